"""Capture of a camera session: flat frames up and down through the exposures, then dark frames of the same.

The exposures are even steps up to beyond the saturation of every channel.
"""

from collections import deque
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from functools import partial
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from data_schemas import (
    CameraPlan,
    CameraSession,
    CameraSettings,
    CaptureError,
    RefusedError,
    RegionOfInterest,
    RigFile,
    SignalChangedError,
)
from data_schemas.storage import write_manifest
from rigs import OpenRig, RawFrame, open_rig, rig_locked
from rigs.capture._exposure import REPLAY_DRIVER, brightest_dn, exposure_ladder, meter_exposure, under_light
from rigs.capture._frame_store import LARGEST_CHANGE, WELL_SEEN, FrameStore, Metered, Rates, Shot, numbered
from rigs.capture._journal import Journal, StatedTimes, fault_notes, faults_noted, healing_s
from rigs.capture._plan import Step, require_named, require_region_inside
from rigs.capture._resume import (
    SET_ASIDE_EVENT,
    Interrupted,
    require_same_devices,
    require_same_inputs,
    resume_notes,
    rig_as_it_is,
    stored_before,
    take_over,
)
from rigs.capture._session_folder import (
    SessionRequest,
    curve_digests,
    curve_files,
    require_empty,
    watched_to_the_end,
    write_session,
    write_start,
)

METERED_FRACTION = 0.7
Counts = NDArray[np.uint16]


def camera_step(plan: CameraPlan, rig: RigFile) -> Step:
    """Return the flat step of a plan after checking the plan against the rig.

    Raises
    ------
    CaptureError
        The camera has no name, the rig no such filter, or the region is empty or leaves the frame.
    """
    require_named("plan.camera_name", plan.camera_name)
    require_region_inside(plan.region, rig.camera)
    slots = {f.name: f.slot for f in rig.filter_wheel.filters}
    if plan.filter_name is not None and plan.filter_name not in slots:
        raise CaptureError(
            f"plan.filter_name: the rig has no filter '{plan.filter_name}'; its filters are {', '.join(slots)}"
        )
    slot = None if plan.filter_name is None else slots[plan.filter_name]
    return Step("white", "white", "lamp", plan.filter_name, slot)


def capture_camera_session(
    rig: RigFile,
    plan: CameraPlan,
    request: SessionRequest,
    *,
    interrupted: Interrupted | None = None,
) -> CameraSession:
    """Capture a camera session into a folder: frames, journal, ``session.json`` and checksums.

    Parameters
    ----------
    rig, plan
        The rig and what to capture on it.
    request
        Where the session goes, who places the white tile, and what its record says of both.
    interrupted
        What is done already, when a session is resumed.

    Raises
    ------
    CaptureError
        The plan does not fit the rig, the folder is not empty, the light is too bright or too dim for the exposures
        of the camera, or a device did not do what was asked.
    SaturatedError
        The white tile is too bright at the camera's shortest exposure.
    """
    step = camera_step(plan, rig)
    curve_files(rig, request.rig_folder)
    if interrupted is None:
        require_empty(request.out)
    present = rig
    if interrupted is not None:
        present, sources = rig_as_it_is(rig, request.rig_folder, interrupted.sources)
        request = replace(request, sources=sources)
    with (
        rig_locked(rig),
        open_rig(present, request.rig_folder, request.operator) as opened,
        watched_to_the_end(request.watch),
    ):
        return capture_camera_with(opened, rig, plan, step, request, interrupted=interrupted)


def capture_camera_with(
    opened: OpenRig,
    rig: RigFile,
    plan: CameraPlan,
    step: Step,
    request: SessionRequest,
    *,
    interrupted: Interrupted | None = None,
) -> CameraSession:
    """Capture a camera session with devices that are open already."""
    inputs = curve_digests(curve_files(rig, request.rig_folder), request.rig_folder)
    if interrupted is not None:
        require_same_inputs(interrupted, inputs)
    opened, out, watch = request.watch.devices(opened), request.out, request.watch
    out.mkdir(parents=True, exist_ok=True)
    devices = opened.identities()
    if interrupted is not None:
        require_same_devices(interrupted, devices)
        opened = replace(opened, clock=interrupted.clock_after(opened.clock))
    whole_cells = RegionOfInterest.model_validate({k: v & ~1 for k, v in plan.region.model_dump().items()})
    with Journal(out, opened.clock, resumed=interrupted is not None, told=watch.noted) as journal:
        if interrupted is None:
            write_start(journal, plan, rig, request, inputs, devices)
        else:
            take_over(out, interrupted)
            journal.append("resume", **stored_before(interrupted))
        with (
            faults_noted(journal, out, camera_times(plan, rig).healing_s),
            FrameStore(opened, rig, whole_cells, out, journal, interrupted, watch) as store,
        ):
            recorder = _Recorder(opened, rig, plan, step, store, journal, request)
            recorder.record(None if interrupted is None else interrupted.levels)
        notes = (*opened.notes, *recorder.notes, *resume_notes(out), *fault_notes(out))
        for note in notes:
            journal.append("note", text=note)
        session = CameraSession(plan=plan, rig=rig, frames=store.frames, devices=opened.identities(), notes=notes)
        noted = dict(request.sources) or ({} if interrupted is None else interrupted.sources)
        write_session(session, out, {**noted, **inputs}, request.command, journal)
    write_manifest(out)
    return session


TYPICAL_EXPOSURE_S: Final = 0.25
"""Mean over flat and dark frames of a tile that saturates in half a second."""
FRAME_S: Final = 0.3
"""Checking and writing a frame, beside its exposure: typical of the cameras here."""
METERING_FRAMES: Final = 12
CHECKS_IN_LIGHT: Final = 2
SATURATED_SHARE: Final = 0.01
"""Of the pixels of a channel: where more are saturated, its mean tells no exposure."""
CHANNELS: Final = 3


def camera_times(plan: CameraPlan, rig: RigFile) -> StatedTimes:
    """Return what a camera session takes; its exposures are known only after metering.

    At the longest each channel has levels of its own, and all exposures are the longest that plan and camera allow.
    """
    flats = plan.levels * plan.frames_per_level + plan.repeats
    most = (
        METERING_FRAMES
        + CHECKS_IN_LIGHT
        + 2 * (CHANNELS * flats - (CHANNELS - 1) * plan.repeats)
        + plan.frames_per_level
    )
    longest_s = min(plan.longest_exposure_s, rig.camera.longest_exposure_s)
    typical_s = (METERING_FRAMES + CHECKS_IN_LIGHT + 2 * flats) * (min(TYPICAL_EXPOSURE_S, longest_s) + FRAME_S)
    return StatedTimes(typical_s, most * (longest_s + FRAME_S), healing_s(typical_s))


class _Recorder:
    """Takes and stores the frames of one session."""

    def __init__(
        self,
        opened: OpenRig,
        rig: RigFile,
        plan: CameraPlan,
        flat: Step,
        store: FrameStore,
        journal: Journal,
        request: SessionRequest,
    ):
        self._opened, self._camera, self._plan, self._flat = opened, rig.camera, plan, flat
        self._store, self._journal, self._progress, self._watch = store, journal, request.tell, request.watch
        self.notes: tuple[str, ...] = ()
        self._metered: Metered | None = None

    def record(self, levels: Mapping[str, Any] | None) -> None:
        """Meter, store the flat frames with the lamp on throughout, then the dark frames.

        Parameters
        ----------
        levels
            What the interrupted part of a resumed session found by metering; None to meter.
        """
        self._opened.operator.place("white")
        if self._flat.slot is None:
            self._opened.operator.swing_wheel_out()
        found: dict[str, Any] = {} if levels is None else dict(levels)
        tasks: deque[Callable[[], None]] = deque()

        def meter() -> None:
            if not found:
                found.update(self._meter())
                self._journal.append("levels", **found)
            if "rates_dn_per_s" in found:
                red, green, blue = (float(rate) for rate in found["rates_dn_per_s"])
                # an older version did not note the exposure, which is at most that of the brightest frames
                rates_s = float(found.get("rates_s", min(found["flats_s"])))
                self._metered = Metered((red, green, blue), rates_s)
            both_s = [*found["flats_s"], *found["flats_s"], *found["extra_darks_s"]]
            missing = self._store.missing(numbered((self._flat, exposure_s) for exposure_s in both_s))
            flats, name = len(found["flats_s"]), self._flat.filter_name
            self._watch.expects([(name if shot.sequence < flats else None, shot.exposure_s) for shot in missing])
            tasks.extend(self._takes(numbered((self._flat, t) for t in found["flats_s"]), "flat frames"))

        tasks.append(meter)
        under_light(self._opened, "lamp", tasks, self._tell_fault)
        self.notes = tuple(found["notes"])
        dark = replace(self._flat, frame_type="dark", light="off")
        exposures_s = (*found["flats_s"], *found["extra_darks_s"])
        darks = numbered(((dark, t) for t in exposures_s), first=len(found["flats_s"]))
        under_light(self._opened, "off", self._takes(darks, "dark frames"), self._tell_fault)
        if self._store.has_unproven and self._metered is not None and self._camera.driver != REPLAY_DRIVER:
            self._prove_in_light(darks, sorted(set(found["flats_s"])))

    def _prove_in_light(self, darks: list[Shot], levels_s: list[float]) -> None:
        """See by flat frames that are not stored whether the camera exposed as asked in the dark; else once more."""
        told: list[str] = []

        def look() -> None:
            for exposure_s in (levels_s[len(levels_s) // 2], levels_s[-1]):
                try:
                    self._require_as_metered(self._flat, self._store.camera.expose(self._flat, exposure_s).raw)
                except SignalChangedError as error:
                    told.append(str(error))

        for is_last in (False, True):
            told.clear()
            under_light(self._opened, "lamp", deque([look]), self._tell_fault)
            if not told:
                self._store.prove()
                return
            again = self._store.take_back()
            self._journal.append(
                "refused", text=f"{told[0]}; dark frames that were taken before and are not used: {len(again)}"
            )
            if is_last:  # a camera that is late for good was late in the light, too
                self._journal.append(SET_ASIDE_EVENT, frames=len(self._store.frames), text=told[0])
                self._store.set_aside()
                raise SignalChangedError(f"{told[0]}; restart the camera, then resume (all frames are taken again)")
            under_light(self._opened, "off", self._takes(darks, "dark frames once more"), self._tell_fault)

    def _require_as_metered(self, step: Step, raw: RawFrame) -> None:
        """Refuse a frame that is not as bright as its exposure and the metering say, or is bright in the dark.

        Where a channel should be near saturation, it is enough that it is bright; one with saturated pixels tells
        nothing.
        """
        if self._metered is None:  # a session that an older version began
            return
        now, full_dn = self._store.rates(raw.counts, raw.exposure_s), self._store.full_scale_dn
        part = raw.counts[self._store.region]
        sites = (part[0::2, 0::2], np.stack([part[0::2, 1::2], part[1::2, 0::2]]), part[1::2, 1::2])
        red, green, blue = (
            there if (site >= full_dn).mean() > SATURATED_SHARE or min(rate, there) > WELL_SEEN[1] * most else rate
            for rate, there, site in zip(self._metered.rates, now, sites, strict=True)
            for most in (full_dn / raw.exposure_s,)
        )
        expected = Metered((red, green, blue), self._metered.exposure_s)
        self._store.require_as_metered(step, raw, None if step.light == "off" else expected)

    def _take(self, shot: Shot) -> None:
        """Take and store a frame that is as metered; one more where it is not. Light that stays in the dark counts."""
        try:
            self._store.take(shot, lambda raw: self._require_as_metered(shot.step, raw))
        except SignalChangedError as error:
            self._journal.append("refused", text=f"{error}; another frame was taken")
            if shot.step.light == "off":
                self._store.take(shot)
            else:
                self._store.take(shot, lambda raw: self._require_as_metered(shot.step, raw))

    def _meter(self) -> dict[str, Any]:
        """Return the exposures (s) of the flat frames, those of further dark frames, and what the user should know."""
        first: Metered | None = None

        def take(exposure_s: float) -> Counts:
            nonlocal first
            raw = self._store.camera.expose(self._flat, exposure_s).raw
            now = self._store.rates(raw.counts, raw.exposure_s)
            if _is_well_seen(now, raw.exposure_s, self._store.full_scale_dn):
                first = Metered(now, exposure_s) if first is None else first
                self._require_in_proportion(raw, first)
            return raw.counts[self._store.region]

        metered_s = meter_exposure(
            take,
            exposure_ladder(self._camera.shortest_exposure_s, self._camera.longest_exposure_s),
            self._store.full_scale_dn,
            self._camera.black_level_dn,
            METERED_FRACTION,
            self._flat.label,
            tell=lambda text: self._progress(0, 1, text),
        )
        raw = self._store.camera.expose(self._flat, metered_s).raw
        metered = self._store.rates(raw.counts, raw.exposure_s)
        if first is not None:
            self._require_in_proportion(raw, first)
        if (shorter_s := 0.5 * raw.exposure_requested_s) >= self._camera.shortest_exposure_s:
            shorter = self._store.camera.expose(self._flat, shorter_s).raw
            rates = self._store.rates(shorter.counts, shorter.exposure_s)
            self._require_in_proportion(raw, Metered(rates, shorter_s))
        saturation_s = saturation_exposures_s(raw.counts[self._store.region], raw.exposure_s, self._camera)
        levels_s = level_exposures_s(saturation_s, self._plan, self._camera)
        half_s = min(levels_s, key=lambda t: abs(t - 0.5 * min(saturation_s.values())))
        longest_s = min(self._plan.longest_exposure_s, self._camera.longest_exposure_s)
        return {
            "flats_s": [*_up_and_down(levels_s, self._plan.frames_per_level), *[half_s] * self._plan.repeats],
            "extra_darks_s": [longest_s] * (self._plan.frames_per_level if longest_s not in levels_s else 0),
            "rates_dn_per_s": metered,
            "rates_s": raw.exposure_s,
            "notes": level_notes(saturation_s, self._plan, self._camera),
        }

    def _require_in_proportion(self, raw: RawFrame, first: Metered) -> None:
        """Refuse a frame of metering that is not as bright as the first one says.

        Raises
        ------
        RefusedError
            The longer exposure is too dim, again and again, beside the first one as before: the camera stops there.
        SignalChangedError
            The light or the camera changed.
        """
        try:
            self._store.require_as_metered(self._flat, raw, first)
        except SignalChangedError as changed:
            if raw.exposure_requested_s <= first.exposure_s:
                raise
            as_before = self._store.camera.expose(self._flat, first.exposure_s).raw
            self._store.require_as_metered(self._flat, as_before, first)
            again = self._store.camera.expose(self._flat, raw.exposure_requested_s).raw
            now = self._store.rates(again.counts, again.exposure_s)
            if max(now) > max(first.rates) / LARGEST_CHANGE:
                raise
            full_dn, top_dn = self._store.full_scale_dn, brightest_dn(again.counts[self._store.region])
            raise RefusedError(
                f"camera: the counts stop at {top_dn:.0f} DN, below full scale ({full_dn} DN). A longer exposure of "
                f"{again.exposure_s:.3g} s gives no more, and the light did not change (checked at "
                f"{first.exposure_s:.3g} s); check bit_depth, or raise the gain"
            ) from changed

    def _takes(self, shots: list[Shot], phase: str) -> deque[Callable[[], None]]:
        """Return what takes and stores the frames that are still missing."""
        missing = self._store.missing(shots)

        def take(done: int, shot: Shot) -> None:
            self._take(shot)
            self._progress(done, len(missing), f"{phase}: {shot.exposure_s:.3g} s")

        return deque(partial(take, done, shot) for done, shot in enumerate(missing, 1))

    def _tell_fault(self, text: str) -> None:
        """Note a light that was lost."""
        self._journal.append("light lost", text=text)


def _is_well_seen(rates: Rates, exposure_s: float, full_scale_dn: int) -> bool:
    """Whether the brightest channel of a frame is neither dim nor near saturation."""
    low, high = WELL_SEEN
    return low * full_scale_dn < max(rates) * exposure_s < high * full_scale_dn


def _up_and_down(levels_s: tuple[float, ...], times: int) -> Iterator[float]:
    """Yield every level `times` times, up and down in turn: a steady drift of the lamp cancels in each level's mean."""
    for turn in range(times):
        yield from levels_s if turn % 2 == 0 else reversed(levels_s)


# The last level lies this far beyond saturation, so that the variance is seen to fall.
BEYOND_SATURATION = 1.15
# Fewer levels than planned fit below saturation when the shortest exposure is already this bright.
LARGEST_FIRST_FRACTION = 0.25
# A channel that needs exposures this many times longer is measured while the brightest is heavily saturated.
LARGEST_CHANNEL_RATIO = 10.0


def saturation_exposures_s(counts: Counts, exposure_s: float, camera: CameraSettings) -> dict[str, float]:
    """Return the exposure (s) that brings the mean of each channel to full scale, from one frame of the region.

    Parameters
    ----------
    counts
        Counts of the region (DN), shape (h, w), whole 2 x 2 cells.
    exposure_s
        Exposure of the frame (s).
    camera
        Its black level and bit depth.
    """
    sites = {"red": counts[0::2, 0::2], "blue": counts[1::2, 1::2]}
    sites["green"] = np.stack([counts[0::2, 1::2], counts[1::2, 0::2]])
    room_dn = 2**camera.bit_depth - 1 - camera.black_level_dn
    signal_dn = {name: float(pixels.mean()) - camera.black_level_dn for name, pixels in sites.items()}
    # Half a count is the least that is told from the black level of the rig file; dimmer channels count as that dim.
    return {name: exposure_s * room_dn / max(signal, 0.5) for name, signal in signal_dn.items()}


def level_exposures_s(saturation_s: dict[str, float], plan: CameraPlan, camera: CameraSettings) -> tuple[float, ...]:
    """Return the exposures (s) of the lit levels, increasing.

    The brightest channel gets `plan.levels` even steps to 1.15 of its saturation; every dimmer one goes on from there
    with its own steps, below which it has the finer ones of the channels before it.

    Raises
    ------
    CaptureError
        The shortest exposure is too long for even steps up to the first saturation, or none saturates.
    """
    longest_s = min(plan.longest_exposure_s, camera.longest_exposure_s)
    first_s = min(saturation_s.values())
    if camera.shortest_exposure_s > LARGEST_FIRST_FRACTION * first_s:
        raise CaptureError(
            f"camera: the white tile saturates in {first_s:.3g} s, so the shortest exposure must be at most "
            f"{LARGEST_FIRST_FRACTION * first_s:.3g} s, but is {camera.shortest_exposure_s:g} s; dim the lamp, close "
            "the aperture or put a filter in the beam (plan.filter_name)"
        )
    if BEYOND_SATURATION * first_s > longest_s:
        raise CaptureError(
            f"camera: the white tile needs {BEYOND_SATURATION * first_s:.3g} s to saturate, but at most {longest_s:g} "
            "s are allowed; brighten the lamp, or raise plan.longest_exposure_s or camera.longest_exposure_s"
        )
    exposures: list[float] = []
    for sat_s in sorted(saturation_s.values()):
        top_s = min(BEYOND_SATURATION * sat_s, longest_s)
        steps = np.linspace(max(top_s / plan.levels, camera.shortest_exposure_s), top_s, plan.levels)
        # 2 % apart is another level; closer ones would only repeat it.
        exposures += [float(t) for t in steps if t > 1.02 * max(exposures, default=0.0)]
    return tuple(exposures)


def level_notes(saturation_s: dict[str, float], plan: CameraPlan, camera: CameraSettings) -> tuple[str, ...]:
    """Return what the user should know about channels that are much dimmer than the brightest."""
    longest_s = min(plan.longest_exposure_s, camera.longest_exposure_s)
    first_s = min(saturation_s.values())
    notes = []
    for name, sat_s in saturation_s.items():
        if sat_s > longest_s:
            notes.append(
                f"{name} does not saturate within {longest_s:g} s; use a lamp or filter with more {name} light"
            )
        elif sat_s > LARGEST_CHANNEL_RATIO * first_s:
            notes.append(
                f"{name} saturates only at {sat_s / first_s:.0f} times the exposure at which the brightest channel "
                f"saturates; charge that spills over from saturated neighbours may disturb {name}"
            )
    return tuple(notes)
