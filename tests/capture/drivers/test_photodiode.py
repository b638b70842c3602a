"""The photodiode as a witness of the laser: a board of our own, the unchanged firmware in QEMU, and how it may lie."""

import contextlib
import itertools
import math
import socket
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from data_schemas import CaptureError, CheckPlan, LaserSettings, LostError, RefusedError, TimedOutError
from finray_calib.acceptance import judge
from rigs import OpenRig, SystemClock, lights, open_rig, paint_plan, simulated_rig
from rigs.capture import _check_session as check_session
from rigs.capture import record_facts
from rigs.capture._check_light import Contrast, PhotodiodeWatch, find_contrast, require_seen
from rigs.capture.light_off_time import after_exception, after_kill
from rigs.light_guard import LightLevel, open_photodiode
from tests.capture.drivers import firmware_in_qemu
from tests.capture.drivers.firmware_in_qemu import Tap, build, firmware_board
from tests.capture.drivers.press_bench import Port, crc8
from tests.capture.drivers.programs import free_port, require
from tests.capture.drivers.test_stage_and_cell import connected

SEEN = Contrast(3 / 1023, 700 / 1023, 1 / 1023)


class DiodeBoard:
    """The side of the board: a reading every 10 ms of what `light` says, on a clock of its own."""

    def __init__(self, port: Port, light: Callable[[], bool]) -> None:
        self.port, self.light, self.is_unplugged, self.is_silent, self.is_damaged = port, light, False, False, False
        self.greets, self.is_stuck = b"LIGHT 1.1\n", False
        self._end, self._heard = threading.Event(), b""
        self.made_s: list[float] = []
        self._thread = threading.Thread(target=self._work, daemon=True)
        self._thread.start()

    def close(self) -> None:
        self._end.set()
        self._thread.join()
        self.port.pull()

    def _work(self) -> None:
        began_s, number = time.monotonic() - 1000.0, 0
        while not self._end.wait(0.01):
            self._heard += self.port.heard()
            if b"I\n" in self._heard:
                self._heard = b""
                self.port.say(self.greets)
            level = 700 if self.light() and not self.is_unplugged else 3
            self.made_s.append(time.monotonic())
            at_ms = int(1e3 * (self.made_s[-1] - began_s))
            text = f"L {number % 65536} {at_ms} {level + number % 3}".encode()
            number += not self.is_stuck
            if not self.is_silent:
                self.port.say(text + b" %02X\n" % (crc8(text) ^ (0x55 if self.is_damaged else 0)))


@contextmanager
def diode_board(folder: Path, light: Callable[[], bool]) -> Iterator[DiodeBoard]:
    board = DiodeBoard(Port(folder / "diode-port"), light)
    try:
        yield board
    finally:
        board.close()


def test_readings_carry_the_time_of_the_board(tmp_path: Path) -> None:
    lit = threading.Event()
    with diode_board(tmp_path, lit.is_set) as board, open_photodiode(str(board.port.path)) as diode:
        assert diode.read(0.5).level < 10
        lit.set()
        switched_s = time.monotonic()
        while (reading := diode.read(0.5)).level < 100:
            assert reading.at_s < switched_s + 0.1
        assert reading.at_s - switched_s >= -0.03
        # readings that wait in the buffer keep the time at which they were made
        time.sleep(0.5)
        waited = [diode.read(0.5) for _ in range(20)]
        assert waited[0].at_s < time.monotonic() - 0.2
        # the board works in this process, so that its pauses are those of a busy computer: they are kept, to its 1 ms
        gaps_s = np.lib.stride_tricks.sliding_window_view(np.diff(board.made_s), len(waited) - 1)
        assert np.abs(gaps_s - np.diff([reading.at_s for reading in waited])).max(axis=1).min() < 0.0015


def test_other_boards_are_refused(tmp_path: Path) -> None:
    with diode_board(tmp_path, lambda: False) as board:
        board.greets = b"LIGHT 2.0\n"
        with pytest.raises(RefusedError, match=r"firmware 2\.0, but .* flash rigs/lights/firmware/photodiode.c"):
            open_photodiode(str(board.port.path)).__enter__()
        board.greets = b""
        with pytest.raises(TimedOutError, match=r"sent no greeting within 3\.5 s; check the cable"):
            open_photodiode(str(board.port.path)).__enter__()


class Level:
    """A photodiode whose reading is told."""

    def __init__(self, level: Callable[[], int], sees_pulses: bool = True) -> None:
        self._level, self.sees_pulses = level, sees_pulses

    def read(self, deadline_s: float) -> LightLevel:
        time.sleep(0.001)
        return LightLevel(self._level(), time.monotonic())


def test_one_that_sees_the_laser_learns_what_dark_is_from_a_closed_beam() -> None:
    with opened_bench() as (opened, closed):
        nobody = replace(opened, close_beam=lambda shut: False)
        seen = find_contrast(nobody, Level(lambda: 700 if opened.laser.state() else 3))
        assert (seen.off_rel, seen.on_rel) == pytest.approx((SEEN.off_rel, SEEN.on_rel))
        assert seen.recorded().closed_rel is None
        assert seen.threshold_rel == pytest.approx(4.5 / 1023)  # by noise, and no share of the light
        seen = find_contrast(opened, Level(lambda: 700 if opened.laser.state() and not closed[0] else 3))
        assert seen.threshold_rel == pytest.approx(4.5 / 1023)
        noisy = itertools.cycle([3, 7, 5, 1])
        seen = find_contrast(
            opened, Level(lambda: next(noisy) + (700 if opened.laser.state() and not closed[0] else 0))
        )
        assert seen.threshold_rel == pytest.approx((4.0 + 6.0 * math.sqrt(5.0)) / 1023, rel=0.05)
        assert closed == [False]


@contextmanager
def opened_bench() -> Iterator[tuple[OpenRig, list[bool]]]:
    """The simulated rig on the clock of this computer, and whether its beam is closed."""
    with open_rig(simulated_rig("red", width_px=64, height_px=64), Path()) as opened:
        closed = [False]

        def close_beam(shut: bool) -> bool:
            assert not opened.laser.state()
            closed[0] = shut
            return True

        yield replace(opened, clock=SystemClock(), close_beam=close_beam), closed


PULSES = itertools.cycle([700, 3])


@pytest.mark.parametrize(
    ("level", "words"),
    [
        (lambda on, shut: 3, "reads the same with the laser on"),  # unplugged
        (lambda on, shut: 900, "reads the same with the laser on"),  # room light, or constant
        (lambda on, shut: 30 if on and not shut else 3, "reads the same with the laser on"),  # too faint
        (lambda on, shut: 1023 if on and not shut else 3, "is saturated and cannot show"),
        (
            lambda on, shut: next(PULSES) if on and not shut else 3,
            "reads the same with the laser on",
        ),  # pulses half missed
        (lambda on, shut: 3 if shut else 700 if on else 40, "The laser is dimmed and not off"),
        (lambda on, shut: 700 if on else 3, "lets light of the laser through"),  # nothing was closed
        (lambda on, shut: 60 if on and shut else 700 if on else 3, "lets light of the laser through"),
        (lambda on, shut: 0 if shut else 700 if on else 30, "or something other than its beam was covered"),
    ],
    ids=["dark", "bright", "faint", "saturated", "pulsed", "dimmed", "not closed", "half closed", "diode covered"],
)
def test_one_that_is_no_witness_is_told(level: Callable[[bool, bool], int], words: str) -> None:
    with opened_bench() as (opened, closed), pytest.raises(CaptureError, match=words):
        find_contrast(opened, Level(lambda: level(bool(opened.laser.state()), closed[0])))


@pytest.mark.parametrize("fails", ["never", "while it is read", "for good"])
def test_a_laser_that_went_out_behind_the_cap_proves_no_closed_beam(fails: str) -> None:
    """The box was opened for the cap: the interlock is open, and the cap may let light through unseen."""
    with opened_bench() as (opened, closed):
        was_closed = [False]

        def state() -> bool:
            was_closed[0] |= closed[0]
            out = fails == "while it is read" and closed[0] and len(read) > 10
            return opened.laser.state() and not out

        def level() -> int:
            if closed[0] and opened.laser.state():
                read.append(1)
            dies = fails == "for good" and was_closed[0]
            return 700 if opened.laser.state() and not closed[0] and not dies else 3

        read: list[int] = []
        laser = Laser(opened.laser, state)
        seen = find_contrast(replace(opened, laser=laser), Level(level)).recorded()
    proven = seen.reported_lit_closed and seen.on_again_rel > 0.5 * seen.on_rel
    assert proven == (fails == "never"), seen


class Laser:
    """A laser with another answer about its state."""

    def __init__(self, laser, state: Callable[[], bool]) -> None:
        self._laser, self.state = laser, state

    def __getattr__(self, name: str):
        return getattr(self._laser, name)


def test_a_beam_that_nobody_opens_again_is_told() -> None:
    with opened_bench() as (opened, closed):
        half = replace(opened, close_beam=lambda shut: opened.close_beam(shut) and shut)
        with pytest.raises(CaptureError, match="nobody has confirmed that its beam is open again"):
            find_contrast(half, Level(lambda: 700 if opened.laser.state() and not closed[0] else 3))


def test_off_takes_several_dark_readings_in_a_row() -> None:
    """One that is dark now and then sees a light that is pulsed, not one that is off."""
    levels = iter([700, 3, 3, 3, 3, 700, 3, 3, 3, 3, 3])
    watch = PhotodiodeWatch(Level(lambda: next(levels)), SEEN)
    assert [watch.look().on for _ in range(3)] == [True, True, False]


def test_a_board_that_repeats_itself_is_stuck(tmp_path: Path) -> None:
    with diode_board(tmp_path, lambda: True) as board, open_photodiode(str(board.port.path)) as diode:
        diode.read(0.5)
        board.is_stuck = True
        with pytest.raises(LostError, match=r"repeats reading \d+, so its board is stuck"):
            read_on(diode)


def read_on(diode) -> None:
    """Read more than was said before it was stuck."""
    for _ in range(30):
        diode.read(0.5)


def test_firmware_that_misses_pulses_does_not_pass(tmp_path: Path) -> None:
    with diode_board(tmp_path, lambda: True) as board:
        for greets, sees_pulses in ((b"LIGHT 1.0\n", False), (b"LIGHT 1.1\n", True)):
            board.greets = greets
            with open_photodiode(str(board.port.path)) as diode:
                assert diode.sees_pulses == sees_pulses


@pytest.mark.parametrize(
    ("closes", "sees_pulses", "verdict", "words"),
    [
        (True, True, "PASS", "light below 0.19 % of the laser's, 0.0086 mW at most, would not be seen"),
        (False, True, "UNDECIDED", "was taken while only the controller reported the laser off"),
        (True, False, "UNDECIDED", "a pulsed laser may look off"),
    ],
)
def test_a_check_passes_with_a_closed_beam_only(
    tmp_path: Path, monkeypatch, closes: bool, sees_pulses: bool, verdict: str, words: str
) -> None:
    """All of the check's own code, with the photodiode of the practice rig."""
    rig = simulated_rig("red", width_px=320, height_px=256)
    plan = CheckPlan(
        check_name="x", region=paint_plan("red", rig.camera).region, photodiode="simulated", filters=("405", "450"),
        wheel_moves=1, revisits=1, warm_up_s=0.0, exposure_rounds=4, darks_per_exposure=2,
    )  # fmt: skip
    opening = check_session.open_rig

    @contextmanager
    def opened_rig(*given: object) -> Iterator[OpenRig]:
        with opening(*given) as opened:
            shut = opened.close_beam if closes else (lambda closed: False)

            @contextmanager
            def photodiode(address: str):
                with opened.photodiode(address) as diode:
                    diode.sees_pulses = sees_pulses
                    yield diode

            yield replace(opened, close_beam=shut, photodiode=photodiode)

    monkeypatch.setattr(check_session, "open_rig", opened_rig)
    facts, notes = record_facts(rig, plan, tmp_path)
    assert facts.errors == {}
    assert facts.diode.sees_pulses == sees_pulses
    assert (facts.diode.closed_rel is None) == (not closes)
    assert next(layer.witness for layer in facts.light_off) == "a photodiode"
    (row,) = (r for r in judge(facts, plan, rig, notes).results if r.name == "laser off after an exception")
    assert (row.verdict, words in row.evidence) == (verdict, True), row


def test_one_that_goes_blind_proves_nothing(monkeypatch) -> None:

    with open_rig(simulated_rig("red", width_px=64, height_px=64), Path()) as opened:
        real_time = replace(opened, clock=SystemClock())
        seen = PhotodiodeWatch(Level(lambda: 700 if opened.laser.state() else 3), SEEN)
        block = after_exception(real_time, 2, seen)
        assert (block.witness, block.still_on, len(block.latest_s)) == ("a photodiode", 0, 2)
        assert all(a <= b < 0.2 for a, b in zip(block.earliest_s, block.latest_s, strict=True))
        with pytest.raises(CaptureError, match="a photodiode does not see the laser"):
            after_exception(real_time, 1, PhotodiodeWatch(Level(lambda: 3), SEEN))
        # unplugged in the very mishap: it read "off" at once, and does not see the laser on afterwards
        looks = iter([700, *([3] * 10_000)])
        with pytest.raises(CaptureError, match="does not see the laser"):
            after_exception(real_time, 1, PhotodiodeWatch(Level(lambda: next(looks)), SEEN))
        # stuck bright: a laser that is off is said to be on
        monkeypatch.setattr("rigs.capture.light_off_time.WATCHED_S", 0.3)
        stuck = PhotodiodeWatch(Level(lambda: 700), SEEN)
        assert after_exception(real_time, 1, stuck).still_on == 1


def emptied(diode) -> None:
    """Read what was said before it fell silent."""
    with contextlib.suppress(TimedOutError):
        while True:
            diode.read(0.1)


def test_a_silent_one_is_an_error(tmp_path: Path) -> None:
    with diode_board(tmp_path, lambda: True) as board, open_photodiode(str(board.port.path)) as diode:
        watch = PhotodiodeWatch(diode, SEEN)
        require_seen(watch)
        board.is_silent = True
        emptied(diode)
        with pytest.raises(TimedOutError, match=r"no reading for 0\.3 s; check its cable and supply"):
            watch.look()


def test_damaged_lines_for_ever_are_told_in_time(tmp_path: Path) -> None:
    with diode_board(tmp_path, lambda: True) as board, open_photodiode(str(board.port.path)) as diode:
        diode.read(0.5)
        board.is_damaged = True
        told: list[str] = []

        def read() -> None:
            try:
                for _ in range(1000):
                    diode.read(0.3)
            except TimedOutError as error:
                told.append(str(error))

        reader = threading.Thread(target=read, daemon=True)
        reader.start()
        reader.join(3.0)
        assert told, "still waiting after 3 s"
        assert "sent only corrupted data for 0.3 s" in told[0]


def test_the_practice_rig_has_one(tmp_path: Path) -> None:
    rig = simulated_rig("red", width_px=320, height_px=256)
    with open_rig(rig, tmp_path) as opened, opened.photodiode("simulated") as diode:
        contrast = find_contrast(opened, diode)
        assert (contrast.off_rel, contrast.on_rel) == pytest.approx((12 / 1023, 800 / 1023))
        block = after_exception(opened, 3, PhotodiodeWatch(diode, contrast))
    assert (block.witness, block.still_on, len(block.latest_s)) == ("a photodiode", 0, 3)


@pytest.mark.rigs
def test_it_sees_the_guard_and_the_dead_man_of_the_firmware(tmp_path: Path) -> None:
    """The laser's unchanged firmware in QEMU; the board's light is what that firmware says of its pin."""
    with firmware_board(build(tmp_path)) as laser_board:
        laser = LaserSettings(
            driver="arduino", address=laser_board.address, wavelength_nm=450.0, power_mw=4.5, laser_class="3R"
        )
        with diode_board(tmp_path, lambda: pin_is_on(laser_board)) as board:
            with open_photodiode(str(board.port.path)) as diode:
                watch = PhotodiodeWatch(diode, SEEN)
                guard = after_kill(laser, "guard", watch, 2)
                dead_man = after_kill(laser, "dead-man", watch, 2)
            assert (guard.still_on, guard.witness, dead_man.still_on) == (0, "a photodiode", 0)
            assert max(guard.latest_s) < 0.5
            # 0.40 s by the firmware's timer, resolved to a reading: no question kept the dead-man from acting
            assert 0.3 < min(dead_man.latest_s) <= max(dead_man.latest_s) < 0.7
            board.is_unplugged = True
            with (
                open_photodiode(str(board.port.path)) as diode,
                pytest.raises(CaptureError, match="does not see the laser"),
            ):
                after_kill(laser, "guard", PhotodiodeWatch(diode, SEEN), 1)
            assert not laser_board.state()


def pin_is_on(board: Tap) -> bool:
    """Whether the last that the laser's board said of its pin is that it is on."""
    for line in reversed(list(board.lines)):
        if line.who == "device" and line.text.strip() in (b"ON", b"OFF", b"TRIP"):
            return line.text.strip() == b"ON"
    return False


@pytest.mark.rigs
def test_unchanged_firmware_in_qemu(tmp_path: Path) -> None:
    """QEMU has no analogue input: the level is always 0, which is what an unplugged photodiode reads."""
    elf = firmware_in_qemu.build(tmp_path, Path(lights.__file__).parent / "firmware" / "photodiode.c")
    port, qemu = free_port(), require("qemu-system-avr", "qemu-system-misc")
    command = [qemu, "-M", "uno", "-bios", str(elf), "-nographic", "-serial", f"tcp:127.0.0.1:{port},server=on,wait=on"]
    with subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL) as board:
        try:
            text = heard(port)
        finally:
            board.kill()
    first, *lines = text.split(b"\n")[:-1]
    assert first == b"LIGHT 1.1"
    readings = [line.split() for line in lines if line.startswith(b"L ")]
    assert [int(r[1]) for r in readings] == list(range(len(readings)))
    assert {r[3] for r in readings} == {b"0"}
    for words in readings:
        assert int(words[4], 16) == crc8(b" ".join(words[:4]))
    milliseconds = [int(r[2]) for r in readings]
    assert all(10 <= later - sooner < 40 for sooner, later in pairwise(milliseconds))


def heard(port: int) -> bytes:
    """Return a second of readings, with the answer to a question among them."""
    text = b""
    line: socket.socket
    with connected(port) as line:
        line.settimeout(5.0)
        while text.count(b"\n") < 60:
            text += line.recv(4096)
        line.sendall(b"I\n")
        while b"LIGHT 1.1\n" not in text.partition(b"\nL ")[2]:
            text += line.recv(4096)
    return text


@pytest.mark.parametrize("address", ["/dev/ttyACM1", "simulated"])
def test_its_address_fits_the_rig(address: str) -> None:

    rig = simulated_rig("red", width_px=320, height_px=256)
    plan = CheckPlan(check_name="x", region=paint_plan("red", rig.camera).region, photodiode=address)
    if address == "simulated":
        assert check_session.check_filters(plan, rig)
    else:
        with pytest.raises(CaptureError, match=r"plan\.photodiode = '/dev/ttyACM1': must be 'simulated'"):
            check_session.check_filters(plan, rig)
