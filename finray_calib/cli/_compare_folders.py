"""``finray compare`` of folders or a list of pairs: a report for each pair, one page over presses and simulators."""

import argparse
import contextlib
import csv
import io
import os
import queue
import re
import signal
import threading
from collections.abc import Mapping, Sequence
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from dataclasses import dataclass, fields
from functools import lru_cache
from itertools import zip_longest
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypeVar

from data_schemas import CompareError, FieldError, FinrayError, ProcessDiedError, RecordError
from data_schemas.storage import Child, files_in, has_file, read_json, stopping_together
from finray_calib.cli._output import Progress, give, progress_bar, say, suggest_file, warn, wrote
from finray_calib.cli._run import (
    command_line,
    distinct_file_names,
    input_digests,
    naming,
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
    jobs, notes = _jobs(arguments)
    out = _place(arguments.out or Path("photometric-errors"), jobs)
    work = _Work(
        out, command_line(), arguments.seed, arguments.register, arguments.despite_mismatch, arguments.normal_map,
        arguments.scale, arguments.relative,
    )  # fmt: skip
    with _Workers(work, jobs) as workers:
        # while the processes start, too
        from data_schemas import provenance
        from data_schemas.storage import ProductSet, write_record
        from finray_calib.reports import PressPictures, batch_page

        _options.cache_clear()
        _options(work)  # a map or scale that cannot be read is a mistake of the whole command
        compared, read = _compare_all(jobs, workers)
        chosen = _worst_of_each(compared)
        pages = workers.do("page", [jobs[k] for k in chosen], "pages of the lowest scores")
    batch = _batch(compared, work, notes)
    succeeded = [pair for pair in compared if pair.skill is not None]
    inputs = read | input_digests([*work.listed, *([] if arguments.pairs is None else [arguments.pairs])])
    shown = [PressPictures.model_validate(page["pictures"]) for page in pages]
    with ProductSet(out / SUMMARY) as products:
        for k, page in zip(chosen, pages, strict=True):
            products.add((out / jobs[k].report).with_suffix(".html"), page["page"].encode())
        products.add(out / TABLE, _table(batch).encode())
        products.add(out / PAGE, batch_page(batch, shown, command_line(), inputs).encode())
        write_record(batch, out / SUMMARY, provenance(command_line(), inputs, arguments.seed), products)
    say(_told(batch))
    wrote(out, f"{len(succeeded)} of {len(jobs)} pairs compared; holds {PAGE}, {TABLE}, {SUMMARY} and reports")
    give(pairs=batch.pairs, compared=len(succeeded), simulators=batch.simulators, lowest=batch.worst,
         relative=batch.relative)  # fmt: skip
    suggest_file(out / PAGE)
    if not succeeded:
        raise CompareError(_none_compared(compared, out / TABLE))


def _none_compared(pairs: "Sequence[ComparedPair]", table: Path) -> str:
    """Return why no pair could be compared: the first reason, and for how many pairs it holds."""
    first = pairs[0].error
    alike = sum(pair.error == first for pair in pairs)
    for_how_many = "" if len(pairs) == 1 else f" (the same for {alike} of {len(pairs)})"
    none = f"none of the {len(pairs)} pair{'' if len(pairs) == 1 else 's'} could be compared"
    return f"{none}; first reason{for_how_many}: {first}; see all reasons in {table}"


def _batch(compared: "Sequence[ComparedPair]", work: "_Work", notes: list[str]) -> "ComparisonBatch":
    """Return the record of all pairs, with the ranking of the simulators and what to capture next."""
    from data_schemas import ComparisonBatch
    from finray_calib.compare import DILATED, rank_simulators, skill_differences, to_capture, worst_pairs

    simulators, unshared = rank_simulators(compared)
    if unshared:
        notes = [*notes, f"left out of the ranking, because not every simulator has them: {', '.join(unshared)}"]
    best = simulators[0].simulator if simulators else ""  # a weak one would name presses that are not hard
    return ComparisonBatch(
        pairs=tuple(compared),
        headline_region=DILATED if any(pair.skill is not None for pair in compared) else None,
        simulators=simulators,
        differences=skill_differences(compared, [s.simulator for s in simulators]),
        worst=worst_pairs(pair for pair in compared if pair.simulator == best),
        to_capture_next=to_capture(compared),
        relative=work.relative,
        notes=tuple(notes),
    )


def _place(out: Path, jobs: Sequence[_Job]) -> Path:
    """Return the folder to write: new, or what an interrupted comparison left, which holds reports and no summary."""
    from data_schemas.storage import clear_leftovers

    for folder in {out, *((out / job.report).parent for job in jobs)}:
        clear_leftovers(folder)
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
    from data_schemas import CompareError
    from finray_calib.compare import pairs_of_rows

    above = path.parent
    with naming(CompareError, path):
        rows = pairs_of_rows(_rows(path))
    return [
        _Job(r.simulator, r.name, above / r.simulated, above / r.captured, Path(), r.press, r.session, r.sensor)
        for r in rows
    ]


def _of_folders(arguments: argparse.Namespace) -> tuple[list[_Job], list[str]]:
    """Return the pairs of one folder of presses or more, each with the folder of captures."""
    from finray_calib.compare import pair_by_name

    captured: Path = arguments.capture
    jobs, notes = [], []
    named = _simulator_names(arguments.simulated)
    for name, folder in named.items():
        paired, alone = pair_by_name(*([file.name for file in files_in(part)] for part in (folder, captured)))
        jobs += [_Job(name, press, folder / one, captured / two, Path()) for press, (one, two) in paired.items()]
        # a capture that the table was taught with has no press: that is no fault
        notes += [
            f"{f}: has no counterpart in the other folder and was left out"
            for f in alone
            if len(named) == 1 or has_file(folder / f)
        ]
    notes = list(dict.fromkeys(notes))
    for note in notes:
        warn(note)
    return jobs, notes


def _simulator_names(folders: Sequence[Path]) -> dict[str, Path]:
    """Return the name of each simulator: that of its folder, with those above where two are alike."""
    found: dict[str, Path] = {}
    for folder in folders:
        parts = [part.removesuffix(".zip") for part in folder.resolve().parts]
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

    texts = ("simulated", "captured", "name", "simulator", "press", "session", "sensor")
    header, rows = read_csv(path, "a CSV file in UTF-8 with a header row", CompareError, other_marks=True, names=texts)
    return [dict(zip_longest(header, cells[: len(header)])) for _, cells in rows]


@dataclass(frozen=True, slots=True)
class _Work:
    """What is done with every pair alike."""

    out: Path
    command: str
    seed: int
    registered: bool
    despite_mismatch: bool
    normal_map: Path | None
    scale: Path | None
    relative: bool = False

    @property
    def listed(self) -> list[Path]:
        """Files that every comparison reads beside its pair."""
        return [file for file in (self.normal_map, self.scale) if file is not None]


@lru_cache(maxsize=1)
def _options(work: _Work) -> "CheckOptions":
    """Return the options of a comparison, with the records that were given."""
    from data_schemas import NormalMapRecord, PixelScale
    from data_schemas.storage import read_record
    from finray_calib.compare import CheckOptions

    normal_map = None if work.normal_map is None else read_record(work.normal_map, NormalMapRecord)
    scale = None if work.scale is None else read_record(work.scale, PixelScale)
    return CheckOptions(work.registered, work.despite_mismatch, normal_map, scale, relative=work.relative)


def _as_json(record: "_Job | _Work") -> dict[str, Any]:
    """Return the fields of a dataclass of texts, numbers and paths."""
    return {f.name: str(v) if isinstance(v := getattr(record, f.name), Path) else v for f in fields(record)}


R = TypeVar("R", "_Job", "_Work")


def _of_json(kind: type[R], told: Mapping[str, Any]) -> R:
    """Return the dataclass that :func:`_as_json` told."""
    paths = {f.name for f in fields(kind) if "Path" in str(f.type)}
    given: dict[str, Any] = {n: Path(v) if n in paths and v is not None else v for n, v in told.items()}
    return kind(**given)


#: Fewer pairs for each process do not repay its start; more processes than these would take much memory.
_LEAST_PAIRS_EACH, _MOST_WORKERS = 6, 8
#: What a process takes: of itself, and for each pixel of a pair. Measured peaks: 300 MB at 320 x 240 px, 440 and 610 MB
#: at 640 x 480 (encoded, linear), 950 MB at 1280 x 960, 1.8 GB at 1920 x 1440.
_BYTES_EACH, _BYTES_PER_PIXEL = 250 << 20, 1400
#: Other programs, and the summary in this process, get this share of the memory that is free.
_MEMORY_SHARE = 0.8
_SIZES_LOOKED_AT = 32
#: Pairs that a process is given at once, where there are enough of them: the last of each is waited for on the disk.
_TASK_PAIRS, _TASKS_EACH = 8, 16


class _Workers:
    """Do work on pairs: in this process where they are few, else in as many processes as this one has cores.

    Results come in the order of the pairs and do not depend on how many processes there are: every pair is compared
    on a single thread, with draws of its own.
    """

    def __init__(self, work: _Work, jobs: Sequence[_Job]) -> None:
        self._work = work
        count = min(_cores(), len(jobs) // _LEAST_PAIRS_EACH, _MOST_WORKERS)
        if count > 1 and (room := _processes_in_memory(jobs)) < count:
            warn(
                f"the free memory is enough for only {room} of {count} processes with pictures of this size, so the "
                "comparison takes longer. Close other programs, or compare fewer pairs at once"
            )
            count = room
        self._children = [
            Child([__name__, "finray_calib.compare"], keeps_memory=True) for _ in range(count if count > 1 else 0)
        ]

    def __enter__(self) -> "_Workers":
        return self

    def __exit__(self, *_: object) -> None:
        for child in self._children:
            child.__exit__(None, None, None)

    def do(self, what: Literal["compare", "page"], jobs: "Sequence[_Job]", title: str) -> list[Any]:
        """Return a result for each job, in their order.

        Raises
        ------
        ProcessDiedError
            A process was killed or crashed; reports that are written stay, and the same command continues.
        """
        with progress_bar(title) as progress:
            if not self._children:
                found: list[Any] = []
                for job in jobs:
                    progress(len(found), len(jobs), job.name)
                    found += do_jobs(what, [_as_json(job)], _as_json(self._work))
                return found
            return self._side_by_side(what, jobs, progress)

    def _side_by_side(self, what: str, jobs: "Sequence[_Job]", progress: Progress) -> list[Any]:
        """Return the results of all processes."""
        size = 1
        if what == "compare":
            size = min(max(len(jobs) // (_TASKS_EACH * len(self._children)), 3), _TASK_PAIRS)
        todo: queue.SimpleQueue[int] = queue.SimpleQueue()
        done: queue.SimpleQueue[tuple[int, list[Any] | BaseException]] = queue.SimpleQueue()
        for start in range(0, len(jobs), size):
            todo.put(start)

        def serve(child: Child) -> None:
            with contextlib.suppress(queue.Empty):
                while True:
                    start = todo.get_nowait()
                    told = [_as_json(job) for job in jobs[start : start + size]]
                    arguments = {"what": what, "jobs": told, "work": _as_json(self._work)}
                    try:
                        done.put((start, child.call(f"{__name__}:do_jobs", arguments)))
                    except BaseException as error:  # the thread that waits raises it
                        return done.put((start, error))

        threads = [threading.Thread(target=serve, args=(child,)) for child in self._children]
        found: dict[int, list[Any]] = {}
        try:
            with stopping_together(self._children):
                for thread in threads:
                    thread.start()
                for _ in range(0, len(jobs), size):
                    start, result = done.get()
                    if isinstance(result, BaseException):
                        raise _of_worker(result, jobs[start : start + size])
                    found[start] = result
                    progress(sum(map(len, found.values())), len(jobs), jobs[start].name)
        finally:
            with contextlib.suppress(queue.Empty):  # the threads take from it, too
                while True:
                    todo.get_nowait()
            if any(thread.is_alive() for thread in threads) and len(found) * size < len(jobs):
                for child in self._children:
                    child.kill(signal.SIGINT)
            for thread in threads:
                if thread.ident is not None:  # Ctrl-C may come before it has started
                    thread.join()
        return [result for start in sorted(found) for result in found[start]]


def _cores() -> int:
    """Return how many cores this process may use; 1 where a child's end cannot be waited for."""
    if not hasattr(os, "waitid"):  # macOS, before Python 3.13
        return 1
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _processes_in_memory(jobs: Sequence[_Job]) -> int:
    """Return for how many processes the free memory suffices, at least 1; many where the system does not say."""
    from data_schemas.storage import memory_left

    step = -(-len(jobs) // _SIZES_LOOKED_AT)
    pixels = max((_pixels(job.captured) for job in jobs[::step]), default=0)
    try:
        left = memory_left()[0]
    except (OSError, KeyError):
        return _MOST_WORKERS
    return max(1, int(_MEMORY_SHARE * left / (_BYTES_EACH + _BYTES_PER_PIXEL * pixels)))


def _pixels(capture: Path) -> int:
    """Return the number of pixels that a capture says its images have; 0 where it cannot be read, as is told later."""
    try:
        rows, columns = read_json(capture)["record"]["contact"]["shape"][:2]
        return int(rows) * int(columns)
    except (FinrayError, KeyError, TypeError, ValueError):
        return 0


def _of_worker(error: BaseException, jobs: Sequence["_Job"]) -> BaseException:
    """Return what to raise for the error of a process that did these jobs."""
    if not isinstance(error, ProcessDiedError):
        return error
    return ProcessDiedError(
        f"the process that compared {', '.join(job.name for job in jobs)} {error}. Reports that are already written "
        "are complete; run the same command again to compare the other pairs"
    )


def do_jobs(what: Literal["compare", "page"], jobs: list[dict[str, Any]], work: dict[str, Any]) -> list[Any]:
    """Compare pairs and store their reports, or return the pages of stored reports, on a single thread.

    Parameters
    ----------
    what
        "compare" or "page".
    jobs, work
        As JSON: the pairs, and what is done with all of them.
    """
    import cv2
    from threadpoolctl import threadpool_limits

    # sums then come in one order, whatever the machine
    threads = cv2.getNumThreads()
    todo, chosen = [_of_json(_Job, job) for job in jobs], _of_json(_Work, work)
    try:
        cv2.setNumThreads(1)
        with threadpool_limits(limits=1):
            if what == "page":
                return [_page(job, chosen) for job in todo]
            return _compare_and_store(todo, chosen)
    finally:
        cv2.setNumThreads(threads)


def _compare_and_store(jobs: Sequence[_Job], work: _Work) -> list[Any]:
    """Return the results of pairs; each report goes to the disk while the next pair is computed.

    All reports are there before the pairs count as done. One that could not be stored ends the command, also where a
    later pair ended with another error.
    """
    begun: list[tuple[dict[str, Any], Future[Path] | None]] = []
    try:
        with ThreadPoolExecutor(max_workers=1) as storing:
            for job in jobs:
                begun.append(_compare_pair(job, work, storing))
    except Exception as later:
        for stored in [stored for _, stored in begun if stored is not None]:
            if (first := stored.exception()) is not None:
                raise first from later
        raise
    for _, storing_one in begun:
        if storing_one is not None:
            storing_one.result()
    return [result for result, _ in begun]


def _compare_all(jobs: Sequence[_Job], workers: _Workers) -> "tuple[list[ComparedPair], dict[str, str]]":
    """Compare all pairs; return them and the digests of the files that were read."""
    from data_schemas import ComparedPair

    told = workers.do("compare", jobs, "compare")
    for job, result in zip(jobs, told, strict=True):
        if result["pair"]["error"] is not None:
            warn(f"{job.name}: {result['pair']['error']}")
    read = {name: digest for result in told for name, digest in result["read"].items()}
    return [ComparedPair.model_validate(result["pair"]) for result in told], read


def _compare_pair(job: _Job, work: _Work, storing: Executor) -> "tuple[dict[str, Any], Future[Path] | None]":
    """Compare one pair and begin to store its report, or tell why not; a report that is there already is taken."""
    from data_schemas import ComparedPair
    from data_schemas.storage import digest_as_read

    told, stored = _compared(job, work, storing)
    pair = ComparedPair.model_validate(
        {
            "name": job.name, "simulated": str(job.simulated), "captured": str(job.captured),
            "simulator": job.simulator, "press": job.press, "session": job.session, "sensor": job.sensor,
            **told,
        }
    )  # fmt: skip
    read = {file.as_posix(): digest_as_read(file) for file in (job.simulated, job.captured)}
    return {
        "pair": pair.model_dump(mode="json"),
        "read": {name: digest for name, digest in read.items() if digest is not None},
    }, stored


def _compared(job: _Job, work: _Work, storing: Executor) -> "tuple[dict[str, Any], Future[Path] | None]":
    """Return what the comparison of a pair adds to the summary, and the report that is on its way to the disk."""
    from data_schemas import provenance
    from data_schemas.storage import write_record
    from finray_calib.compare import checked_report

    path = work.out / job.report
    try:
        press, capture = _read_pair(job)
        options = _options(work)
        origin = provenance(work.command, input_digests([job.simulated, job.captured, *work.listed]), work.seed)
        report = None if path.exists() else checked_report(press, capture, work.seed, options)
    except FieldError:
        raise  # files are read without it: a record that finray itself made wrongly is no fault of this pair
    except (FinrayError, OSError) as error:
        return {"error": str(error)}, None
    # A disk that takes no more is no fault of the pair: it ends the command, which goes on here when run again.
    stored = None
    if report is None:
        report = _stored_report(path, origin)
    else:
        stored = storing.submit(write_record, report, path, origin)
    region = next(r for r in report.regions if r.region == report.headline_region)
    floors = [row.skill for row in region.rows if row.candidate == "floor"]
    return {
        "sensor": job.sensor or capture.rig,
        "report": job.report.as_posix(),
        "skill": report.headline_skill,
        "floor_skill": floors[0] if floors else None,
        "contact_signal": report.contact_signal,
        "findings": report.findings,
    }, stored


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
            f"{path}: exists already, but was made by another command, by another version or from other files; choose "
            "another --out or move it away"
        )
    return report


def _page(job: _Job, work: _Work) -> dict[str, Any]:
    """Return the page of a pair, and its small pictures for the page over all."""
    from data_schemas import PhotometricErrorReport
    from data_schemas.storage import read_record
    from finray_calib.compare import shown_press
    from finray_calib.reports import comparison_page, press_pictures

    report = read_record(work.out / job.report, PhotometricErrorReport)
    press, capture = _read_pair(job)
    shown = shown_press(press, capture, work.registered, work.relative)
    digests: Mapping[str, str] = {} if report.provenance is None else report.provenance.input_sha256
    link = job.report.with_suffix(".html").as_posix()
    small = press_pictures(job.simulator, job.name, link, report, shown, capture)
    page = comparison_page(report, shown, capture, work.command, digests)
    return {"page": page, "pictures": small.model_dump(mode="json")}


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
