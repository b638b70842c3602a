"""Posterior predictive checks that tell whether the fitted curve describes each band."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from finray_calib.fit.likelihood import LogPosterior
from finray_calib.fit.normal_distribution import chi_square_survival
from finray_calib.fit.nuisances import band_values

FloatArray = NDArray[np.float64]

_MOST_DRAWS = 500  # enough for a p-value to 2 %


@dataclass(frozen=True, slots=True)
class BandCheck:
    """Agreement of data and model in each band, channels taken together with their covariance.

    Attributes
    ----------
    chi2
        (B,) posterior mean chi-square; NaN where no channel is usable.
    degrees_of_freedom
        (B,) usable channels of the band.
    p_value
        (B,) posterior predictive probability of a larger chi-square; near 0 where the curve cannot follow the
        data. NaN where no channel is usable.
    total_chi2
        Posterior mean chi-square of all usable values with their full covariance.
    predicted_mean
        (B, C) posterior mean of the band values of the family's curve, dimensionless.
    predicted_sd
        (B, C) standard deviation of the predicted band values: posterior, imperfections of the rig and discrepancy
        together, without measurement noise. Where a value is not usable: of the posterior alone.
    """

    chi2: FloatArray
    degrees_of_freedom: NDArray[np.int64]
    p_value: FloatArray
    total_chi2: float
    predicted_mean: FloatArray
    predicted_sd: FloatArray


def check_bands(log_posterior: LogPosterior, draws: FloatArray) -> BandCheck:
    """Return the per-band posterior predictive check.

    T_b(theta) = (y - mu)_b^T C_bb^-1 (y - mu)_b with C the covariance of measurement, imperfections and discrepancy,
    over the band's usable channels. A replicate's T_b is chi-square with as many degrees of freedom as usable
    channels, so the predictive p is the mean over draws of the chi-square survival function of T_b.

    Parameters
    ----------
    log_posterior
        Measured band values with their covariance.
    draws
        (N, D) posterior draws.

    References
    ----------
    Gelman, Meng, Stern, Posterior predictive assessment of model fitness, Statistica Sinica 6 (1996) 733-807.
    """
    data, p = log_posterior.data, log_posterior.problem
    draws = draws[:: max(1, len(draws) // _MOST_DRAWS)]
    predicted, covariance = log_posterior.predict_usable(draws), log_posterior.covariances(draws)
    residual = p.y - predicted
    bands = data.weights.bands
    chi2, p_value = np.full(bands, np.nan), np.full(bands, np.nan)
    freedom = np.bincount(p.band, minlength=bands).astype(np.int64)
    for band in np.flatnonzero(freedom):
        rows = np.flatnonzero(p.band == band)
        own = residual[:, rows]
        each = np.einsum("ni,ni->n", own, np.linalg.solve(covariance[:, rows][:, :, rows], own[..., None])[..., 0])
        chi2[band], p_value[band] = each.mean(), chi_square_survival(each, rows.size).mean()
    total = np.einsum("ni,ni->n", residual, np.linalg.solve(covariance, residual[..., None])[..., 0])
    curves = log_posterior.family.curves(draws, data.weights.wavelength_nm)
    every = band_values(curves, np.exp(draws[:, p.shapes]), data.weights, log_posterior.leaks(draws))
    variance = every.var(axis=0, ddof=1)
    measured = np.diag(data.covariance)[data.kept]
    variance[data.kept] += np.diagonal(covariance, axis1=1, axis2=2).mean(axis=0) - measured
    shape = data.y.shape
    return BandCheck(
        chi2,
        freedom,
        p_value,
        float(total.mean()),
        every.mean(axis=0).reshape(shape),
        np.sqrt(np.maximum(variance, 0.0)).reshape(shape),
    )
