"""A photodiode on an Arduino that sees a light: a witness that is neither the light's controller nor its driver.

The firmware is ``rigs/lights/firmware/photodiode.c``. Lines of ASCII at 57600 baud, a hundred a second, unasked:

    L SEQUENCE MILLISECONDS LEVEL CHECK

with the reading's number (0 to 65535, then 0 again), the board's clock (ms), the highest level since the line before
(0 to 1023 of the board's reference) and the CRC-8 (polynomial 0x07, two hexadecimal digits) of all before the last
space. It greets with ``LIGHT 1.1`` at every reset, and answers ``I`` with the same. It switches nothing. Version 1.0
gave one conversion in each line, which may miss a light that is pulsed.
"""

import contextlib
import re
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final, NamedTuple, Protocol

from data_schemas import LostError, RefusedError, TimedOutError
from rigs.transports import BoardClock, SerialLink, line_crc8

BAUD: Final = 57600
FIRMWARE_MAJOR: Final = 1
PEAK_MINOR: Final = 1
"""From this minor version on, a reading is the highest level since the one before."""
GREET_WITHIN_S: Final = 3.5
FULL_SCALE_LEVEL: Final = 1023
_LINE: Final = re.compile(rb"(L (\d{1,5}) (\d{1,10}) (\d{1,4})) ([0-9A-F]{2})\r?\n")
_BANNER: Final = re.compile(rb"LIGHT (\d{1,3})\.(\d{1,3})\r?\n")


class LightLevel(NamedTuple):
    """One reading: its level, and when it was made, at the latest, by the monotonic clock of this computer.

    It was made at most :data:`rigs.transports.LATENCY_S` before.
    """

    level: int
    at_s: float


class LightMeter(Protocol):
    """A device that reads the level of a light repeatedly."""

    @property
    def sees_pulses(self) -> bool:
        """Whether a reading holds all that was seen since the one before, so that no pulse is missed."""
        ...

    def read(self, deadline_s: float) -> LightLevel:
        """Return the next reading; at most `deadline_s` seconds."""
        ...


class Photodiode:
    """The photodiode behind one board.

    Parameters
    ----------
    link
        The open serial port.
    address
        Of the board, for messages.

    Raises
    ------
    TimedOutError
        Nothing speaks as the firmware does.
    RefusedError
        The firmware has another major version.
    """

    def __init__(self, link: SerialLink, address: str) -> None:
        self._link, self._name = link, f"photodiode at {address}"
        self._last: bytes | None = None
        self.sees_pulses = self._greet() >= PEAK_MINOR
        self._clock = BoardClock(self._name)

    def read(self, deadline_s: float) -> LightLevel:
        """Return the next reading, which may have waited in a buffer: its time is that of the board's clock.

        Raises
        ------
        TimedOutError
            None came before the deadline.
        LostError
            The connection broke, the board restarted, or says the same reading twice.
        """
        end_s = time.monotonic() + deadline_s
        while True:
            try:
                line = self._link.read_until(b"\n", end_s)
            except TimedOutError:
                raise TimedOutError(
                    f"{self._name}: sent no reading for {deadline_s:g} s; check its cable and supply"
                ) from None
            now_s = time.monotonic()
            match = _LINE.fullmatch(line)
            if match is not None and line_crc8(match[1]) == int(match[5], 16):
                if match[2] == self._last:
                    raise LostError(f"{self._name}: repeats reading {int(match[2])}, so its board is stuck; reset it")
                self._last = match[2]
                return LightLevel(int(match[4]), now_s - self._clock.waited_s(int(match[3]), now_s))
            if now_s >= end_s:
                raise TimedOutError(
                    f"{self._name}: sent only corrupted data for {deadline_s:.2g} s (such as {line[:32]!r}); check "
                    "the cable, and keep it away from the motors' wires"
                )

    def _greet(self) -> int:
        """Return the minor version of the firmware, also when opening the port has restarted the board."""
        for wait_s in (0.5, GREET_WITHIN_S - 0.5):
            end_s = time.monotonic() + wait_s
            self._link.write(b"\nI\n", end_s)
            with contextlib.suppress(TimedOutError):
                while time.monotonic() < end_s:  # lines that come all the while never let a read time out
                    if match := _BANNER.fullmatch(self._link.read_until(b"\n", end_s)):
                        if int(match[1]) == FIRMWARE_MAJOR:
                            return int(match[2])
                        raise RefusedError(
                            f"{self._name}: runs firmware {match[1].decode()}.{match[2].decode()}, but this version "
                            f"of finray needs {FIRMWARE_MAJOR}.x; flash rigs/lights/firmware/photodiode.c to the board"
                        )
        raise TimedOutError(
            f"{self._name}: sent no greeting within {GREET_WITHIN_S:g} s; check the cable and the address, and that "
            "its board runs rigs/lights/firmware/photodiode.c"
        )


@contextmanager
def open_photodiode(address: str) -> Iterator[LightMeter]:
    """Open the board for a ``with`` block."""
    with SerialLink(address, BAUD, "photodiode") as link:
        yield Photodiode(link, address)
