"""Random curves over the light angle: Gaussian processes whose smoothness, length and amplitude are summed over.

One or more such curves, one for each place that is touched, seen at some angles with noise and with unknown common
scales: expected value, covariance and joint draws. Thirteen angles say little about smoothness and length, so that a
choice of either would claim more than is known: both have a prior, and the sum over it is exact on a grid. Where one
more observation helps most is told by the knowledge gradient, exact for normal beliefs.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm

Floats = NDArray[np.float64]

#: A smooth covariance has few eigenvalues of weight; those below this share of the largest are left out of draws.
_LEAST_EIGENVALUE = 1e-10
#: Components of an eigenvector closer than this ratio are one size: rounding leaves less, their steps more.
_EQUAL = 1 - 1e-6
#: Added to the diagonal, relative to the squared amplitude, so that noise-free data factorise.
_JITTER = 1e-9
#: Equally likely. With twice differentiable curves alone a 95 % bound holds for half of the curves with a kink.
SMOOTHNESSES = (0.5, 1.5, 2.5)
LENGTHS_DEG = np.geomspace(8.0, 150.0, 12)
#: Share of the variance that curves at several places have in common. Nobody measured it, so that it is summed over.
SHARED = (0.1, 0.3, 0.5, 0.7, 0.9)


@dataclass(frozen=True, slots=True)
class CurvePrior:
    """Hold the prior of random curves: lognormal lengths and amplitudes, each smoothness as likely as the others.

    Attributes
    ----------
    length_deg, length_ln_sd : float
        Median of the correlation length, and standard deviation of its logarithm.
    amplitude_rel, amplitude_ln_sd : float
        The same of the standard deviation of the curve.
    amplitudes_rel : ndarray, shape (A,)
        Amplitudes that are summed over.
    smoothnesses : tuple of float
        Matern's nu.
    lengths_deg : ndarray, shape (L,)
    """

    length_deg: float
    length_ln_sd: float
    amplitude_rel: float
    amplitude_ln_sd: float
    amplitudes_rel: Floats
    smoothnesses: tuple[float, ...] = SMOOTHNESSES
    lengths_deg: Floats = field(default_factory=LENGTHS_DEG.copy)


@dataclass(frozen=True, slots=True)
class Observations:
    """Hold values of random curves at some angles.

    Attributes
    ----------
    angles_deg, values : ndarray, shape (N,)
    noise : ndarray, shape (N, N)
        Covariance of the values about the curves.
    scales : ndarray, shape (N, M)
        1 where a value carries an unknown constant (flat prior), which is then part of it.
    contact : ndarray of int, shape (N,)
        Number of the curve that a value is of.
    """

    angles_deg: Floats
    values: Floats
    noise: Floats
    scales: Floats
    contact: NDArray[np.int64]


def observations(angles_deg: Floats, values: Floats, noise: Floats, scales: Floats) -> Observations:
    """Return values of one curve."""
    return Observations(angles_deg, values, noise, scales, np.zeros(angles_deg.size, dtype=np.int64))


@dataclass(frozen=True, slots=True)
class _Part:
    """Hold what one smoothness, length and common share say with each of A amplitudes.

    `solve` (A, N, N) maps values to K^-1 (value - constants), `scale_gain` (A, N) to the first constant, whose variance
    is `scale_variance` (A,).
    """

    nu: float
    length_deg: float
    common_share: float
    ln_weight: Floats
    solve: Floats
    scale_gain: Floats
    scale_variance: Floats

    def correlation(self, first_deg: Floats, second_deg: Floats, is_same: NDArray[np.bool_] | bool) -> Floats:
        """Return the correlation of curves between two sets of angles (N,), (M,); between places it is less."""
        share = np.where(is_same, 1.0, self.common_share)
        return np.asarray(share * matern_correlation(first_deg, second_deg, self.length_deg, self.nu))


@dataclass(frozen=True, eq=False)
class CurvePosterior:
    """Hold what observations say about one or more random curves; without any, the prior.

    Attributes
    ----------
    grid_deg : ndarray, shape (G,)
    contacts : int
        Number of curves C.
    seen : Observations
    parts : tuple
        What each smoothness, length and common share says.
    """

    grid_deg: Floats
    contacts: int
    seen: Observations
    _prior: CurvePrior
    parts: tuple[_Part, ...]

    @property
    def weights(self) -> Floats:
        """Posterior weights (parts, A) of smoothness, length and common share, and of the amplitude."""
        return _normalised(np.array([part.ln_weight for part in self.parts]))

    @property
    def amplitude_weights(self) -> Floats:
        """Posterior weights (A,) of the amplitudes."""
        return np.asarray(self.weights.sum(axis=0))

    @cached_property
    def mean(self) -> Floats:
        """Expected curves with their first constant, shape (C, G)."""
        mean = np.zeros((self.contacts, self.grid_deg.size))
        for part, weights in zip(self.parts, self.weights, strict=True):
            solved = (weights * self._prior.amplitudes_rel**2) @ (part.solve @ self.seen.values)
            mean += np.array([self._cross(part, contact) @ solved for contact in range(self.contacts)])
            mean += weights @ (part.scale_gain @ self.seen.values)
        return mean

    @cached_property
    def covariance(self) -> Floats:
        """Covariance (G, G) of the first curve with its constant."""
        return self.second_moment(self.weights) - np.outer(self.mean[0], self.mean[0])

    def second_moment(self, of_parts: Floats) -> Floats:
        """Return the expected square (G, G) of the first curve, with weights (parts, A) that need not be its own."""
        grid, square = self.grid_deg, self._prior.amplitudes_rel**2
        found = np.zeros((grid.size, grid.size))
        for part, weights in zip(self.parts, of_parts, strict=True):
            cross, variances = self._cross(part, 0), weights * square
            found += variances.sum() * part.correlation(grid, grid, True)
            found -= cross @ np.tensordot(variances * square, part.solve, axes=1) @ cross.T
            with_scale = cross @ (variances @ part.scale_gain)
            found += weights @ part.scale_variance - with_scale[:, None] - with_scale
            solved = square[:, None] * (part.solve @ self.seen.values)
            centers = solved @ cross.T + (part.scale_gain @ self.seen.values)[:, None]
            found += (centers.T * weights) @ centers
        return found

    def response(self, number: int) -> Floats:
        """Return what each value adds to the expected first curve in one part, (A, G, N)."""
        part = self.parts[number]
        gain = self._cross(part, 0) @ part.solve
        return np.asarray(self._prior.amplitudes_rel[:, None, None] ** 2 * gain + part.scale_gain[:, None, :])

    def ln_likelihood(self, values: Floats) -> Floats:
        """Return ln(prior weight times likelihood) of other values at the same angles: (parts, A, m) for (m, N)."""
        own = self.seen.values
        found = []
        for part in self.parts:
            misfit = ((values @ part.solve) * values).sum(axis=2) - ((part.solve @ own) @ own)[:, None]
            found.append(part.ln_weight[:, None] - 0.5 * misfit)
        return np.array(found)

    def draws(
        self,
        count: int,
        rng: np.random.Generator,
        values: Floats | None = None,
        nodes: NDArray[np.int64] | None = None,
    ) -> Floats:
        """Return joint draws (count, C, G) of the curves with their first constant.

        A draw of the prior is corrected by what the observations say beyond it (Matheron's rule), which is exact for
        every smoothness, length and amplitude; these are drawn by their weights.

        Parameters
        ----------
        count : int
        rng : numpy.random.Generator
        values : ndarray, shape (count, N), optional
            Other values than those observed, for each draw its own.
        nodes : ndarray of int, shape (count,), optional
            Index into the flattened weights for each draw, where they are not to be drawn.
        """
        seen, amplitudes = self.seen, self._prior.amplitudes_rel
        size, weights = self.grid_deg.size, self.weights
        angles = np.concatenate([self.grid_deg, seen.angles_deg])
        own = np.broadcast_to(seen.values, (count, seen.values.size)) if values is None else values
        measured = own - draw_normal(seen.noise, count, rng)
        picked = rng.choice(weights.size, size=count, p=weights.ravel()) if nodes is None else nodes
        part_of, amplitude_of = np.divmod(picked, weights.shape[1])
        # curves at several places: one that they share, and one of each
        normals = rng.standard_normal((count, 1 if self.contacts == 1 else self.contacts + 1, angles.size))
        curves = np.empty((count, self.contacts, size))
        for number, part in enumerate(self.parts):
            rows = np.flatnonzero(part_of == number)
            if not rows.size:
                continue
            root, amplitude = _root(part.nu, part.length_deg, angles.tobytes()), amplitude_of[rows]
            prior = amplitudes[amplitude, None, None] * (normals[rows][..., : root.shape[1]] @ root.T)
            if self.contacts > 1:
                prior = np.sqrt(part.common_share) * prior[:, :1] + np.sqrt(1 - part.common_share) * prior[:, 1:]
            misfit = measured[rows] - prior[:, seen.contact, size + np.arange(seen.contact.size)]
            curves[rows] = prior[..., :size] + self._correction(part, amplitude, misfit)
        return curves

    def _correction(self, part: _Part, amplitude_of: NDArray[np.int64], misfit: Floats) -> Floats:
        """Return what observations (n, N) beyond a draw of the prior add to its curves, (n, C, G)."""
        solved = np.empty_like(misfit)
        constant = np.zeros(len(misfit))
        for node in np.unique(amplitude_of):
            own = amplitude_of == node
            solved[own] = self._prior.amplitudes_rel[node] ** 2 * misfit[own] @ part.solve[node].T
            constant[own] = misfit[own] @ part.scale_gain[node]
        found = np.stack([solved @ self._cross(part, contact).T for contact in range(self.contacts)], axis=1)
        return np.asarray(found + constant[:, None, None])

    def _cross(self, part: _Part, contact: int) -> Floats:
        """Return the correlation (G, N) of one curve with the values."""
        return part.correlation(self.grid_deg, self.seen.angles_deg, self.seen.contact == contact)


def curve_posterior(prior: CurvePrior, seen: Observations, grid_deg: Floats, contacts: int = 1) -> CurvePosterior:
    """Return what observations say about random curves.

    With K = a^2 R(nu, l) the covariance of the curves at the observations (times the common share between two places),
    N that of their noise, S = K + N, and H the indicator of the unknown constants,

    W = S^-1 - S^-1 H (H' S^-1 H)^-1 H' S^-1,
    curve | y, a, l, nu ~ N(K_g W y, K_gg - K_g W K_g'),
    p(y | a, l, nu) ~ |S|^-1/2 |H' S^-1 H|^-1/2 exp(-y' W y / 2),

    summed over amplitudes a, lengths l, smoothnesses nu and common shares with their priors.

    Parameters
    ----------
    prior : CurvePrior
    seen : Observations
    grid_deg : ndarray, shape (G,)
    contacts : int
        Number of curves; with one, nothing is shared.

    Returns
    -------
    CurvePosterior

    References
    ----------
    C. E. Rasmussen, C. K. I. Williams, Gaussian Processes for Machine Learning (2006), section 2.7.
    """
    shares = (1.0,) if contacts == 1 else SHARED
    lengths = -0.5 * (np.log(prior.lengths_deg / prior.length_deg) / prior.length_ln_sd) ** 2
    parts = tuple(
        _part(prior, seen, nu, (float(length), float(ln_weight)), common_share)
        for nu in prior.smoothnesses
        for length, ln_weight in zip(prior.lengths_deg, lengths, strict=True)
        for common_share in shares
    )
    return CurvePosterior(grid_deg, contacts, seen, prior, parts)


def _part(prior: CurvePrior, seen: Observations, nu: float, length: tuple[float, float], common_share: float) -> _Part:
    """Return the posterior for one smoothness, length (with its log weight) and common share, and all amplitudes."""
    length_deg, ln_weight_of_length = length
    variance = prior.amplitudes_rel[:, None, None] ** 2
    share = np.where(np.equal.outer(seen.contact, seen.contact), 1.0, common_share)
    correlation = share * matern_correlation(seen.angles_deg, seen.angles_deg, length_deg, nu)
    whole = variance * (correlation + _JITTER * np.eye(seen.angles_deg.size)) + seen.noise
    solve = np.linalg.inv(whole)
    ln_weight = (
        ln_weight_of_length - 0.5 * (np.log(prior.amplitudes_rel / prior.amplitude_rel) / prior.amplitude_ln_sd) ** 2
    )
    ln_weight -= 0.5 * np.linalg.slogdet(whole)[1]
    scale_gain: Floats = np.zeros((len(whole), seen.angles_deg.size))
    scale_variance: Floats = np.zeros(len(whole))
    if seen.scales.shape[1]:
        information = seen.scales.T @ solve @ seen.scales
        spread = np.linalg.inv(information)
        estimators = spread @ seen.scales.T @ solve
        ln_weight -= 0.5 * np.linalg.slogdet(information)[1]
        scale_gain, scale_variance = estimators[:, 0], np.asarray(spread[:, 0, 0])
        solve = solve - solve @ seen.scales @ estimators
    ln_weight -= 0.5 * (solve @ seen.values) @ seen.values
    return _Part(nu, length_deg, common_share, ln_weight, np.asarray(solve), scale_gain, scale_variance)


def _normalised(ln_weights: Floats) -> Floats:
    """Return weights that sum to one."""
    weights = np.exp(ln_weights - ln_weights.max())
    return np.asarray(weights / weights.sum())


def quantiles(weights: Floats, values: Floats, at: Sequence[float]) -> tuple[float, ...]:
    """Return quantiles of positive values with weights, linear in the logarithm between them."""
    order = np.argsort(values)
    summed = weights[order].cumsum() - weights[order] / 2
    return tuple(np.exp(np.interp(at, summed, np.log(values[order]))).tolist())


@lru_cache(maxsize=128)
def _root(nu: float, length_deg: float, angles_deg: bytes) -> Floats:
    """Return a root (A, E) of the correlation of a curve at angles, given as the bytes of a float array."""
    angles = np.frombuffer(angles_deg)
    return normal_root(matern_correlation(angles, angles, length_deg, nu))


def matern_correlation(first_deg: Floats, second_deg: Floats, length_deg: float, nu: float) -> Floats:
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
        raise ValueError(
            f"the smoothness nu must be 0.5, 1.5 or 2.5, because other values have no closed form here, got {nu:g}"
        )
    return np.asarray(polynomials[nu] * np.exp(-q))


def draw_normal(covariance: Floats, draws: int, rng: np.random.Generator) -> Floats:
    """Return zero-mean normal draws of shape (draws, G) with a covariance (G, G) that may be singular."""
    root = normal_root(covariance)
    return np.asarray(rng.standard_normal((draws, root.shape[1])) @ root.T)


def normal_root(covariance: Floats) -> Floats:
    """Return a root (G, E) of a covariance (G, G) that may be singular: root root' is the covariance."""
    if not len(covariance):
        return np.zeros((0, 0))
    eigenvalues, vectors = np.linalg.eigh(covariance)
    kept = eigenvalues > _LEAST_EIGENVALUE * eigenvalues.max(initial=0.0)
    return np.asarray(_upright(vectors[:, kept]) * np.sqrt(eigenvalues[kept]))


def _upright(vectors: Floats) -> Floats:
    """Return eigenvectors (G, E) with their largest component positive: their signs differ between LAPACK libraries."""
    size = np.abs(vectors)
    # odd vectors have two largest components, equal but for rounding: the first one counts
    first = (size >= _EQUAL * size.max(axis=0, initial=0.0)).argmax(axis=0)
    return np.asarray(vectors * np.sign(np.take_along_axis(vectors, first[None, :], axis=0)))


def expected_maximum_gain(intercepts: Floats, slopes: Floats) -> float:
    """Return E[max_i(a_i + b_i Z)] - max_i a_i for a standard normal Z.

    The maximum of the lines is piecewise linear and convex. With its lines in order of slope and the points c_i where
    line i gives way to line i + 1, the gain is sum_i (b_{i+1} - b_i) f(-|c_i|), f(z) = phi(z) + z Phi(z). Exact.

    Parameters
    ----------
    intercepts, slopes : ndarray, shape (G,)

    Returns
    -------
    float
        In the unit of the intercepts; never negative.

    References
    ----------
    P. Frazier, W. Powell, S. Dayanik, The knowledge-gradient policy for correlated normal beliefs, INFORMS J. Comput.
    21 (2009), 599-613, algorithm 1.
    """
    order = np.lexsort((intercepts, slopes))
    lines: list[tuple[float, float]] = []
    gives_way: list[float] = []
    for a, b in zip(intercepts[order].tolist(), slopes[order].tolist(), strict=True):
        while lines:
            last_a, last_b = lines[-1]
            if b > last_b:
                crossing = (last_a - a) / (b - last_b)
                if not gives_way or crossing > gives_way[-1]:
                    gives_way.append(crossing)
                    break
            # the last line is nowhere above both of its neighbours
            lines.pop()
            if gives_way:
                gives_way.pop()
        lines.append((a, b))
    steps = np.diff([b for _, b in lines])
    distance = -np.abs(gives_way)
    return float((steps * (norm.pdf(distance) + distance * norm.cdf(distance))).sum())


def knowledge_gradient(mean: Floats, response: Floats, observed_variance: Floats, noise_variance: Floats) -> Floats:
    """Return how much the best expected value is expected to rise when each candidate is observed once.

    Observing candidate j moves the expected values by response[:, j] / sqrt(v_j + n_j) times a standard normal.

    Parameters
    ----------
    mean : ndarray, shape (G,)
        Expected values among which the best is chosen.
    response : ndarray, shape (G, C)
        Covariance of each value with the quantity that candidate j observes.
    observed_variance, noise_variance : ndarray, shape (C,)
        Variance of that quantity before the observation, and of the observation itself.

    Returns
    -------
    ndarray, shape (C,)
        In the unit of the mean.
    """
    sd = np.sqrt(np.maximum(observed_variance, 0) + noise_variance)
    return np.array([expected_maximum_gain(mean, slopes) for slopes in (response / sd).T])
