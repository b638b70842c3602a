"""The posterior of the sim-to-real error: a dense joint normal, its limits, and draws."""

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from finray_calib.decide import _sim_to_real as module
from finray_calib.decide._capture_errors import NO_CAPTURES, CaptureErrors
from finray_calib.decide._sim_to_real import (
    BLIND_PROBABILITY,
    EDGE_PROBABILITY,
    EDGE_SIZE_LOG_SD,
    EDGE_SIZE_REL,
    MOVED_SD_DEG,
    PRIOR_ERROR_LENGTH_DEG,
    PRIOR_ERROR_LENGTH_LOG_SD,
    PRIOR_ERROR_LOG_SD,
    PRIOR_ERROR_REL,
    USUAL_CONTRAST,
    discrepancy_posterior,
    edges_and_glints,
)
from tests.decide.test_gaussian_process import matern_by_bessel_functions

GRID = np.linspace(0, 90, 31)
ANGLES = np.array([12.0, 30.0, 71.0])


@pytest.fixture(autouse=True)
def sizes_do_not_depend_on_the_contrast(monkeypatch):
    """Flat curves keep the formulas plain; a test of its own is on the contrast."""
    monkeypatch.setattr(module, "PROPORTIONAL_PROBABILITY", 0.0)


def captures(log_error, scale_of=None, sd=0.02, angles=ANGLES):
    size = len(log_error)
    shared = 0.3 * sd**2 * np.ones((size, size)) + 0.7 * sd**2 * np.eye(size)
    names = tuple(map(str, range(size)))
    groups = None if scale_of is None else np.array(scale_of)
    return CaptureErrors(names, np.asarray(angles[:size]), np.full(size, 1.0), np.array(log_error), shared, groups)


HILL = np.log(0.4 + np.exp(-0.5 * ((GRID - 40) / 12) ** 2))


def posterior(errors, slope=0.0, ln_curve=None):
    """Of a curve that is flat, or has this slope: moving it changes no more than its scale."""
    curve = slope * GRID if ln_curve is None else ln_curve
    return discrepancy_posterior(errors, curve[None, :], GRID)


def expected(found):
    """The shape expected at the first place, with the scale of the first rig."""
    return found.visible.mean[0]


def covariance(found):
    """Of the shape at the first place that captures see."""
    return found.visible.covariance


def shape_mean(found):
    return expected(found) - expected(found).mean()


def shape_sd(found):
    """Standard deviation of the shape less its mean over the grid."""
    response = covariance(found) - covariance(found).mean(axis=0)
    return np.sqrt(np.diag(response) - response.mean(axis=1))


def shapes(found, count, seed):
    """Draws at the first place, less their means over the grid."""
    draws = found.draws(count, np.random.default_rng(seed)).whole[:, 0]
    return draws - draws.mean(axis=1, keepdims=True)


def test_without_captures_it_is_the_prior():
    prior = posterior(NO_CAPTURES)
    assert expected(prior) == pytest.approx(np.zeros(31))
    low, median, high = prior.amplitude_quantiles_rel
    # The nodes are 17 % apart; quantiles between them are interpolated.
    assert median == pytest.approx(PRIOR_ERROR_REL, rel=0.02)
    assert [low, high] == pytest.approx(
        PRIOR_ERROR_REL * np.exp([-1.96 * PRIOR_ERROR_LOG_SD, 1.96 * PRIOR_ERROR_LOG_SD]), rel=0.08
    )
    # E a^2 of a lognormal, which its truncation at 100 % lowers by 5 %
    mean_square = PRIOR_ERROR_REL**2 * np.exp(2 * PRIOR_ERROR_LOG_SD**2)
    assert np.diag(covariance(prior)) == pytest.approx(np.full(31, mean_square), rel=0.08)


@pytest.mark.parametrize("scale_of", [[0, 0, 0], [0, 0, 1]])
def test_posterior_agrees_with_a_dense_joint_normal(scale_of, monkeypatch):
    """The scales as normal variables of huge variance, then plain conditioning; two amplitudes and two kernels."""
    nodes = [(a, kernel) for a in (0.05, 0.2) for kernel in ((35.0, 2.5), (12.0, 2.5), (35.0, 0.5), (12.0, 0.5))]
    monkeypatch.setattr(module, "_NODES_REL", np.array([0.05, 0.2]))
    monkeypatch.setattr(module, "LENGTHS_DEG", np.array([35.0, 12.0]))
    monkeypatch.setattr(module, "SMOOTHNESSES", (0.5, 2.5))
    errors = captures([0.31, 0.2, 0.28], scale_of)
    found = posterior(errors, slope=0.03)
    vague = 1e4
    noise = errors.covariance + (0.03 * 1.0) ** 2 * np.eye(3)
    log_weights, means, covariances = [], [], []
    everything = np.concatenate([ANGLES, GRID])
    for amplitude, (length, smoothness) in nodes:
        joint = amplitude**2 * matern_by_bessel_functions(everything, length, smoothness)
        groups = np.array(scale_of)
        # t on the grid has the scale of the first rig
        rig = np.concatenate([groups, np.full(31, groups[0])])
        joint += vague * np.equal.outer(rig, rig)
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
    assert expected(found) == pytest.approx(mean, abs=1e-5)
    assert np.abs(covariance(found) - (spread - np.outer(mean, mean))).max() < 1e-5


def test_draws_have_the_posterior_mean_and_spread(monkeypatch):
    """Without edges, what is drawn is what the formulas say."""
    monkeypatch.setattr(module, "EDGE_PROBABILITY", 0.0)
    found = posterior(captures([0.25, 0.05, -0.1], [0, 0, 0]))
    draws = shapes(found, 20_000, 1)
    error = shape_sd(found) / np.sqrt(20_000)
    # 5 standard errors over 31 correlated angles.
    assert (np.abs(draws.mean(axis=0) - shape_mean(found)) < 5 * error).all()
    # Mixtures of amplitudes have heavy tails: a standard deviation is good to 5 %.
    assert draws.std(axis=0) == pytest.approx(shape_sd(found), rel=0.05)


def test_edges_and_reflections_have_their_sizes_and_rates(monkeypatch):
    shapes = edges_and_glints(GRID, 20_000, GRID, np.random.default_rng(2))
    none = (np.abs(shapes).max(axis=1) == 0).mean()
    # binomial standard error 0.0035
    assert none == pytest.approx((1 - EDGE_PROBABILITY) ** 3, abs=0.015)
    mean_square = EDGE_SIZE_REL**2 * np.exp(2 * EDGE_SIZE_LOG_SD**2) * EDGE_PROBABILITY
    # an edge gives nearly b^2 everywhere, and there are two; a reflection is narrow
    assert 1.7 * mean_square < (shapes**2).mean() < 2.4 * mean_square
    monkeypatch.setattr(module, "EDGE_PROBABILITY", 0.05)
    rare = edges_and_glints(GRID, 20_000, GRID, np.random.default_rng(3))
    alone = np.abs(rare).max(axis=1)
    # an edge ends at +- b, a reflection peaks at b: both medians are near that of b, seen through a grid of 3 deg
    assert np.median(alone[alone > 0]) == pytest.approx(EDGE_SIZE_REL, rel=0.25)


def test_a_moved_curve_is_the_simulated_one_at_another_angle(monkeypatch):
    """Without shape, edges and reflections the real curve has the same hill, some degrees elsewhere."""
    monkeypatch.setattr(module, "EDGE_PROBABILITY", 0.0)
    monkeypatch.setattr(module, "PRIOR_ERROR_REL", 1e-9)
    monkeypatch.setattr(module, "_NODES_REL", np.array([1e-9]))
    grid = np.linspace(0, 90, 181)
    fine = np.log(0.4 + np.exp(-0.5 * ((grid - 40) / 12) ** 2))
    found = discrepancy_posterior(NO_CAPTURES, np.stack([fine, fine + 1.0]), grid)
    draws = found.draws(4000, np.random.default_rng(5)).whole
    real = fine - draws[:, 0]
    tops_deg = grid[real.argmax(axis=1)]
    # standard errors 0.08 and 0.06 deg, grid of 0.5 deg
    assert tops_deg.mean() == pytest.approx(40.0, abs=0.4)
    assert tops_deg.std() == pytest.approx(MOVED_SD_DEG, rel=0.06)
    # all places are moved alike, and the hill keeps its height over its foot
    assert draws[:, 1] == pytest.approx(draws[:, 0], abs=1e-6)
    assert np.ptp(real, axis=1) == pytest.approx(np.full(4000, np.ptp(fine)), rel=0.03)


@pytest.mark.parametrize("ln_curve", [None, HILL], ids=["flat", "hill"])
def test_importance_sampling_of_edges_and_movement_agrees_with_rejection(ln_curve, monkeypatch):
    """Draws of the whole prior, kept by the likelihood of two captures: nothing of the update is shared."""
    monkeypatch.setattr(module, "_SHAPES", 4000)
    monkeypatch.setattr(module, "EDGE_PROBABILITY", 0.9)
    errors = captures([0.15, -0.05], [0, 0], sd=0.05)
    found = posterior(errors, ln_curve=ln_curve)
    draws = shapes(found, 20_000, 3)
    prior = shapes(posterior(NO_CAPTURES, ln_curve=ln_curve), 60_000, 4)
    # captures at angles of the grid; the unknown scale takes up the mean, so that only their difference counts
    first, second = (int(np.abs(GRID - angle).argmin()) for angle in errors.angles_deg)
    misfit = (prior[:, first] - prior[:, second]) - (errors.log_error[0] - errors.log_error[1])
    variance = found.noise[0, 0] + found.noise[1, 1] - 2 * found.noise[0, 1]
    weights = np.exp(-0.5 * misfit**2 / variance)
    weights /= weights.sum()
    kept = 1 / (weights**2).sum()
    mean = weights @ prior
    sd = np.sqrt(weights @ (prior - mean) ** 2)
    error = sd * np.sqrt(1 / kept + 1 / 20_000 + 1 / 1000)  # 4000 shapes, a quarter of which have weight
    assert (np.abs(draws.mean(axis=0) - mean) < 5 * error).all()
    # heavy tails: standard deviations agree to 15 %
    assert draws.std(axis=0) == pytest.approx(sd, rel=0.15)


def test_sizes_of_a_curve_that_varies_less_are_less_in_proportion(monkeypatch):
    """Half of the draws of a curve of a tenth of the usual contrast have a tenth of the size, the others all of it."""
    monkeypatch.setattr(module, "EDGE_PROBABILITY", 0.0)
    monkeypatch.setattr(module, "MOVED_SD_DEG", 0.0)
    # nearly of one size but for the contrast
    monkeypatch.setattr(module, "PRIOR_ERROR_LOG_SD", 0.2)
    monkeypatch.setattr(module, "_NODES_REL", np.geomspace(0.001, 0.09, 61))
    rms = PRIOR_ERROR_REL * np.exp(0.2**2)
    wave = HILL - HILL.mean()
    low = 0.1 * USUAL_CONTRAST * wave / wave.std()
    for probability, share in ((0.0, 1.0), (1.0, 0.1), (0.5, np.sqrt(0.505))):
        monkeypatch.setattr(module, "PROPORTIONAL_PROBABILITY", probability)
        draws = posterior(NO_CAPTURES, ln_curve=low).draws(20_000, np.random.default_rng(6)).whole
        # 20 000 correlated curves: 2 %
        assert draws.std() == pytest.approx(rms * share, rel=0.03)
        usual = posterior(NO_CAPTURES, ln_curve=10 * low).draws(20_000, np.random.default_rng(6)).whole
        assert usual.std() == pytest.approx(rms, rel=0.03)
    _, median, _ = posterior(NO_CAPTURES, ln_curve=10 * low).amplitude_quantiles_rel
    assert median == pytest.approx(PRIOR_ERROR_REL, rel=0.05)


def test_one_capture_tells_the_size_of_the_error_and_its_level_near_its_angle():
    small, large = posterior(captures([0.01])), posterior(captures([0.4]))
    prior = posterior(NO_CAPTURES).amplitude_quantiles_rel[1]
    assert small.amplitude_quantiles_rel[1] < prior < 0.5 * large.amplitude_quantiles_rel[1]
    near, far = np.abs(GRID - 12).argmin(), len(GRID) - 1
    assert expected(large)[near] == pytest.approx(0.4, abs=0.03)
    assert abs(expected(large)[far]) < 0.2
    visible = large.visible.covariance
    assert visible[near, near] < 0.05 * visible[far, far]


def test_relative_captures_agree_with_draws_of_the_prior_weighted_by_their_likelihood(monkeypatch):
    """Any share is visible; the draws are made here, and nothing of the update is shared."""
    monkeypatch.setattr(module, "EDGE_PROBABILITY", 0.0)
    monkeypatch.setattr(module, "MOVED_SD_DEG", 0.0)
    monkeypatch.setattr(module, "LENGTHS_DEG", np.array([25.0]))
    monkeypatch.setattr(module, "SMOOTHNESSES", (1.5,))
    monkeypatch.setattr(module, "_SHAPES", 3000)
    # lighter tails, so that standard deviations of draws say something
    monkeypatch.setattr(module, "PRIOR_ERROR_LOG_SD", 0.5)
    rng = np.random.default_rng(8)
    count = 200_000
    share = np.where(rng.random(count) < BLIND_PROBABILITY, 0.02, rng.uniform(0.02, 1, count))
    size = PRIOR_ERROR_REL * np.exp(0.5 * rng.standard_normal(count))
    root = np.linalg.cholesky(matern_by_bessel_functions(GRID, 25.0, 1.5) + 1e-9 * np.eye(31)).T
    visible, hidden = (size[:, None] * (rng.standard_normal((count, 31)) @ root) for _ in range(2))
    visible *= np.sqrt(share)[:, None]
    whole = visible + np.sqrt(1 - share)[:, None] * hidden
    at = [4, 10, 23]
    errors = captures([0.05, -0.02, 0.01], None, angles=GRID[at])
    found = posterior(errors).draws(20_000, np.random.default_rng(9))
    ln_weights = multivariate_normal.logpdf(visible[:, at] - errors.log_error, np.zeros(3), errors.covariance)
    weights = np.exp(ln_weights - ln_weights.max())
    weights /= weights.sum()
    kept = 1 / (weights**2).sum()
    for drawn, prior in ((found.whole, whole), (found.seen, visible)):
        mean = weights @ prior
        sd = np.sqrt(weights @ (prior - mean) ** 2)
        error = sd * np.sqrt(1 / kept + 1 / 1000)  # 3000 shares, of which some have weight
        assert (np.abs(drawn[:, 0].mean(axis=0) - mean) < 5 * error).all()
        # 20 000 draws of 1000 shares that have weight
        assert drawn[:, 0].std(axis=0) == pytest.approx(sd, rel=0.08)


def test_relative_captures_tell_less_than_absolute_ones_and_more_than_none():
    """Perfect captures at every angle that show no error: the whole may still hide in what both images share."""
    angles = np.arange(0.0, 91.0, 10.0)
    zero = np.zeros(10)
    exact, relative, none = (
        np.abs(shapes(posterior(errors), 4000, 7)).mean()
        for errors in (
            captures(zero, [0] * 10, sd=0.002, angles=angles),
            captures(zero, None, sd=0.002, angles=angles),
            NO_CAPTURES,
        )
    )
    assert 3 * exact < 0.7 * none < relative < none


def test_a_common_scale_of_one_rig_changes_nothing():
    plain = posterior(captures([0.25, 0.05, -0.1], [0, 0, 0]))
    shifted = posterior(captures([7.25, 7.05, 6.9], [0, 0, 0]))
    assert shape_mean(shifted) == pytest.approx(shape_mean(plain), abs=1e-9)
    assert shifted.amplitude_quantiles_rel == pytest.approx(plain.amplitude_quantiles_rel)
    # a rig with a single capture says nothing of the shape
    lone = posterior(captures([0.4], [0]))
    assert shape_mean(lone) == pytest.approx(np.zeros(31), abs=1e-12)
    assert lone.amplitude_quantiles_rel == pytest.approx(posterior(NO_CAPTURES).amplitude_quantiles_rel)


def test_captures_at_several_angles_correct_the_shape_and_shrink_its_uncertainty():
    tilt = 0.06 * (GRID / 45 - 1)
    angles = np.array([5.0, 30.0, 60.0, 85.0])
    found = posterior(captures(np.interp(angles, GRID, tilt), [0] * 4, sd=0.005, angles=angles))
    between = (GRID >= 5) & (GRID <= 85)
    assert shape_mean(found)[between] == pytest.approx(tilt[between], abs=0.01)
    # beyond the last captures the error may have a kink, so the tilt is not continued in full
    assert (np.abs(shape_mean(found) - tilt) < 2 * shape_sd(found)).all()
    ratio = shape_sd(found) / shape_sd(posterior(NO_CAPTURES))
    # this error of 3.5 % is as large as the prior's; half-way between captures a short one may hide
    assert ratio.max() < 1.0
    assert np.interp(angles, GRID, ratio).max() < 0.4


def test_an_uncertain_angle_counts_by_the_slope():
    errors = captures([0.2])
    flat, steep = posterior(errors, 0.0), posterior(errors, 0.1)
    assert steep.noise[0, 0] == pytest.approx(flat.noise[0, 0] + 0.1**2)
    near = np.abs(GRID - 12).argmin()
    assert 0 < expected(steep)[near] < expected(flat)[near]
    assert covariance(steep)[near, near] > covariance(flat)[near, near]
