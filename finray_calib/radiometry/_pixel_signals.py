r"""Fluorescence of every raw pixel, streamed step by step.

.. math:: y_b(x) = \frac{F_b(x) / W_b(x)}{V P(x)}

with V the laser's level over the region and P the profile of its spot: the mean of a uniform paint's pixels is the
region's band signal. Sensitivity of the pixels and transmission of the filters cancel. The white tile's texture does
not.

The profile of the laser spot comes from the white reference: laser over lamp through the excitation filter, smoothed,

.. math:: \ln P(x) = p_2(x) + \frac{G * \bigl[w (\ln q_c - \ln \bar q_c - p_2)\bigr]}{G * w}, \qquad q = V / W_e

The pixels' sensitivity and the tile's texture cancel in q, so that only noise is left to remove. The quadratic p_2
is an ideal (Gaussian) spot; without it a kernel would be one-sided, and biased by the spot's slope, where the tile
ends. What a real spot has besides (a clipped edge, rings, a second lobe) the Gaussian kernel G follows, as long as
it is wide against the kernel. All channels show the same profile, each with its own constant and weight.
"""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from data_schemas import BandSignals, CaptureSession, FrameType, PixelSignals, RadiometryError, RegionOfInterest
from finray_calib.radiometry._session_steps import SessionSteps, bleaching_trend, laser_level
from finray_calib.radiometry._step_signals import (
    SITES,
    DarkMap,
    PixelStep,
    ReadFrame,
    complete_bayer_cells,
    dark_map,
    merge_pixels,
)

Floats32 = NDArray[np.float32]
FEWEST_FILTERS = 4


def pixel_signals(
    session: CaptureSession, read: ReadFrame, steps: SessionSteps, bands: BandSignals, whole_frame: bool = False
) -> PixelSignals:
    """Return the fluorescence of every pixel behind every filter.

    Parameters
    ----------
    session
        A finished paint session.
    read
        Returns the raw counts of a frame of the session.
    steps, bands
        The region's steps and band signals of the same session.
    whole_frame
        Map the whole frame instead of the plan's region.

    Raises
    ------
    RadiometryError
        The laser's profile is nowhere known.
    """
    area = _area(session, whole_frame)
    dark = dark_map(session, read, area)
    channel = channel_map(area)

    def merged(kind: FrameType, name: str) -> PixelStep:
        return _merged(session, read, area, dark, kind, name)

    profile, profile_sd_rel = _profile(session, steps, area, channel, merged)
    level = laser_level(steps, bands.channel_weights)
    trend = bleaching_trend(steps)
    # A pixel's exposures are weighed much like its channel's: the doses of the region serve.
    correction = np.ones((len(steps.names), 3)) if trend is None else trend.correction()
    y = np.empty((len(steps.names), *channel.shape), np.float32)
    sd = np.empty_like(y)
    for b, name in enumerate(steps.names):
        to_y = (correction[b] / level).astype(np.float32)[channel] / profile
        y[b], sd[b] = _ratio(merged("fluorescence", name), merged("white", name), channel, to_y, profile_sd_rel)
    usable = np.isfinite(profile) & (np.isfinite(y).sum(axis=0) >= min(FEWEST_FILTERS, len(y)))
    variance = np.diag(bands.fluorescence_covariance).reshape(-1, 3)
    for array in (y, sd, channel, usable, profile, profile_sd_rel):
        array.flags.writeable = False  # the record then keeps them without a copy
    return PixelSignals(
        paint_name=bands.paint_name,
        optics=bands.optics,
        area=area,
        fluorescence=y,
        fluorescence_sd=sd,
        channel=channel,
        usable=usable,
        profile=profile,
        profile_sd_rel=profile_sd_rel,
        common_sd_rel=np.sqrt(variance) / np.where(bands.usable(), np.abs(bands.fluorescence), np.nan),
        channel_weights=bands.channel_weights,
        notes=(*bands.notes, f"laser profile smoothed with a Gaussian of {SMOOTHING_SD_PX:g} px standard deviation"),
    )


def channel_map(area: RegionOfInterest) -> NDArray[np.uint8]:
    """Return the Bayer channel (0 red, 1 green, 2 blue) of every pixel of an area of whole cells, shape (H, W)."""
    channel = np.empty((area.height_px, area.width_px), np.uint8)
    for row, column, c in SITES:
        channel[row::2, column::2] = c
    return channel


def _area(session: CaptureSession, whole_frame: bool) -> RegionOfInterest:
    """Return the area of the map in whole Bayer cells."""
    camera = session.rig.camera
    if whole_frame:
        return RegionOfInterest(row_px=0, column_px=0, height_px=camera.height_px, width_px=camera.width_px)
    return complete_bayer_cells(session.plan.region)


def _merged(
    session: CaptureSession, read: ReadFrame, area: RegionOfInterest, dark: DarkMap, kind: FrameType, name: str
) -> PixelStep:
    """Merge the exposures of one frame type and filter."""
    frames = [f for f in session.frames if (f.frame_type, f.filter_name) == (kind, name)]
    return merge_pixels(frames, read, area, dark, session.rig.camera)


def _profile(
    session: CaptureSession,
    steps: SessionSteps,
    area: RegionOfInterest,
    channel: NDArray[np.uint8],
    merged: Callable[[FrameType, str], PixelStep],
) -> tuple[Floats32, Floats32]:
    """Return the laser's profile over the area and its relative standard deviation."""
    name, white = session.plan.excitation_filter, steps.white[steps.excitation].signal_dn_per_s
    usable = (steps.laser_white.signal_dn_per_s > 0) & (white > 0)
    region_ratio = np.where(usable, steps.laser_white.signal_dn_per_s / np.where(usable, white, 1.0), np.nan)
    profile, sd_rel = laser_profile(
        merged("laser white", name), merged("white", name), channel, region_ratio, _inside(area, session.plan.region)
    )
    if not np.isfinite(profile).any():
        raise RadiometryError(
            f"the white reference under the laser is too dim in every pixel (signal-to-noise ratio below "
            f"{SMALLEST_PIXEL_SNR:g}) to map the laser spot; brighten the laser or raise plan.target_fraction"
        )
    return profile, sd_rel


def _inside(area: RegionOfInterest, region: RegionOfInterest) -> NDArray[np.bool_]:
    """Return the mask of the region in an area that contains it."""
    inside = np.zeros((area.height_px, area.width_px), dtype=bool)
    cells = complete_bayer_cells(region)
    top, left = cells.row_px - area.row_px, cells.column_px - area.column_px
    inside[top : top + cells.height_px, left : left + cells.width_px] = True
    return inside


def _ratio(
    laser: PixelStep, white: PixelStep, channel: NDArray[np.uint8], to_y: Floats32, profile_sd_rel: Floats32
) -> tuple[Floats32, Floats32]:
    """Return y and its standard deviation of one filter; NaN where the white is too dim to divide by."""
    bright = by_majority(white.signal_dn_per_s > SMALLEST_PIXEL_SNR * np.sqrt(white.variance), channel)
    w = np.where(bright, white.signal_dn_per_s, np.float32(np.nan))
    white_rel = white.variance / w**2
    # The mean of 1 / W lies above 1 / mean(W) by the relative variance of W.
    scale = to_y / (w * (1 + white_rel))
    y = laser.signal_dn_per_s * scale
    variance = laser.variance * scale**2 + y**2 * (white_rel + profile_sd_rel**2)
    lost = ~np.isfinite(y)
    variance[lost], y[lost] = np.nan, np.nan
    return y.astype(np.float32), np.sqrt(variance).astype(np.float32)


SMOOTHING_SD_PX = 6.0
# Below this signal-to-noise ratio the logarithm of a pixel's ratio is biased by more than half a per cent.
SMALLEST_PIXEL_SNR = 10.0
# ... and pixels count only where at least this share of their channel's neighbours reaches it.
SMALLEST_GOOD_SHARE = 0.9
NEIGHBOURHOOD_PX = 9
# The profile is known where at least this share of the kernel's weight is.
SMALLEST_SUPPORT = 0.2


def laser_profile(
    laser_white: PixelStep,
    lamp_white: PixelStep,
    channel: NDArray[np.uint8],
    region_ratio: NDArray[np.float64],
    inside: NDArray[np.bool_],
) -> tuple[Floats32, Floats32]:
    """Return the profile (1 on the mean over the region) and its relative standard deviation.

    Parameters
    ----------
    laser_white, lamp_white
        The white reference under the laser and under the lamp through the excitation filter, (H, W).
    channel
        (H, W) Bayer channel of each pixel, 0 to 2.
    region_ratio
        (3,) laser over lamp of each channel over the region; NaN where it is lost.
    inside
        (H, W) True in the region.

    Returns
    -------
    tuple of ndarray
        (H, W) each; NaN where the laser does not reach.
    """
    from scipy.ndimage import gaussian_filter

    with np.errstate(invalid="ignore", divide="ignore"):
        ratio = laser_white.signal_dn_per_s / lamp_white.signal_dn_per_s
        of_laser = laser_white.variance / laser_white.signal_dn_per_s**2
        of_lamp = lamp_white.variance / lamp_white.signal_dn_per_s**2
        variance = of_laser + of_lamp
        # The mean of a noisy logarithm lies half its variance too low, and the lamp's is subtracted.
        log_ratio = np.log(ratio / region_ratio.astype(np.float32)[channel]) + 0.5 * (of_laser - of_lamp)
    positive = (laser_white.signal_dn_per_s > 0) & (lamp_white.signal_dn_per_s > 0)
    good = by_majority(positive & np.isfinite(log_ratio) & (variance < SMALLEST_PIXEL_SNR**-2), channel)
    weight = np.zeros(channel.shape, np.float32)
    for c in range(3):  # one weight for a whole channel: weights that follow the spot would tilt its slopes
        pixels = good & (channel == c)
        if pixels.any():
            weight[pixels] = 1 / np.median(variance[pixels])
    spot = _quadratic(np.where(good, log_ratio, 0.0), weight)
    log_ratio -= spot
    support = gaussian_filter(weight, SMOOTHING_SD_PX)
    known = support > SMALLEST_SUPPORT * support.max() if good.any() else good
    with np.errstate(invalid="ignore", divide="ignore"):
        smooth = gaussian_filter(weight * np.where(good, log_ratio, 0.0), SMOOTHING_SD_PX) / support
        spread = gaussian_filter(weight**2 * np.where(good, variance, 0.0), SMOOTHING_SD_PX / np.sqrt(2.0))
        sd = np.sqrt(spread / (4.0 * np.pi * SMOOTHING_SD_PX**2)) / support
        profile = np.exp(spot + smooth)
    profile /= _region_mean(profile, lamp_white.signal_dn_per_s, inside & known & good)
    nan = np.float32(np.nan)
    return np.where(known, profile, nan).astype(np.float32), np.where(known, sd, nan).astype(np.float32)


def by_majority(good: NDArray[np.bool_], channel: NDArray[np.uint8]) -> NDArray[np.bool_]:
    """Keep a pixel when it and nearly all pixels of its channel around it are good.

    Where most pixels are too dim, the few that pass came out bright by chance, and their ratios are biased.

    Parameters
    ----------
    good
        (H, W) pixels that pass a limit on their own noisy signal.
    channel
        (H, W) Bayer channel, 0 to 2.
    """
    from scipy.ndimage import uniform_filter

    kept = np.zeros(good.shape, dtype=bool)
    for c in range(3):
        there = channel == c
        if (good & there).any():
            passed = uniform_filter((good & there).astype(np.float32), NEIGHBOURHOOD_PX)
            kept |= (
                good
                & there
                & (passed > SMALLEST_GOOD_SHARE * uniform_filter(there.astype(np.float32), NEIGHBOURHOOD_PX))
            )
    return kept


def _quadratic(log_ratio: Floats32, weight: Floats32) -> Floats32:
    """Return the quadratic in row and column that fits the logarithm of the profile best, (H, W)."""
    height, width = weight.shape
    row, column = np.linspace(-1, 1, height, dtype=np.float32)[:, None], np.linspace(-1, 1, width, dtype=np.float32)
    terms = [np.broadcast_to(t, weight.shape) for t in (np.float32(1), row, column, row**2, row * column, column**2)]
    normal = np.array([[np.vdot(weight * a, b) for b in terms] for a in terms], dtype=np.float64)
    right = np.array([np.vdot(weight * a, log_ratio) for a in terms], dtype=np.float64)
    coefficients = np.linalg.lstsq(normal, right, rcond=None)[0].astype(np.float32)
    fitted: Floats32 = np.zeros(weight.shape, np.float32)
    for coefficient, term in zip(coefficients, terms, strict=True):
        fitted += coefficient * term
    return fitted


def _region_mean(profile: Floats32, lamp: Floats32, pixels: NDArray[np.bool_]) -> float:
    """Return the profile's mean over the region, weighted with the lamp's signal as the region's ratio is."""
    if not pixels.any():
        return 1.0
    return float(np.average(profile[pixels], weights=lamp[pixels]))
