"""Find images that do not belong together: channel order, exposure, encoding, bit depth and black level.

Such mistakes spoil more comparisons than optics does, and a fitted factor would hide them. Every finding carries its
numbers. What the images cannot tell gives no finding: a grey sensor does not show its channel order.
Levels without contact tell of camera and lights; the change by contact tells whether a render has colours at all.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import permutations
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from data_schemas import CompareError, SimulatedPress, TactileCapture
from finray_calib.compare._image_noise import block_mean, noise_free, noise_of_change
from finray_calib.compare._prepared_images import Nuisances, nuisances_of
from finray_calib.compare._regions import FACTORS, every_channel
from finray_calib.compare._tone_curve import FAR, REFUSED_GAIN_REL
from finray_calib.sensing import full_scale_dn, rgb_image
from finray_calib.spectra import compiled

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]
Severity = Literal["refuse", "warn"]
Subject = Literal["channel order", "exposure", "encoding", "levels", "change by contact"]
#: Means over blocks bring noise of render and sensor below what the rules look for.
_BLOCK_PX = 8
_LEAST_BLOCKS = 24
#: Of a render whose inputs are known, the level far from the contact may be off by so much before it is told.
_WARN_LEVEL_REL = 0.05
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

    * channel order: an exchange of channels fits clearly better than the order as stored (see `better_order`);
    * exposure, gain or white balance: far from the contact a channel of contact and no contact differs by more than the
      render and the repeat explain;
    * encoding: the capture grows with a power of the render's level, or has an offset (see `tone_curve`);
    * bit depth and black level: see `level_findings`;
    * change by contact: a render that is grey, or a channel of it that never changes, beside a capture in colour;
      channels that change as other ones of the capture; a render without contact that is not from the same camera;
    * clipped pixels: more than 1 % of the contact patch, or of the patch dilated, is clipped or nearly so.

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
    return mismatches(press, capture)[0]


def mismatches(press: SimulatedPress, capture: TactileCapture) -> tuple[tuple[Finding, ...], Nuisances | None]:
    """Return what :func:`find_mismatches` does, with the curve and gains that it estimated."""
    contact, no_contact = rgb_image(capture.contact, capture), rgb_image(capture.no_contact, capture)
    if press.contact.shape != contact.shape:
        raise CompareError(
            f"{press.name} has {press.contact.shape[1]} x {press.contact.shape[0]} px, but {capture.name} has "
            f"{contact.shape[1]} x {contact.shape[0]} px; simulate with the camera of the capture"
        )
    repeat = None if capture.repeat_no_contact is None else rgb_image(capture.repeat_no_contact, capture)
    findings = [Finding("refuse" if sure else "warn", "levels", text) for sure, text in level_findings(capture)]
    findings += _clipped_findings(press, capture, (contact, no_contact))
    nuisances = None
    if press.encoding == capture.encoding or press.encoding == "linear":
        nuisances = nuisances_of(press, capture, (contact, no_contact))
        findings += _gain_findings(nuisances, repeat, capture)
        shown = press if nuisances.tone is None else _through_the_curve(press, nuisances)
        scene = _scene(shown, contact, no_contact, repeat)
        if scene is not None:
            findings += _order_findings(scene, capture.name)
            if not any(f.severity == "refuse" and f.about == "channel order" for f in findings):
                findings += _change_findings(scene, f"the render {press.name}", f"the capture {capture.name}")
            findings += _pose_findings(scene, f"the render {press.name}")
        if scene is not None and capture.encoding == press.encoding == "linear":
            findings += _encoding_findings(scene, capture)
    return tuple(sorted(findings, key=lambda f: f.severity != "refuse")), nuisances


def _through_the_curve(press: SimulatedPress, nuisances: Nuisances) -> SimulatedPress:
    """Return a press in linear light by the fitted exponent, at the level of the capture: its white balance is free."""
    tone = nuisances.tone
    if tone is None:
        return press
    pad = np.isfinite(press.distance)[..., None]
    images = [np.maximum(image, 0.0).astype(np.float64) ** tone.exponent for image in (press.contact, press.no_contact)]
    # a black channel stays black, as a level of 0
    mean = images[1].mean(axis=(0, 1), where=pad)
    level = np.divide(tone.level_dn.mean(axis=0) - tone.offset_dn, mean, out=np.zeros(3), where=mean > 0.0)
    contact, no_contact = ((image * level + tone.offset_dn).astype(np.float32) for image in images)
    return press.model_copy(update={"contact": contact, "no_contact": no_contact})


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
    """Block means, shape (blocks, 3), over the blocks that every image sees.

    `off` marks those far from the contact, `near` those of the patch dilated.
    """

    simulated: Floats
    simulated_no_contact: Floats
    contact: Floats
    no_contact: Floats
    repeat: Floats | None
    off: Mask
    near: Mask

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
        used &= every_channel(np.isfinite(image) & (image > 0))
    if int(used.sum()) < _LEAST_BLOCKS:
        return None
    values = [image[used] for image in blocks]
    return _Scene(
        simulated=values[0],
        simulated_no_contact=values[1],
        contact=values[2],
        no_contact=values[3],
        repeat=None if repeat is None else values[4],
        off=distance[used] > FAR,
        near=distance[used] <= max(FACTORS.values()),
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
                    f"the contact image of {name} matches its own no-contact image when read as {better}: store both "
                    "images with their channels and rows in the same order",
                )
            )
    better = better_order(scene.simulated_no_contact, scene.no_contact, _RENDER_DIFFERS_REL)
    if better is not None:
        findings.append(
            Finding(
                "refuse" if better.clear else "warn",
                "channel order",
                f"the no-contact image of {name} fits the render when read as {better}: check the channel order of "
                "the capture (OpenCV's is BGR), its Bayer pattern, and that no two paints are exchanged",
            )
        )
    return findings


def _spread(first: Floats, second: Floats) -> float:
    """Return the standard deviation of the log ratio over pixels and channels."""
    return float(np.log(first / second).std())


_CHANNELS = ("red", "green", "blue")
#: Of the size of the change by contact: what is smaller than the first share is noise or rounding of a render, what is
#: larger than the second is colour: 86 real presses under coloured lights, and tables of them, had 0.67 and more.
_NO_COLOUR, _COLOUR = 0.05, 0.25
#: A capture that changes by less has no contact to tell from. Where nothing shows its noise it is taken for 2 %: of
#: means over 8 x 8 px at 20 DN a noise of 2 to 3 DN gives so much.
_LEAST_CHANGE_REL, _UNKNOWN_NOISE = 0.01, 0.02**2 * np.eye(3)
#: Correlations of the change by contact with another order of channels, and share of it that the stored one may reach.
_ORDER_SURE, _ORDER_LIKELY = (0.8, 0.5), (0.7, 0.7)


def _change_findings(scene: _Scene, rendered_name: str, captured_name: str) -> list[Finding]:
    """Compare the colours of the change by contact, ln(contact / no contact), whatever the levels without contact are.

    The ratio form and a free exposure take the levels out, so that a render of one channel only, or of depth or
    transparency in the place of a colour, would be scored as if it had been meant so.
    """
    if int(scene.near.sum()) < _LEAST_BLOCKS:
        return []
    rendered, captured = (change[scene.near] for change in _changes(scene))
    noise = _noise(scene)
    of_render, of_capture = np.zeros((3, 3)), _UNKNOWN_NOISE if noise is None else noise
    seen = [noise_free(rendered, of_render), noise_free(captured, of_capture)]
    sizes, colours = [size for size, _ in seen], [colour for _, colour in seen]
    if not sizes[0].max() > 0.0 or sizes[1].max() < _LEAST_CHANGE_REL:
        return []
    if colours[0] < _NO_COLOUR and colours[1] > _COLOUR:
        text = (
            f"{rendered_name} is grey where it is pressed (its channels change alike up to {100 * colours[0]:.1f} % of "
            f"the change), and {captured_name} has colours there ({100 * colours[1]:.0f} %): render in "
            "colour, with the lights of the sensor; a map of depth is no picture"
        )
        return [Finding("warn" if noise is None else "refuse", "change by contact", text)]
    idle = (sizes[0] < _NO_COLOUR * sizes[0].max()) & (sizes[1] > _COLOUR * sizes[1].max())
    findings = [
        Finding(
            "warn",
            "change by contact",
            f"{_CHANNELS[c]} of {rendered_name} hardly changes where it is pressed (by {100 * sizes[0][c]:.2g} %, "
            f"others by up to {100 * sizes[0].max():.2g} %), that of {captured_name} does (by "
            f"{100 * sizes[1][c]:.2g} %): check whether it is transparency or depth in the place of a colour, and "
            "whether a light of the sensor is missing",
        )
        for c in np.flatnonzero(idle)
    ]
    return findings + _order_of_change(rendered, captured, rendered_name, captured_name)


def _changes(scene: _Scene) -> list[Floats]:
    """Return ln(contact / no contact) of render and capture, less what all blocks far from the contact share."""
    changes = [np.log(scene.simulated / scene.simulated_no_contact), np.log(scene.contact / scene.no_contact)]
    return [c - np.median(c[scene.off], axis=0) for c in changes] if scene.has_surround else changes


def _noise(scene: _Scene) -> Floats | None:
    """Return the covariance (3, 3) that noise adds to the captured change, by far blocks or else by the repeat."""
    if scene.has_surround:
        return noise_of_change(scene.no_contact, scene.contact, scene.contact, (scene.off, scene.near))
    if scene.repeat is None:
        return None
    return noise_of_change(scene.no_contact, scene.repeat, scene.contact, (np.ones_like(scene.near), scene.near))


def _order_of_change(rendered: Floats, captured: Floats, rendered_name: str, captured_name: str) -> list[Finding]:
    """Tell an order of channels in which a capture changes as the render does, where it does not as stored."""
    size = float(np.sqrt((rendered**2).sum() * (captured**2).sum()))
    alike = {order: float((rendered * captured[:, order]).sum()) / size for order in permutations(range(3))}
    best, stored = max(alike, key=alike.__getitem__), alike[0, 1, 2]
    told = [alike[best] > least and stored < share * alike[best] for least, share in (_ORDER_SURE, _ORDER_LIKELY)]
    if not any(told):
        return []
    text = (
        f"where it is pressed, {captured_name} changes as {rendered_name} does when its channels are read as "
        f"{''.join('RGB'[c] for c in best)} (correlation {alike[best]:.2f}; as RGB {stored:.2f}): check the channel "
        "order of both (OpenCV's is BGR), and which light of the render has which colour"
    )
    return [Finding("refuse" if told[0] else "warn", "channel order", text)]


#: Far from the contact a render changes from block to block by its noise and by what the gel does there: by so much,
#: and so many times as much as the capture, only if its two images show different things.
_POSE_SPREAD_REL, _POSE_TIMES = 0.03, 3.0


def _pose_findings(scene: _Scene, name: str) -> list[Finding]:
    """Tell a render whose images with and without contact differ far from the contact, where the capture's do not."""
    if not scene.has_surround:
        return []
    spreads = [float(change[scene.off].std(axis=0).max()) for change in _changes(scene)]
    if spreads[0] <= max(_POSE_SPREAD_REL, _POSE_TIMES * spreads[1]):
        return []
    text = (
        f"far from the contact (beyond {FAR:g} half-widths) the two images of {name} differ unevenly, by "
        f"{100 * spreads[0]:.1f} % from place to place, those of the capture by {100 * spreads[1]:.1f} %: render both "
        "with one pose of the camera, the same lights and textures, and enough samples"
    )
    return [Finding("warn", "change by contact", text)]


def _gain_findings(nuisances: Nuisances, repeat: Floats | None, capture: TactileCapture) -> list[Finding]:
    """Tell the channels whose level far from the contact differs with and without it, and what is done about it."""
    gain = nuisances.gain
    if gain is None:
        return []
    drift = _repeat_drift(nuisances, repeat)
    size = np.abs(gain.log_gain)
    told = gain.seen & (size > _TIMES_REPEAT * drift)
    told &= True if nuisances.render.inputs is None else size > np.log1p(_WARN_LEVEL_REL)
    if not told.any():
        return []
    channel = int(np.argmax(np.where(told, size, 0.0)))
    captured, simulated, factor = np.exp([gain.log_captured, gain.log_simulated, gain.log_gain])[:, channel]
    listed = ", ".join(f"{g:.3f} +- {u:.3f}" for g, u in zip(np.exp(gain.log_gain), gain.u, strict=True))
    text = (
        f"far from the contact (beyond {FAR:g} half-widths) the contact image of {capture.name} is {captured:.3f} "
        f"times as bright as its no-contact image in {_CHANNELS[channel]}, but that of the render is "
        f"{simulated:.3f} times as bright (quotient in red, green, blue: {listed}): "
    )
    stops = float(np.log2(factor))
    if abs(stops - round(stops)) < 0.05 and abs(round(stops)) >= 2:
        text += f"that is 2 to the power {round(stops)}, as between images of different bit depth; "
    if nuisances.is_corrected:
        text += "each side was divided by its own gain; "
    elif not gain.is_refused:
        text += "it was not taken out, because it may be an error of the render; "
    elif (gain.uneven > size)[channel] and size[channel] <= np.log1p(REFUSED_GAIN_REL):
        text += f"across the picture it changes by {100 * gain.uneven[channel]:.1f} %, so it is not a gain; "
    changed = "render" if abs(np.log(simulated)) > abs(np.log(captured)) else "capture"
    text += f"{changed} both images with the same exposure, gain, white balance and bit depth"
    return [Finding("refuse" if gain.is_refused else "warn", "exposure", text)]


def _repeat_drift(nuisances: Nuisances, repeat: Floats | None) -> Floats:
    """Return how far the repeat of the no-contact image differs in the level of each channel, as a logarithm."""
    if repeat is None:
        return np.zeros(3)
    both = every_channel(np.isfinite(repeat + nuisances.no_contact))
    sums = [np.maximum(image[both].sum(axis=0), 1e-9) for image in (repeat, nuisances.no_contact)]
    return np.asarray(np.abs(np.log(sums[0] / sums[1])))


#: From this share of a region on its clipped pixels are told; nearly clipped is 98 % of full scale.
_TOLD_CLIPPED, _NEARLY = 0.01, 0.98


def _clipped_findings(press: SimulatedPress, capture: TactileCapture, images: tuple[Floats, Floats]) -> list[Finding]:
    """Tell how much of the contact is clipped or nearly so, channel by channel."""
    near_dn = _NEARLY * full_scale_dn(capture)
    bright = np.logical_or.reduce([~(image < near_dn) for image in images])
    findings = []
    for name, factor in FACTORS.items():
        where = press.distance <= factor
        if not where.any() or bright[where].any(axis=1).mean() <= _TOLD_CLIPPED:
            continue
        shares = ", ".join(
            f"{channel} {100 * share:.1f} %"
            for channel, share in zip(_CHANNELS, bright[where].mean(axis=0), strict=True)
        )
        findings.append(
            Finding(
                "warn",
                "levels",
                f"{100 * bright[where].any(axis=1).mean():.0f} % of the {name} lies at {100 * _NEARLY:.0f} % of full "
                f"scale or more, "
                f"with or without contact ({shares}): clipped pixels are left out of every score, and those near "
                f"full scale are compressed; capture with a shorter exposure",
            )
        )
    return findings


#: From this share of a region on, pixels at which a render is black are told.
_DARK_SHARE = 0.01


def dark_findings(press: SimulatedPress, capture: TactileCapture) -> list[Finding]:
    """Tell channels in which a render that is compared in ratio form is black where the capture has light.

    The change by contact is there a ratio of two zeros, and the image without contact stands in its place: the channel
    then scores as much as doing nothing, 0, and lowers the score of all channels together.
    """
    rest = rgb_image(capture.no_contact, capture)
    if press.no_contact.shape != rest.shape:
        return []  # refused with both sizes where images are compared
    name, factor = list(FACTORS.items())[-1]
    where = press.distance <= factor
    lit = (rest[where] > 0.0) | ~np.isfinite(rest[where])  # clipped is lit
    if not where.any() or not lit.any():
        return []
    dark = (np.asarray(press.no_contact[where]) <= 0.0) & lit
    shares = {channel: float(share) for channel, share in zip(_CHANNELS, dark.mean(axis=0), strict=True)}
    told = [f"{channel} {100 * share:.0f} %" for channel, share in shares.items() if share >= _DARK_SHARE]
    if not told:
        return []
    text = (
        f"{press.name} has no light where the capture has some ({', '.join(told)} of the {name}): these pixels are "
        "scored as an unchanged image, because a change relative to no light is not defined. Check the lights, the "
        "paint and the camera's response of the design in these channels, or render with more samples"
    )
    return [Finding("warn", "levels", text)]


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


#: An exchange must at least halve the disagreement to be sure, and take a quarter off it to be mentioned.
_SURE, _LIKELY = 0.5, 0.75


@dataclass(frozen=True, slots=True)
class BetterOrder:
    """An order of channels that fits better than the stored one.

    Attributes
    ----------
    order : str
        Channels of the second image as they should be read, such as "BGR".
    differs_rel, differs_as_stored_rel : float
        Standard deviation of the logarithm of the ratio of both images with this order and as stored.
    correlation, correlation_as_stored : float
        Mean over channels of the correlation of the logarithms over the picture: the pattern, whatever the levels.
    """

    order: str
    differs_rel: float
    differs_as_stored_rel: float
    correlation: float
    correlation_as_stored: float

    @property
    def clear(self) -> bool:
        """Whether levels and patterns both speak for it."""
        return self.differs_rel < _SURE * self.differs_as_stored_rel and self.correlation > self.correlation_as_stored

    def __str__(self) -> str:
        """Say it with its numbers."""
        return (
            f"{self.order} much better than as RGB (difference after one gain {100 * self.differs_rel:.1f} % instead "
            f"of {100 * self.differs_as_stored_rel:.1f} %, correlation of the patterns {self.correlation:.2f} instead "
            f"of {self.correlation_as_stored:.2f})"
        )


def better_order(first: Floats, second: Floats, floor_rel: float) -> BetterOrder | None:
    """Return the order of the second image's channels that fits the first clearly better than the stored one.

    The disagreement is the standard deviation of log(second / first) over pixels and channels: one gain for all
    channels is free. Valid for channels that differ in level or in pattern; of a grey scene no order is better.

    Parameters
    ----------
    first, second : ndarray, shape (P, 3)
        Positive values of the same places.
    floor_rel : float
        Disagreement that is expected of a right order; below it nothing is said.

    Returns
    -------
    BetterOrder or None
    """
    reference, values = np.log(first), np.log(second)
    spreads = {order: float((values[:, order] - reference).std()) for order in permutations(range(3))}
    stored = (0, 1, 2)
    best = min(spreads, key=spreads.__getitem__)
    if spreads[stored] <= floor_rel or spreads[best] >= _LIKELY * spreads[stored]:
        return None
    return BetterOrder(
        "".join("RGB"[c] for c in best),
        spreads[best],
        spreads[stored],
        _correlation(reference, values[:, best]),
        _correlation(reference, values),
    )


def _correlation(first: Floats, second: Floats) -> float:
    """Return the mean over channels of the correlation over pixels; a channel without any pattern counts 0."""
    a, b = first - first.mean(axis=0), second - second.mean(axis=0)
    norm = np.sqrt((a * a).sum(axis=0) * (b * b).sum(axis=0))
    return float(np.divide((a * b).sum(axis=0), norm, out=np.zeros(3), where=norm > 0).mean())


#: Below this correlation the two images do not show the same light, and no curve between their levels means anything.
LEAST_CORRELATION = 0.9
#: Standard deviation of the logarithm of the render's levels that a curve needs: a flat field has none.
LEAST_CONTRAST = 0.15


@dataclass(frozen=True, slots=True)
class ToneCurve:
    """Fit of a capture's levels to a render's, in the channel where they agree best.

    Attributes
    ----------
    channel : str
    exponent : float
        p of capture = a render^p; 1 for linear light.
    correlation : float
        Of the logarithms of the levels.
    offset_dn : float
        b of capture = k render + b.
    offset_fits_better : bool
        Whether the straight line with offset leaves less than the power.
    """

    channel: str
    exponent: float
    correlation: float
    offset_dn: float
    offset_fits_better: bool


def tone_curve(rendered: Floats, captured: Floats) -> ToneCurve | None:
    """Fit the exponent between the levels of a render and of a capture.

    p = sd(log D) / sd(log S): both have errors, so that neither may stand as the exact one. Channels are fitted apart
    (a gain for each), and the one with the highest correlation speaks.

    Parameters
    ----------
    rendered, captured : ndarray, shape (P, 3)
        Positive levels of the same places.

    Returns
    -------
    ToneCurve or None
        None where the images have too little contrast or too little in common.
    """
    logs = np.log(rendered), np.log(captured)
    contrasts = [values.std(axis=0) for values in logs]
    enough = (contrasts[0] >= LEAST_CONTRAST) & (contrasts[1] >= LEAST_CONTRAST / 10)
    correlations = [float(np.corrcoef(logs[0][:, c], logs[1][:, c])[0, 1]) if enough[c] else 0.0 for c in range(3)]
    channel = int(np.argmax(correlations))
    if correlations[channel] < LEAST_CORRELATION:
        return None
    level, real = rendered[:, channel], captured[:, channel]
    exponent = float(contrasts[1][channel] / contrasts[0][channel])
    power = level**exponent
    power *= (real * power).sum() / (power * power).sum()
    gain, offset = np.polyfit(level, real, 1)
    line_error, power_error = (float(((fit - real) ** 2).sum()) for fit in (gain * level + offset, power))
    return ToneCurve(
        ("red", "green", "blue")[channel], exponent, correlations[channel], float(offset), line_error < power_error
    )


Counts = NDArray[np.uint16]
#: Pixels that must stand at one highest level, and how many times the level below it, to be a clipped image.
_LEAST_PILE, _PILE_TIMES = 50, 5
#: A pile at a level that is close to the typical one is a flat image, not a clipped one.
_PILE_ABOVE_MEDIAN = 1.2
_DARKEST = 0.01
_TIMES_NOISE = 5.0


def level_findings(capture: TactileCapture) -> list[tuple[bool, str]]:
    """Return (whether to refuse, text) for counts that contradict the recorded bit depth or black level.

    * counts above full scale 2^bits - 1;
    * many pixels at one highest level below full scale: data of a smaller depth, or clipped by a program, so that
      clipped pixels would pass for light;
    * all counts multiples of a number: a smaller depth shifted up;
    * the darkest per cent of the no-contact image below the black level by more than five times its noise (known from
      the repeat).
    """
    images = {"contact": capture.contact, "no-contact": capture.no_contact}
    if capture.repeat_no_contact is not None:
        images["repeated no-contact"] = capture.repeat_no_contact
    full_scale_dn = 2**capture.bit_depth - 1
    findings = []
    for name, counts in images.items():
        findings += _depth_findings(f"the {name} image of {capture.name}", counts, full_scale_dn, capture.bit_depth)
    return findings + _black_findings(capture)


def _depth_findings(name: str, counts: Counts, full_scale_dn: int, bits: int) -> list[tuple[bool, str]]:
    """Compare the highest and the common levels with the recorded depth."""
    highest = int(counts.max())
    if highest > full_scale_dn:
        return [(True, f"{name} holds {highest} DN, above the full scale of {bits} bit ({full_scale_dn} DN): {_MEND}")]
    pixels = np.zeros(highest + 1, dtype=np.int64)
    count_levels(counts.ravel(), pixels)
    levels = np.flatnonzero(pixels)
    pixels = pixels[levels]
    findings = []
    step = int(np.gcd.reduce(levels))
    if step > 1 and len(levels) > 2:
        findings.append(
            (
                False,
                f"{name} holds multiples of {step} DN only, as data of fewer than {bits} bit that were shifted up: "
                f"pixels clipped at {full_scale_dn // step * step} DN are not recognised; {_MEND}",
            )
        )
    piled = len(levels) > 2 and pixels[-1] >= max(_LEAST_PILE, _PILE_TIMES * pixels[-2])
    if highest < full_scale_dn and piled and highest > _PILE_ABOVE_MEDIAN * np.median(counts):
        smaller = (
            f", which suggests data of {(highest + 1).bit_length() - 1} bit" if (highest & (highest + 1)) == 0 else ""
        )
        findings.append(
            (
                True,
                f"{pixels[-1]} values of {name} are exactly {highest} DN{smaller}, none is above, and full scale is "
                f"recorded as {full_scale_dn} DN ({bits} bit): they are clipped and would count as light; {_MEND}",
            )
        )
    return findings


@compiled
def count_levels(counts: Counts, pixels: NDArray[np.int64]) -> None:
    """Add to the number of pixels of each level; numpy makes 64-bit integers of all counts first."""
    for i in range(counts.size):
        pixels[counts[i]] += 1


_MEND = "record the bit depth of the camera's own counts"


def _black_findings(capture: TactileCapture) -> list[tuple[bool, str]]:
    """Compare the darkest pixels with the recorded black level."""
    if capture.repeat_no_contact is None:
        return []
    first, second = (image.astype(np.float64) for image in (capture.no_contact, capture.repeat_no_contact))
    dark = first + second <= np.quantile(first + second, _DARKEST)
    level_dn = float((first[dark] + second[dark]).mean() / 2)
    noise_dn = float((first[dark] - second[dark]).std()) / np.sqrt(2)
    below_dn = capture.black_level_dn - level_dn
    if below_dn <= _TIMES_NOISE * noise_dn + 1.0:
        return []
    return [
        (
            True,
            f"the darkest per cent of the no-contact image of {capture.name} lies at {level_dn:.1f} DN (noise "
            f"{noise_dn:.1f} DN), below the recorded black level of {capture.black_level_dn:g} DN: light cannot be "
            "negative; record the black level of a dark frame with the same settings",
        )
    ]
