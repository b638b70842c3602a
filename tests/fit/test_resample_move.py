"""Truth: moments of a normal, masses of two normals, and a bent normal whose marginals are known in closed form."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2, kstest, spearmanr

from finray_calib.fit.importance import importance_sample
from finray_calib.fit.resample_move import LARGEST_MEMORY, moved_draws
from tests.fit.test_sampler import FACTOR, MEAN, WideNormal, normal_density, two_normals

COUNT = 1000
BEND = 0.6


def bent(theta):
    """A normal whose second coordinate is bent along the square of the first."""
    z = np.linalg.solve(FACTOR, (theta - MEAN).T)
    return -0.5 * (z[0] ** 2 + (z[1] - BEND * (z[0] ** 2 - 1)) ** 2 + z[2] ** 2)


def moved(density, proposal, seed, spoil=lambda sample: sample):
    rng = np.random.default_rng(seed)
    sample = spoil(importance_sample(density, proposal, 4000, rng))
    return moved_draws(density, proposal, sample, COUNT, rng)


def unweighted(sample):
    """The proposal's own draws, as if their weights were all equal."""
    return replace(sample, weight=np.full(len(sample.weight), 1 / len(sample.weight)))


@pytest.mark.parametrize("seed", range(3))
def test_draws_follow_the_density_even_from_a_wrong_start(seed):
    draws = moved(normal_density, WideNormal(), seed, unweighted)
    assert draws.forgotten
    z = np.linalg.solve(FACTOR, (draws.theta - MEAN).T)
    # 1000 draws that forgot their start are nearly independent; 12 tests in all at 1e-4
    assert min(kstest(row, "norm").pvalue for row in z) > 1e-4
    assert kstest(np.square(z).sum(axis=0), chi2(3).cdf).pvalue > 1e-4


def test_masses_of_two_maxima_from_a_wrong_start():
    draws = moved(two_normals, WideNormal(5.0), 5, unweighted)
    assert draws.forgotten
    share = (draws.theta[:, 0] < MEAN[0]).mean()
    assert share == pytest.approx(0.7, abs=4 * np.sqrt(0.21 / COUNT))


def test_a_bent_ridge_that_the_proposal_misses_in_part():
    draws = moved(bent, WideNormal(1.5), 6)
    assert draws.forgotten
    z = np.linalg.solve(FACTOR, (draws.theta - MEAN).T)
    assert min(kstest(row, "norm").pvalue for row in (z[0], z[1] - BEND * (z[0] ** 2 - 1), z[2])) > 1e-4


def test_draws_that_hardly_move_remember_and_say_so():
    """Draws on a ring too thin for any step, and a proposal that never meets it."""

    def ring(theta):
        z = np.linalg.solve(FACTOR, (theta - MEAN).T)
        return -0.5 * (((np.hypot(z[0], z[1]) - 1) / 1e-6) ** 2 + ((z[2] - z[0]) / 1e-6) ** 2)

    rng = np.random.default_rng(7)
    turn = rng.uniform(0, 2 * np.pi, COUNT)
    start = MEAN + np.stack([np.cos(turn), np.sin(turn), np.cos(turn)], axis=1) @ FACTOR.T
    sample = unweighted(replace(importance_sample(normal_density, WideNormal(), COUNT, rng), theta=start))
    draws = moved_draws(ring, WideNormal(), sample, COUNT, rng)
    assert draws.memory.max() > LARGEST_MEMORY
    assert not draws.forgotten
    assert draws.sweeps == 700


def test_same_generator_gives_the_same_draws():
    runs = [moved(normal_density, WideNormal(), 8).theta for _ in range(2)]
    assert np.array_equal(*runs)


def test_rank_correlation_is_spearmans():
    from finray_calib.fit.resample_move import _rank_correlation

    rng = np.random.default_rng(9)
    first = rng.standard_normal((200, 2))
    second = first + rng.standard_cauchy((200, 2))
    expected = [spearmanr(first[:, i], second[:, i])[0] for i in range(2)]
    assert _rank_correlation(first, second) == pytest.approx(expected, abs=1e-12)
