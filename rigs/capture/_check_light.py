"""What an acceptance check records of light over time and off its way: warm-up, stray light, trigger latency.

The light is on inside a ``with`` block only, in the thread that holds it, so that it goes off however a measurement
ends; the exposure in which a light is switched on runs in a thread of its own and is waited for.
"""

import math
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Final, Protocol

import numpy as np
from numpy.typing import NDArray

from data_schemas import (
    BandPassFilter,
    BlockedLight,
    CaptureError,
    CheckPlan,
    ExposureLevel,
    LatencyTry,
    RigFile,
    StrayLight,
    TimedOutError,
    TriggerLatency,
    UnsafeError,
    WarmUp,
)
from rigs import CallThread, NoAnswerError, OpenRig, RawFrame
from rigs.capture._exposure import CAMERA_DEADLINE_MARGIN_S, CAMERA_EXPOSURES, shine
from rigs.capture._plan import Step

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
    with shine(opened, "laser"):
        metered_s = frames.meter(lit)
    # light at the limit must not saturate
    longest_s = min(plan.longest_dark_s, rig.camera.longest_exposure_s, metered_s / plan.limits.stray_light_rel)

    def level(band: BandPassFilter, exposure_s: float) -> BlockedLight:
        step = replace(lit, filter_name=band.name, slot=band.slot)
        dark = replace(step, frame_type="dark", light="off")
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
            f"camera: the white tile gives only {signal_dn:.3g} DN through filter {band.name}, {least_dn:.3g} DN are "
            "needed; check lamp, tile and lens cap"
        )


class CameraInUseError(CaptureError):
    """An exposure has not ended after its deadline: nobody else may ask the camera for anything."""


def _why_not(rig: RigFile, plan: CheckPlan) -> str | None:
    """Return why no light can be switched on in the middle of an exposure."""
    if rig.is_simulated:
        return "the clock of a simulated rig stands still between its actions: nothing happens within an exposure"
    if rig.lamp.driver == "manual":
        return "not possible on this rig: its lamp is switched by hand; it needs a lamp or LED that finray switches"
    return "the plan asks for no tries" if plan.latency_tries == 0 else None


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
    exposing = _Exposing(thread, expose)
    try:
        exposing.begin()
        while not requested:
            time.sleep(0.0005)
        time.sleep(max(requested[0] + delay_s - time.monotonic(), 0.0))
        told_s = time.monotonic()
        with opened.lamp.lit():
            confirmed_s = time.monotonic()
            raw = exposing.frame(limit_s)
    finally:
        # the camera is free again before anybody else asks it for anything
        ended: list[bool] = []
        thread.close(lambda: ended.append(True), limit_s)
        if not ended and not isinstance(sys.exception(), UnsafeError):
            raise CameraInUseError(
                f"camera: an exposure of {exposure_s:g} s has not ended {2 * limit_s:g} s after its request, so the "
                "check ends; switch the camera off and on, then check its cable and driver"
            )
    return told_s - requested[0], confirmed_s - requested[0], raw


class _Exposing:
    """An exposure that runs in a thread while this one does something else."""

    def __init__(self, thread: CallThread, expose: Callable[[], RawFrame]) -> None:
        self._thread, self._expose = thread, expose
        self._found: list[RawFrame | BaseException] = []

    def begin(self) -> None:
        """Start it."""

        def act() -> None:
            try:
                self._found.append(self._expose())
            except BaseException as error:
                self._found.append(error)

        self._thread.post(act)

    def frame(self, limit_s: float) -> RawFrame:
        """Return its frame, or raise what it raised."""
        try:
            self._thread.call(lambda: None, limit_s)
        except NoAnswerError:
            raise TimedOutError(f"camera: has not delivered its frame within {limit_s:g} s; check its cable") from None
        found = self._found[0]
        if isinstance(found, BaseException):
            raise found
        return found
