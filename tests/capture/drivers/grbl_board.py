"""A GRBL 1.1 board on a pseudo-terminal, after its documentation and source: one X axis that turns a wheel.

``position`` is what the board counts, in slots; ``slipped`` is how many slots its motor lost, which no stepper tells.
"""

import contextlib
import os
import pty
import re
import select
import threading
import time
import tty
from collections.abc import Iterator
from contextlib import contextmanager

SLOTS_PER_S = 40.0
HOMING_S = 0.15
PULLED_OFF = -0.1
BANNER = "\r\nGrbl 1.1h ['$' for help]\r\n"
LOCKED = "[MSG:'$H'|'$X' to unlock]\r\n"


class GrblBoard:
    """The board's side of the serial line; :func:`grbl_board` runs it."""

    def __init__(self, steps_per_slot: float = 400.0, slipped: int = 0) -> None:
        self._ours, self._theirs = pty.openpty()
        for end in (self._ours, self._theirs):
            tty.setraw(end)
        self.address = os.ttyname(self._theirs)
        self.steps_per_slot, self.slipped = steps_per_slot, slipped
        self.position, self.homings, self.is_mute, self.slots_per_s = 0.0, 0, False, SLOTS_PER_S
        self._is_locked, self._targets, self._homes_at_s = True, list[float](), 0.0
        self._now_s, self._line, self._end = time.monotonic(), b"", threading.Event()
        self.thread = threading.Thread(target=self._work, daemon=True)

    def in_beam(self) -> int | None:
        """Return the slot that light really passes; None between two."""
        slot = -self.position + self.slipped
        return (round(slot) - 1) % 8 + 1 if abs(slot - round(slot)) < 0.02 and not self._targets else None

    def close(self) -> None:
        self._end.set()
        self.thread.join()
        os.close(self._ours)
        os.close(self._theirs)

    def _work(self) -> None:
        while not self._end.is_set():
            readable = select.select([self._ours], [], [], 0.002)[0]
            self._turn()
            if readable:
                with contextlib.suppress(OSError):
                    self._hear(os.read(self._ours, 4096))

    def _turn(self) -> None:
        """Let the motor turn for as long as has passed."""
        now_s = time.monotonic()
        reach, self._now_s = (now_s - self._now_s) * self.slots_per_s, now_s
        if self._homes_at_s and now_s >= self._homes_at_s:
            self.position, self._homes_at_s, self._is_locked = PULLED_OFF, 0.0, False
            self.homings += 1
            self._say("ok\r\n")
        while self._targets and reach > 0.0:
            way = self._targets[0] - self.position
            self.position += max(-reach, min(reach, way))
            reach -= abs(way)
            if self.position == self._targets[0]:
                del self._targets[0]

    def _hear(self, words: bytes) -> None:
        for byte in words:
            if byte == 0x18:
                self._reset()
            elif byte == ord("?"):  # answered at once, whatever line is being written
                state = "Alarm" if self._is_locked else "Run" if self._targets else "Idle"
                self._say(f"<{state}|MPos:{self.position:.3f},0.000,0.000|FS:0,0>\r\n")
            elif byte == ord("\n"):
                line, self._line = self._line.decode().strip(), b""
                self._do(line)
            else:
                self._line += bytes([byte])

    def _reset(self) -> None:
        if self._targets or self._homes_at_s:
            self._is_locked = True
            self._say("ALARM:3\r\n")
        self._targets, self._homes_at_s, self._line = [], 0.0, b""
        self._say(BANNER + (LOCKED if self._is_locked else ""))

    def _do(self, line: str) -> None:
        if line == "$H":
            self._homes_at_s = time.monotonic() + HOMING_S
        elif line == "$I":
            self._say("[VER:1.1h.20190825:]\r\n[OPT:V,15,128]\r\nok\r\n")
        elif line == "$$":
            self._say(f"$0=10\r\n$22=1\r\n$100={self.steps_per_slot:.3f}\r\n$110=500.000\r\nok\r\n")
        elif not line:
            self._say("ok\r\n")
        elif match := re.fullmatch(r"G53 G0 X(-?\d+\.\d+)", line):
            if not self._is_locked:
                self._targets.append(float(match[1]))
            self._say("error:9\r\n" if self._is_locked else "ok\r\n")
        else:
            self._say("error:20\r\n")

    def _say(self, words: str) -> None:
        if not self.is_mute:
            os.write(self._ours, words.encode())


@contextmanager
def grbl_board(steps_per_slot: float = 400.0, slipped: int = 0) -> Iterator[GrblBoard]:
    """Run a board for a ``with`` block."""
    board = GrblBoard(steps_per_slot, slipped)
    board.thread.start()
    try:
        yield board
    finally:
        board.close()
