"""The live view: who is let in, what pages may ask, what the numbers say, and the page in a real browser."""

import http.client
import json
import signal
import socket
import struct
import subprocess
import sys
import threading
import time
from contextlib import ExitStack, contextmanager
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from data_schemas import CameraSettings, CaptureError, LostError, RigFile
from finray_calib.cli.main import main
from rigs import OpenRig, open_rig, write_rig
from rigs.live_view import LiveRig, focus_measure, live_server
from rigs.live_view._live_server import LONGEST_EXPOSURE_S, live_picture
from tests.capture.drivers.programs import require

PATIENCE_S = 30.0


@contextmanager
def viewing(rig: RigFile, change=lambda opened: None):
    """Run a live view with its server; yield both, and the open devices."""
    with ExitStack() as stack:
        opened = stack.enter_context(open_rig(rig, Path()))
        change(opened)
        live = LiveRig(opened, rig)
        server = stack.enter_context(live_server(live))
        threads = [threading.Thread(target=run, daemon=True) for run in (live.run, server.serve_forever)]
        for thread in threads:
            thread.start()
        try:
            yield live, server, opened
        finally:
            live.stop()
            server.shutdown()
            for thread in threads:
                thread.join(PATIENCE_S)


@pytest.fixture
def view(rig: RigFile):
    with viewing(rig) as found:
        yield found


def request(server, method, path, token=None, host=None, body=None, **headers):
    """Return status, headers and body of one request."""
    connection = http.client.HTTPConnection(*server.server_address, timeout=PATIENCE_S)
    connection.putrequest(method, path, skip_host=True)
    connection.putheader("Host", host or server.host)
    sent = {**({} if token is None else {"X-Token": token}), **headers}
    if body is not None:
        sent.setdefault("Content-Length", str(len(body)))
    for name, value in sent.items():
        connection.putheader(name.replace("_", "-"), value)
    connection.endheaders()
    if body is not None:
        connection.send(body)
    answer = connection.getresponse()
    read = answer.status, dict(answer.getheaders()), answer.read()
    connection.close()
    return read


def until(live: LiveRig, wanted):
    """Return the first numbers that are as wanted."""
    end, number = time.monotonic() + PATIENCE_S, 0
    while time.monotonic() < end:
        _, numbers = live.latest(number)
        number = numbers.number
        if wanted(numbers):
            return numbers
    raise AssertionError(f"not within {PATIENCE_S} s: {numbers}")


def test_only_the_token_with_our_own_host_is_let_in(view):
    _, server, _ = view
    page = f"/?token={server.token}"
    assert request(server, "GET", page)[0] == 200
    assert request(server, "GET", "/frame", token=server.token)[0] == 200
    assert request(server, "GET", "/")[0] == 403
    assert request(server, "GET", page, host="evil.example:80")[0] == 403
    assert request(server, "GET", "/frame", token="x" * len(server.token))[0] == 403
    assert request(server, "GET", f"/frame?token={server.token}")[0] == 403
    assert request(server, "GET", "/frame", token=server.token, host="localhost")[0] == 403
    assert request(server, "POST", "/do", body=b'{"lamp": true}')[0] == 403
    assert request(server, "GET", "/session.json", token=server.token)[0] == 404
    assert server.server_address[0] == "127.0.0.1"


def test_the_page_loads_nothing_from_outside(view):
    _, server, _ = view
    _, headers, body = request(server, "GET", f"/?token={server.token}")
    assert headers["Content-Security-Policy"].startswith("default-src 'none'")
    assert (headers["Referrer-Policy"], headers["Cache-Control"]) == ("no-referrer", "no-store")
    assert b"http://" not in body
    assert b"https://" not in body


def test_frame_and_numbers(view, rig):
    live, server, _ = view
    until(live, lambda n: n.number > 0)
    status, headers, body = request(server, "GET", "/frame?after=0", token=server.token)
    told = json.loads(headers["X-Numbers"])
    assert status == 200
    assert len(body) == told["width"] * told["height"]
    assert (told["frame_height"], told["frame_width"]) == (rig.camera.height_px, rig.camera.width_px)
    assert sum(told["histogram"]) == rig.camera.height_px * rig.camera.width_px
    assert told["filters"] == [band.name for band in rig.filter_wheel.filters]
    assert (told["lamp"], told["laser"]) == (False, False)


def test_lamp_filter_exposure_and_region_follow_the_page(view):
    live, server, opened = view

    def ask(**command):
        assert request(server, "POST", "/do", token=server.token, body=json.dumps(command).encode())[0] == 200

    ask(region=[41, 51, 31, 33])
    dark = until(live, lambda n: n.region == (40, 50, 30, 32)).brightest_fraction
    ask(lamp=True)
    ask(filter="560")
    lit = until(live, lambda n: n.lamp and n.filter_name == "560" and n.brightest_fraction > 2 * dark)
    assert not lit.laser
    ask(exposure_s=lit.suggested_s)
    metered = until(live, lambda n: n.exposure_s == pytest.approx(lit.suggested_s, rel=0.01))
    assert metered.brightest_fraction == pytest.approx(0.7, abs=0.1)
    ask(lamp=False)
    assert until(live, lambda n: not n.lamp).brightest_fraction < 0.1
    assert not opened.lamp.state()
    assert not opened.laser.state()


def test_exposures_stay_short_enough_for_the_light_to_go_off(view, rig):
    live, _, _ = view
    live.ask({"exposure_s": 1000})
    assert until(live, lambda n: n.exposure_s > 1).exposure_s == LONGEST_EXPOSURE_S
    live.ask({"exposure_s": 1e-9})
    assert until(live, lambda n: n.exposure_s < 1).exposure_s == pytest.approx(rig.camera.shortest_exposure_s)


@pytest.mark.parametrize(
    "command",
    [{}, {"laser": True}, {"lamp": 1}, {"filter": "999"}, {"exposure_s": -1}, {"exposure_s": float("inf")},
     {"exposure_s": float("nan")},
     {"exposure_s": "1"}, {"region": [1, 2, 3]}, {"region": ["a", 1, 1, 1]}],
)  # fmt: skip
def test_what_pages_may_not_ask(view, command):
    live, _, opened = view
    with pytest.raises(CaptureError, match="valid commands are lamp"):
        live.ask(command)
    assert not opened.laser.state()


def test_bodies_that_are_no_command(view):
    _, server, _ = view
    for body, status in ((b"{", 400), (b"[1]", 400), (b"[" * 900, 400), (b'{"laser": true}', 400)):
        assert request(server, "POST", "/do", token=server.token, body=body)[0] == status
    for length in ("1001", "-1", "x", "9999999999"):
        assert request(server, "POST", "/do", token=server.token, body=b"", Content_Length=length)[0] == 413
    assert request(server, "GET", "/frame?after=99999999999999999999", token=server.token)[0] == 200


def test_a_page_that_is_closed_while_it_asks_leaves_the_terminal_clear(view, capfd):
    _, server, _ = view
    for begun in (b"", b"GET /frame HTTP/1.1\r\n"):
        page = socket.create_connection(server.server_address, timeout=PATIENCE_S)
        page.sendall(begun)
        time.sleep(0.1)  # the server reads it
        page.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))  # close() resets the connection
        page.close()
    time.sleep(0.1)
    assert request(server, "GET", "/frame", token=server.token)[0] == 200
    assert capfd.readouterr().err == ""


def test_an_exposure_beyond_every_number_is_the_longest(view):
    live, _, _ = view
    live.ask({"exposure_s": 10**400})
    assert live.exposure_s == LONGEST_EXPOSURE_S


@pytest.mark.parametrize("asked", [(-50, -50, 10, 10), (10_000, 10_000, 10, 10), (0, 0, 0, 0), (3, 5, 10_000, 10_000)])
def test_regions_lie_in_the_frame_in_whole_cells(view, rig, asked):
    live, _, _ = view
    live.ask({"region": list(asked)})
    whole = (0, 0, rig.camera.height_px, rig.camera.width_px)
    row, column, height, width = until(live, lambda n: n.number > 1 and (n.region != whole or 10_000 in asked)).region
    assert not any(value % 2 for value in (row, column, height, width))
    assert row >= 0
    assert column >= 0
    assert height >= 8
    assert width >= 8
    assert row + height <= rig.camera.height_px
    assert column + width <= rig.camera.width_px


def test_a_camera_that_fails_is_named_and_the_lamp_goes_off(rig):
    broken = threading.Event()

    def fail(opened: OpenRig) -> None:
        expose = opened.camera.expose

        class Camera:
            def expose(self, exposure_s, deadline_s):
                if broken.is_set():
                    raise LostError("camera: unplugged; plug it in")
                return expose(exposure_s, deadline_s)

        object.__setattr__(opened, "camera", Camera())

    with viewing(rig, fail) as (live, _, opened):
        live.ask({"lamp": True})
        until(live, lambda n: n.lamp)
        broken.set()
        assert "unplugged" in until(live, lambda n: n.trouble).trouble
        assert not opened.lamp.state()
        broken.clear()
        assert not until(live, lambda n: not n.trouble).lamp


def test_a_lamp_that_is_not_confirmed_off_after_a_fault_is_reported_and_the_view_stays(rig):
    broken = threading.Event()

    def refuse(opened: OpenRig) -> None:
        lamp, camera = opened.lamp, opened.camera

        @contextmanager
        def never_off():
            with lamp.lit():
                yield
            raise LostError("lamp: NOT CONFIRMED OFF; pull its plug")

        def expose(exposure_s, deadline_s):
            if broken.is_set():
                broken.clear()
                raise LostError("camera: unplugged; plug it in")
            return camera.expose(exposure_s, deadline_s)

        object.__setattr__(opened, "lamp", SimpleNamespace(lit=never_off, state=lamp.state))
        object.__setattr__(opened, "camera", SimpleNamespace(expose=expose))

    with viewing(rig, refuse) as (live, _, _):
        live.ask({"lamp": True})
        until(live, lambda n: n.lamp)
        broken.set()
        told = until(live, lambda n: n.trouble)
        assert "NOT CONFIRMED OFF" in told.trouble
        assert until(live, lambda n: not n.trouble).number > told.number


def test_the_lamp_is_off_when_the_view_ends(rig):
    with viewing(rig) as (live, _, opened):
        live.ask({"lamp": True})
        until(live, lambda n: n.lamp)
    assert not opened.lamp.state()


def scene(sigma_px, exposure_s, noise_seed, camera):
    """Return counts of a random scene, blurred, at an exposure, with the noise of the camera."""
    rng = np.random.default_rng(1)
    texture = gaussian_filter(rng.standard_normal((240, 320)), 1.0)
    sharp = 1.0 + 0.3 * texture / texture.std()
    electrons = exposure_s * 2000.0 * np.clip(gaussian_filter(sharp, sigma_px), 0.05, None)
    noise = np.random.default_rng(noise_seed)
    seen = noise.poisson(electrons) + camera.read_noise_e * noise.standard_normal(electrons.shape)
    return np.clip(np.round(camera.black_level_dn + seen / camera.gain_e_per_dn), 0, 1023).astype(np.uint16)


def test_focus_falls_with_blur_and_does_not_depend_on_exposure_or_noise():
    camera = CameraSettings()
    focus = [focus_measure(scene(sigma, 1.0, 2, camera), camera) for sigma in (0.0, 0.7, 1.5, 3.0)]
    assert focus == sorted(focus, reverse=True)
    assert focus[3] < 0.1 * focus[0]
    dim = focus_measure(scene(0.0, 0.25, 3, camera), camera)
    assert dim == pytest.approx(focus[0], rel=0.1)
    flat = np.full((240, 320), 100.0)
    noise = np.random.default_rng(4)
    counts = np.round(camera.black_level_dn + noise.poisson(flat * camera.gain_e_per_dn) / camera.gain_e_per_dn
                      + camera.read_noise_e / camera.gain_e_per_dn * noise.standard_normal(flat.shape))  # fmt: skip
    assert abs(focus_measure(counts.astype(np.uint16), camera)) < 0.05 * focus[0]


def test_picture_marks_full_scale_and_is_small():
    counts = np.full((1024, 1280), 100, np.uint16)
    counts[512, 640] = 1023
    picture = live_picture(counts, 1023, 16.0)
    assert picture.shape == (512, 640)
    assert (picture == 255).sum() == 1
    assert live_picture(np.zeros((3000, 4000), np.uint16), 1023, 16.0).shape[1] <= 640


@pytest.mark.parametrize("ending", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_command_prints_an_address_and_ends_in_order(rig, tmp_path, ending):
    path = write_rig(rig, tmp_path / "rig.toml")
    command = [sys.executable, "-m", "finray_calib.cli.main", "live", "--rig", str(path)]
    pipe = subprocess.PIPE
    with subprocess.Popen(command, stdout=pipe, stderr=pipe, text=True) as process:
        assert process.stdout.readline().startswith("http://127.0.0.1:")
        process.send_signal(ending)
        _, err = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 0
    assert err == ""


@pytest.mark.parametrize("port", ["80", "x", "65536"])
def test_ports_that_are_none(port, capsys):
    assert main(["live", "--rig", "rig.toml", "--port", port]) == 2
    assert "must be a whole number from 1024 to 65535" in capsys.readouterr().err


@pytest.mark.rigs
def test_page_in_a_real_browser(view, tmp_path):
    """The page shows picture, numbers and filters, and its script runs under its own policy."""
    live, server, _ = view
    live.ask({"lamp": True})
    until(live, lambda n: n.lamp)
    command = [
        require("chromium", "chromium"), "--headless=new", "--no-sandbox", "--disable-gpu", "--virtual-time-budget=700",
        f"--user-data-dir={tmp_path}/profile", "--window-size=1280,900", "--dump-dom", server.url,
    ]  # fmt: skip
    dom = subprocess.run(command, capture_output=True, text=True, check=True, timeout=300).stdout
    assert 'id="lamp" class="bad">ON' in dom
    assert 'id="laser" class="good">off' in dom
    assert "brightest pixel at" in dom or "full scale" in dom
    assert dom.count('aria-pressed="') == 8
    assert "row_px = 0" in dom
    assert server.token not in dom.partition("<script>")[0]
