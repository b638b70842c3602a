"""``finray capture``: run a capture plan on a rig and store the session."""

import argparse
from pathlib import Path

from finray_calib.cli.options import add_out, command_line, file_name, naming, progress_bar, require_new, say

HELP = "capture the filtered images of a paint sample, or the frames that characterise a camera"
DESCRIPTION = """\
Run a capture plan; its 'kind' says which. "paint": dark frames before and after, the white reference, the sample
under lamp and laser through every filter, and a room-light frame, at exposures at which nothing saturates.
"camera": flat frames of the white tile from dark to beyond saturation and dark frames of the same exposures.
Writes a folder with raw 16-bit TIFF frames, a journal, checksums and session.json."""


def add_parser(verbs: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Register the verb."""
    parser = verbs.add_parser(
        "capture", help=HELP, description=DESCRIPTION, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("plan", type=Path, metavar="PLAN", help="plan file (TOML): kind, name, region, exposures")
    parser.add_argument("--rig", type=Path, required=True, metavar="RIG", help="rig file (TOML): camera, wheel, lights")
    add_out(parser, "NAME-session/")
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> None:
    """Capture and report."""
    {"paint": _capture_paint, "camera": _capture_camera}[_plan_kind(arguments.plan)](arguments)


def _plan_kind(path: Path) -> str:
    """Return the kind of a plan; what is no TOML at all is left to the reader of plans, which says why."""
    import tomllib

    from data_schemas.errors import RecordError

    try:
        kind = tomllib.loads(path.read_text(encoding="utf-8")).get("kind", "paint")
    except (OSError, ValueError):
        return "paint"
    if kind not in ("paint", "camera"):
        raise RecordError(f"{path}: 'kind' is {kind!r}; it must be 'paint' or 'camera'")
    return str(kind)


def _capture_paint(arguments: argparse.Namespace) -> None:
    """Capture a paint session."""
    from data_schemas.capture import PaintPlan
    from data_schemas.errors import CaptureError
    from data_schemas.rig import RigFile
    from data_schemas.storage import read_toml
    from rigs.capture.paint_session import capture_paint_session
    from rigs.capture.plan import paint_steps

    plan = read_toml(arguments.plan, PaintPlan)
    rig = read_toml(arguments.rig, RigFile)
    out = require_new(arguments.out or Path(f"{file_name(plan.paint_name)}-session"))
    with naming(CaptureError, arguments.plan):
        paint_steps(plan, rig)
    with progress_bar("capture") as progress:
        session = capture_paint_session(rig, plan, arguments.rig.parent, out, command_line(), progress)
    _report(out, len(session.frames), plan.paint_name, session.notes)


def _capture_camera(arguments: argparse.Namespace) -> None:
    """Capture a camera session."""
    from data_schemas.camera import CameraPlan
    from data_schemas.errors import CaptureError
    from data_schemas.rig import RigFile
    from data_schemas.storage import read_toml
    from rigs.capture.camera_session import camera_step, capture_camera_session

    plan = read_toml(arguments.plan, CameraPlan)
    rig = read_toml(arguments.rig, RigFile)
    out = require_new(arguments.out or Path(f"{file_name(plan.camera_name)}-session"))
    with naming(CaptureError, arguments.plan):
        camera_step(plan, rig)
    with progress_bar("capture") as progress:
        session = capture_camera_session(rig, plan, arguments.rig.parent, out, command_line(), progress)
    _report(out, len(session.frames), plan.camera_name, session.notes)


def _report(out: Path, frames: int, name: str, notes: tuple[str, ...]) -> None:
    """Say what was stored."""
    say(f"{out}: {frames} frames of '{name}'")
    for note in notes:
        say(f"  note: {note}")
