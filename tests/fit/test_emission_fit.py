import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import chi2, norm

from data_schemas.errors import FitError
from finray_calib.fit.band_model import PARAMETER_NAMES
from finray_calib.fit.emission import fit_emission
from finray_calib.fit.likelihood import BandData, LogPosterior
from finray_calib.fit.nuisances import predict_bands
from finray_calib.fit.predictive import check_bands
from finray_calib.fit.prior import EmissionPrior
from finray_calib.fit.sampler import SamplerSettings
from finray_calib.fit.summary import summarise
from finray_calib.spectra.skew_cauchy import SkewCauchy


@pytest.fixture(scope="module")
def posterior(orange_theta, simulate_bands):
    data = simulate_bands(orange_theta, np.random.default_rng(11))
    return fit_emission(data, EmissionPrior(), SamplerSettings(), np.random.default_rng(12))


def test_truth_lies_inside_the_posterior(posterior, orange_theta):
    assert posterior.diagnostics.converged
    apart = posterior.draws.mean(axis=0) - orange_theta
    # chi-square with 6 degrees of freedom exceeds 35 with probability 4e-6
    assert apart @ np.linalg.inv(np.cov(posterior.draws.T)) @ apart < 35
    assert posterior.parameter_names == PARAMETER_NAMES
    laplace_sd = np.sqrt(np.linalg.inv(posterior.maxima.information[0])[0, 0])
    # a well determined paint: the posterior is normal up to a skewness that changes the sd by less than a fifth
    assert posterior.mode_nm.std() == pytest.approx(laplace_sd, rel=0.2)
    assert posterior.map_estimate[0] == pytest.approx(posterior.mode_nm.mean(), abs=3 * posterior.mode_nm.std())


def test_derived_draws_are_those_of_the_curve(posterior):
    for i in (0, 1000, -1):
        curve = SkewCauchy(
            posterior.location_nm[i], posterior.scale_nm[i], posterior.skewness[i], posterior.amplitude_nm[i]
        )
        assert curve.mode_nm == pytest.approx(posterior.mode_nm[i], rel=1e-9)
        assert curve.fwhm_nm == pytest.approx(posterior.fwhm_nm[i], rel=1e-9)
        assert curve.peak_value == pytest.approx(posterior.peak_per_nm[i], rel=1e-9)
        visible = quad(curve, 450, 780, points=[curve.location_nm], epsabs=1e-12)[0]
        assert posterior.energy_yield[i] == pytest.approx(visible, abs=2e-6 * curve.area)
        below = quad(curve, -np.inf, posterior.laser_nm, epsabs=1e-12)[0] / curve.area
        assert posterior.share_below_laser[i] == pytest.approx(below, abs=2e-6)
    assert posterior.reflectance_at_laser.mean() == pytest.approx(0.1, rel=0.05)  # five times the 1 % calibration


def test_spectrum_bands_are_ordered_and_hold_the_true_curve(posterior, orange_theta):
    grid = np.arange(480.0, 721.0, 5.0)
    bands = posterior.spectrum_bands(grid)
    assert (bands.low95 <= bands.low68).all()
    assert (bands.low68 <= bands.mean).all()
    assert (bands.mean <= bands.high68).all()
    assert (bands.high68 <= bands.high95).all()
    truth = SkewCauchy.from_mode(*orange_theta[:4])(grid)
    width = (bands.high95 - bands.low95) / 3.92
    # five standard deviations at every wavelength
    assert (np.abs(truth - bands.mean) < 5 * width).all()


def test_band_check_equals_plain_arithmetic(weights, orange_theta, simulate_bands):
    data = simulate_bands(orange_theta, np.random.default_rng(11))
    mu = predict_bands(orange_theta[None], weights)[0]
    check = check_bands(LogPosterior(data, EmissionPrior()), np.tile(orange_theta, (5, 1)))
    for band in range(8):
        rows = slice(3 * band, 3 * band + 3)
        covariance = data.covariance[rows, rows] + 1e-4 * np.outer(data.y[band], data.y[band])
        residual = data.y[band] - mu[rows]
        expected = residual @ np.linalg.solve(covariance, residual)
        assert check.chi2[band] == pytest.approx(expected, rel=1e-9)
        assert check.p_value[band] == pytest.approx(chi2.sf(expected, 3), rel=1e-9)
    assert np.allclose(check.predicted_mean.ravel(), mu)
    # equal draws leave the calibration error of 1 % alone
    assert np.allclose(check.predicted_sd, 0.01 * data.y, rtol=1e-9)


def test_band_that_the_curve_cannot_follow_is_seen(posterior, weights, orange_theta, simulate_bands):
    data = simulate_bands(orange_theta, np.random.default_rng(11))
    y = data.y.copy()
    y[5] *= 1.1
    spoiled = BandData(y, data.covariance, data.usable, weights)
    check = check_bands(LogPosterior(spoiled, EmissionPrior()), posterior.draws)
    assert check.p_value[5] < 1e-4 < 0.001 < np.delete(check.p_value, 5).min()


def test_lost_band_has_no_check(orange_theta, simulate_bands):
    usable = np.ones((8, 3), bool)
    usable[2], usable[3, 0] = False, False
    data = simulate_bands(orange_theta, np.random.default_rng(11), usable)
    check = check_bands(LogPosterior(data, EmissionPrior()), np.tile(orange_theta, (3, 1)))
    assert check.degrees_of_freedom.tolist() == [3, 3, 0, 2, 3, 3, 3, 3]
    assert np.isnan(check.p_value).tolist() == [False, False, True] + 5 * [False]


def test_summary_of_normal_quantiles():
    draws = norm.ppf((np.arange(100_000) + 0.5) / 100_000, loc=600.0, scale=2.0)
    summary = summarise(draws)
    expected = norm.ppf([0.5, 0.16, 0.84, 0.025, 0.975], loc=600.0, scale=2.0)
    got = [summary.estimate, summary.low68, summary.high68, summary.low95, summary.high95]
    assert np.allclose(got, expected, atol=1e-3)  # a hundred-thousandth of probability at the steepest quantile
    assert summary.sd == pytest.approx(2.0, rel=1e-3)


def test_summary_of_too_few_or_lost_draws_is_refused():
    with pytest.raises(FitError, match="at least 100 finite draws"):
        summarise(np.arange(99.0))
    with pytest.raises(FitError, match="1 of them not finite"):
        summarise(np.append(np.arange(200.0), np.nan))
