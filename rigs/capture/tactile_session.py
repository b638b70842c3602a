"""Capture of a tactile session: board, no contact, and each press between images of no contact."""

from collections.abc import Callable, Mapping, Sequence
from itertools import groupby
from pathlib import Path

from data_schemas.devices import DeviceIdentity
from data_schemas.errors import CaptureError
from data_schemas.folder_manifest import write_manifest
from data_schemas.frame_files import write_frame
from data_schemas.provenance import provenance
from data_schemas.storage import write_record
from data_schemas.tactile import PlannedPress, TactileFrame, TactilePlan, TactileRig, TactileSession
from rigs.capture.exposure import saturated_fraction
from rigs.capture.frame_store import BYTES_PER_PIXEL, require_space
from rigs.capture.journal import Journal
from rigs.capture.rig_lock import device_locked
from rigs.capture.session_folder import require_empty, write_session
from rigs.capture.tactile_camera import TactileCamera
from rigs.capture.tactile_captures import capture_file, clipping_notes, tactile_capture
from rigs.capture.tactile_plan import TactileShot, instruction, press_of, tactile_shots
from rigs.capture.tactile_resume import KIND, InterruptedPresses, take_over
from rigs.drivers import open_camera
from rigs.host import SystemClock, TerminalOperator
from rigs.protocols import Camera, Clock, Operator

Progress = Callable[[int, int, str], None]
SAMPLES_OF_RGB = 3
IMAGES_OF_A_CAPTURE = 3


def capture_tactile_session(
    rig: TactileRig,
    plan: TactilePlan,
    presses: tuple[PlannedPress, ...],
    folders: tuple[Path, Path],
    command: str,
    progress: Progress | None = None,
    *,
    operator: Operator | None = None,
    interrupted: InterruptedPresses | None = None,
    sources: Mapping[str, str] | None = None,
) -> TactileSession:
    """Capture a tactile session: frames, journal, a tactile capture of each contact, ``session.json``, checksums.

    Parameters
    ----------
    rig, plan
        The camera and what to capture with it.
    presses
        Those of the plan or of its file of poses (:func:`~rigs.capture.tactile_plan.planned_presses`).
    folders
        Where relative paths in the rig file start, and the session's folder: new, empty or that of the interrupted
        session.
    command
        The command line that reproduces the session.
    progress
        Called with (done, total, text) after every frame.
    operator
        Who presses; a person at the terminal when left out.
    interrupted
        What is done already, when a session is resumed.
    sources
        Path -> SHA-256 of the files that plan, poses and rig were read from, for the provenance.

    Raises
    ------
    CaptureError
        The plan does not fit the rig, the folder is not empty, another capture uses the camera, or the camera did not
        do what was asked.
    """
    rig_folder, out = folders
    shots = tactile_shots(plan, rig.camera, len(presses))
    if interrupted is None:
        require_empty(out)
    with (
        device_locked("camera", rig.camera.driver, rig.camera.address),
        open_camera(rig.camera, rig_folder) as camera,
    ):
        out.mkdir(parents=True, exist_ok=True)
        clock = SystemClock()
        with Journal(out, clock, resumed=interrupted is not None) as journal:
            recorder = _Recorder(
                camera, rig, plan, presses, out, journal, clock, operator or TerminalOperator(), progress
            )
            device = camera.identity()
            if interrupted is None:
                _write_start(journal, rig, plan, presses, rig_folder, command, device, sources or {})
            else:
                take_over(out, interrupted, device)
                recorder.frames.update(interrupted.frames)
                journal.append("resume", frames=len(interrupted.frames))
            recorder.record(shots)
            notes = interrupted.notes if interrupted else ()
            session = _session_of(plan, rig, presses, recorder.frames, device, notes)
            _write_captures(session, out, command)
            noted = dict(sources or {}) if interrupted is None else interrupted.sources
            write_session(session, out, noted, command, journal)
    write_manifest(out)
    return session


def _session_of(
    plan: TactilePlan,
    rig: TactileRig,
    presses: tuple[PlannedPress, ...],
    frames_by_number: Mapping[int, TactileFrame],
    device: DeviceIdentity,
    notes: tuple[str, ...],
) -> TactileSession:
    """Return the record of a session all of whose frames are there."""
    frames = tuple(frame for _, frame in sorted(frames_by_number.items()))
    contacts = len(presses) * plan.repeats
    return TactileSession(
        plan=plan,
        rig=rig,
        presses=presses,
        frames=frames,
        captures=tuple(capture_file(contact) for contact in range(1, contacts + 1)),
        devices=(device,),
        notes=(*notes, *clipping_notes(frames, contacts)),
    )


def _write_start(
    journal: Journal,
    rig: TactileRig,
    plan: TactilePlan,
    presses: Sequence[PlannedPress],
    folder: Path,
    command: str,
    device: DeviceIdentity,
    sources: Mapping[str, str],
) -> None:
    """Write the first line of the journal: everything that a resumed session needs."""
    journal.append(
        "start",
        command=command,
        kind=KIND,
        plan=plan.model_dump(mode="json"),
        rig=rig.model_dump(mode="json"),
        rig_folder=str(folder.resolve()),
        presses=[press.model_dump(mode="json") for press in presses],
        device=device.model_dump(mode="json"),
        sources=dict(sources),
        schema_versions={"plan": plan.schema_version, "rig": rig.schema_version},
    )


def _write_captures(session: TactileSession, out: Path, command: str) -> None:
    """Write the tactile capture of each contact."""
    for contact, name in enumerate(session.captures, 1):
        press = session.presses[press_of(contact, session.plan.repeats)]
        capture = tactile_capture(out, session.plan, session.rig, press, contact, session.frames)
        groups = (("no contact", contact - 1), ("contact", contact), ("no contact", contact))
        used = {frame.file: frame.sha256 for frame in session.frames if (frame.frame_type, frame.place) in groups}
        write_record(capture, out / name, provenance(command, used, None))


def session_bytes(rig: TactileRig, plan: TactilePlan, presses: int, frames: int) -> int:
    """Return the space on the disk (bytes) of so many frames and of the captures made of them."""
    camera = rig.camera
    samples = SAMPLES_OF_RGB if camera.driver == "mjpeg" else 1
    images = frames + IMAGES_OF_A_CAPTURE * presses * plan.repeats
    return images * camera.width_px * camera.height_px * samples * BYTES_PER_PIXEL


class _Recorder:
    """Takes and stores the frames of one session."""

    def __init__(
        self,
        camera: Camera,
        rig: TactileRig,
        plan: TactilePlan,
        presses: tuple[PlannedPress, ...],
        out: Path,
        journal: Journal,
        clock: Clock,
        operator: Operator,
        progress: Progress | None,
    ):
        self._plan, self._presses, self._out, self._journal = plan, presses, out, journal
        self._clock, self._operator, self._progress = clock, operator, progress
        self._rig = rig
        self._camera = TactileCamera(
            camera, rig.camera, len(plan.bracket_s(rig.camera)) == 1, lambda text: journal.append("refused", text=text)
        )
        self.frames: dict[int, TactileFrame] = {}

    def record(self, shots: tuple[TactileShot, ...]) -> None:
        """Have everything done that needs hands, and take the frames that are missing."""
        missing = [shot for shot in shots if shot.sequence not in self.frames]
        require_space(self._out, session_bytes(self._rig, self._plan, len(self._presses), len(missing)))
        for _, group in groupby(missing, key=lambda shot: shot.group):
            todo = list(group)
            self._operator.do(instruction(todo[0], self._plan, self._presses))
            for shot in todo:
                self._take(shot)
                if self._progress is not None:
                    self._progress(len(self.frames), len(shots), shot.label)

    def _take(self, shot: TactileShot) -> None:
        """Take a frame, write it, then its line of the journal."""
        raw, attempts = self._camera.expose(shot.exposure_s)
        captured_s = self._clock.monotonic_s()
        kind = shot.frame_type.replace(" ", "-")
        file = f"frames/{shot.sequence:05d}_{kind}_{shot.place}_{round(shot.exposure_s * 1e6)}us.tiff"
        try:
            sha256 = write_frame(self._out / file, raw.counts, shot.label)
        except OSError as error:
            raise CaptureError(
                f"{self._out / file}: cannot be written ({error.strerror}); free space or mend the disk, then "
                f"finray capture --resume {self._out}"
            ) from None
        frame = TactileFrame(
            sequence=shot.sequence,
            file=file,
            frame_type=shot.frame_type,
            place=shot.place,
            exposure_requested_s=raw.exposure_requested_s,
            exposure_s=raw.exposure_s if raw.exposure_s == raw.exposure_s else None,  # NaN: the camera does not say
            captured_utc=raw.captured_utc,
            captured_s=captured_s,
            frame_id=raw.frame_id,
            device_time_s=raw.device_time_s,
            settings=dict(raw.settings),
            attempts=attempts,
            saturated_fraction=saturated_fraction(raw.counts, 2**self._rig.camera.bit_depth - 1),
            sha256=sha256,
        )
        self._journal.append("frame", **frame.model_dump())
        self.frames[shot.sequence] = frame
