"""Resample an image on another grid without making up what is missing."""

import cv2
import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]


def warp_image(image: NDArray[np.floating], to_render: Floats, interpolation: int = cv2.INTER_LANCZOS4) -> Floats:
    """Return an image of the render's grid on the capture's grid, in double precision.

    NaN comes where a pixel of the interpolation's window is missing or lies outside; no value is made up. Resample
    linear light only: encoded values are not proportional to it.

    Parameters
    ----------
    image : ndarray, shape (H, W) or (H, W, C)
    to_render : ndarray, shape (2, 3)
        (column, row) of the image = to_render @ (column, row, 1) of the new grid; whole numbers are pixel centres.
    interpolation : int
        OpenCV's flag: Lanczos over 8 x 8 pixels, or ``cv2.INTER_LINEAR`` over 2 x 2 for what must not overshoot.
    """
    planes = np.asarray(image, dtype=np.float64).reshape(*image.shape[:2], -1)
    size = image.shape[1], image.shape[0]
    flags = interpolation | cv2.WARP_INVERSE_MAP
    missing = np.asarray(~np.isfinite(planes).all(axis=2))
    filled = np.where(missing[..., None], 0.0, planes)
    warped = np.stack([cv2.warpAffine(np.ascontiguousarray(p), to_render, size, flags=flags)
                       for p in np.moveaxis(filled, 2, 0)], axis=-1)  # fmt: skip
    reach = 4 if interpolation == cv2.INTER_LANCZOS4 else 1
    warped[_incomplete(missing, to_render, reach)] = np.nan
    return np.asarray(warped.reshape(image.shape), dtype=np.float64)


def _incomplete(missing: Mask, to_render: Floats, reach_px: int) -> Mask:
    """Return where the window around the place in the render touches a missing pixel or the outside."""
    height, width = missing.shape
    rows, columns = np.indices(missing.shape)
    column, row = (m[0] * columns + m[1] * rows + m[2] for m in to_render)
    first_column, first_row = (np.floor(v).astype(int) - reach_px + 1 for v in (column, row))
    whole = np.pad(np.cumsum(np.cumsum(missing, axis=0), axis=1), ((1, 0), (1, 0)))
    last_column, last_row = (np.ceil(v).astype(int) + reach_px for v in (column, row))
    outside = (first_column < 0) | (first_row < 0) | (last_column > width) | (last_row > height)
    left, right = (np.clip(v, 0, width) for v in (first_column, last_column))
    top, bottom = (np.clip(v, 0, height) for v in (first_row, last_row))
    inside_window = whole[bottom, right] - whole[top, right] - whole[bottom, left] + whole[top, left]
    return np.asarray(outside | (inside_window > 0))
