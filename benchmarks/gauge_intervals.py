"""Do the intervals of a gauge study hold the truth as often as they say?

    python benchmarks/gauge_intervals.py [--studies 4000]

Draws balanced studies from known standard deviations (normal effects) and counts how often the 95 % intervals of
``finray check gauge-rr`` hold the truth: of the measurement's standard deviation, the samples', and the number of
distinct categories. Exit status 1 when a rate leaves 0.93 to 0.97.
"""

import argparse
import sys

import numpy as np

from finray_calib.acceptance import gauge_study

DESIGNS = (
    ("5 samples x 6 sessions x 2 mounts x 2 repeats", (5, 6, 2, 2)),
    ("10 samples x 3 sessions x 3 repeats", (10, 3, 1, 3)),
    ("5 samples x 10 sessions x 2 mounts x 3 repeats", (5, 10, 2, 3)),
)
EFFECTS = (
    ("sessions differ most", (1.0, 0.30, 0.10, 0.10, 0.10)),
    ("mounts differ most", (1.0, 0.10, 0.05, 0.30, 0.10)),
    ("repeats differ most", (1.0, 0.05, 0.05, 0.05, 0.30)),
    ("no interaction", (1.0, 0.20, 0.00, 0.20, 0.20)),
)


def study(rng: np.random.Generator, shape: tuple[int, ...], sds: tuple[float, ...]) -> np.ndarray:
    """Return the values of one study; without mounts of their own, that effect is left out."""
    p, s, m, r = shape
    mounts = sds[3] if m > 1 else 0.0
    draw = rng.standard_normal
    return (
        sds[0] * draw((p, 1, 1, 1)) + sds[1] * draw((1, s, 1, 1)) + sds[2] * draw((p, s, 1, 1))
        + mounts * draw((p, s, m, 1)) + sds[4] * draw((p, s, m, r))
    )  # fmt: skip


def coverage(shape: tuple[int, ...], sds: tuple[float, ...], studies: int) -> list[float]:
    """Return how often each interval holds the truth."""
    rng = np.random.default_rng(1)
    kept = [*sds[1:3], sds[3] if shape[2] > 1 else 0.0, sds[4]]
    gauge = float(np.linalg.norm(kept))
    hits = np.zeros(3)
    for _ in range(studies):
        found = gauge_study(study(rng, shape, sds))
        truths = (gauge, sds[0], np.sqrt(2.0) * sds[0] / gauge)
        intervals = (found.gauge_sd, found.sample_sd, found.categories)
        hits += [i.low95 <= truth <= i.high95 for i, truth in zip(intervals, truths, strict=True)]
    return list(hits / studies)


def main() -> int:
    """Print the table and return the exit status."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--studies", type=int, default=4000)
    arguments = parser.parse_args()
    print("| design | effects | measurement's sd (MLS) | samples' sd | distinct categories |\n|---|---|---|---|---|")
    every = []
    for design, shape in DESIGNS:
        for effects, sds in EFFECTS:
            rates = coverage(shape, sds, arguments.studies)
            every += rates
            print(f"| {design} | {effects} | {' | '.join(f'{rate:.3f}' for rate in rates)} |", flush=True)
    return 0 if all(0.93 <= rate <= 0.97 for rate in every) else 1


if __name__ == "__main__":
    sys.exit(main())
