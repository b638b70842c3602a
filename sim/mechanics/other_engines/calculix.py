"""CalculiX as a second engine: the same finger and mesh, pressed by a program of its own in a process of its own."""

from collections.abc import Callable, Iterable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

import numpy as np
from numpy.typing import NDArray

from data_schemas.design import FingerDesign
from data_schemas.errors import SimulateError
from data_schemas.mechanical_design import Preset
from sim.mechanics.contact_analytic import QUAD_CORNERS, quad_shapes
from sim.mechanics.finger_mesh import finger_mesh
from sim.mechanics.finger_parts import finger_materials
from sim.mechanics.mesh import FingerMesh
from sim.mechanics.other_engines.calculix_program import JOB, find_calculix, run_calculix
from sim.mechanics.other_engines.calculix_results import read_convergence, read_frd, read_totals
from sim.mechanics.other_engines.deck_materials import deck_materials
from sim.mechanics.other_engines.deck_push import finger_deck
from sim.mechanics.pressed_finger import PressedFinger

FloatArray = NDArray[np.float64]
Progress = Callable[[int, int, str], None]

_CONTACT: Final = "faceted rigid indenter; contact surface to surface by penalty; ribs do not see each other"
_SAME_TIME = 1e-4  # the .frd file holds six digits of it
_PRESSURE = 3  # of the contact's COPEN, CSLIP1, CSLIP2, CPRESS


def press_finger_calculix(
    design: FingerDesign,
    preset: Preset | None = None,
    increments: int = 4,
    threads: int = 1,
    progress: Progress | None = None,
    time_limit_s: float = 3600.0,
) -> PressedFinger:
    """Press the design's indenter in with CalculiX: see :func:`sim.mechanics.press.press_finger`.

    Mesh, materials, ties and contact stiffness are those of the engine in process; elements, contact search, facets
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

    return press_mesh_calculix(mesh, lines, depth_mm, threads, tell, time_limit_s)


def press_mesh_calculix(
    mesh: FingerMesh,
    lines: Iterable[str],
    depth_mm: float,
    threads: int = 1,
    tell: Callable[[float], None] | None = None,
    time_limit_s: float = 3600.0,
) -> PressedFinger:
    """Run CalculiX on a mesh's deck, as of :func:`~sim.mechanics.other_engines.deck.deck_lines`; collect its results.

    Parameters
    ----------
    mesh
        The mesh; it may be any that has a coat.
    lines
        Of its deck.
    depth_mm
        The deck's push.
    threads, time_limit_s
        See :func:`~sim.mechanics.other_engines.calculix_program.run_calculix`.
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
                f"CalculiX found no equilibrium in the first increment: {unreached or 'it gave no reason'}. Ask for "
                "more increments, a smaller push, or press with the engine in process"
            )
        return _pressed(depth_mm, mesh, Path(name), unreached)


def calculix_notes(design: FingerDesign) -> tuple[str, ...]:
    """Return what must be said about a press with CalculiX: stand-ins for its materials, how contact was made."""
    friction = design.indenter.friction
    return (
        *deck_materials(finger_materials(design), "calculix").notes,
        "C3D8R for the gel, C3D8I elsewhere",
        *([f"friction {friction:g} with CalculiX' own stick slope, not verified here"] if friction > 0.0 else []),
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
        raise SimulateError("CalculiX has not written a whole increment; press with the engine in process")
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
