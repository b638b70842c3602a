"""Whether designed filters pay on fluorophores that the fit has not seen: the designed set against the paper's.

    python benchmarks/designed_filters.py --spectra ../shared/data/spectra --filters 480/10,500/25,520/40,560/40

Fluorophores become paints by photons traced through a layer, and lie on simulated rigs, as in ``paints_of_dyes.py``:
neither shares code or an equation with the design, and the prior of each fit is learned without the fluorophore and all
that resemble it. The same paint, rig, camera and errors are measured through either set.
"""

import argparse
import sys
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

from benchmarks.emission_detection import Rig
from benchmarks.paints_of_dyes import JUDGED, OUT_NM, Case, excited, group_of, left_out_priors
from finray_calib.fit import EmissionPrior, band_data
from finray_calib.fit._filter_design import paired_ratio
from finray_calib.fit._reported_spectrum import fit_spectrum
from rigs.simulated._bench import WAVELENGTH_NM

LARGEST_MEDIAN, LARGEST_MEAN = 0.7, 0.8


def error(case: Case, name: str, prior, filters: tuple[tuple[float, float], ...]) -> float:
    """Return the relative error of the posterior mean of one paint seen through a set of filters."""
    optics = case.rig.optics
    rig = Rig(case.rig.seed, case.rig.blocking_od, case.rig.camera, None, filters)
    rig.optics = rig.optics.model_copy(update={"lamp_temperature_uncertainty_k": optics.lamp_temperature_uncertainty_k})
    case.rig, case.rng = rig, np.random.default_rng(len(name))
    data = band_data(case.signals(name))
    fitted = fit_spectrum(data, prior, EmissionPrior().ln_blocking_sd, 300, np.random.default_rng(1)).curves.mean(
        axis=0
    )
    truth = np.interp(OUT_NM, WAVELENGTH_NM, case.column)
    return float(np.linalg.norm((fitted - truth)[JUDGED]) / np.linalg.norm(truth[JUDGED]))


def main() -> int:
    """Run the fits, print the ratios, return 1 when a bar is missed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--spectra", type=Path, required=True, help="folder with dyes.csv and cameras/")
    parser.add_argument("--filters", required=True, help="centre/width in nm of the emission filters, with commas")
    parser.add_argument("--dyes", type=int, default=40, help="how many fluorophores, evenly from the list")
    arguments = parser.parse_args()
    designed = tuple(tuple(map(float, one.split("/"))) for one in arguments.filters.split(","))
    every = list(excited(arguments.spectra / "dyes.csv").items())
    chosen = [every[i] for i in np.unique(np.linspace(0, len(every) - 1, arguments.dyes).astype(int))]
    priors, rows = left_out_priors(arguments.spectra), []
    with threadpool_limits(limits=1, user_api="blas"):
        for name, curves in chosen:
            case, prior = Case(name, 0, curves, ["assumed"]), priors(name).spectra
            rows.append([error(case, name, prior, filters) for filters in (designed, ())])
            group = group_of(np.interp(OUT_NM, WAVELENGTH_NM, case.column))
            print(f"{name:40s} {group:12s} {rows[-1][0]:.3f} {rows[-1][1]:.3f}", flush=True)
    ours, papers = np.array(rows).T
    met = True
    for label, of, bar in (("median", np.median, LARGEST_MEDIAN), ("mean", np.mean, LARGEST_MEAN)):
        ratio, low, high = paired_ratio(ours, papers, of, np.random.default_rng(2))
        met &= ratio <= bar
        print(f"{label} {of(ours):.3f} against {of(papers):.3f}: {ratio:.2f} [{low:.2f}, {high:.2f}], at most {bar:g}")
    return 0 if met else 1


if __name__ == "__main__":
    sys.exit(main())
