"""``finray compare`` with folders: a report for each pair, and a summary over the presses."""

import argparse
import csv
import io
import re
from collections.abc import Iterable
from itertools import zip_longest
from pathlib import Path
from typing import TYPE_CHECKING

from data_schemas.errors import CompareError, FinrayError, RecordError
from finray_calib.cli.options import (
    command_line,
    file_name,
    input_digests,
    progress_bar,
    require_new,
    require_place,
    say,
    warn,
)

if TYPE_CHECKING:
    from data_schemas.capture import TactileCapture
    from data_schemas.compare import PhotometricErrorReport
    from data_schemas.comparison_batch import ComparedPair, ComparisonBatch
    from data_schemas.provenance import Provenance
    from data_schemas.simulate import SimulatedPress
    from finray_calib.compare.checked_comparison import CheckOptions

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

    from data_schemas.comparison_batch import ComparisonBatch
    from data_schemas.foreign_files import digest_as_read
    from data_schemas.pixel_scale import PixelScale
    from data_schemas.product_set import ProductSet
    from data_schemas.provenance import provenance
    from data_schemas.sensing import NormalMapRecord
    from data_schemas.storage import read_record, write_record
    from finray_calib.compare.batch import mean_skill, worst_pairs
    from finray_calib.compare.checked_comparison import CheckOptions
    from finray_calib.compare.regions import DILATED

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
    say(f"{out}: {skills.size} of {len(pairs)} pairs compared; {SUMMARY}, {TABLE} and their reports written")
    if not skills.size:
        raise CompareError(f"none of the {len(pairs)} pairs could be compared; {out / TABLE} says why")


def _place(out: Path, names: Iterable[str]) -> Path:
    """Return the folder to write: new, or what an interrupted comparison left, which holds reports and no summary."""
    from data_schemas.leftovers import clear_leftovers

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
    from finray_calib.compare.batch import pair_by_name, pairs_of_rows

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
    from data_schemas.foreign_files import read_csv

    header, rows = read_csv(path, "a CSV file in UTF-8 with a header row", CompareError)
    return [dict(zip_longest(header, cells[: len(header)])) for _, cells in rows]


def _compare_pair(
    name: str, files: tuple[Path, Path], listed: list[Path], out: Path, seed: int, options: "CheckOptions"
) -> "ComparedPair":
    """Compare one pair and store its report, or return why not; a report that is there already is taken."""
    from data_schemas.comparison_batch import ComparedPair
    from data_schemas.provenance import provenance
    from finray_calib.compare.checked_comparison import compare_checked

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
    from data_schemas.capture import TactileCapture
    from data_schemas.simulate import SimulatedPress
    from data_schemas.storage import read_record

    return read_record(files[0], SimulatedPress), read_record(files[1], TactileCapture)


def _stored_report(path: Path, origin: "Provenance") -> "PhotometricErrorReport":
    """Return the report that the same command stored before it was interrupted.

    Raises
    ------
    RecordError
        It is of another command, of other files or of another version.
    """
    from data_schemas.compare import PhotometricErrorReport
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
    from data_schemas.product_set import ProductSet
    from data_schemas.storage import write_record
    from finray_calib.reports.comparison_page import comparison_page

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
            f"(95 %, presses drawn with replacement); lowest: {', '.join(batch.worst)}"
        )
    return "\n".join(lines)
