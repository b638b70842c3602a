"""The guard of a light: a process that alone holds the light's connection and switches off when its owner is gone.

Started by :mod:`rigs.light_guard` as ``python -m rigs.light_guard_process FD ROLE MODULE ADDRESS``. The light goes off,
and a fresh answer of its controller confirms it, when the owner's end of the socket closes, when nothing comes from the
owner for 0.8 s while the light is on, and at SIGTERM and SIGHUP; then the process ends. SIGINT is ignored: Ctrl-C in
a terminal is the owner's affair.
"""

import contextlib
import select
import signal
import socket
import sys
import time
from collections.abc import Callable
from contextlib import AbstractContextManager, ExitStack
from importlib import import_module
from typing import TYPE_CHECKING, Any, Final

from rigs.light_guard_messages import (
    EXIT_NOT_OFF,
    EXIT_OFF,
    OWNER_SILENT_S,
    HungUpError,
    error_words,
    receive,
    send,
)

if TYPE_CHECKING:
    from rigs.protocols import LightSwitch

KEEP_ALIVE_S: Final = 0.25
ATTEMPT_S: Final = 0.5
RETRY_FOR_S: Final = 5.0
RETRY_PAUSE_S: Final = 0.2


class Guard:
    """The guard of one light.

    Parameters
    ----------
    owner
        Socket to the owner.
    opening
        Opens the light's switch.
    name
        What the light is and where, for messages.
    """

    def __init__(
        self, owner: socket.socket, opening: "Callable[[], AbstractContextManager[LightSwitch]]", name: str
    ) -> None:
        self._owner, self._opening, self._name = owner, opening, name
        self._connection = ExitStack()
        self._lit = False
        self._heard_s = self._kept_alive_s = time.monotonic()
        self._signal = ""
        self._why_not_off: str | None = None
        self._woken, waker = socket.socketpair()
        for end in (self._woken, waker):
            end.setblocking(False)
        self._waker = waker

    def run(self) -> int:
        """Open the light, serve its owner, switch off; return the exit status."""
        self._take_signals()
        try:
            self._open()
        except Exception as error:
            self._tell(**error_words(error))
            return 1
        reason = "at the start"
        if self._make_off() is None:
            self._tell(ready=True, has_dead_man=self._switch.has_dead_man)
            reason = self._serve()
        why_not = self._why_not_off or self._make_off()
        self._tell(gone=reason, not_off=why_not)
        if why_not is not None:
            self._shout(why_not)
        with contextlib.suppress(Exception):
            self._connection.close()
        return EXIT_OFF if why_not is None else EXIT_NOT_OFF

    def _take_signals(self) -> None:
        """Note signals instead of dying of them, and let them wake the wait."""
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        for number in (signal.SIGTERM, signal.SIGHUP):
            signal.signal(number, self._note_signal)
        signal.set_wakeup_fd(self._waker.fileno(), warn_on_full_buffer=False)

    def _note_signal(self, number: int, frame: object) -> None:
        self._signal = signal.Signals(number).name

    def _open(self) -> None:
        self._switch = self._connection.enter_context(self._opening())

    def _serve(self) -> str:
        """Do what the owner asks until it is time to go; return why it is."""
        while True:
            if self._signal:
                return f"it received {self._signal}"
            if self._why_not_off is not None:
                return "the light does not go off"
            ready = select.select([self._owner, self._woken], [], [], self._pause_s())[0]
            try:
                if self._owner in ready:
                    self._obey(receive(self._owner, time.monotonic()))
                    continue  # what has come already is read before the owner's silence is judged
            except HungUpError:
                return "its owner is gone"
            if not self._lit:
                continue
            now_s = time.monotonic()
            if now_s - self._heard_s >= OWNER_SILENT_S:
                return f"its owner was frozen for {OWNER_SILENT_S:g} s"
            if now_s - self._kept_alive_s >= KEEP_ALIVE_S:
                self._kept_alive_s = now_s
                try:
                    self._switch.keep_alive()
                except Exception as error:
                    return str(error)

    def _pause_s(self) -> float | None:
        """Return how long nothing is to be done unless something comes."""
        if not self._lit:
            return None
        next_s = min(self._heard_s + OWNER_SILENT_S, self._kept_alive_s + KEEP_ALIVE_S)
        return max(next_s - time.monotonic(), 0.0)

    def _obey(self, message: dict[str, Any]) -> None:
        """Do what one message asks and answer it."""
        # A message that waited here while the guard was busy shows that the owner lived when it was sent, not now.
        self._heard_s = max(self._heard_s, float(message["sent_s"]))
        if "number" not in message:
            return
        try:
            answer: dict[str, object] = {"value": self._do(message["ask"], float(message["deadline_s"]))}
        except Exception as error:
            answer = {**error_words(error)}
        self._tell(number=message["number"], **answer)

    def _do(self, ask: str, deadline_s: float) -> object:
        if ask == "identity":
            return self._switch.identity().model_dump()
        if ask == "state":
            return self._switch.state(deadline_s)
        self._lit = ask == "on"
        if self._lit:
            self._switch.switch(True, deadline_s)
            return None
        return self._make_off()

    def _make_off(self) -> str | None:
        """Switch off until a fresh answer confirms it, for some seconds; return why it does not, None when off."""
        self._lit, self._why_not_off = False, None
        end_s = time.monotonic() + RETRY_FOR_S
        while True:
            try:
                self._switch.switch(False, ATTEMPT_S)
                if not self._switch.state(ATTEMPT_S):
                    return None
                why_not = f"{self._name}: still reports on after the off command"
            except Exception as error:  # whatever goes wrong here, the light must be tried again
                why_not = str(error)
            if time.monotonic() > end_s:
                self._why_not_off = why_not
                return why_not
            self._tell(trying=why_not)
            time.sleep(RETRY_PAUSE_S)
            self._reopen()

    def _reopen(self) -> None:
        """Open the connection anew: a lost one never comes back, and opening resets most boards."""
        with contextlib.suppress(Exception):
            self._connection.close()
        self._connection = ExitStack()
        with contextlib.suppress(Exception):
            self._open()
        self._tell(trying="reopened")

    def _tell(self, **message: object) -> None:
        """Tell the owner, if it is there and listens."""
        with contextlib.suppress(HungUpError, BlockingIOError):
            send(self._owner, **message)

    def _shout(self, why: str) -> None:
        """Tell whoever is at the terminal: the owner may be dead."""
        with contextlib.suppress(OSError, ValueError):
            todo = "IS NOT CONFIRMED OFF. PULL ITS PLUG NOW, BEFORE ANYONE OPENS THE BOX."
            sys.stderr.write(f"\n{self._name.upper()} {todo}\n{why}\n")
            sys.stderr.flush()


def main(arguments: list[str]) -> int:
    """Guard the light that the arguments name."""
    descriptor, role, module, address = arguments

    def opening() -> "AbstractContextManager[LightSwitch]":
        switch: AbstractContextManager[LightSwitch] = import_module(module).open_switch(address, role, None)
        return switch

    with socket.socket(fileno=int(descriptor)) as owner:
        return Guard(owner, opening, f"{role} at {address}").run()


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
