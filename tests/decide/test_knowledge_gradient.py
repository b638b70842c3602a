"""The knowledge gradient against simulated observations."""

import numpy as np
import pytest
from scipy.stats import norm

from finray_calib.decide import decide_angle
from finray_calib.decide._capture_errors import NO_CAPTURES, CaptureErrors
from finray_calib.decide._gaussian_process import CurvePrior, curve_posterior, observations
from finray_calib.decide._next_observation import (
    ASSUMED_CAPTURE_SD_REL,
    expected_maximum_gain,
    knowledge_gradient,
    propose_capture,
    propose_render,
)
from finray_calib.decide._sim_to_real import discrepancy_posterior
from tests.decide.curves import FINE_DEG, SWEEP_DEG, sweep

PEAK = 0.5 + np.exp(-0.5 * ((FINE_DEG - 33) / 20) ** 2)
DRAWS = 4000
# A mean of simulated gains leaves this many standard errors in one of 16 000 runs; seeds are fixed.
SURE = 4.0


def test_two_lines_have_a_closed_form():
    """E max(0, a + b Z) = a Phi(a / b) + b phi(a / b)."""
    for a, b in [(-0.3, 1.2), (0.5, -2.0), (-3.0, 0.4)]:
        expected = a * norm.cdf(a / abs(b)) + abs(b) * norm.pdf(a / abs(b))
        gain = expected_maximum_gain(np.array([0.0, a]), np.array([0.0, b]))
        assert gain == pytest.approx(expected - max(a, 0), rel=1e-12)


@pytest.mark.parametrize("lines", [1, 2, 7, 60])
def test_gain_agrees_with_quadrature(lines):
    rng = np.random.default_rng(lines)
    a, b = rng.standard_normal(lines), rng.standard_normal(lines)
    z = np.linspace(-9, 9, 90_001)
    expected = np.trapezoid((a[:, None] + b[:, None] * z).max(axis=0) * norm.pdf(z), z) - a.max()
    # The trapezoid rule misses kinks by less than step^2 of the slope's jump.
    assert expected_maximum_gain(a, b) == pytest.approx(expected, abs=1e-7)


def test_lines_that_never_win_and_equal_slopes_do_not_count():
    plain = expected_maximum_gain(np.array([0.0, 0.0]), np.array([-1.0, 1.0]))
    assert plain == pytest.approx(2 * norm.pdf(0))
    more = expected_maximum_gain(np.array([0.0, -5.0, -0.1, 0.0, -1.0]), np.array([-1.0, 0.0, 1.0, 1.0, 1.0]))
    assert more == pytest.approx(plain)
    assert expected_maximum_gain(np.array([1.0, 2.0]), np.zeros(2)) == 0.0


def test_render_gain_agrees_with_simulated_renders():
    """Every simulated render is put into the regression anew; nothing of the update is shared."""
    rng = np.random.default_rng(3)
    grid = np.arange(0, 91.0, 5)
    one = CurvePrior(30.0, 0.7, 0.5, 1.0, np.array([0.5]), (2.5,), np.array([30.0]))

    def condition(angles, values, noise):
        seen = observations(angles, values, np.diag(noise), np.ones((len(angles), 1)))
        return curve_posterior(one, seen, grid)

    noise = np.full(len(SWEEP_DEG), 0.05**2)
    means = PEAK[::10] + 0.05 * rng.standard_normal(len(SWEEP_DEG))
    now = condition(SWEEP_DEG, means, noise)
    gains = knowledge_gradient(now.mean[0], now.covariance, np.diag(now.covariance), np.full(len(grid), 0.05**2))
    for j in (int(gains.argmax()), 2):
        angles = np.append(SWEEP_DEG, grid[j])
        sd = np.sqrt(now.covariance[j, j] + 0.05**2)
        found = [
            condition(angles, np.append(means, y), np.append(noise, 0.05**2)).mean.max()
            for y in now.mean[0, j] + sd * rng.standard_normal(DRAWS // 4)
        ]
        error = np.std(found) / np.sqrt(len(found))
        assert np.mean(found) - now.mean.max() == pytest.approx(gains[j], abs=SURE * error)


@pytest.mark.parametrize("absolute", [False, True])
def test_capture_gain_agrees_with_simulated_captures(absolute, monkeypatch):
    """One amplitude of the sim-to-real error, so that a capture's effect is linear and the belief stays normal."""
    monkeypatch.setattr("finray_calib.decide._sim_to_real._NODES_REL", np.array([0.1]))
    monkeypatch.setattr("finray_calib.decide._sim_to_real._LENGTHS_DEG", np.array([35.0]))
    monkeypatch.setattr("finray_calib.decide._sim_to_real._SMOOTHNESSES", (2.5,))
    rng = np.random.default_rng(4)
    values = sweep(PEAK, rng, 0.003, 4)
    angles, log_error = np.array([20.0, 60.0]), np.array([0.05, -0.08])
    captures = _captures(angles, log_error, absolute)
    decision = decide_angle(SWEEP_DEG, values, rng, captures=captures)
    proposal = propose_capture(decision, captures)
    assert proposal is not None
    j = int(proposal.angle_deg)
    grid_deg = decision.simulated.posterior.grid_deg
    slope = np.interp(np.append(angles, proposal.angle_deg), grid_deg, decision.simulated.log_slope_per_deg)
    sd = np.sqrt(decision.discrepancy.visible.covariance[j, j] + proposal.noise_rel**2)
    found = []
    for e in decision.discrepancy.mean[j] + sd * rng.standard_normal(DRAWS // 4):
        more = _captures(np.append(angles, proposal.angle_deg), np.append(log_error, e), absolute)
        t = discrepancy_posterior(more, slope, grid_deg).shape_mean
        # the same first-order change as the formula's: what is tested is the update, not the exponential
        found.append((decision.mean_rel * (1 - (t - decision.discrepancy.shape_mean))).max())
    gain = np.mean(found) / decision.mean_rel.max() - 1
    assert gain == pytest.approx(proposal.gain_rel, abs=SURE * np.std(found) / np.sqrt(len(found)))


def _captures(angles_deg, log_error, absolute):
    size = len(angles_deg)
    names = tuple(f"{angle:g} deg" for angle in angles_deg)
    scale_of = np.zeros(size, dtype=np.int64) if absolute else None
    return CaptureErrors(names, angles_deg, np.full(size, 0.5), log_error, 0.01**2 * np.eye(size), scale_of)


def test_proposals_go_where_the_peak_is_unsure_and_end_when_nothing_is():
    noisy = decide_angle(SWEEP_DEG, sweep(PEAK, np.random.default_rng(5), 0.1, 3), np.random.default_rng(1))
    render = propose_render(noisy)
    assert render is not None
    assert render.angle_deg == pytest.approx(33, abs=20)
    assert render.noise_rel == pytest.approx(noisy.simulated.noise_rel / np.sqrt(3))
    clear = decide_angle(SWEEP_DEG, sweep(PEAK, np.random.default_rng(6), 1e-4, 3), np.random.default_rng(1))
    assert propose_render(clear) is None
    unseen = propose_capture(clear, NO_CAPTURES)
    assert unseen is not None
    assert unseen.noise_rel >= ASSUMED_CAPTURE_SD_REL
    everywhere = np.arange(0, 91.0, 5)
    exact = CaptureErrors(
        tuple(map(str, everywhere)), everywhere, np.zeros(19), np.zeros(19), 1e-6 * np.eye(19), np.zeros(19, dtype=int)
    )
    seen = decide_angle(
        SWEEP_DEG, sweep(PEAK, np.random.default_rng(6), 1e-4, 3), np.random.default_rng(1), 0.02, exact
    )
    assert propose_capture(seen, exact) is None


def test_only_allowed_angles_are_chosen_among_but_any_may_be_observed():
    values = sweep(PEAK, np.random.default_rng(7), 0.05, 3)
    allowed = SWEEP_DEG >= 60
    decision = decide_angle(SWEEP_DEG, values, np.random.default_rng(1), allowed=allowed)
    free = decide_angle(SWEEP_DEG, values, np.random.default_rng(1))
    assert decision.best_deg >= 60 > free.best_deg
    render = propose_render(decision)
    assert render is None or render.gain_rel >= 0
