"""The ASCOM Alpaca simulators in their own environment, and a scripted server for what they never do."""

import json
import signal
import subprocess
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Self
from urllib.parse import parse_qsl, urlsplit

from tests.capture.drivers.programs import answers, free_port, others_environment, others_python, wait_until

# Starting it imports astropy, seconds on a busy machine.
READY_WITHIN_S = 60.0
# Written with the simulators' own reader of YAML, from their own template.
WRITE_CONFIGURATION = """
import sys, yaml
from pathlib import Path
import alpaca_simulators
rig = yaml.safe_load((Path(alpaca_simulators.__file__).parent / "config" / "template.yaml").read_text())
devices = rig["devices"]
devices["filterwheel"][0].update(names=[f"{nm} nm" for nm in range(420, 580, 20)], focusoffsets=[0] * 8, position=0)
devices["covercalibrator"][0].update(calibratorstate=1)
devices["covercalibrator"][1] = dict(devices["covercalibrator"][0], calibratorstate=0)
switch = dict(canasync=False, canwrite=True, maximum=1.0, minimum=0.0, step=1.0, value=False, description="light")
switches = {0: dict(switch, name="450 nm laser"), 1: dict(switch, name="interlock", canwrite=False)}
devices["switch"][0].update(maxswitch=2, switches=switches)
Path(sys.argv[1]).write_text(yaml.safe_dump(rig))
"""


class AlpacaServer:
    """The simulators with 8 slots, two switches and two cover calibrators; stop and start at the same address."""

    def __init__(self, folder: Path) -> None:
        self.python = others_python("alpaca-simulators")
        self._program = str(others_environment() / "bin" / "alpaca-simulators")
        self.port = free_port()
        self.url = f"http://127.0.0.1:{self.port}"
        self._rig = folder / "rig.yaml"
        self._log = folder / "server.log"
        subprocess.run([self.python, "-c", WRITE_CONFIGURATION, str(self._rig)], check=True, timeout=READY_WITHIN_S)
        self._process: subprocess.Popen[bytes] | None = None

    def __enter__(self) -> Self:
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.kill()

    def start(self) -> None:
        command = [self._program, "--host", "127.0.0.1", "--port", str(self.port), "--config", str(self._rig)]
        with self._log.open("ab") as log:
            self._process = subprocess.Popen(command, stdout=log, stderr=log)
        try:
            wait_until(lambda: answers(self.port), "the Alpaca server", READY_WITHIN_S)
        except BaseException:
            self.kill()
            raise

    def kill(self) -> None:
        if self._process is not None:
            self._process.kill()
            self._process.wait()
        self._process = None

    @contextmanager
    def frozen(self) -> Iterator[None]:
        """Let it answer nothing for a ``with`` block."""
        assert self._process is not None
        self._process.send_signal(signal.SIGSTOP)
        try:
            yield
        finally:
            self._process.send_signal(signal.SIGCONT)


Script = Callable[[str, str, dict[str, str]], object]
"""Method, member and parameters of a request -> value; bytes are sent as they are, an int pair is error and status."""


@contextmanager
def scripted(script: Script) -> Iterator[str]:
    """Serve what `script` says, at the URL given to the ``with`` block."""

    class Handler(BaseHTTPRequestHandler):
        def _serve(self) -> None:
            length = int(self.headers.get("Content-Length", 0))
            parts = urlsplit(self.path)
            fields = dict(parse_qsl(self.rfile.read(length).decode() if length else parts.query))
            value = script(self.command, parts.path.rsplit("/", 1)[-1], fields)
            if isinstance(value, bytes):
                body, status = value, 200
            else:
                error, status = value if isinstance(value, tuple) else (0, 200)
                answer = {
                    "Value": value,
                    "ErrorNumber": error,
                    "ErrorMessage": "scripted",
                    "ClientTransactionID": int(fields.get("ClientTransactionID", 0)),
                }
                body = json.dumps(answer).encode()
            self.send_response(status)
            self.send_header("Content-Length", str(len(body)))
            self.end_headers()
            self.wfile.write(body)

        do_GET = do_PUT = _serve  # noqa: N815

        def log_message(self, format: str, *args: object) -> None:
            """Say nothing."""

    with ThreadingHTTPServer(("127.0.0.1", 0), Handler) as server:
        thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01})
        thread.start()
        try:
            yield f"http://127.0.0.1:{server.server_address[1]}"
        finally:
            server.shutdown()
            thread.join()
