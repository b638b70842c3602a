"""The folder of a session: what it must be before, and the record and checksums at its end."""

from collections.abc import Iterable, Mapping
from pathlib import Path

from data_schemas.camera import CameraSession
from data_schemas.capture import CaptureSession
from data_schemas.devices import DeviceIdentity
from data_schemas.errors import CaptureError, CurveError
from data_schemas.folder_manifest import MANIFEST_NAME
from data_schemas.leftovers import clear_leftovers
from data_schemas.model import Record
from data_schemas.provenance import digest_of_input, provenance
from data_schemas.rig import RigFile
from data_schemas.storage import write_record
from data_schemas.tactile import TactileRig, TactileSession
from data_schemas.whole_files import sha256_of
from rigs.capture.journal import JOURNAL_NAME, Journal

SESSION_NAME = "session.json"
SESSION_EVENT = "session"
"""Of the line of a journal that holds the checksum of the session's record."""


def is_unborn(out: Path) -> bool:
    """Return whether a folder is empty, but for what a capture left that was killed before its first line."""
    clear_leftovers(out)
    return out.is_dir() and all(path.name == f".{JOURNAL_NAME}.part" for path in out.iterdir())


def require_empty(out: Path) -> None:
    """Refuse a folder that holds something, or a path that is no folder.

    Raises
    ------
    CaptureError
        It does.
    """
    if out.exists() and not is_unborn(out):
        raise CaptureError(
            f"{out}: exists already and is not an empty folder; a capture never overwrites: choose another --out"
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
    rig_folder: Path,
    inputs: dict[str, str],
    command: str,
    camera: DeviceIdentity,
    sources: Mapping[str, str] | None = None,
) -> None:
    """Write the first line of a journal: everything that a resumed session needs.

    `inputs` are curve files, which must be the same when the session goes on; `sources` the plan and rig file, which
    need not be there any more.
    """
    journal.append(
        "start",
        command=command,
        kind=plan.model_dump()["kind"],
        plan=plan.model_dump(mode="json"),
        rig=rig.model_dump(mode="json"),
        rig_folder=str(rig_folder.resolve()),
        inputs=inputs,
        sources=dict(sources or {}),
        schema_versions={"plan": plan.schema_version, "rig": rig.schema_version},
        camera=camera.model_dump(mode="json"),
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
    """Whether a session was interrupted when it was finished but for its checksums."""
    return (out / SESSION_NAME).is_file() and not (out / MANIFEST_NAME).exists()
