"""Sweep the light angle and measure the radiance of the coated face at probe points instead of rendering pictures.

In compiled variants probes are measured for many angles of a light together, with the coat as it is or as tilted
facets; a scalar variant bakes and traces each angle by itself.
"""

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from types import ModuleType
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from data_schemas import FingerDesign, SimulateError
from sim.optics._paint_bands import PaintBands, PaintOptics, chain_matrix
from sim.optics._painted_walls import BAKE_SAMPLES, WALLS, WallExchange, bake_walls, direct_lights
from sim.optics._probes import Facets, ProbePaths, Probes, default_probe_points_mm, probes_on, radiance_meter
from sim.optics._render import Progress, check_paints, lit_integrator, open_scene, stream_seed
from sim.optics._renderer import SCALAR_VARIANT
from sim.optics._scene import LoadedScene, check_outside_the_gel
from sim.surface_meshes import FingerShape, pressed_shape

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class AngleSweep:
    """Band radiances at probe points for each light angle.

    ``radiance_rel`` is (angle, repeat, probe, 3 bands), in units of the panel's radiance. Within a repeat all
    angles use the same random numbers; repeats are independent. ``probe_points_mm`` is (probe, 3): x, y, z on the
    coated face.
    """

    angles_deg: NDArray[np.float64]
    radiance_rel: NDArray[np.float64]
    probe_points_mm: NDArray[np.float64]
    bands: PaintBands
    samples: int
    seed: int
    duration_s: float
    variant: str
    label: str


def sweep_light_angle(
    design: FingerDesign,
    paints: Mapping[str, PaintOptics],
    renderer: ModuleType,
    angles_deg: Sequence[float] | NDArray[np.float64],
    paths: ProbePaths | None = None,
    probe_points_mm: NDArray[np.float64] | None = None,
    progress: Progress | None = None,
    shape: FingerShape | None = None,
) -> AngleSweep:
    """Measure the coated face's radiance at probe points for each light angle.

    The radiance is that towards the inner face, from the same place of the undeformed pad (along the pad's normal where
    it is not deformed), seen from inside the gel, at level b (level a
    knows no angle and cannot drive the decision). In compiled variants one set of paths serves all angles
    (:mod:`sim.optics._angle_paths`); light that the panel itself reflects (5 %) is left out: about 0.1 % of the LED
    band at most in the default finger. A scalar variant bakes and traces each angle by itself.

    Parameters
    ----------
    design
        The finger with its press; its own light angle is replaced.
    paints
        Optics of the paints "red" and "green".
    renderer
        From :func:`sim.optics.open_renderer`. A scalar variant works too, with much more noise.
    angles_deg
        Light angles: the panel's normal from the pad plane.
    paths
        Paths per probe and repeat, shared by all angles (in a scalar variant, per angle).
    probe_points_mm
        Points (x, z) on the undeformed pad, shape (probe, 2); by default
        :func:`sim.optics._probes.default_probe_points_mm`.
    progress
        Called after each repeat (in a scalar variant, after each angle).
    shape
        The finger with contact; by default the design's indenter is pressed in analytically.

    Raises
    ------
    SimulateError
        When there is nothing to sweep, a probe lies outside the pad, or a paint is missing or gains energy.
    """
    start, paths = time.monotonic(), paths or ProbePaths()
    angles = np.asarray(angles_deg, dtype=np.float64)
    if angles.ndim != 1 or angles.size == 0 or paths.repeats < 1 or paths.samples < 1:
        raise SimulateError(
            "a sweep needs a list of angles in deg, at least one repeat and at least one sample, got angles of shape "
            f"{angles.shape}, {paths.repeats} repeats and {paths.samples} samples"
        )
    shape = shape or pressed_shape(design)
    probes = probes_on(
        design, shape, default_probe_points_mm(design, shape) if probe_points_mm is None else probe_points_mm
    )
    bands = check_paints(design, paints)
    radiance = np.empty((angles.size, paths.repeats, len(probes.points_mm), 3))
    designs = [with_light_angle(design, float(angle)) for angle in angles]
    variant = renderer.variant()
    if variant == SCALAR_VARIANT:
        for i, finger in enumerate(designs):
            radiance[i] = _measure_by_meters(finger, shape, bands, renderer, probes, paths)
            if progress is not None:
                progress(i + 1, angles.size, f"light angle {angles[i]:g} deg")
    else:
        of_facets = measure_together(designs, shape, bands, renderer, probes, None, paths, progress)
        radiance = of_facets[:, :, 0]
    duration_s = time.monotonic() - start
    label = f"rendered probes, level b, {variant}"
    return AngleSweep(angles, radiance, probes.points_mm, bands, paths.samples, paths.seed, duration_s, variant, label)


def _measure_by_meters(
    design: FingerDesign,
    shape: FingerShape,
    bands: PaintBands,
    renderer: ModuleType,
    probes: Probes,
    paths: ProbePaths,
) -> Floats:
    """Return the band radiance (repeat, probe, 3) for one light angle in a scalar variant."""
    scene = open_scene(design, shape, bands, renderer, sensor=radiance_meter(renderer, probes, 0))
    bake_samples = max(1, round(BAKE_SAMPLES[True] * BAKE_SHARE))
    values = []
    finger = LoadedScene(scene, design, shape, bands, renderer)
    for repeat, light in enumerate(bake_walls(finger, "b", paths.seed, bake_samples, paths.repeats)):
        integrator, chains = lit_integrator(scene, design, shape, renderer, light)
        of_chains = _read_meters(scene, integrator, renderer, probes, paths.samples, stream_seed(paths.seed, repeat))
        values.append(of_chains @ chain_matrix(chains).T)
    return np.stack(values)


def _read_meters(scene: Any, integrator: Any, renderer: ModuleType, probes: Probes, samples: int, seed: int) -> Floats:
    """Return the radiance (probe, band) of one-pixel radiance meters, by Mitsuba's own path tracer."""
    images = [
        renderer.render(
            scene,
            sensor=renderer.load_dict(radiance_meter(renderer, probes, k)),
            integrator=integrator,
            spp=samples,
            seed=stream_seed(seed, k),
        )
        for k in range(len(probes.points_mm))
    ]
    return np.array([np.array(image, dtype=np.float64).reshape(3) for image in images])


BAKE_SHARE: Final = 0.2
"""Of a picture's bake: each repeat bakes its own walls, so that the repeats show its noise; together they sample it."""

# poses are loops of one compiled kernel, and bits of one number of 32
_POSES_AT_ONCE = 16


def with_light_angle(design: FingerDesign, angle_deg: float) -> FingerDesign:
    """Return the design with another light angle, checked by the record's own bounds."""
    light = type(design.light).model_validate({**design.light.model_dump(), "angle_deg": angle_deg})
    return design.model_copy(update={"light": light})


def measure_together(
    designs: Sequence[FingerDesign],
    shape: FingerShape,
    bands: PaintBands,
    renderer: ModuleType,
    probes: Probes,
    facets: Facets | None,
    paths: ProbePaths,
    progress: Progress | None,
) -> Floats:
    """Return the band radiance (angle, repeat, facet, probe, 3) of all angles, whose paths are the same.

    Parameters
    ----------
    designs
        One finger that differs in the pose of its first light only.
    shape, bands, renderer, probes
        Its surfaces, what is measured where, and a compiled renderer.
    facets
        Tilts of the coat at the probes, which share their paths; None leaves the coat as it is (one facet).
    paths
        How many there are.
    progress
        Called after each repeat.

    Raises
    ------
    SimulateError
        When a panel reaches into the gel.
    """
    for design in designs:
        check_outside_the_gel(design.light, shape)
    batches = [
        _measure_batch(designs[k : k + _POSES_AT_ONCE], shape, bands, renderer, probes, facets, paths, told)
        for k, told in _batches(len(designs), paths.repeats, progress)
    ]
    return np.concatenate(batches)


def _batches(count: int, repeats: int, progress: Progress | None) -> Iterator[tuple[int, Callable[[int], None]]]:
    """Yield the first angle of each batch and what is to be called after each of its repeats."""
    firsts = range(0, count, _POSES_AT_ONCE)
    for number, first in enumerate(firsts):

        def told(done: int, before: int = number * repeats) -> None:
            if progress is not None:
                progress(before + done, len(firsts) * repeats, f"paths of all angles, repeat {done}")

        yield first, told


def _measure_batch(
    designs: Sequence[FingerDesign],
    shape: FingerShape,
    bands: PaintBands,
    renderer: ModuleType,
    probes: Probes,
    facets: Facets | None,
    paths: ProbePaths,
    told: Callable[[int], None],
) -> Floats:
    """Return the band radiance (angle, repeat, facet, probe, 3) of some angles; paths do not depend on the batch."""
    from sim.optics._angle_paths import AnglePaths, facet_radiance

    design, samples = designs[0], paths.samples
    scene = open_scene(design, shape, bands, renderer, sensor=radiance_meter(renderer, probes, 0))
    tracer = AnglePaths(scene, design, shape, [d.light for d in designs])
    direct = direct_lights(design, shape, [d.light for d in designs])
    origins, directions = (np.repeat(v, samples, axis=0) for v in (probes.origins_mm, probes.directions))
    kinds = 1 if facets is None else len(facets.normals)
    radiance = np.empty((len(designs), paths.repeats, kinds, len(probes.points_mm), 3))
    for repeat in range(paths.repeats):
        rng = np.random.default_rng(stream_seed(paths.seed, 2 * repeat))
        walls = WallExchange.traced(tracer, shape, _bake_samples(samples), rng)
        emitted = walls.emitted(direct, bands)
        path_seed = stream_seed(paths.seed, 2 * repeat + 1)
        if facets is not None:
            radiance[:, repeat] = facet_radiance(tracer, probes, facets, emitted, samples, path_seed)
        else:
            seen = tracer.trace(origins, directions, samples, path_seed, from_wall=False)
            radiance[:, repeat, 0, :, :2] = seen.by_wall.received(emitted, range(len(designs)))
            radiance[:, repeat, 0, :, 2] = seen.led.T
        told(repeat + 1)
    return radiance


#: Conversions of the longest chain of fluorescence: each further one is some hundred times weaker.
LONGEST_CHAIN: Final = 3


@dataclass(frozen=True, slots=True)
class FacetChains:
    """What facets of the coat send to the camera, chain by chain of fluorescence, for conversions of 1.

    Attributes
    ----------
    chains
        Names such as "led" (light of the LED itself) or "led>green>red".
    radiance_rel
        In units of the panel's radiance, (repeat, facet, probe, chain).
    """

    chains: tuple[str, ...]
    radiance_rel: Floats


def facet_chains(
    design: FingerDesign,
    shape: FingerShape,
    bands: PaintBands,
    renderer: ModuleType,
    probes: Probes,
    facets: Facets,
    paths: ProbePaths,
) -> FacetChains:
    """Trace facets of the coat once for all paints that reflect like these; how much they emit does not matter.

    Parameters
    ----------
    design, shape, renderer
        The finger under its own lights; a compiled variant.
    bands
        Reflectance of the walls in each band; conversions are not used.
    probes, facets
        Points on the coat, and directions of the coat there.
    paths
        Directions per probe and repeat.

    Raises
    ------
    SimulateError
        When a panel reaches into the gel.
    """
    from sim.optics._angle_paths import AnglePaths, facet_radiance

    check_outside_the_gel(design.light, shape)
    scene = open_scene(design, shape, bands, renderer, sensor=radiance_meter(renderer, probes, 0))
    # each pose of the light stands for one chain of each wall: what walls emit is a pose's own
    poses = sum(len(WALLS) ** k for k in range(LONGEST_CHAIN))
    tracer = AnglePaths(scene, design, shape, [design.light] * poses)
    direct = direct_lights(design, shape, [design.light])[0]
    radiance = []
    for repeat in range(paths.repeats):
        rng = np.random.default_rng(stream_seed(paths.seed, 2 * repeat))
        walls = WallExchange.traced(tracer, shape, _bake_samples(paths.samples), rng)
        chains = walls.chains(0, direct, LONGEST_CHAIN)
        of_wall = [[(name, lit) for name, (wall, lit) in chains.items() if wall == k] for k in range(len(WALLS))]
        emitted = np.array([[of_wall[k][pose][1] for k in range(len(WALLS))] for pose in range(poses)])
        seed = stream_seed(paths.seed, 2 * repeat + 1)
        sent = facet_radiance(tracer, probes, facets, emitted, paths.samples, seed)
        radiance.append(np.concatenate([sent[:1, ..., 2], *(sent[..., k] for k in range(len(WALLS)))]))
    names = ("led", *(name for one in of_wall for name, _ in one))
    return FacetChains(names, np.moveaxis(np.array(radiance), 1, -1))


def _bake_samples(samples: int) -> int:
    """Return the paths of each wall: one from a wall is about as noisy as one from a probe, and probes are more."""
    return max(round(BAKE_SAMPLES[False] * BAKE_SHARE), min(8 * samples, 2 * BAKE_SAMPLES[False]), samples)
