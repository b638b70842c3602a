"""Emulator of a design's expensive numbers: what is known of all designs from few, and which design to compute next.

A Gaussian process for each number, with a length of its own for each input, and noise that is fitted with them. The
knowledge gradient chooses the next design; joint draws say what is known of the best one, of a gain and of a front.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import islice
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve
from scipy.optimize import Bounds, minimize
from scipy.stats import qmc

from data_schemas import CompareError
from finray_calib.decide._gaussian_process import draw_normal, knowledge_gradient

Floats = NDArray[np.float64]
#: Matern's nu, equally likely. The first one is used in a search, the intervals hold both.
SMOOTHNESSES: Final = (2.5, 1.5)
Allowed = Callable[[Floats], bool]

#: Medians of lengths (of inputs from 0 to 1), amplitude and noise (of values of unit spread), and the standard
#: deviation of each logarithm. Wide: lengths from a fifth to four times an input's range, noise from 0.5 % to 1.6.
_LENGTH, _LENGTH_LN_SD = 0.6, 0.8
_AMPLITUDE, _AMPLITUDE_LN_SD = 1.0, 1.0
_NOISE, _NOISE_LN_SD = 0.08, 1.5
#: Variance of the unknown constant, of values of unit spread.
_CONSTANT: Final = 1.0
_JITTER: Final = 1e-8
#: Logarithms of hyperparameters stay within this many standard deviations of their prior.
_BOX_SD: Final = 4.0
#: Draws from which the ensemble is taken by their weights.
_PROPOSALS: Final = 128
_STEP: Final = 1e-4
#: Degrees of freedom of their distribution.
_FREEDOM: Final = 8.0
#: Designs between which the knowledge gradient chooses: all over the box, near the best, and very near it.
_NEAR: Final = ((0.12, 80), (0.04, 50), (0.012, 20))
_EVERYWHERE: Final = 150
#: Designs whose becoming the best is counted.
_RIVALS: Final = 64
#: Candidates from which the best design is sought by descent.
_STARTS: Final = 3
#: Points of the box that are tried for each design of the screen.
_TRIED_PER_DESIGN: Final = 64


@dataclass(frozen=True, eq=False)
class DesignEmulator:
    """What some computed designs say about one number of all designs.

    Attributes
    ----------
    inputs : ndarray, shape (N, D)
        Computed designs, each input from 0 to 1.
    values : ndarray, shape (N,)
        Their numbers, with noise.
    ln_parameters : ndarray, shape (D + 2,)
        Logarithms of the lengths, of the amplitude and of the noise, both over the spread of the values.
    smoothness : float
        Matern's nu: 5/2, or 3/2 for numbers whose slope has kinks.
    """

    inputs: Floats
    values: Floats
    ln_parameters: Floats
    smoothness: float = SMOOTHNESSES[0]

    @cached_property
    def centre(self) -> tuple[float, float]:
        """Mean and spread of the values, in their unit."""
        spread = float(self.values.std())
        return float(self.values.mean()), spread if spread > 0.0 else 1.0

    @cached_property
    def _solved(self) -> tuple[tuple[Floats, bool], Floats]:
        """Factor of the covariance of the values, and the weights of the mean."""
        centre, spread = self.centre
        covariance = self._kernel(self.inputs, self.inputs)
        covariance[np.diag_indices_from(covariance)] += np.exp(2 * self.ln_parameters[-1]) + _JITTER
        factor = cho_factor(covariance, lower=True)
        return factor, cho_solve(factor, (self.values - centre) / spread)

    @property
    def noise_sd(self) -> float:
        """Standard deviation of the noise, in the unit of the values."""
        return float(np.exp(self.ln_parameters[-1])) * self.centre[1]

    @property
    def left_out_error_rel(self) -> float:
        """Error at each design when it is left out, root mean square over the spread of the values (1: no use)."""
        factor, weights = self._solved
        inverse = np.diag(cho_solve(factor, np.eye(len(self.values))))
        return float(np.sqrt(np.mean((weights / inverse) ** 2)))

    def _kernel(self, first: Floats, second: Floats) -> Floats:
        lengths = np.exp(self.ln_parameters[:-2])
        square = np.zeros((len(first), len(second)))
        for k, length in enumerate(lengths):
            square += ((first[:, k, None] - second[:, k]) / length) ** 2
        return np.asarray(np.exp(2 * self.ln_parameters[-2]) * _matern(square, self.smoothness)[0] + _CONSTANT)

    def mean(self, at: Floats) -> Floats:
        """Return the expected number of designs (M, D), in the unit of the values."""
        centre, spread = self.centre
        return np.asarray(centre + spread * (self._kernel(at, self.inputs) @ self._solved[1]))

    def covariance(self, at: Floats, other: Floats | None = None) -> Floats:
        """Return the covariance of the numbers of designs (M, D) and other ones (K, D), without noise: (M, K)."""
        others = at if other is None else other
        across = cho_solve(self._solved[0], self._kernel(self.inputs, others))
        left = self._kernel(at, others) - self._kernel(at, self.inputs) @ across
        return np.asarray(self.centre[1] ** 2 * left)


def _matern(square: Floats, smoothness: float) -> tuple[Floats, Floats]:
    """Return the Matern correlation of squared scaled distances s, and minus twice its derivative by s."""
    scale = 2.0 * smoothness
    q = np.sqrt(scale * square)
    decay = np.exp(-q)
    if smoothness == SMOOTHNESSES[0]:
        return (1.0 + q + q * q / 3.0) * decay, scale / 3.0 * (1.0 + q) * decay
    return (1.0 + q) * decay, scale * decay


def fit_emulator(
    inputs: Floats, values: Floats, start: DesignEmulator | None = None, smoothness: float = SMOOTHNESSES[0]
) -> DesignEmulator:
    r"""Fit lengths, amplitude and noise of an emulator: the most probable ones.

    .. math:: y_i = c + a f(x_i) + n e_i, \quad \mathrm{cov}(f(x), f(x')) = (1 + q + q^2/3) e^{-q},
        \quad q^2 = 5 \sum_d (x_d - x'_d)^2 / l_d^2

    with lognormal priors of l (median 0.6 of an input's range), a and n, and c integrated. Valid for smooth numbers of
    at least D + 2 designs.

    Parameters
    ----------
    inputs : ndarray, shape (N, D)
        Each from 0 to 1.
    values : ndarray, shape (N,)
        Any unit; finite.
    start : DesignEmulator, optional
        Fitted to fewer of the same designs.
    smoothness : float
        Matern's nu, 5/2 or 3/2; the equation is that of 5/2.

    References
    ----------
    C. E. Rasmussen, C. K. I. Williams, Gaussian Processes for Machine Learning (2006), section 5.4.
    """
    middle, sd = _prior(inputs.shape[1])
    squares = [(column[:, None] - column) ** 2 for column in inputs.T]
    spread = float(values.std())
    scaled = (values - values.mean()) / (spread if spread > 0.0 else 1.0)
    first = middle if start is None else start.ln_parameters
    found = minimize(
        _negative_ln_posterior, first, (squares, scaled, smoothness), method="L-BFGS-B", jac=True,
        bounds=list(zip(middle - _BOX_SD * sd, middle + _BOX_SD * sd, strict=True)), options={"maxiter": 60},
    )  # fmt: skip
    return DesignEmulator(inputs, values, np.asarray(found.x), smoothness)


def _prior(count: int) -> tuple[Floats, Floats]:
    """Return median and standard deviation of the logarithms of the hyperparameters."""
    middle = np.log([*[_LENGTH] * count, _AMPLITUDE, _NOISE])
    return middle, np.array([*[_LENGTH_LN_SD] * count, _AMPLITUDE_LN_SD, _NOISE_LN_SD])


def _negative_ln_posterior(
    ln_parameters: Floats, squares: Sequence[Floats], scaled: Floats, smoothness: float
) -> tuple[float, Floats]:
    """Return minus the log posterior of hyperparameters, and its gradient."""
    middle, sd = _prior(len(squares))
    lengths, amplitude2, noise2 = np.exp(ln_parameters[:-2]), *np.exp(2.0 * ln_parameters[-2:])
    parts = [square / length**2 for square, length in zip(squares, lengths, strict=True)]
    correlated, steep = (amplitude2 * of_kernel for of_kernel in _matern(np.sum(parts, axis=0), smoothness))
    covariance = correlated + _CONSTANT
    covariance[np.diag_indices_from(covariance)] += noise2 + _JITTER
    factor = cho_factor(covariance, lower=True)
    weights = cho_solve(factor, scaled)
    pull = cho_solve(factor, np.eye(len(scaled))) - np.outer(weights, weights)
    gradient = np.array(
        [
            *[0.5 * np.sum(pull * steep * part) for part in parts],
            np.sum(pull * correlated),
            noise2 * np.trace(pull),
        ]
    )
    away = (ln_parameters - middle) / sd
    value = 0.5 * scaled @ weights + np.log(np.diag(factor[0])).sum() + 0.5 * away @ away
    return float(value), gradient + away / sd


_ENSEMBLE: Final = 24


def emulator_ensemble(fitted: DesignEmulator, rng: np.random.Generator) -> tuple[DesignEmulator, ...]:
    """Return emulators with smoothness and hyperparameters drawn from their posterior, which intervals then include.

    Drawn from Student's t about the most probable ones of each smoothness, with the curvature there, and taken by the
    ratio of posterior and proposal, with replacement.

    Parameters
    ----------
    fitted
        By :func:`fit_emulator`.
    rng
        Source of the draws.
    """
    centre, spread = fitted.centre
    scaled = (fitted.values - centre) / spread
    squares = [(column[:, None] - column) ** 2 for column in fitted.inputs.T]
    proposed, ln_weights = [], []
    for smoothness in SMOOTHNESSES:
        best = fit_emulator(fitted.inputs, fitted.values, fitted, smoothness)
        of_smoothness, weights = _proposals(best, squares, scaled, rng)
        proposed += [DesignEmulator(fitted.inputs, fitted.values, one, smoothness) for one in of_smoothness]
        ln_weights.append(weights)
    weights = np.concatenate(ln_weights)
    weights = np.exp(weights - weights.max())
    return tuple(proposed[k] for k in rng.choice(len(proposed), size=_ENSEMBLE, p=weights / weights.sum()))


def _proposals(
    best: DesignEmulator, squares: Sequence[Floats], scaled: Floats, rng: np.random.Generator
) -> tuple[Floats, Floats]:
    """Return draws of hyperparameters about the most probable ones, and the logarithms of their weights."""
    peak = best.ln_parameters
    middle, sd = _prior(len(squares))
    precision = np.empty((peak.size, peak.size))
    for k in range(peak.size):
        step = _STEP * np.eye(peak.size)[k]
        above, below = (
            _negative_ln_posterior(peak + way * step, squares, scaled, best.smoothness)[1] for way in (1.0, -1.0)
        )
        precision[k] = (above - below) / (2.0 * _STEP)
    eigenvalues, vectors = np.linalg.eigh((precision + precision.T) / 2.0)
    # no proposal is wider than the prior
    eigenvalues = np.maximum(eigenvalues, 1.0 / sd.max() ** 2)
    normal = rng.standard_normal((_PROPOSALS, peak.size))
    # heavier tails than a normal, so that no weight is huge
    normal *= np.sqrt(_FREEDOM / rng.chisquare(_FREEDOM, size=_PROPOSALS))[:, None]
    proposed = peak + (normal / np.sqrt(eigenvalues)) @ vectors.T
    proposed = np.clip(proposed, middle - _BOX_SD * sd, middle + _BOX_SD * sd)
    ln_weight = 0.5 * (_FREEDOM + peak.size) * np.log1p((normal**2).sum(axis=1) / _FREEDOM)
    ln_weight -= 0.5 * np.log(eigenvalues).sum()
    ln_weight -= [_negative_ln_posterior(one, squares, scaled, best.smoothness)[0] for one in proposed]
    return proposed, ln_weight


def joint_draws(ensemble: Sequence[DesignEmulator], at: Floats, draws: int, rng: np.random.Generator) -> Floats:
    """Return draws (draws, M) of the numbers of designs (M, D) together, as many from each emulator."""
    each = -(-draws // len(ensemble))
    found = [emulator.mean(at) + draw_normal(emulator.covariance(at), each, rng) for emulator in ensemble]
    return np.concatenate(found)[:draws]


def screening_designs(inputs: int, count: int, seed: int, allowed: Allowed | None = None) -> Floats:
    """Return the first designs to compute, (count, inputs): scrambled Sobol' points of the box that are allowed.

    Parameters
    ----------
    inputs
        Number of inputs D.
    count
        Of designs.
    seed
        Of the scrambling.
    allowed
        Tells whether a design (D,) can be built; it is asked once for each.

    Raises
    ------
    CompareError
        When less than one in 64 points is allowed.
    """
    exponent = int(np.ceil(np.log2(_TRIED_PER_DESIGN * count)))
    points = np.asarray(qmc.Sobol(inputs, seed=np.random.default_rng(seed)).random_base2(exponent))
    kept = np.array(list(islice((one for one in points if allowed is None or allowed(one)), count)))
    if len(kept) < count:
        raise CompareError(
            f"only {len(kept)} of {len(points)} tried designs within the limits can be built, which are too few; give "
            "narrower limits"
        )
    return kept[:count]


def next_design(
    emulators: Sequence[DesignEmulator], weights: Floats, rng: np.random.Generator, allowed: Allowed | None = None
) -> Floats:
    r"""Return the design (D,) to compute next: the largest knowledge gradient of the least weighted sum.

    .. math:: \max_x \; \min_{x'} \mu(x') - E_x[\min_{x'} \mu(x' \mid y(x))], \qquad \mu = \sum_k w_k \mu_k

    over candidates all over the box and near the best design so far. The emulators are independent of each other;
    smaller is better.

    Parameters
    ----------
    emulators
        One for each number, of the same designs.
    weights
        Of the numbers, (K,).
    rng
        Source of the candidates.
    allowed
        Tells whether a design (D,) can be built; asked of the best candidates only.
    """
    inputs = emulators[0].inputs

    def mean_of(at: Floats) -> Floats:
        return np.asarray(np.sum([w * e.mean(at) for w, e in zip(weights, emulators, strict=True)], axis=0))

    best = inputs[int(mean_of(inputs).argmin())]
    candidates = _candidates(best, rng)
    mean = mean_of(candidates)
    covariance = np.sum([w**2 * e.covariance(candidates) for w, e in zip(weights, emulators, strict=True)], axis=0)
    variance = np.maximum(np.diag(covariance), 0.0)
    noise = np.full(len(candidates), sum((w * e.noise_sd) ** 2 for w, e in zip(weights, emulators, strict=True)))
    rivals = np.argsort(mean - 2.0 * np.sqrt(variance))[:_RIVALS]
    gains = knowledge_gradient(-mean[rivals], covariance[rivals], variance, noise + _JITTER * variance.max())
    order = np.argsort(-gains, kind="stable")
    return np.asarray(next((candidates[k] for k in order if allowed is None or allowed(candidates[k])), best))


def _candidates(best: Floats, rng: np.random.Generator) -> Floats:
    """Return designs all over the box and near the best one; of the near ones some differ in a few inputs only."""
    near = []
    for sd, count in _NEAR:
        moved = rng.random((count, best.size)) < rng.choice([0.35, 1.0], size=(count, 1))
        near.append(best + moved * rng.normal(0.0, sd, (count, best.size)))
    return np.asarray(np.clip(np.concatenate([rng.random((_EVERYWHERE, best.size)), *near]), 0.0, 1.0))


def best_design(
    emulators: Sequence[DesignEmulator], weights: Floats, rng: np.random.Generator, allowed: Allowed | None = None
) -> Floats:
    """Return the design (D,) of the least expected weighted sum; it need not be a computed one.

    Found from the best of the computed designs and of candidates, by descent on the emulators' mean.

    Parameters
    ----------
    emulators, weights, rng, allowed
        As in :func:`next_design`.
    """
    inputs = emulators[0].inputs

    def mean_of(at: Floats) -> Floats:
        found = [w * e.mean(np.atleast_2d(at)) for w, e in zip(weights, emulators, strict=True)]
        return np.asarray(np.sum(found, axis=0))

    best = inputs[int(mean_of(inputs).argmin())]
    near = _candidates(best, rng)
    starts = np.concatenate([best[None], near[np.argsort(mean_of(near))[:_STARTS]]])
    bounds = Bounds(np.zeros(best.size), np.ones(best.size))

    def descended(start: Floats) -> Floats:
        def value(at: Floats) -> float:
            return float(mean_of(at)[0])

        return np.asarray(minimize(value, start, method="L-BFGS-B", bounds=bounds).x)

    ends = [descended(start) for start in starts]
    tried = np.concatenate([np.clip(ends, 0.0, 1.0), near, inputs])
    order = np.argsort(mean_of(tried), kind="stable")
    return next((tried[k] for k in order if allowed is None or allowed(tried[k])), best)


def near_front(values: Floats, rivals: Floats, tolerance: float) -> NDArray[np.bool_]:
    """Return which designs (M,) no rival beats: is as good in every number, and better by a tolerance in one.

    Parameters
    ----------
    values : ndarray, shape (M, K)
        Numbers, smaller is better.
    rivals : ndarray, shape (R, K)
    tolerance : float
        In the unit of the numbers. With 0 these are the designs that no rival dominates; of rivals as close as one
        likes each would then be on the front by chance only.
    """
    return np.array(
        [not bool(((rivals <= one).all(axis=1) & (rivals < one - tolerance).any(axis=1)).any()) for one in values]
    )


def main_effect(
    ensemble: Sequence[DesignEmulator], column: int, levels: Floats, others: Floats, rng: np.random.Generator
) -> Floats:
    """Return draws (draws, L) of a number's mean over all other inputs, at levels (L,) of one input.

    Parameters
    ----------
    ensemble
        By :func:`emulator_ensemble`; ten draws of each emulator.
    column
        The input.
    levels
        From 0 to 1.
    others
        Designs (S, D) whose other inputs are averaged over.
    rng
        Source of the draws.
    """
    at = np.repeat(others[None], len(levels), axis=0)
    at[:, :, column] = levels[:, None]
    flat = at.reshape(-1, others.shape[1])
    average = np.kron(np.eye(len(levels)), np.full(len(others), 1.0 / len(others)))
    found = []
    for emulator in ensemble:
        covariance = average @ emulator.covariance(flat) @ average.T
        found.append(average @ emulator.mean(flat) + draw_normal(covariance, 10, rng))
    return np.concatenate(found)
