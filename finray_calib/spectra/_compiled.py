"""The only door to Numba: functions compiled to machine code, cached on disk, with elementary functions.

Every call inside is inlined. Left to itself, Numba inlines in the copy that it stores and not in the one that it runs
after compiling, so that reordered sums differ in their last digits between the first run and all later ones.

Numba renews a cached function when its own file changes, not when a function that it calls does. The cache therefore
lies in a folder named after the sources of all compiled functions: old machine code never meets new sources.

The elementary functions are made of arithmetic only, so that compiled loops compute several values in one instruction;
a call of the mathematical library keeps the compiler from doing so. All are exact to rounding or nearly so where an
emission curve is larger than 1e-9 of its peak.
"""

import hashlib
import math
import os
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path
from typing import Final, TypeVar

import numba

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
