"""Compiled Levenberg-Marquardt steps to a local maximum of the posterior."""

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from finray_calib.fit.posterior_kernel import MU, Problem, Work, Z, factorise, log_density, predict
from finray_calib.spectra.compiled import compiled_inside

FloatArray = NDArray[np.float64]

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
