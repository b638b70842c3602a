"""Posterior predictive checks that tell whether the fitted curve describes each band."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2 as chi2_distribution

from finray_calib.fit.likelihood import BandData
from finray_calib.fit.nuisances import marginal_chi2, whitening

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
    predicted_mean
        (B, C) posterior mean of the predicted band values, dimensionless.
    predicted_sd
        (B, C) posterior standard deviation of the predicted band values, without measurement noise.
    """

    chi2: FloatArray
    degrees_of_freedom: NDArray[np.int64]
    p_value: FloatArray
    predicted_mean: FloatArray
    predicted_sd: FloatArray


def check_bands(data: BandData, draws: FloatArray) -> BandCheck:
    """Return the per-band posterior predictive check.

    T_b(theta) = (y - mu)_b^T C_b(theta)^-1 (y - mu)_b with C_b the covariance of the band's usable channels,
    calibration error included. A replicate's T_b is chi-square with as many degrees of freedom as usable
    channels, so the predictive p is the mean over draws of the chi-square survival function of T_b.

    Parameters
    ----------
    data
        Measured band values.
    draws
        (N, 6) posterior draws.

    References
    ----------
    Gelman, Meng, Stern, Posterior predictive assessment of model fitness, Statistica Sinica 6 (1996) 733-807.
    """
    predicted, columns = data.model().predict(draws)
    mean = predicted.mean(axis=0)
    bands = data.weights.bands
    chi2, p_value = np.full(bands, np.nan), np.full(bands, np.nan)
    freedom = np.zeros(bands, dtype=np.int64)
    for band in range(bands):
        rows = data.kept[data.weights.band_index[data.kept] == band]
        freedom[band] = rows.size
        if rows.size:
            whiten = whitening(data.covariance[np.ix_(rows, rows)])
            y = data.y.ravel()[rows]
            chi2[band] = marginal_chi2(y - mean[None, rows], columns.mean(axis=0)[None, rows], whiten)[0][0]
            each = marginal_chi2(y - predicted[:, rows], columns[:, rows], whiten)[0]
            p_value[band] = chi2_distribution.sf(each, rows.size).mean()
    shape = data.y.shape
    return BandCheck(chi2, freedom, p_value, mean.reshape(shape), predicted.std(axis=0, ddof=1).reshape(shape))
