"""Rules that all path tracers of a finger keep: when paths end, how evenly they start, which tables they may reach.

Tables are read and added to by computed places, and no lane reaches outside, whatever it holds. A lane that met nothing
still computes places, from numbers that were never written. A comparison is false for NaN, where the renderer's clip
lets NaN pass and a cast to an integer of NaN, infinity or 1e30 is undefined: 4294967295 with AVX-512, 2147483648
without. Every gather, scatter and cast of :mod:`sim.optics` therefore comes through this module.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

MAX_DEPTH: Final = 30
"""Longest path in surfaces; at 10 the painted bands lose 30 % of their light."""

ROULETTE_DEPTH: Final = 6
"""Paths of more surfaces end by chance."""

LARGEST_SURVIVAL: Final = 0.95
"""Largest chance of a path to go on once chance may end it."""

LIFT_MM: Final = 2e-3
"""Rays leave a surface by this much, and stop before the inner face by as much more as its mesh lies off its map."""

NEWTON_STEPS: Final = 3
"""In single precision: from the undeformed face they meet Snell's law to 1e-6 even at a bending radius of 50 mm."""

SMALLEST_COS_AIR: Final = 0.02
"""Nearer to grazing, rays that leave the inner face keep no further away from it."""


@dataclass(frozen=True, slots=True)
class LedSearch:
    """How paths find the LED's light.

    Attributes
    ----------
    counted
        False leaves the panels dark.
    from_wall
        Rays start on a wall in the gel: the panel's direct light through the inner face is left out.
    refractive
        False leaves the panel to chance: the same mean, much more noise; it serves as a check.
    """

    counted: bool = True
    from_wall: bool = False
    refractive: bool = True


def even_points_of_groups(groups: int, count: int, dimensions: int, rng: np.random.Generator) -> NDArray[np.float64]:
    """Return :func:`even_points` for each of some groups, one group after the other, (groups * count, dimensions)."""
    points = np.arange(count)[:, None] * _steps(dimensions)
    return np.asarray((rng.random((groups, 1, dimensions)) + points) % 1.0).reshape(-1, dimensions)


def even_points(count: int, dimensions: int, rng: np.random.Generator) -> NDArray[np.float64]:
    r"""Return points in the unit cube, (count, dimensions): :math:`x_i = (s + i a) \bmod 1` with a random shift s.

    a = (1/g, 1/g^2, ...) with the root g > 1 of g^(dimensions + 1) = g + 1, which spreads all first points evenly.
    Each point is uniform, so means are unbiased; for what changes slowly, or at edges only, the error falls nearly
    as 1 / count.

    Parameters
    ----------
    count, dimensions
        Number of points and of coordinates.
    rng
        Where the shift comes from.

    References
    ----------
    M. Roberts, The unreasonable effectiveness of quasirandom sequences, 2018.
    """
    return even_points_of_groups(1, count, dimensions, rng)


def _steps(dimensions: int) -> NDArray[np.float64]:
    """Return by how much points of :func:`even_points` differ from the ones before them."""
    root = 2.0
    for _ in range(40):
        root = (1.0 + root) ** (1.0 / (dimensions + 1.0))
    return np.asarray(root ** -np.arange(1.0, dimensions + 1.0))


def cell_at(place: Any, cells: int) -> Any:
    """Return the number, 0 to cells - 1, of the cell that holds a place.

    Cell k holds k <= place < k + 1. Valid for every float: what lies below, and NaN, is in the first cell and what
    lies above in the last one.

    Parameters
    ----------
    place
        The renderer's floats, in cells.
    cells
        Number of cells, 1 to 2^24 (beyond it single precision has no whole numbers).

    Returns
    -------
    array
        The renderer's unsigned integers.
    """
    import drjit as dr

    above = dr.select(place > 0.0, place, 0.0)
    return dr.uint32_array_t(type(place))(dr.minimum(above, cells - 1.0))


_ALIGNED_TO: Final = 64


def aligned(values: NDArray[np.floating]) -> NDArray[np.float32]:
    """Return a copy in single precision whose memory begins at a multiple of 64 bytes.

    The renderer uses an array where it lies, and compiles another kernel when it lies elsewhere: numpy promises
    16 bytes, so that each of its arrays could double the kernels that a disk cache must hold.

    Parameters
    ----------
    values
        Of any shape.
    """
    memory = np.empty(4 * values.size + _ALIGNED_TO, dtype=np.uint8)
    first = -memory.ctypes.data % _ALIGNED_TO
    copy = memory[first : first + 4 * values.size].view(np.float32).reshape(values.shape)
    copy[...] = values
    return copy


class LookupTable:
    """Rows of 1, 2 or 4 numbers in single precision; a row number past the end reads the last row.

    Parameters
    ----------
    rows
        Shape (rows, 1), (rows, 2) or (rows, 4).
    renderer
        From :func:`sim.optics.open_renderer`, a compiled variant.
    """

    def __init__(self, rows: NDArray[np.floating], renderer: Any) -> None:
        import drjit as dr

        self._kind = {1: renderer.Float, 2: renderer.Vector2f, 4: renderer.Vector4f}[rows.shape[1]]
        self._values = renderer.Float(aligned(rows).ravel())
        # numbers that vary between scenes must not become constants of the compiled kernel
        dr.make_opaque(self._values)
        self._last = dr.opaque(renderer.UInt32, len(rows) - 1)

    def add(self, change: Any) -> None:
        """Add the renderer's floats (rows * numbers,) to the table; derivatives by them pass through."""
        self._values = self._values + change

    def row(self, number: Any, active: Any = True) -> Any:
        """Return the rows of these numbers (unsigned integers), zero where not active."""
        import drjit as dr

        return dr.gather(self._kind, self._values, dr.minimum(number, self._last), active)


class Tally:
    """Sums that lanes add to by number, in single precision; a number past the end adds nothing.

    Parameters
    ----------
    count
        Number of sums, at most 2^32 - 1.
    renderer
        From :func:`sim.optics.open_renderer`, a compiled variant.
    """

    def __init__(self, count: int, renderer: Any) -> None:
        import drjit as dr

        self.sums = dr.zeros(renderer.Float, count)
        self._count = dr.opaque(renderer.UInt32, count)

    def add(self, value: Any, number: Any, active: Any = True) -> None:
        """Add values to the sums of these numbers (unsigned integers) where active."""
        import drjit as dr

        dr.scatter_add(self.sums, value, number, active & (number < self._count))


class EventLog:
    """Rows of whole numbers and floats that lanes append, in any order; rows past its length are counted, not kept.

    Parameters
    ----------
    length
        Most rows that are kept.
    integers, floats
        Columns of unsigned integers and of floats in single precision.
    renderer
        From :func:`sim.optics.open_renderer`, a compiled variant.
    """

    def __init__(self, length: int, integers: int, floats: int, renderer: Any) -> None:
        import drjit as dr

        self.columns = [dr.zeros(renderer.UInt32, length) for _ in range(integers)]
        self.columns += [dr.zeros(renderer.Float, length) for _ in range(floats)]
        self.count = dr.zeros(renderer.UInt32, 1)
        self._first, self._length = dr.opaque(renderer.UInt32, 0), dr.opaque(renderer.UInt32, length)

    def add(self, values: Sequence[Any], active: Any) -> None:
        """Append one value per column where active."""
        import drjit as dr

        row = dr.scatter_inc(self.count, self._first, active)
        for column, value in zip(self.columns, values, strict=True):
            dr.scatter(column, value, row, active & (row < self._length))

    def rows(self) -> list[NDArray[Any]]:
        """Return the columns as far as they were written; all rows are there if ``count`` is not above the length."""
        return [column.numpy()[: int(self.count[0])] for column in self.columns]
