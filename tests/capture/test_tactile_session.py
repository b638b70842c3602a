"""Tactile sessions: over MJPEG, from replayed Raspberry Pi raw files, and through the picamera2 stand-in."""

import io
import json
import re
import sys
import tomllib
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from pydantic import ValidationError

from data_schemas.capture import TactileCapture
from data_schemas.errors import BadFrameError, CaptureError, LostError, RecordError, RefusedError
from data_schemas.provenance import provenance
from data_schemas.rig import CameraSettings
from data_schemas.simulate import SimulatedPress
from data_schemas.storage import read_frame, read_record, read_toml, write_record
from data_schemas.tactile import TactilePlan, TactileRig, TactileSession
from finray_calib.compare.comparison_record import compare_press
from finray_calib.compare.linear_image import rgb_image
from rigs.capture.journal import read_journal
from rigs.capture.tactile_camera import TactileCamera
from rigs.capture.tactile_plan import instruction, planned_presses, tactile_shots
from rigs.capture.tactile_resume import is_tactile, read_interrupted_presses
from rigs.capture.tactile_session import capture_tactile_session
from rigs.protocols import RawFrame
from tests.capture.drivers import picamera2_stand_in
from tests.capture.drivers.test_mjpeg import ffmpeg_server, jpeg, serving, stream_of
from tests.command_line.running import finray
from tests.exchange.test_raspberry_pi_folder import write_dng

HOW_TO = Path(__file__).resolve().parents[2] / "docs" / "how-to"
WIDTH_PX, HEIGHT_PX = 96, 64
PLAN = """\
kind = "tactile"
name = "finger 3, ball"
design = "finger 3"
exposures_s = [0.01]
no_contact_images = 2
led_current_ma = 20.0
light_angle_deg = 30.0
light_angle_uncertainty_deg = 0.5
mm_per_px = 0.1
[indenter]
shape = "ball"
radius_mm = 4.0
[[presses]]
depth_mm = 1.0
position_mm = 35.0
depth_uncertainty_mm = 0.02
position_uncertainty_mm = 0.1
tilt_uncertainty_deg = 0.3
[[presses]]
depth_mm = 1.5
position_mm = 40.0
tilt_deg = 5.0
depth_uncertainty_mm = 0.02
position_uncertainty_mm = 0.1
"""
RIG = f"""\
name = "finger on a Pi"
[camera]
driver = "picamera2"
address = "0"
width_px = {WIDTH_PX}
height_px = {HEIGHT_PX}
bit_depth = 10
"""


class Hands:
    """An operator who notes what is asked and does something at it."""

    def __init__(self, act=lambda text: None) -> None:
        self.asked, self._act = [], act

    def do(self, text: str) -> None:
        self.asked.append(text)
        self._act(text)


def plan_of(folder: Path, text: str = PLAN) -> TactilePlan:
    path = folder / "tactile.toml"
    path.write_text(text, encoding="utf-8")
    return read_toml(path, TactilePlan)


def rig_of(folder: Path, text: str = RIG) -> TactileRig:
    path = folder / "rig.toml"
    path.write_text(text, encoding="utf-8")
    return read_toml(path, TactileRig)


def capture(folder: Path, plan: TactilePlan, rig: TactileRig, hands: Hands, **other) -> TactileSession:
    return capture_tactile_session(rig, plan, plan.presses, (folder, folder / "out"), "pytest", operator=hands, **other)


@pytest.fixture
def sensor(monkeypatch):
    monkeypatch.setitem(sys.modules, "picamera2", picamera2_stand_in.module())
    return picamera2_stand_in.Picamera2.sensor


def scene(sensor, contact: bool):
    """Light proportional to the exposure above the black level; a contact brightens the middle by half."""
    width, height = sensor.size
    rng = np.random.default_rng(1)

    def counts(exposure_s: float) -> np.ndarray:
        light = np.full((height, width), 2e4)
        light[height // 4 : 3 * height // 4, width // 4 : 3 * width // 4] *= 1.5 if contact else 1.0
        return 64 + exposure_s * light + rng.normal(0, 1, light.shape)

    return counts


def pressing(sensor) -> Hands:
    def act(text: str) -> None:
        sensor.scene = scene(sensor, contact=text.startswith("Press"))

    return Hands(act)


def press_like(captured: TactileCapture) -> SimulatedPress:
    """The render that would give this capture."""
    no_contact, contact = (
        np.nan_to_num(rgb_image(i, captured), nan=255) for i in (captured.no_contact, captured.contact)
    )
    rows, columns = np.indices(contact.shape[:2]) - np.array(contact.shape[:2])[:, None, None] / 2
    return SimulatedPress(
        name="like it",
        label="made up",
        method="rendered",
        encoding=captured.encoding,
        no_contact=no_contact.astype(np.float32),
        contact=contact.astype(np.float32),
        distance=(np.hypot(rows, columns) / (contact.shape[0] / 4)).astype(np.float32),
        variance=np.full_like(contact, 0.01, dtype=np.float32),
        light_angle_deg=30.0,
        design=None,
    )


def test_session_of_raw_frames(sensor, tmp_path):
    plan, hands = plan_of(tmp_path), pressing(sensor)
    session = capture(tmp_path, plan, rig_of(tmp_path), hands)
    assert [re.match(r"[A-Z]\w+", text)[0] for text in hands.asked] == ["Set", "Press", "Take", "Press", "Take"]
    assert hands.asked[3] == (
        "Press 2 of 2: ball of radius 4 mm, 1.5 mm deep at 40 mm along the pad, tilted by 5 deg. Hold it there."
    )
    assert [f.frame_type for f in session.frames] == [
        *["no contact"] * 2, "contact", *["no contact"] * 2, "contact", *["no contact"] * 2,
    ]  # fmt: skip
    assert session.devices[0].model == "imx219"
    assert read_record(tmp_path / "out" / "session.json", TactileSession) == session.model_copy(
        update={"provenance": read_record(tmp_path / "out" / "session.json", TactileSession).provenance}
    )
    assert not any(line["event"] == "refused" for line in read_journal(tmp_path / "out"))
    stored = read_record(tmp_path / "out" / "press-001.json", TactileCapture)
    assert (stored.layout, stored.encoding, stored.bit_depth, stored.black_level_dn) == ("Bayer RGGB", "linear", 10, 64)
    second = read_record(tmp_path / "out" / "press-002.json", TactileCapture)
    assert set(second.provenance.input_sha256) == {frame.file for frame in session.frames[3:8]}
    assert stored.exposure_s == session.frames[2].exposure_s
    assert stored.exposure_s != session.frames[2].exposure_requested_s
    assert stored.indenter.depth_uncertainty_mm == 0.02
    assert stored.indenter.tilt_uncertainty_deg == 0.3
    assert (stored.led_current_ma, stored.light_angle_uncertainty_deg) == (20.0, 0.5)
    out = tmp_path / "out"
    for image, number in ((stored.contact, 2), (stored.no_contact, 1), (stored.repeat_no_contact, 3)):
        frame = session.frames[number]
        assert np.array_equal(image[..., 0], read_frame(out / frame.file, frame.sha256))


def test_capture_of_raw_frames_is_compared_in_linear_light(sensor, tmp_path):
    capture(tmp_path, plan_of(tmp_path), rig_of(tmp_path), pressing(sensor))
    stored = read_record(tmp_path / "out" / "press-001.json", TactileCapture)
    report = compare_press(press_like(stored), stored, 1)
    assert report.values == "linear light"
    assert report.headline_skill.estimate > 0.9


def test_longest_exposure_without_clipping_is_taken_of_a_bracket(sensor, tmp_path):
    text = PLAN.replace("exposures_s = [0.01]", "bracket_powers = [4, 22]")
    rig = rig_of(tmp_path, RIG + "shortest_exposure_s = 1e-3\nlongest_exposure_s = 0.1\n")
    session = capture(tmp_path, plan_of(tmp_path, text), rig, pressing(sensor))
    stored = read_record(tmp_path / "out" / "press-001.json", TactileCapture)
    # 2^10 to 2^16 us are allowed; 64 + 3e4 DN/s x t stays below 1023 DN up to 32 ms, so 2^14 us = 16 ms is the longest
    assert stored.exposure_bracket_s == pytest.approx([2**n * 1e-6 for n in range(10, 17)])
    assert stored.exposure_s == pytest.approx(2**14 * 1e-6, rel=0.01)
    assert len(session.frames) == 7 * (2 + 2 * 3)


def test_saturated_press_is_given_at_its_shortest_exposure(sensor, tmp_path):
    text = PLAN.replace("[0.01]", "[0.04, 0.08]")
    session = capture(tmp_path, plan_of(tmp_path, text), rig_of(tmp_path), pressing(sensor))
    assert read_record(tmp_path / "out" / "press-001.json", TactileCapture).exposure_s == pytest.approx(0.04, rel=1e-3)
    # The contact is 33 x 49 of 64 x 96 px.
    assert "contact 1: 26.3 % of an image is clipped at the shortest exposure" in session.notes[0]


def test_board_comes_first_and_presses_are_repeated(sensor, tmp_path):
    text = PLAN.replace("exposures_s", "repeats = 2\nexposures_s")
    board = '[board]\nsquares = [7, 5]\nsquare_mm = 3.0\nmarker_mm = 2.2\ndictionary = "DICT_4X4_50"\nimages = 3\n'
    plan, hands = plan_of(tmp_path, text + board), pressing(sensor)
    session = capture(tmp_path, plan, rig_of(tmp_path), hands)
    assert hands.asked[2].startswith("Hold the ChArUco board in view, still; place 3 of 3")
    assert [f.frame_type for f in session.frames[:4]] == ["board"] * 3 + ["no contact"]
    depths = [read_record(tmp_path / "out" / name, TactileCapture).indenter.depth_mm for name in session.captures]
    assert depths == [1.0, 1.0, 1.5, 1.5]


def test_replayed_raspberry_pi_raw_files_through_the_command_line(tmp_path, monkeypatch):
    """DNGs in the layout of rpicam-still, taken elsewhere, replayed from their folder."""
    rng, folder = np.random.default_rng(2), tmp_path / "raw"
    folder.mkdir()
    lines = ["file,exposure_s"]
    for number, factor in enumerate((1.0, 1.0, 1.5, 1.0, 1.0, 1.6, 1.0, 1.0)):
        light = np.full((HEIGHT_PX + 2, WIDTH_PX + 2), 200.0)
        light[16:48, 24:72] *= factor
        counts = np.rint(64 + light + rng.normal(0, 1, light.shape)).astype(np.uint16)
        write_dng(folder / f"{number:02d}.dng", counts)
        lines.append(f"{number:02d}.dng,0.01")
    (folder / "frames.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    rig_of(tmp_path, RIG.replace('"picamera2"', '"folder"').replace('"0"', '"raw"') + "black_level_dn = 64.0\n")
    plan_of(tmp_path)
    monkeypatch.setattr(sys, "stdin", io.StringIO("\n" * 20))
    out = tmp_path / "presses"
    outcome = finray(f"capture {tmp_path}/tactile.toml --rig {tmp_path}/rig.toml --out {out}")
    assert outcome.status == 0, outcome.err
    assert outcome.out == f"{out}: 8 frames of 'finger 3, ball', 2 tactile captures\n"
    assert "Press 1 of 2: ball of radius 4 mm" in outcome.err
    stored = read_record(out / "press-001.json", TactileCapture)
    assert (stored.encoding, stored.layout, stored.exposure_s) == ("linear", "Bayer RGGB", 0.01)
    assert stored.contact[HEIGHT_PX // 2, WIDTH_PX // 2, 0] == pytest.approx(364, abs=6)
    write_record(press_like(stored), tmp_path / "press.json", provenance("pytest"))
    compared = finray(f"compare {tmp_path}/press.json {out}/press-001.json --out {tmp_path}/report.json")
    assert compared.status == 0, compared.err


def mjpeg_rig(folder: Path, address: str, width_px: int, height_px: int) -> TactileRig:
    camera = f'driver = "mjpeg"\naddress = "{address}"\nwidth_px = {width_px}\nheight_px = {height_px}\nbit_depth = 8\n'
    return rig_of(folder, f'name = "stream"\n[camera]\n{camera}')


def require_unknown_encoding(out: Path) -> None:
    stored = read_record(out / "press-001.json", TactileCapture)
    assert (stored.layout, stored.encoding, stored.exposure_s, stored.black_level_dn) == ("RGB", "unknown", None, 0.0)
    report = compare_press(press_like(stored), stored, 1)
    assert report.values == "encoded values, encoding unknown"


def test_session_over_mjpeg_has_unknown_encoding(tmp_path):
    pictures = stream_of(*(jpeg(n) for n in range(240)))
    with serving(pictures, every_s=0.005) as address:
        session = capture(tmp_path, plan_of(tmp_path), mjpeg_rig(tmp_path, address, 320, 240), Hands())
    assert session.frames[0].exposure_s is None
    assert session.frames[0].settings["exposure"] == "unknown"
    stored = cv2.imread(str(tmp_path / "out" / session.frames[0].file), cv2.IMREAD_UNCHANGED)
    assert stored.shape == (240, 320, 3)
    assert stored[5, 5, 2] > stored[5, 5, 0] or stored[5, 5, 0] > 127  # OpenCV reads it as blue, green, red
    require_unknown_encoding(tmp_path / "out")


@pytest.mark.rigs
def test_session_over_ffmpeg(tmp_path):
    with ffmpeg_server() as (address, _):
        capture(tmp_path, plan_of(tmp_path), mjpeg_rig(tmp_path, address, 320, 240), Hands())
    require_unknown_encoding(tmp_path / "out")


def test_bracket_over_mjpeg_is_refused(tmp_path):
    plan = plan_of(tmp_path, PLAN.replace("[0.01]", "[0.01, 0.02]"))
    with (
        serving(stream_of(*(jpeg(n) for n in range(240)))) as address,
        pytest.raises(RefusedError, match=r"does not say its exposure time.*give one exposure"),
    ):
        capture(tmp_path, plan, mjpeg_rig(tmp_path, address, 320, 240), Hands())


@pytest.mark.parametrize("stop_at", ["Set", "Press 1", "Take", "Press 2", "frame of a bracket"])
def test_resumed_session_is_the_same(sensor, tmp_path, stop_at):
    plan = plan_of(tmp_path, PLAN.replace("[0.01]", "[0.005, 0.01]"))
    rig, hands, out = rig_of(tmp_path), pressing(sensor), tmp_path / "out"

    def stop(text: str) -> None:
        if text.startswith(stop_at):
            raise KeyboardInterrupt
        hands.do(text)

    def stop_within_a_press(done: int, total: int, what: str) -> None:
        if stop_at == "frame of a bracket" and done == 5:  # the first of the two exposures of press 1
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        capture(tmp_path, plan, rig, Hands(stop), progress=stop_within_a_press)
    assert is_tactile(out)
    interrupted = read_interrupted_presses(out)
    asked = Hands()
    session = capture_tactile_session(
        interrupted.rig, interrupted.plan, interrupted.presses, (interrupted.rig_folder, out), "pytest",
        operator=asked, interrupted=interrupted,
    )  # fmt: skip
    assert [f.sequence for f in session.frames] == list(range(16))
    assert len(session.captures) == 2
    assert asked.asked[0].startswith("Press 1" if stop_at == "frame of a bracket" else stop_at)
    aside = [path.name for path in (out / "set-aside").glob("*")] if (out / "set-aside").exists() else []
    assert len(aside) == (1 if stop_at == "frame of a bracket" else 0)
    assert f"interrupted after {len(interrupted.frames)} frames" in session.notes[0]
    assert len(session.notes) == 1
    with pytest.raises(CaptureError, match="is finished already"):
        read_interrupted_presses(out)


def test_changed_frame_is_taken_again(sensor, tmp_path):
    def stop(text: str) -> None:
        if text.startswith("Press 2"):
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        capture(tmp_path, plan_of(tmp_path), rig_of(tmp_path), Hands(stop))
    next((tmp_path / "out" / "frames").glob("00002_contact*")).write_bytes(b"torn")
    assert sorted(read_interrupted_presses(tmp_path / "out").frames) == [0, 1, 3, 4]


def resumed(folder: Path, hands: Hands) -> TactileSession:
    interrupted = read_interrupted_presses(folder / "out")
    return capture_tactile_session(
        interrupted.rig, interrupted.plan, interrupted.presses, (folder, folder / "out"), "pytest",
        operator=hands, interrupted=interrupted,
    )  # fmt: skip


def test_captures_of_an_interrupted_session_are_made_anew(sensor, tmp_path):
    """One of their frames was changed since, so that its group is taken again."""
    capture(tmp_path, plan_of(tmp_path), rig_of(tmp_path), pressing(sensor))
    out = tmp_path / "out"
    for name in ("session.json", "manifest-sha256.txt"):
        (out / name).unlink()
    next((out / "frames").glob("00002_contact*")).write_bytes(b"torn")
    before = read_record(out / "press-001.json", TactileCapture)
    sensor.scene = lambda exposure_s: np.tile(np.arange(98) * 5, (66, 1))
    session = resumed(tmp_path, Hands())
    after = read_record(out / "press-001.json", TactileCapture)
    assert np.array_equal(after.contact[..., 0], read_frame(out / session.frames[2].file, session.frames[2].sha256))
    assert not np.array_equal(after.contact, before.contact)
    assert len(list((out / "set-aside").glob("*_press-001.json"))) == 1


def interrupt_at_press_2(text: str) -> None:
    if text.startswith("Press 2"):
        raise KeyboardInterrupt


def test_session_does_not_go_on_with_another_camera(sensor, tmp_path, monkeypatch):
    with pytest.raises(KeyboardInterrupt):
        capture(tmp_path, plan_of(tmp_path), rig_of(tmp_path), Hands(interrupt_at_press_2))
    monkeypatch.setattr(picamera2_stand_in.Picamera2, "camera_properties", {"Model": "imx708"})
    with pytest.raises(CaptureError, match=r"imx708 .* answers now; the session began with .*imx219"):
        resumed(tmp_path, Hands())


def test_session_that_went_on_elsewhere_is_left_alone(sensor, tmp_path):
    with pytest.raises(KeyboardInterrupt):
        capture(tmp_path, plan_of(tmp_path), rig_of(tmp_path), Hands(interrupt_at_press_2))
    interrupted, out = read_interrupted_presses(tmp_path / "out"), tmp_path / "out"
    (out / "frames" / "00005_new.tiff").write_bytes(b"being written")
    with (out / "journal.jsonl").open("a", encoding="utf-8") as journal:
        journal.write('{"event": "resume", "frames": 5}\n')
    with pytest.raises(CaptureError, match="another capture went on with this session meanwhile"):
        capture_tactile_session(
            interrupted.rig, interrupted.plan, interrupted.presses, (tmp_path, out), "pytest", interrupted=interrupted
        )
    assert (out / "frames" / "00005_new.tiff").exists()


def test_replay_is_not_resumed(sensor, tmp_path):
    with pytest.raises(KeyboardInterrupt):
        capture(tmp_path, plan_of(tmp_path), rig_of(tmp_path), Hands(interrupt_at_press_2))
    journal = tmp_path / "out" / "journal.jsonl"
    text = journal.read_text(encoding="utf-8").replace('"driver": "picamera2"', '"driver": "folder"')
    journal.write_text(text, encoding="utf-8")
    with pytest.raises(CaptureError, match="replays a folder of images, which would begin with its first image again"):
        read_interrupted_presses(tmp_path / "out")


def test_resume_through_the_command_line(sensor, tmp_path, monkeypatch):
    plan_of(tmp_path)
    rig_of(tmp_path)
    out = tmp_path / "presses"
    monkeypatch.setattr(sys, "stdin", io.StringIO("\n\n"))
    stopped = finray(f"capture {tmp_path}/tactile.toml --rig {tmp_path}/rig.toml --out {out}")
    assert stopped.status == 2
    assert "needs a person" in stopped.err
    assert f"finray capture --resume {out}" in stopped.err
    monkeypatch.setattr(sys, "stdin", io.StringIO("\n" * 9))
    resumed = finray(f"capture --resume {out}")
    assert resumed.status == 0, resumed.err
    assert "3 frames are there and unchanged" in resumed.out
    assert "8 frames of 'finger 3, ball', 2 tactile captures" in resumed.out


def test_dry_run_lists_and_opens_nothing(sensor, tmp_path):
    plan_of(tmp_path)
    rig_of(tmp_path)
    outcome = finray(f"capture {tmp_path}/tactile.toml --rig {tmp_path}/rig.toml --dry-run")
    assert "2 presses, 1 times each; 8 frames, 0 MB at most\n5 things to do by hand" in outcome.out
    assert sensor.log == []


def test_like_is_refused(tmp_path):
    plan_of(tmp_path)
    rig_of(tmp_path)
    outcome = finray(f"capture {tmp_path}/tactile.toml --rig {tmp_path}/rig.toml --like {tmp_path}")
    assert outcome.status == 2
    assert "--like is for plans of kind 'paint'" in outcome.err


@pytest.mark.parametrize("start", ["", '{"event": "start", "kind": "tactile"}', '{"event": "start", "kind": "paint"}'])
def test_journal_without_a_start_is_refused(tmp_path, start):
    (tmp_path / "journal.jsonl").write_text(start + '\n{"event": "frame", "file": "no"}\n', encoding="utf-8")
    with pytest.raises(CaptureError, match="does not say how the session began"):
        read_interrupted_presses(tmp_path)


def test_folder_in_use_is_refused(sensor, tmp_path):
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "notes.txt").write_text("mine", encoding="utf-8")
    with pytest.raises(CaptureError, match="is not an empty folder"):
        capture(tmp_path, plan_of(tmp_path), rig_of(tmp_path), Hands())


def test_second_capture_on_the_camera_is_refused(sensor, tmp_path):
    plan, rig = plan_of(tmp_path), rig_of(tmp_path)
    (tmp_path / "two").mkdir()

    def again(text: str) -> None:
        capture(tmp_path / "two", plan, rig, Hands())

    with pytest.raises(CaptureError, match="picamera2 at 0 is in use by another capture"):
        capture(tmp_path, plan, rig, Hands(again))


def test_full_disk_stops_with_the_way_on(sensor, tmp_path, monkeypatch):
    def full(*arguments: object) -> str:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("rigs.capture.tactile_session.write_frame", full)
    with pytest.raises(CaptureError, match=r"No space left on device.*finray capture --resume"):
        capture(tmp_path, plan_of(tmp_path), rig_of(tmp_path), Hands())


def test_frames_that_the_disk_cannot_hold_are_refused(sensor, tmp_path):
    huge = rig_of(tmp_path, RIG.replace(f"= {WIDTH_PX}", "= 8192").replace(f"= {HEIGHT_PX}", "= 8192"))
    sensor.size = (8194, 8194)
    plan = plan_of(
        tmp_path, PLAN.replace("exposures_s", "repeats = 100\nexposures_s").replace("images = 2", "images = 50")
    )
    with pytest.raises(CaptureError, match=r"the frames need .* MB are free"):
        capture(tmp_path, plan, huge, Hands())


class Scripted:
    """A camera that delivers what it is given, frames or errors."""

    def __init__(self, *script) -> None:
        self._script = list(script)

    def identity(self):
        raise NotImplementedError

    def expose(self, exposure_s: float, deadline_s: float) -> RawFrame:
        what = self._script.pop(0)
        if isinstance(what, Exception):
            raise what
        return what


def frame(level: int = 9, **other) -> RawFrame:
    counts = np.full((HEIGHT_PX, WIDTH_PX), level, np.uint16)
    counts[0, 0] = 0
    return replace(RawFrame(counts, 0.01, 0.01, "2026-01-01T00:00:00+00:00"), **other)


@contextmanager
def checked(*script):
    settings = CameraSettings(driver="picamera2", address="0", width_px=WIDTH_PX, height_px=HEIGHT_PX, bit_depth=10)
    refused: list[str] = []
    yield TactileCamera(Scripted(*script), settings, True, refused.append), refused


def test_refused_frames_are_taken_again():
    with checked(BadFrameError("torn"), LostError("gone"), frame()) as (camera, refused):
        assert camera.expose(0.01)[1] == 3
    assert refused == ["0.01 s, attempt 1: torn", "0.01 s, attempt 2: gone"]


def test_four_refused_frames_end_the_capture():
    with (
        checked(*[BadFrameError("torn")] * 4) as (camera, _),
        pytest.raises(BadFrameError, match=r"torn \(4 attempts\)"),
    ):
        camera.expose(0.01)


@pytest.mark.parametrize(
    "same", [{}, {"frame_id": 7}, {"device_time_s": 1.5}], ids=["payload", "frame number", "device time"]
)
def test_same_frame_twice_is_refused(same):
    with checked(frame(**same), frame(**same), frame(10, frame_id=8)) as (camera, refused):
        camera.expose(0.01)
        assert camera.expose(0.01)[1] == 2
    assert "the same frame twice" in refused[0]


@pytest.mark.parametrize(
    ("delivered", "message"),
    [
        (frame(exposure_s=0.02), r"0\.01 s were asked for, it reads back 0\.02 s"),
        (frame(counts=np.zeros((10, 10), np.uint16)), "delivered a frame of 10 x 10, the rig file says 64 x 96"),
        (frame(settings={"pixel_format": "Mono16"}), "delivers Mono16, and a tactile capture needs colours"),
        (frame(1024), r"a count of 1024 DN.*bit_depth = 10 allows \(1023 DN\)"),
    ],
    ids=["exposure", "size", "no colours", "bits"],
)
def test_frame_that_is_not_as_asked_is_refused(delivered, message):
    with checked(delivered) as (camera, _), pytest.raises(RefusedError, match=message):
        camera.expose(0.01)


def test_poses_of_a_stage_are_read(tmp_path):
    text = PLAN[: PLAN.index("[[presses]]")].replace("exposures_s", 'poses_csv = "poses.csv"\nexposures_s')
    (tmp_path / "poses.csv").write_text(
        "position_mm,depth_mm,position_uncertainty_mm,depth_uncertainty_mm,tilt_uncertainty_deg\n"
        "35.02,0.998,0.01,0.005,\n40.01,1.501,0.01,0.005,0.2\n",
        encoding="utf-8",
    )
    first, second = planned_presses(plan_of(tmp_path, text), tmp_path)
    assert (first.depth_mm, first.position_mm, first.tilt_uncertainty_deg) == (0.998, 35.02, None)
    assert second.tilt_uncertainty_deg == 0.2


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (None, "no such file"),
        ("depth_mm\n", "holds 0 poses"),
        ("depth_mm,position_mm\n1\n", "line 2: has another number of columns"),
        ("depth_mm,position_mm\n1,2,3\n", "line 2: has another number of columns"),
        ("depth_mm,position_mm\n1,2\n", "line 2: 'depth_uncertainty_mm': is missing"),
        ("depth_mm,height_mm\n1,2\n", "'height_mm': unknown key"),
        ('depth_mm\n"1\n', "cannot be read as CSV"),
    ],
    ids=["missing", "empty", "short", "long", "incomplete", "unknown", "torn"],
)
def test_bad_poses_are_refused(tmp_path, content, message):
    text = PLAN[: PLAN.index("[[presses]]")].replace("exposures_s", 'poses_csv = "poses.csv"\nexposures_s')
    if content is not None:
        (tmp_path / "poses.csv").write_text(content, encoding="utf-8")
    with pytest.raises(RecordError, match=message):
        planned_presses(plan_of(tmp_path, text), tmp_path)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("[[presses]]", "[[pressings]]", "'pressings': unknown key; did you mean 'presses'"),
        ("exposures_s = [0.01]", "", "needs either exposures_s or bracket_powers"),
        ("[0.01]", "[0.01, 0.01]", "an exposure is listed twice"),
        ("exposures_s = [0.01]", "bracket_powers = [9, 4]", "the first must not exceed the last"),
        ("exposures_s", 'poses_csv = "p.csv"\nexposures_s', r"needs either \[\[presses\]\] tables or poses_csv"),
        ("led_current_ma = 20.0\n", "", "'led_current_ma': is missing"),
        ("led_current_ma = 20.0", "led_current_ma = -1", "in mA"),
    ],
)
def test_senseless_plan_is_refused(tmp_path, old, new, message):
    with pytest.raises(RecordError, match=message):
        plan_of(tmp_path, PLAN.replace(old, new))


@pytest.mark.parametrize(
    ("board", "message"),
    [({"marker_mm": 3.0}, "must be smaller than square_mm"), ({"dictionary": "DICT_4X5_50"}, "pattern")],
)
def test_senseless_board_is_refused(board, message):
    plan = tomllib.loads(PLAN)
    plan["board"] = {"squares": [7, 5], "square_mm": 3.0, "marker_mm": 2.0, "dictionary": "DICT_4X4_50"} | board
    with pytest.raises(ValidationError, match=message):
        TactilePlan.model_validate(plan)


def test_rig_of_the_simulated_bench_is_refused(tmp_path):
    with pytest.raises(RecordError, match="the simulated bench holds no finger"):
        rig_of(tmp_path, 'name = "bench"\n[camera]\n')


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("[0.01]", "[40.0]", r"exposures_s: 40 s is out of range; the rig allows 0\.0001 to 30 s"),
        ("exposures_s = [0.01]", "bracket_powers = [0, 5]", r"none of its exposures is within 0\.0001 to 30 s"),
    ],
)
def test_exposures_out_of_range_are_refused(tmp_path, old, new, message):
    with pytest.raises(CaptureError, match=message):
        tactile_shots(plan_of(tmp_path, PLAN.replace(old, new)), rig_of(tmp_path).camera, 2)


def test_captures_of_an_earlier_version_are_read(sensor, tmp_path):
    capture(tmp_path, plan_of(tmp_path), rig_of(tmp_path), pressing(sensor))
    path = tmp_path / "out" / "press-001.json"
    stored = json.loads(path.read_text(encoding="utf-8"))
    for new in ("led_current_ma", "light_angle_uncertainty_deg", "exposure_bracket_s"):
        del stored["record"][new]
    for new in ("tilt_deg", "depth_uncertainty_mm", "position_uncertainty_mm", "tilt_uncertainty_deg"):
        del stored["record"]["indenter"][new]
    path.write_text(json.dumps(stored), encoding="utf-8")
    read = read_record(path, TactileCapture)
    assert read.led_current_ma is None
    assert read.indenter.depth_uncertainty_mm is None


def test_printed_plan_and_rigs_are_valid(tmp_path):
    blocks = {
        name: re.findall(r"^```toml\n(.*?)^```", (HOW_TO / name).read_text(encoding="utf-8"), re.M | re.S)
        for name in ("capture-presses.md", "connect-a-raspberry-pi-camera.md")
    }
    (plan_text,) = [block for block in blocks["capture-presses.md"] if 'kind = "tactile"' in block]
    plan = plan_of(tmp_path, plan_text)
    rigs = [block for page in blocks.values() for block in page if "[camera]" in block]
    assert len(rigs) == 3
    for block in rigs:
        rig = rig_of(tmp_path, block)
        if rig.camera.driver != "mjpeg":
            shots = tactile_shots(plan, rig.camera, len(plan.presses))
            assert instruction(shots[0], plan, plan.presses)
