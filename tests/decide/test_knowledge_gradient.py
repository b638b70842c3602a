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


def test_capture_gain_agrees_with_deciding_anew():
    """The capture is drawn, and decided on anew: the expected loss falls by what was told, to first order."""
    rng = np.random.default_rng(4)
    values = sweep(PEAK, rng, 0.003, 4)
    angles = np.array([10.0, 60.0])
    captures = _captures(angles, np.zeros(2), absolute=True)
    now = decide_angle(SWEEP_DEG, values, np.random.default_rng(5), captures=captures, draws=4000)
    proposal = propose_capture(now, captures)
    assert proposal is not None
    # what the error may be at the two captures and the proposed angle, from the posterior of these captures
    at = np.abs(now.grid_deg - proposal.angle_deg).argmin()
    first = int(np.abs(now.grid_deg - angles[0]).argmin())
    drawn = now.discrepancy.draws(120, rng)[:, 0]
    found = []
    for shape in drawn:
        seen = np.append(np.zeros(2), shape[at] - shape[first] + 0.01 * rng.standard_normal())
        more = _captures(np.append(angles, proposal.angle_deg), seen, absolute=True)
        anew = decide_angle(SWEEP_DEG, values, np.random.default_rng(5), captures=more, draws=1000)
        found.append(now.risk.expected_regret_rel - anew.risk.expected_regret_rel)
    error = np.std(found) / np.sqrt(len(found))
    # the formula does not count that the size of the error is learnt too
    assert np.mean(found) > proposal.gain_rel * decision_top(now) - SURE * error
    assert np.mean(found) < 4 * proposal.gain_rel * decision_top(now) + SURE * error


def decision_top(decision):
    return decision.value_mean[decision.choices].max()


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
