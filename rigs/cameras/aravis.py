"""GenICam cameras through Aravis: USB3 Vision and GigE Vision."""

import time
from contextlib import AbstractContextManager, suppress
from ipaddress import ip_address
from pathlib import Path
from typing import Final

from data_schemas.devices import CameraSettings, DeviceIdentity
from data_schemas.errors import LostError, RefusedError
from rigs.cameras.aravis_device import AravisDevice, AravisStream
from rigs.cameras.aravis_library import Aravis, load_aravis
from rigs.cameras.genicam import ConnectionBrokenError
from rigs.cameras.genicam_camera import GenicamCamera, opened_camera
from rigs.cameras.genicam_device import Delivered, firmware_of, name_of

# A camera that ignores SingleFrame may be sending its next frame when it is told to stop (2.6 MB take 21 ms on gigabit
# Ethernet); what is left of it must not meet the buffer of the next exposure.
SETTLE_S: Final = 0.025


class AravisCamera(AravisDevice):
    """A camera opened by Aravis; a buffer is there only while a frame is wanted.

    Parameters
    ----------
    library
        The loaded Aravis.
    name, address
        Aravis' name of the camera, and its address in the rig file.
    """

    def __init__(self, library: Aravis, name: str, address: str) -> None:
        super().__init__(library, name)
        self._address = address
        self._stream: AravisStream | None = None

    def identity(self) -> DeviceIdentity:
        """Read what the camera is."""
        return DeviceIdentity(
            role="camera",
            driver="aravis",
            address=self._address,
            vendor=self.about("vendor_name"),
            model=self.about("model_name"),
            serial=self.about("device_serial_number"),
            firmware=firmware_of(self),
        )

    def prepare(self) -> None:
        """Open the stream; its buffers have the size of the frames that are set now."""
        self.set_text("AcquisitionMode", "SingleFrame")
        self._stream = self.stream()

    def acquire(self, limit_s: float) -> Delivered | None:
        """Take one frame."""
        if self._stream is None:
            raise ConnectionBrokenError("the stream is closed")
        self._stream.offer_buffer()
        self.execute("AcquisitionStart")
        delivered = self._stream.next_buffer(limit_s)
        if delivered is not None:
            self.execute("AcquisitionStop")
            time.sleep(SETTLE_S)
        return delivered

    def close(self) -> None:
        """Free the stream, then the camera."""
        if self._stream is not None:
            self._stream.close()
            self._stream = None
        super().close()


def open_camera(settings: CameraSettings, folder: Path) -> AbstractContextManager[GenicamCamera]:
    """Return the camera, open for a ``with`` block; its address is a name, serial number or IP address.

    Raises
    ------
    MissingExtraError
        Aravis is not installed.
    """
    library, address, where = load_aravis(), settings.address, name_of(settings)
    return opened_camera(settings, lambda: AravisCamera(library, _name(library, address, where), address))


def found() -> list[tuple[str, str]]:
    """List the cameras in reach: address, and what each is; takes about a second."""
    return [(d.name, f"{d.vendor} {d.model}, serial {d.serial}, at {d.address}") for d in load_aravis().devices()]


def _name(library: Aravis, address: str, where: str) -> str:
    """Return the name by which Aravis opens the camera of the rig file."""
    with suppress(ValueError):
        return str(ip_address(address))
    listed = library.devices()
    names = [d.name for d in listed if address in (d.name, d.serial, d.model)]
    if len(names) == 1:
        return names[0]
    seen = ", ".join(f"{d.name} ({d.model}, serial {d.serial})" for d in listed) or "no camera at all"
    if names:
        raise RefusedError(
            f"{where}: this address fits several cameras; Aravis sees {seen}: give the serial number as address in the "
            "rig file"
        )
    raise LostError(
        f"{where}: is not there; Aravis sees {seen}: check cable and power, on Linux the access rights of the USB "
        "device, and the address in the rig file (a camera's name, serial number or IP address)"
    )
