r"""How far the picture of a target moved between two raw frames, to a hundredth of a pixel, with its uncertainty.

Both frames are reduced to one value for each 2 x 2 Bayer cell. A whole number of cells comes from the maximum of their
cross-correlation; the rest d from least squares on the overlap, with the gradients g of the mean of both frames, which
are free of a gradient's own shift to second order:

.. math:: (G^T G - n \kappa \nu) d = -G^T (b - a), \quad \nu = c_0 - (15 c_1 - 6 c_2 + c_3) / 10

where a and b are the two frames, n is the number of cells, c_h the autocovariance of the mean frame at a distance of h
cells and :math:`\kappa` the sum of squares of the derivative's weights. :math:`\nu` is the part of the variance that no
lens can make: photon noise, and the sensor's pattern of cells that differ from their neighbours. That pattern stays
where it is when the picture moves, and must not count as texture of the target. Dust and stains that are wider than a
cell do count, and pull the shift to zero: two frames do not tell them from the target.
"""

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import correlate1d, gaussian_filter

from data_schemas import PictureShift

Floats = NDArray[np.float64]

SMOOTH_CELLS: Final = 8.0
"""Structures that are wider come from the lamp, which does not move with the picture."""
LARGEST_CELLS: Final = 16
"""Shifts beyond it are not looked for."""
DERIVATIVE: Final = (1.0 / 12.0, -8.0 / 12.0, 0.0, 8.0 / 12.0, -1.0 / 12.0)
LEAST_TEXTURE_SHARE: Final = 0.1
"""Of the gradients' squares: below it, the correction for noise and fixed pattern is larger than what it leaves."""
PX_PER_CELL: Final = 2.0
SCALE_SD: Final = 0.05
"""Of a shift below a cell: on drawn scenes with 0.5 to 3 % texture it was read up to 6 % too large."""


def cells_of(counts: NDArray[np.uint16]) -> Floats:
    """Return the mean of each 2 x 2 Bayer cell of raw counts (2 h, 2 w), without structures of the lamp, (h, w)."""
    raw = counts.astype(np.float64)
    cells = 0.25 * (raw[0::2, 0::2] + raw[0::2, 1::2] + raw[1::2, 0::2] + raw[1::2, 1::2])
    relative = cells / max(float(cells.mean()), 1.0)
    return np.asarray(relative - gaussian_filter(relative, SMOOTH_CELLS))


def picture_shift(before: Floats, after: Floats) -> PictureShift:
    """Return how far the picture moved from one frame to the other.

    Parameters
    ----------
    before, after
        Of :func:`cells_of`, of one shape (h, w).
    """
    rows, columns = _whole_cells(before, after)
    a, b = _overlap(before, after, rows, columns)
    solved = None if min(before.shape) < 2 * LARGEST_CELLS else _least_squares(a, b)
    if solved is None:
        return PictureShift(row_px=0.0, column_px=0.0, sd_px=None)
    rest, sd = solved
    sd = math.hypot(sd, SCALE_SD * float(np.hypot(*rest)))
    return PictureShift(
        row_px=PX_PER_CELL * (rows + float(rest[0])),
        column_px=PX_PER_CELL * (columns + float(rest[1])),
        sd_px=PX_PER_CELL * sd,
    )


def _whole_cells(before: Floats, after: Floats) -> tuple[int, int]:
    """Return the shift with the largest cross-correlation, in whole cells."""
    product = np.fft.irfft2(np.fft.rfft2(after) * np.conj(np.fft.rfft2(before)), s=before.shape)
    reach = [min(LARGEST_CELLS, side // 4) for side in before.shape]
    near = np.roll(product, reach, axis=(0, 1))[: 2 * reach[0] + 1, : 2 * reach[1] + 1]
    row, column = np.unravel_index(int(near.argmax()), near.shape)
    return int(row) - reach[0], int(column) - reach[1]


def _overlap(before: Floats, after: Floats, rows: int, columns: int) -> tuple[Floats, Floats]:
    """Return the parts of both frames that show the same, for a shift by whole cells."""

    def parts(shift: int, side: int) -> tuple[slice, slice]:
        return slice(max(-shift, 0), side - max(shift, 0)), slice(max(shift, 0), side - max(-shift, 0))

    (row_a, row_b), (column_a, column_b) = (
        parts(shift, side) for shift, side in zip((rows, columns), before.shape, strict=True)
    )
    return before[row_a, column_a], after[row_b, column_b]


def _least_squares(a: Floats, b: Floats) -> tuple[Floats, float] | None:
    """Return the shift below a cell and its standard uncertainty (cells); None where there is too little texture."""
    mean, inner = 0.5 * (a + b), (slice(2, -2), slice(2, -2))
    gradients = np.stack([correlate1d(mean, DERIVATIVE, axis=axis)[inner].ravel() for axis in (0, 1)], axis=1)
    change = (b - a)[inner].ravel()
    change = change - change.mean()
    every = gradients.T @ gradients
    weight = float(np.square(DERIVATIVE).sum())
    texture = every - np.eye(2) * len(change) * weight * _unresolved_variance(mean)
    if np.linalg.eigvalsh(texture)[0] < LEAST_TEXTURE_SHARE * np.linalg.eigvalsh(every)[0]:
        return None
    inverse = np.linalg.inv(texture)
    shift = -inverse @ (gradients.T @ change)
    left = change + gradients @ shift
    covariance = inverse @ every @ inverse * float(left @ left) / (len(change) - 3)
    return shift, math.sqrt(0.5 * float(np.trace(covariance)))


def _unresolved_variance(mean: Floats) -> float:
    """Return the variance that neighbouring cells do not share: noise and fixed pattern."""
    apart = mean - mean.mean()

    def covariance(distance: int) -> float:
        along_rows = float(np.mean(apart[distance:] * apart[: apart.shape[0] - distance]))
        along_columns = float(np.mean(apart[:, distance:] * apart[:, : apart.shape[1] - distance]))
        return 0.5 * (along_rows + along_columns)

    shared = (15.0 * covariance(1) - 6.0 * covariance(2) + covariance(3)) / 10.0
    return max(float(np.mean(apart**2)) - shared, 0.0)
