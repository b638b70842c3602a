"""Every maximum of the posterior: compiled Levenberg-Marquardt from many starts, each end finished by NLopt."""

from contextlib import suppress
from dataclasses import dataclass

import nlopt
import numpy as np
from numpy.typing import NDArray

from finray_calib.fit._likelihood import LogPosterior

FloatArray = NDArray[np.float64]

_DRAWS = 512
_STARTS_PER_STRATUM = 2
_MODE_STRATA = 4
_EVALUATIONS = 60
_CONFIRMING_EVALUATIONS = 8000
_FIRST_STEP = 0.1  # in prior standard deviations, for the search without gradients
_GRADIENT_STEP = 1e-5  # in prior standard deviations
_BOX_SD = 8.0  # box of the parameters without truncation: nothing within reach of any data lies outside
_SAME_MAXIMUM = 1.0  # in posterior standard deviations
_SURELY_SAME = 0.05  # in prior standard deviations: ends this close need no curvature to be one
_WAY_POINTS = 33
_LEAST_DIP = 0.1  # nats between two maxima: a shallower dip separates nothing that draws could tell apart
_LEAST = -1e12  # nats: stands in for minus infinity, whose differences are not numbers
_KEEP_WITHIN = 25.0  # nats below the best; a lower maximum holds no mass that a finite sample could see


@dataclass(frozen=True, slots=True)
class Maxima:
    """Distinct local maxima of a posterior, best first.

    Attributes
    ----------
    theta
        (k, D) parameters.
    log_posterior
        (k,) log posterior density.
    information
        (k, D, D) minus the Hessian; the inverse is the Laplace covariance.
    """

    theta: FloatArray
    log_posterior: FloatArray
    information: FloatArray

    @property
    def ln_laplace_mass(self) -> FloatArray:
        """Log of the posterior mass of each maximum in the Laplace approximation, (k,)."""
        size = self.theta.shape[1]
        curvature = np.linalg.slogdet(self.information)[1]
        return np.asarray(self.log_posterior + 0.5 * size * np.log(2 * np.pi) - 0.5 * curvature)


def find_maxima(log_posterior: LogPosterior, rng: np.random.Generator, starts: FloatArray | None = None) -> Maxima:
    """Return all distinct maxima that a stratified multi-start search finds.

    Prior draws are scaled to the data (height from the brightest band, reflectance from the excitation band); the
    best of each stratum of mode and sign of skewness start Levenberg-Marquardt; NLopt's SLSQP finishes each distinct
    end on the exact density, and a search without gradients confirms every maximum beyond the first. Maxima closer
    than one posterior standard deviation, or without a dip between them, are one; those 25 nats below the best are
    dropped.

    Parameters
    ----------
    log_posterior
        Density to climb.
    rng
        Source of the starting points.
    starts
        (n, D) starting points to use instead, for instance the ends of a search on nearly the same density.
    """
    prior = log_posterior.prior
    starts = starting_points(log_posterior, rng) if starts is None else starts
    tops = np.array([log_posterior.climb(start) for start in starts])
    ends = sorted(zip(tops, log_posterior(tops), strict=True), key=lambda end: -end[1])
    kept: list[tuple[FloatArray, float, FloatArray]] = []
    seen: list[FloatArray] = []
    for theta, value in ends:
        if value < ends[0][1] - _KEEP_WITHIN or not np.isfinite(value):
            break
        if any((np.abs(theta - other) < _SURELY_SAME * prior.sd).all() for other in seen):
            continue
        seen.append(theta)
        if any(_distance(theta - other, precision) < _SAME_MAXIMUM for other, _, precision in kept):
            continue
        end, best = _finish(log_posterior, theta, nlopt.LD_SLSQP, _EVALUATIONS)
        if kept and _is_new(log_posterior, end, kept):  # a gradient search can stall on a curved ridge
            end, best = _finish(log_posterior, end, nlopt.LN_NELDERMEAD, _CONFIRMING_EVALUATIONS)
        if _is_new(log_posterior, end, kept):
            kept.append((end, best, log_posterior.information(end)))
    kept.sort(key=lambda maximum: -maximum[1])
    thetas, values, informations = zip(*kept, strict=True)
    return Maxima(np.array(thetas), np.array(values), np.array(informations))


def starting_points(log_posterior: LogPosterior, rng: np.random.Generator) -> FloatArray:
    """Return (n, D) starting points: the best scaled prior draws of each stratum of mode and skewness sign."""
    prior, data = log_posterior.prior, log_posterior.data
    theta = prior.draw(_DRAWS, rng)
    kept, y = data.kept, data.y.ravel()[data.kept]
    excitation = data.weights.is_excitation[kept]
    predicted = log_posterior.predict_usable(theta)
    for column, rows in ((2, ~excitation), (log_posterior.problem.shapes, excitation)):
        if rows.any():
            brightest = max(float(y[rows].max()), np.finfo(float).tiny)
            limit = _BOX_SD * prior.sd[column]
            moved = theta[:, column] + np.log(brightest / predicted[:, rows].max(axis=1))
            theta[:, column] = np.clip(moved, prior.mean[column] - limit, prior.mean[column] + limit)
    order = np.argsort(-log_posterior(theta))
    edges = np.linspace(prior.low[0], prior.high[0], _MODE_STRATA + 1)[1:-1]
    stratum = 2 * np.digitize(theta[order, 0], edges) + (theta[order, 3] > prior.mean[3])
    best = [order[stratum == s][:_STARTS_PER_STRATUM] for s in range(2 * _MODE_STRATA)]
    return np.asarray(theta[np.concatenate(best)])


def _finish(
    log_posterior: LogPosterior, start: FloatArray, algorithm: int, evaluations: int
) -> tuple[FloatArray, float]:
    """Return the maximum that NLopt reaches from `start` and its log posterior density."""
    prior = log_posterior.prior
    scale, dimension = prior.sd, start.size
    steps = np.vstack([np.zeros(dimension), np.eye(dimension), -np.eye(dimension)]) * _GRADIENT_STEP
    low = np.maximum((prior.low - prior.mean) / scale, -_BOX_SD) + _GRADIENT_STEP
    high = np.minimum((prior.high - prior.mean) / scale, _BOX_SD) - _GRADIENT_STEP
    best_z, best_value = np.clip((start - prior.mean) / scale, low, high), -np.inf

    def density(z: FloatArray, gradient: FloatArray) -> float:
        nonlocal best_z, best_value
        rows = steps if gradient.size else steps[:1]
        values = np.maximum(log_posterior(prior.mean + (z + rows) * scale), _LEAST)
        if gradient.size:
            gradient[:] = (values[1 : dimension + 1] - values[dimension + 1 :]) / (2 * _GRADIENT_STEP)
        if values[0] > best_value:
            best_z, best_value = z.copy(), float(values[0])
        return float(values[0])

    search = nlopt.opt(algorithm, dimension)
    search.set_max_objective(density)
    search.set_lower_bounds(low)
    search.set_upper_bounds(high)
    search.set_ftol_abs(1e-7)
    search.set_maxeval(evaluations)
    search.set_initial_step(_FIRST_STEP)
    with suppress(nlopt.RoundoffLimited, nlopt.runtime_error):  # a line search that stalls has still climbed
        search.optimize(best_z)
    return prior.mean + best_z * scale, best_value


def _is_new(log_posterior: LogPosterior, end: FloatArray, kept: list[tuple[FloatArray, float, FloatArray]]) -> bool:
    """Return whether an end is far from every kept maximum, with a dip of the density between them."""
    for other, _, precision in kept:
        way = log_posterior(end + np.linspace(0.0, 1.0, _WAY_POINTS)[:, None] * (other - end))
        dips = way.min() < min(way[0], way[-1]) - _LEAST_DIP
        if not dips or _distance(end - other, precision) <= _SAME_MAXIMUM:
            return False
    return True


def _distance(difference: FloatArray, information: FloatArray) -> float:
    """Return the Mahalanobis distance."""
    return float(np.sqrt(difference @ information @ difference))
