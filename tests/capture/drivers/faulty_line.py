"""A line to a device that does, when it is told to, what lines do to messages: a TCP relay, or a pseudo-terminal.

A fault befalls the next piece that comes by in one direction: it is dropped, cut to its first half, sent twice, held
back, or dripped; or the line breaks before or after it, for a moment or until it is plugged in again.
"""

import contextlib
import os
import pty
import select
import socket
import threading
import time
import tty
from collections.abc import Callable
from pathlib import Path
from typing import Literal, NamedTuple, Self

Kind = Literal["drop", "half", "duplicate", "late", "reset", "restart", "unplug", "slow"]
KINDS: tuple[Kind, ...] = ("drop", "half", "duplicate", "late", "reset", "restart", "unplug", "slow")
LATE_S = 0.4
UNPLUGGED_S = 1.5
DRIP_S = 0.02
DRIPS = 10
PIECE_BYTES = 65536


class Mishap(NamedTuple):
    """A fault, and whether it befalls what is said to the device or what it says."""

    kind: Kind
    to_device: bool


class FaultyLine:
    """A relay to the device at a port of the loopback; the host's end is a port, or a pseudo-terminal at `link`.

    Parameters
    ----------
    port
        Where the device listens.
    restart
        Does to the device what a loss of its power does.
    link
        Path that stands for ``/dev/ttyUSB0``; None for a TCP port.
    """

    def __init__(self, port: int, restart: Callable[[], None], link: Path | None = None) -> None:
        self._device_port, self._restart, self._link = port, restart, link
        self._armed: Mishap | None = None
        self._cut = self._over = False
        self._away_until_s = 0.0
        self.suffered: list[Mishap] = []
        self._server = None if link else socket.create_server(("127.0.0.1", 0))
        self.port = self._server.getsockname()[1] if self._server else 0
        self._threads: list[threading.Thread] = []
        self._main = threading.Thread(target=self._accept if self._server else self._be_a_port, daemon=True)

    def __enter__(self) -> Self:
        self._main.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._over = True
        if self._server is not None:
            self._server.close()
        self._main.join(5.0)

    def arm(self, mishap: Mishap | None) -> None:
        """Let a fault befall the next piece in its direction; None takes it back."""
        self._armed = mishap

    @property
    def is_armed(self) -> bool:
        return self._armed is not None

    def _accept(self) -> None:
        """Relay every connection in a thread of its own; while unplugged, hang up."""
        assert self._server is not None
        self._server.settimeout(0.1)
        while not self._over:
            try:
                host, _ = self._server.accept()
            except TimeoutError:
                continue
            except OSError:
                return
            if time.monotonic() < self._away_until_s:
                host.close()
                continue
            threading.Thread(target=self._relay, args=(host.detach(),), daemon=True).start()

    def _be_a_port(self) -> None:
        """Be a pseudo-terminal, and another one after it is unplugged."""
        assert self._link is not None
        while not self._over:
            if time.monotonic() < self._away_until_s:
                time.sleep(0.02)
                continue
            host, slave = pty.openpty()
            tty.setraw(slave)
            self._link.unlink(missing_ok=True)
            self._link.symlink_to(os.ttyname(slave))
            os.close(slave)
            self._relay(host)
            self._link.unlink(missing_ok=True)

    def _relay(self, host: int) -> None:
        """Pass pieces on until the line breaks or an end hangs up."""
        try:
            device = socket.create_connection(("127.0.0.1", self._device_port), 5.0).detach()
        except OSError:
            os.close(host)
            return
        try:
            while not self._over:
                for end in select.select([host, device], [], [], 0.1)[0]:
                    if not self._pass_on(end, device if end == host else host, end == host):
                        return
        finally:
            for end in (host, device):
                with contextlib.suppress(OSError):
                    os.close(end)

    def _pass_on(self, source: int, target: int, to_device: bool) -> bool:
        """Pass a piece on; return whether the line still stands."""
        try:
            piece = os.read(source, PIECE_BYTES)
        except OSError:
            # nobody has the pseudo-terminal open now
            time.sleep(0.02)
            return self._link is not None and to_device
        if not piece:
            return False
        mishap = self._armed
        if mishap is None or mishap.to_device != to_device:
            return _written(target, piece)
        self._armed = None
        self.suffered.append(mishap)
        return self._befall(mishap.kind, target, piece)

    def _befall(self, kind: Kind, target: int, piece: bytes) -> bool:
        if kind == "drop":
            return True
        if kind == "half":
            return _written(target, piece[: len(piece) // 2])
        if kind == "duplicate":
            return _written(target, piece + piece)
        if kind == "late":
            time.sleep(LATE_S)
            return _written(target, piece)
        if kind == "slow":
            size = max(len(piece) // DRIPS, 1)
            for start in range(0, len(piece), size):
                time.sleep(DRIP_S)
                if not _written(target, piece[start : start + size]):
                    return False
            return True
        if kind == "restart":
            self._restart()
        self._away_until_s = time.monotonic() + (UNPLUGGED_S if kind == "unplug" else 0.0)
        return False


def _written(target: int, piece: bytes) -> bool:
    """Write all of a piece; return whether the other end was there."""
    try:
        while piece:
            select.select([], [target], [], 5.0)
            piece = piece[os.write(target, piece) :]
    except OSError:
        return False
    return True
