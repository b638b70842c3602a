"""The GRBL stage and the HX711 cell on boards of our own, in QEMU, and on grblHAL's simulator where there is one."""

import contextlib
import os
import socket
import subprocess
import threading
import time
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace

import pytest
from serial.tools import list_ports
from serial.tools.list_ports_common import ListPortInfo

from data_schemas import (
    CaptureError,
    LoadCellSettings,
    LostError,
    RefusedError,
    StageSettings,
    TimedOutError,
    UnsafeError,
    WrongPositionError,
)
from rigs import ForceLimitError, OverloadError, load_cells
from rigs.load_cells.hx711 import Hx711Cell, open_load_cell
from rigs.stages.grbl import GrblStage, open_stage
from rigs.transports import line_crc8
from tests.capture.drivers import firmware_in_qemu
from tests.capture.drivers.press_bench import PressBench, crc8, press_bench
from tests.capture.drivers.programs import free_port, require, wait_until

SIMULATOR = os.environ.get("FINRAY_GRBL_SIMULATOR", "")
FAST_MM_PER_S = 4.0


def nothing() -> None:
    """Watch nothing."""


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[PressBench]:
    with press_bench(tmp_path) as running:
        yield running


def stage_settings(address: str, **other: object) -> StageSettings:
    fields = {"press_travel_mm": (-20.0, 0.0), "pad_travel_mm": (0.0, 40.0), "base_mm": 0.0, "clear_mm": 0.0}
    return StageSettings.model_validate({**fields, "driver": "grbl", "address": address, "homing": "switches", **other})


def cell_settings(address: str, **other: object) -> LoadCellSettings:
    fields = {"driver": "hx711", "address": address, "capacity_n": 20.0, "force_limit_n": 5.0}
    return LoadCellSettings.model_validate({**fields, **other})


@pytest.fixture
def stage(bench: PressBench) -> Iterator[GrblStage]:
    with open_stage(stage_settings(str(bench.controller.port.path))) as opened:
        yield opened


@pytest.fixture
def homed(stage: GrblStage) -> GrblStage:
    stage.home(10.0, nothing)
    return stage


def test_place_is_unknown_until_homed(stage, bench):
    assert stage.identity().firmware == "1.1h"
    assert stage.places_mm() is None
    with pytest.raises(RefusedError, match="home it first"):
        stage.move("Z", -1.0, FAST_MM_PER_S, nothing)
    assert not [line for line in bench.controller.lines if line.startswith("$J")]
    stage.home(10.0, nothing)
    assert stage.places_mm() == {"X": 0.0, "Y": 0.0, "Z": 0.0}


def test_a_count_that_is_asked_for_is_not_trusted(stage, bench):
    bench.controller.state = "Idle"
    assert set(stage.counted_mm()) == set("XYZ")
    assert stage.places_mm() is None
    stage.trust_places()
    assert stage.places_mm() is not None


def test_moves_are_absolute_and_arrive(homed, bench):
    for to_mm in (-1.0, -1.05, -0.4, -0.4):
        homed.move("Z", to_mm, FAST_MM_PER_S, nothing)
        assert homed.places_mm()["Z"] == pytest.approx(to_mm, abs=1.0 / 400.0)
    homed.move("X", 12.5, 40.0, nothing)
    assert bench.controller.at_mm["X"] == pytest.approx(12.5, abs=1e-6)
    assert all("G90G53" in line for line in bench.controller.lines if line.startswith("$J"))


def test_a_report_that_was_asked_for_before_is_not_taken_for_the_next(homed, bench):
    """A cell that reads 10 times a second left one behind at each move; a session then ended after some 20 moves."""
    for to_mm in (-1.0, -0.8, -0.6):
        homed.move("Z", to_mm, FAST_MM_PER_S, lambda: time.sleep(0.1))
    bench.controller.at_mm["Z"] = -0.3
    assert homed.places_mm()["Z"] == pytest.approx(-0.3, abs=0.001)


def test_reports_in_inches_are_read(bench):
    bench.controller.inches = True
    with open_stage(stage_settings(str(bench.controller.port.path))) as stage:
        stage.home(10.0, nothing)
        stage.move("Z", -2.0, FAST_MM_PER_S, nothing)
        assert stage.places_mm()["Z"] == pytest.approx(-2.0, abs=0.003)


def test_travel_of_the_rig_file_is_kept_before_anything_moves(homed, bench):
    for axis, to_mm in (("Z", -20.5), ("Z", 0.1), ("X", 41.0), ("Y", 1.0)):
        with pytest.raises(RefusedError, match=r"outside its travel|has no axis"):
            homed.move(axis, to_mm, FAST_MM_PER_S, nothing)
    assert not [line for line in bench.controller.lines if line.startswith("$J")]


def test_own_travel_of_the_controller_is_told_in_words(bench):
    wide = stage_settings(str(bench.controller.port.path), press_travel_mm=(-90.0, 0.0))
    with open_stage(wide) as stage:
        stage.home(10.0, nothing)
        with pytest.raises(RefusedError, match=r"error 15 .the end of the move lies beyond its own travel"):
            stage.move("Z", -80.0, FAST_MM_PER_S, nothing)
        stage.move("Z", -1.0, FAST_MM_PER_S, nothing)


def test_no_homing_switches(stage, bench):
    bench.controller.has_homing = False
    with pytest.raises(RefusedError, match=r"error 5 .homing is switched off"):
        stage.home(10.0, nothing)
    assert stage.places_mm() is None


@pytest.mark.parametrize("kind", [ForceLimitError, KeyboardInterrupt, LostError])
def test_what_the_watch_raises_stops_the_stage_with_its_place_kept(homed, bench, kind):
    began_s = time.monotonic()

    def watch() -> None:
        if time.monotonic() - began_s > 0.4:
            raise kind("enough")

    with pytest.raises(kind):
        homed.move("Z", -19.0, 2.0, watch)
    assert bench.rests
    assert bench.controller.alarms == []
    at_mm = homed.places_mm()["Z"]
    assert at_mm == pytest.approx(bench.controller.at_mm["Z"], abs=0.003)
    # 0.4 s at 2 mm/s, and the way of reacting and braking: 0.5 s more of a busy computer
    assert -2.0 < at_mm < -0.1
    homed.move("Z", 0.0, FAST_MM_PER_S, nothing)


def test_reset_in_the_midst_of_a_move_loses_the_place(homed, bench):
    threading.Timer(0.4, bench.controller.reset).start()
    with pytest.raises((LostError, RefusedError), match=r"alarm 3 .it was reset while it moved|restarted"):
        homed.move("Z", -19.0, 2.0, nothing)
    assert bench.rests
    assert homed.places_mm() is None
    with pytest.raises(RefusedError, match="home it first"):
        homed.move("Z", 0.0, FAST_MM_PER_S, nothing)
    homed.home(10.0, nothing)
    homed.move("Z", -1.0, FAST_MM_PER_S, nothing)


def test_controller_that_restarted_at_the_stop_has_lost_its_place(homed, bench, monkeypatch):
    """Its supply broke down: it greets as after our reset, is not locked ($22=0), and counts from 0."""
    homed.move("Z", -1.0, FAST_MM_PER_S, nothing)
    reset = bench.controller.reset

    def cold() -> None:
        reset()
        bench.controller.at_mm, bench.controller.state = {"X": 0.0, "Y": 0.0, "Z": 0.0}, "Idle"

    homed.stop()
    assert homed.places_mm()["Z"] == pytest.approx(-1.0, abs=0.003)
    monkeypatch.setattr(bench.controller, "reset", cold)
    homed.stop()
    assert homed.places_mm() is None


def test_detection_changes_nothing(bench, monkeypatch):
    from rigs.stages import grbl

    ports = [
        SimpleNamespace(address=str(port.path), usb_id="1a86:7523")
        for port in (bench.controller.port, bench.amplifier.port)
    ]
    monkeypatch.setattr(grbl, "usb_serial_ports", lambda: ports)
    monkeypatch.setattr(bench.controller, "reset", lambda: pytest.fail("it was reset"))
    bench.controller.state = "Run"
    assert grbl.found() == [(str(bench.controller.port.path), "GRBL")]
    assert bench.controller.lines == []


def test_mute_controller_is_stopped_by_a_reset(homed, bench):
    def mute() -> None:
        bench.controller.is_mute = True

    threading.Timer(0.3, mute).start()
    with pytest.raises(UnsafeError, match=r"NOT SEEN TO STOP.*may continue to Z = -19.000 mm, the end of its move"):
        homed.move("Z", -19.0, 1.0, nothing)
    # it hears although it does not speak
    assert bench.rests
    assert bench.controller.at_mm["Z"] > -6.0


def test_pulled_cable_ends_in_a_stop_when_it_is_back(homed, bench):
    threading.Timer(0.3, bench.controller.port.pull).start()
    threading.Timer(1.0, bench.controller.port.plug).start()
    with pytest.raises(LostError, match="connection broke"):
        homed.move("Z", -19.0, 1.0, nothing)
    assert bench.rests
    assert bench.controller.at_mm["Z"] > -6.0
    assert homed.places_mm() is None


def test_cable_that_stays_away_says_how_far_it_drives(homed, bench):
    threading.Timer(0.2, bench.controller.port.pull).start()
    # the whole way, not a step of the rig file
    with pytest.raises(UnsafeError, match=r"may continue to Z = -1.000 mm, the end of its move; switch its motors off"):
        homed.move("Z", -1.0, 1.0, nothing)


def test_another_board_at_the_address_of_the_stage_is_not_driven(bench, monkeypatch):
    """The cable is pulled, and another controller comes back under the port's name: ours may still move."""
    port, heard = bench.controller.port, list[int]()
    usb = ListPortInfo(os.path.realpath(port.path))
    usb.vid, usb.pid, usb.serial_number = 0x2341, 0x0043, "A"
    monkeypatch.setattr(list_ports, "comports", lambda *_: [usb])

    def replug() -> None:
        port.pull()
        time.sleep(0.1)
        monkeypatch.setattr(bench.controller, "_byte", heard.append)
        usb.serial_number = "B"
        port.plug()
        usb.device = os.path.realpath(port.path)

    with open_stage(stage_settings(str(port.path))) as stage:
        stage.home(10.0, nothing)
        threading.Timer(0.3, replug).start()
        with pytest.raises(UnsafeError, match=r"NOT SEEN TO STOP: .*another board .*'B', but 'A' before.*Z = -"):
            stage.move("Z", -19.0, 1.0, nothing)
        with pytest.raises(UnsafeError, match="another board answers now"):
            stage.stop()
        with pytest.raises(LostError):
            stage.places_mm()
    assert heard == []


def test_stage_that_rests_elsewhere_is_told(homed, bench, monkeypatch):
    def jog(axis: str, to_mm: float, speed_mm_per_s: float) -> None:
        bench.controller.port.say(b"ok\r\n")

    monkeypatch.setattr(bench.controller, "_jog", jog)
    with pytest.raises(WrongPositionError, match=r"was sent to -1.000 mm, but stands at 0.000 mm"):
        homed.move("Z", -1.0, FAST_MM_PER_S, nothing)


def test_homing_is_ended_by_a_reset(stage, bench):
    def watch() -> None:
        if bench.controller.state == "Home":
            raise ForceLimitError("it presses")

    with pytest.raises(ForceLimitError):
        stage.home(10.0, watch)
    wait_until(lambda: bench.controller.state == "Alarm", "the alarm", 3.0)
    assert bench.controller.alarms == [6]
    assert stage.places_mm() is None


def test_something_else_at_the_port(bench):
    with pytest.raises(TimedOutError, match="no GRBL controller"):
        open_stage(stage_settings(str(bench.amplifier.port.path))).__enter__()


def test_check_byte_is_that_of_the_polynomial():
    assert line_crc8(b"123456789") == 0xF4  # the catalogue's check value of CRC-8/SMBUS
    assert line_crc8(b"R 421 12345 -83211 0") == crc8(b"R 421 12345 -83211 0")


@pytest.fixture
def cell(bench):
    with open_load_cell(cell_settings(str(bench.amplifier.port.path))) as opened:
        yield opened


def test_readings_are_fresh_and_signed(cell, bench):
    readings = [cell.read(0.5) for _ in range(20)]
    assert all(later.at_s > sooner.at_s for sooner, later in pairwise(readings))
    assert sum(r.counts for r in readings) / 20 == pytest.approx(-20_000, abs=100)


def test_damaged_lines_are_passed_over(cell, bench):
    bench.amplifier.damaged_share = 0.5
    counts = [cell.read(0.5).counts for _ in range(40)]
    assert max(abs(c + 20_000) for c in counts) < 400  # noise of 40 counts


def test_old_readings_are_passed_over(cell, bench):
    bench.amplifier.noise_counts = 4_000  # tells one line from another
    cell.read(0.5)
    time.sleep(1.0)  # some 80 lines wait
    waiting, asked_s = len(bench.amplifier.lines), time.monotonic()
    reading = cell.read(0.5)
    assert waiting > 20
    assert reading.at_s >= asked_s - 0.25  # 0.2 s that a reading may wait, and what a line takes
    fresh = bench.amplifier.lines[waiting - 17 :]  # 0.2 s at 80 readings a second
    assert reading.counts in [int(line.split()[3]) for line in fresh]


@pytest.mark.parametrize("rate_hz", [10, 80])
@pytest.mark.parametrize("slow_rel", [-0.005, 0.005])
def test_clock_of_a_resonator_is_not_taken_for_lateness(monkeypatch, rate_hz, slow_rel):
    """An Uno's is allowed 0.5 %: an hour of readings, with a pause of two minutes after half of it."""
    clock = Ticking()
    monkeypatch.setattr("rigs.load_cells.hx711.time", clock)
    cell = Hx711Cell(BoardOnAClock(clock, rate_hz, slow_rel), cell_settings("/dev/none", rate_hz=rate_hz))
    for _ in range(1800 * rate_hz):
        cell.read(0.5)
    clock.now_s += 120.0
    for _ in range(1800 * rate_hz):
        read_at_s = cell.read(0.5).at_s
        assert clock.now_s - read_at_s < 0.04


class Ticking:
    now_s = 0.0

    def monotonic(self) -> float:
        return self.now_s


class BoardOnAClock:
    """The port of a board whose clock is slow by a share."""

    def __init__(self, clock: Ticking, rate_hz: int, slow_rel: float) -> None:
        self._clock, self._rate_hz, self._slow_rel, self._number = clock, rate_hz, slow_rel, -1
        self.late_s = self.made_s = 0.0

    def write(self, data: bytes, end_s: float) -> None: ...

    def read_until(self, terminator: bytes, end_s: float) -> bytes:
        self._number += 1
        if self._number == 0:
            return b"CELL 1.0\n"
        at_s = self._number / self._rate_hz
        self.made_s, self._clock.now_s = at_s, max(self._clock.now_s, at_s + self.late_s)
        text = f"R {self._number % 65536} {int(1e3 * at_s * (1.0 - self._slow_rel))} {self._number % 7} 0".encode()
        return text + b" %02X\n" % crc8(text)


def test_a_reading_carries_the_earliest_time_at_which_it_was_made(monkeypatch):
    """Also one that waited in a buffer: a step that ended meanwhile is not in it."""
    clock = Ticking()
    monkeypatch.setattr("rigs.load_cells.hx711.time", clock)
    board = BoardOnAClock(clock, 80, 0.0)
    cell = Hx711Cell(board, cell_settings("/dev/none"))
    for late_s in [0.0] * 40 + [0.005 * number for number in range(38)] + [0.19] * 40:
        board.late_s = late_s
        at_s = cell.read(0.5).at_s
        assert board.made_s - 0.035 < at_s < board.made_s  # 0.03 s for the line, 1 ms of the board's clock


def test_silent_cell_is_told_in_time(cell, bench):
    bench.amplifier.is_silent = True
    with contextlib.suppress(TimedOutError):
        while True:
            cell.read(0.1)
    began_s = time.monotonic()
    with pytest.raises(TimedOutError):
        cell.read(0.3)
    assert time.monotonic() - began_s < 0.8


def test_damaged_lines_for_ever_are_told_in_time(cell, bench):
    cell.read(0.5)
    # what it damages is a 1, and from here on every number of a line begins with one
    bench.amplifier._sequence, bench.amplifier.damaged_share = 10_000, 1.0  # noqa: SLF001
    ended: list[float | str] = []

    def read() -> None:
        began_s = time.monotonic()
        try:
            for _ in range(1000):  # what came whole before is read first
                began_s = time.monotonic()
                cell.read(0.3)
        except TimedOutError as error:
            ended.extend([time.monotonic() - began_s, str(error)])

    reader = threading.Thread(target=read, daemon=True)
    reader.start()
    reader.join(3.0)
    assert ended, "still waiting after 3 s"
    assert ended[0] < 0.8
    assert "sent only corrupted data for 0.3 s" in ended[1]


def read_on(cell: Hx711Cell, readings: int) -> None:
    """Read what is told only after what was said before it."""
    for _ in range(readings):
        cell.read(0.5)


@pytest.mark.parametrize(
    ("status", "error", "words"), [(1, OverloadError, "end of its scale"), (2, LostError, "HX711")]
)
def test_status_is_told(cell, bench, status, error, words):
    bench.amplifier.status = status
    with pytest.raises(error, match=words):
        read_on(cell, 40)


def test_restarted_board_is_told(cell, bench):
    for _ in range(20):
        cell.read(0.5)
    bench.amplifier.restart()
    with pytest.raises(LostError, match="restarted"):
        read_on(cell, 80)


@pytest.mark.rigs
def test_unchanged_firmware_in_qemu(tmp_path):
    """QEMU reads DT as low: an amplifier that is always ready and never raises DT, which is status 2."""
    elf = firmware_in_qemu.build(tmp_path, Path(load_cells.__file__).parent / "firmware" / "cell.c")
    port = free_port()
    qemu = require("qemu-system-avr", "qemu-system-misc")
    command = [qemu, "-M", "uno", "-bios", str(elf), "-nographic", "-serial", f"tcp:127.0.0.1:{port},server=on,wait=on"]
    with subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL) as board:
        try:
            text = b""
            with connected(port) as line:
                line.settimeout(5.0)
                while text.count(b"\n") < 60:
                    text += line.recv(4096)
                line.sendall(b"I\n")
                while b"CELL 1.0\n" not in text.partition(b"\nR ")[2]:
                    text += line.recv(4096)
        finally:
            board.kill()
    first, *lines = text.split(b"\n")[:-1]
    assert first == b"CELL 1.0"
    readings = [line.split() for line in lines if line.startswith(b"R ")]
    assert [int(r[1]) for r in readings] == list(range(len(readings)))
    assert {(r[3], r[4]) for r in readings} == {(b"0", b"2")}
    for words in readings:
        assert int(words[5], 16) == crc8(b" ".join(words[:5]))
    milliseconds = [int(r[2]) for r in readings]
    # paced by the firmware to 10 ms and more, by its own clock
    assert all(10 <= later - sooner < 40 for sooner, later in pairwise(milliseconds))


def connected(port: int) -> socket.socket:
    """Connect to a program that has just been started."""
    end_s = time.monotonic() + 10.0
    while True:
        try:
            return socket.create_connection(("127.0.0.1", port))
        except OSError:
            if time.monotonic() > end_s:
                raise
            time.sleep(0.05)


@pytest.mark.rigs
@pytest.mark.skipif(not SIMULATOR, reason="FINRAY_GRBL_SIMULATOR names no grblHAL_sim")
def test_grblhal_simulator(tmp_path, monkeypatch):
    # under load it answers in seconds: what is tested is the protocol
    for name in ("ANSWER_WITHIN_S", "TAKEN_WITHIN_S", "STOP_WITHIN_S"):
        monkeypatch.setattr(f"rigs.stages.grbl.{name}", 8.0)
    port = free_port()
    with subprocess.Popen(
        [SIMULATOR, "-n", "-t", "1", "-p", str(port)], cwd=tmp_path, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL
    ) as program:
        try:
            connected(port).close()
            time.sleep(1.0)
            drive_grblhal(stage_settings(f"socket://127.0.0.1:{port}", homing="by hand"))
        finally:
            program.kill()


def drive_grblhal(settings: StageSettings) -> None:
    with open_stage(settings) as stage:
        assert stage.places_mm() is None
        assert stage.counted_mm() == {"X": 0.0, "Y": 0.0, "Z": 0.0}
        assert stage.places_mm() is None
        assert stage.trust_places() == {"X": 0.0, "Y": 0.0, "Z": 0.0}
        for to_mm in (-0.05, -0.1, -0.5, 0.0):
            stage.move("Z", to_mm, 1.0, nothing)
            assert stage.places_mm()["Z"] == pytest.approx(to_mm, abs=0.005)
        began_s = time.monotonic()

        def watch() -> None:
            if time.monotonic() - began_s > 1.6:
                raise ForceLimitError("enough")

        with pytest.raises(ForceLimitError):
            stage.move("Z", -10.0, 2.0, watch)
        at_mm = stage.places_mm()
        # the simulator reads a byte every few milliseconds, so that a stop takes it tenths of a second
        assert at_mm is not None
        assert -8.0 < at_mm["Z"] < 0.0
        stage.move("Z", 0.0, 5.0, nothing)
        with pytest.raises(CaptureError, match="homing is switched off"):
            stage.home(10.0, nothing)
