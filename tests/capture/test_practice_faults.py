"""Each fault to practise on is said by the command that its page names, not said without it, and mended by resuming."""

import contextlib
import os
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from data_schemas import (
    EXCHANGED_FILTERS,
    PRACTICE_FAULTS,
    CaptureSession,
    PracticeFault,
    SignalChangedError,
    practice_fault,
)
from data_schemas.storage import read_record, sha256_of
from rigs import open_rig, paint_plan, simulated_rig, write_plan, write_rig
from rigs.capture import (
    SessionRequest,
    capture_paint_session,
    read_frame_of,
    read_interrupted,
    read_journal,
    read_session,
    verify_session,
)
from rigs.live_view import LiveRig
from rigs.simulated import BenchFault, RigCondition, with_fault
from tests.architecture.test_conventions import ROOT
from tests.command_line.running import finray

PAGE = ROOT / "docs" / "reference" / "practice-faults.md"
ROW = re.compile(r"^\| `([a-z ]+)` \| (.+?) \((.+?)\) \| .+? \| `(\w+)` \| (.+?) \|$", flags=re.MULTILINE)
ROWS = ROW.findall(PAGE.read_text(encoding="utf-8"))
SAID = [(name, command, text.strip("`")) for name, _, _, command, text in ROWS if command != "live"]
COMMANDS = {
    "check": "check run check.toml --rig rig.toml --out checked",
    "capture": "capture plan.toml --rig rig.toml --out session",
    "like": "capture plan.toml --rig rig.toml --like ../good/session --out session",
}
SMALL = simulated_rig("red", width_px=160, height_px=128)


def with_fault_named(text: str | None):
    assert SMALL.simulated is not None
    return SMALL.model_copy(update={"simulated": SMALL.simulated.model_copy(update={"practice_fault": text})})


def lay_out_folder(folder: Path, fault: str | None) -> None:
    folder.mkdir(exist_ok=True)
    for name in ("rig.toml", "plan.toml"):
        (folder / name).unlink(missing_ok=True)
    region = paint_plan("red", SMALL.camera).region
    write_rig(with_fault_named(fault), folder / "rig.toml")
    write_plan(paint_plan("red", SMALL.camera), folder / "plan.toml")
    places = "".join(f"{name} = {value}\n" for name, value in region.model_dump().items())
    head = 'kind = "check"\ncheck_name = "practice"\nwheel_moves = 5\nrevisits = 4\n'
    (folder / "check.toml").write_text(f"{head}\n[region]\n{places}", encoding="utf-8")


def said_in(folder: Path, command: str) -> str:
    """Return what a command says, its spaces made one."""
    before = Path.cwd()
    os.chdir(folder)
    try:
        if command == "radiometry":
            assert finray(COMMANDS["capture"]).status == 0
        outcome = finray(COMMANDS.get(command, f"{command} session"))
    finally:
        os.chdir(before)
    return " ".join((outcome.out + outcome.err).split())


@pytest.fixture(scope="module")
def good(tmp_path_factory) -> dict[str, str]:
    """What each command says without a fault; its session is what others are compared with."""
    base = tmp_path_factory.mktemp("practice")
    lay_out_folder(base / "good", None)
    capture = said_in(base / "good", "capture")
    said = {"base": str(base), "capture": capture, "check": said_in(base / "good", "check")}
    with contextlib.chdir(base / "good"):
        said["radiometry"] = " ".join(finray("radiometry session").out.split())
    lay_out_folder(base / "alike", None)
    return said | {"like": said_in(base / "alike", "like")}


@pytest.fixture(autouse=True)
def _back(monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)


def test_the_page_lists_every_fault_with_its_sizes():
    sizes = {name: (usual, allowed) for name, usual, allowed, _, _ in ROWS}
    assert set(sizes) == {*PRACTICE_FAULTS, EXCHANGED_FILTERS}
    for name, (unit, usual, least, most) in PRACTICE_FAULTS.items():
        assert sizes[name] == (f"{usual:g} {unit}", f"{least:g} to {most:g}")
        assert practice_fault(name) == practice_fault(f"{name}, {usual:g} {unit}") == PracticeFault(name, usual)
    assert practice_fault(EXCHANGED_FILTERS).pair == tuple(sizes[EXCHANGED_FILTERS][0].split(" and "))


@pytest.mark.parametrize(("fault", "command", "text"), SAID, ids=lambda value: str(value)[:30])
def test_what_the_page_says_is_said_and_not_without_the_fault(good, fault, command, text):
    folder = Path(good["base"]) / f"{fault} {command}"
    lay_out_folder(folder, fault)
    assert text not in good[command]
    assert text in said_in(folder, command)


@pytest.mark.parametrize("fault", [None, "focus shift"])
def test_the_focus_of_the_live_view_falls_with_a_focus_shift_only(fault):
    """The region crosses the tile's edge; the rig's clock runs through a whole period of the fault."""
    rig = with_fault_named(fault)
    shares = []
    with open_rig(rig, Path()) as opened:
        live = LiveRig(opened, rig)
        live.start()
        live.ask({"region": [16, 48, 64, 64]})
        live.ask({"lamp": True})
        live.ask({"filter": "600"})
        live.ask({"exposure_s": 0.0016})
        number = 0
        while opened.clock.monotonic_s() < 11.0:
            opened.camera.state.clock.elapsed_s += 0.25
            _, numbers = live.latest(number)
            number = numbers.number
            is_seen = numbers.best_focus > 0 and numbers.lamp and numbers.filter_name == "600"
            shares += [numbers.focus / numbers.best_focus] if is_seen else []
        live.stop()
        assert live.ended(10.0)
    assert len(shares) > 20
    assert (min(shares) < 0.5) == (fault is not None)


@pytest.mark.parametrize("fault", ["exchanged filters", "unplugged camera", "drifting laser", "slipping wheel"])
def test_a_session_is_resumed_when_the_line_is_taken_away(tmp_path, fault):
    lay_out_folder(tmp_path / "mended", fault)
    said_in(tmp_path / "mended", "capture")
    os.chdir(tmp_path / "mended")
    if fault == "exchanged filters":
        assert finray("capture --resume session").status == 2  # as long as it is there
    rig = Path("rig.toml")
    lines = rig.read_text(encoding="utf-8").splitlines(keepends=True)
    rig.write_text("".join(line for line in lines if not line.startswith("practice_fault")), encoding="utf-8")
    os.chdir(tmp_path)  # the rig file is found wherever the session is resumed
    outcome = finray("capture --resume mended/session")
    assert outcome.status == 0, outcome.err
    assert verify_session(Path("mended/session")).faults == ()
    session = read_record(Path("mended/session/session.json"), CaptureSession)
    assert session.rig.simulated.practice_fault == fault  # what happened is not forgotten
    assert session.filter_proof.verdict == "confirmed"
    assert session.provenance.input_sha256["rig.toml"] == sha256_of(Path("mended/rig.toml"))  # as it is now


def rates(folder: Path, session: CaptureSession) -> dict[tuple[str, str | None, float], float]:
    """Return mean counts above the black level per second of every lit frame, by its type, filter and exposure."""
    return {
        (frame.frame_type, frame.filter_name, frame.exposure_requested_s): float(
            (read_frame_of(folder, frame).mean() - SMALL.camera.black_level_dn) / frame.exposure_s
        )
        for frame in session.frames
        if frame.light in ("lamp", "laser")
    }


@pytest.mark.parametrize("where", ["by resuming", "within the session"])
@pytest.mark.parametrize("fault", ["slipping wheel", "drifting laser"])
def test_a_session_that_was_metered_under_a_fault_is_metered_again_after_the_repair(good, tmp_path, fault, where):
    """No frame of the finished session is off by what the fault takes, against a session without a fault."""
    lay_out_folder(tmp_path, fault)

    def mend(text: str) -> bool:
        assert "at metering" in text
        lay_out_folder(tmp_path, None)
        return where == "within the session"

    rig, plan = with_fault_named(fault), paint_plan("red", SMALL.camera)
    sources = {name: sha256_of(tmp_path / name) for name in ("plan.toml", "rig.toml")}
    request = SessionRequest(tmp_path / "session", "finray capture", rig_folder=tmp_path, sources=sources)
    if where == "by resuming":
        with pytest.raises(SignalChangedError, match="correct the cause, then continue or resume"):
            capture_paint_session(rig, plan, request, mend=mend)
        left = read_interrupted(request.out)
        assert left.doubt
        session = capture_paint_session(rig, plan, replace(request, sources={}), interrupted=left)
    else:
        session = capture_paint_session(rig, plan, request, mend=mend)
    lines = read_journal(request.out)
    (aside,) = [line for line in lines if line["event"] == "set aside"]
    assert aside["frames"] == len(list(request.out.glob("set-aside/*"))) > 0
    # the rig without devices repeats its noise, and its clock, which runs ahead, a millisecond: not both in one frame
    assert {(frame.captured_utc, frame.sha256) for frame in session.frames}.isdisjoint(
        (line["captured_utc"], line["sha256"]) for line in lines[: lines.index(aside)] if line["event"] == "frame"
    )
    assert any("set aside and taken again" in note for note in session.notes)
    assert verify_session(request.out).faults == ()
    clean_folder = Path(good["base"]) / "good" / "session"
    clean = rates(clean_folder, read_session(clean_folder))
    found = rates(request.out, session)
    shared = clean.keys() & found.keys()
    assert len(shared) > 30
    assert all(found[key] == pytest.approx(clean[key], rel=0.1, abs=5.0 / key[2]) for key in shared)  # 5 DN of a frame


def test_a_repair_that_is_interrupted_is_proven_again(tmp_path):
    """A second fault stops the metering after the repair: what it metered until then counts for nothing."""
    lay_out_folder(tmp_path, "slipping wheel")
    os.chdir(tmp_path)
    assert finray(COMMANDS["capture"]).status == 2
    before = read_interrupted(Path("session"))
    lay_out_folder(tmp_path, "unplugged camera, 20 frames")
    assert "cannot be found" in finray("capture --resume session").err
    after = read_interrupted(Path("session"))
    assert (after.metered, after.frames, after.doubt) == (before.metered, before.frames, before.doubt)
    lay_out_folder(tmp_path, None)
    outcome = finray("capture --resume session")
    assert outcome.status == 0, outcome.err
    assert "all steps are metered again" in outcome.out
    assert verify_session(Path("session")).faults == ()


def test_the_fault_stands_in_the_notes_of_a_session(tmp_path):
    lay_out_folder(tmp_path / "noted", "stray light, 0.5 DN/s")
    assert "fault to practise on: stray light, 0.5 DN/s" in said_in(tmp_path / "noted", "capture")
    journal = read_journal(tmp_path / "noted" / "session")
    assert any("fault to practise on" in line.get("text", "") for line in journal if line["event"] == "note")


@pytest.mark.parametrize(
    ("text", "why"),
    [("sliping wheel", "did you mean 'slipping wheel'"), ("", "is not a practice fault; .*names are slipping wheel"),
     ("dirty filter, 30", "a number from 0.1 to 90, a space and the unit, such as 'dirty filter, 30 %'"),
     ("dirty filter, 95 %", "from 0.1 to 90"), ("lamp ageing, nan K", "from 1 to 500"),
     ("stray light, 10 %", "such as 'stray light, 10 DN/s'"), ("exchanged filters, 500", "names of two different"),
     ("exchanged filters, 500 and 500", "needs the names of two different filters"),
     ("exchanged filters, 500 and 610", "no filter is named '610'; valid names are 405, 450")],
)  # fmt: skip
def test_a_line_that_names_no_fault_is_refused_with_what_is_allowed(tmp_path, text, why):
    lay_out_folder(tmp_path / "bad", None)
    rig = tmp_path / "bad" / "rig.toml"
    written = rig.read_text(encoding="utf-8").replace('# practice_fault = "stray light"', f'practice_fault = "{text}"')
    rig.write_text(written, encoding="utf-8")
    outcome = finray(f"rig show {rig}")
    assert outcome.status == 2
    assert re.search(f"rig.toml: .*practice_fault.*{why}", " ".join(outcome.err.split()))


def test_what_a_condition_does_to_the_light():
    """Closed forms: a filter's share, Planck's law against 560 nm, the emitted part, and a blur that keeps the sum."""
    fresh, emitted = np.full((8, 8), 100.0), np.full((8, 8), 40.0)
    dirty = with_fault(RigCondition(), practice_fault("dirty filter, 25 %"), 8, 5)
    assert dirty.seen(fresh, emitted, "lamp", (5, 600.0), 2856.0) == pytest.approx(75.0)
    assert dirty.seen(fresh, emitted, "lamp", (4, 560.0), 2856.0) == pytest.approx(100.0)
    colder = with_fault(RigCondition(), practice_fault("lamp ageing, 200 K"), 8)
    x = 1.438776877e7 / 405.0 * (1 / 2656.0 - 1 / 2856.0) - 1.438776877e7 / 560.0 * (1 / 2656.0 - 1 / 2856.0)
    assert colder.seen(fresh, emitted, "lamp", (0, 405.0), 2856.0) == pytest.approx(100.0 * np.exp(-x), rel=1e-3)
    assert colder.seen(fresh, emitted, "laser", (0, 405.0), 2856.0) == pytest.approx(100.0)
    bleached = with_fault(RigCondition(), practice_fault("bleaching paint, 50 %"), 8, share=0.5)
    assert bleached.seen(fresh, emitted, "laser", (5, 600.0), 2856.0) == pytest.approx(90.0)
    point = np.zeros((64, 64))
    point[32, 32] = 1.0
    blurred = with_fault(RigCondition(), practice_fault("focus shift, 2 px"), 8).seen(
        point, point, "lamp", None, 2856.0
    )
    assert blurred.sum() == pytest.approx(1.0)
    rows = np.arange(32) - 16
    assert (blurred[0::2, 0::2].sum(axis=1) * rows**2).sum() == pytest.approx(4.0, rel=0.01)  # sigma squared


def test_one_message_of_twenty_is_lost_at_five_per_cent():
    fault = BenchFault(practice_fault("lost message"), SMALL.filter_wheel.filters, 2856.0, 6.5)
    lost = 0
    for _ in range(100):
        try:
            fault.require_heard()
        except Exception:
            lost += 1
    assert lost == 5
