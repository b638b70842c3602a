"""Small simulation-based calibration: paints from the prior, measured with the default model, fitted, ranked."""

from dataclasses import replace

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
from finray_calib.fit._emission import REFERENCE_ROUNDS
from finray_calib.spectra import curve_quantities
from tests.fit.synthetic_bands import LOG_NORMAL, orange, simulate

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


LEVELS, PAIRS = np.linspace(-1.2, 1.2, 97), 100  # of ln(level) around the truth: seven standard deviations
SOURCES = {"lamp": (2,), "white reference": (2, 4)}
"""What of theta is unknown: ln(peak), and for a wrong white reference ln(reflectance) by the same factor."""


@pytest.mark.parametrize("source", SOURCES)
def test_what_moves_all_bands_leaves_the_level_in_the_middle_of_its_posterior(weights, source):
    """The lamp moves the reddest band by 15 %, three times the usual, or the white reference all bands by 10 %.

    As shares of measured or fitted values such errors would leave the truth too high. Each level is measured twice with
    opposite errors, so that few paints show a small bias.
    """
    rng, ranks, unknown = np.random.default_rng(20261129), [], list(SOURCES[source])
    data, _ = simulate(orange(), weights, rng)
    prior = LogPosterior(data, LOG_NORMAL, EmissionPrior()).prior
    precision = prior.sd[unknown] ** -2
    mean = precision @ (prior.mean - orange())[unknown] / precision.sum()
    for level in mean + rng.standard_normal(PAIRS) / np.sqrt(precision.sum()):  # the prior
        theta = orange()
        theta[unknown] += level
        z, noise = rng.standard_normal(), rng.standard_normal(24)
        ranks.append([level_rank(data, theta, source, sign * z, sign * noise) for sign in (1, -1)])
    pairs = np.mean(ranks, axis=1)
    # four standard errors of the mean
    assert pairs.mean() == pytest.approx(0.5, abs=4 * pairs.std() / np.sqrt(PAIRS))


def level_rank(data, theta, source, z, noise):
    """Return the posterior probability that the level lies below the truth; all else is known."""
    lamp, tile = (0.15 * np.repeat(np.linspace(-0.2, 1.0, 8), 3), 0.0) if source == "lamp" else (np.zeros(24), 0.1)
    plain = LogPosterior(data, LOG_NORMAL, EmissionPrior(), PAINT_DISCREPANCY)
    mu = plain.predict_usable(theta[None])[0]
    plain = LogPosterior(replace(data, y=mu.reshape(8, 3)), LOG_NORMAL, EmissionPrior(), PAINT_DISCREPANCY)
    y = mu * (1 + (lamp + tile) * z) + np.linalg.cholesky(plain.covariances(theta[None])[0]) @ noise
    seen = replace(data, y=y.reshape(8, 3), lamp_response_rel=lamp, tile_uncertainty_rel=tile)
    seen = replace(seen, covariance=data.covariance + tile**2 * np.outer(y, y))
    posterior = LogPosterior(seen, LOG_NORMAL, EmissionPrior(), PAINT_DISCREPANCY)
    best = posterior.climb(theta)
    for _ in range(REFERENCE_ROUNDS):
        posterior, best = posterior.refined(best)
    rows = np.tile(theta, (LEVELS.size, 1))
    rows[:, SOURCES[source]] += LEVELS[:, None]
    density = posterior(rows)
    share = np.exp(density - density.max())
    return share[LEVELS < 0].sum() / share.sum() + 0.5 * share[LEVELS.size // 2] / share.sum()
