"""Leaks of single filters: which are sampled, and the sampled ones against closed forms and the moved rig."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import multivariate_normal, norm

from finray_calib.fit import (
    NO_DISCREPANCY,
    PAINT_DISCREPANCY,
    BandData,
    EmissionPrior,
    LogPosterior,
    find_maxima,
    importance_sample,
    leave_one_band_out,
)
from finray_calib.fit._band_data import band_values, decisive_leaks
from finray_calib.fit._emission import curve_draws
from finray_calib.fit._importance import MixtureProposal, WeightedSample
from finray_calib.spectra import band_tolerances, rig_emission_weights
from tests.fit.synthetic_bands import LOG_NORMAL, orange

SHARES = (0.1, 0.3, 0.6)
LEAKY = 2  # the filter at 500 nm, beside the laser
LEAK_SD = 0.2 * np.log(10)  # a catalogue's 0.2 OD
LN_BLOCKING_SD = 0.5
UNFELT_REL = 100.0  # noise of the other filters: twenty values tell nothing about a leak within a factor of ten
KNOWN = EmissionPrior(
    mode_mean_nm=597.0,
    mode_sd_nm=1e-3,
    fwhm_median_nm=48.0,
    ln_fwhm_sd=1e-5,
    peak_median_per_nm=0.004,
    ln_peak_sd=1e-5,
    reflected_laser_median=0.1,
    ln_reflected_laser_sd=1e-5,
    ln_blocking_sd=LN_BLOCKING_SD,
)


def exact_filters(optics, **only):
    """Return the optics with filters of exact centre and width, some of them changed (f500=...).

    The laser's own filter does not leak: its leak would move all bands, and no closed form knows that.
    """
    exact, only = {"center_uncertainty_nm": 0.0, "fwhm_uncertainty_nm": 0.0}, {"f450": {"blocking_od": 9.0}} | only
    return optics.model_copy(
        update={"filters": tuple(f.model_copy(update=exact | only.get(f"f{f.name}", {})) for f in optics.filters)}
    )


def measured(optics, noise_rel, leak=0.0, discrepancy=NO_DISCREPANCY):
    """Return the posterior of an orange paint on exact filters refined there; `leak` is ln of the leak at 500 nm."""
    rig, theta = exact_filters(optics), np.append(orange()[:5], 0.0)
    weights = rig_emission_weights(rig, SHARES)
    own = np.where(weights.band_index == LEAKY, np.exp(leak), 1.0)
    curve = LOG_NORMAL.curves(theta[None], weights.wavelength_nm)
    mu = band_values(curve, np.exp(theta[4:5]), weights, own[None])[0]
    sd = np.where(weights.band_index == LEAKY, noise_rel, UNFELT_REL) * mu
    data = BandData(mu.reshape(8, 3), np.diag(sd**2), np.ones((8, 3), bool), weights, 0.0, band_tolerances(rig, SHARES))
    return LogPosterior(data, known_paint(), KNOWN, discrepancy).refined(theta)[0]


def known_paint():
    """Return the family with its own parameter all but known."""
    return replace(LOG_NORMAL, own=(replace(LOG_NORMAL.own[0], mean=0.35, sd=1e-5),))


def ln_normal(residual, covariance):
    """Return the log density; scipy's refuses bands of such different noise as singular."""
    sd = np.sqrt(np.diag(covariance))
    return (
        multivariate_normal(np.zeros(len(sd)), covariance / np.outer(sd, sd)).logpdf(residual / sd) - np.log(sd).sum()
    )


def test_ratio_decides_which_leaks_are_sampled():
    bands, ratios = 7, np.array([0.49, 0.51, 3.0, 0.0, 0.9, 0.7, 40.0])
    columns = np.zeros((7, 5 * bands))
    columns[np.arange(7), bands + np.arange(7)] = ratios
    columns[:, 4 * bands : 5 * bands] = 0.5 * columns[:, bands : 2 * bands]
    assert decisive_leaks(columns, np.eye(7), bands) == (2, 4, 5, 6)  # the four largest, in the order of the filters
    assert decisive_leaks(columns, 4 * np.eye(7), bands) == (2, 6)
    columns[:, :bands] = 2.0 * np.eye(7)  # calibration errors are part of all else
    assert decisive_leaks(columns, np.eye(7), bands) == (2, 6)
    assert decisive_leaks(np.zeros((7, 35)), np.eye(7), bands) == ()


def test_filter_that_measures_its_leak_is_found_and_its_columns_are_empty(optics):
    posterior = measured(optics, 1e-3)
    assert posterior.prior.names[-2:] == ("ln_blocking", "leak_500")
    assert "filter 500" in posterior.prior.words[-1]
    assert posterior.imperfections.shape == (24, 40)
    assert not posterior.imperfections[:, [8 + LEAKY, 32 + LEAKY]].any()
    assert posterior.imperfections[:, [8 + 5, 32 + 5]].any()  # another filter's stay
    assert measured(optics, UNFELT_REL).prior.names[-1] == "ln_blocking"


def test_leak_of_known_size_splits_between_common_and_own_as_normal_conditioning_says(optics):
    """ln m ~ N(0, a^2), z ~ N(0, 1), ln m + s z = L: ln m ~ N(a^2 L / (a^2 + s^2), a^2 s^2 / (a^2 + s^2))."""
    leak, rng = 1.3, np.random.default_rng(5)
    posterior = measured(optics, 1e-4, leak)
    proposal = MixtureProposal.around(find_maxima(posterior, rng, posterior.prior.mean[None]), posterior.prior)
    sample = importance_sample(posterior, proposal.adapted(posterior, rng), 20_000, rng)
    assert sample.trusted
    common, own = sample.theta[:, -2], sample.theta[:, -1]
    total = LN_BLOCKING_SD**2 + LEAK_SD**2
    mean, sd = LN_BLOCKING_SD**2 * leak / total, LN_BLOCKING_SD * LEAK_SD / np.sqrt(total)
    error = sd / np.sqrt(sample.effective)
    assert sample.weight @ common == pytest.approx(mean, abs=4 * error)
    assert np.sqrt(sample.weight @ (common - mean) ** 2) == pytest.approx(sd, abs=4 * error / np.sqrt(2))
    assert sample.weight @ own == pytest.approx((leak - mean) / LEAK_SD, abs=4 * error / LEAK_SD)
    # noise of 1e-4 of values that are mostly leaked laser light
    assert np.allclose((common + LEAK_SD * own)[sample.weight > 1e-3 / len(common)], leak, rtol=0, atol=0.01)


def test_one_standard_deviation_of_an_own_leak_is_that_of_the_optical_density(optics):
    posterior = measured(optics, 1e-3)
    theta = np.concatenate([orange()[:5], [0.0, 1.0]])
    moved = rig_emission_weights(
        exact_filters(optics, f500={"blocking_od": optics.filters[LEAKY].blocking_od - 0.2}), SHARES
    )
    curve = LOG_NORMAL.curves(theta[None], moved.wavelength_nm)
    expected = band_values(curve, np.exp(theta[4:5]), moved)[0]
    rows = moved.band_index == LEAKY
    # the few-node rule is good to 1e-3 of a value
    np.testing.assert_allclose(posterior.predict_usable(theta[None])[0, rows], expected[rows], rtol=1e-3)
    np.testing.assert_allclose(posterior.leaks(theta[None])[0, rows], 10**0.2, rtol=1e-12)
    # of the other filters the mean of a log-normal leak
    np.testing.assert_allclose(posterior.leaks(theta[None])[0, ~rows], np.exp(LEAK_SD**2 / 2), rtol=1e-12)


def test_rows_of_another_posterior_keep_their_parameters_by_name(optics):
    few, more = measured(optics, UNFELT_REL), measured(optics, 1e-3)
    rows = few.prior.draw(3, np.random.default_rng(1))
    there = more.carried(rows, few.prior.names)
    assert np.array_equal(there, np.column_stack([rows, np.zeros(3)]))
    assert np.array_equal(few.carried(there, more.prior.names), rows)


def test_reported_imperfections_hold_the_sampled_leak_in_its_place(optics):
    posterior = measured(optics, 1e-3, discrepancy=PAINT_DISCREPANCY)
    theta = posterior.prior.draw(50, np.random.default_rng(2))
    drawn = curve_draws(posterior, theta, np.random.default_rng(3)).imperfections
    assert drawn.shape == (50, 40)
    assert np.array_equal(drawn[:, 8 + LEAKY], theta[:, -1])
    assert not np.isclose(drawn[:, 8 + 5], theta[:, -1]).any()


@pytest.mark.parametrize("noise_rel", [0.3, 0.02, 1e-3])
def test_left_out_band_integrates_its_own_leak_over_the_prior(optics, noise_rel):
    """With everything but z fixed: the integral over z of the conditional normal density, by quadrature."""
    posterior = measured(optics, noise_rel, 0.8, PAINT_DISCREPANCY)
    theta = np.concatenate([orange()[:5], [0.1, 0.0]])
    rest, y = posterior.problem.band != LEAKY, posterior.problem.y
    covariance = posterior.covariances(theta[None])[0]
    others = covariance[np.ix_(rest, rest)]

    def density(z):
        mu = posterior.predict_usable(np.append(theta[:-1], z)[None])[0]
        ln_p = ln_normal(y - mu, covariance) - ln_normal((y - mu)[rest], others)
        return np.exp(ln_p - scale) * norm.pdf(z)

    at = (0.8 - 0.1) / LEAK_SD
    scale = 0.0
    scale = np.log(density(at) / norm.pdf(at))
    around = (at - 0.1, at - 0.01, at, at + 0.01, at + 0.1)
    expected = scale + np.log(quad(density, -8.0, 8.0, points=around, limit=400)[0])
    rows = np.tile(theta, (50, 1))
    rows[:, -1] = at + np.linspace(-3, 3, 50) * min(1.0, 3 * noise_rel)
    sample = WeightedSample(rows, np.full(50, 1 / 50), 0.0, 50.0, 0.0, 0.0)
    # the quadratic peak of the nodes is that of a density skewed by the exponential
    assert leave_one_band_out(posterior, sample).ln_density[LEAKY] == pytest.approx(expected, abs=0.02)
