"""GenICam cameras, by whichever library they are reached: raw pixels, nothing automatic, read back.

A camera is told which raw pixel format to send, what not to do by itself, and its exposure; every frame is one
acquisition, and every exchange has a deadline. A library brings a :class:`Device`; :class:`GenicamCamera` makes of it
the camera that captures see.
"""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Final, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from data_schemas import BadFrameError, CameraSettings, DeviceIdentity, LostError, RefusedError, TimedOutError
from rigs import CallThread, NoAnswerError, RawFrame
from rigs.transports import RECOVERS_WITHIN_S, repeated

CONTAINER_BITS: Final = {8: 8, 10: 16, 12: 16, 14: 16, 16: 16}


@dataclass(frozen=True, slots=True)
class RawPixels:
    """A raw pixel format: its name and the bits of a count inside its container."""

    name: str
    bits: int

    @property
    def container(self) -> type[np.uint8 | np.uint16]:
        """Type of one count in the camera's buffer."""
        return np.uint8 if CONTAINER_BITS[self.bits] == 8 else np.uint16


def raw_pixels(offered: tuple[str, ...], bit_depth: int, camera: str) -> RawPixels:
    """Choose the raw pixel format: Bayer RG with the asked bits or 16, monochrome only where there is no Bayer.

    Raises
    ------
    RefusedError
        The camera has no such format.
    """
    colours = "BayerRG" if any(name.startswith("Bayer") for name in offered) else "Mono"
    for bits in sorted({bit_depth, 8 if bit_depth <= 8 else 16}):
        if f"{colours}{bits}" in offered:
            return RawPixels(f"{colours}{bits}", bits)
    raise RefusedError(
        f"{camera}: has no raw pixel format with {bit_depth} bits and Bayer pattern RGGB, only {', '.join(offered)}; "
        "correct bit_depth in the rig file, or use another camera"
    )


def right_aligned(counts: NDArray[np.uint16], pixels: RawPixels, bit_depth: int, camera: str) -> NDArray[np.uint16]:
    """Return counts (DN) with the lowest bit of the converter at the lowest bit, shape (H, W).

    Cameras put the 10 or 12 bits of their converter at the top of a 16-bit format.

    Raises
    ------
    RefusedError
        The counts have more bits than the rig file says.
    BadFrameError
        A count is larger than its format allows.
    """
    if pixels.bits == 16:
        surplus = 16 - bit_depth
        if surplus and np.any(counts & np.uint16(2**surplus - 1)):
            raise RefusedError(
                f"{camera}: {pixels.name} carries more than the {bit_depth} bits of the rig file (its lowest "
                f"{surplus} bits are not all 0); correct bit_depth, or check how the camera processes raw "
                "counts"
            )
        return counts >> np.uint16(surplus)
    if counts.max(initial=0) >= 2**pixels.bits:
        raise BadFrameError(
            f"{camera}: {pixels.name} contains a count of {counts.max()} DN, but {pixels.bits} bits allow less; check "
            "the camera's pixel format"
        )
    return counts


# Names before and after the GenICam Standard Features Naming Convention 1.0.
EXPOSURE_NAMES: Final = ("ExposureTime", "ExposureTimeAbs")
AUTOMATIC: Final = ("ExposureAuto", "GainAuto", "BalanceWhiteAuto", "BlackLevelAuto", "AcquisitionFrameRateAuto")
TRIGGER: Final = "TriggerMode"
MIRRORED: Final = ("ReverseX", "ReverseY")
JOINED: Final = ("BinningHorizontal", "BinningVertical", "DecimationHorizontal", "DecimationVertical")
# A limited frame rate limits the exposure; the others change raw counts.
SWITCHED_OFF: Final = (
    "LUTEnable",
    *(f"{what}Enable{d}" for what in ("AcquisitionFrameRate", "Gamma", "Sharpness", "Saturation") for d in ("", "d")),
)
# Exposures are multiples of a line time (some 10 us to 40 us), by a clock that is good to 0.1 %.
LINE_S: Final = 50e-6
CLOCK_REL: Final = 1e-3
GAIN_STEP_DB: Final = 0.1
BALANCE_STEP: Final = 5e-3


class FeatureError(Exception):
    """A camera library refuses to read or write a feature."""


class ConnectionBrokenError(FeatureError):
    """The camera does not answer any more."""


class Features(Protocol):
    """Features of an open GenICam camera; every method may raise :class:`FeatureError`."""

    def has(self, name: str) -> bool:
        """Return whether the camera has this feature now."""
        ...

    def entries(self, name: str) -> tuple[str, ...]:
        """Return what an enumeration can be set to."""
        ...

    def text(self, name: str) -> str:
        """Read an enumeration or string."""
        ...

    def number(self, name: str) -> float:
        """Read a number."""
        ...

    def is_on(self, name: str) -> bool:
        """Read a switch."""
        ...

    def bounds(self, name: str) -> tuple[float, float]:
        """Return the smallest and largest value of a number."""
        ...

    def set_text(self, name: str, value: str) -> None:
        """Write an enumeration or string."""
        ...

    def set_number(self, name: str, value: float) -> None:
        """Write a number."""
        ...

    def switch(self, name: str, on: bool) -> None:
        """Write a switch."""
        ...


def configure(features: Features, settings: CameraSettings, camera: str) -> RawPixels:
    """Set everything but the exposure: nothing automatic, raw pixels, whole frame, gain; each is read back.

    Raises
    ------
    RefusedError
        The camera cannot do what the rig file says, or reads back something else.
    """
    # A mirrored frame begins with another colour; then, and where they join pixels, some cameras offer other formats.
    for name in MIRRORED:
        _switch_off(features, name, camera)
    for name in JOINED:
        if features.has(name):
            _set_number(features, name, 1.0, 0.0, camera, "every pixel is needed")
    pixels = raw_pixels(features.entries("PixelFormat"), settings.bit_depth, camera)
    _set_text(features, "PixelFormat", pixels.name, camera)
    for name in (*AUTOMATIC, TRIGGER):
        if features.has(name):
            _set_text(features, name, "Off", camera)
    for name in SWITCHED_OFF:
        _switch_off(features, name, camera)
    _equal_white_balance(features, camera)
    if features.has("Gamma"):
        _set_number(features, "Gamma", 1.0, 1e-3, camera, "gamma must be 1")
    _whole_frame(features, settings, camera)
    _set_gain(features, settings.gain_db, camera)
    return pixels


def read_settings(features: Features) -> dict[str, str | float]:
    """Read back what a frame's record should hold beside its exposure."""
    found: dict[str, str | float] = {"pixel_format": features.text("PixelFormat")}
    found |= {name: features.text(name) for name in AUTOMATIC if features.has(name)}
    found |= {name: features.number(name) for name in ("Gain", "BlackLevel", "Gamma") if features.has(name)}
    return found


def _agree(now: str | float | None, before: str | float) -> bool:
    """Whether a setting is as it was read back before."""
    if isinstance(now, float) and isinstance(before, float):
        return abs(now - before) <= GAIN_STEP_DB
    return now == before


def exposure_name(features: Features, camera: str) -> str:
    """Return the name of the exposure time.

    Raises
    ------
    RefusedError
        The camera has none.
    """
    name = next((name for name in EXPOSURE_NAMES if features.has(name)), None)
    if name is None:
        raise RefusedError(
            f"{camera}: has no feature {' or '.join(EXPOSURE_NAMES)}, so the exposure can be neither set nor read; "
            "use a camera with a settable exposure time"
        )
    return name


def set_exposure(features: Features, exposure_s: float, camera: str) -> float:
    """Set the exposure time (s) and return the one that is read back (s).

    Raises
    ------
    RefusedError
        The camera has no exposure time, not this one, or keeps another.
    """
    name = exposure_name(features, camera)
    low_us, high_us = features.bounds(name)
    wanted_us = round(1e6 * exposure_s, 6)  # the product may miss a bound by its last bit
    if not low_us <= wanted_us <= high_us:
        raise RefusedError(
            f"{camera}: cannot expose for {exposure_s:g} s, only for {1e-06 * low_us:g} to {1e-06 * high_us:g} s; "
            "correct shortest_exposure_s and longest_exposure_s in the rig file"
        )
    features.set_number(name, wanted_us)
    actual_s = 1e-6 * features.number(name)
    if abs(actual_s - exposure_s) > LINE_S + CLOCK_REL * exposure_s:
        raise RefusedError(
            f"{camera}: an exposure of {exposure_s:g} s was requested, but the camera uses {actual_s:g} s; switch "
            "automatic exposure and frame rate limits off"
        )
    return actual_s


def require_new(label: tuple[int, float], last: tuple[int, float] | None, camera: str) -> None:
    """Refuse the frame that was delivered last time, by its number and the camera's time (s).

    Neither tells alone: numbers wrap or begin again with each acquisition, and some cameras give no time.

    Raises
    ------
    BadFrameError
        Both are those of the last frame.
    """
    if label[1] > 0.0 and label == last:
        raise BadFrameError(
            f"{camera}: delivered frame {label[0]} twice, so its stream may have stopped; check cable and power, then "
            "run the command again"
        )


def _whole_frame(features: Features, settings: CameraSettings, camera: str) -> None:
    """Read out the frame of the rig file, from the first row and column of the sensor."""
    for size, offset, wanted in (
        ("Width", "OffsetX", settings.width_px),
        ("Height", "OffsetY", settings.height_px),
    ):
        if features.has(offset):
            _set_number(features, offset, features.bounds(offset)[0], 0.0, camera, "the whole frame is needed")
        largest = features.bounds(size)[1]
        if wanted > largest:
            raise RefusedError(
                f"{camera}: cannot read out {size} = {wanted} px, only up to {largest:g} px; correct {size.lower()}_px "
                "in the rig file"
            )
        _set_number(features, size, wanted, 0.0, camera, f"correct {size.lower()}_px of the rig file")


def _switch_off(features: Features, name: str, camera: str) -> None:
    """Switch off what a camera may have, and read it back."""
    if features.has(name) and features.is_on(name):
        features.switch(name, False)
        if features.is_on(name):
            raise RefusedError(
                f"{camera}: {name} changes raw counts or limits the exposure, but finray cannot switch {name} off; "
                "switch it off in the camera maker's program"
            )


def _equal_white_balance(features: Features, camera: str) -> None:
    """Set the digital gains of the colours to 1: also with nothing automatic, some cameras apply them to raw counts."""
    if not (features.has("BalanceRatioSelector") and features.has("BalanceRatio")):
        return
    for colour in features.entries("BalanceRatioSelector"):
        _set_text(features, "BalanceRatioSelector", colour, camera)
        _set_number(features, "BalanceRatio", 1.0, BALANCE_STEP, camera, f"white balance ({colour}) must be off")


def _set_gain(features: Features, gain_db: float, camera: str) -> None:
    """Set the gain (dB); a camera without one has 0 dB."""
    if features.has("Gain"):
        _set_number(features, "Gain", gain_db, GAIN_STEP_DB, camera, "correct gain_db of the rig file")
    elif gain_db:
        raise RefusedError(
            f"{camera}: has no feature Gain, but the rig file states gain_db = {gain_db:g}; leave gain_db out"
        )


def _set_text(features: Features, name: str, value: str, camera: str) -> None:
    """Set an enumeration, which may be fixed at the value, and read it back."""
    if features.text(name) == value:
        return
    features.set_text(name, value)
    found = features.text(name)
    if found != value:
        raise RefusedError(
            f"{camera}: {name} was set to {value}, but reads back {found}; set {name} in the camera maker's program"
        )


def _set_number(features: Features, name: str, value: float, tolerance: float, camera: str, advice: str) -> None:
    """Set a number, which may be fixed at the value, and read it back."""
    if abs(features.number(name) - value) <= tolerance:
        return
    features.set_number(name, value)
    found = features.number(name)
    if abs(found - value) > tolerance:
        raise RefusedError(f"{camera}: {name} was set to {value:g}, but reads back {found:g}; {advice}")


FIRMWARE_NAMES = ("DeviceFirmwareVersion", "DeviceVersion")


@dataclass(frozen=True, slots=True)
class DeliveredFrame:
    """What the transport delivered.

    Attributes
    ----------
    fault
        Why the frame is not whole; empty where it is.
    frame_id, device_time_s
        The camera's number and time (s) of the frame; the time is 0 where it gives none.
    width_px, height_px, content
        Size and bytes of a whole frame.
    """

    fault: str
    frame_id: int
    device_time_s: float
    width_px: int
    height_px: int
    content: NDArray[np.uint8]


class Device(Features, Protocol):
    """An open camera; every method may raise :class:`~rigs.cameras._genicam.FeatureError`."""

    def identity(self) -> DeviceIdentity:
        """Read what the camera is."""
        ...

    def prepare(self) -> None:
        """Get ready to acquire frames with the settings of now."""
        ...

    def acquire(self, limit_s: float) -> DeliveredFrame | None:
        """Start an acquisition, return its first frame (None after `limit_s` seconds) and stop it."""
        ...

    def close(self) -> None:
        """Close the connection."""
        ...


def firmware_of(features: Features) -> str:
    """Return the version of the camera's firmware; empty where it tells none."""
    name = next((name for name in FIRMWARE_NAMES if features.has(name)), None)
    return features.text(name) if name else ""


def name_of(settings: CameraSettings) -> str:
    """Return the camera's name in messages: driver and address."""
    return f"camera ({settings.driver}, {settings.address})"


def image(delivered: DeliveredFrame, pixels: RawPixels, camera: str) -> NDArray[np.uint16]:
    """Return the counts of a whole frame as they stand in its container, shape (H, W).

    Raises
    ------
    BadFrameError
        It holds fewer bytes than its size needs.
    """
    shape = (delivered.height_px, delivered.width_px)
    needed = shape[0] * shape[1] * np.dtype(pixels.container).itemsize
    if delivered.content.size < needed:
        raise BadFrameError(
            f"{camera}: frame {delivered.frame_id} has only {delivered.content.size} bytes, but {shape[0]} x "
            f"{shape[1]} px of {pixels.name} need {needed} bytes"
        )
    return delivered.content[:needed].view(pixels.container).reshape(shape).astype(np.uint16)


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
    settings: dict[str, str | float]


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
        :class:`~rigs.cameras._genicam.FeatureError`.
    """

    def __init__(self, settings: CameraSettings, connect: Callable[[], Device]) -> None:
        self._settings, self._connect = settings, connect
        self._where = name_of(settings)
        self._thread = CallThread(f"{settings.driver} camera")
        self._connection: _Connection | None = None
        self._identity: DeviceIdentity | None = None
        self._pixels: RawPixels | None = None
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
            # A camera keeps the connection that broke for some seconds, and refuses another.
            kind = RefusedError if self._identity is None else LostError
            raise kind(
                f"{self._where}: cannot be opened or configured ({error}); close other programs that use it"
            ) from error
        self._identity, self._exposure_s = self._connection.identity, None
        self._pixels = self._connection.pixels

    def close(self) -> None:
        """Close the connection."""
        self._thread.close(self._closed, CLOSE_DEADLINE_S)

    def identity(self) -> DeviceIdentity:
        """Return what the camera says it is."""

        def ask(end_s: float) -> DeviceIdentity:
            if self._connection is None:
                self.open(min(end_s - time.monotonic(), REOPEN_DEADLINE_S))
            return self._ask(lambda device: device.identity())

        return repeated(ask, time.monotonic() + RECOVERS_WITHIN_S, self._where)

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
        # What may be repeated leaves time for the exposure, which may not: whoever asked for it decides anew.
        exposing_s = min((exposure_s if exposure_s > 0.0 else 0.0) + TRANSFER_S, 0.5 * deadline_s)
        actual_s = repeated(lambda end_s: self._made_ready(exposure_s, end_s), end_s - exposing_s, self._where)
        kept = False
        if exposure_s != self._exposure_s:
            kept = 2 * (actual_s + TRANSFER_S) + ANSWER_S > end_s - time.monotonic()
            if not kept:
                self._grab(actual_s, end_s)
            self._exposure_s = exposure_s
        started_utc = datetime.now(UTC).isoformat(timespec="milliseconds")
        delivered = self._grab(actual_s, end_s)
        settings = {**self._require_kept(actual_s), TRANSPORT: delivered.fault or "success"}
        if kept:
            settings[FIRST_FRAME] = "the first frame was kept, because there was no time to take a second one"
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

    def _require_kept(self, exposure_s: float) -> dict[str, str | float]:
        """Return the settings after a frame; a camera that was restarted answers as before and has lost them.

        Raises
        ------
        LostError
            One is not as it was set; the next exposure sets all of them anew.
        """
        name = self._ask(lambda device: exposure_name(device, self._where))
        now_s = 1e-6 * self._ask(lambda device: device.number(name))
        settings, before = self._ask(read_settings), self._require_connection().settings
        # A black level may follow the temperature.
        lost = [key for key, value in before.items() if key != "BlackLevel" and not _agree(settings.get(key), value)]
        if abs(now_s - exposure_s) > LINE_S + CLOCK_REL * exposure_s:
            lost.append(name)
        if lost:
            self._give_up()
            raise LostError(
                f"{self._where}: has lost its settings ({', '.join(lost)}), as after a restart; check its power "
                "supply, and that no other program changes the settings"
            )
        return settings

    def _made_ready(self, exposure_s: float, end_s: float) -> float:
        """Open a camera that was lost, and set the exposure; return the one that is read back (s)."""
        if self._connection is None:
            self.open(min(end_s - time.monotonic(), REOPEN_DEADLINE_S))
        return self._ask(lambda device: set_exposure(device, exposure_s, self._where))

    def _counts(self, delivered: DeliveredFrame) -> NDArray[np.uint16]:
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

    def _grab(self, exposure_s: float, end_s: float) -> DeliveredFrame:
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
                f"{self._where}: no frame with an exposure of {exposure_s:g} s came within {limit_s:.2f} s, although "
                "the camera answers; check its trigger settings and cable, or allow more time"
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
            raise RefusedError(f"{self._where}: refuses the request ({error}); correct the rig file") from error

    def _require_connection(self) -> _Connection:
        if self._connection is None:
            raise LostError(f"{self._where}: the connection broke earlier; check its cable and power")
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
                    f"{self._where}: a different camera answers now ({identity.model}, serial {identity.serial}); to "
                    "choose the right camera, give its serial number as the address in the rig file"
                )
            exposure_name(device, self._where)
            pixels = configure(device, self._settings, self._where)
            if self._pixels not in (None, pixels):
                # Entries that cannot be asked in time count as not offered, and a monochrome format would be chosen.
                raise ConnectionBrokenError(f"it now offers {pixels.name}, but sent {self._pixels.name} before")
            settings = read_settings(device)
            device.prepare()
            if time.monotonic() > end_s:
                raise ConnectionBrokenError("too late")  # the caller has gone: leave nothing open behind
        except BaseException:
            device.close()
            raise
        return _Connection(device, pixels, identity, settings)

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
