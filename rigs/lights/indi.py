"""A light behind an INDI server: flat-field panels and dust caps with a light (``FLAT_LIGHT_CONTROL``)."""

import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final

from data_schemas import DeviceIdentity, RefusedError
from rigs import GuardedSwitch, Operator, SwitchOffCommand
from rigs.lights._server_light import HAS_DEAD_MAN as HAS_DEAD_MAN
from rigs.lights._server_light import LightRole, ServerLight
from rigs.transports import INDI_OPENS_WITHIN_S, LIGHT_INTERFACE, IndiClient, local_indi_devices, new_vector

ATTEMPT_S: Final = 2.0
_CONTROL: Final = "FLAT_LIGHT_CONTROL"
_ON: Final = "FLAT_LIGHT_ON"
_OFF: Final = "FLAT_LIGHT_OFF"


class IndiPanel:
    """The light of a panel.

    Parameters
    ----------
    client
        Connection to the panel.
    """

    def __init__(self, client: IndiClient) -> None:
        self._client = client
        self.name: Final = client.name

    def identity(self, role: LightRole, address: str, end_s: float) -> DeviceIdentity:
        """Return what the driver says it is."""
        return self._client.identity(role, address)

    def connect(self, end_s: float) -> None:
        """Connect, where there is no connection."""
        self._client.ready(end_s)

    def set(self, on: bool, end_s: float) -> None:
        """Switch, wait for the driver's answer to it, then ask it again."""
        if on:
            self._client.ready(end_s)
            self._set(True, end_s)
        else:
            self._client.within(end_s, lambda end_s: self._set(False, end_s))

    def reading(self, end_s: float) -> bool:
        """Ask the driver afresh whether the light is on: twice, as INDI's answers do not name their question.

        The first may be what another client was told before the light changed.
        """
        return self._client.within(end_s, self._reading, min(ATTEMPT_S, 0.45 * (end_s - time.monotonic())))

    def off_words(self) -> SwitchOffCommand:
        """Return the message that switches off; the server obeys it from a connection that asked for nothing."""
        where = self._client.where
        return SwitchOffCommand(new_vector("Switch", where.device, _CONTROL, {_OFF: "On"}), (where.host, where.port))

    def _set(self, on: bool, end_s: float) -> None:
        """Switch on a connection that stands."""
        self._client.change("Switch", _CONTROL, {_ON if on else _OFF: "On"}, end_s)
        if self._ask(end_s) != on:
            raise RefusedError(
                f"{self.name}: does not turn {'on' if on else 'off'}{self._client.said()}; check the light"
            )

    def _reading(self, end_s: float) -> bool:
        """Ask twice on a connection that stands."""
        self._client.ask(_CONTROL, end_s)
        return self._ask(end_s)

    def _ask(self, end_s: float) -> bool:
        """Return the state; a panel that is just changing counts as lit."""
        control = self._client.ask(_CONTROL, end_s)
        on, off = (control.values.get(member) == "On" for member in (_ON, _OFF))
        if on == off or control.state == "Alert":
            raise RefusedError(
                f"{self.name}: the driver does not report whether the light is on ({_CONTROL} is "
                f"{control.state}){self._client.said()}; check the light, and restart the driver"
            )
        return on or control.state == "Busy"


@contextmanager
def open_switch(address: str, role: LightRole, operator: Operator | None) -> Iterator[GuardedSwitch]:
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
        client.ready(time.monotonic() + INDI_OPENS_WITHIN_S)
        yield ServerLight(IndiPanel(client), role, address)


def found() -> list[tuple[str, str]]:
    """Return address and description of the lights of an INDI server on this computer."""
    return local_indi_devices(LIGHT_INTERFACE)
