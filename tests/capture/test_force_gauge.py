"""The force of a load cell in a session: its first zero, its noise, its sign and its rate."""

from collections import deque
from dataclasses import replace
from pathlib import Path

import pytest

from data_schemas import CaptureError, LoadCellCalibration, TactilePlan, TactileRig
from rigs.capture import ForceGauge, StagePress, open_tactile_rig
from tests.capture.test_stage_press import PRESS_JSON, exact_calibration, simulated, true_force_n


class Spied:
    """A simulated cell that remembers the strongest force that the finger felt."""

    def __init__(self, opened) -> None:
        self._cell, self._state, self.strongest_n = opened.load_cell, opened.stage.state, 0.0

    def identity(self):
        return self._cell.identity()

    def read(self, deadline_s: float):
        reading = self._cell.read(deadline_s)
        self.strongest_n = max(self.strongest_n, true_force_n(self._state.indentation_mm))
        return reading


def refused_press(rig: TactileRig, calibration: LoadCellCalibration) -> tuple[str, float]:
    """Press once as a session does; return why it ended, and the strongest force that the finger felt (N)."""
    with open_tactile_rig(rig, Path()) as opened:
        cell = Spied(opened)
        presser = StagePress(replace(opened, load_cell=cell), rig, calibration, lambda event, **what: None)
        press = TactilePlan.model_validate_json(PRESS_JSON).presses[0]
        with pytest.raises(CaptureError) as ended, presser.standing_by():
            presser.press(press, 1)
    return str(ended.value), cell.strongest_n


def finger(**other: object) -> TactileRig:
    rig = simulated()
    rig["simulated"] |= other
    return TactileRig.model_validate(rig)


def test_cell_of_the_other_sign_is_refused_at_the_touch():
    """It used to drive on to 11.7 N, to the end of its travel, at a limit of 5 N."""
    right = exact_calibration(finger())
    wrong = right.model_copy(
        update={"slope_n_per_count": -right.slope_n_per_count, "counts": tuple(-c for c in right.counts)}
    )
    why, strongest_n = refused_press(finger(), wrong)
    assert "so its sign is reversed; calibrate it as it is mounted" in why
    assert strongest_n < 0.5


@pytest.mark.parametrize(
    ("noise_counts", "words"), [(20000, "noise of"), (8000, "too noisy for this pad"), (4000, "too noisy for this pad")]
)
def test_noise_does_not_hide_the_pad(noise_counts, words):
    """8000 counts are 38 mN: the zero followed the force to 8.5 N, and the press was accepted."""
    rig = finger(noise_counts=noise_counts)
    why, strongest_n = refused_press(rig, exact_calibration(rig))
    assert words in why
    assert strongest_n < 1.5


class RunningMean:
    """A cell whose amplifier gives the running mean of four conversions, as an HX711 does."""

    def __init__(self, cell) -> None:
        self._cell, self._conversions = cell, deque(maxlen=4)

    def identity(self):
        return self._cell.identity()

    def read(self, deadline_s: float):
        reading = self._cell.read(deadline_s)
        self._conversions.append(reading.counts)
        return reading._replace(counts=round(sum(self._conversions) / len(self._conversions)))


def test_noise_that_neighbours_share_is_no_touch():
    """Three of these seeds failed: its mean scatters by twice what it does where nothing is shared."""
    pressed = 0
    for seed in range(30):
        rig = finger(seed=seed, noise_counts=80.0, stiffness_n_per_mm=4.0, relaxing_share=0.0, surface_mm=-1.5)
        with open_tactile_rig(rig, Path()) as opened:
            cell = RunningMean(opened.load_cell)
            presser = StagePress(replace(opened, load_cell=cell), rig, exact_calibration(rig), lambda e, **what: None)
            press = TactilePlan.model_validate_json(PRESS_JSON).presses[0]
            for contact in range(1, 21):
                presser.touches.clear()
                presser.press(press, contact)
                presser.seen()
                touched = presser.measured[contact]
                assert abs(touched.touch_mm + 1.5) < 2.0 * touched.touch_uncertainty_mm
                presser.leave()
                pressed += 1
    assert pressed == 600


def test_force_limit_counts_from_the_first_zero_too():
    """A zero that has followed the force does not lift the limit."""
    rig = finger()
    with open_tactile_rig(rig, Path()) as opened:
        gauge = ForceGauge(opened.load_cell, rig.load_cell, exact_calibration(rig))
        gauge.begin(opened.clock.monotonic_s)
        opened.lay(0.1)
        for _ in range(20):
            force = gauge.mean()
            gauge.follow(force._replace(noise_n=1.0))
        assert abs(gauge.reading_n()) < 0.01
        assert gauge.strongest_n() == pytest.approx(0.98, abs=0.01)
        with pytest.raises(CaptureError, match="its zero drifts, or the pad is still pressed"):
            gauge.tare()


def test_session_begins_at_the_empty_cell_of_its_calibration():
    rig = finger()
    with open_tactile_rig(rig, Path()) as opened:
        opened.lay(0.2)  # 2 N of the limit of 5 N
        gauge = ForceGauge(opened.load_cell, rig.load_cell, exact_calibration(rig))
        with pytest.raises(CaptureError, match=r"a wire of its bridge is broken, or it is another cell"):
            gauge.begin(opened.clock.monotonic_s)


def test_rate_of_the_cell_is_that_of_the_rig_file():
    rig = finger()
    slow = rig.load_cell.model_copy(update={"rate_hz": 10})
    with open_tactile_rig(rig, Path()) as opened:
        gauge = ForceGauge(opened.load_cell, slow, exact_calibration(rig))
        with pytest.raises(CaptureError, match="sends 80 readings a second, but rate_hz of the rig file is 10"):
            gauge.begin(opened.clock.monotonic_s)
