"""The paper's brightness beside the indenter over the angle of the blue light, with the mirror and without."""

from collections.abc import Mapping
from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t as student_t

from data_schemas.design import FingerDesign
from data_schemas.errors import SimulateError
from data_schemas.illumination import BrightestAngle, LightAngleIntensity
from sim.experiments.painted_finger import PaintedFinger
from sim.optics.angle_sweep import sweep_light_angle
from sim.optics.curved_refraction import refract_through
from sim.optics.gel_face import inner_face
from sim.optics.paint_bands import BAND_NAMES
from sim.optics.panel_frame import panel_frame
from sim.optics.render import Progress
from sim.surface_meshes.finger_shape import rest_shape
from sim.surface_meshes.pressed_pad import contact_half_width_mm

Floats = NDArray[np.float64]

# from a panel that faces away from the pad to one that faces the base: with the mirror curves are still high at 0
ANGLES_DEG: Floats = np.arange(-30.0, 121.0, 15.0)
ANGLES_DEG.flags.writeable = False
PRINTED_ANGLE_DEG = 30.0
OTHER_DEPTHS_MM = (4.0, 10.0, 20.0)
MIRRORS = ("with mirror", "without mirror")
PROBES = ("edge of the contact towards the base", "edge of the contact towards the tip")

# the light of one small Lambertian panel is a cosine cut off at zero, and the study adds up many of these
_HARMONICS = 2
_FINE_STEP_DEG = 0.1
_CONFIDENCE = 0.95
# a curve that leaves the sum of cosines by more, relative to its top, is no such sum: say so
_LARGEST_MISFIT_REL = 0.03


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
        Random seed and paths per probe and repeat, shared by all angles.
    paints
        Colour -> where the paint's optics come from.
    progress
        Called after each repeat.
    repeats
        Independent repeats; within one, all angles share their random numbers. Limits are Student's, of repeats - 1
        degrees of freedom.

    Raises
    ------
    SimulateError
        With fewer than two repeats, which have no spread.
    """
    if repeats < 2:
        raise SimulateError(f"limits of a maximum need at least 2 independent repeats, got {repeats}")
    design = finger.design
    points = edge_points_mm(design)
    bare = design.model_copy(update={"mirror": design.mirror.model_copy(update={"reflectance": 0.0})})
    sweeps = []
    for number, one in enumerate((design, bare)):

        def told(done: int, of: int, what: str, before: int = number, case: str = MIRRORS[number]) -> None:
            if progress is not None:
                progress(before * of + done, len(MIRRORS) * of, f"{case}, {what}")

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
        notes=(*finger.coverage_notes(sweeps[0].bands), *doubts(radiance)),
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
        maxima=_maxima(radiance),
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
    pad, face = design.pad, inner_face(design, rest_shape(design))
    x, y, z = (np.ascontiguousarray(v) for v in points_mm.T)
    centre = tuple(np.full(x.shape, v) for v in panel_frame(design.light).centre_mm)
    foot = x / pad.width_mm + 0.5, z / pad.length_mm
    path = refract_through(face.map.evaluate, (x, y, z), foot, (centre[0], centre[1], centre[2]), face)
    return np.asarray(np.degrees(np.arctan2(-path.to_panel[1], -path.to_panel[2])))


def brightest_deg(angles_deg: Floats, values: Floats) -> float:
    r"""Return where the smooth curve through values, a0 + sum of a_k cos k x + b_k sin k x for k = 1, 2, is highest.

    Only angles between the first and the last one are searched.
    """
    fine = _fine_deg(angles_deg)
    return float(fine[np.argmax(_cosines(fine) @ _smooth(angles_deg, values))])


def top_and_loss(angles_deg: Floats, curves: Floats) -> tuple[Floats, Floats, Floats]:
    """Return estimate and 95 % limits of (brightest angle in deg, loss at the printed angle), (2,) each.

    Both are read off the smooth curve through the mean of all repeats, never off single angles, whose noise would
    choose the largest. Limits by the jackknife over repeats with Student's t; the loss is never negative, and zero is
    within its limits where the printed angle is within those of the brightest one.

    Parameters
    ----------
    angles_deg
        Light angles, (n,).
    curves
        Values of independent repeats, (n, repeat), at least two.
    """
    count = curves.shape[1]
    whole = _read(angles_deg, curves.mean(axis=1))
    others = (curves.sum(axis=1, keepdims=True) - curves) / (count - 1)
    left_out = np.array([_read(angles_deg, one) for one in others.T])
    error = np.sqrt((count - 1) / count * ((left_out - left_out.mean(axis=0)) ** 2).sum(axis=0))
    reach = error * student_t.ppf(0.5 + _CONFIDENCE / 2.0, count - 1)
    low, high = whole - reach, whole + reach
    low[0], high[0] = np.clip([low[0], high[0]], angles_deg[0], angles_deg[-1])
    low[1] = 0.0 if low[0] <= PRINTED_ANGLE_DEG <= high[0] else max(low[1], 0.0)
    return whole, low, high


def _read(angles_deg: Floats, values: Floats) -> Floats:
    """Return (brightest angle, loss at the printed one) of a curve."""
    weights, fine = _smooth(angles_deg, values), _fine_deg(angles_deg)
    curve = _cosines(fine) @ weights
    at_printed = float((_cosines(np.array([PRINTED_ANGLE_DEG])) @ weights)[0])
    return np.array([fine[np.argmax(curve)], 1.0 - at_printed / curve.max()])


def _fine_deg(angles_deg: Floats) -> Floats:
    """Return angles between the first and the last one."""
    return np.arange(angles_deg[0], angles_deg[-1] + _FINE_STEP_DEG / 2.0, _FINE_STEP_DEG)


def _cosines(angles_deg: Floats) -> Floats:
    """Return the functions that smooth curves are sums of, (angle, 5)."""
    x = np.radians(angles_deg)
    waves = [wave(k * x) for k in range(1, _HARMONICS + 1) for wave in (np.cos, np.sin)]
    return np.column_stack([np.ones_like(x), *waves])


def _smooth(angles_deg: Floats, values: Floats) -> Floats:
    """Return the weights of the smooth curve through values, (5,): least squares, bright values counting more.

    Where the panel turns its back the curve has a kink, which no sum of few cosines has; it is dark there.
    """
    bright = np.maximum(values, 0.0) / values.max()
    return np.asarray(np.linalg.lstsq(_cosines(angles_deg) * bright[:, None], values * bright)[0])


def _at_depth(design: FingerDesign, depth_mm: float) -> FingerDesign:
    """Return the design with its panel at another depth below the inner face."""
    x, _, z = design.light.position_mm
    return design.model_copy(update={"light": design.light.model_copy(update={"position_mm": (x, -depth_mm, z)})})


def _cases() -> list[tuple[tuple[int, str], tuple[int, str], tuple[int, str]]]:
    """Return numbers and names of mirror, probe and band of each curve."""
    return list(product(enumerate(MIRRORS), enumerate(PROBES), enumerate(BAND_NAMES)))


def _maxima(radiance: Floats) -> tuple[BrightestAngle, ...]:
    """Return the brightest angle of each curve of (mirror, angle, repeat, probe, band), with its limits."""
    found = []
    for (m, mirror), (p, probe), (b, band) in _cases():
        curves = radiance[m, :, :, p, b]
        (best, loss), (low, least), (high, most) = top_and_loss(ANGLES_DEG, curves)
        mean = curves.mean(axis=1)
        found.append(
            BrightestAngle(
                mirror=mirror,
                probe=probe,
                band=band,
                angle_deg=float(best),
                low95_deg=float(low),
                high95_deg=float(high),
                loss_at_printed_rel=float(loss),
                loss_at_printed_low95_rel=float(least),
                loss_at_printed_high95_rel=float(most),
                past_90_rel=float(mean[-1] / np.interp(90.0, ANGLES_DEG, mean)),
            )
        )
    return tuple(found)


def doubts(radiance: Floats) -> tuple[str, ...]:
    """Say where the search ended at a limit, and which curves are no sums of cosines."""
    notes = []
    for (m, mirror), (p, probe), (b, band) in _cases():
        mean, name = radiance[m, :, :, p, b].mean(axis=1), f"{mirror}, {probe}, {band}"
        best = brightest_deg(ANGLES_DEG, mean)
        if best in (ANGLES_DEG[0], ANGLES_DEG[-1]):
            notes.append(f"{name}: highest at {best:g} deg, where the search ended, or beyond; its limits do not hold")
        misfit = (mean - _cosines(ANGLES_DEG) @ _smooth(ANGLES_DEG, mean)) * mean / mean.max()
        misfit_rel = float(np.sqrt(np.mean(misfit**2)) / mean.max())
        if misfit_rel > _LARGEST_MISFIT_REL:
            notes.append(f"{name}: values lie {misfit_rel:.0%} off the smooth curve that its maximum is read off")
    return tuple(notes)
