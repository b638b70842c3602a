import numpy as np
import pytest
from scipy.stats import multivariate_normal, norm, truncnorm

from data_schemas.errors import FitError
from finray_calib.fit.likelihood import BandData, LogPosterior
from finray_calib.fit.nuisances import predict_bands
from finray_calib.fit.prior import EmissionPrior


def plain_log_posterior(theta, data, prior):
    """One theta, everything spelled out with scipy's distributions."""
    mu = predict_bands(theta[None], data.weights)[0]
    same_band = data.weights.band_index[:, None] == data.weights.band_index
    y = np.nan_to_num(data.y.ravel())
    covariance = data.covariance + data.band_calibration_rel**2 * np.outer(y, y) * same_band
    kept = data.usable.ravel()
    likelihood = multivariate_normal(mu[kept], covariance[np.ix_(kept, kept)]).logpdf(data.y.ravel()[kept])
    bounds = np.stack([prior.low - prior.mean, prior.high - prior.mean]) / prior.sd
    return likelihood + truncnorm(*bounds, loc=prior.mean, scale=prior.sd).logpdf(theta).sum()


@pytest.mark.parametrize("lost", [(), (0, 4, 11), (3, 4, 5, 23)])
def test_log_posterior_equals_the_plain_scalar_twin(weights, orange_theta, simulate_bands, lost):
    rng = np.random.default_rng(8)
    usable = np.ones(24, bool)
    usable[list(lost)] = False
    simulated = simulate_bands(orange_theta, rng, usable.reshape(8, 3))
    mix = np.eye(24) + 0.2 * rng.standard_normal((24, 24))
    y = np.where(simulated.usable, simulated.y, np.nan)
    data = BandData(y, mix @ simulated.covariance @ mix.T, simulated.usable, weights, 0.02)
    prior = EmissionPrior()
    theta = np.concatenate([prior.draw(40, rng), orange_theta + 0.01 * rng.standard_normal((10, 6))])
    expected = [plain_log_posterior(t, data, prior) for t in theta]
    # rounding of two different factorisations of a covariance of condition 1e6 or so
    assert np.allclose(LogPosterior(data, prior)(theta), expected, rtol=1e-8, atol=1e-6)


def test_predicting_too_much_is_as_bad_as_predicting_too_little(weights, orange_theta, simulate_bands):
    """A relative error that moved with the model would forgive any prediction that is far too bright."""
    posterior = LogPosterior(simulate_bands(orange_theta, np.random.default_rng(8)), EmissionPrior())
    theta = np.tile(orange_theta, (2, 1))
    theta[:, 3:5] += np.log([[0.5], [1.5]])
    dark, bright = posterior.log_likelihood(theta) - posterior.log_likelihood(orange_theta[None])
    # half the signal is fifty calibration errors in each of the four bands that stand clear of the noise floor
    assert dark < -0.4 * 4 * 50**2
    assert bright == pytest.approx(dark, rel=0.1)


def test_information_equals_the_curvature_of_noise_free_data(weights, orange_theta, simulate_bands):
    noisy = simulate_bands(orange_theta, np.random.default_rng(1))
    y = predict_bands(orange_theta[None], weights).reshape(8, 3)
    posterior = LogPosterior(BandData(y, noisy.covariance, noisy.usable, weights), EmissionPrior())
    information = posterior.information(orange_theta)
    scale = 0.1 / np.sqrt(np.diag(information))
    steps = np.concatenate([np.zeros((1, 6)), np.diag(scale), -np.diag(scale)])
    value = posterior.log_likelihood(orange_theta + steps)
    curvature = -(value[1:7] + value[7:] - 2 * value[0]) / scale**2
    # the covariance's own slope, left out of the information, is worth about 2 r^2 = 2e-4 of it per band
    assert np.allclose(curvature + EmissionPrior().sd ** -2.0, np.diag(information), rtol=0.02)


def test_outside_the_truncation_the_density_is_zero(orange_theta, simulate_bands):
    posterior = LogPosterior(simulate_bands(orange_theta, np.random.default_rng(1)), EmissionPrior())
    outside = np.tile(orange_theta, (3, 1))
    outside[0, 0], outside[1, 2] = 469.0, 6.1
    assert np.isneginf(posterior(outside)).tolist() == [True, True, False]
    assert np.isneginf(posterior(outside[:2])).all()


def test_prior_draws_follow_the_prior():
    prior = EmissionPrior()
    draws = prior.draw(20_000, np.random.default_rng(4))
    assert prior.contains(draws).all()
    expected = truncnorm((470 - 560) / 60, (720 - 560) / 60, loc=560, scale=60)
    # five standard errors: error rate below 1e-6
    assert draws[:, 0].mean() == pytest.approx(expected.mean(), abs=5 * expected.std() / np.sqrt(20_000))
    assert np.median(np.exp(draws[:, 1])) == pytest.approx(45.0, rel=5 * 1.25 * 0.4 / np.sqrt(20_000))
    density = prior.log_density(draws[:1])[0]
    rest = norm(prior.mean[[1, 3, 4, 5]], prior.sd[[1, 3, 4, 5]]).logpdf(draws[0, [1, 3, 4, 5]]).sum()
    kappa = truncnorm(-4, 4, scale=1.5).logpdf(draws[0, 2])
    assert density == pytest.approx(expected.logpdf(draws[0, 0]) + kappa + rest, rel=1e-12)


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"ln_fwhm_sd": 0.0}, "must be positive"),
        ({"peak_median_per_nm": -1.0}, "must be positive"),
        ({"mode_low_nm": 720.0}, "must be below mode_high_nm 720 nm"),
        ({"kappa_limit": 9.0}, "must be at most 8"),
    ],
)
def test_impossible_priors_are_refused(fields, message):
    with pytest.raises(FitError, match=message):
        EmissionPrior(**fields)


def changed(weights, **fields):
    values = {"y": np.ones((8, 3)), "covariance": 1e-6 * np.eye(24), "usable": np.ones((8, 3), bool)}
    return BandData(**(values | {"weights": weights} | fields))


def test_unusable_band_data_are_refused(weights):
    few = np.zeros((8, 3), bool)
    few[:3] = True
    nan = np.ones((8, 3))
    nan[2, 1] = np.nan
    skew = 1e-6 * np.eye(24)
    skew[0, 1] = 1e-7
    with pytest.raises(FitError, match="only 3 bands have a usable channel, at least 4"):
        changed(weights, usable=few)
    with pytest.raises(FitError, match="NaN or infinite"):
        changed(weights, y=nan)
    with pytest.raises(FitError, match="not positive definite"):
        changed(weights, covariance=np.ones((24, 24)))
    with pytest.raises(FitError, match="finite and symmetric"):
        changed(weights, covariance=skew)
    with pytest.raises(FitError, match="do not fit the rig's 24 band values"):
        changed(weights, covariance=np.eye(8))
    with pytest.raises(FitError, match="band_calibration_rel 1 must be"):
        changed(weights, band_calibration_rel=1.0)


def test_nan_in_a_lost_entry_is_allowed(weights):
    y, usable = np.ones((8, 3)), np.ones((8, 3), bool)
    y[7, 2], usable[7, 2] = np.nan, False
    assert changed(weights, y=y, usable=usable).kept.size == 23
