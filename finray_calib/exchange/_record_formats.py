"""Records as other programs take and bring them: an xarray Dataset, JUnit XML of a check, a zip archive of captures.

A Dataset has named dimensions, coordinates and units. An acceptance report becomes one test case for each check, for
continuous-integration servers. The layout of an archive of captures is a standard that others can write without this
program: docs/reference/tactile-captures.md. A package outside the tree may bring a format of captures: an entry point
of the group ``finray_calib.import_formats``, whose module has ``read_capture(folder)`` (:class:`ImportFormat`).
"""

import hashlib
import importlib.util
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, Final, Protocol, get_args
from xml.etree.ElementTree import Element, SubElement, indent, tostring

import numpy as np

from data_schemas import (
    AcceptanceReport,
    ArraySpec,
    CheckResult,
    CheckVerdict,
    ImportFormatError,
    MissingExtraError,
    PlugInKind,
    Provenance,
    Record,
    RecordError,
    SimulatedPress,
    StudyResult,
    TactileCapture,
    find_plug_in,
)
from data_schemas.storage import MANIFEST_NAME, digest_as_read, files_in, folder_at, read_bytes, read_json, read_record
from finray_calib.acceptance import value_text

if TYPE_CHECKING:
    from xarray import Dataset


CHANNELS = ("red", "green", "blue")
AXES = ("x", "y", "z")
UNITS_OF_VECTORS = frozenset({"mm", "N", "N mm", "deg", "MPa"})
UNIT_VECTORS = frozenset({"normal"})
GRID_UNITS = "nm|deg|mm|s"


def record_dataset(record: Record) -> "Dataset":
    """Return the arrays of a record; numbers and words of it become attributes.

    Red, green and blue of a filter or a pixel lie along "channel", the components of places, normals, forces and turns
    along "axis"; another dimension of fixed length N without a name is "axis_N". A dimension that has the name of an
    array of the record, such as "channel" of pixel signals, is "channel_axis". An array along one dimension that is
    named after it (`wavelength_nm` along "wavelength", `grid_deg`) is its coordinate.

    Parameters
    ----------
    record
        Any record with arrays.

    Raises
    ------
    RecordError
        It holds no array.
    MissingExtraError
        xarray is not installed.
    """
    try:
        from xarray import Dataset
    except ImportError:
        raise MissingExtraError("to_xarray needs xarray; install it with pip install 'finray-calib[netcdf]'") from None
    variables: dict[str, Any] = {}
    coordinates: dict[str, Any] = {}
    fields = type(record).model_fields
    arrays = {name: value for name in fields if isinstance(value := getattr(record, name), np.ndarray)}
    named = getattr(record, "channels", None)  # of some records an array, of others their names
    labels = {"channel": named if isinstance(named, tuple) else CHANNELS, "axis": AXES}
    for name, value in arrays.items():
        field = fields[name]
        spec = _spec(field.annotation, field.metadata)
        unit = "1" if spec is None else "1/nm" if spec.unit == "1" and name.endswith("_per_nm") else spec.unit
        dims = _dims(spec.dims if spec is not None else (), value.shape, name, unit)
        dims = tuple(f"{dim}_axis" if dim in arrays else dim for dim in dims)
        attributes = {"units": unit}
        if field.description:
            attributes["long_name"] = field.description
        is_grid = len(dims) == 1 and re.fullmatch(rf"({re.escape(dims[0])}s?|grid)_({GRID_UNITS})", name) is not None
        (coordinates if is_grid else variables)[name] = (dims, value, attributes)
        for dim in dims:
            if (names := labels.get(dim.removesuffix("_axis"))) is not None:
                coordinates[dim] = ((dim,), np.array(names), {})
    if not variables:
        raise RecordError(
            f"this record ({type(record).__name__}) has no array that xarray could hold; read its fields instead, "
            "which are plain numbers and words"
        )
    return Dataset(variables, coords=coordinates, attrs=_attributes(record))


def study_dataset(result: StudyResult) -> "Dataset":
    """Return the table of a design study: numbers and their 95 % limits along "point", and what each point changes.

    A number that a point lacks is NaN. A varied field is a coordinate of its name.

    Parameters
    ----------
    result
        From ``finray study run``.

    Raises
    ------
    MissingExtraError
        xarray is not installed.
    """
    try:
        from xarray import Dataset
    except ImportError:
        raise MissingExtraError("a Dataset needs xarray; install it with pip install 'finray-calib[netcdf]'") from None
    variables: dict[str, Any] = {}
    for first in {metric.name: metric for row in result.points for metric in row.metrics}.values():
        of_point = [next((m for m in row.metrics if m.name == first.name), None) for row in result.points]
        for ending, end in (("", "value"), ("_low95", "low95"), ("_high95", "high95")):
            known = [None if metric is None else getattr(metric, end) for metric in of_point]
            if end != "value" and all(value is None for value in known):
                continue
            numbers = np.array([np.nan if value is None else value for value in known])
            words = first.meaning if end == "value" else f"{end.removesuffix('95')} 95 % limit of {first.name}"
            variables[first.name + ending] = ("point", numbers, {"units": first.unit, "long_name": words})
    coordinates: dict[str, Any] = {"point": [row.number for row in result.points]}
    for field in result.varied:
        values = [row.changes[field] for row in result.points]
        is_number = all(isinstance(value, int | float) for value in values)
        coordinates[field] = ("point", np.array(values, dtype=float if is_number else str))
    origin = {} if result.provenance is None else {"command": result.provenance.command}
    return Dataset(variables, coords=coordinates, attrs={"name": result.name, "about": result.about, **origin})


def study_netcdf(result: StudyResult) -> bytes | None:
    """Return :func:`study_dataset` as netCDF; None where the packages of the extra "netcdf" are not installed."""
    if any(importlib.util.find_spec(package) is None for package in ("xarray", "h5netcdf", "h5py")):
        return None
    with TemporaryDirectory() as folder:
        file = Path(folder) / "table.nc"
        study_dataset(result).to_netcdf(file, engine="h5netcdf")
        return file.read_bytes()


def _spec(annotation: Any, metadata: Iterable[Any] = ()) -> ArraySpec | None:
    """Return what is declared of an array, also of one that may be missing."""
    for item in (*metadata, *getattr(annotation, "__metadata__", ())):
        if isinstance(item, ArraySpec):
            return item
    return next((spec for inner in get_args(annotation) if (spec := _spec(inner)) is not None), None)


def _dims(names: tuple[str, ...], shape: tuple[int, ...], field: str, unit: str) -> tuple[str, ...]:
    """Return one name for each dimension of a field, no name twice."""
    found: list[str] = []
    for place, size in enumerate(shape):
        name = names[place] if place < len(names) else str(size)
        if name.isdigit():
            is_vector = (unit in UNITS_OF_VECTORS or field in UNIT_VECTORS) and place == len(shape) - 1
            of_light = field == "channels" or (found and found[-1] in {"filter", "column"})
            of_three = "axis" if is_vector else "channel" if of_light else "axis_3"
            name = of_three if name == "3" else f"axis_{name}"
        found.append(name if name not in found else f"{name}_{place}")
    return tuple(found)


def _attributes(record: Record) -> dict[str, Any]:
    """Return kind, numbers and words of a record, as netCDF attributes know them."""
    plain = {
        name: int(value) if isinstance(value, bool) else value
        for name in type(record).model_fields
        if isinstance(value := getattr(record, name), bool | int | float | str)
    }
    return {"kind": type(record).__name__, **plain}


_CHILD: Final[dict[CheckVerdict, str]] = {"FAIL": "failure", "ERROR": "error", "UNDECIDED": "skipped"}
_NOT_IN_XML: Final = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")
"""Characters that XML 1.0 cannot hold, as a garbled answer of a device may."""


def junit_xml(report: AcceptanceReport, origin: Provenance) -> bytes:
    """Return the report as JUnit XML: FAIL is a failure, ERROR an error, UNDECIDED is skipped with its reason.

    Parameters
    ----------
    report
        The report.
    origin
        When and with what it was made.
    """
    found = Counter(result.verdict for result in report.results)
    count = {"tests": len(report.results), "failures": found["FAIL"], "errors": found["ERROR"]}
    counted = {name: str(number) for name, number in count.items()}
    root = Element("testsuites", {"name": "finray check", **counted})
    suite = SubElement(root, "testsuite", {"name": _plain(report.rig.name), **counted})
    suite.set("skipped", str(found["UNDECIDED"]))
    suite.set("timestamp", origin.created_utc)
    properties = SubElement(suite, "properties")
    for name, value in (
        ("check", report.plan.check_name),
        ("verdict", report.verdict),
        ("finray-calib", origin.package_version),
    ):
        SubElement(properties, "property", {"name": name, "value": _plain(value)})
    for result in report.results:
        _add_case(suite, result)
    indent(root)
    return bytes(tostring(root, encoding="utf-8", xml_declaration=True)) + b"\n"


def _add_case(suite: Element, result: CheckResult) -> None:
    """Add the test case of one check."""
    group = f"finray.check.{result.section.replace(' ', '_')}"
    case = SubElement(suite, "testcase", {"classname": group, "name": _plain(result.name)})
    words = (result.what, value_text(result), f"allowed: {result.limit}" if result.limit else "", result.evidence)
    if result.verdict == "PASS":
        SubElement(case, "system-out").text = _plain("\n".join(word for word in words if word))
        return
    message = "; ".join(word for word in words[1:] if word)
    child = SubElement(case, _CHILD[result.verdict], {"message": _plain(message)})
    if result.verdict != "UNDECIDED":
        child.set("type", result.verdict)
    child.text = _plain("\n".join(word for word in words if word))


def _plain(text: str) -> str:
    """Return text with what XML cannot hold replaced."""
    return _NOT_IN_XML.sub("\N{REPLACEMENT CHARACTER}", text)


CAPTURE: Final = ".capture.json"
PRESS: Final = ".press.json"
_BESIDE: Final = re.compile(r"contacts\.png|circles\.csv|(readme|licen[cs]e|copying)[\w.-]*", re.IGNORECASE)


@dataclass(frozen=True, slots=True)
class CaptureContainer:
    """What of a folder goes into a container.

    Attributes
    ----------
    captures
        Number of captures.
    presses
        Number of simulated presses.
    files
        All files, in the order of the archive; the checksums come after them.
    left_out
        Files that belong to no capture and no press.
    """

    captures: int
    presses: int
    files: tuple[Path, ...]
    left_out: tuple[Path, ...]

    def contents(self) -> Iterator[tuple[str, bytes]]:
        """Yield name and content of each file, one after the other, and last the checksums of all."""
        lines = []
        for path in self.files:
            content = read_bytes(path)
            lines.append(f"{hashlib.sha256(content).hexdigest()}  {path.name}\n")
            yield path.name, content
        yield MANIFEST_NAME, "".join(lines).encode()


def capture_container(place: Path) -> CaptureContainer:
    """Return which files of a folder go into a container, after every record in it was read and found complete.

    Captures and simulated presses go in with their arrays, and what belongs to all: the picture of the contacts, the
    list of circles, texts named README or LICENSE.

    Parameters
    ----------
    place
        Folder of NAME.capture.json.

    Raises
    ------
    RecordError
        It is not a folder or holds no capture.
    FinrayError
        A record in it is damaged.
    """
    folder = folder_at(place)
    inside = [] if folder is None else [path for path in files_in(folder) if not path.name.startswith(".")]
    captures = [path for path in inside if path.name.endswith(CAPTURE)]
    presses = [path for path in inside if path.name.endswith(PRESS)]
    if not captures:
        raise RecordError(
            f"{place}: contains no NAME{CAPTURE}; give a folder of captures, as 'finray import captures' writes it"
        )
    for path in captures:
        read_record(path, TactileCapture)
    for path in presses:
        read_record(path, SimulatedPress)
    records = [*captures, *presses]
    wanted = {*records, *_arrays(records), *(path for path in inside if _BESIDE.fullmatch(path.name))}
    left_out = tuple(path for path in inside if path not in wanted and path.name != MANIFEST_NAME)
    return CaptureContainer(len(captures), len(presses), tuple(sorted(wanted)), left_out)


def _arrays(records: Sequence[Path]) -> Iterator[Path]:
    """Yield the files that hold the arrays of records which were read."""
    for path in records:
        array_file = read_json(path).get("array_file")
        if array_file is not None:
            yield path.with_name(str(array_file["file"]))


IMPORT_FORMATS: Final = PlugInKind(
    "format",
    "finray_calib.import_formats",
    ("read_capture(folder)",),
    ImportFormatError,
    "docs/how-to/import-captures.md",
)


class ImportFormat(Protocol):
    """What the module of a format has."""

    def read_capture(self, folder: Path) -> TactileCapture:
        """Return the capture of one press from a folder, whose files are read by :mod:`data_schemas.storage`."""
        ...


def capture_by_package(name: str, folder: Path) -> TactileCapture:
    """Read a capture by a format of another package.

    Parameters
    ----------
    name
        The format's, as its entry point has it.
    folder
        Of one press.

    Raises
    ------
    ImportFormatError
        No package, or several, offer the format; its module cannot be imported, lacks ``read_capture`` or fails; what
        it returns is no capture, or is of no file that was read by :mod:`data_schemas.storage`.
    """
    plug_in = find_plug_in(IMPORT_FORMATS, name)
    if not folder.is_dir():
        raise ImportFormatError(
            f"{folder}: {'is a file' if folder.exists() else 'no such folder'}; give the folder of one press"
        )
    module: Any = plug_in.load()
    capture = plug_in.call(lambda: module.read_capture(folder), f"{folder}: ")
    if not isinstance(capture, TactileCapture):
        raise plug_in.refusal(
            f"returns a {type(capture).__name__}, but a data_schemas.TactileCapture is needed", f"{folder}: "
        )
    if not any(digest_as_read(file) is not None for file in folder.rglob("*")):
        raise plug_in.refusal(
            "did not read any file of the folder through data_schemas.storage (read_bytes, read_npy, tiff_image), so "
            "the record could not name its sources", f"{folder}: ",
        )  # fmt: skip
    return capture
