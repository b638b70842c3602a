import numpy as np
import pytest

from finray_calib.fit.likelihood import LogPosterior
from finray_calib.fit.map_search import find_maxima, starting_points
from finray_calib.fit.mixture_proposal import MixtureProposal, effective_number, normalised, tempered_weights
from finray_calib.fit.prior import EmissionPrior


@pytest.fixture(scope="module")
def posterior(orange_theta, simulate_bands):
    return LogPosterior(simulate_bands(orange_theta, np.random.default_rng(3)), EmissionPrior())


@pytest.fixture(scope="module")
def maxima(posterior):
    return find_maxima(posterior, np.random.default_rng(0))


def test_no_point_of_a_dense_random_search_is_higher(posterior, maxima, orange_theta):
    best, height = maxima.theta[0], maxima.log_posterior[0]
    assert height >= posterior(orange_theta[None])[0]
    rng = np.random.default_rng(1)
    factor = np.linalg.cholesky(np.linalg.inv(maxima.information[0]))
    for width in (1.0, 0.1, 0.01):
        near = best + width * rng.standard_normal((5000, 6)) @ factor.T
        assert posterior(near).max() <= height + 1e-5  # the search stops at changes of 1e-6
    assert posterior(EmissionPrior().draw(5000, rng)).max() < height


def test_maximum_lies_within_the_posterior_width_of_the_truth(maxima, orange_theta):
    apart = maxima.theta[0] - orange_theta
    # chi-square with 6 degrees of freedom exceeds 35 with probability 4e-6
    assert apart @ maxima.information[0] @ apart < 35


def test_lost_bands_leave_several_maxima(orange_theta, simulate_bands):
    """Without the bands on either side of the mode, a broad and a narrow curve describe the data."""
    usable = np.zeros((8, 3), bool)
    usable[[1, 2, 6, 7]] = True
    usable[:, [0, 2]] = False
    found = []
    for seed in range(3):
        data = simulate_bands(orange_theta, np.random.default_rng(seed), usable)
        maxima = find_maxima(LogPosterior(data, EmissionPrior()), np.random.default_rng(seed))
        found.append(len(maxima.theta))
        assert (np.diff(maxima.log_posterior) <= 0).all()
        for i, theta in enumerate(maxima.theta):
            others = np.delete(maxima.theta, i, axis=0) - theta
            assert (np.einsum("ni,ij,nj->n", others, maxima.information[i], others) > 0.5).all()
    assert max(found) > 1


def test_starting_points_cover_modes_and_signs_of_skewness(posterior):
    starts = starting_points(posterior, np.random.default_rng(0))
    counts, _, _ = np.histogram2d(starts[:, 0], starts[:, 2], bins=[np.linspace(470, 720, 5), [-6, 0, 6]])
    assert (counts == 2).all()


def test_mixture_density_agrees_with_its_draws(maxima):
    """Importance sampling of the prior's mass, 1, with draws and density of the mixture."""
    prior, rng = EmissionPrior(), np.random.default_rng(2)
    mixture = MixtureProposal.around(maxima, prior)
    theta = mixture.draw(40_000, rng)
    ratio = np.exp(prior.log_density(theta) - mixture.log_density(theta))
    # the prior is 5 % of the mixture, so the ratio is at most 20 and its sd at most sqrt(19): five standard errors
    assert ratio.max() <= 20 * (1 + 1e-9)
    assert ratio.mean() == pytest.approx(1.0, abs=5 * np.sqrt(19 / 40_000))


def test_adaptation_makes_a_bad_proposal_good(orange_theta, simulate_bands):
    """A faint far-red paint: strongly curved posterior, where the Laplace approximation is almost useless."""
    theta = np.array([650.0, 3.7, 1.4, np.log(0.001), np.log(0.06), -0.1])
    posterior = LogPosterior(simulate_bands(theta, np.random.default_rng(1)), EmissionPrior())
    rng = np.random.default_rng(5)
    laplace = MixtureProposal.around(find_maxima(posterior, rng), EmissionPrior())
    adapted = laplace.adapted(posterior, rng)

    def effective_share(mixture):
        draws = mixture.draw(4000, rng)
        return effective_number(normalised(posterior(draws) - mixture.log_density(draws))) / 4000

    assert effective_share(adapted) > max(0.1, 1.5 * effective_share(laplace))


def test_tempered_weights_reach_the_demanded_effective_number():
    ln_weight = np.append(-np.linspace(0, 400, 300), -np.inf)
    weight = tempered_weights(ln_weight, 50.0)
    assert 50.0 <= effective_number(weight) < 100.0  # one factor of 0.8 overshoots by less than a factor of 2
    assert weight[-1] == 0.0
    flat = tempered_weights(np.zeros(10), 5.0)
    assert np.allclose(flat, 0.1)
