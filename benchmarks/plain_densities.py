"""The two log posteriors as a user of emcee or NumPyro would write them: whole arrays, no compiled code of ours.

They share the numbers that define the problem (weights, covariance, prior) with :class:`LogPosterior`, and none of its
functions.
"""

import math

import numpy as np

from finray_calib.fit import LogPosterior
from finray_calib.fit._prior import EDGE_OFFSET_FWHM, EDGE_WIDTH_FWHM
from finray_calib.spectra._emission_families import shape_tables

KAPPA_END, KAPPA_STEPS = 6.5, 1300  # linear interpolation of the shape is then exact to 2e-5


class FiveParameterDensity:
    """The paper's curve on the 401-point grid: mode, ln FWHM, ln peak, kappa, ln(reflected laser)."""

    def __init__(self, posterior: LogPosterior) -> None:
        data, prior = posterior.data, posterior.prior
        self.wavelength, self.emission = data.weights.wavelength_nm, np.array(data.weights.emission)
        self.laser, self.y = np.array(data.weights.reflected_laser), data.y.ravel()
        covariance = data.covariance + posterior.imperfections @ posterior.imperfections.T
        self.factor = np.linalg.cholesky(covariance)
        self.whiten = np.linalg.inv(self.factor)
        self.prior = prior
        ln_norm = -0.5 * self.y.size * math.log(2 * math.pi) - np.log(np.diag(self.factor)).sum()
        self.constant = float(ln_norm + prior.ln_norm)
        self.step = KAPPA_END / KAPPA_STEPS
        self.shapes = np.array(shape_tables(np.arange(KAPPA_STEPS + 1) * self.step))

    def one(self, theta: np.ndarray) -> float:
        """Return the log posterior of one (5,) theta."""
        if ((theta < self.prior.low) | (theta > self.prior.high)).any():
            return -math.inf
        mode, ln_fwhm, ln_peak, kappa, ln_laser = theta.tolist()
        at, cell = math.modf(abs(kappa) / self.step)
        near = self.shapes[:, int(cell)]
        offset, peak, width = (near + at * (self.shapes[:, int(cell) + 1] - near)).tolist()
        scale = math.exp(ln_fwhm) / width
        z = (self.wavelength - (mode - math.copysign(offset, kappa) * scale)) / scale
        curve = (np.arctan(math.sinh(kappa) * z) / math.pi + 0.5) / (1 + z * z)
        mu = self.emission @ curve * (math.exp(ln_peak) / peak) + math.exp(ln_laser) * self.laser
        residual = self.whiten @ (self.y - mu)
        pull = (theta - self.prior.mean) / self.prior.sd
        return float(self.constant - 0.5 * (residual @ residual + pull @ pull))

    def many(self, theta: np.ndarray) -> np.ndarray:
        """Return the log posterior of (n, 5) rows, (n,)."""
        allowed = ((theta >= self.prior.low) & (theta <= self.prior.high)).all(axis=1)
        mode, ln_fwhm, ln_peak, kappa, ln_laser = theta.T
        position = np.minimum(np.abs(kappa) / self.step, KAPPA_STEPS - 1)
        cell = position.astype(int)
        near = self.shapes[:, cell]
        offset, peak, width = near + (position - cell) * (self.shapes[:, cell + 1] - near)
        scale = np.exp(ln_fwhm) / width
        z = (self.wavelength - (mode - np.copysign(offset, kappa) * scale)[:, None]) / scale[:, None]
        curve = (np.arctan(np.sinh(kappa)[:, None] * z) / np.pi + 0.5) / (1 + z * z)
        mu = curve @ self.emission.T * (np.exp(ln_peak) / peak)[:, None] + np.exp(ln_laser)[:, None] * self.laser
        residual = (self.y - mu) @ self.whiten.T
        pull = (theta - self.prior.mean) / self.prior.sd
        value = self.constant - 0.5 * ((residual**2).sum(axis=1) + (pull**2).sum(axis=1))
        return np.where(allowed, value, -np.inf)


class DefaultDensity:
    """Log-normal in wavenumber with discrepancy, blocking and tolerances: batched dense covariances and Cholesky.

    On the few-node rule of the fit, which spares this side a 401 x 401 covariance for every theta.
    """

    def __init__(self, posterior: LogPosterior) -> None:
        data, rule, self.prior = posterior.data, posterior.data.quadrature, posterior.prior
        kept = data.kept
        weights, self.discrepancy = data.weights, posterior.discrepancy
        bands, nodes = rule.nodes_nm.shape
        self.nodes = rule.nodes_nm.ravel()
        own_band = np.repeat(np.arange(bands), nodes) == weights.band_index[kept, None]
        self.in_band = np.where(own_band, np.tile(rule.in_band[kept], bands), 0.0)
        self.points = np.concatenate([self.nodes, rule.grid_nm])
        self.emission = np.concatenate([self.in_band, rule.out_of_band[kept]], axis=1)
        self.leaked = np.concatenate([np.zeros_like(self.in_band), rule.leaked[kept]], axis=1)
        self.laser, self.leaked_laser = weights.reflected_laser[kept], weights.leaked_laser[kept]
        self.leaked_white, self.y, self.kept = weights.leaked_white, data.y.ravel()[kept], kept
        self.leak_sd, self.common = data.tolerances.blocking_sd, data.common_rel[:, kept]
        self.level_share = weights.level_share
        self.own_leaks = [(weights.band_index == band, at) for band, at in posterior.own_leaks.items()]
        u = posterior.imperfections
        self.covariance = data.covariance_without_tile(kept) + u @ u.T
        # bands that share no discrepancy in the fit (e^-8 of its variance) share none here
        near = posterior.problem.kernel > 0
        self.kernel = near * self.discrepancy.smooth_kernel(self.nodes, self.nodes)

    def many(self, theta: np.ndarray) -> np.ndarray:
        """Return the log posterior of (n, D) rows, (n,): six parameters, then the own leaks that are sampled."""
        allowed = ((theta >= self.prior.low) & (theta <= self.prior.high)).all(axis=1)
        mode, ln_fwhm, ln_peak, asymmetry, ln_laser, ln_blocking = theta.T[:6, :, None]
        curve = np.exp(ln_peak) * _log_normal(self.points, mode, np.exp(ln_fwhm), asymmetry)
        own_leak = np.tile(np.exp(self.leak_sd**2 / 2), (len(theta), 1))  # a log-normal's mean lies above its median
        for rows, at in self.own_leaks:
            own_leak[:, rows] = np.exp(self.leak_sd[rows] * theta[:, at, None])
        every = np.exp(ln_blocking) * own_leak - 1
        more, white = every[:, self.kept], 1 + every * self.leaked_white
        mu = curve @ self.emission.T + more * (curve @ self.leaked.T)
        mu += np.exp(ln_laser) * (self.laser + more * self.leaked_laser)
        mu /= white[:, self.kept] * (self.level_share / white).sum(axis=1, keepdims=True)
        scaled = curve[:, : self.nodes.size] + self.discrepancy.floor_rel * np.exp(ln_peak)
        response = self.in_band * scaled[:, None, :]
        fwhm = np.exp(ln_fwhm)
        edge = (self.nodes - mode + EDGE_OFFSET_FWHM * fwhm) / (EDGE_WIDTH_FWHM * fwhm)
        absorbed = self.discrepancy.reabsorption_rel / (1 + np.exp(np.minimum(edge, 60.0)))
        pulled = response @ absorbed[..., None]
        common = mu[..., None] * self.common.T
        covariance = self.covariance + response @ self.kernel @ response.swapaxes(1, 2) + pulled @ pulled.swapaxes(1, 2)
        covariance += common @ common.swapaxes(1, 2)
        factor = np.linalg.cholesky(covariance)
        residual = np.linalg.solve(factor, (self.y - mu)[..., None])[..., 0]
        half = np.log(np.diagonal(factor, axis1=1, axis2=2)).sum(axis=1)
        likelihood = -0.5 * (residual**2).sum(axis=1) - half - 0.5 * self.y.size * np.log(2 * np.pi)
        pull = ((theta - self.prior.mean) / self.prior.sd) ** 2
        return np.where(allowed, likelihood + self.prior.ln_norm - 0.5 * pull.sum(axis=1), -np.inf)


def _log_normal(wavelength: np.ndarray, mode: np.ndarray, fwhm: np.ndarray, asymmetry: np.ndarray) -> np.ndarray:
    """Return the unit curve that is log-normal in wavenumber."""
    centre, ratio = 1e4 / mode, np.exp(asymmetry)
    a = fwhm * ratio / (1 + ratio) ** 2
    b = 1e4 - fwhm * centre * (1 - ratio) / (1 + ratio)
    width = 2 * fwhm * centre**2 / (b + np.sqrt(b**2 + 4 * a * fwhm * centre**2))
    argument = 1 - (1e4 / wavelength - centre) / width * 2 * np.sinh(asymmetry)
    inside = argument > 0
    g = np.log(np.where(inside, argument, 1.0)) / asymmetry
    return np.where(inside, np.exp(-np.log(2) * g**2), 0.0)
