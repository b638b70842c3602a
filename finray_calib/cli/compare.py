"""``finray compare``: how far a simulated press is from a real capture."""

import argparse
from pathlib import Path

from finray_calib.cli.options import add_out, add_seed, command_line, input_digests, naming, require_new, say

HELP = "compare a simulated press with a tactile capture"
DESCRIPTION = """\
Compare a simulated press with a tactile capture over the contact patch and over the patch dilated to twice
its half-width. Every number stands beside doing nothing (the no-contact image as the simulation) and the floor
(what a repeat of the no-contact image costs). The headline is the skill score: 0 is doing nothing, 1 is perfect,
and nothing above the floor row says anything."""


def add_parser(verbs: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Register the verb."""
    parser = verbs.add_parser(
        "compare", help=HELP, description=DESCRIPTION, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("simulated", type=Path, metavar="SIMULATED", help="record of a simulated press")
    parser.add_argument("capture", type=Path, metavar="CAPTURE", help="record of a tactile capture")
    add_out(parser, "photometric-error.json")
    add_seed(parser)
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> None:
    """Compare and report."""
    from data_schemas.capture import TactileCapture
    from data_schemas.errors import CompareError
    from data_schemas.provenance import provenance
    from data_schemas.simulate import SimulatedPress
    from data_schemas.storage import read_record, write_record
    from finray_calib.compare.comparison_record import compare_press
    from finray_calib.reports.comparison_table import comparison_lines

    out = require_new(arguments.out or Path("photometric-error.json"))
    press = read_record(arguments.simulated, SimulatedPress)
    capture = read_record(arguments.capture, TactileCapture)
    with naming(CompareError, arguments.simulated, arguments.capture):
        report = compare_press(press, capture, arguments.seed)
    inputs = input_digests([arguments.simulated, arguments.capture])
    write_record(report, out, provenance(command_line(), inputs, arguments.seed))
    say(comparison_lines(report))
    say(f"{out}: written")
