"""What CalculiX writes: displacements and contact pressures (.frd), totals (.dat) and increments (.sta)."""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from data_schemas import ImportFormatError
from data_schemas.storage import read_bytes

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

_KEY = 3  # columns of the key of a line
_NUMBER = 10  # columns of a node's number
_VALUE = 12  # columns of a value
_ITERATIONS: Final = 3  # column of the .sta file
_STEP_TIME: Final = 5  # column of the .sta file; the total time stands before it
_STA_COLUMNS = 7
_FIELD = re.compile(rb"^ -4  (\S+) +(\d+) +\d+", re.MULTILINE)
_FRAME = re.compile(rb"^ +100CL\s*\S+ *([-+.\dEe]+)", re.MULTILINE)
_TOTAL = re.compile(r"^ (?:total )?([a-z ]+?)(?: \(.*\))? for set (\S+) and time +(\S+)$")


@dataclass(frozen=True, slots=True)
class NodalField:
    """Values (n, components) at the nodes (n,), which count from 1, at a time of the step, whose period is 1."""

    step_fraction: float
    name: str
    nodes: IntArray
    values: FloatArray


@dataclass(frozen=True, slots=True)
class Convergence:
    """Iterations and step time of the converged increments."""

    iterations: IntArray
    times: FloatArray


def read_frd(path: Path, names: tuple[str, ...] = ("DISP", "CONTACT")) -> list[NodalField]:
    """Read fields at the nodes from an ASCII .frd file, in the order of the file.

    The time of a frame stands in its line 100CL. A field that breaks off, of a run that was stopped, is left out.

    Parameters
    ----------
    path
        File.
    names
        Fields that are wanted.

    Raises
    ------
    ImportFormatError
        When the file has no such field, or a field's lines are not as they must be.

    Source: CalculiX CGX manual, "Result Format", short format (key 0).
    """
    text = read_bytes(path, "a results file of CalculiX (.frd)", ImportFormatError)
    frames = [(m.start(), float(m[1])) for m in _FRAME.finditer(text)]
    found = []
    for field in _FIELD.finditer(text):
        name = field[1].decode("ascii", "replace")
        end = text.find(b"\n -3\n", field.end())
        before = [time for start, time in frames if start < field.start()]
        if name in names and end >= 0 and before:
            found.append(_field(path, name, before[-1], text[field.end() : end + 1]))
    if not found:
        raise ImportFormatError(
            f"{path}: holds no field {' or '.join(names)}; it must be an ASCII .frd file of CalculiX, written by "
            "*NODE FILE (binary ones, of OUTPUT=2D or *CONTROLS, are not read)"
        )
    return found


def _field(path: Path, name: str, time: float, block: bytes) -> NodalField:
    """Read the lines of one field: key -1, node, then up to six values in fixed columns."""
    start = block.find(b"\n -1")
    if start < 0:
        return NodalField(time, name, np.zeros(0, np.int64), np.zeros((0, 0)))
    lines = block[start + 1 :]
    width = lines.find(b"\n") + 1
    components, rest = divmod(width - 1 - _KEY - _NUMBER, _VALUE)
    if rest or components < 1 or len(lines) % width:
        raise ImportFormatError(
            f"{path}: lines of the field {name} at time {time:g} must hold a node and values of {_VALUE} columns; the "
            "file is damaged or not in the short ASCII format"
        )
    columns = [("key", f"S{_KEY}"), ("node", f"S{_NUMBER}"), ("values", f"S{_VALUE}", (components,)), ("end", "S1")]
    table = np.frombuffer(lines, dtype=np.dtype(columns))
    try:
        return NodalField(time, name, table["node"].astype(np.int64), table["values"].astype(np.float64))
    except ValueError as error:
        raise ImportFormatError(f"{path}: a value of the field {name} at time {time:g} is no number: {error}") from None


def _lines(path: Path) -> list[str]:
    """Return the lines of a text that CalculiX wrote."""
    return read_bytes(path, "a text that CalculiX wrote", ImportFormatError).decode("ascii", "replace").splitlines()


def read_totals(path: Path) -> Mapping[tuple[str, str], FloatArray]:
    """Read the totals of sets from a .dat file.

    Returns
    -------
    Mapping
        (quantity as CalculiX calls it, set) -> rows (k, 1 + c) of the time and the values; for example
        ("force", "INDENTER") in N, and ("internal energy", "GEL") in N mm.

    Raises
    ------
    ImportFormatError
        When there is no total in the file.
    """
    lines = _lines(path)
    found: dict[tuple[str, str], list[list[float]]] = {}
    for number, line in enumerate(lines):
        head = _TOTAL.match(line)
        below = next((text.split() for text in lines[number + 1 : number + 4] if text.strip()), None)
        if head is not None and below is not None:
            try:
                found.setdefault((head[1], head[2]), []).append([float(head[3]), *map(float, below)])
            except ValueError as error:
                raise ImportFormatError(f"{path}: line {number + 1}: the total is no number: {error}") from None
    if not found:
        raise ImportFormatError(
            f"{path}: holds no totals of sets; write them by *NODE PRINT and *EL PRINT with TOTALS=ONLY"
        )
    uneven = next((key for key, rows in found.items() if len({len(row) for row in rows}) > 1), None)
    if uneven is not None:
        raise ImportFormatError(f"{path}: the totals of {' of '.join(uneven)} differ in their number of values")
    return {key: np.array(rows) for key, rows in found.items()}


def read_convergence(path: Path) -> Convergence:
    """Read the iterations of the converged increments from a .sta file."""
    rows = [line.split() for line in _lines(path)]
    # an attempt that did not converge has a U behind its number
    done = [r for r in rows if len(r) == _STA_COLUMNS and all(cell.isdigit() for cell in r[:4])]
    return Convergence(
        np.array([int(r[_ITERATIONS]) for r in done], dtype=np.int64), np.array([float(r[_STEP_TIME]) for r in done])
    )
