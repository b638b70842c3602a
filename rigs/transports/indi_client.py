"""A connection to one device of an INDI server: properties kept up to date, every wait with a deadline."""

import contextlib
import socket
import time
from collections.abc import Callable, Mapping
from types import TracebackType
from typing import Final, Literal, Self

from data_schemas.errors import LostError, RefusedError, TimedOutError
from rigs.transports.indi_device import IndiDevice, IndiProperty
from rigs.transports.indi_messages import (
    IndiReader,
    enable_blobs,
    get_properties,
    new_vector,
    number,
)
from rigs.transports.indi_server import IndiAddress, devices_at, indi_address, open_socket

OPEN_WITHIN_S: Final = 30.0
"""Drivers that connect reset their device; a wheel that turns once round for its mark took 10 s."""
_RECEIVE_BYTES: Final = 2**20
ANSWER_WITHIN_S: Final = 5.0
"""A driver that crashed is back after one to three seconds."""
_SWITCHED_ON: Final = "On"


class IndiClient(IndiDevice):
    """One device of an INDI server; a lost connection is told once, and the next call connects again.

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
        return True

    def ask(self, name: str, end_s: float) -> IndiProperty:
        """Ask the driver for a property, and return it when the answer to this question has come."""
        self.drain(end_s)
        known = self.properties.get(name)
        before = known.definitions if known else 0
        self._send(get_properties(self._device, name), end_s)
        self.wait(lambda: self.definitions(name) > before, end_s, f"say what {name} is")
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
                    f"{self.name}: {name}.{member} = {value} was asked for, and it reads back "
                    f"'{known.values.get(member, '')}'{self.said()}; choose a value that the device can take"
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
        self.properties, self.blobs = {}, {}
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
        what = (
            f"the server has no such device, it has {known}" if known else "the server says nothing about this device"
        )
        return TimedOutError(
            f"{self.name}: the server {what}; correct the address, or start indiserver with the driver of the device"
        )

    def _send(self, data: bytes, end_s: float) -> None:
        if self._socket is None:
            raise LostError(f"{self.name}: the connection is closed; start again")
        try:
            self._socket.settimeout(max(end_s - time.monotonic(), 1e-3))
            self._socket.sendall(data)
        except TimeoutError as error:
            # Part of a message may be out: nothing can follow it.
            self.close()
            raise TimedOutError(f"{self.name}: the server takes no more messages; restart indiserver") from error
        except OSError as error:
            raise self._lost(str(error)) from error

    def _receive(self, end_s: float) -> bool:
        """Take in what comes until `end_s` at the longest; return whether anything came."""
        if self._socket is None:
            raise LostError(f"{self.name}: the connection is closed; start again")
        try:
            self._socket.settimeout(max(end_s - time.monotonic(), 0.0))
            data = self._socket.recv(_RECEIVE_BYTES)
        except (TimeoutError, BlockingIOError):
            return False
        except OSError as error:
            raise self._lost(str(error)) from error
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
