"""A solid by its boundary, as CAD programs and printers keep it; and surfaces that pass through each other.

Corners, edges between them, faces bounded by loops of edges. A mesh with flat faces becomes such a solid:
neighbouring quadrilaterals of one plane become one face with straight edges. Triangles become binary STL, which
slicers read. Of surfaces it is found whether they pass through each other or through themselves.
"""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import combinations_with_replacement

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from data_schemas import SimulateError
from finray_calib.spectra import compiled, compiled_inside
from sim.surface_meshes._finger_shape import Surface, weld

Coordinates = NDArray[np.float64]
Loop = tuple[tuple[int, bool], ...]
"""Edges in the order in which they are run, each with whether it is run from its start to its end."""


@dataclass(frozen=True, slots=True)
class EllipseArc:
    """Arc centre + cos(t) u + sin(t) v, from the edge's start to its end with growing t; u and v are perpendicular."""

    centre_mm: Coordinates
    u_mm: Coordinates
    v_mm: Coordinates


@dataclass(frozen=True, slots=True)
class Edge:
    """Part of a curve between two corners; a straight line without an arc."""

    start: int
    end: int
    arc: EllipseArc | None = None


@dataclass(frozen=True, slots=True)
class Plane:
    """Plane through a point, with the unit normal that points out of the solid."""

    point_mm: Coordinates
    normal: Coordinates


@dataclass(frozen=True, slots=True)
class HollowCylinder:
    """Inside of a cylinder: the solid lies beyond it, seen from its axis."""

    centre_mm: Coordinates
    axis: Coordinates
    radius_mm: float


@dataclass(frozen=True, slots=True)
class HollowEllipsoid:
    """Inside of an ellipsoid's cap around the end of its y axis, for u and v up to the two tangents.

    Points (x/a, y/b, z/c) = (2u, 1 - u^2 - v^2, 2v) / (1 + u^2 + v^2): the unit sphere seen from its lower pole, where
    u and v are tangents of half the angle from the y axis.
    """

    centre_mm: Coordinates
    semi_axes_mm: Coordinates
    tan_half_across: float
    tan_half_along: float


@dataclass(frozen=True, slots=True)
class Face:
    """Part of a surface within its first loop and outside the others, each with the face on its left from outside."""

    surface: Plane | HollowCylinder | HollowEllipsoid
    loops: tuple[Loop, ...]


@dataclass(frozen=True, slots=True)
class Solid:
    """Corners (n, 3) in mm, edges and faces of one closed body.

    Raises
    ------
    SimulateError
        When an edge is not run exactly once in each direction.
    """

    corners_mm: Coordinates
    edges: tuple[Edge, ...]
    faces: tuple[Face, ...]

    def __post_init__(self) -> None:
        runs = sorted(run for face in self.faces for loop in face.loops for run in loop)
        if runs != [(edge, forward) for edge in range(len(self.edges)) for forward in (False, True)]:
            raise SimulateError("the solid is not closed; two faces must meet at every edge, one on each side of it")


Numbers = NDArray[np.int64]

# neighbours whose normals turn by less lie in one plane: far above rounding, far below the flattest curve in steps of
# a millimetre (10^6 mm of radius turn by 10^-6)
_SAME_PLANE_RAD = 1e-7
_MOST_WARPED_MM = 1e-6


@dataclass(frozen=True, slots=True)
class _HalfEdges:
    """Sides of the quadrilaterals: side i of quad q is 4 q + i. Of each: corners, face, its other half, the next."""

    start: Numbers
    end: Numbers
    face: Numbers
    twin: Numbers
    following: Numbers


@dataclass(frozen=True, slots=True)
class _Runs:
    """Straight stretches of the bounds of faces: first and last side (ascending by the first), and the next stretch."""

    first: Numbers
    last: Numbers
    following: Numbers


def planar_solid(nodes_mm: Coordinates, quads: Numbers) -> Solid:
    """Return the solid within a closed surface of planar quadrilaterals with outward normals.

    Parameters
    ----------
    nodes_mm
        Shape (n, 3).
    quads
        Node numbers (m, 4).

    Raises
    ------
    SimulateError
        When the surface is not closed, is pinched to an edge, or a quadrilateral is warped.
    """
    normals = _normals(nodes_mm, quads)
    sides = _half_edges(quads, normals)
    runs = _straight_runs(nodes_mm, sides)
    # both halves of an edge know it by the lower of their first sides
    name = np.minimum(runs.first, sides.twin[runs.last])
    _, number = np.unique(name, return_inverse=True)
    forward = runs.first == name
    corners, ends = np.unique([sides.start[runs.first], sides.end[runs.last]], return_inverse=True)
    start, end = ends.reshape(2, -1)
    loops: dict[int, list[tuple[float, Loop]]] = {}
    for loop in _cycles(runs.following):
        points = nodes_mm[corners[start[loop]]]
        around = np.cross(points - points[0], np.roll(points, -1, axis=0) - points[0]).sum(axis=0)
        area = float(around @ normals[runs.first[loop[0]] // 4])
        own = loops.setdefault(int(sides.face[runs.first[loop[0]]]), [])
        own.append((area, tuple((int(number[run]), bool(forward[run])) for run in loop)))
    of_face = dict(zip(sides.face[runs.first].tolist(), (runs.first // 4).tolist(), strict=True))
    return Solid(
        corners_mm=nodes_mm[corners],
        edges=tuple(
            Edge(int(start[run]), int(end[run])) for run in np.flatnonzero(forward)[np.argsort(number[forward])]
        ),
        faces=tuple(
            Face(
                Plane(nodes_mm[quads[of_face[face], 0]], normals[of_face[face]]),
                # of the outer loop the area is positive
                tuple(loop for _, loop in sorted(found, key=lambda item: -item[0])),
            )
            for face, found in sorted(loops.items())
        ),
    )


def _normals(nodes_mm: Coordinates, quads: Numbers) -> Coordinates:
    """Return unit normals of quadrilaterals, all of which must be planar."""
    a, b, c, d = (nodes_mm[quads[:, i]] for i in range(4))
    normals = np.cross(c - a, d - b)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    warped_mm = np.abs(np.einsum("qx,qx->q", b - a, normals)).max()
    if not warped_mm <= _MOST_WARPED_MM:
        raise SimulateError(
            f"a quadrilateral of the surface is warped by {warped_mm:.2g} mm, but a flat face needs flat quadrilaterals"
        )
    return np.asarray(normals)


def _half_edges(quads: Numbers, normals: Coordinates) -> _HalfEdges:
    """Return the sides of quadrilaterals with the plane face that each belongs to."""
    start, end = quads.reshape(-1), np.roll(quads, -1, axis=1).reshape(-1)
    side = np.arange(len(start))
    order = np.lexsort((start > end, np.maximum(start, end), np.minimum(start, end)))
    one, two = order[0::2], order[1::2]
    if len(order) % 2 or (start[one] != end[two]).any() or (end[one] != start[two]).any() or _repeats(start, end):
        raise SimulateError(
            "the surface is open or pinched to an edge, but two faces must meet at every edge and run it in opposite "
            "directions"
        )
    twin = np.empty_like(side)
    twin[one], twin[two] = two, one
    turn = np.linalg.norm(np.cross(normals[one // 4], normals[two // 4]), axis=1)
    flat = (turn < _SAME_PLANE_RAD) & (np.einsum("qx,qx->q", normals[one // 4], normals[two // 4]) > 0.0)
    pairs = (one[flat] // 4, two[flat] // 4)
    _, face = connected_components(coo_array((np.ones(flat.sum()), pairs), shape=(len(quads), len(quads))), False)
    return _HalfEdges(start, end, np.repeat(face, 4).astype(np.int64), twin, side - side % 4 + (side + 1) % 4)


def _repeats(start: Numbers, end: Numbers) -> bool:
    """Tell whether an edge is run twice in one direction."""
    return len(np.unique(start * (int(end.max()) + 1) + end)) < len(start)


def _next_on_bound(sides: _HalfEdges, bounds: NDArray[np.bool_]) -> Numbers:
    """Return the side that follows each on the bounds of its face: round its end, across sides within the face."""
    following = np.where(bounds, sides.following, -1)
    inside = bounds & ~bounds[following]
    while inside.any():
        following[inside] = sides.following[sides.twin[following[inside]]]
        inside = bounds & ~bounds[following]
    return following


def _straight_runs(nodes_mm: Coordinates, sides: _HalfEdges) -> _Runs:
    """Return the straight stretches of the bounds between two faces."""
    bounds = sides.face != sides.face[sides.twin]
    step = _next_on_bound(sides, bounds)
    on_bounds = np.flatnonzero(bounds)
    after = step[on_bounds]
    direction = nodes_mm[sides.end] - nodes_mm[sides.start]
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    straight = np.linalg.norm(np.cross(direction[on_bounds], direction[after]), axis=1) < _SAME_PLANE_RAD
    goes_on = straight & (step[sides.twin[after]] == sides.twin[on_bounds])
    joined = np.full(len(step), -1)
    joined[on_bounds[goes_on]] = after[goes_on]
    first = np.setdiff1d(on_bounds, after[goes_on])
    last = first
    while (joined[last] >= 0).any():
        last = np.where(joined[last] >= 0, joined[last], last)
    return _Runs(first, last, np.searchsorted(first, step[last]))


def _cycles(following: Numbers) -> Iterator[Numbers]:
    """Yield the cycles of a permutation."""
    free = np.ones(len(following), dtype=np.bool_)
    for beginning in range(len(following)):
        cycle = []
        at = beginning
        while free[at]:
            free[at] = False
            cycle.append(at)
            at = int(following[at])
        if cycle:
            yield np.array(cycle)


_HEADER_BYTES = 80
_RECORD = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])


def stl_bytes(triangles: NDArray[np.int64], vertices_mm: NDArray[np.float64], title: str) -> bytes:
    """Return a binary STL file, in mm.

    Parameters
    ----------
    triangles
        Vertex numbers (m, 3), counter-clockwise seen from outside.
    vertices_mm
        Shape (n, 3).
    title
        Text of the header: up to 80 ASCII characters that do not begin with "solid".

    Raises
    ------
    SimulateError
        When the title begins with "solid", by which readers know the text format, or is not ASCII or too long.
    """
    if title.startswith("solid") or not title.isascii() or len(title) > _HEADER_BYTES:
        raise SimulateError(
            f"the title of an STL file must be up to {_HEADER_BYTES} ASCII characters that do not begin with 'solid', "
            f"got {title!r}"
        )
    corners = vertices_mm[triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    records = np.zeros(len(triangles), dtype=_RECORD)
    records["normal"] = normals / np.where(lengths > 0.0, lengths, 1.0)
    records["corners"] = corners
    header = title.encode("ascii").ljust(_HEADER_BYTES)
    return b"".join([header, np.array(len(triangles), dtype="<u4").tobytes(), records.tobytes()])


FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

_TOUCH_MM = 1e-9  # far above rounding, and far below the nanometre at which vertices are one


_CELLS_PER_TRIANGLE, _MOST_CELLS = 2.0, 256  # of the grid that finds triangles near an edge; along an axis
_FAR_SHARE = 200  # one of so many corners may lie outside this grid at each end of an axis


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
            raise SimulateError(f"the {body} intersects itself, because {what}; use a finer mesh or a smaller press")


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
    found = _first_meeting(vertices_mm, edges, np.ascontiguousarray(triangles))
    return None if found[0] < 0 else (edges[found[0]], triangles[found[1]])


@compiled
def _first_meeting(vertices: FloatArray, edges: IntArray, triangles: IntArray) -> tuple[int, int]:
    """Return the numbers of an edge and a triangle that meet, or -1, -1.

    Space is divided into about twice as many cells as there are triangles. Each cell lists the triangles whose boxes
    reach into it, and an edge is tried with those of the cells that its own box reaches into. The outermost cells have
    no end: the grid spans all corners but a few, so that one far away does not take it from the others.
    """
    low, extent = np.empty(3), np.empty(3)
    for t in range(3):
        used = np.sort(vertices[triangles.ravel(), t])
        few = len(used) // _FAR_SHARE
        low[t] = used[few]
        extent[t] = max(used[len(used) - 1 - few] - low[t], _TOUCH_MM)
    edge_mm = (extent[0] * extent[1] * extent[2] / (_CELLS_PER_TRIANGLE * len(triangles))) ** (1.0 / 3.0)
    cells, per_mm = np.empty(3, np.int64), np.empty(3)
    for t in range(3):
        cells[t] = min(max(1, int(extent[t] / edge_mm)), _MOST_CELLS)
        per_mm[t] = cells[t] / extent[t]
    boxes, spans = np.empty((len(triangles), 6)), np.empty((len(triangles), 6), np.int64)
    begins = np.zeros(cells[0] * cells[1] * cells[2] + 1, np.int64)
    for j in range(len(triangles)):
        _fill_span(vertices, triangles[j], low, per_mm, cells, boxes[j], spans[j])
        for p in range(spans[j, 0], spans[j, 1]):
            for q in range(spans[j, 2], spans[j, 3]):
                for r in range(spans[j, 4], spans[j, 5]):
                    begins[(p * cells[1] + q) * cells[2] + r + 1] += 1
    begins = np.cumsum(begins)
    ends, listed = begins[:-1].copy(), np.empty(begins[-1], np.int64)
    for j in range(len(triangles)):
        for p in range(spans[j, 0], spans[j, 1]):
            for q in range(spans[j, 2], spans[j, 3]):
                for r in range(spans[j, 4], spans[j, 5]):
                    cell = (p * cells[1] + q) * cells[2] + r
                    listed[ends[cell]] = j
                    ends[cell] += 1
    box, span = np.empty(6), np.empty(6, np.int64)
    for i in range(len(edges)):
        _fill_span(vertices, edges[i], low, per_mm, cells, box, span)
        for p in range(span[0], span[1]):
            for q in range(span[2], span[3]):
                for r in range(span[4], span[5]):
                    cell = (p * cells[1] + q) * cells[2] + r
                    for k in range(begins[cell], begins[cell + 1]):
                        j = listed[k]
                        if _overlap(box, boxes[j]) and _meet(vertices, edges[i], triangles[j]):
                            return i, j
    return -1, -1


@compiled_inside
def _fill_span(
    vertices: FloatArray,
    corners: IntArray,
    low: FloatArray,
    per_mm: FloatArray,
    cells: IntArray,
    box: FloatArray,
    span: IntArray,
) -> None:
    """Fill the box of corners, low and high along each axis, and the first cell and the one behind the last in it."""
    for t in range(3):
        least = most = vertices[corners[0], t]
        for k in range(1, len(corners)):
            least, most = min(least, vertices[corners[k], t]), max(most, vertices[corners[k], t])
        box[2 * t], box[2 * t + 1] = least - _TOUCH_MM, most + _TOUCH_MM
        begin = math.floor((box[2 * t] - low[t]) * per_mm[t])
        end = math.floor((box[2 * t + 1] - low[t]) * per_mm[t])
        span[2 * t], span[2 * t + 1] = min(max(begin, 0), cells[t] - 1), min(max(end, 0), cells[t] - 1) + 1


@compiled_inside
def _overlap(one: FloatArray, other: FloatArray) -> bool:
    """Tell whether two boxes meet."""
    return bool(
        one[0] <= other[1]
        and one[1] >= other[0]
        and one[2] <= other[3]
        and one[3] >= other[2]
        and one[4] <= other[5]
        and one[5] >= other[4]
    )


@compiled_inside
def _meet(vertices: FloatArray, edge: IntArray, triangle: IntArray) -> bool:
    """Tell whether an edge and a triangle that share no vertex meet, other than in one plane."""
    for k in range(3):
        if triangle[k] == edge[0] or triangle[k] == edge[1]:
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
