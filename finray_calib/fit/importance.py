"""Posterior draws by importance sampling from the mixture of Laplace approximations: milliseconds, self-diagnosed."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from finray_calib.fit.mixture_proposal import MixtureProposal, log_sum_exp
from finray_calib.fit.pareto_smoothing import LARGEST_PARETO_K, smooth_weights

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
