"""Framed exchange over a serial port, with a deadline for every wait: the only module that imports pyserial.

And what boards with our firmware say unasked: lines with a check byte and the time of the board's own clock.
"""

import contextlib
import errno
import math
import os
import termios
import time
from collections.abc import Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, Final, NamedTuple, Self, TextIO

import serial
from serial.tools import list_ports
from serial.tools.list_ports_common import ListPortInfo

from data_schemas import CaptureError, LostError, RefusedError, TimedOutError, system_words
from rigs.transports._repeated_exchange import require_same_board

POLL_S: Final = 0.02
LONGEST_ANSWER_BYTES: Final = 4096
"""No device here says this much without a terminator: it is another device, or another speed."""
LASTING_NAMES: Final = "/dev/serial/by-id/"
"""Links by maker, product and serial number: they stay in whichever socket a device is plugged."""
SOCKET_NAMES: Final = "/dev/serial/by-path/"
"""Links by the USB socket that a device is plugged into."""
# termios.error is no OSError, although a pulled plug can raise either.
_PORT_ERRORS: Final = (OSError, termios.error)


class UsbSerialPort(NamedTuple):
    """A serial port behind USB: where it is, what it calls itself, and its vendor and product (``"0403:6001"``)."""

    address: str
    description: str
    usb_id: str


def usb_serial_ports() -> list[UsbSerialPort]:
    """Return the serial ports behind USB, by the name that stays after a replug where there is one.

    Ports of the main board are left out: asking there can hang a console.
    """
    ports = _usb_ports()
    return [
        UsbSerialPort(_lasting_name(port, ports), port.description or "serial port", f"{port.vid:04x}:{port.pid:04x}")
        for port in ports
    ]


def port_advice(address: str) -> str:
    """Return what to write in place of the name of a port that may lead to another device; empty where it stays."""
    ports = _usb_ports()
    port = next((port for port in ports if os.path.realpath(port.device) == os.path.realpath(address)), None)
    if port is None:
        return ""
    alike, lasting = _boards_alike(port, ports), _lasting_name(port, ports)
    may_change = f"{address} may lead to another device after a replug or a restart"
    if alike == 1:
        no_better = address == lasting or address != port.device
        return "" if no_better else f"{may_change}; write {lasting} into the rig file"
    if address == lasting != port.device or not (address == port.device or address.startswith(LASTING_NAMES)):
        return ""
    remedy = (
        f"write {lasting} into the rig file, and leave each board in its USB socket"
        if lasting != port.device
        else f"there are no links under {SOCKET_NAMES} here, so plug the boards in one by one, always in the same order"
    )
    return (
        f"{may_change}, and {alike} boards here ({port.description or port.device}) have no serial numbers that tell "
        f"them apart; {remedy}"
    )


def _usb_ports() -> list[ListPortInfo]:
    return [port for port in sorted(list_ports.comports()) if port.vid is not None]


def _boards_alike(port: ListPortInfo, ports: Sequence[ListPortInfo]) -> int:
    """Return how many boards have the maker, product and serial number of this one; 1 where its links differ."""
    said = (port.vid, port.pid, port.serial_number)
    alike = [other for other in ports if (other.vid, other.pid, other.serial_number) == said]
    if all(_link_to(other, LASTING_NAMES) for other in alike):
        return 1
    # "1-1.4:1.0" is an interface of the board in the socket 1-1.4, and a board may have several
    return len({(other.location or other.device).partition(":")[0] for other in alike})


def _lasting_name(port: ListPortInfo, ports: Sequence[ListPortInfo]) -> str:
    """Return the link that leads to the same device after a replug, or the port's own name where there is none."""
    return _link_to(port, SOCKET_NAMES if _boards_alike(port, ports) > 1 else LASTING_NAMES) or port.device


def _link_to(port: ListPortInfo, folder: str) -> str:
    """Return the link to a port in a folder; empty where there is none."""
    there = os.path.realpath(port.device)
    links = sorted(Path(folder).iterdir()) if Path(folder).is_dir() else []
    return next((str(link) for link in links if os.path.realpath(link) == there), "")


def _is_port(port: ListPortInfo, name: object) -> bool:
    return isinstance(name, str) and os.path.realpath(port.device) == os.path.realpath(name)


class SerialLink:
    """An open serial port (8 data bits, no parity, 1 stop bit) that no other program can open meanwhile.

    Instants `end_s` are readings of :func:`time.monotonic`.

    Parameters
    ----------
    address
        Serial port (``/dev/ttyUSB0``) or a URL of pyserial (``socket://host:port``).
    baud
        Symbols per second.
    device
        What is at the other end, for messages: "filter wheel".
    transcript
        Where every byte is noted: a line ``host b'...'`` or ``device b'...'`` for each piece.

    Attributes
    ----------
    is_broken
        Whether the connection broke since it was opened.
    board_serial
        Serial number of the USB device behind the port; empty where there is none, or no USB.

    Raises
    ------
    RefusedError
        The address has no such form, or the port is not ours to open.
    LostError
        There is nothing at the address.
    """

    def __init__(self, address: str, baud: int, device: str, transcript: TextIO | None = None) -> None:
        self._name = f"{device} at {address}"
        self._address, self._baud = address, baud
        self._transcript = transcript
        self._unread = bytearray()
        self.is_broken, self.board_serial = False, ""
        self._open()

    def reopen(self) -> None:
        """Close the port and open the address anew; after a replug another port may be behind it.

        Raises
        ------
        LostError
            It cannot be opened now, or its serial number is not known yet. A port that has just come back may not be
            ours yet, or be probed by the system.
        RefusedError
            The address leads to another device now; the port stays closed, and this one goes on being looked for.
        """
        # An open descriptor would keep the name of the port that was pulled.
        self.close()
        self.is_broken = True
        self._unread.clear()
        before = self.board_serial
        try:
            self._open()
        except RefusedError as error:
            raise LostError(str(error)) from error
        try:
            require_same_board(self._name, before, self.board_serial)
        except CaptureError:
            self.close()
            self.board_serial = before
            raise
        self.is_broken = False

    def _open(self) -> None:
        """Open the port."""
        try:
            self._port: Any = serial.serial_for_url(self._address, baudrate=self._baud, timeout=POLL_S, exclusive=True)
        except ValueError as error:
            raise RefusedError(
                f"{self._name}: is not an address of a serial port ({error}); write a port such as /dev/ttyUSB0 or a "
                "URL such as socket://host:4001"
            ) from error
        except _PORT_ERRORS as error:
            raise self._not_opened(error) from error
        opened = getattr(self._port, "port", None)  # the device's name, also where it was looked for
        self.board_serial = next((port.serial_number or "" for port in _usb_ports() if _is_port(port, opened)), "")

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Close the port, also one that is lost."""
        # pyserial leaves the socket of a broken TCP connection open.
        tcp = getattr(self._port, "_socket", None)
        with contextlib.suppress(*_PORT_ERRORS):
            self._port.close()
        if tcp is not None:
            tcp.close()

    def descriptor(self) -> int:
        """Return the descriptor of the open port, for a process that shares it.

        Raises
        ------
        RefusedError
            This kind of address has none.
        """
        try:
            return int(self._port.fileno())
        except (AttributeError, OSError) as error:  # io.UnsupportedOperation is an OSError
            raise RefusedError(
                f"{self._name}: this kind of address cannot be shared with the watch of a light; write a port such as "
                "/dev/ttyUSB0 or a URL such as socket://host:4001"
            ) from error

    def write(self, data: bytes, end_s: float) -> None:
        """Send `data`.

        Raises
        ------
        TimedOutError
            The port took no more bytes until `end_s`.
        LostError
            The connection broke.
        """
        try:
            self._port.write_timeout = max(end_s - time.monotonic(), POLL_S)
            self._port.write(data)
        except serial.SerialTimeoutException as error:
            raise TimedOutError(
                f"{self._name}: accepts no more bytes ({data!r} was to be sent); switch the device off and on"
            ) from error
        except _PORT_ERRORS as error:
            raise self._lost(error) from error
        self._note("host", data)

    def read_until(self, terminator: bytes, end_s: float) -> bytes:
        """Return what the device says, up to and with `terminator`; what follows stays for the next call.

        Raises
        ------
        TimedOutError
            The terminator has not come until `end_s`.
        LostError
            The connection broke, or the device says more than any answer holds.
        """
        began_s = time.monotonic()
        while terminator not in self._unread:
            if len(self._unread) > LONGEST_ANSWER_BYTES:
                start = bytes(self._unread[:32])
                self._unread.clear()
                raise LostError(
                    f"{self._name}: sends more than {LONGEST_ANSWER_BYTES} bytes without {terminator!r} (they begin "
                    f"with {start!r}); check that this port belongs to the device, and that its speed is right"
                )
            self._receive()
            # A device that drips bytes is late as well as a mute one.
            if time.monotonic() >= end_s and terminator not in self._unread:
                said = bytes(self._unread).strip()
                heard = f"only {said!r} came" if said else "nothing came"
                raise TimedOutError(
                    f"{self._name}: did not answer within {max(end_s - began_s, 0.0):.2g} s ({heard}); check its "
                    "power and cable, and that this port belongs to it"
                )
        end = self._unread.index(terminator) + len(terminator)
        answer = bytes(self._unread[:end])
        del self._unread[:end]
        return answer

    def forget(self) -> None:
        """Forget what has come already: it answers nothing that is asked from now on.

        Raises
        ------
        LostError
            The connection broke.
        """
        self._unread.clear()
        try:
            forgotten = 0
            while forgotten <= LONGEST_ANSWER_BYTES and (waiting := self._waiting_bytes()):
                data = bytes(self._port.read(waiting))
                self._note("device", data)
                forgotten += max(len(data), 1)
        except _PORT_ERRORS as error:
            raise self._lost(error) from error

    def drain(self, quiet_s: float, end_s: float) -> bytes:
        """Take in and forget whatever comes until nothing has come for `quiet_s` seconds; return it.

        Raises
        ------
        TimedOutError
            The device is not silent until `end_s`.
        LostError
            The connection broke.
        """
        drained = bytes(self._unread)
        last_s = time.monotonic()
        while True:
            self._unread.clear()
            if self._receive():
                last_s = time.monotonic()
                drained = (drained + self._unread)[:LONGEST_ANSWER_BYTES]
            elif time.monotonic() - last_s >= quiet_s:
                return drained
            if time.monotonic() >= end_s:
                raise TimedOutError(
                    f"{self._name}: does not stop sending (such as {drained[:32]!r}); check that this port belongs to "
                    "the device, and that its speed is right"
                )

    def _receive(self) -> bool:
        """Take in all that has come, waiting a moment for the first byte; return whether anything came."""
        before = len(self._unread)
        try:
            # A TCP line hands over single bytes.
            wanted = max(1, self._waiting_bytes())
            while wanted and len(self._unread) <= LONGEST_ANSWER_BYTES and (data := bytes(self._port.read(wanted))):
                self._unread += data
                self._note("device", data)
                wanted = self._waiting_bytes()
        except _PORT_ERRORS as error:
            if len(self._unread) == before:
                raise self._lost(error) from error
        return len(self._unread) > before

    def _waiting_bytes(self) -> int:
        """Return how many bytes have come; pyserial has no error of its own for a port that was closed."""
        if not self._port.is_open:
            raise serial.PortNotOpenError
        return int(self._port.in_waiting)

    def _note(self, who: str, data: bytes) -> None:
        if self._transcript is not None:
            self._transcript.write(f"{who} {data!r}\n")

    def _lost(self, error: Exception) -> LostError:
        self.is_broken = True
        return LostError(
            f"{self._name}: the connection broke ({system_words(error)}); plug the cable in again and check its power"
        )

    def _not_opened(self, error: Exception) -> RefusedError | LostError:
        """Say why the port did not open."""
        number = getattr(error, "errno", None)
        if number in (errno.EACCES, errno.EPERM):
            return RefusedError(
                f"{self._name}: your user has no permission to open this port; join its group (sudo usermod "
                "-aG dialout $USER) and log in again"
            )
        if number in (errno.EAGAIN, errno.EBUSY):
            return RefusedError(f"{self._name}: another program has the port open; close that program")
        there = (
            "" if "://" in self._address else ", ".join(f"{p.address} ({p.description})" for p in usb_serial_ports())
        )
        renamed = f". These USB ports are there now: {there}"
        if not self._address.startswith(LASTING_NAMES):
            renamed += (
                "; a port that was plugged in again may have a new name, so write its lasting link under "
                f"{LASTING_NAMES} into the rig file"
            )
        return LostError(
            f"{self._name}: cannot be opened ({system_words(error)}); check cable and power, and the address with "
            f"'finray rig detect'{renamed if there else ''}"
        )


LATENCY_S: Final = 0.03
"""Longest time from a reading to the quickest arrival of a line: 5 ms on the wire, up to 20 ms in a USB adapter."""
CREEP_REL: Final = 0.01
"""By how much the board's clock may be wrong: the ceramic resonator of an Uno is allowed 0.5 % and ages."""
MILLISECONDS: Final = 2**32


def line_crc8(text: bytes) -> int:
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
