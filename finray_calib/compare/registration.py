"""Bring a render to the pixel grid of a capture: an affine drift of the camera, found on gradients, or a refusal.

The render moves, never the capture: the noise of the capture stays what it is. A map takes a pixel (column, row) of
the capture to the place of the render that shows the same; whole numbers are pixel centres.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from data_schemas.errors import CompareError
from finray_calib.compare.blocks import block_mean
from finray_calib.compare.gradient_view import gradient_view
from finray_calib.compare.image_warp import warp_image

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
            f"the render lies {self.move_px:.2f} px (at most {self.largest_move_px:.2f} px) beside the capture, known "
            f"to {self.residual_px:.2f} px: scale {self.scale_x:.4f} along x and {self.scale_y:.4f} along y, rotation "
            f"{self.rotation_deg:.2f} deg, correlation of gradients {self.score_before_rel:.2f} before and "
            f"{self.score_rel:.2f} after"
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
            f"only {usable.mean():.1%} of the picture is usable on both sides, at least {LEAST_SHARE_OF_PICTURE:.0%} "
            "is needed to register: expose the capture so that less of it is clipped"
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
        reasons.append(f"the gradients correlate by {found.score_rel:.2f} only, at least {LEAST_SCORE:g} is needed")
    if not found.score_rel >= found.score_before_rel:
        reasons.append(f"the gradients correlate less than without it ({found.score_before_rel:.2f})")
    if found.largest_move_px > largest_px:
        reasons.append(f"it moves the render by up to {found.largest_move_px:.1f} px, {largest_px:.0f} px are allowed")
    if max(abs(found.scale_x - 1), abs(found.scale_y - 1)) > LARGEST_SCALE_CHANGE:
        reasons.append(
            f"it changes the scale to {found.scale_x:.3f} and {found.scale_y:.3f}, {LARGEST_SCALE_CHANGE:.0%} is "
            "allowed"
        )
    if abs(found.rotation_deg) > LARGEST_ROTATION_DEG:
        reasons.append(f"it turns the render by {found.rotation_deg:.1f} deg, {LARGEST_ROTATION_DEG:g} deg are allowed")
    largest_residual_px = max(LARGEST_RESIDUAL_PX, LARGEST_RESIDUAL_OF_MOVE * found.move_px)
    if not found.residual_px <= largest_residual_px:
        reasons.append(
            f"two halves of the picture disagree: it is known to {found.residual_px:.1f} px only, "
            f"{largest_residual_px:.1f} px are allowed"
        )
    if reasons:
        raise CompareError(f"registration is rejected: {'; '.join(reasons)}")
