"""Millimetres per pixel where a calibrated camera sees a plane, and how well they are known.

The plane of the pad lies behind a board whose place is known. Scales are given at one place, as a range, over the board
and as a coarse map; their scatter is estimated by drawing the pictures of the board with replacement.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from data_schemas import LARGEST_WIDENED_FACTOR, CompareError, DistortionModel, LocalScale, PixelScale, ScaleRange
from finray_calib.sensing._lens_calibration import POSE, BoardView, LensCalibration, adjust, project

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


@dataclass(frozen=True, slots=True)
class BoardUncertainty:
    """What the user knows of the board and of the coat; uncertainties are standard ones.

    Attributes
    ----------
    square_u_rel
        Of the side of a printed square, relative to it.
    coat_behind_board_mm, coat_behind_board_u_mm
        From the printed face to the coat, away from the camera: the distance that the board's sheet keeps.
    """

    square_u_rel: float
    coat_behind_board_mm: float = 0.0
    coat_behind_board_u_mm: float = 0.0


def fitted_plane(found: LensCalibration, declared: BoardUncertainty, widened_factor: float = 1.0) -> SeenPlane:
    """Return the plane of the first view, its standard deviations widened by a factor."""
    size = len(found.lens) + POSE
    return SeenPlane(
        found.model,
        found.lens,
        found.poses[0],
        found.covariance[:size, :size] * widened_factor**2,
        declared.coat_behind_board_mm,
        declared.coat_behind_board_u_mm,
        declared.square_u_rel,
    )


def seen_plane(record: PixelScale) -> SeenPlane:
    """Return the plane of a record, to ask it for the scale anywhere in the picture."""
    calibration = record.calibration
    return SeenPlane(
        model=calibration.model,
        lens=np.array([*calibration.focal_px, *calibration.centre_px, *calibration.distortion]),
        pose=np.array(record.place),
        covariance=record.covariance * record.widened_factor**2,
        behind_mm=record.coat_behind_board_mm,
        behind_u_mm=record.coat_behind_board_u_mm,
        square_u_rel=record.square_u_rel,
    )


_MAP_COLUMNS, _MAP_ROWS = 33, 25
#: Where the map is known less well than this, pictures of the board did not reach: nothing is stated there.
_UNKNOWN_U_REL = 0.1
_OVER_BOARD = 9


def local_scale(found: ScaleDraws, pixel: Floats) -> LocalScale:
    """Return the scale at the only place that was asked for, a pixel (2,)."""
    (x, y, mean), (u_x, u_y, u_mean) = found.mm_per_px[0], found.u_rel[0]
    return LocalScale(
        column_px=float(pixel[0]),
        row_px=float(pixel[1]),
        along_x_mm_per_px=float(x),
        along_y_mm_per_px=float(y),
        mean_mm_per_px=float(mean),
        along_x_u_rel=float(u_x),
        along_y_u_rel=float(u_y),
        mean_u_rel=float(u_mean),
    )


def scale_range(scales: Floats) -> ScaleRange:
    """Return the range of scales (N, 3), of which some are finite."""
    low, high = np.nanmin(scales, axis=0), np.nanmax(scales, axis=0)
    return ScaleRange(
        along_x_low_mm_per_px=float(low[0]),
        along_x_high_mm_per_px=float(high[0]),
        along_y_low_mm_per_px=float(low[1]),
        along_y_high_mm_per_px=float(high[1]),
    )


def range_over_board(plane: SeenPlane, pad: BoardView) -> ScaleRange:
    """Return the range over the part of the picture that the board covers."""
    share = np.linspace(0.0, 1.0, _OVER_BOARD)
    low, high = pad.places_mm.min(axis=0), pad.places_mm.max(axis=0)
    grid = np.stack(np.meshgrid(*(low[i] + share * (high[i] - low[i]) for i in (0, 1))), -1).reshape(-1, 2)
    pixels = project(plane.model, plane.lens, plane.pose, np.column_stack([grid, np.zeros(len(grid))]))[0]
    return scale_range(scales_only(plane, pixels))


def scale_map(plane: SeenPlane, size_px: tuple[int, int]) -> dict[str, Any]:
    """Return the fields of a record that hold a coarse map over the picture, NaN where the scale is not known."""
    columns, rows = (
        np.linspace(0.0, side - 1.0, count) for side, count in zip(size_px, (_MAP_COLUMNS, _MAP_ROWS), strict=True)
    )
    pixels = np.stack(np.meshgrid(columns, rows), -1).reshape(-1, 2)
    found = plane_scale(plane, pixels)
    unknown = ~(found.u_rel.max(axis=1) <= _UNKNOWN_U_REL)
    scales, u_rel = found.mm_per_px.copy(), found.u_rel.copy()
    scales[unknown], u_rel[unknown] = np.nan, np.nan
    shape = (len(rows), len(columns), 3)
    return {
        "map_columns_px": columns,
        "map_rows_px": rows,
        "map_mm_per_px": scales.reshape(shape),
        "map_u_rel": u_rel.reshape(shape),
    }


RESAMPLINGS = 60
"""Standard deviations from as many are good to a tenth."""
#: Resampled pictures scatter by up to this factor more by chance; beyond it corners of one picture err together.
_SCATTER_FACTOR = 1.5


def resampled_scatter_rel(
    views: Sequence[BoardView],
    found: LensCalibration,
    declared: BoardUncertainty,
    middle_px: Floats,
    rng: np.random.Generator,
) -> float:
    """Return the relative scatter of the mean scale over pictures drawn with replacement.

    There is only one picture of the pad: its corners get the residuals of its own corners, drawn with replacement.

    Parameters
    ----------
    views
        The board on the pad, then in other places.
    found
        Lens and places that all of them give.
    declared
        Tolerances that no picture shows.
    middle_px
        (2,) where on the pad the scale is asked for.
    rng
        Of the drawing.

    Raises
    ------
    CompareError
        Without one or two of the pictures the lens is not determined.
    """
    pad, count = views[0], len(views) - 1
    fitted = _fitted_pixels(found, pad)
    errors = pad.pixels - fitted
    # residuals are smaller than errors by what the pose took
    errors *= np.sqrt(errors.size / max(errors.size - POSE, 1))
    values = []
    for _ in range(RESAMPLINGS):
        drawn = BoardView(pad.name, pad.places_mm, fitted + errors[rng.integers(len(errors), size=len(errors))])
        weights = np.concatenate([[1], np.bincount(rng.integers(count, size=count), minlength=count)]).astype(float)
        kept = weights > 0
        chosen = [drawn, *(view for view, keep in zip(views[1:], kept[1:], strict=True) if keep)]
        try:
            again = adjust(
                chosen, (found.width_px, found.height_px), found.model, found.lens, found.poses[kept], weights[kept]
            )
        except CompareError:
            continue
        values.append(float(np.log(scales_only(fitted_plane(again, declared), middle_px[None])[0, 2])))
    usable = np.array([v for v in values if np.isfinite(v)])
    if len(usable) < RESAMPLINGS // 2:
        raise CompareError(
            "there are too few pictures, because the lens is not determined without one or two of them. Take more "
            "pictures, with the board tilted in several directions"
        )
    # quantiles: a draw of few alike pictures may lie far out
    low, high = np.quantile(usable, [0.1587, 0.8413])
    return float(high - low) / 2.0


def _fitted_pixels(found: LensCalibration, pad: BoardView) -> Floats:
    """Return where the corners of the first view should be."""
    places = np.column_stack([pad.places_mm, np.zeros(len(pad.places_mm))])
    return project(found.model, found.lens, found.poses[0], places)[0]


def widened_factor(resampled_u_rel: float, at_middle: ScaleDraws) -> float:
    """Return the factor on the covariance's standard deviations that resampling asks for.

    Raises
    ------
    CompareError
        The factor is larger than can be stated.
    """
    parts = at_middle.parts_rel
    of_covariance = float(np.hypot(parts["corners of the board on the pad"][0, 2], parts["lens"][0, 2]))
    # corners without any error leave nothing to widen
    ratio = resampled_u_rel / of_covariance if of_covariance > 0.0 else 1.0
    if ratio > LARGEST_WIDENED_FACTOR:
        raise CompareError(
            f"when the pictures are resampled (bootstrap), the scale scatters {ratio:.0f} times as much as the errors "
            f"of corners and lens explain, but at most {LARGEST_WIDENED_FACTOR:g} times is allowed. One or two "
            "pictures alone determine the lens, or the board is not rigid; take more pictures, of a stiff board"
        )
    return ratio if ratio > _SCATTER_FACTOR else 1.0
