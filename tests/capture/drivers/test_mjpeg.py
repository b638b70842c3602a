"""MJPEG cameras against ffmpeg and uStreamer, and against bytes that they once sent."""

import itertools
import math
import signal
import socket
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager, suppress
from functools import lru_cache
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from data_schemas import BadFrameError, CameraSettings, CaptureError, LostError, RefusedError, TimedOutError
from rigs import SystemClock
from rigs.cameras._image_files import decoded_jpeg, jpeg_size_px
from rigs.cameras.mjpeg import open_camera
from rigs.capture._exposure import CheckedCamera
from rigs.capture._plan import Step
from rigs.light_guard.watch import OffLine
from rigs.transports import Fault, MultipartStream, Part, fault_listener
from tests.capture.drivers.programs import answers, free_port, require, wait_until

TRANSCRIPTS = Path(__file__).parent / "transcripts"
WIDTH_PX, HEIGHT_PX = 320, 240
ASKED_S = 0.02


@lru_cache(1000)
def jpeg(level: int, height_px: int = HEIGHT_PX, constant: bool = False) -> bytes:
    picture = np.full((height_px, WIDTH_PX, 3), level, np.uint8)
    if not constant:
        picture[: height_px // 2, :, 2] = 255 - level  # blue, green, RED: the top is redder
    return cv2.imencode(".jpg", picture)[1].tobytes()


def part(body: bytes, *headers: str, length: bool = True) -> bytes:
    lines = ["--frame", "Content-Type: image/jpeg", *headers, *([f"Content-Length: {len(body)}"] if length else [])]
    return "\r\n".join([*lines, "", ""]).encode() + body + b"\r\n"


def stream_of(*bodies: bytes) -> list[bytes]:
    return [part(body) for body in bodies]


OK = b"HTTP/1.0 200 OK\r\nContent-Type: multipart/x-mixed-replace; boundary=frame\r\n"


@contextmanager
def serving(
    parts: list[bytes] | Callable[[], list[bytes]], head: bytes = OK, every_s: float = 0.01, hold: bool = False
) -> Iterator[str]:
    """An HTTP server that sends the parts to every client, then hangs up (or holds the line)."""
    done = threading.Event()
    with socket.create_server(("127.0.0.1", 0)) as server:
        server.settimeout(0.02)

        def serve() -> None:
            while not done.is_set():
                try:
                    link, _ = server.accept()
                except TimeoutError:
                    continue
                with closing(link):
                    try:
                        link.recv(4096)
                        link.sendall(head + b"\r\n")
                        for piece in parts() if callable(parts) else parts:
                            link.sendall(piece)
                            done.wait(every_s)
                        if hold:
                            done.wait()
                    except OSError:
                        continue

        thread = threading.Thread(target=serve)
        thread.start()
        try:
            yield f"http://127.0.0.1:{server.getsockname()[1]}/stream"
        finally:
            done.set()
            thread.join()


def camera_at(address: str, **other: object) -> CameraSettings:
    fields = {"driver": "mjpeg", "address": address, "width_px": WIDTH_PX, "height_px": HEIGHT_PX, "bit_depth": 8}
    return CameraSettings.model_validate(fields | other)


def opened(address: str, **other: object):
    return open_camera(camera_at(address, **other), Path())


def test_picture_is_rgb_of_eight_bits_with_unknown_exposure():
    with serving(stream_of(*(jpeg(n) for n in range(40, 240)))) as address, opened(address) as camera:
        frame = camera.expose(ASKED_S, 2.0)
    assert frame.counts.shape == (HEIGHT_PX, WIDTH_PX, 3)
    assert frame.counts.dtype == np.uint16
    red, _, blue = frame.counts[5, 5]
    assert red > 180 > blue  # the top of the picture
    assert frame.exposure_requested_s == ASKED_S
    assert math.isnan(frame.exposure_s)
    assert frame.settings["exposure"] == "unknown"
    assert frame.settings["pixel_format"] == "RGB8"


def test_pictures_from_before_the_call_are_dropped():
    levels = range(20, 200, 2)
    with (
        serving(stream_of(*(jpeg(n, constant=True) for n in levels)), every_s=0.02) as address,
        opened(address) as camera,
    ):
        time.sleep(0.4)  # about 20 pictures come while nobody asks
        late = camera.expose(ASKED_S, 2.0).counts.mean()
    assert late > 20 + 2 * 10


@pytest.mark.parametrize("length", [True, False], ids=["with Content-Length", "without"])
def test_parts_are_whole_with_and_without_a_length(length):
    # A thumbnail inside a JPEG has an end mark of its own: only the boundary ends a part without a length.
    bodies = [jpeg(n)[:2] + b"\xff\xfe\x00\x06\xff\xd9\xff\xd8" + jpeg(n)[2:] for n in range(40, 240)]
    parts = [part(body, length=length) for body in bodies]
    with serving(parts) as address, MultipartStream(address, "camera", time.monotonic() + 2.0) as stream:
        got = [stream.next_part(time.monotonic() + 2.0).body for _ in range(10)]
    assert got == bodies[:10]


def test_repeated_picture_is_refused():
    with serving(stream_of(*[jpeg(50)] * 100)) as address, opened(address) as camera:
        camera.expose(ASKED_S, 2.0)
        with pytest.raises(BadFrameError, match="the same picture twice"):
            camera.expose(ASKED_S, 2.0)


def test_equal_pictures_of_one_value_are_no_repeat():
    with serving(stream_of(*[jpeg(0, constant=True)] * 100)) as address, opened(address) as camera:
        assert camera.expose(ASKED_S, 2.0).counts.max() == camera.expose(ASKED_S, 2.0).counts.max() == 0


def test_pictures_with_the_same_time_are_of_a_camera_that_hangs():
    parts = [part(jpeg(n), "X-Timestamp: 12.5") for n in range(40, 240)]
    with (
        serving(parts) as address,
        opened(address) as camera,
        pytest.raises(TimedOutError, match=r"no new picture came in time|none that was exposed after"),
    ):
        camera.expose(ASKED_S, 1.0)


def test_pictures_that_a_line_held_back_are_passed_over():
    """One is made every 50 ms and tells by its grey when; the line holds those of 0.6 to 1.0 s back until 1.0 s."""
    began_s: list[float] = []
    bodies = [jpeg(40 + 2 * number, constant=True) for number in range(80)]

    def held_back():
        began_s.append(time.monotonic())
        for number, body in enumerate(bodies):
            made_s = 0.05 * number
            sent_s = 1.0 if 0.6 < made_s < 1.0 else made_s
            time.sleep(max(began_s[-1] + sent_s - time.monotonic(), 0.0))
            yield part(body)

    with serving(held_back, every_s=0.0) as address, opened(address) as camera:
        while not began_s or time.monotonic() < began_s[-1] + 0.97:
            time.sleep(0.01)
        asked_s = time.monotonic() - began_s[-1]
        made_s = 0.05 * round((int(camera.expose(ASKED_S, 3.0).counts[-1, 0, 1]) - 40) / 2)
        assert made_s >= asked_s - 0.05


def test_stamped_pictures_that_were_on_their_way_for_long_are_passed_over():
    """From the tenth on they come half a second late, at the stream's pace: only their stamps tell."""

    ahead_s = 1000.0  # the server's clock is another

    def late():
        for number in range(80):
            time.sleep(0.05)
            taken_s = time.time() - (0.5 if 10 <= number < 40 else 0.0)
            yield part(jpeg(40 + number), f"X-Timestamp: {taken_s + ahead_s:.6f}")

    with serving(late, every_s=0.0) as address, opened(address) as camera:
        time.sleep(0.7)
        asked_s = time.time()
        stamp_s = camera.expose(ASKED_S, 4.0).device_time_s
        assert stamp_s is not None
        assert stamp_s - ahead_s > asked_s - 0.02  # the fastest picture so far took no longer


def test_picture_grabbed_before_the_call_is_passed_over():
    """UStreamer says how old a picture is when it is sent: here the first 30 are 100 s old."""
    old = "X-UStreamer-Online: true", "X-UStreamer-Grab-Time: 1", "X-UStreamer-Send-Time: 101"
    new = "X-UStreamer-Online: true", "X-UStreamer-Grab-Time: 200", "X-UStreamer-Send-Time: 200"
    parts = [*(part(jpeg(40), *old) for _ in range(30)), *(part(jpeg(90), *new) for _ in range(30))]
    with serving(parts) as address, opened(address) as camera:
        assert camera.expose(ASKED_S, 2.0).device_time_s == 200.0


def test_torn_picture_is_refused():
    with (
        serving(stream_of(*(jpeg(n)[:-200] for n in range(40, 240)))) as address,
        opened(address) as camera,
        pytest.raises(BadFrameError, match="incomplete or not a JPEG"),
    ):
        camera.expose(ASKED_S, 2.0)


def test_stream_that_ends_within_a_picture_is_refused():
    with (
        serving([*stream_of(jpeg(1)), part(jpeg(2))[:400]]) as address,
        opened(address) as camera,
        pytest.raises(BadFrameError, match="the stream ended in the middle of a picture"),
    ):
        camera.expose(ASKED_S, 2.0)


def test_ended_stream_is_opened_again():
    """The server hangs up after every seventh picture."""
    faults: list[Fault] = []
    levels = itertools.count(40)
    with (
        serving(lambda: stream_of(*(jpeg(next(levels)) for _ in range(7))), every_s=0.05) as address,
        opened(address) as camera,
        fault_listener(faults.append),
    ):
        assert all(camera.expose(ASKED_S, 2.0).counts.any() for _ in range(5))
    assert all("the stream ended" in fault.what for fault in faults)
    assert faults


def test_silent_stream_times_out():
    with serving(stream_of(jpeg(1)), hold=True) as address, opened(address) as camera:
        began_s = time.monotonic()
        with pytest.raises(TimedOutError, match="no new picture came in time"):
            camera.expose(ASKED_S, 0.3)
        assert 0.3 <= time.monotonic() - began_s < 1.0


def test_trickling_stream_times_out():
    """A byte now and then keeps a timeout per read from ever ending."""
    trickle = [bytes([b]) for b in part(jpeg(1))]
    with serving(trickle, every_s=0.02) as address, MultipartStream(address, "camera", time.monotonic() + 2) as stream:
        began_s = time.monotonic()
        with pytest.raises(TimedOutError, match="no complete picture came in time"):
            stream.next_part(began_s + 0.3)
        assert time.monotonic() - began_s < 1.0


def test_pictures_that_are_all_old_time_out(monkeypatch):
    """A camera that hangs behind a uStreamer that goes on sending, as fast as it can: always what it grabbed before."""
    old = {"x-ustreamer-online": "true", "x-ustreamer-grab-time": "1.0", "x-ustreamer-send-time": "100.0"}
    numbers = itertools.count(1)
    with serving(stream_of(jpeg(1)), hold=True) as address, opened(address) as camera:
        reader = camera.open(time.monotonic())
        monkeypatch.setattr(
            reader, "newer_than", lambda seen, end_s, name: (next(numbers), Part(old, b"", time.monotonic()))
        )
        began_s = time.monotonic()
        with pytest.raises(TimedOutError, match=r"no new picture came in time|none that was exposed after"):
            camera.expose(ASKED_S, 0.3)
        assert 0.3 <= time.monotonic() - began_s < 1.0


def test_picture_that_trickles_in_times_out():
    trickle = [bytes([b]) for b in part(jpeg(1))]
    with serving(trickle, every_s=0.02) as address, opened(address) as camera:
        began_s = time.monotonic()
        with pytest.raises(TimedOutError, match="no new picture came in time"):
            camera.expose(ASKED_S, 0.4)
        assert time.monotonic() - began_s < 1.0


def test_picture_that_claims_to_be_huge_is_not_decoded(monkeypatch):
    """A few bytes may claim 65500 x 65500 px, which would be 13 GB."""
    whole = jpeg(7)
    at = whole.index(b"\xff\xc0") + 5
    huge = whole[:at] + (65500).to_bytes(2) * 2 + whole[at + 4 :]
    monkeypatch.setattr(cv2, "imdecode", lambda *given: pytest.fail("decoded"))
    with (
        serving(stream_of(*[huge] * 40)) as address,
        opened(address) as camera,
        pytest.raises(RefusedError, match="pictures of 65500 x 65500 px, but the rig file states 240 x 320 px"),
    ):
        camera.expose(ASKED_S, 2.0)


@pytest.mark.parametrize("name", [".jpg", "progressive"])
def test_size_is_that_of_the_decoded_picture(name):
    progressive = [cv2.IMWRITE_JPEG_PROGRESSIVE, 1] if name == "progressive" else []
    body = cv2.imencode(".jpg", np.zeros((48, 70, 3), np.uint8), progressive)[1].tobytes()
    assert jpeg_size_px(body, "camera") == (48, 70) == decoded_jpeg(body, "camera").shape[:2]


@pytest.mark.parametrize(
    "body", [b"", b"\xff\xd8", b"\xff\xd8\xff\xd9" + bytes(20), b"GIF89a" + bytes(20), jpeg(3)[:20]]
)
def test_bytes_without_a_frame_header_are_refused(body):
    with pytest.raises(BadFrameError, match="incomplete or not a JPEG"):
        jpeg_size_px(body, "camera")


def test_server_that_never_answers_times_out():
    with (
        socket.create_server(("127.0.0.1", 0)) as silent,
        pytest.raises(TimedOutError, match="did not answer in time"),
    ):
        MultipartStream(f"http://127.0.0.1:{silent.getsockname()[1]}/", "camera", time.monotonic() + 0.2)


def test_addresses_of_a_name_share_the_deadline(monkeypatch):
    """A name with several addresses, of which the first ones do not even refuse (their queue is full)."""
    with socket.socket() as full, closing(socket.socket()) as first, closing(socket.socket()) as second:
        full.bind(("127.0.0.1", 0))
        full.listen(0)
        for link in (first, second):
            link.setblocking(False)
            link.connect_ex(full.getsockname())
        silent = (socket.AF_INET, socket.SOCK_STREAM, 0, "", full.getsockname())
        with serving(stream_of(jpeg(1)), hold=True) as address:
            answering = (*silent[:4], ("127.0.0.1", int(address.split(":")[2].split("/")[0])))
            monkeypatch.setattr(socket, "getaddrinfo", lambda *asked, **options: [silent, silent, answering])
            with MultipartStream("http://camera/", "camera", time.monotonic() + 0.6) as stream:
                assert stream.next_part(time.monotonic() + 1.0).body
            monkeypatch.setattr(socket, "getaddrinfo", lambda *asked, **options: [silent] * 3)
            began_s = time.monotonic()
            with pytest.raises(TimedOutError, match="did not answer in time"):
                MultipartStream("http://camera/", "camera", began_s + 0.3)
            assert time.monotonic() - began_s < 0.6  # three times the deadline would be 0.9


def test_an_address_of_a_family_that_the_computer_lacks_is_passed_over(monkeypatch):
    """Without IPv6, localhost may still have its address first; a light's watch must find its server as well."""
    with serving(stream_of(jpeg(1)), hold=True) as address:
        there = ("127.0.0.1", int(address.split(":")[2].split("/")[0]))
        lacked = (max(socket.AddressFamily) + 1, socket.SOCK_STREAM, 0, "", ("::1", there[1], 0, 0))
        answering = (socket.AF_INET, socket.SOCK_STREAM, 0, "", there)
        monkeypatch.setattr(socket, "getaddrinfo", lambda *asked, **options: [lacked, answering])
        with MultipartStream("http://camera/", "camera", time.monotonic() + 5.0) as stream:
            assert stream.next_part(time.monotonic() + 5.0).body
        OffLine(b"off", there).try_to_connect()
        monkeypatch.setattr(socket, "getaddrinfo", lambda *asked, **options: [lacked])
        with pytest.raises(LostError, match="cannot be reached"):
            MultipartStream("http://camera/", "camera", time.monotonic() + 5.0)
        with pytest.raises(OSError, match="not supported"):
            OffLine(b"off", there).try_to_connect()


def test_nobody_there_is_lost():
    with pytest.raises(LostError, match="cannot be reached"), opened(f"http://127.0.0.1:{free_port()}/stream"):
        pass


@pytest.mark.parametrize("host", ["a..b", "x" * 64])
def test_name_that_no_host_has_is_lost(host):
    with pytest.raises(LostError, match="cannot be reached"), opened(f"http://{host}/stream"):
        pass


def test_other_status_is_refused():
    head = b"HTTP/1.0 404 Not Found\r\n"
    with serving([], head) as address, pytest.raises(RefusedError, match="answers HTTP 404 Not Found"), opened(address):
        pass


@pytest.mark.parametrize(
    "address", ["/dev/video0", "http://", "http://host:port/x", "http://host/a b", "http://a\x7f/", "https://h/"]
)
def test_what_is_no_address_is_refused(address):
    with pytest.raises(RefusedError, match="is not an address of a stream"), opened(address):
        pass


def test_web_page_is_no_stream():
    with (
        serving([b"<p>hello</p>\n"] * 2000, every_s=0.0) as address,
        opened(address) as camera,
        pytest.raises(LostError, match="does not send a multipart stream"),
    ):
        camera.expose(ASKED_S, 2.0)


@pytest.mark.parametrize(
    ("piece", "error", "message"),
    [
        (
            b"--frame\r\n" + b"A: b\r\n" * 200 + b"".join(f"h{n}: 1\r\n".encode() for n in range(200)),
            LostError,
            "more than",
        ),
        (b"--frame\r\nContent-Length: -5\r\n\r\n", BadFrameError, "Content-Length '-5'"),
        (b"--frame\r\nContent-Length: 99999999999\r\n\r\n", BadFrameError, "bytes are allowed"),
        (b"x" * 20000, LostError, "does not send a multipart stream"),
    ],
    ids=["headers", "negative length", "huge length", "no line"],
)
def test_senseless_stream_is_refused(piece, error, message):
    with serving([piece]) as address, opened(address) as camera, pytest.raises(error, match=message):
        camera.expose(ASKED_S, 2.0)


def test_part_without_end_is_refused(monkeypatch):
    monkeypatch.setattr("rigs.transports._timed_http.LONGEST_PART_BYTES", 10_000)
    with (
        serving([part(bytes(40_000), length=False)]) as address,
        opened(address) as camera,
        pytest.raises(BadFrameError, match="longer than 10000 bytes"),
    ):
        camera.expose(ASKED_S, 2.0)


def test_other_size_is_refused():
    parts = stream_of(*(jpeg(n, height_px=200) for n in range(40, 240)))
    with (
        serving(parts) as address,
        opened(address) as camera,
        pytest.raises(RefusedError, match="pictures of 200 x 320 px, but the rig file states 240 x 320 px"),
    ):
        camera.expose(ASKED_S, 2.0)


def test_ten_bits_are_refused():
    with pytest.raises(RefusedError, match="a stream of JPEGs has 8 bits"), opened("http://localhost/", bit_depth=10):
        pass


def test_ustreamer_must_tell_whether_it_has_a_camera():
    head = OK + b"Set-Cookie: stream_client=0/2ec2; path=/\r\n"
    with (
        serving(stream_of(*(jpeg(n) for n in range(200))), head) as address,
        opened(address) as camera,
        pytest.raises(RefusedError, match="add extra_headers=1 to the address"),
    ):
        camera.expose(ASKED_S, 2.0)


def test_filtered_sessions_refuse_a_stream():
    """Its pictures are no raw counts: no paint and no camera can be measured with them."""
    dark = SimpleNamespace(state=lambda: False)
    step = Step("dark", "white", "off", None, None)
    with serving(stream_of(*(jpeg(n) for n in range(240)))) as address, opened(address) as camera:
        rig = SimpleNamespace(camera=camera, wheel=None, lamp=dark, laser=dark, clock=SystemClock())
        with pytest.raises(RefusedError, match=r"delivers colour pictures .3 values.*filtered sessions need raw"):
            CheckedCamera(rig, camera_at(address)).expose(step, ASKED_S)


def test_identity_names_driver_and_server():
    with (
        serving(stream_of(jpeg(1)), OK + b"Server: MJPG-Streamer/0.2\r\n", hold=True) as address,
        opened(address) as camera,
    ):
        identity = camera.identity()
    assert (identity.driver, identity.model, identity.address) == ("mjpeg", "MJPG-Streamer/0.2", address)


@settings(max_examples=40, deadline=None)
@given(
    st.lists(
        st.one_of(st.binary(max_size=60), st.sampled_from(stream_of(jpeg(3))), st.just(b"--frame\r\n")), max_size=6
    )
)
def test_any_bytes_give_a_part_or_a_declared_error(pieces):
    with serving(pieces, every_s=0.0) as address, MultipartStream(address, "camera", time.monotonic() + 2) as stream:
        try:
            for _ in range(8):
                stream.next_part(time.monotonic() + 2.0)
        except CaptureError:
            pass
        else:
            pytest.fail("more parts than were sent")


@given(st.binary(max_size=300), st.integers(0, 300))
def test_any_bytes_give_a_picture_or_a_bad_frame(tail, at):
    whole = jpeg(9)
    with suppress(BadFrameError):
        jpeg_size_px(whole[:at] + tail, "camera")
    with suppress(BadFrameError):
        assert decoded_jpeg(whole[:at] + tail + whole[-2:], "camera").dtype == np.uint8


def recorded(name: str) -> tuple[bytes, bytes]:
    """Head and body of an answer as it came over the wire."""
    head, _, body = (TRANSCRIPTS / name).read_bytes().partition(b"\r\n\r\n")
    return head + b"\r\n", body


def test_recorded_ffmpeg_stream_is_read():
    """Chunked, without a boundary in the Content-Type, as ffmpeg 5.1 sends it."""
    head, body = recorded("mjpeg_ffmpeg.http")
    with serving([body], head) as address, MultipartStream(address, "camera", time.monotonic() + 2) as stream:
        pictures = [decoded_jpeg(stream.next_part(time.monotonic() + 2).body, "camera") for _ in range(5)]
    assert {p.shape for p in pictures} == {(48, 64, 3)}
    assert not np.array_equal(pictures[0], pictures[4])


def test_recorded_ustreamer_without_camera_is_refused():
    head, body = recorded("mjpeg_ustreamer_offline.http")
    with (
        serving([body] * 100, head) as address,
        opened(address) as camera,
        pytest.raises(BadFrameError, match="uStreamer has no camera"),
    ):
        camera.expose(ASKED_S, 2.0)


@contextmanager
def process(*command: str) -> Iterator["subprocess.Popen[bytes]"]:
    quiet = subprocess.DEVNULL
    with subprocess.Popen(command, stdin=quiet, stdout=quiet, stderr=quiet) as running:
        try:
            yield running
        finally:
            running.kill()


@contextmanager
def ffmpeg_server() -> Iterator[tuple[str, "subprocess.Popen[bytes]"]]:
    """Ffmpeg's test picture at 30 frames/s; it serves one client."""
    program, port = require("ffmpeg", package="ffmpeg"), free_port()
    address = f"http://127.0.0.1:{port}/stream"
    source = f"testsrc2=size={WIDTH_PX}x{HEIGHT_PX}:rate=30"
    with process(
        program, "-re", "-f", "lavfi", "-i", source, "-c:v", "mjpeg", "-f", "mpjpeg", "-listen", "1", address
    ) as server:
        wait_until(lambda: listens(port), "ffmpeg")
        yield address, server


def listens(port: int) -> bool:
    """Whether a port is listened to, without connecting: ffmpeg serves one client only."""
    table = Path("/proc/net/tcp").read_text().splitlines()[1:]
    return any(line.split()[1].endswith(f":{port:04X}") and line.split()[3] == "0A" for line in table)


@pytest.mark.rigs
class TestFfmpeg:
    def test_new_pictures_come_in_time(self):
        with ffmpeg_server() as (address, _), opened(address) as camera:
            began_s = time.monotonic()
            frames = [camera.expose(ASKED_S, 5.0) for _ in range(3)]
            assert time.monotonic() - began_s < 3.0  # four pictures of 33 ms each, on a busy machine
        assert len({frame.counts.tobytes() for frame in frames}) == 3

    def test_stopped_server_times_out(self):
        with ffmpeg_server() as (address, server), opened(address) as camera:
            camera.expose(ASKED_S, 5.0)
            server.send_signal(signal.SIGSTOP)
            began_s = time.monotonic()
            with pytest.raises(TimedOutError, match="no new picture came in time"):
                camera.expose(ASKED_S, 0.5)
            assert time.monotonic() - began_s < 1.5

    def test_killed_server_is_lost(self):
        with ffmpeg_server() as (address, server), opened(address) as camera:
            camera.expose(ASKED_S, 5.0)
            server.kill()
            began_s = time.monotonic()
            with pytest.raises((LostError, BadFrameError), match=r"the stream ended|cannot be reached"):
                camera.expose(ASKED_S, 2.0)
            assert time.monotonic() - began_s < 3.0
            with pytest.raises(LostError, match="cannot be reached"):
                camera.expose(ASKED_S, 1.0)


@pytest.mark.rigs
def test_ustreamer_without_camera_is_refused(tmp_path):
    program, port = require("ustreamer", package="ustreamer"), free_port()
    blank = tmp_path / "blank.jpg"
    blank.write_bytes(jpeg(90))
    no_camera = str(tmp_path / "no-camera")
    with process(program, "-d", no_camera, "--host", "127.0.0.1", "--port", str(port), "-k", str(blank)):
        wait_until(lambda: answers(port), "uStreamer")
        with (
            opened(f"http://127.0.0.1:{port}/stream?extra_headers=1") as camera,
            pytest.raises(BadFrameError, match="uStreamer has no camera"),
        ):
            camera.expose(ASKED_S, 5.0)
        with (
            opened(f"http://127.0.0.1:{port}/stream") as camera,
            pytest.raises(RefusedError, match="add extra_headers=1"),
        ):
            camera.expose(ASKED_S, 5.0)
