"""One whole picture of a deformed finger, all bands, against Mitsuba's own ``path`` in three colours.

    python benchmarks/whole_image_time.py [--width 640] [--samples 64] [--rounds 3] [--out FILE]

Both render the same scene with the same sensor, samples per pixel and longest path: ours holds every chain
of fluorescence apart and connects surfaces with the LED through the gel's face; ``path`` sees the painted walls as
textured emitters of the same light. The bake of the walls is told apart, and added. Both are timed by turns in one
process, after one sample each that compiles. The finger is pressed, its gel bent. The variance of the LED band over the
pad, between the rounds' seeds, is set against that of ``path`` at equal time. Bars: 1.5 x the time of ``path``, less
than 2 GB, a quarter of the variance. A camera of 640 x 480 photosites gives a picture of 320 x 240; the fixed costs of
the bake weigh less in larger pictures (``--width 1280``).
"""

import argparse
import json
import resource
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.fluorescence_levels import finger, paints
from sim.optics import choose_variant, open_renderer, paint_bands
from sim.surface_meshes import bent, pressed_shape, rest_shape

TIME_BAR = 1.5
MEMORY_BAR_GB = 2.0
VARIANCE_BAR = 0.25
BENDING_RADIUS_MM = 150.0
LED = 2


def timed(
    render: Callable[[int, int], Any], samples: int, seed: int
) -> tuple[tuple[float, float], NDArray[np.float32]]:
    """Return seconds of the clock and of the processor of one picture, and its LED band."""
    clock, processor = time.monotonic(), time.process_time()
    picture = np.array(render(samples, seed))
    return (time.monotonic() - clock, time.process_time() - processor), picture[..., LED]


def peak_memory_gb() -> float:
    """Return the largest memory of this process so far; Linux counts it in kB."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6


def main() -> None:
    """Print the comparison."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--width", type=int, default=640, help="photosites; the picture has half as many columns")
    parser.add_argument("--samples", type=int, default=64)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--out", type=Path)
    args = parser.parse_args()
    mi = open_renderer(choose_variant("llvm"))
    from sim.optics import BAKE_SAMPLES, LoadedScene, bake_walls, open_guide, pixel_maps
    from sim.optics._painted_walls import light_walls, unbaked_walls
    from sim.optics._render import lit_integrator
    from sim.optics._scene import finger_scene

    design = finger(args.width)
    shape, bands = bent(pressed_shape(design), BENDING_RADIUS_MM), paint_bands(*paints().values(), design.light)
    scene = finger_scene(design, shape, bands, mi, unbaked_walls())
    begun = time.monotonic(), time.process_time()
    guide = open_guide(scene, design, shape, mi)
    light = bake_walls(LoadedScene(scene, design, shape, bands, mi), "b", 3, BAKE_SAMPLES[False], guide=guide)[0]
    baked = time.monotonic() - begun[0], time.process_time() - begun[1]
    light_walls(scene, light, mi)
    ours, chains = lit_integrator(scene, design, shape, mi, light, guide)
    renders: dict[str, Callable[[int, int], Any]] = {
        "ours": lambda spp, seed: mi.render(scene, integrator=ours, spp=spp, seed=seed),
        "path": lambda spp, seed: mi.render(scene, integrator=scene.integrator(), spp=spp, seed=seed),
    }
    for render in renders.values():
        timed(render, 1, 0)
    found = [[timed(render, args.samples, seed) for render in renders.values()] for seed in range(args.rounds)]
    took = np.array([[seconds for seconds, _ in pair] for pair in found])
    (own, own_cpu), (stock, stock_cpu) = np.median(took, axis=0)
    print(
        f"{args.width // 2} columns, {args.samples} samples, gel bent to {BENDING_RADIUS_MM:g} mm, {len(chains)} chains"
    )
    print(f"bake {baked[0]:.1f} s ({baked[1]:.1f} s of the processor)")
    print(f"ours {own:.1f} s ({own_cpu:.1f}), path {stock:.1f} s ({stock_cpu:.1f}), medians of {args.rounds}")
    for name, ratio in (("picture", own_cpu / stock_cpu), ("picture and bake", (own_cpu + baked[1]) / stock_cpu)):
        print(f"{name}: {ratio:.2f} x the processor's time of path, {_verdict(ratio, TIME_BAR)}")
    on_pad = np.isfinite(pixel_maps(design, shape, rest_shape(design), mi, None).coat_mm(design)[..., 0])
    of_ours, of_path = (np.var([pair[k][1][on_pad] for pair in found], axis=0, ddof=1).mean() for k in (0, 1))
    variance = of_ours * own_cpu / (of_path * stock_cpu)
    print(f"variance of the LED band over the pad: {variance:.3f} x, {_verdict(variance, VARIANCE_BAR)}")
    print(f"clock: {own / stock:.2f} x; by rounds {', '.join(f'{r:.2f}' for r in took[:, 0, 0] / took[:, 1, 0])}")
    print(f"memory {peak_memory_gb():.2f} GB, {_verdict(peak_memory_gb(), MEMORY_BAR_GB)}")
    if args.out is not None:
        told = {
            "time_ratio": (own_cpu + baked[1]) / stock_cpu,
            "led_variance_gain": 1.0 / variance,
            "memory_gb": peak_memory_gb(),
        }
        args.out.parent.mkdir(parents=True, exist_ok=True)
        args.out.write_text(json.dumps(told, indent=1))


def _verdict(value: float, bar: float) -> str:
    """Say whether a value is within a bar."""
    return f"{'within' if value <= bar else 'BEYOND'} the bar of {bar:g}"


if __name__ == "__main__":
    main()
