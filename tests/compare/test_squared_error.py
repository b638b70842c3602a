"""Squared errors as quadratic forms, against direct sums and against many draws of noise."""

import numpy as np
import pytest

from finray_calib.compare._region_sums import NoiseCovariance, noise_covariance, squared_error

PIXELS, CHANNELS, LAYERS = 400, 3, 4
ROUNDING = 1e-12


def images(rng):
    """Return layers (P, L), weights (C, L) and a capture (P, C) that they miss by some per cent."""
    layers = rng.uniform(0.5, 1.5, (PIXELS, LAYERS))
    weights = rng.uniform(0.1, 1.0, (CHANNELS, LAYERS))
    return layers, weights, layers @ weights.T * rng.uniform(0.9, 1.1, (PIXELS, CHANNELS))


def test_every_draw_is_the_direct_sum():
    rng = np.random.default_rng(0)
    first, _, captured = images(rng)
    second = first * rng.uniform(0.9, 1.1, first.shape)
    variance = rng.uniform(0.0, 0.01, captured.shape)
    draws = 50
    weights = rng.standard_normal((draws, CHANNELS, LAYERS))
    exposure, drift = rng.uniform(0.5, 2.0, (2, draws))
    found = squared_error((first, second), captured, variance)(weights, exposure, drift)
    for d in range(draws):
        errors = [exposure[d] * half @ weights[d].T - drift[d] * captured for half in (first, second)]
        direct = (errors[0] * errors[1]).sum(axis=0) - drift[d] ** 2 * variance.sum(axis=0)
        assert found[d] == pytest.approx(direct, rel=ROUNDING, abs=1e-9)


def test_equal_halves_without_noise_give_the_plain_squared_error():
    layers, weights, captured = images(np.random.default_rng(1))
    found = squared_error((layers, layers), captured, np.zeros_like(captured))(weights[None], np.ones(1), np.ones(1))
    assert found[0] == pytest.approx(((layers @ weights.T - captured) ** 2).sum(axis=0), rel=1e-9)


def noisy_sums(rng, error, signal, s, d, b):
    """Return noise-corrected sums of (S - D)^2 by halves and of (B - D)^2 for one draw of the noise."""
    halves = [error + np.sqrt(2.0 * s) * rng.standard_normal(error.shape) for _ in range(2)]
    of_capture = np.sqrt(d) * rng.standard_normal(error.shape)
    of_error = ((halves[0] - of_capture) * (halves[1] - of_capture) - d).sum(axis=0)
    doing_nothing = signal + np.sqrt(b) * rng.standard_normal(error.shape) - of_capture
    return of_error, (doing_nothing**2 - b - d).sum(axis=0)


def test_halves_leave_no_bias_from_noise():
    """Noise of the render as large as its error, of the capture twice that: 300 draws, three standard errors."""
    rng = np.random.default_rng(2)
    layers, weights, captured = images(rng)
    truth = ((layers @ weights.T - captured) ** 2).sum(axis=0)
    variance = np.full_like(captured, 0.02)
    found, plain = [], []
    for _ in range(300):
        halves = tuple(layers + 0.1 * rng.standard_normal(layers.shape) for _ in range(2))
        noisy = captured + np.sqrt(variance) * rng.standard_normal(captured.shape)
        found.append(squared_error(halves, noisy, variance)(weights[None], np.ones(1), np.ones(1))[0])
        plain.append((((halves[0] + halves[1]) / 2.0 @ weights.T - noisy) ** 2).sum(axis=0))
    standard_error = np.std(found, axis=0, ddof=1) / np.sqrt(300)
    assert (np.abs(np.mean(found, axis=0) - truth) < 3.0 * standard_error).all()
    assert (np.mean(plain, axis=0) - truth > 30.0 * standard_error).all()


@pytest.mark.parametrize("error_over_noise", [10.0, 1.0, 0.0])
def test_the_covariance_is_that_of_many_draws_and_rather_too_large(error_over_noise):
    rng = np.random.default_rng(3)
    error = error_over_noise * rng.standard_normal((PIXELS, 1))
    signal = 0.5 * error + error_over_noise * rng.standard_normal((PIXELS, 1))
    s, d, b = (np.full((PIXELS, 1), v) for v in (0.5, 1.0, 0.8))
    draws = 4000
    sums = np.array([noisy_sums(rng, error, signal, s, d, b) for _ in range(draws)])[..., 0]
    seen = np.cov(sums.T)
    claimed = []
    for _ in range(100):
        of_capture = np.sqrt(d) * rng.standard_normal(error.shape)
        measured = (
            error + np.sqrt(s) * rng.standard_normal(error.shape) - of_capture,
            signal + np.sqrt(b) * rng.standard_normal(error.shape) - of_capture,
        )
        noise = noise_covariance(*measured, s, d, b + d, d)
        claimed.append([noise.error[0], noise.signal[0], noise.both[0]])
    error_variance, signal_variance, both = np.mean(claimed, axis=0)
    # four standard errors of a variance of 4000 draws; of a covariance, relative to both standard deviations
    margin = 4.0 * np.sqrt(2.0 / draws)
    assert both == pytest.approx(seen[0, 1], abs=margin * np.sqrt(seen[0, 0] * seen[1, 1]))
    for claim, variance in ((error_variance, seen[0, 0]), (signal_variance, seen[1, 1])):
        assert claim > (1.0 - margin) * variance
        # squares that noise made negative count as none: at most half of E max(x^2 - 1, 0) = 0.48 too much, times 4
        assert claim < (1.0 + margin) * variance * (1.1 if error_over_noise >= 10.0 else 2.0)


def test_draws_have_that_covariance():
    noise = NoiseCovariance(np.array([4.0, 1.0, 0.0]), np.array([9.0, 1.0, 2.0]), np.array([3.0, 0.0, 0.0]))
    draws = 40_000
    error, signal = noise.draw(draws, np.random.default_rng(4))
    # four standard errors of each moment
    margin = 4.0 * np.sqrt(2.0 / draws)
    for c, (e, s, both) in enumerate([(4.0, 9.0, 3.0), (1.0, 1.0, 0.0), (0.0, 2.0, 0.0)]):
        seen = np.cov(error[:, c], signal[:, c])
        assert seen[0, 0] == pytest.approx(e, rel=margin)
        assert seen[1, 1] == pytest.approx(s, rel=margin)
        assert seen[0, 1] == pytest.approx(both, abs=margin * np.sqrt(e * s) + 1e-300)
