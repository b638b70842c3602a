"""Third-party programs that the drivers are tested against: where they are, free ports, and waiting for a server."""

import os
import shutil
import socket
import time
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path

import pytest

READY_WITHIN_S = 20.0
POLL_S = 0.02


def require(program: str, package: str) -> str:
    """Return the path of a program; skip loudly where it is missing, fail in continuous integration."""
    path = shutil.which(program)
    if path is None:
        miss(f"{program} is missing: apt-get install --no-install-recommends {package} (make test-rigs does it)")
    return str(path)


def others_python(package: str) -> str:
    """Return the interpreter of the environment that `make test-rigs` makes for other people's programs.

    GPL programs and heavy simulators live there and run as processes of their own.
    """
    python = others_environment() / "bin" / "python"
    if not python.exists():
        miss(f"{python} is missing, with {package} in it: make test-rigs makes it")
    return str(python)


def others_environment() -> Path:
    """Return that environment's folder."""
    return Path(os.environ.get("FINRAY_OTHERS_VENV", Path(__file__).parents[3] / ".venv-others"))


def require_module(module: str, package: str) -> None:
    """Skip loudly where a Python package is missing, fail in continuous integration."""
    if find_spec(module) is None:
        miss(f"the module {module} is missing: pip install {package}")


def miss(reason: str) -> None:
    """Skip loudly; fail in continuous integration."""
    if os.environ.get("CI"):
        pytest.fail(reason)
    pytest.skip(reason)


def free_port() -> int:
    """Return a port of the loopback that nobody uses."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def wait_until(ready: Callable[[], bool], what: str, within_s: float = READY_WITHIN_S) -> None:
    """Poll until `ready`, or fail naming what did not come."""
    end_s = time.monotonic() + within_s
    while not ready():
        if time.monotonic() > end_s:
            pytest.fail(f"{what} was not ready within {within_s:g} s")
        time.sleep(POLL_S)


def answers(port: int) -> bool:
    """Whether something listens on a port of the loopback."""
    with socket.socket() as probe:
        probe.settimeout(0.2)
        return probe.connect_ex(("127.0.0.1", port)) == 0
