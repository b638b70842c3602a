"""Do the fit's intervals hold the truth as often as they say? Simulation-based calibration of every model.

Draws paints from the prior of a model (family with or without discrepancy), measures each on a rig of its own whose
filters are not quite as stated, fits the same model with the nominal rig, and ranks the truth among the posterior
draws. Ranks of a calibrated fit are uniform.

    python benchmarks/simulation_based_calibration.py --model default --paints 1000 --out bench-out/sbc-default.json

Judged, per model: coverage of the 95 % intervals within 3 points, and Kolmogorov-Smirnov p > 0.01 after Holm's
correction over the model's quantities. Of a mixture only the reported quantities are judged: its components may swap.
Exit status 1 when something misses. A mixture takes some 10 s a paint, because emcee must take over often: finished
paints are kept beside OUT, and the same command goes on with the rest, as long as the code of the fit is the same.

The model ``learned`` is the prior of measured spectra, whose posterior `finray fit` reports: paints are drawn from that
prior, cut at zero and with energy conserved, and their values from its own linear likelihood.

Reference: Talts, Betancourt, Simpson, Vehtari, Gelman, Validating Bayesian inference algorithms with simulation-based
calibration, arXiv:1804.06788.
"""

import argparse
import hashlib
import json
import os
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

import numpy as np
from scipy.stats import kstest

import finray_calib
from benchmarks.drawn_paints import drawn_paint, paint_of_the_learned_prior
from finray_calib.fit import (
    DEFAULT_FAMILY,
    NO_DISCREPANCY,
    PAINT_DISCREPANCY,
    EmissionPrior,
    FitSettings,
    band_data,
    fit_emission,
)
from finray_calib.fit._measured_spectra import learned_spectra
from finray_calib.fit._reported_spectrum import conserving_draws, fit_spectrum
from finray_calib.spectra import FAMILIES, WAVELENGTH_NM, curve_quantities

QUANTITIES = ("mode_nm", "fwhm_nm", "skew", "peak_per_nm", "energy_yield")
IMPERFECTIONS = ("calibration", "blocking", "center", "width")
MODELS = {"default": (DEFAULT_FAMILY, PAINT_DISCREPANCY)} | {name: (name, NO_DISCREPANCY) for name in FAMILIES}
LEARNED = "learned"
LARGEST_MISS = 0.03
SMALLEST_P = 0.01


def ranks(task):
    """Return the share of posterior draws below the truth, by name, and how the draws were made."""
    model, seed, index = task
    if model == LEARNED:
        return learned_ranks(np.random.default_rng([seed, index]))
    family, discrepancy = FAMILIES[MODELS[model][0]], MODELS[model][1]
    rng = np.random.default_rng([seed, index])
    paint = drawn_paint(family, discrepancy, EmissionPrior(), rng)
    start = time.perf_counter()
    fit = fit_emission(band_data(paint.bands), family, EmissionPrior(), discrepancy, FitSettings(), rng)
    seconds = time.perf_counter() - start
    truth = curve_quantities(paint.curve[None], WAVELENGTH_NM)
    below = {name: np.mean(getattr(fit.quantities, name) < getattr(truth, name)[0]) for name in QUANTITIES}
    size = paint.theta.size  # behind it theta holds own leaks, judged among the imperfections
    judged_at = range(size - 2 if family.name == "gaussian_mixture" else 0, size)
    below |= {fit.log_posterior.prior.names[i]: np.mean(fit.draws[:, i] < paint.theta[i]) for i in judged_at}
    filters = [f.name for f in paint.bands.optics.filters]
    labels = [f"{what} {name}" for what in IMPERFECTIONS for name in filters]
    share = (fit.curve_draws.imperfections[:, : len(labels)] < paint.imperfections).mean(axis=0)
    below |= dict(zip(labels, share, strict=True))
    sampling = fit.sampling
    return {
        "below": {name: float(value) for name, value in below.items()},
        "method": sampling.method,
        "trusted": sampling.trusted,
        "pareto_k": sampling.sample.pareto_k,
        "maxima": len(fit.maxima.theta),
        "seconds": seconds,
    }


def learned_ranks(rng):
    """Return the same of a paint of the learned prior."""
    curve, reflectance, data, ln_blocking_sd = paint_of_the_learned_prior(rng)
    start = time.perf_counter()
    fit = conserving_draws(fit_spectrum(data, learned_spectra(), ln_blocking_sd, 2000, rng), data)
    seconds = time.perf_counter() - start
    truth, drawn = curve_quantities(curve[None], WAVELENGTH_NM), curve_quantities(fit.curves, WAVELENGTH_NM)
    below = {name: float(np.mean(getattr(drawn, name) < getattr(truth, name)[0])) for name in QUANTITIES}
    below["reflectance"] = float(np.mean(fit.reflectance_at_laser < reflectance))
    method = "closed form"
    return {"below": below, "method": method, "trusted": True, "pareto_k": 0.0, "maxima": 1, "seconds": seconds}


def judged(results):
    """Return the table: mean rank, coverage, Kolmogorov-Smirnov p, whether these two hold with Holm's correction."""
    names = list(results[0]["below"])
    share = np.array([[r["below"][name] for name in names] for r in results])
    p = np.array([kstest(column, "uniform").pvalue for column in share.T])
    order = np.argsort(p)
    holm = np.empty(p.size)
    holm[order] = np.minimum(1, np.maximum.accumulate(p[order] * (p.size - np.arange(p.size))))
    table = {}
    for i, name in enumerate(names):
        covered = {level: float(np.mean(np.abs(share[:, i] - 0.5) <= level / 200)) for level in (95, 68)}
        good = bool(abs(covered[95] - 0.95) <= LARGEST_MISS and holm[i] > SMALLEST_P)
        table[name] = {
            "mean_rank": float(share[:, i].mean()),
            "coverage95": covered[95],
            "coverage68": covered[68],
            "p": float(p[i]),
            "p_holm": float(holm[i]),
            "met": good,
        }
    return table


def code_digest():
    """Return the SHA-256 of what fits and of what makes the paints."""
    package = Path(finray_calib.__file__).parent
    files = sorted(path for room in ("fit", "spectra") for path in (package / room).glob("*.py"))
    files += [package / "fit" / "measured_spectra.json", Path(__file__).parent / "drawn_paints.py"]
    return hashlib.sha256(b"".join(path.read_bytes() for path in files)).hexdigest()


def fitted_paints(tasks, processes, kept: Path | None):
    """Return the result of every task; with a file, those that it holds are not fitted again."""
    head = json.dumps({"model": tasks[0][0], "seed": tasks[0][1], "code": code_digest()})
    lines = kept.read_text().splitlines() if kept is not None and kept.exists() else []
    whole = [line for line in lines[1:] if line.endswith("}}")] if lines[:1] == [head] else []  # the last may be torn
    found = {row["index"]: row["result"] for row in map(json.loads, whole) if row["index"] < len(tasks)}
    if kept is not None:
        kept.parent.mkdir(parents=True, exist_ok=True)
        kept.write_text("\n".join([head, *whole]) + "\n")
        print(f"{len(found)} of {len(tasks)} paints are in {kept}", flush=True)
    left = [task for task in tasks if task[2] not in found]
    with ProcessPoolExecutor(processes, mp_context=get_context("spawn")) as pool:
        for task, result in zip(left, pool.map(ranks, left), strict=True):
            found[task[2]] = result
            if kept is not None:
                with kept.open("a") as file:
                    file.write(json.dumps({"index": task[2], "result": result}) + "\n")
    return [found[index] for index in range(len(tasks))]


def main() -> int:
    """Run the study, print its table, return 1 when something misses."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--model", choices=(*MODELS, LEARNED), default="default")
    parser.add_argument("--paints", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=20261121)
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--out", type=Path)
    arguments = parser.parse_args()
    for library in ("OMP", "OPENBLAS", "NUMBA"):  # each process is one thread; matrices are small
        os.environ[f"{library}_NUM_THREADS"] = "1"
    start = time.perf_counter()
    tasks = [(arguments.model, arguments.seed, index) for index in range(arguments.paints)]
    kept = arguments.out.with_suffix(".paints.jsonl") if arguments.out else None
    results = fitted_paints(tasks, arguments.processes, kept)
    table = judged(results)
    print(f"model {arguments.model}: {arguments.paints} paints, seed {arguments.seed}")
    print(f"{'quantity':26s} rank   95 %   68 %   KS p    after Holm")
    for name, row in table.items():
        cells = "  ".join(f"{row[key]:.3f}" for key in ("mean_rank", "coverage95", "coverage68"))
        cells += f"  {row['p']:.4f}  {row['p_holm']:.4f}"
        print(f"{name:26s} {cells}{'' if row['met'] else '  MISSED'}")
    methods = {m: sum(r["method"] == m for r in results) for m in sorted({r["method"] for r in results})}
    seconds = np.array([r["seconds"] for r in results])
    print(
        f"{methods}; not trusted {sum(not r['trusted'] for r in results)}; several maxima "
        f"{sum(r['maxima'] > 1 for r in results)}; median {np.median(seconds):.2f} s, worst {seconds.max():.1f} s; "
        f"wall {time.perf_counter() - start:.0f} s"
    )
    if arguments.out:
        arguments.out.parent.mkdir(parents=True, exist_ok=True)
        record = {"model": arguments.model, "seed": arguments.seed, "table": table, "paints": results}
        arguments.out.write_text(json.dumps(record, indent=1))
    return 0 if all(row["met"] for row in table.values()) else 1


if __name__ == "__main__":
    sys.exit(main())
