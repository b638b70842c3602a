"""Who sees whether the laser is on: the camera, or a photodiode; and what each of them takes for dark.

"Off" is a reading that cannot be told from dark, by the noise of the witness. What dark is must not rest on the word of
the laser's controller: for the photodiode a person closes the beam, for the camera a filter blocks it. How much light
may stay unseen follows from these levels.
"""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final, Literal, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from data_schemas import (
    BadFrameError,
    BandPassFilter,
    CaptureError,
    DiodeLevels,
    RigFile,
    SightLevels,
    UnsafeError,
    Witness,
)
from rigs import Clock, OpenRig, open_camera
from rigs.capture._check_light import BLOCKED_WIDTHS
from rigs.capture._exposure import CAMERA_DEADLINE_MARGIN_S, WHEEL_DEADLINE_S, shine
from rigs.capture._plan import Step
from rigs.light_guard import MOST_LEVEL, LightLevel, LightLostError, LightMeter
from rigs.transports import LATENCY_S

LONGEST_SIGHT_S: Final = 0.05
"""Exposure of the frames that watch the laser: they resolve the time in which it goes off."""
LEAST_CONTRAST: Final = 0.05  # of full scale, between laser on and off
MOST_SHARE: Final = 0.1
"""Of the signal with the laser on: a witness that cannot tell so much light from dark is none."""
OFF_FRAMES: Final = 6
LEAST_ABOVE_DN: Final = 0.5
LEAST_ABOVE_SHARE: Final = 2e-4
"""Of full scale: by so much a camera's dark level may wander within the check."""
CONTRAST_SD: Final = 10.0
CONTRAST_READINGS: Final = 50
"""Half a second of them: flicker of room light is in their scatter."""
NOISE_SD: Final = 6.0
"""Standard deviations of a dark reading: by noise one is beyond once in 10^9."""
LEAST_STEPS: Final = 1.5
"""Of the converter: a level between two of them reads as either."""
DARK_IN_A_ROW: Final = 5
"""Readings that must be dark for the laser to be off: 50 ms, in which any pulsed light is lit."""
DIODE_SILENT_S: Final = 0.3
SEEING: Final[tuple[Witness, ...]] = ("the camera", "a photodiode")
SEEN_WITHIN_S: Final = 2.0


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


def find_sight(opened: OpenRig, rig: RigFile, frames: RegionFrames) -> SightLevels | None:
    """Look at the white tile with the laser on and off through the filter that passes it; None if both look alike.

    Behind a filter that blocks the laser it is looked at too: that is dark, whatever the laser's controller says. The
    wheel is left where the laser is seen.
    """
    laser_nm = rig.laser.wavelength_nm
    filters = rig.filter_wheel.filters
    passing = [f for f in filters if abs(f.center_nm - laser_nm) <= 0.5 * f.fwhm_nm]
    blocking = [f for f in filters if abs(f.center_nm - laser_nm) > BLOCKED_WIDTHS * f.fwhm_nm]
    if not passing:
        return None
    try:
        _turn_in_the_dark(opened, passing[0])
        with shine(opened, "laser"):
            exposure_s = min(frames.meter(_lit(passing[0])), max(LONGEST_SIGHT_S, rig.camera.shortest_exposure_s))
            on_dn = frames.expose(_lit(passing[0]), exposure_s)
        blocked = min(blocking, key=lambda f: abs(f.center_nm - laser_nm)) if blocking else None
        blocked_dn = None if blocked is None else _blocked_levels(opened, blocked, frames, exposure_s)
        _turn_in_the_dark(opened, passing[0])
        off = _darks(frames, passing[0], exposure_s)
    except (UnsafeError, LightLostError):
        raise
    except CaptureError:
        return None
    full_scale_dn = 2**rig.camera.bit_depth - 1
    above_dn = max(NOISE_SD * float(off.std(ddof=1)), LEAST_ABOVE_DN, LEAST_ABOVE_SHARE * full_scale_dn)
    rises_dn = on_dn - float(off.mean())
    if rises_dn <= LEAST_CONTRAST * full_scale_dn or above_dn > MOST_SHARE * rises_dn:
        return None
    return SightLevels(
        exposure_s=exposure_s,
        on_dn=on_dn,
        off_dn=float(off.mean()),
        off_sd_dn=float(off.std(ddof=1)),
        blocked_filter=None if blocked is None else blocked.name,
        blocked_on_dn=None if blocked_dn is None else blocked_dn[0],
        blocked_off_dn=None if blocked_dn is None else blocked_dn[1],
        threshold_dn=float(off.mean()) + above_dn,
    )


def _lit(band: BandPassFilter) -> Step:
    """Return the white tile under the laser behind a filter."""
    return Step("laser white", "white", "laser", band.name, band.slot)


def _darks(frames: RegionFrames, band: BandPassFilter, exposure_s: float) -> NDArray[np.float64]:
    """Return the levels of some frames behind a filter with all lights off (DN)."""
    dark = Step("dark", "white", "off", band.name, band.slot)
    return np.array([frames.expose(dark, exposure_s) for _ in range(OFF_FRAMES)])


def _turn_in_the_dark(opened: OpenRig, band: BandPassFilter) -> None:
    """Put a filter in the beam before a light is on: a wheel may be turned by hand."""
    if opened.wheel.position() != band.slot:
        opened.wheel.go_to(band.slot, WHEEL_DEADLINE_S)


def _blocked_levels(
    opened: OpenRig, band: BandPassFilter, frames: RegionFrames, exposure_s: float
) -> tuple[float, float]:
    """Return the level behind a filter that blocks the laser, with the laser on and off (DN)."""
    _turn_in_the_dark(opened, band)
    with shine(opened, "laser"):
        on_dn = frames.expose(_lit(band), exposure_s)
    return on_dn, float(_darks(frames, band, exposure_s).mean())


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

    def __init__(self, rig: RigFile, folder: Path, frames: RegionFrames, sight: SightLevels) -> None:
        self._rig, self._folder, self._frames, self._sight = rig, folder, frames, sight

    @contextmanager
    def open(self) -> Iterator["CameraWatch"]:
        """Open the camera alone for a ``with`` block."""
        with open_camera(self._rig.camera, self._folder) as self._camera:
            self.look()  # a camera's first frame after opening may be an old one
            yield self

    def look(self) -> Reading:
        """Take a frame; it shows the laser on unless it cannot be told from dark."""
        start_s, exposure_s = time.monotonic(), self._sight.exposure_s
        try:
            raw = self._camera.expose(exposure_s, exposure_s + CAMERA_DEADLINE_MARGIN_S)
        except BadFrameError:
            return Reading(start_s, time.monotonic(), None)
        is_on = self._frames.region_mean_dn(raw.counts) > self._sight.threshold_dn
        return Reading(start_s, time.monotonic(), is_on)


@dataclass(frozen=True, slots=True)
class Contrast:
    """Levels that a photodiode read with the laser off and on, of its full scale, and with its beam closed by hand.

    Without the closed beam, nobody but the laser's controller says what dark is.
    """

    off_rel: float
    on_rel: float
    off_sd_rel: float = 0.0
    closed_rel: float | None = None
    closed_sd_rel: float = 0.0
    on_again_rel: float | None = None
    reported_lit_closed: bool = False
    sees_pulses: bool = False

    @property
    def threshold_rel(self) -> float:
        """Below it the laser is off: so many standard deviations above the closed beam, else above the laser's off."""
        dark_rel, sd_rel = self.off_rel, self.off_sd_rel
        if self.closed_rel is not None:
            dark_rel, sd_rel = self.closed_rel, self.closed_sd_rel
        return dark_rel + max(NOISE_SD * sd_rel, LEAST_STEPS / MOST_LEVEL)

    def recorded(self) -> DiodeLevels:
        """Return what the facts of a check hold."""
        is_closed = self.closed_rel is not None
        return DiodeLevels(
            closed_rel=self.closed_rel,
            closed_sd_rel=self.closed_sd_rel if is_closed else None,
            off_rel=self.off_rel,
            off_sd_rel=self.off_sd_rel,
            on_rel=self.on_rel,
            threshold_rel=self.threshold_rel,
            readings=DARK_IN_A_ROW,
            on_again_rel=self.on_again_rel,
            reported_lit_closed=self.reported_lit_closed,
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
    seen = Contrast(float(off.mean()), float(lit.mean()), float(off.std(ddof=1)), sees_pulses=diode.sees_pulses)
    contrast = _with_closed_beam(opened, diode, seen)
    scatter_rel = max(float(off.std()), float(lit.std()), 0.5 / MOST_LEVEL)
    rises_rel = contrast.on_rel - contrast.off_rel
    is_seen = rises_rel > max(LEAST_CONTRAST, CONTRAST_SD * scatter_rel) and contrast.threshold_rel < float(lit.min())
    if not is_seen or contrast.threshold_rel > contrast.off_rel + MOST_SHARE * rises_rel:
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
    """Add what dark is, where a person closes the beam: with the laser off and on, so that it is seen to be closed.

    A laser that went out meanwhile would prove no closed beam: its controller is asked before and after the readings,
    and its light is looked at once more when the beam is open again.
    """
    if not opened.close_beam(True):
        return contrast
    closed_off = _read_with(opened, diode, "off")
    with shine(opened, "laser"):
        was_lit = opened.laser.state()
        closed_on = _levels(diode, opened.clock)
        is_lit = opened.laser.state()
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
    again = _read_with(opened, diode, "laser")
    return replace(found, on_again_rel=float(again.mean()), reported_lit_closed=was_lit and is_lit)


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
