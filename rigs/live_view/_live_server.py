"""The newest frame of a rig with its numbers, and the live view of it over HTTP on 127.0.0.1, with a token.

The numbers are focus, exposure, saturation, histogram, wheel and lights; a page gets the newest frame as plain bytes
and gives commands.

A page of another site can reach a server on the own computer (DNS rebinding): the Host must be ours, and frames and
commands need the token in a header, which a foreign page can neither read nor set. No frame is sent before it is asked
for, so a slow page has no backlog.
"""

import contextlib
import hmac
import json
import math
import secrets
import sys
import threading
import time
from contextlib import ExitStack
from dataclasses import asdict, dataclass, replace
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any, Final, Protocol
from urllib.parse import parse_qs, urlsplit

import numpy as np
from numpy.typing import NDArray

from data_schemas import CameraSettings, CaptureError, FinrayError, RigFile
from data_schemas.storage import parse_json, read_bytes
from rigs import OpenRig

Counts = NDArray[np.uint16]
LONGEST_EXPOSURE_S: Final = 2.0
"""Of the live view: so long a light may take to go off when it is asked to."""
MOST_PICTURES_PER_S: Final = 12.0
DEADLINE_MARGIN_S: Final = 5.0
WHEEL_DEADLINE_S: Final = 30.0
TARGET_FRACTION: Final = 0.7
BINS: Final = 64
WIDEST_PICTURE_PX: Final = 640
SATURATED: Final = 255
"""In the picture: a cell with a count at full scale, which nothing else is."""
LEAST_REGION_PX: Final = 8


@dataclass(frozen=True, slots=True)
class LiveNumbers:
    """The numbers that are shown beside a picture.

    Attributes
    ----------
    number
        Of the frame, from 1; 0 before the first.
    exposure_s, suggested_s
        Exposure of the frame, and the one that brings the brightest pixel of the region to 70 % of full scale.
    focus, best_focus
        Sharpness of the region (see :func:`focus_measure`) and the largest of the frames that were begun since region,
        filter, exposure or lamp changed last.
    brightest_fraction, saturated_fraction
        Of the region: 99.9 % of its pixels are darker than the first, as a share of full scale; pixels at full scale.
    histogram
        Pixels of the region in 64 bins from 0 to full scale.
    region
        Row, column, height and width in pixels of the raw frame.
    filter_name, lamp, laser
        The filter in the beam ("none" while none is), and whether the lights are on, as the devices report them; a lamp
        that is not confirmed off counts as on.
    trouble
        Why there is no newer frame; empty where there is.
    """

    number: int
    exposure_s: float
    suggested_s: float
    focus: float
    best_focus: float
    brightest_fraction: float
    saturated_fraction: float
    histogram: tuple[int, ...]
    region: tuple[int, int, int, int]
    filter_name: str
    lamp: bool
    laser: bool
    trouble: str = ""


def focus_measure(counts: Counts, camera: CameraSettings) -> float:
    r"""Return the sharpness of part of a raw frame.

    .. math:: \frac{\langle g_x^2 + g_y^2 \rangle - \sigma^2}{\bar S^2}, \quad
        \sigma^2 = \bar S / K + \sigma_r^2 / K^2 + 1/12

    with g the central differences of one green plane and S its signal above the black level: independent of the
    exposure, and without the part of the camera's noise.

    Parameters
    ----------
    counts
        (H, W) raw counts, whole 2 x 2 cells of an RGGB pattern.
    camera
        Black level, gain and read noise.
    """
    green = counts[0::2, 1::2].astype(np.float64) - camera.black_level_dn
    level = max(float(green.mean()), 1.0)
    across, down = 0.5 * (green[:, 2:] - green[:, :-2]), 0.5 * (green[2:] - green[:-2])
    gain = camera.gain_e_per_dn
    noise = level / gain + (camera.read_noise_e / gain) ** 2 + 1.0 / 12.0
    return (float((across**2).mean()) + float((down**2).mean()) - noise) / level**2


class LiveRig:
    """Exposes continuously in a thread of its own, which owns all devices.

    Parameters
    ----------
    opened, rig
        The open devices and what the rig file says of them.
    """

    def __init__(self, opened: OpenRig, rig: RigFile):
        self._opened, self._rig = opened, rig
        camera = rig.camera
        self._full = 2**camera.bit_depth - 1
        self._exposure_s = min(max(0.02, camera.shortest_exposure_s), LONGEST_EXPOSURE_S)
        self._region = (0, 0, camera.height_px, camera.width_px)
        self._slot: int | None = None
        self._filter_asked = ""
        self._lamp = False
        self._best, self._settings = 0.0, 0
        self._changed = threading.Condition()
        self._stop = threading.Event()
        self._thread: threading.Thread | None = None
        self._ended_by: FinrayError | OSError | None = None
        self._picture: NDArray[np.uint8] = np.zeros((2, 2), np.uint8)
        self._numbers = LiveNumbers(0, self._exposure_s, self._exposure_s, 0, 0, 0, 0, (0,) * BINS, self._region,
                                    "none", lamp=False, laser=False)  # fmt: skip

    @property
    def filters(self) -> dict[str, int]:
        """Name of each filter -> its slot."""
        return {band.name: band.slot for band in self._rig.filter_wheel.filters}

    @property
    def frame_size(self) -> tuple[int, int]:
        """Rows and columns of a raw frame."""
        return self._rig.camera.height_px, self._rig.camera.width_px

    @property
    def region(self) -> tuple[int, int, int, int]:
        """Row, column, height and width that were asked for last, in pixels of the raw frame."""
        return self._region

    @property
    def exposure_s(self) -> float:
        """Exposure that was asked for last."""
        return self._exposure_s

    @property
    def filter_asked(self) -> str:
        """The filter that was asked for last; the one in the beam where none was."""
        return self._filter_asked or self._numbers.filter_name

    def start(self) -> None:
        """Begin to expose in a thread of its own, with the lamp off."""
        self._lamp, self._ended_by = False, None
        self._stop.clear()
        self._thread = threading.Thread(target=self._run_to_its_end, name="live view", daemon=True)
        self._thread.start()

    def run(self) -> None:
        """Expose until :meth:`stop`; the lamp is off at the end."""
        with ExitStack() as lamp:
            while not self._stop.is_set():
                began_s = time.monotonic()
                try:
                    self._look(self._follow(lamp))
                except (FinrayError, OSError) as error:
                    not_off = _off(lamp)
                    self._report(not_off or error, lamp=not_off is not None)
                self._stop.wait(max(1.0 / MOST_PICTURES_PER_S - (time.monotonic() - began_s), 0.0))

    def stop(self) -> None:
        """End :meth:`run` after the exposure that is under way."""
        self._stop.set()

    def ended(self, timeout_s: float) -> bool:
        """Return whether what :meth:`start` began has ended with the lamp off; wait for it at most `timeout_s` seconds.

        Raises
        ------
        UnsafeError
            It has ended, and the lamp is not confirmed off.
        """
        if self._thread is not None:
            self._thread.join(timeout_s)
        if self._ended_by is not None:
            raise self._ended_by
        return self._thread is None or not self._thread.is_alive()

    def _run_to_its_end(self) -> None:
        try:
            self.run()
        except (FinrayError, OSError) as error:  # of the lamp, at the end
            self._ended_by = error
        with self._changed:
            self._numbers = replace(self._numbers, number=self._numbers.number + 1, lamp=self._ended_by is not None)
            self._changed.notify_all()

    def latest(self, after: int, timeout_s: float = 5.0) -> tuple[NDArray[np.uint8], LiveNumbers]:
        """Return the newest picture (h, w), 0 to 255, and its numbers; wait for one behind number `after`."""
        with self._changed:
            self._changed.wait_for(lambda: self._numbers.number > after, timeout_s)
            return self._picture, self._numbers

    def ask(self, command: dict[str, Any]) -> None:
        """Take over what a page asks for; it is done before the next exposure.

        Parameters
        ----------
        command
            ``{"lamp": bool}``, ``{"filter": name}``, ``{"exposure_s": number}`` or ``{"region": [row, column, height,
            width]}`` in pixels of the raw frame, which is rounded down to whole Bayer cells.

        Raises
        ------
        CaptureError
            It asks for something else, or for what the rig does not have.
        """
        with self._changed:
            match command:
                case {"lamp": bool(on)}:
                    self._lamp = on
                case {"filter": str(name)} if name in self.filters:
                    self._slot, self._filter_asked = self.filters[name], name
                case {"exposure_s": int() | float() as asked_s} if 0 < asked_s < math.inf:
                    camera = self._rig.camera
                    longest_s = min(camera.longest_exposure_s, LONGEST_EXPOSURE_S)
                    self._exposure_s = float(min(max(asked_s, camera.shortest_exposure_s), longest_s))
                case {"region": [int(row), int(column), int(height), int(width)]}:
                    self._region = self._within(row, column, height, width)
                case _:
                    raise CaptureError(
                        f"live view: the command {str(command)[:80]} is not valid; valid commands are lamp (true or "
                        f"false), filter ({', '.join(self.filters)}), exposure_s (above 0) and region (row, column, "
                        "height, width)"
                    )
            self._best, self._settings = 0.0, self._settings + 1

    def facts(self) -> dict[str, Any]:
        """Return what a page needs beside the numbers."""
        rows, columns = self.frame_size
        return {"frame_height": rows, "frame_width": columns, "filters": list(self.filters)}

    def _within(self, row: int, column: int, height: int, width: int) -> tuple[int, int, int, int]:
        """Return a region in whole Bayer cells inside the frame."""
        camera = self._rig.camera
        top, left = (min(max(start, 0), size - LEAST_REGION_PX) & ~1
                     for start, size in ((row, camera.height_px), (column, camera.width_px)))  # fmt: skip
        tall = min(max(height, LEAST_REGION_PX), camera.height_px - top) & ~1
        wide = min(max(width, LEAST_REGION_PX), camera.width_px - left) & ~1
        return top, left, tall, wide

    def _follow(self, lamp: ExitStack) -> "_Asked":
        """Bring lamp and wheel to what was asked for, and return what the next frame is to be."""
        with self._changed:
            wants_lamp, slot, self._slot = self._lamp, self._slot, None
            asked = _Asked(self._exposure_s, self._region, self._settings)
        if wants_lamp != self._opened.lamp.state():
            if wants_lamp:
                lamp.enter_context(self._opened.lamp.lit())
            else:
                lamp.close()
        if slot is not None:
            self._opened.wheel.go_to(slot, WHEEL_DEADLINE_S)
        return asked

    def _look(self, asked: "_Asked") -> None:
        """Take a frame and publish it."""
        exposure_s, region = asked.exposure_s, asked.region
        taken = self._opened.camera.expose(exposure_s, exposure_s + DEADLINE_MARGIN_S)
        position, lamp, laser = self._opened.wheel.position(), self._opened.lamp.state(), self._opened.laser.state()
        name = next((name for name, slot in self.filters.items() if slot == position), "none")
        row, column, height, width = region
        seen = taken.counts[row : row + height, column : column + width]
        focus = focus_measure(seen, self._rig.camera)
        bright = float(np.quantile(seen, 0.999)) / self._full
        black = self._rig.camera.black_level_dn / self._full
        factor = (TARGET_FRACTION - black) / max(bright - black, 1e-3)
        counted = np.histogram(seen, bins=BINS, range=(0, self._full + 1))[0]
        picture = live_picture(taken.counts, self._full, self._rig.camera.black_level_dn)
        with self._changed:
            if asked.settings == self._settings:  # nothing changed while the frame was exposed
                self._best = max(self._best, focus)
            self._picture = picture
            self._numbers = LiveNumbers(
                number=self._numbers.number + 1,
                exposure_s=taken.exposure_s,
                suggested_s=taken.exposure_s * (factor if bright < 1.0 else 0.25),
                focus=focus,
                best_focus=self._best,
                brightest_fraction=bright,
                saturated_fraction=float((seen >= self._full).mean()),
                histogram=tuple(int(n) for n in counted),
                region=region,
                filter_name=name,
                lamp=lamp,
                laser=laser,
            )
            self._changed.notify_all()

    def _report(self, error: FinrayError | OSError, lamp: bool) -> None:
        """Publish what went wrong; the lamp was told to go off, and is not lit again until that is asked for."""
        with self._changed:
            self._lamp, self._filter_asked = False, ""
            self._best, self._settings = 0.0, self._settings + 1
            self._numbers = replace(self._numbers, number=self._numbers.number + 1, trouble=str(error), lamp=lamp)
            self._changed.notify_all()


@dataclass(frozen=True, slots=True)
class _Asked:
    """What a frame is to be, and of which count of settings."""

    exposure_s: float
    region: tuple[int, int, int, int]
    settings: int


def _off(lamp: ExitStack) -> FinrayError | OSError | None:
    """Switch the lamp off, and return why that was not confirmed; nothing where it was."""
    try:
        lamp.close()
    except (FinrayError, OSError) as error:
        return error
    return None


def live_picture(counts: Counts, full_scale_dn: int, black_level_dn: float) -> NDArray[np.uint8]:
    """Return a frame as a picture (h, w): mean of each Bayer cell, every n-th cell so that it is at most 640 wide.

    Counts are shown by their square root, which makes dim parts visible; 255 marks a cell with a count at full scale.
    """
    step = -(-(counts.shape[1] // 2) // WIDEST_PICTURE_PX)
    cells = [counts[row :: 2 * step, column :: 2 * step] for row in (0, 1) for column in (0, 1)]
    height, width = (min(cell.shape[axis] for cell in cells) for axis in (0, 1))
    stack = np.stack([cell[:height, :width] for cell in cells])
    share = np.clip((stack.mean(axis=0) - black_level_dn) / (full_scale_dn - black_level_dn), 0.0, 1.0)
    picture: NDArray[np.uint8] = np.round((SATURATED - 1) * np.sqrt(share)).astype(np.uint8)
    picture[(stack >= full_scale_dn).any(axis=0)] = SATURATED
    return picture


LOOPBACK = "127.0.0.1"
MOST_COMMAND_BYTES = 1000
LIVE_PAGE = Path(__file__).with_name("live_view.html")
SESSION_PAGE = Path(__file__).with_name("session_view.html")


class Seen(Protocol):
    """What a server shows: a rig, or a session."""

    def latest(self, after: int, timeout_s: float = 5.0) -> tuple[NDArray[np.uint8], Any]:
        """Return picture and numbers behind number `after`."""
        ...

    def facts(self) -> dict[str, Any]:
        """Return what a page needs beside the numbers."""
        ...

    def ask(self, command: dict[str, Any]) -> None:
        """Do what a page asks for."""
        ...


class LiveServer(ThreadingHTTPServer):
    """Serves one live view.

    Attributes
    ----------
    live
        Where frames come from.
    asked_s
        When a page asked for a frame last (:func:`time.monotonic`); minus infinity before the first.
    sent
        Largest number of a frame that was sent.
    token
        What every request must carry.
    """

    daemon_threads = True

    def __init__(self, live: Seen, port: int, page: Path):
        self.live, self.page, self.token, self.asked_s = live, page, secrets.token_urlsafe(24), -math.inf
        self.sent = 0
        super().__init__((LOOPBACK, port), _Handler)

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Keep the terminal clear of a page that was closed while it asked."""
        if not isinstance(sys.exc_info()[1], ConnectionError):
            super().handle_error(request, client_address)

    @property
    def host(self) -> str:
        """Address and port."""
        return f"{LOOPBACK}:{self.server_address[1]}"

    @property
    def url(self) -> str:
        """What is opened in the browser."""
        return f"http://{self.host}/?token={self.token}"


def live_server(live: Seen, port: int = 0) -> LiveServer:
    """Return a server of a rig or a session, bound and not yet serving; port 0 takes a free one."""
    return LiveServer(live, port, LIVE_PAGE if isinstance(live, LiveRig) else SESSION_PAGE)


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
            self._reply("text/html; charset=utf-8", read_bytes(self.server.page, "the page of the live view"))
        elif asked.path == "/frame" and self._is_allowed(self.headers.get("X-Token", "")):
            after = query.get("after", ["0"])[0]
            self.server.asked_s = time.monotonic()
            seen = self.server.live
            picture, numbers = seen.latest(int(after) if after.isdecimal() and len(after) < 12 else 0)
            told = {**seen.facts(), **asdict(numbers), "width": picture.shape[1], "height": picture.shape[0]}
            self._reply("application/octet-stream", picture.tobytes(), {"X-Numbers": json.dumps(told)})
            self.server.sent = max(self.server.sent, numbers.number)
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
