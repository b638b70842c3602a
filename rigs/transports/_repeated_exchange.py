"""Exchanges that are repeated after a fault, within their one deadline; every repeat is told to who listens.

Only what may be done twice goes through here: questions, positions and settings that are absolute, "off". Never "on", a
relative move, a tare or the start of an exposure: whoever asked for those decides anew.
"""

import math
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Final, NamedTuple, TypeVar

from data_schemas import LostError, RefusedError, TimedOutError

T = TypeVar("T")
PAUSE_S: Final = 0.02
LONGEST_PAUSE_S: Final = 0.2
"""A cable that is plugged in again is found this late."""
LEAST_S: Final = 0.1
"""Less time than this is not enough for another attempt."""
RECOVERS_WITHIN_S: Final = 12.0
"""Longest wait for the answer to a question that has no deadline of its own: pulling a plug and putting it back."""


class Fault(NamedTuple):
    """A fault after which an exchange was repeated.

    Attributes
    ----------
    device
        Role and address.
    what
        The error in words.
    attempt
        Number of the attempt that failed, from 1.
    spent_s
        How long it took.
    """

    device: str
    what: str
    attempt: int
    spent_s: float


_LISTENER: ContextVar[Callable[[Fault], None] | None] = ContextVar("listener to faults", default=None)


@contextmanager
def fault_listener(listener: Callable[[Fault], None]) -> Iterator[None]:
    """Call `listener` with every fault after which an exchange is repeated, for a ``with`` block."""
    token = _LISTENER.set(listener)
    try:
        yield
    finally:
        _LISTENER.reset(token)


def report_fault(fault: Fault) -> None:
    """Report a fault to the listener, if there is one."""
    if (listener := _LISTENER.get()) is not None:
        listener(fault)


def repeated(
    attempt: Callable[[float], T],
    end_s: float,
    device: str,
    *,
    attempt_s: float = math.inf,
    after_fault: Callable[[], object] = lambda: None,
    final: tuple[type[LostError], ...] = (),
) -> T:
    """Return what `attempt` returns; do it again after a connection that broke or an answer that is late or wrong.

    Parameters
    ----------
    attempt
        Called with the instant (:func:`time.monotonic`) at which this attempt must be over; may be done twice.
    end_s
        When all attempts must be over.
    device
        Role and address, for who is told of faults.
    attempt_s
        Longest duration of one attempt.
    after_fault
        Called after each attempt that failed.
    final
        Kinds of errors after which nothing is repeated.

    Raises
    ------
    LostError, TimedOutError
        No attempt succeeded before the time was over; the error of the first, which says what happened.
    """
    number, pause_s = 0, PAUSE_S
    first: LostError | TimedOutError | None = None
    while True:
        number, began_s = number + 1, time.monotonic()
        try:
            return attempt(min(end_s, began_s + attempt_s))
        except (LostError, TimedOutError) as error:
            if isinstance(error, final):
                raise
            first = first or error
            after_fault()
            spent_s = time.monotonic() - began_s
            if time.monotonic() + pause_s + LEAST_S > end_s:
                if number == 1:
                    raise
                raise type(first)(f"{first} (tried {number} times)") from error
            report_fault(Fault(device, str(error), number, round(spent_s, 3)))
        time.sleep(pause_s)
        pause_s = min(2.0 * pause_s, LONGEST_PAUSE_S)


def require_same_board(name: str, before: str, now: str) -> None:
    """Refuse a board that has taken the name of another.

    Parameters
    ----------
    name
        What the device is and where, for the message.
    before, now
        Serial numbers; where the one before is empty, nothing is known and nothing is refused.

    Raises
    ------
    LostError
        The one now is empty: it cannot be read at this moment, as in the first moments after a replug.
    RefusedError
        They differ.
    """
    if before and not now:
        raise LostError(
            f"{name}: the serial number of its board cannot be read now (it was '{before}' before); check its cable, "
            "and that the address leads to the same board"
        )
    if before and now != before:
        raise RefusedError(
            f"{name}: another board answers now (serial number '{now}', but '{before}' before), because the names of "
            "ports change with a replug. Write the board's link under /dev/serial/by-id/ into the rig file, or plug "
            "the boards in again in the order that restores their names"
        )
