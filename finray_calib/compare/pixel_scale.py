"""Millimetres per pixel where a calibrated camera sees a plane, and how well they are known."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from data_schemas.camera_calibration import DistortionModel
from finray_calib.compare.lens_calibration import POSE, project

Floats = NDArray[np.float64]

#: Sensitivities are central differences over this many standard deviations: the scale is all but linear in them.
_STEP_SD = 0.1
_INVERSION = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 200, 1e-12)
#: Of the inversion of the lens, back in the picture.
_LARGEST_INVERSION_ERROR_PX = 1e-3


@dataclass(frozen=True, slots=True)
class SeenPlane:
    """A lens, the board's place, and where the plane of interest lies behind the board.

    Attributes
    ----------
    lens
        (n,) fx, fy, cx, cy and the coefficients of the distortion.
    pose
        (6,) rotation vector and translation in mm, from the board to the camera.
    covariance
        (n + 6, n + 6) of both.
    behind_mm, behind_u_mm
        Distance of the plane from the board, away from the camera, and its standard uncertainty.
    square_u_rel
        Standard uncertainty of the printed squares, relative: all lengths are in proportion to them.
    """

    model: DistortionModel
    lens: Floats
    pose: Floats
    covariance: Floats
    behind_mm: float = 0.0
    behind_u_mm: float = 0.0
    square_u_rel: float = 0.0


@dataclass(frozen=True, slots=True)
class ScaleDraws:
    """Scales at N places with their relative standard uncertainties, and the parts of these.

    Attributes
    ----------
    mm_per_px
        (N, 3) along rows (x), along columns (y), and the root of the area of a pixel; NaN where the plane is not seen.
    u_rel
        (N, 3), all together.
    parts_rel
        name -> (N, 3), of independent inputs; their squares add up to u_rel squared.
    """

    mm_per_px: Floats
    u_rel: Floats
    parts_rel: dict[str, Floats]


def plane_scale(plane: SeenPlane, pixels: Floats) -> ScaleDraws:
    """Return the local scale at pixels, with uncertainty.

    With (u, v) = project(X, Y) from the plane to the picture, s_x = |d(X, Y)/du|, s_y = |d(X, Y)/dv| and s = root of
    |det d(X, Y)/d(u, v)|. First order in all inputs; the corners, the lens and the place share one covariance.

    Parameters
    ----------
    plane
        The lens and the plane.
    pixels
        (N, 2) columns and rows; whole numbers are pixel centres.
    """
    n = len(plane.lens)
    best = np.concatenate([plane.lens, plane.pose, [plane.behind_mm]])
    scales = _scales(plane.model, best, n, pixels)
    log_slopes = np.empty((*scales.shape, n + POSE))
    for index in range(n + POSE):
        sd = np.sqrt(plane.covariance[index, index])
        log_slopes[..., index] = _slope(plane.model, best, n, pixels, index, _STEP_SD * sd)
    covariance = plane.covariance
    together = np.einsum("nsi,ij,nsj->ns", log_slopes, covariance, log_slopes)
    of_pose = _given_lens(covariance, n)
    corners = np.einsum("nsi,ij,nsj->ns", log_slopes[..., n:], of_pose, log_slopes[..., n:])
    behind = np.zeros_like(scales)
    if plane.behind_u_mm > 0.0:
        behind = np.abs(_slope(plane.model, best, n, pixels, n + POSE, plane.behind_u_mm)) * plane.behind_u_mm
    parts = {
        "corners of the board on the pad": np.sqrt(corners),
        "lens": np.sqrt(np.maximum(together - corners, 0.0)),
        "printed squares": np.where(np.isfinite(scales), plane.square_u_rel, np.nan),
        "distance of the coat from the board": behind,
    }
    total = np.sqrt(sum((part**2 for part in parts.values()), np.zeros_like(scales)))
    return ScaleDraws(scales, total, parts)


def scales_only(plane: SeenPlane, pixels: Floats) -> Floats:
    """Return the scales of :func:`plane_scale` alone."""
    values = np.concatenate([plane.lens, plane.pose, [plane.behind_mm]])
    return _scales(plane.model, values, len(plane.lens), pixels)


def plane_places_mm(plane: SeenPlane, pixels: Floats) -> Floats:
    """Return where on the plane pixels (N, 2) look, in the board's axes (N, 2); NaN where they do not see it."""
    values = np.concatenate([plane.lens, plane.pose, [plane.behind_mm]])
    return _places(plane.model, values, len(plane.lens), pixels)[0]


def _slope(model: DistortionModel, best: Floats, n: int, pixels: Floats, index: int, step: float) -> Floats:
    """Return the derivative (N, 3) of the log of the scales by one parameter."""
    if step == 0.0:
        return np.zeros((len(pixels), 3))
    both = []
    for sign in (1.0, -1.0):
        moved = best.copy()
        moved[index] += sign * step
        both.append(np.log(_scales(model, moved, n, pixels)))
    return np.asarray((both[0] - both[1]) / (2.0 * step))


def _given_lens(covariance: Floats, n: int) -> Floats:
    """Return the covariance of the pose for a known lens: what the corners of one picture leave open."""
    sd = np.sqrt(np.diag(covariance)[:n])
    sd[sd == 0.0] = 1.0
    across = covariance[n:, :n] / sd
    correlation = covariance[:n, :n] / np.outer(sd, sd)
    return np.asarray(covariance[n:, n:] - across @ np.linalg.pinv(correlation, rcond=1e-12, hermitian=True) @ across.T)


def _scales(model: DistortionModel, values: Floats, n: int, pixels: Floats) -> Floats:
    """Return scales (N, 3) for lens, pose and distance in one vector."""
    lens, turn = values[:n], cv2.Rodrigues(values[n : n + 3])[0]
    places, shift = _places(model, values, n, pixels)
    seen = np.isfinite(places).all(axis=1)
    scales = np.full((len(pixels), 3), np.nan)
    if not seen.any():
        return scales
    pose = np.concatenate([values[n : n + 3], shift])
    _, columns = project(model, lens, pose, np.column_stack([places[seen], np.zeros(int(seen.sum()))]))
    # a step on the plane moves the point in front of the camera as a step of the translation does
    forward = columns[:, :, n + 3 :] @ turn[:, :2]
    with np.errstate(all="ignore"):
        inverse = np.linalg.inv(forward)
    scales[seen, 0] = np.linalg.norm(inverse[:, :, 0], axis=1)
    scales[seen, 1] = np.linalg.norm(inverse[:, :, 1], axis=1)
    scales[seen, 2] = np.sqrt(np.abs(np.linalg.det(inverse)))
    return scales


def _places(model: DistortionModel, values: Floats, n: int, pixels: Floats) -> tuple[Floats, Floats]:
    """Return places (N, 2) on the plane and the translation to it."""
    lens = values[:n]
    turn, shift = cv2.Rodrigues(values[n : n + 3])[0], values[n + 3 : n + POSE]
    normal = turn[:, 2] * (1.0 if turn[:, 2] @ shift >= 0.0 else -1.0)
    shift = shift + values[n + POSE] * normal
    rays = _rays(model, lens, pixels)
    with np.errstate(all="ignore"):
        distances = (normal @ shift) / (rays @ normal)
    distances[~(distances > 0.0)] = np.nan
    points = rays * distances[:, None] - shift
    return np.asarray(points @ turn[:, :2]), np.asarray(shift)


def _rays(model: DistortionModel, lens: Floats, pixels: Floats) -> Floats:
    """Return rays (N, 3) with z = 1 of pixels; NaN where the lens cannot be inverted."""
    matrix = np.array([[lens[0], 0.0, lens[2]], [0.0, lens[1], lens[3]], [0.0, 0.0, 1.0]])
    points = np.ascontiguousarray(pixels, dtype=np.float64).reshape(-1, 1, 2)
    if model == "fisheye":
        plane = cv2.fisheye.undistortPoints(points, matrix, lens[4:], criteria=_INVERSION)
    else:
        plane = cv2.undistortPoints(points, matrix, lens[4:], criteria=_INVERSION)
    rays: Floats = np.column_stack([np.asarray(plane, dtype=np.float64).reshape(-1, 2), np.ones(len(points))])
    rays[~np.isfinite(rays).all(axis=1) | (np.abs(rays).max(axis=1) > 1e3)] = np.nan
    good = np.isfinite(rays).all(axis=1)
    if good.any():
        back = project(model, lens, np.zeros(POSE), rays[good])[0]
        off = np.linalg.norm(back - pixels[good], axis=1) > _LARGEST_INVERSION_ERROR_PX
        rays[np.flatnonzero(good)[off]] = np.nan
    return np.asarray(rays)
