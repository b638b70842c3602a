"""Bring a simulated press and a capture to one grid and one unit, or refuse to compare them."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from data_schemas.capture import TactileCapture
from data_schemas.errors import CompareError
from data_schemas.simulate import SimulatedPress
from finray_calib.compare.blocks import block_mean
from finray_calib.compare.capture_noise import NO_NOISE, capture_noise
from finray_calib.compare.linear_image import rgb_image
from finray_calib.compare.press_conditions import require_same_conditions
from finray_calib.compare.region_sums import Captured
from finray_calib.compare.render_layers import RenderLayers, render_layers

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class PreparedImages:
    """Both sides of a comparison; captured values are DN above black level.

    Attributes
    ----------
    layers
        The render.
    captured
        Contact, no contact and repeat, NaN where any of them is clipped, and the noise of the camera; none is taken
        out of encoded values, nor where there is no repeat to tell it from.
    clipped
        (H, W) whether a captured image is at full scale.
    distance
        (H, W) distance from the contact's centre in half-widths, NaN off the pad.
    block_px
        Side of the blocks of pixels that the images are means of.
    """

    layers: RenderLayers
    captured: Captured
    clipped: NDArray[np.bool_]
    distance: Floats
    block_px: int = 1

    def blocked(self, side_px: int) -> "PreparedImages":
        """Return the means over blocks of pixels."""
        return PreparedImages(
            layers=self.layers.blocked(side_px),
            captured=self.captured.blocked(side_px),
            clipped=block_mean(self.clipped.astype(np.float64), side_px) > 0.0,
            distance=block_mean(self.distance, side_px),
            block_px=side_px,
        )


def prepare_images(press: SimulatedPress, capture: TactileCapture) -> PreparedImages:
    """Return both sides of a comparison on one grid.

    Raises
    ------
    CompareError
        Light, indenter or push of both differ (see `require_same_conditions`), the images differ in size, linear light
        would be compared with encoded values, or the render is not finite.
    """
    contact, no_contact = rgb_image(capture.contact, capture), rgb_image(capture.no_contact, capture)
    repeat = None if capture.repeat_no_contact is None else rgb_image(capture.repeat_no_contact, capture)
    _require_comparable(press, capture, contact.shape)
    images = [contact, no_contact] if repeat is None else [contact, no_contact, repeat]
    clipped = np.logical_or.reduce([np.isnan(image).any(axis=-1) for image in images])
    noise = NO_NOISE
    if repeat is not None and capture.encoding == "linear":
        noise = capture_noise(no_contact, repeat)
    for image in images:
        image[clipped] = np.nan
    return PreparedImages(
        render_layers(press), Captured(contact, no_contact, repeat, noise), clipped, press.distance.astype(np.float64)
    )


def _require_comparable(press: SimulatedPress, capture: TactileCapture, shape: tuple[int, ...]) -> None:
    """Refuse images of another light, press, size or encoding, with what to do."""
    require_same_conditions(press, capture)
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
