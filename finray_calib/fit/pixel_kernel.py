"""The compiled fit of every pixel: damped Gauss-Newton steps of a block of pixels at once, and their covariance.

The parameters of a pixel are those of its family (mode, ln FWHM, ln peak, the family's own one) and, linear, the
reflectance at the laser. The bands of a block of pixels have analytic derivatives, which make the normal matrices.

A lane is one pixel of a block; nothing is allocated per block. Each lane steps at its own pace, and one whose pixel is
done takes the next pixel of the row, so that slow pixels hold up no others.
"""

import math
from typing import Final, NamedTuple

import numpy as np
from numba import prange
from numpy.typing import NDArray

from finray_calib.spectra import compiled, compiled_in_parallel
from finray_calib.spectra.family_kernels import CURVE_CONSTANTS, LANES, SHAPES, curve_constants, curve_slopes

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


IntArray = NDArray[np.int64]

MOST_STEPS: Final = 60
_CLOSE = 1e-6  # squared distance in standard deviations: 0.001
_BEST_RATE = 0.01  # of the squared distance from step to step that is believed: one lucky step says little
_FIRST_DAMPING, _LEAST_DAMPING = 0.03, 1e-2


class Descent(NamedTuple):
    """Where the pixels of a block stand between two steps; each row is (LANES,)."""

    pixel: IntArray  # -1 in a lane without pixel
    steps: IntArray
    near: NDArray[np.bool_]  # what remains after the step under way is below the tolerance
    damping: FloatArray
    distance: FloatArray  # squared, to the minimum of the undamped linear model
    before: FloatArray  # the same one accepted step ago
    promised: FloatArray  # gain of the step under way by the linear model
    theta: FloatArray  # (5, LANES) best so far; block.theta is where the step leads
    normal: FloatArray  # (ROWS, LANES) there


@compiled
def descent() -> Descent:
    """Return a descent without pixels."""
    return Descent(
        np.full(LANES, -1),
        np.zeros(LANES, np.int64),
        np.zeros(LANES, np.bool_),
        np.zeros(LANES),
        np.zeros(LANES),
        np.full(LANES, np.inf),
        np.zeros(LANES),
        np.zeros((PARAMETERS, LANES)),
        np.zeros((ROWS, LANES)),
    )


@compiled
def begin(d: Descent, lane: int, pixel: int) -> None:
    """Give a lane a new pixel, whose first step is accepted wherever it leads."""
    d.pixel[lane], d.steps[lane], d.near[lane] = pixel, 0, False
    d.damping[lane], d.promised[lane], d.distance[lane], d.normal[COST, lane] = 0.0, 0.0, math.inf, math.inf


@compiled
def judge(block: PixelBlock, d: Descent) -> None:
    """Accept the steps that led no higher, and set the damping by how much of the promised gain came true."""
    for i in range(LANES):
        gain = d.normal[COST, i] - block.normal[COST, i]
        if gain >= 0:
            d.before[i] = d.distance[i]
            for j in range(PARAMETERS):
                d.theta[j, i] = block.theta[j, i]
            for j in range(ROWS):
                d.normal[j, i] = block.normal[j, i]
        if gain > 0.75 * d.promised[i]:
            d.damping[i] = 0.2 * d.damping[i] if d.damping[i] > _LEAST_DAMPING else 0.0
        elif not gain >= 0.5 * d.promised[i]:  # also where the cost is not a number
            d.damping[i] = max(4 * d.damping[i], _FIRST_DAMPING)
        d.steps[i] += 1


@compiled
def propose(p: PixelProblem, block: PixelBlock, d: Descent) -> None:
    """Fill block.theta with the next step of each lane, and tell how near its end will be."""
    factorise(d.normal, block.none, block.factor)
    solve(block.factor, d.distance, block.step)
    d.promised[:] = d.distance
    if d.damping.max() > 0:
        factorise(d.normal, d.damping, block.factor)
        solve(block.factor, d.promised, block.step)
    for i in range(LANES):
        rate = min(max(d.distance[i] / d.before[i], _BEST_RATE), 1.0)
        d.near[i] = d.distance[i] * rate < _CLOSE
        for j in range(PARAMETERS):
            limit = p.longest_step[j]
            block.theta[j, i] = d.theta[j, i] - min(max(block.step[j, i], -limit), limit)
        block.theta[3, i] = min(max(block.theta[3, i], p.low), p.high)


FEWEST_BANDS: Final = 4
RESULTS: Final = 3 * (PARAMETERS + 1) + 1
"""Values per pixel: six estimates (mode, FWHM, peak, own, reflectance, yield), their standard deviations, the part of
these that is the scatter of the estimate by noise alone (the rest is what the prior leaves open), chi-square."""

NOT_FITTED, NOT_CONVERGED, CONVERGED = 0, 1, 2

_CHANNELS = 3
_LOWEST_SCALE = 0.05  # of the starting height: a pixel without signal starts at a twentieth of the region's


class PixelRow(NamedTuple):
    """One row of pixels; B bands, C columns."""

    y: NDArray[np.float32]  # (B, C)
    sd: NDArray[np.float32]  # (B, C)
    channel: NDArray[np.uint8]  # (C,)
    usable: NDArray[np.bool_]  # (C,)


@compiled
def _load(p: PixelProblem, c: int, row: PixelRow, column: int, block: PixelBlock, lane: int) -> None:
    """Put the signals of a pixel into a lane; bands without a good value do not count."""
    for b in range(len(row.y)):
        value, spread = row.y[b, column], row.sd[b, column]
        good = _is_good(p, c, b, value, spread)
        block.y[b, lane], block.inverse_sd[b, lane] = (value, 1.0 / spread) if good else (0.0, 0.0)


@compiled
def _is_good(p: PixelProblem, c: int, b: int, value: float, spread: float) -> bool:
    """Return whether a band of a pixel can be used."""
    return bool(p.used[c, b] and math.isfinite(value) and math.isfinite(spread) and spread > 0)


@compiled
def _height(p: PixelProblem, c: int, region: FloatArray, block: PixelBlock, lane: int) -> float:
    """Return the height of a pixel over that of the region, (B + 1, 4), by a weighted dot product of their bands."""
    along = length = 0.0
    for b in range(len(block.y)):
        if b != p.excitation:
            emitted = region[b, 0] * block.inverse_sd[b, lane]
            along += emitted * (block.y[b, lane] - p.mean[4] * p.laser[c, b]) * block.inverse_sd[b, lane]
            length += emitted * emitted
    return max(along / length, _LOWEST_SCALE) if length > 0 else 1.0


@compiled
def _first_steps(
    p: PixelProblem, c: int, row: PixelRow, columns: IntArray, block: PixelBlock, theta: FloatArray
) -> None:
    """Fill theta (5, N) with the first step of each pixel from the region's fit scaled to the pixel's height.

    There all pixels have one curve but for its height, so that it is computed once.
    """
    d = descent()
    for j in range(PARAMETERS):
        block.theta[j] = p.mean[j]
    fill_emitted(p, c, block)
    region = block.emitted[:, ::LANES].copy()
    for first in range(0, len(columns), LANES):
        d.theta[:] = p.mean.reshape(-1, 1)
        count = min(LANES, len(columns) - first)
        for lane in range(count):
            _load(p, c, row, columns[first + lane], block, lane)
            height = _height(p, c, region, block, lane)
            d.theta[2, lane] += math.log(height)
            for b in range(len(region)):
                for s in range(SHAPES):
                    block.emitted[b, s * LANES + lane] = height * region[b, s]
        block.theta[:] = d.theta
        fill_normal(p, c, block)
        d.normal[:] = block.normal
        propose(p, block, d)
        theta[:, first : first + count] = block.theta[:, :count]


@compiled
def _fit(
    p: PixelProblem, c: int, row: PixelRow, columns: IntArray, block: PixelBlock, theta: FloatArray, normal: FloatArray
) -> NDArray[np.bool_]:
    """Move theta (5, N) of pixels of channel c to the maxima of their posteriors; fill normal (ROWS, N) there.

    Gauss-Newton steps, damped where a step gains much less than the linear model promises. They end when what remains
    at the present rate is below a thousandth of a standard deviation: (N,), whether they ended.
    """
    d, begun, done, converged = descent(), 0, 0, np.empty(len(columns), np.bool_)
    while done < len(columns):
        for lane in range(LANES):
            if d.pixel[lane] < 0 and begun < len(columns):
                _load(p, c, row, columns[begun], block, lane)
                begin(d, lane, begun)
                block.theta[:, lane] = theta[:, begun]
                begun += 1
        fill_emitted(p, c, block)
        fill_normal(p, c, block)
        judge(block, d)
        for lane in range(LANES):
            i = d.pixel[lane]
            if i >= 0 and (d.near[lane] or d.steps[lane] > MOST_STEPS):
                theta[:, i], normal[:, i], converged[i] = d.theta[:, lane], d.normal[:, lane], d.near[lane]
                d.pixel[lane] = -1
                done += 1
        propose(p, block, d)
    return converged


@compiled
def _report(p: PixelProblem, block: PixelBlock, out: NDArray[np.float32]) -> None:
    """Fill results (RESULTS, LANES) of the pixels whose fit is in the block."""
    n, variance, energy = PARAMETERS, np.empty(LANES), block.normal[COST + 1 :]
    right = block.normal[COST - n : COST]
    for q in range(n + 1):
        right[:] = 0.0
        for i in range(LANES):
            if q < n:
                positive = q in (1, 2)
                out[q, i] = math.exp(block.theta[q, i]) if positive else block.theta[q, i]
                right[q, i] = out[q, i] if positive else 1.0
            else:
                out[n, i] = right[2, i] = energy[0, i]
                right[0, i], right[1, i], right[3, i] = energy[1, i], energy[2, i], energy[3, i]
        factorise(block.normal, block.none, block.factor)
        solve(block.factor, variance, block.step)
        for i in range(LANES):
            noise = variance[i]
            for j in range(n):
                noise -= p.precision[j] * block.step[j, i] ** 2
            out[n + 1 + q, i] = math.sqrt(variance[i])
            out[2 * n + 2 + q, i] = math.sqrt(max(noise, 0.0))
    for i in range(LANES):
        chi_square = block.normal[COST, i]
        for j in range(n):
            chi_square -= (block.theta[j, i] - p.mean[j]) ** 2 * p.precision[j]
        out[3 * n + 3, i] = chi_square


@compiled
def _fit_row(
    p: PixelProblem, row: PixelRow, out: NDArray[np.float32], status: NDArray[np.uint8], bands: NDArray[np.uint8]
) -> None:
    """Fit one row of pixels, channel after channel."""
    width, block = len(row.channel), empty_block(len(row.y))
    theta, normal, result = (
        np.empty((PARAMETERS, width)),
        np.empty((ROWS, width)),
        np.empty((RESULTS, LANES), np.float32),
    )
    out[:] = np.nan
    status[:] = NOT_FITTED
    for column in range(width):
        bands[column] = 0
        for b in range(len(row.y)):
            bands[column] += _is_good(p, row.channel[column], b, row.y[b, column], row.sd[b, column])
    for c in range(_CHANNELS):
        columns = np.flatnonzero((row.channel == c) & row.usable & (bands >= FEWEST_BANDS))
        _first_steps(p, c, row, columns, block, theta)
        converged = _fit(p, c, row, columns, block, theta, normal)
        for first in range(0, len(columns), LANES):
            count = min(LANES, len(columns) - first)
            block.theta[:, :count] = theta[:, first : first + count]
            block.normal[:, :count] = normal[:, first : first + count]
            _report(p, block, result)
            for lane in range(count):
                out[:, columns[first + lane]] = result[:, lane]
                status[columns[first + lane]] = CONVERGED if converged[first + lane] else NOT_CONVERGED


@compiled_in_parallel
def fit_pixels(
    p: PixelProblem,
    y: NDArray[np.float32],
    sd: NDArray[np.float32],
    channel: NDArray[np.uint8],
    usable: NDArray[np.bool_],
    out: NDArray[np.float32],
    status: NDArray[np.uint8],
    bands: NDArray[np.uint8],
) -> None:
    """Fit all pixels of (B, R, C) signals; fill results (RESULTS, R, C), status and number of bands (R, C)."""
    for i in prange(y.shape[1]):
        _fit_row(p, PixelRow(y[:, i], sd[:, i], channel[i], usable[i]), out[:, i], status[i], bands[i])
