"""Start a press from one on a coarser mesh: displacements between meshes of the same finger, and a predictor."""

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import cKDTree

from data_schemas.errors import SimulateError
from sim.mechanics.assembly import State
from sim.mechanics.increments import Extrapolation
from sim.mechanics.mesh import FingerMesh

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

_CORNERS = np.array(
    [[-1, -1, -1], [1, -1, -1], [1, 1, -1], [-1, 1, -1], [-1, -1, 1], [1, -1, 1], [1, 1, 1], [-1, 1, 1]], dtype=float
)
_NEAREST_CENTRES = 64  # hexahedra whose boxes are looked at
_CANDIDATES = (2, 16)  # nearest of these boxes that a node is looked for in, more for who lies in none
_INVERSION_STEPS = 5  # Newton's method in a convex hexahedron converges in three or four
_TOGETHER = 20_000  # pairs of node and hexahedron inverted at a time: 60 MB
_BOXES_TOGETHER = 500_000  # pairs of node and box looked at at a time: 100 MB
# curved walls have other chords on another mesh: a node may lie this share of a hexahedron's half-size outside
_OUTSIDE = 0.5
_SLIGHTLY = 1e-6  # beyond this a better hexahedron is looked for among more candidates


class Interpolation:
    """Takes displacements of one mesh of a finger to the nodes of another one, block by block at rest coordinates.

    Trilinear in the hexahedron that a node lies in; just beyond the surface the hexahedron's field is continued. Where
    both meshes have the same hexahedra (a dimension has changed a little), node to node.

    Parameters
    ----------
    source, target
        Meshes with blocks of the same names.

    Raises
    ------
    SimulateError
        When the meshes are not of the same finger: a block is missing or lies elsewhere.
    """

    def __init__(self, source: FingerMesh, target: FingerMesh) -> None:
        missing = set(target.hexahedra) ^ set(source.hexahedra)
        if missing:
            raise SimulateError(
                f"a press can start only from a mesh of the same finger; {', '.join(sorted(missing))} is a part of "
                "one of the two meshes only"
            )
        count = len(target.nodes_mm)
        self._cells, self._weights = np.zeros((count, 8), np.int64), np.zeros((count, 8))
        if all(np.array_equal(cells, source.hexahedra[name]) for name, cells in target.hexahedra.items()):
            self._cells[:, 0], self._weights[:, 0] = np.arange(count), 1.0
            return
        for name, hexahedra in target.hexahedra.items():
            nodes = np.unique(hexahedra)
            cells, weights, outside = _located(source.nodes_mm, source.hexahedra[name], target.nodes_mm[nodes])
            worst = int(np.argmax(outside))
            if outside[worst] > _OUTSIDE:
                x, y, z = target.nodes_mm[nodes[worst]]
                raise SimulateError(
                    f"a press can start only from a mesh of the same finger; the point ({x:.2f}, {y:.2f}, {z:.2f}) mm "
                    f"of its part {name} lies outside the other mesh"
                )
            self._cells[nodes], self._weights[nodes] = cells, weights

    def __call__(self, displacement_mm: FloatArray) -> FloatArray:
        """Return the displacement (n, 3) at the target's nodes of one (m, 3) of the source's nodes."""
        return np.asarray(np.einsum("na,nai->ni", self._weights, displacement_mm[self._cells]))


class CoarserPath:
    """A predictor for :func:`sim.mechanics.increments.load_increments`: the coarser press's increment, interpolated.

    Parameters
    ----------
    source, target
        The coarser mesh and the one that is to be solved.
    fractions
        Rising shares of the load (k,) of the coarser press's equilibria.
    displacements_mm
        Their displacements (k, m, 3).
    """

    def __init__(
        self, source: FingerMesh, target: FingerMesh, fractions: ArrayLike, displacements_mm: FloatArray
    ) -> None:
        self._interpolation = Interpolation(source, target)
        self._beyond = Extrapolation()
        self._fractions = np.concatenate([[0.0], np.asarray(fractions, dtype=np.float64)])
        self._path = np.concatenate([np.zeros((1, *displacements_mm.shape[1:])), displacements_mm])

    def _at(self, fraction: float) -> FloatArray:
        """Return the coarser displacement at a share of the load, on straight lines between its equilibria."""
        k = int(np.clip(np.searchsorted(self._fractions, fraction), 1, len(self._fractions) - 1))
        low, high = self._fractions[k - 1 : k + 1]
        share = (fraction - low) / (high - low)
        return np.asarray((1.0 - share) * self._path[k - 1] + share * self._path[k])

    def __call__(self, state: State, at: float, aim: float) -> State | None:
        """Return the equilibrium at the share `at`, displaced by what the coarser one moves on to the share `aim`.

        Beyond the coarser press's last equilibrium, its own last two are extrapolated.
        """
        further = self._beyond(state, at, aim)
        if aim > self._fractions[-1]:
            return further
        return State(state.u_mm + self._interpolation(self._at(aim) - self._at(at)), state.modes)


def _located(nodes: FloatArray, hexahedra: IntArray, points: FloatArray) -> tuple[IntArray, FloatArray, FloatArray]:
    """Return for each point the nodes (n, 8) and weights of its hexahedron, and how far outside it lies."""
    near = _nearest_boxes(nodes[hexahedra], points)
    owner, local = np.zeros(len(points), np.int64), np.full((len(points), 3), np.inf)
    left = np.arange(len(points))
    for candidates in _CANDIDATES:
        tried = near[left, :candidates]
        found = np.concatenate(
            [
                _local_coordinates(nodes[hexahedra[tried[rows]]], points[left[rows]])
                for rows in np.array_split(np.arange(len(left)), max(1, tried.size // _TOGETHER))
            ]
        )
        excess = np.where(np.isfinite(found).all(axis=2), np.abs(found).max(axis=2), np.inf) - 1.0
        best = excess.argmin(axis=1)
        row = np.arange(len(left))
        owner[left], local[left] = tried[row, best], found[row, best]
        left = left[excess[row, best] > _SLIGHTLY]
        if not len(left):
            break
    shapes, _ = _shapes(local)
    return hexahedra[owner], shapes, np.abs(local).max(axis=1) - 1.0


def _nearest_boxes(corners: FloatArray, points: FloatArray) -> IntArray:
    """Return for each point the hexahedra whose boxes are nearest, those with nearer centres first among equals.

    Centres alone would not do: of long and thin hexahedra the nearest centre may be that of another layer.
    """
    _, near = cKDTree(corners.mean(axis=1)).query(points, k=min(_NEAREST_CENTRES, len(corners)))
    near = near.reshape(len(points), -1)
    low, high = corners.min(axis=1), corners.max(axis=1)
    found = []
    for rows in np.array_split(np.arange(len(points)), max(1, near.size // _BOXES_TOGETHER)):
        place, cells = points[rows, None], near[rows]
        off = np.maximum(0.0, np.maximum(low[cells] - place, place - high[cells])).max(axis=2)
        order = np.argsort(off, axis=1, kind="stable")[:, : _CANDIDATES[-1]]
        found.append(np.take_along_axis(cells, order, axis=1))
    return np.concatenate(found)


def _local_coordinates(corners: FloatArray, points: FloatArray) -> FloatArray:
    """Return the local coordinates (n, c, 3) of points (n, 3) in hexahedra with corners (n, c, 8, 3)."""
    local = np.zeros((*corners.shape[:2], 3))
    for _ in range(_INVERSION_STEPS):
        shapes, slopes = _shapes(local)
        off = points[:, None] - np.einsum("nca,ncai->nci", shapes, corners)
        jacobian = np.einsum("ncai,ncaj->ncij", corners, slopes)
        # a far candidate may fold: its place is of no use, but must not stop the others
        folded = np.abs(np.linalg.det(jacobian)) < 1e-12
        jacobian[folded] = np.eye(3)
        step = np.linalg.solve(jacobian, off[..., None])[..., 0]
        step[folded] = np.inf
        local = np.clip(local + step, -1e3, 1e3)
    return local


def _shapes(local: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the trilinear shape functions at points (..., 3), shape (..., 8), and their gradients (..., 8, 3)."""
    sides = 1.0 + _CORNERS * local[..., None, :]
    x, y, z = sides[..., 0], sides[..., 1], sides[..., 2]
    slopes = np.stack([_CORNERS[:, 0] * y * z, _CORNERS[:, 1] * x * z, _CORNERS[:, 2] * x * y], axis=-1)
    return x * y * z / 8.0, slopes / 8.0
