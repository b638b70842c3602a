"""``finray capture``: run a capture plan on a rig and store the session."""

import argparse
from pathlib import Path

from finray_calib.cli.options import add_out, command_line, file_name, naming, progress_bar, require_new, say

HELP = "capture the filtered images of a paint sample"
DESCRIPTION = """\
Capture a paint session: dark frames before and after, the white reference, the sample under lamp and laser
through every filter, and a room-light frame. Exposures are chosen so that nothing saturates. Writes a folder
with raw 16-bit TIFF frames, a journal, checksums and session.json."""


def add_parser(verbs: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Register the verb."""
    parser = verbs.add_parser(
        "capture", help=HELP, description=DESCRIPTION, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("plan", type=Path, metavar="PLAN", help="plan file (TOML): paint, region, exposures")
    parser.add_argument("--rig", type=Path, required=True, metavar="RIG", help="rig file (TOML): camera, wheel, lights")
    add_out(parser, "PAINT-session/")
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> None:
    """Capture and report."""
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
    say(f"{out}: {len(session.frames)} frames of '{plan.paint_name}'")
    for note in session.notes:
        say(f"  note: {note}")
