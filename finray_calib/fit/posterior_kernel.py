"""The compiled log posterior: band values of a curve, covariance with discrepancy, normal log density."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from finray_calib.fit.discrepancy import EDGE_OFFSET_FWHM, EDGE_WIDTH_FWHM
from finray_calib.spectra.band_quadrature import NODES
from finray_calib.spectra.compiled import compiled
from finray_calib.spectra.family_kernels import CONSTANTS, constants, fill

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

_LN_2PI = math.log(2 * math.pi)
_DIFFERENCE = 1e-5  # step of derivatives, in prior standard deviations
_INSIDE = 1e-6  # distance kept from a truncation, in prior standard deviations
_FIRST_DAMPING, _LEAST_DAMPING, _LARGEST_DAMPING = 1e-2, 1e-9, 1e8
_LEAST_GAIN_NATS = 1e-5


class TruncatedNormals(NamedTuple):
    """The prior of D parameters."""

    mean: FloatArray  # (D,)
    sd: FloatArray
    low: FloatArray
    high: FloatArray
    ln_norm: float


class Problem(NamedTuple):
    """Everything the compiled functions need; K usable rows, B bands, Q nodes a band, G grid points, D parameters.

    Theta is the family's parameters, then ln(reflectance at the laser), then ln(blocking) and the own leaks where they
    are sampled.
    """

    family: int
    shapes: int  # number of the family's parameters
    has_blocking: bool
    table: FloatArray
    band: IntArray  # (K,)
    points_nm: FloatArray  # (B Q + G,) the bands' nodes, band after band, then the grid
    in_band: FloatArray  # (K, Q)
    out_of_band: FloatArray  # (K, G)
    leaked: FloatArray  # (K, G)
    laser: FloatArray  # (K,)
    leaked_laser: FloatArray  # (K,)
    leaked_white: FloatArray  # (K,)
    leak_mean: FloatArray  # (K,) mean over median of the row's own leak
    leak_sd: FloatArray  # (K,) standard deviation of its logarithm
    leak_at: IntArray  # (K,) where theta holds it, in these standard deviations; 0 where it is not sampled
    y: FloatArray  # (K,)
    covariance: FloatArray  # (K, K) measurement and imperfections
    whiten: FloatArray  # (K, K) inverse Cholesky factor of the covariance
    ln_norm: float  # of the normal density with that covariance
    discrepancy: bool
    kernel: FloatArray  # (B Q, B Q) smooth part between all nodes
    near: IntArray  # (B, B) 1 where two bands share discrepancy
    floor_rel: float
    reabsorption_rel: float
    prior: TruncatedNormals


class Work(NamedTuple):
    """Scratch arrays of one evaluation."""

    c: FloatArray
    curve: FloatArray  # at the points
    mu: FloatArray
    scaled: FloatArray
    pull: FloatArray
    edge: FloatArray
    factor: FloatArray
    z: FloatArray


@compiled
def scratch(rows: int, points: int, bands: int) -> Work:
    """Return scratch arrays of the right sizes."""
    return Work(
        np.empty(CONSTANTS),
        np.empty(points),
        np.empty(rows),
        np.empty((rows, NODES)),
        np.empty((bands, NODES)),
        np.empty(rows),
        np.empty((rows, rows)),
        np.empty(rows),
    )


@compiled
def predict(p: Problem, theta: FloatArray, w: Work) -> None:
    """Fill w.mu with the band values of one parameter vector, and the curve at all points."""
    constants(p.family, theta, p.table, w.c)
    fill(p.family, w.c, p.points_nm, w.curve)
    rho = math.exp(theta[p.shapes])
    blocking = math.exp(theta[p.shapes + 1]) if p.has_blocking else 1.0
    grid = w.curve[len(p.near) * NODES :]
    for i in range(len(p.y)):
        first, emitted, leaked = p.band[i] * NODES, 0.0, 0.0
        own = math.exp(p.leak_sd[i] * theta[p.leak_at[i]]) if p.leak_at[i] > 0 else p.leak_mean[i]
        more = blocking * own - 1
        for q in range(NODES):
            emitted += p.in_band[i, q] * w.curve[first + q]
        for g in range(len(grid)):
            emitted += p.out_of_band[i, g] * grid[g]
        if p.has_blocking:
            for g in range(len(grid)):
                leaked += p.leaked[i, g] * grid[g]
        laser = p.laser[i] + more * p.leaked_laser[i]
        w.mu[i] = (emitted + more * leaked + rho * laser) / (1 + more * p.leaked_white[i])


@compiled
def add_discrepancy(p: Problem, theta: FloatArray, w: Work) -> None:
    """Fill w.factor with covariance plus discrepancy (lower triangle), for the curve that predict() left."""
    scaled, pull, edge, factor, kernel = w.scaled, w.pull, w.edge, w.factor, p.kernel
    floor = p.floor_rel * math.exp(theta[2])
    width = math.exp(theta[1])
    rows, bands = len(p.y), len(pull)
    if p.reabsorption_rel > 0:
        for b in range(bands):
            for q in range(NODES):
                u = (p.points_nm[b * NODES + q] - theta[0] + EDGE_OFFSET_FWHM * width) / (EDGE_WIDTH_FWHM * width)
                pull[b, q] = p.reabsorption_rel / (1 + math.exp(min(u, 60.0)))
    for i in range(rows):
        b, s = p.band[i], 0.0
        for q in range(NODES):
            scaled[i, q] = p.in_band[i, q] * (w.curve[b * NODES + q] + floor)
        if p.reabsorption_rel > 0:
            for q in range(NODES):
                s += scaled[i, q] * pull[b, q]
        edge[i] = s
    for j in range(rows):
        own = p.band[j]
        for b in range(own, bands):
            if p.near[b, own]:
                for q in range(NODES):
                    part = 0.0
                    for r in range(NODES):
                        part += kernel[b * NODES + q, own * NODES + r] * scaled[j, r]
                    pull[b, q] = part
        for i in range(j, rows):
            total, b = p.covariance[i, j] + edge[i] * edge[j], p.band[i]
            if p.near[b, own]:
                for q in range(NODES):
                    total += scaled[i, q] * pull[b, q]
            factor[i, j] = total


@compiled
def factorise(a: FloatArray) -> float:
    """Replace the lower triangle by its Cholesky factor; return half the log determinant."""
    half = 0.0
    for i in range(len(a)):
        for j in range(i + 1):
            s = a[i, j]
            for k in range(j):
                s -= a[i, k] * a[j, k]
            if i == j:
                a[i, i] = math.sqrt(max(s, 1e-300))
                half += math.log(a[i, i])
            else:
                a[i, j] = s / a[j, j]
    return half


@compiled
def log_prior(prior: TruncatedNormals, theta: FloatArray) -> float:
    """Return the log prior density, minus infinity outside the truncation."""
    s = prior.ln_norm
    for d in range(len(theta)):
        if not (prior.low[d] <= theta[d] <= prior.high[d]):
            return -math.inf
        s -= 0.5 * ((theta[d] - prior.mean[d]) / prior.sd[d]) ** 2
    return s


@compiled
def log_likelihood_one(p: Problem, theta: FloatArray, w: Work) -> float:
    """Return ln p(y | theta) of one parameter vector, and leave the whitened residual in w.z."""
    # one function where two would read better: what takes a Problem costs a second to compile
    rows = len(p.y)
    predict(p, theta, w)
    if p.discrepancy:
        add_discrepancy(p, theta, w)
        value = -0.5 * rows * _LN_2PI - factorise(w.factor)
    else:
        value = p.ln_norm
    for i in range(rows):
        s = 0.0
        if p.discrepancy:
            s = p.y[i] - w.mu[i]
            for j in range(i):
                s -= w.factor[i, j] * w.z[j]
            s /= w.factor[i, i]
        else:
            for j in range(i + 1):
                s += p.whiten[i, j] * (p.y[j] - w.mu[j])
        w.z[i] = s
        value -= 0.5 * s * s
    return value if math.isfinite(value) else -math.inf


@compiled
def log_posterior(p: Problem, theta: FloatArray, with_prior: bool) -> FloatArray:
    """Return the log posterior (or likelihood) of (n, D) rows, (n,)."""
    out, w = np.empty(len(theta)), scratch(len(p.y), len(p.points_nm), len(p.near))
    for i in range(len(theta)):
        prior = log_prior(p.prior, theta[i])
        out[i] = prior
        if prior > -math.inf:
            out[i] = log_likelihood_one(p, theta[i], w) + (prior if with_prior else 0.0)
    return out


@compiled
def predictions(p: Problem, theta: FloatArray) -> FloatArray:
    """Return the predicted usable band values of (n, D) rows, (n, K)."""
    out, w = np.empty((len(theta), len(p.y))), scratch(len(p.y), len(p.points_nm), len(p.near))
    for i in range(len(theta)):
        predict(p, theta[i], w)
        for k in range(len(p.y)):
            out[i, k] = w.mu[k]
    return out


@compiled
def covariances(p: Problem, theta: FloatArray) -> FloatArray:
    """Return the covariance of the usable band values at each of (n, D) rows, (n, K, K)."""
    rows = len(p.y)
    out, w = np.empty((len(theta), rows, rows)), scratch(len(p.y), len(p.points_nm), len(p.near))
    for n in range(len(theta)):
        if p.discrepancy:
            predict(p, theta[n], w)
            add_discrepancy(p, theta[n], w)
        for i in range(rows):
            for j in range(i + 1):
                c = w.factor[i, j] if p.discrepancy else p.covariance[i, j]
                out[n, i, j] = c
                out[n, j, i] = c
    return out


@compiled
def _linearise(p: Problem, theta: FloatArray, w: Work, residual: FloatArray, jacobian: FloatArray) -> None:
    """Fill the whitened residual (K,) and the whitened derivative of the prediction (K, D) at theta.

    The covariance of this theta whitens both; derivatives by forward differences.
    """
    rows = len(p.y)
    log_likelihood_one(p, theta, w)
    mu, factor, moved = w.mu.copy(), w.factor.copy(), theta.copy()
    for i in range(rows):  # element by element: numba compiles slice assignment ten times longer
        residual[i] = w.z[i]
    for d in range(len(theta)):
        h = _DIFFERENCE * p.prior.sd[d]
        moved[d] = theta[d] + h
        predict(p, moved, w)
        moved[d] = theta[d]
        for i in range(rows):
            s = 0.0
            if p.discrepancy:
                s = (w.mu[i] - mu[i]) / h
                for j in range(i):
                    s -= factor[i, j] * jacobian[j, d]
                s /= factor[i, i]
            else:
                for j in range(i + 1):
                    s += p.whiten[i, j] * (w.mu[j] - mu[j]) / h
            jacobian[i, d] = s


@compiled
def _damped_step(
    prior: TruncatedNormals,
    theta: FloatArray,
    residual: FloatArray,
    jacobian: FloatArray,
    damping: float,
    normal: FloatArray,
    step: FloatArray,
) -> None:
    """Fill the Levenberg-Marquardt step (D,)."""
    size, rows = len(theta), len(residual)
    for d in range(size):
        step[d] = -(theta[d] - prior.mean[d]) / prior.sd[d] ** 2
        for i in range(rows):
            step[d] += jacobian[i, d] * residual[i]
        for e in range(d + 1):
            s = 0.0
            for i in range(rows):
                s += jacobian[i, d] * jacobian[i, e]
            normal[d, e] = (s + prior.sd[d] ** -2) * (1 + damping) if e == d else s
    factorise(normal)
    for d in range(size):
        for e in range(d):
            step[d] -= normal[d, e] * step[e]
        step[d] /= normal[d, d]
    for d in range(size - 1, -1, -1):
        for e in range(d + 1, size):
            step[d] -= normal[e, d] * step[e]
        step[d] /= normal[d, d]


@compiled
def climb(p: Problem, start: FloatArray, iterations: int) -> FloatArray:
    """Return where Levenberg-Marquardt steps from `start` (D,) end, (D,).

    The covariance is held within a step and renewed at every accepted one; steps are accepted by the true density.
    """
    size, rows = len(start), len(p.y)
    w, theta, moved = scratch(len(p.y), len(p.points_nm), len(p.near)), start.copy(), start.copy()
    residual, jacobian = np.empty(rows), np.empty((rows, size))
    normal, step = np.empty((size, size)), np.empty(size)
    best = log_likelihood_one(p, theta, w) + log_prior(p.prior, theta)
    damping, fresh = _FIRST_DAMPING, True
    for _ in range(iterations):
        if fresh:
            _linearise(p, theta, w, residual, jacobian)
        _damped_step(p.prior, theta, residual, jacobian, damping, normal, step)
        for d in range(size):
            limit = p.prior.sd[d]
            moved[d] = theta[d] + min(max(step[d], -limit), limit)
            moved[d] = min(max(moved[d], p.prior.low[d] + _INSIDE * limit), p.prior.high[d] - _INSIDE * limit)
        new = log_likelihood_one(p, moved, w) + log_prior(p.prior, moved)
        fresh = new > best
        if fresh:
            gain, best = new - best, new
            for d in range(size):
                theta[d] = moved[d]
            damping = max(damping / 5, _LEAST_DAMPING)
            if gain < _LEAST_GAIN_NATS:
                break
        else:
            damping *= 6
            if damping > _LARGEST_DAMPING:
                break
    return theta
