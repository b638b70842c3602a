"""What the table of drivers adds to them."""

from contextlib import nullcontext
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from data_schemas import CameraSettings, LampSettings, LaserSettings, RefusedError, RigFile
from rigs import TerminalOperator, open_camera, open_lamp, open_rig
from rigs.light_guard import GuardedLight
from tests.capture.drivers import file_switch
from tests.capture.drivers.rig_excerpts import wheel_settings


@pytest.mark.parametrize(
    ("camera_at", "wheel_at", "wheel_driver", "told"),
    [
        ("pi:7624/CCD", "pi/EFW", "indi", {"wheel_device": "EFW"}),
        ("pi/CCD", "pi:7624/EFW", "indi", {"wheel_device": "EFW"}),
        ("pi/CCD", "pi:7625/EFW", "indi", {}),
        ("pi/CCD", "po/EFW", "indi", {}),
        ("pi/CCD", "http://pi:1/0", "alpaca", {}),
    ],
)
def test_an_indi_camera_is_told_the_wheel_of_its_own_server(
    camera_at: str, wheel_at: str, wheel_driver: str, told: dict[str, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    heard: list[dict[str, Any]] = []

    def record(settings: CameraSettings, folder: Path, **extra: Any) -> nullcontext[SimpleNamespace]:
        heard.append(extra)
        return nullcontext(SimpleNamespace(identity=None, expose=None))

    monkeypatch.setattr("rigs.cameras.indi.open_camera", record)
    camera = CameraSettings.model_construct(driver="indi", address=camera_at)
    with open_camera(camera, Path(), wheel_settings(wheel_at, driver=wheel_driver)):
        assert heard == [told]


def test_a_lamp_with_a_controller_has_a_guard(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file_switch.install(monkeypatch)
    with open_lamp(LampSettings.model_construct(driver="indi", address=str(tmp_path)), TerminalOperator()) as lamp:
        assert isinstance(lamp, GuardedLight)
        with lamp.lit():
            assert (tmp_path / "on").exists()
        assert not (tmp_path / "on").exists()


def test_a_laser_waits_for_a_capture_that_hangs_only_so_long(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Longer than two of the longest exposures, which a camera may need for one frame, and no more than minutes."""
    file_switch.install(monkeypatch)
    patience_s: list[float] = []

    def record(settings: LaserSettings, given_s: float) -> nullcontext[None]:
        patience_s.append(given_s)
        raise RefusedError("seen")

    monkeypatch.setattr("rigs._open_rig.open_laser", record)
    laser = {"wavelength_nm": 450.0, "power_mw": 4.5, "laser_class": "3R"}
    rig = RigFile(
        name="rig",
        camera=CameraSettings(driver="folder", address="images", longest_exposure_s=30.0),
        filter_wheel=wheel_settings("", driver="manual"),
        laser=LaserSettings(driver="indi", address=str(tmp_path), **laser),
        lamp=LampSettings(driver="manual"),
    )
    with pytest.raises(RefusedError, match="seen"), open_rig(rig, tmp_path):
        pytest.fail("opened")
    assert 2 * 30.0 + 60.0 < patience_s[0] < 10 * 60.0
