"""Press an indenter into a finger: increments of the push, forces, displacements and the contact patch."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from data_schemas.design import FingerDesign
from data_schemas.errors import SimulateError
from data_schemas.mechanical_design import ElasticSolid, NeoHookeSolid, OgdenSolid
from sim.mechanics.assembly import Assembly, State
from sim.mechanics.elements import Elasticity, Modes
from sim.mechanics.finger_mesh import STEPS, Preset, finger_mesh
from sim.mechanics.linear_solver import linear_solver
from sim.mechanics.materials import LinearElastic, Ogden, check_stability, neo_hooke
from sim.mechanics.mesh import FingerMesh
from sim.mechanics.newton import Increment, Supports, load_increments
from sim.mechanics.press_contact import ContactChoice, PressContact, chosen_contact, press_contact
from sim.mechanics.ties import TiedNodes
from sim.mechanics.warm_start import CoarserPath

FloatArray = NDArray[np.float64]
Progress = Callable[[int, int, str], None]

# a patch that reaches over this share of the pad is a strip across it
_WHOLE_WIDTH = 0.95
# two shares of a push that differ by rounding
_SAME_SHARE = 1e-9
# per node, against the fin's E times element size: the tie opens by a hundredth of the fin's own strain
_TIE_MODULI_TIMES_STEP = 100.0


@dataclass(frozen=True, slots=True)
class PressedFinger:
    """Equilibria of a finger under a rigid indenter; k increments, the last one is the whole push.

    Attributes
    ----------
    mesh
        The mesh.
    depth_mm
        Push of the indenter from first touch, (k,).
    force_n
        Force on the indenter, (k, 3).
    energy_n_mm
        Strain energy with that of contact and ties, (k,); with the barrier also of its drive and of the last
        increment's friction.
    displacement_mm
        Of the nodes, (k, n, 3); of the last increments only, (l, n, 3), where a stored press was gone on with.
    iterations
        Newton iterations of each increment, (k,).
    modes_mm
        Incompatible modes of each block at the last increment, (m, 3, 3) or (m, 0, 3).
    pressure_mpa, touch_mm
        Of the last increment: contact pressure at the q sampling points of the coat's f faces (f, q), and where these
        lie in the undeformed pad (f, q, 3).
    unreached
        Why the push ended early; empty when it did not.
    contact
        In words: how the indenter and the parts touch.
    """

    mesh: FingerMesh
    depth_mm: FloatArray
    force_n: FloatArray
    energy_n_mm: FloatArray
    displacement_mm: FloatArray
    iterations: NDArray[np.int64]
    modes_mm: Modes
    pressure_mpa: FloatArray
    touch_mm: FloatArray
    unreached: str
    contact: str


def press_finger(
    design: FingerDesign,
    preset: Preset | None = None,
    increments: int = 4,
    threads: int = 1,
    progress: Progress | None = None,
    start: PressedFinger | None = None,
    resume: PressedFinger | None = None,
    store: Callable[[PressedFinger], None] | None = None,
    contact: ContactChoice = "auto",
    folder: Path = Path(),
) -> PressedFinger:
    """Press the design's indenter in by its depth along the pad's normal, from first touch.

    Contact by a penalty on exact distances, frictionless, where ribs do not see each other; or by a barrier with the
    design's friction and contact of all parts. A push of 5 mm and more buckles ribs, which takes more increments.

    Parameters
    ----------
    design
        Finger, materials and indenter; ``indenter.depth_mm`` is the whole push.
    preset
        Fineness of the mesh; the design's own by default.
    increments
        Equal steps of the push that are wanted; smaller ones are put between where needed.
    threads
        Of elements and factorisation.
    progress
        Called after each increment.
    start
        The same press on a coarser mesh, whose displacements, interpolated, are where each increment's search starts.
        By default a finer mesh than coarse starts from the first increment on the coarse one (not with the barrier).
    resume
        The same press on the same mesh to a lower depth, to go on from.
    store
        Called after each increment with the press so far, for example to keep it for `resume`.
    contact
        "auto": the penalty where it can, the barrier for friction and meshes of the user.
    folder
        Where the design stands: the STL of an indenter is relative to it.

    Raises
    ------
    SimulateError
        When there is no push, not even the first increment finds an equilibrium, or `start` or `resume` is a press of
        another finger or mesh.
    """
    if design.indenter.depth_mm <= 0.0:
        raise SimulateError(f"indenter.depth_mm = {design.indenter.depth_mm:g} mm: a press needs a depth above 0 mm")
    steps, depth = STEPS[preset or design.mesh.preset], design.indenter.depth_mm
    touch = press_contact(design, finger_mesh(design, preset), steps.pad_mm, contact, threads, folder)
    mesh = touch.mesh
    elasticity = Elasticity(mesh, finger_materials(design), threads)
    assembly = Assembly(elasticity, [*touch.terms, *finger_ties(design, mesh, steps.skeleton_mm)])

    def loading(fraction: float) -> Supports:
        return touch.push(fraction * depth)

    begin, rest = (0.0, None) if resume is None else resumed(resume, mesh, depth)
    if rest is not None:
        touch.accept(rest)
    stops = [(k + 1) / increments for k in range(increments) if (k + 1) / increments > begin + _SAME_SHARE]
    if start is None and resume is None:
        predict = _path_from_coarse(_first_on_coarse(design, preset, increments, threads, contact), mesh, depth)
    else:
        predict = None if start is None else _path_of(start, mesh, depth)
    solver = linear_solver(threads=threads)
    reached: list[Increment] = []
    forces: list[FloatArray] = []
    unreached = ""
    try:
        for step in load_increments(
            assembly, solver, loading, stops, rest, begin, predict=predict, settle=touch.settle
        ):
            reached.append(step)
            forces.append(touch.force_n(step.equilibrium.state.u_mm))
            if store is not None:
                store(_result(design, mesh, touch, reached, np.array(forces), "", resume))
            if progress is not None:
                done = sum(step.fraction >= s for s in stops)
                progress(done, len(stops), f"pressed to {step.fraction * depth:.2f} mm")
    except SimulateError as stuck:
        if not reached:
            raise
        unreached = str(stuck)
        touch.push(reached[-1].fraction * depth)
    return _result(design, mesh, touch, reached, np.array(forces), unreached, resume)


def _first_on_coarse(
    design: FingerDesign, preset: Preset | None, increments: int, threads: int, contact: ContactChoice
) -> PressedFinger | None:
    """Press by the first increment on the coarse mesh, which halves the finer one's iterations there.

    Further increments are extrapolated: from 3 to 4 mm the coarse path led to a slow start on the medium mesh.
    """
    if (preset or design.mesh.preset) == "coarse" or chosen_contact(design, contact) == "barrier":
        return None
    first = design.indenter.model_copy(update={"depth_mm": design.indenter.depth_mm / increments})
    try:
        return press_finger(design.model_copy(update={"indenter": first}), "coarse", 1, threads, contact=contact)
    except SimulateError:
        return None


def _path_from_coarse(coarse: PressedFinger | None, mesh: FingerMesh, depth_mm: float) -> CoarserPath | None:
    """Return where a coarse press leads a finer mesh; none where the meshes are too far apart: it is help, not need."""
    try:
        return None if coarse is None else _path_of(coarse, mesh, depth_mm)
    except SimulateError:
        return None


def _path_of(press: PressedFinger, mesh: FingerMesh, depth_mm: float) -> CoarserPath:
    """Return the displacements of a coarser press on a mesh, by the share of the push."""
    return CoarserPath(press.mesh, mesh, list(press.depth_mm / depth_mm), press.displacement_mm)


def resumed(press: PressedFinger, mesh: FingerMesh, depth_mm: float) -> tuple[float, State]:
    """Return the share of a push that a stored press has done, and its state.

    Raises
    ------
    SimulateError
        When it stands on another mesh, or has been as deep already.
    """
    if not np.array_equal(press.mesh.nodes_mm, mesh.nodes_mm):
        raise SimulateError(
            f"the press to go on from has a mesh of {len(press.mesh.nodes_mm)} nodes that is not that of this press "
            f"({len(mesh.nodes_mm)} nodes); resume with the same design, mesh and --contact, or press from the start"
        )
    done = float(press.depth_mm[-1])
    if done >= (1.0 - _SAME_SHARE) * depth_mm:
        raise SimulateError(
            f"the press to go on from is at {done:g} mm already and indenter.depth_mm is {depth_mm:g} mm; "
            "ask for more, or resume from an earlier increment"
        )
    return done / depth_mm, State(press.displacement_mm[-1], press.modes_mm)


def finger_materials(design: FingerDesign) -> dict[str, Ogden | LinearElastic]:
    """Return the engine's materials by the names that the mesh's blocks give.

    Raises
    ------
    SimulateError
        When a rubber's constants make it unstable.
    """
    found: dict[str, Ogden | LinearElastic] = {}
    for name in type(design.mechanics).model_fields:
        solid = getattr(design.mechanics, name)
        if isinstance(solid, OgdenSolid):
            rubber = Ogden(solid.mu_mpa, solid.alpha, solid.bulk_over_shear)
            try:
                check_stability(rubber)
            except SimulateError as unstable:
                raise SimulateError(f"mechanics.{name}: {unstable}") from unstable
            found[name] = rubber
        elif isinstance(solid, NeoHookeSolid):
            found[name] = neo_hooke(solid.c10_mpa, solid.bulk_over_shear)
        elif isinstance(solid, ElasticSolid):
            found[name] = LinearElastic(solid.youngs_modulus_mpa, solid.poisson_ratio)
    return found


def contact_distance(pressed: PressedFinger, nodes: NDArray[np.int64]) -> FloatArray:
    """Return the distance of coat nodes from the middle of the contact in units of its half-width; <= 1 in contact.

    The patch is taken as an ellipse in the undeformed pad, or as a strip where it reaches across the pad. It ends half
    the distance between sampling points beyond the outermost one that touches, and is known to about that. NaN without
    contact.
    """
    touching = pressed.touch_mm[pressed.pressure_mpa > 0.0]
    # two Gauss points lie 1/sqrt(3) of a face apart, on average half a face
    margin = np.median(np.ptp(pressed.touch_mm, axis=1), axis=0) * np.sqrt(3.0) / 4.0
    if not len(touching):
        return np.full(len(nodes), np.nan)
    places = pressed.mesh.nodes_mm[nodes]
    squares = np.zeros(len(nodes))
    for axis in (0, 2):
        low, high = touching[:, axis].min() - margin[axis], touching[:, axis].max() + margin[axis]
        pad_low, pad_high = places[:, axis].min(), places[:, axis].max()
        if high - low < _WHOLE_WIDTH * (pad_high - pad_low):
            squares += ((places[:, axis] - (low + high) / 2.0) / ((high - low) / 2.0)) ** 2
    return np.asarray(np.sqrt(squares))


def finger_ties(design: FingerDesign, mesh: FingerMesh, step_mm: float) -> list[TiedNodes]:
    """Return the ties of the mesh."""
    fin = finger_materials(design)["skeleton"]
    stiffness = _TIE_MODULI_TIMES_STEP * fin.youngs_modulus_mpa * step_mm
    return [TiedNodes(mesh.nodes_mm, tie, stiffness) for tie in mesh.ties]


def _result(
    design: FingerDesign,
    mesh: FingerMesh,
    touch: PressContact,
    reached: Sequence[Increment],
    forces: FloatArray,
    unreached: str,
    before: PressedFinger | None,
) -> PressedFinger:
    """Collect the increments, after those of a press that was gone on with."""
    last = reached[-1].equilibrium.state.u_mm
    depths = np.array([step.fraction for step in reached]) * design.indenter.depth_mm
    energies = np.array([step.equilibrium.energy_n_mm for step in reached])
    iterations = np.array([step.equilibrium.iterations for step in reached])
    return PressedFinger(
        mesh=mesh,
        depth_mm=depths if before is None else np.concatenate([before.depth_mm, depths]),
        force_n=forces if before is None else np.concatenate([before.force_n, forces]),
        energy_n_mm=energies if before is None else np.concatenate([before.energy_n_mm, energies]),
        displacement_mm=np.array([step.equilibrium.state.u_mm for step in reached]),
        iterations=iterations if before is None else np.concatenate([before.iterations, iterations]),
        modes_mm=reached[-1].equilibrium.state.modes,
        pressure_mpa=touch.pressures_mpa(last),
        touch_mm=touch.touch_mm(),
        unreached=unreached,
        contact=touch.note,
    )
