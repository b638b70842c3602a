"""The scale on the pad as a record: made from pictures of a ChArUco board, read at a contact patch.

Of the pictures one shows the board on the pad. For a comparison the record gives the millimetres per pixel at the
contact patch, and the sizes of its regions.
"""

from collections.abc import Mapping, Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from data_schemas import (
    BoardResidual,
    CameraCalibration,
    CharucoBoard,
    CompareError,
    DistortionModel,
    PatchScale,
    PixelScale,
    RegionExtent,
    ScaleContribution,
    TactileCapture,
)
from finray_calib.sensing._lens_calibration import (
    LEAST_VIEWS,
    POSE,
    BoardView,
    LensCalibration,
    adjust,
    calibrate_lens,
    refined_views,
    require_plausible,
)
from finray_calib.sensing._pixel_scale import (
    BoardUncertainty,
    ScaleDraws,
    fitted_plane,
    local_scale,
    plane_places_mm,
    plane_scale,
    range_over_board,
    resampled_scatter_rel,
    scale_map,
    scale_range,
    scales_only,
    seen_plane,
    widened_factor,
)

MOST_OBLIQUE_DEG = 70.0
LARGEST_U_REL = 0.05
#: A picture of the pad that fits this much worse than the others was taken through something that these were not.
_WORSE_FACTOR = 2.0


def pixel_scale(
    pad: BoardView,
    lens_views: Sequence[BoardView],
    size_px: tuple[int, int],
    board: CharucoBoard,
    declared: BoardUncertainty,
    seed: int,
    model: DistortionModel | None = None,
    pictures: Mapping[str, NDArray[np.uint8]] | None = None,
) -> PixelScale:
    """Calibrate the lens and the place of the board together, and state the scale on the pad.

    Uncertainties are first order from the joint covariance; pictures drawn with replacement check it, and where their
    scatter is more than 1.5 times as large, it is stated instead.

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
        The squares of the board cannot be right, the lens is not determined, the board on the pad is seen too
        obliquely, or the scale is known to worse than 5 %.
    """
    require_plausible(board)
    if len(lens_views) < LEAST_VIEWS:
        raise CompareError(
            f"{len(lens_views)} usable pictures of the board besides the picture on the pad are too few; give at "
            f"least {LEAST_VIEWS} (ten is a good number), each with the board turned and tilted differently"
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
    views: Sequence[BoardView],
    found: LensCalibration,
    board: CharucoBoard,
    declared: BoardUncertainty,
    resampled_u: float,
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
            f"{pad.name}: the board on the pad is seen at {angle_deg:.0f} deg from its normal, but at most "
            f"{MOST_OBLIQUE_DEG:g} deg is allowed; check that the board lies flat on the pad, and that this picture "
            "shows it there"
        )


def _require_known(found: ScaleDraws, pad: BoardView) -> None:
    """Refuse a scale that is hardly known."""
    u_rel = float(found.u_rel[0].max())
    if not u_rel <= LARGEST_U_REL:
        worst = max(found.parts_rel, key=lambda name: float(found.parts_rel[name][0].max()))
        raise CompareError(
            f"{pad.name}: the standard uncertainty of the scale is {100 * u_rel:.0f} %, but at most "
            f"{100 * LARGEST_U_REL:.0f} % is allowed; most of it comes from '{worst}'. Show more of the "
            "board, larger in the picture, and take more pictures with it turned and tilted"
        )


def _notes(
    found: LensCalibration, residuals: Sequence[BoardResidual], widened: float, resampled_u: float
) -> tuple[str, ...]:
    """Say what speaks against the numbers."""
    notes = []
    if widened > 1.0:
        notes.append(
            f"resampling the pictures gives a scatter of the scale of {100 * resampled_u:.2f} %, {widened:.1f} times "
            "that of independent corners, so the corners of one picture have common errors (check that the board is "
            "flat and the pictures are sharp). Uncertainties are widened by this factor"
        )
    others = float(np.sqrt(np.mean([r.rms_px**2 for r in residuals[1:]])))
    if residuals[0].rms_px > _WORSE_FACTOR * others:
        notes.append(
            f"{residuals[0].file}: the board on the pad fits to {residuals[0].rms_px:.2f} px, but the other pictures "
            f"fit to {others:.2f} px; the picture may have been taken through the gel or a mirror that is not flat, "
            "or with another focus"
        )
    if len({r.mirrored for r in residuals}) > 1:
        notes.append("some pictures show the board mirrored and others do not; a flat mirror changes no length")
    notes.append(
        f"the scale is valid in the plane of the board, for the untouched pad; lens: {found.model} model, "
        f"{len(residuals) - 1} pictures"
    )
    return tuple(notes)


Floats = NDArray[np.float64]

#: Two scales of one camera that differ by more than this many standard uncertainties, and by more than 1 %, are two.
_TIMES_U, _ALLOWED_REL = 3.0, 0.01
_MOST_PLACES = 20_000


def patch_scale(
    record: PixelScale, capture: TactileCapture, distance: NDArray[np.floating], factors: Mapping[str, float]
) -> PatchScale:
    """Return the scale at the contact patch and the extent of regions in mm.

    Parameters
    ----------
    record
        Scale of the capture's camera.
    capture
        Whose raw pixels they are.
    distance
        (H, W) from the contact's centre in half-widths, one value per pixel (per cell of a Bayer capture); NaN off the
        pad.
    factors
        Name -> half-widths of each region.

    Raises
    ------
    CompareError
        The record is of pictures of another size, or the camera does not see the plane of the pad at the patch.
    """
    _require_same_picture(record, capture)
    cell = 1 if capture.layout == "RGB" else 2
    plane = seen_plane(record)
    patch, pad = _thinned(_raw_pixels(distance <= 1.0, cell)), _thinned(_raw_pixels(np.isfinite(distance), cell))
    if not len(patch):
        raise CompareError(
            f"{capture.name}: no pixel of the render lies within 1 half-width of the contact, so the patch has no "
            "size; check that the contact is in the picture"
        )
    middle_px = patch.mean(axis=0)
    at_middle = plane_scale(plane, middle_px[None])
    seen = scales_only(plane, np.concatenate([patch, pad]))
    if not at_middle.u_rel.max() <= LARGEST_U_REL:
        raise CompareError(
            f"{capture.name}: the pixel scale is not known to {100 * LARGEST_U_REL:.0f} % at column "
            f"{middle_px[0]:.0f}, row {middle_px[1]:.0f}, the middle of the patch, because the camera does not see the "
            "plane of the pad there, or no picture shows the board near it. If the pixel scale belongs to this "
            "camera, lay the board where the patch is and measure again"
        )
    along = _along_picture(plane_places_mm(plane, middle_px + np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])))
    side_mm, u_rel = cell * at_middle.mm_per_px[0, :2], at_middle.u_rel[0, :2]
    extents = []
    for name, factor in factors.items():
        # what lies farthest out lies on the border
        places = plane_places_mm(plane, _raw_pixels(_border(distance <= factor), cell))
        extents.append(_extent(name, places @ along.T, side_mm, u_rel))
    return PatchScale(
        middle=local_scale(at_middle, middle_px),
        over_patch=scale_range(seen[: len(patch)]),
        over_pad=scale_range(seen[len(patch) :]),
        extents=tuple(extents),
    )


def _extent(name: str, places_mm: Floats, side_mm: Floats, u_rel: Floats) -> RegionExtent:
    """Return the extent of a region from the places (N, 2) of its border along both directions of the picture."""
    spans = np.ptp(places_mm[np.isfinite(places_mm).all(axis=1)], axis=0) + side_mm
    # either end lies anywhere in its pixel: variance side^2 / 12 each
    u_mm = np.hypot(spans * u_rel, side_mm / np.sqrt(6.0))
    return RegionExtent(
        region=name,
        along_x_mm=float(spans[0]),
        along_y_mm=float(spans[1]),
        along_x_u_mm=float(u_mm[0]),
        along_y_u_mm=float(u_mm[1]),
    )


def with_measured_scale(capture: TactileCapture, record: PixelScale) -> TactileCapture:
    """Return a capture that states the measured mean scale, at the middle of the board on the pad, and its uncertainty.

    Raises
    ------
    CompareError
        The record is of pictures of another size.
    """
    _require_same_picture(record, capture)
    middle = record.middle
    return capture.model_copy(update={"mm_per_px": middle.mean_mm_per_px, "mm_per_px_u_rel": middle.mean_u_rel})


def scale_finding(found: PatchScale, capture: TactileCapture) -> str | None:
    """Report that the capture states another scale; None where it states none, or one that agrees."""
    if capture.mm_per_px is None:
        return None
    measured, u_rel = found.middle.mean_mm_per_px, found.middle.mean_u_rel
    apart = abs(float(np.log(capture.mm_per_px / measured)))
    allowed = max(_ALLOWED_REL, _TIMES_U * float(np.hypot(u_rel, capture.mm_per_px_u_rel or 0.0)))
    if apart <= allowed:
        return None
    return (
        f"scale: {capture.name} states {capture.mm_per_px:.4g} mm per pixel, but the pixel scale at the patch is "
        f"{measured:.4g} mm per pixel (u = {100 * u_rel:.1f} %); one of them belongs to another camera, place or "
        "picture size"
    )


def _require_same_picture(record: PixelScale, capture: TactileCapture) -> None:
    """Refuse a scale of pictures of another size."""
    rows, columns = capture.contact.shape[:2]
    lens = record.calibration
    if (lens.width_px, lens.height_px) != (columns, rows):
        raise CompareError(
            f"the pixel scale was measured on pictures of {lens.width_px} x {lens.height_px} px, but {capture.name} "
            f"has {columns} x {rows} px; measure it with the camera of the capture, at its full frame"
        )


def _raw_pixels(mask: NDArray[np.bool_], cell: int) -> Floats:
    """Return (column, row) in raw pixels of the pixels of a mask."""
    rows, columns = np.nonzero(mask)
    return np.asarray((np.column_stack([columns, rows]) + 0.5) * cell - 0.5)


def _thinned(places: Floats) -> Floats:
    """Return every so many-th place where there are very many, which show the range of a scale as well."""
    return places[:: 1 + len(places) // _MOST_PLACES]


def _border(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return the pixels of a mask that have a neighbour outside it, or none at the picture's edge."""
    inner = cv2.erode(mask.astype(np.uint8), cv2.getStructuringElement(cv2.MORPH_CROSS, (3, 3)), borderValue=0)
    return np.asarray(mask & (inner == 0))


def _along_picture(three: Floats) -> Floats:
    """Return unit vectors (2, 2) on the plane along x and y of the picture, from a place and its two neighbours."""
    steps = three[1:] - three[0]
    return np.asarray(steps / np.linalg.norm(steps, axis=1, keepdims=True))
