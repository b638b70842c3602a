"""A GRBL 1.1 controller that presses a pad, and an HX711 board that feels it, each on a pseudo-terminal, in real time.

Written after GRBL's documents and the firmware's own text; it shares no code with the drivers. The controller has a
line buffer of 128 bytes, one planned move, accelerations, jogs, feed hold, jog cancel, soft reset, homing, soft limits,
alarms and lost steps; the amplifier averages its last four conversions. Places are in mm, 0 is the homing switch.
"""

import contextlib
import math
import os
import pty
import random
import re
import select
import threading
import time
import tty
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

BUFFER_BYTES = 128
ACCELERATION_MM_PER_S2 = 200.0
STEPS_PER_MM = 400.0
N_PER_COUNT = 5e-6
TRAVEL_MM = 60.0


class Port:
    """A pseudo-terminal behind a name that stays when it is pulled and plugged in again."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._turn, self._ours, self._theirs = threading.Lock(), -1, -1
        self.plug()

    def plug(self) -> None:
        with self._turn:
            self._ours, self._theirs = pty.openpty()
            for end in (self._ours, self._theirs):
                tty.setraw(end)
            os.set_blocking(self._ours, False)  # what nobody reads is lost, as at a port that is not open
            self.path.unlink(missing_ok=True)
            self.path.symlink_to(os.ttyname(self._theirs))

    def pull(self) -> None:
        with self._turn:
            self.path.unlink(missing_ok=True)
            for end in (self._ours, self._theirs):
                if end >= 0:
                    os.close(end)
            self._ours = self._theirs = -1

    def heard(self) -> bytes:
        with self._turn, contextlib.suppress(OSError):
            if self._ours >= 0 and select.select([self._ours], [], [], 0)[0]:
                return os.read(self._ours, 4096)
        return b""

    def say(self, text: bytes) -> None:
        with self._turn, contextlib.suppress(OSError):
            if self._ours >= 0:
                os.write(self._ours, text)


class Controller:
    """The side of GRBL; `at_mm` is what it counts, `lost_mm` what its press axis did not go."""

    def __init__(self, port: Port) -> None:
        self.port = port
        self.at_mm = {"X": -5.0, "Y": 0.0, "Z": -0.5}
        self.lost_mm, self.loses_share = 0.0, 0.0
        self.is_mute, self.has_homing, self.inches = False, True, False
        self.state, self.alarms, self.lines, self.furthest_mm = "Alarm", [], [], 0.0
        self._axis, self._target_mm, self._speed_mm_per_s, self._fastest = "Z", 0.0, 0.0, 0.0
        self._rx, self._homes_s, self._holds, self._reports = b"", 0.0, False, 0

    @property
    def true_press_mm(self) -> float:
        return self.at_mm["Z"] + self.lost_mm

    def tick(self, dt_s: float) -> None:
        for byte in self.port.heard():
            self._byte(byte)
        if self.state == "Home":
            self._homes_s -= dt_s
            self.at_mm["Z"] = min(self.at_mm["Z"] + 20.0 * dt_s, 0.0)
            if self._homes_s <= 0.0:
                self.at_mm, self.state, self.lost_mm = {"X": 0.0, "Y": 0.0, "Z": 0.0}, "Idle", 0.0
                self._say("ok")
        elif self.state in ("Jog", "Hold:1"):
            self._drive(dt_s)
        while b"\n" in self._rx and self.state != "Home":
            line, _, self._rx = self._rx.partition(b"\n")
            self._line(line.decode("ascii", "replace").strip())

    def _drive(self, dt_s: float) -> None:
        way_mm = self._target_mm - self.at_mm[self._axis]
        brakes_mm = self._speed_mm_per_s**2 / (2.0 * ACCELERATION_MM_PER_S2)
        slower = self._holds or abs(way_mm) <= brakes_mm
        change = ACCELERATION_MM_PER_S2 * dt_s
        self._speed_mm_per_s = (
            max(self._speed_mm_per_s - change, 0.0 if self._holds else 0.05)
            if slower
            else min(self._speed_mm_per_s + change, self._fastest)
        )
        step_mm = math.copysign(min(self._speed_mm_per_s * dt_s, abs(way_mm)), way_mm)
        self.at_mm[self._axis] += step_mm
        if self._axis == "Z":
            self.lost_mm -= self.loses_share * min(step_mm, 0.0)
            self.furthest_mm = min(self.furthest_mm, self.true_press_mm)
        if self.at_mm[self._axis] == self._target_mm or (self._holds and self._speed_mm_per_s == 0.0):
            # a jog that was held is forgotten, by the document on jogging
            self.state, self._holds, self._speed_mm_per_s = "Idle", False, 0.0

    def _byte(self, byte: int) -> None:
        if byte == 0x18:
            self.reset()
        elif byte == ord("?"):
            if self.state != "Home":
                self._report()
        elif byte in (ord("!"), 0x85):
            if self.state == "Jog":
                self._holds = True
            elif self.state == "Idle" and byte == ord("!"):
                self.state = "Hold:0"
        elif len(self._rx) < BUFFER_BYTES:
            self._rx += bytes([byte])

    def reset(self) -> None:
        """A soft reset, or one by a spike on the supply."""
        if self.state in ("Jog", "Hold:1", "Home"):
            self._alarm(6 if self.state == "Home" else 3)
        elif self.state != "Alarm":
            self.state = "Idle"
        self._rx, self._holds, self._speed_mm_per_s, self._reports = b"", False, 0.0, 0
        self._say("\r\nGrbl 1.1h ['$' for help]")
        if self.state == "Alarm":
            self._say("[MSG:'$H'|'$X' to unlock]")

    def _alarm(self, number: int) -> None:
        self.state = "Alarm"
        self.alarms.append(number)
        self._say(f"ALARM:{number}")

    def _report(self) -> None:
        unit = 25.4 if self.inches else 1.0
        # motors go in whole steps
        places = [round(self.at_mm[a] * STEPS_PER_MM) / STEPS_PER_MM / unit for a in "XYZ"]
        text = ",".join(f"{at:.4f}" if self.inches else f"{at:.3f}" for at in places)
        extra = "|WCO:1.000,2.000,3.000" if self._reports % 10 == 0 else ""
        self._reports += 1
        self._say(f"<{self.state}|MPos:{text}|FS:0,0{extra}>")

    def _line(self, line: str) -> None:
        self.lines.append(line)
        if not line:
            self._say("ok")
        elif line == "$H":
            if self.has_homing:
                self.state, self._homes_s = "Home", 0.4
            else:
                self._say("error:5")
        elif line == "$X":
            self.state = "Idle"
            self._say("[MSG:Caution: Unlocked]\r\nok")
        elif line == "$$":
            inches, homing = int(self.inches), int(self.has_homing)
            self._say(
                f"$10=1\r\n$13={inches}\r\n$20=1\r\n$22={homing}\r\n$100=400.000\r\n$101=400.000\r\n$102=400.000\r\nok"
            )
        elif match := re.fullmatch(r"\$J=G21G90G53([XYZ])(-?\d+\.\d{3})F(\d+\.\d+)", line):
            self._jog(match[1], float(match[2]), float(match[3]) / 60.0)
        else:
            self._say("error:3" if line.startswith("$") else "error:20")

    def _jog(self, axis: str, to_mm: float, speed_mm_per_s: float) -> None:
        if self.state != "Idle":
            self._say("error:9")
        elif not -TRAVEL_MM <= (to_mm if axis == "Z" else -to_mm) <= 0.0:
            self._say("error:15")
        else:
            self._axis, self._target_mm, self._fastest, self.state = axis, to_mm, speed_mm_per_s, "Jog"
            self._say("ok")

    def _say(self, text: str) -> None:
        if not self.is_mute:
            self.port.say(f"{text}\r\n".encode())


class Amplifier:
    """The side of the HX711's board."""

    def __init__(self, port: Port, rate_hz: int) -> None:
        self.port, self.rate_hz = port, rate_hz
        self.is_stuck = self.is_silent = False
        self.damaged_share, self.status, self.noise_counts = 0.0, 0, 40
        self.lines: list[bytes] = []
        self._conversions: deque[float] = deque(maxlen=4)
        self._next_s = self._began_s = time.monotonic()
        self._sequence, self._counts, self._rx, self._random = 0, 0, b"", random.Random(3)

    def restart(self) -> None:
        self._began_s, self._sequence = time.monotonic(), 0
        self.port.say(b"CELL 1.0\n")

    def tick(self, now_s: float, force_n: float) -> None:
        self._rx += self.port.heard()
        if b"I\n" in self._rx:
            self._rx = b""
            self.port.say(b"CELL 1.0\n")
        if now_s < self._next_s:
            return
        self._next_s = max(self._next_s + 1.0 / self.rate_hz, now_s - 0.1)
        self._conversions.append(force_n / N_PER_COUNT + self._random.gauss(0.0, 2.0 * self.noise_counts))
        if not self.is_stuck:
            self._counts = round(-20_000 + sum(self._conversions) / len(self._conversions))
        if self.is_silent:
            return
        text = f"R {self._sequence} {int(1e3 * (now_s - self._began_s))} {self._counts} {self.status}".encode()
        self._sequence = (self._sequence + 1) % 65536
        line = text + b" %02X\n" % crc8(text)
        self.lines.append(line)
        if self._random.random() < self.damaged_share:
            line = line.replace(b"1", b"7")
        self.port.say(line)


def crc8(text: bytes) -> int:
    """CRC-8, polynomial 0x107, as a division of polynomials over two elements."""
    number = int.from_bytes(text, "big") << 8
    for place in range(number.bit_length() - 9, -1, -1):
        if number >> (place + 8) & 1:
            number ^= 0x107 << place
    return number


class PressBench:
    """Controller, amplifier and a pad whose surface is at `surface_mm` of the press axis."""

    def __init__(self, folder: Path, rate_hz: int = 80) -> None:
        self.controller = Controller(Port(folder / "stage-port"))
        self.amplifier = Amplifier(Port(folder / "cell-port"), rate_hz)
        self.surface_mm, self.stiffness_n_per_mm = -1.5, 4.0
        self.strongest_n, self.force_n, self._end = 0.0, 0.0, threading.Event()
        self._thread = threading.Thread(target=self._work, daemon=True)
        self._thread.start()

    @property
    def rests(self) -> bool:
        """Whether the press axis does not move."""
        before = self.controller.at_mm["Z"]
        time.sleep(0.3)
        return self.controller.at_mm["Z"] == before

    def close(self) -> None:
        self._end.set()
        self._thread.join()
        for port in (self.controller.port, self.amplifier.port):
            port.pull()

    def _work(self) -> None:
        last_s = time.monotonic()
        while not self._end.wait(0.001):
            now_s = time.monotonic()
            # a busy computer must not make the stage jump
            self.controller.tick(min(now_s - last_s, 0.02))
            depth_mm = max(self.surface_mm - self.controller.true_press_mm, 0.0)
            self.force_n = self.stiffness_n_per_mm * depth_mm
            self.strongest_n = max(self.strongest_n, self.force_n)
            self.amplifier.tick(now_s, self.force_n)
            last_s = now_s


@contextmanager
def press_bench(folder: Path, rate_hz: int = 80) -> Iterator[PressBench]:
    """Run both boards for a ``with`` block."""
    bench = PressBench(folder, rate_hz)
    try:
        yield bench
    finally:
        bench.close()
