"""Error of the colour alone: red and green as shares of all light, which points at paints and LED."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from finray_calib.compare.regions import usable_pixels

Floats = NDArray[np.float64]
#: Below ten times its noise the sum is no divisor: shares would be biased by more than 1 %.
LEAST_SUM_TO_NOISE = 10.0


@dataclass(frozen=True, slots=True)
class ChromaticityError:
    """Hold the error of the chromaticity over a region.

    Attributes
    ----------
    rms : float
        Root mean square of the distance in the plane of R / (R + G + B) and G / (R + G + B); a share is 0..1.
    mean_red, mean_green : float
        Mean of simulated - captured share: the systematic part.
    noise_rms : float
        What noise alone would have given; its square was subtracted. 0 if no variance was given.
    pixels_used : int
        Pixels whose sum exceeds ten times its noise in both images.
    """

    rms: float
    mean_red: float
    mean_green: float
    noise_rms: float
    pixels_used: int


def chromaticity_error(
    simulated: Floats,
    captured: Floats,
    mask: NDArray[np.bool_],
    simulated_variance: Floats | None = None,
    captured_variance: Floats | None = None,
) -> ChromaticityError:
    r"""Return the RMS distance of the chromaticities (r, g) = (R, G) / (R + G + B).

    .. math:: e^2 = \langle (r_S - r_D)^2 + (g_S - g_D)^2 \rangle - \langle u_r^2 + u_g^2 \rangle_S
                    - \langle u_r^2 + u_g^2 \rangle_D, \quad
              u_r^2 = [(1 - r)^2 u_R^2 + r^2 (u_G^2 + u_B^2)] / (R + G + B)^2

    The noise is to first order, with channels independent. Valid for linear light with the black level removed; an
    exposure factor does not change it.

    Parameters
    ----------
    simulated, captured : ndarray, shape (H, W, 3)
    mask : ndarray of bool, shape (H, W)
    simulated_variance, captured_variance : ndarray, shape (H, W, 3), optional
        Noise variance of each pixel, in the square of the image's unit. Pixels whose sum is below ten times its noise
        in one image are left out; without a variance those whose sum is not positive.

    Returns
    -------
    ChromaticityError

    Raises
    ------
    CompareError
        If shapes differ or no pixel is usable.
    """
    first, first_noise = _shares(simulated, simulated_variance)
    second, second_noise = _shares(captured, captured_variance)
    difference, noise_square = first - second, first_noise + second_noise
    used = usable_pixels(mask, difference, np.broadcast_to(noise_square[..., None], difference.shape))
    noise = float(noise_square[used].mean())
    square = float((difference[used] ** 2).sum(axis=1).mean())
    red, green = difference[used].mean(axis=0)
    return ChromaticityError(
        float(np.sqrt(max(square - noise, 0.0))), float(red), float(green), float(np.sqrt(noise)), int(used.sum())
    )


def _shares(image: Floats, variance: Floats | None) -> tuple[Floats, Floats]:
    """Return red and green share (H, W, 2), NaN where the sum is too small, and their summed noise variance (H, W)."""
    total = np.asarray(image.sum(axis=2))
    noise_square = np.zeros_like(total) if variance is None else np.asarray(variance.sum(axis=2))
    enough = (total > 0) & (total > LEAST_SUM_TO_NOISE * np.sqrt(noise_square))
    divisor = np.where(enough, total, np.nan)
    share = image[..., :2] / divisor[..., None]
    if variance is None:
        return share, np.zeros_like(total)
    others = noise_square[..., None] - variance[..., :2]
    noise = ((1 - share) ** 2 * variance[..., :2] + share**2 * others).sum(axis=2) / divisor**2
    return share, noise
