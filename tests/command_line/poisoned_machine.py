"""Checks of a machine that hang, die and raise; run in processes by name."""

import os
import signal
import time

from data_schemas import SimulateError


def hangs() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    time.sleep(600.0)


def dies() -> None:
    os.kill(os.getpid(), signal.SIGILL)


def raises() -> None:
    raise SimulateError("the library cannot be used")


def stumbles() -> None:
    raise ZeroDivisionError("division by zero")


def is_good() -> dict[str, str]:
    return {"state": "good", "found": "all right", "mend": ""}
