"""``finray capture``: dry run, interruption by signals, resuming, a session like an earlier one."""

import io
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from data_schemas import LampSettings, LaserSettings, RigFile
from data_schemas.storage import read_toml
from rigs import write_rig
from rigs.capture import read_session, verify_session
from rigs.simulated import SimulatedLight
from tests.capture.drivers import file_switch
from tests.capture.drivers.programs import free_port
from tests.capture.drivers.thorlabs_wheel import emulated_wheel
from tests.command_line.running import edit, finray, succeed


def mistake(arguments: str) -> str:
    """Run what must end as a user's mistake; return what it says."""
    outcome = finray(arguments)
    assert outcome.status == 2
    return outcome.err


def test_dry_run_tells_time_and_disk_and_stores_nothing(lab: Path, tmp_path: Path) -> None:
    said = succeed(f"capture {lab}/plan.toml --rig {lab}/rig.toml --out {tmp_path}/out --dry-run")
    assert "MB" in said
    assert "min" in said
    assert "nothing was moved, lit or stored" in said
    assert list(tmp_path.iterdir()) == []


def test_dry_run_needs_nobody(lab: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Wheel and lamp in a person's hand, and nobody there: what would be asked is said."""
    file_switch.install(monkeypatch)
    monkeypatch.setattr(sys, "stdin", io.StringIO(""))
    (tmp_path / "laser").mkdir()
    rig = real_rig(lab)
    laser = rig.laser.model_copy(update={"driver": "indi", "address": str(tmp_path / "laser"), "laser_class": "2"})
    update = {
        "camera": rig.camera.model_copy(update={"address": str(lab / "session")}),
        "filter_wheel": rig.filter_wheel.model_copy(update={"driver": "manual", "address": ""}),
        "laser": laser,
        "lamp": LampSettings(driver="manual"),
    }
    write_rig(rig.model_copy(update=update), tmp_path / "rig.toml")
    outcome = finray(f"capture {lab}/plan.toml --rig {tmp_path}/rig.toml --dry-run")
    assert (outcome.status, outcome.err) == (0, "")
    assert "you will be asked during the capture: Switch the lamp off.\n" in outcome.out
    assert "nothing was moved, lit or stored" in outcome.out


@pytest.mark.parametrize("how", ["--dry-run", ""])
def test_a_disk_that_is_too_small_is_told_before_anything_is_lit(
    lab: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, how: str
) -> None:
    def forbidden(*_: object) -> None:
        raise AssertionError("nothing may be lit")

    monkeypatch.setattr(SimulatedLight, "lit", forbidden)
    monkeypatch.setattr("rigs.capture._frame_store._free_bytes", lambda folder: 3_000_000)
    said = mistake(f"capture {lab}/plan.toml --rig {lab}/rig.toml --out {tmp_path}/new/out {how}")
    assert re.search(r"new/out: the frames need 5 to \d+ MB, but only 3 MB are free; free space or choose", said), said
    assert list(tmp_path.iterdir()) == []


def test_a_disk_that_may_be_too_small_is_no_reason_to_refuse(
    lab: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("rigs.capture._frame_store._free_bytes", lambda folder: 8_000_000)
    outcome = finray(f"capture {lab}/plan.toml --rig {lab}/rig.toml --out {tmp_path}/out --dry-run")
    assert outcome.status == 0
    assert "MB, but only 8 MB are free" in outcome.err
    monkeypatch.undo()
    assert finray(f"capture {lab}/plan.toml --rig {lab}/rig.toml --out {tmp_path}/out --dry-run").err == ""


@pytest.mark.parametrize("how", ["--dry-run", ""])
def test_a_black_level_above_the_target_is_refused_in_one_sentence(lab: Path, tmp_path: Path, how: str) -> None:
    rig = tmp_path / "rig.toml"
    rig.write_text((lab / "rig.toml").read_text())
    edit(rig, "black_level_dn = 16", "black_level_dn = 720")
    said = mistake(f"capture {lab}/plan.toml --rig {rig} --out {tmp_path}/out {how}")
    assert re.search(
        r"camera\.black_level_dn = 720 DN must be below target_fraction = 0\.7 of full scale \(1023 DN\)", said
    )
    assert said.count("\n") == 1
    assert not (tmp_path / "out").exists()


def everything(folder: Path) -> dict[str, bytes]:
    """Return the content of all files of a folder."""
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_a_record_that_was_lost_is_asked_for_and_can_be_written_anew(lab: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    shutil.copytree(lab / "session", out)
    (out / "session.json").unlink()
    before = everything(out)
    for command in (f"capture --resume {out}", f"radiometry {out} --out {tmp_path}/bands.json"):
        said = mistake(command)
        assert "was complete (manifest-sha256.txt is there), but session.json is missing; restore it" in said
        assert "continue with" not in said
        assert everything(out) == before
    (out / "manifest-sha256.txt").unlink()  # as the sentence says
    succeed(f"capture --resume {out}")
    assert not verify_session(out).faults
    rebuilt, first = read_session(out).frames, read_session(lab / "session").frames
    assert [frame.file for frame in rebuilt] == [frame.file for frame in first]
    # on a busy machine a dark frame was once not that of before, so frames with light alone are compared in all
    assert [f for f in rebuilt if f.frame_type != "dark"] == [f for f in first if f.frame_type != "dark"]


def test_resume_says_what_it_sets_aside(lab: Path, tmp_path: Path) -> None:
    """Of a session that ended after nine dark frames, before a frame in light showed how the camera exposed."""
    out = tmp_path / "out"
    shutil.copytree(lab / "session", out)
    for name in ("session.json", "manifest-sha256.txt"):
        (out / name).unlink()
    lines = (out / "journal.jsonl").read_text().splitlines(keepends=True)
    ends = [number for number, line in enumerate(lines, 1) if json.loads(line)["event"] == "frame"]
    (out / "journal.jsonl").write_text("".join(lines[: ends[8]]))
    kept = {json.loads(lines[end - 1])["file"] for end in ends[:9]}
    for path in (out / "frames").iterdir():
        if path.relative_to(out).as_posix() not in kept:
            path.unlink()
    said = succeed(f"capture --resume {out}")
    assert "0 frames are stored and unchanged\n  9 other files of frames/ set aside, in set-aside/" in said
    assert len(list((out / "set-aside").iterdir())) == 9


def test_a_session_that_was_moved_without_its_inputs_is_whole(
    lab: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made, moved = tmp_path / "made", tmp_path / "far" / "from" / "there" / "and" / "its" / "inputs"
    made.mkdir()
    for name in ("rig.toml", "plan.toml"):
        shutil.copy(lab / name, made)
    monkeypatch.chdir(made)
    succeed("capture plan.toml --rig rig.toml --out session")
    moved.mkdir(parents=True)
    monkeypatch.chdir(moved)
    shutil.copytree(made / "session", moved / "session")
    outcome = finray("verify session")
    assert outcome.status == 0, outcome.out
    for name in ("plan.toml", "rig.toml"):
        assert f"note: {name}: not found; session.json holds what was read from it" in outcome.out
    assert re.search(r"session: unchanged: \d+ files", outcome.out)
    assert finray("trace session/session.json").status == 1  # which asks for the files themselves
    shutil.copy(made / "rig.toml", moved)
    edit(moved / "rig.toml", "black_level_dn = 16", "black_level_dn = 17")
    changed = finray("verify session")
    assert changed.status == 1
    assert "changed: " in changed.out  # a file of that name that is another one is still told


@pytest.mark.rigs
def test_dry_run_moves_no_wheel(lab: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A move would set the target of lewis' FW212C, which is another than its slot."""
    file_switch.install(monkeypatch)
    rig, laser = real_rig(lab), {"driver": "indi", "address": str(tmp_path / "laser"), "laser_class": "2"}
    lamp = LampSettings(driver="indi", address=str(tmp_path / "lamp"))
    for name in ("laser", "lamp"):
        (tmp_path / name).mkdir()
    with emulated_wheel() as wheel:
        named = rig.filter_wheel.model_copy(update={"driver": "thorlabs", "address": wheel.address})
        update = {"filter_wheel": named, "laser": rig.laser.model_copy(update=laser), "lamp": lamp}
        camera = rig.camera.model_copy(update={"address": str(lab / "session")})
        write_rig(rig.model_copy(update={**update, "camera": camera}), tmp_path / "rig.toml")
        wheel.control.put(pos=4, target=9)
        said = succeed(f"capture {lab}/plan.toml --rig {tmp_path}/rig.toml --dry-run")
        assert "nothing was moved, lit or stored" in said
        assert (wheel.control.get("pos"), wheel.control.get("target")) == (4, 9)
    assert sorted(path.name for path in tmp_path.rglob("*")) == ["lamp", "laser", "rig.toml"]


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT, signal.SIGHUP])
def test_signal_ends_the_capture_cleanly_and_resume_finishes_it(lab: Path, tmp_path: Path, number: int) -> None:
    out = tmp_path / "out"
    run = [sys.executable, "-m", "finray_calib.cli.main", "capture", str(lab / "plan.toml")]
    process = subprocess.Popen(
        [*run, "--rig", str(lab / "rig.toml"), "--out", str(out)], stderr=subprocess.PIPE, text=True
    )
    end_s = time.monotonic() + 600
    while sum("_dark_" not in path.name for path in (out / "frames").glob("*.tiff")) < 5:
        assert time.monotonic() < end_s
        time.sleep(0.01)
    os.kill(process.pid, number)
    _, said = process.communicate(timeout=600)
    assert process.returncode == 130
    assert f"finray capture --resume {out}" in said
    assert '"outcome": "KeyboardInterrupt' in (out / "journal.jsonl").read_text().splitlines()[-1]
    before = {path.name: path.stat().st_mtime_ns for path in (out / "frames").iterdir()}
    kept = re.search(r"(\d+) frames are stored and unchanged", succeed(f"capture --resume {out}"))
    unchanged = [name for name, time_ns in before.items() if (out / "frames" / name).stat().st_mtime_ns == time_ns]
    assert kept is not None
    assert int(kept[1]) == len(unchanged) >= 5
    assert all("_dark_" in name for name in before if name not in unchanged)  # no lit frame had followed them
    assert len(read_session(out).frames) == len(read_session(lab / "session").frames)


def test_resume_takes_everything_from_the_session(lab: Path, tmp_path: Path) -> None:
    said = mistake(f"capture {lab}/plan.toml --rig {lab}/rig.toml --resume {tmp_path}")
    assert "leave out PLAN, --rig and --out" in said
    finished = mistake(f"capture --resume {lab}/session")
    assert "is finished already" in finished
    assert "continue with" not in finished
    assert "--resume and --dry-run cannot be combined" in mistake(f"capture --resume {tmp_path} --dry-run")
    assert "contains no interrupted session (journal.jsonl is missing)" in mistake(f"capture --resume {tmp_path}")
    assert "PLAN or --rig is missing; give both" in mistake(f"capture {lab}/plan.toml")


def test_session_that_lacks_its_checksums_only_gets_them(lab: Path, tmp_path: Path) -> None:
    """The capture was killed between ``session.json`` and the checksums of all files."""
    out = tmp_path / "out"
    shutil.copytree(lab / "session", out)
    whole = (out / "manifest-sha256.txt").read_text()
    (out / "manifest-sha256.txt").unlink()
    assert "was complete except for its checksums" in succeed(f"capture --resume {out}")
    assert (out / "manifest-sha256.txt").read_text() == whole
    assert "is finished already" in mistake(f"capture --resume {out}")


@pytest.mark.parametrize("lost_lines", [1, 2])
def test_session_whose_journal_lacks_only_its_end_gets_it(lab: Path, tmp_path: Path, lost_lines: int) -> None:
    """The capture was killed after ``session.json``, before the last or the last two lines of the journal."""
    out = tmp_path / "out"
    shutil.copytree(lab / "session", out)
    (out / "manifest-sha256.txt").unlink()
    lines = (out / "journal.jsonl").read_text().splitlines(keepends=True)
    (out / "journal.jsonl").write_text("".join(lines[:-lost_lines]))
    assert "was complete except for its checksums" in succeed(f"capture --resume {out}")
    assert verify_session(out).faults == ()


def test_session_like_an_earlier_one_says_so(lab: Path, tmp_path: Path) -> None:
    said = succeed(f"capture {lab}/plan.toml --rig {lab}/rig.toml --out {tmp_path}/out --like {lab}/session")
    assert "filters: confirmed: the white frames repeat those of the earlier session" in said


def real_rig(lab: Path) -> RigFile:
    """The rig of the lab with real devices, which nobody has switched on."""
    rig = read_toml(lab / "rig.toml", RigFile)
    laser = {"address": f"socket://127.0.0.1:{free_port()}", "power_mw": 4.5, "laser_class": "3R"}
    return RigFile(
        name="lab",
        camera=rig.camera.model_copy(update={"driver": "folder", "address": "images"}),
        filter_wheel=rig.filter_wheel.model_copy(update={"driver": "manual"}),
        laser=LaserSettings(driver="arduino", wavelength_nm=450.0, **laser),
        lamp=LampSettings(driver="manual"),
    )


def test_real_laser_needs_its_label_and_is_announced(lab: Path, tmp_path: Path) -> None:
    capture = f"capture {lab}/plan.toml --out {tmp_path}/out --rig"
    named, nameless = tmp_path / "named.toml", tmp_path / "nameless.toml"
    write_rig(real_rig(lab), named)
    lines = named.read_text().splitlines(keepends=True)
    nameless.write_text("".join(line for line in lines if not line.startswith(("power_mw", "laser_class"))))
    said = mistake(f"{capture} {nameless}")
    assert "laser_class, power_mw must be given for a real laser" in said
    said = mistake(f"{capture} {named}")
    assert "LASER 450 nm, 4.5 mW, class 3R: it will be switched on. Wear goggles for 450 nm, close the box" in said
    off = "all processes are killed: yes, by the dead-man in the light's controller, within 0.5 s"
    assert (
        said.index("LASER 450 nm") < said.index(off) < said.index("cannot be opened")
    )  # told before anything is tried


@pytest.mark.parametrize("more", ["", "--dry-run"])
def test_hazardous_laser_without_a_layer_outside_the_computer_is_refused(lab: Path, tmp_path: Path, more: str) -> None:
    rig, file = real_rig(lab), tmp_path / "rig.toml"
    panel = rig.laser.model_copy(update={"driver": "indi", "address": f"127.0.0.1:{free_port()}/Panel"})
    write_rig(rig.model_copy(update={"laser": panel}), file)
    said = mistake(f"capture {lab}/plan.toml --out {tmp_path}/out --rig {file} {more}")
    assert "a class 3R laser is switched on only if hardware outside the computer" in said
    assert "[laser.outside_layer]" in said
    assert not (tmp_path / "out").exists()
    weak = panel.model_copy(update={"laser_class": "2"})
    write_rig(rig.model_copy(update={"laser": weak}), tmp_path / "weak.toml")
    said = mistake(f"capture {lab}/plan.toml --out {tmp_path}/out --rig {tmp_path}/weak.toml")
    assert said.index("all processes are killed: NO, the light stays on") < said.index("nothing listens")
