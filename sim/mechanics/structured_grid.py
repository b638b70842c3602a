"""Hexahedra on a structured grid of points, of which some cells are left out."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

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
