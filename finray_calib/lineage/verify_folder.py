"""Whether all that a folder of products or sessions holds is as it was written."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from data_schemas.errors import FinrayError, RecordError
from data_schemas.folder_manifest import MANIFEST_NAME, FileFault, manifest_faults
from data_schemas.foreign_files import read_json
from finray_calib.lineage.trace import KINDS, Traced, Tracer, findings
from rigs.capture.journal import JOURNAL_NAME
from rigs.capture.session_folder import SESSION_NAME
from rigs.capture.verify_session import verify_session

DEMO_MARK: Final = ("demo.json", "report.html")
"""Files of a finished demo, which writes checksums of all its files last."""


@dataclass(frozen=True, slots=True)
class FolderCheck:
    """What was found in a folder.

    Attributes
    ----------
    records
        The records, with what they were made from.
    faults
        What is not as it was written; empty for a whole folder.
    notes
        What cannot be told, or does no harm.
    hashed
        Number of files of the folder that were hashed.
    """

    records: tuple[Traced, ...]
    faults: tuple[FileFault, ...]
    notes: tuple[str, ...]
    hashed: int


def verify_folder(folder: Path) -> FolderCheck:
    """Re-hash all files of a folder that a record, a session or checksums bind, and name what is not as it was.

    Raises
    ------
    RecordError
        There is no such folder, or nothing in it that could be checked.
    """
    if not folder.is_dir():
        raise RecordError(f"{folder}: no such folder; give the folder of a session or of products")
    tracer, records = Tracer(), list[Traced]()
    faults: dict[FileFault, None] = {}
    notes: dict[str, None] = {}
    for path in _visible(folder):
        if path.suffix == ".json":
            records += _record(tracer, path, faults)
    for traced in records:
        faults |= dict.fromkeys(findings(traced))
        notes |= dict.fromkeys(f"{part.path or part.name}: {note}" for part in traced.all() for note in part.notes)
    for session in _sessions(folder):
        check = verify_session(session)
        faults |= dict.fromkeys(check.faults)
        notes |= dict.fromkeys(f"{session / SESSION_NAME}: {note}" for note in check.notes)
    bound = set(tracer.digests) | _files_of(records)
    for listed in (path.parent for path in _visible(folder) if path.name == MANIFEST_NAME):
        of_manifest, unlisted = manifest_faults(listed, tracer.digests)
        told = {fault.path.resolve() for fault in faults}
        faults |= dict.fromkeys(fault for fault in of_manifest if fault.path.resolve() not in told)
        bound |= {path.resolve() for path in listed.rglob("*") if path not in (listed / MANIFEST_NAME, *unlisted)}
    dirty = {part.path for traced in records for part in traced.all() if part.is_dirty}
    if dirty:
        notes[f"{len(dirty)} records were made by sources that differed from the commit that they name"] = None
    faults |= dict.fromkeys(_missing_checksums(folder))
    notes |= dict.fromkeys(_unbound(folder, bound))
    hashed = sum(path.resolve() in bound for path in _visible(folder))
    if not (records or faults or hashed):
        raise RecordError(f"{folder}: holds no stored record, session or checksums; give a folder that finray wrote")
    return FolderCheck(tuple(records), tuple(faults), tuple(notes), hashed)


def _record(tracer: Tracer, path: Path, faults: dict[FileFault, None]) -> Iterator[Traced]:
    """Yield a JSON file traced as a record, if it is one; one that cannot be read is a fault."""
    try:
        envelope = read_json(path)
    except FinrayError as error:
        faults[FileFault(path, "changed", str(error).removeprefix(f"{path}: "))] = None
        return
    if isinstance(envelope, dict) and envelope.get("kind") in KINDS:
        yield tracer.trace(path)


def _visible(folder: Path) -> list[Path]:
    """Return the files of a folder and below it that are not hidden."""
    return sorted(
        path
        for path in folder.rglob("*")
        if path.is_file() and not any(part.startswith(".") for part in path.relative_to(folder).parts)
    )


def _sessions(folder: Path) -> list[Path]:
    """Return the folders of sessions, those among them that lost their record or journal as well."""
    marks = {path.parent for path in _visible(folder) if path.name == JOURNAL_NAME}
    marks |= {path.parent.parent for path in _visible(folder) if path.parent.name == "frames"}
    return sorted(mark for mark in marks if mark.is_relative_to(folder))


def _files_of(records: list[Traced]) -> set[Path]:
    """Return the records themselves, resolved, which their seals bind."""
    return {part.path.resolve() for traced in records for part in traced.all() if part.path is not None}


def _missing_checksums(folder: Path) -> Iterator[FileFault]:
    """Yield finished demos whose checksums are missing."""
    for mark in _visible(folder):
        demo = mark.parent
        if mark.name != DEMO_MARK[0] or not all((demo / name).is_file() for name in DEMO_MARK):
            continue
        if not (demo / MANIFEST_NAME).is_file():
            yield FileFault(demo / MANIFEST_NAME, "missing", "the checksums of a finished demo are missing")


def _unbound(folder: Path, bound: set[Path]) -> Iterator[str]:
    """Yield what no record and no checksums speak of."""
    names = {MANIFEST_NAME}
    loose = [path for path in _visible(folder) if path.resolve() not in bound and path.name not in names]
    if loose:
        shown = ", ".join(str(path.relative_to(folder)) for path in loose[:5])
        more = f" and {len(loose) - 5} more" if len(loose) > 5 else ""
        yield f"not checked, as no record and no checksums name them: {shown}{more}"
