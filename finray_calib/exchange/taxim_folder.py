"""Read a Taxim calibration folder: its ball presses become tactile captures.

Nothing pickled is loaded: shadowTable.npz is left out as a whole, of dataPack.npz whatever is pickled.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from data_schemas.capture import TactileCapture
from data_schemas.errors import ImportFormatError
from data_schemas.foreign_files import read_json
from finray_calib.exchange.ball_press_records import BallPress, press_captures, require_length
from finray_calib.exchange.plain_arrays import Arrays, read_npz, require_array

DATA_PACK: Final = "dataPack.npz"
PARAMETERS: Final = "params.json"
BALL_DIAMETER_MM: Final = 4.0
"""Of the ball that Taxim's own folders were made with; the folder does not say."""
LARGEST_PIXEL_MM: Final = 1.0

_SHADOWS = "shadowTable.npz"
_NOT_NEEDED = {
    "polycalib.npz": "the shading table: made from the presses, which a normal map is fitted to anew",
    "gelmap.npy": "the height of the undeformed gel: not part of a capture",
    "real_bg.npy": "a background: dataPack's f0 is taken",
    "bg.jpg": "a background: dataPack's f0 is taken",
}


@dataclass(frozen=True, slots=True)
class TaximFolder:
    """What a folder gave: captures of the presses, what was left out of it and why, and what was assumed."""

    captures: tuple[TactileCapture, ...]
    left_out: tuple[str, ...]
    assumed: tuple[str, ...]


def read_taxim(folder: Path, ball_diameter_mm: float | None = None, mm_per_px: float | None = None) -> TaximFolder:
    """Read the presses of a Taxim calibration folder.

    The images are BGR in the file and RGB here; circle centres are (column, row) in the file.

    Parameters
    ----------
    folder
        Holds dataPack.npz, and params.json unless `mm_per_px` is given.
    ball_diameter_mm
        Of the ball; by default that of Taxim's own folders, 4 mm.
    mm_per_px
        Side of a pixel on the gel; by default ``pixmm`` of params.json.

    Raises
    ------
    ImportFormatError
        When the folder holds no presses, or something in it is not what the format says.
    """
    if not folder.is_dir():
        raise ImportFormatError(f"{folder}: no such folder; give a Taxim calibration folder, with {DATA_PACK} in it")
    path = folder / DATA_PACK
    arrays, pickled = read_npz(path)
    no_contact = _image(require_array(arrays, pickled, "f0", 3, path), "f0", path)
    if "imgs" not in arrays and "imgs" not in pickled:
        raise ImportFormatError(
            f"{path}: holds the no-contact image only, no presses ('imgs'); that is enough for Taxim to render, and "
            "nothing to compare with: ask for the folder that the table was made from"
        )
    scale = require_length(
        _pixel_mm(folder) if mm_per_px is None else mm_per_px, "millimetres per pixel", "--mm-per-px", LARGEST_PIXEL_MM
    )
    diameter = require_length(
        BALL_DIAMETER_MM if ball_diameter_mm is None else ball_diameter_mm, "the ball's diameter", "--ball-diameter-mm"
    )
    presses = _presses(arrays, pickled, path, diameter)
    name = folder.resolve().name
    captures = press_captures(presses, no_contact, scale, f"Taxim calibration folder '{name}'")
    assumed = [] if ball_diameter_mm is not None else [f"ball of {diameter:g} mm diameter, as of Taxim's own folders"]
    return TaximFolder(tuple(captures), _left_out(folder, pickled), tuple(assumed))


def _presses(arrays: Arrays, pickled: tuple[str, ...], path: Path, ball_diameter_mm: float) -> list[BallPress]:
    """Return the presses of a data pack."""
    images = require_array(arrays, pickled, "imgs", 4, path)
    centres = require_array(arrays, pickled, "touch_center", 2, path).astype(np.float64)
    radii = require_array(arrays, pickled, "touch_radius", 1, path).astype(np.float64)
    if centres.shape != (len(images), 2) or radii.shape != (len(images),):
        raise ImportFormatError(
            f"{path}: {len(images)} images in 'imgs' need as many centres (x, y) and radii, got 'touch_center' of "
            f"shape {centres.shape} and 'touch_radius' of {radii.shape}"
        )
    return [
        BallPress(f"press {k}", _image(image, "imgs", path), float(y), float(x), float(radius), ball_diameter_mm)
        for k, (image, (x, y), radius) in enumerate(zip(images, centres, radii, strict=True), start=1)
    ]


def _image(bgr: NDArray[Any], name: str, path: Path) -> NDArray[np.uint8]:
    """Return a stored image in RGB order."""
    if bgr.shape[2] != 3 or bgr.dtype != np.uint8:
        raise ImportFormatError(
            f"{path}: {name!r} must hold 8-bit colour images (rows, columns, 3), got {bgr.dtype} of {bgr.shape}"
        )
    return np.ascontiguousarray(bgr[..., ::-1])


def _pixel_mm(folder: Path) -> float | None:
    """Return ``sensor.pixmm`` of params.json, None without that file."""
    path = folder / PARAMETERS
    if not path.is_file():
        return None
    try:
        found = read_json(path, "Taxim's parameters", ImportFormatError)["sensor"]["pixmm"]
        if isinstance(found, bool) or not isinstance(found, int | float):
            raise TypeError(f"is {found!r}, no number")
        return float(found)
    except (KeyError, TypeError) as error:
        raise ImportFormatError(
            f"{path}: 'sensor' 'pixmm' (mm per px) cannot be read ({type(error).__name__}: {error}); correct it, or "
            "give --mm-per-px"
        ) from None


def _left_out(folder: Path, pickled: tuple[str, ...]) -> tuple[str, ...]:
    """Say what of the folder is not in the captures."""
    lines = [f"{DATA_PACK}, {name!r}: pickled objects are never loaded" for name in pickled]
    if (folder / _SHADOWS).exists():
        lines.append(f"{_SHADOWS}: pickled objects are never loaded")
    lines += [f"{name}: {why}" for name, why in _NOT_NEEDED.items() if (folder / name).exists()]
    return tuple(lines)
