"""The bare switch of a light behind a server that keeps it on when its client dies, as those of INDI and Alpaca do."""

import time
from typing import Final, Literal, Protocol

from data_schemas import CaptureError, DeviceIdentity, LostError, RefusedError, UnsafeError
from rigs import SwitchOffCommand

HAS_DEAD_MAN: Final = False
LightRole = Literal["laser", "lamp"]
ASK_WITHIN_S: Final = 5.0
ASK_EVERY_S: Final = 0.5
"""How often a lit light is asked whether it is still on."""
STILL_ON_WITHIN_S: Final = 2.0


class Panel(Protocol):
    """A light as its server offers it; instants `end_s` are readings of :func:`time.monotonic`."""

    @property
    def name(self) -> str:
        """Role and address, for messages."""
        ...

    def identity(self, role: LightRole, address: str, end_s: float) -> DeviceIdentity:
        """Ask what it is."""
        ...

    def connect(self, end_s: float) -> None:
        """Connect again after the connection was lost."""
        ...

    def set(self, on: bool, end_s: float) -> None:
        """Switch, and return when a fresh answer confirms it."""
        ...

    def reading(self, end_s: float) -> bool:
        """Ask afresh whether it is on; one that is changing counts as on."""
        ...

    def off_words(self) -> SwitchOffCommand:
        """Return what switches it off over a connection of somebody else."""
        ...


class ServerLight:
    """The bare switch of a light behind a server.

    Parameters
    ----------
    panel
        The light as its server offers it.
    role, address
        What it is in the rig, and where it was found.
    """

    has_dead_man: Final = HAS_DEAD_MAN

    def __init__(self, panel: Panel, role: LightRole, address: str) -> None:
        self._panel, self._role, self._address = panel, role, address
        self._is_confirmed_on = False
        self._asked_s = 0.0

    def identity(self) -> DeviceIdentity:
        """Ask the server what the light is."""
        return self._panel.identity(self._role, self._address, time.monotonic() + ASK_WITHIN_S)

    def switch(self, on: bool, deadline_s: float) -> None:
        """Switch, and return when a fresh answer confirms it; at most `deadline_s` seconds.

        Raises
        ------
        UnsafeError
            Off was asked for and is not confirmed.
        RefusedError
            The device refuses to switch on.
        TimedOutError
            On is not confirmed before the deadline.
        LostError
            The connection broke before on was confirmed.
        """
        end_s = time.monotonic() + deadline_s
        self._is_confirmed_on = False
        if on:
            self._panel.set(True, end_s)
            self._is_confirmed_on, self._asked_s = True, time.monotonic()
            return
        try:
            try:
                self._panel.set(False, end_s)
            except LostError:
                # A server or driver that comes back has its device as it was: lit.
                self._panel.connect(end_s)
                self._panel.set(False, end_s)
        except CaptureError as error:
            raise UnsafeError(
                f"{self._panel.name}: off is not confirmed; cut the power of the light before you open the box. "
                f"The reason: {error}"
            ) from error

    def state(self, deadline_s: float) -> bool:
        """Ask the server afresh whether the light is on.

        Raises
        ------
        RefusedError
            It does not know.
        """
        return self._panel.reading(time.monotonic() + deadline_s)

    def off_words(self) -> SwitchOffCommand:
        """Return what switches it off over a connection of the watch."""
        return self._panel.off_words()

    def prove_dead_man(self, deadline_s: float) -> None:
        """Refuse: a server has no dead-man.

        Raises
        ------
        RefusedError
            Always.
        """
        raise RefusedError(f"{self._panel.name}: a light behind a server has no dead-man that could be tested")

    def keep_alive(self) -> None:
        """Ask, twice a second, whether the light that was switched on still is: there is no dead-man to be told.

        Raises
        ------
        LostError
            It is off, or the server has gone.
        TimedOutError
            The server does not answer.
        """
        now_s = time.monotonic()
        if not self._is_confirmed_on or now_s - self._asked_s < ASK_EVERY_S:
            return
        self._asked_s = now_s
        if not self._panel.reading(now_s + STILL_ON_WITHIN_S):
            raise LostError(
                f"{self._panel.name}: is off although it was switched on; check whether another program or a "
                "person switched it, and check its power supply"
            )
