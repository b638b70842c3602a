"""The one compiled function of the posterior that Python calls: several would each compile all that they share."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from finray_calib.fit.climb_kernel import climb
from finray_calib.fit.posterior_kernel import (
    MU,
    Problem,
    factorise,
    fill_covariance,
    invert,
    log_density,
    predict,
    scratch,
)
from finray_calib.spectra.compiled import compiled

FloatArray = NDArray[np.float64]

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
