"""What an acceptance check records of light: warm-up, stray light, trigger latency; and who sees that the laser is off.

The light is on inside a ``with`` block only, in the thread that holds it, so that it goes off however a measurement
ends; the exposure in which a light is switched on runs in a thread of its own and is waited for.

"Off" is a reading that cannot be told from dark, by the noise of the witness. What dark is must not rest on the word of
the laser's controller: for the photodiode a person closes the beam, for the camera a filter blocks it. How much light
may stay unseen follows from these levels.
"""

import math
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final, Literal, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from data_schemas import (
    BadFrameError,
    BandPassFilter,
    BlockedLight,
    CaptureError,
    CheckPlan,
    DiodeLevels,
    ExposureLevel,
    LatencyTry,
    RigFile,
    SightLevels,
    StrayLight,
    TimedOutError,
    TriggerLatency,
    UnsafeError,
    WarmUp,
    Witness,
)
from rigs import CallThread, Clock, OpenRig, RawFrame, open_camera
from rigs.capture._exposure import CAMERA_DEADLINE_MARGIN_S, CAMERA_EXPOSURES, WHEEL_DEADLINE_S, shine
from rigs.capture._plan import Step
from rigs.light_guard import FULL_SCALE_LEVEL, LightLevel, LightLostError, LightMeter
from rigs.transports import LATENCY_S

LEAST_SIGNAL_FRACTION: Final = 0.05
"""Of full scale, mean of the region: below it, noise decides."""
WARM_UP_LOOKS: Final = 40
"""White frames over the time that the lamp is watched: they resolve a fortieth of it."""
LEVEL_FRAMES: Final = 6
"""With and without light: few frames more would make the uncertainty of a mean only a little smaller."""
BLOCKED_WIDTHS: Final = 2.0
"""Widths (FWHM) between a filter's centre and the laser, from which the filter counts as one that blocks it."""
WINDOW: Final = (0.1, 0.9)
"""Lit share of an exposure between which it tells when it began."""
STEP_SHARE: Final = 0.7
"""Of the exposure, between two tries of which neither saw the light go on: less than the window."""
MOST_TRIES: Final = 3
"""For one that sees the light go on."""


class SteppedFrames(Protocol):
    """Takes the checked frames of a check, reduced to its region."""

    def white_step(self, band: BandPassFilter) -> Step:
        """Return the white tile under the lamp behind a filter."""
        ...

    def meter(self, step: Step) -> float:
        """Return the exposure (s) at which the region is well exposed."""
        ...

    def expose(self, step: Step, exposure_s: float) -> float:
        """Take a checked frame and return the region's mean count (DN)."""
        ...

    def region_mean_dn(self, counts: NDArray[np.uint16]) -> float:
        """Return the mean count of the region (DN) of a frame's counts (H, W)."""
        ...


def watch_warm_up(
    opened: OpenRig, rig: RigFile, plan: CheckPlan, frames: SteppedFrames, band: BandPassFilter
) -> WarmUp | None:
    """Watch the white tile from the moment the lamp is on, and the dark level before and after; None if not asked for.

    Metering comes after the first seconds of a lamp, so the exposure is found in a moment of light, and the lamp is
    off again for the dark frames: what it has warmed up by then is missing.
    """
    if plan.warm_up_s == 0.0:
        return None
    opened.operator.place("white")
    clock, white = opened.clock, frames.white_step(band)
    dark = replace(white, frame_type="dark", light="off")
    with shine(opened, "lamp"):
        exposure_s = frames.meter(white)

    def darks() -> tuple[float, ...]:
        return tuple(frames.expose(dark, exposure_s) for _ in range(LEVEL_FRAMES))

    before, times_s, values = darks(), [], []
    with shine(opened, "lamp"):
        began_s = clock.monotonic_s()
        step_s, look = plan.warm_up_s / (WARM_UP_LOOKS - 1), 0
        while look < WARM_UP_LOOKS:
            clock.sleep(max(began_s + look * step_s - clock.monotonic_s(), 0.0))
            asked_s = clock.monotonic_s()
            values.append(frames.expose(white, exposure_s) - rig.camera.black_level_dn)
            times_s.append(0.5 * (asked_s + clock.monotonic_s()) - began_s)
            # long exposures leave out the looks that they are late for
            look = max(look + 1, math.ceil((clock.monotonic_s() - began_s) / step_s))
    return WarmUp(
        filter_name=band.name,
        times_s=tuple(times_s),
        white_dn=tuple(values),
        dark_before_dn=before,
        dark_after_dn=darks(),
    )


def stray_light(
    opened: OpenRig, rig: RigFile, plan: CheckPlan, frames: SteppedFrames, filters: Sequence[BandPassFilter]
) -> StrayLight:
    """Look at the white tile under the laser behind the filter that passes it and all that block it."""
    laser_nm = rig.laser.wavelength_nm
    passing = [band for band in filters if abs(band.center_nm - laser_nm) <= 0.5 * band.fwhm_nm]
    blocking = [band for band in filters if abs(band.center_nm - laser_nm) > BLOCKED_WIDTHS * band.fwhm_nm]
    if not passing or not blocking:
        lacks = "passes" if not passing else "blocks"
        return StrayLight(missing=f"no filter of this check {lacks} the laser at {laser_nm:g} nm")
    opened.operator.place("white")
    lit = replace(frames.white_step(passing[0]), frame_type="laser white", light="laser")
    _turn_in_the_dark(opened, passing[0])
    with shine(opened, "laser"):
        metered_s = frames.meter(lit)
    # light at the limit must not saturate
    longest_s = min(plan.longest_dark_s, rig.camera.longest_exposure_s, metered_s / plan.limits.stray_light_rel)

    def level(band: BandPassFilter, exposure_s: float) -> BlockedLight:
        step = replace(lit, filter_name=band.name, slot=band.slot)
        dark = replace(step, frame_type="dark", light="off")
        _turn_in_the_dark(opened, band)
        with shine(opened, "laser"):
            white_dn = tuple(frames.expose(step, exposure_s) for _ in range(LEVEL_FRAMES))
        dark_dn = tuple(frames.expose(dark, exposure_s) for _ in range(LEVEL_FRAMES))
        return BlockedLight(
            filter_name=band.name, level=ExposureLevel(exposure_s=exposure_s, white_dn=white_dn, dark_dn=dark_dn)
        )

    passed = level(passing[0], metered_s)
    return StrayLight(passed=passed, blocked=tuple(level(band, max(longest_s, metered_s)) for band in blocking))


def trigger_latency(
    opened: OpenRig, rig: RigFile, plan: CheckPlan, frames: SteppedFrames, band: BandPassFilter
) -> TriggerLatency:
    """Switch the lamp on in the middle of exposures, and note how much of it each has seen.

    Parameters
    ----------
    band
        The filter behind which the lamp needs the longest exposure, so that switching takes little of it.
    """
    if (missing := _why_not(rig, plan)) is not None:
        return TriggerLatency(missing=missing)
    opened.operator.place("white")
    step = frames.white_step(band)
    with shine(opened, "lamp"):
        exposure_s = frames.meter(step)
        full = [frames.expose(step, exposure_s) for _ in range(LEVEL_FRAMES)]
    dark = replace(step, frame_type="dark", light="off")
    dark_dn = float(np.mean([frames.expose(dark, exposure_s) for _ in range(LEVEL_FRAMES)]))
    signal_dn, share_sd = float(np.mean(full)) - dark_dn, float(np.std(full, ddof=1))
    require_white(signal_dn, rig, band)

    def seen(raw: RawFrame) -> float:
        return (frames.region_mean_dn(raw.counts) - dark_dn) / signal_dn

    tries: list[LatencyTry] = []
    delay_s = 0.5 * exposure_s
    while sum(WINDOW[0] < one.lit_share < WINDOW[1] for one in tries) < plan.latency_tries > len(tries) / MOST_TRIES:
        earliest_s, latest_s, raw = _switched_on_within(opened, exposure_s, delay_s)
        tries.append(
            LatencyTry(
                on_earliest_s=earliest_s,
                on_latest_s=latest_s,
                lit_share=seen(raw),
                lit_share_sd=share_sd / signal_dn,
            )
        )
        # lit all the while: the exposure began later than thought; not at all: it ended before
        if tries[-1].lit_share > WINDOW[1]:
            delay_s += STEP_SHARE * exposure_s
        elif tries[-1].lit_share < WINDOW[0]:
            delay_s = max(delay_s - STEP_SHARE * exposure_s, 0.0)
    return TriggerLatency(exposure_s=exposure_s, tries=tuple(tries))


def require_white(signal_dn: float, rig: RigFile, band: BandPassFilter) -> None:
    """Refuse a white tile that is too dark for its light to be measured.

    Raises
    ------
    CaptureError
        The mean of the region is below a twentieth of full scale.
    """
    least_dn = LEAST_SIGNAL_FRACTION * (2**rig.camera.bit_depth - 1)
    if signal_dn < least_dn:
        raise CaptureError(
            f"camera: the white tile gives only {signal_dn:.3g} DN through filter {band.name}, but at least "
            f"{least_dn:.3g} DN are needed; check lamp, tile and lens cap"
        )


class CameraInUseError(CaptureError):
    """An exposure has not ended after its deadline: nobody else may ask the camera for anything."""


def _why_not(rig: RigFile, plan: CheckPlan) -> str | None:
    """Return why no light can be switched on in the middle of an exposure."""
    if rig.is_simulated:
        return "not possible on a simulated rig, because no light can be switched while a simulated exposure runs"
    if rig.lamp.driver == "manual":
        return "not possible on this rig, because its lamp is switched by hand; use a lamp or LED that finray switches"
    return "the plan states 0 tries (latency_tries)" if plan.latency_tries == 0 else None


def _switched_on_within(opened: OpenRig, exposure_s: float, delay_s: float) -> tuple[float, float, RawFrame]:
    """Request an exposure, switch the lamp on after a delay, and return when it went on (s after the request).

    Raises
    ------
    CaptureError
        The camera or the lamp failed; the lamp is off.
    CameraInUseError
        The exposure has not ended in time; the lamp is off.
    """
    limit_s = CAMERA_EXPOSURES * exposure_s + CAMERA_DEADLINE_MARGIN_S
    requested: list[float] = []

    def expose() -> RawFrame:
        requested.append(time.monotonic())
        return opened.camera.expose(exposure_s, limit_s)

    thread = CallThread("exposure of a latency")
    try:
        answer = thread.post(expose)
        while not requested:
            time.sleep(0.0005)
        time.sleep(max(requested[0] + delay_s - time.monotonic(), 0.0))
        told_s = time.monotonic()
        with opened.lamp.lit():
            confirmed_s = time.monotonic()
            raw = _answered(answer, limit_s)
    finally:
        # the camera is free again before anybody else asks it for anything
        ended: list[bool] = []
        thread.close(lambda: ended.append(True), limit_s)
        if not ended and not isinstance(sys.exception(), UnsafeError):
            raise CameraInUseError(
                f"camera: an exposure of {exposure_s:g} s has not ended {2 * limit_s:g} s after its request, so the "
                f"check ends; switch the camera off and on, then check its cable and driver"
            )
    return told_s - requested[0], confirmed_s - requested[0], raw


def _answered(answer: Future[RawFrame], limit_s: float) -> RawFrame:
    """Return the frame of an exposure that runs in a thread, or raise what it raised."""
    try:
        return answer.result(limit_s)
    except TimeoutError:
        if answer.done():  # by the camera's own time-out, or just after this one
            return answer.result()
        raise TimedOutError(f"camera: has not delivered its frame within {limit_s:g} s; check its cable") from None


LONGEST_SIGHT_S: Final = 0.05
"""Exposure of the frames that watch the laser: they resolve the time in which it goes off."""
LEAST_CONTRAST: Final = 0.05  # of full scale, between laser on and off
MOST_SHARE: Final = 0.1
"""Of the signal with the laser on: an instrument that cannot tell so much light from dark confirms nothing."""
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
MOST_OTHER_SHARE: Final = 0.2
"""Of the laser's level before the filter that blocks it: more is another filter, or another laser."""
DARK_SPAN_S: Final = 0.05
"""Frames in the dark must span it: a shorter one may lie between two pulses."""
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
        if blocked is not None and not _is_back(opened, passing[0], frames, exposure_s, on_dn):
            return None
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


def _is_back(opened: OpenRig, band: BandPassFilter, frames: RegionFrames, exposure_s: float, on_dn: float) -> bool:
    """Return whether the laser looks as before when its filter is back: a wheel may have stayed where it was."""
    with shine(opened, "laser"):
        return abs(frames.expose(_lit(band), exposure_s) - on_dn) <= MOST_OTHER_SHARE * on_dn


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
        """Return the next frame, or the first of some dark ones in a row; one shows the laser on unless it is dark."""
        first = self._frame()
        return self._first_of_dark(first) if first.on is False else first

    def _frame(self) -> Reading:
        """Take a frame; it shows the laser on unless it cannot be told from dark."""
        start_s, exposure_s = time.monotonic(), self._sight.exposure_s
        try:
            raw = self._camera.expose(exposure_s, exposure_s + CAMERA_DEADLINE_MARGIN_S)
        except BadFrameError:
            return Reading(start_s, time.monotonic(), None)
        is_on = self._frames.region_mean_dn(raw.counts) > self._sight.threshold_dn
        return Reading(start_s, time.monotonic(), is_on)

    def _first_of_dark(self, first: Reading) -> Reading:
        """Return the next frame that is lit or refused, or the first of some dark ones that span a while."""
        dark, last = 1, first
        while dark < DARK_IN_A_ROW or last.end_s - first.start_s < DARK_SPAN_S:
            last = self._frame()
            if last.on is not False:
                return last
            dark += 1
        return first


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
        return dark_rel + max(NOISE_SD * sd_rel, LEAST_STEPS / FULL_SCALE_LEVEL)

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
    if lit.max() >= 1.0:
        raise CaptureError(
            "photodiode: reads its full scale with the laser on, so it is saturated and cannot show whether the "
            "laser is off; take a smaller resistor, or move the photodiode away from the spot"
        )
    seen = Contrast(float(off.mean()), float(lit.mean()), float(off.std(ddof=1)), sees_pulses=diode.sees_pulses)
    contrast = _with_closed_beam(opened, diode, seen)
    scatter_rel = max(float(off.std()), float(lit.std()), 0.5 / FULL_SCALE_LEVEL)
    rises_rel = contrast.on_rel - contrast.off_rel
    is_seen = rises_rel > max(LEAST_CONTRAST, CONTRAST_SD * scatter_rel) and contrast.threshold_rel < float(lit.min())
    if not is_seen or contrast.threshold_rel > contrast.off_rel + MOST_SHARE * rises_rel:
        raise CaptureError(
            "photodiode: reads the same with the laser on and off, so it cannot show whether the laser is off; point "
            "the photodiode at the spot, check its wires and cover it from room light"
        )
    # closed is above off by more than the threshold is above closed
    if contrast.closed_rel is not None and 2.0 * contrast.closed_rel - contrast.off_rel > contrast.threshold_rel:
        raise CaptureError(
            f"photodiode: reads {100 * contrast.closed_rel:.2g} % of its scale with the beam closed, but only "
            f"{100 * contrast.off_rel:.2g} % with the laser off, because other light came in while the beam was "
            "closed; keep the box shut, leave the room light as it is, and check again"
        )
    if float(off.max()) >= contrast.threshold_rel:
        raise CaptureError(
            f"photodiode: reads {100 * off.max():.2g} % of its scale with the laser off, but less than "
            f"{100 * contrast.threshold_rel:.2g} % with its beam closed. The laser is dimmed and not off, or "
            "something other than its beam was covered; find out which before anybody opens the box"
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
        raise CaptureError("laser: nobody has confirmed that its beam is open again; open the beam, and check again")
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
            found.append(reading.level / FULL_SCALE_LEVEL)
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
            if readings[-1].level > FULL_SCALE_LEVEL * self._contrast.threshold_rel:
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
        f"laser: is on, but {watch.witness} does not see the laser, so nothing could confirm that the laser is off; "
        f"check the cable of {watch.witness}, and where it points"
    )
