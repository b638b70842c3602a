"""One channel of a camera: from stacks of flat and dark frames to the quantities of EMVA 1288."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from data_schemas.camera import (
    ChannelCharacterisation,
    ChannelName,
    PhotonTransferCurve,
    Resolvable,
)
from data_schemas.errors import RadiometryError
from data_schemas.estimate import Estimate
from finray_calib.radiometry.estimates import non_negative, normal_estimate, root_of
from finray_calib.radiometry.frame_stack import StackStatistics
from finray_calib.radiometry.photon_transfer import (
    LARGEST_SATURATED_FRACTION,
    LINE_END,
    LINEARITY_RANGE,
    ROUNDING_VARIANCE_DN2,
    Linearity,
    LineFit,
    PhotonTransfer,
    fit_line,
    linearity,
    nonuniformity,
    photon_transfer,
    require_noise,
    saturation_level,
)

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]
FEWEST_IN_FIT = 5


@dataclass(frozen=True, slots=True)
class ChannelLevels:
    """Stacks of one channel.

    Attributes
    ----------
    exposure_s
        Exposures (s) of the lit stacks, increasing, shape (levels,).
    lit, dark
        The lit stack and the dark stack of every level.
    dark_exposure_s, all_dark
        All dark stacks, those without a lit one among them, and their exposures (s), shape (darks,).
    """

    exposure_s: Floats
    lit: tuple[StackStatistics, ...]
    dark: tuple[StackStatistics, ...]
    dark_exposure_s: Floats
    all_dark: tuple[StackStatistics, ...]

    @property
    def signal_dn(self) -> Floats:
        """Mean above the dark mean of the same exposure (DN), shape (levels,)."""
        return np.array([lit.mean_dn - dark.mean_dn for lit, dark in zip(self.lit, self.dark, strict=True)])


@dataclass(frozen=True, slots=True)
class _Saturation:
    """Where the variance is largest and what follows; all None when no exposure saturates."""

    saturation_dn: Estimate | None = None
    full_well_e: Estimate | None = None
    snr_max: Estimate | None = None
    dynamic_range: Estimate | None = None


@dataclass(frozen=True, slots=True)
class _FixedPattern:
    """Differences between pixels that stay from frame to frame."""

    dsnu_dn: Resolvable
    prnu_rel: Resolvable
    flat_nonuniformity_rel: Resolvable


def characterise_channel(
    name: ChannelName, levels: ChannelLevels, light_repeatability_rel: float
) -> ChannelCharacterisation:
    """Characterise one channel.

    Parameters
    ----------
    name
        The channel.
    levels
        Its stacks.
    light_repeatability_rel
        Relative standard deviation of the light from frame to frame; the linearity error cannot be told from it.

    Raises
    ------
    RadiometryError
        Too few levels are unsaturated and in the range of a fit, or the frames do not vary as photons do.
    """
    peak = saturation_level(levels.lit)
    in_line, in_linearity = _used(name, levels, peak)
    used = [stack for stack, is_used in zip(levels.lit, in_line, strict=True) if is_used]
    require_noise([*levels.all_dark, *used], f"{name} channel")
    black = fit_line(
        levels.dark_exposure_s,
        np.array([s.mean_dn for s in levels.all_dark]),
        np.array([s.mean_sd_dn for s in levels.all_dark]),
    )
    black_level_dn, pattern = float(black.parameters[0]), _fixed_pattern(levels, in_line)
    # The region is a sample of the sensor: the offsets of its pixels do not average out completely.
    black_sd_dn = np.hypot(np.sqrt(black.covariance[0, 0]), pattern.dsnu_dn.estimate / np.sqrt(levels.lit[0].pixels))
    transfer = photon_transfer([*levels.dark, *used], black_level_dn, f"{name} channel")
    top = _Saturation() if peak is None else _saturation(levels, peak, black_level_dn, transfer)
    linear = _linearity(levels, in_linearity, light_repeatability_rel)
    return ChannelCharacterisation(
        channel=name,
        pixels=levels.lit[0].pixels,
        gain_e_per_dn=transfer.gain_e_per_dn,
        read_noise_e=transfer.read_noise_e,
        read_noise_dn=transfer.read_noise_dn,
        black_level_dn=normal_estimate(black_level_dn, float(black_sd_dn)),
        dark_current_e_per_s=_dark_current(black, transfer),
        saturation_dn=top.saturation_dn,
        full_well_e=top.full_well_e,
        snr_max=top.snr_max,
        dynamic_range=top.dynamic_range,
        linearity_error_rel=linear.error_rel,
        linearity_lowest_rel=float(np.nanmin(linear.deviation_rel)),
        linearity_highest_rel=float(np.nanmax(linear.deviation_rel)),
        dsnu_dn=pattern.dsnu_dn,
        prnu_rel=pattern.prnu_rel,
        flat_nonuniformity_rel=pattern.flat_nonuniformity_rel,
        chi_square=transfer.line.chi_square,
        degrees_of_freedom=transfer.line.degrees_of_freedom,
        chi_square_p=transfer.line.chi_square_p,
        curve=_curve(levels, in_line, linear.deviation_rel),
    )


def _used(name: ChannelName, levels: ChannelLevels, peak: int | None) -> tuple[Bools, Bools]:
    """Return the levels of the photon transfer line and those of the linearity fit."""
    signal_dn = levels.signal_dn
    top_dn = float(signal_dn[-1] if peak is None else signal_dn[peak])
    clear = np.array([s.saturated_fraction <= LARGEST_SATURATED_FRACTION for s in levels.lit])
    low, high = LINEARITY_RANGE
    in_line = clear & (signal_dn <= LINE_END * top_dn)
    in_linearity = clear & (signal_dn >= low * top_dn) & (signal_dn <= high * top_dn)
    for used, start in ((in_line, 0.0), (in_linearity, low)):
        if used.sum() < FEWEST_IN_FIT:
            end = LINE_END if used is in_line else high
            raise RadiometryError(
                f"{name} channel: {used.sum()} of {len(used)} exposures give unsaturated counts at {start:.0%} to "
                f"{end:.0%} of saturation, at least {FEWEST_IN_FIT} are needed; {int((~clear).sum())} are saturated: "
                "choose exposures between dark and saturation, a region that the light fills evenly, or another filter "
                "or lamp for this channel"
            )
    return in_line, in_linearity


def _linearity(levels: ChannelLevels, used: Bools, light_repeatability_rel: float) -> Linearity:
    """Fit the linearity line; the noise of a level is that of the light and of the pixels."""
    signal_dn = levels.signal_dn
    light_rel = light_repeatability_rel / np.sqrt([s.frames for s in levels.lit])
    pixels_dn = np.hypot([s.mean_sd_dn for s in levels.lit], [s.mean_sd_dn for s in levels.dark])
    noise_rel = np.zeros_like(signal_dn)
    noise_rel[used] = np.hypot(light_rel[used], pixels_dn[used] / signal_dn[used])
    return linearity(levels.exposure_s, signal_dn, noise_rel, used)


def _dark_current(black: LineFit, transfer: PhotonTransfer) -> Resolvable:
    """Return the growth of the dark mean with exposure (e/s)."""
    gain, slope_dn_per_s = transfer.gain_e_per_dn, float(black.parameters[1])
    sd_e_per_s = float(np.hypot(gain.estimate * np.sqrt(black.covariance[1, 1]), slope_dn_per_s * gain.sd))
    return non_negative(gain.estimate * slope_dn_per_s, sd_e_per_s)


def _saturation(levels: ChannelLevels, peak: int, black_level_dn: float, transfer: PhotonTransfer) -> _Saturation:
    """Return saturation and what follows; the true maximum of the variance lies between the levels beside the peak."""
    mean_dn = [s.mean_dn for s in levels.lit]
    low_dn, saturation_dn, high_dn = mean_dn[max(peak - 1, 0)], mean_dn[peak], max(mean_dn[peak : peak + 2])
    sd_dn = (high_dn - low_dn) / float(np.sqrt(12.0))
    gain, noise = transfer.gain_e_per_dn, transfer.read_noise_dn
    charge_dn = saturation_dn - black_level_dn
    well_e = charge_dn * gain.estimate
    well_sd_e = float(np.hypot(sd_dn * gain.estimate, charge_dn * gain.sd))
    # EMVA's absolute sensitivity threshold in electrons.
    dark_noise_dn = float(np.sqrt(noise.estimate**2 + ROUNDING_VARIANCE_DN2))
    threshold_e = dark_noise_dn * gain.estimate + 0.5
    threshold_sd_e = gain.estimate * noise.estimate * noise.sd / dark_noise_dn
    dynamic_range = well_e / threshold_e
    return _Saturation(
        saturation_dn=Estimate(
            estimate=saturation_dn,
            sd=sd_dn,
            low68=max(saturation_dn - sd_dn, low_dn),
            high68=min(saturation_dn + sd_dn, high_dn),
            low95=low_dn,
            high95=high_dn,
        ),
        full_well_e=normal_estimate(well_e, well_sd_e),
        snr_max=normal_estimate(float(np.sqrt(well_e)), 0.5 * well_sd_e / float(np.sqrt(well_e))),
        dynamic_range=normal_estimate(
            dynamic_range, dynamic_range * float(np.hypot(well_sd_e / well_e, threshold_sd_e / threshold_e))
        ),
    )


def _fixed_pattern(levels: ChannelLevels, usable: Bools) -> _FixedPattern:
    """Return PRNU and DSNU from the stacks with most frames, the brightest of them for PRNU."""
    signal_dn = levels.signal_dn
    level = max(np.flatnonzero(usable), key=lambda i: (levels.lit[i].frames, signal_dn[i]))
    lit, dark = levels.lit[level], levels.dark[level]
    pixel, flat = nonuniformity(lit, dark, "pixel_to_pixel"), nonuniformity(lit, dark, "spatial")
    offset = nonuniformity(max(levels.all_dark, key=lambda s: s.frames), None, "spatial")
    return _FixedPattern(
        dsnu_dn=root_of(offset.variance_dn2, offset.sd_dn2),
        prnu_rel=root_of(pixel.variance_dn2, pixel.sd_dn2, 1.0 / float(signal_dn[level])),
        flat_nonuniformity_rel=root_of(flat.variance_dn2, flat.sd_dn2, 1.0 / float(signal_dn[level])),
    )


def _curve(levels: ChannelLevels, in_line: Bools, deviation_rel: Floats) -> PhotonTransferCurve:
    """Return the photon transfer curve."""
    return PhotonTransferCurve(
        exposure_s=levels.exposure_s,
        mean_dn=np.array([s.mean_dn for s in levels.lit]),
        variance_dn2=np.array([s.variance_dn2 for s in levels.lit]),
        dark_mean_dn=np.array([s.mean_dn for s in levels.dark]),
        dark_variance_dn2=np.array([s.variance_dn2 for s in levels.dark]),
        saturated_fraction=np.array([s.saturated_fraction for s in levels.lit]),
        in_line=in_line,
        deviation_rel=deviation_rel,
    )
