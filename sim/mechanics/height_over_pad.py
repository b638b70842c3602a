"""The least height of triangles over a curved face: where a body of triangles comes to touch on its way down."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from data_schemas.errors import SimulateError

FloatArray = NDArray[np.float64]

_CLOSE_MM = 1e-5  # the least height is known to this
_ENOUGH_MM = 0.004  # and at least to this: the chord of the facets of round bodies
_MOST_HALVINGS = 20
_MOST_TRIANGLES = 250_000  # to be divided: where a body runs along the face, none of them can be left out
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
            fan = np.stack([polygon[:-2], polygon[1:-1]], axis=1)
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
    r"""Return the least height of triangles (k, 3, 3) over a face that bulges towards them, to 1e-5 mm.

    .. math:: h \ge \min_i h_i - \frac{\kappa r^2}{2}, \quad r \le l / \sqrt 3

    with the heights h_i of a triangle's corners, the face's curvature kappa, the radius r of the smallest circle around
    the triangle in plan and its longest edge l (Jung). Triangles that cannot hold the least height are left out, the
    others divided by four; no more where over 250 000 are left, if that tells the height to 0.004 mm.

    Parameters
    ----------
    triangles_mm
        The triangles, y upwards.
    height_mm
        Height of points (m, 3) over the face.
    curvature_per_mm
        A bound of the face's second derivative; 0 for a plane.

    Raises
    ------
    SimulateError
        When the triangles run along the face in too many places for that.
    """
    least, left = np.inf, triangles_mm
    for _ in range(_MOST_HALVINGS):
        heights = height_mm(left.reshape(-1, 3)).reshape(-1, 3).min(axis=1)
        least = min(least, float(heights.min()))
        plan = left[..., [0, 2]]
        longest = np.linalg.norm(plan - np.roll(plan, 1, axis=1), axis=2).max(axis=1)
        lowest = heights - curvature_per_mm * longest**2 / 6.0
        left = left[lowest < least - _CLOSE_MM]
        if not len(left):
            break
        if len(left) > _MOST_TRIANGLES:
            _check_close(least - float(lowest.min()), len(left))
            break
        six = np.concatenate([left, (left + np.roll(left, -1, axis=1)) / 2.0], axis=1)
        left = six[:, _HALVES].reshape(-1, 3, 3)
    return least


def _check_close(off_mm: float, places: int) -> None:
    """Check that the least height is known well enough."""
    if off_mm > _ENOUGH_MM:
        raise SimulateError(
            f"the mesh of the indenter runs along the pad in {places} places, so that its first touch is known to "
            f"{off_mm:.2g} mm only, not to {_ENOUGH_MM:g} mm; give an STL of fewer triangles"
        )
