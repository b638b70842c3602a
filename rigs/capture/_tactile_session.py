"""Capture of a tactile session: board, no contact, and each press between images of no contact.

A person presses, or a stage with a load cell does by itself (:mod:`rigs.capture._stage_press`). The frames become the
tactile capture of each contact; an interrupted session is replayed from its journal.
"""

import math
from collections import Counter
from collections.abc import Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from typing import Final, NoReturn

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from data_schemas import (
    CaptureError,
    DeviceIdentity,
    IndenterPose,
    LoadCellCalibration,
    MeasuredPress,
    PlannedPress,
    RecordError,
    SignalChangedError,
    TactileCapture,
    TactileFrame,
    TactilePlan,
    TactileRig,
    TactileSession,
    provenance,
)
from data_schemas.storage import read_frame, sha256_of, write_frame, write_manifest, write_record
from rigs import RawFrame, driver_notes
from rigs.capture._exposure import (
    CAMERA_DEADLINE_MARGIN_S,
    DEADLINE_EXPOSURES,
    TactileCamera,
    saturated_fraction,
)
from rigs.capture._filter_proof import LEAST_SIGNAL_FRACTION
from rigs.capture._force_gauge import (
    SETTLING_READINGS,
    ZERO_MOVED_SHARE,
    OpenTactileRig,
    calibration_notes,
    open_tactile_rig,
    read_cell_calibration,
)
from rigs.capture._frame_store import BYTES_PER_PIXEL, LARGEST_CHANGE, require_space
from rigs.capture._journal import (
    JOURNAL_NAME,
    Journal,
    StatedTimes,
    fault_notes,
    faults_noted,
    healing_s,
    not_written,
    read_journal,
)
from rigs.capture._plan import TactileShot, instruction, press_of, tactile_shots
from rigs.capture._resume import CHANGED_EVENT, NO_BEGINNING, UNFIT_BEGINNING, begun_with, move_aside, resume_notes
from rigs.capture._session_folder import SESSION_NAME, SessionRequest, clear_session, require_empty, write_session
from rigs.capture._stage_press import EXCHANGE_S, HOMING_WITHIN_S, StagePress, contact_times, replayed_presses

Triple = tuple[TactileFrame, TactileFrame, TactileFrame]
MOST_SATURATED_FRACTION = 1e-3
"""A glint may saturate; a larger clipped part hides the press."""


def capture_file(contact: int) -> str:
    """Return the name of the record of a contact (from 1)."""
    return f"press-{contact:03d}.json"


def tactile_capture(
    folder: Path,
    plan: TactilePlan,
    rig: TactileRig,
    press: PlannedPress,
    contact: int,
    session: TactileSession,
) -> TactileCapture:
    """Return the images of one contact: those of the longest exposure at which hardly anything saturates.

    The no-contact image is the last one before, its repeat the first one after the contact.

    Parameters
    ----------
    folder
        Folder of the session.
    plan, rig, press
        What was captured with what.
    contact
        Number of the contact, from 1.
    session
        Its frames, and what stage and load cell measured.

    Raises
    ------
    CaptureError
        A frame of the contact is missing.
    ChecksumError
        A frame was changed.
    """
    triples = _triples(session.frames, contact)
    bracket_s = tuple(sorted(triples))
    if not bracket_s:
        raise CaptureError(f"{folder}: has no complete set of frames of contact {contact}; capture it again")
    shown, before, after = _best(triples)
    images = [_image(folder, frame) for frame in (shown, before, after)]
    raw = images[0].shape[2] == 1
    measured = next((press for press in session.measured if press.contact == contact), None)
    read_black_dn = shown.settings.get("black_level_dn", rig.camera.black_level_dn)
    return TactileCapture(
        name=f"{plan.name}, press {press_of(contact, plan.repeats) + 1}, contact {contact}",
        contact=images[0],
        no_contact=images[1],
        repeat_no_contact=images[2],
        layout="Bayer RGGB" if raw else "RGB",
        encoding="linear" if raw else "unknown",
        bit_depth=rig.camera.bit_depth,
        black_level_dn=float(read_black_dn) if raw else 0.0,
        exposure_s=shown.exposure_s,
        light_angle_deg=plan.light_angle_deg,
        light_angle_uncertainty_deg=plan.light_angle_uncertainty_deg,
        led_current_ma=plan.led_current_ma,
        exposure_bracket_s=bracket_s if len(bracket_s) > 1 else (),
        indenter=_pose(press, plan, measured),
        force_n=None if measured is None else measured.force_n,
        force_uncertainty_n=None if measured is None else measured.force_uncertainty_n,
        press=measured,
        load_cell=None if measured is None else session.load_cell,
        contact_circle=None,
        mm_per_px=plan.mm_per_px,
        mm_per_px_u_rel=plan.mm_per_px_u_rel,
        rig=f"{rig.name}, {rig.camera.driver} {rig.camera.address}, {plan.design}",
        source=f"tactile session '{folder.resolve().name}', {plan.design}, camera {rig.camera.driver}, frame "
        f"{shown.sequence} at {shown.captured_utc}",
    )


def _pose(press: PlannedPress, plan: TactilePlan, measured: MeasuredPress | None) -> IndenterPose:
    """Return the pose of a press: as a person was asked for it, or with the depth that the stage reached."""
    pose = press.pose(plan.indenter)
    if measured is None:
        return pose
    reached = {"depth_mm": measured.depth_mm, "depth_uncertainty_mm": measured.depth_uncertainty_mm}
    return pose.model_copy(update=reached)


def clipping_notes(frames: Sequence[TactileFrame], contacts: int) -> tuple[str, ...]:
    """Name the contacts that are clipped even at the shortest exposure of the session."""
    notes = []
    for contact in range(1, contacts + 1):
        clipped = max(frame.saturated_fraction for frame in _best(_triples(frames, contact)))
        if clipped > MOST_SATURATED_FRACTION:
            notes.append(
                f"contact {contact}: {100 * clipped:.1f} % of an image is clipped even at the shortest exposure, and "
                "comparisons leave these pixels out; add shorter exposures, or dim the LEDs"
            )
    return tuple(notes)


def _best(triples: dict[float, Triple]) -> Triple:
    """Return the images of the longest exposure at which hardly anything saturates, else of the shortest one."""
    good = [
        asked_s
        for asked_s, images in triples.items()
        if max(frame.saturated_fraction for frame in images) <= MOST_SATURATED_FRACTION
    ]
    return triples[max(good) if good else min(triples)]


def _triples(frames: Sequence[TactileFrame], contact: int) -> dict[float, Triple]:
    """Return contact, no contact before and no contact after for each exposure that was asked for."""

    def of(frame_type: str, place: int) -> dict[float, list[TactileFrame]]:
        found: dict[float, list[TactileFrame]] = {}
        for frame in frames:
            if (frame.frame_type, frame.place) == (frame_type, place):
                found.setdefault(frame.exposure_requested_s, []).append(frame)
        return found

    shown, before, after = of("contact", contact), of("no contact", contact - 1), of("no contact", contact)
    return {t: (shown[t][0], before[t][-1], after[t][0]) for t in shown.keys() & before.keys() & after.keys()}


def _image(folder: Path, frame: TactileFrame) -> NDArray[np.uint16]:
    """Return a stored frame as (rows, columns, samples)."""
    path = folder / frame.file
    if not path.resolve().is_relative_to(folder.resolve()):
        raise RecordError(f"{path}: points outside the session's folder; frames must be plain files inside it")
    image = read_frame(path, frame.sha256)
    return image[..., None] if image.ndim == 2 else image


KIND = "tactile"
PRESS_DOUBT: Final = (
    "light and gel may have changed between the contact before the interruption and the image of no contact after it"
)


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
    measured
        What stage and load cell measured of the contacts that are done.
    """

    plan: TactilePlan
    rig: TactileRig
    presses: tuple[PlannedPress, ...]
    rig_folder: Path
    frames: dict[int, TactileFrame]
    device: DeviceIdentity | None
    lines: int
    sources: dict[str, str]
    measured: dict[int, MeasuredPress]


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
    except (StopIteration, KeyError):
        raise CaptureError(f"{folder / JOURNAL_NAME}: {NO_BEGINNING}") from None
    except (TypeError, ValueError):
        raise CaptureError(f"{folder / JOURNAL_NAME}: {UNFIT_BEGINNING}") from None
    if rig.camera.driver == "folder":
        raise CaptureError(
            f"{folder}: replays a folder of images, so it cannot be resumed, because a replay would begin again with "
            "the first image; capture the session again, into another folder"
        )
    good, newest = dict[int, TactileFrame](), 0
    for line in lines:
        if line["event"] == CHANGED_EVENT:  # the contact before it may be of another light or exposure
            contact = ("contact", line.get("place", newest))  # older versions did not note the place
            good = {n: frame for n, frame in good.items() if (frame.frame_type, frame.place) != contact}
        frame = _frame(line) if line["event"] == "frame" else None
        if frame is not None and _is_unchanged(folder, frame):
            good[frame.sequence] = frame
            newest = frame.place if frame.frame_type == "contact" else newest
    shots = tactile_shots(plan, rig.camera, len(presses))
    wanted = Counter(shot.group for shot in shots)
    there = Counter(shot.group for shot in shots if shot.sequence in good)
    measured = replayed_presses(lines) if rig.stage is not None else {}
    if rig.load_cell is not None:
        # one without its zero, or whose zero moved too far, is pressed again
        most_n = ZERO_MOVED_SHARE * rig.load_cell.force_limit_n
        measured = {c: m for c, m in measured.items() if m.zero_shift_n is not None and abs(m.zero_shift_n) <= most_n}

    def is_complete(shot: TactileShot) -> bool:
        pressed = rig.stage is None or shot.frame_type != "contact" or shot.place in measured
        return pressed and there[shot.group] == wanted[shot.group]

    whole = {shot.sequence: good[shot.sequence] for shot in shots if is_complete(shot)}
    sources = start.get("sources", {})
    return InterruptedPresses(plan, rig, presses, rig_folder, whole, device, len(lines), sources, measured)


def take_over(folder: Path, interrupted: InterruptedPresses, device: DeviceIdentity) -> None:
    """Move what will be made anew into the folder "set-aside": other frames, and captures; the journal must be ours.

    Raises
    ------
    CaptureError
        The session went on since it was read, or another camera answers now.
    """
    if (folder / SESSION_NAME).exists() or len(read_journal(folder)) != interrupted.lines:
        raise CaptureError(
            f"{folder}: another capture has continued this session in the meantime; check what it stored"
        )
    if interrupted.device not in (None, device):
        raise CaptureError(
            f"camera: {device.model} (serial '{device.serial}') is connected now, but the session began with "
            f"{interrupted.device}; connect the first camera again, or capture the session again"
        )
    clear_session(folder)
    known = {folder / frame.file for frame in interrupted.frames.values()}
    frames = [path for path in sorted((folder / "frames").glob("*")) if path not in known]
    move_aside(folder, (*frames, *sorted(folder.glob("press-*"))))


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


SAMPLES_OF_RGB = 3
IMAGES_OF_A_CAPTURE = 3


def capture_tactile_session(
    rig: TactileRig,
    plan: TactilePlan,
    presses: tuple[PlannedPress, ...],
    request: SessionRequest,
    *,
    interrupted: InterruptedPresses | None = None,
) -> TactileSession:
    """Capture a tactile session: frames, journal, a tactile capture of each contact, ``session.json``, checksums.

    Parameters
    ----------
    rig, plan
        The camera and what to capture with it.
    presses
        Those of the plan or of its file of poses (:func:`~rigs.capture.planned_presses`).
    request
        Where the session goes, who presses, and what its record says of both.
    interrupted
        What is done already, when a session is resumed.

    Raises
    ------
    CaptureError
        The plan does not fit the rig, the folder is not empty, another capture uses the camera, or the camera did not
        do what was asked.
    """
    out = request.out
    shots = tactile_shots(plan, rig.camera, len(presses))
    require_pressable(rig, presses)
    calibration = None if rig.load_cell is None else read_cell_calibration(rig.load_cell, request.rig_folder)
    if interrupted is None:
        require_empty(out)
    with open_tactile_rig(rig, request.rig_folder, request.operator) as opened:
        out.mkdir(parents=True, exist_ok=True)
        camera = opened.camera_there()
        with Journal(out, opened.clock, resumed=interrupted is not None, told=request.watch.noted) as journal:
            recorder = _Recorder(opened, rig, plan, presses, journal, request, calibration)
            device = camera.identity()
            if interrupted is None:
                _write_start(journal, rig, plan, presses, request, device)
            else:
                take_over(out, interrupted, device)
                recorder.frames.update(interrupted.frames)
                recorder.take_levels()
                recorder.continue_from(interrupted.measured)
                journal.append("resume", frames=len(interrupted.frames))
            with faults_noted(journal, out, stated_times(rig, plan, presses).healing_s):
                recorder.record(shots)
            doubts = () if calibration is None else calibration_notes(rig, calibration)
            notes = (*driver_notes(rig), *doubts, *resume_notes(out, PRESS_DOUBT), *fault_notes(out))
            session = _session_of(plan, rig, presses, recorder, device, notes).model_copy(
                update={"press_devices": opened.press_devices(), "load_cell": calibration}
            )
            _write_captures(session, out, request.command)
            noted = dict(request.sources) if interrupted is None else interrupted.sources
            write_session(session, out, noted, request.command, journal)
    write_manifest(out)
    return session


def _session_of(
    plan: TactilePlan,
    rig: TactileRig,
    presses: tuple[PlannedPress, ...],
    recorder: "_Recorder",
    device: DeviceIdentity,
    notes: tuple[str, ...],
) -> TactileSession:
    """Return the record of a session all of whose frames are there."""
    frames = tuple(frame for _, frame in sorted(recorder.frames.items()))
    contacts = len(presses) * plan.repeats
    return TactileSession(
        plan=plan,
        rig=rig,
        presses=presses,
        frames=frames,
        captures=tuple(capture_file(contact) for contact in range(1, contacts + 1)),
        devices=(device,),
        measured=tuple(press for _, press in sorted(recorder.measured.items())),
        notes=(*notes, *clipping_notes(frames, contacts)),
    )


def _write_start(
    journal: Journal,
    rig: TactileRig,
    plan: TactilePlan,
    presses: Sequence[PlannedPress],
    request: SessionRequest,
    device: DeviceIdentity,
) -> None:
    """Write the first line of the journal: everything that a resumed session needs."""
    journal.append(
        "start",
        command=request.command,
        kind=KIND,
        plan=plan.model_dump(mode="json"),
        rig=rig.model_dump(mode="json"),
        rig_folder=str(request.rig_folder.resolve()),
        presses=[press.model_dump(mode="json") for press in presses],
        device=device.model_dump(mode="json"),
        sources=dict(request.sources),
        schema_versions={"plan": plan.schema_version, "rig": rig.schema_version},
    )


def _write_captures(session: TactileSession, out: Path, command: str) -> None:
    """Write the tactile capture of each contact."""
    for contact, name in enumerate(session.captures, 1):
        press = session.presses[press_of(contact, session.plan.repeats)]
        capture = tactile_capture(out, session.plan, session.rig, press, contact, session)
        groups = (("no contact", contact - 1), ("contact", contact), ("no contact", contact))
        used = {frame.file: frame.sha256 for frame in session.frames if (frame.frame_type, frame.place) in groups}
        write_record(capture, out / name, provenance(command, used, None))


def session_bytes(rig: TactileRig, plan: TactilePlan, presses: int, frames: int) -> int:
    """Return the space on the disk (bytes) of so many frames and of the captures made of them."""
    camera = rig.camera
    samples = SAMPLES_OF_RGB if camera.driver == "mjpeg" else 1
    images = frames + IMAGES_OF_A_CAPTURE * presses * plan.repeats
    return images * camera.width_px * camera.height_px * samples * BYTES_PER_PIXEL


def require_pressable(rig: TactileRig, presses: Sequence[PlannedPress]) -> None:
    """Refuse forces that nothing measures, and presses that a stage cannot make.

    Raises
    ------
    CaptureError
        A press names a force and the rig has no load cell, needs a tilt, or lies beyond the stage's travel.
    """
    for number, press in enumerate(presses, 1):
        where = f"plan.presses (entry {number})"
        if rig.stage is None or rig.load_cell is None:
            if press.until_force_n is not None or press.force_limit_n is not None:
                raise CaptureError(
                    f"{where}: gives a force, but the rig has no stage with a load cell, so a press cannot stop at a "
                    "force; describe stage and load cell in the rig file, or leave the force out"
                )
            continue
        if press.tilt_deg:
            raise CaptureError(f"{where}: tilt_deg = {press.tilt_deg:g}, but the stage cannot tilt; leave tilt_deg out")
        if (press.until_force_n or 0.0) >= rig.load_cell.force_limit_n:
            raise CaptureError(
                f"{where}: until_force_n must be below force_limit_n of the rig file, {rig.load_cell.force_limit_n:g} N"
            )
        most_mm = abs(rig.stage.deepest_mm - rig.stage.clear_mm)
        if press.depth_mm > most_mm:
            raise CaptureError(
                f"{where}: depth_mm = {press.depth_mm:g} is more than the {most_mm:g} mm from clear_mm to the end of "
                "press_travel_mm; press less deeply, or correct the rig file"
            )
        low_mm, high_mm = rig.stage.pad_travel_mm
        at_mm = rig.stage.base_mm + rig.stage.from_base * press.position_mm
        if not low_mm <= at_mm <= high_mm:
            raise CaptureError(
                f"{where}: position_mm = {press.position_mm:g} leads to {rig.stage.pad_axis} = {at_mm:g} mm, outside "
                f"the stage's travel of {low_mm:g} to {high_mm:g} mm; correct position_mm, or the rig file"
            )


FRAME_S: Final = 0.3
"""Reading out, checking and writing a frame, beside its exposure: typical of the cameras here."""


def stated_times(rig: TactileRig, plan: TactilePlan, presses: Sequence[PlannedPress]) -> StatedTimes:
    """Return what a tactile session takes: its exposures and, where a stage presses, the time of the stage.

    At the longest every frame waits for the camera's deadline, and the stage goes through all of its travel.
    """
    exposures_s = [shot.exposure_s for shot in tactile_shots(plan, rig.camera, len(presses))]
    typical_s = sum(exposures_s) + FRAME_S * len(exposures_s)
    longest_s = sum(DEADLINE_EXPOSURES * t + CAMERA_DEADLINE_MARGIN_S for t in exposures_s)
    if rig.stage is not None and rig.load_cell is not None:
        each = [contact_times(rig.stage, rig.load_cell, press) for press in presses]
        typical_s += plan.repeats * sum(times.typical_s for times in each)
        # homing, and the way from its zero to clear_mm in steps
        steps = max(abs(end_mm - rig.stage.clear_mm) for end_mm in rig.stage.press_travel_mm) / rig.stage.step_mm
        longest_s += HOMING_WITHIN_S + steps * (
            EXCHANGE_S + rig.stage.step_mm / rig.stage.press_speed_mm_per_s + SETTLING_READINGS / rig.load_cell.rate_hz
        )
        longest_s += plan.repeats * sum(times.longest_s for times in each)
    return StatedTimes(typical_s, longest_s, healing_s(typical_s))


class _Recorder:
    """Takes and stores the frames of one session."""

    def __init__(
        self,
        opened: OpenTactileRig,
        rig: TactileRig,
        plan: TactilePlan,
        presses: tuple[PlannedPress, ...],
        journal: Journal,
        request: SessionRequest,
        calibration: LoadCellCalibration | None,
    ):
        self._plan, self._presses, self._out, self._journal = plan, presses, request.out, journal
        self._clock, self._operator, self._progress = opened.clock, opened.operator, request.tell
        self._rig, self._watch = rig, request.watch
        camera, one_exposure = opened.camera_there(), len(plan.bracket_s(rig.camera)) == 1
        self._camera = TactileCamera(
            camera, rig.camera, one_exposure, lambda text: journal.append("refused", text=text)
        )
        self._stage = None if calibration is None else StagePress(opened, rig, calibration, journal.append)
        self._levels_dn: dict[float, float] = {}
        self.frames: dict[int, TactileFrame] = {}
        self.measured: dict[int, MeasuredPress] = {} if self._stage is None else self._stage.measured

    def continue_from(self, measured: dict[int, MeasuredPress]) -> None:
        """Take over the contacts that are done, and where each place was touched: a finger that moved is found."""
        self.measured.update(measured)
        for contact, press in sorted(measured.items()):
            if self._stage is not None:
                place_mm = self._presses[press_of(contact, self._plan.repeats)].position_mm
                self._stage.touches.setdefault(place_mm, (press.touch_mm, press.touch_uncertainty_mm))

    def record(self, shots: tuple[TactileShot, ...]) -> None:
        """Have everything done that needs hands, and take the frames that are missing."""
        missing = [shot for shot in shots if shot.sequence not in self.frames]
        require_space(self._out, session_bytes(self._rig, self._plan, len(self._presses), len(missing)))
        self._watch.expects([(None, shot.exposure_s) for shot in missing])
        with nullcontext() if self._stage is None else self._stage.standing_by():
            for _, group in groupby(missing, key=lambda shot: shot.group):
                todo = list(group)
                self._make_ready(todo[0])
                for shot in todo:
                    self._take(shot)
                    self._progress(len(self.frames), len(shots), shot.label)
                if self._stage is not None and todo[0].frame_type == "contact":
                    self._stage.seen()
            if self._stage is not None:
                self._stage.leave()

    def _make_ready(self, shot: TactileShot) -> None:
        """Have the pad as a frame needs it: the stage presses and leaves, a person does all else."""
        if self._stage is None or shot.frame_type == "board" or shot.group == ("no contact", 0):
            self._operator.do(instruction(shot, self._plan, self._presses))
        if self._stage is None or shot.frame_type == "board":
            return
        if shot.frame_type == "contact":
            self._stage.press(self._presses[press_of(shot.place, self._plan.repeats)], shot.place)
        else:
            self._stage.leave()

    def take_levels(self) -> None:
        """Take over how bright the pad was at first, at each exposure, from the stored images of no contact."""
        for _, frame in sorted(self.frames.items()):
            is_compared = frame.frame_type == "no contact" and frame.exposure_s is not None
            if is_compared and frame.exposure_requested_s not in self._levels_dn:
                self._is_changed(frame.exposure_requested_s, read_frame(self._out / frame.file, frame.sha256))

    def _level_dn(self, counts: NDArray[np.uint16]) -> float:
        """Return the mean above the black level (DN)."""
        return float(counts.mean()) - self._rig.camera.black_level_dn

    def _is_changed(self, exposure_s: float, counts: NDArray[np.uint16]) -> bool:
        """Whether an image of no contact is not as bright as the first one at its exposure, where that is bright."""
        now_dn = self._level_dn(counts)
        first_dn = self._levels_dn.setdefault(exposure_s, now_dn)
        if max(first_dn, now_dn) < LEAST_SIGNAL_FRACTION * 2**self._rig.camera.bit_depth:
            return False
        return not first_dn / LARGEST_CHANGE < now_dn < first_dn * LARGEST_CHANGE

    def _refuse(self, shot: TactileShot, raw: RawFrame) -> NoReturn:
        """End a session whose images of no contact changed: the contact before it does not count."""
        text = (
            f"camera: {shot.label} gives {self._level_dn(raw.counts):.4g} DN on average, but the first image of no "
            f"contact gave {self._levels_dn[shot.exposure_s]:.4g} DN at the same exposure, a change "
            f"beyond the factor of {LARGEST_CHANGE:g} that is allowed. Light, camera exposure or room changed, or "
            "something still touches the pad; restart the camera, check the light, then resume (the contact before "
            "this image is repeated). If the first images are the wrong ones, capture into another folder"
        )
        self._journal.append(CHANGED_EVENT, text=text, place=shot.place)
        raise SignalChangedError(text)

    def _take(self, shot: TactileShot) -> None:
        """Take a frame, write it, then its line of the journal."""
        raw, attempts = self._camera.expose(shot.exposure_s)
        # a camera that does not say how long it exposes may choose it by itself
        is_compared = shot.frame_type == "no contact" and math.isfinite(raw.exposure_s)
        if is_compared and self._is_changed(shot.exposure_s, raw.counts):
            self._journal.append("refused", text=f"{shot.label}: not as bright as the first one; another was taken")
            raw, attempts = self._camera.expose(shot.exposure_s)
            if self._is_changed(shot.exposure_s, raw.counts):
                self._refuse(shot, raw)
        self._watch.frame(shot.label, raw)
        captured_s = self._clock.monotonic_s()
        kind = shot.frame_type.replace(" ", "-")
        file = f"frames/{shot.sequence:05d}_{kind}_{shot.place}_{round(shot.exposure_s * 1e6)}us.tiff"
        try:
            sha256 = write_frame(self._out / file, raw.counts, shot.label)
        except OSError as error:
            raise not_written(self._out / file, error, self._out) from None
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
