"""Whether the claims of a light-angle decision hold, and what it loses, on random curves whose optimum is known.

    OMP_NUM_THREADS=1 python benchmarks/light_angle_decision.py --out bench-out/light-angle-decision.json

A sweep of 10 deg with 3 repeats and 8 % noise. In the first two cases the simulation is the truth, and what is judged
is the claim by simulation alone. In the others the truth is another curve: a draw of the decision's own prior of the
sim-to-real error, or of another kind, a tilt or a bump; and eight families of pairs of curves that no Gaussian process
drew: with shadow edges, kinks, flat tops, glints, hardly any slope, steps and waves, and sweeps of neighbouring places;
and three more by formulas of light, on which nothing was chosen, which are judged by the same bars alone.
Those are decided on without captures, with five captures by absolute ratios, and with five relative to their own
no-contact images, which see a random share of the error. Of those the decision may claim too little, not too much.
Last, seven errors on one kind of simulated curve: a claim without captures knows the simulated curve only, so it is the
same for all of them, and how far it must stay below what comes true follows from the rates alone, whatever the prior.
With --audit, five sharper families in place of all these: without captures, with five absolute ones, and with the
simulation as the truth, where the claim by simulation alone is judged by eye (last two columns).
Cases that stand in the file of --out are not run again. Regrets are also those of the greatest mean of the repeats and
of the greatest single value, which is what is done without statistics.
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
    AUDIT,
    FINE_DEG,
    FOREIGN,
    LOBE_ERRORS,
    PEDESTAL,
    SWEEP_DEG,
    UNSEEN,
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
LEAST_COVERAGE, LEAST_OF_GLINTS = 0.92, 0.85
LARGEST_SHORT = 0.10  # claimed below what came true, on the mean over families
LARGEST_BOUND = 0.087  # three times that of a prior of one length and smoothness, whose bound holds too rarely
LARGEST_POOLED = 0.99
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

    @property
    def is_foreign(self) -> bool:
        return callable(self.truth)


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
    bound: float
    decided: float

    @property
    def ratio_means(self) -> float:
        return self.regret_of_means / self.regret

    @property
    def ratio_single(self) -> float:
        return self.regret_of_single / self.regret


FIVE_DEG = (5.0, 20.0, 40.0, 60.0, 85.0)
FOREIGN_CAPTURE_SD_REL = 0.02
# 8 % of the hill's height, which stands on a pedestal of half of it; 8 % of hill and pedestal is harder.
ONE_LOBE = tuple(Case(f"{error.__name__} of a lobe, no capture", 0.02, error) for error in LOBE_ERRORS)
CASES = (
    Case("8 % of the hill", NOISE / (1 + PEDESTAL)),
    Case("8 % of the maximum", NOISE),
    Case("model, one capture", 0.02, "model", (30.0,)),
    Case("model, three captures", 0.02, "model", (15.0, 45.0, 75.0), absolute=True),
    Case("tilt, three captures", 0.02, "tilt", (15.0, 45.0, 75.0), absolute=True),
    Case("bump, three captures", 0.02, "bump", (15.0, 45.0, 75.0), absolute=True),
    Case("model, no capture", 0.02, "model"),
    *(Case(f"{family.__name__}, no capture", 0.02, family) for family in FOREIGN + UNSEEN),
    *(Case(f"{family.__name__}, absolute", 0.02, family, FIVE_DEG, absolute=True) for family in FOREIGN + UNSEEN),
    *(Case(f"{family.__name__}, relative", 0.02, family, FIVE_DEG) for family in FOREIGN + UNSEEN),
    *ONE_LOBE,
)


def _itself(family: Callable[[np.random.Generator], Pair]) -> Callable[[np.random.Generator], Pair]:
    """Return pairs in which the simulated curve of a family is the true one."""
    return lambda rng: (family(rng)[0],) * 2


AUDIT_CASES = (
    *(Case(f"{family.__name__}, no capture", 0.02, family) for family in AUDIT),
    *(Case(f"{family.__name__}, absolute", 0.02, family, FIVE_DEG, absolute=True) for family in AUDIT),
    *(Case(f"{family.__name__}, exact", 0.02, _itself(family)) for family in AUDIT),
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
    if case.is_foreign and case.captures_deg:
        # captures beside their own no-contact images see a share of the error that nobody knows
        seen = np.log(simulated / real) * (1.0 if case.absolute else rng.random())
        angles = np.array(case.captures_deg)
        captures = honest_captures(simulated, seen, angles, rng, case.absolute, FOREIGN_CAPTURE_SD_REL, 0.0)
    if isinstance(case.truth, str):
        log_error = log_discrepancy(case.truth, rng, simulated)
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
        claim.regret_95_rel,
        decision.verdict in {"decided", "tie"},
    )


def main() -> int:
    """Print a line for each case; return 1 when a bar is missed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--curves", type=int, default=3000, help="without captures")
    parser.add_argument("--curves-with-captures", type=int, default=1000)
    parser.add_argument("--draws", type=int, default=2000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--audit", action="store_true", help="five sharper families alone")
    parser.add_argument("--out", type=Path, help="a file that is there already is gone on with")
    arguments = parser.parse_args()
    settings = {name: getattr(arguments, name) for name in ("curves", "curves_with_captures", "draws", "seed")}
    stored = json.loads(arguments.out.read_text()) if arguments.out and arguments.out.exists() else {}
    found = stored["cases"] if stored.get("settings") == settings else {}
    print(
        f"{'case':24s} curves | within 5 deg | loss <= 2 %  | bound: holds, mean  | regret: true, claimed, simulation, "
    )
    print(f"{'':24s}        | claimed true | claimed true | decided             | greatest mean, greatest value | ")
    print(f"{'':24s} simulation only: claimed loss <= 2 %, bound holds")
    for case in AUDIT_CASES if arguments.audit else CASES:
        if case.name not in found:
            curves = arguments.curves_with_captures if case.truth else arguments.curves
            o = run(case, curves, arguments.seed, arguments.draws)
            found[case.name] = asdict(o) | {"ratio_means": o.ratio_means, "ratio_single": o.ratio_single}
            if arguments.out:
                arguments.out.parent.mkdir(parents=True, exist_ok=True)
                arguments.out.write_text(json.dumps({"settings": settings, "cases": found}, indent=1))
        _print(case.name, found[case.name])
    return int(not (_judge_audit if arguments.audit else _judge)(found))


def _print(name: str, r: dict[str, float]) -> None:
    """Print the line of a case."""
    print(
        f"{name:24s} {r['curves']:6d} | {r['claimed_within_5deg']:.2f} {r['actual_within_5deg']:.2f}    "
        f"| {r['claimed_within_tolerance']:.2f} {r['actual_within_tolerance']:.2f}    "
        f"| {r['coverage_of_95']:.2f} {r['bound']:6.2%} {r['decided']:.2f}  "
        f"| {r['regret']:.2%} {r['claimed_regret']:.2%} {r['regret_simulation_only']:.2%} "
        f"{r['regret_of_means']:.2%} {r['regret_of_single']:.2%} "
        f"| {r['claimed_simulation_only']:.2f} {r['coverage_simulation_only']:.2f}",
        flush=True,
    )


def _families(family: dict[str, dict[str, float]], kind: str, name: str) -> list[tuple[str, bool]]:
    """Return the bars of some families with one kind of captures, and whether each is met."""
    over = {n: r["claimed_within_tolerance"] - r["actual_within_tolerance"] for n, r in family.items()}
    worst, mean = max(over, key=lambda n: over[n]), float(np.mean(list(over.values())))
    holds = [r["coverage_of_95"] - (LEAST_OF_GLINTS if "glint" in n else LEAST_COVERAGE) for n, r in family.items()]
    pooled, bound, decided = (
        float(np.mean([r[key] for r in family.values()])) for key in ("coverage_of_95", "bound", "decided")
    )
    return [
        (f"{name}: most claimed above what came true: {over[worst]:+.3f} ({worst})", over[worst] <= LARGEST_MISS),
        (f"{name}: the same on the mean: {mean:+.3f}", mean >= -LARGEST_SHORT),
        (f"{name}: least share of 95 % bounds that hold, above its bar: {min(holds):+.3f}", min(holds) >= 0),
        (f"{name}: bounds that hold, pooled: {pooled:.3f}", kind == "no capture" or pooled <= LARGEST_POOLED),
        (f"{name}: mean bound {bound:.2%}", kind != "absolute" or bound <= LARGEST_BOUND),
        (f"{name}: decided in {decided:.2f}", kind == "absolute" or decided == 0),
    ]


def _judge_audit(found: dict[str, dict[str, float]]) -> bool:
    """Print the bars of the sharper families and return whether all are met."""
    rows = []
    for kind in ("no capture", "absolute"):
        names = [f"{family.__name__}, {kind}" for family in AUDIT]
        rows += _families({name: found[name] for name in names}, kind, f"sharper families, {kind}")
    return _told(rows)


def _judge(found: dict[str, dict[str, float]]) -> bool:
    """Print the bars and return whether all are met."""
    own = max(
        abs(found[c.name]["claimed_within_5deg"] - found[c.name]["actual_within_5deg"])
        for c in CASES
        if c.truth in (None, "model")
    )
    rows = [(f"largest difference of claimed and actual, own kind of curve: {own:.3f}", own <= LARGEST_MISS)]
    for kind in ("no capture", "absolute", "relative"):
        for which, families in (("eight families", FOREIGN), ("unseen families", UNSEEN)):
            names = [f"{family.__name__}, {kind}" for family in families]
            rows += _families({name: found[name] for name in names}, kind, f"{which}, {kind}")
    rates = np.array([found[case.name]["actual_within_tolerance"] for case in ONE_LOBE])
    short = float(rates.mean() - rates.min() - LARGEST_MISS)
    rows.append(
        (
            f"one lobe: a claim that is nowhere {LARGEST_MISS} too much is short by {short:.3f} (shown)",
            True,
        )
    )
    first = found[CASES[0].name]
    rows.append(
        (
            f"regret of the greatest mean, times ours: {first['ratio_means']:.2f}",
            first["ratio_means"] >= LEAST_OVER_MEANS,
        )
    )
    rows.append(
        (f"of the greatest single value: {first['ratio_single']:.2f}", first["ratio_single"] >= LEAST_OVER_SINGLE)
    )
    return _told(rows)


def _told(rows: Sequence[tuple[str, bool]]) -> bool:
    """Print bars and return whether all are met."""
    for text, is_met in rows:
        print(f"{text}: {'met' if is_met else 'NOT MET'}")
    return all(is_met for _, is_met in rows)


if __name__ == "__main__":
    sys.exit(main())
