"""Blocking calls of a camera library with a deadline: one thread makes them, in order; the caller waits no longer."""

import threading
from collections.abc import Callable
from concurrent.futures import Future
from queue import SimpleQueue
from typing import Any, TypeVar

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
