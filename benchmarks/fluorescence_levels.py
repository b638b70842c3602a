"""Level (b), baked walls, against level (c), path-wise fluorescence in bands, on one pressed finger.

    python benchmarks/fluorescence_levels.py [--seeds 36] [--samples-per-pixel 512] [--width 128] [--depth 30]
        [--twice] [--spectral] [--out FILE]

Prints per band the mean over the image of both levels with standard errors over seeds (each seed has its own bake),
their ratio with its error, whether a bake with 3 % too little light would be found, and how much lower the
pixel variance of level b is at equal time. Bar: bias of b under 1.5 % plus 3 combined errors, each below 0.5 %.
``--twice`` also compares depth 30 with 60 and two lights with their sum, level c. ``--spectral`` compares full spectra
with bands in three windows of wavelength; it runs in a process of its own, because variants are set per process.
"""

import argparse
import json
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t as student_t

from data_schemas import FingerDesign, LightPanel
from sim.optics import BAND_NAMES, PaintBands, PaintOptics, choose_variant, open_renderer, paint_bands

Floats = NDArray[np.float64]

BIAS_BAR_REL = 0.015
LARGEST_ERROR_REL = 0.005
WRONG_BAKE_REL = 0.97
"""Irradiance of the negative control: the comparison must tell a bake that is 3 % too dark."""

WINDOWS_NM = ((575.0, 750.0), (480.0, 570.0), (400.0, 475.0))
"""Of the camera that full spectra are compared in: mostly red emission, green emission, LED."""

# the baked level needs fewer paths per pixel for an equal error of the painted bands, but its bakes more
_BAKED_SHARE = 4
# two lights and their sum take three measurements: a part of the seeds, and as many paired ones for the depth
_SEEDS_SHARE = 4
# shares of the wavelengths drawn like the windows' own band and evenly: weights stay bounded
_LIKE_THE_BAND = 0.7


@dataclass
class Means:
    """Image means per seed (seeds, 3 bands), mean pixel variance of one render (3,) and its seconds."""

    per_seed: Floats
    pixel_variance: Floats
    seconds: float

    @property
    def mean(self) -> Floats:
        return np.asarray(self.per_seed.mean(axis=0))

    @property
    def error(self) -> Floats:
        return np.asarray(self.per_seed.std(axis=0, ddof=1) / np.sqrt(len(self.per_seed)))


def paints() -> dict[str, PaintOptics]:
    """Return two plausible paints; green emission excites the red one."""
    w = np.arange(400.0, 751.0, 5.0)

    def bell(center_nm: float, sigma_nm: float, peak: float) -> Floats:
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

    from sim.optics import LoadedScene, bake_walls, last_band, open_guide, open_scene
    from sim.optics._band_paths import band_paths
    from sim.optics._fluorescent_paths import fluorescent_bands
    from sim.optics._render import lit_integrator
    from sim.surface_meshes import pressed_shape

    shape, bands = pressed_shape(design), paint_bands(*paints().values(), design.light)
    scene = open_scene(design, shape, bands, mi)
    panels, guide = band_paths(scene, design, shape), open_guide(scene, design, shape, mi)
    matrices = {name: bands.matrix(name) for name in ("red", "green")}
    integrator, chains = fluorescent_bands(scene, matrices, max_depth=depth, panels=panels), BAND_NAMES
    images, seconds = [], 0.0
    for seed in seeds:
        if level == "b":
            light = bake_walls(LoadedScene(scene, design, shape, bands, mi), "b", seed, bake_samples, guide=guide)[0]
            integrator, chains = lit_integrator(scene, design, shape, mi, light, guide)
        start = time.monotonic()
        image = mi.render(scene, integrator=integrator, spp=samples_per_pixel, seed=seed).numpy().astype(float)
        seconds += time.monotonic() - start
        of_band = [[k for k, chain in enumerate(chains) if last_band(chain) == band] for band in BAND_NAMES]
        images.append(np.stack([image[..., k].sum(axis=-1) for k in of_band], axis=-1))
    stack = np.array(images)
    return Means(stack.mean(axis=(1, 2)), stack.var(axis=0, ddof=1).mean(axis=(0, 1)), seconds / len(seeds))


def compared(one: Means, other: Means) -> tuple[Floats, Floats]:
    """Return the ratio of means per band and its standard error."""
    ratio = one.mean / other.mean
    return ratio, ratio * np.hypot(one.error / one.mean, other.error / other.mean)


def beyond_the_bar(ratio: Floats, error: Floats) -> NDArray[np.bool_]:
    """Return which ratios are off by more than the bar."""
    return np.asarray(np.abs(ratio - 1.0) > BIAS_BAR_REL + 3.0 * error)


def windows_of_bands(bands: PaintBands) -> Floats:
    """Return what each window holds of each band, (window, band): a camera matrix with box responses."""
    held = np.empty((len(WINDOWS_NM), len(BAND_NAMES)))
    for k, (low, high) in enumerate(WINDOWS_NM):
        fine = np.linspace(low, high, 2001)
        for j, band in enumerate(bands.bands):
            density = np.interp(fine, band.wavelength_nm, band.density_per_nm, left=0.0, right=0.0)
            held[k, j] = np.trapezoid(density, fine)
    return held


def measure_spectral(design: FingerDesign, seeds: range, samples_per_pixel: int) -> Floats:
    """Return the mean energy over the image in each window by full spectra, (seed, window).

    Each window has its own wavelengths, drawn mostly as its band shines: four of a path, evenly through the density.
    """
    import mitsuba as mi

    from sim.optics import open_scene
    from sim.optics._band_paths import band_paths
    from sim.optics._paint_bands import led_band
    from sim.surface_meshes import pressed_shape
    from tests.simulate.spectral_paths import fluorescent_paint, fluorescent_spectrum

    shape, bands, led = pressed_shape(design), paint_bands(*paints().values(), design.light), led_band(design.light)
    scene = open_scene(design, shape, bands, mi)
    tables = {name: fluorescent_paint(paint, design.light) for name, paint in paints().items()}
    panels = band_paths(scene, design, shape)
    integrator = fluorescent_spectrum(scene, tables, led.wavelength_nm, led.density_per_nm, panels=panels)
    sensor = scene.sensors()[0]
    columns, rows = sensor.film().size()
    count = int(columns * rows * samples_per_pixel)
    found = np.empty((len(seeds), len(WINDOWS_NM)))
    for i, seed in enumerate(seeds):
        for k, window in enumerate(WINDOWS_NM):
            sampler = mi.load_dict({"type": "independent"})
            sampler.seed(len(WINDOWS_NM) * seed + k, count)
            ray, _ = sensor.sample_ray_differential(0.0, 0.5, sampler.next_2d(), mi.Point2f(0.5))
            start = np.random.default_rng((seed, k)).random(count)
            wavelength_nm, per_density_nm = _drawn_nm(window, bands.bands[k], (start + np.arange(4)[:, None] / 4) % 1.0)
            ray.wavelengths = mi.Spectrum(*[mi.Float(w.astype(np.float32)) for w in wavelength_nm])
            radiance = integrator.sample(scene, sampler, ray, None, mi.Bool(True))[0].numpy().astype(float)
            found[i, k] = (radiance * per_density_nm).mean()
    return found


def _drawn_nm(window_nm: tuple[float, float], band: object, uniform: Floats) -> tuple[Floats, Floats]:
    """Return wavelengths in a window and one over their density, by inverting the integral of the density."""
    fine = np.linspace(*window_nm, 4001)
    like = np.interp(fine, band.wavelength_nm, band.density_per_nm, left=0.0, right=0.0)  # type: ignore[attr-defined]
    density = _LIKE_THE_BAND * like / np.trapezoid(like, fine) + (1.0 - _LIKE_THE_BAND) / (fine[-1] - fine[0])
    integral = np.concatenate([[0.0], np.cumsum((density[1:] + density[:-1]) / 2.0 * np.diff(fine))])
    wavelength_nm = np.interp(uniform * integral[-1], integral, fine)
    return wavelength_nm, 1.0 / np.interp(wavelength_nm, fine, density)


def report_levels(args: argparse.Namespace) -> Means:
    """Print the comparison of b with c; return the means of c."""
    design, start = finger(args.width), time.monotonic()
    samples = max(2, args.samples_per_pixel // _BAKED_SHARE)
    baked = measure(design, "b", range(args.seeds), samples, bake_samples=128_000)
    paths = measure(design, "c", range(1000, 1000 + args.seeds), args.samples_per_pixel, args.depth)
    ratio, error = compared(baked, paths)
    wrong = beyond_the_bar(ratio * WRONG_BAKE_REL, error)
    gain = paths.pixel_variance * paths.seconds / (baked.pixel_variance * baked.seconds)
    for k, band in enumerate(BAND_NAMES):
        relative = [m.error[k] / m.mean[k] for m in (baked, paths)]
        verdict = "BEYOND" if beyond_the_bar(ratio, error)[k] else "within"
        small = "below" if max(relative) < LARGEST_ERROR_REL else "ABOVE"
        found = "is no matter of bakes" if band == "led" else f"{'found' if wrong[k] else 'NOT found'}"
        print(
            f"{band:5s} b / c = {ratio[k]:.4f} +- {error[k]:.4f} (errors {relative[0]:.2%}, {relative[1]:.2%}, {small} "
            f"{LARGEST_ERROR_REL:.1%}), {verdict} the bar; a bake 3 % too dark: {found}; pixel variance at equal time "
            f"{gain[k]:.1f} x lower"
        )
    print(f"time {time.monotonic() - start:.0f} s", flush=True)
    if args.out is not None:
        told = {
            band: {"ratio": ratio[k], "error": error[k], "variance_gain": gain[k]} for k, band in enumerate(BAND_NAMES)
        }
        args.out.parent.mkdir(parents=True, exist_ok=True)
        args.out.write_text(json.dumps(told, indent=1))
    return paths


def report_twice(args: argparse.Namespace, paths: Means) -> None:
    """Print depth 30 against 60 with equal random numbers, and two lights against one plus one."""
    start, seeds = time.monotonic(), max(2, args.seeds // _SEEDS_SHARE)
    deep = measure(finger(args.width), "c", range(1000, 1000 + seeds), args.samples_per_pixel, 2 * args.depth)
    # equal paths but for their parts beyond the depth
    lost = 1.0 - paths.per_seed[:seeds] / deep.per_seed
    print(
        f"depth {args.depth} loses of depth {2 * args.depth}:",
        ", ".join(
            f"{band} {mean:.2e} +- {error:.1e}"
            for band, mean, error in zip(
                BAND_NAMES, lost.mean(axis=0), lost.std(axis=0, ddof=1) / np.sqrt(seeds), strict=True
            )
        ),
        flush=True,
    )
    # both panels stay where they are, because they also shade and reflect; one of the two is dark
    tip = LightPanel(position_mm=(0.0, -10.0, 71.0), angle_deg=150.0)
    base, dark = FingerDesign().light, {"power_rel": 1e-9}
    cases = ((base, tip), (base.model_copy(update=dark), tip), (base, tip.model_copy(update=dark)))
    both, far, near = (
        measure(
            finger(args.width, light=one, second_light=other), "c",
            range(3000 + 1000 * k, 3000 + 1000 * k + seeds), args.samples_per_pixel, args.depth,
        )
        for k, (one, other) in enumerate(cases)
    )  # fmt: skip
    total = Means(near.per_seed + far.per_seed, near.pixel_variance, near.seconds)
    ratio, error = compared(both, total)
    told = ", ".join(f"{b} {r:.4f} +- {e:.4f}" for b, r, e in zip(BAND_NAMES, ratio, error, strict=True))
    print(f"two lights / one + one: {told}; time {time.monotonic() - start:.0f} s", flush=True)


def report_spectral(args: argparse.Namespace, paths: Means) -> None:
    """Print full spectra against bands in each window, with an interval over seeds."""
    start = time.monotonic()
    samples, seeds = args.spectral_samples, args.spectral_seeds
    child = subprocess.run(
        [sys.executable, __file__, "--only-spectral", "--width", str(args.width), "--seeds", str(seeds),
         "--samples-per-pixel", str(samples)],
        stdout=subprocess.PIPE, text=True, check=True,
    )  # fmt: skip
    spectral = np.array(json.loads(child.stdout))
    bands = paths.per_seed @ windows_of_bands(paint_bands(*paints().values(), FingerDesign().light)).T
    for k, window in enumerate(WINDOWS_NM):
        ratio = spectral[:, k].mean() / bands[:, k].mean()
        parts = [v[:, k].var(ddof=1) / len(v) / v[:, k].mean() ** 2 for v in (spectral, bands)]
        error, freedom = np.sqrt(sum(parts)), sum(parts) ** 2 / sum(p**2 / (n - 1) for p, n in zip(
            parts, (len(spectral), len(bands)), strict=True))  # fmt: skip
        reach = ratio * error * student_t.ppf(0.975, freedom)
        print(
            f"{window[0]:g} to {window[1]:g} nm: spectral / bands = {ratio:.4f} [{ratio - reach:.4f}, "
            f"{ratio + reach:.4f}] (95 %, {seeds} seeds of {samples} samples; errors {np.sqrt(parts[0]):.2%}, "
            f"{np.sqrt(parts[1]):.2%})"
        )
    print(f"time of the spectra {time.monotonic() - start:.0f} s", flush=True)


def main() -> None:
    """Print the comparisons."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--seeds", type=int, default=36)
    parser.add_argument("--samples-per-pixel", type=int, default=512)
    parser.add_argument("--width", type=int, default=128)
    parser.add_argument("--depth", type=int, default=30)
    parser.add_argument("--twice", action="store_true")
    parser.add_argument("--spectral", action="store_true")
    parser.add_argument("--spectral-seeds", type=int, default=12)
    parser.add_argument("--spectral-samples", type=int, default=128)
    parser.add_argument("--out", type=Path, help="of levels b and c, as JSON")
    parser.add_argument("--only-spectral", action="store_true", help=argparse.SUPPRESS)
    args = parser.parse_args()
    open_renderer(choose_variant("llvm", spectral=args.only_spectral))
    if args.only_spectral:
        found = measure_spectral(finger(args.width), range(5000, 5000 + args.seeds), args.samples_per_pixel)
        print(json.dumps(found.tolist()))
        return
    paths = report_levels(args)
    if args.spectral:
        report_spectral(args, paths)
    if args.twice:
        report_twice(args, paths)


if __name__ == "__main__":
    main()
