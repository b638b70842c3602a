"""The live view over HTTP on 127.0.0.1: a page, the newest frame as plain bytes, and commands; all with a token.

A page of another site can reach a server on the own computer (DNS rebinding): the Host must be ours, and frames and
commands need the token in a header, which a foreign page can neither read nor set. No frame is sent before it is asked
for, so a slow page has no backlog.
"""

import contextlib
import hmac
import json
import secrets
from dataclasses import asdict
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from urllib.parse import parse_qs, urlsplit

from data_schemas import CaptureError, FinrayError
from data_schemas.storage import parse_json, read_bytes
from rigs.live_view._live_rig import LiveRig

LOOPBACK = "127.0.0.1"
MOST_COMMAND_BYTES = 1000
PAGE = Path(__file__).with_name("live_view.html")


class LiveServer(ThreadingHTTPServer):
    """Serves one live view.

    Attributes
    ----------
    live
        Where frames come from.
    token
        What every request must carry.
    """

    daemon_threads = True

    def __init__(self, live: LiveRig, port: int):
        self.live, self.token = live, secrets.token_urlsafe(24)
        super().__init__((LOOPBACK, port), _Handler)

    @property
    def host(self) -> str:
        """Address and port."""
        return f"{LOOPBACK}:{self.server_address[1]}"

    @property
    def url(self) -> str:
        """What is opened in the browser."""
        return f"http://{self.host}/?token={self.token}"


def live_server(live: LiveRig, port: int = 0) -> LiveServer:
    """Return a server of a live view, bound and not yet serving; port 0 takes a free one."""
    return LiveServer(live, port)


class _Handler(BaseHTTPRequestHandler):
    """Answers one connection."""

    protocol_version = "HTTP/1.1"
    timeout = 30.0
    server: LiveServer

    def log_message(self, *_: object) -> None:
        """Keep the terminal clear; the address holds the token."""

    def do_GET(self) -> None:
        """Answer with the page or the newest frame."""
        asked = urlsplit(self.path)
        query = parse_qs(asked.query)
        if asked.path == "/" and self._is_allowed(query.get("token", [""])[0]):
            self._reply("text/html; charset=utf-8", read_bytes(PAGE, "the page of the live view"))
        elif asked.path == "/frame" and self._is_allowed(self.headers.get("X-Token", "")):
            after = query.get("after", ["0"])[0]
            picture, numbers = self.server.live.latest(int(after) if after.isdecimal() and len(after) < 12 else 0)
            told = {
                **asdict(numbers),
                "width": picture.shape[1],
                "height": picture.shape[0],
                "frame_height": self.server.live.frame_size[0],
                "frame_width": self.server.live.frame_size[1],
                "filters": list(self.server.live.filters),
            }
            self._reply("application/octet-stream", picture.tobytes(), {"X-Numbers": json.dumps(told)})
        elif asked.path not in ("/", "/frame"):
            self.send_error(404)

    def do_POST(self) -> None:
        """Take a command."""
        if not self._is_allowed(self.headers.get("X-Token", "")):
            return
        length = self.headers.get("Content-Length", "")
        if not length.isdecimal() or len(length) > 6 or int(length) > MOST_COMMAND_BYTES:
            self.close_connection = True
            self.send_error(413)
            return
        try:
            command = parse_json(self.rfile.read(int(length)), "live view", CaptureError)
            self.server.live.ask(command if isinstance(command, dict) else {})
        except FinrayError as error:
            self._reply("text/plain; charset=utf-8", str(error).encode(), status=400)
        else:
            self._reply("application/json", b"{}")

    def _is_allowed(self, token: str) -> bool:
        """Whether a request is ours; it is answered where it is not."""
        own = hmac.compare_digest(token.encode(), self.server.token.encode())
        if own and self.headers.get("Host") == self.server.host:
            return True
        self.close_connection = True
        self.send_error(403)
        return False

    def _reply(self, kind: str, body: bytes, headers: dict[str, str] | None = None, status: int = 200) -> None:
        """Send an answer; a page that was closed meanwhile gets none."""
        with contextlib.suppress(BrokenPipeError, ConnectionResetError):
            self.send_response(status)
            own = {"Content-Type": kind, "Content-Length": str(len(body)), "Cache-Control": "no-store"}
            policy = "default-src 'none'; style-src 'unsafe-inline'; script-src 'unsafe-inline'; connect-src 'self'"
            safe = {"Referrer-Policy": "no-referrer", "X-Content-Type-Options": "nosniff",
                    "Content-Security-Policy": policy, "X-Frame-Options": "DENY"}  # fmt: skip
            for name, value in {**own, **safe, **(headers or {})}.items():
                self.send_header(name, value)
            self.end_headers()
            self.wfile.write(body)
