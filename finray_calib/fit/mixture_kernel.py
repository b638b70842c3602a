"""Compiled density of a mixture of Student t components: what an importance sample costs beside the posterior."""

import numpy as np
from numpy.typing import NDArray

from finray_calib.spectra.compiled import compiled

FloatArray = NDArray[np.float64]


@compiled
def fill_terms(
    theta: FloatArray,
    centres: FloatArray,
    whiten: FloatArray,
    height: FloatArray,
    degrees_of_freedom: int,
    squared: FloatArray,
    term: FloatArray,
) -> None:
    """Fill the squared Mahalanobis distances and the terms of the density of (n, D) rows, each (n, K).

    term_k = height_k (1 + squared_k / df)^(-(df + D) / 2), with whole degrees of freedom df: half-integer powers are
    products and one square root. The whitening matrices, (K, D, D), are lower triangles.
    """
    size = theta.shape[1]
    whole, odd = (degrees_of_freedom + size) // 2, (degrees_of_freedom + size) % 2
    apart = np.empty(size)
    for n in range(len(theta)):
        for k in range(len(centres)):
            total = 0.0
            for i in range(size):
                apart[i] = theta[n, i] - centres[k, i]
                z = 0.0
                for j in range(i + 1):
                    z += whiten[k, i, j] * apart[j]
                total += z * z
            squared[n, k] = total
            base = 1.0 + total / degrees_of_freedom
            power = np.sqrt(base) if odd else 1.0
            for _ in range(whole):
                power *= base
            term[n, k] = height[k] / power
