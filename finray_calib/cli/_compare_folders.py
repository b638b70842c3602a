"""``finray compare`` of folders or a list of pairs: a report for each pair, one page over presses and simulators."""

import argparse
import csv
import io
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import zip_longest
from pathlib import Path
from typing import TYPE_CHECKING

from data_schemas import CompareError, FinrayError, RecordError
from finray_calib.cli._output import give, look_at, progress_bar, say, warn, wrote
from finray_calib.cli._run import command_line, distinct_file_names, input_digests, require_new, require_place

if TYPE_CHECKING:
    from data_schemas import (
        ComparedPair,
        ComparisonBatch,
        PhotometricErrorReport,
        Provenance,
        SimulatedPress,
        TactileCapture,
    )
    from data_schemas.storage import ProductSet
    from finray_calib.compare import CheckOptions
    from finray_calib.reports import PressPictures

SUMMARY, TABLE, PAGE = "summary.json", "summary.csv", "summary.html"
REPORT = ".photometric-error"
MOST_PAGES = 20
COLUMNS = (
    "simulator", "name", "skill", "skill_low", "skill_high", "floor_skill", "findings", "error",
    "simulated", "captured",
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class _Job:
    """One pair to compare: its files, what is known of the press, and where its report goes, within the output."""

    simulator: str
    name: str
    simulated: Path
    captured: Path
    report: Path
    press: str = ""
    session: str | None = None
    sensor: str | None = None


def compare_folders(arguments: argparse.Namespace) -> None:
    """Compare all pairs; a pair that fails is told and does not stop the others.

    Raises
    ------
    CompareError
        No pair is there, or none could be compared (the summary says why, pair by pair).
    """
    from data_schemas import ComparisonBatch, NormalMapRecord, PixelScale, provenance
    from data_schemas.storage import ProductSet, digest_as_read, read_record, write_record
    from finray_calib.compare import DILATED, CheckOptions, rank_simulators, skill_differences, to_capture, worst_pairs
    from finray_calib.reports import batch_page

    jobs, notes = _jobs(arguments)
    out = _place(arguments.out or Path("photometric-errors"), jobs)
    normal_map = None if arguments.normal_map is None else read_record(arguments.normal_map, NormalMapRecord)
    scale = None if arguments.scale is None else read_record(arguments.scale, PixelScale)
    options = CheckOptions(arguments.register, arguments.despite_mismatch, normal_map, scale)
    listed = [file for file in (arguments.normal_map, arguments.scale) if file is not None]
    compared = []
    with progress_bar("compare") as progress:
        for number, job in enumerate(jobs):
            progress(number, len(jobs), job.name)
            compared.append(_compare_pair(job, listed, out, arguments.seed, options))
    succeeded = [pair for pair in compared if pair.skill is not None]
    simulators, unshared = rank_simulators(compared)
    if unshared:
        notes.append(f"not in the ranking, as not every simulator has them: {', '.join(unshared)}")
    batch = ComparisonBatch(
        pairs=tuple(compared),
        headline_region=DILATED if succeeded else None,
        simulators=simulators,
        differences=skill_differences(compared, [s.simulator for s in simulators]),
        worst=worst_pairs(compared),
        to_capture_next=to_capture(compared),
        notes=tuple(notes),
    )
    read = [f for job in jobs for f in (job.simulated, job.captured) if digest_as_read(f) is not None]
    inputs = input_digests([*read, *listed, *([] if arguments.pairs is None else [arguments.pairs])])
    with ProductSet(out / SUMMARY) as products:
        shown = _worst_pages(jobs, compared, out, products, options)
        products.add(out / TABLE, _table(batch).encode())
        products.add(out / PAGE, batch_page(batch, shown, command_line(), inputs).encode())
        write_record(batch, out / SUMMARY, provenance(command_line(), inputs, arguments.seed), products)
    say(_told(batch))
    wrote(out, f"{len(succeeded)} of {len(jobs)} pairs compared; holds {PAGE}, {TABLE}, {SUMMARY} and reports")
    give(pairs=batch.pairs, compared=len(succeeded), simulators=batch.simulators, lowest=batch.worst)
    look_at(out / PAGE)
    if not succeeded:
        raise CompareError(f"none of the {len(jobs)} pairs could be compared; {out / TABLE} says why")


def _place(out: Path, jobs: Sequence[_Job]) -> Path:
    """Return the folder to write: new, or what an interrupted comparison left, which holds reports and no summary."""
    from data_schemas.storage import clear_leftovers

    clear_leftovers(out)
    stems = {job.report.as_posix().removesuffix(".json") for job in jobs}
    above = {job.report.parent.as_posix() for job in jobs}
    left = [path.relative_to(out).as_posix() for path in out.rglob("*")] if out.is_dir() else [SUMMARY]
    if all(name in above or _REPORT_FILE.sub("", name) in stems for name in left):
        return require_place(out / SUMMARY).parent
    return require_new(out)


_REPORT_FILE = re.compile(r"(\.[0-9a-f]{12}\.npz|\.json|\.html)$")


def _jobs(arguments: argparse.Namespace) -> tuple[list[_Job], list[str]]:
    """Return the pairs to compare, and what to tell of files without partner."""
    notes: list[str] = []
    if arguments.pairs is not None:
        found = _of_table(arguments.pairs)
    else:
        found, notes = _of_folders(arguments)
    several = len({job.simulator for job in found}) > 1
    folders = distinct_file_names([job.simulator for job in found])
    files = distinct_file_names([job.name for job in found])
    jobs = []
    for job in found:
        file = Path(f"{files[job.name]}{REPORT}.json")
        report = Path(folders[job.simulator]) / file if several else file
        jobs.append(
            _Job(job.simulator, job.name, job.simulated, job.captured, report, job.press, job.session, job.sensor)
        )
    return jobs, notes


def _of_table(path: Path) -> list[_Job]:
    """Return the pairs of a table."""
    from finray_calib.compare import pairs_of_rows

    above = path.parent
    return [
        _Job(r.simulator, r.name, above / r.simulated, above / r.captured, Path(), r.press, r.session, r.sensor)
        for r in pairs_of_rows(_rows(path))
    ]


def _of_folders(arguments: argparse.Namespace) -> tuple[list[_Job], list[str]]:
    """Return the pairs of one folder of presses or more, each with the folder of captures."""
    from finray_calib.compare import pair_by_name

    captured: Path = arguments.capture
    jobs, notes = [], []
    named = _simulator_names(arguments.simulated)
    for name, folder in named.items():
        paired, alone = pair_by_name(*([file.name for file in part.iterdir()] for part in (folder, captured)))
        jobs += [_Job(name, press, folder / one, captured / two, Path()) for press, (one, two) in paired.items()]
        # a capture that the table was taught with has no press: that is no fault
        notes += [f"{f}: has no partner and was left out" for f in alone if len(named) == 1 or (folder / f).is_file()]
    notes = list(dict.fromkeys(notes))
    for note in notes:
        warn(note)
    return jobs, notes


def _simulator_names(folders: Sequence[Path]) -> dict[str, Path]:
    """Return the name of each simulator: that of its folder, with those above where two are alike."""
    found: dict[str, Path] = {}
    for folder in folders:
        parts = folder.resolve().parts
        name = next(
            (n for n in ("/".join(parts[-k:]) for k in range(1, len(parts))) if n not in found), str(folder.resolve())
        )
        if folder.resolve() in [other.resolve() for other in found.values()]:
            raise CompareError(f"{folder}: is given twice; give each folder of simulated presses once")
        found[name] = folder
    return found


def _rows(path: Path) -> list[dict[str, str | None]]:
    """Return the rows of a CSV file with header."""
    from data_schemas.storage import read_csv

    header, rows = read_csv(path, "a CSV file in UTF-8 with a header row", CompareError)
    return [dict(zip_longest(header, cells[: len(header)])) for _, cells in rows]


def _compare_pair(job: _Job, listed: list[Path], out: Path, seed: int, options: "CheckOptions") -> "ComparedPair":
    """Compare one pair and store its report, or return why not; a report that is there already is taken."""
    from data_schemas import ComparedPair, provenance
    from data_schemas.storage import write_record
    from finray_calib.compare import compare_checked

    places = {
        "name": job.name, "simulated": str(job.simulated), "captured": str(job.captured), "simulator": job.simulator,
        "press": job.press, "session": job.session, "sensor": job.sensor,
    }  # fmt: skip
    path = out / job.report
    try:
        press, capture = _read_pair(job)
        origin = provenance(command_line(), input_digests([job.simulated, job.captured, *listed]), seed)
        report = None if path.exists() else compare_checked(press, capture, seed, options)[0]
    except (FinrayError, OSError) as error:
        warn(f"{job.name}: {error}")
        return ComparedPair.model_validate({**places, "error": str(error)})
    # A disk that takes no more is no fault of the pair: it ends the command, which goes on here when run again.
    if report is None:
        report = _stored_report(path, origin)
    else:
        write_record(report, path, origin)
    region = next(r for r in report.regions if r.region == report.headline_region)
    floors = [row.skill for row in region.rows if row.candidate == "floor"]
    return ComparedPair.model_validate(
        {
            **places,
            "sensor": job.sensor or capture.rig,
            "report": job.report.as_posix(),
            "skill": report.headline_skill,
            "floor_skill": floors[0] if floors else None,
            "contact_signal": report.contact_signal,
            "findings": report.findings,
        }
    )


def _read_pair(job: _Job) -> "tuple[SimulatedPress, TactileCapture]":
    """Read a press and its capture."""
    from data_schemas import SimulatedPress, TactileCapture
    from data_schemas.storage import read_record

    return read_record(job.simulated, SimulatedPress), read_record(job.captured, TactileCapture)


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


def _worst_pages(
    jobs: Sequence[_Job],
    compared: "Sequence[ComparedPair]",
    out: Path,
    products: "ProductSet",
    options: "CheckOptions",
) -> "list[PressPictures]":
    """Write the pages of the pairs of lowest skill, and return their pictures for the page over all."""
    from data_schemas import PhotometricErrorReport
    from data_schemas.storage import read_record
    from finray_calib.compare import shown_press
    from finray_calib.reports import comparison_page, press_pictures

    found = []
    for k in _worst_of_each(compared):
        job, path = jobs[k], out / jobs[k].report
        report = read_record(path, PhotometricErrorReport)
        press, capture = _read_pair(job)
        shown = shown_press(press, capture, options.registered)
        digests: Mapping[str, str] = {} if report.provenance is None else report.provenance.input_sha256
        page = comparison_page(report, shown, capture, command_line(), digests)
        products.add(path.with_suffix(".html"), page.encode())
        link = job.report.with_suffix(".html").as_posix()
        found.append(press_pictures(job.simulator, job.name, link, report, shown, capture))
    return found


def _worst_of_each(compared: "Sequence[ComparedPair]") -> list[int]:
    """Return which pairs have the lowest skills, as many of each simulator; an untouched image is none."""
    names = list(dict.fromkeys(pair.simulator for pair in compared))
    scored = [
        (pair.skill.estimate, k)
        for k, pair in enumerate(compared)
        if pair.skill is not None and abs(pair.skill.estimate) > _NOTHING
    ]
    scored.sort()
    share = max(1, MOST_PAGES // max(1, len({compared[k].simulator for _, k in scored})))
    chosen = [k for name in names for _, k in [s for s in scored if compared[s[1]].simulator == name][:share]]
    return sorted(chosen, key=[k for _, k in scored].index)[:MOST_PAGES]


_NOTHING = 1e-6


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
        table.writerow((pair.simulator, pair.name, *numbers, floor, *rest))
    return text.getvalue()


def _told(batch: "ComparisonBatch") -> str:
    """Return the summary in a few lines."""
    from finray_calib.reports import batch_lines

    lines = []
    several = len(batch.simulators) > 1
    for pair in batch.pairs:
        name = f"{pair.simulator} {pair.name}" if several else pair.name
        if pair.skill is None:
            lines.append(f"{name:30} failed: {pair.error}")
        else:
            lines.append(f"{name:30} skill {pair.skill.estimate:6.3f}")
    return "\n".join([*lines, *batch_lines(batch)])
