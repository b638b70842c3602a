"""Posterior draws by importance sampling from the mixture of Laplace approximations: milliseconds, self-diagnosed.

The weights are Pareto-smoothed, and the diagnostic k tells whether they can be trusted. Draws weighted anew also tell
how much the answer owes to the prior: posterior means when every prior is made narrower or wider.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from finray_calib.fit._mixture_proposal import MixtureProposal, log_sum_exp
from finray_calib.fit._prior import Prior

FloatArray = NDArray[np.float64]

FEWEST_EFFECTIVE: Final = 800.0
"""Effective draws for 95 % limits: the quantile's own error is then a tenth of a standard deviation."""

SMALLEST_EFFECTIVE_SHARE: Final = 0.25
"""Of the draws. A proposal that covers less of the posterior can miss a tail and still show a harmless k."""


@dataclass(frozen=True, slots=True)
class WeightedSample:
    """Weighted draws of a posterior.

    Attributes
    ----------
    theta
        (n, D) draws of the proposal.
    weight
        (n,) smoothed weights, sum 1.
    pareto_k
        Shape of the tail of the raw weights; above 0.7 the sample is not to be trusted.
    effective
        Effective number of draws.
    ln_evidence, ln_evidence_sd
        Logarithm of the integral of the density, and its Monte Carlo standard deviation.
    """

    theta: FloatArray
    weight: FloatArray
    pareto_k: float
    effective: float
    ln_evidence: float
    ln_evidence_sd: float

    @property
    def covered(self) -> bool:
        """Whether the proposal covers the density, as far as k and the effective share tell."""
        return self.pareto_k <= LARGEST_PARETO_K and self.effective >= SMALLEST_EFFECTIVE_SHARE * len(self.weight)

    @property
    def trusted(self) -> bool:
        """Whether the proposal covers the density and enough draws are effective for 95 % limits."""
        return self.covered and self.effective >= FEWEST_EFFECTIVE

    def resampled(self, count: int, rng: np.random.Generator) -> FloatArray:
        """Return (count, D) draws of equal weight in random order, by systematic resampling."""
        position = (np.arange(count) + rng.random()) / count
        chosen = np.searchsorted(np.cumsum(self.weight), position).clip(max=len(self.weight) - 1)
        return np.asarray(self.theta[rng.permutation(chosen)])


def importance_sample(
    log_density: Callable[[FloatArray], FloatArray], proposal: MixtureProposal, count: int, rng: np.random.Generator
) -> WeightedSample:
    """Return draws of a proposal weighted by density over proposal, smoothed.

    The mean of the raw weights estimates the evidence without bias.

    Parameters
    ----------
    log_density
        Function of (n, D) rows returning (n,) log densities, minus infinity where not allowed.
    proposal
        Normalised density with tails heavier than the posterior's.
    count
        Number of draws.
    rng
        Source of all randomness.
    """
    theta = proposal.draw(count, rng)
    ln_weight = log_density(theta) - proposal.log_density(theta)
    smoothed = smooth_weights(ln_weight)
    ln_sum = float(log_sum_exp(ln_weight))
    raw = np.exp(ln_weight - ln_sum)
    sd = float(np.sqrt(max(float((raw**2).sum()) - 1 / count, 0.0)))
    return WeightedSample(
        theta, smoothed.weight, smoothed.pareto_k, smoothed.effective, ln_sum - float(np.log(count)), sd
    )


LARGEST_PARETO_K: Final = 0.7
"""Above this shape of the tail an importance sample of practical size is not to be trusted (Vehtari and others)."""

_FEWEST_IN_TAIL = 5
_PRIOR_COUNT = 10  # of the weak prior on the shape: k is shrunk towards 0.5 as if by ten draws
_PRIOR_SHAPE = 0.5
_EQUAL_NATS = 1e-9  # rounding of log densities: weights closer together than this are equal


@dataclass(frozen=True, slots=True)
class SmoothedWeights:
    """Normalised weights (n,) and the shape k of the tail of the raw ones, infinite where it cannot be estimated."""

    weight: FloatArray
    pareto_k: float

    @property
    def effective(self) -> float:
        """Effective number of draws, 1 / sum(w^2)."""
        return float(1 / (self.weight**2).sum())


def smooth_weights(ln_weight: FloatArray) -> SmoothedWeights:
    """Return importance weights whose largest are replaced by quantiles of a fitted generalised Pareto tail.

    The tail holds the min(n / 5, 3 sqrt(n)) largest weights; a smoothed weight is never above the largest raw one.
    Equal largest weights have no tail: k is 0. Of fewer than five different ones k is infinite.

    Parameters
    ----------
    ln_weight
        (n,) logarithms of the raw weights up to a constant; minus infinity for weight zero.

    References
    ----------
    Vehtari, Simpson, Gelman, Yao, Gabry, Pareto smoothed importance sampling, JMLR 25 (2024) 1-58.
    """
    shifted = np.asarray(ln_weight - ln_weight.max())
    size = len(shifted)
    count = int(np.ceil(min(0.2 * size, 3 * np.sqrt(size))))
    order = np.argsort(shifted)
    cut = max(shifted[order[-count - 1]], np.log(np.finfo(float).tiny))
    tail = order[-count:]
    tail = tail[shifted[tail] > cut]
    equal = cut > -_EQUAL_NATS
    k = 0.0 if equal else np.inf
    if not equal and len(tail) >= _FEWEST_IN_TAIL:
        k, scale = fit_pareto_tail(np.exp(shifted[tail]) - np.exp(cut))
        if np.isfinite(k):
            p = (np.arange(len(tail)) + 0.5) / len(tail)
            with np.errstate(over="ignore"):  # of a hopelessly heavy tail; cut to the largest raw weight below
                q = scale * np.expm1(-k * np.log1p(-p)) / k if k != 0 else -scale * np.log1p(-p)
            shifted[tail] = np.minimum(np.log(np.exp(cut) + q), 0.0)
    weight = np.exp(shifted - shifted.max())
    return SmoothedWeights(weight / weight.sum(), float(k))


def fit_pareto_tail(excess: FloatArray) -> tuple[float, float]:
    """Return shape k and scale of a generalised Pareto distribution of positive excesses in increasing order.

    The quasi-Bayesian estimate of Zhang and Stephens with a weak prior on the shape.

    References
    ----------
    Zhang, Stephens, A new and efficient estimation method for the generalized Pareto distribution, Technometrics 51
    (2009) 316-325.
    """
    size = len(excess)
    candidates = 30 + int(np.sqrt(size))
    j = np.arange(1, candidates + 1)
    theta = 1 / excess[-1] + (1 - np.sqrt(candidates / (j - 0.5))) / (3 * excess[int(size / 4 + 0.5) - 1])
    shape = np.log1p(-theta[:, None] * excess).mean(axis=1)
    profile = size * (np.log(-theta / shape) - shape - 1)
    weight = np.exp(profile - profile.max())
    best = float(theta @ weight / weight.sum())
    k = float(np.log1p(-best * excess).mean())
    return (size * k + _PRIOR_COUNT * _PRIOR_SHAPE) / (size + _PRIOR_COUNT), -k / best


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
