"""``finray demo``: a stage that dies is one sentence, and the same command goes on where it stopped."""

import json
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from data_schemas import ProcessDiedError, RecordError, RefusedError
from finray_calib.demo import can_continue
from finray_calib.demo._report import write_report
from finray_calib.demo._run import STAGES as REAL_STAGES
from finray_calib.demo._run import complete_stages, note_time, noted_times
from tests.command_line import small_demo
from tests.command_line.running import Program, children_of, succeed, tree
from tests.documentation.example_records import example_results
from tests.schemas.test_child_process import gone_within

ROOT = Path(__file__).resolve().parents[2]


def poison(out: Path, stage: str, **how: object) -> None:
    out.with_name(f"{out.name}.{stage}.poison").write_text(json.dumps(how))


def computed(out: Path) -> list[str]:
    return [line.split()[0] for line in out.with_name(f"{out.name}.computed").read_text().splitlines()]


def test_stages_run_in_order_in_their_processes(tmp_path):
    out, bar = tmp_path / "d", small_demo.Bar()
    report, said = small_demo.run(out, bar=bar)
    lines = (tmp_path / "d.computed").read_text().split()
    assert lines[::2] == ["one", "two", "three"]
    first, second, third = lines[1::2]
    assert first == second != third
    assert str(os.getpid()) not in lines
    assert said == []
    assert report["verdict"] == "done"
    assert report["seconds"] > 0.0
    assert bar.told == [("simulate", 1, 1, f"stored {name}") for name in ("one", "two", "three")]
    left = {path.name for path in out.iterdir() if path.suffix != ".npz"}
    assert left == {"demo.json", "stage-times.jsonl", "one.json", "two.json", "three.json", "report.html"}


@pytest.mark.parametrize(
    ("how", "message"),
    [
        (
            {"number": signal.SIGSEGV},
            r"^stage two was ended by SIGSEGV \(it used memory that does not belong to it, which is a fault",
        ),
        ({"number": signal.SIGILL}, r"^stage two was ended by SIGILL \(a compiled library uses instructions that this"),
        (
            {"number": signal.SIGKILL},
            r"^stage two was killed \(SIGKILL\) .*; it had taken 0\.\d\d GiB of",
        ),
        ({"memory_bytes": 1 << 31}, r"^stage two ran out of memory after it had taken 0\.\d\d GiB"),
    ],
)
def test_a_stage_that_dies_is_named_and_the_same_command_goes_on(tmp_path, how, message):
    out = tmp_path / "d"
    poison(out, "two", **how)
    with pytest.raises(ProcessDiedError, match=message) as died:
        small_demo.run(out)
    log = out / "logs" / "stage-two.log"
    assert f"Its log is {log}. Finished work is kept; run the same command again to continue. " in str(died.value)
    assert "'finray doctor'" in str(died.value)
    assert computed(out) == ["one"]
    if how.get("number") == signal.SIGKILL:  # which leaves no time to write
        assert log.read_text().startswith("The process was killed (SIGKILL)")
    else:
        assert re.search(r"(Fatal Python error|MemoryError)", log.read_text())
        assert "small_demo.py" in log.read_text()
    before = tree(out)
    report, said = small_demo.run(out)
    assert said == [f"{out}: continues after 1 of 3 stages, which are complete"]
    assert computed(out) == ["one", "two", "three"]
    assert report["verdict"] == "done"
    after = tree(out)
    changed = {path for path in before if before[path] != after.get(path)}
    assert {Path(path).name for path in changed} <= {"stage-times.jsonl"}


def test_a_line_of_times_that_was_cut_off_does_not_take_the_next_one_with_it(tmp_path):
    (tmp_path / "stage-times.jsonl").write_text('{"kind": "simulate", "stage": "stage one", "sec')
    note_time(tmp_path, small_demo.STAGES[1], 3.0)
    note_time(tmp_path, small_demo.STAGES[2], 4.0)
    assert noted_times(tmp_path, small_demo.STAGES) == {"simulate": 7.0}


def test_what_a_stage_refuses_comes_through_in_its_words(tmp_path):
    poison(tmp_path / "d", "three", refuses="wheel at 2 of 8: turn it to 1")
    with pytest.raises(RefusedError) as refused:
        small_demo.run(tmp_path / "d")
    assert str(refused.value) == "wheel at 2 of 8: turn it to 1"
    assert small_demo.run(tmp_path / "d")[0]["verdict"] == "done"
    assert computed(tmp_path / "d") == ["one", "two", "three"]


def test_a_stage_that_hangs_ends_with_ctrl_c_and_the_demo_goes_on(tmp_path):
    out = tmp_path / "d"
    poison(out, "three", hangs_s=600.0)
    code = f"from tests.command_line.small_demo import main; main({str(out)!r})"
    parent = subprocess.Popen(
        [sys.executable, "-c", code], cwd=ROOT, stderr=subprocess.PIPE, text=True,
        env={**os.environ, "PYTHONPATH": os.fspath(ROOT)},
    )  # fmt: skip
    log, deadline = out / "logs" / "stage-three.log", time.monotonic() + 60.0
    while not (log.exists() and "hangs" in log.read_text()):
        assert time.monotonic() < deadline
        time.sleep(0.05)
    children = children_of(parent.pid)
    assert children
    with pytest.raises(RecordError, match="another 'finray demo' is writing into it; wait, or choose another --out"):
        small_demo.run(out)
    assert not can_continue(out, small_demo.settings(out))
    parent.send_signal(signal.SIGINT)
    assert "KeyboardInterrupt" in parent.communicate(timeout=30.0)[1]
    assert gone_within(children, 5.0)
    assert can_continue(out, small_demo.settings(out))
    assert small_demo.run(out)[0]["verdict"] == "done"
    assert computed(out) == ["one", "two", "three"]


def begun(out: Path) -> None:
    """Leave a demo of which stage three died."""
    poison(out, "three", number=signal.SIGKILL)
    with pytest.raises(ProcessDiedError):
        small_demo.run(out)


def without_arrays(out: Path) -> None:
    next(out.glob("two.*.npz")).unlink()


def other_input(out: Path) -> None:
    stored = (out / "one.json").read_text()
    (out / "one.json").write_text(stored + "\n")


def cut_off(out: Path) -> None:
    (out / "two.json").write_text((out / "two.json").read_text()[:100])


def without_input(out: Path) -> None:
    (out / "one.json").unlink()


@pytest.mark.parametrize(
    ("harm", "message"),
    [
        (without_arrays, r"two\.\w+\.npz: is missing, but it contains the arrays of two\.json"),
        (
            other_input,
            r"two\.json: was made from one\.json, which has changed since; move two\.json away to have it made again",
        ),
        (without_input, r"two\.json: was made from one\.json, which is not complete; move two\.json away"),
        (cut_off, r"two\.json: cannot be read as JSON"),
    ],
)
def test_a_product_that_was_changed_is_not_gone_on_from(tmp_path, harm: Callable[[Path], None], message):
    out = tmp_path / "d"
    begun(out)
    harm(out)
    before = tree(out)
    with pytest.raises(RecordError, match=message):
        small_demo.run(out)
    assert tree(out) == before
    assert computed(out) == ["one", "two"]


def test_settings_are_not_mixed(tmp_path):
    out = tmp_path / "d"
    begun(out)
    before = tree(out)
    with pytest.raises(
        RecordError, match=r"contains an unfinished demo with another seed 1 \(now 2\), whose files would mix"
    ):
        small_demo.run(out, seed=2)
    assert not can_continue(out, small_demo.settings(out, seed=2))
    (out / "demo.json").write_text((out / "demo.json").read_text().replace('"version": "', '"version": "9.'))
    with pytest.raises(RecordError, match=r"with another version 9\..*; choose another --out"):
        small_demo.run(out)
    stored = (out / "demo.json").read_text().replace('"version": "9.', '"version": "')
    (out / "demo.json").write_text(re.sub(r'"numpy": "[^"]+"', '"numpy": "0.9"', stored))
    with pytest.raises(RecordError, match=r"with another numpy 0\.9 \(now \d[\d.]+\), whose files would mix"):
        small_demo.run(out)
    (out / "demo.json").write_text("{}")
    with pytest.raises(RecordError, match=r"demo\.json was written by another version of finray"):
        small_demo.run(out)
    assert {path: digest for path, digest in tree(out).items() if not path.endswith("demo.json")} == {
        path: digest for path, digest in before.items() if not path.endswith("demo.json")
    }


def test_a_finished_demo_is_told_where_it_is(tmp_path):
    small_demo.run(tmp_path / "d")
    before = tree(tmp_path)
    with pytest.raises(
        RecordError, match=r"already contains a finished demo, whose report is \S+report\.html; choose ano"
    ):
        small_demo.run(tmp_path / "d")
    assert tree(tmp_path) == before


def test_what_a_killed_stage_was_writing_is_cleared(tmp_path):
    out = tmp_path / "d"
    begun(out)
    (out / ".three.json.0a1b2c3d.finray.part").write_text("half")
    small_demo.run(out)
    assert not list(out.glob(".*"))


def test_every_stage_of_the_demo_names_its_inputs_before_they_are_needed():
    made: set[str] = set()
    for stage in REAL_STAGES:
        assert stage.products
        for product in stage.products:
            assert set(product.inputs) <= made
        made |= {product.file for product in stage.products}
    assert complete_stages(Path("/nowhere"), REAL_STAGES) == set()


@pytest.mark.renderer
@pytest.mark.timeout(900)
def test_the_demo_itself_goes_on_after_a_fit_that_crashed(tmp_path):
    """The real demo, whose fit of the red paint is killed by SIGSEGV; then interrupted when that paint is fitted."""
    out = tmp_path / "demo"
    first = Program(f"demo --engine scalar --out {out}", out.parent)
    log = out / "logs" / "the-fit-of-the-red-paint.log"
    first.wait_for(log)
    time.sleep(0.2)  # the log is opened just before the output goes there
    for child in first.children():
        os.kill(child, signal.SIGSEGV)
    status, _, said = first.end()
    assert status == 3
    told = re.search(
        r"^finray demo: error: the fit of the red paint was ended by SIGSEGV .* memory\. Its log is (\S+)\. "
        r"Finished work is kept; run the same command again to continue\. .*$",
        said.splitlines()[-1],
    )
    assert told, said
    assert Path(told[1]) == log
    assert "Fatal Python error: Segmentation fault" in log.read_text()
    kept = tree(out / "red")

    again = Program(f"demo --engine scalar --out {out}", out.parent)
    again.wait_for(out / "red" / "paint.json")
    children = again.children()
    again.process.send_signal(signal.SIGINT)
    status, told_at_once, said = again.end()
    assert status == 130
    assert said.endswith("interrupted; files already written are complete\n")
    assert gone_within(children, 5.0)
    after = tree(out / "red")
    assert all(after[path] == digest for path, digest in kept.items())
    assert f"{out}: continues after 2 of 16 stages" in told_at_once


def test_the_verb_ends_with_what_the_report_returns(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    results = example_results()
    monkeypatch.setattr("finray_calib.demo._report.stored_results", lambda demo, seconds: results)

    def finished(settings: dict[str, Any], *_: object) -> dict[str, Any]:
        Path(settings["out"]).mkdir()
        return write_report(settings, {}) | {"seconds": 61.2}

    monkeypatch.setattr("finray_calib.demo.run_demo", finished)
    told = succeed(f"demo --engine scalar --out {tmp_path}/d")
    assert told.startswith(results.decision.headline)
    assert "time: 61 s" in told
    assert told.endswith(f"look at: {tmp_path}/d/report.html\n")
