"""What the devices of a rig say about themselves, each on its own; nothing moves and the lights stay off."""

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from data_schemas import CameraSettings, DeviceIdentity, FinrayError, RigFile, TactileRig, coverage_notes
from data_schemas.storage import camera_response, lamp_curve, read_filter_curves
from rigs._drivers import Kind, offered
from rigs._host import TerminalOperator
from rigs._open_rig import Settings, lone_camera, lone_lamp, lone_laser, lone_wheel
from rigs._protocols import Camera, Light
from rigs.light_guard import GuardedLight, off_lines

DARK_EXPOSURE_S: Final = 0.01
Lines = Iterator["str | Warned"]


class Warned(str):
    """A line that the user should not miss."""

    __slots__ = ()


@dataclass(frozen=True, slots=True)
class PartReport:
    """What one part of a rig reports.

    Attributes
    ----------
    title
        What it is, with its driver and address.
    lines, warnings
        What it says, and what the user should not miss.
    error
        Why it could not say (more).
    """

    title: str
    lines: tuple[str, ...]
    warnings: tuple[str, ...]
    error: Exception | None


def look_at(rig: RigFile, folder: Path) -> Iterator[PartReport]:
    """Report on laser, lamp, filter wheel, camera and curves, one after the other; an error of one hides no other.

    Lights come first: opening switches them off, so that the camera's frame is dark.

    Parameters
    ----------
    rig
        The rig file's content.
    folder
        Where relative paths in it start.
    """
    yield _report(device_title("laser", rig.laser), lambda: _laser(rig, folder))
    yield _report(device_title("lamp", rig.lamp), lambda: _lamp(rig, folder))
    yield _report(device_title("filter wheel", rig.filter_wheel), lambda: _wheel(rig, folder))
    yield _report(device_title("camera", rig.camera), lambda: _camera(lone_camera(rig, folder), rig.camera))
    yield _report("filters and curves", lambda: _curves(rig, folder))


def look_at_tactile(rig: TactileRig, folder: Path) -> Iterator[PartReport]:
    """Report on the camera of a tactile rig, which has nothing else.

    Parameters
    ----------
    rig
        The rig file's content.
    folder
        Where relative paths in it start.
    """
    camera = rig.camera
    yield _report(device_title("camera", camera), lambda: _camera(lone_camera(rig, folder), camera))


def device_title(role: str, settings: Settings) -> str:
    """Return a device of a rig file with its driver, the driver's package where it is not ours, and its address."""
    kind: Kind = "camera" if role == "camera" else "filter wheel" if role == "filter wheel" else "light"
    labels = [driver.label for driver in offered(kind).get(settings.driver, ())]
    driver = labels[0] if len(labels) == 1 else settings.driver
    return f"{role}: {driver}{f' at {settings.address}' if settings.address else ''}"


def _report(title: str, look: Callable[[], Lines]) -> PartReport:
    """Collect what a part says, also before an error."""
    lines: list[str] = []
    error: Exception | None = None
    try:
        lines.extend(look())  # what came before an error stays
    except (FinrayError, OSError) as caught:
        error = caught
    said = tuple(line for line in lines if not isinstance(line, Warned))
    return PartReport(title, said, tuple(line for line in lines if isinstance(line, Warned)), error)


def _says(identity: DeviceIdentity) -> str:
    """Return a device's identity in a line."""
    name = " ".join(part for part in (identity.vendor, identity.model) if part) or "does not say what it is"
    serial = f", serial {identity.serial}" if identity.serial else ""
    return f"{name}{serial}{f', firmware {identity.firmware}' if identity.firmware else ''}"


def _laser(rig: RigFile, folder: Path) -> Lines:
    laser = rig.laser
    with lone_laser(rig, folder) as light:
        yield from _light(light)
    yield f"by the rig file: {laser.wavelength_nm:g} nm, {laser.power_mw:g} mW, class {laser.laser_class}"


def _lamp(rig: RigFile, folder: Path) -> Lines:
    if rig.lamp.driver == "manual":
        yield "switched by hand; nobody is asked here, so that its state is unknown"
        yield Warned("see that the lamp is off: nothing shows whether the camera's frame below was dark")
        return
    with lone_lamp(rig, folder, TerminalOperator()) as light:
        yield from _light(light)


def _light(light: Light) -> Lines:
    yield _says(light.identity())
    if light.state():
        yield Warned("reports ON although it was switched off; look at its controller")
    else:
        yield "reports off"
    if isinstance(light, GuardedLight):
        by_processes, by_hardware = off_lines(light.has_dead_man, light.outside_layer)
        yield by_processes
        yield by_hardware if light.has_dead_man else Warned(by_hardware)
        if light.refusal:
            yield Warned(f"cannot be lit: {light.refusal}")


def _wheel(rig: RigFile, folder: Path) -> Lines:
    with lone_wheel(rig, folder, TerminalOperator()) as wheel:
        yield _says(wheel.identity())
        names = {band.slot: band.name for band in rig.filter_wheel.filters}
        position = wheel.position()
        if position is None:
            yield "position unknown: it moves, is out of the beam, or nobody has confirmed one"
        else:
            yield f"at slot {position}, {f'filter {names[position]}' if position in names else 'which has no filter'}"
        yield "slots: " + ", ".join(f"{slot} {names.get(slot, '(none)')}" for slot in wheel.slots)
        if lost := sorted(set(names) - set(wheel.slots)):
            yield Warned(f"the wheel has no slot {lost[0]}, where the rig file puts filter {names[lost[0]]}")


def _camera(opening: AbstractContextManager[Camera], settings: CameraSettings) -> Lines:
    with opening as camera:
        yield _says(camera.identity())
        if settings.driver == "folder":
            yield "not exposed: each image of a folder is used once"
            return
        exposure_s = min(max(DARK_EXPOSURE_S, settings.shortest_exposure_s), settings.longest_exposure_s)
        from rigs.capture import CAMERA_DEADLINE_MARGIN_S  # which needs an open rig itself

        frame = camera.expose(exposure_s, exposure_s + CAMERA_DEADLINE_MARGIN_S)
    counts = frame.counts
    yield f"{counts.shape[1]} x {counts.shape[0]} px; {exposure_s:g} s asked for, {frame.exposure_s:g} s read back"
    yield (
        f"without lights {counts.min()} to {counts.max()} DN, median {np.median(counts):g} DN; by the rig file the "
        f"black level is {settings.black_level_dn:g} DN"
    )
    if frame.settings:
        yield "settings: " + ", ".join(f"{name} {value}" for name, value in sorted(frame.settings.items()))
    if counts.shape[:2] != (settings.height_px, settings.width_px):
        yield Warned(f"the rig file says {settings.width_px} x {settings.height_px} px; correct width_px and height_px")
    if counts.max() >= 2**settings.bit_depth - 1:
        yield Warned("some pixels are saturated in the dark: light leaks in, or bit_depth of the rig file is wrong")


def _curves(rig: RigFile, folder: Path) -> Lines:
    """Return the table of the filters and what is known of the curves."""
    yield f"{'slot':>4}  {'name':8}  {'centre, nm':>14}  {'width, nm':>14}  {'OD':>3}  transmission"
    for band in sorted(rig.filter_wheel.filters, key=lambda band: band.slot):
        center = f"{band.center_nm:g} +- {band.center_uncertainty_nm:g}"
        width = f"{band.fwhm_nm:g} +- {band.fwhm_uncertainty_nm:g}"
        curve = "nominal" if band.curve is None else band.curve
        yield f"{band.slot:>4}  {band.name:8}  {center:>14}  {width:>14}  {band.blocking_od:>3g}  {curve}"
    if rig.camera.response == "assumed":
        yield Warned("the camera's response is assumed; name a measured one (camera.response) where there is one")
    curves = read_filter_curves(rig.filter_wheel.filters, folder)
    response = camera_response(rig.camera.response, folder)
    yield from map(Warned, coverage_notes(rig.filter_wheel.filters, curves, (*response, lamp_curve(rig.lamp, folder))))
