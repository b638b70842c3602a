"""A camera behind an INDI server: raw 16-bit frames as FITS, every setting compared with the frame's own header."""

import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import Final

from data_schemas.devices import CameraSettings, DeviceIdentity
from data_schemas.errors import CaptureError, RefusedError, TimedOutError
from rigs.cameras.fits_image import read_fits_image
from rigs.cameras.indi_frames import IndiFrames
from rigs.protocols import Camera, RawFrame
from rigs.transports.indi_client import OPEN_WITHIN_S, IndiClient
from rigs.transports.indi_messages import blob_bytes
from rigs.transports.indi_server import CAMERA_INTERFACE, found_on_this_computer

ABORT_WITHIN_S: Final = 1.0
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

    def prepare(self, end_s: float) -> None:
        """Connect where there is no connection, and then set what every frame needs."""
        if not self._client.ready(end_s):
            return
        try:
            self._configure(end_s)
        except CaptureError:
            # The next call starts over, rather than expose with half of the settings.
            self._client.close()
            raise

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
        self.prepare(end_s)
        self._require_range(exposure_s)
        if self._client.ask(_EXPOSURE, end_s).state == "Busy":
            self._abort(end_s)
        self._client.blobs.pop(_FRAME, None)
        captured_utc = datetime.now(UTC).isoformat(timespec="milliseconds")
        try:
            self._await_frame(exposure_s, end_s)
        except TimedOutError:
            with suppress(TimedOutError):
                self._abort(time.monotonic() + ABORT_WITHIN_S)
            raise
        blob = self._client.blobs.pop(_FRAME)
        if blob.attributes.get("format") not in (".fits", ".fits.z"):
            raise RefusedError(
                f"{self._client.name}: sends frames as '{blob.attributes.get('format', '')[:16]}', .fits is needed; "
                "set the driver's transfer format to FITS and its compression off"
            )
        image = read_fits_image(blob_bytes(blob, self._client.name), self._client.name)
        return self._frames.checked(image, exposure_s, captured_utc)

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
                f"{client.name}: its sensor has {wide} x {high} px, the rig file asks for {camera.width_px} x "
                f"{camera.height_px} px; correct width_px and height_px"
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
                f"{self._client.name}: cannot expose for {exposure_s:g} s, {least_s:g} to {greatest_s:g} s are "
                "allowed; correct shortest_exposure_s and longest_exposure_s of the rig file"
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
        camera.prepare(time.monotonic() + OPEN_WITHIN_S)
        yield camera


def found() -> list[tuple[str, str]]:
    """Return address and description of the cameras of an INDI server on this computer."""
    return found_on_this_computer(CAMERA_INTERFACE)
