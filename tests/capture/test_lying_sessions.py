"""Camera and tactile sessions, and check runs, beside devices that answer correctly and lie.

Each frame carries what was true while it was exposed. No frame is wrong in a finished record, and a session that ends
goes on by one resumption. Paint sessions: tests/capture/test_lying_devices.py.
"""

import errno
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import pytest

from data_schemas import (
    CameraPlan,
    CameraSession,
    CaptureError,
    PlannedPress,
    TactilePlan,
    TactileRig,
    TactileSession,
    provenance,
)
from data_schemas.storage import write_record
from rigs import RawFrame, open_rig, paint_plan, simulated_rig, tactile_rig
from rigs.capture import (
    SessionRequest,
    _frame_store,
    _tactile_session,
    capture_tactile_session,
    read_interrupted,
    read_interrupted_presses,
)
from rigs.capture._camera_session import camera_step, capture_camera_with
from rigs.simulated import FingerCamera, SimulatedStage
from tests.capture.finger_session import Hands
from tests.capture.test_lying_devices import LyingCamera, LyingWheel
from tests.capture.test_stage_press import exact_calibration

PLAN = CameraPlan(
    camera_name="demo", filter_name="532", levels=10, frames_per_level=2, repeats=2,
    region=paint_plan("red", simulated_rig("red", width_px=64, height_px=64).camera).region,
)  # fmt: skip
BEGINNINGS = (6, 20, 50, 70, 100)
"""From metering to the last dark frame. Before the first bright frame of the metering, nothing shows a halved exposure:
all of the session is then as it would be at twice the light."""


@dataclass
class JumpingClock:
    """A clock of the computer that is set forward and back by an hour, again and again."""

    clock: Any
    reads: int = 0

    def utc(self) -> str:
        self.reads += 1
        jump = timedelta(hours=(self.reads // 5) % 3 - 1)
        return (datetime.fromisoformat(self.clock.utc()).astimezone(UTC) + jump).isoformat(timespec="milliseconds")

    def monotonic_s(self) -> float:
        return float(self.clock.monotonic_s())

    def sleep(self, duration_s: float) -> None:
        self.clock.sleep(duration_s)


def full_disk(monkeypatch: pytest.MonkeyPatch, module: Any, full_at: int, frames: int) -> None:
    """Have the disk full for some frames, and free again."""
    write, written = module.write_frame, [0]

    def full(*given: object) -> str:
        written[0] += 1
        if full_at <= written[0] < full_at + frames:
            raise OSError(errno.ENOSPC, "No space left on device")
        return str(write(*given))

    monkeypatch.setattr(module, "write_frame", full)


def camera_session(kind: str, begins: int, out: Path) -> tuple[CameraSession, list[str]]:
    """Capture beside a device that lies until a person restarts it."""
    rig, interrupted, resumes = simulated_rig("red", width_px=64, height_px=64), None, list[str]()
    for _ in range(3):
        with open_rig(rig, Path()) as opened:
            lie = kind if interrupted is None else ""
            lying = replace(
                opened,
                camera=LyingCamera(opened, lie, begins),
                wheel=LyingWheel(opened, lie, begins),
                clock=JumpingClock(opened.clock) if kind == "a clock that jumps" else opened.clock,
            )
            request = SessionRequest(out, "pytest")
            try:
                step = camera_step(PLAN, rig)
                return capture_camera_with(lying, rig, PLAN, step, request, interrupted=interrupted), resumes
            except CaptureError as error:
                resumes.append(str(error))
                interrupted = read_interrupted(out)
    raise AssertionError(resumes)


def wrong_flats(session: CameraSession) -> list[str]:
    return [
        f"{frame.sequence} {frame.light} {frame.exposure_s} {frame.settings}"
        for frame in session.frames
        if frame.settings["true_exposure_s"] != pytest.approx(frame.exposure_s)
        or frame.settings["true_lamp"] != (frame.light == "lamp")
        or frame.settings["true_slot"] != frame.slot_before
    ]


@pytest.mark.parametrize("kind", ["late frames", "brown-out", "an old frame", "late answers", "a clock that jumps"])
@pytest.mark.parametrize("begins", BEGINNINGS)
def test_a_camera_session_beside_a_device_that_lies(tmp_path: Path, kind: str, begins: int) -> None:
    session, resumes = camera_session(kind, begins, tmp_path / "s")
    assert wrong_flats(session) == []
    assert len(resumes) <= 1, resumes
    assert [frame.sequence for frame in session.frames] == list(range(len(session.frames)))


def test_a_disk_that_was_full_and_is_free_again_loses_no_flat_frame(tmp_path: Path, monkeypatch) -> None:
    full_disk(monkeypatch, _frame_store, 8, 2)
    session, resumes = camera_session("", 0, tmp_path / "s")
    assert wrong_flats(session) == []
    assert len(resumes) == 1


TACTILE = TactilePlan.model_validate(
    {
        "name": "x", "design": "x", "exposures_s": [0.005, 0.01], "led_current_ma": 20.0, "light_angle_deg": 30.0,
        "light_angle_uncertainty_deg": 0.5, "indenter": {"shape": "ball", "radius_mm": 4.0},
        "presses": [
            {"depth_mm": 0.3, "position_mm": at_mm, "depth_uncertainty_mm": 0.02, "position_uncertainty_mm": 0.1}
            for at_mm in (6.0, 8.0)
        ],
    }
)  # fmt: skip


class Lies:
    """What the camera of the finger does from one exposure on, until it is restarted."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, kind: str, begins: int) -> None:
        self.kind, self.begins, self.taken, self.before = kind, begins, 0, None
        expose = FingerCamera.expose

        def lying(camera: FingerCamera, exposure_s: float, deadline_s: float) -> RawFrame:
            self.taken += 1
            lies = self.taken >= self.begins if kind != "an old frame" else self.taken == self.begins
            truly_s = 0.5 * exposure_s if lies and self.kind == "brown-out" else exposure_s
            raw = expose(camera, truly_s, deadline_s)
            true = {"true_exposure_s": truly_s, "true_depth_mm": camera.state.indentation_mm}
            settings = {**raw.settings, **true}
            now = replace(raw, exposure_requested_s=exposure_s, exposure_s=exposure_s, frame_id=self.taken)
            now = replace(now, settings=settings)
            before, self.before = self.before, now
            if lies and before is not None and self.kind in ("late frames", "an old frame"):
                return replace(now, counts=before.counts, settings=before.settings)
            return now

        monkeypatch.setattr(FingerCamera, "expose", lying)


def finger(folder: Path) -> TactileRig:
    rig = tactile_rig(simulated=True)
    write_record(exact_calibration(rig), folder / "load-cell.json", provenance("pytest"))
    return rig


def tactile_session(folder: Path, lies: Lies | None = None) -> tuple[TactileSession, list[str]]:
    """Capture by a stage until it is done; a person restarts the camera before a resumption."""
    rig, interrupted, resumes = finger(folder), None, list[str]()
    presses: tuple[PlannedPress, ...] = TACTILE.presses
    for _ in range(4):
        request = SessionRequest(folder / "s", "pytest", rig_folder=folder, operator=Allowing())
        try:
            return capture_tactile_session(rig, TACTILE, presses, request, interrupted=interrupted), resumes
        except CaptureError as error:
            resumes.append(str(error))
            interrupted = read_interrupted_presses(folder / "s")
            if lies is not None:
                lies.kind = ""
    raise AssertionError(resumes)


class Allowing(Hands):
    def allows(self, question: str) -> bool:
        return True


def wrong_presses(session: TactileSession) -> list[str]:
    return [
        f"{frame.sequence} {frame.frame_type} {frame.settings}"
        for frame in session.frames
        if frame.settings["true_exposure_s"] != pytest.approx(frame.exposure_s)
        or (frame.settings["true_depth_mm"] > 0.0) != (frame.frame_type == "contact")
    ]


@pytest.mark.parametrize("kind", ["late frames", "brown-out", "an old frame"])
@pytest.mark.parametrize("begins", [3, 4, 6, 9])
def test_a_tactile_session_beside_a_camera_that_lies(tmp_path: Path, monkeypatch, kind: str, begins: int) -> None:
    """Frames: 2 of no contact, 2 of the contact, 2 of no contact and so on."""
    session, resumes = tactile_session(tmp_path, Lies(monkeypatch, kind, begins))
    assert wrong_presses(session) == []
    assert len(resumes) <= (kind == "brown-out"), resumes
    assert {press.contact for press in session.measured} == {1, 2}


def test_a_disk_that_was_full_and_is_free_again_loses_no_contact(tmp_path: Path, monkeypatch) -> None:
    Lies(monkeypatch, "", 0)
    full_disk(monkeypatch, _tactile_session, 4, 1)
    session, resumes = tactile_session(tmp_path)
    assert wrong_presses(session) == []
    assert len(resumes) == 1


@pytest.mark.parametrize("moves_not_made", [1, 2])
def test_a_stage_that_reports_success_before_it_moved_makes_no_wrong_press(
    tmp_path: Path, monkeypatch, moves_not_made: int
) -> None:
    """Some moves are made only when the next one is asked for: force and depth of the record are those of the pad."""
    Lies(monkeypatch, "", 0)
    move, waiting, count = SimulatedStage.move, list[Any](), [0]

    def late(stage: SimulatedStage, *given: Any) -> None:
        count[0] += 1
        for made in waiting:
            move(stage, *made)
        waiting.clear()
        if count[0] % 37 < moves_not_made:
            waiting.append(given)
        else:
            move(stage, *given)

    monkeypatch.setattr(SimulatedStage, "move", late)
    session, resumes = tactile_session(tmp_path)
    assert wrong_presses(session) == []
    assert len(resumes) <= 1, resumes
