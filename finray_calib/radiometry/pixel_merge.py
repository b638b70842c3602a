r"""Signal of every raw pixel of one step: dark-corrected, exposures merged by inverse variance.

.. math:: S = \frac{\sum_i w_i D_i / t_i}{\sum_i w_i}, \qquad
    w_i = t_i^2 \Big/ \Bigl(\frac{\hat S t_i}{K} + \frac{\sigma_r^2}{K^2} + \frac{1}{12} + \sigma_o^2\Bigr)

with D the count above the dark level (its dark current counts as shot noise) and :math:`\sigma_o` the noise of a
pixel's dark offset. A pixel that is saturated in a long exposure is taken from the shorter ones.
The shot noise in the weights is that of the pooled signal :math:`\hat S = \sum D_i / \sum t_i`; weights from each
exposure's own count would favour the exposures that happened to come out low. Frames are read one at a time (twice),
so that memory does not grow with their number.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from data_schemas.capture import CaptureSession, Frame, RegionOfInterest
from data_schemas.devices import CameraSettings
from finray_calib.radiometry.camera_noise import noise_variance_dn2
from finray_calib.radiometry.dark_levels import ReadFrame, thermal_levels_dn

Floats32 = NDArray[np.float32]
Counts = NDArray[np.uint16]
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
