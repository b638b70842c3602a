"""A connection to one device of an INDI server: properties kept up to date, every wait with a deadline.

Where devices are (addresses, servers and what they have), and what one of them has said: properties, frames, messages.
"""

import contextlib
import re
import socket
import time
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from types import TracebackType
from typing import Final, Literal, NamedTuple, Self, TypeVar

from data_schemas import DeviceIdentity, LostError, RefusedError, TimedOutError, system_words
from rigs.transports._indi_messages import (
    IndiElement,
    IndiMessage,
    IndiReader,
    enable_blobs,
    get_properties,
    new_vector,
    number,
)
from rigs.transports._repeated_exchange import repeated

DEFAULT_PORT: Final = 7624
CAMERA_INTERFACE: Final = 1 << 1
FILTER_WHEEL_INTERFACE: Final = 1 << 4
LIGHT_INTERFACE: Final = 1 << 10
#: What drivers print for a number without a limit.
_NO_LIMIT: Final = re.compile(r"\s*[+-]?(nan|inf(inity)?)\s*", re.I)
_LISTING_S: Final = 0.5
_LISTING_BYTES: Final = 2**16


class IndiAddress(NamedTuple):
    """Where a device is: host and port of its server, and its name there."""

    host: str
    port: int
    device: str


def indi_address(address: str, role: str) -> IndiAddress:
    """Split ``host:port/device``; the port may be left out.

    Raises
    ------
    RefusedError
        It has no such form.
    """
    server, _, device = address.partition("/")
    host, colon, port = server.rpartition(":")
    if not colon or server.endswith("]"):  # the colons in brackets are those of an IPv6 address
        host, port = server, str(DEFAULT_PORT)
    if host.startswith("[") and host.endswith("]"):
        host = host[1:-1]
    if not (
        host and device.strip() and port.isascii() and port.isdecimal() and len(port) < 6 and 0 < int(port) < 2**16
    ):
        raise RefusedError(
            f"{role}: '{address}' is not an INDI address; write host:port/device name, such as "
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
            data = server.recv(_LISTING_BYTES)
            if not data:
                break
            for message in reader.feed(data):
                if message.device and message.tag.startswith("def"):
                    kinds = {element.name: element.text for element in message.elements}.get("DRIVER_INTERFACE", "0")
                    bits = int(kinds) if kinds.isascii() and kinds.isdecimal() and len(kinds) < 10 else 0
                    found[message.device] = found.get(message.device, 0) | bits
    return found


def local_indi_devices(interface: int) -> list[tuple[str, str]]:
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
            f"{name}: nothing listens at {where.host}:{where.port} ({system_words(error)}); start indiserver, or "
            "correct the address"
        ) from error
    opened.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    return opened


LONGEST_TEXT: Final = 200
_KEPT_TEXTS: Final = 8


@dataclass(slots=True)
class IndiProperty:
    """What the driver reported last about a property; updated in place.

    Attributes
    ----------
    state
        Idle, Ok, Busy or Alert.
    values
        Texts of the members, by name.
    ranges
        Least and greatest value of numbers that have both, by name of the member.
    definitions, settings
        How often the driver has defined and set it in this connection: whoever waits for news compares.
    """

    state: str = "Idle"
    values: dict[str, str] = field(default_factory=dict)
    ranges: dict[str, tuple[float, float]] = field(default_factory=dict)
    definitions: int = 0
    settings: int = 0


class IndiDevice:
    """What is known of a device.

    Parameters
    ----------
    device
        Its name in the server.
    name
        Role and address, for messages.
    needed
        Property that the device has while it is connected; without it the device counts as lost.
    """

    def __init__(self, device: str, name: str, needed: str) -> None:
        self.name = name
        self._device, self._needed = device, needed
        self.properties: dict[str, IndiProperty] = {}
        self.blobs: dict[str, IndiElement] = {}
        self._withdrawn: dict[str, IndiProperty] = {}
        self._texts: deque[str] = deque(maxlen=_KEPT_TEXTS)

    def property(self, name: str) -> IndiProperty:
        """Return what was said last about a property.

        Raises
        ------
        RefusedError
            The device has no such property.
        """
        if name not in self.properties:
            raise RefusedError(f"{self.name}: has no property {name}; name another device of the server")
        return self.properties[name]

    def number(self, name: str, member: str) -> float:
        """Return a number of a property as it was said last."""
        return number(self.property(name).values.get(member, ""), f"{self.name}: {name}.{member}")

    def definitions(self, name: str) -> int:
        """Return how often the driver has defined a property in this connection; 0 where there is none."""
        return self.properties[name].definitions if name in self.properties else 0

    def identity(self, role: Literal["camera", "filter wheel", "laser", "lamp"], address: str) -> DeviceIdentity:
        """Return what the driver says it is."""
        info = self.properties.get("DRIVER_INFO", IndiProperty()).values
        version = info.get("DRIVER_VERSION", "")
        return DeviceIdentity(
            role=role,
            driver="indi",
            address=address,
            model=self._device,
            firmware=f"{info.get('DRIVER_EXEC', '')} {version}".strip(),
        )

    def refusal(self, what: str) -> RefusedError:
        """Return the error for an Alert, with what the driver says about it."""
        return RefusedError(
            f"{self.name}: refuses to {what}{self.said()}; correct the rig file or the plan if the device cannot do "
            "this, otherwise repair the device"
        )

    def said(self) -> str:
        """Return what the driver said since the last request, as the end of a message."""
        return f" (the driver says: {'; '.join(self._texts)})" if self._texts else ""

    def lost(self, reason: str) -> LostError:
        """Return the error for a connection that broke, with what the driver said before."""
        return LostError(
            f"{self.name}: the connection broke ({reason}){self.said()}; check the device's cable, and that indiserver "
            "runs with its driver"
        )

    def take(self, message: IndiMessage) -> None:
        """Bring what is known up to date.

        Raises
        ------
        LostError
            The device has gone.
        """
        if message.device != self._device:
            return
        if message.attributes.get("message"):
            self._texts.append(message.attributes["message"][:LONGEST_TEXT])
        if message.tag == "delProperty":
            self._forget(message.name)
        elif message.tag == "setBLOBVector":
            self.blobs.update({blob.name: blob for blob in message.elements})
        elif message.tag.startswith(("def", "set")) and message.name:
            again = self._withdrawn.pop(message.name, None)
            known = self.properties.setdefault(message.name, again or IndiProperty())
            is_definition = message.tag.startswith("def")
            known.definitions += is_definition
            # Drivers that rebuild their controls after a change answer it by a new definition alone.
            known.settings += again is not None or not is_definition
            known.state = message.attributes.get("state", known.state)
            for element in message.elements:
                known.values[element.name] = element.text
                stated = [element.attributes.get(end, "nan") for end in ("min", "max")]
                if not any(_NO_LIMIT.fullmatch(end) for end in stated):
                    where = f"{self.name}: range of {message.name}"
                    known.ranges[element.name] = (number(stated[0], where), number(stated[1], where))

    def _forget(self, name: str) -> None:
        """Drop a property, or all; without the needed one there is no device.

        Its counts are kept: an exchange that runs compares with them when the property is defined again.
        """
        for each in [name] if name else list(self.properties):
            if (known := self.properties.pop(each, None)) is not None:
                known.values.clear()
                known.ranges.clear()
                self._withdrawn[each] = known
        if not name or name == self._needed:
            raise self.lost(f"the driver withdrew {name or 'the device'}, so it crashed or was disconnected")


INDI_OPENS_WITHIN_S: Final = 30.0
"""Drivers that connect reset their device; a wheel that turns once round for its mark took 10 s."""
ATTEMPT_S: Final = 3.0
"""A driver answers a question in milliseconds; one that crashed is back after one to three seconds."""
_RECEIVE_BYTES: Final = 2**20
ANSWER_WITHIN_S: Final = 5.0
"""A driver that crashed is back after one to three seconds."""
_SWITCHED_ON: Final = "On"


T = TypeVar("T")


class IndiClient(IndiDevice):
    """One device of an INDI server; a lost connection is reported once, and the next call connects again.

    Attributes
    ----------
    connections
        How often it has connected: a driver that was left may have been restarted, and its device moved.

    Instants `end_s` are readings of :func:`time.monotonic`.

    Parameters
    ----------
    address
        ``host:port/device``.
    role
        What the device is in the rig, for messages.
    needed
        Property that the device has while it is connected; without it the device counts as lost.
    """

    def __init__(self, address: str, role: str, needed: str) -> None:
        self._where = indi_address(address, role)
        super().__init__(self._where.device, f"{role} at {address}", needed)
        self._socket: socket.socket | None = None
        self._reader = IndiReader(self.name)
        self.connections = 0

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Leave the server; the device stays as it is."""
        if self._socket is not None:
            with contextlib.suppress(OSError):
                self._socket.close()
        self._socket = None

    @property
    def where(self) -> IndiAddress:
        """Host and port of the server, and the device's name there."""
        return self._where

    def ready(self, end_s: float) -> bool:
        """Take in what has come, connect where there is no connection; return whether this one is new.

        Raises
        ------
        LostError
            Nothing listens at the address, or the device left the connection since the last call.
        TimedOutError
            The server has no such device, or the device did not connect in time.
        RefusedError
            The driver cannot connect to its device.
        """
        if self._socket is not None:
            self.drain(end_s)
            return False
        try:
            self._connect(end_s)
        except BaseException:
            self.close()
            raise
        self.connections += 1
        return True

    def within(self, end_s: float, exchange: Callable[[float], T], attempt_s: float = ATTEMPT_S) -> T:
        """Return what an exchange returns, which may be done twice; after each fault over a new connection.

        Parameters
        ----------
        end_s
            When all attempts must be over.
        exchange
            Called with the instant at which this attempt must be over.
        attempt_s
            Longest duration of one attempt.

        Raises
        ------
        LostError, TimedOutError
            No attempt succeeded before the time was over.
        """

        def attempt(end_s: float) -> T:
            self.ready(end_s)
            return exchange(end_s)

        # After a message that was cut off nothing on the old connection can be understood.
        return repeated(attempt, end_s, self.name, attempt_s=attempt_s, after_fault=self.close)

    def ask(self, name: str, end_s: float) -> IndiProperty:
        """Ask the driver for a property, and return it when the answer to this question has come."""
        self.drain(end_s)
        known = self.properties.get(name)
        before = known.definitions if known else 0
        self._send(get_properties(self._device, name), end_s)
        self.wait(lambda: self.definitions(name) > before, end_s, f"report {name}")
        return self.properties[name]

    def request(
        self, kind: Literal["Number", "Switch", "Text"], name: str, values: Mapping[str, str], end_s: float
    ) -> int:
        """Ask for new values; return how often the driver had set the property before, to wait for more."""
        self.drain(end_s)
        before = self.property(name).settings
        self._texts.clear()
        self._send(new_vector(kind, self._device, name, values), end_s)
        return before

    def change(
        self, kind: Literal["Number", "Switch", "Text"], name: str, values: Mapping[str, str], end_s: float
    ) -> IndiProperty:
        """Ask for new values, wait for the driver's answer to it, then read the property back.

        Raises
        ------
        RefusedError
            The driver refuses (Alert), or reads back something else.
        """
        before = self.request(kind, name, values, end_s)
        what = f"set {name} to {', '.join(values.values())}"
        known = self.property(name)
        self.wait(lambda: known.settings > before and known.state != "Busy", end_s, what)
        if known.state == "Alert":
            raise self.refusal(what)
        known = self.ask(name, end_s)
        for member, value in values.items():
            if not self._agrees(kind, known.values.get(member, ""), value):
                raise RefusedError(
                    f"{self.name}: {name}.{member} = {value} was requested, but the device reports "
                    f"'{known.values.get(member, '')}'{self.said()}; "
                    "choose a value that the device can take"
                )
        return known

    def enable_blobs(self, end_s: float) -> None:
        """Ask the server for the frames of the device."""
        self._send(enable_blobs(self._device), end_s)

    def wait(self, condition: Callable[[], bool], end_s: float, what: str) -> None:
        """Take in messages until `condition` holds.

        Raises
        ------
        TimedOutError
            It does not hold until `end_s`.
        LostError
            The connection broke, or the device left it.
        """
        began_s = time.monotonic()
        while not condition():
            self._receive(end_s)
            # A server that talks without end about something else is late as well as a mute one.
            if time.monotonic() >= end_s and not condition():
                raise TimedOutError(
                    f"{self.name}: did not {what} within {max(end_s - began_s, 0.0):.2g} s{self.said()}; check the "
                    "device and its driver"
                )

    def drain(self, end_s: float) -> None:
        """Take in what has come already."""
        while self._receive(0.0) and time.monotonic() < end_s:
            pass

    def _connect(self, end_s: float) -> None:
        """Connect to the server, and the driver to its device."""
        self.properties, self.blobs, self._withdrawn = {}, {}, {}
        self._texts.clear()
        self._reader = IndiReader(self.name)
        self._socket = open_socket(self._where, self.name, end_s)
        self._send(get_properties(self._device), end_s)
        try:
            # Half a second is kept to ask which devices there are, or half of the time if that is less.
            now_s = time.monotonic()
            answer_s = max(min(now_s + ANSWER_WITHIN_S, end_s - 0.5), (now_s + end_s) / 2)
            self.wait(lambda: self.definitions("CONNECTION") > 0, answer_s, "answer")
        except TimedOutError as error:
            raise self._unknown_device(end_s) from error
        if self.property("CONNECTION").values.get("CONNECT") != _SWITCHED_ON:
            before = self.request("Switch", "CONNECTION", {"CONNECT": _SWITCHED_ON}, end_s)
            connection = self.property("CONNECTION")
            self.wait(lambda: connection.settings > before and connection.state != "Busy", end_s, "connect")
            if connection.state == "Alert" or connection.values.get("CONNECT") != _SWITCHED_ON:
                raise self.refusal("connect to its device")
        self.wait(lambda: self._needed in self.properties, end_s, f"offer {self._needed}")
        # A driver answers in order: after this answer all that belongs to the connection is defined.
        self.ask("CONNECTION", end_s)

    def _unknown_device(self, end_s: float) -> TimedOutError:
        known = ", ".join(f"'{device}'" for device in sorted(devices_at(self._where, end_s)))
        what = f"has no such device, only {known}" if known else "does not report this device"
        return TimedOutError(
            f"{self.name}: the server {what}; correct the address, or start indiserver with the driver of the device"
        )

    def _send(self, data: bytes, end_s: float) -> None:
        if self._socket is None:
            raise LostError(f"{self.name}: the connection is closed; run the command again")
        try:
            self._socket.settimeout(max(end_s - time.monotonic(), 1e-3))
            self._socket.sendall(data)
        except TimeoutError as error:
            # Part of a message may be out: nothing can follow it.
            self.close()
            raise TimedOutError(f"{self.name}: the server accepts no more messages; restart indiserver") from error
        except OSError as error:
            raise self._lost(system_words(error)) from error

    def _receive(self, end_s: float) -> bool:
        """Take in what comes until `end_s` at the longest; return whether anything came."""
        if self._socket is None:
            raise LostError(f"{self.name}: the connection is closed; run the command again")
        try:
            self._socket.settimeout(max(end_s - time.monotonic(), 0.0))
            data = self._socket.recv(_RECEIVE_BYTES)
        except (TimeoutError, BlockingIOError):
            return False
        except OSError as error:
            raise self._lost(system_words(error)) from error
        if not data:
            raise self._lost("the server closed it")
        try:
            messages = self._reader.feed(data)
            for message in messages:
                self.take(message)
        except LostError:
            self.close()
            raise
        return True

    def _lost(self, reason: str) -> LostError:
        self.close()
        return self.lost(reason)

    def _agrees(self, kind: str, read_back: str, asked: str) -> bool:
        if kind == "Number" and read_back:
            return abs(number(read_back, self.name) - float(asked)) <= 1e-6 * max(1.0, abs(float(asked)))
        return read_back == asked
