"""GenICam cameras of any make through the maker's own GenTL producer (a .cti file) and harvesters."""

import os
import time
from collections.abc import Callable
from contextlib import AbstractContextManager, suppress
from pathlib import Path
from typing import Any, Final, TypeVar

import numpy as np

from data_schemas import CameraSettings, DeviceIdentity, LostError, MissingExtraError, RefusedError
from rigs.cameras._genicam import (
    ConnectionBrokenError,
    DeliveredFrame,
    FeatureError,
    GenicamCamera,
    firmware_of,
    name_of,
    opened_camera,
)

T = TypeVar("T")
NS_PER_S: Final = 1e9
_NOTHING: Final = np.empty(0, dtype=np.uint8)
READ_ONLY, READ_WRITE = 3, 4
"""Access modes of GenApi that allow to read."""
PRODUCERS_VARIABLE: Final = "GENICAM_GENTL64_PATH"
"""Where installers of GenTL producers for 64 bits put their folders (GenTL standard, chapter 2)."""


class GentlCamera:
    """A camera of a GenTL producer.

    Acquisition is started and stopped for every frame; harvesters flushes and announces its buffers afresh, so that no
    older frame is left.

    Parameters
    ----------
    producer
        The .cti file.
    serial
        Serial number of the camera; empty for the only one.
    address, where
        Address in the rig file, and name in messages.
    """

    def __init__(self, producer: Path, serial: str, address: str, where: str) -> None:
        self._harvester = _harvester(producer, where)
        self._address = address
        try:
            self._about = _one_of(self._harvester.device_info_list, serial, where)
            self._acquirer = _asked(lambda: self._harvester.create(self._about))
        except BaseException:
            self._harvester.reset()
            raise
        self._nodes = self._acquirer.remote_device.node_map

    def has(self, name: str) -> bool:
        """Return whether the camera has this feature now and lets it be read."""
        if not _asked(lambda: self._nodes.has_node(name)):
            return False
        return int(_asked(lambda: self._nodes.get_node(name).get_access_mode())) in (READ_ONLY, READ_WRITE)

    def entries(self, name: str) -> tuple[str, ...]:
        """Return what an enumeration can be set to."""
        return tuple(str(entry) for entry in _asked(lambda: self._node(name).symbolics))

    def text(self, name: str) -> str:
        """Read an enumeration or string."""
        return str(_asked(lambda: self._node(name).value))

    def number(self, name: str) -> float:
        """Read a number."""
        return float(_asked(lambda: self._node(name).value))

    def is_on(self, name: str) -> bool:
        """Read a switch."""
        return bool(_asked(lambda: self._node(name).value))

    def bounds(self, name: str) -> tuple[float, float]:
        """Return the smallest and largest value of a number."""
        return _asked(lambda: (float(self._node(name).min), float(self._node(name).max)))

    def set_text(self, name: str, value: str) -> None:
        """Write an enumeration or string."""
        self._write(name, value)

    def set_number(self, name: str, value: float) -> None:
        """Write a number."""
        is_integer = isinstance(_asked(lambda: self._node(name).value), int)
        self._write(name, round(value) if is_integer else float(value))

    def switch(self, name: str, on: bool) -> None:
        """Write a switch."""
        self._write(name, on)

    def identity(self) -> DeviceIdentity:
        """Read what the camera is."""
        about = self._about
        return DeviceIdentity(
            role="camera",
            driver="gentl",
            address=self._address,
            vendor=about.vendor,
            model=about.model,
            serial=about.serial_number,
            firmware=firmware_of(self),
        )

    def prepare(self) -> None:
        """Have each acquisition end after one frame, where the camera can."""
        if self.has("AcquisitionMode") and "SingleFrame" in self.entries("AcquisitionMode"):
            self.set_text("AcquisitionMode", "SingleFrame")

    def acquire(self, limit_s: float) -> DeliveredFrame | None:
        """Start an acquisition, return its first frame (None after `limit_s` seconds) and stop it."""
        _asked(self._acquirer.start)
        try:
            end_s = time.monotonic() + limit_s
            buffer = _asked(lambda: self._acquirer.try_fetch(timeout=limit_s))
            if buffer is None:  # harvesters drops a frame that is not whole, and returns before the time is up
                return None if time.monotonic() >= end_s else DeliveredFrame("incomplete", 0, 0.0, 0, 0, _NOTHING)
            try:
                return _asked(lambda: _copied(buffer))
            finally:
                _asked(buffer.queue)
        finally:
            _asked(self._acquirer.stop)

    def close(self) -> None:
        """Close the camera and its producer."""
        with suppress(FeatureError):
            _asked(self._acquirer.destroy)
        self._harvester.reset()

    def _node(self, name: str) -> Any:
        return self._nodes.get_node(name)

    def _write(self, name: str, value: str | float | bool) -> None:
        def write() -> None:
            self._node(name).value = value

        _asked(write)


def open_camera(settings: CameraSettings, folder: Path) -> AbstractContextManager[GenicamCamera]:
    """Return a camera, open for a ``with`` block; its address is ``PRODUCER.cti`` or ``PRODUCER.cti#SERIAL``.

    Raises
    ------
    MissingExtraError
        harvesters is not installed.
    """
    path, _, serial = settings.address.partition("#")
    where = name_of(settings)
    return opened_camera(settings, lambda: GentlCamera(folder / path, serial, settings.address, where))


def found() -> list[tuple[str, str]]:
    """List the cameras of the producers that the camera makers' software has installed: address, and what each is."""
    seen = []
    for folder in filter(None, os.environ.get(PRODUCERS_VARIABLE, "").split(os.pathsep)):
        for producer in sorted(Path(folder).glob("*.cti")):
            with suppress(RefusedError):  # one of another kind of computer must not hide the others
                harvester = _harvester(producer, "camera (gentl)")
                try:
                    seen += [
                        (f"{producer}#{d.serial_number}", f"{d.vendor} {d.model}, serial {d.serial_number}")
                        for d in harvester.device_info_list
                    ]
                finally:
                    harvester.reset()
    return seen


def _harvester(producer: Path, where: str) -> Any:
    """Load a producer."""
    try:
        from harvesters.core import Harvester
    except ImportError as error:
        raise MissingExtraError(
            f"camera driver 'gentl' needs harvesters ({error}); install it with pip install 'finray-calib[gentl]'"
        ) from None
    if not producer.is_file():
        raise RefusedError(
            f"{where}: the producer {producer} does not exist; give the .cti file that came with the camera's "
            "software as the address in the rig file"
        )
    harvester = Harvester()
    try:
        harvester.add_file(str(producer), check_validity=True)
        _asked(harvester.update)
    except (FeatureError, OSError) as error:
        harvester.reset()
        raise RefusedError(
            f"{where}: {producer} cannot be loaded ({error}); install the camera's software for this kind of computer"
        ) from error
    return harvester


def _one_of(listed: Any, serial: str, where: str) -> Any:
    """Return the camera with a serial number, or the only one."""
    fitting = [device for device in listed if not serial or device.serial_number == serial]
    if len(fitting) == 1:
        return fitting[0]
    seen = ", ".join(f"{d.vendor} {d.model} serial '{d.serial_number}'" for d in listed) or "no camera at all"
    if fitting:
        raise RefusedError(
            f"{where}: the producer lists several cameras ({seen}); add '#' and the serial number of one camera to "
            "the address in the rig file"
        )
    raise LostError(
        f"{where}: was not found (the producer lists {seen}); check cable, power, and the serial number after '#' in "
        "the address of the rig file"
    )


def _asked(function: Callable[[], T]) -> T:
    """Call the library and turn its exceptions into ours."""
    import genicam.genapi
    import genicam.gentl

    broken = (
        genicam.genapi.TimeoutException,
        genicam.gentl.TimeoutException,
        genicam.gentl.IoException,
        genicam.gentl.ClosedException,
        genicam.gentl.InvalidHandleException,
    )
    try:
        return function()
    except broken as error:
        raise ConnectionBrokenError(str(error)) from error
    except (genicam.genapi.GenericException, genicam.gentl.GenericException, AttributeError, ValueError) as error:
        raise FeatureError(str(error)) from error


def _copied(buffer: Any) -> DeliveredFrame:
    """Copy a whole frame out of the producer's memory."""
    parts = buffer.payload.components
    if not parts:
        return DeliveredFrame("no image in the buffer", _number(buffer), 0.0, 0, 0, _NOTHING)
    content = np.array(parts[0].data).view(np.uint8).ravel()
    return DeliveredFrame("", _number(buffer), _time_s(buffer), int(parts[0].width), int(parts[0].height), content)


def _number(buffer: Any) -> int:
    """Return the number of a frame, 0 where the producer gives none."""
    try:
        return int(_asked(lambda: buffer.module.frame_id))
    except FeatureError:
        return 0


def _time_s(buffer: Any) -> float:
    """Return the camera's time of a frame (s), 0 where it gives none."""
    try:
        return float(_asked(lambda: buffer.timestamp_ns)) / NS_PER_S
    except FeatureError:
        return 0.0
