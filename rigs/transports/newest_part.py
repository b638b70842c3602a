"""The newest part of a stream: who asks gets no old one that waited in a buffer on the way."""

import threading
import time
from typing import Final

from data_schemas.errors import CaptureError, TimedOutError
from rigs.transports.multipart_stream import MultipartStream, Part

SILENCE_S: Final = 600.0
"""A stream that sends nothing for so long has ended."""


class NewestPart:
    """Reads a stream in a thread all the time and keeps the newest part.

    Parameters
    ----------
    stream
        The open stream; it is closed with this.
    """

    def __init__(self, stream: MultipartStream) -> None:
        self._stream = stream
        self._news = threading.Condition()
        self._count, self._part = 0, Part({}, b"", 0.0)
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
                    self._count, self._part = self._count + 1, part
                self._error = error
                self._news.notify_all()
