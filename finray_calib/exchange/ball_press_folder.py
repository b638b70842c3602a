"""Read a folder of ball presses with a background image and labelled circles.

Two layouts: that of gs_sdk (``catalog.csv`` names a folder per press, with ``gelsight.png`` and ``label.npz`` of center
and radius), and plain images with ``circles.csv`` (image, column_px, row_px, radius_px).
"""

from dataclasses import dataclass
from itertools import zip_longest
from pathlib import Path, PurePosixPath
from typing import Final

from data_schemas.capture import ContactCircle, TactileCapture
from data_schemas.errors import ImportFormatError
from data_schemas.foreign_files import finite_number, read_csv
from finray_calib.exchange.ball_press_records import BallPress, press_captures, read_rgb, require_length
from finray_calib.exchange.plain_arrays import read_npz, require_array

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
        raise ImportFormatError(f"{folder}: no such folder; give a folder with background.png and {CATALOG}")
    background = next((folder / name for name in BACKGROUNDS if (folder / name).is_file()), None)
    if background is None:
        raise ImportFormatError(
            f"{folder}: there is no {' or '.join(BACKGROUNDS)}; the image without contact must lie there"
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
        raise ImportFormatError(f"{folder}: there is neither {CATALOG} (gs_sdk) nor {CIRCLES}; see the how-to")
    if not presses:
        raise ImportFormatError(f"{folder}: no labelled press in it; label the contact circles first")
    captures = press_captures(presses, read_rgb(background), scale, f"ball presses of '{folder.resolve().name}'")
    return BallPressFolder(tuple(captures), tuple(left_out))


def read_circles(path: Path) -> dict[str, ContactCircle]:
    """Return image name -> contact circle of a CSV file (image, column_px, row_px, radius_px).

    Raises
    ------
    ImportFormatError
        When it is missing or not such a file, a radius is not above zero, or an image comes twice.
    """
    circles: dict[str, ContactCircle] = {}
    for line, row in _rows(path, _CIRCLE_COLUMNS):
        image = str(_inside(row["image"], path, line))
        column, at_row, radius = (_number(row[name], name, path, line) for name in _CIRCLE_COLUMNS[1:])
        if radius <= 0.0 or image in circles:
            fault = f"radius_px = {radius:g} must be above 0" if radius <= 0.0 else f"{image} has a circle already"
            raise ImportFormatError(f"{path}, line {line}: {fault}; correct the line")
        circles[image] = ContactCircle(row_px=at_row, column_px=column, radius_px=radius)
    return circles


def _catalogued(folder: Path, ball_diameter_mm: float | None, left_out: list[str]) -> list[BallPress]:
    """Return the labelled presses of a gs_sdk catalog."""
    presses = []
    for line, row in _rows(folder / CATALOG, (_FOLDER,)):
        name = _inside(row[_FOLDER], folder / CATALOG, line)
        label = folder / name / "label.npz"
        if not label.is_file():
            left_out.append(f"{name}: no label.npz, so no contact circle")
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
        BallPress(image, read_rgb(folder / image), circle.row_px, circle.column_px, circle.radius_px, diameter)
        for image, circle in read_circles(path).items()
    ]


def _rows(path: Path, needed: tuple[str, ...]) -> list[tuple[int, dict[str, str]]]:
    """Return (line, values by column) of a CSV file."""
    columns, cells = read_csv(path, "a CSV file", ImportFormatError, skip_space=True)
    rows = [(line, dict(zip_longest(columns, row[: len(columns)], fillvalue=""))) for line, row in cells]
    if len(rows) > MOST_PRESSES:
        raise ImportFormatError(
            f"{path}: lists {len(rows)} presses; at most {MOST_PRESSES} are read: give a part of it"
        )
    missing = [name for name in needed if name not in columns]
    if missing:
        raise ImportFormatError(
            f"{path}: the first line must name the columns {', '.join(needed)}; {', '.join(missing)} is missing"
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
        raise ImportFormatError(f"{where}: {_DIAMETER} must be a number of mm, got {stated!r}") from None
    require_length(diameter, f"{where}: {_DIAMETER}", "--ball-diameter-mm")
    if given_mm is not None and abs(diameter - given_mm) > _SAME_DIAMETER_MM:
        raise ImportFormatError(
            f"{where}: the catalog says a ball of {diameter:g} mm, --ball-diameter-mm {given_mm:g} mm; leave the "
            "option out, or correct the catalog"
        )
    return diameter


def _number(text: str, name: str, path: Path, line: int) -> float:
    """Return a finite number of a CSV file."""
    try:
        return finite_number(text)
    except ValueError:
        raise ImportFormatError(f"{path}, line {line}: {name} must be a number, got {text!r}") from None
