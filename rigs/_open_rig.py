"""From a rig file to opened devices: ``with open_rig(rig, folder) as opened:``; and what each says about itself.

All of a rig or one device alone, so that the others need not be there; an overview asks each on its own, moves
nothing and leaves the lights off. One capture at a time has a device, whatever its address is called: ``with
rig_locked(rig):``.

A lock goes by what an address leads to. Serial ports count by the device's number, so that every link to one is the
same; servers by every network address that their name resolves to, where all addresses of this computer are one. A
lock is a name in the kernel's table of abstract sockets: it holds for all users and vanishes with its process. What
two names share behind another computer (a tunnel, a forwarded port) cannot be seen from here. A camera with several
names (its serial number, its network address) refuses a second program by itself.
"""

import errno
import hashlib
import ipaddress
import os
import socket
import stat
import struct
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, ExitStack, contextmanager, nullcontext, suppress
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Final, TypeVar
from urllib.parse import urlsplit

import numpy as np

from data_schemas import (
    NO_ADDRESS,
    CameraSettings,
    CaptureError,
    DeviceIdentity,
    FinrayError,
    LoadCellSettings,
    PracticeFault,
    RefusedError,
    RigFile,
    SpectralCurve,
    TactileRig,
    coverage_notes,
)
from data_schemas.storage import camera_response, lamp_curve, read_filter_curves
from rigs._drivers import (
    Settings,
    device_title,
    driver_notes,
    open_camera,
    open_lamp,
    open_laser,
    open_wheel,
)
from rigs._protocols import Camera, Clock, FilterWheel, Light, Operator, SystemClock, TerminalOperator
from rigs.light_guard import GuardedLight, LightMeter, off_lines, open_photodiode
from rigs.transports import indi_address, port_advice

if TYPE_CHECKING:
    from rigs.simulated import BenchState
    from rigs.simulated.sensor import Sensor


THIS_COMPUTER: Final = "this computer"
_PORT_WRAPPERS: Final = ("spy", "alt")
"""Schemes of pyserial that hold the path of a port: ``spy:///dev/ttyUSB0``."""
_SERIAL_SERVERS: Final = ("socket", "rfc2217")
"""Schemes of pyserial that lead to a port of a server: what follows its number are options."""
_CREDENTIALS: Final = struct.Struct("3i")
"""Process, user and group of the other end of a socket."""


def device_keys(driver: str, address: str) -> frozenset[str]:
    """Return names of the device behind an address; two addresses that share one lead to the same device.

    Parameters
    ----------
    driver, address
        As in the rig file. What is not an address counts as it is written: opening the device tells what is wrong.
    """
    if driver == "indi":
        with suppress(RefusedError):
            where = indi_address(address, "device")
            return frozenset(f"{host}:{where.port}/{where.device}" for host in _hosts(where.host))
    try:
        parts = urlsplit(address)
        host, port = parts.hostname, parts.port or (80 if parts.scheme == "http" else 0)
    except ValueError:
        return frozenset({f"{driver} {address}"})
    if parts.scheme and host:
        pieces = [piece.lstrip("0") or "0" if piece.isdecimal() else piece for piece in parts.path.split("/") if piece]
        is_served = parts.scheme in _SERIAL_SERVERS
        path = "" if is_served else "/".join(pieces) + (f"?{parts.query}" if parts.query else "")
        return frozenset(f"{name}:{port}/{path}" for name in _hosts(host))
    path = parts.path if parts.scheme in _PORT_WRAPPERS else address
    return frozenset({_port_key(path) or f"{driver} {address.strip()}"})


def _port_key(path: str) -> str | None:
    """Return the number of a port on this computer, or its real path where there is none; None where it is no path."""
    if "/" not in path:
        return None
    try:
        found = os.stat(path)
    except (OSError, ValueError):
        return os.path.realpath(path) if path.startswith("/") and "\0" not in path else None
    if stat.S_ISCHR(found.st_mode):
        return f"character device {os.major(found.st_rdev)}:{os.minor(found.st_rdev)}"
    return os.path.realpath(path)


def _hosts(name: str) -> set[str]:
    """Return the network addresses of a computer; its name where that is unknown, which opening the device tells."""
    try:
        found = socket.getaddrinfo(name, None, type=socket.SOCK_STREAM)
    except (OSError, UnicodeError):
        return {name.rstrip(".").casefold()}
    return {_host_key(str(entry[4][0]).partition("%")[0]) for entry in found}


def _host_key(text: str) -> str:
    """Return a network address; those of this computer have one name."""
    address = ipaddress.ip_address(text)
    address = getattr(address, "ipv4_mapped", None) or address
    if address.is_loopback or address.is_unspecified:
        return THIS_COMPUTER
    with socket.socket(socket.AF_INET if address.version == 4 else socket.AF_INET6, socket.SOCK_DGRAM) as probe:
        try:
            probe.bind((str(address), 0))  # the kernel takes addresses of its own only
        except OSError:
            return str(address)
    return THIS_COMPUTER


@contextmanager
def rig_locked(rig: RigFile) -> Iterator[None]:
    """Hold the locks of all devices of a rig for a ``with`` block; a camera and its own INDI wheel share one.

    Raises
    ------
    CaptureError
        Another process holds one.
    RefusedError
        Two addresses of the rig lead to one device that cannot be both.
    """
    with ExitStack() as stack:
        for key, role, device in _keys_apart(rig):
            stack.enter_context(_locked(key, role, device.driver, device.address))
        yield


def _keys_apart(rig: RigFile) -> Iterator[tuple[str, str, Settings]]:
    """Yield the name of each device of a rig once, with the role that has it; refuse two that cannot be one device."""
    devices: dict[str, Settings]
    devices = {"camera": rig.camera, "filter wheel": rig.filter_wheel, "laser": rig.laser, "lamp": rig.lamp}
    holders: dict[str, str] = {}
    for role, device in devices.items():
        keys = _keys_to_lock(device.driver, device.address)
        for holder in {holders[key] for key in keys & holders.keys()}:
            if device.driver != "indi" or {holder, role} == {"laser", "lamp"}:
                raise RefusedError(
                    f"{holder} at {devices[holder].address} and {role} at {device.address} are the same device; "
                    "correct the address of one of them in the rig file"
                )
        yield from ((key, role, device) for key in sorted(keys - holders.keys()))
        holders |= dict.fromkeys(keys, role)


@contextmanager
def device_locked(role: str, driver: str, address: str) -> Iterator[None]:
    """Hold the lock of one device for a ``with`` block; a folder of images is no device and has no lock.

    Raises
    ------
    CaptureError
        Another process holds it.
    """
    with ExitStack() as stack:
        for key in sorted(_keys_to_lock(driver, address)):
            stack.enter_context(_locked(key, role, driver, address))
        yield


def _keys_to_lock(driver: str, address: str) -> frozenset[str]:
    return frozenset() if driver in (*NO_ADDRESS, "folder") else device_keys(driver, address)


@contextmanager
def _locked(key: str, role: str, driver: str, address: str) -> Iterator[None]:
    """Hold one name for a ``with`` block."""
    name = f"\0finray-calib device {hashlib.sha256(key.encode()).hexdigest()}"
    with socket.socket(socket.AF_UNIX) as lock:
        try:
            lock.bind(name)
        except OSError as error:
            if error.errno != errno.EADDRINUSE:
                raise
            raise CaptureError(
                f"{role}: {driver} at {address} is in use by another capture (process {_holder(name)}); wait until it "
                "ends"
            ) from None
        lock.listen(socket.SOMAXCONN)  # each who asks for the holder takes a place for good
        yield


def _holder(name: str) -> str:
    """Return the process that holds a name."""
    with socket.socket(socket.AF_UNIX) as line:
        line.settimeout(1.0)
        try:
            line.connect(name)
            told = line.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _CREDENTIALS.size)
        except OSError:  # it has just ended
            return "unknown"
    return str(_CREDENTIALS.unpack(told)[0])


DARK_CURRENT_E_PER_S = 2.0
PIXEL_NONUNIFORMITY_REL = 0.01
DARK_OFFSET_SD_E = 2.0
FULL_WELL_MARGIN = 1.05
LEASE_S = 240.0
"""Beside two of the longest exposures (a camera's first frame is discarded): moves, retries and a slow disk."""


@dataclass(frozen=True, slots=True)
class OpenRig:
    """Opened devices and the known curves of a rig.

    Attributes
    ----------
    camera_response
        Red, green and blue response (sensor and Bayer filter), relative.
    lamp_spectrum
        Relative spectral irradiance of the lamp on the target.
    filter_curves
        Measured transmission of the filters that name one, by the filter's name.
    notes
        What the user should know about the curves (end values that are held, range of measured transmissions), drivers
        of other packages with their versions, and what does not switch the laser off.
    practise
        Gives the simulated rig a fault to practise on, or takes it away (None); does nothing to a real one.
    photodiode
        Opens the photodiode at an address, a witness of the laser.
    close_beam
        Has a person close the laser's beam by hand (True) or open it again, and returns whether that was done.
    """

    camera: Camera
    wheel: FilterWheel
    laser: Light
    lamp: Light
    operator: Operator
    clock: Clock
    camera_response: tuple[SpectralCurve, SpectralCurve, SpectralCurve]
    lamp_spectrum: SpectralCurve
    filter_curves: Mapping[str, SpectralCurve] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    practise: Callable[[PracticeFault | None], None] = lambda fault: None
    photodiode: Callable[[str], AbstractContextManager[LightMeter]] = open_photodiode
    close_beam: Callable[[bool], bool] = lambda closed: False

    def identities(self) -> tuple[DeviceIdentity, ...]:
        """Return what the devices say they are."""
        return tuple(device.identity() for device in (self.camera, self.wheel, self.laser, self.lamp))


CLOSE_BEAM: Final = (
    "The laser is off. Close its beam with a cap or a shutter that no program moves, so that none of its light reaches "
    "the photodiode; do not cover the photodiode. Close the box: the laser will be lit. Is that done?"
)
OPEN_BEAM: Final = "The laser is off. Take the cap off, or open the shutter, and close the box again. Is that done?"


@contextmanager
def open_rig(rig: RigFile, folder: Path, operator: Operator | None = None) -> Iterator[OpenRig]:
    """Open the devices of a rig for a ``with`` block; lights are off and connections closed at its end.

    Parameters
    ----------
    rig
        The rig file's content.
    folder
        Where relative paths in the rig file start.
    operator
        Who places targets at a real rig; a person at the terminal when left out.

    Raises
    ------
    RefusedError
        A driver is not installed, or is not as a driver must be; no device was opened.
    CaptureError
        A device cannot be reached or is not what the rig file says.
    MissingExtraError
        A driver needs a package or program that is not installed.
    CurveError
        A curve file is missing or unusable, misses more than 20 % of a filter's band, or does not agree with the
        filter that names it.
    """
    response = camera_response(rig.camera.response, folder)
    lamp = lamp_curve(rig.lamp, folder)
    filter_curves = read_filter_curves(rig.filter_wheel.filters, folder)
    notes = coverage_notes(rig.filter_wheel.filters, filter_curves, (*response, lamp))
    if rig.is_simulated:
        yield _open_simulated(rig, folder, response, lamp, filter_curves, notes)
        return
    others = driver_notes(rig)

    def close_beam(closed: bool) -> bool:
        return hands.allows(CLOSE_BEAM if closed else OPEN_BEAM)

    hands, lease_s = operator or TerminalOperator(), 2.0 * rig.camera.longest_exposure_s + LEASE_S
    with ExitStack() as stack:
        laser = stack.enter_context(open_laser(rig.laser, lease_s))
        yield OpenRig(
            camera=stack.enter_context(open_camera(rig.camera, folder, rig.filter_wheel)),
            wheel=stack.enter_context(open_wheel(rig.filter_wheel, hands)),
            laser=laser,
            lamp=stack.enter_context(open_lamp(rig.lamp, hands)),
            operator=hands,
            clock=SystemClock(),
            camera_response=response,
            lamp_spectrum=lamp,
            filter_curves=filter_curves,
            notes=(*notes, *others, *laser.notes),
            close_beam=close_beam,
        )


def _open_simulated(
    rig: RigFile,
    folder: Path,
    response: tuple[SpectralCurve, SpectralCurve, SpectralCurve],
    lamp: SpectralCurve,
    filter_curves: Mapping[str, SpectralCurve],
    notes: tuple[str, ...],
) -> OpenRig:
    """Put the simulated devices over one bench."""
    # Imported here so that a rig of real devices never loads the simulation.
    from rigs.simulated import (
        Bench,
        BenchState,
        SimulatedCamera,
        SimulatedClock,
        SimulatedFilterWheel,
        SimulatedLight,
        SimulatedOperator,
        SimulatedPhotodiode,
    )

    seed = rig.simulated.seed if rig.simulated is not None else 0
    slots = tuple(sorted(optic.slot for optic in rig.filter_wheel.filters))
    clock = SimulatedClock()
    state = BenchState(clock=clock, slot=slots[0], laser_power_mw=rig.laser.power_mw)
    if rig.simulated is not None and rig.simulated.fault is not None:
        _practise(state, rig, rig.simulated.fault)
        notes = (*notes, f"the simulated rig has a fault to practise on: {rig.simulated.practice_fault}")
    bench, sensor = Bench(rig, folder, response, filter_curves), _simulated_sensor(rig.camera, seed)
    return OpenRig(
        camera=SimulatedCamera(bench, sensor, state, np.random.default_rng([seed, 2])),
        wheel=SimulatedFilterWheel(slots, state),
        laser=SimulatedLight("laser", state),
        lamp=SimulatedLight("lamp", state),
        operator=SimulatedOperator(state),
        clock=clock,
        camera_response=response,
        lamp_spectrum=lamp,
        filter_curves=filter_curves,
        notes=notes,
        practise=partial(_practise, state, rig),
        photodiode=lambda address: nullcontext(SimulatedPhotodiode(state)),
        close_beam=state.close_beam,
    )


def _practise(state: "BenchState", rig: RigFile, fault: PracticeFault | None) -> None:
    """Give the bench a fault to practise on, or take it away."""
    from rigs.simulated import BenchFault

    filters, camera = rig.filter_wheel.filters, rig.camera
    state.fault = fault and BenchFault(fault, filters, rig.lamp.temperature_k, camera.gain_e_per_dn)


def _simulated_sensor(camera: CameraSettings, seed: int) -> "Sensor":
    """Return a sensor with the numbers of the rig file, and assumed ones where it has none."""
    from rigs.simulated.sensor import Sensor

    return Sensor(
        bit_depth=camera.bit_depth,
        black_level_dn=camera.black_level_dn,
        gain_e_per_dn=camera.gain_e_per_dn,
        read_noise_e=camera.read_noise_e,
        dark_current_e_per_s=DARK_CURRENT_E_PER_S,
        full_well_e=FULL_WELL_MARGIN * 2**camera.bit_depth * camera.gain_e_per_dn,
        prnu_rel=PIXEL_NONUNIFORMITY_REL,
        dsnu_e=DARK_OFFSET_SD_E,
        seed=seed,
    )


T = TypeVar("T")


def open_rig_camera(rig: RigFile | TactileRig, folder: Path) -> AbstractContextManager[Camera]:
    """Return the camera, open for a ``with`` block; relative paths start in `folder`."""
    bench = rig if isinstance(rig, RigFile) else None
    return _alone(
        bench, folder, "camera", rig.camera, lambda: open_camera(rig.camera, folder), lambda opened: opened.camera
    )


def open_rig_wheel(rig: RigFile, folder: Path, operator: Operator) -> AbstractContextManager[FilterWheel]:
    """Return the filter wheel, open for a ``with`` block."""
    wheel = rig.filter_wheel
    return _alone(rig, folder, "filter wheel", wheel, lambda: open_wheel(wheel, operator), lambda opened: opened.wheel)


def open_rig_laser(rig: RigFile, folder: Path) -> AbstractContextManager[Light]:
    """Return the laser behind its guard, open for a ``with`` block; it is confirmed off before and after."""
    return _alone(rig, folder, "laser", rig.laser, lambda: open_laser(rig.laser), lambda opened: opened.laser)


def open_rig_lamp(rig: RigFile, folder: Path, operator: Operator) -> AbstractContextManager[Light]:
    """Return the lamp, open for a ``with`` block; it is confirmed off before and after."""
    return _alone(rig, folder, "lamp", rig.lamp, lambda: open_lamp(rig.lamp, operator), lambda opened: opened.lamp)


@contextmanager
def _alone(
    rig: RigFile | None,
    folder: Path,
    role: str,
    settings: Settings,
    opening: Callable[[], AbstractContextManager[T]],
    of_bench: Callable[[OpenRig], T],
) -> Iterator[T]:
    """Open a real device, or take it from the simulated bench."""
    if rig is not None and rig.is_simulated:
        with open_rig(rig, folder) as opened:
            yield of_bench(opened)
    else:
        with device_locked(role, settings.driver, settings.address), opening() as device:
            yield device


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


def inspect_rig(rig: RigFile, folder: Path) -> Iterator[PartReport]:
    """Report on laser, lamp, filter wheel, camera and curves, one after the other; an error of one hides no other.

    Lights come first: opening switches them off, so that the camera's frame is dark.

    Parameters
    ----------
    rig
        The rig file's content.
    folder
        Where relative paths in it start.
    """
    yield _device("laser", rig.laser, lambda: _laser(rig, folder))
    yield _device("lamp", rig.lamp, lambda: _lamp(rig, folder))
    yield _device("filter wheel", rig.filter_wheel, lambda: _wheel(rig, folder))
    yield _device("camera", rig.camera, lambda: _camera(open_rig_camera(rig, folder), rig.camera))
    yield _report("filters and curves", lambda: _curves(rig, folder))
    shared = _report("addresses", lambda: (key for key, _, _ in _keys_apart(rig)))
    if shared.error is not None:
        yield replace(shared, lines=())


def inspect_tactile_rig(rig: TactileRig, folder: Path) -> Iterator[PartReport]:
    """Report on the camera of a tactile rig, and on stage and load cell where it has them; nothing moves.

    Parameters
    ----------
    rig
        The rig file's content.
    folder
        Where relative paths in it start.
    """
    camera, stage, cell = rig.camera, rig.stage, rig.load_cell
    if not rig.is_simulated:
        yield _device("camera", camera, lambda: _camera(open_rig_camera(rig, folder), camera))
    if stage is not None:
        yield _device("stage", stage, lambda: _stage(rig, folder))
    if cell is not None:
        yield _device("load cell", cell, lambda: _cell(rig, folder))
        yield _report("calibration of the load cell", lambda: _calibration(rig, cell, folder))


def _calibration(rig: TactileRig, settings: LoadCellSettings, folder: Path) -> Lines:
    from rigs.capture import calibration_notes, read_cell_calibration  # which need an open rig themselves

    calibration = read_cell_calibration(settings, folder)
    yield str(calibration)
    yield from map(Warned, calibration_notes(rig, calibration))


def _stage(rig: TactileRig, folder: Path) -> Lines:
    from rigs.capture import open_tactile_rig

    with open_tactile_rig(rig, folder, only="stage") as opened:
        if opened.stage is not None and rig.stage is not None:
            says = opened.stage.identity()
            yield f"{says.model}{f', firmware {says.firmware}' if says.firmware else ''}"
            yield "its position is unknown until a session homes it"
            yield (
                f"the rig file states: axis {rig.stage.press_axis} presses the pad and is clear of it at "
                f"{rig.stage.clear_mm:g} mm; its travel is {rig.stage.press_travel_mm[0]:g} to "
                f"{rig.stage.press_travel_mm[1]:g} mm"
            )


def _cell(rig: TactileRig, folder: Path) -> Lines:
    from rigs.capture import open_tactile_rig

    with open_tactile_rig(rig, folder, only="load cell") as opened:
        if opened.load_cell is not None and rig.load_cell is not None:
            says = opened.load_cell.identity()
            yield f"{says.model}{f', firmware {says.firmware}' if says.firmware else ''}"
            counts = [opened.load_cell.read(rig.load_cell.silent_s).counts for _ in range(10)]
            yield f"ten readings: mean {np.mean(counts):.0f}, standard deviation {np.std(counts, ddof=1):.0f} counts"
            if min(counts) == max(counts):
                yield Warned(
                    "all ten readings have the same count, so the load cell is stuck; check amplifier and wiring"
                )


def _device(role: str, settings: Settings, look: Callable[[], Lines]) -> PartReport:
    """Collect what a device says, with what is wrong with the name of its port."""
    found = _report(device_title(role, settings), look)
    advice = port_advice(settings.address) if settings.address else ""
    return replace(found, warnings=(*found.warnings, advice)) if advice else found


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
    name = " ".join(part for part in (identity.vendor, identity.model) if part) or "does not identify itself"
    serial = f", serial {identity.serial}" if identity.serial else ""
    return f"{name}{serial}{f', firmware {identity.firmware}' if identity.firmware else ''}"


def _laser(rig: RigFile, folder: Path) -> Lines:
    laser = rig.laser
    with open_rig_laser(rig, folder) as light:
        yield from _light(light)
    yield f"the rig file states: {laser.wavelength_nm:g} nm, {laser.power_mw:g} mW, class {laser.laser_class}"


def _lamp(rig: RigFile, folder: Path) -> Lines:
    if rig.lamp.driver == "manual":
        yield "its state is unknown: it is switched by hand, and this command does not ask the operator"
        yield Warned("check that the lamp is off: finray cannot know whether the camera's frame below was dark")
        return
    with open_rig_lamp(rig, folder, TerminalOperator()) as light:
        yield from _light(light)


def _light(light: Light) -> Lines:
    yield _says(light.identity())
    if light.state():
        yield Warned("reports ON although it was switched off; check its controller")
    else:
        yield "reports off"
    if isinstance(light, GuardedLight):
        by_processes, by_hardware = off_lines(light.has_dead_man, light.outside_layer)
        yield by_processes
        yield by_hardware if light.has_dead_man else Warned(by_hardware)
        if light.refusal:
            yield Warned(f"cannot be lit: {light.refusal}")


def _wheel(rig: RigFile, folder: Path) -> Lines:
    with open_rig_wheel(rig, folder, TerminalOperator()) as wheel:
        yield _says(wheel.identity())
        names = {band.slot: band.name for band in rig.filter_wheel.filters}
        position = wheel.position()
        if position is None:
            yield "position unknown: the wheel moves, is out of the beam, or nobody has confirmed a position"
        elif not hasattr(position, "__index__"):
            yield Warned(f"its driver returns the position {position!r}, where the number of a slot or None is needed")
        else:
            yield f"at slot {position}, {f'filter {names[position]}' if position in names else 'which has no filter'}"
        yield "slots: " + ", ".join(f"{slot} {names.get(slot, '(none)')}" for slot in wheel.slots)
        if lost := sorted(set(names) - set(wheel.slots)):
            yield Warned(f"the wheel has no slot {lost[0]}, where the rig file puts filter {names[lost[0]]}")


def _camera(opening: AbstractContextManager[Camera], settings: CameraSettings) -> Lines:
    with opening as camera:
        yield _says(camera.identity())
        if settings.driver == "folder":
            yield "no frame was taken, because each image of a folder can be used only once"
            return
        exposure_s = min(max(DARK_EXPOSURE_S, settings.shortest_exposure_s), settings.longest_exposure_s)
        from rigs.capture import CAMERA_DEADLINE_MARGIN_S  # which needs an open rig itself

        frame = camera.expose(exposure_s, exposure_s + CAMERA_DEADLINE_MARGIN_S)
    counts = frame.counts
    yield f"{counts.shape[1]} x {counts.shape[0]} px; {exposure_s:g} s requested, {frame.exposure_s:g} s read back"
    yield (
        f"without light: {counts.min()} to {counts.max()} DN, median {np.median(counts):g} DN; the rig file "
        f"states a black level of {settings.black_level_dn:g} DN"
    )
    if frame.settings:
        yield "settings: " + ", ".join(f"{name} {value}" for name, value in sorted(frame.settings.items()))
    if counts.shape[:2] != (settings.height_px, settings.width_px):
        yield Warned(
            f"the rig file states {settings.width_px} x {settings.height_px} px; correct width_px and height_px"
        )
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
        yield Warned(
            "the camera's response is assumed; if you have a measured response, name its file in camera.response"
        )
    curves = read_filter_curves(rig.filter_wheel.filters, folder)
    response = camera_response(rig.camera.response, folder)
    yield from map(Warned, coverage_notes(rig.filter_wheel.filters, curves, (*response, lamp_curve(rig.lamp, folder))))
