"""Gaussian-process regression of a smooth curve over an angle, with known noise and an unknown constant mean."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve

#: Prior of the length scale: lognormal, median 35 deg, sigma 0.6. Lambertian and mirror responses vary over
#: tens of degrees; 95 % of the prior lies between 11 and 113 deg.
PRIOR_LENGTH_DEG = 35.0
PRIOR_LENGTH_LOG_SD = 0.6
#: Prior of the amplitude relative to the curve's mean: lognormal, median 0.5, sigma 1.
PRIOR_AMPLITUDE_REL = 0.5
PRIOR_AMPLITUDE_LOG_SD = 1.0
#: Added to the diagonal, relative to the squared amplitude, so that noise-free data factorise.
_JITTER = 1e-9
#: Noise below a millionth of the curve's mean counts as that: rounding, not information.
_LEAST_NOISE_REL = 1e-6
#: A smooth covariance has few eigenvalues of weight; those below this share of the largest are left out of draws.
_LEAST_EIGENVALUE = 1e-10
#: Components of an eigenvector closer than this ratio are one size: rounding leaves less, their steps more.
_EQUAL = 1 - 1e-6
_LENGTHS_DEG = np.geomspace(6.0, 200.0, 56)
_AMPLITUDES_REL = np.geomspace(0.005, 20.0, 96)


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
        distance_deg = np.abs(first_deg[:, None] - second_deg[None, :])
        return self.amplitude_rel**2 * _correlation(distance_deg / self.length_deg)


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
    """Find the length scale and amplitude of greatest posterior density.

    The likelihood has the constant mean integrated out under a flat prior; the priors are the lognormal ones above,
    as densities of the logarithms. With values whitened by their noise, K = a^2 Q diag(e) Q' + 1 for every amplitude
    a, so that one eigendecomposition serves all amplitudes of a length. The best node of a grid so fine that the
    maximum beside it is less than 0.02 nats higher. Valid for values scaled to a mean of 1.

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
    whitening = 1 / np.sqrt(np.maximum(noise_variance, _LEAST_NOISE_REL**2))
    correlation = _correlation(np.abs(angles_deg[:, None] - angles_deg) / _LENGTHS_DEG[:, None, None])
    eigenvalues, vectors = np.linalg.eigh(correlation * np.outer(whitening, whitening))
    values = np.einsum("a,laq->lq", whitening * values_rel, vectors)[:, None]
    ones = np.einsum("a,laq->lq", whitening, vectors)[:, None]
    precision = 1 / (1 + np.maximum(eigenvalues, 0)[:, None] * _AMPLITUDES_REL[None, :, None] ** 2)
    information = (precision * ones**2).sum(axis=2)
    constant = (precision * ones * values).sum(axis=2) / information
    misfit = (precision * (values - constant[..., None] * ones) ** 2).sum(axis=2)
    loss = (misfit - np.log(precision).sum(axis=2) + np.log(information)) / 2
    loss += _log_prior_loss(_LENGTHS_DEG, PRIOR_LENGTH_DEG, PRIOR_LENGTH_LOG_SD)[:, None]
    loss += _log_prior_loss(_AMPLITUDES_REL, PRIOR_AMPLITUDE_REL, PRIOR_AMPLITUDE_LOG_SD)
    length, amplitude = np.unravel_index(loss.argmin(), loss.shape)
    return Matern52(float(_LENGTHS_DEG[length]), float(_AMPLITUDES_REL[amplitude]))


def matern_correlation(
    first_deg: NDArray[np.float64], second_deg: NDArray[np.float64], length_deg: float, nu: float
) -> NDArray[np.float64]:
    """Return the Matern correlation of two sets of angles (N,), (M,) as an (N, M) array.

    With q = sqrt(2 nu) d / l: exp(-q) for nu = 1/2, (1 + q) exp(-q) for 3/2, (1 + q + q^2 / 3) exp(-q) for 5/2.

    Parameters
    ----------
    first_deg, second_deg : ndarray, shapes (N,) and (M,)
    length_deg : float
        Length scale l.
    nu : float
        Smoothness: 1/2 for curves that are continuous with kinks everywhere, 3/2 for one derivative, 5/2 for two.

    Raises
    ------
    ValueError
        For another nu.
    """
    q = np.sqrt(2 * nu) * np.abs(first_deg[:, None] - second_deg) / length_deg
    polynomials = {0.5: 1.0, 1.5: 1 + q, 2.5: 1 + q + q * q / 3}
    if nu not in polynomials:
        raise ValueError(f"smoothness nu = {nu:g} has no closed form here; must be 0.5, 1.5 or 2.5")
    return np.asarray(polynomials[nu] * np.exp(-q))


def _correlation(distance: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the Matern-5/2 correlation at distances in units of the length scale."""
    q = np.sqrt(5) * distance
    return np.asarray((1 + q + q * q / 3) * np.exp(-q))


def _log_prior_loss(values: NDArray[np.float64], median: float, log_sd: float) -> NDArray[np.float64]:
    """Return minus the logarithm of a lognormal density of the logarithm, without its constant."""
    return np.asarray((np.log(values / median) / log_sd) ** 2 / 2)


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
    root = normal_root(covariance)
    return np.asarray(rng.standard_normal((draws, root.shape[1])) @ root.T)


def normal_root(covariance: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return a root (G, E) of a covariance (G, G) that may be singular: root root' is the covariance."""
    if not len(covariance):
        return np.zeros((0, 0))
    eigenvalues, vectors = np.linalg.eigh(covariance)
    kept = eigenvalues > _LEAST_EIGENVALUE * eigenvalues.max(initial=0.0)
    return np.asarray(_upright(vectors[:, kept]) * np.sqrt(eigenvalues[kept]))


def _upright(vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return eigenvectors (G, E) with their largest component positive: their signs differ between LAPACK libraries."""
    size = np.abs(vectors)
    # odd vectors have two largest components, equal but for rounding: the first one counts
    first = (size >= _EQUAL * size.max(axis=0, initial=0.0)).argmax(axis=0)
    return np.asarray(vectors * np.sign(np.take_along_axis(vectors, first[None, :], axis=0)))


def _factorised(
    kernel: Matern52, angles_deg: NDArray[np.float64], noise_variance: NDArray[np.float64]
) -> tuple[NDArray[np.float64], bool]:
    """Return the Cholesky factor of the covariance of the observed values."""
    covariance = kernel.covariance(angles_deg, angles_deg)
    covariance[np.diag_indices_from(covariance)] += noise_variance + _JITTER * kernel.amplitude_rel**2
    factor: tuple[NDArray[np.float64], bool] = cho_factor(covariance, lower=True)
    return factor
