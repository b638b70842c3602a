"""Noise and bias by place of pictures whose pixels share light, against the path tracer or against own paths.

    python -m benchmarks.picture_bias --own-paths [--state rest] [--width 640] [--rounds 6] [--out FILE]
    python -m benchmarks.picture_bias [--width 160] [--samples 128] [--reference 512] [--seeds 4] [--out FILE]

With ``--own-paths`` (half a minute of processor time) only what is shared is compared: each pixel traces that light by
paths of its own, 1 million in each round, and looks the same light up as a picture does. All else is common to both and
cancels; nodes have twice the default's paths, whose noise stays in the difference and in no error. Strips and squares
of 5 mm, relative to all light of the band there, with standard errors over the rounds.

Without it, both render a pressed finger with the same seeds, so with the same baked walls: what the walls' noise does
is common to both and cancels. For each band: the ratio of the coat's mean, and of blocks of 5 mm along the pad and
across it, with standard errors over the seeds; the noise that each picture claims, relative to the band's mean, and
processor seconds.
Bar: no block off by more than 1 % plus 3 standard errors.
"""

import argparse
import json
import time
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.fluorescence_levels import finger, paints
from data_schemas import FingerDesign
from sim.optics import (
    BAND_NAMES,
    LoadedScene,
    PressRender,
    RenderSettings,
    choose_variant,
    open_guide,
    open_renderer,
    open_scene,
    paint_bands,
    render_press,
)
from sim.optics._optical_layout import camera_pose
from sim.optics._painted_walls import bake_batches, led_irradiance, reflected_light
from sim.optics._path_rules import cell_at
from sim.optics._pixel_maps import camera_rays
from sim.surface_meshes import FingerShape, pressed_shape, rest_shape

Floats = NDArray[np.float64]

BIAS_BAR_REL = 0.01
ERRORS = 3.0
BLOCK_MM = 5.0
_LOOKED_UP = 6
FEWEST_PIXELS = 20
"""Blocks of fewer pixels, at the rim, say nothing."""


def main() -> None:
    """Print ratios and noise and leave 1 when a block is outside the bar."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--width", type=int, help="photosites; the picture has half as many columns")
    parser.add_argument("--own-paths", action="store_true", help="each pixel traces by itself what it else shares")
    parser.add_argument("--state", choices=("pressed", "rest"), default="pressed", help="of the finger, for own paths")
    parser.add_argument("--rounds", type=int, default=6, help="rounds of a million own paths")
    parser.add_argument("--samples", type=int, default=128, help="paths per pixel that share light, as in a render")
    parser.add_argument("--reference", type=int, default=512, help="paths per pixel of the path tracer")
    parser.add_argument("--seeds", type=int, default=4)
    parser.add_argument("--out", type=Path)
    args = parser.parse_args()
    mi = open_renderer(choose_variant("llvm"))
    if args.own_paths:
        raise SystemExit(0 if _own_paths(args, mi) else 1)
    design, times = finger(args.width or 160), np.zeros(2)
    renders: list[tuple[PressRender, PressRender]] = []
    for seed in range(args.seeds):
        pair = []
        for kind, (shared, samples) in enumerate(((True, args.samples), (False, args.reference))):
            how = RenderSettings("b", seed, samples, samples, shared_light=shared)
            begun = time.process_time()
            pair.append(render_press(design, paints(), mi, how))
            times[kind] += time.process_time() - begun
        renders.append((pair[0], pair[1]))
    blocks = _blocks(renders[0][0].contact_maps.coat_mm(design))
    ratios = {name: _ratios(renders, block) for name, block in blocks.items()}
    met = _told(ratios)
    noise = {kind: _noise(renders, k, blocks["coat"]) for k, kind in enumerate(("shared", "path tracer"))}
    for k, (kind, of_bands) in enumerate(noise.items()):
        told = ", ".join(f"{band} {value:.1%}" for band, value in zip(BAND_NAMES, of_bands, strict=True))
        print(f"{kind}: noise {told}; {times[k] / args.seeds:.1f} s of processor time, both states")
    if args.out is not None:
        args.out.parent.mkdir(parents=True, exist_ok=True)
        found = {name: {"ratio": r.tolist(), "error": e.tolist()} for name, (r, e) in ratios.items()}
        args.out.write_text(json.dumps({"blocks": found, "noise_rel": noise, "met": met}, indent=1))
    raise SystemExit(0 if met else 1)


def _own_paths(args: argparse.Namespace, mi: Any) -> bool:
    """Print and write how far shared light is off where pixels trace it themselves; return whether the bar is met."""
    design = finger(args.width or 640)
    gathers = _gathers(design, pressed_shape(design) if args.state == "pressed" else rest_shape(design), mi)
    rounds = [_one_round(gathers, design, mi, seed) for seed in range(args.rounds)]
    place_mm = rounds[0][0] * [design.pad.width_mm, design.pad.length_mm]
    x, z = np.floor(place_mm / BLOCK_MM).astype(np.int64).T
    found, met = {}, True
    for name, number in (("along", z), ("across", x), ("squares", z * (x.max() + 1) + x)):
        bias, error = _off(rounds, number)
        good = np.abs(bias) <= BIAS_BAR_REL + ERRORS * error
        met &= bool(good.all())
        print(f"{name}: {(~good).sum(axis=0)} of {len(good)} outside (red, green, LED)")
        excess = np.sqrt(np.maximum((bias**2 - error**2).mean(axis=0), 0.0))
        print(
            f"  rms {np.round(100 * excess, 2)} % beyond the errors of {np.round(100 * np.median(error, axis=0), 2)} %"
        )
        if name != "squares":
            for band, b, e in zip(BAND_NAMES, bias.T, error.T, strict=True):
                print(f"  {band}: " + " ".join(f"{100 * v:+.1f}({100 * w:.1f})" for v, w in zip(b, e, strict=True)))
        found[name] = {"bias_rel": bias.tolist(), "error_rel": error.tolist()}
    if args.out is not None:
        args.out.parent.mkdir(parents=True, exist_ok=True)
        args.out.write_text(json.dumps({"state": args.state, "places": found, "met": met}, indent=1))
    return met


def _off(rounds: list[tuple[Floats, Floats, Floats, Floats]], number: NDArray[np.int64]) -> tuple[Floats, Floats]:
    """Return shared less own light over all light by block and band, (block, 3), and its standard error."""

    def by_block(values: Floats) -> Floats:
        return np.stack([np.bincount(number, weights=v) for v in values.T], axis=-1)

    less = np.array([by_block(shared - own) for _, own, shared, _ in rounds])
    light = np.mean([by_block(own + rest) for _, own, _, rest in rounds], axis=0)
    return less.mean(axis=0) / light, less.std(axis=0, ddof=1) / np.sqrt(len(rounds)) / light


def _gathers(design: FingerDesign, shape: FingerShape, mi: Any) -> Any:
    """Return what shares light, with the mean of the baked walls in all batches."""
    from sim.optics import _shared_gathers  # needs the variant set

    bands = paint_bands(*paints().values(), design.light)
    scene = open_scene(design, shape, bands, mi)
    guide, lit = open_guide(scene, design, shape, mi), LoadedScene(scene, design, shape, bands, mi)
    received = led_irradiance(lit, 0, guide=guide)
    light = bake_batches(lit, "b", 0, guide=guide, received=received)
    reflected = reflected_light(lit, light, received, 1)
    _shared_gathers.RAYS *= 2
    even = {chain: np.repeat(v.mean(axis=0, keepdims=True), len(v), axis=0) for chain, v in light.items()}
    everywhere = np.repeat(reflected.mean(axis=0, keepdims=True), len(reflected), axis=0)
    return _shared_gathers.SharedGathers(lit, even, everywhere, guide, 7)


def _one_round(gathers: Any, design: FingerDesign, mi: Any, seed: int) -> tuple[Floats, Floats, Floats, Floats]:
    """Return place (pixel, 2), own, shared and all other light (pixel, band) of the pixels that see the coat."""
    import drjit as dr

    from sim.optics import _shared_gathers as sharing
    from sim.optics._path_rules import LookupTable

    rays = camera_rays(design).reshape(-1, 3)
    per_pixel, scene = max(1, round(1e6 / len(rays))), gathers.finger.scene
    count = len(rays) * per_pixel
    lane = dr.arange(mi.UInt32, count)
    pixel = lane // per_pixel
    way = LookupTable(np.column_stack([rays, np.zeros(len(rays))]), mi).row(pixel)
    centre = mi.Point3f(camera_pose(design).centre_mm.tolist())
    sight = sharing.Sight.along(gathers, scene, mi.Ray3f(centre, mi.Vector3f(way.x, way.y, way.z)))
    si, here = sight.si, sight.on_coat
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(seed, count)
    gathers.batch_of_lane = cell_at(sampler.next_1d() * gathers.batches, gathers.batches)
    towards, density = gathers.drawn(si, [sampler.next_1d() for _ in range(4)], sharing.GUIDE_CHANCE)
    drawn = here & (density > 0.0)
    arriving = gathers.arriving_along(si.spawn_ray(towards), sampler, drawn)
    value = si.bsdf().eval(mi.BSDFContext(), si, si.to_local(towards), here)
    own = [dr.select(drawn, a * value[b] / density, 0) for a, b in zip(arriving, gathers.band_of, strict=True)]
    shift = [sampler.next_1d() for _ in range(8)]
    gathers.counts = sharing.GatherCounts(directions=_LOOKED_UP)
    looked = [sharing.shared_light(gathers, si, shift, mi.UInt32(k), here) for k in range(_LOOKED_UP)]
    shared = [sum(one[k] for one in looked) for k in range(len(own))]
    rest = sharing.straight_light(gathers, scene, si, shift, mi.UInt32(0), here)
    rest[2] += sharing.mirrored_light(gathers, scene, sampler, si, shift, mi.UInt32(0), here)
    dr.eval(own, shared, rest, here, si.uv)
    seen = here.numpy().reshape(-1, per_pixel)[:, 0]
    of_band = np.eye(len(BAND_NAMES))[gathers.band_of]
    light = [
        np.stack([np.array(v) for v in values], axis=-1).reshape(len(rays), per_pixel, -1).mean(axis=1)[seen] @ of_band
        for values in (own, shared, rest)
    ]
    return si.uv.numpy().T.reshape(len(rays), per_pixel, 2)[seen, 0], light[0], light[1], light[2]


def _blocks(place_mm: Floats) -> dict[str, NDArray[np.bool_]]:
    """Return the pixels of the whole coat and of each block, by the place (z, x) that they see."""
    blocks = {"coat": np.isfinite(place_mm[..., 0])}
    for axis, name in enumerate("zx"):
        number = np.floor(place_mm[..., axis] / BLOCK_MM)
        for k in np.unique(number[blocks["coat"]]):
            here = number == k
            if here.sum() >= FEWEST_PIXELS:
                blocks[f"{name} {k * BLOCK_MM:+.0f} to {(k + 1) * BLOCK_MM:+.0f} mm"] = here
    return blocks


def _ratios(renders: list[tuple[PressRender, PressRender]], block: NDArray[np.bool_]) -> tuple[Floats, Floats]:
    """Return the ratio of shared to path traced light in a block per band, and its standard error over the seeds."""
    sums = np.array([[one.contact_bands[block].sum(axis=0, dtype=np.float64) for one in pair] for pair in renders])
    ratio = sums[:, 0].sum(axis=0) / sums[:, 1].sum(axis=0)
    rest = sums[:, 0] - ratio * sums[:, 1]
    return ratio, rest.std(axis=0, ddof=1) * np.sqrt(len(sums)) / sums[:, 1].sum(axis=0)


def _told(ratios: dict[str, tuple[Floats, Floats]]) -> bool:
    """Print the ratios and return whether all are within the bar."""
    met = True
    for name, (ratio, error) in ratios.items():
        good = np.abs(ratio - 1.0) <= BIAS_BAR_REL + ERRORS * error
        met &= bool(good.all())
        told = [f"{band} {r:.3f} +- {e:.3f}" for band, r, e in zip(BAND_NAMES, ratio, error, strict=True)]
        print(f"{name:18s} {', '.join(told)}{'' if good.all() else '  outside'}")
    return met


def _noise(renders: list[tuple[PressRender, PressRender]], kind: int, coat: NDArray[np.bool_]) -> list[float]:
    """Return the claimed noise per band, root mean square over the coat, relative to the band's mean."""
    variance = np.mean([pair[kind].contact_variance[coat].mean(axis=0) for pair in renders], axis=0)
    mean = np.mean([pair[kind].contact_bands[coat].mean(axis=0) for pair in renders], axis=0)
    return [float(v) for v in np.sqrt(variance) / mean]


if __name__ == "__main__":
    main()
