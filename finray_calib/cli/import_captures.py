"""``finray import``: captures that labs already have become records."""

import argparse
from pathlib import Path

from finray_calib.cli.options import add_out, command_line, require_new, say

HELP = "import captures made elsewhere (9DTact calibration folders)"
DESCRIPTION = """\
Import a sensor folder of 9DTact as a tactile capture. With --predict-from, also write a simple prediction of
the press: the darkening-to-depth table of the other sensor applied to this one, labelled "table, not
rendered". Compare the two with 'finray compare'."""


def add_parser(verbs: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Register the verb."""
    parser = verbs.add_parser(
        "import", help=HELP, description=DESCRIPTION, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("format", choices=["9dtact"], help="format of the folder")
    parser.add_argument("folder", type=Path, metavar="FOLDER", help="sensor folder, for example sensor_1")
    parser.add_argument(
        "--predict-from", type=Path, metavar="FOLDER", help="other sensor whose table makes a prediction"
    )
    add_out(parser, "FOLDER.capture.json, with --predict-from also FOLDER.press.json beside it")
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> None:
    """Import and report."""
    from data_schemas.provenance import provenance
    from data_schemas.storage import sha256_of, write_record
    from finray_calib.exchange.nine_dtact_records import table_prediction, tactile_capture

    folder: Path = arguments.folder
    out = require_new(arguments.out or Path(f"{folder.resolve().name}.capture.json"))
    press_out = out.with_name(f"{out.name.removesuffix('.json').removesuffix('.capture')}.press.json")
    if arguments.predict_from is not None:
        require_new(press_out)
    capture = tactile_capture(folder)
    press = None if arguments.predict_from is None else table_prediction(folder, arguments.predict_from)
    sources = [folder] if arguments.predict_from is None else [folder, arguments.predict_from]
    files = sorted(f for source in sources for f in source.rglob("*") if f.suffix in {".png", ".npy"})
    origin = provenance(
        command_line(), {f"{f.parent.parent.name}/{f.parent.name}/{f.name}": sha256_of(f) for f in files}
    )
    write_record(capture, out, origin)
    rows, columns = capture.contact.shape[:2]
    say(f"{out}: {capture.name}, {columns} x {rows} px, encoding {capture.encoding}")
    if press is not None:
        write_record(press, press_out, origin)
        say(f"{press_out}: {press.name} ({press.label})")
