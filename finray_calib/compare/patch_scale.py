"""Millimetres per pixel where a comparison looks: at the contact patch, and how large its regions are."""

from collections.abc import Mapping

import cv2
import numpy as np
from numpy.typing import NDArray

from data_schemas.capture import TactileCapture
from data_schemas.compare import PatchScale, RegionExtent
from data_schemas.errors import CompareError
from data_schemas.pixel_scale import PixelScale
from finray_calib.compare.board_plane import seen_plane
from finray_calib.compare.pixel_scale import plane_places_mm, plane_scale, scales_only
from finray_calib.compare.pixel_scale_record import LARGEST_U_REL
from finray_calib.compare.scale_summaries import local_scale, scale_range

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
            f"{capture.name}: no pixel of the render lies within 1 half-width of the contact, so that the patch has no "
            "size: is the contact in the picture?"
        )
    middle_px = patch.mean(axis=0)
    at_middle = plane_scale(plane, middle_px[None])
    seen = scales_only(plane, np.concatenate([patch, pad]))
    if not at_middle.u_rel.max() <= LARGEST_U_REL:
        raise CompareError(
            f"{capture.name}: at column {middle_px[0]:.0f}, row {middle_px[1]:.0f}, the middle of the patch, the pixel "
            f"scale is not known to {LARGEST_U_REL:.0%}: its camera does not see the plane of the pad there, or no "
            "board came near. Is it of this camera? Then lay the board where the patch is"
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
    """Say that the capture's own scale is another one; None where it has none, or agrees."""
    if capture.mm_per_px is None:
        return None
    measured, u_rel = found.middle.mean_mm_per_px, found.middle.mean_u_rel
    apart = abs(float(np.log(capture.mm_per_px / measured)))
    allowed = max(_ALLOWED_REL, _TIMES_U * float(np.hypot(u_rel, capture.mm_per_px_u_rel or 0.0)))
    if apart <= allowed:
        return None
    return (
        f"scale: {capture.name} states {capture.mm_per_px:.4g} mm per pixel, the pixel scale {measured:.4g} at the "
        f"patch (u = {u_rel:.1%}): one of them is of another camera, place or picture size"
    )


def _require_same_picture(record: PixelScale, capture: TactileCapture) -> None:
    """Refuse a scale of pictures of another size."""
    rows, columns = capture.contact.shape[:2]
    lens = record.calibration
    if (lens.width_px, lens.height_px) != (columns, rows):
        raise CompareError(
            f"the pixel scale is of pictures of {lens.width_px} x {lens.height_px} px, {capture.name} has {columns} x "
            f"{rows} px: measure it with the camera of the capture, at its full frame"
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
