"""From pictures of a ChArUco board, one of them on the pad, to the record of the scale on the pad."""

from collections.abc import Mapping, Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from data_schemas.camera_calibration import CameraCalibration, DistortionModel
from data_schemas.errors import CompareError
from data_schemas.pixel_scale import BoardResidual, PixelScale, ScaleContribution
from data_schemas.tactile import CharucoBoard
from finray_calib.compare.board_corners import BoardView, require_plausible
from finray_calib.compare.board_plane import Declared, fitted_plane
from finray_calib.compare.corner_refinement import refined_views
from finray_calib.compare.lens_calibration import LEAST_VIEWS, POSE, LensCalibration, adjust, calibrate_lens
from finray_calib.compare.pixel_scale import ScaleDraws, plane_scale
from finray_calib.compare.scale_scatter import resampled_scatter_rel, widened_factor
from finray_calib.compare.scale_summaries import local_scale, range_over_board, scale_map

MOST_OBLIQUE_DEG = 70.0
LARGEST_U_REL = 0.05
#: A picture of the pad that fits this much worse than the others was taken through something that these were not.
_WORSE_FACTOR = 2.0


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
    resampled_u = resampled_scatter_rel(views, found, declared, pad.pixels.mean(axis=0), np.random.default_rng(seed))
    return _record(views, found, board, declared, resampled_u)


def _record(
    views: Sequence[BoardView], found: LensCalibration, board: CharucoBoard, declared: Declared, resampled_u: float
) -> PixelScale:
    """Return the record of a fitted lens and board, of which the first view is that on the pad."""
    pad = views[0]
    middle_px = pad.pixels.mean(axis=0)
    plane = fitted_plane(found, declared)
    at_middle = plane_scale(plane, middle_px[None])
    widened = widened_factor(resampled_u, at_middle)
    if widened > 1.0:
        plane = fitted_plane(found, declared, widened)
        at_middle = plane_scale(plane, middle_px[None])
    _require_known(at_middle, pad)
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
        middle=local_scale(at_middle, middle_px),
        over_board=range_over_board(plane, pad),
        budget=tuple(ScaleContribution(input=k, u_rel=float(v[0, 2])) for k, v in at_middle.parts_rel.items()),
        resampled_u_rel=resampled_u,
        **scale_map(plane, (found.width_px, found.height_px)),
        notes=_notes(found, residuals, widened, resampled_u),
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
