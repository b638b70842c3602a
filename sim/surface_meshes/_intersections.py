"""Find surfaces that pass through each other or through themselves."""

import math
from collections.abc import Mapping
from itertools import combinations_with_replacement

import numpy as np
from numpy.typing import NDArray

from data_schemas import SimulateError
from finray_calib.spectra import compiled, compiled_inside
from sim.surface_meshes._finger_shape import Surface, weld

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

_TOUCH_MM = 1e-9  # far above rounding, and far below the nanometre at which vertices are one


def check_no_intersections(surfaces: Mapping[str, Surface], body: str = "gel") -> None:
    """Check that no triangle of a body passes through another one.

    Light inside a body that overlaps itself takes ways that no real body has, without any error in the renderer.

    Raises
    ------
    SimulateError
        When triangles cross; the message names the surfaces.
    """
    if not _cross(surfaces):
        return
    # welded edges belong to both surfaces of a pair, so that neighbours count as one
    for first, second in combinations_with_replacement(surfaces, 2):
        if _cross({name: surfaces[name] for name in (first, second)}):
            what = f"surface {first} passes through {'itself' if first == second else f'surface {second}'}"
            raise SimulateError(
                f"the {body} intersects itself: {what}; a deformation this large needs a finer mesh or a smaller press"
            )


def _cross(surfaces: Mapping[str, Surface]) -> bool:
    """Tell whether any edge of the surfaces passes through any of their triangles."""
    vertices, triangles, _ = weld(surfaces)
    return crossing_pair(vertices, triangles) is not None


def crossing_pair(vertices_mm: FloatArray, triangles: IntArray) -> tuple[IntArray, IntArray] | None:
    """Return an edge and a triangle of a mesh that meet and share no vertex.

    Of two triangles that cross, an edge of one passes through the other. An edge that ends on a triangle counts, one
    that lies in its plane does not.

    Parameters
    ----------
    vertices_mm
        Shape (n, 3).
    triangles
        Shape (m, 3).

    Returns
    -------
    tuple or None
        Vertices of the edge (2,) and of the triangle (3,), or nothing.
    """
    ends = np.sort(triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    keys = np.unique(ends[:, 0] * len(vertices_mm) + ends[:, 1])
    edges = np.column_stack(np.divmod(keys, len(vertices_mm)))
    boxes = [(vertices_mm[of].min(axis=1), vertices_mm[of].max(axis=1)) for of in (edges, triangles)]
    axis = min(range(3), key=lambda k: _count(*(end[:, k] for box in boxes for end in box)))
    # sorted along the axis along which fewest boxes meet
    first, second = (np.argsort(low[:, axis]) for low, _ in boxes)
    edges, triangles = edges[first], triangles[second]
    found = _first_meeting(vertices_mm, edges, triangles, axis)
    return None if found[0] < 0 else (edges[found[0]], triangles[found[1]])


def _count(low: FloatArray, high: FloatArray, below: FloatArray, above: FloatArray) -> int:
    """Return how many pairs of intervals meet: all that start before one ends, less those that end before it starts."""
    return int((np.searchsorted(np.sort(below), high, "right") - np.searchsorted(np.sort(above), low, "left")).sum())


@compiled
def _first_meeting(vertices: FloatArray, edges: IntArray, triangles: IntArray, axis: int) -> tuple[int, int]:
    """Return the numbers of an edge and a triangle that meet, or -1, -1.

    Two intervals meet where the lower end of one lies in the other: edges are gone through from each triangle's lower
    end to its upper one, and triangles from each edge's.
    """
    low, high = np.empty(len(edges)), np.empty(len(edges))
    for i in range(len(edges)):
        a, b = vertices[edges[i, 0], axis], vertices[edges[i, 1], axis]
        low[i], high[i] = min(a, b) - _TOUCH_MM, max(a, b) + _TOUCH_MM
    below, above = np.empty(len(triangles)), np.empty(len(triangles))
    for j in range(len(triangles)):
        a, b, c = vertices[triangles[j, 0], axis], vertices[triangles[j, 1], axis], vertices[triangles[j, 2], axis]
        below[j], above[j] = min(a, b, c), max(a, b, c)
    for i in range(len(edges)):
        j = np.searchsorted(below, low[i])
        while j < len(triangles) and below[j] <= high[i]:
            if _meet(vertices, edges[i], triangles[j]):
                return i, j
            j += 1
    for j in range(len(triangles)):
        i = np.searchsorted(low, below[j], side="right")
        while i < len(edges) and low[i] <= above[j]:
            if _meet(vertices, edges[i], triangles[j]):
                return i, j
            i += 1
    return -1, -1


@compiled_inside
def _meet(vertices: FloatArray, edge: IntArray, triangle: IntArray) -> bool:
    """Tell whether an edge and a triangle that share no vertex meet, other than in one plane."""
    for k in range(3):
        if triangle[k] == edge[0] or triangle[k] == edge[1]:
            return False
    for k in range(3):
        p, q = vertices[edge[0], k], vertices[edge[1], k]
        a, b, c = vertices[triangle[0], k], vertices[triangle[1], k], vertices[triangle[2], k]
        if min(p, q) - _TOUCH_MM > max(a, b, c) or max(p, q) + _TOUCH_MM < min(a, b, c):
            return False
    px, py, pz = vertices[edge[0], 0], vertices[edge[0], 1], vertices[edge[0], 2]
    qx, qy, qz = vertices[edge[1], 0], vertices[edge[1], 1], vertices[edge[1], 2]
    nx, ny, nz = _normal(vertices, triangle)
    size = math.sqrt(nx * nx + ny * ny + nz * nz)
    if size == 0.0:
        return False
    nx, ny, nz = nx / size, ny / size, nz / size
    ax, ay, az = vertices[triangle[0], 0], vertices[triangle[0], 1], vertices[triangle[0], 2]
    of_p = nx * (px - ax) + ny * (py - ay) + nz * (pz - az)
    of_q = nx * (qx - ax) + ny * (qy - ay) + nz * (qz - az)
    if min(of_p, of_q) > _TOUCH_MM or max(of_p, of_q) < -_TOUCH_MM or max(abs(of_p), abs(of_q)) <= _TOUCH_MM:
        return False
    share = min(max(of_p / (of_p - of_q), 0.0), 1.0)
    x, y, z = px + share * (qx - px), py + share * (qy - py), pz + share * (qz - pz)
    for k in range(3):
        start, end = triangle[k], triangle[(k + 1) % 3]
        sx, sy, sz = vertices[start, 0], vertices[start, 1], vertices[start, 2]
        ex, ey, ez = vertices[end, 0] - sx, vertices[end, 1] - sy, vertices[end, 2] - sz
        x_in, y_in, z_in = ny * ez - nz * ey, nz * ex - nx * ez, nx * ey - ny * ex
        inside = x_in * (x - sx) + y_in * (y - sy) + z_in * (z - sz)
        if inside < -_TOUCH_MM * math.sqrt(ex * ex + ey * ey + ez * ez):
            return False
    return True


@compiled_inside
def _normal(vertices: FloatArray, triangle: IntArray) -> tuple[float, float, float]:
    """Return the normal of a triangle, twice its area long."""
    a, b, c = triangle[0], triangle[1], triangle[2]
    bx, by, bz = vertices[b, 0] - vertices[a, 0], vertices[b, 1] - vertices[a, 1], vertices[b, 2] - vertices[a, 2]
    cx, cy, cz = vertices[c, 0] - vertices[a, 0], vertices[c, 1] - vertices[a, 1], vertices[c, 2] - vertices[a, 2]
    return by * cz - bz * cy, bz * cx - bx * cz, bx * cy - by * cx
