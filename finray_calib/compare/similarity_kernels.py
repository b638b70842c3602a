"""Pointwise arithmetic of structural similarity, compiled: one pass over memory where array expressions take ten."""

import numpy as np
from numpy.typing import NDArray

from finray_calib.spectra.compiled import compiled

Floats = NDArray[np.float64]


@compiled
def second_moments(x: Floats, y: Floats, squares: Floats, product: Floats) -> None:
    """Put x^2 + y^2 and x y of two (rows, values) arrays into the last two."""
    for row in range(x.shape[0]):
        for i in range(x.shape[1]):
            a, b = x[row, i], y[row, i]
            squares[row, i] = a * a + b * b
            product[row, i] = a * b


@compiled
def similarity_factors(mean_x: Floats, mean_y: Floats, squares: Floats, product: Floats, c1: float, c2: float) -> None:
    """Turn windowed moments, (rows, values), into the factors luminance and structure, in place of the first and last.

    luminance = (2 mu_x mu_y + c1) / (mu_x^2 + mu_y^2 + c1), structure = (2 cov + c2) / (var_x + var_y + c2).
    """
    for row in range(mean_x.shape[0]):
        for i in range(mean_x.shape[1]):
            a, b = mean_x[row, i], mean_y[row, i]
            ab, aabb = a * b, a * a + b * b
            mean_x[row, i] = (2.0 * ab + c1) / (aabb + c1)
            product[row, i] = (2.0 * (product[row, i] - ab) + c2) / (squares[row, i] - aabb + c2)


@compiled
def channel_mean_of_product(first: Floats, second: Floats, result: Floats) -> None:
    """Put the mean over channels of the product of two (rows, columns, channels) arrays into the third."""
    channels = first.shape[2]
    for row in range(first.shape[0]):
        for column in range(first.shape[1]):
            total = 0.0
            for channel in range(channels):
                total += first[row, column, channel] * second[row, column, channel]
            result[row, column] = total / channels
