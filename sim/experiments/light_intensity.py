"""The paper's brightness beside the indenter over the angle of the blue light, with the mirror and without."""

from collections.abc import Mapping
from itertools import product

import numpy as np
from numpy.typing import NDArray

from data_schemas.design import FingerDesign
from data_schemas.errors import SimulateError
from data_schemas.illumination import BrightestAngle, LightAngleIntensity
from sim.experiments.painted_finger import PaintedFinger
from sim.optics.angle_sweep import sweep_light_angle
from sim.optics.paint_bands import BAND_NAMES
from sim.optics.refracted_light import panel_frame, trace_crossing
from sim.optics.render import Progress
from sim.surface_meshes.pressed_pad import contact_half_width_mm

Floats = NDArray[np.float64]

ANGLES_DEG: Floats = np.arange(0.0, 121.0, 15.0)
ANGLES_DEG.flags.writeable = False
PRINTED_ANGLE_DEG = 30.0
OTHER_DEPTHS_MM = (4.0, 10.0, 20.0)
MIRRORS = ("with mirror", "without mirror")
PROBES = ("edge of the contact towards the base", "edge of the contact towards the tip")

_BOOTSTRAPS = 1000
# a parabola describes a cosine to 1 % within 30 deg of its top
_AROUND_TOP_DEG = 30.0
# the maximum may lie between angles of the sweep
_FINE_STEP_DEG = 0.5
_LIMITS = (2.5, 97.5)


def study_light_angle(
    finger: PaintedFinger,
    seed: int,
    samples: int,
    paints: Mapping[str, str],
    progress: Progress | None = None,
    repeats: int = 5,
) -> LightAngleIntensity:
    """Measure the brightness of the coat at both edges of the contact over the light angle, with and without mirror.

    Parameters
    ----------
    finger
        Design, paints, camera response and renderer; its own light angle is replaced.
    seed, samples
        Random seed and paths per probe, angle and repeat.
    paints
        Colour -> where the paint's optics come from.
    progress
        Called after each angle.
    repeats
        Independent repeats; within one, all angles share their random numbers.

    Raises
    ------
    SimulateError
        With fewer than two repeats, which leave nothing to draw from.
    """
    if repeats < 2:
        raise SimulateError(f"limits of a maximum need at least 2 independent repeats, got {repeats}")
    design = finger.design
    points = edge_points_mm(design)
    bare = design.model_copy(update={"mirror": design.mirror.model_copy(update={"reflectance": 0.0})})
    total, sweeps = len(MIRRORS) * len(ANGLES_DEG), []
    for number, one in enumerate((design, bare)):

        def told(
            done: int, _: int, what: str, first: int = number * len(ANGLES_DEG), case: str = MIRRORS[number]
        ) -> None:
            if progress is not None:
                progress(first + done, total, f"{case}, {what}")

        sweeps.append(
            sweep_light_angle(one, finger.paints, finger.renderer, ANGLES_DEG, repeats, seed, samples, points, told)
        )
    radiance = np.stack([sweep.radiance_rel for sweep in sweeps])
    probes = sweeps[0].probe_points_mm
    depths = {f"{mm:g}": tuple(elevation_deg(_at_depth(design, mm), probes).tolist()) for mm in OTHER_DEPTHS_MM}
    return LightAngleIntensity(
        name=f"{design.name}, light angle",
        label=sweeps[0].label,
        design=design,
        paints=dict(paints),
        samples=samples,
        notes=finger.coverage_notes(sweeps[0].bands),
        mirrors=MIRRORS,
        probes=PROBES,
        bands=BAND_NAMES,
        probe_points_mm=probes,
        led_depth_mm=-design.light.position_mm[1],
        angles_deg=ANGLES_DEG,
        radiance_rel=radiance,
        elevation_deg=elevation_deg(design, probes),
        elevation_by_depth_deg=depths,
        printed_angle_deg=PRINTED_ANGLE_DEG,
        maxima=_maxima(radiance, np.random.default_rng(seed)),
    )


def edge_points_mm(design: FingerDesign) -> Floats:
    """Return the points (x, z) on the pad's middle line where the contact ends, towards the base and the tip."""
    half_width = float(contact_half_width_mm(design))
    z = design.indenter.position_mm + np.array([-half_width, half_width])
    return np.column_stack([np.zeros(2), z])


def elevation_deg(design: FingerDesign, points_mm: Floats) -> Floats:
    """Return the angle above the pad plane at which light leaves the panel's centre to reach points in the gel.

    A small panel whose normal has the angle a lights a point directly by cos(a - elevation), at most zero beyond
    90 deg. Valid for the undeformed flat inner face.
    """
    frame = panel_frame(design.light)
    index = design.pad.index_at(design.light.peak_wavelength_nm)
    leaves = trace_crossing(points_mm, frame.centre_mm, frame.normal, index).crossing_mm - frame.centre_mm
    return np.degrees(np.arctan2(leaves[:, 1], leaves[:, 2]))


def brightest_deg(angles_deg: Floats, values: Floats) -> float:
    """Return where a curve is highest: the top of a parabola through its values within 30 deg of the largest one."""
    near = np.abs(angles_deg - angles_deg[np.argmax(values)]) <= _AROUND_TOP_DEG
    fine = np.arange(angles_deg[near][0], angles_deg[near][-1] + _FINE_STEP_DEG / 2.0, _FINE_STEP_DEG)
    parabola = np.polynomial.Polynomial.fit(angles_deg[near], values[near], 2)
    return float(fine[np.argmax(parabola(fine))])


def _at_depth(design: FingerDesign, depth_mm: float) -> FingerDesign:
    """Return the design with its panel at another depth below the inner face."""
    x, _, z = design.light.position_mm
    return design.model_copy(update={"light": design.light.model_copy(update={"position_mm": (x, -depth_mm, z)})})


def _maxima(radiance: Floats, rng: np.random.Generator) -> tuple[BrightestAngle, ...]:
    """Return the brightest angle of each curve of (mirror, angle, repeat, probe, band), with bootstrap limits."""
    drawn = rng.integers(radiance.shape[2], size=(_BOOTSTRAPS, radiance.shape[2]))
    found = []
    for (m, mirror), (p, probe), (b, band) in product(enumerate(MIRRORS), enumerate(PROBES), enumerate(BAND_NAMES)):
        curves = radiance[m, :, :, p, b]
        mean = curves.mean(axis=1)
        best, loss = _top(mean)
        tops = np.array([_top(curves[:, repeats].mean(axis=1)) for repeats in drawn])
        (low, high), (least, most) = np.percentile(tops, _LIMITS, axis=0).T
        found.append(
            BrightestAngle(
                mirror=mirror,
                probe=probe,
                band=band,
                angle_deg=best,
                low95_deg=float(low),
                high95_deg=float(high),
                loss_at_printed_rel=loss,
                loss_at_printed_low95_rel=float(least),
                loss_at_printed_high95_rel=float(most),
                past_90_rel=float(mean[-1] / np.interp(90.0, ANGLES_DEG, mean)),
            )
        )
    return tuple(found)


def _top(values: Floats) -> tuple[float, float]:
    """Return the brightest angle of a curve and what the printed one loses, relative to the highest value."""
    loss = 1.0 - float(np.interp(PRINTED_ANGLE_DEG, ANGLES_DEG, values)) / float(values.max())
    return brightest_deg(ANGLES_DEG, values), loss
