"""What ``finray capture`` does for a tactile plan."""

import argparse
from pathlib import Path

from data_schemas.errors import CaptureError
from data_schemas.storage import read_toml
from data_schemas.tactile import TactilePlan, TactileRig, TactileSession
from finray_calib.cli.interruption import interruptible
from finray_calib.cli.options import command_line, file_name, input_digests, naming, require_new_session, say, warn
from rigs.capture.tactile_plan import planned_presses, tactile_shots
from rigs.capture.tactile_resume import read_interrupted_presses
from rigs.capture.tactile_session import capture_tactile_session, session_bytes


def capture_tactile(arguments: argparse.Namespace) -> None:
    """Capture a tactile session, or list what it would ask for."""
    if arguments.like is not None:
        raise CaptureError("--like is for plans of kind 'paint'; leave it out")
    plan, rig = read_toml(arguments.plan, TactilePlan), read_toml(arguments.rig, TactileRig)
    presses = planned_presses(plan, arguments.plan.parent)
    with naming(CaptureError, arguments.plan):
        shots = tactile_shots(plan, rig.camera, len(presses))
    if arguments.dry_run:
        say(
            f"{len(presses)} presses, {plan.repeats} times each; {len(shots)} frames, "
            f"{1e-6 * session_bytes(rig, plan, len(presses), len(shots)):.0f} MB at most"
        )
        say(f"{len({shot.group for shot in shots})} things to do by hand")
        say(f"{sum(shot.exposure_s for shot in shots):.0f} s of exposure; the camera was not opened")
        return
    out = require_new_session(arguments.out or Path(f"{file_name(plan.name)}-session"))
    poses = [] if plan.poses_csv is None else [arguments.plan.parent / plan.poses_csv]
    sources = input_digests([arguments.plan, arguments.rig, *poses])
    with interruptible(out):
        session = capture_tactile_session(
            rig, plan, presses, (arguments.rig.parent, out), command_line(), _tell, sources=sources
        )
    _report(out, session)


def resume_tactile(folder: Path) -> None:
    """Go on with an interrupted tactile session."""
    interrupted = read_interrupted_presses(folder)
    say(f"{folder}: {len(interrupted.frames)} frames are there and unchanged")
    session = capture_tactile_session(
        interrupted.rig,
        interrupted.plan,
        interrupted.presses,
        (interrupted.rig_folder, folder),
        command_line(),
        _tell,
        interrupted=interrupted,
    )
    _report(folder, session)


def _tell(done: int, total: int, what: str) -> None:
    """Tell the progress in lines: a bar would hide what the operator is asked."""
    warn(f"  {done}/{total} {what}")


def _report(out: Path, session: TactileSession) -> None:
    """Say what was stored."""
    say(f"{out}: {len(session.frames)} frames of '{session.plan.name}', {len(session.captures)} tactile captures")
    for note in session.notes:
        say(f"  note: {note}")
