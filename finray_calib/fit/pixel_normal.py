"""Bands of a block of pixels with analytic derivatives, their normal matrices, and the solution of these.

The parameters of a pixel are those of its family (mode, ln FWHM, ln peak, the family's own one) and, linear, the
reflectance at the laser. A lane is one pixel of a block; nothing is allocated per block.
"""

import math
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from finray_calib.fit.pixel_curves import CURVE_CONSTANTS, LANES, SHAPES, curve_constants, curve_slopes
from finray_calib.spectra.compiled import compiled

FloatArray = NDArray[np.float64]

PARAMETERS: Final = 5
NODES: Final = 4
"""Nodes of a band: the error is below 1e-4 of the band for emission 30 nm wide, far below a pixel's noise."""
COST: Final = 20
"""Row of the normal matrix that holds chi-square plus the prior's square sum."""
ROWS: Final = COST + 1 + SHAPES


class PixelProblem(NamedTuple):
    """What all pixels share; 3 channels, B bands, Q nodes a band, G grid points.

    The band value of channel c is sum_q in_band f(node) + sum_g out_of_band f(grid) + reflectance laser. One more row
    of out_of_band holds the weights of the energy yield.
    """

    family: int
    table: FloatArray  # (3, K) mode offset, peak and width of the unit skew-Cauchy curve over kappa
    nodes_nm: FloatArray  # (B Q,) band after band
    in_band: FloatArray  # (3, B, Q), all 0 where a band has no pass band above the laser
    grid_nm: FloatArray  # (G,)
    out_of_band: FloatArray  # (3, B + 1, G)
    laser: FloatArray  # (3, B)
    used: NDArray[np.bool_]  # (3, B)
    excitation: int
    mean: FloatArray  # (5,) prior and start
    precision: FloatArray  # (5,) of the prior
    longest_step: FloatArray  # (5,)
    low: float  # of the family's own parameter
    high: float


class PixelBlock(NamedTuple):
    """A block of pixels of one channel: their signals, and the arrays that the functions below fill."""

    y: FloatArray  # (B, LANES)
    inverse_sd: FloatArray  # (B, LANES) 0 where the band is not used
    theta: FloatArray  # (5, LANES)
    constants: FloatArray  # (CURVE_CONSTANTS * LANES,)
    curve: FloatArray  # (4 * LANES,) curve and slopes at one wavelength
    emitted: FloatArray  # (B + 1, 4 * LANES) bands and yield, with slopes by mode, ln FWHM, own
    row: FloatArray  # (6 * LANES,) slopes and residual of one band, in standard deviations
    normal: FloatArray  # (ROWS, LANES) lower triangle of the matrix, gradient, cost, yield with its slopes
    factor: FloatArray  # (20, LANES) Cholesky factor of the normal matrix, then the half-way solution
    step: FloatArray  # (5, LANES)
    none: FloatArray  # (LANES,) no damping


@compiled
def empty_block(bands: int) -> PixelBlock:
    """Return a block without pixels: no band is used, so that its fit rests at the prior."""
    n = PARAMETERS
    return PixelBlock(
        np.zeros((bands, LANES)),
        np.zeros((bands, LANES)),
        np.zeros((n, LANES)),
        np.zeros(CURVE_CONSTANTS * LANES),
        np.zeros(SHAPES * LANES),
        np.zeros((bands + 1, SHAPES * LANES)),
        np.zeros((n + 1) * LANES),
        np.zeros((ROWS, LANES)),
        np.zeros((COST, LANES)),
        np.zeros((n, LANES)),
        np.zeros(LANES),
    )


@compiled
def _add(weight: float, values: FloatArray, total: FloatArray) -> None:
    """Add weighted curves and slopes to a band."""
    for i in range(SHAPES * LANES):
        total[i] += weight * values[i]


@compiled
def fill_emitted(p: PixelProblem, c: int, block: PixelBlock) -> None:
    """Fill what the curves at block.theta emit into the bands of channel c, with slopes."""
    curve_constants(p.family, p.table, block.theta, block.constants)
    block.emitted[:] = 0.0
    for i in range(len(p.nodes_nm)):
        weight = p.in_band[c, i // NODES, i % NODES]
        if weight != 0:
            curve_slopes(p.family, block.constants, p.nodes_nm[i], block.curve)
            _add(weight, block.curve, block.emitted[i // NODES])
    for g in range(len(p.grid_nm)):
        curve_slopes(p.family, block.constants, p.grid_nm[g], block.curve)
        for b in range(len(block.emitted)):
            _add(p.out_of_band[c, b, g], block.curve, block.emitted[b])


@compiled
def _start_normal(p: PixelProblem, block: PixelBlock) -> None:
    """Fill the normal matrices with the prior's share."""
    block.normal[:] = 0.0
    for j in range(PARAMETERS):
        for lane in range(LANES):
            off = block.theta[j, lane] - p.mean[j]
            block.normal[j * (j + 3) // 2, lane] = p.precision[j]
            block.normal[COST - PARAMETERS + j, lane] = off * p.precision[j]
            block.normal[COST, lane] += off * off * p.precision[j]


@compiled
def fill_normal(p: PixelProblem, c: int, block: PixelBlock) -> None:
    """Fill normal matrix, gradient and cost of the posterior of each pixel at block.theta from block.emitted.

    The gradient is the matrix' sixth row and the cost its corner: the normal matrix of slopes and residual together.
    """
    _start_normal(p, block)
    row = block.row
    for b in range(len(block.y)):
        emitted, laser = block.emitted[b], p.laser[c, b]
        for i in range(LANES):
            inverse = block.inverse_sd[b, i]
            row[i], row[LANES + i] = emitted[LANES + i] * inverse, emitted[2 * LANES + i] * inverse
            row[2 * LANES + i], row[3 * LANES + i] = emitted[i] * inverse, emitted[3 * LANES + i] * inverse
            row[4 * LANES + i] = laser * inverse
            row[5 * LANES + i] = (emitted[i] + block.theta[4, i] * laser - block.y[b, i]) * inverse
        for j in range(PARAMETERS + 1):
            for k in range(j + 1):
                for i in range(LANES):
                    block.normal[j * (j + 1) // 2 + k, i] += row[j * LANES + i] * row[k * LANES + i]
    for j in range(SHAPES):
        block.normal[COST + 1 + j] = block.emitted[len(block.y)][j * LANES : (j + 1) * LANES]


@compiled
def factorise(normal: FloatArray, damping: FloatArray, factor: FloatArray) -> None:
    """Fill Cholesky factors of normal matrices, their diagonals raised by (LANES,) factors; the sixth row is solved."""
    for j in range(PARAMETERS + 1):
        for k in range(min(j + 1, PARAMETERS)):
            jk, kk = j * (j + 1) // 2 + k, k * (k + 3) // 2
            for i in range(LANES):
                factor[jk, i] = normal[jk, i] * (1 + damping[i]) if j == k else normal[jk, i]
            for m in range(k):
                jm, km = j * (j + 1) // 2 + m, k * (k + 1) // 2 + m
                for i in range(LANES):
                    factor[jk, i] -= factor[jm, i] * factor[km, i]
            for i in range(LANES):
                factor[jk, i] = math.sqrt(factor[jk, i]) if j == k else factor[jk, i] / factor[kk, i]


@compiled
def solve(factor: FloatArray, length: FloatArray, out: FloatArray) -> None:
    """Fill solutions (5, LANES) for the sixth rows, and right side times solution (LANES,), a squared length."""
    length[:] = 0.0
    for j in range(PARAMETERS - 1, -1, -1):
        for i in range(LANES):
            half_way = factor[COST - PARAMETERS + j, i]
            length[i] += half_way * half_way
            out[j, i] = half_way
        for m in range(j + 1, PARAMETERS):
            for i in range(LANES):
                out[j, i] -= factor[m * (m + 1) // 2 + j, i] * out[m, i]
        for i in range(LANES):
            out[j, i] /= factor[j * (j + 3) // 2, i]
