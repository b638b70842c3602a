"""``finray compare``: how far simulated presses are from real captures."""

import argparse
from pathlib import Path

from finray_calib.cli.compare_force import add_force, compare_force_verb, refuse_force_options
from finray_calib.cli.options import (
    add_out,
    add_seed,
    command_line,
    input_digests,
    naming,
    new_page_beside,
    require_new,
    say,
)

HELP = "compare simulated presses with tactile captures"
DESCRIPTION = """\
Compare a simulated press with a tactile capture over the contact patch and over the patch dilated to twice
its half-width. Every number stands beside doing nothing (the no-contact image as the simulation) and the floor
(what a repeat of the no-contact image costs). The headline is the skill score: 0 is doing nothing, 1 is perfect.
The noise of linear captures with a repeat is taken out of the simulation's score but not of the floor, so that the
score may lie above it; with encoded values both hold the noise, and nothing above the floor row says anything.

With two folders, one.press.json is compared with one.capture.json and so on (or the pairs of --pairs): a report
for each, and a summary over the presses.

Another light angle, indenter, depth or position than the capture states is refused, and so are images that do not
belong together (channel order, exposure, encoding, bit depth, black level). Whether
the camera stands where the render has it is told; --register moves the render accordingly.

With --force, the force of a press by finite elements is compared with a measured one instead."""


def add_parser(verbs: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Register the verb."""
    parser = verbs.add_parser(
        "compare", help=HELP, description=DESCRIPTION, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "simulated", type=Path, nargs="?", metavar="SIMULATED", help="record of a simulated press, or a folder of them"
    )
    parser.add_argument(
        "capture", type=Path, nargs="?", metavar="CAPTURE", help="record of a tactile capture, or a folder of them"
    )
    parser.add_argument(
        "--pairs", type=Path, metavar="CSV",
        help="pairs to compare: columns simulated, captured (files, relative to the CSV), and name if wanted",
    )  # fmt: skip
    parser.add_argument("--register", action="store_true", help="move the render by the drift of the camera")
    parser.add_argument(
        "--despite-mismatch",
        action="store_true",
        help="compare images that do not belong together; say so in the report",
    )
    parser.add_argument(
        "--normal-map", type=Path, metavar="FILE",
        help="also compare normals and depth, by the map that 'finray study normal-map' wrote",
    )  # fmt: skip
    parser.add_argument(
        "--scale", type=Path, metavar="FILE",
        help="also give the scale and the sizes of patch and halo in mm, by what 'finray study pixel-scale' wrote",
    )  # fmt: skip
    add_force(parser)
    add_out(parser, "photometric-error.json, with --force force-comparison.json; with folders photometric-errors")
    add_seed(parser)
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> None:
    """Compare one pair, or all pairs of two folders or a list."""
    from data_schemas.errors import CompareError

    if arguments.force is not None:
        return compare_force_verb(arguments)
    refuse_force_options(arguments)
    if (arguments.pairs is None) == (arguments.simulated is None):
        raise CompareError("give SIMULATED and CAPTURE, or --pairs CSV: one of the two")
    if arguments.simulated is not None and arguments.capture is None:
        raise CompareError(f"{arguments.simulated}: with what? Give CAPTURE too, a record or a folder as SIMULATED is")
    folders = [p is not None and p.is_dir() for p in (arguments.simulated, arguments.capture)]
    if arguments.pairs is None and folders[0] != folders[1]:
        raise CompareError(
            f"{arguments.simulated} and {arguments.capture}: one is a folder, the other is not; give two records "
            "or two folders"
        )
    if arguments.pairs is not None or folders[0]:
        from finray_calib.cli.compare_folders import compare_folders

        compare_folders(arguments)
    else:
        _compare_one(arguments)


def _compare_one(arguments: argparse.Namespace) -> None:
    """Compare one press with its capture."""
    from data_schemas.capture import TactileCapture
    from data_schemas.errors import CompareError
    from data_schemas.pixel_scale import PixelScale
    from data_schemas.product_set import ProductSet
    from data_schemas.provenance import provenance
    from data_schemas.sensing import NormalMapRecord
    from data_schemas.simulate import SimulatedPress
    from data_schemas.storage import read_record, write_record
    from finray_calib.compare.checked_comparison import CheckOptions, compare_checked
    from finray_calib.reports.comparison_page import comparison_page
    from finray_calib.reports.comparison_table import comparison_lines

    out = require_new(arguments.out or Path("photometric-error.json"))
    page = new_page_beside(out)
    press = read_record(arguments.simulated, SimulatedPress)
    capture = read_record(arguments.capture, TactileCapture)
    maps = [] if arguments.normal_map is None else [arguments.normal_map]
    normal_map = read_record(maps[0], NormalMapRecord) if maps else None
    scale = None if arguments.scale is None else read_record(arguments.scale, PixelScale)
    options = CheckOptions(arguments.register, arguments.despite_mismatch, normal_map, scale)
    with naming(CompareError, arguments.simulated, arguments.capture):
        report, shown = compare_checked(press, capture, arguments.seed, options)
    inputs = input_digests(
        [arguments.simulated, arguments.capture, *maps, *([arguments.scale] if arguments.scale else [])]
    )
    with ProductSet(out) as products:
        products.add(page, comparison_page(report, shown, capture, command_line(), inputs).encode())
        write_record(report, out, provenance(command_line(), inputs, arguments.seed), products)
    say(comparison_lines(report))
    for finding in report.findings:
        say(f"{finding}\n")
    say(f"{out}: written\n{page}: written, to be read in a browser or printed")
