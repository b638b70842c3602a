r"""Posterior draws of the emission curve with its discrepancy, and of the rig's imperfections.

Given theta everything else is jointly normal, so a posterior draw is a prior draw plus the correction that its
misfit to the data asks for (Matheron's rule):

.. math:: (\delta, k) = (\delta_0, k_0) + \mathrm{cov}[(\delta, k), y]\,C(\theta)^{-1}
          (y - \mu(\theta) - A\delta_0 - U k_0 - e_0)
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from finray_calib.fit.discrepancy import EDGE_OFFSET_FWHM, EDGE_WIDTH_FWHM, Discrepancy
from finray_calib.fit.likelihood import LogPosterior
from finray_calib.fit.nuisances import blocking_column

FloatArray = NDArray[np.float64]

_RANK_TOLERANCE = 1e-9  # of the largest eigenvalue of the Gaussian process on the grid


@dataclass(frozen=True, slots=True)
class CurveDraws:
    """Joint posterior draws.

    Attributes
    ----------
    curves
        (n, L) emission curves with discrepancy, nm^-1; never negative, zero below the laser line.
    family_curves
        (n, L) the family's curves alone.
    imperfections
        (n, M) the rig's imperfections k in prior standard deviations: calibration of each band, then, when the
        filters have tolerances, blocking, centre and width of each filter.
    """

    curves: FloatArray
    family_curves: FloatArray
    imperfections: FloatArray


def curve_draws(log_posterior: LogPosterior, theta: FloatArray, rng: np.random.Generator) -> CurveDraws:
    """Return one joint draw of discrepancy and imperfections for each parameter row.

    Parameters
    ----------
    log_posterior
        Data, family, discrepancy and imperfections.
    theta
        (n, D) posterior draws.
    rng
        Source of all randomness.
    """
    p, data, d = log_posterior.problem, log_posterior.data, log_posterior.discrepancy
    grid, nodes = data.weights.wavelength_nm, data.quadrature.nodes_nm.ravel()
    split, count = len(grid), len(theta)
    every = np.concatenate([grid, nodes])
    shape = log_posterior.family.curves(theta, every)
    scale = shape + d.floor_rel * np.exp(theta[:, 2, None])
    edge = d.reabsorption_rel * _blue_edge(theta, every)
    relative = _smooth_draws(log_posterior, every, count, rng) + edge * rng.standard_normal((count, 1))
    delta = scale * relative
    u = log_posterior.imperfections
    k = rng.standard_normal((count, u.shape[1]))
    noise = np.linalg.cholesky(data.covariance[np.ix_(data.kept, data.kept)])
    member = np.zeros((len(p.y), len(nodes)))  # in-band weights of each row at all nodes
    columns = p.band[:, None] * p.in_band.shape[1] + np.arange(p.in_band.shape[1])
    np.put_along_axis(member, columns, p.in_band, axis=1)
    simulated = log_posterior.predict_usable(theta) + delta[:, split:] @ member.T + k @ u.T
    misfit = p.y - simulated - rng.standard_normal((count, len(p.y))) @ noise.T
    alpha = np.einsum("nij,nj->ni", log_posterior.precisions(theta), misfit)
    pull = (alpha @ member) * scale[:, split:]
    smooth = pull @ d.smooth_kernel(nodes, grid)
    rigid = edge[:, :split] * (pull * edge[:, split:]).sum(axis=1, keepdims=True)
    curves = shape[:, :split] + delta[:, :split] + scale[:, :split] * (smooth + rigid)
    above = grid >= data.weights.laser_nm
    k += alpha @ u
    for band, column in log_posterior.own_leaks.items():
        k[:, blocking_column(band, data.weights.bands)] = theta[:, column]
    return CurveDraws(np.maximum(curves, 0.0) * above, shape[:, :split] * above, k)


def _blue_edge(theta: FloatArray, wavelength_nm: FloatArray) -> FloatArray:
    """Return the logistic that falls from 1 to 0 around the blue half-maximum, (n, L)."""
    mode, width = theta[:, 0, None], np.exp(theta[:, 1, None])
    u = (wavelength_nm - mode + EDGE_OFFSET_FWHM * width) / (EDGE_WIDTH_FWHM * width)
    return np.asarray(1 / (1 + np.exp(np.minimum(u, 60.0))))


def _smooth_draws(
    log_posterior: LogPosterior, wavelength_nm: FloatArray, count: int, rng: np.random.Generator
) -> FloatArray:
    """Return draws of the Gaussian process from its prior, (n, L)."""
    root = _process_root(log_posterior.discrepancy, wavelength_nm.tobytes())
    return np.asarray(rng.standard_normal((count, root.shape[1])) @ root.T)


@lru_cache(maxsize=4)
def _process_root(discrepancy: Discrepancy, wavelengths: bytes) -> FloatArray:
    """Return a factor of the process's covariance, (L, rank); all families of a fit share it."""
    wavelength_nm = np.frombuffer(wavelengths)
    roots, directions = np.linalg.eigh(discrepancy.smooth_kernel(wavelength_nm, wavelength_nm))
    large = roots > _RANK_TOLERANCE * max(float(roots[-1]), np.finfo(float).tiny)
    return np.asarray(directions[:, large] * np.sqrt(roots[large]))
