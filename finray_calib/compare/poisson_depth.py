"""Integrate slopes to a depth: the least-squares solution of Poisson's equation by cosine transforms."""

import numpy as np
from numpy.typing import NDArray
from scipy.fft import dctn, idctn

Floats = NDArray[np.float64]


def poisson_depth_mm(slopes: Floats, mm_per_px: float) -> Floats:
    """Return the depth whose differences from pixel to pixel come nearest to the slopes.

    Minimises the sum over neighbours of (z_b - z_a - h (s_a + s_b) / 2)^2, h = `mm_per_px`; nothing is assumed at the
    edges (Neumann). Exact for every depth that is a polynomial of second degree.

    Parameters
    ----------
    slopes
        (H, W, 2): d depth / d column and d depth / d row, mm per mm; finite.
    mm_per_px
        Side of a pixel on the gel.

    Returns
    -------
    (H, W), mm, of mean zero: slopes do not tell a constant.
    """
    rows, columns = slopes.shape[:2]
    divergence = np.zeros((rows, columns))
    along = mm_per_px * (slopes[:, :-1, 0] + slopes[:, 1:, 0]) / 2.0
    down = mm_per_px * (slopes[:-1, :, 1] + slopes[1:, :, 1]) / 2.0
    divergence[:, :-1] += along
    divergence[:, 1:] -= along
    divergence[:-1] += down
    divergence[1:] -= down
    cosines = [2.0 - 2.0 * np.cos(np.pi * np.arange(size) / size) for size in (rows, columns)]
    laplacian = -(cosines[0][:, None] + cosines[1])
    spectrum = dctn(divergence, type=2, norm="ortho")
    laplacian[0, 0] = 1.0
    spectrum /= laplacian
    spectrum[0, 0] = 0.0
    return np.asarray(idctn(spectrum, type=2, norm="ortho"))
