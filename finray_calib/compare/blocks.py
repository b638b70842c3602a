"""Average images over square blocks, so that the noise of a path-traced render does not pass for its error."""

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
# Render noise of a block beside the contact's own level; the changes that a press makes are some ten times larger.
LARGEST_NOISE_REL = 0.03
LARGEST_BLOCK_PX = 8


def block_side_px(level: Floats, variance: Floats | None, where: NDArray[np.bool_]) -> int:
    """Return the smallest block (1, 2, 4 or 8 px) over which the render's noise falls below 3 % of its level.

    Parameters
    ----------
    level
        (H, W, 3) render.
    variance
        (H, W, 3) variance of each pixel from render noise, independent between pixels; 1 px when None.
    where
        (H, W) pixels that are compared.
    """
    if variance is None or not where.any():
        return 1
    per_channel = np.sqrt(variance[where].mean(axis=0)) / level[where].mean(axis=0)
    noise_rel = float(per_channel.max())
    side = 1
    while side < LARGEST_BLOCK_PX and noise_rel / side > LARGEST_NOISE_REL:
        side *= 2
    return side


def block_mean(image: Floats, side_px: int) -> Floats:
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
