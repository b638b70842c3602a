"""A filter wheel behind an INDI server (``FILTER_SLOT``): ZWO, Starlight Xpress, QHY, Optec and others."""

import math
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final

from data_schemas import DeviceIdentity, FilterWheelSettings, LostError, TimedOutError, WrongPositionError
from rigs import FilterWheel, Operator
from rigs.filter_wheels._arrival import Arrival, require_slot, require_slots
from rigs.transports import (
    FILTER_WHEEL_INTERFACE,
    INDI_OPENS_WITHIN_S,
    RECOVERS_WITHIN_S,
    IndiClient,
    IndiProperty,
    local_indi_devices,
)

ANSWER_WITHIN_S: Final = 3.0
"""Most drivers answer at once that the wheel moves; those that say nothing meanwhile need longer."""
TURNS_WITHIN_S: Final = 6.0
POLL_S: Final = 0.05
ELSEWHERE_S: Final = 1.0
"""INDI has a word for moving, so that rest at another slot is soon believed."""
MOST_SLOTS: Final = 100
"""No wheel has more: what a broken driver says beyond it would fill the memory."""
_SLOT: Final = "FILTER_SLOT"
_VALUE: Final = "FILTER_SLOT_VALUE"
_AT_REST: Final = ("Ok", "Idle")


class IndiFilterWheel:
    """A wheel of filters of an INDI server.

    Every exchange is repeated within its deadline. After a new connection the slot counts as unknown until a move has
    ended: drivers that were restarted say slot 1 unseen.

    Parameters
    ----------
    client
        Connection to the wheel, open.
    address
        Where it was found.
    """

    def __init__(self, client: IndiClient, address: str) -> None:
        self._client = client
        self._address = address
        self._known_in = client.connections

    def identity(self) -> DeviceIdentity:
        """Return what the driver says it is."""
        return self._client.identity("filter wheel", self._address)

    @property
    def slots(self) -> tuple[int, ...]:
        """Numbers of the slots that the driver offers."""
        least, greatest = self._client.property(_SLOT).ranges.get(_VALUE, (1.0, 0.0))
        return tuple(range(max(1, int(least)), min(int(greatest), MOST_SLOTS) + 1))

    def position(self) -> int | None:
        """Ask the driver for the slot; None while it is unknown: it moves, a move failed, or the connection is new."""
        at = self._client.within(
            time.monotonic() + RECOVERS_WITHIN_S, lambda end_s: self._at(self._client.ask(_SLOT, end_s))
        )
        return at if self._client.connections == self._known_in else None

    def go_to(self, slot: int, deadline_s: float) -> None:
        """Move until the driver is idle and reports `slot` in two polls; at most `deadline_s` seconds.

        The wheel is sent also to the slot at which it is said to be.

        Raises
        ------
        RefusedError
            The wheel has no such slot, or the driver answers with an Alert.
        TimedOutError
            It did not arrive before the deadline.
        WrongPositionError
            It came to rest at another slot.
        LostError
            The connection broke, or the driver crashed, until the deadline.
        """
        self._client.within(time.monotonic() + deadline_s, lambda end_s: self._move(slot, end_s), math.inf)
        self._known_in = self._client.connections

    def _move(self, slot: int, end_s: float) -> None:
        """Send the wheel to a slot, and return when it is there."""
        require_slot(slot, self.slots, self._client.name)
        what = f"move to slot {slot}"
        # A move that missed its deadline, or is somebody else's: its late Ok must not answer for this one.
        while self._ask(end_s).state == "Busy":
            _pause(end_s, f"{self._client.name}: cannot {what}, because an earlier move has not ended")
        before = self._client.request("Number", _SLOT, {_VALUE: str(slot)}, end_s)
        wheel = self._client.property(_SLOT)
        # Without an answer the polls tell: it moves, it is there, or it has not heard.
        answered_s = min(end_s, time.monotonic() + ANSWER_WITHIN_S)
        try:
            self._client.wait(lambda: wheel.settings > before and wheel.state != "Busy", answered_s, what)
        except TimedOutError:
            if answered_s == end_s:
                raise
        arrival = Arrival(self._client.name, slot, ELSEWHERE_S)
        while True:
            if wheel.state == "Alert":
                raise self._client.refusal(what)
            wheel = self._ask(end_s)
            at = self._at(wheel)
            try:
                if arrival.sees(at):
                    return
            except WrongPositionError as error:
                if wheel.settings > before:
                    raise
                raise LostError(f"{error}; the driver did not answer the request") from error
            if at != slot:
                _pause(end_s, f"{self._client.name}: did not {what}, but reports {wheel.values.get(_VALUE)}")

    def _ask(self, end_s: float) -> IndiProperty:
        """Ask the driver for the slot; some say nothing while the wheel turns."""
        return self._client.ask(_SLOT, min(end_s, time.monotonic() + TURNS_WITHIN_S))

    def _at(self, wheel: IndiProperty) -> int | None:
        """Return the slot of an answer of the driver."""
        value = self._client.number(_SLOT, _VALUE)
        return int(value) if wheel.state in _AT_REST and value in self.slots else None


@contextmanager
def open_wheel(settings: FilterWheelSettings, operator: Operator) -> Iterator[FilterWheel]:
    """Open the wheel at ``host:port/device`` for a ``with`` block; nothing is moved by it.

    Raises
    ------
    RefusedError
        The address has another form, the driver cannot connect to its device, or the wheel lacks a slot of the rig.
    TimedOutError
        The server has no such device, or the device is no filter wheel.
    LostError
        No server listens at the address.
    """
    with IndiClient(settings.address, "filter wheel", _SLOT) as client:
        client.ready(time.monotonic() + INDI_OPENS_WITHIN_S)
        wheel = IndiFilterWheel(client, settings.address)
        require_slots(settings.filters, wheel.slots, client.name)
        yield wheel


def found() -> list[tuple[str, str]]:
    """Return address and description of the filter wheels of an INDI server on this computer."""
    return local_indi_devices(FILTER_WHEEL_INTERFACE)


def _pause(end_s: float, overdue: str) -> None:
    """Wait for the next poll; raise when there is no time for one."""
    # What would be left after the pause is too short for an answer.
    if time.monotonic() + 2.0 * POLL_S > end_s:
        raise TimedOutError(f"{overdue}; check whether something blocks the wheel, and check its power supply")
    time.sleep(POLL_S)
