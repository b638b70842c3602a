"""Press an indenter into a finger: increments of the push, from first touch or from a stored press."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from data_schemas import FingerDesign, NoEquilibriumError, Preset, SimulateError
from sim.mechanics._assembly import Assembly, Elasticity, State
from sim.mechanics._contact_library import contact_library_failure
from sim.mechanics._finger_mesh import STEPS, finger_materials, finger_mesh, finger_ties
from sim.mechanics._increments import CoarserPath, Watch, load_increments
from sim.mechanics._linear_solver import linear_solver
from sim.mechanics._mesh import FingerMesh
from sim.mechanics._newton import NewtonOptions, Supports
from sim.mechanics._press_contact import ContactChoice, PressContact, chosen_contact, press_contact
from sim.mechanics._pressed_finger import PressedFinger, PressHistory

Progress = Callable[[int, int, str], None]

# two shares of a push that differ by rounding
_SAME_SHARE = 1e-9


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
    budget_s: float | None = None,
) -> PressedFinger:
    """Press the design's indenter in by its depth along the pad's normal, from first touch.

    Contact by a penalty on exact distances, frictionless, where ribs do not see each other; or by a barrier with the
    design's friction and contact of all parts. Each increment is looked at for surfaces of the finger that pass
    through each other, which the result then tells. A push of 5 mm and more buckles ribs, which takes more increments.

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
        Called before each iteration and after each increment.
    start
        The same press on a coarser mesh, whose displacements, interpolated, are where each increment's search starts.
        By default a finer mesh than coarse starts from the first increment on the coarse one (not with the barrier).
    resume
        The same press on the same mesh to a lower depth, to go on from.
    store
        Called after each increment with the press so far, for example to keep it for `resume`.
    contact
        "auto": the penalty where it can, the barrier for friction and meshes of the user, and for a press whose parts
        pass through each other by the penalty: it begins again.
    folder
        Where the design stands: the STL of an indenter is relative to it.
    budget_s
        Processor time that it may take, see :class:`~sim.mechanics._increments.Watch`; then it ends early.

    Raises
    ------
    SimulateError
        When there is no push, not even the first increment finds an equilibrium or has the time to, or `start` or
        `resume` is a press of another finger or mesh.
    """
    if design.indenter.depth_mm <= 0.0:
        raise SimulateError(f"indenter.depth_mm = {design.indenter.depth_mm:g} mm: a press needs a depth above 0 mm")
    if resume is not None and resume.kind == "barrier" and contact == "auto":
        contact = "barrier"
    watch = Watch(progress, increments, budget_s)
    steps, depth = STEPS[preset or design.mesh.preset], design.indenter.depth_mm
    touch = press_contact(design, finger_mesh(design, preset), steps.pad_mm, contact, threads, folder)
    mesh = touch.mesh
    ties = finger_ties(design, mesh, steps.skeleton_mm)
    assembly = Assembly(Elasticity(mesh, finger_materials(design), threads), [*touch.terms, *ties])

    def loading(fraction: float) -> Supports:
        return touch.push(fraction * depth)

    begin, rest = (0.0, None) if resume is None else resumed(resume, mesh, depth)
    if rest is not None:
        touch.accept(rest)
    stops = [(k + 1) / increments for k in range(increments) if (k + 1) / increments > begin + _SAME_SHARE]
    if start is None and resume is None:
        predict = _path_from_coarse(_first_on_coarse(design, preset, increments, threads, contact, watch), mesh, depth)
    else:
        predict = None if start is None else _path_of(start, mesh, depth)
    history = PressHistory(assembly, ties, touch, resume)
    try:
        for step in load_increments(
            assembly,
            linear_solver(threads=threads),
            loading,
            stops,
            rest,
            begin,
            options=NewtonOptions(tell=watch.tell),
            predict=predict,
            settle=touch.settle,
            refuse=lambda state, fraction: _passed_through(touch, state, fraction * depth, steps.pad_mm),
        ):
            history.add(step.fraction * depth, step.equilibrium)
            if history.crossing and contact == "auto" and touch.kind == "penalty" and contact_library_failure() is None:
                watch.reached(0, f"{history.crossing}; pressing again with contact of all parts")
                found = press_finger(
                    design, preset, increments, threads, progress, store=store, contact="barrier", folder=folder,
                    budget_s=watch.left_s,
                )  # fmt: skip
                why = f"{found.contact}; by the penalty, which was tried first, {history.crossing}"
                return replace(found, contact=why)
            if store is not None:
                store(history.pressed())
            done = increments - sum(step.fraction < s for s in stops)
            watch.reached(done, f"pressed to {step.fraction * depth:.2f} mm")
    except NoEquilibriumError as stuck:
        if history.depth_mm is None:
            raise
        touch.push(history.depth_mm)
        return history.pressed(str(stuck))
    return history.pressed()


def _passed_through(touch: PressContact, state: State, pushed_mm: float, pad_mm: float) -> str:
    """Return that an equilibrium is one behind the coat, or nothing."""
    force_n = float(touch.force_n(state.u_mm)[1])
    # a round indenter may stand between the nodes of one element
    between = force_n == 0.0 and pushed_mm <= pad_mm
    return "" if force_n > 0.0 or between else "the indenter has passed through the coat"


def _first_on_coarse(
    design: FingerDesign, preset: Preset | None, increments: int, threads: int, contact: ContactChoice, watch: Watch
) -> PressedFinger | None:
    """Press by the first increment on the coarse mesh, which halves the finer one's iterations there.

    Further increments are extrapolated: from 3 to 4 mm the coarse path led to a slow start on the medium mesh.
    """
    if (preset or design.mesh.preset) == "coarse" or chosen_contact(design, contact) == "barrier":
        return None
    first = design.indenter.model_copy(update={"depth_mm": design.indenter.depth_mm / increments})
    try:
        shallow = design.model_copy(update={"indenter": first})
        return press_finger(shallow, "coarse", 1, threads, watch.coarse, contact="penalty", budget_s=watch.left_s)
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
