"""The guard of a light: a process that alone holds the light's connection and switches off when its owner is gone.

Started by :mod:`rigs.light_guard` as ``python -m rigs.light_guard_process FD ROLE MODULE ADDRESS``. The light goes off,
and a fresh answer of its controller confirms it, when the owner's end of the socket closes, when nothing comes from the
owner for 0.8 s while the light is on, and at SIGTERM and SIGHUP; then the process ends. A controller that is slow to
answer does not delay this: waiting for it is given up. SIGINT is ignored: Ctrl-C in a terminal is the owner's affair.
"""

import contextlib
import select
import signal
import socket
import sys
import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from importlib import import_module
from typing import TYPE_CHECKING, Any, Final

from rigs.held_light import HeldLight
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
ALONE_FOR_S: Final = 600.0
WATCH_S: Final = 0.02
"""How often the guard looks for its owner while it waits for the light; of the 50 ms in which it sends "off"."""


class _GivenUp(BaseException):
    """Nobody waits for the light's answer any more; no driver may take it for an error of its own."""


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
        self._owner, self._name = owner, name
        self._light = HeldLight(opening, name)
        self._lit = self._is_watching = self._is_owner_gone = False
        self._heard_s = self._kept_alive_s = time.monotonic()
        self._questions: deque[dict[str, Any]] = deque()
        self._signal = ""
        self._why_not_off: str | None = None
        self._woken, self._waker = socket.socketpair()
        for end in (self._woken, self._waker):
            end.setblocking(False)

    def run(self) -> int:
        """Open the light, serve its owner, switch off; return the exit status."""
        self._take_signals()
        try:
            self._light.open()
        except Exception as error:
            self._tell(**error_words(error))
            return 1
        reason = "at the start"
        if self._make_off() is None:
            self._tell(ready=True, has_dead_man=self._light.switch.has_dead_man)
            try:
                reason = self._serve()
            except Exception as error:  # a mistake of ours, and the light may be on
                reason = repr(error)
        why_not = self._why_not_off or self._make_off()
        self._tell(gone=reason, not_off=why_not)
        if why_not is not None:
            self._shout(why_not)
            why_not = self._go_on_alone(why_not)
        self._light.close()
        return EXIT_OFF if why_not is None else EXIT_NOT_OFF

    def _go_on_alone(self, why_not: str) -> str | None:
        """Where no owner is left that could: go on trying, for the light of a server may come back with it, lit."""
        end_s = time.monotonic() + ALONE_FOR_S
        failure: str | None = why_not
        self._listen()
        while failure is not None and self._is_owner_gone and time.monotonic() < end_s:
            failure = self._make_off()
        return failure

    def _take_signals(self) -> None:
        """Note signals instead of dying of them, and let them wake the wait."""
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        for number in (signal.SIGTERM, signal.SIGHUP):
            signal.signal(number, self._note_signal)
        signal.signal(signal.SIGALRM, self._look_up)
        signal.set_wakeup_fd(self._waker.fileno(), warn_on_full_buffer=False)

    def _note_signal(self, number: int, frame: object) -> None:
        self._signal = signal.Signals(number).name

    def _serve(self) -> str:
        """Do what the owner asks until it is time to go; return why it is."""
        while (reason := self._reason_to_go()) is None:
            if self._questions:
                self._answer(self._questions.popleft())
            elif self._lit and time.monotonic() - self._kept_alive_s >= KEEP_ALIVE_S:
                self._kept_alive_s = time.monotonic()
                try:
                    self._light.switch.keep_alive()
                except Exception as error:
                    return str(error)
            elif self._woken in select.select([self._owner, self._woken], [], [], self._pause_s())[0]:
                self._woken.recv(4096)
        return reason

    def _reason_to_go(self) -> str | None:
        """Take in what has come; return why the light must go off now, None when it need not."""
        self._listen()
        if self._signal:
            return f"it received {self._signal}"
        if self._why_not_off is not None:
            return "the light does not go off"
        if self._is_owner_gone:
            return "its owner is gone"
        if self._lit and time.monotonic() - self._heard_s >= OWNER_SILENT_S:
            return f"its owner was frozen for {OWNER_SILENT_S:g} s"
        return None

    def _listen(self) -> None:
        """Take in all that has come from the owner, before its silence is judged."""
        try:
            while True:
                message = receive(self._owner, time.monotonic())
                # One that waited here while the guard was busy shows that the owner lived when it was sent, not now.
                self._heard_s = max(self._heard_s, float(message["sent_s"]))
                if "number" in message:
                    self._questions.append(message)
        except TimeoutError:
            pass
        except HungUpError:
            self._is_owner_gone = True

    def _pause_s(self) -> float | None:
        """Return how long nothing is to be done unless something comes."""
        if not self._lit:
            return None
        next_s = min(self._heard_s + OWNER_SILENT_S, self._kept_alive_s + KEEP_ALIVE_S)
        return max(next_s - time.monotonic(), 0.0)

    @contextmanager
    def _watching(self) -> Iterator[None]:
        """Look up from waiting for the light, every few milliseconds."""
        self._is_watching = True
        signal.setitimer(signal.ITIMER_REAL, WATCH_S, WATCH_S)
        try:
            yield
        finally:
            self._is_watching = False
            signal.setitimer(signal.ITIMER_REAL, 0.0)

    def _look_up(self, number: int, frame: object) -> None:
        """Give up waiting for the light when it must go off, or when the owner asks for something else meanwhile."""
        if self._is_watching and (self._reason_to_go() is not None or self._questions):
            self._is_watching = False  # once is enough, and never outside of the wait
            raise _GivenUp

    def _answer(self, message: dict[str, Any]) -> None:
        """Do what one message asks and answer it."""
        try:
            answer: dict[str, object] = {"value": self._do(message["ask"], float(message["deadline_s"]))}
        except _GivenUp:
            return
        except Exception as error:
            answer = {**error_words(error)}
        self._tell(number=message["number"], **answer)

    def _do(self, ask: str, deadline_s: float) -> object:
        if ask == "off":
            return self._make_off()
        with self._watching():
            switch = self._light.switch
            if ask == "identity":
                return switch.identity().model_dump()
            if ask == "state":
                return switch.state(deadline_s)
            self._lit = True
            self._light.expect_late_on()
            switch.switch(True, deadline_s)
            self._light.confirm_on()
            return None

    def _make_off(self) -> str | None:
        """Switch off; return why the light does not go off, None when it is confirmed off."""
        self._lit = False
        self._why_not_off = self._light.make_off(ATTEMPT_S, lambda word: self._tell(trying=word))
        return self._why_not_off

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
