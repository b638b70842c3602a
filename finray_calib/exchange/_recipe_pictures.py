"""Pictures and numbers of a recipe's folder, and what is wrong with them although each can be read.

A picture that its viewer turns, transparent pixels, two bit depths in one press, lengths in another unit and circles
whose rows and columns are exchanged all give an image or a number that looks right and is not.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from data_schemas import ImportFormatError, TactileCapture
from data_schemas.storage import has_file, read_bytes
from finray_calib.exchange._ball_presses import LARGEST_PIXEL_MM
from finray_calib.exchange._capture_recipe import LeftOutError, Recipe
from finray_calib.exchange._render_files import exr_rgb
from finray_calib.sensing import contact_distance
from rigs.cameras import decoded_picture

Floats = NDArray[np.float64]

_BITS: Final = {np.dtype(np.uint8): 8, np.dtype(np.uint16): 16}
_PICTURE: Final = "a picture (PNG, JPEG) or OpenEXR image"
_UPRIGHT = 1
_ORIENTATION_TAG = 0x0112
#: More pixels of an OpenEXR image above full scale than these are no highlight, and fewer steps below it no picture.
_MOST_ABOVE_FULL, _LEAST_STEPS = 0.01, 256
#: A ball that is pressed in by d touches over a circle whose cap is d high in a rigid pad, and half as high in a thick
#: soft one; with a drawn circle and the play of a stage both agree to this factor.
_DEPTH_FACTOR = 5.0
_UNITS: Final = {1e-3: '"m"', 0.1: '"cm"', 1e3: '"um"'}
#: Without a circle: depths in mm that a gel can have.
_DEPTHS_MM: Final = (0.01, 30.0)
#: The change by contact is so much denser where rows and columns of the circles are exchanged.
_EXCHANGED, _NEAR = 2.0, 1.5


def pixels_of(path: Path) -> NDArray[Any]:
    """Return a picture as stored, (H, W, 3) in RGB order, or (H, W, 1) where it is grey.

    Raises
    ------
    ImportFormatError
        It is missing, of another kind or depth, turned by a mark that viewers follow, or transparent in part.
    """
    if not has_file(path):
        raise ImportFormatError(f"{path}: no such file; the folder must hold it")
    content = read_bytes(path, _PICTURE, ImportFormatError)
    if (turned := orientation(content)) != _UPRIGHT:
        raise ImportFormatError(
            f"{path}: carries the mark of a camera that it is to be shown turned or mirrored (EXIF orientation "
            f"{turned}), which some programs follow and others do not, so that it is not known which way its labels "
            "stand. Turn all pictures for good, as 'mogrify -auto-orient' does, and label these"
        )
    return _in_rgb(decoded_picture(content, path, ImportFormatError), path)


def frame_of(content: bytes, path: Path) -> NDArray[Any]:
    """Return a frame of a video, (H, W, 3) in RGB order."""
    return in_colour(_in_rgb(decoded_picture(content, path, ImportFormatError), path))


def in_colour(picture: NDArray[Any]) -> NDArray[Any]:
    """Return a picture of one or three channels with three."""
    return picture if picture.shape[2] == 3 else np.repeat(picture, 3, axis=2)


def _in_rgb(picture: NDArray[Any], path: Path) -> NDArray[Any]:
    """Return what OpenCV decoded with its channels in the order of RGB, without an opaque alpha channel."""
    if picture.dtype not in _BITS:
        raise ImportFormatError(f"{path}: holds {picture.dtype}; pictures of 8 or 16 bits are read: convert it")
    if picture.ndim == 2:
        return picture[..., None]
    if picture.shape[2] == 4 and (clear := picture[..., 3] < np.iinfo(picture.dtype).max).any():
        raise ImportFormatError(
            f"{path}: {100 * clear.mean():.2g} % of its pixels are transparent, and their colours are not those of the "
            "camera; save it without transparency, as the camera took it"
        )
    return picture[..., 2::-1]


def orientation(content: bytes) -> int:
    """Return how a JPEG or PNG is marked to be turned (EXIF): 1 for upright, or where it says nothing that is known."""
    at = content.find(b"Exif\0\0", 0, 1 << 16) + 6 if content.startswith(b"\xff\xd8") else content.find(b"eXIf") + 4
    if at < 6:
        return _UPRIGHT
    exif = content[at : at + (1 << 16)]
    order = {b"II": "little", b"MM": "big"}.get(exif[:2])
    if order not in ("little", "big"):
        return _UPRIGHT

    def number(place: int, size: int) -> int:
        return int.from_bytes(exif[place : place + size], "big" if order == "big" else "little")

    first = number(4, 4)
    for entry in range(first + 2, first + 2 + 12 * min(number(first, 2), 256), 12):
        if number(entry, 2) == _ORIENTATION_TAG and 1 <= number(entry + 8, 2) <= 8:
            return number(entry + 8, 2)
    return _UPRIGHT


def exr_steps(path: Path, full_scale_rel: float) -> NDArray[np.uint16]:
    """Return an OpenEXR image (H, W, 3) in steps of which 65535 are full scale.

    Raises
    ------
    ImportFormatError
        Much of it lies above full scale, or so little of the scale is used that steps would be seen.
    """
    image = exr_rgb(path)
    largest, above = float(image.max()), float((image > full_scale_rel).mean())
    if above > _MOST_ABOVE_FULL or largest * 65535.0 < _LEAST_STEPS * full_scale_rel:
        what = (
            f"{100 * above:.3g} % of its values lie above picture.full_scale = {full_scale_rel:g} and would be clipped"
            if above > _MOST_ABOVE_FULL
            else f"its values fill only {largest / full_scale_rel * 65535.0:.3g} of the 65535 steps below "
            f"picture.full_scale = {full_scale_rel:g}"
        )
        raise ImportFormatError(
            f"{path}: {what}; its largest value is {largest:.4g}: give a full scale a little above that of all pictures"
        )
    return np.clip(np.rint(image / full_scale_rel * 65535.0), 0.0, 65535.0).astype(np.uint16)


def require_alike(pictures: Mapping[Path, NDArray[Any]]) -> None:
    """Refuse pictures of one press of different depths or numbers of channels: their values mean different light.

    Raises
    ------
    ImportFormatError
        Two of them differ.
    """
    (first_path, first), *others = pictures.items()
    for path, picture in others:
        kinds = [
            f"{_BITS[p.dtype]} bits, {'grey' if p.shape[2] == 1 else 'colour'}"
            + (" and light (OpenEXR)" if file.suffix.lower() == ".exr" else "")
            for file, p in ((first_path, first), (path, picture))
        ]
        if kinds[0] != kinds[1]:
            raise ImportFormatError(
                f"{first_path} has {kinds[0]}, {path} has {kinds[1]}: values of the two cannot be compared; save the "
                "pictures of all presses and those without contact in one format"
            )


def require_possible_scale(recipe: Recipe) -> None:
    """Refuse a pixel of more than a millimetre: no sensor of this kind has one, and inverted scales do.

    Raises
    ------
    ImportFormatError
        The scale of the recipe says so.
    """
    scale = recipe.scale
    if scale is not None and scale.side_mm > LARGEST_PIXEL_MM:
        given, other = ("mm_per_px", "px_per_mm") if scale.mm_per_px is not None else ("px_per_mm", "mm_per_px")
        number = scale.mm_per_px if scale.mm_per_px is not None else scale.px_per_mm
        raise ImportFormatError(
            f"recipe '{recipe.name}', scale: with {given} = {number:g} a pixel is {scale.side_mm:.4g} mm wide, and at "
            f"most {LARGEST_PIXEL_MM:g} mm are allowed; is it {other} = {number:g}?"
        )


def require_possible_depths(recipe: Recipe, depths: Mapping[str, tuple[float, float | None]]) -> None:
    """Refuse depths that are in another unit than millimetres, by the circles of balls or by what a gel can be.

    Parameters
    ----------
    recipe
        Named in the message.
    depths
        Name of the press -> its depth and the height of its circle's cap where ball, scale and circle are known, mm.

    Raises
    ------
    ImportFormatError
        The median of the presses is too far off.
    """
    if not depths:
        return
    ratios = [depth / cap for depth, cap in depths.values() if cap is not None and cap > 0.0]
    middle_mm = float(np.median([depth for depth, _ in depths.values()]))
    if ratios:
        ratio = float(np.median(ratios))
        if 1.0 / _DEPTH_FACTOR <= ratio <= _DEPTH_FACTOR:
            return
        why = f"{ratio:.2g} times the height of the ball's cap over the contact circles, {middle_mm / ratio:.3g} mm"
    elif _DEPTHS_MM[0] <= middle_mm <= _DEPTHS_MM[1]:
        return
    else:
        ratio = middle_mm / 1.0
        why = f"and {_DEPTHS_MM[0]:g} to {_DEPTHS_MM[1]:g} mm are allowed"
    unit = next((name for factor, name in _UNITS.items() if 1 / 3 < ratio / factor < 3), '"m", "cm" or "um"')
    raise ImportFormatError(
        f"recipe '{recipe.name}', indenter.depth_mm: the median depth of {len(depths)} presses is {middle_mm:.3g} mm, "
        f"{why}. If the column is in another unit, say columns_in = {unit} below [indenter]; else correct the depths, "
        "the scale or the ball's diameter"
    )


def circle_densities(capture: TactileCapture) -> tuple[float, float] | None:
    """Return the change by contact per pixel near the circle, and near one with row and column exchanged.

    None where the exchanged one lies outside the picture or over the same pixels.
    """
    circle, distance = capture.contact_circle, contact_distance(capture)
    if circle is None or distance is None:
        return None
    exchanged = circle.model_copy(update={"row_px": circle.column_px, "column_px": circle.row_px})
    rows, columns = capture.contact.shape[:2]
    apart = np.sqrt(2.0) * abs(circle.row_px - circle.column_px)
    if not (exchanged.row_px < rows and exchanged.column_px < columns) or apart < circle.radius_px:
        return None
    other = contact_distance(capture.model_copy(update={"contact_circle": exchanged}))
    change = np.abs(capture.contact.astype(np.float64) - capture.no_contact).mean(axis=-1)
    if other is None or not ((distance < _NEAR).any() and (other < _NEAR).any()):
        return None
    return float(change[distance < _NEAR].mean()), float(change[other < _NEAR].mean())


def require_circles_on_contacts(recipe: Recipe, densities: Mapping[str, tuple[float, float]]) -> None:
    """Refuse circles whose presses change more where row and column are exchanged.

    Raises
    ------
    ImportFormatError
        The median over presses says so.
    """
    if not densities:
        return
    ratio = float(np.median([other / max(own, 1e-9) for own, other in densities.values()]))
    if ratio > _EXCHANGED:
        raise ImportFormatError(
            f"recipe '{recipe.name}', contact.circle: {len(densities)} presses change {ratio:.2g} times as much where "
            "row and column of their circles are exchanged; exchange column_px and row_px"
        )


def above_zero(what: str, value_mm: float | None) -> None:
    """Leave out a press of which a table says a length that none has.

    Raises
    ------
    LeftOutError
        It is not above 0.
    """
    if value_mm is not None and not value_mm > 0.0:
        raise LeftOutError(f"its {what} is {value_mm:g} mm in the table; it must be above 0")


def longest_hold(strength: Floats, least_share: float) -> int:
    """Return the middle of the longest run of frames near the largest value."""
    held = np.concatenate([[False], strength >= least_share * strength.max(), [False]])
    starts, stops = np.flatnonzero(~held[:-1] & held[1:]), np.flatnonzero(held[:-1] & ~held[1:])
    longest = int(np.argmax(stops - starts))
    return int((starts[longest] + stops[longest] - 1) // 2)


def small_frame(picture: NDArray[Any]) -> Floats:
    """Return a frame in few pixels, for choosing frames."""
    return np.asarray(cv2.resize(picture, (160, 120), interpolation=cv2.INTER_AREA), dtype=np.float64)
