"""Frames of an INDI camera against what was asked for: size, exposure, gain, colour pattern, bits, each one new."""

from collections.abc import Mapping
from datetime import UTC, datetime
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from data_schemas.devices import CameraSettings
from data_schemas.errors import BadFrameError, FrameSizeError, RefusedError
from rigs.cameras.fits_image import CardValue, FitsImage
from rigs.protocols import RawFrame
from rigs.transports.indi_client import IndiClient

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
                f"{name}: sent {image.counts.shape[1]} x {image.counts.shape[0]} px, {self._settings.width_px} x "
                f"{self._settings.height_px} px were asked for; check the frame and binning in the camera's driver"
            )
        read_back_s = _number(header, "EXPTIME", name)
        if abs(read_back_s - exposure_s) > EXPOSURE_TOLERANCE_REL * exposure_s:
            raise RefusedError(
                f"{name}: {exposure_s:g} s were asked for, the frame's header says {read_back_s:g} s; see that no "
                "other program uses the camera"
            )
        gain = self._settings.gain_db
        if "GAIN" in header and abs(_number(header, "GAIN", name) - gain) > _HEADER_DIGITS_REL * max(1.0, gain):
            raise RefusedError(
                f"{name}: gain {gain:g} was asked for, the frame's header says {header['GAIN']}; see that no other "
                "program uses the camera"
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
                f"{offsets[1]}, rows {header.get('ROWORDER', 'TOP-DOWN')}), {self._settings.bayer_pattern} from the "
                "top left is needed; choose a camera or a frame with this pattern"
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
                f"{self._client.name}: sent counts up to {int(counts.max())} DN, {depth} bits hold {2**depth - 1} DN; "
                "correct bit_depth of the rig file"
            )
        return counts


def _number(header: Mapping[str, CardValue], key: str, name: str) -> float:
    """Return a number of the header."""
    value = header.get(key)
    if not isinstance(value, float):
        raise RefusedError(f"{name}: the frame's header states no {key}; choose another INDI driver for the camera")
    return value
