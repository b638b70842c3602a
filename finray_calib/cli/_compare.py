"""``finray compare``: how far simulated presses are from real captures; of a pair, of folders, or of a force."""

import argparse
from pathlib import Path

from finray_calib.cli._output import give, say, suggest_command, suggest_file, wrote
from finray_calib.cli._run import (
    add_out,
    add_seed,
    command_line,
    input_digests,
    naming,
    new_page_beside,
    require_new,
)

HELP = "compare simulated presses with tactile captures"
DESCRIPTION = """\
Compare a simulated press with a tactile capture over the contact patch and over the patch dilated to twice
its half-width. Every number is printed beside the same number for doing nothing (the no-contact image taken as the
simulation) and for the noise floor (a repeat of the no-contact image). The headline is the skill score: 0 is doing
nothing, 1 is perfect. The noise of linear captures with a repeat is taken out of the simulation's score and out of the
floor, which then shows how far the image without contact drifted; with encoded values both contain the noise, and
scores above the floor row are not meaningful.

With folders, one.press.json is compared with one.capture.json and so on (or the pairs of --pairs): a report for
each, and a page over all presses with an interval over presses, from three presses on. Several folders of simulated
presses, one of each simulator, are ranked: 'finray compare MINE TABLE CAPTURES'.

The command refuses a press whose light angle, indenter, depth or position is not that of the capture, and images that
do not belong together (channel order, exposure, encoding, bit depth, black level). It reports how far the camera is
from the place that the render assumes; --register moves the render accordingly.

With --force, the force of a press by finite elements is compared with a measured one instead."""


def add_compare(verbs: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Register the verb."""
    parser = verbs.add_parser("compare", help=HELP, description=DESCRIPTION)
    parser.add_argument(
        "records", type=Path, nargs="*", metavar="SIMULATED ... CAPTURE",
        help="either two records (a simulated press, then a tactile capture), or one folder of simulated presses for "
             "each simulator, followed by the folder of captures; folders may be zip archives",
    )  # fmt: skip
    parser.add_argument(
        "--pairs", type=Path, metavar="CSV",
        help="table of pairs to compare, with the columns simulated and captured (files, relative to the CSV) and "
             "optionally name, simulator, press (the same for repeats of one press), session and sensor",
    )  # fmt: skip
    parser.add_argument("--register", action="store_true", help="shift the render by the measured drift of the camera")
    parser.add_argument(
        "--despite-mismatch",
        action="store_true",
        help="compare images even if they do not belong together; the report then says so",
    )
    parser.add_argument(
        "--relative", action="store_true",
        help="compare only the change caused by contact; the captured image without contact then replaces the "
             "rendered one (needs linear values)",
    )  # fmt: skip
    parser.add_argument(
        "--normal-map", type=Path, metavar="FILE",
        help="also compare normals and depth, with the normal map that 'finray sense teach' wrote",
    )  # fmt: skip
    parser.add_argument(
        "--scale", type=Path, metavar="FILE",
        help="also give the sizes of contact patch and dilated patch in mm, with the scale that 'finray sense scale' "
             "measured",
    )  # fmt: skip
    parser.add_argument(
        "--metric", action="append", default=[], metavar="NAME",
        help="also compute this metric of an installed package (repeatable; for a single pair only)",
    )  # fmt: skip
    add_force(parser)
    add_out(parser, "photometric-error.json, with --force force-comparison.json; with folders photometric-errors")
    add_seed(parser)
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> None:
    """Compare one pair, or all pairs of two folders or a list."""
    from data_schemas import CompareError
    from data_schemas.storage import folder_at
    from finray_calib.cli._compare_folders import compare_folders

    if arguments.force is not None:
        return compare_force_verb(arguments)
    refuse_force_options(arguments)
    records: list[Path] = arguments.records
    if (arguments.pairs is None) == (not records):
        raise CompareError("either SIMULATED and CAPTURE or --pairs CSV must be given, but not both")
    if len(records) == 1:
        raise CompareError(
            f"{records[0]}: CAPTURE, the record or folder to compare with, is missing; add a record if SIMULATED is a "
            "record, or a folder if SIMULATED is a folder"
        )
    inside = [folder_at(path, CompareError) for path in records]
    folders = [folder is not None for folder in inside]
    if any(folders) and not all(folders):
        for path, is_folder in zip(records, folders, strict=True):
            if not is_folder and not path.exists():
                raise CompareError(f"{path}: no such file or folder; give two records or folders")
        raise CompareError(
            f"{' and '.join(str(path) for path in records)}: some are folders, others are not; give two records, "
            "or folders only"
        )
    if len(records) > 2 and not any(folders):
        raise CompareError(
            f"{records[2]}: is a third record, but only two are compared; give one record of a press and one of a "
            "capture, or folders"
        )
    if records:
        records = [folder or path for folder, path in zip(inside, records, strict=True)]
        arguments.simulated, arguments.capture = records[:-1], records[-1]
    if arguments.pairs is not None or folders[0]:
        if arguments.metric:
            raise CompareError(
                "--metric works only for one press and one capture, not for folders or --pairs; leave it out"
            )
        compare_folders(arguments)
    else:
        _compare_one(arguments.simulated[0], arguments)


def _compare_one(simulated: Path, arguments: argparse.Namespace) -> None:
    """Compare one press with its capture."""
    from data_schemas import CompareError, NormalMapRecord, PixelScale, SimulatedPress, TactileCapture, provenance
    from data_schemas.storage import ProductSet, read_record, write_record
    from finray_calib.compare import CheckOptions, compare_checked
    from finray_calib.reports import comparison_lines, comparison_page

    out = require_new(arguments.out or Path("photometric-error.json"), ".json")
    page = new_page_beside(out)
    press = read_record(simulated, SimulatedPress)
    capture = read_record(arguments.capture, TactileCapture)
    maps = [] if arguments.normal_map is None else [arguments.normal_map]
    normal_map = read_record(maps[0], NormalMapRecord) if maps else None
    scale = None if arguments.scale is None else read_record(arguments.scale, PixelScale)
    options = CheckOptions(
        arguments.register, arguments.despite_mismatch, normal_map, scale, tuple(dict.fromkeys(arguments.metric)),
        arguments.relative,
    )  # fmt: skip
    with naming(CompareError, simulated, arguments.capture):
        report, shown = compare_checked(press, capture, arguments.seed, options)
    inputs = input_digests([simulated, arguments.capture, *maps, *([arguments.scale] if arguments.scale else [])])
    with ProductSet(out) as products:
        products.add(page, comparison_page(report, shown, capture, command_line(), inputs).encode())
        write_record(report, out, provenance(command_line(), inputs, arguments.seed), products)
    say(comparison_lines(report))
    for finding in report.findings:
        say(f"{finding}\n")
    wrote(out, "the comparison")
    wrote(page, "its page, to be read in a browser or printed")
    give(
        headline_skill=report.headline_skill, headline_region=report.headline_region, findings=report.findings,
        packaged_metrics=report.packaged_metrics, relative=report.relative,
    )  # fmt: skip
    if report.objective_error is not None and not report.relative and not report.forced_mismatch:
        suggest_command("finray decide SWEEP --photometric-error", out)
    suggest_file(page)


DEFAULT_OUT = "force-comparison.json"


def add_force(parser: argparse.ArgumentParser) -> None:
    """Add the options of a comparison of forces."""
    parser.add_argument(
        "--force", type=Path, metavar="CSV",
        help="measured force curve to compare with the force of SIMULATED (NAME.mechanics.json), with the columns "
             "displacement_mm and force_n and, if known, force_uncertainty_n and displacement_uncertainty_mm",
    )  # fmt: skip
    parser.add_argument(
        "--known-first-touch", action="store_true",
        help="take the measured displacements as counted from first touch, instead of fitting where first touch is "
             "(with --force only)",
    )  # fmt: skip
    parser.add_argument(
        "--other-mesh", type=Path, metavar="FILE",
        help="record of the same press on another mesh (with --force only); the difference between the two presses "
             "is used as the uncertainty of the mesh where it is larger than the known error of the 70 x 35 finger's "
             "mesh",
    )  # fmt: skip


def compare_force_verb(arguments: argparse.Namespace) -> None:
    """Compare, store record and figure, and tell the table."""
    from data_schemas import CompareError

    records: list[Path] = arguments.records
    if len(records) != 1 or arguments.pairs is not None:
        raise CompareError(
            "--force compares exactly one record with a CSV file; give only NAME.mechanics.json, without CAPTURE and "
            "--pairs"
        )
    of_images = (arguments.register, arguments.despite_mismatch, arguments.relative, arguments.metric)
    if any(of_images) or arguments.normal_map is not None or arguments.scale is not None:
        raise CompareError(
            "--force compares no images, so it cannot be combined with --register, --despite-mismatch, --relative, "
            "--normal-map, --scale or --metric; leave them out"
        )

    import numpy as np

    from data_schemas import PressMechanics, provenance
    from data_schemas.storage import ProductSet, read_record, write_record
    from finray_calib.exchange import read_force_csv
    from finray_calib.force import compare_force
    from finray_calib.reports import force_figure_png, force_lines

    out = require_new(arguments.out or Path(DEFAULT_OUT), ".json")
    picture = require_new(out.with_suffix(".png"))
    press = read_record(records[0], PressMechanics)
    other = None if arguments.other_mesh is None else read_record(arguments.other_mesh, PressMechanics)
    measured = read_force_csv(arguments.force)
    with naming(CompareError, records[0]):
        comparison = compare_force(
            press, measured, np.random.default_rng(arguments.seed), not arguments.known_first_touch, other
        )
    read = [records[0], arguments.force, *([] if arguments.other_mesh is None else [arguments.other_mesh])]
    with ProductSet(out) as products:
        products.add(picture, force_figure_png(comparison))
        write_record(comparison, out, provenance(command_line(), input_digests(read), arguments.seed), products)
    say(force_lines(comparison))
    wrote(out, "the comparison")
    wrote(picture, "curve and points" if comparison.withheld else "curve, band and points")
    give(label=comparison.label, rows=comparison.rows, withheld=comparison.withheld)
    suggest_file(picture)


def refuse_force_options(arguments: argparse.Namespace) -> None:
    """Refuse options that belong to a comparison of forces where images are compared."""
    from data_schemas import CompareError

    if arguments.known_first_touch or arguments.other_mesh is not None:
        raise CompareError(
            "--known-first-touch and --other-mesh work only with --force CSV; add --force, or leave them out"
        )
