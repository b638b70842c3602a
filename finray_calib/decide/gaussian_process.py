"""Gaussian-process regression of a smooth curve over an angle, with known noise and an unknown constant mean."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve
from scipy.optimize import minimize

#: Prior of the length scale: lognormal, median 35 deg, sigma 0.6. Lambertian and mirror responses vary over
#: tens of degrees; 95 % of the prior lies between 11 and 113 deg.
PRIOR_LENGTH_DEG = 35.0
PRIOR_LENGTH_LOG_SD = 0.6
#: Prior of the amplitude relative to the curve's mean: lognormal, median 0.5, sigma 1.
PRIOR_AMPLITUDE_REL = 0.5
PRIOR_AMPLITUDE_LOG_SD = 1.0
#: Added to the diagonal, relative to the squared amplitude, so that noise-free data factorise.
_JITTER = 1e-9


@dataclass(frozen=True, slots=True)
class Matern52:
    """Hold a Matern covariance of smoothness 5/2.

    k(d) = a^2 (1 + q + q^2 / 3) exp(-q) with q = sqrt(5) d / l: curves that are twice differentiable.

    Attributes
    ----------
    length_deg : float
        Length scale l.
    amplitude_rel : float
        Standard deviation a, in the unit of the values.
    """

    length_deg: float
    amplitude_rel: float

    def covariance(self, first_deg: NDArray[np.float64], second_deg: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the covariance of two sets of angles (N,), (M,) as an (N, M) array."""
        q = np.sqrt(5) * np.abs(first_deg[:, None] - second_deg[None, :]) / self.length_deg
        return np.asarray(self.amplitude_rel**2 * (1 + q + q * q / 3) * np.exp(-q))


@dataclass(frozen=True, slots=True)
class CurvePosterior:
    """Hold the joint normal distribution of a curve: `mean` (G,) and `covariance` (G, G) on `grid_deg` (G,)."""

    grid_deg: NDArray[np.float64]
    mean: NDArray[np.float64]
    covariance: NDArray[np.float64]

    @property
    def standard_deviation(self) -> NDArray[np.float64]:
        """Pointwise standard deviation, shape (G,)."""
        return np.asarray(np.sqrt(np.maximum(np.diag(self.covariance), 0)))


def fit_kernel(
    angles_deg: NDArray[np.float64], values_rel: NDArray[np.float64], noise_variance: NDArray[np.float64]
) -> Matern52:
    """Find the length scale and amplitude of greatest penalised marginal likelihood.

    The likelihood is that of the generalised-least-squares residuals of a constant mean; the penalties are the
    lognormal priors above. Valid for values scaled to a mean of 1.

    Parameters
    ----------
    angles_deg, values_rel, noise_variance : ndarray, shape (A,)
        Angles, observed values, and the variance of each value.

    Returns
    -------
    Matern52

    References
    ----------
    C. E. Rasmussen, C. K. I. Williams, Gaussian Processes for Machine Learning (2006), sections 2.7 and 5.4.
    """
    ones = np.ones_like(values_rel)
    center = np.log([PRIOR_LENGTH_DEG, PRIOR_AMPLITUDE_REL])
    width = np.array([PRIOR_LENGTH_LOG_SD, PRIOR_AMPLITUDE_LOG_SD])

    def penalised_loss(log_parameters: NDArray[np.float64]) -> float:
        factor = _factorised(_kernel(log_parameters), angles_deg, noise_variance)
        weights = cho_solve(factor, ones)
        residual = values_rel - (weights @ values_rel) / weights.sum()
        log_determinant = 2 * np.log(np.diag(factor[0])).sum()
        penalty = (((log_parameters - center) / width) ** 2).sum()
        return float(residual @ cho_solve(factor, residual) + log_determinant + penalty) / 2

    # A hundredth of a log unit is far finer than the data determine length and amplitude.
    found = minimize(penalised_loss, center, method="Nelder-Mead", options={"xatol": 0.01, "fatol": 0.01})
    return _kernel(np.asarray(found.x))


def condition(
    kernel: Matern52,
    angles_deg: NDArray[np.float64],
    values_rel: NDArray[np.float64],
    noise_variance: NDArray[np.float64],
    grid_deg: NDArray[np.float64],
) -> CurvePosterior:
    """Return the curve on a grid given noisy values, with the constant mean integrated out under a flat prior.

    With K = k(x, x) + diag(noise), r = 1 - k(g, x) K^-1 1 and m = 1' K^-1 y / 1' K^-1 1, the mean is
    m + k(g, x) K^-1 (y - m) and the covariance k(g, g) - k(g, x) K^-1 k(x, g) + r r' / 1' K^-1 1.

    Parameters
    ----------
    kernel : Matern52
    angles_deg, values_rel, noise_variance : ndarray, shape (A,)
    grid_deg : ndarray, shape (G,)

    Returns
    -------
    CurvePosterior

    References
    ----------
    C. E. Rasmussen, C. K. I. Williams, Gaussian Processes for Machine Learning (2006), section 2.7.
    """
    factor = _factorised(kernel, angles_deg, noise_variance)
    weights = cho_solve(factor, np.ones_like(values_rel))
    constant = (weights @ values_rel) / weights.sum()
    cross = kernel.covariance(grid_deg, angles_deg)
    remainder = 1 - cross @ weights
    return CurvePosterior(
        grid_deg,
        constant + cross @ cho_solve(factor, values_rel - constant),
        kernel.covariance(grid_deg, grid_deg)
        - cross @ cho_solve(factor, cross.T)
        + np.outer(remainder, remainder) / weights.sum(),
    )


def draw_normal(covariance: NDArray[np.float64], draws: int, rng: np.random.Generator) -> NDArray[np.float64]:
    """Return zero-mean normal draws of shape (draws, G) with a covariance (G, G) that may be singular."""
    eigenvalues, vectors = np.linalg.eigh(covariance)
    # Rounding leaves eigenvalues of a smooth covariance slightly below zero.
    scale = np.sqrt(np.maximum(eigenvalues, 0))
    return np.asarray((rng.standard_normal((draws, len(scale))) * scale) @ vectors.T)


def _kernel(log_parameters: NDArray[np.float64]) -> Matern52:
    """Return the kernel with these logarithms of length and amplitude."""
    length_deg, amplitude_rel = np.exp(log_parameters)
    return Matern52(float(length_deg), float(amplitude_rel))


def _factorised(
    kernel: Matern52, angles_deg: NDArray[np.float64], noise_variance: NDArray[np.float64]
) -> tuple[NDArray[np.float64], bool]:
    """Return the Cholesky factor of the covariance of the observed values."""
    covariance = kernel.covariance(angles_deg, angles_deg)
    covariance[np.diag_indices_from(covariance)] += noise_variance + _JITTER * kernel.amplitude_rel**2
    factor: tuple[NDArray[np.float64], bool] = cho_factor(covariance, lower=True)
    return factor
