"""Posterior predictive checks that tell whether the fitted curve describes each band."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2 as chi2_distribution

from finray_calib.fit.likelihood import LogPosterior
from finray_calib.fit.nuisances import predict_bands

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class BandCheck:
    """Agreement of data and model in each band, channels taken together with their covariance.

    Attributes
    ----------
    chi2
        (B,) chi-square of the posterior mean prediction; NaN where no channel is usable.
    degrees_of_freedom
        (B,) usable channels of the band.
    p_value
        (B,) posterior predictive probability of a larger chi-square; near 0 where the curve cannot follow the
        data. NaN where no channel is usable.
    total_chi2
        Chi-square of all usable values with their full covariance at the posterior mean prediction.
    predicted_mean
        (B, C) posterior mean of the predicted band values, dimensionless.
    predicted_sd
        (B, C) standard deviation of the predicted band values: posterior and imperfections of the rig together,
        without measurement noise.
    """

    chi2: FloatArray
    degrees_of_freedom: NDArray[np.int64]
    p_value: FloatArray
    total_chi2: float
    predicted_mean: FloatArray
    predicted_sd: FloatArray


def check_bands(log_posterior: LogPosterior, draws: FloatArray) -> BandCheck:
    """Return the per-band posterior predictive check.

    T_b(theta) = (y - mu)_b^T C_bb^-1 (y - mu)_b with C the covariance of measurement and imperfections, over the
    band's usable channels. A replicate's T_b is chi-square with as many degrees of freedom as usable channels, so
    the predictive p is the mean over draws of the chi-square survival function of T_b.

    Parameters
    ----------
    log_posterior
        Measured band values with their covariance.
    draws
        (N, 6) posterior draws.

    References
    ----------
    Gelman, Meng, Stern, Posterior predictive assessment of model fitness, Statistica Sinica 6 (1996) 733-807.
    """
    data = log_posterior.data
    predicted = predict_bands(draws, data.weights)
    mean, variance = predicted.mean(axis=0), predicted.var(axis=0, ddof=1)
    bands, of_row = data.weights.bands, data.weights.band_index[data.kept]
    chi2, p_value = np.full(bands, np.nan), np.full(bands, np.nan)
    freedom = np.array([(of_row == band).sum() for band in range(bands)], dtype=np.int64)
    for band in np.flatnonzero(freedom):
        members = np.flatnonzero(of_row == band)
        rows = data.kept[members]
        precision = np.linalg.inv(log_posterior.covariance[np.ix_(members, members)])
        residual = data.y.ravel()[rows] - np.vstack([mean, predicted])[:, rows]
        each = ((residual @ precision) * residual).sum(axis=1)
        chi2[band], p_value[band] = each[0], chi2_distribution.sf(each[1:], rows.size).mean()
    measured = np.diag(data.covariance)[data.kept]
    variance[data.kept] += np.diag(log_posterior.covariance) - measured
    shape = data.y.shape
    residual = data.y.ravel()[data.kept] - mean[data.kept]
    total = float(residual @ np.linalg.solve(log_posterior.covariance, residual))
    return BandCheck(chi2, freedom, p_value, total, mean.reshape(shape), np.sqrt(variance).reshape(shape))
