"""The Aravis driver against Aravis' own fake GigE Vision camera."""

import signal
import subprocess
import threading
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import pytest

from data_schemas import BadFrameError, CameraSettings, LostError, MissingExtraError, RefusedError, TimedOutError
from rigs.cameras import GenicamCamera, aravis
from rigs.cameras import aravis as aravis_library
from rigs.capture._exposure import TactileCamera
from tests.capture.drivers.fake_gigevision_camera import SERIAL, FakeCamera, fake_camera
from tests.capture.drivers.programs import require

SIDE_PX = 512
SETTINGS = CameraSettings(driver="aravis", address="127.0.0.1", width_px=SIDE_PX, height_px=SIDE_PX, bit_depth=8)
EXPOSURE_S, DEADLINE_S = 0.01, 5.0
# How soon the loss of the camera must be noticed after the exposure; Aravis itself says so after 5.9 s.
NOTICED_S = 2.0


@pytest.fixture
def camera_process() -> Iterator[FakeCamera]:
    require("arv-tool-0.8", "aravis-tools-cli")
    with fake_camera() as process:
        yield process


@pytest.fixture
def camera(camera_process: FakeCamera) -> Iterator[GenicamCamera]:
    with aravis.open_camera(SETTINGS, Path()) as opened:
        yield opened


def expose_until(camera: GenicamCamera, within_s: float) -> int:
    """Return how many attempts it takes to get a frame again."""
    end_s, attempts = time.monotonic() + within_s, 0
    while True:
        attempts += 1
        try:
            camera.expose(EXPOSURE_S, DEADLINE_S)
        except (LostError, TimedOutError, BadFrameError):
            if time.monotonic() > end_s:
                raise
        else:
            return attempts


@pytest.mark.rigs
def test_frame_is_raw_new_and_what_was_asked(camera: GenicamCamera) -> None:
    before_s = time.time()
    first, second = (camera.expose(EXPOSURE_S, DEADLINE_S) for _ in range(2))
    assert first.counts.shape == (SIDE_PX, SIDE_PX)
    assert first.counts.dtype == "uint16"
    assert 0 < first.counts.max() <= 255
    assert first.settings["pixel_format"] == "BayerRG8"
    assert first.settings["GainAuto"] == "Off"
    assert first.settings["TransportStatus"] == "success"
    assert first.exposure_s == pytest.approx(EXPOSURE_S, abs=1e-6)
    assert first.frame_id is not None
    assert second.frame_id is not None
    assert first.device_time_s is not None
    assert second.device_time_s is not None
    # the fake camera's clock is the host's: the frame was made after the call, and the second after the first
    assert before_s < first.device_time_s < second.device_time_s <= time.time()
    identity = camera.identity()
    assert (identity.vendor, identity.model, identity.serial, identity.role) == ("Aravis", "Fake", SERIAL, "camera")
    # another program of the Aravis project reads the same exposure from the camera
    told = subprocess.run(
        ["arv-tool-0.8", "-a", "127.0.0.1", "control", "ExposureTimeAbs", "PixelFormat"],
        capture_output=True,
        text=True,
        check=True,
        timeout=20,
    ).stdout
    assert "ExposureTimeAbs = 10000" in told
    assert "PixelFormat = BayerRG8" in told


@pytest.mark.rigs
def test_found_by_name_and_serial_number(camera_process: FakeCamera) -> None:
    (name, what), *others = aravis.found()
    assert not others
    assert SERIAL in what
    for address in (name, SERIAL):
        with aravis.open_camera(SETTINGS.model_copy(update={"address": address}), Path()) as camera:
            assert camera.identity().serial == SERIAL
    elsewhere = SETTINGS.model_copy(update={"address": "NOT-THERE"})
    with (
        pytest.raises(LostError, match=f"NOT-THERE.*was not found .Aravis sees .*{SERIAL}"),
        aravis.open_camera(elsewhere, Path()),
    ):
        pass


@pytest.mark.rigs
@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"bit_depth": 10}, "no raw pixel format with 10 bits.*only .*BayerRG8.*correct bit_depth"),
        ({"width_px": 4096}, "cannot read out Width = 4096 px, only up to 2048 px; correct width_px"),
        ({"gain_db": 6.0}, "has no feature Gain, but the rig file states gain_db = 6"),
    ],
)
def test_what_the_camera_cannot_be_is_refused(
    camera_process: FakeCamera, change: dict[str, float], message: str
) -> None:
    with pytest.raises(RefusedError, match=message), aravis.open_camera(SETTINGS.model_copy(update=change), Path()):
        pass


@pytest.mark.rigs
def test_exposure_out_of_range_is_refused_and_the_next_is_taken(camera: GenicamCamera) -> None:
    with pytest.raises(RefusedError, match="cannot expose for 20 s, only for 1e-05 to 10 s"):
        camera.expose(20.0, 25.0)
    assert camera.expose(EXPOSURE_S, DEADLINE_S).counts.size == SIDE_PX**2


@pytest.mark.rigs
def test_too_short_a_deadline_keeps_the_first_frame_and_says_so(camera: GenicamCamera) -> None:
    frame = camera.expose(EXPOSURE_S, 1.5)  # two frames and the answers may take up to 3 s
    assert (
        frame.settings["FirstFrameAfterChange"]
        == "the first frame was kept, because there was no time to take a second one"
    )
    assert "FirstFrameAfterChange" not in camera.expose(EXPOSURE_S, DEADLINE_S).settings


@pytest.mark.rigs
def test_lossy_line_gives_refused_frames_and_whole_ones_only() -> None:
    require("arv-tool-0.8", "aravis-tools-cli")
    with fake_camera() as _, aravis.open_camera(SETTINGS, Path()) as camera:
        whole = camera.expose(EXPOSURE_S, DEADLINE_S).counts.sum()
    delivered = refused = 0
    with fake_camera(lost_per_thousand=5) as _, aravis.open_camera(SETTINGS, Path()) as camera:
        for _ in range(24):
            try:
                counts = camera.expose(EXPOSURE_S, DEADLINE_S).counts
            except BadFrameError:
                refused += 1
            else:
                # its pattern moves through the frame, the sum stays; a lost packet of zeros would be missed by 0.5 %
                assert counts.sum() == pytest.approx(whole, rel=1e-3)
                delivered += 1
    # 40 to 65 % of the frames lose a packet: all or none of 24 has a chance below 1e-4
    assert delivered > 0
    assert refused > 0


@pytest.mark.rigs
def test_very_lossy_line_gives_no_frame() -> None:
    require("arv-tool-0.8", "aravis-tools-cli")
    with fake_camera(lost_per_thousand=100) as _, aravis.open_camera(SETTINGS, Path()) as camera:
        for _ in range(5):
            with pytest.raises(BadFrameError, match=r"the transport reports .*use another cable or port"):
                camera.expose(EXPOSURE_S, DEADLINE_S)


@pytest.mark.rigs
def test_camera_killed_in_an_exposure_is_noticed_and_comes_back(
    camera: GenicamCamera, camera_process: FakeCamera
) -> None:
    camera.expose(EXPOSURE_S, DEADLINE_S)
    camera_process.kill()
    started_s = time.monotonic()
    with pytest.raises(LostError, match=r"did not answer within 0\.9 s; check its cable and power"):
        camera.expose(EXPOSURE_S, 2.0)
    assert time.monotonic() - started_s < 2.0 + NOTICED_S
    with pytest.raises(LostError, match=r"did not answer within|is not there"):
        camera.expose(EXPOSURE_S, 2.0)
    camera_process.start()
    assert expose_until(camera, within_s=20.0) <= 4  # as many as the capture engine makes
    assert camera.identity().serial == SERIAL


@pytest.mark.rigs
@pytest.mark.parametrize("fault", [signal.SIGKILL, signal.SIGSTOP])
def test_camera_that_falls_silent_in_an_exposure_is_lost(camera_process: FakeCamera, fault: signal.Signals) -> None:
    # one frame a second: the fault, 0.3 s after the last frame, falls between the start of an exposure and its frame
    subprocess.run(
        ["arv-tool-0.8", "-a", "127.0.0.1", "control", "AcquisitionFrameRate=1"],
        check=True,
        capture_output=True,
        timeout=20,
    )
    with aravis.open_camera(SETTINGS, Path()) as camera:
        camera.expose(1.0, 8.0)
        timer = threading.Timer(0.3, camera_process.process.send_signal, [fault])
        timer.start()
        started_s = time.monotonic()
        with pytest.raises(LostError, match=r"did not answer within 0\.6 s; check its cable and power"):
            camera.expose(1.0, 6.0)
        assert time.monotonic() - started_s < 1.0 + NOTICED_S
        timer.join()
        with pytest.raises(LostError, match="did not answer within"):
            camera.expose(1.0, 6.0)
        if fault == signal.SIGSTOP:
            camera_process.process.send_signal(signal.SIGCONT)
        else:
            camera_process.process.wait()
            camera_process.start()
        assert expose_until(camera, within_s=20.0) <= 4


@pytest.mark.rigs
def test_capture_goes_on_when_a_frozen_camera_comes_back(camera_process: FakeCamera) -> None:
    refused: list[str] = []

    def thaw(text: str) -> None:
        refused.append(text)
        camera_process.process.send_signal(signal.SIGCONT)

    with aravis.open_camera(SETTINGS, Path()) as camera:
        engine = TactileCamera(camera, SETTINGS, False, thaw)
        assert engine.expose(EXPOSURE_S)[1] == 1
        camera_process.process.send_signal(signal.SIGSTOP)
        assert engine.expose(EXPOSURE_S)[1] in (2, 3)
    assert "did not answer within" in refused[0]


@pytest.mark.rigs
def test_frame_that_does_not_come_from_a_camera_that_answers_is_late(camera_process: FakeCamera) -> None:
    subprocess.run(
        ["arv-tool-0.8", "-a", "127.0.0.1", "control", "AcquisitionFrameRate=0.2"],
        check=True,
        capture_output=True,
        timeout=20,
    )
    with aravis.open_camera(SETTINGS, Path()) as camera:
        with suppress(TimedOutError):
            camera.expose(EXPOSURE_S, DEADLINE_S)  # the fake camera may send its first one at once
        with pytest.raises(
            TimedOutError,
            match=r"no frame with an exposure of 0\.01 s came within 1\.01 s, although the camera answers",
        ):
            camera.expose(EXPOSURE_S, DEADLINE_S)


@pytest.mark.rigs
def test_numbers_wrap_and_memory_stays() -> None:
    """The fake camera counts from 65 401 or so: 65 535 is followed by 1, which is no lost frame."""
    require("arv-tool-0.8", "aravis-tools-cli")
    with fake_camera() as _, aravis.open_camera(SETTINGS, Path()) as camera:
        for _ in range(40):
            camera.expose(EXPOSURE_S, DEADLINE_S)
        before_kib = resident_kib()
        numbers = [camera.expose(EXPOSURE_S, DEADLINE_S).frame_id for _ in range(140)]
        grown_kib = resident_kib() - before_kib
    assert numbers[0] is not None
    assert numbers[0] > 65_000
    assert numbers[-1] is not None
    assert numbers[-1] < 1000
    assert len(set(numbers)) == len(numbers)
    # 140 frames are 36 MB
    assert grown_kib < 4096


def resident_kib() -> int:
    status = Path("/proc/self/status").read_text(encoding="ascii")
    return int(next(line for line in status.splitlines() if line.startswith("VmRSS")).split()[1])


def test_missing_library_names_the_package(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(aravis_library, "LIBRARY", "libaravis-not-here.so.0")
    aravis_library.load_aravis.cache_clear()
    with pytest.raises(MissingExtraError, match=r"apt-get install --no-install-recommends libaravis-0\.8-0"):
        aravis.found()
    aravis_library.load_aravis.cache_clear()
