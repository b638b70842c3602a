"""Every maximum of the posterior, found by NLopt from many starting points."""

from contextlib import suppress
from dataclasses import dataclass

import nlopt
import numpy as np
from numpy.typing import NDArray

from finray_calib.fit.likelihood import LogPosterior

FloatArray = NDArray[np.float64]

_DRAWS = 1024
_STARTS_PER_STRATUM = 2
_MODE_STRATA = 4
_EVALUATIONS = 400
_GRADIENT_STEP = 1e-5  # in prior standard deviations
_BOX_SD = 8.0  # box of the parameters without truncation: nothing within reach of any data lies outside
_SAME_MAXIMUM = 1.0  # in posterior standard deviations
_KEEP_WITHIN = 25.0  # nats below the best; a lower maximum holds no mass that a finite chain could see


@dataclass(frozen=True, slots=True)
class Maxima:
    """Distinct local maxima of a posterior, best first.

    Attributes
    ----------
    theta
        (k, 6) parameters.
    log_posterior
        (k,) log posterior density.
    information
        (k, 6, 6) expected information plus prior precision; the inverse is the Laplace covariance.
    """

    theta: FloatArray
    log_posterior: FloatArray
    information: FloatArray

    @property
    def ln_laplace_mass(self) -> FloatArray:
        """Log of the posterior mass of each maximum in the Laplace approximation, up to a constant, (k,)."""
        return np.asarray(self.log_posterior - 0.5 * np.linalg.slogdet(self.information)[1])


def find_maxima(log_posterior: LogPosterior, rng: np.random.Generator) -> Maxima:
    """Return all distinct maxima that a stratified multi-start search finds.

    Prior draws are scaled to the data (height from the brightest band, reflectance from the excitation band);
    the best of each stratum of mode and sign of skewness start NLopt's SLSQP in prior standard deviations.
    Maxima closer than one posterior standard deviation are one; those 25 nats below the best are dropped.

    Parameters
    ----------
    log_posterior
        Density to climb.
    rng
        Source of the starting points.
    """
    starts = starting_points(log_posterior, rng)
    ends = [_climb(log_posterior, start) for start in starts]
    ends.sort(key=lambda end: -end[1])
    kept: list[tuple[FloatArray, float, FloatArray]] = []
    for theta, value in ends:
        if value < ends[0][1] - _KEEP_WITHIN:
            break
        if all(_distance(theta - other, precision) > _SAME_MAXIMUM for other, _, precision in kept):
            kept.append((theta, value, log_posterior.information(theta)))
    thetas, values, informations = zip(*kept, strict=True)
    return Maxima(np.array(thetas), np.array(values), np.array(informations))


def starting_points(log_posterior: LogPosterior, rng: np.random.Generator) -> FloatArray:
    """Return (n, 6) starting points: the best scaled prior draws of each stratum of mode and skewness sign."""
    prior, data = log_posterior.prior, log_posterior.data
    theta = prior.draw(_DRAWS, rng)
    kept, y = data.kept, data.y.ravel()[data.kept]
    excitation = data.weights.is_excitation[kept]
    predicted = log_posterior.predict_usable(theta)
    shift = np.zeros((_DRAWS, 2))
    for column, rows in enumerate((~excitation, excitation)):
        if rows.any():
            brightest = max(float(y[rows].max()), np.finfo(float).tiny)
            shift[:, column] = np.log(brightest / predicted[:, rows].max(axis=1))
    limit = _BOX_SD * prior.sd[3:5]
    theta[:, 3:5] = np.clip(theta[:, 3:5] + shift, prior.mean[3:5] - limit, prior.mean[3:5] + limit)
    order = np.argsort(-log_posterior(theta))
    edges = np.linspace(prior.mode_low_nm, prior.mode_high_nm, _MODE_STRATA + 1)[1:-1]
    stratum = 2 * np.digitize(theta[order, 0], edges) + (theta[order, 2] > 0)
    best = [order[stratum == s][:_STARTS_PER_STRATUM] for s in range(2 * _MODE_STRATA)]
    return np.asarray(theta[np.concatenate(best)])


def _climb(log_posterior: LogPosterior, start: FloatArray) -> tuple[FloatArray, float]:
    """Return the maximum reached from `start` and its log posterior density."""
    prior = log_posterior.prior
    scale, dimension = prior.sd, start.size
    steps = np.vstack([np.zeros(dimension), np.eye(dimension), -np.eye(dimension)]) * _GRADIENT_STEP
    low = np.maximum((prior.low - prior.mean) / scale, -_BOX_SD) + _GRADIENT_STEP
    high = np.minimum((prior.high - prior.mean) / scale, _BOX_SD) - _GRADIENT_STEP

    best_z, best_value = np.clip((start - prior.mean) / scale, low, high), -np.inf

    def density(z: FloatArray, gradient: FloatArray) -> float:
        nonlocal best_z, best_value
        values = log_posterior(prior.mean + (z + steps) * scale)
        if gradient.size:
            gradient[:] = (values[1 : dimension + 1] - values[dimension + 1 :]) / (2 * _GRADIENT_STEP)
        if values[0] > best_value:
            best_z, best_value = z.copy(), float(values[0])
        return float(values[0])

    search = nlopt.opt(nlopt.LD_SLSQP, dimension)
    search.set_max_objective(density)
    search.set_lower_bounds(low)
    search.set_upper_bounds(high)
    search.set_ftol_abs(1e-6)
    search.set_maxeval(_EVALUATIONS)
    with suppress(nlopt.RoundoffLimited, nlopt.runtime_error):  # a line search that stalls has still climbed
        search.optimize(best_z)
    return prior.mean + best_z * scale, best_value


def _distance(difference: FloatArray, information: FloatArray) -> float:
    """Return the Mahalanobis distance."""
    return float(np.sqrt(difference @ information @ difference))
