"""From linear images to what a screen shows: white balance, sRGB transfer, outlines, PNG bytes and data URIs.

The images of a touch have the light of each source unmixed where that is possible and are cut to the pad; what the
touch changes in capture and render is shown on one scale. Denoised pictures are for the eye only: nothing is measured
in them. Many presses stand on one sheet with their contacts and a list of circles to correct.
"""

import base64
import csv
import io
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import import_module
from math import ceil, sqrt
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from data_schemas import MissingExtraError, RecordError, SensedPress, SimulatedPress, SimulateError, TactileCapture
from finray_calib.reports._style import new_figure, styled
from finray_calib.reports._style import png_bytes as figure_bytes
from finray_calib.sensing import full_scale_dn, rgb_image

FloatImage = NDArray[np.float64]
ByteImage = NDArray[np.uint8]

WHITE_PERCENTILE = 99.5
"""Share of pixels, in per cent, that must not clip in the display; the rest are glints and hot pixels."""


CLIPPED_GREYS = (225, 140)
"""The two levels that clipped pixels are drawn with."""


def display_white(image: NDArray[np.floating]) -> FloatImage:
    """Return the value of each channel that a display should show as white, (3,): a high percentile.

    Parameters
    ----------
    image
        (..., 3) pixels to balance by, any unit.

    Raises
    ------
    RecordError
        When a channel has no light to balance by.
    """
    white = np.nanpercentile(np.asarray(image, dtype=np.float64).reshape(-1, 3), WHITE_PERCENTILE, axis=0)
    if not (white > 0).all():
        raise RecordError(
            f"display image: percentile {WHITE_PERCENTILE} of the channels is {white.tolist()}, but every channel must "
            "be above 0 to be shown white-balanced; check black level and exposure"
        )
    return np.asarray(white)


def to_display(image: NDArray[np.floating], white: FloatImage, linear: bool) -> ByteImage:
    """Return 8-bit sRGB code values of an image: divided by the white of each channel, then the sRGB transfer.

    s = 12.92 v up to v = 0.0031308, else 1.055 v^(1/2.4) - 0.055 (IEC 61966-2-1). Encoded values (`linear`
    False) have their curve already and are only scaled.

    Parameters
    ----------
    image
        (H, W, 3), any unit; NaN is shown black.
    white
        (3,) value per channel shown as white, same unit.
    """
    value = np.clip(np.nan_to_num(np.asarray(image, dtype=np.float64)) / white, 0.0, 1.0)
    if linear:
        value = np.where(value <= 0.0031308, 12.92 * value, 1.055 * value ** (1 / 2.4) - 0.055)
    return np.asarray(np.rint(255 * value), dtype=np.uint8)


def raspberry_pi_display(image: NDArray[np.floating], pad: NDArray[np.bool_]) -> ByteImage:
    r"""Return what the image processing of a Raspberry Pi (camera module 2) makes of linear camera values, 8-bit.

    s = T(e M diag(g) v) with the white balance g and colour matrix M of its bluest daylight, 8575 K, where automatic
    white balance ends under blue light, and its tone curve T. The exposure e puts the brightest of the pad at 70 %.
    For the eye: lens shading, sharpening and the tone curve's adaptation to the picture are left out.

    Parameters
    ----------
    image
        (H, W, 3) linear values, any unit.
    pad
        (H, W) pixels to expose by.

    Raises
    ------
    RecordError
        When the pad is black.

    References
    ----------
    Tuning of the IMX219 in libcamera (src/ipa/rpi/vc4/data/imx219.json, BSD-2-Clause): ct_curve, ccm, contrast.
    """
    colours = np.asarray(image, dtype=np.float64) * _PI_GAINS @ _PI_MATRIX.T
    brightest = np.nanpercentile(colours[pad].max(axis=-1), WHITE_PERCENTILE) if pad.any() else 0.0
    if not brightest > 0.0:
        raise RecordError("display image: the pad is black in a Raspberry Pi's colours; check lights and paints")
    exposed = np.clip(np.nan_to_num(_PI_EXPOSED_TO / brightest * colours), 0.0, 1.0)
    return np.asarray(np.rint(255.0 * np.interp(exposed, *_PI_TONE_CURVE)), dtype=np.uint8)


_PI_EXPOSED_TO = 0.7
_PI_GAINS = np.array([2.31, 1.0, 1.24])
_PI_MATRIX = np.array([[2.212, -0.532, -0.679], [-0.579, 3.079, -1.500], [-0.277, -0.733, 2.010]])
_PI_TONE_CURVE = (
    np.array([0, 1024, 4096, 8192, 16384, 32768, 49152, 65535]) / 65535,
    np.array([0, 5040, 15312, 25744, 40642, 54876, 61183, 65535]) / 65535,
)
"""Linear and shown value."""


def with_outline(image: ByteImage, mask: NDArray[np.bool_]) -> ByteImage:
    """Return the image with the border of a mask drawn as a white line beside a black one (seen on any ground).

    The mask is stretched to the image when their sizes differ.
    """
    height, width = image.shape[:2]
    inside = cv2.resize(mask.astype(np.uint8), (width, height), interpolation=cv2.INTER_NEAREST)
    cross = cv2.getStructuringElement(cv2.MORPH_CROSS, (3, 3))
    outer = cv2.dilate(inside, cross) > inside
    inner = inside > cv2.erode(inside, cross, borderValue=1)
    drawn = image.copy()
    drawn[outer] = 0
    drawn[inner] = 255
    return drawn


def missing(image: NDArray[np.floating]) -> NDArray[np.bool_]:
    """Return which pixels (H, W) of an image (H, W, 3) have a channel without value."""
    return np.asarray(np.isnan(image).any(axis=-1), dtype=np.bool_)


def with_clipped(image: ByteImage, clipped: NDArray[np.bool_]) -> ByteImage:
    """Return the image with clipped pixels as a chequerboard of two greys, which no colour of light looks like.

    Where a channel is at full scale the colour is not known: shown as it is, or unmixed, it takes a false one.
    """
    drawn = image.copy()
    rows, columns = np.nonzero(clipped)
    drawn[rows, columns] = np.where((rows // 2 + columns // 2) % 2 == 0, *CLIPPED_GREYS)[:, None]
    return drawn


def clipped_remark(clipped: NDArray[np.bool_]) -> str:
    """Return what a caption says of clipped pixels; nothing where there are none."""
    return " Grey chequers: clipped, so the colour is not known." if clipped.any() else ""


def png_bytes(rgb: ByteImage) -> bytes:
    """Return an (H, W, 3) sRGB image as PNG bytes."""
    _, encoded = cv2.imencode(".png", np.ascontiguousarray(rgb[..., ::-1]))
    return encoded.tobytes()


def png_data_uri(rgb: ByteImage) -> str:
    """Return an (H, W, 3) sRGB image as a PNG data URI for an HTML image."""
    return "data:image/png;base64," + base64.b64encode(png_bytes(rgb)).decode("ascii")


SHOWN_AS_RGB = ("red", "green", "led")
"""Bands shown as red, green and blue: emission of the two paints, and light of the LED."""
MARGIN_REL = 0.12
"""Border left around the pad, as a share of its height in the image; the painted walls lie in it."""


def is_unmixed(press: SimulatedPress) -> bool:
    """Whether the images of a press, and of its capture, can be split into red emission, green emission and LED."""
    return press.encoding == "linear" and press.camera_matrix is not None and set(press.bands) == set(SHOWN_AS_RGB)


def touch_pair(
    press: SimulatedPress, no_contact: NDArray[np.floating], contact: NDArray[np.floating], region: NDArray[np.bool_]
) -> tuple[ByteImage, ByteImage]:
    """Return the untouched and the touched image for the screen, cut to the pad; the second with a region outlined.

    Camera RGB x becomes bands C^-1 x with the press's camera matrix C. Both images are divided by the same white:
    a high percentile of each band over the untouched pad, so that glare beside the pad does not set the scale.
    Without a camera matrix the camera's own channels are shown.

    Parameters
    ----------
    press
        Gives camera matrix, encoding and the pad.
    no_contact, contact
        (H, W, 3) images of one camera, on the grid of the press, any unit; NaN where clipped, which is drawn so.
    region
        (H, W) mask that is outlined.

    Raises
    ------
    RecordError
        When a channel has no light on the pad.
    """
    before, after = (shown_bands(press, np.asarray(image, dtype=np.float64)) for image in (no_contact, contact))
    pad = np.isfinite(press.distance)
    white, linear = display_white(before[pad]), press.encoding == "linear"
    shown, touched = (with_clipped(to_display(image, white, linear), missing(image)) for image in (before, after))
    window = pad_window(press)
    return shown[window], with_outline(touched, region)[window]


def pad_window(press: SimulatedPress) -> tuple[slice, slice]:
    """Return rows and columns that hold the pad and a margin."""
    rows, columns = np.nonzero(np.isfinite(press.distance))
    margin = round(MARGIN_REL * (rows.max() - rows.min()))
    return (
        slice(int(max(rows.min() - margin, 0)), int(rows.max() + margin + 1)),
        slice(int(max(columns.min() - margin, 0)), int(columns.max() + margin + 1)),
    )


def shown_bands(press: SimulatedPress, image: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the light of each source in the order it is shown, or the image itself."""
    if press.camera_matrix is None or not is_unmixed(press):
        return image
    order = [press.bands.index(name) for name in SHOWN_AS_RGB]
    # A camera whose channels see alike has no inverse; the pseudo-inverse then still gives a picture.
    return np.asarray(image @ np.linalg.pinv(press.camera_matrix)[order].T)


def display_remark(press: SimulatedPress) -> str:
    """Say what was done to the images for the screen."""
    cut = "Images are cut to the pad"
    if is_unmixed(press):
        return (
            f"{cut} and unmixed into red emission (shown red), green emission (green) and LED light (blue), each "
            "balanced for the screen on the untouched pad; the numbers use the camera's linear values."
        )
    if press.encoding == "linear":
        return (
            f"{cut}; each channel is balanced for the screen on the untouched pad. The numbers use the camera's linear "
            "values."
        )
    return f"{cut}; they hold encoded values, which are only scaled for the screen."


Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]
LARGEST_PIXELS = 100_000
"""Pictures have no more: a noisy image hardly compresses, and the page should travel by e-mail."""
LARGEST_MAP_PIXELS = 45_000
"""Nor maps: single pixels of a noisy difference say nothing."""
_LARGEST_SIDE_PX, _LEAST_BLOCKS = 8, 16
_SD_OF_MEDIAN_STEP = 1.4826 / sqrt(2.0)
"""Standard deviation of one value by the median absolute difference of two."""


@dataclass(frozen=True, slots=True)
class TouchPictures:
    """The pad in 8-bit sRGB: captured untouched and touched, simulated touched; scored regions outlined.

    `clipped` are the masks of the clipped pixels of both captured pictures, which are drawn as such.
    """

    captured_untouched: ByteImage
    captured: ByteImage
    simulated: ByteImage
    clipped: tuple[Mask, Mask]


def on_grid(mask: Mask, shape: tuple[int, ...]) -> Mask:
    """Return a mask (H, W) on a coarser or finer grid of the same view; all of it where the mask is empty."""
    rows, columns = (np.arange(n) * size // n for n, size in zip(shape, mask.shape, strict=True))
    found = mask[np.ix_(rows, columns)]
    return found if found.any() else np.full(shape, True)


@dataclass(frozen=True, slots=True)
class TouchChanges:
    """What the touch changes, mean over the channels relative to the untouched level, (H, W); NaN where clipped.

    `regions` are the outlines of the scored regions on the same grid.
    """

    captured: Floats
    simulated: Floats
    regions: tuple[Mask, ...]

    @property
    def scale(self) -> float:
        """Return the end of a common colour scale: what 99 % of the values of both maps in the regions stay below.

        Beside the regions a dark picture changes by many times its level, and would leave nothing to see in them.
        """
        inside = on_grid(np.any(self.regions, axis=0), self.captured.shape)
        both = np.abs(np.stack([self.captured[inside], self.simulated[inside]]))
        top = float(np.nanpercentile(both, 99.0)) if np.isfinite(both).any() else 0.0
        return top if top > 0 else 1.0


def require_one_grid(press: SimulatedPress, capture: TactileCapture) -> None:
    """Refuse a render that is not on the grid of the capture.

    Raises
    ------
    RecordError
        Their sizes differ.
    """
    height, width = rgb_image(capture.no_contact, capture).shape[:2]
    if press.contact.shape[:2] != (height, width):
        raise RecordError(
            f"comparison page: the render has {press.contact.shape[1]} x {press.contact.shape[0]} px, but the capture "
            f"has {width} x {height} px; give the render on the grid of the capture (registered)"
        )


def touch_pictures(press: SimulatedPress, capture: TactileCapture, factors: tuple[float, ...]) -> TouchPictures:
    """Return capture and render as pictures, cut to the pad, with the regions of these half-widths outlined.

    Linear light is divided by the white of each untouched pad, with common headroom for what the touch makes brighter;
    encoded values are shown as they are.
    """
    linear, window = capture.encoding == "linear", pad_window(press)
    captured = [shown_bands(press, rgb_image(image, capture)) for image in (capture.no_contact, capture.contact)]
    simulated = [shown_bands(press, image.astype(np.float64)) for image in (press.no_contact, press.contact)]
    if linear:
        whites = _whites(captured, simulated, np.isfinite(press.distance))
    else:
        whites = [np.full(3, full_scale_dn(capture))] * 2
    untouched, touched = (missing(image[window]) for image in captured)
    clipped = (untouched, touched)
    masks = [press.distance[window] <= factor for factor in factors]
    return TouchPictures(
        _fitted(with_clipped(to_display(captured[0][window], whites[0], linear), clipped[0])),
        _outlined(with_clipped(to_display(captured[1][window], whites[0], linear), clipped[1]), masks),
        _outlined(to_display(simulated[1][window], whites[1], linear), masks),
        clipped,
    )


def _whites(captured: list[Floats], simulated: list[Floats], pad: Mask) -> list[Floats]:
    """Return what is shown white in capture and render, from the untouched and the touched image of each."""
    before, after = ([display_white(pair[i][pad]) for pair in (captured, simulated)] for i in (0, 1))
    headroom = max(1.0, *(float((a / b).max()) for a, b in zip(after, before, strict=True)))
    return [headroom * white for white in before]


def touch_changes(press: SimulatedPress, capture: TactileCapture, factors: tuple[float, ...]) -> TouchChanges:
    """Return what the touch changes in capture and render.

    change = mean over the channels of (contact - no contact) / mean no-contact level over the pad

    Each side is divided by its own level, so an exposure common to both of its images cancels. Noisy maps are averaged
    over blocks, so that what the touch changes is seen.
    """
    window, pad = pad_window(press), np.isfinite(press.distance)
    captured = _change(rgb_image(capture.no_contact, capture), rgb_image(capture.contact, capture), pad)
    simulated = _change(press.no_contact.astype(np.float64), press.contact.astype(np.float64), pad)
    regions = tuple((press.distance <= factor)[window] for factor in factors)
    side = max(_steady_side(image[window]) for image in (captured, simulated))
    return TouchChanges(coarser(captured[window], side), coarser(simulated[window], side), regions)


def _change(no_contact: Floats, contact: Floats, pad: Mask) -> Floats:
    """Return the relative change of one side."""
    level = np.nanmean(no_contact[pad], axis=0)
    return np.asarray(((contact - no_contact) / level).mean(axis=-1))


def _steady_side(values: Floats) -> int:
    """Return the side of blocks whose noise is a tenth of what the map shows; at most 8 px, and 16 blocks stay.

    The noise is the median of the differences of neighbours, as that of a normal distribution.
    """
    steps = np.abs(np.diff(values, axis=1))
    noise = float(np.nanmedian(steps)) * _SD_OF_MEDIAN_STEP
    largest = max(1, min(_LARGEST_SIDE_PX, min(values.shape) // _LEAST_BLOCKS))
    shown = np.abs(coarser(values, largest))
    level = float(np.nanpercentile(shown, 99.0)) if np.isfinite(shown).any() else 0.0
    side = 1
    while 2 * side <= largest and noise / side > 0.1 * level:
        side *= 2
    return side


def coarser(values: Floats, least_side_px: int = 1) -> Floats:
    """Return a map averaged over blocks until it has few enough pixels; NaN stays out of the means."""
    side = max(least_side_px, ceil(sqrt(values.size / LARGEST_MAP_PIXELS)))
    rows, columns = (max(n // side, 1) for n in values.shape)
    blocks = values[: rows * side, : columns * side].reshape(rows, side, columns, side)
    known = np.isfinite(blocks).sum(axis=(1, 3))
    total = np.nansum(blocks, axis=(1, 3))
    return np.where(known > 0, total / np.maximum(known, 1), np.nan)


def _fitted(image: ByteImage) -> ByteImage:
    """Return the picture, made smaller where it has too many pixels."""
    height, width = image.shape[:2]
    share = sqrt(LARGEST_PIXELS / (height * width))
    if share >= 1:
        return image
    size = (max(int(width * share), 1), max(int(height * share), 1))
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)


def _outlined(image: ByteImage, masks: list[Mask]) -> ByteImage:
    """Return the fitted picture with every region outlined."""
    drawn = _fitted(image)
    for mask in masks:
        drawn = with_outline(drawn, mask)
    return drawn


FEWEST_SAMPLES = 64
"""Paths per pixel below which the denoiser invents light: with 16 it raised green and blue by 9 to 14 %."""

_WHITE_PERCENTILE = 97.0


def require_denoiser() -> Any:
    """Return the denoising function of Open Image Denoise; called before anything is rendered.

    Raises
    ------
    MissingExtraError
        The package is not installed.
    """
    try:
        return import_module("pyoidn.denoise").denoise
    except ImportError:
        raise MissingExtraError(
            "denoised pictures need Open Image Denoise: pip install 'finray-calib[denoise]'"
        ) from None


def denoised(bands: NDArray[np.float32], samples_per_pixel: int) -> NDArray[np.float32]:
    """Return band images without their noise, each band for itself as a grey picture.

    Bands denoised together, or with few paths, come out biased; the contrast of an indentation drops by 2 to 15 %
    even so, and thin glints vanish.

    Parameters
    ----------
    bands
        (rows, columns, band), at least 0.
    samples_per_pixel
        Paths per pixel they were rendered with.

    Raises
    ------
    SimulateError
        With fewer than 64 paths per pixel.
    MissingExtraError
        Open Image Denoise is not installed.
    """
    if samples_per_pixel < FEWEST_SAMPLES:
        raise SimulateError(
            f"a denoised picture needs at least {FEWEST_SAMPLES} paths per pixel, got {samples_per_pixel}; with fewer "
            "paths the denoiser makes the image too bright. Give --samples 64 or more, or leave out --denoise"
        )
    denoise = require_denoiser()
    clean = np.empty_like(bands)
    for k in range(bands.shape[-1]):
        white = np.float32(np.percentile(bands[..., k], _WHITE_PERCENTILE)) or np.float32(1.0)
        grey = np.repeat(bands[..., k, None] / white, 3, axis=2).astype(np.float32)
        clean[..., k] = np.asarray(denoise(np.ascontiguousarray(grey), hdr=True))[..., 0] * white
    return np.maximum(clean, np.float32(0.0))


THUMBNAIL_PX = 240
MOST_SHOWN = 200
_COLUMNS = 7
_WHITE, _DARK = (255, 255, 255), (0, 0, 0)


class ContactSheet:
    """Small pictures of presses with their contact, and their circles, added one press after the other."""

    def __init__(self) -> None:
        self._tiles: list[ByteImage] = []
        self._rows: list[tuple[str, ...]] = []

    def add(self, name: str, capture: TactileCapture) -> None:
        """Add a press; the first 200 are shown."""
        if len(self._tiles) < MOST_SHOWN:
            self._tiles.append(_thumbnail(name, capture))
        circle = capture.contact_circle
        if circle is not None:
            numbers = (f"{v:.4g}" for v in (circle.column_px, circle.row_px, circle.radius_px))
            self._rows.append((name, *numbers, capture.contact_told_by or "label"))

    def png(self) -> bytes:
        """Return the pictures as one PNG picture."""
        height = max(tile.shape[0] for tile in self._tiles)
        columns = min(_COLUMNS, len(self._tiles))
        sheet = np.full((-(-len(self._tiles) // columns) * height, columns * THUMBNAIL_PX, 3), 255, np.uint8)
        for i, tile in enumerate(self._tiles):
            top, left = i // columns * height, i % columns * THUMBNAIL_PX
            sheet[top : top + tile.shape[0], left : left + tile.shape[1]] = tile
        return png_bytes(sheet)

    def circles_csv(self) -> str:
        """Return the circles, a line each: image, column_px, row_px, radius_px, source."""
        text = io.StringIO(newline="")
        table = csv.writer(text, lineterminator="\n")
        table.writerows([("image", "column_px", "row_px", "radius_px", "source"), *self._rows])
        return text.getvalue()


def _thumbnail(name: str, capture: TactileCapture) -> ByteImage:
    """Return a small picture of a press with its contact and its name."""
    picture = _shown(capture.contact.astype(np.float64), capture)
    scale = THUMBNAIL_PX / picture.shape[1]
    size = (THUMBNAIL_PX, max(1, round(scale * picture.shape[0])))
    tile = np.ascontiguousarray(
        np.rint(255.0 * cv2.resize(picture, size, interpolation=cv2.INTER_AREA)), dtype=np.uint8
    )
    circle, outline = capture.contact_circle, capture.contact_outline
    if circle is not None:
        centre = (round(scale * circle.column_px), round(scale * circle.row_px))
        for colour, width in ((_DARK, 3), (_WHITE, 1)):
            cv2.circle(tile, centre, max(1, round(scale * circle.radius_px)), colour, width, cv2.LINE_AA)
    elif outline is not None:
        corners = np.array([[[round(scale * p.column_px), round(scale * p.row_px)]] for p in outline], np.int32)
        for colour, width in ((_DARK, 3), (_WHITE, 1)):
            cv2.polylines(tile, [corners], True, colour, width, cv2.LINE_AA)
    for colour, width in ((_DARK, 3), (_WHITE, 1)):
        cv2.putText(tile, name[-34:], (4, 14), cv2.FONT_HERSHEY_SIMPLEX, 0.38, colour, width, cv2.LINE_AA)
    return tile


def _shown(values: NDArray[np.float64], capture: TactileCapture) -> NDArray[np.float64]:
    """Return values (H, W, 1 or 3) as an eye sees them, (H, W, 3), 0 to 1."""
    top = max(float(np.nanpercentile(values, 99.5)), 1e-9)
    shown = np.clip(np.nan_to_num(values, nan=top) / top, 0.0, 1.0) ** (0.45 if capture.encoding == "linear" else 1.0)
    return np.repeat(shown, 3, axis=2) if shown.shape[2] == 1 else shown


def sensed_png(sensed: SensedPress, capture: TactileCapture) -> bytes:
    """Return capture, normals and depth of a sensed press, each with the outline of its contact, as a PNG picture."""
    touched = sensed.contact.astype(np.bool_)
    rows, columns = touched.shape
    counts = capture.contact.astype(np.float64)
    seen = cv2.resize(_shown(counts, capture), (columns, rows), interpolation=cv2.INTER_AREA)
    normal = np.asarray(np.rint(255.0 * (0.5 + 0.5 * sensed.normal)), dtype=np.uint8)
    width_mm, height_mm = columns * sensed.mm_per_px, rows * sensed.mm_per_px
    extent = (0.0, width_mm, height_mm, 0.0)
    with styled():
        figure = new_figure(11.0, 0.9 + 3.3 * height_mm / width_mm)
        axes = figure.subplots(1, 3, sharex=True, sharey=True)
        for at, image, title in zip(
            axes[:2],
            (np.asarray(np.rint(255.0 * seen), dtype=np.uint8), normal),
            ("capture", "normal"),
            strict=True,
        ):
            at.imshow(with_outline(image, touched), extent=extent)
            at.set_title(title)
        drawn = axes[2].imshow(sensed.depth_mm, extent=extent, cmap="viridis")
        axes[2].contour(touched, levels=[0.5], colors="white", linewidths=1.2, extent=extent, origin="upper")
        axes[2].set_title("depth" if sensed.depth_u_mm is None else f"depth, u = {sensed.depth_u_mm:.2g} mm at a pixel")
        figure.colorbar(drawn, ax=axes[2], label="mm into the gel")
        axes[0].set_ylabel("mm")
        for at in axes:
            at.set_xlabel("mm")
            at.grid(visible=False)
        return figure_bytes(figure)


_LIT_PERCENTILE, _LIT_SHARE = 95.0, 0.1
"""Pictures of a study are cut alike: to where any of them has this share of the light of its brightest 5 %."""
_MEDIAN_PX, _FEWEST_LIT = 5, 0.05
"""A single bright pixel is the render's noise, and a row or column with fewer lit pixels than this is left out."""


def lit_window(images: Sequence[NDArray[np.float32]]) -> tuple[slice, slice]:
    """Return the rows and columns that are lit in any of some pictures of one size: the dark around is left out."""
    rows, columns = (np.zeros(size) for size in images[0].shape[:2])
    for image in images:
        level = np.percentile(image, _LIT_PERCENTILE, axis=(0, 1))
        light = (image / np.where(level > 0.0, level, 1.0)).mean(axis=-1, dtype=np.float32)
        is_lit = cv2.medianBlur(light, _MEDIAN_PX) > _LIT_SHARE
        rows, columns = np.maximum(rows, is_lit.mean(axis=1)), np.maximum(columns, is_lit.mean(axis=0))
    return _reach(rows), _reach(columns)


def _reach(share: NDArray[np.floating]) -> slice:
    """Return from the first to the last place with enough lit pixels; all where there is none."""
    found = np.flatnonzero(share > _FEWEST_LIT)
    return slice(int(found[0]), int(found[-1]) + 1) if found.size else slice(None)
