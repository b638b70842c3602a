"""One device of a rig alone, so that the others need not be there; locked against captures as in a session."""

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import TypeVar

from data_schemas.devices import CameraSettings, FilterWheelSettings, LampSettings, LaserSettings
from data_schemas.rig import RigFile
from rigs.capture.rig_lock import device_locked
from rigs.drivers import open_camera, open_lamp, open_laser, open_wheel
from rigs.open_rig import OpenRig, open_rig
from rigs.protocols import Camera, FilterWheel, Light, Operator

T = TypeVar("T")
Settings = CameraSettings | FilterWheelSettings | LaserSettings | LampSettings


def lone_camera(rig: RigFile, folder: Path) -> AbstractContextManager[Camera]:
    """Return the camera, open for a ``with`` block; relative paths start in `folder`."""
    return _alone(
        rig, folder, "camera", rig.camera, lambda: open_camera(rig.camera, folder), lambda opened: opened.camera
    )


def lone_wheel(rig: RigFile, folder: Path, operator: Operator) -> AbstractContextManager[FilterWheel]:
    """Return the filter wheel, open for a ``with`` block."""
    wheel = rig.filter_wheel
    return _alone(rig, folder, "filter wheel", wheel, lambda: open_wheel(wheel, operator), lambda opened: opened.wheel)


def lone_laser(rig: RigFile, folder: Path) -> AbstractContextManager[Light]:
    """Return the laser behind its guard, open for a ``with`` block; it is confirmed off before and after."""
    return _alone(rig, folder, "laser", rig.laser, lambda: open_laser(rig.laser), lambda opened: opened.laser)


def lone_lamp(rig: RigFile, folder: Path, operator: Operator) -> AbstractContextManager[Light]:
    """Return the lamp, open for a ``with`` block; it is confirmed off before and after."""
    return _alone(rig, folder, "lamp", rig.lamp, lambda: open_lamp(rig.lamp, operator), lambda opened: opened.lamp)


@contextmanager
def _alone(
    rig: RigFile,
    folder: Path,
    role: str,
    settings: Settings,
    opening: Callable[[], AbstractContextManager[T]],
    of_bench: Callable[[OpenRig], T],
) -> Iterator[T]:
    """Open a real device, or take it from the simulated bench."""
    if rig.is_simulated:
        with open_rig(rig, folder) as opened:
            yield of_bench(opened)
    else:
        with device_locked(role, settings.driver, settings.address), opening() as device:
            yield device
