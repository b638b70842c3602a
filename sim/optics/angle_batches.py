"""Measure probes for many angles of a light together, with the coat as it is or as tilted facets."""

from collections.abc import Callable, Iterator, Sequence
from types import ModuleType
from typing import Final

import numpy as np
from numpy.typing import NDArray

from data_schemas.design import FingerDesign
from sim.optics.facets import Facets
from sim.optics.lit_scene import open_scene, stream_seed
from sim.optics.paint_bands import PaintBands
from sim.optics.probes import Probes, radiance_meter
from sim.optics.render import Progress
from sim.optics.scene import check_outside_the_gel
from sim.optics.wall_baking import BAKE_SAMPLES
from sim.optics.wall_exchange import WallExchange, direct_lights
from sim.surface_meshes.finger_shape import FingerShape

Floats = NDArray[np.float64]

BAKE_SHARE: Final = 0.2
"""Of a picture's bake: each repeat bakes its own walls, so that the repeats show its noise; together they sample it."""

# poses are loops of one compiled kernel and share its memory
_POSES_AT_ONCE = 16


def at_angle(design: FingerDesign, angle_deg: float) -> FingerDesign:
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
    samples: int,
    repeats: int,
    seed: int,
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
    samples, repeats, seed
        Paths per probe and repeat, independent repeats, and random seed.
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
        _measure_batch(
            designs[k : k + _POSES_AT_ONCE], shape, bands, renderer, probes, facets, samples, repeats, seed, told
        )
        for k, told in _batches(len(designs), repeats, progress)
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
    samples: int,
    repeats: int,
    seed: int,
    told: Callable[[int], None],
) -> Floats:
    """Return the band radiance (angle, repeat, facet, probe, 3) of some angles; paths do not depend on the batch."""
    from sim.optics.angle_paths import AnglePaths  # both need the variant set
    from sim.optics.facet_light import facet_radiance

    design = designs[0]
    scene = open_scene(design, shape, bands, renderer, sensor=radiance_meter(renderer, probes, 0))
    tracer = AnglePaths(scene, design, shape, [d.light for d in designs])
    direct = direct_lights(design, shape, [d.light for d in designs])
    # a path from a probe and one from a wall are about as noisy, and there are more probes than walls
    bake_samples = max(round(BAKE_SAMPLES[False] * BAKE_SHARE), min(8 * samples, 2 * BAKE_SAMPLES[False]), samples)
    origins, directions = (np.repeat(v, samples, axis=0) for v in (probes.origins_mm, probes.directions))
    radiance = np.empty((len(designs), repeats, 1 if facets is None else len(facets.normals), len(probes.points_mm), 3))
    for repeat in range(repeats):
        rng = np.random.default_rng(stream_seed(seed, 2 * repeat))
        walls = WallExchange.traced(tracer, shape, bake_samples, rng)
        emitted = np.array([walls.emitted(k, direct[k], bands) for k in range(len(designs))])
        path_seed = stream_seed(seed, 2 * repeat + 1)
        if facets is not None:
            radiance[:, repeat] = facet_radiance(tracer, probes, facets, emitted, samples, path_seed)
        else:
            seen = tracer.trace(origins, directions, samples, path_seed, from_wall=False)
            radiance[:, repeat, 0, :, :2] = np.einsum("pkwij,kwij->kpw", seen.by_wall, emitted, optimize=True)
            radiance[:, repeat, 0, :, 2] = seen.led.T
        told(repeat + 1)
    return radiance
