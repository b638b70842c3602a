"""The light's real firmware in QEMU's Arduino Uno, behind a tap that sees every byte and can pull the cable."""

import contextlib
import select
import socket
import subprocess
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

from rigs import lights
from tests.capture.drivers.programs import free_port, require, wait_until

SOURCE = Path(lights.__file__).parent / "firmware" / "laser.c"


class Line(NamedTuple):
    """A line that passed the tap, and when its end did, by the monotonic clock."""

    at_s: float
    who: str
    text: bytes


def build(folder: Path, source: Path = SOURCE) -> Path:
    """Compile the firmware as its README says, or another one."""
    elf = folder / "laser.elf"
    command = [require("avr-gcc", "gcc-avr avr-libc"), "-std=c11", "-Wall", "-Wextra", "-Werror", "-Os"]
    subprocess.run([*command, "-mmcu=atmega328p", "-o", str(elf), str(source)], check=True)
    return elf


class Tap:
    """A relay between hosts and the board; it stays connected to the board, one host at a time."""

    def __init__(self, board: socket.socket) -> None:
        self.lines: list[Line] = []
        self._begun = {"host": b"", "device": b""}
        self._board = board
        self._server = socket.create_server(("127.0.0.1", 0))
        self.address = f"socket://127.0.0.1:{self._server.getsockname()[1]}"
        self._stop, self._woken = socket.socketpair()
        self._thread = threading.Thread(target=self._relay)
        self._thread.start()

    def pull_cable(self) -> None:
        """Cut the host off; the board goes on unheard, and what it says is still noted."""
        with contextlib.suppress(OSError):
            self._stop.send(b"c")

    def stop(self) -> None:
        """End the relay."""
        self._stop.close()
        self._thread.join()
        for end in (self._board, self._server, self._woken):
            end.close()

    def times(self, who: str, text: bytes, after_s: float = 0.0) -> list[float]:
        """Return when a line passed after an instant, each time."""
        return [line.at_s for line in list(self.lines) if line[1:] == (who, text) and line.at_s >= after_s]

    def when(self, who: str, text: bytes, after_s: float = 0.0, within_s: float = 3.0) -> float:
        """Return when a line first passed after an instant; wait for it."""
        wait_until(lambda: bool(self.times(who, text, after_s)), f"{text!r} of the {who}", within_s)
        return self.times(who, text, after_s)[0]

    def say(self, data: bytes) -> None:
        """Say something to the board past any host."""
        self._board.sendall(data)

    def state(self) -> bool:
        """Ask the board itself, past any host."""
        asked_s = time.monotonic()
        self._board.sendall(b"?\n")
        answers: list[Line] = []

        def answered() -> bool:
            answers[:] = [x for x in list(self.lines) if x.at_s > asked_s and x.text in (b"ON", b"OFF")]
            return bool(answers)

        wait_until(answered, "an answer of the board", 3.0)
        return answers[-1].text == b"ON"

    def _note(self, who: str, data: bytes) -> None:
        now_s = time.monotonic()
        *whole, self._begun[who] = (self._begun[who] + data).split(b"\n")
        self.lines += [Line(now_s, who, text) for text in whole]

    def _relay(self) -> None:
        host: socket.socket | None = None
        server: socket.socket | None = self._server
        while True:
            ends = [end for end in (self._woken, self._board, host or server) if end is not None]
            ready = select.select(ends, [], [])[0]
            if self._woken in ready:
                if not self._woken.recv(1):
                    break
                server = None
                self._server.close()
                if host is not None:
                    host.close()
                host = None
                continue
            if self._board in ready:
                data = self._board.recv(256)
                self._note("device", data)
                if not data:
                    break
                with contextlib.suppress(OSError):
                    if host is not None:
                        host.sendall(data)
            if host is not None and host in ready:
                try:
                    data = host.recv(256)
                except OSError:
                    data = b""
                if not data:
                    host.close()
                    host = None
                    continue
                self._note("host", data)
                self._board.sendall(data)
            elif host is None and server is not None and server in ready:
                host = server.accept()[0]
                host.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        if host is not None:
            host.close()


@contextmanager
def firmware_board(elf: Path) -> Iterator[Tap]:
    """Run the firmware behind a tap for a ``with`` block."""
    qemu, port = require("qemu-system-avr", "qemu-system-misc"), free_port()
    serial = f"tcp:127.0.0.1:{port},server=on,wait=off,nodelay=on"
    command = [qemu, "-M", "uno", "-bios", str(elf), "-display", "none", "-monitor", "none", "-serial", serial]
    # A session of its own, which goes before the others where that is permitted: a busy computer slows no real board
    # down, and a starved emulation loses ticks of the dead-man's timer.
    process = subprocess.Popen(command, stdin=subprocess.DEVNULL, start_new_session=True)
    with contextlib.suppress(OSError):
        Path(f"/proc/{process.pid}/autogroup").write_text("-15")
    try:
        tap = Tap(_connected(port))
        try:
            tap.state()  # answered once it runs, after any banner
            yield tap
        finally:
            tap.stop()
    finally:
        process.kill()
        process.wait()


def _connected(port: int) -> socket.socket:
    """Connect once QEMU listens; it takes one client, so nothing may probe the port."""
    line = socket.socket()

    def there() -> bool:
        with contextlib.suppress(ConnectionRefusedError):
            line.connect(("127.0.0.1", port))
            return True
        return False

    wait_until(there, "QEMU's Arduino")
    line.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    return line
