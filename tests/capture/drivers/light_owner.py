"""A program that keeps a laser on behind its guard, and the guard processes that run."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from tests.capture.drivers import file_switch
from tests.capture.drivers.programs import wait_until

OWNER = """
import sys, time
from data_schemas.errors import CaptureError
from rigs.light_guard import guarded_light
try:
    with guarded_light("laser", sys.argv[3], sys.argv[1]) as light:
        if sys.argv[2] == "rests":
            print("READY", flush=True)
            sys.stdin.readline()
        with light.lit():
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


def start_owner(folder: Path, habit: str = "waits") -> "subprocess.Popen[str]":
    """Start an owner that keeps the light in a file on."""
    stand_in = f"offered('light')['indi'] = (Driver('light', 'indi', {file_switch.__name__!r}),)"
    program = f"from rigs import Driver, offered\n{stand_in}\n{OWNER}"
    command = [sys.executable, "-c", program, str(folder), habit, "indi"]
    pipe = subprocess.PIPE
    return subprocess.Popen(command, stdin=pipe, stdout=pipe, text=True, start_new_session=True)


@contextmanager
def file_owner(folder: Path, habit: str = "waits") -> Iterator["subprocess.Popen[str]"]:
    """Run an owner that keeps the light in a file on for a ``with`` block."""
    with start_owner(folder, habit) as process:
        try:
            assert process.stdout is not None
            assert process.stdout.readline() == "ON\n"
            yield process
        finally:
            for pid in (process.pid, *guards(str(folder)), *watches(str(folder))):
                with suppress(ProcessLookupError):
                    os.kill(pid, signal.SIGKILL)


def guards(address: str) -> list[int]:
    """Return the guard processes of a light that run."""
    module = b"rigs.light_guard.guard_process"
    return [pid for pid, words in commands() if words[2:4] == [b"-m", module] and address.encode() in words]


def watches(address: str) -> list[int]:
    """Return the watches of a light that run; their command names the guard's module too, for the successor."""
    return [pid for pid, words in commands() if f"laser at {address}".encode() in words]


def commands() -> Iterator[tuple[int, list[bytes]]]:
    """Return the processes that run, with the words of their commands."""
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            with suppress(OSError):  # it ended meanwhile
                yield int(entry.name), (entry / "cmdline").read_bytes().split(b"\0")


def the_guard(address: str) -> int:
    (pid,) = guards(address)
    return pid


def the_watch(address: str) -> int:
    (pid,) = watches(address)
    return pid


class Interrupt:
    """A signal to be sent, and when it was."""

    def __init__(self, number: signal.Signals) -> None:
        self._number, self.at_s = number, 0.0

    def to(self, pid: int) -> None:
        self.at_s = time.monotonic()
        os.kill(pid, self._number)
