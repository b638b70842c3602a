r"""One linear signal per capture step: mean over the region, dark-corrected, per second.

For exposure time t the signal of a channel is :math:`S = (\bar D - \bar D_{dark}(t)) / t` in DN/s. The exposures of
a step are merged with inverse-variance weights, where the variance holds noise, dark level and the repeatability of
the light; saturated exposures are left out. Frames are read one at a time and only their means are kept.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from data_schemas.capture import CaptureSession, Frame, FrameType
from data_schemas.errors import RadiometryError
from finray_calib.radiometry.camera_noise import noise_variance_dn2
from finray_calib.radiometry.dark_levels import DarkLevel, ReadFrame
from finray_calib.radiometry.region import RegionMeans, region_means

Floats = NDArray[np.float64]
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
                f"{frame.file}: no dark frame of {frame.exposure_s:g} s; capture darks of the same exposure time"
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
