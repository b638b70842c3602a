"""Where one more observation helps most: the knowledge gradient, exact for normal beliefs."""

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm

Floats = NDArray[np.float64]


def expected_maximum_gain(intercepts: Floats, slopes: Floats) -> float:
    """Return E[max_i(a_i + b_i Z)] - max_i a_i for a standard normal Z.

    The maximum of the lines is piecewise linear and convex. With its lines in order of slope and the points c_i where
    line i gives way to line i + 1, the gain is sum_i (b_{i+1} - b_i) f(-|c_i|), f(z) = phi(z) + z Phi(z). Exact.

    Parameters
    ----------
    intercepts, slopes : ndarray, shape (G,)

    Returns
    -------
    float
        In the unit of the intercepts; never negative.

    References
    ----------
    P. Frazier, W. Powell, S. Dayanik, The knowledge-gradient policy for correlated normal beliefs, INFORMS J. Comput.
    21 (2009), 599-613, algorithm 1.
    """
    order = np.lexsort((intercepts, slopes))
    lines: list[tuple[float, float]] = []
    gives_way: list[float] = []
    for a, b in zip(intercepts[order].tolist(), slopes[order].tolist(), strict=True):
        while lines:
            last_a, last_b = lines[-1]
            if b > last_b:
                crossing = (last_a - a) / (b - last_b)
                if not gives_way or crossing > gives_way[-1]:
                    gives_way.append(crossing)
                    break
            # the last line is nowhere above both of its neighbours
            lines.pop()
            if gives_way:
                gives_way.pop()
        lines.append((a, b))
    steps = np.diff([b for _, b in lines])
    distance = -np.abs(gives_way)
    return float((steps * (norm.pdf(distance) + distance * norm.cdf(distance))).sum())


def knowledge_gradient(mean: Floats, response: Floats, observed_variance: Floats, noise_variance: Floats) -> Floats:
    """Return how much the best expected value is expected to rise when each candidate is observed once.

    Observing candidate j moves the expected values by response[:, j] / sqrt(v_j + n_j) times a standard normal.

    Parameters
    ----------
    mean : ndarray, shape (G,)
        Expected values among which the best is chosen.
    response : ndarray, shape (G, C)
        Covariance of each value with the quantity that candidate j observes.
    observed_variance, noise_variance : ndarray, shape (C,)
        Variance of that quantity before the observation, and of the observation itself.

    Returns
    -------
    ndarray, shape (C,)
        In the unit of the mean.
    """
    sd = np.sqrt(np.maximum(observed_variance, 0) + noise_variance)
    return np.array([expected_maximum_gain(mean, slopes) for slopes in (response / sd).T])
