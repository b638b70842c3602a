"""The device part of an acceptance check of a rig whose stage presses; :mod:`finray_calib.acceptance` judges.

Whoever reports something is not believed alone: that the stage moves is seen by the force that the cell feels and by
the dent in the camera's picture, and that the cell feels is seen by the touches of the stage. Towards the pad the stage
goes in steps that the cell watches; it is stopped on purpose only on its way out of the pad. Whatever ends a part
early, the stage is stopped and leaves the pad before the next one.
"""

import itertools
import math
import time
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Final, Literal, TypeVar

import numpy as np
from numpy.typing import NDArray

from data_schemas import (
    CaptureError,
    CellAtRest,
    CheckedTouch,
    DeviceIdentity,
    ForceStop,
    Handshake,
    LoadCellCalibration,
    PlannedPress,
    PressDevice,
    PressFacts,
    RefusedError,
    Section,
    StageMoves,
    StageStop,
    TactileCheckPlan,
    TactileRig,
    TimedOutError,
    UnsafeError,
)
from rigs import CellReading, Clock, ForceLimitError, LoadCell, Operator, Stage, TerminalOperator
from rigs.capture._check_session import HANDSHAKES, Progress
from rigs.capture._exposure import CAMERA_DEADLINE_MARGIN_S
from rigs.capture._force_gauge import SETTLING_READINGS, STEP_READINGS, Force, at_rest, read_cell_calibration
from rigs.capture._plan import require_named
from rigs.capture._stage_press import PRESS_LESS, NotAllowedError, OpenTactileRig, StagePress, open_tactile_rig

T = TypeVar("T")
SECTIONS: Final[tuple[Section, ...]] = ("handshake", "load cell", "stage", "touch", "force limit", "stops")
STEPS: Final = len(SECTIONS) + 3
"""Opening, these, closing, opening once more."""


def check_press_plan(plan: TactileCheckPlan, rig: TactileRig, folder: Path) -> LoadCellCalibration:
    """Return the calibration of the load cell, after checking the plan against the rig.

    Raises
    ------
    CaptureError
        The check has no name, nothing presses, or a place or force lies outside what the rig file allows.
    RecordError
        The cell is not calibrated.
    """
    require_named("plan.check_name", plan.check_name)
    if rig.stage is None or rig.load_cell is None:
        raise CaptureError(f"rig '{rig.name}': has no [stage] and [load_cell]; there is nothing to check that presses")
    stage, most_n = rig.stage, rig.load_cell.force_limit_n
    low_mm, high_mm = stage.pad_travel_mm
    for away_mm in (-plan.beside_mm, plan.beside_mm):
        at_mm = stage.base_mm + stage.from_base * (plan.position_mm + away_mm)
        if not low_mm <= at_mm <= high_mm:
            raise CaptureError(
                f"plan.position_mm = {plan.position_mm:g} mm and beside_mm = {plan.beside_mm:g} mm lead to "
                f"{stage.pad_axis} = {at_mm:g} mm, outside the stage's travel of {low_mm:g} to {high_mm:g} mm; choose "
                "a position farther from its ends, or a smaller beside_mm"
            )
    if plan.force_limit_n is not None and plan.force_limit_n > most_n:
        raise CaptureError(
            f"plan.force_limit_n = {plan.force_limit_n:g} N must not exceed the {most_n:g} N of the rig file"
        )
    return read_cell_calibration(rig.load_cell, folder)


def record_press_facts(
    rig: TactileRig,
    plan: TactileCheckPlan,
    rig_folder: Path,
    progress: Progress = lambda done, total, what: None,
    *,
    operator: Operator | None = None,
) -> PressFacts:
    """Try stage, load cell and camera of a rig and return what they did.

    A device error ends its own part; the stage is stopped and leaves the pad before the next one. A cell that fails, a
    touch that is not found, a place that is lost and a stage that is not seen to stop end all that moves.

    Parameters
    ----------
    rig, plan
        The rig and what to check on it.
    rig_folder
        Where relative paths in the rig file start.
    progress
        Called with (done, total, text) at the start of every part.
    operator
        Who allows the stage to move; a person at the terminal when left out.

    Raises
    ------
    CaptureError
        The plan does not fit the rig.
    """
    calibration = check_press_plan(plan, rig, rig_folder)
    return _Recorder(rig, plan, rig_folder, calibration, progress).record(operator or TerminalOperator())


class _Recorder:
    """Walks through the parts of one check."""

    def __init__(
        self,
        rig: TactileRig,
        plan: TactileCheckPlan,
        rig_folder: Path,
        calibration: LoadCellCalibration,
        progress: Progress,
    ) -> None:
        self._rig, self._plan, self._folder, self._progress = rig, plan, rig_folder, progress
        self._calibration = calibration
        self._facts = PressFacts(calibration=calibration, calibration_age_days=age_days(calibration.calibrated_utc))
        self._errors: dict[Section, str] = {}
        self._ended: str | None = None
        self._begun: list[Section] = []
        self._presser: StagePress | None = None
        self._told: list[str] = []

    def record(self, operator: Operator) -> PressFacts:
        """Open the rig, try everything, close it, and open it once more."""
        with ExitStack() as stack:
            opened = self._attempt(
                "opening", lambda: stack.enter_context(open_tactile_rig(self._rig, self._folder, operator))
            )
            if opened is None:
                self._ended = "the rig could not be opened"
                self._errors |= dict.fromkeys(SECTIONS, f"not tried: {self._ended}")
            else:
                self._with_open_rig(opened)
            closing = stack.pop_all()
        self._attempt("closing", closing.close, also_when_ended=True)
        self._attempt("reconnect", lambda: self._reconnect(operator))
        self._keep(errors=self._errors)
        return self._facts

    def _with_open_rig(self, opened: OpenTactileRig) -> None:
        """Try everything that the open rig can show."""
        hands = self._attempt("handshake", lambda: press_handshakes(opened, self._rig))
        self._keep(handshakes=hands or ())
        for hand in hands or ():
            if hand.role != "camera" and hand.error is not None:
                self._ended = f"the {hand.role} does not answer"
        self._attempt("handshake", lambda: self._keep(frame_overheads_s=frame_overheads_s(opened, self._plan)))
        self._attempt("load cell", lambda: self._keep(at_rest=self._rest(opened)))
        if "load cell" in self._errors:
            self._ended = self._ended or "the load cell does not work, so nothing would stop the stage"
        stage, cell = opened.stage, opened.load_cell
        if stage is None or cell is None:  # a rig file with both opens both
            return
        timed, tapped = TimedStage(stage, opened.clock), TappedCell(cell, opened.clock)
        checked = replace(opened, stage=timed, load_cell=tapped)
        limit_n = force_limit_n(self._plan, self._rig)
        presser = StagePress(checked, self._rig, self._calibration, self._note, limit_n)
        checks = PressRounds(checked, presser, timed, tapped, self._plan, self._rig)
        # whatever ends the question, nothing has moved and nothing moves
        self._attempt("stage", lambda: _require_allowed(opened, checks.question()))
        if "stage" not in self._errors:
            self._presser = presser
            self._attempt("stage", checks.along_the_pad)
        self._ended = self._ended or ("the stage could not be made ready" if "stage" in self._errors else None)
        self._attempt("touch", lambda: checks.touch(self._keep))
        self._ended = self._ended or ("the pad was not touched as it should" if "touch" in self._errors else None)
        self._attempt("force limit", lambda: checks.force_stops(self._keep))
        self._attempt("stops", lambda: checks.stops(self._keep))
        self._keep(moves=timed.moves())

    def _rest(self, opened: OpenTactileRig) -> CellAtRest:
        """Read the cell while nothing moves."""
        settings, cell = self._rig.load_cell, opened.load_cell
        if settings is None or cell is None:
            raise RefusedError("load cell: there is none")
        return at_rest(cell, settings, self._calibration, opened.clock, self._plan.rest_s)

    def _reconnect(self, operator: Operator) -> None:
        """Open the closed rig once more, and note what the devices say of themselves; nothing moves."""
        start_s = time.monotonic()
        with open_tactile_rig(self._rig, self._folder, operator) as opened:
            again = press_handshakes(opened, self._rig, asked=1)
            took_s = time.monotonic() - start_s
        for hand in again:
            if hand.error is not None:
                raise CaptureError(hand.error)
        after = tuple(hand.identity for hand in again if hand.identity is not None)
        self._keep(reconnect_s=took_s, reconnected=after)

    def _attempt(self, section: Section, act: Callable[[], T], *, also_when_ended: bool = False) -> T | None:
        """Return what `act` returns; note its error, with what the stage did then, and return None."""
        if self._ended is not None and not also_when_ended:
            self._errors.setdefault(section, f"not tried: {self._ended}")
            return None
        if section not in self._begun:
            self._progress(len(self._begun), STEPS, section)
            self._begun.append(section)
        self._told.clear()
        try:
            if self._presser is None:
                return act()
            with self._presser.standing_by():
                return act()
        except CaptureError as error:
            self._errors.setdefault(section, "; ".join([str(error), *(f"the stage {told}" for told in self._told)]))
            if isinstance(error, UnsafeError):
                self._ended = "the stage was not seen to stop; switch its motors off before anyone touches it"
            elif self._told and not self._told[-1].startswith("moved away"):
                self._ended = "the stage did not leave the pad by itself; free the pad by hand"
            return None

    def _note(self, event: str, **what: object) -> None:
        """Remember what the stage did after it was stopped."""
        if event == "stage after stop":
            self._told.append(str(what["text"]))

    def _keep(self, **what: object) -> None:
        """Add facts."""
        self._facts = self._facts.model_copy(update=what)


def _require_allowed(opened: OpenTactileRig, question: str) -> None:
    """Ask a person before anything moves.

    Raises
    ------
    NotAllowedError
        The person said no, or nobody is there.
    """
    if not opened.operator.allows(question):
        raise NotAllowedError(
            "stage: nobody has allowed it to move; run the check in a terminal, look at the rig, and type yes"
        )


def age_days(calibrated_utc: str) -> float | None:
    """Return how many days ago a calibration was made; None where its date cannot be read or lies ahead."""
    try:
        then = datetime.fromisoformat(calibrated_utc)
    except ValueError:
        return None
    then = then if then.tzinfo is not None else then.replace(tzinfo=UTC)
    days = (datetime.now(UTC) - then).total_seconds() / 86400.0
    return days if days > -1.0 else None


def press_handshakes(opened: OpenTactileRig, rig: TactileRig, asked: int = HANDSHAKES) -> tuple[Handshake, ...]:
    """Ask camera, stage and load cell who they are and how they stand, so many times; nothing moves."""
    stage, cell = opened.stage, opened.load_cell
    found = [_handshake(opened, "camera", rig.camera.driver, opened.camera_there().identity, lambda: None, asked)]
    if stage is not None and rig.stage is not None:
        found.append(_handshake(opened, "stage", rig.stage.driver, stage.identity, stage.places_mm, asked))
    if cell is not None and rig.load_cell is not None:
        within_s = rig.load_cell.silent_s
        asking: Callable[[], object] = lambda: cell.read(within_s)  # noqa: E731
        found.append(_handshake(opened, "load cell", rig.load_cell.driver, cell.identity, asking, asked))
    return tuple(found)


def _handshake(
    opened: OpenTactileRig,
    role: Literal["camera", "stage", "load cell"],
    driver: str,
    identity: Callable[[], DeviceIdentity | PressDevice],
    state: Callable[[], object],
    asked: int,
) -> Handshake:
    """Ask one device so many times."""
    durations_s: list[float] = []
    said, error = None, None
    try:
        for _ in range(asked):
            start_s = opened.clock.monotonic_s()
            said = identity()
            state()
            durations_s.append(opened.clock.monotonic_s() - start_s)
    except CaptureError as raised:
        error = str(raised)
    return Handshake(role=role, driver=driver, identity=said, durations_s=tuple(durations_s), error=error)


def frame_overheads_s(opened: OpenTactileRig, plan: TactileCheckPlan) -> tuple[float, ...]:
    """Take frames, and return how long each took beyond its exposure (s)."""
    camera, clock, found = opened.camera_there(), opened.clock, []
    for _ in range(HANDSHAKES):
        start_s = clock.monotonic_s()
        camera.expose(plan.exposure_s, plan.exposure_s + CAMERA_DEADLINE_MARGIN_S)
        found.append(max(clock.monotonic_s() - start_s - plan.exposure_s, 0.0))
    return tuple(found)


LIMIT_SHARE: Final = 0.5
"""Of the rig's force limit: what the check allows itself where its plan names no limit."""
PRESS_SHARE: Final = 0.25
"""Of the check's force limit: the force at which the stage turns."""
STOP_SHARE: Final = 0.5
"""Of the check's force limit: the force at which the stage is stopped to see how far it goes beyond."""
STEP_MARGIN: Final = 1.5
"""Forces that are left free for one more step, for a pad that becomes stiffer."""
STOP_WAY_S: Final = 2.0
"""How long a move takes that is stopped on its way, beside the time that the cell may be silent."""
STOP_AT_SHARE: Final = 0.3
DENT_FRAMES: Final = 4
DENT_CELLS: Final = 32
"""Columns in which a picture is looked at, so that noise averages out."""
DENT_SD: Final = 6.0


def force_limit_n(plan: TactileCheckPlan, rig: TactileRig) -> float:
    """Return the force (N) at which the stage stops in this check: that of its plan, or half of the rig file's."""
    most_n = math.inf if rig.load_cell is None else rig.load_cell.force_limit_n
    return min(plan.force_limit_n or LIMIT_SHARE * most_n, most_n)


class _StopRequestedError(Exception):
    """Stands for a person who wants the stage to stop."""


class _SilencedError(TimedOutError):
    """No reading came because the check passes none on."""


@dataclass(slots=True)
class TappedCell:
    """A load cell whose readings are remembered, and which can be made silent."""

    cell: LoadCell
    clock: Clock
    is_silent: bool = False
    last_s: float = 0.0
    heard: list[int] | None = None

    def identity(self) -> PressDevice:
        """Return what the cell says it is."""
        return self.cell.identity()

    def read(self, deadline_s: float) -> CellReading:
        """Return the next reading, unless the cell was made silent."""
        if self.is_silent:
            self.clock.sleep(deadline_s)
            raise _SilencedError(f"load cell: made silent by the check; no reading came within {deadline_s:g} s")
        reading = self.cell.read(deadline_s)
        self.last_s = self.clock.monotonic_s()
        if self.heard is not None:
            self.heard.append(reading.counts)
        return reading


class TimedStage:
    """A stage whose moves are timed, and asked for their end."""

    def __init__(self, stage: Stage, clock: Clock) -> None:
        self._stage, self._clock = stage, clock
        self._moves: dict[str, list[tuple[float, float]]] = {}

    def identity(self) -> PressDevice:
        """Return what the stage says it is."""
        return self._stage.identity()

    def places_mm(self) -> dict[str, float] | None:
        """Ask where the axes stand."""
        return self._stage.places_mm()

    def home(self, deadline_s: float, watch: Callable[[], None]) -> None:
        """Find the zero."""
        self._stage.home(deadline_s, watch)

    def counted_mm(self) -> dict[str, float]:
        """Ask for the count."""
        return self._stage.counted_mm()

    def trust_places(self) -> dict[str, float]:
        """Take the count for true."""
        return self._stage.trust_places()

    def move(self, axis: str, to_mm: float, speed_mm_per_s: float, watch: Callable[[], None]) -> None:
        """Move, and note how long it took beyond its way, and where it is reported to have ended."""
        before = self._stage.places_mm()
        began_s = self._clock.monotonic_s()
        self._stage.move(axis, to_mm, speed_mm_per_s, watch)
        took_s = self._clock.monotonic_s() - began_s
        after = self._stage.places_mm()
        if before is not None and after is not None:
            late_s = max(took_s - abs(to_mm - before[axis]) / speed_mm_per_s, 0.0)
            self._moves.setdefault(axis, []).append((late_s, abs(after[axis] - to_mm)))

    def stop(self) -> None:
        """Stop at once."""
        self._stage.stop()

    def moves(self) -> tuple[StageMoves, ...]:
        """Return what was seen of each axis."""
        return tuple(
            StageMoves(
                axis=axis,
                moves=len(seen),
                longest_overhead_s=max(late_s for late_s, _ in seen),
                furthest_off_mm=max(off_mm for _, off_mm in seen),
            )
            for axis, seen in sorted(self._moves.items())
        )


class PressRounds:
    """What the stage does while the cell and the camera look on."""

    def __init__(
        self,
        opened: OpenTactileRig,
        presser: StagePress,
        stage: TimedStage,
        cell: TappedCell,
        plan: TactileCheckPlan,
        rig: TactileRig,
    ) -> None:
        if rig.stage is None or rig.load_cell is None:
            raise RefusedError(f"rig '{rig.name}': has no stage with a load cell")
        self._opened, self._presser, self._stage, self._cell, self._plan = opened, presser, stage, cell, plan
        self._settings, self._silent_s = rig.stage, rig.load_cell.silent_s
        self._limit_n = force_limit_n(plan, rig)
        self._numbers = itertools.count(1)

    def question(self) -> str:
        """Return what a person is asked before anything moves."""
        stage, plan = self._settings, self._plan
        homes = "homes all axes, then " if stage.homing == "switches" else ""
        return (
            f"The check {homes}moves the stage along the pad and presses {plan.returns + 3 * plan.stops + 4} times "
            f"at {plan.position_mm:g} mm from the base and {plan.beside_mm:g} mm beside it, with up to "
            f"{self._limit_n:g} N and {plan.deepest_mm:g} mm deep. Is the way free, are all hands away, and is the "
            "switch of the motors within reach?"
        )

    def along_the_pad(self) -> None:
        """Home, and go to either side of the position while nothing touches."""
        self._presser.prepare()
        for turn in range(self._plan.returns):
            self._beside(turn)
            self._go_along(0.0)

    def _beside(self, turn: int) -> Literal["base", "tip"]:
        """Leave the position along the pad to the side whose turn it is."""
        side: Literal["base", "tip"] = "base" if turn % 2 == 0 else "tip"
        self._go_along(-self._plan.beside_mm if side == "base" else self._plan.beside_mm)
        return side

    def _go_along(self, away_mm: float) -> None:
        """Go along the pad, clear of it, to a place beside the position."""
        self._presser.away(self._presser.guard(self._limit_n))
        stage = self._settings
        at_mm = stage.base_mm + stage.from_base * (self._plan.position_mm + away_mm)
        self._stage.move(stage.pad_axis, at_mm, stage.travel_speed_mm_per_s, self._presser.guard(self._limit_n))

    def touch(self, keep: Callable[..., None]) -> None:
        """Return to the position from both sides, touch, press, turn and leave."""
        dents = [self._dent(away_mm) for away_mm in (-self._plan.beside_mm, self._plan.beside_mm)]
        keep(dents_px=tuple(dent for dent in dents if dent is not None))
        found: list[CheckedTouch] = []
        for turn in range(self._plan.returns):
            found.append(self._round(turn))
            keep(touches=tuple(found))

    def _dent(self, away_mm: float) -> float | None:
        """Press beside the position, and return where the camera sees the contact (column, px); None: not at all."""
        self._go_along(away_mm)
        before = self._pictures()
        self._press(away_mm)
        during = self._pictures()
        self._presser.leave()
        return dent_column_px(before, during)

    def _pictures(self) -> NDArray[np.float64]:
        """Take frames."""
        exposure_s = self._plan.exposure_s
        camera = self._opened.camera_there()
        frames = [camera.expose(exposure_s, exposure_s + CAMERA_DEADLINE_MARGIN_S) for _ in range(DENT_FRAMES)]
        return np.stack([frame.counts.astype(np.float64) for frame in frames])

    def _press(self, away_mm: float = 0.0) -> int:
        """Touch and press until the turning force, and return the number of the contact."""
        number = next(self._numbers)
        self._presser.touches.clear()  # where the touch comes is what the check is about
        self._presser.press(
            PlannedPress(
                depth_mm=self._plan.deepest_mm,
                position_mm=self._plan.position_mm + away_mm,
                depth_uncertainty_mm=0.0,
                position_uncertainty_mm=0.0,
                force_limit_n=self._limit_n,
                until_force_n=PRESS_SHARE * self._limit_n,
            ),
            number,
        )
        self._presser.seen()
        return number

    def _round(self, turn: int) -> CheckedTouch:
        """Return to the position from one side, touch, press, go deeper and back, and leave."""
        side = self._beside(turn)
        number = self._press()
        touched = self._presser.measured[number]
        from_above, deeper, from_below, deeper_mm = self._turn()
        self._presser.leave()
        return CheckedTouch(
            side=side,
            touch_mm=touched.touch_mm,
            touch_uncertainty_mm=touched.touch_uncertainty_mm,
            from_above_n=from_above.mean_n,
            from_below_n=from_below.mean_n,
            deeper_n=deeper.mean_n,
            deeper_mm=deeper_mm,
            noise_n=from_above.noise_n,
            relaxed_n=touched.relaxed_n,
            zero_shift_n=self._presser.measured[number].zero_shift_n or 0.0,
        )

    def _turn(self) -> tuple[Force, Force, Force, float]:
        """Go some steps deeper and back to the same position: forces before, deepest and after, and how deep (mm)."""
        stage, gauge, watch = self._settings, self._presser.gauge, self._presser.guard(self._limit_n)
        start_mm, before = self._at_mm(), gauge.settled()
        wanted = math.ceil(2.0 * self._plan.limits.backlash_mm / stage.step_mm)
        force, deeper_mm = before, 0.0
        for number, at_mm in enumerate(self._presser.steps(start_mm, stage.step_mm), 1):
            if self._is_too_deep(at_mm):
                break
            self._presser.step_to(at_mm, watch)
            last, force = force, gauge.settled()
            deeper_mm = number * stage.step_mm
            if number >= wanted or force.mean_n + STEP_MARGIN * abs(force.mean_n - last.mean_n) > self._limit_n:
                break
        if deeper_mm == 0.0:
            raise RefusedError(
                f"stage: one step of {stage.step_mm:g} mm from the turning force leads deeper than deepest_mm = "
                f"{self._plan.deepest_mm:g} mm; raise deepest_mm, or lower force_limit_n of the plan"
            )
        self._stage.move(stage.press_axis, start_mm, stage.press_speed_mm_per_s, watch)
        return before, force, gauge.settled(), deeper_mm

    def _at_mm(self) -> float:
        """Return where the press axis stands."""
        places = self._stage.places_mm()
        if places is None:
            raise RefusedError("stage: its position is unknown; free the pad by hand, then check again")
        return places[self._settings.press_axis]

    def force_stops(self, keep: Callable[..., None]) -> None:
        """Press into a force limit that lies below that of the check, again and again."""
        found: list[ForceStop] = []
        for turn in range(self._plan.stops):
            self._beside(turn)
            self._press()
            found.append(self._into_a_limit())
            self._presser.leave()
            keep(force_stops=tuple(found))

    def _into_a_limit(self) -> ForceStop:
        """Go on in steps until the force limit of this part stops the stage, and return how far the force went."""
        stage, gauge = self._settings, self._presser.gauge
        start_mm, points = self._at_mm(), [gauge.settled().mean_n]
        stop_n = STOP_SHARE * self._limit_n
        watch = self._presser.guard(stop_n)
        try:
            for at_mm in self._presser.steps(start_mm, stage.step_mm):
                if self._is_too_deep(at_mm):
                    raise RefusedError(
                        f"stage: {points[-1]:.3g} N at deepest_mm = {self._plan.deepest_mm:g} mm, but the stop is "
                        f"tried at {stop_n:g} N; raise deepest_mm, or lower force_limit_n of the plan"
                    )
                self._require_room(points, stop_n)
                self._cell.heard = []
                self._presser.step_to(at_mm, watch)
                points.append(gauge.settled().mean_n)
        except ForceLimitError:
            gauge.mean(SETTLING_READINGS + STEP_READINGS)
        heard, self._cell.heard = self._cell.heard or [], None
        slopes = np.diff(points) / stage.step_mm
        grows = float(slopes[-1] - slopes[-2]) if slopes.size > 1 else 0.0
        if not slopes.size or slopes[-1] <= 0.0:
            raise RefusedError(
                f"stage: its first step of {stage.step_mm:g} mm reached {stop_n:g} N already; raise force_limit_n of "
                "the plan, or shorten step_mm of the rig file"
            )
        return ForceStop(
            limit_n=stop_n,
            peak_n=max(gauge.force_n(counts) for counts in heard),
            noise_n=gauge.noise_n,
            stiffness_n_per_mm=float(slopes[-1]) + max(grows, 0.0),
            step_mm=stage.step_mm,
        )

    def _is_too_deep(self, at_mm: float) -> bool:
        """Whether a place of the press axis lies deeper than the plan allows."""
        touch_mm = self._presser.touches[self._plan.position_mm][0]
        return self._settings.into_pad * (at_mm - touch_mm) > self._plan.deepest_mm

    def _require_room(self, points: list[float], stop_n: float) -> None:
        """Refuse a step that could lead beyond the force limit of the check."""
        rise_n = points[-1] - points[-2] if len(points) > 1 else 0.0
        if stop_n + STEP_MARGIN * rise_n > self._limit_n:
            raise RefusedError(
                f"stage: one step of {self._settings.step_mm:g} mm adds {rise_n:.3g} N, which is too much to try a "
                f"stop at {stop_n:g} N below force_limit_n = {self._limit_n:g} N; {PRESS_LESS}"
            )

    def stops(self, keep: Callable[..., None]) -> None:
        """Stop the stage on its way out of the pad, for every reason in turn; then touch once more."""
        stops: list[StageStop] = []
        touches: list[CheckedTouch] = []
        reasons: tuple[Literal["request", "silent cell"], ...] = ("request", "silent cell")
        for turn, reason in enumerate(reasons * self._plan.stops):
            stops.append(self._stopped_round(turn, reason))
            keep(stops=tuple(stops))
            self._presser.leave()
        for turn in range(2):
            touches.append(self._round(turn))
        keep(after_stops=tuple(touches))

    def _stopped_round(self, turn: int, reason: Literal["request", "silent cell"]) -> StageStop:
        """Press, and stop the stage on its way out."""
        self._beside(turn)
        self._press()
        stage, clock, start_mm = self._settings, self._opened.clock, self._at_mm()
        lasts_s = STOP_WAY_S + (self._silent_s if reason == "silent cell" else 0.0)
        speed_mm_per_s = min(abs(stage.clear_mm - start_mm) / lasts_s, stage.travel_speed_mm_per_s)
        began_s, guard = clock.monotonic_s(), self._presser.guard(self._limit_n)
        asked: list[float] = []

        def watch() -> None:
            guard()
            if clock.monotonic_s() - began_s > STOP_AT_SHARE * lasts_s:
                if reason == "request":
                    asked.append(clock.monotonic_s())
                    raise _StopRequestedError
                self._cell.is_silent = True

        try:
            self._stage.move(stage.press_axis, stage.clear_mm, speed_mm_per_s, watch)
        except (_StopRequestedError, _SilencedError):
            pass
        finally:
            stood_s, self._cell.is_silent = clock.monotonic_s(), False
        places = self._stage.places_mm()
        return StageStop(
            reason=reason,
            stood_after_s=max(stood_s - (asked[0] if asked else self._cell.last_s), 0.0),
            start_mm=start_mm,
            end_mm=stage.clear_mm,
            stood_mm=None if places is None else places[stage.press_axis],
        )


def dent_column_px(before: NDArray[np.float64], during: NDArray[np.float64]) -> float | None:
    """Return the column around which frames differ (px), each of shape (n, H, W); None where nothing stands out."""
    width = int(before.shape[2]) // (2 * DENT_CELLS) * (2 * DENT_CELLS)
    if width == 0:
        return None
    cut = [
        frames[:, :, :width].reshape(frames.shape[0], frames.shape[1], DENT_CELLS, -1) for frames in (before, during)
    ]
    # whole Bayer cells: colours that brighten and darken must not cancel
    mosaic = [[part[:, i::2, :, j::2].mean(axis=(1, 3)) for i in (0, 1) for j in (0, 1)] for part in cut]
    change = sum((b.mean(axis=0) - a.mean(axis=0)) ** 2 for a, b in zip(*mosaic, strict=True))
    noise = sum((b.var(axis=0, ddof=1) + a.var(axis=0, ddof=1)) / len(a) for a, b in zip(*mosaic, strict=True))
    seen = np.clip(np.asarray(change) - DENT_SD**2 * float(np.mean(noise)), 0.0, None)
    if seen.sum() == 0.0:
        return None
    middle = float(np.average(np.arange(DENT_CELLS) + 0.5, weights=seen))
    return float(middle * width / DENT_CELLS)
