"""Evenly spread random points: a Kronecker sequence with a random shift, unbiased and with less noise."""

import numpy as np
from numpy.typing import NDArray


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
    root = 2.0
    for _ in range(40):
        root = (1.0 + root) ** (1.0 / (dimensions + 1.0))
    steps = root ** -np.arange(1.0, dimensions + 1.0)
    return np.asarray((rng.random(dimensions) + np.arange(count)[:, None] * steps) % 1.0)
