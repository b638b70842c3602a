"""Whether pictures with other random numbers differ as much as the variance of each says.

    python -m benchmarks.render_noise [--width 640] [--samples 64] [--seeds 4] [--out FILE]

For every pair of seeds and each band: the share of the coat's pixels that differ by more than their 95 % points,
dark pixels included, and the spread that is claimed beside the one that is seen, relative to the band's mean. Bar: 4 to
6 % beyond (5 % by definition; pixels of rare, bright light keep it from being exact).
"""

import argparse
import json
from itertools import combinations
from pathlib import Path

import numpy as np

from benchmarks.fluorescence_levels import paints
from data_schemas import FingerDesign
from sim.optics import BAND_NAMES, RenderSettings, choose_variant, open_renderer, render_press

LEAST, MOST = 0.04, 0.06
POINT = 1.96


def main() -> None:
    """Print the shares and leave 1 when one is outside the bar."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--width", type=int, default=640, help="photosites; the picture has half as many columns")
    parser.add_argument("--samples", type=int, default=64)
    parser.add_argument("--seeds", type=int, default=4)
    parser.add_argument("--out", type=Path)
    args = parser.parse_args()
    mi = open_renderer(choose_variant("llvm"))
    design = FingerDesign()
    camera = design.camera.model_copy(update={"width_px": args.width, "height_px": args.width * 3 // 4})
    design = design.model_copy(update={"camera": camera})
    renders = [
        render_press(design, paints(), mi, RenderSettings(seed=seed, samples_per_pixel=args.samples))
        for seed in range(args.seeds)
    ]
    coat = renders[0].contact_maps.sees("coat")
    images = np.array([render.contact_bands[coat] for render in renders], dtype=np.float64)
    variances = np.array([render.contact_variance[coat] for render in renders], dtype=np.float64)
    pairs = list(combinations(range(args.seeds), 2))
    beyond = np.mean(
        [np.abs(images[i] - images[j]) > POINT * np.sqrt(variances[i] + variances[j]) for i, j in pairs], axis=(0, 1)
    )
    mean = images.mean(axis=(0, 1))
    claimed, seen = np.sqrt(variances.mean(axis=(0, 1))) / mean, np.sqrt(images.var(axis=0, ddof=1).mean(axis=0)) / mean
    met = bool(((beyond >= LEAST) & (beyond <= MOST)).all())
    for band, *numbers in zip(BAND_NAMES, beyond, claimed, seen, strict=True):
        print(f"{band:6s} beyond {numbers[0]:.2%}, noise claimed {numbers[1]:.1%}, seen {numbers[2]:.1%}")
    if args.out is not None:
        args.out.parent.mkdir(parents=True, exist_ok=True)
        told = {"beyond": beyond.tolist(), "claimed_rel": claimed.tolist(), "seen_rel": seen.tolist(), "met": met}
        args.out.write_text(json.dumps(told, indent=1))
    raise SystemExit(0 if met else 1)


if __name__ == "__main__":
    main()
