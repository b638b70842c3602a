"""The guard of a light: a process that alone holds the light's connection and switches off when its owner is gone.

Started by :mod:`rigs.light_guard` as ``python -m rigs.light_guard_process FD ROLE MODULE ADDRESS``. The light goes off,
and a fresh answer of its controller confirms it, when the owner's end of the socket closes, when nothing comes from the
owner for 0.8 s while the light is on, and at SIGTERM and SIGHUP; then the process ends. A controller that is slow to
answer does not delay this: waiting for it is given up. SIGINT is ignored: Ctrl-C in a terminal is the owner's affair.
"""

import contextlib
import math
import select
import signal
import socket
import sys
import time
from collections import deque
from collections.abc import Callable
from contextlib import AbstractContextManager
from importlib import import_module
from typing import TYPE_CHECKING, Any, Final

from rigs.held_light import HeldLight
from rigs.interruptible_wait import GivenUp, Wait
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

KEEP_ALIVE_S: Final = 0.15
"""Four fit into the 0.7 s of the firmware's dead-man: three may be lost or late."""
LOOK_EVERY_S: Final = 0.5
"""How often a dark light without a dead-man is asked: a server may carry out an "on" of long ago."""
LOOK_WITHIN_S: Final = 2.0
LOOK_ALONE_S: Final = 6.0
"""So long it is switched off again after an "on" that nobody confirmed and whose owner is gone."""
ATTEMPT_S: Final = 0.5
ALONE_FOR_S: Final = 600.0


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
        self._lit = self._is_owner_gone = False
        self._heard_s = self._looked_s = time.monotonic()
        # Given up when the light must go off, or when the owner asks for something else meanwhile.
        self._wait = Wait(lambda: self._reason_to_go() is not None or bool(self._questions))
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

    def _go_on_alone(self, why_not: str | None) -> str | None:
        """Where no owner is left that could: go on trying, for the light of a server may come back with it, lit.

        A light that is off stays watched for a while where an "on" may still be on its way.
        """
        began_s, failure = time.monotonic(), why_not
        watch_s = LOOK_ALONE_S if self._light.may_come_on_late else 0.0
        self._listen()
        while self._is_owner_gone and time.monotonic() < began_s + (watch_s if failure is None else ALONE_FOR_S):
            time.sleep(LOOK_EVERY_S)
            failure = self._make_off()
        return failure

    def _take_signals(self) -> None:
        """Note signals instead of dying of them, and let them wake the wait."""
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        for number in (signal.SIGTERM, signal.SIGHUP):
            signal.signal(number, self._note_signal)
        self._wait.take_alarms()
        signal.set_wakeup_fd(self._waker.fileno(), warn_on_full_buffer=False)

    def _note_signal(self, number: int, frame: object) -> None:
        self._signal = signal.Signals(number).name

    def _serve(self) -> str:
        """Do what the owner asks until it is time to go; return why it is."""
        while (reason := self._reason_to_go()) is None:
            if self._questions:
                self._answer(self._questions.popleft())
            elif time.monotonic() >= self._next_look_s():
                if (why := self._look_after()) is not None:
                    return why
            elif self._woken in select.select([self._owner, self._woken], [], [], self._pause_s())[0]:
                self._woken.recv(4096)
        return reason

    def _next_look_s(self) -> float:
        """Return when the light must next hear of us, or be looked at; a dark one with a dead-man never."""
        if self._lit:
            return self._looked_s + KEEP_ALIVE_S
        return math.inf if self._light.switch.has_dead_man else self._looked_s + LOOK_EVERY_S

    def _look_after(self) -> str | None:
        """Keep a lit light alive, and see that a dark one is dark; return why it is time to go."""
        self._looked_s = time.monotonic()
        switch = self._light.switch
        try:
            if self._lit and switch.has_dead_man:  # waits for nothing, and must not be torn from its line
                switch.keep_alive()
                return None
            with self._wait.for_the_light():
                if self._lit:
                    switch.keep_alive()
                elif switch.state(LOOK_WITHIN_S):
                    return "the light was on although nobody had asked for it"
        except GivenUp:
            return None
        except Exception as error:  # a dark light that cannot be asked now is asked again
            return str(error) if self._lit else None
        return None

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
        """Return how long nothing is to be done unless something comes; None for ever."""
        next_s = self._next_look_s()
        if self._lit:
            next_s = min(next_s, self._heard_s + OWNER_SILENT_S)
        return None if math.isinf(next_s) else max(next_s - time.monotonic(), 0.0)

    def _answer(self, message: dict[str, Any]) -> None:
        """Do what one message asks and answer it."""
        try:
            answer: dict[str, object] = {"value": self._do(message["ask"], float(message["deadline_s"]))}
        except GivenUp:
            return
        except Exception as error:
            answer = {**error_words(error)}
        self._tell(number=message["number"], **answer)

    def _do(self, ask: str, deadline_s: float) -> object:
        if ask == "off":
            return self._make_off()
        with self._wait.for_the_light():
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
