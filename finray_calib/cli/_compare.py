"""``finray compare``: how far simulated presses are from real captures; of a pair, of folders, or of a force."""

import argparse
import csv
import io
import re
from collections.abc import Iterable
from itertools import zip_longest
from pathlib import Path
from typing import TYPE_CHECKING

from data_schemas import CompareError, FinrayError, RecordError
from finray_calib.cli._output import give, go_on_with, look_at, progress_bar, say, warn, wrote
from finray_calib.cli._run import (
    add_out,
    add_seed,
    command_line,
    file_name,
    input_digests,
    naming,
    new_page_beside,
    require_new,
    require_place,
)

if TYPE_CHECKING:
    from data_schemas import (
        ComparedPair,
        ComparisonBatch,
        PhotometricErrorReport,
        Provenance,
        SimulatedPress,
        TactileCapture,
    )
    from finray_calib.compare import CheckOptions


HELP = "compare simulated presses with tactile captures"
DESCRIPTION = """\
Compare a simulated press with a tactile capture over the contact patch and over the patch dilated to twice
its half-width. Every number stands beside doing nothing (the no-contact image as the simulation) and the floor
(what a repeat of the no-contact image costs). The headline is the skill score: 0 is doing nothing, 1 is perfect.
The noise of linear captures with a repeat is taken out of the simulation's score but not of the floor, so that the
score may lie above it; with encoded values both hold the noise, and scores above the floor row are not meaningful.

With two folders, one.press.json is compared with one.capture.json and so on (or the pairs of --pairs): a report
for each, and a summary over the presses.

Another light angle, indenter, depth or position than the capture states is refused, and so are images that do not
belong together (channel order, exposure, encoding, bit depth, black level). A camera that
does not stand where the render has it is reported; --register moves the render accordingly.

With --force, the force of a press by finite elements is compared with a measured one instead."""


def add_compare(verbs: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Register the verb."""
    parser = verbs.add_parser("compare", help=HELP, description=DESCRIPTION)
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
        help="also compare normals and depth, by the map that 'finray sense teach' wrote",
    )  # fmt: skip
    parser.add_argument(
        "--scale", type=Path, metavar="FILE",
        help="also give the scale and the sizes of patch and halo in mm, by what 'finray sense scale' wrote",
    )  # fmt: skip
    add_force(parser)
    add_out(parser, "photometric-error.json, with --force force-comparison.json; with folders photometric-errors")
    add_seed(parser)
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> None:
    """Compare one pair, or all pairs of two folders or a list."""
    from data_schemas import CompareError

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
        compare_folders(arguments)
    else:
        _compare_one(arguments)


def _compare_one(arguments: argparse.Namespace) -> None:
    """Compare one press with its capture."""
    from data_schemas import CompareError, NormalMapRecord, PixelScale, SimulatedPress, TactileCapture, provenance
    from data_schemas.storage import ProductSet, read_record, write_record
    from finray_calib.compare import CheckOptions, compare_checked
    from finray_calib.reports import comparison_lines, comparison_page

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
    wrote(out, "the comparison")
    wrote(page, "its page, to be read in a browser or printed")
    give(headline_skill=report.headline_skill, headline_region=report.headline_region, findings=report.findings)
    go_on_with("finray decide SWEEP --photometric-error", out)
    look_at(page)


SUMMARY, TABLE = "summary.json", "summary.csv"
_REPORT_FILE = re.compile(r"(\.[0-9a-f]{12}\.npz|\.json|\.html)$")
COLUMNS = ("name", "skill", "skill_low95", "skill_high95", "floor_skill", "findings", "error", "simulated", "captured")


def compare_folders(arguments: argparse.Namespace) -> None:
    """Compare all pairs; a pair that fails is told and does not stop the others.

    Raises
    ------
    CompareError
        No pair is there, or none could be compared (the summary says why, pair by pair).
    """
    import numpy as np

    from data_schemas import ComparisonBatch, NormalMapRecord, PixelScale, provenance
    from data_schemas.storage import ProductSet, digest_as_read, read_record, write_record
    from finray_calib.compare import DILATED, CheckOptions, mean_skill, worst_pairs

    pairs, notes = _pairs(arguments)
    out = _place(arguments.out or Path("photometric-errors"), pairs)
    normal_map = None if arguments.normal_map is None else read_record(arguments.normal_map, NormalMapRecord)
    scale = None if arguments.scale is None else read_record(arguments.scale, PixelScale)
    options = CheckOptions(arguments.register, arguments.despite_mismatch, normal_map, scale)
    listed = [file for file in (arguments.normal_map, arguments.scale) if file is not None]
    compared = []
    with progress_bar("compare") as progress:
        for number, (name, files) in enumerate(pairs.items()):
            progress(number, len(pairs), name)
            compared.append(_compare_pair(name, files, listed, out, arguments.seed, options))
    skills = np.array([pair.skill.estimate for pair in compared if pair.skill is not None])
    batch = ComparisonBatch(
        pairs=tuple(compared),
        headline_region=DILATED if skills.size else None,
        mean_skill=mean_skill(skills),
        worst=worst_pairs(compared),
        notes=tuple(notes),
    )
    read = [f for pair in pairs.values() for f in pair if digest_as_read(f) is not None]
    inputs = input_digests([*read, *listed, *([] if arguments.pairs is None else [arguments.pairs])])
    with ProductSet(out / SUMMARY) as products:
        products.add(out / TABLE, _table(batch).encode())
        write_record(batch, out / SUMMARY, provenance(command_line(), inputs, arguments.seed), products)
    say(_told(batch))
    wrote(out, f"{skills.size} of {len(pairs)} pairs compared; holds {SUMMARY}, {TABLE} and their reports")
    give(pairs=batch.pairs, compared=skills.size, mean_skill=batch.mean_skill, lowest=batch.worst)
    look_at(out / TABLE)
    if not skills.size:
        raise CompareError(f"none of the {len(pairs)} pairs could be compared; {out / TABLE} says why")


def _place(out: Path, names: Iterable[str]) -> Path:
    """Return the folder to write: new, or what an interrupted comparison left, which holds reports and no summary."""
    from data_schemas.storage import clear_leftovers

    clear_leftovers(out)
    stems = {_report_name(name).removesuffix(".json") for name in names}
    left = [path.name for path in out.iterdir()] if out.is_dir() else [SUMMARY]
    if all(_REPORT_FILE.sub("", name) in stems for name in left):
        return require_place(out / SUMMARY).parent
    return require_new(out)


def _report_name(name: str) -> str:
    """Return the file of a pair's report."""
    return f"{file_name(name)}.photometric-error.json"


def _pairs(arguments: argparse.Namespace) -> tuple[dict[str, tuple[Path, Path]], list[str]]:
    """Return name -> files, and what to tell of files without partner."""
    from finray_calib.compare import pair_by_name, pairs_of_rows

    if arguments.pairs is not None:
        listed = pairs_of_rows(_rows(arguments.pairs))
        above = arguments.pairs.parent
        return {name: (above / first, above / second) for name, (first, second) in listed.items()}, []
    simulated, captured = arguments.simulated, arguments.capture
    paired, alone = pair_by_name(*([file.name for file in folder.iterdir()] for folder in (simulated, captured)))
    notes = [f"{file}: has no partner and was left out" for file in alone]
    for note in notes:
        warn(note)
    return {name: (simulated / first, captured / second) for name, (first, second) in paired.items()}, notes


def _rows(path: Path) -> list[dict[str, str | None]]:
    """Return the rows of a CSV file with header."""
    from data_schemas.storage import read_csv

    header, rows = read_csv(path, "a CSV file in UTF-8 with a header row", CompareError)
    return [dict(zip_longest(header, cells[: len(header)])) for _, cells in rows]


def _compare_pair(
    name: str, files: tuple[Path, Path], listed: list[Path], out: Path, seed: int, options: "CheckOptions"
) -> "ComparedPair":
    """Compare one pair and store its report, or return why not; a report that is there already is taken."""
    from data_schemas import ComparedPair, provenance
    from finray_calib.compare import compare_checked

    places = {"name": name, "simulated": str(files[0]), "captured": str(files[1])}
    path = out / _report_name(name)
    try:
        press, capture = _read_pair(files)
        origin = provenance(command_line(), input_digests([*files, *listed]), seed)
        report, shown = None, press
        if not path.exists():
            report, shown = compare_checked(press, capture, seed, options)
    except (FinrayError, OSError) as error:
        warn(f"{name}: {error}")
        return ComparedPair.model_validate({**places, "error": str(error)})
    # A disk that takes no more is no fault of the pair: it ends the command, which goes on here when run again.
    if report is None:
        report = _stored_report(path, origin)
    else:
        _store_report(path, report, shown, capture, origin)
    region = next(r for r in report.regions if r.region == report.headline_region)
    floors = [row.skill for row in region.rows if row.candidate == "floor"]
    return ComparedPair.model_validate(
        {
            **places,
            "report": path.name,
            "skill": report.headline_skill,
            "floor_skill": floors[0] if floors else None,
            "findings": report.findings,
        }
    )


def _read_pair(files: tuple[Path, Path]) -> "tuple[SimulatedPress, TactileCapture]":
    """Read a press and its capture."""
    from data_schemas import SimulatedPress, TactileCapture
    from data_schemas.storage import read_record

    return read_record(files[0], SimulatedPress), read_record(files[1], TactileCapture)


def _stored_report(path: Path, origin: "Provenance") -> "PhotometricErrorReport":
    """Return the report that the same command stored before it was interrupted.

    Raises
    ------
    RecordError
        It is of another command, of other files or of another version.
    """
    from data_schemas import PhotometricErrorReport
    from data_schemas.storage import read_record

    report = read_record(path, PhotometricErrorReport)
    time = {"created_utc": origin.created_utc}
    if report.provenance is None or report.provenance.model_copy(update=time) != origin:
        raise RecordError(
            f"{path}: is there already, of another command, version or other files; choose another --out or move it "
            "away"
        )
    return report


def _store_report(
    path: Path,
    report: "PhotometricErrorReport",
    shown: "SimulatedPress",
    capture: "TactileCapture",
    origin: "Provenance",
) -> None:
    """Write the report of a pair and its page."""
    from data_schemas.storage import ProductSet, write_record
    from finray_calib.reports import comparison_page

    page = comparison_page(report, shown, capture, origin.command, origin.input_sha256)
    with ProductSet(path) as products:
        products.add(path.with_suffix(".html"), page.encode())
        write_record(report, path, origin, products)


def _table(batch: "ComparisonBatch") -> str:
    """Return one row per pair, for spreadsheets."""
    text = io.StringIO(newline="")
    table = csv.writer(text)
    table.writerow(COLUMNS)
    for pair in batch.pairs:
        skill = pair.skill
        numbers = ("", "", "") if skill is None else (skill.estimate, skill.low95, skill.high95)
        floor = "" if pair.floor_skill is None else pair.floor_skill.estimate
        rest = (" | ".join(pair.findings), pair.error or "", pair.simulated, pair.captured)
        table.writerow((pair.name, *numbers, floor, *rest))
    return text.getvalue()


def _told(batch: "ComparisonBatch") -> str:
    """Return the summary in a few lines."""
    lines = []
    for pair in batch.pairs:
        if pair.skill is None:
            lines.append(f"{pair.name:30} failed: {pair.error}")
        else:
            lines.append(
                f"{pair.name:30} skill {pair.skill.estimate:6.3f}  [{pair.skill.low95:.3f}, {pair.skill.high95:.3f}]"
            )
    if batch.mean_skill is not None:
        mean = batch.mean_skill
        lines.append(
            f"mean skill {mean.estimate:.3f} [{mean.low95:.3f}, {mean.high95:.3f}] over {batch.headline_region} "
            f"(95 %, Student's t over the presses); lowest: {', '.join(batch.worst)}"
        )
    return "\n".join(lines)


DEFAULT_OUT = "force-comparison.json"


def add_force(parser: argparse.ArgumentParser) -> None:
    """Add the options of a comparison of forces."""
    parser.add_argument(
        "--force", type=Path, metavar="CSV",
        help="compare the force of SIMULATED (NAME.mechanics.json) with a measured one: columns displacement_mm and "
        "force_n, if known force_uncertainty_n and displacement_uncertainty_mm",
    )  # fmt: skip
    parser.add_argument(
        "--known-first-touch", action="store_true",
        help="with --force: displacements count from first touch; it is not fitted",
    )  # fmt: skip
    parser.add_argument(
        "--other-mesh", type=Path, metavar="FILE",
        help="with --force: the same press on another mesh; where they differ by more than the mesh of the 70 x 35 "
        "finger is known to be off by, that is its uncertainty",
    )  # fmt: skip


def compare_force_verb(arguments: argparse.Namespace) -> None:
    """Compare, store record and figure, and tell the table."""
    from data_schemas import CompareError

    if arguments.simulated is None or arguments.capture is not None or arguments.pairs is not None:
        raise CompareError(
            "--force compares one record with a CSV: give NAME.mechanics.json, no CAPTURE and no --pairs"
        )
    if arguments.register or arguments.despite_mismatch or arguments.normal_map is not None:
        raise CompareError("--force: --register, --despite-mismatch and --normal-map belong to images; leave them out")

    import numpy as np

    from data_schemas import PressMechanics, provenance
    from data_schemas.storage import ProductSet, read_record, write_record
    from finray_calib.exchange import read_force_csv
    from finray_calib.force import compare_force
    from finray_calib.reports import force_figure_png, force_lines

    out = require_new(arguments.out or Path(DEFAULT_OUT))
    if out.suffix != ".json":
        raise CompareError(f"{out}: is to be a record; choose an --out that ends in .json, the figure goes beside it")
    picture = require_new(out.with_suffix(".png"))
    press = read_record(arguments.simulated, PressMechanics)
    other = None if arguments.other_mesh is None else read_record(arguments.other_mesh, PressMechanics)
    measured = read_force_csv(arguments.force)
    with naming(CompareError, arguments.simulated):
        comparison = compare_force(
            press, measured, np.random.default_rng(arguments.seed), not arguments.known_first_touch, other
        )
    read = [arguments.simulated, arguments.force, *([] if arguments.other_mesh is None else [arguments.other_mesh])]
    with ProductSet(out) as products:
        products.add(picture, force_figure_png(comparison))
        write_record(comparison, out, provenance(command_line(), input_digests(read), arguments.seed), products)
    say(force_lines(comparison))
    wrote(out, "the comparison")
    wrote(picture, "curve and points" if comparison.withheld else "curve, band and points")
    give(label=comparison.label, rows=comparison.rows, withheld=comparison.withheld)
    look_at(picture)


def refuse_force_options(arguments: argparse.Namespace) -> None:
    """Refuse options that belong to a comparison of forces where images are compared."""
    from data_schemas import CompareError

    if arguments.known_first_touch or arguments.other_mesh is not None:
        raise CompareError("--known-first-touch and --other-mesh belong to --force CSV; add it, or leave them out")
