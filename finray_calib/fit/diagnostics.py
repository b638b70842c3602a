"""Convergence diagnostics of Markov chains: R-hat, effective sample size and autocorrelation time.

All functions take chains of one quantity as (steps, chains). Walkers of an ensemble are treated as chains.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

LARGEST_R_HAT = 1.01
SMALLEST_EFFECTIVE_SAMPLES = 400.0
"""A chain is trusted below this R-hat and above this effective sample size (Vehtari and others, 2021)."""

_WINDOW = 5.0  # Sokal: sum the autocorrelation to the first lag beyond five autocorrelation times


@dataclass(frozen=True, slots=True)
class ChainDiagnostics:
    """How far the chains can be trusted, per parameter.

    Attributes
    ----------
    r_hat
        (6,) rank-normalised split R-hat, 1 when the chains agree.
    bulk_ess
        (6,) bulk effective sample size.
    autocorrelation_steps
        (6,) integrated autocorrelation time, steps.
    acceptance
        Accepted share of the proposals.
    steps
        Steps kept per walker, after the discarded start.
    walkers
        Number of walkers.
    converged
        True when the chain is longer than the demanded number of autocorrelation times and R-hat is close to 1.
    """

    r_hat: FloatArray
    bulk_ess: FloatArray
    autocorrelation_steps: FloatArray
    acceptance: float
    steps: int
    walkers: int
    converged: bool


def rank_r_hat(chains: FloatArray) -> float:
    """Return the rank-normalised split R-hat, the larger of bulk and folded.

    sqrt(((n - 1)/n W + B/n) / W) of the normal scores of the ranks of the split chains; folded with
    abs(x - median). Valid for four or more steps.

    Parameters
    ----------
    chains
        (steps, chains) values of one quantity.

    References
    ----------
    Vehtari, Gelman, Simpson, Carpenter, Buerkner, Rank-normalization, folding, and localization: an improved
    R-hat, Bayesian Analysis 16 (2021) 667-718.
    """
    halves = _split(chains)
    return max(_r_hat(_normal_scores(halves)), _r_hat(_normal_scores(np.abs(halves - np.median(halves)))))


def bulk_ess(chains: FloatArray) -> float:
    """Return the bulk effective sample size of the rank-normalised split chains.

    S / (1 + 2 sum rho_t) with Geyer's initial monotone positive sequence over pairs of lags, S the number of
    values; at most S log10(S).

    Parameters
    ----------
    chains
        (steps, chains) values of one quantity.

    References
    ----------
    Vehtari et al., Bayesian Analysis 16 (2021) 667-718, section 3.2.
    """
    scores = _normal_scores(_split(chains))
    steps, count = scores.shape
    covariance = _autocovariance(scores).mean(axis=1)
    within = covariance[0] * steps / (steps - 1)
    between = scores.mean(axis=0).var(ddof=1) if count > 1 else 0.0
    marginal = within * (steps - 1) / steps + between
    rho = 1 - (within - covariance * steps / (steps - 1)) / marginal
    rho[0] = 1.0
    pairs = rho[: steps // 2 * 2].reshape(-1, 2).sum(axis=1)
    positive = pairs[: int(np.argmax(pairs <= 0))] if (pairs <= 0).any() else pairs
    tau = max(-1 + 2 * float(np.minimum.accumulate(positive).sum()), 1 / np.log10(scores.size))
    return float(scores.size / tau)


def autocorrelation_time(chains: FloatArray) -> float:
    """Return the integrated autocorrelation time in steps, 1 + 2 sum rho_t, with Sokal's window.

    The autocorrelation functions are averaged over the chains. Trust it when the chains are longer than 50
    times the result.

    Parameters
    ----------
    chains
        (steps, chains) values of one quantity.

    References
    ----------
    Goodman, Weare, Comm. Appl. Math. Comp. Sci. 5 (2010) 65-80; Sokal, Monte Carlo methods (1989).
    """
    covariance = _autocovariance(chains).mean(axis=1)
    tau = 2 * np.cumsum(covariance / covariance[0]) - 1
    beyond = np.arange(tau.size) >= _WINDOW * tau
    return float(tau[np.argmax(beyond)] if beyond.any() else tau[-1])


def _split(chains: FloatArray) -> FloatArray:
    """Return first and second halves as separate chains."""
    half = chains.shape[0] // 2
    return np.concatenate([chains[:half], chains[-half:]], axis=1)


def _normal_scores(values: FloatArray) -> FloatArray:
    """Return the normal quantiles of the fractional ranks."""
    from scipy.special import ndtri  # here, because it takes long to load, and most fits have no chain

    _, place, count = np.unique(values, return_inverse=True, return_counts=True)
    ranks = (np.cumsum(count) - (count - 1) / 2)[place].reshape(values.shape)  # repeated values share their mean rank
    return np.asarray(ndtri((ranks - 0.375) / (values.size + 0.25)))


def _r_hat(chains: FloatArray) -> float:
    """Return the Gelman-Rubin ratio of chains."""
    steps = chains.shape[0]
    within = chains.var(axis=0, ddof=1).mean()
    between = chains.mean(axis=0).var(ddof=1)
    return float(np.sqrt((steps - 1) / steps + between / within))


def _autocovariance(chains: FloatArray) -> FloatArray:
    """Return the biased autocovariance of each chain by FFT, (steps, chains)."""
    steps = chains.shape[0]
    size = 1 << (2 * steps - 1).bit_length()
    spectrum = np.fft.rfft(chains - chains.mean(axis=0), n=size, axis=0)
    return np.asarray(np.fft.irfft(np.abs(spectrum) ** 2, n=size, axis=0)[:steps] / steps)
