"""The likelihood of band values with noise, the imperfections of the rig, and the discrepancy of the paint."""

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from data_schemas import FitError
from finray_calib.fit._band_data import LEAST_BANDS, BandData, Reference, decisive_leaks
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

__all__ = ["LEAST_BANDS", "BandData", "LogPosterior"]

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
                "the covariance of the band values is singular: two values carry the same information without noise of "
                "their own; state their uncertainties, or leave one of them out"
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
        rest = data.covariance[np.ix_(data.kept, data.kept)] + self.covariances(theta[None])[0] - p.covariance
        decisive = decisive_leaks(data.imperfections(believed), rest, data.weights.bands)
        return replace(reference, sampled_leaks=decisive)

    def refined(self, theta: FloatArray) -> tuple["LogPosterior", FloatArray]:
        """Return the posterior whose tolerances act at `theta` (D,), and the maximum that it reaches from there."""
        reference = self.reference_at(theta)
        posterior = LogPosterior(self.data, self.family, self._paints, self.discrepancy, reference)
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
    u = posterior.imperfections
    covariance = data.covariance[np.ix_(kept, kept)] + u @ u.T
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
    rows["leaked_laser"], rows["leaked_white"] = weights.leaked_laser[kept], weights.leaked_white[kept]
    rows["leak_mean"], rows["leak_sd"] = data.leak_mean[kept], data.leak_sd[kept]
    rows["leak_at"] = [posterior.own_leaks.get(band, 0) for band in rows["band"]]
    for name in NORMAL.names or ():
        normals[name] = getattr(prior, name)
    return Problem(
        family=posterior.family.code,
        shapes=len(posterior.family.parameter_names),
        has_blocking=posterior.has_blocking,
        table=skew_shape_table(),
        points_nm=np.concatenate([nodes, rule.grid_nm]),
        rows=rows,
        weights=np.concatenate([rule.in_band, rule.out_of_band, rule.leaked], axis=1)[kept],
        covariance=covariance,
        kernel=discrepancy.smooth_kernel(nodes, nodes)
        * np.repeat(np.repeat(near, BAND_NODES, axis=0), BAND_NODES, axis=1),
        floor_rel=discrepancy.floor_rel,
        reabsorption_rel=discrepancy.reabsorption_rel,
        prior=normals,
        ln_prior_norm=prior.ln_norm,
    )
