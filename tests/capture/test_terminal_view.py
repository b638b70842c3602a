"""The live view in a terminal: what keys do to the devices, every way out, and what the screen shows."""

import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from finray_calib.cli.main import main
from rigs import open_rig, write_rig
from rigs.live_view import LiveRig
from rigs.live_view._live_server import LONGEST_EXPOSURE_S
from rigs.live_view._terminal_page import LEAST_COLUMNS, Screen, keys_in, reduced
from rigs.live_view._terminal_view import HELP, changed_region, next_filter
from tests.architecture.test_conventions import ROOT
from tests.capture.drivers.programs import require
from tests.capture.terminal_screen import Terminal

MARGIN_S = 2.0
"""For a busy computer, beside the exposure that is under way."""


@pytest.fixture
def path(rig, tmp_path) -> Path:
    return write_rig(rig, tmp_path / "rig.toml")


def command(path: Path, mode: str = "plain") -> list[str]:
    script = ["-m", "tests.capture.watched_live_view", str(path.with_name("log")), mode]
    return [sys.executable, *script, "live", "--rig", str(path), "--terminal"]


def view(path: Path, mode: str = "plain", size=(80, 24), **environment: str) -> Terminal:
    return Terminal(command(path, mode), size, PYTHONPATH=str(ROOT), **environment)


def told(path: Path) -> list[str]:
    """Return what the devices wrote down, without the times."""
    log = path.with_name("log")
    return [line.split(" ", 1)[1] for line in log.read_text().splitlines()] if log.exists() else []


def exposures(path: Path) -> list[float]:
    return [float(line.split()[1]) for line in told(path) if line.startswith("exposure")]


def lights(path: Path) -> list[str]:
    return [line for line in told(path) if line.startswith(("lamp", "laser"))]


def lit(terminal: Terminal, path: Path) -> None:
    """Switch the lamp on."""
    terminal.until("LAMP off")
    terminal.press("o")
    terminal.until("LAMP ON")
    assert lights(path) == ["lamp on"]


def is_as_before(terminal: Terminal) -> bool:
    """Whether the terminal is set as it was, on its own screen, with a cursor."""
    return terminal.mode == terminal.mode_before and not terminal.screen.is_other and terminal.screen.cursor_is_shown


def test_each_key_does_to_the_devices_what_it_says(path, rig):
    names = [band.name for band in rig.filter_wheel.filters]
    slots = {band.name: band.slot for band in rig.filter_wheel.filters}
    with view(path) as terminal:
        lit(terminal, path)
        before = exposures(path)[-1]
        terminal.press("+")
        terminal.until(lambda: exposures(path)[-1] == pytest.approx(2 * before))
        terminal.press("--")
        terminal.until(lambda: exposures(path)[-1] == pytest.approx(before / 2))
        terminal.press("m")
        terminal.until(lambda: "good" in terminal.screen.text)
        terminal.press("4")
        terminal.until(f"4 [{names[3]}]")
        terminal.press("ff")
        terminal.until(f"6 [{names[5]}]")
        terminal.press("F")
        terminal.until(f"5 [{names[4]}]")
        assert [line for line in told(path) if line.startswith("slot")][-1] == f"slot {slots[names[4]]}"
        terminal.press("<<")
        terminal.until("height_px 82  width_px 102")  # 128 and 160, twice by 1.25, in whole cells of 2 px
        terminal.until("row_px 22  column_px 28")
        terminal.press("\x1b[A\x1b[D")
        terminal.until("row_px 16  column_px 22")
        terminal.press("\x1b[1;2B\x1bOC")
        terminal.until("row_px 18  column_px 28")
        terminal.press("a")
        terminal.until("height_px 128  width_px 160")
        terminal.press("?")
        terminal.until(HELP[-1])
        assert "LASER" not in terminal.screen.text
        terminal.press("x")
        terminal.until("FOCUS")
        for key in ("l", " ", "\x1b"):
            terminal.press(key)
            terminal.until("LAMP off")
            assert lights(path)[-1] == "lamp off"
            terminal.press("o")
            terminal.until("LAMP ON")
        terminal.press("q")
        assert terminal.status() == 0
        assert lights(path)[-1] == "lamp off"
        assert "laser on" not in lights(path)
        assert is_as_before(terminal)
        assert "height_px = 128" in terminal.screen.bare_text


@pytest.mark.parametrize("way", ["q", "\x03", "SIGTERM", "SIGHUP", "gone"])
def test_the_lamp_is_off_in_time_and_the_terminal_as_before_on_every_way_out(path, way):
    with view(path, "slow") as terminal:
        lit(terminal, path)
        terminal.press("+" * 10)
        terminal.until(lambda: exposures(path)[-1] == LONGEST_EXPOSURE_S)
        asked_s = time.monotonic()
        if way == "gone":  # the window is closed: the system tells it by SIGHUP, and reading and writing fail
            terminal.close_window()
            assert terminal.process.wait(30) == 0
        else:
            if way.startswith("SIG"):
                terminal.process.send_signal(signal.Signals[way])
            else:
                terminal.press(way)
            assert terminal.status() == 0
            assert is_as_before(terminal)
            assert "Traceback" not in terminal.screen.bare_text
        time_of_off = float(path.with_name("log").read_text().splitlines()[-1].split()[0])
        assert lights(path) == ["lamp on", "lamp off"]
        assert time_of_off - asked_s < LONGEST_EXPOSURE_S + MARGIN_S


def test_a_failure_of_the_view_gives_the_terminal_back_with_the_lamp_off(path):
    with view(path, "broken") as terminal:
        terminal.until("LAMP off")
        terminal.press("o")
        assert terminal.status() == 1
        assert is_as_before(terminal)
        assert "drawing failed" in terminal.screen.bare_text
        assert lights(path) == ["lamp on", "lamp off"]


def test_a_lamp_that_is_not_confirmed_off_is_told_after_the_view(path):
    with view(path, "stubborn") as terminal:
        lit(terminal, path)
        terminal.press("q")
        assert terminal.status() == 2
        assert is_as_before(terminal)
        assert "NOT CONFIRMED OFF" in terminal.screen.bare_text
        assert "Traceback" not in terminal.screen.bare_text


def test_ctrl_z_stops_with_the_lamp_off_and_a_terminal_for_the_shell(path):
    """Under a shell with job control, which the kernel asks for before it stops anything."""
    with Terminal(["bash", "--norc", "--noprofile", "-i"], PS1="ready> ", PYTHONPATH=str(ROOT)) as terminal:
        terminal.until(lambda: "ready>" in terminal.screen.bare_text)
        terminal.press(" ".join(command(path)) + "\n")
        lit(terminal, path)
        mode = terminal.mode
        terminal.press("\x1a")
        terminal.until(lambda: "Stopped" in terminal.screen.bare_text)
        assert lights(path) == ["lamp on", "lamp off"]
        assert not terminal.screen.is_other
        assert terminal.screen.cursor_is_shown
        frames = len(exposures(path))
        time.sleep(0.5)
        assert len(exposures(path)) == frames
        terminal.press("fg\n")
        terminal.until(lambda: terminal.screen.is_other and "LAMP off" in terminal.screen.text)
        terminal.until(lambda: len(exposures(path)) > frames)
        assert terminal.mode == mode
        assert lights(path) == ["lamp on", "lamp off"]
        terminal.press("o")
        terminal.until("LAMP ON")
        terminal.press("q")
        terminal.until(lambda: terminal.screen.bare_text.rstrip().endswith("ready>"))
        assert lights(path) == ["lamp on", "lamp off"] * 2


def test_ctrl_z_where_nobody_could_continue_it_puts_the_lamp_off_and_goes_on(path):
    """The kernel stops no program whose session has no shell."""
    with view(path) as terminal:
        lit(terminal, path)
        terminal.press("\x1a")
        terminal.until("LAMP off")
        terminal.press("o")
        terminal.until("LAMP ON")
        terminal.press("q")
        assert terminal.status() == 0
        assert is_as_before(terminal)


def test_a_terminal_that_takes_nothing_delays_no_key(path):
    with view(path) as terminal:
        lit(terminal, path)
        end = time.monotonic() + 3.0
        while time.monotonic() < end:  # nothing is read meanwhile: the line is full
            time.sleep(0.1)
        terminal.press("l")
        end = time.monotonic() + MARGIN_S
        while lights(path)[-1] != "lamp off":
            assert time.monotonic() < end
            time.sleep(0.02)
        terminal.press("q")
        assert terminal.status() == 0


def test_a_lamp_that_a_person_switches_is_asked_for_in_the_view(path):
    with view(path, "manual") as terminal:
        terminal.until(lambda: "Switch the lamp off." in terminal.screen.bare_text)
        terminal.press("\r")
        terminal.until("LAMP off")
        terminal.press("o")
        terminal.until("Switch the lamp on. Press Enter when done.")
        terminal.press("x+")
        terminal.press("\r")
        terminal.until("LAMP ON")
        terminal.press("q")
        terminal.until("Switch the lamp off. Press Enter when done.")
        terminal.press("\r")
        assert terminal.status() == 0
        assert is_as_before(terminal)


def test_the_screen_follows_the_size_of_the_terminal(path):
    with view(path) as terminal:
        terminal.until("help  q")
        assert terminal.screen.rows()[-1].startswith(" l LIGHT OFF")
        terminal.resize(60, 20)
        terminal.until("needs 80 x 24")
        assert "60 x 20" in terminal.screen.text
        terminal.press("o")
        terminal.until("lamp ON")
        terminal.resize(130, 45)
        terminal.until("LAMP ON")
        terminal.until(lambda: terminal.screen.rows()[44].startswith(" l LIGHT OFF"))
        terminal.resize(20, 2)
        terminal.until("finray live needs 80")
        terminal.press("q")
        assert terminal.status() == 0


def test_without_colours_and_without_unicode(path):
    with view(path, NO_COLOR="1", PYTHONIOENCODING="ascii") as terminal:
        lit(terminal, path)
        terminal.press("m")
        terminal.until("good")
        assert b"38;5" not in terminal.bytes
        assert terminal.bytes.isascii()
        assert any(sign in terminal.screen.text for sign in ("%%%", "###", "***", "+++"))
        terminal.press("+")
        terminal.until("XXX")
        terminal.press("q")
        assert terminal.status() == 0


def test_where_there_is_no_terminal(path, capsys, monkeypatch):
    assert main(["live", "--rig", str(path), "--terminal"]) == 2
    assert "is not a terminal; leave out --terminal" in capsys.readouterr().err
    monkeypatch.setenv("TERM", "dumb")
    for words, reason in (([], "cannot place its cursor"), (["--json"], "")):
        with Terminal([sys.executable, "-m", "finray_calib.cli.main", "live", "--rig", str(path), "--terminal", *words],
                      PYTHONPATH=str(ROOT), TERM="dumb" if reason else "xterm") as terminal:  # fmt: skip
            assert terminal.status() == 2
            told = " ".join(terminal.screen.bare_text.split())
            assert (reason or "cannot be combined with --json or --quiet") in told


def test_a_frame_under_way_when_settings_change_is_not_the_best(rig, tmp_path):
    """A sharp frame that began with the old region must not stand as the best of the new one."""
    with open_rig(rig, tmp_path) as opened:
        begun, go_on = threading.Event(), threading.Event()
        rng = np.random.default_rng(1)
        sharp = rng.integers(0, 900, (rig.camera.height_px, rig.camera.width_px)).astype(np.uint16)
        frames = [sharp, np.full_like(sharp, 500)]

        def expose(exposure_s, deadline_s):
            begun.set()
            assert go_on.wait(30)
            counts = frames.pop(0) if len(frames) > 1 else frames[0]
            return SimpleNamespace(counts=counts, exposure_s=exposure_s)

        object.__setattr__(opened, "camera", SimpleNamespace(expose=expose))
        live = LiveRig(opened, rig)
        live.start()
        assert begun.wait(30)
        live.ask({"region": [0, 0, 64, 64]})
        go_on.set()
        _, numbers = live.latest(0)
        assert numbers.focus > 0.1
        assert numbers.best_focus == 0.0
        _, numbers = live.latest(numbers.number)
        assert numbers.region == (0, 0, 64, 64)
        assert numbers.best_focus == max(numbers.focus, 0.0) < 0.01
        live.stop()
        assert live.ended(30.0)


@given(st.lists(st.sampled_from(["up", "down", "left", "right", "fine up", "fine left", "<", ">", "a"]), max_size=60),
       st.integers(16, 3000), st.integers(16, 3000))  # fmt: skip
def test_regions_stay_in_the_frame(keys, rows, columns):
    region = (0, 0, rows, columns)
    for key in keys:
        region = changed_region(key, region, (rows, columns))
        row, column, height, width = region
        assert 0 <= row <= rows - height
        assert 0 <= column <= columns - width
        assert height >= 16
        assert width >= 16
    assert changed_region("x", region, (rows, columns)) is None


def test_keys_as_terminals_send_them():
    assert keys_in(b"l\x1b[A\x1bOB\x1b[1;2C\r", False) == (["l", "up", "down", "fine right", "enter"], b"")
    assert keys_in(b"\x1b", False) == ([], b"\x1b")
    assert keys_in(b"\x1b[1;", False) == ([], b"\x1b[1;")
    assert keys_in(b"\x1b", True) == (["escape"], b"")
    assert keys_in(b"\x1b\x1b[A", False) == (["escape", "up"], b"")
    assert keys_in(b"\x1b[15~q", False) == (["q"], b"")


@given(st.binary(max_size=40))
def test_whatever_is_typed_comes_to_an_end(typed):
    keys, rest = keys_in(typed, True)
    assert rest == b""
    assert all(keys)


def test_filters_go_round():
    assert [next_filter(["a", "b", "c"], now, step) for now, step in (("c", 1), ("a", -1), ("none", 1))] == [
        "a",
        "c",
        "a",
    ]


def test_a_smaller_picture_keeps_means_and_marks():
    picture = np.add.outer(np.arange(100), np.arange(120)).astype(np.uint8)
    small = reduced(picture, 10, 12)
    blocks = picture.reshape(10, 10, 12, 10).mean(axis=(1, 3))
    assert np.abs(small - blocks).max() <= 0.5
    picture[37, 81] = 255
    assert np.argwhere(reduced(picture, 10, 12) == 255).tolist() == [[3, 8]]
    assert reduced(picture, 400, 400).shape == (400, 400)


def test_the_least_screen_has_room_for_all_lines():
    assert Screen(LEAST_COLUMNS, 24).is_large_enough
    assert max(map(len, HELP)) <= LEAST_COLUMNS - 2
    assert len(HELP) + 3 <= 24


def settled(rows: list[str]) -> list[str]:
    """Return the rows that are the same for every frame."""
    moving = {0, 3, 4, 5, 8}
    return [row.rstrip() for n, row in enumerate(rows) if n not in moving]


@pytest.mark.rigs
def test_tmux_shows_what_the_screen_of_these_tests_shows(path, tmp_path):
    tmux = [require("tmux", "tmux"), "-S", str(tmp_path / "tmux"), "-f", "/dev/null", "-u"]
    run = " ".join(command(path))
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "LANG": "C.UTF-8"}
    subprocess.run([*tmux, "new-session", "-d", "-x", "80", "-y", "24", run], check=True, env=environment)
    subprocess.run([*tmux, "set", "status", "off"], check=True)
    try:
        with view(path) as terminal:
            terminal.until("? help")
            end, ours, theirs = time.monotonic() + 60, ["ours"], ["theirs"]
            while ours != theirs and time.monotonic() < end:  # either may be half drawn
                terminal.read()
                shown = subprocess.run([*tmux, "capture-pane", "-p"], capture_output=True, text=True, check=True).stdout
                ours, theirs = settled(terminal.screen.rows()), settled(shown.rstrip("\n").split("\n"))
        assert len(ours) == 19
        assert ours == theirs
    finally:
        subprocess.run([*tmux, "kill-server"], check=False)
