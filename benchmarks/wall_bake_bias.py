"""Smoothed light on the painted walls against the unsmoothed light of many more rays, pressed and at rest.

    python benchmarks/wall_bake_bias.py [--bakes 100] [--samples N] [--presses NAME ...] [--out FOLDER]

Each bake of a press traces the detours of the LED's light to both walls and smooths them as a render does. The mean of
what was traced, without any smoothing, is the truth that does not share the spline's assumptions: with 100 bakes it has
100 times the rays of one. Prints, per press, wall and strip of 5 mm along the wall, how far the smoothed light of
single bakes lies off in the mean, in percent of the wall's light there, with its standard error in brackets, and the
same for the polynomial of degree 7 by 1 that stood here before; the noise of one bake per texel; and how often the
texels' own intervals hold the truth. Bars: bias rms 0.3 %, nowhere beyond 1 % by more than three standard errors, noise
0.7 %.

Goes on where it was stopped: each press has a file of its own in the folder, which grows by ten bakes at a time.
"""

import argparse
import json
from pathlib import Path
from types import ModuleType

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t as student_t

from benchmarks.fluorescence_levels import finger, paints
from data_schemas import FingerDesign, Indenter
from sim.optics import (
    BAKE_SAMPLES,
    TEXELS_ALONG,
    WALLS,
    choose_variant,
    open_guide,
    open_renderer,
    open_scene,
    paint_bands,
)
from sim.optics._path_rules import LedSearch

Floats = NDArray[np.float64]

PRESSES = {
    "rest": Indenter(depth_mm=0.0),
    "cylinder": Indenter(),
    "cylinder near the base": Indenter(position_mm=18.0),
    "cylinder near the tip": Indenter(position_mm=54.0, depth_mm=1.0),
    "thin cylinder": Indenter(radius_mm=4.0, depth_mm=1.5, position_mm=42.0),
    "ball in the middle": Indenter(shape="ball", radius_mm=8.0, depth_mm=2.0),
    "ball beside the green wall": Indenter(shape="ball", radius_mm=6.0, depth_mm=1.5, across_mm=10.0, position_mm=28.0),
}
STRIP_MM = 5.0
BIAS_BAR_REL, PLACE_BAR_REL, NOISE_BAR_REL = 0.003, 0.01, 0.007
_AT_ONCE = 10


def traced(name: str, samples: int, first: int, count: int, renderer: ModuleType) -> dict[str, Floats]:
    """Return, of so many bakes, the light (bake, wall, along, up) as traced, as smoothed, and its standard error."""
    from sim.optics._band_paths import band_paths
    from sim.optics._painted_walls import radiance_at_walls
    from sim.optics._wall_spline import smooth_batches
    from sim.surface_meshes import pressed_shape, rest_shape

    design = finger(160, indenter=PRESSES[name])
    shape = rest_shape(design) if name == "rest" else pressed_shape(design)
    scene = open_scene(design, shape, paint_bands(*paints().values(), design.light), renderer)
    guide = open_guide(scene, design, shape, renderer)
    tracer = band_paths(scene, design, shape, led=LedSearch(from_wall=True), guide=guide)
    found: dict[str, list[Floats]] = {"raw": [], "smooth": [], "error": []}
    for seed in range(first, first + count):
        batches = np.pi * radiance_at_walls(scene, shape, tracer, renderer, seed, samples, guide)[..., 2]
        walls = [smooth_batches(batches[:, k]) for k in range(len(WALLS))]
        found["raw"].append(batches.mean(axis=0))
        found["smooth"].append(np.stack([wall.mean for wall in walls]))
        found["error"].append(np.stack([wall.error_sd for wall in walls]))
    return {key: np.stack(values) for key, values in found.items()} | {"direct": direct(design, shape)}


def direct(design: FingerDesign, shape: object) -> Floats:
    """Return the light that reaches the walls straight through the inner face, (wall, along, up)."""
    from sim.optics._painted_walls import direct_irradiance, texel_uv

    return np.stack([direct_irradiance(design, shape, wall, texel_uv()) for wall in WALLS])  # type: ignore[arg-type]


def kept(path: Path, name: str, samples: int, bakes: int, renderer: ModuleType) -> dict[str, Floats]:
    """Return the bakes of one press, after tracing those that its file lacks."""
    have: dict[str, Floats] = {}
    if path.exists():
        with np.load(path, allow_pickle=False) as stored:
            have = dict(stored)
    while len(have.get("raw", ())) < bakes:
        done = len(have.get("raw", ()))
        more = traced(name, samples, done, min(_AT_ONCE, bakes - done), renderer)
        have = more if not have else more | {k: np.concatenate([have[k], more[k]]) for k in ("raw", "smooth", "error")}
        partial = path.with_suffix(".partial.npz")
        np.savez_compressed(partial, **have)  # type: ignore[arg-type]
        partial.replace(path)
    return {k: v if k == "direct" else v[:bakes] for k, v in have.items()}


def polynomial(maps: Floats) -> Floats:
    """Return least-squares polynomials of degree 7 along and 1 up, as walls were smoothed before."""
    along, up = ((np.arange(n) + 0.5) / n * 2.0 - 1.0 for n in maps.shape[-2:])
    legendre = np.polynomial.legendre.legvander
    basis = np.linalg.qr(np.kron(legendre(along, 7), legendre(up, 1)))[0]
    flat = maps.reshape(*maps.shape[:-2], -1)
    return np.asarray((flat @ basis @ basis.T).reshape(maps.shape))


def strips(maps: Floats) -> Floats:
    """Return means over strips of 5 mm of a wall of 70 mm, (..., strip)."""
    count = round(70.0 / STRIP_MM)
    return np.asarray(maps.reshape(*maps.shape[:-2], count, TEXELS_ALONG // count * maps.shape[-1]).mean(axis=-1))


def bias_of(smooth: Floats, raw: Floats, whole: Floats) -> tuple[Floats, Floats]:
    """Return bias and its standard error per wall and strip, as shares of the light there."""
    off = strips(smooth - raw) / strips(whole)
    return np.asarray(off.mean(axis=0)), np.asarray(off.std(axis=0, ddof=1) / np.sqrt(len(off)))


def report(name: str, have: dict[str, Floats]) -> dict[str, float]:
    """Print one press; return its numbers."""
    raw, smooth = have["raw"], have["smooth"]
    whole = raw.mean(axis=0) + have["direct"]
    told: dict[str, float] = {"bakes": len(raw)}
    for label, fit in (("spline", smooth), ("polynomial", polynomial(raw))):
        bias, error = bias_of(fit, raw, whole)
        rms = np.sqrt(max(np.mean(bias**2 - error**2), 0.0))
        beyond = np.abs(bias) - 3.0 * error
        told |= {f"{label} bias rms": float(rms), f"{label} beyond": float(beyond.max())}
        largest = np.abs(bias).max()
        print(f"{name}, {label}: bias rms {rms:.2%}, largest {largest:.2%}, surely beyond {beyond.max():.2%}")
        for wall, row, row_error in zip(WALLS, bias, error, strict=True):
            cells = " ".join(f"{100 * b:5.1f}({e:3.1f})" for b, e in zip(row, 100 * row_error, strict=True))
            print(f"    {wall:5s} {cells}")
    noise = np.sqrt(np.mean(smooth.var(axis=0, ddof=1) / whole**2))
    # the truth has noise of its own, which would make short runs look worse than they are
    spread = have["error"] ** 2 + raw.var(axis=0, ddof=1) / len(raw)
    inside = np.abs(smooth - raw.mean(axis=0)) < student_t.ppf(0.975, 15) * np.sqrt(spread)
    told |= {"noise": float(noise), "coverage": float(inside.mean())}
    print(f"    noise of one bake per texel {noise:.2%}; 95 % intervals hold {inside.mean():.1%} of texels", flush=True)
    return told


def main() -> None:
    """Trace what is missing and print every press."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0] if __doc__ else None)
    parser.add_argument("--bakes", type=int, default=100)
    parser.add_argument("--samples", type=int, default=BAKE_SAMPLES[False])
    parser.add_argument("--presses", nargs="*", default=list(PRESSES), choices=list(PRESSES))
    parser.add_argument("--out", type=Path, default=Path("bench-out/wall_bake_bias"))
    args = parser.parse_args()
    renderer = open_renderer(choose_variant("llvm"))
    args.out.mkdir(parents=True, exist_ok=True)
    told = {}
    for name in args.presses:
        path = args.out / f"{name.replace(' ', '_')}_{args.samples}.npz"
        told[name] = report(name, kept(path, name, args.samples, args.bakes, renderer))
    (args.out / "numbers.json").write_text(json.dumps(told, indent=1))
    pressed = [numbers for name, numbers in told.items() if name != "rest"]
    if pressed:
        rms = np.sqrt(np.mean([n["spline bias rms"] ** 2 for n in pressed]))
        beyond, noise = (max(n[key] for n in pressed) for key in ("spline beyond", "noise"))
        print(
            f"pressed: bias rms {rms:.2%} (bar {BIAS_BAR_REL:.1%}), surely beyond {beyond:.2%} (bar "
            f"{PLACE_BAR_REL:.0%}), noise {noise:.1%} (bar {NOISE_BAR_REL:.1%})"
        )


if __name__ == "__main__":
    main()
