"""The gradient magnitude of an image: what two images of one scene share whatever their gain, colour and tone."""

import cv2
import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]
#: Sensor and render noise have their gradients below this scale, the shades of a soft pad above it.
_BLUR_PX = 2.0
_REACH_PX = 9
#: Of a channel's mean; below it the logarithm would show noise.
_DARK_REL = 0.1


def gradient_view(image: Floats) -> tuple[Floats, Mask]:
    """Return the gradient magnitude of the channels' mean logarithm, and where it can be trusted.

    A gain of a channel does not change the logarithm's gradient, a power only its scale, and a shade over the picture
    adds little: what is left are the edges. A dim fluorescent channel counts as much as that of the light.

    Parameters
    ----------
    image : ndarray, shape (H, W, 3)

    Returns
    -------
    magnitude : ndarray, shape (H, W)
        Relative change per pixel, after a blur of 2 px.
    usable : ndarray of bool, shape (H, W)
        False near pixels that are not finite.
    """
    finite = np.asarray(np.isfinite(image).all(axis=2))
    filled = np.where(finite[..., None], image, 0.0)
    level = filled.sum(axis=(0, 1)) / max(int(finite.sum()), 1)
    relative = np.maximum(filled / np.where(level > 0, level, 1.0), 0.0)
    tone = np.where(finite, np.log(relative + _DARK_REL).mean(axis=2), 0.0)
    smooth = cv2.GaussianBlur(tone, (0, 0), _BLUR_PX)
    rows, columns = (cv2.Sobel(smooth, cv2.CV_64F, *order, scale=1 / 8) for order in ((0, 1), (1, 0)))
    near = cv2.dilate((~finite).astype(np.uint8), np.ones((2 * _REACH_PX + 1,) * 2, np.uint8)) > 0
    return np.hypot(rows, columns), ~near
