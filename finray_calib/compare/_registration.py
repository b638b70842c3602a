"""Bring a render to the pixel grid of a capture: an affine drift of the camera, found on gradients, or a refusal.

The render moves, never the capture: the noise of the capture stays what it is. A map takes a pixel (column, row) of
the capture to the place of the render that shows the same; whole numbers are pixel centres. Every image of the press
is moved by one map, without making up what is missing.
"""

from dataclasses import dataclass
from typing import Any, get_args

import cv2
import numpy as np
from numpy.typing import NDArray

from data_schemas import ArraySpec, CompareError, Model, SimulatedPress, TactileCapture
from finray_calib.compare._image_noise import block_mean
from finray_calib.compare._regions import every_channel
from finray_calib.sensing import rgb_image

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]
#: Motions from simple to rich with the grids they are fitted on: coarse ones reach far, the finest one is exact.
_MOTIONS = ((cv2.MOTION_TRANSLATION, (4, 1)), (cv2.MOTION_EUCLIDEAN, (2, 1)), (cv2.MOTION_AFFINE, (2, 1)))
_STOP = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 60, 1e-6)
_SMOOTHING_PX = 5
_PROBES = 9
#: Tiles of the two halves across the shorter side.
_TILES = 12
#: Limits of what a camera's drift can be. Beyond them the fit followed something else.
LEAST_SCORE = 0.85
LARGEST_MOVE_OF_SIDE = 0.05
LARGEST_SCALE_CHANGE = 0.05
LARGEST_ROTATION_DEG = 5.0
#: Two halves of the picture must say the same to a pixel, or to a quarter of the move where that is more.
LARGEST_RESIDUAL_PX, LARGEST_RESIDUAL_OF_MOVE = 1.0, 0.25
LEAST_SHARE_OF_PICTURE = 0.05
#: A drift that is real takes at least a third off the pictures' lack of correlation. Pictures that differ in light or
#: model give a map as well, but one that explains next to nothing.
UNEXPLAINED_SHARE = 0.67
#: Half of what a calibration by a board leaves; less is no drift, however quiet the images.
LEAST_DRIFT_PX = 0.05


@dataclass(frozen=True, slots=True)
class Registration:
    """Hold the map from the capture's pixels to the render's, and what speaks for it.

    Attributes
    ----------
    to_render : ndarray, shape (2, 3)
        (column, row) of the render = to_render @ (column, row, 1) of the capture.
    score_rel, score_before_rel : float
        Correlation of the gradient pictures with and without the map.
    move_px, largest_move_px : float
        Root mean square and maximum over the frame of how far the render moves.
    residual_px : float
        Standard uncertainty of the map: root mean square over the frame of half the difference between the maps of two
        halves of the picture (a chequerboard). It knows noise and lack of edges, not differences of light between
        both pictures: those add about half a pixel where shades are soft.
    scale_x, scale_y : float
        Render pixels per capture pixel along columns and rows.
    rotation_deg : float
    """

    to_render: Floats
    score_rel: float
    score_before_rel: float
    move_px: float
    largest_move_px: float
    residual_px: float
    scale_x: float
    scale_y: float
    rotation_deg: float

    @property
    def significant(self) -> bool:
        """Whether the move is a drift: larger than its uncertainty, and it explains what made the pictures differ."""
        explained = 1 - self.score_rel <= UNEXPLAINED_SHARE * (1 - self.score_before_rel)
        return explained and self.move_px > max(2 * self.residual_px, LEAST_DRIFT_PX)

    def __str__(self) -> str:
        """Say it in one line."""
        return (
            f"the render lies {self.move_px:.2f} px away from the capture (at most {self.largest_move_px:.2f} px; "
            f"standard uncertainty {self.residual_px:.2f} px), with a scale of {self.scale_x:.4f} along x and "
            f"{self.scale_y:.4f} along y, a rotation of {self.rotation_deg:.2f} deg, and a correlation of gradients of "
            f"{self.score_before_rel:.2f} before and {self.score_rel:.2f} after"
        )


def register(rendered: Floats, captured: Floats, mask: Mask | None = None) -> Registration:
    """Find the shift, turn or affine map that brings a render onto a capture, or refuse.

    Maximises the enhanced correlation coefficient of the gradient magnitudes, from coarse to fine; a shift is enough
    unless a turn, or an affine map, explains a third of what it leaves. Gain and tone do not matter; what is compared
    are edges and shades, so that pictures without any are refused. Valid for drifts of a calibrated camera: up to 5 %
    of the shorter side, 5 % of scale, 5 deg.

    Parameters
    ----------
    rendered, captured : ndarray, shape (H, W, 3)
        Images of one size. Take those without contact where they have edges enough: an indenter that the render puts
        at a wrong place would pass for a drift of the camera.
    mask : ndarray of bool, shape (H, W), optional
        Pixels of the capture that may be used; default all. Pixels that are not finite are not.

    Returns
    -------
    Registration

    Raises
    ------
    CompareError
        The images differ in size, too little of them is usable, or the map found cannot be trusted.

    References
    ----------
    G. D. Evangelidis, E. Z. Psarakis, IEEE Trans. Pattern Analysis and Machine Intelligence 30 (2008) 1858.
    """
    if rendered.shape != captured.shape:
        raise CompareError(
            f"a render of {rendered.shape[1]} x {rendered.shape[0]} px cannot be registered to a capture of "
            f"{captured.shape[1]} x {captured.shape[0]} px: simulate with the camera of the capture"
        )
    (moving, moving_usable), (fixed, fixed_usable) = gradient_view(rendered), gradient_view(captured)
    usable = moving_usable & fixed_usable & (True if mask is None else mask)
    if usable.mean() < LEAST_SHARE_OF_PICTURE:
        raise CompareError(
            f"only {100 * usable.mean():.1f} % of the picture is usable in both images, but registration needs at "
            f"least {100 * LEAST_SHARE_OF_PICTURE:.0f} %; expose the capture so that less of it is clipped"
        )
    matrix, motion = _simplest_map(moving, fixed, usable)
    halves = [_refined(moving, fixed, usable & half, matrix, 1, motion) for half in _halves(usable.shape)]
    result = _described(matrix, halves, moving, fixed, usable)
    _require_trustworthy(result, min(usable.shape))
    return result


def _simplest_map(moving: Floats, fixed: Floats, usable: Mask) -> tuple[Floats, int]:
    """Return the map of the simplest motion that a richer one does not beat clearly, and that motion.

    A richer motion always fits better; where it follows differences of light instead of a drift it gains little, and
    its map is wrong by pixels far from the edges it rests on.
    """
    start = chosen = np.eye(2, 3)
    motion, best = _MOTIONS[0][0], 1 - _score(moving, fixed, usable, chosen)
    for richer, factors in _MOTIONS:
        for factor in factors:
            start = _refined(moving, fixed, usable, start, factor, richer)
        unexplained = 1 - _score(moving, fixed, usable, start)
        if unexplained <= UNEXPLAINED_SHARE * best:
            chosen, motion, best = start, richer, unexplained
    return chosen, motion


def _score(moving: Floats, fixed: Floats, usable: Mask, matrix: Floats) -> float:
    """Return the correlation of the moved picture with the other one."""
    moved = warp_image(moving, matrix, cv2.INTER_LINEAR)
    both = usable & np.isfinite(moved)
    first, second = (image[both] - image[both].mean() for image in (moved, fixed))
    norm = float(np.sqrt((first @ first) * (second @ second)))
    return float(first @ second) / norm if norm > 0 else 0.0


def _refined(moving: Floats, fixed: Floats, usable: Mask, matrix: Floats, factor: int, motion: int) -> Floats:
    """Return the map after refinement on a grid that is coarser by a factor."""
    small = [block_mean(image, factor) for image in (fixed, moving)]
    mask = (block_mean(usable.astype(np.float64), factor) > 0.999).astype(np.uint8)
    everywhere = np.ones(small[1].shape, dtype=np.uint8)
    start = scaled_map(matrix, 1 / factor).astype(np.float32)
    try:
        fixed_small, moving_small = (image.astype(np.float32) for image in small)
        # the mask is that of the picture that stands still
        _, found = cv2.findTransformECCWithMask(
            fixed_small, moving_small, mask, everywhere, start, motion, _STOP, _SMOOTHING_PX
        )
    except cv2.error:
        raise CompareError(
            "registration failed: the pictures have too few edges in common, or they are too far apart"
        ) from None
    return scaled_map(np.asarray(found, dtype=np.float64), factor)


def scaled_map(matrix: Floats, factor: float) -> Floats:
    """Return a map for a grid that is finer by a factor.

    Pixel 0 of a coarse grid covers the fine pixels 0 to factor - 1, so its centre lies at (factor - 1) / 2 of the fine
    grid, not at 0: x_fine = factor x_coarse + (factor - 1) / 2.
    """
    offset = (factor - 1) / 2
    linear, shift = matrix[:, :2], matrix[:, 2]
    moved = factor * shift + offset - linear @ np.full(2, offset)
    return np.column_stack([linear, moved])


def _halves(shape: tuple[int, ...]) -> tuple[Mask, Mask]:
    """Return a chequerboard and its complement."""
    side = max(min(shape) // _TILES, 1)
    rows, columns = np.indices(shape) // side
    even = (rows + columns) % 2 == 0
    return even, ~even


def _moves_px(matrix: Floats, shape: tuple[int, ...]) -> Floats:
    """Return how far a map moves probes all over the frame, shape (probes, 2)."""
    rows, columns = (np.linspace(0, side - 1, _PROBES) for side in shape)
    places = np.stack([*np.meshgrid(columns, rows), np.ones((_PROBES, _PROBES))], axis=-1).reshape(-1, 3)
    return np.asarray(places @ matrix.T - places[:, :2])


def _described(matrix: Floats, halves: list[Floats], moving: Floats, fixed: Floats, usable: Mask) -> Registration:
    """Return the map with everything that speaks for or against it."""
    moves = np.hypot(*_moves_px(matrix, usable.shape).T)
    apart = _moves_px(halves[0], usable.shape) - _moves_px(halves[1], usable.shape)
    scale_x, scale_y = np.hypot(*matrix[:, :2])
    return Registration(
        to_render=matrix,
        score_rel=_score(moving, fixed, usable, matrix),
        score_before_rel=_score(moving, fixed, usable, np.eye(2, 3)),
        move_px=float(np.sqrt((moves**2).mean())),
        largest_move_px=float(moves.max()),
        residual_px=float(np.sqrt((apart**2).sum(axis=1).mean())) / 2,
        scale_x=float(scale_x),
        scale_y=float(scale_y),
        rotation_deg=float(np.rad2deg(np.arctan2(matrix[1, 0] - matrix[0, 1], matrix[0, 0] + matrix[1, 1]))),
    )


def _require_trustworthy(found: Registration, side_px: int) -> None:
    """Refuse a map that a drift of the camera cannot explain, or that the picture does not determine."""
    largest_px = LARGEST_MOVE_OF_SIDE * side_px
    reasons = []
    if not found.score_rel >= LEAST_SCORE:
        reasons.append(
            f"the correlation of the gradients is only {found.score_rel:.2f}, but must be at least {LEAST_SCORE:g}"
        )
    if not found.score_rel >= found.score_before_rel:
        reasons.append(
            f"the correlation of the gradients was higher before the registration ({found.score_before_rel:.2f})"
        )
    if found.largest_move_px > largest_px:
        reasons.append(
            f"the render would move by up to {found.largest_move_px:.1f} px, but at most {largest_px:.0f} px are "
            "allowed"
        )
    if max(abs(found.scale_x - 1), abs(found.scale_y - 1)) > LARGEST_SCALE_CHANGE:
        reasons.append(
            f"the scale would change to {found.scale_x:.3f} and {found.scale_y:.3f}, but a change of at most "
            f"{100 * LARGEST_SCALE_CHANGE:.0f} % is allowed"
        )
    if abs(found.rotation_deg) > LARGEST_ROTATION_DEG:
        reasons.append(
            f"the render would turn by {found.rotation_deg:.1f} deg, but at most {LARGEST_ROTATION_DEG:g} deg are "
            "allowed"
        )
    largest_residual_px = max(LARGEST_RESIDUAL_PX, LARGEST_RESIDUAL_OF_MOVE * found.move_px)
    if not found.residual_px <= largest_residual_px:
        reasons.append(
            f"two halves of the picture disagree about the move by a standard uncertainty of {found.residual_px:.1f} "
            f"px, but at most {largest_residual_px:.1f} px are allowed"
        )
    if reasons:
        raise CompareError(f"registration is rejected because {'; '.join(reasons)}")


def register_press(press: SimulatedPress, capture: TactileCapture) -> tuple[Registration, str]:
    """Find the drift of the camera between a render and a capture.

    On the images without contact, where nothing but the camera can move; where they have too few edges, on those with
    contact, which takes an error of the indenter's place for a part of the drift.

    Returns
    -------
    Registration
    str
        "no contact" or "contact": the images it rests on.

    Raises
    ------
    CompareError
        Neither pair of images gives a map that can be trusted; the message holds both reasons.
    """
    reasons = []
    pairs = (
        ("no contact", press.no_contact, capture.no_contact),
        ("contact", press.contact, capture.contact),
    )
    for state, rendered, counts in pairs:
        try:
            return register(rendered.astype(np.float64), rgb_image(counts, capture)), state
        except CompareError as error:
            reasons.append(f"on the images with {state}: {error}")
    raise CompareError("; ".join(reasons))


def move_press(press: SimulatedPress, to_render: Floats) -> SimulatedPress:
    """Return a press with all its images and the distance map on the grid of the capture.

    Light is interpolated by Lanczos' kernel over 8 x 8 pixels and stays at or above zero where it was; beyond the
    render's edge the nearest pixel stands in, and the distance is NaN there, so that no region holds such a pixel. The
    distance is interpolated linearly. Variances become those of interpolated pixels up to their correlation.

    Parameters
    ----------
    press : SimulatedPress
        In linear light, or a table prediction in encoded values, whose interpolation is an approximation.
    to_render : ndarray, shape (2, 3)
        See `finray_calib.compare._registration.Registration`.
    """
    moved = _moved(press, to_render)
    distance = warp_image(press.distance, to_render, cv2.INTER_LINEAR)
    distance[np.isnan(warp_image(press.contact, to_render)).any(axis=2)] = np.nan
    return press.model_copy(update={**moved, "distance": distance.astype(np.float32)})


def _moved(record: Model, to_render: Floats) -> dict[str, Any]:
    """Return the fields of a record that hold images, moved; fields in inner records too."""
    update: dict[str, Any] = {}
    for name, info in type(record).model_fields.items():
        value = getattr(record, name)
        # the spec of an optional array stands inside the union
        inner = (m for part in get_args(info.annotation) for m in getattr(part, "__metadata__", ()))
        spec = next((m for m in (*info.metadata, *inner) if isinstance(m, ArraySpec)), None)
        if isinstance(value, Model):
            update[name] = value.model_copy(update=_moved(value, to_render))
        elif value is not None and spec is not None and "row" in spec.dims and not spec.allow_nan:
            update[name] = _moved_image(value, spec.dims.index("row"), to_render)
    return update


def _moved_image(image: NDArray[np.float32], row_axis: int, to_render: Floats) -> NDArray[np.float32]:
    """Return an array whose rows and columns are those of an image, moved plane by plane."""
    rows, columns = image.shape[row_axis : row_axis + 2]
    planes = np.moveaxis(image, (row_axis, row_axis + 1), (-2, -1)).astype(np.float64)
    moved = np.empty(planes.shape, dtype=np.float32)
    flags = cv2.INTER_LANCZOS4 | cv2.WARP_INVERSE_MAP
    for index in np.ndindex(planes.shape[:-2]):
        plane = np.ascontiguousarray(planes[index])
        warped = cv2.warpAffine(plane, to_render, (columns, rows), flags=flags, borderMode=cv2.BORDER_REPLICATE)
        # the kernel overshoots at edges, but light is never negative
        moved[index] = np.maximum(warped, 0.0) if plane.min() >= 0 else warped
    return np.ascontiguousarray(np.moveaxis(moved, (-2, -1), (row_axis, row_axis + 1)))


def warp_image(image: NDArray[np.floating], to_render: Floats, interpolation: int = cv2.INTER_LANCZOS4) -> Floats:
    """Return an image of the render's grid on the capture's grid, in double precision.

    NaN comes where a pixel of the interpolation's window is missing or lies outside; no value is made up. Resample
    linear light only: encoded values are not proportional to it.

    Parameters
    ----------
    image : ndarray, shape (H, W) or (H, W, C)
    to_render : ndarray, shape (2, 3)
        (column, row) of the image = to_render @ (column, row, 1) of the new grid; whole numbers are pixel centres.
    interpolation : int
        OpenCV's flag: Lanczos over 8 x 8 pixels, or ``cv2.INTER_LINEAR`` over 2 x 2 for what must not overshoot.
    """
    planes = np.asarray(image, dtype=np.float64).reshape(*image.shape[:2], -1)
    size = image.shape[1], image.shape[0]
    flags = interpolation | cv2.WARP_INVERSE_MAP
    missing = ~every_channel(np.isfinite(planes))
    filled = np.where(missing[..., None], 0.0, planes)
    warped = np.stack([cv2.warpAffine(np.ascontiguousarray(p), to_render, size, flags=flags)
                       for p in np.moveaxis(filled, 2, 0)], axis=-1)  # fmt: skip
    reach = 4 if interpolation == cv2.INTER_LANCZOS4 else 1
    warped[_incomplete(missing, to_render, reach)] = np.nan
    return np.asarray(warped.reshape(image.shape), dtype=np.float64)


def _incomplete(missing: Mask, to_render: Floats, reach_px: int) -> Mask:
    """Return where the window around the place in the render touches a missing pixel or the outside."""
    height, width = missing.shape
    rows, columns = np.indices(missing.shape)
    column, row = (m[0] * columns + m[1] * rows + m[2] for m in to_render)
    first_column, first_row = (np.floor(v).astype(int) - reach_px + 1 for v in (column, row))
    whole = np.pad(np.cumsum(np.cumsum(missing, axis=0), axis=1), ((1, 0), (1, 0)))
    last_column, last_row = (np.ceil(v).astype(int) + reach_px for v in (column, row))
    outside = (first_column < 0) | (first_row < 0) | (last_column > width) | (last_row > height)
    left, right = (np.clip(v, 0, width) for v in (first_column, last_column))
    top, bottom = (np.clip(v, 0, height) for v in (first_row, last_row))
    inside_window = whole[bottom, right] - whole[top, right] - whole[bottom, left] + whole[top, left]
    return np.asarray(outside | (inside_window > 0))


#: Sensor and render noise have their gradients below this scale, the shades of a soft pad above it.
_BLUR_PX = 2.0
_REACH_PX = 9
#: Of a channel's mean; below it the logarithm would show noise.
_DARK_REL = 0.1


def gradient_view(image: Floats) -> tuple[Floats, Mask]:
    """Return the gradient magnitude of the channels' mean logarithm, and where it can be trusted.

    A gain of a channel does not change the logarithm's gradient, a power only its scale, and a shade over the picture
    adds little: what is left are the edges. A dim fluorescent channel counts as much as that of the light.

    Parameters
    ----------
    image : ndarray, shape (H, W, 3)

    Returns
    -------
    magnitude : ndarray, shape (H, W)
        Relative change per pixel, after a blur of 2 px.
    usable : ndarray of bool, shape (H, W)
        False near pixels that are not finite.
    """
    finite = every_channel(np.isfinite(image))
    filled = np.where(finite[..., None], image, 0.0)
    level = filled.sum(axis=(0, 1)) / max(int(finite.sum()), 1)
    relative = np.maximum(filled / np.where(level > 0, level, 1.0), 0.0)
    tone = np.where(finite, np.log(relative + _DARK_REL).mean(axis=2), 0.0)
    smooth = cv2.GaussianBlur(tone, (0, 0), _BLUR_PX)
    rows, columns = (cv2.Sobel(smooth, cv2.CV_64F, *order, scale=1 / 8) for order in ((0, 1), (1, 0)))
    near = cv2.dilate((~finite).astype(np.uint8), np.ones((2 * _REACH_PX + 1,) * 2, np.uint8)) > 0
    return np.hypot(rows, columns), ~near
