"""Hexahedra to their boundary: quadrilaterals, triangles with outward normals, and what these are worth."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

# corners of the faces of a hexahedron in C3D8 order, counter-clockwise seen from outside
FACES = np.array([[0, 3, 2, 1], [4, 5, 6, 7], [0, 1, 5, 4], [1, 2, 6, 5], [2, 3, 7, 6], [3, 0, 4, 7]])

_SIGNS = np.array([[-1, -1, -1], [1, -1, -1], [1, 1, -1], [-1, 1, -1], [-1, -1, 1], [1, -1, 1], [1, 1, 1], [-1, 1, 1]])
_NEIGHBOURS = np.array([[1, 3, 4], [2, 0, 5], [3, 1, 6], [0, 2, 7], [7, 5, 0], [4, 6, 1], [5, 7, 2], [6, 4, 3]])
# diagonals that differ by less, relative, count as equal: rounding must not decide the split
_EQUAL_DIAGONALS_REL = 1e-9
# a triangle with less area than this share of its longest edge squared is a line
_DEGENERATE_SHARE = 1e-9


@dataclass(frozen=True, slots=True)
class BoundaryQuads:
    """Boundary quadrilaterals (k, 4) with outward normals, and the hexahedron that each belongs to, (k,)."""

    quads: NDArray[np.int64]
    owner: NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class SurfaceQuality:
    """What a triangulated boundary is worth.

    ``open_edges`` belong to one triangle only, ``flipped_edges`` are run twice in one direction (a triangle turned
    round), ``degenerate`` counts triangles without area. ``euler_number`` is 2 for a ball and 2 - 2 n for a body with
    n handles. ``volume_mm3`` lies inside the triangles (positive for outward normals) and ``hexahedra_volume_mm3``
    in the trilinear hexahedra; warped faces make them differ.
    """

    triangles: int
    euler_number: int
    open_edges: int
    flipped_edges: int
    degenerate: int
    volume_mm3: float
    hexahedra_volume_mm3: float

    @property
    def is_closed(self) -> bool:
        """Whether each edge belongs to two triangles that run it in opposite directions."""
        return self.open_edges == self.flipped_edges == 0


def boundary_quads(hexahedra: NDArray[np.int64]) -> BoundaryQuads:
    """Return the faces that belong to one hexahedron only.

    A face is known by its four node numbers in ascending order, as two 64-bit keys; faces that occur twice lie
    inside.

    Parameters
    ----------
    hexahedra
        Node numbers (m, 8) in Abaqus' C3D8 order, 0 to 2^31.
    """
    quads = hexahedra[:, FACES].reshape(-1, 4)
    count = int(hexahedra.max()) + 1
    a, b, c, d = np.ascontiguousarray(quads.T)
    low_ab, high_ab, low_cd, high_cd = np.minimum(a, b), np.maximum(a, b), np.minimum(c, d), np.maximum(c, d)
    lowest, highest = np.minimum(low_ab, low_cd), np.maximum(high_ab, high_cd)
    second = np.minimum(np.maximum(low_ab, low_cd), np.minimum(high_ab, high_cd))
    third = a + b + c + d - lowest - second - highest
    first_key, second_key = lowest * count + second, third * count + highest
    order = np.lexsort((second_key, first_key))
    first_key, second_key = first_key[order], second_key[order]
    again = (first_key[1:] == first_key[:-1]) & (second_key[1:] == second_key[:-1])
    inside = np.concatenate([again, [False]]) | np.concatenate([[False], again])
    kept = np.sort(order[~inside])
    return BoundaryQuads(quads[kept], kept // len(FACES))


def split_quads(quads: NDArray[np.int64], nodes_mm: NDArray[np.float64]) -> NDArray[np.int64]:
    """Return two triangles per quad, (2 k, 3), split on the shorter diagonal (first to third corner when equal).

    Triangles 2 i and 2 i + 1 belong to quad i and keep its normal.
    """
    a, b, c, d = (nodes_mm[quads[:, i]] for i in range(4))
    ac, bd = ((a - c) ** 2).sum(axis=1), ((b - d) ** 2).sum(axis=1)
    other = (bd < ac * (1.0 - _EQUAL_DIAGONALS_REL))[:, None]
    first = np.where(other, quads[:, [0, 1, 3]], quads[:, [0, 1, 2]])
    second = np.where(other, quads[:, [1, 2, 3]], quads[:, [0, 2, 3]])
    return np.stack([first, second], axis=1).reshape(-1, 3)


def corner_jacobians_mm3(nodes_mm: NDArray[np.float64], hexahedra: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return the triple product of the three edges at each corner, shape (m, 8): 8 times the Jacobian there."""
    points = nodes_mm[hexahedra]
    edges = points[:, _NEIGHBOURS] - points[:, :, None, :]
    return np.asarray(np.einsum("ecx,ecx->ec", np.cross(edges[:, :, 0], edges[:, :, 1]), edges[:, :, 2]))


def hexahedra_volume_mm3(nodes_mm: NDArray[np.float64], hexahedra: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return the volume of each trilinear hexahedron, (m,); 2 x 2 x 2 Gauss points are exact for it."""
    points = nodes_mm[hexahedra]
    volume = np.zeros(len(hexahedra))
    for gradients in _gauss_gradients():
        volume += np.linalg.det(np.einsum("enx,nr->exr", points, gradients))
    return volume


def _gauss_gradients() -> Iterator[NDArray[np.float64]]:
    """Yield the gradients (8, 3) of the shape functions at the 2 x 2 x 2 Gauss points, whose weights are 1."""
    for point in _SIGNS / np.sqrt(3.0):
        one = 1.0 + _SIGNS * point
        yield np.stack([_SIGNS[:, r] * np.prod(np.delete(one, r, axis=1), axis=1) / 8.0 for r in range(3)], axis=1)


def surface_quality(
    triangles: NDArray[np.int64], nodes_mm: NDArray[np.float64], hexahedra: NDArray[np.int64]
) -> SurfaceQuality:
    """Count edges, handles and degenerate triangles of a boundary and compare its volume with its hexahedra's."""
    edges = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
    count = int(triangles.max()) + 1
    directed, times = np.unique(edges[:, 0] * count + edges[:, 1], return_counts=True)
    undirected = np.unique(edges.min(axis=1) * count + edges.max(axis=1))
    opposite = (directed % count) * count + directed // count
    a, b, c = (nodes_mm[triangles[:, i]] for i in range(3))
    cross = np.cross(b - a, c - a)
    longest = np.max([((p - q) ** 2).sum(axis=1) for p, q in ((a, b), (b, c), (c, a))], axis=0)
    return SurfaceQuality(
        triangles=len(triangles),
        euler_number=len(np.unique(triangles)) - len(undirected) + len(triangles),
        open_edges=int((~np.isin(directed, opposite, assume_unique=True)).sum()),
        flipped_edges=int((times > 1).sum()),
        degenerate=int((np.linalg.norm(cross, axis=1) / 2.0 < _DEGENERATE_SHARE * longest).sum()),
        volume_mm3=float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6.0),
        hexahedra_volume_mm3=float(hexahedra_volume_mm3(nodes_mm, hexahedra).sum()),
    )


def smooth_normals(triangles: NDArray[np.int64], vertices_mm: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return unit normals at the vertices (n, 3), the mean of the triangles' weighted by their angle there.

    Zero at vertices of no triangle. Weighting by angle makes them independent of how quads are split.
    """
    normals = np.zeros_like(vertices_mm)
    corners = vertices_mm[triangles]
    face = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    face /= np.maximum(np.linalg.norm(face, axis=1, keepdims=True), np.finfo(np.float64).tiny)
    for i in range(3):
        to_next, to_last = corners[:, (i + 1) % 3] - corners[:, i], corners[:, (i + 2) % 3] - corners[:, i]
        sine = np.linalg.norm(np.cross(to_next, to_last), axis=1)
        angle = np.arctan2(sine, np.einsum("ij,ij->i", to_next, to_last))
        np.add.at(normals, triangles[:, i], angle[:, None] * face)
    return np.asarray(normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), np.finfo(np.float64).tiny))
