"""Where a face of the gel is: a smooth map from its reference coordinates (u, v) to mm, with two derivatives.

A tensor product of uniform cubic B-splines, fitted to the vertices of a mesh; so the face has a tangent plane and
a curvature everywhere, which the facets of the mesh have not. Structured grids and unstructured meshes alike.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse.linalg import spsolve

from data_schemas.errors import SimulateError
from sim.optics.cubic_splines import (
    Vector,
    cell_and_fraction,
    design_matrix,
    spline_weights,
    tensor_sum,
    third_differences,
)
from sim.optics.lookup_tables import LookupTable, cell_at
from sim.surface_meshes.surface import Surface

# a face bends over the thickness of the gel (about 6 mm), which cells of this size follow to parts in a million
_CELL_MM = 2.0
_MOST_CELLS = 64
# weight of the smoothness against one vertex: it settles what no vertex determines and moves nothing else
_SMOOTHNESS = 1e-7
# a map this near to a plane is one: below the rounding of single precision at 100 mm
_PLANE_MM = 1e-5
# a mesh that leaves its smooth map by more than this is crumpled, or its texture coordinates are wrong
_LARGEST_GAP_MM = 0.3


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
            raise SimulateError(
                f"the {name} is no smooth face: its mesh leaves the smooth map by {gap:.2g} mm "
                f"({_LARGEST_GAP_MM} mm allowed); check its texture coordinates, or refine the mesh"
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
        raise SimulateError(
            f"the texture coordinates of the {name} fold: {int((turns <= 0.0).sum())} of {len(turns)} triangles turn "
            "one way and the others not; every triangle must turn the same way in (u, v)"
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
