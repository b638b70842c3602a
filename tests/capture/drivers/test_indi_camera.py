"""The INDI camera against INDI's simulator: recorded, with altered frames, and the program itself with its faults."""

import math
import time
from collections.abc import Iterator, Mapping
from contextlib import AbstractContextManager
from pathlib import Path

import numpy as np
import pytest

from data_schemas import BadFrameError, RefusedError, TimedOutError
from rigs import Camera, RawFrame, TerminalOperator
from rigs.cameras import indi
from rigs.cameras.indi import CardValue, FitsImage, IndiFrames, open_camera
from rigs.filter_wheels.indi import open_wheel
from rigs.lights.indi import open_switch
from rigs.transports import Fault, IndiClient, fault_listener
from tests.capture.drivers.indi_server import CCD, PANEL, SIMULATORS, WHEEL, IndiServer
from tests.capture.drivers.rig_excerpts import camera_settings, wheel_settings
from tests.capture.drivers.serial_replay import TRANSCRIPTS, read_transcript, replayed

RECORDED = read_transcript(TRANSCRIPTS / "indi_ccd.txt")
SIZE_PX = 64
FRAME_S = 10.0


def replayed_camera(address: str, **others: object) -> AbstractContextManager[Camera]:
    asked = {"width_px": SIZE_PX, "height_px": SIZE_PX, "gain_db": 20.0, **others}
    return open_camera(camera_settings(f"{address.removeprefix('socket://')}/{CCD}", **asked), Path())


def altered(old: bytes, new: bytes) -> list[tuple[str, bytes]]:
    """The recorded exchange with something else said after the exposure began."""
    at = next(i for i, (who, said) in enumerate(RECORDED) if b'name="CCD_EXPOSURE"><oneNumber' in said) + 1
    assert old in RECORDED[at][1]
    return [*RECORDED[:at], ("device", RECORDED[at][1].replace(old, new))]


def exposed(spoken: list[tuple[str, bytes]]) -> RawFrame:
    with replayed(spoken) as address, replayed_camera(address) as camera:
        return camera.expose(0.02, 5.0)


def test_the_recorded_camera_gives_its_frame_and_settings() -> None:
    frame = exposed(RECORDED)
    assert frame.counts.shape == (SIZE_PX, SIZE_PX)
    assert frame.counts.dtype == np.uint16
    # Read noise of the simulator, as the reference measured it.
    assert 4.0 < frame.counts.mean() < 5.0
    assert frame.counts.max() == 9
    assert (frame.exposure_requested_s, frame.exposure_s, frame.frame_id) == (0.02, 0.02, None)
    assert frame.settings == {
        "gain": 20.0,
        "black_level": 0.0,
        "sensor_temperature_c": 0.0,
        "pixel_format": "BayerRG16",
        "filter_header": "Red",
        "active_filter": CCD,
    }


@pytest.mark.parametrize(
    ("old", "new", "error", "why"),
    [
        (b'format=".fits"', b'format=".fits.fz"', RefusedError, r"sends frames as '\.fits\.fz', but \.fits"),
        (b'size="', b'size="9', BadFrameError, "bytes, but states a size of 9"),
        (b'state="Ok"', b'state="Alert" message="no cable"', RefusedError, "refuses to expose for 0.02 s .*no cable"),
        (b"U0lNUExF", b"AAAAAAAA", BadFrameError, "is not a FITS file with a complete header"),
    ],
)
def test_frames_that_are_not_as_asked_for(old: bytes, new: bytes, error: type[Exception], why: str) -> None:
    with pytest.raises(error, match=why):
        exposed(altered(old, new))


class Delivered(IndiFrames):
    """The check of a camera's frames, of counts and cards."""

    def check(self, counts: np.ndarray, exposure_s: float = 0.1, **cards: CardValue) -> RawFrame:
        header: Mapping[str, CardValue] = {"EXPTIME": 0.1, "DATE-OBS": "2026-01-01T00:00:00.100", **cards}
        return self.checked(FitsImage(counts.astype(np.uint16), header), exposure_s, "2026-01-01T00:00:00.000+00:00")


def delivered(bit_depth: int = 10) -> Delivered:
    settings = camera_settings(f"h/{CCD}", width_px=SIZE_PX, height_px=SIZE_PX, gain_db=3.0, bit_depth=bit_depth)
    return Delivered(IndiClient(settings.address, "camera", "CCD_EXPOSURE"), settings)


COUNTS = np.arange(SIZE_PX**2).reshape(SIZE_PX, SIZE_PX) % 1000


def test_headers_that_contradict_what_was_asked_are_refused() -> None:
    with pytest.raises(RefusedError, match=r"sent 32 x 64 px, but 64 x 64 px were requested"):
        delivered().check(COUNTS[:, :32])
    with pytest.raises(
        RefusedError, match=r"an exposure of 0\.2 s was requested, but the frame's header states 0\.1 s"
    ):
        delivered().check(COUNTS, exposure_s=0.2)
    with pytest.raises(RefusedError, match=r"gain 3 was requested, but the frame's header states 4\.0"):
        delivered().check(COUNTS, GAIN=4.0)
    with pytest.raises(RefusedError, match="EXPTIME is missing from the frame's header"):
        delivered().check(COUNTS, EXPTIME="")
    # a comparison with NaN is never true, so it would pass for the exposure and the gain that were asked for
    for card in ("EXPTIME", "GAIN"):
        with pytest.raises(RefusedError, match=f"{card} is missing from the frame's header, or is not a number"):
            delivered().check(COUNTS, **{card: math.nan})
    other: list[dict[str, CardValue]] = [{"BAYERPAT": "GRBG"}, {"XBAYROFF": 1.0}, {"ROWORDER": "BOTTOM-UP"}]
    for cards in other:
        with pytest.raises(RefusedError, match="RGGB from the top left is needed"):
            delivered().check(COUNTS, **cards)
    assert delivered().check(COUNTS, GAIN=3.0).settings["pixel_format"] == "Mono16"


def test_a_frame_that_comes_twice_is_bad() -> None:
    frames = delivered()
    first = frames.check(COUNTS)
    with pytest.raises(BadFrameError, match=r"sent the frame of 2026-01-01T00:00:00\.100 twice"):
        frames.check(COUNTS)
    later = frames.check(COUNTS, **{"DATE-OBS": "2026-01-01T00:00:00.350"})
    assert first.device_time_s is not None
    assert later.device_time_s == pytest.approx(first.device_time_s + 0.25, abs=1e-6)
    assert frames.check(COUNTS, **{"DATE-OBS": "unknown"}).device_time_s is None


def test_left_aligned_counts_are_shifted_and_too_many_refused() -> None:
    frames = delivered()
    np.testing.assert_array_equal(frames.check(COUNTS << 6).counts, COUNTS)
    with pytest.raises(BadFrameError, match="sent counts up to 1024 DN, but 10 bits hold at most 1023 DN"):
        frames.check(COUNTS + 25, **{"DATE-OBS": "2"})
    # Seen with its lowest bits in use once, it is never shifted again.
    flat = np.full_like(COUNTS, 64)
    np.testing.assert_array_equal(frames.check(flat, **{"DATE-OBS": "3"}).counts, flat)
    np.testing.assert_array_equal(delivered(16).check(flat).counts, flat)


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[IndiServer]:
    with IndiServer(tmp_path_factory.mktemp("indi"), SIMULATORS) as running:
        yield running


@pytest.fixture
def camera(server: IndiServer) -> Iterator[Camera]:
    with open_camera(camera_settings(server.address(CCD)), Path()) as opened:
        yield opened


@pytest.mark.rigs
def test_eight_filters_under_the_light_panel(server: IndiServer, camera: Camera) -> None:
    wheel_at = wheel_settings(server.address(WHEEL), count=8)
    times_s = set()
    with (
        open_wheel(wheel_at, TerminalOperator()) as wheel,
        open_switch(server.address(PANEL), "laser", None) as light,
    ):
        light.switch(True, 5.0)
        for slot in wheel.slots:
            wheel.go_to(slot, 10.0)
            frame = camera.expose(0.1, FRAME_S)
            assert wheel.position() == slot
            assert light.state(5.0)
            assert frame.counts.shape == (1024, 1280)
            assert frame.exposure_s == 0.1
            times_s.add(frame.device_time_s)
        light.switch(False, 5.0)
    assert len(times_s) == 8


@pytest.mark.rigs
def test_size_and_gain_are_set_and_the_middle_is_read(server: IndiServer) -> None:
    smaller = camera_settings(server.address(CCD), width_px=640, height_px=480, gain_db=10.0)
    with open_camera(smaller, Path()) as camera:
        frame = camera.expose(0.05, FRAME_S)
    assert frame.counts.shape == (480, 640)
    assert frame.settings["gain"] == 10.0
    with IndiClient(server.address(CCD), "camera", "CCD_EXPOSURE") as client:
        client.ready(time.monotonic() + 5.0)
        assert (client.number("CCD_FRAME", "X"), client.number("CCD_FRAME", "Y")) == (320.0, 272.0)


@pytest.mark.rigs
def test_what_the_camera_cannot_do_is_refused(server: IndiServer, camera: Camera) -> None:
    for exposure_s in (-1.0, 0.0, 4000.0, float("nan")):
        with pytest.raises(RefusedError, match=r"cannot expose for .* s, only for 0\.01 to 3600 s"):
            camera.expose(exposure_s, FRAME_S)
    too_large = camera_settings(server.address(CCD), width_px=2000)
    with pytest.raises(RefusedError, match="its sensor has 1280 x 1024 px"), open_camera(too_large, Path()):
        pass
    # What the driver itself says to it.
    with IndiClient(server.address(CCD), "camera", "CCD_EXPOSURE") as client:
        end_s = time.monotonic() + 5.0
        client.ready(end_s)
        with pytest.raises(RefusedError, match=r"refuses to set CCD_EXPOSURE to -1 .*-1"):
            client.change("Number", "CCD_EXPOSURE", {"CCD_EXPOSURE_VALUE": "-1"}, end_s)


@pytest.mark.rigs
def test_a_frame_that_is_late_is_aborted_and_does_not_pass_for_the_next(camera: Camera) -> None:
    began_s = time.monotonic()
    with pytest.raises(TimedOutError, match="did not expose for 3 s within"):
        camera.expose(3.0, 0.5)
    assert time.monotonic() - began_s < 2.0
    frame = camera.expose(0.05, FRAME_S)
    assert frame.exposure_s == 0.05


@pytest.mark.rigs
def test_an_exposure_of_somebody_else_is_ended_first(server: IndiServer, camera: Camera) -> None:
    with IndiClient(server.address(CCD), "other", "CCD_EXPOSURE") as other:
        end_s = time.monotonic() + 5.0
        other.ready(end_s)
        other.request("Number", "CCD_EXPOSURE", {"CCD_EXPOSURE_VALUE": "30"}, end_s)
        other.wait(lambda: other.property("CCD_EXPOSURE").state == "Busy", end_s, "begin")
        began_s = time.monotonic()
        assert camera.expose(0.05, FRAME_S).exposure_s == 0.05
        assert time.monotonic() - began_s < 5.0


@pytest.mark.rigs
def test_a_driver_that_crashes_is_connected_again_with_its_settings(server: IndiServer) -> None:
    faults: list[Fault] = []
    with open_camera(camera_settings(server.address(CCD), gain_db=7.0), Path()) as camera:
        assert camera.expose(0.05, FRAME_S).settings["gain"] == 7.0
        server.crash_camera()
        with fault_listener(faults.append):
            assert camera.expose(0.05, FRAME_S).settings["gain"] == 7.0
    assert "the driver withdrew the device, so it crashed" in faults[0].what


@pytest.mark.rigs
def test_a_setting_changed_by_another_program_is_found_in_the_header(server: IndiServer, camera: Camera) -> None:
    server.put(CCD, "CCD_GAIN.GAIN=55")
    with pytest.raises(RefusedError, match=r"gain 0 was requested, but the frame's header states 55"):
        camera.expose(0.05, FRAME_S)


@pytest.mark.rigs
def test_the_filter_header_follows_the_wheel_that_the_camera_listens_to(server: IndiServer, camera: Camera) -> None:
    """Until it is told, INDI's camera listens to its own wheel and calls every filter Red."""
    with open_wheel(wheel_settings(server.address(WHEEL), count=8), TerminalOperator()) as wheel:
        wheel.go_to(4, 10.0)
        default = camera.expose(0.05, FRAME_S).settings
        assert (default["active_filter"], default["filter_header"]) == (CCD, "Red")
        server.put(CCD, f"ACTIVE_DEVICES.ACTIVE_FILTER={WHEEL}")
        wheel.go_to(4, 10.0)
        told = camera.expose(0.05, FRAME_S).settings
    assert (told["active_filter"], told["filter_header"]) == (WHEEL, "H_Alpha")


@pytest.mark.rigs
def test_detection_lists_each_kind_of_device(server: IndiServer, monkeypatch: pytest.MonkeyPatch) -> None:
    from rigs.filter_wheels import indi as wheels
    from rigs.lights import indi as lights
    from rigs.transports import _indi_client as indi_server

    monkeypatch.setattr(indi_server, "DEFAULT_PORT", server.port)
    place = f"localhost:{server.port}"
    assert indi.found()[0] == (f"{place}/{CCD}", f"INDI device {CCD}")
    assert (f"{place}/{WHEEL}", f"INDI device {WHEEL}") in wheels.found()
    assert lights.found() == [(f"{place}/{PANEL}", f"INDI device {PANEL}")]
