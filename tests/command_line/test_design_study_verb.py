"""``finray study run``: killed in the middle it goes on, and its table, page and records say the same."""

import csv
import json
from pathlib import Path

import pytest

from data_schemas import StudyMetric, StudyPoint, StudyResult, StudyRow, provenance
from data_schemas.storage import read_record, write_record
from finray_calib.cli._design import _finger_or_sensor
from finray_calib.cli._study_run import stand_in_paints
from finray_calib.cli.main import main
from sim import given_design, preset_design, preset_sensor
from sim.studies import StudyPaints, StudyTask, point_file, read_plan, study_points
from sim.studies._point import point_key
from tests.command_line.running import Program

PLAN = """
kind = "design"
name = "tiny & <small>"
about = "Two light angles on one pad."

[set]
"camera.width_px" = 160
"camera.height_px" = 120

[measure]
samples = 2

[[vary]]
field = "light.angle_deg"
values = [0.0, 40.0]

[[vary]]
field = "preset"
values = ["cylindrical-r40"]
"""


def begin(folder: Path, more: str = "") -> Program:
    return Program(f"study run plan.toml --out out {more}", folder)


@pytest.mark.renderer
@pytest.mark.timeout(3600)
def test_a_killed_study_goes_on_with_what_is_missing(tmp_path, capsys):
    (tmp_path / "plan.toml").write_text(PLAN)
    first = begin(tmp_path, "--workers 1")
    one = tmp_path / "out" / "points" / "00001.json"
    first.wait_for(one, 1500.0)
    first.kill()
    kept = {path: path.read_bytes() for path in one.parent.glob("*.json")}

    again = begin(tmp_path)
    status, said, warned = again.end(1500.0)
    assert status == 0, warned
    assert all(path.read_bytes() == content for path, content in kept.items())
    assert not list((tmp_path / "out").rglob(".*"))

    result = read_record(tmp_path / "out" / "study.json", StudyResult)
    points = [read_record(tmp_path / "out" / "points" / f"{n:05d}.json", StudyPoint) for n in (1, 2)]
    assert [row.metrics for row in result.points] == [point.metrics for point in points]
    assert points[0].contact.shape == (60, 80, 3)
    rows = list(csv.DictReader((tmp_path / "out" / "table.csv").read_text().splitlines()))
    assert [row["preset"] for row in rows] == ["cylindrical-r40"] * 2
    brightness = {m.name: m for m in points[1].metrics}["brightness_rel"]
    assert float(rows[1]["brightness_rel"]) == brightness.value
    assert float(rows[1]["brightness_rel_low95"]) == brightness.low95
    page = (tmp_path / "out" / "study.html").read_text()
    assert "tiny &amp; &lt;small&gt;" in page
    assert page.count("data:image/png") == 2
    assert "2 of 2 points computed" in page
    assert "cylindrical-r40" in said

    capsys.readouterr()
    assert main(["study", "show", str(tmp_path / "out")]) == 0
    table, _, last = capsys.readouterr().out.rpartition("look at: ")
    assert table in said
    assert last == f"{tmp_path}/out/study.html\n"
    assert said.endswith("look at: out/study.html\n")


def test_points_of_other_code_are_told_when_a_study_goes_on(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("plan.toml").write_text(PLAN)
    plan, path = read_plan("plan.toml")
    task = StudyTask(plan, StudyPaints(*stand_in_paints()), "auto", tmp_path / "out", tmp_path, provenance("a test"))
    point_file(task.folder, 1).parent.mkdir(parents=True)
    older = task.origin.model_copy(update={"package_version": "0.0.9", "git_commit": "ab" * 20, "git_dirty": False})
    vivid = StudyMetric(name="vividness", value=7.0, low95=6.0, high95=8.0, unit="1", meaning="chroma")
    for planned, origin in zip(study_points(plan, path), (older, task.origin), strict=True):
        record = StudyPoint(
            study=plan.name, number=planned.number, key=point_key(task, planned), changes=planned.changes,
            design=planned.design, metrics=(vivid,), processor_s=1.0,
        )  # fmt: skip
        write_record(record, point_file(task.folder, planned.number), origin)
    assert main(["study", "run", "plan.toml", "--out", "out"]) == 0
    warned = " ".join(capsys.readouterr().err.split())
    old = f"finray-calib 0.0.9, commit {'ab' * 6}"
    assert f"points computed by other code than the present code ({task.origin.code}) are kept: 1 by {old}." in warned
    assert "Give --renew to compute them again" in warned
    assert f"1 by {old}; 2 by {task.origin.code}" in " ".join(Path("out/study.html").read_text().split())
    rows = read_record(Path("out/study.json"), StudyResult).points
    assert [row.computed_by for row in rows] == [old, task.origin.code]
    point_file(task.folder, 1).unlink()
    write_record(record.model_copy(update={"number": 1, "key": point_key(task, study_points(plan, path)[0])}),
                 point_file(task.folder, 1), task.origin)  # fmt: skip
    assert main(["study", "run", "plan.toml", "--out", "out", "--renew"]) == 0
    assert "other code" not in capsys.readouterr().err
    assert "by different code" not in Path("out/study.html").read_text()


def test_points_of_another_renderer_are_told_when_a_study_goes_on(tmp_path, capsys, monkeypatch):
    """Random numbers are shared within one renderer only."""
    monkeypatch.chdir(tmp_path)
    Path("plan.toml").write_text(PLAN)
    plan, path = read_plan("plan.toml")
    task = StudyTask(plan, StudyPaints(*stand_in_paints()), "auto", tmp_path / "out", tmp_path, provenance("a test"))
    point_file(task.folder, 1).parent.mkdir(parents=True)
    vivid = StudyMetric(name="vividness", value=7.0, low95=6.0, high95=8.0, unit="1", meaning="chroma")
    points = study_points(plan, path)

    def store(planned, variant):
        record = StudyPoint(
            study=plan.name, number=planned.number, key=point_key(task, planned), changes=planned.changes,
            design=planned.design, metrics=(vivid,), processor_s=1.0, notes=(f"rendered, level b, {variant}",),
        )  # fmt: skip
        point_file(task.folder, planned.number).unlink(missing_ok=True)
        write_record(record, point_file(task.folder, planned.number), task.origin)

    store(points[0], "scalar_rgb, without what several surfaces reflect")
    store(points[1], "llvm_ad_rgb")
    assert main(["study", "run", "plan.toml", "--out", "out"]) == 0
    warned = " ".join(capsys.readouterr().err.split())
    assert "points were rendered by different renderers: 1 by scalar_rgb; 2 by llvm_ad_rgb. Their differences" in warned
    assert "run the study again with another --out" in warned
    store(points[0], "llvm_ad_rgb")
    assert main(["study", "run", "plan.toml", "--out", "out"]) == 0
    assert "different renderers" not in capsys.readouterr().err


def test_mistakes_in_a_plan_are_one_sentence(tmp_path, capsys):
    assert main(["study", "run", str(tmp_path / "none.toml")]) == 2
    assert "no such plan; give a plan file (TOML) or one of the shipped plans" in capsys.readouterr().err
    (tmp_path / "plan.toml").write_text(PLAN.replace("light.angle_deg", "light.angel"))
    assert main(["study", "run", str(tmp_path / "plan.toml"), "--out", str(tmp_path / "out")]) == 2
    assert (
        "point 1 (light.angel = 0.0, preset = cylindrical-r40): 'light.angel' is not a field" in capsys.readouterr().err
    )
    assert not (tmp_path / "out").exists()


def test_a_study_that_was_never_run_cannot_be_shown(tmp_path, capsys):
    assert main(["study", "show", str(tmp_path)]) == 2
    assert "study.json" in capsys.readouterr().err


def test_two_studies_are_compared_by_the_points_that_they_share(tmp_path, capsys):
    for name, field in (("a", "light.angle_deg"), ("b", "light.angle_deg"), ("c", "pad.thickness_mm")):
        rows = tuple(
            StudyRow(number=k, changes={field: 10.0 * k}, metrics=(
                StudyMetric(name="vividness", value=v, low95=v - 0.1, high95=v + 0.1, unit="1", meaning="chroma"),))
            for k, v in enumerate((5.0, 6.0 if name == "a" else 7.0, 8.0)[: 3 if name == "a" else 2], start=1)
        )  # fmt: skip
        result = StudyResult(name=name, about="", varied=(field,), points=rows, failures=())
        (tmp_path / name).mkdir()
        write_record(result, tmp_path / name / "study.json", provenance("made up", {}, 1))
    a, b, c = (str(tmp_path / name) for name in "abc")
    assert main(["study", "compare", a, b]) == 0
    said = capsys.readouterr().out
    assert "vividness  6 -> 7  1.00 [0.86, 1.14], differs" in said
    assert "1 of 2 numbers with limits differ" in said
    assert "points in the first study only: 1" in said
    assert main(["study", "compare", a, b, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)["result"]
    assert [d["is_apart"] for d in found["differences"]] == [False, True]
    assert found["only_first"] == [{"light.angle_deg": 30.0}]
    assert main(["study", "compare", a, c]) == 2
    said = " ".join(capsys.readouterr().err.split())
    assert (
        "have no result of a point in common, because the first changes light.angle_deg and the second pad.thickness_mm"
        in said
    )


def test_a_folder_with_the_name_of_a_ready_made_design_does_not_hide_it(tmp_path, monkeypatch):
    """Studies and searches write folders of such names by default."""
    monkeypatch.chdir(tmp_path)
    for name in ("flat-70x35", "digit"):
        Path(name).mkdir()
    design, files, _ = given_design(Path("flat-70x35"))
    assert (design, files) == (preset_design("flat-70x35"), [])
    sensor, files, _ = _finger_or_sensor(Path("digit"))
    assert (sensor, files) == (preset_sensor("digit"), [])
