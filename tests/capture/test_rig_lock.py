"""One capture per device, whatever its address is called; one device per light."""

import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from pydantic import ValidationError

from data_schemas import CameraSettings, CaptureError, FilterWheelSettings, LampSettings, LaserSettings, RigFile
from rigs import device_locked, rig_locked, simulated_rig

CHILD = """
import sys
from rigs._open_rig import device_locked
with device_locked("filter wheel", "thorlabs", sys.argv[1]):
    print("held", flush=True)
    sys.stdin.read()
"""
LASER = {"wavelength_nm": 450.0, "power_mw": 4.5, "laser_class": "3R"}


def real_rig(wheel: str, lamp: LampSettings) -> RigFile:
    return RigFile(
        name="lab",
        camera=CameraSettings(driver="mjpeg", address=f"http://{wheel}"),
        filter_wheel=FilterWheelSettings(
            driver="thorlabs", address=wheel, filters=simulated_rig("red").filter_wheel.filters
        ),
        laser=LaserSettings(driver="arduino", address="socket://board:1", **LASER),
        lamp=lamp,
    )


@contextmanager
def held_elsewhere(address: str) -> Iterator[subprocess.Popen[str]]:
    """Another process that holds the lock of a wheel."""
    child = subprocess.Popen(
        [sys.executable, "-c", CHILD, address], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    with child:
        try:
            assert child.stdout is not None
            assert child.stdout.readline() == "held\n"
            yield child
        finally:
            child.kill()


def test_second_capture_on_the_rig_is_refused_until_the_first_is_gone(tmp_path: Path) -> None:
    port, other_name = tmp_path / "ttyUSB0", tmp_path / "by-id"
    port.touch()
    other_name.symlink_to(port)
    rig = real_rig(str(other_name), LampSettings(driver="manual"))
    with (
        held_elsewhere(str(port)) as holder,
        pytest.raises(CaptureError, match=rf"filter wheel: thorlabs at .*by-id is in use .*process {holder.pid}\)"),
        rig_locked(rig),
    ):
        pass
    with rig_locked(rig):  # the lock went with its process, killed as it was
        pass


def test_what_is_no_device_is_not_locked() -> None:
    rig = simulated_rig("red")
    folder = ("camera", "folder", "a")
    with rig_locked(rig), rig_locked(rig), device_locked(*folder), device_locked(*folder):
        pass


def test_laser_and_lamp_are_two_switches() -> None:
    with pytest.raises(ValidationError, match=r"laser and lamp are both driver 'arduino' at socket://board:1"):
        real_rig("socket://wheel:1", LampSettings(driver="arduino", address="socket://board:1"))


def test_wheel_and_laser_are_at_two_ports() -> None:
    with pytest.raises(ValidationError, match=r"filter_wheel and laser are both at socket://board:1"):
        real_rig("socket://board:1", LampSettings(driver="manual"))
