r"""How far the region's mean may lie from the paint's: texture seen through the laser spot.

The laser weighs the region unevenly, and it weighs another texture on the white tile than on the sample, so that the
ratio of the two means depends on where the spot lies. Over K blocks with light shares e_k and deviations d_k
(averaged over the bands, because texture is common to them)

.. math:: \mathrm{var} = \frac{K}{K - 1} \sum_k e_k^2 \Bigl[(d_k - \bar d)^2 - n\Bigr]

with n the photon noise of a block. Valid when a block is wider than the texture; a slow gradient over the region
makes it larger than the truth.
"""

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
# A band whose blocks are noisier than this says nothing about texture.
LARGEST_BLOCK_NOISE_REL = 0.05


def texture_variance_rel(values: Floats, noise_variance_rel: Floats, light: Floats) -> float:
    """Return the relative variance of the region's mean due to texture, common to all bands.

    Parameters
    ----------
    values
        (K, N) value of each block and band, any unit; NaN columns are left out.
    noise_variance_rel
        (N,) relative noise variance of one block's value.
    light
        (K,) light on each block, any unit.
    """
    mean = values.mean(axis=0)
    good = np.isfinite(values).all(axis=0) & (mean > 0) & (noise_variance_rel < LARGEST_BLOCK_NOISE_REL**2)
    if len(values) < 2 or not good.any():
        return 0.0
    weight = 1 / np.maximum(noise_variance_rel[good], np.finfo(float).tiny)
    deviation = (values[:, good] / mean[good] - 1) @ weight / weight.sum()
    share = light / light.sum()
    scatter = (deviation - share @ deviation) ** 2 - 1 / weight.sum()
    blocks = len(values)
    return max(float((share**2 * scatter).sum()) * blocks / (blocks - 1), 0.0)
