"""Round trips, atomicity and refusals of the record storage."""

import errno
import json
import os
import threading
import tomllib
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
import tifffile
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from pydantic import ValidationError

from data_schemas import (
    BandSignals,
    ChecksumError,
    FieldError,
    FingerDesign,
    IndenterPose,
    Interval,
    NewerSchemaError,
    PaintCalibration,
    PaintPlan,
    RecordError,
    RigFile,
    TactileCapture,
    provenance,
    why_failed,
)
from data_schemas.storage import (
    read_frame,
    read_record,
    read_toml,
    sha256_of,
    toml_text,
    write_bytes,
    write_frame,
    write_record,
)
from data_schemas.storage._records import INLINE_VALUES
from tests.schemas.stored_files import write_sealed

ORIGIN = provenance("pytest", {"input.csv": "0" * 64}, seed=3)


def capture(image: np.ndarray) -> TactileCapture:
    return TactileCapture(
        name="press",
        contact=image,
        no_contact=image,
        repeat_no_contact=None,
        layout="Bayer RGGB",
        encoding="linear",
        bit_depth=10,
        black_level_dn=16.0,
        exposure_s=0.1,
        light_angle_deg=30.0,
        indenter=IndenterPose(shape="cylinder", radius_mm=10.0, depth_mm=1.5, position_mm=35.0),
        contact_circle=None,
        mm_per_px=None,
        source="test",
    )


@settings(max_examples=25, deadline=None)
@given(
    image=arrays(
        np.uint16, st.tuples(st.integers(1, 20), st.integers(1, 20), st.just(1)).map(lambda s: (2 * s[0], 2 * s[1], 1))
    ),
    exposure_s=st.floats(1e-6, 3600.0),
)
def test_round_trip_keeps_every_bit(tmp_path_factory, image, exposure_s):
    folder = tmp_path_factory.mktemp("record")
    record = capture(image).model_copy(update={"exposure_s": exposure_s})
    path = write_record(record, folder / "press.json", ORIGIN)
    back = read_record(path, TactileCapture)
    np.testing.assert_array_equal(back.contact, image)
    assert back.exposure_s == exposure_s
    assert back.provenance == ORIGIN
    assert not back.contact.flags.writeable
    assert (len(list(folder.glob("*.npz"))) == 1) == (image.size > INLINE_VALUES)


def test_no_part_file_is_left_when_writing_fails(tmp_path, monkeypatch):
    def full_disk(handle: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.fsync", full_disk)
    with pytest.raises(OSError, match="No space"):
        write_record(capture(np.zeros((30, 30, 1), np.uint16)), tmp_path / "press.json", ORIGIN)
    assert list(tmp_path.iterdir()) == []


def test_existing_record_is_not_overwritten(tmp_path):
    path = write_record(FingerDesign(), tmp_path / "design.json", ORIGIN)
    before = path.read_bytes()
    with pytest.raises(RecordError, match="exists already and is not overwritten"):
        write_record(FingerDesign(name="other"), path, ORIGIN)
    assert path.read_bytes() == before


def test_of_two_writers_of_a_file_at_the_same_moment_one_wins_whole(tmp_path, monkeypatch):
    both_ready, link = threading.Barrier(2, timeout=20), os.link

    def link_together(source: Path, target: Path) -> None:
        both_ready.wait()
        link(source, target)

    monkeypatch.setattr("os.link", link_together)

    def write(content: bytes) -> str:
        try:
            write_bytes(tmp_path / "page.html", content)
        except RecordError as error:
            return str(error)
        return "won"

    with ThreadPoolExecutor(2) as pool:
        outcomes = list(pool.map(write, (b"one", b"two")))
    winner = outcomes.index("won")
    assert "exists already and is not overwritten" in outcomes[1 - winner]
    assert (tmp_path / "page.html").read_bytes() == (b"one", b"two")[winner]
    assert not list(tmp_path.glob(".*"))


def test_second_writer_of_a_record_is_told_that_one_is_at_work(tmp_path, monkeypatch):
    outcomes, link = [], os.link

    def link_while_another_tries(source: Path, target: Path) -> None:
        if not outcomes:
            try:
                write_record(capture(np.full((30, 30, 1), 2, np.uint16)), tmp_path / "press.json", ORIGIN)
            except RecordError as error:
                outcomes.append(str(error))
        link(source, target)

    monkeypatch.setattr("os.link", link_while_another_tries)
    write_record(capture(np.ones((30, 30, 1), np.uint16)), tmp_path / "press.json", ORIGIN)
    assert "another process seems to be writing this file" in outcomes[0]
    np.testing.assert_array_equal(read_record(tmp_path / "press.json", TactileCapture).contact, 1)
    assert not list(tmp_path.glob(".*"))


def test_array_file_with_the_same_content_is_used_again(tmp_path):
    record = capture(np.ones((30, 30, 1), np.uint16))
    path = write_record(record, tmp_path / "press.json", ORIGIN)
    path.unlink()
    np.testing.assert_array_equal(read_record(write_record(record, path, ORIGIN), TactileCapture).contact, 1)
    path.unlink()
    next(tmp_path.glob("*.npz")).write_bytes(b"other content under this name")
    with pytest.raises(RecordError, match=r"npz: exists already and is not overwritten"):
        write_record(record, path, ORIGIN)
    assert not path.exists()


@pytest.mark.parametrize("number", [errno.EPERM, errno.ENOTSUP, errno.ENOSYS])
def test_file_system_without_hard_links(tmp_path, monkeypatch, number):
    def no_link(source: str, target: Path) -> None:
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr("os.link", no_link)
    write_bytes(tmp_path / "a", b"first")
    with pytest.raises(RecordError, match="exists already and is not overwritten"):
        write_bytes(tmp_path / "a", b"second")
    assert [(p.name, p.read_bytes()) for p in tmp_path.iterdir()] == [("a", b"first")]


@pytest.mark.parametrize(("keys", "told"), [(4, "and 1 more fault"), (5, "and 2 more faults")])
def test_faults_beyond_the_first_five_are_counted(tmp_path, keys, told):
    (tmp_path / "rig.toml").write_text("".join(f"key{k} = 1\n" for k in range(keys)))  # name and wheel are missing
    with pytest.raises(RecordError, match=f"{told}$"):
        read_toml(tmp_path / "rig.toml", RigFile)


def test_other_faults_of_linking_are_reported_and_leave_nothing(tmp_path, monkeypatch):
    def broken(source: str, target: Path) -> None:
        raise OSError(errno.EIO, "Input/output error")

    monkeypatch.setattr("os.link", broken)
    with pytest.raises(OSError, match="Input/output error"):
        write_bytes(tmp_path / "a", b"first")
    assert list(tmp_path.iterdir()) == []


def test_newer_version_is_refused_with_what_to_do(tmp_path):
    path = write_record(FingerDesign(), tmp_path / "design.json", ORIGIN)
    envelope = json.loads(path.read_text())
    envelope["schema_version"] = 99
    path.write_text(json.dumps(envelope))
    with pytest.raises(NewerSchemaError, match=r"design.json: schema_version 99 .*'pip install -U finray-calib"):
        read_record(path, FingerDesign)


def test_earlier_version_is_refused_with_the_command_to_run_again(tmp_path):
    path = tmp_path / "paint.json"
    envelope = {"kind": "PaintCalibration", "schema_version": 1, "array_file": None, "record": {"mode_nm": 600.0}}
    write_sealed(path, envelope)
    with pytest.raises(
        RecordError, match=r"version 1 of the PaintCalibration .* version \d+ .*; run 'finray fit' again"
    ):
        read_record(path, PaintCalibration)


@pytest.mark.parametrize("version", ["one", 0, None, 1.5])
def test_nonsense_version_is_refused(tmp_path, version):
    path = write_record(FingerDesign(), tmp_path / "design.json", ORIGIN)
    envelope = json.loads(path.read_text()) | {"schema_version": version}
    write_sealed(path, envelope)
    with pytest.raises(RecordError, match="whole number from 1"):
        read_record(path, FingerDesign)


def test_wrong_kind_folder_missing_and_broken_files(tmp_path):
    path = write_record(FingerDesign(), tmp_path / "design.json", ORIGIN)
    with pytest.raises(RecordError, match="contains a finger design, but band signals are needed"):
        read_record(path, BandSignals)
    with pytest.raises(RecordError, match="is a folder"):
        read_record(tmp_path, FingerDesign)
    with pytest.raises(RecordError, match="no such file"):
        read_record(tmp_path / "absent.json", FingerDesign)
    path.write_bytes(path.read_bytes()[:50])
    with pytest.raises(RecordError, match="cannot be read as JSON"):
        read_record(path, FingerDesign)
    path.write_text("[" * 100_000)
    with pytest.raises(RecordError, match="cannot be read as JSON"):
        read_record(path, FingerDesign)
    path.write_text("[1]")
    with pytest.raises(RecordError, match="is not a stored record"):
        read_record(path, FingerDesign)


class TestArrayFile:
    @pytest.fixture
    def stored(self, tmp_path) -> tuple[Path, Path]:
        path = write_record(capture(np.ones((40, 40, 1), np.uint16)), tmp_path / "press.json", ORIGIN)
        return path, next(tmp_path.glob("*.npz"))

    def test_changed(self, stored):
        path, array_file = stored
        content = bytearray(array_file.read_bytes())
        content[200] ^= 1
        array_file.write_bytes(bytes(content))
        with pytest.raises(ChecksumError, match=r"npz: was changed \(its SHA-256 differs"):
            read_record(path, TactileCapture)

    def test_missing(self, stored):
        path, array_file = stored
        array_file.unlink()
        with pytest.raises(ChecksumError, match="is missing, but it contains the arrays"):
            read_record(path, TactileCapture)

    @pytest.mark.parametrize("name", ["../secret.npz", "", ".", ".."])
    def test_path_outside_the_folder(self, stored, name):
        path, _ = stored
        envelope = json.loads(path.read_text())
        envelope["array_file"]["file"] = name
        write_sealed(path, envelope)
        with pytest.raises(RecordError, match="must be a plain file name"):
            read_record(path, TactileCapture)

    def test_without_its_keys(self, stored):
        path, _ = stored
        write_sealed(path, json.loads(path.read_text()) | {"array_file": {}})
        with pytest.raises(RecordError, match="must contain 'file' and 'sha256'"):
            read_record(path, TactileCapture)

    def test_pickles_are_never_loaded(self, stored):
        path, array_file = stored
        np.savez(array_file, contact=np.array([{"a": 1}], dtype=object))
        envelope = json.loads(path.read_text())
        envelope["array_file"]["sha256"] = sha256_of(array_file)
        write_sealed(path, envelope)
        with pytest.raises(RecordError, match="cannot be read as numpy arrays"):
            read_record(path, TactileCapture)

    def test_missing_entry(self, stored):
        path, array_file = stored
        np.savez(array_file, contact=np.ones((40, 40, 1), np.uint16))
        envelope = json.loads(path.read_text())
        envelope["array_file"]["sha256"] = sha256_of(array_file)
        write_sealed(path, envelope)
        with pytest.raises(RecordError, match="array 'no_contact' is missing"):
            read_record(path, TactileCapture)


class TestFilesPeopleWrite:
    def rig(self, tmp_path, text: str) -> Path:
        path = tmp_path / "rig.toml"
        path.write_text(text)
        return path

    def test_unknown_key_names_the_nearest(self, tmp_path):
        path = self.rig(
            tmp_path,
            'name = "r"\n[filter_wheel]\n[[filter_wheel.filters]]\nslot = 1\nname = "405"\ncentre_nm = 405\n',
        )
        with pytest.raises(RecordError, match=r"rig.toml: .*centre_nm': unknown key; did you mean 'center_nm'"):
            read_toml(path, RigFile)

    def test_wrong_unit(self, tmp_path):
        path = self.rig(
            tmp_path,
            'name = "r"\n[filter_wheel]\n[[filter_wheel.filters]]\nslot = 1\nname = "405"\ncenter_nm = 0.405\n',
        )
        with pytest.raises(RecordError, match=r"center_nm' \(in nm\): must be at least 200"):
            read_toml(path, RigFile)

    def test_file_without_end(self):
        with pytest.raises(RecordError, match="/dev/zero: is a device; give the path of a rig file"):
            read_toml(Path("/dev/zero"), RigFile)

    def test_filter_named_twice(self, tmp_path):
        one = '[[filter_wheel.filters]]\nslot = {}\nname = "405"\ncenter_nm = {}\n'
        text = 'name = "r"\n[filter_wheel]\n' + one.format(1, 405) + one.format(2, 450)
        with pytest.raises(RecordError, match="name 405 is used by two filters"):
            read_toml(self.rig(tmp_path, text), RigFile)

    def test_exposure_range_turned_round(self, tmp_path):
        text = (
            'name = "r"\n[camera]\nshortest_exposure_s = 2.0\nlongest_exposure_s = 1.0\n[filter_wheel]\n'
            '[[filter_wheel.filters]]\nslot = 1\nname = "405"\ncenter_nm = 405\n'
        )
        with pytest.raises(RecordError, match=r"longest_exposure_s = 1 s must exceed shortest_exposure_s = 2 s"):
            read_toml(self.rig(tmp_path, text), RigFile)

    def test_missing_field(self, tmp_path):
        with pytest.raises(RecordError, match="'paint_name': is missing and must be given"):
            read_toml(self.rig(tmp_path, "[region]\nrow_px=1\ncolumn_px=1\nheight_px=9\nwidth_px=9\n"), PaintPlan)

    def test_no_exposure(self, tmp_path):
        text = 'paint_name = "red"\nbracket = []\n[region]\nrow_px=1\ncolumn_px=1\nheight_px=9\nwidth_px=9\n'
        with pytest.raises(RecordError, match=r"'bracket': must have more entries, at least 1"):
            read_toml(self.rig(tmp_path, text), PaintPlan)

    def test_light_inside_the_gel(self, tmp_path):
        path = self.rig(tmp_path, "[light]\nposition_mm = [0.0, 2.0, 0.0]\n")
        with pytest.raises(RecordError, match="y must be negative"):
            read_toml(path, FingerDesign)

    @pytest.mark.parametrize(
        ("text", "message"),
        [
            ("[indenter]\nacross_mm = 20.0\n", "must lie on the pad"),
            ("[indenter]\nposition_mm = 90.0\n", "must lie on the pad"),
            ("[camera]\nwidth_px = 641\n", "must be even"),
            ("[mirror]\nreflectance = 88.0\n", r"mirror.reflectance': must be at most 1"),
            (
                '[origin]\n"pad.lenght_mm" = "measured"\n',
                r"'origin': 'pad\.lenght_mm' is not a field of the design; did you mean pad\.length_mm",
            ),
            (
                '[origin]\nxyz = "measured"\n',
                r"'xyz' is not a field of the design; fields are pad\.parameters, pad\.package, pad\.shape",
            ),
        ],
    )
    def test_impossible_design(self, tmp_path, text, message):
        with pytest.raises(RecordError, match=message):
            read_toml(self.rig(tmp_path, text), FingerDesign)

    def test_not_toml_missing_and_folder(self, tmp_path):
        with pytest.raises(RecordError, match="cannot be read as TOML"):
            read_toml(self.rig(tmp_path, "name = "), RigFile)
        with pytest.raises(RecordError, match="no such file"):
            read_toml(tmp_path / "absent.toml", RigFile)
        with pytest.raises(RecordError, match="is a folder"):
            read_toml(tmp_path, RigFile)


def test_frames_are_checked_and_never_overwritten(tmp_path):
    path = tmp_path / "frames" / "0001.tiff"
    frame = np.arange(64, dtype=np.uint16).reshape(8, 8)
    digest = write_frame(path, frame, "test frame")
    np.testing.assert_array_equal(read_frame(path, digest), frame)
    with pytest.raises(RecordError, match="not overwritten"):
        write_frame(path, frame, "again")
    with pytest.raises(ChecksumError, match=r"0001.tiff: the frame was changed \(its SHA-256 differs"):
        read_frame(path, "0" * 64)
    with pytest.raises(ChecksumError, match="frame is missing"):
        read_frame(tmp_path / "frames" / "0002.tiff", digest)


@pytest.mark.parametrize("description", ["532 nm, gr\u00fcn, 0.1 s", "532 nm, 0.1 s"])
def test_a_frame_is_described_in_any_language(tmp_path, description):
    """Names of filters stand in the description, which TIFF calls ASCII and readers take for UTF-8."""
    path = tmp_path / "0001.tiff"
    digest = write_frame(path, np.zeros((4, 4), dtype=np.uint16), description)
    assert read_frame(path, digest).shape == (4, 4)
    with tifffile.TiffFile(path) as file:
        assert file.pages[0].description == description


def test_a_list_of_failures_says_where_finray_itself_made_a_wrong_record():
    with pytest.raises(FieldError) as wrong:
        Interval(estimate="much", low95=0.0, high95=1.0)
    assert why_failed(wrong.value).startswith("finray made an invalid record: 'estimate'")
    assert why_failed(RecordError("no such file")) == "no such file"
    with pytest.raises(ValidationError):
        Interval.model_validate({"estimate": "much", "low95": 0.0, "high95": 1.0})


@given(text=st.text(st.characters(exclude_categories=("Cs",))))
def test_a_text_written_as_toml_is_read_as_it_was(text: str) -> None:
    assert tomllib.loads(f"a = {toml_text(text)}") == {"a": text}


def test_toml_refuses_a_del_character_that_json_leaves() -> None:
    assert toml_text('"\x7f\n') == '"\\"\\u007f\\n"'
