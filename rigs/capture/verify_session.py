"""Whether a finished session is as it was captured: record, journal, checksums and frames bind each other.

The record holds the SHA-256 of every frame and its own seal; the journal chains its lines and holds plan, rig, every
frame and the SHA-256 of the record; the checksums list all files. An accident or an edit breaks at least one of these;
a forger who computes all of them anew is not detected.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from data_schemas.camera import CameraSession
from data_schemas.capture import CaptureSession
from data_schemas.errors import CaptureError, RecordError
from data_schemas.folder_manifest import MANIFEST_NAME, FileFault, manifest_faults, sha256_now, write_manifest
from data_schemas.foreign_files import digest_as_read, read_json
from data_schemas.model import Record
from data_schemas.storage import read_record
from data_schemas.tactile import TactileSession
from rigs.capture.journal import JOURNAL_NAME, Journal, LinkedLine, linked_lines
from rigs.capture.session_folder import SESSION_EVENT, SESSION_NAME, seal_session
from rigs.host import SystemClock

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
        digests[path] = digest_as_read(path) or sha256_now(path)
        faults += _frame_faults(folder, session, digests)
    except RecordError as error:
        if not path.exists():
            faults.append(FileFault(path, "missing", "the record of the session is missing"))
        else:
            faults.append(FileFault(path, "changed", str(error).removeprefix(f"{path}: ")))
        session, is_sealed = None, True
    if not is_sealed:
        notes.append(f"{SESSION_NAME} is of a version before seals; its own values are checked by {MANIFEST_NAME} only")
    faults += _journal_faults(folder, session, is_sealed, digests.get(path), notes)
    of_manifest, unlisted = manifest_faults(folder, digests)
    told = {fault.path for fault in faults}
    faults += [fault for fault in of_manifest if fault.path not in told]
    captured = {folder / JOURNAL_NAME, *digests}
    for file in unlisted:
        if file in captured:
            text = f"does not list {file.relative_to(folder).as_posix()}: a line was removed"
            faults.append(FileFault(folder / MANIFEST_NAME, "changed", text))
        else:
            notes.append(f"{file.relative_to(folder)}: came later, {MANIFEST_NAME} does not list it")
    if not (folder / MANIFEST_NAME).is_file():
        notes.append(f"without {MANIFEST_NAME}, other files of the session are not checked")
    return SessionCheck(tuple(faults), tuple(notes), digests)


def _read(path: Path) -> tuple[Session, bool]:
    """Read the record of a session, and tell whether it carries a seal."""
    envelope = read_json(path, "the record of a session")
    kind = envelope.get("kind") if isinstance(envelope, dict) else None
    if kind not in SESSION_KINDS:
        raise RecordError(f"{path}: is a {kind or 'file of unknown kind'}, not the record of a session")
    session: Any = read_record(path, SESSION_KINDS[kind])
    return session, "content_sha256" in envelope


def _frame_faults(folder: Path, session: Session, digests: dict[Path, str]) -> Iterator[FileFault]:
    """Yield the frames that are not as they were captured."""
    for frame in session.frames:
        path = folder / frame.file
        if not path.exists():
            yield FileFault(path, "missing", f"is missing; frame {frame.sequence} of {SESSION_NAME}")
            continue
        try:
            if not path.resolve().is_relative_to(folder.resolve()):
                raise RecordError(f"{path}: leads out of the session's folder")
            digests[path] = sha256_now(path)
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
        said.append(f"line {broken.number} or a line before it was changed or removed: its link does not hold")
    linked = [line for line in lines if line.link]
    if is_sealed and (not linked or not lines[0].link or not lines[-1].link):
        said.append("holds lines without links, so that lines were added, changed or removed")
    elif not linked:
        notes.append(f"{JOURNAL_NAME} is of a version before links; its lines are checked by {MANIFEST_NAME} only")
    if is_sealed or linked:
        said += _ending_faults(lines, session_sha256)
    if session is not None:
        said += _disagreements(lines, session)
    return [FileFault(path, "changed", text) for text in said]


def _ending_faults(lines: list[LinkedLine], session_sha256: str | None) -> Iterator[str]:
    """Yield what is wrong with the last lines of a finished session's journal."""
    last = lines[-1].entry if lines else {}
    if last.get("event") != "stop" or last.get("outcome") != "done":
        yield "does not end with the end of the session: lines are missing"
    noted = next((line.entry for line in reversed(lines) if line.entry["event"] == SESSION_EVENT), None)
    if noted is None:
        yield f"lacks the line that holds the checksum of {SESSION_NAME}"
    elif session_sha256 is not None and noted.get("sha256") != session_sha256:
        yield f"holds another checksum of {SESSION_NAME} than it has: one of the two was changed"


def _disagreements(lines: list[LinkedLine], session: Session) -> Iterator[str]:
    """Yield in what journal and record differ."""
    start = next((line.entry for line in lines if line.entry["event"] == "start"), {})
    for name, record in (("plan", session.plan), ("rig", session.rig)):
        if name in start and not _is(start[name], record):
            yield f"begins with another {name} than {SESSION_NAME} holds"
    noted = {line.entry.get("sequence"): line.entry for line in lines if line.entry["event"] == "frame"}
    for frame in session.frames:
        entry, wanted = noted.get(frame.sequence), frame.model_dump(mode="json")
        if entry is None:
            yield f"lacks frame {frame.sequence}, {frame.file}"
        elif any(entry[key] != wanted[key] for key in entry.keys() & wanted.keys()):
            other = next(key for key in wanted if key in entry and entry[key] != wanted[key])
            yield f"says another {other} of frame {frame.sequence} than {SESSION_NAME}"


def _is(stored: Any, record: Record) -> bool:
    """Return whether a plan or rig of a journal is that of the record; old ones lack fields that have a default."""
    try:
        return type(record).model_validate(stored) == record
    except ValidationError:
        return False


def complete_session(folder: Path) -> None:
    """Write the checksums of a session that was interrupted when it was finished but for them.

    Raises
    ------
    CaptureError
        What is there does not agree: checksums would hide that.
    """
    unfinished = (f"lacks the line that holds the checksum of {SESSION_NAME}", "does not end with the end")
    found = [fault for fault in verify_session(folder).faults if fault.path != folder / MANIFEST_NAME]
    faults = [fault for fault in found if not fault.text.startswith(unfinished)]
    if faults:
        raise CaptureError(
            f"{faults[0].path}: {faults[0].text}; the checksums are not written, as they would hide it: restore the "
            "file, or capture the session again"
        )
    if found:
        with Journal(folder, SystemClock(), resumed=True) as journal:
            seal_session(folder, journal)
    write_manifest(folder)
