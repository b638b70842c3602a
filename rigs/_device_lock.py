"""One capture at a time has a device, whatever its address is called: ``with rig_locked(rig):``.

A lock goes by what an address leads to. Serial ports count by the device's number, so that every link to one is the
same; servers by every network address that their name resolves to, where all addresses of this computer are one. A
lock is a name in the kernel's table of abstract sockets: it holds for all users and vanishes with its process. What two
names share behind another computer (a tunnel, a forwarded port) cannot be seen from here. A camera with several names
(its serial number, its network address) refuses a second program by itself.
"""

import errno
import hashlib
import ipaddress
import os
import socket
import stat
import struct
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from typing import Final
from urllib.parse import urlsplit

from data_schemas import NO_ADDRESS, CaptureError, RefusedError, RigFile
from rigs.transports import indi_address

THIS_COMPUTER: Final = "this computer"
_PORT_WRAPPERS: Final = ("spy", "alt")
"""Schemes of pyserial that hold the path of a port: ``spy:///dev/ttyUSB0``."""
_CREDENTIALS: Final = struct.Struct("3i")
"""Process, user and group of the other end of a socket."""


def device_keys(driver: str, address: str) -> frozenset[str]:
    """Return names of the device behind an address; two addresses that share one lead to the same device.

    Parameters
    ----------
    driver, address
        As in the rig file. What is no address counts as it is written: opening the device tells what is wrong.
    """
    if driver == "indi":
        with suppress(RefusedError):
            where = indi_address(address, "device")
            return frozenset(f"{host}:{where.port}/{where.device}" for host in _hosts(where.host))
    try:
        parts = urlsplit(address)
        host, port = parts.hostname, parts.port or (80 if parts.scheme == "http" else 0)
    except ValueError:
        return frozenset({f"{driver} {address}"})
    if parts.scheme and host:
        pieces = [piece.lstrip("0") or "0" if piece.isdecimal() else piece for piece in parts.path.split("/") if piece]
        path = "/".join(pieces) + (f"?{parts.query}" if parts.query else "")
        return frozenset(f"{name}:{port}/{path}" for name in _hosts(host))
    path = parts.path if parts.scheme in _PORT_WRAPPERS else address
    return frozenset({_port_key(path) or f"{driver} {address.strip()}"})


def _port_key(path: str) -> str | None:
    """Return the number of a port on this computer, or its real path where there is none; None where it is no path."""
    if "/" not in path:
        return None
    try:
        found = os.stat(path)
    except (OSError, ValueError):
        return os.path.realpath(path) if path.startswith("/") and "\0" not in path else None
    if stat.S_ISCHR(found.st_mode):
        return f"character device {os.major(found.st_rdev)}:{os.minor(found.st_rdev)}"
    return os.path.realpath(path)


def _hosts(name: str) -> set[str]:
    """Return the network addresses of a computer; its name where that is unknown, which opening the device tells."""
    try:
        found = socket.getaddrinfo(name, None, type=socket.SOCK_STREAM)
    except (OSError, UnicodeError):
        return {name.rstrip(".").casefold()}
    return {_host_key(str(entry[4][0]).partition("%")[0]) for entry in found}


def _host_key(text: str) -> str:
    """Return a network address; those of this computer have one name."""
    address = ipaddress.ip_address(text)
    address = getattr(address, "ipv4_mapped", None) or address
    if address.is_loopback or address.is_unspecified:
        return THIS_COMPUTER
    with socket.socket(socket.AF_INET if address.version == 4 else socket.AF_INET6, socket.SOCK_DGRAM) as probe:
        try:
            probe.bind((str(address), 0))  # the kernel takes addresses of its own only
        except OSError:
            return str(address)
    return THIS_COMPUTER


@contextmanager
def rig_locked(rig: RigFile) -> Iterator[None]:
    """Hold the locks of all devices of a rig for a ``with`` block; a camera and its own INDI wheel share one.

    Raises
    ------
    CaptureError
        Another process holds one.
    RefusedError
        Two addresses of the rig lead to one device that cannot be both.
    """
    devices = {
        "camera": (rig.camera.driver, rig.camera.address),
        "filter wheel": (rig.filter_wheel.driver, rig.filter_wheel.address),
        "laser": (rig.laser.driver, rig.laser.address),
        "lamp": (rig.lamp.driver, rig.lamp.address),
    }
    holders: dict[str, str] = {}
    with ExitStack() as stack:
        for role, (driver, address) in devices.items():
            keys = _keys_to_lock(driver, address)
            for holder in {holders[key] for key in keys & holders.keys()}:
                if driver != "indi" or {holder, role} == {"laser", "lamp"}:
                    raise RefusedError(
                        f"{holder} at {devices[holder][1]} and {role} at {address} are one and the same device; "
                        "correct the address of one of them in the rig file"
                    )
            for key in sorted(keys - holders.keys()):
                stack.enter_context(_locked(key, role, driver, address))
            holders |= dict.fromkeys(keys, role)
        yield


@contextmanager
def device_locked(role: str, driver: str, address: str) -> Iterator[None]:
    """Hold the lock of one device for a ``with`` block; what is no device, such as a folder of images, has none.

    Raises
    ------
    CaptureError
        Another process holds it.
    """
    with ExitStack() as stack:
        for key in sorted(_keys_to_lock(driver, address)):
            stack.enter_context(_locked(key, role, driver, address))
        yield


def _keys_to_lock(driver: str, address: str) -> frozenset[str]:
    return frozenset() if driver in (*NO_ADDRESS, "folder") else device_keys(driver, address)


@contextmanager
def _locked(key: str, role: str, driver: str, address: str) -> Iterator[None]:
    """Hold one name for a ``with`` block."""
    name = f"\0finray-calib device {hashlib.sha256(key.encode()).hexdigest()}"
    with socket.socket(socket.AF_UNIX) as lock:
        try:
            lock.bind(name)
        except OSError as error:
            if error.errno != errno.EADDRINUSE:
                raise
            raise CaptureError(
                f"{role}: {driver} at {address} is in use by another capture (process {_holder(name)}); wait until it "
                "ends"
            ) from None
        lock.listen(socket.SOMAXCONN)  # each who asks for the holder takes a place for good
        yield


def _holder(name: str) -> str:
    """Return the process that holds a name."""
    with socket.socket(socket.AF_UNIX) as line:
        line.settimeout(1.0)
        try:
            line.connect(name)
            told = line.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _CREDENTIALS.size)
        except OSError:  # it has just ended
            return "unknown"
    return str(_CREDENTIALS.unpack(told)[0])
