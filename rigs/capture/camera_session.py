"""Capture of a camera session: flat frames up and down through the exposures, then dark frames of the same."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from data_schemas.camera import CameraPlan, CameraSession
from data_schemas.capture import RegionOfInterest
from data_schemas.errors import CaptureError
from data_schemas.folder_manifest import write_manifest
from data_schemas.rig import RigFile
from rigs.capture.camera_levels import level_exposures_s, level_notes, saturation_exposures_s
from rigs.capture.exchange import shine
from rigs.capture.exposure import exposure_ladder, meter_exposure
from rigs.capture.frame_store import FrameStore, Shot, numbered
from rigs.capture.journal import Journal
from rigs.capture.plan import Step, require_region_inside
from rigs.capture.resume import Interrupted, resume_notes, take_over
from rigs.capture.rig_lock import rig_locked
from rigs.capture.same_as_begun import require_same_camera, require_same_inputs
from rigs.capture.session_folder import curve_digests, curve_files, require_empty, write_session, write_start
from rigs.open_rig import OpenRig, open_rig
from rigs.protocols import Operator

Progress = Callable[[int, int, str], None]
METERED_FRACTION = 0.7


def camera_step(plan: CameraPlan, rig: RigFile) -> Step:
    """Return the flat step of a plan after checking the plan against the rig.

    Raises
    ------
    CaptureError
        The rig has no such filter, or the region is empty or leaves the frame.
    """
    require_region_inside(plan.region, rig.camera)
    slots = {f.name: f.slot for f in rig.filter_wheel.filters}
    if plan.filter_name is not None and plan.filter_name not in slots:
        raise CaptureError(
            f"plan.filter_name: the rig has no filter '{plan.filter_name}'; its filters are {', '.join(slots)}"
        )
    slot = None if plan.filter_name is None else slots[plan.filter_name]
    return Step("white", "white", "lamp", plan.filter_name, slot)


def capture_camera_session(
    rig: RigFile,
    plan: CameraPlan,
    rig_folder: Path,
    out: Path,
    command: str,
    progress: Progress | None = None,
    *,
    operator: Operator | None = None,
    interrupted: Interrupted | None = None,
    sources: Mapping[str, str] | None = None,
) -> CameraSession:
    """Capture a camera session into the folder `out`: frames, journal, ``session.json`` and checksums.

    Parameters
    ----------
    rig, plan
        The rig and what to capture on it.
    rig_folder
        Where relative paths in the rig file start.
    out
        New or empty folder, or that of the interrupted session.
    command
        The command line that reproduces the session.
    progress
        Called with (done, total, text) after every frame; it counts within the phase that the text names.
    operator
        Who places the white tile; a person at the terminal when left out.
    interrupted
        What is done already, when a session is resumed.
    sources
        Path -> SHA-256 of the files that plan and rig were read from, for the provenance.

    Raises
    ------
    CaptureError
        The plan does not fit the rig, the folder is not empty, the light is too bright or too dim for the exposures
        of the camera, or a device did not do what was asked.
    SaturatedError
        The white tile is too bright at the camera's shortest exposure.
    """
    step, curves = camera_step(plan, rig), curve_files(rig, rig_folder)
    if interrupted is None:
        require_empty(out)
    with rig_locked(rig), open_rig(rig, rig_folder, operator) as opened:
        inputs = curve_digests(curves, rig_folder)
        if interrupted is not None:
            require_same_inputs(interrupted, inputs)
        return capture_camera_with(
            opened, rig, plan, step, out, inputs, command, progress, interrupted, rig_folder, sources
        )


def capture_camera_with(
    opened: OpenRig,
    rig: RigFile,
    plan: CameraPlan,
    step: Step,
    out: Path,
    inputs: dict[str, str],
    command: str,
    progress: Progress | None = None,
    interrupted: Interrupted | None = None,
    rig_folder: Path = Path(),
    sources: Mapping[str, str] | None = None,
) -> CameraSession:
    """Capture a camera session with devices that are open already."""
    out.mkdir(parents=True, exist_ok=True)
    camera = opened.camera.identity()
    if interrupted is not None:
        require_same_camera(interrupted, camera)
        opened = replace(opened, clock=interrupted.clock_after(opened.clock))
    whole_cells = RegionOfInterest.model_validate({k: v & ~1 for k, v in plan.region.model_dump().items()})
    with Journal(out, opened.clock, resumed=interrupted is not None) as journal:
        if interrupted is None:
            write_start(journal, plan, rig, rig_folder, inputs, command, camera, sources)
        else:
            take_over(out, interrupted)
            journal.append("resume", frames=len(interrupted.frames))
        with FrameStore(opened, rig, whole_cells, out, journal, interrupted) as store:
            recorder = _Recorder(opened, rig, plan, step, store, journal, progress)
            recorder.record(None if interrupted is None else interrupted.levels)
        notes = (*opened.notes, *recorder.notes, *resume_notes(interrupted))
        for note in notes:
            journal.append("note", text=note)
        session = CameraSession(plan=plan, rig=rig, frames=store.frames, devices=opened.identities(), notes=notes)
        noted = dict(sources or {}) if interrupted is None else interrupted.sources
        write_session(session, out, {**noted, **inputs}, command, journal)
    write_manifest(out)
    return session


class _Recorder:
    """Takes and stores the frames of one session."""

    def __init__(
        self,
        opened: OpenRig,
        rig: RigFile,
        plan: CameraPlan,
        flat: Step,
        store: FrameStore,
        journal: Journal,
        progress: Progress | None,
    ):
        self._opened, self._camera, self._plan, self._flat = opened, rig.camera, plan, flat
        self._store, self._journal, self._progress = store, journal, progress
        self.notes: tuple[str, ...] = ()

    def record(self, levels: Mapping[str, Any] | None) -> None:
        """Meter, store the flat frames with the lamp on throughout, then the dark frames.

        Parameters
        ----------
        levels
            What the interrupted part of a resumed session found by metering; None to meter.
        """
        self._opened.operator.place("white")
        if self._flat.slot is None:
            self._opened.operator.swing_wheel_out()
        with shine(self._opened, "lamp"):
            if levels is None:
                levels = self._meter()
                self._journal.append("levels", **levels)
            self.notes = tuple(levels["notes"])
            flats = numbered((self._flat, t) for t in levels["flats_s"])
            self._take_all(flats, "flat frames")
        dark = replace(self._flat, frame_type="dark", light="off")
        darks = numbered(((dark, t) for t in (*levels["flats_s"], *levels["extra_darks_s"])), first=len(flats))
        with shine(self._opened, "off"):
            self._take_all(darks, "dark frames")

    def _meter(self) -> dict[str, Any]:
        """Return the exposures (s) of the flat frames, those of further dark frames, and what the user should know."""
        metered_s = meter_exposure(
            lambda exposure_s: self._store.camera.expose(self._flat, exposure_s).raw.counts[self._store.region],
            exposure_ladder(self._camera.shortest_exposure_s, self._camera.longest_exposure_s),
            self._store.full_scale_dn,
            self._camera.black_level_dn,
            METERED_FRACTION,
            self._flat.label,
        )
        raw = self._store.camera.expose(self._flat, metered_s).raw
        saturation_s = saturation_exposures_s(raw.counts[self._store.region], raw.exposure_s, self._camera)
        levels_s = level_exposures_s(saturation_s, self._plan, self._camera)
        half_s = min(levels_s, key=lambda t: abs(t - 0.5 * min(saturation_s.values())))
        longest_s = min(self._plan.longest_exposure_s, self._camera.longest_exposure_s)
        return {
            "flats_s": [*_up_and_down(levels_s, self._plan.frames_per_level), *[half_s] * self._plan.repeats],
            "extra_darks_s": [longest_s] * (self._plan.frames_per_level if longest_s not in levels_s else 0),
            "notes": level_notes(saturation_s, self._plan, self._camera),
        }

    def _take_all(self, shots: list[Shot], phase: str) -> None:
        """Store the frames that are still missing."""
        missing = self._store.missing(shots)
        for done, shot in enumerate(missing, 1):
            self._store.take(shot)
            if self._progress is not None:
                self._progress(done, len(missing), f"{phase}: {shot.exposure_s:.3g} s")


def _up_and_down(levels_s: tuple[float, ...], times: int) -> Iterator[float]:
    """Yield every level `times` times, up and down in turn: a steady drift of the lamp cancels in each level's mean."""
    for turn in range(times):
        yield from levels_s if turn % 2 == 0 else reversed(levels_s)
