r"""How well each band is predicted from the others.

.. math:: p(y_b | y_{-b}) = \left[ E_{\theta|y}\, \frac{1}{p(y_b | y_{-b}, \theta)} \right]^{-1}

by importance weights of the posterior draws, Pareto-smoothed. Within a draw the bands are jointly normal, so the
conditional density follows from the inverse covariance.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from finray_calib.fit.likelihood import LogPosterior
from finray_calib.fit.pareto_smoothing import smooth_weights

FloatArray = NDArray[np.float64]

_MOST_DRAWS = 1000


@dataclass(frozen=True, slots=True)
class BandPrediction:
    """Predictive scores of the left-out bands.

    Attributes
    ----------
    ln_density
        (B,) ln p(y_b | y_-b), nats; NaN where no channel is usable. Higher is better.
    pareto_k
        (B,) diagnostic of the weights; above 0.7 the band decides the fit and its score is only indicative.
    """

    ln_density: FloatArray
    pareto_k: FloatArray

    @property
    def total(self) -> float:
        """Sum over the bands, nats."""
        return float(np.nansum(self.ln_density))


def leave_one_band_out(log_posterior: LogPosterior, draws: FloatArray) -> BandPrediction:
    """Return the leave-one-band-out predictive score of each band.

    Parameters
    ----------
    log_posterior
        Data, family and discrepancy.
    draws
        (N, D) posterior draws of equal weight.

    References
    ----------
    Vehtari, Gelman, Gabry, Practical Bayesian model evaluation using leave-one-out cross-validation and WAIC,
    Statistics and Computing 27 (2017) 1413-1432; Burkner, Gabry, Vehtari, Efficient leave-one-out cross-validation
    for Bayesian non-factorized normal and Student-t models, Computational Statistics 36 (2021) 1243-1261.
    """
    p = log_posterior.problem
    theta = draws[:: max(1, len(draws) // _MOST_DRAWS)]
    precision = np.linalg.inv(log_posterior.covariances(theta))
    pull = np.einsum("nij,nj->ni", precision, p.y - log_posterior.predict_usable(theta))
    bands = log_posterior.data.weights.bands
    score, k = np.full(bands, np.nan), np.full(bands, np.nan)
    for band in np.unique(p.band):
        rows = np.flatnonzero(p.band == band)
        own, error = precision[:, rows][:, :, rows], pull[:, rows]
        quadratic = np.einsum("ni,ni->n", error, np.linalg.solve(own, error[..., None])[..., 0])
        ln_p = 0.5 * (np.linalg.slogdet(own)[1] - quadratic - rows.size * np.log(2 * np.pi))
        smoothed = smooth_weights(-ln_p)
        score[band] = float(np.log(smoothed.weight @ np.exp(ln_p - ln_p.max())) + ln_p.max())
        k[band] = smoothed.pareto_k
    return BandPrediction(score, k)
