"""The likelihood of band values, and every maximum of the posterior under it.

The likelihood knows noise, the imperfections of the rig, and the discrepancy of the paint. The maxima are sought by
compiled Levenberg-Marquardt from many starts; NLopt finishes each end.
"""

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, replace

import nlopt
import numpy as np
from numpy.typing import NDArray

from data_schemas import FitError
from finray_calib.fit._band_data import BandData, Reference, decisive_leaks
from finray_calib.fit._prior import NO_DISCREPANCY, Discrepancy, EmissionPrior
from finray_calib.fit.posterior_kernel import (
    COVARIANCE,
    LOG_LIKELIHOOD,
    LOG_POSTERIOR,
    NORMAL,
    PRECISION,
    PREDICTION,
    ROW,
    TOP,
    Problem,
    evaluate,
)
from finray_calib.spectra import BAND_NODES, EmissionFamily, machine_threads, skew_shape_table

FloatArray = NDArray[np.float64]

_HESSIAN_STEP = 1e-3  # in prior standard deviations: truncation 1e-6, rounding 1e-9 of the curvature
_CLIMB_STEPS = 60
_SINGULAR = 1e100  # no value is known that well: a pivot was zero
_ROWS_WORTH_A_THREAD = 2500  # some 20 ms; for less, a busy second core costs more than an idle one gains
_LENGTHS_APART = 4.0  # bands further apart than four correlation lengths share no discrepancy (e^-8)


class LogPosterior:
    """Log posterior density of parameter rows: y ~ N(mu(theta), S + U U^T + discrepancy(theta)).

    Theta is the family's parameters, the logarithm of the reflectance at the laser and, when the filters leak, the
    logarithm of their blocking and the own leaks of the filters that decide, see :func:`decisive_leaks`.

    Parameters
    ----------
    data
        Measured band values.
    family
        Family of emission curves.
    prior
        Prior of the quantities common to all families.
    discrepancy
        How far the paint may leave the family.
    reference
        Where the filters' tolerances act, see :meth:`BandData.imperfections`.
    """

    def __init__(
        self,
        data: BandData,
        family: EmissionFamily,
        prior: EmissionPrior,
        discrepancy: Discrepancy = NO_DISCREPANCY,
        reference: Reference | None = None,
    ) -> None:
        self.data, self.family, self.discrepancy, self._paints = data, family, discrepancy, prior
        self.has_blocking = bool((data.weights.leaked_laser > 0).any() or (data.weights.leaked_emission > 0).any())
        shapes, bands = len(family.parameter_names), reference.sampled_leaks if reference else ()
        self.own_leaks = {band: shapes + 2 + i for i, band in enumerate(bands)}
        self.prior = prior.of(family, with_blocking=self.has_blocking, own_leaks=_leaks_by_name(data, bands))
        self.imperfections = data.imperfections(reference)
        self.problem = _problem(self)

    def __call__(self, theta: FloatArray) -> FloatArray:
        """Return the log posterior density (up to the evidence) of (n, D) rows, (n,)."""
        return self._by_row(LOG_POSTERIOR, theta, 1)[:, 0]

    def log_likelihood(self, theta: FloatArray) -> FloatArray:
        """Return ln p(y | theta) of (n, D) rows inside the prior, (n,)."""
        return self._by_row(LOG_LIKELIHOOD, theta, 1)[:, 0]

    def predict_usable(self, theta: FloatArray) -> FloatArray:
        """Return the predicted usable band values of (n, D) rows, without discrepancy, (n, K)."""
        return self._by_row(PREDICTION, theta, self.data.kept.size)

    def covariances(self, theta: FloatArray) -> FloatArray:
        """Return the covariance of the usable band values at (n, D) rows, (n, K, K)."""
        return self._matrices(COVARIANCE, theta)

    def precisions(self, theta: FloatArray) -> FloatArray:
        """Return the inverse covariance of the usable band values at (n, D) rows, (n, K, K).

        Raises
        ------
        FitError
            When a covariance is singular.
        """
        found = self._matrices(PRECISION, theta)
        if not (np.abs(found) < _SINGULAR).all():
            raise FitError(
                "the covariance of the band values is singular, because two values carry the same information "
                "without independent noise; state the uncertainties of these values, or leave one of them out"
            )
        return found

    def _matrices(self, quantity: int, theta: FloatArray) -> FloatArray:
        """Return a compiled matrix of many rows, (n, K, K)."""
        size = self.data.kept.size
        return np.reshape(self._by_row(quantity, theta, size**2), (-1, size, size))

    def _by_row(self, quantity: int, theta: FloatArray, columns: int, steps: int = 0) -> FloatArray:
        """Return a compiled quantity of many rows, (n, columns), computed by several threads where that pays."""
        threads = max(1, min(machine_threads(), len(theta) // _ROWS_WORTH_A_THREAD))
        theta, out = np.ascontiguousarray(theta), np.empty((len(theta), columns))
        if threads == 1:
            evaluate(self.problem, theta, quantity, steps, out)
            return out
        with ThreadPoolExecutor(threads) as pool:
            parts = zip(np.array_split(theta, threads), np.array_split(out, threads), strict=True)
            for done in [pool.submit(evaluate, self.problem, rows, quantity, steps, part) for rows, part in parts]:
                done.result()
        return out

    def climb(self, start: FloatArray) -> FloatArray:
        """Return the local maximum that Levenberg-Marquardt steps from `start` (D,) reach, (D,)."""
        return np.asarray(self._by_row(TOP, start[None], start.size, _CLIMB_STEPS)[0])

    def reference_at(self, theta: FloatArray) -> Reference:
        """Return the emission, reflectance and leaks of one parameter vector (D,), and which leaks decide there."""
        data, p = self.data, self.problem
        curve = self.family.curves(theta[None], data.weights.wavelength_nm)[0]
        reference = Reference(curve, float(np.exp(theta[p.shapes])), self.leaks(theta[None])[0])
        if data.tolerances is None or not self.has_blocking:
            return reference
        # a leak that was found to be low still decides: judged by what it was believed to be
        believed = replace(reference, leak=np.exp(theta[p.shapes + 1]) * data.leak_mean)
        rest = data.covariance_without_tile(data.kept) + self.covariances(theta[None])[0] - p.covariance[0]
        decisive = decisive_leaks(data.imperfections(believed), rest, data.weights.bands)
        return replace(reference, sampled_leaks=decisive)

    def refined(self, theta: FloatArray) -> tuple["LogPosterior", FloatArray]:
        """Return the posterior whose tolerances act at `theta` (D,), and the maximum that it reaches from there."""
        posterior = LogPosterior(self.data, self.family, self._paints, self.discrepancy, self.reference_at(theta))
        return posterior, posterior.climb(posterior.carried(theta[None], self.prior.names)[0])

    def carried(self, theta: FloatArray, names: Sequence[str]) -> FloatArray:
        """Return (n, D) rows of these parameters from rows of others: what `names` lacks is at its prior mean."""
        rows = np.tile(self.prior.mean, (len(theta), 1))
        for column, name in enumerate(self.prior.names):
            if name in names:
                rows[:, column] = theta[:, names.index(name)]
        return rows

    def leaks(self, theta: FloatArray) -> FloatArray:
        """Return the multiplier of the nominal leak of all rows, (n, N): of an own leak that is not sampled its mean.

        One without leak.
        """
        data = self.data
        if not self.has_blocking:
            return np.ones((len(theta), data.y.size))
        own = np.tile(data.leak_mean, (len(theta), 1))
        for band, column in self.own_leaks.items():
            rows = data.weights.band_index == band
            own[:, rows] = np.exp(data.leak_sd[rows] * theta[:, column, None])
        return np.asarray(np.exp(theta[:, self.problem.shapes + 1, None]) * own)

    def information(self, theta: FloatArray) -> FloatArray:
        """Return minus the Hessian of the log posterior at one theta, (D, D), made positive definite.

        Central differences of the density. In prior standard deviations no direction is allowed less than a
        quarter of the prior's own precision, so that the inverse is a covariance even at a saddle.
        """
        prior, size = self.prior, self.prior.size
        step = np.full(size, _HESSIAN_STEP) * prior.sd
        theta = np.clip(theta, prior.low + 2.1 * step, prior.high - 2.1 * step)
        first, second = np.tril_indices(size)
        unit = np.diag(step)
        moves = [a * unit[first] + b * unit[second] for a, b in ((1, 1), (1, -1), (-1, 1), (-1, -1))]
        values = self((theta + np.concatenate(moves)).reshape(-1, size)).reshape(4, -1)
        curvature = -(values[0] - values[1] - values[2] + values[3]) / (4 * _HESSIAN_STEP**2)
        scaled = np.zeros((size, size))
        scaled[first, second] = scaled[second, first] = np.nan_to_num(curvature)
        roots, directions = np.linalg.eigh(scaled)
        scaled = (directions * np.maximum(roots, 0.25)) @ directions.T
        return np.asarray(scaled / np.outer(prior.sd, prior.sd))


def _leaks_by_name(data: BandData, bands: Sequence[int]) -> dict[str, float]:
    """Return the standard deviation of ln(own leak) by filter name."""
    if data.tolerances is None:
        return {}
    first_row = np.searchsorted(data.weights.band_index, bands)
    return {data.tolerances.filter_names[b]: float(data.leak_sd[r]) for b, r in zip(bands, first_row, strict=True)}


def _problem(posterior: LogPosterior) -> Problem:
    """Return the arrays of the compiled functions."""
    data, prior, discrepancy = posterior.data, posterior.prior, posterior.discrepancy
    kept, weights = data.kept, data.weights
    rule = data.quadrature
    u, common = posterior.imperfections, data.common_rel[:, kept]
    nodes = rule.nodes_nm.ravel()
    centres = rule.nodes_nm.mean(axis=1)
    near = np.abs(centres[:, None] - centres) < _LENGTHS_APART * discrepancy.length_nm
    emits = np.bincount(weights.band_index, np.abs(rule.in_band).sum(axis=1)) > 0
    near &= emits[:, None] & emits
    rows, normals = np.zeros(kept.size, ROW), np.zeros(prior.size, NORMAL)
    rows["band"], rows["y"], rows["laser"] = (
        weights.band_index[kept],
        data.y.ravel()[kept],
        weights.reflected_laser[kept],
    )
    lit = np.flatnonzero(weights.level_share)
    level = np.zeros(lit.size, ROW)
    level["band"], level["laser"] = weights.band_index[lit], weights.level_share[lit]
    for table, of in ((rows, kept), (level, lit)):
        table["leaked_laser"], table["leaked_white"] = weights.leaked_laser[of], weights.leaked_white[of]
        table["leak_mean"], table["leak_sd"] = data.leak_mean[of], data.leak_sd[of]
        table["leak_at"] = [posterior.own_leaks.get(band, 0) for band in table["band"]]
    for name in NORMAL.names or ():
        normals[name] = getattr(prior, name)
    return Problem(
        family=posterior.family.code,
        shapes=len(posterior.family.parameter_names),
        has_blocking=posterior.has_blocking,
        table=skew_shape_table(),
        points_nm=np.concatenate([nodes, rule.grid_nm]),
        rows=rows,
        level=level,
        weights=np.concatenate([rule.in_band, rule.out_of_band, rule.leaked], axis=1)[kept],
        covariance=np.stack([data.covariance_without_tile(kept) + u @ u.T, common.T @ common]),
        kernel=discrepancy.smooth_kernel(nodes, nodes)
        * np.repeat(np.repeat(near, BAND_NODES, axis=0), BAND_NODES, axis=1),
        floor_rel=discrepancy.floor_rel,
        reabsorption_rel=discrepancy.reabsorption_rel,
        prior=normals,
        ln_prior_norm=prior.ln_norm,
    )


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
