r"""Derivatives of an equilibrium by anything that its energy depends on, through one factorisation.

.. math:: R(u, q) = 0, \qquad K \frac{du}{dq} = -\frac{\partial R}{\partial q}, \qquad
    \frac{dF}{dq} = \frac{\partial F}{\partial q} + \frac{\partial F}{\partial u} \cdot \frac{du}{dq}, \qquad
    \frac{d\Pi}{dq} = \frac{\partial \Pi}{\partial q}

R is the gradient of the energy Pi with the incompatible modes eliminated, K its exact second derivative: with the
contact's curvature, without projection. R and Pi at the same displacement of two designs, a little to both sides, give
the partial derivatives; a whole press is never differenced. Only the blocks whose material or nodes change are
evaluated. Forward mode: one solution for each number gives force and surface alike.

Exact where the energy is smooth. It is not where a point of the coat begins to touch (the penalty's second derivative
jumps), where friction depends on earlier increments, and where ribs snap: an equilibrium that is not stable is refused.
"""

from collections.abc import Mapping
from copy import copy
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from data_schemas import FingerDesign, NoEquilibriumError, SimulateError
from sim.mechanics._assembly import Assembly, Elasticity, State, Term, add_forces
from sim.mechanics._finger_mesh import STEPS, finger_materials, finger_mesh, finger_ties
from sim.mechanics._increments import with_own_modes
from sim.mechanics._indenters import rigid_indenter
from sim.mechanics._linear_solver import SymmetricSolver, linear_solver
from sim.mechanics._mesh import FingerMesh
from sim.mechanics._newton import NewtonOptions, Supports, find_equilibrium
from sim.mechanics._penalty_contact import PenaltyContact, PenaltyPress, penalty_mpa_per_mm
from sim.mechanics._press import PressedFinger, PressSettings

FloatArray = NDArray[np.float64]

_UNSTABLE = (
    "the finger is about to snap (its stiffness has a negative curvature): a derivative there would not hold over any "
    "distance; press less deeply, or take differences of whole presses"
)


@dataclass(frozen=True, slots=True)
class DesignChange:
    """A number of a design, a little to both sides of its value.

    Attributes
    ----------
    low, high
        The design with the number below and above; the meshes must have the same hexahedra.
    step
        By how much the number, or its logarithm, differs between them: some 1e-5 of it.
    """

    low: FingerDesign
    high: FingerDesign
    step: float


@dataclass(frozen=True, slots=True)
class PressDerivatives:
    """Derivatives of a press of k increments by p numbers, each over :attr:`DesignChange.step`.

    Attributes
    ----------
    names
        Of the numbers, (p,).
    force_n
        Of the force on the indenter, (k, p, 3).
    energy_n_mm
        Of the stored energy, (k, p).
    displacement_mm
        Of the nodes at the last increment, (p, n, 3).
    refused
        Why a number has no derivatives, by its name.
    """

    names: tuple[str, ...]
    force_n: FloatArray
    energy_n_mm: FloatArray
    displacement_mm: FloatArray
    refused: Mapping[str, str]


class StableEquilibrium:
    """The stiffness of an equilibrium, factorised once.

    Parameters
    ----------
    assembly
        What is in equilibrium.
    supports
        What is held.
    state
        The equilibrium.
    solver
        Factorises.
    push
        How the supports move with the push d, du/dd (n, 3) of them; none: they rest.

    Attributes
    ----------
    follow
        du/dd of all nodes (n, 3). With it dF/dq = dR/dq . du/dd, of the force F = dPi/dd that pushes.

    Raises
    ------
    NoEquilibriumError
        When it is about to snap.
    """

    def __init__(
        self,
        assembly: Assembly,
        supports: Supports,
        state: State,
        solver: SymmetricSolver,
        push: FloatArray | None = None,
    ) -> None:
        assembly.assemble(state)
        self._fixed, self._solver = supports.fixed, solver
        pulled = None if push is None else assembly.matrix.times(push.ravel()).reshape(-1, 3)
        assembly.matrix.constrain(supports.fixed.ravel())
        solver.factorise(assembly.matrix.upper(), assembly.matrix.version)
        if not solver.definite:
            raise NoEquilibriumError(_UNSTABLE)
        self.follow = np.zeros_like(state.u_mm)
        if push is not None and pulled is not None:
            self.follow = np.where(self._fixed, push, self.moved_mm(pulled))

    def moved_mm(self, forces_n: FloatArray) -> FloatArray:
        """Return du/dq (n, 3) of dR/dq (n, 3)."""
        right = np.where(self._fixed, 0.0, -forces_n)
        return self._solver.solve(right.ravel()).reshape(-1, 3)


def residual_and_energy(elasticity: Elasticity, state: State) -> tuple[FloatArray, float]:
    """Return the gradient of the elastic energy (n, 3) in N, with the modes eliminated, and the energy in N mm."""
    gradient = np.zeros((elasticity.count, 3))
    for part in elasticity.matrices(state.u_mm, state.modes):
        add_forces(elasticity.cells[part.block][part.elements], part.force, gradient)
    return gradient, elasticity.energy(state.u_mm, state.modes)


class _Side:
    """A changed design: the parts of its energy that the change reaches."""

    def __init__(self, design: FingerDesign, base: "_Base", settings: PressSettings, folder: Path) -> None:
        before, mesh = base.design, base.mesh
        steps = STEPS[settings.preset or before.mesh.preset]
        same_shape = design.model_copy(update={"mechanics": before.mechanics}) == before
        own = mesh if same_shape else finger_mesh(design, settings.preset)
        _require_same_hexahedra(own, mesh)
        moved = (own.nodes_mm != mesh.nodes_mm).any(axis=1)
        materials, old = finger_materials(design), finger_materials(before)
        self._blocks = [
            k for k, b in enumerate(own.blocks)
            if materials[b.material] != old[b.material] or moved[b.hexahedra].any()
        ]  # fmt: skip
        self._elasticity = None
        if self._blocks:
            changed = replace(own, blocks=tuple(own.blocks[k] for k in self._blocks))
            self._elasticity = Elasticity(changed, materials, settings.threads)
        self._ties = finger_ties(design, own, steps.skeleton_mm)
        indenter = base.indenter if same_shape else rigid_indenter(design, folder)
        self._touch = PenaltyPress(own, indenter, penalty_mpa_per_mm(design, steps.pad_mm))
        self._depth_mm, self._before_mm = design.indenter.depth_mm, before.indenter.depth_mm

    def at(self, state: State, depth_mm: float) -> tuple[FloatArray, FloatArray, float]:
        """Return the gradient of these parts and of it that of the contact, both (n, 3), and their energy.

        A change of the push acts on each increment's.
        """
        self._touch.push(depth_mm * self._depth_mm / self._before_mm)
        u = state.u_mm
        of_contact = sum((term.gradient(u) for term in self._touch.terms), np.zeros_like(u))
        gradient = of_contact + sum(tie.gradient(u) for tie in self._ties)
        energy = sum(term.energy(u) for term in (*self._touch.terms, *self._ties))
        if self._elasticity is not None:
            own = State(u, tuple(state.modes[k] for k in self._blocks))
            elastic, stored = residual_and_energy(self._elasticity, own)
            gradient, energy = gradient + elastic, energy + stored
        return gradient, of_contact, energy


def _require_same_hexahedra(mesh: FingerMesh, other: FingerMesh) -> None:
    """Check that two meshes differ in the places of their nodes only.

    Raises
    ------
    SimulateError
        When they do not.
    """
    pairs = [(mesh.hexahedra, other.hexahedra), (mesh.surfaces, other.surfaces), (mesh.node_sets, other.node_sets)]
    if not all(
        one.keys() == two.keys() and all(np.array_equal(one[name], two[name]) for name in one) for one, two in pairs
    ):
        raise SimulateError(
            "this number has no derivative, because a small change of it changes the mesh and thereby the force; take "
            "the difference of two whole presses"
        )


def press_derivatives(
    design: FingerDesign,
    pressed: PressedFinger,
    changes: Mapping[str, DesignChange],
    settings: PressSettings | None = None,
    folder: Path = Path(),
) -> PressDerivatives:
    """Return the derivatives of a press's forces, energies and displacements by numbers of its design.

    The stiffness of contact and ties, which follows the materials, changes with them, as in a new press.

    Parameters
    ----------
    design, folder
        As they went into :func:`~sim.mechanics.press_finger`.
    pressed
        What came out, by the penalty and from first touch.
    changes
        The numbers by name.
    settings
        Preset and threads of the press.

    Raises
    ------
    SimulateError
        When the press is not by the penalty, has friction or contact between the finger's parts, or an increment of it
        is about to snap.
    """
    settings = settings or PressSettings()
    if pressed.kind != "penalty" or pressed.motion is not None or design.indenter.friction > 0.0:
        raise SimulateError(
            "derivatives need a press along the pad's normal with penalty contact and without friction, because with "
            "friction or a path the force depends on earlier increments; take differences of whole presses"
        )
    if pressed.parts_touch_from_mm is not None:
        raise SimulateError(
            "derivatives do not include contact between parts of the finger, but parts touched in this press; press "
            "less deeply, or take differences of whole presses"
        )
    base = _Base(design, pressed.mesh, settings, folder)
    sides: dict[str, tuple[_Side, _Side]] = {}
    refused = {}
    for name, change in changes.items():
        try:
            low, high = (_Side(changed, base, settings, folder) for changed in (change.low, change.high))
            sides[name] = (low, high)
        except SimulateError as why:
            refused[name] = str(why)
    forces, energies, moved = [], [], np.empty((0, len(pressed.mesh.nodes_mm), 3))
    for k in range(len(pressed.depth_mm)):
        rows = base.at(pressed, k, sides, changes)
        forces.append([row[0] for row in rows])
        energies.append([row[1] for row in rows])
        moved = np.array([row[2] for row in rows]).reshape(-1, *moved.shape[1:])
    count = len(pressed.depth_mm), len(sides)
    return PressDerivatives(
        tuple(sides), np.array(forces).reshape(*count, 3), np.array(energies).reshape(count), moved, refused
    )


class _Base:
    """The unchanged finger with its exact contact."""

    def __init__(self, design: FingerDesign, mesh: FingerMesh, settings: PressSettings, folder: Path) -> None:
        steps = STEPS[settings.preset or design.mesh.preset]
        self.design, self.mesh, self.indenter = design, mesh, rigid_indenter(design, folder)
        self._touch = PenaltyPress(mesh, self.indenter, penalty_mpa_per_mm(design, steps.pad_mm))
        # one after the other, they share the pose
        self._contacts = [_exact(term) for term in self._touch.terms]
        ties = finger_ties(design, mesh, steps.skeleton_mm)
        elasticity = Elasticity(mesh, finger_materials(design), settings.threads)
        self._assembly = Assembly(elasticity, [*self._contacts, *ties])
        self._solver = linear_solver(threads=settings.threads)

    def at(
        self,
        pressed: PressedFinger,
        increment: int,
        sides: Mapping[str, tuple["_Side", "_Side"]],
        changes: Mapping[str, DesignChange],
    ) -> list[tuple[FloatArray, float, FloatArray]]:
        """Return the derivatives of force (3,), energy and displacement (n, 3) at an increment, number by number."""
        depth_mm = float(pressed.depth_mm[increment])
        state, supports = self._equilibrium(pressed, increment, depth_mm)
        stable = StableEquilibrium(self._assembly, supports, state, self._solver)
        pulls = [contact.hessian(state.u_mm, project=False).tocsr() for contact in self._contacts]
        found = []
        for name, pair in sides.items():
            (low, low_contact, less), (high, high_contact, more) = (side.at(state, depth_mm) for side in pair)
            step = changes[name].step
            moved = stable.moved_mm((high - low) / step)
            force = (high_contact - low_contact).sum(axis=0) / step
            force += sum(((pull @ moved.ravel()).reshape(-1, 3).sum(axis=0) for pull in pulls), np.zeros(3))
            found.append((force, (more - less) / step, moved))
        return found

    def _equilibrium(self, pressed: PressedFinger, increment: int, depth_mm: float) -> tuple[State, Supports]:
        """Return an increment of a press with its modes, which only the last one has stored."""
        supports = self._touch.push(depth_mm)
        for term, own in zip(self._contacts, self._touch.terms, strict=True):
            term.place(_exact(own).pose)
        u, last = pressed.displacement_mm[increment], increment == len(pressed.depth_mm) - 1
        state = State(u, pressed.modes_mm if last else self._assembly.elasticity.no_modes)
        if not last:
            state = with_own_modes(self._assembly, state)
        # the equilibrium of the press itself, also where it is a saddle, which StableEquilibrium refuses
        reached = find_equilibrium(self._assembly, state, supports, self._solver, NewtonOptions(stable=False))
        if reached.failure:
            raise NoEquilibriumError(
                f"increment {increment + 1} is not an equilibrium of this design: {reached.failure}"
            )
        return reached.state, supports


def _exact(term: Term) -> PenaltyContact:
    """Return a contact by the penalty with its whole second derivative.

    Raises
    ------
    SimulateError
        When it is another contact.
    """
    if not isinstance(term, PenaltyContact):
        raise SimulateError("derivatives need a press with penalty contact; press with --contact penalty")
    exact = copy(term)
    exact.curvature = True
    return exact
