"""What an interrupted session left: replayed from its journal, so that only what is missing is captured.

Curve files and camera must be as they were when the session began.
"""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final, Literal, TypeVar

from pydantic import ValidationError

from data_schemas import (
    CaptureError,
    DeviceIdentity,
    Frame,
    LightState,
    Record,
    RecordError,
    RigFile,
    digest_of_input,
    explain,
)
from data_schemas.storage import migrate, read_toml, read_toml_tables, sha256_of
from rigs import Clock, OpenRig
from rigs.capture._journal import JOURNAL_NAME, read_journal
from rigs.capture._session_folder import SESSION_NAME, clear_session
from rigs.light_guard import LightLostError, is_hazardous

ORPHANS = "set-aside"
NO_BEGINNING: Final = (
    "the line with which the session begins is missing or incomplete; capture the session again, into another folder"
)
UNFIT_BEGINNING: Final = (
    "its first line does not describe a session that this version can resume; resume with the version that began the "
    "session, or capture it again into another folder"
)
CHANGED_EVENT: Final = "signal changed"
"""Of the line of a journal that tells of a frame unlike its metering: either may be wrong."""
AS_BEFORE_EVENT: Final = "as before"
"""Of the line that says that all is metered again, and agrees with what was metered and stored before."""
SET_ASIDE_EVENT: Final = "set aside"
"""Of the line that says that the frames so far do not count, for the rig was another one when they were taken."""
PROVEN_EVENT: Final = "frames proven"
"""Of the line that says that a lit frame after the dark ones was as metered."""
P = TypeVar("P", bound=Record)


@dataclass(frozen=True, slots=True)
class LaterClock:
    """A clock whose monotonic time goes on where the interrupted part of a session stopped."""

    clock: Clock
    ahead_s: float

    def utc(self) -> str:
        """Return the time of day, ISO 8601, UTC."""
        return self.clock.utc()

    def monotonic_s(self) -> float:
        """Return the seconds of the whole session's time axis."""
        return self.clock.monotonic_s() + self.ahead_s

    def sleep(self, duration_s: float) -> None:
        """Let time pass."""
        self.clock.sleep(duration_s)


@dataclass(frozen=True, slots=True)
class Interrupted:
    """The part of a session that is done.

    Attributes
    ----------
    start
        First line of the journal: command, kind, plan, rig, folder of the rig file, checksums of its curves.
    frames
        Stored frames whose files are there and unchanged, by number.
    metered
        Exposures (s) of the metered steps and their rates (DN/s), by the label of the step.
    dose_j
        Laser light that fell on the sample (J).
    levels
        What a camera session decided after metering; None before.
    ended_s, ended_utc
        Time of the last line.
    lines
        Number of lines of the journal.
    laser_was_lost
        Whether the laser went out by itself and was not lit since.
    doubt
        What a frame said against its metering, where nothing was metered again since; empty otherwise.
    """

    start: dict[str, Any]
    frames: dict[int, Frame] = field(default_factory=dict)
    metered: dict[str, tuple[list[float], tuple[float, float, float]]] = field(default_factory=dict)
    dose_j: float = 0.0
    levels: dict[str, Any] | None = None
    ended_s: float = 0.0
    ended_utc: str = ""
    lines: int = 0
    laser_was_lost: bool = False
    doubt: str = ""

    @property
    def kind(self) -> str:
        """Kind of the session's plan."""
        return str(self.start["kind"])

    @property
    def sources(self) -> dict[str, str]:
        """Path -> SHA-256 of the files that plan and rig were read from."""
        return dict(self.start.get("sources", {}))

    @property
    def rig_folder(self) -> Path:
        """Where relative paths in the rig file start."""
        return Path(str(self.start["rig_folder"]))

    def plan(self, kind: type[P]) -> P:
        """Return the plan of the session.

        Raises
        ------
        CaptureError
            It is none of today's: another version of finray began the session.
        """
        return begun_with("plan", self.start, kind)

    def rig(self) -> RigFile:
        """Return the rig of the session.

        Raises
        ------
        CaptureError
            It is none of today's: another version of finray began the session.
        """
        return begun_with("rig", self.start, RigFile)

    def clock_after(self, clock: Clock) -> LaterClock:
        """Return a clock that goes on after the interruption; the pause is taken from the time of day, if it grew."""
        paused_s = (datetime.fromisoformat(clock.utc()) - datetime.fromisoformat(self.ended_utc)).total_seconds()
        return LaterClock(clock, self.ended_s + max(paused_s, 0.0) - clock.monotonic_s())


def read_interrupted(folder: Path) -> Interrupted:
    """Replay the journal of an interrupted session and re-hash its frames; nothing is changed.

    Frames that are missing, changed or without a line in the journal count as not taken: see :func:`take_over`.

    Raises
    ------
    CaptureError
        The session is finished, or its journal does not say how it began.
    """
    if (folder / SESSION_NAME).exists():
        raise CaptureError(f"{folder}: is finished already ({SESSION_NAME} is there); nothing is left to resume")
    lines = read_journal(folder)
    start = next((line for line in lines if line["event"] == "start"), None)
    if start is None or not {"kind", "plan", "rig", "rig_folder", "inputs"} <= start.keys():
        raise CaptureError(f"{folder / JOURNAL_NAME}: {NO_BEGINNING}")
    rig_camera = start["rig"].get("camera", {}) if isinstance(start["rig"], dict) else {}
    if rig_camera.get("driver") == "folder":
        raise CaptureError(
            f"{folder}: replays a folder of images, so it cannot be resumed, because a replay would begin again with "
            "the first image; capture the session again"
        )
    try:
        interrupted = _replayed(folder, start, lines)
    except (KeyError, TypeError, ValueError):
        raise CaptureError(
            f"{folder / JOURNAL_NAME}: contains lines that finray did not write; restore the file, or capture the "
            "session again into another folder"
        ) from None
    return interrupted


def _contradicts(line: dict[str, Any]) -> bool:
    """Whether a line of a journal tells that the frames contradict the filters."""
    return line["event"] == "filter proof" and line.get("verdict") == "contradicted"


def _replayed(folder: Path, start: dict[str, Any], lines: list[dict[str, Any]]) -> Interrupted:
    """Return what the lines of a journal say."""
    steps, stored, doubt = _in_force(lines)
    doses_j = [float(line.get("sample_dose_j", line.get("laser_dose_j", 0.0))) for line in lines]
    return Interrupted(
        start=start,
        frames=dict(_good_frames(folder, stored)),
        metered={
            line["label"]: ([float(t) for t in line["exposures_s"]], _rates(line["rates_dn_per_s"])) for line in steps
        },
        dose_j=max(doses_j),
        levels=_levels(lines),
        ended_s=float(lines[-1]["monotonic_s"]),
        ended_utc=datetime.fromisoformat(lines[-1]["utc"]).astimezone(UTC).isoformat(),
        lines=len(lines),
        laser_was_lost=_laser_was_lost(lines),
        doubt=doubt,
    )


def is_compared(light: LightState | None) -> bool:
    """Whether a frame in this light is compared with its metering: in the dark and in room light none is."""
    return light in ("lamp", "laser")


def _in_force(lines: list[dict[str, Any]]) -> tuple[list[dict[str, Any]], list[dict[str, Any]], str]:
    """Return the lines of metered steps and of frames that still count, and what was said against them since.

    Once the frames have contradicted the filters somebody looks into the wheel: what was metered and stored before is
    of the wheel as it was, and is taken again. Once a frame has contradicted its metering either may be wrong: what was
    metered before and after the repair is compared, and only then is it known what counts. Frames in the dark and in
    room light count when a later lit one was as metered: a camera that halves exposures unsaid is seen in light only.
    """
    steps: dict[str, dict[str, Any]] = {}
    again: dict[str, dict[str, Any]] = {}
    stored: list[dict[str, Any]] = []
    doubt, proven = "", 0
    for line in lines:
        event = line["event"]
        if _contradicts(line):
            steps, again, stored, doubt = {}, {}, [], ""
        elif event == CHANGED_EVENT:
            doubt, again = str(line["text"]), {}
        elif event == "resume":
            again = {}  # an interrupted repair is proven from its beginning
        elif event == SET_ASIDE_EVENT:
            steps, again, stored, doubt = again, {}, [], ""
        elif event == AS_BEFORE_EVENT:
            again, doubt = {}, ""
        elif event == "step" and "rates_dn_per_s" in line:
            (again if doubt else steps)[line["label"]] = line
        elif event == "frame":
            stored.append(line)
        if event == PROVEN_EVENT or (event == "frame" and is_compared(line.get("light"))):
            proven = len(stored)
    lit = [line for line in stored[proven:] if is_compared(line.get("light"))]
    return list(steps.values()), [*stored[:proven], *lit], doubt


def _levels(lines: list[dict[str, Any]]) -> dict[str, Any] | None:
    """Return what a camera session decided after metering, where its frames were not set aside since."""
    for line in reversed(lines):
        if line["event"] in ("levels", SET_ASIDE_EVENT):
            return line if line["event"] == "levels" else None
    return None


def _laser_was_lost(lines: list[dict[str, Any]]) -> bool:
    """Return whether the last that a journal tells of the laser's light is that it was lost."""
    for line in reversed(lines):
        if line["event"] == "light lost" and str(line["text"]).startswith("light 'laser'"):
            return True
        if line["event"] == "laser on":
            return False
    return False


def _rates(values: Iterable[float]) -> tuple[float, float, float]:
    """Return the rates of red, green and blue (DN/s)."""
    red, green, blue = values
    return float(red), float(green), float(blue)


def begun_with(what: Literal["plan", "rig"], start: dict[str, Any], kind: type[P]) -> P:
    """Return the plan or rig that the first line of a journal holds, migrated to today's version.

    Raises
    ------
    CaptureError
        It is of a version that cannot be migrated, or does not fit.
    """
    version = start.get("schema_versions", {}).get(what, 1)
    try:
        return kind.model_validate(migrate(Path(JOURNAL_NAME), kind, version, dict(start[what])))
    except RecordError as error:
        raise CaptureError(f"{error}; resume with the version that began the session, or capture it again") from None
    except ValidationError as error:
        raise CaptureError(
            f"{JOURNAL_NAME}: the {what} in its first line does not fit this version of finray "
            f"({explain(error, kind)}); "
            "resume with the version that began the session, or capture it again"
        ) from None


def take_over(folder: Path, interrupted: Interrupted) -> None:
    """Move the frame files that nothing vouches for into the folder "set-aside"; the journal must be ours by now.

    Raises
    ------
    CaptureError
        The session went on since it was read.
    """
    if (folder / SESSION_NAME).exists() or len(read_journal(folder)) != interrupted.lines:
        raise CaptureError(
            f"{folder}: another capture has continued this session in the meantime; check what it stored"
        )
    clear_session(folder)
    move_aside(folder, unvouched_files(folder, interrupted))


def rig_as_it_is(rig: RigFile, rig_folder: Path, sources: Mapping[str, str]) -> tuple[RigFile, dict[str, str]]:
    """Return the rig to be opened: that of the session, without a practice fault that was taken out of its file since.

    A fault stands for what is wrong at the rig, which a person mends between two parts of a session, or within it. All
    else in the file is as it was when the session began, and so is the record of the session.

    Parameters
    ----------
    rig
        Of the session.
    rig_folder
        Where the rig file is.
    sources
        Path -> SHA-256 of the files that plan and rig were read from.

    Returns
    -------
    present, sources
        The rig, and the files with the SHA-256 of the rig file that was read now.

    Raises
    ------
    RecordError
        The rig file is there and cannot be read.
    """
    if rig.simulated is None or rig.simulated.practice_fault is None:
        return rig, dict(sources)
    for name in sources:
        path = rig_folder / Path(name).name
        if path.suffix == ".toml" and path.is_file() and "simulated" in read_toml_tables(path):
            now = read_toml(path, RigFile).simulated
            bench = rig.simulated.model_copy(update={"practice_fault": None if now is None else now.practice_fault})
            return rig.model_copy(update={"simulated": bench}), {**sources, name: digest_of_input(path)}
    return rig, dict(sources)


def resume_notes(
    folder: Path,
    doubt: str = "lamp, laser and temperature may have changed meanwhile, and the laser dose does not include the "
    "light between the last stored frame and the interruption",
) -> tuple[str, ...]:
    """Return what the user of a resumed session should know, with every interruption that its journal holds."""
    counts = [str(line["frames"]) for line in read_journal(folder) if line["event"] == "resume" and "frames" in line]
    if not counts:
        return ()
    return (f"interrupted after {', '.join(counts)} frame{'' if counts == ['1'] else 's'} and resumed: {doubt}",)


def stored_before(interrupted: Interrupted) -> dict[str, Any]:
    """Return what the journal's line of a resumed session says: its frames, and those in light of each filter."""
    lit = [frame.filter_name for frame in interrupted.frames.values() if frame.filter_name and frame.light != "off"]
    return {"frames": len(interrupted.frames), "filters": dict(Counter(lit))}


def _good_frames(folder: Path, lines: list[dict[str, Any]]) -> Iterable[tuple[int, Frame]]:
    """Yield number and record of every frame whose file is there and unchanged."""
    for line in lines:
        try:
            frame = Frame.model_validate({k: v for k, v in line.items() if k in Frame.model_fields})
        except ValidationError:
            continue
        path = folder / frame.file
        if path.is_file() and not path.is_symlink() and sha256_of(path) == frame.sha256:
            yield frame.sequence, frame


def set_aside(folder: Path, known: set[str]) -> None:
    """Move frame files that are not `known` out of the way; nothing is deleted."""
    move_aside(folder, _unknown(folder, known))


def unvouched_files(folder: Path, interrupted: Interrupted) -> list[Path]:
    """Return the files among the frames of an interrupted session that nothing vouches for."""
    return _unknown(folder, {frame.file for frame in interrupted.frames.values()})


def _unknown(folder: Path, known: set[str]) -> list[Path]:
    return [path for path in sorted((folder / "frames").glob("*")) if path.relative_to(folder).as_posix() not in known]


def move_aside(folder: Path, files: Iterable[Path]) -> None:
    """Move files of a session out of the way, beside those of the same name that were moved before."""
    aside = folder / ORPHANS
    for path in files:
        aside.mkdir(exist_ok=True)
        number = len(list(aside.iterdir()))
        while (place := aside / f"{number:04d}_{path.name.lstrip('.')}").exists():  # a person took others away
            number += 1
        path.rename(place)


def require_same_inputs(interrupted: Interrupted, inputs: dict[str, str]) -> None:
    """Refuse to go on with other curves than the session began with.

    Raises
    ------
    CaptureError
        A curve file changed.
    """
    before: dict[str, str] = interrupted.start["inputs"]  # earlier versions did not note the lamp's spectrum
    changed = sorted(name for name, digest in before.items() if inputs.get(name) != digest)
    if changed:
        raise CaptureError(
            f"{changed[0]}: has changed since the session began; restore the file, or capture the session again"
        )


def require_same_devices(interrupted: Interrupted, devices: Sequence[DeviceIdentity]) -> None:
    """Refuse to go on with other devices than the session began with: an address may have another behind it now.

    Of the others only a serial number tells it, and of wheels none is known.

    Raises
    ------
    CaptureError
        Another camera or board answers, or a board's serial number is not known now; sessions of old versions do not
        say which it was.
    """
    camera, *others = devices
    before = interrupted.start.get("camera")
    if before is not None and _named(before) != _named(camera.model_dump()):
        raise CaptureError(
            f"camera: {_named(camera.model_dump())} is connected now, but the session began with {_named(before)}; "
            "connect the first camera again, or capture the session again"
        )
    serials: dict[str, str] = interrupted.start.get("serials", {})
    for device in others:
        began = serials.get(device.role, "")
        if began and device.serial != began:
            raise CaptureError(
                f"{device.role} at {device.address}: the board with serial number '{device.serial}' is connected now, "
                f"but the session began with '{began}'; plug the boards in as before, or capture the session again"
            )


def _named(camera: Any) -> str:
    """Return a camera in words; a new firmware does not make it another."""
    said = camera if isinstance(camera, dict) else {}
    return f"{said.get('vendor', '')} {said.get('model', '')} (serial '{said.get('serial', '')}')".strip()


def as_before(opened: OpenRig, rig: RigFile, devices: Sequence[DeviceIdentity], interrupted: Interrupted) -> OpenRig:
    """Return the rig with the clock of an interrupted session, after asking for a laser that was lost in it."""
    require_same_devices(interrupted, devices)
    _require_permission(interrupted, rig, opened)
    return replace(opened, clock=interrupted.clock_after(opened.clock))


def _require_permission(interrupted: Interrupted, rig: RigFile, opened: OpenRig) -> None:
    """Ask before a laser that harms eyes is lit again in a session in which it was lost."""
    question = (
        "The laser went off or stopped answering before this session ended. Is the box closed, does everybody wear "
        "goggles, and may the laser be lit again?"
    )
    if interrupted.laser_was_lost and is_hazardous(rig.laser) and not opened.operator.allows(question):
        raise LightLostError(
            "laser: went off or stopped answering in this session, and is lit again only if a person at the terminal "
            "says that the box is closed; find out why it went off, close the box, then run the same command in a "
            "terminal"
        )
