"""Numbers out of a libcamera tuning file, and its tables by colour temperature."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from data_schemas.errors import ImportFormatError

Floats = NDArray[np.float64]


def by_temperature(entries: Any, name: str, key: str, shape: tuple[int, int]) -> tuple[Floats, Floats]:
    """Return colour temperatures (T,), increasing, and the tables of `key` as (T, *shape).

    Raises
    ------
    ImportFormatError
        An entry has no temperature or table, temperatures do not increase, or a table is not numbers of the shape.
    """
    if not isinstance(entries, list) or not all(isinstance(e, Mapping) and "ct" in e and key in e for e in entries):
        raise ImportFormatError(f"tuning: {name} must be a list of objects with 'ct' (K) and '{key}'")
    temperature_k = numbers([e["ct"] for e in entries], f"{name} ct", (-1,))
    if (np.diff(temperature_k) <= 0).any():
        raise ImportFormatError(f"tuning: {name} must be in increasing order of 'ct', got {temperature_k.tolist()} K")
    return temperature_k, numbers([e[key] for e in entries], f"{name} {key}", (len(entries), *shape))


def at_temperature(temperature_k: Floats, tables: Floats, wanted_k: float) -> Floats:
    """Return the table at a colour temperature: linear between entries, end tables held."""
    position = float(np.interp(wanted_k, temperature_k, np.arange(len(temperature_k))))
    low = min(int(position), max(len(tables) - 2, 0))
    high = min(low + 1, len(tables) - 1)
    share = position - low
    return np.asarray((1.0 - share) * tables[low] + share * tables[high])


def numbers(values: Any, name: str, shape: tuple[int, ...]) -> Floats:
    """Return finite numbers in a shape.

    Raises
    ------
    ImportFormatError
        They are no numbers, not finite, or do not fill the shape.
    """
    try:
        array = np.array(values, dtype=np.float64).reshape(shape)
    except (TypeError, ValueError):
        raise ImportFormatError(
            f"tuning: {name} is not an array of numbers of shape {shape}; is the file whole?"
        ) from None
    if not np.isfinite(array).all():
        raise ImportFormatError(f"tuning: {name} holds NaN or infinite numbers; is the file whole?")
    return array
