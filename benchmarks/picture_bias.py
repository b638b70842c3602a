"""Noise and bias by place of pictures whose pixels share light, against the path tracer or against own paths.

    python -m benchmarks.picture_bias --own-paths [--state rest] [--preset NAME] [--rounds 8] [--out FILE]
    python -m benchmarks.picture_bias [--width 160] [--samples 128] [--reference 512] [--seeds 4] [--out FILE]

With ``--own-paths`` only what is shared is compared: each pixel traces that light by paths of its own, 1 million in
each round, and looks the same light up as a picture does. All else is common to both and cancels. Strips and squares
of 5 mm, relative to all light of the band there, with standard errors: of the own paths over the rounds, and of the
nodes over their batches.

Without it, both render a pressed finger with the same seeds, so with the same baked walls: what the walls' noise does
is common to both and cancels. For each band: the ratio of the coat's mean, and of blocks of 5 mm along the pad and
across it, with standard errors over the seeds; the noise that each picture claims, relative to the band's mean, and
processor seconds.
Bar: no block off by more than 1 % plus 3 standard errors.
"""

import argparse
import json
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.fluorescence_levels import finger, paints
from data_schemas import FingerDesign
from sim import preset_design
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
from sim.optics._painted_walls import BATCHES, bake_batches, led_irradiance, reflected_light
from sim.optics._path_rules import LookupTable, cell_at
from sim.optics._pixel_maps import camera_rays
from sim.surface_meshes import FingerShape, pressed_shape, rest_shape

Floats = NDArray[np.float64]

BIAS_BAR_REL = 0.01
ERRORS = 3.0
BLOCK_MM = 5.0
FEWEST_PIXELS = 20
FEWEST_PATHS = 500
_LOOKED_UP = 6
"""Blocks of fewer pixels, at the rim, say nothing."""


def main() -> None:
    """Print ratios and noise and leave 1 when a block is outside the bar."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--own-paths", action="store_true", help="each pixel traces by itself what it else shares")
    parser.add_argument("--state", choices=("pressed", "rest"), default="pressed", help="of the finger, for own paths")
    parser.add_argument("--preset", help="ready-made finger, for own paths; else the default one")
    parser.add_argument("--rounds", type=int, default=8, help="rounds of a million own paths")
    parser.add_argument("--node-paths", type=int, default=1, help="times the default's paths of the nodes")
    parser.add_argument("--seed", type=int, default=0, help="of bake and nodes, for own paths")
    parser.add_argument("--width", type=int, help="photosites; the picture has half as many columns")
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


@dataclass(frozen=True, slots=True)
class _Round:
    """Light per path (path, band) of a round: own, shared, all other; place (path, 2) and batch of each."""

    own: Floats
    shared: Floats
    rest: Floats
    place_mm: Floats
    batch: NDArray[np.int64]

    def by_block(self, number: NDArray[np.int64], blocks: int) -> tuple[Floats, Floats, Floats]:
        """Return own and other light per block (block, band), and shared light per batch (batch, block, band)."""

        def means(values: Floats, group: NDArray[np.int64], groups: int) -> Floats:
            count = np.maximum(np.bincount(group, minlength=groups), 1)
            return np.stack([np.bincount(group, weights=v, minlength=groups) / count for v in values.T], axis=-1)

        by_batch = means(self.shared, self.batch * blocks + number, BATCHES * blocks)
        return means(self.own, number, blocks), means(self.rest, number, blocks), by_batch.reshape(BATCHES, blocks, -1)


def _own_paths(args: argparse.Namespace, mi: Any) -> bool:
    """Print and write how far shared light is off where pixels trace it themselves; return whether the bar is met."""
    design = finger(args.width or 640)
    if args.preset:
        preset, size = preset_design(args.preset), design.camera
        same = preset.camera.model_copy(update={"width_px": size.width_px, "height_px": size.height_px})
        design = preset.model_copy(update={"camera": same})
    gathers = _gathers(design, pressed_shape(design) if args.state == "pressed" else rest_shape(design), mi, args)
    rounds = [_one_round(gathers, design, mi, 1000 * args.seed + k) for k in range(args.rounds)]
    numbers = [np.floor(one.place_mm / BLOCK_MM).astype(np.int64) for one in rounds]
    numbers = [one - numbers[0].min(axis=0) for one in numbers]
    across = 1 + max(one[:, 0].max() for one in numbers)
    found, met = {}, True
    for name, (by_x, by_z) in {"along": (0, 1), "across": (1, 0), "squares": (1, across)}.items():
        bias, error = _off(rounds, [by_x * one[:, 0] + by_z * one[:, 1] for one in numbers])
        good = np.abs(bias) <= BIAS_BAR_REL + ERRORS * error
        met &= bool(good.all())
        excess = np.sqrt(np.maximum((bias**2 - error**2).mean(axis=0), 0.0))
        print(
            f"{name}: {(~good).sum(axis=0)} of {len(good)} outside (red, green, LED); rms beyond the errors "
            f"{np.round(100 * excess, 2)} %, median error {np.round(100 * np.median(error, axis=0), 2)} %"
        )
        for band, b, e in zip(BAND_NAMES, bias.T, error.T, strict=True):
            if name != "squares":
                print(f"  {band}: " + " ".join(f"{100 * v:+.1f}({100 * w:.1f})" for v, w in zip(b, e, strict=True)))
        found[name] = {"bias_rel": bias.tolist(), "error_rel": error.tolist()}
    if args.out is not None:
        args.out.parent.mkdir(parents=True, exist_ok=True)
        args.out.write_text(json.dumps({"state": args.state, "places": found, "met": met}, indent=1))
    return met


def _off(rounds: list[_Round], numbers: list[NDArray[np.int64]]) -> tuple[Floats, Floats]:
    """Return shared less own light over all light by block and band, (block, 3), and its standard error."""
    blocks = 1 + max(int(number.max()) for number in numbers)
    found = [one.by_block(number, blocks) for one, number in zip(rounds, numbers, strict=True)]
    own, rest, shared = (np.array([one[k] for one in found]) for k in range(3))
    own_variance, by_batch = own.var(axis=0, ddof=1) / len(own), shared.mean(axis=0)
    light = own.mean(axis=0) + rest.mean(axis=0)
    lit = np.bincount(numbers[0], minlength=blocks) >= FEWEST_PATHS
    variance = own_variance + by_batch.var(axis=0, ddof=1) / len(by_batch)
    return ((by_batch.mean(axis=0) - own.mean(axis=0)) / light)[lit], (np.sqrt(variance) / light)[lit]


def _gathers(design: FingerDesign, shape: FingerShape, mi: Any, args: argparse.Namespace) -> Any:
    """Return what shares light, with the mean of the baked walls in all batches."""
    from sim.optics import _shared_gathers  # needs the variant set

    bands, seed = paint_bands(*paints().values(), design.light), 10 * args.seed
    scene = open_scene(design, shape, bands, mi)
    guide, lit = open_guide(scene, design, shape, mi), LoadedScene(scene, design, shape, bands, mi)
    received = led_irradiance(lit, seed, guide=guide)
    light = bake_batches(lit, "b", seed, guide=guide, received=received)
    reflected = reflected_light(lit, light, received, seed + 1)
    even = {chain: np.repeat(v.mean(axis=0, keepdims=True), len(v), axis=0) for chain, v in light.items()}
    everywhere = np.repeat(reflected.mean(axis=0, keepdims=True), len(reflected), axis=0)
    _shared_gathers.RAYS *= args.node_paths
    begun = time.process_time()
    gathers = _shared_gathers.SharedGathers(lit, even, everywhere, guide, seed + 7)
    print(f"nodes: {time.process_time() - begun:.1f} s of processor time")
    return gathers


def _one_round(gathers: Any, design: FingerDesign, mi: Any, seed: int) -> _Round:
    """Trace own paths, and look shared light up, where the rays of pixels meet the coat."""
    import drjit as dr

    from sim.optics import _shared_gathers as sharing

    rays = camera_rays(design).reshape(-1, 3)
    per_pixel, scene = max(1, round(1e6 / len(rays))), gathers.finger.scene
    count = len(rays) * per_pixel
    way = LookupTable(np.column_stack([rays, np.zeros(len(rays))]), mi).row(dr.arange(mi.UInt32, count) // per_pixel)
    centre = mi.Point3f(camera_pose(design).centre_mm.tolist())
    sight = sharing.Sight.along(gathers, scene, mi.Ray3f(centre, mi.Vector3f(way.x, way.y, way.z)))
    si, here = sight.si, sight.on_coat
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(seed, count)
    batch = cell_at(sampler.next_1d() * gathers.batches, gathers.batches)
    towards, density = gathers.drawn(si, [sampler.next_1d() for _ in range(4)], 0.0)
    drawn = here & (density > 0.0)
    arriving = sharing.arriving_light(gathers, scene, sampler, si.spawn_ray(towards), batch)
    value = si.bsdf().eval(mi.BSDFContext(), si, si.to_local(towards), here)
    own = [dr.select(drawn, a * value[b] / density, 0) for a, b in zip(arriving, gathers.band_of, strict=True)]
    shift = [sampler.next_1d() for _ in range(8)]
    looked = [sharing.own_light(gathers, si, here)]
    looked += [sharing.shared_light(gathers, si, shift, mi.UInt32(k), _LOOKED_UP, here) for k in range(_LOOKED_UP)]
    shared = [sum(one[k] for one in looked) for k in range(len(own))]
    rest = sharing.straight_light(gathers, scene, si, shift, mi.UInt32(0), here)
    rest[2] += sharing.mirrored_light(gathers, scene, sampler, si, shift, mi.UInt32(0), here)
    dr.eval(own, shared, rest, here, si.uv, batch)
    seen, of_band = here.numpy(), np.eye(len(BAND_NAMES))[gathers.band_of]
    light = (np.stack([np.array(v) for v in values], axis=-1)[seen] @ of_band for values in (own, shared, rest))
    place_mm = si.uv.numpy().T[seen] * [design.pad.width_mm, design.pad.length_mm]
    return _Round(*light, place_mm, batch.numpy()[seen].astype(np.int64))


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
