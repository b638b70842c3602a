r"""The directions in which the rig's imperfections move the band values.

.. math:: y = \mu(\theta) + U k + e, \quad k \sim N(0, I), \quad e \sim N(0, S)

One column of U per band for each of: its calibration, its blocking, its filter's centre and its filter's width. The
imperfections k are integrated out analytically, :math:`y \sim N(\mu, S + U U^T)`.

U is fixed before sampling: the calibration columns from the measured values, the others at a reference fit. Were U
to move with the model, a model that cannot follow the data could buy likelihood by predicting too much, because
relative errors of a large prediction forgive everything; an orange ink came out at four times its true yield. For
errors of 1 % the bias of taking them at the data is 1e-4.

A filter's own leak is log-normal, and where it decides what the fit believes, no fixed column can stand for it: such
leaks are sampled beside the shape, and their columns are empty.

.. math:: m_b = e^{\ln m + \sigma_b z_b}, \quad z_b \sim N(0, 1)
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from finray_calib.spectra.band_tolerances import BandTolerances
from finray_calib.spectra.band_weights import EmissionWeights

FloatArray = NDArray[np.float64]

DECISIVE_RATIO = 0.5
"""A leak that moves the bands by more than this, in standard deviations of all else, is sampled."""

MOST_SAMPLED_LEAKS = 4

_BLOCKING, _CURVATURE = 1, 4  # of the blocks of U: calibration, blocking, centre, width, curvature of the blocking


@dataclass(frozen=True, slots=True)
class Reference:
    """Where the filters' tolerances act.

    Attributes
    ----------
    curve
        (L,) emission on the weights' grid, nm^-1.
    reflected_laser
        Reflectance at the laser line.
    leak
        (N,) multiplier of each row's nominal leak.
    sampled_leaks
        Bands whose own leak is a parameter.
    """

    curve: FloatArray
    reflected_laser: float
    leak: FloatArray
    sampled_leaks: tuple[int, ...] = ()


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
        Multiplier of the nominal leak: one, (n,), or (n, N) of each row.
    """
    reflectance = np.asarray(reflected_laser)[:, None]
    more = np.asarray(blocking, dtype=np.float64) - 1
    more = more if more.ndim == 2 else np.broadcast_to(more, len(curves))[:, None]
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


def tolerance_columns(reference: Reference, weights: EmissionWeights, tolerances: BandTolerances) -> FloatArray:
    """Return the columns of the filters' blocking, centre, width and curvature of the blocking, (N, 4 B).

    Empty where a leak is sampled.
    """
    curve, reflected_laser = reference.curve, reference.reflected_laser
    mu = band_values(curve[None], np.array([reflected_laser]), weights, reference.leak[None])[0]
    leaked = weights.leaked_emission @ curve + reflected_laser * weights.leaked_laser
    white = 1 + (reference.leak - 1) * weights.leaked_white
    slope = reference.leak * (leaked - mu * weights.leaked_white) / white  # d mu / d ln(leak of the row's filter)
    slope[np.isin(weights.band_index, reference.sampled_leaks)] = 0.0
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


def decisive_leaks(imperfections: FloatArray, rest: FloatArray, bands: int) -> tuple[int, ...]:
    r"""Return the bands whose own leak must be sampled, in order: at most four, those of the largest ratio.

    .. math:: r_b = \sqrt{c_b^T C_b^{-1} c_b} > 0.5

    with c_b the band's blocking column and C_b the covariance of all else. A smaller ratio leaves the leak as it was
    believed to be, and its linear column is good enough.

    Parameters
    ----------
    imperfections
        (K, 5 B) all columns of U, none sampled.
    rest
        (K, K) covariance of the measurement and the discrepancy.
    bands
        Number of bands B.
    """
    ratios = {}
    for band in range(bands):
        own = imperfections[:, blocking_column(band, bands)]
        if own.any():
            others = np.delete(imperfections, [blocking_column(band, bands), _CURVATURE * bands + band], axis=1)
            ratios[band] = float(np.sqrt(own @ np.linalg.solve(rest + others @ others.T, own)))
    decisive = [band for band, ratio in ratios.items() if ratio > DECISIVE_RATIO]
    return tuple(sorted(sorted(decisive, key=lambda band: -ratios[band])[:MOST_SAMPLED_LEAKS]))


def blocking_column(band: int, bands: int) -> int:
    """Return the column of U that holds a band's blocking."""
    return _BLOCKING * bands + band


def _per_band(values: FloatArray, weights: EmissionWeights) -> FloatArray:
    """Return (N,) values as one column per band, (N, B)."""
    return np.asarray(values[:, None] * (weights.band_index[:, None] == np.arange(weights.bands)))
