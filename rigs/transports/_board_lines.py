"""Lines that boards with our firmware say unasked: their check byte, and their clock beside that of this computer."""

import math
import time
from typing import Final

from data_schemas import LostError

CREEP_REL: Final = 0.01
"""By how much the board's clock may be wrong: the ceramic resonator of an Uno is allowed 0.5 % and ages."""
MILLISECONDS: Final = 2**32


def check_byte(text: bytes) -> int:
    """Return the CRC-8 of a line: polynomial x^8 + x^2 + x + 1, initial value 0, most significant bit first."""
    crc = 0
    for byte in text:
        crc ^= byte
        for _ in range(8):
            crc = (crc << 1 ^ 0x07) & 0xFF if crc & 0x80 else crc << 1
    return crc


class BoardClock:
    """The clock of a board (ms since its reset), and how late its lines come.

    Parameters
    ----------
    device
        What the board is, for messages: "load cell at /dev/ttyACM0".
    """

    def __init__(self, device: str) -> None:
        self._device = device
        self._last_ms, self._least_late_s, self._last_s = 0, math.inf, time.monotonic()

    @property
    def heard_s(self) -> float:
        """When the last line came, by the monotonic clock."""
        return self._last_s

    def waited_s(self, at_ms: int, now_s: float) -> float:
        """Return how much later than the quickest line so far this one came (s); the board's clock wraps at 2^32 ms.

        Raises
        ------
        LostError
            The clock went back: the board restarted.
        """
        ahead_ms = (at_ms - self._last_ms) % MILLISECONDS
        if ahead_ms > MILLISECONDS // 2:
            raise LostError(f"{self._device}: its board restarted; check its supply and cable")
        self._last_ms += ahead_ms
        late_s = now_s - 1e-3 * self._last_ms
        # a board whose clock is slow would else look later and later
        self._least_late_s = min(late_s, self._least_late_s + CREEP_REL * (now_s - self._last_s))
        self._last_s = now_s
        return late_s - self._least_late_s
