"""Truth: moments of a normal, masses of two normals, and a bent normal whose marginals are known in closed form."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2, kstest, spearmanr

from finray_calib.fit import LARGEST_MEMORY, importance_sample
from finray_calib.fit._likelihood import Maxima
from finray_calib.fit._markov_chains import _centred_ranks, _largest_correlation, moved_draws
from tests.fit.test_sampler import FACTOR, MEAN, WideNormal, normal_density, two_normals

COUNT = 1000
BEND = 0.6
PRECISION = np.linalg.inv(FACTOR @ FACTOR.T)


def maxima_at(*places):
    return Maxima(np.array(places), np.zeros(len(places)), np.array([PRECISION] * len(places)))


ONE = maxima_at(MEAN)


def bent(theta):
    """A normal whose second coordinate is bent along the square of the first."""
    z = np.linalg.solve(FACTOR, (theta - MEAN).T)
    return -0.5 * (z[0] ** 2 + (z[1] - BEND * (z[0] ** 2 - 1)) ** 2 + z[2] ** 2)


def moved(density, proposal, seed, spoil=lambda sample: sample, maxima=ONE):
    rng = np.random.default_rng(seed)
    sample = spoil(importance_sample(density, proposal, 4000, rng))
    return moved_draws(density, proposal, sample, maxima, COUNT, rng)


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
    draws = moved(
        two_normals, WideNormal(5.0), 5, unweighted, maxima_at(MEAN - 5 * FACTOR[:, 0], MEAN + 5 * FACTOR[:, 0])
    )
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
    draws = moved_draws(ring, WideNormal(), sample, ONE, COUNT, rng)
    assert draws.memory > LARGEST_MEMORY
    assert not draws.forgotten
    assert draws.sweeps == 700


def test_same_generator_gives_the_same_draws():
    runs = [moved(normal_density, WideNormal(), 8).theta for _ in range(2)]
    assert np.array_equal(*runs)


def test_a_small_maximum_that_never_exchanges_is_noticed():
    """Each of two maxima of different shapes holds half the mass; the start has 3 % in one, and nothing leads over."""
    far = 40 * FACTOR[:, 0]

    def two_shapes(theta):
        beside = np.linalg.solve(FACTOR, (theta - MEAN - far).T)
        return np.logaddexp(
            normal_density(theta), -0.5 * (np.diag([1e3, 1e3, 1e3]) @ beside**2).sum(axis=0) + 1.5 * np.log(1e3)
        )

    rng = np.random.default_rng(10)
    small = rng.standard_normal((30, 3)) / np.sqrt(1e3) @ FACTOR.T + MEAN + far
    start = np.concatenate([MEAN + rng.standard_normal((COUNT - 30, 3)) @ FACTOR.T, small])
    sample = unweighted(replace(importance_sample(normal_density, WideNormal(), COUNT, rng), theta=start))
    known = moved_draws(two_shapes, WideNormal(1.0), sample, maxima_at(MEAN, MEAN + far), COUNT, rng)
    in_small = np.linalg.solve(FACTOR, (known.theta - MEAN).T)[0] > 20
    assert in_small.mean() == pytest.approx(0.03, abs=0.01)  # wrong by far: one half is true
    assert known.memory > 0.5
    assert not known.forgotten


def test_copies_that_stay_are_not_forgotten():
    """One draw carries all the weight, and hardly a copy of it ever moves."""

    def needle(theta):
        return 1e12 * normal_density(theta)

    rng = np.random.default_rng(11)
    sample = importance_sample(normal_density, WideNormal(), COUNT, rng)
    alone = replace(sample, theta=np.where(np.arange(COUNT)[:, None] == 7, MEAN, sample.theta), weight=np.eye(COUNT)[7])
    draws = moved_draws(needle, WideNormal(), alone, ONE, COUNT, rng)
    assert draws.distinct < 0.1 * COUNT
    assert not draws.forgotten


def test_correlations_are_spearmans_and_pearsons():
    rng = np.random.default_rng(9)
    first = rng.standard_normal((200, 2))
    second = first + rng.standard_cauchy((200, 2))
    expected = max(spearmanr(first[:, i], second[:, i])[0] for i in range(2))
    assert _largest_correlation(_centred_ranks(first), _centred_ranks(second)) == pytest.approx(expected, abs=1e-12)
    belongs = rng.random((2, 200, 1)) < 0.3
    centred = belongs - belongs.mean(axis=1, keepdims=True)
    assert _largest_correlation(*centred) == pytest.approx(abs(np.corrcoef(belongs[:, :, 0])[0, 1]), abs=1e-12)
