"""Frames that are refused and taken again, a bounded number of times."""

import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import pytest

from data_schemas import BadFrameError, DeviceIdentity, LostError, RefusedError, RigFile, TimedOutError
from rigs import Camera, OpenRig, RawFrame, SystemClock, open_rig
from rigs.capture._exposure import ATTEMPTS, CheckedCamera, NewFrames, within_attempts
from rigs.capture._journal import Journal, faults_noted
from rigs.capture._plan import Step

DARK = Step("dark", "white", "off", "450", 2)


@dataclass
class Changing:
    """A camera whose frames are changed, or withheld, by number."""

    camera: Camera
    change: Callable[[int, RawFrame], RawFrame]
    taken: int = 0

    def identity(self) -> DeviceIdentity:
        return self.camera.identity()

    def expose(self, exposure_s: float, deadline_s: float) -> RawFrame:
        frame = self.camera.expose(exposure_s, deadline_s)
        self.taken += 1
        return self.change(self.taken, frame)


@dataclass
class Taken:
    camera: CheckedCamera
    refused: list[str] = field(default_factory=list)


def over(rig: RigFile, opened: OpenRig, change: Callable[[int, RawFrame], RawFrame]) -> Taken:
    refused: list[str] = []
    changed = replace(opened, camera=Changing(opened.camera, change))
    return Taken(CheckedCamera(changed, rig.camera, refused.append), refused)


def fail_until(number: int, error: Exception) -> Callable[[int, RawFrame], RawFrame]:
    def change(taken: int, frame: RawFrame) -> RawFrame:
        if taken < number:
            raise error
        return frame

    return change


@pytest.mark.parametrize(
    "error", [BadFrameError("camera: missing packets"), LostError("camera: gone"), TimedOutError("camera: no frame")]
)
def test_refused_frame_is_taken_again_and_counted(rig: RigFile, error: Exception) -> None:
    with open_rig(rig, Path()) as opened:
        taken = over(rig, opened, fail_until(3, error))
        assert taken.camera.expose(DARK, 0.01).attempts == 3
    assert len(taken.refused) == 2
    assert all(str(error) in text for text in taken.refused)


def test_attempts_are_bounded(rig: RigFile) -> None:
    with open_rig(rig, Path()) as opened:
        taken = over(rig, opened, fail_until(99, BadFrameError("camera: missing packets")))
        with pytest.raises(BadFrameError, match=rf"missing packets \({ATTEMPTS} attempts at dark"):
            taken.camera.expose(DARK, 0.01)


def test_camera_that_is_late_every_time_is_lost(rig: RigFile) -> None:
    with open_rig(rig, Path()) as opened:
        taken = over(rig, opened, fail_until(99, TimedOutError("camera: no frame of 1 s came")))
        with pytest.raises(LostError, match=rf"no frame of 1 s came \({ATTEMPTS} attempts at dark"):
            taken.camera.expose(DARK, 0.01)
    assert len(taken.refused) == ATTEMPTS - 1


@pytest.mark.parametrize(
    "stale",
    [
        lambda n, f, first: replace(f, frame_id=7 if n < 3 else 8, device_time_s=1.0 if n < 3 else 2.0),
        lambda n, f, first: replace(f, device_time_s=1.0 if n < 3 else 2.0),
        lambda n, f, first: replace(f, counts=first) if n < 3 else f,
    ],
    ids=["same number", "same device time", "same payload"],
)
def test_frame_seen_before_is_refused(rig: RigFile, stale: Callable[[int, RawFrame, np.ndarray], RawFrame]) -> None:
    firsts: list[np.ndarray] = []

    def change(number: int, frame: RawFrame) -> RawFrame:
        firsts.append(frame.counts)
        return stale(number, frame, firsts[0])

    with open_rig(rig, Path()) as opened:
        taken = over(rig, opened, change)
        assert taken.camera.expose(DARK, 0.01).attempts == 1
        assert taken.camera.expose(DARK, 0.01).attempts == 2
    assert "the same frame twice" in taken.refused[0]


def test_number_that_wraps_and_constant_frames_are_no_repeats(rig: RigFile) -> None:
    def wraps(number: int, frame: RawFrame) -> RawFrame:
        return replace(frame, frame_id={1: 65535, 2: 1}[number])

    def constant(number: int, frame: RawFrame) -> RawFrame:
        return replace(frame, counts=np.full_like(frame.counts, 16))

    for change in (wraps, constant):
        with open_rig(rig, Path()) as opened:
            taken = over(rig, opened, change)
            assert [taken.camera.expose(DARK, 0.01).attempts for _ in range(2)] == [1, 1]


def test_frame_of_another_size_is_taken_again_and_refused_at_last(rig: RigFile) -> None:
    """A server that changes its resolution, or another program that cut the frame, may be right the next time."""

    def cut(until: int) -> Callable[[int, RawFrame], RawFrame]:
        return lambda number, frame: replace(frame, counts=frame.counts[:-2]) if number < until else frame

    with open_rig(rig, Path()) as opened:
        taken = over(rig, opened, cut(3))
        assert taken.camera.expose(DARK, 0.01).attempts == 3
        assert all("delivered a frame of" in text for text in taken.refused)
        message = rf"the rig file states .* px.*\({ATTEMPTS} attempts at dark"
        with pytest.raises(RefusedError, match=message):
            over(rig, opened, cut(99)).camera.expose(DARK, 0.01)


def test_colour_pictures_are_refused(rig: RigFile) -> None:
    def colour(number: int, frame: RawFrame) -> RawFrame:
        return replace(frame, counts=np.dstack([frame.counts] * 3))

    with open_rig(rig, Path()) as opened, pytest.raises(RefusedError, match=r"colour pictures \(3 values a pixel\)"):
        over(rig, opened, colour).camera.expose(DARK, 0.01)


def test_header_that_names_one_filter_at_two_slots_is_refused(rig: RigFile) -> None:
    """INDI's camera follows its own inner wheel by default: its frames say "Red" behind every filter."""

    def snooping(number: int, frame: RawFrame) -> RawFrame:
        return replace(frame, settings={"filter_header": "Red", "active_filter": "CCD Simulator"})

    with open_rig(rig, Path()) as opened:
        taken = over(rig, opened, snooping)
        taken.camera.expose(DARK, 0.01)
        with pytest.raises(RefusedError, match=r"header states 'Red' at slot 3, as at slot 2; .*'CCD Simulator'"):
            taken.camera.expose(replace(DARK, filter_name="500", slot=3), 0.01)


def test_header_that_changes_at_one_slot_is_refused(rig: RigFile) -> None:
    """The header of an old move: slot 2 is named after a slot that was left before the first frame."""

    def late(number: int, frame: RawFrame) -> RawFrame:
        return replace(frame, settings={"filter_header": "Green" if number == 1 else "Red"})

    with open_rig(rig, Path()) as opened:
        taken = over(rig, opened, late)
        taken.camera.expose(DARK, 0.01)
        with pytest.raises(RefusedError, match=r"states 'Red' at slot 2, where it stated 'Green' before"):
            taken.camera.expose(DARK, 0.01)


def test_exposure_that_is_not_read_back_is_refused(rig: RigFile) -> None:
    def silent(number: int, frame: RawFrame) -> RawFrame:
        return replace(frame, exposure_s=float("nan"))

    with open_rig(rig, Path()) as opened, pytest.raises(RefusedError, match=r"the camera reads back nan s"):
        over(rig, opened, silent).camera.expose(DARK, 0.01)


@dataclass
class Noisy:
    """A camera of 64 DN black level with noise and numbers, that delivers one frame twice."""

    signal_dn_per_s: float
    repeats: int
    pause_s: float = 0.0
    taken: int = 0
    last: RawFrame | None = None

    def identity(self) -> DeviceIdentity:
        raise NotImplementedError

    def expose(self, exposure_s: float, deadline_s: float) -> RawFrame:
        self.taken += 1
        time.sleep(self.pause_s)
        if self.taken != self.repeats or self.last is None:
            mean_dn = 64.0 + self.signal_dn_per_s * exposure_s
            counts = np.random.default_rng(self.taken).normal(mean_dn, 3.0, (64, 64)).round().astype(np.uint16)
            self.last = RawFrame(counts, exposure_s, exposure_s, "2026-01-01T00:00:00Z", frame_id=self.taken)
        return self.last


def all_new(rig: RigFile, camera: Noisy, exposures_s: list[float]) -> int:
    """Take frames, each until it is new; return how many were exposed since the one that came twice."""
    frames = NewFrames(camera, rig.camera.model_copy(update={"black_level_dn": 64.0, "bit_depth": 12}))
    for exposure_s in exposures_s:
        within_attempts(lambda attempt, t=exposure_s: frames.require_new(frames.expose(t, 9.0)), lambda text: None, "x")
    return camera.taken


def test_the_doubling_ends_by_dim_frames_that_change(rig: RigFile) -> None:
    """Their signals of 20 to 40 DN differ by half, but with a black level of 64 DN they looked alike for ever."""
    exposures_s = [0.5, 1.0] * 6
    # the repeat, and two exposures each until the next brightness proves it
    assert all_new(rig, Noisy(40.0, repeats=4), exposures_s) <= len(exposures_s) + 5
    # in the dark nothing tells
    assert all_new(rig, Noisy(0.0, repeats=4), exposures_s) > 2 * len(exposures_s) - 5


def test_a_frame_that_is_thrown_away_is_no_time_lost(rig: RigFile, tmp_path: Path) -> None:
    """One repeat ended a session of long dark frames: each exposure after it counted as a fault's."""
    with Journal(tmp_path, SystemClock()) as journal, faults_noted(journal, tmp_path, 0.5):
        journal.append("start")
        assert all_new(rig, Noisy(0.0, repeats=4, pause_s=0.1), [0.5] * 12) > 18


def test_noise_is_looked_for_only_in_frames_that_are_equal(rig: RigFile, monkeypatch: pytest.MonkeyPatch) -> None:
    """It takes 0.4 s at 20 megapixels, in the light of a laser."""
    looked: list[int] = []

    def noisy(counts: np.ndarray) -> bool:
        looked.append(counts.size)
        return True

    monkeypatch.setattr("rigs.capture._exposure._is_noisy", noisy)
    all_new(rig, Noisy(40.0, repeats=99), [0.5] * 5)
    assert looked == []
