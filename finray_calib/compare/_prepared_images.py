"""Bring a simulated press and a capture to one grid and one unit, or refuse to compare them.

Refused are other stated conditions (light, indenter or push), sizes and encodings. The design of the render is compared
with the record of the capture; what either does not state is not judged.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from data_schemas import CompareError, Indenter, IndenterPose, SimulatedPress, TactileCapture
from finray_calib.compare._image_noise import NO_NOISE, block_mean, capture_noise
from finray_calib.compare._region_sums import Captured, RenderLayers, render_layers
from finray_calib.sensing import rgb_image

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


#: Angles are set by hand: this near, they are meant to be one.
_SAME_ANGLE_DEG = 1.0
#: Radii are typed from a drawing or measured by a calliper: this near, they are meant to be one.
_SAME_RADIUS_REL = 0.02
#: Depths and positions of one press as two files state them, where no uncertainty allows more.
_SAME_DEPTH_MM, _SAME_POSITION_MM = 0.05, 0.5
#: Differences up to so many stated standard uncertainties are one condition.
_STANDARD_UNCERTAINTIES = 3.0
_ROUND_SHAPES = ("cylinder", "ball")


def require_same_conditions(press: SimulatedPress, capture: TactileCapture) -> None:
    """Refuse a render of another light, indenter or push than the capture's, with both numbers and what to do.

    Raises
    ------
    CompareError
        Angles of the light, shapes or radii of the indenter, depths or positions of the push differ by more than three
        stated standard uncertainties and by more than is one setting: 1 deg, 2 %, 0.05 mm, 0.5 mm.
    """
    _require_same_light(press, capture)
    if press.design is None:
        return
    _require_same_indenter(press.name, press.design.indenter, capture)
    _require_same_push(press.name, press.design.indenter, capture)


def _allowed(same: float, uncertainty: float | None) -> float:
    """Return the largest difference that is none."""
    # 2 and 1.95 are 0.05 apart although their difference in binary is a little more
    return max(same, _STANDARD_UNCERTAINTIES * (uncertainty or 0.0)) * (1.0 + 1e-9)


def _require_same_light(press: SimulatedPress, capture: TactileCapture) -> None:
    """Refuse another angle of the light."""
    rendered_deg, captured_deg = press.light_angle_deg, capture.light_angle_deg
    if rendered_deg is None or captured_deg is None:
        return
    allowed_deg = _allowed(_SAME_ANGLE_DEG, capture.light_angle_uncertainty_deg)
    if abs(rendered_deg - captured_deg) > allowed_deg:
        raise CompareError(
            f"{press.name} is lit at {rendered_deg:g} deg, {capture.name} at {captured_deg:g} deg; up to "
            f"{allowed_deg:.2g} deg apart are one light: simulate with the capture's light.angle_deg"
        )


def _require_same_indenter(name: str, rendered: Indenter, capture: TactileCapture) -> None:
    """Refuse another shape or size; a capture states no size of cuboids and meshes."""
    captured = capture.indenter
    if rendered.shape != captured.shape:
        raise CompareError(
            f"{name} presses a {_described(rendered)}, {capture.name} a {_described(captured)}: simulate with the "
            "capture's indenter.shape and size, or correct the indenter of the capture's record"
        )
    if captured.shape not in _ROUND_SHAPES:
        return
    if abs(rendered.radius_mm / captured.radius_mm - 1.0) > _SAME_RADIUS_REL * (1.0 + 1e-9):
        raise CompareError(
            f"{name} presses a {_described(rendered)}, {capture.name} a {_described(captured)}; up to "
            f"{_SAME_RADIUS_REL:.0%} apart are one size: simulate with the capture's indenter.radius_mm"
        )


def _described(indenter: Indenter | IndenterPose) -> str:
    """Return shape, and radius where the shape has one."""
    radius = f" of radius {indenter.radius_mm:g} mm" if indenter.shape in _ROUND_SHAPES else ""
    return f"{indenter.shape}{radius}"


def _require_same_push(name: str, rendered: Indenter, capture: TactileCapture) -> None:
    """Refuse another depth or position along the pad."""
    captured = capture.indenter
    pairs = (
        ("depth_mm", "deep", "depth", _SAME_DEPTH_MM, captured.depth_uncertainty_mm),
        ("position_mm", "along the pad", "position", _SAME_POSITION_MM, captured.position_uncertainty_mm),
    )
    for field, where, what, same_mm, uncertainty_mm in pairs:
        rendered_mm, captured_mm = getattr(rendered, field), getattr(captured, field)
        allowed_mm = _allowed(same_mm, uncertainty_mm)
        if captured_mm is not None and abs(rendered_mm - captured_mm) > allowed_mm:
            raise CompareError(
                f"{name} is pressed {rendered_mm:g} mm {where}, {capture.name} {captured_mm:g} mm; up to "
                f"{allowed_mm:.2g} mm apart are one {what}: simulate with the capture's indenter.{field}, or, if it is "
                f"not known so well, state {field.removesuffix('_mm')}_uncertainty_mm in the capture"
            )
