"""Do the fit's intervals hold the truth as often as they say?

Draws paints from the prior, simulates the band values of the paper's eight-filter rig from the model (0.4 % of
the signal, 0.3 % of the brightest band, 1 % calibration error per band, filters off their nominal centre, width and
blocking), fits each, and counts how often the equal-tailed 68 % and 95 %
intervals hold the truth. A calibrated fit stays within the binomial limits.

    python benchmarks/coverage_of_intervals.py --paints 100 --seed 20261121 --out coverage.json

The limits hold with the declared probability of a false alarm per interval (--error-rate). Exit status 1 when
the mode or the width misses a limit.
"""

import argparse
import json
import os
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

import numpy as np
from scipy.stats import binom, kstest

from data_schemas.radiometry import Optics
from data_schemas.standard_curves import assumed_camera_response, halogen_lamp
from finray_calib.fit.band_model import PARAMETER_NAMES
from finray_calib.fit.emission import fit_emission
from finray_calib.fit.likelihood import BandData
from finray_calib.fit.nuisances import predict_bands, tolerance_columns
from finray_calib.fit.prior import EmissionPrior
from finray_calib.fit.sampler import SamplerSettings
from finray_calib.spectra.band_tolerances import BandTolerances, tolerances_of
from finray_calib.spectra.band_weights import EmissionWeights
from finray_calib.spectra.rig_curves import weights_of
from rigs.presets import simulated_rig

CHANNEL_WEIGHTS = (0.01, 0.09, 0.9)
NOISE_REL = 0.004
STRAY_LIGHT_REL = 0.003
CALIBRATION_REL = 0.01
JUDGED = ("mode_nm", "ln_fwhm_nm")  # intervals of ln FWHM hold exactly when those of FWHM do


def nominal_rig() -> tuple[EmissionWeights, BandTolerances]:
    """Return the weights and tolerances of the paper's eight filters with a Bayer camera and a halogen lamp."""
    rig = simulated_rig("red")
    optics = Optics(
        filters=rig.filter_wheel.filters,
        excitation_filter="450",
        laser=rig.laser,
        lamp=halogen_lamp(),
        white_reference=rig.white_reference,
        camera_response=assumed_camera_response(),
    )
    return weights_of(optics, CHANNEL_WEIGHTS), tolerances_of(optics, CHANNEL_WEIGHTS)


def simulate(theta, weights, tolerances, rng) -> BandData:
    """Return simulated band values of one paint: the model, its imperfections drawn, and measurement noise."""
    mu = predict_bands(theta[None], weights)[0]
    sd = np.hypot(NOISE_REL * mu, STRAY_LIGHT_REL * mu[~weights.is_excitation].max())
    columns = tolerance_columns(theta, weights, tolerances)
    calibration = 1 + CALIBRATION_REL * rng.standard_normal(weights.bands)[weights.band_index]
    y = calibration * mu + columns @ rng.standard_normal(columns.shape[1]) + sd * rng.standard_normal(mu.size)
    shape = (weights.bands, -1)
    usable = np.ones(mu.size, bool).reshape(shape)
    return BandData(y.reshape(shape), np.diag(sd**2), usable, weights, CALIBRATION_REL, tolerances)


def rank_of_truth(task):
    """Return the share of posterior draws below the truth per parameter, convergence, maxima and seconds."""
    seed, index, most_steps = task
    rng = np.random.default_rng([seed, index])
    prior = EmissionPrior()
    theta = prior.draw(1, rng)[0]
    data = simulate(theta, *nominal_rig(), rng)
    start = time.perf_counter()
    posterior = fit_emission(data, prior, SamplerSettings(most_steps=most_steps), rng)
    seconds = time.perf_counter() - start
    return {
        "truth": theta.tolist(),
        "share_below": (posterior.draws < theta).mean(axis=0).tolist(),
        "converged": posterior.diagnostics.converged,
        "least_ess": float(posterior.diagnostics.bulk_ess.min()),
        "maxima": len(posterior.maxima.theta),
        "band_p": posterior.bands.p_value.tolist(),
        "seconds": seconds,
    }


def summary_of(results, error_rate):
    """Return hits, limits and rank uniformity per parameter."""
    share = np.array([r["share_below"] for r in results])
    table = {}
    for i, name in enumerate(PARAMETER_NAMES):
        row = {"rank_uniformity_p": float(kstest(share[:, i], "uniform").pvalue)}
        for level in (95, 68):
            hits = int((np.abs(share[:, i] - 0.5) <= level / 200).sum())
            limits = [int(binom.ppf(error_rate / 2, len(share), level / 100))]
            limits.append(int(binom.isf(error_rate / 2, len(share), level / 100)))
            row[f"hits{level}"], row[f"limits{level}"] = hits, limits
        row["passed"] = all(row[f"limits{v}"][0] <= row[f"hits{v}"] <= row[f"limits{v}"][1] for v in (95, 68))
        table[name] = row
    return table


def main() -> int:
    """Run the study, print its table, return 1 when a judged interval misses its limits."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--paints", type=int, default=100)
    parser.add_argument("--seed", type=int, default=20261121)
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--most-steps", type=int, default=SamplerSettings().most_steps)
    parser.add_argument("--error-rate", type=float, default=3e-3)
    parser.add_argument("--out", type=Path)
    arguments = parser.parse_args()
    os.environ["OMP_NUM_THREADS"] = os.environ["OPENBLAS_NUM_THREADS"] = "1"  # matrices are small: one thread is faster
    start = time.perf_counter()
    tasks = [(arguments.seed, index, arguments.most_steps) for index in range(arguments.paints)]
    with ProcessPoolExecutor(arguments.processes, mp_context=get_context("spawn")) as pool:
        results = list(pool.map(rank_of_truth, tasks))
    table = summary_of(results, arguments.error_rate)
    seconds = np.array([r["seconds"] for r in results])
    print(f"{arguments.paints} paints, seed {arguments.seed}, error rate {arguments.error_rate:g} per interval")
    print("parameter           95 % hits (limits)   68 % hits (limits)   rank uniformity p")
    for name, row in table.items():
        cells = [f"{row[f'hits{v}']:3d} ({row[f'limits{v}'][0]}..{row[f'limits{v}'][1]})" for v in (95, 68)]
        print(f"{name:19s} {cells[0]:20s} {cells[1]:20s} {row['rank_uniformity_p']:.3f}")
    unconverged = sum(not r["converged"] for r in results)
    print(
        f"fit: median {np.median(seconds):.1f} s, worst {seconds.max():.1f} s; not converged {unconverged}; "
        f"several maxima {sum(r['maxima'] > 1 for r in results)}; wall {time.perf_counter() - start:.0f} s"
    )
    if arguments.out:
        record = {"arguments": {k: str(v) for k, v in vars(arguments).items()}, "table": table, "paints": results}
        arguments.out.write_text(json.dumps(record, indent=1))
    return 0 if all(table[name]["passed"] for name in JUDGED) else 1


if __name__ == "__main__":
    sys.exit(main())
