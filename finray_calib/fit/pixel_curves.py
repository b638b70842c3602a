"""Emission curves of four parameters with their slopes, on many wavelengths at once.

The loops hold arithmetic only, no call of a mathematical library, so that the compiler computes several wavelengths
in one instruction; the approximations below are far more exact than any band value.
"""

import math
from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from finray_calib.spectra.family_kernels import KAPPA_END, KAPPA_STEP, SKEW_CAUCHY

FloatArray = NDArray[np.float64]

SHAPES: Final = 4
"""Parameters of a curve: mode, ln FWHM, ln peak and the family's own one."""
CURVE_CONSTANTS: Final = 9
FAST: Final = {"contract", "reassoc", "arcp", "nsz"}
"""Sums may be reordered; NaN and infinity keep their meaning."""

_LN_2 = math.log(2.0)
_LEAST_ASYMMETRY = 1e-4  # nearer to 0 a log-normal is taken to be this skew: 1e-4 of the curve
_LEAST_ARGUMENT = 1e-4  # of the logarithm; the curve has vanished there


@njit(cache=True, fastmath=FAST, error_model="numpy")  # type: ignore[untyped-decorator]
def arctangent(value: float) -> float:
    """Return atan(value) to 2e-8 (Abramowitz and Stegun, 4.4.49)."""
    large = abs(value) > 1
    t = 1 / value if large else value
    q = t * t
    r = ((0.0028662257 * q - 0.0161657367) * q + 0.0429096138) * q - 0.0752896400
    r = (((r * q + 0.1065626393) * q - 0.1420889944) * q + 0.1999355085) * q - 0.3333314528
    r = t * (r * q + 1)
    half = 0.5 * math.pi if value > 0 else -0.5 * math.pi
    return half - r if large else r


@njit(cache=True, fastmath=FAST, error_model="numpy")  # type: ignore[untyped-decorator]
def falling_exponential(value: float) -> float:
    """Return exp(-value) for 0 or more, to 2e-9 below 10 and to 1e-22 beyond: a series, squared eight times."""
    y = min(value, 50.0) / 256
    e = 1 - y * (1 - y * (0.5 - y * (1 / 6 - y * (1 / 24 - y * (1 / 120)))))
    for _ in range(8):
        e *= e
    return e


@njit(cache=True, fastmath=FAST, error_model="numpy")  # type: ignore[untyped-decorator]
def logarithm(value: float) -> float:
    """Return ln(value) to 1e-7 from 0.02 to 20: the inverse hyperbolic tangent of the eighth root."""
    root = math.sqrt(math.sqrt(math.sqrt(value)))
    t = (root - 1) / (root + 1)
    q = t * t
    return 16 * t * (1 + q * (1 / 3 + q * (1 / 5 + q * (1 / 7 + q * (1 / 9 + q * (1 / 11))))))


@njit(cache=True, fastmath=FAST, error_model="numpy")  # type: ignore[untyped-decorator]
def curve_constants(family: int, table: FloatArray, theta: FloatArray, k: FloatArray) -> None:
    """Fill what the curve of one parameter vector needs at each wavelength."""
    if family == SKEW_CAUCHY:
        m, peak, width, dm, dpeak, dwidth = _unit_shape(table, theta[3])
        k[0], k[1], k[2] = theta[0], width * math.exp(-theta[1]), m
        k[3], k[4], k[5] = math.sinh(theta[3]), math.cosh(theta[3]), math.exp(theta[2]) / peak
        k[6], k[7], k[8] = dm, dpeak / peak, dwidth / width
    else:
        nu, width, s = 1e4 / theta[0], math.exp(theta[1]), theta[3]
        if abs(s) < _LEAST_ASYMMETRY:
            s = _LEAST_ASYMMETRY
        tilt, share = math.tanh(s / 2), 0.25 / math.cosh(s / 2) ** 2
        # the half-width condition is the root x of a x^2 + b x = c, so its derivatives are those of an implicit one
        a, b, c = width * share, 1e4 + width * nu * tilt, width * nu * nu
        x = 2 * c / (b + math.sqrt(b * b + 4 * a * c))
        slope = (2 * a * x + b) * x
        d_nu = -nu / theta[0]
        k[0], k[1], k[2], k[3] = nu, 1 / x, s, math.exp(theta[2])
        k[4] = d_nu / x
        k[5] = (2 * width * nu - width * tilt * x) * d_nu / slope
        k[6] = (c - a * x * x - width * nu * tilt * x) / slope
        k[7] = (a * tilt * x * x - 2 * width * nu * share * x) / slope
        k[8] = math.sinh(s)


@njit(cache=True, fastmath=FAST, error_model="numpy")  # type: ignore[untyped-decorator]
def curve_slopes(family: int, k: FloatArray, wavelength_nm: FloatArray, out: FloatArray) -> None:
    """Fill the curve and its slopes by mode, ln FWHM and own parameter, (4, L); the slope by ln peak is the curve."""
    # local numbers: the compiler cannot know that filling `out` leaves k alone
    k0, k1, k2, k3, k4, k5, k6, k7, k8 = k[0], k[1], k[2], k[3], k[4], k[5], k[6], k[7], k[8]
    if family == SKEW_CAUCHY:
        for i in range(len(wavelength_nm)):
            off = (wavelength_nm[i] - k0) * k1
            z = off + k2
            w_z = k3 * z
            bell, step = 1 / (1 + z * z), arctangent(w_z) / math.pi + 0.5
            kick = 1 / (math.pi * (1 + w_z * w_z))
            f = k5 * bell * step
            by_z = k5 * bell * (k3 * kick - 2 * z * bell * step)
            out[0, i] = f
            out[1, i] = -by_z * k1
            out[2, i] = -off * by_z
            out[3, i] = by_z * (off * k8 + k6) - f * k7 + k5 * bell * kick * z * k4
    else:
        cosh = math.sqrt(1 + k8 * k8)
        for i in range(len(wavelength_nm)):
            u = (1e4 / wavelength_nm[i] - k0) * k1
            a = max(1 - 2 * u * k8, _LEAST_ARGUMENT)
            g = logarithm(a) / k2
            by_u = -2 * k8 / (a * k2)
            by_s = (-2 * u * cosh / a - g) / k2
            f = k3 * falling_exponential(_LN_2 * g * g)
            fall = -2 * _LN_2 * g * f
            out[0, i] = f
            out[1, i] = -fall * by_u * (k4 + u * k5)
            out[2, i] = -fall * by_u * u * k6
            out[3, i] = fall * (by_s - by_u * u * k7)


@njit(cache=True, fastmath=FAST, error_model="numpy")  # type: ignore[untyped-decorator]
def _unit_shape(table: FloatArray, kappa: float) -> tuple[float, float, float, float, float, float]:
    """Return mode offset, peak and width of the unit skew-Cauchy curve and their derivatives by kappa."""
    a = min(abs(kappa), KAPPA_END - 1e-9) / KAPPA_STEP + 1
    i = int(a)
    t = a - i
    w0, w1 = ((-0.5 * t + 1.0) * t - 0.5) * t, (1.5 * t - 2.5) * t * t + 1.0
    w2, w3 = ((-1.5 * t + 2.0) * t + 0.5) * t, (0.5 * t - 0.5) * t * t
    d0, d1 = (-1.5 * t + 2.0) * t - 0.5, (4.5 * t - 5.0) * t
    d2, d3 = (-4.5 * t + 4.0) * t + 0.5, (1.5 * t - 1.0) * t
    m = w0 * table[0, i - 1] + w1 * table[0, i] + w2 * table[0, i + 1] + w3 * table[0, i + 2]
    p = w0 * table[1, i - 1] + w1 * table[1, i] + w2 * table[1, i + 1] + w3 * table[1, i + 2]
    v = w0 * table[2, i - 1] + w1 * table[2, i] + w2 * table[2, i + 1] + w3 * table[2, i + 2]
    dm = (d0 * table[0, i - 1] + d1 * table[0, i] + d2 * table[0, i + 1] + d3 * table[0, i + 2]) / KAPPA_STEP
    dp = (d0 * table[1, i - 1] + d1 * table[1, i] + d2 * table[1, i + 1] + d3 * table[1, i + 2]) / KAPPA_STEP
    dv = (d0 * table[2, i - 1] + d1 * table[2, i] + d2 * table[2, i + 1] + d3 * table[2, i + 2]) / KAPPA_STEP
    return (m, p, v, dm, dp, dv) if kappa >= 0 else (-m, p, v, dm, -dp, -dv)
