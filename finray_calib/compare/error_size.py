"""Size of an error that is seen through uncertainty, with its 95 % interval."""

import numpy as np
from numpy.typing import NDArray

from data_schemas.compare import Interval

Floats = NDArray[np.float64]

_SHARE = 0.95
_PERCENTILES = (2.5, 97.5)


def error_size(error: Floats, systematic: Floats, noise: Floats) -> Interval:
    """Return the root mean square of an error m of which E = m + s + e is seen, with its 95 % interval.

    Any set that holds s with 95 % gives an interval of m: here the smallest 95 % of its draws, by their mean square.
    The ends are the smallest and the largest rms(E - s) over them, so that 0 is among the sizes where s may be all of
    E; a distribution of E - s never would say so. What noise adds to a mean square, 2 m e + e^2, is taken off: its
    mean from the estimate, its 95 % range from the ends. Holds m with 95 % or more; wider than needed where many
    independent directions of s matter.

    Parameters
    ----------
    error
        Seen, (n,).
    systematic, noise
        Draws of s and e with mean 0, (k, n); s is shared by the points, e is not.
    """
    seen = float(np.mean(error**2))
    noise_squares = np.mean(noise**2, axis=1)
    added_low, added_high = np.percentile(2.0 * noise @ error / len(error) + noise_squares, _PERCENTILES)
    squares = np.mean(systematic**2, axis=1)
    likely = systematic[squares <= np.quantile(squares, _SHARE)]
    left = np.mean((error - likely) ** 2, axis=1)
    mean_squares = np.array([seen - noise_squares.mean(), left.min() - added_high, left.max() - added_low])
    estimate, low, high = np.sqrt(np.maximum(mean_squares, 0.0))
    return Interval(estimate=float(estimate), low95=float(min(low, estimate)), high95=float(max(high, estimate)))
