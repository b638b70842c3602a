"""Who bears the risk when many items are inspected: global consumer's and producer's risk (JCGM 106:2012, 9.5).

All numbers of one call are in one unit, that of the inspected quantity; risks are probabilities, 0 to 1.
"""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm

from data_schemas import FinrayError
from finray_calib.acceptance._conformity import ToleranceInterval, check_sd

Floats = NDArray[np.float64]

_TAIL_SDS: Final = 9.0  # beyond it a normal distribution has less than 1e-18
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(24)


@dataclass(frozen=True, slots=True)
class GlobalRisks:
    """Hold the risks of inspecting many items.

    Attributes
    ----------
    consumer_share : float
        R_C: probability that an item is accepted and does not conform.
    producer_share : float
        R_P: probability that an item conforms and is rejected.
    conforming_share : float
        Probability that an item conforms, before inspection.
    """

    consumer_share: float
    producer_share: float
    conforming_share: float


def global_risks(
    prior: Callable[[Floats], Floats],
    support: tuple[float, float],
    sd: float,
    tolerance: ToleranceInterval,
    guard: float = 0.0,
) -> GlobalRisks:
    """Return the consumer's and producer's risk of inspecting items of a known distribution.

    R_C = int_{not C} g0(eta) P(accept | eta) d eta and R_P = int_C g0(eta) (1 - P(accept | eta)) d eta over conforming
    values C, with P(accept | eta) = Phi((A_U - eta) / u) - Phi((A_L - eta) / u): measurements scatter normally about
    the true value, and are accepted within the tolerance interval narrowed by the guard band.

    Parameters
    ----------
    prior : callable
        Density g0 of the quantity over the items, per unit of it, for example ``scipy.stats.gamma(4, scale=0.25).pdf``.
    support : tuple of float
        Finite interval that holds all of g0 that matters.
    sd : float
        Standard uncertainty u of one measurement, in the unit of the limits; above 0.
    tolerance : ToleranceInterval
    guard : float
        Guard band w, in that unit; negative for guarded rejection.

    Returns
    -------
    GlobalRisks

    Raises
    ------
    FinrayError
        The uncertainty is not above 0, the support is no finite interval, or the density is not 1 over it.

    References
    ----------
    JCGM 106:2012, 9.5.
    """
    check_sd(sd)
    if sd == 0.0 or not np.isfinite(support).all() or support[0] >= support[1]:
        raise FinrayError(
            f"support {support} and uncertainty {sd}: the support must be a finite interval, lowest value first, and "
            "the uncertainty of a measurement above 0; for an exact measurement both risks are 0"
        )
    value, weight = _quadrature(support, tolerance, guard, sd)
    weight = weight * np.asarray(prior(value))
    low, high = tolerance.narrowed(guard)
    # guard bands that overlap leave nothing that could be accepted
    accepted = np.maximum(norm.cdf((high - value) / sd) - norm.cdf((low - value) / sd), 0.0)
    conforms = (value >= tolerance.edges[0]) & (value <= tolerance.edges[1])
    whole = float(weight.sum())
    # a support that cuts more off than this changes risks that one would state
    if abs(whole - 1) > 1e-4:
        raise FinrayError(
            f"the distribution of the items integrates to {whole:.6g} over {support}: it must be a density, per unit "
            "of the quantity; widen the support or normalise it"
        )
    return GlobalRisks(
        consumer_share=float((weight * accepted)[~conforms].sum()),
        producer_share=float((weight * (1 - accepted))[conforms].sum()),
        conforming_share=float(weight[conforms].sum()),
    )


def global_risks_normal(
    mean: float, process_sd: float, sd: float, tolerance: ToleranceInterval, guard: float = 0.0
) -> GlobalRisks:
    """Return the global risks of items that are normally distributed.

    Parameters
    ----------
    mean, process_sd : float
        Of the items, in the unit of the limits.
    sd, tolerance, guard
        As for :func:`global_risks`.

    Raises
    ------
    FinrayError
        One of the standard deviations is not above 0.
    """
    check_sd(process_sd)
    if process_sd == 0.0:
        raise FinrayError("the standard deviation of the items is 0: use conformance_probability for one known item")
    reach = _TAIL_SDS * process_sd
    return global_risks(norm(mean, process_sd).pdf, (mean - reach, mean + reach), sd, tolerance, guard)


def _quadrature(
    support: tuple[float, float], tolerance: ToleranceInterval, guard: float, sd: float
) -> tuple[Floats, Floats]:
    """Return nodes and weights of Gauss-Legendre panels: short where acceptance changes, none across a limit."""
    bends = [limit + step * sd for limit in tolerance.narrowed(guard) for step in range(-8, 9, 2)]
    inner = [*np.linspace(*support, 33), *tolerance.edges, *bends]
    ends = sorted({float(end) for end in inner if support[0] <= end <= support[1]})
    middle, half = np.array([((b + a) / 2, (b - a) / 2) for a, b in pairwise(ends)]).T
    return (middle[:, None] + half[:, None] * _NODES).ravel(), (half[:, None] * _WEIGHTS).ravel()
