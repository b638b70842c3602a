"""The device part of an acceptance check of a rig whose stage presses; :mod:`finray_calib.acceptance` judges.

Whoever reports something is not believed alone: that the stage moves is seen by the force that the cell feels and by
the dent in the camera's picture, and that the cell feels is seen by the touches of the stage. Whatever ends a part
early, the stage is stopped and leaves the pad before the next one.
"""

from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import replace
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Final, TypeVar

from data_schemas import (
    CaptureError,
    CellAtRest,
    Handshake,
    LaidMass,
    LoadCellCalibration,
    PressFacts,
    RefusedError,
    Section,
    TactileCheckPlan,
    TactileRig,
    UnsafeError,
)
from rigs import Operator, TerminalOperator
from rigs.capture._check_recorder import HANDSHAKES, CheckRecorder, Progress, ask, come_back
from rigs.capture._exposure import CAMERA_DEADLINE_MARGIN_S
from rigs.capture._force_gauge import OpenTactileRig, at_rest, open_tactile_rig, read_cell_calibration, weigh
from rigs.capture._plan import require_named
from rigs.capture._press_rounds import PressRounds, TappedCell, TimedStage, force_limit_n
from rigs.capture._stage_press import NotAllowedError, StagePress

T = TypeVar("T")
SECTIONS: Final[tuple[Section, ...]] = ("handshake", "load cell", "stage", "touch", "force limit", "stops")
HEAVIEST_GRAVITY_M_PER_S2: Final = 9.9
STEPS: Final = len(SECTIONS) + 3
"""Opening, these, closing, opening once more."""
LEAST_FELT, MOST_FELT = 0.8, 1.25
"""Least and most that the cell may read of a known mass, as a share of its weight; else the stage must not press."""


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
        raise CaptureError(
            f"rig '{rig.name}': has no [stage] or no [load_cell], but this check needs both; describe them in the rig "
            "file"
        )
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
            f"plan.force_limit_n = {plan.force_limit_n:g} N must not exceed force_limit_n = {most_n:g} N of the rig "
            "file"
        )
    if plan.known_mass is not None and plan.known_mass.mass_kg * HEAVIEST_GRAVITY_M_PER_S2 > rig.load_cell.capacity_n:
        raise CaptureError(
            f"plan.known_mass.mass_kg = {plan.known_mass.mass_kg:g} kg weighs more than the "
            f"{rig.load_cell.capacity_n:g} N that the cell can bear (capacity_n of the rig file); give a lighter mass"
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


class _Recorder(CheckRecorder[PressFacts]):
    """Walks through the parts of one check."""

    def __init__(
        self,
        rig: TactileRig,
        plan: TactileCheckPlan,
        rig_folder: Path,
        calibration: LoadCellCalibration,
        progress: Progress,
    ) -> None:
        age = age_days(calibration.calibrated_utc)
        super().__init__(
            PressFacts(calibration=calibration, calibration_age_days=age),
            STEPS + (plan.gauge_block is not None),
            progress,
        )
        self._rig, self._plan, self._folder, self._calibration = rig, plan, rig_folder, calibration
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
            self._presser = None  # what follows moves nothing
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
        self._attempt("load cell", lambda: self._keep(laid=self._laid(opened)))
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
        self._ended = self._ended or ("the touch of the pad failed" if "touch" in self._errors else None)
        self._attempt("force limit", lambda: checks.force_stops(self._keep))
        self._attempt("stops", lambda: checks.stops(self._keep))
        if self._plan.gauge_block is not None:
            self._attempt("touch", lambda: checks.block(opened.lay_block, self._keep))
        self._keep(moves=timed.moves())

    def _rest(self, opened: OpenTactileRig) -> CellAtRest:
        """Read the cell while nothing moves."""
        settings, cell = self._rig.load_cell, opened.load_cell
        if settings is None or cell is None:
            raise RefusedError("load cell: is missing; describe it in the rig file")
        return at_rest(cell, settings, self._calibration, opened.clock, self._plan.rest_s)

    def _laid(self, opened: OpenTactileRig) -> LaidMass | None:
        """Have the known mass of the plan laid on the cell, before anything moves; None: there is none at hand."""
        settings, cell, known = self._rig.load_cell, opened.load_cell, self._plan.known_mass
        if settings is None or cell is None or known is None:
            return None
        laid = weigh(cell, settings, self._calibration, opened.lay, known.mass_kg)
        weight_n = known.mass_kg * self._calibration.gravity_m_per_s2
        for force_n in laid.forces_n:
            if not LEAST_FELT <= force_n / weight_n <= MOST_FELT:
                raise RefusedError(
                    f"load cell: reads {force_n:.3g} N under the known mass, but the mass weighs {weight_n:.3g} N, so "
                    "a stage must not press with this load cell. Place the mass that the plan names on the cell, or "
                    "calibrate the cell again ('finray rig calibrate-cell')"
                )
        return laid

    def _reconnect(self, operator: Operator) -> None:
        """Open the closed rig once more, and note what the devices say of themselves; nothing moves."""
        opening = open_tactile_rig(self._rig, self._folder, operator)
        self._keep(**come_back(opening, lambda opened: press_handshakes(opened, self._rig, asked=1)))

    def _tried(self, act: Callable[[], T]) -> T:
        """Return what `act` returns; the stage is stopped and leaves the pad where it ends with an error."""
        self._told.clear()
        if self._presser is None:
            return act()
        with self._presser.standing_by():
            return act()

    def _words(self, error: CaptureError) -> str:
        """Return an error with what the stage did then."""
        return "; ".join([str(error), *(f"the stage {told}" for told in self._told)])

    def _why_it_ends(self, error: CaptureError, section: Section) -> str | None:
        """Return why an error ends all that moves."""
        if isinstance(error, UnsafeError):
            return "the stage was not seen to stop; switch its motors off before anyone touches it"
        if self._told and not self._told[-1].startswith("moved away"):
            return "the stage did not leave the pad by itself; move the indenter off the pad by hand"
        if self._presser is not None and str(error).startswith("load cell"):
            return "the load cell failed, so nothing would stop the stage"
        if isinstance(error, NotAllowedError):
            return "nobody confirmed that the stage may move"
        return None

    def _note(self, event: str, **what: object) -> None:
        """Remember what the stage did after it was stopped."""
        if event == "stage after stop":
            self._told.append(str(what["text"]))


def _require_allowed(opened: OpenTactileRig, question: str) -> None:
    """Ask a person before anything moves.

    Raises
    ------
    NotAllowedError
        The person said no, or nobody is there.
    """
    if not opened.operator.allows(question):
        raise NotAllowedError(
            "stage: nobody has confirmed that it may move; run the check in a terminal, look at the rig, and type yes"
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
    clock, stage, cell = opened.clock, opened.stage, opened.load_cell
    found = [ask(clock, ("camera", rig.camera.driver), opened.camera_there(), lambda: None, asked)]
    if stage is not None and rig.stage is not None:
        found.append(ask(clock, ("stage", rig.stage.driver), stage, stage.places_mm, asked))
    if cell is not None and rig.load_cell is not None:
        read = partial(cell.read, rig.load_cell.silent_s)
        found.append(ask(clock, ("load cell", rig.load_cell.driver), cell, read, asked))
    return tuple(found)


def frame_overheads_s(opened: OpenTactileRig, plan: TactileCheckPlan) -> tuple[float, ...]:
    """Take frames, and return how long each took beyond its exposure (s)."""
    camera, clock, found = opened.camera_there(), opened.clock, []
    for _ in range(HANDSHAKES):
        start_s = clock.monotonic_s()
        camera.expose(plan.exposure_s, plan.exposure_s + CAMERA_DEADLINE_MARGIN_S)
        found.append(max(clock.monotonic_s() - start_s - plan.exposure_s, 0.0))
    return tuple(found)
