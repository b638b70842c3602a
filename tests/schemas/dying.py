"""What a child process may do to itself; run there by name."""

import ctypes
import os
import signal
import subprocess
import sys
import time
import warnings
from pathlib import Path
from typing import Any

from data_schemas import errors
from data_schemas.storage import tell


def add(a: float, b: float) -> dict[str, Any]:
    tell({"adding": [a, b]})
    return {"sum": a + b, "pid": os.getpid()}


def raise_signal(number: int) -> None:
    os.kill(os.getpid(), number)
    time.sleep(60.0)


def read_address_zero() -> None:
    ctypes.string_at(0)


def run_illegal_instruction() -> None:
    """Run the two bytes 0f 0b (ud2), which no x86 processor has."""
    import mmap

    page = mmap.mmap(-1, mmap.PAGESIZE, prot=mmap.PROT_READ | mmap.PROT_WRITE | mmap.PROT_EXEC)
    page.write(b"\x0f\x0b")
    ctypes.CFUNCTYPE(None)(ctypes.addressof(ctypes.c_char.from_buffer(page)))()


def take_memory(gib: float) -> int:
    return len(bytearray(int(gib * 2**30)))


def raise_named(kind: str, text: str) -> None:
    raise getattr(errors, kind)(text)


def open_file(path: str) -> None:
    Path(path).read_bytes()


def stumble() -> None:
    raise TypeError("a fault of ours")


def leave() -> None:
    os._exit(7)


def write_and_warn() -> None:
    sys.stdout.write("to standard output\n")
    os.write(2, b"from a library\n")
    warnings.warn("a warning", stacklevel=1)


def wait(seconds: float, ignore_interrupts: bool, with_own_child: bool = False) -> None:
    if ignore_interrupts:
        signal.signal(signal.SIGINT, signal.SIG_IGN)
    own = subprocess.Popen([sys.executable, "-c", f"import time; time.sleep({seconds})"]) if with_own_child else None
    tell({"pids": [os.getpid(), *([] if own is None else [own.pid])]})
    time.sleep(seconds)


def environment(name: str) -> str | None:
    return os.environ.get(name)


def main_waiting_for_a_child(ignore_interrupts: bool) -> None:
    """Be a parent of its own, which a test interrupts or kills."""
    from data_schemas.storage import Child

    with Child() as child:
        child.call(
            "tests.schemas.dying:wait",
            {"seconds": 120.0, "ignore_interrupts": ignore_interrupts, "with_own_child": True},
            hear=lambda message: sys.stdout.write(" ".join(map(str, message["pids"])) + "\n") and sys.stdout.flush(),
        )
