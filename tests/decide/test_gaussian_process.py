"""Random curves whose smoothness, length and amplitude are summed over: dense joint normals, limits, draws."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.special import gamma, kv
from scipy.stats import multivariate_normal

from finray_calib.decide._gaussian_process import (
    CurvePrior,
    Observations,
    curve_posterior,
    draw_normal,
    matern_correlation,
    observations,
)

ANGLES = np.array([0.0, 7, 20, 30, 45, 60, 90])
GRID = np.linspace(0, 90, 31)
#: Few nodes, so that the sum over them can be written out.
FEW = CurvePrior(30.0, 0.7, 0.4, 1.0, np.array([0.1, 0.6]), (0.5, 2.5), np.array([12.0, 35.0]))
ONE = CurvePrior(30.0, 0.7, 0.4, 1.0, np.array([0.4]), (2.5,), np.array([33.0]))


@pytest.fixture
def data():
    rng = np.random.default_rng(0)
    values = 1 + 0.4 * np.cos((ANGLES - 35) / 25) + 0.05 * rng.standard_normal(len(ANGLES))
    return values, rng.uniform(0.001, 0.005, len(ANGLES))


def matern_by_bessel_functions(angles, length, smoothness):
    """The Matern correlation of any smoothness, from its definition."""
    q = np.maximum(np.sqrt(2 * smoothness) * np.abs(np.subtract.outer(angles, angles)) / length, 1e-10)
    return 2 ** (1 - smoothness) / gamma(smoothness) * q**smoothness * kv(smoothness, q)


def with_constant(values, noise):
    return observations(ANGLES, values, np.diag(noise), np.ones((len(ANGLES), 1)))


def dense(prior, values, noise, contact, same_constant, shares=(1.0,), grid_contact=0):
    """Mean and covariance on GRID by conditioning of joint normals, the constant one more variable of huge variance."""
    vague, size = 1e4, len(values)
    everything = np.concatenate([ANGLES[:size], GRID])
    contacts = np.concatenate([contact, np.full(len(GRID), grid_contact)])
    ln_weights, means, covariances = [], [], []
    for amplitude in prior.amplitudes_rel:
        for nu in prior.smoothnesses:
            for length in prior.lengths_deg:
                for shared in shares:
                    share = np.where(np.equal.outer(contacts, contacts), 1.0, shared)
                    joint = amplitude**2 * share * matern_by_bessel_functions(everything, length, nu)
                    joint += vague * same_constant
                    whole = joint[:size, :size] + np.diag(noise)
                    gain = np.linalg.solve(whole, joint[:size, size:]).T
                    ln_weight = multivariate_normal.logpdf(values, np.zeros(size), whole)
                    ln_weight -= 0.5 * (np.log(length / prior.length_deg) / prior.length_ln_sd) ** 2
                    ln_weight -= 0.5 * (np.log(amplitude / prior.amplitude_rel) / prior.amplitude_ln_sd) ** 2
                    ln_weights.append(ln_weight)
                    means.append(gain @ values)
                    covariances.append(joint[size:, size:] - gain @ joint[:size, size:])
    weights = np.exp(np.array(ln_weights) - max(ln_weights))
    weights /= weights.sum()
    mean = weights @ np.array(means)
    spread = sum(w * (c + np.outer(m, m)) for w, c, m in zip(weights, covariances, means, strict=True))
    return mean, spread - np.outer(mean, mean)


def test_correlations_agree_with_bessel_functions():
    for smoothness in (0.5, 1.5, 2.5):
        expected = matern_by_bessel_functions(GRID, 20.0, smoothness)
        assert matern_correlation(GRID, GRID, 20.0, smoothness) == pytest.approx(expected, abs=1e-9)
    with pytest.raises(ValueError, match=r"smoothness nu must be 0\.5, 1\.5 or 2\.5, .* got 2"):
        matern_correlation(GRID, GRID, 20.0, 2.0)


def test_posterior_agrees_with_dense_joint_normals(data):
    values, noise = data
    mean, covariance = dense(FEW, values, noise, np.zeros(7, dtype=int), 1.0)
    found = curve_posterior(FEW, with_constant(values, noise), GRID)
    # The flat prior is approached as noise / vague, rounding grows as vague: both near 1e-6.
    assert found.mean[0] == pytest.approx(mean, abs=1e-5)
    assert np.abs(found.covariance - covariance).max() < 1e-5


def test_several_curves_share_a_part_that_is_summed_over(data):
    """Values of two curves; expected third one, of which nothing was seen, and the first."""
    values, noise = data
    contact = np.array([0, 1, 1, 0, 1, 0, 1])
    seen = Observations(ANGLES, values - 1, np.diag(noise), np.zeros((7, 0)), contact)
    found = curve_posterior(FEW, seen, GRID, contacts=3)
    shares = (0.1, 0.3, 0.5, 0.7, 0.9)
    for number in (0, 2):
        mean, covariance = dense(FEW, values - 1, noise, contact, 0.0, shares, number)
        assert found.mean[number] == pytest.approx(mean, abs=1e-7)
        draws = found.draws(20_000, np.random.default_rng(1))[:, number]
        sd = np.sqrt(np.diag(covariance))
        # 5 standard errors of a mean, and 3 % of a standard deviation of a mixture
        assert (np.abs(draws.mean(axis=0) - mean) < 5 * sd / np.sqrt(20_000)).all()
        assert draws.std(axis=0) == pytest.approx(sd, rel=0.03)


def test_posterior_passes_through_exact_data_and_shifts_with_them(data):
    values, _ = data
    none = np.full(len(ANGLES), 1e-12)
    found = curve_posterior(ONE, with_constant(values, none), ANGLES)
    # The jitter of 1e-9 relative variance stands in for exact data.
    assert found.mean[0] == pytest.approx(values, abs=1e-5)
    assert np.diag(found.covariance).max() < 1e-6
    shifted = curve_posterior(ONE, with_constant(values + 7, none), ANGLES)
    assert shifted.mean[0] == pytest.approx(found.mean[0] + 7, abs=1e-8)


def test_draws_have_the_posterior_mean_and_spread_with_their_constant(data):
    values, noise = data
    found = curve_posterior(FEW, with_constant(values, noise), GRID)
    draws = found.draws(20_000, np.random.default_rng(1))[:, 0]
    sd = np.sqrt(np.diag(found.covariance))
    assert (np.abs(draws.mean(axis=0) - found.mean[0]) < 5 * sd / np.sqrt(20_000)).all()
    assert draws.std(axis=0) == pytest.approx(sd, rel=0.03)
    # neighbouring angles move together as the covariance says; few draws of a mixture carry its spread between the
    # observations, which makes a correlation as uncertain as one of a fifth as many normal draws: 5 standard errors
    expected = found.covariance / np.outer(sd, sd)
    assert np.corrcoef(draws.T) == pytest.approx(expected, abs=5 / np.sqrt(4_000))


def test_likelihood_of_other_values_is_that_of_a_new_posterior(data):
    """What importance sampling weights shapes with."""
    values, noise = data
    seen = with_constant(values, noise)
    found = curve_posterior(FEW, seen, GRID)
    other = values + 0.1 * np.sin(ANGLES)
    there = curve_posterior(FEW, replace(seen, values=other), GRID)
    weighed = found.ln_likelihood(np.array([values, other]))
    expected = np.exp(weighed[..., 1] - weighed[..., 1].max())
    assert there.weights == pytest.approx(expected / expected.sum(), abs=1e-12)


def test_draws_have_the_covariance_asked_for_even_if_it_is_singular():
    rank_one = np.outer([1.0, 2, -1], [1.0, 2, -1])
    draws = draw_normal(rank_one, 20_000, np.random.default_rng(1))
    assert draws[:, 1] == pytest.approx(2 * draws[:, 0], abs=1e-6)
    # Standard error of a variance from 20 000 draws is 1 %; five of them.
    assert np.cov(draws.T) == pytest.approx(rank_one, rel=0.05)


def test_draws_do_not_depend_on_the_signs_of_the_eigenvectors(monkeypatch):
    """LAPACK libraries return either sign; odd eigenvectors of an even kernel have two largest components."""
    covariance = 0.25 * matern_correlation(GRID, GRID, 35.0, 2.5)
    plain = draw_normal(covariance, 5, np.random.default_rng(1))
    eigenvalues, vectors = np.linalg.eigh(covariance)
    rng = np.random.default_rng(2)
    for _ in range(3):
        signs = rng.choice([-1.0, 1.0], len(GRID))
        rounding = 1 + 1e-12 * rng.standard_normal(vectors.shape)
        monkeypatch.setattr(np.linalg, "eigh", lambda _, v=vectors * rounding * signs: (eigenvalues, v))
        assert draw_normal(covariance, 5, np.random.default_rng(1)) == pytest.approx(plain, abs=1e-9)
