"""What ``finray trace`` and ``finray verify`` say, and the exit statuses that scripts look at."""

import json
import re
import shutil
from pathlib import Path

import numpy as np
import pytest

from finray_calib.lineage._trace import compare
from tests.command_line.running import finray, succeed
from tests.lineage.tamperings import made_anew, number
from tests.schemas.freeze import FROZEN
from tests.schemas.stored_files import write_sealed


@pytest.fixture
def decided(lab: Path, tmp_path: Path) -> Path:
    """A decision with its sweep and report, all made by verbs."""
    folder = tmp_path / "lab"
    shutil.copytree(lab, folder)
    (folder / "report.json").unlink()
    for page in folder.glob("report*.html"):
        page.unlink()
    succeed(f"compare {folder}/press.json {folder}/capture.json --out {folder}/report.json")
    succeed(f"decide {folder}/sweep.json --photometric-error {folder}/report.json --out {folder}/decision.json")
    return folder


def test_tree_is_plain_in_a_pipe(decided):
    said = succeed(f"trace {decided}/decision.json").splitlines()
    assert said[0] == f"{decided}/decision.json  LightAngleDecision  unchanged"
    assert f"  {decided}/report.json  PhotometricErrorReport  unchanged" in said
    assert f"    {decided}/press.json  SimulatedPress  unchanged" in said
    assert said[-1].startswith("unchanged: ")
    assert not re.search(r"[^\x00-\x7f]|\x1b", "\n".join(said))


def test_page_stored_with_a_record_is_bound_to_it(decided):
    page = decided / "decision.html"
    page.write_text(page.read_text().replace("deg", "degrees", 1))
    outcome = finray(f"trace {decided}/decision.json")
    assert outcome.status == 1
    assert f"changed: {page}: was changed: its SHA-256 is not the one in decision.json" in outcome.out


def test_statuses(decided, tmp_path):
    assert finray(f"verify {decided}").status == 0
    number("press.json", "light_angle_deg")(decided)
    for command in (f"trace {decided}/decision.json", f"verify {decided}"):
        outcome = finray(command)
        assert outcome.status == 1
        assert re.search(
            r"NOT AS WRITTEN: 1 finding\n(note: .*\n)*changed: .*press.json: does not match its seal", outcome.out
        )
    for mistake, said in {
        f"trace {tmp_path}/none.json": "none.json: no such file",
        f"trace {decided}": "is a folder or a zip archive; give the path",
        f"trace {decided}/plan.toml": "is not a stored record",
        f"verify {tmp_path}/none": "no such folder",
        f"verify {tmp_path / 'empty'}": "holds no stored record, session or checksums",
    }.items():
        (tmp_path / "empty").mkdir(exist_ok=True)
        outcome = finray(mistake)
        assert outcome.status == 2
        assert said in outcome.err


@pytest.mark.parametrize("kind", [["BandSignals"], {"name": "BandSignals"}, 1, None])
def test_a_foreign_json_file_with_a_kind_is_no_record(decided, kind):
    """Many programs write an object with a "kind" that is a list or an object."""
    foreign = decided / "foreign.json"
    foreign.write_text(json.dumps({"kind": kind, "record": {}}))
    assert "foreign.json" in succeed(f"verify {decided}")  # among the files that nothing names
    outcome = finray(f"trace {foreign}")
    assert outcome.status == 2
    assert "is not a stored record" in outcome.err
    (decided / "other").mkdir()
    foreign.rename(decided / "other" / "session.json")
    for command in ("radiometry {}", "export nexus {}"):
        outcome = finray(command.format(decided / "other"))
        assert outcome.status == 2
        assert "session.json: contains " in outcome.err


def test_stale_input(decided):
    made_anew("report.json")(decided)
    outcome = finray(f"trace {decided}/decision.json")
    assert outcome.status == 1
    assert re.search(r"stale: .*report.json: was made again at 20\d\d-", outcome.out)


def test_input_is_found_by_its_checksum_beside_the_record(decided):
    (decided / "sweep.json").rename(decided / "my-sweep.json")
    said = succeed(f"trace {decided}/decision.json")
    assert f"note: found by its SHA-256 as {decided}/my-sweep.json" in said


def test_moved_folder_is_whole(decided, tmp_path):
    moved = tmp_path / "moved"
    decided.rename(moved)
    assert "unchanged" in succeed(f"trace {moved}/decision.json")


def test_records_before_seals_are_read_and_say_so(tmp_path):
    shutil.copytree(FROZEN / "LightAngleDecision" / "v1", tmp_path / "old")
    outcome = finray(f"trace {tmp_path}/old/example.json")
    assert "has no seal" in outcome.out
    assert outcome.status == 1  # its input is not there
    assert "missing" in outcome.out


@pytest.mark.parametrize("name", ["a\0b", 300 * "a"], ids=["NUL", "300 bytes"])
def test_a_name_that_no_file_can_have_is_a_missing_file(tmp_path, name):
    shutil.copytree(FROZEN / "LightAngleDecision" / "v1", tmp_path / "old")
    path = tmp_path / "old" / "example.json"
    envelope = json.loads(path.read_text())
    write_sealed(path, envelope | {"companions": {name: "0" * 64}})
    outcome = finray(f"trace {path}")
    assert outcome.status == 1
    assert "is missing; it belongs to example.json" in outcome.out


def test_replay_of_a_decision_agrees(decided):
    said = succeed(f"trace {decided}/decision.json --replay")
    agrees = re.search(
        r"replayed, agrees within the tolerance [^:]+: \d+ values, \d+ differ"
        r"(?:, by at most (\S+) of the largest value of their field)?",
        said,
    )
    assert agrees
    # sums of another process may come in another order: rounding, far below the declared tolerance
    assert float(agrees[1] or 0.0) < 1e-12
    assert not (decided / "decision-2.json").exists()


def test_replay_writes_nothing_where_an_abbreviated_option_says(decided):
    out = decided / "shortened.json"
    succeed(f"decide {decided}/sweep.json --photometric-error {decided}/report.json --ou {out}")
    moved = decided / "moved.json"
    out.rename(moved)
    made = sorted(decided.rglob("*"))
    assert "replayed, agrees" in succeed(f"trace {moved} --replay")
    assert sorted(decided.rglob("*")) == made


def test_replay_by_another_seed_differs(decided):
    """The command in the provenance is what is run: one that was another gives other numbers."""
    path = decided / "decision.json"
    succeed(f"decide {decided}/sweep.json --seed 8 --out {decided}/other.json")
    envelope, other = (json.loads(p.read_text()) for p in (path, decided / "other.json"))
    envelope["record"]["provenance"]["command"] = other["record"]["provenance"]["command"]
    write_sealed(path, envelope)
    outcome = finray(f"trace {path} --replay")
    assert outcome.status == 1
    assert "REPLAYED, DIFFERS" in outcome.out


def test_what_cannot_be_done_again_is_refused(decided):
    outcome = finray(f"trace {decided}/session/session.json --replay")
    assert outcome.status == 2
    assert "was made by 'finray capture', which cannot be repeated" in outcome.err
    outcome = finray(f"trace {decided}/sweep.json --replay")
    assert outcome.status == 2
    assert "contains no finray command" in outcome.err


class TestComparison:
    def test_equal_and_missing_numbers(self):
        same = {"a": np.array([1.0, np.nan]), "b": {"c": [1.0, None]}, "d": float("nan")}
        assert compare("BandSignals", same, same).agrees

    @pytest.mark.parametrize(
        ("before", "again"),
        [
            ({"a": 1.0}, {"a": 1.0 + 1e-15}),
            ({"a": np.array([1.0, 2.0])}, {"a": np.array([1.0, np.nan])}),
            ({"a": np.array([1, 2])}, {"a": np.array([1, 3])}),
            ({"a": np.zeros(3)}, {"a": np.zeros(4)}),
            ({"a": np.array([np.inf, 1.0])}, {"a": np.array([np.inf, 2.0])}),
            ({"a": "x"}, {"a": "y"}),
            ({"a": None}, {"a": 0.0}),
            ({"a": [1.0]}, {"a": [1.0, 2.0]}),
            ({"a": True}, {"a": 1}),
            ({"a": 1.0}, {}),
        ],
    )
    def test_any_difference_is_one_where_none_is_allowed(self, before, again):
        outcome = compare("BandSignals", before, again)
        assert not outcome.agrees
        assert outcome.differences[0].startswith("a")

    def test_tolerance_is_over_the_largest_of_the_field(self):
        before = {"a": np.array([1.0, 1e-9])}
        assert compare("PaintCalibration", before, {"a": before["a"] + 1e-7}).agrees
        assert not compare("PaintCalibration", before, {"a": before["a"] + 1e-5}).agrees
        assert not compare("PaintCalibration", {"a": 1e-9}, {"a": 1e-7}).agrees

    def test_infinite_values_hide_no_difference(self):
        before = {"a": np.array([np.inf, -np.inf, 1.0])}
        assert compare("PaintCalibration", before, {"a": np.array([np.inf, -np.inf, 1.0 + 1e-7])}).agrees
        assert not compare("PaintCalibration", before, {"a": np.array([np.inf, -np.inf, 2.0])}).agrees
        assert not compare("PaintCalibration", before, {"a": np.array([np.inf, 3.0, 1.0])}).agrees
