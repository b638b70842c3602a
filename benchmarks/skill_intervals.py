"""How often the interval over presses holds the skill of all: samples of the presses of a comparison that was made.

    python -m benchmarks.skill_intervals SCORES/summary.json [--samples 400]

The presses of one simulator are the population, and its skill over all of them the truth. Samples of 3, 5, 8 and 12
presses are drawn without replacement, so that more of the truth is held than of an endless population: by the share of
presses that the sample has. Beside it stands the interval of one press over its pixels, which holds far less.
"""

import argparse
from pathlib import Path

import numpy as np

from data_schemas import ComparisonBatch
from data_schemas.storage import read_record
from finray_calib.compare import skill_over_presses

SIZES = (3, 5, 8, 12)


def main() -> None:
    """Print the coverage of each size of sample."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("summary", type=Path)
    parser.add_argument("--samples", type=int, default=400)
    arguments = parser.parse_args()
    batch = read_record(arguments.summary, ComparisonBatch)
    for score in batch.simulators:
        pairs = [p for p in batch.pairs if p.simulator == score.simulator and p.skill is not None]
        whole = skill_over_presses(pairs)
        if whole is None:
            continue
        truth, rng = whole.estimate, np.random.default_rng(1)
        print(f"{score.simulator}: skill {truth:.4f} of {len(pairs)} presses")
        inside = np.mean([p.skill.low95 <= truth <= p.skill.high95 for p in pairs if p.skill is not None])
        print(f"  over the pixels of one press: holds {inside:.2f}")
        for size in (n for n in SIZES if n < len(pairs)):
            found = [
                skill_over_presses([pairs[i] for i in rng.choice(len(pairs), size, replace=False)])
                for _ in range(arguments.samples)
            ]
            held = np.mean([f.low95 <= truth <= f.high95 for f in found])
            own = all(f.low95 < f.estimate < f.high95 <= 1.0 for f in found)
            width = np.median([f.high95 - f.low95 for f in found])
            print(f"  {size:2d} presses: holds {held:.3f}, width {width:.3f}, its own estimate always {own}")


if __name__ == "__main__":
    main()
