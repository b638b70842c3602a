"""Waiting for a device that is given up as soon as something matters more, whatever library waits."""

import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Final

LOOK_S: Final = 0.02
"""How often the guard looks for its owner while it waits for the light; of the 50 ms in which it sends "off"."""


class GivenUp(BaseException):
    """Nobody waits for the device's answer any more; no driver may take it for an error of its own."""


class Wait:
    """A wait of the main thread; one at a time in a process.

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
