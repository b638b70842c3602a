"""Gaussian processes over the light angle: the simulated curve between its angles, and how the real one may differ.

Regression of a smooth curve with known noise and an unknown constant mean; and the sim-to-real error of a curve, learnt
from captures.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve

from finray_calib.decide._capture_errors import CaptureErrors

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


Floats = NDArray[np.float64]

#: Prior of the relative sim-to-real error of the objective's shape: lognormal, median 10 %, 95 % between 2.5 % and
#: 39 %. Shading models fitted to real sensors leave 20 to 33 % of the contact's signal unexplained, 3 to 4 % of full
#: scale, which is about a tenth of a pad's level.
PRIOR_ERROR_REL = 0.1
PRIOR_ERROR_LOG_SD = 0.7
#: Prior of its length: lognormal, median 25 deg, sigma 0.8. No capture set varies the light's angle, so that edges of
#: shadows (some degrees) and a lobe that leans (the whole sweep) are both possible.
PRIOR_ERROR_LENGTH_DEG = 25.0
PRIOR_ERROR_LENGTH_LOG_SD = 0.8
_NODES_REL = np.geomspace(0.004, 2.0, 21)
_ERROR_LENGTHS_DEG = np.geomspace(8.0, 150.0, 12)
#: Equally likely. With twice differentiable errors alone a 95 % bound holds for half of the curves with a kink.
_SMOOTHNESSES = (0.5, 1.5, 2.5)


@dataclass(frozen=True, slots=True)
class _Kernel:
    """Hold one smoothness (Matern nu) and length of delta, and the logarithm of its prior weight."""

    nu: float
    length_deg: float
    ln_weight: float

    def correlation(self, first_deg: Floats, second_deg: Floats) -> Floats:
        """Return the correlation of delta between two sets of angles (N,), (M,) as an (N, M) array."""
        return matern_correlation(first_deg, second_deg, self.length_deg, self.nu)


@dataclass(frozen=True, slots=True)
class _Part:
    """Hold what one kernel says with each of A amplitudes: log weights, and linear maps from log errors to t.

    `gain` (A, G, N) gives the mean of delta, `scale_gain` (A, N) that of s; `scale_covariance` (A, G) is that of delta
    and s, `ln_scale_variance` (A,) that of s.
    """

    kernel: _Kernel
    ln_weight: Floats
    gain: Floats
    scale_gain: Floats
    scale_covariance: Floats
    ln_scale_variance: Floats


@dataclass(frozen=True, slots=True)
class Discrepancy:
    """Hold the posterior of t = s + delta, where captured curve = simulated curve * exp(-t).

    delta is a zero-mean Gaussian process whose smoothness (Matern 1/2, 3/2, 5/2), length and amplitude have priors and
    are summed over; s is the common scale of the captures: unknown (flat prior) where absolute ratios are compared,
    else zero.

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
    _parts: tuple[_Part, ...]

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
        kernel and amplitude; these are drawn by their weights.
        """
        size = self.grid_deg.size
        angles = np.concatenate([self.grid_deg, self._errors.angles_deg])
        measured = self._errors.log_error - draw_normal(self.noise, draws, rng)
        weights = _weights(self._parts)
        kernel_of, amplitude_of = np.divmod(rng.choice(weights.size, size=draws, p=weights.ravel()), weights.shape[1])
        normals = rng.standard_normal((draws, angles.size))
        curves = np.empty((draws, size))
        for number, part in enumerate(self._parts):
            rows = np.flatnonzero(kernel_of == number)
            root, amplitude = _root(part.kernel, angles.tobytes()), amplitude_of[rows]
            prior = _NODES_REL[amplitude, None] * (normals[rows, : root.shape[1]] @ root.T)
            curves[rows] = prior[:, :size]
            for node in np.unique(amplitude):
                own = amplitude == node
                curves[rows[own]] += (measured[rows[own]] - prior[own, size:]) @ part.gain[node].T
        return np.asarray(curves - curves.mean(axis=1, keepdims=True))


def discrepancy_posterior(errors: CaptureErrors, log_slope_per_deg: Floats, grid_deg: Floats) -> Discrepancy:
    """Return what captures say about the sim-to-real error at every angle; without captures, the prior.

    With the log errors e at the captures, K = a^2 R(nu, l) the covariance of delta, N that of the errors, S = K_cc + N
    and H the indicator of the unknown scales, W = S^-1 - S^-1 H (H' S^-1 H)^-1 H' S^-1:

    delta | e, a, l, nu ~ N(K_gc W e, K_gg - K_gc W K_cg),
    p(e | a, l, nu) ~ |S|^-1/2 |H' S^-1 H|^-1/2 exp(-e' W e / 2),

    summed over 21 amplitudes a, 12 lengths l and three smoothnesses nu with their priors.

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
    scales = _scale_indicator(errors)
    parts = tuple(_part(kernel, errors, noise, scales, grid_deg) for kernel in _kernels())
    mean, covariance = _mixture(parts, errors, grid_deg)
    return Discrepancy(grid_deg, mean, covariance, _quantiles(parts), noise, errors, parts)


def _kernels() -> tuple[_Kernel, ...]:
    """Return every smoothness and length with its prior."""
    return tuple(
        _Kernel(nu, length, -0.5 * (np.log(length / PRIOR_ERROR_LENGTH_DEG) / PRIOR_ERROR_LENGTH_LOG_SD) ** 2)
        for nu in _SMOOTHNESSES
        for length in _ERROR_LENGTHS_DEG.tolist()
    )


@lru_cache(maxsize=64)
def _root(kernel: _Kernel, angles_deg: bytes) -> Floats:
    """Return a root (A, E) of the correlation of delta at angles, given as the bytes of a float array."""
    angles = np.frombuffer(angles_deg)
    return normal_root(kernel.correlation(angles, angles))


def _part(kernel: _Kernel, errors: CaptureErrors, noise: Floats, scales: Floats, grid_deg: Floats) -> _Part:
    """Return the posterior for one kernel and all amplitudes; `scales` (N, M) tells which capture has which scale."""
    variance = _NODES_REL[:, None, None] ** 2
    whole = variance * kernel.correlation(errors.angles_deg, errors.angles_deg) + noise
    cross = variance * kernel.correlation(grid_deg, errors.angles_deg)
    precision = np.linalg.inv(whole)
    ln_weight = kernel.ln_weight - 0.5 * (np.log(_NODES_REL / PRIOR_ERROR_REL) / PRIOR_ERROR_LOG_SD) ** 2
    ln_weight -= 0.5 * np.linalg.slogdet(whole)[1]
    scale_gain: Floats = np.zeros((len(whole), len(scales)))
    scale_covariance: Floats = np.zeros((len(whole), grid_deg.size))
    ln_scale_variance: Floats = np.zeros(len(whole))
    if scales.shape[1]:
        information = scales.T @ precision @ scales
        spread = np.linalg.inv(information)
        estimators = spread @ scales.T @ precision
        ln_weight -= 0.5 * np.linalg.slogdet(information)[1]
        scale_gain, ln_scale_variance = estimators[:, 0], np.asarray(spread[:, 0, 0])
        scale_covariance = -(cross @ estimators[:, 0, :, None])[..., 0]
        precision = precision - precision @ scales @ estimators
    ln_weight -= 0.5 * (precision @ errors.log_error) @ errors.log_error
    return _Part(kernel, ln_weight, cross @ precision, scale_gain, scale_covariance, ln_scale_variance)


def _weights(parts: Sequence[_Part]) -> Floats:
    """Return the posterior weights of kernels and amplitudes, (K, A)."""
    ln_weights = np.array([part.ln_weight for part in parts])
    weights = np.exp(ln_weights - ln_weights.max())
    return np.asarray(weights / weights.sum())


def _mixture(parts: Sequence[_Part], errors: CaptureErrors, grid_deg: Floats) -> tuple[Floats, Floats]:
    """Return mean (G,) and covariance (G, G) of t = s + delta over all kernels and amplitudes."""
    mean, covariance = np.zeros(grid_deg.size), np.zeros((grid_deg.size, grid_deg.size))
    for part, weights in zip(parts, _weights(parts), strict=True):
        variances = weights * _NODES_REL**2
        covariance += variances.sum() * part.kernel.correlation(grid_deg, grid_deg)
        covariance -= (
            np.tensordot(variances, part.gain, axes=1) @ part.kernel.correlation(grid_deg, errors.angles_deg).T
        )
        with_scale = weights @ part.scale_covariance
        covariance += with_scale[:, None] + with_scale + weights @ part.ln_scale_variance
        centers = (part.gain + part.scale_gain[:, None]) @ errors.log_error
        covariance += (centers.T * weights) @ centers
        mean += weights @ centers
    return mean, covariance - np.outer(mean, mean)


def _quantiles(parts: Sequence[_Part]) -> tuple[float, float, float]:
    """Return the 2.5 %, 50 % and 97.5 % quantiles of the amplitude, linear in its logarithm between the nodes."""
    weights, log_amplitudes = _weights(parts).sum(axis=0), np.log(_NODES_REL)
    low, median, high = np.exp(np.interp([0.025, 0.5, 0.975], weights.cumsum() - weights / 2, log_amplitudes))
    return float(low), float(median), float(high)


def _scale_indicator(errors: CaptureErrors) -> Floats:
    """Return (N, scales): 1 where a capture has that unknown scale; no column where none is unknown."""
    if errors.scale_of is None:
        return np.zeros((errors.angles_deg.size, 0))
    return np.equal.outer(errors.scale_of, np.unique(errors.scale_of)).astype(np.float64)
