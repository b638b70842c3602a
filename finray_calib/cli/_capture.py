"""``finray capture``: run a capture plan on a rig and store the session, or go on with an interrupted one.

The plan says which kind of session it is: paint, camera or tactile.
"""

import argparse
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from finray_calib.cli._output import Progress, give, guide, progress_bar, say, suggest_command, warn, wrote
from finray_calib.cli._run import (
    add_out,
    command_line,
    file_name,
    input_digests,
    interruptible,
    naming,
    require_new_session,
)

if TYPE_CHECKING:
    from data_schemas import (
        CameraPlan,
        CameraSession,
        CaptureSession,
        PaintPlan,
        RigFile,
        TactilePlan,
        TactileRig,
        TactileSession,
    )
    from rigs import Operator
    from rigs.capture import Forecast, Interrupted, SessionRequest, SessionWatch, StatedTimes


CAPTURE_HELP = "capture a paint sample through filters, the frames that characterise a camera, or presses on a finger"
CAPTURE_DESCRIPTION = """\
Run a capture plan of one of three kinds, which the plan states as 'kind'.

"paint": dark frames before and after, the white reference, the sample
under lamp and laser through every filter, and a room-light frame, at exposures at which nothing saturates.

"camera": flat frames of the white tile from dark to beyond saturation and dark frames of the same exposures.

"tactile": presses on a finger, each between images of no contact. With a camera alone in the rig file, a person
presses; with a stage and a load cell in it as well, the rig presses by itself and stops at a force.

Writes a folder with raw 16-bit TIFF frames, a journal, checksums and session.json. An interrupted session
continues where it stopped with --resume."""


def add_capture(verbs: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Register the verb."""
    parser = verbs.add_parser("capture", help=CAPTURE_HELP, description=CAPTURE_DESCRIPTION)
    parser.add_argument("plan", type=Path, nargs="?", metavar="PLAN", help="plan file (TOML): kind, name, region")
    parser.add_argument("--rig", type=Path, metavar="RIG", help="rig file (TOML): camera, wheel, lights")
    parser.add_argument(
        "--resume",
        type=Path,
        metavar="SESSION",
        help="continue an interrupted session (without PLAN, --rig and --out)",
    )
    parser.add_argument(
        "--dry-run",
        action="store_true",
        help="open the rig, check the plan and print time and disk space, without moving anything",
    )
    parser.add_argument(
        "--like",
        type=Path,
        metavar="SESSION",
        help="earlier session on this rig whose white frames the new white frames must resemble",
    )
    add_out(parser, "NAME-session/")
    parser.set_defaults(run=run_capture, attend=at_the_terminal)


def run_capture(arguments: argparse.Namespace) -> None:
    """Capture and report."""
    from data_schemas import CaptureError

    if arguments.resume is not None:
        if arguments.plan is not None or arguments.rig is not None or arguments.out is not None:
            raise CaptureError(
                "--resume takes plan, rig and folder from the session, so they cannot be given again; "
                "leave out PLAN, --rig and --out"
            )
        if arguments.dry_run:
            raise CaptureError(
                "--resume and --dry-run cannot be combined, because --dry-run describes a session that has not "
                "begun; give only one of them"
            )
        with interruptible(arguments.resume):
            resume(arguments.resume, arguments.like, at_the_terminal)
        return
    if arguments.plan is None or arguments.rig is None:
        raise CaptureError("PLAN or --rig is missing; give both, or --resume with the folder of an interrupted session")
    capture(arguments)


def capture(arguments: argparse.Namespace) -> None:
    """Capture what the plan is of, with who attends to it."""
    KINDS[plan_kind(arguments.plan, tuple(KINDS))](arguments)


def plan_kind(path: Path, known: tuple[str, ...]) -> str:
    """Return the kind of a plan, by default the first; what is no TOML is left to the reader of plans."""
    from data_schemas import RecordError
    from data_schemas.storage import read_toml_tables

    try:
        kind = read_toml_tables(path).get("kind", known[0])
    except RecordError:
        return known[0]
    if kind not in known:
        raise RecordError(f"{path}: 'kind' must be one of {', '.join(map(repr, known))}, but is {kind!r}")
    return str(kind)


def capture_tactile(arguments: argparse.Namespace) -> None:
    """Capture a tactile session, or list what it would ask for."""
    from data_schemas import CaptureError, TactilePlan, TactileRig
    from data_schemas.storage import read_toml
    from rigs.capture import (
        capture_tactile_session,
        planned_presses,
        require_pressable,
        session_bytes,
        stated_times,
        tactile_shots,
    )

    if arguments.like is not None:
        raise CaptureError("--like is supported only for plans of kind 'paint'; leave it out")
    plan, rig = read_toml(arguments.plan, TactilePlan), read_toml(arguments.rig, TactileRig)
    presses = planned_presses(plan, arguments.plan.parent)
    with naming(CaptureError, arguments.plan):
        shots = tactile_shots(plan, rig.camera, len(presses))
        require_pressable(rig, presses)
    times = stated_times(rig, plan, presses)
    stated = _stated_presses(times, by_hand=rig.stage is None)
    if arguments.dry_run:
        give(presses=len(presses), most_frames=len(shots), **times._asdict())
        say(
            f"{len(presses)} presses, {plan.repeats} times each; {len(shots)} frames, "
            f"{1e-6 * session_bytes(rig, plan, len(presses), len(shots)):.0f} MB at most"
        )
        if rig.stage is None:
            say(f"{len({shot.group for shot in shots})} steps to be done by hand")
        say(f"{stated}; the camera was not opened")
        return
    out = require_new_session(arguments.out or Path(f"{file_name(plan.name)}-session"))
    poses = [] if plan.poses_csv is None else [arguments.plan.parent / plan.poses_csv]
    sources = input_digests([arguments.plan, arguments.rig, *poses])
    with interruptible(out), arguments.attend(rig, plan, out) as attended:
        request = replace(attended, progress=_told_first(stated, attended.progress)).request(
            out, arguments.rig.parent, sources
        )
        session = capture_tactile_session(rig, plan, presses, request)
    _report_tactile(out, session)


def _stated_presses(times: "StatedTimes", *, by_hand: bool) -> str:
    """Return how long a tactile session takes at the most, as it is told before it begins."""
    hands = " plus the time for what you do by hand" if by_hand else ""
    return (
        f"this takes about {times.typical_s / 60:.1f} min{hands}, and at most {times.longest_s / 60:.0f} min{hands}. "
        f"Recovery from faults may add up to {times.healing_s / 60:.0f} min; after that, the session ends and can be "
        "resumed"
    )


def resume_tactile(folder: Path, attend: "Attend") -> None:
    """Go on with an interrupted tactile session."""
    from rigs.capture import capture_tactile_session, read_interrupted_presses

    interrupted = read_interrupted_presses(folder)
    say(f"{folder}: {len(interrupted.frames)} frames are stored and unchanged")
    with attend(interrupted.rig, interrupted.plan, folder) as attended:
        session = capture_tactile_session(
            interrupted.rig,
            interrupted.plan,
            interrupted.presses,
            attended.request(folder, interrupted.rig_folder),
            interrupted=interrupted,
        )
    _report_tactile(folder, session)


def _report_operator(done: int, total: int, what: str) -> None:
    """Tell the progress in lines: a bar would hide what the operator is asked."""
    guide(f"  {done}/{total} {what}")


def _report_tactile(out: Path, session: "TactileSession") -> None:
    """Say what was stored."""
    wrote(out, f"{len(session.frames)} frames of '{session.plan.name}', {len(session.captures)} tactile captures")
    give(
        name=session.plan.name,
        frames=len(session.frames),
        captures=len(session.captures),
        notes=session.notes,
        forces_n=[press.force_n for press in session.measured],
        force_uncertainties_n=[press.force_uncertainty_n for press in session.measured],
    )
    for press in session.measured:
        force = f"{press.force_n:.3f} +- {press.force_uncertainty_n:.3f} N"
        say(f"  contact {press.contact}: {press.depth_mm:.3f} +- {press.depth_uncertainty_mm:.3f} mm, {force}")
    for note in session.notes:
        say(f"  note: {note}")


def capture_paint(arguments: argparse.Namespace) -> None:
    """Capture a paint session, or say what it would take."""
    from data_schemas import CaptureError, PaintPlan, RigFile
    from data_schemas.storage import read_toml
    from rigs import AbsentOperator, open_rig, rig_locked
    from rigs.capture import capture_paint_session, forecast, paint_steps, read_session, require_ready
    from rigs.light_guard import require_outside_layer

    plan, rig = read_toml(arguments.plan, PaintPlan), read_toml(arguments.rig, RigFile)
    with naming(CaptureError, arguments.plan):
        steps = paint_steps(plan, rig)
    with naming(CaptureError, arguments.rig):
        require_outside_layer(rig.laser)
    expected, folder = forecast(plan, rig, steps), arguments.out or Path(f"{file_name(plan.paint_name)}-session")
    _warn_of_space(folder, expected)
    if arguments.dry_run:
        nobody = AbsentOperator()
        with rig_locked(rig), open_rig(rig, arguments.rig.parent, nobody) as opened:
            require_ready(opened, steps)
        give(
            steps=expected.steps, most_frames=expected.most_frames, disk_bytes=expected.disk_bytes,
            typical_s=expected.typical_s, longest_s=expected.longest_s, recovery_s=expected.healing_s,
            healing_s=expected.healing_s,
        )  # fmt: skip
        say(f"{expected.steps} steps, at most {expected.most_frames} frames, {1e-6 * expected.disk_bytes:.0f} MB")
        say(f"targets to be placed in view: {expected.targets}; moves of the wheel: {expected.moves}")
        say(_stated(expected.typical_s, expected.longest_s, expected.healing_s))
        for instruction in dict.fromkeys(nobody.instructions):
            say(f"you will be asked during the capture: {instruction}")
        say("the rig is ready; nothing was moved, lit or stored")
        suggest_command("finray capture", arguments.plan, "--rig", arguments.rig)
        return
    last_good = None if arguments.like is None else read_session(arguments.like)
    out = require_new_session(folder)
    sources = input_digests([arguments.plan, arguments.rig])
    stated = _stated(expected.typical_s, expected.longest_s, expected.healing_s)
    with interruptible(out), arguments.attend(rig, plan, out) as attended:
        request = replace(attended, progress=_told_first(stated, attended.progress)).request(
            out, arguments.rig.parent, sources
        )
        session = capture_paint_session(rig, plan, request, last_good=last_good, mend=attended.mend)
    _report(out, session, plan.paint_name)


def _warn_of_space(folder: Path, expected: "Forecast") -> None:
    """Refuse a disk that cannot hold a frame of each step, and warn of one that may not hold all exposures of them."""
    from rigs.capture import space_warning

    least_bytes = expected.disk_bytes * (expected.steps + 1) // expected.most_frames
    if (text := space_warning(folder, least_bytes, expected.disk_bytes)) is not None:
        warn(f"warning: {text}")


def _stated(typical_s: float, longest_s: float, healing_s: float) -> str:
    """Return how long a session takes at the most, as it is told before it begins."""
    return (
        f"this takes about {typical_s / 60:.0f} min ({longest_s / 60:.0f} min if every exposure has to be the longest "
        f"that the rig file allows). Recovery from faults may add up to {healing_s / 60:.0f} min; after that, the "
        "session ends and can be resumed"
    )


def _told_first(text: str, progress: Progress) -> Progress:
    """Return a progress that tells a text before its first step: once the rig is open, and no mistake can be told."""
    left = [text]

    def tell(done: int, total: int, what: str) -> None:
        while left:
            say(left.pop())
        progress(done, total, what)

    return tell


def _ask_to_mend(what: str) -> bool:
    """Ask whoever is at the terminal to mend something; return whether it is done, at once where there is nobody."""
    from rigs import discard_typed_input

    if not (sys.stdin.isatty() and sys.stderr.isatty()):
        return False
    discard_typed_input()
    sys.stderr.write(
        f"\n{what}\nThe lights are off. Repair the fault, close the box and press Enter; type q and press Enter to "
        "end the session here. "
    )
    sys.stderr.flush()
    answer = sys.stdin.readline()
    return bool(answer) and answer.strip().lower() not in ("q", "quit")


def capture_camera(arguments: argparse.Namespace) -> None:
    """Capture a camera session."""
    from data_schemas import CameraPlan, CaptureError, RigFile
    from data_schemas.storage import read_toml
    from rigs.capture import camera_step, camera_times, capture_camera_session

    if arguments.dry_run or arguments.like is not None:
        raise CaptureError("--dry-run and --like are supported only for plans of kind 'paint'; leave them out")
    plan, rig = read_toml(arguments.plan, CameraPlan), read_toml(arguments.rig, RigFile)
    out = require_new_session(arguments.out or Path(f"{file_name(plan.camera_name)}-session"))
    sources = input_digests([arguments.plan, arguments.rig])
    with naming(CaptureError, arguments.plan):
        camera_step(plan, rig)
    stated = _stated(*camera_times(plan, rig))
    with interruptible(out), arguments.attend(rig, plan, out) as attended:
        request = replace(attended, progress=_told_first(stated, attended.progress)).request(
            out, arguments.rig.parent, sources
        )
        session = capture_camera_session(rig, plan, request)
    _report(out, session, plan.camera_name)


KINDS: dict[str, Callable[[argparse.Namespace], None]] = {
    "paint": capture_paint,
    "camera": capture_camera,
    "tactile": capture_tactile,
}


def resume(folder: Path, like: Path | None, attend: "Attend") -> None:
    """Go on with an interrupted session."""
    from data_schemas import CaptureError
    from rigs.capture import (
        complete_session,
        is_tactile,
        lacks_manifest,
        read_interrupted,
        read_session,
        require_unfinished,
        unvouched_files,
    )

    if lacks_manifest(folder):
        complete_session(folder)
        done = "was complete except for its checksums, which have now been written; nothing else is left to resume"
        wrote(folder, done)
        give(notes=[done])
        return
    require_unfinished(folder)
    tactile = is_tactile(folder)
    interrupted = None if tactile else read_interrupted(folder)
    if like is not None and (interrupted is None or interrupted.kind != "paint"):
        raise CaptureError("--like is supported only for sessions of kind 'paint'; leave it out")
    if interrupted is None:
        resume_tactile(folder, attend)
        return
    if interrupted.kind not in ("paint", "camera"):
        raise CaptureError(
            f"{folder}: sessions of kind '{interrupted.kind}' cannot be resumed; start the session "
            "again from the beginning"
        )
    say(f"{folder}: {len(interrupted.frames)} frames are stored and unchanged")
    aside = [file for file in unvouched_files(folder, interrupted) if not file.name.startswith(".")]
    if aside:
        files = "1 other file" if len(aside) == 1 else f"{len(aside)} other files"
        say(f"  {files} of frames/ set aside, in set-aside/; what they show is taken again where it is missing:")
        say("  changed, not in the journal, or taken without light and not proven by a later frame in light")
    if interrupted.doubt:
        say("  all steps are metered again, because a frame differed from its metering in brightness or colour;")
        say("  frames that the repaired rig cannot reproduce are set aside and taken again")
    if interrupted.kind == "camera":
        _resume_camera(folder, interrupted, attend)
    else:
        _resume_paint(folder, interrupted, None if like is None else read_session(like), attend)


def _resume_paint(
    folder: Path, interrupted: "Interrupted", last_good: "CaptureSession | None", attend: "Attend"
) -> None:
    """Go on with a paint session."""
    from data_schemas import PaintPlan
    from rigs.capture import capture_paint_session

    plan, rig = interrupted.plan(PaintPlan), interrupted.rig()
    with attend(rig, plan, folder) as attended:
        request = attended.request(folder, interrupted.rig_folder)
        session = capture_paint_session(
            rig, plan, request, interrupted=interrupted, last_good=last_good, mend=attended.mend
        )
    _report(folder, session, plan.paint_name)


def _resume_camera(folder: Path, interrupted: "Interrupted", attend: "Attend") -> None:
    """Go on with a camera session."""
    from data_schemas import CameraPlan
    from rigs.capture import capture_camera_session

    plan, rig = interrupted.plan(CameraPlan), interrupted.rig()
    with attend(rig, plan, folder) as attended:
        request = attended.request(folder, interrupted.rig_folder)
        session = capture_camera_session(rig, plan, request, interrupted=interrupted)
    _report(folder, session, plan.camera_name)


@dataclass(frozen=True, slots=True)
class Attended:
    """Who attends to a session: sees its progress, is asked, mends, and watches its frames.

    Attributes
    ----------
    progress
        Called with how far the session is.
    operator
        Who places and presses; a person at the terminal when left out.
    mend
        Has something mended, and returns whether it is done.
    watch
        Sees frames and journal; nobody when left out.
    """

    progress: Progress
    operator: "Operator | None" = None
    mend: Callable[[str], bool] = _ask_to_mend
    watch: "SessionWatch | None" = None

    def request(self, out: Path, rig_folder: Path, sources: Mapping[str, str] | None = None) -> "SessionRequest":
        """Return what is asked of a capture into a folder."""
        from rigs.capture import SessionRequest, SessionWatch

        return SessionRequest(
            out,
            command_line(),
            rig_folder=rig_folder,
            progress=self.progress,
            operator=self.operator,
            sources=sources or {},
            watch=self.watch or SessionWatch(),
        )


Attend = Callable[
    ["RigFile | TactileRig", "PaintPlan | CameraPlan | TactilePlan", Path], AbstractContextManager[Attended]
]
"""Opens what attends to a session: called with rig, plan and the session's folder."""


@contextmanager
def at_the_terminal(
    rig: "RigFile | TactileRig", plan: "PaintPlan | CameraPlan | TactilePlan", out: Path
) -> Iterator[Attended]:
    """Ask at the bare terminal, with progress in lines or a bar."""
    from data_schemas import RigFile

    if not isinstance(rig, RigFile):
        yield Attended(_report_operator)
        return
    with _bar_or_lines(rig) as progress:
        warn_of_laser(rig)
        yield Attended(progress)


def warn_of_laser(rig: "RigFile") -> None:
    """Say before a real laser is lit what it is and what switches it off."""
    if not rig.is_simulated:
        from rigs.light_guard import safety_lines

        for line in safety_lines(rig.laser):
            guide(line)


def _bar_or_lines(rig: "RigFile") -> AbstractContextManager[Progress]:
    """Return a bar on the simulated rig, lines on a real one: a bar would hide what the operator is asked."""
    return progress_bar("capture") if rig.is_simulated else _lines()


@contextmanager
def _lines() -> Iterator[Progress]:
    """Tell the progress in lines."""
    yield lambda done, total, what: guide(f"  {done}/{total} {what}")


def _report(out: Path, session: "CaptureSession | CameraSession", name: str) -> None:
    """Say what was stored."""
    from data_schemas import CaptureSession

    wrote(out, f"{len(session.frames)} frames of '{name}'")
    give(name=name, frames=len(session.frames), notes=session.notes)
    suggest_command("finray radiometry", out)
    if isinstance(session, CaptureSession) and session.filter_proof is not None:
        give(filters_verdict=session.filter_proof.verdict)
        say(f"  filters: {session.filter_proof.verdict}: {session.filter_proof.text}")
    for note in session.notes:
        say(f"  note: {note}")
