"""Every fault of a line, in both directions: no slot is believed that is not true, and nobody is needed.

The small twin of benchmarks/session_faults.py, with a wheel of a few lines that speaks as an FW212C does.
"""

import os
import socket
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from data_schemas import BandPassFilter, FilterWheelSettings, LostError, TimedOutError
from rigs import TerminalOperator, open_wheel
from rigs.transports import Fault, fault_listener, repeated
from tests.capture.drivers.faulty_line import KINDS, FaultyLine, Kind, Mishap
from tests.capture.drivers.programs import wait_until

MOVE_S = 20.0


class SmallWheel:
    """An FW212C on a port of the loopback."""

    def __init__(self) -> None:
        self.values = {"pos": 1, "pcount": 12, "sensors": 1, "speed": 0}
        self.server = socket.create_server(("127.0.0.1", 0))
        self.port = self.server.getsockname()[1]
        threading.Thread(target=self._accept, daemon=True).start()

    def restart(self) -> None:
        self.values.update(pos=1, sensors=1, speed=0)

    def _accept(self) -> None:
        while True:
            try:
                line, _ = self.server.accept()
            except OSError:
                return
            threading.Thread(target=self._serve, args=(line,), daemon=True).start()

    def _serve(self, line: socket.socket) -> None:
        heard = b""
        with line:
            while piece := line.recv(256):
                *commands, heard = (heard + piece).split(b"\r")
                for command in commands:
                    line.sendall(self._answer(command.decode("ascii", "replace")).encode())

    def _answer(self, command: str) -> str:
        name, _, value = command.partition("=")
        if command == "*idn?":
            return f"{command}\rTHORLABS FW102C/FW212C Filter Wheel version 1.04\r> "
        if command[:-1] in self.values and command.endswith("?"):
            return f"{command}\r{self.values[command[:-1]]}\r> "
        if name in self.values and value.isdecimal():
            self.values[name] = int(value)
            return f"{command}\r> "
        return f"{command}\rCommand error CMD_NOT_DEFINED\r> "


@contextmanager
def small_wheel() -> Iterator[SmallWheel]:
    wheel = SmallWheel()
    try:
        yield wheel
    finally:
        wheel.server.close()


@pytest.mark.parametrize("kind", KINDS)
def test_a_wheel_ends_at_its_slot_whatever_befalls_its_line(tmp_path: Path, kind: Kind) -> None:
    filters = tuple(BandPassFilter(slot=k, name=str(k), center_nm=400.0 + 20.0 * k) for k in range(1, 9))
    port = tmp_path / "ttyWheel"
    told: list[Fault] = []
    with small_wheel() as device, FaultyLine(device.port, device.restart, port) as line:
        wait_until(lambda: os.path.lexists(port), "the pseudo-terminal")
        settings = FilterWheelSettings(driver="thorlabs", address=str(port), filters=filters)
        with open_wheel(settings, TerminalOperator()) as wheel, fault_listener(told.append):
            for slot, to_device in ((3, True), (7, False), (2, True), (6, False)):
                line.arm(Mishap(kind, to_device))
                wheel.go_to(slot, MOVE_S)
                assert wheel.position() == slot == device.values["pos"]
                assert (device.values["sensors"], device.values["speed"]) == (0, 1)
    assert len(line.suffered) == 4
    assert told or kind in ("duplicate", "late", "slow")  # these come in time


def test_attempts_are_told_and_end_with_the_time() -> None:
    told: list[Fault] = []
    errors = iter([LostError("first"), TimedOutError("second")])

    def attempt(end_s: float) -> str:
        if (error := next(errors, None)) is not None:
            raise error
        return "answer"

    with fault_listener(told.append):
        assert repeated(attempt, time.monotonic() + 10.0, "wheel") == "answer"
    assert [(fault.device, fault.what, fault.attempt) for fault in told] == [
        ("wheel", "first", 1),
        ("wheel", "second", 2),
    ]

    def fails(end_s: float) -> None:
        raise LostError("gone") if end_s > time.monotonic() else TimedOutError("late")

    began_s = time.monotonic()
    with pytest.raises(LostError, match=r"gone \(tried \d+ times\)"):
        repeated(fails, began_s + 0.4, "wheel")
    assert time.monotonic() - began_s <= 0.4
    with pytest.raises(LostError, match=r"^gone$"):
        repeated(fails, began_s + 9.0, "wheel", final=(LostError,))
