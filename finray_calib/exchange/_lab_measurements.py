"""What a lab measures beside its captures: forces, band signals, filters, detectors, pictures of a calibration board.

The CSV of a force has comment lines that start with #, one header row, and units in its names; that of band signals may
have commas, tabs or semicolons between its columns, and an empty one is written as a template. Pictures of a board are
read as grey levels; the calibration made of them leaves as OpenCV's programs read it.
"""

import difflib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from data_schemas import (
    BadFrameError,
    BandPassFilter,
    CameraCalibration,
    CompareError,
    CurveError,
    FieldError,
    FilterWheelSettings,
    ImportedFilter,
    ImportFormatError,
    LaserSettings,
    RigFile,
    SpectralCurve,
    half_maximum_nm,
)
from data_schemas.storage import finite_number, read_csv, read_filter_curve, read_table, read_toml, tiff_image
from finray_calib.exchange._set_files import TIFF_STARTS
from finray_calib.force import MeasuredForce
from rigs.cameras import decoded_picture, read_content, read_raw

NEEDED: Final = ("displacement_mm", "force_n")
#: Of the range of displacements: less is the jitter of a gauge.
_BACK_REL: Final = 0.05
OPTIONAL: Final = ("force_uncertainty_n", "displacement_uncertainty_mm")


def read_force_csv(path: Path) -> MeasuredForce:
    """Read a measured loading curve.

    Rows in the order of the measurement, loading only. Columns in any order: displacement_mm of the indenter along the
    pad's normal and force_n that pushes it back; if known, force_uncertainty_n and displacement_uncertainty_mm
    (standard uncertainties, independent between rows).

    Raises
    ------
    ImportFormatError
        The file is missing or no table of finite numbers, or a column is missing, doubled or unknown.
    CompareError
        There are too few points, an uncertainty is negative, the force pulls, or the indenter goes back.
    """
    try:
        header, table = read_table(path)
    except CurveError as error:
        raise ImportFormatError(str(error)) from None
    # a byte order mark that came under a comment
    header = [name.removeprefix("\ufeff").lower() for name in header]
    allowed = f"required columns are {', '.join(NEEDED)}; {', '.join(OPTIONAL)} are also allowed"
    unknown = [name for name in header if name not in {*NEEDED, *OPTIONAL}]
    if unknown:
        raise ImportFormatError(
            f"{path}: column '{unknown[0][:60]}' is not supported; {allowed}. Give mm and N, separated by commas"
        )
    missing = [name for name in NEEDED if name not in header]
    if missing:
        raise ImportFormatError(f"{path}: has no column '{missing[0]}'; {allowed}")
    if len(set(header)) < len(header):
        raise ImportFormatError(f"{path}: a column appears twice; {allowed}")
    columns = dict(zip(header, table.T, strict=True))
    _require_loading(path, columns["displacement_mm"])
    return MeasuredForce(
        path.name,
        columns["displacement_mm"],
        columns["force_n"],
        columns.get("force_uncertainty_n"),
        columns.get("displacement_uncertainty_mm"),
    )


def _require_loading(path: Path, displacement_mm: NDArray[np.float64]) -> None:
    """Refuse rows in which the indenter goes back: rubber pushes less on the way out."""
    deepest = np.maximum.accumulate(displacement_mm)
    back = np.flatnonzero(deepest - displacement_mm > _BACK_REL * np.ptp(displacement_mm))
    if back.size:
        row = int(back[0])
        raise CompareError(
            f"{path}: row {row + 1} below the header has a displacement of {displacement_mm[row]:g} mm after "
            f"{deepest[row]:g} mm, so the indenter moves back, and the force is lower than in loading. Leave out the "
            "rows of unloading; if all rows are of loading, sort them by displacement_mm"
        )


RAW_SUFFIXES = (".dng",)


def read_board_picture(path: Path, monochrome: bool = False) -> NDArray[np.uint8]:
    """Return a picture as grey levels of 8 bits (H, W), stretched to its own range.

    DNG, TIFF, PNG or JPEG. One number of 16 bits per pixel is taken for raw Bayer counts (RGGB), unless `monochrome`;
    of 8 bits for grey.

    Raises
    ------
    ImportFormatError
        The file is missing, is not a picture, or shows nothing.
    """
    try:
        image = read_raw(path) if path.suffix.lower() in RAW_SUFFIXES else _decoded(path)
    except BadFrameError as error:
        raise ImportFormatError(str(error)) from None
    if image.ndim == 3 and image.shape[2] in (3, 4):
        levels = image[..., :3].astype(np.float64).mean(axis=2)
    elif image.ndim == 2 or image.shape[2] == 1:
        plane = image if image.ndim == 2 else image[..., 0]
        raw = plane.dtype == np.uint16 and not monochrome
        levels = (cv2.cvtColor(plane, cv2.COLOR_BayerRGGB2GRAY) if raw else plane).astype(np.float64)
    else:
        raise ImportFormatError(
            f"{path}: has {image.shape[2]} values per pixel, but must have 1 (raw or grey), or 3 or 4 (colour)"
        )
    low, high = float(levels.min()), float(levels.max())
    if high <= low:
        raise ImportFormatError(
            f"{path}: every pixel has the same value ({low:g}), so it shows no board; give a picture of the board"
        )
    return np.asarray(np.rint((levels - low) / (high - low) * 255.0), dtype=np.uint8)


def calibration_yaml(calibration: CameraCalibration) -> bytes:
    """Return a calibration as cv2.FileStorage writes it, which `camera.calibration` of a design reads."""
    (fx, fy), (cx, cy) = calibration.focal_px, calibration.centre_px
    storage = cv2.FileStorage("", cv2.FILE_STORAGE_WRITE | cv2.FILE_STORAGE_MEMORY | cv2.FILE_STORAGE_FORMAT_YAML)
    storage.write("image_width", calibration.width_px)
    storage.write("image_height", calibration.height_px)
    storage.write("camera_matrix", np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]]))
    storage.write("distortion_coefficients", np.array([calibration.distortion]))
    storage.write("distortion_model", calibration.model)
    text: str = storage.releaseAndGetString()
    return text.encode()


def _decoded(path: Path) -> NDArray[np.uint8] | NDArray[np.uint16]:
    """Return the numbers of a TIFF, PNG or JPEG."""
    content = read_content(path)
    tiff = content[:4] in TIFF_STARTS
    image = tiff_image(content, path, ImportFormatError) if tiff else decoded_picture(content, path, ImportFormatError)
    if image.dtype not in (np.uint8, np.uint16):
        raise ImportFormatError(
            f"{path}: has {image.dtype} pixels, which are not supported; save the picture with unsigned integers of 8 "
            "or 16 bits"
        )
    return np.asarray(image)


Floats = NDArray[np.float64]
CHANNELS: Final = ("red", "green", "blue")
# Noise of 64 filters goes 4 below 0 once in five hundred tables; a dark that drifted adds as much again.
LARGEST_DEFICIT_SD: Final = 10.0
READINGS: Final = ("paint_laser", "white_laser", "paint_lamp", "white_lamp", "dark")
RATIOS: Final = ("fluorescence", "reflectance")
FILTER_DATA: Final = (
    "center_nm",
    "fwhm_nm",
    "center_uncertainty_nm",
    "fwhm_uncertainty_nm",
    "blocking_od",
    "blocking_uncertainty_od",
)
_TEXTS: Final = ("filter", "channel", "curve")
_VALUES: Final = (*READINGS, *RATIOS)
_COLUMNS: Final = (*_TEXTS, *FILTER_DATA, *(f"{name}{end}" for name in _VALUES for end in ("", "_sd")), "laser_weight")

# Beyond any unit of a detector; the fourth power of their ratio is still a number.
_SMALLEST, _LARGEST = 1e-18, 1e18


class SignalRow(NamedTuple):
    """One row of a table of band signals: its line, its texts, and its numbers by column, without empty cells."""

    line: int
    filter_name: str
    channel: str
    curve: str
    numbers: dict[str, float]


@dataclass(frozen=True, slots=True)
class SignalTable:
    """A table of band signals whose cells were checked."""

    path: Path
    header: tuple[str, ...]
    rows: tuple[SignalRow, ...]

    @property
    def channels(self) -> tuple[str, ...]:
        """Names of the channels; one without a name where the table has no column of them."""
        return CHANNELS if "channel" in self.header else ("",)

    @property
    def describes_filters(self) -> bool:
        """Whether the table itself says what its filters are."""
        return bool({"curve", "center_nm"} & {*self.header})

    @property
    def names(self) -> list[str]:
        """Names of the filters in the order of the rows."""
        return list(dict.fromkeys(row.filter_name for row in self.rows))

    def has(self, name: str) -> bool:
        """Whether any row has a number in this column."""
        return any(name in row.numbers for row in self.rows)

    def column(self, name: str, filters: Sequence[BandPassFilter]) -> Floats:
        """Return the numbers of a column by filter and channel, (B, C); NaN where there is none."""
        found = {(row.filter_name, row.channel): row.numbers.get(name, np.nan) for row in self.rows}
        return np.array([[found.get((band.name, channel), np.nan) for channel in self.channels] for band in filters])


def signal_template(rig: Path | None = None, channels: int = 1) -> str:
    """Return an empty table (CSV) with the filters of a rig file, or with columns that describe filters.

    Parameters
    ----------
    rig
        Rig file.
    channels
        1 for a photodiode or a monochrome camera, 3 for a colour camera.
    """
    filters = () if rig is None else read_toml(rig, RigFile).filter_wheel.filters
    texts = ["filter", *(["channel"] if channels > 1 else []), *([] if filters else ["center_nm", "fwhm_nm"])]
    columns = [*texts, *(f"{name}{end}" for name in READINGS for end in ("", "_sd"))]
    colours = [[name] for name in CHANNELS] if channels > 1 else [[]]
    cells = [[band.name, *colour] for band in filters for colour in colours]
    rows = [",".join([*map(_quoted, row), *[""] * (len(columns) - len(row))]) for row in cells]
    return "".join(f"{line}\n" for line in (*_TEMPLATE_LINES, ",".join(columns), *rows))


# No comma, semicolon or quote: a spreadsheet that saves the table again leaves such lines as they are.
_TEMPLATE_LINES: Final = (
    "# Band signals of one paint: one row for each filter. Any unit that is the same in all rows.",
    "# paint_laser: paint under the laser. white_laser: white reference under the laser (only at the laser's filter).",
    "# paint_lamp and white_lamp: paint and white reference under the lamp. dark: reading without light.",
    "# Columns that end in _sd hold the standard uncertainty in the same unit. Leave empty what was not measured.",
)


def _quoted(text: str) -> str:
    """Return a cell of a CSV file."""
    quoted = text.replace('"', '""')
    # a row that begins with # would be a comment
    return f'"{quoted}"' if any(mark in text for mark in ',;"\t') or text.startswith("#") else text


def read_signal_cells(path: Path) -> SignalTable:
    """Read the cells and refuse what is no number, and columns and rows that do not belong together."""
    what = "a CSV file of band signals"
    names, lines = read_csv(
        path, what, ImportFormatError, comments=True, skip_space=True, other_marks=True, names=_TEXTS
    )
    if not names:
        raise ImportFormatError(f"{path}: is empty; give a header row and one row for each filter")
    width = max((k for k, name in enumerate(names, 1) if name), default=0)  # a spreadsheet may add empty columns
    lone = next((line for line, cells in lines if any(cell.strip() for cell in cells[width:])), None)
    if lone is not None:
        raise ImportFormatError(
            f"{path}, line {lone}: has a value in a column without a name; name or remove the column"
        )
    # a byte order mark that came under a comment
    header = tuple(name.removeprefix("\ufeff").lower() for name in names[:width])
    _check_columns(path, header)
    rows = tuple(_row(path, header, line, cells) for line, cells in lines)
    if not rows:
        raise ImportFormatError(f"{path}: has no row below its header; give one row for each filter")
    needed = "fluorescence" if "fluorescence" in header else "paint_laser"
    if not any(needed in row.numbers for row in rows):
        raise ImportFormatError(f"{path}: the column '{needed}' is empty in all rows; fill in what was measured")
    seen: dict[tuple[str, str], int] = {}
    for row in rows:
        earlier = seen.setdefault((row.filter_name, row.channel), row.line)
        if earlier != row.line:
            of_channel = f", channel '{row.channel}'," if row.channel else ""
            raise ImportFormatError(
                f"{path}, line {row.line}: filter '{row.filter_name}'{of_channel} already stands in line {earlier}; "
                "give the mean of repeated readings in one row, with the standard uncertainty of the mean"
            )
    return SignalTable(path, header, rows)


def _check_columns(path: Path, header: Sequence[str]) -> None:
    """Refuse columns that are unknown or missing, and two that say the same."""
    readings = ", ".join((*READINGS, *RATIOS))
    if "wavelength_nm" in header:
        raise ImportFormatError(
            f"{path}: contains a curve over the wavelength (column 'wavelength_nm'), but a table of band signals is "
            "needed; give that as TABLE, and curves with --response or --lamp"
        )
    for name in header:
        if name not in _COLUMNS:
            near = difflib.get_close_matches(name, _COLUMNS, 1, cutoff=0.6)
            hint = f"did you mean '{near[0]}'?" if near else "rename or remove the column."
            raise ImportFormatError(
                f"{path}: column '{name[:60]}' is not supported; {hint} Supported are {', '.join(_TEXTS)}, "
                f"{', '.join(FILTER_DATA)}, laser_weight, and {readings}, each with its _sd"
            )
    if len(set(header)) < len(header):
        raise ImportFormatError(f"{path}: a column appears twice; remove one")
    described = next((name for name in FILTER_DATA if name in header), None)
    if described is not None and not {"curve", "center_nm"} & {*header}:
        raise ImportFormatError(
            f"{path}: has the column '{described}', but neither 'center_nm' nor 'curve', without which the filters are "
            "those of the rig file; add the column center_nm (nm) or curve (a CSV file), or remove the column"
        )
    if "filter" not in header:
        raise ImportFormatError(f"{path}: the column 'filter' is missing; give the name of the filter in each row")
    for one, other in (("paint_laser", "fluorescence"), ("paint_lamp", "reflectance")):
        if one in header and other in header:
            raise ImportFormatError(
                f"{path}: has both columns '{one}' and '{other}', which could contradict each other; remove one"
            )
    if not {"paint_laser", "fluorescence"} & {*header}:
        raise ImportFormatError(
            f"{path}: the column 'paint_laser' (paint under the laser) is missing; add it, or 'fluorescence' where the "
            "values are already referred to the white reference"
        )
    lone = next((n for n in header if n in _VALUES and f"{n}_sd" not in header), None)
    if lone is not None:
        raise ImportFormatError(
            f"{path}: the column '{lone}_sd' is missing; add the standard uncertainty of '{lone}', in the same unit"
        )


def _row(path: Path, header: Sequence[str], line: int, cells: Sequence[str]) -> SignalRow:
    """Check the cells of one row."""
    by_name = {name: cell.strip() for name, cell in zip(header, cells, strict=False)}
    if not by_name.get("filter"):
        raise ImportFormatError(f"{path}, line {line}: the column 'filter' is empty; give the filter's name")
    channel = by_name.get("channel", "").lower()
    if "channel" in header and channel not in CHANNELS:
        raise ImportFormatError(
            f"{path}, line {line}, column 'channel': is '{channel[:40]}', but must be red, green or blue; remove the "
            "column if the detector has one channel"
        )
    numbers = {name: _number(path, line, name, cell) for name, cell in by_name.items() if cell and name not in _TEXTS}
    for name in _VALUES:
        sd = numbers.get(f"{name}_sd")
        if name in numbers and sd is None:
            raise ImportFormatError(
                f"{path}, line {line}: has a value in the column '{name}', but none in '{name}_sd'; give its standard "
                "uncertainty, in the same unit"
            )
        if name in numbers and sd == 0 and name in ("paint_laser", "paint_lamp", *RATIOS):
            raise ImportFormatError(
                f"{path}, line {line}, column '{name}_sd': is 0, but must be above 0, because every reading has noise; "
                f"give the standard uncertainty of '{name}', in the same unit"
            )
    _require_light(f"{path}, line {line}", numbers)
    return SignalRow(line, by_name["filter"], channel, by_name.get("curve", ""), numbers)


def _require_light(where: str, numbers: Mapping[str, float]) -> None:
    """Refuse a value of the paint that lies below 0 by more than noise."""
    for name in ("paint_laser", "paint_lamp", *RATIOS):
        is_dark = name in READINGS and "dark" in numbers
        value = numbers.get(name, 0.0) - (numbers["dark"] if is_dark else 0.0)
        sd = float(np.hypot(numbers.get(f"{name}_sd", 0.0), numbers["dark_sd"] if is_dark else 0.0))
        if name in numbers and value < -LARGEST_DEFICIT_SD * sd:
            raise ImportFormatError(
                f"{where}, column '{name}': lies {-value / sd:.3g} standard uncertainties below 0"
                f"{' once its dark is subtracted' if is_dark else ''}, but light is never negative (at most "
                f"{LARGEST_DEFICIT_SD:g} are taken for noise); correct the reading{' or its dark' if is_dark else ''}, "
                f"or give the larger uncertainty that it has in '{name}_sd'"
            )


def _number(path: Path, line: int, name: str, cell: str) -> float:
    """Return the number of a cell."""
    where = f"{path}, line {line}, column '{name}'"
    try:
        value = finite_number(cell)
    except ValueError as error:
        raise ImportFormatError(
            f"{where}: {error}; write a number such as 0.0125 or 1.25e-2, or leave the cell empty if nothing was "
            "measured"
        ) from None
    if name.endswith(("_sd", "_weight")) and value < 0:
        raise ImportFormatError(f"{where}: is {value:g}, but must be at least 0; correct the cell")
    if value != 0 and not _SMALLEST <= abs(value) <= _LARGEST:
        raise ImportFormatError(
            f"{where}: is {value:g}, but only 0 and sizes from {_SMALLEST:g} to {_LARGEST:g} are supported; choose "
            "another unit"
        )
    return value


WIDEST_LASER_NM = 60.0
"""Full width of an LED, the widest source of one line, is 15 to 40 nm; a wider one is white light or another unit."""
MOST_FILTERS = 64  # slots that a record numbers
MONOCHROME_COLUMNS = ["wavelength_nm", "response_percent"]


def require_line(place: Path, laser: LaserSettings) -> None:
    """Refuse a source that is no line; the error names the file `place`."""
    if laser.fwhm_nm > WIDEST_LASER_NM:
        raise ImportFormatError(
            f"{place}: laser.fwhm_nm is {laser.fwhm_nm:g} nm, but the excitation must be one line "
            f"of at most {WIDEST_LASER_NM:g} nm (a laser has 1 to 5 nm, an LED 15 to 40 nm); give its full width at "
            "half maximum in nm"
        )


def curve_inside(place: Path, name: str) -> Path:
    """Return the path of a curve that the file `place` names, if it lies in or below the folder of that file."""
    if not (place.parent / name).resolve().is_relative_to(place.parent.resolve()):
        raise CurveError(
            f"{place}: {name!r} points outside the folder; move the curve file into the folder of the description"
        )
    return place.parent / name


def filter_curves_of(folder: Path, filters: Iterable[ImportedFilter]) -> dict[str, SpectralCurve]:
    """Return the measured transmissions of the filters that name one, by the filter's name."""
    return {given.name: read_filter_curve(folder / given.curve) for given in filters if given.curve}


def wheel_of(
    place: Path, filters: Iterable[ImportedFilter], curves: Mapping[str, SpectralCurve]
) -> FilterWheelSettings:
    """Return the filters, with centre and width of their measured curves where they have one, as those of a wheel.

    Raises
    ------
    CurveError
        A curve holds no whole pass band, or filters are the same or too many; the error names the file `place`.
    """
    given = tuple(filters)
    if len(given) > MOST_FILTERS:
        raise CurveError(
            f"{place}: has {len(given)} filters, but at most {MOST_FILTERS} are supported; leave out some, or give "
            "wider ones"
        )
    try:
        return FilterWheelSettings(
            filters=tuple(_filter(slot, one, curves.get(one.name)) for slot, one in enumerate(given, 1))
        )
    except FieldError as error:
        fault = error.without_field
        raise CurveError(f"{place}, filters: {fault}; check that all wavelengths are in nm") from None


def _filter(slot: int, given: ImportedFilter, curve: SpectralCurve | None) -> BandPassFilter:
    """Return a filter by its nominal values, or by centre and width of its measured curve."""
    known = given.model_dump(exclude_none=True)
    if curve is not None:
        low_nm, high_nm = half_maximum_nm(curve)
        known |= {"center_nm": 0.5 * (low_nm + high_nm), "fwhm_nm": high_nm - low_nm}
    return BandPassFilter(slot=slot, **known)


def one_channel(path: Path | None) -> tuple[SpectralCurve, SpectralCurve, SpectralCurve]:
    """Return the response of a detector of one channel three times: that of a CSV file, or a flat one."""
    if path is not None:
        one = _monochrome_response(path)
    else:
        one = SpectralCurve(
            name="monochrome", wavelength_nm=np.array([380.0, 780.0]), values=np.ones(2), source="assumed flat"
        )
    return one, one, one


def _monochrome_response(path: Path) -> SpectralCurve:
    """Read the response of a monochrome camera, 0..1."""
    header, table = read_table(path)
    if header != MONOCHROME_COLUMNS:
        raise CurveError(
            f"{path}: the header is {','.join(header)[:80]}, but a monochrome response needs "
            f"{','.join(MONOCHROME_COLUMNS)}"
        )
    if (table[:, 1] < 0).any() or not table[:, 1].any():
        raise CurveError(f"{path}: response_percent must be at least 0 in every row and above 0 in one or more")
    try:
        return SpectralCurve(name="monochrome", wavelength_nm=table[:, 0], values=table[:, 1] / 100, source=path.name)
    except FieldError as error:
        raise CurveError(f"{path}: {error.without_field}") from None
