"""From the name of a driver to its module: each is imported only when a rig file names it.

A camera's module has ``open_camera(settings, folder)``, a filter wheel's ``open_wheel(settings, operator)``, a light's
``open_switch(address, role, operator)``; each returns a context manager.
"""

import math
from contextlib import AbstractContextManager
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Final, cast

from data_schemas.devices import CameraSettings, FilterWheelSettings, LampSettings, LaserSettings
from rigs.light_guard.guarded_light import LEASE_S, GuardedLight, guarded_light
from rigs.lights.plain_light import plain_light
from rigs.protocols import Camera, FilterWheel, Light, Operator
from rigs.transports.indi_server import indi_address

CAMERAS: Final = {
    "aravis": "rigs.cameras.aravis",
    "gentl": "rigs.cameras.gentl",
    "mjpeg": "rigs.cameras.mjpeg",
    "picamera2": "rigs.cameras.raspberry_pi",
    "indi": "rigs.cameras.indi",
    "micro-manager": "rigs.cameras.micro_manager",
    "folder": "rigs.cameras.image_folder",
}
FILTER_WHEELS: Final = {
    "thorlabs": "rigs.filter_wheels.thorlabs",
    "indi": "rigs.filter_wheels.indi",
    "alpaca": "rigs.filter_wheels.alpaca",
    "manual": "rigs.filter_wheels.manual",
}
LIGHTS: Final = {
    "arduino": "rigs.lights.arduino",
    "indi": "rigs.lights.indi",
    "alpaca": "rigs.lights.alpaca",
    "manual": "rigs.lights.manual",
}


def open_camera(
    settings: CameraSettings, folder: Path, wheel: FilterWheelSettings | None = None
) -> AbstractContextManager[Camera]:
    """Return the camera of a rig, open for a ``with`` block; relative paths start in `folder`.

    An INDI camera names a filter in its headers: it is told which wheel, where that is on the same server.
    """
    module = _module(CAMERAS, settings.driver)
    extra = {}
    if settings.driver == "indi" and wheel is not None and wheel.driver == "indi":
        camera_at, wheel_at = indi_address(settings.address, "camera"), indi_address(wheel.address, "filter wheel")
        extra = {"wheel_device": wheel_at.device} if camera_at[:2] == wheel_at[:2] else {}
    return cast(AbstractContextManager[Camera], module.open_camera(settings, folder, **extra))


def open_wheel(settings: FilterWheelSettings, operator: Operator) -> AbstractContextManager[FilterWheel]:
    """Return the filter wheel of a rig, open for a ``with`` block."""
    wheel = _module(FILTER_WHEELS, settings.driver).open_wheel(settings, operator)
    return cast(AbstractContextManager[FilterWheel], wheel)


def open_laser(settings: LaserSettings, lease_s: float = LEASE_S) -> AbstractContextManager[GuardedLight]:
    """Return the laser of a rig behind its guard process, open for a ``with`` block.

    It goes off when the program asks nothing for `lease_s` seconds while it is lit. One of class 3R or above goes on
    only with a layer outside the computer.
    """
    return guarded_light("laser", settings.driver, settings.address, lease_s, settings)


def open_lamp(settings: LampSettings, operator: Operator) -> AbstractContextManager[Light]:
    """Return the lamp of a rig, open for a ``with`` block.

    One with a controller has a guard process too: it also feeds the dead-man, without which a lamp goes off.
    """
    if settings.driver == "manual":
        return plain_light(_module(LIGHTS, settings.driver).open_switch(settings.address, "lamp", operator))
    return guarded_light("lamp", settings.driver, settings.address, math.inf)


def _module(known: dict[str, str], driver: str) -> ModuleType:
    """Return the module of a driver."""
    return import_module(known[driver])
