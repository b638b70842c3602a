"""Error of the change that contact makes, seen through its gradient: what differenced pipelines live on.

Gradients are Sobel / 8: the central difference across two pixels, averaged 1-2-1 along the edge, per pixel.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from data_schemas.errors import CompareError
from finray_calib.compare.regions import usable_pixels

Floats = NDArray[np.float64]
_DIFFERENCE = np.array([-0.5, 0.0, 0.5])
_AVERAGE = np.array([0.25, 0.5, 0.25])


@dataclass(frozen=True, slots=True)
class GradientError:
    """Hold the gradient error over a region.

    Attributes
    ----------
    rms_per_px : float
        Root mean square over pixels and channels.
    per_channel_rms_per_px : ndarray, shape (C,)
    noise_rms_per_px : float
        What noise alone would have given; its square was subtracted. 0 if no variance was given.
    pixels_used : int
    """

    rms_per_px: float
    per_channel_rms_per_px: Floats
    noise_rms_per_px: float
    pixels_used: int


def difference_gradient_error(
    simulated_change: Floats,
    captured_change: Floats,
    level: Floats,
    mask: NDArray[np.bool_],
    noise_variance: Floats | None = None,
) -> GradientError:
    r"""Return the RMS of the gradient of (S - S0) - (D - D0), relative to the level of each channel.

    .. math:: e_c^2 = \langle |\nabla r_c|^2 \rangle / L_c^2, \quad r = (S - S_0) - (D - D_0),
              \quad e^2 = \langle e_c^2 \rangle_c

    With noise that is independent between pixels, :math:`\langle|\nabla r|^2\rangle` is too large by the variance
    filtered with the squared kernels; given `noise_variance` it is subtracted, and what falls below zero is 0.
    Doing nothing is `simulated_change` = 0. Valid for linear light; on encoded values it is a similarity.

    Parameters
    ----------
    simulated_change, captured_change : ndarray, shape (H, W, C)
        S - S0 and D - D0 in one unit.
    level : ndarray, shape (C,)
        What counts as one: mean level of the pad without contact.
    mask : ndarray of bool, shape (H, W)
        A pixel enters where its 3 x 3 window lies in the image and is finite.
    noise_variance : ndarray, shape (H, W, C), optional
        Variance of r: the sum of those of its four images, render noise and shot noise alike.

    Returns
    -------
    GradientError

    Raises
    ------
    CompareError
        If shapes differ, no pixel is usable or a level is not positive.
    """
    squares = gradient_squares(simulated_change - captured_change, level)
    noise = np.zeros_like(squares) if noise_variance is None else gradient_noise(noise_variance, level)
    used = usable_pixels(mask, squares, noise)
    noise_square = noise[used].mean(axis=0)
    per_channel = np.maximum(squares[used].mean(axis=0) - noise_square, 0.0)
    return GradientError(
        rms_per_px=float(np.sqrt(per_channel.mean())),
        per_channel_rms_per_px=np.sqrt(per_channel),
        noise_rms_per_px=float(np.sqrt(noise_square.mean())),
        pixels_used=int(used.sum()),
    )


def gradient_squares(residual: Floats, level: Floats) -> Floats:
    """Return the squared gradient of a residual relative to the level, shape (H, W, C), in 1 / px^2.

    NaN on the border and beside a pixel that is not finite. These are what a block bootstrap resamples.

    Raises
    ------
    CompareError
        If a level is not positive.
    """
    white = _checked_level(level)
    rows, columns = (_filtered(residual, *k) for k in ((_AVERAGE, _DIFFERENCE), (_DIFFERENCE, _AVERAGE)))
    squares = (rows * rows + columns * columns) / white**2
    return _without_incomplete_windows(squares, residual)


def gradient_noise(variance: Floats, level: Floats) -> Floats:
    """Return what noise of this variance adds to `gradient_squares` on average, shape (H, W, C), in 1 / px^2.

    The variance filtered with the squares of the kernels' weights; noise is independent between pixels.

    Raises
    ------
    CompareError
        If a level is not positive.
    """
    white = _checked_level(level)
    difference, average = _DIFFERENCE**2, _AVERAGE**2
    noise = _filtered(variance, average, difference) + _filtered(variance, difference, average)
    return _without_incomplete_windows(noise / white**2, variance)


def _checked_level(level: Floats) -> Floats:
    """Return the level of each channel, or say that it must be positive."""
    white = np.asarray(level, dtype=np.float64)
    if not (white > 0).all():
        raise CompareError(
            f"The level that gradients are relative to must be positive in every channel, got {white.tolist()}: check "
            "the black level and the no-contact image"
        )
    return white


def _filtered(image: Floats, along_columns: Floats, along_rows: Floats) -> Floats:
    """Return the image correlated with a kernel down the columns and one along the rows."""
    finite = np.ascontiguousarray(np.nan_to_num(image, nan=0.0, posinf=0.0, neginf=0.0))
    return np.asarray(cv2.sepFilter2D(finite, -1, along_rows, along_columns), dtype=np.float64).reshape(image.shape)


def _without_incomplete_windows(values: Floats, image: Floats) -> Floats:
    """Put NaN where the 3 x 3 window leaves the image or holds a pixel that is not finite."""
    missing = np.pad(~np.isfinite(image).all(axis=2), 1, constant_values=True).astype(np.uint8)
    values[cv2.dilate(missing, np.ones((3, 3), np.uint8))[1:-1, 1:-1] > 0] = np.nan
    return values
