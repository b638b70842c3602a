"""The only import of Numba, and compiled emission curves: for the likelihood, and with slopes for many pixels.

Functions are compiled to machine code and cached on disk. Every call inside is inlined. Left to itself, Numba inlines
in the copy that it stores and not in the one that it runs after compiling, so that reordered sums differ in their
last digits between the first run and all later ones. Numba renews a cached function when its own file changes, not
when a function that it calls does. The cache therefore lies in a folder named after the sources of all compiled
functions: old machine code is never used with new sources.

The elementary functions are made of arithmetic only, so that compiled loops compute several values in one
instruction; a call of the mathematical library keeps the compiler from doing so. All are exact to rounding or nearly
so where an emission curve is larger than 1e-9 of its peak.

Every family takes its parameters in the order mode, ln FWHM, ln peak, then its own. :func:`constants` turns them into
the numbers that :func:`fill` needs at each wavelength.

:func:`curve_constants` and :func:`curve_slopes` do the same for the families of four parameters, at one wavelength and
many parameter vectors. A lane is one pixel of a block. The loops over lanes hold arithmetic only, so that the compiler
computes several pixels in one instruction; rows of lanes lie one behind the other in flat arrays, so that it knows that
they do not overlap.
"""

import hashlib
import math
import os
from collections.abc import Callable
from functools import lru_cache
from importlib import import_module
from pathlib import Path
from typing import Any, Final, TypeVar

import numba
import numpy as np
from numpy.typing import NDArray

Function = TypeVar("Function", bound=Callable[..., object])

_REORDER = {"reassoc", "contract", "arcp", "nsz"}  # sums may be reordered; infinities and NaN keep their meaning
_OPTIONS = {"fastmath": _REORDER, "error_model": "numpy", "nogil": True, "forceinline": True}
_PACKAGE = Path(__file__).parents[1]
_SOURCES = ("spectra", "fit")


def compiled(function: Function) -> Function:
    """Compile a function of floats and arrays at its first call; later processes load it from the cache.

    Division by zero gives an infinity, as in numpy, and raises nothing. It releases the interpreter's lock, so that
    threads run it side by side.
    """
    return _cached(numba.njit(**_OPTIONS), function)


def compiled_inside(function: Function) -> Function:
    """Compile a function that only compiled functions call, without the wrappers that calls from Python would need."""
    return _cached(numba.njit(**_OPTIONS, no_cpython_wrapper=True, no_cfunc_wrapper=True), function)


def compiled_in_parallel(function: Function) -> Function:
    """Compile a function whose loops over :data:`numba.prange` run on several threads."""
    return _cached(numba.njit(error_model="numpy", parallel=True), function)


def machine_threads() -> int:
    """Return how many threads compiled functions may use: all cores, or NUMBA_NUM_THREADS where it is set."""
    return int(numba.config.NUMBA_NUM_THREADS)


def _cached(compiler: Callable[[Function], object], function: Function) -> Function:
    """Return the compiled function with its cache in this package's own folder; other users of Numba see no change."""
    dispatcher = compiler(function)
    before, numba.config.CACHE_DIR = numba.config.CACHE_DIR, _cache_folder()
    try:
        dispatcher.enable_caching()  # type: ignore[attr-defined]
    finally:
        numba.config.CACHE_DIR = before
    return dispatcher  # type: ignore[return-value]


@lru_cache(maxsize=1)
def _cache_folder() -> str:
    """Return the folder of these sources, below NUMBA_CACHE_DIR or the user's cache folder."""
    digest = hashlib.sha256()
    for path in sorted(path for name in _SOURCES for path in (_PACKAGE / name).glob("*.py")):
        digest.update(path.read_bytes())
    home = os.environ.get("XDG_CACHE_HOME") or str(Path.home() / ".cache")
    base = numba.config.CACHE_DIR or str(Path(home) / "finray-calib")
    return str(Path(base) / f"compiled-{digest.hexdigest()[:12]}")


def _load_arrays_without_scipy() -> None:
    """Load what Numba knows of arrays without :mod:`scipy.linalg`, which takes as long as the rest of Numba.

    Numba asks whether there is a BLAS where it loads its functions of arrays, at the first call of any compiled
    function, although it needs one only where compiled code multiplies matrices. It asks again there, and then loads
    it. The answer is known here: SciPy is required by this package. A Numba that is laid out otherwise loads as usual.
    """
    try:
        linalg: Any = import_module("numba.np.linalg")
        asked = linalg.ensure_blas
    except (ImportError, AttributeError):
        return
    linalg.ensure_blas = lambda: None
    try:
        import_module("numba.np.arraymath")
    finally:
        linalg.ensure_blas = asked


_load_arrays_without_scipy()

_LARGE: Final = 2.414213562373095  # tan(3 pi / 8)
_MIDDLE: Final = 0.4142135623730950  # tan(pi / 8)
_LEAST_EXPONENT: Final = -80.0  # e^-80: 1e-35 of a peak
_DOUBLINGS: Final = 8


@compiled
def arctangent(value: float) -> float:
    """Return atan(value) to 1e-16 + 4e-16 |atan(value)|.

    Arguments are brought below tan(pi / 8), where a rational function serves.

    References
    ----------
    Moshier, Methods and Programs for Mathematical Functions, 1989 (Cephes, atan).
    """
    a = abs(value)
    large, middle = a > _LARGE, a > _MIDDLE
    above = -1.0 if large else (a - 1 if middle else a)
    below = a if large else (a + 1 if middle else 1.0)
    start = math.pi / 2 if large else (math.pi / 4 if middle else 0.0)
    t = above / below
    q = t * t
    p = (-8.750608600031904e-1 * q - 1.615753718733365e1) * q - 7.500855792314705e1
    p = (p * q - 1.228866684490136e2) * q - 6.485021904942025e1
    d = ((q + 2.485846490142306e1) * q + 1.650270098316988e2) * q + 4.328810604912903e2
    d = (d * q + 4.853903996359137e2) * q + 1.945506571482614e2
    angle = start + t * q * p / d + t
    return angle if value >= 0 else -angle


@compiled
def falling_exponential(value: float) -> float:
    """Return exp(value) for 0 and below to 1e-13 (absolute); below -80 it is exp(-80).

    The series of exp(value / 256), squared eight times.
    """
    y = max(value, _LEAST_EXPONENT) / 256
    e = 1 + y / 8 * (1 + y / 9 * (1 + y / 10 * (1 + y / 11)))
    e = 1 + y * (1 + y / 2 * (1 + y / 3 * (1 + y / 4 * (1 + y / 5 * (1 + y / 6 * (1 + y / 7 * e))))))
    for _ in range(_DOUBLINGS):
        e *= e
    return e


@compiled
def log_of_one_plus(value: float) -> float:
    """Return ln(1 + value) above -1, to 1e-14 (relative) while 1 + value lies in 1/40 to 40, to 1e-8 in 1e-4 to 1e4.

    ln(1 + value) = 16 artanh(t), t = r / (r + 2), r = (1 + value)^(1/8) - 1, of which the series converges fast.
    """
    r = value / (math.sqrt(1 + value) + 1)
    r = r / (math.sqrt(1 + r) + 1)
    r = r / (math.sqrt(1 + r) + 1)
    t = r / (r + 2)
    q = t * t
    s = 1 / 13 + q * (1 / 15 + q * (1 / 17 + q * (1 / 19 + q * (1 / 21 + q / 23))))
    s = 1 / 3 + q * (1 / 5 + q * (1 / 7 + q * (1 / 9 + q * (1 / 11 + q * s))))
    return 16 * t * (1 + q * s)


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


LANES: Final = 16
"""Pixels that are computed side by side."""
SHAPES: Final = 4
"""Parameters of a curve: mode, ln FWHM, ln peak and the family's own one."""
CURVE_CONSTANTS: Final = 10
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
