"""ASCOM Alpaca: which devices are in reach, and requests to one of them, each with one deadline for all of it.

Servers on this computer and its network answer a broadcast (UDP port 32227) with their port and list their devices
(``GET /management/v1/configureddevices``); a device answers in JSON over HTTP.
Source: ASCOM Alpaca API reference, version 1: ``GET`` and ``PUT /api/v1/{device type}/{number}/{member}``.
"""

import contextlib
import itertools
import json
import os
import socket
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack
from http.client import HTTPException
from typing import Any, Final, Literal, NamedTuple, TypeVar
from urllib.parse import urlencode, urlsplit

from data_schemas import DeviceIdentity, LostError, RefusedError, TimedOutError, system_words
from rigs.transports._repeated_exchange import repeated
from rigs.transports._timed_http import TimedConnection

T = TypeVar("T")
ALPACA_OPENS_WITHIN_S: Final = 15.0
POLL_S: Final = 0.02
GET_ATTEMPT_S: Final = 2.0
PUT_ATTEMPT_S: Final = 8.0
"""Some servers answer to a move when it has ended."""
LARGEST_ANSWER_BYTES: Final = 2**16
_NOT_CONNECTED: Final = 0x407
_ERRORS: Final = {
    0x400: "not implemented",
    0x401: "invalid value",
    0x402: "value not set",
    _NOT_CONNECTED: "not connected",
    0x40B: "invalid operation",
    0x40C: "action not implemented",
    0x40E: "operation cancelled",
}
# Servers tell clients apart by it; two programs of one user differ by their process.
_CLIENT_ID: Final = 1 + os.getpid() % 65535


class AlpacaAddress(NamedTuple):
    """Where a device is: host and port of the server, and the path behind it."""

    host: str
    port: int
    path: tuple[str, ...]


def alpaca_address(address: str, role: str, form: str) -> AlpacaAddress:
    """Split ``http://host:port/...``; `form` says how this kind of device is written, for the message.

    Raises
    ------
    RefusedError
        It has no such form.
    """
    try:
        parts = urlsplit(address)
        host, port = parts.hostname, parts.port or 0
    except ValueError:
        host, port = None, 0
    path = tuple(piece for piece in parts.path.split("/") if piece) if host else ()
    if not host or not port or parts.scheme != "http" or not path or parts.query or parts.fragment:
        raise RefusedError(f"{role}: '{address}' is not an Alpaca address; write {form}")
    return AlpacaAddress(host, port, path)


def device_number(text: str) -> int | None:
    """Return the number of a device or switch; None where there is none."""
    return int(text) if text.isascii() and text.isdecimal() and len(text) < 10 else None


class AlpacaClient:
    """One device of an Alpaca server.

    Requests are repeated within their deadline, but for those that say ``once``. After a fault the device is connected
    again where its server has forgotten it. Instants `end_s` are readings of :func:`time.monotonic`.

    Parameters
    ----------
    where
        Host and port of the server.
    device_type, number
        Kind of the device (``filterwheel``) and its number there.
    name
        Role and address, for messages.

    Attributes
    ----------
    connections
        How often the server was found to have no connection to its device: it was restarted, and the device may have
        moved.
    """

    def __init__(self, where: AlpacaAddress, device_type: str, number: int, name: str) -> None:
        self.name = name
        self.connections = 0
        self._is_doubtful = False
        self._model: str | None = None
        self._host, self._port = where.host, where.port
        self._path = f"/api/v1/{device_type}/{number}/"
        self._transactions = itertools.count(1)

    def connect(self, end_s: float) -> None:
        """Have the server connect to its device, and wait until it says that it did.

        Raises
        ------
        RefusedError
            Another device than before has this number.
        """
        if self._ask("GET", "connected", {}, end_s) is not True:
            self.connections += 1
            self._ask("PUT", "connected", {"Connected": True}, end_s)
            while self._ask("GET", "connected", {}, end_s) is not True:
                self.pause(end_s, "connect to its device")
        model = str(self._ask("GET", "name", {}, end_s))
        if self._model not in (None, model):
            raise RefusedError(
                f"{self.name}: '{model}' answers now, but '{self._model}' answered before; correct the numbers in the "
                "address, or restore the server's configuration"
            )
        self._model, self._is_doubtful = model, False

    def get(self, member: str, end_s: float, **parameters: int) -> Any:
        """Return what a member of the device holds.

        Raises
        ------
        RefusedError
            The device answers with an error.
        TimedOutError
            The answer is not there until `end_s`.
        LostError
            Nothing listens, the connection broke, the device is not connected, or the answer is not Alpaca's.
        """
        return self._within(end_s, lambda end_s: self._ask("GET", member, parameters, end_s))

    def get_bool(self, member: str, end_s: float, **parameters: int) -> bool:
        """Return a truth value."""
        value = self.get(member, end_s, **parameters)
        if not isinstance(value, bool):
            raise self._not_alpaca(member, value)
        return value

    def get_int(self, member: str, end_s: float, **parameters: int) -> int:
        """Return a whole number."""
        value = self.get(member, end_s, **parameters)
        if isinstance(value, bool) or not isinstance(value, int):
            raise self._not_alpaca(member, value)
        return value

    def get_text(self, member: str, end_s: float) -> str:
        """Return a text; empty where the device has none."""
        value = self.get(member, end_s)
        if not isinstance(value, str):
            raise self._not_alpaca(member, value)
        return value

    def get_list(self, member: str, end_s: float) -> list[Any]:
        """Return a list."""
        value = self.get(member, end_s)
        if not isinstance(value, list):
            raise self._not_alpaca(member, value)
        return value

    def put(self, member: str, parameters: Mapping[str, bool | int], end_s: float, *, once: bool = False) -> None:
        """Set or start something, with `once` in one attempt; raises as :meth:`get` does."""
        if once:
            if self._is_doubtful:
                self.connect(end_s)
            self._ask("PUT", member, parameters, end_s)
        else:
            self._within(end_s, lambda end_s: self._ask("PUT", member, parameters, end_s), PUT_ATTEMPT_S)

    def put_request(self, member: str, parameters: Mapping[str, bool | int]) -> tuple[bytes, tuple[str, int]]:
        """Return the request that :meth:`put` would send, as bytes, and host and port that it goes to."""
        body = urlencode({**parameters, "ClientID": _CLIENT_ID, "ClientTransactionID": 0})
        host = f"[{self._host}]" if ":" in self._host else self._host
        head = (
            f"PUT {self._path}{member} HTTP/1.1",
            f"Host: {host}:{self._port}",
            "Content-Type: application/x-www-form-urlencoded",
            f"Content-Length: {len(body)}",
            "Connection: close",
        )
        return ("\r\n".join(head) + "\r\n\r\n" + body).encode(), (self._host, self._port)

    def identity(self, role: Literal["filter wheel", "laser", "lamp"], address: str, end_s: float) -> DeviceIdentity:
        """Ask the device what it is."""
        return DeviceIdentity(
            role=role,
            driver="alpaca",
            address=address,
            model=self.get_text("name", end_s),
            firmware=self.get_text("driverversion", end_s),
        )

    def pause(self, end_s: float, what: str) -> None:
        """Wait for the next poll.

        Raises
        ------
        TimedOutError
            There is no time for one.
        """
        # What would be left after the pause is too short for an answer.
        if time.monotonic() + 2.0 * POLL_S > end_s:
            raise TimedOutError(f"{self.name}: did not {what} before its deadline; check the device and its driver")
        time.sleep(POLL_S)

    def _within(self, end_s: float, request: Callable[[float], T], longest_s: float = GET_ATTEMPT_S) -> T:
        """Return what a request returns, repeated after faults."""

        def attempt(end_s: float) -> T:
            if self._is_doubtful:
                self.connect(end_s)
            return request(end_s)

        # Two attempts fit into any deadline.
        attempt_s = min(longest_s, 0.45 * (end_s - time.monotonic()))
        return repeated(attempt, end_s, self.name, attempt_s=attempt_s, after_fault=self._doubt)

    def _doubt(self) -> None:
        """Note that a request failed."""
        self._is_doubtful = True

    def _ask(self, method: str, member: str, parameters: Mapping[str, bool | int], end_s: float) -> Any:
        """Send one request, and return the value of its checked answer."""
        transaction = next(self._transactions)
        fields = urlencode({**parameters, "ClientID": _CLIENT_ID, "ClientTransactionID": transaction})
        status, body = self._ask_server(method, self._path + member, fields, end_s)
        if status != 200:
            raise RefusedError(
                f"{self.name}: the server rejected '{member}' with HTTP status {status} ({_start(body)}); check the "
                "device number in the address"
            )
        try:
            answer = json.loads(body)
        except (ValueError, RecursionError):
            answer = None
        if not isinstance(answer, dict) or not isinstance(answer.get("ErrorNumber"), int):
            raise self._not_alpaca(member, _start(body))
        # Servers that do not count say 0, or nothing.
        if answer.get("ClientTransactionID") not in (None, 0, transaction):
            raise self._not_alpaca(member, f"an answer to request {answer['ClientTransactionID']!s:.20}")
        self._require_success(member, answer)
        return answer.get("Value")

    def _require_success(self, member: str, answer: Mapping[str, Any]) -> None:
        error = answer["ErrorNumber"]
        if error == 0:
            return
        said = str(answer.get("ErrorMessage", ""))[:200]
        told = f"{self.name}: '{member}' fails with error {error:#x} ({_ERRORS.get(error, 'of the driver')}): {said}"
        if error == _NOT_CONNECTED:
            raise LostError(f"{told}; check the cable of the device, then connect the device again in its server")
        raise RefusedError(
            f"{told}; correct the rig file or the plan if the device cannot do this, otherwise repair the device"
        )

    def _ask_server(self, method: str, path: str, fields: str, end_s: float) -> tuple[int, bytes]:
        """Return status and body of one HTTP request."""
        try:
            connection = TimedConnection(self._host, self._port, end_s)
            with ExitStack() as ending:
                ending.callback(connection.hang_up)
                if method == "GET":
                    connection.request(method, f"{path}?{fields}")
                else:
                    connection.request(method, path, fields, {"Content-Type": "application/x-www-form-urlencoded"})
                response = connection.getresponse()
                body = response.read(LARGEST_ANSWER_BYTES + 1)
        except TimeoutError as error:
            raise TimedOutError(
                f"{self.name}: the server did not answer in time; check that its computer runs and its firewall lets "
                f"port {self._port} through"
            ) from error
        except (OSError, HTTPException, ValueError) as error:
            raise LostError(
                f"{self.name}: no answer from {self._host}:{self._port} ({system_words(error):.200}); start the Alpaca "
                "server, or correct the address"
            ) from error
        if len(body) > LARGEST_ANSWER_BYTES:
            raise self._not_alpaca(path, f"more than {LARGEST_ANSWER_BYTES} bytes")
        return response.status, body

    def _not_alpaca(self, member: str, said: object) -> LostError:
        return LostError(
            f"{self.name}: answers '{member}' with {said!r:.100}, which is not an Alpaca answer; check that "
            "an Alpaca server listens at this address"
        )


def _start(body: bytes) -> str:
    return body[:100].decode("utf-8", "replace")


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
