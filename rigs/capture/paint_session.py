"""Capture of a paint session: meter, dark frames, every step at every exposure, dark frames again."""

import re
from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import replace
from itertools import groupby
from pathlib import Path

from data_schemas.capture import CaptureSession, Frame, LightState, PaintPlan, Target
from data_schemas.errors import CaptureError
from data_schemas.provenance import provenance
from data_schemas.rig import RigFile
from data_schemas.storage import sha256_of, write_bytes, write_frame, write_record
from rigs.capture.exchange import expose_checked, shine
from rigs.capture.exposure import exposure_ladder, meter_exposure, rung_at_or_below, saturated_fraction
from rigs.capture.journal import Journal
from rigs.capture.laser_dose import LaserDose
from rigs.capture.plan import Step, paint_steps, with_repeat
from rigs.open_rig import OpenRig, open_rig

Progress = Callable[[int, int, str], None]
SESSION_NAME = "session.json"
MANIFEST_NAME = "manifest-sha256.txt"


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
    _require_empty(out)
    with open_rig(rig, rig_folder) as opened:
        return capture_with(opened, rig, plan, steps, out, _provenance_inputs(rig, rig_folder), command, progress)


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
            lamp=opened.lamp_spectrum,
            frames=_Recorder(opened, rig, plan, out, journal, progress).record(steps),
            notes=opened.notes,
        )
        seed = rig.simulated.seed if rig.simulated is not None else None
        write_record(session, out / SESSION_NAME, provenance(command, inputs, seed))
    _write_manifest(out)
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
        self._out, self._journal, self._progress = out, journal, progress
        region = plan.region
        self._region = (
            slice(region.row_px, region.row_px + region.height_px),
            slice(region.column_px, region.column_px + region.width_px),
        )
        self._full_scale_dn = 2**rig.camera.bit_depth - 1
        self._ladder = exposure_ladder(rig.camera.shortest_exposure_s, rig.camera.longest_exposure_s)
        self._dose = LaserDose(rig.laser.power_mw, opened.clock)
        self._tilt_deg = 0.0
        self._metered_s: dict[LightState, float] = {}
        self._frames: list[Frame] = []

    def record(self, steps: tuple[Step, ...]) -> tuple[Frame, ...]:
        """Meter all steps backwards, then store darks, frames (brightest emission again at the end) and darks."""
        exposures_s: dict[Step, list[float]] = {}

        def meter(step: Step) -> None:
            exposures_s[step] = self._bracket(step)
            self._journal.append("step", label=step.label, exposures_s=exposures_s[step])

        def store(step: Step) -> None:
            for exposure_s in exposures_s[step]:
                self._store(step, exposure_s)

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
        return tuple(self._frames)

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
        self._walk((dark,) * len(pending_s), phase, lambda step: self._store(step, next(next_s)))

    def _bracket(self, step: Step) -> list[float]:
        """Meter a step and return the exposures (s) of its bracket, longest first, without repeats."""
        region = self._region if step.light != "room" else (slice(None), slice(None))
        metered_s = meter_exposure(
            lambda exposure_s: expose_checked(self._opened, self._camera, step, exposure_s).raw.counts[region],
            self._ladder,
            self._full_scale_dn,
            self._camera.black_level_dn,
            self._plan.target_fraction,
            step.label,
            self._metered_s.get(step.light),
        )
        self._metered_s[step.light] = metered_s
        rungs_s = {rung_at_or_below(self._ladder, metered_s * factor) for factor in self._plan.bracket}
        return sorted(rungs_s, reverse=True)

    def _store(self, step: Step, exposure_s: float) -> None:
        """Take one frame, write it and note it in the journal."""
        checked = expose_checked(self._opened, self._camera, step, exposure_s)
        number, raw = len(self._frames), checked.raw
        middle_ago_s = 0.5 * raw.exposure_s
        file = f"frames/{_file_name(number, step, raw.exposure_s)}"
        frame = Frame(
            sequence=number,
            file=file,
            frame_type=step.frame_type,
            target=step.target,
            light=step.light,
            filter_name=step.filter_name,
            slot_before=checked.slot_before,
            slot_after=checked.slot_after,
            exposure_requested_s=raw.exposure_requested_s,
            exposure_s=raw.exposure_s,
            captured_utc=raw.captured_utc,
            middle_s=max(self._opened.clock.monotonic_s() - middle_ago_s, 0.0),
            laser_dose_j=self._dose.energy_j(middle_ago_s),
            tilt_deg=step.tilt_deg,
            saturated_fraction=saturated_fraction(raw.counts[self._region], self._full_scale_dn),
            sha256=write_frame(self._out / file, raw.counts, f"{step.label}, {raw.exposure_s:g} s"),
        )
        self._frames.append(frame)
        self._journal.append("frame", **frame.model_dump())


def _file_name(number: int, step: Step, exposure_s: float) -> str:
    """Return ``NNNN_<type>_<filter>_<exposure>us.tiff`` with plain characters only."""
    words = (step.frame_type, step.filter_name or "none")
    kind, filter_name = (re.sub(r"[^A-Za-z0-9.-]+", "-", word) for word in words)
    return f"{number:04d}_{kind}_{filter_name}_{round(exposure_s * 1e6)}us.tiff"


def _require_empty(out: Path) -> None:
    """Refuse a folder that holds something, or a path that is no folder."""
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise CaptureError(
            f"{out}: exists already and is not an empty folder; a capture never overwrites: choose another --out"
        )


def _provenance_inputs(rig: RigFile, rig_folder: Path) -> dict[str, str]:
    """Return the checksums of the curve files that the rig file names."""
    named = [] if rig.camera.response == "assumed" else [rig.camera.response]
    if rig.simulated is not None and rig.simulated.material is not None:
        named.append(rig.simulated.material)
    return {name: sha256_of(rig_folder / name) for name in named}


def _write_manifest(out: Path) -> None:
    """Write the checksums of all files of the session in the format of ``sha256sum --check``."""
    files = sorted(path for path in out.rglob("*") if path.is_file())
    lines = [f"{sha256_of(path)}  {path.relative_to(out).as_posix()}\n" for path in files]
    write_bytes(out / MANIFEST_NAME, "".join(lines).encode())
