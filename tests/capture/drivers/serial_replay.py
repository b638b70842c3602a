"""Recorded exchanges played back over TCP: the driver says what it said then, byte for byte, and hears the answers."""

import ast
import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import groupby
from pathlib import Path

TRANSCRIPTS = Path(__file__).parent / "transcripts"
WAIT_S = 10.0


def read_transcript(path: Path) -> list[tuple[str, bytes]]:
    """Return who said what; pieces of one speaker in a row are joined, lines that begin with # are skipped."""
    lines = [line.split(" ", 1) for line in path.read_text("ascii").splitlines() if line and not line.startswith("#")]
    spoken = [(who, ast.literal_eval(said)) for who, said in lines]
    return [(who, b"".join(said for _, said in run)) for who, run in groupby(spoken, key=lambda piece: piece[0])]


@contextmanager
def replayed(spoken: list[tuple[str, bytes]]) -> Iterator[str]:
    """Play the device's part of an exchange at the address given to the ``with`` block; all of it must be heard."""
    faults: list[str] = []
    with socket.create_server(("127.0.0.1", 0)) as server:
        server.settimeout(WAIT_S)
        player = threading.Thread(target=_play, args=(server, spoken, faults))
        player.start()
        try:
            yield f"socket://127.0.0.1:{server.getsockname()[1]}"
        finally:
            player.join(WAIT_S)
    assert not faults, faults


def _play(server: socket.socket, spoken: list[tuple[str, bytes]], faults: list[str]) -> None:
    try:
        line, _ = server.accept()
        with line:
            line.settimeout(WAIT_S)
            for who, expected in spoken:
                if who == "device":
                    line.sendall(expected)
                    continue
                heard = b""
                while len(heard) < len(expected) and (piece := line.recv(len(expected) - len(heard))):
                    heard += piece
                if heard != expected:
                    faults.append(f"the host said {heard!r}, {expected!r} was recorded")
                    return
            while line.recv(64):
                faults.append("the host said more than was recorded")
    except OSError as error:
        faults.append(f"the exchange broke off: {error}")
