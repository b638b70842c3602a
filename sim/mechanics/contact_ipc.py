"""Contact by a barrier on distances (incremental potential contact), of parts and an indenter; lagged friction."""

from dataclasses import dataclass

import ipctk
import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from data_schemas.errors import SimulateError
from sim.mechanics.near_pairs import NearStencils

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

_KEPT_GAP = 0.9  # share of the way to a collision that a step may go: distances stay above zero
_NEAR_AT_REST_MM = 0.2  # what lies closer at rest is joined, tied or one thin sheet, and never collides
_RESERVE_MM = 0.5  # pairs within this distance get their place in the matrix together


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


@dataclass(frozen=True, slots=True)
class Obstacle:
    """A rigid triangle mesh whose places are relative to the displacement of its reference node.

    Vertices (m, 3) in mm, triangles (k, 3), and the number of a node that no element uses.
    """

    vertices_mm: FloatArray
    triangles: IntArray
    reference_node: int


class BarrierContact:
    r"""A :class:`~sim.mechanics.assembly.Term`: Pi = sum_c w_c kappa d b(d_c / d) + sum_c mu N_c f0(|slip_c|).

    b(t) = -(t - 1)^2 ln t for t < 1 in the physical scaling of the IPC Toolkit, w the area of a pair; N and the
    directions of slip are lagged. All vertices of the surfaces collide with all triangles, and edges with edges, but
    for those of the obstacle among themselves and what is nearly touching at rest.

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
        Whether curvature is always without its negative part, even where Newton's method does not ask for it.
    threads
        Of the IPC Toolkit.

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
    ) -> None:
        ipctk.set_num_threads(threads)
        ipctk.set_logger_level(ipctk.LoggerLevel.error)
        self.barrier = barrier or Barrier()
        self.obstacle = obstacle
        self._count = len(nodes_mm)
        self._project = project
        self.surface_nodes, local = np.unique(triangles, return_inverse=True)
        own = len(self.surface_nodes)
        faces = local.reshape(-1, 3)
        rest = nodes_mm[self.surface_nodes]
        # the node that moves each vertex, and the vertex' place when no node is displaced
        self._mover = self.surface_nodes
        if obstacle is not None:
            faces = np.concatenate([faces, obstacle.triangles + own])
            rest = np.concatenate([rest, obstacle.vertices_mm])
            moved_by = np.full(len(obstacle.vertices_mm), obstacle.reference_node)
            self._mover = np.concatenate([self._mover, moved_by])
        self._rest = rest
        faces32 = np.asfortranarray(faces, np.int32)
        self._mesh = ipctk.CollisionMesh(np.asfortranarray(rest), ipctk.edges(faces32), faces32)
        self._check_apart(own)
        self._mesh.can_collide = self._allowed(own)
        self._potential = ipctk.BarrierPotential(self.barrier.reach_mm, self.barrier.stiffness_mpa, True)
        self._friction = ipctk.FrictionPotential(self.barrier.stick_mm)
        self._narrow = ipctk.AdditiveCCD()
        self._lag: ipctk.TangentialCollisions | None = None
        # the toolkit takes the mean of both sides' coefficients
        self._ratio = np.where(np.arange(len(rest)) >= own, 2.0 * self.barrier.friction_ratio, 0.0)
        self._begin = self._end = self._vertices(np.zeros((self._count, 3)))
        self._seen: tuple[FloatArray, ipctk.NormalCollisions] | None = None
        self._swept: tuple[FloatArray, FloatArray, ipctk.Candidates] | None = None
        self._reserved = self._first_places(local.reshape(-1, 3), obstacle)

    def _check_apart(self, own: int) -> None:
        """Check that the obstacle is outside the parts; what is tied may touch."""
        self._mesh.can_collide = ipctk.make_vertex_patches_filter((np.arange(len(self._rest)) >= own).astype(np.int32))
        if ipctk.has_intersections(self._mesh, np.asfortranarray(self._rest)):
            raise SimulateError(
                "the indenter starts inside the finger: it must be outside before the push; check indenter.file, "
                "position_mm, across_mm and rotation_deg"
            )

    def _allowed(self, own: int) -> "ipctk.CollisionFilter":
        """Return which pairs of vertices may collide."""
        parts = ipctk.make_static_obstacle_filter(own)
        near = ipctk.Candidates()
        self._mesh.can_collide = parts
        # each box is made larger by this: half the distance finds them all
        near.build(self._mesh, np.asfortranarray(self._rest), _NEAR_AT_REST_MM / 2.0)
        pairs = _stencils(near, self._mesh).closer_than(self._rest, _NEAR_AT_REST_MM).vertex_pairs()
        pairs = pairs[pairs[:, 1] < own]
        barred = {(int(a), int(b)): False for a, b in pairs}
        return parts & ipctk.make_sparse_filter(barred, True)

    def _first_places(self, triangles: IntArray, obstacle: Obstacle | None) -> IntArray:
        """Return the pairs of nodes, low * n + high, that the matrix has anyway, or reserves from the start."""
        nodes = self.surface_nodes[triangles]
        pairs = np.concatenate([nodes[:, [0, 1]], nodes[:, [1, 2]], nodes[:, [2, 0]]])
        if obstacle is not None:
            to_body = np.column_stack([self.surface_nodes, np.full(len(self.surface_nodes), obstacle.reference_node)])
            pairs = np.concatenate([pairs, to_body])
        return self._keys(pairs)

    def _keys(self, pairs: IntArray) -> IntArray:
        return np.unique(pairs.min(axis=1) * self._count + pairs.max(axis=1))

    def _vertices(self, u: FloatArray) -> FloatArray:
        return np.asfortranarray(self._rest + u[self._mover])

    def _collisions(self, vertices: FloatArray) -> "ipctk.NormalCollisions":
        """Return the pairs closer than the barrier's reach, from the last call where nothing has moved."""
        if self._seen is not None and np.array_equal(self._seen[0], vertices):
            return self._seen[1]
        found = ipctk.NormalCollisions()
        found.use_area_weighting = True
        found.collision_set_type = ipctk.NormalCollisions.IMPROVED_MAX_APPROX
        found.build(self._near_pairs(vertices), self._mesh, vertices, self.barrier.reach_mm)
        self._seen = vertices, found
        return found

    def _near_pairs(self, vertices: FloatArray) -> "ipctk.Candidates":
        """Return candidates for contact, those of the last step where the vertices lie within its boxes."""
        if self._swept is not None:
            low, high, near = self._swept
            if (vertices >= low).all() and (vertices <= high).all():
                return near
        return self._sweep(vertices, vertices)

    def _sweep(self, start: FloatArray, end: FloatArray) -> "ipctk.Candidates":
        """Find and keep the candidates for contact on the straight way between two places of the vertices."""
        near = ipctk.Candidates()
        near.build(self._mesh, start, end, self.barrier.reach_mm)
        self._swept = np.minimum(start, end), np.maximum(start, end), near
        return near

    def gap_mm(self, u: FloatArray) -> float:
        """Return the least distance; infinity where nothing is within the barrier's reach."""
        vertices = self._vertices(u)
        found = self._collisions(vertices)
        return float(np.sqrt(found.compute_minimum_distance(self._mesh, vertices))) if len(found) else np.inf

    def energy(self, u: FloatArray) -> float:
        """Return Pi in N mm."""
        vertices = self._vertices(u)
        energy = float(self._potential(self._collisions(vertices), self._mesh, vertices))
        if self._lag is not None:
            energy += float(self._friction(self._lag, self._mesh, self._slip(vertices)))
        return energy if np.isfinite(energy) else np.inf

    def gradient(self, u: FloatArray) -> FloatArray:
        """Return dPi/du in N, shape (n, 3)."""
        return self._to_nodes(self.normal_forces_n(u) + self._friction_forces(u))

    def _to_nodes(self, forces: FloatArray) -> FloatArray:
        out = np.zeros((self._count, 3))
        np.add.at(out, self._mover, forces)
        return out

    def normal_forces_n(self, u: FloatArray) -> FloatArray:
        """Return the barrier's derivative by each vertex (v, 3) in N: surface nodes, then the obstacle's vertices."""
        vertices = self._vertices(u)
        return np.asarray(
            self._potential.gradient(self._collisions(vertices), self._mesh, vertices), dtype=np.float64
        ).reshape(-1, 3)

    def _friction_forces(self, u: FloatArray) -> FloatArray:
        if self._lag is None:
            return np.zeros_like(self._rest)
        slip = self._slip(self._vertices(u))
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
        own = len(self.surface_nodes)
        push = np.linalg.norm(self.normal_forces_n(u)[:own], axis=1) / np.asarray(self._mesh.vertex_areas)[:own]
        of_node = np.zeros(self._count)
        of_node[self.surface_nodes] = push
        return np.asarray(of_node[nodes])

    def hessian(self, u: FloatArray, project: bool) -> sp.coo_array | sp.csr_array:
        """Return the second derivative; zeros reserve the places of all pairs that have been near."""
        method = ipctk.PSDProjectionMethod.CLAMP if project or self._project else ipctk.PSDProjectionMethod.NONE
        vertices = self._vertices(u)
        found = self._potential.hessian(self._collisions(vertices), self._mesh, vertices, method)
        if self._lag is not None:
            found = found + self._friction.hessian(self._lag, self._mesh, self._slip(vertices), method)
        entries = sp.coo_array(found)
        vertex, axis = np.divmod(entries.row, 3)
        other, other_axis = np.divmod(entries.col, 3)
        node, other_node = self._mover[vertex], self._mover[other]
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
        near = ipctk.Candidates()
        near.build(self._mesh, vertices, _RESERVE_MM)
        pairs = self._mover[_stencils(near, self._mesh).vertex_pairs()]
        self._reserved = np.union1d(np.union1d(self._reserved, needed), self._keys(pairs[pairs[:, 0] != pairs[:, 1]]))

    def max_step(self, u: FloatArray, du: FloatArray) -> float:
        """Return the share of a step before which nothing meets, less a tenth."""
        start, end = self._vertices(u), self._vertices(u + du)
        free = self._sweep(start, end).compute_collision_free_stepsize(
            self._mesh, start, end, narrow_phase_ccd=self._narrow
        )
        return float(free) if free >= 1.0 else _KEPT_GAP * float(free)

    def restart(self) -> None:
        """Begin an increment, or begin it again, where the last one ended."""
        self._begin = self._end
        self._lag = self._lagged(self._begin)

    def settle(self, u: FloatArray) -> bool:
        """Renew the lagged normal forces at an equilibrium; return whether friction is settled, and then accept it."""
        if self.barrier.friction_ratio > 0.0:
            before = self._friction_forces(u)
            self._lag = self._lagged(self._vertices(u))
            change = np.linalg.norm(self._friction_forces(u) - before)
            if change > self.barrier.settled_rel * np.linalg.norm(self.normal_forces_n(u)):
                return False
        self.accept(u)
        return True

    def accept(self, u: FloatArray) -> None:
        """Let the next increment's slip count from here."""
        self._end = self._vertices(u)

    def _lagged(self, vertices: FloatArray) -> "ipctk.TangentialCollisions | None":
        if self.barrier.friction_ratio == 0.0:
            return None
        lag = ipctk.TangentialCollisions()
        normal = self._collisions(vertices)
        lag.build(self._mesh, vertices, normal, self._potential, self._ratio, self._ratio)
        return lag


def _stencils(near: "ipctk.Candidates", mesh: "ipctk.CollisionMesh") -> NearStencils:
    """Return the vertices of all candidates."""
    faces, edges = np.asarray(mesh.faces, np.int64), np.asarray(mesh.edges, np.int64)
    of_faces = np.array([(c.vertex_id, c.face_id) for c in near.fv_candidates], np.int64).reshape(-1, 2)
    of_edges = np.array([(c.edge0_id, c.edge1_id) for c in near.ee_candidates], np.int64).reshape(-1, 2)
    return NearStencils(
        np.column_stack([of_faces[:, 0], faces[of_faces[:, 1]]]),
        np.column_stack([edges[of_edges[:, 0]], edges[of_edges[:, 1]]]),
    )
