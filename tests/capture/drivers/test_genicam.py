"""What every GenICam camera is told and asked, and calls with a deadline."""

import threading
import time
from dataclasses import dataclass, field

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from data_schemas import BadFrameError, CameraSettings, DeviceIdentity, LostError, RefusedError
from rigs import CallThread, NoAnswerError
from rigs.cameras import DeliveredFrame, GenicamCamera
from rigs.cameras._genicam import (
    ConnectionBrokenError,
    FeatureError,
    RawPixels,
    configure,
    image,
    raw_pixels,
    read_settings,
    require_new,
    right_aligned,
    set_exposure,
)

SETTINGS = CameraSettings(driver="gentl", address="here.cti", width_px=64, height_px=64, bit_depth=10, gain_db=3.0)


@dataclass
class Nodes:
    """Features of a camera that keeps some of its values whatever it is told."""

    values: dict[str, str | float | bool]
    kept: tuple[str, ...] = ()
    limits: dict[str, tuple[float, float]] = field(default_factory=dict)

    def has(self, name: str) -> bool:
        return name in self.values

    def entries(self, name: str) -> tuple[str, ...]:
        return {"PixelFormat": ("BayerRG8", "BayerRG16"), "BalanceRatioSelector": ("Red", "Blue")}[name]

    def text(self, name: str) -> str:
        return str(self.values[name])

    def number(self, name: str) -> float:
        return float(self.values[name])

    def is_on(self, name: str) -> bool:
        return bool(self.values[name])

    def bounds(self, name: str) -> tuple[float, float]:
        return self.limits.get(name, (0.0, 1e9))

    def set_text(self, name: str, value: str) -> None:
        self._set(name, value)

    def set_number(self, name: str, value: float) -> None:
        self._set(name, value)

    def switch(self, name: str, on: bool) -> None:
        self._set(name, on)

    def _set(self, name: str, value: str | float | bool) -> None:
        if name not in self.kept:
            self.values[name] = value


def nodes(*kept: str) -> Nodes:
    return Nodes(
        {
            "PixelFormat": "BayerRG8",
            "ExposureAuto": "Continuous",
            "GammaEnable": True,
            "Gamma": 2.2,
            "Width": 32,
            "OffsetX": 8,
            "Height": 32,
            "Gain": 0.0,
            "ExposureTime": 5000.0,
        },
        kept,
    )


def test_everything_automatic_is_off_and_recorded() -> None:
    camera = nodes()
    pixels = configure(camera, SETTINGS, "camera")
    assert pixels == RawPixels("BayerRG16", 16)
    assert camera.values == {
        "PixelFormat": "BayerRG16",
        "ExposureAuto": "Off",
        "GammaEnable": False,
        "Gamma": 1.0,
        "Width": 64,
        "OffsetX": 0.0,
        "Height": 64,
        "Gain": 3.0,
        "ExposureTime": 5000.0,
    }
    assert read_settings(camera) == {"pixel_format": "BayerRG16", "ExposureAuto": "Off", "Gain": 3.0, "Gamma": 1.0}


@pytest.mark.parametrize(
    ("kept", "message"),
    [
        ("PixelFormat", "PixelFormat was set to BayerRG16, but reads back BayerRG8"),
        ("ExposureAuto", "ExposureAuto was set to Off, but reads back Continuous"),
        (
            "GammaEnable",
            "GammaEnable changes raw counts or limits the exposure, but finray cannot switch GammaEnable off",
        ),
        ("Gamma", r"Gamma was set to 1, but reads back 2\.2; gamma must be 1"),
        ("OffsetX", "OffsetX was set to 0, but reads back 8"),
        ("Width", "Width was set to 64, but reads back 32; correct width_px"),
        ("Gain", "Gain was set to 3, but reads back 0; correct gain_db"),
    ],
)
def test_setting_that_is_kept_silently_is_refused(kept: str, message: str) -> None:
    with pytest.raises(RefusedError, match=message):
        configure(nodes(kept), SETTINGS, "camera")


def test_mirroring_trigger_and_white_balance_are_undone() -> None:
    """White balance of a colour camera multiplies raw counts; a trigger would be waited for."""
    camera = nodes()
    camera.values |= {"ReverseX": True, "TriggerMode": "On", "BalanceRatioSelector": "Red", "BalanceRatio": 1.7}
    configure(camera, SETTINGS, "camera")
    assert camera.values | {"ReverseX": False, "TriggerMode": "Off", "BalanceRatio": 1.0} == camera.values
    assert camera.values["BalanceRatioSelector"] == "Blue"  # both were set
    camera = nodes("BalanceRatio")
    camera.values |= {"BalanceRatioSelector": "Red", "BalanceRatio": 1.7}
    with pytest.raises(
        RefusedError, match=r"BalanceRatio was set to 1, but reads back 1\.7; white balance .Red. must be off"
    ):
        configure(camera, SETTINGS, "camera")


def test_pixels_are_neither_joined_nor_left_out() -> None:
    """A frame of half the sensor fits a camera that still joins 2 x 2 pixels, as another program has left it."""
    camera = nodes()
    camera.values |= {"BinningHorizontal": 2.0, "BinningVertical": 2.0, "DecimationVertical": 4.0}
    configure(camera, SETTINGS, "camera")
    joined = ("BinningHorizontal", "BinningVertical", "DecimationVertical")
    assert [camera.values[name] for name in joined] == [1.0, 1.0, 1.0]
    camera = nodes("BinningVertical")
    camera.values["BinningVertical"] = 2.0
    with pytest.raises(RefusedError, match="BinningVertical was set to 1, but reads back 2; every pixel is needed"):
        configure(camera, SETTINGS, "camera")


def test_setting_that_is_fixed_at_the_right_value_is_fine() -> None:
    camera = nodes("Gamma", "Gain")
    camera.values |= {"Gamma": 1.0, "Gain": 3.0}
    assert configure(camera, SETTINGS, "camera").bits == 16


def test_the_ends_of_the_range_are_allowed() -> None:
    """In floating-point numbers 1e6 * 0.000249 is below 249, and 1e6 * 0.001007 above 1007."""
    camera = nodes()
    camera.limits["ExposureTime"] = (249.0, 1007.0)
    for exposure_s, exposure_us in ((0.000249, 249.0), (0.001007, 1007.0)):
        assert set_exposure(camera, exposure_s, "camera") == pytest.approx(exposure_s, rel=1e-12)
        assert camera.values["ExposureTime"] == exposure_us
    for outside_s in (0.0002489, 0.0010071):
        with pytest.raises(RefusedError, match=r"only for 0\.000249 to 0\.001007 s"):
            set_exposure(camera, outside_s, "camera")


def test_exposure_that_is_kept_silently_is_refused() -> None:
    assert set_exposure(nodes(), 0.02, "camera") == pytest.approx(0.02)
    with pytest.raises(RefusedError, match=r"an exposure of 0\.02 s was requested, but the camera uses 0\.005 s"):
        set_exposure(nodes("ExposureTime"), 0.02, "camera")


@pytest.mark.parametrize(
    ("offered", "bits", "name"),
    [
        (("BayerRG8", "BayerRG10", "BayerRG16", "Mono8"), 10, "BayerRG10"),
        (("BayerRG8", "BayerRG16", "Mono8"), 10, "BayerRG16"),
        (("BayerRG8", "BayerRG16"), 8, "BayerRG8"),
        # In the order of the standard's names: packed formats are never chosen.
        (("BayerRG12Packed", "BayerRG12p", "BayerRG10p", "BayerRG16", "BayerRG8"), 10, "BayerRG16"),
        (("BayerRG12Packed", "BayerRG12p", "BayerRG16", "BayerRG8"), 12, "BayerRG16"),
        (("Mono8", "Mono16"), 12, "Mono16"),
    ],
)
def test_pixel_format_follows_the_bits(offered: tuple[str, ...], bits: int, name: str) -> None:
    assert raw_pixels(offered, bits, "camera").name == name


@pytest.mark.parametrize("offered", [("BayerGB8", "Mono8"), ("RGB8",), ()])
def test_other_patterns_and_colour_pictures_are_refused(offered: tuple[str, ...]) -> None:
    with pytest.raises(RefusedError, match="no raw pixel format with 8 bits and Bayer pattern RGGB"):
        raw_pixels(offered, 8, "camera")


@given(st.integers(1, 1023), st.sampled_from([10, 12, 14, 16]))
def test_counts_come_down_to_their_bits(count: int, bit_depth: int) -> None:
    stored = np.full((2, 2), count << (16 - bit_depth), dtype=np.uint16)
    found = right_aligned(stored, RawPixels("BayerRG16", 16), bit_depth, "camera")
    np.testing.assert_array_equal(found, np.full((2, 2), count))
    unpacked = np.full((2, 2), count, dtype=np.uint16)
    np.testing.assert_array_equal(right_aligned(unpacked, RawPixels("BayerRG10", 10), 10, "camera"), unpacked)


def test_counts_with_too_many_bits_are_refused() -> None:
    counts = np.full((2, 2), 64 + 16, dtype=np.uint16)
    with pytest.raises(RefusedError, match="carries more than the 10 bits of the rig file"):
        right_aligned(counts, RawPixels("BayerRG16", 16), 10, "camera")
    with pytest.raises(BadFrameError, match="contains a count of 1024 DN, but 10 bits"):
        right_aligned(np.array([[1024]], dtype=np.uint16), RawPixels("BayerRG10", 10), 10, "camera")


def test_frame_that_was_delivered_before_is_refused() -> None:
    require_new((7, 1.5), None, "camera")
    require_new((7, 1.6), (7, 1.5), "camera")  # numbers begin again in each acquisition
    require_new((7, 0.0), (7, 0.0), "camera")  # without a time the number tells nothing
    with pytest.raises(BadFrameError, match="delivered frame 7 twice"):
        require_new((7, 1.5), (7, 1.5), "camera")


def test_bytes_become_counts_of_the_container() -> None:
    content = np.arange(13, dtype=np.uint8)  # a transport may pad
    found = image(DeliveredFrame("", 1, 0.0, 3, 2, content), RawPixels("Mono16", 16), "camera")
    np.testing.assert_array_equal(found, [[0x0100, 0x0302, 0x0504], [0x0706, 0x0908, 0x0B0A]])
    with pytest.raises(BadFrameError, match="frame 1 has only 5 bytes, but 2 x 3 px of Mono8 need 6"):
        image(DeliveredFrame("", 1, 0.0, 3, 2, content[:5]), RawPixels("Mono8", 8), "camera")


class Unreachable(Nodes):
    """A camera whose serial number changes each time it is opened, and that breaks when it is used."""

    opened = 0

    def identity(self) -> DeviceIdentity:
        return DeviceIdentity(role="camera", driver="gentl", model="M", serial=str(self.opened))

    def prepare(self) -> None:
        """Nothing to do."""

    def acquire(self, limit_s: float) -> DeliveredFrame | None:
        raise ConnectionBrokenError("unplugged")

    def close(self) -> None:
        """Nothing to do."""


def test_broken_connection_is_lost_and_another_camera_is_not_taken() -> None:
    def connect() -> Unreachable:
        Unreachable.opened += 1
        return Unreachable(nodes().values)

    camera = GenicamCamera(SETTINGS, connect)
    camera.open()
    with pytest.raises(LostError, match=r"the connection broke \(unplugged\)"):
        camera.expose(0.01, 5.0)
    for ask in (camera.identity, lambda: camera.expose(0.01, 5.0)):
        with pytest.raises(
            RefusedError, match=r"a different camera answers now .M, serial \d.; .*give its serial number"
        ):
            ask()
    camera.close()


@pytest.mark.parametrize(("name", "reset"), [("PixelFormat", "Mono8"), ("Gain", 0.0), ("ExposureTime", 20000.0)])
def test_camera_that_lost_its_settings_in_a_frame_is_set_anew(name: str, reset: str | float) -> None:
    """A camera without a session of its own is restarted, answers as before, and sends what it likes."""

    restarts = [False, True]  # in the frame after the one that is thrown away

    class Restarted(Unreachable):
        def identity(self) -> DeviceIdentity:
            return DeviceIdentity(role="camera", driver="gentl", model="M")

        def acquire(self, limit_s: float) -> DeliveredFrame | None:
            if restarts and restarts.pop(0):
                self.values[name] = reset
            return DeliveredFrame("", 1, time.monotonic(), 64, 64, np.zeros(2 * 64 * 64, dtype=np.uint8))

    camera = GenicamCamera(SETTINGS, lambda: Restarted(nodes().values))
    camera.open()
    with pytest.raises(LostError, match=r"has lost its settings \(\w+\), as after a restart; check its power"):
        camera.expose(0.01, 5.0)
    assert camera.expose(0.01, 5.0).settings["pixel_format"] == "BayerRG16"
    camera.close()


def test_camera_that_comes_back_with_fewer_formats_is_not_believed() -> None:
    """While a camera starts, formats that cannot be asked in time count as not offered."""
    offers = [("BayerRG8", "BayerRG16"), ("Mono8", "Mono16"), ("BayerRG8", "BayerRG16")]

    class Starting(Unreachable):
        def identity(self) -> DeviceIdentity:
            return DeviceIdentity(role="camera", driver="gentl", model="M")

        def entries(self, name: str) -> tuple[str, ...]:
            return offers.pop(0) if name == "PixelFormat" else super().entries(name)

    camera = GenicamCamera(SETTINGS, lambda: Starting(nodes().values))
    camera.open()
    with pytest.raises(LostError, match="the connection broke"):
        camera.expose(0.01, 5.0)
    assert camera.identity().model == "M"  # opened twice: the first offered Mono16
    assert not offers
    camera.close()


@pytest.mark.parametrize(
    ("error", "raised", "message"),
    [
        (ConnectionBrokenError("gone"), LostError, "cannot be opened .gone."),
        (FeatureError("locked"), RefusedError, "cannot be opened or configured .locked."),
    ],
)
def test_camera_that_cannot_be_opened_says_why(error: FeatureError, raised: type[Exception], message: str) -> None:
    def connect() -> Unreachable:
        raise error

    camera = GenicamCamera(SETTINGS, connect)
    with pytest.raises(raised, match=message):
        camera.open()
    camera.close()


def test_refusal_of_a_feature_names_it() -> None:
    class Locked(Unreachable):
        def set_number(self, name: str, value: float) -> None:
            if name == "ExposureTime":
                raise FeatureError("ExposureTime is locked")
            super().set_number(name, value)

    camera = GenicamCamera(SETTINGS, lambda: Locked(nodes().values))
    camera.open()
    with pytest.raises(RefusedError, match=r"refuses the request .ExposureTime is locked."):
        camera.expose(0.01, 5.0)
    camera.close()


def test_call_that_hangs_is_left_alone() -> None:
    calls, hold, ran = CallThread("test"), threading.Event(), threading.Event()
    assert calls.call(lambda: 3, 5.0) == 3
    with pytest.raises(ZeroDivisionError):
        calls.call(lambda: 1 // 0, 5.0)
    started_s = time.monotonic()
    with pytest.raises(NoAnswerError):
        calls.call(hold.wait, 0.05)
    with pytest.raises(NoAnswerError):  # it waits behind the one that hangs, and is never made
        calls.call(ran.set, 0.05)
    assert time.monotonic() - started_s < 2.0
    calls.close(lambda: None, 0.05)  # does not wait longer either
    hold.set()
    last = CallThread("test")
    closed: list[int] = []
    last.post(lambda: closed.append(1))
    last.close(lambda: closed.append(2), 5.0)
    assert closed == [1, 2]
    assert not ran.is_set()
