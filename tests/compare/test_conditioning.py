"""Draws narrowed by captured levels, against the closed-form posterior of linear normal problems."""

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from finray_calib.compare import _input_draws as conditioning
from finray_calib.compare._input_draws import InputDraws, condition_on_levels

DRAWS = 40_000
LEVELS = (2, 3, 2)
SIZE = int(np.prod(LEVELS))
# of z: two entries of the matrix, one move, the drift
PRIOR_SD = np.array([0.1, 0.3, 0.2, 0.02])
NOISE = np.full(LEVELS, 0.01**2)


def drawn(rng):
    z = PRIOR_SD * rng.standard_normal((DRAWS, 4))
    return InputDraws(np.ones((1, 2)), {"paint": z[:, None, :2]}, {"depth": z[:, 2]}, z[:, 3])


def packed(draws):
    return np.column_stack([draws.log_factors["paint"][:, 0], draws.moves_mm["depth"], draws.log_drift])


@pytest.fixture
def problem():
    """Return the sensitivity (levels, z) and the residual of z = 0."""
    rng = np.random.default_rng(0)
    return rng.standard_normal((SIZE, 4)), 0.1 * rng.standard_normal(SIZE)


def residual_of(sensitivity, at_zero):
    return lambda draws: (at_zero + packed(draws) @ sensitivity.T).reshape(-1, *LEVELS)


def model_covariance():
    """Correlation 1/3 of one channel in both images, 2/3 of the parts of one image's channel, none between channels."""
    c = np.zeros((SIZE, SIZE))
    places = list(np.ndindex(LEVELS))
    for i, (image, channel, part) in enumerate(places):
        for j, (other_image, other_channel, other_part) in enumerate(places):
            if channel == other_channel:
                c[i, j] = 1.0 / 3.0 + (image == other_image) / 3.0 + ((image, part) == (other_image, other_part)) / 3.0
    return c


def posterior(sensitivity, at_zero, size):
    """Return mean and covariance of z given e + d + noise = 0."""
    prior = np.diag(PRIOR_SD**2)
    r = size**2 * model_covariance() + np.diag(NOISE.ravel())
    gain = prior @ sensitivity.T @ np.linalg.inv(sensitivity @ prior @ sensitivity.T + r)
    return -gain @ at_zero, prior - gain @ sensitivity @ prior


def require_moments(z, mean, covariance):
    # four standard errors; the gain is estimated from the draws, which doubles them
    spread = np.sqrt(np.diag(covariance))
    assert np.abs(z.mean(axis=0) - mean).max() < (8.0 * spread / np.sqrt(DRAWS)).max()
    scaled = (np.cov(z.T) - covariance) / np.outer(spread, spread)
    assert np.abs(scaled).max() < 8.0 * np.sqrt(2.0 / DRAWS)


@pytest.mark.parametrize("size", [0.01, 0.2])
def test_one_size_of_the_model_error_gives_the_normal_posterior(problem, size, monkeypatch):
    monkeypatch.setattr(conditioning, "MODEL_ERROR_REL", np.array([size]))
    rng = np.random.default_rng(1)
    before = drawn(rng)
    after = condition_on_levels(before, residual_of(*problem), NOISE, rng)
    require_moments(packed(after), *posterior(*problem, size))
    assert packed(before).std(axis=0) == pytest.approx(PRIOR_SD, rel=4.0 / np.sqrt(2.0 * DRAWS))


def test_the_size_has_its_own_posterior(problem):
    """Levels that no input explains: a mixture over sizes, weighted by their likelihood."""
    sensitivity, at_zero = problem
    rng = np.random.default_rng(2)
    after = condition_on_levels(drawn(rng), residual_of(*problem), NOISE, rng)
    spread = sensitivity @ np.diag(PRIOR_SD**2) @ sensitivity.T + np.diag(NOISE.ravel())
    sizes = conditioning.MODEL_ERROR_REL
    log_chance = [multivariate_normal(cov=spread + t**2 * model_covariance()).logpdf(at_zero) for t in sizes]
    chance = np.exp(log_chance - np.max(log_chance))
    chance /= chance.sum()
    parts = [posterior(*problem, t) for t in sizes]
    mean = sum(p * m for p, (m, _) in zip(chance, parts, strict=True))
    between = sum(p * np.outer(m - mean, m - mean) for p, (m, _) in zip(chance, parts, strict=True))
    covariance = between + sum(p * v for p, (_, v) in zip(chance, parts, strict=True))
    # mixtures have heavier tails than a normal distribution: the margins of its moments, and as much again
    z = packed(after)
    assert z.mean(axis=0) == pytest.approx(mean, abs=(16.0 * np.sqrt(np.diag(covariance) / DRAWS)).max())
    assert z.std(axis=0) == pytest.approx(np.sqrt(np.diag(covariance)), rel=16.0 / np.sqrt(2.0 * DRAWS))
    # levels that are off by 10 % speak for sizes of that order
    assert 0.03 < sizes[np.argmax(chance)] < 0.3


def test_levels_that_fit_leave_the_inputs_and_narrow_them(problem):
    rng = np.random.default_rng(3)
    after = condition_on_levels(drawn(rng), residual_of(problem[0], np.zeros(SIZE)), NOISE, rng)
    z = packed(after)
    assert np.abs(z.mean(axis=0)).max() < (8.0 * PRIOR_SD / np.sqrt(DRAWS)).max()
    # the levels move by as much as the inputs, and tell them to about 1 %
    assert (z.std(axis=0)[:3] < 0.1 * PRIOR_SD[:3]).all()


def test_an_input_that_moves_no_level_is_left_alone():
    sensitivity = np.random.default_rng(4).standard_normal((SIZE, 4))
    sensitivity[:, 2] = 0.0
    rng = np.random.default_rng(5)
    after = condition_on_levels(drawn(rng), residual_of(sensitivity, np.full(SIZE, 0.05)), NOISE, rng)
    assert after.moves_mm["depth"].std() == pytest.approx(PRIOR_SD[2], rel=8.0 / np.sqrt(2.0 * DRAWS))
    assert after.matrix.shape == (DRAWS, 1, 2)
