"""Do the fit's intervals hold the truth as often as they say?

Draws paints from the prior of a family, with its discrepancy, and measures each on a rig of its own: every filter off
its stated centre, width and blocking within its uncertainty, 1 % calibration error per band, 0.3 % channel response,
0.3 % stray light, 0.2 % noise. The fit of that family runs with the nominal rig, and the script counts how often the
equal-tailed 68 % and 95 % intervals hold the truth. A calibrated fit stays within the binomial limits.

    python benchmarks/coverage_of_intervals.py --paints 100 --seed 20261121 --out coverage.json

The limits hold with the declared probability of a false alarm per interval (--error-rate). Exit status 1 when
mode, width or yield misses a limit.
"""

import argparse
import json
import os
import sys
import time
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

import numpy as np
from scipy.stats import binom, kstest

from data_schemas.radiometry import BandSignals, Optics
from data_schemas.rig import BandPassFilter
from data_schemas.standard_curves import assumed_camera_response, halogen_lamp
from finray_calib.fit.discrepancy import (
    EDGE_OFFSET_FWHM,
    EDGE_WIDTH_FWHM,
    NO_DISCREPANCY,
    PAINT_DISCREPANCY,
    Discrepancy,
)
from finray_calib.fit.emission import FitSettings, fit_emission
from finray_calib.fit.family_choice import DEFAULT_FAMILY
from finray_calib.fit.nuisances import band_values
from finray_calib.fit.paint_calibration import (
    BAND_CALIBRATION_REL,
    CHANNEL_RESPONSE_REL,
    STRAY_LIGHT_REL,
    band_data,
)
from finray_calib.fit.prior import EmissionPrior
from finray_calib.spectra.curve_quantities import curve_quantities
from finray_calib.spectra.emission_families import FAMILIES
from finray_calib.spectra.rig_curves import WAVELENGTH_NM, weights_of
from rigs.presets import simulated_rig

CHANNEL_WEIGHTS = (0.01, 0.09, 0.9)
NOISE_REL = 0.002
QUANTITIES = ("mode_nm", "fwhm_nm", "skew", "peak_per_nm", "energy_yield")
JUDGED = ("mode_nm", "fwhm_nm", "energy_yield")


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


def real_emission(theta: np.ndarray, family: str, discrepancy: Discrepancy, rng: np.random.Generator) -> np.ndarray:
    """Return the emission of one prior draw, (L,): a curve of the family and a draw of the discrepancy."""
    shape = FAMILIES[family].curves(theta[None], WAVELENGTH_NM)[0]
    if not discrepancy.acts:
        return shape
    roots, directions = np.linalg.eigh(discrepancy.smooth_kernel(WAVELENGTH_NM, WAVELENGTH_NM))
    smooth = directions @ (np.sqrt(np.maximum(roots, 0.0)) * rng.standard_normal(roots.size))
    width = np.exp(theta[1])
    edge = 1 / (1 + np.exp((WAVELENGTH_NM - theta[0] + EDGE_OFFSET_FWHM * width) / (EDGE_WIDTH_FWHM * width)))
    relative = smooth + discrepancy.reabsorption_rel * rng.standard_normal() * edge
    return shape + (shape + discrepancy.floor_rel * np.exp(theta[2])) * relative


def simulate(emission: np.ndarray, reflected_laser: float, leak: float, rng: np.random.Generator) -> BandSignals:
    """Return the band signals of one paint on a real rig, with the nominal rig written beside them."""
    nominal = nominal_optics()
    weights = weights_of(real_optics(nominal, rng), CHANNEL_WEIGHTS)
    mu = band_values(emission[None], np.array([reflected_laser]), weights, leak)[0]
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
    """Return the share of posterior draws below the truth of each quantity, method, trust, maxima and seconds."""
    seed, index, family, discrepancy = task
    rng = np.random.default_rng([seed, index])
    prior = EmissionPrior()
    joint = prior.of(FAMILIES[family], with_blocking=True)
    theta = joint.draw(1, rng)[0]
    emission = real_emission(theta, family, discrepancy, rng)
    bands = simulate(emission, float(np.exp(theta[-2])), float(np.exp(theta[-1])), rng)
    emitted = np.maximum(emission, 0.0) * (bands.optics.laser.wavelength_nm <= WAVELENGTH_NM)
    truth = curve_quantities(emitted[None], WAVELENGTH_NM)
    start = time.perf_counter()
    posterior = fit_emission(band_data(bands), FAMILIES[family], prior, discrepancy, FitSettings(), rng)
    seconds = time.perf_counter() - start
    share = {q: float((getattr(posterior.quantities, q) < getattr(truth, q)[0]).mean()) for q in QUANTITIES}
    share |= {name: float((posterior.draws[:, i] < theta[i]).mean()) for i, name in enumerate(joint.names)}
    return {
        "truth": {q: float(getattr(truth, q)[0]) for q in QUANTITIES},
        "theta": theta.tolist(),
        "share_below": share,
        "method": posterior.sampling.method,
        "trusted": posterior.sampling.trusted,
        "pareto_k": posterior.sampling.sample.pareto_k,
        "maxima": len(posterior.maxima.log_posterior),
        "seconds": seconds,
    }


def summary_of(results, error_rate):
    """Return hits, limits and rank uniformity of each quantity and parameter."""
    table = {}
    for name in results[0]["share_below"]:
        share = np.array([r["share_below"][name] for r in results])
        row = {"rank_uniformity_p": float(kstest(share, "uniform").pvalue)}
        for level in (95, 68):
            hits = int((np.abs(share - 0.5) <= level / 200).sum())
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
    parser.add_argument("--family", choices=tuple(FAMILIES), default=DEFAULT_FAMILY)
    parser.add_argument("--no-discrepancy", action="store_true", help="paints exactly of the family, fitted as such")
    parser.add_argument("--error-rate", type=float, default=3e-3)
    parser.add_argument("--out", type=Path)
    arguments = parser.parse_args()
    os.environ["OMP_NUM_THREADS"] = os.environ["OPENBLAS_NUM_THREADS"] = "1"  # matrices are small: one thread is faster
    start = time.perf_counter()
    discrepancy = NO_DISCREPANCY if arguments.no_discrepancy else PAINT_DISCREPANCY
    tasks = [(arguments.seed, index, arguments.family, discrepancy) for index in range(arguments.paints)]
    with ProcessPoolExecutor(arguments.processes, mp_context=get_context("spawn")) as pool:
        results = list(pool.map(rank_of_truth, tasks))
    table = summary_of(results, arguments.error_rate)
    seconds = np.array([r["seconds"] for r in results])
    print(
        f"{arguments.paints} paints of {arguments.family}{' without discrepancy' * arguments.no_discrepancy}, seed "
        f"{arguments.seed}, error rate {arguments.error_rate:g} per interval"
    )
    print("quantity              95 % hits (limits)   68 % hits (limits)   rank uniformity p")
    for name, row in table.items():
        cells = [f"{row[f'hits{v}']:3d} ({row[f'limits{v}'][0]}..{row[f'limits{v}'][1]})" for v in (95, 68)]
        print(f"{name:21s} {cells[0]:20s} {cells[1]:20s} {row['rank_uniformity_p']:.3f}")
    methods = Counter(r["method"] for r in results)
    print(
        f"fit: median {np.median(seconds):.2f} s, worst {seconds.max():.2f} s; "
        f"{', '.join(f'{n} by {method}' for method, n in methods.items())}; not trusted "
        f"{sum(not r['trusted'] for r in results)}; several maxima {sum(r['maxima'] > 1 for r in results)}; wall "
        f"{time.perf_counter() - start:.0f} s"
    )
    if arguments.out:
        record = {"arguments": {k: str(v) for k, v in vars(arguments).items()}, "table": table, "paints": results}
        arguments.out.parent.mkdir(parents=True, exist_ok=True)
        arguments.out.write_text(json.dumps(record, indent=1))
    return 0 if all(table[name]["passed"] for name in JUDGED) else 1


if __name__ == "__main__":
    sys.exit(main())
