"""A light behind an INDI server: flat-field panels and dust caps with a light (``FLAT_LIGHT_CONTROL``)."""

import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final, Literal

from data_schemas.errors import CaptureError, LostError, RefusedError, UnsafeError
from data_schemas.rig import DeviceIdentity
from rigs.protocols import LightSwitch, Operator
from rigs.transports.indi_client import OPEN_WITHIN_S, IndiClient
from rigs.transports.indi_server import LIGHT_INTERFACE, found_on_this_computer

_CONTROL: Final = "FLAT_LIGHT_CONTROL"
_ON: Final = "FLAT_LIGHT_ON"
_OFF: Final = "FLAT_LIGHT_OFF"


class IndiLight:
    """The bare switch of a light panel; the server keeps a light on when its client dies.

    Parameters
    ----------
    client
        Connection to the panel.
    role, address
        What it is in the rig, and where it was found.
    """

    has_dead_man: Final = False

    def __init__(self, client: IndiClient, role: Literal["laser", "lamp"], address: str) -> None:
        self._client = client
        self._role = role
        self._address = address

    def identity(self) -> DeviceIdentity:
        """Return what the driver says it is."""
        return self._client.identity(self._role, self._address)

    def switch(self, on: bool, deadline_s: float) -> None:
        """Switch, wait for the driver's answer to it, then ask it again; at most `deadline_s` seconds.

        Raises
        ------
        UnsafeError
            Off was asked for and is not confirmed.
        RefusedError
            The driver refuses to switch on.
        TimedOutError
            On is not confirmed before the deadline.
        LostError
            The connection broke before on was confirmed.
        """
        end_s = time.monotonic() + deadline_s
        if on:
            self._set(True, end_s)
            return
        try:
            try:
                self._set(False, end_s)
            except LostError:
                # A driver that crashed comes back with the device as it was: lit.
                self._set(False, end_s)
        except CaptureError as error:
            raise UnsafeError(
                f"{self._client.name}: off is not confirmed; cut the power of the light before you open the box. "
                f"The reason: {error}"
            ) from error

    def state(self, deadline_s: float) -> bool:
        """Ask the driver afresh whether the light is on.

        Raises
        ------
        RefusedError
            The driver does not know.
        """
        end_s = time.monotonic() + deadline_s
        self._client.ready(end_s)
        return self._ask(end_s)

    def keep_alive(self) -> None:
        """Do nothing: an INDI light has no dead-man."""

    def _set(self, on: bool, end_s: float) -> None:
        self._client.ready(end_s)
        self._client.change("Switch", _CONTROL, {_ON if on else _OFF: "On"}, end_s)
        if self._ask(end_s) != on:
            raise RefusedError(f"{self._client.name}: does not turn {'on' if on else 'off'}{self._client.said()}")

    def _ask(self, end_s: float) -> bool:
        """Return the state; a panel that is just changing counts as lit."""
        control = self._client.ask(_CONTROL, end_s)
        on, off = (control.values.get(member) == "On" for member in (_ON, _OFF))
        if on == off or control.state == "Alert":
            raise RefusedError(
                f"{self._client.name}: the driver cannot tell whether the light is on ({_CONTROL} is {control.state})"
                f"{self._client.said()}; look at the light, and restart the driver"
            )
        return on or control.state == "Busy"


@contextmanager
def open_switch(address: str, role: Literal["laser", "lamp"], operator: Operator | None) -> Iterator[LightSwitch]:
    """Open the switch of a light at ``host:port/device`` for a ``with`` block; nothing is switched by it.

    Raises
    ------
    RefusedError
        The address has another form, or the driver cannot connect to its device.
    TimedOutError
        The server has no such device, or the device has no light.
    LostError
        No server listens at the address.
    """
    with IndiClient(address, role, _CONTROL) as client:
        client.ready(time.monotonic() + OPEN_WITHIN_S)
        yield IndiLight(client, role, address)


def found() -> list[tuple[str, str]]:
    """Return address and description of the lights of an INDI server on this computer."""
    return found_on_this_computer(LIGHT_INTERFACE)
