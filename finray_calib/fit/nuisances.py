r"""The band values that the model predicts, and the directions in which the rig's imperfections move them.

.. math:: y = \mu(\theta) + U(\theta) k + e, \quad k \sim N(0, I), \quad e \sim N(0, S)

One column of U per band for each of: its calibration, its blocking, its filter's centre and its filter's width.
The imperfections k are integrated out analytically, :math:`y \sim N(\mu, S + U U^T)`; U moves with the model.
"""

import numpy as np
from numpy.typing import NDArray

from finray_calib.fit.band_model import emission_curves
from finray_calib.spectra.band_tolerances import BandTolerances
from finray_calib.spectra.band_weights import EmissionWeights

FloatArray = NDArray[np.float64]

_ROUNDING = 1e-13  # of the largest variance: 1e-7 for a calibration error a thousand times the noise


class NuisanceModel:
    """Predictions and imperfection columns of parameter rows.

    Parameters
    ----------
    weights
        Weights of the rig, N rows.
    band_calibration_rel
        Relative standard uncertainty of each band's calibration, common to its channels.
    tolerances
        Tolerances of the filters; perfectly known filters when None.
    """

    def __init__(
        self, weights: EmissionWeights, band_calibration_rel: float, tolerances: BandTolerances | None = None
    ) -> None:
        self.weights = weights
        self.tolerances = tolerances
        self._calibration = band_calibration_rel
        self._in_band = (weights.band_index[:, None] == np.arange(weights.bands)).astype(np.float64)
        shifts = () if tolerances is None else tuple(tolerances.emission_shift)
        self._operator = np.concatenate([weights.emission, weights.leaked_emission, *shifts]).T

    def predict(self, theta: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the band values (n, N) of (n, 6) parameter rows and the imperfection columns U (n, N, M).

        The value is that of :class:`EmissionWeights` with m = exp(ln_blocking) times the nominal leak.
        """
        weights = self.weights
        curves = emission_curves(theta, weights.wavelength_nm)
        emitted = np.split(curves @ self._operator, self._operator.shape[1] // len(self._in_band), axis=1)
        reflectance = np.exp(theta[:, 4, None])
        leaked = emitted[1] + reflectance * weights.leaked_laser
        more = np.expm1(theta[:, 5, None])
        white = 1 + more * weights.leaked_white
        mu = (emitted[0] + reflectance * weights.reflected_laser + more * leaked) / white
        columns = [self._per_band(self._calibration * mu)]
        if self.tolerances is not None:
            slope = (1 + more) * (leaked - mu * weights.leaked_white) / white  # d mu / d ln(leak of the row's filter)
            columns.append(self._per_band(self.tolerances.blocking_sd * slope))
            for kind in range(2):
                own = emitted[kind + 2] + reflectance * self.tolerances.laser_shift[kind]
                moved = self._per_band(own)
                moved[:, :, self._excitation_band] -= self.tolerances.level_shift[kind] * mu
                columns.append(moved)
        return mu, np.concatenate(columns, axis=2)

    @property
    def _excitation_band(self) -> int:
        """Index of the band of the excitation filter."""
        return int(self.weights.band_index[np.argmax(self.weights.is_excitation)])

    def _per_band(self, values: FloatArray) -> FloatArray:
        """Return (n, N) values as one column per band, (n, N, B)."""
        return np.asarray(values[:, :, None] * self._in_band)


def marginal_chi2(residual: FloatArray, columns: FloatArray, whiten: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return chi-square and ln det(I + A A^T) of residuals with imperfections integrated out, each (n,).

    With A = whiten @ U and z = whiten @ r, w solves (I + A A^T) w = z; then chi2 = w^T w + (A^T w)^T (A^T w), where
    A^T w are the best imperfections. As a sum of squares it cannot cancel for absurd parameters, which z^T w would
    and make them look perfect.

    Parameters
    ----------
    residual
        (n, K) measured minus predicted.
    columns
        (n, K, M) imperfection columns U.
    whiten
        (K, K) inverse of the lower Cholesky factor of the measurement covariance S.
    """
    spread = whiten @ columns
    system = spread @ spread.swapaxes(1, 2)
    # absurd parameters make U so large that the unit matrix is lost in rounding: it is kept above that
    largest = np.diagonal(system, axis1=1, axis2=2).max(axis=1)
    system = system + (1 + _ROUNDING * largest)[:, None, None] * np.eye(len(whiten))
    weighted = np.linalg.solve(system, (residual @ whiten.T)[..., None])
    best = spread.swapaxes(1, 2) @ weighted
    chi2 = (weighted[..., 0] ** 2).sum(axis=1) + (best[..., 0] ** 2).sum(axis=1)
    return np.asarray(chi2), np.asarray(np.linalg.slogdet(system)[1])


def whitening(covariance: FloatArray) -> FloatArray:
    """Return the inverse of the lower Cholesky factor of a covariance."""
    return np.asarray(np.linalg.inv(np.linalg.cholesky(covariance)), dtype=np.float64)
