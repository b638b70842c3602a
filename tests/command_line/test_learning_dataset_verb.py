"""``finray study dataset``: killed in the middle it goes on, and index, card, checksums and shards say the same."""

import csv
import hashlib
from pathlib import Path

import cv2
import numpy as np
import pytest

from data_schemas import DatasetShard, LearningDataset, SimulateError
from data_schemas.storage import manifest_faults, read_record
from finray_calib.cli.main import main
from tests.command_line.running import Program
from tests.simulate.shards import read_shard

SMALL = "--size 40x30 --presses-per-shard 1 --lights 1 --paints 2 --samples 2 --radius-mm 3 5 --depth-mm 0.4 1.2"
WORDS = f"baby-48x18 {SMALL} --out out"


def begin(folder: Path, more: str = "") -> Program:
    return Program(f"study dataset {WORDS} {more}", folder)


def decoded(content):
    return cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_UNCHANGED)


@pytest.mark.renderer
@pytest.mark.timeout(3600)
def test_a_killed_data_set_goes_on_and_grows(tmp_path):
    first = begin(tmp_path, "--presses 3 --workers 1")
    shards = tmp_path / "out" / "shards"
    first.wait_for(shards / "shard-000000.json", 1500.0)
    first.kill()
    kept = {path: path.read_bytes() for path in shards.glob("shard-*")}

    again = begin(tmp_path, "--presses 2 --workers 1")
    status, said, warned = again.end(1500.0)
    assert status == 0, warned
    assert all(path.read_bytes() == content for path, content in kept.items())
    assert not list((tmp_path / "out").rglob(".*"))
    assert said.endswith("look at: out/README.md\n")
    assert "4 samples; presses: 2 train, 0 validation, 0 test" in said

    dataset = read_record(tmp_path / "out" / "dataset.json", LearningDataset)
    rows = list(csv.DictReader((tmp_path / "out" / "index.csv").read_text().splitlines()))
    assert [row["sample"] for row in rows] == ["0", "1", "2", "3"]
    assert len({row["red_emission_factor"] for row in rows}) == 4
    for listed in dataset.shards:
        file = tmp_path / "out" / listed.file
        assert hashlib.sha256(file.read_bytes()).hexdigest() == listed.sha256
        record = read_record(file.with_suffix(".json"), DatasetShard)
        for sample, labels in zip(read_shard(file), record.samples, strict=True):
            assert sample["json"] == labels.model_dump(mode="json")
            pictures = {name: decoded(sample[name]) for name in ("rgb.png", "rest.png", "depth.png", "normals.png")}
            assert {name: (image.dtype, image.shape) for name, image in pictures.items()} == {
                "rgb.png": (np.uint8, (30, 40, 3)), "rest.png": (np.uint8, (30, 40, 3)),
                "depth.png": (np.uint16, (30, 40)), "normals.png": (np.uint16, (30, 40, 3)),
            }  # fmt: skip
            coat = pictures["depth.png"] > 0
            assert 0.1 < coat.mean() < 0.9
            assert (coat == (pictures["normals.png"] > 0).all(axis=-1)).all()
            deepest_mm = (pictures["depth.png"].max() - 32768.0) / 1e3
            assert deepest_mm == pytest.approx(labels.largest_depth_mm, abs=0.51e-3)
            assert deepest_mm <= labels.indenter.depth_mm + 0.15 * np.log(2.0) + 1e-3
    places = np.load(tmp_path / "out" / "places_mm.npy")
    assert places.shape == (30, 40, 2)
    assert np.nanmax(np.abs(places[..., 0])) <= 9.0 + 1e-3
    faults, unlisted = manifest_faults(tmp_path / "out")
    assert not faults
    assert {path.name for path in unlisted} <= {"dataset.json", "manifest-sha256.txt"}

    before = {path: path.read_bytes() for path in shards.glob("shard-*")}
    more = begin(tmp_path, "--presses 3 --workers 1")
    status, said, warned = more.end(1500.0)
    assert status == 0, warned
    assert "6 samples" in said
    assert all(path.read_bytes() == content for path, content in before.items())

    other = begin(tmp_path, "--presses 3 --seed 2")
    status, _, warned = other.end(1500.0)
    assert status == 2
    assert "was computed from another design or seed, other ranges or paints" in " ".join(warned.split())


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--radius-mm", "5", "3"), "the range must not run downwards, from 5 to 3 mm; give the smaller number first"),
        (("--depth-mm", "0.5", "30"), "goes through the pad"),
        (("--radius-mm", "3", "80", "--depth-mm", "1", "3"), "leaves no room on the pad of 48 x 18 mm"),
        (("--emission-ratio", "0.5"), "emission_ratio"),
    ],
)
def test_what_cannot_be_drawn_is_told_before_a_worker_starts(tmp_path, monkeypatch, capsys, words, said):
    monkeypatch.chdir(tmp_path)
    assert main(["study", "dataset", "baby-48x18", "--presses", "2", *words]) == 2
    assert said in " ".join(capsys.readouterr().err.split())
    assert not list(tmp_path.glob("*-dataset"))


def test_the_files_of_a_design_are_named_as_inputs(tmp_path, monkeypatch, capsys):
    def stopped(task, *_):
        raise SimulateError(" ".join(sorted(task.origin.input_sha256)))

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("sim.studies.run_dataset", stopped)
    (tmp_path / "finger.toml").write_text('preset = "baby-48x18"\n[camera]\nresponse = "camera.csv"\n')
    (tmp_path / "camera.csv").write_text("content")
    assert main(["study", "dataset", "finger.toml", "--presses", "1"]) == 2
    assert "camera.csv finger.toml" in capsys.readouterr().err
    (tmp_path / "camera.csv").unlink()
    assert main(["study", "dataset", "finger.toml", "--presses", "1", "--out", "other"]) == 2
    assert "camera.csv: no such file" in capsys.readouterr().err


def test_a_folder_of_something_else_is_left_alone(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "notes").mkdir()
    (tmp_path / "notes" / "mine.txt").write_text("keep")
    assert main(["study", "dataset", "baby-48x18", "--radius-mm", "3", "5", "--presses", "2", "--out", "notes"]) == 2
    assert "holds something other than a data set" in capsys.readouterr().err
    assert (tmp_path / "notes" / "mine.txt").read_text() == "keep"
