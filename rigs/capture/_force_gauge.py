"""The devices of a tactile rig, opened and locked, and the force of its load cell.

The force is counts above a tare by the slope of the calibration, and what makes it doubtful. The first tare of a
session must agree with the empty cell of the calibration, and every later one with the first, so that no drift, and no
pad that is taken for one, can lift the force limit unseen.
"""

import math
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Final, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from data_schemas import (
    CaptureError,
    CellAtRest,
    LaidMass,
    LoadCellCalibration,
    LoadCellSettings,
    LostError,
    PressDevice,
    RecordError,
    RefusedError,
    TactileRig,
)
from data_schemas.storage import read_record
from rigs import (
    Camera,
    Clock,
    ForceLimitError,
    LoadCell,
    Operator,
    Stage,
    SystemClock,
    TerminalOperator,
    device_locked,
    open_camera,
    open_load_cell,
    open_stage,
)

Floats = NDArray[np.float64]
TARE_READINGS: Final = 32
STEP_READINGS: Final = 8
SETTLING_READINGS: Final = 4
"""The HX711's filter has taken in a change after four readings (its data sheet: 50 ms at 80 Hz, 400 ms at 10 Hz)."""
COARSE_SD: Final = 8.0


def mean_noise_n(noise_n: float, readings: int) -> float:
    r"""Return the standard uncertainty of a mean (N) by the noise of one reading: the filter has neighbours share it.

    An amplifier that gives the running mean of four conversions needs four readings for one that is new:

    .. math:: u = s \sqrt{4 / n}

    is a little more than it is for such a filter, and twice that of readings which share nothing.
    """
    return noise_n * math.sqrt(SETTLING_READINGS / max(readings, SETTLING_READINGS))


JUMP_SD: Final = 10.0
"""Of one reading: a reading farther away is no noise."""
BACK_SHARE: Final = 0.8
"""Of a jump, within the next reading: a force leaves the amplifier's filter within four, a lost bit at once."""
MOST_BETWEEN: Final = 2.0
"""Times that readings come: two that were made farther apart do not follow each other."""
MOST_JUMPS: Final = 0.25
"""Of the readings of a mean: more of them are no lost bits."""


def without_jumps(readings: Sequence[float] | Floats, sd: float = 1.0) -> Floats:
    """Return readings of a cell at rest without those that lost a bit on their way.

    A jump is farther from the median than ten standard deviations, by the median distance from it, and so far from both
    of its neighbours too: the amplifier's filter shows a force in several. The first and the last reading are always
    kept, and where more than a quarter seem to be jumps, all are.

    Parameters
    ----------
    readings
        Counts, or forces (N).
    sd
        Least standard deviation of one, in their unit: equal readings have none.
    """
    values = np.asarray(readings, dtype=np.float64)
    away = np.abs(values - np.median(values))
    far = JUMP_SD * max(1.4826 * float(np.median(away)), sd)
    steps = np.abs(np.diff(values))
    jumps = np.zeros(values.size, dtype=bool)
    jumps[1:-1] = (away[1:-1] > far) & (np.minimum(steps[:-1], steps[1:]) > far)
    return values if jumps.sum() > MOST_JUMPS * values.size else values[~jumps]


def without_spikes(values: Floats, sd: float) -> Floats:
    """Return readings of a force that changes, each lone one beyond both of its neighbours replaced by the nearer one.

    The amplifier's filter lets no force come and go within one reading; a lost bit does.

    Parameters
    ----------
    values
        Readings, shape (n,).
    sd
        Standard deviation of one by noise, in their unit.
    """
    if values.size < 3:
        return values
    before, middle, after = values[:-2], values[1:-1], values[2:]
    low, high = np.minimum(before, after), np.maximum(before, after)
    beyond = np.maximum(middle - high, low - middle)
    lone = beyond > np.maximum(JUMP_SD * sd, BACK_SHARE / (1.0 - BACK_SHARE) * (high - low))
    found = values.copy()
    found[1:-1] = np.where(lone, np.clip(middle, low, high), middle)
    return found


LEAST_EQUAL: Final = 4
ZERO_MOVED_SHARE: Final = 0.1
"""Of the force limit: a zero that moved by more tells of a loose cell or a warm amplifier; noise must stay below."""
UNLOADED_SHARE: Final = 0.25
"""Of the force limit: so far from the empty cell of its calibration may a session begin."""
FOLLOWED_SD: Final = 1.0
"""A drift moves a mean by less from step to step; a pad soon moves it by more, and is not taken for a drift."""
BUFFERED_S: Final = 0.2


def read_cell_calibration(settings: LoadCellSettings, folder: Path) -> LoadCellCalibration:
    """Read the calibration that a rig file names.

    Raises
    ------
    RecordError
        It is missing, no such record, or that of a cell with another driver.
    """
    path = folder / settings.calibration
    if not path.is_file():
        raise RecordError(
            f"{path}: the calibration of the load cell is missing, so counts cannot be converted to newtons; write it "
            f"with 'finray rig calibrate-cell RIG --out {path}'"
        )
    calibration = read_record(path, LoadCellCalibration)
    driver, _, _ = calibration.cell.rpartition(", ")[2].partition(" ")
    if driver != settings.driver:
        raise RecordError(
            f"{path}: is the calibration of '{calibration.cell}', but load_cell.driver in the rig file is "
            f"{settings.driver}; calibrate this cell with 'finray rig calibrate-cell RIG --out {path}'"
        )
    return calibration


def calibration_notes(rig: TactileRig, calibration: LoadCellCalibration) -> tuple[str, ...]:
    """Say what makes the calibration of a load cell doubtful: another address, and forces beyond its masses."""
    if (settings := rig.load_cell) is None:
        return ()
    heaviest_n, notes = max(calibration.masses_kg) * calibration.gravity_m_per_s2, []
    _, _, address = calibration.cell.rpartition(", ")[2].partition(" ")
    if address != settings.address:
        notes.append(
            f"load cell: was calibrated at '{address}', but is at '{settings.address}' now; if a different cell is "
            "connected, calibrate that cell"
        )
    if settings.force_limit_n > heaviest_n:
        notes.append(
            f"load cell: forces above {heaviest_n:.3g} N, the heaviest mass of its calibration, are extrapolated "
            f"(force_limit_n is {settings.force_limit_n:g} N); the uncertainty of these forces is valid only if the "
            "cell is linear beyond this mass"
        )
    return tuple(notes)


class Force(NamedTuple):
    """A mean force above the tare, and its standard uncertainty by noise alone (N)."""

    mean_n: float
    noise_n: float


class ForceGauge:
    """A load cell with its calibration and a tare.

    Parameters
    ----------
    cell, settings
        The open cell and what the rig file says of it.
    calibration
        How its counts become newtons.
    """

    def __init__(self, cell: LoadCell, settings: LoadCellSettings, calibration: LoadCellCalibration) -> None:
        self._cell, self._settings, self._slope = cell, settings, calibration.slope_n_per_count
        equal = max(LEAST_EQUAL, math.ceil(settings.silent_s * settings.rate_hz))
        self._newest: deque[int] = deque(maxlen=equal)
        self._zero, self._zero_readings, self.noise_n = math.nan, TARE_READINGS, math.nan
        self._moved_s = self._made_s = self._made_before_s = -math.inf
        self._tared = self._first_zero = math.nan
        self.lost_bits = 0
        slope, masses = calibration.slope_n_per_count, np.array(calibration.masses_kg)
        unloaded = np.array(calibration.counts) - masses * calibration.gravity_m_per_s2 / slope
        self._unloaded = float(unloaded.mean())

    def reading_n(self) -> float:
        """Return the next reading above the tare (N); nan before there is one. Raises what :meth:`strongest_n` does."""
        return self.force_n(self._counts())

    def force_n(self, counts: int) -> float:
        """Return the force of a count above the tare (N)."""
        return (counts - self._zero) * self._slope

    def reading_above_empty_n(self) -> float:
        """Return the next reading above the empty cell of the calibration (N); raises what :meth:`strongest_n` does."""
        return (self._counts() - self._unloaded) * self._slope

    def strongest_n(self) -> float:
        """Return the next reading above the tare or above the first one of the session (N), whichever is larger.

        Raises
        ------
        LostError
            The same count came for as long as the cell may be silent: an amplifier's noise never does that.
        TimedOutError
            No reading came for so long.
        """
        counts = self._counts()
        return max(((counts - zero) * self._slope for zero in (self._zero, self._first_zero)), key=abs)

    def has_jumped(self, limit_n: float) -> bool:
        """Whether the last reading had lost a bit, by the one before and those that come next.

        It is far from the one before and from the next, which were made one after the other, and none of the next is
        beyond the limit. Where a reading is missing between them, a force may have come and gone: it has not.
        """
        if len(self._newest) < 2 or math.isnan(self.noise_n):
            return False
        before, jumped = self._newest[-2], self._newest[-1]
        sd, most_s = self.noise_n / abs(self._slope), MOST_BETWEEN / self._settings.rate_hz
        since_before_s, jumped_s = self._made_s - self._made_before_s, self._made_s
        next_ones = [self._counts()]
        is_gapless = max(since_before_s, self._made_s - jumped_s) <= most_s
        next_ones += [self._counts() for _ in range(SETTLING_READINGS - 1)]
        far = max(JUMP_SD * sd, BACK_SHARE * abs(jumped - float(np.median(next_ones))))
        is_back = is_gapless and min(abs(jumped - before), abs(jumped - next_ones[0])) > far
        strongest_n = max(abs(count - zero) for count in next_ones for zero in (self._zero, self._first_zero))
        if not is_back or strongest_n * abs(self._slope) > limit_n:
            return False
        self.lost_bits += 1
        return True

    def _counts(self) -> int:
        """Return the next count, unless the cell is stuck."""
        self._made_before_s = self._made_s
        counts, self._made_s = self._cell.read(self._settings.silent_s)
        self._newest.append(counts)
        if len(self._newest) == self._newest.maxlen and len(set(self._newest)) == 1:
            raise LostError(
                f"load cell: has reported {counts} for {self._newest.maxlen} readings, so it is stuck; check "
                "amplifier and wiring"
            )
        return counts

    def moved(self, now_s: float) -> None:
        """Remember when a move ended: what was made before, however late it comes, says nothing of the force since."""
        self._moved_s = now_s

    def settle(self, take: Callable[[], object]) -> None:
        """Have readings taken until so many were made after the last move that the amplifier's filter shows all of it.

        A reading beyond a limit that `take` keeps is looked at again: it may have lost a bit.

        Raises
        ------
        LostError
            All came too late, for as long as the cell may be silent.
        ForceLimitError
            `take` raised it, and the next readings agree.
        """
        made, late, most_late = 0, 0, math.ceil(self._settings.silent_s * self._settings.rate_hz)
        while made < SETTLING_READINGS:
            try:
                take()
            except ForceLimitError as error:
                if error.limit_n is None or late > most_late or not self.has_jumped(error.limit_n):
                    raise
            made, late = (made + 1, late) if self._made_s > self._moved_s else (made, late + 1)
            if late > most_late:
                raise LostError(
                    f"load cell: {late} readings in a row were made before the stage was at rest, so they come too "
                    "late to stop it; close other programs, and check the board's cable"
                )

    def begin(self, now_s: Callable[[], float]) -> None:
        """Tare for the first time in a session, with nothing on the cell; `now_s` tells the time.

        Raises
        ------
        CaptureError
            The cell reads far from the empty one of its calibration, at another rate than the rig file says, or as
            :meth:`tare` raises.
        """
        settings = self._settings
        for _ in range(math.ceil(BUFFERED_S * settings.rate_hz)):
            self._counts()
        began_s = now_s()
        self.tare()
        rate_hz = (SETTLING_READINGS + TARE_READINGS + 2) / max(now_s() - began_s, 1e-9)
        if not 0.5 < rate_hz / settings.rate_hz < 2.0:
            raise CaptureError(
                f"load cell: sends {rate_hz:.3g} readings a second, but rate_hz in the rig file is {settings.rate_hz}; "
                "correct rate_hz, or set the RATE pin of the HX711 (low: 10, high: 80)"
            )
        allowed_n, off_n = UNLOADED_SHARE * settings.force_limit_n, (self._zero - self._unloaded) * self._slope
        if abs(off_n) > allowed_n:
            raise CaptureError(
                f"load cell: reads {off_n:.3g} N by its calibration where nothing should touch it (at most "
                f"{allowed_n:.3g} N is allowed). Something lies or presses on the cell, a wire of its bridge is "
                "broken, or this is another cell; free the cell, check its wires, or calibrate it as mounted"
            )
        self._first_zero = self._zero

    def tare(self) -> None:
        """Take the mean of some readings for no force, and their scatter for the noise of one.

        Raises
        ------
        CaptureError
            It is far from the first one, or noise could hide a tenth of the force limit.
        """
        self.settle(self._counts)
        counts = self._at_rest(TARE_READINGS, 1.0)
        self._zero = self._tared = float(counts.mean())
        self._zero_readings, self.noise_n = TARE_READINGS, float(counts.std(ddof=1)) * abs(self._slope)
        allowed_n = ZERO_MOVED_SHARE * self._settings.force_limit_n
        if COARSE_SD * self.noise_n > allowed_n:
            raise CaptureError(
                f"load cell: noise of {self.noise_n:.2g} N in one reading is too much for force_limit_n = "
                f"{self._settings.force_limit_n:g} N (at most {allowed_n / COARSE_SD:.2g} N is allowed); shield the "
                "cell's wires, fasten the cell, or set it to 10 readings a second"
            )
        moved_n = (self._zero - self._first_zero) * self._slope
        if abs(moved_n) > allowed_n:
            raise CaptureError(
                f"load cell: is {moved_n:+.3g} N off its tare at the beginning of the session (at most {allowed_n:.3g} "
                "N is allowed). Its zero drifts, or the indenter still presses the pad; let the cell warm up and "
                "tighten its mount, or move the indenter off the pad, then resume"
            )

    def mean(self, readings: int = STEP_READINGS, watch: Callable[[], object] | None = None) -> Force:
        """Return the mean of readings that the amplifier's filter has forgotten the past in.

        What watches moves, as :func:`rigs.capture._stage_press.StagePress.guard`, takes the readings before them.
        """
        self.settle(watch or self.reading_n)
        counts = self._at_rest(readings, self.noise_n / abs(self._slope))
        mean_n = (float(counts.mean()) - self._zero) * self._slope
        noise_n = math.hypot(mean_noise_n(self.noise_n, readings), mean_noise_n(self.noise_n, self._zero_readings))
        return Force(mean_n, noise_n)

    def _at_rest(self, readings: int, sd: float) -> Floats:
        """Return counts without those that lost a bit; one reading before and one after show whether the ends did."""
        counts = np.array([self._counts() for _ in range(readings + 2)], dtype=np.float64)
        kept = without_jumps(counts, sd)
        self.lost_bits += counts.size - kept.size
        return kept[1:-1]

    def follow(self, force: Force) -> None:
        """Take a mean of a step that touched nothing for no force, by a standard deviation at most: it drifts."""
        most_n = FOLLOWED_SD * force.noise_n
        self._zero += min(max(force.mean_n, -most_n), most_n) / self._slope
        self._zero_readings = STEP_READINGS

    def absorbed_n(self) -> float:
        """Return the force of the pad that the zero may have followed since the tare (N)."""
        followed_n = (self._zero - self._tared) * self._slope
        noise_n = mean_noise_n(self.noise_n, STEP_READINGS)
        return max(followed_n, 0.0) + FOLLOWED_SD * noise_n if followed_n else 0.0

    def settled(self, watch: Callable[[], object] | None = None) -> Force:
        """Return the force when two means in a row agree, or after the longest wait that the rig file allows."""
        before = self.mean(watch=watch)
        rounds = int(self._settings.settle_s * self._settings.rate_hz / (STEP_READINGS + SETTLING_READINGS))
        for _ in range(max(rounds, 1)):
            now = self.mean(watch=watch)
            if abs(now.mean_n - before.mean_n) <= 3.0 * math.sqrt(2.0) * mean_noise_n(self.noise_n, STEP_READINGS):
                return now
            before = now
        return before


BLOCKS: Final = 12
"""Equal parts of the time at rest, each with a mean."""


def at_rest(
    cell: LoadCell, settings: LoadCellSettings, calibration: LoadCellCalibration, clock: Clock, rest_s: float
) -> CellAtRest:
    """Read the cell for so long while nothing moves.

    Raises
    ------
    LostError
        It is stuck.
    CaptureError
        It fell silent, or reads as no empty cell would.
    """
    gauge = ForceGauge(cell, settings, calibration)
    gauge.begin(clock.monotonic_s)
    forces_n, times_s = [gauge.reading_above_empty_n()], []
    end_s = clock.monotonic_s() + rest_s
    while clock.monotonic_s() < end_s:
        forces_n.append(gauge.reading_above_empty_n())
        times_s.append(clock.monotonic_s())
    forces_n.append(gauge.reading_above_empty_n())
    # one reading before each block and one after show whether its ends lost a bit
    edges = np.linspace(0, len(times_s), BLOCKS + 1).astype(int)
    around = [forces_n[start : end + 2] for start, end in pairwise(edges)]
    blocks = [without_jumps(block, abs(calibration.slope_n_per_count))[1:-1] for block in around]
    within = math.sqrt(float(np.mean([block.var(ddof=1) for block in blocks])))
    return CellAtRest(
        readings=len(times_s),
        span_s=times_s[-1] - times_s[0],
        longest_gap_s=float(np.diff(times_s).max()),
        noise_n=within,
        means_n=tuple(float(block.mean()) for block in blocks),
        jumps=len(times_s) - sum(block.size for block in blocks),
    )


LAYINGS: Final = 2
"""How often a known mass is laid: off its middle it reads otherwise, which one laying would not show."""
LAID_SETTLES_S: Final = 3.0
LAID_S: Final = 4.0
"""How long the cell is read then; shorter than what creeps, longer than noise."""


def weigh(
    cell: LoadCell,
    settings: LoadCellSettings,
    calibration: LoadCellCalibration,
    lay: Callable[[float], None],
    mass_kg: float,
) -> LaidMass:
    """Have a mass laid on the cell and taken off, again and again, and return what the calibration makes of it.

    Raises
    ------
    CaptureError
        The cell fell silent, is stuck or overloaded, or does not return to its zero: something still lies on it.
    """
    gauge = ForceGauge(cell, settings, calibration)

    def mean_n() -> tuple[float, float]:
        for _ in range(math.ceil(LAID_SETTLES_S * settings.rate_hz)):
            gauge.reading_above_empty_n()
        readings = [gauge.reading_above_empty_n() for _ in range(math.ceil(LAID_S * settings.rate_hz) + 2)]
        forces = without_jumps(readings, abs(calibration.slope_n_per_count))[1:-1]
        return float(forces.mean()), float(forces.std(ddof=1)) / math.sqrt(forces.size / SETTLING_READINGS)

    lay(0.0)
    zeros, loaded = [mean_n()], []
    for _ in range(LAYINGS):
        lay(mass_kg)
        loaded.append(mean_n())
        lay(0.0)
        zeros.append(mean_n())
        moved_n = zeros[-1][0] - zeros[0][0]
        if abs(moved_n) > ZERO_MOVED_SHARE * settings.force_limit_n:
            raise CaptureError(
                f"load cell: reads {moved_n:+.3g} N after the mass was taken off, but 0 N before it was placed; take "
                "everything off the cell, fasten the cell, then check again"
            )
    empty = [0.5 * (before[0] + after[0]) for before, after in pairwise(zeros)]
    return LaidMass(
        forces_n=tuple(on[0] - off for on, off in zip(loaded, empty, strict=True)),
        zeros_n=tuple(zero for zero, _ in zeros),
        noise_n=max(noise for _, noise in (*zeros, *loaded)),
    )


@dataclass(frozen=True, slots=True)
class OpenTactileRig:
    """Opened devices of a tactile rig.

    Attributes
    ----------
    stage, load_cell
        None where a person presses.
    lay
        Lays a mass (kg) on the cell: the simulated one at once, on a real one a person is asked.
    lay_block
        Lays a block of a thickness (mm) on the pad, or takes it off (0), and returns whether that was done.
    """

    camera: Camera | None
    stage: Stage | None
    load_cell: LoadCell | None
    operator: Operator
    clock: Clock
    lay: Callable[[float], None] = lambda mass_kg: None
    lay_block: Callable[[float], bool] = lambda thickness_mm: False

    def camera_there(self) -> Camera:
        """Return the camera, which was opened."""
        if self.camera is None:
            raise RefusedError("camera: could not be opened; check its address in the rig file and its cable")
        return self.camera

    def press_devices(self) -> tuple[PressDevice, ...]:
        """Return what stage and load cell say they are."""
        return tuple(device.identity() for device in (self.stage, self.load_cell) if device is not None)


@contextmanager
def open_tactile_rig(
    rig: TactileRig,
    folder: Path,
    operator: Operator | None = None,
    only: Literal["camera", "stage", "load cell", "stage and load cell"] | None = None,
) -> Iterator[OpenTactileRig]:
    """Open and lock camera, stage and load cell for a ``with`` block; opening a stage stops whatever it was doing.

    Parameters
    ----------
    rig
        The rig file's content.
    folder
        Where relative paths in it start.
    operator
        Who presses, or is asked; a person at the terminal when left out.
    only
        What to open; all when left out.

    Raises
    ------
    CaptureError
        A device cannot be reached, or another capture uses it.
    """
    if rig.is_simulated:
        yield _open_finger(rig)
        return
    hands = operator or TerminalOperator()

    def lay(mass_kg: float) -> None:
        hands.do(f"Place {1e3 * mass_kg:g} g gently on the load cell." if mass_kg else "Take everything off the cell.")

    def lay_block(thickness_mm: float) -> bool:
        what = f"Place the block of {thickness_mm:g} mm flat on the pad under the indenter"
        what = what if thickness_mm else "Take the block off the pad"
        return hands.allows(f"The stage is at rest. {what}, and take your hands away. Is that done?")

    with ExitStack() as stack:
        parts = {"camera": rig.camera, "stage": rig.stage, "load cell": rig.load_cell}
        wanted = {role: part for role, part in parts.items() if part is not None and (only is None or role in only)}
        for role, part in wanted.items():
            stack.enter_context(device_locked(role, part.driver, part.address))
        # the cell before the stage: what moves is never open without what stops it
        cell = stack.enter_context(open_load_cell(rig.load_cell)) if rig.load_cell and "load cell" in wanted else None
        camera = stack.enter_context(open_camera(rig.camera, folder)) if "camera" in wanted else None
        stage = stack.enter_context(open_stage(rig.stage)) if rig.stage and "stage" in wanted else None
        yield OpenTactileRig(camera, stage, cell, hands, SystemClock(), lay, lay_block)


def _open_finger(rig: TactileRig) -> OpenTactileRig:
    """Put the simulated devices of a tactile rig over one finger."""
    # Imported here so that a rig of real devices never loads the simulation.
    from rigs.simulated import FingerCamera, FingerOperator, FingerState, SimulatedLoadCell, SimulatedStage

    if rig.simulated is None or rig.load_cell is None:
        raise RefusedError(
            f"rig '{rig.name}': has no [simulated] or no [load_cell] table, but a simulated finger needs both"
        )
    state, seed = FingerState(rig), rig.simulated.seed

    def lay(mass_kg: float) -> None:
        state.load_kg = mass_kg

    def lay_block(thickness_mm: float) -> bool:
        state.block_mm = thickness_mm
        return True

    return OpenTactileRig(
        FingerCamera(state, rig.camera, np.random.default_rng([seed, 2])),
        SimulatedStage(state),
        SimulatedLoadCell(state, rig.load_cell, np.random.default_rng([seed, 3])),
        FingerOperator(state),
        state.clock,
        lay,
        lay_block,
    )
