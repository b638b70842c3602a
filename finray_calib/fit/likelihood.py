"""The likelihood of band values with measurement noise and the imperfections of the rig."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from data_schemas.errors import FitError
from finray_calib.fit.nuisances import calibration_columns, predict_bands, tolerance_columns
from finray_calib.fit.prior import EmissionPrior
from finray_calib.spectra.band_tolerances import BandTolerances
from finray_calib.spectra.band_weights import EmissionWeights, read_only

FloatArray = NDArray[np.float64]

LEAST_BANDS = 4
"""Fewest bands with a usable channel: a mode, a width, a skewness and a height need as many."""

_DIFFERENCE_STEP = 1e-4  # in prior standard deviations: truncation 1e-8, rounding 1e-11, both far below the noise


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
        if not (np.isfinite(measured).all() and np.allclose(measured, measured.T, rtol=1e-6, atol=0.0)):
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

    @property
    def kept(self) -> NDArray[np.int64]:
        """Rows of the usable entries in band-major order."""
        return np.flatnonzero(self.usable.ravel())

    def imperfections(self, reference: FloatArray | None = None) -> FloatArray:
        """Return the imperfection columns U of the usable rows, (K, M).

        Parameters
        ----------
        reference
            (6,) parameters at which the filters' tolerances act; calibration errors alone when None.
        """
        y = np.nan_to_num(self.y.ravel())
        columns = [calibration_columns(y, self.weights, self.band_calibration_rel)]
        if reference is not None and self.tolerances is not None:
            columns.append(tolerance_columns(reference, self.weights, self.tolerances))
        return np.concatenate(columns, axis=1)[self.kept]


class LogPosterior:
    """Log posterior density of parameter rows given band data and a prior: y ~ N(mu(theta), S + U U^T).

    Parameters
    ----------
    data
        Measured band values.
    prior
        Prior of the six parameters.
    reference
        (6,) parameters at which the filters' tolerances act, see :meth:`BandData.imperfections`.
    """

    def __init__(self, data: BandData, prior: EmissionPrior, reference: FloatArray | None = None) -> None:
        self.data = data
        self.prior = prior
        self._kept = data.kept
        self._y = data.y.ravel()[self._kept]
        imperfections = data.imperfections(reference)
        self.covariance = data.covariance[np.ix_(self._kept, self._kept)] + imperfections @ imperfections.T
        factor = np.linalg.cholesky(self.covariance)
        self._whiten: FloatArray = np.asarray(np.linalg.inv(factor), dtype=np.float64)
        self._constant = -0.5 * self._kept.size * np.log(2 * np.pi) - np.log(np.diagonal(factor)).sum()

    def __call__(self, theta: FloatArray) -> FloatArray:
        """Return the log posterior density (up to the evidence) of (n, 6) rows, (n,)."""
        inside = self.prior.contains(theta)
        result = np.full(len(theta), -np.inf)
        if inside.any():
            result[inside] = self.prior.log_density(theta[inside]) + self.log_likelihood(theta[inside])
        return result

    def log_likelihood(self, theta: FloatArray) -> FloatArray:
        """Return ln p(y | theta) of (n, 6) rows, (n,)."""
        residual = (self._y - self.predict_usable(theta)) @ self._whiten.T
        return np.asarray(self._constant - 0.5 * (residual**2).sum(axis=1))

    def predict_usable(self, theta: FloatArray) -> FloatArray:
        """Return the predicted usable band values of (n, 6) rows, (n, K)."""
        return predict_bands(theta, self.data.weights)[:, self._kept]

    def information(self, theta: FloatArray) -> FloatArray:
        """Return the expected (Fisher) information plus the prior precision at one theta, (6, 6).

        J^T C^-1 J + diag(1 / sd^2), J by central differences. Its inverse is the Laplace covariance.
        """
        step = _DIFFERENCE_STEP * np.diag(self.prior.sd)
        low = np.maximum(theta - step, self.prior.low - np.diagonal(step))
        moved = self.predict_usable(np.concatenate([theta + step, low]))
        jacobian = (moved[:6] - moved[6:]) / (2 * _DIFFERENCE_STEP * self.prior.sd[:, None])
        whitened = jacobian @ self._whiten.T
        return np.asarray(whitened @ whitened.T + np.diag(self.prior.sd**-2.0))
