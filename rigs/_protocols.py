"""What a calibration rig must be able to do (camera, wheel, lights, operator, clock), and a real clock and operator.

Every exchange has a deadline in seconds on a monotonic clock; a device that misses it raises
:class:`~data_schemas.errors.TimedOutError`. Drivers never guess: a position or state is what the device says, asked
afresh. They raise the children of :class:`~data_schemas.errors.CaptureError` only; each message names the device.

The computer and the person at a real rig are a system clock and a terminal operator. Blocking calls of a camera
library, or of a disk that hangs, are made in order by one thread; the caller waits no longer than its deadline.
"""

import contextlib
import sys
import termios
import threading
import time
from collections.abc import Callable, Mapping
from concurrent.futures import Future
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from datetime import UTC, datetime
from queue import SimpleQueue
from typing import Any, NamedTuple, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from data_schemas import CaptureError, DeviceIdentity, PressDevice, Target


@dataclass(frozen=True, slots=True)
class RawFrame:
    """One exposure as the camera delivered it.

    Attributes
    ----------
    counts
        Raw Bayer counts (DN), shape (H, W).
    exposure_requested_s, exposure_s
        Exposure time that was asked for and the one the camera read back.
    captured_utc
        Start of the exposure by the host's clock, ISO 8601, UTC.
    frame_id
        The camera's own number of the frame, where it gives one; it may wrap.
    device_time_s
        The camera's own time of the frame (s from an arbitrary start), where it gives one.
    settings
        Other settings as the camera reads them back (gain, black level, pixel format), by name.
    """

    counts: NDArray[np.uint16]
    exposure_requested_s: float
    exposure_s: float
    captured_utc: str
    frame_id: int | None = None
    device_time_s: float | None = None
    settings: Mapping[str, str | float] = field(default_factory=dict)


class Clock(Protocol):
    """Source of time: one for labels, one for deadlines."""

    def utc(self) -> str:
        """Return the time of day, ISO 8601, UTC; it may step."""
        ...

    def monotonic_s(self) -> float:
        """Return seconds since an arbitrary start; it never goes back."""
        ...

    def sleep(self, duration_s: float) -> None:
        """Let time pass."""
        ...


class Camera(Protocol):
    """A camera with raw Bayer output and settable exposure."""

    def identity(self) -> DeviceIdentity:
        """Return what the camera says it is."""
        ...

    def expose(self, exposure_s: float, deadline_s: float) -> RawFrame:
        """Take one frame with `exposure_s` seconds; it is there after at most `deadline_s` seconds.

        The frame was exposed after this call began. Frames that the transport calls incomplete, frames seen before
        and pictures that stand in for a missing camera raise :class:`~data_schemas.BadFrameError`.
        """
        ...


class FilterWheel(Protocol):
    """A wheel of filters in front of the camera."""

    def identity(self) -> DeviceIdentity:
        """Return what the wheel says it is."""
        ...

    @property
    def slots(self) -> tuple[int, ...]:
        """Numbers of the slots that can be reached."""
        ...

    def position(self) -> int | None:
        """Return the slot in the beam as the device reports it; None when no filter is (moving, swung out)."""
        ...

    def go_to(self, slot: int, deadline_s: float) -> None:
        """Move until the device is idle and reports `slot` in two polls; at most `deadline_s` seconds.

        Raises
        ------
        RefusedError
            The wheel has no such slot; nothing moved.
        TimedOutError
            It did not arrive before the deadline.
        WrongPositionError
            It came to rest at another slot.
        """
        ...


class Light(Protocol):
    """A light that is off unless a ``with light.lit():`` block is running."""

    def identity(self) -> DeviceIdentity:
        """Return what the light's controller says it is."""
        ...

    def state(self) -> bool:
        """Return whether the light is on, as the device reports it."""
        ...

    def lit(self) -> AbstractContextManager[None]:
        """Switch on for a ``with`` block; off at its end, also when an exception leaves it."""
        ...


class LightSwitch(Protocol):
    """The bare switch of a light: what a driver brings; :mod:`rigs.light_guard` makes a :class:`Light` of it."""

    @property
    def has_dead_man(self) -> bool:
        """Whether the controller itself switches the light off when it hears nothing for half a second."""
        ...

    def identity(self) -> DeviceIdentity:
        """Return what the controller says it is."""
        ...

    def switch(self, on: bool, deadline_s: float) -> None:
        """Switch, and return when a fresh answer of the controller confirms it; at most `deadline_s` seconds.

        Raises
        ------
        UnsafeError
            Off was asked for and is not confirmed.
        """
        ...

    def state(self, deadline_s: float) -> bool:
        """Ask the controller afresh whether the light is on."""
        ...

    def keep_alive(self) -> None:
        """Tell the controller that the host lives; nothing where it has no dead-man."""
        ...


class SwitchOffCommand(NamedTuple):
    """What switches a light off without its driver, which may hang or be gone.

    Attributes
    ----------
    data
        Bytes to send; they may come in the midst of other traffic, and twice.
    line
        Host and port of a server that takes one more connection, or the descriptor of the light's open line.
    """

    data: bytes
    line: tuple[str, int] | int


class GuardedSwitch(LightSwitch, Protocol):
    """The bare switch of a light that a controller or server switches, and a guard can hold."""

    def off_words(self) -> SwitchOffCommand:
        """Return what switches it off over a line that the guard does not hold."""
        ...

    def prove_dead_man(self, deadline_s: float) -> None:
        """Switch on and say nothing until the dead-man has acted; confirmed on in at most `deadline_s` seconds.

        Raises
        ------
        RefusedError
            It did not act, or there is none.
        """
        ...


class OverloadError(CaptureError):
    """A load cell reads its end of scale: the force is beyond what it can measure."""


class ForceLimitError(CaptureError):
    """A force was larger than allowed, and the stage was stopped.

    Attributes
    ----------
    force_n, limit_n
        The reading that passed the limit, and the limit (N); None where the error comes from elsewhere.
    """

    def __init__(self, text: str, force_n: float | None = None, limit_n: float | None = None) -> None:
        super().__init__(text)
        self.force_n, self.limit_n = force_n, limit_n


class CellReading(NamedTuple):
    """One reading of a load cell.

    Attributes
    ----------
    counts
        As the amplifier gives it, signed.
    at_s
        When it was made, at the earliest, on the monotonic clock: by the board's own clock, less what a line takes at
        most. A reading that is later than the end of a move was made after it.
    """

    counts: int
    at_s: float


class LoadCell(Protocol):
    """A load cell that makes readings by itself, several a second; it knows neither newtons nor a tare."""

    def identity(self) -> PressDevice:
        """Return what the amplifier's board says it is."""
        ...

    def read(self, deadline_s: float) -> CellReading:
        """Return the next reading that was not returned yet and is fresh; at most `deadline_s` seconds.

        Readings are passed over that were damaged on the way, or waited for longer than a fifth of a second.

        Raises
        ------
        TimedOutError
            None came before the deadline.
        OverloadError
            The amplifier reads its end of scale.
        LostError
            The connection broke, the board restarted, or its amplifier does not answer.
        """
        ...


class Stage(Protocol):
    """A stage of several axes; all places are absolute machine coordinates in mm, and unknown until it was homed."""

    def identity(self) -> PressDevice:
        """Return what the controller says it is."""
        ...

    def places_mm(self) -> dict[str, float] | None:
        """Ask where the axes stand; None while that is unknown: not homed yet, or lost by a reset, stop or alarm."""
        ...

    def home(self, deadline_s: float, watch: Callable[[], None]) -> None:
        """Have the stage find its zero by its switches, with `watch` called all the while; then its places are known.

        Raises
        ------
        RefusedError
            It has no switches, or does not find them.
        """
        ...

    def counted_mm(self) -> dict[str, float]:
        """Return where the controller counts the axes (mm), whether or not that is true; nothing is trusted by it."""
        ...

    def trust_places(self) -> dict[str, float]:
        """Take where the controller counts the axes for true, because a person brought them there; return it."""
        ...

    def move(self, axis: str, to_mm: float, speed_mm_per_s: float, watch: Callable[[], None]) -> None:
        """Move one axis, and return when the controller has reported its end twice.

        `watch` is called all the while, several times a second. What it raises, or anything else that goes wrong,
        stops the stage before this method is left; a move is never repeated.

        Raises
        ------
        RefusedError
            The place is unknown, or the end lies beyond the travel that the rig file allows; nothing moved.
        TimedOutError, LostError, WrongPositionError
            It did not arrive in time, did not answer, or came to rest elsewhere; it was stopped.
        UnsafeError
            It could not be seen to stop.
        """
        ...

    def stop(self) -> None:
        """Stop at once, and return when it is seen to stand.

        Raises
        ------
        UnsafeError
            It is not seen to stand.
        """
        ...


def missing_members(device: object, protocol: type) -> tuple[str, ...]:
    """Return the methods and properties of a protocol that a device lacks; its properties are not read."""
    names = [
        name
        for above in reversed(protocol.__mro__)
        if getattr(above, "_is_protocol", False)
        for name in vars(above)
        if not name.startswith("_")
    ]
    return tuple(name for name in names if not (hasattr(type(device), name) or hasattr(device, name)))


class Operator(Protocol):
    """Who acts at the rig: a person who is asked, or a stage."""

    def place(self, target: Target) -> None:
        """Put `target` in view, and return when it is there (no deadline: people take their time).

        "white" and "sample" mean a closed, dark box with the wheel in the beam. "sample beside ColorChecker"
        means room light on both and the wheel swung out of the beam.
        """
        ...

    def swing_wheel_out(self) -> None:
        """Take the wheel out of the beam of the target in view, until the next :meth:`place` (no deadline)."""
        ...

    def tilt(self, angle_deg: float) -> None:
        """Turn the sample until its normal and the laser beam enclose `angle_deg`; 0 faces the laser (no deadline)."""
        ...

    def do(self, instruction: str) -> None:
        """Have something done that no device can do, such as turning a filter wheel by hand (no deadline)."""
        ...

    def allows(self, question: str) -> bool:
        """Return whether a person who was asked says yes; False where nobody can be asked (no deadline)."""
        ...


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

    def sleep(self, duration_s: float) -> None:
        """Wait."""
        time.sleep(duration_s)


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
        self.do(f"Turn the sample until the laser beam is at {angle_deg:g} deg to the sample's normal.")

    def do(self, instruction: str) -> None:
        """Show an instruction and wait for Enter.

        Raises
        ------
        CaptureError
            Nobody can answer: standard input is closed.
        """
        discard_typed_input()
        sys.stderr.write(f"\n{instruction}\nPress Enter when done. ")
        sys.stderr.flush()
        if not sys.stdin.readline():
            raise CaptureError(
                f"operator: '{instruction}' needs a person, but standard input is closed; run the capture in a terminal"
            )

    def allows(self, question: str) -> bool:
        """Ask a question that only the word "yes" answers with yes; keys pressed before it was asked do not count."""
        if not (sys.stdin.isatty() and sys.stderr.isatty()):
            return False
        discard_typed_input()
        sys.stderr.write(f"\n{question}\nType yes and press Enter; anything else counts as no. ")
        sys.stderr.flush()
        return sys.stdin.readline().strip().lower() == "yes"


def discard_typed_input() -> None:
    """Drop what was typed at the terminal before a question is asked: it is not an answer."""
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
        self.do(f"Turn the sample until the laser beam is at {angle_deg:g} deg to the sample's normal.")

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

    def post(self, function: Callable[[], T]) -> Future[T]:
        """Make a call when those before it have ended; return what will hold its result, for who wants to wait."""
        answer: Future[T] = Future()
        self._calls.put((function, answer))
        return answer

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
