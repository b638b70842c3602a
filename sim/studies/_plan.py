"""The plan of a design study: read from TOML, and turned into points that are whole designs."""

import itertools
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from pydantic import ValidationError
from scipy.stats import qmc

from data_schemas import DesignStudy, DesignValue, FingerDesign, RecordError, SimulateError, explain
from data_schemas.storage import read_toml
from sim import PRESETS, preset_design, read_design

_PLANS: Final = Path(__file__).parent / "plans"
SHIPPED_PLANS: Final[tuple[str, ...]] = tuple(sorted(path.stem for path in _PLANS.glob("*.toml")))
"""Names of the plans that come with the package: the paper's experiments."""
PRESET: Final = "preset"
SEED: Final = "seed"


@dataclass(frozen=True, slots=True)
class PlannedPoint:
    """One point of a study.

    Attributes
    ----------
    number
        From 1, in the order of the plan.
    changes
        What the point changes, by dotted field.
    design
        The whole finger.
    seed
        Of its renders.
    """

    number: int
    changes: dict[str, DesignValue]
    design: FingerDesign
    seed: int


def read_plan(name_or_path: str | Path) -> tuple[DesignStudy, Path]:
    """Read a plan by its file, or one that comes with the package by its name; return it and its file.

    Raises
    ------
    RecordError
        There is neither a file nor a shipped plan of this name, or the file is no plan.
    """
    path = Path(name_or_path)
    if not path.exists() and str(name_or_path) in SHIPPED_PLANS:
        path = _PLANS / f"{name_or_path}.toml"
    if not path.exists():
        raise RecordError(
            f"{path}: no such plan; give a plan file (TOML), or one of the shipped plans: {', '.join(SHIPPED_PLANS)}"
        )
    return read_toml(path, DesignStudy), path


def study_points(plan: DesignStudy, path: Path) -> list[PlannedPoint]:
    """Return the points of a plan, each with its whole design.

    All points of a random study together are a scrambled Sobol' sample of the box of its ranges.

    Parameters
    ----------
    plan, path
        From :func:`read_plan`; a design file is looked for beside the plan.

    Raises
    ------
    SimulateError
        A point is no finger: a field is unknown or a value is not allowed. The message names point and field.
    """
    points = []
    for number, changes in enumerate(_changes(plan), start=1):
        base = _base(plan, path, changes)
        try:
            design = _changed(base, {**plan.set, **changes})
        except ValidationError as error:
            raise SimulateError(f"{path}: point {number} ({_words(changes)}): {explain(error, FingerDesign)}") from None
        except SimulateError as error:
            raise SimulateError(f"{path}: point {number} ({_words(changes)}): {error}") from None
        points.append(PlannedPoint(number, changes, design, _seed(plan, changes, path)))
    return points


def _changes(plan: DesignStudy) -> Iterator[dict[str, DesignValue]]:
    """Yield what each point changes."""
    fields = [variation.field for variation in plan.vary]
    if plan.combine == "random":
        low = [float(variation.low or 0.0) for variation in plan.vary]
        high = [float(variation.high or 0.0) for variation in plan.vary]
        # a power of two of points keeps the sample balanced; what is too many is left out
        exponent = max(1, (int(plan.count or 2) - 1).bit_length())
        sample = qmc.Sobol(len(fields), seed=plan.seed).random_base2(exponent)[: plan.count]
        rows: Iterator[tuple[DesignValue, ...]] = (
            tuple(float(value) for value in row) for row in qmc.scale(sample, low, high)
        )
    else:
        together = zip if plan.combine == "together" else itertools.product
        rows = iter(together(*(variation.values for variation in plan.vary)))
    for row in rows:
        yield dict(zip(fields, row, strict=True))


def _base(plan: DesignStudy, path: Path, changes: Mapping[str, DesignValue]) -> FingerDesign:
    """Return the design that a point starts from."""
    name = changes.get(PRESET, plan.design)
    if not isinstance(name, str):
        raise SimulateError(f"{path}: preset = {name!r} must be the name of a ready-made finger")
    file = path.parent / name
    if PRESET not in changes and name not in PRESETS:
        return read_design(file)
    try:
        return preset_design(name)
    except SimulateError as error:
        raise SimulateError(f"{path}: {error}") from None


def _changed(base: FingerDesign, changes: Mapping[str, DesignValue]) -> FingerDesign:
    """Return a design with other values; what a value came from no longer holds where it is changed."""
    tables = base.model_dump(mode="python", exclude={"provenance"})
    for field, value in changes.items():
        if field not in (PRESET, SEED):
            _set(tables, field, value)
    tables["origin"] = {field: where for field, where in base.origin.items() if field not in changes}
    return FingerDesign.model_validate(tables)


def _set(tables: dict[str, Any], field: str, value: DesignValue) -> None:
    """Put a value at a dotted field; where a whole number stands, a drawn one is rounded to one."""
    *above, last = field.split(".")
    table: Any = tables
    for name in above:
        table = table.get(name) if isinstance(table, dict) else None
    if not isinstance(table, dict):
        raise SimulateError(
            f"'{field}' is no field of this finger, which has no [{'.'.join(above)}]; 'finray design init' writes all"
        )
    if last not in table:
        raise SimulateError(f"'{field}' is no field of a design; 'finray design init' writes all fields")
    is_whole = isinstance(table[last], int) and not isinstance(table[last], bool)
    table[last] = round(value) if is_whole and isinstance(value, float) else value


def _seed(plan: DesignStudy, changes: Mapping[str, DesignValue], path: Path) -> int:
    """Return the seed of a point: the study's, so that points share their random numbers, unless it is varied."""
    seed = changes.get(SEED, plan.seed)
    if isinstance(seed, bool) or not isinstance(seed, int | float) or seed < 0:
        raise SimulateError(f"{path}: seed = {seed!r} must be a whole number from 0")
    return int(seed)


def _words(changes: Mapping[str, DesignValue]) -> str:
    """Say what a point changes."""
    return ", ".join(f"{field} = {value}" for field, value in changes.items())
