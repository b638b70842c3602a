"""Noise of images: how large a camera's is, what gradients make of it, and blocks of pixels that quiet it.

A camera's noise is told from two images of the same scene, so that it can be taken out of squared errors. Gradients are
Sobel / 8, the central difference averaged 1-2-1 along the edge. Means over square blocks are fewer, quieter numbers
where single pixels hold more noise than signal.
"""

from dataclasses import dataclass
from typing import Any, TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

from data_schemas import CompareError
from finray_calib.compare._regions import every_channel
from finray_calib.spectra import compiled

Floats = NDArray[np.float64]
Blocks = NDArray[np.bool_]
AnyFloats = NDArray[np.floating[Any]]
LEVELS = 20
#: Of a level's largest squares this share is left out, with what a normal distribution has there put back.
_TRIMMED_SHARE = 0.02
# the mean of the squares of a unit normal variable that lie below their 98 % quantile
_TRIMMED_MEAN = 0.8735
_LEAST_PIXELS = 500
# differences of neighbours in both directions: blind to level, drift and slopes; unit noise stays unit noise
_HIGH_PASS = np.array([[1.0, -2.0, 1.0], [-2.0, 4.0, -2.0], [1.0, -2.0, 1.0]]) / 6.0


@dataclass(frozen=True, slots=True)
class CaptureNoise:
    """Variance of one pixel of one image, offset + slope * level, per channel; arrays of shape (C,)."""

    offset: Floats
    slope: Floats

    def variance(self, image: Floats) -> Floats:
        """Return the variance of each pixel of an image (H, W, C) at its own level."""
        if not (self.offset.any() or self.slope.any()):
            return np.zeros(image.shape)
        return np.asarray(self.offset + self.slope * np.maximum(image, 0.0))


NO_NOISE = CaptureNoise(np.zeros(3), np.zeros(3))


def capture_noise(first: Floats, second: Floats) -> CaptureNoise:
    """Fit variance = offset + slope * level to the difference of two images of one scene.

    The difference goes through a high-pass of unit noise gain, which leaves out drift of the light and whatever else
    changes smoothly between the images; half its mean square per level is the variance of one image. Read noise is the
    offset, shot noise the slope. A fixed pattern, which both images share, is no noise here. Noise that neighbouring
    pixels share (JPEG, interpolated colours) is underestimated.

    Parameters
    ----------
    first, second : ndarray, shape (H, W, C)
        Black level removed; NaN where clipped.

    Returns
    -------
    CaptureNoise

    Raises
    ------
    CompareError
        If fewer than 500 pixels with whole neighbourhoods are finite.
    """
    finite = every_channel(np.isfinite(first + second))
    whole = cv2.erode(finite.astype(np.uint8), np.ones((3, 3), np.uint8), borderValue=0) > 0
    if whole.sum() < _LEAST_PIXELS:
        raise CompareError(
            f"only {int(whole.sum())} pixels of the two no-contact images can be compared, but at least "
            f"{_LEAST_PIXELS} are needed to measure the camera's noise; capture with a shorter exposure"
        )
    fits = [_fit(*_squares(first[..., c], second[..., c], finite, whole)) for c in range(first.shape[2])]
    offset, slope = np.array(fits).T
    return CaptureNoise(offset, slope)


def high_passed(image: Floats) -> Floats:
    """Return an image (H, W, C) through the high-pass of unit noise gain; its edge and all beside NaN are NaN."""
    high = cv2.filter2D(image, cv2.CV_64F, _HIGH_PASS).reshape(image.shape)
    high[[0, -1]] = np.nan
    high[:, [0, -1]] = np.nan
    return np.asarray(high)


def _squares(
    first: Floats, second: Floats, finite: NDArray[np.bool_], whole: NDArray[np.bool_]
) -> tuple[Floats, Floats]:
    """Return level and half the square of the high-passed difference of each usable pixel."""
    difference = np.where(finite, second - first, 0.0)
    high = cv2.filter2D(difference, cv2.CV_64F, _HIGH_PASS)
    return ((first + second) / 2.0)[whole], np.asarray(0.5 * high[whole] ** 2, dtype=np.float64)


def _fit(level: Floats, square: Floats) -> tuple[float, float]:
    """Return offset and slope, neither negative, from trimmed means over classes of level."""
    classes = np.array_split(np.argsort(level, kind="stable"), LEVELS)
    means = [_trimmed_mean(square[c]) for c in classes]
    levels = np.array([max(level[c].mean(), 0.0) for c in classes])
    weights = 1.0 / np.maximum(means, max(float(np.mean(means)) * 1e-3, 1e-300))
    design = np.stack([np.ones(LEVELS), levels], axis=1)
    offset, slope = nnls(design * weights[:, None], np.array(means) * weights)[0]
    return float(offset), float(slope)


def _trimmed_mean(square: Floats) -> float:
    """Return the mean of squares of normal noise, robust against a few changed pixels."""
    kept = np.sort(square)[: int(np.ceil((1.0 - _TRIMMED_SHARE) * len(square)))]
    return float(kept.mean() / _TRIMMED_MEAN)


_DIFFERENCE, _AVERAGE = np.array([-0.5, 0.0, 0.5]), np.array([0.25, 0.5, 0.25])
NOISE_EXCESS = (1.0 + 2.0 * 0.5**2) * (1.0 + 2.0 * ((2.0 / 3.0) ** 2 + (1.0 / 6.0) ** 2)) + (5.0 / 6.0) ** 2
"""Sums of squared gradients of noise, both directions together, scatter this much more than of independent numbers,
because neighbours share pixels: the sum of the squared correlations within a direction and between the two."""


def image_gradient(image: NDArray[np.floating]) -> Floats:
    """Return the gradient down the rows and along them, (2, H, W, C), per px.

    NaN at the frame's edge, and where one of the 3 x 3 pixels is not finite in any channel.
    """
    return _filtered(image, _DIFFERENCE, _AVERAGE)


def gradient_variance(variance: Floats) -> Floats:
    """Return the variance (2, H, W, C) of the gradients of an image whose pixels have independent noise."""
    return _filtered(variance, _DIFFERENCE**2, _AVERAGE**2)


def _filtered(image: NDArray[np.floating], across: Floats, along: Floats) -> Floats:
    """Return the image filtered with both turns of a separable kernel."""
    missing = missing_pixels(image)
    finite = np.ascontiguousarray(image, dtype=np.float64)
    if missing is not None:
        finite = np.where(np.isfinite(finite), finite, 0.0)
    both = np.zeros((2, *image.shape))
    if finite.any():
        for turned, kernels in zip(both, ((along, across), (across, along)), strict=True):
            turned[:] = cv2.sepFilter2D(finite, -1, *kernels).reshape(image.shape)
    both[:, _incomplete(missing, image.shape)] = np.nan
    return both


def has_gradient(*images: NDArray[np.floating]) -> NDArray[np.bool_]:
    """Return the pixels (H, W) whose gradient is finite in every image, see :func:`image_gradient`."""
    return ~_incomplete(missing_pixels(*images), images[0].shape)


def _incomplete(missing: NDArray[np.bool_] | None, shape: tuple[int, ...]) -> NDArray[np.bool_]:
    """Return the pixels (H, W) of which one of the 3 x 3 pixels is missing or outside."""
    incomplete = np.ones(shape[:2], dtype=np.bool_)
    incomplete[1:-1, 1:-1] = False
    if missing is not None:
        incomplete |= cv2.dilate(missing.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
    return incomplete


def missing_pixels(*images: NDArray[np.floating]) -> NDArray[np.bool_] | None:
    """Return the pixels (H, W) of which an image (H, W, C) holds a value that is not finite; None without any."""
    # a finite sum tells that all of its terms are finite, at a small part of the time of a look at each
    some = [image for image in images if not np.isfinite(image.sum())]
    if not some:
        return None
    channels = [image[..., c] for image in some for c in range(image.shape[2])]
    missing = ~np.isfinite(channels[0])
    for channel in channels[1:]:
        missing |= ~np.isfinite(channel)
    return missing if missing.any() else None


Image = TypeVar("Image", NDArray[np.float64], NDArray[np.float32])
# blocks this much smaller than the contact's half-width still follow its shape
_BLOCKS_PER_HALF_WIDTH = 4.0


def largest_block_px(distance: Floats) -> int:
    """Return the largest block (1, 2, 4 ... px) that still resolves the contact: a quarter of its half-width.

    Parameters
    ----------
    distance
        (H, W) distance from the contact's centre in half-widths, NaN off the pad.
    """
    slopes = [np.diff(distance, axis=axis)[: distance.shape[0] - 1, : distance.shape[1] - 1] for axis in (0, 1)]
    steepness = np.hypot(*slopes)[distance[:-1, :-1] <= 2.0]
    steepness = steepness[np.isfinite(steepness)]
    if not steepness.size or not np.median(steepness) > 0.0:
        return 1
    half_width_px = 1.0 / float(np.median(steepness))
    return int(2 ** max(0.0, np.floor(np.log2(half_width_px / _BLOCKS_PER_HALF_WIDTH))))


def block_mean(image: Image, side_px: int) -> Image:
    """Return the mean over blocks of `side_px` pixels; incomplete blocks at the far edges are cut off.

    A block with a NaN pixel is NaN.

    Parameters
    ----------
    image
        (H, W) or (H, W, C).
    side_px
        Side of a block.
    """
    if side_px == 1:
        return image
    rows, columns = (n // side_px for n in image.shape[:2])
    mean = np.zeros((rows, columns, *image.shape[2:]), dtype=image.dtype)
    channels = image.shape[2] if image.ndim == 3 else 1
    _sum_blocks(image.reshape(*image.shape[:2], channels), side_px, mean.reshape(rows, columns, channels))
    mean /= side_px**2
    return mean


def mean_level(image: Floats) -> Floats:
    """Return the mean (C,) over the finite pixels of an image (H, W, C)."""
    pixels = image.reshape(-1, image.shape[-1])
    # as products, which take a fraction of the time of numpy's sums over so long an axis
    ones = np.ones(len(pixels))
    mean = ones @ pixels / len(pixels)
    if np.isfinite(mean).all():
        return np.asarray(mean)
    finite = np.isfinite(pixels)
    return np.asarray((ones @ np.where(finite, pixels, 0.0)) / (ones @ finite))


@compiled
def _sum_blocks(image: AnyFloats, side_px: int, sums: AnyFloats) -> None:
    """Add the pixels (H, W, C) of each block to its sum, row by row; numpy takes several times as long."""
    for row in range(sums.shape[0]):
        for i in range(side_px):
            for column in range(sums.shape[1]):
                for j in range(side_px):
                    for channel in range(sums.shape[2]):
                        sums[row, column, channel] += image[row * side_px + i, column * side_px + j, channel]


#: Changes and colours must exceed their noise so many times: from far blocks it is known to about a third.
_CLEARLY = 2.0


def noise_of_change(first: Floats, second: Floats, touched: Floats, where: tuple[Blocks, Blocks]) -> Floats:
    """Return the covariance (3, 3) of what noise adds to ln(touched / first) at some blocks, from others.

    Parameters
    ----------
    first, second, touched : ndarray, shape (blocks, 3)
        Without contact; the same again where only noise and gains differ; with contact.
    where : tuple of bool ndarray
        Blocks at which `second` shows the noise, and those at which it is wanted: noise of one size in DN is larger in
        the logarithm of a darker block.
    """
    (shown, wanted), change = where, np.log(second / first)
    per_dn = [np.hypot(1.0 / image, 1.0 / first) for image in (second, touched)]
    noise_dn = ((change - np.median(change[shown], axis=0)) / per_dn[0])[shown]
    near = per_dn[1][wanted]
    return np.asarray((noise_dn.T @ noise_dn / len(noise_dn)) * (near.T @ near / len(near)))


def noise_free(change: Floats, noise: Floats) -> tuple[Floats, float]:
    """Return the size of a change (blocks, 3) by channel, and how far its channels differ from their mean, over it.

    Noise of the covariance (3, 3) is taken out; what does not exceed it clearly is 0.
    """
    total, own = (change**2).mean(axis=0), np.diag(noise)
    apart = float(((change - change.mean(axis=1, keepdims=True)) ** 2).mean())
    own_apart = float((np.trace(noise) - noise.sum() / 3.0) / 3.0)
    squares = np.where(total > _CLEARLY**2 * own, total - own, 0.0)
    coloured = apart - own_apart if apart > _CLEARLY**2 * own_apart else 0.0
    return np.sqrt(squares), float(np.sqrt(coloured / max(float((total - own).mean()), coloured, 1e-300)))
