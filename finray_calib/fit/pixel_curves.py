"""Emission curves of four parameters with their slopes, at one wavelength for many parameter vectors at once.

A lane is one pixel of a block. The loops over lanes hold arithmetic only, so that the compiler computes several
pixels in one instruction; rows of lanes lie one behind the other in flat arrays, which tells it that they are apart.
"""

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from finray_calib.spectra.compiled import compiled
from finray_calib.spectra.elementary_functions import arctangent, falling_exponential
from finray_calib.spectra.family_kernels import (
    KAPPA_CELLS,
    KAPPA_END,
    KAPPA_STEP,
    SKEW_CAUCHY,
    cell_of_table,
)

FloatArray = NDArray[np.float64]

LANES: Final = 16
"""Pixels that are computed side by side."""
SHAPES: Final = 4
"""Parameters of a curve: mode, ln FWHM, ln peak and the family's own one."""
CURVE_CONSTANTS: Final = 10

_LN_2 = math.log(2.0)
_LEAST_ASYMMETRY = 1e-4  # nearer to 0 a log-normal is taken to be this skew: 1e-4 of the curve
_LEAST_ARGUMENT = 1e-4  # of the logarithm; the curve has vanished there


@compiled
def curve_constants(family: int, table: FloatArray, theta: FloatArray, k: FloatArray) -> None:
    """Fill what the curves of parameter vectors (>= 4, LANES) need at each wavelength, (CURVE_CONSTANTS * LANES,)."""
    for lane in range(LANES):
        mode, width, peak, own = theta[0, lane], math.exp(theta[1, lane]), math.exp(theta[2, lane]), theta[3, lane]
        if family == SKEW_CAUCHY:
            values = _skew_cauchy_constants(table, mode, width, peak, own)
        else:
            values = _log_normal_constants(mode, width, peak, own)
        for i, value in enumerate(values):
            k[i * LANES + lane] = value


@compiled
def curve_slopes(family: int, k: FloatArray, wavelength_nm: float, out: FloatArray) -> None:
    """Fill curves and slopes by mode, ln FWHM and own parameter, (4 * LANES,); the slope by ln peak is the curve."""
    if family == SKEW_CAUCHY:
        for i in range(LANES):
            off = (wavelength_nm - k[i]) * k[LANES + i]
            z = off + k[2 * LANES + i]
            w, peak = k[3 * LANES + i], k[5 * LANES + i]
            by_bell, by_kick, step = 1 + z * z, 1 + w * z * w * z, arctangent(w * z) / math.pi + 0.5
            both = 1 / (by_bell * by_kick)
            bell, kick = by_kick * both, by_bell * both / math.pi
            f = peak * bell * step
            by_z = peak * bell * (w * kick - 2 * z * bell * step)
            out[i] = f
            out[LANES + i] = -by_z * k[LANES + i]
            out[2 * LANES + i] = -off * by_z
            by_own = by_z * (off * k[8 * LANES + i] + k[6 * LANES + i]) - f * k[7 * LANES + i]
            out[3 * LANES + i] = by_own + peak * bell * kick * z * k[4 * LANES + i]
    else:
        nu = 1e4 / wavelength_nm
        for i in range(LANES):
            u, inverse_s, sinh = (nu - k[i]) * k[LANES + i], k[2 * LANES + i], k[8 * LANES + i]
            a = max(1 - 2 * u * sinh, _LEAST_ARGUMENT)
            g, inverse_a = logarithm(a) * inverse_s, 1 / a
            f = k[3 * LANES + i] * falling_exponential(-_LN_2 * g * g)
            fall = -2 * _LN_2 * g * f
            by_u = -2 * sinh * inverse_a * inverse_s
            by_s = (-2 * u * k[9 * LANES + i] * inverse_a - g) * inverse_s
            out[i] = f
            out[LANES + i] = -fall * by_u * (k[4 * LANES + i] + u * k[5 * LANES + i])
            out[2 * LANES + i] = -fall * by_u * u * k[6 * LANES + i]
            out[3 * LANES + i] = fall * (by_s - by_u * u * k[7 * LANES + i])


@compiled
def logarithm(value: float) -> float:
    """Return ln(value) to 1e-7 from 0.02 to 20: the inverse hyperbolic tangent of the eighth root."""
    root = math.sqrt(math.sqrt(math.sqrt(value)))
    t = (root - 1) / (root + 1)
    q = t * t
    return 16 * t * (1 + q * (1 / 3 + q * (1 / 5 + q * (1 / 7 + q * (1 / 9 + q * (1 / 11))))))


@compiled
def _skew_cauchy_constants(
    table: FloatArray, mode: float, width: float, peak: float, kappa: float
) -> tuple[float, float, float, float, float, float, float, float, float, float]:
    """Return mode, inverse scale, mode offset, skewness with its slope, height, slopes of the unit shape, unused 0."""
    a = min(abs(kappa), KAPPA_END - 1e-9) / KAPPA_STEP + 1
    i = cell_of_table(a, KAPPA_CELLS)
    t = a - i
    value = (
        ((-0.5 * t + 1.0) * t - 0.5) * t,
        (1.5 * t - 2.5) * t * t + 1.0,
        ((-1.5 * t + 2.0) * t + 0.5) * t,
        (0.5 * t - 0.5) * t * t,
    )
    slope = (-1.5 * t + 2.0) * t - 0.5, (4.5 * t - 5.0) * t, (-4.5 * t + 4.0) * t + 0.5, (1.5 * t - 1.0) * t
    m = p = v = dm = dp = dv = 0.0
    for r in range(4):
        m, dm = m + value[r] * table[0, i + r - 1], dm + slope[r] * table[0, i + r - 1]
        p, dp = p + value[r] * table[1, i + r - 1], dp + slope[r] * table[1, i + r - 1]
        v, dv = v + value[r] * table[2, i + r - 1], dv + slope[r] * table[2, i + r - 1]
    sign = 1.0 if kappa >= 0 else -1.0
    along = sign / KAPPA_STEP
    grown = math.exp(kappa)
    sinh, cosh = (grown - 1 / grown) / 2, (grown + 1 / grown) / 2
    return mode, v / width, sign * m, sinh, cosh, peak / p, dm / KAPPA_STEP, along * dp / p, along * dv / v, 0.0


@compiled
def _log_normal_constants(
    mode: float, width: float, peak: float, s: float
) -> tuple[float, float, float, float, float, float, float, float, float, float]:
    """Return mode's wavenumber, inverse width, inverse asymmetry, height, slopes of the width, sinh and cosh."""
    if abs(s) < _LEAST_ASYMMETRY:
        s = _LEAST_ASYMMETRY
    nu, root = 1e4 / mode, math.exp(s / 2)
    tilt, share = (root - 1 / root) / (root + 1 / root), 1 / (root + 1 / root) ** 2
    # the half-width condition is the root x of a x^2 + b x = c, so its derivatives are those of an implicit one
    a, b, c = width * share, 1e4 + width * nu * tilt, width * nu * nu
    x = 2 * c / (b + math.sqrt(b * b + 4 * a * c))
    slope = (2 * a * x + b) * x
    d_nu = -nu / mode
    by_mode = (2 * width * nu - width * tilt * x) * d_nu / slope
    by_width = (c - a * x * x - width * nu * tilt * x) / slope
    by_s = (a * tilt * x * x - 2 * width * nu * share * x) / slope
    sinh, cosh = (root * root - 1 / (root * root)) / 2, (root * root + 1 / (root * root)) / 2
    return nu, 1 / x, 1 / s, peak, d_nu / x, by_mode, by_width, by_s, sinh, cosh
