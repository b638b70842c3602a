"""Simulated camera, filter wheel, lights, operator and clock over one bench, and their faults; nothing sleeps.

By what a rig differs from its file is a :class:`RigCondition`: by chance from session to session, or by a fault to
practise on, which some light, some laser light or some time brings about.
"""

import math
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime, timedelta
from typing import Final, Literal, TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from data_schemas import (
    BandPassFilter,
    CaptureError,
    DeviceIdentity,
    LightState,
    LostError,
    PracticeFault,
    RefusedError,
    Target,
    TimedOutError,
)
from rigs import RawFrame
from rigs.light_guard import LightLevel
from rigs.simulated._bench import Bench
from rigs.simulated.sensor import Sensor
from rigs.transports import RECOVERS_WITHIN_S, repeated

Floats = NDArray[np.float64]
T = TypeVar("T")
LIGHT_REPEATABILITY_REL = 0.002
EXPOSURE_STEP_S = 1e-6
FRAME_OVERHEAD_S = 0.02
WHEEL_STEP_S = 0.4


@dataclass(frozen=True, slots=True)
class RigCondition:
    """The differences between a rig and its file; all zero means no difference.

    Attributes
    ----------
    lamp_rel, laser_rel
        Level of the lights, relative, less one.
    lamp_k
        The lamp's temperature apart from that of the file (K).
    emission_rel
        Emission of the sample, relative, less one.
    filters_rel
        Light through each filter, relative, less one, in the order of the rig file; empty counts as zeros.
    blur_px
        Standard deviation of the blur of each plane of the mosaic (pixels of the plane).
    black_dn
        Dark level apart from that of the file (DN).
    stray_dn_per_s
        Light that leaks into the box (DN/s).
    exchanged
        Names of two filters that are in each other's slots.
    """

    lamp_rel: float = 0.0
    lamp_k: float = 0.0
    laser_rel: float = 0.0
    emission_rel: float = 0.0
    filters_rel: tuple[float, ...] = ()
    blur_px: float = 0.0
    black_dn: float = 0.0
    stray_dn_per_s: float = 0.0
    exchanged: tuple[str, str] | None = None

    def truly_in_beam(self, name: str | None) -> str | None:
        """Return the filter that is in the beam where a filter of this name should be."""
        if self.exchanged is None or name not in self.exchanged:
            return name
        return self.exchanged[1 - self.exchanged.index(str(name))]

    def seen(
        self,
        fresh: Floats,
        emitted: Floats,
        light: LightState,
        band: tuple[int, float] | None,
        lamp_temperature_k: float,
        flicker_rel: float = 1.0,
    ) -> Floats:
        r"""Return what the camera sees of one light (e/s), shape (H, W).

        .. math:: l_{light} \, l_{filter} \, \frac{P(\lambda_f, T + \Delta T)}{P(\lambda_f, T)} \,
                  G_\sigma * (r + \epsilon e)

        with Planck's law P relative to 560 nm for the lamp only, the blur G and the emitted part e of r.

        Parameters
        ----------
        fresh, emitted
            Photo-electrons per second of the rig as its file says, and the part that the sample emits, (H, W).
        light
            The one light that shines.
        band
            Place in the rig file and centre (nm) of the filter that is truly in the beam; None without one.
        lamp_temperature_k
            The lamp's temperature of the rig file (K).
        flicker_rel
            Level of this frame, relative.
        """
        level = 1.0 + {"lamp": self.lamp_rel, "laser": self.laser_rel}.get(light, 0.0)
        if band is not None:
            place, centre_nm = band
            if light == "lamp":
                level *= _planck_ratio(centre_nm, lamp_temperature_k, self.lamp_k)
            level *= 1.0 + (self.filters_rel[place] if self.filters_rel else 0.0)
        return level * flicker_rel * _blurred(fresh + self.emission_rel * emitted, self.blur_px)


def with_fault(
    condition: RigCondition, fault: PracticeFault, filters: int, place: int = 0, share: float = 1.0
) -> RigCondition:
    """Return the condition of a rig with a fault that shows in its light.

    Parameters
    ----------
    condition
        Without the fault.
    fault
        Its name and size, such as 30 (%) of the light of a filter, or 200 (K).
    filters, place
        Number of filters of the rig, and place of the one that slips or is dirty.
    share
        How far it has developed, 0 to 1.
    """
    size = share * fault.value
    match fault.name:
        case "slipping wheel" | "dirty filter":
            changed = list(condition.filters_rel or (0.0,) * filters)
            changed[place] -= size / 100
            return replace(condition, filters_rel=tuple(changed))
        case "drifting laser":
            return replace(condition, laser_rel=condition.laser_rel - size / 100)
        case "bleaching paint":
            return replace(condition, emission_rel=condition.emission_rel - size / 100)
        case "lamp ageing":
            return replace(condition, lamp_k=condition.lamp_k - size)
        case "focus shift":
            return replace(condition, blur_px=float(np.hypot(condition.blur_px, size)))
        case "stray light":
            return replace(condition, stray_dn_per_s=condition.stray_dn_per_s + size)
        case "exchanged filters":
            return replace(condition, exchanged=fault.pair)
    return condition


def _planck_ratio(centre_nm: float, kelvin: float, change_k: float) -> float:
    """Return the lamp's light at a wavelength over that of the usual temperature, both 1 at 560 nm."""

    def light(temperature_k: float, wavelength_nm: float) -> float:
        return 1.0 / float(np.expm1(1.438776877e7 / (wavelength_nm * temperature_k)))

    warm = kelvin + change_k
    return light(warm, centre_nm) / light(warm, 560.0) * light(kelvin, 560.0) / light(kelvin, centre_nm)


def _blurred(rate: Floats, sigma_px: float) -> Floats:
    """Blur each plane of an RGGB mosaic by a Gaussian of this many pixels of the plane."""
    out = np.empty_like(rate)
    for row, column in np.ndindex(2, 2):
        out[row::2, column::2] = gaussian_filter(rate[row::2, column::2], max(sigma_px, 0.0), mode="nearest")
    return out


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

    def sleep(self, duration_s: float) -> None:
        """Let simulated time pass, at once."""
        self.elapsed_s += duration_s


DRIFTS_WITHIN_S: Final = 60.0
"""Of laser light, until the laser has drifted by all of the size of the fault."""
BLEACHES_WITHIN_J: Final = 0.5
"""Dose on the sample after which 63 % of the size of the fault is reached."""
FOCUS_PERIOD_S: Final = 10.0
"""In which the focus wanders away by the size of the fault, and back."""
DIRTY_NM: Final = 600.0
"""The filter nearest to it is the dirty one."""


@dataclass(slots=True)
class BenchFault:
    """A fault to practise on, and what it depends on: exposures, messages and laser time so far.

    Attributes
    ----------
    fault
        Its name and size.
    filters
        Of the rig file, in its order.
    lamp_temperature_k, gain_e_per_dn
        Of the rig file.
    laser_lit_s, exposures, messages
        Time with the laser on, frames and messages to the wheel since the rig was opened.
    arrivals
        Slot -> how often the wheel arrived there.
    """

    fault: PracticeFault
    filters: tuple[BandPassFilter, ...]
    lamp_temperature_k: float
    gain_e_per_dn: float
    laser_lit_s: float = 0.0
    exposures: int = 0
    messages: int = 0
    arrivals: Counter[int] = field(default_factory=Counter)

    def condition(self, elapsed_s: float, slot: int | None, sample_dose_j: float) -> RigCondition:
        """Return the condition of the rig now."""
        places = {band.slot: place for place, band in enumerate(self.filters)}
        place, share = 0, 1.0
        match self.fault.name:
            case "slipping wheel":  # every second time that it arrives at a slot
                place = places.get(slot or 0, 0)
                share = 0.0 if slot is None else float(self.arrivals[slot] % 2 == 0 and self.arrivals[slot] > 0)
            case "dirty filter":
                place = min(range(len(self.filters)), key=lambda i: abs(self.filters[i].center_nm - DIRTY_NM))
            case "drifting laser":
                share = min(self.laser_lit_s / DRIFTS_WITHIN_S, 1.0)
            case "bleaching paint":
                share = -math.expm1(-sample_dose_j / BLEACHES_WITHIN_J)
            case "focus shift":
                share = math.sin(math.pi * elapsed_s / FOCUS_PERIOD_S) ** 2
        return with_fault(RigCondition(), self.fault, len(self.filters), place, share)

    def band_of(self, slot: int | None, condition: RigCondition) -> BandPassFilter | None:
        """Return the filter that is truly in the beam at a slot."""
        names = {band.name: band for band in self.filters}
        said = next((band.name for band in self.filters if band.slot == slot), None)
        return names.get(str(condition.truly_in_beam(said)))

    def require_plugged(self) -> None:
        """Count an exposure, and refuse it where the camera is unplugged by now."""
        self.exposures += 1
        if self.fault.name == "unplugged camera" and self.exposures > self.fault.value:
            raise LostError("camera: does not answer and cannot be found; check its cable and power")

    def require_heard(self) -> None:
        """Count a message to the wheel, and lose it where its turn has come: one of 20 for 5 %."""
        self.messages += 1
        if self.fault.name == "lost message" and self.messages % max(round(100.0 / self.fault.value), 2) == 0:
            raise TimedOutError("filter wheel: has not answered; the message was lost on its way")


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
    fault: BenchFault | None = None
    beam_is_closed: bool = False

    def close_beam(self, closed: bool) -> bool:
        """Close the laser's beam before the photodiode, or open it, by hand."""
        self.beam_is_closed = closed
        return True

    def advance(self, duration_s: float) -> None:
        """Let time pass: the clock runs, and a shining laser doses the sample in view."""
        self.clock.elapsed_s += duration_s
        if self.laser and self.fault is not None:
            self.fault.laser_lit_s += duration_s
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
            raise RefusedError(f"camera: an exposure of {exposure_s:g} s is not possible; give more than 0 s")
        if self.state.fault is not None:
            self.state.fault.require_plugged()
        captured_utc = self.state.clock.utc()
        read_back_s = round(max(exposure_s, EXPOSURE_STEP_S), 6)
        slot = self.state.slot if self.state.wheel_in_beam else None
        electrons_per_s = self.bench.darkness()
        self.state.advance(0.5 * exposure_s)
        for light in self.state.lights():
            level = 1.0 + LIGHT_REPEATABILITY_REL * self.rng.standard_normal()
            if light == "laser":
                level *= self.state.laser_incidence()
            electrons_per_s = electrons_per_s + self._seen(light, slot, level)
        if self.state.fault is not None:
            leak_dn_per_s = self._condition(self.state.fault, slot).stray_dn_per_s
            electrons_per_s = electrons_per_s + leak_dn_per_s * self.state.fault.gain_e_per_dn
        counts = self.sensor.expose(electrons_per_s, read_back_s, self.rng)
        self.state.advance(0.5 * exposure_s + FRAME_OVERHEAD_S)
        return RawFrame(counts, exposure_s, read_back_s, captured_utc)

    def _condition(self, fault: BenchFault, slot: int | None) -> RigCondition:
        return fault.condition(self.state.clock.elapsed_s, slot, self.state.sample_dose_j)

    def _seen(self, light: LightState, slot: int | None, level: float) -> Floats:
        """Return what one light gives (e/s), with the fault of the bench if it has one."""
        state, fault = self.state, self.state.fault
        if fault is None:
            return level * self.bench.electrons_per_s(state.target, light, slot, state.sample_dose_j)
        condition = self._condition(fault, slot)
        band = fault.band_of(slot, condition)
        true_slot = slot if band is None else band.slot
        fresh, emitted = (
            part(state.target, light, true_slot, state.sample_dose_j)
            for part in (self.bench.electrons_per_s, self.bench.emitted_electrons_per_s)
        )
        place = None if band is None else (fault.filters.index(band), band.center_nm)
        return condition.seen(fresh, emitted, light, place, fault.lamp_temperature_k, level)


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
        return self._asked(lambda: self.state.slot if self.state.wheel_in_beam else None)

    def go_to(self, slot: int, deadline_s: float) -> None:
        """Turn to `slot` by the shorter way, 0.4 s a step."""
        if slot not in self.slots:
            raise RefusedError(
                f"filter wheel: has no slot {slot}, only {', '.join(map(str, self.slots))}; correct the slot numbers "
                "in the rig file"
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
                f"filter wheel: needs {needed_s:g} s to reach slot {slot}, but the deadline is {deadline_s:g} s; "
                "allow more time"
            )
        self._asked(lambda: self.state.advance(needed_s))
        self.state.slot = slot
        if self.state.fault is not None:
            self.state.fault.arrivals[slot] += 1

    def _asked(self, answer: Callable[[], T]) -> T:
        """Return the wheel's answer; a message that is lost is sent again, as over a line."""
        fault = self.state.fault
        if fault is None:
            return answer()

        def attempt(end_s: float) -> T:
            fault.require_heard()
            return answer()

        return repeated(attempt, time.monotonic() + RECOVERS_WITHIN_S, "filter wheel simulated")


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


LIT_LEVEL, DARK_LEVEL = 800, 12
LEVEL_EVERY_S: Final = 0.01


@dataclass(slots=True)
class SimulatedPhotodiode:
    """Photodiode that sees the laser of the bench."""

    state: BenchState
    sees_pulses: bool = True

    def read(self, deadline_s: float) -> LightLevel:
        """Return the next reading."""
        self.state.clock.sleep(min(LEVEL_EVERY_S, deadline_s))
        is_lit = self.state.laser and not self.state.beam_is_closed
        return LightLevel(LIT_LEVEL if is_lit else DARK_LEVEL, self.state.clock.monotonic_s())


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
