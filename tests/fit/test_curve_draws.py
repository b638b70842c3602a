"""Draws of the curve against the joint normal posterior written out on the whole grid, and their coverage."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import binom

from finray_calib.fit import NO_DISCREPANCY, PAINT_DISCREPANCY, EmissionPrior, LogPosterior, two_maxima
from finray_calib.fit._emission import curve_draws
from finray_calib.spectra import band_quadrature
from tests.fit.synthetic_bands import LOG_NORMAL, orange, simulate

COUNT = 2000
# without a floor and with a small amplitude no drawn curve touches zero, where draws are cut
SMALL = replace(PAINT_DISCREPANCY, amplitude_rel=0.05, floor_rel=0.0)
TILE_REL = 0.1  # uncertainty of the white reference


@pytest.fixture(scope="module")
def posterior(weights):
    data, _ = simulate(orange(), weights, np.random.default_rng(3), discrepancy=SMALL)
    lamp = np.linspace(-0.04, 0.12, 24)
    covariance = data.covariance + TILE_REL**2 * np.outer(data.y, data.y)
    uncertain = replace(data, covariance=covariance, lamp_response_rel=lamp, tile_uncertainty_rel=TILE_REL)
    return LogPosterior(uncertain, LOG_NORMAL, EmissionPrior(), SMALL)


@pytest.fixture(scope="module")
def normal(posterior):
    """Mean and covariance of (curve on the grid, imperfections) given y at the fixed theta, by block inversion."""
    theta, d, weights = orange(), posterior.discrepancy, posterior.data.weights
    rule, grid = band_quadrature(weights), weights.wavelength_nm
    every = np.concatenate([grid, rule.nodes_nm.ravel()])
    scale = LOG_NORMAL.curves(theta[None], every)[0] + d.floor_rel * np.exp(theta[2])
    apart = (every[:, None] - every) / d.length_nm
    width = np.exp(theta[1])
    edge = d.reabsorption_rel / (1 + np.exp((every - (theta[0] - 0.5 * width)) / (0.12 * width)))
    process = np.outer(scale, scale) * (d.amplitude_rel**2 * np.exp(-0.5 * apart**2) + np.outer(edge, edge))
    own = weights.band_index[:, None] == np.arange(weights.bands)
    member = (own[:, :, None] * rule.in_band[:, None, :]).reshape(len(own), -1)
    u = posterior.imperfections
    size, errors = grid.size, u.shape[1]
    prior = np.zeros((size + errors, size + errors))
    prior[:size, :size] = process[:size, :size]
    prior[size:, size:] = np.eye(errors)
    with_y = np.concatenate([process[:size, size:] @ member.T, u.T])
    mu, y = posterior.predict_usable(theta[None])[0], posterior.data.y.ravel()
    lamp = posterior.data.lamp_response_rel * mu
    noise = posterior.data.covariance - TILE_REL**2 * np.outer(y, y)
    total = member @ process[size:, size:] @ member.T + u @ u.T + noise + np.outer(lamp, lamp)
    total += TILE_REL**2 * np.outer(mu, mu)
    gain = np.linalg.solve(total, with_y.T).T
    mean = gain @ (posterior.problem.y - mu)
    mean[:size] += scale[:size]
    return mean, prior - gain @ with_y.T


def test_mean_and_covariance_are_those_of_the_joint_normal_posterior(posterior, normal):
    mean, covariance = normal
    grid = posterior.data.weights.wavelength_nm
    drawn = curve_draws(posterior, np.tile(orange(), (COUNT, 1)), np.random.default_rng(7))
    seen = np.flatnonzero((grid > 565) & (grid < 760))[::10]
    assert (drawn.curves[:, seen] > 0).all()
    keep = np.concatenate([seen, grid.size + np.arange(8)])
    got = np.concatenate([drawn.curves, drawn.imperfections], axis=1)[:, keep]
    mean, covariance = mean[keep], covariance[np.ix_(keep, keep)]
    sd = np.sqrt(np.diag(covariance))
    # five standard errors; the bands that the likelihood takes as independent correlate by less than 0.02 of a sd
    assert np.abs((got.mean(axis=0) - mean) / sd).max() < 5 / np.sqrt(COUNT) + 0.02
    correlation = covariance / np.outer(sd, sd)
    assert np.abs(np.cov(got.T) / np.outer(sd, sd) - correlation).max() < 5 * np.sqrt(2 / COUNT) + 0.02


def test_imperfections_are_the_calibration_errors_that_were_made(weights):
    """A band that is brighter than the others allow pulls its own calibration."""
    data, _ = simulate(orange(), weights, np.random.default_rng(3), discrepancy=SMALL)
    y = data.y.copy()
    y[5] *= 1.05
    spoiled = LogPosterior(replace(data, y=y), LOG_NORMAL, EmissionPrior(), NO_DISCREPANCY)
    pulls = curve_draws(spoiled, np.tile(orange(), (500, 1)), np.random.default_rng(7)).imperfections
    assert pulls.shape == (500, 8)
    assert pulls[:, 5].mean() > 3.0  # 5 % are five standard uncertainties, some were there before
    assert pulls[:, 5].std() < 0.5


def test_without_discrepancy_the_curves_are_those_of_the_family(weights, posterior):
    alone = LogPosterior(posterior.data, LOG_NORMAL, EmissionPrior(), NO_DISCREPANCY)
    theta = orange() + 0.01 * np.random.default_rng(2).standard_normal((50, 6))
    drawn = curve_draws(alone, theta, np.random.default_rng(1))
    expected = LOG_NORMAL.curves(theta, weights.wavelength_nm) * (weights.wavelength_nm >= weights.laser_nm)
    assert np.allclose(drawn.curves, expected, rtol=1e-12, atol=0)
    assert np.allclose(drawn.family_curves, expected, rtol=1e-12, atol=0)


def test_no_curve_is_negative_or_emits_below_the_laser(weights):
    data, _ = simulate(orange(), weights, np.random.default_rng(3))
    posterior = LogPosterior(data, LOG_NORMAL, EmissionPrior(), PAINT_DISCREPANCY)
    drawn = curve_draws(posterior, np.tile(orange(), (300, 1)), np.random.default_rng(7))
    assert drawn.curves.min() == 0.0
    assert (drawn.curves[:, weights.wavelength_nm < weights.laser_nm] == 0).all()


def test_same_seed_gives_the_same_curves(posterior):
    theta = np.tile(orange(), (20, 1))
    one, two = (curve_draws(posterior, theta, np.random.default_rng(5)).curves for _ in range(2))
    assert np.array_equal(one, two)


def test_bands_of_the_curve_cover_paints_drawn_with_discrepancy(weights):
    """With theta known the 95 % band at one wavelength holds the truth with a probability of 95 %."""
    rng, paints, hits = np.random.default_rng(11), 60, np.zeros(4)
    at = np.searchsorted(weights.wavelength_nm, [545.0, 580.0, 615.0, 645.0])  # between the filters
    for _ in range(paints):
        data, truth = simulate(orange(), weights, rng, discrepancy=PAINT_DISCREPANCY)
        posterior = LogPosterior(data, LOG_NORMAL, EmissionPrior(), PAINT_DISCREPANCY)
        curves = curve_draws(posterior, np.tile(orange(), (300, 1)), rng).curves[:, at]
        low, high = np.quantile(curves, [0.025, 0.975], axis=0)
        true = np.maximum(truth[at], 0.0)  # no paint emits less than nothing
        hits += (low <= true) & (true <= high)
    # four wavelengths, error rate 1e-3 each
    limits = binom(paints, 0.95).ppf([5e-4, 1 - 5e-4])
    assert (hits >= limits[0]).all()
    assert (hits <= limits[1]).all()


def test_two_maxima_are_found_with_the_share_of_curves_that_have_them():
    """Curves of two dyes at known places beside those of one dye; small ripples do not count."""
    w = np.arange(450.0, 781.0)

    def dye(at_nm):
        return np.exp(-0.5 * ((w - at_nm) / 12.0) ** 2)

    two = [dye(570.0 + k) + 0.5 * dye(650.0 - k) for k in range(3)]
    found = two_maxima(w, np.array([*two, dye(600.0)] * 50))
    assert found is not None
    assert found.probability == 0.75
    assert (found.first_nm.estimate, found.second_nm.estimate) == (571.0, 649.0)
    # 570 and 650 nm stand 6.7 widths apart: the other dye adds nothing at a maximum
    assert found.second_to_first.estimate == pytest.approx(0.5, rel=1e-6)
    assert two_maxima(w, np.array([two[0], dye(600.0), dye(600.0)] * 50)) is None
    # an interval needs 100 draws
    assert two_maxima(w, np.array([two[0]] * 80 + [dye(600.0)] * 70)) is None
    rippled = dye(570.0) + 0.02 * dye(700.0)
    assert two_maxima(w, np.array([rippled] * 100)) is None
