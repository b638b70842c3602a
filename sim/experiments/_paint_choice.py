"""Which paints a finger should carry: the error of the sensed normal for each pair, before anything is moulded.

Light is traced once for all paints. What facets of the coat send to the camera is kept chain by chain of fluorescence,
so that conversions, emission spectra and the camera are a matrix product; the reflectance of the walls, which light
meets on its way, is followed to second order from nine scenes.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import permutations
from types import ModuleType
from typing import Final

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from data_schemas import CameraCalibration, FingerDesign, PaintCalibration, SimulateError
from sim.experiments._light_angle import (
    POINTS_ACROSS,
    POINTS_ALONG,
    RAYS,
    REPEATS,
    colour_separations_deg,
    exposed_table,
    facet_shares,
    facet_slopes,
    held_out_errors_deg,
)
from sim.experiments._optics_products import tactile_sensor
from sim.experiments._painted_finger import RESPONSE_NM, CameraResponse, coverage_notes, paint_optics
from sim.optics import (
    BAND_NAMES,
    SCALAR_VARIANT,
    PaintBands,
    PaintOptics,
    ProbePaths,
    Progress,
    band_mean,
    chain_matrix,
    emission_band,
    facet_chains,
    paint_bands,
    seen_points,
    tilted_facets,
)
from sim.surface_meshes import pressed_shape, rest_shape

Floats = NDArray[np.float64]
Pair = tuple[str, str]

#: Draws of every paint. The 95 % limits of a difference are then known to a tenth of their width.
DRAWS: Final = 100
#: Rays per point and repeat: a quarter of a sweep's, which makes all errors alike some 5 % larger.
PAIR_RAYS: Final = RAYS // 4
_WALLS: Final = ("red", "green")
_LED: Final = BAND_NAMES.index("led")


@dataclass(frozen=True, slots=True)
class PaintDraws:
    """A paint and how sure its emission is.

    Attributes
    ----------
    optics
        Mean of the posterior.
    emission_per_nm
        Draws of its emission, (draw, wavelength).
    excited_at_nm
        Light that its emission was measured under; None where it is the finger's own.
    """

    optics: PaintOptics
    emission_per_nm: Floats
    excited_at_nm: float | None = None

    @classmethod
    def of(cls, calibration: PaintCalibration) -> "PaintDraws":
        """Return the draws of a calibrated paint."""
        emission = np.maximum(calibration.emission_draws_per_nm, 0.0)
        return cls(paint_optics(calibration), emission, calibration.reradiation.laser_nm)


@dataclass(frozen=True, slots=True)
class PaintedPairs:
    """What each pair of paints makes of a finger.

    Attributes
    ----------
    pairs
        Names of the paints on the red and on the green wall.
    normal_error_deg
        Error of the sensed normal, mean over the pad, (pair, draw); draws belong to each other.
    separation_deg
        Angle between the colours of facets that tilt to opposite sides, median over the pad, (pair, draw).
    exposure_rel
        Exposure time relative to the shortest, (pair,).
    notes
        What the numbers rest on.
    """

    pairs: tuple[Pair, ...]
    normal_error_deg: Floats
    separation_deg: Floats
    exposure_rel: Floats
    notes: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class UnpaintedFinger:
    """A finger without paints.

    Attributes
    ----------
    design
        Geometry, light and camera.
    response
        Tactile camera: red, green and blue curve.
    renderer
        A compiled variant, opened by :func:`sim.optics.open_renderer`.
    calibration
        Geometry of the camera; an ideal pinhole without it.
    """

    design: FingerDesign
    response: CameraResponse
    renderer: ModuleType
    calibration: CameraCalibration | None = None


@dataclass(frozen=True, slots=True)
class PairPaths:
    """Light of the facets for walls of any reflectance, by one set of paths.

    Attributes
    ----------
    chains
        Names of the chains of fluorescence.
    radiance_rel
        At the reflectances in the middle, for conversions of 1, (repeat, facet, point, chain).
    ends
        ``radiance_rel`` at the lowest and at the highest reflectance of a wall in the LED's band, or in the bands of
        the paints, over that in the middle: (wall, 2, 2, repeat, facet, point, chain).
    middle, half_range
        Reflectance of each wall in each band, (wall, band).
    places_mm
        (x, z) of the points.
    """

    chains: tuple[str, ...]
    radiance_rel: Floats
    ends: Floats
    middle: Floats
    half_range: Floats
    places_mm: Floats

    def of(self, bands: PaintBands) -> Floats:
        """Return the light of the facets, (repeat, facet, point, chain), of walls with these reflectances."""
        distance = np.array([bands.reflectance[wall] for wall in _WALLS]) - self.middle
        moved = np.divide(distance, self.half_range, out=np.zeros_like(distance), where=self.half_range > 0.0)
        last = np.array([BAND_NAMES.index(chain.rsplit(">", 1)[-1]) for chain in self.chains])
        light = self.radiance_rel
        for k in range(len(_WALLS)):
            light = light * _between(self.ends[k, 0], moved[k, _LED])
            light = light * _between(self.ends[k, 1], np.where(last == _LED, 0.0, moved[k, last]))
        return light


def _between(ends: Floats, place: Floats) -> Floats:
    """Return the parabola through 1 at 0 and the ends at -1 and 1: light that meets a wall at most twice follows it.

    Light grows with reflectance, so that it never leaves the ends, as a parabola through a higher power may.
    """
    low, high = ends
    parabola = 1.0 + place * (high - low) / 2.0 + place**2 * ((high + low) / 2.0 - 1.0)
    return np.asarray(np.clip(parabola, np.minimum(ends.min(axis=0), 1.0), np.maximum(ends.max(axis=0), 1.0)))


def paint_pairs(
    finger: UnpaintedFinger,
    paints: Mapping[str, PaintDraws],
    seed: int,
    draws: int = DRAWS,
    paths: ProbePaths | None = None,
    progress: Progress | None = None,
) -> PaintedPairs:
    """Measure how well the finger would sense normals with each ordered pair of paints.

    Every pair sees the same paths, the same noise of the camera and the same draws of a paint, so that differences are
    surer than values. Draw d takes repeat d modulo the repeats of the paths.

    Parameters
    ----------
    finger
        Design, camera and renderer.
    paints
        At least two, by name.
    seed
        Of paths, draws and noise.
    draws
        Of each paint.
    paths
        Directions per point, and repeats.
    progress
        Called after each scene and each pair.

    Raises
    ------
    SimulateError
        With fewer than two paints, with a scalar renderer, when a paint emits nothing above the LED, or when the
        camera sees too little of the pad.
    """
    _check(finger, paints)
    sensor = tactile_sensor(finger.design, seed)
    paths = paths or ProbePaths(PAIR_RAYS, REPEATS, seed)
    light = finger.design.light
    pairs = tuple(permutations(paints, 2))
    bands = [paint_bands(paints[red].optics, paints[green].optics, light) for red, green in pairs]
    steps = Steps(progress, 4 * len(_WALLS) + 1 + len(pairs))
    traced = trace_pairs(finger, bands, paths, steps)
    drawn = {
        name: PaintEmission.drawn(paint, finger, draws, np.random.default_rng([seed, k]))
        for k, (name, paint) in enumerate(paints.items())
    }
    rgb = np.empty((len(pairs), draws, len(traced.places_mm), len(facet_slopes()), 3))
    led = camera_column(finger, bands[0], _LED)
    for k, (pair, of_pair) in enumerate(zip(pairs, bands, strict=True)):
        rgb[k] = _camera_radiance(traced, of_pair, [drawn[name] for name in pair], led)
    table = exposed_table(
        rgb, traced.places_mm, facet_shares(rest_shape(finger.design), pressed_shape(finger.design)), sensor
    )
    errors_deg = np.empty((len(pairs), draws))
    with threadpool_limits(limits=1, user_api="blas"):  # matrices of some hundred rows: threads cost more than they do
        for k, (red, green) in enumerate(pairs):
            one = replace(table, signal_e=table.signal_e[k : k + 1])
            errors_deg[k] = held_out_errors_deg(one, sensor, seed)[0].mean(axis=-1)
            steps.done(f"{red} and {green}")
    separation = np.median(colour_separations_deg(table), axis=2)
    return PaintedPairs(pairs, errors_deg, separation, table.exposure_rel, _notes(finger, paints, bands))


def trace_pairs(
    finger: UnpaintedFinger, bands: Sequence[PaintBands], paths: ProbePaths, steps: "Steps | None" = None
) -> PairPaths:
    """Trace the facets for all pairs: in the middle of their reflectances, and with one group of them at either end.

    Parameters
    ----------
    finger
        Design, camera and renderer.
    bands
        Of every pair.
    paths
        Directions per point, and repeats.
    steps
        Told after each scene.
    """
    rest = rest_shape(finger.design)
    points = seen_points(finger.design, rest, finger.renderer, POINTS_ACROSS, POINTS_ALONG, finger.calibration)
    facets = tilted_facets(points.normals, facet_slopes())
    reflectance = np.array([[one.reflectance[wall] for wall in _WALLS] for one in bands])
    low, high = reflectance.min(axis=0), reflectance.max(axis=0)
    middle, half_range = (low + high) / 2.0, (high - low) / 2.0

    def traced(of_walls: Floats) -> tuple[tuple[str, ...], Floats]:
        scene = replace(bands[0], reflectance=dict(zip(_WALLS, of_walls, strict=True)))
        found = facet_chains(finger.design, rest, scene, finger.renderer, points.probes, facets, paths)
        if steps is not None:
            steps.done("paths of all pairs")
        return found.chains, found.radiance_rel

    chains, base = traced(middle)
    ends = np.ones((len(_WALLS), 2, 2, *base.shape))
    for wall, group, end in np.ndindex(ends.shape[:3]):
        of_bands = [k for k in range(len(BAND_NAMES)) if (k == _LED) == (group == 0)]
        moved = middle.copy()
        moved[wall, of_bands] = (low, high)[end][wall, of_bands]
        # facets that get no light of a chain get none with brighter walls either
        np.divide(traced(moved)[1], base, out=ends[wall, group, end], where=base > 0.0)
    return PairPaths(chains, base, ends, middle, half_range, points.places_mm)


@dataclass(frozen=True, slots=True)
class PaintEmission:
    """Draws of what the camera sees of a paint: its band in each channel (draw, 3), and its yield over the mean's."""

    camera: Floats
    gain: Floats

    @classmethod
    def drawn(cls, paint: PaintDraws, finger: UnpaintedFinger, draws: int, rng: np.random.Generator) -> "PaintEmission":
        light = finger.design.light
        _, mean, _ = emission_band(paint.optics, light)
        count = len(paint.emission_per_nm)
        chosen = rng.permutation(count)[:draws] if count >= draws else rng.integers(count, size=draws)
        camera, gain = np.empty((draws, 3)), np.empty(draws)
        for d, number in enumerate(chosen):
            band, conversion, _ = emission_band(
                replace(paint.optics, emission_per_nm=paint.emission_per_nm[number]), light
            )
            gain[d] = conversion / mean
            camera[d] = [
                band_mean(RESPONSE_NM, curve(RESPONSE_NM), band, f"camera response {name}")
                for name, curve in zip("RGB", finger.response, strict=True)
            ]
        return cls(camera, gain)


def camera_column(finger: UnpaintedFinger, bands: PaintBands, band: int) -> Floats:
    """Return what the camera's channels make of a band, (3,)."""
    return np.array(
        [
            band_mean(RESPONSE_NM, curve(RESPONSE_NM), bands.bands[band], f"camera response {name}")
            for name, curve in zip("RGB", finger.response, strict=True)
        ]
    )


def _camera_radiance(traced: PairPaths, bands: PaintBands, drawn: Sequence[PaintEmission], led: Floats) -> Floats:
    """Return the camera's signals of a pair, (draw, point, facet, 3)."""
    return camera_radiance(traced.chains, traced.of(bands), bands, drawn, led)


def camera_radiance(
    chains: Sequence[str], light: Floats, bands: PaintBands, drawn: Sequence[PaintEmission], led: Floats
) -> Floats:
    """Return the camera's signals of a pair of paints, (draw, point, facet, 3).

    Parameters
    ----------
    chains, light
        Of the facets, for conversions of 1: (repeat, facet, point, chain). Draw d takes repeat d modulo the repeats.
    bands
        Conversions of the pair.
    drawn
        Draws of the red and of the green paint.
    led
        What the camera makes of the LED's band, (3,).
    """
    of_draws = []
    for d in range(len(drawn[0].gain)):
        gains = {
            (band, wall): bands.conversion[wall][k] * emission.gain[d]
            for wall, emission in zip(_WALLS, drawn, strict=True)
            for k, band in enumerate(BAND_NAMES)
        }
        to_camera = np.column_stack([*(emission.camera[d] for emission in drawn), led])
        of_chains = to_camera @ chain_matrix(chains, gains)
        of_draws.append(np.einsum("kc,fpc->pfk", of_chains, light[d % len(light)]))
    return np.array(of_draws)


def _notes(finger: UnpaintedFinger, paints: Mapping[str, PaintDraws], bands: Sequence[PaintBands]) -> tuple[str, ...]:
    """Say what the numbers rest on."""
    light = finger.design.light
    elsewhere = [
        f"{name}: its emission was measured under {paint.excited_at_nm:.0f} nm and is assumed to be the same under "
        f"the LED's "
        f"{light.peak_wavelength_nm:.0f} nm"
        for name, paint in paints.items()
        if paint.excited_at_nm is not None and abs(paint.excited_at_nm - light.peak_wavelength_nm) > light.fwhm_nm / 2.0
    ]
    coverage = dict.fromkeys(note for one in bands for note in coverage_notes(finger.response, one))
    return (
        f"light angle {light.angle_deg:g} deg, as in the design; a different pair may have a different best angle",
        f"camera response: {finger.response[0].source}",
        "the coat's reflectance is taken at the middle of the first pair's bands, which is wrong by 1 % for exchanged "
        "paints",
        *elsewhere,
        *coverage,
    )


class Steps:
    """Tell how many steps of a known number are done."""

    def __init__(self, progress: Progress | None, total: int) -> None:
        self.progress, self.total, self.count = progress, total, 0

    def done(self, what: str) -> None:
        self.count += 1
        if self.progress is not None:
            self.progress(self.count, self.total, what)


def _check(finger: UnpaintedFinger, paints: Mapping[str, PaintDraws]) -> None:
    """Refuse what cannot be compared."""
    if len(paints) < 2:
        raise SimulateError(
            f"a comparison of paints needs at least two paints, got {len(paints)}; give --paint FILE at least twice"
        )
    if finger.renderer.variant() == SCALAR_VARIANT:
        raise SimulateError(
            "comparing paints needs a compiled variant of Mitsuba, because paths are traced once for all paints; leave "
            "out --engine scalar, and make sure that LLVM is installed"
        )
