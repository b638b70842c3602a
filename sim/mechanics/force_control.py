"""Press until a force is reached."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from data_schemas.design import FingerDesign
from data_schemas.errors import NoEquilibriumError, SimulateError
from data_schemas.mechanical_design import Preset
from sim.mechanics.assembly import Assembly, State, Term
from sim.mechanics.contact_analytic import PenaltyContact
from sim.mechanics.elements import Elasticity
from sim.mechanics.finger_mesh import STEPS, finger_mesh
from sim.mechanics.finger_parts import finger_materials, finger_ties
from sim.mechanics.increments import Extrapolation, load_increments
from sim.mechanics.indenters import rigid_indenter
from sim.mechanics.linear_solver import SymmetricSolver, linear_solver
from sim.mechanics.loads import DeadForce
from sim.mechanics.newton import Supports, find_equilibrium
from sim.mechanics.penalty_press import PenaltyTouch, penalty_mpa_per_mm
from sim.mechanics.pressed_finger import PressedFinger, PressHistory

FloatArray = NDArray[np.float64]
Progress = Callable[[int, int, str], None]

_TOUCH_MM = 0.1  # pushed in by displacement first: without contact nothing would hold an indenter under a force


def press_to_force(
    design: FingerDesign,
    force_n: float,
    preset: Preset | None = None,
    increments: int = 4,
    threads: int = 1,
    folder: Path = Path(),
    progress: Progress | None = None,
) -> PressedFinger:
    """Press the design's indenter in along the pad's normal until it pushes with a force; without friction.

    The indenter is a node that a dead force drives; it is free along the normal only. Where the force falls with the
    push (buckling), the push jumps on to where the force is reached again.

    Parameters
    ----------
    design
        Finger, materials and indenter; ``indenter.depth_mm`` plays no part.
    force_n
        Along the pad's normal, towards the finger.
    preset, threads
        See :func:`sim.mechanics.press.press_finger`.
    increments
        Equal parts of the force.
    folder
        Where the design stands.
    progress
        Called after each increment.

    Returns
    -------
    PressedFinger
        Its mesh has one node more than the finger's, the last: the indenter.

    Raises
    ------
    SimulateError
        When the force is not positive, the indenter has no exact distances (a mesh of the user) or friction, or not
        even the first part of the force finds an equilibrium.
    """
    check_force(design, force_n)
    touch = _DrivenIndenter(design, preset, folder)
    ties = finger_ties(design, touch.mesh, STEPS[preset or design.mesh.preset].skeleton_mm)
    assembly = Assembly(Elasticity(touch.mesh, finger_materials(design), threads), [*touch.terms, *ties])
    solver = linear_solver(threads=threads)
    touched = touch.first_touch(assembly, solver)
    begin = float(touch.force_n(touched.u_mm)[1]) / force_n
    predict = Extrapolation()
    predict(assembly.at_rest(), 0.0, 0.0)
    stops = [(k + 1) / increments for k in range(increments)]
    history = PressHistory(assembly, ties, touch)
    reached_n = 0.0
    try:
        for step in load_increments(
            assembly, solver, lambda share: touch.push_with(share * force_n), stops, touched, begin, predict=predict
        ):
            depth_mm, reached_n = touch.depth_mm(step.equilibrium.state), step.fraction * force_n
            history.add(depth_mm, step.equilibrium)
            if progress is not None:
                reached = sum(step.fraction >= stop for stop in stops)
                progress(reached, increments, f"pressed with {reached_n:.2f} N to {depth_mm:.2f} mm")
    except NoEquilibriumError as stuck:
        if history.depth_mm is None:
            raise
        touch.push_with(reached_n)
        return history.pressed(str(stuck))
    return history.pressed()


def check_force(design: FingerDesign, force_n: float) -> None:
    """Check that a design's indenter can be pressed to a force.

    Raises
    ------
    SimulateError
        See :func:`press_to_force`.
    """
    if not 0.0 < force_n < np.inf:
        raise SimulateError(f"force_n = {force_n:g} N: a press needs a finite force above 0 N")
    if design.indenter.shape == "mesh" or design.indenter.friction > 0.0:
        raise SimulateError(
            "a press to a force is without friction and on exact distances: give indenter.friction = 0 and a cylinder, "
            "ball or cuboid, or press to a depth"
        )


class _DrivenIndenter(PenaltyTouch):
    """The coat against exact distances of an indenter that is a node of its own, driven by a force."""

    def __init__(self, design: FingerDesign, preset: Preset | None, folder: Path) -> None:
        indenter, finger = rigid_indenter(design, folder), finger_mesh(design, preset)
        if indenter.body is None:
            raise SimulateError("a press to a force needs a cylinder, ball or cuboid; press a mesh to a depth")
        self._node = len(finger.nodes_mm)
        mesh = replace(finger, nodes_mm=np.concatenate([finger.nodes_mm, [indenter.touching.position_mm]]))
        self._step_mm = STEPS[preset or design.mesh.preset].pad_mm
        contact = PenaltyContact(
            mesh.nodes_mm, mesh.surfaces["coat"], indenter.body, indenter.pose(_TOUCH_MM),
            penalty_mpa_per_mm(design, self._step_mm), reference_node=self._node, curvature=False,
        )  # fmt: skip
        super().__init__(mesh, contact)
        self._force = DeadForce(np.array([self._node]))
        self.terms: tuple[Term, ...] = (contact, self._force)
        self._held = Supports.at_rest(self._node + 1, np.append(mesh.node_sets["fixed"], self._node))
        self._free = self._held.fixed.copy()
        self._free[self._node, 1] = False

    @property
    def note(self) -> str:
        """How the surfaces touch, and what drives the indenter."""
        return f"{super().note}; the indenter is driven by a force of {-self._force.force_n[1]:g} N"

    def first_touch(self, assembly: Assembly, solver: SymmetricSolver) -> State:
        """Return the equilibrium at a small push without the force.

        Raises
        ------
        NoEquilibriumError
            When there is none, or the coat is not touched: nothing would hold the indenter under a force.
        """
        touched = find_equilibrium(assembly, assembly.at_rest(), self._held, solver)
        if touched.failure:
            why = f"{touched.failure}; try a finer mesh"
            raise NoEquilibriumError(f"no equilibrium at a push of {_TOUCH_MM:g} mm: {why}")
        if not self.force_n(touched.state.u_mm)[1] > 0.0:
            raise NoEquilibriumError(
                f"at a push of {_TOUCH_MM:g} mm, from which the force begins, the indenter touches no node of the "
                f"coat, whose elements are {self._step_mm:g} mm wide: press with a finer [mesh] preset, or to a "
                "depth with --contact barrier"
            )
        return touched.state

    def push_with(self, force_n: float) -> Supports:
        """Set the force and return the supports."""
        self._force.force_n[1] = -force_n
        return Supports(self._free, np.zeros_like(self.mesh.nodes_mm))

    def depth_mm(self, state: State) -> float:
        """Return the push from first touch."""
        return _TOUCH_MM - float(state.u_mm[self._node, 1])
