"""Cameras behind MJPEG over HTTP: uStreamer, mjpg-streamer, ffmpeg, and what else sends JPEGs one after another.

The pictures went through the camera's own curve into 8 bits: fit to see a press, never for radiometry. Exposure cannot
be set or read over such a stream; the frame's ``exposure_s`` is NaN and its settings say ``exposure = "unknown"``.
"""

import math
import time
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from data_schemas import (
    BadFrameError,
    CameraSettings,
    CaptureError,
    DeviceIdentity,
    FrameSizeError,
    RefusedError,
    TimedOutError,
)
from rigs import RawFrame
from rigs.cameras._image_files import decoded_jpeg, jpeg_size_px
from rigs.transports import MultipartStream, NewestPart, Part, repeated

OPEN_DEADLINE_S: Final = 5.0
STALLED_S: Final = 2.5
"""A stream that brings no picture for so long is opened anew."""
STALE_PARTS: Final = 3
"""After a call one part may be half received, one half sent and one half exposed: these are not of the call."""


@contextmanager
def open_camera(settings: CameraSettings, folder: Path) -> Iterator["MjpegCamera"]:
    """Open the camera for a ``with`` block.

    Parameters
    ----------
    settings
        The camera of the rig file; ``address`` is ``http://host:port/path``.
    folder
        Not used: the address is no path.

    Raises
    ------
    RefusedError
        The rig file asks for raw counts, or the server refuses.
    LostError, TimedOutError
        The server cannot be reached.
    """
    if settings.bit_depth != 8:
        raise RefusedError(
            f"camera at {settings.address}: camera.bit_depth is {settings.bit_depth}, but a stream of JPEGs has 8 "
            "bits; write bit_depth = 8, or use a driver of raw counts (picamera2, aravis)"
        )
    camera = MjpegCamera(settings)
    try:
        camera.open(time.monotonic() + OPEN_DEADLINE_S)
        yield camera
    finally:
        camera.close()


class MjpegCamera:
    """A camera behind a stream that is read all the time, so that no old pictures wait in buffers on the way.

    Parameters
    ----------
    settings
        The camera of the rig file.
    """

    def __init__(self, settings: CameraSettings) -> None:
        self._settings, self._name = settings, f"camera at {settings.address}"
        self._reader: NewestPart | None = None
        self._server, self._is_ustreamer = "", False
        self._last = b""

    def open(self, end_s: float) -> NewestPart:
        """Open the stream, unless it is open, before `end_s` (:func:`time.monotonic`)."""
        if self._reader is not None and self._reader.has_ended():
            self.close()
        if self._reader is None:
            stream = MultipartStream(self._settings.address, "camera", end_s)
            self._server = stream.headers.get("server", "")
            self._is_ustreamer = stream.headers.get("set-cookie", "").startswith("stream_client=")
            self._reader = NewestPart(stream, _device_time_s)
        return self._reader

    def close(self) -> None:
        """Close the stream."""
        if self._reader is not None:
            self._reader.close()
            self._reader = None

    def identity(self) -> DeviceIdentity:
        """Return where the camera is; a stream says no more than the name of its server."""
        return DeviceIdentity(role="camera", driver="mjpeg", address=self._settings.address, model=self._server)

    def expose(self, exposure_s: float, deadline_s: float) -> RawFrame:
        """Return the fourth picture that arrives after the call, (H, W, 3) RGB of 8 bits; `exposure_s` is not set.

        Pictures that were held back on the way are passed over: those behind the stream's pace, and where the server
        stamps its pictures, those that took longer than the fastest of this connection. What stays unknown is a delay
        that every picture of a stream has; no stream tells it.

        Raises
        ------
        BadFrameError
            The picture is torn, was delivered before, or stands in for a missing camera.
        FrameSizeError
            The picture has another size than the rig file says.
        RefusedError
            Its server hides whether a camera is there.
        LostError
            The stream broke; the next exposure opens it again.
        TimedOutError
            No picture came in time.
        """
        try:
            part = repeated(self._fresh_part, time.monotonic() + deadline_s, self._name, after_fault=self.close)
        except CaptureError:
            self.close()
            raise
        received_utc = datetime.now(UTC).isoformat(timespec="milliseconds")
        self._require_size(*jpeg_size_px(part.body, self._name))
        counts = decoded_jpeg(part.body, self._name)
        device_time_s = _device_time_s(part)
        self._require_new(part.body, counts)
        return RawFrame(
            counts=counts.astype(np.uint16),
            exposure_requested_s=exposure_s,
            exposure_s=math.nan,
            captured_utc=received_utc,
            device_time_s=device_time_s,
            settings={"exposure": "unknown", "pixel_format": "RGB8", "compression": "JPEG", "time": "of arrival"},
        )

    def _fresh_part(self, end_s: float) -> Part:
        """Wait for a part whose picture was exposed after now."""
        reader = self.open(end_s)
        started_s, before = time.monotonic(), reader.count()
        count = before
        while True:
            count, part = reader.newer_than(count, min(end_s, time.monotonic() + STALLED_S), self._name)
            self._require_online(part)
            age_s = _number(part, "x-ustreamer-send-time") - _number(part, "x-ustreamer-grab-time")
            old = math.isfinite(age_s) and part.begun_s - age_s < started_s
            if count - before > STALE_PARTS and part.taken_s >= started_s and not old:
                return part
            if time.monotonic() > end_s:
                raise TimedOutError(
                    f"{self._name}: pictures arrive, but none that was exposed after the request arrived before the "
                    "deadline; the camera or its server hangs, or the network is slow"
                )

    def _require_online(self, part: Part) -> None:
        """Refuse uStreamer's stand-in picture, and a uStreamer that is not asked to tell."""
        online = part.headers.get("x-ustreamer-online")
        if online is None and self._is_ustreamer:
            raise RefusedError(
                f"{self._name}: uStreamer serves a placeholder picture when its camera is missing, but does not "
                "report this; add extra_headers=1 to the address (/stream?extra_headers=1)"
            )
        if online is not None and online.lower() != "true":
            raise BadFrameError(
                f"{self._name}: uStreamer has no camera and serves a placeholder picture; check the camera's cable "
                "and uStreamer's option --device"
            )

    def _require_size(self, height_px: int, width_px: int) -> None:
        """Refuse a picture of another size, before it is decoded: a few bytes can claim any."""
        asked = (self._settings.height_px, self._settings.width_px)
        if (height_px, width_px) != asked:
            raise FrameSizeError(
                f"{self._name}: sends pictures of {height_px} x {width_px} px, but the rig file states "
                f"{asked[0]} x {asked[1]} px (height x width); correct the rig file or the server's resolution"
            )

    def _require_new(self, body: bytes, counts: NDArray[np.uint8]) -> None:
        """Refuse the picture that was delivered last time; two pictures of one value each may well be equal."""
        if body == self._last and counts.min() < counts.max():
            raise BadFrameError(
                f"{self._name}: sent the same picture twice, so the camera hangs or the server repeats a stored picture"
            )
        self._last = body


def _device_time_s(part: Part) -> float | None:
    """Return the server's own time of the picture (s): when it was grabbed, or when mjpg-streamer stamped it."""
    for header in ("x-ustreamer-grab-time", "x-timestamp"):
        time_s = _number(part, header)
        if math.isfinite(time_s) and time_s > 0.0:
            return time_s
    return None


def _number(part: Part, header: str) -> float:
    """Return the number in a header; NaN where it is missing or none."""
    try:
        return float(part.headers.get(header, "nan"))
    except ValueError:
        return math.nan
