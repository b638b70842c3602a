"""What can be found: every driver that can look for its devices is asked, each with a deadline."""

from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from typing import Final, Literal

from data_schemas.devices import NO_ADDRESS
from rigs.call_thread import CallThread, NoAnswerError
from rigs.drivers import CAMERAS, FILTER_WHEELS, LIGHTS

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
