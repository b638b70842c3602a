from dataclasses import replace

import numpy as np
import pytest

from data_schemas import FitError
from finray_calib.fit import EmissionPrior, SamplerSettings, sample_posterior
from finray_calib.fit._band_data import MOST_SAMPLED_LEAKS
from finray_calib.fit._markov_chains import LEAST_WALKERS, initial_walkers
from finray_calib.spectra import FAMILIES

MEAN = np.array([560.0, 3.8, 0.5])
FACTOR = np.array([[4.0, 0.0, 0.0], [0.05, 0.08, 0.0], [-0.3, 0.1, 0.5]])


class WideNormal:
    """A proposal three times too wide and off centre."""

    def __init__(self, width=3.0):
        self.factor = width * FACTOR
        self.mean = MEAN + FACTOR @ np.ones(3)

    def draw(self, count, rng):
        return self.mean + rng.standard_normal((count, 3)) @ self.factor.T

    def log_density(self, theta):
        z = np.linalg.solve(self.factor, (theta - self.mean).T)
        return -0.5 * (z**2).sum(axis=0) - np.log(np.abs(np.linalg.det(self.factor))) - 1.5 * np.log(2 * np.pi)


def normal_density(theta):
    return -0.5 * (np.linalg.solve(FACTOR, (theta - MEAN).T) ** 2).sum(axis=0)


def two_normals(theta):
    """Mass 0.7 at -5 and 0.3 at +5 posterior widths along the first axis."""
    shifts = (np.log(0.7), -5 * FACTOR[:, 0]), (np.log(0.3), 5 * FACTOR[:, 0])
    return np.logaddexp.reduce([ln_mass + normal_density(theta - shift) for ln_mass, shift in shifts])


def test_moments_of_a_normal_posterior():
    draws, diagnostics = sample_posterior(normal_density, WideNormal(), SamplerSettings(), np.random.default_rng(2))
    assert diagnostics.converged
    assert diagnostics.steps >= 50 * diagnostics.autocorrelation_steps.max()
    covariance = FACTOR @ FACTOR.T
    sd = np.sqrt(np.diag(covariance))
    effective = diagnostics.bulk_ess.min()
    # five Monte Carlo standard errors each: mean sd/sqrt(n), sd sd/sqrt(2 n), correlation at most 1/sqrt(n)
    assert np.allclose(draws.mean(axis=0), MEAN, atol=5 * sd / np.sqrt(effective), rtol=0)
    assert np.allclose(draws.std(axis=0), sd, rtol=5 / np.sqrt(2 * effective))
    expected = covariance / np.outer(sd, sd)
    assert np.allclose(np.corrcoef(draws.T), expected, atol=5 / np.sqrt(effective))


def test_masses_of_two_separate_maxima():
    draws, diagnostics = sample_posterior(two_normals, WideNormal(5.0), SamplerSettings(), np.random.default_rng(3))
    share = (draws[:, 0] < MEAN[0]).mean()
    # the share is a mean of draws with sd sqrt(.7 .3); five standard errors
    assert share == pytest.approx(0.7, abs=5 * np.sqrt(0.21 / diagnostics.bulk_ess[0]))


def test_same_generator_gives_the_same_draws():
    settings = SamplerSettings(walkers=24, block_steps=200, most_steps=400, kept_draws=100)
    runs = [sample_posterior(normal_density, WideNormal(), settings, np.random.default_rng(7))[0] for _ in range(2)]
    assert np.array_equal(*runs)
    assert runs[0].shape == (100, 3)


def test_limit_of_steps_is_kept_and_reported():
    settings = SamplerSettings(walkers=24, block_steps=100, most_steps=150, autocorrelation_times=1000.0)
    _, diagnostics = sample_posterior(normal_density, WideNormal(), settings, np.random.default_rng(7))
    assert not diagnostics.converged
    assert diagnostics.steps == 150 - int(0.3 * 150)


def test_walkers_start_distinct_and_near_the_posterior():
    walkers = initial_walkers(normal_density, WideNormal(10.0), 64, np.random.default_rng(4))
    assert len(np.unique(walkers, axis=0)) == 64
    # the proposal's own draws average 3 x 10^2 squared widths; tempering must remove most of that
    assert -2 * normal_density(walkers).mean() < 60


def test_fewest_walkers_are_twice_the_parameters_of_the_largest_model():
    largest = max(EmissionPrior().of(family, with_blocking=True).size for family in FAMILIES.values())
    assert 2 * (largest + MOST_SAMPLED_LEAKS) == LEAST_WALKERS


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"walkers": 33}, "an even number of at least 24, .* but is 33"),
        ({"walkers": 22}, "an even number of at least 24, twice the parameters .* but is 22"),
        ({"block_steps": 50}, "at least 100 and at most most_steps"),
        ({"kept_draws": 10}, "at least 100 for 95 % intervals"),
    ],
)
def test_impossible_settings_are_refused(fields, message):
    with pytest.raises(FitError, match=message):
        replace(SamplerSettings(), **fields)
