"""Sense one press: depth, normals and contact from its colours, with the errors of the map on presses unseen."""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from data_schemas import CompareError, NormalMapRecord, SensedPress, TactileCapture
from finray_calib.sensing._normal_map import filled_slopes, mean_level, poisson_depth_mm, relative_change, rgb_image
from finray_calib.sensing._normal_map_fit import check_senses, contact_sha256, frame_of, normal_map_of

Floats = NDArray[np.float64]

CONTACT_SHARE: Final = 0.1
"""Without another level, the contact is where the depth exceeds this share of the largest, and three times its u."""
_TIMES_U = 3.0
_SEGMENTS = 8
#: Below this many standard uncertainties the largest depth is none.
LEAST_DEPTH_TO_U: Final = 2.0
_OUTSIDE_TOLD, _CLIPPED_TOLD = 0.05, 0.01


def sense_press(record: NormalMapRecord, capture: TactileCapture, contact_depth_mm: float | None = None) -> SensedPress:
    """Return depth, normals and contact of a capture by a map that other presses taught.

    The depth is the least-squares integral of the slopes and counts from its median over the frame of the picture.
    Its uncertainties are root mean squares over the presses that taught it, each sensed by a map of others of them, so
    they hold for shapes, places and depths like theirs; the error of the level from which depths count is in them.

    Parameters
    ----------
    record
        The map.
    capture
        Of the same sensor, encoding and scale.
    contact_depth_mm
        From which depth on a pixel counts as touched, by default a tenth of the largest, and at least three standard
        uncertainties.

    Raises
    ------
    CompareError
        Encoding, size or scale are not those of the map, the level is not above zero, or nothing is pressed in.
    """
    check_senses(record, capture)
    contact, no_contact = (rgb_image(counts, capture) for counts in (capture.contact, capture.no_contact))
    senses, level = normal_map_of(record), mean_level(no_contact)
    slopes = senses.slopes(contact, no_contact, level)
    usable: NDArray[np.bool_] = np.asarray(np.isfinite(slopes).all(axis=-1), dtype=np.bool_)
    whole = filled_slopes(slopes)
    depth = poisson_depth_mm(whole, record.mm_per_px)
    depth -= float(np.median(depth[frame_of(depth.shape)]))
    deepest = float(depth.max())
    u_mm, deepest_u_mm = _uncertainties(record, depth, deepest)
    if not deepest > LEAST_DEPTH_TO_U * (u_mm or 0.0):
        raise CompareError(
            f"{capture.name}: the map '{record.name}' senses no depth beyond its uncertainty (largest "
            f"{deepest:.3g} mm, u = {u_mm or 0.0:.2g} mm): is the press in view, and are contact and no-contact image "
            "of one session?"
        )
    chosen = contact_depth_mm
    if chosen is None:
        chosen = min(max(CONTACT_SHARE * deepest, _TIMES_U * (u_mm or 0.0)), 0.5 * deepest)
    if not 0.0 < chosen < deepest:
        raise CompareError(
            f"the level of the contact must lie above 0 and below the largest depth, {deepest:.3g} mm, got "
            f"{chosen:g} mm; correct --contact-depth-mm"
        )
    touched: NDArray[np.bool_] = np.asarray(depth > chosen, dtype=np.bool_)
    change = relative_change(contact, no_contact, level)
    beyond = ((change < senses.low) | (change > senses.high)).any(axis=-1)
    known: NDArray[np.bool_] = touched & usable
    found = _Shares(_share(np.asarray(beyond, dtype=np.bool_), known) if known.any() else 1.0, _share(~usable, touched))
    taught = contact_sha256(capture) in record.taught_by_sha256 if record.taught_by_sha256 else None
    normal = np.concatenate([-whole, np.ones((*whole.shape[:2], 1))], axis=-1)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    return SensedPress(
        name=capture.name,
        normal_map=record.name,
        mm_per_px=record.mm_per_px,
        depth_mm=depth.astype(np.float32),
        normal=normal.astype(np.float32),
        contact=touched.astype(np.uint8),
        depth_u_mm=u_mm,
        contact_depth_mm=chosen,
        deepest_mm=deepest,
        deepest_u_mm=deepest_u_mm,
        contact_area_mm2=float(touched.sum()) * record.mm_per_px**2,
        contact_area_u_mm2=None if u_mm is None else _area_u_mm2(depth, chosen, u_mm, record.mm_per_px),
        outside_share=found.outside_share,
        clipped_share=found.clipped_share,
        is_of_teaching=taught,
        notes=_notes(record, capture, found, taught),
    )


@dataclass(frozen=True, slots=True)
class _Shares:
    """Shares of the contact's pixels that the map does not know, and that are clipped."""

    outside_share: float
    clipped_share: float


def _share(which: NDArray[np.bool_], of: NDArray[np.bool_]) -> float:
    """Return the share of one set of pixels in another."""
    return float(which[of].mean())


def _uncertainties(record: NormalMapRecord, depth: Floats, deepest_mm: float) -> tuple[float | None, float | None]:
    """Return u of the depth at a pixel and of the largest depth, mm: of presses that did not teach, with the level.

    The level is as far off as around those presses, or as the frame of this picture scatters, whichever is more.
    """
    rms, height, levels = record.held_out_depth_rms_mm, record.held_out_height_error_rel, record.held_out_level_mm
    level_mm = max(_frame_scatter_mm(depth), 0.0 if levels is None else float(np.sqrt(np.mean(levels**2))))
    of_pixel = None if rms is None else float(np.sqrt(np.mean(rms**2) + level_mm**2))
    of_deepest = None if height is None else float(np.sqrt(np.mean(height**2) * deepest_mm**2 + level_mm**2))
    return of_pixel, of_deepest


def _frame_scatter_mm(depth: Floats) -> float:
    """Return the standard deviation over eight parts of the frame of their median depth: what its level is unsure by.

    Half of the parts may be touched by the contact or its halo: the median of the deviations counts.
    """
    rows, columns = np.nonzero(frame_of(depth.shape))
    middle = (depth.shape[0] - 1) / 2.0, (depth.shape[1] - 1) / 2.0
    turn = np.arctan2(rows - middle[0], columns - middle[1])
    part = np.minimum(((turn + np.pi) / (2.0 * np.pi) * _SEGMENTS).astype(np.intp), _SEGMENTS - 1)
    values = depth[rows, columns]
    medians = np.array([np.median(values[part == k]) for k in range(_SEGMENTS) if (part == k).any()])
    return float(1.4826 * np.median(np.abs(medians - np.median(medians))))


def _area_u_mm2(depth: Floats, level_mm: float, u_mm: float, mm_per_px: float) -> float:
    """Return half the difference of the areas at one u below and above the level."""
    counts = [float((depth > max(level_mm + sign * u_mm, 0.0)).sum()) for sign in (-1.0, 1.0)]
    return 0.5 * abs(counts[0] - counts[1]) * mm_per_px**2


def _notes(record: NormalMapRecord, capture: TactileCapture, shares: _Shares, taught: bool | None) -> tuple[str, ...]:
    """Return what a reader must know."""
    notes = []
    if taught:
        notes.append(
            f"this press taught the map '{record.name}': what is sensed says nothing of other presses, and the stated "
            "uncertainty is too large for this one; teach with other presses"
        )
    if taught is None:
        notes.append("whether this press taught the map is not known: the map is of an earlier version; teach it again")
    if record.held_out_level_mm is None and record.held_out_depth_rms_mm is not None:
        notes.append(
            "how far the level of the depth is off around a contact is not known: only the scatter of the frame is in "
            "its uncertainty; teach again, with contacts that leave 3.5 radii in view"
        )
    if record.held_out_depth_rms_mm is None:
        notes.append("the uncertainty of the depth is not known: the map is of an earlier version; teach it again")
    if shares.outside_share > _OUTSIDE_TOLD:
        notes.append(
            f"{shares.outside_share:.0%} of the contact's pixels change colour as no teaching press did; the map is "
            "held at its last value there: teach with deeper presses, or at more places"
        )
    if shares.clipped_share > _CLIPPED_TOLD:
        notes.append(
            f"{shares.clipped_share:.0%} of the contact's pixels are clipped and take their slope from their "
            "neighbours: expose shorter"
        )
    notes.append(
        "depth counts from the median over the frame of the picture, where the gel is taken to be untouched; how far "
        "the whole gel has moved is not seen"
    )
    if capture.no_contact_from != "image":
        notes.append(
            f"the image without contact is a substitute ({capture.no_contact_from}): its errors are in the depth"
        )
    return tuple(notes)


def surface_triangles(sensed: SensedPress) -> tuple[NDArray[np.int64], Floats]:
    """Return the surface of the gel as triangles (m, 3) and vertices (n, 3) in mm.

    x along columns, y against rows, z out of the gel, which a dent makes negative; two triangles for each square of
    four pixels, counter-clockwise seen from outside.
    """
    rows, columns = sensed.depth_mm.shape
    row, column = np.mgrid[:rows, :columns].astype(np.float64) * sensed.mm_per_px
    vertices = np.stack([column, -row, -sensed.depth_mm.astype(np.float64)], axis=-1).reshape(-1, 3)
    number = np.arange(rows * columns, dtype=np.int64).reshape(rows, columns)
    top_left, top_right, low_left, low_right = (
        number[:-1, :-1].ravel(), number[:-1, 1:].ravel(), number[1:, :-1].ravel(), number[1:, 1:].ravel()
    )  # fmt: skip
    first = np.stack([top_left, low_left, low_right], axis=-1)
    second = np.stack([top_left, low_right, top_right], axis=-1)
    return np.concatenate([first, second]), vertices
