"""A GenICam camera as the capture engine sees it: one acquisition for each frame, every exchange with a deadline."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Final, TypeVar

import numpy as np
from numpy.typing import NDArray

from data_schemas.devices import CameraSettings, DeviceIdentity
from data_schemas.errors import BadFrameError, LostError, RefusedError, TimedOutError
from rigs.call_thread import CallThread, NoAnswerError
from rigs.cameras.genicam import (
    ConnectionBrokenError,
    FeatureError,
    configure,
    exposure_name,
    read_settings,
    require_new,
    set_exposure,
)
from rigs.cameras.genicam_device import Delivered, Device, image, name_of
from rigs.cameras.genicam_pixels import RawPixels, right_aligned
from rigs.protocols import RawFrame

T = TypeVar("T")
OPEN_DEADLINE_S: Final = 20.0
REOPEN_DEADLINE_S: Final = 3.0
# A dead camera's connection closes after 5 s or more; nobody needs to wait for that.
CLOSE_DEADLINE_S: Final = 2.0
# A living camera answers a register in milliseconds; libraries would try for seconds.
ANSWER_S: Final = 0.9
# A camera whose frame is overdue is asked whether it is there at all; with the transfer's time, a loss is told within
# 2 s of the exposure.
THERE_S: Final = 0.6
# From the end of the exposure to the last packet; 24 MB take 0.25 s on a gigabit line.
TRANSFER_S: Final = 1.0
FIRST_FRAME: Final = "FirstFrameAfterChange"
TRANSPORT: Final = "TransportStatus"
"""Not a setting of the camera: what the transport says of the frame."""


@dataclass(slots=True)
class _Connection:
    """An open camera as it was configured."""

    device: Device
    pixels: RawPixels
    identity: DeviceIdentity


class GenicamCamera:
    """A GenICam camera behind a library.

    Every frame is an acquisition of its own, so that it was exposed after the call began. The first frame after a
    change of the exposure is taken and thrown away, as long as the deadline allows. After a broken connection the next
    call tries to open the camera again.

    Parameters
    ----------
    settings
        Camera of the rig file.
    connect
        Finds and opens the camera; raises children of CaptureError or
        :class:`~rigs.cameras.genicam.FeatureError`.
    """

    def __init__(self, settings: CameraSettings, connect: Callable[[], Device]) -> None:
        self._settings, self._connect = settings, connect
        self._where = name_of(settings)
        self._thread = CallThread(f"{settings.driver} camera")
        self._connection: _Connection | None = None
        self._identity: DeviceIdentity | None = None
        self._exposure_s: float | None = None
        self._last: tuple[int, float] | None = None

    def open(self, limit_s: float = OPEN_DEADLINE_S) -> None:
        """Find, open and configure the camera, and read what it is.

        Raises
        ------
        LostError
            It is not there or does not answer.
        RefusedError
            It cannot be what the rig file says, or is another camera than before.
        """
        end_s = time.monotonic() + limit_s
        try:
            self._connection = self._thread.call(lambda: self._opened(end_s), limit_s)
        except NoAnswerError:
            raise LostError(
                f"{self._where}: did not answer within {limit_s:g} s; check its cable and power, and that no other "
                "program has it open"
            ) from None
        except ConnectionBrokenError as error:
            raise LostError(f"{self._where}: cannot be opened ({error}); check its cable and power") from error
        except FeatureError as error:
            raise RefusedError(
                f"{self._where}: cannot be opened or configured ({error}); does another program use it?"
            ) from error
        self._identity, self._exposure_s = self._connection.identity, None

    def close(self) -> None:
        """Close the connection."""
        self._thread.close(self._closed, CLOSE_DEADLINE_S)

    def identity(self) -> DeviceIdentity:
        """Return what the camera says it is."""
        return self._ask(lambda device: device.identity())

    def expose(self, exposure_s: float, deadline_s: float) -> RawFrame:
        """Take one frame.

        Raises
        ------
        TimedOutError
            No frame came from a camera that answers: it waits for something, or the deadline is too short.
        LostError
            The camera does not answer; told within 2 s of the end of the exposure.
        BadFrameError
            The transport lost part of the frame, or it is the one that was delivered before.
        RefusedError
            The camera cannot expose like this.
        """
        end_s = time.monotonic() + deadline_s
        if self._connection is None:
            self.open(min(deadline_s, REOPEN_DEADLINE_S))
        actual_s = self._ask(lambda device: set_exposure(device, exposure_s, self._where))
        kept = False
        if exposure_s != self._exposure_s:
            kept = 2 * (actual_s + TRANSFER_S) + ANSWER_S > end_s - time.monotonic()
            if not kept:
                self._grab(actual_s, end_s)
            self._exposure_s = exposure_s
        started_utc = datetime.now(UTC).isoformat(timespec="milliseconds")
        delivered = self._grab(actual_s, end_s)
        settings = {**self._ask(read_settings), TRANSPORT: delivered.fault or "success"}
        if kept:
            settings[FIRST_FRAME] = "kept: no time for two"
        timed = delivered.device_time_s > 0.0
        return RawFrame(
            counts=self._counts(delivered),
            exposure_requested_s=exposure_s,
            exposure_s=actual_s,
            captured_utc=started_utc,
            # A camera may count from 1 again in each acquisition: without a time its number tells nothing.
            frame_id=delivered.frame_id if timed else None,
            device_time_s=delivered.device_time_s if timed else None,
            settings=settings,
        )

    def _counts(self, delivered: Delivered) -> NDArray[np.uint16]:
        """Return the counts of a frame, or refuse it."""
        if delivered.fault:
            raise BadFrameError(
                f"{self._where}: the transport reports '{delivered.fault}' for frame {delivered.frame_id}; if it "
                "happens often, use another cable or port, other packet sizes or fewer devices on the bus"
            )
        connection = self._require_connection()
        counts = image(delivered, connection.pixels, self._where)
        label = (delivered.frame_id, delivered.device_time_s)
        require_new(label, self._last, self._where)
        self._last = label
        return right_aligned(counts, connection.pixels, self._settings.bit_depth, self._where)

    def _grab(self, exposure_s: float, end_s: float) -> Delivered:
        """Take one frame within the deadline."""
        limit_s = min(exposure_s + TRANSFER_S, end_s - time.monotonic())
        try:
            delivered = self._call(lambda device: device.acquire(limit_s), limit_s + THERE_S)
        except NoAnswerError:
            raise self._silent(limit_s + THERE_S) from None
        if delivered is None:
            # Whether the camera is gone decides what the user must do; a register tells in milliseconds.
            self._ask(lambda device: device.number(exposure_name(device, self._where)), THERE_S)
            self._give_up()
            raise TimedOutError(
                f"{self._where}: no frame of {exposure_s:g} s came within {limit_s:.2f} s, though the camera answers; "
                "check its trigger settings and cable, or allow more time"
            )
        return delivered

    def _ask(self, function: Callable[[Device], T], limit_s: float = ANSWER_S) -> T:
        """Exchange registers with the camera."""
        try:
            return self._call(function, limit_s)
        except NoAnswerError:
            raise self._silent(limit_s) from None

    def _silent(self, limit_s: float) -> LostError:
        """Leave a camera that does not answer; return the error that tells it."""
        self._give_up()
        return LostError(f"{self._where}: did not answer within {limit_s:.3g} s; check its cable and power")

    def _call(self, function: Callable[[Device], T], limit_s: float) -> T:
        device = self._require_connection().device
        try:
            return self._thread.call(lambda: function(device), limit_s)
        except ConnectionBrokenError as error:
            self._give_up()
            raise LostError(f"{self._where}: the connection broke ({error}); check its cable and power") from error
        except FeatureError as error:
            raise RefusedError(f"{self._where}: refuses what was asked ({error})") from error

    def _require_connection(self) -> _Connection:
        if self._connection is None:
            raise LostError(f"{self._where}: the connection broke before; check its cable and power")
        return self._connection

    def _give_up(self) -> None:
        """Leave a connection that failed; what it sends later must never count as a frame."""
        connection, self._connection = self._connection, None
        if connection is not None:
            self._thread.post(connection.device.close)

    def _opened(self, end_s: float) -> _Connection:
        """Open and configure; runs in the thread."""
        device = self._connect()
        try:
            identity = device.identity()
            if self._identity not in (None, identity):
                raise RefusedError(
                    f"{self._where}: another camera answers now ({identity.model}, serial {identity.serial}); give "
                    "the serial number as address in the rig file"
                )
            exposure_name(device, self._where)
            pixels = configure(device, self._settings, self._where)
            device.prepare()
            if time.monotonic() > end_s:
                raise ConnectionBrokenError("too late")  # the caller has gone: leave nothing open behind
        except BaseException:
            device.close()
            raise
        return _Connection(device, pixels, identity)

    def _closed(self) -> None:
        """Close what is open; runs in the thread."""
        connection, self._connection = self._connection, None
        if connection is not None:
            connection.device.close()


@contextmanager
def opened_camera(settings: CameraSettings, connect: Callable[[], Device]) -> Iterator[GenicamCamera]:
    """Open a camera for a ``with`` block; `connect` finds and opens it behind its library."""
    camera = GenicamCamera(settings, connect)
    try:
        camera.open()
        yield camera
    finally:
        camera.close()
