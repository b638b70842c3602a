"""Which Alpaca devices are in reach: servers on this computer and its network answer a broadcast with their port.

Source: ASCOM Alpaca API reference, version 1, chapters on discovery (UDP port 32227) and on the management interface
(``GET /management/v1/configureddevices``).
"""

import contextlib
import json
import socket
import time
from collections.abc import Iterator
from http.client import HTTPException
from typing import Final, NamedTuple

from rigs.transports.timed_http import TimedConnection

DISCOVERY_PORT: Final = 32227
QUESTION: Final = b"alpacadiscovery1"
ANSWER_WITHIN_S: Final = 1.0
LIST_WITHIN_S: Final = 2.0
LARGEST_LIST_BYTES: Final = 2**18


class AlpacaDevice(NamedTuple):
    """A device that a server offers: where, of what kind in lower case, its number there and its name."""

    server: str
    kind: str
    number: int
    name: str


def alpaca_devices() -> list[AlpacaDevice]:
    """Return the devices of all servers that answer; takes about a second. Nothing is connected or switched."""
    return [device for host, port in sorted(_servers()) for device in _devices_of(host, port)]


def _servers() -> set[tuple[str, int]]:
    """Return host and port of the servers that answer the broadcast."""
    servers: set[tuple[str, int]] = set()
    end_s = time.monotonic() + ANSWER_WITHIN_S
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as line:
        line.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
        for address in ("127.0.0.1", "255.255.255.255"):
            with contextlib.suppress(OSError):  # a computer without a network
                line.sendto(QUESTION, (address, DISCOVERY_PORT))
        while (left_s := end_s - time.monotonic()) > 0.0:
            line.settimeout(left_s)
            try:
                answer, (host, _) = line.recvfrom(1024)
                port = json.loads(answer)["AlpacaPort"]
            except (
                OSError,
                ValueError,
                RecursionError,
                KeyError,
                TypeError,
            ):  # no server of this kind
                continue
            if isinstance(port, int) and 0 < port < 2**16:
                servers.add((host, port))
    return servers


def _devices_of(host: str, port: int) -> Iterator[AlpacaDevice]:
    """List what a server offers; one that does not answer as it should offers nothing."""
    try:
        connection = TimedConnection(host, port, time.monotonic() + LIST_WITHIN_S)
        with contextlib.ExitStack() as ending:
            ending.callback(connection.hang_up)
            connection.request("GET", "/management/v1/configureddevices?ClientID=1&ClientTransactionID=1")
            listed = json.loads(connection.getresponse().read(LARGEST_LIST_BYTES))["Value"]
        for device in listed:
            kind, number, name = device["DeviceType"], device["DeviceNumber"], device["DeviceName"]
            yield AlpacaDevice(f"http://{host}:{port}", str(kind).lower(), int(number), str(name))
    except (OSError, HTTPException, ValueError, RecursionError, KeyError, TypeError):
        return
