"""Render one state of a finger, with contact or without, as two independent halves: their difference is its noise."""

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import ModuleType
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from data_schemas.camera_calibration import CameraCalibration
from data_schemas.design import FingerDesign
from data_schemas.errors import SimulateError
from sim.optics.finger_view import Window
from sim.optics.lit_scene import lit_integrator, open_guide, open_scene, pathwise_integrator, stream_seed
from sim.optics.paint_bands import PaintBands
from sim.optics.pixel_maps import PixelMaps
from sim.optics.scene import camera_sensor
from sim.optics.variants import SCALAR_VARIANT
from sim.optics.wall_baking import BAKE_SAMPLES, bake_walls
from sim.optics.wall_emission import FIRST_CHAINS, Level
from sim.surface_meshes.finger_shape import FingerShape

SURROUNDINGS_SHARE = 8
"""Pixels that see neither coat nor walls get this many times fewer paths: nothing is measured there."""

CONTACT_REACH = 2.5
"""In half-widths of the contact: a comparison reaches to twice its half-width."""

RenderLevel = Level | Literal["c"]
"""A level of :data:`sim.optics.wall_emission.Level`, or c: fluorescence traced along each path, the reference."""


@dataclass(frozen=True, slots=True)
class CameraWindows:
    """The finger's camera, its pixels that see the pad, and those around contact and halo if it sees any."""

    design: FingerDesign
    calibration: CameraCalibration | None
    window: Window
    contact: Window | None

    @classmethod
    def of(
        cls, design: FingerDesign, calibration: CameraCalibration | None, maps: Sequence[PixelMaps]
    ) -> "CameraWindows":
        """Return the windows of a finger by what its pixels see without contact and with it."""
        near = maps[1].contact_distance <= CONTACT_REACH
        contact = Window.around(np.where(near, 0.0, np.nan)[..., None]) if near.any() else None
        return cls(design, calibration, Window.around(*(m.coat_mm(design) for m in maps)), contact)


@dataclass(frozen=True, slots=True)
class PathsPerPixel:
    """Paths per pixel of both halves together: over the pad, and around the contact."""

    pad: int
    contact: int

    def __post_init__(self) -> None:
        """Refuse numbers that cannot be halved."""
        for name, count in (("samples_per_pixel", self.pad), ("contact_samples_per_pixel", self.contact)):
            if count < 2 or count % 2:
                raise SimulateError(
                    f"{name} must be an even number of at least 2 (two independent halves), got {count}"
                )


@dataclass(frozen=True, slots=True)
class StateRender:
    """The finger without or with contact: an image per chain, half the difference of both halves, their seconds."""

    chains: Mapping[str, NDArray[np.float32]]
    half_difference: Mapping[str, NDArray[np.float32]]
    bake_s: float
    render_s: float


def render_state(
    camera: CameraWindows,
    shape: FingerShape,
    bands: PaintBands,
    renderer: ModuleType,
    level: RenderLevel,
    seed: int,
    samples: PathsPerPixel,
) -> StateRender:
    """Render two independent halves, whose difference tells the noise."""
    begun, design = time.monotonic(), camera.design
    scene = open_scene(design, shape, bands, renderer, camera_sensor(design, renderer, camera.calibration))
    guide = None if level == "c" else open_guide(scene, design, shape, renderer)
    prepared_s = time.monotonic() - begun
    (one, bake_s), (other, more_s) = (
        _render_half(scene, guide, camera, shape, bands, renderer, level, stream_seed(seed, half), samples)
        for half in (0, 1)
    )
    bake_s += prepared_s + more_s
    mean, half_difference = _mean_and_half_difference(one, other)
    return StateRender(mean, half_difference, bake_s, time.monotonic() - begun - bake_s)


def _render_half(
    scene: Any,
    guide: Any,
    camera: CameraWindows,
    shape: FingerShape,
    bands: PaintBands,
    renderer: ModuleType,
    level: RenderLevel,
    seed: int,
    samples: PathsPerPixel,
) -> tuple[dict[str, NDArray[np.float32]], float]:
    """Bake the walls and render once, the windows finely; return an image per chain and the seconds of the bake."""
    begun, design = time.monotonic(), camera.design
    chains: tuple[str, ...]
    if level == "c":
        integrator, chains = pathwise_integrator(scene, design, shape, bands, renderer), FIRST_CHAINS
    else:
        paths = BAKE_SAMPLES[renderer.variant() == SCALAR_VARIANT]
        light = bake_walls(scene, design, shape, bands, renderer, level, seed, paths, guide=guide)[0]
        integrator, chains = lit_integrator(scene, design, shape, renderer, light, guide)
    bake_s = time.monotonic() - begun
    coarse = max(1, samples.pad // 2 // SURROUNDINGS_SHARE)
    image = np.array(renderer.render(scene, integrator=integrator, spp=coarse, seed=seed), dtype=np.float32)
    for stream, (window, count) in enumerate(((camera.window, samples.pad), (camera.contact, samples.contact)), 1):
        if window is not None:
            sensor = renderer.load_dict(camera_sensor(design, renderer, camera.calibration, window))
            fine = renderer.render(
                scene, sensor=sensor, integrator=integrator, spp=count // 2, seed=stream_seed(seed, stream)
            )
            image[window.rows, window.columns] = np.array(fine, dtype=np.float32)
    return {chain: image[..., k] for k, chain in enumerate(chains)}, bake_s


def _mean_and_half_difference(
    one: dict[str, NDArray[np.float32]], other: dict[str, NDArray[np.float32]]
) -> tuple[dict[str, NDArray[np.float32]], dict[str, NDArray[np.float32]]]:
    """Return mean and half difference of two halves; a chain at the edge of being left out may be in one of them."""
    dark = np.zeros_like(next(iter(one.values())))
    pairs = {c: (one.get(c, dark), other.get(c, dark)) for c in dict.fromkeys([*one, *other])}
    half = np.float32(0.5)
    return {c: half * (a + b) for c, (a, b) in pairs.items()}, {c: half * (a - b) for c, (a, b) in pairs.items()}
