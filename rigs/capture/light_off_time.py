"""How long the laser stays on after a mishap, for each of its safety layers.

Who sees whether it is on while its guard holds its connection is the camera, or a new connection. The victim of the
mishap is this module started as ``python -m rigs.capture.light_off_time DRIVER ADDRESS``: it keeps the laser on behind
its guard and says ``ON`` and the process numbers of guard and watch. It ends, and the laser goes off, when its standard
input closes (whoever started it is gone), at the latest after 10 s.
"""

import os
import select
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final, Literal, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from data_schemas import (
    BadFrameError,
    CaptureError,
    DiodeLevels,
    FinrayError,
    LaserSettings,
    LightLayer,
    LightOff,
    RigFile,
    TimedOutError,
    UnsafeError,
    Witness,
)
from rigs import Clock, LightSwitch, OpenRig, driver_module, find_driver, open_camera
from rigs.capture._exposure import CAMERA_DEADLINE_MARGIN_S, WHEEL_DEADLINE_S, shine
from rigs.capture._plan import Step
from rigs.light_guard import (
    MOST_LEVEL,
    GuardedLight,
    LightLevel,
    LightLostError,
    LightMeter,
    require_outside_layer,
)
from rigs.transports import LATENCY_S

LONGEST_SIGHT_S: Final = 0.05
"""Exposure of the frames that watch the laser: they resolve the time in which it goes off."""
LEAST_CONTRAST: Final = 0.05  # of full scale, between laser on and off
DARK_SHARE: Final = 0.1
"""Of the signal with the laser on: a frame below it was lit for less than a tenth of its exposure."""
CONTRAST_SD: Final = 10.0
CONTRAST_READINGS: Final = 50
"""Half a second of them: flicker of room light is in their scatter."""
CLOSED_SD: Final = 6.0
"""Standard deviations of a reading with the beam closed: by noise one is beyond once in 10^9."""
LEAST_STEPS: Final = 1.5
"""Of the converter: a level between two of them reads as either."""
DARK_IN_A_ROW: Final = 5
"""Readings that must be dark for the laser to be off: 50 ms, in which any pulsed light is lit."""
DIODE_SILENT_S: Final = 0.3
SEEING: Final[tuple[Witness, ...]] = ("the camera", "a photodiode")
SEEN_WITHIN_S: Final = 2.0
ASK_WITHIN_S: Final = 1.0
ASK_EVERY_S: Final = 0.02
OFF_WITHIN_S: Final = 5.0


class Reading(NamedTuple):
    """One look at the laser: when it began and ended by the monotonic clock, and whether the laser was on.

    `on` is None where nothing could be seen.
    """

    start_s: float
    end_s: float
    on: bool | None


class RegionFrames(Protocol):
    """Frames of the region that shows the laser."""

    def region_mean_dn(self, counts: NDArray[np.uint16]) -> float:
        """Return the mean count of the region (DN) of a frame's counts (H, W)."""
        ...

    def expose(self, step: Step, exposure_s: float) -> float:
        """Take a checked frame and return the region's mean count (DN)."""
        ...

    def meter(self, step: Step) -> float:
        """Return the exposure (s) at which the region is well exposed."""
        ...


class LaserWatch(Protocol):
    """Somebody who looks at the laser again and again."""

    @property
    def witness(self) -> Witness:
        """Who looks."""
        ...

    def look(self) -> Reading:
        """Look once."""
        ...


@dataclass(frozen=True, slots=True)
class Sight:
    """What the camera sees of the laser: mean counts (DN) with the laser off and on at one exposure (s)."""

    exposure_s: float
    off_dn: float
    on_dn: float


def find_sight(opened: OpenRig, rig: RigFile, frames: RegionFrames) -> Sight | None:
    """Look at the white tile with the laser on and off through the filter that passes it; None if both look alike.

    The wheel stays where the laser is seen.
    """
    laser_nm = rig.laser.wavelength_nm
    passing = [f for f in rig.filter_wheel.filters if abs(f.center_nm - laser_nm) <= 0.5 * f.fwhm_nm]
    if not passing:
        return None
    lit = Step("laser white", "white", "laser", passing[0].name, passing[0].slot)
    dark = Step("dark", "white", "off", passing[0].name, passing[0].slot)
    try:
        if opened.wheel.position() != lit.slot:  # in the dark: a wheel may be turned by hand
            opened.wheel.go_to(passing[0].slot, WHEEL_DEADLINE_S)
        with shine(opened, "laser"):
            exposure_s = min(frames.meter(lit), max(LONGEST_SIGHT_S, rig.camera.shortest_exposure_s))
            on_dn = frames.expose(lit, exposure_s)
        off_dn = frames.expose(dark, exposure_s)
    except (UnsafeError, LightLostError):
        raise
    except CaptureError:
        return None
    seen = on_dn - off_dn > LEAST_CONTRAST * (2**rig.camera.bit_depth - 1)
    return Sight(exposure_s, off_dn, on_dn) if seen else None


class CameraWatch:
    """The camera as the witness.

    Parameters
    ----------
    rig, folder
        The rig file and where its relative paths start.
    frames
        Know the region.
    sight
        What the laser looks like.
    """

    witness: Witness = "the camera"

    def __init__(self, rig: RigFile, folder: Path, frames: RegionFrames, sight: Sight) -> None:
        self._rig, self._folder, self._frames, self._sight = rig, folder, frames, sight

    @contextmanager
    def open(self) -> Iterator["CameraWatch"]:
        """Open the camera alone for a ``with`` block."""
        with open_camera(self._rig.camera, self._folder) as self._camera:
            self.look()  # a camera's first frame after opening may be an old one
            yield self

    def look(self) -> Reading:
        """Take a frame; it shows the laser on unless it was lit for less than a tenth of its exposure."""
        start_s = time.monotonic()
        exposure_s, off_dn, on_dn = self._sight.exposure_s, self._sight.off_dn, self._sight.on_dn
        try:
            raw = self._camera.expose(exposure_s, exposure_s + CAMERA_DEADLINE_MARGIN_S)
        except BadFrameError:
            return Reading(start_s, time.monotonic(), None)
        signal_dn = self._frames.region_mean_dn(raw.counts) - off_dn
        return Reading(start_s, time.monotonic(), signal_dn > DARK_SHARE * (on_dn - off_dn))


class ConnectionWatch:
    """A new connection to the laser's controller as the witness; one is made for every look.

    Parameters
    ----------
    laser
        Driver and address.
    quiet_s
        Pause before every look. A dead-man counts a question as a sign of life: it is asked seldom.
    """

    witness: Witness = "a new connection"

    def __init__(self, laser: LaserSettings, quiet_s: float = ASK_EVERY_S) -> None:
        self._laser, self._quiet_s = laser, quiet_s

    def look(self) -> Reading:
        """Ask the controller, if a connection is to be had.

        A dead-man that is asked while it counts starts anew: when the answer is "off", it was off at the first word
        of the connection, which is then the end of the look.
        """
        time.sleep(self._quiet_s)
        start_s = time.monotonic()
        try:
            with _open_switch(self._laser) as switch:
                on = bool(switch.state(ASK_WITHIN_S))
                answered_s = time.monotonic()
                asked_dead_man = bool(switch.has_dead_man) and self._quiet_s > ASK_EVERY_S
        except CaptureError:
            return Reading(start_s, time.monotonic(), None)
        return Reading(start_s, start_s if asked_dead_man and not on else answered_s, on)


@dataclass(frozen=True, slots=True)
class Contrast:
    """Levels that a photodiode read with the laser off and on, of its full scale, and with its beam closed by hand.

    Without the closed beam, nobody but the laser's controller says what dark is.
    """

    off_rel: float
    on_rel: float
    closed_rel: float | None = None
    closed_sd_rel: float = 0.0
    sees_pulses: bool = False

    @property
    def threshold_rel(self) -> float:
        """Below it the laser is off: so many standard deviations above the closed beam, or a tenth of the light."""
        if self.closed_rel is None:
            return self.off_rel + DARK_SHARE * (self.on_rel - self.off_rel)
        return self.closed_rel + max(CLOSED_SD * self.closed_sd_rel, LEAST_STEPS / MOST_LEVEL)

    def recorded(self) -> DiodeLevels:
        """Return what the facts of a check hold."""
        is_closed = self.closed_rel is not None
        return DiodeLevels(
            closed_rel=self.closed_rel,
            closed_sd_rel=self.closed_sd_rel if is_closed else None,
            off_rel=self.off_rel,
            on_rel=self.on_rel,
            threshold_rel=self.threshold_rel,
            readings=DARK_IN_A_ROW,
            sees_pulses=self.sees_pulses,
        )


def find_contrast(opened: OpenRig, diode: LightMeter) -> Contrast:
    """Read the photodiode with the laser off, on and off again, and with its beam closed by a person, on and off.

    A photodiode that is unplugged, covered or looks elsewhere is dark all the while: it has to see the light first. A
    laser that is only dimmed reads more than with its beam closed.

    Raises
    ------
    CaptureError
        It does not see the difference, is saturated, or reads light where there should be none.
    """
    before, lit, after = (_read_with(opened, diode, light) for light in ("off", "laser", "off"))
    off = np.concatenate([before, after])
    if lit.max() * MOST_LEVEL >= MOST_LEVEL:
        raise CaptureError(
            "photodiode: reads its full scale with the laser on, so it is saturated and no witness; take a smaller "
            "resistor, or move it away from the spot"
        )
    contrast = _with_closed_beam(
        opened, diode, Contrast(float(off.mean()), float(lit.mean()), sees_pulses=diode.sees_pulses)
    )
    scatter_rel = max(float(off.std()), float(lit.std()), 0.5 / MOST_LEVEL)
    rises_rel = contrast.on_rel - contrast.off_rel
    is_seen = rises_rel > max(LEAST_CONTRAST, CONTRAST_SD * scatter_rel) and contrast.threshold_rel < float(lit.min())
    if not is_seen or contrast.threshold_rel > contrast.off_rel + DARK_SHARE * rises_rel:
        raise CaptureError(
            "photodiode: does not see the difference between laser on and off, so it is no witness; point it at the "
            "spot, check its wires and cover it from room light"
        )
    if float(off.max()) >= contrast.threshold_rel:
        raise CaptureError(
            f"photodiode: reads {100 * off.max():.2g} % of its scale with the laser off, and less than "
            f"{100 * contrast.threshold_rel:.2g} % with its beam closed: the laser is not off but dimmed, or something "
            "else than its beam was covered; find out which before anybody opens the box"
        )
    return contrast


def _with_closed_beam(opened: OpenRig, diode: LightMeter, contrast: Contrast) -> Contrast:
    """Add what dark is, where a person closes the beam: with the laser off and on, so that it is seen to be closed."""
    if not opened.close_beam(True):
        return contrast
    closed_off = _read_with(opened, diode, "off")
    closed_on = _read_with(opened, diode, "laser")
    closed = np.concatenate([closed_off, closed_on])
    found = replace(
        contrast,
        closed_rel=float(closed_off.mean()),
        closed_sd_rel=max(float(part.std(ddof=1)) for part in (closed_off, closed_on)),
    )
    if float(closed.max()) >= found.threshold_rel:
        raise CaptureError(
            f"photodiode: reads up to {100 * closed.max():.2g} % of its scale with the beam closed, so the cap or "
            "shutter lets light of the laser through, or room light flickers; close the beam tightly, shade the "
            "photodiode, and check again"
        )
    if not opened.close_beam(False):
        raise CaptureError("laser: nobody has confirmed that its beam is open again; open it, and check again")
    return found


def _read_with(opened: OpenRig, diode: LightMeter, light: Literal["off", "laser"]) -> NDArray[np.float64]:
    """Return readings with the laser on, or with all lights off."""
    with shine(opened, light):
        return _levels(diode, opened.clock)


def _levels(diode: LightMeter, clock: Clock) -> NDArray[np.float64]:
    """Return some readings, of full scale, that were all made after this call began."""
    begun_s, found = clock.monotonic_s() + LATENCY_S, list[float]()
    while len(found) < CONTRAST_READINGS:
        reading = diode.read(DIODE_SILENT_S)
        if reading.at_s > begun_s:
            found.append(reading.level / MOST_LEVEL)
    return np.array(found)


class PhotodiodeWatch:
    """A photodiode as the witness: its readings come by themselves, and their times are those of its own clock.

    Parameters
    ----------
    diode
        The open photodiode.
    contrast
        What the laser looks like.
    """

    witness: Witness = "a photodiode"

    def __init__(self, diode: LightMeter, contrast: Contrast) -> None:
        self._diode, self._contrast = diode, contrast

    def look(self) -> Reading:
        """Return the next reading that is lit, or the first of some dark ones in a row.

        Where the photodiode fell silent, its error is raised.
        """
        readings = list[LightLevel]()
        while len(readings) < DARK_IN_A_ROW:
            readings.append(self._diode.read(DIODE_SILENT_S))
            if readings[-1].level > MOST_LEVEL * self._contrast.threshold_rel:
                return Reading(readings[-1].at_s - LATENCY_S, readings[-1].at_s, on=True)
        return Reading(readings[0].at_s - LATENCY_S, readings[0].at_s, on=False)


def require_seen(watch: LaserWatch, now_s: Callable[[], float] = time.monotonic) -> None:
    """Refuse a witness of the light that does not see it while it is on; a controller that is asked sees nothing.

    Raises
    ------
    CaptureError
        It says "off", or nothing.
    """
    if watch.witness not in SEEING:
        return
    begun_s = now_s()
    while now_s() - begun_s < SEEN_WITHIN_S:
        reading = watch.look()
        if reading.start_s > begun_s and reading.on:
            return
    raise CaptureError(
        f'laser: is on, and {watch.witness} does not see it (any more), so it is no witness of "off"; check what it '
        "looks at, and its cable"
    )


def can_be_asked_anew(laser: LaserSettings) -> bool:
    """Whether a second connection tells the state without changing it: opening a serial port resets most boards."""
    return laser.driver in ("indi", "alpaca") or laser.address.startswith("socket://")


def _open_switch(laser: LaserSettings) -> AbstractContextManager[LightSwitch]:
    """Return the laser's switch over a connection of its own, without a guard, for a ``with`` block."""
    switch: AbstractContextManager[LightSwitch]
    switch = driver_module(find_driver("light", laser.driver)).open_switch(laser.address, "laser", None)
    return switch


def make_off(laser: LaserSettings) -> None:
    """Switch the laser off over a connection of our own, trying for some seconds.

    Raises
    ------
    UnsafeError
        It is not confirmed off.
    """
    end_s = time.monotonic() + OFF_WITHIN_S
    while True:
        try:
            with _open_switch(laser) as switch:
                switch.switch(False, ASK_WITHIN_S)
                return
        except CaptureError as error:
            if time.monotonic() > end_s:
                raise UnsafeError(
                    f"laser at {laser.address}: NOT CONFIRMED OFF after its safety layers were tried; pull "
                    f"its plug before anyone opens the box. The cause: {error}"
                ) from error
        time.sleep(ASK_EVERY_S)


WATCHED_S: Final = 5.0
"""A layer that takes longer has failed."""
START_WITHIN_S: Final = 40.0


class MishapError(Exception):
    """Stands for whatever may go wrong while the laser is on."""


class Holder(NamedTuple):
    """A program that holds the laser on, and the guard and the watch of its laser."""

    process: "subprocess.Popen[str]"
    guard_pid: int
    watch_pid: int


def after_exception(opened: OpenRig, repeats: int, watch: LaserWatch | None = None) -> LightOff:
    """Raise an exception in the block that lights the laser; ask the controller when the block is left.

    A watch that sees the light is asked too, where there is one: it must see the laser on before, and off after.

    Raises
    ------
    LightLostError
        The laser does not go on, or went off by itself.
    UnsafeError
        It is not confirmed off.
    """
    earliest_s, latest_s, still_on = list[float](), list[float](), 0
    for _ in range(repeats):
        start_s = opened.clock.monotonic_s()
        try:
            with opened.laser.lit():
                if not opened.laser.state():
                    raise LightLostError("laser: reads back off in the block that lights it; check interlock and key")
                if watch is not None:
                    require_seen(watch, opened.clock.monotonic_s)
                start_s = opened.clock.monotonic_s()
                raise MishapError
        except MishapError:
            is_on = opened.laser.state()
        asked_s = opened.clock.monotonic_s() - start_s
        earliest, latest = (0.0, asked_s) if watch is None else _watch(watch, start_s, opened.clock.monotonic_s)
        if is_on or latest is None:
            still_on += 1
        else:
            earliest_s.append(earliest)
            latest_s.append(latest)
    if watch is not None:  # one that went blind in the last mishap has seen it go off, too
        with opened.laser.lit():
            require_seen(watch, opened.clock.monotonic_s)
    return LightOff(
        layer="block",
        witness="its own connection" if watch is None else watch.witness,
        earliest_s=tuple(earliest_s),
        latest_s=tuple(latest_s),
        still_on=still_on,
    )


def after_kill(laser: LaserSettings, layer: LightLayer, watch: LaserWatch, repeats: int) -> LightOff:
    """Kill who holds the laser (layer "guard"), or all three processes ("dead-man"), and watch; off in any case then.

    Nothing else may have the laser open.

    Raises
    ------
    CaptureError
        The laser does not go on, or must not, or the witness fails.
    UnsafeError
        The laser is not confirmed off in the end.
    """
    require_outside_layer(laser)
    earliest_s: list[float] = []
    latest_s: list[float] = []
    for _ in range(repeats):
        for _ in range(_MOST_TRIES):
            try:
                with _holding(laser) as holder:
                    require_seen(watch)
                    killed_s = time.monotonic()
                    at_once = _kill(holder, layer)
                    earliest, latest = _watch(watch, killed_s)
            finally:
                make_off(laser)
            if at_once:
                break
        else:
            raise CaptureError(
                f"laser at {laser.address}: its three processes could not be stopped within {1e3 * _AT_ONCE_S:g} ms of "
                f"each other in {_MOST_TRIES} tries, so one of them may switch off before the dead-man does; close "
                f"other programs and run the check again"
            )
        if latest is not None:
            earliest_s.append(earliest)
            latest_s.append(latest)
    if watch.witness in SEEING:  # one that went blind in the last mishap has seen it go off, too
        try:
            with _holding(laser):
                require_seen(watch)
        finally:
            make_off(laser)
    return LightOff(
        layer=layer,
        witness=watch.witness,
        earliest_s=tuple(earliest_s),
        latest_s=tuple(latest_s),
        still_on=repeats - len(latest_s),
        watched_s=WATCHED_S,
    )


_AT_ONCE_S = 1e-4
"""One of them that runs in between needs about as long to see that another was stopped and to say "off"."""
_MOST_TRIES = 5


def _kill(holder: Holder, layer: LightLayer) -> bool:
    """Kill the holder; for the dead-man all three, stopped first so that none can switch off in another's place.

    Return whether they were stopped so close to each other that none could.

    Raises
    ------
    CaptureError
        One of them had ended by itself.
    """
    pids = (holder.watch_pid, holder.guard_pid, holder.process.pid)
    if layer == "guard":
        holder.process.kill()
        return True
    try:
        with _on_one_core(pids):
            began_s = time.monotonic()
            for pid in pids:
                os.kill(pid, signal.SIGSTOP)
            stopped_s = time.monotonic()
            for pid in pids:
                os.kill(pid, signal.SIGKILL)
    except ProcessLookupError:
        raise CaptureError("laser: its guard or watch ended by itself before it was killed; find out why") from None
    return stopped_s - began_s < _AT_ONCE_S


@contextmanager
def _on_one_core(pids: Sequence[int]) -> Iterator[None]:
    """Keep the processes on one core with this one for a ``with`` block, so that none runs while this one does.

    Where the system does not let us, only the time that stopping them takes tells.
    """
    if not hasattr(os, "sched_setaffinity"):
        yield
        return
    ours = os.sched_getaffinity(0)
    try:
        for pid in (*pids, 0):
            try:
                os.sched_setaffinity(pid, {min(ours)})
            except ProcessLookupError:
                raise
            except OSError:
                continue
        time.sleep(ASK_EVERY_S)  # whoever has rested is not interrupted at once
        yield
    finally:
        os.sched_setaffinity(0, ours)


def _watch(
    watch: LaserWatch, killed_s: float, now_s: Callable[[], float] = time.monotonic
) -> tuple[float, float | None]:
    """Return between which times after the kill (s) the laser went off; no latest one when it did not."""
    earliest_s = 0.0
    while now_s() - killed_s < WATCHED_S:
        reading = watch.look()
        if reading.on is False:
            return earliest_s, max(reading.end_s - killed_s, earliest_s)
        if reading.on:
            earliest_s = max(reading.start_s - killed_s, 0.0)
    return earliest_s, None


@contextmanager
def _holding(laser: LaserSettings) -> Iterator[Holder]:
    """Run a program of its own that holds the laser on for a ``with`` block."""
    process = subprocess.Popen(
        [sys.executable, "-P", "-m", "rigs.capture.light_off_time", laser.driver, laser.address],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    with process:
        try:
            said = _first_line(process)
            if not said.startswith("ON "):
                raise CaptureError(
                    f"laser: the program that should keep it on answered: {said or 'nothing, and ended'}"
                )
            guard_pid, watch_pid = map(int, said.split()[1:])
            yield Holder(process, guard_pid, watch_pid)
        finally:
            process.kill()


def _first_line(process: "subprocess.Popen[str]") -> str:
    """Return the first line that the program says."""
    if process.stdout is None or not select.select([process.stdout], [], [], START_WITHIN_S)[0]:
        raise TimedOutError(f"laser: the program that should keep it on did not answer within {START_WITHIN_S:g} s")
    return process.stdout.readline().strip()


LONGEST_S: Final = 10.0


def main(arguments: list[str]) -> int:
    """Hold the laser that the arguments name."""
    driver, address = arguments
    try:
        light = GuardedLight("laser", driver, address)
        try:
            light.open()
            with light.lit():
                sys.stdout.write(f"ON {light.guard_pid} {light.watch_pid}\n")
                sys.stdout.flush()
                select.select([sys.stdin], [], [], LONGEST_S)
        finally:
            light.close()
    except FinrayError as error:
        sys.stdout.write(f"{' '.join(str(error).split())}\n")
        sys.stdout.flush()
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
