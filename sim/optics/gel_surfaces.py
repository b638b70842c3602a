"""The closed gel as triangle surfaces: coated face, inner face, two painted walls and two ends.

All triangles are oriented outward here; the scene turns the painted walls inward, where they emit.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from data_schemas.design import FingerDesign
from data_schemas.errors import SimulateError
from sim.optics.pressed_pad import pad_face

_WALL_ROWS = 9


@dataclass(frozen=True, slots=True)
class Surface:
    """A triangulated grid: vertices (n, 3) in mm, triangles (m, 3), texture coordinates (n, 2) in 0..1."""

    vertices_mm: NDArray[np.float64]
    triangles: NDArray[np.int64]
    uv: NDArray[np.float64]

    def reversed(self) -> "Surface":
        """Return the same surface seen from its other side."""
        return Surface(self.vertices_mm, self.triangles[:, ::-1], self.uv)


def gel_surfaces(design: FingerDesign) -> dict[str, Surface]:
    """Return the six faces of the gel, oriented outward.

    Names: "coat" (y = y(z)), "inner" (y = 0), "red" (x = -width/2), "green" (x = +width/2), "base" (z = 0) and
    "tip" (z = length). Texture coordinates of the walls: u is height / local thickness, v is z / length.
    """
    face = pad_face(design)
    x, z, y = face.x_mm, face.z_mm, face.y_mm
    xx, zz = np.meshgrid(x, z, indexing="ij")
    rows = np.linspace(0.0, 1.0, _WALL_ROWS)
    u_x, v_z = (x - x[0]) / (x[-1] - x[0]), z / z[-1]
    surfaces = {
        "coat": _grid(np.stack([xx, y, zz], -1), u_x, v_z, flip=True),
        "inner": _grid(np.stack([xx, np.zeros_like(y), zz], -1), u_x, v_z, flip=False),
    }
    for name, i, flip in (("red", 0, True), ("green", -1, False)):
        points = np.stack(np.broadcast_arrays(x[i], rows[:, None] * y[i][None, :], z[None, :]), -1)
        surfaces[name] = _grid(points, rows, v_z, flip=flip)
    for name, j, flip in (("base", 0, True), ("tip", -1, False)):
        points = np.stack(np.broadcast_arrays(x[:, None], y[:, j][:, None] * rows[None, :], z[j]), -1)
        surfaces[name] = _grid(points, u_x, rows, flip=flip)
    return surfaces


def check_closed(surfaces: dict[str, Surface]) -> float:
    """Check that the surfaces close one volume with outward normals and return that volume in mm^3.

    A face turned the wrong way gives no error in the renderer, only wrong light: so every edge must be shared by
    exactly two triangles that run it in opposite directions, and the signed volume must be positive.

    Raises
    ------
    SimulateError
        When an edge is open or run twice in one direction, or when the normals point inward.
    """
    vertices = np.concatenate([s.vertices_mm for s in surfaces.values()])
    offsets = np.cumsum([0] + [len(s.vertices_mm) for s in surfaces.values()])
    triangles = np.concatenate([s.triangles + o for s, o in zip(surfaces.values(), offsets, strict=False)])
    # faces meet with equal coordinates up to rounding; a nanometre welds them
    _, welded = np.unique(np.round(vertices, 6), axis=0, return_inverse=True)
    corners = welded.reshape(-1)[triangles]
    edges = np.concatenate([corners[:, [0, 1]], corners[:, [1, 2]], corners[:, [2, 0]]])
    directed = edges[:, 0] * (edges.max() + 1) + edges[:, 1]
    opposite = edges[:, 1] * (edges.max() + 1) + edges[:, 0]
    bad = int((~np.isin(directed, opposite)).sum()) + directed.size - np.unique(directed).size
    if bad:
        raise SimulateError(
            f"the gel of faces {', '.join(surfaces)} is not closed: {bad} edges are open or run twice in one "
            "direction; every edge must belong to two triangles of opposite direction. Check each face"
        )
    a, b, c = (vertices[triangles[:, k]] for k in range(3))
    volume = float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6.0)
    if volume <= 0.0:
        raise SimulateError(f"the gel's normals point inward (signed volume {volume:.3g} mm^3); turn every face round")
    return volume


def _grid(points: NDArray[np.float64], u: NDArray[np.float64], v: NDArray[np.float64], flip: bool) -> Surface:
    """Triangulate a (nu, nv, 3) grid; `flip` reverses the orientation."""
    nu, nv = points.shape[:2]
    index = np.arange(nu * nv).reshape(nu, nv)
    a, b, c, d = index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]
    triangles = np.concatenate([np.stack(t, -1).reshape(-1, 3) for t in ((a, b, c), (a, c, d))])
    uv = np.stack(np.meshgrid(u, v, indexing="ij"), -1).reshape(-1, 2)
    return Surface(points.reshape(-1, 3), triangles[:, ::-1] if flip else triangles, uv)
