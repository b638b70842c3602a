"""From pictures of a ChArUco board, one of them on the pad, to the record of the scale on the pad."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from data_schemas.camera_calibration import CameraCalibration, DistortionModel
from data_schemas.errors import CompareError
from data_schemas.pixel_scale import (
    LARGEST_WIDENED_FACTOR,
    BoardResidual,
    LocalScale,
    PixelScale,
    ScaleContribution,
    ScaleRange,
)
from data_schemas.tactile import CharucoBoard
from finray_calib.compare.board_corners import BoardView, require_plausible
from finray_calib.compare.corner_refinement import refined_views
from finray_calib.compare.lens_calibration import LEAST_VIEWS, POSE, LensCalibration, adjust, calibrate_lens, project
from finray_calib.compare.pixel_scale import ScaleDraws, SeenPlane, plane_scale, scales_only

Floats = NDArray[np.float64]

RESAMPLINGS = 60
"""Standard deviations from as many are good to a tenth."""
MOST_OBLIQUE_DEG = 70.0
LARGEST_U_REL = 0.05
#: Resampled pictures scatter by up to this factor more by chance; beyond it corners of one picture err together.
_SCATTER_FACTOR = 1.5
#: A picture of the pad that fits this much worse than the others was taken through something that these were not.
_WORSE_FACTOR = 2.0
_MAP_COLUMNS, _MAP_ROWS = 33, 25
#: Where the map is known less well than this, pictures of the board did not reach: nothing is stated there.
_UNKNOWN_U_REL = 0.1
_OVER_BOARD = 9


@dataclass(frozen=True, slots=True)
class Declared:
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


def pixel_scale(
    pad: BoardView,
    lens_views: Sequence[BoardView],
    size_px: tuple[int, int],
    board: CharucoBoard,
    declared: Declared,
    seed: int,
    model: DistortionModel | None = None,
    pictures: Mapping[str, NDArray[np.uint8]] | None = None,
) -> PixelScale:
    """Calibrate the lens and the place of the board together, and state the scale on the pad.

    Uncertainties are first order from the joint covariance; pictures drawn with replacement check it, and where they
    scatter by half as much again, they decide.

    Parameters
    ----------
    pad
        The board where the pad is.
    lens_views
        The board in other places, turned and tilted; of the same camera with the same focus.
    size_px
        Width and height of the pictures.
    board
        What was printed.
    declared
        Tolerances that no picture shows.
    seed
        Of the resampling.
    model
        Of the lens; by default the one that fits better.
    pictures
        (H, W) by name of the view: corners are then found again in the plane of the board.

    Raises
    ------
    CompareError
        The board cannot be what it is said to be, the lens is not determined, the board on the pad is seen too
        obliquely, or the scale is known to worse than 5 %.
    """
    require_plausible(board)
    if len(lens_views) < LEAST_VIEWS:
        raise CompareError(
            f"{len(lens_views)} usable pictures of the board beside that on the pad: give {LEAST_VIEWS} or more (ten "
            "are good), each with the board turned and tilted otherwise"
        )
    views = [pad, *lens_views]
    found = _best_lens(views, size_px, model)
    if pictures is not None:
        views = refined_views(views, pictures, found, board)
        pad, found = views[0], adjust(views, size_px, found.model, found.lens, found.poses)
    _require_facing(found, pad)
    resampled_u = _resampled_u(views, found, declared, pad.pixels.mean(axis=0), np.random.default_rng(seed))
    return _record(views, found, board, declared, resampled_u)


def _record(
    views: Sequence[BoardView], found: LensCalibration, board: CharucoBoard, declared: Declared, resampled_u: float
) -> PixelScale:
    """Return the record of a fitted lens and board, of which the first view is that on the pad."""
    pad, size_px = views[0], (found.width_px, found.height_px)
    middle_px = pad.pixels.mean(axis=0)
    plane = _plane(found, declared)
    at_middle = plane_scale(plane, middle_px[None])
    widened = _widened(resampled_u, at_middle)
    if widened > 1.0:
        plane = _plane(found, declared, widened)
        at_middle = plane_scale(plane, middle_px[None])
    _require_known(at_middle, pad)
    columns, rows, scale_map = _map(plane, size_px)
    residuals = [
        BoardResidual(file=view.name, corners=len(view.pixels), rms_px=float(rms), mirrored=view.mirrored)
        for view, rms in zip(views, found.view_rms_px, strict=True)
    ]
    n = len(found.lens)
    place = tuple(float(v) for v in found.poses[0])
    return PixelScale(
        board=board,
        square_u_rel=declared.square_u_rel,
        coat_behind_board_mm=declared.coat_behind_board_mm,
        coat_behind_board_u_mm=declared.coat_behind_board_u_mm,
        calibration=_calibration(found),
        place=(place[0], place[1], place[2], place[3], place[4], place[5]),
        covariance=found.covariance[: n + POSE, : n + POSE],
        widened_factor=widened,
        corner_sd_px=found.corner_sd_px,
        degrees_of_freedom=found.degrees_of_freedom,
        pad_picture=residuals[0],
        lens_pictures=tuple(residuals[1:]),
        middle=local_scale(at_middle, middle_px, 0),
        over_board=_over_board(plane, pad),
        budget=tuple(ScaleContribution(input=k, u_rel=float(v[0, 2])) for k, v in at_middle.parts_rel.items()),
        resampled_u_rel=resampled_u,
        map_columns_px=columns,
        map_rows_px=rows,
        map_mm_per_px=scale_map.mm_per_px.reshape(len(rows), len(columns), 3),
        map_u_rel=scale_map.u_rel.reshape(len(rows), len(columns), 3),
        notes=_notes(found, residuals, widened, resampled_u),
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


def local_scale(found: ScaleDraws, pixel: Floats, index: int) -> LocalScale:
    """Return the scale at one of the places that were asked for."""
    (x, y, mean), (u_x, u_y, u_mean) = found.mm_per_px[index], found.u_rel[index]
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


def _best_lens(views: Sequence[BoardView], size_px: tuple[int, int], model: DistortionModel | None) -> LensCalibration:
    """Return the calibration by a model, or by the one that leaves less."""
    if model is not None:
        return calibrate_lens(views, size_px, model)
    found, refused = [], []
    models: tuple[DistortionModel, ...] = ("fisheye", "pinhole")
    for tried in models:
        try:
            found.append(calibrate_lens(views, size_px, tried))
        except CompareError as error:
            refused.append(error)
    if not found:
        raise refused[0]
    return min(found, key=lambda lens: lens.corner_sd_px)


def _plane(found: LensCalibration, declared: Declared, widened: float = 1.0) -> SeenPlane:
    """Return the plane of the first view."""
    size = len(found.lens) + POSE
    return SeenPlane(
        found.model,
        found.lens,
        found.poses[0],
        found.covariance[:size, :size] * widened**2,
        declared.coat_behind_board_mm,
        declared.coat_behind_board_u_mm,
        declared.square_u_rel,
    )


def _calibration(found: LensCalibration) -> CameraCalibration:
    """Return the lens as designs name it."""
    fx, fy, cx, cy, *distortion = (float(v) for v in found.lens)
    return CameraCalibration(
        model=found.model,
        width_px=found.width_px,
        height_px=found.height_px,
        focal_px=(fx, fy),
        centre_px=(cx, cy),
        distortion=tuple(distortion),
        source="pictures of a ChArUco board",
    )


def _require_facing(found: LensCalibration, pad: BoardView) -> None:
    """Refuse a board on the pad that is seen from the side."""
    turn = cv2.Rodrigues(found.poses[0][:3])[0]
    middle = turn[:, :2] @ pad.places_mm.mean(axis=0) + found.poses[0][3:]
    cosine = float(abs(turn[:, 2] @ middle) / np.linalg.norm(middle))
    angle_deg = float(np.rad2deg(np.arccos(min(cosine, 1.0))))
    if angle_deg > MOST_OBLIQUE_DEG:
        raise CompareError(
            f"{pad.name}: the board on the pad is seen at {angle_deg:.0f} deg from its normal, up to "
            f"{MOST_OBLIQUE_DEG:g} deg can be measured: is it flat on the pad, and is this the picture of it?"
        )


def _require_known(found: ScaleDraws, pad: BoardView) -> None:
    """Refuse a scale that is hardly known."""
    u_rel = float(found.u_rel[0].max())
    if not u_rel <= LARGEST_U_REL:
        worst = max(found.parts_rel, key=lambda name: float(found.parts_rel[name][0].max()))
        raise CompareError(
            f"{pad.name}: the scale is known to {u_rel:.0%} only, {LARGEST_U_REL:.0%} is allowed; most comes from "
            f"'{worst}'. Show more of the board, larger in the picture, and take more pictures with it turned and "
            "tilted"
        )


def _resampled_u(
    views: Sequence[BoardView], found: LensCalibration, declared: Declared, middle_px: Floats, rng: np.random.Generator
) -> float:
    """Return the relative scatter of the mean scale over pictures drawn with replacement.

    The picture of the pad is one of a kind: its corners get the residuals of its own corners, drawn with replacement.
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
        values.append(float(np.log(scales_only(_plane(again, declared), middle_px[None])[0, 2])))
    usable = np.array([v for v in values if np.isfinite(v)])
    if len(usable) < RESAMPLINGS // 2:
        raise CompareError(
            "the lens rests on too few pictures: without one or two of them it is not determined. Take more, with the "
            "board tilted in several directions"
        )
    # quantiles: a draw of few alike pictures may lie far out
    low, high = np.quantile(usable, [0.1587, 0.8413])
    return float(high - low) / 2.0


def _fitted_pixels(found: LensCalibration, pad: BoardView) -> Floats:
    """Return where the corners of the first view should be."""
    places = np.column_stack([pad.places_mm, np.zeros(len(pad.places_mm))])
    return project(found.model, found.lens, found.poses[0], places)[0]


def _widened(resampled_u: float, at_middle: ScaleDraws) -> float:
    """Return the factor on the covariance's standard deviations that resampling asks for."""
    parts = at_middle.parts_rel
    of_covariance = float(np.hypot(parts["corners of the board on the pad"][0, 2], parts["lens"][0, 2]))
    # corners without any error leave nothing to widen
    ratio = resampled_u / of_covariance if of_covariance > 0.0 else 1.0
    if ratio > LARGEST_WIDENED_FACTOR:
        raise CompareError(
            f"the scale scatters {ratio:.0f} times as much when pictures are drawn with replacement as independent "
            f"corners allow; up to {LARGEST_WIDENED_FACTOR:g} times can be stated: the lens rests on one or two of the "
            "pictures, or the board was not rigid. Take more pictures"
        )
    return ratio if ratio > _SCATTER_FACTOR else 1.0


def _over_board(plane: SeenPlane, pad: BoardView) -> ScaleRange:
    """Return the range over the part of the picture that the board covers."""
    share = np.linspace(0.0, 1.0, _OVER_BOARD)
    low, high = pad.places_mm.min(axis=0), pad.places_mm.max(axis=0)
    grid = np.stack(np.meshgrid(*(low[i] + share * (high[i] - low[i]) for i in (0, 1))), -1).reshape(-1, 2)
    pixels = project(plane.model, plane.lens, plane.pose, np.column_stack([grid, np.zeros(len(grid))]))[0]
    return scale_range(scales_only(plane, pixels))


def _map(plane: SeenPlane, size_px: tuple[int, int]) -> tuple[Floats, Floats, ScaleDraws]:
    """Return columns, rows and scales of a coarse map over the picture."""
    columns, rows = (
        np.linspace(0.0, side - 1.0, count) for side, count in zip(size_px, (_MAP_COLUMNS, _MAP_ROWS), strict=True)
    )
    pixels = np.stack(np.meshgrid(columns, rows), -1).reshape(-1, 2)
    found = plane_scale(plane, pixels)
    unknown = ~(found.u_rel.max(axis=1) <= _UNKNOWN_U_REL)
    scales, u_rel = found.mm_per_px.copy(), found.u_rel.copy()
    scales[unknown], u_rel[unknown] = np.nan, np.nan
    return columns, rows, ScaleDraws(scales, u_rel, {})


def _notes(
    found: LensCalibration, residuals: Sequence[BoardResidual], widened: float, resampled_u: float
) -> tuple[str, ...]:
    """Say what speaks against the numbers."""
    notes = []
    if widened > 1.0:
        notes.append(
            f"the scale scatters by {resampled_u:.2%} when pictures are drawn with replacement, {widened:.1f} times "
            "what independent corners allow: corners of a picture err together (is the board flat, are pictures "
            "sharp?). Uncertainties are widened by this factor"
        )
    others = float(np.sqrt(np.mean([r.rms_px**2 for r in residuals[1:]])))
    if residuals[0].rms_px > _WORSE_FACTOR * others:
        notes.append(
            f"{residuals[0].file}: the board on the pad fits to {residuals[0].rms_px:.2f} px, in the other pictures to "
            f"{others:.2f} px: was it taken through the gel or a mirror that is not flat, or with another focus?"
        )
    if len({r.mirrored for r in residuals}) > 1:
        notes.append("some pictures show the board mirrored, others do not; a flat mirror changes no length")
    notes.append(
        f"holds where the board lay, for the pad at rest; {found.model} model, {len(residuals) - 1} pictures for the "
        "lens"
    )
    return tuple(notes)
