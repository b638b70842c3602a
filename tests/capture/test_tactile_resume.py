"""Tactile sessions that were interrupted, and go on."""

import io
import sys
from pathlib import Path

import numpy as np
import pytest

from data_schemas import CaptureError, SignalChangedError, TactileCapture, TactileSession
from data_schemas.storage import read_frame, read_record
from rigs.capture import SessionRequest, capture_tactile_session, is_tactile, read_interrupted_presses
from tests.capture.drivers import picamera2_stand_in
from tests.capture.finger_session import PLAN, RIG, Hands, capture, plan_of, pressing, rig_of
from tests.command_line.running import finray


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
        interrupted.rig,
        interrupted.plan,
        interrupted.presses,
        SessionRequest(out, "pytest", rig_folder=interrupted.rig_folder, operator=asked),
        interrupted=interrupted,
    )
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
        interrupted.rig,
        interrupted.plan,
        interrupted.presses,
        SessionRequest(folder / "out", "pytest", rig_folder=folder, operator=hands),
        interrupted=interrupted,
    )


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


def test_what_is_taken_again_twice_is_set_aside_beside_the_first(sensor, tmp_path):
    """Also where a person has taken some of the files that were set aside away."""
    out = tmp_path / "out"

    def end_anew(content: bytes) -> None:
        for name in ("session.json", "manifest-sha256.txt"):
            (out / name).unlink(missing_ok=True)
        next((out / "frames").glob("00002_contact*")).write_bytes(content)

    capture(tmp_path, plan_of(tmp_path), rig_of(tmp_path), pressing(sensor))
    end_anew(b"first")
    resumed(tmp_path, pressing(sensor))
    aside = out / "set-aside"
    kept = next(aside.glob("*_contact*"))
    kept.rename(aside / kept.name.replace("0000_", "0001_"))
    for other in set(aside.iterdir()) - set(aside.glob("*_contact*")):
        other.unlink()
    end_anew(b"second")
    resumed(tmp_path, pressing(sensor))
    assert sorted(path.read_bytes() for path in aside.glob("*_contact*")) == [b"first", b"second"]


@pytest.mark.parametrize("is_older", [False, True])
def test_a_contact_before_a_changed_image_is_pressed_again(sensor, tmp_path, is_older):
    """At the first exposure of the bracket the pad is too dim for a comparison, so its image proves nothing."""
    plan = plan_of(tmp_path, PLAN.replace("[0.01]", "[0.0005, 0.01]"))
    rig = rig_of(tmp_path, RIG + "black_level_dn = 64.0\n")
    usual = pressing(sensor)

    def dim(text: str) -> None:
        usual.do(text)
        if text.startswith(("Press 2", "Take")) and "Press 2" in "".join(hands.asked):
            bright = sensor.scene
            sensor.scene = lambda exposure_s: 64 + 0.5 * (bright(exposure_s) - 64)

    hands = Hands(dim)
    with pytest.raises(SignalChangedError, match="the contact before this image is repeated"):
        capture(tmp_path, plan, rig, hands)
    if is_older:
        journal = tmp_path / "out" / "journal.jsonl"
        journal.write_text(journal.read_text(encoding="utf-8").replace(', "place": 2, "link"', ', "link"'), "utf-8")
    asked = pressing(sensor)
    session = resumed(tmp_path, asked)
    assert [text.split(":")[0] for text in asked.asked] == ["Press 2 of 2", "Take the indenter away from the pad."]
    means = [
        read_frame(tmp_path / "out" / frame.file, frame.sha256).mean()
        for frame in session.frames
        if (frame.frame_type, frame.exposure_requested_s) == ("contact", 0.01)
    ]
    assert means[0] == pytest.approx(means[1], rel=0.01)  # noise of 1 DN a pixel moves a mean by far less


def test_session_does_not_go_on_with_another_camera(sensor, tmp_path, monkeypatch):
    with pytest.raises(KeyboardInterrupt):
        capture(tmp_path, plan_of(tmp_path), rig_of(tmp_path), Hands(interrupt_at_press_2))
    monkeypatch.setattr(picamera2_stand_in.Picamera2, "camera_properties", {"Model": "imx708"})
    with pytest.raises(CaptureError, match=r"imx708 .* is connected now, but the session began with .*imx219"):
        resumed(tmp_path, Hands())


def test_session_that_went_on_elsewhere_is_left_alone(sensor, tmp_path):
    with pytest.raises(KeyboardInterrupt):
        capture(tmp_path, plan_of(tmp_path), rig_of(tmp_path), Hands(interrupt_at_press_2))
    interrupted, out = read_interrupted_presses(tmp_path / "out"), tmp_path / "out"
    (out / "frames" / "00005_new.tiff").write_bytes(b"being written")
    with (out / "journal.jsonl").open("a", encoding="utf-8") as journal:
        journal.write('{"event": "resume", "frames": 5}\n')
    with pytest.raises(CaptureError, match="another capture has continued this session in the meantime"):
        capture_tactile_session(
            interrupted.rig,
            interrupted.plan,
            interrupted.presses,
            SessionRequest(out, "pytest", rig_folder=tmp_path),
            interrupted=interrupted,
        )
    assert (out / "frames" / "00005_new.tiff").exists()


def test_replay_is_not_resumed(sensor, tmp_path):
    with pytest.raises(KeyboardInterrupt):
        capture(tmp_path, plan_of(tmp_path), rig_of(tmp_path), Hands(interrupt_at_press_2))
    journal = tmp_path / "out" / "journal.jsonl"
    text = journal.read_text(encoding="utf-8").replace('"driver": "picamera2"', '"driver": "folder"')
    journal.write_text(text, encoding="utf-8")
    with pytest.raises(
        CaptureError,
        match="replays a folder of images, so it cannot be resumed, because a replay would begin again",
    ):
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
    assert "3 frames are stored and unchanged" in resumed.out
    assert "8 frames of 'finger 3, ball', 2 tactile captures" in resumed.out


@pytest.mark.parametrize("start", ["", '{"event": "start", "kind": "tactile"}', '{"event": "start", "kind": "paint"}'])
def test_journal_without_a_start_is_refused(tmp_path, start):
    (tmp_path / "journal.jsonl").write_text(start + '\n{"event": "frame", "file": "no"}\n', encoding="utf-8")
    with pytest.raises(CaptureError, match="the line with which the session begins is missing or incomplete"):
        read_interrupted_presses(tmp_path)


@pytest.mark.parametrize(
    ("plan", "why"),
    [
        ('{"nonsense": 1}', "the plan in its first line does not fit this version"),
        ("3", "its first line does not describe a session that this version can resume"),
    ],
)
def test_journal_of_another_version_is_not_called_incomplete(tmp_path, plan, why):
    start = f'{{"event": "start", "kind": "tactile", "plan": {plan}, "rig": {{}}, "presses": [], "rig_folder": "."}}'
    (tmp_path / "journal.jsonl").write_text(start + "\n", encoding="utf-8")
    with pytest.raises(CaptureError, match=why):
        read_interrupted_presses(tmp_path)
