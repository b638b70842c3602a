"""What is asked of a capture, and the folder of a session: begun empty, sealed, read, and verified.

The record holds the SHA-256 of every frame and its own seal; the journal chains its lines and holds plan, rig, every
frame and the SHA-256 of the record; the checksums list all files. An accident or an edit breaks at least one of these;
a forger who computes all of them anew is not detected.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from data_schemas import (
    CameraSession,
    CaptureError,
    CaptureSession,
    CurveError,
    DeviceIdentity,
    Frame,
    Record,
    RecordError,
    RigFile,
    TactileRig,
    TactileSession,
    digest_of_input,
    kind_in_words,
    provenance,
)
from data_schemas.storage import (
    MANIFEST_NAME,
    FileFault,
    clear_leftovers,
    digest_as_read,
    has_file,
    manifest_faults,
    read_frame,
    read_json,
    read_record,
    sha256_of,
    stored_kind,
    write_manifest,
    write_record,
)
from rigs import OpenRig, Operator, RawFrame, SystemClock
from rigs.capture._journal import JOURNAL_NAME, Journal, LinkedLine, linked_lines, resume_command
from rigs.capture._plan import Step

SESSION_NAME = "session.json"
SESSION_EVENT = "session"
"""Of the line of a journal that holds the checksum of the session's record."""


Progress = Callable[[int, int, str], None]


class SessionWatch:
    """Observer of a running session; this one does nothing, and a view overrides the methods that it shows.

    A session calls it from the thread that runs it, journal lines from that of the frame writer too; it must not raise,
    but for the devices that it returns.
    """

    def devices(self, opened: OpenRig) -> OpenRig:
        """Return the devices that the session is to use in place of the opened ones."""
        return opened

    def left(self) -> None:
        """See that the session has ended, before the devices that it used are closed."""

    def noted(self, event: str, what: Mapping[str, Any]) -> None:
        """See a line of the journal that is on the disk: its event, and what else it says."""

    def expects(self, shots: Sequence[tuple[str | None, float]]) -> None:
        """Learn filter (None for dark frames and without one) and exposure (s) of all frames still to be taken."""

    def frame(self, label: str, raw: RawFrame, step: Step | None = None) -> None:
        """See a frame that was accepted, stored or of a metering; a press on a finger has no step."""


@contextmanager
def watched_to_the_end(watch: SessionWatch) -> Iterator[None]:
    """Tell a watch when a ``with`` block that uses devices is left: it lets go of them before they are closed."""
    try:
        yield
    finally:
        watch.left()


@dataclass(frozen=True, slots=True)
class SessionRequest:
    """What a capture needs besides rig and plan: its folder, the operator, and what its record states about it.

    Attributes
    ----------
    out
        New or empty folder, or that of the interrupted session.
    command
        The command line that reproduces the session.
    rig_folder
        Where relative paths in the rig file start.
    progress
        Called with (done, total, text) after every metered step and every frame; it counts within the phase
        that the text names.
    operator
        Who places targets and presses; a person at the terminal when left out.
    sources
        Path -> SHA-256 of the files that plan and rig were read from, for the provenance.
    watch
        Sees what the session does; nobody when left out.
    """

    out: Path
    command: str
    rig_folder: Path = Path()
    progress: Progress | None = None
    operator: Operator | None = None
    sources: Mapping[str, str] = field(default_factory=dict)
    watch: SessionWatch = field(default_factory=SessionWatch)

    def tell(self, done: int, total: int, text: str) -> None:
        """Tell the progress to whoever asked for it."""
        if self.progress is not None:
            self.progress(done, total, text)


def is_unstarted(out: Path) -> bool:
    """Return whether a folder is empty, or holds only what a capture left that was killed before its first line."""
    clear_leftovers(out)
    return out.is_dir() and all(path.name == f".{JOURNAL_NAME}.part" for path in out.iterdir())


def require_empty(out: Path) -> None:
    """Refuse a folder that holds something, or a path that is not a folder.

    Raises
    ------
    CaptureError
        It does.
    """
    if out.exists() and not is_unstarted(out):
        raise CaptureError(
            f"{out}: exists already and is not an empty folder, and a capture never overwrites files; choose another "
            "--out"
        )


def clear_session(out: Path) -> None:
    """Remove the part files that a killed capture left in the folder of a session; its journal must be ours."""
    for folder in (out, out / "frames"):
        clear_leftovers(folder)


def curve_files(rig: RigFile, rig_folder: Path) -> tuple[str, ...]:
    """Return the names of the curve files that the rig file names.

    Raises
    ------
    CurveError
        One is missing.
    """
    named = [] if rig.camera.response == "assumed" else [rig.camera.response]
    named += [band.curve for band in rig.filter_wheel.filters if band.curve is not None]
    named += [rig.lamp.spectrum] if rig.lamp.spectrum.endswith(".csv") else []
    if rig.simulated is not None and rig.simulated.material is not None:
        named.append(rig.simulated.material)
    lost = [name for name in named if not (rig_folder / name).is_file()]
    if lost:
        raise CurveError(f"{rig_folder / lost[0]}: no such file; give the path of a CSV file")
    return tuple(named)


def curve_digests(curves: Iterable[str], rig_folder: Path) -> dict[str, str]:
    """Return name -> SHA-256 of curve files as they were read when the rig was opened."""
    return {name: digest_of_input(rig_folder / name) for name in curves}


def write_start(
    journal: Journal,
    plan: Record,
    rig: RigFile,
    request: SessionRequest,
    inputs: dict[str, str],
    devices: Sequence[DeviceIdentity],
) -> None:
    """Write the first line of a journal: everything that a resumed session needs.

    `inputs` are curve files and `devices` those of the rig, the camera first, which must be the same when the session
    goes on; the request's sources are the plan and rig file, which need not be there any more.
    """
    journal.append(
        "start",
        command=request.command,
        kind=plan.model_dump()["kind"],
        plan=plan.model_dump(mode="json"),
        rig=rig.model_dump(mode="json"),
        rig_folder=str(request.rig_folder.resolve()),
        inputs=inputs,
        sources=dict(request.sources),
        schema_versions={"plan": plan.schema_version, "rig": rig.schema_version},
        camera=devices[0].model_dump(mode="json"),
        serials={device.role: device.serial for device in devices[1:] if device.serial},
    )


def write_session(
    session: CaptureSession | CameraSession | TactileSession,
    out: Path,
    inputs: dict[str, str],
    command: str,
    journal: Journal,
) -> None:
    """Write the record of a finished session, and its checksum into the journal."""
    bench = None if isinstance(session.rig, TactileRig) else session.rig.simulated
    write_record(session, out / SESSION_NAME, provenance(command, inputs, None if bench is None else bench.seed))
    seal_session(out, journal)


def seal_session(out: Path, journal: Journal) -> None:
    """Note the checksum of the session's record in the journal, which binds the two."""
    journal.append(SESSION_EVENT, file=SESSION_NAME, sha256=sha256_of(out / SESSION_NAME))


def lacks_manifest(out: Path) -> bool:
    """Whether a session was interrupted when only its checksums were missing."""
    return (out / SESSION_NAME).is_file() and not (out / MANIFEST_NAME).exists()


def require_unfinished(folder: Path) -> None:
    """Refuse to resume a session that was complete and lost its record since; nothing is written.

    Raises
    ------
    CaptureError
        Its checksums are there and its record is not.
    """
    if _has_lost_its_record(folder):
        raise CaptureError(f"{folder}: {_LOST}")


def _has_lost_its_record(folder: Path) -> bool:
    return (folder / MANIFEST_NAME).is_file() and not has_file(folder / SESSION_NAME)


_LOST: Final = (
    f"was complete ({MANIFEST_NAME} is there), but {SESSION_NAME} is missing; restore it from a copy of the session. "
    f"Without a copy, delete {MANIFEST_NAME} and run 'finray capture --resume' on the same rig, which writes "
    f"{SESSION_NAME} anew from the journal and the frames"
)
SessionKind = Literal["paint", "camera"]
KINDS: dict[str, SessionKind] = {CaptureSession.__name__: "paint", CameraSession.__name__: "camera"}


def session_kind(folder: Path) -> SessionKind:
    """Tell what was captured into `folder`: a paint or a camera.

    Raises
    ------
    RecordError
        The folder is missing, holds no session or one of another kind, or the capture was not finished.
    """
    path = _session_file(folder)
    stored = read_json(path, "a capture session (.json)")
    kind = stored_kind(stored)
    if kind not in KINDS:
        found = kind_in_words(kind) if kind else "no record of a known kind"
        raise RecordError(f"{path}: contains {found}, but a capture session or a camera session is needed")
    return KINDS[kind]


def read_session(folder: Path) -> CaptureSession:
    """Read the paint session that was captured into `folder`.

    Raises
    ------
    RecordError
        The folder is missing, holds no paint session, or the capture was not finished.
    """
    return read_record(_session_file(folder), CaptureSession)


def read_camera_session(folder: Path) -> CameraSession:
    """Read the camera session that was captured into `folder`.

    Raises
    ------
    RecordError
        The folder is missing, holds no camera session, or the capture was not finished.
    """
    return read_record(_session_file(folder), CameraSession)


def _session_file(folder: Path) -> Path:
    """Return the session's record, or say why there is none."""
    if (folder / SESSION_NAME).is_file():
        return folder / SESSION_NAME
    if not folder.is_dir():
        what = "is a file" if folder.exists() else "no such folder"
        raise RecordError(f"{folder}: {what}; give the folder that 'finray capture' wrote")
    if _has_lost_its_record(folder):
        raise RecordError(f"{folder}: {_LOST}")
    if (folder / JOURNAL_NAME).is_file():
        raise RecordError(
            f"{folder}: the capture was not finished ({SESSION_NAME} is missing); the last line of {JOURNAL_NAME} "
            f"says why. Continue with '{resume_command(folder)}'"
        )
    raise RecordError(
        f"{folder}: contains no capture session ({SESSION_NAME} is missing); give the folder that 'finray capture' "
        "wrote"
    )


def read_frame_of(folder: Path, frame: Frame) -> NDArray[np.uint16]:
    """Return the counts of one frame (DN), shape (H, W), after checking its checksum.

    Raises
    ------
    RecordError
        The frame's path leads out of the session's folder (a link).
    ChecksumError
        The frame is missing or was changed.
    """
    path = folder / frame.file
    if not path.resolve().is_relative_to(folder.resolve()):
        raise RecordError(f"{path}: points outside the session's folder; frames must be plain files inside it")
    return read_frame(path, frame.sha256)


Session = CaptureSession | CameraSession | TactileSession
SESSION_KINDS: dict[str, type[Record]] = {t.__name__: t for t in (CaptureSession, CameraSession, TactileSession)}


@dataclass(frozen=True, slots=True)
class SessionCheck:
    """What was found in the folder of a session.

    Attributes
    ----------
    faults
        What is not as it was captured; empty for a whole session.
    notes
        What cannot be told, or does no harm.
    digests
        SHA-256 of the files that were hashed.
    """

    faults: tuple[FileFault, ...]
    notes: tuple[str, ...]
    digests: dict[Path, str]


def verify_session(folder: Path) -> SessionCheck:
    """Read a session's record, re-hash all its files, and compare record, journal and checksums with each other.

    Raises
    ------
    RecordError
        The folder holds no finished session.
    """
    path = folder / SESSION_NAME
    digests: dict[Path, str] = {}
    notes: list[str] = []
    faults: list[FileFault] = []
    try:
        session, is_sealed = _read(path)
        digests[path] = digest_as_read(path) or sha256_of(path)
        faults += _frame_faults(folder, session, digests)
    except RecordError as error:
        if not has_file(path):
            faults.append(FileFault(path, "missing", "the record of the session is missing"))
        else:
            faults.append(FileFault(path, "changed", str(error).removeprefix(f"{path}: ")))
        session, is_sealed = None, True
    if not is_sealed:
        notes.append(
            f"{SESSION_NAME} was written by a version of finray that stored no checksum of {SESSION_NAME} in the "
            f"journal, so only {MANIFEST_NAME} protects its values"
        )
    faults += _journal_faults(folder, session, is_sealed, digests.get(path), notes)
    of_manifest, unlisted = manifest_faults(folder, digests)
    told = {fault.path for fault in faults}
    faults += [fault for fault in of_manifest if fault.path not in told]
    captured = {folder / JOURNAL_NAME, *digests}
    for file in unlisted:
        if file in captured:
            text = f"does not list {file.relative_to(folder).as_posix()}, so a line was removed"
            faults.append(FileFault(folder / MANIFEST_NAME, "changed", text))
        else:
            notes.append(f"{file.relative_to(folder)}: was added later; {MANIFEST_NAME} does not list it")
    if not has_file(folder / MANIFEST_NAME):
        notes.append(f"{MANIFEST_NAME} is missing, so other files of the session are not checked")
    return SessionCheck(tuple(faults), tuple(notes), digests)


def _read(path: Path) -> tuple[Session, bool]:
    """Read the record of a session, and tell whether it carries a seal."""
    envelope = read_json(path, "the record of a session")
    kind = stored_kind(envelope)
    if kind not in SESSION_KINDS:
        found = kind_in_words(kind) if kind else "no record of a known kind"
        raise RecordError(f"{path}: contains {found}, but the record of a session is needed")
    session: Any = read_record(path, SESSION_KINDS[kind])
    return session, "content_sha256" in envelope


def _frame_faults(folder: Path, session: Session, digests: dict[Path, str]) -> Iterator[FileFault]:
    """Yield the frames that are not as they were captured."""
    for frame in session.frames:
        path = folder / frame.file
        if not has_file(path):
            yield FileFault(path, "missing", f"is missing; frame {frame.sequence} of {SESSION_NAME}")
            continue
        try:
            if not path.resolve().is_relative_to(folder.resolve()):
                raise RecordError(f"{path}: points outside the session's folder")
            digests[path] = sha256_of(path)
        except RecordError as error:
            yield FileFault(path, "changed", str(error).removeprefix(f"{path}: "))
            continue
        if digests[path] != frame.sha256:
            yield FileFault(path, "changed", f"was changed: its SHA-256 is not the one in {SESSION_NAME}")


def _journal_faults(
    folder: Path, session: Session | None, is_sealed: bool, session_sha256: str | None, notes: list[str]
) -> list[FileFault]:
    """Return what does not agree in the journal, with itself and with the record."""
    path = folder / JOURNAL_NAME
    try:
        lines = linked_lines(folder)
    except CaptureError:
        return [FileFault(path, "missing", "the journal of the session is missing")]
    said: list[str] = []
    broken = next((line for line in lines if not line.holds), None)
    if broken is not None:
        said.append(
            f"line {broken.number}, or an earlier line, was changed or removed, because the checksum of line "
            f"{broken.number} does not follow from the line above it"
        )
    linked = [line for line in lines if line.link]
    if is_sealed and (not linked or not lines[0].link or not lines[-1].link):
        said.append("contains lines without a checksum of the line before, so lines were added, changed or removed")
    elif not linked:
        notes.append(
            f"{JOURNAL_NAME} was written by a version of finray without checksums in its lines, so only "
            f"{MANIFEST_NAME} protects it"
        )
    if is_sealed or linked:
        said += _ending_faults(lines, session_sha256)
    if session is not None:
        said += _disagreements(lines, session)
    return [FileFault(path, "changed", text) for text in said]


_NO_END: Final = "its last line is not the end of the session, so lines are missing"
_NO_CHECKSUM: Final = f"lacks the line that holds the checksum of {SESSION_NAME}"


def _ending_faults(lines: list[LinkedLine], session_sha256: str | None) -> Iterator[str]:
    """Yield what is wrong with the last lines of a finished session's journal."""
    last = lines[-1].entry if lines else {}
    if last.get("event") != "stop" or last.get("outcome") != "done":
        yield _NO_END
    noted = next((line.entry for line in reversed(lines) if line.entry["event"] == SESSION_EVENT), None)
    if noted is None:
        yield _NO_CHECKSUM
    elif session_sha256 is not None and noted.get("sha256") != session_sha256:
        yield f"holds a checksum of {SESSION_NAME} that differs from the file's, so one of the two was changed"


def _disagreements(lines: list[LinkedLine], session: Session) -> Iterator[str]:
    """Yield in what journal and record differ."""
    start = next((line.entry for line in lines if line.entry["event"] == "start"), {})
    for name, record in (("plan", session.plan), ("rig", session.rig)):
        if name in start and not _is(start[name], record):
            yield f"begins with a {name} that differs from the one in {SESSION_NAME}"
    noted = {line.entry.get("sequence"): line.entry for line in lines if line.entry["event"] == "frame"}
    for frame in session.frames:
        entry, wanted = noted.get(frame.sequence), frame.model_dump(mode="json")
        if entry is None:
            yield f"lacks frame {frame.sequence}, {frame.file}"
        elif any(entry[key] != wanted[key] for key in entry.keys() & wanted.keys()):
            other = next(key for key in wanted if key in entry and entry[key] != wanted[key])
            yield f"and {SESSION_NAME} differ in {other} of frame {frame.sequence}"


def _is(stored: Any, record: Record) -> bool:
    """Return whether a plan or rig of a journal is that of the record; old ones lack fields that have a default."""
    try:
        return type(record).model_validate(stored) == record
    except ValidationError:
        return False


def complete_session(folder: Path) -> None:
    """Write the checksums of a session that was interrupted when only they were missing.

    Raises
    ------
    CaptureError
        What is there does not agree: checksums would hide that.
    """
    unfinished = {_NO_CHECKSUM, _NO_END}
    found = [fault for fault in verify_session(folder).faults if fault.path != folder / MANIFEST_NAME]
    faults = [fault for fault in found if fault.text not in unfinished]
    if faults:
        raise CaptureError(
            f"{faults[0].path}: {faults[0].text}; the checksums are not written, because they would hide this fault. "
            "Restore the file, or capture the session again"
        )
    if found:
        with Journal(folder, SystemClock(), resumed=True) as journal:
            seal_session(folder, journal)
    write_manifest(folder)
