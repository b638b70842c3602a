"""Damped Gauss-Newton steps of a block of pixels side by side, each lane at its own pace."""

import math
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from finray_calib.fit.pixel_curves import LANES
from finray_calib.fit.pixel_normal import COST, PARAMETERS, ROWS, PixelBlock, PixelProblem, factorise, solve
from finray_calib.spectra.compiled import compiled

FloatArray = NDArray[np.float64]
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
