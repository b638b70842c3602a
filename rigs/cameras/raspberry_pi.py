"""Raspberry Pi cameras through picamera2: raw Bayer counts with locked exposure, gain and white balance.

Which sensor mode fits a rig file, and counts from the bytes of a buffer.
Not hardware-verified: written after picamera2's source and manual, and tested with a stand-in that follows them.
"""

import contextlib
import math
import re
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from importlib import import_module
from pathlib import Path
from typing import Any, Final, Self, cast

import numpy as np
from numpy.typing import NDArray

from data_schemas import (
    BadFrameError,
    CameraSettings,
    DeviceIdentity,
    LostError,
    MissingExtraError,
    RefusedError,
    TimedOutError,
)
from data_schemas.storage import FIRST_RED, BayerOrder
from rigs import CallThread, NoAnswerError, RawFrame

CONTAINER_BITS: Final = 16
RAW_FORMAT: Final = re.compile(r"S(RGGB|GRBG|GBRG|BGGR)(8|10|12|14|16)")

Mode = Mapping[str, Any]


def chosen_mode(settings: CameraSettings, modes: Sequence[Mode], name: str) -> Mode:
    """Return the sensor mode of the rig file's bit depth whose frame has its size after the cut.

    Parameters
    ----------
    settings
        The camera of the rig file.
    modes
        ``Picamera2.sensor_modes``.
    name
        The camera, for the message.

    Raises
    ------
    RefusedError
        There is none.
    """
    asked = (settings.width_px, settings.height_px)
    fitting: dict[tuple[int, int], Mode] = {
        cut: mode
        for mode in modes
        if mode.get("bit_depth") == settings.bit_depth and (cut := _size_after_cut(mode)) is not None
    }
    if asked not in fitting:
        allowed = ", ".join(f"{width} x {height}" for width, height in sorted(fitting)) or "none"
        raise RefusedError(
            f"{name}: has no raw mode of {asked[0]} x {asked[1]} px with {settings.bit_depth} bits; sizes with this "
            f"bit depth are {allowed} (width x height, cropped so that the first pixel is red). Correct the rig file"
        )
    return fitting[asked]


def _size_after_cut(mode: Mode) -> tuple[int, int] | None:
    """Return width and height of a mode's frame after the cut; None where it is no Bayer mode."""
    found = RAW_FORMAT.fullmatch(str(mode.get("unpacked", "")))
    if found is None:
        return None
    row, column = FIRST_RED[cast(BayerOrder, found[1])]
    width, height = mode["size"]
    return (width - column) // 2 * 2, (height - row) // 2 * 2


@dataclass(frozen=True, slots=True)
class RawLayout:
    """How the counts lie in a buffer, and what of them is the frame.

    Attributes
    ----------
    pixel_format
        libcamera's name of it, such as "SBGGR10".
    order
        Colours of the first 2 x 2 pixels, row by row.
    shift
        Bits below the counts: a Pi 5 puts them at the left end of 16 bits, a Pi 4 at the right end.
    bit_depth
        Bits of a count.
    stored_px, frame_px
        Width and height in the buffer (without padding) and after the cut.
    """

    pixel_format: str
    order: BayerOrder
    shift: int
    bit_depth: int
    stored_px: tuple[int, int]
    frame_px: tuple[int, int]

    @classmethod
    def of(cls, raw: Mapping[str, Any], mode: Mode, settings: CameraSettings, name: str) -> Self:
        """Return the layout of a configured raw stream.

        Raises
        ------
        RefusedError
            The camera did not take the format or size of `mode`.
        """
        found = RAW_FORMAT.fullmatch(raw["format"])
        bits = 0 if found is None else int(found[2])
        (width, height), asked = raw["size"], tuple(mode["size"])
        if found is None or (width, height) != asked or bits not in (settings.bit_depth, CONTAINER_BITS):
            raise RefusedError(
                f"{name}: raw {mode['unpacked']} of {asked[0]} x {asked[1]} px was requested, but the camera delivers "
                f"{raw['format']} of {width} x {height} px; update picamera2, or choose another size or bit_depth"
            )
        frame_px = settings.width_px, settings.height_px
        return cls(
            found[0],
            cast(BayerOrder, found[1]),
            bits - settings.bit_depth,
            settings.bit_depth,
            (width, height),
            frame_px,
        )

    def counts(self, stored: NDArray[Any], name: str) -> NDArray[np.uint16]:
        """Return counts (DN), shape (H, W): padding off, right-aligned, beginning with red.

        Parameters
        ----------
        stored
            The bytes of a buffer, shape (rows, bytes in a row), as ``make_array("raw")`` returns them.
        name
            The camera, for messages.

        Raises
        ------
        BadFrameError
            The buffer has another size.
        RefusedError
            The counts do not fit the bit depth.
        """
        unpacked = stored.astype(np.uint16) if self.pixel_format.endswith("8") else stored.view(np.uint16)
        width, height = self.stored_px
        if unpacked.shape[0] != height or unpacked.shape[1] < width:
            raise BadFrameError(
                f"{name}: delivered a buffer of {unpacked.shape[0]} x {unpacked.shape[1]} values for a frame of "
                f"{height} x {width} px (height x width)"
            )
        shifted = unpacked[:, :width]
        if np.any(shifted & ((1 << self.shift) - 1)) or int(shifted.max()) >> self.shift >= 1 << self.bit_depth:
            raise RefusedError(
                f"{name}: the counts do not fit {self.bit_depth} bits in {self.pixel_format}; correct "
                "camera.bit_depth in the rig file"
            )
        row, column = FIRST_RED[self.order]
        frame = shifted[row : row + self.frame_px[1], column : column + self.frame_px[0]]
        return np.ascontiguousarray(frame >> self.shift)


MOST_REQUESTS: Final = 20
"""Frames until a new exposure must have taken effect: sensors take up to three, and a queue may stand before them."""
TOLERANCE_REL: Final = 0.05
"""Sensors set exposures in lines and gains in steps; more than this is a setting that was not taken."""
FRAME_FACTOR: Final = 1.1
"""A frame lasts longer than its exposure, to read the sensor out."""
BUFFERS: Final = 2
"""As few as possible: each that waits is a frame with the settings before."""
LEVELS: Final = 65536
"""libcamera gives black levels on a 16-bit scale whatever the sensor delivers."""
OPEN_WITHIN_S: Final = 20.0
CLOSE_WITHIN_S: Final = 5.0
"""libcamera has no deadlines of its own."""
GAINS_OF_WHITE_BALANCE: Final = (1.0, 1.0)
"""Raw counts do not depend on them; fixed, they say that nothing was automatic."""


@contextmanager
def open_camera(settings: CameraSettings, folder: Path) -> Iterator["RaspberryPiCamera"]:
    """Open the camera for a ``with`` block.

    Parameters
    ----------
    settings
        The camera of the rig file; ``address`` is the number of the camera ("0").
    folder
        Not used: the address is no path.

    Raises
    ------
    MissingExtraError
        picamera2 is not installed.
    RefusedError
        There is no such camera, another program uses it, or it has no such frame size or bit depth.
    """
    camera_class = _picamera2()
    number = _camera_number(settings.address, camera_class.global_camera_info())
    calls = CallThread("picamera2")
    try:
        device = calls.call(lambda: camera_class(number), OPEN_WITHIN_S)
    except NoAnswerError:
        raise _mute(f"camera {number}", OPEN_WITHIN_S) from None
    except RuntimeError as error:  # IndexError is excluded by the number
        raise RefusedError(
            f"camera {number}: cannot be opened ({error}); end the program that uses it (rpicam-vid, uStreamer)"
        ) from None
    try:
        yield RaspberryPiCamera(device, settings, calls)
    finally:
        with contextlib.suppress(NoAnswerError):  # what hangs is left to the end of the program
            calls.call(lambda: _close(device), CLOSE_WITHIN_S)
        calls.close(lambda: None, 0.0)


def found() -> list[tuple[str, str]]:
    """Return address and model of the cameras of this Raspberry Pi; none where picamera2 is not installed."""
    try:
        cameras = _picamera2().global_camera_info()
    except MissingExtraError:
        return []
    return [(str(info["Num"]), str(info["Model"])) for info in cameras]


class RaspberryPiCamera:
    """One camera of a Raspberry Pi.

    Parameters
    ----------
    device
        The open ``Picamera2``.
    settings
        The camera of the rig file; its size is that of the frame after the cut that makes it begin with red.
    calls
        Makes the calls that may hang.

    Raises
    ------
    RefusedError
        The camera has no such raw mode.
    LostError
        It does not answer.
    """

    def __init__(self, device: Any, settings: CameraSettings, calls: CallThread) -> None:
        self._calls = calls
        self._device, self._settings, self._name = device, settings, f"camera {settings.address} (picamera2)"
        self._asked: dict[str, object] = {}
        self._layout = self._configured()

    def _configured(self) -> RawLayout:
        """Configure the raw stream; the first exposure starts it."""
        device = self._device
        mode = chosen_mode(self._settings, device.sensor_modes, self._name)
        raw = {"format": mode["unpacked"], "size": mode["size"]}
        still = device.create_still_configuration(raw=raw, buffer_count=BUFFERS, queue=False)
        self._within(OPEN_WITHIN_S, lambda: device.configure(still))
        return RawLayout.of(device.camera_configuration()["raw"], mode, self._settings, self._name)

    def identity(self) -> DeviceIdentity:
        """Return the sensor's model; Raspberry Pi cameras have no serial number."""
        model = str(self._device.camera_properties.get("Model", ""))
        return DeviceIdentity(
            role="camera", driver="picamera2", address=self._settings.address, vendor="Raspberry Pi", model=model
        )

    def expose(self, exposure_s: float, deadline_s: float) -> RawFrame:
        """Return the first frame that was exposed after the call with the settings asked for.

        Raises
        ------
        RefusedError
            The camera cannot expose so, or reads back other settings in all of 20 frames.
        TimedOutError, LostError
            No such frame came in time; the camera stopped.
        """
        began_ns, end_s = time.monotonic_ns(), time.monotonic() + deadline_s
        self._set(exposure_s, end_s)
        metadata: dict[str, Any] = {}
        for _ in range(MOST_REQUESTS):
            request = self._next_request(end_s)
            try:
                metadata = request.get_metadata()
                start_ns = metadata["SensorTimestamp"] - round(1000 * metadata["ExposureTime"])
                # The time stamp is that of the first pixel's readout; its exposure began before.
                if start_ns >= began_ns and not self._differing(metadata):
                    return self._frame(request.make_array("raw"), metadata, exposure_s, start_ns)
            except KeyError as missing:
                raise BadFrameError(f"{self._name}: delivered a frame without {missing} in its metadata") from None
            finally:
                request.release()
        raise RefusedError(
            f"{self._name}: {'; '.join(self._differing(metadata)) or 'all frames are older than the call'} (after "
            f"{MOST_REQUESTS} frames); choose settings that the camera supports, and end other programs that use it"
        )

    def _set(self, exposure_s: float, end_s: float) -> None:
        """Ask for exposure, gain and white balance, with all automatics off, if they are not asked for already.

        The stream is started anew: settings that change on the way wait behind frames of the exposure before.
        """
        exposure_us, gain = round(1e6 * exposure_s), 10 ** (self._settings.gain_db / 20)
        limits = self._device.camera_controls
        for control, value, unit, scale in (
            ("ExposureTime", exposure_us, " s", 1e-6),
            ("AnalogueGain", gain, "", 1.0),
        ):
            lowest, highest = limits[control][:2]
            # libcamera gives 0 as the highest where it knows none.
            if value < lowest * (1 - TOLERANCE_REL) or (highest and value > highest * (1 + TOLERANCE_REL)):
                raise RefusedError(
                    f"{self._name}: {control} {value * scale:g}{unit} is out of range; {lowest * scale:g} to "
                    f"{highest * scale:g}{unit} are allowed"
                )
        frame_us = max(round(FRAME_FACTOR * exposure_us), limits["FrameDurationLimits"][0])
        asked = {
            "AeEnable": False,
            "AwbEnable": False,
            "ColourGains": GAINS_OF_WHITE_BALANCE,
            "ExposureTime": exposure_us,
            "AnalogueGain": gain,
            "FrameDurationLimits": (frame_us, frame_us),
        }
        if asked != self._asked:
            self._asked = {}
            try:
                self._within(end_s - time.monotonic(), lambda: self._start_with(asked))
            except RuntimeError as error:
                raise self._lost(error) from None
            self._asked = asked

    def _start_with(self, asked: dict[str, object]) -> None:
        """Start the stream anew."""
        self._device.stop()
        self._device.set_controls(asked)
        self._device.start()

    def _within(self, limit_s: float, function: Callable[[], object]) -> None:
        """Make a call of libcamera that may hang."""
        try:
            self._calls.call(function, limit_s)
        except NoAnswerError:
            raise _mute(self._name, limit_s) from None

    def _next_request(self, end_s: float) -> Any:
        """Return the next finished request; it must be released."""
        try:
            job = self._device.capture_request(wait=False)
            return job.get_result(timeout=max(end_s - time.monotonic(), 0.0))
        except TimeoutError:
            self._device.cancel_all_and_flush()
            self._asked = {}
            raise TimedOutError(
                f"{self._name}: delivered no frame in time; check its cable, then restart the capture"
            ) from None
        except RuntimeError as error:
            raise self._lost(error) from None

    def _lost(self, error: RuntimeError) -> LostError:
        """Return the error of a camera that stopped; the next exposure starts its stream anew."""
        self._asked = {}
        return LostError(f"{self._name}: stopped ({error}); check its cable and restart the capture")

    def _differing(self, metadata: Mapping[str, Any]) -> list[str]:
        """Return in words which settings read back otherwise than asked for."""
        wanted = {name: self._asked[name] for name in ("ExposureTime", "AnalogueGain", "ColourGains")}
        return [
            f"{name} {value} was requested, but it reads back {metadata.get(name)}"
            for name, value in wanted.items()
            if not np.allclose(metadata.get(name, math.nan), np.asarray(value, float), rtol=TOLERANCE_REL, atol=0.0)
        ]

    def _frame(self, stored: NDArray[Any], metadata: Mapping[str, Any], asked_s: float, start_ns: int) -> RawFrame:
        """Return the frame of a request."""
        started = datetime.now(UTC) - timedelta(microseconds=(time.monotonic_ns() - start_ns) / 1000)
        return RawFrame(
            counts=self._layout.counts(stored, self._name),
            exposure_requested_s=asked_s,
            exposure_s=metadata["ExposureTime"] * 1e-6,
            captured_utc=started.isoformat(timespec="milliseconds"),
            device_time_s=metadata["SensorTimestamp"] * 1e-9,
            settings={"pixel_format": self._layout.pixel_format, **_plain_settings(metadata, self._settings.bit_depth)},
        )


def _close(device: Any) -> None:
    """Stop and close the camera."""
    with contextlib.suppress(RuntimeError):  # a dead camera cannot be stopped
        device.stop()
    device.close()


def _mute(name: str, limit_s: float) -> LostError:
    """Return the error of a camera whose library hangs."""
    return LostError(
        f"{name}: libcamera did not answer within {limit_s:.3g} s; check the ribbon cable, and restart the Pi if "
        f"this continues"
    )


def _picamera2() -> Any:
    """Return the class ``Picamera2``."""
    try:
        return import_module("picamera2").Picamera2
    except ImportError as error:
        raise MissingExtraError(
            f"driver 'picamera2' runs on a Raspberry Pi and needs picamera2 there ({error}); install it with 'sudo "
            "apt install python3-picamera2', and make the virtual environment with --system-site-packages. From "
            "another computer, use driver 'mjpeg'"
        ) from None


def _camera_number(address: str, cameras: list[dict[str, Any]]) -> int:
    """Return the number of a camera that is there."""
    known = {str(info["Num"]): info for info in cameras}
    if address not in known:
        seen = ", ".join(f"{n} ({info['Model']})" for n, info in known.items())
        there = f"its cameras are {seen}" if seen else "it reports no camera, so check the ribbon cable"
        raise RefusedError(f"camera {address!r}: does not exist on this Raspberry Pi; {there}")
    return int(address)


def _plain_settings(metadata: Mapping[str, Any], bit_depth: int) -> dict[str, str | float]:
    """Return gains, frame duration, temperature and black level of a frame, as far as its metadata has them."""
    names = {
        "AnalogueGain": "analogue_gain_factor",
        "DigitalGain": "digital_gain_factor",
        "FrameDuration": "frame_duration_us",
        "SensorTemperature": "sensor_temperature_c",
        "ColourTemperature": "colour_temperature_k",
    }
    plain: dict[str, str | float] = {name: float(metadata[key]) for key, name in names.items() if key in metadata}
    red, blue = metadata["ColourGains"]
    plain |= {"red_gain_factor": float(red), "blue_gain_factor": float(blue)}
    levels = metadata.get("SensorBlackLevels", ())
    if levels and min(levels) == max(levels):
        plain["black_level_dn"] = levels[0] * 2**bit_depth / LEVELS
    return plain
