"""What a calibration rig must be able to do: camera, filter wheel, lights, operator, clock.

Every exchange has a deadline in seconds on a monotonic clock; a device that misses it raises
:class:`~data_schemas.errors.CaptureError`. Drivers never guess: a position or state is what the device says.
"""

from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from data_schemas.capture import Target


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
        Start of the exposure, ISO 8601, UTC.
    """

    counts: NDArray[np.uint16]
    exposure_requested_s: float
    exposure_s: float
    captured_utc: str


class Clock(Protocol):
    """Source of time: one for labels, one for deadlines."""

    def utc(self) -> str:
        """Return the time of day, ISO 8601, UTC; it may step."""
        ...

    def monotonic_s(self) -> float:
        """Return seconds since an arbitrary start; it never goes back."""
        ...


class Camera(Protocol):
    """A camera with raw Bayer output and settable exposure."""

    def expose(self, exposure_s: float, deadline_s: float) -> RawFrame:
        """Take one frame with `exposure_s` seconds; it is there after at most `deadline_s` seconds."""
        ...


class FilterWheel(Protocol):
    """A wheel of filters in front of the camera."""

    @property
    def slots(self) -> tuple[int, ...]:
        """Numbers of the slots that can be reached."""
        ...

    def position(self) -> int | None:
        """Return the slot in the beam as the device reports it; None when no filter is (moving, swung out)."""
        ...

    def go_to(self, slot: int, deadline_s: float) -> None:
        """Move until the device reports `slot` and stands still; at most `deadline_s` seconds."""
        ...


class Light(Protocol):
    """A light that is off unless a ``with light.lit():`` block is running."""

    def state(self) -> bool:
        """Return whether the light is on, as the device reports it."""
        ...

    def lit(self) -> AbstractContextManager[None]:
        """Switch on for a ``with`` block; off at its end, also when an exception leaves it."""
        ...


class Operator(Protocol):
    """The hands at the rig: a person who is asked, or a stage."""

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
