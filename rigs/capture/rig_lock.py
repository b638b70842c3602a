"""One capture per device: a lock file for each, named after its driver and address."""

import fcntl
import hashlib
import os
import tempfile
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

from data_schemas.devices import NO_ADDRESS
from data_schemas.errors import CaptureError
from data_schemas.rig import RigFile


@contextmanager
def rig_locked(rig: RigFile) -> Iterator[None]:
    """Hold the locks of all devices of a rig for a ``with`` block.

    They are advisory locks of the operating system: they vanish with their process, however it ends.

    Raises
    ------
    CaptureError
        Another process holds one.
    """
    devices = {
        "camera": (rig.camera.driver, rig.camera.address),
        "filter wheel": (rig.filter_wheel.driver, rig.filter_wheel.address),
        "laser": (rig.laser.driver, rig.laser.address),
        "lamp": (rig.lamp.driver, rig.lamp.address),
    }
    with ExitStack() as stack:
        for role, (driver, address) in devices.items():
            stack.enter_context(device_locked(role, driver, address))
        yield


@contextmanager
def device_locked(role: str, driver: str, address: str) -> Iterator[None]:
    """Hold the lock of one device for a ``with`` block; what is no device, such as a folder of images, has none.

    Raises
    ------
    CaptureError
        Another process holds it.
    """
    if driver in (*NO_ADDRESS, "folder"):
        yield
        return
    # /dev/serial/by-id/... leads to /dev/ttyUSB0
    device = os.path.realpath(address) if address.startswith("/") else address
    name = hashlib.sha256(f"{driver} {device}".encode()).hexdigest()[:16]
    path = Path(tempfile.gettempdir()) / f"finray-{os.getuid()}-{name}.lock"
    handle = os.open(path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o600)
    try:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            holder = os.read(handle, 32).decode("ascii", "replace").strip() or "unknown"
            raise CaptureError(
                f"{role}: {driver} at {address} is in use by another capture (process {holder}); wait until it ends"
            ) from None
        os.ftruncate(handle, 0)
        os.pwrite(handle, f"{os.getpid()}\n".encode(), 0)
        yield
    finally:
        os.close(handle)
