"""The likelihood of band values with noise, the imperfections of the rig, and the discrepancy of the paint."""

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from data_schemas.errors import FitError
from finray_calib.fit.discrepancy import NO_DISCREPANCY, Discrepancy
from finray_calib.fit.nuisances import Reference, calibration_columns, decisive_leaks, tolerance_columns
from finray_calib.fit.posterior_kernel import Problem, TruncatedNormals, climb, covariances, log_posterior, predictions
from finray_calib.fit.prior import EmissionPrior
from finray_calib.spectra.band_quadrature import BandQuadrature, band_quadrature
from finray_calib.spectra.band_tolerances import BandTolerances
from finray_calib.spectra.band_weights import EmissionWeights, read_only
from finray_calib.spectra.compiled import machine_threads
from finray_calib.spectra.emission_families import EmissionFamily, tables

FloatArray = NDArray[np.float64]

LEAST_BANDS = 4
"""Fewest bands with a usable channel: a mode, a width, a skewness and a height need as many."""

_ASYMMETRY_REL = 1e-6  # of the two standard deviations: far above rounding, far below what a fit could feel
_HESSIAN_STEP = 1e-3  # in prior standard deviations: truncation 1e-6, rounding 1e-9 of the curvature
_CLIMB_STEPS = 60
_ROWS_WORTH_A_THREAD = 500  # some milliseconds, against a tenth of one to start a thread
_LENGTHS_APART = 4.0  # bands further apart than four correlation lengths share no discrepancy (e^-8)


@dataclass(frozen=True, slots=True)
class BandData:
    """Normalised band values of one region or pixel, ready to fit.

    Attributes
    ----------
    y
        (B, C) normalised band values, dimensionless; may be NaN where not usable.
    covariance
        (B C, B C) measurement covariance of y in band-major order, without the calibration error.
    usable
        (B, C) False for saturated or lost entries.
    weights
        Weights of the rig with B C rows.
    band_calibration_rel
        Relative standard uncertainty of each band's calibration, common to its channels.
    tolerances
        Tolerances of the filters' centre, width and blocking; perfectly known filters when None.
    quadrature
        Few-node rule of the weights.

    Raises
    ------
    FitError
        When shapes disagree, usable values are not finite, fewer than four bands are usable, or the
        covariance is not symmetric positive definite.
    """

    y: FloatArray
    covariance: FloatArray
    usable: NDArray[np.bool_]
    weights: EmissionWeights
    band_calibration_rel: float = 0.01
    tolerances: BandTolerances | None = None
    quadrature: BandQuadrature = field(init=False)

    def __post_init__(self) -> None:
        rows = self.weights.band_index.size
        if self.y.size != rows or self.usable.shape != self.y.shape or self.covariance.shape != (rows, rows):
            raise FitError(
                f"band data: y {self.y.shape}, usable {self.usable.shape} and covariance {self.covariance.shape} do "
                f"not fit the rig's {rows} band values; y and usable must be bands x channels"
            )
        bands = int(self.usable.any(axis=1).sum())
        if bands < LEAST_BANDS:
            raise FitError(
                f"band data: only {bands} bands have a usable channel, at least {LEAST_BANDS} are needed; "
                "repeat the saturated or lost bands"
            )
        if not np.isfinite(self.y[self.usable]).all():
            raise FitError("band data: usable band values are NaN or infinite; mark them as not usable")
        if not 0 <= self.band_calibration_rel < 1:
            raise FitError(
                f"band data: band_calibration_rel {self.band_calibration_rel:g} must be 0 or more and below 1"
            )
        kept = self.usable.ravel()
        measured = self.covariance[np.ix_(kept, kept)]
        if not (np.isfinite(measured).all() and _is_symmetric(measured)):
            raise FitError("band data: the covariance must be finite and symmetric over the usable entries")
        try:
            np.linalg.cholesky(measured)
        except np.linalg.LinAlgError:
            raise FitError(
                "band data: the covariance is not positive definite over the usable entries; give every band "
                "value a variance of its own (read noise at least)"
            ) from None
        for name in ("y", "covariance", "usable"):
            object.__setattr__(self, name, read_only(getattr(self, name)))
        object.__setattr__(self, "quadrature", band_quadrature(self.weights))

    def without_band(self, band: int) -> "BandData":
        """Return the data with one band left out.

        Raises
        ------
        FitError
            When fewer than four bands remain.
        """
        usable = self.usable.copy()
        usable[band] = False
        return replace(self, usable=usable)

    @property
    def kept(self) -> NDArray[np.int64]:
        """Rows of the usable entries in band-major order."""
        return np.flatnonzero(self.usable.ravel())

    @property
    def leak_sd(self) -> FloatArray:
        """Standard deviation of ln(leak) of each row's filter around the common one, (N,)."""
        return np.zeros(self.y.size) if self.tolerances is None else self.tolerances.blocking_sd

    @property
    def leak_mean(self) -> FloatArray:
        """Mean over median of each row's own leak, (N,): a log-normal's mean lies above its median."""
        return np.asarray(np.exp(self.leak_sd**2 / 2))

    def imperfections(self, reference: Reference | None = None) -> FloatArray:
        """Return the imperfection columns U of the usable rows, (K, M).

        Parameters
        ----------
        reference
            The emission at which the filters' tolerances act; calibration errors alone when None.
        """
        y = np.nan_to_num(self.y.ravel())
        columns = [calibration_columns(y, self.weights, self.band_calibration_rel)]
        if reference is not None and self.tolerances is not None:
            columns.append(tolerance_columns(reference, self.weights, self.tolerances))
        return np.concatenate(columns, axis=1)[self.kept]


def _is_symmetric(covariance: FloatArray) -> bool:
    """Whether C_ij and C_ji agree, relative to sqrt(C_ii C_jj)."""
    sd = np.sqrt(np.maximum(np.diagonal(covariance), 0.0))
    return bool((np.abs(covariance - covariance.T) <= _ASYMMETRY_REL * np.outer(sd, sd)).all())


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
        return self._by_row(lambda rows: log_posterior(self.problem, rows, True), theta)

    def log_likelihood(self, theta: FloatArray) -> FloatArray:
        """Return ln p(y | theta) of (n, D) rows inside the prior, (n,)."""
        return self._by_row(lambda rows: log_posterior(self.problem, rows, False), theta)

    def predict_usable(self, theta: FloatArray) -> FloatArray:
        """Return the predicted usable band values of (n, D) rows, without discrepancy, (n, K)."""
        return self._by_row(lambda rows: predictions(self.problem, rows), theta)

    def covariances(self, theta: FloatArray) -> FloatArray:
        """Return the covariance of the usable band values at (n, D) rows, (n, K, K)."""
        return self._by_row(lambda rows: covariances(self.problem, rows), theta)

    def _by_row(self, compiled_function: Callable[[FloatArray], FloatArray], theta: FloatArray) -> FloatArray:
        """Return a compiled function of many rows, computed by several threads where that pays."""
        threads = min(machine_threads(), len(theta) // _ROWS_WORTH_A_THREAD)
        theta = np.ascontiguousarray(theta)
        if threads < 2:
            return np.asarray(compiled_function(theta))
        with ThreadPoolExecutor(threads) as pool:
            return np.concatenate(list(pool.map(compiled_function, np.array_split(theta, threads))))

    def climb(self, start: FloatArray) -> FloatArray:
        """Return the local maximum that Levenberg-Marquardt steps from `start` (D,) reach, (D,)."""
        return np.asarray(climb(self.problem, np.ascontiguousarray(start), _CLIMB_STEPS))

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
    factor = np.linalg.cholesky(covariance)
    nodes = rule.nodes_nm.ravel()
    centres = rule.nodes_nm.mean(axis=1)
    near = np.abs(centres[:, None] - centres) < _LENGTHS_APART * discrepancy.length_nm
    emits = np.bincount(weights.band_index, np.abs(rule.in_band).sum(axis=1)) > 0
    near &= emits[:, None] & emits
    row = {name: np.ascontiguousarray(getattr(rule, name)[kept]) for name in ("in_band", "out_of_band", "leaked")}
    own = {name: getattr(weights, name)[kept] for name in ("leaked_laser", "leaked_white")}
    return Problem(
        family=posterior.family.code,
        shapes=len(posterior.family.parameter_names),
        has_blocking=posterior.has_blocking,
        table=np.ascontiguousarray(tables()),
        band=np.ascontiguousarray(weights.band_index[kept]),
        points_nm=np.concatenate([nodes, rule.grid_nm]),
        laser=weights.reflected_laser[kept],
        leak_mean=data.leak_mean[kept],
        leak_sd=data.leak_sd[kept],
        leak_at=np.array([posterior.own_leaks.get(band, 0) for band in weights.band_index[kept]]),
        y=data.y.ravel()[kept],
        covariance=covariance,
        whiten=np.ascontiguousarray(np.linalg.inv(factor)),
        ln_norm=float(-0.5 * kept.size * np.log(2 * np.pi) - np.log(np.diagonal(factor)).sum()),
        discrepancy=discrepancy.acts,
        kernel=discrepancy.smooth_kernel(nodes, nodes),
        near=near.astype(np.int64),
        floor_rel=discrepancy.floor_rel,
        reabsorption_rel=discrepancy.reabsorption_rel,
        prior=TruncatedNormals(prior.mean, prior.sd, prior.low, prior.high, prior.ln_norm),
        **row,
        **own,
    )
