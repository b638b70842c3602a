"""Effective samples per second of the fit beside emcee and NumPyro, on the same posteriors in the same run.

    OMP_NUM_THREADS=1 python benchmarks/samplers.py --out bench-out/samplers.json

Times are of the processor, one thread each: by the clock a busy machine stretches the minutes of a chain otherwise
than the tenth of a second of a fit. The repetitions of all samplers are interleaved, and ratios are of medians.
Compilation of numba is excluded (it is cached on disk), NumPyro's is not: every run of its users pays it. Setting up
the arrays of a problem is excluded for all. The fit makes as many draws as ``finray fit`` does: more draws spread the
cost of finding the maxima, and make the ratio larger than users see (``--draws 128000``).
"""

import argparse
import json
import os
import sys
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np

from benchmarks.paint_problems import default_posterior, five_parameter_posterior
from benchmarks.plain_densities import DefaultDensity, FiveParameterDensity
from benchmarks.sampling_paths import Run, run_emcee, run_fit, run_nuts
from finray_calib.fit import FitSettings, LogPosterior, find_maxima
from finray_calib.fit._importance import MixtureProposal

BARS = {
    ("five parameters", "emcee, Python loop"): 300.0,
    ("five parameters", "emcee, vectorised"): 100.0,
    ("five parameters", "NumPyro NUTS"): 1000.0,
    ("default model", "emcee, vectorised"): 30.0,
}
LARGEST_DIFFERENCE_NATS = {"five parameters": 0.01, "default model": 1e-6}
"""Of the two log posteriors near the maximum: few nodes against 401 wavelengths; the same rule and rounding."""
NEAR_MAXIMUM_NATS = 20.0
LARGEST_Z = 4.5  # of some hundred normal deviates, with a false alarm in a thousand runs
REFERENCE = "fit"


def problems(
    seed: int, arguments: argparse.Namespace
) -> dict[str, tuple[LogPosterior, FiveParameterDensity | DefaultDensity, dict[str, Callable[[int], Run]]]]:
    """Return for each model: our posterior, the plain density, and a function of a seed for each sampler."""
    five, default = five_parameter_posterior(seed), default_posterior(seed)
    plain_five, plain_default = FiveParameterDensity(five), DefaultDensity(default)
    size = {"steps": arguments.steps, "walkers": arguments.walkers}
    paths_five: dict[str, Callable[[int], Run]] = {
        REFERENCE: lambda s: run_fit(five, arguments.draws, s),
        "emcee, Python loop": lambda s: run_emcee(plain_five.one, five, s, **size, vectorize=False),
        "emcee, vectorised": lambda s: run_emcee(plain_five.many, five, s, **size, vectorize=True),
        "NumPyro NUTS": lambda s: run_nuts(plain_five, five, s, arguments.chains),
    }
    paths_default: dict[str, Callable[[int], Run]] = {
        REFERENCE: lambda s: run_fit(default, arguments.draws, s),
        "emcee, vectorised": lambda s: run_emcee(plain_default.many, default, s, **size, vectorize=True),
    }
    return {
        "five parameters": (five, plain_five, paths_five),
        "default model": (default, plain_default, paths_default),
    }


def largest_difference(posterior: LogPosterior, plain) -> float:
    """Return the largest difference of the two log posteriors over proposal draws near the maximum, nats."""
    rng = np.random.default_rng(0)
    theta = MixtureProposal.around(find_maxima(posterior, rng), posterior.prior).draw(2000, rng)
    ours = posterior(theta)
    near = ours > ours.max() - NEAR_MAXIMUM_NATS
    return float(np.abs(ours - plain.many(theta))[near].max())


def agreement(runs: Mapping[str, list[Run]]) -> dict[str, float]:
    """Return for each other sampler how far its means and standard deviations lie from the fit's, in standard errors.

    The error of a mean is sd / sqrt(effective), of a standard deviation sd / sqrt(2 effective) for near-normal draws;
    runs of one sampler are pooled.
    """
    mean, sd, effective = _pooled(runs[REFERENCE])
    worst = {}
    for name, found in runs.items():
        if name != REFERENCE:
            other_mean, other_sd, other_effective = _pooled(found)
            error = sd * np.sqrt(1 / effective + 1 / other_effective)
            apart = np.concatenate([np.abs(other_mean - mean) / error, np.abs(other_sd - sd) / error * np.sqrt(2)])
            worst[name] = float(apart.max())
    return worst


def _pooled(runs: list[Run]) -> tuple[np.ndarray, np.ndarray, float]:
    """Return mean, sd and effective number of the runs of one sampler together."""
    share = np.array([r.effective for r in runs])
    mean, square = (np.average(v, axis=0, weights=share) for v in ([r.mean for r in runs], [r.sd**2 for r in runs]))
    return mean, np.sqrt(square), float(share.sum())


def honest_share(posterior: LogPosterior, draws: int, repetitions: int) -> float:
    """Return claimed over true variance of the fit's worst posterior mean; 1 when its effective number is right.

    The true variance is that over repeated runs: with 40 of them it is known to 22 %.
    """
    runs = [run_fit(posterior, draws, 1000 + s) for s in range(repetitions)]
    claimed = np.mean([r.sd**2 / r.effective for r in runs], axis=0)
    return float((claimed / np.var([r.mean for r in runs], axis=0, ddof=1)).min())


def measure(model: str, posterior: LogPosterior, plain, paths, arguments: argparse.Namespace) -> dict:
    """Return the interleaved measurement of one model and print it."""
    run_fit(posterior, 2000, 0)  # loads the compiled code
    runs: dict[str, list[Run]] = {name: [] for name in paths}
    for repetition in range(arguments.repetitions):
        for name, path in paths.items():
            repeats = arguments.fit_repeats if name == REFERENCE else 1
            runs[name] += [path(100 * repetition + r + arguments.seed) for r in range(repeats)]
    rates = {name: float(np.median([r.per_second for r in found])) for name, found in runs.items()}
    difference = largest_difference(posterior, plain)
    largest_z = agreement(runs)
    honest = honest_share(posterior, arguments.draws, arguments.honest_repetitions)
    print(f"{model}: log posteriors differ by {difference:.1e} nats at most near the maximum")
    for name, found in runs.items():
        bar = BARS.get((model, name))
        ratio = "" if bar is None else f"x{rates[REFERENCE] / rates[name]:7.0f}  (at least {bar:.0f})"
        seconds, effective = (np.median([getattr(r, f) for r in found]) for f in ("seconds", "effective"))
        apart = f"; at most {largest_z[name]:.1f} standard errors apart" if name in largest_z else ""
        print(
            f"  {name:20s} {seconds:7.3f} s {effective:8.0f} effective {rates[name]:10.1f}/s  {ratio} "
            f"{found[0].method}{apart}"
        )
    print(f"  variance of the fit's means over repeated runs, claimed over true: {honest:.2f}")
    return {
        "rates_per_s": rates,
        "ratios": {name: rates[REFERENCE] / rate for name, rate in rates.items() if name != REFERENCE},
        "bars": {name: bar for (own, name), bar in BARS.items() if own == model},
        "seconds": {name: [r.seconds for r in found] for name, found in runs.items()},
        "effective": {name: [r.effective for r in found] for name, found in runs.items()},
        "method": {name: found[0].method for name, found in runs.items()},
        "largest_difference_nats": difference,
        "largest_z": largest_z,
        "claimed_over_true_variance": honest,
        "agree": difference < LARGEST_DIFFERENCE_NATS[model] and max(largest_z.values()) < LARGEST_Z,
    }


def main() -> int:
    """Measure both models, print, store; return 1 when a bar is missed or the samplers disagree."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--draws", type=int, default=FitSettings().importance_draws, help="draws of the fit")
    parser.add_argument("--repetitions", type=int, default=3)
    parser.add_argument("--fit-repeats", type=int, default=5, help="runs of the fit in each repetition")
    parser.add_argument("--steps", type=int, default=4000, help="steps of emcee")
    parser.add_argument("--walkers", type=int, default=32)
    parser.add_argument("--chains", type=int, default=4, help="chains of NUTS")
    parser.add_argument("--honest-repetitions", type=int, default=40)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--models", nargs="+", default=["five parameters", "default model"])
    parser.add_argument("--out", type=Path)
    arguments = parser.parse_args()
    found = {
        model: measure(model, *parts, arguments)
        for model, parts in problems(arguments.seed, arguments).items()
        if model in arguments.models
    }
    if arguments.out:
        arguments.out.parent.mkdir(parents=True, exist_ok=True)
        settings = {k: str(v) for k, v in vars(arguments).items()} | {"threads": os.environ.get("OMP_NUM_THREADS", "")}
        arguments.out.write_text(json.dumps({"settings": settings, "models": found}, indent=1))
    met = all(m["ratios"][name] >= bar for m in found.values() for name, bar in m["bars"].items())
    return 0 if met and all(m["agree"] for m in found.values()) else 1


if __name__ == "__main__":
    sys.exit(main())
