import numpy as np
import pytest
from scipy.optimize import minimize
from scipy.stats import lognorm, multivariate_normal

from finray_calib.decide._gaussian_process import Matern52, condition, draw_normal, fit_kernel

ANGLES = np.array([0.0, 7, 20, 30, 45, 60, 90])
GRID = np.linspace(0, 90, 31)


@pytest.fixture
def data():
    rng = np.random.default_rng(0)
    values = 1 + 0.4 * np.cos((ANGLES - 35) / 25) + 0.05 * rng.standard_normal(len(ANGLES))
    return values, rng.uniform(0.001, 0.005, len(ANGLES))


def test_covariance_is_the_matern_of_smoothness_five_halves():
    """The Bessel form of the Matern family, written independently."""
    from scipy.special import gamma, kv

    distance = np.array([0.5, 3.0, 20.0, 70.0])
    q = np.sqrt(5) * distance / 30
    expected = 4 * 2 ** (1 - 2.5) / gamma(2.5) * q**2.5 * kv(2.5, q)
    kernel = Matern52(30.0, 2.0)
    assert kernel.covariance(np.zeros(1), distance)[0] == pytest.approx(expected, rel=1e-12)
    assert kernel.covariance(np.zeros(1), np.zeros(1)) == pytest.approx(4.0)


def test_posterior_agrees_with_a_dense_joint_normal(data):
    """The constant as one more normal variable of huge variance, then plain conditioning of the joint normal."""
    values, noise = data
    kernel = Matern52(33.0, 0.4)
    everything = np.concatenate([ANGLES, GRID])
    vague = 1e5
    joint = kernel.covariance(everything, everything) + vague
    joint[: len(ANGLES), : len(ANGLES)] += np.diag(noise)
    gain = np.linalg.solve(joint[: len(ANGLES), : len(ANGLES)], joint[: len(ANGLES), len(ANGLES) :]).T
    mean = gain @ values
    covariance = joint[len(ANGLES) :, len(ANGLES) :] - gain @ joint[: len(ANGLES), len(ANGLES) :]
    posterior = condition(kernel, ANGLES, values, noise, GRID)
    # The flat prior is approached as noise / vague and rounding grows as vague: both near 1e-8 here.
    assert posterior.mean == pytest.approx(mean, abs=1e-6)
    assert np.abs(posterior.covariance - covariance).max() < 1e-6
    assert posterior.standard_deviation == pytest.approx(np.sqrt(np.diag(covariance)), abs=1e-5)


def test_posterior_passes_through_exact_data_and_shifts_with_them(data):
    values, _ = data
    kernel = Matern52(35.0, 0.5)
    none = np.zeros(len(ANGLES))
    posterior = condition(kernel, ANGLES, values, none, ANGLES)
    # The jitter of 1e-9 relative variance stands in for exact data.
    assert posterior.mean == pytest.approx(values, abs=1e-5)
    assert posterior.standard_deviation.max() < 1e-3
    shifted = condition(kernel, ANGLES, values + 7, none, GRID)
    assert shifted.mean == pytest.approx(condition(kernel, ANGLES, values, none, GRID).mean + 7, abs=1e-8)


def test_fitted_kernel_maximises_the_penalised_likelihood(data):
    """The same objective from scipy's densities, minimised by another algorithm from another start."""
    values, noise = data

    def loss(log_parameters):
        length, amplitude = np.exp(log_parameters)
        covariance = Matern52(length, amplitude).covariance(ANGLES, ANGLES) + np.diag(noise)
        covariance += 1e-9 * amplitude**2 * np.eye(len(ANGLES))
        inverse = np.linalg.inv(covariance)
        constant = (inverse @ values).sum() / inverse.sum()
        integrated = -0.5 * np.log(inverse.sum())
        # A density per logarithm: the lognormal density times its argument.
        prior = lognorm.logpdf(length, 0.6, scale=35) + np.log(length)
        prior += lognorm.logpdf(amplitude, 1.0, scale=0.5) + np.log(amplitude)
        return -multivariate_normal.logpdf(values, np.full(len(values), constant), covariance) - integrated - prior

    found = fit_kernel(ANGLES, values, noise)
    best = minimize(loss, np.log([20.0, 1.0]), method="Powell")
    # The grid promises 0.02, Powell stops within 0.001.
    assert loss(np.log([found.length_deg, found.amplitude_rel])) < best.fun + 0.021
    assert found.length_deg == pytest.approx(np.exp(best.x[0]), rel=0.1)


def test_draws_have_the_covariance_asked_for_even_if_it_is_singular():
    rank_one = np.outer([1.0, 2, -1], [1.0, 2, -1])
    draws = draw_normal(rank_one, 20_000, np.random.default_rng(1))
    assert draws[:, 1] == pytest.approx(2 * draws[:, 0], abs=1e-6)
    # Standard error of a variance from 20 000 draws is 1 %; five of them.
    assert np.cov(draws.T) == pytest.approx(rank_one, rel=0.05)


def test_draws_do_not_depend_on_the_signs_of_the_eigenvectors(monkeypatch):
    """LAPACK libraries return either sign; odd eigenvectors of an even kernel have two largest components."""
    covariance = Matern52(35.0, 0.5).covariance(GRID, GRID)
    plain = draw_normal(covariance, 5, np.random.default_rng(1))
    eigenvalues, vectors = np.linalg.eigh(covariance)
    rng = np.random.default_rng(2)
    for _ in range(3):
        signs = rng.choice([-1.0, 1.0], len(GRID))
        rounding = 1 + 1e-12 * rng.standard_normal(vectors.shape)
        monkeypatch.setattr(np.linalg, "eigh", lambda _, v=vectors * rounding * signs: (eigenvalues, v))
        assert draw_normal(covariance, 5, np.random.default_rng(1)) == pytest.approx(plain, abs=1e-9)
