"""A compliant finger that a simulated stage presses, with the load cell that feels it and the camera that sees it.

One state on one clock that nothing waits for: time passes when a device takes its own. The force follows a curve with a
part that relaxes; the stage needs its way to stop; counts are as noisy as an HX711's. Sessions do not see its numbers.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray

from data_schemas import (
    CameraSettings,
    DeviceIdentity,
    LoadCellSettings,
    PracticeFault,
    PressDevice,
    RefusedError,
    StageSettings,
    TactileRig,
    Target,
    TimedOutError,
)
from rigs import CellReading, OverloadError, RawFrame
from rigs.simulated import SimulatedClock
from rigs.simulated.sensor import Sensor, mosaic

Floats = NDArray[np.float64]
RELAXES_WITHIN_S: Final = 0.5
FRAME_OVERHEAD_S: Final = 0.02
BRAKING_MM_PER_S2: Final = 50.0
DEAF_S: Final = 0.03
"""From the order to stop until the motors brake: a line of a serial port and the controller's own loop."""
BUFFERED_S: Final = 0.2
"""A real driver discards what has waited longer."""
OFFSET_COUNTS: Final = 84_000
END_OF_SCALE: Final = 0x7FFFFF
PAD_E_PER_S: Final = 3.0e5
IMAGE_OF_PAD_MM: Final = 20.0
STANDARD_GRAVITY_M_PER_S2: Final = 9.80665
_NOISES: Final = {"wandering cell": "wander_counts", "humming cell": "hum_counts", "lost bits": "lost_every"}


FORGETS_WITHIN_S: Final = (0.1, 1.0, 10.0, 100.0)
MAINS_HZ: Final = 50.0
CLOCK_FAST: Final = 1.013
"""The amplifier's own oscillator: its conversions are no whole fraction of the mains' period."""
REJECTS_HZ: Final = 10
BITS: Final = 22


@dataclass(slots=True)
class CellNoise:
    """Add to each reading what is not white.

    Attributes
    ----------
    wander_counts
        Standard deviation of the slow noise.
    hum_counts
        Amplitude of the pick-up.
    lost_every
        Mean number of readings from one lost bit to the next; 0: none is lost.
    """

    wander_counts: int = 0
    hum_counts: int = 0
    lost_every: int = 0
    _slow: list[float] = field(default_factory=lambda: [0.0] * len(FORGETS_WITHIN_S))
    _last_s: float | None = None

    def added(self, now_s: float, rate_hz: int, rng: np.random.Generator) -> float:
        """Return what is added to the reading of this moment (counts)."""
        hum = 0.0 if rate_hz <= REJECTS_HZ else math.sin(2.0 * math.pi * MAINS_HZ * CLOCK_FAST * now_s)
        if self.wander_counts <= 0.0:
            return self.hum_counts * hum
        since_s = math.inf if self._last_s is None else now_s - self._last_s
        self._last_s = now_s
        each = self.wander_counts / math.sqrt(len(FORGETS_WITHIN_S))
        for k, within_s in enumerate(FORGETS_WITHIN_S):
            kept = math.exp(-since_s / within_s)
            self._slow[k] = kept * self._slow[k] + math.sqrt(1.0 - kept**2) * each * rng.standard_normal()
        return sum(self._slow) + self.hum_counts * hum

    def damaged(self, counts: int, rng: np.random.Generator) -> int:
        """Return the count as it arrives: now and then with a bit too many, too few or wrong."""
        if self.lost_every <= 0.0 or rng.random() * self.lost_every >= 1.0:
            return counts
        kind = rng.integers(3)
        return counts * 2 if kind == 0 else counts // 2 if kind == 1 else counts ^ (1 << int(rng.integers(BITS)))


@dataclass(slots=True)
class FingerState:
    """Where the stage is, how hard it presses, what lies on the cell, and the fault to practise on.

    Attributes
    ----------
    rig
        The rig file, with the numbers of the finger.
    clock
        What time it is.
    counted_mm
        Where the controller counts the axes.
    load_kg
        Mass on the cell while it is calibrated.
    block_mm
        Thickness of what lies on the pad.
    moving
        Brings the stage to where it is now, while it moves.
    noise
        Of the cell, beside the white one.
    unread_s
        Time for which readings of the cell lie in the port's buffer: the stage was being stopped.
    """

    rig: TactileRig
    clock: SimulatedClock = field(default_factory=SimulatedClock)
    counted_mm: dict[str, float] = field(default_factory=dict)
    load_kg: float = 0.0
    block_mm: float = 0.0
    moving: Callable[[], None] | None = None
    noise: CellNoise = field(default_factory=CellNoise)
    unread_s: float = 0.0
    _lost_mm: float = 0.0
    _relaxing_n: float = 0.0
    _last: tuple[float, float] = (0.0, 0.0)

    def __post_init__(self) -> None:
        stage = self.stage
        self.counted_mm = {stage.press_axis: stage.clear_mm, stage.pad_axis: stage.base_mm}
        if (fault := self.fault) is not None and fault.name in _NOISES:
            setattr(self.noise, _NOISES[fault.name], round(fault.value))

    @property
    def stage(self) -> StageSettings:
        """The stage of the rig file."""
        if self.rig.stage is None:
            raise RefusedError(
                f"rig '{self.rig.name}': has no [stage] table; add it, as 'finray rig init --preset "
                "simulated-finger' writes it"
            )
        return self.rig.stage

    @property
    def fault(self) -> PracticeFault | None:
        """The fault to practise on."""
        return None if self.rig.simulated is None else self.rig.simulated.fault

    def has(self, name: str) -> bool:
        """Whether the rig has a fault now; those of the cell begin some time after the start."""
        fault = self.fault
        begins_s = fault.value if fault is not None and name in ("stuck cell", "silent cell") else 0.0
        return fault is not None and fault.name == name and self.clock.elapsed_s >= begins_s

    def advance(self, duration_s: float) -> None:
        """Let time pass, in which the stage moves if it does."""
        self.clock.elapsed_s += duration_s
        if self.moving is not None:
            self.moving()

    def drive(self, axis: str, to_mm: float) -> None:
        """Have an axis at a place by the controller's count; one that loses steps has gone less far into the pad."""
        way_mm = to_mm - self.counted_mm[axis]
        fault = self.fault
        if fault is not None and fault.name == "lost steps" and way_mm * self.stage.into_pad > 0.0:
            self._lost_mm += 1e-2 * fault.value * abs(way_mm) * (axis == self.stage.press_axis)
        self.counted_mm[axis] = to_mm

    def found_again(self) -> None:
        """Have the controller's count be where the stage stands."""
        self._lost_mm = 0.0

    @property
    def indentation_mm(self) -> float:
        """How deep the indenter is in the pad."""
        finger, stage = self.rig.simulated, self.stage
        if finger is None:
            return 0.0
        beyond_mm = stage.into_pad * (self.counted_mm[stage.press_axis] - finger.surface_mm)
        return max(beyond_mm + self.block_mm - self._lost_mm, 0.0)

    def force_n(self) -> float:
        """Return the force on the cell now."""
        finger = self.rig.simulated
        if finger is None:
            return 0.0
        depth_mm, now_s = self.indentation_mm, self.clock.elapsed_s
        elastic_n = finger.stiffness_n_per_mm * depth_mm + finger.stiffening_n_per_mm2 * depth_mm**2
        before_s, before_n = self._last
        fading = math.exp(-(now_s - before_s) / RELAXES_WITHIN_S)
        self._relaxing_n = fading * self._relaxing_n + finger.relaxing_share * (elastic_n - before_n)
        self._last = (now_s, elastic_n)
        pressing_n = max(elastic_n + self._relaxing_n, 0.0) if depth_mm > 0.0 else 0.0
        return pressing_n + STANDARD_GRAVITY_M_PER_S2 * self.load_kg


@dataclass(slots=True)
class SimulatedStage:
    """Stage whose moves take their time on the clock of the finger."""

    state: FingerState
    is_known: bool = False

    def identity(self) -> PressDevice:
        """Return what the stage is."""
        return PressDevice(role="stage", driver="simulated", model="simulated finger")

    def places_mm(self) -> dict[str, float] | None:
        """Return where the axes stand."""
        return dict(self.state.counted_mm) if self.is_known else None

    def home(self, deadline_s: float, watch: Callable[[], None]) -> None:
        """Find the zero of all axes by their switches, after which no steps are lost; end clear of the pad."""
        watch()
        self.state.advance(min(2.0, deadline_s))
        stage = self.state.stage
        self.state.counted_mm = {stage.press_axis: stage.clear_mm, stage.pad_axis: stage.base_mm}
        self.state.found_again()
        self.is_known = True

    def counted_mm(self) -> dict[str, float]:
        """Return the count."""
        return dict(self.state.counted_mm)

    def trust_places(self) -> dict[str, float]:
        """Take the count for true."""
        self.is_known = True
        return dict(self.state.counted_mm)

    def move(self, axis: str, to_mm: float, speed_mm_per_s: float, watch: Callable[[], None]) -> None:
        """Move one axis by small ways, with a look at `watch` after each."""
        stage = self.state.stage
        low_mm, high_mm = stage.press_travel_mm if axis == stage.press_axis else stage.pad_travel_mm
        if not low_mm <= to_mm <= high_mm:
            raise RefusedError(
                f"stage: {axis} = {to_mm:.3f} mm lies outside its travel of {low_mm:g} to {high_mm:g} mm in the rig "
                "file, so nothing moved; correct the plan, or the travel"
            )
        if not self.is_known:
            raise RefusedError("stage: its position is unknown; home it first")
        start_mm, began_s = self.state.counted_mm[axis], self.state.clock.elapsed_s
        way_mm = to_mm - start_mm
        takes_s = abs(way_mm) / speed_mm_per_s

        def share(later_s: float = 0.0) -> float:
            return min((self.state.clock.elapsed_s - began_s + later_s) / takes_s, 1.0) if takes_s else 1.0

        self.state.moving = lambda: self.state.drive(axis, start_mm + share() * way_mm)
        try:
            while share() < 1.0:
                before_s = self.state.clock.elapsed_s
                watch()
                if self.state.clock.elapsed_s == before_s:
                    self.state.advance(0.005)
        except BaseException:
            self.state.moving = None
            # deaf at full speed, then half as far as at full speed while it brakes
            braking_s = speed_mm_per_s / BRAKING_MM_PER_S2
            self.state.drive(axis, start_mm + share(DEAF_S + 0.5 * braking_s) * way_mm)
            self.state.advance(DEAF_S + braking_s)
            self.state.unread_s = DEAF_S + braking_s if DEAF_S + braking_s <= BUFFERED_S else 0.0
            raise
        self.state.moving = None
        self.state.drive(axis, to_mm)

    def stop(self) -> None:
        """Stand; between moves it does so anyway."""


@dataclass(slots=True)
class SimulatedLoadCell:
    """HX711 that feels the finger, 10 or 80 times a second."""

    state: FingerState
    settings: LoadCellSettings
    rng: np.random.Generator
    _last_counts: int = 0

    def identity(self) -> PressDevice:
        """Return what the cell is."""
        return PressDevice(role="load cell", driver="simulated", model="simulated finger")

    def read(self, deadline_s: float) -> CellReading:
        """Return the next reading."""
        state, finger = self.state, self.state.rig.simulated
        if finger is None or state.has("silent cell"):
            state.advance(deadline_s)
            raise TimedOutError(f"load cell: did not answer within {deadline_s:g} s; check its cable and supply")
        period_s = 1.0 / self.settings.rate_hz
        if state.unread_s < period_s:
            state.unread_s = 0.0
            state.advance(period_s)
        else:
            state.unread_s -= period_s  # one of those that have waited in the port's buffer
        force_n = state.force_n()
        fault = state.fault
        if fault is not None and fault.name == "drifting cell":
            force_n += 1e-3 * fault.value * state.clock.elapsed_s
        added = state.noise.added(state.clock.elapsed_s, self.settings.rate_hz, self.rng)
        added += finger.noise_counts * self.rng.standard_normal()
        counts = state.noise.damaged(round(OFFSET_COUNTS + force_n / finger.cell_n_per_count + added), self.rng)
        if abs(counts) >= END_OF_SCALE:
            raise OverloadError("load cell: reads the end of its scale; take the load away")
        if not state.has("stuck cell"):
            self._last_counts = counts
        return CellReading(self._last_counts, state.clock.monotonic_s() - state.unread_s)


@dataclass(slots=True)
class FingerCamera:
    """Camera under the pad: the contact of a ball darkens red and brightens blue, more so the deeper it is."""

    state: FingerState
    settings: CameraSettings
    rng: np.random.Generator

    def identity(self) -> DeviceIdentity:
        """Return what the camera is."""
        return DeviceIdentity(role="camera", driver="simulated", model="simulated finger")

    def expose(self, exposure_s: float, deadline_s: float) -> RawFrame:
        """Take one frame."""
        if exposure_s <= 0.0:
            raise RefusedError(f"camera: an exposure of {exposure_s:g} s is not possible; give more than 0 s")
        if exposure_s + FRAME_OVERHEAD_S > deadline_s:
            raise TimedOutError(
                f"camera: an exposure of {exposure_s:g} s cannot be done within {deadline_s:g} s; allow more time"
            )
        captured_utc = self.state.clock.utc()
        self.state.advance(exposure_s + FRAME_OVERHEAD_S)
        settings = self.settings
        sensor = Sensor(
            settings.bit_depth, settings.black_level_dn, settings.gain_e_per_dn, settings.read_noise_e, 2.0,
            1.05 * 2**settings.bit_depth * settings.gain_e_per_dn, 0.01, 2.0, 1,
        )  # fmt: skip
        counts = sensor.expose(mosaic(self._light_e_per_s()), exposure_s, self.rng)
        return RawFrame(counts, exposure_s, exposure_s, captured_utc)

    def _light_e_per_s(self) -> Floats:
        """Return red, green and blue of each cell of the mosaic, shape (h, w, 3)."""
        height, width = self.settings.height_px // 2, self.settings.width_px // 2
        stage = self.state.stage
        along_mm = stage.from_base * (self.state.counted_mm[stage.pad_axis] - stage.base_mm)
        rows, columns = np.mgrid[0:height, 0:width]
        mm_per_cell = IMAGE_OF_PAD_MM / width
        center = (along_mm % IMAGE_OF_PAD_MM) / mm_per_cell
        distance_mm = mm_per_cell * np.hypot(rows - height / 2, columns - center)
        depth_mm = self.state.indentation_mm
        radius_mm = max(math.sqrt(8.0 * depth_mm), 1e-3)  # of a ball of 4 mm
        dent = min(depth_mm, 1.0) * np.exp(-((distance_mm / radius_mm) ** 2))
        factors = np.stack([1.0 - 0.5 * dent, 1.0 + 0.1 * dent, 1.0 + 0.6 * dent], axis=-1)
        return np.asarray(PAD_E_PER_S * factors)


@dataclass(slots=True)
class FingerOperator:
    """Operator who does at once what is asked, and puts masses on the cell."""

    state: FingerState

    def place(self, target: Target) -> None:
        """Nothing is placed at a finger."""

    def swing_wheel_out(self) -> None:
        """There is no wheel."""

    def tilt(self, angle_deg: float) -> None:
        """Nothing is tilted."""

    def do(self, instruction: str) -> None:
        """Do nothing: the stage presses."""

    def allows(self, question: str) -> bool:
        """Allow everything: a simulated stage harms nobody."""
        return True
