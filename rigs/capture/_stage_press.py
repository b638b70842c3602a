r"""Presses by a stage with a load cell that stops it: touch, steps, force with uncertainty, and away.

What a press rests on: the force is the cell's count above a tare times the slope of its calibration; the touch lies
between the last step without and the first with a force above five standard deviations (so that the pad's stiffness
times touch_step_mm must exceed the noise of a mean several times); every place is an absolute
machine coordinate that the stage has reported. While the stage moves, each reading of the cell is compared with the
force limit and with the last ones. The force that is reached beyond the limit is at most

.. math:: \Delta F = k \min\bigl(v (t_{cell} + t_{stage}) + v^2 / 2 a, \; s\bigr)

with the stiffness k, the speed v, the time between readings (and the amplifier's own filter), the time until the stage
obeys, its deceleration a and the step s: no move towards the pad is longer than one step.
"""

import math
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, Final, NamedTuple

from data_schemas import (
    CaptureError,
    LoadCellCalibration,
    LoadCellSettings,
    MeasuredPress,
    PlannedPress,
    RefusedError,
    StageSettings,
    TactileRig,
    UnsafeError,
)
from rigs import (
    ForceLimitError,
)
from rigs.capture._force_gauge import (
    COARSE_SD,
    SETTLING_READINGS,
    STEP_READINGS,
    TARE_READINGS,
    ZERO_MOVED_SHARE,
    Force,
    ForceGauge,
    OpenTactileRig,
    mean_noise_n,
    read_cell_calibration,
)

TOUCH_SD: Final = 5.0
"""A force above so many standard deviations is a touch: by chance in fewer than one step of 10,000."""
BACK_STEPS: Final = 3
FIRST_POINTS: Final = 3
STEPS_OF_A_TARE: Final = 10
"""Long steps without a force after which the cell is tared again, because its zero drifts."""
LEAST_STEP_MM: Final = 0.005
STEP_MARGIN: Final = 1.5
"""Forces that are left free for one more step, for a pad that becomes stiffer."""
SECOND_STEP_MARGIN: Final = 2.5
"""The same where only one step tells the stiffness: of a pad whose force grows with the square of the depth."""
SEARCH_SHARE: Final = 0.25
"""Of the force limit, in the search of the touch: noise and a moved zero stay below a fifth of it."""
SEARCH_SD: Final = 12.0
"""Of a reading: what stops the search is more than what counts as a touch, also where a press has a small limit."""
SIDEWAYS_SHARE: Final = 0.2
"""Of the force limit, on ways along the pad: a zero may have moved by a tenth of it."""
MOST_LOST_BITS: Final = 3
"""In one move, each of which stops the stage: more tell of a broken wire."""
FORCE_REACHED: Final = 0.98
HOMING_WITHIN_S: Final = 60.0
TOUCH_MOVED_MM: Final = 0.1
"""A pad that has crept is touched a few hundredths of a millimetre deeper; more means lost steps."""
PRESS_LESS: Final = "press less deeply, or raise force_limit_n if finger and load cell can bear it"
NOT_CLEAR: Final = (
    "the indenter touches before clear_mm of the rig file, or an axis is reversed; correct clear_mm or the axis"
)


@dataclass(slots=True)
class _Touched:
    """The contact that is being made."""

    contact: int
    touch_mm: float
    touch_uncertainty_mm: float
    points: list[tuple[float, Force]]
    press: PlannedPress
    before: Force
    absorbed_n: float


def free_travel_guard(opened: OpenTactileRig, rig: TactileRig, folder: Path) -> Callable[[], None]:
    """Return what to call while a stage moves where nothing should touch: it raises at a tenth of the force limit.

    Raises
    ------
    RefusedError
        There is no load cell.
    RecordError
        There is no calibration of it.
    """
    if rig.load_cell is None or opened.load_cell is None:
        raise RefusedError(f"rig '{rig.name}': has no load cell that could stop its stage")
    gauge = ForceGauge(opened.load_cell, rig.load_cell, read_cell_calibration(rig.load_cell, folder))
    gauge.begin(opened.clock.monotonic_s)
    return _guard(gauge, ZERO_MOVED_SHARE * rig.load_cell.force_limit_n, NOT_CLEAR)


def _guard(gauge: ForceGauge, limit_n: float, advice: str) -> Callable[[], None]:
    """Return what is called while a stage moves: it takes the cell's next reading and raises beyond the limit."""

    def watch() -> None:
        force_n = gauge.strongest_n()
        if abs(force_n) > limit_n:
            text = f"stage: stopped at {force_n:.3g} N, beyond the limit of {limit_n:g} N; {advice}"
            raise ForceLimitError(text, force_n, limit_n)

    return watch


class NotAllowedError(RefusedError):
    """A person did not allow the stage to move: it stays where it is."""


class StagePress:
    """Presses the contacts of one session, and leaves the pad whatever goes wrong.

    Parameters
    ----------
    opened, rig
        Open devices and the rig file.
    calibration
        Of the load cell.
    note
        Writes a line of the journal: event, and what it says.
    limit_n
        Force (N) at which the stage stops, where it is less than that of the rig file.

    Raises
    ------
    RefusedError
        The rig has no stage or no load cell.
    """

    def __init__(
        self,
        opened: OpenTactileRig,
        rig: TactileRig,
        calibration: LoadCellCalibration,
        note: Callable[..., None],
        limit_n: float = math.inf,
    ) -> None:
        if rig.stage is None or rig.load_cell is None or opened.stage is None or opened.load_cell is None:
            raise RefusedError(f"rig '{rig.name}': has no stage with a load cell; nothing can press by itself")
        self._stage, self._settings, self._cell = opened.stage, rig.stage, rig.load_cell
        self.gauge, self._calibration = ForceGauge(opened.load_cell, rig.load_cell, calibration), calibration
        self._operator, self._clock, self._note = opened.operator, opened.clock, note
        self._is_ready = False
        self._now: _Touched | None = None
        self.touches: dict[float, tuple[float, float]] = {}
        self.limit_n = min(limit_n, rig.load_cell.force_limit_n)
        self.measured: dict[int, MeasuredPress] = {}

    def guard(self, limit_n: float, advice: str = PRESS_LESS) -> Callable[[], None]:
        """Return what is called while the stage moves."""
        return _guard(self.gauge, limit_n, advice)

    @contextmanager
    def standing_by(self) -> Iterator[None]:
        """Stop and leave the pad when anything ends a ``with`` block early, and say so in the journal.

        Where a person does not allow a move, nothing moves.
        """
        try:
            yield
        except NotAllowedError:
            raise
        except BaseException as error:
            with suppress(CaptureError):
                self._note("stage stopped", why=f"{type(error).__name__}: {error}")
            with _undisturbed():
                self._flee(error)
            raise

    def _flee(self, error: BaseException) -> None:
        """Move away from the pad if it is known where that is; raise only if the stage is not seen to stop."""
        stage = self._settings
        unsafe: UnsafeError | None = None
        try:
            self._stage.stop()
            if (places := self._stage.places_mm()) is None:
                told = (
                    "does not know its position after the stop; move the indenter off the pad by hand, then home "
                    "the stage"
                )
            elif stage.into_pad * (places[stage.press_axis] - stage.clear_mm) < -LEAST_STEP_MM:
                told = (
                    f"stands at {stage.press_axis} = {places[stage.press_axis]:.3f} mm, and clear_mm = "
                    f"{stage.clear_mm:g} mm lies from there towards the pad; move the indenter off the pad by hand"
                )
            else:
                self._stage.move(stage.press_axis, stage.clear_mm, stage.travel_speed_mm_per_s, lambda: None)
                told = f"moved away to {stage.press_axis} = {stage.clear_mm:g} mm"
        except UnsafeError as worse:
            unsafe, told = worse, f"could not move the indenter away: {worse}"
        except CaptureError as other:
            told = f"could not move the indenter away: {other}"
        with suppress(CaptureError):
            self._note("stage after stop", text=told)
        if unsafe is not None:
            raise unsafe from error

    def prepare(self) -> None:
        """Find the stage's zero, and go where nothing touches; once in a session."""
        if self._is_ready:
            return
        self.gauge.begin(self._clock.monotonic_s)
        if self._settings.homing == "switches":
            self._stage.home(HOMING_WITHIN_S, self.guard(self.limit_n))
        else:
            self._trust_by_hand()
        self.away(self.guard(self.limit_n))
        places = self._stage.places_mm()
        self._note("stage ready", places_mm=places, homing=self._settings.homing)
        self._is_ready = True

    def _trust_by_hand(self) -> None:
        """Have a person say that the stage stands at the zero that the rig file counts from."""
        places = self._stage.counted_mm()
        where = ", ".join(f"{axis} {at_mm:.3f} mm" for axis, at_mm in sorted(places.items()))
        if not self._operator.allows(
            f"The stage reports its position as {where}. Have you brought it to the zero from which the rig "
            "file counts positions, and is the way to clear_mm free?"
        ):
            raise NotAllowedError("stage: nobody has confirmed that it is at its zero; bring it there, then resume")
        self._stage.trust_places()

    def away(self, watch: Callable[[], None]) -> None:
        """Move the press axis to where nothing touches: step by step where that is towards the pad, as after homing."""
        stage = self._settings
        places = self._stage.places_mm()
        if places is None:
            raise RefusedError("stage: its position is unknown; resume the session, which homes the stage")
        at_mm, careful = places[stage.press_axis], self.guard(ZERO_MOVED_SHARE * self.limit_n, NOT_CLEAR)
        while stage.into_pad * (stage.clear_mm - at_mm) > stage.step_mm:
            at_mm += stage.into_pad * stage.step_mm
            self.step_to(at_mm, careful)
        if stage.into_pad * (stage.clear_mm - at_mm) > 0.0:
            self.press_to(stage.clear_mm, careful)
            return
        self.drive(stage.press_axis, stage.clear_mm, stage.travel_speed_mm_per_s, watch)

    def drive(self, axis: str, to_mm: float, speed_mm_per_s: float, watch: Callable[[], None]) -> None:
        """Move one axis; the force is then that of readings which were made after the move ended.

        A reading beyond the limit stops the stage. Where the next ones show that it had lost a bit, the move goes on.
        """
        for more in range(MOST_LOST_BITS, -1, -1):
            try:
                self._stage.move(axis, to_mm, speed_mm_per_s, watch)
                return
            except ForceLimitError as error:
                if error.limit_n is None or not (more and self.gauge.has_jumped(error.limit_n)):
                    raise
            finally:
                self.gauge.moved(self._clock.monotonic_s())

    def along(self, to_mm: float) -> None:
        """Move along the pad, clear of it: a fifth of the force limit ends that, as nothing should touch there."""
        stage = self._settings
        careful = self.guard(SIDEWAYS_SHARE * self.limit_n, NOT_CLEAR)
        self.drive(stage.pad_axis, to_mm, stage.travel_speed_mm_per_s, careful)

    def press_to(self, to_mm: float, watch: Callable[[], None]) -> None:
        """Move the press axis at the speed of presses."""
        self.drive(self._settings.press_axis, to_mm, self._settings.press_speed_mm_per_s, watch)

    def step_to(self, to_mm: float, watch: Callable[[], None]) -> None:
        """Move one step towards the pad, and go on only when the amplifier's filter has shown all of its force."""
        self.press_to(to_mm, watch)
        self.gauge.settle(watch)

    def press(self, press: PlannedPress, contact: int) -> None:
        """Touch the pad at the place of a press and press as it asks; the stage then stands.

        Raises
        ------
        ForceLimitError
            The force exceeded the limit of the press or of the rig; the stage has left the pad.
        RefusedError
            The press is deeper than the travel of the rig file.
        CaptureError
            Stage or cell failed, or the touch has moved since the last time at this place.
        """
        self.prepare()
        stage = self._settings
        limit_n = min(self.limit_n, press.force_limit_n or math.inf)
        self.away(self.guard(limit_n))
        place_mm = stage.base_mm + stage.from_base * press.position_mm
        self.along(place_mm)
        above_mm, force, been_mm = self._find_touch(limit_n)
        absorbed_n = self.gauge.absorbed_n()
        touched = _Touched(contact, above_mm, 0.0, [(above_mm, force)], press, force, absorbed_n)
        self._push(touched, limit_n, been_mm)
        touched.before = self.gauge.settled(self.guard(limit_n))
        self._note("force", contact=contact, force_n=touched.before.mean_n, before="images")
        self._now = touched

    def steps(self, from_mm: float, step_mm: float) -> Iterator[float]:
        """Yield places step by step towards the pad, to the end of the travel."""
        stage = self._settings
        number = 1
        while True:
            to_mm = from_mm + stage.into_pad * number * step_mm
            if stage.into_pad * (to_mm - stage.deepest_mm) > 0.0:
                raise RefusedError(
                    f"stage: has reached {stage.press_axis} = {stage.deepest_mm:g} mm, the end of its travel into the "
                    "pad; if that is not deep enough, raise press_travel_mm in the rig file"
                )
            yield to_mm
            number += 1

    def _find_touch(self, limit_n: float) -> tuple[float, Force, float]:
        """Return the first place with a force, looked for with long and then with short steps from before it.

        With it the place that the long steps had led to.
        """
        stage, watch = self._settings, self.guard(limit_n)
        been_mm = self._search_by_long_steps(limit_n)
        back_mm = self._step_back(been_mm, watch)
        self.gauge.tare()
        for at_mm in self.steps(back_mm, stage.touch_step_mm):
            self.press_to(at_mm, watch)
            force = self.gauge.mean(watch=watch)
            if abs(force.mean_n) > TOUCH_SD * force.noise_n and self._is_touched():
                if force.mean_n < 0.0:
                    raise CaptureError(
                        f"load cell: reports {force.mean_n:.3g} N where the pad is touched, so its sign is reversed, "
                        "or its zero drifts; calibrate the cell as mounted, or let it warm up"
                    )
                return at_mm, force, been_mm
            self.gauge.follow(force)
        raise AssertionError("the steps end with an error")

    def _search_by_long_steps(self, limit_n: float) -> float:
        """Return the place (mm) where long steps meet the pad; a share of the force limit ends the last one early.

        How stiff the pad is nobody knows yet: a whole step into a stiff one would lead beyond the limit.

        Raises
        ------
        ForceLimitError
            One step led beyond the limit all the same, before the stage could stop.
        """
        stage = self._settings
        self.gauge.tare()
        share_n = min(max(SEARCH_SHARE * limit_n, SEARCH_SD * self.gauge.noise_n), limit_n)
        careful = self.guard(share_n, f"the search for the touch stops there, below the force limit of {limit_n:g} N")
        for number, at_mm in enumerate(self.steps(stage.clear_mm, stage.step_mm), 1):
            try:
                self.step_to(at_mm, careful)
            except ForceLimitError as error:
                places, strongest_n = self._stage.places_mm(), abs(self.gauge.mean().mean_n)
                if places is None or error.limit_n is None:
                    raise
                if strongest_n > limit_n:
                    raise ForceLimitError(
                        f"stage: the search for the touch met {strongest_n:.3g} N in one step of {stage.step_mm:g} "
                        f"mm, beyond the limit of {limit_n:g} N; shorten step_mm or lower press_speed_mm_per_s in the "
                        "rig file",
                        strongest_n,
                        limit_n,
                    ) from error
                return float(places[stage.press_axis])
            if abs(self.gauge.reading_n()) > COARSE_SD * self.gauge.noise_n and self._is_touched():
                break
            if number % STEPS_OF_A_TARE == 0:
                self.gauge.tare()
        return at_mm

    def _step_back(self, at_mm: float, watch: Callable[[], None]) -> float:
        """Go back some long steps until that changes the force no more, and return where the stage is then."""
        stage, before = self._settings, self.gauge.mean()
        while True:
            at_mm -= stage.into_pad * BACK_STEPS * stage.step_mm
            if stage.into_pad * (at_mm - stage.clear_mm) < 0.0:
                raise CaptureError(
                    f"load cell: reports a force near clear_mm = {stage.clear_mm:g} mm, where nothing should touch. "
                    f"Its zero drifts, or clear_mm in the rig file is less than {3 * BACK_STEPS * stage.step_mm:g} mm "
                    "from the pad; let the cell warm up, or correct clear_mm"
                )
            self.press_to(at_mm, watch)
            now = self.gauge.mean()
            noise_n = math.sqrt(2.0) * mean_noise_n(self.gauge.noise_n, STEP_READINGS)
            if abs(now.mean_n - before.mean_n) <= TOUCH_SD * noise_n:
                return at_mm
            before = now

    def _is_touched(self) -> bool:
        """Whether a second mean is above the threshold too."""
        force = self.gauge.mean()
        return abs(force.mean_n) > TOUCH_SD * force.noise_n

    def _push(self, touched: _Touched, limit_n: float, been_mm: float) -> None:
        """Press step by step to the depth or force that is asked for.

        The first step leads no deeper than the search of the touch, or by one short step. Each of the others goes where
        nothing has been since the touch, and needs room: a pad may become stiffer.
        """
        stage, press, watch = self._settings, touched.press, self.guard(limit_n)
        first_mm = at_mm = touched.points[0][0]
        self._place_touch(touched)
        while True:
            depth_mm = stage.into_pad * (at_mm - touched.touch_mm)
            force = touched.points[-1][1]
            step_mm = min(stage.step_mm, press.depth_mm - depth_mm)
            if len(touched.points) == 1:
                step_mm = min(step_mm, max(stage.into_pad * (been_mm - at_mm), stage.touch_step_mm))
            if press.until_force_n is not None:
                if force.mean_n >= FORCE_REACHED * press.until_force_n:
                    break
                stiffness = max(force.mean_n, force.noise_n) / max(depth_mm, stage.touch_step_mm)
                step_mm = min(step_mm, max((press.until_force_n - force.mean_n) / stiffness, LEAST_STEP_MM))
            if step_mm < 0.5 * LEAST_STEP_MM:
                break
            if len(touched.points) > 1:
                step_mm = self._with_room(touched, step_mm, limit_n)
            at_mm = next(self.steps(at_mm, step_mm))
            self.press_to(at_mm, watch)
            touched.points.append((at_mm, self.gauge.mean(watch=watch)))
            if len(touched.points) <= FIRST_POINTS:
                self._place_touch(touched)
                self._require_seen(touched)
        if press.until_force_n is not None and force.mean_n < FORCE_REACHED * press.until_force_n:
            raise RefusedError(
                f"stage: the force at the depth of {press.depth_mm:g} mm is only {force.mean_n:.3g} N, but "
                f"until_force_n = {press.until_force_n:g} N; raise depth_mm, or lower until_force_n"
            )
        self._require_same_touch(touched, first_mm)

    def _with_room(self, touched: _Touched, step_mm: float, limit_n: float) -> float:
        """Return the step (mm), shortened where it might lead beyond the limit by a pad that becomes stiffer.

        One to a force leads no farther than that by the stiffness of the next step. To a depth that the same stiffness
        puts beyond the limit, shorter steps would only lead nearer to the limit before they end.

        Raises
        ------
        RefusedError
            It would lead beyond the limit by the stiffness alone, or a step has no room.
        """
        at_mm, now = touched.points[-1]
        stiffness, until_n = _next_stiffness_n_per_mm(touched.points[-3:], step_mm), touched.press.until_force_n
        if until_n is not None and stiffness > 0.0:
            step_mm = min(step_mm, max((until_n - now.mean_n) / stiffness, LEAST_STEP_MM))
        margin = STEP_MARGIN if len(touched.points) > 2 else SECOND_STEP_MARGIN
        room_n = limit_n - now.mean_n
        most_mm = room_n / (margin * stiffness) if stiffness > 0.0 else math.inf
        if stiffness * step_mm > room_n or min(most_mm, step_mm) < 0.5 * LEAST_STEP_MM:
            raise RefusedError(
                f"stage: after {abs(at_mm - touched.points[0][0]):.2g} mm in steps, the cell reads {now.mean_n:.3g} N, "
                f"and the next step of {step_mm:.2g} mm adds {stiffness * step_mm:.3g} N, which would exceed or nearly "
                f"reach the limit of {limit_n:g} N; shorten step_mm of the rig file, or {PRESS_LESS}"
            )
        return min(step_mm, most_mm)

    def _place_touch(self, touched: _Touched) -> None:
        r"""Place the touch within the last short step, evenly likely.

        It lies between the first place z with a force and the one before, less what may stay unseen there: the
        threshold T over the stiffness. The standard uncertainty is half of that over the root of 3.
        """
        stage = self._settings
        above_mm = touched.points[0][0]
        before_mm = above_mm - stage.into_pad * stage.touch_step_mm
        threshold_n = (TOUCH_SD + 2.0) * touched.points[0][1].noise_n
        stiffness = [f.mean_n / abs(z - before_mm) for z, f in touched.points[:FIRST_POINTS] if f.mean_n > 0.0]
        unseen_mm = (threshold_n + touched.absorbed_n) / min(stiffness) if stiffness else stage.step_mm
        wide_mm = stage.touch_step_mm + unseen_mm
        touched.touch_mm = above_mm - stage.into_pad * 0.5 * wide_mm
        touched.touch_uncertainty_mm = 0.5 * wide_mm / math.sqrt(3.0)

    def _require_seen(self, touched: _Touched) -> None:
        """Refuse a pad that a short step presses by less than the cell can tell: its touch is found too late."""
        if len(touched.points) < FIRST_POINTS:
            return
        stage, (at_mm, force) = self._settings, touched.points[FIRST_POINTS - 1]
        way_mm = abs(at_mm - touched.points[0][0]) + stage.touch_step_mm
        needed_n = (TOUCH_SD + 2.0) * touched.points[0][1].noise_n + touched.absorbed_n
        got_n = max(force.mean_n, 0.0) * stage.touch_step_mm / way_mm
        if needed_n > got_n:
            raise CaptureError(
                f"load cell: is too noisy for this pad. A step of touch_step_mm = {stage.touch_step_mm:g} mm changes "
                f"the force by {1000.0 * got_n:.2g} mN, but only a change of {1000.0 * needed_n:.2g} mN or more can "
                "be distinguished from noise and drift; take a longer touch_step_mm, shield the cell's wires, or "
                "read the cell 10 times a second"
            )

    def _require_same_touch(self, touched: _Touched, first_mm: float) -> None:
        """Refuse a touch that has moved since the last one at this place: the stage lost steps, or something moved."""
        place_mm = touched.press.position_mm
        self._note(
            "touch", contact=touched.contact, place_mm=touched.touch_mm, uncertainty_mm=touched.touch_uncertainty_mm,
            first_force_at_mm=first_mm,
        )  # fmt: skip
        if place_mm in self.touches:
            before_mm, before_u_mm = self.touches[place_mm]
            allowed_mm = TOUCH_MOVED_MM + 3.0 * math.hypot(before_u_mm, touched.touch_uncertainty_mm)
            moved_mm = touched.touch_mm - before_mm
            if abs(moved_mm) > allowed_mm:
                raise CaptureError(
                    f"stage: at {place_mm:g} mm along the pad, the touch is {moved_mm:+.3f} mm away from the earlier "
                    f"touch (at most {allowed_mm:.2f} mm is allowed). The stage lost steps, or the finger moved; "
                    "drive the stage slower, fasten stage and finger, then resume"
                )
        self.touches.setdefault(place_mm, (touched.touch_mm, touched.touch_uncertainty_mm))

    def seen(self) -> None:
        """Measure the force again when the images of a contact are taken; what it lost meanwhile is uncertainty."""
        if self._now is None:
            return
        after, done = self.gauge.mean(), self._now
        measured = self._measured(done, after)
        self._note("press", **measured.model_dump())
        self.measured[done.contact] = measured

    def _measured(self, done: _Touched, after: Force) -> MeasuredPress:
        """Return the contact with what is uncertain of its force and depth."""
        stage = self._settings
        force_n, relaxed_n = 0.5 * (done.before.mean_n + after.mean_n), done.before.mean_n - after.mean_n
        noise_n = math.hypot(done.before.noise_n, after.noise_n) / math.sqrt(2.0)
        absorbed_n = done.absorbed_n / math.sqrt(3.0)
        depths_mm = [stage.into_pad * (z - done.touch_mm) for z, _ in done.points]
        return MeasuredPress(
            contact=done.contact,
            ended_by="depth" if done.press.until_force_n is None else "force",
            touch_mm=done.touch_mm,
            touch_uncertainty_mm=done.touch_uncertainty_mm,
            depth_mm=max(depths_mm[-1], 0.0),
            depth_uncertainty_mm=math.hypot(done.touch_uncertainty_mm, stage.position_uncertainty_mm),
            force_n=force_n,
            force_uncertainty_n=math.hypot(
                self._scale_uncertainty_n(force_n), noise_n, relaxed_n / math.sqrt(12.0), absorbed_n
            ),
            relaxed_n=relaxed_n,
            point_depths_mm=tuple(depths_mm),
            point_forces_n=tuple(force.mean_n for _, force in done.points),
            point_uncertainties_n=tuple(
                math.hypot(self._scale_uncertainty_n(force.mean_n), force.noise_n) for _, force in done.points
            ),
        )

    def _scale_uncertainty_n(self, force_n: float) -> float:
        """Return the standard uncertainty of a force by the calibration: its slope and the form of its curve."""
        calibration = self._calibration
        slope_rel = calibration.slope_uncertainty_n_per_count / abs(calibration.slope_n_per_count)
        return math.hypot(slope_rel * force_n, calibration.form_uncertainty_n)

    def leave(self) -> None:
        """Move away from the pad, and see how far the cell's zero has moved meanwhile.

        Raises
        ------
        CaptureError
            By more than a tenth of the force limit.
        """
        self.prepare()
        self.away(self.guard(math.inf))
        if self._now is None:
            return
        contact, self._now = self._now.contact, None
        shift = self.gauge.mean(TARE_READINGS)
        self._note("zero", contact=contact, shift_n=shift.mean_n, lost_bits=self.gauge.lost_bits)
        self.measured[contact] = with_zero_shift(self.measured[contact], shift.mean_n)
        if abs(shift.mean_n) > ZERO_MOVED_SHARE * self.limit_n:
            raise CaptureError(
                f"load cell: its zero moved by {shift.mean_n:+.3g} N during contact {contact} (at most "
                f"{ZERO_MOVED_SHARE * self.limit_n:.3g} N is allowed); let the cell warm up, fasten the cell, then "
                "resume"
            )


def _next_stiffness_n_per_mm(points: list[tuple[float, Force]], step_mm: float) -> float:
    """Return the stiffness of the next step: that of the last one, and what it grew by where that is more than noise.

    Parameters
    ----------
    points
        The last places (mm) and forces, two or three.
    step_mm
        Length of the next step.
    """
    steps = [(abs(z - a), f.mean_n - e.mean_n, math.hypot(f.noise_n, e.noise_n)) for (a, e), (z, f) in pairwise(points)]
    way_mm, rise_n, noise_n = steps[-1]
    stiffness = max(rise_n, 0.0) / way_mm
    if len(steps) == 1:
        return stiffness
    before_mm, before_n, before_noise_n = steps[0]
    grown = stiffness - before_n / before_mm
    if grown <= 3.0 * math.hypot(noise_n / way_mm, before_noise_n / before_mm):
        return stiffness
    return stiffness + grown * (way_mm + step_mm) / (before_mm + way_mm)


@contextmanager
def _undisturbed() -> Iterator[None]:
    """Let a second Ctrl-C wait until the stage has left the pad, which takes bounded time."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


def with_zero_shift(measured: MeasuredPress, shift_n: float) -> MeasuredPress:
    """Return a contact after which the cell's zero had moved: by any part of it at each force, evenly likely."""
    part_n = shift_n / math.sqrt(3.0)
    wider = {
        "force_uncertainty_n": math.hypot(measured.force_uncertainty_n, part_n),
        "point_uncertainties_n": tuple(math.hypot(u_n, part_n) for u_n in measured.point_uncertainties_n),
    }
    return measured.model_copy(update={"zero_shift_n": shift_n, **wider})


def replayed_presses(lines: list[dict[str, Any]]) -> dict[int, MeasuredPress]:
    """Return the contacts that the lines of a journal hold, with what the zero had moved after each."""
    presses: dict[int, MeasuredPress] = {}
    for line in lines:
        if line["event"] == "press":
            fields = {name: line[name] for name in MeasuredPress.model_fields if name in line}
            presses[int(line["contact"])] = MeasuredPress.model_validate(fields)
        elif line["event"] == "zero" and int(line["contact"]) in presses:
            contact = int(line["contact"])
            presses[contact] = with_zero_shift(presses[contact], float(line["shift_n"]))
    return presses


EXCHANGE_S: Final = 0.2
"""What a step of the stage takes beside its way: its line, the answer and two reports."""


class ContactTimes(NamedTuple):
    """How long a stage takes for one contact (s), typically and at the longest."""

    typical_s: float
    longest_s: float


def contact_times(stage: StageSettings, cell: LoadCellSettings, press: PlannedPress) -> ContactTimes:
    """Return how long one contact takes: the way to the pad, the touch, the steps, settling and the way back.

    The longest goes through all of the travel with as many readings as the touch needs, and waits for the force as long
    as the rig file allows. A step costs a fifth of a second of exchanges with the controller.
    """
    way_mm = abs(stage.deepest_mm - stage.clear_mm)
    reading_s, exchange_s = 1.0 / cell.rate_hz, EXCHANGE_S
    mean_s = (SETTLING_READINGS + STEP_READINGS) * reading_s
    coarse_s = EXCHANGE_S + stage.step_mm / stage.press_speed_mm_per_s + (1 + SETTLING_READINGS) * reading_s
    fine_s = exchange_s + stage.touch_step_mm / stage.press_speed_mm_per_s + mean_s
    pressing_s = press.depth_mm / stage.step_mm * (coarse_s + mean_s)
    touch_s = 2.0 * BACK_STEPS * stage.step_mm / stage.touch_step_mm * fine_s + 3.0 * TARE_READINGS * reading_s
    travel_s = 2.0 * (way_mm + 20.0) / stage.travel_speed_mm_per_s
    typical_s = 0.5 * way_mm / stage.step_mm * coarse_s + touch_s + pressing_s + travel_s + 4.0 * mean_s
    longest_s = way_mm / stage.step_mm * coarse_s + 2.0 * touch_s + pressing_s + 2.0 * travel_s + cell.settle_s
    return ContactTimes(typical_s, longest_s)
