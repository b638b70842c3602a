"""Pareto-smoothed importance weights and the diagnostic k that tells whether they can be trusted."""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

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
