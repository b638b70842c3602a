"""The picamera2 driver against a stand-in that follows picamera2's source; not against a Raspberry Pi."""

import importlib.util
import threading
import time
from pathlib import Path

import numpy as np
import pytest

from data_schemas import BadFrameError, CameraSettings, LostError, MissingExtraError, RefusedError, TimedOutError
from rigs.cameras.raspberry_pi import RawLayout, found, open_camera

WIDTH_PX, HEIGHT_PX = 96, 64  # 98 x 66 of a BGGR sensor, less what does not begin with red


def opened(**other: object):
    fields = {"driver": "picamera2", "address": "0", "width_px": WIDTH_PX, "height_px": HEIGHT_PX, "bit_depth": 10}
    return open_camera(CameraSettings.model_validate(fields | other), Path())


def bayer(order: str, width: int, height: int) -> np.ndarray:
    """Red 100, green 200, blue 300 DN in any order, and one more for each row."""
    cell = np.array([{"R": 100, "G": 200, "B": 300}[c] for c in order]).reshape(2, 2)
    return np.tile(cell, (height // 2, width // 2)) + np.arange(height)[:, None] // 2


@pytest.mark.skipif(importlib.util.find_spec("picamera2") is not None, reason="picamera2 is installed here")
def test_missing_picamera2_is_named():
    with pytest.raises(MissingExtraError, match="sudo apt install python3-picamera2"), opened():
        pass
    assert found() == []


def test_frame_carries_what_was_asked_and_what_was_read_back(sensor):
    with opened() as camera:
        frame = camera.expose(0.01, 2.0)
    assert frame.exposure_requested_s == 0.01
    assert frame.exposure_s == pytest.approx(0.01, abs=20e-6)  # a line
    assert frame.exposure_s != 0.01
    assert frame.settings["pixel_format"] == "SBGGR10"
    assert frame.settings["analogue_gain_factor"] == 1.0
    assert frame.settings["black_level_dn"] == 64.0
    assert frame.device_time_s == pytest.approx(time.monotonic(), abs=1.0)
    assert frame.counts.dtype == np.uint16
    assert frame.counts.mean() == pytest.approx(64 + 1e4 * frame.exposure_s, abs=1)


@pytest.mark.parametrize(
    ("order", "size"), [("RGGB", (96, 64)), ("GRBG", (98, 64)), ("GBRG", (96, 66)), ("BGGR", (98, 66))]
)
@pytest.mark.parametrize("container_bits", [10, 16], ids=["Pi 4", "Pi 5"])
def test_frame_begins_with_red_and_is_right_aligned(sensor, order, size, container_bits):
    sensor.order, sensor.size, sensor.container_bits = order, size, container_bits
    sensor.scene = lambda exposure_s: bayer(order, *size)
    with opened() as camera:
        counts = camera.expose(0.001, 2.0).counts
    assert counts.shape == (HEIGHT_PX, WIDTH_PX)
    assert set(np.unique(counts[0::2, 0::2] // 100)) == {1}
    assert set(np.unique(counts[0::2, 1::2] // 100)) == {2}
    assert set(np.unique(counts[1::2, 0::2] // 100)) == {2}
    assert set(np.unique(counts[1::2, 1::2] // 100)) == {3}


@pytest.mark.parametrize("pixel_format", ["SRGGB8", "SGBRG8"])
def test_eight_bit_buffers_hold_a_byte_a_pixel(pixel_format):
    stored = np.arange(96 * 70, dtype=np.uint8).reshape(70, 96)  # 80 px and padding
    layout = RawLayout(pixel_format, pixel_format[1:5], 0, 8, (80, 70), (80, 64))
    first_row = 1 if pixel_format == "SGBRG8" else 0
    assert np.array_equal(layout.counts(stored, "camera"), stored[first_row : first_row + 64, :80])


def test_settings_that_take_frames_are_waited_for(sensor):
    sensor.frames_late = 3
    with opened() as camera:
        for exposure_s in (0.01, 0.002, 0.004):
            assert camera.expose(exposure_s, 2.0).exposure_s == pytest.approx(exposure_s, rel=0.01)


def test_same_settings_are_not_sent_again(sensor):
    with opened() as camera:
        for exposure_s in (0.01, 0.01, 0.002):
            camera.expose(exposure_s, 2.0)
    assert sensor.log == ["set 10000 us", "start", "set 2000 us", "start", "close"]


def test_frames_from_before_the_call_are_dropped(sensor):
    with opened() as camera:
        camera.expose(0.005, 2.0)
        called_s = time.monotonic()
        frame = camera.expose(0.005, 2.0)
    assert frame.device_time_s - frame.exposure_s >= called_s


@pytest.mark.parametrize(
    ("kept", "value", "message"),
    [
        ("ExposureTime", 5000, r"ExposureTime 10000 was requested, but it reads back 5000"),
        ("AnalogueGain", 8.0, r"AnalogueGain 1\.0 was requested, but it reads back 8\.0"),
        ("ColourGains", (2.1, 1.4), r"ColourGains \(1\.0, 1\.0\) was requested"),
        ("age_ns", 10**12, r"all frames are older than the call"),
    ],
)
def test_setting_that_is_silently_kept_is_refused(sensor, kept, value, message):
    sensor.keeps[kept] = value
    with opened() as camera, pytest.raises(RefusedError, match=message):
        camera.expose(0.01, 2.0)


@pytest.mark.parametrize("exposure_s", [2**4 * 1e-6, 2**24 * 1e-6])
def test_exposure_out_of_range_is_refused(sensor, exposure_s):
    with opened() as camera, pytest.raises(RefusedError, match=r"7.5e-05 to 11.7668 s are allowed"):
        camera.expose(exposure_s, 20.0)


def test_gain_out_of_range_is_refused(sensor):
    with (
        opened(gain_db=30.0) as camera,
        pytest.raises(RefusedError, match=r"31\.6228 is out of"),
    ):
        camera.expose(0.01, 2.0)


def test_gain_of_the_rig_file_is_set(sensor):
    with opened(gain_db=6.0) as camera:
        assert camera.expose(0.01, 2.0).settings["analogue_gain_factor"] == pytest.approx(1.995, abs=0.001)


def test_silent_camera_times_out(sensor):
    with opened() as camera:
        sensor.silent = True
        began_s = time.monotonic()
        with pytest.raises(TimedOutError, match="delivered no frame in time"):
            camera.expose(0.01, 0.2)
        assert time.monotonic() - began_s < 1.0
    assert "cancel" in sensor.log


def test_broken_camera_is_lost(sensor):
    with opened() as camera:
        sensor.broken = True
        with pytest.raises(LostError, match="frontend has timed out"):
            camera.expose(0.01, 1.0)


def test_library_that_hangs_is_left_alone(sensor):
    """libcamera's calls have no deadline: what hangs must not keep a capture, and its laser, waiting."""
    sensor.hangs = threading.Event()
    with opened() as camera:
        began_s = time.monotonic()
        with pytest.raises(LostError, match=r"libcamera did not answer within 0\.\d+ s; check the ribbon cable"):
            camera.expose(0.01, 0.5)
        assert time.monotonic() - began_s < 2.0
        sensor.hangs.set()
        assert camera.expose(0.01, 5.0).exposure_s == pytest.approx(0.01, rel=0.01)
    assert sensor.log[-1] == "close"


def test_stream_of_a_camera_that_failed_is_started_anew(sensor):
    with opened() as camera:
        sensor.broken = True
        with pytest.raises(LostError, match="frontend has timed out"):
            camera.expose(0.01, 1.0)
        sensor.cannot_start = True
        with pytest.raises(LostError, match=r"stopped .Failed to start camera"):
            camera.expose(0.01, 1.0)
        sensor.broken = sensor.cannot_start = False
        assert camera.expose(0.01, 1.0).exposure_s == pytest.approx(0.01, rel=0.01)
    assert sensor.log.count("start") == 2


def test_incomplete_metadata_is_a_bad_frame(sensor):
    sensor.lacks = ("SensorTimestamp",)
    with opened() as camera, pytest.raises(BadFrameError, match="without 'SensorTimestamp'"):
        camera.expose(0.01, 1.0)


def test_other_buffer_is_a_bad_frame(sensor):
    sensor.scene = lambda exposure_s: np.zeros((10, 10))
    with opened() as camera, pytest.raises(BadFrameError, match="10 x 26 values for a frame of 66 x 98 px"):
        camera.expose(0.01, 1.0)


def test_counts_beyond_the_bit_depth_are_refused(sensor):
    sensor.container_bits, sensor.bit_depth = 16, 12
    with opened(bit_depth=12) as camera:
        sensor.bit_depth = 14  # left-aligned by two bits less than it should be
        sensor.scene = lambda exposure_s: np.full((66, 98), 3)
        with pytest.raises(RefusedError, match="do not fit 12 bits in SBGGR16"):
            camera.expose(0.01, 1.0)


def test_size_that_the_sensor_lacks_is_refused(sensor):
    with (
        pytest.raises(RefusedError, match=r"bits; sizes with this bit depth are 96 x 64 .*the first pixel is red"),
        opened(width_px=98),
    ):
        pass


def test_packed_format_is_refused(sensor):
    sensor.answers_format = "BGGR_PISP_COMP1"
    with (
        pytest.raises(RefusedError, match="raw SBGGR10 of 98 x 66 px was requested, but the camera delivers BGGR"),
        opened(),
    ):
        pass


def test_other_camera_number_is_refused(sensor):
    with (
        pytest.raises(RefusedError, match=r"does not exist on this Raspberry Pi; its cameras are 0 \(imx219\)"),
        opened(address="3"),
    ):
        pass


def test_camera_in_use_is_refused(sensor):
    sensor.keeps["in use"] = True
    with pytest.raises(RefusedError, match="end the program that uses it"), opened():
        pass


def test_identity_and_detection(sensor):
    assert found() == [("0", "imx219")]
    with opened() as camera:
        assert camera.identity().model == "imx219"
