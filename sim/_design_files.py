"""The file of a finger's design as every program reads it: a whole finger, or a ready-made one with numbers changed."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Final

from pydantic import BaseModel

from data_schemas import FingerDesign, RecordError, SimulateError
from data_schemas.storage import read_toml
from sim._designs import PRESETS, preset_design

OPTIONAL_TABLES: Final = ("mesh",)
"""A choice of how to compute, no part of the finger."""
FILM_MATERIAL: Final = "mechanics.film"
FILM_OF_THE_PAD: Final = "pad.film"


def read_design(path: Path) -> FingerDesign:
    """Read a finger's design (TOML).

    With ``preset = "flat-70x35"`` above its first table the file changes that ready-made finger; without it the file
    must hold every table of a finger, so that none is made of defaults that nobody asked for.

    Raises
    ------
    RecordError
        See :func:`~data_schemas.storage.read_toml`; tables are missing; of the name of a ready-made finger it says how
        to write its file.
    SimulateError
        There is no ready-made finger of this name.
    """

    def complete(tables: dict[str, Any]) -> dict[str, Any]:
        written = dict(tables)
        preset = written.pop("preset", None)
        if preset is None:
            _require_tables(path, written, FingerDesign)
            return written
        if not isinstance(preset, str):
            raise RecordError(f"{path}: preset = {preset!r} must be the name of a ready-made finger")
        try:
            ready = preset_design(preset)
        except SimulateError as error:
            raise SimulateError(f"{path}: {error}") from None
        values = ready.model_dump(mode="python", exclude_unset=True)
        origin = {field: where for field, where in ready.origin.items() if not _changes(written, ready, field)}
        return _merged({**values, "origin": origin}, written)

    if path.name == str(path) and path.name in PRESETS and not path.exists():
        raise RecordError(f"{path}: no such file; write it first: finray design init {path}, then give {path}.toml")
    return read_toml(path, FingerDesign, complete)


def design_inputs(design: FingerDesign, path: Path) -> list[Path]:
    """Return the design's file and those that it names."""
    named = [design.camera.calibration, None if design.camera.response == "assumed" else design.camera.response]
    return [path, *(path.parent / name for name in named if name is not None)]


def _require_tables(path: Path, written: Mapping[str, Any], model: type[BaseModel]) -> None:
    """Refuse a design in which a part of the finger is not there."""
    wanted = [name for name in _tables(model) if name != FILM_MATERIAL or _at(written, FILM_OF_THE_PAD) is not None]
    missing = [name for name in wanted if not isinstance(_at(written, name), dict)]
    if missing:
        raise RecordError(
            f"{path}: a finger without {', '.join(f'[{name}]' for name in missing)}; write what is missing (finray "
            'design init writes a whole finger), or let it come from a ready-made one: preset = "flat-70x35" above the '
            "first table ('finray design list' lists them)"
        )


def _tables(model: type[BaseModel], above: str = "") -> Iterator[str]:
    """Yield the dotted names of the tables that every finger has."""
    for name, field in model.model_fields.items():
        kind = field.annotation
        if isinstance(kind, type) and issubclass(kind, BaseModel) and name not in OPTIONAL_TABLES:
            yield f"{above}{name}"
            yield from _tables(kind, f"{above}{name}.")


def _at(table: Any, field: str) -> Any:
    """Return what stands at a dotted path of a table; None where nothing does."""
    for name in field.split("."):
        table = table.get(name) if isinstance(table, Mapping) else None
    return table


def _changes(written: Mapping[str, Any], ready: FingerDesign, field: str) -> bool:
    """Return whether a file gives a field another value than the ready-made finger has."""
    value: Any = ready
    for name in field.split("."):
        value = getattr(value, name, None)
    given = _at(written, field)
    return given is not None and (tuple(given) if isinstance(given, list) else given) != value


def _merged(below: Mapping[str, Any], above: Mapping[str, Any]) -> dict[str, Any]:
    """Return tables in which each value of `above` replaces that of `below`."""
    both = {**below, **above}
    for name in below.keys() & above.keys():
        if isinstance(below[name], Mapping) and isinstance(above[name], Mapping):
            both[name] = _merged(below[name], above[name])
    return both
