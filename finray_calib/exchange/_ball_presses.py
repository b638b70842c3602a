"""Folders of ball presses of other labs as tactile captures: images, a background and labelled circles.

Three layouts: that of gs_sdk (``catalog.csv`` names a folder per press, with ``gelsight.png`` and ``label.npz`` of
center and radius), plain images with ``circles.csv`` (image, column_px, row_px, radius_px), and a Taxim calibration
folder. The 8-bit colour images are of unknown encoding.

No pickled object is ever loaded, for that would run a stranger's code: of Taxim's shadowTable.npz nothing, of
dataPack.npz what is not pickled.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import zip_longest
from pathlib import Path, PurePosixPath
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import NDArray

from data_schemas import ContactCircle, ImportFormatError, IndenterPose, TactileCapture, storage
from data_schemas.storage import finite_number, read_csv, read_json
from rigs.cameras import read_picture

Bytes = NDArray[np.uint8]
LARGEST_BALL_MM = 100.0


@dataclass(frozen=True, slots=True)
class BallPress:
    """One press: its image in RGB order, and the circle that someone drew around the contact.

    Attributes
    ----------
    name
        Of the press within its folder.
    rgb
        (H, W, 3).
    row_px, column_px, radius_px
        Centre and radius of the circle.
    ball_diameter_mm
        Of the ball.
    """

    name: str
    rgb: Bytes
    row_px: float
    column_px: float
    radius_px: float
    ball_diameter_mm: float


def press_captures(
    presses: Sequence[BallPress], no_contact_rgb: Bytes, mm_per_px: float, source: str
) -> list[TactileCapture]:
    """Return a tactile capture of each press; all share one no-contact image, and none has a repeat of it.

    Exposure, gains and transfer curve are not known: ``encoding`` is "unknown" and ``exposure_s`` is left out.

    Raises
    ------
    ImportFormatError
        When an image has another size than the no-contact image, a circle lies outside its image, or is larger than
        the ball.
    """
    for press in presses:
        _check(press, no_contact_rgb, mm_per_px, source)
    return [_capture(press, no_contact_rgb, mm_per_px, source) for press in presses]


def require_length(value_mm: float | None, what: str, option: str, largest_mm: float = LARGEST_BALL_MM) -> float:
    """Return a length that the user, or the folder, must give.

    Raises
    ------
    ImportFormatError
        When it is missing, not above zero, or too large to be meant.
    """
    if value_mm is None:
        raise ImportFormatError(f"{what} is not stated in the folder; give it with {option}")
    if not 0.0 < value_mm <= largest_mm:
        raise ImportFormatError(f"{what} must be above 0 and at most {largest_mm:g} mm, got {value_mm:g} mm")
    return value_mm


def _capture(press: BallPress, no_contact_rgb: Bytes, mm_per_px: float, source: str) -> TactileCapture:
    """Return the record of one press."""
    return TactileCapture(
        name=press.name,
        contact=press.rgb.astype(np.uint16),
        no_contact=no_contact_rgb.astype(np.uint16),
        repeat_no_contact=None,
        layout="RGB",
        encoding="unknown",
        bit_depth=8,
        black_level_dn=0.0,
        exposure_s=None,
        light_angle_deg=None,
        indenter=IndenterPose(shape="ball", radius_mm=press.ball_diameter_mm / 2.0, depth_mm=None, position_mm=None),
        contact_circle=ContactCircle(row_px=press.row_px, column_px=press.column_px, radius_px=press.radius_px),
        mm_per_px=mm_per_px,
        source=source,
    )


def _check(press: BallPress, no_contact_rgb: Bytes, mm_per_px: float, source: str) -> None:
    """Refuse a press whose image or circle cannot be."""
    where = f"{source}: {press.name}"
    rows, columns = no_contact_rgb.shape[:2]
    if press.rgb.shape != no_contact_rgb.shape:
        raise ImportFormatError(
            f"{where}: the image has shape {press.rgb.shape}, but the no-contact image has shape "
            f"{no_contact_rgb.shape}; take both images with one camera at one size"
        )
    if not (0.0 <= press.row_px < rows and 0.0 <= press.column_px < columns):
        raise ImportFormatError(
            f"{where}: the circle's centre, row {press.row_px:g}, column {press.column_px:g}, lies outside the picture "
            f"of {columns} x {rows} px; check whether x (column) and y (row) are exchanged"
        )
    ball_px = press.ball_diameter_mm / 2.0 / mm_per_px
    if not 0.0 < press.radius_px < ball_px:
        raise ImportFormatError(
            f"{where}: the contact circle has a radius of {press.radius_px:g} px, but it must be above 0 and below "
            f"the radius of the ball, {ball_px:.4g} px ({press.ball_diameter_mm:g} mm diameter at {mm_per_px:g} mm "
            "per px); correct --ball-diameter-mm (diameter, not radius), --mm-per-px (not px per mm) or the label"
        )


def read_rgb(path: Path) -> Bytes:
    """Read an 8-bit colour image in RGB order.

    Raises
    ------
    ImportFormatError
        When the file is missing or holds something else.
    """
    if not path.is_file():
        raise ImportFormatError(f"{path}: no such file, but the folder must contain it")
    bgr = read_picture(path, "an 8-bit colour image (PNG, JPEG)", ImportFormatError)
    if bgr.ndim != 3 or bgr.shape[2] != 3 or bgr.dtype != np.uint8:
        raise ImportFormatError(
            f"{path}: expected an 8-bit colour image (PNG, JPEG), got {bgr.dtype} of shape {bgr.shape}; convert the "
            "image"
        )
    return np.asarray(bgr[..., ::-1], dtype=np.uint8)


BACKGROUNDS: Final = ("background.png", "background.jpg", "background.jpeg")
CATALOG: Final = "catalog.csv"
CIRCLES: Final = "circles.csv"
LARGEST_PIXEL_MM: Final = 1.0
MOST_PRESSES: Final = 2000

_FOLDER, _DIAMETER = "experiment_reldir", "diameter(mm)"
_CIRCLE_COLUMNS = ("image", "column_px", "row_px", "radius_px")
# labels are whole tenths of a millimetre; a disagreement beyond rounding is one
_SAME_DIAMETER_MM = 1e-3


@dataclass(frozen=True, slots=True)
class BallPressFolder:
    """What a folder gave: captures of the presses, and what was left out of it and why."""

    captures: tuple[TactileCapture, ...]
    left_out: tuple[str, ...]


def read_ball_presses(folder: Path, mm_per_px: float, ball_diameter_mm: float | None = None) -> BallPressFolder:
    """Read a folder of ball presses; presses without a label are left out.

    Parameters
    ----------
    folder
        Holds background.png (or .jpg), and catalog.csv or circles.csv.
    mm_per_px
        Side of a pixel on the gel.
    ball_diameter_mm
        Of the ball; a catalog may give it for each press, and must then agree.

    Raises
    ------
    ImportFormatError
        When a file is missing or not what the layout says.
    """
    if not folder.is_dir():
        raise ImportFormatError(
            f"{folder}: {'is a file' if folder.exists() else 'no such folder'}; give a folder with background.png and "
            f"{CATALOG}"
        )
    background = next((folder / name for name in BACKGROUNDS if (folder / name).is_file()), None)
    if background is None:
        raise ImportFormatError(
            f"{folder}: the image without contact is missing; add it to the folder as {' or '.join(BACKGROUNDS)}"
        )
    scale = require_length(mm_per_px, "millimetres per pixel", "--mm-per-px", LARGEST_PIXEL_MM)
    if ball_diameter_mm is not None:
        require_length(ball_diameter_mm, "the ball's diameter", "--ball-diameter-mm")
    left_out: list[str] = []
    if (folder / CATALOG).is_file():
        presses = _catalogued(folder, ball_diameter_mm, left_out)
    elif (folder / CIRCLES).is_file():
        presses = _circled(folder, ball_diameter_mm)
    else:
        raise ImportFormatError(
            f"{folder}: there is neither {CATALOG} (gs_sdk) nor {CIRCLES}; add one of them "
            f"(docs/how-to/exchange-with-taxim.md)"
        )
    if not presses:
        raise ImportFormatError(f"{folder}: contains no labelled press; label the contact circles first")
    captures = press_captures(presses, read_rgb(background), scale, f"ball presses of '{folder.resolve().name}'")
    return BallPressFolder(tuple(captures), tuple(left_out))


@dataclass(frozen=True, slots=True)
class SourcedCircle:
    """A contact circle, and whether a person drew it or a search found it."""

    circle: ContactCircle
    source: Literal["label", "search"]


def read_circles(path: Path) -> dict[str, SourcedCircle]:
    """Return image name -> contact circle of a CSV file (image, column_px, row_px, radius_px, optionally source).

    Raises
    ------
    ImportFormatError
        When it is missing or not such a file, a radius is not above zero, the source is neither label nor search, or
        an image comes twice.
    """
    circles: dict[str, SourcedCircle] = {}
    for line, row in _rows(path, _CIRCLE_COLUMNS):
        image = str(_inside(row["image"], path, line))
        column, at_row, radius = (_number(row[name], name, path, line) for name in _CIRCLE_COLUMNS[1:])
        if radius <= 0.0 or image in circles:
            fault = f"radius_px = {radius:g} must be above 0" if radius <= 0.0 else f"{image} already has a circle"
            raise ImportFormatError(f"{path}, line {line}: {fault}; correct the line")
        name = "told_by" if "told_by" in row else "source"  # its name before
        source = str(row.get(name, "")).strip() or "label"
        if source not in ("label", "search"):
            raise ImportFormatError(f"{path}, line {line}: {name} must be 'label' or 'search', got {source!r}")
        found = ContactCircle(row_px=at_row, column_px=column, radius_px=radius)
        circles[image] = SourcedCircle(found, "search" if source == "search" else "label")
    return circles


def _catalogued(folder: Path, ball_diameter_mm: float | None, left_out: list[str]) -> list[BallPress]:
    """Return the labelled presses of a gs_sdk catalog."""
    presses, seen = [], set[PurePosixPath]()
    for line, row in _rows(folder / CATALOG, (_FOLDER,)):
        name = _inside(row[_FOLDER], folder / CATALOG, line)
        if name in seen:
            raise ImportFormatError(
                f"{folder / CATALOG}, line {line}: the press {name} is listed twice, so that it would count as two; "
                "remove the line"
            )
        seen.add(name)
        label = folder / name / "label.npz"
        if not label.is_file():
            left_out.append(f"{name}: has no label.npz and so no contact circle")
            continue
        arrays, pickled = read_npz(label)
        centre = require_array(arrays, pickled, "center", 1, label)
        radius = require_array(arrays, pickled, "radius", 0, label)
        if centre.shape != (2,):
            raise ImportFormatError(f"{label}: 'center' must be (x, y), got shape {centre.shape}")
        diameter = _diameter(row.get(_DIAMETER), ball_diameter_mm, f"{folder / CATALOG}, line {line}")
        rgb = read_rgb(folder / name / "gelsight.png")
        presses.append(BallPress(str(name), rgb, float(centre[1]), float(centre[0]), float(radius), diameter))
    return presses


def _circled(folder: Path, ball_diameter_mm: float | None) -> list[BallPress]:
    """Return the presses of a list of circles."""
    path = folder / CIRCLES
    diameter = require_length(ball_diameter_mm, "the ball's diameter", "--ball-diameter-mm")
    return [
        BallPress(image, read_rgb(folder / image), of.circle.row_px, of.circle.column_px, of.circle.radius_px, diameter)
        for image, of in read_circles(path).items()
    ]


def _rows(path: Path, needed: tuple[str, ...]) -> list[tuple[int, dict[str, str]]]:
    """Return (line, values by column) of a CSV file."""
    columns, cells = read_csv(path, "a CSV file", ImportFormatError, skip_space=True)
    rows = [(line, dict(zip_longest(columns, row[: len(columns)], fillvalue=""))) for line, row in cells]
    if len(rows) > MOST_PRESSES:
        raise ImportFormatError(
            f"{path}: lists {len(rows)} presses, but at most {MOST_PRESSES} can be read; split the file"
        )
    missing = [name for name in needed if name not in columns]
    if missing:
        raise ImportFormatError(
            f"{path}: the first line must name the columns {', '.join(needed)}, but {', '.join(missing)} is missing"
        )
    return rows


def _inside(name: str, path: Path, line: int) -> PurePosixPath:
    """Return a path within the folder; catalogs written on Windows have backslashes."""
    inner = PurePosixPath(name.strip().replace("\\", "/"))
    if not inner.parts or inner.is_absolute() or ".." in inner.parts or ":" in inner.parts[0]:
        raise ImportFormatError(f"{path}, line {line}: {name!r} must be a path within the folder")
    return inner


def _diameter(stated: str | None, given_mm: float | None, where: str) -> float:
    """Return the ball's diameter, of the catalog or of the user; both must agree."""
    if not stated:
        return require_length(given_mm, "the ball's diameter", "--ball-diameter-mm")
    try:
        diameter = finite_number(stated)
    except ValueError:
        raise ImportFormatError(f"{where}: {_DIAMETER} must be a number in mm, got {stated!r}") from None
    require_length(diameter, f"{where}: {_DIAMETER}", "--ball-diameter-mm")
    if given_mm is not None and abs(diameter - given_mm) > _SAME_DIAMETER_MM:
        raise ImportFormatError(
            f"{where}: the catalog states a ball of {diameter:g} mm, but --ball-diameter-mm is {given_mm:g} "
            "mm; leave the option out, or correct the catalog"
        )
    return diameter


def _number(text: str, name: str, path: Path, line: int) -> float:
    """Return a finite number of a CSV file."""
    try:
        return finite_number(text)
    except ValueError:
        raise ImportFormatError(f"{path}, line {line}: {name} must be a number, got {text!r}") from None


Arrays = dict[str, NDArray[Any]]


def read_npz(path: Path) -> tuple[Arrays, tuple[str, ...]]:
    """Return the arrays of an npz file by name, and the names of its pickled ones, which are left out.

    What else lies in the file, such as a text, is left out too.

    Raises
    ------
    ImportFormatError
        When the file is missing, damaged or no npz file.
    """
    if not path.exists():
        raise ImportFormatError(f"{path}: no such file, but the folder must contain it")
    return storage.read_npz(path, "an npz file", ImportFormatError)


def require_array(
    arrays: Mapping[str, NDArray[Any]], pickled: tuple[str, ...], name: str, dims: int, path: Path
) -> NDArray[Any]:
    """Return an array of numbers of so many dimensions.

    Raises
    ------
    ImportFormatError
        When it is missing, pickled, not finite numbers, or has other dimensions.
    """
    if name in pickled:
        raise ImportFormatError(
            f"{path}: {name!r} is stored as pickled objects, which are never loaded; have its owner save it again as a "
            "plain array (numpy.savez with equal shapes)"
        )
    if name not in arrays:
        raise ImportFormatError(
            f"{path}: array {name!r} is missing; the file contains {', '.join(sorted(arrays)) or 'nothing'}"
        )
    array = arrays[name]
    if array.dtype.kind not in "uif" or array.ndim != dims or not np.isfinite(array).all():
        raise ImportFormatError(
            f"{path}: {name!r} must be an array of finite numbers with {dims} dimensions, got {array.dtype} of shape "
            f"{array.shape}"
        )
    return array


DATA_PACK: Final = "dataPack.npz"
PARAMETERS: Final = "params.json"
BALL_DIAMETER_MM: Final = 4.0
"""Of the ball that Taxim's own folders were made with; the folder does not say."""

_SHADOWS = "shadowTable.npz"
_NOT_NEEDED = {
    "polycalib.npz": "the shading table: it was made from the presses, and 'finray sense teach' fits a normal map to "
    "them",
    "gelmap.npy": "the height of the undeformed gel: not part of a capture",
    "real_bg.npy": "a picture without contact: f0 of dataPack.npz is used instead",
    "bg.jpg": "a picture without contact: f0 of dataPack.npz is used instead",
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
        raise ImportFormatError(
            f"{folder}: {'is a file' if folder.exists() else 'no such folder'}; give a Taxim calibration folder, with "
            f"{DATA_PACK} in it"
        )
    path = folder / DATA_PACK
    arrays, pickled = read_npz(path)
    no_contact = _image(require_array(arrays, pickled, "f0", 3, path), "f0", path)
    if "imgs" not in arrays and "imgs" not in pickled:
        raise ImportFormatError(
            f"{path}: contains only the image without contact, but no presses ('imgs'). Taxim can render with it, but "
            "there is nothing to compare with; ask its owner for the folder of presses from which the table was made"
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
    assumed = [] if ball_diameter_mm is not None else [f"a ball of {diameter:g} mm diameter, as in Taxim's own folders"]
    return TaximFolder(tuple(captures), _left_out(folder, pickled), tuple(assumed))


def _presses(arrays: Arrays, pickled: tuple[str, ...], path: Path, ball_diameter_mm: float) -> list[BallPress]:
    """Return the presses of a data pack."""
    images = require_array(arrays, pickled, "imgs", 4, path)
    centres = require_array(arrays, pickled, "touch_center", 2, path).astype(np.float64)
    radii = require_array(arrays, pickled, "touch_radius", 1, path).astype(np.float64)
    if centres.shape != (len(images), 2) or radii.shape != (len(images),):
        raise ImportFormatError(
            f"{path}: 'imgs' has {len(images)} images, each of which needs a centre (x, y) and a radius, but "
            f"'touch_center' has shape {centres.shape} and 'touch_radius' has shape {radii.shape}"
        )
    return [
        BallPress(f"press {k}", _image(image, "imgs", path), float(y), float(x), float(radius), ball_diameter_mm)
        for k, (image, (x, y), radius) in enumerate(zip(images, centres, radii, strict=True), start=1)
    ]


def _image(bgr: NDArray[Any], name: str, path: Path) -> NDArray[np.uint8]:
    """Return a stored image in RGB order."""
    if bgr.shape[2] != 3 or bgr.dtype != np.uint8:
        raise ImportFormatError(
            f"{path}: {name!r} must contain 8-bit colour images (rows, columns, 3), got {bgr.dtype} of shape "
            f"{bgr.shape}"
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
            raise TypeError(f"is {found!r}, which is not a number")
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
