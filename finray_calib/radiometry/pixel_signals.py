r"""Fluorescence of every raw pixel, streamed step by step.

.. math:: y_b(x) = \frac{F_b(x) / W_b(x)}{V P(x)}

with V the laser's level over the region and P the profile of its spot
(:mod:`~finray_calib.radiometry.laser_profile`): the mean of a uniform paint's pixels is the region's band signal.
Sensitivity of the pixels and transmission of the filters cancel. The white tile's texture does not.
"""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from data_schemas.capture import CaptureSession, FrameType, RegionOfInterest
from data_schemas.errors import RadiometryError
from data_schemas.radiometry import BandSignals, PixelSignals
from finray_calib.radiometry.bleaching import bleaching_trend
from finray_calib.radiometry.dark_levels import ReadFrame
from finray_calib.radiometry.laser_level import laser_level
from finray_calib.radiometry.laser_profile import SMALLEST_PIXEL_SNR, SMOOTHING_SD_PX, by_majority, laser_profile
from finray_calib.radiometry.pixel_merge import SITES, DarkMap, PixelStep, dark_map, merge_pixels
from finray_calib.radiometry.region import whole_cells
from finray_calib.radiometry.session_steps import SessionSteps

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
    return whole_cells(session.plan.region)


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
    cells = whole_cells(region)
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
