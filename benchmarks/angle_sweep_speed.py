"""Sweep of the light angle by probes against one image per angle, on one pressed finger.

    python benchmarks/angle_sweep_speed.py [--angles 13] [--noise 0.01] [--width 640] [--bands led]

A pilot of each finds the paths per probe, and the samples per pixel, that bring the mean relative standard error of
the LED band (or of all bands) to the asked noise: at the probes, and of the mean over 8 x 8 pixels around them. Then
the sweep is run and timed; of the images one is, and the others take as long. Also compared: images of 64 samples,
whatever their noise. Bar: 20 x faster.
"""

import argparse
import time
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
class Comparison:
    """Seconds of the sweep and of the images, and what was traced."""

    sweep_s: float
    sweep_noise_rel: float
    samples: int
    images_s: float
    samples_per_pixel: float
    pictures_s: float

    @property
    def ratio(self) -> float:
        """How many times longer the images of equal noise take."""
        return self.images_s / self.sweep_s

    @property
    def ratio_of_pictures(self) -> float:
        """How many times longer images of 64 samples take."""
        return self.pictures_s / self.sweep_s


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

    few = angles_deg[:: max(1, len(angles_deg) // 4)]
    trial = sweep_light_angle(design, paints(), mi, few, repeats, 1, pilot)
    samples = int(np.ceil(pilot * (noise_rel(trial.radiance_rel, columns) / noise) ** 2))
    start = time.monotonic()
    sweep = sweep_light_angle(design, paints(), mi, angles_deg, repeats, 2, max(samples, 16))
    sweep_s = time.monotonic() - start
    per_pixel = samples_for_blocks(design, noise, columns)
    fixed_s, per_sample_s = image_seconds(design)
    return Comparison(
        sweep_s,
        noise_rel(sweep.radiance_rel, columns),
        samples,
        len(angles_deg) * (fixed_s + per_sample_s * per_pixel),
        per_pixel,
        len(angles_deg) * (fixed_s + per_sample_s * PICTURE_SAMPLES_PER_PIXEL),
    )


def samples_for_blocks(design: FingerDesign, noise: float, columns: list[int], pilot: int = 16) -> float:
    """Return the samples per pixel that bring the mean of 8 x 8 pixels around the probes to the asked noise."""
    import mitsuba as mi

    from sim.optics.angle_sweep import default_probe_points_mm
    from sim.optics.render import render_press

    renders = [render_press(design, paints(), mi, seed=seed, samples_per_pixel=pilot) for seed in range(1)]
    position = renders[0].contact_maps.coat_mm(design)
    squares = []
    for x, z in default_probe_points_mm(design):
        distance = np.nan_to_num(np.hypot(position[..., 0] - z, position[..., 1] - x), nan=np.inf)
        row, column = np.unravel_index(np.argmin(distance), distance.shape)
        block = np.s_[row - BLOCK_PX // 2 : row + BLOCK_PX // 2, column - BLOCK_PX // 2 : column + BLOCK_PX // 2]
        mean = np.mean([r.contact_bands[block].mean(axis=(0, 1), dtype=float) for r in renders], axis=0)
        variance = np.mean([r.contact_variance[block].mean(axis=(0, 1), dtype=float) for r in renders], axis=0)
        squares.append(variance / BLOCK_PX**2 / mean**2)
    return float(pilot * np.mean(np.array(squares)[:, columns]) / noise**2)


def image_seconds(design: FingerDesign) -> tuple[float, float]:
    """Return the seconds of scene and bake of one image, and those of each sample per pixel."""
    import mitsuba as mi

    from sim.optics.paint_bands import paint_bands
    from sim.optics.render import BAKE_SAMPLES, lit_integrator, open_scene
    from sim.optics.wall_baking import bake_walls
    from sim.surface_meshes.finger_shape import pressed_shape

    shape, bands = pressed_shape(design), paint_bands(*paints().values(), design.light)
    start = time.monotonic()
    scene = open_scene(design, shape, bands, mi)
    light = bake_walls(scene, design, shape, bands, mi, "b", 3, BAKE_SAMPLES[False])[0]
    integrator, _ = lit_integrator(scene, design, shape, mi, light)
    fixed_s = time.monotonic() - start
    np.array(mi.render(scene, integrator=integrator, spp=1, seed=0))  # compiles
    start = time.monotonic()
    np.array(mi.render(scene, integrator=integrator, spp=PICTURE_SAMPLES_PER_PIXEL // 4, seed=1))
    return fixed_s, (time.monotonic() - start) / (PICTURE_SAMPLES_PER_PIXEL // 4)


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
    found = compare(finger(args.width), angles, args.noise, columns, 2000, args.repeats)
    print(
        f"sweep of {args.angles} angles: {found.sweep_s:.1f} s with {args.repeats} x {found.samples} paths per probe "
        f"(noise {100 * found.sweep_noise_rel:.2f} %)"
    )
    for name, seconds, per_pixel, ratio in (
        ("equal noise", found.images_s, found.samples_per_pixel, found.ratio),
        ("pictures", found.pictures_s, PICTURE_SAMPLES_PER_PIXEL, found.ratio_of_pictures),
    ):
        print(
            f"{args.angles} images, {name}: {seconds:.1f} s at {per_pixel:.0f} samples per pixel: {ratio:.1f} x, "
            f"{'within' if ratio >= BAR else 'BELOW'} the bar of {BAR:g}"
        )


if __name__ == "__main__":
    main()
