"""Absorption of a fluorescent paint: a saturated band with a steep red edge and a soft blue end."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from data_schemas.errors import CurveError

Floats = NDArray[np.float64]
LN_2, LN_10 = float(np.log(2.0)), float(np.log(10.0))


def absorptance(
    wavelength_nm: ArrayLike,
    peak_nm: ArrayLike,
    peak_absorbance: ArrayLike,
    red_half_width_nm: ArrayLike,
    blue_half_width_nm: ArrayLike,
    blue_floor: ArrayLike,
) -> Floats:
    r"""Return the share of photons that a paint layer absorbs.

    .. math:: a(\lambda) = 1 - 10^{-A b(\lambda)}, \quad
       b = \begin{cases} G(d/w_r) & d > 0 \\ c + (1 - c)\, G(d/w_b) & d \le 0 \end{cases}, \quad
       d = \lambda - \lambda_a, \; G(z) = 2^{-z^2}

    A thick layer (A > 1) saturates to a flat plateau; a thin one shows the band itself. The floor c stands for the
    higher absorption bands in the blue and ultraviolet. Valid for one absorbing species; all arguments broadcast.

    Parameters
    ----------
    wavelength_nm
        Wavelength, nm.
    peak_nm
        Maximum of absorption, nm: the emission's maximum minus the Stokes shift.
    peak_absorbance
        A, decadic absorbance of the layer at the maximum, above 0.
    red_half_width_nm, blue_half_width_nm
        Half widths at half maximum of the absorbance on either side, nm, above 0.
    blue_floor
        c, absorbance far in the blue relative to the maximum, 0 to 1.

    Returns
    -------
    numpy.ndarray
        Absorptance, 0 to 1, broadcast shape.

    Raises
    ------
    CurveError
        A width or the absorbance is not positive, or the floor is not within 0 to 1.
    """
    x, peak, absorbance, red, blue, floor = (
        np.asarray(v, dtype=np.float64)
        for v in (wavelength_nm, peak_nm, peak_absorbance, red_half_width_nm, blue_half_width_nm, blue_floor)
    )
    if not ((absorbance > 0).all() and (red > 0).all() and (blue > 0).all() and ((floor >= 0) & (floor <= 1)).all()):
        raise CurveError(
            "absorption band: absorbance and both half widths (nm) must be above 0 and the blue floor within 0 to 1"
        )
    distance = x - peak
    bell = np.exp(-LN_2 * (distance / np.where(distance > 0, red, blue)) ** 2)
    band = np.where(distance > 0, bell, floor + (1 - floor) * bell)
    return np.asarray(-np.expm1(-LN_10 * absorbance * band))


def smooth_covariance(wavelength_nm: Floats, amplitude_rel: float, length_nm: float) -> Floats:
    """Return the covariance s^2 exp(-(l - l')^2 / (2 L^2)) of a smooth deviation of the logarithm of a curve.

    Parameters
    ----------
    wavelength_nm
        (L,) wavelengths, nm.
    amplitude_rel
        s, standard deviation of the logarithm.
    length_nm
        L, correlation length, nm.

    Returns
    -------
    numpy.ndarray
        (L, L), dimensionless.
    """
    z = (wavelength_nm[:, None] - wavelength_nm[None, :]) / length_nm
    return np.asarray(amplitude_rel**2 * np.exp(-0.5 * z**2))


def photon_yield(emission_per_nm: Floats, wavelength_nm: Floats, excitation_nm: float) -> Floats:
    r"""Return emitted over incident photons of emission curves excited at one wavelength.

    .. math:: P = \int_{\lambda_x} e(\lambda)\, \lambda / \lambda_x \, d\lambda

    e counts energy per nm, so that each emitted photon carries less of it than the one that excited it. No paint
    emits below its excitation: what a curve holds there is not counted. Trapezoidal rule.

    Parameters
    ----------
    emission_per_nm
        (..., L) emission, nm^-1.
    wavelength_nm
        (L,) grid, nm.
    excitation_nm
        Excitation, nm.

    Returns
    -------
    numpy.ndarray
        (...), dimensionless; at most 1 - reflectance, because a photon makes at most one photon.
    """
    above = emission_per_nm * (wavelength_nm > excitation_nm) * wavelength_nm / excitation_nm
    return np.asarray(np.trapezoid(above, wavelength_nm, axis=-1))
