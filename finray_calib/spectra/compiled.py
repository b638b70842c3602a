"""The only door to Numba: functions compiled to machine code, cached on disk beside the package or for the user."""

from collections.abc import Callable
from typing import TypeVar

from numba import njit

Function = TypeVar("Function", bound=Callable[..., object])

_REORDER = {"reassoc", "contract", "arcp", "nsz"}  # sums may be reordered; infinities and NaN keep their meaning


def compiled(function: Function) -> Function:
    """Compile a function of floats and arrays at its first call; later processes load it from the cache.

    Division by zero gives an infinity, as in numpy, and raises nothing.
    """
    return njit(cache=True, fastmath=_REORDER, error_model="numpy")(function)  # type: ignore[no-any-return]
