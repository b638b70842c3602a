"""Render a press: the finger without and with the indenter, as band images with their noise and position maps."""

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from data_schemas.camera_calibration import CameraCalibration
from data_schemas.design import FingerDesign
from data_schemas.errors import SimulateError
from sim.optics.lit_scene import check_paints, stream_seed
from sim.optics.paint_bands import BAND_NAMES, PaintBands, PaintOptics
from sim.optics.pixel_maps import PixelMaps, pixel_maps
from sim.optics.state_render import CameraWindows, PathsPerPixel, RenderLevel, StateRender, render_state
from sim.optics.variants import SCALAR_VARIANT
from sim.optics.wall_emission import LEVEL_NAMES, last_band
from sim.surface_meshes.finger_shape import FingerShape, pressed_shape, rest_shape
from sim.surface_meshes.intersections import check_no_intersections

CONTACT_SHARE = 2
"""Pixels near the contact get this many times more paths by default: comparisons look there, and they are few."""

# beside the streams of halves and windows, which count from zero
_CONTACT_STREAM = 100

# a bent finger at rest would be shorter; meshes keep their size to rounding
_SIZE_TOLERANCE_REL = 0.02

Progress = Callable[[int, int, str], None]
"""Called with the number of finished steps, of all steps, and what was done."""


@dataclass(frozen=True, slots=True)
class PressRender:
    """Band images of a finger without and with a press.

    Images are (rows, columns, 3 bands: red emission, green emission, LED), radiance in units of the panel's;
    ``*_chains`` hold the same light apart, per chain of fluorescence in the order of ``chains``: the mean of two
    independent halves, and ``*_half_difference`` half their difference, so that mean + and - it are the halves. Each
    half has its own bake of the walls, so the variance holds the bake's noise too; that part (about 2 % of the painted
    bands) is common to all pixels and does not average out over an area.
    ``*_variance`` is the variance of the mean of the halves, ``*_maps`` is what each pixel sees,
    ``contact_label`` where the pressed shape comes from.
    """

    no_contact_bands: NDArray[np.float32]
    contact_bands: NDArray[np.float32]
    chains: tuple[str, ...]
    no_contact_chains: NDArray[np.float32]
    contact_chains: NDArray[np.float32]
    no_contact_half_difference: NDArray[np.float32]
    contact_half_difference: NDArray[np.float32]
    no_contact_variance: NDArray[np.float32]
    contact_variance: NDArray[np.float32]
    no_contact_maps: PixelMaps
    contact_maps: PixelMaps
    contact_label: str
    bands: PaintBands
    samples_per_pixel: int
    seed: int
    timings_s: Mapping[str, float]
    variant: str
    level: RenderLevel
    label: str

    @property
    def chains_apart(self) -> bool:
        """Whether ``*_chains`` hold each chain; else all chains of a band stand together under its first."""
        return self.level != "c" and self.variant != SCALAR_VARIANT


def render_press(
    design: FingerDesign,
    paints: Mapping[str, PaintOptics],
    renderer: ModuleType,
    level: RenderLevel = "b",
    seed: int = 0,
    samples_per_pixel: int = 64,
    progress: Progress | None = None,
    shapes: tuple[FingerShape, FingerShape] | None = None,
    calibration: CameraCalibration | None = None,
    contact_samples_per_pixel: int | None = None,
    common_random_numbers: bool = True,
) -> PressRender:
    """Render a finger without and with its press.

    The same seed gives the same images.

    Parameters
    ----------
    design
        The finger; without `shapes` its indenter is pressed in analytically.
    paints
        Optics of the paints "red" (x = -width/2) and "green" (x = +width/2).
    renderer
        From :func:`sim.optics.variants.open_renderer`.
    level
        How the walls emit. Level c needs a compiled variant.
    seed
        Random seed, >= 0.
    samples_per_pixel
        Paths per pixel that sees the pad, an even number >= 2: two independent halves are rendered. The
        surroundings get an eighth.
    progress
        Called after each step.
    shapes
        The finger without and with contact, equal meshes.
    calibration
        Of the camera; without it the ideal pinhole of the design.
    contact_samples_per_pixel
        Paths per pixel of the rectangle around the contact and its halo, an even number; by default twice those
        of the pad.
    common_random_numbers
        Whether both images use the same random numbers, so that their difference away from the contact is small.
        What stands for a capture needs noise of its own in each image, as cameras have it.

    Raises
    ------
    SimulateError
        When a paint is missing, a paint gains energy, samples_per_pixel is odd, the gel intersects itself, the camera
        does not see the coat, or level c meets a scalar variant.
    """
    samples = PathsPerPixel(samples_per_pixel, contact_samples_per_pixel or CONTACT_SHARE * samples_per_pixel)
    _check_scalar(design, renderer)
    start = time.monotonic()
    bands = check_paints(design, paints)
    rest, pressed = shapes or (rest_shape(design), pressed_shape(design))
    _check_size(design, rest)
    for shape in (rest, pressed):
        check_no_intersections(shape.gel)
    maps = [pixel_maps(design, shape, rest, renderer, calibration) for shape in (rest, pressed)]
    timings = {"pixel maps": time.monotonic() - start}
    camera = CameraWindows.of(design, calibration, maps)
    states = []
    for step, (name, shape) in enumerate((("no contact", rest), ("contact", pressed)), start=1):
        own = seed if common_random_numbers or step == 1 else stream_seed(seed, _CONTACT_STREAM)
        states.append(render_state(camera, shape, bands, renderer, level, own, samples))
        timings |= {f"bake {name}": states[-1].bake_s, f"render {name}": states[-1].render_s}
        if progress is not None:
            progress(step, 2, f"rendered {name}")
    timings["total"] = time.monotonic() - start
    chains = tuple(dict.fromkeys(chain for state in states for chain in state.chains))
    variant = renderer.variant()
    return PressRender(
        **_images("no_contact", states[0], chains, maps[0]),
        **_images("contact", states[1], chains, maps[1]),
        chains=chains,
        contact_label=pressed.label,
        bands=bands,
        samples_per_pixel=samples_per_pixel,
        seed=seed,
        timings_s=timings,
        variant=variant,
        level=level,
        label=f"rendered, {'level c' if level == 'c' else LEVEL_NAMES[level]}, {variant}{_left_out(design, variant)}",
    )


def _left_out(design: FingerDesign, variant: str) -> str:
    """Say what Mitsuba's own integrators, which a scalar variant needs, cannot render."""
    return ", without the film" if variant == SCALAR_VARIANT and design.pad.film is not None else ""


def _check_size(design: FingerDesign, rest: FingerShape) -> None:
    """Refuse surfaces of another finger: their coordinates would be read with this one's sizes."""
    extent = np.ptp(rest.surfaces["coat"].vertices_mm, axis=0)
    for name, size, meshed in (("width", design.pad.width_mm, extent[0]), ("length", design.pad.length_mm, extent[2])):
        if abs(meshed - size) > _SIZE_TOLERANCE_REL * size:
            raise SimulateError(
                f"the surfaces belong to another finger: their pad has a {name} of {meshed:.3g} mm, the design's "
                f"pad.{name}_mm is {size:g} mm"
            )


def _check_scalar(design: FingerDesign, renderer: ModuleType) -> None:
    """Refuse what a scalar variant would render wrongly."""
    if renderer.variant() == SCALAR_VARIANT and any(light.beam_exponent != 1.0 for light in design.lights):
        raise SimulateError(
            "light.beam_exponent: a scalar variant renders Lambertian panels (1) only; take 1, or install LLVM 17+"
        )


def _images(name: str, state: StateRender, chains: tuple[str, ...], maps: PixelMaps) -> dict[str, Any]:
    """Return the fields of a render that belong to one state."""
    return {
        f"{name}_bands": _bands_of(state.chains),
        f"{name}_chains": _stacked(state.chains, chains),
        f"{name}_half_difference": _stacked(state.half_difference, chains),
        f"{name}_variance": _bands_of(state.half_difference) ** 2,
        f"{name}_maps": maps,
    }


def _bands_of(images: Mapping[str, NDArray[np.float32]]) -> NDArray[np.float32]:
    """Return the band images (rows, columns, 3) that chain images add up to."""
    of_band = {b: [image for chain, image in images.items() if last_band(chain) == b] for b in BAND_NAMES}
    return np.stack([np.sum(of_band[band], axis=0, dtype=np.float32) for band in BAND_NAMES], axis=-1)


def _stacked(images: Mapping[str, NDArray[np.float32]], chains: tuple[str, ...]) -> NDArray[np.float32]:
    """Return chain images as (rows, columns, chain)."""
    dark = np.zeros_like(next(iter(images.values())))
    return np.stack([images.get(chain, dark) for chain in chains], axis=-1)
