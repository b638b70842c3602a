"""From photo-electrons to raw counts: the only model of an image sensor (the tactile renderer uses it too)."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Counts = NDArray[np.uint16]
BAND_ROWS = 64
# From here on the largest difference of the two cumulative distributions is below 0.002.
CORNISH_FISHER_FROM_E = 10.0
# Variance of (z^2 - 1)/6 plus that of rounding to whole electrons.
EXCESS_VARIANCE_E2 = 1.0 / 18.0 + 1.0 / 12.0


@dataclass(frozen=True, slots=True)
class Sensor:
    """Linear image sensor with the noise model of EMVA 1288.

    Attributes
    ----------
    bit_depth
        Bits of a count; full scale is ``2**bit_depth - 1`` DN.
    black_level_dn
        Count without light and dark current (DN).
    gain_e_per_dn
        Electrons per count (e/DN).
    read_noise_e
        Temporal standard deviation in the dark (e).
    dark_current_e_per_s
        Mean dark current (e/s).
    full_well_e
        Largest charge of a pixel (e).
    prnu_rel
        Standard deviation of the pixels' sensitivity, relative.
    dsnu_e
        Standard deviation of the pixels' dark offset (e), the same at every exposure.
    seed
        Seed of the fixed pattern (which pixel deviates how much).
    """

    bit_depth: int
    black_level_dn: float
    gain_e_per_dn: float
    read_noise_e: float
    dark_current_e_per_s: float
    full_well_e: float
    prnu_rel: float
    dsnu_e: float
    seed: int

    @property
    def full_scale_dn(self) -> int:
        """Largest count (DN)."""
        return int(2**self.bit_depth - 1)

    def fixed_pattern(self, shape: tuple[int, int]) -> tuple[Floats, Floats]:
        """Return each pixel's relative sensitivity (mean 1) and dark offset (e), both of `shape` (H, W)."""
        return _fixed_pattern(self.seed, self.prnu_rel, self.dsnu_e, shape)

    def expose(self, electrons_per_s: Floats, exposure_s: float, rng: np.random.Generator) -> Counts:
        r"""Expose one frame.

        .. math:: n = \mathrm{clip}\Bigl(\mathrm{round}\bigl(b + (\min(P, w) + o + \sigma z) / K\bigr)\Bigr),
                  \quad P \sim \mathrm{Poisson}\bigl((g r + d)\, t\bigr)

        with rate r, sensitivity g, dark current d, full well w, offset o, read noise sigma, gain K (e/DN) and
        black level b.

        Parameters
        ----------
        electrons_per_s
            Mean photo-electrons per second and pixel, shape (H, W), not negative.
        exposure_s
            Exposure time (s).
        rng
            Generator of the temporal noise.

        Returns
        -------
        ndarray of uint16
            Counts (DN), shape (H, W), 0 to full scale.
        """
        height, width = electrons_per_s.shape
        sensitivity, offset_e = self.fixed_pattern((height, width))
        counts = np.empty((height, width), dtype=np.uint16)
        bands = [slice(first, first + BAND_ROWS) for first in range(0, height, BAND_ROWS)]

        def expose_band(band: slice, band_rng: np.random.Generator) -> None:
            mean_e = electrons_per_s[band] * sensitivity[band]
            counts[band] = self._count(mean_e, offset_e[band], exposure_s, band_rng)

        # Bands fit the cache, and numpy releases the interpreter lock: as many of them run as there are cores.
        with ThreadPoolExecutor() as pool:
            list(pool.map(expose_band, bands, rng.spawn(len(bands))))
        return counts

    def _count(self, electrons_per_s: Floats, offset_e: Floats, exposure_s: float, rng: np.random.Generator) -> Counts:
        """Expose a band of rows; `electrons_per_s` is overwritten."""
        mean_e = electrons_per_s
        mean_e += self.dark_current_e_per_s
        mean_e *= exposure_s
        # Far beyond the full well the draw is clipped anyway.
        np.minimum(mean_e, 4.0 * self.full_well_e, out=mean_e)
        charge_e = poisson_charge(mean_e, rng)
        np.minimum(charge_e, self.full_well_e, out=charge_e)
        charge_e += offset_e
        charge_e += self.read_noise_e * rng.standard_normal(charge_e.shape, dtype=np.float32)
        charge_e /= self.gain_e_per_dn
        charge_e += self.black_level_dn
        np.rint(charge_e, out=charge_e)
        np.clip(charge_e, 0, self.full_scale_dn, out=charge_e)
        return charge_e.astype(np.uint16)


@lru_cache(maxsize=2)
def _fixed_pattern(seed: int, prnu_rel: float, dsnu_e: float, shape: tuple[int, int]) -> tuple[Floats, Floats]:
    """Draw the fixed pattern; cached because every frame of a session needs it."""
    rng = np.random.default_rng([seed, 4])
    sensitivity = np.clip(1.0 + prnu_rel * rng.standard_normal(shape), 0.0, None)
    offset_e = dsnu_e * rng.standard_normal(shape)
    for pattern in (sensitivity, offset_e):
        pattern.flags.writeable = False
    return sensitivity, offset_e


def poisson_charge(mean_e: Floats, rng: np.random.Generator) -> Floats:
    r"""Draw Poisson electron numbers fast: exact below 10 e, above by the first Cornish-Fisher correction.

    .. math:: P \approx \mathrm{round}\bigl(\mu + \sqrt{\mu - 5/36}\, z + (z^2 - 1)/6\bigr), \quad z \sim N(0, 1)

    which has the mean, variance and (to order 1/mu) skewness of the Poisson law; twice as fast as exact draws.

    Parameters
    ----------
    mean_e
        Mean electron number of each pixel, any shape, not negative.
    rng
        Generator of the draws.

    Returns
    -------
    ndarray
        Whole numbers of electrons, shape of `mean_e`.
    """
    few = mean_e < CORNISH_FISHER_FROM_E
    if few.all():
        return rng.poisson(mean_e).astype(np.float64)
    z = rng.standard_normal(mean_e.shape, dtype=np.float32)
    charge_e: Floats = np.sqrt(np.maximum(mean_e - EXCESS_VARIANCE_E2, 0.0))
    charge_e *= z
    charge_e += mean_e
    z *= z
    z -= 1.0
    z /= 6.0
    charge_e += z
    np.rint(charge_e, out=charge_e)
    np.maximum(charge_e, 0.0, out=charge_e)
    charge_e[few] = rng.poisson(mean_e[few])
    return charge_e


def mosaic(rgb: Floats) -> Floats:
    """Spread red, green and blue planes over an RGGB Bayer mosaic.

    Parameters
    ----------
    rgb
        Values per 2 x 2 cell, shape (h, w, 3).

    Returns
    -------
    ndarray
        Shape (2h, 2w): red top left, green top right and bottom left, blue bottom right of each cell.
    """
    height, width, _ = rgb.shape
    raw = np.empty((2 * height, 2 * width))
    raw[0::2, 0::2] = rgb[..., 0]
    raw[0::2, 1::2] = raw[1::2, 0::2] = rgb[..., 1]
    raw[1::2, 1::2] = rgb[..., 2]
    return raw
