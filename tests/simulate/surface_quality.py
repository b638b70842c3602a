"""What a triangulated boundary is worth, beside the hexahedra that it was made of: an oracle of the meshes."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

_SIGNS = np.array([[-1, -1, -1], [1, -1, -1], [1, 1, -1], [-1, 1, -1], [-1, -1, 1], [1, -1, 1], [1, 1, 1], [-1, 1, 1]])
_DEGENERATE_SHARE = 1e-9


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
