r"""How well each band is predicted from the others.

.. math:: p(y_b | y_{-b}) = \left[ E_{\theta|y}\, \frac{1}{p(y_b | y_{-b}, \theta)} \right]^{-1}

Without a band the posterior is wider, so posterior draws are the wrong sample for it: the draws of the proposal, whose
tails are heavier, are weighted anew for each band instead. Given theta the bands are jointly normal, and the
conditional density follows from the inverse covariance. A leak of the band's own that is sampled is known from that
band alone: it is integrated over its prior again. The excitation band has no score: it measures the reflectance at the
laser, which no other band predicts and no family of emission curves describes.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from finray_calib.fit.importance import WeightedSample
from finray_calib.fit.likelihood import LogPosterior
from finray_calib.fit.mixture_proposal import log_sum_exp
from finray_calib.fit.pareto_smoothing import smooth_weights

FloatArray = NDArray[np.float64]

_DRAWS: Final = 2000
_NODES, _NODE_WEIGHTS = np.polynomial.hermite_e.hermegauss(12)
_PEAK_STEPS: Final = 12  # of at most one prior standard deviation


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
    precision, predicted = log_posterior.precisions(theta), log_posterior.predict_usable(theta)
    pull = np.einsum("nij,nj->ni", precision, p.y - predicted)
    bands = log_posterior.data.weights.bands
    score, k = np.full(bands, np.nan), np.full(bands, np.nan)
    excitation = log_posterior.data.weights.band_index[np.argmax(log_posterior.data.weights.is_excitation)]
    for band in np.setdiff1d(p.band, excitation):
        rows = np.flatnonzero(p.band == band)
        own = precision[:, rows][:, :, rows]
        error = np.linalg.solve(own, pull[:, rows, None])[..., 0]
        quadratic = np.einsum("ni,nij,nj->n", error, own, error)
        if band in log_posterior.own_leaks:
            quadratic = _without_own_leak(log_posterior, theta, rows, predicted[:, rows], error, own)
        ln_p = 0.5 * (np.linalg.slogdet(own)[1] - quadratic - rows.size * np.log(2 * np.pi))
        smoothed = smooth_weights(ln_weight - ln_p)
        top = float(ln_p.max())
        score[band] = float(np.log(smoothed.weight @ np.exp(ln_p - top))) + top
        k[band] = smoothed.pareto_k
    return BandPrediction(score, k)


def _without_own_leak(
    log_posterior: LogPosterior,
    theta: FloatArray,
    rows: NDArray[np.int64],
    predicted: FloatArray,
    error: FloatArray,
    precision: FloatArray,
) -> FloatArray:
    r"""Return -2 ln of the mean of exp(-e^T P e / 2) over the prior of the band's own leak, (n,).

    With the leak x the prediction moves as g = (x - 1) / (1 + (x - 1) w), of which it is a linear function. By
    Gauss-Hermite nodes around the peak in z = ln(x / common) / sd.
    """
    p = log_posterior.problem
    own = p.rows[rows]
    column, sd, white = own["leak_at"][0], own["leak_sd"][0], own["leaked_white"]
    common, drawn = np.exp(theta[:, p.shapes + 1]), theta[:, column]

    def opened(z: FloatArray) -> tuple[FloatArray, FloatArray]:
        leak = (common * np.exp(sd * z))[:, None]
        below = 1 + (leak - 1) * white
        return (leak - 1) / below, sd * leak / below**2

    beside = theta.copy()
    beside[:, column] += 1.0
    change = log_posterior.predict_usable(beside)[:, rows] - predicted
    start = opened(drawn)[0]
    slope = change / (opened(drawn + 1.0)[0] - start)
    peak = drawn.copy()
    for _ in range(_PEAK_STEPS):
        now, rate = opened(peak)
        pull = np.einsum("ni,nij->nj", slope * rate, precision)
        curvature = 1 + np.einsum("nj,nj->n", pull, slope * rate)
        downhill = np.einsum("nj,nj->n", pull, error - slope * (now - start)) - peak
        peak = peak + np.clip(downhill / curvature, -1.0, 1.0)
    terms = []
    for node, weight in zip(_NODES, _NODE_WEIGHTS, strict=True):
        z = peak + node / np.sqrt(curvature)
        left = error - slope * (opened(z)[0] - start)
        terms.append(np.log(weight) + 0.5 * (node**2 - z**2 - np.einsum("ni,nij,nj->n", left, precision, left)))
    return np.asarray(np.log(2 * np.pi * curvature) - 2 * log_sum_exp(np.array(terms)))
