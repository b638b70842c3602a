"""Faults in the middle of a session: lights go off, nothing that was captured is lost, the session can be resumed."""

import errno
import os
import signal
import threading
import time
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, field, replace
from datetime import date, datetime, timedelta
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from data_schemas import (
    BadFrameError,
    CaptureError,
    CaptureSession,
    DeviceIdentity,
    FilterWheelSettings,
    LostError,
    OutsideLayer,
    PaintPlan,
    RefusedError,
    RigFile,
    SaturatedError,
    TimedOutError,
)
from data_schemas.storage import sha256_of
from rigs import Camera, Clock, FilterWheel, Light, OpenRig, Operator, RawFrame, open_laser, open_rig
from rigs.capture import Interrupted, SessionRequest, forecast, paint_steps, read_interrupted, read_session
from rigs.capture import _exposure as exchange
from rigs.capture import _frame_store as frame_store
from rigs.capture._journal import HealingTimeError, read_journal
from rigs.capture._paint_session import capture_with
from rigs.filter_wheels.thorlabs import open_wheel
from rigs.light_guard import GuardedLight, LightLostError
from rigs.transports import Fault, report_fault
from tests.capture.drivers import file_switch
from tests.capture.drivers.thorlabs_wheel import EmulatedWheel, emulated_wheel

FRAMES_BEFORE = 12
"""Of about 30: the white tile is done, the sample has begun."""


@pytest.fixture(scope="module")
def small(plan: PaintPlan) -> PaintPlan:
    changed = {"filters": ("450", "532", "600"), "bracket": (1.0,), "darks_per_exposure": 1}
    return plan.model_copy(update=changed)


def capture(
    opened: OpenRig, rig: RigFile, plan: PaintPlan, out: Path, interrupted: Interrupted | None = None
) -> CaptureSession:
    return capture_with(
        opened, rig, plan, paint_steps(plan, rig), SessionRequest(out, "finray capture"), interrupted=interrupted
    )


def dark(opened: OpenRig) -> bool:
    return not (opened.lamp.state() or opened.laser.state())


@dataclass
class TurningBench:
    """A real wheel that turns the simulated bench with it; something happens after so many moves."""

    wheel: FilterWheel
    bench: FilterWheel
    moves: int = 0
    at_move: dict[int, Any] = field(default_factory=dict)

    @property
    def slots(self) -> tuple[int, ...]:
        return self.wheel.slots

    def identity(self) -> DeviceIdentity:
        return self.wheel.identity()

    def position(self) -> int | None:
        if self.bench.position() is None:
            return None  # swung out
        return self.wheel.position()

    def go_to(self, slot: int, deadline_s: float) -> None:
        self.moves += 1
        self.at_move.get(self.moves, lambda: None)()
        self.wheel.go_to(slot, deadline_s)
        self.bench.go_to(slot, deadline_s)


@pytest.fixture(scope="module")
def device() -> Iterator[EmulatedWheel]:
    with emulated_wheel() as wheel:
        yield wheel


@pytest.mark.rigs
@pytest.mark.parametrize(
    ("fault", "error", "message"),
    [
        ({"stuck": True}, TimedOutError, "did not reach slot . within 3 s"),
        ({"slip": 1}, TimedOutError, "its last report is slot"),  # sent again, it falls back to where it rests
        ({"mute": True}, TimedOutError, "did not answer within"),
        ({"garble": True}, LostError, "attempts at"),
    ],
    ids=["stuck", "lost step", "mute", "garbled"],
)
def test_wheel_that_fails_ends_in_the_dark_and_the_session_goes_on_later(
    rig: RigFile,
    small: PaintPlan,
    tmp_path: Path,
    device: EmulatedWheel,
    monkeypatch: pytest.MonkeyPatch,
    fault: dict[str, object],
    error: type[CaptureError],
    message: str,
) -> None:
    """The wheel is lewis' FW212C; it fails at the tenth move, when metering is done and frames are being stored."""
    monkeypatch.setattr(exchange, "WHEEL_DEADLINE_S", 3.0)  # longer than a wheel may rest on its way
    device.reset()
    settings = FilterWheelSettings(driver="thorlabs", address=device.address, filters=rig.filter_wheel.filters)
    with open_rig(rig, Path()) as opened, open_wheel(settings, opened.operator) as wheel:
        turning = TurningBench(wheel, opened.wheel, at_move={10: lambda: device.control.put(**fault)})
        with pytest.raises(error, match=message):
            capture(replace(opened, wheel=turning), rig, small, tmp_path / "out")
        assert dark(opened)
    stored = {path: sha256_of(path) for path in (tmp_path / "out" / "frames").iterdir()}
    assert stored
    device.reset()
    with open_rig(rig, Path()) as opened, open_wheel(settings, opened.operator) as wheel:
        mended = replace(opened, wheel=TurningBench(wheel, opened.wheel))
        session = capture(mended, rig, small, tmp_path / "out", read_interrupted(tmp_path / "out"))
        assert dark(opened)
    assert all(sha256_of(path) == digest for path, digest in stored.items())
    assert read_session(tmp_path / "out").frames == session.frames
    assert any("resumed" in note for note in session.notes)


@dataclass
class ChangedCamera:
    """A camera whose frames are changed from a number on."""

    camera: Camera
    change: Any
    taken: int = 0

    def identity(self) -> DeviceIdentity:
        return self.camera.identity()

    def expose(self, exposure_s: float, deadline_s: float) -> RawFrame:
        self.taken += 1
        return self.change(self.taken, self.camera.expose(exposure_s, deadline_s))


def test_frame_unlike_its_metering_is_not_stored_and_is_taken_again(
    rig: RigFile, small: PaintPlan, tmp_path: Path
) -> None:
    """The lamp fails by a third while frames are stored: the frame that shows it must not be in the resumed session."""

    def dimmed(number: int, raw: RawFrame) -> RawFrame:
        signal = raw.counts.astype(float) - rig.camera.black_level_dn
        counts = (rig.camera.black_level_dn + 0.67 * signal).clip(0).astype(np.uint16)
        return replace(raw, counts=counts) if len(list(tmp_path.glob("frames/*.tiff"))) >= FRAMES_BEFORE else raw

    with open_rig(rig, Path()) as opened:
        failing = replace(opened, camera=ChangedCamera(opened.camera, dimmed))
        with pytest.raises(
            CaptureError, match=r"DN/s in .* at metering, .* correct the cause, then continue or resume"
        ):
            capture(failing, rig, small, tmp_path)
        assert dark(opened)
    before = set(read_interrupted(tmp_path).frames)
    with open_rig(rig, Path()) as opened:
        session = capture(opened, rig, small, tmp_path, read_interrupted(tmp_path))
    assert before < {frame.sequence for frame in session.frames}
    # at most one good frame whose line was not written yet, the one after the last line; no dimmed one
    aside = [int(path.name.split("_")[1]) for path in tmp_path.glob("set-aside/*")]
    assert aside in ([], [max(before) + 1])
    assert all(sequence < FRAMES_BEFORE for sequence in aside)
    (proven,) = [line for line in read_journal(tmp_path) if line["event"] == "as before"]
    assert proven["frames"] == len(before)


@pytest.mark.parametrize("ending", [RefusedError("camera: unplugged"), KeyboardInterrupt()])
def test_frame_that_could_not_be_written_is_told_beside_what_ended_the_capture(
    rig: RigFile, small: PaintPlan, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, ending: BaseException
) -> None:
    """The disk fills up while the camera fails: the frames that are waiting to be written are lost too."""
    opening_gate = threading.Event()

    def full(path: Path, counts: np.ndarray, title: str) -> str:
        opening_gate.wait(10.0)
        raise OSError(errno.ENOSPC, "No space left on device")

    def fails(number: int, raw: RawFrame) -> RawFrame:
        if waiting:
            opening_gate.set()
            raise ending
        return raw

    waiting: list[object] = []
    monkeypatch.setattr(frame_store, "write_frame", full)
    take = frame_store.FrameStore.take
    monkeypatch.setattr(frame_store.FrameStore, "take", lambda *given: (take(*given), waiting.append(given)))
    with open_rig(rig, Path()) as opened:
        broken = replace(opened, camera=ChangedCamera(opened.camera, fails))
        with pytest.raises(type(ending)) as caught:
            capture(broken, rig, small, tmp_path)
        assert dark(opened)
    told = " ".join([str(caught.value), *getattr(caught.value, "__notes__", ())])
    assert "cannot be written (No space left on device); free space" in told
    assert str(ending) in told


def test_disk_that_hangs_ends_the_session_in_the_dark_and_it_can_be_resumed(
    rig: RigFile, small: PaintPlan, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A frame of the laser is neither taken nor refused by the disk: the laser must not wait for it."""
    back, written, lit = threading.Event(), threading.Event(), []
    write = frame_store.write_frame

    def hangs(path: Path, counts: np.ndarray, title: str) -> str:
        if "fluorescence" in path.name:
            lit.append(opened.laser.state())
            back.wait(30.0)
        try:
            return write(path, counts, title)
        finally:
            if "fluorescence" in path.name:
                written.set()

    with open_rig(rig, Path()) as opened, monkeypatch.context() as patch:
        patch.setattr(frame_store, "write_frame", hangs)
        patch.setattr(frame_store, "WRITE_WITHIN_S", 0.3)
        try:
            with pytest.raises(CaptureError, match=r"the disk does not respond .nothing was written .*--resume"):
                capture(opened, rig, small, tmp_path)
            assert dark(opened)
            assert lit == [True]
        finally:
            back.set()
            assert written.wait(10.0)
    with open_rig(rig, Path()) as opened:
        session = capture(opened, rig, small, tmp_path, read_interrupted(tmp_path))
    assert read_session(tmp_path).frames == session.frames


def test_camera_without_colours_is_noted(rig: RigFile, small: PaintPlan, tmp_path: Path) -> None:
    def mono(number: int, raw: RawFrame) -> RawFrame:
        return replace(raw, settings={"pixel_format": "Mono16"})

    with open_rig(rig, Path()) as opened:
        session = capture(replace(opened, camera=ChangedCamera(opened.camera, mono)), rig, small, tmp_path)
    (note,) = [note for note in session.notes if note not in opened.notes]
    assert "its frames are Mono16, but radiometry reads them as Bayer RGGB" in note


def test_saturated_pixels_are_exposed_again_shorter_and_flagged(rig: RigFile, small: PaintPlan, tmp_path: Path) -> None:
    """One pixel in 500 clips in exposures above 20 ms; a hot one clips in every stored frame."""
    full_dn = 2**rig.camera.bit_depth - 1

    def clipped(number: int, raw: RawFrame) -> RawFrame:
        counts = raw.counts.copy()
        if raw.exposure_s > 0.02:
            counts.flat[::499] = full_dn
        if (tmp_path / "frames").exists():
            region = small.region
            counts[region.row_px, region.column_px] = full_dn
        return replace(raw, counts=counts)

    with open_rig(rig, Path()) as opened:
        session = capture(replace(opened, camera=ChangedCamera(opened.camera, clipped)), rig, small, tmp_path)
    lit = [frame for frame in session.frames if frame.light in ("lamp", "laser")]
    assert max(frame.exposure_s for frame in lit) <= 0.02
    pixels = small.region.height_px * small.region.width_px
    # the first frame is on its way to the disk while the folder of the frames comes into being
    flagged = [frame.saturated_fraction for frame in session.frames[2:]]
    assert flagged == pytest.approx([1 / pixels] * len(flagged))


def test_camera_that_always_saturates_ends_the_session(rig: RigFile, small: PaintPlan, tmp_path: Path) -> None:
    def white(number: int, raw: RawFrame) -> RawFrame:
        return replace(raw, counts=np.full_like(raw.counts, 2**rig.camera.bit_depth - 1))

    with open_rig(rig, Path()) as opened:
        with pytest.raises(SaturatedError):
            capture(replace(opened, camera=ChangedCamera(opened.camera, white)), rig, small, tmp_path)
        assert dark(opened)


STEPS_AT_LINE = 20  # of the journal, which has about 30 when the camera fails


@dataclass
class SteppingClock:
    """A host whose time of day is put right, or wrong, while the monotonic clock runs on."""

    clock: Clock
    step_s: float
    asked: int = 0

    def utc(self) -> str:
        self.asked += 1
        stepped_s = self.step_s if self.asked > STEPS_AT_LINE else 0.0
        return (datetime.fromisoformat(self.clock.utc()) + timedelta(seconds=stepped_s)).isoformat()

    def monotonic_s(self) -> float:
        return self.clock.monotonic_s()


@pytest.mark.parametrize("step_s", [-86400.0, 86400.0])
def test_order_of_frames_survives_a_step_of_the_clock(
    rig: RigFile, small: PaintPlan, tmp_path: Path, step_s: float
) -> None:
    """The time of day steps by a day in the session, and back before it is resumed."""

    def lost(number: int, raw: RawFrame) -> RawFrame:
        if len(list(tmp_path.glob("frames/*.tiff"))) >= FRAMES_BEFORE:
            raise RefusedError("camera: unplugged")
        return raw

    with open_rig(rig, Path()) as opened:
        clock = SteppingClock(opened.clock, step_s)
        stepping = replace(opened, clock=clock, camera=ChangedCamera(opened.camera, lost))
        with pytest.raises(RefusedError, match="unplugged"):
            capture(stepping, rig, small, tmp_path)
    assert clock.asked > STEPS_AT_LINE + 5  # the step lies within
    with open_rig(rig, Path()) as opened:
        session = capture(opened, rig, small, tmp_path, read_interrupted(tmp_path))
    middles_s = [frame.middle_s for frame in session.frames]
    assert middles_s == sorted(middles_s)
    assert len(set(middles_s)) == len(middles_s)
    doses_j = [frame.laser_dose_j for frame in session.frames]
    assert doses_j == sorted(doses_j)


def test_sample_that_may_be_tilted_is_turned_back_at_a_resumption(
    rig: RigFile, small: PaintPlan, tmp_path: Path
) -> None:
    """Metering begins with the tilted sample; what an interruption then left behind, nobody knows."""
    tilted = small.model_copy(update={"second_tilt_deg": 30.0, "second_tilt_filters": ("532", "600")})
    steps = paint_steps(tilted, rig)
    asked: list[float] = []

    def lost(number: int, raw: RawFrame) -> RawFrame:
        if (tmp_path / "journal.jsonl").read_text().count('"label": "tilted') == len(tilted.second_tilt_filters or ()):
            raise RefusedError("camera: unplugged")
        return raw

    with open_rig(rig, Path()) as opened:
        broken = replace(opened, camera=ChangedCamera(opened.camera, lost))
        with pytest.raises(RefusedError, match="unplugged"):
            capture_with(broken, rig, tilted, steps, SessionRequest(tmp_path, "finray capture"))

    @dataclass
    class Hands:
        hands: Any

        def __getattr__(self, name: str) -> Any:
            return getattr(self.hands, name)

        def tilt(self, angle_deg: float) -> None:
            asked.append(angle_deg)
            self.hands.tilt(angle_deg)

    with open_rig(rig, Path()) as opened:
        hands = replace(opened, operator=Hands(opened.operator))
        capture_with(
            hands,
            rig,
            tilted,
            steps,
            SessionRequest(tmp_path, "finray capture"),
            interrupted=read_interrupted(tmp_path),
        )
    assert asked == [0.0, 30.0]  # upright for what is left of metering, tilted for the last frames


@dataclass
class FailingLight:
    """A light that is lost when it is asked for the so-many-th time while it is lit, and then as often again."""

    light: Light
    at_questions: tuple[int, ...]
    asked: int = 0

    def identity(self) -> DeviceIdentity:
        return self.light.identity()

    def state(self) -> bool:
        if self.light.state():
            self.asked += 1
            if self.asked in self.at_questions:
                raise LightLostError("lamp: the guard process has ended; confirmed off")
        return self.light.state()

    def lit(self) -> AbstractContextManager[None]:
        return self.light.lit()


def test_light_that_is_lost_is_lit_anew_and_the_frame_redone(
    rig: RigFile, small: PaintPlan, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(exchange, "RELIGHT_PAUSE_S", 0.0)
    with open_rig(rig, Path()) as opened:
        failing = replace(opened, lamp=FailingLight(opened.lamp, (7, 30)), laser=FailingLight(opened.laser, (20,)))
        session = capture(failing, rig, small, tmp_path)
        assert dark(opened)
    whole = {frame.sequence for frame in session.frames}
    assert whole == set(range(len(session.frames)))
    assert all(frame.lights_before == frame.lights_after for frame in session.frames)
    doses = [frame.laser_dose_j for frame in session.frames]
    assert doses == sorted(doses)
    lost = [line for line in read_journal(tmp_path) if line["event"] == "light lost"]
    assert len(lost) == 3
    assert any("a light went off or stopped answering, number of times: 3" in note for note in session.notes)


@dataclass
class Asked:
    """The bench's operator, who answers when a lost light may be lit again."""

    hands: Operator
    answer: bool
    questions: list[str] = field(default_factory=list)

    def __getattr__(self, name: str) -> Any:
        return getattr(self.hands, name)

    def allows(self, question: str) -> bool:
        self.questions.append(question)
        return self.answer


@pytest.mark.parametrize("hazard", ["3R", "3B", "4"])
def test_a_hazardous_laser_that_was_lost_stays_dark_until_a_person_allows_it(
    rig: RigFile, small: PaintPlan, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, hazard: str
) -> None:
    monkeypatch.setattr(exchange, "RELIGHT_PAUSE_S", 0.0)
    hazardous = rig.model_copy(update={"laser": rig.laser.model_copy(update={"laser_class": hazard})})

    message = (
        r"laser: went off or stopped answering \(.*\)\. It is off now, and is lit again only if a person"
        r".*close the box, then continue .* --resume"
    )
    with open_rig(hazardous, Path()) as opened:
        operator, laser = Asked(opened.operator, False), FailingLight(opened.laser, (8,))
        with pytest.raises(LightLostError, match=message):
            capture(replace(opened, laser=laser, operator=operator), hazardous, small, tmp_path)
        assert dark(opened)
    assert len(operator.questions) == 1
    assert laser.asked == 8  # never lit after the loss
    with open_rig(hazardous, Path()) as opened:
        operator, laser = Asked(opened.operator, False), FailingLight(opened.laser, ())
        with pytest.raises(
            LightLostError, match=r"stopped answering in this session.*run the same command in a terminal"
        ):
            capture(
                replace(opened, laser=laser, operator=operator), hazardous, small, tmp_path, read_interrupted(tmp_path)
            )
    assert (len(operator.questions), laser.asked) == (1, 0)  # taking it up again needs a person, too
    with open_rig(hazardous, Path()) as opened:
        operator, laser = Asked(opened.operator, True), FailingLight(opened.laser, (8,))
        failing = replace(opened, laser=laser, operator=operator)
        capture(failing, hazardous, small, tmp_path, read_interrupted(tmp_path))
        assert dark(opened)
    assert len(operator.questions) == 2
    assert "stopped answering before this session ended" in operator.questions[0]
    assert "was the box opened?" in operator.questions[1]
    assert laser.asked > 8


@dataclass
class GuardedBenchLaser:
    """A real light behind a real guard, and the bench's laser with it."""

    guarded: GuardedLight
    bench: Light

    def identity(self) -> DeviceIdentity:
        return self.guarded.identity()

    def state(self) -> bool:
        return self.guarded.state()

    @contextmanager
    def lit(self) -> Iterator[None]:
        with self.guarded.lit(), self.bench.lit():
            yield


def test_a_guard_that_is_killed_leaves_a_hazardous_laser_dark_until_a_person_allows_it(
    rig: RigFile, small: PaintPlan, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The guard process is killed while the laser is on; the light itself, a file, tells what is true."""
    file_switch.install(monkeypatch)
    (light := tmp_path / "light").mkdir()
    day = date.today().isoformat()
    layer = OutsideLayer(kind="interlock", tested_on=day, test="a file, which harms nobody")
    update = {"driver": "indi", "address": str(light), "laser_class": "3B", "outside_layer": layer}
    settings = rig.laser.model_copy(update=update)
    hazardous = rig.model_copy(update={"laser": rig.laser.model_copy(update={"laser_class": "3B"})})
    was_on: list[bool] = []

    class Person(Asked):
        def allows(self, question: str) -> bool:
            was_on.append((light / "on").exists())
            return super().allows(question)

    with open_rig(rig, Path()) as opened, open_laser(settings) as guarded:
        first_guard = guarded.guard_pid

        def kill(number: int, raw: RawFrame) -> RawFrame:
            if (light / "on").exists() and guarded.guard_pid == first_guard:
                os.kill(first_guard, signal.SIGKILL)
            return raw

        person = Person(opened.operator, True)
        struck = replace(
            opened,
            laser=GuardedBenchLaser(guarded, opened.laser),
            camera=ChangedCamera(opened.camera, kill),
            operator=person,
        )
        session = capture(struck, hazardous, small, tmp_path / "session")
        assert not (light / "on").exists()
    assert was_on == [False]
    assert "the guard process has ended" in person.questions[0]
    assert any("a light went off or stopped answering, number of times: 1" in note for note in session.notes)


@pytest.mark.parametrize("hazard", ["1", "2", "2M"])
def test_a_harmless_laser_is_lit_anew_without_a_person(
    rig: RigFile, small: PaintPlan, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, hazard: str
) -> None:
    monkeypatch.setattr(exchange, "RELIGHT_PAUSE_S", 0.0)
    harmless = rig.model_copy(update={"laser": rig.laser.model_copy(update={"laser_class": hazard})})
    with open_rig(harmless, Path()) as opened:
        operator = Asked(opened.operator, False)
        lamp, laser = FailingLight(opened.lamp, (7,)), FailingLight(opened.laser, (8,))
        capture(replace(opened, lamp=lamp, laser=laser, operator=operator), harmless, small, tmp_path)
    assert operator.questions == []


def test_light_that_is_lost_again_and_again_ends_the_session(
    rig: RigFile, small: PaintPlan, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(exchange, "RELIGHT_PAUSE_S", 0.0)
    with open_rig(rig, Path()) as opened:
        failing = replace(opened, lamp=FailingLight(opened.lamp, tuple(range(1, 99))))
        with pytest.raises(LightLostError, match="the guard process has ended"):
            capture(failing, rig, small, tmp_path)
        assert dark(opened)
        assert failing.lamp.asked == exchange.RELIGHTS + 1


def test_faults_are_noted_and_told_at_the_end(rig: RigFile, small: PaintPlan, tmp_path: Path) -> None:
    """The wheel's driver repeats an exchange, and the camera delivers a frame that is taken again."""

    class Repeating(TurningBench):
        def go_to(self, slot: int, deadline_s: float) -> None:
            report_fault(Fault("filter wheel at /dev/ttyUSB0", "did not answer within 1 s", 1, 1.25))
            super().go_to(slot, deadline_s)

    def once(number: int, raw: RawFrame) -> RawFrame:
        if number == 20:
            raise BadFrameError("camera: torn")
        return raw

    with open_rig(rig, Path()) as opened:
        wheel = Repeating(opened.wheel, opened.wheel)
        session = capture(replace(opened, wheel=wheel, camera=ChangedCamera(opened.camera, once)), rig, small, tmp_path)
    faults = [line for line in read_journal(tmp_path) if line["event"] == "fault"]
    assert {line["what"] for line in faults} == {"did not answer within 1 s"}
    assert len(faults) == wheel.moves
    assert session.notes[-1] == (
        f"faults that did not stop the session: {wheel.moves} messages to devices were repeated "
        f"(filter wheel at /dev/ttyUSB0 {wheel.moves}), 1 frame was taken again; "
        f"journal.jsonl lists them ({1.25 * wheel.moves:.1f} s lost)"
    )


@pytest.mark.parametrize("kind", ["exchanges", "frames"])
def test_faults_that_cost_more_than_the_session_stated_end_it_in_the_dark(
    rig: RigFile, small: PaintPlan, tmp_path: Path, kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What was told before the start holds: plan and healing time, with one fault beyond it at the most."""
    stated = forecast(small, rig, paint_steps(small, rig))
    each_s, late_s = stated.healing_s / 5.5, 0.0
    monkeypatch.setattr("rigs.capture._journal.time", SimpleNamespace(monotonic=lambda: time.monotonic() + late_s))

    class Repeating(TurningBench):
        def go_to(self, slot: int, deadline_s: float) -> None:
            if kind == "exchanges":
                report_fault(Fault("filter wheel at /dev/ttyUSB0", "did not answer", 1, each_s))
            super().go_to(slot, deadline_s)

    def torn(number: int, raw: RawFrame) -> RawFrame:
        nonlocal late_s
        if kind == "frames" and number % 2:
            late_s += each_s
            raise BadFrameError("camera: torn")
        return raw

    with open_rig(rig, Path()) as opened:
        wheel = Repeating(opened.wheel, opened.wheel)
        failing = replace(opened, wheel=wheel, camera=ChangedCamera(opened.camera, torn))
        with pytest.raises(
            HealingTimeError,
            match=rf"at most {stated.healing_s:.0f} s are allowed; repair the device that journal\.jsonl names",
        ):
            capture(failing, rig, small, tmp_path)
        assert dark(opened)
    event = "fault" if kind == "exchanges" else "refused"
    assert sum(line["event"] == event for line in read_journal(tmp_path)) == 6
    with open_rig(rig, Path()) as opened:
        session = capture(opened, rig, small, tmp_path, read_interrupted(tmp_path))
    assert session.frames
