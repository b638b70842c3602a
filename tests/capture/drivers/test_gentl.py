"""The GenTL driver against Viky, the virtual producer in the genicam package of EMVA."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from data_schemas import CameraSettings, LostError, MissingExtraError, RefusedError
from rigs.cameras import gentl
from rigs.cameras._genicam import FeatureError, RawPixels, configure, image, set_exposure
from tests.capture.drivers.programs import require_module

SIDE_PX = 400
DEADLINE_S = 5.0


@pytest.fixture(scope="module")
def producer() -> Path:
    require_module("harvesters", "harvesters")
    import genicam

    return Path(genicam.__file__).parent / "viky.cti"


def settings(address: str) -> CameraSettings:
    return CameraSettings(driver="gentl", address=address, width_px=SIDE_PX, height_px=SIDE_PX, bit_depth=8)


@pytest.fixture
def viky(producer: Path) -> Iterator[gentl.GentlCamera]:
    camera = gentl.GentlCamera(producer, "1", f"{producer}#1", "camera (gentl)")
    yield camera
    camera.close()


def test_frames_are_whole_and_of_their_own_acquisition(viky: gentl.GentlCamera) -> None:
    pixels = configure(viky, settings("viky.cti#1"), "camera")
    viky.prepare()
    assert pixels == RawPixels("Mono8", 8)
    for _ in range(3):
        delivered = viky.acquire(DEADLINE_S)
        assert delivered is not None
        assert not delivered.fault
        assert delivered.frame_id == 1  # counted from the start of the acquisition
        counts = image(delivered, pixels, "camera")
        assert counts.shape == (SIDE_PX, SIDE_PX)
        assert 0 <= counts.min() < counts.max() <= 255
    identity = viky.identity()
    assert (identity.model, identity.serial, identity.role) == ("Viky", "1", "camera")


def test_no_frame_in_time_is_none(viky: gentl.GentlCamera) -> None:
    configure(viky, settings("viky.cti#1"), "camera")
    viky.prepare()
    assert viky.acquire(1e-4) is None  # 20 frames a second: none comes so soon
    assert viky.acquire(DEADLINE_S) is not None


def test_features_that_are_not_there_or_out_of_range_say_so(viky: gentl.GentlCamera) -> None:
    assert not viky.has("ExposureTime")
    assert viky.bounds("Width") == (100.0, 800.0)
    with pytest.raises(RefusedError, match="has no feature ExposureTime or ExposureTimeAbs"):
        set_exposure(viky, 0.01, "camera")
    with pytest.raises(FeatureError, match="must be equal or smaller than Max = 800"):
        viky.set_number("Width", 1e6)
    with pytest.raises(FeatureError):
        viky.number("ExposureTime")
    with pytest.raises(RefusedError, match="cannot read out Width = 1280 px, only up to 800 px"):
        configure(viky, settings("viky.cti").model_copy(update={"width_px": 1280}), "camera")
    with pytest.raises(RefusedError, match=r"no raw pixel format with 10 bits .*only RGBa8, Mono8"):
        configure(viky, settings("viky.cti").model_copy(update={"bit_depth": 10}), "camera")


def test_camera_without_an_exposure_time_is_not_opened(producer: Path) -> None:
    with (
        pytest.raises(RefusedError, match=r"has no feature ExposureTime .*settable exposure time"),
        gentl.open_camera(settings(f"{producer}#1"), Path()),
    ):
        pass


@pytest.mark.parametrize(
    ("serial", "raised", "message"),
    [
        ("", RefusedError, "lists several cameras .*add '#' and the serial number"),
        ("#77", LostError, "was not found .the producer lists .*Viky serial '0'"),
    ],
)
def test_camera_is_named_by_its_serial_number(
    producer: Path, serial: str, raised: type[Exception], message: str
) -> None:
    with pytest.raises(raised, match=message), gentl.open_camera(settings(f"{producer}{serial}"), Path()):
        pass


def test_producer_that_is_missing_or_none(producer: Path, tmp_path: Path) -> None:
    with (
        pytest.raises(RefusedError, match=r"the producer .*nowhere\.cti does not exist; give the \.cti file"),
        gentl.open_camera(settings("nowhere.cti"), tmp_path),
    ):
        pass
    (tmp_path / "text.cti").write_text("no library")
    with (
        pytest.raises(RefusedError, match=r"cannot be loaded .*install the camera's software"),
        gentl.open_camera(settings("text.cti"), tmp_path),
    ):
        pass


def test_missing_package_names_the_extra(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setitem(__import__("sys").modules, "harvesters.core", None)
    with (
        pytest.raises(MissingExtraError, match=r"pip install 'finray-calib\[gentl\]'"),
        gentl.open_camera(settings("any.cti"), tmp_path),
    ):
        pass


def test_cameras_of_installed_producers_are_found(
    producer: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    (tmp_path / "broken.cti").write_bytes(b"no library")
    monkeypatch.setenv(gentl.PRODUCERS_VARIABLE, f"{tmp_path}:{producer.parent}:")
    listed = dict(gentl.found())
    assert f"{producer}#1" in listed
    assert "Viky, serial 1" in listed[f"{producer}#1"]
    monkeypatch.delenv(gentl.PRODUCERS_VARIABLE)
    assert gentl.found() == []
