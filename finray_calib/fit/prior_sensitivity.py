"""How much the answer owes to the prior: posterior means when every prior is made narrower or wider."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from finray_calib.fit.pareto_smoothing import smooth_weights
from finray_calib.fit.prior import Prior

FloatArray = NDArray[np.float64]


def mean_shifts(
    prior: Prior, theta: FloatArray, quantities: Mapping[str, FloatArray], factor: float
) -> dict[str, float]:
    """Return the shift of each posterior mean, in its standard deviations, under a prior `factor` times as wide.

    By reweighting the draws with the ratio of the two priors, smoothed; exact in the limit of many draws, a lower
    bound of the size when the weights are very uneven.

    Parameters
    ----------
    prior
        Prior the draws were made with.
    theta
        (N, D) posterior draws of equal weight.
    quantities
        Draws of each quantity, (N,).
    factor
        Multiplier of all standard deviations of the prior.
    """
    weight = smooth_weights(prior.widened(factor).log_density(theta) - prior.log_density(theta)).weight
    shifts = {}
    for name, draws in quantities.items():
        sd = float(draws.std(ddof=1))
        shifts[name] = float((weight @ draws - draws.mean()) / sd) if sd > 0 else 0.0
    return shifts
