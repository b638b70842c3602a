"""Edges of elements that shrink towards sharp inner corners, where stress and the error of a mesh gather."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sim.mechanics.structured_grid import divided


@dataclass(frozen=True, slots=True)
class CornerGrading:
    """How elements shrink towards the inner corners between ribs and fins.

    At a corner of 270 deg stress is infinite, and the error of even elements falls only as the 1.09th power of their
    edge: it is the first edge that counts, and edges may grow fast from there (Szabo and Babuska, Finite Element
    Analysis, 1991, chapter 10).

    Attributes
    ----------
    thickness_share
        First edge over the thickness of the thinnest of ribs and fins.
    growth_ratio
        An edge is at most this many times longer than its neighbour nearer to the corner, up to the next line that
        the grid has to meet.
    halvings
        How often edges in the side view are halved afterwards, but those of base plate and backing; for studies of
        convergence.
    """

    thickness_share: float
    growth_ratio: float
    halvings: int = 0


def graded(
    length_mm: float, first_mm: float, growth_ratio: float, longest_mm: float, corners: tuple[bool, bool] = (True, True)
) -> NDArray[np.float64]:
    """Return positions from 0 to a length whose steps grow from the ends that are corners.

    Parameters
    ----------
    length_mm
        Last position.
    first_mm
        Step at a corner.
    growth_ratio
        Largest ratio of a step to its neighbour nearer to the corner.
    longest_mm
        Largest step.
    corners
        Whether the first and the last position are corners.

    Returns
    -------
    ndarray
        Evenly divided where there is no room for a step at the corners beside one as long.
    """
    ends, steps, reached, step = sum(corners), [], 0.0, first_mm
    while ends and step < longest_mm and length_mm - ends * (reached + step) >= step:
        steps.append(step)
        reached, step = reached + step, step * growth_ratio
    from_end = np.cumsum([0.0, *steps])
    low, high = (from_end if is_corner else from_end[:1] for is_corner in corners)
    middle = divided([low[-1], length_mm - high[-1]], min(step, longest_mm) if steps else longest_mm)
    return np.concatenate([low[:-1], middle, length_mm - high[-2::-1]])


def fitted_between(pattern_mm: NDArray[np.float64], depth_mm: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return positions over depths (d,) like those of a symmetric pattern (n,), as shares, shape (n, d).

    Over a lesser depth steps at both ends keep their lengths, the others shrink, and at last all are even; over a
    greater one all grow.
    """
    from_end = np.arange(len(pattern_mm))[:, None] * (depth_mm / (len(pattern_mm) - 1))
    stretched = pattern_mm[:, None] * np.maximum(1.0, depth_mm / pattern_mm[-1])
    from_end = np.minimum(stretched, from_end) / depth_mm
    half = (len(pattern_mm) + 1) // 2
    return np.concatenate([from_end[:half], 1.0 - from_end[: len(pattern_mm) - half][::-1]])
