"""How often the interval over presses holds the skill of all: samples of the presses of a comparison that was made.

    python -m benchmarks.skill_intervals SCORES/summary.json ... [--samples 400]

The presses of one simulator are the population, and its skill over all of them the truth. Samples of 3, 5, 8 and 12
presses are drawn without replacement, as a smaller set would have been captured: more of the truth is then held than
of an endless population, by the share of presses that the sample has. And they are drawn with replacement, as from an
endless population in which each press is as frequent. The same is done for the difference of every two simulators.
Beside it stands the interval of one press over its pixels, which holds far less.
"""

import argparse
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from data_schemas import ComparedPair, ComparisonBatch, SkillDifference, SkillOverPresses
from data_schemas.storage import read_record
from finray_calib.compare import skill_differences, skill_over_presses

SIZES = (3, 5, 8, 12)
#: An untouched image scores 0 in every press: there is nothing to hold.
LEAST_SPREAD = 1e-6
Result = SkillOverPresses | SkillDifference | None


def main() -> None:
    """Print the coverage of each size of sample."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("summaries", type=Path, nargs="+")
    parser.add_argument("--samples", type=int, default=400)
    arguments = parser.parse_args()
    for path in arguments.summaries:
        batch = read_record(path, ComparisonBatch)
        scored = {
            s.simulator: [p for p in batch.pairs if p.simulator == s.simulator and p.skill is not None]
            for s in batch.simulators
        }
        scored = {name: pairs for name, pairs in scored.items() if np.ptp([_skill(p) for p in pairs]) > LEAST_SPREAD}
        for name, pairs in scored.items():
            whole = skill_over_presses(pairs)
            if whole is None:
                continue
            print(f"{path.parent.name}, {name}: skill {whole.estimate:.4f} of {len(pairs)} presses")
            inside = np.mean([p.skill.low95 <= whole.estimate <= p.skill.high95 for p in pairs if p.skill is not None])
            print(f"  over the pixels of one press: holds {inside:.2f}")
            told({name: pairs}, whole.estimate, skill_over_presses, arguments.samples)
        names = list(scored)
        for first, second in [(a, b) for k, a in enumerate(names) for b in names[k + 1 :]]:
            both = {p.name for p in scored[first]} & {p.name for p in scored[second]}
            pairs_of = {name: [p for p in scored[name] if p.name in both] for name in (first, second)}

            def difference(pairs: Sequence[ComparedPair], names: tuple[str, str] = (first, second)) -> Result:
                return skill_differences(pairs, names)[0]

            whole_difference = difference([*pairs_of[first], *pairs_of[second]])
            if whole_difference is not None:
                print(f"{path.parent.name}, {first} minus {second}: {whole_difference.estimate:.4f}")
                told(pairs_of, whole_difference.estimate, difference, arguments.samples)


def _skill(pair: ComparedPair) -> float:
    """Return the skill of a pair."""
    return 0.0 if pair.skill is None else pair.skill.estimate


def told(
    pairs_of: dict[str, list[ComparedPair]],
    truth: float,
    result_of: Callable[[Sequence[ComparedPair]], Result],
    samples: int,
) -> None:
    """Print coverage for each size, without and with replacement."""
    count = len(next(iter(pairs_of.values())))
    for replace in (False, True):
        for size in (n for n in SIZES if n < count):
            rng = np.random.default_rng(1)
            found = []
            for _ in range(samples):
                chosen = rng.choice(count, size, replace=replace)
                # a press that is drawn twice stands for two presses
                drawn = [
                    pairs[i].model_copy(update={"name": f"{pairs[i].name}-{k}", "press": ""})
                    for pairs in pairs_of.values()
                    for k, i in enumerate(chosen)
                ]
                found.append(result_of(drawn))
            ends = [(f.low95, f.estimate, f.high95) for f in found if f is not None and f.low95 is not None]
            held = np.mean([low <= truth <= (high or 0.0) for low, _, high in ends])
            own = all(low < estimate < (high or 0.0) for low, estimate, high in ends)
            width = np.median([(high or 0.0) - low for low, _, high in ends])
            how = "with replacement" if replace else "without"
            print(f"  {size:2d} presses, {how}: holds {held:.3f}, width {width:.3f}, its own estimate always {own}")


if __name__ == "__main__":
    main()
