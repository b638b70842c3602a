"""The camera of a finger: what it delivers is checked, and taken again."""

from contextlib import contextmanager
from dataclasses import replace

import numpy as np
import pytest

from data_schemas import BadFrameError, CameraSettings, LostError, RefusedError
from rigs import RawFrame
from rigs.capture._exposure import TactileCamera
from tests.capture.finger_session import HEIGHT_PX, WIDTH_PX


class Scripted:
    """A camera that delivers what it is given, frames or errors."""

    def __init__(self, *script) -> None:
        self._script = list(script)

    def identity(self):
        raise NotImplementedError

    def expose(self, exposure_s: float, deadline_s: float) -> RawFrame:
        what = self._script.pop(0)
        if isinstance(what, Exception):
            raise what
        return what


def frame(level: int = 9, **other) -> RawFrame:
    counts = np.full((HEIGHT_PX, WIDTH_PX), level, np.uint16)
    counts[0, 0] = 0
    return replace(RawFrame(counts, 0.01, 0.01, "2026-01-01T00:00:00+00:00"), **other)


@contextmanager
def checked(*script):
    settings = CameraSettings(driver="picamera2", address="0", width_px=WIDTH_PX, height_px=HEIGHT_PX, bit_depth=10)
    refused: list[str] = []
    yield TactileCamera(Scripted(*script), settings, True, refused.append), refused


def test_refused_frames_are_taken_again():
    with checked(BadFrameError("torn"), LostError("gone"), frame()) as (camera, refused):
        assert camera.expose(0.01)[1] == 3
    assert refused == ["0.01 s, attempt 1: torn", "0.01 s, attempt 2: gone"]


def test_four_refused_frames_end_the_capture():
    with (
        checked(*[BadFrameError("torn")] * 4) as (camera, _),
        pytest.raises(BadFrameError, match=r"torn \(4 attempts at 0\.01 s\)"),
    ):
        camera.expose(0.01)


@pytest.mark.parametrize(
    "same", [{}, {"frame_id": 7}, {"device_time_s": 1.5}], ids=["payload", "frame number", "device time"]
)
def test_same_frame_twice_is_refused(same):
    with checked(frame(**same), frame(**same), frame(10, frame_id=8), frame(11, frame_id=9)) as (camera, refused):
        camera.expose(0.01)
        raw, attempts = camera.expose(0.01)
        assert attempts == 2
        assert raw.frame_id == 9  # the one before it may be of the request before
    assert "the same frame twice" in refused[0]


def noisy(seed: int, level: int = 100) -> RawFrame:
    counts = np.random.default_rng(seed).integers(level - 9, level + 9, (HEIGHT_PX, WIDTH_PX), dtype=np.uint16)
    return frame(counts=counts, frame_id=seed)


def test_a_frame_of_some_time_ago_is_refused_whatever_its_number():
    old = replace(noisy(1), frame_id=3)
    with checked(noisy(1), noisy(2), old, noisy(4), noisy(5)) as (camera, refused):
        assert [camera.expose(0.01)[0].frame_id for _ in range(3)] == [1, 2, 5]
    assert len(refused) == 1


def test_each_exposure_is_made_twice_until_the_camera_is_seen_to_be_in_time():
    late = [noisy(3, 200), noisy(4, 200)]  # the light has changed: the first one shows so, too
    with checked(noisy(1), noisy(1), noisy(2), noisy(7), *late, noisy(5)) as (camera, _):
        assert [camera.expose(0.01)[0].frame_id for _ in range(4)] == [1, 7, 4, 5]
    # the frame that was refused brought a late camera up to date: that one looks in time proves nothing
    with checked(noisy(1), noisy(1), noisy(2, 200), noisy(7, 200), noisy(3), noisy(4)) as (camera, _):
        assert [camera.expose(0.01)[0].frame_id for _ in range(3)] == [1, 7, 4]
    # a camera that is late shows in the first one what was before
    late = [noisy(3), noisy(4, 200)]
    with checked(noisy(1), noisy(1), noisy(2), noisy(7), *late, noisy(5, 200), noisy(6, 200)) as (camera, _):
        assert [camera.expose(0.01)[0].frame_id for _ in range(4)] == [1, 7, 4, 6]


def test_frame_of_another_size_is_taken_again_and_refused_at_last():
    other = frame(counts=np.zeros((10, 10), np.uint16))
    with checked(other, other, frame()) as (camera, refused):
        assert camera.expose(0.01)[1] == 3
    assert len(refused) == 2
    message = r"delivered a frame of 10 x 10, but the rig file states 64 x 96.*\(4 attempts at 0\.01 s\)"
    with checked(*[other] * 4) as (camera, _), pytest.raises(RefusedError, match=message):
        camera.expose(0.01)


@pytest.mark.parametrize(
    ("delivered", "message"),
    [
        (frame(exposure_s=0.02), r"an exposure of 0\.01 s was requested, but the camera reads back 0\.02 s"),
        (frame(settings={"pixel_format": "Mono16"}), "delivers Mono16, but a tactile capture needs colours"),
        (frame(1024), r"a count of 1024 DN.*bit_depth = 10 allows \(1023 DN\)"),
    ],
    ids=["exposure", "no colours", "bits"],
)
def test_frame_that_is_not_as_asked_is_refused(delivered, message):
    with checked(delivered) as (camera, _), pytest.raises(RefusedError, match=message):
        camera.expose(0.01)
