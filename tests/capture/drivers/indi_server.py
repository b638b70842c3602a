"""INDI's own server and drivers, in a network of their own: it listens on every interface and cannot be told not to.

The server runs inside new user, network and process namespaces, where only a loopback exists. Two relays bridge it:
one inside from a socket file (the file system is shared) to the server, one outside from a loopback port to the file.
"""

import os
import shlex
import signal
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import TracebackType
from typing import Self

import pytest

from rigs.transports._indi_client import IndiAddress, devices_at
from tests.capture.drivers.programs import answers, free_port, require, wait_until

CCD, WHEEL, PANEL = "CCD Simulator", "Filter Simulator", "Light Panel Simulator"
SIMULATORS = {"indi_simulator_ccd": CCD, "indi_simulator_wheel": WHEEL, "indi_simulator_lightpanel": PANEL}
# Drivers of real devices that can pretend to have one.
REAL_WHEELS = {
    "indi_optec_wheel": "Optec IFW",
    "indi_quantum_wheel": "Quantum Wheel",
    "indi_trutech_wheel": "TruTech Wheel",
    "indi_qhycfw2_wheel": "QHYCFW2",
}
INDI_PORT = 7624


class IndiServer:
    """A server with its drivers; start, kill and start again at the same address."""

    def __init__(self, folder: Path, drivers: dict[str, str]) -> None:
        for program, package in (("indiserver", "indi-bin"), ("socat", "socat"), ("unshare", "util-linux")):
            require(program, package)
        if subprocess.run(["unshare", "-rnpf", "true"], capture_output=True, check=False).returncode:
            pytest.skip(
                "unshare -rnpf is not permitted here: allow user namespaces (sysctl kernel.unprivileged_userns_clone)"
            )
        self.drivers = drivers
        self.port = free_port()
        self._folder = folder
        self._processes: list[subprocess.Popen[bytes]] = []

    def __enter__(self) -> Self:
        try:
            self.start()
        except BaseException:
            self.kill()
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.kill()

    def address(self, device: str) -> str:
        return f"127.0.0.1:{self.port}/{device}"

    def start(self) -> None:
        """Start it and wait until every driver has named its device."""
        relay = self._folder / "relay"
        relay.unlink(missing_ok=True)
        server = f"indiserver -p {INDI_PORT} -m 500 -u finray-{self.port} {' '.join(self.drivers)}"
        listen = f"socat UNIX-LISTEN:{shlex.quote(str(relay))},fork TCP:127.0.0.1:{INDI_PORT}"
        self._spawn("unshare", "-rnpf", "--kill-child", "sh", "-c", f"ip link set lo up; {server} & exec {listen}")
        wait_until(relay.exists, "the relay of the INDI server")
        self._spawn("socat", f"TCP-LISTEN:{self.port},bind=127.0.0.1,fork,reuseaddr", f"UNIX-CONNECT:{relay}")
        wait_until(lambda: answers(self.port), "the relay outside")
        where = IndiAddress("127.0.0.1", self.port, "")
        wanted = set(self.drivers.values())
        wait_until(lambda: wanted <= set(devices_at(where, time.monotonic() + 1.0)), "the INDI server")

    def kill(self) -> None:
        """Kill all of it at once."""
        for process in self._processes:
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()
        self._processes = []

    @contextmanager
    def frozen(self) -> Iterator[None]:
        """Let nothing through for a ``with`` block, while every connection stands."""
        outside = self._processes[-1].pid
        os.killpg(outside, signal.SIGSTOP)
        try:
            yield
        finally:
            os.killpg(outside, signal.SIGCONT)

    def put(self, device: str, setting: str, stays: bool = True) -> None:
        """Set a property (``"CCD_GAIN.GAIN=10"``) with INDI's own program; wait until it reads so if it stays."""
        name, value = setting.split("=")
        self._run("indi_setprop", f"{device}.{setting}")
        if stays:
            wait_until(lambda: self._run("indi_getprop", "-1", f"{device}.{name}") == value, f"{device}.{setting}")

    def crash_camera(self) -> None:
        """Have the driver of the camera crash; wait until the server has withdrawn the device and starts it again."""
        log = self._folder / "server.log"
        before = log.read_text().count("restart #")
        self.put(CCD, "CCD_SIMULATE_CRASH.CRASH=On", stays=False)
        wait_until(lambda: log.read_text().count("restart #") > before, "the restart of the camera's driver")

    def _run(self, program: str, *arguments: str) -> str:
        where = ("-h", "127.0.0.1", "-p", str(self.port), "-t", "2")
        command = [require(program, "indi-bin"), *where, *arguments]
        return subprocess.run(command, timeout=20.0, capture_output=True, text=True, check=False).stdout.strip()

    def _spawn(self, *command: str) -> None:
        log = (self._folder / "server.log").open("ab")
        with log:
            # A session of its own: socat makes a child for every connection.
            self._processes.append(
                subprocess.Popen(
                    command,
                    stdout=log,
                    stderr=log,
                    env={**os.environ, "HOME": str(self._folder)},
                    start_new_session=True,
                )
            )
