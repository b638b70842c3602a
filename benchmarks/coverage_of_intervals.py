"""Do the fit's intervals hold the truth as often as they say?

Draws paints from the prior, simulates the band values of a nominal eight-filter rig from the model (0.3 % of
the signal plus a small floor, and 1 % calibration error per band), fits each, and counts how often the
equal-tailed 68 % and 95 % intervals hold the truth. A calibrated fit stays within the binomial limits.

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

from finray_calib.fit.band_model import PARAMETER_NAMES, predict_bands
from finray_calib.fit.emission import fit_emission
from finray_calib.fit.likelihood import BandData
from finray_calib.fit.prior import EmissionPrior
from finray_calib.fit.sampler import SamplerSettings
from finray_calib.spectra.band_weights import EmissionWeights, emission_weights

CENTER_NM = (405, 450, 500, 532, 560, 600, 630, 660)
NOISE_REL = 0.003
NOISE_FLOOR = 2e-4
CALIBRATION_REL = 0.01
JUDGED = ("mode_nm", "ln_fwhm_nm")  # intervals of ln FWHM hold exactly when those of FWHM do


def nominal_weights() -> EmissionWeights:
    """Return the weights of Gaussian 10 nm filters with an OD5 floor, a Bayer camera and a white LED."""
    wavelength = np.arange(380.0, 781.0)

    def line(center, fwhm):
        return np.exp(-4 * np.log(2) * ((wavelength - center) / fwhm) ** 2)

    transmission = np.array([np.maximum(0.6 * line(center, 10.0), 1e-5) for center in CENTER_NM])
    response = np.array([0.01 + line(center, fwhm) for center, fwhm in ((600, 80), (535, 90), (460, 80))])
    lamp = 0.3 + line(450, 25) + line(570, 130)
    white = np.full(wavelength.size, 0.97)
    return emission_weights(wavelength, transmission, response, lamp, white, line(450, 2), 1, [0.25, 0.5, 0.25])


def simulate(theta, weights, rng) -> BandData:
    """Return simulated band values of one paint."""
    mu = predict_bands(theta[None], weights)[0]
    sd = np.hypot(NOISE_REL * mu, NOISE_FLOOR)
    calibration = 1 + CALIBRATION_REL * rng.standard_normal(weights.bands)[weights.band_index]
    y = mu * calibration + sd * rng.standard_normal(mu.size)
    shape = (weights.bands, -1)
    usable = np.ones(mu.size, bool).reshape(shape)
    return BandData(y.reshape(shape), np.diag(sd**2), usable, weights, CALIBRATION_REL)


def rank_of_truth(task):
    """Return the share of posterior draws below the truth per parameter, convergence, maxima and seconds."""
    seed, index, most_steps = task
    rng = np.random.default_rng([seed, index])
    prior, weights = EmissionPrior(), nominal_weights()
    theta = prior.draw(1, rng)[0]
    data = simulate(theta, weights, rng)
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
