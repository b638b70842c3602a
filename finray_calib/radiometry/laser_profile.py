r"""Profile of the laser spot from the white reference: laser over lamp through the excitation filter, smoothed.

.. math:: \ln P(x) = p_2(x) + \frac{G * \bigl[w (\ln q_c - \ln \bar q_c - p_2)\bigr]}{G * w}, \qquad q = V / W_e

The pixels' sensitivity and the tile's texture cancel in q, so that only noise is left to remove. The quadratic p_2
is an ideal (Gaussian) spot; without it a kernel would be one-sided, and biased by the spot's slope, where the tile
ends. What a real spot has besides (a clipped edge, rings, a second lobe) the Gaussian kernel G follows, as long as
it is wide against the kernel. All channels tell the same profile, each with its own constant and weight.
"""

import numpy as np
from numpy.typing import NDArray

from finray_calib.radiometry.pixel_merge import PixelStep

Floats32 = NDArray[np.float32]
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
        variance = laser_white.variance / laser_white.signal_dn_per_s**2
        variance += lamp_white.variance / lamp_white.signal_dn_per_s**2
        # The mean of a noisy logarithm lies half its variance too low.
        log_ratio = np.log(ratio / region_ratio.astype(np.float32)[channel]) + 0.5 * variance
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
