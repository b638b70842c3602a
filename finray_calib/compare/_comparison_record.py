"""From one simulated press and one tactile capture to the photometric error report.

What goes before it: do the images belong together, and does the camera stand where it should. What goes with it: what a
reader must know, namely what the intervals cover, what they leave out, and what is withheld.
"""

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from data_schemas import (
    CompareError,
    FittedToneCurve,
    InputUncertainty,
    MonteCarlo,
    NormalMapRecord,
    ObjectiveError,
    PackagedMetric,
    PhotometricErrorReport,
    PixelScale,
    SensingError,
    SimulatedPress,
    TactileCapture,
    ValidationCell,
    finger_identity,
)
from finray_calib.compare._candidate_errors import packaged_metric, region_records, sensing_record
from finray_calib.compare._comparison import LARGEST_HEADLINE_NOISE, Comparison, block_averaged_comparison
from finray_calib.compare._displayed_images import SSIM_SETTINGS, ShownCandidate, full_frame_ssim, shown_candidates
from finray_calib.compare._error_attribution import attribute_error
from finray_calib.compare._image_noise import mean_level
from finray_calib.compare._input_draws import POSE, InputDraws, Inputs, Propagated, generator_of
from finray_calib.compare._mismatch import dark_findings, mismatches, require_no_mismatch
from finray_calib.compare._photometric_error import (
    ErrorDraws,
    captured_share,
    error_draws,
    nuisance_skill_u,
    objective_error,
    objective_through_curve,
    ring_of,
    uncertainty_budget,
    validation_cells,
)
from finray_calib.compare._prepared_images import (
    Nuisances,
    PreparedImages,
    begins_from,
    nuisances_of,
    prepare_images,
    relative_press,
    require_same_conditions,
)
from finray_calib.compare._regions import DILATED, FACTORS, every_channel
from finray_calib.compare._registration import move_press, register_press
from finray_calib.compare._tone_curve import drift_record, encoded_layers, tone_record, without_gain
from finray_calib.sensing import (
    contact_distance,
    full_scale_dn,
    patch_scale,
    rgb_image,
    scale_finding,
    with_measured_scale,
)

#: How the finding begins that says that the camera stands where the render has it.
NO_DRIFT = "no drift of the camera that matters"
_ONE_PICTURE = (
    "a drift of the camera cannot be measured: the prediction begins from the capture's own image without contact, "
    "so both agree wherever the camera was"
)
_WHAT_TO_DO = (
    "Check that the render has the camera, the design and the light angle of the capture, or calibrate the camera with "
    "a ChArUco board and simulate with that calibration"
)


@dataclass(frozen=True, slots=True)
class CheckOptions:
    """What to do with what the checks find.

    Attributes
    ----------
    registered : bool
        Move the render by the drift of the camera that was found; else the drift is only told. The render stands where
        the calibrated camera puts it, so that a drift is a fact about the rig, which a silent correction would hide.
    despite_mismatch : bool
        Compare images that do not belong together; the findings stand in the report.
    normal_map : NormalMapRecord or None
        Of the capture's sensor, for the error in sensing space.
    pixel_scale : PixelScale or None
        Of the capture's camera, for the sizes of patch and halo in mm; it takes the place of what the capture states.
    metrics : tuple of str
        Names of metrics that other packages bring, which stand beside ours.
    relative : bool
        Judge the change by contact alone, see `relative_press`.
    """

    registered: bool = False
    despite_mismatch: bool = False
    normal_map: NormalMapRecord | None = None
    pixel_scale: PixelScale | None = None
    metrics: tuple[str, ...] = ()
    relative: bool = False


def compare_checked(
    press: SimulatedPress, capture: TactileCapture, seed: int, options: CheckOptions | None = None
) -> tuple[PhotometricErrorReport, SimulatedPress]:
    """Compare a press with a capture after checking that they belong together.

    Returns
    -------
    PhotometricErrorReport
        As :func:`checked_report` returns it.
    SimulatedPress
        The press as it was compared: moved, if that was asked for and the camera has drifted.

    Raises
    ------
    CompareError
        See :func:`checked_report`.
    """
    report, compared, estimated = _checked(press, capture, seed, options or CheckOptions())
    return report, _as_compared(compared, capture, estimated or nuisances_of(compared, capture))


def checked_report(
    press: SimulatedPress, capture: TactileCapture, seed: int, options: CheckOptions | None = None
) -> PhotometricErrorReport:
    """Return the report alone, of a press and a capture that belong together.

    Returns
    -------
    PhotometricErrorReport
        What the checks found stands in its `findings`; `forced_mismatch` where they would have refused it.

    Raises
    ------
    CompareError
        The images do not belong together, cannot be compared (see `compare_press`), or the registration that was asked
        for cannot be trusted.
    """
    return _checked(press, capture, seed, options or CheckOptions())[0]


def _checked(
    press: SimulatedPress, capture: TactileCapture, seed: int, chosen: CheckOptions
) -> tuple[PhotometricErrorReport, SimulatedPress, Nuisances | None]:
    """Return the report, the press where it was compared, and curve and gains, where they are known."""
    if chosen.relative and chosen.registered:
        raise CompareError(
            "--relative and --register cannot be combined, because with --relative the capture's own image without "
            "contact replaces the render's, so no drift can be found; leave out one of these options"
        )
    # before the images: a press elsewhere looks like another exposure
    require_same_conditions(press, capture)
    in_ratios = chosen.relative or (press.encoding, capture.encoding) == ("linear", "unknown")
    dark = dark_findings(press, capture) if in_ratios else []
    if chosen.relative:
        press = relative_press(press, capture)
    findings, estimated = mismatches(press, capture)
    findings = (*findings, *dark)
    if not chosen.despite_mismatch:
        require_no_mismatch(findings)
    compared, told = _placed_press(press, capture, chosen.registered)
    checks = (*(f"{f.about}: {f.text}" for f in findings), *told, *_other_press(compared, capture))
    scale, scaled = None, capture
    if chosen.pixel_scale is not None:
        scaled = with_measured_scale(capture, chosen.pixel_scale)
    estimated = estimated if compared is press else None
    prepared = prepare_images(compared, scaled, estimated)
    report = _report(compared, scaled, seed, chosen.normal_map, prepared, chosen.metrics)
    if chosen.pixel_scale is not None:
        scale = patch_scale(chosen.pixel_scale, capture, compared.distance, FACTORS)
        other = scale_finding(scale, capture)
        checks = checks if other is None else (*checks, other)
    forced = any(f.severity == "refuse" for f in findings)
    found = {"findings": (*report.findings, *checks), "forced_mismatch": forced, "patch_scale": scale}
    return report.model_copy(update=found | {"relative": chosen.relative}), compared, estimated


_SIZE_IN_NAME: Final = re.compile(r"(?<![\d.])(\d+(?:\.\d+)?)[ _-]?(mm|um|N|deg)(?![A-Za-z])")


def _other_press(press: SimulatedPress, capture: TactileCapture) -> Iterator[str]:
    """Tell what shows that a capture is of another press: contacts that share no pixel, and sizes in the two names."""
    distance = contact_distance(capture)
    patches = [] if distance is None else [press.distance <= 1.0, distance <= 1.0]
    if patches and all(patch.any() for patch in patches) and not (patches[0] & patches[1]).any():
        at = [f"{name} ({_place(patch)})" for name, patch in zip((press.name, capture.name), patches, strict=True)]
        yield (
            f"place: the contact of the render {at[0]} and that of the capture {at[1]} share no pixel: check that both "
            "are of the same press, and the contact circle or outline of the capture"
        )
    sizes = [{(unit, float(number)) for number, unit in _SIZE_IN_NAME.findall(n)} for n in (press.name, capture.name)]
    for unit in sorted({unit for unit, _ in sizes[0]} & {unit for unit, _ in sizes[1]}):
        told = [sorted(number for u, number in named if u == unit) for named in sizes]
        if not set(told[0]) & set(told[1]):
            words = [" and ".join(f"{number:g} {unit}" for number in numbers) for numbers in told]
            yield (
                f"names: the render {press.name} is named by {words[0]}, but the capture {capture.name} by {words[1]}: "
                "check that both are of the same press"
            )


def _place(patch: NDArray[np.bool_]) -> str:
    """Return where a contact patch lies, in words."""
    row, column = (float(places.mean()) for places in np.nonzero(patch))
    return f"its centre at row {row:.0f} px, column {column:.0f} px, radius {np.sqrt(patch.sum() / np.pi):.0f} px"


def shown_press(
    press: SimulatedPress, capture: TactileCapture, registered: bool = False, relative: bool = False
) -> SimulatedPress:
    """Return the press as :func:`compare_checked` compared it: moved if asked, through the camera's curve and gains."""
    press = relative_press(press, capture) if relative else press
    placed = _placed_press(press, capture, registered)[0]
    return _as_compared(placed, capture, nuisances_of(placed, capture))


def _as_compared(press: SimulatedPress, capture: TactileCapture, nuisances: Nuisances) -> SimulatedPress:
    """Return the press as its pictures stand beside the capture's: through the tone curve, with the capture's gain."""
    tone, gain = nuisances.tone, nuisances.gain
    if nuisances.is_idle or capture.encoding == "linear":
        return press
    layers, rest, offset_dn = nuisances.render, press.no_contact.astype(np.float64), 0.0
    if tone is not None:
        rest, offset_dn = np.nan_to_num(nuisances.no_contact), tone.offset_dn
        layers = encoded_layers(nuisances.render, rest, tone.exponent, tone.offset_dn)
    contact = layers.rgb(layers.contact)
    if nuisances.is_corrected and gain is not None:
        contact = without_gain(contact, np.where(gain.to_correct, -gain.log_gain, 0.0), offset_dn)
    images = {"contact": contact.astype(np.float32), "no_contact": rest.astype(np.float32), "encoding": "unknown"}
    return press.model_copy(update=images)


def _placed_press(press: SimulatedPress, capture: TactileCapture, registered: bool) -> tuple[SimulatedPress, list[str]]:
    """Return the press, moved if asked, and what to tell of the camera's drift."""
    if begins_from(press, rgb_image(capture.no_contact, capture)):
        return press, [_ONE_PICTURE]
    try:
        found, state = register_press(press, capture)
    except CompareError as error:
        if registered:
            raise CompareError(f"{error}. {_WHAT_TO_DO}, or compare without --register") from None
        return press, [f"it is not known whether the camera is where the render assumes it: {error}. {_WHAT_TO_DO}"]
    if not found.significant:
        return press, [f"{NO_DRIFT}, by the images with {state}: {found}"]
    if not registered:
        seen = f"the camera has drifted, as the images with {state} show: {found}"
        return press, [f"{seen}; the option 'register' moves the render"]
    return move_press(press, found.to_render), [f"the render was moved to fit the images with {state}: {found}"]


Floats = NDArray[np.float64]
CONDITIONED_DRAWS = 2000
"""Draws that the chromaticity's are the first of: fewer do not settle how inputs and levels hang together."""


def compare_press(
    press: SimulatedPress, capture: TactileCapture, seed: int, normal_map: NormalMapRecord | None = None
) -> PhotometricErrorReport:
    """Compare a render (or table prediction) with a capture over the contact patch and its halo.

    Squared errors are those of the noise-free images: the render's noise is taken out by its two independent halves,
    the camera's by what the two no-contact images tell of it. Intervals propagate paints, camera, pose, drift and noise
    (JCGM 101); for images of which no input is known to be uncertain they come from parts of the region. A render in
    linear light meets encoded values through a tone curve that is fitted to the images without contact.

    Parameters
    ----------
    press
        Simulated contact and no-contact images with the distance map that defines the regions.
    capture
        Contact, no-contact and repeat images of the same press.
    seed
        Seed of the draws that belong to this capture alone.
    normal_map
        From colour to normals, of the capture's sensor: both sides are then compared in sensing space too.

    Raises
    ------
    CompareError
        The images differ in size, the render holds encoded values and the capture light, contact changes nothing, or
        the render is black.
    """
    return _report(press, capture, seed, normal_map, prepare_images(press, capture))


def _report(
    press: SimulatedPress, capture: TactileCapture, seed: int, normal_map: NormalMapRecord | None,
    prepared: PreparedImages, metrics: tuple[str, ...] = (),
) -> PhotometricErrorReport:  # fmt: skip
    """Return the report of prepared images."""
    linear, rng = capture.encoding == "linear", generator_of(capture, seed)
    images, comparison = block_averaged_comparison(prepared, capture)
    nuisances = prepared.nuisances
    draws = error_draws(comparison, rng)
    candidates = shown_candidates(comparison, capture)
    conditioned = _conditioned(comparison, rng)
    records = region_records(comparison, draws, candidates, images.clipped, capture, conditioned)
    headline = next(row for row in records[-1].rows if row.candidate == "simulation")
    statements = _statements(comparison, images.distance, capture, draws, rng)
    exposure = None if draws.propagated is None else draws.propagated.draws["exposure"]
    attributed = partial(attribute_error, comparison, images.distance, images.block_px, full_scale_dn(capture))
    red, green, blue = (float(w) for w in comparison.channel_weights)
    return PhotometricErrorReport(
        **_compared_sides(press, capture),
        values="linear light" if linear else ENCODED if nuisances.tone is None else THROUGH_A_CURVE,
        block_px=images.block_px,
        headline_region=DILATED,
        headline_skill=headline.skill,
        regions=records,
        ssim_full_frame=full_frame_ssim(candidates),
        ssim_settings=SSIM_SETTINGS,
        exposure_factor=comparison.best_exposure if linear else None,
        exposure_factor_sd=None if exposure is None else float(exposure.std(ddof=1)),
        channel_weights=(red, green, blue),
        objective_error=statements.objective,
        interval_covers=interval_covers(comparison, draws),
        interval_over="pixels of this press" if draws.propagated is None else "inputs",
        contact_signal=_contact_signal(comparison, capture, images.block_px),
        attribution=attributed(headline.skill.estimate),
        monte_carlo=monte_carlo(draws.propagated, press, comparison.inputs),
        budget=statements.budget,
        validation=statements.validation,
        sensing=_sensing(comparison, normal_map, capture, candidates, images.block_px, rng),
        tone_curve=_tone_record(comparison, images.distance, rng),
        white_balance=None if nuisances.gain is None else drift_record(nuisances.gain, nuisances.is_corrected),
        error_map=_error_map(candidates["simulation"].image, comparison),
        withheld=withheld(press, capture, draws.propagated is not None, statements.objective is not None),
        findings=(OWN_NOISE,) if prepared.holds_noise_of_render else (),
        notes=notes_of(press, capture, images.block_px, nuisances),
        packaged_metrics=_packaged(metrics, comparison, candidates, conditioned),
    )


def _packaged(
    metrics: tuple[str, ...], comparison: Comparison, candidates: Mapping[str, ShownCandidate], drawn: InputDraws | None
) -> tuple[PackagedMetric, ...]:
    """Return the metrics of other packages."""
    images = {name: candidate.image for name, candidate in candidates.items()}
    return tuple(packaged_metric(name, comparison, images, drawn) for name in metrics)


OWN_NOISE: Final = (
    "render: the capture has the same noise as this render, so it was made from this render. The noise is not taken "
    "out, because the score would exceed 1. A score of 1 then shows that the comparison works, not that the "
    "simulation is right: compare with a capture, or with one made from a render of another seed"
)
ENCODED: Final = "encoded values, encoding unknown"
THROUGH_A_CURVE: Final = "encoded values, through a fitted tone curve"


def _tone_record(comparison: Comparison, distance: Floats, rng: np.random.Generator) -> FittedToneCurve | None:
    """Return the record of the fitted curve, and what it does to the headline."""
    nuisances = comparison.nuisances
    if nuisances is None or nuisances.tone is None:
        return None
    tone, where = nuisances.tone, comparison.used[-1]
    rest = nuisances.render.rgb(nuisances.render.no_contact)
    lit = np.isfinite(distance) & every_channel((rest > 0.0) | ~tone.lit)
    light = np.log(np.where(tone.lit, rest[lit], 1.0)).mean(axis=0) if lit.any() else np.zeros(3)
    level = comparison.captured.contact[where]
    low, high = tone.level_dn.min(axis=0), tone.level_dn.max(axis=0)
    outside = float(((level < low) | (level > high)).any(axis=1).mean())
    return tone_record(tone, light, nuisance_skill_u(comparison, rng), outside)


@dataclass(frozen=True, slots=True)
class _Statements:
    """What only linear light allows: error of the sweep's objective, budget and validation."""

    objective: ObjectiveError | None = None
    budget: tuple[InputUncertainty, ...] = ()
    validation: tuple[ValidationCell, ...] = ()


def _compared_sides(press: SimulatedPress, capture: TactileCapture) -> dict[str, Any]:
    """Return what the report says of both sides as they were given."""
    return {
        "simulated": press.name,
        "captured": capture.name,
        "finger": None if press.design is None else finger_identity(press.design),
        "label": press.label,
        "light_angle_deg": capture.light_angle_deg,
        "light_angle_uncertainty_deg": capture.light_angle_uncertainty_deg,
    }


def _contact_signal(comparison: Comparison, capture: TactileCapture, block_px: int) -> float:
    """Return what the headline skill is a share of, in pixels times squares of the level or of full scale."""
    signal = float(comparison.sums[-1].signal(np.ones(1))[0] @ comparison.channel_weights) * block_px**2
    return signal if capture.encoding == "linear" else signal / full_scale_dn(capture) ** 2


def _conditioned(comparison: Comparison, rng: np.random.Generator) -> InputDraws | None:
    """Return draws of the inputs narrowed by the captured levels, None where no input has a known uncertainty."""
    if comparison.inputs is None or comparison.layers.inputs is None:
        return None
    return comparison.conditioned(comparison.inputs.draw(CONDITIONED_DRAWS, rng), rng)


def _statements(
    comparison: Comparison, distance: Floats, capture: TactileCapture, draws: ErrorDraws, rng: np.random.Generator
) -> _Statements:
    """Return objective, budget and validation, for linear light whose inputs are known; through a curve the first."""
    inputs = comparison.inputs
    nuisances = comparison.nuisances
    if nuisances is not None and nuisances.tone is not None and nuisances.render.inputs is not None:
        return _Statements(objective_through_curve(comparison, nuisances, distance, capture, rng))
    if inputs is None or draws.propagated is None:
        return _Statements()
    captured = comparison.captured
    usable = every_channel(np.isfinite(captured.contact))
    ring = ring_of(distance, usable)
    share = captured_share(comparison, ring, np.isfinite(distance))
    return _Statements(
        objective_error(comparison, inputs, ring, share, capture, rng),
        uncertainty_budget(comparison, inputs, ring, share, capture, rng),
        validation_cells(comparison, inputs, rng),
    )


def _sensing(
    comparison: Comparison,
    normal_map: NormalMapRecord | None,
    capture: TactileCapture,
    candidates: dict[str, ShownCandidate],
    block_px: int,
    rng: np.random.Generator,
) -> SensingError | None:
    """Return the error in sensing space, where there is a map to sense with."""
    if normal_map is None:
        return None
    images = {name: candidate.image for name, candidate in candidates.items()}
    return sensing_record(comparison, normal_map, capture, images, block_px, _conditioned(comparison, rng))


def _error_map(simulated: Floats, comparison: Comparison) -> NDArray[np.float32]:
    """Return the error per pixel: rms over channels of (simulated - captured) / mean no-contact level."""
    captured = comparison.captured
    level = mean_level(captured.no_contact)
    squares = simulated - captured.contact
    squares /= level
    squares *= squares
    # numpy's mean over so short an axis takes many times as long, for the same digits
    error: Floats = np.sqrt((squares[..., 0] + squares[..., 1] + squares[..., 2]) / 3.0)
    return error.astype(np.float32)


COVERS_INPUTS = (
    "The 95 % intervals cover the metric that capture and render would have without noise and with the true paints, "
    "camera and pose. They include the uncertain inputs that the budget lists. Noise is subtracted from every error"
)
_PARTS: Final = (
    "The intervals show how much a number depends on which pixels of this press are evaluated (square tiles of the "
    "region, drawn with replacement). They are not 95 % intervals"
)
_NOT_PRESSES: Final = (
    "They do not apply to another press, which usually differs by several times as much. For an interval over "
    "presses, compare folders of three presses or more"
)
COVERS_PARTS = f"{_PARTS}. No input of this image has a known uncertainty. {_NOT_PRESSES}"
COVERS_CURVE = (
    f"{_PARTS}. They include the uncertainty from {{unknown}}. No other input of this image has a known uncertainty. "
    f"{_NOT_PRESSES}"
)


def interval_covers(comparison: Comparison, draws: ErrorDraws) -> str:
    """Say what the intervals cover."""
    nuisances = comparison.nuisances
    if draws.propagated is not None:
        return COVERS_INPUTS
    if nuisances is None:
        return COVERS_PARTS
    names = [] if nuisances.tone is None else ["the unknown tone curve of the camera"]
    names += ["the gain that was taken out"] if nuisances.is_corrected else []
    return COVERS_CURVE.format(unknown=" and ".join(names))


ALWAYS_UNKNOWN = (
    "another press, day or finger: that needs more captures",
    "the fixed pattern of the camera, and light that the design does not hold",
)


def monte_carlo(draws: Propagated | None, press: SimulatedPress, inputs: Inputs | None) -> MonteCarlo | None:
    """Say how the intervals were propagated and what they leave out."""
    if draws is None or inputs is None:
        return None
    left_out = [*ALWAYS_UNKNOWN]
    known = press.known_inputs.names if press.known_inputs is not None else ()
    left_out += [
        f"the {name}, for which the press holds no draws"
        for name in ("red paint", "green paint", "camera response")
        if name not in known
    ]
    left_out += [
        f"the {POSE[name]}: the capture states no uncertainty of it, or the render has no derivative for it "
        "(option 'pose-response')"
        for name in POSE
        if name not in inputs.pose_names
    ]
    return MonteCarlo(
        draws=len(draws.draws["exposure"]),
        significant_digits=draws.significant_digits,
        not_included=tuple(left_out),
    )


def withheld(
    press: SimulatedPress, capture: TactileCapture, is_propagated: bool, has_objective: bool = False
) -> tuple[str, ...]:
    """Say which figures an unknown encoding, or a press of unknown inputs, does not allow."""
    if is_propagated:
        return ()
    if capture.encoding == "linear":
        return (
            "the error of the sweep's objective, budget and validation are not given: no input of "
            f"{press.name} has a known uncertainty",
        )
    objective = "" if has_objective else "objective "
    return (
        f"relative RMS, gradient and colour error, exposure factor, {objective}and validation are not given: the "
        f"encoding of {capture.name} is unknown, so its values are not proportional to light",
    )


_CURVE_CANNOT_KNOW = (
    "the tone curve was fitted to the images without contact alone. Three things are not known and not in any "
    "interval: a gain common to both captured images (it cancels in their ratio), the part of the exponent that is "
    "an error of the render's contrast, and any shape of the curve other than a power with an offset"
)


def notes_of(
    press: SimulatedPress, capture: TactileCapture, block_px: int, nuisances: Nuisances | None = None
) -> tuple[str, ...]:
    """Collect what a reader must know."""
    notes, linear = list(press.notes), capture.encoding == "linear"
    if nuisances is not None and nuisances.tone is not None:
        notes.append(_CURVE_CANNOT_KNOW)
    if nuisances is not None and nuisances.gain is None:
        notes.append(
            "it is not known whether exposure or white balance changed between the captures, because no channel has "
            "light in 8 or more blocks of pixels beyond 3 half-widths from the contact"
        )
    if block_px > 1:
        notes.append(
            f"compared over blocks of {block_px} x {block_px} px, so that noise makes the headline uncertain by no "
            f"more than {LARGEST_HEADLINE_NOISE:g}, as far as blocks of at most a quarter of the contact's half-width "
            "allow"
        )
    if capture.repeat_no_contact is None:
        notes.append(
            "the capture has no repeat of the no-contact image, so neither the floor nor the camera's noise is known"
        )
        notes.append(
            "the touch was detected against the noise between neighbouring pixels, so noise that neighbours share "
            "(JPEG, interpolated colours) can look like a touch"
        )
    elif not linear:
        notes.append("the noise of encoded images is not known, so it stays in their errors")
    if linear and press.contact_half_difference is None:
        notes.append(
            "the render was not stored as two independent halves, so its noise is not known and stays in its errors"
        )
    return tuple(notes)
