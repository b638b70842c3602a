"""Small simulation-based calibration: paints from the prior, measured with the default model, fitted, ranked."""

import numpy as np
import pytest
from scipy.stats import binom, kstest

from finray_calib.fit import (
    PAINT_DISCREPANCY,
    BandData,
    EmissionPrior,
    FitSettings,
    LogPosterior,
    SamplerSettings,
    fit_emission,
)
from finray_calib.spectra import curve_quantities
from tests.fit.synthetic_bands import LOG_NORMAL, simulate

PAINTS = 64
# of a false alarm in each of the five tests of ranks and the five of coverage
ERROR_RATE = 1e-3
SETTINGS = FitSettings(importance_draws=3000, kept_draws=300, chain=SamplerSettings(walkers=32, most_steps=300))


@pytest.fixture(scope="module")
def ranks(weights):
    """Share of the posterior draws below the truth, for each paint and quantity."""
    rng = np.random.default_rng(20261121)
    prior = LogPosterior(
        BandData(np.ones((8, 3)), np.eye(24), np.ones((8, 3), bool), weights), LOG_NORMAL, EmissionPrior()
    )
    rows = []
    for theta in prior.prior.draw(PAINTS, rng):
        data, truth = simulate(theta, weights, rng, discrepancy=PAINT_DISCREPANCY)
        above = np.maximum(truth, 0.0) * (weights.wavelength_nm >= weights.laser_nm)
        true = curve_quantities(above[None], weights.wavelength_nm)
        fitted = fit_emission(data, LOG_NORMAL, EmissionPrior(), PAINT_DISCREPANCY, SETTINGS, rng)
        names = ("mode_nm", "fwhm_nm", "peak_per_nm", "energy_yield")
        row = {name: (getattr(fitted.quantities, name) < getattr(true, name)[0]).mean() for name in names}
        row["reflectance"] = (fitted.reflectance_at_laser < np.exp(theta[4])).mean()
        rows.append(row)
    return {name: np.array([row[name] for row in rows]) for name in rows[0]}


@pytest.mark.parametrize("name", ["mode_nm", "fwhm_nm", "peak_per_nm", "energy_yield", "reflectance"])
def test_intervals_hold_the_truth_as_often_as_they_say(ranks, name):
    assert kstest(ranks[name], "uniform").pvalue > ERROR_RATE
    inside = int(((ranks[name] > 0.025) & (ranks[name] < 0.975)).sum())
    low, high = binom(PAINTS, 0.95).ppf([ERROR_RATE / 2, 1 - ERROR_RATE / 2])
    assert low <= inside <= high
