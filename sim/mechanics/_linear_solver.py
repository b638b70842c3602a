"""The symmetric systems of equilibrium: their matrix, and direct solvers.

The pattern of the matrix is fixed: nodal 3 x 3 blocks of its upper triangle (CSR), to which compiled loops add values.
The solver is MKL PARDISO, or SuperLU where that is not installed.
"""

import ctypes
import importlib
import math
import os
import sys
from collections.abc import Callable, Iterable
from pathlib import Path
from types import ModuleType
from typing import Literal, Protocol

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from data_schemas import MissingExtraError, SimulateError
from sim.mechanics._element_kernels import compiled

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
SolverName = Literal["auto", "pardiso", "superlu"]

_SYMMETRIC_POSITIVE, _SYMMETRIC_INDEFINITE = 2, -2
# a tangent that has negative curvature once has it in the iterations after too
_INDEFINITE_AFTER_FAILURE = 6
# a pivot leaves the diagonal only below this share of its column: the usual 1 spoils the order, fifty times as slow
_DIAGONAL_PIVOT = 1e-3
_NEGATIVE_PIVOTS = 23  # PARDISO's count of negative eigenvalues
# of the least eigenvalue, and restarts of 20 vectors
_CURVATURE_REL, _CURVATURE_ROUNDS = 1e-2, 10
# of Lanczos; and of the stiffness of before what every shape must have kept: a node that lost contact kept a tenth
_NEAR_STEPS, _NEAR_RATIO = 4, 0.05
_BLOCKS = -80  # PARDISO's own value: rows whose patterns agree by 80 % become blocks

_FLOATS, _INTS = ctypes.POINTER(ctypes.c_double), ctypes.POINTER(ctypes.c_int32)


_RATE_AFTER = 4  # conjugate gradients after which their rate tells whether they go on


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
        """Return the whole symmetric matrix times a vector (3 n,), in double precision whatever the vector's."""
        taken = np.ascontiguousarray(vector, np.float64)
        out = np.zeros_like(taken)
        _add_product(self.indptr, self.indices, self.values, taken, out)
        return out

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
def _add_product(
    indptr: IntArray, indices: NDArray[np.int32], values: FloatArray, vector: FloatArray, out: FloatArray
) -> None:
    """Add a symmetric matrix, given by rows of its upper triangle that begin with the diagonal, times a vector."""
    for r in range(len(vector)):
        begin, own = indptr[r], vector[r]
        total = values[begin] * own
        for p in range(begin + 1, indptr[r + 1]):
            total += values[p] * vector[indices[p]]
            out[indices[p]] += values[p] * own
        out[r] += total


@compiled
def _constrain(fixed: NDArray[np.bool_], indptr: IntArray, indices: NDArray[np.int32], values: FloatArray) -> None:
    for r in range(len(fixed)):
        for p in range(indptr[r], indptr[r + 1]):
            if fixed[r] or fixed[indices[p]]:
                values[p] = 1.0 if indices[p] == r else 0.0


class SymmetricSolver(Protocol):
    """Factorises symmetric matrices given by their upper triangle (CSR, sorted) and solves with them."""

    @property
    def definite(self) -> bool:
        """Whether the last factorised matrix is positive definite: an equilibrium with it is stable."""
        ...

    def factorise(self, upper: sp.csr_array, pattern: int) -> None:
        """Factorise; with the same number of the pattern, the matrix differs from the last one in its values only."""
        ...

    def factorise_definite(self, upper: sp.csr_array, pattern: int) -> bool:
        """Factorise as :meth:`factorise` does, and tell whether the matrix is positive definite: else nothing holds."""
        ...

    def solve(self, right_side: FloatArray) -> FloatArray:
        """Return x (n,) of the last factorised matrix for the right side (n,)."""
        ...


def linear_solver(name: SolverName = "auto", threads: int = 1) -> SymmetricSolver:
    """Open a solver: PARDISO where pypardiso is installed, else SuperLU.

    Raises
    ------
    MissingExtraError
        When PARDISO is asked for by name and pypardiso is missing.
    """
    if name == "superlu":
        return SuperLU()
    try:
        return Pardiso(threads)
    except ImportError as missing:
        if name == "auto":
            return SuperLU()
        raise MissingExtraError(
            f"the solver pardiso needs pypardiso ({missing}), which is installed with finray-calib only on x86-64 "
            "Linux and Windows; choose superlu elsewhere"
        ) from missing


def refined(
    times: Callable[[FloatArray], FloatArray],
    solver: SymmetricSolver,
    right_side: FloatArray,
    residual_rel: float,
    iterations: int,
) -> FloatArray | None:
    """Solve with a matrix near the last factorised one, by conjugate gradients that the old factors precondition.

    Parameters
    ----------
    times
        The matrix times a vector (n,).
    solver
        Holds the factors.
    right_side
        Shape (n,).
    residual_rel
        Norm of the residual over that of the right side.
    iterations
        At most.

    Returns
    -------
    FloatArray or None
        x (n,), or nothing where the matrices are too far apart or the new one is not positive definite.
    """
    x, residual = np.zeros_like(right_side), right_side.copy()
    whole = _product(right_side, right_side)
    enough = residual_rel**2 * whole
    direction = preconditioned = solver.solve(residual)
    slope = _product(residual, preconditioned)
    for done in range(1, iterations + 1):
        image = times(direction)
        curve = _product(direction, image)
        if not (curve > 0.0 and slope > 0.0):
            return None
        x += slope / curve * direction
        residual -= slope / curve * image
        left = _product(residual, residual)
        if left <= enough:
            return x
        # at the rate so far it is not near enough at the last iteration either
        if done >= _RATE_AFTER and (left / whole) ** (iterations / done) * whole > enough:
            return None
        preconditioned = solver.solve(residual)
        before, slope = slope, _product(residual, preconditioned)
        direction = preconditioned + slope / before * direction
    return None


def stays_definite(times: Callable[[FloatArray], FloatArray], solver: SymmetricSolver, size: int) -> bool:
    """Tell whether a matrix near the last factorised one, which is positive definite, is so too.

    Valid only where few shapes have changed by much: the matrix must belong to a state close by.
    A few of Lanczos' steps on K x = c P x with the factorised P, from a random vector in which soft shapes prevail. All
    c are near 1 but those of shapes that have become soft, which such steps find first.

    Parameters
    ----------
    times
        The matrix K times a vector (n,).
    solver
        Holds the factors of P, which is positive definite.
    size
        n.
    """
    image, before = np.random.default_rng(0).standard_normal(size), np.zeros(size)
    beside = np.zeros((_NEAR_STEPS, 2))
    for step in range(_NEAR_STEPS):
        vector = solver.solve(image)
        norm = math.sqrt(max(_product(vector, image), 1e-300))
        vector, image = vector / norm, image / norm
        further = times(vector)
        beside[step] = _product(vector, further), norm
        image, before = further - beside[step, 0] * image - norm * (step > 0) * before, image
    between = beside[1:, 1]
    ratios = np.linalg.eigvalsh(np.diag(beside[:, 0]) + np.diag(between, 1) + np.diag(between, -1))
    return bool(ratios.min() >= _NEAR_RATIO)


def least_curvature(
    exact: sp.csr_array, definite: sp.csr_array, solver: SymmetricSolver
) -> tuple[float, FloatArray | None]:
    """Return the least eigenvalue c of K x = c P x and its vector x (n,), or none where it is not found.

    Lanczos' method in the product of P, which makes the lowest eigenvalues stand apart: P is K without negative
    curvature, so that most are 1, and as many are negative as those of K (J. J. Sylvester, 1852).

    Parameters
    ----------
    exact, definite
        Upper triangles of K and P, (n, n) in N/mm.
    solver
        Holds the factors of P.
    """
    k, p = (sp.linalg.aslinearoperator(upper + sp.triu(upper, 1).T) for upper in (exact, definite))
    inverse = sp.linalg.LinearOperator(exact.shape, matvec=solver.solve, dtype=np.float64)
    start = solver.solve(np.random.default_rng(0).standard_normal(exact.shape[0]))
    try:
        values, vectors = sp.linalg.eigsh(
            k, 1, p, which="SA", v0=start, tol=_CURVATURE_REL, Minv=inverse, maxiter=_CURVATURE_ROUNDS
        )
    except sp.linalg.ArpackNoConvergence:
        return math.nan, None
    return float(values[0]), np.asarray(vectors[:, 0], dtype=np.float64)


def _product(a: FloatArray, b: FloatArray) -> float:
    """Return a . b without BLAS, which would wake a thread of its own for long vectors and let it spin."""
    return float(np.einsum("i,i->", a, b))


class SuperLU:
    """SuperLU of SciPy, an unsymmetric factorisation: anywhere, for small meshes."""

    def __init__(self) -> None:
        self._solve: sp.linalg.SuperLU | None = None

    @property
    def definite(self) -> bool:
        """Whether all pivots of the last matrix are positive and on the diagonal: exchanged rows hide a sign."""
        found = self._solve
        return found is not None and bool((found.perm_r == found.perm_c).all() and (found.U.diagonal() > 0.0).all())

    def factorise(self, upper: sp.csr_array, pattern: int) -> None:
        """Factorise the whole matrix."""
        whole = upper + sp.triu(upper, 1).T
        try:
            self._solve = sp.linalg.splu(
                whole.tocsc(),
                permc_spec="MMD_AT_PLUS_A",
                diag_pivot_thresh=_DIAGONAL_PIVOT,
                options={"SymmetricMode": True},
            )
        except RuntimeError as singular:
            raise SimulateError(_SINGULAR) from singular

    def factorise_definite(self, upper: sp.csr_array, pattern: int) -> bool:
        """Factorise the whole matrix and tell whether it is positive definite: a singular one is not."""
        try:
            self.factorise(upper, pattern)
        except SimulateError:
            return False
        return self.definite

    def solve(self, right_side: FloatArray) -> FloatArray:
        """Return x (n,)."""
        if self._solve is None:
            raise SimulateError("nothing has been factorised yet; call factorise first")
        return np.asarray(self._solve.solve(right_side))


_SINGULAR = (
    "the stiffness matrix is singular: some part can move freely. Fix it, tie it to another part, or bring it into "
    "contact"
)


class Pardiso:
    """MKL PARDISO: its symbolic phase is done once per pattern.

    Cholesky's factorisation, 2.5 times as fast as that of indefinite matrices, is tried first; where it meets negative
    curvature the indefinite one takes over for some factorisations.
    """

    def __init__(self, threads: int = 1) -> None:
        self._solver = _pypardiso().PyPardisoSolver(mtype=_SYMMETRIC_POSITIVE)
        self._solver.libmkl.MKL_Set_Num_Threads(threads)
        # own settings, METIS (its parallel form orders no better), pivots lifted to 1e-8, no scaling or matching (they
        # need values in the symbolic phase), iterative refinement only where pivots were lifted, blocks (the three
        # unknowns of a node have one pattern: half the time of the symbolic phase), and two levels, for many threads
        # but a sixth faster on one too
        for number, value in ((1, 1), (2, 2), (10, 8), (11, 0), (13, 0), (8, 0), (21, 1), (24, 1), (37, _BLOCKS)):
            self._solver.set_iparm(number, value)
        self._matrix: sp.csr_array | None = None
        self._pattern = (-1, -1)
        self._places: tuple[NDArray[np.int32], ...] = ()  # indptr and indices of the matrix, counted from 1
        self._indefinite = 0

    @property
    def definite(self) -> bool:
        """Whether Cholesky's factorisation, or else the count of negative pivots, says that it is."""
        if self._solver.mtype == _SYMMETRIC_POSITIVE:
            return self._matrix is not None
        return self._matrix is not None and int(self._solver.get_iparm(_NEGATIVE_PIVOTS)) == 0

    def _call(self, phase: int, right_side: FloatArray) -> FloatArray:
        """Run a phase of PARDISO on the matrix at hand, as the wrapper does, which copies all indices at each call.

        The wrapper's public methods repeat the symbolic phase at each factorisation too.
        """
        if self._matrix is None:
            raise SimulateError("nothing has been factorised yet; call factorise first")
        wrapped, found, error = self._solver, np.zeros_like(right_side), ctypes.c_int32(0)
        numbers = (1, 1, wrapped.mtype, phase, len(right_side))
        values = (self._matrix.data, *self._places, wrapped.perm)
        wrapped.libmkl.pardiso(
            wrapped.pt.ctypes.data_as(ctypes.POINTER(ctypes.c_int64)),
            *(ctypes.byref(ctypes.c_int32(number)) for number in numbers),
            *(array.ctypes.data_as(kind) for array, kind in zip(values, (_FLOATS, _INTS, _INTS, _INTS), strict=True)),
            ctypes.byref(ctypes.c_int32(1)),
            wrapped.iparm.ctypes.data_as(_INTS),
            ctypes.byref(ctypes.c_int32(0)),
            right_side.ctypes.data_as(_FLOATS),
            found.ctypes.data_as(_FLOATS),
            ctypes.byref(error),
        )
        if error.value:
            raise SimulateError(f"{_SINGULAR} (PARDISO: error {error.value})")
        return found

    def factorise(self, upper: sp.csr_array, pattern: int) -> None:
        """Factorise; the symbolic phase only for a new pattern."""
        if self._indefinite:
            self._indefinite -= 1
            self._factorise(upper, pattern, _SYMMETRIC_INDEFINITE)
            return
        try:
            self._factorise(upper, pattern, _SYMMETRIC_POSITIVE)
        except SimulateError:
            self._indefinite = _INDEFINITE_AFTER_FAILURE
            self._factorise(upper, pattern, _SYMMETRIC_INDEFINITE)

    def factorise_definite(self, upper: sp.csr_array, pattern: int) -> bool:
        """Factorise by Cholesky's method and tell whether that can be: a third of the time where it cannot."""
        try:
            self._factorise(upper, pattern, _SYMMETRIC_POSITIVE)
        except SimulateError:
            return False
        self._indefinite = 0
        return True

    def _factorise(self, upper: sp.csr_array, pattern: int, kind: int) -> None:
        """Factorise as a matrix of one kind."""
        nothing = np.zeros(upper.shape[0])
        if self._matrix is None or (pattern, upper.nnz) != self._pattern or kind != self._solver.mtype:
            self.release()
            self._solver.set_matrix_type(kind)
            self._matrix, self._pattern = upper, (pattern, upper.nnz)
            self._places = tuple(array.astype(np.int32) + np.int32(1) for array in (upper.indptr, upper.indices))
            self._call(11, nothing)
        self._matrix = upper
        self._call(22, nothing)

    def solve(self, right_side: FloatArray) -> FloatArray:
        """Return x (n,)."""
        return self._call(33, np.ascontiguousarray(right_side, np.float64))

    def release(self) -> None:
        """Give the factors' memory back."""
        if self._matrix is not None:
            self._solver.free_memory(everything=True)
            self._matrix = None

    def __del__(self) -> None:
        # at the interpreter's end modules that the wrapper needs are gone, and the memory goes anyway
        if hasattr(self, "_matrix") and not sys.is_finalizing():
            self.release()


def _pypardiso() -> ModuleType:
    """Import pypardiso with threads that sleep, rather than spin, between calls: they share the cores with Numba's."""
    os.environ.setdefault("KMP_BLOCKTIME", "0")
    # where pip puts MKL; without a hint the wrapper searches the whole environment, a second each time
    beside = sorted(Path(sys.prefix).glob("[Ll]ib*/*mkl_rt*"))
    if beside:
        os.environ.setdefault("PYPARDISO_MKL_RT", os.fspath(beside[0]))
    return importlib.import_module("pypardiso")
