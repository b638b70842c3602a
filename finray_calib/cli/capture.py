"""``finray capture``: run a capture plan on a rig and store the session."""

import argparse
from pathlib import Path

from finray_calib.cli.options import add_out

HELP = "capture a paint sample through filters, the frames that characterise a camera, or presses on a finger"
DESCRIPTION = """\
Run a capture plan; its 'kind' says which. "paint": dark frames before and after, the white reference, the sample
under lamp and laser through every filter, and a room-light frame, at exposures at which nothing saturates.
"camera": flat frames of the white tile from dark to beyond saturation and dark frames of the same exposures.
"tactile": presses on a finger, each between images of no contact; its rig file describes a camera alone.
Writes a folder with raw 16-bit TIFF frames, a journal, checksums and session.json. An interrupted session goes on
where it stopped with --resume."""


def add_parser(verbs: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Register the verb."""
    parser = verbs.add_parser(
        "capture", help=HELP, description=DESCRIPTION, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("plan", type=Path, nargs="?", metavar="PLAN", help="plan file (TOML): kind, name, region")
    parser.add_argument("--rig", type=Path, metavar="RIG", help="rig file (TOML): camera, wheel, lights")
    parser.add_argument(
        "--resume", type=Path, metavar="SESSION", help="go on with an interrupted session; takes no PLAN and no --rig"
    )
    parser.add_argument(
        "--dry-run", action="store_true", help="open the rig, check the plan, print time and disk; nothing moves"
    )
    parser.add_argument(
        "--like", type=Path, metavar="SESSION", help="earlier session on this rig that the white frames must resemble"
    )
    add_out(parser, "NAME-session/")
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> None:
    """Capture and report."""
    from data_schemas.errors import CaptureError
    from finray_calib.cli.capture_kinds import KINDS, resume
    from finray_calib.cli.interruption import interruptible

    if arguments.resume is not None:
        if arguments.plan is not None or arguments.rig is not None or arguments.out is not None:
            raise CaptureError("--resume takes plan, rig and folder from the session; leave out PLAN, --rig and --out")
        if arguments.dry_run:
            raise CaptureError("--resume goes on at once, and --dry-run is for a session that is to begin; give one")
        with interruptible(arguments.resume):
            resume(arguments.resume, arguments.like)
        return
    if arguments.plan is None or arguments.rig is None:
        raise CaptureError("give a PLAN and its --rig, or --resume with the folder of an interrupted session")
    KINDS[_plan_kind(arguments.plan, tuple(KINDS))](arguments)


def _plan_kind(path: Path, known: tuple[str, ...]) -> str:
    """Return the kind of a plan; what is no TOML at all is left to the reader of plans, which says why."""
    from data_schemas.errors import RecordError
    from data_schemas.foreign_files import read_toml_tables

    try:
        kind = read_toml_tables(path).get("kind", "paint")
    except RecordError:
        return "paint"
    if kind not in known:
        raise RecordError(f"{path}: 'kind' is {kind!r}; it must be one of {', '.join(map(repr, known))}")
    return str(kind)
