"""Noise of pictures whose pixels share light, and processor time by part; or of path-traced ones.

    python -m benchmarks.picture_noise [--seeds 4] [--own-paths] [--samples 64] [--against FILE | --keep FILE]

The default finger at rest and pressed, 320 x 240 pixels; each seed has its own bake, nodes and pixels. For each state
and band, over the pixels that see the coat: the median, over pixels, of the error over the pixel's own light, the root
mean square error over the band's mean, and the same without the 1 % of pixels with the largest errors, which lie at
rims. The reference is what ``--keep`` stored of other seeds, its own noise included: the mean of K pictures adds a
K-th of one's variance. Without it each seed is compared with the mean of the others, scaled to the error of one.
Processor time by part is the mean over the seeds, of both states, without compilation.
"""

import argparse
import json
import time
from collections import defaultdict
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from benchmarks.fluorescence_levels import paints
from data_schemas import FingerDesign
from sim.optics import BAND_NAMES, LoadedScene, RenderSettings, choose_variant, open_guide, open_renderer, open_scene
from sim.optics import _render as rendering
from sim.optics._painted_walls import BAKE_SAMPLES, bake_batches, last_band, led_irradiance, reflected_light
from sim.optics._pixel_maps import pixel_maps
from sim.optics._render import traced_picture
from sim.optics._scene import camera_sensor
from sim.surface_meshes import FingerShape, pressed_shape, rest_shape

Floats = NDArray[np.float64]
STATES = ("rest", "pressed")
RIMS = 0.01
BAR_REL = 0.01


class Parts:
    """Processor seconds by part of a picture."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = defaultdict(float)

    def timed(self, part: str, work: Callable[[], Any]) -> Any:
        """Do the work, wait for the renderer, and add its time to the part."""
        begun = time.process_time()
        result = work()
        dr.sync_thread()
        self.seconds[part] += time.process_time() - begun
        return result


def main() -> None:
    """Print noise and times, and leave 1 when the noise of a band is above the bar."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--seeds", type=int, default=4)
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--own-paths", action="store_true", help="path-traced pictures")
    parser.add_argument("--samples", type=int, default=64, help="paths per pixel, as in RenderSettings")
    kept = parser.add_mutually_exclusive_group()
    kept.add_argument("--keep", type=Path, help="store the mean, to be the reference of other seeds")
    kept.add_argument("--against", type=Path, help="reference that --keep has stored")
    parser.add_argument("--out", type=Path)
    args = parser.parse_args()
    mi = open_renderer(choose_variant("llvm"))
    images, variances, seconds = _rendered(args, mi)
    if args.keep is not None:
        np.savez(args.keep, **{state: of.mean(axis=0) for state, of in images.items()})
    reference = dict(np.load(args.against)) if args.against is not None else dict.fromkeys(STATES)
    noise = {state: _noise(images[state], reference[state]) for state in STATES}
    beyond = {state: _beyond(images[state], variances[state]) for state in STATES}
    met = all(value <= BAR_REL for of in noise.values() for value in of["rms"])
    for state in STATES:
        print(f"{state} ({', '.join(BAND_NAMES)})")
        for name, values in (*noise[state].items(), ("beyond their 95 % points", beyond[state])):
            print(f"  {name:32s} " + ", ".join(f"{100 * value:.2f} %" for value in values))
    told = ", ".join(f"{part} {value:.1f}" for part, value in seconds.items())
    print(f"processor time {sum(seconds.values()):.1f} s: {told}")
    if args.out is not None:
        args.out.parent.mkdir(parents=True, exist_ok=True)
        args.out.write_text(
            json.dumps({"noise_rel": noise, "beyond": beyond, "seconds": seconds, "met": met}, indent=1)
        )
    raise SystemExit(0 if met else 1)


def _rendered(args: argparse.Namespace, mi: Any) -> tuple[dict[str, Floats], dict[str, Floats], dict[str, float]]:
    """Return bands and variances (seed, pixel, band) of the coat's pixels by state, and mean seconds by part."""
    design, parts = FingerDesign(), Parts()
    shapes = (rest_shape(design), pressed_shape(design))
    maps = [pixel_maps(design, shape, shapes[0], mi, None) for shape in shapes]
    camera = rendering.CameraWindows.of(design, None, maps)
    images: dict[str, list[Floats]] = {state: [] for state in STATES}
    variances: dict[str, list[Floats]] = {state: [] for state in STATES}
    # what is rendered first only serves to compile
    for number in range(-1, args.seeds):
        parts = Parts() if number <= 0 else parts
        how = RenderSettings("b", args.first_seed + max(number, 0), args.samples, shared_light=not args.own_paths)
        for state, shape, seen in zip(STATES, shapes, maps, strict=True):
            bands, variance = _picture(camera, shape, mi, how, parts)
            if number >= 0:
                images[state].append(bands[seen.sees("coat")])
                variances[state].append(variance[seen.sees("coat")])
    means = {part: seconds / args.seeds for part, seconds in parts.seconds.items()}
    pictures, their_variances = ({state: np.array(one[state]) for state in STATES} for one in (images, variances))
    return pictures, their_variances, means


def _picture(camera: Any, shape: FingerShape, mi: Any, how: RenderSettings, parts: Parts) -> tuple[Floats, Floats]:
    """Return bands and their variance, (rows, columns, 3), as :func:`sim.optics._render.render_state` makes them."""
    design, seed_of = camera.design, partial(rendering.stream_seed, how.seed)
    bands, seed = rendering.check_paints(design, paints()), seed_of(0)
    sensor = camera_sensor(design, mi, None)
    scene = parts.timed("scene", lambda: open_scene(design, shape, bands, mi, sensor))
    guide = parts.timed("guide", lambda: open_guide(scene, design, shape, mi))
    finger, samples = LoadedScene(scene, design, shape, bands, mi), BAKE_SAMPLES[False]
    received = parts.timed("bake", lambda: led_irradiance(finger, seed, samples, guide))
    light = parts.timed("bake", lambda: bake_batches(finger, "b", seed, samples, guide, received))
    if how.shared_light:
        from sim.optics._shared_gathers import SharedGathers  # needs the variant set

        streams = (seed_of(stream) for stream in (rendering.REFLECTED_STREAM, rendering.NODES_STREAM))
        reflected = parts.timed("bake", lambda: reflected_light(finger, light, received, next(streams)))
        tracer = parts.timed("nodes", lambda: SharedGathers(finger, light, reflected, guide, next(streams)))
        chains = tracer.chains
    else:
        tracer, chains = rendering.lit_integrator(scene, design, shape, mi, light, guide)
    # beside the coat, its pixels, and those of the contact, which get more paths
    found: list[Floats] = []
    for number, name in enumerate(("surroundings", "pad", "contact")):
        regions = [(px if k == number else px[:0], n) for k, (px, n) in enumerate(camera.regions(how))]
        work = partial(traced_picture, scene, tracer, mi, chains, regions, seed_of)
        one = parts.timed(f"pixels of the {name}", work)
        found = [a + b for a, b in zip(found, one, strict=True)] if found else list(one)
    of_band = np.array([[last_band(chain) == band for band in BAND_NAMES] for chain in chains], dtype=np.float64)
    return found[0] @ of_band, np.asarray(found[2], dtype=np.float64)


def _noise(images: Floats, reference: Floats | None) -> dict[str, list[float]]:
    """Return the noise of one picture by band, from pictures (seed, pixel, band)."""
    if reference is None:
        scale = np.sqrt(len(images) / (len(images) - 1.0))
        reference = images.mean(axis=0)
    else:
        scale = 1.0
    error = scale * (images - reference)
    light = np.maximum(reference, np.finfo(np.float32).tiny)
    relative, typical = error / reference.mean(axis=0), 0.6745
    square = (relative**2).mean(axis=0)
    inner = np.sort(square, axis=0)[: round((1.0 - RIMS) * len(square))]
    by_pixel = np.sqrt(((error / light) ** 2).mean(axis=0))
    return {
        "median over pixels": [float(v) for v in np.median(by_pixel, axis=0)],
        "rms": [float(v) for v in np.sqrt(square.mean(axis=0))],
        "rms without 1 % of pixels": [float(v) for v in np.sqrt(inner.mean(axis=0))],
        "typical error of a pixel": [float(v) for v in np.median(np.abs(error / light), axis=(0, 1)) / typical],
    }


def _beyond(images: Floats, variances: Floats) -> list[float]:
    """Return the share of pixels that differ between two seeds by more than their 95 % points, by band."""
    if len(images) < 2:
        return [float("nan")] * images.shape[-1]
    sigma = np.sqrt(variances[:-1] + variances[1:])
    return [float(v) for v in (np.abs(np.diff(images, axis=0)) > 1.96 * sigma).mean(axis=(0, 1))]


if __name__ == "__main__":
    main()
