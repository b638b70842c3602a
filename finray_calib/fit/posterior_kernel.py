"""The compiled log posterior: band values of a curve, covariance with discrepancy, normal log density, ascent.

The climb to a local maximum takes Levenberg-Marquardt steps. Python calls one compiled function, :func:`evaluate`:
several would each compile all that they share.
"""

import math
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from finray_calib.fit._prior import EDGE_OFFSET_FWHM, EDGE_WIDTH_FWHM
from finray_calib.spectra import BAND_NODES, compiled, compiled_inside
from finray_calib.spectra.family_kernels import CONSTANTS, constants, fill

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

_LN_2PI = math.log(2 * math.pi)
_FAR_FROM_ONE = 1e100  # of a product of pivots, each 1e-150 or more: its logarithm is taken before it underflows


# Few wide arrays, because compiling a function takes longer with every array that it is given.
ROW: Final = np.dtype(
    [
        ("band", np.int64),
        ("y", np.float64),
        ("laser", np.float64),  # what the row sees of the reflected laser, and how much of it and of white leaks in
        ("leaked_laser", np.float64),
        ("leaked_white", np.float64),
        ("leak_mean", np.float64),  # mean over median of the row's own leak, and standard deviation of its logarithm
        ("leak_sd", np.float64),
        ("leak_at", np.int64),  # where theta holds it, in these standard deviations; 0 where it is not sampled
    ],
    align=True,
)
NORMAL: Final = np.dtype([(name, np.float64) for name in ("mean", "sd", "low", "high")], align=True)
"""A usable band value, and the truncated normal prior of a parameter."""


class Problem(NamedTuple):
    """Everything the compiled functions need; K usable rows, B bands, Q nodes a band, G grid points, D parameters.

    Theta is the family's parameters, then ln(reflectance at the laser), then ln(blocking) and the own leaks where they
    are sampled.
    """

    family: int
    shapes: int  # number of the family's parameters
    has_blocking: bool
    table: FloatArray
    points_nm: FloatArray  # (B Q + G,) the bands' nodes, band after band, then the grid
    rows: NDArray[np.void]  # (K,) of ROW
    level: NDArray[np.void]  # (C,) of ROW: the channels of the laser's level, each with its share as laser
    weights: FloatArray  # (K, Q + 2 G) at the nodes of the row's band, then on the grid: out of band, leaked
    covariance: FloatArray  # (2, K, K) measurement and imperfections; relative one of what is common to all values
    kernel: FloatArray  # (B Q, B Q) smooth part of the discrepancy between all nodes
    floor_rel: float
    reabsorption_rel: float
    prior: NDArray[np.void]  # (D,) of NORMAL
    ln_prior_norm: float

    @property
    def y(self) -> FloatArray:
        """Usable band values, (K,)."""
        return np.asarray(self.rows["y"])

    @property
    def band(self) -> IntArray:
        """Band of each usable value, (K,)."""
        return np.asarray(self.rows["band"])

    @property
    def in_band(self) -> FloatArray:
        """Weights at the nodes of each row's band, (K, Q)."""
        return self.weights[:, :BAND_NODES]


class Work(NamedTuple):
    """Scratch arrays of one evaluation."""

    c: FloatArray  # constants of the curve
    curve: FloatArray  # (2, B Q + G) at the points: the curve, and what pulls on it
    row: FloatArray  # (3, K) prediction, whitened residual, re-absorbed light
    scaled: FloatArray  # (K, Q) curve times weights
    factor: FloatArray  # (K, K) lower triangle, of the diagonal the inverse


MU: Final = 0
Z: Final = 1
_EDGE: Final = 2


@compiled_inside
def scratch(rows: int, points: int) -> Work:
    """Return scratch arrays of the right sizes."""
    return Work(
        np.empty(CONSTANTS),
        np.empty((2, points)),
        np.empty((3, rows)),
        np.empty((rows, BAND_NODES)),
        np.empty((rows, rows)),
    )


@compiled_inside
def _more(row: NDArray[np.void], theta: FloatArray, blocking: float) -> float:
    """Return the leak of a row's filter over the nominal one, less 1."""
    own = math.exp(row["leak_sd"] * theta[row["leak_at"]]) if row["leak_at"] > 0 else row["leak_mean"]
    return float(blocking * own - 1)


@compiled_inside
def predict(p: Problem, theta: FloatArray, w: Work) -> None:
    """Fill w.row[MU] with the band values of one parameter vector, and the curve at all points."""
    constants(p.family, theta, p.table, w.c)
    fill(p.family, w.c, p.points_nm, w.curve[0])
    rho = math.exp(theta[p.shapes])
    blocking = math.exp(theta[p.shapes + 1]) if p.has_blocking else 1.0
    # slices: of an index that is a sum the compiler cannot tell that it is not negative, and takes value after value
    curve = w.curve[0, len(p.kernel) :]
    grid, level = len(curve), 0.0
    for i in range(len(p.level)):
        row = p.level[i]
        level += row["laser"] / (1 + _more(row, theta, blocking) * row["leaked_white"])
    for i in range(len(p.rows)):
        row = p.rows[i]
        first, emitted, leaked = row["band"] * BAND_NODES, 0.0, 0.0
        more = _more(row, theta, blocking)
        for q in range(BAND_NODES):
            emitted += p.weights[i, q] * w.curve[0, first + q]
        out_of_band, leaks = p.weights[i, BAND_NODES : BAND_NODES + grid], p.weights[i, BAND_NODES + grid :]
        for g in range(grid):
            emitted += out_of_band[g] * curve[g]
            leaked += leaks[g] * curve[g]
        laser = row["laser"] + more * row["leaked_laser"]
        w.row[MU, i] = (emitted + more * leaked + rho * laser) / ((1 + more * row["leaked_white"]) * level)


@compiled_inside
def fill_covariance(p: Problem, theta: FloatArray, w: Work) -> None:
    """Fill the lower triangle of w.factor with the covariance of all, for curve and prediction that predict() left."""
    floor, width = p.floor_rel * math.exp(theta[2]), math.exp(theta[1])
    rows, nodes = len(p.rows), len(p.kernel)
    for n in range(nodes):
        u = (p.points_nm[n] - theta[0] + EDGE_OFFSET_FWHM * width) / (EDGE_WIDTH_FWHM * width)
        w.curve[1, n] = p.reabsorption_rel / (1 + math.exp(min(u, 60.0)))
    for i in range(rows):
        first, s = p.rows[i]["band"] * BAND_NODES, 0.0
        for q in range(BAND_NODES):
            w.scaled[i, q] = p.weights[i, q] * (w.curve[0, first + q] + floor)
            s += w.scaled[i, q] * w.curve[1, first + q]
        w.row[_EDGE, i] = s
    for j in range(rows):
        own = p.rows[j]["band"] * BAND_NODES
        for first in range(own, nodes, BAND_NODES):
            if p.kernel[first, own] > 0:
                for q in range(BAND_NODES):
                    part = 0.0
                    for r in range(BAND_NODES):
                        part += p.kernel[first + q, own + r] * w.scaled[j, r]
                    w.curve[1, first + q] = part
        for i in range(j, rows):
            total, first = p.covariance[0, i, j] + w.row[_EDGE, i] * w.row[_EDGE, j], p.rows[i]["band"] * BAND_NODES
            total += p.covariance[1, i, j] * w.row[MU, i] * w.row[MU, j]
            if p.kernel[first, own] > 0:
                for q in range(BAND_NODES):
                    total += w.scaled[i, q] * w.curve[1, first + q]
            w.factor[i, j] = total


@compiled_inside
def factorise(a: FloatArray, b: FloatArray) -> float:
    """Replace a lower triangle by its Cholesky factor L and b by L^-1 b; return half the log determinant."""
    half, product = 0.0, 1.0
    for i in range(len(b)):
        for j in range(i):
            s = a[i, j]
            for k in range(j):
                s -= a[i, k] * a[j, k]
            a[i, j] = s * a[j, j]
        s, z = a[i, i], b[i]
        for k in range(i):
            s -= a[i, k] * a[i, k]
            z -= a[i, k] * b[k]
        pivot = math.sqrt(max(s, 1e-300))
        product *= pivot
        if not 1 / _FAR_FROM_ONE < product < _FAR_FROM_ONE:
            half, product = half + math.log(product), 1.0
        a[i, i] = 1 / pivot  # a division takes longer than all else in these short loops
        b[i] = z / pivot
    return half + math.log(product)


@compiled_inside
def invert(a: FloatArray) -> None:
    """Replace a Cholesky factor (lower triangle, of the diagonal the inverse) by the lower triangle of C^-1."""
    size = len(a)
    for i in range(size):  # L^-1: row i of L and the rows above
        for k in range(i):
            own = -a[i, k] * a[i, i]
            for j in range(k):
                a[i, j] += own * a[k, j]
            a[i, k] = own * a[k, k]
    for i in range(size):  # L^-T L^-1: row i and the rows below
        own = a[i, i]
        for j in range(i + 1):
            a[i, j] *= own
        for k in range(i + 1, size):
            own = a[k, i]
            for j in range(i + 1):
                a[i, j] += own * a[k, j]


@compiled_inside
def log_density(p: Problem, theta: FloatArray, w: Work, with_prior: bool) -> float:
    """Return the log posterior (or likelihood) of one theta; leave prediction, factor and whitened residual in w.

    Where the prior is 0 both are minus infinity, and w is left alone.
    """
    prior = p.ln_prior_norm
    for d in range(len(theta)):
        normal = p.prior[d]
        if not (normal["low"] <= theta[d] <= normal["high"]):
            return -math.inf
        prior -= 0.5 * ((theta[d] - normal["mean"]) / normal["sd"]) ** 2
    predict(p, theta, w)
    fill_covariance(p, theta, w)
    rows = len(p.rows)
    for i in range(rows):
        w.row[Z, i] = p.rows[i]["y"] - w.row[MU, i]
    value = -0.5 * rows * _LN_2PI - factorise(w.factor, w.row[Z])
    for i in range(rows):
        value -= 0.5 * w.row[Z, i] ** 2
    if not (math.isfinite(value) and math.isfinite(prior)):
        return -math.inf
    return value + prior if with_prior else value


_DIFFERENCE = 1e-5  # step of derivatives, in prior standard deviations
_INSIDE = 1e-6  # distance kept from a truncation, in prior standard deviations
_FIRST_DAMPING, _LEAST_DAMPING, _LARGEST_DAMPING = 5e-2, 1e-9, 1e8
_FALL, _RISE = 5.0, 6.0  # of the damping after a step that was accepted or refused
_LEAST_GAIN_NATS = 1e-5

_RESIDUAL: Final = 0
_MU: Final = 1
_JACOBIAN: Final = 2
"""Rows of the linear model, (2 + D, K)."""


@compiled_inside
def _linearise(p: Problem, theta: FloatArray, w: Work, linear: FloatArray) -> None:
    """Fill residual and derivative of the prediction at theta, whitened, for what log_density() left there.

    Derivatives by forward differences.
    """
    rows = len(p.rows)
    for i in range(rows):
        linear[_RESIDUAL, i], linear[_MU, i] = w.row[Z, i], w.row[MU, i]
    for d in range(len(theta)):
        h, at = _DIFFERENCE * p.prior[d]["sd"], theta[d]
        theta[d] = at + h
        predict(p, theta, w)
        theta[d] = at
        for i in range(rows):
            s = (w.row[MU, i] - linear[_MU, i]) / h
            for j in range(i):
                s -= w.factor[i, j] * linear[_JACOBIAN + d, j]
            linear[_JACOBIAN + d, i] = s * w.factor[i, i]


@compiled_inside
def _damped_step(
    prior: NDArray[np.void], theta: FloatArray, linear: FloatArray, damping: float, normal: FloatArray, step: FloatArray
) -> None:
    """Fill the Levenberg-Marquardt step (D,)."""
    size, rows = len(theta), linear.shape[1]
    for d in range(size):
        precision = prior[d]["sd"] ** -2
        step[d] = -(theta[d] - prior[d]["mean"]) * precision
        for i in range(rows):
            step[d] += linear[_JACOBIAN + d, i] * linear[_RESIDUAL, i]
        for e in range(d + 1):
            s = 0.0
            for i in range(rows):
                s += linear[_JACOBIAN + d, i] * linear[_JACOBIAN + e, i]
            normal[d, e] = (s + precision) * (1 + damping) if e == d else s
    factorise(normal, step)
    for d in range(size - 1, -1, -1):
        for e in range(d + 1, size):
            step[d] -= normal[e, d] * step[e]
        step[d] *= normal[d, d]


@compiled_inside
def climb(p: Problem, theta: FloatArray, w: Work, steps: int) -> float:
    """Move theta (D,) by Levenberg-Marquardt steps towards a maximum; return the log posterior there.

    The covariance is held within a step and renewed at every accepted one; steps are accepted by the true density.
    Without steps theta stays, and w holds what log_density() leaves.
    """
    size = len(theta)
    linear, normal, moves = np.empty((_JACOBIAN + size, len(p.rows))), np.empty((size, size)), np.empty((2, size))
    step, moved = moves[0], moves[1]
    for d in range(size):
        moved[d] = theta[d]
    best, damping = -math.inf, _FIRST_DAMPING
    for taken in range(steps + 1):
        new = log_density(p, moved, w, True)
        gain = new - best
        if gain > 0:
            best, damping = new, max(damping / _FALL, _LEAST_DAMPING)
            for d in range(size):
                theta[d] = moved[d]
        else:
            damping *= _RISE
        if taken == steps or 0 < gain < _LEAST_GAIN_NATS or damping > _LARGEST_DAMPING:
            break
        if gain > 0:
            _linearise(p, theta, w, linear)
        _damped_step(p.prior, theta, linear, damping, normal, step)
        for d in range(size):
            own = p.prior[d]
            limit = own["sd"]
            at = theta[d] + min(max(step[d], -limit), limit)
            moved[d] = min(max(at, own["low"] + _INSIDE * limit), own["high"] - _INSIDE * limit)
    return best


LOG_POSTERIOR: Final = 0
LOG_LIKELIHOOD: Final = 1
PREDICTION: Final = 2
COVARIANCE: Final = 3
PRECISION: Final = 4
TOP: Final = 5


@compiled
def evaluate(p: Problem, theta: FloatArray, quantity: int, steps: int, out: FloatArray) -> None:
    """Fill one row of out with a quantity of each of (n, D) rows; a top is where climbing that many steps ends."""
    rows = len(p.rows)
    w = scratch(rows, len(p.points_nm))
    for n in range(len(theta)):
        if quantity in (LOG_POSTERIOR, LOG_LIKELIHOOD):
            out[n, 0] = log_density(p, theta[n], w, quantity == LOG_POSTERIOR)
        elif quantity == TOP:
            for d in range(theta.shape[1]):
                out[n, d] = theta[n, d]
            climb(p, out[n], w, steps)
        else:
            predict(p, theta[n], w)
            if quantity != PREDICTION:
                fill_covariance(p, theta[n], w)
            if quantity == PRECISION:
                factorise(w.factor, w.row[MU])
                invert(w.factor)
            for i in range(rows):
                if quantity == PREDICTION:
                    out[n, i] = w.row[MU, i]
                else:
                    for j in range(i + 1):
                        out[n, i * rows + j] = w.factor[i, j]
                        out[n, j * rows + i] = w.factor[i, j]
