r"""How well each band is predicted from the others.

.. math:: p(y_b | y_{-b}) = \left[ E_{\theta|y}\, \frac{1}{p(y_b | y_{-b}, \theta)} \right]^{-1}

Without a band the posterior is wider, so posterior draws are the wrong sample for it: the draws of the proposal, whose
tails are heavier, are weighted anew for each band instead. Given theta the bands are jointly normal, and the
conditional density follows from the inverse covariance. The excitation band has no score: it measures the reflectance
at the laser, which no other band predicts and no family of emission curves describes.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from finray_calib.fit.importance import WeightedSample
from finray_calib.fit.likelihood import LogPosterior
from finray_calib.fit.pareto_smoothing import smooth_weights

FloatArray = NDArray[np.float64]

_DRAWS: Final = 2000


@dataclass(frozen=True, slots=True)
class BandPrediction:
    """Predictive scores of the left-out bands.

    Attributes
    ----------
    ln_density
        (B,) ln p(y_b | y_-b), nats; NaN for the excitation band and where no channel is usable. Higher is better.
    pareto_k
        (B,) diagnostic of the weights without the band; above 0.7 the band decides the fit and its score is only
        indicative.
    """

    ln_density: FloatArray
    pareto_k: FloatArray

    @property
    def total(self) -> float:
        """Sum over the bands, nats."""
        return float(np.nansum(self.ln_density))


def leave_one_band_out(log_posterior: LogPosterior, sample: WeightedSample) -> BandPrediction:
    """Return the leave-one-band-out predictive score of each band.

    Parameters
    ----------
    log_posterior
        Data, family and discrepancy.
    sample
        Weighted draws of the posterior, from a proposal with heavier tails.

    References
    ----------
    Burkner, Gabry, Vehtari, Efficient leave-one-out cross-validation for Bayesian non-factorized normal and Student-t
    models, Computational Statistics 36 (2021) 1243-1261.
    """
    p = log_posterior.problem
    kept = np.flatnonzero(sample.weight > 0)[:_DRAWS]
    theta, ln_weight = sample.theta[kept], np.log(sample.weight[kept])
    precision = np.linalg.inv(log_posterior.covariances(theta))
    pull = np.einsum("nij,nj->ni", precision, p.y - log_posterior.predict_usable(theta))
    bands = log_posterior.data.weights.bands
    score, k = np.full(bands, np.nan), np.full(bands, np.nan)
    excitation = log_posterior.data.weights.band_index[np.argmax(log_posterior.data.weights.is_excitation)]
    for band in np.setdiff1d(p.band, excitation):
        rows = np.flatnonzero(p.band == band)
        own, error = precision[:, rows][:, :, rows], pull[:, rows]
        quadratic = np.einsum("ni,ni->n", error, np.linalg.solve(own, error[..., None])[..., 0])
        ln_p = 0.5 * (np.linalg.slogdet(own)[1] - quadratic - rows.size * np.log(2 * np.pi))
        smoothed = smooth_weights(ln_weight - ln_p)
        top = float(ln_p.max())
        score[band] = float(np.log(smoothed.weight @ np.exp(ln_p - top))) + top
        k[band] = smoothed.pareto_k
    return BandPrediction(score, k)
