"""The computer and the person at a real rig: system clock, calls with a deadline, terminal operator.

Blocking calls of a camera library, or of a disk that hangs, are made in order by one thread; the caller waits no
longer than its deadline.
"""

import contextlib
import sys
import termios
import threading
import time
from collections.abc import Callable
from concurrent.futures import Future
from datetime import UTC, datetime
from queue import SimpleQueue
from typing import Any, TypeVar

from data_schemas import CaptureError, Target

_TARGETS: dict[Target, str] = {
    "white": "Put the white tile in view, swing the filter wheel into the beam and close the box.",
    "sample": "Put the paint sample in view, swing the filter wheel into the beam and close the box.",
    "sample beside ColorChecker": "Put the sample beside the ColorChecker in view, swing the filter wheel out of the "
    "beam, open the box and switch the room light on.",
}


class SystemClock:
    """Clock of the host."""

    def utc(self) -> str:
        """Return the time of day, ISO 8601, UTC."""
        return datetime.now(UTC).isoformat(timespec="milliseconds")

    def monotonic_s(self) -> float:
        """Return seconds since an arbitrary start."""
        return time.monotonic()


class TerminalOperator:
    """A person at the terminal: reads an instruction, does it, presses Enter."""

    def __init__(self) -> None:
        self._in_view: Target | None = None

    def place(self, target: Target) -> None:
        """Have `target` put in view; nothing is asked when it is there already."""
        if target != self._in_view:
            self._in_view = None
            self.do(_TARGETS[target])
            self._in_view = target

    def swing_wheel_out(self) -> None:
        """Have the filter wheel swung out of the beam."""
        # The next place() asks for the wheel to be swung in again.
        self._in_view = None
        self.do("Swing the filter wheel out of the beam.")

    def tilt(self, angle_deg: float) -> None:
        """Have the sample tilted."""
        self.do(f"Turn the sample until its normal and the laser beam enclose {angle_deg:g} deg.")

    def do(self, instruction: str) -> None:
        """Show an instruction and wait for Enter.

        Raises
        ------
        CaptureError
            Nobody can answer: standard input is closed.
        """
        forget_typed_ahead()
        sys.stderr.write(f"\n{instruction}\nPress Enter when done. ")
        sys.stderr.flush()
        if not sys.stdin.readline():
            raise CaptureError(
                f"operator: '{instruction}' needs a person, and standard input is closed; run the capture in a terminal"
            )

    def allows(self, question: str) -> bool:
        """Ask a question that only the word "yes" answers with yes; keys pressed before it was asked do not count."""
        if not (sys.stdin.isatty() and sys.stderr.isatty()):
            return False
        forget_typed_ahead()
        sys.stderr.write(f"\n{question}\nType yes and press Enter; anything else ends the capture here. ")
        sys.stderr.flush()
        return sys.stdin.readline().strip().lower() == "yes"


def forget_typed_ahead() -> None:
    """Drop what was typed at the terminal before a question is asked: it is no answer."""
    # a program in the background whose terminal is gone has nobody who could have typed
    with contextlib.suppress(termios.error, OSError):
        if sys.stdin.isatty():
            termios.tcflush(sys.stdin, termios.TCIFLUSH)


class AbsentOperator:
    """Nobody, for looking at a rig: nothing is asked, and what a person would have been asked is remembered.

    Attributes
    ----------
    instructions
        What a person would have been asked to do, in order.
    """

    def __init__(self) -> None:
        self.instructions: list[str] = []

    def place(self, target: Target) -> None:
        """Remember that `target` would be put in view."""
        self.do(_TARGETS[target])

    def swing_wheel_out(self) -> None:
        """Remember that the wheel would be swung out."""
        self.do("Swing the filter wheel out of the beam.")

    def tilt(self, angle_deg: float) -> None:
        """Remember that the sample would be tilted."""
        self.do(f"Turn the sample until its normal and the laser beam enclose {angle_deg:g} deg.")

    def do(self, instruction: str) -> None:
        """Remember an instruction."""
        self.instructions.append(instruction)

    def allows(self, question: str) -> bool:
        """Allow nothing."""
        return False


T = TypeVar("T")


class NoAnswerError(Exception):
    """A call did not end in time; it may still be running."""


class CallThread:
    """Makes calls one after the other in a thread of its own.

    A library that hangs in a register exchange can neither be interrupted nor called again. The thread is a daemon, so
    that it does not keep the program from ending either.

    Parameters
    ----------
    name
        Name of the thread.
    """

    def __init__(self, name: str) -> None:
        self._calls: SimpleQueue[tuple[Callable[[], Any], Future[Any]] | None] = SimpleQueue()
        threading.Thread(target=self._work, name=name, daemon=True).start()

    def call(self, function: Callable[[], T], limit_s: float) -> T:
        """Return the result of `function`, or raise what it raises; wait at most `limit_s` seconds.

        Raises
        ------
        NoAnswerError
            It, or one before it, is still running; if it has not begun, it never will.
        """
        answer: Future[T] = Future()
        self._calls.put((function, answer))
        try:
            return answer.result(max(limit_s, 0.0))
        except TimeoutError:
            if not answer.cancel() and answer.done():  # it ended meanwhile, or raised a TimeoutError of its own
                return answer.result()
            raise NoAnswerError from None

    def post(self, function: Callable[[], object]) -> None:
        """Make a call when those before it have ended; nobody waits for its result."""
        self._calls.put((function, Future()))

    def close(self, last: Callable[[], object], limit_s: float) -> None:
        """Make one last call when those before it have ended, and end the thread; wait at most `limit_s` seconds."""
        answer: Future[object] = Future()
        self._calls.put((last, answer))
        self._calls.put(None)
        try:
            answer.exception(limit_s)
        except TimeoutError:
            return

    def _work(self) -> None:
        while (item := self._calls.get()) is not None:
            function, answer = item
            if not answer.set_running_or_notify_cancel():
                continue
            try:
                answer.set_result(function())
            except BaseException as error:
                answer.set_exception(error)
            del function, answer, item
