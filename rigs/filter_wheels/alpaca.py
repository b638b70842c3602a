"""A filter wheel behind an ASCOM Alpaca server. Alpaca counts slots from 0, finray from 1: converted here only."""

import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final

from data_schemas import DeviceIdentity, FilterWheelSettings, RefusedError
from rigs import FilterWheel, Operator
from rigs.filter_wheels._arrival import Arrival, require_slot, require_slots
from rigs.transports import (
    ALPACA_OPENS_WITHIN_S,
    RECOVERS_WITHIN_S,
    AlpacaClient,
    alpaca_address,
    alpaca_devices,
    device_number,
)

ASK_WITHIN_S: Final = 5.0
ELSEWHERE_S: Final = 2.0
"""Some drivers name the slot they left until the wheel turns."""
_FIRST_SLOT: Final = 1
_MOVING: Final = -1


class AlpacaFilterWheel:
    """A wheel of filters of an Alpaca server.

    Parameters
    ----------
    client
        The connected device.
    address
        Where it was found.
    count
        Number of its slots.
    """

    def __init__(self, client: AlpacaClient, address: str, count: int) -> None:
        self._client = client
        self._address = address
        self._slots = tuple(range(_FIRST_SLOT, _FIRST_SLOT + count))
        self._known_in = client.connections

    def identity(self) -> DeviceIdentity:
        """Ask the device what it is."""
        return self._client.identity("filter wheel", self._address, time.monotonic() + ASK_WITHIN_S)

    @property
    def slots(self) -> tuple[int, ...]:
        """Numbers of the slots, as many as the device had names for when it was opened."""
        return self._slots

    def position(self) -> int | None:
        """Ask the device for the slot in the beam; None while it moves, and after its server has been restarted."""
        at = self._ask(time.monotonic() + RECOVERS_WITHIN_S)
        return at if self._client.connections == self._known_in else None

    def go_to(self, slot: int, deadline_s: float) -> None:
        """Move until two polls report `slot`; at most `deadline_s` seconds.

        Raises
        ------
        RefusedError
            The wheel has no such slot, or the device refuses.
        TimedOutError
            It did not arrive before the deadline.
        WrongPositionError
            It came to rest at another slot.
        LostError
            The connection broke.
        """
        end_s = time.monotonic() + deadline_s
        require_slot(slot, self._slots, self._client.name)
        # A move that missed its deadline must not be taken for this one.
        while self._ask(end_s) is None:
            self._client.pause(end_s, "end the previous move")
        is_there = False
        while not is_there:
            self._client.put("position", {"Position": slot - _FIRST_SLOT}, end_s)
            arrival, sent_in = Arrival(self._client.name, slot, ELSEWHERE_S), self._client.connections
            # A server that was restarted meanwhile has forgotten the order.
            while not is_there and sent_in == self._client.connections:
                if not (is_there := arrival.sees(self._ask(end_s))):
                    self._client.pause(end_s, f"move to slot {slot}")
        self._known_in = self._client.connections

    def _ask(self, end_s: float) -> int | None:
        """Return the slot; None for moving and for a number that no slot has."""
        position = self._client.get_int("position", end_s)
        slot = position + _FIRST_SLOT
        return slot if position != _MOVING and slot in self._slots else None


@contextmanager
def open_wheel(settings: FilterWheelSettings, operator: Operator) -> Iterator[FilterWheel]:
    """Open the wheel at ``http://host:port/number`` for a ``with`` block; nothing is moved by it.

    Raises
    ------
    RefusedError
        The address has another form, there is no such device, or the wheel lacks a slot of the rig file.
    TimedOutError, LostError
        The server does not answer, or not as an Alpaca server.
    """
    form = "http://host:port/number of the wheel, such as http://192.168.1.20:11111/0"
    where = alpaca_address(settings.address, "filter wheel", form)
    number = device_number(where.path[0])
    if number is None or len(where.path) != 1:
        raise RefusedError(f"filter wheel: '{settings.address}' is not an Alpaca address; write {form}")
    client = AlpacaClient(where, "filterwheel", number, f"filter wheel at {settings.address}")
    end_s = time.monotonic() + ALPACA_OPENS_WITHIN_S
    client.connect(end_s)
    wheel = AlpacaFilterWheel(client, settings.address, len(client.get_list("names", end_s)))
    require_slots(settings.filters, wheel.slots, client.name)
    yield wheel


def found() -> list[tuple[str, str]]:
    """Return address and description of the wheels of the Alpaca servers in reach."""
    return [
        (f"{device.server}/{device.number}", f"Alpaca filter wheel {device.name}")
        for device in alpaca_devices()
        if device.kind == "filterwheel"
    ]
