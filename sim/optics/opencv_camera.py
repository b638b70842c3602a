"""Turn every point of a calibrated camera's picture into the ray that meets it.

OpenCV's own inversion gives the rays on a grid; a cubic spline through them is what the renderer and the pixel maps
evaluate. Directions are in OpenCV's axes: x right, y down, z forward.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BSpline, make_lsq_spline

from data_schemas.camera_calibration import CameraCalibration
from data_schemas.errors import SimulateError

Floats = NDArray[np.float64]

# OpenCV stops after five steps unless told otherwise, which leaves up to 0.2 px with a wide lens
_STEPS, _STEP_TOLERANCE = 500, 1e-13
_LARGEST_INVERSION_ERROR_PX = 1e-5
_BISECTIONS = 60
# grid of the spline: with 8 px per interval a lens of 120 deg is met to better than 1e-4 px
_INTERVAL_PX, _FEWEST_INTERVALS, _MOST_INTERVALS = 8.0, 64, 256
_DEGREE = 3


@dataclass(frozen=True, slots=True)
class RayTable:
    """Rays of a picture as a uniform cubic B-spline.

    ``coefficients`` (rows, columns, 3) stand at texel centres; the picture's edges lie 1.5 texels inside the outer
    edges, so that no value outside the picture was ever asked for.
    """

    coefficients: Floats

    def texture_place(self, film: Floats) -> Floats:
        """Return where in a texture of the coefficients (0..1) a point of the film (0..1, x right, y down) lies."""
        rows, columns = self.coefficients.shape[:2]
        intervals = np.array([columns, rows]) - _DEGREE
        return np.asarray((film * intervals + 1.5) / (intervals + _DEGREE))

    def directions(self, film: Floats) -> Floats:
        """Return unit directions (..., 3) of points (..., 2) of the film, x and y in 0..1."""
        points = film.reshape(-1, 2)
        weights = [_basis(points[:, axis], self.coefficients.shape[1 - axis] - _DEGREE) for axis in (0, 1)]
        (first_x, weight_x), (first_y, weight_y) = weights
        offsets = np.arange(_DEGREE + 1)
        near = self.coefficients[first_y[:, None, None] + offsets[:, None], first_x[:, None, None] + offsets]
        rays = np.einsum("nyxc,ny,nx->nc", near, weight_y, weight_x)
        rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
        return np.asarray(rays.reshape(*film.shape[:-1], 3))


def ray_table(calibration: CameraCalibration) -> RayTable:
    """Return the rays of a calibrated camera.

    Raises
    ------
    SimulateError
        When the distortion cannot be inverted somewhere in the picture.
    """
    size = np.array([calibration.width_px, calibration.height_px])
    intervals = np.clip(np.ceil(size / _INTERVAL_PX), _FEWEST_INTERVALS, _MOST_INTERVALS).astype(int)
    x, y = (np.linspace(0.0, 1.0, 2 * n + 1) for n in intervals)
    film = np.stack(np.meshgrid(x, y), -1)
    rays = rays_of_pixels(calibration, film * size - 0.5)
    along_rows = make_lsq_spline(y, rays, _knots(intervals[1]), k=_DEGREE).c
    return RayTable(np.moveaxis(make_lsq_spline(x, np.moveaxis(along_rows, 1, 0), _knots(intervals[0])).c, 0, 1))


def require_same_shape(calibration: CameraCalibration, width_px: int, height_px: int) -> None:
    """Refuse a picture whose sides have another ratio than the calibrated one; its size may differ.

    Raises
    ------
    SimulateError
        When the ratio differs by more than half a pixel of the smaller picture.
    """
    expected = width_px * calibration.height_px / calibration.width_px
    if abs(expected - height_px) > 0.5:
        raise SimulateError(
            f"{calibration.source} calibrates a picture of {calibration.width_px} x {calibration.height_px} px, the "
            f"design's camera has another shape ({width_px} x {height_px} in its rendering): set camera.width_px and "
            "camera.height_px to the calibrated size or a fraction of it"
        )


def rays_of_pixels(calibration: CameraCalibration, pixels: Floats) -> Floats:
    """Return the unit directions (..., 3) that a camera images onto points (..., 2) of its picture.

    Pinhole models are inverted by cv2.undistortPoints; fisheye models by bisection of theta_d(theta), because
    OpenCV's inversion ends at 90 deg from the axis.

    Raises
    ------
    SimulateError
        When the distortion cannot be inverted at one of the points: its polynomial turns round there.
    """
    points = np.ascontiguousarray(pixels.reshape(-1, 1, 2), dtype=np.float64)
    rays = (_fisheye_rays if calibration.model == "fisheye" else _pinhole_rays)(calibration, points)
    return np.asarray(rays.reshape(*pixels.shape[:-1], 3))


def camera_matrix_of(calibration: CameraCalibration) -> Floats:
    """Return OpenCV's 3 x 3 matrix."""
    (fx, fy), (cx, cy) = calibration.focal_px, calibration.centre_px
    return np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])


def _pinhole_rays(calibration: CameraCalibration, points: Floats) -> Floats:
    """Invert the pinhole model and make sure that it was inverted."""
    matrix, distortion = camera_matrix_of(calibration), np.array(calibration.distortion or (0.0,) * 4)
    criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, _STEPS, _STEP_TOLERANCE)
    plane = cv2.undistortPoints(points, matrix, distortion, criteria=criteria)
    rays = np.concatenate([plane, np.ones((len(plane), 1, 1))], axis=-1)
    back, jacobian = cv2.projectPoints(rays, np.zeros(3), np.zeros(3), matrix, distortion)
    error = np.linalg.norm((back - points)[:, 0], axis=-1)
    # moving the point by (dx, dy) must move its image the same way round: columns 3, 4 are the translation's
    turn = jacobian[0::2, 3] * jacobian[1::2, 4] - jacobian[0::2, 4] * jacobian[1::2, 3]
    _require_invertible(calibration, points, ~(error < _LARGEST_INVERSION_ERROR_PX) | ~(turn > 0.0))
    return np.asarray(rays / np.linalg.norm(rays, axis=-1, keepdims=True))


def _fisheye_rays(calibration: CameraCalibration, points: Floats) -> Floats:
    """Invert the fisheye model up to 180 deg from the axis."""
    k = np.array(calibration.distortion or (0.0,) * 4)
    plane = (points[:, 0] - np.array(calibration.centre_px)) / np.array(calibration.focal_px)
    distorted = np.linalg.norm(plane, axis=-1)

    def theta_d(theta: Floats) -> Floats:
        square = theta**2
        return np.asarray(theta * (1.0 + square * (k[0] + square * (k[1] + square * (k[2] + square * k[3])))))

    samples = np.linspace(0.0, np.pi, 4097)
    falls = np.flatnonzero(np.diff(theta_d(samples)) <= 0.0)
    last = samples[falls[0] if falls.size else -1]
    _require_invertible(calibration, points, ~(distorted <= theta_d(last)))
    low, high = np.zeros_like(distorted), np.full_like(distorted, last)
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        below = theta_d(middle) < distorted
        low, high = np.where(below, middle, low), np.where(below, high, middle)
    theta = 0.5 * (low + high)
    across = np.divide(np.sin(theta), distorted, out=np.ones_like(theta), where=distorted > 0.0)
    return np.column_stack([plane * across[:, None], np.cos(theta)])


def _require_invertible(calibration: CameraCalibration, points: Floats, bad: NDArray[np.bool_]) -> None:
    """Refuse a distortion that folds inside the picture."""
    if bad.any():
        column, row = points[int(np.argmax(bad)), 0]
        raise SimulateError(
            f"{calibration.source}: the {calibration.model} distortion cannot be inverted at {bad.mean():.1%} of the "
            f"picture, for example at column {column:.0f}, row {row:.0f}: its polynomial turns round there. Calibrate "
            "with boards that reach the corners, or with fewer coefficients"
        )


def _knots(intervals: int) -> Floats:
    """Return uniform knots on 0..1 that go on beyond both ends."""
    return np.asarray(np.arange(-_DEGREE, intervals + _DEGREE + 1) / intervals)


def _basis(x: Floats, intervals: int) -> tuple[NDArray[np.int64], Floats]:
    """Return the first coefficient that counts at each point, and the weights of the four."""
    place = x * intervals
    first = np.clip(np.floor(place), 0, intervals - 1).astype(np.int64)
    unit = BSpline.basis_element(np.arange(_DEGREE + 2.0), extrapolate=False)
    t = place - first
    return first, np.stack([np.nan_to_num(unit(t + _DEGREE - j)) for j in range(_DEGREE + 1)], -1)
