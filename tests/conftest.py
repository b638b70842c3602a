"""Fixtures shared by all test folders."""

import os
import signal
from pathlib import Path

import pytest

SHARED_DATA = Path(__file__).resolve().parents[2] / "shared" / "data"


@pytest.fixture
def shared_data() -> Path:
    """Folder of measured spectra and captures beside the checkout; its absence is a loud skip."""
    if not (SHARED_DATA / "spectra" / "README.md").is_file():
        pytest.skip(f"MEASURED DATA ABSENT: {SHARED_DATA} not found; tests on real paint and captures were NOT run")
    return SHARED_DATA


def pytest_configure(config: pytest.Config) -> None:
    """Take Ctrl-C as a terminal's processes do: a job in the background inherits, and passes on, that it is ignored."""
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    if config.getoption("markexpr") != "rigs":  # those wait for devices, and most of their work is other programs'
        _keep_to_one_core()


@pytest.hookimpl(optionalhook=True)  # where pytest-xdist is
def pytest_xdist_make_scheduler(config: pytest.Config, log):
    """Keep tests of rigs that start the programs of devices on one worker: some of these programs have a fixed port.

    Those of the check of a press wait for boards in real time and share nothing: each goes to any worker.
    """
    if config.getoption("markexpr") != "rigs":
        return None
    from xdist.scheduler import LoadScopeScheduling

    class Rigs(LoadScopeScheduling):
        def _split_scope(self, nodeid: str) -> str:
            if nodeid.startswith("tests/capture/test_check_press.py"):
                return nodeid
            return "devices" if nodeid.startswith(("tests/capture/", "tests/command_line/")) else "other programs"

    return Rigs(config, log)


def _keep_to_one_core() -> None:
    """Keep a worker of pytest-xdist, and what it starts, to one core.

    Threads that add 32-bit numbers add them in the order in which they come; at a threshold the last digit then sends a
    path of a render elsewhere. On one core the order, and so every digit, is the same in each run.
    """
    worker = os.environ.get("PYTEST_XDIST_WORKER", "")
    if worker.startswith("gw") and hasattr(os, "sched_setaffinity"):
        cores = sorted(os.sched_getaffinity(0))
        os.sched_setaffinity(0, {cores[int(worker[2:]) % len(cores)]})
