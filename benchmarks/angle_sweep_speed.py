"""Sweep of the light angle by probes against one image per angle, on one pressed finger.

    python benchmarks/angle_sweep_speed.py [--angles 13] [--noise 0.01] [--width 640] [--bands led]

A pilot of the sweep finds the paths per probe that bring the root mean square of the relative standard errors of the
LED band (or of all bands) at the probes to the asked noise; then the sweep is run and timed. A pilot image gives the
samples per pixel that bring the mean of 8 x 8 pixels around the probes to the noise that the sweep has reached, and
the seconds per sample; the time of the images of equal noise is extrapolated from these two. Seconds are those of the
processor (all threads), which other work on the machine disturbs less, and of the clock. Bar: 20 x faster.
"""

import argparse
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from benchmarks.fluorescence_levels import finger, paints
from data_schemas.design import FingerDesign
from sim.optics.paint_bands import BAND_NAMES
from sim.optics.variants import choose_variant, open_renderer

BAR = 20.0
BLOCK_PX = 8
PICTURE_SAMPLES_PER_PIXEL = 64


@dataclass
class Seconds:
    """Seconds of the clock and of the processor."""

    clock: float
    processor: float

    def times(self, factor: float) -> "Seconds":
        """Return so many times as much."""
        return Seconds(self.clock * factor, self.processor * factor)

    def __str__(self) -> str:
        return f"{self.clock:.1f} s ({self.processor:.1f} s of the processor)"


@contextmanager
def timed(took: list[Seconds]) -> Iterator[None]:
    """Append what the block takes."""
    clock, processor = time.monotonic(), time.process_time()
    yield
    took.append(Seconds(time.monotonic() - clock, time.process_time() - processor))


@dataclass
class Comparison:
    """What the sweep and one image per angle took, and what was traced."""

    sweep: Seconds
    noise_rel: float
    samples: int
    image_fixed: Seconds
    image_per_sample: Seconds
    samples_per_pixel: float

    def images(self, angles: int, samples_per_pixel: float) -> Seconds:
        """Return the seconds of images of so many samples per pixel."""
        fixed, traced = self.image_fixed, self.image_per_sample.times(samples_per_pixel)
        return Seconds(fixed.clock + traced.clock, fixed.processor + traced.processor).times(angles)


def noise_rel(radiance: NDArray[np.float64], columns: list[int]) -> float:
    """Return the root mean square of relative standard errors of (angle, repeat, probe, band) over the repeats."""
    error = radiance.std(axis=1, ddof=1) / np.sqrt(radiance.shape[1])
    return float(np.sqrt(np.mean((error / radiance.mean(axis=1))[..., columns] ** 2)))


def compare(
    design: FingerDesign, angles_deg: NDArray[np.float64], noise: float, columns: list[int], pilot: int, repeats: int
) -> Comparison:
    """Measure both ways to the asked noise."""
    import mitsuba as mi

    from sim.optics.angle_sweep import sweep_light_angle

    trial = sweep_light_angle(design, paints(), mi, angles_deg, repeats, 1, pilot)
    samples = max(16, int(np.ceil(pilot * (noise_rel(trial.radiance_rel, columns) / noise) ** 2)))
    took: list[Seconds] = []
    with timed(took):
        sweep = sweep_light_angle(design, paints(), mi, angles_deg, repeats, 2, samples)
    reached = noise_rel(sweep.radiance_rel, columns)
    per_pixel = samples_for_blocks(design, reached, columns)
    return Comparison(took[0], reached, samples, *image_seconds(design), per_pixel)


def samples_for_blocks(design: FingerDesign, noise: float, columns: list[int], pilot: int = 16) -> float:
    """Return the samples per pixel that bring the mean of 8 x 8 pixels around the probes to the asked noise."""
    import mitsuba as mi

    from sim.optics.probes import default_probe_points_mm
    from sim.optics.render import render_press
    from sim.surface_meshes.finger_shape import pressed_shape

    render = render_press(design, paints(), mi, seed=0, samples_per_pixel=pilot)
    position = render.contact_maps.coat_mm(design)
    squares = []
    for x, z in default_probe_points_mm(design, pressed_shape(design)):
        distance = np.nan_to_num(np.hypot(position[..., 0] - z, position[..., 1] - x), nan=np.inf)
        row, column = np.unravel_index(np.argmin(distance), distance.shape)
        block = np.s_[row - BLOCK_PX // 2 : row + BLOCK_PX // 2, column - BLOCK_PX // 2 : column + BLOCK_PX // 2]
        mean = render.contact_bands[block].mean(axis=(0, 1), dtype=float)
        variance = render.contact_variance[block].mean(axis=(0, 1), dtype=float)
        squares.append(variance / BLOCK_PX**2 / mean**2)
    return float(pilot * np.mean(np.array(squares)[:, columns]) / noise**2)


def image_seconds(design: FingerDesign) -> tuple[Seconds, Seconds]:
    """Return the seconds of scene and bake of one image, and those of each sample per pixel."""
    import mitsuba as mi

    from sim.optics.paint_bands import paint_bands
    from sim.optics.render import BAKE_SAMPLES, lit_integrator, open_scene
    from sim.optics.wall_baking import bake_walls
    from sim.surface_meshes.finger_shape import pressed_shape

    shape, bands = pressed_shape(design), paint_bands(*paints().values(), design.light)
    took: list[Seconds] = []
    with timed(took):
        scene = open_scene(design, shape, bands, mi)
        light = bake_walls(scene, design, shape, bands, mi, "b", 3, BAKE_SAMPLES[False])[0]
        integrator, _ = lit_integrator(scene, design, shape, mi, light)
    np.array(mi.render(scene, integrator=integrator, spp=1, seed=0))  # compiles
    samples = PICTURE_SAMPLES_PER_PIXEL // 4
    with timed(took):
        np.array(mi.render(scene, integrator=integrator, spp=samples, seed=1))
    return took[0], took[1].times(1.0 / samples)


def main() -> None:
    """Print the comparison."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--angles", type=int, default=13)
    parser.add_argument("--noise", type=float, default=0.01)
    parser.add_argument("--width", type=int, default=640)
    parser.add_argument("--bands", choices=["led", "all"], default="led")
    parser.add_argument("--repeats", type=int, default=6)
    args = parser.parse_args()
    open_renderer(choose_variant("llvm"))
    columns = [BAND_NAMES.index("led")] if args.bands == "led" else [0, 1, 2]
    angles = np.linspace(0.0, 120.0, args.angles)
    found = compare(finger(args.width), angles, args.noise, columns, 4000, args.repeats)
    print(
        f"sweep of {args.angles} angles: {found.sweep} with {args.repeats} x {found.samples} paths per probe, "
        f"shared by all angles; noise {100 * found.noise_rel:.2f} %"
    )
    for name, per_pixel in (
        ("of the same noise, extrapolated from the variance per sample", found.samples_per_pixel),
        ("as pictures", float(PICTURE_SAMPLES_PER_PIXEL)),
    ):
        images = found.images(args.angles, per_pixel)
        ratio = images.processor / found.sweep.processor
        print(
            f"{args.angles} images {name}: {images} at {per_pixel:.0f} samples per pixel: {ratio:.1f} x the "
            f"processor's time, {images.clock / found.sweep.clock:.1f} x the clock's, "
            f"{'within' if ratio >= BAR else 'BELOW'} the bar of {BAR:g}"
        )


if __name__ == "__main__":
    main()
