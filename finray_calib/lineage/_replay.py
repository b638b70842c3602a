"""Compute a record again: its command is run into a temporary folder, and the numbers are compared.

The command is taken apart into words and run without a shell. Names of inputs become the files that were found for
them, names of outputs lead into the temporary folder. Nothing beside it is written.
"""

import math
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from data_schemas import FinrayError, Provenance, RecordError
from data_schemas.storage import read_json, read_record
from finray_calib.lineage._trace import KINDS, Traced

REPLAYED: Final = ("radiometry", "fit", "simulate", "recolour", "compare", "decide", "import", "study", "demo")
"""Verbs that compute; what others did (a capture) cannot be done again."""
OUTPUTS: Final = ("--out", "--report")
TOLERANCE_REL: Final[Mapping[str, float]] = {
    "PaintCalibration": 2e-6,
    "PaintMap": 2e-6,
    "SimulatedPress": 2e-6,
    "LightAngleSweep": 2e-6,
    "PressMechanics": 1e-6,
    "FingerSurfaces": 1e-6,
    "PressIncrement": 1e-6,
    "PhotometricErrorReport": 2e-5,
    "LightAngleDecision": 2e-5,
}
"""Kind -> largest difference of a number over the largest magnitude of its field that a replay may have; else 0.

On one machine the numbers of a fit come out the same. Threads and vector units of another one take sums in another
order, so that last digits differ; draws and presses carry these further. Reports and decisions are made from such
records."""
MOST_DIFFERENCES: Final = 10


@dataclass(frozen=True, slots=True)
class Replayed:
    """How a record compares with what its command computes now.

    Attributes
    ----------
    agrees
        Whether all is within the tolerance of its kind.
    sentence
        The outcome in words.
    differences
        What differs by more, at most so many lines.
    """

    agrees: bool
    sentence: str
    differences: tuple[str, ...]


def replay(tree: Traced) -> Replayed:
    """Run the command of a traced, whole record again and compare.

    Raises
    ------
    RecordError
        The record holds no command that can be run again, or the command fails now.
    """
    path = tree.path
    assert path is not None  # noqa: S101 - a traced root was read
    record = read_record(path, KINDS[tree.kind])
    words = _words(path, record.provenance)
    with tempfile.TemporaryDirectory(prefix="finray-replay-") as made:
        folder = Path(made)
        arguments = _arguments(words, tree, folder)
        done = subprocess.run(
            [sys.executable, "-m", "finray_calib.cli.main", *arguments],
            cwd=folder,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            check=False,
        )
        if done.returncode:
            said = done.stderr.strip().splitlines()
            raise RecordError(f"{path}: its command fails now: {said[-1] if said else f'status {done.returncode}'}")
        again = read_record(_same_product(folder, path, tree.kind), KINDS[tree.kind])
    compared = compare(tree.kind, record.model_dump(exclude={"provenance"}), again.model_dump(exclude={"provenance"}))
    return replace(compared, differences=(*compared.differences, *_otherwise(record.provenance, again.provenance)))


def _otherwise(before: Provenance | None, again: Provenance | None) -> Iterator[str]:
    """Yield what else differs between the two runs and may explain a difference."""
    if before is None or again is None:
        return
    for name in ("git_commit", "git_dirty", "python_version", "processor", "renderer"):
        if getattr(before, name) != getattr(again, name):
            yield f"note: {name} was {getattr(before, name)}, is {getattr(again, name)}"
    for name in sorted(before.packages.keys() | again.packages.keys()):
        if before.packages.get(name) != again.packages.get(name):
            yield f"note: {name} was {before.packages.get(name)}, is {again.packages.get(name)}"


def _words(path: Path, provenance: Provenance | None) -> tuple[str, ...]:
    """Return the words of the command that made a record."""
    words = None if provenance is None else provenance.arguments
    if words is None:
        raise RecordError(f"{path}: holds no finray command, so that it cannot be computed again")
    if words[0] not in REPLAYED:
        raise RecordError(
            f"{path}: was made by 'finray {words[0]}', which cannot be done again; --replay is for records of "
            f"{', '.join(REPLAYED)}"
        )
    return words


def _arguments(words: tuple[str, ...], tree: Traced, folder: Path) -> list[str]:
    """Return the words with inputs where they were found, and outputs in the folder."""
    found = {part.name: part.path.resolve() for part in tree.inputs if part.path is not None}
    arguments: list[str] = []
    is_output = False
    for word in words:
        option, equals, value = word.partition("=")
        if is_output:
            arguments.append(str(folder / Path(word).name))
        elif equals and option in OUTPUTS:
            arguments.append(f"{option}={folder / Path(value).name}")
        elif equals:
            arguments.append(f"{option}={_found(value, found)}")
        else:
            arguments.append(_found(word, found))
        is_output = word in OUTPUTS
    return arguments


def _found(word: str, found: Mapping[str, Path]) -> str:
    """Return where the file or folder that a word names was found; the word itself where it names none."""
    if word.startswith("-"):
        return word
    plain = Path(word).as_posix()
    if plain in found:
        return str(found[plain])
    for name, path in found.items():
        if name.startswith(f"{plain}/"):
            below = Path(name).relative_to(plain).parts
            return str(path.parents[len(below) - 1])
    return str(Path(word).resolve()) if Path(word).exists() else word


def _same_product(folder: Path, path: Path, kind: str) -> Path:
    """Return the record that was made again: of the same kind, its name the likest."""

    def likeness(file: Path) -> int:
        pairs = zip(reversed(file.parts), reversed(path.resolve().parts), strict=False)
        return next((count for count, (a, b) in enumerate(pairs) if a != b), len(file.parts))

    made = [file for file in sorted(folder.rglob("*.json")) if _kind_of(file) == kind]
    if not made:
        raise RecordError(f"{path}: its command makes no {kind} now; it was another version that made it")
    return max(made, key=likeness)


def _kind_of(file: Path) -> str | None:
    """Return the kind of a stored record."""
    try:
        envelope = read_json(file)
    except FinrayError:
        return None
    return envelope.get("kind") if isinstance(envelope, dict) else None


def compare(kind: str, before: Mapping[str, Any], again: Mapping[str, Any]) -> Replayed:
    """Compare the contents of two records of a kind, field by field.

    Parameters
    ----------
    kind
        Kind of both.
    before, again
        Their fields, arrays as arrays.
    """
    tolerance_rel = TOLERANCE_REL.get(kind, 0.0)
    values = changed = 0
    largest_rel, told = 0.0, list[str]()
    for place, a, b in _pairs("", before, again):
        if isinstance(a, np.ndarray) and isinstance(b, np.ndarray) and a.shape == b.shape:
            count, differing, difference_rel = _array_difference(a, b)
        else:
            count, differing = 1, int(not _same(a, b))
            difference_rel = _number_difference(a, b) if differing else 0.0
        values, changed = values + count, changed + differing
        largest_rel = max(largest_rel, difference_rel)
        if difference_rel > tolerance_rel:
            told.append(f"{place}: {_shown(a)} before, {_shown(b)} now")
    words = f"{values} values, {changed} differ"
    if changed and math.isfinite(largest_rel):
        words += f", at most by {largest_rel:.2g} of the largest of their field"
    if told:
        more = [f"and {len(told) - MOST_DIFFERENCES} more fields"] if len(told) > MOST_DIFFERENCES else []
        sentence = f"REPLAYED, DIFFERS: {words} (tolerance of a {kind}: {tolerance_rel:g})"
        return Replayed(False, sentence, (*told[:MOST_DIFFERENCES], *more))
    return Replayed(True, f"replayed, agrees: {words} (tolerance of a {kind}: {tolerance_rel:g})", ())


def _pairs(place: str, a: Any, b: Any) -> Iterator[tuple[str, Any, Any]]:
    """Yield place and values of two contents; lists of numbers as arrays."""
    if isinstance(a, Mapping) and isinstance(b, Mapping):
        for key in [*a, *(key for key in b if key not in a)]:
            yield from _pairs(f"{place}.{key}".lstrip("."), a.get(key), b.get(key))
    elif isinstance(a, list | tuple) and isinstance(b, list | tuple) and len(a) == len(b):
        for number, (x, y) in enumerate(zip(a, b, strict=True)):
            yield from _pairs(f"{place}[{number}]", x, y)
    else:
        yield place, a, b


def _same(a: Any, b: Any) -> bool:
    """Return whether two values are the same; two missing numbers are."""
    if isinstance(a, float) and isinstance(b, float) and math.isnan(a) and math.isnan(b):
        return True
    if isinstance(a, np.ndarray) or isinstance(b, np.ndarray):
        return False
    return bool(a == b) and type(a) is type(b)


def _number_difference(a: Any, b: Any) -> float:
    """Return the difference of two numbers over the larger magnitude; infinite for anything else."""
    if isinstance(a, float) and isinstance(b, float) and math.isfinite(a) and math.isfinite(b):
        return abs(a - b) / max(abs(a), abs(b))
    return math.inf


def _array_difference(a: np.ndarray, b: np.ndarray) -> tuple[int, int, float]:
    """Return how many values there are and differ, and the largest difference over the largest magnitude."""
    differs = ~((a == b) | (np.isnan(a) & np.isnan(b))) if a.dtype.kind == "f" else a != b
    if not differs.any():
        return a.size, 0, 0.0
    if a.dtype.kind != "f":
        return a.size, int(differs.sum()), math.inf
    scale = float(np.nanmax(np.abs(a)))
    with np.errstate(invalid="ignore"):
        largest = float(np.max(np.abs(a[differs].astype(np.float64) - b[differs])))
    return a.size, int(differs.sum()), largest / scale if math.isfinite(largest) and scale > 0.0 else math.inf


def _shown(value: Any) -> str:
    """Return a value in few characters."""
    text = f"array {value.shape}" if isinstance(value, np.ndarray) else repr(value)
    return text if len(text) <= 60 else f"{text[:57]}..."
