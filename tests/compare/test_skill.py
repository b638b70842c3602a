import math

import numpy as np
import pytest

from data_schemas import CompareError
from finray_calib.compare import disc
from finray_calib.compare._comparison import channel_weights
from tests.compare.plain_skill import skill_score
from tests.compare.scenes import CENTER_PX, SHAPE, press


@pytest.fixture
def scene():
    return press(np.random.default_rng(0))


def test_do_nothing_is_exactly_zero_and_the_capture_itself_exactly_one(scene):
    no_contact, captured, mask = scene
    assert skill_score(no_contact, captured, no_contact, mask).skill == 0.0
    assert skill_score(captured, captured, no_contact, mask).skill == 1.0


@pytest.mark.parametrize("share", [-0.5, 0.3, 0.9, 1.2])
def test_a_share_of_the_contact_signal_gives_the_closed_form(scene, share):
    no_contact, captured, mask = scene
    simulated = no_contact + share * (captured - no_contact)
    score = skill_score(simulated, captured, no_contact, mask)
    # The residual is (1 - share) of the signal in every pixel and channel, whatever the weights.
    assert score.skill == pytest.approx(1 - (1 - share) ** 2, abs=1e-12)
    assert score.per_channel_skill == pytest.approx([1 - (1 - share) ** 2] * 3, abs=1e-12)


def test_weights_pool_the_channels_as_written(scene):
    no_contact, captured, mask = scene
    simulated = captured.copy()
    simulated[..., 2] = no_contact[..., 2]
    signal = ((no_contact - captured)[mask] ** 2).sum(axis=0)
    plain = skill_score(simulated, captured, no_contact, mask, np.ones(3))
    assert plain.skill == pytest.approx(1 - signal[2] / signal.sum(), rel=1e-12)
    default = skill_score(simulated, captured, no_contact, mask)
    weight = 1 / no_contact[mask].mean(axis=0) ** 2
    assert default.weights == pytest.approx(weight, rel=1e-12)
    assert default.skill == pytest.approx(1 - weight[2] * signal[2] / (weight @ signal), rel=1e-12)
    # The dim channel has 1 % of the plain energy but about a third of the relative one.
    assert plain.skill > 0.98
    assert default.skill < 0.7
    assert default.per_channel_skill == pytest.approx([1, 1, 0], abs=1e-12)


def test_the_default_score_does_not_depend_on_the_unit(scene):
    no_contact, captured, mask = scene
    simulated = no_contact + 0.7 * (captured - no_contact) + 1.0
    one = skill_score(simulated, captured, no_contact, mask).skill
    other = skill_score(simulated / 255, captured / 255, no_contact / 255, mask).skill
    assert one == pytest.approx(other, rel=1e-12)


def test_missing_pixels_are_left_out_and_counted(scene):
    no_contact, captured, mask = scene
    simulated = no_contact + 0.5 * (captured - no_contact)
    hole = disc(SHAPE, CENTER_PX, 5.0)
    simulated[hole] = np.nan
    score = skill_score(simulated, captured, no_contact, mask)
    assert score.pixels_left_out == hole.sum()
    assert score.pixels_used == (mask & ~hole).sum()
    expected = skill_score(np.nan_to_num(simulated), captured, no_contact, mask & ~hole)
    assert score.skill == expected.skill


def test_a_channel_without_signal_has_no_score_of_its_own(scene):
    no_contact, captured, mask = scene
    captured[..., 1] = no_contact[..., 1]
    score = skill_score(no_contact, captured, no_contact, mask)
    assert math.isnan(score.per_channel_skill[1])
    assert score.skill == 0.0


def test_a_capture_without_contact_is_refused(scene):
    no_contact, _, mask = scene
    with pytest.raises(CompareError, match="no contact signal to explain"):
        skill_score(no_contact, no_contact, no_contact, mask)


def test_weights_of_a_channel_without_light_are_refused(scene):
    no_contact, _, mask = scene
    no_contact[..., 2] = -0.5
    with pytest.raises(CompareError, match=r"Channel 2 of the no-contact image has a mean of -0.5"):
        channel_weights(no_contact, mask)
