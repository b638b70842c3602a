"""What a light's owner and its guard process say to each other: JSON objects, one to a packet of a Unix socket."""

import json
import select
import socket
import time
from typing import Any, Final

from data_schemas.errors import (
    CaptureError,
    FinrayError,
    LostError,
    MissingExtraError,
    RefusedError,
    TimedOutError,
    UnsafeError,
)

LONGEST_MESSAGE_BYTES: Final = 65536
EXIT_OFF: Final = 0
"""The guard ended and a fresh answer of the controller says that the light is off."""
EXIT_NOT_OFF: Final = 3

_ERRORS: Final[dict[str, type[FinrayError]]] = {
    kind.__name__: kind
    for kind in (CaptureError, LostError, MissingExtraError, RefusedError, TimedOutError, UnsafeError)
}


class HungUpError(Exception):
    """The other end of the socket is closed."""


def channel() -> tuple[socket.socket, socket.socket]:
    """Return both ends of a socket that keeps messages apart."""
    return socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)


def send(end: socket.socket, **message: object) -> None:
    """Send a message without waiting.

    Raises
    ------
    HungUpError
        Nobody is at the other end.
    BlockingIOError
        The other end has not read for long.
    """
    try:
        end.send(json.dumps(message).encode(), socket.MSG_DONTWAIT | socket.MSG_NOSIGNAL)
    except BlockingIOError:
        raise
    except OSError as error:
        raise HungUpError from error


def receive(end: socket.socket, end_s: float) -> dict[str, Any]:
    """Return the next message; `end_s` is a reading of :func:`time.monotonic`.

    Raises
    ------
    HungUpError
        One of the ends is closed, or what came is no message of ours.
    TimeoutError
        Nothing came until `end_s`.
    """
    try:
        if not select.select([end], [], [], max(end_s - time.monotonic(), 0.0))[0]:
            raise TimeoutError
        try:
            packet = end.recv(LONGEST_MESSAGE_BYTES)
        except ConnectionResetError:
            # Told once when the other end closed without reading all of ours; its last words are still here.
            packet = end.recv(LONGEST_MESSAGE_BYTES)
        message = json.loads(packet)  # nothing at all comes from a closed end
    except TimeoutError:
        raise
    except (OSError, ValueError) as error:
        raise HungUpError from error
    if not isinstance(message, dict):
        raise HungUpError
    return message


def error_words(error: Exception) -> dict[str, str]:
    """Return an error as part of a message."""
    name = type(error).__name__
    return {"error": name, "why": str(error)} if name in _ERRORS else {"error": "CaptureError", "why": repr(error)}


def error_from(message: dict[str, Any]) -> FinrayError:
    """Return the error that a message tells."""
    return _ERRORS[message["error"]](message["why"])
