"""Compiled emission curves of all families: shared by likelihood and pixel maps.

Every family takes its parameters in the order mode, ln FWHM, ln peak, then its own. :func:`constants` turns them
into the numbers that :func:`fill` needs at each wavelength.
"""

import math
from collections.abc import Callable
from typing import Final

import numpy as np
from numpy.typing import NDArray

from finray_calib.spectra.compiled import compiled, compiled_inside
from finray_calib.spectra.elementary_functions import arctangent, falling_exponential, log_of_one_plus

FloatArray = NDArray[np.float64]

SKEW_CAUCHY: Final = 0
SKEW_T: Final = 1
LOG_NORMAL: Final = 2
GAUSSIAN_MIXTURE: Final = 3

CONSTANTS: Final = 6
"""Length of the array that :func:`constants` fills."""

KAPPA_STEP: Final = 0.05
KAPPA_END: Final = 8.0
LN_TAIL_STEP: Final = 0.1
LN_TAIL_START: Final = -0.6
LN_TAIL_END: Final = 4.2
"""Grid of the shape table: asinh(skewness) from 0, and the logarithm of the tail's degrees of freedom."""

KAPPA_CELLS: Final = round(KAPPA_END / KAPPA_STEP)
_LN_TAIL_CELLS = round((LN_TAIL_END - LN_TAIL_START) / LN_TAIL_STEP)
_BISECTIONS = 50  # halves a bracket of 40 scale lengths to 4e-14
_LN_2 = math.log(2.0)
_SUPPORT_END = 1e-6 - 1  # of a log-normal, where its curve has vanished
_NO_SKEW = 1e-12  # stands in for 0: the log-normal's limit is a Gaussian


def shape_table() -> FloatArray:
    """Return mode offset, peak and full width of the unit skew-t curve on the grid of kappa and ln n, (3, K, N).

    The curve is (1 + z^2/n)^(-(n+1)/2) (atan(w z)/pi + 1/2) with w = sinh(kappa); n = 1 is the paper's skew-Cauchy.
    One grid step beyond each end, for cubic interpolation.
    """
    kappa = KAPPA_STEP * np.arange(-1, KAPPA_CELLS + 2)
    ln_tail = LN_TAIL_START + LN_TAIL_STEP * np.arange(-1, _LN_TAIL_CELLS + 2)
    w, n = np.broadcast_arrays(np.sinh(kappa)[:, None], np.exp(ln_tail))

    def unit(z: FloatArray) -> FloatArray:
        return np.asarray(np.exp(-(n + 1) / 2 * np.log1p(z * z / n)) * (np.arctan(w * z) / np.pi + 0.5))

    def rises(z: FloatArray) -> NDArray[np.bool_]:
        slope = -(n + 1) * z / (n + z * z) * (np.arctan(w * z) / np.pi + 0.5) + w / np.pi / (1 + (w * z) ** 2)
        return np.asarray(slope > 0)

    mode = _bisected(rises, np.where(w > 0, 0.0, -1.5), np.where(w > 0, 1.5, 0.0))
    peak = unit(mode)
    red, blue = (_bisected(lambda z: unit(z) > peak / 2, mode, mode + far) for far in (40.0, -40.0))
    return np.stack([mode, peak, red - blue])


def _bisected(holds: Callable[[FloatArray], NDArray[np.bool_]], inside: FloatArray, outside: FloatArray) -> FloatArray:
    """Return where a condition that holds at the points inside, and not at those outside, begins to fail."""
    for _ in range(_BISECTIONS):
        middle = (inside + outside) / 2
        held = holds(middle)
        inside, outside = np.where(held, middle, inside), np.where(held, outside, middle)
    return np.asarray((inside + outside) / 2)


@compiled_inside
def _cubic(t: float) -> tuple[float, float, float, float]:
    """Return the weights of cubic (Catmull-Rom) interpolation at the fraction t of a cell."""
    return (
        ((-0.5 * t + 1.0) * t - 0.5) * t,
        (1.5 * t - 2.5) * t * t + 1.0,
        ((-1.5 * t + 2.0) * t + 0.5) * t,
        (0.5 * t - 0.5) * t * t,
    )


@compiled
def cell_of_table(index: float, cells: int) -> int:
    """Return the cell, 1 to `cells`, that holds a place in a table with one step more at each end; of NaN the first.

    Compiled functions check no index, and NaN or 1e30 as an integer is undefined; a comparison is false for NaN.
    """
    return int(min(index, float(cells))) if index > 1.0 else 1


@compiled_inside
def skew_t_shape(kappa: float, ln_tail: float, table: FloatArray) -> tuple[float, float, float]:
    """Return mode offset m, peak p and width v of the unit curve by cubic interpolation of the table."""
    a = min(abs(kappa), KAPPA_END - 1e-9) / KAPPA_STEP + 1
    b = (min(max(ln_tail, LN_TAIL_START), LN_TAIL_END - 1e-9) - LN_TAIL_START) / LN_TAIL_STEP + 1
    i, j = cell_of_table(a, KAPPA_CELLS), cell_of_table(b, _LN_TAIL_CELLS)
    along, across = _cubic(a - i), _cubic(b - j)
    m = p = v = 0.0
    for r in range(4):
        for c in range(4):
            weight = along[r] * across[c]
            m += weight * table[0, i + r - 1, j + c - 1]
            p += weight * table[1, i + r - 1, j + c - 1]
            v += weight * table[2, i + r - 1, j + c - 1]
    return (m if kappa >= 0 else -m), p, v


@compiled_inside
def constants(family: int, theta: FloatArray, table: FloatArray, out: FloatArray) -> None:
    """Fill the constants of a curve from its parameters (mode, ln FWHM, ln peak, the family's own)."""
    mode, width, peak = theta[0], math.exp(theta[1]), math.exp(theta[2])
    if family in (SKEW_CAUCHY, SKEW_T):
        ln_tail = theta[4] if family == SKEW_T else 0.0
        m, p, v = skew_t_shape(theta[3], ln_tail, table)
        scale = width / v
        out[0], out[1], out[2] = mode - m * scale, 1 / scale, math.sinh(theta[3])
        out[3], out[4] = peak / p, math.exp(ln_tail)
    elif family == LOG_NORMAL:
        nu, s = 1e4 / mode, theta[3]
        r = math.exp(s)
        a = width * r / (1 + r) ** 2
        b = 1e4 - width * nu * (1 - r) / (1 + r)
        width_kk = 2 * width * nu * nu / (b + math.sqrt(b * b + 4 * a * width * nu * nu))
        out[0], out[1], out[2], out[3] = nu, 1 / width_kk, s, peak
    else:
        out[0], out[1], out[2] = mode, 1 / width, peak
        out[3], out[4] = mode + theta[3], math.exp(-theta[4]) / width
        out[5] = peak * math.exp(theta[5])


@compiled_inside
def fill(family: int, c: FloatArray, wavelength_nm: FloatArray, out: FloatArray) -> None:
    """Fill the curve at (L,) wavelengths from its constants."""
    # local numbers: the compiler cannot know that filling `out` leaves c alone
    c0, c1, c2, c3, c4, c5 = c[0], c[1], c[2], c[3], c[4], c[5]
    if family == SKEW_CAUCHY:
        for j in range(len(wavelength_nm)):
            z = (wavelength_nm[j] - c0) * c1
            out[j] = c3 / (1 + z * z) * (arctangent(c2 * z) / math.pi + 0.5)
    elif family == SKEW_T:
        for j in range(len(wavelength_nm)):
            z = (wavelength_nm[j] - c0) * c1
            bell = falling_exponential(-(c4 + 1) / 2 * log_of_one_plus(z * z / c4))
            out[j] = c3 * bell * (arctangent(c2 * z) / math.pi + 0.5)
    elif family == LOG_NORMAL:
        skew = c2 if c2 != 0.0 else _NO_SKEW
        slope, sharpness = 2 * math.sinh(skew) * c1, math.sqrt(_LN_2) / skew
        for j in range(len(wavelength_nm)):
            g = sharpness * log_of_one_plus(max((c0 - 1e4 / wavelength_nm[j]) * slope, _SUPPORT_END))
            out[j] = c3 * falling_exponential(-g * g)
    else:
        for j in range(len(wavelength_nm)):
            u, t = (wavelength_nm[j] - c0) * c1, (wavelength_nm[j] - c3) * c4
            out[j] = c2 * falling_exponential(-4 * _LN_2 * u * u) + c5 * falling_exponential(-4 * _LN_2 * t * t)


@compiled
def curves(family: int, theta: FloatArray, table: FloatArray, wavelength_nm: FloatArray) -> FloatArray:
    """Return the curves of (n, >= D) parameter rows at (L,) wavelengths, (n, L)."""
    out = np.empty((len(theta), len(wavelength_nm)))
    c = np.empty(CONSTANTS)
    for i in range(len(theta)):
        constants(family, theta[i], table, c)
        fill(family, c, wavelength_nm, out[i])
    return out
