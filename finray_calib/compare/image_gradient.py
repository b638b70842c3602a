"""Gradients of images, and the noise in them: Sobel / 8, the central difference averaged 1-2-1 along the edge."""

import cv2
import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
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
    missing = np.pad(~np.isfinite(image).all(axis=2), 1, constant_values=True).astype(np.uint8)
    incomplete = cv2.dilate(missing, np.ones((3, 3), np.uint8))[1:-1, 1:-1] > 0
    finite = np.ascontiguousarray(np.nan_to_num(image, nan=0.0, posinf=0.0, neginf=0.0), dtype=np.float64)
    turns = ((along, across), (across, along))
    both = np.array([cv2.sepFilter2D(finite, -1, *kernels).reshape(image.shape) for kernels in turns])
    both[:, incomplete] = np.nan
    return both
