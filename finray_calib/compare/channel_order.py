"""Whether two images of one scene agree better when the channels of one are exchanged."""

from dataclasses import dataclass
from itertools import permutations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
#: An exchange must at least halve the disagreement to be sure, and take a quarter off it to be mentioned.
_SURE, _LIKELY = 0.5, 0.75


@dataclass(frozen=True, slots=True)
class BetterOrder:
    """An order of channels that fits better than the stored one.

    Attributes
    ----------
    order : str
        Channels of the second image as they should be read, such as "BGR".
    differs_rel, differs_as_stored_rel : float
        Standard deviation of the logarithm of the ratio of both images with this order and as stored.
    correlation, correlation_as_stored : float
        Mean over channels of the correlation of the logarithms over the picture: the pattern, whatever the levels.
    """

    order: str
    differs_rel: float
    differs_as_stored_rel: float
    correlation: float
    correlation_as_stored: float

    @property
    def clear(self) -> bool:
        """Whether levels and patterns both speak for it."""
        return self.differs_rel < _SURE * self.differs_as_stored_rel and self.correlation > self.correlation_as_stored

    def __str__(self) -> str:
        """Say it with its numbers."""
        return (
            f"{self.order} much better than as RGB (they differ by {self.differs_rel:.1%} against "
            f"{self.differs_as_stored_rel:.1%} after one gain; their patterns correlate by {self.correlation:.2f} "
            f"against {self.correlation_as_stored:.2f})"
        )


def better_order(first: Floats, second: Floats, floor_rel: float) -> BetterOrder | None:
    """Return the order of the second image's channels that fits the first clearly better than the stored one.

    The disagreement is the standard deviation of log(second / first) over pixels and channels: one gain for all
    channels is free. Valid for channels that differ in level or in pattern; of a grey scene no order is better.

    Parameters
    ----------
    first, second : ndarray, shape (P, 3)
        Positive values of the same places.
    floor_rel : float
        Disagreement that is expected of a right order; below it nothing is said.

    Returns
    -------
    BetterOrder or None
    """
    reference, values = np.log(first), np.log(second)
    spreads = {order: float((values[:, order] - reference).std()) for order in permutations(range(3))}
    stored = (0, 1, 2)
    best = min(spreads, key=spreads.__getitem__)
    if spreads[stored] <= floor_rel or spreads[best] >= _LIKELY * spreads[stored]:
        return None
    return BetterOrder(
        "".join("RGB"[c] for c in best),
        spreads[best],
        spreads[stored],
        _correlation(reference, values[:, best]),
        _correlation(reference, values),
    )


def _correlation(first: Floats, second: Floats) -> float:
    """Return the mean over channels of the correlation over pixels; a channel without any pattern counts 0."""
    a, b = first - first.mean(axis=0), second - second.mean(axis=0)
    norm = np.sqrt((a * a).sum(axis=0) * (b * b).sum(axis=0))
    return float(np.divide((a * b).sum(axis=0), norm, out=np.zeros(3), where=norm > 0).mean())
