"""Capture of a paint session: meter, dark frames, every step at every exposure, dark frames again."""

from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import replace
from itertools import groupby
from pathlib import Path

from data_schemas.capture import CaptureSession, Frame, LightState, PaintPlan, Target
from data_schemas.rig import RigFile
from rigs.capture.exchange import expose_checked, shine
from rigs.capture.exposure import exposure_ladder, meter_exposure, rung_at_or_below
from rigs.capture.frame_store import FrameStore
from rigs.capture.journal import Journal
from rigs.capture.plan import Step, paint_steps, with_repeat
from rigs.capture.session_folder import curve_files, require_empty, write_manifest, write_session
from rigs.open_rig import OpenRig, open_rig

Progress = Callable[[int, int, str], None]


def capture_paint_session(
    rig: RigFile,
    plan: PaintPlan,
    rig_folder: Path,
    out: Path,
    command: str,
    progress: Progress | None = None,
) -> CaptureSession:
    """Capture a paint session into the folder `out`: frames, journal, ``session.json`` and checksums.

    Metering frames are not stored. Half of ``plan.darks_per_exposure`` (rounded up) is taken before and as many
    after the other frames, for every exposure that they use.

    Parameters
    ----------
    rig, plan
        The rig and what to capture on it.
    rig_folder
        Where relative paths in the rig file start.
    out
        New or empty folder.
    command
        The command line that reproduces the session.
    progress
        Called with (done, total, text) after every metered step and every frame; it counts within the phase
        that the text names.

    Raises
    ------
    CaptureError
        The plan does not fit the rig, the folder is not empty, or a device did not do what was asked.
    SaturatedError
        A step is too bright at the camera's shortest exposure.
    """
    steps = paint_steps(plan, rig)
    require_empty(out)
    with open_rig(rig, rig_folder) as opened:
        return capture_with(opened, rig, plan, steps, out, curve_files(rig, rig_folder), command, progress)


def capture_with(
    opened: OpenRig,
    rig: RigFile,
    plan: PaintPlan,
    steps: tuple[Step, ...],
    out: Path,
    inputs: dict[str, str],
    command: str,
    progress: Progress | None = None,
) -> CaptureSession:
    """Capture the `steps` of a paint session with devices that are open already."""
    out.mkdir(parents=True, exist_ok=True)
    with Journal(out, opened.clock) as journal:
        journal.append("start", command=command, rig=rig.name, paint=plan.paint_name, steps=len(steps))
        for note in opened.notes:
            journal.append("note", text=note)
        session = CaptureSession(
            plan=plan,
            rig=rig,
            camera_response=opened.camera_response,
            filter_curves=dict(opened.filter_curves),
            lamp=opened.lamp_spectrum,
            frames=_Recorder(opened, rig, plan, out, journal, progress).record(steps),
            notes=opened.notes,
        )
        write_session(session, out, inputs, command)
    write_manifest(out)
    return session


class _Recorder:
    """Walks through the steps of one session and stores the frames."""

    def __init__(
        self,
        opened: OpenRig,
        rig: RigFile,
        plan: PaintPlan,
        out: Path,
        journal: Journal,
        progress: Progress | None,
    ):
        self._opened, self._camera, self._plan = opened, rig.camera, plan
        self._journal, self._progress = journal, progress
        self._store = FrameStore(opened, rig, plan.region, out, journal)
        self._dose = self._store.dose
        self._ladder = exposure_ladder(rig.camera.shortest_exposure_s, rig.camera.longest_exposure_s)
        self._tilt_deg = 0.0
        self._metered_s: dict[LightState, float] = {}

    def record(self, steps: tuple[Step, ...]) -> tuple[Frame, ...]:
        """Meter all steps backwards, then store darks, frames (brightest emission again at the end) and darks."""
        exposures_s: dict[Step, list[float]] = {}

        def meter(step: Step) -> None:
            exposures_s[step] = self._bracket(step)
            self._journal.append("step", label=step.label, exposures_s=exposures_s[step])

        def store(step: Step) -> None:
            for exposure_s in exposures_s[step]:
                self._store.take(step, exposure_s)

        self._walk(steps[::-1], "metering", meter)
        longest_s = {step: bracket[0] for step, bracket in exposures_s.items()}
        steps = with_repeat(steps, self._plan.excitation_filter, longest_s)
        for step in steps:
            if step.frame_type == "fluorescence repeat":
                exposures_s[step] = exposures_s[replace(step, frame_type="fluorescence")]
        used_s = sorted({exposure_s for bracket in exposures_s.values() for exposure_s in bracket})
        self._darks(steps[0], used_s, "dark frames before")
        self._walk(steps, "frames", store)
        self._darks(steps[-1], used_s, "dark frames after")
        return tuple(self._store.frames)

    def _walk(self, steps: tuple[Step, ...], phase: str, act: Callable[[Step], None]) -> None:
        """Do `act` at every step with its target in place and its light on; light off between groups."""
        done = 0
        for (target, light, tilt_deg), group in groupby(steps, key=lambda s: (s.target, s.light, s.tilt_deg)):
            self._place(target, tilt_deg)
            on_sample = light == "laser" and target == "sample"
            with shine(self._opened, light), self._dose.shining() if on_sample else nullcontext():
                if light == "laser":
                    self._journal.append("laser on", target=target, sample_dose_j=self._dose.energy_j())
                for step in group:
                    act(step)
                    done += 1
                    if self._progress is not None:
                        self._progress(done, len(steps), f"{phase}: {step.label}")
            if light == "laser":
                self._journal.append("laser off", target=target, sample_dose_j=self._dose.energy_j())

    def _place(self, target: Target, tilt_deg: float) -> None:
        """Ask the operator for a target and, when it changes, for the tilt of the sample."""
        self._opened.operator.place(target)
        if tilt_deg != self._tilt_deg:
            self._opened.operator.tilt(tilt_deg)
            self._tilt_deg = tilt_deg

    def _darks(self, beside: Step, exposures_s: list[float], phase: str) -> None:
        """Store half of the dark frames (rounded up) of every exposure with the box as it is at the step `beside`."""
        each = (self._plan.darks_per_exposure + 1) // 2
        dark = replace(beside, frame_type="dark", light="off", filter_name=None)
        pending_s = [exposure_s for exposure_s in exposures_s for _ in range(each)]
        next_s = iter(pending_s)
        self._walk((dark,) * len(pending_s), phase, lambda step: self._store.take(step, next(next_s)))

    def _bracket(self, step: Step) -> list[float]:
        """Meter a step and return the exposures (s) of its bracket, longest first, without repeats."""
        region = self._store.region if step.light != "room" else (slice(None), slice(None))
        metered_s = meter_exposure(
            lambda exposure_s: expose_checked(self._opened, self._camera, step, exposure_s).raw.counts[region],
            self._ladder,
            self._store.full_scale_dn,
            self._camera.black_level_dn,
            self._plan.target_fraction,
            step.label,
            self._metered_s.get(step.light),
        )
        self._metered_s[step.light] = metered_s
        rungs_s = {rung_at_or_below(self._ladder, metered_s * factor) for factor in self._plan.bracket}
        return sorted(rungs_s, reverse=True)
