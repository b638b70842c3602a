"""The likelihood of band values with measurement noise and a calibration error common to the channels of a band."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from data_schemas.errors import FitError
from finray_calib.fit.band_model import predict_bands
from finray_calib.fit.prior import EmissionPrior
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


class LogPosterior:
    """Log posterior density of parameter rows given band data and a prior.

    y ~ N(mu, S + r^2 mu_b mu_b^T inside each band b), mu = the model's prediction. The calibration term is
    evaluated at the model, so its log determinant counts: at the data it would favour low values. The best
    calibration errors k of the bands solve (I + U^T S^-1 U) k = U^T S^-1 (y - mu), U = r mu in each band; then
    chi2 = (y - mu - U k)^T S^-1 (y - mu - U k) + k^T k.

    Parameters
    ----------
    data
        Measured band values.
    prior
        Prior of the six parameters.
    """

    def __init__(self, data: BandData, prior: EmissionPrior) -> None:
        self.data = data
        self.prior = prior
        kept = data.kept
        self._y = data.y.ravel()[kept]
        measured = data.covariance[np.ix_(kept, kept)]
        self._precision = np.linalg.inv(measured)
        self._constant = -0.5 * (kept.size * np.log(2 * np.pi) + np.linalg.slogdet(measured)[1])
        bands = data.weights.band_index[kept]
        self._in_band = (bands[:, None] == np.unique(bands)).astype(np.float64)

    def __call__(self, theta: FloatArray) -> FloatArray:
        """Return the log posterior density (up to the evidence) of (n, 6) rows, (n,)."""
        inside = self.prior.contains(theta)
        result = np.full(len(theta), -np.inf)
        if inside.any():
            result[inside] = self.prior.log_density(theta[inside]) + self.log_likelihood(theta[inside])
        return result

    def log_likelihood(self, theta: FloatArray) -> FloatArray:
        """Return ln p(y | theta) of (n, 6) rows, (n,)."""
        predicted = self.predict_usable(theta)
        residual = self._y - predicted
        system, spread = self._calibration_system(predicted)
        projected = (spread * (residual @ self._precision)) @ self._in_band
        error = np.linalg.solve(system, projected[..., None])[..., 0]
        # as a least-squares sum chi2 has only positive terms: the textbook difference cancels for absurd theta
        # and would make them look perfect
        rest = residual - spread * (error @ self._in_band.T)
        chi2 = ((rest @ self._precision) * rest).sum(axis=1) + (error**2).sum(axis=1)
        lower = np.linalg.cholesky(system)
        ln_det = 2 * np.log(np.diagonal(lower, axis1=1, axis2=2)).sum(axis=1)
        return np.asarray(self._constant - 0.5 * (chi2 + ln_det))

    def predict_usable(self, theta: FloatArray) -> FloatArray:
        """Return the predicted usable band values of (n, 6) rows, (n, K)."""
        return predict_bands(theta, self.data.weights)[:, self.data.kept]

    def information(self, theta: FloatArray) -> FloatArray:
        """Return the expected (Fisher) information plus the prior precision at one theta, (6, 6).

        J^T C^-1 J + diag(1 / sd^2), J by central differences; the small term of the covariance's own slope is
        left out. Its inverse is the Laplace covariance.
        """
        step = _DIFFERENCE_STEP * np.diag(self.prior.sd)
        low = np.maximum(theta - step, self.prior.low - np.diagonal(step))
        moved = self.predict_usable(np.concatenate([theta + step, low]))
        jacobian = (moved[:6] - moved[6:]) / (2 * _DIFFERENCE_STEP * self.prior.sd[:, None])
        predicted = self.predict_usable(theta[None])
        system, spread = self._calibration_system(predicted)
        weighted = jacobian @ self._precision
        projected = (spread * weighted) @ self._in_band
        calibrated = weighted @ jacobian.T - projected @ np.linalg.solve(system[0], projected.T)
        return np.asarray(calibrated + np.diag(self.prior.sd**-2.0))

    def _calibration_system(self, predicted: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return I + U^T S^-1 U, (n, B, B), and the values of U = r mu, (n, K), of the rank-one terms."""
        spread = self.data.band_calibration_rel * predicted
        inner = spread[:, :, None] * self._precision * spread[:, None, :]
        system = self._in_band.T @ inner @ self._in_band
        return system + np.eye(self._in_band.shape[1]), spread
