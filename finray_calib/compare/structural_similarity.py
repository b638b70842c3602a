"""Structural similarity with the settings of its paper, with a mask, and safe against missing pixels."""

from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from data_schemas.errors import CompareError
from finray_calib.compare.similarity_kernels import (
    channel_mean_of_product,
    second_moments,
    similarity_factors,
)

Floats = NDArray[np.float64]
WINDOW_PX = 11
_BORDER_PX = WINDOW_PX // 2
_SIGMA_PX = 1.5
_K1, _K2 = 0.01, 0.03
#: Rows worked at once, in buffers that are allocated once: fresh memory for each band costs more than its arithmetic.
_BAND_ROWS = 64


@dataclass(frozen=True, slots=True)
class StructuralSimilarity:
    """Hold a map of structural similarity and its mean.

    Attributes
    ----------
    ssim_map : ndarray, shape (H, W)
        Mean over channels; NaN on the 5 px border and where the window touches a pixel that is not finite.
    mean : float
        Mean of the map, over the mask if one was given.
    """

    ssim_map: NDArray[np.float64]
    mean: float

    def mean_within(self, mask: NDArray[np.bool_]) -> float:
        """Return the mean of the map over a boolean mask of shape (H, W).

        NaN when no window centred in it is complete: the mask lies on the border, or every window holds a pixel
        that is not finite.

        Raises
        ------
        CompareError
            If the mask has another shape.
        """
        return _mean_within(self.ssim_map, mask)


def structural_similarity(
    first: NDArray[np.float64] | NDArray[np.uint8],
    second: NDArray[np.float64] | NDArray[np.uint8],
    data_range_dn: float,
    mask: NDArray[np.bool_] | None = None,
) -> StructuralSimilarity:
    """Return the structural similarity of two images.

    SSIM = (2 mu_x mu_y + C1)(2 cov_xy + C2) / ((mu_x^2 + mu_y^2 + C1)(var_x + var_y + C2)), with means,
    variances and covariance (of the population) under an 11 x 11 Gaussian window of sigma 1.5 px,
    C1 = (0.01 L)^2 and C2 = (0.03 L)^2; averaged over channels, borders without a full window left out. The
    whole-image mean says little about contact, which changes few pixels: print it beside that of the
    no-contact image.

    Parameters
    ----------
    first, second : ndarray of float or uint8, shape (H, W, C)
        Images in one unit.
    data_range_dn : float
        Full scale L in that unit (255 for 8 bit); always stated, since the value depends on it.
    mask : ndarray of bool, shape (H, W), optional
        Window centres to average over; default all.

    Returns
    -------
    StructuralSimilarity

    Raises
    ------
    CompareError
        If shapes differ, the images are smaller than the window, or the range is not positive.

    References
    ----------
    Z. Wang et al., IEEE Transactions on Image Processing 13 (2004) 600.
    """
    x, y = np.asarray(first, dtype=np.float64), np.asarray(second, dtype=np.float64)
    if x.ndim != 3 or x.shape != y.shape or min(x.shape[:2]) < WINDOW_PX:
        raise CompareError(
            f"Structural similarity needs two images of one shape (height, width, channels) of at least "
            f"{WINDOW_PX} x {WINDOW_PX} px, got {x.shape} and {y.shape}. Register and crop the render first."
        )
    if not data_range_dn > 0:
        raise CompareError(f"The data range must be positive, got {data_range_dn}; give full scale, as 255 for 8 bit.")
    all_finite = bool(np.isfinite(x.sum() + y.sum()))  # then every pixel is finite, at a small part of the time
    if not all_finite:
        missing = ~np.isfinite(_channel_sum(x + y))
        x, y = (np.where(missing[..., None], 0.0, image) for image in (x, y))
    ssim_map = np.full(x.shape[:2], np.nan)
    inside = slice(_BORDER_PX, -_BORDER_PX)
    for rows, luminance, structure in similarity_bands(x, y, data_range_dn):
        channel_mean_of_product(luminance, structure, ssim_map[rows, inside])
    if not all_finite:
        window = np.ones((WINDOW_PX, WINDOW_PX), dtype=np.uint8)
        ssim_map[cv2.dilate(missing.astype(np.uint8), window) > 0] = np.nan
    everywhere = np.ones(x.shape[:2], dtype=np.bool_)
    return StructuralSimilarity(ssim_map, _mean_within(ssim_map, everywhere if mask is None else mask))


def similarity_bands(x: Floats, y: Floats, data_range_dn: float) -> Iterator[tuple[slice, Floats, Floats]]:
    """Yield the two factors of the similarity, band by band over the rows that have a full window.

    luminance = (2 mu_x mu_y + C1) / (mu_x^2 + mu_y^2 + C1), structure = (2 cov_xy + C2) / (var_x + var_y + C2).

    Parameters
    ----------
    x, y : ndarray, shape (H, W, C)
        Finite.
    data_range_dn : float

    Yields
    ------
    rows : slice
        Of the whole image.
    luminance, structure : ndarray, shape (rows, W - 10, C)
        Buffers, valid until the next band.
    """
    c1, c2 = (_K1 * data_range_dn) ** 2, (_K2 * data_range_dn) ** 2
    height, width, channels = x.shape
    columns = slice(_BORDER_PX, -_BORDER_PX)
    x, y = np.ascontiguousarray(x), np.ascontiguousarray(y)
    buffers = np.empty((6, _BAND_ROWS + 2 * _BORDER_PX, width, channels))
    for start in range(_BORDER_PX, height - _BORDER_PX, _BAND_ROWS):
        stop = min(start + _BAND_ROWS, height - _BORDER_PX)
        band = slice(start - _BORDER_PX, stop + _BORDER_PX)
        mean_x, mean_y, squares, product, *sources = buffers[:, : stop - start + 2 * _BORDER_PX]
        second_moments(_rows(x[band]), _rows(y[band]), *map(_rows, sources))
        for source, mean in ((x[band], mean_x), (y[band], mean_y), (sources[0], squares), (sources[1], product)):
            cv2.GaussianBlur(source, (WINDOW_PX, WINDOW_PX), _SIGMA_PX, dst=mean)
        similarity_factors(_rows(mean_x), _rows(mean_y), _rows(squares), _rows(product), c1, c2)
        # the rows and columns without a full window are wrong, and left out
        yield slice(start, stop), mean_x[_BORDER_PX:-_BORDER_PX, columns], product[_BORDER_PX:-_BORDER_PX, columns]


def _rows(image: Floats) -> Floats:
    """Return an image as (rows, columns x channels)."""
    return image.reshape(len(image), -1)


def _channel_sum(image: Floats) -> Floats:
    """Return the sum over channels; numpy's own over three neighbours in memory takes as long as a filter."""
    total = image[..., 0].copy()
    for channel in range(1, image.shape[2]):
        total += image[..., channel]
    return total


def _mean_within(ssim_map: NDArray[np.float64], mask: NDArray[np.bool_]) -> float:
    """Return the mean of the finite map values inside a mask; NaN when there is none."""
    if mask.shape != ssim_map.shape:
        raise CompareError(
            f"The mask has shape {mask.shape} but the images are {ssim_map.shape[0]} x {ssim_map.shape[1]} px. "
            "Make the region for this image size."
        )
    values = ssim_map[mask]
    values = values[np.isfinite(values)]
    return float(values.mean()) if values.size else float("nan")
