r"""The band values that the model predicts, and the directions in which the rig's imperfections move them.

.. math:: y = \mu(\theta) + U k + e, \quad k \sim N(0, I), \quad e \sim N(0, S)

One column of U per band for each of: its calibration, its blocking, its filter's centre and its filter's width. The
imperfections k are integrated out analytically, :math:`y \sim N(\mu, S + U U^T)`.

U is fixed before sampling: the calibration columns from the measured values, the others at a reference fit. Were U
to move with the model, a model that cannot follow the data could buy likelihood by predicting too much, because
relative errors of a large prediction forgive everything; an orange ink came out at four times its true yield. For
errors of 1 % the bias of taking them at the data is 1e-4.
"""

import numpy as np
from numpy.typing import NDArray

from finray_calib.fit.band_model import emission_curves
from finray_calib.spectra.band_tolerances import BandTolerances
from finray_calib.spectra.band_weights import EmissionWeights

FloatArray = NDArray[np.float64]


def predict_bands(theta: FloatArray, weights: EmissionWeights) -> FloatArray:
    """Return the band values (n, N) of (n, 6) parameter rows.

    The value is that of :class:`EmissionWeights` with m = exp(ln_blocking) times the nominal leak.
    """
    return _parts(theta, weights)[0]


def calibration_columns(y: FloatArray, weights: EmissionWeights, band_calibration_rel: float) -> FloatArray:
    """Return one column per band, (N, B): a relative error common to the channels of a band.

    Parameters
    ----------
    y
        (N,) measured band values.
    weights
        Weights of the rig.
    band_calibration_rel
        Relative standard uncertainty of each band's calibration.
    """
    return _per_band(band_calibration_rel * y, weights)


def tolerance_columns(theta: FloatArray, weights: EmissionWeights, tolerances: BandTolerances) -> FloatArray:
    """Return the columns of the filters' blocking, centre and width, (N, 3 B), at one parameter vector (6,)."""
    mu, leaked, white = (part[0] for part in _parts(theta[None], weights))
    leak = np.exp(theta[5])
    slope = leak * (leaked - mu * weights.leaked_white) / white  # d mu / d ln(leak of the row's filter)
    columns = [_per_band(tolerances.blocking_sd * slope, weights)]
    curve = emission_curves(theta[None], weights.wavelength_nm)[0]
    excitation = int(weights.band_index[np.argmax(weights.is_excitation)])
    for kind in range(2):
        own = tolerances.emission_shift[kind] @ curve + np.exp(theta[4]) * tolerances.laser_shift[kind]
        moved = _per_band(own, weights)
        moved[:, excitation] -= tolerances.level_shift[kind] * mu
        columns.append(moved)
    return np.concatenate(columns, axis=1)


def _parts(theta: FloatArray, weights: EmissionWeights) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the band values, their nominally leaked part and the change of the white signal, each (n, N)."""
    curves = emission_curves(theta, weights.wavelength_nm)
    reflectance = np.exp(theta[:, 4, None])
    leaked = curves @ weights.leaked_emission.T + reflectance * weights.leaked_laser
    more = np.expm1(theta[:, 5, None])
    white = 1 + more * weights.leaked_white
    mu = (curves @ weights.emission.T + reflectance * weights.reflected_laser + more * leaked) / white
    return mu, leaked, white


def _per_band(values: FloatArray, weights: EmissionWeights) -> FloatArray:
    """Return (N,) values as one column per band, (N, B)."""
    return np.asarray(values[:, None] * (weights.band_index[:, None] == np.arange(weights.bands)))
