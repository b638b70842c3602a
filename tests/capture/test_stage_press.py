"""Sessions in which a stage presses: on the simulated finger by the command line, and on boards in real time."""

import json
import os
import re
import signal
import subprocess
import sys
import threading
import time
from collections import deque
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from data_schemas import (
    CaptureError,
    LoadCellCalibration,
    LoadCellSettings,
    TactileCapture,
    TactilePlan,
    TactileRig,
    TactileSession,
    UnsafeError,
    provenance,
)
from data_schemas.storage import read_record, read_toml, write_record
from rigs import CellReading, ForceLimitError, RawFrame, SystemClock, write_tactile_rig
from rigs.capture import SessionRequest, StagePress, capture_tactile_session, open_tactile_rig, read_journal
from rigs.simulated import FingerState, SimulatedLoadCell, SimulatedStage
from rigs.simulated._finger import BRAKING_MM_PER_S2, DEAF_S
from tests.capture.drivers.press_bench import N_PER_COUNT, PressBench, press_bench
from tests.command_line.running import finray

STIFFNESS_N_PER_MM, STIFFENING_N_PER_MM2 = 1.5, 0.8


def true_force_n(depth_mm: float) -> float:
    return STIFFNESS_N_PER_MM * depth_mm + STIFFENING_N_PER_MM2 * depth_mm**2


@pytest.fixture
def practice(tmp_path: Path) -> Path:
    """A rig to practise on whose cell is calibrated, and its plan."""
    assert finray(f"rig init --preset simulated-finger --out {tmp_path}/rig.toml").status == 0
    done = finray(f"rig calibrate-cell {tmp_path}/rig.toml --masses-g 20,50,100,200 --gravity 9.80665")
    assert done.status == 0, done.err
    return tmp_path


def changed(folder: Path, file: str, *edits: tuple[str, str]) -> None:
    path = folder / file
    text = path.read_text(encoding="utf-8")
    for old, new in edits:
        assert old in text
        text = text.replace(old, new)
    path.write_text(text, encoding="utf-8")


def faulty(folder: Path, fault: str) -> None:
    changed(folder, "rig.toml", ("# practice_fault = ...", f'practice_fault = "{fault}"  #'))


def session(folder: Path):
    return finray(f"capture {folder}/rig-presses.toml --rig {folder}/rig.toml --out {folder}/s")


def events(folder: Path, name: str) -> list[dict[str, object]]:
    return [line for line in read_journal(folder / "s") if line["event"] == name]


def only_the_stop_is_left(monkeypatch) -> None:
    """No step asks for room: a pad may become stiffer at once."""
    monkeypatch.setattr(StagePress, "_with_room", lambda presser, touched, step_mm, limit_n: step_mm)


FILTER, LATE = 4, 2


def test_homing_finds_the_place_again_after_lost_steps(practice):
    faulty(practice, "lost steps, 10 %")
    state = FingerState(read_toml(practice / "rig.toml", TactileRig))
    stage, axis = SimulatedStage(state), state.stage.press_axis
    depths = []
    for _ in range(2):
        stage.home(5.0, lambda: None)
        deep_mm = state.rig.simulated.surface_mm + state.stage.into_pad * 2.0
        stage.move(axis, deep_mm, 5.0, lambda: None)
        depths.append(state.indentation_mm)
    assert 0.0 < depths[0] < 2.0
    assert depths[1] == depths[0]


def test_a_last_step_that_leads_beyond_the_limit_ends_the_press(practice, monkeypatch):
    """An HX711 shows the mean of four conversions, and late: the last step shows its force only after it ended."""
    kept: dict[int, deque[CellReading]] = {}
    ideal = SimulatedLoadCell.read

    def read(cell, deadline_s):
        readings = kept.setdefault(id(cell), deque(maxlen=FILTER + LATE))
        readings.append(ideal(cell, deadline_s))
        shown = list(readings)[:FILTER]
        return CellReading(round(sum(one.counts for one in shown) / len(shown)), shown[-1].at_s)

    monkeypatch.setattr(SimulatedLoadCell, "read", read)
    only_the_stop_is_left(monkeypatch)
    changed(
        practice, "rig-presses.toml", ("until_force_n = 1.0 ", "# "), ("force_limit_n = 2.0", "force_limit_n = 4.0")
    )
    outcome = session(practice)
    assert outcome.status == 2
    (stopped,) = events(practice, "stage stopped")
    assert re.search(r"stopped at 4\.0\d N, beyond the limit of 4 N", stopped["why"])
    assert [press["contact"] for press in events(practice, "press")] == [1]


def test_session_runs_by_itself(practice):
    outcome = session(practice)
    assert outcome.status == 0, outcome.err
    assert "this takes about" in outcome.out
    for number in (1, 2):
        stored = read_record(practice / "s" / f"press-00{number}.json", TactileCapture)
        assert stored.force_n == pytest.approx(true_force_n(stored.indenter.depth_mm), abs=0.03)
        assert stored.force_uncertainty_n < 0.02
        assert stored.press.depth_mm == stored.indenter.depth_mm
        assert stored.load_cell.traceability.startswith("not traceable")
        assert stored.press.zero_shift_n == pytest.approx(0.0, abs=0.005)
        assert len(stored.press.point_depths_mm) == len(stored.press.point_forces_n) > 5
        dent = stored.contact.astype(float) - stored.no_contact
        assert np.abs(dent).max() > 20
    first, second = (read_record(practice / "s" / f"press-00{n}.json", TactileCapture) for n in (1, 2))
    assert first.indenter.depth_mm == pytest.approx(0.5, abs=0.002)
    assert first.press.ended_by == "depth"
    assert second.press.ended_by == "force"
    assert second.force_n == pytest.approx(1.0, abs=0.03)
    record = read_record(practice / "s" / "session.json", TactileSession)
    assert [device.role for device in record.press_devices] == ["stage", "load cell"]
    assert finray(f"verify {practice}/s").status == 0


def test_force_limit_stops_the_stage_and_it_leaves(practice, monkeypatch):
    only_the_stop_is_left(monkeypatch)
    changed(
        practice, "rig-presses.toml", ("until_force_n = 1.0 ", "# "), ("force_limit_n = 2.0", "force_limit_n = 0.8")
    )
    outcome = session(practice)
    assert outcome.status == 2
    assert "beyond the limit of 0.8 N" in outcome.err
    assert f"finray capture --resume {practice}/s" in outcome.err
    assert "ForceLimitError" in events(practice, "stage stopped")[0]["why"]
    assert events(practice, "stage after stop")[0]["text"] == "moved away to Z = 0 mm"
    assert len(events(practice, "press")) == 1


@pytest.mark.parametrize(
    ("fault", "words"),
    [
        ("stuck cell, 30 s", "so it is stuck"),
        ("silent cell, 30 s", "did not answer within 0.5 s"),
        ("drifting cell, 60 mN/s", "can be distinguished from noise and drift"),
        ("drifting cell, 100 mN/s", "Its zero drifts, or the indenter"),
    ],
)
def test_faults_of_the_cell_stop_the_stage(practice, fault, words):
    faulty(practice, fault)
    outcome = session(practice)
    assert outcome.status == 2
    assert words in outcome.err
    assert events(practice, "stage after stop")[0]["text"] == "moved away to Z = 0 mm"


@pytest.mark.parametrize("drift_mn_per_s", [0.2, 0.5])
def test_drift_is_in_the_uncertainty(practice, drift_mn_per_s):
    faulty(practice, f"drifting cell, {drift_mn_per_s} mN/s")
    outcome = session(practice)
    assert outcome.status == 0, outcome.err
    for press in read_record(practice / "s" / "session.json", TactileSession).measured:
        assert press.zero_shift_n > 1e-3 * drift_mn_per_s
        truth_n = true_force_n(press.depth_mm)
        slope = STIFFNESS_N_PER_MM + 2.0 * STIFFENING_N_PER_MM2 * press.depth_mm
        # what is left beside the force's own uncertainty is that of the depth it is compared at
        allowed_n = 2.5 * np.hypot(press.force_uncertainty_n, slope * press.touch_uncertainty_mm)
        assert press.force_n == pytest.approx(truth_n, abs=allowed_n)


def test_lost_steps_are_seen_at_the_next_touch(practice):
    faulty(practice, "lost steps, 3 %")
    changed(practice, "rig-presses.toml", ("led_current_ma", "repeats = 3\nled_current_ma"))
    outcome = session(practice)
    assert outcome.status == 2
    assert "The stage lost steps, or the finger moved" in outcome.err


def test_resumed_session_presses_what_is_missing_only(practice):
    changed(practice, "rig-presses.toml", ("until_force_n = 1.0 ", "until_force_n = 1.4 "))
    changed(practice, "rig.toml", ("surface_mm = -6.0", "surface_mm = -8.45"))
    outcome = session(practice)
    assert outcome.status == 2
    assert "end of its travel into the pad" in outcome.err
    done = [int(line["contact"]) for line in events(practice, "press")]
    assert done == [1]
    # the rig of the journal counts: only a rig that is as it was goes on, and it fails again at the same press
    again = finray(f"capture --resume {practice}/s")
    assert again.status == 2
    assert [int(line["contact"]) for line in events(practice, "press")] == [1]
    assert len(events(practice, "stage ready")) == 2


def test_interrupted_session_is_finished_with_its_forces(practice, monkeypatch):
    stopped_at = {"frames": 5}

    def dying(*arguments: object) -> str:
        stopped_at["frames"] -= 1
        if stopped_at["frames"] < 0:
            raise KeyboardInterrupt
        return write_frame(*arguments)

    from rigs.capture._tactile_session import write_frame

    with monkeypatch.context() as patched:
        patched.setattr("rigs.capture._tactile_session.write_frame", dying)
        assert session(practice).status == 130
    assert events(practice, "stage after stop")[0]["text"] == "moved away to Z = 0 mm"
    resumed = finray(f"capture --resume {practice}/s")
    assert resumed.status == 0, resumed.err
    record = read_record(practice / "s" / "session.json", TactileSession)
    assert [press.contact for press in record.measured] == [1, 2]
    assert finray(f"verify {practice}/s").status == 0


def test_plans_with_forces_need_a_cell(practice, tmp_path):
    text = (practice / "rig.toml").read_text(encoding="utf-8").partition("[stage]")[0]
    text = text.replace('driver = "simulated" ', 'driver = "picamera2" ').replace("# address = ...", 'address = "0"')
    (tmp_path / "by-hand.toml").write_text(text, encoding="utf-8")
    outcome = finray(f"capture {practice}/rig-presses.toml --rig {tmp_path}/by-hand.toml --dry-run")
    assert outcome.status == 2
    assert "plan.presses (entry 2): gives a force, but the rig has no stage" in outcome.err


@pytest.mark.parametrize(
    ("file", "edit", "words"),
    [
        ("rig-presses.toml", ("until_force_n = 1.0 ", "until_force_n = 6.0 "), "until_force_n = 6 N must be below"),
        ("rig-presses.toml", ("position_mm = 8.0", "position_mm = 90.0"), "outside the stage's travel of 0 to 80 mm"),
        ("rig-presses.toml", ("position_mm = 8.0", "position_mm = 8.0\ntilt_deg = 5.0"), "the stage cannot tilt"),
        (
            "rig.toml",
            ("press_travel_mm = [-9.0, 0.0]", "press_travel_mm = [0.0, -9.0]"),
            "write the lower position first",
        ),
        ("rig.toml", ('pad_axis = "X"', 'pad_axis = "Z"'), "press_axis and pad_axis are both Z"),
        ("rig.toml", ("force_limit_n = 5.0", "force_limit_n = 50.0"), "must not exceed capacity_n = 9.8 N"),
        ("rig.toml", ("clear_mm = 0.0", "clear_mm = -9.0"), "not at the end that lies in the pad"),
        ("rig.toml", ("# practice_fault = ...", 'practice_fault = "loose cell"  #'), "is not a practice fault"),
        ("rig.toml", ('calibration = "load-cell.json"', 'calibration = "none.json"'), "finray rig calibrate-cell"),
    ],
)
def test_mistakes_are_refused_before_anything_moves(practice, file, edit, words):
    changed(practice, file, edit)
    outcome = session(practice)
    assert outcome.status == 2
    assert words in outcome.err
    assert not (practice / "s" / "journal.jsonl").exists()


def test_a_cell_may_be_silent_for_four_readings():
    with pytest.raises(ValueError, match=r"too short for four readings at 10 Hz; give at least 0\.4 s"):
        LoadCellSettings(capacity_n=5.0, force_limit_n=2.0, rate_hz=10, silent_s=0.3)


def test_rig_is_shown_with_its_calibration(practice):
    shown = finray(f"rig show {practice}/rig.toml")
    assert shown.status == 0, shown.err
    assert "travel is -9 to 0 mm" in shown.out
    assert "slope_n_per_count" in shown.out


def test_calibration_of_a_cell_is_refused(practice):
    asked = f"rig calibrate-cell {practice}/rig.toml --out {practice}/other.json --gravity 9.81"
    assert "weigh 19.6 N, but the cell can bear only 9.8 N" in finray(f"{asked} --masses-g 20,2000").err
    assert "two or more different masses in grams" in finray(f"{asked} --masses-g 20").err
    assert (
        "must be 9.7 to 9.9 m/s^2 (9.78 at the equator"
        in finray(f"{asked} --masses-g 20,50".replace("9.81", "1.62")).err
    )
    assert "exists" in finray(f"rig calibrate-cell {practice}/rig.toml --masses-g 20,50 --gravity 9.81").err


def drawn_presses(count: int) -> list[tuple[float, float, float, float]]:
    """Touch error (mm) and force error (N) of random fingers, each with its standard uncertainty."""
    rng, found = np.random.default_rng(5), []
    for seed in range(count):
        rig = random_finger(rng, seed)
        with open_tactile_rig(rig, Path()) as opened:
            presser = StagePress(opened, rig, exact_calibration(rig), lambda event, **what: None)
            plan = TactilePlan.model_validate_json(PRESS_JSON)
            presser.press(plan.presses[0], 1)
            presser.seen()
            measured = presser.measured[1]
            finger = rig.simulated
            depth_mm = finger.surface_mm - opened.stage.places_mm()["Z"]
            truth_n = finger.stiffness_n_per_mm * depth_mm + finger.stiffening_n_per_mm2 * depth_mm**2
            touch = (measured.touch_mm - finger.surface_mm, measured.touch_uncertainty_mm)
            found.append((*touch, measured.force_n - truth_n, measured.force_uncertainty_n))
    return found


PRESS_JSON = json.dumps(
    {
        "name": "x", "design": "x", "exposures_s": [0.01], "led_current_ma": 20.0, "light_angle_deg": 30.0,
        "light_angle_uncertainty_deg": 0.5, "indenter": {"shape": "ball", "radius_mm": 4.0},
        "presses": [
            {"depth_mm": 0.3, "position_mm": 8.0, "depth_uncertainty_mm": 0.02, "position_uncertainty_mm": 0.1}
        ],
    }
)  # fmt: skip


def random_finger(rng: np.random.Generator, seed: int) -> TactileRig:
    from rigs import tactile_rig

    rig = tactile_rig(simulated=True).model_dump()
    rig["simulated"] |= {
        "seed": seed,
        "relaxing_share": 0.0,
        "noise_counts": int(np.exp(rng.uniform(np.log(15), np.log(150)))),
        "surface_mm": rng.uniform(-2.0, -1.0),
        "stiffness_n_per_mm": np.exp(rng.uniform(np.log(0.3), np.log(5.0))),
        "stiffening_n_per_mm2": rng.uniform(0.0, 3.0),
    }
    return TactileRig.model_validate(rig)


def exact_calibration(rig: TactileRig, slope: float | None = None) -> LoadCellCalibration:
    slope = slope or rig.simulated.cell_n_per_count
    return LoadCellCalibration(
        cell=f"x, {rig.load_cell.driver} {rig.load_cell.address}", calibrated_utc="2026-01-01",
        gravity_m_per_s2=9.81, gravity_uncertainty_m_per_s2=0.0,
        masses_kg=(0.0, 0.1, 0.0), mass_uncertainty_rel=0.0, counts=(0.0, 0.981 / slope, 0.0),
        counts_uncertainties=(1.0, 1.0, 1.0), slope_n_per_count=slope, slope_uncertainty_n_per_count=0.0,
        linearity_n=0.0, hysteresis_n=0.0, noise_n=0.0, drift_n_per_s=0.0, readings=40,
    )  # fmt: skip


def test_touch_and_force_lie_within_their_uncertainties():
    found = np.array(drawn_presses(200))
    # what still relaxes when two means agree is in the force for a moment more: judged where nothing relaxes
    held = np.mean(np.abs(found[:, 2]) <= 1.96 * found[:, 3])
    assert held >= 0.904
    covered = np.mean(np.abs(found[:, 0]) <= 1.96 * found[:, 1])
    # 0.95 less three standard deviations of 200 draws
    assert covered >= 0.904
    # evenly likely within its bounds: a standard uncertainty that is not idle
    assert 0.6 < np.sqrt(np.mean((found[:, 0] / found[:, 1]) ** 2)) < 1.3


@pytest.mark.parametrize("speed_mm_per_s", [0.5, 2.0, 10.0])
def test_overshoot_of_the_limit_is_what_the_formula_says(practice, speed_mm_per_s):
    """One long move into the pad, without steps: dF = k (v t + v^2 / 2a) by the simulated stage's own numbers."""
    from rigs.capture import ForceGauge, open_tactile_rig

    rig = read_toml(practice / "rig.toml", TactileRig)
    with open_tactile_rig(rig, practice) as opened:
        gauge = ForceGauge(opened.load_cell, rig.load_cell, exact_calibration(rig))
        gauge.tare()
        opened.stage.home(10.0, lambda: None)

        def watch() -> None:
            if gauge.reading_n() > 1.0:
                raise ForceLimitError("enough")

        with pytest.raises(ForceLimitError):
            opened.stage.move("Z", -9.0, speed_mm_per_s, watch)
        depth_mm = -6.0 - opened.stage.places_mm()["Z"]
    stiffness = STIFFNESS_N_PER_MM + 2.0 * STIFFENING_N_PER_MM2 * depth_mm
    most_n = stiffness * (speed_mm_per_s * (1.0 / 80.0 + 0.03) + speed_mm_per_s**2 / 100.0)
    # the relaxing share of 5 % acts before the elastic force reaches the limit
    assert 0.9 < true_force_n(depth_mm) < 1.0 + most_n


def test_calibration_covers_the_true_slope():
    from finray_calib.force import Gravity, Loads, calibrate_cell, loading_order

    order = np.array(loading_order((0.02, 0.05, 0.1, 0.2, 0.5)))
    slope, gravity, hits, draws = 4.7e-6, 9.81, 0, 400
    for seed in range(draws):
        rng = np.random.default_rng(seed)
        true_g = gravity + 0.001 * rng.standard_normal()
        true_kg = order * (1.0 + 0.0005 * rng.standard_normal())
        # placing and hysteresis scatter by more than the mean of 40 readings
        force_n = true_kg * true_g + 3e-4 * rng.standard_normal(len(order))
        counts = 84_000 + force_n[:, None] / slope + 60 * rng.standard_normal((len(order), 40))
        loads = Loads(order, counts, np.arange(len(order), dtype=float), 0.0005)
        record = calibrate_cell(loads, Gravity(gravity, 0.001), "x", "2026-01-01")
        hits += abs(record.slope_n_per_count - slope) <= 1.96 * record.slope_uncertainty_n_per_count
    # 0.95 +- three standard deviations of 400 draws
    assert 0.917 <= hits / draws <= 0.983


@pytest.fixture
def bench(tmp_path: Path):
    with press_bench(tmp_path) as running:
        yield running


class FlatCamera:
    """A camera that sees noise."""

    def __init__(self) -> None:
        self._rng = np.random.default_rng(1)

    def identity(self):
        from data_schemas import DeviceIdentity

        return DeviceIdentity(role="camera", driver="picamera2", address="0", model="imx219")

    def expose(self, exposure_s: float, deadline_s: float) -> RawFrame:
        counts = self._rng.integers(100, 200, (64, 96)).astype(np.uint16)
        return RawFrame(counts, exposure_s, exposure_s, SystemClock().utc())


def real_rig(folder: Path, bench: PressBench, **stage: object) -> TactileRig:
    """Write the rig of both boards, with its calibration, and a plan of one press."""
    rig = TactileRig.model_validate(
        {
            "name": "boards",
            "camera": {"driver": "picamera2", "address": f"of process {os.getpid()}", "width_px": 96, "height_px": 64},
            "stage": {
                "driver": "grbl", "address": str(bench.controller.port.path), "base_mm": 0.0, "clear_mm": -0.7,
                "press_travel_mm": (-3.0, 0.0), "pad_travel_mm": (0.0, 20.0), "homing": "switches",
                "press_speed_mm_per_s": 4.0, "travel_speed_mm_per_s": 40.0, "step_mm": 0.1, "touch_step_mm": 0.05,
                **stage,
            },
            "load_cell": {
                "driver": "hx711", "address": str(bench.amplifier.port.path), "capacity_n": 20.0, "force_limit_n": 4.0,
                "settle_s": 0.5, "silent_s": 0.3,
            },
        }
    )  # fmt: skip
    write_tactile_rig(rig, folder / "rig.toml")
    calibration = exact_calibration(rig, N_PER_COUNT)
    write_record(calibration, folder / "load-cell.json", provenance("pytest"))
    return rig


def simulated() -> dict[str, object]:
    from rigs import tactile_rig

    return tactile_rig(simulated=True).model_dump()


class Hands:
    """Does nothing and allows everything."""

    def do(self, text: str) -> None: ...

    def allows(self, question: str) -> bool:
        return True


def run(folder: Path, rig: TactileRig, monkeypatch, **press: object) -> TactileSession:
    from contextlib import nullcontext

    monkeypatch.setattr("rigs.capture._force_gauge.open_camera", lambda *_: nullcontext(FlatCamera()))
    plan = TactilePlan.model_validate_json(PRESS_JSON)
    presses = (plan.presses[0].model_copy(update=press),)
    plan = plan.model_copy(update={"presses": presses})
    return capture_tactile_session(rig, plan, presses, SessionRequest(folder / "s", "pytest", folder, operator=Hands()))


def test_session_on_boards(bench, tmp_path, monkeypatch):
    bench.controller.at_mm["X"] = -2.0
    record = run(tmp_path, real_rig(tmp_path, bench), monkeypatch, depth_mm=0.4)
    press = record.measured[0]
    assert press.depth_mm == pytest.approx(0.4, abs=0.01)
    assert press.touch_mm == pytest.approx(-1.5, abs=2.5 * press.touch_uncertainty_mm + 0.0025)
    # 4 N/mm; the touch is known to half a step of 0.05 mm
    assert press.force_n == pytest.approx(4.0 * press.depth_mm, abs=4.0 * 0.03)
    assert bench.controller.at_mm["Z"] == pytest.approx(-0.7, abs=1e-6)
    assert bench.controller.at_mm["X"] == pytest.approx(8.0, abs=1e-6)


def test_a_cell_that_is_late_changes_neither_touch_nor_force(tmp_path, monkeypatch):
    """By one reading in its board and one on its way, 10 times a second: reports of the stage used to pile up then."""
    with press_bench(tmp_path, 10) as bench:
        bench.surface_mm, cell, say, lines = -1.2, bench.amplifier, bench.amplifier.port.say, deque[bytes]()

        class Late(deque[float]):
            before: float | None = None

            def append(self, conversion: float) -> None:
                super().append(conversion if self.before is None else self.before)
                self.before = conversion

        def say_late(line: bytes) -> None:
            if line.startswith(b"R "):
                lines.append(line)
                line = lines.popleft() if len(lines) > 1 else b""
            say(line)

        cell._conversions = Late(maxlen=4)  # noqa: SLF001 a filter that is one conversion longer
        monkeypatch.setattr(cell.port, "say", say_late)
        rig = real_rig(tmp_path, bench, clear_mm=-0.4, touch_step_mm=0.1)
        slow = rig.load_cell.model_copy(update={"rate_hz": 10, "silent_s": 0.5})
        record = run(tmp_path, rig.model_copy(update={"load_cell": slow}), monkeypatch, depth_mm=0.1)
    press = record.measured[0]
    assert abs(press.touch_mm - bench.surface_mm) < 3.0 * press.touch_uncertainty_mm
    true_n = 4.0 * (press.depth_mm + bench.surface_mm - press.touch_mm)
    # half a step of the motor, at 4 N/mm
    assert press.force_n == pytest.approx(true_n, abs=3.0 * press.force_uncertainty_n + 0.5 * 4.0 / 400.0)


@pytest.mark.parametrize("fault", ["stuck", "silent", "reset", "pulled", "stiff"])
def test_no_fault_leaves_the_stage_driving(bench, tmp_path, monkeypatch, fault):
    """Once the pad is pressed; the strongest force stays within the limit and one step of the stage."""
    cell, controller = bench.amplifier, bench.controller

    def break_it() -> None:
        while bench.force_n < 0.3:
            time.sleep(0.005)
        if fault == "stuck":
            cell.is_stuck = True
        elif fault == "silent":
            cell.is_silent = True
        elif fault == "reset":
            while controller.state != "Jog":
                time.sleep(0.001)
            controller.reset()
        elif fault == "pulled":
            controller.port.pull()
            time.sleep(0.5)
            controller.port.plug()
        else:
            bench.stiffness_n_per_mm = 40.0

    threading.Thread(target=break_it, daemon=True).start()
    with pytest.raises(CaptureError) as ended:
        run(tmp_path, real_rig(tmp_path, bench), monkeypatch, depth_mm=1.2)
    assert (tmp_path / "s" / "journal.jsonl").is_file(), str(ended.value)
    assert bench.rests
    assert controller.state in ("Idle", "Alarm", "Hold:0")
    stiffness = bench.stiffness_n_per_mm
    assert bench.strongest_n <= max(4.0, 4.0 * 1.2) + 0.1 * stiffness
    told = [line for line in read_journal(tmp_path / "s") if line["event"] in ("stage stopped", "stage after stop")]
    assert len(told) == 2
    if fault in ("stuck", "silent", "stiff"):
        assert controller.at_mm["Z"] == pytest.approx(-0.7, abs=1e-6)
        assert bench.force_n == 0.0


def test_killed_program_leaves_at_most_one_step(bench, tmp_path):
    """SIGKILL while the stage moves: nothing of ours can act, and the controller ends its one move."""
    rig = real_rig(tmp_path, bench)
    text = f"""
from pathlib import Path
from data_schemas import TactileRig
from rigs.stages.grbl import open_stage
rig = TactileRig.model_validate_json({rig.model_dump_json()!r})
with open_stage(rig.stage) as stage:
    stage.home(10.0, lambda: None)
    print("ready", flush=True)
    at_mm = 0.0
    while True:
        at_mm -= rig.stage.step_mm
        stage.move("Z", at_mm, 0.5, lambda: None)
"""
    with subprocess.Popen([sys.executable, "-c", text], stdout=subprocess.PIPE, text=True) as program:
        assert program.stdout.readline() == "ready\n"
        time.sleep(1.0)
        program.send_signal(signal.SIGKILL)
        killed_at_mm = bench.controller.at_mm["Z"]
    time.sleep(0.5)
    assert bench.rests
    assert killed_at_mm - 0.1 - 1e-6 <= bench.controller.at_mm["Z"] < 0.0


def test_calibration_of_another_cell_is_refused_or_told(practice):
    path = practice / "load-cell.json"
    record = read_record(path, LoadCellCalibration)
    path.unlink()
    write_record(record.model_copy(update={"cell": "bench, hx711 /dev/ttyACM0"}), path, provenance("pytest"))
    outcome = session(practice)
    assert outcome.status == 2
    assert "is the calibration of 'bench, hx711 /dev/ttyACM0', but load_cell.driver in the rig file is" in outcome.err
    assert "is the calibration of" in finray(f"rig show {practice}/rig.toml").out
    path.unlink()
    write_record(record.model_copy(update={"cell": "bench, simulated elsewhere"}), path, provenance("pytest"))
    assert "was calibrated at 'elsewhere'" in finray(f"rig show {practice}/rig.toml").out
    assert session(practice).status == 0
    notes = read_record(practice / "s" / "session.json", TactileSession).notes
    assert any("was calibrated at 'elsewhere'" in note for note in notes)
    # 200 g were laid on it, and it may press with 5 N
    assert any("forces above 1.96 N" in note and "are extrapolated" in note for note in notes)


def test_contact_without_its_zero_is_pressed_again(practice, monkeypatch):
    """A session that ended between the images and the zero used to lose the zero's part of the uncertainty."""
    faulty(practice, "drifting cell, 0.5 mN/s")
    leave, ended = StagePress.leave, []

    def dying(presser: StagePress) -> None:
        if presser.measured and not ended:
            ended.append(True)
            raise KeyboardInterrupt
        leave(presser)

    monkeypatch.setattr(StagePress, "leave", dying)
    assert session(practice).status == 130
    assert finray(f"capture --resume {practice}/s").status == 0
    measured = read_record(practice / "s" / "session.json", TactileSession).measured
    assert [press.contact for press in measured] == [1, 2]
    assert all(press.zero_shift_n is not None for press in measured)
    assert [line["contact"] for line in events(practice, "press")] == [1, 1, 2]


def test_finger_that_moved_before_a_session_went_on_is_found(practice, monkeypatch):
    changed(practice, "rig-presses.toml", ("led_current_ma", "repeats = 2\nled_current_ma"))
    press, moved = StagePress.press, []

    def dying(presser: StagePress, planned, contact: int) -> None:
        if contact == 2 and not moved:
            moved.append(True)
            raise KeyboardInterrupt
        press(presser, planned, contact)

    monkeypatch.setattr(StagePress, "press", dying)
    assert session(practice).status == 130
    journal = practice / "s" / "journal.jsonl"
    text = journal.read_text(encoding="utf-8")
    assert '"surface_mm": -6.0' in text
    journal.write_text(text.replace('"surface_mm": -6.0', '"surface_mm": -6.4'), encoding="utf-8")
    resumed = finray(f"capture --resume {practice}/s")
    assert resumed.status == 2
    assert "or the finger moved" in resumed.err


def test_press_deeper_than_the_travel_is_refused(practice):
    changed(practice, "rig-presses.toml", ("depth_mm = 1.5 ", "depth_mm = 9.5 "))
    outcome = session(practice)
    assert "depth_mm = 9.5 is more than the 9 mm from clear_mm to the end of press_travel_mm" in outcome.err


def test_touch_step_is_no_longer_than_a_step(practice):
    changed(practice, "rig.toml", ("touch_step_mm = 0.02", "touch_step_mm = 0.5"))
    assert "touch_step_mm = 0.5 mm must not exceed step_mm = 0.05 mm" in session(practice).err


def journal_of(folder: Path, event: str) -> str:
    return next(str(line["text"]) for line in read_journal(folder / "s") if line["event"] == event)


def test_stage_that_stops_beyond_clear_mm_does_not_flee_into_the_pad(bench, tmp_path, monkeypatch):
    """clear_mm lies in the pad: the flight was an absolute move to it, and pressed 18 N at a limit of 4 N."""
    rig = real_rig(tmp_path, bench, clear_mm=-6.0, press_travel_mm=(-20.0, 0.0))
    with pytest.raises(ForceLimitError, match="the indenter touches before clear_mm"):
        run(tmp_path, rig, monkeypatch)
    # a tenth of the limit, one step of 0.1 mm into 4 N/mm, and another where a busy computer reads late
    assert bench.strongest_n <= 0.4 + 2 * 0.4
    assert bench.controller.at_mm["Z"] > -2.0
    assert "lies from there towards the pad; move the indenter off the pad by hand" in journal_of(
        tmp_path, "stage after stop"
    )
    ways = [float(line.partition("G53Z")[2].partition("F")[0]) for line in bench.controller.lines if "G53Z" in line]
    assert max(sooner - later for sooner, later in pairwise([0.0, *ways])) <= 0.1 + 1e-9


def test_stage_that_is_not_seen_to_stop_is_what_the_person_is_told(bench, tmp_path, monkeypatch):
    """The cable is pulled while it homes."""

    def pull() -> None:
        while bench.controller.state != "Home":
            time.sleep(0.002)
        bench.controller.port.pull()

    rig = real_rig(tmp_path, bench)
    threading.Thread(target=pull, daemon=True).start()
    with pytest.raises(UnsafeError, match=r"NOT SEEN TO STOP.*drive to their switches.*switch its motors off"):
        run(tmp_path, rig, monkeypatch)
    assert "NOT SEEN TO STOP" in journal_of(tmp_path, "stage after stop")


def test_second_interruption_waits_until_the_pad_is_left(bench, tmp_path, monkeypatch):
    flee, expose = StagePress._flee, FlatCamera.expose  # noqa: SLF001 the flight itself is disturbed

    def interrupted(camera: FlatCamera, exposure_s: float, deadline_s: float) -> RawFrame:
        if bench.force_n > 0.0:
            raise KeyboardInterrupt
        return expose(camera, exposure_s, deadline_s)

    def disturbed(presser: StagePress, error: BaseException) -> None:
        os.kill(os.getpid(), signal.SIGINT)
        time.sleep(0.05)
        flee(presser, error)

    monkeypatch.setattr(FlatCamera, "expose", interrupted)
    monkeypatch.setattr(StagePress, "_flee", disturbed)
    with pytest.raises(KeyboardInterrupt):
        run(tmp_path, real_rig(tmp_path, bench), monkeypatch, depth_mm=0.4)
    assert bench.force_n == 0.0
    assert bench.controller.at_mm["Z"] == pytest.approx(-0.7, abs=1e-6)


def stiff(stiffness_n_per_mm: float, **stage: object) -> TactileRig:
    rig = simulated()
    rig["simulated"] |= {
        "stiffness_n_per_mm": stiffness_n_per_mm, "stiffening_n_per_mm2": 0.0, "relaxing_share": 0.0,
    }  # fmt: skip
    rig["stage"] |= stage
    return TactileRig.model_validate(rig)


def pressed(rig: TactileRig, limit_n: float, **press: object) -> tuple[str, list[float]]:
    """Press with a limit; return why it ended ("" where it did not), and the forces of its places (N)."""
    planned = TactilePlan.model_validate_json(PRESS_JSON).presses[0].model_copy(update=press)
    forces: list[float] = []
    with open_tactile_rig(rig, Path()) as opened:
        presser = StagePress(opened, rig, exact_calibration(rig), lambda event, **what: None, limit_n)
        move = opened.stage.move

        class Watched:
            def __getattr__(self, name: str):
                return getattr(opened.stage, name)

            def move(self, *given: object) -> None:
                move(*given)
                forces.append(opened.stage.state.force_n())

        presser._stage = Watched()  # noqa: SLF001
        try:
            presser.press(planned, 1)
        except CaptureError as error:
            return str(error), forces
    return "", forces


@pytest.mark.parametrize("stiffness_n_per_mm", [5.0, 13.6, 20.0, 40.0, 60.0, 400.0])
def test_the_search_of_the_touch_stays_below_the_limit(monkeypatch, stiffness_n_per_mm):
    """Long steps of 0.3 mm led to 4.08 N into a pad of 13.6 N/mm, and ended the session before it had begun."""
    soft_n, felt_n = FingerState.force_n, list[float]()

    def force_n(state: FingerState) -> float:
        felt_n.append(soft_n(state))
        return felt_n[-1]

    monkeypatch.setattr(FingerState, "force_n", force_n)
    rig = stiff(stiffness_n_per_mm, step_mm=0.3)
    why, _ = pressed(rig, 4.0, depth_mm=0.02, force_limit_n=None)
    speed = rig.stage.press_speed_mm_per_s
    beyond_mm = speed * (1.0 / rig.load_cell.rate_hz + DEAF_S) + speed**2 / (2.0 * BRAKING_MM_PER_S2)
    if stiffness_n_per_mm < 100.0:
        assert why == ""
        assert max(felt_n) < 4.0
    else:  # nothing can stop the stage in time: what to do is said
        assert "search for the touch met" in why
        assert "shorten step_mm or lower press_speed_mm_per_s" in why
        assert max(felt_n) < 1.0 + stiffness_n_per_mm * beyond_mm


def test_a_session_asks_for_room_before_its_first_whole_step():
    """The first step goes where the search of the touch has been; a pad of 18 N/mm adds 0.9 N by the next."""
    why, forces = pressed(stiff(18.0), 1.5)
    assert "adds 0.9 N, which would exceed or nearly reach the limit of 1.5 N" in why
    assert max(forces) < 1.5
    why, forces = pressed(stiff(1.5), 1.5)
    assert why == ""
    assert max(forces) == pytest.approx(0.45, abs=0.05)


@pytest.mark.parametrize("stiffening_n_per_mm2", [1.0, 12.0])
def test_every_step_asks_for_room(stiffening_n_per_mm2):
    """A pad that becomes stiffer exceeded the limit by its third step: only the second one was asked."""
    rig = stiff(1.5, step_mm=0.1)
    pad = rig.simulated.model_copy(update={"stiffening_n_per_mm2": stiffening_n_per_mm2})
    why, forces = pressed(rig.model_copy(update={"simulated": pad}), 0.7)
    assert max(forces) < 0.7
    if stiffening_n_per_mm2 > 10.0:
        assert "which would exceed or nearly reach the limit of 0.7 N" in why
        assert max(forces) > 0.35  # it went as far as there was room
    else:
        assert why == ""


@pytest.mark.parametrize(
    ("pad", "until_force_n"),
    [
        # stiffness (N/mm), its growth (N/mm^2), share that relaxes, noise, seed
        ((0.3, 10.0, 0.2, 400, 1), 3.0),
        ((0.487, 12.726, 0.0, 300, 1), 3.4),
    ],
)
def test_a_press_to_a_force_below_the_limit_takes_shorter_steps(pad, until_force_n):
    """The step to the force by the stiffness so far led beyond the limit, and was refused at half of the force."""
    names = ("stiffness_n_per_mm", "stiffening_n_per_mm2", "relaxing_share", "noise_counts", "seed")
    rig = stiff(1.0, step_mm=0.2, touch_step_mm=0.02)
    rig = rig.model_copy(update={"simulated": rig.simulated.model_copy(update=dict(zip(names, pad, strict=True)))})
    why, forces = pressed(rig, 4.0, depth_mm=3.0, until_force_n=until_force_n, force_limit_n=None)
    assert why == ""
    assert 0.98 * until_force_n <= max(forces) < 4.0


@pytest.mark.parametrize("wall_mm", [0.25, 0.5, 0.8])
def test_a_press_to_a_force_ends_at_something_hard(monkeypatch, wall_mm):
    """Behind some depth, a part of 60 N/mm: beyond the limit it goes as far as the stage cannot be stopped."""
    soft_n, felt_n = FingerState.force_n, list[float]()

    def force_n(state: FingerState) -> float:
        felt_n.append(soft_n(state) + 60.0 * max(state.indentation_mm - wall_mm, 0.0))
        return felt_n[-1]

    monkeypatch.setattr(FingerState, "force_n", force_n)
    rig = stiff(1.5, step_mm=0.1)
    why, _ = pressed(rig, 2.0, depth_mm=3.0, until_force_n=1.8, force_limit_n=None)
    assert "beyond the limit of 2 N" in why
    speed = rig.stage.press_speed_mm_per_s
    beyond_mm = speed * (1.0 / rig.load_cell.rate_hz + DEAF_S) + speed**2 / (2.0 * BRAKING_MM_PER_S2)
    assert max(felt_n) < 2.0 + (60.0 + 1.5) * beyond_mm


@pytest.mark.parametrize("force_n", [0.15, 0.35])
def test_what_is_met_beside_the_pad_stops_the_way_along_it(force_n):
    """Nothing should touch there: a fifth of the limit ends it, not all of it."""
    rig = stiff(1.5)
    with open_tactile_rig(rig, Path()) as opened:
        presser = StagePress(opened, rig, exact_calibration(rig), lambda event, **what: None, 1.0)
        presser.prepare()
        opened.stage.state.load_kg = force_n / 9.80665
        if force_n < 0.2:
            presser.along(rig.stage.base_mm + rig.stage.from_base * 9.0)
        else:
            with pytest.raises(ForceLimitError, match="the indenter touches before clear_mm"):
                presser.along(rig.stage.base_mm + rig.stage.from_base * 9.0)
