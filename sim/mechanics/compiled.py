"""The only door to Numba in the mechanics: functions compiled to machine code and cached beside their source.

Numba renews a cached function when its own file changes, not when a function that it calls does. A compiled function
therefore calls only compiled functions of its own file.
"""

from collections.abc import Callable
from typing import TypeVar

import numba

Function = TypeVar("Function", bound=Callable[..., object])

_REORDER = {"reassoc", "contract", "arcp", "nsz"}  # sums may be reordered; infinities and NaN keep their meaning


def compiled(function: Function) -> Function:
    """Compile a function of floats and arrays at its first call; it releases the interpreter's lock.

    Division by zero gives an infinity, as in numpy, and raises nothing.
    """
    dispatcher: Function = numba.njit(cache=True, nogil=True, fastmath=_REORDER, error_model="numpy")(function)
    return dispatcher
