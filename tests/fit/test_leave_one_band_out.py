import numpy as np
import pytest
from scipy.stats import multivariate_normal

from finray_calib.fit import (
    PAINT_DISCREPANCY,
    EmissionPrior,
    LogPosterior,
    find_maxima,
    importance_sample,
    leave_one_band_out,
)
from finray_calib.fit._family_choice import BandPrediction
from finray_calib.fit._importance import MixtureProposal, WeightedSample
from tests.fit.synthetic_bands import LOG_NORMAL, orange, simulate, without_band

FAIR_PARETO_K = 0.7
EMISSION_BANDS = [0, 2, 3, 4, 5, 6, 7]


def sampled(data, seed):
    """Return posterior, draws and evidence by the adapted proposal."""
    rng = np.random.default_rng(seed)
    posterior = LogPosterior(data, LOG_NORMAL, EmissionPrior(), PAINT_DISCREPANCY)
    proposal = MixtureProposal.around(find_maxima(posterior, rng), posterior.prior).adapted(posterior, rng)
    sample = importance_sample(posterior, proposal, 6000, rng)
    assert sample.ln_evidence_sd < 0.1
    return posterior, sample


def equal_weights(theta):
    """Return draws as a sample of equal weights."""
    return WeightedSample(theta, np.full(len(theta), 1 / len(theta)), 0.0, float(len(theta)), 0.0, 0.0)


def test_scores_are_ratios_of_evidences_with_and_without_the_band(weights):
    """p(y_b | y_-b) = Z(all) / Z(without b), by refits."""
    data, _ = simulate(orange(), weights, np.random.default_rng(4), discrepancy=PAINT_DISCREPANCY)
    posterior, sample = sampled(data, 11)
    got = leave_one_band_out(posterior, sample)
    others = [sampled(without_band(data, b), 2 + b)[1].ln_evidence for b in EMISSION_BANDS]
    exact = np.full(8, np.nan)
    exact[EMISSION_BANDS] = sample.ln_evidence - np.array(others)
    fair = got.pareto_k < FAIR_PARETO_K
    assert fair.sum() >= 4
    # two thousand draws with weights of shape up to 0.7 scatter by 2000^(0.7 - 1), a tenth; 3 sd of it
    assert np.abs(got.ln_density - exact)[fair].max() < 0.3
    # the sum over all bands, indicative ones too, decides between families on differences of nats
    assert abs(got.total - np.nansum(exact)) < 1.5


def test_a_band_that_nothing_depends_on_is_predicted_by_the_others_exactly(weights):
    """With one fixed theta the score is the conditional normal density of the band given the others."""
    data, _ = simulate(orange(), weights, np.random.default_rng(4), discrepancy=PAINT_DISCREPANCY)
    posterior = LogPosterior(data, LOG_NORMAL, EmissionPrior(), PAINT_DISCREPANCY)
    got = leave_one_band_out(posterior, equal_weights(np.tile(orange(), (200, 1))))
    mu, covariance = posterior.predict_usable(orange()[None])[0], posterior.covariances(orange()[None])[0]
    y, band = posterior.problem.y, posterior.problem.band
    whole = multivariate_normal(mu, covariance).logpdf(y)
    for b in EMISSION_BANDS:
        rest = band != b
        others = multivariate_normal(mu[rest], covariance[np.ix_(rest, rest)]).logpdf(y[rest])
        # differences of log densities of two to three dozen numbers, condition 1e6
        assert got.ln_density[b] == pytest.approx(whole - others, abs=1e-4)


def test_lost_band_has_no_score(weights):
    usable = np.ones((8, 3), bool)
    usable[2] = False
    data, _ = simulate(orange(), weights, np.random.default_rng(4), usable=usable)
    posterior = LogPosterior(data, LOG_NORMAL, EmissionPrior())
    draws = orange() + 1e-4 * np.random.default_rng(1).standard_normal((200, 6))
    got = leave_one_band_out(posterior, equal_weights(draws))
    assert np.isnan(got.ln_density).tolist() == [b in (1, 2) for b in range(8)]
    assert np.isfinite(got.total)


def test_total_skips_lost_bands():
    assert BandPrediction(np.array([1.0, np.nan, 2.0]), np.zeros(3)).total == 3.0
