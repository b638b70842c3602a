"""Do the fit's intervals hold the truth as often as they say?

Draws paints from the prior and measures each on a rig of its own: every filter off its stated centre, width and
blocking within its uncertainty, 1 % calibration error per band, 0.3 % channel response, 0.3 % stray light, 0.2 %
noise. The whole fit runs with the nominal rig, and the script counts how often the equal-tailed 68 % and 95 %
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

from data_schemas.radiometry import BandSignals, Optics
from data_schemas.rig import BandPassFilter
from data_schemas.standard_curves import assumed_camera_response, halogen_lamp
from finray_calib.fit.band_model import PARAMETER_NAMES
from finray_calib.fit.nuisances import predict_bands
from finray_calib.fit.paint_calibration import (
    BAND_CALIBRATION_REL,
    CHANNEL_RESPONSE_REL,
    STRAY_LIGHT_REL,
    calibrate_paint,
)
from finray_calib.fit.prior import EmissionPrior
from finray_calib.fit.sampler import SamplerSettings
from finray_calib.spectra.rig_curves import weights_of
from rigs.presets import simulated_rig

CHANNEL_WEIGHTS = (0.01, 0.09, 0.9)
NOISE_REL = 0.002
JUDGED = ("mode_nm", "ln_fwhm_nm")  # intervals of ln FWHM hold exactly when those of FWHM do


def nominal_optics() -> Optics:
    """Return the paper's eight filters with a Bayer camera and a halogen lamp, as the rig file states them."""
    rig = simulated_rig("red")
    return Optics(
        filters=rig.filter_wheel.filters,
        excitation_filter="450",
        laser=rig.laser,
        lamp=halogen_lamp(),
        white_reference=rig.white_reference,
        camera_response=assumed_camera_response(),
    )


def real_optics(nominal: Optics, rng: np.random.Generator) -> Optics:
    """Return the rig as it is: every filter off its stated centre, width and blocking within its uncertainty."""

    def off(band: BandPassFilter) -> BandPassFilter:
        change = {
            "center_nm": band.center_nm + band.center_uncertainty_nm * rng.standard_normal(),
            "fwhm_nm": band.fwhm_nm + band.fwhm_uncertainty_nm * rng.standard_normal(),
            "blocking_od": band.blocking_od + band.blocking_uncertainty_od * rng.standard_normal(),
        }
        return band.model_copy(update=change)

    return nominal.model_copy(update={"filters": tuple(off(band) for band in nominal.filters)})


def simulate(theta: np.ndarray, rng: np.random.Generator) -> BandSignals:
    """Return the band signals of one paint on a real rig, with the nominal rig written beside them."""
    nominal = nominal_optics()
    weights = weights_of(real_optics(nominal, rng), CHANNEL_WEIGHTS)
    mu = predict_bands(theta[None], weights)[0]
    stray = STRAY_LIGHT_REL * mu[~weights.is_excitation].max() * rng.standard_normal(mu.size)
    calibration = 1 + BAND_CALIBRATION_REL * rng.standard_normal(weights.bands)[weights.band_index]
    response, noise = (1 + rel * rng.standard_normal(mu.size) for rel in (CHANNEL_RESPONSE_REL, NOISE_REL))
    y = mu * calibration * response * noise + stray
    return BandSignals(
        paint_name="prior draw",
        optics=nominal,
        fluorescence=y.reshape(-1, 3),
        fluorescence_covariance=np.diag((NOISE_REL * y) ** 2 + 1e-16),
        reflectance=np.full((8, 3), 0.5),
        reflectance_covariance=1e-4 * np.eye(24),
        channel_weights=np.array(CHANNEL_WEIGHTS),
        flags=(("ok", "ok", "ok"),) * 8,
        saturated_fraction=np.zeros((8, 3)),
        region_pixels=10_000,
    )


def rank_of_truth(task):
    """Return the share of posterior draws below the truth per parameter, convergence, maxima and seconds."""
    seed, index, most_steps = task
    rng = np.random.default_rng([seed, index])
    theta = EmissionPrior().draw(1, rng)[0]
    bands = simulate(theta, rng)
    start = time.perf_counter()
    paint = calibrate_paint(bands, int(rng.integers(2**31)), settings=SamplerSettings(most_steps=most_steps))
    seconds = time.perf_counter() - start
    return {
        "truth": theta.tolist(),
        "share_below": (paint.draws < theta).mean(axis=0).tolist(),
        "converged": paint.diagnostics.converged,
        "least_ess": min(paint.diagnostics.effective_samples.values()),
        "maxima": len(paint.diagnostics.maxima),
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
        arguments.out.parent.mkdir(parents=True, exist_ok=True)
        arguments.out.write_text(json.dumps(record, indent=1))
    return 0 if all(table[name]["passed"] for name in JUDGED) else 1


if __name__ == "__main__":
    sys.exit(main())
