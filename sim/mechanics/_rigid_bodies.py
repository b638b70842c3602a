"""Rigid bodies: exact signed distances with normals and curvatures, and closed triangle meshes (mm).

Meshes are facets of exact bodies or the STL files of a user.
"""

import math
import struct
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from data_schemas import SimulateError
from data_schemas.storage import finite_number, read_bytes

FloatArray = NDArray[np.float64]

Distances = tuple[FloatArray, FloatArray, FloatArray]
"""Distance (m,), negative inside, in mm; its gradient (m, 3), the outward normal; its Hessian (m, 3, 3) in 1/mm."""

_ORTHONORMAL = 1e-9  # a rotation matrix may miss R R^T = 1 by this much


class Body(Protocol):
    """A rigid body in its own axes."""

    def distances(self, points_mm: FloatArray) -> Distances:
        """Return signed distance, gradient and Hessian at points (m, 3) in mm."""
        ...


def _check_positive(body: str, **sizes_mm: float) -> None:
    for name, value in sizes_mm.items():
        if not value > 0.0:
            raise SimulateError(f"{body}: {name} must be above 0 mm, got {value:g} mm")


def _check_edge(body: str, edge_mm: float, limit_mm: float) -> None:
    if not 0.0 < edge_mm <= limit_mm:
        raise SimulateError(
            f"{body}: edge_radius_mm must be above 0 and at most {limit_mm:g} mm (half of the least size), got "
            f"{edge_mm:g} mm"
        )


@dataclass(frozen=True, slots=True)
class Sphere:
    """Sphere about the origin."""

    radius_mm: float

    def __post_init__(self) -> None:
        _check_positive("sphere", radius_mm=self.radius_mm)

    def distances(self, points_mm: FloatArray) -> Distances:
        """Return |x| - R, x / |x| and (1 - n n) / |x|."""
        r = np.linalg.norm(points_mm, axis=1)
        normal = points_mm / r[:, None]
        return r - self.radius_mm, normal, (np.eye(3) - _outer(normal, normal)) / r[:, None, None]


@dataclass(frozen=True, slots=True)
class Cylinder:
    """Cylinder about the x axis with its middle in the origin; endless without a half length, else of rounded rims."""

    radius_mm: float
    half_length_mm: float = math.inf
    edge_radius_mm: float = 1.0

    def __post_init__(self) -> None:
        _check_positive("cylinder", radius_mm=self.radius_mm, half_length_mm=self.half_length_mm)
        if self.half_length_mm < math.inf:
            _check_edge("cylinder", self.edge_radius_mm, min(self.radius_mm, self.half_length_mm))

    def distances(self, points_mm: FloatArray) -> Distances:
        """Return the distance from the rounded rectangle of half section, turned about the axis."""
        axis = np.array([1.0, 0.0, 0.0])
        radial = points_mm * (1.0 - axis)
        rho = np.linalg.norm(radial, axis=1)
        outward = radial / rho[:, None]
        around = np.eye(3) - _outer(outward, outward) - np.outer(axis, axis)
        if self.half_length_mm == math.inf:
            return rho - self.radius_mm, outward, around / rho[:, None, None]
        half = np.array([self.radius_mm, self.half_length_mm])
        distance, slope, curve = _rounded_box(np.stack([rho, points_mm[:, 0]], 1), half, self.edge_radius_mm)
        normal = slope[:, :1] * outward + slope[:, 1:] * axis
        along = np.broadcast_to(axis, outward.shape)
        mixed = _outer(outward, along)
        hessian = curve[:, 0, 0, None, None] * _outer(outward, outward) + curve[:, 1, 1, None, None] * _outer(
            along, along
        )
        hessian += curve[:, 0, 1, None, None] * (mixed + mixed.transpose(0, 2, 1))
        return distance, normal, hessian + (slope[:, 0] / rho)[:, None, None] * around


@dataclass(frozen=True, slots=True)
class RoundedBox:
    """Cuboid about the origin with rounded edges and corners; sizes include them."""

    half_sizes_mm: tuple[float, float, float]
    edge_radius_mm: float

    def __post_init__(self) -> None:
        _check_positive("cuboid", **dict(zip(("half_x_mm", "half_y_mm", "half_z_mm"), self.half_sizes_mm, strict=True)))
        _check_edge("cuboid", self.edge_radius_mm, min(self.half_sizes_mm))

    def distances(self, points_mm: FloatArray) -> Distances:
        """Return the distance from the box shrunk by the edge radius, less that radius."""
        return _rounded_box(points_mm, np.array(self.half_sizes_mm), self.edge_radius_mm)


def _rounded_box(points: FloatArray, half: FloatArray, edge: float) -> Distances:
    """Distances of a rounded box in two or three dimensions."""
    axes = points.shape[1]
    side = np.where(points >= 0.0, 1.0, -1.0)
    beyond = np.abs(points) - (half - edge)
    out = beyond > 0.0
    reach = np.where(out, beyond, 0.0)
    length = np.linalg.norm(reach, axis=1)
    outside = length > 0.0
    safe = np.where(outside, length, 1.0)
    nearest = np.eye(axes)[beyond.argmax(1)]
    normal = np.where(outside[:, None], reach / safe[:, None], nearest)
    hessian = (np.eye(axes) * out[:, :, None] - _outer(normal, normal)) / safe[:, None, None]
    hessian[~outside] = 0.0
    distance = np.where(outside, length, beyond.max(1)) - edge
    return distance, normal * side, hessian * _outer(side, side)


def _outer(a: FloatArray, b: FloatArray) -> FloatArray:
    return a[:, :, None] * b[:, None, :]


@dataclass(frozen=True, slots=True)
class Pose:
    """Place of a body's origin in mm and its rotation: columns are the body's axes in space."""

    position_mm: tuple[float, float, float]
    rotation: FloatArray = field(default_factory=lambda: np.eye(3))

    def __post_init__(self) -> None:
        r = self.rotation
        if r.shape != (3, 3) or np.abs(r @ r.T - np.eye(3)).max() > _ORTHONORMAL or np.linalg.det(r) < 0.0:
            raise SimulateError(f"a pose's rotation must be a proper rotation matrix (3, 3), got {r.tolist()}")

    def distances(self, body: Body, points_mm: FloatArray) -> Distances:
        """Return the distances of a body in this pose at points (m, 3) in space."""
        r = self.rotation
        distance, normal, hessian = body.distances((points_mm - np.array(self.position_mm)) @ r)
        return distance, normal @ r.T, r @ hessian @ r.T


IntArray = NDArray[np.int64]

_HEADER_BYTES = 80
_LARGEST_STL_BYTES = 64 << 20  # a million triangles: far more than a contact search takes
_RECORD = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
_SAME_SHARE = 1e-6  # corners closer than this share of the body's size are one
_LEAST_VOLUME = 1e-9  # of the cube of its size; what rounding leaves of two sides that lie on each other
_LEAST_MM, _MOST_MM = 0.5, 300.0
_MM_PER_INCH = 25.4
_SEGMENT_MM = 5.0  # of long facets: their boxes stay small when the body is turned


@dataclass(frozen=True, slots=True)
class TriangleMesh:
    """Vertices (m, 3) in mm and triangles (k, 3), outward."""

    vertices_mm: FloatArray
    triangles: IntArray


_SEARCH_PIECES = 4000  # into about so many are triangles divided for the search
_MOST_DIVISIONS = 16
_BESIDE_MM = 2.0  # points further outside the box are told their distance from the box
_ON_SURFACE_MM = 1e-9


class FacetedBody:
    """Closed triangle mesh in its own axes: the exact signed distance from its facets.

    d = s |x - c| with the nearest point c of the facets. The sign s is that of (x - c) . n with the normal n of the
    face, edge or corner that c lies on, where those of edges and corners are the sum of their faces' normals, weighted
    by angle (Baerentzen and Aanaes 2005). Points over 2 mm outside the body's box get the distance from the box, which
    is less. Facets have no curvature, so that the second derivative is given as zero: that of edges is left out.

    Parameters
    ----------
    surface
        See :func:`read_body`.
    """

    def __init__(self, surface: TriangleMesh) -> None:
        self.surface = surface
        self._corners = surface.vertices_mm[surface.triangles]
        self._normals = _feature_normals(surface)
        self._box = self._corners.min(axis=(0, 1)), self._corners.max(axis=(0, 1))
        pieces, self._owner = _search_pieces(self._corners)
        middles = pieces.mean(axis=1)
        self._reach_mm = float(np.linalg.norm(pieces - middles[:, None], axis=2).max())
        self._tree = cKDTree(middles)
        self._last: tuple[FloatArray, Distances] | None = None

    def distances(self, points_mm: FloatArray) -> Distances:
        """Return signed distance, gradient and zero."""
        # energy, gradient and tangent ask at one state after the other
        if self._last is not None and np.array_equal(self._last[0], points_mm):
            return self._last[1]
        low, high = self._box
        beyond = points_mm - np.clip(points_mm, low, high)
        distance = np.linalg.norm(beyond, axis=1)
        normal = beyond / np.maximum(distance, _ON_SURFACE_MM)[:, None]
        near = np.flatnonzero(distance <= _BESIDE_MM)
        if len(near):
            distance[near], normal[near] = self._from_facets(points_mm[near])
        found = distance, normal, np.zeros((len(points_mm), 3, 3))
        self._last = points_mm.copy(), found
        return found

    def _from_facets(self, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return signed distance and gradient at points near the body."""
        from_middle, _ = self._tree.query(points)
        found = np.asarray(
            self._tree.query_ball_point(points, from_middle + self._reach_mm * (1.0 + 1e-9)), dtype=object
        )
        counts = np.array([len(some) for some in found])
        row = np.repeat(np.arange(len(points)), counts)
        facet = self._owner[np.concatenate(found).astype(np.int64)]
        weights = _nearest_weights(points[row], self._corners[facet])
        way = points[row] - np.einsum("ka,kai->ki", weights, self._corners[facet])
        length = np.linalg.norm(way, axis=1)
        order = np.lexsort((length, row))
        best = order[np.concatenate([[0], np.cumsum(counts)[:-1]])]
        feature = _FEATURE[(weights[best] > 0.0) @ np.array([1, 2, 4])]
        outward = self._normals[facet[best], feature]
        side = np.where(np.einsum("ki,ki->k", way[best], outward) >= 0.0, 1.0, -1.0)
        size = length[best]
        on = size < _ON_SURFACE_MM
        straight = side[:, None] * way[best] / np.where(on, 1.0, size)[:, None]
        return side * size, np.where(on[:, None], outward, straight)


# which of a triangle's normals holds where, by which corners have a share: corners 4 to 6, the edges opposite to them 1
# to 3, the face 0
_FEATURE = np.array([0, 4, 5, 3, 6, 2, 1, 0])


def least_radius_mm(body: Body) -> float:
    """Return the radius of a body's sharpest edge; 0 of facets, and of packaged bodies with sharp edges."""
    if isinstance(body, RoundedBox):
        return body.edge_radius_mm
    if isinstance(body, Cylinder):
        return body.radius_mm if body.half_length_mm == math.inf else body.edge_radius_mm
    return body.radius_mm if isinstance(body, Sphere) else float(getattr(body, "least_radius_mm", 0.0))


def _feature_normals(surface: TriangleMesh) -> FloatArray:
    """Return the unit normals (k, 7, 3) of each triangle's face, edges (opposite to each corner) and corners."""
    corners = surface.vertices_mm[surface.triangles]
    face = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    face /= np.linalg.norm(face, axis=1, keepdims=True)
    at_vertex = np.zeros_like(surface.vertices_mm)
    edges = np.stack([surface.triangles[:, [1, 2]], surface.triangles[:, [2, 0]], surface.triangles[:, [0, 1]]], axis=1)
    keys = np.sort(edges, axis=2) @ np.array([len(surface.vertices_mm), 1])
    _, edge = np.unique(keys, return_inverse=True)
    edge = edge.reshape(keys.shape)
    at_edge = np.zeros((edge.max() + 1, 3))
    for k in range(3):
        a, b = (corners[:, (k + 1) % 3] - corners[:, k]), (corners[:, (k + 2) % 3] - corners[:, k])
        angle = np.arctan2(np.linalg.norm(np.cross(a, b), axis=1), np.einsum("ki,ki->k", a, b))
        np.add.at(at_vertex, surface.triangles[:, k], angle[:, None] * face)
        np.add.at(at_edge, edge[:, k], face)
    whole = np.concatenate([face[:, None], at_edge[edge], at_vertex[surface.triangles]], axis=1)
    return np.asarray(whole / np.maximum(np.linalg.norm(whole, axis=2, keepdims=True), 1e-300))


def _search_pieces(corners: FloatArray) -> tuple[FloatArray, IntArray]:
    """Return triangles (m, 3, 3) that are the given ones, long ones halved, and which of these each belongs to."""
    areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 2.0
    longest_mm = 2.0 * math.sqrt(float(areas.sum()) / _SEARCH_PIECES)
    pieces, owner = corners, np.arange(len(corners))
    for _ in range(_MOST_DIVISIONS):
        lengths = np.linalg.norm(pieces - np.roll(pieces, -1, axis=1), axis=2)
        long = np.flatnonzero(lengths.max(axis=1) > longest_mm)
        if not len(long):
            break
        first = lengths[long].argmax(axis=1)
        a, b, c = (pieces[long, (first + k) % 3] for k in range(3))
        middle = (a + b) / 2.0
        halves = np.concatenate([np.stack([a, middle, c], axis=1), np.stack([middle, b, c], axis=1)])
        pieces = np.concatenate([np.delete(pieces, long, axis=0), halves])
        owner = np.concatenate([np.delete(owner, long), owner[long], owner[long]])
    return pieces, owner


def _nearest_weights(points: FloatArray, corners: FloatArray) -> FloatArray:
    """Return the weights (k, 3) of the corners (k, 3, 3) at the triangle's point nearest to each point (k, 3)."""
    best, least = np.zeros((len(points), 3)), np.full(len(points), np.inf)
    rows = np.arange(len(points))
    for k in range(3):
        start, end = corners[:, k], corners[:, (k + 1) % 3]
        way = end - start
        size = np.maximum(np.einsum("ki,ki->k", way, way), 1e-300)
        share = np.clip(np.einsum("ki,ki->k", points - start, way) / size, 0.0, 1.0)
        off = np.linalg.norm(points - start - share[:, None] * way, axis=1)
        closer = off < least
        weights = np.zeros((len(points), 3))
        weights[:, k], weights[:, (k + 1) % 3] = 1.0 - share, share
        best[closer], least[closer] = weights[closer], off[closer]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    double = np.maximum(np.einsum("ki,ki->k", normal, normal), 1e-300)
    inner = np.empty((len(points), 3))
    for k in range(3):
        a, b = corners[rows, (k + 1) % 3], corners[rows, (k + 2) % 3]
        inner[:, k] = np.einsum("ki,ki->k", np.cross(b - a, points - a), normal) / double
    inside = np.all(inner > 0.0, axis=1, keepdims=True)
    return np.where(inside, inner, best)


def rotation_matrix(x_deg: float, y_deg: float, z_deg: float) -> FloatArray:
    """Return the matrix (3, 3) that turns about x, then y, then z, all of them axes in space."""
    turned = np.eye(3)
    for axis, angle_deg in enumerate((x_deg, y_deg, z_deg)):
        c, s = math.cos(math.radians(angle_deg)), math.sin(math.radians(angle_deg))
        i, j = (axis + 1) % 3, (axis + 2) % 3
        step = np.eye(3)
        step[i, i], step[i, j], step[j, i], step[j, j] = c, -s, s, c
        turned = step @ turned
    return turned


def body_mesh(body: Body, chord_mm: float, half_length_mm: float) -> TriangleMesh:
    """Return a body's facets, whose middles lie at most `chord_mm` inside its round faces.

    A cylinder without ends is cut to `half_length_mm` on both sides.
    """
    if isinstance(body, RoundedBox):
        half, edge = np.array(body.half_sizes_mm), body.edge_radius_mm
    else:
        radius = float(getattr(body, "radius_mm"))  # noqa: B009
        half, edge = np.full(3, radius), radius
    if isinstance(body, Cylinder):
        return _tube(body.radius_mm, half_length_mm, chord_mm)
    return _rounded_box_facets(half, edge, chord_mm)


def sphere_facets(chord_share: float) -> TriangleMesh:
    """Return facets of a sphere of radius 1 mm about the origin, whose middles lie so much inside it at most."""
    return _rounded_box_facets(np.ones(3), 1.0, chord_share)


def _parts(radius_mm: float, angle: float, chord_mm: float) -> int:
    """Return into how many facets an arc must be divided: chord = R (1 - cos(step / 2))."""
    return max(2, math.ceil(angle / (2.0 * math.acos(1.0 - min(chord_mm / radius_mm, 0.5)))))


def _tube(radius_mm: float, half_length_mm: float, chord_mm: float) -> TriangleMesh:
    """Return a closed tube about x."""
    around = _parts(radius_mm, 2.0 * math.pi, chord_mm)
    along = max(1, math.ceil(2.0 * half_length_mm / _SEGMENT_MM))
    angle = 2.0 * np.pi * np.arange(around) / around
    ring = radius_mm * np.column_stack([np.cos(angle), np.sin(angle)])
    x = np.linspace(-half_length_mm, half_length_mm, along + 1)
    side = np.concatenate([np.column_stack([np.full(around, at), ring]) for at in x])
    ends = np.array([[x[0], 0.0, 0.0], [x[-1], 0.0, 0.0]])
    i = np.arange(around)
    n = (i + 1) % around
    first, last, middle = 0, along * around, len(side)
    triangles = [np.column_stack([np.full(around, middle), n + first, i + first])]
    for k in range(along):
        low, high = k * around, (k + 1) * around
        triangles += [np.column_stack([i + low, n + low, n + high]), np.column_stack([i + low, n + high, i + high])]
    triangles.append(np.column_stack([np.full(around, middle + 1), i + last, n + last]))
    return TriangleMesh(np.concatenate([side, ends]), np.concatenate(triangles))


def _rounded_box_facets(half_mm: FloatArray, edge_mm: float, chord_mm: float) -> TriangleMesh:
    """Return a box whose faces are grids that are bent over its edges: the points of a cube, moved onto the body."""
    # a point of a bent grid lies up to sqrt(2) steps from its neighbours across a corner: half the chord each way
    parts = _parts(edge_mm, np.pi / 2.0, chord_mm / 2.0)
    rounded = edge_mm * np.tan(np.linspace(0.0, np.pi / 4.0, math.ceil(parts / 2) + 1))
    steps = []
    for inner in half_mm - edge_mm:
        flat = np.linspace(-inner, inner, math.ceil(2.0 * inner / _SEGMENT_MM) + 1) if inner > 0.0 else np.zeros(1)
        steps.append(np.concatenate([-inner - rounded[:0:-1], flat, inner + rounded[1:]]))
    vertices, triangles, count = [], [], 0
    for axis in range(3):
        a, b = (axis + 1) % 3, (axis + 2) % 3
        grid_a, grid_b = np.meshgrid(steps[a], steps[b], indexing="ij")
        numbers = np.arange(grid_a.size).reshape(grid_a.shape)
        q = [numbers[:-1, :-1], numbers[1:, :-1], numbers[1:, 1:], numbers[:-1, 1:]]
        p, r, s, t = (c.ravel() for c in q)
        for side in (1.0, -1.0):
            points = np.empty((grid_a.size, 3))
            points[:, a], points[:, b], points[:, axis] = grid_a.ravel(), grid_b.ravel(), side * half_mm[axis]
            order = (p, r, s, t) if side > 0.0 else (p, t, s, r)
            w, x, y, z = (o + count for o in order)
            triangles += [np.column_stack([w, x, y]), np.column_stack([w, y, z])]
            vertices.append(points)
            count += len(points)
    cube = np.concatenate(vertices)
    core = np.clip(cube, edge_mm - half_mm, half_mm - edge_mm)
    off = cube - core
    bent = core + edge_mm * off / np.linalg.norm(off, axis=1, keepdims=True)
    return _welded(bent, np.concatenate(triangles))


def _welded(vertices: FloatArray, triangles: IntArray) -> TriangleMesh:
    """Return a mesh whose equal corners are one vertex, without triangles that vanish by it."""
    apart_mm = _SAME_SHARE * (float(np.ptp(vertices, axis=0).max()) or 1.0)
    _, first, number = np.unique(np.round(vertices / apart_mm), axis=0, return_index=True, return_inverse=True)
    kept, number = vertices[first], number.reshape(-1)
    if len(kept):
        # rounding parts corners that lie on both sides of a boundary, however close they are
        pairs = cKDTree(kept).query_pairs(apart_mm, output_type="ndarray")
        joined = coo_array((np.ones(len(pairs), dtype=np.bool_), pairs.T), shape=(len(kept), len(kept)))
        _, lead, body = np.unique(
            connected_components(joined, directed=False)[1], return_index=True, return_inverse=True
        )
        kept, number = kept[lead], body.reshape(-1)[number]
    merged = number[triangles]
    a, b, c = merged.T
    return TriangleMesh(kept, merged[(a != b) & (b != c) & (c != a)])


def read_body(path: Path) -> TriangleMesh:
    """Return the closed body of an STL file (binary or text), in mm, with outward triangles.

    Raises
    ------
    SimulateError
        When it cannot be read, is open, twisted or of no volume, or of a size that cannot be mm.
    """
    vertices, triangles = read_triangles(path, "the indenter's STL file (indenter.file)")
    if not len(triangles):
        raise SimulateError(f"{path}: contains no triangles, but an indenter must be a closed body")
    mesh = _welded(vertices, triangles)
    check_closed_body(mesh, str(path))
    if not len(mesh.triangles):
        raise SimulateError(f"{path}: none of the triangles has an area, but an indenter must be a closed body")
    corners = mesh.vertices_mm[mesh.triangles]
    volume = float(np.einsum("ki,ki->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2]))) / 6.0
    if abs(volume) < _LEAST_VOLUME * float(np.ptp(mesh.vertices_mm, axis=0).max()) ** 3:
        raise SimulateError(f"{path}: the triangles enclose no volume, but an indenter must be a closed body")
    if volume < 0.0:
        raise SimulateError(
            f"{path}: the body is inside out, because its triangles face inward (enclosed volume {volume:.4g} mm3); "
            "turn the normals outward in a modelling program and export it again"
        )
    return mesh


def check_closed_body(mesh: TriangleMesh, name: str) -> None:
    """Check that each edge belongs to two triangles that run it in opposite directions, and that the size can be mm.

    Raises
    ------
    SimulateError
        When not; the message counts the edges.
    """
    directed = np.concatenate([mesh.triangles[:, list(pair)] for pair in ((0, 1), (1, 2), (2, 0))])
    keys = np.sort(directed, axis=1) @ np.array([len(mesh.vertices_mm), 1])
    _, place, times = np.unique(keys, return_inverse=True, return_counts=True)
    if (times != 2).any():
        raise SimulateError(
            f"{name}: the body is not closed, because {int((times == 1).sum())} edges belong to only one triangle and "
            f"{int((times > 2).sum())} to more than two; close the body in a modelling program and export it again"
        )
    runs = np.bincount(place, np.where(directed[:, 0] < directed[:, 1], 1, -1))
    if runs.any():
        raise SimulateError(
            f"{name}: some triangles are inside out, because {int((runs != 0).sum())} edges have two triangles of "
            "opposite orientation; orient all triangles outward in a modelling program and export the body again"
        )
    size = float(np.ptp(mesh.vertices_mm, axis=0).max())
    if not _LEAST_MM <= size <= _MOST_MM:
        small = "metres" if size * _MM_PER_INCH < _LEAST_MM else "inches or metres"
        meant = small if size < _LEAST_MM else "micrometres"
        raise SimulateError(
            f"{name}: the body measures {size:g} mm, but must measure {_LEAST_MM:g} to {_MOST_MM:g} mm. The file seems "
            f"to be in {meant}; export it in mm"
        )


def read_triangles(path: Path, what: str) -> tuple[FloatArray, IntArray]:
    """Return the corners (3 k, 3) of an STL file's triangles in mm, three vertices each, and the triangles (k, 3).

    Raises
    ------
    SimulateError
        When it cannot be read; the message says what should lie there.
    """
    data = read_bytes(path, what, SimulateError, _LARGEST_STL_BYTES)
    count = struct.unpack_from("<I", data, _HEADER_BYTES)[0] if len(data) >= _HEADER_BYTES + 4 else -1
    if len(data) == _HEADER_BYTES + 4 + count * _RECORD.itemsize:
        corners = np.frombuffer(data, _RECORD, count, _HEADER_BYTES + 4)["corners"].astype(np.float64)
    else:
        corners = _text_stl(data, path)
    vertices = corners.reshape(-1, 3)
    if not np.isfinite(vertices).all():
        raise SimulateError(f"{path}: contains vertices with coordinates that are not finite; export the body again")
    return vertices, np.arange(len(vertices)).reshape(-1, 3)


def _text_stl(data: bytes, path: Path) -> FloatArray:
    """Return the corners (3 k, 3) of a text STL."""
    words = data.decode("ascii", "replace").split()
    try:
        if words[0] != "solid":
            raise ValueError
        at = [k for k, word in enumerate(words) if word == "vertex"]
        corners = np.array([[finite_number(number) for number in words[k + 1 : k + 4]] for k in at])
        return corners.reshape(-1, 9)
    except (ValueError, IndexError) as error:
        raise SimulateError(f"{path}: is neither a binary nor a text STL file; export it as STL, in mm") from error
