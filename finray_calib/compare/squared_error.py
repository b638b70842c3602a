"""Squared error between a render and a capture as a quadratic form: every draw of the inputs costs a few products.

A render is k m . L, its layers L weighted by m (paints, camera, pose) and an exposure factor k. Its squared error to
the capture D, summed over pixels, is k^2 m'A m - 2 k m'b + d with sums A, b, d that are formed once. A comes from the
product of two independent halves of the render, and the noise variance of the capture is taken out of d: what is left
is the squared error of the noise-free images.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class SquaredError:
    """Hold the sums over the pixels of one region; C channels, L layers.

    Attributes
    ----------
    quadratic : ndarray, shape (L, L)
        Symmetrised sum of products of both halves.
    linear : ndarray, shape (C, L)
        Sum of layers times capture.
    constant : ndarray, shape (C,)
        Sum of squares of the capture without its noise.
    """

    quadratic: Floats
    linear: Floats
    constant: Floats

    def __call__(self, weights: Floats, exposure: Floats, drift: Floats) -> Floats:
        """Return squared errors (draws, C), noise removed; small ones may come out negative.

        Parameters
        ----------
        weights : ndarray, shape (draws, C, L)
        exposure : ndarray, shape (draws,)
            Factor on the render.
        drift : ndarray, shape (draws,)
            Factor on the capture.
        """
        k, g = exposure[:, None], drift[:, None]
        squares = np.einsum("dcl,dcl->dc", weights @ self.quadratic, weights)
        return np.asarray(
            k**2 * squares - 2.0 * k * g * np.einsum("dcl,cl->dc", weights, self.linear) + g**2 * self.constant
        )


def squared_error(halves: tuple[Floats, Floats], captured: Floats, variance: Floats) -> SquaredError:
    """Form the sums over pixels.

    Parameters
    ----------
    halves : two ndarrays, shape (P, L)
        Layers of the independent halves of a render.
    captured : ndarray, shape (P, C)
    variance : ndarray, shape (P, C)
        Noise variance of `captured`.
    """
    first, second = halves
    product = first.T @ second
    return SquaredError(
        quadratic=(product + product.T) / 2.0,
        linear=captured.T @ ((first + second) / 2.0),
        constant=(captured**2 - variance).sum(axis=0),
    )


@dataclass(frozen=True, slots=True)
class NoiseCovariance:
    """What noise does to the squared error and to the contact signal of each channel; arrays of shape (C,)."""

    error: Floats
    signal: Floats
    both: Floats

    def draw(self, draws: int, rng: np.random.Generator) -> tuple[Floats, Floats]:
        """Return joint normal deviations (draws, C) of error and signal."""
        error_sd = np.sqrt(self.error)
        shared = np.divide(self.both, error_sd, out=np.zeros_like(error_sd), where=error_sd > 0.0)
        own = np.sqrt(np.maximum(self.signal - shared**2, 0.0))
        one, other = rng.standard_normal((2, draws, len(error_sd)))
        return one * error_sd, one * shared + other * own


def noise_covariance(
    error: Floats, signal: Floats, render_variance: Floats, capture_variance: Floats, no_contact_variance: Floats
) -> NoiseCovariance:
    """Return variances and covariance of noise-corrected sums of (S - D)^2 and (B - D)^2.

    With the error e = S - D and the signal s = B - D of the noise-free images and variances v of the noise, which is
    normal and independent between pixels: var sum (S-D)^2 = sum 4 e^2 (v_S + v_D) + 2 (v_S + v_D)^2, and with the
    independent halves of the render 2 v_S^2 more; cov = sum 4 e s v_D + 2 v_D^2. e^2, s^2 and e s are replaced by what
    is measured without the noise's share, no square below zero, so the variances are rather too large than too small.

    Parameters
    ----------
    error, signal : ndarray, shape (P, C)
        S - D and B - D as measured.
    render_variance, capture_variance, no_contact_variance : ndarray, shape (P, C)
    """
    s, d, b = render_variance, capture_variance, no_contact_variance
    clean_error = np.maximum(error**2 - s - d, 0.0)
    clean_signal = np.maximum(signal**2 - b - d, 0.0)
    return NoiseCovariance(
        error=(4.0 * clean_error * (s + d) + 2.0 * (s + d) ** 2 + 2.0 * s**2).sum(axis=0),
        signal=(4.0 * clean_signal * (b + d) + 2.0 * (b + d) ** 2).sum(axis=0),
        both=(4.0 * (error * signal - d) * d + 2.0 * d**2).sum(axis=0),
    )
