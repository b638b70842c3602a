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


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Keep tests that start the programs of devices on one worker: some of these programs have a fixed port."""
    for item in items:
        if item.get_closest_marker("rigs") and not item.get_closest_marker("xdist_group"):
            with_devices = {"capture", "command_line"} & set(item.path.parts)
            item.add_marker(pytest.mark.xdist_group("devices" if with_devices else "other programs"))


def _keep_to_one_core() -> None:
    """Keep a worker of pytest-xdist, and what it starts, to one core.

    Threads that add 32-bit numbers add them in the order in which they come; at a threshold the last digit then sends a
    path of a render elsewhere. On one core the order, and so every digit, is the same in each run.
    """
    worker = os.environ.get("PYTEST_XDIST_WORKER", "")
    if worker.startswith("gw") and hasattr(os, "sched_setaffinity"):
        cores = sorted(os.sched_getaffinity(0))
        os.sched_setaffinity(0, {cores[int(worker[2:]) % len(cores)]})
