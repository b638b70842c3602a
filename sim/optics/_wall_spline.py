"""Smooth what rays bring to the painted walls: a penalised spline on the texels, as stiff as the noise asks for.

The light on a wall has features of 5 to 10 mm beside a contact, which a polynomial over the whole wall cannot follow:
it rings on both sides of them, the same with every seed. The spline has one coefficient per texel (the tracer reads
texels bilinearly, so that they are coefficients of linear B-splines) and is held by its second differences along the
wall and up it. How stiffly is found by generalised cross-validation, for each map anew. Of the batches of a map, each
half is smoothed as the other half chose: no value is weighted by its own noise, and the mean stays linear in the light.
"""

import functools
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d

Floats = NDArray[np.float64]

BATCHES: Final = 16
"""Independent batches in which the light of the walls is computed; their scatter has 15 degrees of freedom."""

# trial strengths of both penalties, in units of the noise, from no smoothing to straight lines
_STRENGTHS = 10.0 ** np.arange(-8.0, 4.01, 0.25)
# cross-validation balances bias and noise of single texels; what the walls send is a mean over centimetres, in which
# noise averages out and bias does not: a tenth of the strength leaves a seventh of the bias and adds a tenth of noise
_SHARE_OF_STRENGTH = 0.1
# the variance of a texel is shared by all texels at its place along the wall and this many beside it
_ROWS_TOGETHER = 5
# of the mean variance: texels that no path reached are not known better than this
_LEAST_VARIANCE_REL = 1e-4
# of the largest value, where batches do not differ at all
_LEAST_NOISE_REL = 1e-6


@dataclass(frozen=True, slots=True)
class WallSmoother:
    r"""Smooth maps over a wall, (along, up) texels, linearly; several smoothers together are one with leading axes.

    A map y becomes the c that minimises

    .. math:: \sum (y - c)^2 / \sigma_z^2 + a \sum (\Delta_z^2 (c / \sigma_z))^2 + b \sum (\Delta_u^2 c)^2 / \sigma_z^2

    with the noise sigma at each place along the wall, which falls as the light does. In products of vectors along and
    up the wall everything is diagonal.

    Attributes
    ----------
    noise_sd
        sigma of what is smoothed, (..., along).
    gain
        What is kept of each product of vectors, 0 to 1, (..., along, up); the sum is the degrees of freedom of the fit.
    """

    noise_sd: Floats
    gain: Floats

    def __call__(self, values: NDArray[np.floating]) -> Floats:
        """Return the smoothed maps (..., along, up)."""
        (_, along), (_, up) = (_roughness(count) for count in self.gain.shape[-2:])
        kept = self.gain * (along.T @ (values / self.noise_sd[..., None]) @ up)
        return np.asarray(self.noise_sd[..., None] * (along @ kept @ up.T))

    @property
    def bias_variance(self) -> Floats:
        r"""Return the expected square of what smoothing takes off the truth, (along, up).

        Of light that is as rough as cross-validation found: the prior of covariance :math:`P^{-1}` of smoothing splines
        (Wahba 1983, Nychka 1988), of which :math:`I - S` is lost. Valid as a mean over the wall, not at each texel.
        """
        (_, along), (_, up) = (_roughness(count) for count in self.gain.shape[-2:])
        # per product the prior's variance is s g / (1 - g) noises, and (1 - g)^2 of it is lost
        share = _SHARE_OF_STRENGTH * self.gain * (1.0 - self.gain)
        return np.asarray(self.noise_sd[..., None] ** 2 * (along**2 @ share @ (up**2).T))


@dataclass(frozen=True, slots=True)
class SmoothedWall:
    """A smoothed map of a wall: its batches (batch, along, up), and the variance of smoothing's bias (along, up)."""

    batches: Floats
    bias_variance: Floats

    @property
    def mean(self) -> Floats:
        """Return the mean of the batches, (along, up)."""
        return np.asarray(self.batches.mean(axis=0))

    @property
    def error_sd(self) -> Floats:
        """Return the standard error of the mean, (along, up): noise by the batches, and the bias of smoothing."""
        noise = self.batches.var(axis=0, ddof=1) / len(self.batches)
        return np.asarray(np.sqrt(noise + self.bias_variance))


def smooth_batches(values: NDArray[np.floating]) -> SmoothedWall:
    """Smooth independent, equally good estimates of one map.

    Parameters
    ----------
    values
        Shape (batch, along, up); an even number of batches, at least four.

    Returns
    -------
    SmoothedWall
        Where the mean lies below zero by more than three standard errors, which no light does, it is set to zero.
        Single batches may lie below zero.
    """
    middle = len(values) // 2
    halves = values[:middle], values[middle:]
    smoothers = [choose_smoother(half.mean(axis=0), half.var(axis=0, ddof=1) / middle) for half in halves]
    batches = np.concatenate([smoothers[1](halves[0]), smoothers[0](halves[1])])
    found = SmoothedWall(batches, (smoothers[0].bias_variance + smoothers[1].bias_variance) / 2.0)
    dark = np.where(found.mean < -3.0 * found.error_sd, found.mean, 0.0)
    return SmoothedWall(batches - dark, found.bias_variance)


def choose_smoother(values: NDArray[np.floating], variance: NDArray[np.floating], maps: int = 2) -> WallSmoother:
    r"""Choose the strengths that predict a map best, and return the smoother for the mean of so many such maps.

    Generalised cross-validation: the least of :math:`\sum w r^2 / (1 - f / n)^2` with the residuals r, the fit's
    degrees of freedom f and the number n of texels; then a tenth of these strengths. They are those of the light, not
    of its noise: for the mean of maps, of less variance, they stay the same beside larger weights.

    Parameters
    ----------
    values
        The map, (along, up), or several, (..., along, up), for each of which is chosen by itself.
    variance
        Noise variance of each texel, of the same shape. It is taken to depend on the place along the wall alone.
    maps
        How many independent maps like this one are to be smoothed together.

    References
    ----------
    G. Wahba, Spline Models for Observational Data, 1990, chapter 4; P. Eilers, B. Marx, Statistical Science 11, 1996.
    """
    largest = np.abs(values).max(axis=(-2, -1))[..., None]
    noise_sd = _noise_along(variance, _LEAST_NOISE_REL * largest + np.finfo(np.float64).tiny)
    (of_along, along), (of_up, up) = (_roughness(count) for count in values.shape[-2:])
    spectrum = along.T @ (values / noise_sd[..., None]) @ up
    a, b = _least_prediction_error(spectrum**2)
    gain = 1.0 / (1.0 + _SHARE_OF_STRENGTH / maps * (a * of_along[:, None] + b * of_up))
    return WallSmoother(noise_sd / np.sqrt(maps), gain)


def _noise_along(variance: NDArray[np.floating], least_sd: Floats) -> Floats:
    """Return the standard deviation of texels along walls: a parabola in its logarithm, (..., along)."""
    rows = uniform_filter1d(variance.mean(axis=-1), _ROWS_TOGETHER, axis=-1, mode="nearest")
    lit = rows.any(axis=-1, keepdims=True)
    logarithm = np.log(np.where(lit, np.maximum(rows, _LEAST_VARIANCE_REL * rows.mean(axis=-1, keepdims=True)), 1.0))
    parabola, _ = np.linalg.qr(np.vander(np.linspace(-1.0, 1.0, rows.shape[-1]), 3))
    return np.where(lit, np.exp(0.5 * (logarithm @ parabola @ parabola.T)), least_sd)


def _least_prediction_error(spectrum2: Floats) -> tuple[Floats, Floats]:
    """Return the strengths along and up walls with the least generalised cross-validation score, (..., 1, 1) each.

    Every second one is tried, then the neighbours of the best.
    """
    lost2, divisor = _trials(*spectrum2.shape[-2:])
    maps = spectrum2.reshape(-1, lost2.shape[-1])
    every, last = np.arange(0, len(_STRENGTHS), 2), len(_STRENGTHS) - 1
    coarse = (every[:, None] * len(_STRENGTHS) + every).ravel()
    best = coarse[np.argmin((maps @ lost2[coarse].T) / divisor[coarse], axis=1)]
    around = np.arange(-1, 2)
    up, along = (np.clip(k[:, None] + around, 0, last) for k in divmod(best, len(_STRENGTHS)))
    near = (up[:, :, None] * len(_STRENGTHS) + along[:, None, :]).reshape(len(maps), -1)
    scores = (lost2[near] @ maps[:, :, None])[..., 0] / divisor[near]
    chosen = np.take_along_axis(near, scores.argmin(axis=1)[:, None], axis=1)[:, 0]
    b, a = (_STRENGTHS[k].reshape(*spectrum2.shape[:-2], 1, 1) for k in divmod(chosen, len(_STRENGTHS)))
    return a, b


@functools.cache
def _trials(along: int, up: int) -> tuple[Floats, Floats]:
    """Return what each pair of strengths takes off, squared, (pair, along * up), and the square of its mean, (pair,).

    Pairs are in the order of the strength up the wall, then along it.
    """
    (of_along, _), (of_up, _) = _roughness(along), _roughness(up)
    strength_up, strength_along = (s.reshape(-1, 1, 1) for s in np.meshgrid(_STRENGTHS, _STRENGTHS, indexing="ij"))
    roughness = strength_along * of_along[:, None] + strength_up * of_up
    lost = (roughness / (1.0 + roughness)).reshape(len(roughness), -1)
    return lost**2, lost.mean(axis=1) ** 2


@functools.cache
def _roughness(count: int) -> tuple[Floats, Floats]:
    """Return the sums of squared second differences of orthonormal vectors, (count,), and these as columns.

    In units of the smallest that is not zero.
    """
    difference = np.diff(np.eye(count), 2, axis=0)
    roughness, vectors = np.linalg.eigh(difference.T @ difference)
    roughness[:2] = 0.0
    return roughness / roughness[2], vectors
