"""How the real curve may differ from the simulated one: a Gaussian process over the angle, learnt from captures."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from finray_calib.decide.capture_errors import CaptureErrors
from finray_calib.decide.gaussian_process import PRIOR_LENGTH_DEG, Matern52, draw_normal

Floats = NDArray[np.float64]

#: Prior of the relative sim-to-real error of the objective's shape: lognormal, median 10 %, 95 % between 2.5 % and
#: 39 %. Shading models fitted to real sensors leave 20 to 33 % of the contact's signal unexplained, 3 to 4 % of full
#: scale, which is about a tenth of a pad's level.
PRIOR_ERROR_REL = 0.1
PRIOR_ERROR_LOG_SD = 0.7
_NODES_REL = np.geomspace(0.004, 2.0, 41)


@dataclass(frozen=True, slots=True)
class _Node:
    """Hold what one amplitude of delta says: its log weight, and the linear maps from log errors to t = s + delta.

    `gain` (G, N) gives the mean of delta, `scale_gain` (N,) that of s; `scale_covariance` (G,) is that of delta and s.
    """

    amplitude_rel: float
    ln_weight: float
    gain: Floats
    scale_gain: Floats
    scale_covariance: Floats
    ln_scale_variance: float


@dataclass(frozen=True, slots=True)
class Discrepancy:
    """Hold the posterior of t = s + delta, where captured curve = simulated curve * exp(-t).

    delta is a zero-mean Gaussian process (Matern-5/2, 35 deg) whose amplitude has a lognormal prior and is integrated
    over; s is the common scale of the captures: unknown (flat prior) where absolute ratios are compared, else zero.

    Attributes
    ----------
    grid_deg : ndarray, shape (G,)
    mean : ndarray, shape (G,)
        Of t; where captures have several unknown scales, with that of the first.
    covariance : ndarray, shape (G, G)
        Of t.
    amplitude_quantiles_rel : tuple of float
        2.5 %, 50 % and 97.5 % quantiles of the amplitude of delta.
    noise : ndarray, shape (N, N)
        Covariance of the log errors at the captures, with what the uncertainty of the angles adds.
    """

    grid_deg: Floats
    mean: Floats
    covariance: Floats
    amplitude_quantiles_rel: tuple[float, float, float]
    noise: Floats
    _errors: CaptureErrors
    _nodes: tuple[_Node, ...]

    @property
    def shape_mean(self) -> Floats:
        """Mean of t less its mean over the grid, shape (G,)."""
        return np.asarray(self.mean - self.mean.mean())

    @property
    def shape_sd(self) -> Floats:
        """Standard deviation of t less its mean over the grid, shape (G,)."""
        response = self.shape_response
        return np.asarray(np.sqrt(np.maximum(np.diag(response) - response.mean(axis=1), 0)))

    @property
    def shape_response(self) -> Floats:
        """Covariance (G, G) of t less its mean over the grid, by row, with t itself, by column."""
        return np.asarray(self.covariance - self.covariance.mean(axis=0))

    def shape_draws(self, draws: int, rng: np.random.Generator) -> Floats:
        """Return joint draws (draws, G) of t less its mean over the grid: a common scale cannot change the ranking.

        A draw of the prior is corrected by what captures say beyond it (Matheron's rule), which is exact for every
        amplitude; amplitudes are drawn by their weights.
        """
        size = self.grid_deg.size
        angles = np.concatenate([self.grid_deg, self._errors.angles_deg])
        unit = draw_normal(Matern52(PRIOR_LENGTH_DEG, 1.0).covariance(angles, angles), draws, rng)
        measured = self._errors.log_error - draw_normal(self.noise, draws, rng)
        which = rng.choice(len(self._nodes), size=draws, p=_weights(self._nodes))
        curves = np.empty((draws, size))
        for number, node in enumerate(self._nodes):
            rows = which == number
            prior = node.amplitude_rel * unit[rows]
            curves[rows] = prior[:, :size] + (measured[rows] - prior[:, size:]) @ node.gain.T
        return np.asarray(curves - curves.mean(axis=1, keepdims=True))


def discrepancy_posterior(errors: CaptureErrors, log_slope_per_deg: Floats, grid_deg: Floats) -> Discrepancy:
    """Return what captures say about the sim-to-real error at every angle; without captures, the prior.

    With the log errors e at the captures, K = a^2 R the covariance of delta, N that of the errors, S = K_cc + N and H
    the indicator of the unknown scales, W = S^-1 - S^-1 H (H' S^-1 H)^-1 H' S^-1:

    delta | e, a ~ N(K_gc W e, K_gg - K_gc W K_cg),
    p(e | a) ~ |S|^-1/2 |H' S^-1 H|^-1/2 exp(-e' W e / 2).

    N holds the covariance of the reports and, on its diagonal, (slope * angle uncertainty)^2: the capture was taken at
    an angle that is known so well only.

    Parameters
    ----------
    errors : CaptureErrors
    log_slope_per_deg : ndarray, shape (N,)
        Derivative of the logarithm of the simulated curve at the captures.
    grid_deg : ndarray, shape (G,)

    Returns
    -------
    Discrepancy

    References
    ----------
    M. C. Kennedy, A. O'Hagan, Bayesian calibration of computer models, J. R. Statist. Soc. B 63 (2001), 425-464.
    """
    noise = errors.covariance + np.diag((log_slope_per_deg * errors.angle_sd_deg) ** 2)
    kernel = Matern52(PRIOR_LENGTH_DEG, 1.0)
    across = kernel.covariance(grid_deg, errors.angles_deg)
    among = kernel.covariance(errors.angles_deg, errors.angles_deg)
    scales = _scale_indicator(errors)
    nodes = tuple(_node(a, across, among, noise, scales, errors.log_error) for a in _NODES_REL.tolist())
    mean, covariance = _mixture(nodes, errors.log_error, across, kernel.covariance(grid_deg, grid_deg))
    return Discrepancy(grid_deg, mean, covariance, _quantiles(nodes), noise, errors, nodes)


def _node(
    amplitude_rel: float, across: Floats, among: Floats, noise: Floats, scales: Floats, log_error: Floats
) -> _Node:
    """Return the posterior for one amplitude; `across` (G, N) and `among` (N, N) are correlations of delta."""
    whole = amplitude_rel**2 * among + noise
    precision = np.linalg.inv(whole)
    cross = amplitude_rel**2 * across
    ln_weight = -0.5 * (np.log(amplitude_rel / PRIOR_ERROR_REL) / PRIOR_ERROR_LOG_SD) ** 2
    ln_weight -= 0.5 * np.linalg.slogdet(whole)[1]
    scale_gain, scale_covariance, ln_scale_variance = np.zeros(len(log_error)), np.zeros(len(across)), 0.0
    if scales.shape[1]:
        information = scales.T @ precision @ scales
        spread = np.linalg.inv(information)
        estimators = spread @ scales.T @ precision
        ln_weight -= 0.5 * np.linalg.slogdet(information)[1]
        scale_gain, ln_scale_variance = estimators[0], float(spread[0, 0])
        scale_covariance = -cross @ estimators[0]
        precision = precision - precision @ scales @ estimators
    ln_weight -= 0.5 * log_error @ precision @ log_error
    return _Node(amplitude_rel, float(ln_weight), cross @ precision, scale_gain, scale_covariance, ln_scale_variance)


def _weights(nodes: tuple[_Node, ...]) -> Floats:
    """Return the posterior weights of the amplitudes."""
    ln_weights = np.array([node.ln_weight for node in nodes])
    weights = np.exp(ln_weights - ln_weights.max())
    return np.asarray(weights / weights.sum())


def _mixture(nodes: tuple[_Node, ...], log_error: Floats, across: Floats, everywhere: Floats) -> tuple[Floats, Floats]:
    """Return mean (G,) and covariance (G, G) of t = s + delta over all amplitudes."""
    weights = _weights(nodes)
    variances = weights * np.square([node.amplitude_rel for node in nodes])
    gain = np.tensordot(variances, np.stack([node.gain for node in nodes]), axes=1)
    with_scale = weights @ np.stack([node.scale_covariance for node in nodes])
    ln_scale_variance = weights @ np.array([node.ln_scale_variance for node in nodes])
    centers = np.stack([(node.gain + node.scale_gain) @ log_error for node in nodes])
    mean = weights @ centers
    covariance = variances.sum() * everywhere - gain @ across.T
    covariance += with_scale[:, None] + with_scale + ln_scale_variance
    covariance += (centers.T * weights) @ centers - np.outer(mean, mean)
    return np.asarray(mean), covariance


def _quantiles(nodes: tuple[_Node, ...]) -> tuple[float, float, float]:
    """Return the 2.5 %, 50 % and 97.5 % quantiles of the amplitude, linear in its logarithm between the nodes."""
    weights = _weights(nodes)
    log_amplitudes = np.log([node.amplitude_rel for node in nodes])
    low, median, high = np.exp(np.interp([0.025, 0.5, 0.975], weights.cumsum() - weights / 2, log_amplitudes))
    return float(low), float(median), float(high)


def _scale_indicator(errors: CaptureErrors) -> Floats:
    """Return (N, scales): 1 where a capture has that unknown scale; no column where none is unknown."""
    if errors.scale_of is None:
        return np.zeros((errors.angles_deg.size, 0))
    return np.equal.outer(errors.scale_of, np.unique(errors.scale_of)).astype(np.float64)
