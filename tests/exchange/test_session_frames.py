"""Frames of sessions as OME-TIFF, NeXus and bluesky documents, read back by programs that share no code with ours.

OME-XML is judged by ome-types (schema of OME); planes are read by tifffile, by OpenCV's libtiff and by Pillow; NeXus
files by nexusformat, in a process of its own; documents by the validators of event-model, the consolidator of bluesky
and its best-effort callback.
"""

import errno
import json
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import event_model
import h5py
import numpy as np
import ome_types
import pytest
import tifffile
from bluesky.callbacks.best_effort import BestEffortCallback
from bluesky.consolidators import HDF5Consolidator
from PIL import Image

from data_schemas import CaptureSession, ChecksumError, MissingExtraError, RecordError, provenance
from data_schemas.storage import read_frame, read_record, write_frame, write_record
from finray_calib.exchange import (
    SessionFrames,
    read_session_frames,
    write_bluesky_documents,
    write_nexus,
    write_ome_tiff,
)
from finray_calib.exchange._session_frames import FrameSink, SessionFrame
from rigs import camera_plan, paint_plan, simulated_rig
from rigs.capture import SessionRequest, capture_camera_session, capture_paint_session
from tests.capture.drivers import picamera2_stand_in
from tests.capture.drivers.programs import others_python
from tests.capture.finger_session import RIG, capture, plan_of, pressing, rig_of, scene
from tests.command_line.running import finray

Writer = Callable[[SessionFrames, Path, str, Callable[[int, int, str], None]], int]
WRITERS: dict[str, tuple[Writer, str]] = {
    "ome-tiff": (write_ome_tiff, ".ome.tiff"),
    "nexus": (write_nexus, ".nxs"),
    "bluesky": (write_bluesky_documents, ".jsonl"),
}
ORIGIN = "finray export, in a test"
# times are written with 9 digits: of a session of minutes to better than a microsecond
TIME_S = 1e-6


def quiet(done: int, total: int, text: str) -> None:
    """Show no progress."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a paint session of the simulated rig."""
    out = tmp_path_factory.mktemp("sessions") / "paint"
    rig = simulated_rig("red", width_px=160, height_px=128)
    capture_paint_session(rig, paint_plan("red", rig.camera), SessionRequest(out, "pytest"))
    return out


@pytest.fixture(scope="module")
def session(folder: Path) -> SessionFrames:
    return read_session_frames(folder)


@pytest.fixture(scope="module")
def written(session: SessionFrames, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Return the file of each format."""
    out = tmp_path_factory.mktemp("written")
    files = {name: out / f"{name}{ending}" for name, (_, ending) in WRITERS.items()}
    for name, (write, _) in WRITERS.items():
        write(session, files[name], ORIGIN, quiet)
    return files


def stored(session: SessionFrames, frame: SessionFrame) -> np.ndarray:
    """Return a frame as the capture stored it."""
    return read_frame(session.folder / frame.file, frame.sha256)


def facts_of(ome: ome_types.OME, refs: list[ome_types.model.AnnotationRef]) -> dict[str, str]:
    """Return the map annotations that are referred to."""
    maps = {str(note.id): note for note in ome.structured_annotations.map_annotations}
    return {m.k: m.value for ref in refs if ref.id in maps for m in maps[ref.id].value.ms}


def test_ome_xml_keeps_the_schema_and_tells_times_wavelengths_and_filters(
    session: SessionFrames, written: dict[str, Path]
) -> None:
    ome = ome_types.from_tiff(written["ome-tiff"], validate=True)
    frames = {frame.sequence: frame for frame in session.frames}
    seen = set()
    for image in ome.images:
        for plane in image.pixels.planes:
            facts = facts_of(ome, plane.annotation_refs)
            frame = frames[int(facts["sequence"])]
            seen.add(frame.sequence)
            channel = image.pixels.channels[plane.the_c]
            assert channel.name == frame.filter_name
            assert plane.exposure_time == pytest.approx(frame.exposure_s, rel=1e-8)
            assert plane.delta_t == pytest.approx(frame.start_s, abs=TIME_S)
            assert facts["sha256"] == frame.sha256
            assert facts["lights_before"] == frame.facts["lights_before"]
            lit = frame.light == "laser"
            assert channel.excitation_wavelength == (session.laser.wavelength_nm if lit else None)
            seen_through = frame.band is not None and frame.light != "off"
            assert channel.emission_wavelength == (frame.band.center_nm if seen_through else None)
    assert seen == set(frames)
    camera = facts_of(ome, ome.images[0].annotation_refs)
    assert (camera["cfa_pattern"], camera["black_level_dn"], camera["written_by"]) == ("RGGB", "16", ORIGIN)
    assert camera["full_scale_dn"] == "1023"
    assert ome.images[0].pixels.significant_bits == session.camera.bit_depth


def test_ome_tiff_tells_rig_region_and_which_frames_are_dark(session: SessionFrames, written: dict[str, Path]) -> None:
    ome = ome_types.from_tiff(written["ome-tiff"], validate=True)
    instrument = ome.instruments[0]
    assert instrument.lasers[0].wavelength == session.laser.wavelength_nm
    assert instrument.lasers[0].power == session.laser.power_mw
    bands = {one.model: one.transmittance_range for one in instrument.filters}
    for band in session.filters:
        found = bands[band.name]
        assert (found.cut_in, found.cut_out) == (band.center_nm - band.fwhm_nm / 2, band.center_nm + band.fwhm_nm / 2)
    rectangle = ome.rois[0].union[0]
    region = session.region
    assert (rectangle.x, rectangle.y) == (region.column_px, region.row_px)
    assert (rectangle.width, rectangle.height) == (region.width_px, region.height_px)
    tags = {str(tag.id): tag.value for tag in ome.structured_annotations.tag_annotations}
    words = {image.name: [tags[r.id] for r in image.annotation_refs if r.id in tags] for image in ome.images}
    for name, tagged in words.items():
        assert tagged == [
            "dark frame" if name.startswith("dark") else "white frame" if "white of" in name else name.split(" of ")[0]
        ]
    assert any(tagged == ["dark frame"] for tagged in words.values())
    assert any(tagged == ["white frame"] for tagged in words.values())


def test_characters_that_xml_does_not_know_are_replaced(session: SessionFrames, tmp_path: Path) -> None:
    camera = session.camera.model_copy(update={"model": "c\x0b\ud800"})
    odd = replace(session, sample="r\x01\ufffe\u00e9<\n\U0001f600", camera=camera)
    write_ome_tiff(odd, tmp_path / "x.ome.tiff", "finray\x00", quiet)
    ome = ome_types.from_tiff(tmp_path / "x.ome.tiff", validate=True)
    assert "session of r\ufffd\ufffd\u00e9<\n\U0001f600 on rig" in ome.images[0].description
    assert ome.instruments[0].detectors[0].model in (session.device("camera").model, "c\ufffd\ufffd")
    assert facts_of(ome, ome.images[0].annotation_refs)["written_by"] == "finray\ufffd"


def test_characters_that_hdf5_does_not_know_are_replaced(session: SessionFrames, tmp_path: Path) -> None:
    first = replace(session.frames[0], facts={**session.frames[0].facts, "setting_note": "n\x00"})
    odd = replace(session, sample="r\x00\ud800\u00e9", notes=("a\x00", "b"), frames=(first, *session.frames[1:]))
    write_nexus(odd, tmp_path / "x.nxs", ORIGIN, quiet)
    with h5py.File(tmp_path / "x.nxs") as file:
        assert file["entry/sample/name"].asstr()[()] == "r\ufffd\ufffd\u00e9"
        assert file["entry/notes/data"].asstr()[()] == "a\ufffd\nb"
        assert file["entry/frames/setting_note"].asstr()[0] == "n\ufffd"


def test_planes_are_the_stored_counts_for_three_tiff_readers(session: SessionFrames, written: dict[str, Path]) -> None:
    expected = [
        stored(session, frame)
        for one in session.series()
        for time_point in zip(*one.channels, strict=True)
        for frame in time_point
    ]
    read, planes = cv2.imreadmulti(str(written["ome-tiff"]), flags=cv2.IMREAD_UNCHANGED)
    assert read
    with Image.open(written["ome-tiff"]) as image:
        assert image.n_frames == len(planes) == len(expected) == len(session.frames)
        for number, (wanted, plane) in enumerate(zip(expected, planes, strict=True)):
            image.seek(number)
            np.testing.assert_array_equal(plane, wanted)
            np.testing.assert_array_equal(np.asarray(image), wanted)


def test_series_are_whole_rectangles_for_tifffile(session: SessionFrames, written: dict[str, Path]) -> None:
    with tifffile.TiffFile(written["ome-tiff"]) as file:
        assert file.is_ome
        found = {one.name: one for one in file.series}
        for one in session.series():
            rows, columns = session.camera.height_px, session.camera.width_px
            wanted = np.array([[stored(session, frame) for frame in channel] for channel in one.channels])
            counts = found[one.name].asarray().reshape(len(one.channels[0]), len(one.channels), rows, columns)
            np.testing.assert_array_equal(counts, np.swapaxes(wanted, 0, 1))


def test_nexus_file_tells_times_filters_lights_and_sample(session: SessionFrames, written: dict[str, Path]) -> None:
    with h5py.File(written["nexus"]) as file:
        entry = file[file.attrs["default"]]
        plot = entry[entry.attrs["default"]]
        stack = plot[plot.attrs["signal"]]
        camera = entry["instrument/camera"]
        assert (plot.attrs["NX_class"], camera.attrs["NX_class"]) == ("NXdata", "NXdetector")
        for number, frame in enumerate(session.frames):
            np.testing.assert_array_equal(stack[number], stored(session, frame))
        np.testing.assert_array_equal(camera["count_time"], [frame.exposure_s for frame in session.frames])
        np.testing.assert_array_equal(camera["start_time"], [frame.start_s for frame in session.frames])
        assert camera["count_time"].attrs["units"] == camera["start_time"].attrs["units"] == "s"
        assert "distance" not in camera
        assert camera["settings/cfa_pattern"].asstr()[()] == "RGGB"
        wavelength = entry["instrument/laser_beam/incident_wavelength"]
        assert (wavelength[()], wavelength.attrs["units"]) == (session.laser.wavelength_nm, "nm")
        for band in session.filters:
            found = entry[f"instrument/filter_{band.slot}"]
            assert (found.attrs["NX_class"], found["band/wavelength"][()]) == ("NXfilter", band.center_nm)
        assert list(entry["frames/filter"].asstr()) == [frame.filter_name for frame in session.frames]
        assert entry["sample/name"].asstr()[()] == session.sample


BY_NEXUSFORMAT = """
import json, sys
from nexusformat.nexus import nxload
from nexusformat.nexus.validate import validate_file
plot = nxload(sys.argv[1]).get_default()
found = [plot.nxclass, plot.nxsignal.shape, [axis.nxname for axis in plot.nxaxes]]
print("FOUND" + json.dumps([*found, [validate_file(path) for path in sys.argv[1:]]]))
"""


@pytest.mark.rigs
def test_nexus_classes_hold_only_what_their_definitions_know(
    session: SessionFrames, written: dict[str, Path], tmp_path: Path
) -> None:
    """The validator of nexusformat brings the definitions of the NeXus committee; it is seen to find faults."""
    python = others_python("nexusformat")
    spoilt = tmp_path / "spoilt.nxs"
    spoilt.write_bytes(written["nexus"].read_bytes())
    with h5py.File(spoilt, "r+") as file:
        file["entry/instrument/camera/count_time"].attrs["units"] = "mm"
        file["entry/instrument/camera/invented"] = 1.0
    done = subprocess.run(
        [python, "-c", BY_NEXUSFORMAT, str(written["nexus"]), str(spoilt)], capture_output=True, text=True, check=True
    )
    kind, shape, axes, (ours, faulty) = json.loads(done.stdout.partition("FOUND")[2])
    assert (kind, shape) == ("NXdata", [len(session.frames), session.camera.height_px, session.camera.width_px])
    assert axes == ["frame", "row", "column"]
    assert ours == [0, 0]
    assert sum(faulty) > 0


def test_times_count_from_the_frame_that_began_first_though_the_hosts_clock_steps(
    session: SessionFrames, tmp_path: Path
) -> None:
    """The clock of the host is put back by a day after the first frame."""
    first, *others = session.frames
    assert first.start_s == 0.0
    first = replace(first, captured_utc="2026-03-02T10:00:00.000+00:00")
    stepped = replace(
        session, frames=(first, *(replace(frame, captured_utc="2026-03-01T10:00:01.000+00:00") for frame in others))
    )
    write_nexus(stepped, tmp_path / "x.nxs", ORIGIN, quiet)
    with h5py.File(tmp_path / "x.nxs") as file:
        for name in ("start_time", "stop_time"):
            assert file[f"entry/instrument/camera/{name}"].attrs["start"] == first.captured_utc
    write_ome_tiff(stepped, tmp_path / "x.ome.tiff", ORIGIN, quiet)
    ome = ome_types.from_tiff(tmp_path / "x.ome.tiff")
    assert facts_of(ome, ome.images[0].annotation_refs)["delta_t_counts_from"] == first.captured_utc


def test_a_filter_that_is_not_in_the_rig_is_refused(folder: Path, tmp_path: Path) -> None:
    other = tmp_path / "other"
    shutil.copytree(folder, other)
    record = read_record(other / "session.json", CaptureSession)
    place, frame = next((n, f) for n, f in enumerate(record.frames) if f.filter_name is not None)
    frames = list(record.frames)
    frames[place] = frame.model_copy(update={"filter_name": "555"})
    (other / "session.json").unlink()
    for array in other.glob("session*.npz"):
        array.unlink()
    write_record(record.model_copy(update={"frames": tuple(frames)}), other / "session.json", provenance("pytest"))
    with pytest.raises(RecordError, match=rf"session\.json: frames\[{place}\]: filter '555' is not in the rig.*405"):
        read_session_frames(other)


def test_frames_lie_in_the_nexus_file_once(session: SessionFrames, written: dict[str, Path]) -> None:
    with h5py.File(written["nexus"]) as file:
        assert file["entry/data/data"] == file["entry/instrument/camera/data"]
    raw = 2 * session.camera.width_px * session.camera.height_px * len(session.frames)
    assert written["nexus"].stat().st_size < 1.1 * raw


def documents_of(path: Path) -> list[tuple[str, dict]]:
    return [tuple(json.loads(line)) for line in path.read_text(encoding="ascii").splitlines()]


def test_documents_keep_the_event_model(session: SessionFrames, written: dict[str, Path]) -> None:
    documents = documents_of(written["bluesky"])
    for name, document in documents:
        event_model.schema_validators[event_model.DocumentNames[name]].validate(document)
    names = [name for name, _ in documents]
    assert names[0] == "start"
    assert names[-1] == "stop"
    assert names.count("event") == len(session.frames)
    events = [document for name, document in documents if name == "event"]
    keys = next(document for name, document in documents if name == "descriptor")["data_keys"]
    for number, (event, frame) in enumerate(zip(events, session.frames, strict=True), 1):
        assert event["seq_num"] == number
        assert set(event["data"]) == set(keys) - {"camera_frame"}
        assert event["data"]["exposure_s"] == frame.exposure_s
        assert event["data"]["filter"] == frame.filter_name
        assert event["data"]["light"] == frame.light


def test_documents_are_taken_by_router_and_best_effort_callback(written: dict[str, Path]) -> None:
    class Router(event_model.DocumentRouter):
        seen: dict[str, int]

        def __init__(self) -> None:
            super().__init__()
            self.seen = {}

        def __call__(self, name: str, doc: dict, validate: bool = True) -> tuple[str, dict]:
            self.seen[name] = self.seen.get(name, 0) + 1
            return super().__call__(name, doc, validate=validate)

    router, best_effort = Router(), BestEffortCallback()
    best_effort.disable_plots()
    for name, document in documents_of(written["bluesky"]):
        router(name, document, validate=True)
        best_effort(name, document)
    assert router.seen["event"] == 82
    assert router.seen["stream_resource"] == router.seen["stream_datum"] == router.seen["stop"] == 1


def test_consolidator_of_bluesky_finds_the_frames(session: SessionFrames, written: dict[str, Path]) -> None:
    by_name = {name: document for name, document in documents_of(written["bluesky"]) if name != "event"}
    consolidator = HDF5Consolidator(by_name["stream_resource"], by_name["descriptor"])
    consolidator.consume_stream_datum(by_name["stream_datum"])
    assert consolidator.shape == (len(session.frames), session.camera.height_px, session.camera.width_px)
    assert consolidator.data_type.to_numpy_dtype() == np.dtype("<u2")
    assert consolidator.chunks[0] == (1,) * len(session.frames)
    uri = consolidator.get_data_source().assets[0].data_uri
    assert uri.startswith("file://localhost/")
    with h5py.File(uri.removeprefix("file://localhost")) as file:
        stack = file[consolidator.adapter_parameters()["dataset"]]
        for number, frame in enumerate(session.frames):
            np.testing.assert_array_equal(stack[number], stored(session, frame))


def test_camera_session_is_exported_too(tmp_path: Path) -> None:
    rig = simulated_rig("red", width_px=64, height_px=64)
    plan = camera_plan("camera", rig.camera).model_copy(update={"levels": 10, "repeats": 0})
    capture_camera_session(rig, plan, SessionRequest(tmp_path / "camera", "pytest"))
    session = read_session_frames(tmp_path / "camera")
    assert session.kind == "camera"
    write_ome_tiff(session, tmp_path / "c.ome.tiff", ORIGIN, quiet)
    ome = ome_types.from_tiff(tmp_path / "c.ome.tiff", validate=True)
    assert sum(len(image.pixels.planes) for image in ome.images) == len(session.frames)
    write_nexus(session, tmp_path / "c.nxs", ORIGIN, quiet)
    with h5py.File(tmp_path / "c.nxs") as file:
        assert file["entry/data/data"].shape == (len(session.frames), 64, 64)


def tactile_folder(folder: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Capture two presses, with a camera that no other test has."""
    monkeypatch.setitem(sys.modules, "picamera2", picamera2_stand_in.module())
    sensor = picamera2_stand_in.Picamera2.sensor
    sensor.cameras[0]["Num"] = os.getpid()
    sensor.scene = scene(sensor, contact=False)
    rig = rig_of(folder, RIG.replace('address = "0"', f'address = "{os.getpid()}"'))
    capture(folder, plan_of(folder), rig, pressing(sensor))
    return folder / "out"


@pytest.fixture
def finger(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> SessionFrames:
    """Return a tactile session of two presses."""
    return read_session_frames(tactile_folder(tmp_path, monkeypatch))


def test_tactile_session_has_a_pixel_size_and_no_invented_light(finger: SessionFrames, tmp_path: Path) -> None:
    write_ome_tiff(finger, tmp_path / "f.ome.tiff", ORIGIN, quiet)
    ome = ome_types.from_tiff(tmp_path / "f.ome.tiff", validate=True)
    pixels = ome.images[0].pixels
    assert (pixels.physical_size_x, pixels.physical_size_x_unit.value) == (finger.mm_per_px, "mm")
    assert {image.name for image in ome.images} == {"no contact", "contact"}
    assert pixels.channels[0].excitation_wavelength is None
    assert ome.instruments[0].lasers == []
    assert ome.rois == []
    write_nexus(finger, tmp_path / "f.nxs", ORIGIN, quiet)
    with h5py.File(tmp_path / "f.nxs") as file:
        assert "laser" not in file["entry/instrument"]
        assert file["entry/instrument/camera/settings/side_of_a_pixel_on_the_pad"][()] == finger.mm_per_px


def coloured(session: SessionFrames) -> SessionFrames:
    """Return the session with frames of three colours, and no exposure read back, as a stream of pictures has."""
    shape = (session.camera.height_px, session.camera.width_px, 3)
    rng = np.random.default_rng(7)
    frames = []
    for frame in session.frames:
        file = frame.file.replace(".tiff", "_rgb.tiff")
        counts = rng.integers(0, 1023, shape).astype(np.uint16)
        frames.append(replace(frame, file=file, sha256=write_frame(session.folder / file, counts, ""), exposure_s=None))
    return replace(session, frames=tuple(frames))


def test_pictures_of_three_colours_come_back(finger: SessionFrames, tmp_path: Path) -> None:
    session = coloured(finger)
    write_ome_tiff(session, tmp_path / "f.ome.tiff", ORIGIN, quiet)
    ome = ome_types.from_tiff(tmp_path / "f.ome.tiff", validate=True)
    assert ome.images[0].pixels.size_c == 3
    assert ome.images[0].pixels.planes[0].exposure_time is None
    assert "cfa_pattern" not in facts_of(ome, ome.images[0].annotation_refs)
    read, planes = cv2.imreadmulti(str(tmp_path / "f.ome.tiff"), flags=cv2.IMREAD_UNCHANGED)
    assert read
    order = [f for one in session.series() for f in one.channels[0]]
    for plane, frame in zip(planes, order, strict=True):
        np.testing.assert_array_equal(plane[..., ::-1], stored(session, frame))
    write_bluesky_documents(session, tmp_path / "f.jsonl", ORIGIN, quiet)
    for name, document in documents_of(tmp_path / "f.jsonl"):
        event_model.schema_validators[event_model.DocumentNames[name]].validate(document)
        assert "exposure_s" not in document.get("data", {})
    with h5py.File(tmp_path / "f.nxs") as file:
        np.testing.assert_array_equal(file["entry/data/data"][0], stored(session, session.frames[0]))


def test_a_session_of_over_4_gb_is_a_big_tiff(
    session: SessionFrames, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The limit is brought down to the session in place of a session of 4 GB."""
    monkeypatch.setattr("finray_calib.exchange._ome_tiff.LARGEST_PLAIN_BYTES", 1_000_000)
    write_ome_tiff(session, tmp_path / "big.ome.tiff", ORIGIN, quiet)
    with tifffile.TiffFile(tmp_path / "big.ome.tiff") as file:
        assert file.is_bigtiff
        assert len(file.pages) == len(session.frames)


@pytest.mark.parametrize("name", WRITERS)
def test_the_same_session_gives_the_same_pixels_and_numbers_again(
    session: SessionFrames, written: dict[str, Path], tmp_path: Path, name: str
) -> None:
    write, ending = WRITERS[name]
    again = tmp_path / f"{name}{ending}"
    write(session, again, ORIGIN, quiet)
    first = written[name].read_bytes().replace(bytes(written[name].parent), bytes(again.parent))
    assert again.read_bytes() == first


@pytest.mark.parametrize("name", WRITERS)
@pytest.mark.parametrize("fault", ["gone", "changed"])
def test_nothing_is_left_of_a_session_whose_frames_are_not_whole(
    folder: Path, session: SessionFrames, tmp_path: Path, name: str, fault: str
) -> None:
    write, ending = WRITERS[name]
    last = session.frames[-1]
    path = folder / last.file
    content = path.read_bytes()
    path.unlink()
    if fault == "changed":
        path.write_bytes(content[:-1] + b"\x01")
    try:
        with pytest.raises(ChecksumError, match=r"frame is missing|SHA-256 differs"):
            write(session, tmp_path / f"x{ending}", ORIGIN, quiet)
    finally:
        path.write_bytes(content)
    assert list(tmp_path.iterdir()) == []


class FullDisk:
    """An open file on a disk that takes so many bytes more."""

    def __init__(self, file: object, left_bytes: int) -> None:
        self._file, self._left_bytes = file, left_bytes

    def __getattr__(self, name: str) -> object:
        return getattr(self._file, name)

    def write(self, content: bytes) -> int:
        self._left_bytes -= len(content)
        if self._left_bytes < 0:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return self._file.write(content)


@pytest.mark.parametrize("name", WRITERS)
@pytest.mark.parametrize("left_bytes", [0, 1_000_000])
def test_a_full_disk_is_told_with_the_file_and_leaves_nothing(
    session: SessionFrames, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, left_bytes: int
) -> None:
    class OnFullDisk(FrameSink):
        def __init__(self, handle: int) -> None:
            super().__init__(handle)
            self._file = FullDisk(self._file, left_bytes)

    monkeypatch.setattr("finray_calib.exchange._ome_tiff.FrameSink", OnFullDisk)
    monkeypatch.setattr("finray_calib.exchange._nexus.FrameSink", OnFullDisk)
    write, ending = WRITERS[name]
    with pytest.raises(OSError, match="No space left on device") as raised:
        write(session, tmp_path / f"x{ending}", ORIGIN, quiet)
    assert raised.value.filename == str(tmp_path / ("x.nxs" if name == "bluesky" else f"x{ending}"))
    assert list(tmp_path.iterdir()) == []


def test_frames_are_taken_back_where_the_documents_cannot_be_written(
    session: SessionFrames, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(path: Path, content: bytes) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(path))

    monkeypatch.setattr("finray_calib.exchange._nexus.write_bytes", refuse)
    with pytest.raises(OSError, match="No space left"):
        write_bluesky_documents(session, tmp_path / "x.jsonl", ORIGIN, quiet)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", WRITERS)
def test_an_existing_file_is_not_overwritten(session: SessionFrames, tmp_path: Path, name: str) -> None:
    write, ending = WRITERS[name]
    (tmp_path / f"x{ending}").write_text("mine")
    with pytest.raises(RecordError, match="exists already"):
        write(session, tmp_path / f"x{ending}", ORIGIN, quiet)
    assert [path.name for path in tmp_path.iterdir()] == [f"x{ending}"]
    assert (tmp_path / f"x{ending}").read_text() == "mine"


def test_a_link_out_of_the_session_is_refused(folder: Path, session: SessionFrames, tmp_path: Path) -> None:
    path = folder / session.frames[3].file
    outside = tmp_path / "outside.tiff"
    outside.write_bytes(path.read_bytes())
    path.rename(tmp_path / "kept.tiff")
    path.symlink_to(outside)
    try:
        with pytest.raises(RecordError, match="points outside the folder of the session"):
            write_ome_tiff(session, tmp_path / "x.ome.tiff", ORIGIN, quiet)
    finally:
        path.unlink()
        (tmp_path / "kept.tiff").rename(path)


def test_missing_h5py_names_the_extra(session: SessionFrames, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "h5py", None)
    for write, ending in (WRITERS["nexus"], WRITERS["bluesky"]):
        with pytest.raises(MissingExtraError, match=r"pip install 'finray-calib\[nexus\]'"):
            write(session, tmp_path / f"x{ending}", ORIGIN, quiet)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", WRITERS)
def test_the_verb_writes_and_tells(folder: Path, tmp_path: Path, name: str) -> None:
    ending = WRITERS[name][1]
    outcome = finray(f"export {name} {folder} --out {tmp_path}/x{ending} --json")
    assert outcome.status == 0, outcome.err
    said = json.loads(outcome.out)
    assert said["result"] == {"kind": "frames", "format": name, "session": "paint", "frames": 82}
    assert said["look_at"] == f"{tmp_path}/x{ending}"
    assert all(Path(path).is_file() for path in said["written"])
    again = finray(f"export {name} {folder} --out {tmp_path}/x{ending}")
    assert (again.status, "exists already" in again.err) == (2, True)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("export ome-tiff {t}/none --out {t}/a.ome.tiff", "none: no such folder"),
        ("export nexus {t} --out {t}/a.nxs", "contains no capture session"),
        ("export nexus {t}/begun --out {t}/a.nxs", "the capture was not finished.*Continue with"),
        ("export bluesky {t}/lost --out {t}/a.jsonl", "1 of 82 frames of the session are missing.*finray verify"),
        ("export ome-tiff {f} --out {t}/a.tiff", r"must end in \.ome\.tiff or \.ome\.tif"),
        ("export ome-tiff", "ome-tiff needs exactly one session"),
        ("export ome-tiff {f} {f}", "ome-tiff needs exactly one session"),
        ("export nexus {f} --format csv", "--format is only for paints; leave it out for the frames of a session"),
        ("export nexus {f} --dialect calculix", "--dialect: supported only for a deck"),
    ],
)
def test_mistakes_are_told(folder: Path, tmp_path: Path, words: str, message: str) -> None:
    (tmp_path / "begun").mkdir()
    (tmp_path / "begun" / "journal.jsonl").write_text("")
    lost = tmp_path / "lost"
    shutil.copytree(folder, lost)
    next((lost / "frames").iterdir()).unlink()
    outcome = finray(words.format(t=tmp_path, f=folder))
    assert outcome.status == 2
    assert re.search(message, " ".join(outcome.err.split())), outcome.err
    assert not list(tmp_path.glob("a.*"))
