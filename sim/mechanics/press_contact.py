"""Contact of a press: the fast penalty on exact distances, or the barrier with friction and contact of the ribs."""

from dataclasses import replace
from pathlib import Path
from typing import Literal, Protocol

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from data_schemas.design import FingerDesign
from data_schemas.errors import SimulateError
from sim.mechanics.assembly import State, Term
from sim.mechanics.body_meshes import TriangleMesh
from sim.mechanics.contact_analytic import PenaltyContact
from sim.mechanics.contact_ipc import Barrier, BarrierContact, Obstacle
from sim.mechanics.indenters import RigidIndenter, rigid_indenter
from sim.mechanics.mesh import FingerMesh
from sim.mechanics.newton import Supports
from sim.surface_meshes.hexahedra import boundary_quads, split_quads

FloatArray = NDArray[np.float64]
ContactKind = Literal["penalty", "barrier"]
ContactChoice = Literal["auto", "penalty", "barrier"]

# contact sinks in by pressure / stiffness: at a tenth of the gel's modulus by a thousandth of an element
_CONTACT_MODULI_PER_STEP = 100.0
# facets of the indenter that stay this far from the finger's box throughout the push are left out
_OUT_OF_REACH_MM = 3.0


class PressContact(Protocol):
    """What a press needs of its contact; `mesh` is the finger's, with one more node where the indenter is one."""

    mesh: FingerMesh
    terms: tuple[Term, ...]
    note: str

    def push(self, depth_mm: float) -> Supports:
        """Move the indenter to a depth and return the supports; lagged forces are those of the last increment."""
        ...

    def settle(self, state: State) -> bool:
        """Renew lagged forces at an equilibrium; return whether it still is one."""
        ...

    def accept(self, state: State) -> None:
        """Let the next increment begin at a stored state."""
        ...

    def force_n(self, u: FloatArray) -> FloatArray:
        """Return the force on the indenter (3,)."""
        ...

    def pressures_mpa(self, u: FloatArray) -> FloatArray:
        """Return the pressure at q points of the coat's f faces, (f, q)."""
        ...

    def touch_mm(self) -> FloatArray:
        """Return where these points lie in the undeformed pad, (f, q, 3)."""
        ...


def chosen_contact(design: FingerDesign, wanted: ContactChoice = "auto") -> ContactKind:
    """Return the contact of a press: the penalty where it can, the barrier for friction and meshes of the user.

    Raises
    ------
    SimulateError
        When the penalty is asked for where only the barrier serves.
    """
    indenter = design.indenter
    needs = [
        *([f"indenter.friction = {indenter.friction:g}"] if indenter.friction > 0.0 else []),
        *(['indenter.shape = "mesh"'] if indenter.shape == "mesh" else []),
    ]
    if wanted == "penalty" and needs:
        raise SimulateError(f"--contact penalty cannot serve {' and '.join(needs)}: use --contact barrier, or auto")
    if wanted == "auto":
        return "barrier" if needs else "penalty"
    return wanted


def press_contact(
    design: FingerDesign,
    mesh: FingerMesh,
    step_mm: float,
    wanted: ContactChoice = "auto",
    threads: int = 1,
    folder: Path = Path(),
    barrier: Barrier | None = None,
) -> PressContact:
    """Return the contact of a finger with its indenter at first touch.

    Parameters
    ----------
    design, mesh
        Finger.
    step_mm
        Edge of the pad's elements.
    wanted
        See :func:`chosen_contact`.
    threads
        Of the barrier.
    folder
        Where the design stands.
    barrier
        How the barrier acts; by default its stiffness is the gel's shear modulus.

    Raises
    ------
    SimulateError
        See :func:`chosen_contact` and :func:`~sim.mechanics.indenters.rigid_indenter`.
    """
    kind = chosen_contact(design, wanted)
    indenter = rigid_indenter(design, folder)
    shear_mpa = 2.0 * design.mechanics.gel.c10_mpa
    if kind == "penalty":
        return _PenaltyPress(mesh, indenter, _CONTACT_MODULI_PER_STEP * shear_mpa / step_mm)
    chosen = barrier or Barrier(stiffness_mpa=shear_mpa)
    return _BarrierPress(design, mesh, indenter, replace(chosen, friction_ratio=design.indenter.friction), threads)


class _PenaltyPress:
    """The coat against exact distances of the indenter."""

    def __init__(self, mesh: FingerMesh, indenter: RigidIndenter, stiffness_mpa_per_mm: float) -> None:
        if indenter.body is None:
            raise SimulateError("a mesh of the user has no exact distances: use --contact barrier, or auto")
        self.mesh, self._indenter = mesh, indenter
        coat = mesh.surfaces["coat"]
        self._contact = PenaltyContact(
            mesh.nodes_mm, coat, indenter.body, indenter.touching, stiffness_mpa_per_mm, curvature=False
        )
        self.terms: tuple[Term, ...] = (self._contact,)
        self._supports = Supports.at_rest(len(mesh.nodes_mm), mesh.node_sets["fixed"])
        self.note = "contact by penalty: frictionless; the indenter's distance is exact; ribs do not see each other"

    def push(self, depth_mm: float) -> Supports:
        self._contact.place(self._indenter.pose(depth_mm))
        return self._supports

    def settle(self, state: State) -> bool:
        return True

    def accept(self, state: State) -> None:
        return

    def force_n(self, u: FloatArray) -> FloatArray:
        return self._contact.force_n(u)

    def pressures_mpa(self, u: FloatArray) -> FloatArray:
        return self._contact.pressures_mpa(u)

    def touch_mm(self) -> FloatArray:
        return self._contact.points_mm(np.zeros_like(self.mesh.nodes_mm))


class Drive:
    """A :class:`~sim.mechanics.assembly.Term` that pulls one displacement to a target: k/2 (u - t)^2 + l (u - t).

    A prescribed motion would stop where the barrier's step limit does, far from any equilibrium; a stiff spring gives
    the way there an energy. Its force l is renewed until the target is met.

    Parameters
    ----------
    node, axis
        What is driven.
    stiffness_n_per_mm
        k.
    met_mm
        How near the target must be.
    """

    def __init__(self, node: int, axis: int, stiffness_n_per_mm: float = 1e4, met_mm: float = 1e-4) -> None:
        self.target_mm = 0.0
        self._node, self._axis, self._k, self._met, self._force = node, axis, stiffness_n_per_mm, met_mm, 0.0

    def _off(self, u: FloatArray) -> float:
        return float(u[self._node, self._axis]) - self.target_mm

    def energy(self, u: FloatArray) -> float:
        """Return the energy in N mm."""
        off = self._off(u)
        return 0.5 * self._k * off**2 + self._force * off

    def gradient(self, u: FloatArray) -> FloatArray:
        """Return its derivative in N, shape (n, 3)."""
        out = np.zeros_like(u)
        out[self._node, self._axis] = self._k * self._off(u) + self._force
        return out

    def hessian(self, u: FloatArray, project: bool) -> sp.coo_array | sp.csr_array:
        """Return k at its place."""
        at = np.array([3 * self._node + self._axis])
        return sp.coo_array((np.array([self._k]), (at, at)), shape=(u.size, u.size))

    def max_step(self, u: FloatArray, du: FloatArray) -> float:
        """Return 1."""
        return 1.0

    def settle(self, u: FloatArray) -> bool:
        """Renew the force at an equilibrium; return whether the target was met."""
        off = self._off(u)
        self._force += self._k * off
        return abs(off) <= self._met


class _BarrierPress:
    """All surfaces of the finger among themselves and against the indenter's triangles."""

    def __init__(
        self, design: FingerDesign, mesh: FingerMesh, indenter: RigidIndenter, barrier: Barrier, threads: int
    ) -> None:
        reference = len(mesh.nodes_mm)
        place = np.array([indenter.touching.position_mm])
        self.mesh = replace(mesh, nodes_mm=np.concatenate([mesh.nodes_mm, place]))
        # the push counts from where the barrier begins: surfaces rest a little below its reach
        start = indenter.vertices_mm(barrier.reach_mm)
        near = _within_reach(start, indenter.surface, mesh.nodes_mm, design.indenter.depth_mm)
        obstacle = Obstacle(near.vertices_mm, near.triangles, reference)
        self.contact = BarrierContact(self.mesh.nodes_mm, outer_triangles(mesh), obstacle, barrier, threads=threads)
        self._drive = Drive(reference, 1)
        self.terms: tuple[Term, ...] = (self.contact, self._drive)
        self._supports = Supports.at_rest(reference + 1, mesh.node_sets["fixed"])
        self._supports.fixed[reference] = (True, False, True)
        self.note = (
            f"contact by a barrier: surfaces, the ribs' among them, keep a gap below {barrier.reach_mm:g} mm, from "
            f"which the push counts; friction {barrier.friction_ratio:g} between indenter and finger, none elsewhere"
        )

    def push(self, depth_mm: float) -> Supports:
        self.contact.restart()
        self._drive.target_mm = -depth_mm
        return self._supports

    def settle(self, state: State) -> bool:
        there = self._drive.settle(state.u_mm)
        return self.contact.settle(state.u_mm) and there

    def accept(self, state: State) -> None:
        self.contact.accept(state.u_mm)

    def force_n(self, u: FloatArray) -> FloatArray:
        return self.contact.force_n(u)

    def pressures_mpa(self, u: FloatArray) -> FloatArray:
        return self.contact.pressures_mpa(u, self.mesh.surfaces["coat"])

    def touch_mm(self) -> FloatArray:
        return np.asarray(self.mesh.nodes_mm[self.mesh.surfaces["coat"]])


def outer_triangles(mesh: FingerMesh) -> NDArray[np.int64]:
    """Return the triangles (k, 3) of everything that can be touched: the boundary of all blocks that share nodes."""
    return split_quads(boundary_quads(np.concatenate(list(mesh.hexahedra.values()))).quads, mesh.nodes_mm)


def _within_reach(vertices: FloatArray, surface: TriangleMesh, nodes_mm: FloatArray, depth_mm: float) -> TriangleMesh:
    """Return the facets that can come near the finger, whose parts move by up to the push."""
    corners = vertices[surface.triangles]
    low, high = corners.min(axis=1), corners.max(axis=1)
    margin = depth_mm + _OUT_OF_REACH_MM
    near = ((low <= nodes_mm.max(axis=0) + margin) & (high >= nodes_mm.min(axis=0) - margin)).all(axis=1)
    used, numbers = np.unique(surface.triangles[near], return_inverse=True)
    return TriangleMesh(vertices[used], numbers.reshape(-1, 3))
