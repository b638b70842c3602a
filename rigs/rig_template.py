"""The rig file that a new user starts from: the paper's set-up, with what was found in the place of what is assumed."""

from collections.abc import Mapping
from typing import Any, Final, Literal

from data_schemas.band_pass_filter import BandPassFilter
from data_schemas.devices import CameraSettings, FilterWheelSettings, LampSettings, LaserSettings
from data_schemas.rig import RigFile
from rigs.detect import FoundDevice
from rigs.presets import PAPER_FILTERS_NM

Role = Literal["camera", "filter wheel", "laser", "lamp"]
CAMERA_SERIAL: Final = "SERIAL-NUMBER"
"""Where nothing was found: no camera has this, so that the file is refused until it is filled in."""
WHEEL_PORT: Final = "/dev/ttyUSB0"
LASER_PORT: Final = "/dev/ttyACM0"
_PAPER: Final[dict[Role, dict[str, Any]]] = {
    "camera": {"driver": "aravis", "address": CAMERA_SERIAL, "model": "CM3-U3-13Y3C-CS"},
    "filter wheel": {"driver": "thorlabs", "address": WHEEL_PORT, "model": "FW212C"},
    "laser": {"driver": "arduino", "address": LASER_PORT},
    "lamp": {"driver": "manual"},
}
_TO_FILL_IN: Final[dict[Role, str]] = {
    "camera": f"camera: address = {CAMERA_SERIAL} stands for its serial number ('finray rig detect' lists cameras)",
    "filter wheel": f"filter_wheel: address = {WHEEL_PORT} is the usual port; 'finray rig detect' names the right one",
    "laser": f"laser: address = {LASER_PORT} is the usual port; 'finray rig detect' names the right one",
    "lamp": "lamp: driver = manual, the operator switches it; name a driver and an address if a controller does",
}
_ALWAYS: Final = (
    "laser: compare wavelength_nm, power_mw and laser_class with its label; it is not switched on before they stand "
    "in the file",
    "filter_wheel.filters: correct the slots, and the centres and uncertainties where there is a certificate",
    "camera: width, height, bit_depth and the three noise figures are those of the paper's camera",
)


def paper_rig(found: Mapping[Role, FoundDevice]) -> RigFile:
    """Return the paper's rig: eight filters known from a catalogue, a laser of 4.5 mW at 450 nm, a halogen lamp.

    Parameters
    ----------
    found
        Devices to use in the place of the assumed ones.
    """
    named = {role: _named(role, found.get(role)) for role in _PAPER}
    filters = tuple(
        BandPassFilter(slot=slot, name=str(center_nm), center_nm=center_nm)
        for slot, center_nm in enumerate(PAPER_FILTERS_NM, 1)
    )
    label = {"wavelength_nm": 450.0, "power_mw": 4.5, "laser_class": "3R"}
    return RigFile(
        name="paint bench",
        camera=CameraSettings.model_validate(named["camera"]),
        filter_wheel=FilterWheelSettings.model_validate({**named["filter wheel"], "filters": filters}),
        laser=LaserSettings.model_validate({**named["laser"], **label}),
        lamp=LampSettings.model_validate(named["lamp"]),
    )


def to_fill_in(found: Mapping[Role, FoundDevice]) -> tuple[str, ...]:
    """Return what the user has to fill in or compare in the file of :func:`paper_rig`."""
    return (*(text for role, text in _TO_FILL_IN.items() if role not in found), *_ALWAYS)


def _named(role: Role, device: FoundDevice | None) -> dict[str, Any]:
    """Return driver, address and model of a role."""
    if device is None:
        return _PAPER[role]
    model = {"model": device.what} if "model" in _PAPER[role] else {}
    return {"driver": device.driver, "address": device.address, **model}
