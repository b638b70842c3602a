"""What ``finray capture`` does for each kind of plan, for a dry run and for an interrupted session."""

import argparse
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path

from data_schemas.camera import CameraPlan, CameraSession
from data_schemas.capture import CaptureSession, PaintPlan
from data_schemas.devices import LaserSettings
from data_schemas.errors import CaptureError
from data_schemas.rig import RigFile
from data_schemas.storage import read_toml
from finray_calib.cli.capture_tactile import capture_tactile, resume_tactile
from finray_calib.cli.interruption import interruptible
from finray_calib.cli.options import (
    Progress,
    command_line,
    file_name,
    input_digests,
    naming,
    progress_bar,
    require_new_session,
    say,
    warn,
)
from rigs.capture.camera_session import camera_step, capture_camera_session
from rigs.capture.dry_run import forecast, require_ready
from rigs.capture.paint_session import capture_paint_session
from rigs.capture.plan import paint_steps
from rigs.capture.read_session import read_session
from rigs.capture.resume import Interrupted, read_interrupted
from rigs.capture.rig_lock import rig_locked
from rigs.capture.session_folder import lacks_manifest
from rigs.capture.tactile_resume import is_tactile
from rigs.capture.verify_session import complete_session
from rigs.light_guard import require_outside_layer
from rigs.open_rig import open_rig


def capture_paint(arguments: argparse.Namespace) -> None:
    """Capture a paint session, or say what it would take."""
    plan, rig = read_toml(arguments.plan, PaintPlan), read_toml(arguments.rig, RigFile)
    with naming(CaptureError, arguments.plan):
        steps = paint_steps(plan, rig)
    with naming(CaptureError, arguments.rig):
        require_outside_layer(rig.laser)
    if arguments.dry_run:
        with rig_locked(rig), open_rig(rig, arguments.rig.parent) as opened:
            require_ready(opened, steps)
        expected = forecast(plan, rig, steps)
        say(f"{expected.steps} steps, at most {expected.most_frames} frames, {1e-6 * expected.disk_bytes:.0f} MB")
        say(f"{expected.targets} times another target, {expected.moves} moves of the wheel")
        say(f"about {expected.typical_s / 60:.0f} min; {expected.longest_s / 60:.0f} min if every exposure is longest")
        say("the rig is ready; nothing was moved, lit or stored")
        return
    last_good = None if arguments.like is None else read_session(arguments.like)
    out = require_new_session(arguments.out or Path(f"{file_name(plan.paint_name)}-session"))
    sources = input_digests([arguments.plan, arguments.rig])
    with interruptible(out), _telling(rig) as progress:
        session = capture_paint_session(
            rig, plan, arguments.rig.parent, out, command_line(), progress, last_good=last_good, sources=sources
        )
    _report(out, session, plan.paint_name)


def capture_camera(arguments: argparse.Namespace) -> None:
    """Capture a camera session."""
    if arguments.dry_run or arguments.like is not None:
        raise CaptureError("--dry-run and --like are for plans of kind 'paint'; leave them out")
    plan, rig = read_toml(arguments.plan, CameraPlan), read_toml(arguments.rig, RigFile)
    out = require_new_session(arguments.out or Path(f"{file_name(plan.camera_name)}-session"))
    sources = input_digests([arguments.plan, arguments.rig])
    with naming(CaptureError, arguments.plan):
        camera_step(plan, rig)
    with interruptible(out), _telling(rig) as progress:
        session = capture_camera_session(
            rig, plan, arguments.rig.parent, out, command_line(), progress, sources=sources
        )
    _report(out, session, plan.camera_name)


KINDS: dict[str, Callable[[argparse.Namespace], None]] = {
    "paint": capture_paint,
    "camera": capture_camera,
    "tactile": capture_tactile,
}


def resume(folder: Path, like: Path | None) -> None:
    """Go on with an interrupted session."""
    if lacks_manifest(folder):
        complete_session(folder)
        say(f"{folder}: was finished but for its checksums, which are written now; nothing else is left to resume")
        return
    tactile = is_tactile(folder)
    interrupted = None if tactile else read_interrupted(folder)
    if like is not None and (interrupted is None or interrupted.kind != "paint"):
        raise CaptureError("--like is for sessions of kind 'paint'; leave it out")
    if interrupted is None:
        resume_tactile(folder)
        return
    if interrupted.kind not in ("paint", "camera"):
        raise CaptureError(f"{folder}: sessions of kind '{interrupted.kind}' cannot be resumed; capture it again")
    say(f"{folder}: {len(interrupted.frames)} frames are there and unchanged")
    if interrupted.kind == "camera":
        _resume_camera(folder, interrupted)
    else:
        _resume_paint(folder, interrupted, None if like is None else read_session(like))


def _resume_paint(folder: Path, interrupted: Interrupted, last_good: CaptureSession | None) -> None:
    """Go on with a paint session."""
    plan, rig = interrupted.plan(PaintPlan), interrupted.rig()
    with _telling(rig) as progress:
        session = capture_paint_session(
            rig,
            plan,
            interrupted.rig_folder,
            folder,
            command_line(),
            progress,
            interrupted=interrupted,
            last_good=last_good,
        )
    _report(folder, session, plan.paint_name)


def _resume_camera(folder: Path, interrupted: Interrupted) -> None:
    """Go on with a camera session."""
    plan, rig = interrupted.plan(CameraPlan), interrupted.rig()
    with _telling(rig) as progress:
        session = capture_camera_session(
            rig, plan, interrupted.rig_folder, folder, command_line(), progress, interrupted=interrupted
        )
    _report(folder, session, plan.camera_name)


@contextmanager
def _telling(rig: RigFile) -> Iterator[Progress]:
    """Show the progress; before a real laser its safety line. A bar would hide what the operator is asked."""
    with _bar_or_lines(rig) as progress:
        if not rig.is_simulated:
            for line in safety_lines(rig.laser):
                warn(line)
        yield progress


def _bar_or_lines(rig: RigFile) -> AbstractContextManager[Progress]:
    """Return a bar on the simulated rig, lines on a real one."""
    return progress_bar("capture") if rig.is_simulated else _lines()


@contextmanager
def _lines() -> Iterator[Progress]:
    """Tell the progress in lines."""
    yield lambda done, total, what: warn(f"  {done}/{total} {what}")


def safety_lines(laser: LaserSettings) -> tuple[str, ...]:
    """Return what everybody in the room must know, with what switches the laser off and what does not."""
    from rigs.light_guard.outside_layer import has_dead_man, off_lines

    return (
        f"LASER {laser.wavelength_nm:g} nm, {laser.power_mw:g} mW, class {laser.laser_class}: it will be switched on. "
        f"Wear goggles for {laser.wavelength_nm:g} nm, close the box, keep others out",
        *(f"  {line}" for line in off_lines(has_dead_man(laser), laser.outside_layer)),
    )


def _report(out: Path, session: CaptureSession | CameraSession, name: str) -> None:
    """Say what was stored."""
    say(f"{out}: {len(session.frames)} frames of '{name}'")
    if isinstance(session, CaptureSession) and session.filter_proof is not None:
        say(f"  filters: {session.filter_proof.verdict}: {session.filter_proof.text}")
    for note in session.notes:
        say(f"  note: {note}")
