"""The force of a load cell in a session: its first zero, its noise, its sign and its rate."""

from collections import deque
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from data_schemas import CaptureError, LoadCellCalibration, TactilePlan, TactileRig
from rigs import CellReading, ForceLimitError
from rigs.capture import ForceGauge, StagePress, open_tactile_rig
from rigs.capture._force_gauge import at_rest, weigh, without_jumps, without_spikes
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
    assert "its sign is reversed, or its zero drifts; calibrate the cell as mounted" in why
    assert strongest_n < 0.5


@pytest.mark.parametrize(
    ("noise_counts", "words"), [(20000, "noise of"), (8000, "too noisy for this pad"), (4000, "too noisy for this pad")]
)
def test_noise_does_not_hide_the_pad(noise_counts, words):
    """8000 counts are 38 mN: the zero followed the force to 8.5 N, and the press was accepted."""
    rig = finger(noise_counts=noise_counts)
    why, strongest_n = refused_press(rig, exact_calibration(rig))
    assert words in why
    assert strongest_n < 2.0  # with its own noise of 0.04 N and less; the limit is 5 N


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
        with pytest.raises(CaptureError, match="Its zero drifts, or the indenter still presses the pad"):
            gauge.tare()


def test_session_begins_at_the_empty_cell_of_its_calibration():
    rig = finger()
    with open_tactile_rig(rig, Path()) as opened:
        opened.lay(0.2)  # 2 N of the limit of 5 N
        gauge = ForceGauge(opened.load_cell, rig.load_cell, exact_calibration(rig))
        with pytest.raises(CaptureError, match=r"a wire of its bridge is broken, or this is another cell"):
            gauge.begin(opened.clock.monotonic_s)


def test_rate_of_the_cell_is_that_of_the_rig_file():
    rig = finger()
    slow = rig.load_cell.model_copy(update={"rate_hz": 10})
    with open_tactile_rig(rig, Path()) as opened:
        gauge = ForceGauge(opened.load_cell, slow, exact_calibration(rig))
        with pytest.raises(CaptureError, match="sends 80 readings a second, but rate_hz in the rig file is 10"):
            gauge.begin(opened.clock.monotonic_s)


NOISES = ["lost bits, 300 readings", "wandering cell, 120 counts", "humming cell, 400 counts"]


@pytest.mark.parametrize("fault", NOISES)
def test_noise_that_is_not_white_moves_no_touch_and_no_force(fault: str) -> None:
    """Each point of each press lies within the uncertainty that it states; nothing ends for a lost bit."""
    rng, touches, points, lost = np.random.default_rng(4), [], [], 0
    for seed in range(12):
        soft = {"relaxing_share": 0.0, "stiffness_n_per_mm": float(np.exp(rng.uniform(0.0, 1.5)))}
        rig = finger(seed=seed, surface_mm=float(rng.uniform(-2.0, -1.0)), practice_fault=fault, **soft)
        with open_tactile_rig(rig, Path()) as opened:
            presser = StagePress(opened, rig, exact_calibration(rig), lambda event, **what: None)
            presser.press(TactilePlan.model_validate_json(PRESS_JSON).presses[0], 1)
            presser.seen()
            presser.leave()
            found, lost = presser.measured[1], lost + presser.gauge.lost_bits
        model = rig.simulated
        late_mm = model.surface_mm - found.touch_mm
        touches.append(abs(late_mm) / found.touch_uncertainty_mm)
        for depth_mm, force_n, u_n in zip(
            found.point_depths_mm, found.point_forces_n, found.point_uncertainties_n, strict=True
        ):
            depth_mm += late_mm
            true_n = model.stiffness_n_per_mm * depth_mm + model.stiffening_n_per_mm2 * depth_mm**2
            points.append(abs(force_n - true_n) / u_n)
    assert max(touches) < 2.0  # evenly likely within 1.73
    # some hundreds of points, each with noise that its neighbours share; one lost bit is thousands of uncertainties
    assert max(points) < 6.0, max(points)
    assert np.mean(np.array(points) < 2.0) > 0.9


def averaged(forces_n: list[float]) -> list[float]:
    """Return what an amplifier shows: the running mean of four conversions."""
    past = deque(maxlen=4)
    return [float(np.mean(past)) for force_n in forces_n if past.append(force_n) is None]


@pytest.mark.parametrize("falls", ["it stays", "it relaxes", "it snaps away", "it snaps half away"])
def test_a_force_beyond_the_limit_is_never_taken_for_a_lost_bit(falls: str) -> None:
    """Whatever the pad does once the stage stands: the amplifier's filter lets no force go within one reading."""
    rng = np.random.default_rng(7)
    for _ in range(60):
        limit_n, rise_n = rng.uniform(0.5, 4.0), float(np.exp(rng.uniform(np.log(0.01), np.log(3.0))))
        rises = [float(f) for f in np.arange(0.0, limit_n + 4.0 * rise_n, rise_n)]
        shown = averaged(rises)
        first = next(k for k, f in enumerate(shown) if f > limit_n)
        end_n = rises[first]
        then = {
            "it stays": [end_n] * 8,
            "it relaxes": [end_n * (0.7 + 0.3 * float(np.exp(-k / 3.0))) for k in range(8)],
            "it snaps away": [0.0] * 8,
            "it snaps half away": [0.5 * end_n] * 8,
        }[falls]
        readings = averaged(rises[: first + 1] + then)[first - 1 :]
        assert not judged_lost(readings, limit_n), (limit_n, rise_n, readings)


def judged_lost(forces_n: list[float], limit_n: float, gap_s: float = 0.0) -> bool:
    """Whether the second of some readings is taken for a lost bit, by the others; a noise of 1 mN."""
    rig, calibration = finger(), exact_calibration(finger())
    told = [round(force_n / calibration.slope_n_per_count) for force_n in forces_n]
    with open_tactile_rig(rig, Path()) as opened:
        cell = Told(opened.load_cell)
        gauge = ForceGauge(cell, rig.load_cell, calibration)
        gauge.begin(opened.clock.monotonic_s)
        empty = round(np.mean([cell.read(0.5).counts for _ in range(64)]))
        cell.told = (CellReading(empty + count, gap_s * (k > 1)) for k, count in enumerate(told))
        gauge.reading_n()
        gauge.reading_n()
        return gauge.has_jumped(limit_n)


class Told:
    """A cell whose counts are told from some moment on."""

    def __init__(self, cell) -> None:
        self._cell, self.told = cell, None

    def read(self, deadline_s: float) -> CellReading:
        return self._cell.read(deadline_s) if self.told is None else next(self.told)


@pytest.mark.parametrize("force_n", [0.0, 0.4, 0.9])
@pytest.mark.parametrize("lost_n", [1.5, 9.8, -3.0])
def test_a_lost_bit_is_told_by_the_next_reading(force_n: float, lost_n: float) -> None:
    assert judged_lost([force_n, force_n + lost_n, *[force_n] * 4], 1.0)
    assert not judged_lost([force_n, *[force_n + lost_n] * 5], 1.0)  # it stays: a force, or a broken wire
    # readings are missing after it, or the one before was as large: a force may have come and gone
    assert not judged_lost([force_n, force_n + lost_n, *[force_n] * 4], 1.0, gap_s=0.2)
    assert not judged_lost([force_n + 0.9 * lost_n, force_n + lost_n, *[force_n] * 4], 1.0)


def test_one_lost_bit_after_another_ends_the_move() -> None:
    """A stage whose cell is mostly wrong does not go on."""
    rig = finger()
    with open_tactile_rig(rig, Path()) as opened:
        turn, cell = [0], opened.load_cell

        class Broken:
            identity = cell.identity

            def read(self, deadline_s: float) -> CellReading:
                turn[0] += 1
                reading = cell.read(deadline_s)
                lost = turn[0] > 100 and turn[0] % 5 == 0
                return reading._replace(counts=reading.counts + (2_000_000 if lost else 0))

        presser = StagePress(replace(opened, load_cell=Broken()), rig, exact_calibration(rig), lambda event, **_: None)
        with pytest.raises(ForceLimitError, match="beyond the limit"), presser.standing_by():
            presser.press(TactilePlan.model_validate_json(PRESS_JSON).presses[0], 1)


class Losing:
    """A cell that loses a bit (1.2 N) in one of 97 readings."""

    def __init__(self, cell, phase: int) -> None:
        self._cell, self._phase, self._number = cell, phase, 0

    def read(self, deadline_s: float) -> CellReading:
        self._number += 1
        reading = self._cell.read(deadline_s)
        is_lost = self._number > 60 and self._number % 97 == self._phase  # not in the first tare
        return reading._replace(counts=reading.counts ^ (1 << 18 if is_lost else 0))


def test_a_bit_that_is_lost_anywhere_at_rest_is_left_out() -> None:
    """Also in the first or last reading of a mean: the noise was 150 times too large, and a mass 4 mN off."""
    rig = finger()
    calibration = exact_calibration(rig)
    noise_n, weight_n = rig.simulated.noise_counts * abs(calibration.slope_n_per_count), 0.1 * 9.80665
    for phase in range(97):
        with open_tactile_rig(rig, Path()) as opened:
            rest = at_rest(Losing(opened.load_cell, phase), rig.load_cell, calibration, opened.clock, 10.0)
        assert 7 <= rest.jumps <= 9
        assert rest.noise_n == pytest.approx(noise_n, rel=0.15)  # 800 readings tell it to 2.5 %
        assert np.ptp(rest.means_n) < noise_n  # eight standard deviations of a mean of 67 readings
        with open_tactile_rig(rig, Path()) as opened:
            laid = weigh(Losing(opened.load_cell, phase), rig.load_cell, calibration, opened.lay, 0.1)
        # five standard deviations of a mean of 320 readings less two halves of others
        assert laid.forces_n == pytest.approx([weight_n] * 2, abs=noise_n / 3.0)


def test_jumps_are_left_out_and_real_changes_kept() -> None:
    rng = np.random.default_rng(2)
    quiet = rng.normal(84_000, 60, 32)
    spoilt = quiet.copy()
    spoilt[[3, 20]] = 168_000, 84_000 ^ (1 << 15)
    assert without_jumps(spoilt).size == 30
    assert abs(without_jumps(spoilt).mean() - quiet.mean()) < 20
    pressed = np.where(np.arange(32) < 16, quiet, quiet + 5_000)  # a force that began in the middle
    assert without_jumps(pressed).size == 32
    assert without_jumps(np.full(8, 5.0)).size == 8
    ramp = np.linspace(0.0, 1.0, 40) + rng.normal(0.0, 1e-3, 40)
    spiked = ramp.copy()
    spiked[[10, 30]] = 5.0, -4.0
    assert np.abs(without_spikes(spiked, 1e-3) - ramp).max() < 0.06
    np.testing.assert_array_equal(without_spikes(ramp, 1e-3), ramp)
    peak = np.array(averaged([0.0] * 8 + [1.0] * 3 + [0.0] * 8))  # a tap through the amplifier's filter
    np.testing.assert_array_equal(without_spikes(peak, 1e-3), peak)
