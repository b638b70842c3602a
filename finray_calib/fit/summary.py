"""One number and its intervals from posterior draws."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from data_schemas.errors import FitError

_FEWEST_DRAWS = 100


@dataclass(frozen=True, slots=True)
class Summary:
    """Estimate with equal-tailed intervals, in the unit of the draws.

    Attributes
    ----------
    estimate
        Median.
    sd
        Standard deviation.
    low68, high68
        16 % and 84 % quantiles.
    low95, high95
        2.5 % and 97.5 % quantiles.
    """

    estimate: float
    sd: float
    low68: float
    high68: float
    low95: float
    high95: float


def summarise(draws: NDArray[np.float64]) -> Summary:
    """Return median, standard deviation and equal-tailed 68 % and 95 % intervals of draws of one quantity.

    Parameters
    ----------
    draws
        (N,) posterior draws, at least 100.

    Raises
    ------
    FitError
        When there are fewer than 100 draws or one is not finite.
    """
    if draws.size < _FEWEST_DRAWS or not np.isfinite(draws).all():
        raise FitError(
            f"summary: {draws.size} draws, {int((~np.isfinite(draws)).sum())} of them not finite; at least "
            f"{_FEWEST_DRAWS} finite draws are needed for 95 % limits"
        )
    low95, low68, median, high68, high95 = np.quantile(draws, [0.025, 0.16, 0.5, 0.84, 0.975])
    return Summary(float(median), float(draws.std(ddof=1)), float(low68), float(high68), float(low95), float(high95))
