"""Bring a simulated press and a capture to one grid and one unit, or refuse to compare them.

Refused are other stated conditions (light, indenter or push), sizes, and encoded values of a render beside light of a
capture. The design of the render is compared with the record of the capture; what either does not state is not judged.
A render in linear light meets an encoded capture through an unknown tone curve, and gains of the camera that differ
between the captures are taken out: both are nuisances that the images without contact and the pixels far from it tell.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from data_schemas import CompareError, Indenter, IndenterPose, SimulatedPress, TactileCapture
from finray_calib.compare._image_noise import NO_NOISE, block_mean, capture_noise, high_passed, missing_pixels
from finray_calib.compare._region_sums import Captured, RenderLayers, render_layers
from finray_calib.compare._regions import every_channel
from finray_calib.compare._tone_curve import (
    NUISANCE_DRAWS,
    FarGain,
    ToneFit,
    encoded_layers,
    far_gain,
    fit_tone,
    layers_without_gain,
    without_gain,
)
from finray_calib.sensing import full_scale_dn, rgb_image

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Nuisances:
    """Hold what the camera does between render and capture, and both sides before it is taken out.

    Attributes
    ----------
    render : RenderLayers
        As it is stored.
    contact : ndarray, shape (H, W, 3)
        As captured.
    no_contact : ndarray, shape (H, W, 3)
        As captured.
    tone : ToneFit or None
        None where both sides hold the same kind of values.
    gain : FarGain or None
        None where it cannot be told.
    is_corrected : bool
        Whether the gain is taken out.
    """

    render: RenderLayers
    contact: Floats
    no_contact: Floats
    tone: ToneFit | None
    gain: FarGain | None
    is_corrected: bool

    @property
    def is_idle(self) -> bool:
        """Whether nothing is changed on either side."""
        return self.tone is None and not self.is_corrected

    def blocked(self, side_px: int) -> "Nuisances":
        """Return the means over blocks of pixels."""
        contact, no_contact = (block_mean(image, side_px) for image in (self.contact, self.no_contact))
        return replace(self, render=self.render.blocked(side_px), contact=contact, no_contact=no_contact)

    def at(self, where: NDArray[np.bool_]) -> "Nuisances":
        """Return the same at some pixels (H, W) only, as images of a single row."""
        contact, no_contact = (image[where][None] for image in (self.contact, self.no_contact))
        return replace(self, render=self.render.at(where), contact=contact, no_contact=no_contact)

    def best(self) -> tuple[RenderLayers, Floats]:
        """Return render and captured contact image at the best curve and gains."""
        curve = None if self.tone is None else (self.tone.exponent, self.tone.offset_dn)
        return self._layers(curve), self._contact(curve, np.zeros(3))

    def drawn(self, tone: ToneFit, rng: np.random.Generator) -> Iterator[tuple[RenderLayers, Floats]]:
        """Yield the same for draws of its curve and of the gains."""
        u = np.zeros(3) if self.gain is None else self.gain.u
        for exponent, offset_dn in tone.draws[:NUISANCE_DRAWS].tolist():
            curve = exponent, offset_dn
            yield self._layers(curve), self._contact(curve, u * rng.standard_normal(3))

    def factor_draws(self, rng: np.random.Generator) -> Floats:
        """Return factors (draws, 3) on the best captured contact image for draws of the gains, without a curve."""
        if self.gain is None:
            return np.ones((NUISANCE_DRAWS, 3))
        more = self.gain.u * rng.standard_normal((NUISANCE_DRAWS, 3))
        return np.exp(np.where(self.gain.to_correct, -more, 0.0))

    def _layers(self, curve: tuple[float, float] | None) -> RenderLayers:
        """Return the render through a curve of this exponent and offset, without its gains."""
        layers, offset_dn, steeper = self.render, 0.0, 1.0
        if curve is not None:
            layers, offset_dn = encoded_layers(self.render, self.no_contact, *curve), curve[1]
        if not self.is_corrected or self.gain is None:
            return layers
        if curve is not None and self.tone is not None:
            steeper = curve[0] / self.tone.exponent
        of_render = np.where(self.gain.to_correct, steeper * self.gain.log_simulated, 0.0)
        return layers_without_gain(layers, of_render, offset_dn)

    def _contact(self, curve: tuple[float, float] | None, more: Floats) -> Floats:
        """Return the captured contact image without gains that differ by `more` in their logarithm."""
        if not self.is_corrected or self.gain is None:
            return self.contact
        of_capture = np.where(self.gain.to_correct, self.gain.log_captured + more, 0.0)
        return without_gain(self.contact, of_capture, 0.0 if curve is None else curve[1])


def nuisances_of(
    press: SimulatedPress, capture: TactileCapture, images: tuple[Floats, Floats] | None = None
) -> Nuisances:
    """Estimate tone curve and gains; images of one size, the captured ones (contact, no contact) where they are known.

    The curve is fitted where a render in linear light meets encoded values. Gains that all pixels far from the contact
    share are taken out of both sides, each by its own, so that an image without contact that was given the gain of the
    capture explains nothing; of a render whose paints and camera are known they are only told, for there they may be an
    error of the render, which is to be seen.
    """
    contact, no_contact = images or [rgb_image(counts, capture) for counts in (capture.contact, capture.no_contact)]
    render, distance = render_layers(press), press.distance.astype(np.float64)
    if capture.encoding == "linear" and begins_from(press, no_contact):
        render = replace(render, rest_noise=_noise_of_rest(press, no_contact))
    full_dn = full_scale_dn(capture)
    tone, shown, offset_dn = None, render, 0.0
    if press.encoding == "linear" and capture.encoding == "unknown":
        # a generator of its own: the curve of a pair does not depend on what else is drawn
        tone = fit_tone(
            render.rgb(render.no_contact), no_contact, np.isfinite(distance), full_dn, np.random.default_rng(_TONE_SEED)
        )
        offset_dn = tone.offset_dn
        shown = encoded_layers(render, no_contact, tone.exponent, offset_dn)
    simulated = [shown.rgb(image) - offset_dn for image in (shown.contact, shown.no_contact)]
    captured = (contact - offset_dn, no_contact - offset_dn)
    gain = far_gain(captured, (simulated[0], simulated[1]), distance, full_dn)
    is_corrected = shown.inputs is None and gain is not None and bool(gain.to_correct.any()) and not gain.is_refused
    return Nuisances(render, contact, no_contact, tone, gain, is_corrected)


_TONE_SEED = 20_040


def begins_from(press: SimulatedPress, no_contact: Floats) -> bool:
    """Return whether the image without contact of a press is this captured one (H, W, 3), NaN where clipped."""
    if press.no_contact.shape != no_contact.shape:
        return False
    alike = press.no_contact == no_contact.astype(press.no_contact.dtype)
    return bool((alike | ~np.isfinite(no_contact)).all())


def _noise_of_rest(press: SimulatedPress, no_contact: Floats) -> Floats:
    """Return (S / B)^2: the factor on the variance of the noise of B that its contact image S = B L1 / L0 holds.

    A contact image that is formed otherwise, as B and a change, differs from it by the contrast of the contact alone.
    """
    rest = np.nan_to_num(no_contact)
    ratio = np.divide(press.contact, rest, out=np.ones(rest.shape), where=rest > 0.0)
    return np.asarray(ratio**2)


def relative_press(press: SimulatedPress, capture: TactileCapture) -> SimulatedPress:
    """Return a render at the light of the capture: S = B L1 / L0, with B the captured image without contact.

    The render's own light field without contact is then not judged: its level, colours and shading. The noise of B is
    in S, too, and is taken out of the error where a repeat tells it. What is known of paints and camera acts on the
    light field, and is left out.

    Raises
    ------
    CompareError
        One of both is not linear light; encoded values are compared in this way through their tone curve.
    """
    if press.encoding != "linear" or capture.encoding != "linear":
        raise CompareError(
            f"--relative needs linear values in both records, but the encoding of {press.name} is {press.encoding} and "
            f"that of {capture.name} is {capture.encoding}. Leave --relative out; encoded captures are always compared "
            "in this way"
        )
    rest = rgb_image(capture.no_contact, capture)
    if press.no_contact.shape != rest.shape:
        return press  # refused with both sizes where images are compared
    layers = encoded_layers(render_layers(press), rest, 1.0, 0.0)
    dropped = dict.fromkeys(
        (
            "no_contact_bands", "contact_bands", "contact_bands_variance", "no_contact_chains", "contact_chains",
            "known_inputs", "pose_response", "camera_matrix",
        )
    )  # fmt: skip
    return press.model_copy(
        update={
            **dropped,
            "bands": (), "chains": (), "layer_matrix": np.eye(3), "variance": None,
            "contact": layers.contact, "no_contact": np.nan_to_num(rest).astype(np.float32),
            "contact_half_difference": layers.contact_half, "no_contact_half_difference": layers.no_contact_half,
            "notes": (*press.notes, RELATIVE),
        }
    )  # fmt: skip


RELATIVE = (
    "compared relative to the capture's own image without contact, which stands in the place of the render's: only the "
    "change by contact is judged, and not the level, colours and shading of the render without contact"
)


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
    nuisances
        Tone curve and gains, which are taken out of `layers` and `captured`.
    block_px
        Side of the blocks of pixels that the images are means of.
    holds_noise_of_render
        Whether the capture was made from this very render, see :func:`holds_noise_of`.
    """

    layers: RenderLayers
    captured: Captured
    clipped: NDArray[np.bool_]
    distance: Floats
    nuisances: Nuisances
    block_px: int = 1
    holds_noise_of_render: bool = False

    def blocked(self, side_px: int) -> "PreparedImages":
        """Return the means over blocks of pixels."""
        layers, captured, nuisances = self.layers.blocked(side_px), self.captured.blocked(side_px), self.nuisances
        if not nuisances.is_idle:
            # the curve of a mean, not the mean of the curve: the render's noise is large in single pixels
            nuisances = nuisances.blocked(side_px)
            layers, contact = nuisances.best()
            captured = replace(captured, contact=contact)
        return PreparedImages(
            layers=layers,
            captured=captured,
            nuisances=nuisances,
            clipped=block_mean(self.clipped.astype(np.float64), side_px) > 0.0,
            distance=block_mean(self.distance, side_px),
            block_px=side_px,
            holds_noise_of_render=self.holds_noise_of_render,
        )


def prepare_images(
    press: SimulatedPress, capture: TactileCapture, estimated: Nuisances | None = None
) -> PreparedImages:
    """Return both sides of a comparison on one grid, without the curve and gains that were `estimated` of them, if any.

    Raises
    ------
    CompareError
        Light, indenter or push of both differ (see `require_same_conditions`), the images differ in size, the render
        holds encoded values and the capture light, or the render is not finite.
    """
    if estimated is None:
        contact, no_contact = rgb_image(capture.contact, capture), rgb_image(capture.no_contact, capture)
    else:
        contact, no_contact = estimated.contact.copy(), estimated.no_contact.copy()
    repeat = None if capture.repeat_no_contact is None else rgb_image(capture.repeat_no_contact, capture)
    _require_comparable(press, capture, contact.shape)
    images = [contact, no_contact] if repeat is None else [contact, no_contact, repeat]
    clipped = missing_pixels(*images)
    if clipped is None:
        clipped = np.zeros(contact.shape[:2], dtype=np.bool_)
    noise = NO_NOISE
    if repeat is not None and capture.encoding == "linear":
        noise = capture_noise(no_contact, repeat)
    for image in images if clipped.any() else ():
        image[clipped] = np.nan
    nuisances = estimated or nuisances_of(press, capture)
    nuisances = replace(nuisances, contact=contact, no_contact=no_contact)
    layers, compared = nuisances.best()
    captured = Captured(compared, no_contact, repeat, noise)
    is_own = capture.encoding == "linear" and holds_noise_of(layers, captured)
    if is_own:
        layers = layers.without_noise
        nuisances = replace(nuisances, render=nuisances.render.without_noise)
    distance = press.distance.astype(np.float64)
    return PreparedImages(layers, captured, clipped, distance, nuisances, holds_noise_of_render=is_own)


#: Noise of an independent capture differs from the render's by at least the sum of both; of a capture made from the
#: render the render's part is missing. Half-way lies far from either: thousands of pixels tell.
_OWN_NOISE_SHARE = 0.5
_LEAST_NOISE_PIXELS = 500
# noise of the render below this share of the camera's moves no score, and is not told from it
_LEAST_RENDER_NOISE = 0.3
#: By so much the camera's noise may be taken too large, as where the repeat holds more of it. Without this margin an
#: independent capture would be taken for one of the render's.
_CAMERA_NOISE_TOO_LARGE_REL = 0.15


def holds_noise_of(layers: RenderLayers, captured: Captured) -> bool:
    r"""Return whether a capture holds the very noise of the render that it is compared with.

    Through a high-pass of unit noise gain, k S - D of independent images has at least the variance
    :math:`k^2 v_S + v_D`; of a capture that was made from the render :math:`v_D`. The product of the render's halves,
    :math:`(S_1 - D)(S_2 - D)`, would then be negative, and the skill would exceed 1 by the render's noise over the
    contact signal. :math:`v_S` is what the half difference shows through the same high-pass.

    Parameters
    ----------
    layers, captured
        In linear light.
    """
    image, half = layers.rgb(layers.contact), layers.rgb(layers.contact_half)
    contact = captured.contact
    seen = np.isfinite(contact)
    if not half.any() or not (np.nan_to_num(contact) > 0.0).any():
        return False
    k = [contact[..., c][seen[..., c]].sum() / max(image[..., c][seen[..., c]].sum(), 1e-300) for c in range(3)]
    left, of_render = high_passed(image * k - contact), high_passed(half * k)
    of_camera = captured.variance(np.nan_to_num(contact))
    used = every_channel(np.isfinite(left)) & (np.nan_to_num(of_render) != 0.0).any(axis=2)
    if used.sum() < _LEAST_NOISE_PIXELS:
        return False
    render, camera = (of_render[used] ** 2).mean(axis=0), of_camera[used].mean(axis=0)
    told = render > _LEAST_RENDER_NOISE * camera
    share = ((left[used] ** 2).mean(axis=0) - (1.0 - _CAMERA_NOISE_TOO_LARGE_REL) * camera)[told] / render[told]
    return bool(told.any() and float(np.median(share)) < _OWN_NOISE_SHARE)


def _require_comparable(press: SimulatedPress, capture: TactileCapture, shape: tuple[int, ...]) -> None:
    """Refuse images of another light, press, size or encoding, with what to do."""
    require_same_conditions(press, capture)
    if press.contact.shape != shape:
        raise CompareError(
            f"{press.name} has {press.contact.shape[1]} x {press.contact.shape[0]} px, but {capture.name} has "
            f"{shape[1]} x {shape[0]} px; simulate with the camera of the capture (design: camera.width_px, "
            "camera.height_px)"
        )
    balanced = press.shown_light is not None and press.shown_light.white_balance != (1.0, 1.0, 1.0)
    if balanced and capture.encoding == "linear":
        raise CompareError(
            f"{press.name} was given a white balance, but {capture.name} contains the camera's own channels; recolour "
            "the press without --white-balance (or with 1:1:1)"
        )
    if press.encoding == "unknown" and capture.encoding == "linear":
        raise CompareError(
            f"{press.name} contains encoded values but {capture.name} contains linear light, and encoded values cannot "
            "be converted to linear light without loss; give the simulation in linear light"
        )
    if press.encoding == "unknown" and capture.encoding == "unknown":
        _require_one_scale(press, capture)
        _require_colours(press, capture)


#: A capture has colours where channels of a hundredth of its blocks of pixels differ by more than this share of its
#: mean: lights of several colours may add up to white where nothing touches, and noise of a white one has no blocks.
_COLOURED, _COLOUR_BLOCK_PX = 0.1, 8


def _require_colours(press: SimulatedPress, capture: TactileCapture) -> None:
    """Refuse a grey render of encoded values beside a capture in colour.

    A render that does not change where it is touched has no light of its own: of a white rest it is grey.
    """
    if (press.contact != press.contact[..., :1]).any() or (press.contact == press.no_contact).all():
        return
    seen = block_mean(rgb_image(capture.contact, capture), min(_COLOUR_BLOCK_PX, *press.contact.shape[:2]))
    seen = seen[every_channel(np.isfinite(seen))]
    if seen.size and float(np.percentile(np.ptp(seen, axis=-1), 99.0)) > _COLOURED * float(seen.mean()):
        raise CompareError(
            f"{press.name} is grey, but the capture {capture.name} has colours; render in colour, or capture in grey"
        )


#: Encoded values end at full scale; by more than a highlight only another scale does not.
_ABOVE_FULL = 1.25
#: Largest values of the scales that pictures have when nobody asks for the capture's.
_USUAL_SCALES = (1.0, 255.0)


def _require_one_scale(press: SimulatedPress, capture: TactileCapture) -> None:
    """Refuse encoded values whose full scales differ, such as 0 to 1 or 255 beside 0 to 65535.

    Told by the brightest parts of both: images without contact may be black. A render within a smaller usual scale may
    be on the capture's and dim; it is refused where it would be so by more than half of what the scales differ by.
    """
    # as stored: clipped pixels, which count as missing, are as large as the scale is
    rendered = max(_brightest(image) for image in (press.contact, press.no_contact))
    captured = max(_brightest(image) for image in (capture.contact, capture.no_contact)) - capture.black_level_dn
    full_dn = full_scale_dn(capture)
    is_smaller = any(
        0.0 < rendered <= scale < full_dn and captured > rendered * full_dn / scale / 2.0 for scale in _USUAL_SCALES
    )
    if is_smaller or rendered > _ABOVE_FULL * full_dn:
        raise CompareError(
            f"the brightest parts of {press.name} are at {rendered:.3g}, but those of {capture.name} are at "
            f"{captured:.3g} of {full_dn:.0f}; write the render on the scale of the capture, whose pixels have "
            f"{capture.bit_depth} bits ('finray import render' with --capture does this), and with the capture's "
            "exposure"
        )


def _brightest(image: NDArray[Any]) -> float:
    """Return the value that 0.1 % of an image exceed: single pixels may be wrong."""
    return float(np.nanpercentile(image, 99.9))


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
        stated standard uncertainties and by more than is one setting: 1 deg, 2 %, 0.05 mm, 0.5 mm. Or the render
        shows no contact.
    """
    _require_same_light(press, capture)
    if not np.isfinite(press.distance).any():
        raise CompareError(
            f"{press.name!r} is not pressed in; give the design the indenter and depth of {capture.name}, and render "
            "it again"
        )
    if press.indenter is None:
        return
    _require_same_indenter(press.name, press.indenter, capture)
    _require_same_push(press.name, press.indenter, capture)


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
            f"{press.name} is lit at {rendered_deg:g} deg but {capture.name} at {captured_deg:g} deg, and the angles "
            f"may differ by at most {allowed_deg:.2g} deg; simulate with the capture's light.angle_deg"
        )


def _require_same_indenter(name: str, rendered: Indenter, capture: TactileCapture) -> None:
    """Refuse another shape or size; a capture states no size of cuboids and meshes."""
    captured = capture.indenter
    if rendered.pose_shape != captured.shape:
        raise CompareError(
            f"{name} presses a {_described(rendered)}, but {capture.name} presses a {_described(captured)}; simulate "
            "with the capture's indenter.shape and size, or correct the indenter of the capture's record"
        )
    if captured.shape not in _ROUND_SHAPES or captured.radius_mm is None:
        return
    if abs(rendered.radius_mm / captured.radius_mm - 1.0) > _SAME_RADIUS_REL * (1.0 + 1e-9):
        raise CompareError(
            f"{name} presses a {_described(rendered)}, but {capture.name} presses a {_described(captured)}, and the "
            f"radii may differ by at most {100 * _SAME_RADIUS_REL:.0f} %; simulate with the capture's "
            "indenter.radius_mm"
        )


def _described(indenter: Indenter | IndenterPose) -> str:
    """Return shape, and radius where the shape has one."""
    is_known = indenter.shape in _ROUND_SHAPES and indenter.radius_mm is not None
    radius = f" of radius {indenter.radius_mm:g} mm" if is_known else ""
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
                f"{name} is pressed {rendered_mm:g} mm {where} but {capture.name} {captured_mm:g} mm, and the {what} "
                f"may differ by at most {allowed_mm:.2g} mm. Simulate with the capture's indenter.{field}, or state "
                f"{field.removesuffix('_mm')}_uncertainty_mm in the capture if the {what} is known less well"
            )
