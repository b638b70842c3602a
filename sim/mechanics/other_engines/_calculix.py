"""CalculiX as a second engine: the same finger and mesh, pressed by a program of its own in a process of its own.

The program is found, run on a deck and ended in time. Of its results are read displacements and contact pressures
(.frd), totals (.dat) and increments (.sta).
"""

import os
import re
import shutil
import signal
import subprocess
import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

import numpy as np
from numpy.typing import NDArray

from data_schemas import FingerDesign, ImportFormatError, MissingExtraError, Preset, SimulateError
from data_schemas.storage import read_bytes
from sim.mechanics import QUAD_CORNERS, FingerMesh, PressedFinger, finger_materials, finger_mesh, quad_shapes
from sim.mechanics.other_engines._deck import NodalField, deck_materials, finger_deck

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
class Convergence:
    """Iterations and step time of the converged increments."""

    iterations: IntArray
    times: FloatArray


_FIELDS: Final = ("DISP", "CONTACT")


def read_frd(path: Path) -> list[NodalField]:
    """Read displacements and contact at the nodes from an ASCII .frd file, in the order of the file.

    The time of a frame stands in its line 100CL. A field that breaks off, of a run that was stopped, is left out.

    Parameters
    ----------
    path
        File.

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
        if name in _FIELDS and end >= 0 and before:
            found.append(_field(path, name, before[-1], text[field.end() : end + 1]))
    if not found:
        raise ImportFormatError(
            f"{path}: contains no field {' or '.join(_FIELDS)}; give an ASCII .frd file of CalculiX, written with "
            "*NODE FILE (binary files, of OUTPUT=2D or *CONTROLS, are not supported)"
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
            f"{path}: lines of the field {name} at time {time:g} must contain a node and values of {_VALUE} columns; "
            "the file is corrupted or not in the short ASCII format"
        )
    columns = [("key", f"S{_KEY}"), ("node", f"S{_NUMBER}"), ("values", f"S{_VALUE}", (components,)), ("end", "S1")]
    table = np.frombuffer(lines, dtype=np.dtype(columns))
    try:
        return NodalField(time, name, table["node"].astype(np.int64), table["values"].astype(np.float64))
    except ValueError as error:
        raise ImportFormatError(
            f"{path}: a value of the field {name} at time {time:g} is not a number ({error})"
        ) from None


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
                raise ImportFormatError(f"{path}, line {number + 1}: the total is not a number ({error})") from None
    if not found:
        raise ImportFormatError(
            f"{path}: contains no totals of sets; write them with *NODE PRINT and *EL PRINT with TOTALS=ONLY"
        )
    uneven = next((key for key, rows in found.items() if len({len(row) for row in rows}) > 1), None)
    if uneven is not None:
        raise ImportFormatError(
            f"{path}: the totals of {' of '.join(uneven)} must all have the same number of values, but do not"
        )
    return {key: np.array(rows) for key, rows in found.items()}


def read_convergence(path: Path) -> Convergence:
    """Read the iterations of the converged increments from a .sta file."""
    rows = [line.split() for line in _lines(path)]
    # an attempt that did not converge has a U behind its number
    done = [r for r in rows if len(r) == _STA_COLUMNS and all(cell.isdigit() for cell in r[:4])]
    return Convergence(
        np.array([int(r[_ITERATIONS]) for r in done], dtype=np.int64), np.array([float(r[_STEP_TIME]) for r in done])
    )


Progress = Callable[[int, int, str], None]

_CONTACT: Final = "faceted rigid indenter; contact surface to surface by penalty; contact between ribs is not computed"
_SAME_TIME = 1e-4  # the .frd file holds six digits of it
_PRESSURE = 3  # of the contact's COPEN, CSLIP1, CSLIP2, CPRESS


def press_finger_calculix(
    design: FingerDesign,
    preset: Preset | None = None,
    increments: int = 4,
    threads: int = 1,
    progress: Progress | None = None,
) -> PressedFinger:
    """Press the design's indenter in with CalculiX: see :func:`sim.mechanics.press_finger`.

    Mesh, materials, ties and contact stiffness are those of our own engine; elements, contact search, facets
    of the indenter and solver are CalculiX' own. Rubber that is not neo-Hookean becomes a polynomial of the invariants
    (:func:`calculix_notes` says which). Pressures stand at the coat's nodes and are interpolated.

    Raises
    ------
    MissingExtraError
        When CalculiX is not installed.
    SimulateError
        When there is no push, or not even the first increment finds an equilibrium.
    """
    find_calculix()
    mesh = finger_mesh(design, preset)
    lines = finger_deck(design, "calculix", preset, increments, mesh=mesh)
    depth_mm = design.indenter.depth_mm

    def tell(share: float) -> None:
        if progress is not None:
            progress(int(share * increments + _SAME_TIME), increments, f"pressed to {share * depth_mm:.2f} mm")

    return press_mesh_calculix(mesh, lines, depth_mm, threads, tell)


def press_mesh_calculix(
    mesh: FingerMesh,
    lines: Iterable[str],
    depth_mm: float,
    threads: int = 1,
    tell: Callable[[float], None] | None = None,
    time_limit_s: float = 3600.0,
) -> PressedFinger:
    """Run CalculiX on a mesh's deck, as of :func:`~sim.mechanics.other_engines._deck.deck_lines`; collect its results.

    Parameters
    ----------
    mesh
        The mesh; it may be any that has a coat.
    lines
        Of its deck.
    depth_mm
        The deck's push.
    threads, time_limit_s
        See :func:`~sim.mechanics.other_engines._calculix.run_calculix`.
    tell
        Called with the share of the push that is done.

    Raises
    ------
    MissingExtraError
        When CalculiX is not installed.
    SimulateError
        When not even the first increment finds an equilibrium.
    """

    def watch(folder: Path) -> None:
        if tell is not None and len(_reached(folder)):
            tell(float(_reached(folder)[-1]))

    with TemporaryDirectory(prefix="finray-calculix-") as name:
        unreached = run_calculix(lines, Path(name), threads, time_limit_s, watch)
        if not len(_reached(Path(name))):
            raise SimulateError(
                f"CalculiX found no equilibrium in the first increment ({unreached or 'it gave no reason'}). Ask for "
                "more increments or a smaller push, or leave out --engine calculix"
            )
        return _pressed(depth_mm, mesh, Path(name), unreached)


def calculix_notes(design: FingerDesign) -> tuple[str, ...]:
    """Return what must be said about a press with CalculiX: stand-ins for its materials, how contact was made."""
    friction = design.indenter.friction
    return (
        *deck_materials(finger_materials(design), "calculix").notes,
        "C3D8R for the gel, C3D8I elsewhere",
        *(
            [
                f"friction {friction:g}, with a stick slope of a tenth of the contact stiffness; CalculiX results with "
                "friction are not verified"
            ]
            if friction > 0.0
            else []
        ),
    )


def _reached(folder: Path) -> FloatArray:
    """Return the shares of the push that converged."""
    path = folder / f"{JOB}.sta"
    return read_convergence(path).times if path.exists() else np.zeros(0)


def _pressed(depth_mm: float, mesh: FingerMesh, folder: Path, unreached: str) -> PressedFinger:
    """Collect what CalculiX wrote about the increments of which everything is there."""
    fields = read_frd(folder / f"{JOB}.frd")
    moved = [f for f in fields if f.name == "DISP"]
    pressed = [f for f in fields if f.name == "CONTACT"]
    totals = read_totals(folder / f"{JOB}.dat")
    force = totals.get(("force", "INDENTER"), np.zeros((0, 4)))
    energies = [rows for (what, _), rows in totals.items() if what == "internal energy"]
    convergence = read_convergence(folder / f"{JOB}.sta")
    count = min(len(moved), len(pressed), len(force), len(convergence.times), *map(len, energies))
    if not count:
        raise SimulateError("CalculiX has not written a complete increment; leave out --engine calculix")
    nodes = len(mesh.nodes_mm)
    displacement = np.stack([_at_nodes(f.nodes, f.values, nodes) for f in moved[:count]])
    # at the Gauss points, as the engine in process has them
    shapes, _ = quad_shapes(QUAD_CORNERS / np.sqrt(3.0))
    coat = mesh.surfaces["coat"]
    pressure = _at_nodes(pressed[count - 1].nodes, pressed[count - 1].values, nodes)[:, _PRESSURE]
    return PressedFinger(
        mesh=mesh,
        depth_mm=force[:count, 0] * depth_mm,
        force_n=-force[:count, 1:],
        energy_n_mm=np.sum([rows[:count, 1] for rows in energies], axis=0),
        displacement_mm=displacement,
        iterations=convergence.iterations[:count],
        modes_mm=(),
        pressure_mpa=np.maximum(pressure[coat] @ shapes.T, 0.0),
        touch_mm=np.einsum("qa,kai->kqi", shapes, mesh.nodes_mm[coat]),
        unreached=unreached,
        contact=_CONTACT,
    )


def _at_nodes(numbers: NDArray[np.int64], values: FloatArray, count: int) -> FloatArray:
    """Return the first three or more components at the nodes of the finger, which come first; zero where none is."""
    out = np.zeros((count, values.shape[1]))
    of_finger = numbers <= count
    out[numbers[of_finger] - 1] = values[of_finger]
    return out


PROGRAM: Final = "ccx"
JOB: Final = "finger"
"""Name, without its ending, of every file of a run."""

_POLL_S = 0.2
_ENDS_WITHIN_S = 5.0


def find_calculix() -> str:
    """Return the path of CalculiX.

    Raises
    ------
    MissingExtraError
        When it is not installed.
    """
    path = shutil.which(PROGRAM)
    if path is None:
        raise MissingExtraError(
            f"CalculiX (the program {PROGRAM}) is not installed or not on the PATH; on Debian and Ubuntu: apt-get "
            "install calculix-ccx. Without it, leave out --engine calculix"
        )
    return path


def calculix_version() -> str:
    """Return the version of the installed CalculiX, for example "2.20".

    Raises
    ------
    MissingExtraError
        When it is not installed.
    """
    said = subprocess.run([find_calculix(), "-v"], capture_output=True, text=True, timeout=60.0, check=False).stdout
    found = re.search(r"Version\s+(\S+)", said)
    return found[1] if found else "of unknown version"


def run_calculix(
    lines: Iterable[str],
    folder: Path,
    threads: int = 1,
    time_limit_s: float = 3600.0,
    watch: Callable[[Path], None] | None = None,
) -> str:
    """Run CalculiX on a deck in a folder; its results are finger.frd, finger.dat and finger.sta there.

    Parameters
    ----------
    lines
        Of the deck.
    folder
        An empty folder.
    threads
        Of assembly and solver.
    time_limit_s
        After which the run is ended.
    watch
        Called several times a second with the folder.

    Returns
    -------
    str
        Why it ended early; empty when it did not.

    Raises
    ------
    MissingExtraError
        When CalculiX is not installed.
    """
    program = find_calculix()
    with (folder / f"{JOB}.inp").open("w", encoding="ascii") as deck:
        deck.writelines(f"{line}\n" for line in lines)
    # unbuffered: the totals of a run that is ended are those of its last increment
    count = str(threads)
    limits = {"OMP_NUM_THREADS": count, "CCX_NPROC_EQUATION_SOLVER": count, "GFORTRAN_UNBUFFERED_ALL": "y"}
    log = folder / f"{JOB}.log"
    end = time.monotonic() + time_limit_s
    with log.open("wb") as out:
        process = subprocess.Popen(
            [program, "-i", JOB],
            cwd=folder,
            env={**os.environ, **limits},
            stdin=subprocess.DEVNULL,
            stdout=out,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )
        try:
            while process.poll() is None and time.monotonic() < end:
                if watch is not None:
                    watch(folder)
                time.sleep(_POLL_S)
            late = process.poll() is None
        finally:
            _end(process)
    if late:
        return f"CalculiX was ended after {time_limit_s:g} s, the time limit; take a coarser mesh or a smaller push"
    return _complaint(read_bytes(log, "the log of CalculiX").decode("ascii", "replace"), process.returncode)


def _end(process: "subprocess.Popen[bytes]") -> None:
    """End a process that still runs, with what it has started."""
    for ending in (signal.SIGTERM, signal.SIGKILL):
        if process.poll() is not None:
            return
        os.killpg(process.pid, ending)
        try:
            process.wait(_ENDS_WITHIN_S)
        except subprocess.TimeoutExpired:
            continue


def _complaint(log: str, status: int) -> str:
    """Return why a run ended early."""
    if "Job finished" in log:
        return ""
    said = re.search(r"\*ERROR[:\s]*(.*(?:\n {4,}\S.*)*)", log)
    reason = " ".join(said[1].split()) if said else f"it ended with status {status}"
    return f"CalculiX stopped: {reason}"
