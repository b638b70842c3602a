"""Sweep the angle of the blue light: the paper's brightness near the indenter, with paint uncertainty."""

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from data_schemas.fit import PaintCalibration
from data_schemas.simulate import LightAngleSweep
from finray_calib.spectra.skew_cauchy import SkewCauchy
from sim.experiments.painted_finger import PaintedFinger
from sim.optics.angle_sweep import Progress, sweep_light_angle
from sim.optics.paint_bands import BAND_NAMES, PaintBands, PaintOptics, paint_bands

Floats = NDArray[np.float64]
OBJECTIVE = (
    "brightness beside the indenter: camera R + G + B of the coating at probe points on both edges of the contact, "
    "seen along the pad's normal"
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
) -> LightAngleSweep:
    """Measure the objective at every angle, with one draw of both paints and one noise seed per repeat.

    The value of a repeat is ``sum_b w_b basis_b`` with band weights ``w = (sum of the rows of C) * gain``: the
    camera matrix C and the gain (yield of the draw over the mean yield) are those of the repeat's posterior
    draw, the same at every angle, so that a common scale cannot change the ranking.
    """
    sweep = sweep_light_angle(
        finger.design, finger.paints, finger.renderer, angles_deg, repeats, seed, samples, progress=progress
    )
    rng = np.random.default_rng(seed)
    weights = np.array([_band_weights(finger, calibrations, sweep.bands, rng) for _ in range(repeats)])
    basis = sweep.radiance_rel
    return LightAngleSweep(
        name=f"{finger.design.name}, light angle",
        objective=OBJECTIVE,
        label=sweep.label,
        angles_deg=sweep.angles_deg,
        values=np.einsum("rb,arpb->ar", weights, basis) / basis.shape[2],
        basis=basis,
        bands=BAND_NAMES,
        probe_points_mm=sweep.probe_points_mm,
        design=finger.design,
        paints=dict(paint_sha256),
        notes=(f"camera response: {finger.response[0].source}",),
    )


def _band_weights(
    finger: PaintedFinger, calibrations: Mapping[str, PaintCalibration], mean: PaintBands, rng: np.random.Generator
) -> Floats:
    """Return the weight of each band for one draw of both paints."""
    drawn = {colour: _draw(finger.paints[colour], calibrations.get(colour), rng) for colour in ("red", "green")}
    bands = paint_bands(drawn["red"], drawn["green"], finger.design.light)
    gain = [bands.energy_conversion[c] / mean.energy_conversion[c] for c in ("red", "green")]
    return finger.camera_matrix(bands).sum(axis=0) * np.array([*gain, 1.0])


def _draw(paint: PaintOptics, calibration: PaintCalibration | None, rng: np.random.Generator) -> PaintOptics:
    """Return the paint with the emission of one posterior draw (or as it is, without a calibration)."""
    if calibration is None:
        return paint
    mode_nm, ln_fwhm_nm, kappa, ln_peak_per_nm = calibration.draws[rng.integers(len(calibration.draws))][:4]
    emission = SkewCauchy.from_mode(mode_nm, ln_fwhm_nm, kappa, ln_peak_per_nm)(paint.wavelength_nm)
    return PaintOptics(paint.name, paint.wavelength_nm, emission, paint.reflectance)
