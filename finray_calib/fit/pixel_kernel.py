"""The compiled fit of every pixel: curve with analytic derivatives, Levenberg-Marquardt steps, normal matrix.

The parameters of a pixel are those of its family (mode, ln FWHM, ln peak, the family's own one) and, linear, the
reflectance at the laser. All functions work on scratch arrays of their thread: nothing is allocated per pixel.
"""

import math
from typing import NamedTuple

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from finray_calib.fit.pixel_curves import CURVE_CONSTANTS, FAST, SHAPES, curve_constants, curve_slopes

FloatArray = NDArray[np.float64]

PARAMETERS = 5
NODES = 4
"""Nodes of a band: the error is below 1e-4 of the band for emission 30 nm wide, far below a pixel's noise."""
FEWEST_BANDS = 4
RESULTS = 3 * (PARAMETERS + 1) + 1
"""Values per pixel: six estimates (mode, FWHM, peak, own, reflectance, yield), their standard deviations, the part of
these that is the scatter of the estimate by noise alone (the rest is what the prior leaves open), chi-square."""

NOT_FITTED, NOT_CONVERGED, CONVERGED = 0, 1, 2

_MOST_STEPS = 60
_NEAR, _CLOSE = 0.01, 1e-6  # squared distances in standard deviations: 0.1 and 0.001
_FAR, _STALE = 0.3, 6e-6  # squared: half a prior's sd from where the leak was expanded; 0.0025 sd of the bands
_BEST_RATE = 0.01  # of the squared distance from step to step that is believed: one lucky step says little
_FIRST_DAMPING, _LEAST_DAMPING = 0.03, 1e-2
_LOWEST_SCALE = 0.05  # of the starting height: a pixel without signal starts at a twentieth of the region's


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


class PixelWork(NamedTuple):
    """Scratch arrays of one thread."""

    y: FloatArray  # (B,)
    inverse_sd: FloatArray  # (B,) 0 where the band is not used
    floor: FloatArray  # (B + 1, 4) out-of-band values and slopes by mode, ln FWHM, own, for a peak of 1
    about: FloatArray  # (5,) where they were taken
    region_floor: FloatArray  # (3, B + 1, 4) the same at the region's fit
    region_emitted: FloatArray  # (3, B) emission that the region's fit sends into the bands
    theta: FloatArray  # (5,)
    moved: FloatArray  # (5,)
    constants: FloatArray
    at_nodes: FloatArray  # (4, B Q) curve and slopes
    at_grid: FloatArray  # (4, G)
    residual: FloatArray  # (B,) in standard deviations
    jacobian: FloatArray  # (B, 5) in standard deviations
    normal: FloatArray  # (5, 5) lower triangle
    gradient: FloatArray  # (5,)
    factor: FloatArray  # (5, 5) lower triangle
    step: FloatArray  # (5,)
    slope: FloatArray  # (5,)


@njit(cache=True, error_model="numpy")  # type: ignore[untyped-decorator]
def pixel_work(p: PixelProblem) -> PixelWork:
    """Return scratch arrays of the right sizes."""
    n, bands = PARAMETERS, p.in_band.shape[1]
    return PixelWork(
        np.empty(bands),
        np.zeros(bands),
        np.empty((bands + 1, SHAPES)),
        np.empty(n),
        np.empty((3, bands + 1, SHAPES)),
        np.empty((3, bands)),
        np.empty(n),
        np.empty(n),
        np.empty(CURVE_CONSTANTS),
        np.empty((SHAPES, len(p.nodes_nm))),
        np.empty((SHAPES, len(p.grid_nm))),
        np.empty(bands),
        np.zeros((bands, n)),
        np.empty((n, n)),
        np.empty(n),
        np.empty((n, n)),
        np.empty(n),
        np.empty(n),
    )


@njit(cache=True, fastmath=FAST, error_model="numpy")  # type: ignore[untyped-decorator]
def _expand_floor(p: PixelProblem, c: int, theta: FloatArray, w: PixelWork, floor: FloatArray) -> None:
    """Fill the out-of-band values and slopes of channel c at theta, for a peak of 1."""
    curve_constants(p.family, p.table, theta, w.constants)
    curve_slopes(p.family, w.constants, p.grid_nm, w.at_grid)
    inverse_peak = math.exp(-theta[2])
    for b in range(len(floor)):
        for s in range(SHAPES):
            total = 0.0
            for g in range(len(p.grid_nm)):
                total += p.out_of_band[c, b, g] * w.at_grid[s, g]
            floor[b, s] = total * inverse_peak


@njit(cache=True, fastmath=FAST, error_model="numpy")  # type: ignore[untyped-decorator]
def pixel_cost(p: PixelProblem, c: int, theta: FloatArray, w: PixelWork) -> float:
    """Fill residuals and Jacobian of a pixel of channel c; return chi-square plus the prior's square sum.

    Light that passes outside the pass bands follows the curve to first order about w.about.
    """
    curve_constants(p.family, p.table, theta, w.constants)
    curve_slopes(p.family, w.constants, p.nodes_nm, w.at_nodes)
    peak, total = math.exp(theta[2]), 0.0
    off_mode, off_width, off_own = theta[0] - w.about[0], theta[1] - w.about[1], theta[3] - w.about[3]
    for b in range(len(w.y)):
        if w.inverse_sd[b] == 0:
            continue
        by_mode, by_width, by_own = peak * w.floor[b, 1], peak * w.floor[b, 2], peak * w.floor[b, 3]
        emitted = peak * w.floor[b, 0] + by_mode * off_mode + by_width * off_width + by_own * off_own
        for q in range(NODES):
            weight, i = p.in_band[c, b, q], b * NODES + q
            emitted += weight * w.at_nodes[0, i]
            by_mode += weight * w.at_nodes[1, i]
            by_width += weight * w.at_nodes[2, i]
            by_own += weight * w.at_nodes[3, i]
        inverse = w.inverse_sd[b]
        w.residual[b] = (emitted + theta[4] * p.laser[c, b] - w.y[b]) * inverse
        w.jacobian[b, 0], w.jacobian[b, 1], w.jacobian[b, 2] = by_mode * inverse, by_width * inverse, emitted * inverse
        w.jacobian[b, 3], w.jacobian[b, 4] = by_own * inverse, p.laser[c, b] * inverse
        total += w.residual[b] ** 2
    for j in range(PARAMETERS):
        total += (theta[j] - p.mean[j]) ** 2 * p.precision[j]
    return total


@njit(cache=True, fastmath=FAST, error_model="numpy")  # type: ignore[untyped-decorator]
def _fill_normal(p: PixelProblem, w: PixelWork) -> None:
    """Fill the normal matrix and the gradient at w.theta from its residuals and Jacobian."""
    for j in range(PARAMETERS):
        w.gradient[j] = (w.theta[j] - p.mean[j]) * p.precision[j]
        for k in range(j):
            w.normal[j, k] = 0.0
        w.normal[j, j] = p.precision[j]
    for b in range(len(w.y)):
        if w.inverse_sd[b] == 0:
            continue
        for j in range(PARAMETERS):
            w.gradient[j] += w.jacobian[b, j] * w.residual[b]
            for k in range(j + 1):
                w.normal[j, k] += w.jacobian[b, j] * w.jacobian[b, k]


@njit(cache=True, fastmath=FAST, error_model="numpy")  # type: ignore[untyped-decorator]
def _factorise(w: PixelWork, damping: float) -> None:
    """Fill w.factor with the Cholesky factor of the normal matrix, its diagonal raised by the damping."""
    for j in range(PARAMETERS):
        for k in range(j + 1):
            s = w.normal[j, k] * (1 + damping) if j == k else w.normal[j, k]
            for m in range(k):
                s -= w.factor[j, m] * w.factor[k, m]
            w.factor[j, k] = math.sqrt(s) if j == k else s / w.factor[k, k]


@njit(cache=True, fastmath=FAST, error_model="numpy")  # type: ignore[untyped-decorator]
def _solve(factor: FloatArray, right: FloatArray, out: FloatArray) -> float:
    """Fill `out` with the solution for a right side; return right' times the solution, a squared length."""
    length = 0.0
    for j in range(PARAMETERS):
        s = right[j]
        for m in range(j):
            s -= factor[j, m] * out[m]
        out[j] = s / factor[j, j]
        length += out[j] ** 2
    for j in range(PARAMETERS - 1, -1, -1):
        s = out[j]
        for m in range(j + 1, PARAMETERS):
            s -= factor[m, j] * out[m]
        out[j] = s / factor[j, j]
    return length


@njit(cache=True, error_model="numpy")  # type: ignore[untyped-decorator]
def _start(p: PixelProblem, c: int, w: PixelWork) -> None:
    """Set w.theta to the region's fit, its height scaled to the pixel's emission bands by a weighted dot product."""
    w.theta[:] = p.mean
    w.about[:] = p.mean
    w.floor[:] = w.region_floor[c]
    along = length = 0.0
    for b in range(len(w.y)):
        if w.inverse_sd[b] > 0 and b != p.excitation:
            emitted = w.region_emitted[c, b] * w.inverse_sd[b]
            along += emitted * (w.y[b] - p.mean[4] * p.laser[c, b]) * w.inverse_sd[b]
            length += emitted * emitted
    if length > 0:
        w.theta[2] += math.log(max(along / length, _LOWEST_SCALE))


@njit(cache=True, error_model="numpy")  # type: ignore[untyped-decorator]
def _region_bands(p: PixelProblem, w: PixelWork) -> None:
    """Fill what the region's fit emits into the bands of each channel."""
    w.inverse_sd[:] = 1.0
    w.y[:] = 0.0
    w.about[:] = p.mean
    for c in range(3):
        _expand_floor(p, c, p.mean, w, w.region_floor[c])
        w.floor[:] = w.region_floor[c]
        pixel_cost(p, c, p.mean, w)
        w.region_emitted[c] = w.jacobian[:, 2]


@njit(cache=True, error_model="numpy")  # type: ignore[untyped-decorator]
def _is_stale(p: PixelProblem, w: PixelWork) -> bool:
    """Return whether the curve has left the place about which the leak was expanded, by more than the leak allows.

    The second order grows with the squared distance and counts in units of the noise.
    """
    off, leak, peak = 0.0, 0.0, math.exp(w.theta[2])
    for j in (0, 1, 3):
        off += (w.theta[j] - w.about[j]) ** 2 * p.precision[j]
    for b in range(len(w.y)):
        leak += (peak * w.floor[b, 0] * w.inverse_sd[b]) ** 2
    return off > _FAR or off * off * leak > _STALE


@njit(cache=True, error_model="numpy")  # type: ignore[untyped-decorator]
def fit_pixel(p: PixelProblem, c: int, w: PixelWork) -> tuple[float, bool]:
    """Move w.theta to the maximum of the posterior of the pixel in w.y; leave the normal matrix there.

    Gauss-Newton steps, damped where a step gains much less than the linear model promises. They end when what remains
    at the present rate is below a thousandth of a standard deviation.

    Returns
    -------
    tuple
        Chi-square plus the prior's square sum, and whether the steps ended.
    """
    _start(p, c, w)
    cost, damping, before = pixel_cost(p, c, w.theta, w), 0.0, math.inf
    close = converged = False
    _fill_normal(p, w)
    for _ in range(_MOST_STEPS):
        renewed = False
        _factorise(w, 0.0)
        distance = promised = _solve(w.factor, w.gradient, w.step)
        if damping > 0:
            _factorise(w, damping)
            promised = _solve(w.factor, w.gradient, w.step)
        near = distance * min(max(distance / before, _BEST_RATE), 1.0) < _CLOSE
        for j in range(PARAMETERS):
            limit = p.longest_step[j]
            w.moved[j] = w.theta[j] - min(max(w.step[j], -limit), limit)
        w.moved[3] = min(max(w.moved[3], p.low), p.high)
        trial = pixel_cost(p, c, w.moved, w)
        gain = cost - trial
        if gain >= 0:
            w.theta[:], cost, before = w.moved, trial, distance
            renewed = (close or distance < _NEAR) and _is_stale(p, w)
            if renewed:
                close = True
                w.about[:] = w.theta
                _expand_floor(p, c, w.about, w, w.floor)
                cost = pixel_cost(p, c, w.theta, w)
            _fill_normal(p, w)
        converged = near and not renewed
        if converged:
            break
        if gain < 0.5 * promised:
            damping = max(4 * damping, _FIRST_DAMPING)
        elif gain > 0.75 * promised:
            damping = 0.2 * damping if damping > _LEAST_DAMPING else 0.0
    return cost, converged


@njit(cache=True, error_model="numpy")  # type: ignore[untyped-decorator]
def _report(p: PixelProblem, cost: float, w: PixelWork, out: NDArray[np.float32]) -> None:
    """Fill the results of a pixel from the fit that is in w."""
    n, peak = PARAMETERS, math.exp(w.theta[2])
    _factorise(w, 0.0)
    floor = w.floor[len(w.y)]
    for q in range(n + 1):
        w.slope[:] = 0.0
        if q < n:
            positive = q == 1 or q == 2
            out[q] = math.exp(w.theta[q]) if positive else w.theta[q]
            w.slope[q] = out[q] if positive else 1.0
        else:
            w.slope[0], w.slope[1], w.slope[3] = peak * floor[1], peak * floor[2], peak * floor[3]
            w.slope[2] = peak * floor[0]
            for j in (0, 1, 3):
                w.slope[2] += w.slope[j] * (w.theta[j] - w.about[j])
            out[n] = w.slope[2]
        variance = _solve(w.factor, w.slope, w.step)
        noise = variance
        for j in range(n):
            noise -= p.precision[j] * w.step[j] ** 2
        out[n + 1 + q] = math.sqrt(variance)
        out[2 * n + 2 + q] = math.sqrt(max(noise, 0.0))
    out[3 * n + 3] = cost
    for j in range(n):
        out[3 * n + 3] -= (w.theta[j] - p.mean[j]) ** 2 * p.precision[j]


@njit(cache=True, error_model="numpy")  # type: ignore[untyped-decorator]
def _fit_row(
    p: PixelProblem,
    y: NDArray[np.float32],
    sd: NDArray[np.float32],
    channel: NDArray[np.uint8],
    usable: NDArray[np.bool_],
    out: NDArray[np.float32],
    status: NDArray[np.uint8],
    bands: NDArray[np.uint8],
) -> None:
    """Fit one row of pixels, of (B, C) signals."""
    w, result = pixel_work(p), np.empty(RESULTS, np.float32)
    _region_bands(p, w)
    for column in range(y.shape[1]):
        c, count = channel[column], 0
        for b in range(len(y)):
            w.y[b] = y[b, column]
            spread = sd[b, column]
            good = p.used[c, b] and math.isfinite(w.y[b]) and math.isfinite(spread) and spread > 0
            w.inverse_sd[b] = 1.0 / spread if good else 0.0
            count += 1 if good else 0
        bands[column] = count
        if usable[column] and count >= FEWEST_BANDS:
            cost, converged = fit_pixel(p, c, w)
            status[column] = CONVERGED if converged else NOT_CONVERGED
            _report(p, cost, w, result)
            out[:, column] = result
        else:
            status[column] = NOT_FITTED
            out[:, column] = np.nan


@njit(cache=True, parallel=True)  # type: ignore[untyped-decorator]
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
    for row in prange(y.shape[1]):
        _fit_row(p, y[:, row], sd[:, row], channel[row], usable[row], out[:, row], status[row], bands[row])
