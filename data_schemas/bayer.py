"""Colour patterns of Bayer sensors, and the frame that begins with red."""

from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

BayerOrder = Literal["RGGB", "BGGR", "GRBG", "GBRG"]
"""Colours of the first 2 x 2 pixels, row by row."""
FIRST_RED: Final[dict[BayerOrder, tuple[int, int]]] = {"RGGB": (0, 0), "GRBG": (0, 1), "GBRG": (1, 0), "BGGR": (1, 1)}
"""Rows and columns to leave out at the start, so that the frame begins with red."""


def rggb_frame(counts: NDArray[np.uint16], order: BayerOrder) -> NDArray[np.uint16]:
    """Return a Bayer frame that begins with red and has whole 2 x 2 cells, by cutting off rows and columns.

    Parameters
    ----------
    counts
        (H, W) raw counts (DN).
    order
        Colours of the first 2 x 2 pixels, row by row.
    """
    row, column = FIRST_RED[order]
    height, width = ((n - first) // 2 * 2 for n, first in zip(counts.shape, (row, column), strict=True))
    return np.ascontiguousarray(counts[row : row + height, column : column + width])
