"""An open GenICam camera, by whichever library: what it must be able to do, and the frames that it delivers."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from data_schemas.devices import CameraSettings, DeviceIdentity
from data_schemas.errors import BadFrameError
from rigs.cameras.genicam import Features
from rigs.cameras.genicam_pixels import RawPixels

FIRMWARE_NAMES = ("DeviceFirmwareVersion", "DeviceVersion")


@dataclass(frozen=True, slots=True)
class Delivered:
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
    """An open camera; every method may raise :class:`~rigs.cameras.genicam.FeatureError`."""

    def identity(self) -> DeviceIdentity:
        """Read what the camera is."""
        ...

    def prepare(self) -> None:
        """Get ready to acquire frames with the settings of now."""
        ...

    def acquire(self, limit_s: float) -> Delivered | None:
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


def image(delivered: Delivered, pixels: RawPixels, camera: str) -> NDArray[np.uint16]:
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
            f"{camera}: frame {delivered.frame_id} holds {delivered.content.size} bytes; {shape[0]} x {shape[1]} px of "
            f"{pixels.name} need {needed}"
        )
    return delivered.content[:needed].view(pixels.container).reshape(shape).astype(np.uint16)
