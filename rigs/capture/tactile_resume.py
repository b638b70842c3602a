"""What an interrupted tactile session left, replayed from its journal."""

from collections import Counter
from dataclasses import dataclass
from pathlib import Path

from pydantic import ValidationError

from data_schemas.devices import DeviceIdentity
from data_schemas.errors import CaptureError
from data_schemas.tactile import PlannedPress, TactileFrame, TactilePlan, TactileRig
from data_schemas.whole_files import sha256_of
from rigs.capture.journal import JOURNAL_NAME, read_journal
from rigs.capture.resume import ORPHANS, begun_with
from rigs.capture.session_folder import SESSION_NAME, clear_session
from rigs.capture.tactile_plan import tactile_shots

KIND = "tactile"


@dataclass(frozen=True, slots=True)
class InterruptedPresses:
    """The part of a tactile session that is done.

    Attributes
    ----------
    plan, rig, presses
        As the session began.
    rig_folder
        Where relative paths in the rig file start.
    frames
        Stored frames whose files are there and unchanged, by number: those of whole groups only, since a press that
        is done again is another press.
    device
        The camera that took them; None where the journal does not say it.
    lines
        Number of lines of the journal.
    sources
        Path -> SHA-256 of the files that plan, poses and rig were read from.
    """

    plan: TactilePlan
    rig: TactileRig
    presses: tuple[PlannedPress, ...]
    rig_folder: Path
    frames: dict[int, TactileFrame]
    device: DeviceIdentity | None
    lines: int
    sources: dict[str, str]

    @property
    def notes(self) -> tuple[str, ...]:
        """What the user of the resumed session should know."""
        return (
            f"interrupted after {len(self.frames)} frames and resumed: the light and the gel may have changed between "
            "the contact before the interruption and the image of no contact after it",
        )


def is_tactile(folder: Path) -> bool:
    """Whether the interrupted session in `folder` is a tactile one.

    Raises
    ------
    CaptureError
        There is no journal.
    """
    return any(line["event"] == "start" and line.get("kind") == KIND for line in read_journal(folder))


def read_interrupted_presses(folder: Path) -> InterruptedPresses:
    """Replay the journal of an interrupted tactile session and re-hash its frames; nothing is changed.

    Raises
    ------
    CaptureError
        The session is finished, its journal does not say how it began, or it replays a folder of images.
    """
    if (folder / SESSION_NAME).exists():
        raise CaptureError(f"{folder}: is finished already ({SESSION_NAME} is there); nothing is left to resume")
    lines = read_journal(folder)
    try:
        start = next(line for line in lines if line["event"] == "start" and line.get("kind") == KIND)
        plan, rig = begun_with("plan", start, TactilePlan), begun_with("rig", start, TactileRig)
        presses = tuple(PlannedPress.model_validate(press) for press in start["presses"])
        rig_folder = Path(start["rig_folder"])
        device = DeviceIdentity.model_validate(start["device"]) if "device" in start else None
    except (StopIteration, KeyError, TypeError, ValidationError):
        raise CaptureError(
            f"{folder / JOURNAL_NAME}: does not say how the session began; capture it again into another folder"
        ) from None
    if rig.camera.driver == "folder":
        raise CaptureError(
            f"{folder}: replays a folder of images, which would begin with its first image again; capture it again "
            "into another folder"
        )
    good = {}
    for line in lines:
        frame = _frame(line) if line["event"] == "frame" else None
        if frame is not None and _is_unchanged(folder, frame):
            good[frame.sequence] = frame
    shots = tactile_shots(plan, rig.camera, len(presses))
    wanted = Counter(shot.group for shot in shots)
    there = Counter(shot.group for shot in shots if shot.sequence in good)
    whole = {shot.sequence: good[shot.sequence] for shot in shots if there[shot.group] == wanted[shot.group]}
    return InterruptedPresses(plan, rig, presses, rig_folder, whole, device, len(lines), start.get("sources", {}))


def take_over(folder: Path, interrupted: InterruptedPresses, device: DeviceIdentity) -> None:
    """Move what will be made anew into the folder "set-aside": other frames, and captures; the journal must be ours.

    Raises
    ------
    CaptureError
        The session went on since it was read, or another camera answers now.
    """
    if (folder / SESSION_NAME).exists() or len(read_journal(folder)) != interrupted.lines:
        raise CaptureError(f"{folder}: another capture went on with this session meanwhile; look at what it did")
    if interrupted.device not in (None, device):
        raise CaptureError(
            f"camera: {device.model} (serial '{device.serial}') answers now; the session began with "
            f"{interrupted.device}: connect that one, or capture the session again"
        )
    clear_session(folder)
    known = {folder / frame.file for frame in interrupted.frames.values()}
    frames = [path for path in sorted((folder / "frames").glob("*")) if path not in known]
    for path in (*frames, *sorted(folder.glob("press-*"))):
        aside = folder / ORPHANS
        aside.mkdir(exist_ok=True)
        path.rename(aside / f"{len(list(aside.iterdir())):04d}_{path.name.lstrip('.')}")


def _frame(line: dict[str, object]) -> TactileFrame | None:
    """Return the record of a frame; None where the line is no such record."""
    try:
        return TactileFrame.model_validate({k: v for k, v in line.items() if k in TactileFrame.model_fields})
    except ValidationError:
        return None


def _is_unchanged(folder: Path, frame: TactileFrame) -> bool:
    """Whether the file of a frame is there as it was written."""
    path = folder / frame.file
    return path.is_file() and not path.is_symlink() and sha256_of(path) == frame.sha256
