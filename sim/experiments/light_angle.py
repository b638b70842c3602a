"""Sweep the angle of the blue light: the paper's brightness near the indenter, with paint uncertainty."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from data_schemas.fit import PaintCalibration
from data_schemas.simulate import AngleConstraints, AngleObjective, LightAngleSweep
from sim.experiments.light_angle_objectives import REPEATS, angle_objectives, require_compiled
from sim.experiments.painted_finger import PaintedFinger
from sim.experiments.press import SHAPE_NOTE
from sim.optics.angle_sweep import sweep_light_angle
from sim.optics.paint_bands import BAND_NAMES, PaintBands, PaintOptics, paint_bands
from sim.optics.render import Progress
from sim.surface_meshes.finger_shape import FingerShape

Floats = NDArray[np.float64]
OBJECTIVE = (
    "white-balanced brightness beside the indenter: mean of camera R, G and B of the coating, each relative to its own "
    "mean over the sweep, at probe points on both edges of the contact, seen along the pad's normal"
)


def light_angle_sweep(
    finger: PaintedFinger,
    calibrations: Mapping[str, PaintCalibration],
    angles_deg: Sequence[float],
    repeats: int,
    samples: int,
    seed: int,
    paint_sha256: Mapping[str, str],
    progress: Progress | None = None,
    shape: FingerShape | None = None,
    further_objectives: bool = False,
    rest: FingerShape | None = None,
) -> LightAngleSweep:
    """Measure the objective at every angle, with one draw of both paints and one noise seed per repeat.

    A repeat's camera signal is ``C diag(gain) basis``; the camera matrix C and the gain (yield of the draw over the
    mean yield) are those of the repeat's posterior draw, the same at every angle, so that a common scale cannot
    change the ranking. The value is the mean of the three channels, each relative to its mean over the sweep: the
    blue channel, tens of times brighter in raw counts, would otherwise be the only one that counts.
    `shape` is the finger with contact, by default that of the analytic press.

    With `further_objectives`, those of :mod:`sim.experiments.light_angle_objectives` are measured too, with the first
    draws of the paints, on the finger without contact, `rest` (by default that of the design).
    """
    if further_objectives:
        require_compiled(finger)
    sweep = sweep_light_angle(
        finger.design, finger.paints, finger.renderer, angles_deg, repeats, seed, samples, None, progress, shape
    )
    rng = np.random.default_rng(seed)
    to_camera = np.array([_camera_of_draw(finger, calibrations, sweep.bands, rng) for _ in range(repeats)])
    basis = sweep.radiance_rel
    rgb = np.einsum("rcb,arpb->arc", to_camera, basis) / basis.shape[2]
    channels = rgb / rgb.mean(axis=(0, 1))
    others: tuple[AngleObjective, ...] = ()
    constraints: AngleConstraints | None = None
    if further_objectives:
        shapes = None if rest is None or shape is None else (rest, shape)
        others, constraints = angle_objectives(
            finger, to_camera[:REPEATS], sweep.angles_deg, seed, progress=progress, shapes=shapes
        )
    return LightAngleSweep(
        name=f"{finger.design.name}, light angle",
        objective=OBJECTIVE,
        label=sweep.label,
        angles_deg=sweep.angles_deg,
        values=channels.mean(axis=2),
        channels=channels,
        basis=basis,
        bands=BAND_NAMES,
        probe_points_mm=sweep.probe_points_mm,
        other_objectives=others,
        constraints=constraints,
        design=finger.design,
        paints=dict(paint_sha256),
        notes=(
            f"{SHAPE_NOTE}{'analytic press' if shape is None else shape.label}",
            f"camera response: {finger.response[0].source}",
            *finger.coverage_notes(sweep.bands),
        ),
    )


def _camera_of_draw(
    finger: PaintedFinger, calibrations: Mapping[str, PaintCalibration], mean: PaintBands, rng: np.random.Generator
) -> Floats:
    """Return the (channel, band) matrix for one draw of both paints."""
    drawn = {colour: _draw(finger.paints[colour], calibrations.get(colour), rng) for colour in ("red", "green")}
    bands = paint_bands(drawn["red"], drawn["green"], finger.design.light)
    gain = [bands.energy_conversion[c] / mean.energy_conversion[c] for c in ("red", "green")]
    return np.asarray(finger.camera_matrix(bands) * np.array([*gain, 1.0]))


def _draw(paint: PaintOptics, calibration: PaintCalibration | None, rng: np.random.Generator) -> PaintOptics:
    """Return the paint with the emission of one posterior draw (or as it is, without a calibration)."""
    if calibration is None:
        return paint
    emission = calibration.emission_draws_per_nm[rng.integers(len(calibration.emission_draws_per_nm))]
    return replace(paint, emission_per_nm=emission)
