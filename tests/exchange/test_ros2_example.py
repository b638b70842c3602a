"""The ROS 2 example: its messages against the definitions of ROS 2, through a bag that rosbags writes and reads.

The node itself needs ROS 2 and is not run here.
"""

import importlib.util
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from rosbags.highlevel import AnyReader

from data_schemas import TactileCapture, TactileSession, provenance
from data_schemas.storage import read_record, write_record
from finray_calib.exchange import SessionFrames, read_session_frames
from tests.exchange.test_session_frames import stored, tactile_folder

FILE = Path(__file__).resolve().parents[2] / "examples" / "ros2" / "session_to_ros2.py"
FORCE_N = 2.5


@pytest.fixture(scope="module")
def example() -> ModuleType:
    spec = importlib.util.spec_from_file_location("session_to_ros2", FILE)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture
def finger(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> SessionFrames:
    """Return a tactile session of two presses, the second with a force."""
    folder = tactile_folder(tmp_path, monkeypatch)
    second = folder / read_record(folder / "session.json", TactileSession).captures[1]
    record = replace_force(read_record(second, TactileCapture))
    second.unlink()
    for array in second.parent.glob(f"{second.name.removesuffix('.json')}*.npz"):
        array.unlink()
    write_record(record, second, provenance("pytest"))
    return read_session_frames(folder)


def replace_force(record: TactileCapture) -> TactileCapture:
    return record.model_copy(update={"force_n": FORCE_N})


def test_stamps_count_from_the_frame_that_began_first_though_the_hosts_clock_steps(
    example: ModuleType, finger: SessionFrames
) -> None:
    first, *others = sorted(finger.frames, key=lambda frame: frame.start_s)
    stepped = replace(
        finger, frames=(first, *(replace(frame, captured_utc="2020-01-01T00:00:00.000+00:00") for frame in others))
    )
    _, stamp_ns, _ = next(iter(example.messages(stepped)))
    assert stamp_ns == round(1e9 * first.start_unix_s)


def test_a_bag_holds_counts_pattern_times_and_forces(
    example: ModuleType, finger: SessionFrames, tmp_path: Path
) -> None:
    count = example.write_bag(finger, tmp_path / "bag")
    images, infos, wrenches = [], [], []
    with AnyReader([tmp_path / "bag"]) as reader:
        for connection, stamp_ns, raw in reader.messages():
            message = reader.deserialize(raw, connection.msgtype)
            assert stamp_ns == message.header.stamp.sec * 10**9 + message.header.stamp.nanosec
            {"/finray/image_raw": images, "/finray/camera_info": infos, "/finray/wrench": wrenches}[
                connection.topic
            ].append(message)
    assert len(images) == len(infos) == len(finger.frames)
    assert count == len(images) + len(infos) + len(wrenches)
    rows, columns, bits = finger.camera.height_px, finger.camera.width_px, finger.camera.bit_depth
    for frame, message in zip(sorted(finger.frames, key=lambda f: f.start_s), images, strict=True):
        assert (message.height, message.width, message.encoding) == (rows, columns, "bayer_rggb16")
        assert (message.is_bigendian, message.step) == (0, 2 * columns)
        counts = message.data.view("<u2").reshape(rows, columns)
        np.testing.assert_array_equal(counts >> (16 - bits), stored(finger, frame))
    first = images[0].header.stamp
    for frame, message in zip(sorted(finger.frames, key=lambda f: f.start_s), images, strict=True):
        stamp = message.header.stamp
        later_s = stamp.sec - first.sec + 1e-9 * (stamp.nanosec - first.nanosec)
        assert later_s == pytest.approx(frame.start_s, abs=2e-9)
    assert [message.wrench.force.z for message in wrenches] == [FORCE_N]
    contact = next(f for f in finger.frames if f.frame_type == "contact" and f.facts["place"] == 2)
    stamps = [(message.header.stamp.sec, message.header.stamp.nanosec) for message in images]
    place = sorted(finger.frames, key=lambda f: f.start_s).index(contact)
    assert (wrenches[0].header.stamp.sec, wrenches[0].header.stamp.nanosec) == stamps[place]
    assert not infos[0].k.any()


def test_pictures_are_rgb16(example: ModuleType) -> None:
    counts = np.arange(2 * 4 * 3, dtype=np.uint16).reshape(2, 4, 3)
    fields = example.image(counts, "RGGB", 8, 1_500_000_000_250_000_000)
    assert (fields["encoding"], fields["step"], len(fields["data"])) == ("rgb16", 4 * 3 * 2, 48)
    np.testing.assert_array_equal(fields["data"].view("<u2").reshape(2, 4, 3), counts << 8)
    assert fields["header"]["stamp"] == {"sec": 1_500_000_000, "nanosec": 250_000_000}


def test_a_session_without_force_publishes_none(example: ModuleType, finger: SessionFrames) -> None:
    bench = replace(finger, kind="paint")
    assert {kind for kind, _, _ in example.messages(bench)} == {example.IMAGE, example.INFO}
