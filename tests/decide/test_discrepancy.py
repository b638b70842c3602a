"""The posterior of the sim-to-real error: a dense joint normal, its limits, and draws."""

import numpy as np
import pytest
from scipy.special import gamma, kv
from scipy.stats import multivariate_normal

from finray_calib.decide import _gaussian_process as module
from finray_calib.decide._capture_errors import NO_CAPTURES, CaptureErrors
from finray_calib.decide._gaussian_process import (
    PRIOR_ERROR_LENGTH_DEG,
    PRIOR_ERROR_LENGTH_LOG_SD,
    PRIOR_ERROR_LOG_SD,
    PRIOR_ERROR_REL,
    discrepancy_posterior,
    matern_correlation,
)

GRID = np.linspace(0, 90, 31)
ANGLES = np.array([12.0, 30.0, 71.0])


def captures(log_error, scale_of=None, sd=0.02, angles=ANGLES):
    size = len(log_error)
    shared = 0.3 * sd**2 * np.ones((size, size)) + 0.7 * sd**2 * np.eye(size)
    names = tuple(map(str, range(size)))
    groups = None if scale_of is None else np.array(scale_of)
    return CaptureErrors(names, np.asarray(angles[:size]), np.full(size, 1.0), np.array(log_error), shared, groups)


def matern_by_bessel_functions(angles, length, smoothness):
    """The Matern correlation of any smoothness, from its definition."""
    q = np.maximum(np.sqrt(2 * smoothness) * np.abs(np.subtract.outer(angles, angles)) / length, 1e-10)
    return 2 ** (1 - smoothness) / gamma(smoothness) * q**smoothness * kv(smoothness, q)


def test_correlations_agree_with_bessel_functions():
    for smoothness in (0.5, 1.5, 2.5):
        expected = matern_by_bessel_functions(GRID, 20.0, smoothness)
        assert matern_correlation(GRID, GRID, 20.0, smoothness) == pytest.approx(expected, abs=1e-9)
    with pytest.raises(ValueError, match=r"smoothness nu = 2 has no closed form here; must be 0\.5, 1\.5 or 2\.5"):
        matern_correlation(GRID, GRID, 20.0, 2.0)


def posterior(errors, slope=0.0):
    return discrepancy_posterior(errors, np.full(len(errors.names), slope), GRID)


def test_without_captures_it_is_the_prior():
    prior = posterior(NO_CAPTURES)
    assert prior.mean == pytest.approx(np.zeros(31))
    low, median, high = prior.amplitude_quantiles_rel
    # The nodes are 17 % apart; quantiles between them are interpolated.
    assert median == pytest.approx(PRIOR_ERROR_REL, rel=0.02)
    assert [low, high] == pytest.approx(PRIOR_ERROR_REL * np.exp([-1.96 * 0.7, 1.96 * 0.7]), rel=0.05)
    # E a^2 of a lognormal; its truncation at 200 % matters little
    mean_square = PRIOR_ERROR_REL**2 * np.exp(2 * PRIOR_ERROR_LOG_SD**2)
    assert np.diag(prior.covariance) == pytest.approx(np.full(31, mean_square), rel=0.02)


@pytest.mark.parametrize("scale_of", [None, [0, 0, 0], [0, 0, 1]])
def test_posterior_agrees_with_a_dense_joint_normal(scale_of, monkeypatch):
    """The scales as normal variables of huge variance, then plain conditioning; two amplitudes and two kernels."""
    nodes = [(a, kernel) for a in (0.05, 0.2) for kernel in ((35.0, 2.5), (12.0, 2.5), (35.0, 0.5), (12.0, 0.5))]
    monkeypatch.setattr(module, "_NODES_REL", np.array([0.05, 0.2]))
    monkeypatch.setattr(module, "_ERROR_LENGTHS_DEG", np.array([35.0, 12.0]))
    monkeypatch.setattr(module, "_SMOOTHNESSES", (0.5, 2.5))
    errors = captures([0.31, 0.2, 0.28], scale_of)
    found = posterior(errors, slope=0.03)
    vague = 1e4
    noise = errors.covariance + (0.03 * 1.0) ** 2 * np.eye(3)
    log_weights, means, covariances = [], [], []
    everything = np.concatenate([ANGLES, GRID])
    for amplitude, (length, smoothness) in nodes:
        joint = amplitude**2 * matern_by_bessel_functions(everything, length, smoothness)
        groups = np.array([-1] * 3 if scale_of is None else scale_of)
        # t on the grid has the scale of the first rig
        rig = np.concatenate([groups, np.full(31, groups[0])])
        joint += vague * np.equal.outer(rig, rig) * (rig[:, None] >= 0)
        whole = joint[:3, :3] + noise
        gain = np.linalg.solve(whole, joint[:3, 3:]).T
        log_weights.append(multivariate_normal.logpdf(errors.log_error, np.zeros(3), whole))
        log_weights[-1] -= 0.5 * (np.log(amplitude / PRIOR_ERROR_REL) / PRIOR_ERROR_LOG_SD) ** 2
        log_weights[-1] -= 0.5 * (np.log(length / PRIOR_ERROR_LENGTH_DEG) / PRIOR_ERROR_LENGTH_LOG_SD) ** 2
        means.append(gain @ errors.log_error)
        covariances.append(joint[3:, 3:] - gain @ joint[:3, 3:])
    weights = np.exp(np.array(log_weights) - max(log_weights))
    weights /= weights.sum()
    mean = weights @ np.array(means)
    spread = sum(w * (c + np.outer(m, m)) for w, c, m in zip(weights, covariances, means, strict=True))
    # The flat prior is approached as noise / vague, rounding grows as vague: both below 1e-6.
    assert found.mean == pytest.approx(mean, abs=1e-5)
    assert np.abs(found.covariance - (spread - np.outer(mean, mean))).max() < 1e-5


def test_draws_have_the_posterior_mean_and_spread():
    found = posterior(captures([0.25, 0.05, -0.1], [0, 0, 0]))
    draws = found.shape_draws(20_000, np.random.default_rng(1))
    assert draws.mean(axis=1) == pytest.approx(np.zeros(20_000), abs=1e-12)
    error = found.shape_sd / np.sqrt(20_000)
    # 5 standard errors over 31 correlated angles.
    assert (np.abs(draws.mean(axis=0) - found.shape_mean) < 5 * error).all()
    # Mixtures of amplitudes have heavy tails: a standard deviation is good to 3 %.
    assert draws.std(axis=0) == pytest.approx(found.shape_sd, rel=0.03)


def test_one_capture_tells_the_size_of_the_error_and_its_level_near_its_angle():
    small, large = posterior(captures([0.01])), posterior(captures([0.4]))
    prior = posterior(NO_CAPTURES).amplitude_quantiles_rel[1]
    assert small.amplitude_quantiles_rel[1] < prior < large.amplitude_quantiles_rel[1]
    near, far = np.abs(GRID - 12).argmin(), len(GRID) - 1
    assert large.mean[near] == pytest.approx(0.4, abs=0.03)
    assert abs(large.mean[far]) < 0.2
    assert large.covariance[near, near] < 0.05 * large.covariance[far, far]


def test_a_common_scale_of_one_rig_changes_nothing():
    plain = posterior(captures([0.25, 0.05, -0.1], [0, 0, 0]))
    shifted = posterior(captures([7.25, 7.05, 6.9], [0, 0, 0]))
    assert shifted.shape_mean == pytest.approx(plain.shape_mean, abs=1e-9)
    assert shifted.amplitude_quantiles_rel == pytest.approx(plain.amplitude_quantiles_rel)
    # a rig with a single capture says nothing of the shape
    lone = posterior(captures([0.4], [0]))
    assert lone.shape_mean == pytest.approx(np.zeros(31), abs=1e-12)
    assert lone.amplitude_quantiles_rel == pytest.approx(posterior(NO_CAPTURES).amplitude_quantiles_rel)


def test_captures_at_several_angles_correct_the_shape_and_shrink_its_uncertainty():
    tilt = 0.3 * (GRID / 45 - 1)
    angles = np.array([5.0, 30.0, 60.0, 85.0])
    found = posterior(captures(np.interp(angles, GRID, tilt), [0] * 4, sd=0.005, angles=angles))
    between = (GRID >= 5) & (GRID <= 85)
    assert found.shape_mean[between] == pytest.approx(tilt[between], abs=0.03)
    # beyond the last captures the error may have a kink, so the tilt is not continued in full
    assert (np.abs(found.shape_mean - tilt) < 2 * found.shape_sd).all()
    ratio = found.shape_sd / posterior(NO_CAPTURES).shape_sd
    # this error of 30 % is larger than the prior's 10 %, and half-way between captures a short one may hide
    assert ratio.max() < 1.0
    assert np.interp(angles, GRID, ratio).max() < 0.4


def test_an_uncertain_angle_counts_by_the_slope():
    errors = captures([0.2])
    flat, steep = posterior(errors, 0.0), posterior(errors, 0.1)
    assert steep.noise[0, 0] == pytest.approx(flat.noise[0, 0] + 0.1**2)
    near = np.abs(GRID - 12).argmin()
    assert 0 < steep.mean[near] < flat.mean[near]
    assert steep.covariance[near, near] > flat.covariance[near, near]
