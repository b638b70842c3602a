"""Devices of a watched session: their calls can be left when light is to be off, and end before a device is closed."""

import contextvars
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future, wait
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, Final, Literal, TypeVar

from data_schemas import DeviceIdentity, LostError, Target, UnsafeError
from rigs import CallThread, Camera, FilterWheel, Light, Operator, RawFrame
from rigs.light_guard import LightLostError
from rigs.transports import RECOVERS_WITHIN_S

if TYPE_CHECKING:
    from rigs.live_view._watched_session import WatchedSession

T = TypeVar("T")
LightRole = Literal["lamp", "laser"]
CALL_MARGIN_S: Final = 0.5
"""A driver reports a missed deadline slightly after the deadline has passed."""
THROWN_AWAY: Final = "the light was switched off by hand in the view; the frame under way is discarded"


class HandsOnBench:
    """A person who is asked, and the simulated bench where what was asked is then done."""

    def __init__(self, person: Operator, bench: Operator) -> None:
        self._person, self._bench = person, bench

    def place(self, target: Target) -> None:
        self._person.place(target)
        self._bench.place(target)

    def swing_wheel_out(self) -> None:
        self._person.swing_wheel_out()
        self._bench.swing_wheel_out()

    def tilt(self, angle_deg: float) -> None:
        self._person.tilt(angle_deg)
        self._bench.tilt(angle_deg)

    def do(self, instruction: str) -> None:
        self._person.do(instruction)
        self._bench.do(instruction)

    def allows(self, question: str) -> bool:
        return self._person.allows(question)


class DarkenedCalls:
    """Makes calls of camera and wheel in order in a thread, and leaves them when light is to be off.

    A call that was left keeps its deadline. Until it has ended no other begins, and the devices are not closed; one
    that does not end in time leaves its device to be reopened: nothing is asked of it any more.
    """

    def __init__(self, session: "WatchedSession") -> None:
        self._session, self._thread = session, CallThread("watched devices")
        self._running: Future[Any] | None = None
        self._ends_s = 0.0
        self._is_over = False

    def call(self, function: Callable[[], T], deadline_s: float = RECOVERS_WITHIN_S) -> T:
        """Return what `function` returns, which takes at most `deadline_s` seconds by its own word.

        Raises
        ------
        LightLostError
            A light was to go off; the call goes on, and what it returns is thrown away.
        LostError
            A call that was left has not ended within its deadline.
        """
        if self._running is not None:
            self._session.wait_for(self._running, self._left_s())
        if self._session.must_go_dark:
            raise LightLostError(THROWN_AWAY)
        if self._running is not None and not self._running.done():
            raise LostError(
                "camera or filter wheel: a call that was still running when the light went off has not ended within "
                "its deadline; end the session, plug the device in again, and resume"
            )
        context, answer = contextvars.copy_context(), Future[T]()

        def run() -> None:
            if self._is_over or not answer.set_running_or_notify_cancel():
                return
            try:
                answer.set_result(context.run(function))
            except BaseException as error:
                answer.set_exception(error)
            self._session.wake()

        self._running, self._ends_s = answer, time.monotonic() + deadline_s
        self._thread.post(run)
        self._session.wait_for(answer)
        if not answer.done():
            answer.cancel()  # if it has not begun, it never will
            raise LightLostError(THROWN_AWAY)
        return answer.result()

    def finish(self) -> bool:
        """Begin no call any more; return whether the one that runs has ended, at the latest at its deadline."""
        self._is_over = True
        if self._running is None or self._running.cancel():
            return True
        wait((self._running,), self._left_s())
        return self._running.done()

    def _left_s(self) -> float:
        """Return the time that the call that runs may still take."""
        return max(self._ends_s + CALL_MARGIN_S - time.monotonic(), 0.0)


class WatchedCamera:
    def __init__(self, camera: Camera, calls: DarkenedCalls) -> None:
        self._inner, self._calls = camera, calls

    def identity(self) -> DeviceIdentity:
        return self._calls.call(self._inner.identity)

    def expose(self, exposure_s: float, deadline_s: float) -> RawFrame:
        return self._calls.call(lambda: self._inner.expose(exposure_s, deadline_s), deadline_s)


class WatchedWheel:
    def __init__(self, wheel: FilterWheel, calls: DarkenedCalls) -> None:
        self._inner, self._calls = wheel, calls

    def identity(self) -> DeviceIdentity:
        return self._calls.call(self._inner.identity)

    @property
    def slots(self) -> tuple[int, ...]:
        return self._inner.slots

    def position(self) -> int | None:
        return self._calls.call(self._inner.position)

    def go_to(self, slot: int, deadline_s: float) -> None:
        self._calls.call(lambda: self._inner.go_to(slot, deadline_s), deadline_s)


class WatchedLight:
    def __init__(self, light: Light, role: LightRole, session: "WatchedSession") -> None:
        self._inner, self._role, self._session = light, role, session

    def identity(self) -> DeviceIdentity:
        return self._inner.identity()

    def state(self) -> bool:
        is_on = self._inner.state()
        self._session.reports(self._role, is_on)
        return is_on

    @contextmanager
    def lit(self) -> Iterator[None]:
        self._session.require_allowed(self._role)
        is_off = True
        try:
            with self._inner.lit(), self._session.shining(self._role):
                yield
        except UnsafeError:
            is_off = False
            raise
        finally:
            self._session.reports(self._role, not is_off)
