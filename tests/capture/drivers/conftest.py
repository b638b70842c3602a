"""No test of a driver may leave a process behind."""

import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from data_schemas.storage._array_files import end_child
from tests.capture.drivers.programs import wait_until

ENDED_WITHIN_S = 10.0


@pytest.fixture(scope="session", autouse=True)
def no_process_is_left() -> Iterator[None]:
    before = children()
    yield
    end_child()  # a parser in a process of its own stays for the next file
    left: dict[int, str] = {}

    def gone() -> bool:
        left.clear()
        left.update({pid: command for pid, command in children().items() if pid not in before})
        return not left

    try:
        wait_until(gone, "the end of the programs that tests started", ENDED_WITHIN_S)
    except pytest.fail.Exception as error:
        pytest.fail(f"{error}: {left}")


def children() -> dict[int, str]:
    """Return the running children of this process with their command lines; Python's own trackers do not count."""
    found = {}
    for entry in Path("/proc").iterdir():
        try:
            # the name, in brackets, may hold anything; state and parent follow it
            state, parent = (
                (entry / "stat").read_text().rpartition(")")[2].split()[:2] if entry.name.isdigit() else "ZZ"
            )
            command = (entry / "cmdline").read_bytes().replace(b"\0", b" ").decode(errors="replace")
        except OSError:
            continue  # it ended meanwhile
        if parent == str(os.getpid()) and state != "Z" and "multiprocessing" not in command:
            found[int(entry.name)] = command
    return found
