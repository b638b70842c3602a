"""The device part of an acceptance check: it records what the devices do; :mod:`finray_calib.acceptance` judges.

Who the devices say they are, where the wheel goes, what the frames show, and how fast the light goes off. Frames are
reduced at once to what is judged: dark level, white rates, revisits, ratios.
"""

from collections.abc import Callable, Sequence
from contextlib import ExitStack, nullcontext, suppress
from dataclasses import replace
from pathlib import Path
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from data_schemas import (
    BandPassFilter,
    CaptureError,
    CheckFacts,
    CheckPlan,
    DarkFrames,
    ExposureLevel,
    FilterProof,
    Handshake,
    LightOff,
    Revisit,
    RigFile,
    SaturatedError,
    Section,
    SightLevels,
    StrayLight,
    UnsafeError,
    WheelMove,
    WrongPositionError,
)
from rigs import OpenRig, Operator, TerminalOperator, open_rig, rig_locked
from rigs.capture._check_light import (
    LEAST_SIGNAL_FRACTION,
    CameraInUseError,
    CameraWatch,
    Contrast,
    LaserWatch,
    PhotodiodeWatch,
    find_contrast,
    find_sight,
    require_white,
    stray_light,
    trigger_latency,
    watch_warm_up,
)
from rigs.capture._check_recorder import HANDSHAKES, CheckRecorder, Progress, ask, come_back
from rigs.capture._exposure import (
    REPLAY_DRIVER,
    WHEEL_DEADLINE_S,
    CheckedCamera,
    exposure_ladder,
    meter_exposure,
    shine,
)
from rigs.capture._filter_proof import judge_filters, predicted_rates, signal_floor
from rigs.capture._picture_shift import cells_of, picture_shift
from rigs.capture._plan import Step, metering_room_dn, planned_filters, require_named, require_region_inside
from rigs.capture.light_off_time import ConnectionWatch, after_exception, after_kill, can_be_asked_anew
from rigs.light_guard import GuardedLight, LightLostError, is_hazardous, open_photodiode

Counts = NDArray[np.uint16]
CLOCKED_S: Final = 0.2
"""From here on the clock tells whether a frame was exposed for as long as it says: overheads are much less."""
LEAST_TAKEN: Final = 0.8
"""Of an exposure, until its frame is there: a camera that runs freely may have begun a little before."""
AS_METERED_REL: Final = 0.1
"""Of the strongest channel, within a check: a lamp changes by less once it is warm, and few filters are so alike."""


class CheckFrames:
    """Takes the frames of one check.

    Parameters
    ----------
    opened, rig, plan
        The open devices, the rig file and the plan.
    filters
        Filters to be checked, in order.
    tell
        Called with a text before every long exposure.
    """

    def __init__(
        self,
        opened: OpenRig,
        rig: RigFile,
        plan: CheckPlan,
        filters: Sequence[BandPassFilter],
        tell: Callable[[str], None] = lambda text: None,
    ) -> None:
        self._tell = tell
        self._rig = rig
        self._opened, self._settings, self._plan, self._filters = opened, rig.camera, plan, filters
        self._camera = CheckedCamera(opened, rig.camera)
        # whole Bayer cells, so that every frame shows red, green and blue alike
        row, column = plan.region.row_px & ~1, plan.region.column_px & ~1
        self._region = (
            slice(row, row + (plan.region.height_px & ~1)),
            slice(column, column + (plan.region.width_px & ~1)),
        )
        self.white_span_s = 0.0
        self.overheads_s: list[float] = []
        self._metered_s: dict[str, float] = {}
        self._signals_dn: dict[str, float] = {}
        self._rates: dict[str, tuple[float, float, float]] = {}
        self._looks: list[tuple[str, NDArray[np.float64]]] = []  # filter, and the rates of the last frame behind it

    def white_step(self, band: BandPassFilter) -> Step:
        """Return the white tile under the lamp behind a filter."""
        return Step("white", "white", "lamp", band.name, band.slot)

    def dark_frames(self) -> tuple[DarkFrames, ...]:
        """Take dark frames at the shortest exposure, half and all of the plan's longest, all lights off."""
        longest_s = min(self._plan.longest_dark_s, self._settings.longest_exposure_s)
        exposures_s = sorted({self._settings.shortest_exposure_s, 0.5 * longest_s, longest_s})
        step = replace(self.white_step(self._filters[0]), frame_type="dark", light="off")
        with shine(self._opened, "off"):
            return tuple(self._dark(step, exposure_s) for exposure_s in exposures_s)

    def prove_filters(self) -> FilterProof:
        """Meter the white tile behind every filter and judge from the rates which filter is where."""
        with shine(self._opened, "lamp"):
            for band in self._filters:
                counts, exposure_s = self._metered(self.white_step(band))
                self._rates[band.name] = self._channel_rates(counts, exposure_s)
        opened = self._opened
        predicted = predicted_rates(self._filters, opened.filter_curves, opened.lamp_spectrum, opened.camera_response)
        names = [band.name for band in self._filters]
        measured = np.array([self._rates[name] for name in names])
        in_the_dark = np.array([self._rates_in_the_dark(band) for band in self._filters])
        floor = signal_floor([self._metered_s[name] for name in names], 2**self._settings.bit_depth - 1)
        lamp_off = dict(zip(names, in_the_dark, strict=True))
        return judge_filters(names, measured - in_the_dark, predicted, lamp_off.__getitem__, (), floor)

    def shows(self, band: BandPassFilter) -> bool:
        """Whether the white tile looks behind a filter as at its metering, or was too dark then to tell.

        Of two frames one must: the first may be an old one, or the lamp may flicker. While not all filters are
        metered, nothing can be told.
        """
        least_dn = LEAST_SIGNAL_FRACTION * (2**self._settings.bit_depth - 1)
        if self.revisit_filter is None or self._signals_dn[band.name] < least_dn:
            return True

        def is_as_metered() -> bool:
            raw = self._camera.expose(self.white_step(band), self._metered_s[band.name]).raw
            now = np.array(self._channel_rates(raw.counts[self._region], raw.exposure_s))
            self._looks.append((band.name, now))
            return _alike(now, np.array(self._rates[band.name]))

        if is_as_metered():
            return True
        self._looks.pop()
        return is_as_metered()

    def common_factor(self) -> float | None:
        r"""Return the factor between all frames of :meth:`shows` and the metering; None: there is no common one.

        .. math:: f = \operatorname{median}_k \frac{n_k \cdot m_k}{m_k \cdot m_k}

        with the rates n of frame k and m at the metering of its filter. A wheel that stands elsewhere than it says
        has another factor behind each filter, so one filter alone tells nothing.
        """
        if len({name for name, _ in self._looks}) < 2:
            return None
        pairs = [(now, np.array(self._rates[name])) for name, now in self._looks]
        factor = float(np.median([now @ was / (was @ was) for now, was in pairs]))
        is_one = abs(factor - 1.0) <= 0.5 * AS_METERED_REL  # then a frame that is unlike is not explained by it
        return factor if not is_one and all(_alike(now, factor * was) for now, was in pairs) else None

    def require_as_metered(self) -> None:
        """Refuse a camera whose exposures, or a lamp whose level, are others than when the filters were metered.

        Raises
        ------
        CaptureError
            The white tile looks otherwise behind the brightest filter.
        """
        band = next((band for band in self._filters if band.name == self.revisit_filter), None)
        if band is None:
            return
        with shine(self._opened, "lamp"):
            if not self.shows(band):
                raise CaptureError(
                    f"camera: the white tile behind filter {band.name} differs by more than {100 * AS_METERED_REL:.0f} "
                    "% from its metering at the same exposure. The wheel slipped, the lamp changed, or the camera "
                    "does not expose for as long as it reports; repair the wheel if its checks failed, let the lamp "
                    "warm up, switch the camera off and on, then check again"
                )

    def brightest_filter(self) -> BandPassFilter:
        """Return the filter with the shortest metered exposure; the filters are metered first if need be.

        Raises
        ------
        CaptureError
            The white tile is dark through all of them.
        """
        if len(self._metered_s) < len(self._filters):
            self.prove_filters()
        band = min(self._filters, key=lambda band: self._metered_s[band.name])
        require_white(self._signals_dn[band.name], self._rig, band)
        return band

    def dimmest_filter(self) -> BandPassFilter:
        """Return the filter with the longest metered exposure; the first one while they are not metered."""
        return max(self._filters, key=lambda band: self._metered_s.get(band.name, 0.0))

    @property
    def revisit_filter(self) -> str | None:
        """Name of the brightest filter; None while it is not known."""
        known = len(self._metered_s) == len(self._filters)
        return min(self._metered_s, key=lambda name: self._metered_s[name]) if known else None

    def revisits(self) -> tuple[Revisit, ...]:
        """Compare the white signal over a pause without a move, then over a move away and back, again and again."""
        band = self.brightest_filter()
        others = [other for other in self._filters if other.slot != band.slot]
        step, exposure_s = self.white_step(band), self._metered_s[band.name]
        found: list[Revisit] = []
        with shine(self._opened, "lamp"):
            for turn in range(self._plan.revisits if others else 0):
                before, still = self._region_counts(step, exposure_s), self._region_counts(step, exposure_s)
                self._region_counts(self.white_step(others[turn % len(others)]), self._settings.shortest_exposure_s)
                found.append(self._revisit(before, still, self._region_counts(step, exposure_s)))
        return tuple(found)

    def exposure_levels(self) -> tuple[ExposureLevel, ...]:
        """Take white and dark frames at t, 2 t and 4 t up and down in turn: a steady drift of the lamp cancels.

        Raises
        ------
        SaturatedError
            The brightest filter leaves no room for a quarter of its exposure.
        """
        band = self.brightest_filter()
        longest_s = self._metered_s[band.name]
        exposures_s = [longest_s / 4, longest_s / 2, longest_s]
        if exposures_s[0] < self._settings.shortest_exposure_s * (1 - 1e-9):
            raise SaturatedError(
                f"filter {band.name}: this check also needs a quarter of the white tile's exposure of {longest_s:g} "
                f"s, but a quarter is below the camera's shortest exposure of {self._settings.shortest_exposure_s:g} "
                "s; dim the lamp or close the aperture"
            )
        white = self.white_step(band)
        dark = replace(white, frame_type="dark", light="off")
        taken: dict[str, list[list[float]]] = {}
        read_back_s, clock = list(exposures_s), self._opened.clock
        for step in (white, dark):
            values: list[list[float]] = [[], [], []]
            with shine(self._opened, step.light):
                self._camera.expose(step, exposures_s[0])  # the wheel is there before times count
                began_s = clock.monotonic_s()
                for turn in range(self._plan.exposure_rounds):
                    for k in (0, 1, 2) if turn % 2 == 0 else (2, 1, 0):
                        asked_s = clock.monotonic_s()
                        checked = self._camera.expose(step, exposures_s[k])
                        raw = checked.raw
                        if checked.attempts == 1:
                            self.overheads_s.append(max(clock.monotonic_s() - asked_s - raw.exposure_s, 0.0))
                        values[k].append(float(raw.counts[self._region].mean()))
                        read_back_s[k] = raw.exposure_s
                if step is white:
                    self.white_span_s = clock.monotonic_s() - began_s
            taken[step.light] = values
        return tuple(
            ExposureLevel(exposure_s=read_back_s[k], white_dn=tuple(taken["lamp"][k]), dark_dn=tuple(taken["off"][k]))
            for k in range(3)
        )

    def region_mean_dn(self, counts: Counts) -> float:
        """Return the mean count of the region (DN)."""
        return float(counts[self._region].mean())

    def expose(self, step: Step, exposure_s: float) -> float:
        """Take a checked frame and return the region's mean count (DN)."""
        return self.region_mean_dn(self._camera.expose(step, exposure_s).raw.counts)

    def meter(self, step: Step) -> float:
        """Return the exposure (s) at which the region is well exposed."""
        return meter_exposure(
            lambda exposure_s: self._camera.expose(step, exposure_s).raw.counts[self._region],
            exposure_ladder(self._settings.shortest_exposure_s, self._settings.longest_exposure_s),
            2**self._settings.bit_depth - 1,
            self._settings.black_level_dn,
            self._plan.target_fraction,
            step.label,
            next(reversed(self._metered_s.values()), None),
            self._tell,
        )

    def _metered(self, step: Step) -> tuple[Counts, float]:
        """Meter a step and return a frame of its region with its exposure (s)."""
        exposure_s = self.meter(step)
        raw = self._camera.expose(step, exposure_s).raw
        name = str(step.filter_name)
        self._metered_s[name] = exposure_s
        self._signals_dn[name] = self.region_mean_dn(raw.counts) - self._settings.black_level_dn
        return raw.counts[self._region], raw.exposure_s

    def _rates_in_the_dark(self, band: BandPassFilter) -> tuple[float, float, float]:
        """Return the rates of the white tile behind a filter with the lamp off (DN/s)."""
        step = replace(self.white_step(band), frame_type="dark", light="off")
        with shine(self._opened, "off"):
            raw = self._camera.expose(step, self._metered_s[band.name]).raw
        return self._channel_rates(raw.counts[self._region], raw.exposure_s)

    def _region_counts(self, step: Step, exposure_s: float) -> Counts:
        """Return the region of a checked frame."""
        return self._camera.expose(step, exposure_s).raw.counts[self._region]

    def _revisit(self, *frames: Counts) -> Revisit:
        """Compare three frames of the region: before, still there, and back."""
        before, still, back = (max(float(counts.mean()) - self._settings.black_level_dn, 1.0) for counts in frames)
        pictures = [cells_of(counts) for counts in frames]
        return Revisit(
            still_rel=still / before - 1.0,
            moved_rel=back / still - 1.0,
            still_px=picture_shift(pictures[0], pictures[1]),
            moved_px=picture_shift(pictures[1], pictures[2]),
        )

    def _dark(self, step: Step, exposure_s: float) -> DarkFrames:
        """Take the dark frames of one exposure."""
        frames, read_back_s = [], exposure_s
        for _ in range(self._plan.darks_per_exposure):
            asked_s = self._opened.clock.monotonic_s()
            raw = self._camera.expose(step, exposure_s).raw
            took_s = self._opened.clock.monotonic_s() - asked_s
            is_clocked = raw.exposure_s >= CLOCKED_S and self._settings.driver != REPLAY_DRIVER
            if is_clocked and took_s < LEAST_TAKEN * raw.exposure_s:
                raise CaptureError(
                    f"camera: reports an exposure of {raw.exposure_s:g} s, but its frame arrived only {took_s:.3g} s "
                    "after the request. The camera exposes for less than it reports, or delivers an earlier frame; "
                    "switch the camera off and on, then check its driver and trigger mode"
                )
            frames.append(raw.counts[self._region].astype(np.int32))
            read_back_s = raw.exposure_s
        variance = [np.var(second - first) / 2.0 for first, second in zip(frames[0::2], frames[1::2], strict=False)]
        return DarkFrames(
            exposure_s=read_back_s,
            means_dn=tuple(float(frame.mean()) for frame in frames),
            noise_dn=float(np.sqrt(np.mean(variance))),
            at_zero_fraction=float(np.mean([np.mean(frame == 0) for frame in frames])),
            pixels=frames[0].size,
        )

    def _channel_rates(self, counts: Counts, exposure_s: float) -> tuple[float, float, float]:
        """Return the mean rates above the black level, red, green, blue (DN/s)."""
        part = counts.astype(np.float64) - self._settings.black_level_dn
        green = 0.5 * (part[0::2, 1::2].mean() + part[1::2, 0::2].mean())
        red, blue = part[0::2, 0::2].mean(), part[1::2, 1::2].mean()
        return float(red) / exposure_s, float(green) / exposure_s, float(blue) / exposure_s


def _alike(now: NDArray[np.float64], was: NDArray[np.float64]) -> bool:
    """Whether rates are those that are expected."""
    return bool(np.abs(now - was).max() <= AS_METERED_REL * was.max())


QUIET_SHARE: Final = 0.95
"""Of the limit: when a dead-man is asked whether it has acted. Earlier questions would keep it from acting."""
WITH_OPEN_RIG: Final[tuple[Section, ...]] = (
    "handshake", "dark frames", "warm-up", "filters", "wheel", "revisits", "exposures", "stray light",
    "trigger latency", "light off",
)  # fmt: skip
WITH_LASER: Final[tuple[Section, ...]] = ("stray light", "light off")
STEPS: Final = len(WITH_OPEN_RIG) + 4
"""Opening, these, closing, opening once more, and the laser's layers without the rig."""


def check_filters(plan: CheckPlan, rig: RigFile) -> list[BandPassFilter]:
    """Return the filters to be checked, after checking the plan against the rig.

    Raises
    ------
    CaptureError
        The check has no name, the rig lacks a filter, or the region is empty or leaves the frame.
    """
    require_named("plan.check_name", plan.check_name)
    require_region_inside(plan.region, rig.camera)
    metering_room_dn(plan.target_fraction, 2**rig.camera.bit_depth - 1, rig.camera.black_level_dn)
    if plan.photodiode is not None and rig.is_simulated != (plan.photodiode == "simulated"):
        allowed = "'simulated', as the rig is" if rig.is_simulated else "a serial port or pyserial URL on a real rig"
        raise CaptureError(
            f"plan.photodiode = '{plan.photodiode}': must be {allowed}; correct it, or leave photodiode out"
        )
    if plan.photodiode is not None and not rig.is_simulated and plan.photodiode == rig.laser.address:
        raise CaptureError(
            f"plan.photodiode = '{plan.photodiode}': is the address of the laser, and opening this port would reset "
            "the laser's board; give the port of the photodiode's own board"
        )
    return planned_filters(plan.filters, rig)


def record_facts(
    rig: RigFile,
    plan: CheckPlan,
    rig_folder: Path,
    progress: Progress = lambda done, total, what: None,
    *,
    operator: Operator | None = None,
) -> tuple[CheckFacts, tuple[str, ...]]:
    """Try the devices of a rig and return what they did, with the notes of the rig.

    A device error ends its own section only; all lights are confirmed off before the next begins. A light that is
    not confirmed off ends everything, and so does a laser of class 3R or above that went out by itself.

    Parameters
    ----------
    rig, plan
        The rig and what to check on it.
    rig_folder
        Where relative paths in the rig file start.
    progress
        Called with (done, total, text) at the start of every section.
    operator
        Who places the white tile; a person at the terminal when left out.

    Raises
    ------
    CaptureError
        The plan does not fit the rig, or another process uses it.
    """
    filters = check_filters(plan, rig)
    with rig_locked(rig):
        return _Recorder(rig, plan, rig_folder, filters, progress).record(operator or TerminalOperator())


class _Recorder(CheckRecorder[CheckFacts]):
    """Walks through the sections of one check."""

    def __init__(
        self, rig: RigFile, plan: CheckPlan, rig_folder: Path, filters: list[BandPassFilter], progress: Progress
    ) -> None:
        super().__init__(CheckFacts(), STEPS, progress)
        self._rig, self._plan, self._folder, self._filters = rig, plan, rig_folder, filters
        self._has_dead_man: bool | None = None  # of a laser that has a guard
        self._sight: SightLevels | None = None
        self._contrast: Contrast | None = None
        self._frames: CheckFrames | None = None

    def record(self, operator: Operator) -> tuple[CheckFacts, tuple[str, ...]]:
        """Open the rig, try everything, close it, then try what needs the laser for itself."""
        notes: tuple[str, ...] = ()
        with ExitStack() as stack:
            opened = self._attempt("opening", lambda: stack.enter_context(open_rig(self._rig, self._folder, operator)))
            if opened is None:
                self._ended = "the rig could not be opened"
                self._errors |= dict.fromkeys(WITH_OPEN_RIG, f"not tried: {self._ended}")
            else:
                notes = opened.notes
                self._with_open_rig(opened)
            closing = stack.pop_all()
        self._attempt("closing", closing.close, also_when_ended=True)
        self._attempt("reconnect", lambda: self._reconnect(operator))
        layers = self._attempt("light off", self._without_rig) or ()
        self._keep(light_off=(*self._facts.light_off, *layers), errors=self._errors)
        return self._facts, notes

    def _with_open_rig(self, opened: OpenRig) -> None:
        """Try everything that the open rig can show."""
        if isinstance(opened.laser, GuardedLight):
            self._has_dead_man = opened.laser.has_dead_man
        frames = self._frames = CheckFrames(
            opened,
            self._rig,
            self._plan,
            self._filters,
            lambda text: self._progress(len(self._begun) - 1, STEPS, text),
        )
        self._keep(handshakes=self._attempt("handshake", lambda: handshakes(opened, self._rig)) or ())
        self._keep(darks=self._attempt("dark frames", frames.dark_frames) or ())
        self._lights_are_off(opened, "dark frames")
        # before anything else lights the lamp
        first = self._filters[0]
        self._keep(
            warm_up=self._attempt("warm-up", lambda: watch_warm_up(opened, self._rig, self._plan, frames, first))
        )
        self._lights_are_off(opened, "warm-up")
        self._keep(filter_proof=self._attempt("filters", frames.prove_filters))
        self._lights_are_off(opened, "filters")
        moves: list[WheelMove] = []
        # by now each filter is metered, so that a frame shows where the wheel arrived
        self._attempt("wheel", lambda: make_moves(opened, self._plan, self._filters, frames, moves))
        self._keep(moves=tuple(moves))  # those before an error too
        self._lights_are_off(opened, "wheel")
        self._keep(revisits=self._attempt("revisits", frames.revisits) or (), revisit_filter=frames.revisit_filter)
        self._lights_are_off(opened, "revisits")
        self._keep(levels=self._attempt("exposures", frames.exposure_levels) or ())
        self._keep(white_span_s=frames.white_span_s, frame_overheads_s=tuple(frames.overheads_s))
        self._lights_are_off(opened, "exposures")
        self._off_its_way(opened, frames)
        self._attempt("light off", lambda: self._block_layer(opened))
        self._lights_are_off(opened, "light off")

    def _off_its_way(self, opened: OpenRig, frames: CheckFrames) -> None:
        """Try the laser behind filters that block it, and the lamp in the middle of exposures."""
        given = (opened, self._rig, self._plan, frames)

        def look() -> StrayLight:
            found = stray_light(*given, self._filters)
            frames.require_as_metered()
            return found

        self._keep(stray_light=self._attempt("stray light", look))
        self._lights_are_off(opened, "stray light")
        self._keep(latency=self._attempt("trigger latency", lambda: trigger_latency(*given, frames.dimmest_filter())))
        self._lights_are_off(opened, "trigger latency")

    def _reconnect(self, operator: Operator) -> None:
        """Open the closed rig once more, and note what the devices say of themselves."""
        opening = open_rig(self._rig, self._folder, operator)
        self._keep(**come_back(opening, lambda opened: handshakes(opened, self._rig, asked=1)))

    def _why_it_ends(self, error: CaptureError, section: Section) -> str | None:
        """Return why an error ends all that follows."""
        if isinstance(error, UnsafeError):
            return "a light is not confirmed off"
        if isinstance(error, CameraInUseError):
            return "the camera is still in use by an exposure that has not ended"
        if isinstance(error, LightLostError) and section in WITH_LASER and is_hazardous(self._rig.laser):
            return "the laser went off without a command, and is not lit again until a person has found the cause"
        return None

    def _lights_are_off(self, opened: OpenRig, section: Section) -> None:
        """End the check when a light is on, or cannot be asked, between two sections."""
        if self._ended is not None:
            return
        try:
            on = [name for name, light in (("laser", opened.laser), ("lamp", opened.lamp)) if light.state()]
        except CaptureError as error:
            self._errors.setdefault(section, str(error))
            self._ended = f"a light does not report whether it is off ({error})"
            return
        if on:
            self._errors[section] = (
                f"{on[0]}: still reports that it is on at the end of this part of the check; pull "
                "its plug before you open the box"
            )
            self._ended = f"the {on[0]} is on"

    def _block_layer(self, opened: OpenRig) -> None:
        """Try the block that lights the laser, and see whether the camera sees it."""
        opened.operator.place("white")
        repeats = self._plan.light_off_repeats
        if self._plan.photodiode is None:
            self._keep(light_off=(after_exception(opened, repeats),))
        else:
            with opened.photodiode(self._plan.photodiode) as diode:
                self._contrast = find_contrast(opened, diode)
                self._keep(diode=self._contrast.recorded())
                self._keep(light_off=(after_exception(opened, repeats, PhotodiodeWatch(diode, self._contrast)),))
            return
        if self._has_dead_man is not None and self._frames is not None:
            self._sight = find_sight(opened, self._rig, self._frames)
            self._keep(sight=self._sight)

    def _without_rig(self) -> tuple[LightOff, ...]:
        """Try guard and dead-man, the rig being closed."""
        if self._has_dead_man is None:
            reason = f"{'the simulated rig' if self._rig.is_simulated else 'this laser'} has no guard process"
            return LightOff(layer="guard", missing=reason), LightOff(layer="dead-man", missing=reason)
        if (why := self._errors.get("light off")) is not None and is_hazardous(self._rig.laser):
            return LightOff(layer="guard", error=_not_lit(why)), LightOff(layer="dead-man", error=_not_lit(why))
        guard = self._layer("guard")
        if guard.error is not None and is_hazardous(self._rig.laser):
            return guard, LightOff(layer="dead-man", error=_not_lit(guard.error))
        if not self._has_dead_man:
            reason = "the laser's controller has no dead-man: when the computer hangs, the laser stays on"
            return guard, LightOff(layer="dead-man", missing=reason)
        return guard, self._layer("dead-man")

    def _layer(self, layer: Literal["guard", "dead-man"]) -> LightOff:
        """Try one layer before a witness."""
        laser, repeats = self._rig.laser, self._plan.light_off_repeats
        try:
            if self._contrast is not None and self._plan.photodiode is not None:
                with open_photodiode(self._plan.photodiode) as diode:
                    return after_kill(laser, layer, PhotodiodeWatch(diode, self._contrast), repeats)
            if self._sight is not None and self._frames is not None:
                with CameraWatch(self._rig, self._folder, self._frames, self._sight).open() as camera:
                    return after_kill(laser, layer, camera, repeats)
            if can_be_asked_anew(laser):
                quiet_s = QUIET_SHARE * self._plan.limits.light_off_s
                watch: LaserWatch = ConnectionWatch(laser, quiet_s) if layer == "dead-man" else ConnectionWatch(laser)
                return after_kill(laser, layer, watch, repeats)
        except UnsafeError:
            raise
        except CaptureError as error:
            return LightOff(layer=layer, error=str(error))
        return LightOff(
            layer=layer,
            missing="this cannot be observed: the camera does not see the laser, and opening the laser's serial port "
            "a second time resets most boards, which switches it off; point a photodiode at it (photodiode in the "
            "plan)",
        )


def _not_lit(why: str) -> str:
    """Say that a laser that harms eyes is not lit after an error: it may be that somebody opened the box."""
    return f"not tried: the laser is not lit again until a person has found the cause ({why})"


def handshakes(opened: OpenRig, rig: RigFile, asked: int = HANDSHAKES) -> tuple[Handshake, ...]:
    """Ask every device who it is and how it stands, so many times."""
    return (
        ask(opened.clock, ("camera", rig.camera.driver), opened.camera, lambda: None, asked),
        ask(opened.clock, ("filter wheel", rig.filter_wheel.driver), opened.wheel, opened.wheel.position, asked),
        ask(opened.clock, ("laser", rig.laser.driver), opened.laser, opened.laser.state, asked),
        ask(opened.clock, ("lamp", rig.lamp.driver), opened.lamp, opened.lamp.state, asked),
    )


def make_moves(
    opened: OpenRig, plan: CheckPlan, filters: Sequence[BandPassFilter], frames: CheckFrames, moves: list[WheelMove]
) -> None:
    """Turn the wheel to filters drawn at random, never to the one in the beam; arrival is asked afresh, and looked at.

    A wheel whose frame is not that of the filter which it reports has arrived nowhere.

    Raises
    ------
    CaptureError
        All frames are those of their filters but for one factor.
    """
    opened.operator.place("white")
    rng = np.random.default_rng(plan.seed)
    bands = {band.slot: band for band in filters}
    if plan.wheel_moves == 0 or len(bands) < 2:
        return
    unlike: list[int] = []
    with shine(opened, "lamp") if frames.revisit_filter is not None else nullcontext():
        for _ in range(plan.wheel_moves):
            here = opened.wheel.position()
            slot = int(rng.choice([slot for slot in bands if slot != here]))
            start_s = opened.clock.monotonic_s()
            # where it stands is asked below, and is what the check is about
            with suppress(WrongPositionError):
                opened.wheel.go_to(slot, WHEEL_DEADLINE_S)
            duration_s = opened.clock.monotonic_s() - start_s
            arrived = opened.wheel.position()
            if arrived == slot and not frames.shows(bands[slot]):
                unlike.append(len(moves))
                arrived = None
            moves.append(WheelMove(from_slot=here, to_slot=slot, arrived_slot=arrived, duration_s=duration_s))
    if unlike and (factor := frames.common_factor()) is not None:
        for k in unlike:
            moves[k] = moves[k].model_copy(update={"arrived_slot": moves[k].to_slot})
        raise CaptureError(
            f"lamp: the white tile is {factor:.2f} times as bright as at its metering behind every filter that the "
            "wheel turned to. The lamp changed, or the camera does not expose for as long as it reports; let the "
            "lamp warm up, switch the camera off and on, then check again"
        )
