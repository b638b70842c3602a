"""Bring a simulated press and a capture to one grid and one unit, or refuse to compare them."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from data_schemas.capture import TactileCapture
from data_schemas.errors import CompareError
from data_schemas.simulate import SimulatedPress
from finray_calib.compare.blocks import block_mean, block_side_px
from finray_calib.compare.linear_image import rgb_image
from finray_calib.compare.structural_similarity import WINDOW_PX
from finray_calib.compare.tiles import MINIMUM_TILES

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class PreparedImages:
    """Images in DN above black level, averaged over blocks of the capture's pixels.

    Attributes
    ----------
    simulated, simulated_no_contact
        (H, W, 3) render, brought to the level of the capture in linear light.
    contact, no_contact, repeat
        (H, W, 3) capture; the repeat may be missing.
    clipped
        (H, W) whether a sample of the block is at full scale in a captured image.
    distance
        (H, W) distance from the contact's centre in half-widths, NaN off the pad.
    scale
        DN per unit of the render's radiance that was applied.
    block_px
        Side of the blocks.
    """

    simulated: Floats
    simulated_no_contact: Floats
    contact: Floats
    no_contact: Floats
    repeat: Floats | None
    clipped: NDArray[np.bool_]
    distance: Floats
    scale: float
    block_px: int


def prepare_images(press: SimulatedPress, capture: TactileCapture) -> PreparedImages:
    """Return both sides of a comparison on one grid.

    Raises
    ------
    CompareError
        The images differ in size, linear light would be compared with encoded values, or the render is black.
    """
    contact, no_contact = rgb_image(capture.contact, capture), rgb_image(capture.no_contact, capture)
    repeat = None if capture.repeat_no_contact is None else rgb_image(capture.repeat_no_contact, capture)
    _require_comparable(press, capture, contact.shape)
    distance = press.distance.astype(np.float64)
    scale = _common_scale(press, no_contact) if capture.encoding == "linear" else 1.0
    variance = None if press.variance is None else press.variance.astype(np.float64)
    side = block_side_px(press.contact.astype(np.float64), variance, np.isfinite(distance))
    _require_blocks(press.name, block_mean(distance, side), side)

    captured = [contact, no_contact] if repeat is None else [contact, no_contact, repeat]
    clipped = np.logical_or.reduce([np.isnan(image).any(axis=-1) for image in captured])

    def binned(image: NDArray[np.floating]) -> Floats:
        return block_mean(image.astype(np.float64), side)

    return PreparedImages(
        simulated=scale * binned(press.contact),
        simulated_no_contact=scale * binned(press.no_contact),
        contact=binned(contact),
        no_contact=binned(no_contact),
        repeat=None if repeat is None else binned(repeat),
        clipped=block_mean(clipped.astype(np.float64), side) > 0,
        distance=binned(distance),
        scale=scale,
        block_px=side,
    )


def _require_comparable(press: SimulatedPress, capture: TactileCapture, shape: tuple[int, ...]) -> None:
    """Refuse images of different size or encoding, with what to do."""
    if press.contact.shape != shape:
        raise CompareError(
            f"{press.name} has {press.contact.shape[1]} x {press.contact.shape[0]} px, {capture.name} has {shape[1]} x "
            f"{shape[0]} px: simulate with the camera of the capture (design: camera.width_px, camera.height_px)"
        )
    balanced = press.shown_light is not None and press.shown_light.white_balance != (1.0, 1.0, 1.0)
    if balanced and capture.encoding == "linear":
        raise CompareError(
            f"{press.name} was given a white balance, {capture.name} holds the camera's own channels: recolour the "
            "press without --white-balance (or with 1:1:1)"
        )
    if press.encoding != capture.encoding:
        raise CompareError(
            f"{press.name} holds {press.encoding} values, {capture.name} {capture.encoding} ones: linear light cannot "
            "be compared with an image whose encoding is unknown; capture raw frames, or compare a table prediction"
        )


def _require_blocks(name: str, distance: Floats, side: int) -> None:
    """Refuse a render whose noise needs blocks so large that too few are left."""
    on_contact = int((distance <= 1.0).sum())
    if side > 1 and (min(distance.shape) < WINDOW_PX or on_contact < MINIMUM_TILES):
        raise CompareError(
            f"{name} is so noisy that it must be averaged over blocks of {side} x {side} px, which leaves "
            f"{distance.shape[1]} x {distance.shape[0]} blocks and {on_contact} of them on the contact; at least "
            f"{WINDOW_PX} x {WINDOW_PX} and {MINIMUM_TILES} are needed: simulate with more "
            "--samples or a camera with more pixels"
        )


def _common_scale(press: SimulatedPress, no_contact: Floats) -> float:
    """Return DN per unit of radiance that brings a render to the level of the capture (refined by the factor)."""
    simulated = press.no_contact.astype(np.float64)
    usable = np.isfinite(press.distance) & np.isfinite(no_contact).all(axis=-1)
    total = simulated[usable].sum()
    if not usable.any() or total <= 0:
        raise CompareError(f"{press.name}: the no-contact image is black where the capture sees the pad")
    return float(no_contact[usable].sum() / total)
