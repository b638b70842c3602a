r"""The directions in which the rig's imperfections move the band values.

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

from finray_calib.spectra.band_tolerances import BandTolerances
from finray_calib.spectra.band_weights import EmissionWeights

FloatArray = NDArray[np.float64]


def band_values(
    curves: FloatArray, reflected_laser: FloatArray, weights: EmissionWeights, blocking: FloatArray | float = 1.0
) -> FloatArray:
    """Return the band values (n, N) of emission curves on the full wavelength grid.

    The value is that of :class:`EmissionWeights` with m = `blocking` times the nominal leak.

    Parameters
    ----------
    curves
        (n, L) emission on the weights' grid, nm^-1.
    reflected_laser
        (n,) reflectance at the laser line.
    weights
        Weights of the rig.
    blocking
        (n,) or one multiplier of the nominal leak.
    """
    reflectance = np.asarray(reflected_laser)[:, None]
    more = np.broadcast_to(np.asarray(blocking, dtype=np.float64) - 1, len(curves))[:, None]
    leaked = curves @ weights.leaked_emission.T + reflectance * weights.leaked_laser
    mu = curves @ weights.emission.T + reflectance * weights.reflected_laser + more * leaked
    return np.asarray(mu / (1 + more * weights.leaked_white))


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


def tolerance_columns(
    curve: FloatArray, reflected_laser: float, blocking: float, weights: EmissionWeights, tolerances: BandTolerances
) -> FloatArray:
    """Return the columns of the filters' blocking, centre, width and curvature of the blocking, (N, 4 B).

    At one reference curve (L,).
    """
    mu = band_values(curve[None], np.array([reflected_laser]), weights, blocking)[0]
    leaked = weights.leaked_emission @ curve + reflected_laser * weights.leaked_laser
    white = 1 + (blocking - 1) * weights.leaked_white
    slope = blocking * (leaked - mu * weights.leaked_white) / white  # d mu / d ln(leak of the row's filter)
    sd = tolerances.blocking_sd
    columns = [_per_band(sd * slope, weights)]
    excitation = int(weights.band_index[np.argmax(weights.is_excitation)])
    for kind in range(2):
        own = tolerances.emission_shift[kind] @ curve + reflected_laser * tolerances.laser_shift[kind]
        moved = _per_band(own, weights)
        moved[:, excitation] -= tolerances.level_shift[kind] * mu
        columns.append(moved)
    # the leak is log-normal: what is left of it beside its mean and its linear part has this standard deviation
    columns.append(_per_band(sd**2 / np.sqrt(2) * slope, weights))
    return np.concatenate(columns, axis=1)


def _per_band(values: FloatArray, weights: EmissionWeights) -> FloatArray:
    """Return (N,) values as one column per band, (N, B)."""
    return np.asarray(values[:, None] * (weights.band_index[:, None] == np.arange(weights.bands)))
