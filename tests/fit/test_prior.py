import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import kstest, norm, truncnorm

from data_schemas import FitError
from finray_calib.fit import EmissionPrior
from finray_calib.spectra import FAMILIES


@pytest.fixture(params=list(FAMILIES))
def prior(request):
    return EmissionPrior().of(FAMILIES[request.param], with_blocking=True)


def test_each_parameter_integrates_to_one(prior):
    """The joint density divided by the others' closed forms, integrated over one parameter at a time."""
    for d in range(prior.size):
        low, high = np.clip(
            [prior.low[d], prior.high[d]], prior.mean[d] - 12 * prior.sd[d], prior.mean[d] + 12 * prior.sd[d]
        )
        others = [k for k in range(prior.size) if k != d]
        at = np.clip(prior.mean, prior.low, prior.high)
        bounds = (prior.low - prior.mean) / prior.sd, (prior.high - prior.mean) / prior.sd
        rest = sum(
            truncnorm(bounds[0][k], bounds[1][k], loc=prior.mean[k], scale=prior.sd[k]).logpdf(at[k]) for k in others
        )

        def density(x, d=d, at=at, rest=rest):
            theta = at.copy()
            theta[d] = x
            return np.exp(prior.log_density(theta[None])[0] - rest)

        total = quad(density, low, high, points=[prior.mean[d]], limit=200, epsabs=1e-12)[0]
        assert total == pytest.approx(1.0, abs=1e-9)


def test_draws_follow_the_truncated_normals(prior):
    draws = prior.draw(4000, np.random.default_rng(4))
    assert prior.contains(draws).all()
    bounds = (prior.low - prior.mean) / prior.sd, (prior.high - prior.mean) / prior.sd
    for d in range(prior.size):
        law = truncnorm(bounds[0][d], bounds[1][d], loc=prior.mean[d], scale=prior.sd[d])
        # error rate 1e-5 for each of some thirty marginals, with a fixed seed
        assert kstest(draws[:, d], law.cdf).pvalue > 1e-5


def test_density_outside_the_truncation_is_zero(prior):
    theta = np.tile(np.clip(prior.mean, prior.low, prior.high), (3, 1))
    theta[0, 0], theta[1, 0] = prior.low[0] - 1e-6, np.nan
    assert np.isneginf(prior.log_density(theta)).tolist() == [True, True, False]


def test_widened_prior_has_wider_normals_in_the_same_bounds(prior):
    wide = prior.widened(2.0)
    assert np.array_equal(wide.sd, 2 * prior.sd)
    assert np.array_equal(wide.high, prior.high)
    free = ~np.isfinite(prior.high)
    expected = norm(prior.mean[free], 2 * prior.sd[free]).logpdf(prior.mean[free]).sum()
    narrowed = norm(prior.mean[free], prior.sd[free]).logpdf(prior.mean[free]).sum()
    bounded = [
        np.log(np.diff(norm(m, s).cdf([lo, hi]))[0] / np.diff(norm(m, 2 * s).cdf([lo, hi]))[0] / 2)
        for m, s, lo, hi in zip(*(v[~free] for v in (prior.mean, prior.sd, prior.low, prior.high)), strict=True)
    ]
    gain = wide.log_density(prior.mean[None])[0] - prior.log_density(prior.mean[None])[0]
    assert gain == pytest.approx(expected - narrowed + sum(bounded), abs=1e-9)


def test_every_parameter_has_its_prior_in_words(prior):
    assert len(prior.words) == prior.size
    assert prior.words[0] == "normal(560, 60) nm, cut to 470..720 nm"
    assert prior.words[1] == "log-normal, median 50 nm, sd of the logarithm 0.3"
    without = EmissionPrior().of(FAMILIES["zheng2014"], with_blocking=False)
    assert "ln_blocking" not in without.names


def test_medians_of_the_log_normal_priors(prior):
    draws = np.exp(prior.draw(20_000, np.random.default_rng(9))[:, :3] * [0, 1, 1])
    # standard error of a median: 1.25 sd / sqrt(n); five of them
    assert np.median(draws[:, 1]) == pytest.approx(50.0, rel=5 * 1.25 * 0.3 / np.sqrt(20_000))
    assert np.median(draws[:, 2]) == pytest.approx(0.003, rel=5 * 1.25 * 1.2 / np.sqrt(20_000))


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"ln_fwhm_sd": 0.0}, "ln_fwhm_sd is 0, but must be positive"),
        ({"peak_median_per_nm": -1.0}, "peak_median_per_nm is -1, but must be positive"),
        ({"ln_blocking_sd": np.nan}, "ln_blocking_sd is nan, but must be a finite number"),
        ({"mode_sd_nm": np.inf}, "mode_sd_nm is inf, but must be a finite number"),
        ({"mode_mean_nm": np.nan}, "mode_mean_nm is nan, but must be a finite number"),
        ({"mode_low_nm": 720.0}, "must be below mode_high_nm 720 nm"),
    ],
)
def test_impossible_priors_are_refused(fields, message):
    with pytest.raises(FitError, match=message):
        EmissionPrior(**fields)
