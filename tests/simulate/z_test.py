"""Tell whether two Monte Carlo images differ by more than their noise, pixel by pixel and as a whole."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import stats


@dataclass(frozen=True)
class ZTest:
    """Standard scores of an image against a reference, and what Holm's procedure rejects.

    ``z`` (rows, columns, channels) per pixel; ``channel_z`` (channels,) of the sum over all pixels, which finds a
    small change everywhere that no single pixel shows. ``rejected`` counts hypotheses of both families.
    """

    z: NDArray[np.float64]
    channel_z: NDArray[np.float64]
    rejected_pixels: int
    rejected_channels: int

    @property
    def rejected(self) -> int:
        return self.rejected_pixels + self.rejected_channels


def z_test(
    runs: NDArray[np.float64],
    reference: NDArray[np.float64],
    reference_variance: NDArray[np.float64],
    reference_runs: int,
    error_rate: float = 1e-3,
) -> ZTest:
    """Compare independent renders (n, rows, columns, channels) with a stored mean image and the variance of that mean.

    Welch's t per pixel with both variances estimated, turned into standard scores. Pixels are independent (box
    filter), so the variance of a channel's sum is the sum of variances. Holm's step-down procedure over all pixels
    at half the error rate, and over the channels at the other half, keeps the chance of any false rejection under
    `error_rate`, whatever the dependence. Pixels that are the same constant in both (variance zero) count as equal.
    """
    count = len(runs)
    difference = runs.mean(axis=0) - reference
    own = runs.var(axis=0, ddof=1) / count
    variance = own + reference_variance
    noisy = variance > 0.0
    if (difference[~noisy] != 0.0).any():
        raise AssertionError("a pixel without noise differs from the reference")
    t = np.divide(difference, np.sqrt(variance), out=np.zeros_like(difference), where=noisy)
    parts = own**2 / (count - 1) + reference_variance**2 / (reference_runs - 1)
    freedom = np.divide(variance**2, parts, out=np.full_like(variance, np.inf), where=noisy)
    p = 2.0 * stats.t.sf(np.abs(t), freedom)
    total = variance.sum(axis=(0, 1))
    channel_z = np.divide(difference.sum(axis=(0, 1)), np.sqrt(total), out=np.zeros(total.shape), where=total > 0.0)
    channel_p = 2.0 * stats.norm.sf(np.abs(channel_z))
    pixels, channels = (int(holm(family.ravel(), error_rate / 2.0).sum()) for family in (p, channel_p))
    z = np.sign(t) * stats.norm.isf(np.clip(p, 1e-300, 1.0) / 2.0)
    return ZTest(z, channel_z, pixels, channels)


def holm(p: NDArray[np.float64], error_rate: float) -> NDArray[np.bool_]:
    """Return which hypotheses Holm's step-down procedure rejects at a family-wise error rate."""
    order = np.argsort(p)
    passed = p[order] > error_rate / (p.size - np.arange(p.size))
    first = int(np.argmax(passed)) if passed.any() else p.size
    rejected = np.zeros(p.size, dtype=bool)
    rejected[order[:first]] = True
    return rejected
