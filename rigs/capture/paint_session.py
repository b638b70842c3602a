"""Capture of a paint session: from plan and rig to a folder with frames, journal, record and checksums."""

from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path

from data_schemas.capture import CaptureSession, Frame, PaintPlan
from data_schemas.folder_manifest import write_manifest
from data_schemas.rig import RigFile
from rigs.capture.frame_store import FrameStore
from rigs.capture.journal import Journal
from rigs.capture.paint_recorder import PaintRecorder, Progress
from rigs.capture.plan import Step, paint_steps
from rigs.capture.resume import Interrupted, resume_notes, take_over
from rigs.capture.rig_lock import rig_locked
from rigs.capture.same_as_begun import require_same_camera, require_same_inputs
from rigs.capture.session_folder import curve_digests, curve_files, require_empty, write_session, write_start
from rigs.light_guard import require_outside_layer
from rigs.open_rig import OpenRig, open_rig
from rigs.protocols import Operator


def capture_paint_session(
    rig: RigFile,
    plan: PaintPlan,
    rig_folder: Path,
    out: Path,
    command: str,
    progress: Progress | None = None,
    *,
    operator: Operator | None = None,
    interrupted: Interrupted | None = None,
    last_good: CaptureSession | None = None,
    sources: Mapping[str, str] | None = None,
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
        New or empty folder, or that of the interrupted session.
    command
        The command line that reproduces the session.
    progress
        Called with (done, total, text) after every metered step and every frame; it counts within the phase
        that the text names.
    operator
        Who places targets; a person at the terminal when left out.
    interrupted
        What is done already, when a session is resumed.
    last_good
        An earlier session on this rig whose white frames these must resemble.
    sources
        Path -> SHA-256 of the files that plan and rig were read from, for the provenance.

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
    steps, curves = paint_steps(plan, rig), curve_files(rig, rig_folder)
    if interrupted is None:
        require_empty(out)
    with rig_locked(rig), open_rig(rig, rig_folder, operator) as opened:
        inputs = curve_digests(curves, rig_folder)
        if interrupted is not None:
            require_same_inputs(interrupted, inputs)
        return capture_with(
            opened, rig, plan, steps, out, inputs, command, progress, interrupted, last_good, rig_folder, sources
        )


def capture_with(
    opened: OpenRig,
    rig: RigFile,
    plan: PaintPlan,
    steps: tuple[Step, ...],
    out: Path,
    inputs: dict[str, str],
    command: str,
    progress: Progress | None = None,
    interrupted: Interrupted | None = None,
    last_good: CaptureSession | None = None,
    rig_folder: Path = Path(),
    sources: Mapping[str, str] | None = None,
) -> CaptureSession:
    """Capture the `steps` of a paint session with devices that are open already."""
    out.mkdir(parents=True, exist_ok=True)
    camera = opened.camera.identity()
    if interrupted is not None:
        require_same_camera(interrupted, camera)
        opened = replace(opened, clock=interrupted.clock_after(opened.clock))
    with Journal(out, opened.clock, resumed=interrupted is not None) as journal:
        if interrupted is None:
            write_start(journal, plan, rig, rig_folder, inputs, command, camera, sources)
        else:
            take_over(out, interrupted)
            journal.append("resume", frames=len(interrupted.frames), sample_dose_j=interrupted.dose_j)
        for note in opened.notes:
            journal.append("note", text=note)
        with FrameStore(opened, rig, plan.region, out, journal, interrupted) as store:
            recorder = PaintRecorder(opened, rig, plan, store, journal, progress, interrupted, last_good)
            recorder.record(steps)
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
            notes=(*opened.notes, *colour_notes(store.frames), *resume_notes(interrupted)),
        )
        noted = dict(sources or {}) if interrupted is None else interrupted.sources
        write_session(session, out, {**noted, **inputs}, command, journal)
    write_manifest(out)
    return session


def colour_notes(frames: Iterable[Frame]) -> tuple[str, ...]:
    """Return what must be known of a camera that says of itself that it sees no colours."""
    formats = sorted({str(frame.settings.get("pixel_format", "")) for frame in frames})
    mono = [name for name in formats if name.lower().startswith("mono")]
    if not mono:
        return ()
    return (
        f"camera: its frames are {', '.join(mono)}, and radiometry takes them for Bayer RGGB: red, green and blue will "
        "be one and the same response, and only the filters tell wavelengths apart; for a colour camera choose its raw "
        "Bayer pixel format",
    )
