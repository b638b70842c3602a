"""The folder of a session: what it must be before, and the record and checksums at its end."""

from pathlib import Path

from data_schemas.camera import CameraSession
from data_schemas.capture import CaptureSession
from data_schemas.devices import DeviceIdentity
from data_schemas.errors import CaptureError, CurveError
from data_schemas.model import Record
from data_schemas.provenance import provenance
from data_schemas.rig import RigFile
from data_schemas.storage import write_record
from data_schemas.whole_files import sha256_of, write_bytes
from rigs.capture.journal import JOURNAL_NAME, Journal

SESSION_NAME = "session.json"
MANIFEST_NAME = "manifest-sha256.txt"


def require_empty(out: Path) -> None:
    """Refuse a folder that holds something, or a path that is no folder.

    Raises
    ------
    CaptureError
        It does.
    """
    unborn = f".{JOURNAL_NAME}.part"  # of a capture that ended before its first line
    if out.exists() and (not out.is_dir() or any(path.name != unborn for path in out.iterdir())):
        raise CaptureError(
            f"{out}: exists already and is not an empty folder; a capture never overwrites: choose another --out"
        )


def curve_files(rig: RigFile, rig_folder: Path) -> dict[str, str]:
    """Return name -> SHA-256 of the curve files that the rig file names.

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
    return {name: sha256_of(rig_folder / name) for name in named}


def write_start(
    journal: Journal,
    plan: Record,
    rig: RigFile,
    rig_folder: Path,
    inputs: dict[str, str],
    command: str,
    camera: DeviceIdentity,
) -> None:
    """Write the first line of a journal: everything that a resumed session needs."""
    journal.append(
        "start",
        command=command,
        kind=plan.model_dump()["kind"],
        plan=plan.model_dump(mode="json"),
        rig=rig.model_dump(mode="json"),
        rig_folder=str(rig_folder.resolve()),
        inputs=inputs,
        camera=camera.model_dump(mode="json"),
    )


def write_session(session: CaptureSession | CameraSession, out: Path, inputs: dict[str, str], command: str) -> None:
    """Write the record of a finished session."""
    seed = session.rig.simulated.seed if session.rig.simulated is not None else None
    write_record(session, out / SESSION_NAME, provenance(command, inputs, seed))


def write_manifest(out: Path) -> None:
    """Write the checksums of all files of the session in the format of ``sha256sum --check``."""
    files = sorted(path for path in out.rglob("*") if path.is_file())
    lines = [f"{sha256_of(path)}  {path.relative_to(out).as_posix()}\n" for path in files]
    write_bytes(out / MANIFEST_NAME, "".join(lines).encode())


def lacks_manifest(out: Path) -> bool:
    """Whether a session was interrupted when it was finished but for its checksums."""
    return (out / SESSION_NAME).is_file() and not (out / MANIFEST_NAME).exists()
