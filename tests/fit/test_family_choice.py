"""Choice between families, prior sensitivity and the check by chains, on posteriors of known form."""

import re
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import norm

from finray_calib.fit import (
    DEFAULT_FAMILY,
    NO_DISCREPANCY,
    EmissionPrior,
    SamplerSettings,
    choose_family,
    fit_emission,
    score_families,
)
from finray_calib.fit._family_choice import BandPrediction, FamilyScore
from finray_calib.fit._importance import mean_shifts
from finray_calib.fit._paint_calibration import check_by_chain
from tests.fit.synthetic_bands import LOG_NORMAL, QUICK, orange, simulate

K = np.zeros(4)


def evidence(value):
    return SimpleNamespace(sampling=SimpleNamespace(sample=SimpleNamespace(ln_evidence=value)))


def test_probabilities_are_shares_of_the_evidence():
    left_out = {name: BandPrediction(np.arange(4.0), K) for name in ("zheng2014", DEFAULT_FAMILY)}
    scores = score_families({"zheng2014": evidence(-1000.0), DEFAULT_FAMILY: evidence(-1000.0 + np.log(3.0))}, left_out)
    assert scores["zheng2014"].probability == pytest.approx(0.25)
    assert scores[DEFAULT_FAMILY].probability == pytest.approx(0.75)


def test_error_of_a_difference_is_that_of_a_sum_over_bands():
    apart = np.array([0.5, -1.0, 2.0, 0.1, np.nan])
    base = np.array([1.0, 2.0, 3.0, 4.0, np.nan])
    scores = score_families(
        {"zheng2014": evidence(0.0), DEFAULT_FAMILY: evidence(0.0)},
        {"zheng2014": BandPrediction(base + apart, np.zeros(5)), DEFAULT_FAMILY: BandPrediction(base, np.zeros(5))},
    )
    assert scores["zheng2014"].difference_sd == pytest.approx(2 * np.std([0.5, -1.0, 2.0, 0.1], ddof=1))
    assert scores[DEFAULT_FAMILY].difference_sd == 0.0


def scores(probability, gain, sd):
    return {
        "zheng2014": FamilyScore(probability, BandPrediction(np.array([gain]), K), sd),
        DEFAULT_FAMILY: FamilyScore(1 - probability, BandPrediction(np.array([0.0]), K), 0.0),
    }


@pytest.mark.parametrize(
    ("probability", "gain", "sd", "expected", "words"),
    [
        (0.30, 5.0, 1.0, DEFAULT_FAMILY, "the default, and the most probable given these bands"),
        (0.89, 5.0, 1.0, DEFAULT_FAMILY, "do not clearly distinguish the families"),
        (0.99, 1.9, 1.0, DEFAULT_FAMILY, "although the bands make it improbable"),
        (0.99, -3.0, 1.0, DEFAULT_FAMILY, "zheng2014 -3.0"),
        (0.99, 2.1, 1.0, "zheng2014", "predicts left-out bands better by 2.1 .- 1.0 nats"),
        (0.9998, 43.0, 27.0, DEFAULT_FAMILY, "although the bands make it improbable"),
        (0.99999, 43.0, 27.0, "zheng2014", "the bands rule out the default"),
        (0.99999, -43.0, 5.0, DEFAULT_FAMILY, "zheng2014 -43.0"),
    ],
)
def test_another_family_needs_probability_and_prediction(probability, gain, sd, expected, words):
    name, why = choose_family(scores(probability, gain, sd))
    assert name == expected
    assert re.search(words, why)


def test_prior_shift_of_a_normal_posterior_is_the_closed_form():
    """Prior N(m, s), likelihood N(x, e): the mean under a wider prior follows from the sum of precisions."""
    prior = EmissionPrior().of(LOG_NORMAL, with_blocking=True)
    d = 1  # ln FWHM: a prior without truncation
    m, s = prior.mean[d], prior.sd[d]
    x, e = m + 1.5 * s, 0.8 * s

    def posterior_of(width):
        precision = 1 / (width * s) ** 2 + 1 / e**2
        return (m / (width * s) ** 2 + x / e**2) / precision, precision**-0.5

    mean, sd = posterior_of(1.0)
    rng = np.random.default_rng(3)
    theta = np.tile(prior.mean, (20_000, 1))
    theta[:, d] = norm(mean, sd).rvs(20_000, random_state=rng)
    for factor in (0.5, 2.0):
        shift = mean_shifts(prior, theta, {"ln_fwhm": theta[:, d], "fixed": np.ones(20_000)}, factor)
        # draws are reweighted by factors of up to a few: four standard errors of some 5000 effective draws
        assert shift["ln_fwhm"] == pytest.approx((posterior_of(factor)[0] - mean) / sd, abs=4 / np.sqrt(5000))
        assert shift["fixed"] == 0.0


def test_chain_confirms_a_fit_and_names_every_parameter(weights):
    data, _ = simulate(orange(), weights, np.random.default_rng(11))
    posterior = fit_emission(data, LOG_NORMAL, EmissionPrior(), NO_DISCREPANCY, QUICK, np.random.default_rng(12))
    settings = SamplerSettings(walkers=32, most_steps=1200)
    check = check_by_chain(posterior, settings, np.random.default_rng(13))
    assert set(check.mean_shift_sd) == set(posterior.log_posterior.prior.names) == set(check.r_hat)
    effective = min(*check.effective_samples.values(), len(posterior.draws))
    # five combined standard errors
    assert max(map(abs, check.mean_shift_sd.values())) < 5 * np.sqrt(2 / effective)
    assert check.walkers == 32
    moved = posterior.draws + posterior.draws.std(axis=0)
    wrong = check_by_chain(SimpleNamespace(**{**vars(posterior), "draws": moved}), settings, np.random.default_rng(13))
    assert min(wrong.mean_shift_sd.values()) < -0.8
