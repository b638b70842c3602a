"""A light behind an ASCOM Alpaca server: one switch of a switch device, or the lamp of a cover calibrator."""

import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final

from data_schemas import DeviceIdentity, RefusedError
from rigs import GuardedSwitch, Operator, SwitchOffCommand
from rigs.lights._server_light import HAS_DEAD_MAN as HAS_DEAD_MAN
from rigs.lights._server_light import LightRole, ServerLight
from rigs.transports import ALPACA_OPENS_WITHIN_S, AlpacaClient, alpaca_address, alpaca_devices, device_number

_NOT_PRESENT: Final = 0
# Off, not ready (it warms up or goes out), ready.
_CALIBRATOR_STATES: Final[dict[int, bool | None]] = {1: False, 2: None, 3: True}


class Relay:
    """One switch of a switch device.

    Parameters
    ----------
    client
        The device.
    number
        Number of the switch in it.
    """

    def __init__(self, client: AlpacaClient, number: int) -> None:
        self._client = client
        self._number = number

    def require_light(self, end_s: float) -> None:
        """Refuse a switch that is not there or cannot be written."""
        count = self._client.get_int("maxswitch", end_s)
        if self._number >= count:
            raise RefusedError(
                f"{self._client.name}: has no switch {self._number} ({count} switches, counted from 0); correct the "
                "address"
            )
        if not self._client.get_bool("canwrite", end_s, Id=self._number):
            raise RefusedError(f"{self._client.name}: switch {self._number} can only be read; correct the address")

    def command(self, on: bool, end_s: float) -> None:
        """Ask the device to switch."""
        self._client.put("setswitch", {"Id": self._number, "State": on}, end_s, once=on)

    def reading(self, end_s: float) -> bool:
        """Ask whether the switch is on."""
        return self._client.get_bool("getswitch", end_s, Id=self._number)

    def off_words(self) -> SwitchOffCommand:
        """Return the request that switches off."""
        return SwitchOffCommand(*self._client.put_request("setswitch", {"Id": self._number, "State": False}))


class Calibrator:
    """The lamp of a cover calibrator, at its full brightness.

    Parameters
    ----------
    client
        The device.
    """

    def __init__(self, client: AlpacaClient) -> None:
        self._client = client

    def require_light(self, end_s: float) -> None:
        """Refuse a cover without a lamp."""
        if self._client.get_int("calibratorstate", end_s) == _NOT_PRESENT:
            raise RefusedError(f"{self._client.name}: has a cover but no lamp; name another device")

    def command(self, on: bool, end_s: float) -> None:
        """Ask the device to switch."""
        if on:
            brightest = self._client.get_int("maxbrightness", end_s)
            self._client.put("calibratoron", {"Brightness": brightest}, end_s, once=True)
        else:
            self._client.put("calibratoroff", {}, end_s)

    def reading(self, end_s: float) -> bool | None:
        """Ask whether the lamp is on; None while it warms up or goes out."""
        state = self._client.get_int("calibratorstate", end_s)
        if state not in _CALIBRATOR_STATES:
            raise RefusedError(
                f"{self._client.name}: the device does not report whether the lamp is on (calibratorstate "
                f"{state}); check the lamp, and restart its driver"
            )
        return _CALIBRATOR_STATES[state]

    def off_words(self) -> SwitchOffCommand:
        """Return the request that switches off."""
        return SwitchOffCommand(*self._client.put_request("calibratoroff", {}))


class AlpacaPanel:
    """A light of an Alpaca server.

    Parameters
    ----------
    client
        The connected device.
    controlled
        What switches the light in it.
    """

    def __init__(self, client: AlpacaClient, controlled: Relay | Calibrator) -> None:
        self._client, self._controlled = client, controlled
        self.name: Final = client.name

    def identity(self, role: LightRole, address: str, end_s: float) -> DeviceIdentity:
        """Ask the device what it is."""
        return self._client.identity(role, address, end_s)

    def connect(self, end_s: float) -> None:
        """Have the server connect again: every request has a connection of its own, so a restarted one is found."""
        self._client.connect(end_s)

    def set(self, on: bool, end_s: float) -> None:
        """Switch, and ask until the device confirms it."""
        self._controlled.command(on, end_s)
        while self._controlled.reading(end_s) is not on:
            self._client.pause(end_s, f"confirm {'on' if on else 'off'}")

    def reading(self, end_s: float) -> bool:
        """Ask the device whether the light is on; one that is changing counts as on."""
        return self._controlled.reading(end_s) is not False

    def off_words(self) -> SwitchOffCommand:
        """Return the request that switches off; the watch opens a connection for it."""
        return self._controlled.off_words()


@contextmanager
def open_switch(address: str, role: LightRole, operator: Operator | None) -> Iterator[GuardedSwitch]:
    """Open ``http://host:port/switch/D/N`` or ``http://host:port/covercalibrator/N``; nothing is switched by it.

    Raises
    ------
    RefusedError
        The address has another form, or there is no such light.
    TimedOutError, LostError
        The server does not answer, or not as an Alpaca server.
    """
    form = "http://host:port/switch/0/1 (numbers of the device and of its switch) or http://host:port/covercalibrator/0"
    where = alpaca_address(address, role, form)
    kind, numbers = where.path[0], [device_number(piece) for piece in where.path[1:]]
    name = f"{role} at {address}"
    controlled: Relay | Calibrator
    match kind, numbers:
        case "switch", [int(device), int(switch_number)]:
            controlled = Relay(client := AlpacaClient(where, kind, device, name), switch_number)
        case "covercalibrator", [int(device)]:
            controlled = Calibrator(client := AlpacaClient(where, kind, device, name))
        case _:
            raise RefusedError(f"{role}: '{address}' is not an Alpaca address; write {form}")
    end_s = time.monotonic() + ALPACA_OPENS_WITHIN_S
    client.connect(end_s)
    controlled.require_light(end_s)
    yield ServerLight(AlpacaPanel(client, controlled), role, address)


def found() -> list[tuple[str, str]]:
    """Return address and description of the lights of the Alpaca servers in reach; of a switch device its first."""
    forms = {
        "switch": (
            "{0.server}/switch/{0.number}/0",
            "Alpaca switches {0.name}; the last number chooses one",
        ),
        "covercalibrator": ("{0.server}/covercalibrator/{0.number}", "Alpaca cover calibrator {0.name}"),
    }
    return [
        (forms[device.kind][0].format(device), forms[device.kind][1].format(device))
        for device in alpaca_devices()
        if device.kind in forms
    ]
