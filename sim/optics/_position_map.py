"""Where a face of the gel is: a smooth map from its reference coordinates (u, v) to mm, with two derivatives.

A tensor product of uniform cubic B-splines, fitted to the vertices of a mesh; so the face has a tangent plane and a
curvature everywhere, which the facets of the mesh have not. Structured grids and unstructured meshes alike. Along each
direction, `cells` cells have `cells + 3` coefficients; one piece of arithmetic serves numpy's arrays and the
renderer's.
"""

import hashlib
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array, csr_array, diags_array, eye_array, kron, vstack
from scipy.sparse.linalg import spsolve

from data_schemas import ImpossibleFingerError
from sim.optics._path_rules import LookupTable, cell_at
from sim.surface_meshes import Surface

Vector = tuple[Any, Any, Any]


def cell_and_fraction(u: NDArray[np.float64], cells: int) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Return the cell that holds u (the last one for u = 1) and the position within it."""
    x = u * cells
    # a comparison is false for NaN, which clip lets pass
    i = np.where(x > 0.0, np.minimum(np.floor(x), cells - 1), 0.0).astype(np.int64)
    return i, x - i


def spline_weights(t: Any, cells: int) -> tuple[tuple[Any, ...], tuple[Any, ...], tuple[Any, ...]]:
    """Return the four cubic B-splines at a fraction t of a cell, and their derivatives by the coordinate."""
    s = 1.0 - t
    value = (
        s * s * s / 6.0,
        (4.0 - t * t * (6.0 - 3.0 * t)) / 6.0,
        (4.0 - s * s * (6.0 - 3.0 * s)) / 6.0,
        t * t * t / 6.0,
    )
    half, square = 0.5 * cells, float(cells) ** 2
    first = (-half * s * s, half * t * (3.0 * t - 4.0), half * s * (4.0 - 3.0 * s), half * t * t)
    second = (square * s, square * (3.0 * t - 2.0), square * (3.0 * s - 2.0), square * t)
    return value, first, second


def tensor_sum(gather: Callable[[int, int], Vector], weights_u: Any, weights_v: Any) -> list[Vector]:
    """Return the value and its derivatives by u, v, uu, uv and vv: sums over the 4 x 4 neighbouring coefficients.

    Parameters
    ----------
    gather
        From offsets 0..3 along u and v to the coefficient there.
    weights_u, weights_v
        From :func:`spline_weights`.
    """
    orders = ((0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2))
    totals: list[list[Any]] = [[0.0] * 3 for _ in orders]
    for a in range(4):
        rows: list[list[Any]] = [[0.0] * 3 for _ in range(3)]
        for b in range(4):
            found = gather(a, b)
            for row, weight in zip(rows, weights_v, strict=True):
                for k in range(3):
                    row[k] = row[k] + weight[b] * found[k]
        for total, (in_u, in_v) in zip(totals, orders, strict=True):
            for k in range(3):
                total[k] = total[k] + weights_u[in_u][a] * rows[in_v][k]
    return [(t[0], t[1], t[2]) for t in totals]


def design_matrix(uv: NDArray[np.float64], cells: tuple[int, int]) -> csr_array:
    """Return the spline's values at places uv (n, 2) as a matrix on the coefficients, u before v."""
    (i, s), (j, t) = (cell_and_fraction(uv[:, k], cells[k]) for k in (0, 1))
    value_u, value_v = spline_weights(s, cells[0])[0], spline_weights(t, cells[1])[0]
    columns = np.stack([(i + a) * (cells[1] + 3) + (j + b) for a in range(4) for b in range(4)], axis=1)
    values = np.stack([value_u[a] * value_v[b] for a in range(4) for b in range(4)], axis=1)
    rows = np.repeat(np.arange(len(uv)), 16)
    size = (len(uv), (cells[0] + 3) * (cells[1] + 3))
    return coo_array((values.ravel(), (rows, columns.ravel())), shape=size).tocsr()


def third_differences(cells: tuple[int, int]) -> csr_array:
    """Return the third differences of the coefficients along both directions as one matrix."""
    counts = (cells[0] + 3, cells[1] + 3)
    along = [
        diags_array([-1.0, 3.0, -3.0, 1.0], offsets=[0, 1, 2, 3], shape=(count - 3, count)).tocsr() for count in counts
    ]
    return vstack([kron(along[0], eye_array(counts[1])), kron(eye_array(counts[0]), along[1])]).tocsr()


# a face bends over the thickness of the gel (about 6 mm), which cells of this size follow to parts in a million
_CELL_MM = 2.0
_MOST_CELLS = 64
# weight of the smoothness against one vertex: it settles what no vertex determines and moves nothing else
_SMOOTHNESS = 1e-7
# a map this near to a plane is one: below the rounding of single precision at 100 mm
_PLANE_MM = 1e-5
# faces of some fingers without and with contact
_MOST_FITTED = 64
_FITTED: "OrderedDict[bytes, PositionMap]" = OrderedDict()
# a mesh that leaves its smooth map by more than this is crumpled, or its texture coordinates are wrong
_LARGEST_GAP_MM = 0.3
# a place on the coat is served by points so near, across and along: the face blurs what it sends back over 12 mm
_REACH_MM = np.array([7.0, 12.0])
_HEIGHT_PRIOR = 1e-6


class FacePoint(NamedTuple):
    """Position on a face (mm) and its derivatives by u and v, each as three components of any one array type."""

    position: Vector
    du: Vector
    dv: Vector
    duu: Vector
    duv: Vector
    dvv: Vector


Evaluate = Callable[[Any, Any], FacePoint]
"""From (u, v) to the point of a face; u and v are arrays of one type."""


@dataclass(frozen=True, slots=True)
class PositionMap:
    """Coefficients (cells_u + 3, cells_v + 3, 3) of the spline in mm, and how far the mesh leaves it.

    ``gap_mm`` is the largest distance between mesh and map, at vertices and centres of triangles; ``turn`` is 1 where
    the mesh's normals are along d/du x d/dv and -1 where they are against it.
    """

    coefficients_mm: NDArray[np.float64]
    gap_mm: float = 0.0
    turn: float = 1.0

    @classmethod
    def of(cls, surface: Surface, name: str = "face") -> "PositionMap":
        """Fit the map to a mesh by least squares.

        The same mesh is fitted once: a render asks for the map of each face several times, and repeats of it again.
        Minimises the squared distance at the vertices plus a vanishing share of the squared third differences, which
        fills cells without a vertex smoothly. Exact for planes; for smooth faces of cell size h the
        error is of order h^4.

        Parameters
        ----------
        surface
            Mesh whose texture coordinates cover 0..1 in both directions without folds.
        name
            What the face is called in error messages.

        Raises
        ------
        SimulateError
            When the texture coordinates fold, or the mesh leaves every smooth map by more than 0.3 mm.
        """
        arrays = (surface.vertices_mm, surface.triangles, surface.uv)
        key = hashlib.blake2b(b"".join(array.tobytes() for array in arrays)).digest()
        if key not in _FITTED:
            fitted = cls._fitted(surface, name)
            fitted.coefficients_mm.flags.writeable = False  # it is shared
            _FITTED[key] = fitted
            if len(_FITTED) > _MOST_FITTED:
                _FITTED.popitem(last=False)
        return _FITTED[key]

    @classmethod
    def _fitted(cls, surface: Surface, name: str) -> "PositionMap":
        """Fit the map; see `of`."""
        turn = _turn(surface, name)
        cells = _cells(surface)
        fit = design_matrix(surface.uv, cells)
        rough = np.sqrt(_SMOOTHNESS) * third_differences(cells)
        normal_matrix = (fit.T @ fit + rough.T @ rough).tocsc()
        solved = spsolve(normal_matrix, fit.T @ surface.vertices_mm)
        coefficients = solved.reshape(cells[0] + 3, cells[1] + 3, 3)
        corners = surface.triangles
        middle_uv = np.concatenate([surface.uv, surface.uv[corners].mean(axis=1)])
        middle_mm = np.concatenate([surface.vertices_mm, surface.vertices_mm[corners].mean(axis=1)])
        gap = float(np.linalg.norm(cls(coefficients).positions_mm(middle_uv) - middle_mm, axis=-1).max())
        if gap > _LARGEST_GAP_MM:
            raise ImpossibleFingerError(
                f"the {name} is not a smooth face, because its mesh departs from the smooth map by {gap:.2g} mm and at "
                f"most {_LARGEST_GAP_MM} mm is allowed; check its texture coordinates, or refine the mesh"
            )
        return cls(coefficients, gap, turn)

    @property
    def is_plane(self) -> bool:
        """Whether the map is linear in u and v."""
        second = [np.abs(np.diff(self.coefficients_mm, 2, axis=axis)).max() for axis in (0, 1)]
        mixed = np.abs(np.diff(np.diff(self.coefficients_mm, axis=0), axis=1)).max()
        return bool(max(*second, mixed) < _PLANE_MM)

    def evaluate(self, u: NDArray[np.float64], v: NDArray[np.float64]) -> FacePoint:
        """Return points of the face and their derivatives for arrays u, v of equal shape, within 0..1."""
        if self.is_plane:
            return self._plane(u, v)
        i, s = cell_and_fraction(np.asarray(u, dtype=np.float64), self.coefficients_mm.shape[0] - 3)
        j, t = cell_and_fraction(np.asarray(v, dtype=np.float64), self.coefficients_mm.shape[1] - 3)

        def gather(a: int, b: int) -> Vector:
            found = self.coefficients_mm[i + a, j + b]
            return found[..., 0], found[..., 1], found[..., 2]

        return FacePoint(*tensor_sum(gather, spline_weights(s, self._cells[0]), spline_weights(t, self._cells[1])))

    def positions_mm(self, uv: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the positions (..., 3) at texture coordinates (..., 2)."""
        return np.stack(self.evaluate(uv[..., 0], uv[..., 1]).position, axis=-1)

    def normals(self, uv: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the unit normals (..., 3), on the side of the mesh's, at texture coordinates (..., 2)."""
        point = self.evaluate(uv[..., 0], uv[..., 1])
        normal = np.cross(np.stack(point.du, axis=-1), np.stack(point.dv, axis=-1))
        return np.asarray(self.turn * normal / np.linalg.norm(normal, axis=-1, keepdims=True))

    def in_renderer(self, renderer: Any) -> Evaluate:
        """Return :meth:`evaluate` for the renderer's arrays (compiled variants), differentiable by u and v.

        Written out instead of the renderer's cubic texture, whose derivatives cannot be differentiated again.
        """
        if self.is_plane:
            return self._plane_in_renderer(renderer)
        padded = np.pad(self.coefficients_mm, ((0, 0), (0, 0), (0, 1)))  # four numbers are fetched as one packet
        table, along = LookupTable(padded.reshape(-1, 4), renderer), self.coefficients_mm.shape[1]
        cells_u, cells_v = self._cells

        def evaluate(u: Any, v: Any) -> FacePoint:
            x, y = u * cells_u, v * cells_v
            i, j = cell_at(x, cells_u), cell_at(y, cells_v)

            def gather(a: int, b: int) -> Vector:
                found = table.row((i + a) * along + (j + b))
                return found.x, found.y, found.z

            weights_u = spline_weights(x - renderer.Float(i), cells_u)
            weights_v = spline_weights(y - renderer.Float(j), cells_v)
            return FacePoint(*tensor_sum(gather, weights_u, weights_v))

        return evaluate

    def _plane_in_renderer(self, renderer: Any) -> Evaluate:
        """Return the evaluation of a plane, without any look-up."""
        import drjit as dr

        origin, du, dv = (tuple(renderer.Float(float(c)) for c in vector) for vector in self._frame)
        # numbers that vary between scenes must not become constants of the compiled kernel
        dr.make_opaque(origin, du, dv)

        def evaluate(u: Any, v: Any) -> FacePoint:
            x, y, z = (o + a * u + b * v for o, a, b in zip(origin, du, dv, strict=True))
            # made anew: a literal that outlives a loop keeps the size that the loop gave it
            none = (renderer.Float(0.0),) * 3
            return FacePoint((x, y, z), du, dv, none, none, none)

        return evaluate

    def _plane(self, u: NDArray[np.float64], v: NDArray[np.float64]) -> FacePoint:
        """Return points of a plane."""
        shape = np.broadcast_shapes(np.shape(u), np.shape(v))
        origin, du, dv = self._frame
        x, y, z = (o + a * u + b * v for o, a, b in zip(origin, du, dv, strict=True))
        along_u, along_v, none = (
            (np.broadcast_to(d[0], shape), np.broadcast_to(d[1], shape), np.broadcast_to(d[2], shape))
            for d in (du, dv, np.zeros(3))
        )
        return FacePoint((x, y, z), along_u, along_v, none, none, none)

    @property
    def _frame(self) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """Position at u = v = 0 and the derivatives of a plane; its coefficients lie on an even grid."""
        c, (cells_u, cells_v) = self.coefficients_mm, self._cells
        du, dv = (c[1, 0] - c[0, 0]) * cells_u, (c[0, 1] - c[0, 0]) * cells_v
        return c[1, 1], du, dv

    @property
    def _cells(self) -> tuple[int, int]:
        """Number of cells along u and v."""
        return self.coefficients_mm.shape[0] - 3, self.coefficients_mm.shape[1] - 3


def _turn(surface: Surface, name: str) -> float:
    """Return in which sense the triangles turn in (u, v); refuse texture coordinates that fold."""
    a, b, c = (surface.uv[surface.triangles[:, k]] for k in range(3))
    turns = np.sign((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0])
    if (turns != turns[0]).any() or turns[0] == 0.0:
        others = min(int((turns * sense <= 0.0).sum()) for sense in (1.0, -1.0))
        raise ImpossibleFingerError(
            f"the texture coordinates of the {name} fold, because {others} of {len(turns)} "
            "triangles turn the other way; every triangle must turn the same way in (u, v)"
        )
    return float(turns[0])


def _cells(surface: Surface) -> tuple[int, int]:
    """Return how many cells along u and v a mesh can settle: at most one per vertex, about 2 mm each."""
    edges = surface.triangles[:, [1, 2, 0]]
    step_uv = np.abs(surface.uv[edges] - surface.uv[surface.triangles]).reshape(-1, 2)
    step_mm = np.linalg.norm(surface.vertices_mm[edges] - surface.vertices_mm[surface.triangles], axis=-1).ravel()
    share = step_uv / step_uv.max(axis=0)
    cells = []
    for axis in (0, 1):
        # edges in this direction, or nearly so
        along = share[:, axis] > 2.0 * share[:, 1 - axis]
        size_mm = np.median(step_mm[along] / step_uv[along, axis])
        spacing = np.median(step_uv[along, axis])
        cells.append(int(np.clip(min(round(size_mm / _CELL_MM), round(1.0 / spacing)), 1, _MOST_CELLS)))
    return cells[0], cells[1]


def regression_weights(
    places_mm: NDArray[np.float64],
    nodes_mm: NDArray[np.float64],
    depth_mm: NDArray[np.float64],
    node_depth_mm: NDArray[np.float64],
) -> NDArray[np.float32]:
    r"""Return the weights (place, node) by which values at nodes stand for those at places: local regression.

    .. math:: \min_c \sum_n k_n (y_n - c \cdot b(p_n - p))^2, \quad b = (1, x, z, x^2, x z, z^2, h), \quad w_n = c_0

    with the kernel :math:`k = 1 - r^2` in the ellipse of 7 by 12 mm around the place and the height h of the
    coat. Exact for what is quadratic in place and linear in height; to fourth order for what is smooth.

    Parameters
    ----------
    places_mm, nodes_mm
        (x, z) on the undeformed pad, (n, 2).
    depth_mm, node_depth_mm
        Height of the coat there, (n,).
    """
    weights = np.zeros((len(places_mm), len(nodes_mm)), dtype=np.float32)
    for start in range(0, len(places_mm), 256):
        here = slice(start, start + 256)
        away = (nodes_mm[None] - places_mm[here, None]) / _REACH_MM
        kernel = np.maximum(1.0 - (away**2).sum(axis=-1), 0.0)
        height = (node_depth_mm[None] - depth_mm[here, None]) / _REACH_MM[0]
        x, z = away[..., 0], away[..., 1]
        basis = np.stack([np.ones_like(x), x, z, x * x, x * z, z * z, height], axis=-1)
        weighted = basis * kernel[..., None]
        gram = np.swapaxes(weighted, 1, 2) @ basis
        # a flat coat does not tell what the height does
        gram[:, -1, -1] += _HEIGHT_PRIOR * gram[:, 0, 0]
        first = np.zeros((len(gram), basis.shape[-1], 1))
        first[:, 0] = 1.0
        weights[here] = (weighted @ np.linalg.solve(gram, first))[..., 0]
    return weights
