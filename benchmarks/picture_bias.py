"""Noise and bias by place of pictures whose pixels share light, against the path tracer.

    python -m benchmarks.picture_bias [--width 160] [--samples 128] [--reference 512] [--seeds 4] [--out FILE]

Both render a pressed finger with the same seeds, so with the same baked walls: what the walls' noise does is common to
both and cancels. For each band: the ratio of the coat's mean, and of blocks of 5 mm along the pad and across it, with
standard errors over the seeds; the noise that each picture claims, relative to the band's mean, and processor seconds.
Bar: no block off by more than 1 % plus 3 standard errors.
"""

import argparse
import json
import time
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.fluorescence_levels import finger, paints
from sim.optics import BAND_NAMES, PressRender, RenderSettings, choose_variant, open_renderer, render_press

Floats = NDArray[np.float64]

BIAS_BAR_REL = 0.01
ERRORS = 3.0
BLOCK_MM = 5.0
FEWEST_PIXELS = 20
"""Blocks of fewer pixels, at the rim, say nothing."""


def main() -> None:
    """Print ratios and noise and leave 1 when a block is outside the bar."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--width", type=int, default=160, help="photosites; the picture has half as many columns")
    parser.add_argument("--samples", type=int, default=128, help="paths per pixel that share light, as in a render")
    parser.add_argument("--reference", type=int, default=512, help="paths per pixel of the path tracer")
    parser.add_argument("--seeds", type=int, default=4)
    parser.add_argument("--out", type=Path)
    args = parser.parse_args()
    mi = open_renderer(choose_variant("llvm"))
    design, times = finger(args.width), np.zeros(2)
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
