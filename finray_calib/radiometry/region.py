"""The painted region of a raw Bayer frame, channel by channel."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from data_schemas.capture import RegionOfInterest
from data_schemas.errors import RadiometryError

Counts = NDArray[np.uint16]
Floats = NDArray[np.float64]
SMALLEST_SIDE_PX = 4
# The region is also averaged in 4 x 4 blocks: their scatter shows how uniform the paint is.
BLOCKS_PER_SIDE = 4


@dataclass(frozen=True, slots=True)
class RegionMeans:
    """Means of one frame over the region, channels red, green, blue.

    Attributes
    ----------
    mean_dn
        (3,) mean count.
    saturated_fraction
        (3,) share of the pixels at full scale.
    pixels
        (3,) number of pixels.
    block_mean_dn
        (blocks, 3) mean count of each block.
    """

    mean_dn: Floats
    saturated_fraction: Floats
    pixels: Floats
    block_mean_dn: Floats


def whole_cells(region: RegionOfInterest) -> RegionOfInterest:
    """Return the region in whole 2 x 2 Bayer cells: first row, first column and size rounded down to even numbers."""
    values = region.model_dump()
    return RegionOfInterest(**{name: value & ~1 for name, value in values.items()})


def region_channels(frame: Counts, region: RegionOfInterest) -> tuple[Counts, Counts, Counts]:
    """Return the red, green and blue samples (DN) of a region of an RGGB frame, each flattened.

    The region is taken as whole 2 x 2 Bayer cells. Green holds both greens of a cell.

    Raises
    ------
    RadiometryError
        The region is empty, smaller than 4 x 4 px, or reaches beyond the frame.
    """
    cut = _cut(frame, region)
    green = np.concatenate([cut[0::2, 1::2].ravel(), cut[1::2, 0::2].ravel()])
    return cut[0::2, 0::2].ravel(), green, cut[1::2, 1::2].ravel()


def region_means(frame: Counts, region: RegionOfInterest, full_scale_dn: int) -> RegionMeans:
    """Reduce one frame to its means over the region and over the region's blocks.

    Raises
    ------
    RadiometryError
        The region is empty, smaller than 4 x 4 px, or reaches beyond the frame.
    """
    channels = region_channels(frame, region)
    cut = _cut(frame, region)
    rows, columns = (np.linspace(0, size // 2, _blocks(size) + 1).astype(int) * 2 for size in cut.shape)
    blocks = []
    for top, bottom in pairwise(rows):
        for left, right in pairwise(columns):
            block = cut[top:bottom, left:right]
            green = 0.5 * (block[0::2, 1::2].mean() + block[1::2, 0::2].mean())
            blocks.append((block[0::2, 0::2].mean(), green, block[1::2, 1::2].mean()))
    return RegionMeans(
        mean_dn=np.array([c.mean() for c in channels]),
        saturated_fraction=np.array([(c >= full_scale_dn).mean() for c in channels]),
        pixels=np.array([float(c.size) for c in channels]),
        block_mean_dn=np.array(blocks),
    )


def _blocks(side_px: int) -> int:
    """Return the number of blocks along a side: at most one per Bayer cell."""
    return min(BLOCKS_PER_SIDE, side_px // 2)


def _cut(frame: Counts, region: RegionOfInterest) -> Counts:
    """Return the whole Bayer cells of the region after checking it."""
    cells = whole_cells(region)
    top, left, height, width = cells.row_px, cells.column_px, cells.height_px, cells.width_px
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
    return frame[top : top + height, left : left + width]
