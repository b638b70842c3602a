"""Square tiles of a region: the units that may be resampled when neighbouring pixels share their error."""

import numpy as np
from numpy.typing import NDArray

from data_schemas.errors import CompareError

#: Fewer tiles cannot show how an error varies over a region; with 12 the spread itself is known to about 20 %.
MINIMUM_TILES = 12


def tile_indices(mask: NDArray[np.bool_], tile_px: int) -> NDArray[np.intp]:
    """Return the number of the tile that each pixel of a mask lies in.

    Parameters
    ----------
    mask : ndarray of bool, shape (H, W)
        Not empty.
    tile_px : int
        Side of a tile, px; the first tile starts at the corner of the mask's bounding box.

    Returns
    -------
    ndarray of int, shape (P,)
        0 ... G - 1 without gaps, for the P pixels in the order of ``image[mask]``.
    """
    rows, columns = np.nonzero(mask)
    row_tile = (rows - rows.min()) // tile_px
    column_tile = (columns - columns.min()) // tile_px
    number = row_tile * (int(column_tile.max()) + 1) + column_tile
    return np.asarray(np.unique(number, return_inverse=True)[1], dtype=np.intp)


def tile_side_px(mask: NDArray[np.bool_], largest_px: int = 16) -> int:
    """Return the largest tile side that still gives enough tiles, halving from `largest_px`.

    Parameters
    ----------
    mask : ndarray of bool, shape (H, W)
    largest_px : int
        Preferred side, px.

    Returns
    -------
    int
        Side, px.

    Raises
    ------
    CompareError
        If the mask has fewer pixels than the least number of tiles.
    """
    pixels = int(mask.sum())
    if pixels < MINIMUM_TILES:
        raise CompareError(
            f"The region has {pixels} usable pixels; an interval needs at least {MINIMUM_TILES}. Use a larger "
            "region or a larger image."
        )
    side = largest_px
    while side > 1 and int(tile_indices(mask, side).max()) + 1 < MINIMUM_TILES:
        side //= 2
    return side
