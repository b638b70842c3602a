"""Characterise a camera from a camera session: frames by exposure, channel by channel, to EMVA 1288 quantities."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaincc

from data_schemas import (
    FEWEST_LEVELS,
    CameraCharacterisation,
    CameraSession,
    CaptureSession,
    ChannelCharacterisation,
    ChannelName,
    Estimate,
    Frame,
    FrameType,
    PhotonTransferCurve,
    RadiometryError,
    Resolvable,
)
from finray_calib.radiometry._photon_transfer import (
    LARGEST_SATURATED_FRACTION,
    LINE_END,
    LINEARITY_RANGE,
    ROUNDING_VARIANCE_DN2,
    SMALLEST_CHI_SQUARE_P,
    FrameStack,
    Linearity,
    LineFit,
    PhotonTransfer,
    Sites,
    SpatialVariance,
    StackStatistics,
    fit_line,
    linearity,
    non_negative,
    nonuniformity,
    normal_estimate,
    photon_transfer,
    require_noise,
    root_of,
    saturation_level,
)
from finray_calib.radiometry._step_signals import complete_bayer_cells, cut

ReadCounts = Callable[[Frame], NDArray[np.uint16]]
CHANNELS: dict[str, dict[ChannelName, Sites]] = {
    "RGGB": {"red": ((0, 0, 2),), "green": ((0, 1, 2), (1, 0, 2)), "blue": ((1, 1, 2),)},
}
# EMVA 1288 asks for an offset at which at most 0.5 % of the dark counts fall to zero.
LARGEST_EMPTY_FRACTION = 0.005
# A smaller dark variance is mostly that of rounding (EMVA 1288).
SMALLEST_DARK_VARIANCE_DN2 = 0.24


@dataclass(frozen=True, slots=True)
class _Stack:
    """Equal exposures: exposure time and the statistics of every channel."""

    exposure_s: float
    channels: tuple[StackStatistics, ...]


def characterise_camera(session: CameraSession, read: ReadCounts) -> CameraCharacterisation:
    """Turn a camera session into gain, noise, dark current, saturation, linearity, PRNU and DSNU of every channel.

    Frames are read one at a time; memory does not grow with their number.

    Parameters
    ----------
    session
        A finished camera session.
    read
        Returns the raw counts of a frame of the session (checks its checksum).

    Raises
    ------
    RadiometryError
        Too few exposures, no dark frames, a channel that is saturated everywhere, frames without noise or of
        unequal size.
    """
    sites = CHANNELS[session.rig.camera.bayer_pattern]
    lit = _stacks(session, "white", tuple(sites.values()), read)
    dark = _stacks(session, "dark", tuple(sites.values()), read)
    _require_levels(lit, dark)
    repeatability_rel = _repeatability_rel(lit, dark)
    channels = []
    for index, name in enumerate(sites):
        levels = ChannelLevels(
            exposure_s=np.array([stack.exposure_s for stack in lit.values()]),
            lit=tuple(stack.channels[index] for stack in lit.values()),
            dark=tuple(dark[asked_s].channels[index] for asked_s in lit),
            dark_exposure_s=np.array([stack.exposure_s for stack in dark.values()]),
            all_dark=tuple(stack.channels[index] for stack in dark.values()),
        )
        channels.append(characterise_channel(name, levels, repeatability_rel))
    empty_fraction = max(s.empty_fraction for stack in dark.values() for s in stack.channels)
    return CameraCharacterisation(
        camera_name=session.plan.camera_name,
        camera=session.rig.camera,
        filter_name=session.plan.filter_name,
        channels=tuple(channels),
        light_repeatability_rel=repeatability_rel,
        warnings=_warnings(channels, empty_fraction),
        notes=session.notes,
    )


def _stacks(
    session: CameraSession, frame_type: FrameType, sites: tuple[Sites, ...], read: ReadCounts
) -> dict[float, _Stack]:
    """Return the stacks of one frame type by the exposure that was asked for (s), in its order."""
    grouped: dict[float, list[Frame]] = {}
    for frame in session.frames:
        if frame.frame_type == frame_type:
            grouped.setdefault(frame.exposure_requested_s, []).append(frame)
    full_scale_dn, region = 2**session.rig.camera.bit_depth - 1, complete_bayer_cells(session.plan.region)
    stacks = {}
    for asked_s, frames in sorted(grouped.items()):
        stack = FrameStack(f"{frame_type} frames of {asked_s:g} s", sites, full_scale_dn)
        for frame in frames:
            stack.add(cut(read(frame), region))
        stacks[asked_s] = _Stack(float(np.mean([f.exposure_s for f in frames])), stack.statistics())
    return stacks


def _require_levels(lit: dict[float, _Stack], dark: dict[float, _Stack]) -> None:
    """Refuse too few exposures, and flat frames without dark ones of the same exposure."""
    if len(lit) < FEWEST_LEVELS:
        raise RadiometryError(
            f"session.frames: has flat frames at only {len(lit)} exposures, but at least {FEWEST_LEVELS} exposures "
            "are needed; raise plan.levels and capture again"
        )
    lost = [asked_s for asked_s in lit if asked_s not in dark]
    if lost:
        raise RadiometryError(
            f"session.frames: dark frames are missing at {', '.join(f'{t:g} s' for t in lost[:3])} ({len(lost)} of "
            f"{len(lit)} exposures lack them); capture dark frames at every exposure of the flat frames"
        )


def _repeatability_rel(lit: dict[float, _Stack], dark: dict[float, _Stack]) -> float:
    """Return the relative standard deviation of the light from frame to frame, without the pixels' noise."""
    excess, freedom = 0.0, 0
    for asked_s, stack in lit.items():
        pairs = [
            (c, d) for c, d in zip(stack.channels, dark[asked_s].channels, strict=True) if c.saturated_fraction == 0
        ]
        if not pairs:
            continue
        bright, black = max(pairs, key=lambda pair: pair[0].mean_dn)
        signal_dn = bright.mean_dn - black.mean_dn
        if signal_dn > 0.0:
            flicker_dn2 = float(np.var(bright.frame_means_dn, ddof=1)) - bright.variance_dn2 / bright.pixels
            excess += (bright.frames - 1) * flicker_dn2 / signal_dn**2
            freedom += bright.frames - 1
    return float(np.sqrt(max(excess, 0.0) / max(freedom, 1)))


def _warnings(channels: list[ChannelCharacterisation], empty_fraction: float) -> tuple[str, ...]:
    """Say in words what a user must know before trusting the numbers."""
    warnings = []
    for c in channels:
        if c.chi_square_p < SMALLEST_CHI_SQUARE_P:
            warnings.append(
                f"{c.channel}: variance against mean is not a straight line (chi-square {c.chi_square:.0f} for "
                f"{c.degrees_of_freedom} degrees of freedom), so intervals of gain and read noise are widened; look "
                "for gamma, noise reduction or a drifting lamp"
            )
        if c.saturation_dn is None:
            warnings.append(f"{c.channel}: no exposure saturates, so saturation and dynamic range are not known")
        if np.median(c.curve.dark_variance_dn2) < SMALLEST_DARK_VARIANCE_DN2:
            warnings.append(
                f"{c.channel}: the dark variance is below {SMALLEST_DARK_VARIANCE_DN2:g} DN^2, where rounding hides "
                "the read noise; raise the camera's gain or bit depth to resolve it"
            )
    if empty_fraction > LARGEST_EMPTY_FRACTION:
        warnings.append(
            f"{100 * empty_fraction:.1f} % of the dark counts are 0 (at most {100 * LARGEST_EMPTY_FRACTION:.1f} % is "
            "allowed), so the read noise is underestimated; raise the camera's black level"
        )
    gain = np.array([c.gain_e_per_dn.estimate for c in channels])
    weight = np.array([1.0 / c.gain_e_per_dn.sd**2 for c in channels])
    chi_square = float(np.sum(weight * (gain - np.average(gain, weights=weight)) ** 2))
    if len(channels) > 1 and gammaincc(0.5 * (len(channels) - 1), 0.5 * chi_square) < SMALLEST_CHI_SQUARE_P:
        warnings.append(
            "the channels differ in gain ("
            + ", ".join(f"{c.channel} {c.gain_e_per_dn.estimate:.3f} e/DN" for c in channels)
            + "); check that no white balance is applied to the raw frames"
        )
    return tuple(warnings)


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
    dsnu_rows_dn: Resolvable
    dsnu_columns_dn: Resolvable
    dsnu_pixels_dn: Resolvable
    prnu_rel: Resolvable
    prnu_rows_rel: Resolvable
    prnu_columns_rel: Resolvable
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
        Relative standard deviation of the light from frame to frame; the linearity error is not distinguishable from
        it.

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
        dsnu_rows_dn=pattern.dsnu_rows_dn,
        dsnu_columns_dn=pattern.dsnu_columns_dn,
        dsnu_pixels_dn=pattern.dsnu_pixels_dn,
        prnu_rel=pattern.prnu_rel,
        prnu_rows_rel=pattern.prnu_rows_rel,
        prnu_columns_rel=pattern.prnu_columns_rel,
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
                f"{name} channel: only {used.sum()} of {len(used)} exposures give unsaturated counts at "
                f"{100 * start:.0f} % to {100 * end:.0f} % of saturation, but at least {FEWEST_IN_FIT} are needed "
                f"({int((~clear).sum())} "
                "are saturated); choose exposures between dark and saturation, a region that the light fills evenly, "
                "or another filter or lamp for this channel"
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
    threshold_e = sensitivity_threshold_e(gain, noise).estimate
    threshold_sd_e = gain.estimate**2 * noise.estimate * noise.sd / (threshold_e - 0.5)
    dynamic_range = well_e / threshold_e
    # the gain is in well and threshold alike, and cancels but for the 1/2 of the threshold
    gain_rel = 0.5 / threshold_e * gain.sd / gain.estimate
    range_sd_rel = float(np.sqrt((sd_dn / charge_dn) ** 2 + gain_rel**2 + (threshold_sd_e / threshold_e) ** 2))
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
        dynamic_range=normal_estimate(dynamic_range, dynamic_range * range_sd_rel),
    )


def sensitivity_threshold_e(gain_e_per_dn: Estimate, read_noise_dn: Estimate) -> Estimate:
    r"""Return the least charge that a pixel detects (e): the absolute sensitivity threshold of EMVA 1288.

    .. math:: \mu_{e,\min} = \sqrt{\sigma_d^2 + \sigma_q^2} / K + 1/2, \quad \sigma_q^2 = 1/12

    with the gain 1/K in electrons per count. Gain and noise are taken as independent.

    Parameters
    ----------
    gain_e_per_dn
        Gain (e/DN).
    read_noise_dn
        Temporal dark noise without that of rounding (DN).
    """
    gain, noise = gain_e_per_dn, read_noise_dn
    dark_noise_dn = float(np.sqrt(noise.estimate**2 + ROUNDING_VARIANCE_DN2))
    sd_e = float(np.hypot(gain.sd * dark_noise_dn, gain.estimate * noise.estimate * noise.sd / dark_noise_dn))
    return normal_estimate(dark_noise_dn * gain.estimate + 0.5, sd_e)


def _fixed_pattern(levels: ChannelLevels, usable: Bools) -> _FixedPattern:
    """Return PRNU and DSNU: from the lit stack with the least shot noise, and the dark stack with most frames."""
    signal_dn = levels.signal_dn
    level = max(np.flatnonzero(usable), key=lambda i: levels.lit[i].frames * signal_dn[i])
    lit, dark = levels.lit[level], levels.dark[level]
    pixel, flat = nonuniformity(lit, dark, "pixel_to_pixel"), nonuniformity(lit, dark, "spatial")
    darkest = max(levels.all_dark, key=lambda s: s.frames)

    def offset(found: SpatialVariance) -> Resolvable:
        return root_of(found.variance_dn2, found.sd_dn2)

    def response(found: SpatialVariance) -> Resolvable:
        return root_of(found.variance_dn2, found.sd_dn2, 1.0 / float(signal_dn[level]))

    return _FixedPattern(
        dsnu_dn=offset(nonuniformity(darkest, None, "spatial")),
        dsnu_rows_dn=offset(nonuniformity(darkest, None, "rows")),
        dsnu_columns_dn=offset(nonuniformity(darkest, None, "columns")),
        dsnu_pixels_dn=offset(nonuniformity(darkest, None, "pixels")),
        prnu_rel=response(pixel),
        prnu_rows_rel=response(nonuniformity(lit, dark, "row_to_row")),
        prnu_columns_rel=response(nonuniformity(lit, dark, "column_to_column")),
        flat_nonuniformity_rel=response(flat),
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


def with_camera(session: CaptureSession, measured: CameraCharacterisation) -> CaptureSession:
    """Return a session with the gain, read noise and black level of a characterised camera; its notes say so."""
    camera = measured.applied_to(session.rig.camera)
    note = (
        f"camera characterisation '{measured.camera_name}' used: gain {camera.gain_e_per_dn:.4g} e/DN, read noise "
        f"{camera.read_noise_e:.3g} e, black level {camera.black_level_dn:.4g} DN"
    )
    rig = session.rig.model_copy(update={"camera": camera})
    return session.model_copy(update={"rig": rig, "notes": (*session.notes, note)})
