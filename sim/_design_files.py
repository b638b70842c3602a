"""The files that a design names, by their place and by their content."""

from collections.abc import Collection
from pathlib import Path
from typing import Final

from data_schemas import FingerDesign, PlainSensor, digest_of_input
from data_schemas.storage import read_bytes

_NAMED: Final = {
    "camera": ("calibration", "response"),
    "indenter": ("file",),
}
"""Part of a finger -> its fields that name a file."""
#: Words of such a field that name no file.
_NO_FILE: Final = (None, "assumed", "ideal")


def design_inputs(design: FingerDesign, path: Path) -> list[Path]:
    """Return the design's file and those of its camera."""
    return [path, *_files(design, path.parent, ["camera"]).values()]


def read_design_files(design: FingerDesign, folder: Path, parts: Collection[str] = tuple(_NAMED)) -> dict[str, Path]:
    """Read the files that parts of a design name, so that their content is known; return field -> file.

    Parameters
    ----------
    design
        The finger.
    folder
        Where relative paths in the design start.
    parts
        "camera", "indenter" or both.

    Raises
    ------
    RecordError
        A file is not there or cannot be read.
    """
    files = _files(design, folder, parts)
    for field, file in files.items():
        read_bytes(file, f"a file ({field} of the design)")
    return files


def design_digests(design: FingerDesign, folder: Path, parts: Collection[str] = tuple(_NAMED)) -> dict[str, str]:
    """Return field -> SHA-256 of the files that parts of a design name, for keys: a name may stay with another content.

    Empty where the design names none. Parameters and errors as of :func:`read_design_files`.
    """
    return {field: digest_of_input(file) for field, file in read_design_files(design, folder, parts).items()}


def _files(design: FingerDesign, folder: Path, parts: Collection[str]) -> dict[str, Path]:
    """Return field -> file of what parts of a design name."""
    named = {f"{part}.{field}": getattr(getattr(design, part), field) for part in parts for field in _NAMED[part]}
    return {field: folder / name for field, name in named.items() if name not in _NO_FILE}


def sensor_inputs(sensor: PlainSensor, path: Path) -> list[Path]:
    """Return the design's file and those that it names."""
    camera = sensor.camera
    named = [
        camera.calibration,
        camera.response,
        sensor.indenter.file if sensor.surface is None else sensor.surface.file,
    ]
    return [path, *(path.parent / name for name in named if name not in _NO_FILE)]
