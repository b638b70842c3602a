"""Which vertices of a triangle mesh lie near faces and edges that they do not belong to."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

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
