"""HTTP with one deadline for all reads of an answer, and the parts of an answer that never ends.

A timeout per read lets a slow server go on forever. Of a ``multipart/x-mixed-replace`` answer (MJPEG over HTTP) each
part is read before a deadline, and who asks gets the newest, not an old one that waited in a buffer on the way.
"""

import contextlib
import http.client
import io
import math
import re
import socket
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from itertools import pairwise
from statistics import fmean, median
from types import TracebackType
from typing import Any, Final, Self
from urllib.parse import urlsplit

from data_schemas import BadFrameError, CaptureError, LostError, RefusedError, TimedOutError, system_words

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
        try:
            link = socket.socket(family, kind, protocol)
        except OSError as error:  # a computer without IPv6, whose localhost has an address of it all the same
            failed = error
            continue
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


LONGEST_LINE_BYTES: Final = 8192
LONGEST_PART_BYTES: Final = 64 * 2**20
MOST_HEADERS: Final = 100


@dataclass(frozen=True, slots=True)
class Part:
    """One part of the stream.

    Attributes
    ----------
    headers
        By name in lower case.
    body
        The bytes between the headers and the next boundary.
    begun_s
        Reading of :func:`time.monotonic` when the first byte of the part had come.
    taken_s
        Latest reading of :func:`time.monotonic` at which its content can have been there to be sent, as far as the
        stream tells: by its sender's stamp, as if the fastest part of the stream had taken no time on its way, and by
        the stream's pace. Parts that a line held back are behind the pace, until the line has caught up.
    """

    headers: Mapping[str, str]
    body: bytes
    begun_s: float
    taken_s: float = -math.inf


class MultipartStream:
    """An open stream; a ``with`` block. Instants `end_s` are readings of :func:`time.monotonic`.

    Parameters
    ----------
    address
        ``http://host:port/path``.
    device
        What is at the other end, for messages: "camera".
    end_s
        When the server must have answered.

    Raises
    ------
    RefusedError
        The address has another form, or the server answers with another status than 200.
    LostError
        Nobody listens there, or the answer is no HTTP.
    TimedOutError
        The server did not answer in time.
    """

    def __init__(self, address: str, device: str, end_s: float) -> None:
        self._name = f"{device} at {address}"
        host, port, path = self._split(address)
        self._unread = bytearray()
        self._delimiter = b""
        self._connection = TimedConnection(host, port, end_s)
        try:
            self._connection.request("GET", path, headers={"Accept": "multipart/x-mixed-replace, */*"})
            self._answer = self._connection.getresponse()
        except TimeoutError:
            self.close()
            raise TimedOutError(
                f"{self._name}: did not answer in time; check that the camera server runs and that the network works"
            ) from None
        except (OSError, UnicodeError, http.client.HTTPException) as error:  # UnicodeError: no host can have that name
            self.close()
            raise LostError(
                f"{self._name}: cannot be reached ({system_words(error)}); start the camera server there, "
                "or correct the address"
            ) from None
        if self._answer.status != http.client.OK:
            self.close()
            raise RefusedError(
                f"{self._name}: answers HTTP {self._answer.status} {self._answer.reason}, but 200 is needed; "
                "correct the path of the address (such as /stream, /?action=stream, /video_feed)"
            )
        self.headers = {name.lower(): value for name, value in self._answer.getheaders()}

    def next_part(self, end_s: float) -> Part:
        """Return the next whole part.

        Raises
        ------
        BadFrameError
            The stream ended within a part.
        LostError
            The stream ended between two parts, or what came is no multipart stream.
        TimedOutError
            No whole part came before `end_s`.
        """
        self._connection.clock.end_s = end_s
        headers: dict[str, str] | None = None
        try:
            self._skip_to_boundary()
            begun_s = time.monotonic()
            headers = self._headers()
            return Part(headers, self._body(headers), begun_s)
        except TimeoutError:
            raise TimedOutError(
                f"{self._name}: no complete picture came in time; the camera or its server hangs, or the network is "
                f"slow"
            ) from None
        except (OSError, http.client.HTTPException) as error:
            if headers is not None:
                raise BadFrameError(
                    f"{self._name}: the stream ended in the middle of a picture; check the network and "
                    "the camera server"
                ) from None
            raise LostError(
                f"{self._name}: the stream ended ({system_words(error)}); start the camera server again"
            ) from None

    def close(self) -> None:
        """Close the connection, also under a read that waits in another thread."""
        self._connection.hang_up()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.close()

    def _split(self, address: str) -> tuple[str, int, str]:
        """Return host, port and path of an address."""
        try:
            parts = urlsplit(address)
            host, port = parts.hostname, parts.port or 80
        except ValueError:
            host, port = None, 0
        if (
            host is None
            or parts.scheme != "http"
            or not address.isascii()
            or any(c <= " " or c == "\x7f" for c in address)
        ):
            raise RefusedError(
                f"{self._name}: is not an address of a stream; write http://host:port/path, such as "
                "http://raspberrypi.local:8080/stream"
            )
        return host, port, (parts.path or "/") + (f"?{parts.query}" if parts.query else "")

    def _skip_to_boundary(self) -> None:
        """Read past the line that begins a part; the first such line says what the boundary is.

        The Content-Type of the answer is not asked: ffmpeg sends none with a boundary, and others quote it wrongly.
        """
        skipped = 0
        while True:
            line = self._line()
            if self._delimiter and line == self._delimiter:
                return
            if not self._delimiter and line.startswith(b"--") and len(line) > 2:
                self._delimiter = line
                return
            skipped += len(line) + 1
            if skipped > LONGEST_LINE_BYTES:
                raise LostError(
                    f"{self._name}: does not send a multipart stream of pictures; correct the path of the address"
                )

    def _headers(self) -> dict[str, str]:
        """Read the headers of a part."""
        headers: dict[str, str] = {}
        while line := self._line():
            name, _, value = line.decode("latin-1").partition(":")
            headers[name.strip().lower()] = value.strip()
            if len(headers) > MOST_HEADERS:
                raise LostError(
                    f"{self._name}: sends a part with more than {MOST_HEADERS} headers; check that a camera server is "
                    "at this address"
                )
        return headers

    def _body(self, headers: Mapping[str, str]) -> bytes:
        """Read the body of a part: as long as it says, or up to the next boundary (which stays unread)."""
        if "content-length" in headers:
            length = headers["content-length"]
            if not (re.fullmatch("[0-9]{1,12}", length) and int(length) <= LONGEST_PART_BYTES):
                raise BadFrameError(
                    f"{self._name}: a part states Content-Length {length[:40]!r}, but only 0 to {LONGEST_PART_BYTES} "
                    "bytes are allowed"
                )
            while len(self._unread) < int(length):
                self._read_more()
            return self._take(int(length))
        ending, seen = b"\n" + self._delimiter, 0
        while (at := self._unread.find(ending, max(seen - len(ending), 0))) < 0:
            seen = len(self._unread)
            if seen > LONGEST_PART_BYTES:
                raise BadFrameError(
                    f"{self._name}: a part is longer than {LONGEST_PART_BYTES} bytes; check that a camera server is "
                    "at this address"
                )
            self._read_more()
        body = self._take(at)
        del self._unread[:1]
        return body.removesuffix(b"\r")

    def _line(self) -> bytes:
        """Read a line without its end."""
        while (at := self._unread.find(b"\n")) < 0:
            if len(self._unread) > LONGEST_LINE_BYTES:
                raise LostError(
                    f"{self._name}: does not send a multipart stream of pictures; correct the path of the address"
                )
            self._read_more()
        return self._take(at + 1).rstrip()

    def _take(self, count: int) -> bytes:
        """Return the first unread bytes."""
        taken = bytes(self._unread[:count])
        del self._unread[:count]
        return taken

    def _read_more(self) -> None:
        """Read what is there, or wait for the next bytes; chunked coding is undone on the way."""
        try:
            piece = self._answer.read1(PIECE_BYTES)
        except ValueError as error:  # a broken chunk length, or closed meanwhile
            raise ConnectionError(str(error)) from None
        if not piece:
            raise ConnectionError("closed by the server")
        self._unread += piece


SILENCE_S: Final = 600.0
"""A stream that sends nothing for so long has ended."""


PACE_OF_PARTS: Final = 32
"""So many parts tell the stream's pace."""


class NewestPart:
    """Reads a stream in a thread all the time and keeps the newest part.

    Parameters
    ----------
    stream
        The open stream; it is closed with this.
    stamp_s
        Returns when a part was taken by its sender's clock (s); None where it does not say.
    """

    def __init__(self, stream: MultipartStream, stamp_s: Callable[[Part], float | None] = lambda part: None) -> None:
        self._stream, self._stamp_s, self._least_lag_s = stream, stamp_s, math.inf
        self._news = threading.Condition()
        self._count, self._part = 0, Part({}, b"", 0.0)
        self._begun_s: deque[float] = deque(maxlen=PACE_OF_PARTS)
        self._error: CaptureError | None = None
        self._thread = threading.Thread(target=self._read, name="mjpeg-reader", daemon=True)
        self._thread.start()

    def count(self) -> int:
        """Return the number of parts up to now."""
        with self._news:
            return self._count

    def has_ended(self) -> bool:
        """Return whether the stream ended."""
        with self._news:
            return self._error is not None

    def newer_than(self, seen: int, end_s: float, name: str) -> tuple[int, Part]:
        """Wait for a part with a number above `seen`; return number and content of the newest one.

        Parameters
        ----------
        seen
            Number of the newest part that is known already.
        end_s
            When to give up (:func:`time.monotonic`).
        name
            What sends the parts, for the message.

        Raises
        ------
        TimedOutError
            None came in time.
        BadFrameError, LostError
            The stream ended.
        """
        with self._news:
            while self._count <= seen:
                if self._error is not None:
                    raise self._error
                left_s = end_s - time.monotonic()
                if left_s <= 0.0:
                    raise TimedOutError(
                        f"{name}: no new picture came in time; the camera or its server hangs, or the network is slow"
                    )
                self._news.wait(left_s)
            return self._count, self._part

    def _timed(self, part: Part) -> Part:
        """Return a part with when it was taken."""
        taken_s = part.begun_s - self._behind_pace_s(part.begun_s)
        if (stamp_s := self._stamp_s(part)) is not None:
            self._least_lag_s = min(self._least_lag_s, part.begun_s - stamp_s)
            taken_s = min(taken_s, stamp_s + self._least_lag_s)
        return replace(part, taken_s=taken_s)

    def _behind_pace_s(self, begun_s: float) -> float:
        """Return how much later a part may begin than it was taken, by the stream's pace (s).

        That is how far it is behind the fastest ones before it, and one interval, as a few parts tell the pace roughly.
        """
        self._begun_s.append(begun_s)
        intervals_s = [after_s - before_s for before_s, after_s in pairwise(self._begun_s)] or [0.0]
        # What is held back and not caught up with raises the mean; the median falls in a burst, and then waits longer.
        pace_s = min(fmean(intervals_s), median(intervals_s))
        behind_s = (begun_s - before_s - number * pace_s for number, before_s in enumerate(reversed(self._begun_s)))
        return pace_s + max(behind_s)

    def close(self) -> None:
        """End the stream and its thread."""
        self._stream.close()
        self._thread.join()

    def _read(self) -> None:
        """Read until the stream ends."""
        error: CaptureError | None = None
        while error is None:
            try:
                part = self._stream.next_part(time.monotonic() + SILENCE_S)
            except CaptureError as ended:
                error = ended
            with self._news:
                if error is None:
                    self._count, self._part = self._count + 1, self._timed(part)
                self._error = error
                self._news.notify_all()
