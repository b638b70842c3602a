"""Average images over square blocks: fewer, quieter numbers where single pixels hold more noise than signal."""

from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
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
    cut = image[: rows * side_px, : columns * side_px]
    return np.asarray(cut.reshape(rows, side_px, columns, side_px, *image.shape[2:]).mean(axis=(1, 3)))
