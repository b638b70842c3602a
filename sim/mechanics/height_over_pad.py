"""The least height of triangles over a curved face: where a body of triangles comes to touch on its way down."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

_CLOSE_MM = 1e-5  # the least height is known to this
_MOST_HALVINGS = 20
_HALVES = ((0, 3, 5), (3, 1, 4), (5, 4, 2), (3, 4, 5))  # of a triangle's corners and the middles of its edges


def over_rectangle(corners_mm: FloatArray, x_mm: tuple[float, float], z_mm: tuple[float, float]) -> FloatArray:
    """Return the parts of triangles (k, 3, 3) that lie over a rectangle in x and z, as triangles (m, 3, 3)."""
    low, high = corners_mm.min(axis=1), corners_mm.max(axis=1)
    bounds = ((0, *x_mm), (2, *z_mm))
    meets = np.all([(low[:, axis] <= last) & (high[:, axis] >= first) for axis, first, last in bounds], axis=0)
    inside = np.all([(low[:, axis] >= first) & (high[:, axis] <= last) for axis, first, last in bounds], axis=0)
    parts = [corners_mm[inside]]
    for triangle in corners_mm[meets & ~inside]:
        polygon = triangle
        for axis, first, last in bounds:
            polygon = _above(polygon, polygon[:, axis] - first)
            polygon = _above(polygon, last - polygon[:, axis])
        if len(polygon):
            fan = np.stack([polygon[:-1], np.roll(polygon[:-1], -1, axis=0)], axis=1)
            parts.append(np.concatenate([np.broadcast_to(polygon[-1], (len(fan), 1, 3)), fan], axis=1))
    return np.concatenate(parts)


def _above(polygon: FloatArray, beyond: FloatArray) -> FloatArray:
    """Return the part of a convex polygon (k, 3) where a linear function, given at its points, is not negative."""
    kept = []
    for here in range(len(polygon)):
        before = here - 1
        if (beyond[here] < 0.0) != (beyond[before] < 0.0):
            share = beyond[before] / (beyond[before] - beyond[here])
            kept.append(polygon[before] + share * (polygon[here] - polygon[before]))
        if beyond[here] >= 0.0:
            kept.append(polygon[here])
    return np.array(kept).reshape(-1, 3)


def least_over_triangles(
    triangles_mm: FloatArray, height_mm: Callable[[FloatArray], FloatArray], curvature_per_mm: float
) -> float:
    """Return the least height of triangles (k, 3, 3) over a face that bulges towards them, to 1e-5 mm.

    The height is convex on a triangle, and below its corners by at most half of its curvature times the square of the
    longest edge in plan: triangles that cannot hold the least one are left out, the others divided by four.

    Parameters
    ----------
    triangles_mm
        The triangles, y upwards.
    height_mm
        Height of points (m, 3) over the face.
    curvature_per_mm
        A bound of the face's second derivative; 0 for a plane.
    """
    least, left = np.inf, triangles_mm
    for _ in range(_MOST_HALVINGS):
        heights = height_mm(left.reshape(-1, 3)).reshape(-1, 3).min(axis=1)
        least = min(least, float(heights.min()))
        plan = left[..., [0, 2]]
        longest = np.linalg.norm(plan - np.roll(plan, 1, axis=1), axis=2).max(axis=1)
        left = left[heights - 0.5 * curvature_per_mm * longest**2 < least - _CLOSE_MM]
        if not len(left):
            break
        six = np.concatenate([left, (left + np.roll(left, -1, axis=1)) / 2.0], axis=1)
        left = six[:, _HALVES].reshape(-1, 3, 3)
    return least
