"""Surfaces that may collide: where they are, which pairs may touch, which are near, how far they may move.

Like :mod:`sim.mechanics._barrier_contact`, it cannot be imported where the IPC Toolkit does not run.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from data_schemas import SimulateError
from sim.mechanics._contact_library import contact_library

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

_PARALLEL = 1e-12  # squared sine of the angle below which two edges have no single nearest point between their ends


@dataclass(frozen=True, slots=True)
class NearStencils:
    """Vertices (k, 4) of a vertex and a face, and of two edges, that may be near each other."""

    vertex_face: IntArray
    edge_edge: IntArray

    def vertex_pairs(self) -> IntArray:
        """Return the pairs of vertices (m, 2), ascending, across the two sides."""
        a = self.vertex_face[:, [0, 0, 0, 1, 2, 3]].reshape(-1, 2, 3).transpose(0, 2, 1).reshape(-1, 2)
        b = self.edge_edge[:, [0, 0, 1, 1, 2, 3, 2, 3]].reshape(-1, 2, 4).transpose(0, 2, 1).reshape(-1, 2)
        return np.unique(np.sort(np.concatenate([a, b]), axis=1), axis=0)

    def closer_than(self, vertices_mm: FloatArray, distance_mm: float) -> "NearStencils":
        """Return those whose sides are closer to each other."""
        face, edge = vertices_mm[self.vertex_face], vertices_mm[self.edge_edge]
        return NearStencils(
            self.vertex_face[point_triangle_mm(face) < distance_mm], self.edge_edge[edge_edge_mm(edge) < distance_mm]
        )


def _point_edge(point: FloatArray, start: FloatArray, end: FloatArray) -> FloatArray:
    """Return the distance of points from edges, (k,)."""
    along = end - start
    share = np.einsum("ki,ki->k", point - start, along) / np.einsum("ki,ki->k", along, along)
    return np.asarray(np.linalg.norm(point - start - np.clip(share, 0.0, 1.0)[:, None] * along, axis=1))


def point_triangle_mm(corners: FloatArray) -> FloatArray:
    """Return the distance (k,) of the first of four points (k, 4, 3) from the triangle of the others."""
    point, a, b, c = np.moveaxis(corners, 1, 0)
    least = np.minimum.reduce([_point_edge(point, a, b), _point_edge(point, b, c), _point_edge(point, c, a)])
    normal = np.cross(b - a, c - a)
    inside = np.ones(len(point), dtype=bool)
    for start, end in ((a, b), (b, c), (c, a)):
        inside &= np.einsum("ki,ki->k", np.cross(end - start, point - start), normal) >= 0.0
    off = np.abs(np.einsum("ki,ki->k", point - a, normal)) / np.linalg.norm(normal, axis=1)
    return np.asarray(np.where(inside, off, least))


def edge_edge_mm(corners: FloatArray) -> FloatArray:
    """Return the distance (k,) of the edge of the first two of four points (k, 4, 3) from that of the others."""
    a, b, c, d = np.moveaxis(corners, 1, 0)
    ends = [_point_edge(a, c, d), _point_edge(b, c, d), _point_edge(c, a, b), _point_edge(d, a, b)]
    u, v, w = b - a, d - c, a - c
    uu, uv, vv = (np.einsum("ki,ki->k", p, q) for p, q in ((u, u), (u, v), (v, v)))
    uw, vw = np.einsum("ki,ki->k", u, w), np.einsum("ki,ki->k", v, w)
    sine = uu * vv - uv**2
    crossing = sine > _PARALLEL * uu * vv
    safe = np.where(crossing, sine, 1.0)
    s, t = (uv * vw - vv * uw) / safe, (uu * vw - uv * uw) / safe
    between = crossing & (s >= 0.0) & (s <= 1.0) & (t >= 0.0) & (t <= 1.0)
    apart = np.linalg.norm(w + s[:, None] * u - t[:, None] * v, axis=1)
    return np.asarray(np.where(between, apart, np.minimum.reduce(ends)))


if TYPE_CHECKING:
    import ipctk
else:
    ipctk = contact_library()

_KEPT_GAP = 0.9  # share of the way to a collision that a step may go: distances stay above zero
# what lies at rest within so many reaches of the barrier is joined or one thin sheet, and never collides: it would push
# at rest; the sides of a corner that folds collide, but for their first elements
_REACHES_AT_REST = 2.0
_TIED_MM = 0.2  # faces that are tied lie this close at rest where they are curved, and never collide


@dataclass(frozen=True, slots=True)
class Obstacle:
    """A rigid triangle mesh whose places are relative to the displacement of its reference node.

    Vertices (m, 3) in mm, triangles (k, 3), and the number of a node that no element uses.
    """

    vertices_mm: FloatArray
    triangles: IntArray
    reference_node: int


class CollidingSurfaces:
    """Vertices of the parts' surfaces and then of an obstacle, moved by the nodes of a finite-element mesh.

    All vertices collide with all triangles, and edges with edges, but for those of the obstacle among themselves and
    what is nearly touching at rest.

    Parameters
    ----------
    nodes_mm
        Nodes at rest (n, 3), with the obstacle's reference node.
    triangles
        Surfaces that may touch, (t, 3), outward.
    obstacle
        The indenter; none for contact of the parts alone.
    reach_mm
        Distance below which pairs are near.
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
        obstacle: Obstacle | None,
        reach_mm: float,
        tied: IntArray | None = None,
    ) -> None:
        self.nodes, local = np.unique(triangles, return_inverse=True)
        self.own = len(self.nodes)
        self._reach = reach_mm
        faces = local.reshape(-1, 3)
        self.rest_mm = nodes_mm[self.nodes]
        # the node that moves each vertex
        self.mover = self.nodes
        if obstacle is not None:
            faces = np.concatenate([faces, obstacle.triangles + self.own])
            self.rest_mm = np.concatenate([self.rest_mm, obstacle.vertices_mm])
            moved_by = np.full(len(obstacle.vertices_mm), obstacle.reference_node)
            self.mover = np.concatenate([self.mover, moved_by])
        faces32 = np.asfortranarray(faces, np.int32)
        self.mesh = ipctk.CollisionMesh(np.asfortranarray(self.rest_mm), ipctk.edges(faces32), faces32)
        self._narrow = ipctk.AdditiveCCD()
        self._seen: tuple[FloatArray, ipctk.NormalCollisions] | None = None
        self._swept: tuple[FloatArray, FloatArray, ipctk.Candidates] | None = None
        self._check_apart()
        self.mesh.can_collide = self._allowed(np.isin(self.nodes, [] if tied is None else tied))

    def _check_apart(self) -> None:
        """Check that the obstacle is outside the parts; what is tied may touch."""
        sides = (np.arange(len(self.rest_mm)) >= self.own).astype(np.int32)
        self.mesh.can_collide = ipctk.make_vertex_patches_filter(sides)
        if ipctk.has_intersections(self.mesh, np.asfortranarray(self.rest_mm)):
            raise SimulateError(
                "the indenter starts inside the finger, but must be outside before the push; check indenter.file, "
                "position_mm, across_mm and rotation_deg"
            )

    def _allowed(self, tied: NDArray[np.bool_]) -> "ipctk.CollisionFilter":
        """Return which pairs of vertices may collide; `tied` are those of the parts at a tie, (v,)."""
        parts = ipctk.make_static_obstacle_filter(self.own)
        self.mesh.can_collide = parts
        joined_mm = _REACHES_AT_REST * self._reach
        # each box is made larger by this: half the distance finds them all
        near = self._stencils(self.rest_mm, max(joined_mm, _TIED_MM) / 2.0)
        pairs = near.closer_than(self.rest_mm, joined_mm).vertex_pairs()
        if tied.any():
            at_ties = near.closer_than(self.rest_mm, _TIED_MM).vertex_pairs()
            at_ties = at_ties[at_ties[:, 1] < self.own]
            pairs = np.concatenate([pairs, at_ties[tied[at_ties].all(axis=1)]])
        pairs = pairs[pairs[:, 1] < self.own]
        barred = {(int(a), int(b)): False for a, b in pairs}
        return parts & ipctk.make_sparse_filter(barred, True)

    def _stencils(self, vertices: FloatArray, growth_mm: float) -> NearStencils:
        """Return the pairs whose boxes meet when they are made larger on all sides."""
        near = ipctk.Candidates()
        near.build(self.mesh, np.asfortranarray(vertices), growth_mm)
        faces, edges = np.asarray(self.mesh.faces, np.int64), np.asarray(self.mesh.edges, np.int64)
        of_faces = np.array([(c.vertex_id, c.face_id) for c in near.fv_candidates], np.int64).reshape(-1, 2)
        of_edges = np.array([(c.edge0_id, c.edge1_id) for c in near.ee_candidates], np.int64).reshape(-1, 2)
        return NearStencils(
            np.column_stack([of_faces[:, 0], faces[of_faces[:, 1]]]),
            np.column_stack([edges[of_edges[:, 0]], edges[of_edges[:, 1]]]),
        )

    def node_pairs(self, vertices: FloatArray, distance_mm: float) -> IntArray:
        """Return the different nodes (m, 2) that move the vertices of pairs that are closer to each other."""
        # each box is made larger by this: half the distance finds them all
        near = self._stencils(vertices, distance_mm / 2.0).closer_than(vertices, distance_mm)
        pairs = self.mover[near.vertex_pairs()]
        return np.asarray(pairs[pairs[:, 0] != pairs[:, 1]])

    def vertices_mm(self, u: FloatArray) -> FloatArray:
        """Return where the vertices are at a displacement of the nodes."""
        return np.asfortranarray(self.rest_mm + u[self.mover])

    def collisions(self, vertices: FloatArray) -> "ipctk.NormalCollisions":
        """Return the pairs within reach, from the last call where nothing has moved."""
        if self._seen is not None and np.array_equal(self._seen[0], vertices):
            return self._seen[1]
        found = ipctk.NormalCollisions()
        found.use_area_weighting = True
        found.collision_set_type = ipctk.NormalCollisions.IMPROVED_MAX_APPROX
        found.build(self._near_pairs(vertices), self.mesh, vertices, self._reach)
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
        near.build(self.mesh, start, end, self._reach)
        self._swept = np.minimum(start, end), np.maximum(start, end), near
        return near

    def free_share(self, start: FloatArray, end: FloatArray) -> float:
        """Return the share of a straight way before which nothing meets, less a tenth."""
        free = self._sweep(start, end).compute_collision_free_stepsize(
            self.mesh, start, end, narrow_phase_ccd=self._narrow
        )
        return float(free) if free >= 1.0 else _KEPT_GAP * float(free)

    def gap_mm(self, vertices: FloatArray) -> float:
        """Return the least distance; infinity where nothing is within reach."""
        found = self.collisions(vertices)
        return float(np.sqrt(found.compute_minimum_distance(self.mesh, vertices))) if len(found) else np.inf

    def pairs_of_parts(self, vertices: FloatArray) -> int:
        """Return how many pairs within reach do not belong to the obstacle."""
        faces, edges = np.asarray(self.mesh.faces), np.asarray(self.mesh.edges)
        found = self.collisions(vertices)
        used = [found[k].vertex_ids(edges, faces) for k in range(len(found))]
        return sum(all(v < self.own for v in stencil) for stencil in used)
