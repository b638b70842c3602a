"""Capture of a camera session: flat frames up and down through the exposures, then dark frames of the same."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

from data_schemas.camera import CameraPlan, CameraSession
from data_schemas.capture import RegionOfInterest
from data_schemas.errors import CaptureError
from data_schemas.rig import RigFile
from rigs.capture.camera_levels import level_exposures_s, level_notes, saturation_exposures_s
from rigs.capture.exchange import expose_checked, shine
from rigs.capture.exposure import exposure_ladder, meter_exposure
from rigs.capture.frame_store import FrameStore
from rigs.capture.journal import Journal
from rigs.capture.plan import Step, require_region_inside
from rigs.capture.session_folder import curve_files, require_empty, write_manifest, write_session
from rigs.open_rig import OpenRig, open_rig

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
) -> CameraSession:
    """Capture a camera session into the folder `out`: frames, journal, ``session.json`` and checksums.

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
        Called with (done, total, text) after every frame; it counts within the phase that the text names.

    Raises
    ------
    CaptureError
        The plan does not fit the rig, the folder is not empty, the light is too bright or too dim for the exposures
        of the camera, or a device did not do what was asked.
    SaturatedError
        The white tile is too bright at the camera's shortest exposure.
    """
    step = camera_step(plan, rig)
    require_empty(out)
    with open_rig(rig, rig_folder) as opened:
        return capture_camera_with(opened, rig, plan, step, out, curve_files(rig, rig_folder), command, progress)


def capture_camera_with(
    opened: OpenRig,
    rig: RigFile,
    plan: CameraPlan,
    step: Step,
    out: Path,
    inputs: dict[str, str],
    command: str,
    progress: Progress | None = None,
) -> CameraSession:
    """Capture a camera session with devices that are open already."""
    out.mkdir(parents=True, exist_ok=True)
    with Journal(out, opened.clock) as journal:
        journal.append("start", command=command, rig=rig.name, camera=plan.camera_name)
        recorder = _Recorder(opened, rig, plan, step, out, journal, progress)
        recorder.record()
        notes = (*opened.notes, *recorder.notes)
        for note in notes:
            journal.append("note", text=note)
        session = CameraSession(plan=plan, rig=rig, frames=tuple(recorder.store.frames), notes=notes)
        write_session(session, out, inputs, command)
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
        out: Path,
        journal: Journal,
        progress: Progress | None,
    ):
        self._opened, self._camera, self._plan, self._flat = opened, rig.camera, plan, flat
        self._journal, self._progress = journal, progress
        whole_cells = RegionOfInterest.model_validate({k: v & ~1 for k, v in plan.region.model_dump().items()})
        self.store = FrameStore(opened, rig, whole_cells, out, journal)
        self.notes: tuple[str, ...] = ()

    def record(self) -> None:
        """Meter, store the flat frames with the lamp on throughout, then the dark frames."""
        self._opened.operator.place("white")
        if self._flat.slot is None:
            self._opened.operator.swing_wheel_out()
        with shine(self._opened, "lamp"):
            saturation_s = self._meter()
            self.notes = level_notes(saturation_s, self._plan, self._camera)
            levels_s = level_exposures_s(saturation_s, self._plan, self._camera)
            half_s = min(levels_s, key=lambda t: abs(t - 0.5 * min(saturation_s.values())))
            flats_s = [*_up_and_down(levels_s, self._plan.frames_per_level), *[half_s] * self._plan.repeats]
            self._journal.append("step", label=self._flat.label, exposures_s=levels_s)
            self._store_all(self._flat, flats_s, "flat frames")
        dark = replace(self._flat, frame_type="dark", light="off")
        longest_s = min(self._plan.longest_exposure_s, self._camera.longest_exposure_s)
        extra_s = [longest_s] * (self._plan.frames_per_level if longest_s not in levels_s else 0)
        with shine(self._opened, "off"):
            self._store_all(dark, [*flats_s, *extra_s], "dark frames")

    def _meter(self) -> dict[str, float]:
        """Return the exposure (s) at which each channel saturates."""
        metered_s = meter_exposure(
            lambda exposure_s: expose_checked(self._opened, self._camera, self._flat, exposure_s).raw.counts[
                self.store.region
            ],
            exposure_ladder(self._camera.shortest_exposure_s, self._camera.longest_exposure_s),
            self.store.full_scale_dn,
            self._camera.black_level_dn,
            METERED_FRACTION,
            self._flat.label,
        )
        raw = expose_checked(self._opened, self._camera, self._flat, metered_s).raw
        return saturation_exposures_s(raw.counts[self.store.region], raw.exposure_s, self._camera)

    def _store_all(self, step: Step, exposures_s: list[float], phase: str) -> None:
        """Store one frame per exposure."""
        for done, exposure_s in enumerate(exposures_s, 1):
            self.store.take(step, exposure_s)
            if self._progress is not None:
                self._progress(done, len(exposures_s), f"{phase}: {exposure_s:.3g} s")


def _up_and_down(levels_s: tuple[float, ...], times: int) -> Iterator[float]:
    """Yield every level `times` times, up and down in turn: a steady drift of the lamp cancels in each level's mean."""
    for turn in range(times):
        yield from levels_s if turn % 2 == 0 else reversed(levels_s)
