"""From one simulated press and one tactile capture to the photometric error report."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from data_schemas.capture import TactileCapture
from data_schemas.compare import (
    InputUncertainty,
    MonteCarlo,
    ObjectiveError,
    PhotometricErrorReport,
    SensingError,
    ValidationCell,
)
from data_schemas.compare import RegionError as RegionRecord
from data_schemas.finger_identity import finger_identity
from data_schemas.sensing import NormalMapRecord
from data_schemas.simulate import SimulatedPress
from finray_calib.compare.blocks import largest_block_px
from finray_calib.compare.brightness import captured_share, objective_error, ring_of
from finray_calib.compare.budget import uncertainty_budget
from finray_calib.compare.error_rows import (
    CHROMATICITY_DRAWS,
    ShownCandidate,
    error_row,
    full_frame_ssim,
    shown_candidate,
)
from finray_calib.compare.input_draws import POSE, Inputs, generator_of, inputs_of
from finray_calib.compare.photometric_error import (
    Comparison,
    RegionResult,
    best,
    prepare_comparison,
    propagated,
    require_contact,
    resampled,
)
from finray_calib.compare.prepared_images import PreparedImages, prepare_images
from finray_calib.compare.regions import Region, strip_from_distance
from finray_calib.compare.sensing_record import sensing_record
from finray_calib.compare.stopping_rule import Propagated
from finray_calib.compare.validation import validation_cells

Floats = NDArray[np.float64]
PATCH, DILATED = "contact patch", "contact patch dilated 2x"
FACTORS = {PATCH: 1.0, DILATED: 2.0}
LARGEST_HEADLINE_NOISE = 0.01
"""Standard deviation of the headline skill from noise alone, from which on pixels are averaged over blocks."""
CONDITIONED_DRAWS = 2000
"""Draws that the chromaticity's are the first of: fewer do not settle how inputs and levels hang together."""
SSIM_SETTINGS = (
    "Wang 2004 on the compared values: sigma 1.5, 11 x 11, K1 0.01, K2 0.03, population covariance, no border"
)
COVERS_INPUTS = (
    "the metric between the noise-free capture and the noise-free render with the true paints, camera and pose: what "
    "the inputs of the budget leave open, with 95 % probability; noise is taken out of every error"
)
COVERS_PARTS = (
    "how much a number depends on which part of the region was looked at (tiles drawn with replacement): no input of "
    "this image has a known uncertainty"
)
ALWAYS_UNKNOWN = (
    "another press, day or finger: that needs more captures",
    "the fixed pattern of the camera, and light that the design does not hold",
)


def compare_press(
    press: SimulatedPress, capture: TactileCapture, seed: int, normal_map: NormalMapRecord | None = None
) -> PhotometricErrorReport:
    """Compare a render (or table prediction) with a capture over the contact patch and its halo.

    Squared errors are those of the noise-free images: the render's noise is taken out by its two independent halves,
    the camera's by what the two no-contact images tell of it. Intervals propagate paints, camera, pose, drift and noise
    (JCGM 101); for images of which no input is known to be uncertain they come from parts of the region.

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
        The images differ in size, linear light would be compared with encoded values, contact changes nothing, or the
        render is black.
    """
    linear, rng = capture.encoding == "linear", generator_of(capture, seed)
    images, comparison = _quiet_comparison(prepare_images(press, capture), capture)
    captured = images.captured
    draws = _draws(comparison, rng)
    candidates = _candidates(comparison, capture)
    records = _region_records(comparison, draws, candidates, images.clipped, capture, rng)
    headline = next(row for row in records[-1].rows if row.candidate == "simulation")
    statements = _statements(comparison, images.distance, capture, draws, rng)
    exposure = None if draws.propagated is None else draws.propagated.draws["exposure"]
    red, green, blue = (float(w) for w in comparison.channel_weights)
    return PhotometricErrorReport(
        simulated=press.name,
        captured=capture.name,
        finger=None if press.design is None else finger_identity(press.design),
        label=press.label,
        values="linear light" if linear else "encoded values, encoding unknown",
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
        light_angle_deg=capture.light_angle_deg,
        light_angle_uncertainty_deg=capture.light_angle_uncertainty_deg,
        interval_covers=COVERS_PARTS if draws.propagated is None else COVERS_INPUTS,
        monte_carlo=_monte_carlo(draws.propagated, press, comparison.inputs),
        budget=statements.budget,
        validation=statements.validation,
        sensing=_sensing(comparison, normal_map, capture, candidates, images.block_px, rng),
        error_map=_error_map(candidates["simulation"].image, captured.contact, captured.no_contact),
        withheld=_withheld(press, capture, draws.propagated is not None),
        notes=_notes(press, capture, images.block_px),
    )


def _quiet_comparison(images: PreparedImages, capture: TactileCapture) -> tuple[PreparedImages, Comparison]:
    """Return images and sums over the smallest blocks that keep noise from ruling the headline."""
    linear, side, largest = capture.encoding == "linear", 1, largest_block_px(images.distance)
    while True:
        blocked = images if side == 1 else images.blocked(side)
        captured, distance = blocked.captured, blocked.distance
        inputs = None
        if linear:
            inputs = inputs_of(blocked.layers, capture, captured.no_contact, captured.repeat, np.isfinite(distance))
        regions = [Region(name, strip_from_distance(distance, factor), factor) for name, factor in FACTORS.items()]
        comparison = prepare_comparison(blocked.layers, captured, regions, inputs, linear, linear, demand_contact=False)
        if side >= largest or comparison.headline_noise <= LARGEST_HEADLINE_NOISE:
            require_contact(comparison)
            return blocked, comparison
        side *= 2


@dataclass(frozen=True, slots=True)
class _Draws:
    """Draws of every region; where they come from parts of the region, the values over all of it beside them."""

    regions: list[RegionResult]
    whole: list[RegionResult] | None
    propagated: Propagated | None


@dataclass(frozen=True, slots=True)
class _Statements:
    """What only linear light allows: error of the sweep's objective, budget and validation."""

    objective: ObjectiveError | None = None
    budget: tuple[InputUncertainty, ...] = ()
    validation: tuple[ValidationCell, ...] = ()


def _draws(comparison: Comparison, rng: np.random.Generator) -> _Draws:
    """Propagate the inputs where their uncertainty is known, else resample parts of the regions."""
    if comparison.inputs is None or comparison.layers.inputs is None:
        return _Draws(resampled(comparison, rng), best(comparison), None)
    regions, all_draws = propagated(comparison, comparison.inputs, rng)
    return _Draws(regions, None, all_draws)


def _candidates(comparison: Comparison, capture: TactileCapture) -> dict[str, ShownCandidate]:
    """Return the candidates as images: doing nothing, the render, and a perfect render seen on the repeat."""
    layers, captured, k = comparison.layers, comparison.captured, comparison.best_exposure
    images = {
        "do nothing": (captured.no_contact, captured.variance(captured.no_contact)),
        "simulation": (k * layers.rgb(layers.contact), k**2 * layers.contact_variance),
    }
    if captured.repeat is not None:
        variance = captured.variance(captured.repeat) + captured.variance(captured.no_contact)
        images["floor"] = (captured.contact + captured.repeat - captured.no_contact, variance)
    linear = capture.encoding == "linear"
    return {
        name: shown_candidate(
            *image, captured.contact, captured.no_contact, comparison.used[-1], _full_scale_dn(capture), linear
        )
        for name, image in images.items()
    }


def _region_records(
    comparison: Comparison,
    draws: _Draws,
    candidates: dict[str, ShownCandidate],
    clipped: NDArray[np.bool_],
    capture: TactileCapture,
    rng: np.random.Generator,
) -> tuple[RegionRecord, ...]:
    """Return the table of every region."""
    captured, inputs = comparison.captured, comparison.inputs
    variance = captured.variance(captured.contact)
    drawn = None
    if draws.propagated is not None and inputs is not None:
        conditioned = comparison.conditioned(inputs.draw(CONDITIONED_DRAWS, rng), rng)
        exposure = comparison.exposure_of(conditioned.matrix)
        drawn = (exposure[:, None, None] * conditioned.weights)[:CHROMATICITY_DRAWS]
    records = []
    for i, (region, used) in enumerate(zip(comparison.regions, comparison.used, strict=True)):
        images = None
        if drawn is not None and inputs is not None:
            first, second = comparison.layers.halves("contact", used, inputs.pose_names)
            images = np.einsum("dcl,pl->dpc", drawn, (first + second) / 2.0)
        rows = [
            error_row(
                name, candidate, captured.contact, variance, used, draws.regions[i],
                None if draws.whole is None else draws.whole[i], comparison.channel_weights, _full_scale_dn(capture),
                capture.encoding == "linear", images if name == "simulation" else None,
                i == len(comparison.regions) - 1, comparison.sums[i].told,
            )
            for name, candidate in candidates.items()
        ]  # fmt: skip
        share = float(clipped[region.mask].mean())
        records.append(
            RegionRecord(
                region=region.name,
                factor=region.factor,
                pixels=int(used.sum()),
                clipped_fraction=share,
                rows=tuple(rows),
            )
        )
    return tuple(records)


def _statements(
    comparison: Comparison, distance: Floats, capture: TactileCapture, draws: _Draws, rng: np.random.Generator
) -> _Statements:
    """Return objective, budget and validation, for linear light whose inputs are known."""
    inputs = comparison.inputs
    if inputs is None or draws.propagated is None:
        return _Statements()
    captured = comparison.captured
    usable: NDArray[np.bool_] = np.asarray(np.isfinite(captured.contact).all(axis=2), dtype=np.bool_)
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
    inputs, conditioned = comparison.inputs, None
    if inputs is not None and comparison.layers.inputs is not None:
        conditioned = comparison.conditioned(inputs.draw(CONDITIONED_DRAWS, rng), rng)
    images = {name: candidate.image for name, candidate in candidates.items()}
    return sensing_record(comparison, normal_map, capture, images, block_px, conditioned)


def _full_scale_dn(capture: TactileCapture) -> float:
    """Return full scale above black level."""
    return float(2.0**capture.bit_depth - 1.0 - capture.black_level_dn)


def _monte_carlo(draws: Propagated | None, press: SimulatedPress, inputs: Inputs | None) -> MonteCarlo | None:
    """Say how the intervals were propagated and what they leave out."""
    if draws is None or inputs is None:
        return None
    left_out = [*ALWAYS_UNKNOWN]
    known = press.known_inputs.names if press.known_inputs is not None else ()
    left_out += [
        f"the {name}, of which the press holds no draws"
        for name in ("red paint", "green paint", "camera response")
        if name not in known
    ]
    left_out += [
        f"the {POSE[name]}: the capture states no uncertainty of it, or the render no derivative (--pose-response)"
        for name in POSE
        if name not in inputs.pose_names
    ]
    return MonteCarlo(
        draws=len(draws.draws["exposure"]),
        significant_digits=draws.significant_digits,
        not_included=tuple(left_out),
    )


def _error_map(simulated: Floats, captured: Floats, no_contact: Floats) -> NDArray[np.float32]:
    """Return the error per pixel: rms over channels of (simulated - captured) / mean no-contact level."""
    level = np.nanmean(no_contact, axis=(0, 1))
    error: Floats = np.sqrt((((simulated - captured) / level) ** 2).mean(axis=-1))
    return error.astype(np.float32)


def _withheld(press: SimulatedPress, capture: TactileCapture, is_propagated: bool) -> tuple[str, ...]:
    """Say which figures an unknown encoding, or a press of unknown inputs, does not allow."""
    if is_propagated:
        return ()
    if capture.encoding == "linear":
        return (
            "the error of the sweep's objective, budget and validation are not given: no input of "
            f"{press.name} has a known uncertainty",
        )
    return (
        "relative RMS, gradient and colour error, exposure factor, objective and validation are not given: the "
        f"encoding of {capture.name} is unknown, so its values are not proportional to light",
    )


def _notes(press: SimulatedPress, capture: TactileCapture, block_px: int) -> tuple[str, ...]:
    """Collect what a reader must know."""
    notes, linear = list(press.notes), capture.encoding == "linear"
    if block_px > 1:
        notes.append(
            f"compared over blocks of {block_px} x {block_px} px, at most a quarter of the contact's half-width, so "
            f"that noise leaves the headline uncertain by {LARGEST_HEADLINE_NOISE:g}, or as little as such blocks allow"
        )
    if capture.repeat_no_contact is None:
        notes.append("no repeat of the no-contact image: neither the floor nor the camera's noise is known")
        notes.append(
            "that there is a touch was told from noise as neighbouring pixels show it: noise that they share (JPEG, "
            "interpolated colours) can pass for a touch"
        )
    elif not linear:
        notes.append("the noise of encoded images is not known: it stays in their errors")
    if linear and press.contact_half_difference is None:
        notes.append("the render holds no halves: its noise stays in its errors")
    return tuple(notes)
