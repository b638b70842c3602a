"""From the name of a driver to its module, and what the drivers can find; each is imported when it is named.

A camera's module has ``open_camera(settings, folder)``, a filter wheel's ``open_wheel(settings, operator)``, a light's
``open_switch(address, role, operator)``; each returns a context manager. One with ``found()`` can look for its devices;
the search asks every such driver, each with a deadline.
"""

import math
from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Final, Literal, cast

from data_schemas import NO_ADDRESS, CameraSettings, FilterWheelSettings, LampSettings, LaserSettings
from rigs._host import CallThread, NoAnswerError
from rigs._protocols import Camera, FilterWheel, Light, Operator
from rigs.light_guard import LEASE_S, GuardedLight, guarded_light
from rigs.lights.manual import plain_light
from rigs.transports import indi_address

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


Kind = Literal["camera", "filter wheel", "light"]
DRIVERS: Final[dict[Kind, dict[str, str]]] = {"camera": CAMERAS, "filter wheel": FILTER_WHEELS, "light": LIGHTS}
# A board that restarts when its port is opened needs 3.5 s to speak; some computers have several ports.
LOOK_WITHIN_S: Final = 12.0


@dataclass(frozen=True, slots=True)
class FoundDevice:
    """A device in reach: what it can be in a rig, and how the rig file names it.

    Attributes
    ----------
    kind
        What it can be.
    driver, address
        For the rig file.
    what
        What it says it is.
    """

    kind: Kind
    driver: str
    address: str
    what: str


@dataclass(frozen=True, slots=True)
class Detection:
    """What was found, and why some drivers found nothing.

    Attributes
    ----------
    devices
        Devices in reach.
    notes
        Drivers that could not look, and why.
    not_searched
        Drivers whose devices cannot be looked for.
    """

    devices: tuple[FoundDevice, ...]
    notes: tuple[str, ...]
    not_searched: tuple[str, ...]


def detect(limit_s: float = LOOK_WITHIN_S) -> Detection:
    """Ask every driver what it can find, one after the other; at most `limit_s` seconds each. Nothing is switched.

    Serial ports behind USB are opened for a moment, and most Arduino boards restart then.
    """
    devices: list[FoundDevice] = []
    notes: list[str] = []
    not_searched: list[str] = []
    for kind, modules in DRIVERS.items():
        for driver, module in modules.items():
            try:
                found: Callable[[], list[tuple[str, str]]] | None = getattr(import_module(module), "found", None)
                if found is not None:
                    listed = CallThread(f"search for {driver}").call(found, limit_s)
                    devices += [FoundDevice(kind, driver, address, what) for address, what in listed]
                elif driver not in (*NO_ADDRESS, "folder", *not_searched):
                    not_searched.append(driver)
            except NoAnswerError:
                notes.append(f"{driver}: the search for a {kind} did not end within {limit_s:g} s")
            except Exception as error:  # whatever one driver runs into must not hide what the others find
                notes.append(f"{driver}: {error}")
    return Detection(tuple(devices), tuple(dict.fromkeys(notes)), tuple(not_searched))
