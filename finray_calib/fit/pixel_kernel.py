"""The compiled fit of every pixel: damped Gauss-Newton steps of a block of pixels at once, and their covariance.

A lane whose pixel is done takes the next pixel of the row, so that slow pixels hold up no others.
"""

import math
from typing import Final, NamedTuple

import numpy as np
from numba import prange
from numpy.typing import NDArray

from finray_calib.fit.pixel_curves import LANES, SHAPES
from finray_calib.fit.pixel_descent import MOST_STEPS, begin, descent, judge, propose
from finray_calib.fit.pixel_normal import (
    COST,
    PARAMETERS,
    ROWS,
    PixelBlock,
    PixelProblem,
    empty_block,
    factorise,
    fill_emitted,
    fill_normal,
    solve,
)
from finray_calib.spectra.compiled import compiled, compiled_in_parallel

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

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
