import numpy as np
import pytest
from scipy.stats import multivariate_t

from finray_calib.fit import EmissionPrior, LogPosterior, find_maxima
from finray_calib.fit._importance import MixtureProposal, effective_number, normalised, tempered_weights
from tests.fit.synthetic_bands import LOG_NORMAL, ZHENG, orange, simulate

PRIOR = EmissionPrior().of(LOG_NORMAL, with_blocking=True)


def two_components():
    rng = np.random.default_rng(1)
    factors = 0.2 * np.eye(6) + 0.05 * rng.standard_normal((2, 6, 6))
    covariances = np.einsum("kij,klj->kil", factors, factors) * np.outer(PRIOR.sd, PRIOR.sd)
    centres = PRIOR.mean + np.array([[0.5], [-0.5]]) * PRIOR.sd
    return MixtureProposal(np.array([3.0, 1.0]), centres, covariances, PRIOR), centres, covariances


def test_density_is_that_of_scipys_multivariate_t_and_the_prior():
    mixture, centres, covariances = two_components()
    theta = PRIOR.draw(50, np.random.default_rng(2))
    parts = [multivariate_t(c, s, df=5).pdf(theta) for c, s in zip(centres, covariances, strict=True)]
    expected = 0.95 * (0.75 * parts[0] + 0.25 * parts[1]) + 0.05 * np.exp(PRIOR.log_density(theta))
    assert mixture.log_density(theta) == pytest.approx(np.log(expected), rel=1e-9)


def test_density_agrees_with_its_draws():
    """Importance sampling of the prior's mass, 1, with draws and density of the mixture."""
    mixture, _, _ = two_components()
    theta = mixture.draw(40_000, np.random.default_rng(2))
    ratio = np.exp(PRIOR.log_density(theta) - mixture.log_density(theta))
    # the prior is 5 % of the mixture, so the ratio is at most 20 and its sd at most sqrt(19): five standard errors
    assert ratio.max() <= 20 * (1 + 1e-9)
    assert ratio.mean() == pytest.approx(1.0, abs=5 * np.sqrt(19 / 40_000))


def test_draws_have_the_moments_of_the_mixture():
    mixture, centres, _ = two_components()
    theta = mixture.draw(40_000, np.random.default_rng(3))
    expected = 0.95 * (0.75 * centres[0] + 0.25 * centres[1]) + 0.05 * PRIOR.draw(
        200_000, np.random.default_rng(4)
    ).mean(0)
    # five standard errors
    assert (np.abs(theta.mean(axis=0) - expected) < 5 * theta.std(axis=0) / np.sqrt(40_000)).all()


def test_adaptation_makes_a_bad_proposal_good(weights):
    """A faint far-red paint: strongly curved posterior, where the Laplace approximation is almost useless."""
    theta = np.array([650.0, 3.7, np.log(0.001), 1.4, np.log(0.06), -0.1])
    data, _ = simulate(theta, weights, np.random.default_rng(1), family=ZHENG)
    posterior = LogPosterior(data, ZHENG, EmissionPrior())
    rng = np.random.default_rng(5)
    laplace = MixtureProposal.around(find_maxima(posterior, rng), posterior.prior)
    adapted = laplace.adapted(posterior, rng)

    def effective_share(mixture):
        draws = mixture.draw(4000, rng)
        return effective_number(normalised(posterior(draws) - mixture.log_density(draws))) / 4000

    assert effective_share(adapted) > max(0.1, 1.5 * effective_share(laplace))


def test_update_without_any_draw_near_a_component_keeps_the_mixture():
    mixture, _, _ = two_components()
    far = PRIOR.mean[None] + 7.5 * PRIOR.sd * np.sign(np.random.default_rng(1).standard_normal((100, 6)))
    far = np.clip(far, PRIOR.low, PRIOR.high)
    kept = mixture.updated(far, np.full(100, 0.0))
    assert kept is mixture


def test_tempered_weights_reach_the_demanded_effective_number():
    ln_weight = np.append(-np.linspace(0, 400, 300), -np.inf)
    weight = tempered_weights(ln_weight, 50.0)
    assert 50.0 <= effective_number(weight) < 100.0  # one factor of 0.8 overshoots by less than a factor of 2
    assert weight[-1] == 0.0
    flat = tempered_weights(np.zeros(10), 5.0)
    assert np.allclose(flat, 0.1)


def test_same_seed_gives_the_same_proposal(weights):
    data, _ = simulate(orange(), weights, np.random.default_rng(1))
    posterior = LogPosterior(data, LOG_NORMAL, EmissionPrior())
    theta = posterior.prior.draw(10, np.random.default_rng(0))
    values = []
    for _ in range(2):
        rng = np.random.default_rng(11)
        mixture = MixtureProposal.around(find_maxima(posterior, rng), posterior.prior).adapted(posterior, rng)
        values.append(mixture.log_density(theta))
    assert np.array_equal(*values)
