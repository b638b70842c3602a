"""Level (b), baked walls, against level (c), path-wise fluorescence in bands, on one pressed finger.

    python benchmarks/fluorescence_levels.py [--seeds 16] [--samples-per-pixel 256] [--width 128] [--depth 30] [--twice]

Prints per band the mean over the image of both levels with standard errors over seeds (each seed has its own bake),
their ratio with its interval, and how much lower the pixel variance of level b is at equal time. Bar: bias of b under
1.5 % plus 3 combined errors. ``--twice`` also compares depth 30 with 60 and two lights with their sum, level c.
"""

import argparse
import time
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from data_schemas.design import FingerDesign, LightPanel
from sim.optics.paint_bands import BAND_NAMES, PaintOptics, paint_bands
from sim.optics.variants import choose_variant, open_renderer

BIAS_BAR_REL = 0.015


@dataclass
class Means:
    """Image means per seed (seeds, 3 bands), mean pixel variance of one render (3,) and its seconds."""

    per_seed: NDArray[np.float64]
    pixel_variance: NDArray[np.float64]
    seconds: float

    @property
    def mean(self) -> NDArray[np.float64]:
        return np.asarray(self.per_seed.mean(axis=0))

    @property
    def error(self) -> NDArray[np.float64]:
        return np.asarray(self.per_seed.std(axis=0, ddof=1) / np.sqrt(len(self.per_seed)))


def paints() -> dict[str, PaintOptics]:
    """Return two plausible paints; green emission excites the red one."""
    w = np.arange(400.0, 751.0, 5.0)

    def bell(center_nm: float, sigma_nm: float, peak: float) -> NDArray[np.float64]:
        return np.asarray(peak * np.exp(-0.5 * ((w - center_nm) / sigma_nm) ** 2))

    red = 0.05 + 0.7 / (1.0 + np.exp(-(w - 605.0) / 12.0))
    return {
        "red": PaintOptics("red", w, bell(610.0, 18.0, 0.0066), red, bell(490.0, 45.0, 1.0)),
        "green": PaintOptics(
            "green", w, bell(520.0, 15.0, 0.0066), 0.06 + bell(530.0, 40.0, 0.4), bell(460.0, 30.0, 1.0)
        ),
    }


def finger(width_px: int, **changes: object) -> FingerDesign:
    """Return the default finger seen by a small camera."""
    design = FingerDesign()
    camera = design.camera.model_copy(update={"width_px": width_px, "height_px": width_px * 3 // 4})
    return design.model_copy(update={"camera": camera, **changes})


def measure(
    design: FingerDesign,
    level: str,
    seeds: range,
    samples_per_pixel: int,
    depth: int = 30,
    bake_samples: int = 64_000,
) -> Means:
    """Render once per seed at level "b" or "c"; means are over the whole image."""
    import mitsuba as mi

    from sim.optics.fluorescent_bands import fluorescent_bands
    from sim.optics.paths import band_integrator
    from sim.optics.render import lit_integrator, open_scene
    from sim.optics.wall_baking import bake_walls
    from sim.optics.wall_emission import last_band
    from sim.surface_meshes.finger_shape import pressed_shape

    shape, bands = pressed_shape(design), paint_bands(*paints().values(), design.light)
    scene = open_scene(design, shape, bands, mi)
    panels = band_integrator(scene, design, shape)
    matrices = {name: bands.matrix(name) for name in ("red", "green")}
    integrator, chains = fluorescent_bands(scene, matrices, max_depth=depth, panels=panels), BAND_NAMES
    images, seconds = [], 0.0
    for seed in seeds:
        if level == "b":
            light = bake_walls(scene, design, shape, bands, mi, "b", seed, bake_samples)[0]
            integrator, chains = lit_integrator(scene, design, shape, mi, light)
        start = time.monotonic()
        image = mi.render(scene, integrator=integrator, spp=samples_per_pixel, seed=seed).numpy().astype(float)
        seconds += time.monotonic() - start
        of_band = [[k for k, chain in enumerate(chains) if last_band(chain) == band] for band in BAND_NAMES]
        images.append(np.stack([image[..., k].sum(axis=-1) for k in of_band], axis=-1))
    stack = np.array(images)
    return Means(stack.mean(axis=(1, 2)), stack.var(axis=0, ddof=1).mean(axis=(0, 1)), seconds / len(seeds))


def compared(one: Means, other: Means) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the ratio of means per band and its standard error."""
    ratio = one.mean / other.mean
    return ratio, ratio * np.hypot(one.error / one.mean, other.error / other.mean)


def main() -> None:
    """Print the comparison."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--seeds", type=int, default=16)
    parser.add_argument("--samples-per-pixel", type=int, default=256)
    parser.add_argument("--width", type=int, default=128)
    parser.add_argument("--depth", type=int, default=30)
    parser.add_argument("--twice", action="store_true")
    args = parser.parse_args()
    open_renderer(choose_variant("llvm"))
    design, seeds = finger(args.width), range(args.seeds)
    baked = measure(design, "b", seeds, args.samples_per_pixel)
    paths = measure(design, "c", range(1000, 1000 + args.seeds), args.samples_per_pixel, args.depth)
    ratio, error = compared(baked, paths)
    gain = paths.pixel_variance * paths.seconds / (baked.pixel_variance * baked.seconds)
    for k, band in enumerate(BAND_NAMES):
        relative = [100.0 * m.error[k] / m.mean[k] for m in (baked, paths)]
        within = abs(ratio[k] - 1.0) <= BIAS_BAR_REL + 3.0 * error[k]
        print(
            f"{band:5s} b / c = {ratio[k]:.4f} +- {error[k]:.4f} (errors {relative[0]:.2f} %, {relative[1]:.2f} %), "
            f"{'within' if within else 'BEYOND'} the bar; pixel variance at equal time {gain[k]:.1f} x lower"
        )
    if args.twice:
        deep = measure(design, "c", range(2000, 2000 + args.seeds), args.samples_per_pixel, 2 * args.depth)
        print("depth", args.depth, "/", 2 * args.depth, *compared(paths, deep))
        tip = LightPanel(position_mm=(0.0, -10.0, 71.0), angle_deg=150.0)
        both, far = (finger(args.width, **c) for c in ({"second_light": tip}, {"light": tip}))
        two = measure(both, "c", range(3000, 3000 + args.seeds), args.samples_per_pixel, args.depth)
        alone = measure(far, "c", range(4000, 4000 + args.seeds), args.samples_per_pixel, args.depth)
        total = Means(paths.per_seed + alone.per_seed, paths.pixel_variance, paths.seconds)
        print("two lights / one + one", *compared(two, total))


if __name__ == "__main__":
    main()
