"""The photodiode as a witness of the laser: a board of our own, the unchanged firmware in QEMU, and how it may lie."""

import contextlib
import socket
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import pytest

from data_schemas import CaptureError, CheckPlan, LaserSettings, RefusedError, TimedOutError
from rigs import SystemClock, lights, open_rig, paint_plan, simulated_rig
from rigs.capture import _check_session as check_session
from rigs.capture.light_off_time import (
    Contrast,
    PhotodiodeWatch,
    after_exception,
    after_kill,
    find_contrast,
    require_seen,
)
from rigs.light_guard import LightLevel, open_photodiode
from tests.capture.drivers import firmware_in_qemu
from tests.capture.drivers.firmware_in_qemu import Tap, build, firmware_board
from tests.capture.drivers.press_bench import Port, crc8
from tests.capture.drivers.programs import free_port, require
from tests.capture.drivers.test_stage_and_cell import connected

SEEN = Contrast(3 / 1023, 700 / 1023)


class DiodeBoard:
    """The side of the board: a reading every 10 ms of what `light` says, on a clock of its own."""

    def __init__(self, port: Port, light: Callable[[], bool]) -> None:
        self.port, self.light, self.is_unplugged, self.is_silent, self.is_damaged = port, light, False, False, False
        self.greets = b"LIGHT 1.0\n"
        self._end, self._heard = threading.Event(), b""
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
            at_ms = int(1e3 * (time.monotonic() - began_s))
            text = f"L {number % 65536} {at_ms} {level + number % 3}".encode()
            number += 1
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
        assert all(0.005 < later.at_s - sooner.at_s < 0.05 for sooner, later in pairwise(waited))


def test_other_boards_are_refused(tmp_path: Path) -> None:
    with diode_board(tmp_path, lambda: False) as board:
        board.greets = b"LIGHT 2.0\n"
        with pytest.raises(RefusedError, match=r"firmware 2\.0; .* flash rigs/lights/firmware/photodiode.c"):
            open_photodiode(str(board.port.path)).__enter__()
        board.greets = b""
        with pytest.raises(TimedOutError, match=r"does not greet within 3\.5 s; check the cable"):
            open_photodiode(str(board.port.path)).__enter__()


class Level:
    """A photodiode whose reading is told."""

    def __init__(self, level: Callable[[], int]) -> None:
        self._level = level

    def read(self, deadline_s: float) -> LightLevel:
        time.sleep(0.001)
        return LightLevel(self._level(), time.monotonic())


def test_one_that_reads_dark_all_the_while_has_no_contrast() -> None:

    with open_rig(simulated_rig("red", width_px=64, height_px=64), Path()) as opened:
        real_time = replace(opened, clock=SystemClock())
        assert find_contrast(real_time, Level(lambda: 3)) is None  # unplugged
        assert find_contrast(real_time, Level(lambda: 900)) is None  # room light
        assert find_contrast(real_time, Level(lambda: 30 if opened.laser.state() else 3)) is None  # too faint
        seen = find_contrast(real_time, Level(lambda: 700 if opened.laser.state() else 3))
        assert (seen.off_rel, seen.on_rel) == pytest.approx((SEEN.off_rel, SEEN.on_rel))


def test_one_that_goes_blind_proves_nothing(monkeypatch) -> None:

    with open_rig(simulated_rig("red", width_px=64, height_px=64), Path()) as opened:
        real_time = replace(opened, clock=SystemClock())
        seen = PhotodiodeWatch(Level(lambda: 700 if opened.laser.state() else 3), SEEN)
        block = after_exception(real_time, 2, seen)
        assert (block.witness, block.still_on, len(block.latest_s)) == ("a photodiode", 0, 2)
        assert all(a <= b < 0.2 for a, b in zip(block.earliest_s, block.latest_s, strict=True))
        with pytest.raises(CaptureError, match="a photodiode does not see it"):
            after_exception(real_time, 1, PhotodiodeWatch(Level(lambda: 3), SEEN))
        # unplugged in the very mishap: it read "off" at once, and does not see the laser on afterwards
        looks = iter([700, 3, *([3] * 10_000)])
        with pytest.raises(CaptureError, match="does not see it"):
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
        assert "only damaged lines came for 0.3 s" in told[0]


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
            with open_photodiode(str(board.port.path)) as diode, pytest.raises(CaptureError, match="does not see it"):
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
    assert first == b"LIGHT 1.0"
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
        while b"LIGHT 1.0\n" not in text.partition(b"\nL ")[2]:
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
