"""Captures in one zip archive: ``finray export captures``, and every verb that takes the archive for the folder."""

import json
import shutil
import subprocess
import zipfile
from pathlib import Path

import numpy as np
import pytest

from data_schemas import ComparisonBatch, NormalMapRecord
from data_schemas.storage import read_record
from tests.command_line.running import finray, tree
from tests.exchange.ball_press_folders import BALL_DIAMETER_MM, write_taxim
from tests.exchange.recipe_folders import write_fots


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a set, what was imported of it, and the container of that."""
    folder = tmp_path_factory.mktemp("zips")
    write_fots(folder / "FOTS")
    imported = finray(f"import captures {folder}/FOTS --recipe fots-gelsight --predict-from 2 --out {folder}/fots")
    assert imported.status == 0, imported.err
    exported = finray(f"export captures {folder}/fots --out {folder}/fots.zip")
    assert exported.status == 0, exported.err
    assert "5 captures and 3 simulated presses" in exported.out
    return folder


def scores(summary: Path) -> list[tuple[object, ...]]:
    pairs = read_record(summary, ComparisonBatch).pairs
    return [(pair.name, pair.skill, pair.floor_skill, pair.findings, pair.contact_signal) for pair in pairs]


def test_folder_and_archive_give_the_same_numbers(made: Path, tmp_path: Path) -> None:
    for number, place in enumerate(("fots", "fots.zip")):
        assert finray(f"compare {made}/{place} {made}/{place} --out {tmp_path}/{number}").status == 0
    assert scores(tmp_path / "0/summary.json") == scores(tmp_path / "1/summary.json")
    assert len(scores(tmp_path / "1/summary.json")) == 3
    batch = read_record(tmp_path / "1/summary.json", ComparisonBatch)
    assert (batch.simulators[0].simulator, batch.pairs[0].captured) == ("fots", f"{made}/fots.zip/0002.capture.json")
    pair = f"{made}/fots.zip/0002.press.json {made}/fots.zip/0002.capture.json"
    assert finray(f"compare {pair} --out {tmp_path}/one.json").status == 0
    traced = finray(f"trace {tmp_path}/one.json")
    assert (traced.status, f"{made}/fots.zip/0002.capture.json" in traced.out) == (0, True)


def test_archives_of_other_programs_give_them_too(made: Path, tmp_path: Path) -> None:
    """A folder packed by Info-ZIP, in which it lies as a folder, and one by Python with deflated files."""
    assert finray(f"compare {made}/fots {made}/fots --out {tmp_path}/folder").status == 0
    packed = [tmp_path / "python.zip"]
    with zipfile.ZipFile(packed[0], "w", zipfile.ZIP_DEFLATED) as archive:
        for path in (made / "fots").iterdir():
            archive.write(path, path.name)
    if program := shutil.which("zip"):
        packed.append(tmp_path / "info.zip")
        subprocess.run([program, "-qr", packed[1], "fots"], cwd=made, check=True)
    for path in packed:
        assert finray(f"compare {path} {path} --out {tmp_path}/{path.stem}").status == 0
        assert scores(tmp_path / path.stem / "summary.json") == scores(tmp_path / "folder/summary.json")


def test_a_set_is_imported_from_the_archive_that_a_forge_gives(made: Path, tmp_path: Path) -> None:
    with zipfile.ZipFile(tmp_path / "FOTS-main.zip", "w", zipfile.ZIP_DEFLATED) as archive:
        for path in (made / "FOTS").rglob("*"):
            archive.write(path, f"FOTS-main/{path.relative_to(made / 'FOTS')}")
    imported = finray(f"import captures {tmp_path}/FOTS-main.zip --recipe fots-gelsight --out {tmp_path}/fots")
    assert imported.status == 0, imported.err
    for name in ("0001", "0005"):
        ours, theirs = (
            next(np.load(file)["contact"] for file in folder.glob(f"{name}.capture.*.npz"))
            for folder in (made / "fots", tmp_path / "fots")
        )
        assert np.array_equal(ours, theirs)
    assert finray(f"trace {tmp_path}/fots/0001.capture.json").status == 0


def test_a_container_is_whole_the_same_each_time_and_sees_a_change(made: Path, tmp_path: Path) -> None:
    again = finray(f"export captures {made}/fots.zip --out {tmp_path}/again.zip")
    assert again.status == 0
    assert (tmp_path / "again.zip").read_bytes() == (made / "fots.zip").read_bytes()
    assert finray(f"verify {made}/fots.zip").status == 0
    with zipfile.ZipFile(made / "fots.zip") as archive, zipfile.ZipFile(tmp_path / "changed.zip", "w") as other:
        for entry in archive.infolist():
            content = archive.read(entry)
            other.writestr(entry.filename, content if entry.filename != "circles.csv" else content + b"\n")
    changed = finray(f"verify {tmp_path}/changed.zip")
    assert changed.status == 1
    assert "changed.zip/circles.csv: was changed: its SHA-256 is not the one in manifest-sha256.txt" in changed.out
    before = tree(tmp_path)
    taken = finray(f"export captures {made}/fots --out {tmp_path}/again.zip")
    assert (taken.status, "exists already and is not overwritten" in taken.err) == (2, True)
    assert tree(tmp_path) == before


def test_what_belongs_to_no_capture_is_left_out_and_told(made: Path, tmp_path: Path) -> None:
    shutil.copytree(made / "fots", tmp_path / "fots")
    for name in ("notes.txt", "LICENSE.md", ".hidden"):
        (tmp_path / "fots" / name).write_text("words\n")
    outcome = finray(f"export captures {tmp_path}/fots --out {tmp_path}/f.zip --json")
    with zipfile.ZipFile(tmp_path / "f.zip") as archive:
        names = archive.namelist()
    assert ("LICENSE.md" in names, "notes.txt" in names, ".hidden" in names) == (True, False, False)
    assert {entry[-4:] for entry in names} == {".npz", "json", ".csv", ".png", ".txt", "E.md"}
    assert json.loads(outcome.out)["result"]["left_out"] == ["notes.txt"]


@pytest.mark.parametrize(
    ("words", "says"),
    [
        ("export captures {f}/FOTS --out {t}/a.zip", "FOTS: contains no NAME.capture.json; give a folder of captures"),
        (
            "export captures {f}/fots --out {t}/a.tar",
            "a.tar: must be a zip archive; choose an --out that ends in .zip",
        ),
        ("export captures {f}/fots {f}/fots", "captures need exactly one folder"),
        ("export captures {f}/fots --format csv", "--format is only for paints; leave it out for captures"),
        ("export captures {t}/damaged --out {t}/a.zip", "0001.capture.json: .* seal"),
        ("compare {t}/poisoned.zip {f}/fots --out {t}/o", "poisoned.zip: '../one.txt' leads out of its folder"),
        ("compare {f}/fots {t}/poisoned.zip --out {t}/o", "poisoned.zip: '../one.txt' leads out of its folder"),
        ("bench tactile {t}/poisoned.zip --out {t}/o", "poisoned.zip: '../one.txt' leads out of its folder"),
        ("sense teach {t}/poisoned.zip --out {t}/o.json", "poisoned.zip: '../one.txt' leads out of its folder"),
        ("import captures {t}/poisoned.zip --recipe fots-gelsight --out {t}/o", "poisoned.zip: '../one.txt' leads"),
        ("verify {t}/poisoned.zip", "poisoned.zip: '../one.txt' leads out of its folder"),
        ("trace {f}/fots.zip", "fots.zip: is a folder or a zip archive; give the path of"),
    ],
)
def test_mistakes_are_one_sentence(made: Path, tmp_path: Path, words: str, says: str) -> None:
    import re

    (tmp_path / "damaged").mkdir()
    text = (made / "fots" / "0001.capture.json").read_text().replace('"bit_depth": 8', '"bit_depth": 10')
    (tmp_path / "damaged" / "0001.capture.json").write_text(text)
    with zipfile.ZipFile(tmp_path / "poisoned.zip", "w") as archive:
        archive.writestr("../one.txt", b"1")
    before = tree(tmp_path)
    outcome = finray(words.format(f=made, t=tmp_path))
    assert outcome.status == 2, outcome.out
    assert re.search(says, outcome.err)
    assert outcome.err.count("\n") == 1
    assert tree(tmp_path) == before


def test_a_bench_and_a_map_take_an_archive(made: Path, tmp_path: Path) -> None:
    benches = [
        finray(f"bench tactile {made}/{place} --teach 2 --out {tmp_path}/{place}") for place in ("fots", "fots.zip")
    ]
    assert [bench.status for bench in benches] == [0, 0], benches[1].err
    rows = [json.loads((tmp_path / place / "row.json").read_text()) for place in ("fots", "fots.zip")]
    for row in rows:
        del row["row_sha256"]
    assert rows[0] == rows[1]
    assert rows[1]["set"] == "fots"


def test_a_map_taught_from_an_archive_is_the_one_of_the_folder(tmp_path: Path) -> None:
    write_taxim(tmp_path / "taxim")
    imported = finray(f"import taxim {tmp_path}/taxim --ball-diameter-mm {BALL_DIAMETER_MM} --out {tmp_path}/captures")
    assert imported.status == 0, imported.err
    assert finray(f"export captures {tmp_path}/captures --out {tmp_path}/captures.zip").status == 0
    for name in ("captures", "captures.zip"):
        taught = finray(f"sense teach {tmp_path}/{name} --out {tmp_path}/{name}.map.json")
        assert taught.status == 0, taught.err
    one, other = (read_record(tmp_path / f"{name}.map.json", NormalMapRecord) for name in ("captures", "captures.zip"))
    assert np.array_equal(one.held_out_angle_deg, other.held_out_angle_deg)
    sensed = finray(
        f"sense run {tmp_path}/captures.zip.map.json {tmp_path}/captures.zip/press-001.capture.json "
        f"--out {tmp_path}/one.json"
    )
    assert sensed.status == 0, sensed.err
