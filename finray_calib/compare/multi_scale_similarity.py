"""Multi-scale structural similarity with the settings of its paper, with a mask, and safe against missing pixels."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from data_schemas.errors import CompareError
from finray_calib.compare.blocks import block_mean
from finray_calib.compare.structural_similarity import WINDOW_PX, similarity_bands

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]
WEIGHTS = (0.0448, 0.2856, 0.3001, 0.2363, 0.1333)
_BORDER_PX = WINDOW_PX // 2


@dataclass(frozen=True, slots=True)
class MultiScaleSimilarity:
    """Hold a multi-scale similarity and the number of scales behind it.

    Attributes
    ----------
    value : float
    scales : int
        5 in the paper; with fewer the value is another quantity, see `label`.
    """

    value: float
    scales: int

    @property
    def label(self) -> str:
        """Say which quantity it is."""
        if self.scales == len(WEIGHTS):
            return "MS-SSIM, 5 scales (Wang 2003)"
        return f"MS-SSIM with {self.scales} of 5 scales, weights renormalised: not comparable with 5"


def multi_scale_similarity(
    first: Floats,
    second: Floats,
    data_range_dn: float,
    mask: Mask | None = None,
    fewer_scales: bool = False,
) -> MultiScaleSimilarity | None:
    r"""Return the multi-scale structural similarity of two images.

    .. math:: \langle l_5 s_5 \rangle^{w_5} \prod_{j=1}^{4} \langle s_j \rangle^{w_j}

    for each channel, then the mean over channels, with the luminance and structure factors l, s of
    `structural_similarity`, their means over complete windows, and each scale the mean over 2 x 2 pixels of the one
    before: over those that are finite in both images. A negative mean counts as 0. A coarse pixel lies in the mask
    where one of its pixels does.

    Parameters
    ----------
    first, second : ndarray, shape (H, W, C)
        Images in one unit.
    data_range_dn : float
        Full scale in that unit.
    mask : ndarray of bool, shape (H, W), optional
        Window centres to average over; default all.
    fewer_scales : bool
        Whether an image too small for five scales (shorter side below 176 px) may use as many as fit, with the weights
        brought back to a sum of 1.

    Returns
    -------
    MultiScaleSimilarity or None
        None for an image that is too small, or where a scale has no complete window in the mask.

    Raises
    ------
    CompareError
        If shapes differ or the range is not positive.

    References
    ----------
    Z. Wang, E. P. Simoncelli, A. C. Bovik, Asilomar Conference on Signals, Systems and Computers (2003) 1398.
    """
    x, y = (np.asarray(image, dtype=np.float64) for image in (first, second))
    inside = np.ones(x.shape[:2], dtype=np.bool_) if mask is None else mask
    if x.ndim != 3 or x.shape != y.shape or inside.shape != x.shape[:2]:
        raise CompareError(
            "Multi-scale similarity needs two images and a mask of one size (height, width, channels), got "
            f"{x.shape}, {y.shape} and {inside.shape}. Register and crop the render first."
        )
    if not data_range_dn > 0:
        raise CompareError(f"The data range must be positive, got {data_range_dn}; give full scale, as 255 for 8 bit.")
    scales = _scales(min(x.shape[:2]))
    if scales == 0 or (scales < len(WEIGHTS) and not fewer_scales):
        return None
    missing = np.asarray(~np.isfinite(x + y).all(axis=2))
    x, y = (np.where(missing[..., None], np.nan, image) for image in (x, y))
    # the five published weights add up to 1.0001 and are taken as they are
    weights = np.array(WEIGHTS[:scales]) / (1.0 if scales == len(WEIGHTS) else sum(WEIGHTS[:scales]))
    value = np.ones(x.shape[2])
    for scale, weight in enumerate(weights):
        if scale:
            x, y = _halved(x), _halved(y)
            inside = block_mean(inside.astype(np.float64), 2) > 0
        structure, whole = _mean_factors(x, y, data_range_dn, inside)
        value *= np.maximum(whole if scale == scales - 1 else structure, 0.0) ** weight
    return MultiScaleSimilarity(float(value.mean()), scales) if np.isfinite(value).all() else None


def _halved(image: Floats) -> Floats:
    """Return the mean over the finite pixels of blocks of 2 x 2; NaN where there is none."""
    finite = np.isfinite(image)
    share = block_mean(finite.astype(np.float64), 2)
    return block_mean(np.where(finite, image, 0.0), 2) / np.where(share > 0, share, np.nan)


def _scales(side_px: int) -> int:
    """Return how many scales have a complete window across the image, at most five."""
    return sum(side_px >= WINDOW_PX * 2**scale for scale in range(len(WEIGHTS)))


def _mean_factors(x: Floats, y: Floats, data_range_dn: float, mask: Mask) -> tuple[Floats, Floats]:
    """Return per channel the means of structure and of luminance x structure over the complete windows of a mask."""
    missing = np.asarray(~np.isfinite(x + y).all(axis=2))
    window = np.ones((WINDOW_PX, WINDOW_PX), dtype=np.uint8)
    used = mask & (cv2.dilate(missing.astype(np.uint8), window) == 0)
    if missing.any():
        x, y = (np.where(missing[..., None], 0.0, image) for image in (x, y))
    sums, windows = np.zeros((2, x.shape[2])), 0
    for rows, luminance, structure in similarity_bands(x, y, data_range_dn):
        chosen = used[rows, _BORDER_PX:-_BORDER_PX]
        similar = structure[chosen]
        sums += similar.sum(axis=0), (luminance[chosen] * similar).sum(axis=0)
        windows += len(similar)
    structure_mean, whole_mean = sums / windows if windows else np.full_like(sums, np.nan)
    return structure_mean, whole_mean
