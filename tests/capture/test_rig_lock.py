"""One capture per device, whatever its address is called; one device per light."""

import os
import pty
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from data_schemas import (
    CameraSettings,
    CaptureError,
    FieldError,
    FilterWheelSettings,
    LampSettings,
    LaserSettings,
    RefusedError,
    RigFile,
)
from rigs import device_locked, rig_locked, simulated_rig
from rigs._open_rig import device_keys

CHILD = """
import sys
from rigs import device_locked
with device_locked("filter wheel", *sys.argv[1:]):
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
def held_elsewhere(
    address: str, driver: str = "thorlabs", folder: Path | None = None
) -> Iterator[subprocess.Popen[str]]:
    """Another process that holds the lock of a device, with a folder of its own for temporary files."""
    child = subprocess.Popen(
        [sys.executable, "-c", CHILD, driver, address],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        env=None if folder is None else os.environ | {"TMPDIR": str(folder)},
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


def own_network_addresses() -> list[str]:
    """The addresses of this computer's host name; without one, loopback alone."""
    try:
        found = socket.getaddrinfo(socket.gethostname(), None, socket.AF_INET, socket.SOCK_STREAM)
    except OSError:
        return []
    return [socket.gethostname(), *(str(entry[4][0]) for entry in found)]


@pytest.mark.parametrize(
    ("driver", "form"),
    [
        ("indi", "{}:7624/Light Panel Simulator"),
        ("alpaca", "http://{}:32323/switch/0/2"),
        ("mjpeg", "http://{}:8080/stream"),
        ("arduino", "socket://{}:5000"),
        ("thorlabs", "rfc2217://{}:5000"),
    ],
)
def test_every_name_of_this_computer_leads_to_one_device(driver: str, form: str) -> None:
    names = ["localhost", "LOCALHOST", "127.0.0.1", "127.0.0.2", "0.0.0.0", *own_network_addresses()]
    names += [] if driver == "indi" else ["[::1]", "[::ffff:127.0.0.1]"]
    keys = {name: device_keys(driver, form.format(name)) for name in names}
    for name, found in keys.items():
        assert found & keys["127.0.0.1"], f"{name}: {found}"


@pytest.mark.parametrize(
    ("driver", "one", "other"),
    [
        ("indi", "localhost/Panel", "127.0.0.1:7624/Panel"),
        ("indi", "::1:7624/Panel", "localhost:7624/Panel"),
        ("alpaca", "http://localhost:80/switch/0/2", "http://localhost/switch/00/02/"),
        ("alpaca", "http://192.0.2.7:80/switch/0/2", "HTTP://192.0.2.7/switch/0/2"),
        ("mjpeg", "http://rig.invalid:80/stream", "http://RIG.invalid./stream"),
        # options of pyserial
        ("arduino", "socket://localhost:5000", "socket://127.0.0.1:5000?logging=debug"),
        ("thorlabs", "rfc2217://192.0.2.7:5000", "rfc2217://192.0.2.7:5000/?ign_set_control&timeout=5"),
    ],
)
def test_other_ways_to_write_an_address_are_the_same_device(driver: str, one: str, other: str) -> None:
    assert device_keys(driver, one) & device_keys(driver, other)


@pytest.mark.parametrize(
    ("driver", "one", "other"),
    [
        ("indi", "localhost/Panel", "localhost/Panel 2"),
        ("indi", "localhost/Panel", "localhost:7625/Panel"),
        ("indi", "localhost/Panel", "192.0.2.7/Panel"),  # of a network for documents: never this computer
        ("alpaca", "http://localhost:80/switch/0/2", "http://localhost:80/switch/0/20"),
        ("alpaca", "http://localhost:80/switch/0/2", "http://localhost:80/covercalibrator/0"),
        ("aravis", "18273645", "18273646"),
    ],
)
def test_other_devices_have_other_locks(driver: str, one: str, other: str) -> None:
    assert not device_keys(driver, one) & device_keys(driver, other)


def test_links_to_a_port_and_its_number_are_the_same_device(tmp_path: Path) -> None:
    ends = pty.openpty()
    try:
        port, link, second = os.ttyname(ends[1]), tmp_path / "by-id", tmp_path / "by-path"
        link.symlink_to(port)
        second.symlink_to(link)
        names = [port, str(link), str(second), f"/proc/{os.getpid()}/fd/{ends[1]}", f"spy://{port}"]
        assert len({device_keys(driver, name) for name in names for driver in ("thorlabs", "arduino")}) == 1
        number = os.stat(port).st_rdev
        assert device_keys("arduino", port) == {f"character device {os.major(number)}:{os.minor(number)}"}
    finally:
        for end in ends:
            os.close(end)


def test_localhost_and_its_number_do_not_run_side_by_side(tmp_path: Path) -> None:
    """Two captures on one light: the second would switch off the first one's laser."""
    with held_elsewhere("localhost:7624/Panel", "indi", tmp_path) as holder:
        with (
            pytest.raises(CaptureError, match=rf"laser: indi at 127.0.0.1/Panel is in use .*process {holder.pid}\)"),
            device_locked("laser", "indi", "127.0.0.1/Panel"),
        ):
            pass
        with device_locked("laser", "indi", "127.0.0.1/Panel 2"):
            pass


@pytest.mark.skipif(os.getuid() != 0, reason="only root can become another user")
def test_another_user_of_the_computer_is_refused_too() -> None:
    # Modules are loaded before: another user may not be allowed to read them.
    change = "import os; from rigs._open_rig import device_keys; device_keys(*sys.argv[1:]); os.setuid(65534)"
    as_nobody = CHILD.replace("with device_locked", f"{change}\nwith device_locked")
    with device_locked("laser", "indi", "localhost/Panel"):
        command = [sys.executable, "-c", as_nobody, "indi", "127.0.0.1/Panel"]
        ran = subprocess.run(command, stdin=subprocess.DEVNULL, capture_output=True, text=True, timeout=60, check=False)
    assert ran.returncode == 1
    assert f"is in use by another capture (process {os.getpid()})" in ran.stderr


def indi_rig(wheel: str, laser: str, lamp: str) -> RigFile:
    filters = simulated_rig("red").filter_wheel.filters
    return RigFile(
        name="lab",
        camera=CameraSettings(driver="indi", address="localhost/ZWO CCD"),
        filter_wheel=FilterWheelSettings(driver="indi", address=wheel, filters=filters),
        laser=LaserSettings(driver="indi", address=laser, **LASER),
        lamp=LampSettings(driver="indi", address=lamp),
    )


def test_laser_and_lamp_by_two_names_are_still_one_light() -> None:
    rig = indi_rig("localhost/Wheel", "localhost/Panel", "127.0.0.1:7624/Panel")
    message = r"laser at localhost/Panel and lamp at 127.0.0.1:7624/Panel are the same device; correct"
    with pytest.raises(RefusedError, match=message), rig_locked(rig):
        pass


def test_a_camera_and_its_own_wheel_share_a_lock() -> None:
    rig = indi_rig("127.0.0.1/ZWO CCD", "localhost/Panel", "localhost/Lamp")
    assert device_keys("indi", rig.filter_wheel.address) & device_keys("indi", rig.camera.address)
    with (
        rig_locked(rig),
        pytest.raises(CaptureError, match="filter wheel"),
        device_locked("filter wheel", "indi", rig.filter_wheel.address),
    ):
        pass


def test_wheel_and_lamp_by_two_links_are_still_one_port(tmp_path: Path) -> None:
    port, link = tmp_path / "ttyUSB0", tmp_path / "by-id"
    port.touch()
    link.symlink_to(port)
    rig = real_rig(str(port), LampSettings(driver="arduino", address=str(link)))
    message = r"filter wheel at .*ttyUSB0 and lamp at .*by-id are the same device"
    with pytest.raises(RefusedError, match=message), rig_locked(rig):
        pass


def test_what_is_no_device_is_not_locked() -> None:
    """Held twice without an error, which is all that there is to see."""
    rig = simulated_rig("red")
    folder = ("camera", "folder", "a")
    with rig_locked(rig), rig_locked(rig), device_locked(*folder), device_locked(*folder):
        pass


def test_laser_and_lamp_are_two_switches() -> None:
    with pytest.raises(FieldError, match=r"laser and lamp have the same driver 'arduino' and address socket://board:1"):
        real_rig("socket://wheel:1", LampSettings(driver="arduino", address="socket://board:1"))


def test_wheel_and_laser_are_at_two_ports() -> None:
    with pytest.raises(FieldError, match=r"filter_wheel and laser have the same address, socket://board:1"):
        real_rig("socket://board:1", LampSettings(driver="manual"))
