"""Teach a normal map with presses of a ball, score it on presses it has not seen, store it, and sense with it.

What it senses in a capture are depth, surface normals and contact.
"""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from data_schemas import CompareError, ContactCircle, NormalMapRecord, SensedPress, TactileCapture
from finray_calib.sensing._normal_map import (
    DEGREE,
    Floats,
    Mask,
    NormalMap,
    angles_deg,
    coordinates,
    filled_slopes,
    frame_of,
    mean_level,
    poisson_depth_mm,
    polynomial_terms,
    relative_change,
    rgb_image,
    size_in_words,
)

MINIMUM_PRESSES: Final = 12
"""With fewer the score on unseen presses is a matter of luck: 3 real presses gave anything from -17 to 0.88."""
HELD_OUT_SPLITS: Final = 12

# weight of the penalty on the coefficients, relative to the mean square of the terms
_RIDGE_REL = 1e-6
# a labelled circle ends about a pixel beside the true one: its rim teaches nothing
_INSIDE_REL = 0.95
# nearer the gel bulges by an amount that the ball does not tell; from here on it is taken as flat
_FLAT_FROM_REL = 2.5
# pixels of each kind per press that teach; more cost time and add nothing
_PIXELS_PER_PRESS = 1500


@dataclass(frozen=True, slots=True)
class CalibrationPress:
    """A press of a ball whose contact circle is known.

    Attributes
    ----------
    contact, no_contact
        Images (H, W, 3) in one unit; NaN where clipped.
    row_px, column_px, radius_px
        Centre and radius of the contact circle.
    ball_radius_px, name
        Radius of the ball in pixels of the image; what messages call the press.
    """

    contact: Floats
    no_contact: Floats
    row_px: float
    column_px: float
    radius_px: float
    ball_radius_px: float
    name: str = ""


@dataclass(frozen=True, slots=True)
class HeldOutScore:
    """Scores on the presses that a random half did not teach, one entry per split.

    Attributes
    ----------
    explained
        1 - squared error of the slopes relative to that of a flat gel, inside the contact circles; 0 is a flat gel.
    angle_deg
        Mean angle between sensed and true normal inside the circles.
    """

    explained: Floats
    angle_deg: Floats


def fit_normal_map(presses: Sequence[CalibrationPress], seed: int) -> NormalMap:
    """Fit a normal map to ball presses by ridge regression.

    Inside a contact circle the gel has the ball's shape: slope = -offset / sqrt(R^2 - r^2). Beyond 2.5 radii it is
    taken as flat; between, where the gel bulges, nothing is taught.

    Parameters
    ----------
    presses
        At least 12, spread over pad and depth, with images of one camera.
    seed
        Of the choice of pixels.

    Raises
    ------
    CompareError
        When there are too few presses, images differ in size, a circle lies outside its image or is larger than its
        ball, or no press changes the picture.
    """
    lessons = _lessons(presses, seed)
    change = np.concatenate([lesson.change for lesson in lessons])
    rows, columns = presses[0].contact.shape[:2]
    return NormalMap(_solve(lessons), DEGREE, change.min(axis=0), change.max(axis=0), (rows, columns))


def held_out_score(presses: Sequence[CalibrationPress], seed: int) -> HeldOutScore:
    """Fit random halves of the presses and score each on the other half.

    Parameters
    ----------
    presses
        As in :func:`fit_normal_map`, with the same refusals.
    seed
        Of the choice of pixels and of the splits.
    """
    lessons = _lessons(presses, seed)
    rng = np.random.default_rng([seed, HELD_OUT_SPLITS])
    explained, angles = np.empty(HELD_OUT_SPLITS), np.empty(HELD_OUT_SPLITS)
    for split in range(HELD_OUT_SPLITS):
        order = rng.permutation(len(lessons))
        half = len(lessons) // 2
        coefficients = _solve([lessons[i] for i in order[:half]])
        unseen = [lessons[i] for i in order[half:]]
        sensed = np.concatenate([u.terms @ coefficients for u in unseen])
        true = np.concatenate([u.slopes for u in unseen])
        explained[split] = 1.0 - ((sensed - true) ** 2).sum() / (true**2).sum()
        angles[split] = angles_deg(sensed, true).mean()
    return HeldOutScore(explained, angles)


def ball_slopes(rows_px: Floats, columns_px: Floats, press: CalibrationPress) -> Floats:
    """Return the slopes (n, 2) of the gel under a ball along columns and rows: -offset / sqrt(R^2 - r^2)."""
    offset = np.column_stack([columns_px - press.column_px, rows_px - press.row_px])
    height = np.sqrt(press.ball_radius_px**2 - (offset**2).sum(axis=1))
    return np.asarray(-offset / height[:, None])


@dataclass(frozen=True, slots=True)
class DepthErrors:
    """Depth errors of each press, by maps taught without it, (presses,); levels where a ring is in view."""

    rms_mm: Floats
    height_rel: Floats
    level_mm: Floats | None


FOLDS: Final = 6
"""A map of five sixths of the presses is nearly that of all; one of half of them is off several times as far."""
#: How far from the middle of a contact its depth is integrated, in its radii.
_WINDOW_REL = 3.0
# the rim of a circle, in radii: sensed heights count from the mean over it
_RIM_REL = (0.9, 1.0)


def depth_errors(presses: Sequence[CalibrationPress], mm_per_px: float, seed: int) -> DepthErrors:
    """Sense each press by a map of five sixths of the others, and compare its depth to that of the ball.

    The depth is integrated up to three radii from the middle. In the circle the true depth is that of the ball's cap.
    The errors are the rms difference after a constant is taken out, and the relative error of the height from the rim
    to the middle. The level is the mean depth 2.5 to 3.5 radii away, where the gel is taken as flat, counted from the
    picture's frame.

    Parameters
    ----------
    presses, seed
        As in :func:`held_out_score`.
    mm_per_px
        Side of a pixel of the presses' images.
    """
    lessons = _lessons(presses, seed)
    order = np.random.default_rng([seed, FOLDS]).permutation(len(lessons))
    rows, columns = presses[0].contact.shape[:2]
    rms, heights, levels = np.empty((3, len(lessons)))
    for unseen in np.array_split(order, FOLDS):
        others = [lesson for k, lesson in enumerate(lessons) if k not in set(unseen.tolist())]
        seen = np.concatenate([lesson.change for lesson in others])
        taught = NormalMap(_solve(others), DEGREE, seen.min(axis=0), seen.max(axis=0), (rows, columns))
        for k in unseen:
            left_mm, heights[k] = _depth_error(taught, presses[k], mm_per_px)
            rms[k] = np.sqrt(np.mean(left_mm**2))
            levels[k] = _level_mm(taught, presses[k], mm_per_px)
    known = np.isfinite(levels)
    return DepthErrors(rms, heights, levels[known] if known.any() else None)


_FLAT_TO_REL = 3.5
_LEAST_RING_PX = 50


def _level_mm(taught: NormalMap, press: CalibrationPress, mm_per_px: float) -> float:
    """Return the mean depth around a contact, counted from the frame; NaN where too little of the ring is in view."""
    slopes = taught.slopes(press.contact, press.no_contact)
    depth = poisson_depth_mm(filled_slopes(slopes), mm_per_px)
    rows, columns = np.indices(depth.shape, dtype=np.float64)
    away = np.hypot(rows - press.row_px, columns - press.column_px) / press.radius_px
    ring = (away >= _FLAT_FROM_REL) & (away <= _FLAT_TO_REL)
    if ring.sum() < _LEAST_RING_PX:
        return float("nan")
    return float(depth[ring].mean() - np.median(depth[frame_of(depth.shape)]))


def _depth_error(taught: NormalMap, press: CalibrationPress, mm_per_px: float) -> tuple[Floats, float]:
    """Return the errors (pixels,) of the depth in a circle, mm, and the relative error of its height."""
    slopes = taught.slopes(press.contact, press.no_contact)
    rows, columns = np.indices(slopes.shape[:2], dtype=np.float64)
    window = np.maximum(np.abs(rows - press.row_px), np.abs(columns - press.column_px)) <= _WINDOW_REL * press.radius_px
    inside = np.ix_(window.any(axis=1), window.any(axis=0))
    usable: Mask = np.asarray(np.isfinite(slopes).all(axis=-1), dtype=np.bool_)
    depth = poisson_depth_mm(filled_slopes(slopes)[inside], mm_per_px)
    away = np.hypot(rows - press.row_px, columns - press.column_px)[inside]
    cap = np.sqrt(np.maximum(press.ball_radius_px**2 - np.minimum(away, press.radius_px) ** 2, 0.0)) * mm_per_px
    touched = (away <= press.radius_px) & usable[inside]
    left = (depth - cap)[touched]
    rim = (away >= _RIM_REL[0] * press.radius_px) & (away <= _RIM_REL[1] * press.radius_px)
    middle = away <= max(0.2 * press.radius_px, 1.0)
    sensed, true = (float(image[middle].mean() - image[rim].mean()) for image in (depth, cap))
    return left - left.mean(), sensed / true - 1.0


@dataclass(frozen=True, slots=True)
class _Lesson:
    """What one press teaches: colour changes, normal equations, and terms and slopes of the pixels in the circle."""

    change: Floats
    normal: Floats
    right: Floats
    terms: Floats
    slopes: Floats


def _lessons(presses: Sequence[CalibrationPress], seed: int) -> list[_Lesson]:
    """Check the presses and choose their pixels."""
    if len(presses) < MINIMUM_PRESSES:
        raise CompareError(
            f"a normal map needs at least {MINIMUM_PRESSES} ball presses, got {len(presses)}; with fewer, its score "
            "on unseen presses depends on chance. Capture more, spread over the pad and over depths"
        )
    rng = np.random.default_rng(seed)
    shape = presses[0].contact.shape[:2]
    lessons = [_lesson(press, press.name or f"press {k}", shape, rng) for k, press in enumerate(presses, start=1)]
    if not any(np.ptp(lesson.change) > 0.0 for lesson in lessons):
        raise CompareError(
            "no press changes the picture, because contact and no-contact images are the same; check the files"
        )
    return lessons


def _lesson(press: CalibrationPress, name: str, shape: tuple[int, ...], rng: np.random.Generator) -> _Lesson:
    """Choose pixels of a press and give their terms and slopes."""
    _check_press(press, name, shape)
    rows, columns = np.indices(shape, dtype=np.float64)
    radii = np.hypot(rows - press.row_px, columns - press.column_px) / press.radius_px
    finite = np.isfinite(press.contact).all(axis=-1) & np.isfinite(press.no_contact).all(axis=-1)
    inside = _choose(finite & (radii <= _INSIDE_REL), rng)
    if not inside.size:
        raise CompareError(
            f"{name}: the contact circle of {press.radius_px:g} px around row {press.row_px:g}, column "
            f"{press.column_px:g} has no usable pixel in a picture of {shape[1]} x {shape[0]} px; check the circle "
            "and the exposure"
        )
    if not (-0.5 <= press.row_px <= shape[0] - 0.5 and -0.5 <= press.column_px <= shape[1] - 0.5):
        raise CompareError(
            f"{name}: the middle of the contact circle, row {press.row_px:g}, column {press.column_px:g}, lies outside "
            f"the picture of {shape[1]} x {shape[0]} px; correct the circle, or leave the press out"
        )
    chosen = np.concatenate([inside, _choose(finite & (radii >= _FLAT_FROM_REL), rng)])
    change = relative_change(press.contact, press.no_contact).reshape(-1, 3)[chosen]
    x, y = (c.ravel()[chosen] for c in coordinates((shape[0], shape[1])))
    slopes = ball_slopes(rows.ravel()[inside], columns.ravel()[inside], press)
    terms = polynomial_terms(change, x, y)
    taught = terms[: len(inside)]  # the others are flat and add nothing to the right-hand side
    return _Lesson(change, terms.T @ terms, taught.T @ slopes, taught, slopes)


def _check_press(press: CalibrationPress, name: str, shape: tuple[int, ...]) -> None:
    """Refuse a press whose images or circle cannot be."""
    for kind, image in (("contact", press.contact), ("no-contact", press.no_contact)):
        if image.shape != (*shape, 3):
            raise CompareError(
                f"{name}: the {kind} image has {size_in_words(image)}, but the first press has {shape[1]} x {shape[0]} "
                "px and 3 colours; fit a normal map only to colour images of one camera"
            )
    if not 0.0 < press.radius_px < press.ball_radius_px:
        raise CompareError(
            f"{name}: the contact circle of {press.radius_px:g} px must be smaller than the ball of "
            f"{press.ball_radius_px:.4g} px radius; check the ball (diameter or radius?), mm per px and the circle"
        )


def _choose(mask: Mask, rng: np.random.Generator) -> NDArray[np.intp]:
    """Return flat indices of some pixels of a mask."""
    found = np.flatnonzero(mask)
    return found if found.size <= _PIXELS_PER_PRESS else rng.choice(found, _PIXELS_PER_PRESS, replace=False)


def _solve(lessons: Sequence[_Lesson]) -> Floats:
    """Return the coefficients (term, 2) of least squares with a small penalty on all but the constant."""
    normal = np.sum([lesson.normal for lesson in lessons], axis=0)
    right = np.sum([lesson.right for lesson in lessons], axis=0)
    penalty = np.full(len(normal), _RIDGE_REL * np.trace(normal) / len(normal))
    penalty[0] = 0.0
    return np.asarray(np.linalg.solve(normal + np.diag(penalty), right))


# scales of one camera differ by rounding only, those that were measured twice by more
_SAME_SCALE_REL, _NEAR_SCALE_REL = 1e-6, 0.02


def normal_map_record(captures: Sequence[TactileCapture], name: str, seed: int) -> NormalMapRecord:
    """Fit a normal map to captures of ball presses, with its score on presses it has not seen.

    Parameters
    ----------
    captures
        At least 12 of one camera, each with a contact circle, a ball's radius and mm per px.
    name
        Of the map.
    seed
        Of the choice of pixels and of the random halves.

    Raises
    ------
    CompareError
        When captures lack what is needed, do not belong together, or are too few.
    """
    presses = [calibration_press(capture) for capture in captures]
    _check_together(captures)
    fitted = fit_normal_map(presses, seed)
    score = held_out_score(presses, seed)
    first = captures[0]
    errors = depth_errors(presses, _scale_mm(first) * _cell_px(first), seed)
    return NormalMapRecord(
        name=name,
        degree=fitted.degree,
        coefficients=fitted.coefficients,
        lowest_change_rel=fitted.low,
        highest_change_rel=fitted.high,
        height_px=fitted.shape_px[0],
        width_px=fitted.shape_px[1],
        mm_per_px=_scale_mm(first) * _cell_px(first),
        mm_per_px_u_rel=first.mm_per_px_u_rel,
        encoding=first.encoding,
        presses=len(presses),
        held_out_explained_rel=score.explained,
        held_out_angle_deg=score.angle_deg,
        held_out_depth_rms_mm=errors.rms_mm,
        held_out_height_error_rel=errors.height_rel,
        held_out_level_mm=errors.level_mm,
        training_sha256=tuple(contact_sha256(capture) for capture in captures),
        notes=tuple(sorted({capture.source for capture in captures})),
    )


def contact_sha256(capture: TactileCapture) -> str:
    """Return the SHA-256 of the contact image: the same press under another name is known by it."""
    return hashlib.sha256(np.ascontiguousarray(capture.contact, dtype="<u2").tobytes()).hexdigest()


def normal_map_of(record: NormalMapRecord) -> NormalMap:
    """Return the map of a record."""
    return NormalMap(
        coefficients=record.coefficients,
        degree=record.degree,
        low=record.lowest_change_rel,
        high=record.highest_change_rel,
        shape_px=(record.height_px, record.width_px),
    )


def require_matching_capture(record: NormalMapRecord, capture: TactileCapture) -> None:
    """Refuse to apply a map to a capture of another encoding or scale.

    Raises
    ------
    CompareError
        When the capture's encoding or scale is not that of the map's calibration presses.
    """
    if record.encoding != capture.encoding:
        raise CompareError(
            f"{capture.name} has {capture.encoding} values, but the normal map '{record.name}' was trained on "
            f"{record.encoding} values; fit a map to presses with the same camera settings"
        )
    if capture.mm_per_px is not None:
        scale_mm = capture.mm_per_px * _cell_px(capture)
        if not np.isclose(scale_mm, record.mm_per_px, rtol=_NEAR_SCALE_REL, atol=0.0):
            raise CompareError(
                f"{capture.name} has {scale_mm:.4g} mm per pixel, but the normal map '{record.name}' has "
                f"{record.mm_per_px:.4g} mm per pixel, so slopes and depths would be wrong; fit the map to presses at "
                "this distance, or give the measured scale (--scale) if the capture states a planned one"
            )


def calibration_press(capture: TactileCapture) -> CalibrationPress:
    """Return the press of a capture with its circle in pixels of its colour image (a Bayer cell is one pixel).

    Raises
    ------
    CompareError
        When the capture is not of a ball, or its circle or scale is missing.
    """
    circle, radius_mm = require_ball_press(capture)
    cell = _cell_px(capture)
    return CalibrationPress(
        contact=rgb_image(capture.contact, capture),
        no_contact=rgb_image(capture.no_contact, capture),
        row_px=(circle.row_px + 0.5) / cell - 0.5,
        column_px=(circle.column_px + 0.5) / cell - 0.5,
        radius_px=circle.radius_px / cell,
        ball_radius_px=radius_mm / _scale_mm(capture) / cell,
        name=capture.name,
    )


def require_ball_press(capture: TactileCapture) -> tuple[ContactCircle, float]:
    """Return the contact circle of a capture that can teach a normal map, and the ball's radius in mm.

    Raises
    ------
    CompareError
        When the capture is not of a ball, or its circle, the ball's radius or its scale is missing.
    """
    circle = capture.contact_circle
    if capture.indenter.shape != "ball" or circle is None:
        raise CompareError(
            f"{capture.name}: a normal map is trained only on presses of a ball with a known contact circle, but this "
            f"press is by a {capture.indenter.shape} {('without' if circle is None else 'with')} a contact circle"
        )
    if capture.indenter.radius_mm is None:
        raise CompareError(
            f"{capture.name}: the radius of the ball is missing, so the slopes are unknown; import the press again "
            "with the ball's diameter"
        )
    _scale_mm(capture)
    return circle, capture.indenter.radius_mm


def _scale_mm(capture: TactileCapture) -> float:
    """Return mm per raw pixel."""
    if capture.mm_per_px is None:
        raise CompareError(
            f"{capture.name}: mm_per_px is missing, so the size of the ball in pixels is unknown; add mm_per_px"
        )
    return capture.mm_per_px


def _cell_px(capture: TactileCapture) -> int:
    """Return the raw pixels along the side of a pixel of the colour image."""
    return 1 if capture.layout == "RGB" else 2


def _check_together(captures: Sequence[TactileCapture]) -> None:
    """Refuse captures of different cameras or settings, and a press that is given twice."""
    name_of: dict[str, str] = {}
    for capture in captures:
        digest = contact_sha256(capture)
        if digest in name_of:
            raise CompareError(
                f"{name_of[digest]} and {capture.name} are the same image, so the map would be judged by a press that "
                "it was trained on; give each press only once"
            )
        name_of[digest] = capture.name
    for capture in captures[1:]:
        for field in ("encoding", "layout", "bit_depth"):
            one, other = getattr(captures[0], field), getattr(capture, field)
            if one != other:
                raise CompareError(
                    f"{capture.name} has {field} {other}, but {captures[0].name} has {one}; train a normal map only on "
                    "captures of one camera with one setting"
                )
        if not np.isclose(_scale_mm(capture), _scale_mm(captures[0]), rtol=_SAME_SCALE_REL, atol=0.0):
            raise CompareError(
                f"{capture.name} has {capture.mm_per_px:g} mm per px, but {captures[0].name} has "
                f"{captures[0].mm_per_px:g} mm per px; train a normal map on captures of one camera at one distance"
            )


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
    they hold for shapes, places and depths like theirs. The error of the level from which depths count is in them, that
    of the scale in that of the largest depth alone.

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
    require_matching_capture(record, capture)
    contact, no_contact = (rgb_image(counts, capture) for counts in (capture.contact, capture.no_contact))
    senses, level = normal_map_of(record), mean_level(no_contact)
    slopes = senses.slopes(contact, no_contact, level)
    usable = np.asarray(np.isfinite(slopes).all(axis=-1), dtype=np.bool_)
    whole = filled_slopes(slopes)
    depth = poisson_depth_mm(whole, record.mm_per_px)
    depth -= float(np.median(depth[frame_of(depth.shape)]))
    deepest = float(depth.max())
    u_mm, deepest_u_mm = _uncertainties(record, depth, deepest)
    if not deepest > LEAST_DEPTH_TO_U * (u_mm or 0.0):
        raise CompareError(
            f"{capture.name}: the map '{record.name}' senses no depth beyond its uncertainty (largest {deepest:.3g} "
            f"mm, u = {u_mm or 0.0:.2g} mm); check that the press is in view, and that the contact and no-contact "
            "images are of one session"
        )
    chosen = _contact_level_mm(contact_depth_mm, deepest, u_mm or 0.0)
    touched = depth > chosen
    change = relative_change(contact, no_contact, level)
    beyond = np.asarray(((change < senses.low) | (change > senses.high)).any(axis=-1), dtype=np.bool_)
    known = touched & usable
    outside = float(beyond[known].mean()) if known.any() else 1.0
    clipped = 1.0 - float(usable[touched].mean())
    taught = contact_sha256(capture) in record.training_sha256 if record.training_sha256 else None
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
        outside_share=outside,
        clipped_share=clipped,
        is_of_teaching=taught,
        notes=_notes(record, capture, outside, clipped, taught),
    )


def _contact_level_mm(asked_mm: float | None, deepest_mm: float, u_mm: float) -> float:
    """Return from which depth on a pixel counts as touched, mm."""
    if asked_mm is None:
        return min(max(CONTACT_SHARE * deepest_mm, _TIMES_U * u_mm), 0.5 * deepest_mm)
    if not 0.0 < asked_mm < deepest_mm:
        raise CompareError(
            f"the contact level (--contact-depth-mm) must be above 0 and below the largest depth, {deepest_mm:.3g} "
            f"mm, got {asked_mm:g} mm"
        )
    return asked_mm


def _uncertainties(record: NormalMapRecord, depth: Floats, deepest_mm: float) -> tuple[float | None, float | None]:
    """Return u of the depth at a pixel and of the largest depth, mm: of presses that did not teach, with the level.

    The level is as far off as around those presses, or as the frame of this picture scatters, whichever is more. The
    largest depth goes as the square of the scale: as the step of the integration and as the ball's size in pixels.
    """
    rms, height, levels = record.held_out_depth_rms_mm, record.held_out_height_error_rel, record.held_out_level_mm
    level_mm = max(_frame_scatter_mm(depth), 0.0 if levels is None else float(np.sqrt(np.mean(levels**2))))
    of_pixel = None if rms is None else float(np.sqrt(np.mean(rms**2) + level_mm**2))
    if height is None:
        return of_pixel, None
    height_rel2 = np.mean(height**2) + (2.0 * (record.mm_per_px_u_rel or 0.0)) ** 2
    return of_pixel, float(np.sqrt(height_rel2 * deepest_mm**2 + level_mm**2))


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


def _notes(
    record: NormalMapRecord, capture: TactileCapture, outside_share: float, clipped_share: float, taught: bool | None
) -> tuple[str, ...]:
    """Return what a reader must know; of the contact's pixels, the shares that the map does not know and clipped."""
    notes = []
    if taught:
        notes.append(
            f"the map '{record.name}' was trained on this press, so its result does not hold for other presses, and "
            "its stated uncertainty is too large for this press; train the map with other presses"
        )
    if taught is None:
        notes.append(
            "an older version made the map, so it is unknown whether this press trained it; train the map again"
        )
    if record.held_out_level_mm is None and record.held_out_depth_rms_mm is not None:
        notes.append(
            "the error of the zero level of the depth around a contact is unknown, so the stated uncertainty "
            "includes only the scatter at the border of the picture; train the map again, with contacts around which "
            "3.5 radii are in view"
        )
    if record.held_out_depth_rms_mm is None:
        notes.append("an older version made the map, so the uncertainty of the depth is unknown; train the map again")
    if outside_share > _OUTSIDE_TOLD:
        notes.append(
            f"{100 * outside_share:.0f} % of the contact's pixels change colour in a way that no training press did, "
            "and the map keeps its last value there; train with deeper presses, or at more places"
        )
    if clipped_share > _CLIPPED_TOLD:
        notes.append(
            f"{100 * clipped_share:.0f} % of the contact's pixels are clipped and take their slope from their "
            "neighbours; use a shorter exposure"
        )
    notes.append(
        "depth is measured from the median over the border of the picture, where the gel is assumed to be untouched; "
        "a movement of the gel as a whole is not seen"
    )
    if record.mm_per_px_u_rel and record.held_out_height_error_rel is not None:
        notes.append(
            f"all depths rest on one scale, whose standard uncertainty of {100 * record.mm_per_px_u_rel:.2g} % "
            "changes them together by twice as much; only the uncertainty of the largest depth includes it"
        )
    if capture.no_contact_from != "image":
        notes.append(
            f"the image without contact is a substitute ({capture.no_contact_from}), whose errors also change the depth"
        )
    return tuple(notes)


def surface_triangles(sensed: SensedPress, mirrored: bool = False) -> tuple[NDArray[np.int64], Floats]:
    """Return the surface of the gel as triangles (m, 3) and vertices (n, 3) in mm.

    x along columns, y along rows, z out of the gel, which a dent makes negative: right-handed for a camera that looks
    at the gel. `mirrored`: it looks into one mirror, and y is against rows. Counter-clockwise seen from outside.
    """
    rows, columns = sensed.depth_mm.shape
    row, column = np.mgrid[:rows, :columns].astype(np.float64) * sensed.mm_per_px
    y = -row if mirrored else row
    vertices = np.stack([column, y, -sensed.depth_mm.astype(np.float64)], axis=-1).reshape(-1, 3)
    number = np.arange(rows * columns, dtype=np.int64).reshape(rows, columns)
    top_left, top_right, low_left, low_right = (
        number[:-1, :-1].ravel(), number[:-1, 1:].ravel(), number[1:, :-1].ravel(), number[1:, 1:].ravel()
    )  # fmt: skip
    first = np.stack([top_left, low_left, low_right], axis=-1)
    second = np.stack([top_left, low_right, top_right], axis=-1)
    return np.concatenate([first, second])[:, :: 1 if mirrored else -1], vertices
