"""The paper's way to fit a paint beside ours, on measured materials: the figure of docs/explanation.

The emission of an orange ink and of a yellow textile is seen once through the paper's eight filters with 1 %
calibration error per band and 0.3 % of the brightest, and fitted twice: by the paper's skew-Cauchy taken to be exact,
and by the default family with its discrepancy.

    python benchmarks/paper_fit_beside_ours.py MATERIALS --out docs/images/paper-fit-beside-ours.png

MATERIALS is a folder of measured re-radiation matrices that holds hercules_orange_ink.csv and textile_yellow.csv.

Prints, per material and model, the relative RMS error of the mean curve, the share of the measured curve inside the
pointwise 95 % band, and the mode and full width with their 95 % limits.
"""

import argparse
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from benchmarks.leave_one_material_out import FILTERS_NM, emission_of, rig_weights, score, seen
from finray_calib.fit import (
    DEFAULT_FAMILY,
    NO_DISCREPANCY,
    PAINT_DISCREPANCY,
    BandData,
    Discrepancy,
    EmissionPosterior,
    EmissionPrior,
    FitSettings,
    fit_emission,
)
from finray_calib.reports._style import BLUE, INK, VERMILLION, new_figure, styled
from finray_calib.spectra import FAMILIES, WAVELENGTH_NM, EmissionWeights

MATERIALS = {"hercules_orange_ink": "orange ink", "textile_yellow": "yellow textile"}
SHOWN_NM = (470.0, 720.0)
SCALE = 1e3  # the ordinate is in thousandths per nm


@dataclass(frozen=True)
class Model:
    title: str
    family: str
    discrepancy: Discrepancy
    colour: str


MODELS = (
    Model("The paper's curve (skew-Cauchy), taken to be exact", "zheng2014", NO_DISCREPANCY, VERMILLION),
    Model("Ours: log-normal in wavenumber + discrepancy", DEFAULT_FAMILY, PAINT_DISCREPANCY, BLUE),
)


def fitted(data: BandData, model: Model, seed: int) -> EmissionPosterior:
    """Return the posterior of one model."""
    rng = np.random.default_rng(seed)
    return fit_emission(data, FAMILIES[model.family], EmissionPrior(), model.discrepancy, FitSettings(), rng)


def band_points(data: BandData, truth: np.ndarray, weights: EmissionWeights) -> np.ndarray:
    """Return the measured bands as emission: the true band mean times measured over true band value, nm^-1."""
    own = weights.emission @ truth
    mean = np.array([truth[np.abs(WAVELENGTH_NM - centre) <= 5].mean() for centre in FILTERS_NM])
    return mean * (data.y[:, 0] / (own + 0.05 * weights.reflected_laser))


def draw(axes: Axes, model: Model, posterior: EmissionPosterior, truth: np.ndarray, points: np.ndarray) -> None:
    """Draw one fit with its band, the measured curve dashed, and the eight bands."""
    curves, x = posterior.curve_draws.curves, WAVELENGTH_NM
    low, high = SCALE * np.quantile(curves, [0.025, 0.975], axis=0)
    axes.fill_between(x, low, high, color=model.colour, alpha=0.25, linewidth=0, label="95 % band of the fit")
    axes.plot(x, SCALE * curves.mean(axis=0), color=model.colour, label="fit to the bands")
    axes.plot(x, SCALE * truth, color=INK, linestyle="--", linewidth=1.4, label="measured spectrum (truth)")
    axes.plot(FILTERS_NM, SCALE * points, "o", color=INK, markersize=5, label="bands that the fit sees")
    row = score(curves, truth)
    axes.text(
        0.98,
        0.95,
        f"error {100 * row['error']:.0f} % (relative RMS)\n95 % band contains "
        f"{100 * row['coverage95']:.0f} %\nof the measured spectrum",
        transform=axes.transAxes,
        ha="right",
        va="top",
        color=INK,
        bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 2.0},
    )
    axes.set_xlim(*SHOWN_NM)


def report(name: str, model: Model, posterior: EmissionPosterior, truth: np.ndarray) -> None:
    """Print the numbers of one fit."""
    row, quantities = score(posterior.curve_draws.curves, truth), posterior.quantities
    mode, width = (np.quantile(q, [0.5, 0.025, 0.975]) for q in (quantities.mode_nm, quantities.fwhm_nm))
    print(
        f"{name:20s} {model.family:22s} error {row['error']:.3f}  coverage {row['coverage95']:.2f}  "
        f"mode {mode[0]:.1f} [{mode[1]:.1f}, {mode[2]:.1f}] nm  FWHM {width[0]:.1f} [{width[1]:.1f}, {width[2]:.1f}] nm"
    )


def main() -> int:
    """Fit both materials with both models and write the figure."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("materials", type=Path, help="folder of measured re-radiation matrices (CSV)")
    parser.add_argument("--seed", type=int, default=20261121)
    parser.add_argument("--out", type=Path, default=Path("bench-out/paper-fit-beside-ours.png"))
    arguments = parser.parse_args()
    weights = rig_weights()
    with styled():
        figure: Figure = new_figure(10.0, 7.8)
        axes = figure.subplots(2, 2, sharex=True, sharey="row")
        for row, (stem, words) in enumerate(MATERIALS.items()):
            truth = emission_of(arguments.materials / f"{stem}.csv")
            data = seen(truth, weights, np.random.default_rng([arguments.seed, row]))
            points = band_points(data, truth, weights)
            for column, model in enumerate(MODELS):
                posterior = fitted(data, model, arguments.seed)
                draw(axes[row, column], model, posterior, truth, points)
                report(stem, model, posterior, truth)
            axes[row, 0].set_ylim(0, None)
            axes[row, 0].set_ylabel(f"{words}\nemission, 1/1000 per nm")
        for column, model in enumerate(MODELS):
            axes[0, column].set_title(model.title, color=model.colour, loc="left", fontweight="bold")
            axes[1, column].set_xlabel("wavelength, nm")
        handles, labels = axes[0, 1].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower center", ncols=4)
        figure.suptitle(
            "Eight filter bands leave a spectrum open between them.\nThe paper's curve claims to know it and misses "
            "the measured one; ours says how far it can be off.",
            fontsize=12,
            x=0.01,
            ha="left",
        )
        arguments.out.parent.mkdir(parents=True, exist_ok=True)
        figure.savefig(arguments.out, dpi=110, metadata={"Software": None})
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
