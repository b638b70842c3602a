"""The emulated Thorlabs wheel as a server of the device simulator lewis, with its faults at hand."""

import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import TracebackType
from typing import Self

import zmq

from tests.capture.drivers.programs import answers, free_port, others_python, wait_until

HERE = Path(__file__).parent
CYCLE_S = 0.005
CONTROL_WITHIN_MS = 5000


class WheelControl:
    """The back door of the emulated wheel: sets its state and its faults."""

    def __init__(self, port: int) -> None:
        self._context = zmq.Context()
        self._context.setsockopt(zmq.RCVTIMEO, CONTROL_WITHIN_MS)
        self._context.setsockopt(zmq.LINGER, 0)
        self._socket = self._context.socket(zmq.REQ)
        self._socket.connect(f"tcp://127.0.0.1:{port}")

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._context.destroy()

    def call(self, method: str, *values: object) -> object:
        self._socket.send_json({"method": method, "params": values, "jsonrpc": "2.0", "id": "1"})
        reply = self._socket.recv_json()
        assert isinstance(reply, dict)
        assert "error" not in reply, reply
        return reply["result"]

    def put(self, **state: object) -> None:
        """Set attributes of the wheel: ``put(stuck=True)``."""
        for name, value in state.items():
            self.call(f"device.{name}:set", value)

    def get(self, name: str) -> object:
        return self.call(f"device.{name}:get")


class EmulatedWheel:
    """A running emulated wheel: its address for the driver, its back door, and its end."""

    def __init__(self, process: subprocess.Popen[bytes], port: int, control: WheelControl) -> None:
        self._process = process
        self.port = port
        self.address = f"socket://127.0.0.1:{port}"
        self.control = control

    def reset(self) -> None:
        """Make it as new."""
        self.control.put(idn="THORLABS FW102C/FW212C Filter Wheel version 1.04", pcount=12, pos=1, target=1, left_s=0.0)
        self.control.put(trig=0, speed=0, sensors=1, baud=1, step_s=0.02, prompt_after_move=False, owed=[])
        self.control.put(stuck=False, slip=0, mute=False, garble=False, late_s=0.0, forgets="")

    def stop(self) -> None:
        """Kill it: the plug is out."""
        self._process.kill()
        self._process.wait()


@contextmanager
def emulated_wheel() -> Iterator[EmulatedWheel]:
    """Start an emulated wheel for a ``with`` block."""
    port, control_port = free_port(), free_port()
    command = [others_python("lewis"), "-c", "from lewis.scripts.run import run_simulation; run_simulation()"]
    command += ["-a", str(HERE), "-k", "lewis_devices", "fw212c", "-c", str(CYCLE_S), "-o", "none"]
    command += ["-p", f"stream: {{bind_address: 127.0.0.1, port: {port}}}", "-r", f"127.0.0.1:{control_port}"]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        wait_until(lambda: answers(port) and answers(control_port), "the emulated wheel of lewis")
        with WheelControl(control_port) as control:
            yield EmulatedWheel(process, port, control)
    finally:
        process.kill()
        process.wait()
