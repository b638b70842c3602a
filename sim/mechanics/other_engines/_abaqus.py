"""A finger that Abaqus has pressed: its results file (.fil, ASCII) on the mesh of the deck.

The file gives displacements and reaction forces of nodes.
"""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Final, cast

import numpy as np
from numpy.typing import NDArray

from data_schemas import FingerDesign, ImportFormatError, Preset
from data_schemas.storage import read_bytes
from sim.mechanics import Body, PenaltyContact, PressedFinger, finger_mesh, rigid_indenter
from sim.mechanics.other_engines._deck import NodalField, finger_push

FloatArray = NDArray[np.float64]

_SAME_TIME = 1e-6


def pressed_by_abaqus(
    design: FingerDesign, fields: Sequence[NodalField], preset: Preset | None = None
) -> PressedFinger:
    """Return the press of a deck of :func:`~sim.mechanics.other_engines.finger_deck` from Abaqus' results.

    The push is that of the indenter's reference node. Pressures are those of the deck's linear penalty at the depth by
    which faces of the coat lie inside the exact indenter; the file holds no energies and no iterations (NaN and 0).

    Parameters
    ----------
    design, preset
        As they went into the deck.
    fields
        Of :func:`sim.mechanics.other_engines.read_fil`.

    Raises
    ------
    ImportFormatError
        When nodes or the indenter's reference node are missing: the file is of another mesh, or of other requests.
    """
    preset = preset or design.mesh.preset
    mesh = finger_mesh(design, preset)
    push = finger_push(design, preset, 1)
    count = len(mesh.nodes_mm)
    reference = count + len(push.indenter.nodes_mm) + 1
    times = sorted({f.step_fraction for f in fields if f.step_fraction > 0.0})
    if not times:
        raise ImportFormatError(
            "the results hold no increment after the start of the step (step time above 0); let Abaqus finish at least "
            "one increment of the push"
        )
    moved = np.stack([_of_nodes(fields, "U", t, np.arange(1, count + 1), preset) for t in times])
    depth_mm = -np.array([_of_nodes(fields, "U", t, np.array([reference]), preset)[0, 1] for t in times])
    reaction = np.array([_of_nodes(fields, "RF", t, np.array([reference]), preset)[0] for t in times])
    indenter = rigid_indenter(design)
    body = cast(Body, indenter.body)  # a push has been made of it
    pose = indenter.pose(float(depth_mm[-1]))
    coat = PenaltyContact(mesh.nodes_mm, mesh.surfaces["coat"], body, pose, push.stiffness_mpa_per_mm)
    return PressedFinger(
        mesh=mesh,
        depth_mm=depth_mm,
        force_n=-reaction,
        energy_n_mm=np.full(len(times), np.nan),
        displacement_mm=moved,
        iterations=np.zeros(len(times), dtype=np.int64),
        modes_mm=(),
        pressure_mpa=coat.pressures_mpa(moved[-1]),
        touch_mm=coat.points_mm(np.zeros_like(moved[-1])),
        unreached="" if times[-1] > 1.0 - _SAME_TIME else f"the results end at {times[-1]:.4g} of the step",
        contact="faceted rigid indenter; contact surface to surface by penalty; contact between ribs is not computed",
    )


def _of_nodes(
    fields: Sequence[NodalField], name: str, time: float, wanted: NDArray[np.int64], preset: Preset
) -> FloatArray:
    """Return the values (k, 3) of some nodes at a time."""
    for field in fields:
        if field.name != name or field.step_fraction != time:
            continue
        order = np.argsort(field.nodes)
        at = np.searchsorted(field.nodes, wanted, sorter=order)
        found = order[np.minimum(at, len(order) - 1)]
        if (field.nodes[found] == wanted).all():
            return field.values[found]
    raise ImportFormatError(
        f"{name} of the nodes {wanted[0]} to {wanted[-1]} at step time {time:g} is missing in the results; compute a "
        f"deck of this design on the {preset} mesh with its output requests (finray export deck DESIGN --dialect "
        "abaqus)"
    )


FIELDS: Final = {101: "U", 104: "RF"}
"""Record keys of the nodal quantities that are read."""

_INCREMENT_STARTS: Final = 2000
_STEP_TIME: Final = 1  # attribute of that record
_COLUMNS: Final = 80
_REAL: Final = 22  # columns of a number after its D
_TEXT: Final = 8  # columns of a text after its A
_LARGEST: Final = 1e15  # whole numbers up to there are exact
_COMPONENTS: Final = 3  # the reference node of a rigid body has rotations too


def read_fil(path: Path) -> list[NodalField]:
    """Read displacements "U" in mm and reaction forces "RF" in N at the nodes, increment by increment.

    In the ASCII format the file is one run of characters, 80 in a line. A record begins with an asterisk; its items
    are its length and its key, then the attributes: integers as I, the number of digits in two columns, and the
    digits; numbers as D and 22 columns; texts as A and 8 columns. The times are those of the step.

    Not tested on a complete file of Abaqus, because none was at hand: record keys and attributes are those of the
    documentation, the ASCII coding is that of the first line of a file of Abaqus 6.23.

    Parameters
    ----------
    path
        File that *FILE FORMAT, ASCII and *NODE FILE have made; not the binary default.

    Raises
    ------
    ImportFormatError
        When the file is binary, or is not made of such records, or holds none of these quantities.

    Source: Abaqus Output Reference, "Results file": records for any request, and once per increment.
    """
    content = read_bytes(path, "an Abaqus results file in ASCII (.fil)", ImportFormatError)
    if not content.startswith(b"*I"):
        raise ImportFormatError(
            f"{path}: is not an Abaqus results file in ASCII, which begins with *I; request one with *FILE FORMAT, "
            "ASCII in the step, as in the decks of finray export deck, or convert the file with abaqus ascfil"
        )
    lines = content.decode("ascii", "replace").splitlines()
    # blanks at the end of a line may have been trimmed, and may be part of a number
    text = "".join(line.ljust(_COLUMNS) for line in lines)
    found: list[NodalField] = []
    rows: dict[str, tuple[list[int], list[list[float]]]] = {}
    time = 0.0
    for record in text.split("*")[1:]:
        key = _key(record)
        if key == _INCREMENT_STARTS:
            found += _collected(rows, time)
            rows = {}
            _, time = _numbers(path, record, _STEP_TIME + 1, "an increment needs its times")
        elif key in FIELDS:
            number, *values = _numbers(path, record, None, "displacements and forces need a node and finite numbers")
            nodes, components = rows.setdefault(FIELDS[key], ([], []))
            nodes.append(int(number))
            components.append([*values, 0.0, 0.0][:_COMPONENTS])
    found += _collected(rows, time)
    if not found:
        raise ImportFormatError(f"{path}: contains no displacements; write them with *NODE FILE, U and RF")
    return found


def _collected(rows: dict[str, tuple[list[int], list[list[float]]]], time: float) -> Iterator[NodalField]:
    """Yield the quantities of one increment."""
    for name, (nodes, values) in rows.items():
        numbers: NDArray[np.int64] = np.array(nodes, dtype=np.int64)
        yield NodalField(time, name, numbers, np.array(values, dtype=np.float64))


def _key(record: str) -> int:
    """Return the key of a record, its second item; -1 for what is none, such as a heading with an asterisk."""
    try:
        start = 3 + int(record[1:3])
        return int(record[start + 3 : start + 3 + int(record[start + 1 : start + 3])])
    except ValueError:
        return -1


def _numbers(path: Path, record: str, count: int | None, needed: str) -> list[float]:
    """Return the first attributes of a record, or all, which must be two or more finite numbers."""
    found = _attributes(path, record)[:count]
    numbers = [float(v) for v in found if not isinstance(v, str) and abs(v) < _LARGEST]
    if len(numbers) < max(len(found), 2):
        raise ImportFormatError(f"{path}: the record *{record[:40].strip()}... is corrupted ({needed})")
    return numbers


def _attributes(path: Path, record: str) -> list[float | str]:
    """Return the items of a record after its length and key."""
    items: list[float | str] = []
    at = 0
    try:
        while at < len(record) and not record[at].isspace():
            kind = record[at]
            width = int(record[at + 1 : at + 3]) + 2 if kind == "I" else _REAL if kind in "DE" else _TEXT
            word = record[at + 1 : at + 1 + width]
            if len(word) < width or kind not in "IDEA":
                raise ValueError(f"an item {kind}{word.strip()}")
            items.append(int(word[2:]) if kind == "I" else word if kind == "A" else float(word.replace("D", "E")))
            at += 1 + width
    except ValueError as error:
        raise ImportFormatError(f"{path}: the record *{record[:40].strip()}... is corrupted ({error})") from None
    if len(items) != items[0]:
        raise ImportFormatError(
            f"{path}: the record *{record[:40].strip()}... has {len(items)} items but states {items[0]}; the file is "
            "corrupted, or its lines are not of 80 columns"
        )
    return items[2:]
