"""The fixed pattern of a symmetric matrix of nodal 3 x 3 blocks (upper triangle, CSR), and adding values to it."""

from collections.abc import Iterable

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from sim.mechanics.compiled import compiled

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


class UpperBlocks:
    """Upper triangle of a symmetric matrix of (3 n, 3 n) whose rows belong to n nodes.

    The pattern is fixed, so that a factorisation's symbolic phase can be used again; :meth:`add_sparse` widens it
    where a term needs more, and counts that in `version`.

    Parameters
    ----------
    count
        Number of nodes n.
    cells
        Arrays (m, k) of nodes that are coupled with each other.
    """

    def __init__(self, count: int, cells: Iterable[IntArray]) -> None:
        self.count = count
        self.version = 0
        self._keys = np.unique(np.concatenate([np.empty(0, np.int64), *(_pair_keys(c, count) for c in cells)]))
        self._lay_out()

    def _lay_out(self) -> None:
        row, neighbour = np.divmod(self._keys, self.count)
        neighbours = np.bincount(row, minlength=self.count)
        self._first = np.concatenate([[0], np.cumsum(neighbours)])
        lengths = (3 * neighbours[:, None] + 3 - np.arange(3)).ravel()
        self.indptr = np.concatenate([[0], np.cumsum(lengths)])
        self.indices = np.empty(self.indptr[-1], np.int32)
        _fill_indices(self._first, neighbour, self.indptr, self.indices)
        self.values = np.zeros(len(self.indices))

    def slots(self, cells: IntArray) -> NDArray[np.int32]:
        """Return where the 3 x 3 blocks a <= b of cells (m, k) start in their rows, shape (m, k (k + 1) / 2)."""
        a, b = np.triu_indices(cells.shape[1])
        low, high = np.minimum(cells[:, a], cells[:, b]), np.maximum(cells[:, a], cells[:, b])
        place = np.searchsorted(self._keys, (low * self.count + high).ravel()).reshape(low.shape)
        return np.asarray(np.where(low == high, 0, 3 + 3 * (place - self._first[low])), dtype=np.int32)

    def clear(self) -> None:
        """Set all values to zero."""
        self.values[:] = 0.0

    def add_cells(self, cells: IntArray, slots: NDArray[np.int32], blocks: FloatArray) -> None:
        """Add symmetric matrices (m, 3 k, 3 k) of cells (m, k) at slots of :meth:`slots`."""
        _add_cells(cells, slots, blocks, self.indptr, self.values)

    def add_sparse(self, matrix: sp.coo_array | sp.csr_array) -> None:
        """Add a symmetric sparse matrix (3 n, 3 n), of which the upper triangle is read."""
        entries = matrix.tocoo()
        upper = entries.row <= entries.col
        row, col, value = entries.row[upper].astype(np.int64), entries.col[upper].astype(np.int64), entries.data[upper]
        if _add_entries(row, col, value, self.indptr, self.indices, self.values, False):
            self._widen(row // 3, col // 3)
        _add_entries(row, col, value, self.indptr, self.indices, self.values, True)

    def _widen(self, row: IntArray, col: IntArray) -> None:
        before = self.upper()
        new = np.minimum(row, col) * self.count + np.maximum(row, col)
        self._keys = np.union1d(self._keys, new[row != col])
        self._lay_out()
        self.version += 1
        entries = before.tocoo()
        rows, cols = entries.row.astype(np.int64), entries.col.astype(np.int64)
        _add_entries(rows, cols, entries.data, self.indptr, self.indices, self.values, True)

    def upper(self) -> sp.csr_array:
        """Return the upper triangle; it shares its values with this object."""
        size = 3 * self.count
        matrix = sp.csr_array((self.values, self.indices, self.indptr.astype(np.int32)), shape=(size, size))
        matrix.has_sorted_indices = True
        return matrix

    def times(self, vector: FloatArray) -> FloatArray:
        """Return the whole symmetric matrix times a vector (3 n,)."""
        upper = self.upper()
        return np.asarray(upper @ vector + upper.T @ vector - upper.diagonal() * vector)

    def constrain(self, fixed: NDArray[np.bool_]) -> None:
        """Replace rows and columns of fixed unknowns (3 n,) by those of the unit matrix, in place."""
        _constrain(fixed, self.indptr, self.indices, self.values)


def _pair_keys(cells: IntArray, count: int) -> IntArray:
    """Return the distinct pairs low * count + high, low < high, of nodes of the same cell."""
    a, b = np.triu_indices(cells.shape[1], 1)
    low, high = np.minimum(cells[:, a], cells[:, b]), np.maximum(cells[:, a], cells[:, b])
    return np.unique((low * count + high)[low != high])


@compiled
def _fill_indices(first: IntArray, neighbour: IntArray, indptr: IntArray, indices: NDArray[np.int32]) -> None:
    for n in range(len(first) - 1):
        for i in range(3):
            p = indptr[3 * n + i]
            for k in range(i, 3):
                indices[p] = 3 * n + k
                p += 1
            for t in range(first[n], first[n + 1]):
                for k in range(3):
                    indices[p] = 3 * neighbour[t] + k
                    p += 1


@compiled
def _add_cells(
    cells: IntArray, slots: NDArray[np.int32], blocks: FloatArray, indptr: IntArray, values: FloatArray
) -> None:
    size = cells.shape[1]
    for e in range(len(cells)):
        slot = 0
        for a in range(size):
            for b in range(a, size):
                low, high, turned = cells[e, a], cells[e, b], cells[e, a] > cells[e, b]
                if turned:
                    low, high = high, low
                start = slots[e, slot]
                slot += 1
                for i in range(3):
                    p = indptr[3 * low + i] + start - i
                    for k in range(i if low == high else 0, 3):
                        values[p + k] += blocks[e, 3 * a + k, 3 * b + i] if turned else blocks[e, 3 * a + i, 3 * b + k]


@compiled
def add_forces(cells: IntArray, forces: FloatArray, out: FloatArray) -> None:
    """Add forces (m, 3 k) of cells (m, k) to those of the nodes (n, 3)."""
    for e in range(len(cells)):
        for a in range(cells.shape[1]):
            for i in range(3):
                out[cells[e, a], i] += forces[e, 3 * a + i]


@compiled
def _add_entries(
    row: IntArray,
    col: IntArray,
    value: FloatArray,
    indptr: IntArray,
    indices: NDArray[np.int32],
    values: FloatArray,
    write: bool,
) -> int:
    """Add entries that the pattern holds; return how many it does not hold."""
    missing = 0
    for e in range(len(row)):
        low, high = indptr[row[e]], indptr[row[e] + 1]
        end = high
        while low < high:
            middle = (low + high) // 2
            if indices[middle] < col[e]:
                low = middle + 1
            else:
                high = middle
        if low == end or indices[low] != col[e]:
            missing += 1
        elif write:
            values[low] += value[e]
    return missing


@compiled
def _constrain(fixed: NDArray[np.bool_], indptr: IntArray, indices: NDArray[np.int32], values: FloatArray) -> None:
    for r in range(len(fixed)):
        for p in range(indptr[r], indptr[r + 1]):
            if fixed[r] or fixed[indices[p]]:
                values[p] = 1.0 if indices[p] == r else 0.0
