"""Capture of a paint session: from plan and rig to a folder with frames, journal, record and checksums.

Meter, prove the filters, dark frames, every step at every exposure, dark frames. What a session will take is found
without moving, lighting or storing anything.
"""

from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, replace
from functools import partial
from itertools import groupby, pairwise
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from data_schemas import (
    BandPassFilter,
    CaptureSession,
    FilterProof,
    LightState,
    PaintPlan,
    RigFile,
    SignalChangedError,
    Target,
    WrongPositionError,
)
from data_schemas.storage import write_manifest
from rigs import OpenRig, RawFrame, open_rig, rig_locked
from rigs.capture._exposure import (
    REPLAY_DRIVER,
    WHEEL_DEADLINE_S,
    exposure_ladder,
    meter_exposure,
    rung_at_or_below,
    shine,
    under_light,
)
from rigs.capture._filter_proof import (
    LaserLine,
    compare_with_last,
    judge_filters,
    predicted_rates,
    signal_floor,
)
from rigs.capture._frame_store import (
    BYTES_PER_PIXEL,
    SAME_SHARE,
    FrameStore,
    Metered,
    Rates,
    Shot,
    checks_in_light,
    colour_notes,
    numbered,
)
from rigs.capture._journal import Journal, fault_notes, faults_noted, healing_s
from rigs.capture._plan import Step, paint_steps, with_repeat
from rigs.capture._resume import (
    AS_BEFORE_EVENT,
    CHANGED_EVENT,
    SET_ASIDE_EVENT,
    Interrupted,
    as_before,
    require_same_inputs,
    resume_notes,
    rig_as_it_is,
    stored_before,
    take_over,
)
from rigs.capture._session_folder import (
    SessionRequest,
    curve_digests,
    curve_files,
    read_frame_of,
    require_empty,
    watched_to_the_end,
    write_session,
    write_start,
)
from rigs.light_guard import LightLostError, is_hazardous, require_outside_layer

T = TypeVar("T")
Mend = Callable[[str], bool]
"""Tells somebody what is to be mended; returns, when it is, whether to go on."""
MOST_REPAIRS = 5

MOST_OLD_FRAMES = 1
"""In a session, delivered as new ones: a second one tells of a camera that is late for good."""
UNPROVEN_NOTE = (
    "no step with lamp or laser gives a good signal at the exposures of this session, so nothing shows that the "
    "camera still exposed as requested during the last dark frames"
)


class PaintRecorder:
    """Walks through the steps of one session and stores the frames."""

    def __init__(
        self,
        opened: OpenRig,
        rig: RigFile,
        plan: PaintPlan,
        store: FrameStore,
        journal: Journal,
        request: SessionRequest,
        interrupted: Interrupted | None,
    ):
        self._opened, self._rig, self._plan = opened, rig, plan
        self._journal, self._progress, self._store, self._watch = journal, request.tell, store, request.watch
        self._out = request.out
        self._ladder = exposure_ladder(rig.camera.shortest_exposure_s, rig.camera.longest_exposure_s)
        # an interrupted session may have left the sample tilted
        left_tilted = interrupted is not None and plan.second_tilt_deg is not None
        self._tilt_deg = None if left_tilted else 0.0
        self._metered_s: dict[LightState, float] = {}
        self._exposures_s: dict[Step, list[float]] = {}
        self._rates: dict[Step, Rates] = {}
        self._white: tuple[Step, ...] = ()
        self._before = {} if interrupted is None else interrupted.metered
        self._in_doubt = interrupted is not None and interrupted.doubt != ""
        self.proof: FilterProof | None = None
        self.notes = opened.notes
        self._healed = 0

    def record(self, steps: tuple[Step, ...], last_good: CaptureSession | None, mend: Mend) -> None:
        """Meter all steps, and store the frames; where somebody mends what changed meanwhile, do both again."""
        if not self._in_doubt:
            self._remember(steps)
        for repair in range(MOST_REPAIRS + 1):
            self._meter_and_prove(steps, last_good, mend)
            if self._in_doubt:
                self._settle(steps)
            try:
                self._store_frames(steps)
            except SignalChangedError as error:
                self._journal.append(CHANGED_EVENT, text=str(error))
                if repair == MOST_REPAIRS or not mend(str(error)):
                    raise
                self._journal.append("repair", text=str(error))
                self._before = {step.label: (self._exposures_s[step], self._rates[step]) for step in steps}
                self._in_doubt = True
                self._forget()
            else:
                return

    def _remember(self, steps: tuple[Step, ...]) -> None:
        """Take over what was metered before."""
        for step in steps:
            if step.label in self._before:
                self._exposures_s[step], self._rates[step] = self._before[step.label]

    def _forget(self) -> None:
        """Have everything metered again."""
        for known in (self._exposures_s, self._rates, self._metered_s):
            known.clear()

    def _settle(self, steps: tuple[Step, ...]) -> None:
        """Keep the stored frames where the mended rig is as it was metered before; else take all of them again.

        A frame contradicted its metering, and either may have been taken under the fault. What the rig gives now
        decides: frames stay only where metering before the repair and every lit frame agree with it.
        """
        self._store.take_back()
        unlike = self._unlike_before(steps)
        if unlike is None:
            self._remember(steps)
            agree = f"agree within {100 * SAME_SHARE:.0f} % with those of the repaired rig"
            text = f"the meterings and frames from before the repair {agree}"
            self._journal.append(AS_BEFORE_EVENT, frames=len(self._store.frames), text=text)
        else:
            self._set_aside(unlike)
        self._in_doubt = False

    def _set_aside(self, why: str) -> None:
        """Note that the frames so far do not count, then move them out of the way; none is used again."""
        self._journal.append(SET_ASIDE_EVENT, frames=len(self._store.frames), text=why)
        count, self._healed = self._store.set_aside(), 0
        self._tell(f"{count} frames from before the repair are set aside and taken again: {why}")

    def _unlike_before(self, steps: tuple[Step, ...]) -> str | None:
        """Return what was metered or stored before and is not what the rig gives now; None where all is."""
        lit = [step for step in steps if step.light in ("lamp", "laser")]
        for step in (step for step in lit if step.label in self._before):  # none where all was set aside
            exposures_s, before = self._before[step.label]
            if not self._store.are_same(self._rates[step], before, exposures_s[0]):
                return f"{step.label} gave a different signal before the repair"
            now, old = self._metered(step), Metered(before, exposures_s[0] / max(self._plan.bracket))
            if self._store.other_colour(step, now, old) is not None:  # or its frames would be refused for ever
                return f"{step.label} showed a different colour before the repair"
        places = {(step.frame_type, step.filter_name, step.tilt_deg): step for step in lit}
        for frame in self._store.frames:
            kind = "fluorescence" if frame.frame_type == "fluorescence repeat" else frame.frame_type
            place = places.get((kind, frame.filter_name, frame.tilt_deg))
            if place is None:
                continue
            stored = self._store.rates(read_frame_of(self._out, frame), frame.exposure_s)
            if not self._store.are_same(self._rates[place], stored, frame.exposure_s):
                return f"{frame.file} does not agree with {place.label} after the repair"
        return None

    def _store_frames(self, steps: tuple[Step, ...]) -> None:
        """Store darks, frames (brightest emission again at the end) and darks."""
        longest_s = {step: self._exposures_s[step][0] for step in steps}
        steps = with_repeat(steps, self._plan.excitation_filter, longest_s)
        for step in steps:
            if step.frame_type == "fluorescence repeat":
                once = replace(step, frame_type="fluorescence")
                self._exposures_s[step], self._rates[step] = self._exposures_s[once], self._rates[once]
        used_s = sorted({exposure_s for step in steps for exposure_s in self._exposures_s[step]})
        lit = [(step, exposure_s) for step in steps for exposure_s in self._exposures_s[step]]
        before, after = self._darks(steps[0], used_s), self._darks(steps[-1], used_s)
        missing = self._store.missing(numbered([*before, *lit, *after]))
        self._watch.expects([(shot.step.filter_name, shot.exposure_s) for shot in missing])
        for phase, first, last in (
            ("dark frames before", 0, len(before)),
            ("frames", len(before), len(before) + len(lit)),
            ("dark frames after", len(before) + len(lit), len(before) + len(lit) + len(after)),
        ):
            shots = [shot for shot in missing if first <= shot.sequence < last]
            self._walk([(shot.step, shot) for shot in shots], phase, self._take)
        if self._store.has_unproven and self._rig.camera.driver != REPLAY_DRIVER:
            self._prove_in_light(
                missing, checks_in_light(self._rates, steps[-1], self._rates, used_s, self._store.full_scale_dn)
            )

    def _prove_in_light(self, missing: Sequence[Shot], checks: Sequence[tuple[Step, float]]) -> None:
        """See by lit frames that are not stored whether the camera was as metered in the dark; once more where not.

        No frame in the dark tells that it was exposed for half of the time that was asked for.
        """
        if not checks:
            self.notes = (*self.notes, UNPROVEN_NOTE)
            return
        told: list[str] = []

        def look(check: tuple[Step, float]) -> None:
            try:
                self._require_as_metered(check[0], self._store.camera.expose(*check).raw)
            except SignalChangedError as error:
                told.append(str(error))

        for is_last in (False, True):
            told.clear()
            self._walk([(check[0], check) for check in checks], "check of the dark frames in light", look)
            if not told:
                self._store.prove()
                return
            again = self._store.take_back()
            self._journal.append("refused", text=f"{told[0]}; {len(again)} dark frames before it are not used")
            if is_last:
                raise SignalChangedError(f"{told[0]}; the dark frames taken before are not used")
            self._walk([(s.step, s) for s in missing if s.sequence in again], "dark frames once more", self._take)

    def _meter_and_prove(self, steps: tuple[Step, ...], last_good: CaptureSession | None, mend: Mend) -> None:
        """Meter and prove the filters; where somebody mends what the frames contradict, do both again."""
        for repair in range(MOST_REPAIRS + 1):
            self._walk([(s, s) for s in steps[::-1] if s not in self._exposures_s], "metering", self._meter)
            try:
                self._prove(steps, last_good)
            except WrongPositionError as error:
                if repair == MOST_REPAIRS or not mend(str(error)):
                    raise
                self._journal.append("repair", text=str(error))
                if self._store.frames:
                    self._set_aside("they were taken before the filters were corrected")
                self._in_doubt = False
                self._forget()
            else:
                return

    def white_rates(self) -> tuple[tuple[float, float, float], ...]:
        """Return the rates of the white tile behind each filter in the order of the plan, DN/s."""
        return tuple(self._rates[step] for step in self._white)

    def _walk(self, todo: Iterable[tuple[Step, T]], phase: str, act: Callable[[T], None]) -> None:
        """Do `act` at every step with its target in place and its light on; light off between groups."""
        todo = list(todo)
        done = 0

        def once(step: Step, what: T) -> None:
            nonlocal done
            act(what)
            done += 1
            self._progress(done, len(todo), f"{phase}: {step.label}")

        for (target, light, tilt_deg, by_hand), group in groupby(todo, key=lambda t: self._setting(t[0])):
            self._place(target, tilt_deg)
            if by_hand is not None and self._opened.wheel.position() != by_hand:
                self._opened.wheel.go_to(by_hand, WHEEL_DEADLINE_S)
            lit = partial(self._laser_noted, target) if light == "laser" else nullcontext
            tasks: deque[Callable[[], None]] = deque(partial(once, step, what) for step, what in group)
            must_ask = light == "laser" and is_hazardous(self._rig.laser)
            under_light(self._opened, light, tasks, self._tell_fault, lit, must_ask)

    @contextmanager
    def _laser_noted(self, target: Target) -> Iterator[None]:
        """Note in the journal that the laser goes on and off, and count its dose on the sample."""
        dose = self._store.dose
        # The dose begins with the command, and holds the test of a dead-man too.
        try:
            with dose.shining() if target == "sample" else nullcontext():
                self._journal.append("laser on", target=target, sample_dose_j=dose.energy_j())
                yield
        except LightLostError:  # its light fell on the sample until then
            self._journal.append("laser off", target=target, sample_dose_j=dose.energy_j())
            raise
        self._journal.append("laser off", target=target, sample_dose_j=dose.energy_j())

    def _tell_fault(self, text: str) -> None:
        """Note a light that was lost, and warn whoever is at the rig."""
        self._journal.append("light lost", text=text)
        self._tell(text)

    def _tell(self, text: str) -> None:
        """Tell whoever is at the rig."""
        self._progress(0, 1, text)

    def _setting(self, step: Step) -> tuple[Target, LightState, float, int | None]:
        """Return what stays while a light is on; a wheel turned by hand is turned in the dark."""
        by_hand = step.slot if self._rig.filter_wheel.driver == "manual" else None
        return step.target, step.light, step.tilt_deg, by_hand

    def _place(self, target: Target, tilt_deg: float) -> None:
        """Ask the operator for a target and, when it changes, for the tilt of the sample."""
        self._opened.operator.place(target)
        if tilt_deg != self._tilt_deg:
            self._opened.operator.tilt(tilt_deg)
            self._tilt_deg = tilt_deg

    def _darks(self, beside: Step, exposures_s: list[float]) -> list[tuple[Step, float]]:
        """Return half of the dark frames (rounded up) of every exposure with the box as it is at the step `beside`."""
        each = (self._plan.darks_per_exposure + 1) // 2
        dark = replace(beside, frame_type="dark", light="off", filter_name=None)
        return [(dark, exposure_s) for exposure_s in exposures_s for _ in range(each)]

    def _meter(self, step: Step) -> None:
        """Find the exposures (s) of a step's bracket, longest first, without repeats."""
        region = self._store.region if step.light != "room" else (slice(None), slice(None))
        rates: dict[float, Rates] = {}

        def take(exposure_s: float) -> NDArray[np.uint16]:
            raw = self._store.camera.expose(step, exposure_s).raw
            rates[exposure_s] = self._store.rates(raw.counts, raw.exposure_s)
            return raw.counts[region]

        metered_s = meter_exposure(
            take,
            self._ladder,
            self._store.full_scale_dn,
            self._rig.camera.black_level_dn,
            self._plan.target_fraction,
            step.label,
            self._metered_s.get(step.light),
            self._tell,
        )
        self._metered_s[step.light] = metered_s
        rungs_s = {rung_at_or_below(self._ladder, metered_s * factor) for factor in self._plan.bracket}
        self._exposures_s[step], self._rates[step] = sorted(rungs_s, reverse=True), rates[metered_s]
        self._journal.append(
            "step", label=step.label, exposures_s=self._exposures_s[step], rates_dn_per_s=rates[metered_s]
        )

    def _take(self, shot: Shot) -> None:
        """Take a frame and store it when its signal is that of its step's metering; one more where it is not.

        A camera may deliver an earlier frame as a new one. One that does so again is late for good, also by frames in
        the dark that nothing tells: none so far counts. In the dark, light that stays may leak in, and is stored.
        """
        try:
            self._store.take(shot, lambda raw: self._require_as_metered(shot.step, raw))
        except SignalChangedError as error:
            self._journal.append("refused", text=f"{error}; another frame was taken")
            leaks = self._take_again(shot)
            self._healed += not leaks
            if self._healed <= MOST_OLD_FRAMES:
                return
            self._set_aside("twice a frame differed from its metering and the next frame did not")
            raise SignalChangedError(
                f"{error}; the next frame agreed with the metering. This has now happened twice, so the camera "
                "delivers earlier frames as new ones, or the light flickers; restart the camera, check the light, "
                "then resume"
            ) from error

    def _take_again(self, shot: Shot) -> bool:
        """Take a frame once more, and return whether it shows light in the dark again."""
        if shot.step.light != "off":
            self._store.take(shot, lambda raw: self._require_as_metered(shot.step, raw))
            return False
        leaks: list[bool] = []

        def look(raw: RawFrame) -> None:
            leaks.append(
                max(self._store.rates(raw.counts, raw.exposure_s)) > self._store.visible_dn_per_s(raw.exposure_s)
            )

        self._store.take(shot, look)
        return leaks[-1]

    def _require_as_metered(self, step: Step, raw: RawFrame) -> None:
        """Refuse a frame whose signal is not that of its step's metering."""
        if step.light == "off":
            self._store.require_as_metered(step, raw, None)
        elif step.light != "room":
            metered = self._metered(step)
            self._store.require_as_metered(step, raw, metered)
            self._store.require_same_colour(step, raw, metered)

    def _metered(self, step: Step) -> Metered:
        """Return what the metering of a step found."""
        return Metered(self._rates[step], self._exposures_s[step][0] / max(self._plan.bracket))

    def _prove(self, steps: tuple[Step, ...], last_good: CaptureSession | None) -> None:
        """Judge from the metered rates whether the wheel holds the filters that the rig file names."""
        self._white = tuple(step for step in steps if step.frame_type == "white")
        known = {f.name: f for f in self._rig.filter_wheel.filters}
        filters = [known[str(step.filter_name)] for step in self._white]
        line = self._laser_line(steps, filters)
        self.proof = self._judge_by_lamp(filters, line)
        if self.proof.verdict != "contradicted":
            under_laser = {str(s.filter_name): s for s in steps if s.frame_type == "fluorescence"}
            shown = line.judge(lambda name: self._rates_in_the_dark(under_laser[name]))
            verdict = shown.verdict if shown.verdict == "contradicted" else self.proof.verdict
            self.proof = FilterProof(verdict=verdict, text=f"{self.proof.text}; {shown.text}")
        if last_good is not None and self.proof.verdict != "contradicted":
            names, measured = [f.name for f in filters], np.array(self.white_rates())
            repeated = compare_with_last(names, measured, last_good, self._floor(self._white))
            if repeated.verdict == "cannot tell":
                repeated = FilterProof(verdict=self.proof.verdict, text=f"{self.proof.text}; {repeated.text}")
            self.proof = repeated
        self._journal.append("filter proof", verdict=self.proof.verdict, text=self.proof.text)
        if self.proof.verdict == "contradicted":
            raise WrongPositionError(f"filter wheel: {self.proof.text}")

    def _judge_by_lamp(self, filters: Sequence[BandPassFilter], line: LaserLine) -> FilterProof:
        """Judge from the rates of the white tile; before a conviction the dark level behind each filter is measured."""
        opened, measured, names = self._opened, np.array(self.white_rates()), [f.name for f in filters]
        predicted = predicted_rates(filters, opened.filter_curves, opened.lamp_spectrum, opened.camera_response)
        excitation = self._plan.excitation_filter
        apart = [frozenset((excitation, other)) for other in line.not_exchanged()]

        def judged(rates: NDArray[np.float64], floor: NDArray[np.float64]) -> FilterProof:
            lit = dict(zip(names, self._white, strict=True))
            return judge_filters(names, rates, predicted, lambda n: self._rates_in_the_dark(lit[n]), apart, floor)

        proof = judged(measured, self._floor(self._white))
        if proof.verdict != "contradicted":
            return proof
        # A wrong black level in the rig file colours every dim filter.
        pairs = np.array([[self._rates_in_the_dark(step) for step in self._white] for _ in range(2)])
        uncertainty_dn_per_s = np.abs(pairs[0] - pairs[1]).max(axis=1) / np.sqrt(2.0)
        return judged(measured - pairs.mean(axis=0), self._floor(self._white, uncertainty_dn_per_s))

    def _laser_line(self, steps: tuple[Step, ...], filters: Sequence[BandPassFilter]) -> LaserLine:
        """Return what the metered rates under the laser say, in the order of the filters."""
        lit = {(s.frame_type, s.filter_name): s for s in steps if s.light == "laser"}
        rates = {key: self._rates[step] for key, step in lit.items()}
        excitation = self._plan.excitation_filter
        return LaserLine(
            filters,
            excitation,
            self._rig.laser.wavelength_nm,
            self._opened.filter_curves,
            self._opened.camera_response,
            rates["laser white", excitation],
            [rates["fluorescence", f.name] for f in filters],
            float(self._floor([lit["laser white", excitation]])[0]),
            self._floor([lit["fluorescence", f.name] for f in filters]),
        )

    def _floor(
        self, steps: Sequence[Step], uncertainty_dn_per_s: NDArray[np.float64] | float = 0.0
    ) -> NDArray[np.float64]:
        """Return the rates above which the light of metered steps is a signal (DN/s)."""
        exposures_s = [self._exposures_s[step][0] for step in steps]
        return signal_floor(exposures_s, self._store.full_scale_dn, uncertainty_dn_per_s)

    def _rates_in_the_dark(self, lit: Step) -> Rates:
        """Return the rates of a step with its light off (DN/s)."""
        self._place(lit.target, lit.tilt_deg)
        dark, exposure_s = replace(lit, frame_type="dark", light="off"), self._exposures_s[lit][0]
        with shine(self._opened, "off"):
            raw = self._store.camera.expose(dark, exposure_s).raw
        return self._store.rates(raw.counts, raw.exposure_s)


def capture_paint_session(
    rig: RigFile,
    plan: PaintPlan,
    request: SessionRequest,
    *,
    interrupted: Interrupted | None = None,
    last_good: CaptureSession | None = None,
    mend: Mend = lambda text: False,
) -> CaptureSession:
    """Capture a paint session into a folder: frames, journal, ``session.json`` and checksums.

    Metering frames are not stored. Half of ``plan.darks_per_exposure`` (rounded up) is taken before and as many
    after the other frames, for every exposure that they use.

    Parameters
    ----------
    rig, plan
        The rig and what to capture on it.
    request
        Where the session goes, who is at the rig, and what its record says of both.
    interrupted
        What is done already, when a session is resumed.
    last_good
        An earlier session on this rig whose white frames these must resemble.
    mend
        Called with a text when the frames contradict the filters or their metering; True goes on with metering and
        proofs taken again. Nobody mends anything when left out.

    Raises
    ------
    CaptureError
        The plan does not fit the rig, the folder is not empty, a device did not do what was asked, or the frames
        contradict the wheel.
    RefusedError
        The laser is of class 3R or above, and nothing outside the computer switches it off.
    SaturatedError
        A step is too bright at the camera's shortest exposure.
    """
    require_outside_layer(rig.laser)
    steps = paint_steps(plan, rig)
    curve_files(rig, request.rig_folder)
    if interrupted is None:
        require_empty(request.out)
    begun_with = request.sources if interrupted is None else interrupted.sources
    present, sources = rig_as_it_is(rig, request.rig_folder, begun_with)
    request = replace(request, sources=sources)
    with (
        rig_locked(rig),
        open_rig(present, request.rig_folder, request.operator) as opened,
        watched_to_the_end(request.watch),
    ):

        def mended(text: str) -> bool:
            if not mend(text):
                return False
            bench, read = rig_as_it_is(rig, request.rig_folder, sources)
            sources.update(read)
            opened.practise(None if bench.simulated is None else bench.simulated.fault)
            return True

        return capture_with(
            opened, rig, plan, steps, request, interrupted=interrupted, last_good=last_good, mend=mended
        )


def capture_with(
    opened: OpenRig,
    rig: RigFile,
    plan: PaintPlan,
    steps: tuple[Step, ...],
    request: SessionRequest,
    *,
    interrupted: Interrupted | None = None,
    last_good: CaptureSession | None = None,
    mend: Mend = lambda text: False,
) -> CaptureSession:
    """Capture the `steps` of a paint session with devices that are open already."""
    inputs = curve_digests(curve_files(rig, request.rig_folder), request.rig_folder)
    opened, out = request.watch.devices(opened), request.out
    devices = opened.identities()
    if interrupted is not None:
        require_same_inputs(interrupted, inputs)
        opened = as_before(opened, rig, devices, interrupted)
    out.mkdir(parents=True, exist_ok=True)
    with Journal(out, opened.clock, resumed=interrupted is not None, told=request.watch.noted) as journal:
        if interrupted is None:
            write_start(journal, plan, rig, request, inputs, devices)
        else:
            _go_on(journal, out, interrupted)
        for note in opened.notes:
            journal.append("note", text=note)
        recorded = FrameStore(opened, rig, plan.region, out, journal, interrupted, request.watch)
        with faults_noted(journal, out, forecast(plan, rig, steps).healing_s), recorded as store:
            recorder = PaintRecorder(opened, rig, plan, store, journal, request, interrupted)
            recorder.record(steps, last_good, mend)
        session = CaptureSession(
            plan=plan,
            rig=rig,
            camera_response=opened.camera_response,
            filter_curves=dict(opened.filter_curves),
            lamp=opened.lamp_spectrum,
            frames=store.frames,
            devices=opened.identities(),
            filter_proof=recorder.proof,
            white_rates_dn_per_s=recorder.white_rates(),
            notes=(*recorder.notes, *colour_notes(store.frames), *resume_notes(out), *fault_notes(out)),
        )
        noted = dict(request.sources) or ({} if interrupted is None else interrupted.sources)
        write_session(session, out, {**noted, **inputs}, request.command, journal)
    write_manifest(out)
    return session


def _go_on(journal: Journal, out: Path, interrupted: Interrupted) -> None:
    """Take over the folder of an interrupted session, and note it in its journal."""
    take_over(out, interrupted)
    journal.append("resume", **stored_before(interrupted), sample_dose_j=interrupted.dose_j)


WHEEL_MOVE_S = 1.0  # to a neighbouring slot: the slowest of the usual wheels
METERING_FRAMES = 4  # a step, typically
CHECKS_IN_LIGHT = 2
LIT_SESSION_EXPOSURE_S = 0.5  # typical mean exposure; what it really is only metering tells


@dataclass(frozen=True, slots=True)
class Forecast:
    """What a session will take.

    Attributes
    ----------
    steps, most_frames
        Steps, and frames if every step needs other exposures than the rest.
    targets
        How often the operator is asked for another target.
    moves
        Moves of the wheel.
    disk_bytes
        Space on disk for `most_frames`.
    typical_s, longest_s
        Duration with typical exposures, and if every frame took the camera's longest (s); operator not counted.
    healing_s
        How long faults may hold it up besides (s); more ends it, to be resumed.
    """

    steps: int
    most_frames: int
    targets: int
    moves: int
    disk_bytes: int
    typical_s: float
    longest_s: float
    healing_s: float


def forecast(plan: PaintPlan, rig: RigFile, steps: Sequence[Step]) -> Forecast:
    """Return what a paint session of these steps will take.

    Parameters
    ----------
    plan, rig
        The plan and the rig that `steps` were listed for.
    steps
        Steps of the session.
    """
    rungs = len(exposure_ladder(rig.camera.shortest_exposure_s, rig.camera.longest_exposure_s))
    lit = (len(steps) + 1) * len(plan.bracket)
    darks = 2 * ((plan.darks_per_exposure + 1) // 2) * min(rungs, lit)
    moves = 2 * sum(a.slot != b.slot for a, b in pairwise(steps))
    frames, metering = lit + darks, METERING_FRAMES * len(steps) + CHECKS_IN_LIGHT
    typical_s = moves * WHEEL_MOVE_S + (frames + metering) * LIT_SESSION_EXPOSURE_S
    return Forecast(
        steps=len(steps),
        most_frames=frames,
        targets=2 * len(list(groupby(steps, key=lambda step: step.target))) - 1,
        moves=moves,
        disk_bytes=BYTES_PER_PIXEL * rig.camera.width_px * rig.camera.height_px * frames,
        typical_s=typical_s,
        longest_s=moves * WHEEL_MOVE_S + (frames + metering) * rig.camera.longest_exposure_s,
        healing_s=healing_s(typical_s),
    )
