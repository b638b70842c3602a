"""The painted region of a raw Bayer frame, channel by channel."""

import numpy as np
from numpy.typing import NDArray

from data_schemas.capture import RegionOfInterest
from data_schemas.errors import RadiometryError

Counts = NDArray[np.uint16]
SMALLEST_SIDE_PX = 4


def region_channels(frame: Counts, region: RegionOfInterest) -> tuple[Counts, Counts, Counts]:
    """Return the red, green and blue samples (DN) of a region of an RGGB frame, each flattened.

    The region is taken as whole 2 x 2 Bayer cells: its first row and column are rounded down to even
    numbers, its size likewise. Green holds both greens of a cell.

    Raises
    ------
    RadiometryError
        The region is empty, smaller than 4 x 4 px, or reaches beyond the frame.
    """
    top, left = region.row_px & ~1, region.column_px & ~1
    height, width = region.height_px & ~1, region.width_px & ~1
    rows, columns = frame.shape
    if height < SMALLEST_SIDE_PX or width < SMALLEST_SIDE_PX:
        raise RadiometryError(
            f"plan.region: {region.height_px} x {region.width_px} px is empty or too small; it needs at least "
            f"{SMALLEST_SIDE_PX} x {SMALLEST_SIDE_PX} px of paint: correct height_px and width_px"
        )
    if top + height > rows or left + width > columns:
        raise RadiometryError(
            f"plan.region: rows {top} to {top + height} and columns {left} to {left + width} px reach beyond the "
            f"frame of {rows} x {columns} px"
        )
    cut = frame[top : top + height, left : left + width]
    green = np.concatenate([cut[0::2, 1::2].ravel(), cut[1::2, 0::2].ravel()])
    return cut[0::2, 0::2].ravel(), green, cut[1::2, 1::2].ravel()
