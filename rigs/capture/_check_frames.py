"""Frames of an acceptance check, reduced at once to what is judged: dark level, white rates, revisits, ratios."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from data_schemas import (
    BandPassFilter,
    CaptureError,
    CheckPlan,
    DarkFrames,
    ExposureLevel,
    FilterProof,
    Revisit,
    RigFile,
    SaturatedError,
)
from rigs import OpenRig
from rigs.capture._exposure import CheckedCamera, exposure_ladder, meter_exposure, shine
from rigs.capture._filter_proof import judge_filters, predicted_rates, signal_floor
from rigs.capture._plan import Step

Counts = NDArray[np.uint16]

LEAST_SIGNAL_FRACTION = 0.05  # of full scale, mean of the region: below it, noise decides


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
        self._opened, self._settings, self._plan, self._filters = opened, rig.camera, plan, filters
        self._camera = CheckedCamera(opened, rig.camera)
        # whole Bayer cells, so that every frame shows red, green and blue alike
        row, column = plan.region.row_px & ~1, plan.region.column_px & ~1
        self._region = (
            slice(row, row + (plan.region.height_px & ~1)),
            slice(column, column + (plan.region.width_px & ~1)),
        )
        self._metered_s: dict[str, float] = {}
        self._signals_dn: dict[str, float] = {}

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
        rates = []
        with shine(self._opened, "lamp"):
            for band in self._filters:
                step = self.white_step(band)
                counts, exposure_s = self._metered(step)
                rates.append(self._channel_rates(counts, exposure_s))
        opened = self._opened
        predicted = predicted_rates(self._filters, opened.filter_curves, opened.lamp_spectrum, opened.camera_response)
        names = [band.name for band in self._filters]
        measured = np.array(rates)
        in_the_dark = np.array([self._rates_in_the_dark(band) for band in self._filters])
        floor = signal_floor([self._metered_s[name] for name in names], 2**self._settings.bit_depth - 1)
        return judge_filters(names, measured - in_the_dark, predicted, lambda: in_the_dark[0], (), floor)

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
        signal_dn, full_dn = self._signals_dn[band.name], 2**self._settings.bit_depth - 1
        if signal_dn < LEAST_SIGNAL_FRACTION * full_dn:
            raise CaptureError(
                f"camera: the white tile gives only {signal_dn:.3g} DN through filter {band.name}, "
                f"{LEAST_SIGNAL_FRACTION * full_dn:.3g} DN are needed; check lamp, tile and lens cap"
            )
        return band

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
                before, still = self._white(step, exposure_s), self._white(step, exposure_s)
                self._white(self.white_step(others[turn % len(others)]), self._settings.shortest_exposure_s)
                back = self._white(step, exposure_s)
                found.append(Revisit(still_rel=still / before - 1.0, moved_rel=back / still - 1.0))
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
                f"filter {band.name}: the white tile needs {longest_s:g} s, and a quarter of it is below the camera's "
                f"shortest exposure, {self._settings.shortest_exposure_s:g} s; dim the lamp or close the aperture"
            )
        white = self.white_step(band)
        dark = replace(white, frame_type="dark", light="off")
        taken: dict[str, list[list[float]]] = {}
        read_back_s = list(exposures_s)
        for step in (white, dark):
            values: list[list[float]] = [[], [], []]
            with shine(self._opened, step.light):
                for turn in range(self._plan.exposure_rounds):
                    for k in (0, 1, 2) if turn % 2 == 0 else (2, 1, 0):
                        raw = self._camera.expose(step, exposures_s[k]).raw
                        values[k].append(float(raw.counts[self._region].mean()))
                        read_back_s[k] = raw.exposure_s
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

    def _white(self, step: Step, exposure_s: float) -> float:
        """Return the signal of the region above the black level (DN)."""
        return max(self.expose(step, exposure_s) - self._settings.black_level_dn, 1.0)

    def _dark(self, step: Step, exposure_s: float) -> DarkFrames:
        """Take the dark frames of one exposure."""
        frames, read_back_s = [], exposure_s
        for _ in range(self._plan.darks_per_exposure):
            raw = self._camera.expose(step, exposure_s).raw
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
