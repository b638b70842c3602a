"""Noise of a camera from two images of the same scene, so that it can be taken out of squared errors."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

from data_schemas.errors import CompareError

Floats = NDArray[np.float64]
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
    finite: NDArray[np.bool_] = np.asarray(np.isfinite(first + second).all(axis=2))
    whole = cv2.erode(finite.astype(np.uint8), np.ones((3, 3), np.uint8), borderValue=0) > 0
    if whole.sum() < _LEAST_PIXELS:
        raise CompareError(
            f"only {int(whole.sum())} pixels of the two no-contact images can be compared; at least {_LEAST_PIXELS} "
            "are needed to tell the camera's noise: capture with a shorter exposure"
        )
    fits = [_fit(*_squares(first[..., c], second[..., c], finite, whole)) for c in range(first.shape[2])]
    offset, slope = np.array(fits).T
    return CaptureNoise(offset, slope)


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
