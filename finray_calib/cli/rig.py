"""``finray rig``: write a rig file, find devices, show what a rig's devices report."""

import argparse
from pathlib import Path

from finray_calib.cli.options import add_out, require_new, say, warn

HELP = "write a rig file, find devices, and show what the devices of a rig report"
INIT_HELP = "write a commented rig file to start from"
INIT_DESCRIPTION = """\
Write a rig file with a comment on every value, made after a preset. On a terminal the devices that are found are
offered; otherwise the preset's own are written, and what to fill in is said."""
DETECT_HELP = "list the cameras, filter wheels and lights that can be found"
DETECT_DESCRIPTION = """\
Ask every driver what it can find, and print driver and address as a rig file names them. Serial ports behind USB are
opened for a moment; most Arduino boards restart then."""
SHOW_HELP = "show what each device of a rig reports"
SHOW_DESCRIPTION = """\
Open each device of a rig on its own and print what it is, where the wheel stands, whether the lights are off, what
switches them off when a process or the computer fails, one dark exposure of the camera, and the filters. Nothing moves
and the lights stay off. A device that cannot be reached hides no other; the exit status is 2 then."""


def add_parser(verbs: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Register the verb and what it can do."""
    parser = verbs.add_parser("rig", help=HELP, description=HELP)
    actions = parser.add_subparsers(dest="action", metavar="ACTION", title="actions", required=True)
    init = actions.add_parser("init", help=INIT_HELP, description=INIT_DESCRIPTION)
    init.add_argument("--preset", choices=("paper",), default="paper", help="whose set-up (default: paper)")
    add_out(init, "rig.toml")
    init.set_defaults(run=run_init)
    detect = actions.add_parser("detect", help=DETECT_HELP, description=DETECT_DESCRIPTION)
    detect.set_defaults(run=run_detect)
    show = actions.add_parser("show", help=SHOW_HELP, description=SHOW_DESCRIPTION)
    show.add_argument("rig", type=Path, metavar="RIG", help="rig file (TOML)")
    show.set_defaults(run=run_show)


def run_init(arguments: argparse.Namespace) -> None:
    """Write a rig file."""
    from finray_calib.cli.choose_devices import chosen_devices
    from rigs.rig_template import paper_rig, to_fill_in
    from rigs.toml_text import write_rig

    out = require_new(arguments.out or Path("rig.toml"))
    chosen = chosen_devices()
    say(f"rig file: {write_rig(paper_rig(chosen), out)}")
    for text in to_fill_in(chosen):
        say(f"  fill in or compare: {text}")
    say(f"then: finray rig show {out}")


def run_detect(arguments: argparse.Namespace) -> None:
    """Print what is found."""
    from rigs.detect import detect

    detection = detect()
    rows = [("device", "driver", "address", "what it is")]
    rows += [(d.kind, d.driver, d.address, d.what) for d in detection.devices]
    widths = [max(len(row[column]) for row in rows) for column in range(3)]
    for row in rows if detection.devices else ():
        say("  ".join([*(f"{row[column]:{widths[column]}}" for column in range(3)), row[3]]))
    if not detection.devices:
        say("no device found")
    for note in detection.notes:
        warn(f"note: {note}")
    if detection.not_searched:
        warn(f"note: not searched for: {', '.join(detection.not_searched)}; their addresses are yours to give")


def run_show(arguments: argparse.Namespace) -> None:
    """Print what every device reports."""
    from data_schemas.errors import CaptureError
    from data_schemas.rig import RigFile
    from data_schemas.storage import read_toml
    from data_schemas.tactile import TactileRig
    from rigs.overview import look_at, look_at_tactile

    if _has_a_wheel(arguments.rig):
        rig = read_toml(arguments.rig, RigFile)
        name, parts = rig.name, look_at(rig, arguments.rig.parent)
    else:
        tactile = read_toml(arguments.rig, TactileRig)
        name, parts = tactile.name, look_at_tactile(tactile, arguments.rig.parent)
    say(name)
    failed = []
    for part in parts:
        say(f"\n{part.title}")
        for line in part.lines:
            say(f"  {line}")
        for warning in part.warnings:
            say(f"  warning: {warning}")
        if part.error is not None:
            say(f"  ERROR: {part.error}")
            failed.append(part.title)
    if failed:
        raise CaptureError(f"{arguments.rig}: errors above at {'; '.join(failed)}; correct them and show the rig again")


def _has_a_wheel(path: Path) -> bool:
    """Whether a rig file is that of a paint rig; what is no TOML at all is left to its reader, which says why."""
    from data_schemas.errors import RecordError
    from data_schemas.foreign_files import read_toml_tables

    try:
        tables = read_toml_tables(path)
    except RecordError:
        return True
    return tables.keys() - {"schema_version"} != {"name", "camera"}
