"""Tactile sessions: over MJPEG, from replayed Raspberry Pi raw files, and through the picamera2 stand-in."""

import io
import json
import re
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from data_schemas import (
    CaptureError,
    RefusedError,
    SimulatedPress,
    TactileCapture,
    TactileRig,
    TactileSession,
    provenance,
)
from data_schemas.storage import read_frame, read_record, write_record
from finray_calib.compare import compare_press
from finray_calib.sensing import rgb_image
from rigs.capture import read_journal
from tests.capture.drivers.test_mjpeg import ffmpeg_server, jpeg, serving, stream_of
from tests.capture.finger_session import HEIGHT_PX, PLAN, RIG, WIDTH_PX, Hands, capture, plan_of, pressing, rig_of
from tests.command_line.running import finray
from tests.exchange.test_raspberry_pi_folder import write_dng


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
    assert "contact 1: 26.3 % of an image is clipped even at the shortest exposure" in session.notes[0]


def test_board_comes_first_and_presses_are_repeated(sensor, tmp_path):
    text = PLAN.replace("exposures_s", "repeats = 2\nexposures_s")
    board = '[board]\nsquares = [7, 5]\nsquare_mm = 3.0\nmarker_mm = 2.2\ndictionary = "DICT_4X4_50"\nimages = 3\n'
    plan, hands = plan_of(tmp_path, text + board), pressing(sensor)
    session = capture(tmp_path, plan, rig_of(tmp_path), hands)
    assert hands.asked[2].startswith("Hold the ChArUco board still and in view (place 3 of 3)")
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
    stated, _, stored_line = outcome.out.partition("\n")
    assert stated.startswith(
        "this takes about 0.0 min plus the time for what you do by hand, and at most "
        "1 min plus the time for what you do by hand. "
    )
    assert stored_line == f"{out}: 8 frames of 'finger 3, ball', 2 tactile captures\n"
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
        pytest.raises(RefusedError, match=r"does not report its exposure time.*give only one exposure"),
    ):
        capture(tmp_path, plan, mjpeg_rig(tmp_path, address, 320, 240), Hands())


def test_dry_run_lists_and_opens_nothing(sensor, tmp_path):
    plan_of(tmp_path)
    rig_of(tmp_path)
    outcome = finray(f"capture {tmp_path}/tactile.toml --rig {tmp_path}/rig.toml --dry-run")
    assert "2 presses, 1 times each; 8 frames, 0 MB at most\n5 steps to be done by hand" in outcome.out
    assert sensor.log == []


def test_like_is_refused(tmp_path):
    plan_of(tmp_path)
    rig_of(tmp_path)
    outcome = finray(f"capture {tmp_path}/tactile.toml --rig {tmp_path}/rig.toml --like {tmp_path}")
    assert outcome.status == 2
    assert "--like is supported only for plans of kind 'paint'" in outcome.err


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

    monkeypatch.setattr("rigs.capture._tactile_session.write_frame", full)
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


def test_captures_of_an_earlier_version_are_read(sensor, tmp_path):
    capture(tmp_path, plan_of(tmp_path), rig_of(tmp_path), pressing(sensor))
    path = tmp_path / "out" / "press-001.json"
    stored = json.loads(path.read_text(encoding="utf-8"))
    for new in ("led_current_ma", "light_angle_uncertainty_deg", "exposure_bracket_s"):
        del stored["record"][new]
    for new in ("tilt_deg", "depth_uncertainty_mm", "position_uncertainty_mm", "tilt_uncertainty_deg"):
        del stored["record"]["indenter"][new]
    del stored["content_sha256"]
    stored["schema_version"] = 1
    path.write_text(json.dumps(stored), encoding="utf-8")
    read = read_record(path, TactileCapture)
    assert read.led_current_ma is None
    assert read.indenter.depth_uncertainty_mm is None
