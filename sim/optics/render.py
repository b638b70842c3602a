"""Render a press: the finger without and with the indenter, as band images with their noise and position maps."""

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from data_schemas.design import FingerDesign
from data_schemas.errors import SimulateError
from sim.optics.finger_view import Window, coat_positions
from sim.optics.paint_bands import PaintBands, PaintOptics, paint_bands
from sim.optics.pressed_pad import contact_half_width_mm, without_press
from sim.optics.scene import camera_sensor, finger_scene
from sim.optics.variants import SCALAR_VARIANT
from sim.optics.wall_baking import indirect_irradiance, light_walls
from sim.optics.wall_emission import LEVEL_NAMES, Level, unbaked_emission

BAKE_SAMPLES = {False: 64_000, True: 12_000}
"""Paths per wall of one bake, by whether the variant is scalar (there each path costs a call from Python)."""

SURROUNDINGS_SHARE = 8
"""Pixels that see neither coat nor walls get this many times fewer paths: nothing is measured there."""

Progress = Callable[[int, int, str], None]
"""Called with the number of finished steps, of all steps, and what was done."""


@dataclass(frozen=True, slots=True)
class PressRender:
    """Band images of a finger without and with a press.

    Images are (rows, columns, 3 bands: red emission, green emission, LED), radiance in units of the panel's. Each
    half has its own bake of the walls, so the variance holds the bake's noise too; that part (about 2 % of the painted
    bands) is common to all pixels and does not average out over an area.
    ``*_variance`` is the variance of the mean of the two independent halves. ``*_coat_uv_mm`` (rows, columns, 2) is
    the point (z, x) of the coated face that a pixel sees, NaN elsewhere. ``distance_in_half_widths``
    (rows, columns) is |z - z0| over the half width of the contact for the pressed pad; NaN outside and without press.
    """

    no_contact_bands: NDArray[np.float32]
    contact_bands: NDArray[np.float32]
    no_contact_variance: NDArray[np.float32]
    contact_variance: NDArray[np.float32]
    no_contact_coat_uv_mm: NDArray[np.float64]
    contact_coat_uv_mm: NDArray[np.float64]
    distance_in_half_widths: NDArray[np.float64]
    bands: PaintBands
    samples_per_pixel: int
    seed: int
    timings_s: Mapping[str, float]
    variant: str
    level: Level
    label: str


def render_press(
    design: FingerDesign,
    paints: Mapping[str, PaintOptics],
    renderer: ModuleType,
    level: Level = "b",
    seed: int = 0,
    samples_per_pixel: int = 64,
    progress: Progress | None = None,
) -> PressRender:
    """Render a finger without and with its press.

    Both images use the same random numbers, so that their difference away from the contact is small. The same
    seed gives the same images.

    Parameters
    ----------
    design
        The finger; its indenter is the press.
    paints
        Optics of the paints "red" (x = -width/2) and "green" (x = +width/2).
    renderer
        From :func:`sim.optics.variants.open_renderer`.
    level
        How the walls emit, see :func:`sim.optics.wall_emission.wall_emission`.
    seed
        Random seed, >= 0.
    samples_per_pixel
        Paths per pixel that sees the pad, an even number >= 2: two independent halves are rendered. The
        surroundings get an eighth.
    progress
        Called after each step.

    Raises
    ------
    SimulateError
        When a paint is missing, a paint gains energy, or samples_per_pixel is odd.
    """
    if samples_per_pixel < 2 or samples_per_pixel % 2:
        raise SimulateError(
            f"samples_per_pixel must be an even number of at least 2 (two independent halves), got {samples_per_pixel}"
        )
    start = time.monotonic()
    bands = check_paints(design, paints)
    timings: dict[str, float] = {}
    images, variances = {}, {}
    fingers = {"no contact": without_press(design), "contact": design}
    maps = {name: coat_positions(finger) for name, finger in fingers.items()}
    window = Window.around(*maps.values())
    for step, (name, finger) in enumerate(fingers.items()):
        begun = time.monotonic()
        halves = []
        for half in (0, 1):
            image, bake_s = _render_half(
                finger, bands, renderer, level, stream_seed(seed, half), samples_per_pixel // 2, window
            )
            halves.append(image)
            timings[f"bake {name}"] = timings.get(f"bake {name}", 0.0) + bake_s
        images[name] = np.float32(0.5) * (halves[0] + halves[1])
        variances[name] = np.float32(0.25) * (halves[0] - halves[1]) ** 2
        timings[f"render {name}"] = time.monotonic() - begun - timings[f"bake {name}"]
        if progress is not None:
            progress(step + 1, len(fingers), f"rendered {name}")
    timings["total"] = time.monotonic() - start
    variant = renderer.variant()
    return PressRender(
        no_contact_bands=images["no contact"],
        contact_bands=images["contact"],
        no_contact_variance=variances["no contact"],
        contact_variance=variances["contact"],
        no_contact_coat_uv_mm=maps["no contact"],
        contact_coat_uv_mm=maps["contact"],
        distance_in_half_widths=_distance_in_half_widths(design, maps["contact"]),
        bands=bands,
        samples_per_pixel=samples_per_pixel,
        seed=seed,
        timings_s=timings,
        variant=variant,
        level=level,
        label=f"rendered, {LEVEL_NAMES[level]}, {variant}",
    )


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


def scene_integrator(design: FingerDesign, renderer: ModuleType) -> Any:
    """Return the band path tracer, or None in a scalar variant, which uses the scene's own ``path``."""
    if renderer.variant() == SCALAR_VARIANT:
        return None
    from sim.optics.paths import band_integrator  # needs the variant set

    return band_integrator(design)


def stream_seed(seed: int, stream: int) -> int:
    """Return the renderer's 32-bit seed of one of several independent random streams."""
    return int(np.random.SeedSequence((seed, stream)).generate_state(1)[0])


def open_scene(design: FingerDesign, bands: PaintBands, renderer: ModuleType, **extra: Any) -> tuple[Any, Any]:
    """Return a scene whose walls can emit (still unbaked) and its integrator, None in a scalar variant."""
    scene = finger_scene(design, bands, renderer, unbaked_emission(), **extra)
    return scene, scene_integrator(design, renderer)


def _render_half(
    design: FingerDesign,
    bands: PaintBands,
    renderer: ModuleType,
    level: Level,
    seed: int,
    samples_per_pixel: int,
    window: Window,
) -> tuple[NDArray[np.float32], float]:
    """Bake the walls and render once, the window finely; return the image and the seconds of the bake."""
    begun = time.monotonic()
    scene, integrator = open_scene(design, bands, renderer)
    samples = BAKE_SAMPLES[renderer.variant() == SCALAR_VARIANT]
    indirect = indirect_irradiance(scene, design, renderer, seed, samples)[0]
    light_walls(scene, design, bands, renderer, level, indirect)
    bake_s = time.monotonic() - begun
    extra = {} if integrator is None else {"integrator": integrator}
    coarse = max(1, samples_per_pixel // SURROUNDINGS_SHARE)
    image = np.array(renderer.render(scene, spp=coarse, seed=seed, **extra), dtype=np.float32)
    sensor = renderer.load_dict(camera_sensor(design, renderer, window))
    fine = renderer.render(scene, sensor=sensor, spp=samples_per_pixel, seed=stream_seed(seed, 1), **extra)
    image[window.rows, window.columns] = np.array(fine, dtype=np.float32)
    return image, bake_s


def _distance_in_half_widths(design: FingerDesign, coat_uv_mm: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return each pixel's distance from the line of contact in units of the contact's half width."""
    half_width = contact_half_width_mm(design)
    if half_width == 0.0:
        return np.full(coat_uv_mm.shape[:2], np.nan)
    return np.asarray(np.abs(coat_uv_mm[..., 0] - design.indenter.position_mm) / half_width)
