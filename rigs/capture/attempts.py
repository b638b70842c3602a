"""Frames that are refused, and cameras that are lost or late: taken again, a bounded number of times."""

from collections.abc import Callable
from typing import Final, TypeVar

from data_schemas.errors import BadFrameError, FrameSizeError, LostError, TimedOutError
from rigs.protocols import Camera, RawFrame

T = TypeVar("T")
RETAKEN: Final = (BadFrameError, FrameSizeError, LostError)
"""What another attempt may mend."""
ATTEMPTS: Final = 4
"""Exposures before a frame that is refused every time ends the capture."""


def exposed(camera: Camera, exposure_s: float, deadline_s: float) -> RawFrame:
    """Take one frame; a camera that is late counts as lost, for its next exposure begins with a new connection.

    Raises
    ------
    LostError
        The camera is lost or late.
    """
    try:
        return camera.expose(exposure_s, deadline_s)
    except TimedOutError as error:
        raise LostError(str(error)) from error


def within_attempts(once: Callable[[int], T], on_refusal: Callable[[str], None], what: str) -> tuple[T, int]:
    """Return what `once` returns and how many attempts it took, four at most.

    Parameters
    ----------
    once
        Called with the number of the attempt, from 1.
    on_refusal
        Called with a text for every attempt that is repeated.
    what
        What is exposed, for the texts.

    Raises
    ------
    BadFrameError, FrameSizeError, LostError
        Every attempt failed.
    """
    for attempt in range(1, ATTEMPTS):
        try:
            return once(attempt), attempt
        except RETAKEN as error:
            on_refusal(f"{what}, attempt {attempt}: {error}")
    try:
        return once(ATTEMPTS), ATTEMPTS
    except RETAKEN as error:
        raise type(error)(f"{error} ({ATTEMPTS} attempts at {what})") from error
