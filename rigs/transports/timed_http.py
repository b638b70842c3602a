"""HTTP connections whose every read is bounded by one deadline: a timeout per read lets a slow server go on forever."""

import contextlib
import http.client
import io
import socket
import time
from dataclasses import dataclass
from typing import Any, Final

PIECE_BYTES: Final = 65536


@dataclass(slots=True)
class _Clock:
    """When the exchange that runs must be over."""

    end_s: float

    def left_s(self) -> float:
        """Return the time that is left (s)."""
        left_s = self.end_s - time.monotonic()
        if left_s <= 0.0:
            raise TimeoutError
        return left_s


class TimedConnection(http.client.HTTPConnection):
    """A connection with a deadline.

    Parameters
    ----------
    host, port
        The server.
    end_s
        When the exchange must be over (:func:`time.monotonic`); later ones set ``clock.end_s`` anew.

    Raises
    ------
    TimeoutError
        Of all that waits: the deadline is over.
    """

    def __init__(self, host: str, port: int, end_s: float) -> None:
        super().__init__(host, port)
        self.clock = _Clock(end_s)
        self._link: socket.socket | None = None

    def connect(self) -> None:
        """Connect before the deadline."""
        self._link = _connected(self.host, self.port, self.clock)
        self.sock: Any = _TimedSocket(self._link, self.clock)

    def hang_up(self) -> None:
        """End the connection; the shutdown wakes a read that waits in another thread."""
        if self._link is not None:
            with contextlib.suppress(OSError):  # the other end was faster
                self._link.shutdown(socket.SHUT_RDWR)
            self._link.close()


def _connected(host: str, port: int, clock: _Clock) -> socket.socket:
    """Connect to the first address of a name that answers; all of them together have the time that is left."""
    known = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)
    failed: OSError = TimeoutError()
    for number, (family, kind, protocol, _, address) in enumerate(known):
        link = socket.socket(family, kind, protocol)
        try:
            link.settimeout(clock.left_s() / (len(known) - number))
            link.connect(address)
        except OSError as error:
            link.close()
            failed = error
        else:
            return link
    raise failed


class _TimedSocket:
    """The part of a socket that :mod:`http.client` uses, with a deadline."""

    def __init__(self, link: socket.socket, clock: _Clock) -> None:
        self._link, self._clock = link, clock

    def sendall(self, data: bytes) -> None:
        """Send all bytes."""
        self._link.settimeout(self._clock.left_s())
        self._link.sendall(data)

    def makefile(self, mode: str) -> io.BufferedReader:
        """Return the reading end."""
        return io.BufferedReader(_TimedReader(self._link, self._clock), PIECE_BYTES)

    def close(self) -> None:
        """Do nothing: http.client closes when the headers are read, and the reading end is still needed."""


class _TimedReader(io.RawIOBase):
    """Bytes of a socket; reading raises TimeoutError after the deadline."""

    def __init__(self, link: socket.socket, clock: _Clock) -> None:
        self._link, self._clock = link, clock

    def readable(self) -> bool:
        """Return that it can be read."""
        return True

    def readinto(self, buffer: Any) -> int:
        """Read what is there into `buffer`."""
        self._link.settimeout(self._clock.left_s())
        return self._link.recv_into(buffer)
