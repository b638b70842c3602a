"""A finger's scene with paint on its walls, and what renders it at each level in each variant."""

from collections.abc import Mapping
from types import ModuleType
from typing import Any

import numpy as np

from data_schemas.design import FingerDesign
from data_schemas.errors import SimulateError
from sim.optics.paint_bands import PaintBands, PaintOptics, paint_bands
from sim.optics.scene import finger_scene
from sim.optics.variants import SCALAR_VARIANT
from sim.optics.wall_baking import light_walls
from sim.optics.wall_emission import FIRST_CHAINS, WALLS, WallLight, unbaked_walls
from sim.surface_meshes.finger_shape import FingerShape


def check_paints(design: FingerDesign, paints: Mapping[str, PaintOptics]) -> PaintBands:
    """Return the bands of the two paints of a finger.

    Raises
    ------
    SimulateError
        When "red" or "green" is missing.
    """
    missing = {"red", "green"} - paints.keys()
    if missing:
        raise SimulateError(f"paints must hold 'red' and 'green'; missing: {', '.join(sorted(missing))}")
    return paint_bands(paints["red"], paints["green"], design.light)


def stream_seed(seed: int, stream: int) -> int:
    """Return the renderer's 32-bit seed of one of several independent random streams."""
    return int(np.random.SeedSequence((seed, stream)).generate_state(1)[0])


def open_scene(
    design: FingerDesign,
    shape: FingerShape,
    bands: PaintBands,
    renderer: ModuleType,
    sensor: Mapping[str, Any] | None = None,
) -> Any:
    """Return a scene whose walls can be lit with :func:`lit_integrator`."""
    # the band path tracer looks the walls' light up itself; Mitsuba's own integrators need emitters
    emission = unbaked_walls() if renderer.variant() == SCALAR_VARIANT else None
    return finger_scene(design, shape, bands, renderer, emission, sensor)


def open_guide(scene: Any, design: FingerDesign, shape: FingerShape, renderer: ModuleType) -> Any:
    """Return the :class:`sim.optics.mirror_guide.MirrorGuide` of a scene; None in a scalar variant, which has none."""
    if renderer.variant() == SCALAR_VARIANT:
        return None
    from sim.optics.band_integrator import mirror_guide  # needs the variant set

    return mirror_guide(scene, design, shape)


def lit_integrator(
    scene: Any, design: FingerDesign, shape: FingerShape, renderer: ModuleType, light: WallLight, guide: Any = None
) -> tuple[Any, tuple[str, ...]]:
    """Return what renders a scene with lit walls, and the chains that its channels hold.

    With a guide (:func:`open_guide`) the LED's light has less noise. In a scalar variant this is the scene's own
    ``path``: its channels are the bands, all chains of a band together.
    """
    if renderer.variant() == SCALAR_VARIANT:
        light_walls(scene, light, renderer)
        return scene.integrator(), FIRST_CHAINS
    from sim.optics.band_integrator import band_integrator  # needs the variant set

    integrator = band_integrator(scene, design, shape, light, guide=guide)
    return integrator, integrator.chains


def pathwise_integrator(
    scene: Any, design: FingerDesign, shape: FingerShape, bands: PaintBands, renderer: ModuleType
) -> Any:
    """Return the integrator of level c; its channels are the bands, all chains of a band together."""
    if renderer.variant() == SCALAR_VARIANT:
        raise SimulateError("level c runs in compiled variants only; install LLVM 17 or newer, or take level b")
    from sim.optics.band_integrator import band_paths  # these need the variant set
    from sim.optics.fluorescent_bands import fluorescent_bands

    panels = band_paths(scene, design, shape)
    return fluorescent_bands(scene, {wall: bands.matrix(wall) for wall in WALLS}, panels=panels)
