"""The only door to Numba: functions compiled to machine code, cached on disk for the user.

Every call inside is inlined. Left to itself, Numba inlines in the copy that it stores and not in the one that it runs
after compiling, so that reordered sums differ in their last digits between the first run and all later ones.

Numba renews a cached function when its own file changes, not when a function that it calls does. The cache therefore
lies in a folder named after the sources of all compiled functions: old machine code never meets new sources.
"""

import hashlib
import os
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path
from typing import TypeVar

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
