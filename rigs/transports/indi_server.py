"""Where INDI devices are: addresses, connections to servers, and the devices that a server has."""

import contextlib
import socket
import time
from typing import Final, NamedTuple

from data_schemas.errors import LostError, RefusedError, TimedOutError
from rigs.transports.indi_messages import IndiReader, get_properties

DEFAULT_PORT: Final = 7624
CAMERA_INTERFACE: Final = 1 << 1
FILTER_WHEEL_INTERFACE: Final = 1 << 4
LIGHT_INTERFACE: Final = 1 << 10
_LISTING_S: Final = 0.5
_RECEIVE_BYTES: Final = 2**16


class IndiAddress(NamedTuple):
    """Where a device is: host and port of its server, and its name there."""

    host: str
    port: int
    device: str


def indi_address(address: str, role: str) -> IndiAddress:
    """Take ``host:port/device`` apart; the port may be left out.

    Raises
    ------
    RefusedError
        It has no such form.
    """
    server, _, device = address.partition("/")
    host, colon, port = server.rpartition(":")
    host, port = (host, port) if colon else (server, str(DEFAULT_PORT))
    if not (
        host and device.strip() and port.isascii() and port.isdecimal() and len(port) < 6 and 0 < int(port) < 2**16
    ):
        raise RefusedError(
            f"{role}: '{address}' is no INDI address; write host:port/device name, such as "
            f"localhost:{DEFAULT_PORT}/Filter Simulator"
        )
    return IndiAddress(host, int(port), device.strip())


def devices_at(where: IndiAddress, end_s: float) -> dict[str, int]:
    """Return the devices of a server with the kinds of their interfaces (bits of DRIVER_INTERFACE)."""
    found: dict[str, int] = {}
    reader = IndiReader(f"INDI server at {where.host}:{where.port}")
    with contextlib.suppress(OSError, LostError, TimedOutError), open_socket(where, "INDI server", end_s) as server:
        server.sendall(get_properties())
        while (left_s := end_s - time.monotonic()) > 0.0:
            server.settimeout(min(left_s, _LISTING_S))
            data = server.recv(_RECEIVE_BYTES)
            if not data:
                break
            for message in reader.feed(data):
                if message.device and message.tag.startswith("def"):
                    kinds = {element.name: element.text for element in message.elements}.get("DRIVER_INTERFACE", "0")
                    bits = int(kinds) if kinds.isascii() and kinds.isdecimal() and len(kinds) < 10 else 0
                    found[message.device] = found.get(message.device, 0) | bits
    return found


def found_on_this_computer(interface: int) -> list[tuple[str, str]]:
    """Return address and description of the devices with an interface at the default port of this computer."""
    where = IndiAddress("localhost", DEFAULT_PORT, "")
    devices = devices_at(where, time.monotonic() + 2 * _LISTING_S)
    return [
        (f"{where.host}:{where.port}/{device}", f"INDI device {device}")
        for device, kinds in sorted(devices.items())
        if kinds & interface
    ]


def open_socket(where: IndiAddress, name: str, end_s: float) -> socket.socket:
    """Connect to a server."""
    try:
        opened = socket.create_connection((where.host, where.port), max(end_s - time.monotonic(), 1e-3))
    except TimeoutError as error:
        raise TimedOutError(
            f"{name}: {where.host} did not answer; check that the computer runs and its firewall lets port "
            f"{where.port} through"
        ) from error
    except (OSError, UnicodeError) as error:  # a host name that cannot be one fails to be encoded
        raise LostError(
            f"{name}: nothing listens at {where.host}:{where.port} ({error}); start indiserver, or correct the address"
        ) from error
    opened.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    return opened
