"""A capture that is killed at any moment leaves no torn file, and resuming it gives the whole session."""

import json
import os
import random
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from data_schemas import CaptureError, CaptureSession, Frame, PaintPlan, RigFile
from data_schemas.storage import sha256_of
from rigs import open_rig
from rigs.capture import (
    SessionRequest,
    capture_paint_session,
    paint_steps,
    read_frame_of,
    read_interrupted,
    read_session,
)
from rigs.capture._paint_session import capture_with
from rigs.capture._resume import ORPHANS, set_aside
from rigs.simulated import SimulatedLight

KILLS = 25
CHILD = """
import sys, time
from pathlib import Path
from data_schemas._capture import PaintPlan
from data_schemas._rig import RigFile
from rigs.capture._paint_session import capture_paint_session
from rigs.capture._resume import read_interrupted
from rigs.capture._session_folder import SessionRequest
plan, rig = PaintPlan.model_validate_json(sys.argv[1]), RigFile.model_validate_json(sys.argv[2])
out = Path(sys.argv[3])
interrupted = read_interrupted(out) if (out / "journal.jsonl").exists() else None
print("go", flush=True)
capture_paint_session(rig, plan, SessionRequest(out, "finray capture"), interrupted=interrupted)
"""


@pytest.fixture(scope="module")
def small(plan: PaintPlan) -> PaintPlan:
    return plan.model_copy(update={"filters": ("450", "532", "600"), "bracket": (1.0, 0.25), "darks_per_exposure": 1})


def what_was_taken(session: CaptureSession) -> list[tuple[object, ...]]:
    """What makes two sessions the same: everything that chance and time do not touch."""
    return [(f.sequence, f.file, f.frame_type, f.light, f.target, f.filter_name, f.exposure_s) for f in session.frames]


@pytest.fixture(scope="module")
def uninterrupted(rig: RigFile, small: PaintPlan, tmp_path_factory: pytest.TempPathFactory) -> CaptureSession:
    return capture_paint_session(rig, small, SessionRequest(tmp_path_factory.mktemp("whole") / "out", "finray capture"))


@pytest.mark.timeout(280)
def test_killed_at_any_moment_nothing_is_torn_and_resuming_completes(
    rig: RigFile, small: PaintPlan, uninterrupted: CaptureSession, tmp_path: Path
) -> None:
    """One session is killed and resumed again and again until it is done; then another, until 25 kills are reached."""
    chance, kills, sessions, folder = random.Random(5), 0, 0, tmp_path / "0"
    texts = (small.model_dump_json(), rig.model_dump_json())
    while kills < KILLS:
        child = subprocess.Popen([sys.executable, "-c", CHILD, *texts, str(folder)], stdout=subprocess.PIPE, text=True)
        assert child.stdout is not None
        assert child.stdout.readline() == "go\n"
        time.sleep(chance.uniform(0.0, 0.6))
        child.send_signal(signal.SIGKILL)
        child.wait()
        child.stdout.close()
        if not (folder / "session.json").exists():
            kills += 1
            for frame in stored_frames(folder):
                read_frame_of(folder, frame)  # raises when torn or changed
        else:
            sessions, folder = sessions + 1, tmp_path / str(sessions + 1)
    if not (folder / "session.json").exists():
        interrupted = read_interrupted(folder) if (folder / "journal.jsonl").exists() else None
        capture_paint_session(rig, small, SessionRequest(folder, "finray capture"), interrupted=interrupted)
    for done in sorted(tmp_path.iterdir()):
        session = read_session(done)
        assert what_was_taken(session) == what_was_taken(uninterrupted)
        doses = [f.laser_dose_j for f in session.frames]
        assert doses == sorted(doses)
        assert [f.middle_s for f in session.frames] == sorted(f.middle_s for f in session.frames)
        for frame in session.frames:
            read_frame_of(done, frame)
        assert not list(done.rglob("*.part"))


def stored_frames(folder: Path) -> list[Frame]:
    """Frames that the journal vouches for."""
    if not (folder / "journal.jsonl").exists():
        return []
    lines = (folder / "journal.jsonl").read_text().splitlines()
    frames = []
    for line in lines:
        try:
            entry = json.loads(line)
        except ValueError:
            continue
        if entry["event"] == "frame":
            frames.append(Frame.model_validate({k: v for k, v in entry.items() if k in Frame.model_fields}))
    return frames


@pytest.fixture
def stopped(rig: RigFile, small: PaintPlan, tmp_path: Path) -> Path:
    """A session that ended before its last frames."""
    return captured_in_part(rig, small, tmp_path / "stopped")


def captured_in_part(rig: RigFile, small: PaintPlan, out: Path, rig_folder: Path = Path()) -> Path:
    """Return a finished session without record, manifest and last lines."""
    with open_rig(rig, rig_folder) as opened:
        capture_with(opened, rig, small, paint_steps(small, rig), SessionRequest(out, "finray capture", rig_folder))
    for name in ("session.json", "manifest-sha256.txt"):
        (out / name).unlink()
    lines = (out / "journal.jsonl").read_text().splitlines(keepends=True)
    (out / "journal.jsonl").write_text("".join(lines[:-8]))
    return out


def resumed(rig: RigFile, plan: PaintPlan, out: Path) -> CaptureSession:
    return capture_paint_session(rig, plan, SessionRequest(out, "finray capture"), interrupted=read_interrupted(out))


def test_changed_missing_and_unknown_frames_are_taken_again(
    rig: RigFile, small: PaintPlan, uninterrupted: CaptureSession, stopped: Path
) -> None:
    known = sorted(frame.file for frame in stored_frames(stopped))
    changed, missing, kept = stopped / known[3], stopped / known[5], stopped / known[7]
    changed.write_bytes(changed.read_bytes()[:-1] + b"x")
    missing.unlink()
    before = sha256_of(kept)
    (stopped / "frames" / ".0099_half.tiff.12345678.part").write_bytes(b"torn")
    session = resumed(rig, small, stopped)
    assert what_was_taken(session) == what_was_taken(uninterrupted)
    assert sha256_of(kept) == before
    aside = sorted(path.name for path in (stopped / ORPHANS).iterdir())
    assert any(name.endswith("part") for name in aside)
    assert any(name.endswith(changed.name) for name in aside)
    assert any("interrupted after" in note for note in session.notes)
    assert read_session(stopped).frames == session.frames


def test_every_interruption_is_noted(rig: RigFile, small: PaintPlan, stopped: Path) -> None:
    with (stopped / "journal.jsonl").open("a") as journal:
        journal.write('{"event": "resume", "frames": 1, "utc": "2026-11-20T10:00:00+00:00", "monotonic_s": 1e4}\n')
    count = len(read_interrupted(stopped).frames)
    (note,) = [note for note in resumed(rig, small, stopped).notes if "interrupted" in note]
    assert note.startswith(f"interrupted after 1, {count} frames and resumed")


def test_line_cut_short_is_passed_over(rig: RigFile, small: PaintPlan, stopped: Path) -> None:
    with (stopped / "journal.jsonl").open("a") as journal:
        journal.write('{"event": "fra')
    assert len(resumed(rig, small, stopped).frames) > 0
    lines = (stopped / "journal.jsonl").read_text().splitlines()
    assert sum(line.startswith('{"event": "fra') and not line.endswith("}") for line in lines) == 1


def test_finished_session_is_not_resumed(rig: RigFile, small: PaintPlan, stopped: Path) -> None:
    resumed(rig, small, stopped)
    with pytest.raises(CaptureError, match=r"is finished already .* nothing is left to resume"):
        read_interrupted(stopped)


def test_folder_without_a_beginning_is_refused(tmp_path: Path) -> None:
    with pytest.raises(
        CaptureError, match=r"contains no interrupted session \(journal\.jsonl is missing\); give the folder"
    ):
        read_interrupted(tmp_path)
    (tmp_path / "journal.jsonl").write_text('{"event": "start", "utc": "", "monotonic_s": 0}\n')
    with pytest.raises(
        CaptureError,
        match=r"the line with which the session begins is missing or incomplete; capture the session again",
    ):
        read_interrupted(tmp_path)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('"rates_dn_per_s": [', '"rates_dn_per_s": [1.0, '),
        ('"exposures_s": [', '"exposures_s": ["long", '),
        ('"label": ', '"lable": '),
    ],
)
def test_edited_journal_is_refused(stopped: Path, old: str, new: str) -> None:
    text = (stopped / "journal.jsonl").read_text()
    assert old in text
    (stopped / "journal.jsonl").write_text(text.replace(old, new, 1))
    with pytest.raises(
        CaptureError, match=r"journal\.jsonl: contains lines that finray did not write; restore the file"
    ):
        read_interrupted(stopped)


def test_session_of_another_version_is_refused(rig: RigFile, small: PaintPlan, stopped: Path) -> None:
    journal = stopped / "journal.jsonl"
    journal.write_text(journal.read_text().replace('"bracket"', '"brackets"', 1).replace('"lamp"', '"lamps"', 1))
    interrupted = read_interrupted(stopped)
    with pytest.raises(
        CaptureError,
        match=r"the plan in its first line does not fit this version "
        r".*'brackets'.*resume",
    ):
        interrupted.plan(PaintPlan)
    with pytest.raises(CaptureError, match=r"the rig in its first line does not fit this version .*'lamps'"):
        interrupted.rig()


def test_reading_touches_nothing_and_a_session_that_went_on_is_left_alone(
    rig: RigFile, small: PaintPlan, stopped: Path
) -> None:
    """A capture may be running in the folder: its part files are moved only when its journal is ours."""
    part = stopped / "frames" / ".0099_half.tiff.12345678.part"
    part.write_bytes(b"being written")
    early = read_interrupted(stopped)
    assert part.exists()
    resumed(rig, small, stopped)
    (stopped / "session.json").unlink()
    whole = sorted(path.name for path in (stopped / "frames").iterdir())
    with pytest.raises(CaptureError, match=r"another capture has continued this session in the meantime"):
        capture_paint_session(rig, small, SessionRequest(stopped, "finray capture"), interrupted=early)
    assert sorted(path.name for path in (stopped / "frames").iterdir()) == whole


def test_another_camera_is_refused(rig: RigFile, small: PaintPlan, stopped: Path) -> None:
    """Behind an IP address or a model's name another camera may answer after the interruption."""
    text = (stopped / "journal.jsonl").read_text()
    (stopped / "journal.jsonl").write_text(text.replace('"model": "simulated bench"', '"model": "another"', 1))
    before = sorted(stopped.rglob("*"))
    with pytest.raises(CaptureError, match=r"simulated bench .* is connected now, but the session began with another "):
        resumed(rig, small, stopped)
    assert sorted(stopped.rglob("*")) == before


def test_another_board_of_the_lamp_is_refused(
    rig: RigFile, small: PaintPlan, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its port's name may lead to the laser's board by now, which runs the same firmware."""
    said = {"serial": "L-1"}
    asked = SimulatedLight.identity
    monkeypatch.setattr(SimulatedLight, "identity", lambda light: asked(light).model_copy(update=said))
    out = captured_in_part(rig, small, tmp_path / "stopped")
    said["serial"] = "L-2"
    message = r"laser at .*'L-2' is connected now, .* began with 'L-1'; plug the boards in as before, or capture the"
    with pytest.raises(CaptureError, match=message):
        resumed(rig, small, out)
    said["serial"] = "L-1"
    assert resumed(rig, small, out).frames


def test_session_that_does_not_name_its_camera_goes_on(rig: RigFile, small: PaintPlan, stopped: Path) -> None:
    first, *others = (stopped / "journal.jsonl").read_text().splitlines(keepends=True)
    start = json.loads(first)
    del start["camera"]
    (stopped / "journal.jsonl").write_text(json.dumps(start) + "\n" + "".join(others))
    assert resumed(rig, small, stopped).frames


def test_changed_curve_file_is_refused(rig: RigFile, small: PaintPlan, stopped: Path) -> None:
    text = (stopped / "journal.jsonl").read_text()
    (stopped / "journal.jsonl").write_text(text.replace('"inputs": {}', '"inputs": {"red.csv": "00"}', 1))
    with pytest.raises(CaptureError, match=r"red\.csv: has changed since the session began"):
        resumed(rig, small, stopped)


def test_changed_lamp_spectrum_is_refused(rig: RigFile, small: PaintPlan, tmp_path: Path) -> None:
    """Its curve stands in the record of the session, for frames that were taken before it changed."""
    curve = tmp_path / "lamp.csv"
    curve.write_text("wavelength_nm,power_rel\n360,0.2\n560,1.0\n800,1.8\n")
    lit = rig.model_copy(update={"lamp": rig.lamp.model_copy(update={"spectrum": "lamp.csv"})})
    out = captured_in_part(lit, small, tmp_path / "stopped", tmp_path)
    before = curve.read_text()
    curve.write_text(before.replace("800,1.8", "800,0.9"))
    request = SessionRequest(out, "finray capture", tmp_path)
    with pytest.raises(CaptureError, match=r"lamp\.csv: has changed since the session began; restore the file"):
        capture_paint_session(lit, small, request, interrupted=read_interrupted(out))
    curve.write_text(before)
    # sessions of versions that did not note the lamp's spectrum go on
    journal = out / "journal.jsonl"
    journal.write_text(re.sub(r'"inputs": \{"lamp.csv": "\w+"\}', '"inputs": {}', journal.read_text(), count=1))
    session = capture_paint_session(lit, small, request, interrupted=read_interrupted(out))
    assert session.frames
    stored = read_session(out)
    assert stored.provenance is not None
    assert stored.provenance.input_sha256 == {"lamp.csv": sha256_of(curve)}


def test_files_of_the_same_name_are_set_aside_beside_each_other(tmp_path: Path) -> None:
    """Nothing is deleted, also where a person has taken some of those that were set aside away."""
    (tmp_path / "frames").mkdir()

    def set_aside_anew(content: str, *names: str) -> None:
        for name in names:
            (tmp_path / "frames" / name).write_text(content)
        set_aside(tmp_path, set())

    set_aside_anew("first", "0001_white.tiff", "0002_white.tiff")
    (tmp_path / ORPHANS / "0000_0001_white.tiff").unlink()
    set_aside_anew("second", "0002_white.tiff")
    assert sorted(path.read_text() for path in (tmp_path / ORPHANS).iterdir()) == ["first", "second"]


def test_second_capture_into_the_same_folder_is_refused(rig: RigFile, small: PaintPlan, stopped: Path) -> None:
    lock = "import fcntl,sys,time; f=open(sys.argv[1],'a'); fcntl.flock(f, fcntl.LOCK_EX); print('held', flush=True); "
    other = subprocess.Popen(
        [sys.executable, "-c", lock + "time.sleep(60)", str(stopped / "journal.jsonl")],
        stdout=subprocess.PIPE,
        text=True,
    )
    try:
        assert other.stdout is not None
        assert other.stdout.readline() == "held\n"
        with pytest.raises(CaptureError, match=r"another capture is writing into this folder"):
            resumed(rig, small, stopped)
    finally:
        other.kill()
        other.wait()
        if other.stdout is not None:
            other.stdout.close()


@pytest.mark.skipif(os.geteuid() != 0, reason="only root may mount a small disk")
def test_full_disk_ends_the_session_and_it_can_be_resumed(rig: RigFile, small: PaintPlan, tmp_path: Path) -> None:
    """A file system of 400 kB holds some of the 41 kB frames; the check beforehand is passed by pretending space."""
    disk = tmp_path / "disk"
    disk.mkdir()
    mounted = subprocess.run(["mount", "-t", "tmpfs", "-o", "size=400k", "none", str(disk)], capture_output=True)
    if mounted.returncode != 0:
        pytest.skip("this machine does not allow to mount a file system")
    try:
        with open_rig(rig, Path()) as opened, pytest.MonkeyPatch.context() as patch:
            with pytest.raises(CaptureError, match=r"the frames need .* MB, but only .* MB are free"):
                capture_with(
                    opened, rig, small, paint_steps(small, rig), SessionRequest(disk / "refused", "finray capture")
                )
            patch.setattr("rigs.capture._frame_store.require_space", lambda folder, needed_bytes: None)
            with pytest.raises(CaptureError, match=r"cannot be written \(No space left .*--resume"):
                capture_with(
                    opened, rig, small, paint_steps(small, rig), SessionRequest(disk / "out", "finray capture")
                )
            assert not opened.lamp.state()
            assert not opened.laser.state()
        subprocess.run(["mount", "-o", "remount,size=20m", str(disk)], check=True)
        assert len(resumed(rig, small, disk / "out").frames) > len(list((disk / "out" / ORPHANS).glob("*")))
    finally:
        subprocess.run(["umount", str(disk)], check=True)


def test_replayed_folder_is_not_resumed(stopped: Path) -> None:
    """The images of a folder come in their order: a resumed session would begin with the first again."""
    text = (stopped / "journal.jsonl").read_text()
    (stopped / "journal.jsonl").write_text(text.replace('"driver": "simulated"', '"driver": "folder"', 1))
    with pytest.raises(CaptureError, match=r"replays a folder of images"):
        read_interrupted(stopped)
