"""A load cell behind an HX711 amplifier on an Arduino with the firmware of ``rigs/load_cells/firmware``.

Lines of ASCII at 57600 baud. The board says each reading once, unasked:

    R SEQUENCE MILLISECONDS COUNTS STATUS CHECK

with the reading's number (0 to 65535, then 0 again), the board's clock (ms), the signed 24-bit count, a status (0 good,
1 at the end of scale, 2 the amplifier does not answer as an HX711 does) and the CRC-8 (polynomial 0x07, two hexadecimal
digits) of all before the last space. It greets with ``CELL 1.0`` at every reset, and answers ``I`` with the same.
"""

import contextlib
import re
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final

from data_schemas import CaptureError, LoadCellSettings, LostError, PressDevice, RefusedError, TimedOutError
from rigs import CellReading, OverloadError
from rigs.transports import LATENCY_S, BoardClock, SerialLink, line_crc8, usb_serial_ports

BAUD: Final = 57600
FIRMWARE_MAJOR: Final = 1
FRESH_S: Final = 0.2
"""A reading that waited for longer in a buffer says nothing of the force now."""
BACKLOG_S: Final = 1e-3
"""A line that is there sooner had waited in a buffer."""
GREET_WITHIN_S: Final = 3.5
HIGHEST, LOWEST = 0x7FFFFF, -0x800000
BOARD_VENDORS: Final = ("2341", "2a03", "1a86")
_LINE: Final = re.compile(rb"(R (\d{1,5}) (\d{1,10}) (-?\d{1,7}) ([0-2])) ([0-9A-F]{2})\r?\n")
_BANNER: Final = re.compile(rb"CELL (\d{1,3})\.(\d{1,3})\r?\n")


class Hx711Cell:
    """The cell behind one board.

    Parameters
    ----------
    link
        The open serial port.
    settings
        The load cell of the rig file.

    Raises
    ------
    TimedOutError
        Nothing speaks as the firmware does.
    RefusedError
        The firmware has another major version.
    """

    def __init__(self, link: SerialLink, settings: LoadCellSettings) -> None:
        self._link, self._settings = link, settings
        self._name = f"load cell at {settings.address}"
        self._clock = BoardClock(self._name)
        self._version = self._greet()

    def identity(self) -> PressDevice:
        """Return what the board said when it was opened."""
        model = self._settings.model or "HX711 on an Arduino"
        address = self._settings.address
        return PressDevice(role="load cell", driver="hx711", address=address, model=model, firmware=self._version)

    def read(self, deadline_s: float) -> CellReading:
        """Return the next fresh reading; see :class:`rigs.LoadCell`."""
        asked_s = time.monotonic()
        end_s, is_backlog = asked_s + deadline_s, asked_s - self._clock.heard_s > FRESH_S
        while True:
            began_s = time.monotonic()
            line = self._link.read_until(b"\n", end_s)
            now_s = time.monotonic()
            is_backlog &= now_s - began_s < BACKLOG_S
            match = _LINE.fullmatch(line)
            if match is None or line_crc8(match[1]) != int(match[6], 16):
                if now_s >= end_s:
                    raise TimedOutError(
                        f"{self._name}: sent only corrupted data for {deadline_s:.2g} s (such as {line[:32]!r}); "
                        "check the cable, and keep it away from the motors' wires"
                    )
                continue  # damaged on the way, or a greeting: the next one comes soon
            counts, status = int(match[4]), int(match[5])
            if status == 2:
                raise LostError(
                    f"{self._name}: its amplifier does not answer as an HX711 does; check its wires and supply"
                )
            if status == 1 or counts in (HIGHEST, LOWEST):
                raise OverloadError(
                    f"{self._name}: reads the end of its scale; take the load away and check the wiring"
                )
            waited_s = self._clock.waited_s(int(match[3]), now_s)
            if waited_s <= FRESH_S and not is_backlog:
                return CellReading(counts, now_s - waited_s - LATENCY_S)
            if now_s >= end_s:
                raise TimedOutError(
                    f"{self._name}: its readings arrive more than {FRESH_S:g} s late; close other programs"
                )

    def _greet(self) -> str:
        """Return the version of the firmware, also when opening the port has restarted the board."""
        heard: list[bytes] = []
        for wait_s in (0.5, GREET_WITHIN_S - 0.5):
            end_s = time.monotonic() + wait_s
            self._link.write(b"\nI\n", end_s)
            with contextlib.suppress(TimedOutError):
                while time.monotonic() < end_s:  # readings that come all the while never let a read time out
                    heard.append(self._link.read_until(b"\n", end_s))
                    if match := _BANNER.fullmatch(heard[-1]):
                        if int(match[1]) != FIRMWARE_MAJOR:
                            raise RefusedError(
                                f"{self._name}: runs firmware {match[1].decode()}.{match[2].decode()}, but this "
                                f"version of finray needs {FIRMWARE_MAJOR}.x; flash rigs/load_cells/firmware to the "
                                "board"
                            )
                        return f"{match[1].decode()}.{match[2].decode()}"
        said = f"sent {heard[-1][:32]!r}, but" if heard else "sent"
        raise TimedOutError(
            f"{self._name}: {said} no greeting within {GREET_WITHIN_S:g} s; check the cable and the address "
            "('finray rig detect'), and that the board runs rigs/load_cells/firmware"
        )


@contextmanager
def open_load_cell(settings: LoadCellSettings) -> Iterator[Hx711Cell]:
    """Open the board for a ``with`` block."""
    with SerialLink(settings.address, BAUD, "load cell") as link:
        yield Hx711Cell(link, settings)


def found() -> list[tuple[str, str]]:
    """Return the boards that answer as a load cell: address and version. Opening a port resets most boards."""
    cells = []
    for port in usb_serial_ports():
        if port.usb_id.split(":")[0] not in BOARD_VENDORS:
            continue
        settings = LoadCellSettings(driver="hx711", address=port.address, capacity_n=1.0, force_limit_n=1.0)
        with contextlib.suppress(CaptureError), open_load_cell(settings) as cell:
            cells.append((port.address, f"load cell with HX711, firmware {cell.identity().firmware}"))
    return cells
