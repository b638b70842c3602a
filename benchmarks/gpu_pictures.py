"""The picture of a pressed finger on a GPU beside the same by LLVM: the same light within noise, and the time it takes.

    python -m benchmarks.gpu_pictures [--width 640] [--samples 64] [--seeds 6] [--levels b c] [--out FILE]

Each engine renders in a process of its own, first with a seed that compiles its kernels, then with seeds of its own;
both states of the finger, bakes included. For each band and 5 mm along the coat the means over the seeds are compared
by Welch's t, and Holm's step over all of them rejects at 1 %. Time to equal error is seconds of the clock times the
mean variance of the coat's pixels between seeds. Bars: nothing rejected; less time on the GPU.
"""

import argparse
import json
import os
import subprocess
import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from benchmarks.fluorescence_levels import finger, paints
from sim.optics import BAND_NAMES, RenderSettings, choose_variant, open_renderer, render_press

STRIP_MM = 5.0
REJECTED_AT = 0.01
ENGINES = ("llvm", "cuda")


class Pictures(NamedTuple):
    """Band radiance of strips (seed, strip, band), mean variance between seeds and mean (band,), seconds."""

    strips: NDArray[np.float64]
    pixel_variance: NDArray[np.float64]
    mean: NDArray[np.float64]
    first_s: float
    again_s: float


def main() -> int:
    """Print the comparison and return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--width", type=int, default=640, help="photosites; the picture has half as many columns")
    parser.add_argument("--samples", type=int, default=64)
    parser.add_argument("--seeds", type=int, default=6)
    parser.add_argument("--levels", nargs="+", default=["b", "c"], choices=["b", "c"])
    parser.add_argument("--out", type=Path)
    parser.add_argument("--child", choices=ENGINES, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.child is not None:
        _render(arguments)
        return 0
    told = {}
    for level in arguments.levels:
        llvm, cuda = (pictures(e, level, arguments.width, arguments.samples, arguments.seeds) for e in ENGINES)
        told[level] = compared(llvm, cuda)
        print(f"level {level}: {json.dumps(told[level])}")
    if arguments.out is not None:
        arguments.out.parent.mkdir(parents=True, exist_ok=True)
        arguments.out.write_text(json.dumps(told, indent=1) + "\n")
    return int(any(one["rejected"] for one in told.values()))


def pictures(engine: str, level: str, width_px: int, samples: int, seeds: int) -> Pictures:
    """Render with an engine in a process of its own.

    Parameters
    ----------
    engine
        "llvm" or "cuda".
    level
        How the walls emit, "b" or "c".
    width_px
        Photosites of the camera.
    samples
        Paths per pixel.
    seeds
        Pictures after the first; those of the engines have different seeds.
    """
    with TemporaryDirectory() as folder:
        file = Path(folder) / "pictures.npz"
        words = ["--child", engine, "--width", width_px, "--samples", samples, "--seeds", seeds]
        command = [sys.executable, "-m", "benchmarks.gpu_pictures", *words, "--levels", level, "--out", file]
        subprocess.run([str(word) for word in command], check=True, cwd=Path(__file__).parents[1], env=os.environ)
        with np.load(file, allow_pickle=False) as found:
            return Pictures(*(found[name] for name in Pictures._fields))


def _render(arguments: argparse.Namespace) -> None:
    """Render and store what is compared."""
    mi = open_renderer(choose_variant(arguments.child))
    design, first = finger(arguments.width), 1000 * ENGINES.index(arguments.child)
    images, times_s = [], []
    for seed in range(first, first + arguments.seeds + 1):
        settings = RenderSettings(arguments.levels[0], seed=seed, samples_per_pixel=arguments.samples)
        begun = time.monotonic()
        render = render_press(design, paints(), mi, settings)
        times_s.append(time.monotonic() - begun)
        images.append(render.contact_bands.astype(np.float64))
    seen = render.contact_maps.sees("coat")
    along = np.floor(render.contact_maps.coat_mm(design)[seen][:, 1] / STRIP_MM)
    coat = np.array(images[1:])[:, seen]
    strips = np.stack([coat[:, along == k].mean(axis=1) for k in np.unique(along)], axis=1)
    values = Pictures(
        strips, coat.var(axis=0, ddof=1).mean(axis=0), coat.mean(axis=(0, 1)), times_s[0], float(np.median(times_s[1:]))
    )
    np.savez(arguments.out, **values._asdict())


def compared(llvm: Pictures, cuda: Pictures) -> dict[str, Any]:
    """Return per band the ratio of the engines with its standard error, what Holm's step rejects, and times."""
    p = np.sort(stats.ttest_ind(llvm.strips, cuda.strips, axis=0, equal_var=False).pvalue.ravel())
    rejected = bool((p <= REJECTED_AT / np.arange(len(p), 0, -1)).cumprod().any())
    means = [one.strips.mean(axis=1) for one in (llvm, cuda)]
    errors = [m.std(axis=0, ddof=1) / np.sqrt(len(m)) / m.mean(axis=0) for m in means]
    cost = [one.again_s * one.pixel_variance / one.mean**2 for one in (llvm, cuda)]
    ratio, error, faster = means[1].mean(axis=0) / means[0].mean(axis=0), np.hypot(*errors), cost[0] / cost[1]
    return {
        "ratio": _by_band(ratio),
        "standard_error": _by_band(error),
        "strips": len(p),
        "least_p": float(p[0]),
        "rejected": rejected,
        "first_s": {"llvm": float(llvm.first_s), "cuda": float(cuda.first_s)},
        "again_s": {"llvm": float(llvm.again_s), "cuda": float(cuda.again_s)},
        "times_faster_to_equal_error": _by_band(faster),
    }


def _by_band(values: NDArray[np.float64]) -> dict[str, float]:
    return {name: round(float(value), 4) for name, value in zip(BAND_NAMES, values, strict=True)}


if __name__ == "__main__":
    sys.exit(main())
