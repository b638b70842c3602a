"""What the stage does in a check while load cell and camera look on: moves, touches, presses and stops.

Towards the pad the stage goes in steps that the cell watches. It is stopped on purpose on its way out of the pad, and
in one slow move towards it that ends, whatever fails, where steps have led before.
"""

import itertools
import math
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from data_schemas import (
    BlockTouches,
    CheckedTouch,
    ForceStop,
    MovingStop,
    PlannedPress,
    PressDevice,
    RefusedError,
    StageMoves,
    StageStop,
    TactileCheckPlan,
    TactileRig,
    TimedOutError,
)
from rigs import CellReading, Clock, ForceLimitError, LoadCell, Stage
from rigs.capture._exposure import CAMERA_DEADLINE_MARGIN_S, CAMERA_EXPOSURES
from rigs.capture._force_gauge import SETTLING_READINGS, STEP_READINGS, Force, OpenTactileRig, without_spikes
from rigs.capture._stage_press import PRESS_LESS, STEP_MARGIN, NotAllowedError, StagePress
from rigs.transports import LATENCY_S

LIMIT_SHARE: Final = 0.5
"""Of the rig's force limit: what the check allows itself where its plan names no limit."""
PRESS_SHARE: Final = 0.25
"""Of the check's force limit: the force at which the stage turns."""
STOP_SHARE: Final = 0.5
"""Of the check's force limit: the force at which the stage is stopped to see how far it goes beyond."""
MOVING_STEPS: Final = 3
"""So much longer than a step must a move be for a stop within it to be told from its end."""
STEPS_PER_S: Final = 1.0
"""Of that move: a reading that comes 0.2 s late then adds a fifth of a step."""
STOP_WAY_S: Final = 2.0
"""How long a move takes that is stopped on its way, beside the time that the cell may be silent."""
STOP_AT_SHARE: Final = 0.3
LISTEN_S: Final = 4.0
"""Beyond the longest allowed time: how long the cell checks that a stopped stage is at rest."""
STILL_SHARE: Final = 0.1
STILL_SD: Final = 7.0
"""Of one reading: two differ by more once in 10^6."""
CLEAR_SD: Final = 50.0
CONTACT_SHARE: Final = 0.1
BLOCK_TOUCHES: Final = 3
ROOM_STEPS: Final = 12
"""The search of a touch goes back by nine steps from the first force, and needs some before clear_mm."""
DENT_ROUNDS: Final = 3
DENT_FRAMES: Final = 4
DENT_CELLS: Final = 32
"""Columns in which a picture is looked at, so that noise averages out."""
DENT_SD: Final = 6.0
DENT_TURNS: Final = 20


def force_limit_n(plan: TactileCheckPlan, rig: TactileRig) -> float:
    """Return the force (N) at which the stage stops in this check: that of its plan, or half of the rig file's."""
    most_n = math.inf if rig.load_cell is None else rig.load_cell.force_limit_n
    return min(plan.force_limit_n or LIMIT_SHARE * most_n, most_n)


Floats = NDArray[np.float64]


class _StopRequestedError(RefusedError):
    """Stands for a person who wants the stage to stop; it passes through drivers as errors of finray do."""


class _SilencedError(TimedOutError):
    """No reading came because the check passes none on."""


@dataclass(slots=True)
class TappedCell:
    """A load cell whose readings are remembered, and which can be made silent: it then feels on, and tells nobody."""

    cell: LoadCell
    clock: Clock
    is_silent: bool = False
    last_s: float = 0.0
    heard: list[int] | None = None
    felt: list[tuple[float, int]] | None = None

    def identity(self) -> PressDevice:
        """Return what the cell says it is."""
        return self.cell.identity()

    def read(self, deadline_s: float) -> CellReading:
        """Return the next reading, unless the cell was made silent."""
        if self.is_silent:
            self.feel(deadline_s)
            raise _SilencedError(
                f"load cell: the check stops its readings here; no reading came within {deadline_s:g} s"
            )
        reading = self._read(deadline_s)
        self.last_s = reading.at_s
        if self.heard is not None:
            self.heard.append(reading.counts)
        return reading

    def feel(self, duration_s: float) -> None:
        """Remember what is felt for so long, and pass nothing on."""
        end_s = self.clock.monotonic_s() + duration_s
        while (left_s := end_s - self.clock.monotonic_s()) > 0.0:
            with suppress(TimedOutError):
                self._read(left_s)

    def _read(self, deadline_s: float) -> CellReading:
        """Return the next reading, and remember it with the time at which it was made."""
        reading = self.cell.read(deadline_s)
        if self.felt is not None:
            self.felt.append((reading.at_s, reading.counts))
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
        self._limit_n, self._rate_hz = force_limit_n(plan, rig), rig.load_cell.rate_hz
        self._numbers = itertools.count(1)

    def question(self) -> str:
        """Return what a person is asked before anything moves."""
        stage, plan = self._settings, self._plan
        blocks = 0 if plan.gauge_block is None else 2 * BLOCK_TOUCHES
        presses = plan.returns + 3 * plan.stops + 2 * DENT_ROUNDS + 2 + blocks
        homes = "homes all axes, then " if stage.homing == "switches" else ""
        return (
            f"The check {homes}moves the stage along the pad and presses {presses} times "
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
        self._presser.along(at_mm)

    def touch(self, keep: Callable[..., None]) -> None:
        """Return to the position from both sides, touch, press, turn and leave."""
        sides_mm = (-self._plan.beside_mm, self._plan.beside_mm) * DENT_ROUNDS
        dents = [dent for away_mm in sides_mm if (dent := self._dent(away_mm)) is not None]
        keep(dents_px=tuple(dents) if len(dents) == len(sides_mm) else ())
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
        exposure_s, camera = self._plan.exposure_s, self._opened.camera_there()
        limit_s = CAMERA_EXPOSURES * exposure_s + CAMERA_DEADLINE_MARGIN_S
        frames = [camera.expose(exposure_s, limit_s) for _ in range(DENT_FRAMES)]
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
        from_above, deeper, from_below, deeper_mm = self._turn(number)
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

    def _turn(self, number: int) -> tuple[Force, Force, Force, float]:
        """Go some steps deeper and back to the same position: forces before, deepest and after, and how deep (mm)."""
        stage, gauge, watch = self._settings, self._presser.gauge, self._presser.guard(self._limit_n)
        start_mm, before = self._at_mm(), gauge.settled()
        self._require_room(
            before.mean_n, self._rise_n(number), "press deeper from the force at which the stage turns back"
        )
        wanted = math.ceil(2.0 * self._plan.limits.backlash_mm / stage.step_mm)
        force, deeper_mm = before, 0.0
        for steps, at_mm in enumerate(self._presser.steps(start_mm, stage.step_mm), 1):
            if self._is_too_deep(at_mm):
                break
            self._presser.step_to(at_mm, watch)
            last, force = force, gauge.settled()
            deeper_mm = steps * stage.step_mm
            if steps >= wanted or force.mean_n + STEP_MARGIN * abs(force.mean_n - last.mean_n) > self._limit_n:
                break
        if deeper_mm == 0.0:
            raise RefusedError(
                f"stage: one step of {stage.step_mm:g} mm beyond the force at which the stage turns back leads deeper "
                f"than deepest_mm = {self._plan.deepest_mm:g} mm; raise deepest_mm, or lower force_limit_n of the plan"
            )
        self._presser.press_to(start_mm, watch)
        return before, force, gauge.settled(), deeper_mm

    def _at_mm(self) -> float:
        """Return where the press axis stands."""
        places = self._stage.places_mm()
        if places is None:
            raise RefusedError(
                "stage: its position is unknown; move the indenter off the pad by hand, then run 'finray check run' "
                "again"
            )
        return places[self._settings.press_axis]

    def force_stops(self, keep: Callable[..., None]) -> None:
        """Press into a force limit that lies below that of the check, again and again."""
        found: list[ForceStop] = []
        for turn in range(self._plan.stops):
            self._beside(turn)
            found.append(self._into_a_limit(self._press()))
            self._presser.leave()
            keep(force_stops=tuple(found))

    def _into_a_limit(self, number: int) -> ForceStop:
        """Go on in steps until the force limit of this part stops the stage, and return how far the force went."""
        stage, gauge = self._settings, self._presser.gauge
        start_mm, points = self._at_mm(), [gauge.settled().mean_n]
        stop_n = STOP_SHARE * self._limit_n
        watch, rise_n = self._presser.guard(stop_n), self._rise_n(number)
        try:
            for at_mm in self._presser.steps(start_mm, stage.step_mm):
                if self._is_too_deep(at_mm):
                    raise RefusedError(
                        f"stage: the force is {points[-1]:.3g} N at deepest_mm = {self._plan.deepest_mm:g} mm, but the "
                        f"stop must be tried at {stop_n:g} N; raise deepest_mm, or lower force_limit_n of the plan"
                    )
                rise_n = points[-1] - points[-2] if len(points) > 1 else rise_n
                self._require_room(stop_n, rise_n, f"try a stop at {stop_n:g} N")
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
                f"stage: the first step of {stage.step_mm:g} mm already reached {stop_n:g} N; raise force_limit_n of "
                "the plan, or shorten step_mm of the rig file"
            )
        return ForceStop(
            limit_n=stop_n,
            peak_n=self._peak_n(heard),
            noise_n=gauge.noise_n,
            stiffness_n_per_mm=float(slopes[-1]) + max(grows, 0.0),
            step_mm=stage.step_mm,
            moving=self._within_a_move(start_mm),
        )

    def _within_a_move(self, start_mm: float) -> MovingStop | None:
        """Go back, and move slowly once more to where steps have just led; a force limit stops that move halfway.

        Where nothing stops it, the move ends where the stage has stood before. None: the way is too short, or the force
        grows too little, for a stop to be told from that end.
        """
        stage, gauge = self._settings, self._presser.gauge
        end_mm, end_n = self._at_mm(), gauge.settled().mean_n
        self._presser.press_to(start_mm, self._presser.guard(self._limit_n))
        start_n, way_mm = gauge.settled().mean_n, stage.into_pad * (end_mm - start_mm)
        if way_mm < MOVING_STEPS * stage.step_mm or end_n - start_n < CLEAR_SD * gauge.noise_n:
            return None
        limit_n, speed_mm_per_s = 0.5 * (start_n + end_n), min(STEPS_PER_S * stage.step_mm, stage.press_speed_mm_per_s)
        self._cell.heard, stopped_at_n = [], None
        try:
            self._presser.drive(stage.press_axis, end_mm, speed_mm_per_s, self._presser.guard(limit_n))
        except ForceLimitError as error:
            stopped_at_n = error.force_n
        places = self._stage.places_mm()
        gauge.mean(SETTLING_READINGS + STEP_READINGS)
        heard, self._cell.heard = self._cell.heard, None
        return MovingStop(
            limit_n=limit_n,
            way_mm=way_mm,
            unstopped_n=end_n,
            peak_n=self._peak_n(heard),
            stopped_at_n=stopped_at_n,
            end_mm=end_mm,
            stood_mm=None if places is None else places[stage.press_axis],
        )

    def _peak_n(self, heard: list[int]) -> float:
        """Return the largest force of some readings (N); a lost bit is no force."""
        gauge = self._presser.gauge
        return float(without_spikes(np.array([gauge.force_n(counts) for counts in heard]), gauge.noise_n).max())

    def _is_too_deep(self, at_mm: float) -> bool:
        """Whether a place of the press axis lies deeper than the plan allows."""
        touch_mm = self._presser.touches[self._plan.position_mm][0]
        return self._settings.into_pad * (at_mm - touch_mm) > self._plan.deepest_mm

    def _rise_n(self, number: int) -> float:
        """Return what the next step adds by the stiffness over the last step of a press, shorter ones joined (N)."""
        pressed, step_mm = self._presser.measured[number], self._settings.step_mm
        points = list(zip(pressed.point_depths_mm, pressed.point_forces_n, strict=True))
        if len(points) < 2:
            raise RefusedError(
                f"stage: the force is already {points[0][1]:.3g} N at the first touch, so it is not known how much "
                f"one step of {step_mm:g} mm adds; raise force_limit_n of the plan, or shorten touch_step_mm of the "
                "rig file"
            )
        end_mm, end_n = points[-1]
        begin_mm, begin_n = next(
            (point for point in reversed(points[:-1]) if end_mm - point[0] >= 0.5 * step_mm), points[0]
        )
        return max(end_n - begin_n, 0.0) / (end_mm - begin_mm) * step_mm

    def _require_room(self, from_n: float, rise_n: float, what: str) -> None:
        """Refuse a step that could lead beyond the force limit of the check."""
        if from_n + STEP_MARGIN * rise_n > self._limit_n:
            raise RefusedError(
                f"stage: one step of {self._settings.step_mm:g} mm adds {rise_n:.3g} N, which is too much to {what} "
                f"below force_limit_n = {self._limit_n:g} N; {PRESS_LESS}"
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

    def block(self, lay_block: Callable[[float], bool], keep: Callable[..., None]) -> None:
        """Touch the pad, have a block laid on it where there is one, touch that, and have it taken away.

        Raises
        ------
        NotAllowedError
            Nobody says that it was taken away: nothing moves any more.
        """
        known, stage = self._plan.gauge_block, self._settings
        if known is None:
            return
        pad = [self._touch() for _ in range(BLOCK_TOUCHES)]
        room_mm = stage.into_pad * (pad[0][0] - stage.clear_mm) - known.thickness_mm
        if room_mm < ROOM_STEPS * stage.step_mm:
            raise RefusedError(
                f"stage: a block of {known.thickness_mm:g} mm leaves only {room_mm:.3g} mm below clear_mm = "
                f"{stage.clear_mm:g} mm, but {ROOM_STEPS * stage.step_mm:g} mm are needed; take a thinner block"
            )
        if not lay_block(known.thickness_mm):
            return
        on_block = [self._touch() for _ in range(BLOCK_TOUCHES)]
        touched = BlockTouches(
            pad_mm=tuple(at_mm for at_mm, _ in pad),
            block_mm=tuple(at_mm for at_mm, _ in on_block),
            touch_uncertainty_mm=max(sd_mm for _, sd_mm in (*pad, *on_block)),
        )
        keep(block=touched)
        if not lay_block(0.0):
            raise NotAllowedError(
                "stage: nobody has confirmed that the block was taken off the pad, so the stage does not move any "
                "more; take the block away, and check again"
            )

    def _touch(self) -> tuple[float, float]:
        """Touch what lies at the position, leave it, and return where it was touched, with the uncertainty (mm)."""
        touched = self._presser.measured[self._press()]
        self._presser.leave()
        return touched.touch_mm, touched.touch_uncertainty_mm

    def _stopped_round(self, turn: int, reason: Literal["request", "silent cell"]) -> StageStop:
        """Press, and stop the stage on its way out."""
        self._beside(turn)
        self._press()
        stage, clock, start_mm = self._settings, self._opened.clock, self._at_mm()
        # so slow that it still presses when it should stand: the cell feels whether it does
        lasts_s = STOP_WAY_S + (self._silent_s if reason == "silent cell" else 0.0)
        depth_mm = abs(start_mm - self._presser.touches[self._plan.position_mm][0])
        speed_mm_per_s = min(depth_mm / lasts_s, stage.travel_speed_mm_per_s)
        self._cell.felt = []
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
        self._cell.feel(self._plan.limits.halt_s + LISTEN_S)
        felt, self._cell.felt = self._cell.felt, None
        asked_s = asked[0] if asked else self._cell.last_s
        times_s = np.array([at_s for at_s, _ in felt])
        noise_n = self._presser.gauge.noise_n
        forces_n = without_spikes(np.array([self._presser.gauge.force_n(counts) for _, counts in felt]), noise_n)
        still = still_after(times_s, forces_n, asked_s, noise_n, self._rate_hz)
        most_s = self._plan.limits.halt_s + (self._silent_s if reason == "silent cell" else 0.0)
        if still is None and (left_s := left_after_s(times_s, forces_n)) is not None and left_s - asked_s > most_s:
            still = left_s - asked_s, LATENCY_S, math.inf  # it moved until then at least
        places = self._stage.places_mm()
        return StageStop(
            reason=reason,
            stood_after_s=max(stood_s - asked_s, 0.0),
            start_mm=start_mm,
            end_mm=stage.clear_mm,
            stood_mm=None if places is None else places[stage.press_axis],
            still_after_s=None if still is None else still[0],
            still_sd_s=None if still is None else still[1],
            unseen_creep_rel=None if still is None or math.isinf(still[2]) else still[2],
        )


def still_after(
    times_s: Floats, forces_n: Floats, asked_s: float, noise_n: float, rate_hz: float
) -> tuple[float, float, float] | None:
    r"""Return how long after `asked_s` the force fell no more, with its uncertainty (s), and what creep stays unseen.

    The stage stands from the first reading after which the force falls by less than a tenth of its fall until then, or
    than noise. A pad that recovers presses more; a stage that goes on presses less. None where the cell cannot tell:
    the force did not fall clearly before, or was gone in the end, so that nothing touched any more.

    A force that falls by less than the threshold T in the time t until the last reading, where it fell by F in
    :math:`t_0` before, hides a stage that creeps on at up to

    .. math:: v / v_0 = (T / t) / (F / t_0)

    of its speed, on a pad that does not recover meanwhile.

    Parameters
    ----------
    times_s, forces_n
        Readings from the beginning of the move until well after the stop, shape (n,), by when they were made at the
        earliest.
    asked_s
        When the stage was asked to stop, or when the last reading was passed on.
    noise_n
        Standard deviation of one reading.
    rate_hz
        Readings a second.
    """
    before, after = times_s <= asked_s, times_s > asked_s
    if before.sum() < SETTLING_READINGS or after.sum() < SETTLING_READINGS:
        return None
    fell_n = float(forces_n[before][0] - forces_n[before][-1])
    if fell_n < CLEAR_SD * noise_n or float(forces_n[-SETTLING_READINGS:].mean()) < CONTACT_SHARE * forces_n[0]:
        return None
    threshold_n = max(STILL_SHARE * fell_n, STILL_SD * noise_n)
    lowest_to_come = np.minimum.accumulate(forces_n[::-1])[::-1]
    falls_no_more = after & (forces_n - lowest_to_come <= threshold_n)
    at_s = float(times_s[falls_no_more][0]) + 0.5 * LATENCY_S
    speed_n_per_s = fell_n / max(asked_s - float(times_s[0]), 1.0 / rate_hz)
    sd_s = math.hypot(threshold_n / speed_n_per_s, SETTLING_READINGS / rate_hz, LATENCY_S / math.sqrt(12.0))
    left_s = max(float(times_s[-1]) - at_s, 1.0 / rate_hz)
    return at_s - asked_s, sd_s, threshold_n / left_s / speed_n_per_s


def left_after_s(times_s: Floats, forces_n: Floats) -> float | None:
    """Return when the stage had left the pad by the force (s); None: it still presses at the end."""
    gone = np.flatnonzero(forces_n < CONTACT_SHARE * forces_n[0]) if forces_n.size else np.array([])
    still_presses = forces_n.size == 0 or forces_n[-SETTLING_READINGS:].mean() >= CONTACT_SHARE * forces_n[0]
    return None if still_presses or not gone.size else float(times_s[gone[0]])


def dent_column_px(before: NDArray[np.float64], during: NDArray[np.float64]) -> float | None:
    """Return the column around which frames differ (px); None where nothing stands out.

    Parameters
    ----------
    before, during
        Bayer frames, each of shape (n, H, W), or RGB ones, (n, H, W, 3).
    """
    width = int(before.shape[2]) // (2 * DENT_CELLS) * (2 * DENT_CELLS)
    if width == 0:
        return None
    # planes of one colour: colours that brighten and darken must not cancel
    cells = [
        [plane[:, :, : width // 2].reshape(*plane.shape[:2], DENT_CELLS, -1).mean(axis=(1, 3)) for plane in planes]
        for planes in (_colour_planes(before), _colour_planes(during))
    ]
    change = sum((b.mean(axis=0) - a.mean(axis=0)) ** 2 for a, b in zip(*cells, strict=True))
    noise = sum((b.var(axis=0, ddof=1) + a.var(axis=0, ddof=1)) / len(a) for a, b in zip(*cells, strict=True))
    seen = np.clip(np.asarray(change) - DENT_SD**2 * float(np.mean(noise)), 0.0, None)
    if seen.sum() == 0.0:
        return None
    if any((frames[1:] == frames[:-1]).all(axis=tuple(range(1, frames.ndim))).any() for frames in (before, during)):
        return None  # a camera that repeats a frame may show where the contact was before
    column_px = float(np.average(np.arange(DENT_CELLS) + 0.5, weights=seen)) * width / DENT_CELLS
    return _centered_px(before, during, column_px)


def _colour_planes(frames: NDArray[np.float64]) -> list[NDArray[np.float64]]:
    """Return frames as planes of one colour and half their size, (n, H/2, W/2): Bayer sites, or means of RGB pixels."""
    sites = [frames[:, i::2, j::2] for i in (0, 1) for j in (0, 1)]
    if frames.ndim == 3:
        return sites
    rows, columns = sites[-1].shape[1:3]
    mean = np.mean([site[:, :rows, :columns] for site in sites], axis=0)
    return [mean[..., colour] for colour in range(mean.shape[3])]


def _centered_px(before: NDArray[np.float64], during: NDArray[np.float64], column_px: float) -> float:
    """Return the centre of gravity of the change about a column, over a window that is symmetric about it (px)."""
    change = np.zeros(before.shape[2] // 2)
    for a, b in zip(_colour_planes(before), _colour_planes(during), strict=True):
        change += ((b.mean(axis=0) - a.mean(axis=0)) ** 2)[:, : change.size].mean(axis=0)
    change = np.clip(change - np.median(change), 0.0, None)
    columns_px = 2.0 * np.arange(change.size) + 1.0
    for _ in range(DENT_TURNS):
        away_px = columns_px - column_px
        half_px = min(
            2.0 * math.sqrt(float(np.average(away_px**2, weights=change + 1e-12))),
            column_px,
            2.0 * change.size - column_px,
        )
        # a soft window: a hard one jumps by whole cells
        weights = change * np.clip(1.0 - (away_px / max(half_px, 4.0)) ** 2, 0.0, None)
        if weights.sum() == 0.0:
            return column_px
        column_px = float(np.average(columns_px, weights=weights))
    return column_px
