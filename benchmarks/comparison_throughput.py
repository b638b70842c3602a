"""A thousand registered pairs of 640 x 480 images: skill, relative RMS, SSIM and CIEDE2000, beside the public packages.

    python benchmarks/comparison_throughput.py [--pairs 1000] [--threads 2] [--out FILE]

Pairs are made up beforehand and reused in turn, so that only the metrics are timed. Then a few pairs go through
scikit-image (SSIM) and colour-science (CIEDE2000) in the same process, interleaved with ours on one thread. Times are
those of the thread's processor, so that the ratio holds on a busy machine too.
"""

import argparse
import json
import resource
import time
from concurrent.futures import ThreadPoolExecutor
from itertools import cycle, islice
from pathlib import Path

import colour
import cv2
import numpy as np
from skimage.metrics import structural_similarity as scikit_image_ssim

from finray_calib.compare.colour_difference import colour_difference_map, colour_difference_within
from finray_calib.compare.displayed_images import display_white_dn, displayed_image
from finray_calib.compare.regions import disc
from finray_calib.compare.relative_rms import relative_rms
from finray_calib.compare.skill import skill_score
from finray_calib.compare.structural_similarity import structural_similarity

SHAPE, DATA_RANGE_DN, DIFFERENT = (480, 640), 1023.0, 8
SECONDS_ALLOWED, RATIO_ALLOWED = 60.0, 3.0
REGION = disc(SHAPE, (240.0, 320.0), 150.0)
AROUND = slice(90, 391), slice(170, 471)


def press(seed):
    """Return render, capture and no-contact image of a made-up press, DN."""
    rng = np.random.default_rng(seed)
    rows, columns = np.mgrid[: SHAPE[0], : SHAPE[1]]
    pad = np.stack([300 + 0.4 * columns, 500 - 0.3 * columns, 200 + 0.5 * rows], axis=2)
    bump = np.exp(-(((rows - 240) / 75) ** 2 + ((columns - 320) / 75) ** 2))[..., None]
    noisy = [pad * (1 - d * bump) + 4 * rng.standard_normal(pad.shape) for d in (0.33, 0.3, 0.0)]
    return tuple(np.clip(image, 0, DATA_RANGE_DN) for image in noisy)


def compare(images):
    """Return the four metrics of one pair over the region; structural similarity over the whole frame as well."""
    simulated, captured, no_contact = images
    white_dn = display_white_dn(no_contact)
    similarity = structural_similarity(simulated, captured, DATA_RANGE_DN)
    near = [image[AROUND] for image in images]
    shown = [displayed_image(image, white_dn, linear=True) for image in near[:2]]
    return (
        skill_score(*near, REGION[AROUND]).skill,
        relative_rms(*near[:2], REGION[AROUND]),
        (similarity.mean, similarity.mean_within(REGION)),
        colour_difference_within(*shown, REGION[AROUND]),
    )


def thread_s(function):
    """Return the processor time of a call and its result."""
    start = time.thread_time()
    result = function()
    return time.thread_time() - start, result


def lab(image):
    return colour.XYZ_to_Lab(colour.sRGB_to_XYZ(image))


def beside_packages(pairs, rounds=9):
    """Return (what, our median s, the package's median s, largest difference of the maps)."""
    times = {name: ([], []) for name in ("SSIM", "CIEDE2000")}
    apart = dict.fromkeys(times, 0.0)
    for number in range(rounds):
        simulated, captured, no_contact = pairs[number % len(pairs)]
        shown = [displayed_image(i, display_white_dn(no_contact), linear=True) for i in (simulated, captured)]
        runs = {
            "SSIM": (
                lambda a=simulated, b=captured: structural_similarity(a, b, DATA_RANGE_DN).ssim_map[5:-5, 5:-5],
                lambda a=simulated, b=captured: scikit_image_ssim(
                    a, b, data_range=DATA_RANGE_DN, channel_axis=2, gaussian_weights=True, sigma=1.5,
                    use_sample_covariance=False, full=True,
                )[1][5:-5, 5:-5].mean(axis=2),
            ),
            "CIEDE2000": (
                lambda s=shown: colour_difference_map(*s),
                lambda s=shown: colour.delta_E(lab(s[0]), lab(s[1]), method="CIE 2000"),
            ),
        }  # fmt: skip
        for name, functions in runs.items():
            results = [thread_s(function) for function in functions]
            for seconds, (spent, _) in zip(times[name], results, strict=True):
                seconds.append(spent)
            apart[name] = max(apart[name], float(np.abs(results[0][1] - results[1][1]).max()))
    return [(name, *(float(np.median(t)) for t in both), apart[name]) for name, both in times.items()]


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--pairs", type=int, default=1000)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--out", type=Path)
    arguments = parser.parse_args()
    cv2.setNumThreads(1)
    pairs = [press(seed) for seed in range(DIFFERENT)]
    compare(pairs[0])
    start, spent = time.perf_counter(), time.process_time()
    with ThreadPoolExecutor(arguments.threads) as pool:
        skills = [result[0] for result in pool.map(compare, islice(cycle(pairs), arguments.pairs))]
    wall_s, cpu_s = time.perf_counter() - start, time.process_time() - spent
    memory_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    each_ms, spent_ms = 1e3 * wall_s / arguments.pairs, 1e3 * cpu_s / arguments.pairs
    print(f"{arguments.pairs} pairs, {arguments.threads} threads: {wall_s:.1f} s, {each_ms:.0f} ms a pair (processor")
    print(f"{spent_ms:.0f} ms), at most {memory_mb:.0f} MB, mean skill {np.mean(skills):.3f}")
    print(f"1,000 pairs: {each_ms:.0f} s; bar {SECONDS_ALLOWED:.0f} s: {met(each_ms < SECONDS_ALLOWED)}")
    found = {"seconds_1000": each_ms, "memory_mb": memory_mb}
    for name, ours_s, theirs_s, apart in beside_packages(pairs):
        ratio = theirs_s / ours_s
        found[f"{name.lower()}_ratio"] = ratio
        print(f"{name}: {1e3 * ours_s:.1f} ms, package {1e3 * theirs_s:.1f} ms, ratio {ratio:.2f}", end=" ")
        print(f"(bar {RATIO_ALLOWED:g}: {met(ratio >= RATIO_ALLOWED)}), maps differ by at most {apart:.1e}")
    if arguments.out is not None:
        arguments.out.parent.mkdir(parents=True, exist_ok=True)
        arguments.out.write_text(json.dumps(found))


def met(holds):
    return "met" if holds else "NOT met"


if __name__ == "__main__":
    main()
