"""Adaptive Monte Carlo propagation: draw until the numbers that are printed no longer change."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
BLOCK_DRAWS = 10_000
LARGEST_BLOCKS = 12
COVERAGE = 0.95
_LEAST_BLOCKS = 4
_WANTED_DIGITS = 2


@dataclass(frozen=True, slots=True)
class Propagated:
    """Hold the draws of the headline and of all else, and whether the rule was met.

    Attributes
    ----------
    draws : dict of str to ndarray
        Draws along the first axis.
    significant_digits : int
        Digits of the headline's standard uncertainty to half a unit of which estimate, standard uncertainty and both
        ends of the 95 % interval are stable: 2, or 1, or 0 where not even one is.
    """

    draws: dict[str, Floats]
    significant_digits: int


def propagate(block: Callable[[int], dict[str, Floats]], headline: str) -> Propagated:
    """Draw blocks until the headline's statistics are stable to two digits, at most 120,000 draws.

    After each block of 10,000 draws the mean y, the standard deviation u(y) and the ends of the 95 % interval are
    formed; with s the standard error of each over h blocks, the rule is 2 s < delta / 2, where delta is a unit of the
    last significant digit of u(y).

    Parameters
    ----------
    block : callable
        Number of draws -> named draws (along the first axis).
    headline : str
        The name that is watched.

    Returns
    -------
    Propagated

    References
    ----------
    JCGM 101:2008, 7.9.
    """
    blocks: list[dict[str, Floats]] = []
    statistics: list[tuple[float, float, float, float]] = []
    digits = 0
    while len(blocks) < LARGEST_BLOCKS and digits < _WANTED_DIGITS:
        blocks.append(block(BLOCK_DRAWS))
        values = blocks[-1][headline]
        low, high = ends(values)
        statistics.append((float(values.mean()), float(values.std(ddof=1)), float(low), float(high)))
        if len(blocks) >= _LEAST_BLOCKS:
            u = float(np.concatenate([b[headline] for b in blocks]).std(ddof=1))
            error = 2.0 * np.std(statistics, axis=0, ddof=1).max() / np.sqrt(len(blocks))
            digits = sum(bool(error <= numerical_tolerance(u, n)) for n in range(1, _WANTED_DIGITS + 1))
    return Propagated({name: np.concatenate([b[name] for b in blocks]) for name in blocks[0]}, digits)


def numerical_tolerance(u: float, significant_digits: int) -> float:
    """Return half a unit of the last significant digit of a standard uncertainty (JCGM 101:2008, 7.9.2)."""
    if not u > 0.0:
        return 0.0
    return float(0.5 * 10.0 ** (np.floor(np.log10(u)) - (significant_digits - 1)))


def ends(values: Floats) -> tuple[Floats, Floats]:
    """Return both ends of the probabilistically symmetric 95 % interval along the first axis."""
    tail = (1.0 - COVERAGE) / 2.0
    low, high = np.quantile(values, [tail, 1.0 - tail], axis=0)
    return np.asarray(low), np.asarray(high)
