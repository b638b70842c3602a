"""A light between its owner and its guard: whoever holds its connection makes it off, and what the two say.

The guard holds the connection, or the owner when the guard is gone. Their messages are JSON objects, one to a packet of
a Unix socket.
"""

import contextlib
import json
import math
import select
import socket
import time
from collections.abc import Callable
from contextlib import AbstractContextManager, ExitStack
from typing import TYPE_CHECKING, Any, Final

from data_schemas import (
    CaptureError,
    FinrayError,
    LostError,
    MissingExtraError,
    RefusedError,
    TimedOutError,
    UnsafeError,
)
from rigs.transports import require_same_board

if TYPE_CHECKING:
    from rigs import GuardedSwitch


LATE_ON_S: Final = 2.0
"""A server whose "on" nobody has confirmed may carry it out so late: "off" is repeated meanwhile."""
RETRY_FOR_S: Final = 5.0
RETRY_PAUSE_S: Final = 0.2


NOBODY_ASKED: Final = "on although nothing had switched it on"


class LightLostError(LostError):
    """A light did not come on, or went off unasked; it is confirmed off, and may be lit again."""


class ReconnectingLight:
    """A light that is made to be off, over a new connection where the old one fails.

    Parameters
    ----------
    opening
        Opens the light's switch.
    name
        What the light is and where, for messages.
    before_opening
        Called before every opening: whoever else has a hand on the line lets go.

    Attributes
    ----------
    serial
        Serial number of the board; empty until it is known, and where there is none.
    """

    def __init__(
        self,
        opening: "Callable[[], AbstractContextManager[GuardedSwitch]]",
        name: str,
        before_opening: Callable[[], None] = lambda: None,
    ) -> None:
        self._opening, self._name, self._before_opening = opening, name, before_opening
        self._connection = ExitStack()
        self._switch: GuardedSwitch | None = None
        self._late_on_until_s = 0.0
        self.serial = ""
        self._is_same = False

    def open(self) -> None:
        """Open the connection; raises what the driver does.

        Raises
        ------
        RefusedError
            The driver's switch lacks something, so that the light could not be guarded.
        """
        # rigs names this package; its protocols are looked up when they are there.
        from rigs import GuardedSwitch, missing_members

        self._before_opening()
        switch = self._connection.enter_context(self._opening())
        if lacking := missing_members(switch, GuardedSwitch):
            raise RefusedError(
                f"{self._name}: its driver {type(switch).__module__} returns a switch that lacks "
                f"{', '.join(lacking)}; update the package that provides it, or tell its author "
                "(docs/how-to/write-a-driver.md)"
            )
        self._switch, self._is_same = switch, False

    def close(self) -> None:
        """Close the connection, also one that is lost."""
        self._switch = None
        with contextlib.suppress(Exception):
            self._connection.close()
        self._connection = ExitStack()

    def reopened(self) -> "GuardedSwitch":
        """Return the switch, over a new connection where there is none; raises what the driver does."""
        if self._switch is None:
            self.open()
        return self.switch

    def same(self) -> "GuardedSwitch":
        """Return the switch of the board that was opened first; "off" may reach another one, nothing else may.

        Raises
        ------
        LostError
            Which board answers cannot be told now.
        RefusedError
            Another board answers, known by its serial number; its connection is closed.
        """
        switch = self.reopened()
        if not self._is_same:
            serial = switch.identity().serial
            try:
                require_same_board(self._name, self.serial, serial)
            except CaptureError:
                self.close()  # the next question looks for the first board again
                raise
            self.serial, self._is_same = serial, True
        return switch

    @property
    def switch(self) -> "GuardedSwitch":
        """The open switch."""
        if self._switch is None:
            raise LostError(f"{self._name}: the connection is closed; run the command again")
        return self._switch

    def expect_late_on(self) -> None:
        """Note that an "on" is under way: until it is confirmed, it may be carried out after an "off"."""
        self._late_on_until_s = math.inf

    def confirm_on(self) -> None:
        """Note that the "on" under way has been carried out."""
        self._late_on_until_s = 0.0

    @property
    def may_come_on_late(self) -> bool:
        """Whether an "on" was sent that nobody confirmed, and the controller has no order of lines to rely on."""
        has_dead_man = self._switch is not None and self._switch.has_dead_man
        return self._late_on_until_s > 0.0 and not has_dead_man

    def make_off(self, attempt_s: float, tell: Callable[[str], None]) -> str | None:
        """Switch off until a fresh answer confirms it, for some seconds; return why it does not, None when off.

        After an "on" that nobody confirmed it is switched off again and again for :data:`LATE_ON_S`. Lines of a
        controller with a dead-man keep their order, and need it not.

        Parameters
        ----------
        attempt_s
            Longest wait for one answer.
        tell
            Called with a word at every step, for those who wait.
        """
        now_s = time.monotonic()
        self._late_on_until_s = min(self._late_on_until_s, now_s + LATE_ON_S)
        end_s = max(now_s, self._late_on_until_s) + RETRY_FOR_S
        while True:
            try:
                if self._switch is None:
                    self.open()
                    tell("opened")
                why_not = self._off_once(attempt_s)
                if why_not is None and (time.monotonic() >= self._late_on_until_s or self.switch.has_dead_man):
                    return None
            except Exception as error:  # whatever goes wrong here, the light must be tried again
                why_not = str(error)
            if why_not is not None:
                # A lost connection never comes back, and opening resets most boards.
                self.close()
                if time.monotonic() > end_s:
                    return why_not
            tell(why_not or "a late command to switch on may still be executed")
            time.sleep(RETRY_PAUSE_S)

    def _off_once(self, attempt_s: float) -> str | None:
        """Switch off and ask; return what is wrong."""
        self.switch.switch(False, attempt_s)
        if self.switch.state(attempt_s):
            return f"{self._name}: still reports that it is on after the command to switch off"
        return None


LONGEST_MESSAGE_BYTES: Final = 65536
EXIT_OFF: Final = 0
"""The guard ended and a fresh answer of the controller says that the light is off."""
EXIT_NOT_OFF: Final = 3

_ERRORS: Final[dict[str, type[FinrayError]]] = {
    kind.__name__: kind
    for kind in (CaptureError, LostError, MissingExtraError, RefusedError, TimedOutError, UnsafeError)
}


class HungUpError(Exception):
    """The other end of the socket is closed."""


def channel() -> tuple[socket.socket, socket.socket]:
    """Return both ends of a socket that keeps messages apart."""
    return socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)


def send(end: socket.socket, **message: object) -> None:
    """Send a message without waiting.

    Raises
    ------
    HungUpError
        Nobody is at the other end.
    BlockingIOError
        The other end has not read for long.
    """
    try:
        end.send(json.dumps(message).encode(), socket.MSG_DONTWAIT | socket.MSG_NOSIGNAL)
    except BlockingIOError:
        raise
    except OSError as error:
        raise HungUpError from error


def receive(end: socket.socket, end_s: float) -> dict[str, Any]:
    """Return the next message; `end_s` is a reading of :func:`time.monotonic`.

    Raises
    ------
    HungUpError
        One of the ends is closed, or what came is no message of ours.
    TimeoutError
        Nothing came until `end_s`.
    """
    try:
        if not select.select([end], [], [], max(end_s - time.monotonic(), 0.0))[0]:
            raise TimeoutError
        try:
            packet = end.recv(LONGEST_MESSAGE_BYTES)
        except ConnectionResetError:
            # Told once when the other end closed without reading all of ours; its last words are still here.
            packet = end.recv(LONGEST_MESSAGE_BYTES)
        message = json.loads(packet)  # nothing at all comes from a closed end
    except TimeoutError:
        raise
    except (OSError, ValueError) as error:
        raise HungUpError from error
    if not isinstance(message, dict):
        raise HungUpError
    return message


def error_words(error: Exception) -> dict[str, str]:
    """Return an error as part of a message: as the nearest class that the other side knows."""
    known = next((kind.__name__ for kind in type(error).__mro__ if kind.__name__ in _ERRORS), None)
    return {"error": known or "CaptureError", "why": str(error) if known else repr(error)}


def error_from(message: dict[str, Any]) -> FinrayError:
    """Return the error that a message tells."""
    return _ERRORS[message["error"]](message["why"])
