"""Whether the claims of a light-angle decision hold, and what it loses, on random curves whose optimum is known.

    OMP_NUM_THREADS=1 python benchmarks/light_angle_decision.py --out bench-out/light-angle-decision.json

A sweep of 10 deg with 3 repeats and 8 % noise. In the first two cases the simulation is the truth, and what is judged
is the claim by simulation alone. In the others the truth is another curve: a draw of the decision's own prior of the
sim-to-real error, or of another kind, a tilt or a bump; and, without captures, pairs of curves that no Gaussian process
drew, with shadow edges, kinks, flat tops and glints. Of those the decision may claim too little, not too much. Regrets
are also those of the greatest mean of the repeats and of the greatest single value, which is what is done without
statistics.
"""

import argparse
import json
import sys
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from finray_calib.decide import decide_angle
from finray_calib.decide._capture_errors import NO_CAPTURES
from tests.decide.curves import (
    FINE_DEG,
    FOREIGN,
    PEDESTAL,
    SWEEP_DEG,
    Family,
    Pair,
    honest_captures,
    log_discrepancy,
    random_curve,
    regret_of,
    sweep,
)

REPEATS = 3
NOISE = 0.08
SCALE = 0.05  # of one repeat, all of whose values share it
LARGEST_MISS = 0.05
LEAST_COVERAGE = 0.92
TOLERANCE_REL = 0.02
LEAST_OVER_MEANS, LEAST_OVER_SINGLE = 2.8, 4.0


@dataclass(frozen=True)
class Case:
    """Curves of one kind: noise relative to the maximum, the truth, and the captures.

    The truth is the simulated curve itself, one that differs from it by an error of a family, or a pair of its own.
    """

    name: str
    noise_of_maximum: float
    truth: Family | Callable[[np.random.Generator], Pair] | None = None
    captures_deg: tuple[float, ...] = ()
    absolute: bool = False


@dataclass(frozen=True)
class Outcome:
    """Claimed and actual probabilities of a case, and mean regrets."""

    curves: int
    claimed_within_5deg: float
    actual_within_5deg: float
    coverage_of_95: float
    claimed_regret: float
    regret: float
    regret_simulation_only: float
    regret_of_means: float
    regret_of_single: float
    claimed_within_tolerance: float
    actual_within_tolerance: float
    claimed_simulation_only: float
    coverage_simulation_only: float

    @property
    def ratio_means(self) -> float:
        return self.regret_of_means / self.regret

    @property
    def ratio_single(self) -> float:
        return self.regret_of_single / self.regret


# 8 % of the hill's height, which stands on a pedestal of half of it; 8 % of hill and pedestal is harder.
CASES = (
    Case("8 % of the hill", NOISE / (1 + PEDESTAL)),
    Case("8 % of the maximum", NOISE),
    Case("model, one capture", 0.02, "model", (30.0,)),
    Case("model, three captures", 0.02, "model", (15.0, 45.0, 75.0), absolute=True),
    Case("tilt, three captures", 0.02, "tilt", (15.0, 45.0, 75.0), absolute=True),
    Case("bump, three captures", 0.02, "bump", (15.0, 45.0, 75.0), absolute=True),
    Case("model, no capture", 0.02, "model"),
    *(Case(f"{family.__name__}, no capture", 0.02, family) for family in FOREIGN),
)


def run(case: Case, curves: int, seed: int, draws: int = 2000) -> Outcome:
    """Decide on many random curves and compare with their truth."""
    rng = np.random.default_rng(seed)
    rows = [_one(case, rng, draws) for _ in range(curves)]
    return Outcome(curves, *np.mean(rows, axis=0).tolist())


def _one(case: Case, rng: np.random.Generator, draws: int) -> Sequence[float]:
    """Return the numbers of one curve, in the order of the outcome."""
    simulated, real = case.truth(rng) if callable(case.truth) else (random_curve(rng),) * 2
    values = sweep(simulated, rng, case.noise_of_maximum, REPEATS, SCALE)
    captures = NO_CAPTURES
    if isinstance(case.truth, str):
        log_error = log_discrepancy(case.truth, rng)
        real = simulated * np.exp(-log_error)
        if case.captures_deg:
            captures = honest_captures(simulated, log_error, np.array(case.captures_deg), rng, case.absolute)
    decision = decide_angle(SWEEP_DEG, values, rng, TOLERANCE_REL, captures, draws=draws)
    regret, alone = regret_of(real, decision.best_deg), decision.simulation_only
    claim = alone if case.truth is None else decision.risk
    return (
        claim.p_within_5deg,
        abs(FINE_DEG[real.argmax()] - decision.best_deg) <= 5,
        # an optimum that is found exactly leaves rounding, against a bound of zero
        regret <= claim.regret_95_rel + 1e-12,
        claim.expected_regret_rel,
        regret,
        regret_of(real, decision.best_simulation_only_deg),
        regret_of(real, SWEEP_DEG[values.mean(axis=1).argmax()]),
        regret_of(real, SWEEP_DEG[values[:, 0].argmax()]),
        claim.p_within_tolerance,
        regret <= TOLERANCE_REL,
        alone.p_within_tolerance,
        regret <= alone.regret_95_rel + 1e-12,
    )


def main() -> int:
    """Print a line for each case; return 1 when a bar is missed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--curves", type=int, default=3000, help="without captures")
    parser.add_argument("--curves-with-captures", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out", type=Path)
    arguments = parser.parse_args()
    found = {}
    print(f"{'case':24s} {'curves':>6s} {'claimed':>8s} {'actual':>7s} {'bound holds':>11s} {'regret':>8s} ", end="")
    print(
        f"{'claimed':>8s} {'simulation':>10s} {'means':>14s} {'single':>14s}   loss <= 2 %: claimed, actual, ", end=""
    )
    print("by simulation alone claimed, its bound holds")
    for case in CASES:
        o = run(case, arguments.curves_with_captures if case.truth else arguments.curves, arguments.seed)
        found[case.name] = asdict(o) | {"ratio_means": o.ratio_means, "ratio_single": o.ratio_single}
        print(
            f"{case.name:24s} {o.curves:6d} {o.claimed_within_5deg:8.3f} {o.actual_within_5deg:7.3f} "
            f"{o.coverage_of_95:11.3f} {o.regret:8.3%} {o.claimed_regret:8.3%} {o.regret_simulation_only:10.3%} "
            f"{o.regret_of_means:7.3%} {o.ratio_means:5.2f}x {o.regret_of_single:7.3%} {o.ratio_single:5.2f}x   "
            f"{o.claimed_within_tolerance:.3f} {o.actual_within_tolerance:.3f} {o.claimed_simulation_only:.3f} "
            f"{o.coverage_simulation_only:.3f}",
            flush=True,
        )
    miss = {row: found[row]["claimed_within_5deg"] - found[row]["actual_within_5deg"] for row in found}
    own = max(abs(miss[case.name]) for case in CASES if case.truth in (None, "model"))
    without = [found[case.name] for case in CASES if case.truth is not None and not case.captures_deg]
    uncaptured = max(row["claimed_within_tolerance"] - row["actual_within_tolerance"] for row in without)
    bound_holds = min(row["coverage_of_95"] for row in without)
    foreign = max(miss[case.name] for case in CASES if case.truth in ("tilt", "bump"))
    first = found[CASES[0].name]
    print(f"largest difference of claimed and actual: {own:.3f} (at most {LARGEST_MISS})")
    print(f"largest overclaim where the error is not of the prior's kind: {foreign:.3f} (at most {LARGEST_MISS})")
    print(f"largest overclaim of a loss within 2 % without captures: {uncaptured:.3f} (at most {LARGEST_MISS})")
    print(f"least share of bounds that hold without captures: {bound_holds:.3f} (at least {LEAST_COVERAGE})")
    if arguments.out:
        arguments.out.parent.mkdir(parents=True, exist_ok=True)
        arguments.out.write_text(
            json.dumps(
                {
                    "cases": found,
                    "largest_miss": own,
                    "largest_overclaim": foreign,
                    "largest_overclaim_without_captures": uncaptured,
                    "least_coverage_without_captures": bound_holds,
                    "seed": arguments.seed,
                },
                indent=1,
            )
        )
    met = (
        max(own, foreign, uncaptured) <= LARGEST_MISS
        and bound_holds >= LEAST_COVERAGE
        and first["ratio_means"] >= LEAST_OVER_MEANS
        and first["ratio_single"] >= LEAST_OVER_SINGLE
    )
    return int(not met)


if __name__ == "__main__":
    sys.exit(main())
