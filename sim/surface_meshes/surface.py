"""A triangulated surface, and the check that several of them close one volume."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from data_schemas.errors import SimulateError

# faces of one body meet with equal coordinates up to rounding; a nanometre welds them
_WELD_DECIMALS = 6


@dataclass(frozen=True, slots=True)
class Surface:
    """Triangles of one face: vertices (n, 3) in mm, triangles (m, 3), texture coordinates (n, 2) in 0..1.

    Texture coordinates belong to the undeformed finger: a point keeps them when the finger deforms.
    """

    vertices_mm: NDArray[np.float64]
    triangles: NDArray[np.int64]
    uv: NDArray[np.float64]

    def __post_init__(self) -> None:
        for name, shape in (("vertices_mm", (3,)), ("triangles", (3,)), ("uv", (2,))):
            values = getattr(self, name)
            if values.ndim != 2 or values.shape[1:] != shape or not np.isfinite(values).all():
                raise SimulateError(f"a surface's {name} must be finite, of shape (n, {shape[0]}), got {values.shape}")
        if len(self.uv) != len(self.vertices_mm) or not len(self.triangles):
            raise SimulateError(
                f"a surface needs triangles and a texture coordinate per vertex, got {len(self.triangles)} triangles, "
                f"{len(self.vertices_mm)} vertices and {len(self.uv)} texture coordinates"
            )
        if self.triangles.min() < 0 or self.triangles.max() >= len(self.vertices_mm):
            raise SimulateError(f"a surface's triangles must name vertices 0 to {len(self.vertices_mm) - 1}")

    def reversed(self) -> "Surface":
        """Return the same surface seen from its other side."""
        return Surface(self.vertices_mm, self.triangles[:, ::-1], self.uv)

    def moved_to(self, vertices_mm: NDArray[np.float64]) -> "Surface":
        """Return the surface with its vertices elsewhere."""
        return Surface(vertices_mm, self.triangles, self.uv)


def grid_surface(
    points_mm: NDArray[np.float64], u: NDArray[np.float64], v: NDArray[np.float64], flip: bool = False
) -> Surface:
    """Triangulate a (nu, nv, 3) grid of points; normals along d/du x d/dv, or against it with `flip`."""
    nu, nv = points_mm.shape[:2]
    index = np.arange(nu * nv).reshape(nu, nv)
    a, b, c, d = index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]
    triangles = np.concatenate([np.stack(t, -1).reshape(-1, 3) for t in ((a, b, c), (a, c, d))])
    uv = np.stack(np.meshgrid(u, v, indexing="ij"), -1).reshape(-1, 2)
    return Surface(points_mm.reshape(-1, 3), triangles[:, ::-1] if flip else triangles, uv)


def vertex_normals(surface: Surface) -> NDArray[np.float64]:
    """Return the unit normals (n, 3) of the vertices: means of the faces around, weighted by their angles there."""
    corners = surface.vertices_mm[surface.triangles]
    face = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    face /= np.linalg.norm(face, axis=-1, keepdims=True)
    normals = np.zeros_like(surface.vertices_mm)
    for k in range(3):
        a, b = (corners[:, (k + step) % 3] - corners[:, k] for step in (1, 2))
        cosine = np.sum(a * b, axis=-1) / (np.linalg.norm(a, axis=-1) * np.linalg.norm(b, axis=-1))
        np.add.at(normals, surface.triangles[:, k], face * np.arccos(np.clip(cosine, -1.0, 1.0))[:, None])
    return np.asarray(normals / np.linalg.norm(normals, axis=-1, keepdims=True))


def weld(surfaces: Mapping[str, Surface]) -> tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.int64]]:
    """Join surfaces at equal vertices.

    Returns
    -------
    vertices_mm
        Shape (n, 3), each place once.
    triangles
        Shape (m, 3), of all surfaces one after the other.
    owner
        Number of the surface that a triangle belongs to, shape (m,).
    """
    vertices = np.concatenate([s.vertices_mm for s in surfaces.values()])
    offsets = np.cumsum([0] + [len(s.vertices_mm) for s in surfaces.values()])
    triangles = np.concatenate([s.triangles + o for s, o in zip(surfaces.values(), offsets, strict=False)])
    owner = np.repeat(np.arange(len(surfaces)), [len(s.triangles) for s in surfaces.values()])
    _, first, place = np.unique(np.round(vertices, _WELD_DECIMALS), axis=0, return_index=True, return_inverse=True)
    return vertices[first], place.reshape(-1)[triangles], owner


def check_closed(surfaces: Mapping[str, Surface], body: str = "gel") -> float:
    """Check that surfaces close one volume with outward normals and return that volume in mm^3.

    A face turned the wrong way gives no error in the renderer, only wrong light: so every edge must be shared by
    exactly two triangles that run it in opposite directions, and the signed volume must be positive.

    Raises
    ------
    SimulateError
        When an edge is open or run twice in one direction, naming the faces at fault, or when the normals point
        inward.
    """
    vertices, corners, owner = weld(surfaces)
    edges = np.concatenate([corners[:, [0, 1]], corners[:, [1, 2]], corners[:, [2, 0]]])
    directed = edges[:, 0] * (edges.max() + 1) + edges[:, 1]
    opposite = edges[:, 1] * (edges.max() + 1) + edges[:, 0]
    _, first, times = np.unique(directed, return_inverse=True, return_counts=True)
    bad = ~np.isin(directed, opposite) | (times[first.reshape(-1)] > 1)
    if bad.any():
        per_face = np.bincount(np.tile(owner, 3)[bad], minlength=len(surfaces))
        where = ", ".join(f"{name} ({n})" for name, n in zip(surfaces, per_face, strict=True) if n)
        raise SimulateError(
            f"the {body} is not closed: {int(bad.sum())} edges are open or run twice in one direction, at {where}; "
            "two triangles must meet at every edge and run it in opposite directions. Close the mesh, or turn the face"
        )
    a, b, c = (vertices[corners[:, k]] for k in range(3))
    volume = float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6.0)
    if volume <= 0.0:
        raise SimulateError(
            f"the normals of the {body} point inward (signed volume {volume:.3g} mm^3); turn every face round"
        )
    return volume
