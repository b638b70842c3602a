"""A program that keeps a laser on behind its guard, and the guard processes that run."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from tests.capture.drivers.programs import wait_until

OWNER = """
import sys, time
from data_schemas.errors import CaptureError
from rigs.light_guard import guarded_light
try:
    with guarded_light("laser", sys.argv[3], sys.argv[1]) as light, light.lit():
        print("ON", flush=True)
        end_s = time.monotonic() + 60.0
        while time.monotonic() < end_s:
            time.sleep(0.02)
            if sys.argv[2] == "asks":
                light.state()
except CaptureError as error:
    print(f"{type(error).__name__}: {error}", flush=True)
except KeyboardInterrupt:
    print("interrupted", flush=True)
"""


@contextmanager
def owner(address: str, habit: str = "waits", driver: str = "arduino") -> Iterator["subprocess.Popen[str]"]:
    """Run a program that keeps the laser on for a ``with`` block, in a process group of its own."""
    command = [sys.executable, "-c", OWNER, address, habit, driver]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, start_new_session=True) as process:
        try:
            assert process.stdout is not None
            assert process.stdout.readline() == "ON\n"
            yield process
        finally:
            process.kill()
    wait_until(lambda: not guards(address), "the end of the guard")


def guards(address: str) -> list[int]:
    """Return the guard processes of a light that run."""
    found = []
    for entry in Path("/proc").iterdir():
        try:
            words = (entry / "cmdline").read_bytes().split(b"\0") if entry.name.isdigit() else []
        except OSError:
            continue  # it ended meanwhile
        if b"rigs.light_guard_process" in words and address.encode() in words:
            found.append(int(entry.name))
    return found


def the_guard(address: str) -> int:
    (pid,) = guards(address)
    return pid


class Interrupt:
    """A signal to be sent, and when it was."""

    def __init__(self, number: signal.Signals) -> None:
        self._number, self.at_s = number, 0.0

    def to(self, pid: int) -> None:
        self.at_s = time.monotonic()
        os.kill(pid, self._number)
