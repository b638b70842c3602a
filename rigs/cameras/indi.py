"""A camera behind an INDI server: raw 16-bit frames as FITS, every setting compared with the frame's own header.

Size, exposure, gain, colour pattern and bits must be what was asked for, and each frame a new one. Of FITS it reads the
one kind that INDI servers send: a primary image of 16-bit whole numbers.
Source: FITS standard 4.0, sections 3 and 4: cards of 80 characters in blocks of 2880 bytes, then big-endian data.
"""

import math
import re
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Final, Literal

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
from rigs import Camera, RawFrame
from rigs.transports import CAMERA_INTERFACE, INDI_OPENS_WITHIN_S, IndiClient, blob_bytes, local_indi_devices

ABORT_WITHIN_S: Final = 1.0
TRANSFER_S: Final = 1.0
"""From the end of an exposure to its frame."""
_EXPOSURE: Final = "CCD_EXPOSURE"
_EXPOSURE_VALUE: Final = "CCD_EXPOSURE_VALUE"
_FRAME: Final = "CCD1"
# What every frame needs, where the driver has the choice: property, member.
_SWITCHES: Final = (
    ("UPLOAD_MODE", "UPLOAD_CLIENT"),
    ("CCD_TRANSFER_FORMAT", "FORMAT_FITS"),
    ("CCD_COMPRESSION", "INDI_DISABLED"),
    ("CCD_FRAME_TYPE", "FRAME_LIGHT"),
    ("CCD_VIDEO_STREAM", "STREAM_OFF"),
    ("CCD_FAST_TOGGLE", "INDI_DISABLED"),
)


class IndiCamera:
    """A camera of an INDI server.

    Parameters
    ----------
    client
        Connection to the camera.
    settings
        What the rig file says about it.
    """

    def __init__(self, client: IndiClient, settings: CameraSettings, wheel_device: str = "") -> None:
        self._client = client
        self._settings = settings
        self._wheel_device = wheel_device
        self._frames = IndiFrames(client, settings)
        self._set_in = 0

    def prepare(self, end_s: float) -> None:
        """Connect where there is no connection, and then set what every frame needs."""
        self._client.ready(end_s)
        if self._set_in == self._client.connections:
            return
        try:
            self._configure(end_s)
        except CaptureError:
            # The next call starts over, rather than expose with half of the settings.
            self._client.close()
            raise
        self._set_in = self._client.connections

    def identity(self) -> DeviceIdentity:
        """Return what the driver says it is."""
        return self._client.identity("camera", self._settings.address)

    def expose(self, exposure_s: float, deadline_s: float) -> RawFrame:
        """Take one frame with `exposure_s` seconds; it is there after at most `deadline_s` seconds.

        Raises
        ------
        RefusedError
            The camera cannot expose so long, or reads back another setting than it was given.
        BadFrameError
            The frame is cut off, damaged, was delivered before, or holds more counts than its bits allow.
        TimedOutError
            The frame did not come; the exposure is aborted.
        LostError
            The connection broke, or the driver crashed.
        """
        end_s = time.monotonic() + deadline_s
        # What may be repeated leaves time for the exposure, which may not: whoever asked for it decides anew.
        exposing_s = min((exposure_s if exposure_s > 0.0 else 0.0) + TRANSFER_S, 0.5 * deadline_s)
        self._client.within(end_s - exposing_s, self._make_idle)
        self._require_range(exposure_s)
        self._client.blobs.pop(_FRAME, None)
        captured_utc = datetime.now(UTC).isoformat(timespec="milliseconds")
        try:
            self._await_frame(exposure_s, end_s)
        except TimedOutError:
            with suppress(TimedOutError):
                self._abort(time.monotonic() + ABORT_WITHIN_S)
            self._client.close()  # after a message that was cut off nothing more is understood
            raise
        blob = self._client.blobs.pop(_FRAME)
        if blob.attributes.get("format") not in (".fits", ".fits.z"):
            raise RefusedError(
                f"{self._client.name}: sends frames as '{blob.attributes.get('format', '')[:16]}', but .fits "
                "is needed; set the driver's transfer format to FITS and its compression off"
            )
        image = read_fits_image(blob_bytes(blob, self._client.name), self._client.name)
        return self._frames.checked(image, exposure_s, captured_utc)

    def _make_idle(self, end_s: float) -> None:
        """Have the camera connected and set, and no exposure running."""
        self.prepare(end_s)
        if self._client.ask(_EXPOSURE, end_s).state == "Busy":
            self._abort(end_s)

    def _await_frame(self, exposure_s: float, end_s: float) -> None:
        """Begin an exposure and wait for its frame and the driver's Ok."""
        what = f"expose for {exposure_s:g} s"
        before = self._client.request("Number", _EXPOSURE, {_EXPOSURE_VALUE: f"{exposure_s:.9g}"}, end_s)
        known = self._client.property(_EXPOSURE)

        def is_over() -> bool:
            if known.settings > before and known.state == "Alert":
                raise self._client.refusal(what)
            return _FRAME in self._client.blobs and known.settings > before and known.state != "Busy"

        self._client.wait(is_over, end_s, what)

    def _abort(self, end_s: float) -> None:
        """End the exposure that runs, whoever began it; its frame must not pass for the next one's."""
        self._client.request("Switch", "CCD_ABORT_EXPOSURE", {"ABORT": "On"}, end_s)
        self._client.wait(
            lambda: self._client.property(_EXPOSURE).state != "Busy", end_s, "abort the exposure that is running"
        )

    def _configure(self, end_s: float) -> None:
        """Ask for whole raw frames of the rig's size, and its gain."""
        client, camera = self._client, self._settings
        client.enable_blobs(end_s)
        for name, member in _SWITCHES:
            if name in client.properties and member in client.property(name).values:
                client.change("Switch", name, {member: "On"}, end_s)
        if "CCD_BINNING" in client.properties:
            client.change("Number", "CCD_BINNING", {"HOR_BIN": "1", "VER_BIN": "1"}, end_s)
        if "CCD_GAIN" in client.properties:
            client.change("Number", "CCD_GAIN", {"GAIN": f"{camera.gain_db:.9g}"}, end_s)
        wide, high = (int(client.number("CCD_INFO", axis)) for axis in ("CCD_MAX_X", "CCD_MAX_Y"))
        if camera.width_px > wide or camera.height_px > high:
            raise RefusedError(
                f"{client.name}: its sensor has {wide} x {high} px, but the rig file states {camera.width_px} "
                f"x {camera.height_px} px; correct width_px and height_px"
            )
        if self._wheel_device and self._snoops():
            client.change("Text", "ACTIVE_DEVICES", {"ACTIVE_FILTER": self._wheel_device}, end_s)
        # The middle of the sensor, at an even row and column so that the colour pattern stays.
        left, top = (wide - camera.width_px) // 4 * 2, (high - camera.height_px) // 4 * 2
        frame = {"X": left, "Y": top, "WIDTH": camera.width_px, "HEIGHT": camera.height_px}
        client.change("Number", "CCD_FRAME", {member: str(value) for member, value in frame.items()}, end_s)

    def _snoops(self) -> bool:
        """Whether the camera can be told which filter wheel its headers speak of."""
        known = self._client.properties.get("ACTIVE_DEVICES")
        return known is not None and "ACTIVE_FILTER" in known.values

    def _require_range(self, exposure_s: float) -> None:
        least_s, greatest_s = self._client.property(_EXPOSURE).ranges.get(_EXPOSURE_VALUE, (0.0, 0.0))
        if exposure_s <= 0.0 or (greatest_s > least_s and not least_s <= exposure_s <= greatest_s):
            raise RefusedError(
                f"{self._client.name}: cannot expose for {exposure_s:g} s, only for {least_s:g} to "
                f"{greatest_s:g} s; correct shortest_exposure_s and longest_exposure_s of the rig file"
            )


@contextmanager
def open_camera(settings: CameraSettings, folder: Path, wheel_device: str = "") -> Iterator[Camera]:
    """Open the camera at ``host:port/device`` for a ``with`` block, with the rig's frame size and gain.

    `wheel_device` is the filter wheel on the same server whose filter the frames' headers shall name.

    ``gain_db`` is written to the driver's GAIN as it is; each driver counts in its own unit.

    Raises
    ------
    RefusedError
        The address has another form, the driver cannot connect, or a setting reads back differently.
    TimedOutError
        The server has no such device, or the device is no camera.
    LostError
        No server listens at the address.
    """
    with IndiClient(settings.address, "camera", _EXPOSURE) as client:
        camera = IndiCamera(client, settings, wheel_device)
        camera.prepare(time.monotonic() + INDI_OPENS_WITHIN_S)
        yield camera


def found() -> list[tuple[str, str]]:
    """Return address and description of the cameras of an INDI server on this computer."""
    return local_indi_devices(CAMERA_INTERFACE)


BLOCK_BYTES: Final = 2880
CARD_BYTES: Final = 80
_LONGEST_HEADER_BYTES: Final = 100 * BLOCK_BYTES
_UNSIGNED_ZERO: Final = 32768.0
_TEXT: Final = re.compile(r"'((?:[^']|'')*)'")

CardValue = str | float | bool


@dataclass(frozen=True, slots=True)
class FitsImage:
    """Counts (DN), shape (H, W), rows as they are stored, and the values of the header's cards."""

    counts: NDArray[np.uint16]
    header: Mapping[str, CardValue]


def read_fits_image(data: bytes, name: str) -> FitsImage:
    """Return the primary image of a FITS file; `name` says where it is from, for messages.

    Raises
    ------
    BadFrameError
        The file is cut off or damaged.
    RefusedError
        It holds something else than one image of 16-bit whole numbers.
    """
    header, start = _header(data, name)
    unit = {key: header.get(key, default) for key, default in (("BZERO", 0.0), ("BSCALE", 1.0))}
    if (header.get("BITPIX"), header.get("NAXIS"), unit["BSCALE"]) != (16, 2, 1.0) or unit["BZERO"] not in (
        0.0,
        _UNSIGNED_ZERO,
    ):
        raise RefusedError(
            f"{name}: sends FITS with BITPIX {header.get('BITPIX')}, NAXIS {header.get('NAXIS')}, BSCALE "
            f"{unit['BSCALE']}, BZERO {unit['BZERO']}, but one raw image of 16-bit counts is needed (BITPIX 16, NAXIS "
            "2); choose a raw 16-bit capture format in the camera's driver"
        )
    width, height = (_length(header.get(axis)) for axis in ("NAXIS1", "NAXIS2"))
    if width * height == 0 or len(data) < start + 2 * width * height:
        raise BadFrameError(
            f"{name}: a frame of {width} x {height} px needs {2 * width * height} bytes after its header, but "
            f"only {len(data) - start} came; expose again"
        )
    stored = np.frombuffer(data, dtype=">u2", count=width * height, offset=start).reshape(height, width)
    # Stored values are signed; adding 32768 to them turns over their highest bit.
    highest_bit = np.uint16(0x8000)
    if unit["BZERO"] == _UNSIGNED_ZERO:
        counts = stored.astype(np.uint16) ^ highest_bit
    elif (stored & highest_bit).any():
        raise RefusedError(f"{name}: sends negative counts; choose a raw 16-bit capture format in the camera's driver")
    else:
        counts = stored.astype(np.uint16)
    return FitsImage(counts, header)


def _header(data: bytes, name: str) -> tuple[dict[str, CardValue], int]:
    """Return the cards up to END, and where the data starts."""
    header: dict[str, CardValue] = {}
    for at in range(0, min(len(data), _LONGEST_HEADER_BYTES), CARD_BYTES):
        card = data[at : at + CARD_BYTES].decode("ascii", "replace")
        key = card[:8].rstrip()
        if at == 0 and not card.startswith("SIMPLE  ="):
            break
        if key == "END":
            return header, -(-(at + CARD_BYTES) // BLOCK_BYTES) * BLOCK_BYTES
        if card[8:10] == "= " and (value := _value(card[10:])) is not None:
            header[key] = value
    raise BadFrameError(
        f"{name}: sends {data[:10]!r}..., which is not a FITS file with a complete header; expose again"
    )


def _value(field: str) -> CardValue | None:
    """Return the value of a card: text without the blanks at its end, number or truth value."""
    text = _TEXT.match(field.lstrip())
    if text:
        return text[1].replace("''", "'").rstrip()
    word = field.split("/")[0].strip()
    if word in ("T", "F"):
        return word == "T"
    try:
        return float(word.replace("D", "E"))
    except ValueError:
        return None


def _length(value: CardValue | None) -> int:
    """Return the length of an axis; 0 where it is none."""
    whole = isinstance(value, float) and value.is_integer() and 0.0 < value < 2**16
    return int(value) if whole and value is not None else 0


EXPOSURE_TOLERANCE_REL: Final = 0.01
"""Cameras expose in steps; a header that differs by more belongs to another exposure."""
_HEADER_DIGITS_REL: Final = 1e-5
# Settings that the record carries as the driver reads them back: name there, property, member.
_READ_BACK: Final = (
    ("gain", "CCD_GAIN", "GAIN"),
    ("black_level", "CCD_OFFSET", "OFFSET"),
    ("sensor_temperature_c", "CCD_TEMPERATURE", "CCD_TEMPERATURE_VALUE"),
)


class IndiFrames:
    """The check of one camera's frames; what was seen of earlier ones counts for the next.

    Parameters
    ----------
    client
        Connection to the camera.
    settings
        What the rig file says about it.
    """

    def __init__(self, client: IndiClient, settings: CameraSettings) -> None:
        self._client = client
        self._settings = settings
        self._last_time_s: float | None = None
        # Whether the camera was seen to use the low bits of its 16, which it does for good.
        self._right_aligned = settings.bit_depth == 16

    def checked(self, image: FitsImage, exposure_s: float, captured_utc: str) -> RawFrame:
        """Return a frame that is what was asked for.

        Raises
        ------
        FrameSizeError
            Its size is another.
        RefusedError
            Its exposure, gain or colour pattern is another, or its header does not tell.
        BadFrameError
            It was delivered before, or holds more counts than its bits allow.
        """
        header, name = image.header, self._client.name
        if image.counts.shape != (self._settings.height_px, self._settings.width_px):
            raise FrameSizeError(
                f"{name}: sent {image.counts.shape[1]} x {image.counts.shape[0]} px, but "
                f"{self._settings.width_px} x {self._settings.height_px} px were requested; check the frame "
                "and binning in the camera's driver"
            )
        read_back_s = _number(header, "EXPTIME", name)
        if abs(read_back_s - exposure_s) > EXPOSURE_TOLERANCE_REL * exposure_s:
            raise RefusedError(
                f"{name}: an exposure of {exposure_s:g} s was requested, but the frame's header states {read_back_s:g} "
                "s; make sure that no other program uses the camera"
            )
        gain = self._settings.gain_db
        if "GAIN" in header and abs(_number(header, "GAIN", name) - gain) > _HEADER_DIGITS_REL * max(1.0, gain):
            raise RefusedError(
                f"{name}: gain {gain:g} was requested, but the frame's header states {header['GAIN']}; make "
                "sure that no other program uses the camera"
            )
        device_time_s = self._require_new(header)
        return RawFrame(
            counts=self._right_align(image.counts),
            exposure_requested_s=exposure_s,
            exposure_s=read_back_s,
            captured_utc=captured_utc,
            device_time_s=device_time_s,
            settings=self._settings_read_back(header),
        )

    def _settings_read_back(self, header: Mapping[str, CardValue]) -> dict[str, str | float]:
        """Return what the driver and the header say beside the exposure."""
        client = self._client
        settings: dict[str, str | float] = {
            label: client.number(name, member) for label, name, member in _READ_BACK if name in client.properties
        }
        settings["pixel_format"] = self._pixel_format(header)
        # Which filter the driver believes in: only as true as ACTIVE_FILTER, which names the wheel it listens to.
        if "FILTER" in header:
            settings["filter_header"] = str(header["FILTER"])
        active = client.properties.get("ACTIVE_DEVICES")
        if active is not None and "ACTIVE_FILTER" in active.values:
            settings["active_filter"] = active.values["ACTIVE_FILTER"]
        return settings

    def _pixel_format(self, header: Mapping[str, CardValue]) -> Literal["BayerRG16", "Mono16"]:
        """Return the colour pattern; refuse one that the rig file does not mean."""
        pattern = header.get("BAYERPAT", "")
        offsets = [header.get(key, 0.0) for key in ("XBAYROFF", "YBAYROFF")]
        upside_down = header.get("ROWORDER", "TOP-DOWN") != "TOP-DOWN"
        if pattern not in ("", self._settings.bayer_pattern) or offsets != [0.0, 0.0] or upside_down:
            raise RefusedError(
                f"{self._client.name}: sends the colour pattern {pattern or 'none'} (offset {offsets[0]}, "
                f"{offsets[1]}, rows {header.get('ROWORDER', 'TOP-DOWN')}), but "
                f"{self._settings.bayer_pattern} from the top left is needed; choose a camera or a frame with "
                "this pattern"
            )
        return "BayerRG16" if pattern else "Mono16"

    def _require_new(self, header: Mapping[str, CardValue]) -> float | None:
        """Return the driver's time of the frame; refuse one that was delivered before."""
        try:
            taken = datetime.fromisoformat(str(header.get("DATE-OBS", "")))
        except ValueError:
            return None
        device_time_s = (taken if taken.tzinfo else taken.replace(tzinfo=UTC)).timestamp()
        if device_time_s == self._last_time_s:
            raise BadFrameError(f"{self._client.name}: sent the frame of {header['DATE-OBS']} twice; expose again")
        self._last_time_s = device_time_s
        return device_time_s

    def _right_align(self, counts: NDArray[np.uint16]) -> NDArray[np.uint16]:
        """Shift counts down whose lowest bits no pixel ever uses: fewer bits, left-aligned in 16."""
        depth = self._settings.bit_depth
        used = int(np.bitwise_or.reduce(counts, axis=None))
        if used & ((1 << (16 - depth)) - 1):
            self._right_aligned = True
        if not self._right_aligned:
            return counts >> np.uint16(16 - depth)
        if used >> depth:
            raise BadFrameError(
                f"{self._client.name}: sent counts up to {int(counts.max())} DN, but {depth} bits hold at "
                f"most {2**depth - 1} DN; correct bit_depth of the rig file"
            )
        return counts


def _number(header: Mapping[str, CardValue], key: str, name: str) -> float:
    """Return a finite number of the header."""
    value = header.get(key)
    if not isinstance(value, float) or not math.isfinite(value):
        raise RefusedError(
            f"{name}: {key} is missing from the frame's header, or is not a number; choose another "
            "INDI driver for the camera"
        )
    return value
