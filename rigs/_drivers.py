"""From the name of a driver in a rig file to its module, of finray-calib or of another package; and what is in reach.

A driver is a module, imported when a rig names it. Those of finray-calib are the files of ``rigs.cameras``,
``rigs.filter_wheels``, ``rigs.lights``, ``rigs.stages`` and ``rigs.load_cells``; a driver of another package is an
entry point of the group ``finray_calib.cameras`` (``.filter_wheels``, ``.lights``, ``.stages``, ``.load_cells``) whose
value is the module. A rig file cannot name a module itself: it travels with sessions, and must not choose what code
runs.

A camera's module has ``open_camera(settings, folder)``, a filter wheel's ``open_wheel(settings, operator)``, a light's
``open_switch(address, role, operator)`` and ``HAS_DEAD_MAN``, a stage's ``open_stage(settings)``, a load cell's
``open_load_cell(settings)``; each function returns a context manager. One with
``found()`` can look for its devices; the search asks every such driver, each with a deadline.
"""

import difflib
import math
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, ExitStack, contextmanager
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from pkgutil import iter_modules
from types import ModuleType
from typing import Any, Final, Literal, TypeVar, cast

from data_schemas import (
    NO_ADDRESS,
    CameraSettings,
    CaptureError,
    FilterWheelSettings,
    LampSettings,
    LaserSettings,
    LoadCellSettings,
    PlugIn,
    PlugInKind,
    RefusedError,
    RigFile,
    StageSettings,
    TactileRig,
    plug_ins,
)
from rigs._protocols import (
    CallThread,
    Camera,
    FilterWheel,
    Light,
    LoadCell,
    NoAnswerError,
    Operator,
    Stage,
    missing_members,
)
from rigs.light_guard import LEASE_S, GuardedLight, guarded_light
from rigs.lights.manual import plain_light
from rigs.transports import indi_address, port_advice

Kind = Literal["camera", "filter wheel", "light", "stage", "load cell"]
_FOLDERS: Final[dict[Kind, str]] = {
    "camera": "cameras",
    "filter wheel": "filter_wheels",
    "light": "lights",
    "stage": "stages",
    "load cell": "load_cells",
}
"""Kind -> folder of ``rigs``, and the last part of the group of entry points."""
_FUNCTIONS: Final[dict[Kind, tuple[str, ...]]] = {
    "camera": ("open_camera",),
    "filter wheel": ("open_wheel",),
    "light": ("open_switch", "HAS_DEAD_MAN"),
    "stage": ("open_stage",),
    "load cell": ("open_load_cell",),
}
_NAMES: Final = {"raspberry_pi": "picamera2", "image_folder": "folder"}
"""Files whose driver has another name; that of the others is the file's, with hyphens."""
OURS: Final = "finray-calib"
HOW_TO: Final = "docs/how-to/write-a-driver.md"
_KINDS: Final[dict[Kind, PlugInKind]] = {
    kind: PlugInKind(f"{kind}: driver", f"finray_calib.{folder}", _FUNCTIONS[kind], RefusedError, HOW_TO)
    for kind, folder in _FOLDERS.items()
}


@dataclass(frozen=True, slots=True)
class Driver:
    """A driver that a rig file can name.

    Attributes
    ----------
    kind, name
        What it drives, and its name in a rig file.
    module
        What is imported.
    package, version
        The distribution that brings it.
    """

    kind: Kind
    name: str
    module: str
    package: str = OURS
    version: str = ""

    @property
    def is_ours(self) -> bool:
        """Whether it is one of finray-calib."""
        return self.package == OURS

    @property
    def plug_in(self) -> PlugIn:
        """The same as what a package brings."""
        return PlugIn(_KINDS[self.kind], self.name, self.module, self.package, self.version)

    @property
    def label(self) -> str:
        """Its name, with the package where it is not ours: ``grbl (finray-grbl-wheel 0.1)``."""
        return self.name if self.is_ours else f"{self.name} ({self.package} {self.version})"


@cache
def offered(kind: Kind) -> dict[str, tuple[Driver, ...]]:
    """Return the drivers of a kind by name; several of one name where packages offer the same."""
    table = _ours(kind)
    for one in plug_ins(_KINDS[kind]):
        driver = Driver(kind, one.name, one.module, one.package, one.version)
        table[one.name] = (*table.get(one.name, ()), driver)
    return table


def _ours(kind: Kind) -> dict[str, tuple[Driver, ...]]:
    """Return the drivers of finray-calib by name."""
    folder = _FOLDERS[kind]
    table: dict[str, tuple[Driver, ...]] = {"simulated": (Driver(kind, "simulated", "rigs.simulated"),)}
    for file in iter_modules([str(Path(__file__).with_name(folder))]):
        if not file.name.startswith("_"):
            name = _NAMES.get(file.name, file.name.replace("_", "-"))
            table[name] = (Driver(kind, name, f"rigs.{folder}.{file.name}"),)
    return table


def find_driver(kind: Kind, name: str) -> Driver:
    """Return the one driver of a name; nothing is imported.

    Raises
    ------
    RefusedError
        There is none, or several packages offer one.
    """
    table = offered(kind)
    if name not in table:
        known = ", ".join(sorted(found[0].label for found in table.values()))
        near = difflib.get_close_matches(name, table, 1, cutoff=0.6)
        hint = f"did you mean '{near[0]}'? Valid" if near else "valid"
        raise RefusedError(
            f"{kind}: no driver '{name}' is installed; {hint} drivers are {known}. Change the key driver in the rig "
            f"file, or install the package that provides the driver ({HOW_TO})"
        )
    if len(table[name]) > 1:
        packages = [f"{driver.package} {driver.version}".rstrip() for driver in table[name]]
        others = [driver.package for driver in table[name] if not driver.is_ours]
        raise RefusedError(
            f"{kind}: driver '{name}' is offered by {' and by '.join(packages)}, and finray cannot know which one you "
            f"mean; run 'pip uninstall {others[-1]}', or ask the author of that package to rename the driver"
        )
    return table[name][0]


Settings = CameraSettings | FilterWheelSettings | LaserSettings | LampSettings | StageSettings | LoadCellSettings
_OWN_KINDS: Final[Mapping[str, Kind]] = {kind: kind for kind in ("camera", "filter wheel", "stage", "load cell")}


def device_title(role: str, settings: Settings) -> str:
    """Return a device of a rig file with its driver, the driver's package where it is not ours, and its address."""
    kind = _OWN_KINDS.get(role, "light")
    labels = [driver.label for driver in offered(kind).get(settings.driver, ())]
    driver = labels[0] if len(labels) == 1 else settings.driver
    return f"{role}: {driver}{f' at {settings.address}' if settings.address else ''}"


def driver_module(driver: Driver) -> ModuleType:
    """Return the module of a driver, which has all that one of its kind must have.

    Raises
    ------
    RefusedError
        It cannot be imported, or lacks something.
    """
    return driver.plug_in.load()


def rig_drivers(rig: RigFile | TactileRig) -> tuple[Driver, ...]:
    """Return the drivers of a rig, each imported, none of a simulated rig; no device is opened.

    Raises
    ------
    RefusedError
        A driver is not installed, offered twice, cannot be imported or lacks something.
    """
    if rig.is_simulated:
        return ()
    named: list[tuple[Kind, str]] = [("camera", rig.camera.driver)]
    if isinstance(rig, TactileRig) and rig.stage is not None and rig.load_cell is not None:
        named += [("stage", rig.stage.driver), ("load cell", rig.load_cell.driver)]
    if isinstance(rig, RigFile):
        named.append(("filter wheel", rig.filter_wheel.driver))
        named += [("light", light.driver) for light in (rig.laser, rig.lamp)]
    drivers = tuple(find_driver(kind, name) for kind, name in named)
    for driver in drivers:
        driver_module(driver)
    return drivers


def driver_notes(rig: RigFile | TactileRig) -> tuple[str, ...]:
    """Return lines, for the record of a session, on drivers of other packages and on ports whose names may change.

    Drivers with their version; of a port whose name may lead to another device after a replug, which name to write.

    Raises
    ------
    RefusedError
        As :func:`rig_drivers` does.
    """
    drivers = rig_drivers(rig)
    others = [f"{driver.kind}: driver {driver.label}" for driver in drivers if not driver.is_ours]
    if not drivers:
        return ()
    held = (rig.filter_wheel, rig.laser, rig.lamp) if isinstance(rig, RigFile) else (rig.stage, rig.load_cell)
    ports = [port_advice(device.address) for device in held if device is not None and device.address]
    return tuple(dict.fromkeys([*others, *filter(None, ports)]))


Device = TypeVar("Device")


@contextmanager
def _opened(
    driver: Driver, opening: Callable[[ModuleType], AbstractContextManager[Device]], protocol: type
) -> Iterator[Device]:
    """Open a device for a ``with`` block, and refuse one that lacks a part of its protocol."""
    module, plug_in = driver_module(driver), driver.plug_in
    with ExitStack() as stack:
        device = plug_in.call(lambda: stack.enter_context(opening(module)), when=" when it opens")
        if lacking := missing_members(device, protocol):
            raise plug_in.refusal(f"returns a device that lacks {', '.join(lacking)}")
        yield device if driver.is_ours else cast("Device", _PackagedDevice(plug_in, device, protocol))


class _PackagedDevice:
    """A device of another package, whose errors name its driver and the method; errors of finray's own kinds pass."""

    def __init__(self, plug_in: PlugIn, device: object, protocol: type) -> None:
        self._plug_in, self._device, self._protocol = plug_in, device, protocol

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_"):
            raise AttributeError(name)
        if name not in dir(self._protocol):
            return getattr(self._device, name)
        found = self._named(name, lambda: getattr(self._device, name))
        if not callable(found):
            return found
        return lambda *given, **named: self._named(f"{name}()", lambda: found(*given, **named))

    def _named(self, what: str, function: Callable[[], Any]) -> Any:
        try:
            return self._plug_in.call(function, when=f" in {what}")
        except OSError as error:  # of a broken cable as of a mistake: a driver tells the two apart
            raise CaptureError(
                f"{self._plug_in.label} fails in {what} ({type(error).__name__}: {error}); check the device and its "
                f"cable ({HOW_TO})"
            ) from error


def open_camera(
    settings: CameraSettings, folder: Path, wheel: FilterWheelSettings | None = None
) -> AbstractContextManager[Camera]:
    """Return the camera of a rig, open for a ``with`` block; relative paths start in `folder`.

    An INDI camera names a filter in its headers: it is told which wheel, where that is on the same server.
    """
    extra = {}
    if settings.driver == "indi" and wheel is not None and wheel.driver == "indi":
        camera_at, wheel_at = indi_address(settings.address, "camera"), indi_address(wheel.address, "filter wheel")
        extra = {"wheel_device": wheel_at.device} if camera_at[:2] == wheel_at[:2] else {}
    driver = find_driver("camera", settings.driver)
    return _opened(driver, lambda module: module.open_camera(settings, folder, **extra), Camera)


def open_wheel(settings: FilterWheelSettings, operator: Operator) -> AbstractContextManager[FilterWheel]:
    """Return the filter wheel of a rig, open for a ``with`` block."""
    driver = find_driver("filter wheel", settings.driver)
    return _opened(driver, lambda module: module.open_wheel(settings, operator), FilterWheel)


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
        module = driver_module(find_driver("light", settings.driver))
        return plain_light(module.open_switch(settings.address, "lamp", operator))
    return guarded_light("lamp", settings.driver, settings.address, math.inf)


def open_stage(settings: StageSettings) -> AbstractContextManager[Stage]:
    """Return the stage of a rig, open for a ``with`` block; opening stops whatever it was doing."""
    return _opened(find_driver("stage", settings.driver), lambda module: module.open_stage(settings), Stage)


def open_load_cell(settings: LoadCellSettings) -> AbstractContextManager[LoadCell]:
    """Return the load cell of a rig, open for a ``with`` block."""
    return _opened(find_driver("load cell", settings.driver), lambda module: module.open_load_cell(settings), LoadCell)


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
        Drivers that could not look, and why; drivers of other packages.
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
    notes: list[str] = [f"{driver.kind} driver {driver.label} is installed" for driver in drivers_of_other_packages()]
    not_searched: list[str] = []
    for kind in _FOLDERS:
        for name in offered(kind):
            if name in (*NO_ADDRESS, "folder"):
                continue
            try:
                listed = CallThread(f"search for {name}").call(partial(_found, kind, name), limit_s)
                if listed is None:
                    not_searched.append(name)
                else:
                    devices += [FoundDevice(kind, name, address, what) for address, what in listed]
            except NoAnswerError:
                notes.append(f"{name}: the search for a {kind} did not end within {limit_s:g} s")
            except Exception as error:  # whatever one driver runs into must not hide what the others find
                notes.append(f"{name}: {error}")
    boards = [device.address for device in devices if (device.kind, device.driver) == ("light", "arduino")]
    if len(boards) > 1:
        notes.append(
            f"{len(boards)} lights run the same firmware ({', '.join(boards)}); to learn which one is the laser, "
            "unplug the laser's board and search again"
        )
    return Detection(tuple(devices), tuple(dict.fromkeys(notes)), tuple(dict.fromkeys(not_searched)))


def _found(kind: Kind, name: str) -> list[tuple[str, str]] | None:
    """Return address and description of the devices that a driver finds; None where it cannot look."""
    found: Callable[[], list[tuple[str, str]]] | None
    found = getattr(driver_module(find_driver(kind, name)), "found", None)
    return None if found is None else found()


def drivers_of_other_packages() -> list[Driver]:
    """Return every driver that finray-calib does not bring; nothing is imported."""
    return [driver for kind in _FOLDERS for found in offered(kind).values() for driver in found if not driver.is_ours]
