"""What every acceptance check records alike: its parts one after the other, who answers, and who comes back."""

import time
from collections.abc import Callable
from contextlib import AbstractContextManager
from typing import Final, Generic, Protocol, TypeVar

from pydantic import BaseModel

from data_schemas import CaptureError, DeviceIdentity, Handshake, PressDevice, Section
from rigs import Clock

Progress = Callable[[int, int, str], None]
T = TypeVar("T")
Opened = TypeVar("Opened")
Facts = TypeVar("Facts", bound=BaseModel)
HANDSHAKES: Final = 3


class _Named(Protocol):
    """What every device of a rig is."""

    def identity(self) -> DeviceIdentity | PressDevice:
        """Return what it says it is."""
        ...


def ask(
    clock: Clock, role_and_driver: tuple[str, str], device: _Named, state: Callable[[], object], asked: int
) -> Handshake:
    """Ask one device so many times who it is and how it stands."""
    role, driver = role_and_driver
    durations_s: list[float] = []
    identity, error = None, None
    try:
        for _ in range(asked):
            start_s = clock.monotonic_s()
            identity = device.identity()
            state()
            durations_s.append(clock.monotonic_s() - start_s)
    except CaptureError as raised:
        error = str(raised)
    return Handshake.model_validate(
        {"role": role, "driver": driver, "identity": identity, "durations_s": durations_s, "error": error}
    )


def come_back(
    opening: AbstractContextManager[Opened], asked: Callable[[Opened], tuple[Handshake, ...]]
) -> dict[str, object]:
    """Open a closed rig once more, and return the facts: how long until all devices answered, and what they said.

    Raises
    ------
    CaptureError
        A device does not answer.
    """
    start_s = time.monotonic()
    with opening as opened:
        again = asked(opened)
        took_s = time.monotonic() - start_s
    for hand in again:
        if hand.error is not None:
            raise CaptureError(hand.error)
    return {
        "reconnect_s": took_s,
        "reconnected": tuple(hand.identity for hand in again if hand.identity is not None),
    }


class CheckRecorder(Generic[Facts]):
    """Tries the parts of a check one after the other: an error ends its own part, and some end all that follow.

    Parameters
    ----------
    facts
        What is known before anything is tried.
    steps
        Number of parts, for `progress`.
    progress
        Called with (done, total, text) at the start of every part.
    """

    def __init__(self, facts: Facts, steps: int, progress: Progress) -> None:
        self._facts, self._steps, self._progress = facts, steps, progress
        self._errors: dict[Section, str] = {}
        self._ended: str | None = None
        self._begun: list[Section] = []

    def _attempt(self, section: Section, act: Callable[[], T], *, also_when_ended: bool = False) -> T | None:
        """Return what `act` returns; note its error and return None."""
        if self._ended is not None and not also_when_ended:
            self._errors.setdefault(section, f"not tried: {self._ended}")
            return None
        if not self._begun or self._begun[-1] != section:
            self._progress(len(self._begun), self._steps, section)
            self._begun.append(section)
        try:
            return self._tried(act)
        except CaptureError as error:
            self._errors.setdefault(section, self._words(error))
            self._ended = self._why_it_ends(error, section) or self._ended
            return None

    def _tried(self, act: Callable[[], T]) -> T:
        """Return what `act` returns."""
        return act()

    def _words(self, error: CaptureError) -> str:
        """Return what is noted of an error."""
        return str(error)

    def _why_it_ends(self, error: CaptureError, section: Section) -> str | None:
        """Return why an error ends all that follows; None: it ends its own part only."""
        return None

    def _keep(self, **what: object) -> None:
        """Add facts."""
        self._facts = self._facts.model_copy(update=what)
