"""Tensor products of uniform cubic B-splines over 0..1: weights, sums with derivatives, the matrices of a fit.

Along each direction, `cells` cells have `cells + 3` coefficients; one piece of arithmetic serves numpy's arrays and
the renderer's.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array, csr_array, diags_array, eye_array, kron, vstack

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
