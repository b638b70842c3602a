import numpy as np
import pytest
from scipy.stats import chi2, norm

from data_schemas import FitError
from finray_calib.fit import (
    NO_DISCREPANCY,
    PAINT_DISCREPANCY,
    BandData,
    EmissionPrior,
    LogPosterior,
    check_bands,
    summarise,
)
from tests.fit.synthetic_bands import LOG_NORMAL, full_sum, orange, simulate


@pytest.fixture(scope="module")
def data(weights):
    return simulate(orange(), weights, np.random.default_rng(11))[0]


def test_band_check_equals_plain_arithmetic(weights, data):
    posterior = LogPosterior(data, LOG_NORMAL, EmissionPrior())
    mu = posterior.predict_usable(orange()[None])[0]
    check = check_bands(posterior, np.tile(orange(), (5, 1)))
    for band in range(8):
        rows = slice(3 * band, 3 * band + 3)
        covariance = data.covariance[rows, rows] + 1e-4 * np.outer(data.y[band], data.y[band])
        residual = data.y[band] - mu[rows]
        expected = residual @ np.linalg.solve(covariance, residual)
        assert check.chi2[band] == pytest.approx(expected, rel=1e-7)
        assert check.p_value[band] == pytest.approx(chi2.sf(expected, 3), rel=1e-7)
    full = full_sum(LOG_NORMAL, orange(), weights)[0]
    assert np.allclose(check.predicted_mean.ravel(), full, rtol=1e-12)
    # equal draws leave the calibration error of 1 % alone
    assert np.allclose(check.predicted_sd, 0.01 * np.abs(data.y), rtol=1e-6, atol=1e-12)


def test_total_is_the_squared_whitened_residual(data):
    posterior = LogPosterior(data, LOG_NORMAL, EmissionPrior(), PAINT_DISCREPANCY)
    residual = posterior.problem.y - posterior.predict_usable(orange()[None])[0]
    expected = residual @ np.linalg.solve(posterior.covariances(orange()[None])[0], residual)
    assert check_bands(posterior, np.tile(orange(), (5, 1))).total_chi2 == pytest.approx(expected, rel=1e-7)


def test_band_that_the_curve_cannot_follow_is_seen(weights, data):
    y = data.y.copy()
    y[5] *= 1.1
    spoiled = BandData(y, data.covariance, data.usable, weights)
    check = check_bands(LogPosterior(spoiled, LOG_NORMAL, EmissionPrior(), NO_DISCREPANCY), np.tile(orange(), (5, 1)))
    assert check.p_value[5] < 1e-4 < 0.001 < np.delete(check.p_value, 5).min()


def test_discrepancy_widens_the_predicted_values(data):
    check = check_bands(LogPosterior(data, LOG_NORMAL, EmissionPrior(), PAINT_DISCREPANCY), np.tile(orange(), (5, 1)))
    bright = check.predicted_mean > 0.1 * check.predicted_mean.max()
    bright[1] = False  # reflected laser light has no discrepancy
    # 12 % of a Gaussian process of 12 nm averages over a 10 nm band to about 11 %
    assert (check.predicted_sd / check.predicted_mean)[bright].min() > 0.08


def test_lost_band_has_no_check(weights):
    usable = np.ones((8, 3), bool)
    usable[2], usable[3, 0] = False, False
    data, _ = simulate(orange(), weights, np.random.default_rng(11), usable=usable)
    check = check_bands(LogPosterior(data, LOG_NORMAL, EmissionPrior()), np.tile(orange(), (3, 1)))
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
    with pytest.raises(FitError, match="at least 100 draws, all of them finite"):
        summarise(np.arange(99.0))
    with pytest.raises(FitError, match="1 of them not finite"):
        summarise(np.append(np.arange(200.0), np.nan))
