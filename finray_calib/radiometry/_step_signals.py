r"""One linear signal per capture step, dark-corrected, per second: mean over the painted region, or of every raw pixel.

For exposure time t the signal of a channel is :math:`S = (\bar D - \bar D_{dark}(t)) / t` in DN/s. The exposures of
a step are merged with inverse-variance weights, where the variance holds noise, dark level and the repeatability of
the light; saturated exposures are left out. The dark level of the region at every exposure time is that of the dark
frames before and after a session. Frames are read one at a time and only their means are kept.

The exposures of a pixel are merged likewise,

.. math:: S = \frac{\sum_i w_i D_i / t_i}{\sum_i w_i}, \qquad
    w_i = t_i^2 \Big/ \Bigl(\frac{\hat S t_i}{K} + \frac{\sigma_r^2}{K^2} + \frac{1}{12} + \sigma_o^2\Bigr)

with D the count above the dark level (its dark current counts as shot noise) and :math:`\sigma_o` the noise of a
pixel's dark offset. A pixel that is saturated in a long exposure is taken from the shorter ones.
The shot noise in the weights is that of the pooled signal :math:`\hat S = \sum D_i / \sum t_i`; weights from each
exposure's own count would favour the exposures that happened to come out low. Frames are read one at a time (twice),
so that memory does not grow with their number.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray

from data_schemas import CameraSettings, CaptureSession, Frame, FrameType, RadiometryError, RegionOfInterest

Counts = NDArray[np.uint16]
Floats = NDArray[np.float64]
SMALLEST_SIDE_PX = 4
# The region is also averaged in 4 x 4 blocks: their scatter shows how uniform the paint is.
BLOCKS_PER_SIDE = 4


@dataclass(frozen=True, slots=True)
class RegionMeans:
    """Means of one frame over the region, channels red, green, blue.

    Attributes
    ----------
    mean_dn
        (3,) mean count.
    saturated_fraction
        (3,) share of the pixels at full scale.
    pixels
        (3,) number of pixels.
    block_mean_dn
        (blocks, 3) mean count of each block.
    """

    mean_dn: Floats
    saturated_fraction: Floats
    pixels: Floats
    block_mean_dn: Floats


def complete_bayer_cells(region: RegionOfInterest) -> RegionOfInterest:
    """Return the region in whole 2 x 2 Bayer cells: first row, first column and size rounded down to even numbers."""
    values = region.model_dump()
    return RegionOfInterest(**{name: value & ~1 for name, value in values.items()})


def region_channels(frame: Counts, region: RegionOfInterest) -> tuple[Counts, Counts, Counts]:
    """Return the red, green and blue samples (DN) of a region of an RGGB frame, each flattened.

    The region is taken as whole 2 x 2 Bayer cells. Green holds both greens of a cell.

    Raises
    ------
    RadiometryError
        The region is empty, smaller than 4 x 4 px, or reaches beyond the frame.
    """
    cut = _checked_cells(frame, region)
    green = np.concatenate([cut[0::2, 1::2].ravel(), cut[1::2, 0::2].ravel()])
    return cut[0::2, 0::2].ravel(), green, cut[1::2, 1::2].ravel()


def region_means(frame: Counts, region: RegionOfInterest, full_scale_dn: int) -> RegionMeans:
    """Reduce one frame to its means over the region and over the region's blocks.

    Raises
    ------
    RadiometryError
        The region is empty, smaller than 4 x 4 px, or reaches beyond the frame.
    """
    channels = region_channels(frame, region)
    cut = _checked_cells(frame, region)
    rows, columns = (np.linspace(0, size // 2, _blocks(size) + 1).astype(int) * 2 for size in cut.shape)
    blocks = []
    for top, bottom in pairwise(rows):
        for left, right in pairwise(columns):
            block = cut[top:bottom, left:right]
            green = 0.5 * (block[0::2, 1::2].mean() + block[1::2, 0::2].mean())
            blocks.append((block[0::2, 0::2].mean(), green, block[1::2, 1::2].mean()))
    return RegionMeans(
        mean_dn=np.array([c.mean() for c in channels]),
        saturated_fraction=np.array([(c >= full_scale_dn).mean() for c in channels]),
        pixels=np.array([float(c.size) for c in channels]),
        block_mean_dn=np.array(blocks),
    )


def _blocks(side_px: int) -> int:
    """Return the number of blocks along a side: at most one per Bayer cell."""
    return min(BLOCKS_PER_SIDE, side_px // 2)


def _checked_cells(frame: Counts, region: RegionOfInterest) -> Counts:
    """Return the whole Bayer cells of the region after checking it."""
    cells = complete_bayer_cells(region)
    top, left, height, width = cells.row_px, cells.column_px, cells.height_px, cells.width_px
    rows, columns = frame.shape
    if height < SMALLEST_SIDE_PX or width < SMALLEST_SIDE_PX:
        raise RadiometryError(
            f"plan.region: {region.height_px} x {region.width_px} px is empty or too small, but at least "
            f"{SMALLEST_SIDE_PX} x {SMALLEST_SIDE_PX} px of paint are needed; correct height_px and width_px"
        )
    if top + height > rows or left + width > columns:
        raise RadiometryError(
            f"plan.region: rows {top} to {top + height} and columns {left} to {left + width} px reach beyond the frame "
            f"of {rows} x {columns} px; correct the region"
        )
    return frame[top : top + height, left : left + width]


ReadFrame = Callable[[Frame], NDArray[np.uint16]]


@dataclass(frozen=True, slots=True)
class DarkLevel:
    """Mean dark level of the region at one exposure time, channels red, green, blue.

    Attributes
    ----------
    level_dn, noise_variance
        (3,) level (DN) and the variance of its noise (DN^2); both are shared by every step of this exposure time.
    thermal_dn
        Level above that of the shortest exposure (DN): dark current, which brings shot noise of its own.
    drift_dn
        Mean level of the later half of the dark frames less that of the earlier half (DN).
    drift_variance_dn2
        What that drift adds (DN^2), common to the channels: the level at the time of a frame lies evenly between.
    """

    level_dn: Floats
    noise_variance: Floats
    thermal_dn: float
    drift_dn: float
    drift_variance_dn2: float


def dark_levels(session: CaptureSession, read: ReadFrame) -> dict[float, DarkLevel]:
    """Return the dark level for each requested exposure time (the one that is read back may differ slightly).

    Raises
    ------
    RadiometryError
        The session has no dark frames.
    """
    means: dict[float, list[Floats]] = {}
    pixels = np.ones(3)
    full_scale_dn = 2**session.rig.camera.bit_depth - 1
    for frame in session.frames:
        if frame.frame_type == "dark":
            reduced = region_means(read(frame), session.plan.region, full_scale_dn)
            means.setdefault(frame.exposure_requested_s, []).append(reduced.mean_dn)
            pixels = reduced.pixels
    if not means:
        raise RadiometryError("session.frames: has no dark frames; capture dark frames before and after the session")
    thermal_dn = thermal_levels_dn({exposure_s: float(np.mean(rows)) for exposure_s, rows in means.items()})
    return {
        exposure_s: _level(np.array(rows), noise_variance_dn2(level, session.rig.camera) / pixels, level)
        for (exposure_s, rows), level in zip(means.items(), thermal_dn.values(), strict=True)
    }


def thermal_levels_dn(level_dn: dict[float, float]) -> dict[float, float]:
    """Return the dark level of each exposure time (s) above that of the shortest one (DN, at least 0)."""
    lowest_dn = level_dn[min(level_dn)]
    return {exposure_s: max(level - lowest_dn, 0.0) for exposure_s, level in level_dn.items()}


def _level(rows: Floats, noise: Floats, thermal_dn: float) -> DarkLevel:
    """Reduce the (frames, 3) means of one exposure time; noise (3,) is the variance of one frame's means."""
    half = len(rows) // 2
    drift_dn = float(np.mean(rows[half:]) - np.mean(rows[:half])) if half else 0.0
    by_chance = float(noise.sum() / 9) * (1 / half + 1 / (len(rows) - half)) if half else 0.0
    # Evenly distributed over +- drift / 2: a variance of drift^2 / 12.
    drift_variance_dn2 = max(drift_dn**2 - by_chance, 0.0) / 12
    return DarkLevel(rows.mean(axis=0), noise / len(rows), thermal_dn, drift_dn, drift_variance_dn2)


StepKey = tuple[FrameType, str]
# A handful of hot pixels may sit at full scale without biasing the mean of thousands of pixels.
LARGEST_SATURATED_FRACTION = 1e-4
# The repeatability of lamp and laser is never taken as better than this: a handful of log ratios cannot show it.
SMALLEST_REPEATABILITY_REL = 5e-4
# Assumed when fewer brackets than this are bright enough to tell.
ASSUMED_REPEATABILITY_REL = 0.005
FEWEST_RATIOS = 3
LARGEST_RATIO_NOISE = 0.01


@dataclass(frozen=True, slots=True)
class ExposureSignal:
    """Signal of one frame over the region, channels red, green, blue.

    Attributes
    ----------
    frame
        Its record.
    signal_dn_per_s, noise_variance
        (3,) signal and the variance of its own noise, without that of the dark level.
    dark_variance
        (3,) variance that the dark level adds.
    saturated_fraction
        (3,) share of the region at full scale.
    block_dn_per_s
        (blocks, 3) signal of the region's blocks.
    """

    frame: Frame
    signal_dn_per_s: Floats
    noise_variance: Floats
    dark_variance: Floats
    saturated_fraction: Floats
    block_dn_per_s: Floats

    @property
    def usable(self) -> NDArray[np.bool_]:
        """Channels that are not saturated, (3,)."""
        return self.saturated_fraction <= LARGEST_SATURATED_FRACTION


@dataclass(frozen=True, slots=True)
class StepSignal:
    """Merged signal of one step (frame type and filter), channels red, green, blue.

    Attributes
    ----------
    exposures
        The signals that were merged.
    shares
        (exposures, 3) weight of each exposure; the columns sum to 1 (0 where every exposure is saturated).
    signal_dn_per_s, noise_variance
        (3,) merged signal and the variance of its own noise; NaN where every exposure is saturated.
    """

    exposures: tuple[ExposureSignal, ...]
    shares: Floats
    signal_dn_per_s: Floats
    noise_variance: Floats

    @property
    def saturated_fraction(self) -> Floats:
        """Smallest saturated fraction of the region over the exposures, (3,)."""
        return np.asarray(np.array([e.saturated_fraction for e in self.exposures]).min(axis=0))

    @property
    def block_dn_per_s(self) -> Floats:
        """Merged signal of the region's blocks, (blocks, 3)."""
        blocks = np.array([e.block_dn_per_s for e in self.exposures])
        return np.asarray(np.einsum("ec,ekc->kc", self.shares, blocks))

    @property
    def dose_j(self) -> Floats:
        """Laser light on the sample at the middle of the exposures, mean by weight (J), (3,)."""
        doses_j = np.array([e.frame.laser_dose_j for e in self.exposures])
        return np.where(self.shares.any(axis=0), doses_j @ self.shares, doses_j.mean())


def exposure_signals(
    session: CaptureSession, read: ReadFrame, darks: dict[float, DarkLevel]
) -> dict[StepKey, list[ExposureSignal]]:
    """Return the signals of every lit frame of a session, by step.

    Raises
    ------
    RadiometryError
        A frame has no dark frame of its exposure time.
    """
    grouped: dict[StepKey, list[ExposureSignal]] = {}
    full_scale_dn = 2**session.rig.camera.bit_depth - 1
    for frame in session.frames:
        if frame.frame_type == "dark" or frame.filter_name is None:
            continue
        dark = darks.get(frame.exposure_requested_s)
        if dark is None:
            raise RadiometryError(
                f"{frame.file}: no dark frame of {frame.exposure_s:g} s was captured; capture dark frames of the same "
                "exposure time"
            )
        means = region_means(read(frame), session.plan.region, full_scale_dn)
        signal = _one_exposure(session, frame, means, dark)
        grouped.setdefault((frame.frame_type, frame.filter_name), []).append(signal)
    return grouped


def _one_exposure(session: CaptureSession, frame: Frame, means: RegionMeans, dark: DarkLevel) -> ExposureSignal:
    """Return the dark-corrected signal of one frame."""
    signal_dn, t = means.mean_dn - dark.level_dn, frame.exposure_s
    shot_dn = np.maximum(signal_dn, 0.0) + dark.thermal_dn
    return ExposureSignal(
        frame=frame,
        signal_dn_per_s=signal_dn / t,
        noise_variance=noise_variance_dn2(shot_dn, session.rig.camera) / means.pixels / t**2,
        dark_variance=(dark.noise_variance + dark.drift_variance_dn2) / t**2,
        saturated_fraction=means.saturated_fraction,
        block_dn_per_s=(means.block_mean_dn - dark.level_dn) / t,
    )


def merge_exposures(exposures: Sequence[ExposureSignal], repeatability_rel: float) -> StepSignal:
    """Merge the exposures of one step by inverse variance, channel by channel.

    The repeatability acts on the total signal over the total time, the same for all exposures: weights that
    follow each exposure's own noise would favour the dim ones.
    """
    signal, noise, dark, usable = (
        np.array([getattr(e, name) for e in exposures])
        for name in ("signal_dn_per_s", "noise_variance", "dark_variance", "usable")
    )
    times_s = np.array([e.frame.exposure_s for e in exposures])[:, None] * usable
    lost = ~usable.any(axis=0)
    pooled = (signal * times_s).sum(axis=0) / np.where(lost, 1.0, times_s.sum(axis=0))
    weight = np.where(usable, 1 / (noise + dark + (repeatability_rel * pooled) ** 2), 0.0)
    shares = weight / np.where(lost, 1.0, weight.sum(axis=0))
    return StepSignal(
        exposures=tuple(exposures),
        shares=shares,
        signal_dn_per_s=np.where(lost, np.nan, (shares * signal).sum(axis=0)),
        noise_variance=np.where(lost, np.nan, (shares**2 * noise).sum(axis=0)),
    )


def light_repeatability_rel(
    grouped: dict[StepKey, list[ExposureSignal]], fading_per_j: Mapping[StepKey, float] | None = None
) -> float:
    """Return the relative repeatability of one exposure (lamp or laser), from the log ratios within each step.

    Half the mean square of ln(S_later / S_first) beyond photon noise is the variance of one exposure's light level.

    Parameters
    ----------
    grouped
        Signals by step.
    fading_per_j
        Relative loss per joule of the steps that fade under the laser; the ratios are freed of it.
    """
    fading = fading_per_j or {}
    ratios = [pair for key, exposures in grouped.items() for pair in _log_ratios(exposures, fading.get(key, 0.0))]
    pairs = np.array(ratios).reshape(-1, 2)
    bright = pairs[pairs[:, 1] < LARGEST_RATIO_NOISE**2]  # dim steps would only add photon noise
    if len(bright) < FEWEST_RATIOS:
        return ASSUMED_REPEATABILITY_REL
    excess = float(np.mean(bright[:, 0] ** 2 - bright[:, 1])) / 2
    return float(np.sqrt(max(excess, SMALLEST_REPEATABILITY_REL**2)))


def mean_log_ratio(first: ExposureSignal, later: ExposureSignal) -> tuple[float, float] | None:
    """Return ln(S_later / S_first), averaged over well-measured channels, with its noise variance."""
    good = first.usable & later.usable & (first.signal_dn_per_s > 0) & (later.signal_dn_per_s > 0)
    if not good.any():
        return None
    noise = sum((e.noise_variance + e.dark_variance)[good] / e.signal_dn_per_s[good] ** 2 for e in (first, later))
    weight = 1 / np.asarray(noise)
    ratio = np.log(later.signal_dn_per_s[good] / first.signal_dn_per_s[good])
    return float((weight * ratio).sum() / weight.sum()), float(1 / weight.sum())


def _log_ratios(exposures: Sequence[ExposureSignal], loss_per_j: float) -> list[tuple[float, float]]:
    """Return the log ratios of later exposures to the first, freed of fading, with their noise variances."""
    pairs = []
    for later in exposures[1:]:
        pair = mean_log_ratio(exposures[0], later)
        if pair is not None:
            faded = loss_per_j * (later.frame.laser_dose_j - exposures[0].frame.laser_dose_j)
            pairs.append((pair[0] + faded, pair[1]))
    return pairs


Floats32 = NDArray[np.float32]
# First row and column of the four sites of an RGGB cell, and their channel.
SITES = ((0, 0, 0), (0, 1, 1), (1, 0, 1), (1, 1, 2))


@dataclass(frozen=True, slots=True)
class DarkMap:
    """Dark count of every pixel: its offset, the same at all exposures, on a level per exposure time and Bayer site.

    Attributes
    ----------
    offset_dn
        (H, W) deviation of the pixel from its site's level.
    offset_variance_dn2
        Variance of the offset's noise (DN^2).
    level_dn
        Exposure time asked for (s) -> level of the four sites.
    thermal_dn
        Exposure time asked for (s) -> dark current (DN).
    """

    offset_dn: Floats32
    offset_variance_dn2: float
    level_dn: dict[float, list[float]]
    thermal_dn: dict[float, float]

    def subtract(self, counts: Counts, exposure_requested_s: float) -> Floats32:
        """Return the counts above the dark count, shape (H, W)."""
        signal = counts - self.offset_dn
        for (row, column, _), level_dn in zip(SITES, self.level_dn[exposure_requested_s], strict=True):
            signal[row::2, column::2] -= np.float32(level_dn)
        return signal


@dataclass(frozen=True, slots=True)
class PixelStep:
    """Merged signal (DN/s) and its variance, both (H, W); NaN where every exposure is saturated."""

    signal_dn_per_s: Floats32
    variance: Floats32


def dark_map(session: CaptureSession, read: ReadFrame, area: RegionOfInterest) -> DarkMap:
    """Average the dark frames of a session over an area of whole Bayer cells.

    The offsets of all exposure times are pooled: two dark frames alone would add more noise than they remove.
    """
    total = np.zeros((area.height_px, area.width_px))
    levels: dict[float, list[list[float]]] = {}
    frames = [f for f in session.frames if f.frame_type == "dark"]
    for frame in frames:
        counts = cut(read(frame), area)
        sites = [float(counts[row::2, column::2].mean()) for row, column, _ in SITES]
        levels.setdefault(frame.exposure_requested_s, []).append(sites)
        total += counts
        for (row, column, _), level in zip(SITES, sites, strict=True):
            total[row::2, column::2] -= level
    return DarkMap(
        offset_dn=(total / len(frames)).astype(np.float32),
        offset_variance_dn2=float(noise_variance_dn2(0.0, session.rig.camera)) / len(frames),
        level_dn={exposure_s: np.mean(rows, axis=0).tolist() for exposure_s, rows in levels.items()},
        thermal_dn=thermal_levels_dn({exposure_s: float(np.mean(rows)) for exposure_s, rows in levels.items()}),
    )


def cut(frame: Counts, area: RegionOfInterest) -> Counts:
    """Return an area of a frame."""
    return frame[area.row_px : area.row_px + area.height_px, area.column_px : area.column_px + area.width_px]


def merge_pixels(
    frames: Sequence[Frame], read: ReadFrame, area: RegionOfInterest, dark: DarkMap, camera: CameraSettings
) -> PixelStep:
    """Merge the exposures of one step, pixel by pixel.

    Parameters
    ----------
    frames
        The frames of the step.
    read
        Returns the counts of a frame.
    area
        What to cut out of it, in whole Bayer cells.
    dark
        Dark counts of the area.
    camera
        Gain, read noise and bit depth.
    """
    full_scale_dn = 2**camera.bit_depth - 1
    shape = (area.height_px, area.width_px)
    charge, time = np.zeros(shape, np.float32), np.zeros(shape, np.float32)
    for frame in frames:
        counts = cut(read(frame), area)
        usable = counts < full_scale_dn
        charge += usable * dark.subtract(counts, frame.exposure_requested_s)
        time += usable * np.float32(frame.exposure_s)
    with np.errstate(invalid="ignore", divide="ignore"):
        pooled = np.maximum(charge / time, 0.0)
    weighted, total = np.zeros(shape, np.float32), np.zeros(shape, np.float32)
    for frame in frames:
        counts, t = cut(read(frame), area), np.float32(frame.exposure_s)
        in_the_dark = noise_variance_dn2(dark.thermal_dn[frame.exposure_requested_s], camera) + dark.offset_variance_dn2
        variance = pooled * (t / np.float32(camera.gain_e_per_dn)) + np.float32(in_the_dark)
        weight = np.where(counts < full_scale_dn, t * t / variance, np.float32(0.0))
        weighted += weight * (dark.subtract(counts, frame.exposure_requested_s) / t)
        total += weight
    total[total == 0] = np.nan
    return PixelStep(weighted / total, np.reciprocal(total))


def noise_variance_dn2(signal_dn: ArrayLike, camera: CameraSettings) -> NDArray[np.float64]:
    r"""Return the temporal variance of one pixel by the photon transfer relation.

    .. math:: \mathrm{var}(D) = \sigma_r^2 / K^2 + S / K + 1/12

    Valid below saturation. Read noise and gain are those of the camera settings; the gain cancels in the ratios
    that the band signals are, so that its error moves only these variances, all alike.

    Parameters
    ----------
    signal_dn
        Mean count from light and dark current (DN), any shape; negative values count as dark.
    camera
        Its gain K (e/DN) and read noise (e).

    Source: EMVA Standard 1288, release 4.0.
    """
    shot = np.maximum(np.asarray(signal_dn, dtype=np.float64), 0.0) / camera.gain_e_per_dn
    return np.asarray(shot + (camera.read_noise_e / camera.gain_e_per_dn) ** 2 + 1 / 12)
