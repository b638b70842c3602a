"""``finray check run``: the files it writes, its exit status, and a user's mistakes."""

import json
import re
from pathlib import Path

import pytest

from data_schemas import AcceptanceReport, LostError
from data_schemas.storage import read_record, sha256_of
from rigs import paint_plan, simulated_rig
from rigs.capture import _check_session as check_session
from tests.command_line.running import edit, finray, succeed, tree
from tests.command_line.test_good_runs import require_valid

REGION = paint_plan("red", simulated_rig("red", width_px=320, height_px=256).camera).region
PLAN = f"""\
kind = "check"
check_name = "lab rig"
wheel_moves = 3
revisits = 2

[region]
row_px = {REGION.row_px}
column_px = {REGION.column_px}
height_px = {REGION.height_px}
width_px = {REGION.width_px}

[limits]
revisit_rel = 0.05
"""


@pytest.fixture
def plan(tmp_path: Path) -> Path:
    path = tmp_path / "check.toml"
    path.write_text(PLAN)
    return path


def test_a_good_rig_is_accepted_and_every_file_is_there(lab: Path, plan: Path, tmp_path: Path) -> None:
    said = succeed(f"check run {plan} --rig {lab}/rig.toml --out {tmp_path}/out")
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == ["check.json", "junit.xml", "report.html"]
    report = read_record(tmp_path / "out/check.json", AcceptanceReport)
    # what the simulated rig does not have is named, and is no failure
    assert report.verdict == "UNDECIDED"
    assert {r.name for r in report.results if r.verdict != "PASS"} == {
        "picture stays in place",
        "trigger latency",
        "laser off by the guard",
        "laser off by the dead-man",
    }
    assert all(result.name in said for result in report.results)
    assert "the simulated rig has no guard process" in said
    origin = require_valid(tmp_path / "out/check.json")
    assert origin["input_sha256"] == {f"{p}": sha256_of(p) for p in (plan, lab / "rig.toml")}
    assert origin["seed"] == 1
    assert b'skipped="4"' in (tmp_path / "out/junit.xml").read_bytes()
    assert re.search("Acceptance check .{0,6}lab rig", (tmp_path / "out/report.html").read_text())


def test_a_rig_beyond_its_limits_is_refused_with_status_1(lab: Path, plan: Path, tmp_path: Path) -> None:
    edit(plan, "revisit_rel = 0.05", "move_s = 0.1")
    outcome = finray(f"check run {plan} --rig {lab}/rig.toml --out {tmp_path}/out")
    assert outcome.status == 1
    assert re.search(r"^FAIL      wheel moves in time: ", outcome.out, flags=re.MULTILINE)
    assert json.loads((tmp_path / "out/check.json").read_text())["record"]["verdict"] == "FAIL"
    assert 'failures="1"' in (tmp_path / "out/junit.xml").read_text()


def test_a_rig_that_does_not_open_is_reported_with_status_1(
    lab: Path, plan: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def gone(*_: object) -> None:
        raise LostError("camera: not there")

    monkeypatch.setattr(check_session, "open_rig", gone)
    outcome = finray(f"check run {plan} --rig {lab}/rig.toml --out {tmp_path}/out")
    assert outcome.status == 1
    assert "ERROR     rig opens: camera: not there" in outcome.out
    assert read_record(tmp_path / "out/check.json", AcceptanceReport).verdict == "ERROR"


def test_the_folder_is_named_after_the_check(lab: Path, plan: Path, tmp_path: Path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    succeed(f"check run {plan} --rig {lab}/rig.toml")
    assert (tmp_path / "lab-rig-check/check.json").exists()


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (
            'kind = "check"',
            'kind = "paint"',
            r"'kind' must be one of 'check', 'tactile check', but is 'paint'",
        ),
        ("wheel_moves", "weel_moves", r"'weel_moves': unknown key; did you mean 'wheel_moves'\?"),
        ("revisit_rel", "revisit", r"'limits\.revisit': unknown key; did you mean 'revisit_rel'\?"),
        ("revisits = 2", 'filters = ["999"]', r"check\.toml: plan\.filters: the rig has no filter '999'"),
        ("revisits = 2", "filters = []", r"check\.toml: plan\.filters: is empty"),
        ("revisits = 2", 'filters = ["450", "450"]', r"filters: '450' is named twice"),
        (
            "revisits = 2",
            "exposure_rounds = 3",
            r"'exposure_rounds': must be at least 4, got 3",
        ),
        ("revisit_rel = 0.05", "light_off_s = 0", r"'limits\.light_off_s' \(in s\): must be above 0"),
        ("revisits = 2", "warm_up_s = -5.0", r"must be at least 0, got -5\.0; correct it, and give it in s"),
        ("revisits = 2", 'texture_is_of_the_tile = "maybe"', r"must be true or false, without quotes, got 'maybe'"),
        ("row_px = ", "row_px = 9", r"check\.toml: plan\.region: row_px = \d+ .* outside the frame"),
    ],
)
def test_mistakes_in_the_plan_are_one_line_and_change_nothing(
    lab: Path, plan: Path, tmp_path: Path, old: str, new: str, message: str
) -> None:
    edit(plan, old, new)
    before = tree(tmp_path)
    outcome = finray(f"check run {plan} --rig {lab}/rig.toml --out {tmp_path}/out")
    assert (outcome.status, outcome.out, outcome.err.count("\n")) == (2, "", 1)
    assert re.search(message, outcome.err), outcome.err
    assert tree(tmp_path) == before


def test_mistakes_in_the_arguments(lab: Path, plan: Path, tmp_path: Path) -> None:
    assert "the following arguments are required: ACT" in finray("check").err
    assert "the following arguments are required: --rig" in finray(f"check run {plan}").err
    assert "rig.toml: no such file" in finray(f"check run {plan} --rig {tmp_path}/rig.toml").err
    (tmp_path / "out").mkdir()
    taken = finray(f"check run {plan} --rig {lab}/rig.toml --out {tmp_path}/out")
    assert (taken.status, "exists already and is not overwritten" in taken.err) == (2, True)
