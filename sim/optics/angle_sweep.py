"""Sweep the light angle and measure the radiance of the coated face at probe points instead of rendering pictures."""

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from data_schemas.design import FingerDesign
from data_schemas.errors import SimulateError
from sim.optics.angle_batches import BAKE_SHARE, at_angle, measure_together
from sim.optics.chain_images import chain_matrix
from sim.optics.lit_scene import check_paints, lit_integrator, open_scene, stream_seed
from sim.optics.paint_bands import PaintBands, PaintOptics
from sim.optics.probes import Probes, default_probe_points_mm, probes_on, radiance_meter
from sim.optics.render import Progress
from sim.optics.variants import SCALAR_VARIANT
from sim.optics.wall_baking import BAKE_SAMPLES, bake_walls
from sim.surface_meshes.finger_shape import FingerShape, pressed_shape

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
    repeats: int = 6,
    seed: int = 0,
    samples: int = 4000,
    probe_points_mm: NDArray[np.float64] | None = None,
    progress: Progress | None = None,
    shape: FingerShape | None = None,
) -> AngleSweep:
    """Measure the coated face's radiance at probe points for each light angle.

    The radiance is that towards the inner face, from the same place of the undeformed pad (along the pad's normal where
    it is not deformed), seen from inside the gel, at level b (level a
    knows no angle and cannot drive the decision). In compiled variants one set of paths serves all angles
    (:mod:`sim.optics.angle_paths`); light that the panel itself reflects (5 %) is left out: about 0.1 % of the LED
    band at most in the default finger. A scalar variant bakes and traces each angle by itself.

    Parameters
    ----------
    design
        The finger with its press; its own light angle is replaced.
    paints
        Optics of the paints "red" and "green".
    renderer
        From :func:`sim.optics.variants.open_renderer`. A scalar variant works too, with much more noise.
    angles_deg
        Light angles: the panel's normal from the pad plane.
    repeats
        Independent repeats, which give the noise.
    seed
        Random seed, >= 0.
    samples
        Paths per probe and repeat, shared by all angles (in a scalar variant, per angle).
    probe_points_mm
        Points (x, z) on the undeformed pad, shape (probe, 2); by default
        :func:`sim.optics.probes.default_probe_points_mm`.
    progress
        Called after each repeat (in a scalar variant, after each angle).
    shape
        The finger with contact; by default the design's indenter is pressed in analytically.

    Raises
    ------
    SimulateError
        When there is nothing to sweep, a probe lies outside the pad, or a paint is missing or gains energy.
    """
    start = time.monotonic()
    angles = np.asarray(angles_deg, dtype=np.float64)
    if angles.ndim != 1 or angles.size == 0 or repeats < 1 or samples < 1:
        raise SimulateError(
            f"a sweep needs a list of angles in deg, at least one repeat and at least one sample; got angles "
            f"of shape {angles.shape}, {repeats} repeats and {samples} samples"
        )
    shape = shape or pressed_shape(design)
    probes = probes_on(
        design, shape, default_probe_points_mm(design, shape) if probe_points_mm is None else probe_points_mm
    )
    bands = check_paints(design, paints)
    radiance = np.empty((angles.size, repeats, len(probes.points_mm), 3))
    designs = [at_angle(design, float(angle)) for angle in angles]
    variant = renderer.variant()
    if variant == SCALAR_VARIANT:
        for i, finger in enumerate(designs):
            radiance[i] = _measure_by_meters(finger, shape, bands, renderer, probes, samples, repeats, seed)
            if progress is not None:
                progress(i + 1, angles.size, f"light angle {angles[i]:g} deg")
    else:
        of_facets = measure_together(designs, shape, bands, renderer, probes, None, samples, repeats, seed, progress)
        radiance = of_facets[:, :, 0]
    duration_s = time.monotonic() - start
    label = f"rendered probes, level b, {variant}"
    return AngleSweep(angles, radiance, probes.points_mm, bands, samples, seed, duration_s, variant, label)


def _measure_by_meters(
    design: FingerDesign,
    shape: FingerShape,
    bands: PaintBands,
    renderer: ModuleType,
    probes: Probes,
    samples: int,
    repeats: int,
    seed: int,
) -> Floats:
    """Return the band radiance (repeat, probe, 3) for one light angle in a scalar variant."""
    scene = open_scene(design, shape, bands, renderer, sensor=radiance_meter(renderer, probes, 0))
    bake_samples = max(1, round(BAKE_SAMPLES[True] * BAKE_SHARE))
    values = []
    for repeat, light in enumerate(bake_walls(scene, design, shape, bands, renderer, "b", seed, bake_samples, repeats)):
        integrator, chains = lit_integrator(scene, design, shape, renderer, light)
        of_chains = _read_meters(scene, integrator, renderer, probes, samples, stream_seed(seed, repeat))
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
