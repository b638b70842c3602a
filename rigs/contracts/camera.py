"""What every camera must do.

A class of tests derives from :class:`CameraContract` and brings the fixtures `camera` (open) and `camera_settings`.
"""

import time
from itertools import pairwise

import numpy as np
import pytest

from data_schemas.devices import CameraSettings
from data_schemas.errors import CaptureError, RefusedError
from rigs.capture.exchange import CAMERA_DEADLINE_MARGIN_S, EXPOSURE_TOLERANCE_REL
from rigs.protocols import Camera, RawFrame

LATE_S = 1.0
"""How much later than its deadline an exchange may end: one register exchange, and a busy computer."""
USUAL_EXPOSURE_S = 0.01
LONG_EXPOSURE_S = 2.0
ENCODED = ("mjpeg",)
"""Drivers of cameras whose exposure is not in our hands and whose frames are pictures."""


class CameraContract:
    """Tests of a camera."""

    @pytest.fixture
    def exposures_s(self, camera_settings: CameraSettings) -> tuple[float, float]:
        """Return two exposures that the camera can do."""
        shortest_s, longest_s = camera_settings.shortest_exposure_s, camera_settings.longest_exposure_s
        first_s = min(max(USUAL_EXPOSURE_S, shortest_s), 0.5 * longest_s)
        return first_s, 2.0 * first_s

    def test_it_says_what_it_is(self, camera: Camera, camera_settings: CameraSettings) -> None:
        """Its identity is not empty; of a stream only its address need be known."""
        identity = camera.identity()
        assert identity.role == "camera"
        assert identity.driver
        assert identity.model or (camera_settings.driver in ENCODED and identity.address)

    def test_frames_have_the_shape_and_bits_of_the_rig_file(
        self, camera: Camera, camera_settings: CameraSettings, exposures_s: tuple[float, float]
    ) -> None:
        """Counts are unsigned, of the stated size, and never above full scale."""
        counts = _exposed(camera, exposures_s[0]).counts
        assert counts.shape[:2] == (camera_settings.height_px, camera_settings.width_px)
        assert counts.ndim == (3 if camera_settings.driver in ENCODED else 2)
        assert counts.dtype == np.uint16
        assert counts.max() < 2**camera_settings.bit_depth

    def test_exposure_is_read_back(
        self, camera: Camera, camera_settings: CameraSettings, exposures_s: tuple[float, float]
    ) -> None:
        """Every frame tells the exposure that was asked for and the one that was used, also after a change."""
        _require_exposure(camera_settings)
        for exposure_s in (*exposures_s, exposures_s[0]):
            frame = _exposed(camera, exposure_s)
            assert frame.exposure_requested_s == exposure_s
            assert frame.exposure_s == pytest.approx(exposure_s, rel=EXPOSURE_TOLERANCE_REL)

    def test_every_frame_is_new(self, camera: Camera, exposures_s: tuple[float, float]) -> None:
        """Number and device time differ from frame to frame; where there are none, the counts do, unless constant."""
        frames = [_exposed(camera, exposures_s[0]) for _ in range(3)]
        for last, frame in pairwise(frames):
            if frame.frame_id is not None or frame.device_time_s is not None:
                assert (frame.frame_id, frame.device_time_s) != (last.frame_id, last.device_time_s)
            else:
                assert frame.counts.min() == frame.counts.max() or not np.array_equal(frame.counts, last.counts)

    def test_impossible_exposure_is_refused_and_the_next_is_not(
        self, camera: Camera, camera_settings: CameraSettings, exposures_s: tuple[float, float]
    ) -> None:
        """An exposure out of range ends in RefusedError, never in a frame with another exposure."""
        _require_exposure(camera_settings)
        with pytest.raises(RefusedError):
            camera.expose(-1.0, CAMERA_DEADLINE_MARGIN_S)
        assert _exposed(camera, exposures_s[0]).exposure_s == pytest.approx(exposures_s[0], rel=EXPOSURE_TOLERANCE_REL)

    def test_deadline_is_kept(self, camera: Camera, camera_settings: CameraSettings) -> None:
        """A frame that cannot be there in time is not waited for, and the camera can be used again afterwards."""
        exposure_s = min(LONG_EXPOSURE_S, camera_settings.longest_exposure_s)
        deadline_s = 0.25 * exposure_s
        began_s = time.monotonic()
        try:
            camera.expose(exposure_s, deadline_s)
        except CaptureError:
            assert time.monotonic() - began_s < deadline_s + LATE_S
        else:  # emulated cameras need not take the time
            assert time.monotonic() - began_s < deadline_s
        end_s = time.monotonic() + exposure_s + 2.0 * CAMERA_DEADLINE_MARGIN_S
        while True:
            try:
                frame = _exposed(camera, exposure_s)
            except CaptureError:
                if time.monotonic() > end_s:
                    raise
            else:
                break
        if camera_settings.driver not in ENCODED:
            assert frame.exposure_s == pytest.approx(exposure_s, rel=EXPOSURE_TOLERANCE_REL)


def _exposed(camera: Camera, exposure_s: float) -> RawFrame:
    return camera.expose(exposure_s, exposure_s + CAMERA_DEADLINE_MARGIN_S)


def _require_exposure(settings: CameraSettings) -> None:
    if settings.driver in ENCODED:
        pytest.skip(f"driver {settings.driver}: the exposure is the camera's own affair and cannot be set or read")


class TestCamera(CameraContract):
    """The camera of the rig file that ``--rig`` names."""
