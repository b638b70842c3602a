"""Finite-element meshes: blocks of hexahedra, sets of nodes, surfaces and ties (mm); structured grids to make them of.

Edges shrink towards sharp inner corners, where stress and the error of a mesh gather. A contact between coat and
indenter alone lets ribs fold into ribs and fins, and the pad's film into the skeleton. :class:`OwnSurfaces` therefore
tests edges against triangles: it finds surfaces that pass through each other, however thin they are.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from data_schemas import SimulateError
from sim.surface_meshes import boundary_quads, corner_jacobians_mm3, crossing_pair, split_quads

Element = Literal["mean_dilatation", "incompatible_modes"]


@dataclass(frozen=True, slots=True)
class Block:
    """Hexahedra of one part: (m, 8) node numbers in Abaqus' C3D8 order, material and element."""

    name: str
    hexahedra: NDArray[np.int64]
    material: str
    element: Element


@dataclass(frozen=True, slots=True)
class Tie:
    """Slave nodes (k,) that move with the master quadrilaterals (m, 4) they lie on."""

    slave_nodes: NDArray[np.int64]
    master_quads: NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class FingerMesh:
    """Nodes (n, 3) in mm, blocks, named sets of nodes, named surfaces (quads outward) and ties.

    Raises
    ------
    SimulateError
        When a block, set, surface or tie names a node that does not exist, or a hexahedron is folded at a corner.
    """

    nodes_mm: NDArray[np.float64]
    blocks: tuple[Block, ...]
    node_sets: Mapping[str, NDArray[np.int64]]
    surfaces: Mapping[str, NDArray[np.int64]]
    ties: tuple[Tie, ...]

    def __post_init__(self) -> None:
        count = len(self.nodes_mm)
        numbered = [(f"block {b.name}", b.hexahedra) for b in self.blocks]
        numbered += [(f"node set {name}", nodes) for name, nodes in self.node_sets.items()]
        numbered += [(f"surface {name}", quads) for name, quads in self.surfaces.items()]
        numbered += [("a tie", part) for tie in self.ties for part in (tie.slave_nodes, tie.master_quads)]
        for what, nodes in numbered:
            if not nodes.size or nodes.min() < 0 or nodes.max() >= count:
                raise SimulateError(f"{what} of the mesh must name only nodes from 0 to {count - 1}, and at least one")
        for block in self.blocks:
            check_unfolded(self.nodes_mm, block.hexahedra, block.name)

    @property
    def hexahedra(self) -> dict[str, NDArray[np.int64]]:
        """Hexahedra of each block by its name."""
        return {block.name: block.hexahedra for block in self.blocks}

    @property
    def tied_nodes(self) -> NDArray[np.int64]:
        """Nodes of both sides of the ties, (k,)."""
        tied = [nodes.ravel() for tie in self.ties for nodes in (tie.slave_nodes, tie.master_quads)]
        return np.unique(np.concatenate([np.empty(0, np.int64), *tied]))


def check_unfolded(nodes_mm: NDArray[np.float64], hexahedra: NDArray[np.int64], name: str) -> None:
    """Check that the Jacobian of every hexahedron is positive at all eight corners.

    Raises
    ------
    SimulateError
        When one is not; the message gives the block and the place.
    """
    jacobians = corner_jacobians_mm3(nodes_mm, hexahedra)
    worst = np.unravel_index(np.argmin(jacobians), jacobians.shape)
    if jacobians[worst] <= 0.0:
        x, y, z = nodes_mm[hexahedra[worst]]
        raise SimulateError(
            f"{int((jacobians.min(axis=1) <= 0.0).sum())} hexahedra of block {name} are inside out, the worst at "
            f"({x:.2f}, {y:.2f}, {z:.2f}) mm; give the nodes in C3D8 order, and parts that do not pass through each "
            "other"
        )


# a step may be this much longer than asked for before another element is put in
_LONGER = 1.001


@dataclass(frozen=True, slots=True)
class Grid:
    """Hexahedra of a grid.

    Attributes
    ----------
    nodes_mm
        Points that some cell uses, shape (n, 3).
    hexahedra
        Shape (m, 8), Abaqus' C3D8 order.
    cells
        Indices (i, j, k) of each hexahedron's cell, shape (m, 3).
    numbers
        Node number of each grid point, -1 where no cell uses it.
    """

    nodes_mm: NDArray[np.float64]
    hexahedra: NDArray[np.int64]
    cells: NDArray[np.int64]
    numbers: NDArray[np.int64]


def hexahedra_on_grid(points_mm: NDArray[np.float64], used: NDArray[np.bool_]) -> Grid:
    """Return the hexahedra of the used cells (ni, nj, nk) of right-handed points (ni + 1, nj + 1, nk + 1, 3)."""
    index = np.arange(points_mm[..., 0].size).reshape(points_mm.shape[:3])
    cells = np.argwhere(used)
    around = np.array([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1)])
    corners = cells[:, None, :] + around
    at_grid = index[corners[..., 0], corners[..., 1], corners[..., 2]]
    nodes = np.unique(at_grid)
    numbers = np.full(index.size, -1)
    numbers[nodes] = np.arange(len(nodes))
    return Grid(points_mm.reshape(-1, 3)[nodes], numbers[at_grid], cells, numbers.reshape(index.shape))


def divided(breakpoints_mm: list[float], step_mm: float, fewest: int = 1) -> NDArray[np.float64]:
    """Return positions from the first to the last breakpoint, each stretch divided evenly by at most the step."""
    parts = [np.array(breakpoints_mm[:1])]
    for low, high in pairwise(breakpoints_mm):
        count = max(fewest, int(np.ceil((high - low) / (step_mm * _LONGER))))
        parts.append(np.linspace(low, high, count + 1)[1:])
    return np.concatenate(parts)


def quads_of_layer(numbers: NDArray[np.int64], used: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Return the quads of the used cells of a sheet of node numbers (na, nb); normals along a cross b."""
    a, b = np.nonzero(used)
    return np.stack([numbers[a, b], numbers[a + 1, b], numbers[a + 1, b + 1], numbers[a, b + 1]], axis=1)


@dataclass(frozen=True, slots=True)
class CornerGrading:
    """How elements shrink towards the inner corners between ribs and fins.

    At a corner of 270 deg stress is infinite, and the error of even elements falls only as the 1.09th power of their
    edge: it is the first edge that counts, and edges may grow fast from there (Szabo and Babuska, Finite Element
    Analysis, 1991, chapter 10).

    Attributes
    ----------
    thickness_share
        First edge over the thickness of the thinnest of ribs and fins.
    growth_ratio
        An edge is at most this many times longer than its neighbour nearer to the corner, up to the next line that
        the grid has to meet.
    halvings
        How often edges in the side view are halved afterwards, but those of base plate and backing; for studies of
        convergence.
    """

    thickness_share: float
    growth_ratio: float
    halvings: int = 0


def graded(
    length_mm: float, first_mm: float, growth_ratio: float, longest_mm: float, corners: tuple[bool, bool] = (True, True)
) -> NDArray[np.float64]:
    """Return positions from 0 to a length whose steps grow from the ends that are corners.

    Parameters
    ----------
    length_mm
        Last position.
    first_mm
        Step at a corner.
    growth_ratio
        Largest ratio of a step to its neighbour nearer to the corner.
    longest_mm
        Largest step.
    corners
        Whether the first and the last position are corners.

    Returns
    -------
    ndarray
        Evenly divided where there is no room for a step at the corners beside one as long.
    """
    ends, steps, reached, step = sum(corners), [], 0.0, first_mm
    while ends and step < longest_mm and length_mm - ends * (reached + step) >= step:
        steps.append(step)
        reached, step = reached + step, step * growth_ratio
    from_end = np.cumsum([0.0, *steps])
    low, high = (from_end if is_corner else from_end[:1] for is_corner in corners)
    middle = divided([low[-1], length_mm - high[-1]], min(step, longest_mm) if steps else longest_mm)
    return np.concatenate([low[:-1], middle, length_mm - high[-2::-1]])


def fitted_between(pattern_mm: NDArray[np.float64], depth_mm: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return positions over depths (d,) like those of a symmetric pattern (n,), as shares, shape (n, d).

    Over a lesser depth steps at both ends keep their lengths, the others shrink, and at last all are even; over a
    greater one all grow.
    """
    from_end = np.arange(len(pattern_mm))[:, None] * (depth_mm / (len(pattern_mm) - 1))
    stretched = pattern_mm[:, None] * np.maximum(1.0, depth_mm / pattern_mm[-1])
    from_end = np.minimum(stretched, from_end) / depth_mm
    half = (len(pattern_mm) + 1) // 2
    return np.concatenate([from_end[:half], 1.0 - from_end[: len(pattern_mm) - half][::-1]])


def outer_triangles(mesh: FingerMesh) -> NDArray[np.int64]:
    """Return the triangles (k, 3) of everything that can be touched: the boundary of all blocks that share nodes."""
    return split_quads(boundary_quads(np.concatenate(list(mesh.hexahedra.values()))).quads, mesh.nodes_mm)


QUAD_CORNERS = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])


def quad_shapes(local: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the bilinear shape functions at points (..., 2), shape (..., 4), and their gradients (..., 4, 2)."""
    x, y = 1.0 + QUAD_CORNERS[:, 0] * local[..., None, 0], 1.0 + QUAD_CORNERS[:, 1] * local[..., None, 1]
    return x * y / 4.0, np.stack([QUAD_CORNERS[:, 0] * y, QUAD_CORNERS[:, 1] * x], -1) / 4.0


@dataclass(frozen=True, slots=True)
class FacePoints:
    """Where on k faces a contact acts.

    Attributes
    ----------
    quads
        Nodes of the faces, (k, 4), outward.
    places
        In the faces' own coordinates from -1 to 1, (k, q, 2).
    shares
        Of a face's area that the points stand for, (k, q); they sum to 1.
    """

    quads: NDArray[np.int64]
    places: NDArray[np.float64]
    shares: NDArray[np.float64]

    def of(self, faces: NDArray[np.int64]) -> "FacePoints":
        """Return the points of some of the faces."""
        return FacePoints(self.quads[faces], self.places[faces], self.shares[faces])


# points and weights of Radau's rules from the side at -1, and of those with both ends
_RADAU = {
    2: (np.array([-1.0, 1.0 / 3.0]), np.array([0.5, 1.5])),
    3: (
        np.array([-1.0, (1.0 - 6.0**0.5) / 5.0, (1.0 + 6.0**0.5) / 5.0]),
        np.array([4.0, 16.0 + 6.0**0.5, 16.0 - 6.0**0.5]) / 18.0,
    ),
}
_BOTH_ENDS = {
    2: (np.array([-1.0, 1.0]), np.array([1.0, 1.0])),
    3: (np.array([-1.0, 0.0, 1.0]), np.array([1.0, 4.0, 1.0]) / 3.0),
}


def _across_face(count: int, low: bool, high: bool) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return points and weights across a face, by whether its low and its high side lie at the border."""
    if low and high:
        return _BOTH_ENDS[count]
    places, weights = _RADAU[count] if low or high else np.polynomial.legendre.leggauss(count)
    return (-places[::-1], weights[::-1]) if high else (places, weights)


def face_points(quads: NDArray[np.int64], per_side: int = 2, to_border: bool = True) -> FacePoints:
    """Return the points of faces (k, 4): Gauss points, but on the border of the faces Radau points, which lie on it.

    Gauss points lie 0.21 of a face inside it. Where a surface ends and an indenter comes in at a slope, its border
    sinks in by this way times the slope before the first of them touches. All of the rules give an even pressure the
    nodal forces of its exact integral.

    Parameters
    ----------
    quads
        All faces of the surface: a side that only one of them has lies at its border.
    per_side
        Points along a side, 2 or 3.
    to_border
        False: Gauss points on all faces.
    """
    sides = np.sort(np.stack([quads, np.roll(quads, -1, axis=1)], axis=2), axis=2)
    _, side, times = np.unique(sides.reshape(-1, 2), axis=0, return_inverse=True, return_counts=True)
    at_border = to_border & (times[side.reshape(-1)] == 1).reshape(-1, 4)  # of the sides at -y, +x, +y and -x
    places, shares = np.empty((len(quads), per_side**2, 2)), np.empty((len(quads), per_side**2))
    for ends in np.unique(at_border, axis=0):
        (x, share_x), (y, share_y) = _across_face(per_side, ends[3], ends[1]), _across_face(per_side, ends[0], ends[2])
        rows = (at_border == ends).all(axis=1)
        places[rows] = np.stack(np.meshgrid(x, y), -1).reshape(-1, 2)
        shares[rows] = np.outer(share_y, share_x).ravel() / 4.0
    return FacePoints(quads, places, shares)


class OwnSurfaces:
    """The outer surfaces of a finger, but for faces at a tie, which lie in each other.

    Parameters
    ----------
    mesh
        Finger at rest.
    """

    def __init__(self, mesh: FingerMesh) -> None:
        self._mesh = mesh
        self._seen: tuple[NDArray[np.float64], str] | None = None
        triangles = outer_triangles(mesh)
        at_tie = np.isin(triangles, mesh.tied_nodes).any(axis=1)
        self._triangles = np.ascontiguousarray(triangles[~at_tie])

    def crossing(self, displacement_mm: NDArray[np.float64]) -> str:
        """Return in words where surfaces pass through each other at a displacement (n, 3) of the nodes, or nothing.

        The answer to the last question is kept.
        """
        if self._seen is None or not np.array_equal(self._seen[0], displacement_mm):
            self._seen = displacement_mm.copy(), self._crossing(displacement_mm)
        return self._seen[1]

    def _crossing(self, displacement_mm: NDArray[np.float64]) -> str:
        rest = self._mesh.nodes_mm
        found = crossing_pair(np.ascontiguousarray(rest + displacement_mm), self._triangles)
        if found is None:
            return ""
        edge, triangle = found
        x, y, z = rest[triangle].mean(axis=0)
        return (
            f"the finger passes through itself (its {self._part(edge[0])} through its {self._part(triangle[0])}) near "
            f"({x:.1f}, {y:.1f}, {z:.1f}) mm of the undeformed finger"
        )

    def is_crossed_by(self, vertices_mm: NDArray[np.float64], triangles: NDArray[np.int64]) -> bool:
        """Return whether a body's surface, of vertices (m, 3), passes through these surfaces at rest."""
        rest = self._mesh.nodes_mm
        whole = np.concatenate([self._triangles, triangles + len(rest)])
        return crossing_pair(np.concatenate([rest, vertices_mm]), np.ascontiguousarray(whole)) is not None

    def _part(self, node: int) -> str:
        """Return the name of a part that a node is of."""
        return next(b.name.replace("_", " ") for b in self._mesh.blocks if (b.hexahedra == node).any())
