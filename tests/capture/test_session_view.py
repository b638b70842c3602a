"""A session in the live view: that of `finray capture`, its questions, its light key, and views that come and go."""

import http.client
import json
import re
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections import Counter
from contextlib import contextmanager, nullcontext
from dataclasses import replace
from pathlib import Path

import pytest

from data_schemas import BadFrameError, CaptureError, LostError, PaintPlan, RigFile
from finray_calib.cli.main import main
from rigs import open_rig, paint_plan, simulated_rig, write_plan, write_rig
from rigs.capture import (
    SessionRequest,
    capture_paint_session,
    capture_tactile_session,
    read_frame_of,
    read_interrupted,
    read_journal,
    read_session,
    verify_session,
)
from rigs.capture import _paint_session as capturing
from rigs.capture._session_folder import watched_to_the_end
from rigs.light_guard import LightLostError
from rigs.live_view import WatchedSession, live_server
from rigs.live_view._live_server import BINS
from rigs.live_view._session_page import HELP, LETTERS, _SessionPage, large_letters, session_screen
from rigs.live_view._terminal_page import LEAST_COLUMNS, Screen
from rigs.live_view._watched_session import (
    DARK_WITHIN_S,
    REFERENCES,
    TARGET_HEADLINES,
    Drift,
    FilterCount,
    SessionNumbers,
)
from rigs.simulated import Bench, SimulatedCamera, SimulatedLight
from tests.architecture.test_conventions import ROOT
from tests.capture.drivers.programs import require
from tests.capture.finger_session import plan_of, rig_of, scene
from tests.capture.terminal_screen import Terminal

PATIENCE_S = 240.0
BUSY_S = 2.0
"""For a computer that is busy: a thread that is woken may wait so long for its turn."""


@pytest.fixture(scope="module")
def small() -> RigFile:
    return simulated_rig("red", width_px=80, height_px=64)


@pytest.fixture(scope="module")
def short(small) -> PaintPlan:
    """Three filters."""
    return paint_plan("red", small.camera).model_copy(update={"filters": ("450", "600", "630")})


@pytest.fixture(scope="module")
def short_folder(small, short, tmp_path_factory) -> Path:
    """The session of three filters without a view."""
    out = tmp_path_factory.mktemp("short") / "out"
    capture_paint_session(small, short, SessionRequest(out, "finray capture"))
    return out


@pytest.fixture(scope="module")
def captured_short(short_folder):
    return read_session(short_folder)


def watched(rig: RigFile, plan: PaintPlan) -> WatchedSession:
    return WatchedSession("red", rig.camera, plan.region, takes_time=False)


def request(session: WatchedSession, out: Path) -> SessionRequest:
    return SessionRequest(out, "finray live", progress=session.progress, operator=session.operator, watch=session)


@contextmanager
def person(session: WatchedSession, answer=lambda numbers: numbers.answers[0]):
    """Answer every question in a thread, as a view does; yield what was asked."""
    asked, stop = [], threading.Event()

    def look() -> None:
        after = 0
        while not stop.is_set():
            _, numbers = session.latest(after, 0.2)
            after = numbers.number
            if numbers.question and (not asked or asked[-1].question != numbers.question):
                asked.append(numbers)
                session.ask({"question": numbers.question, "answer": answer(numbers)})

    thread = threading.Thread(target=look)
    thread.start()
    try:
        yield asked
    finally:
        stop.set()
        thread.join(PATIENCE_S)


def frames_of(session) -> list[tuple[str, str, float]]:
    return [(frame.file, frame.sha256, frame.laser_dose_j) for frame in session.frames]


def test_a_session_in_the_view_is_that_of_capture(small, short, captured_short, tmp_path):
    """Same seed, same frames: the view looks and asks, and changes nothing."""
    session = watched(small, short)
    with person(session) as asked:
        made = capture_paint_session(small, short, request(session, tmp_path / "out"), mend=session.mend)
    assert frames_of(made) == frames_of(captured_short)
    assert made.notes == captured_short.notes
    assert made.filter_proof == captured_short.filter_proof
    picture, numbers = session.latest(-1, 0.0)
    sample, beside, white = (TARGET_HEADLINES[t] for t in ("sample", "sample beside ColorChecker", "white"))
    assert [a.headline for a in asked] == [sample, beside, white, beside, sample]
    assert (numbers.stored, numbers.left, numbers.time_left_s) == (len(made.frames), 0, 0.0)
    assert all(f.stored == f.planned > 0 for f in numbers.filters)
    assert [f.name for f in numbers.filters] == list(short.filters)
    assert (numbers.lamp, numbers.laser, numbers.question) == (False, False, 0)
    assert picture.shape == (32, 40)


def test_drift_is_that_of_the_frames(small, short, tmp_path):
    """The lamp falls by 3 % between metering and frames: the last white frame says so within its uncertainty."""
    session = watched(small, short)
    flicker = 2.0 * 0.002 * 2.0**0.5  # two standard deviations of two frames of the simulated light
    with person(session), dimmer(session, 0.97):
        capture_paint_session(small, short, request(session, tmp_path / "out"))
    (white,) = [d for d in session.latest(-1, 0.0)[1].drifts if d.label.startswith("tile lamp")]
    assert white.change_rel == pytest.approx(-0.03, abs=flicker + 2.0 * white.uncertainty_rel)
    assert 0.0 < white.uncertainty_rel < 0.01


@contextmanager
def dimmer(session: WatchedSession, factor: float):
    """Dim what shines on the bench once frames are stored."""
    from rigs.simulated import Bench

    shining = Bench.electrons_per_s

    def dimmed(self, *what):
        level = factor if session.latest(-1, 0.0)[1].left >= 0 else 1.0
        return level * shining(self, *what)

    Bench.electrons_per_s = dimmed
    try:
        yield
    finally:
        Bench.electrons_per_s = shining


class Held:
    """The simulated camera, held in the first exposure under a light; and when that light went off."""

    def __init__(self, monkeypatch, light: str) -> None:
        self.begun, self.go_on = threading.Event(), threading.Event()
        self.off_s = 0.0
        self.lit: list[str] = []
        expose, lit = SimulatedCamera.expose, SimulatedLight.lit

        def held(camera, exposure_s, deadline_s):
            if getattr(camera.state, light, False) and not self.begun.is_set():
                self.begun.set()
                assert self.go_on.wait(PATIENCE_S)
            return expose(camera, exposure_s, deadline_s)

        @contextmanager
        def noted(device):
            with lit(device):
                self.lit.append(device.name)
                yield
            # not reached where the block is left by an error

        @contextmanager
        def timed(device):
            try:
                with noted(device):
                    yield
            finally:
                if device.name == light and not self.off_s:
                    self.off_s = time.monotonic()

        monkeypatch.setattr(SimulatedCamera, "expose", held)
        monkeypatch.setattr(SimulatedLight, "lit", timed)


@pytest.mark.parametrize("light", ["lamp", "laser"])
def test_the_light_key_acts_within_an_exposure_and_the_frame_is_taken_again(
    small, short, short_folder, captured_short, tmp_path, monkeypatch, light
):
    held, session = Held(monkeypatch, light), watched(small, short)
    seen = {}

    def press() -> None:
        assert held.begun.wait(PATIENCE_S)
        pressed_s = time.monotonic()
        session.ask({"lamp": False})
        while not held.off_s and time.monotonic() < pressed_s + PATIENCE_S:
            time.sleep(0.005)
        seen["off_after_s"] = held.off_s - pressed_s  # the exposure is still held
        held.go_on.set()

    thread = threading.Thread(target=press)
    thread.start()
    out = tmp_path / "out"
    with person(session) as asked:
        made = capture_paint_session(small, short, request(session, out))
    thread.join(PATIENCE_S)
    assert 0.0 < seen["off_after_s"] < DARK_WITHIN_S + BUSY_S
    (dark,) = [a for a in asked if a.kept_off]  # a laser that harms eyes is asked for in the words of the session
    assert dark.headline == ("THE LIGHT IS OFF" if light == "lamp" else "YES OR NO?")
    assert light in dark.text
    assert (dark.lamp, dark.laser) == (False, False)
    assert any(
        note.startswith("faults that did not stop the session: a light went off or stopped answering")
        for note in made.notes
    )
    assert session.latest(-1, 0.0)[1].lights_lost == 1
    assert [frame.file for frame in made.frames] == [frame.file for frame in captured_short.frames]
    for frame, twin in zip(made.frames, captured_short.frames, strict=True):
        level, as_before = read_frame_of(out, frame).mean(), read_frame_of(short_folder, twin).mean()
        assert level == pytest.approx(as_before, rel=0.02)  # flicker of 0.2 % and noise; a light that went off shows
    assert verify_session(out).faults == ()


def test_the_light_key_before_a_light_keeps_it_off(small, short, tmp_path, monkeypatch):
    """Pressed while all is dark, it lets no light come on before it is allowed, and 'end' ends a session to resume."""
    held, session = Held(monkeypatch, "none"), watched(small, short)
    session.ask({"lamp": False})
    out = tmp_path / "out"
    words = {"THE LIGHT IS OFF": "end"}
    with (
        person(session, lambda n: words.get(n.headline, n.answers[0])),
        pytest.raises(CaptureError, match="was switched off by hand and is not lit again"),
    ):
        capture_paint_session(small, short, request(session, out))
    assert held.lit == []
    made = capture_paint_session(small, short, SessionRequest(out, "x"), interrupted=read_interrupted(out))
    assert verify_session(out).faults == ()
    assert len(made.frames) > 20


@pytest.fixture
def interrupts():
    """The interrupt, which a shell has programs in the background ignore."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.usefixtures("interrupts")
def test_a_session_that_does_not_leave_its_light_is_ended(small, short, tmp_path, monkeypatch):
    """Held outside of camera and wheel, as by a disk that hangs, it is ended as by Ctrl-C."""
    held, session = Held(monkeypatch, "lamp"), watched(small, short)
    held.go_on.set()
    pressed = []

    def hang(done: int, total: int, what: str) -> None:
        if session.latest(-1, 0.0)[1].lamp and not pressed:
            pressed.append(time.monotonic())
            session.darken()
            time.sleep(60.0)

    asked = SessionRequest(tmp_path / "out", "x", progress=hang, operator=session.operator, watch=session)
    with person(session), pytest.raises(KeyboardInterrupt):
        capture_paint_session(small, short, asked)
    assert held.off_s - pressed[0] < DARK_WITHIN_S + BUSY_S
    assert read_journal(tmp_path / "out")[-1]["outcome"].startswith("KeyboardInterrupt")
    assert read_interrupted(tmp_path / "out").kind == "paint"


def test_what_is_healed_is_counted(small, short, captured_short, tmp_path, monkeypatch):
    expose, taken = SimulatedCamera.expose, []

    def torn(camera, exposure_s, deadline_s):
        taken.append(exposure_s)
        if len(taken) in (3, 20):
            raise BadFrameError("camera: a torn frame")
        return expose(camera, exposure_s, deadline_s)

    monkeypatch.setattr(SimulatedCamera, "expose", torn)
    session = watched(small, short)
    with person(session):
        made = capture_paint_session(small, short, request(session, tmp_path / "out"))
    assert session.latest(-1, 0.0)[1].retaken == 2
    assert frames_of(made) == frames_of(captured_short)


@pytest.mark.parametrize("stays_dim", [False, True])
def test_frames_that_no_longer_count_are_not_counted(small, short, tmp_path, monkeypatch, stays_dim):
    """The lamp dims once frames are stored, until somebody mends it; or stays so, and all frames are taken again."""
    session, is_dim = watched(small, short), threading.Event()
    shining = Bench.electrons_per_s

    def dimmed(bench, *what):
        stored = session.latest(-1, 0.0)[1].stored
        if stored and not is_dim.is_set() and not session.latest(-1, 0.0)[1].repairs:
            is_dim.set()
        return (0.7 if is_dim.is_set() else 1.0) * shining(bench, *what)

    def mended(text: str) -> bool:
        if not stays_dim:
            is_dim.clear()
        return session.mend(text)

    monkeypatch.setattr(Bench, "electrons_per_s", dimmed)
    with person(session):
        made = capture_paint_session(small, short, request(session, tmp_path / "out"), mend=mended)
    events = [line["event"] for line in read_journal(tmp_path / "out")]
    assert ("set aside" if stays_dim else "as before") in events
    _, numbers = session.latest(-1, 0.0)
    assert (numbers.repairs, numbers.stored, numbers.left) == (1, len(made.frames), 0)
    assert all(f.stored == f.planned > 0 for f in numbers.filters)


def test_a_resumed_session_counts_the_frames_of_each_filter_that_were_stored_before(
    small, short, captured_short, short_folder, tmp_path
):
    out = tmp_path / "out"
    shutil.copytree(short_folder, out)
    for name in ("session.json", "manifest-sha256.txt"):
        (out / name).unlink()
    lines = (out / "journal.jsonl").read_text().splitlines(keepends=True)
    ends = [number for number, line in enumerate(lines, 1) if json.loads(line)["event"] == "frame"]
    (out / "journal.jsonl").write_text("".join(lines[: ends[2 * len(ends) // 3]]))
    session, interrupted = watched(small, short), read_interrupted(out)
    assert any(frame.light != "off" for frame in interrupted.frames.values())
    with person(session):
        capture_paint_session(small, short, request(session, out), interrupted=interrupted, mend=session.mend)
    taken = Counter(frame.filter_name for frame in captured_short.frames if frame.light != "off")
    counted = {f.name: (f.stored, f.planned) for f in session.latest(-1, 0.0)[1].filters}
    assert counted == {name: (count, count) for name, count in taken.items() if name is not None}


def test_a_session_of_presses(sensor, tmp_path):
    """It has no region, no filter and no light of its own; the key for light off says so and holds nothing."""
    plan, rig = plan_of(tmp_path), rig_of(tmp_path)
    session = WatchedSession(plan.name, rig.camera, None, has_lights=False)
    session.darken()

    def presses(numbers) -> str:
        sensor.scene = scene(sensor, contact=numbers.text.startswith("Press"))
        return "done"

    with person(session, presses) as asked:
        made = capture_tactile_session(rig, plan, plan.presses, request(session, tmp_path / "out"))
    picture, numbers = session.latest(-1, 0.0)
    assert (numbers.stored, numbers.left, numbers.kept_off) == (len(made.frames), 0, False)
    assert "switch it off at the finger" in numbers.told
    assert len(asked) > 4
    assert asked[0].headline == "YOUR HANDS PLEASE"
    assert picture.shape == (rig.camera.height_px // 2, rig.camera.width_px // 2)
    assert numbers.exposure_s == pytest.approx(0.01, rel=0.05)


def test_a_repair_is_asked_for_and_the_operator_is_believed():
    session = WatchedSession("red", simulated_rig("red").camera, None)
    with person(session, lambda n: n.answers[-1]) as asked:
        assert not session.mend("filter wheel: 450 and 600 are exchanged")
    with person(session) as again:
        assert session.mend("filter wheel: 450 and 600 are exchanged")
        assert session.operator.allows("May it be lit?")
    assert [a.answers for a in (*asked, *again)] == [("done", "end"), ("done", "end"), ("yes", "no")]
    assert "exchanged" in asked[0].text


@pytest.mark.parametrize(
    "command",
    [{}, {"lamp": True}, {"laser": False}, {"filter": "450"}, {"end": 1}, {"question": 0, "answer": "done"},
     {"question": 1, "answer": "done"}, {"question": "1", "answer": "done"}],
)  # fmt: skip
def test_what_pages_may_not_ask_of_a_session(small, short, command):
    session = watched(small, short)
    with pytest.raises(CaptureError, match=r"takes only lamp|is no longer open"):
        session.ask(command)
    assert not session.latest(-1, 0.0)[1].kept_off


@pytest.mark.parametrize(
    ("words", "reason"),
    [("", "give --rig to see"), ("--plan plan.toml", "--rig is missing; give the rig on which"),
     ("--rig r --out o", "are only for a session"),
     ("--resume s --plan plan.toml", "leave out --plan, --rig"), ("--plan p --rig r --terminal", "is not a terminal")],
)  # fmt: skip
def test_commands_that_are_none(words, reason, capsys):
    assert main(["live", *words.split()]) == 2
    assert reason in capsys.readouterr().err


# ---------------------------------------------------------------- a laser that harms eyes is lit again by two acts
@pytest.mark.parametrize(("laser_class", "word"), [("3R", "goggles"), ("3R", "end"), ("2", None)])
def test_a_laser_that_harms_eyes_is_lit_again_by_two_acts(small, short, tmp_path, monkeypatch, laser_class, word):
    """The first answer alone lights nothing; the second act names class and wavelength."""
    rig = small.model_copy(update={"laser": small.laser.model_copy(update={"laser_class": laser_class})})
    held = Held(monkeypatch, "laser")
    held.go_on.set()
    session = WatchedSession("red", rig.camera, short.region, takes_time=False, laser=rig.laser)
    pressed = []

    def press(done: int, total: int, what: str) -> None:
        if session.latest(-1, 0.0)[1].laser and not pressed:
            pressed.append(len(held.lit))
            session.ask({"lamp": False})
        session.progress(done, total, what)

    asked_of = SessionRequest(tmp_path / "out", "x", progress=press, operator=session.operator, watch=session)
    ended = pytest.raises(CaptureError, match="is lit again only if") if word == "end" else nullcontext()
    with person(session, lambda n: word if "goggles" in n.answers else n.answers[0]) as asked, ended:
        capture_paint_session(rig, short, asked_of)
    confirmed = [a for a in asked if "goggles" in a.answers]
    assert len(confirmed) == (word is not None)
    if confirmed:
        assert confirmed[0].headline == "CLASS 3R LASER"
        assert "goggles for 450 nm" in confirmed[0].text
        assert not confirmed[0].laser
    assert (len(held.lit) > pressed[0]) == (word != "end")


@contextmanager
def asked_for_goggles(small):
    """A session at its second question; yield it and what came of it."""
    session = WatchedSession("red", small.camera, None, laser=small.laser)
    answered: list[bool] = []
    thread = threading.Thread(target=lambda: answered.append(session.goggles_are_on()), daemon=True)
    thread.start()
    end_s = time.monotonic() + PATIENCE_S
    while not session.latest(-1, 0.0)[1].question and time.monotonic() < end_s:
        time.sleep(0.005)
    yield session, answered
    thread.join(PATIENCE_S)


def test_in_the_terminal_the_second_act_has_a_key_of_its_own_and_off_stays_one(small):
    with asked_for_goggles(small) as (session, answered):
        page = _SessionPage.__new__(_SessionPage)
        page._session, page._helps, page._ends = session, False, False  # noqa: SLF001
        for key in ("enter", "y", "enter", "x"):
            page._press(key)  # noqa: SLF001
        assert answered == []
        screen = "\n".join(session_screen(Screen(LEAST_COLUMNS, 24, colours=False, blocks=False), session,
                                          *session.latest(-1, 0.0), False))  # fmt: skip
        assert "C L A S S   3 R   L A S E R" in screen
        assert "Press g when they do." in screen
        page._press("l")  # noqa: SLF001
        assert session.latest(-1, 0.0)[1].kept_off
        page._press("g")  # noqa: SLF001
    assert answered == [True]


@pytest.mark.parametrize(("before", "shown"), [("q", "_ends"), ("?", "_helps")])
def test_a_key_that_goes_back_answers_no_question_behind_it(small, before, shown):
    """A person who presses y at "END?" has not said that the box is closed; lights go off from everywhere."""
    session = WatchedSession("red", small.camera, None, laser=small.laser)
    answered: list[str] = []
    question = ("YES OR NO?", "Is the box closed?", ("yes", "no"))
    thread = threading.Thread(target=lambda: answered.append(session.ask_person(*question)), daemon=True)
    thread.start()
    end_s = time.monotonic() + PATIENCE_S
    while not session.latest(-1, 0.0)[1].question and time.monotonic() < end_s:
        time.sleep(0.005)
    page = _SessionPage.__new__(_SessionPage)
    page._session, page._helps, page._ends = session, False, False  # noqa: SLF001
    for key in ("y", "n", "q", "?"):
        page._press(before)  # noqa: SLF001
        assert getattr(page, shown)
        page._press(key)  # noqa: SLF001
        assert (page._helps, page._ends) == (False, False)  # noqa: SLF001
        assert session.latest(-1, 0.0)[1].question
    page._press(before)  # noqa: SLF001
    page._press("l")  # noqa: SLF001
    assert session.latest(-1, 0.0)[1].kept_off
    page._press("n")  # noqa: SLF001
    thread.join(PATIENCE_S)
    assert answered == ["no"]


def test_in_the_browser_the_second_act_has_an_answer_of_its_own_and_off_stays_one(small):
    with asked_for_goggles(small) as (session, answered), live_server(session) as server:
        threading.Thread(target=server.serve_forever, args=(0.05,), daemon=True).start()
        number = session.latest(-1, 0.0)[1].question

        def do(command: dict) -> int:
            connection = http.client.HTTPConnection(server.host, timeout=PATIENCE_S)
            connection.request("POST", "/do", json.dumps(command), {"X-Token": server.token})
            status = connection.getresponse().status
            connection.close()
            return status

        assert [do({"question": number, "answer": word}) for word in ("done", "yes")] == [400, 400]
        assert answered == []
        assert do({"lamp": False}) == 200
        assert session.latest(-1, 0.0)[1].kept_off
        assert do({"question": number, "answer": "goggles"}) == 200
        server.shutdown()
    assert answered == [True]
    page = (ROOT / "rigs" / "live_view" / "session_view.html").read_text(encoding="utf-8")
    assert 'event.key === "g") reply("goggles")' in page


# ---------------------------------------------------------------- an exposure that was left ends before devices close
class Blocking:
    """A camera whose read blocks; it writes down what is called and when it is closed."""

    def __init__(self, read_s: float) -> None:
        self.events: list[str] = []
        self.released, self._read_s = threading.Event(), read_s

    def expose(self, exposure_s: float, deadline_s: float) -> None:
        self.events.append("read")
        self.released.wait(self._read_s)
        self.events.append("end of read")

    def close(self) -> None:
        self.events.append("close")


def left_and_closed(small, camera: Blocking, deadline_s: float, then=lambda devices: None) -> float:
    """Leave an exposure by the key for light off, do `then`, close; return the seconds from its begin to the close."""
    session = WatchedSession("red", small.camera, None)
    began_s = time.monotonic()
    with open_rig(small, Path()) as opened:
        with watched_to_the_end(session):
            devices = session.devices(replace(opened, camera=camera))

            def press() -> None:
                while "read" not in camera.events:
                    time.sleep(0.005)
                session.darken()

            threading.Thread(target=press, daemon=True).start()
            with pytest.raises(LightLostError), session.shining("lamp"):
                devices.camera.expose(0.1, deadline_s)
            then(devices)
        camera.close()
    return time.monotonic() - began_s


def test_devices_are_closed_when_the_exposure_that_was_left_has_ended(small):
    camera = Blocking(read_s=0.5)
    left_and_closed(small, camera, deadline_s=60.0)
    assert camera.events == ["read", "end of read", "close"]


def test_a_read_that_does_not_end_keeps_nothing_waiting_beyond_its_deadline_and_is_asked_nothing_more(small):
    camera = Blocking(read_s=PATIENCE_S)

    def again(devices) -> None:
        with pytest.raises(LostError, match="has not ended within its deadline; end the session, plug"):
            devices.camera.expose(0.1, 0.5)

    took_s = left_and_closed(small, camera, deadline_s=0.5, then=again)
    assert 0.5 <= took_s < 0.5 + PATIENCE_S / 10.0
    assert camera.events == ["read", "close"]
    camera.released.set()
    time.sleep(0.2)
    assert camera.events == ["read", "close", "end of read"]  # no call after the close


def test_a_session_waits_for_the_exposure_that_it_left(small, short, tmp_path, monkeypatch):
    """By the capture itself: at the end of `open_rig`, no exposure runs."""
    running, at_close, begun = [0], [], threading.Event()
    expose, opening = SimulatedCamera.expose, capturing.open_rig
    session = watched(small, short)

    def slow(camera, exposure_s, deadline_s):
        running[0] += 1
        if camera.state.lamp and not begun.is_set():
            begun.set()
            time.sleep(0.5)
        try:
            return expose(camera, exposure_s, deadline_s)
        finally:
            running[0] -= 1

    @contextmanager
    def noted(*what):
        with opening(*what) as opened:
            try:
                yield opened
            finally:
                at_close.append(running[0])

    monkeypatch.setattr(SimulatedCamera, "expose", slow)
    monkeypatch.setattr(capturing, "open_rig", noted)
    threading.Thread(target=lambda: begun.wait(PATIENCE_S) and session.darken(), daemon=True).start()
    words = {"THE LIGHT IS OFF": "end"}
    with (
        person(session, lambda n: words.get(n.headline, n.answers[0])),
        pytest.raises(CaptureError, match="was switched off by hand"),
    ):
        capture_paint_session(small, short, request(session, tmp_path / "out"))
    assert at_close == [0]


# ---------------------------------------------------------------- the command, in a terminal and in a browser
@pytest.fixture
def files(small, short, tmp_path) -> Path:
    write_rig(small, tmp_path / "rig.toml")
    write_plan(short, tmp_path / "plan.toml")
    return tmp_path


def command(files: Path, *words: str) -> list[str]:
    live = [sys.executable, "-m", "finray_calib.cli.main", "live", "--rig", f"{files}/rig.toml"]
    return [*live, "--plan", f"{files}/plan.toml", "--out", f"{files}/out", *words]


def in_terminal(files: Path, size=(80, 24), **environment: str) -> Terminal:
    return Terminal(command(files, "--terminal"), size, PYTHONPATH=str(ROOT), **environment)


class Page:
    """What a page of a running session does, over HTTP."""

    def __init__(self, files: Path) -> None:
        address = (files / "out.live-address").read_text(encoding="utf-8").strip()
        self.url = address
        self.host, self.token = address.removeprefix("http://").split("/?token=")

    def told(self, after: int = 0) -> dict:
        return json.loads(self._answer("GET", f"/frame?after={after}").getheader("X-Numbers"))

    def do(self, **command) -> int:
        return self._answer("POST", "/do", json.dumps(command)).status

    def _answer(self, method: str, path: str, body: str | None = None):
        connection = http.client.HTTPConnection(self.host, timeout=PATIENCE_S)
        connection.request(method, path, body, {"X-Token": self.token})
        answer = connection.getresponse()
        answer.read()
        connection.close()
        return answer

    def until(self, wanted) -> dict:
        end_s, number = time.monotonic() + PATIENCE_S, 0
        while time.monotonic() < end_s:
            told = self.told(number)
            number = told["number"]
            if wanted(told):
                return told
        raise AssertionError(told)

    def answer_all(self) -> None:
        """Answer until the session has ended."""
        while not (told := self.until(lambda t: t["question"] or t["ended"]))["ended"]:
            assert self.do(question=told["question"], answer=told["answers"][0]) == 200
            self.until(lambda t, q=told["question"]: t["question"] != q)


def is_as_before(terminal: Terminal) -> bool:
    return terminal.mode == terminal.mode_before and not terminal.screen.is_other and terminal.screen.cursor_is_shown


def asks(terminal: Terminal, words: str) -> None:
    terminal.until(lambda: words in " ".join(terminal.screen.text.split()), PATIENCE_S)


def status_of(terminal: Terminal) -> int:
    terminal.until(lambda: terminal.process.poll() is not None, PATIENCE_S)
    return terminal.status()


def test_a_whole_session_in_the_terminal(files, captured_short):
    with in_terminal(files) as terminal:
        for words in ("Put the paint sample", "beside the ColorChecker", "Put the white tile",
                      "beside the ColorChecker",
                      "Put the paint sample"):  # fmt: skip
            asks(terminal, words)
            terminal.until(lambda: "Press Enter when done." in " ".join(terminal.screen.text.split()))
            assert all(len(row) == 80 for row in terminal.screen.rows())
            terminal.press("x\r")
            terminal.until(lambda words=words: words not in " ".join(terminal.screen.text.split()))
        assert status_of(terminal) == 0
        assert is_as_before(terminal)
        said = " ".join(terminal.screen.bare_text.split())
    assert f"{len(captured_short.frames)} frames of 'red'" in said
    assert "next: finray radiometry" in said
    assert frames_of(read_session(files / "out")) == frames_of(captured_short)
    assert not (files / "out.live-address").exists()


def test_a_session_outlives_its_terminal_and_its_page(files, captured_short):
    """The window is closed in the middle; a page takes over, is closed too, and another one ends it."""
    with in_terminal(files) as terminal:
        asks(terminal, "Put the paint sample")
        terminal.press("\r")
        asks(terminal, "beside the ColorChecker")
        assert (files / "out.live-address").stat().st_mode & 0o777 == 0o600
        second = [*command(files)[:4], "--resume", f"{files}/out"]
        refused = subprocess.run(second, cwd=ROOT, capture_output=True, text=True, check=False)
        assert refused.returncode == 2
        assert f"the view of this session is already open at {Page(files).url}" in refused.stderr
        terminal.close_window()
        told = Page(files).until(lambda t: t["question"])
        assert told["headline"] == "SAMPLE + CHECKER"
        assert Page(files).do(question=told["question"], answer="done") == 200
        Page(files).answer_all()
        terminal.process.wait(PATIENCE_S)
    assert verify_session(files / "out").faults == ()
    assert frames_of(read_session(files / "out")) == frames_of(captured_short)


def test_ctrl_c_ends_it_dark_and_capture_resumes_it(files, captured_short):
    with in_terminal(files) as terminal:
        asks(terminal, "Put the paint sample")
        terminal.press("\x1a")
        asks(terminal, "Ctrl-Z is ignored")
        terminal.press("?")
        asks(terminal, "Its address, for a browser")
        terminal.press(" ")
        terminal.press("x")
        asks(terminal, "KEPT OFF by hand")
        terminal.press("\r")
        asks(terminal, "You switched the light off")
        terminal.press("\x03")
        assert status_of(terminal) == 130
        assert is_as_before(terminal)
        assert "Traceback" not in terminal.screen.bare_text
        assert f"finray capture --resume {files}/out" in " ".join(terminal.screen.bare_text.split())
    assert main(["capture", "--resume", f"{files}/out"]) == 0
    assert [f.file for f in read_session(files / "out").frames] == [f.file for f in captured_short.frames]


def test_q_and_e_end_it_and_live_resumes_it(files):
    with in_terminal(files) as terminal:
        asks(terminal, "Put the paint sample")
        terminal.press("q")
        asks(terminal, "Press e to end the session")
        terminal.press("x")
        asks(terminal, "Put the paint sample")
        terminal.press("qe")
        assert status_of(terminal) == 130
    words = [*command(files)[:4], "--resume", f"{files}/out"]
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True, cwd=files) as process:
        assert any(line.startswith("http://127.0.0.1:") for line in process.stdout)
        Page(files).answer_all()
        assert process.wait(PATIENCE_S) == 0
    assert verify_session(files / "out").faults == ()


@pytest.mark.rigs
def test_the_page_in_a_real_browser(files, tmp_path):
    with subprocess.Popen(command(files), stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        process.stdout.readline()
        page = Page(files)
        told = page.until(lambda t: t["question"])
        page.do(question=told["question"], answer="done")
        page.until(lambda t: t["question"] == told["question"] + 1)
        browser = [
            require("chromium", "chromium"), "--headless=new", "--no-sandbox", "--disable-gpu",
            f"--user-data-dir={tmp_path}/profile", "--virtual-time-budget=150", "--dump-dom", page.url,
        ]  # fmt: skip
        dom = subprocess.run(browser, capture_output=True, text=True, check=True, timeout=300).stdout
        assert '<h1 id="headline">SAMPLE + CHECKER</h1>' in dom
        assert "Done, go on [Enter]</button>" in dom
        assert 'id="lamp" class="good">off' in dom
        assert "metering: " in dom
        assert page.token not in dom.partition("<script>")[0]
        assert page.do(end=True) == 200  # the browser is gone by now, and the session was not
        assert process.wait(PATIENCE_S) == 130


# ---------------------------------------------------------------- what the screen shows
def numbers(**what) -> SessionNumbers:
    full = {
        "headline": "FRAMES", "text": "12 of 60: frames: white (white, lamp) through filter 560", "stored": 12,
        "left": 48, "time_left_s": 200.0, "frame": "white", "exposure_s": 0.1, "snr": 88.0, "lamp": True,
        "histogram": (1,) * BINS,
        "drifts": tuple(Drift(f"{kind} 560", -0.0031, 0.0004) for kind in REFERENCES.values()),
        "filters": (FilterCount("450", 4, 4, 50.0),
        FilterCount("560", 2, 4, 60.0)), "retaken": 1, "told": "taken again: camera: a torn frame",
    }  # fmt: skip
    return SessionNumbers(**{**full, **what})


def test_every_number_has_its_place_at_80_by_24(small, short):
    import numpy as np

    session = watched(small, short)
    screen = Screen(LEAST_COLUMNS, 24, colours=False)
    lines = session_screen(screen, session, np.zeros((32, 40), np.uint8), numbers(), False)
    text = "\n".join(lines)
    assert len(lines) == 24
    for shown in ("LAMP ON", "LASER off", "TIME LEFT 3 min", "12 frames stored, 48 to take", "SIGNAL TO NOISE 88",
                  "FILTER none, 1 of 2 done", "560 2/4", "drift -0.31\u00b10.04 % tile lamp 560", " % tile laser 560",
                  "% repeat 560",
                  "0 lights lost, 0 repairs", "0 repeated, 1 retaken",
                  "a torn frame", "l LIGHT OFF"):  # fmt: skip
        assert shown in text
    assert len(HELP) + 6 <= 24
    assert any("flicker is not in it" in text for text in HELP)  # as on the page in the browser
    assert max(map(len, HELP)) <= LEAST_COLUMNS - 2


def test_a_long_question_is_shown_to_its_end(small, short):
    """The longest one names why the guard of the laser ended; what is asked stands at its end."""
    import numpy as np

    text = (
        "The laser went off without a command and stays off (laser at /dev/serial/by-id/usb-Arduino_Uno_85439-if00: "
        "the guard process has ended (it was killed by signal 9); the light has been switched off without it and is "
        "confirmed off. Continue the capture with --resume). Find the cause first: was the box opened? Is it closed "
        "now, does everybody wear goggles, and may the laser be lit again?"
    )
    asked = numbers(headline="YES OR NO?", text=text, question=1, answers=("yes", "no"))
    screen = Screen(LEAST_COLUMNS, 24, colours=False)
    lines = session_screen(screen, watched(small, short), np.zeros((32, 40), np.uint8), asked, False)
    assert len(lines) == 24
    shown = " ".join(re.sub(r"\x1b\[\d*m", "", line).strip() for line in lines)
    # without spaces, as a line may end after a hyphen
    assert f"{text} Press y or n.".replace(" ", "") in shown.replace(" ", "")
    for told in ("LAMP ON", "LASER off", "TIME LEFT", "a torn frame", "l LIGHT OFF"):
        assert told in shown


def test_large_letters():
    """Each letter of the headlines is drawn, in three lines that fit the terminal, and no two letters are alike."""
    headlines = [*TARGET_HEADLINES.values(), "SWING WHEEL OUT", "TURN THE SAMPLE", "YOUR HANDS PLEASE", "YES OR NO?",
                 "MEND THE RIG", "THE LIGHT IS OFF",
                 "CLASS 3R LASER", "CLASS 4 LASER", "DARK FRAMES BEFORE", "METERING", "END?"]  # fmt: skip
    screen = Screen(LEAST_COLUMNS, 24)
    for headline in headlines:
        assert set(headline) <= set(LETTERS)
        lines = large_letters(screen, headline)
        assert len(lines) == 3
        assert max(map(len, lines)) <= LEAST_COLUMNS
        assert set("".join(lines)) <= set(" \u2580\u2584\u2588")
    assert len(set(LETTERS.values())) == len(LETTERS)
    assert all(len({len(row) for row in rows.split()}) == 1 and len(rows.split()) == 5 for rows in LETTERS.values())
    assert large_letters(Screen(LEAST_COLUMNS, 24, blocks=False), "DONE")[1].strip() == "D O N E"
