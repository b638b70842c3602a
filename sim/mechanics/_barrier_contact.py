"""Contact by a barrier on distances (incremental potential contact): parts and any indenter, lagged friction.

It cannot be imported where the IPC Toolkit does not run (see :mod:`sim.mechanics._contact_library`).
"""

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from data_schemas import ContactKind, FingerDesign
from sim.mechanics._assembly import State, Term
from sim.mechanics._colliding_surfaces import CollidingSurfaces, Obstacle
from sim.mechanics._contact_library import contact_library
from sim.mechanics._increments import LAGGED_REL
from sim.mechanics._indenters import RigidIndenter
from sim.mechanics._materials import material_of
from sim.mechanics._mesh import FingerMesh, outer_triangles
from sim.mechanics._newton import Supports
from sim.mechanics._rigid_bodies import TriangleMesh

if TYPE_CHECKING:
    import ipctk
else:
    ipctk = contact_library()

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

# pairs within this distance get their place in the matrix together, five times the reach: a new pattern costs about one
# factorisation, and places that stay empty cost each of them (at 0.5 mm five times as long with thin ribs)
_RESERVE_MM = 0.1


@dataclass(frozen=True, slots=True)
class Barrier:
    """How contact acts.

    Parameters
    ----------
    reach_mm
        Distance d below which surfaces push each other apart; they rest at a gap somewhat below it.
    stiffness_mpa
        Scale of the pressure, of the order of the softest part's shear modulus: more makes the gap nearer to d.
    friction_ratio
        Coulomb's coefficient between the indenter and everything else; other pairs slide freely.
    stick_mm
        Slip of an increment below which friction grows smoothly from zero.
    settled_rel
        Friction is settled when the forces at the lagged and at the new normal forces differ by less than this share
        of the normal forces.
    """

    reach_mm: float = 0.02
    stiffness_mpa: float = 0.3
    friction_ratio: float = 0.0
    stick_mm: float = 1e-3
    settled_rel: float = 1e-3


class BarrierContact:
    r"""A :class:`~sim.mechanics._assembly.Term`: Pi = sum_c w_c kappa d b(d_c / d) + sum_c mu N_c f0(|slip_c|).

    b(t) = -(t - 1)^2 ln t for t < 1 in the physical scaling of the IPC Toolkit, w the area of a pair; N and the
    directions of slip are lagged. :class:`CollidingSurfaces` decides which pairs c count.

    Parameters
    ----------
    nodes_mm
        Nodes at rest (n, 3), with the obstacle's reference node.
    triangles
        Surfaces that may touch, (t, 3), outward.
    obstacle
        The indenter; none for contact of the parts alone.
    barrier
        How contact acts.
    project
        Whether curvature is without its negative part, even where Newton's method does not ask for it, until lagged
        forces have settled: far from an equilibrium that takes fewer steps, near to it more.
    threads
        Of the IPC Toolkit.
    tied
        Nodes of faces that are tied to each other, (k,).

    Raises
    ------
    SimulateError
        When the obstacle starts inside the parts.
    """

    def __init__(
        self,
        nodes_mm: FloatArray,
        triangles: IntArray,
        obstacle: Obstacle | None = None,
        barrier: Barrier | None = None,
        project: bool = True,
        threads: int = 1,
        tied: IntArray | None = None,
    ) -> None:
        ipctk.set_num_threads(threads)
        ipctk.set_logger_level(ipctk.LoggerLevel.error)
        self.barrier = barrier or Barrier()
        self.obstacle = obstacle
        self._count = len(nodes_mm)
        self._project = self._projects = project
        self._surfaces = CollidingSurfaces(nodes_mm, triangles, obstacle, self.barrier.reach_mm, tied)
        self._mesh = self._surfaces.mesh
        self._potential = ipctk.BarrierPotential(self.barrier.reach_mm, self.barrier.stiffness_mpa, True)
        self._friction = ipctk.FrictionPotential(self.barrier.stick_mm)
        self._lag: ipctk.TangentialCollisions | None = None
        vertices = np.arange(len(self._surfaces.rest_mm))
        # the toolkit takes the mean of both sides' coefficients
        self._ratio = np.where(vertices >= self._surfaces.own, 2.0 * self.barrier.friction_ratio, 0.0)
        self._begin = self._end = self._surfaces.vertices_mm(np.zeros((self._count, 3)))
        self._reserved = self._first_places(triangles, obstacle)

    def _first_places(self, triangles: IntArray, obstacle: Obstacle | None) -> IntArray:
        """Return the pairs of nodes, low * n + high, that the matrix has anyway, or reserves from the start."""
        pairs = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
        if obstacle is not None:
            nodes = self._surfaces.nodes
            to_body = np.column_stack([nodes, np.full(len(nodes), obstacle.reference_node)])
            pairs = np.concatenate([pairs, to_body])
        return self._keys(pairs)

    def _keys(self, pairs: IntArray) -> IntArray:
        return np.unique(pairs.min(axis=1) * self._count + pairs.max(axis=1))

    def gap_mm(self, u: FloatArray) -> float:
        """Return the least distance; infinity where nothing is within the barrier's reach."""
        return self._surfaces.gap_mm(self._surfaces.vertices_mm(u))

    def pairs_of_parts(self, u: FloatArray) -> int:
        """Return how many pairs within the barrier's reach are the parts' own, not the obstacle's."""
        return self._surfaces.pairs_of_parts(self._surfaces.vertices_mm(u))

    def energy(self, u: FloatArray) -> float:
        """Return Pi in N mm."""
        energy = self.barrier_energy(u)
        if self._lag is not None:
            energy += float(self._friction(self._lag, self._mesh, self._slip(self._surfaces.vertices_mm(u))))
        return energy if np.isfinite(energy) else np.inf

    def barrier_energy(self, u: FloatArray) -> float:
        """Return the first sum of Pi in N mm: what pushes surfaces apart, which is stored."""
        vertices = self._surfaces.vertices_mm(u)
        return float(self._potential(self._surfaces.collisions(vertices), self._mesh, vertices))

    def friction_work_n_mm(self, u: FloatArray) -> float:
        """Return the work lost to friction since the increment began: forces at `u` along the slip up to there."""
        return float((self._friction_forces(u) * self._slip(self._surfaces.vertices_mm(u))).sum())

    def gradient(self, u: FloatArray) -> FloatArray:
        """Return dPi/du in N, shape (n, 3)."""
        return self._to_nodes(self.normal_forces_n(u) + self._friction_forces(u))

    def _to_nodes(self, forces: FloatArray) -> FloatArray:
        out = np.zeros((self._count, 3))
        np.add.at(out, self._surfaces.mover, forces)
        return out

    def normal_forces_n(self, u: FloatArray) -> FloatArray:
        """Return the barrier's derivative by each vertex (v, 3) in N: surface nodes, then the obstacle's vertices."""
        vertices = self._surfaces.vertices_mm(u)
        return np.asarray(
            self._potential.gradient(self._surfaces.collisions(vertices), self._mesh, vertices), dtype=np.float64
        ).reshape(-1, 3)

    def _friction_forces(self, u: FloatArray) -> FloatArray:
        if self._lag is None:
            return np.zeros_like(self._surfaces.rest_mm)
        slip = self._slip(self._surfaces.vertices_mm(u))
        return np.asarray(self._friction.gradient(self._lag, self._mesh, slip), dtype=np.float64).reshape(-1, 3)

    def _slip(self, vertices: FloatArray) -> FloatArray:
        return np.asfortranarray(vertices - self._begin)

    def force_n(self, u: FloatArray) -> FloatArray:
        """Return the force on the obstacle (3,)."""
        if self.obstacle is None:
            return np.zeros(3)
        return np.asarray(-self.gradient(u)[self.obstacle.reference_node])

    def pressures_mpa(self, u: FloatArray, nodes: IntArray) -> FloatArray:
        """Return the normal force of surface nodes over their area at rest, shape of `nodes`; 0 for other nodes."""
        own = self._surfaces.own
        push = np.linalg.norm(self.normal_forces_n(u)[:own], axis=1) / np.asarray(self._mesh.vertex_areas)[:own]
        of_node = np.zeros(self._count)
        of_node[self._surfaces.nodes] = push
        return np.asarray(of_node[nodes])

    def hessian(self, u: FloatArray, project: bool) -> sp.coo_array | sp.csr_array:
        """Return the second derivative; zeros reserve the places of all pairs that have been near."""
        method = ipctk.PSDProjectionMethod.CLAMP if project or self._projects else ipctk.PSDProjectionMethod.NONE
        vertices = self._surfaces.vertices_mm(u)
        found = self._potential.hessian(self._surfaces.collisions(vertices), self._mesh, vertices, method)
        if self._lag is not None:
            found = found + self._friction.hessian(self._lag, self._mesh, self._slip(vertices), method)
        entries = sp.coo_array(found)
        vertex, axis = np.divmod(entries.row, 3)
        other, other_axis = np.divmod(entries.col, 3)
        node, other_node = self._surfaces.mover[vertex], self._surfaces.mover[other]
        self._reserve(vertices, node, other_node)
        low, high = np.divmod(self._reserved, self._count)
        rows = np.concatenate([3 * node + axis, 3 * low])
        cols = np.concatenate([3 * other_node + other_axis, 3 * high])
        values = np.concatenate([entries.data, np.zeros(len(low))])
        return sp.coo_array((values, (rows, cols)), shape=(3 * self._count, 3 * self._count))

    def _reserve(self, vertices: FloatArray, node: IntArray, other: IntArray) -> None:
        """Reserve the places of all pairs that are near, when one is needed that has none."""
        apart = node < other
        needed = self._keys(np.column_stack([node[apart], other[apart]])) if apart.any() else np.empty(0, np.int64)
        if np.isin(needed, self._reserved).all():
            return
        near = self._keys(self._surfaces.node_pairs(vertices, _RESERVE_MM))
        self._reserved = np.union1d(np.union1d(self._reserved, needed), near)

    def max_step(self, u: FloatArray, du: FloatArray) -> float:
        """Return the share of a step before which nothing meets, less a tenth."""
        return self._surfaces.free_share(self._surfaces.vertices_mm(u), self._surfaces.vertices_mm(u + du))

    def restart(self) -> None:
        """Begin an increment, or begin it again, where the last one ended."""
        self._begin = self._end
        self._lag = self._lagged(self._begin)
        self._projects = self._project

    def approach(self) -> None:
        """Take the exact curvature until the next increment: lagged forces have settled, the equilibrium is near."""
        self._projects = False

    def settle(self, u: FloatArray) -> bool:
        """Renew the lagged normal forces at an equilibrium; return whether friction is settled."""
        if self.barrier.friction_ratio == 0.0:
            return True
        before = self._friction_forces(u)
        self._lag = self._lagged(self._surfaces.vertices_mm(u))
        change = np.linalg.norm(self._friction_forces(u) - before)
        return bool(change <= self.barrier.settled_rel * np.linalg.norm(self.normal_forces_n(u)))

    def accept(self, u: FloatArray) -> None:
        """Let the next increment's slip count from here."""
        self._end = self._surfaces.vertices_mm(u)

    def _lagged(self, vertices: FloatArray) -> "ipctk.TangentialCollisions | None":
        if self.barrier.friction_ratio == 0.0:
            return None
        lag = ipctk.TangentialCollisions()
        normal = self._surfaces.collisions(vertices)
        lag.build(self._mesh, vertices, normal, self._potential, self._ratio, self._ratio)
        return lag


class Drive:
    """A :class:`~sim.mechanics._assembly.Term` that pulls one displacement to a target: k/2 (u - t)^2 + l (u - t).

    A prescribed motion would stop where the barrier's step limit does, far from any equilibrium; a stiff spring gives
    the way there an energy. Its force l is renewed until the target is met, and is foreseen for the next target on the
    straight line through the last two.

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
        self._kept = [(0.0, 0.0)]  # targets and forces of the last two accepted states, where their forces were found
        self._is_found = False

    def aim(self, target_mm: float) -> None:
        """Set the target of an increment that begins, or begins again, where the last accepted state is."""
        self.target_mm, self._force = target_mm, self._kept[-1][1] if self._kept else 0.0
        self._is_found = len(self._kept) == 2
        if self._is_found:
            (before, weaker), (now, stronger) = self._kept
            if now != before:
                self._force += (stronger - weaker) / (now - before) * (target_mm - now)

    def keep(self) -> None:
        """Remember target and force of a state that is accepted; a stored one has met its target without its force."""
        self._kept = [*self._kept[-1:], (self.target_mm, self._force)] if self._is_found else []

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
        is_met = abs(off) <= self._met
        self._is_found |= not is_met
        return is_met


class DrivenContact:
    """A barrier contact and the drive of its obstacle against y; along x and z the obstacle is held.

    Parameters
    ----------
    contact
        With an obstacle.
    supports
        What else is held; the obstacle is added.
    reference_node
        The obstacle's.
    met_mm
        How near the depth must be.

    Attributes
    ----------
    terms
        Of the assembly.
    """

    settle_rel = LAGGED_REL

    def __init__(self, contact: BarrierContact, supports: Supports, reference_node: int, met_mm: float = 1e-4) -> None:
        self.contact = contact
        self._drive = Drive(reference_node, 1, met_mm=met_mm)
        self.terms: tuple[Term, ...] = (contact, self._drive)
        self._supports = supports
        self._supports.fixed[reference_node] = (True, False, True)

    def push(self, depth_mm: float) -> Supports:
        """Aim at a depth and return the supports; slip counts from the last accepted state."""
        self.contact.restart()
        self._drive.aim(-depth_mm)
        return self._supports

    def settle(self, state: State) -> bool:
        """Renew lagged forces at an equilibrium; return whether it still is one."""
        met, settled = self._drive.settle(state.u_mm), self.contact.settle(state.u_mm)
        if met and settled:
            self.contact.approach()
        return met and settled

    def accept(self, state: State) -> None:
        """Let the next increment begin at a state."""
        self.contact.accept(state.u_mm)
        self._drive.keep()


# facets of the indenter that stay this far from the finger's box throughout the push are left out
_OUT_OF_REACH_MM = 3.0


class BarrierPress(DrivenContact):
    """All surfaces of the finger among themselves and against the indenter's triangles.

    The push counts from where the gap to first touch is the barrier's reach. Surfaces rest at a gap a little below
    that, so that the coat goes down by the push, as it does under an indenter that may touch.

    Parameters
    ----------
    design, mesh
        Finger.
    indenter
        At first touch.
    barrier
        How the barrier acts.
    threads
        Of the barrier.
    """

    kind: ContactKind = "barrier"

    def __init__(
        self, design: FingerDesign, mesh: FingerMesh, indenter: RigidIndenter, barrier: Barrier, threads: int
    ) -> None:
        reference = len(mesh.nodes_mm)
        place = np.array([indenter.touching.position_mm])
        self.mesh = replace(mesh, nodes_mm=np.concatenate([mesh.nodes_mm, place]))
        start = indenter.vertices_mm(barrier.reach_mm)
        near = _within_reach(start, indenter.surface, mesh.nodes_mm, design.indenter.depth_mm)
        obstacle = Obstacle(near.vertices_mm, near.triangles, reference)
        contact = BarrierContact(
            self.mesh.nodes_mm, outer_triangles(mesh), obstacle, barrier, threads=threads, tied=mesh.tied_nodes
        )
        super().__init__(contact, Supports.at_rest(reference + 1, mesh.node_sets["fixed"]), reference)
        self._settled_mm = np.zeros_like(self.mesh.nodes_mm)

    @property
    def note(self) -> str:
        """How the surfaces touch, and how near they are at the last equilibrium."""
        u, reach = self._settled_mm, self.contact.barrier.reach_mm
        own = self.contact.pairs_of_parts(u)
        parts = f"touch each other at {own} pairs" if own else "do not touch each other"
        return (
            f"barrier contact: surfaces repel each other at gaps below {reach:g} mm, and the push counts from that gap "
            f"(smallest gap: {self.contact.gap_mm(u):.3g} mm); friction {self.contact.barrier.friction_ratio:g} "
            f"between indenter and finger, none elsewhere; the ribs and other parts of the finger {parts}"
        )

    def accept(self, state: State) -> None:
        """Let the next increment begin at a state."""
        super().accept(state)
        self._settled_mm = state.u_mm

    def force_n(self, u: FloatArray) -> FloatArray:
        """Return the force on the indenter (3,)."""
        return self.contact.force_n(u)

    def energy_n_mm(self, u: FloatArray) -> float:
        """Return the energy of the barrier alone, without friction and the drive of the indenter."""
        return self.contact.barrier_energy(u)

    def caveat(self, u: FloatArray) -> str:
        """Return nothing: a barrier keeps surfaces apart."""
        return ""

    def friction_work_n_mm(self, u: FloatArray) -> float:
        """Return the work lost to friction in the increment that ended at `u`."""
        return self.contact.friction_work_n_mm(u)

    def pressures_mpa(self, u: FloatArray) -> FloatArray:
        """Return the pressure at the corners of the faces of the coat, (f, 4)."""
        return self.contact.pressures_mpa(u, self.mesh.surfaces["coat"])

    def touch_mm(self) -> FloatArray:
        """Return where these lie in the undeformed pad, (f, 4, 3)."""
        return np.asarray(self.mesh.nodes_mm[self.mesh.surfaces["coat"]])


def finger_parts_contact(design: FingerDesign, mesh: FingerMesh, threads: int) -> BarrierContact:
    """Return the contact of a finger's parts among themselves, of the gel's stiffness, with its exact curvature."""
    barrier = Barrier(stiffness_mpa=material_of(design.mechanics.gel, "mechanics.gel").shear_modulus_mpa)
    surface = outer_triangles(mesh)
    return BarrierContact(mesh.nodes_mm, surface, None, barrier, False, threads, mesh.tied_nodes)


def _within_reach(vertices: FloatArray, surface: TriangleMesh, nodes_mm: FloatArray, depth_mm: float) -> TriangleMesh:
    """Return the facets that can come near the finger, whose parts move by up to the push."""
    corners = vertices[surface.triangles]
    low, high = corners.min(axis=1), corners.max(axis=1)
    margin = depth_mm + _OUT_OF_REACH_MM
    near = ((low <= nodes_mm.max(axis=0) + margin) & (high >= nodes_mm.min(axis=0) - margin)).all(axis=1)
    used, numbers = np.unique(surface.triangles[near], return_inverse=True)
    return TriangleMesh(vertices[used], numbers.reshape(-1, 3))
