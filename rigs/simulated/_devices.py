"""Simulated camera, filter wheel, lights, operator and clock over one bench; nothing sleeps."""

import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from typing import Literal

import numpy as np

from data_schemas import CaptureError, DeviceIdentity, LightState, RefusedError, Target, TimedOutError
from rigs import RawFrame
from rigs.simulated._bench import Bench
from rigs.simulated.sensor import Sensor

LIGHT_REPEATABILITY_REL = 0.002
EXPOSURE_STEP_S = 1e-6
FRAME_OVERHEAD_S = 0.02
WHEEL_STEP_S = 0.4


@dataclass(slots=True)
class SimulatedClock:
    """Clock that advances only when a simulated device takes its time."""

    start: datetime = field(default_factory=lambda: datetime.now(UTC))
    elapsed_s: float = 0.0

    def utc(self) -> str:
        """Return the simulated time of day, ISO 8601, UTC."""
        return (self.start + timedelta(seconds=self.elapsed_s)).isoformat(timespec="milliseconds")

    def monotonic_s(self) -> float:
        """Return the simulated seconds since the start."""
        return self.elapsed_s


@dataclass(slots=True)
class BenchState:
    """What stands, shines and turns on the bench at this moment."""

    clock: SimulatedClock
    slot: int
    laser_power_mw: float = 0.0
    target: Target = "white"
    lamp: bool = False
    laser: bool = False
    wheel_swung_out: bool = False
    tilt_deg: float = 0.0
    sample_dose_j: float = 0.0

    def advance(self, duration_s: float) -> None:
        """Let time pass: the clock runs, and a shining laser doses the sample in view."""
        self.clock.elapsed_s += duration_s
        if self.laser and self.target == "sample":
            self.sample_dose_j += 1e-3 * self.laser_power_mw * duration_s

    def laser_incidence(self) -> float:
        """Return the laser's irradiance on the target relative to normal incidence: the cosine of the tilt."""
        return math.cos(math.radians(self.tilt_deg)) if self.target == "sample" else 1.0

    @property
    def wheel_in_beam(self) -> bool:
        """Whether the light passes the filter wheel (always swung out for the ColorChecker)."""
        return not (self.wheel_swung_out or self.box_is_open)

    @property
    def box_is_open(self) -> bool:
        """Whether room light falls on the target."""
        return self.target == "sample beside ColorChecker"

    def lights(self) -> tuple[LightState, ...]:
        """Return the lights that shine now; the open box lets room light in."""
        on: list[tuple[LightState, bool]] = [
            ("lamp", self.lamp),
            ("laser", self.laser),
            ("room", self.box_is_open),
        ]
        return tuple(name for name, shines in on if shines)


@dataclass(slots=True)
class SimulatedCamera:
    """Camera that sees the bench."""

    bench: Bench
    sensor: Sensor
    state: BenchState
    rng: np.random.Generator

    def identity(self) -> DeviceIdentity:
        """Return what the camera is."""
        return DeviceIdentity(role="camera", driver="simulated", model="simulated bench")

    def expose(self, exposure_s: float, deadline_s: float) -> RawFrame:
        """Take one frame; light levels repeat from frame to frame within 0.2 %."""
        if exposure_s + FRAME_OVERHEAD_S > deadline_s:
            raise TimedOutError(
                f"camera: an exposure of {exposure_s:g} s cannot be done within the deadline of {deadline_s:g} s; "
                "allow more time"
            )
        if exposure_s <= 0.0:
            raise RefusedError(f"camera: an exposure of {exposure_s:g} s cannot be; give more than 0 s")
        captured_utc = self.state.clock.utc()
        read_back_s = round(max(exposure_s, EXPOSURE_STEP_S), 6)
        slot = self.state.slot if self.state.wheel_in_beam else None
        electrons_per_s = self.bench.darkness()
        self.state.advance(0.5 * exposure_s)
        for light in self.state.lights():
            level = 1.0 + LIGHT_REPEATABILITY_REL * self.rng.standard_normal()
            if light == "laser":
                level *= self.state.laser_incidence()
            shining = self.bench.electrons_per_s(self.state.target, light, slot, self.state.sample_dose_j)
            electrons_per_s = electrons_per_s + level * shining
        counts = self.sensor.expose(electrons_per_s, read_back_s, self.rng)
        self.state.advance(0.5 * exposure_s + FRAME_OVERHEAD_S)
        return RawFrame(counts, exposure_s, read_back_s, captured_utc)


@dataclass(slots=True)
class SimulatedFilterWheel:
    """Wheel whose position is read from the bench."""

    slots: tuple[int, ...]
    state: BenchState

    def identity(self) -> DeviceIdentity:
        """Return what the wheel is."""
        return DeviceIdentity(role="filter wheel", driver="simulated", model="simulated bench")

    def position(self) -> int | None:
        """Return the slot in the beam; None while the wheel is swung out."""
        return self.state.slot if self.state.wheel_in_beam else None

    def go_to(self, slot: int, deadline_s: float) -> None:
        """Turn to `slot` by the shorter way, 0.4 s a step."""
        if slot not in self.slots:
            raise RefusedError(
                f"filter wheel: has no slot {slot}; its slots are {', '.join(map(str, self.slots))}: correct the "
                "slot numbers of the rig file"
            )
        if not self.state.wheel_in_beam:
            raise CaptureError(
                f"filter wheel: is swung out of the beam and cannot go to slot {slot}; place the white tile or the "
                "sample first"
            )
        steps = abs(self.slots.index(slot) - self.slots.index(self.state.slot))
        needed_s = WHEEL_STEP_S * min(steps, len(self.slots) - steps)
        if needed_s > deadline_s:
            raise TimedOutError(
                f"filter wheel: needs {needed_s:g} s to slot {slot}, the deadline is {deadline_s:g} s; allow more time"
            )
        self.state.advance(needed_s)
        self.state.slot = slot


@dataclass(slots=True)
class SimulatedLight:
    """Lamp or laser of the bench."""

    name: Literal["lamp", "laser"]
    bench_state: BenchState

    def identity(self) -> DeviceIdentity:
        """Return what the light is."""
        return DeviceIdentity(role=self.name, driver="simulated", model="simulated bench")

    def state(self) -> bool:
        """Return whether the light is on."""
        return self.bench_state.lamp if self.name == "lamp" else self.bench_state.laser

    @contextmanager
    def lit(self) -> Iterator[None]:
        """Switch the light on for a ``with`` block."""
        setattr(self.bench_state, self.name, True)
        try:
            yield
        finally:
            setattr(self.bench_state, self.name, False)


@dataclass(slots=True)
class SimulatedOperator:
    """Operator who places every target at once."""

    state: BenchState

    def place(self, target: Target) -> None:
        """Put `target` in view."""
        self.state.target, self.state.wheel_swung_out = target, False

    def swing_wheel_out(self) -> None:
        """Swing the wheel out of the beam."""
        self.state.wheel_swung_out = True

    def tilt(self, angle_deg: float) -> None:
        """Tilt the sample."""
        self.state.tilt_deg = angle_deg

    def do(self, instruction: str) -> None:
        """Nothing on the bench is done by hand."""

    def allows(self, question: str) -> bool:
        """Allow everything: a simulated light harms nobody."""
        return True
