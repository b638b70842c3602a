import numpy as np
import pytest

from finray_calib.compare.interval import relative_rms_interval, skill_interval
from finray_calib.compare.relative_rms import relative_rms
from finray_calib.compare.skill import skill_score
from tests.compare.scenes import SHAPE, press


def test_do_nothing_has_an_interval_of_exactly_zero():
    no_contact, captured, mask = press(np.random.default_rng(1))
    interval = skill_interval(no_contact, captured, no_contact, mask, np.random.default_rng(2))
    assert (interval.estimate, interval.low, interval.high) == (0.0, 0.0, 0.0)


def test_the_estimate_is_the_score_itself_and_the_seed_decides_the_rest():
    no_contact, captured, mask = press(np.random.default_rng(1))
    simulated = no_contact + 0.8 * (captured - no_contact) + 1
    first = skill_interval(simulated, captured, no_contact, mask, np.random.default_rng(2))
    assert first == skill_interval(simulated, captured, no_contact, mask, np.random.default_rng(2))
    assert first.estimate == skill_score(simulated, captured, no_contact, mask).skill
    assert first.low < first.estimate < first.high
    errors = relative_rms_interval(simulated, captured, mask, np.random.default_rng(2))
    assert [e.estimate for e in errors] == relative_rms(simulated, captured, mask).tolist()
    assert all(e.low < e.estimate < e.high for e in errors)


def test_draws_without_any_signal_are_left_out():
    """Contact in one tile only: a third of the draws miss it."""
    no_contact = np.full((*SHAPE, 1), 100.0)
    captured = no_contact.copy()
    captured[5:10, 5:10] = 80
    simulated = no_contact.copy()
    simulated[5:10, 5:10] = 90
    interval = skill_interval(simulated, captured, no_contact, np.ones(SHAPE, bool), np.random.default_rng(3))
    assert interval.estimate == pytest.approx(0.75)
    assert (interval.low, interval.high) == pytest.approx((0.75, 0.75))


def test_intervals_cover_the_truth():
    """Errors drawn per 8 px block on 96 x 128 px: 48 tiles. Truths in closed form; 95 % intervals, 200 scenes."""
    rng = np.random.default_rng(4)
    mask = np.ones((96, 128), bool)
    no_contact = np.full((96, 128, 1), 100.0)
    captured = np.full((96, 128, 1), 80.0)
    skill_truth = 1 - (4 / 20) ** 2
    rms_truth = 4 / 80
    skill_inside, rms_inside = 0, 0
    for _ in range(200):
        simulated = captured + 4 * np.kron(rng.standard_normal((12, 16)), np.ones((8, 8)))[..., None]
        skill = skill_interval(simulated, captured, no_contact, mask, rng)
        skill_inside += skill.low <= skill_truth <= skill.high
        rms = relative_rms_interval(simulated, captured, mask, rng)[0]
        rms_inside += rms.low <= rms_truth <= rms.high
    # 48 tiles cover 0.94 (600 scenes). Binomial(200, 0.94) is below 174 or above 198 with probability 1.3e-4.
    assert 174 <= skill_inside <= 198
    assert 174 <= rms_inside <= 198
