"""Posterior draws by importance sampling from the mixture of Laplace approximations: milliseconds, self-diagnosed.

The weights are Pareto-smoothed, and the diagnostic k tells whether they can be trusted. Draws weighted anew also tell
how much the answer owes to the prior: posterior means when every prior is made narrower or wider.

The mixture is heavy-tailed and fitted to the posterior; it also says where walkers start and where they may jump to.
The density of its Student t components is compiled: it is what an importance sample costs beside the posterior.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Final, Self

import numpy as np
from numpy.typing import NDArray

from finray_calib.fit._likelihood import Maxima
from finray_calib.fit._prior import Prior
from finray_calib.spectra import compiled

FloatArray = NDArray[np.float64]

_DEGREES_OF_FREEDOM = 5  # tails heavier than the posterior's keep the importance weights bounded
_INFLATION = 1.2  # of the Laplace sd: a proposal a little too wide costs less than one too narrow
_LEAST_MASS = 0.05  # of the best maximum's: the Laplace mass is only an estimate
_PRIOR_SHARE = 0.05
_COMPONENTS = 12
_MOST_ROUNDS = 20
_DRAWS_PER_ROUND = 2000
_LEAST_EFFECTIVE = 0.1  # effective share of the draws below which the weights are tempered
GOOD_EFFECTIVE_SHARE: Final = 0.4
"""Effective share of the draws at which adaptation stops."""

_GOOD_ROUNDS = 2  # one round can be lucky and miss a tail
_NEIGHBOURS = 0.05  # of the draws: they shape a component that is added
_GROWN_SHARE = 0.1
_LEAST_SHARE = 0.01  # of a component: fewer draws cannot carry a covariance


class MixtureProposal:
    """Student t components with 5 degrees of freedom plus a share of prior draws.

    q(theta) = sum_k s_k t_5(theta; centre_k, covariance_k) + s_0 prior(theta), s_0 = 1 - sum_k s_k = 0.05.

    Parameters
    ----------
    shares
        (K,) relative weights of the components.
    centres
        (K, D) centres.
    covariances
        (K, D, D) scale matrices.
    prior
        Prior of the parameters.
    """

    def __init__(self, shares: FloatArray, centres: FloatArray, covariances: FloatArray, prior: Prior) -> None:
        self._prior = prior
        self._shares = np.append(shares / shares.sum() * (1 - _PRIOR_SHARE), _PRIOR_SHARE)
        self._centres = centres
        self._covariances = covariances
        self._factors = np.linalg.cholesky(covariances)
        self._whiten = np.linalg.inv(self._factors)
        dimension, df = centres.shape[1], _DEGREES_OF_FREEDOM
        constant = math.lgamma((df + dimension) / 2) - math.lgamma(df / 2) - dimension / 2 * np.log(df * np.pi)
        ln_norm = constant - np.log(np.diagonal(self._factors, axis1=1, axis2=2)).sum(axis=1)
        self._heights = self._shares[:-1] * np.exp(ln_norm)

    @property
    def shares(self) -> FloatArray:
        """Shares of the components, (K,), without the prior's; their sum is 1."""
        return np.asarray(self._shares[:-1] / self._shares[:-1].sum())

    @classmethod
    def around(cls, maxima: Maxima, prior: Prior) -> Self:
        """Return one component per maximum: its Laplace approximation, slightly widened, weighted by its mass."""
        mass = np.exp(maxima.ln_laplace_mass - maxima.ln_laplace_mass.max())
        covariances = np.asarray(np.linalg.inv(maxima.information) * _INFLATION**2, dtype=np.float64)
        return cls(np.maximum(mass, _LEAST_MASS), maxima.theta, _symmetric(covariances), prior)

    def adapted(
        self,
        log_density: Callable[[FloatArray], FloatArray],
        rng: np.random.Generator,
        draws_per_round: int = _DRAWS_PER_ROUND,
        good_effective_share: float = GOOD_EFFECTIVE_SHARE,
    ) -> Self:
        """Return a mixture of up to ten components fitted to a density by population Monte Carlo.

        Each round draws from the mixture, weights the draws by density / mixture, and updates shares, centres
        and covariances by one step of expectation maximisation for Student t mixtures. While the weights are
        too uneven they are tempered.

        References
        ----------
        Cappe, Douc, Guillin, Marin, Robert, Adaptive importance sampling in general mixture classes,
        Statistics and Computing 18 (2008) 447-459.
        """
        mixture, good = self, 0
        for round_ in range(_MOST_ROUNDS):
            theta = mixture.draw(draws_per_round, rng)
            ln_weight = log_density(theta) - mixture.log_density(theta)
            is_good = effective_number(normalised(ln_weight)) > good_effective_share * draws_per_round
            good = good + 1 if is_good else 0
            if good == _GOOD_ROUNDS:
                break
            weight = tempered_weights(ln_weight, _LEAST_EFFECTIVE * draws_per_round)
            if round_ == 0:
                mixture = self._split(theta, weight, rng)
            mixture = mixture.updated(theta, weight)
        return mixture

    def grown(self, theta: FloatArray, weight: FloatArray) -> Self:
        """Return the mixture with one more component where its draws are most under-represented.

        The centre is the draw of largest weight, the covariance that of its nearest draws; the component takes a
        tenth of the shares. A few of these cover a curved ridge that no adapted component reaches.

        Parameters
        ----------
        theta
            (n, D) draws of this mixture.
        weight
            (n,) their importance weights, sum 1.

        References
        ----------
        Raftery, Bao, Estimating and projecting trends in HIV/AIDS generalized epidemics using incremental mixture
        importance sampling, Biometrics 66 (2010) 1162-1173.
        """
        apart = theta - weight @ theta
        whiten = np.linalg.inv(np.linalg.cholesky(apart.T @ (apart * weight[:, None])))
        centre = theta[weight.argmax()]
        distance = np.square((theta - centre) @ whiten.T).sum(axis=1)
        near = np.argpartition(distance, int(_NEIGHBOURS * len(theta)))[: int(_NEIGHBOURS * len(theta))]
        share = weight[near] + 1 / len(theta)
        beside = theta[near] - centre
        covariance = _symmetric((beside.T @ (beside * share[:, None]) / share.sum())[None])
        return type(self)(
            np.append(self.shares * (1 - _GROWN_SHARE), _GROWN_SHARE),
            np.concatenate([self._centres, centre[None]]),
            np.concatenate([self._covariances, covariance]),
            self._prior,
        )

    def joined(self, other: Self, share: float) -> Self:
        """Return the mixture of this one and another one, which takes `share` of the draws.

        What an adapted mixture has forgotten, the one that it came from still draws, and its weights tell.
        """
        return type(self)(
            np.concatenate([self.shares * (1 - share), other.shares * share]),
            np.concatenate([self._centres, other._centres]),
            np.concatenate([self._covariances, other._covariances]),
            self._prior,
        )

    def draw(self, count: int, rng: np.random.Generator) -> FloatArray:
        """Return (count, D) draws in random order."""
        counts = rng.multinomial(count, self._shares)
        prior_draws = self._prior.draw(counts[-1], rng)
        size = int(counts[:-1].sum())
        stretch = np.sqrt(_DEGREES_OF_FREEDOM / rng.chisquare(_DEGREES_OF_FREEDOM, size))
        normal = stretch[:, None] * rng.standard_normal((size, self._centres.shape[1]))
        parts = zip(self._centres, self._factors, np.split(normal, np.cumsum(counts[:-2])), strict=True)
        draws = [centre + part @ factor.T for centre, factor, part in parts]
        return np.asarray(rng.permutation(np.concatenate([prior_draws, *draws])))

    def log_density(self, theta: FloatArray) -> FloatArray:
        """Return the normalised log density of (n, D) rows, (n,)."""
        _, terms = self._terms(theta)
        return np.asarray(np.log(terms.sum(axis=1) + self._prior_term(theta)))

    def _terms(self, theta: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return squared Mahalanobis distances and densities of the components times their shares, each (n, K)."""
        squared, terms = np.empty((2, len(theta), len(self._centres)))
        rows = np.ascontiguousarray(theta)
        fill_terms(rows, self._centres, self._whiten, self._heights, _DEGREES_OF_FREEDOM, squared, terms)
        return squared, terms

    def _prior_term(self, theta: FloatArray) -> FloatArray:
        """Return the prior's density times its share, (n,)."""
        return np.asarray(self._shares[-1] * np.exp(self._prior.log_density(theta)))

    def _split(self, theta: FloatArray, weight: FloatArray, rng: np.random.Generator) -> Self:
        """Return the mixture with components of the present shapes moved to weighted draws."""
        centres = theta[rng.choice(len(theta), _COMPONENTS, p=weight)]
        nearest = self._terms(centres)[1].argmax(axis=1)
        shares = np.full(_COMPONENTS, 1.0)
        return type(self)(shares, centres, self._covariances[nearest], self._prior)

    def updated(self, theta: FloatArray, weight: FloatArray) -> Self:
        """Return the mixture after one step of expectation maximisation on (n, D) draws with (n,) weights."""
        squared, terms = self._terms(theta)
        member = terms * (weight / (terms.sum(axis=1) + self._prior_term(theta)))[:, None]
        share = member.sum(axis=0)
        keep = share > _LEAST_SHARE
        if not keep.any():
            return self
        scaled = member * (_DEGREES_OF_FREEDOM + theta.shape[1]) / (_DEGREES_OF_FREEDOM + squared)
        centres = (scaled.T @ theta)[keep] / scaled.sum(axis=0)[keep, None]
        apart = theta - centres[:, None]
        weighted = apart * scaled[:, keep].T[..., None]
        covariances = weighted.swapaxes(1, 2) @ apart / share[keep, None, None]
        shrunk = covariances + 0.02 * self._covariances[keep]  # keeps the rank when a component holds few draws
        return type(self)(share[keep], centres, _symmetric(shrunk), self._prior)


def tempered_weights(ln_weight: FloatArray, least_effective: float) -> FloatArray:
    """Return normalised weights w^a with the largest a <= 1 on a grid whose effective number is high enough.

    The effective number of weights is 1 / sum(w^2); a is lowered by factors of 0.8.

    Parameters
    ----------
    ln_weight
        (n,) logarithms, minus infinity allowed.
    least_effective
        Demanded effective number.
    """
    power = 1.0
    while effective_number(normalised(power * ln_weight)) < least_effective and power > 1e-4:
        power *= 0.8
    return normalised(power * ln_weight)


def log_sum_exp(terms: FloatArray) -> FloatArray:
    """Return ln sum exp(terms) along the first axis, without overflow; some term of each sum is finite."""
    top = terms.max(axis=0)
    return np.asarray(top + np.log(np.exp(terms - top).sum(axis=0)))


def normalised(ln_weight: FloatArray) -> FloatArray:
    """Return the weights of logarithms, (n,), with sum 1."""
    weight = np.exp(ln_weight - ln_weight.max())
    return np.asarray(weight / weight.sum())


def effective_number(weight: FloatArray) -> float:
    """Return the effective number 1 / sum(w^2) of normalised weights."""
    return float(1 / (weight**2).sum())


def _symmetric(matrices: FloatArray) -> FloatArray:
    """Return matrices without the asymmetry of rounding."""
    return np.asarray((matrices + matrices.swapaxes(1, 2)) / 2)


@compiled
def fill_terms(
    theta: FloatArray,
    centres: FloatArray,
    whiten: FloatArray,
    height: FloatArray,
    degrees_of_freedom: int,
    squared: FloatArray,
    term: FloatArray,
) -> None:
    """Fill the squared Mahalanobis distances and the terms of the density of (n, D) rows, each (n, K).

    term_k = height_k (1 + squared_k / df)^(-(df + D) / 2), with whole degrees of freedom df: half-integer powers are
    products and one square root. The whitening matrices, (K, D, D), are lower triangles.
    """
    size = theta.shape[1]
    whole, odd = (degrees_of_freedom + size) // 2, (degrees_of_freedom + size) % 2
    apart = np.empty(size)
    for n in range(len(theta)):
        for k in range(len(centres)):
            total = 0.0
            for i in range(size):
                apart[i] = theta[n, i] - centres[k, i]
                z = 0.0
                for j in range(i + 1):
                    z += whiten[k, i, j] * apart[j]
                total += z * z
            squared[n, k] = total
            base = 1.0 + total / degrees_of_freedom
            power = np.sqrt(base) if odd else 1.0
            for _ in range(whole):
                power *= base
            term[n, k] = height[k] / power


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
