"""Fit a sensor's numbers to a few captures of it: which of them its pictures determine, and how well.

Each layer of the picture is rendered once; how it changes with a number of the design comes from renders at a standard
deviation to either side, with the same random numbers, as a parabola. Shift, scale and blur are done to the rendered
picture itself.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from data_schemas import (
    CHANNELS,
    Determined,
    FingerDesign,
    FittedNumber,
    LayerBrightness,
    PlainSensor,
    SensorFit,
    SimulateError,
    TactileCapture,
)
from finray_calib.compare import capture_noise
from finray_calib.fit import (
    PictureBlocks,
    PicturePosterior,
    estimate,
    picture_blocks,
    placed_picture,
    sample_picture_posterior,
)
from finray_calib.sensing import rgb_image
from sim.experiments import FreeParameter, Layers, SensorScene, value_at, with_changed_values
from sim.optics import Progress

Floats = NDArray[np.float64]
Design = FingerDesign | PlainSensor

EXAMPLES: Final = ("pad.thickness_mm", "coating.roughness_alpha")
"""Numbers of the design that may be fitted."""

#: Standard uncertainty of a number of the design where its [uncertainty_rel] states none, by its [origin].
USUAL_U_REL: Final = {"measured": 0.02, "data sheet": 0.05, "paper": 0.05, "assumed": 0.1}
# of the width of the picture, of its scale, and of the logarithm of the blur about its usual size
_SHIFT_SHARE, _SCALE_U_REL, _BLUR_PX, _BLUR_U = 0.01, 0.01, 0.7, 0.5
# the gain is unknown: e^2 to either side of what makes the pictures alike
_GAIN_U = 2.0

CORRELATION_LENGTH: Final = 0.3
"""Of the smooth error, over the longer side of the pad's picture."""
_FAR_SD = 3.0
LARGEST_EMULATOR_REL: Final = 0.02
"""Where renders differ by more from the parabolas through others, new ones are made about the numbers found."""
_SHORTEST_STEP: Final = 0.2  # of such renders, in standard deviations of the prior: shorter ones differ by noise only
_MOST_NOISE: Final = 0.1


def captured_pictures(captures: Sequence[TactileCapture]) -> tuple[Floats, Floats]:
    """Return pictures (1 + captures, 3, row, column) in DN and the variance of their pixels: no contact, each press.

    Pictures without contact are averaged, each once that several captures share. The camera's noise is told from the
    two images without contact of a capture, where it has a repeat; else from the change of the contact, which is then
    part of it.

    Raises
    ------
    SimulateError
        Captures are not linear, differ in size or exposure, or are given twice.
    """
    _require_alike(captures)
    rests, presses, noise = [], [], []
    for capture in captures:
        rest, press = rgb_image(capture.no_contact, capture), rgb_image(capture.contact, capture)
        other = press if capture.repeat_no_contact is None else rgb_image(capture.repeat_no_contact, capture)
        found = capture_noise(rest, other)
        rests.append(rest)
        presses.append(press)
        noise.append((found.variance(rest), found.variance(press)))
    once = list({np.asarray(capture.no_contact).tobytes(): k for k, capture in enumerate(captures)}.values())
    images = [np.mean([rests[k] for k in once], axis=0), *presses]
    variances = [np.mean([noise[k][0] for k in once], axis=0) / len(once), *(n[1] for n in noise)]
    return (np.moveaxis(np.array(images), -1, 1), np.moveaxis(np.array(variances), -1, 1))


def _require_alike(captures: Sequence[TactileCapture]) -> None:
    """Refuse captures that are not of one sensor as it stands."""
    first = captures[0]
    if len({capture.name for capture in captures}) < len(captures):
        raise SimulateError("--captures: a capture is given twice; give each capture only once")
    pictures = [np.asarray(capture.contact).tobytes() for capture in captures]
    for number, picture in enumerate(pictures):
        if picture in pictures[:number]:
            raise SimulateError(
                f"--captures: {captures[number].name} contains the same picture as "
                f"{captures[pictures.index(picture)].name}, which would count twice; give each capture only once"
            )
    for capture in captures:
        if capture.encoding != "linear":
            raise SimulateError(
                f"{capture.name}: encoding = {capture.encoding!r} is not supported, because powers and yields can be "
                "fitted only to linear values; capture raw counts, or import the pictures with their tone curve taken "
                "out"
            )
        for name in ("layout", "bit_depth", "black_level_dn", "exposure_s"):
            if getattr(capture, name) != getattr(first, name):
                raise SimulateError(
                    f"{capture.name}: {name} = {getattr(capture, name)} differs from {getattr(first, name)} of "
                    f"{first.name}, but one gain holds for all captures; give captures of one setting"
                )
        if capture.contact.shape != first.contact.shape:
            raise SimulateError(f"{capture.name} and {first.name} differ in size; give captures of one camera")


@dataclass(frozen=True, slots=True)
class PictureModel:
    """Predicts the block means of all pictures from standardised numbers.

    ``mix`` (channel, layer) is what each channel sees of each layer by the design, ``exponents`` (number, channel,
    layer) with what power of a number it grows. ``base`` are the layers of the design (:class:`Layers`); ``slopes`` and
    ``bends`` hold, by place of a number, how they change to first and second order about ``centre``. ``seen`` are the
    channels that are fitted, 0 to 2 for red, green and blue: those of ``mix``, ``exponents`` and ``captured``.
    """

    numbers: tuple[FreeParameter, ...]
    captured: PictureBlocks
    base: Floats
    mix: Floats
    exponents: Floats
    centre: Floats
    slopes: Mapping[int, Floats]
    bends: Mapping[int, Floats]
    seen: tuple[int, ...] = (0, 1, 2)

    def layers(self, theta: Floats) -> Floats:
        """Return layers at these numbers, (2, picture, layer, row, column)."""
        pictures = self.base
        for k, slope in self.slopes.items():
            step = theta[k] - self.centre[k]
            pictures = pictures + step * slope + step**2 * self.bends[k]
        return pictures

    def growth(self, theta: Floats) -> Floats:
        """Return by how much each layer has grown in each channel, (..., channel, layer), of (..., number)."""
        logs = np.array([n.u if n.place == "layer" or n.name == GAIN else 0.0 for n in self.numbers])
        return np.asarray(np.exp(np.einsum("...k,kcl->...cl", theta * logs, self.exponents)))

    def channels(self, theta: Floats, layers: Floats) -> Floats:
        """Return block means (2, picture, channel, block) of layers."""
        of = {n.name: float(n.at(theta[k])) for k, n in enumerate(self.numbers) if n.place == "picture"}
        gain = next(n.value for n in self.numbers if n.name == GAIN)
        mixed = np.einsum("cl,...lij->...cij", gain * self.mix * self.growth(theta), layers)
        moves = tuple(of[f"picture.{name}"] for name in ("shift_rows_px", "shift_columns_px", "scale", "blur_px"))
        moved = np.array([placed_picture(one, *moves) for one in mixed.reshape(-1, *mixed.shape[3:])])
        means = self.captured.means(moved.reshape(-1, *mixed.shape[2:]))
        return means.reshape(*mixed.shape[:3], -1)

    def predict(self, theta: Floats) -> Floats:
        """Return block means and half differences in the order of the captured ones, (2, value)."""
        return self.channels(theta, self.layers(theta)).reshape(2, -1)


def fit_sensor(
    scene: SensorScene,
    captures: Sequence[TactileCapture],
    free: Sequence[str] = (),
    seed: int = 1,
    progress: Progress | None = None,
) -> SensorFit:
    """Return the posterior of a sensor's numbers from captures of it.

    Always fitted are the powers of several lights, the yields of both paints and the response of the camera (painted
    finger), one gain, and where the picture lies: shift, scale and blur. Depth and place of a press are fitted where
    its capture states their uncertainty. The gain is not known from the design, so that of powers and gain only the
    products are determined.

    Parameters
    ----------
    scene
        The sensor and how it is rendered.
    captures
        Presses of it, all of one exposure.
    free
        Numbers of the design by their dotted path, each positive, such as :data:`EXAMPLES`.
    seed
        Of the draws.
    progress
        Called after each set of renders.

    Raises
    ------
    SimulateError
        Captures do not go together or with the design, or a number cannot be free.
    """
    presses = [_as_captured(scene.design, capture) for capture in captures]
    fields = _design_numbers(scene.design, free)
    pictures, noise = captured_pictures(captures)
    moving = (*fields, *_press_numbers(captures, presses))
    steps = _Steps(progress, 2 + 2 * len(moving))
    base = scene.layers(presses)
    steps.done("the unchanged design")
    if base.pictures.shape[-2:] != pictures.shape[-2:]:
        raise SimulateError(
            f"the design renders {base.pictures.shape[4]} x {base.pictures.shape[3]} px, but {captures[0].name} has "
            f"{pictures.shape[3]} x {pictures.shape[2]} px (a Bayer picture counts one pixel per 2 x 2 cell); set "
            "camera.width_px and camera.height_px of the design to the size of the captures"
        )
    model, dark = _without_dark_channels(
        _model(scene, moving, picture_blocks(pictures, noise, base.on_pad), base), scene.design.name
    )
    renders = _Renders(scene, presses, model.numbers, steps)
    model = renders.about(model, np.zeros(len(model.numbers)), base.pictures, np.ones(len(model.numbers)))
    rng, emulator_rel = np.random.default_rng(seed), None
    posterior = _posterior(model, rng)
    for is_last in (False, True) if moving else ():
        at = posterior.mean
        truth = renders.at(at)
        error = truth - model.layers(at)
        emulator_rel = _rms_rel(model.channels(at, error)[0], model.captured.values)
        if is_last or emulator_rel <= LARGEST_EMULATOR_REL:
            posterior = _posterior(replace(model, base=model.base + error), rng, at)
            break
        model = renders.about(model, at, truth, np.clip(2.0 * posterior.theta.std(axis=0), _SHORTEST_STEP, 1.0))
        posterior = _posterior(model, rng, at)
    steps.done("the fitted numbers")
    return _record(scene, captures, model, posterior, emulator_rel, dark)


GAIN: Final = "picture.gain"


class _Steps:
    """Counts sets of renders."""

    def __init__(self, progress: Progress | None, total: int) -> None:
        self._progress, self._total, self._done = progress, total, 0

    def done(self, what: str) -> None:
        """Tell that one is done; where new renders were needed there are more than was thought."""
        self._done += 1
        self._total = max(self._total, self._done)
        if self._progress is not None:
            self._progress(self._done, self._total, f"rendered {what}")


#: How near the angle of the light in a capture must be to the design's.
_SAME_ANGLE_DEG: Final = 1.0


def _as_captured(design: Design, capture: TactileCapture) -> Design:
    """Return the design with the press of a capture."""
    lit_deg = capture.light_angle_deg
    if isinstance(design, FingerDesign) and lit_deg is not None:
        _require_same_light(design, capture.name, lit_deg)
    pose, values = capture.indenter, {}
    if pose.shape != design.indenter.shape:
        raise SimulateError(
            f"{capture.name} presses a {pose.shape}, but the design presses a {design.indenter.shape}; set "
            "indenter.shape and its size in the design"
        )
    for name in ("radius_mm", "depth_mm", "position_mm"):
        value = getattr(pose, name)
        if value is not None and not (name == "radius_mm" and pose.shape not in ("ball", "cylinder")):
            values[f"indenter.{name}"] = value
    return with_changed_values(design, values)


def _require_same_light(design: FingerDesign, name: str, lit_deg: float) -> None:
    """Refuse a capture under another angle of the light."""
    if abs(lit_deg - design.light.angle_deg) > _SAME_ANGLE_DEG:
        raise SimulateError(
            f"{name} is lit at {lit_deg:g} deg, but the design is lit at {design.light.angle_deg:g} deg; set "
            "light.angle_deg of the design to the angle of the captures"
        )


def _design_numbers(design: Design, free: Sequence[str]) -> tuple[FreeParameter, ...]:
    """Return the numbers of the design that are fitted."""
    idle = design.unused_fields()
    numbers = []
    for name in dict.fromkeys(free):
        value = value_at(design, name) if not name.startswith("_") else None
        if name in idle:
            raise SimulateError(f"--free {name}: has no effect here, {idle[name]}")
        if isinstance(value, bool) or not isinstance(value, float) or not value > 0.0:
            raise SimulateError(
                f"--free {name}: must be the dotted path of a positive number of the design, such as "
                f"{' or '.join(EXAMPLES)}; powers, yields, gain, shift, scale and blur are always fitted"
            )
        if name.endswith("power_rel"):
            raise SimulateError(f"--free {name}: powers are always fitted; leave out --free {name}")
        if name in ("indenter.depth_mm", "indenter.position_mm"):
            needed = f"{name.removesuffix('_mm')}_uncertainty_mm"
            raise SimulateError(
                f"--free {name}: is always fitted for captures that state {needed}; leave out --free {name}"
            )
        if name.startswith("indenter."):
            raise SimulateError(
                f"--free {name}: only depth_mm and position_mm of the indenter can be fitted, and they are fitted "
                f"where the capture states their uncertainty; leave out --free {name}"
            )
        # of entries of a list the design states one uncertainty and one origin, that of all
        field = ".".join(part for part in name.split(".") if not part.isdecimal())
        stated, origin = design.uncertainty_rel.get(field), design.origin.get(field, "assumed")
        u = stated if stated else USUAL_U_REL[origin]
        told = "design: uncertainty_rel" if stated else f"usual for the origin '{origin}': {100 * u:.0f} %"
        unit = next((unit for end, unit in _UNITS.items() if name.endswith(end)), "1")
        numbers.append(FreeParameter(name, value, u, True, told, "design", unit))
    return tuple(numbers)


_UNITS: Final = {"_mm": "mm", "_deg": "deg", "_nm": "nm", "_px": "px"}


def _press_numbers(captures: Sequence[TactileCapture], presses: Sequence[Design]) -> tuple[FreeParameter, ...]:
    """Return depth and place of each press whose uncertainty is stated."""
    numbers = []
    for k, (capture, press) in enumerate(zip(captures, presses, strict=True)):
        for name in ("depth", "position"):
            u = getattr(capture.indenter, f"{name}_uncertainty_mm")
            if u:
                value = float(getattr(press.indenter, f"{name}_mm"))
                numbers.append(
                    FreeParameter(f"press.{k}.{name}_mm", value, u, False, f"capture {capture.name}", "press", "mm", k)
                )
    return tuple(numbers)


def _model(
    scene: SensorScene, moving: tuple[FreeParameter, ...], captured: PictureBlocks, base: Layers
) -> PictureModel:
    """Return the model at the gain that makes the pictures alike."""
    width = base.pictures.shape[4]
    picture = (
        FreeParameter(GAIN, 1.0, _GAIN_U, True, "not known from the design", "picture", "DN"),
        FreeParameter("picture.shift_rows_px", 0.0, _SHIFT_SHARE * width, False, "assumed", "picture", "px"),
        FreeParameter("picture.shift_columns_px", 0.0, _SHIFT_SHARE * width, False, "assumed", "picture", "px"),
        FreeParameter("picture.scale", 1.0, _SCALE_U_REL, True, "assumed", "picture"),
        FreeParameter("picture.blur_px", _BLUR_PX, _BLUR_U, True, "assumed", "picture", "px"),
    )
    numbers = (*scene.layer_numbers, *moving, *picture)
    mix = scene.mix({})
    exponents = np.array([_exponents(scene, mix, number) for number in numbers])
    model = PictureModel(numbers, captured, base.pictures, mix, exponents, np.zeros(len(numbers)), {}, {})
    at = model.channels(np.zeros(len(numbers)), base.pictures)[0]
    gain = float((at * captured.values).sum() / max(float((at**2).sum()), np.finfo(float).tiny))
    if not gain > 0.0:
        raise SimulateError(
            "the captured pictures are dark where the design shows the pad; check the camera of the design"
        )
    return replace(model, numbers=tuple(replace(n, value=gain) if n.name == GAIN else n for n in numbers))


def _without_dark_channels(model: PictureModel, name: str) -> tuple[PictureModel, tuple[str, ...]]:
    """Return the model of the channels that hold light, and what to tell of the others.

    Raises
    ------
    SimulateError
        None does.
    """
    designed = model.channels(np.zeros(len(model.numbers)), model.base)[0].mean(axis=(0, 2)) > 0.0
    captured = model.captured.values.mean(axis=(0, 2)) >= _DARK_DN
    told = tuple(
        f"the {channel} channel is left out of the fit: "
        + (f"the captures hold no light in it (mean below {_DARK_DN:g} DN)" if lit else f"{name} has no light in it")
        + "; lights that only this channel sees are not determined"
        for channel, lit, seen in zip(CHANNELS, designed, captured, strict=True)
        if not (lit and seen)
    )
    kept = np.flatnonzero(designed & captured)
    if not len(kept):
        raise SimulateError(
            f"no channel has light both in the captures and in the design's pictures ({'; '.join(told)}); set "
            "lights.channel of the design to the channels in which the camera sees the lights, or check the exposure "
            "of the captures"
        )
    blocks = replace(model.captured, values=model.captured.values[:, kept], variance=model.captured.variance[:, kept])
    mix, exponents = model.mix[kept], model.exponents[:, kept]
    return replace(model, captured=blocks, mix=mix, exponents=exponents, seen=tuple(kept.tolist())), told


#: A channel of a lower mean holds no light: half of the smallest count.
_DARK_DN: Final = 0.5


def _exponents(scene: SensorScene, mix: Floats, number: FreeParameter) -> Floats:
    """Return with what power of a number each layer grows in each channel, (3, layer)."""
    if number.name == GAIN:
        return np.ones_like(mix)
    if number.place != "layer":
        return np.zeros_like(mix)
    grown = scene.mix({number.name: np.e})
    return np.log(np.divide(grown, mix, out=np.ones_like(mix), where=mix > 0.0))


def _moved(press: Design, number: int, numbers: Sequence[FreeParameter], theta: Floats) -> Design:
    """Return the design of one press with its free numbers at standardised places."""
    values = {}
    for one, at in zip(numbers, theta, strict=True):
        if one.place == "design":
            values[one.name] = float(one.at(at))
        elif one.place == "press" and one.press == number:
            values[f"indenter.{one.name.rsplit('.', 1)[1]}"] = float(one.at(at))
    return with_changed_values(press, values)


@dataclass(frozen=True, slots=True)
class _Renders:
    """Renders of the presses with the free numbers at standardised places."""

    scene: SensorScene
    presses: Sequence[Design]
    numbers: Sequence[FreeParameter]
    steps: _Steps

    def at(self, theta: Floats) -> Floats:
        """Return the layers of all pictures."""
        moved = [_moved(press, number, self.numbers, theta) for number, press in enumerate(self.presses)]
        return self.scene.layers(moved).pictures

    def about(self, model: PictureModel, centre: Floats, base: Floats, widths: Floats) -> PictureModel:
        """Return the model with parabolas through its layers at `centre`, a width above and a width below."""
        slopes, bends = {}, {}
        for k, one in enumerate(self.numbers):
            if one.place not in ("design", "press"):
                continue
            sides = []
            for sign in (1.0, -1.0):
                theta = centre.copy()
                theta[k] += sign * widths[k]
                sides.append(self.at(theta) if one.place == "design" else self._of_press(one.press, theta, base))
                self.steps.done(f"{one.name} {'above' if sign > 0 else 'below'}")
            slopes[k] = (sides[0] - sides[1]) / (2.0 * widths[k])
            bends[k] = ((sides[0] + sides[1]) / 2.0 - base) / widths[k] ** 2
        return replace(model, base=base, centre=centre, slopes=slopes, bends=bends)

    def _of_press(self, press: int, theta: Floats, base: Floats) -> Floats:
        """Return the layers of all pictures where one press alone has moved."""
        side = base.copy()
        moved = _moved(self.presses[press], press, self.numbers, theta)
        side[:, 1 + press] = self.scene.layers([moved]).pictures[:, 1]
        return side


def _posterior(model: PictureModel, rng: np.random.Generator, start: Floats | None = None) -> PicturePosterior:
    """Return the posterior of the standardised numbers."""
    of_logs = [0.02 / n.u if n.place == "layer" or n.name == GAIN else 0.25 for n in model.numbers]
    steps = np.minimum(of_logs, 0.25)
    return sample_picture_posterior(
        model.predict, model.captured, steps, rng, correlation_length=CORRELATION_LENGTH, start=start
    )


def _rms_rel(error: Floats, values: Floats) -> float:
    """Return the rms of an error over the mean of what it is of."""
    return float(np.sqrt(np.mean(error**2)) / np.mean(values))


#: Parts of the prior's width left: below the first a number is determined, above the second it is not.
_DETERMINED, _NOT_DETERMINED = 0.5, 0.9
# members of a combination that is not told apart, by their weight
_MEMBER = 0.3
_PRIOR_QUANTILES = 4001


_NOTES_OF_EVERY_FIT = (
    "gain and powers: the design does not state how many DN a unit of light makes, so only products of the gain with "
    "powers are determined, and ratios of powers; a known exposure does not change that",
    f"the smooth error has a correlation length of {CORRELATION_LENGTH:g} of the pad's picture, which is assumed",
    "in tests on rendered fingers of 80 x 60 px the 95 % intervals held the true value in 94 % of the cases, those "
    "of shifts and scale in 86 to 88 %",
)


def _record(
    scene: SensorScene,
    captures: Sequence[TactileCapture],
    model: PictureModel,
    posterior: PicturePosterior,
    emulator_rel: float | None,
    dark: tuple[str, ...],
) -> SensorFit:
    """Return the record of a fit."""
    design, theta = scene.design, posterior.theta
    draws = np.stack([n.at(theta[:, k]) for k, n in enumerate(model.numbers)], axis=-1)
    far = [n.name for k, n in enumerate(model.numbers) if n.name != GAIN and abs(theta[:, k].mean()) > _FAR_SD]
    notes = [*dark, *_NOTES_OF_EVERY_FIT]
    if not posterior.converged:
        notes.append("the search has not converged; give more --samples, or state smaller uncertainties")
    if far:
        notes.append(
            f"numbers far outside the prior (more than {_FAR_SD:g} standard deviations): {', '.join(far)}; check the "
            "design"
        )
    noisy = [n.name for n, share in zip(model.numbers, posterior.noise_share, strict=True) if share > _MOST_NOISE]
    if noisy:
        notes.append(f"the renders are too noisy to determine {', '.join(noisy)}; give more --samples")
    if not any(n.place == "press" for n in model.numbers):
        notes.append(
            "the captures state no uncertainty of depth or position, so the poses of the presses count as exactly known"
        )
    return SensorFit(
        name=design.name,
        label=scene.label,
        finger=design if isinstance(design, FingerDesign) else None,
        sensor=design if isinstance(design, PlainSensor) else None,
        captures=tuple(capture.name for capture in captures),
        numbers=tuple(_fitted(n, theta[:, k], n.name in noisy) for k, n in enumerate(model.numbers)),
        draws=draws,
        brightness=_brightness(scene, model, theta),
        not_told_apart=_combinations(model.numbers, theta),
        discrepancy_rel=estimate(posterior.discrepancy_rel),
        correlation_length_rel=CORRELATION_LENGTH,
        independent_rel=estimate(posterior.independent_rel),
        residual_rel=posterior.residual_rel,
        emulator_rel=emulator_rel,
        blocks=model.captured.values.shape[-1],
        trusted=posterior.converged and not far and not noisy,
        notes=tuple(notes),
    )


def _fitted(number: FreeParameter, theta: Floats, is_noisy: bool) -> FittedNumber:
    """Return a number before and after."""
    from scipy.stats import norm

    quantiles = norm.ppf((np.arange(_PRIOR_QUANTILES) + 0.5) / _PRIOR_QUANTILES)
    left = float(theta.std())
    verdict: Determined = "determined" if left <= _DETERMINED else "partly determined"
    if left > _NOT_DETERMINED:
        verdict = "not determined by these pictures"
    elif is_noisy:
        verdict = "the renders are too noisy to tell"
    return FittedNumber(
        name=number.name, unit=number.unit, prior=estimate(number.at(quantiles)), prior_origin=number.origin,
        posterior=estimate(number.at(theta)), left_of_prior_rel=left, verdict=verdict,
    )  # fmt: skip


def _brightness(scene: SensorScene, model: PictureModel, theta: Floats) -> tuple[LayerBrightness, ...]:
    """Return what each layer adds to the fitted channel that sees it best, over the design's."""
    growth, seen = model.growth(theta), np.argmax(model.mix, axis=0)
    return tuple(
        LayerBrightness(layer=name, channel=CHANNELS[model.seen[c]], over_design_rel=estimate(growth[:, c, layer]))
        for layer, (name, c) in enumerate(zip(scene.layer_names, seen.tolist(), strict=True))
        if model.mix[c, layer] > 0.0
    )


def _combinations(numbers: Sequence[FreeParameter], theta: Floats) -> tuple[str, ...]:
    """Say which combinations keep more than half of the prior's width."""
    sizes, directions = np.linalg.eigh(np.cov(theta.T))
    told = []
    for size, direction in zip(np.sqrt(np.maximum(sizes, 0.0)), directions.T, strict=True):
        members = [n.name for n, weight in zip(numbers, direction, strict=True) if abs(weight) > _MEMBER]
        if size > _DETERMINED and len(members) > 1:
            told.append(
                f"{', '.join(members)}: one combination of these numbers keeps {100 * min(size, 1.0):.0f} % of its "
                "width in the prior"
            )
    return tuple(told)


def fitted_design(fit: SensorFit) -> Design:
    """Return the design with the fitted value of every field that the pictures determine, at least in part.

    Such a field is then of origin "measured" with its standard uncertainty. Gain, yields, responses and the place of
    the picture are no fields of a design; the record holds them.
    """
    design = fit.finger or fit.sensor
    if design is None:
        raise SimulateError(f"{fit.name}: the fit contains no design")
    values, origin, spread = {}, dict(design.origin), dict(design.uncertainty_rel)
    for number in fit.numbers:
        if value_at(design, number.name) is None or number.verdict not in ("determined", "partly determined"):
            continue
        values[number.name] = number.posterior.estimate
        # of entries of a list the design states one uncertainty, that of all
        field = ".".join(part for part in number.name.split(".") if not part.isdecimal())
        relative = number.posterior.sd / number.posterior.estimate
        spread[field] = max(relative, spread.get(field, 0.0) if field != number.name and field in origin else 0.0)
        origin[field] = "measured"
    changed = with_changed_values(design, values)
    return changed.model_copy(
        update={"name": f"{design.name}, fitted", "origin": origin, "uncertainty_rel": spread, "provenance": None}
    )
