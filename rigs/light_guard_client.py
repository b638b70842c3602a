"""The owner's end of a light's guard process: starting it, asking it, and what follows when it is gone."""

import contextlib
import math
import signal
import socket
import subprocess
import sys
import threading
import time
from contextlib import AbstractContextManager
from importlib import import_module
from typing import TYPE_CHECKING, Any, Final, Literal

from data_schemas.errors import FinrayError, LostError, TimedOutError, UnsafeError
from rigs.held_light import HeldLight
from rigs.light_guard_messages import EXIT_OFF, HEARTBEAT_S, HungUpError, channel, error_from, receive, send

if TYPE_CHECKING:
    from rigs.protocols import LightSwitch

SWITCH_DEADLINE_S: Final = 5.0
GUARD_SILENT_S: Final = 4.5
"""A guard that tries to switch off says so at least this often: opening a port and waiting for a board takes 3.5 s."""
START_WITHIN_S: Final = 45.0
"""Opening a light may take 30 s (INDI), and its driver says better than we what is wrong."""
LEAVE_WITHIN_S: Final = 15.0
END_WITHIN_S: Final = 1.0
ANSWER_MARGIN_S: Final = 0.5
"""What the guard's answer takes beyond the light's."""
RESCUE_ATTEMPT_S: Final = 1.0


class GuardClient:
    """A running guard process, as its owner sees it.

    Parameters
    ----------
    role, module, address
        What the light is, the module of its driver and where its controller is.
    patience_s
        An owner that asks nothing for so long hangs, though its heart beats: a lit light goes off.
    """

    def __init__(self, role: Literal["laser", "lamp"], module: str, address: str, patience_s: float = math.inf) -> None:
        self.name = f"{role} at {address}"
        self.has_dead_man = False
        self._role, self._module, self._address = role, module, address
        self._number, self._asked_s, self._patience_s = 0, time.monotonic(), patience_s
        self._is_on_unanswered = False
        self._ending: FinrayError | None = None
        self._end_once, self._send_once = threading.Lock(), threading.Lock()
        self._closing = threading.Event()
        self._channel, theirs = channel()
        # -P: a file of the user's folder must not stand in for a module of ours.
        command = [sys.executable, "-P", "-m", "rigs.light_guard_process"]
        with theirs:
            self._guard = subprocess.Popen(
                [*command, str(theirs.fileno()), role, self._module, address],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                pass_fds=[theirs.fileno()],
                start_new_session=True,
            )
        self._heart = threading.Thread(target=self._beat, name=f"heartbeat of {self.name}", daemon=True)

    @property
    def pid(self) -> int:
        """Process number of the guard."""
        return self._guard.pid

    def open(self) -> None:
        """Wait until the guard has opened the light and it is confirmed off."""
        while "ready" not in (message := self._listen(START_WITHIN_S)):
            if "error" in message:
                self._ending = error_from(message)
                raise self._ending
        self.has_dead_man = bool(message["has_dead_man"])
        self._heart.start()

    def close(self) -> None:
        """End the guard; it switches off once more.

        Raises
        ------
        UnsafeError
            The light is not confirmed off.
        """
        self._closing.set()
        if self._heart.ident is not None:
            self._heart.join()
        with self._channel:
            with contextlib.suppress(OSError):
                self._channel.shutdown(socket.SHUT_WR)
            with contextlib.suppress(subprocess.TimeoutExpired):
                self._guard.wait(LEAVE_WITHIN_S)
            if self._guard.poll() != EXIT_OFF and isinstance(error := self._end(), UnsafeError):
                raise error

    def ask(self, ask: str, deadline_s: float) -> Any:
        """Have the guard do something and return its answer.

        Raises
        ------
        CaptureError
            What the light's driver raised.
        TimedOutError
            The guard did not answer.
        LostError
            The guard process is gone; the light is confirmed off.
        UnsafeError
            The guard process is gone, and the light is not confirmed off.
        """
        self._asked_s = time.monotonic()
        with self._send_once:
            self._number += 1
            number = self._number
            self._is_on_unanswered |= ask == "on"
            self._say(number=number, ask=ask, deadline_s=deadline_s)
        while True:
            message = self._listen(max(deadline_s + ANSWER_MARGIN_S, GUARD_SILENT_S))
            if message.get("number") != number:
                continue  # it tries again, or an interrupted question is answered now
            if "error" in message:
                raise error_from(message)
            self._is_on_unanswered &= ask not in ("on", "off")
            return message["value"]

    def switch_off(self) -> None:
        """Have the light switched off; a guard that does not answer is killed and replaced by ourselves.

        Raises
        ------
        LostError
            The guard process is gone; the light is confirmed off.
        UnsafeError
            The light is not confirmed off.
        """
        try:
            why_not = self.ask("off", SWITCH_DEADLINE_S)
        except TimedOutError as error:
            self._guard.kill()
            raise self._end() from error
        if why_not is not None:
            raise UnsafeError(self._unconfirmed(str(why_not)))

    def _say(self, **message: object) -> None:
        try:
            send(self._channel, sent_s=time.monotonic(), **message)
        except HungUpError as error:
            raise self._end() from error
        except BlockingIOError as error:
            raise TimedOutError(f"{self.name}: its guard process is frozen") from error

    def _listen(self, within_s: float) -> dict[str, Any]:
        try:
            message = receive(self._channel, time.monotonic() + within_s)
        except HungUpError as error:
            raise self._end() from error
        except TimeoutError as error:
            raise TimedOutError(f"{self.name}: its guard process said nothing for {within_s:g} s") from error
        if "gone" in message:
            raise self._end(message)
        return message

    def _beat(self) -> None:
        """Tell the guard that we live; when it is gone, switch the light off ourselves, at once."""
        while not self._closing.wait(HEARTBEAT_S):
            if time.monotonic() - self._asked_s > self._patience_s:
                continue
            try:
                with self._send_once:
                    send(self._channel, sent_s=time.monotonic())
            except BlockingIOError:
                continue
            except HungUpError:
                self._end()
                return

    def _end(self, farewell: dict[str, Any] | None = None) -> FinrayError:
        """Make sure that the guard is gone and the light off; return the error that tells it, the same every time."""
        with self._end_once:
            if self._ending is None:
                self._ending = self._find_ending(farewell or self._farewell())
            return self._ending

    def _farewell(self) -> dict[str, Any]:
        """Return the guard's last message, if it left one unread."""
        with contextlib.suppress(HungUpError, TimeoutError):
            while True:
                message = receive(self._channel, time.monotonic())
                if "gone" in message:
                    return message
        return {}

    def _find_ending(self, farewell: dict[str, Any]) -> FinrayError:
        with contextlib.suppress(subprocess.TimeoutExpired):
            # One that has hung up or said farewell ends by itself.
            self._guard.wait(END_WITHIN_S)
        if self._guard.poll() is None:
            self._guard.kill()
            self._guard.wait()
        status = self._guard.returncode
        if farewell.get("not_off") is not None:
            return UnsafeError(self._unconfirmed(farewell["not_off"]))
        died = f"killed by {signal.Signals(-status).name}" if status < 0 else f"exit status {status}"
        reason = farewell.get("gone", died)
        if status == EXIT_OFF:
            return LostError(
                f"{self.name}: the guard process has ended ({reason}); it had the light confirmed off before. Take "
                "the capture up again with --resume"
            )
        if (why_not := self._rescue()) is not None:
            return UnsafeError(self._unconfirmed(f"the guard process has ended ({reason}), and then: {why_not}"))
        return LostError(
            f"{self.name}: the guard process has ended ({reason}); the light has been switched off without it and is "
            "confirmed off. Take the capture up again with --resume"
        )

    def _rescue(self) -> str | None:
        """Switch off over a connection of our own, now that the guard's is free; return why it does not go off."""

        def opening() -> "AbstractContextManager[LightSwitch]":
            switch: AbstractContextManager[LightSwitch]
            switch = import_module(self._module).open_switch(self._address, self._role, None)
            return switch

        light = HeldLight(opening, self.name)
        if self._is_on_unanswered:
            light.expect_late_on()
        try:
            return light.make_off(RESCUE_ATTEMPT_S, lambda word: None)
        finally:
            light.close()

    def _unconfirmed(self, why: str) -> str:
        dead_man = (
            " Its dead-man switches it off within 1 s of the last word it heard, but that cannot be read."
            if self.has_dead_man
            else ""
        )
        todo = "pull its plug before anyone opens the box"
        return f"{self.name}: NOT CONFIRMED OFF; {todo}.{dead_man} What went wrong: {why}"
