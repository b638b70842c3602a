"""``finray compare`` over folders and lists: a report for each pair, a summary, and pairs that fail."""

import contextlib
import csv
import json
import os
import queue
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from data_schemas import (
    ComparisonBatch,
    ErrorAttribution,
    ErrorCause,
    FieldError,
    Interval,
    PhotometricErrorReport,
    RecordError,
    provenance,
)
from data_schemas.storage import Child, read_record, write_record
from finray_calib.cli import _compare_folders
from finray_calib.cli._compare_folders import _Job, _Work, _Workers
from finray_calib.compare import OWN_NOISE
from finray_calib.reports import batch_lines, batch_page
from finray_calib.reports._batch_page import _causes_sentence, _tiles
from tests.command_line.records import capture_of, press
from tests.command_line.running import finray, tree


@pytest.fixture
def folders(tmp_path: Path) -> Path:
    """Two good pairs, one with exchanged channels, and a press without capture."""
    origin, good = provenance("pytest"), press()
    exchanged = capture_of(good, 50.0)
    exchanged = exchanged.model_copy(update={"contact": exchanged.contact[..., ::-1].copy()})
    for name, capture in {"one": capture_of(good, 50.0), "two": capture_of(good, 20.0), "bgr": exchanged}.items():
        write_record(good, tmp_path / f"simulated/{name}.press.json", origin)
        write_record(capture, tmp_path / f"captured/{name}.capture.json", origin)
    write_record(good, tmp_path / "simulated/alone.press.json", origin)
    return tmp_path


def test_folders_give_reports_and_a_summary_and_survive_a_bad_pair(folders: Path) -> None:
    outcome = finray(f"compare {folders}/simulated {folders}/captured --out {folders}/out")
    assert outcome.status == 0
    assert "alone.press.json: has no counterpart in the other folder and was left out" in outcome.err
    assert "bgr: " in outcome.err
    assert "2 of 3 pairs compared" in outcome.out
    batch = read_record(folders / "out/summary.json", ComparisonBatch)
    assert [pair.name for pair in batch.pairs] == ["bgr", "one", "two"]
    failed, one, two = batch.pairs
    assert failed.skill is None
    assert "as BGR much better than as RGB" in str(failed.error)
    assert batch.worst == tuple(sorted(("one", "two"), key=lambda n: {"one": one, "two": two}[n].skill.estimate))
    assert one.skill is not None
    assert two.skill is not None
    left = [(1.0 - p.skill.estimate) * p.contact_signal for p in (one, two)]
    (score,) = batch.simulators
    assert score.skill.estimate == pytest.approx(1.0 - sum(left) / (one.contact_signal + two.contact_signal))
    assert (score.compared, score.failed, score.skill.low95) == (2, 1, None)
    page = (folders / "out/summary.html").read_text()
    assert 'href="two.photometric-error.html"' in page
    assert (folders / "out/two.photometric-error.html").is_file()
    assert "2 presses give no interval" in page
    report = read_record(folders / "out" / str(one.report), PhotometricErrorReport)
    assert report.headline_skill == one.skill
    with (folders / "out/summary.csv").open(newline="") as file:
        rows = {row["name"]: row for row in csv.DictReader(file)}
    assert float(rows["one"]["skill"]) == one.skill.estimate
    assert (rows["bgr"]["skill"], rows["bgr"]["error"]) == ("", failed.error)
    before = tree(folders)
    again = finray(f"compare {folders}/simulated {folders}/captured --out {folders}/out")
    assert again.status == 2
    assert "exists already and is not overwritten" in again.err
    assert tree(folders) == before


def test_captures_made_from_their_renders_prove_nothing_on_the_page_of_all_presses(folders: Path) -> None:
    assert finray(f"compare {folders}/simulated {folders}/captured --out {folders}/out").status == 0
    batch = read_record(folders / "out/summary.json", ComparisonBatch)
    (score,) = batch.simulators
    skill = score.skill.model_copy(update={"estimate": 0.97, "low95": 0.96, "high95": 0.98})
    sure = score.model_copy(update={"skill": skill})
    one_of = [batch.pairs[0], batch.pairs[1], batch.pairs[2].model_copy(update={"findings": (OWN_NOISE,)})]
    both = [p if p.skill is None else p.model_copy(update={"findings": (OWN_NOISE,)}) for p in one_of]
    for pairs, light, is_void in ((batch.pairs, "good", False), (one_of, "care", False), (both, "care", True)):
        told = batch.model_copy(update={"simulators": (sure,), "pairs": tuple(pairs)})
        page, lines = batch_page(told, [], "", {}), " ".join(batch_lines(told))
        assert f'<section class="verdict {light}"' in page
        assert re.search(rf'<div class="{light}"><dt>Skill, simula\w+</dt>', page)
        assert ("This comparison proves nothing about the simulation" in page) is is_void
        assert ("made from the render" in lines) is ("made from the render" in page) is (light == "care")


def test_the_error_of_a_process_is_told_though_another_takes_the_last_work_meanwhile(tmp_path, monkeypatch) -> None:
    """Between a look at the queue and taking from it, another thread may empty it."""

    class Taken(queue.SimpleQueue):
        def empty(self) -> bool:
            return False

    class Broken:
        def call(self, *_: object) -> None:
            raise RecordError("the disk is full")

        def kill(self, *_: object) -> None:
            pass

    monkeypatch.setattr(_compare_folders.queue, "SimpleQueue", Taken)
    monkeypatch.setattr(_compare_folders, "stopping_together", lambda _: contextlib.nullcontext())
    workers = _Workers(_Work(tmp_path, "", 1, False, False, None, None), [])
    monkeypatch.setattr(workers, "_children", [Broken()])
    with pytest.raises(RecordError, match="the disk is full"):
        workers.do("compare", [_Job("", "one", tmp_path / "a", tmp_path / "b", Path("c.json"))], "compare")


def test_the_largest_part_of_the_lost_skill_is_named_where_it_is_no_cause() -> None:
    depth = ErrorCause.model_construct(cause="depth", skill_lost=0.06)
    found = ErrorAttribution.model_construct(
        causes=(depth,), skill_lost=0.37, saturation_skill=0.0, noise_skill=0.03, remainder_skill=0.28
    )
    said = _causes_sentence({"depth": 0.06}, [found])
    assert said.startswith("Most skill is lost by what none of the causes explains (remainder): 0.280 for each press")
    assert said.endswith("Of the causes, depth costs most: 0.060.")
    less = found.model_copy(update={"remainder_skill": 0.01})
    assert _causes_sentence({"depth": 0.06}, [less]) == (
        "Most skill is lost by depth: 0.060 for each press, averaged over these presses."
    )


def test_simulators_are_ranked_on_one_page(folders: Path) -> None:
    """The render against one at half contrast, each with reports of its own; the same folder twice is refused."""
    half = press()
    weak = half.model_copy(update={"contact": (half.contact + half.no_contact) / 2})
    for name in ("one", "two", "three"):
        write_record(weak, folders / f"weak/{name}.press.json", provenance("pytest"))
    write_record(half, folders / "simulated/three.press.json", provenance("pytest"))
    write_record(capture_of(half, 30.0), folders / "captured/three.capture.json", provenance("pytest"))
    outcome = finray(f"compare {folders}/weak {folders}/simulated {folders}/captured --out {folders}/out")
    assert outcome.status == 0, outcome.err
    batch = read_record(folders / "out/summary.json", ComparisonBatch)
    assert [score.simulator for score in batch.simulators] == ["simulated", "weak"]
    assert batch.simulators[1].skill.estimate == pytest.approx(0.75, abs=0.05)  # (1 - 1/2)^2 of the change is left
    best = sorted((p.skill.estimate, p.name) for p in batch.pairs if p.simulator == "simulated" and p.skill)
    assert batch.worst == tuple(name for _, name in best)  # not those of the weak one
    assert f"lowest of simulated: {', '.join(batch.worst)}" in outcome.out
    (difference,) = batch.differences
    assert (difference.first, difference.second, difference.better_in) == ("simulated", "weak", 3)
    assert difference.low95 is not None
    assert difference.low95 > 0.0
    simultaneous = "differences in skill; all their 95 % intervals hold together (Bonferroni):"
    assert simultaneous not in outcome.out
    assert simultaneous in batch_lines(batch.model_copy(update={"differences": (difference, difference)}))
    assert (folders / "out/weak/one.photometric-error.html").is_file()
    page = (folders / "out/summary.html").read_text()
    assert "simulated is best" in page
    assert 'href="weak/one.photometric-error.html"' in page
    twice = finray(f"compare {folders}/weak {folders}/weak {folders}/captured --out {folders}/other")
    assert "weak: is given twice; give each folder of simulated presses once" in twice.err


def test_a_relative_comparison_says_so_everywhere_and_suggests_no_decision(folders: Path) -> None:
    assert finray(f"compare {folders}/simulated {folders}/captured --relative --out {folders}/out").status == 0
    batch = read_record(folders / "out/summary.json", ComparisonBatch)
    assert batch.relative
    assert batch.pairs[1].report is not None
    assert read_record(folders / "out" / batch.pairs[1].report, PhotometricErrorReport).relative
    for page in ("summary", "one.photometric-error"):
        text = (folders / f"out/{page}.html").read_text()
        assert "Relative: the captured image without contact replaces the render" in text
    one = f"compare {folders}/simulated/one.press.json {folders}/captured/one.capture.json"
    relative = finray(f"{one} --relative --out {folders}/relative.json")
    absolute = finray(f"{one} --out {folders}/absolute.json")
    assert "relative: only the change by contact is judged" in relative.out
    assert "relative:" not in absolute.out
    assert "finray decide" not in relative.out


def test_names_that_give_one_file_name_get_files_of_their_own(folders: Path) -> None:
    rows = ["a/b", "a:b", "A-b"]
    text = "".join(f"simulated/one.press.json,captured/one.capture.json,{name}\n" for name in rows)
    (folders / "pairs.csv").write_text("simulated,captured,name\n" + text)
    assert finray(f"compare --pairs {folders}/pairs.csv --out {folders}/out").status == 0
    batch = read_record(folders / "out/summary.json", ComparisonBatch)
    files = [str(pair.report) for pair in batch.pairs]
    assert files == [f"{name}.photometric-error.json" for name in ("a-b", "a-b-2", "A-b-3")]
    assert all((folders / "out" / file).is_file() for file in files)


@pytest.mark.parametrize("mark", [",", ";", "\t"])
def test_a_list_of_pairs(folders: Path, mark: str) -> None:
    text = "simulated,captured,name\nsimulated/one.press.json,captured/two.capture.json,mixed\nx.json,y.json,gone\n"
    (folders / "pairs.csv").write_text(text.replace(",", mark))
    outcome = finray(f"compare --pairs {folders}/pairs.csv --out {folders}/out")
    assert outcome.status == 0
    assert "1 of 2 pairs compared" in outcome.out
    mixed, gone = read_record(folders / "out/summary.json", ComparisonBatch).pairs
    assert mixed.skill is not None
    assert "x.json" in str(gone.error)


def test_a_mismatch_is_compared_when_asked(folders: Path) -> None:
    pair = f"{folders}/simulated/bgr.press.json {folders}/captured/bgr.capture.json --out {folders}/one.json"
    refused = finray(f"compare {pair}")
    assert refused.status == 2
    assert "do not belong together: the contact image of capture of the strip" in refused.err
    assert "channel order: " in finray(f"compare {pair} --despite-mismatch").out


def test_nothing_compared_is_an_error_that_gives_the_first_reason_and_says_where_to_look(folders: Path) -> None:
    for rows, expected in (
        ("x.json,y.json", r"none of the 1 pair could be compared; first reason: \S*/x\.json: no such file.*"),
        ("x.json,y.json,a\nx.json,y.json,b\nz.json,y.json,c", r".* first reason \(the same for 2 of 3\): .*x\.json.*"),
    ):
        (folders / "pairs.csv").write_text(f"simulated,captured,name\n{rows}\n")
        shutil.rmtree(folders / "out", ignore_errors=True)
        outcome = finray(f"compare --pairs {folders}/pairs.csv --out {folders}/out")
        assert outcome.status == 2
        assert re.search(f"{expected}; see all reasons in {folders}/out/summary.csv", outcome.err), outcome.err


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ("", "either SIMULATED and CAPTURE or --pairs CSV must be given, but not both"),
        ("{0}/simulated", "CAPTURE, the record or folder to compare with, is missing; add a record"),
        ("{0}/simulated {0}/captured/one.capture.json", "some are folders, others are not; give two records, or"),
        (
            "{0}/none.json {0}/none.json {0}/none.json",
            "none.json: is a third record, but only two are compared; give one",
        ),
        (
            "{0}/simulated --pairs {0}/pairs.csv",
            "either SIMULATED and CAPTURE or --pairs CSV must be given, but not both",
        ),
        ("--pairs {0}/pairs.csv", "row 1: must name a file in both columns, simulated and captured"),
        ("--pairs {0}/none.csv", "none.csv: no such file; give the path of a CSV file"),
        ("--pairs {0}/bytes.csv", "saved as UTF-8 (in Windows, choose the encoding under 'Save as')"),
        ("{0}/simulated {0}/captured --normal-map {0}/none.json", "none.json: no such file"),
        ("{0}/captured {0}/simulated", "(0 presses, 0 captures); give the simulated presses first and"),
    ],
)
def test_mistakes_are_told_and_nothing_is_written(folders: Path, arguments: str, message: str) -> None:
    (folders / "pairs.csv").write_text("simulation,captured\na,b\n")
    (folders / "bytes.csv").write_bytes(b"simulated,captured\n\xff\xfe\n")
    before = tree(folders)
    outcome = finray(f"compare {arguments.format(folders)} --out {folders}/out")
    assert outcome.status == 2
    assert message in outcome.err
    assert tree(folders) == before


def test_the_help_says_which_numbers_contain_noise() -> None:
    """The noise of linear captures is taken out of the score and of the floor."""
    told = " ".join(finray("compare --help").out.split())
    assert "taken out of the simulation's score and out of the floor" in told
    assert "with encoded values both contain the noise" in told


def test_what_fails_for_all_simulators_is_said_once_and_no_interval_has_equal_ends(folders: Path) -> None:
    """Exchanged channels are refused whoever simulates; an untouched image scores 0 in each of three presses."""
    blank = press().model_copy(update={"contact": press().no_contact})
    for name in ("one", "two", "three", "bgr"):
        write_record(blank, folders / f"blank/{name}.press.json", provenance("pytest"))
    write_record(press(), folders / "simulated/three.press.json", provenance("pytest"))
    write_record(capture_of(press(), 30.0), folders / "captured/three.capture.json", provenance("pytest"))
    assert finray(f"compare {folders}/simulated {folders}/blank {folders}/captured --out {folders}/out").status == 0
    batch = read_record(folders / "out/summary.json", ComparisonBatch)
    scores = {score.simulator: score for score in batch.simulators}
    assert scores["blank"].skill.estimate == pytest.approx(0.0, abs=0.01)
    page = (folders / "out/summary.html").read_text()
    assert page.count("Not compared: bgr") <= 2  # the reasons of both differ in their numbers
    assert re.search(r"95 %: (\S+) to \1\b", page) is None


def _numbers(folder: Path) -> dict[str, object]:
    """Return what the reports and the summary of a folder hold, with the digests of their arrays."""
    found = {}
    for path in sorted(folder.glob("*.json")):
        envelope = json.loads(path.read_text())
        del envelope["record"]["provenance"]
        found[path.name] = envelope["record"], envelope["array_file"]
    return found


def test_two_processes_give_the_numbers_of_one(folders: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pairs = f"compare {folders}/simulated {folders}/captured"
    alone = finray(f"{pairs} --out {folders}/n1")
    monkeypatch.setattr(_compare_folders, "_LEAST_PAIRS_EACH", 1)
    monkeypatch.setattr(_compare_folders, "_TASK_PAIRS", 1)
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0, 1})
    started: list[Child] = []
    monkeypatch.setattr(
        _compare_folders, "Child", lambda *told, **how: started.append(Child(*told, **how)) or started[-1]
    )
    together = finray(f"{pairs} --out {folders}/n2")
    assert (together.status, len(started)) == (0, 2)
    told = [re.sub(r"(?m)^compare: .*\n", "", outcome.err) for outcome in (together, alone)]
    assert told[0] == told[1]
    assert _numbers(folders / "n2") == _numbers(folders / "n1")
    assert (folders / "n2/summary.csv").read_text() == (folders / "n1/summary.csv").read_text()
    assert (folders / "n2/one.photometric-error.html").is_file()


@pytest.mark.parametrize(
    ("left_bytes", "processes"),
    [(16 << 30, 4), (1000 << 20, 3), (700 << 20, 2), (600 << 20, 0), (1, 0)],
)
def test_no_more_processes_are_started_than_the_memory_takes(
    folders: Path, monkeypatch: pytest.MonkeyPatch, left_bytes: int, processes: int
) -> None:
    """Each takes 250 MB and 6.4 MB for 60 x 80 px, of four fifths of what is free; alone it is done in this process."""
    monkeypatch.setattr("data_schemas.storage.memory_left", lambda: (left_bytes, 1 << 40))
    monkeypatch.setattr(_compare_folders, "_LEAST_PAIRS_EACH", 1)
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0, 1, 2, 3})
    started: list[object] = []
    monkeypatch.setattr(_compare_folders, "Child", lambda imports, **_: started.append(imports) or _Silent())
    jobs = [_job(folders, name) for name in ("one", "two", "bgr", "none")]
    with _compare_folders._Workers(None, jobs):  # noqa: SLF001 - nothing is done
        assert len(started) == processes


class _Silent:
    """Stands for a process."""

    def __exit__(self, *_: object) -> None:
        """End."""


def _job(folders: Path, name: str) -> object:
    captured = folders / f"captured/{name}.capture.json"
    return _compare_folders._Job("s", name, folders / f"simulated/{name}.press.json", captured, Path())  # noqa: SLF001


def test_processes_that_do_not_fit_are_a_warning_and_give_the_same_numbers(
    folders: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(_compare_folders, "_LEAST_PAIRS_EACH", 1)
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0, 1})
    monkeypatch.setattr("data_schemas.storage.memory_left", lambda: (300 << 20, 1 << 30))
    short = finray(f"compare {folders}/simulated {folders}/captured --out {folders}/short")
    assert short.status == 0
    assert "the free memory is enough for only 1 of 2 processes with pictures of this size" in short.err
    monkeypatch.setattr("data_schemas.storage.memory_left", lambda: (8 << 30, 8 << 30))
    assert "memory" not in finray(f"compare {folders}/simulated {folders}/captured --out {folders}/ample").err
    assert _numbers(folders / "short") == _numbers(folders / "ample")


def _jobs_and_work(folders: Path) -> tuple[list[object], object]:
    """The pairs "one" and "two" as the command gives them to a process."""
    jobs = []
    for name in ("one", "two"):
        report = Path(f"{name}.photometric-error.json")
        files = folders / f"simulated/{name}.press.json", folders / f"captured/{name}.capture.json"
        jobs.append(_compare_folders._Job("s", name, *files, report))  # noqa: SLF001
    (folders / "out").mkdir()
    work = _compare_folders._Work(folders / "out", "finray compare", 1, False, False, None, None)  # noqa: SLF001
    return jobs, work


def _do(folders: Path) -> list[object]:
    jobs, work = _jobs_and_work(folders)
    as_json = _compare_folders._as_json  # noqa: SLF001
    return _compare_folders.do_jobs("compare", [as_json(job) for job in jobs], as_json(work))


def test_a_report_that_cannot_be_stored_is_told_although_a_later_pair_ends_with_another_error(
    folders: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Before, the error of the later pair was raised alone, and nothing said that the disk was full."""
    compared = _compare_folders._compared  # noqa: SLF001

    def second_breaks(job: "_compare_folders._Job", *others: object) -> object:
        if job.name == "two":
            raise RuntimeError("the second pair")
        return compared(job, *others)

    def full(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(_compare_folders, "_compared", second_breaks)
    monkeypatch.setattr("data_schemas.storage.write_record", lambda *_, **__: None)
    with pytest.raises(RuntimeError, match="the second pair"):
        _do(folders)
    (folders / "out").rmdir()
    monkeypatch.setattr("data_schemas.storage.write_record", full)
    with pytest.raises(OSError, match="No space left on device") as raised:
        _do(folders)
    assert str(raised.value.__cause__) == "the second pair"


def test_a_record_that_finray_makes_wrongly_is_no_failed_pair(folders: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A field's error in our own code would else be a pair that could not be compared, among others."""

    def wrong(*_: object, **__: object) -> None:
        Interval(estimate="much", low95=0.0, high95=1.0)

    monkeypatch.setattr("finray_calib.compare.checked_report", wrong)
    with pytest.raises(FieldError, match="estimate"):
        _do(folders)
    failed = finray(f"compare {folders}/simulated {folders}/captured --out {folders}/other")
    assert failed.status == 2
    assert "estimate" in failed.err
    assert not (folders / "other/summary.json").exists()


_SLOW = """\
import os, sys, time
from finray_calib.cli import _compare_folders as f
f._LEAST_PAIRS_EACH = f._TASK_PAIRS = 1
os.sched_getaffinity = lambda _: {0, 1}
sys.argv = ["finray", "compare", "--pairs", sys.argv[1], "--out", sys.argv[2]]
from finray_calib.cli.main import main
sys.exit(main())
"""


def _workers_of(pid: int) -> list[int]:
    """Return the processes that a process started."""
    found: list[int] = []
    for stat in Path("/proc").glob("[0-9]*/stat"):
        with contextlib.suppress(OSError):
            if int(stat.read_text().rpartition(")")[2].split()[1]) == pid:
                found.append(int(stat.parent.name))
    return found


def _states(pids: list[int]) -> set[str]:
    return {Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] for pid in pids}


def _wait(what: Callable[[], bool], command: "subprocess.Popen[str]") -> None:
    """Wait for a running command; one that ended, or is late, fails with what it said and where it was."""
    deadline = time.monotonic() + 180.0  # a machine with other work
    while not what():
        if command.poll() is not None or time.monotonic() > deadline:
            command.send_signal(signal.SIGABRT)  # the fault handler then writes where every thread is
            command.send_signal(signal.SIGCONT)
            pytest.fail(f"status {command.poll()}: {command.communicate(timeout=60.0)[1]}")
        time.sleep(0.02)


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="looks at processes in /proc")
def test_ctrl_z_stops_all_processes_and_ctrl_c_ends_them(folders: Path) -> None:
    rows = [f"simulated/one.press.json,captured/one.capture.json,pair {k}" for k in range(400)]
    (folders / "pairs.csv").write_text("\n".join(["simulated,captured,name", *rows]) + "\n")
    words = [sys.executable, "-X", "faulthandler", "-c", _SLOW, str(folders / "pairs.csv"), str(folders / "out")]
    with subprocess.Popen(words, cwd=Path(__file__).parents[2], stderr=subprocess.PIPE, text=True) as command:
        try:
            _wait(lambda: len(list((folders / "out").glob("*.json"))) > 1, command)
            workers = _workers_of(command.pid)
            assert len(workers) == 2
            command.send_signal(signal.SIGTSTP)
            _wait(lambda: _states([command.pid, *workers]) == {"T"}, command)
            stored = len(list((folders / "out").glob("*.json")))
            time.sleep(0.5)
            assert len(list((folders / "out").glob("*.json"))) == stored
            command.send_signal(signal.SIGCONT)
            _wait(lambda: len(list((folders / "out").glob("*.json"))) > stored, command)
            command.send_signal(signal.SIGINT)
            _, said = command.communicate(timeout=180.0)
        finally:
            command.kill()
    assert command.returncode == 130, said
    assert not any(Path(f"/proc/{pid}").exists() for pid in workers)


class _Struck(Child):
    """A process that something happens to when it is first called."""

    def call(self, *arguments: object, **named: object) -> object:
        if self.strike(self):
            os.kill(os.getpid(), signal.SIGINT)
        return super().call(*arguments, **named)


@pytest.mark.parametrize(
    ("strike", "status", "told"),
    [
        (Child.kill, 3, "the process that compared bgr, one, two was killed (SIGKILL) by"),
        (lambda _: True, 130, "interrupted; files already written are complete"),
    ],
)
def test_the_same_command_continues_after_a_process_ended(
    folders: Path,
    monkeypatch: pytest.MonkeyPatch,
    request: pytest.FixtureRequest,
    strike: object,
    status: int,
    told: str,
) -> None:
    command = f"compare {folders}/simulated {folders}/captured --out {folders}/out"
    monkeypatch.setattr(_compare_folders, "_LEAST_PAIRS_EACH", 1)
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0, 1})
    # a shell script ignores Ctrl-C in what it starts in the background, and the test may be that
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    request.addfinalizer(lambda: signal.signal(signal.SIGINT, before))
    with monkeypatch.context() as broken:
        broken.setattr(_Struck, "strike", staticmethod(strike), raising=False)
        broken.setattr(_compare_folders, "Child", _Struck)
        outcome = finray(command)
    assert (outcome.status, told in outcome.err) == (status, True), outcome.err
    assert not (folders / "out/summary.json").exists()
    again = finray(command)
    assert again.status == 0, again.err
    assert "2 of 3 pairs compared" in again.out


_KILLED_AT_A_NAME = """
import os, signal, sys
from data_schemas.storage import _product_set as storage
left, give_name = int(sys.argv.pop(1)), storage.give_name

def strike(part, path):
    global left
    left -= 1
    if left < 0:
        os.kill(os.getpid(), signal.SIGKILL)
    give_name(part, path)

storage.give_name = strike
from finray_calib.cli.main import main
sys.argv[0] = "finray"
sys.exit(main())
"""


@pytest.mark.parametrize("names", [1, 2, 4])
def test_a_command_that_is_killed_between_two_files_continues_with_the_same_numbers(folders: Path, names: int) -> None:
    """Two reports of an array file and a record each, then the summary: SIGKILL before each name is given."""

    words = ["compare", f"{folders}/simulated", f"{folders}/captured", "--out"]

    def run(left: int) -> int:
        command = [sys.executable, "-c", _KILLED_AT_A_NAME, str(left), *words, f"{folders}/out"]
        return subprocess.run(command, capture_output=True, check=False).returncode

    assert run(names) == -signal.SIGKILL
    assert len(list((folders / "out").glob("[!.]*.json"))) == names // 2
    assert run(99) == 0
    assert finray(" ".join([*words, f"{folders}/whole"])).status == 0
    names_of = [sorted(path.name for path in (folders / out).iterdir()) for out in ("out", "whole")]
    assert names_of[0] == names_of[1]
    for name in ("one", "two"):
        found, wanted = (
            read_record(folders / out / f"{name}.photometric-error.json", PhotometricErrorReport)
            for out in ("out", "whole")
        )
        assert found.model_copy(update={"provenance": wanted.provenance}) == wanted


def test_a_system_that_tells_no_cores_compares_all_the_same(folders: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delattr(os, "sched_getaffinity")
    assert finray(f"compare {folders}/simulated {folders}/captured --out {folders}/out").status == 0
    # macOS has no waitid before Python 3.13: no process is started there
    monkeypatch.delattr(os, "waitid")
    monkeypatch.setattr(_compare_folders, "_LEAST_PAIRS_EACH", 1)
    monkeypatch.setattr(_compare_folders, "Child", None)
    assert finray(f"compare {folders}/simulated {folders}/captured --out {folders}/alone").status == 0


@pytest.mark.parametrize(
    ("shapes", "rows"), [([(480, 640), (60, 80)], 112), ([(113, 150), (112, 150)], 112), ([(320, 240)], 200)]
)
def test_pictures_whose_shapes_differ_by_rounding_stand_side_by_side(shapes: list[tuple[int, int]], rows: int) -> None:
    tiles = _tiles([np.full((*shape, 3), 10 * k, np.uint8) for k, shape in enumerate(shapes)])
    assert tiles.shape == (rows, 156 * len(shapes), 3)
    assert [int(tiles[50, 156 * k + 78, 0]) for k in range(len(shapes))] == [10 * k for k in range(len(shapes))]


def test_a_picture_that_is_twice_as_high_as_wide_is_shown_to_its_last_row() -> None:
    picture = np.zeros((200, 100, 3), np.uint8)
    picture[180:] = 100
    tiles = _tiles([picture])
    assert tiles.shape == (200, 156, 3)
    assert int((tiles == 100).all(axis=2).sum()) == 20 * 100
