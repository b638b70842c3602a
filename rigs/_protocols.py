"""What a calibration rig must be able to do: camera, filter wheel, lights, operator, clock.

Every exchange has a deadline in seconds on a monotonic clock; a device that misses it raises
:class:`~data_schemas.errors.TimedOutError`. Drivers never guess: a position or state is what the device says, asked
afresh. They raise the children of :class:`~data_schemas.errors.CaptureError` only; each message names the device.
"""

from collections.abc import Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from data_schemas import DeviceIdentity, Target


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


class OffWords(NamedTuple):
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

    def off_words(self) -> OffWords:
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


def missing_members(device: object, protocol: type) -> tuple[str, ...]:
    """Return the methods and properties of a protocol that a device lacks; no property of it is asked."""
    names = [
        name
        for above in reversed(protocol.__mro__)
        if getattr(above, "_is_protocol", False)
        for name in vars(above)
        if not name.startswith("_")
    ]
    return tuple(name for name in names if not (hasattr(type(device), name) or hasattr(device, name)))


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

    def do(self, instruction: str) -> None:
        """Have something done that no device can do, such as turning a filter wheel by hand (no deadline)."""
        ...

    def allows(self, question: str) -> bool:
        """Return whether a person who was asked says yes; False where nobody can be asked (no deadline)."""
        ...
