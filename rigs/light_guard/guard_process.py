"""The guard of a light: a process that alone holds the light's connection and switches off when another is missing.

Started by the owner as ``python -m rigs.light_guard.guard_process FD OWNER_PID ROLE MODULE ADDRESS``; it starts the
watch. The light goes off, and a fresh answer of its controller confirms it, when the owner dies, is stopped or does
not renew its lease, when the watch dies, is stopped or has said "off", and at SIGTERM and SIGHUP; then the process
ends. A controller that is slow to answer does not delay this: waiting for it is given up. SIGINT is ignored: Ctrl-C in
a terminal is the owner's affair. With ``alone`` in the place of FD it is the watch's successor: it confirms "off".
"""

import contextlib
import gc
import math
import select
import signal
import socket
import subprocess
import sys
import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from data_schemas import LostError, TimedOutError
from rigs.light_guard import watch as watch_program
from rigs.light_guard._reconnecting_light import (
    EXIT_NOT_OFF,
    EXIT_OFF,
    NOBODY_ASKED,
    HungUpError,
    ReconnectingLight,
    channel,
    error_words,
    receive,
    send,
)
from rigs.light_guard.watch import LONGEST_PACKET_BYTES, LOOK_S, OtherProcess
from rigs.transports import Fault, fault_listener

if TYPE_CHECKING:
    from rigs import GuardedSwitch, SwitchOffCommand

KEEP_ALIVE_S: Final = 0.08
"""Five fit into the 0.4 s of the firmware's dead-man: four may be lost or late."""
BEAT_S: Final = 0.5
"""Time between two signs of life that a guard sends to the watch while its light is lit."""
LOOK_EVERY_S: Final = 0.5
"""How often a dark light without a dead-man is asked: a server may carry out an "on" of long ago."""
LOOK_WITHIN_S: Final = 2.0
LOOK_ALONE_S: Final = 6.0
"""So long it is switched off again after an "on" that nobody confirmed and whose owner is gone."""
ATTEMPT_S: Final = 0.5
ALONE_FOR_S: Final = 600.0
ARM_WITHIN_S: Final = 2.0
WATCH_ENDS_WITHIN_S: Final = 1.0
MOST_FAULTS: Final = 20  # told with one answer


class GivenUp(BaseException):
    """Nobody waits for the device's answer any more; no driver may take it for an error of its own."""


class Wait:
    """A wait of the main thread for a device, given up when something matters more, whatever library waits.

    Parameters
    ----------
    matters_more
        Asked every few milliseconds, by an alarm: whether to wait no longer.
    """

    def __init__(self, matters_more: Callable[[], bool]) -> None:
        self._matters_more = matters_more
        self._is_waiting = False

    def take_alarms(self) -> None:
        """Let the alarms of this process look up."""
        signal.signal(signal.SIGALRM, self._look_up)

    @contextmanager
    def for_the_light(self) -> Iterator[None]:
        """Wait in a ``with`` block.

        Raises
        ------
        GivenUp
            Something matters more.
        """
        self._is_waiting = True
        signal.setitimer(signal.ITIMER_REAL, LOOK_S, LOOK_S)
        try:
            yield
        finally:
            self._is_waiting = False
            signal.setitimer(signal.ITIMER_REAL, 0.0)

    def _look_up(self, number: int, frame: object) -> None:
        if self._is_waiting and self._matters_more():
            self._is_waiting = False  # once is enough, and never outside of the wait
            raise GivenUp


class WatchLine:
    """The guard's end of the watch: a process that says "off" when owner or guard is missing.

    Parameters
    ----------
    owner_pid
        Process number of the owner.
    name
        What the light is and where, for messages.
    successor
        Command of the program that confirms "off" when nobody else is left.
    """

    def __init__(self, owner_pid: int, name: str, successor: list[str]) -> None:
        self._name = name
        self.socket, theirs = channel()
        self.socket.setblocking(False)
        # -I and -S: no folder of the user's, no site packages, a start in hundredths of a second.
        command = [sys.executable, "-I", "-S", str(Path(watch_program.__file__))]
        with theirs:
            self._process = subprocess.Popen(
                [*command, str(theirs.fileno()), str(owner_pid), name, *successor],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                pass_fds=[theirs.fileno()],
                start_new_session=True,
            )
        self.process = OtherProcess(self._process.pid)
        self._answer = self._fired = ""
        self._lends_descriptor = False
        self._beat_s = 0.0

    def arm(self, until_s: float, words: "SwitchOffCommand") -> None:
        """Give the watch words and line, and return when it is armed.

        Raises
        ------
        LostError
            It is not, and the light must not go on.
        """
        line = words.line
        self._lends_descriptor = isinstance(line, int)
        where = "" if isinstance(line, int) else f" {line[0]} {line[1]}"
        self._answer = ""
        packet = f"arm {until_s}{where}\n".encode() + words.data
        with contextlib.suppress(OSError):  # one that is gone is told below
            socket.send_fds(self.socket, [packet], [line] if isinstance(line, int) else [])
        end_s = time.monotonic() + ARM_WITHIN_S
        while not self._answer and not self.process.missing() and time.monotonic() < end_s:
            select.select([self.socket], [], [], LOOK_S)
            self.listen()
        if self._answer != "armed":
            missing = self.process.missing()
            why = self._answer.removeprefix("no ") or missing or f"did not answer within {ARM_WITHIN_S:g} s"
            raise LostError(
                f"{self._name}: is not switched on, because the process that watches it could not be armed ({why}). "
                "The process needs a second connection to the light's server or port; make sure that the server or "
                "port accepts one, and start again"
            )

    def listen(self) -> None:
        """Take in all that the watch has said."""
        # Nothing more has come, or the watch is gone, which its state tells; any other fault is the guard's own.
        with contextlib.suppress(BlockingIOError, ConnectionResetError):
            while packet := self.socket.recv(LONGEST_PACKET_BYTES):
                text = packet.decode()
                if text.startswith("fired "):
                    self._fired = text.removeprefix("fired ")
                else:
                    self._answer = text

    def trouble(self, is_lit: bool) -> str | None:
        """Return why the light must go off, as far as the watch knows or is the reason."""
        self.listen()
        if self._fired:
            return self._fired
        missing = self.process.missing()
        return f"its watch {missing}" if missing == "is gone" or (missing and is_lit) else None

    def beat(self) -> None:
        """Show that the guard does not hang."""
        if (now_s := time.monotonic()) - self._beat_s >= BEAT_S:
            self._beat_s = now_s
            self._say(b"alive")

    def renew(self, until_s: float) -> None:
        """Pass a renewed lease on."""
        self._say(f"lease {until_s}".encode())

    def let_go(self) -> None:
        """Have a lent descriptor closed: a port that is lost cannot be opened again before."""
        if self._lends_descriptor:
            self._say(b"drop")

    def dark(self) -> None:
        """Say that the light is confirmed off."""
        self._say(b"dark")

    def end(self) -> None:
        """End the watch, and wait until it has let go of the light."""
        self._say(b"end")
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(0.0 if self.process.missing() else WATCH_ENDS_WITHIN_S)
        self._process.kill()  # one that is stopped, for instance
        self._process.wait()

    def _say(self, packet: bytes) -> None:
        with contextlib.suppress(OSError):  # one that is gone or frozen is told by its state
            self.socket.send(packet, socket.MSG_DONTWAIT | socket.MSG_NOSIGNAL)


class Guard:
    """The guard of one light.

    Parameters
    ----------
    owner
        Socket to the owner.
    owner_process
        The owner's process.
    watch
        The third process.
    opening
        Opens the light's switch.
    name
        What the light is and where, for messages.
    """

    def __init__(
        self,
        owner: socket.socket,
        owner_process: OtherProcess,
        watch: WatchLine,
        opening: "Callable[[], AbstractContextManager[GuardedSwitch]]",
        name: str,
    ) -> None:
        self._owner, self._owner_process, self._watch, self._name = owner, owner_process, watch, name
        self._light = ReconnectingLight(opening, name, watch.let_go)
        self._lit = self._is_owner_gone = self._has_dead_man = False
        self._looked_s = time.monotonic()
        self._lease_s = self._lease_until_s = math.inf
        # Given up when the light must go off, or when the owner asks for something else meanwhile.
        self._wait = Wait(lambda: self._reason_to_go() is not None or bool(self._questions))
        self._questions: deque[dict[str, Any]] = deque()
        self._signal = self._doubt = ""
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
            self._watch.end()
            return 1
        reason = "at the start"
        if self._make_off() is None:
            pids = {"watch_pid": self._watch.process.pid}
            self._has_dead_man = self._light.switch.has_dead_man
            self._tell(ready=True, has_dead_man=self._has_dead_man, **pids)
            try:
                reason = self._serve()
            except Exception as error:  # a mistake of ours, and the light may be on
                reason = repr(error)
        why_not = self._why_not_off or self._make_off()
        self._tell(gone=reason, not_off=why_not, was_told=bool(self._signal))
        if why_not is not None:
            shout(self._name, why_not)
        self._listen()
        if self._is_owner_gone:
            why_not = keep_switching_off(self._light, why_not)
        self._light.close()
        if why_not is None:
            self._watch.end()
        return EXIT_OFF if why_not is None else EXIT_NOT_OFF

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
        ends: list[Any] = [self._owner, self._woken, self._watch.socket]
        ends += [*self._owner_process.descriptors, *self._watch.process.descriptors]
        while (reason := self._reason_to_go()) is None:
            if self._questions:
                self._answer(self._questions.popleft())
            elif time.monotonic() >= self._next_look_s():
                if (why := self._look_after()) is not None:
                    return why
            elif self._woken in select.select(ends, [], [], self._pause_s())[0]:
                self._woken.recv(4096)
        return reason

    def _next_look_s(self) -> float:
        """Return when the light must next hear of us, or be looked at; a dark one with a dead-man never."""
        if self._lit:
            return self._looked_s + KEEP_ALIVE_S
        return math.inf if self._has_dead_man else self._looked_s + LOOK_EVERY_S

    def _look_after(self) -> str | None:
        """Keep a lit light alive, and see that a dark one is dark; return why it is time to go."""
        self._looked_s = time.monotonic()
        try:
            if self._lit and self._has_dead_man:  # waits for nothing, and must not be torn from its line
                self._light.switch.keep_alive()
                return None
            with self._wait.for_the_light():
                if self._lit:
                    self._light.switch.keep_alive()
                elif self._light.reopened().state(LOOK_WITHIN_S):
                    return f"the light was {NOBODY_ASKED}"
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
        if self._doubt:
            return self._doubt
        if self._lit:
            self._watch.beat()
            if missing := self._owner_process.missing():
                return f"its owner {missing}"
            if time.monotonic() >= self._lease_until_s:
                return f"the program that switched it on sent nothing for {self._lease_s:g} s"
        return self._watch.trouble(self._lit)

    def _listen(self) -> None:
        """Take in all that has come from the owner, before its silence is judged."""
        while True:
            try:
                message = receive(self._owner, time.monotonic())
            except TimeoutError:
                return  # that was all
            except HungUpError:
                self._is_owner_gone = True
                return
            # One that waited here while the guard was busy shows that the owner worked when it was sent, not now.
            self._lease_s = float(message["lease_s"])
            self._lease_until_s = float(message["sent_s"]) + self._lease_s
            if self._lit:
                self._watch.renew(self._lease_until_s)
            self._questions.append(message)

    def _pause_s(self) -> float | None:
        """Return how long nothing is to be done unless something comes; None for ever."""
        if self._lit:
            return LOOK_S
        next_s = self._next_look_s()
        return None if math.isinf(next_s) else max(next_s - time.monotonic(), 0.0)

    def _answer(self, message: dict[str, Any]) -> None:
        """Do what one message asks and answer it."""
        faults: list[Fault] = []
        self._light.serial = self._light.serial or str(message.get("serial", ""))
        try:
            with fault_listener(faults.append):
                answer: dict[str, object] = {"value": self._do(message["ask"], float(message["deadline_s"]))}
        except GivenUp:
            return
        except Exception as error:
            answer = {**error_words(error)}
            if isinstance(error, LostError | TimedOutError):
                if self._lit:
                    self._doubt = f"it is on, and its state cannot be read ({error})"
                else:
                    self._light.close()  # the next question opens it anew
        self._tell(number=message["number"], serial=self._light.serial, faults=faults[-MOST_FAULTS:], **answer)

    def _do(self, ask: str, deadline_s: float) -> object:
        if ask == "off":
            return self._make_off()
        with self._wait.for_the_light():
            switch = self._light.same()
            if ask == "identity":
                return switch.identity().model_dump()
            if ask == "state":
                return switch.state(deadline_s)
            self._lit, words = True, switch.off_words()
            self._watch.arm(self._lease_until_s, words)
            self._light.expect_late_on()
            if ask == "on":
                switch.switch(True, deadline_s)
            else:
                switch.prove_dead_man(deadline_s)
            self._light.confirm_on()
            self._looked_s = time.monotonic()
        return _for_the_owner(words) if ask == "on" else self._make_off()

    def _make_off(self) -> str | None:
        """Switch off; return why the light does not go off, None when it is confirmed off."""

        def tell(word: str) -> None:
            self._watch.beat()
            self._tell(trying=word)

        self._lit = False
        self._why_not_off = self._light.make_off(ATTEMPT_S, tell)
        if self._why_not_off is None:
            self._watch.dark()
            gc.collect()  # in the dark it delays nothing
        return self._why_not_off

    def _tell(self, **message: object) -> None:
        """Tell the owner, if it is there and listens."""
        with contextlib.suppress(HungUpError, BlockingIOError):
            send(self._owner, **message)


def _for_the_owner(words: "SwitchOffCommand") -> tuple[str, int, str] | None:
    """Return host, port and words for the light's owner; None where the line is a port that has one opener."""
    return None if isinstance(words.line, int) else (*words.line, words.data.decode("latin-1"))


def keep_switching_off(light: ReconnectingLight, why_not: str | None) -> str | None:
    """Where no owner is left that could: go on trying, for the light of a server may come back with it, lit.

    A light that is off stays watched for a while where an "on" may still be on its way.
    """
    began_s, failure = time.monotonic(), why_not
    watch_s = LOOK_ALONE_S if light.may_come_on_late else 0.0
    while time.monotonic() < began_s + (watch_s if failure is None else ALONE_FOR_S):
        time.sleep(LOOK_EVERY_S)
        failure = light.make_off(ATTEMPT_S, lambda word: None)
    return failure


def shout(name: str, why: str) -> None:
    """Tell whoever is at the terminal: the owner may be dead."""
    with contextlib.suppress(OSError, ValueError):
        todo = "IS NOT CONFIRMED OFF. PULL ITS PLUG NOW, BEFORE ANYONE OPENS THE BOX."
        sys.stderr.write(f"\n{name.upper()} {todo}\n{why}\n")
        sys.stderr.flush()


def main(arguments: list[str]) -> int:
    """Guard the light that the arguments name."""
    descriptor, owner_pid, role, module, address = arguments
    name = f"{role} at {address}"

    def opening() -> "AbstractContextManager[GuardedSwitch]":
        switch: AbstractContextManager[GuardedSwitch] = import_module(module).open_switch(address, role, None)
        return switch

    if descriptor == "alone":
        light = ReconnectingLight(opening, name)
        light.expect_late_on()
        if (why_not := light.make_off(ATTEMPT_S, lambda word: None)) is not None:
            shout(name, why_not)
        return EXIT_OFF if keep_switching_off(light, why_not) is None else EXIT_NOT_OFF
    gc.disable()  # it would delay by tenths of a second
    with socket.socket(fileno=int(descriptor)) as owner:
        try:
            owner_process = OtherProcess(int(owner_pid))
        except OSError:
            return EXIT_OFF  # it has gone already
        module_of_guard = "rigs.light_guard.guard_process"
        successor = [sys.executable, "-P", "-m", module_of_guard, "alone", owner_pid, role, module, address]
        watch = WatchLine(int(owner_pid), name, successor)
        return Guard(owner, owner_process, watch, opening, name).run()


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
