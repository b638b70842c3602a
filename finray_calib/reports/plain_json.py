"""Records and numbers as plain JSON types; a number that is not finite becomes null."""

import math
from typing import Any

import numpy as np

from data_schemas.estimate import Estimate

Json = dict[str, Any]


def plain(value: Any) -> Any:
    """Return plain JSON types: numpy scalars and arrays as numbers and lists, null for what is not finite."""
    if isinstance(value, dict):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, np.generic | np.ndarray):
        return plain(value.tolist())
    return None if isinstance(value, float) and not math.isfinite(value) else value


def estimate_json(value: Estimate, truth: float | None = None) -> Json:
    """Return estimate and 95 % interval, beside the truth where it is known."""
    numbers: Json = {"estimate": value.estimate, "low95": value.low95, "high95": value.high95}
    return numbers if truth is None else {**numbers, "truth": truth}
