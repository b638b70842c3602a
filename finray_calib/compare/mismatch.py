"""Find images that do not belong together: channel order, exposure, encoding, bit depth and black level.

Such mistakes spoil more comparisons than optics does, and a fitted factor would hide them. Every finding carries its
numbers. What the images cannot tell gives no finding: a grey sensor does not show its channel order.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from data_schemas.capture import TactileCapture
from data_schemas.errors import CompareError
from data_schemas.simulate import SimulatedPress
from finray_calib.compare.blocks import block_mean
from finray_calib.compare.channel_order import better_order
from finray_calib.compare.linear_image import rgb_image
from finray_calib.compare.raw_levels import level_findings
from finray_calib.compare.tone_curve import tone_curve

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]
Severity = Literal["refuse", "warn"]
Subject = Literal["channel order", "exposure", "encoding", "levels"]
#: Means over blocks bring noise of render and sensor below what the rules look for.
_BLOCK_PX = 8
_LEAST_BLOCKS = 24
#: Beyond this many half-widths from the contact the light should be that of no contact.
_OFF_CONTACT = 3.0
#: Off-contact level of contact over no contact beside that of the render. Real repeats differ by 1 % (9DTact), digital
#: twins by up to 1.5 %, very noisy ones by 5 %; a stop of exposure is 100 %.
_WARN_LEVEL_REL, _REFUSE_LEVEL_REL = 0.05, 0.15
_TIMES_REPEAT = 4.0
#: Channel orders: noise floor of the rule between two captures (9DTact shows an exchange with 1.3 %), and between a
#: render and a capture, where model errors of 30 % are common.
_CAPTURES_DIFFER_REL, _RENDER_DIFFERS_REL = 0.01, 0.1
#: Exponent between render and capture: sRGB gives 0.45; valid pairs gave 0.97 to 1.03 (rendered with light transport),
#: 0.97 to 1.17 (without).
_REFUSE_EXPONENT, _WARN_EXPONENT = 0.67, 0.8


@dataclass(frozen=True, slots=True)
class Finding:
    """One mismatch, with its evidence in numbers and what to do."""

    severity: Severity
    about: Subject
    text: str


def find_mismatches(press: SimulatedPress, capture: TactileCapture) -> tuple[Finding, ...]:
    """Look for mismatches between a render, a capture and the capture's own no-contact image.

    * channel order: an exchange of channels fits clearly better than the order as stored (see `channel_order`);
    * exposure or gain: far from the contact, contact and no contact differ by more than the render and the repeat
      explain;
    * encoding: the capture grows with a power of the render's level, or has an offset (see `tone_curve`);
    * bit depth and black level: see `raw_levels`.

    Parameters
    ----------
    press, capture
        Of one size in pixels (cells of a Bayer capture).

    Returns
    -------
    tuple of Finding
        Those to refuse first.

    Raises
    ------
    CompareError
        The sizes differ.
    """
    contact, no_contact = rgb_image(capture.contact, capture), rgb_image(capture.no_contact, capture)
    if press.contact.shape != contact.shape:
        raise CompareError(
            f"{press.name} has {press.contact.shape[1]} x {press.contact.shape[0]} px, {capture.name} has "
            f"{contact.shape[1]} x {contact.shape[0]} px: simulate with the camera of the capture"
        )
    repeat = None if capture.repeat_no_contact is None else rgb_image(capture.repeat_no_contact, capture)
    scene = _scene(press, contact, no_contact, repeat)
    findings = [Finding("refuse" if sure else "warn", "levels", text) for sure, text in level_findings(capture)]
    if scene is not None and press.encoding == capture.encoding:
        findings += [*_order_findings(scene, capture.name), *_exposure_findings(scene, capture)]
        if capture.encoding == "linear":
            findings += _encoding_findings(scene, capture)
    return tuple(sorted(findings, key=lambda f: f.severity != "refuse"))


def require_no_mismatch(findings: Sequence[Finding]) -> None:
    """Raise with all findings that must be refused; do nothing when there are only warnings.

    Raises
    ------
    CompareError
        At least one finding must be refused.
    """
    refused = [f.text for f in findings if f.severity == "refuse"]
    if refused:
        raise CompareError("the images do not belong together: " + "; ".join(refused))


@dataclass(frozen=True, slots=True)
class _Scene:
    """Block means, shape (blocks, 3), over the blocks that every image sees; `off` marks those far from the contact."""

    simulated: Floats
    simulated_no_contact: Floats
    contact: Floats
    no_contact: Floats
    repeat: Floats | None
    off: Mask

    @property
    def has_surround(self) -> bool:
        """Whether enough of the picture is far from the contact."""
        return int(self.off.sum()) >= _LEAST_BLOCKS


def _scene(press: SimulatedPress, contact: Floats, no_contact: Floats, repeat: Floats | None) -> _Scene | None:
    """Return block means; None where too few blocks have light in every image."""
    side = max(1, min(_BLOCK_PX, min(contact.shape[:2]) // 15))
    images = [press.contact.astype(np.float64), press.no_contact.astype(np.float64), contact, no_contact]
    images += [] if repeat is None else [repeat]
    distance = block_mean(press.distance.astype(np.float64), side)
    blocks = [block_mean(image, side) for image in images]
    used = np.isfinite(distance)
    for image in blocks:
        used &= np.isfinite(image).all(axis=2) & (np.nan_to_num(image) > 0).all(axis=2)
    if int(used.sum()) < _LEAST_BLOCKS:
        return None
    values = [image[used] for image in blocks]
    return _Scene(
        simulated=values[0],
        simulated_no_contact=values[1],
        contact=values[2],
        no_contact=values[3],
        repeat=None if repeat is None else values[4],
        off=distance[used] > _OFF_CONTACT,
    )


def _order_findings(scene: _Scene, name: str) -> list[Finding]:
    """Compare channel orders of contact with no contact, and of no contact with the render."""
    findings = []
    if scene.has_surround:
        off = scene.off
        drift = 0.0 if scene.repeat is None else _spread(scene.repeat[off], scene.no_contact[off])
        better = better_order(scene.no_contact[off], scene.contact[off], max(_CAPTURES_DIFFER_REL, 2 * drift))
        if better is not None:
            findings.append(
                Finding(
                    "refuse" if better.clear else "warn",
                    "channel order",
                    f"the contact image of {name} fits its own no-contact image as {better}: store both in one order",
                )
            )
    better = better_order(scene.simulated_no_contact, scene.no_contact, _RENDER_DIFFERS_REL)
    if better is not None:
        findings.append(
            Finding(
                "refuse" if better.clear else "warn",
                "channel order",
                f"the no-contact image of {name} fits the render as {better}: check the channel order of the capture "
                "(OpenCV's is BGR), its Bayer pattern, and that no two paints are exchanged",
            )
        )
    return findings


def _spread(first: Floats, second: Floats) -> float:
    """Return the standard deviation of the log ratio over pixels and channels."""
    return float(np.log(first / second).std())


def _exposure_findings(scene: _Scene, capture: TactileCapture) -> list[Finding]:
    """Compare the level far from the contact with and without it."""
    if not scene.has_surround:
        return []
    off = scene.off
    real = scene.contact[off].sum(axis=0) / scene.no_contact[off].sum(axis=0)
    expected = scene.simulated[off].sum(axis=0) / scene.simulated_no_contact[off].sum(axis=0)
    factors = real / expected
    # the middle one: a single channel may be dark
    factor = float(np.median(factors))
    drift = 0.0
    if scene.repeat is not None:
        drift = float(np.median(np.abs(np.log(scene.repeat[off].sum(axis=0) / scene.no_contact[off].sum(axis=0)))))
    beyond, threshold = abs(np.log(factor)), _TIMES_REPEAT * drift
    if beyond <= max(_WARN_LEVEL_REL, threshold):
        return []
    channels = ", ".join(f"{f:.3f}" for f in factors)
    text = (
        f"far from the contact (beyond {_OFF_CONTACT:g} half-widths) the contact image of {capture.name} is "
        f"{factor:.3f} times as bright as its no-contact image, after what the render expects (red, green, blue: "
        f"{channels}); the repeat differs by {drift:.1%}: "
    )
    stops = float(np.log2(factor))
    if abs(stops - round(stops)) < 0.05 and abs(round(stops)) >= 2:
        text += f"that is 2 to the power {round(stops)}, as between images of different bit depth; "
    text += "capture both with the same exposure, gain, white balance and bit depth"
    sure = beyond > max(_REFUSE_LEVEL_REL, threshold)
    return [Finding("refuse" if sure else "warn", "exposure", text)]


def _encoding_findings(scene: _Scene, capture: TactileCapture) -> list[Finding]:
    """Compare the curve of the capture against the render's levels with a straight line through zero."""
    curve = tone_curve(scene.simulated_no_contact, scene.no_contact)
    if curve is None or _WARN_EXPONENT <= curve.exponent <= 1 / _WARN_EXPONENT:
        return []
    sure = not _REFUSE_EXPONENT <= curve.exponent <= 1 / _REFUSE_EXPONENT
    text = (
        f"the no-contact image of {capture.name} is recorded as linear, but its {curve.channel} channel grows with the "
        f"render's level to the power {curve.exponent:.2f} (1 for linear light, 0.45 for sRGB; correlation "
        f"{curve.correlation:.2f}): "
    )
    if curve.offset_fits_better:
        text += (
            f"a constant of {curve.offset_dn:.0f} DN on top of linear light explains it better: check black_level_dn "
            "and stray light"
        )
    else:
        text += "it went through a tone curve: capture raw frames, or record its encoding as unknown"
    return [Finding("refuse" if sure else "warn", "encoding", text)]
