"""From one simulated press and one tactile capture to the photometric error report."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from data_schemas.capture import TactileCapture
from data_schemas.compare import (
    InputUncertainty,
    ObjectiveError,
    PhotometricErrorReport,
    SensingError,
    ValidationCell,
)
from data_schemas.finger_identity import finger_identity
from data_schemas.sensing import NormalMapRecord
from data_schemas.simulate import SimulatedPress
from finray_calib.compare.brightness import captured_share, objective_error, ring_of
from finray_calib.compare.budget import uncertainty_budget
from finray_calib.compare.comparison import Comparison
from finray_calib.compare.comparison_notes import COVERS_INPUTS, COVERS_PARTS, monte_carlo, notes_of, withheld
from finray_calib.compare.input_draws import Drawn, generator_of
from finray_calib.compare.photometric_error import ErrorDraws, error_draws
from finray_calib.compare.prepared_images import prepare_images
from finray_calib.compare.quiet_comparison import quiet_comparison
from finray_calib.compare.region_records import region_records
from finray_calib.compare.regions import DILATED
from finray_calib.compare.sensing_record import sensing_record
from finray_calib.compare.shown_candidates import SSIM_SETTINGS, ShownCandidate, full_frame_ssim, shown_candidates
from finray_calib.compare.validation import validation_cells

Floats = NDArray[np.float64]
CONDITIONED_DRAWS = 2000
"""Draws that the chromaticity's are the first of: fewer do not settle how inputs and levels hang together."""


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
    images, comparison = quiet_comparison(prepare_images(press, capture), capture)
    draws = error_draws(comparison, rng)
    candidates = shown_candidates(comparison, capture)
    conditioned = _conditioned(comparison, rng)
    records = region_records(comparison, draws, candidates, images.clipped, capture, conditioned)
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
        monte_carlo=monte_carlo(draws.propagated, press, comparison.inputs),
        budget=statements.budget,
        validation=statements.validation,
        sensing=_sensing(comparison, normal_map, capture, candidates, images.block_px, rng),
        error_map=_error_map(candidates["simulation"].image, comparison),
        withheld=withheld(press, capture, draws.propagated is not None),
        notes=notes_of(press, capture, images.block_px),
    )


@dataclass(frozen=True, slots=True)
class _Statements:
    """What only linear light allows: error of the sweep's objective, budget and validation."""

    objective: ObjectiveError | None = None
    budget: tuple[InputUncertainty, ...] = ()
    validation: tuple[ValidationCell, ...] = ()


def _conditioned(comparison: Comparison, rng: np.random.Generator) -> Drawn | None:
    """Return draws of the inputs narrowed by the captured levels, None where no input has a known uncertainty."""
    if comparison.inputs is None or comparison.layers.inputs is None:
        return None
    return comparison.conditioned(comparison.inputs.draw(CONDITIONED_DRAWS, rng), rng)


def _statements(
    comparison: Comparison, distance: Floats, capture: TactileCapture, draws: ErrorDraws, rng: np.random.Generator
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
    images = {name: candidate.image for name, candidate in candidates.items()}
    return sensing_record(comparison, normal_map, capture, images, block_px, _conditioned(comparison, rng))


def _error_map(simulated: Floats, comparison: Comparison) -> NDArray[np.float32]:
    """Return the error per pixel: rms over channels of (simulated - captured) / mean no-contact level."""
    captured = comparison.captured
    level = np.nanmean(captured.no_contact, axis=(0, 1))
    error: Floats = np.sqrt((((simulated - captured.contact) / level) ** 2).mean(axis=-1))
    return error.astype(np.float32)
