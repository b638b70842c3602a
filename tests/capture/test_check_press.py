"""The acceptance check of a rig that presses: on the simulated finger, on lying devices, and on boards in real time."""

import re
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from data_schemas import (
    AcceptanceReport,
    CheckResult,
    PressFacts,
    TactileCheckPlan,
    TactileRig,
)
from data_schemas.storage import read_record
from finray_calib.acceptance import judge_pressing
from finray_calib.acceptance._device_checks import remedy_of
from rigs import CellReading
from rigs.capture import OpenTactileRig, record_press_facts
from rigs.capture import _check_press as check_press
from rigs.capture._press_rounds import dent_column_px
from tests.capture.drivers.press_bench import PressBench, press_bench
from tests.capture.test_stage_press import FlatCamera, Hands, changed, faulty, real_rig
from tests.command_line.running import finray

PLAN = """\
kind = "tactile check"
check_name = "practice finger"
position_mm = 8.0
returns = 10
stops = 1
rest_s = 10.0
"""


@pytest.fixture
def practice(tmp_path: Path) -> Path:
    """A rig to practise on whose cell is calibrated up to its force limit, and a plan."""
    assert finray(f"rig init --preset simulated-finger --out {tmp_path}/rig.toml").status == 0
    done = finray(f"rig calibrate-cell {tmp_path}/rig.toml --masses-g 100,300,550 --gravity 9.80665")
    assert done.status == 0, done.err
    (tmp_path / "check.toml").write_text(PLAN, encoding="utf-8")
    return tmp_path


def checked(folder: Path) -> tuple[AcceptanceReport, int]:
    outcome = finray(f"check run {folder}/check.toml --rig {folder}/rig.toml --out {folder}/out")
    assert outcome.status in (0, 1), outcome.err
    return read_record(folder / "out/check.json", AcceptanceReport), outcome.status


def named(report: AcceptanceReport, name: str) -> CheckResult:
    (found,) = (result for result in report.results if result.name == name)
    return found


NOBODY_SAW = {
    "calibration holds", "X moves in time", "X reports its position", "Z moves in time", "Z reports its position",
    "press axis turns without play", "force stops the stage", "X goes as far as sent", "Z goes as far as sent",
}  # fmt: skip
"""What no device of the rig is a witness of."""


def test_the_practice_rig_passes_what_somebody_saw(practice: Path) -> None:
    changed(practice, "check.toml", ("rest_s = 10.0", "rest_s = 60.0"), ("stops = 1", "stops = 3"))
    report, status = checked(practice)
    assert status == 0
    assert {r.name: r.verdict for r in report.results if r.verdict != "PASS"} == dict.fromkeys(NOBODY_SAW, "UNDECIDED")
    assert report.verdict == "UNDECIDED"
    assert [r.name for r in report.results if remedy_of(r.name) is None] == []
    assert all(r.p_conform is None or r.p_conform > 0.95 for r in report.results)
    assert {r.section for r in report.results} == {
        "handshake", "load cell", "stage", "touch", "force limit", "stops", "reconnect",
    }  # fmt: skip
    # by the numbers of the simulated finger: 60 counts of 4.7e-6 N; its stage brakes for 0.1 s at most
    assert named(report, "load cell is quiet").value == pytest.approx(100 * 60 * 4.7e-6 / 5.0, rel=0.1)
    assert named(report, "stage stops on request").value < 0.2
    assert 0.5 < named(report, "stage stops at a silent cell").value < 0.7
    xml = (practice / "out/junit.xml").read_text(encoding="utf-8")
    assert 'failures="0"' in xml
    assert "press axis turns without play" in (practice / "out/report.html").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("fault", "name", "verdict", "words"),
    [
        ("stuck cell, 3 s", "load cell", "ERROR", "so it is stuck"),
        ("silent cell, 3 s", "load cell", "ERROR", "did not answer within 0.5 s"),
        ("silent cell, 200 s", "touches", "ERROR", "the stage moved away to Z = 0 mm"),
        ("stuck cell, 200 s", "touches", "ERROR", "the stage moved away to Z = 0 mm"),
        ("drifting cell, 30 mN/s", "load cell keeps its zero", "FAIL", "+3e+02 mN within 10 s"),
        ("lost steps, 2 %", "touch repeats", "FAIL", "returns from either side"),
    ],
)
def test_faults_of_the_practice_rig_are_found(practice: Path, fault: str, name: str, verdict: str, words: str) -> None:
    faulty(practice, fault)
    report, status = checked(practice)
    found = [r for r in report.results if r.name == name]
    assert (verdict, words in found[-1].evidence) == (found[-1].verdict, True), found
    assert report.verdict in ("FAIL", "ERROR")
    assert status == 1


@pytest.mark.parametrize("fault", ["lost bits, 200 readings", "wandering cell, 120 counts", "humming cell, 400 counts"])
def test_noise_that_is_not_white_changes_no_verdict_of_the_stage(practice: Path, fault: str) -> None:
    """Lost bits are said where the cell rests; the stage is judged as by a cell that loses none."""
    changed(practice, "check.toml", ("stops = 1", "stops = 3"), ("rest_s = 10.0", "rest_s = 60.0"))
    faulty(practice, fault)
    report, status = checked(practice)
    assert status == 0
    lost = {"load cell is quiet"} if fault.startswith("lost") else set()
    assert {r.name for r in report.results if r.verdict != "PASS"} == NOBODY_SAW | lost
    if lost:
        assert "readings were far beyond the noise" in named(report, "load cell is quiet").evidence
        assert 5 <= report.facts.at_rest.jumps <= 60


def lying(monkeypatch: pytest.MonkeyPatch, spoil: Callable[[OpenTactileRig], OpenTactileRig]) -> None:
    """Open the rig with one of its devices replaced."""
    from contextlib import contextmanager

    opening = check_press.open_tactile_rig

    @contextmanager
    def opened(*given: object):
        with opening(*given) as rig:
            yield spoil(rig)

    monkeypatch.setattr(check_press, "open_tactile_rig", opened)


class Wrapped:
    """A device of which some methods lie."""

    def __init__(self, device: object, **lies: object) -> None:
        self._device = device
        self.__dict__.update(lies)

    def __getattr__(self, name: str) -> object:
        return getattr(self._device, name)


def reading(opened: OpenTactileRig, count: Callable[[int], int]) -> OpenTactileRig:
    """Return the rig with a cell whose counts are changed."""
    cell = opened.load_cell

    def read(deadline_s: float) -> CellReading:
        true = cell.read(deadline_s)
        return true._replace(counts=count(true.counts))

    return replace(opened, load_cell=Wrapped(cell, read=read))


def not_moving(opened: OpenTactileRig) -> OpenTactileRig:
    """Return the rig with a stage that reports whatever it is asked for, and stays where it is."""
    stage, places = opened.stage, {}

    def move(axis: str, to_mm: float, speed_mm_per_s: float, watch: Callable[[], None]) -> None:
        watch()
        places[axis] = to_mm

    def places_mm() -> dict[str, float] | None:
        true = stage.places_mm()
        return None if true is None else {**true, **places}

    return replace(opened, stage=Wrapped(stage, move=move, places_mm=places_mm))


def still_pad_axis(opened: OpenTactileRig) -> OpenTactileRig:
    """Return the rig with a pad axis that reports and does not move."""
    stage, places = opened.stage, {}

    def move(axis: str, to_mm: float, speed_mm_per_s: float, watch: Callable[[], None]) -> None:
        if axis == "X":
            watch()
            places[axis] = to_mm
        else:
            stage.move(axis, to_mm, speed_mm_per_s, watch)

    def places_mm() -> dict[str, float] | None:
        true = stage.places_mm()
        return None if true is None else {**true, **places}

    return replace(opened, stage=Wrapped(stage, move=move, places_mm=places_mm))


class Noise:
    """Counts that no force changes: noise about a value, as of a broken bridge."""

    def __init__(self, around: int) -> None:
        self._around, self._number = around, 0

    def __call__(self, true: int) -> int:
        self._number = (self._number * 1103515245 + 12345) % 2**31
        return self._around + self._number % 121 - 60


@pytest.mark.parametrize(
    ("spoil", "passes"),
    [
        (lambda opened: reading(opened, lambda true: 0), set()),
        (lambda opened: reading(opened, Noise(84_000)), set()),
        (lambda opened: reading(opened, lambda true: 168_000 - true), set()),
        (not_moving, set()),
    ],
    ids=["count of 0", "noise that feels nothing", "other sign", "stage that only reports"],
)
def test_nothing_passes_that_nobody_saw(practice: Path, monkeypatch, spoil, passes) -> None:
    lying(monkeypatch, spoil)
    report, status = checked(practice)
    assert (status, report.verdict) == (1, "ERROR")
    seen = {r.name for r in report.results if r.verdict == "PASS"}
    # what needs no witness: who they are, the calibration on paper, and that they come back
    assert seen <= {
        "camera answers", "stage answers", "load cell answers", "frames in time", "calibration is recent",
        "load cell is straight", "devices come back",
    }  # fmt: skip


def test_an_absent_pad_decides_nothing(practice: Path) -> None:
    changed(practice, "rig.toml", ("surface_mm = -6.0", "surface_mm = -20.0"))
    report, status = checked(practice)
    assert status == 1
    assert "the end of its travel into the pad" in named(report, "touches").evidence
    for name in ("load cell is quiet", "load cell keeps its zero", "Z moves in time", "X moves in time"):
        assert named(report, name).verdict == "UNDECIDED", name


def test_a_pad_axis_that_only_reports_does_not_pass(practice: Path, monkeypatch) -> None:
    lying(monkeypatch, still_pad_axis)
    report, _ = checked(practice)
    assert named(report, "X moves in time").verdict == "UNDECIDED"
    assert named(report, "X reports its position").verdict == "UNDECIDED"
    assert "it is not confirmed that X travels as far" in named(report, "X reports its position").evidence
    assert named(report, "Z moves in time").verdict == "UNDECIDED"  # without a block nobody knows how far Z goes
    assert "it is not confirmed that Z travels as far" in named(report, "Z moves in time").evidence


@pytest.mark.parametrize("readings_late", [12, 16])
def test_readings_that_come_late_say_nothing_of_the_step(practice: Path, monkeypatch, readings_late: int) -> None:
    """They wait for up to the 0.2 s that a driver allows: the touch was found 0.02 mm late, the stop 0.18 N beyond."""
    waiting: deque[CellReading] = deque()

    def late(opened: OpenTactileRig) -> OpenTactileRig:
        cell = opened.load_cell

        def read(deadline_s: float) -> CellReading:
            while len(waiting) <= readings_late:
                waiting.append(cell.read(deadline_s))
            return waiting.popleft()

        return replace(opened, load_cell=Wrapped(cell, read=read))

    lying(monkeypatch, late)
    report, _ = checked(practice)
    assert report.facts.errors == {}
    for touch in report.facts.touches:
        assert abs(touch.touch_mm + 6.0) < 2.0 * touch.touch_uncertainty_mm
    (stop,) = report.facts.force_stops
    assert 0.0 < stop.peak_n - stop.limit_n < stop.stiffness_n_per_mm * stop.step_mm


def test_readings_that_are_never_fresh_end_the_press(practice: Path, monkeypatch) -> None:
    def old(opened: OpenTactileRig) -> OpenTactileRig:
        cell = opened.load_cell
        return replace(opened, load_cell=Wrapped(cell, read=lambda s: cell.read(s)._replace(at_s=0.0)))

    lying(monkeypatch, old)
    report, _ = checked(practice)
    assert "were made before the stage was at rest" in named(report, "touches").evidence


@pytest.mark.parametrize(
    ("stiffness", "touch_step", "title", "words"),
    [
        (
            "28.0",
            "0.02",
            "touches",
            "one step of 0.05 mm adds 1.4. N, which is too much to press deeper from the force at which the stage "
            "turns back",
        ),
        (
            "17.5",
            "0.02",
            "force limit holds",
            "one step of 0.05 mm adds 0.9.* N, which is too much to try a stop at 1.25 N",
        ),
        (
            "18.0",
            "0.05",
            "touches",
            "N at the first touch, so it is not known how much one step of 0.05 mm adds",
        ),
    ],
)
def test_a_first_step_without_room_is_refused(
    practice: Path, stiffness: str, touch_step: str, title: str, words: str
) -> None:
    """The check may go to 2.5 N: from the turning force of 0.63 N, and from the stop at 1.25 N."""
    changed(
        practice, "rig.toml",
        ("stiffness_n_per_mm = 1.5", f"stiffness_n_per_mm = {stiffness}"),
        ("touch_step_mm = 0.02 ", f"touch_step_mm = {touch_step} "),
    )  # fmt: skip
    report, _ = checked(practice)
    assert re.search(words, named(report, title).evidence), named(report, title).evidence


@pytest.mark.parametrize(
    ("deepest_mm", "title", "words"),
    [
        (0.36, "touches", "beyond the force at which the stage turns back leads deeper than deepest_mm = 0.36 mm"),
        (0.5, "force limit holds", "N at deepest_mm = 0.5 mm, but the stop must be tried at 1.25 N; raise deepest_mm"),
    ],
)
def test_the_deepest_place_of_the_plan_is_kept(
    practice: Path, monkeypatch, deepest_mm: float, title: str, words: str
) -> None:
    changed(practice, "check.toml", ("stops = 1", f"stops = 1\ndeepest_mm = {deepest_mm}"))
    deepest = [0.0]

    def watched(opened: OpenTactileRig) -> OpenTactileRig:
        def read(deadline_s: float) -> CellReading:
            deepest[0] = max(deepest[0], opened.stage.state.indentation_mm)
            return opened.load_cell.read(deadline_s)

        return replace(opened, load_cell=Wrapped(opened.load_cell, read=read))

    lying(monkeypatch, watched)
    report, _ = checked(practice)
    assert words in named(report, title).evidence, named(report, title).evidence
    assert 0.2 < deepest[0] < deepest_mm + 0.02  # the touch is known to a touch_step_mm


def test_play_of_the_press_axis_is_found(practice: Path, monkeypatch) -> None:
    """A stage that stands deeper by its play while it comes out of the pad."""
    play_mm = 0.08

    def slack(opened: OpenTactileRig) -> OpenTactileRig:
        stage, carriage = opened.stage, {}

        def move(axis: str, to_mm: float, speed_mm_per_s: float, watch: Callable[[], None]) -> None:
            if axis != "Z":
                stage.move(axis, to_mm, speed_mm_per_s, watch)
                return
            # the motor turns, the carriage follows when the play is used up; into the pad is -Z
            true = stage.places_mm()["Z"]
            aim = min(max(true, to_mm - play_mm), to_mm) if to_mm > true else to_mm
            stage.move(axis, max(min(aim, 0.0), -9.0), speed_mm_per_s, watch)
            carriage["Z"] = to_mm

        def places_mm() -> dict[str, float] | None:
            true = stage.places_mm()
            return None if true is None else {**true, **carriage}

        return replace(opened, stage=Wrapped(stage, move=move, places_mm=places_mm))

    lying(monkeypatch, slack)
    report, _ = checked(practice)
    found = named(report, "press axis turns without play")
    assert found.verdict == "FAIL"
    assert found.value == pytest.approx(play_mm, abs=0.005)


def test_a_stage_that_drives_on_after_its_stop_fails(practice: Path, monkeypatch) -> None:
    def deaf(opened: OpenTactileRig) -> OpenTactileRig:
        stage = opened.stage

        def move(axis: str, to_mm: float, speed_mm_per_s: float, watch: Callable[[], None]) -> None:
            try:
                stage.move(axis, to_mm, speed_mm_per_s, watch)
            except BaseException:
                stage.move(axis, to_mm, speed_mm_per_s, lambda: None)
                raise

        return replace(opened, stage=Wrapped(stage, move=move))

    lying(monkeypatch, deaf)
    report, _ = checked(practice)
    assert named(report, "stage stops on request").verdict == "FAIL"
    assert "did not stop before the end of its move" in named(report, "stage stops at a silent cell").evidence


def test_nobody_who_says_yes_is_nothing_that_moves(practice: Path, monkeypatch) -> None:
    class Absent(Hands):
        def allows(self, question: str) -> bool:
            assert re.search(r"homes all axes.*with up to 2\.5 N and 1 mm deep", question)
            return False

    moved: list[str] = []

    def watched(opened: OpenTactileRig) -> OpenTactileRig:
        moves = {name: lambda *_: moved.append("moved") for name in ("move", "home")}
        return replace(opened, stage=Wrapped(opened.stage, **moves), operator=Absent())

    lying(monkeypatch, watched)
    report, status = checked(practice)
    assert (moved, status) == ([], 1)
    assert "nobody has confirmed that it may move" in named(report, "stage moves").evidence


@pytest.mark.parametrize(("homing", "answers"), [("switches", 0), ("by hand", 0), ("by hand", 1)])
def test_after_a_no_the_stage_stays_where_it_is(practice: Path, monkeypatch, homing: str, answers: int) -> None:
    """Also where its position is known from before, and beyond clear_mm."""
    changed(practice, "rig.toml", ('homing = "switches"', f'homing = "{homing}"'))
    moved, asked = [], []

    class Refusing(Hands):
        def allows(self, question: str) -> bool:
            asked.append(question)
            return len(asked) <= answers

    stages = []

    def watched(opened: OpenTactileRig) -> OpenTactileRig:
        stage = opened.stage
        stage.is_known = answers == 0
        stage.state.counted_mm["Z"] = -3.0
        stages.append(stage)
        moves = {name: lambda *_: moved.append("moved") for name in ("move", "home", "stop")}
        return replace(opened, stage=Wrapped(stage, **moves), operator=Refusing())

    lying(monkeypatch, watched)
    report, status = checked(practice)
    assert (moved, status, len(asked)) == ([], 1, answers + 1)
    assert stages[0].is_known == (answers == 0)
    assert "nobody has" in named(report, "stage moves").evidence


def test_the_force_limit_of_the_plan_holds_while_homing_too(practice: Path, monkeypatch) -> None:
    changed(practice, "check.toml", ("stops = 1", "stops = 1\nforce_limit_n = 0.6"))
    in_the_way_n, went_on = [0.0], []

    def blocked(opened: OpenTactileRig) -> OpenTactileRig:
        stage, cell = opened.stage, opened.load_cell

        def home(deadline_s: float, watch: Callable[[], None]) -> None:
            in_the_way_n[0] = 1.0
            for _ in range(3):
                watch()
            went_on.append("homing went on")

        def read(deadline_s: float) -> CellReading:
            true = cell.read(deadline_s)
            return true._replace(counts=true.counts + round(in_the_way_n[0] / 4.7e-6))

        return replace(opened, stage=Wrapped(stage, home=home), load_cell=Wrapped(cell, read=read))

    lying(monkeypatch, blocked)
    report, _ = checked(practice)
    assert went_on == []
    assert "beyond the limit of 0.6 N" in named(report, "stage moves").evidence


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("position_mm = 8.0", "position_mm = 79.0", r"lead to X = 81 mm, outside the stage's travel of 0 to 80 mm"),
        (
            "stops = 1",
            "force_limit_n = 6.0",
            r"plan\.force_limit_n = 6 N must not exceed force_limit_n = 5 N of the rig file",
        ),
        ("stops = 1", "stop = 1", r"'stop': unknown key; did you mean 'stops'"),
        ("rest_s = 10.0", "rest_s = 1.0", r"'rest_s' \(in s\): must be at least 10"),
        ('check_name = "practice finger"', 'check_name = ""', r"check_name"),
    ],
)
def test_mistakes_are_one_line_and_nothing_moves(practice: Path, old: str, new: str, message: str) -> None:
    changed(practice, "check.toml", (old, new))
    outcome = finray(f"check run {practice}/check.toml --rig {practice}/rig.toml --out {practice}/out")
    assert (outcome.status, outcome.err.count("\n")) == (2, 1)
    assert re.search(message, outcome.err), outcome.err
    assert not (practice / "out").exists()


BENCH_PLAN = TactileCheckPlan(
    check_name="boards", position_mm=8.0, returns=4, stops=1, rest_s=10.0, deepest_mm=1.3, force_limit_n=3.0
)


def patient_rig(folder: Path, bench: PressBench) -> TactileRig:
    """Return the rig of both boards, which waits so long for a reading that other work on this computer is no fault."""
    rig = real_rig(folder, bench)
    return rig.model_copy(update={"load_cell": rig.load_cell.model_copy(update={"silent_s": 0.8})})


def on_boards(folder: Path, bench, monkeypatch, **given: object) -> tuple[PressFacts, TactileRig]:
    from contextlib import nullcontext

    monkeypatch.setattr("rigs.capture._force_gauge.open_camera", lambda *_: nullcontext(FlatCamera()))
    rig = patient_rig(folder, bench)
    # so short that a move may be three steps long between the turning force and the stop
    rig = rig.model_copy(update={"stage": rig.stage.model_copy(update={"step_mm": 0.05})})
    plan = BENCH_PLAN.model_copy(update=given)
    return record_press_facts(rig, plan, folder, operator=Hands()), rig


@pytest.mark.rigs
def test_boards_in_real_time(tmp_path: Path, monkeypatch) -> None:
    with press_bench(tmp_path) as bench:
        facts, rig = on_boards(tmp_path, bench, monkeypatch)
        assert bench.strongest_n < BENCH_PLAN.force_limit_n
        assert bench.force_n == 0.0
    assert facts.errors == {}
    report = judge_pressing(facts, BENCH_PLAN, rig)
    verdicts = {r.name: r.verdict for r in report.results}
    for name in ("position survives stops", "load cell is quiet"):
        assert verdicts[name] == "PASS", (name, [r.evidence for r in report.results if r.name == name])
    # a camera that sees noise is no witness of the pad axis, and four returns are too few
    assert verdicts["X moves in time"] == verdicts["Z moves in time"] == verdicts["touch repeats"] == "UNDECIDED"
    (moving,) = (one.moving for one in facts.force_stops)
    assert moving.limit_n < moving.peak_n < moving.unstopped_n


# each takes a minute or two on boards in real time: every fault in two or three parts, and every part at least once
POISONED = (
    ("cell pulled", "load cell"),
    ("cell pulled", "touch"),
    ("cell pulled", "force limit"),
    ("stage reset", "stage"),
    ("stage reset", "touch"),
    ("stage reset", "stops"),
    ("stage pulled", "force limit"),
    ("stage pulled", "stops"),
)


@pytest.mark.rigs
@pytest.mark.parametrize(("what", "part"), POISONED)
def test_poisoned_in_the_middle_of_a_part(tmp_path: Path, monkeypatch, part: str, what: str) -> None:
    """Whatever breaks, and whenever: the stage stands afterwards, and where its place is known it has left the pad."""
    with press_bench(tmp_path) as bench:
        began, begun = threading.Event(), list[bool]()

        def spoil() -> None:
            begun.append(began.wait(600.0))
            time.sleep(0.7 if part != "load cell" else 2.0)
            if what == "cell pulled":
                bench.amplifier.port.pull()
            elif what == "stage reset":
                bench.controller.reset()
                bench.controller.at_mm = dict.fromkeys("XYZ", 0.0) | {"Z": bench.controller.at_mm["Z"]}
            else:
                bench.controller.port.pull()
                time.sleep(1.0)
                bench.controller.port.plug()

        thread = threading.Thread(target=spoil)
        thread.start()
        from contextlib import nullcontext

        monkeypatch.setattr("rigs.capture._force_gauge.open_camera", lambda *_: nullcontext(FlatCamera()))
        rig = patient_rig(tmp_path, bench)

        def progress(done: int, total: int, text: str) -> None:
            if text == part:
                began.set()

        facts = record_press_facts(rig, BENCH_PLAN, tmp_path, progress, operator=Hands())
        thread.join()
        assert begun == [True]
        assert bench.rests
        assert bench.strongest_n < BENCH_PLAN.force_limit_n
        if what == "cell pulled":
            assert bench.force_n == 0.0
        assert facts.errors
        report = judge_pressing(facts, BENCH_PLAN, rig)
        assert report.verdict in ("ERROR", "FAIL")


def test_a_dent_is_seen_at_the_same_column_in_rgb_pictures() -> None:
    """A camera behind MJPEG sends three values a pixel; a dent that turns red into blue must not cancel."""
    before, during = 100.0 + np.random.default_rng(3).standard_normal((2, 4, 96, 128, 3))
    during[:, :, 56:74] += np.array([30.0, 0.0, -30.0])
    bayer = [frames[..., 0] for frames in (before, during)]
    # the dent is drawn around column 65; noise and the soft window move its centre by less than 0.2 px
    assert dent_column_px(*bayer) == pytest.approx(65.0, abs=0.2)
    assert dent_column_px(before, during) == pytest.approx(65.0, abs=0.2)
    assert dent_column_px(before, before[::-1]) is None
    repeated = during.copy()
    repeated[1] = repeated[0]
    assert dent_column_px(before, repeated) is None
