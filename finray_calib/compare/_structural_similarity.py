"""Structural similarity, on one scale and on several, with the settings of its papers.

With a mask, and safe against missing pixels. Its pointwise arithmetic is compiled: one pass over memory where array
expressions take ten.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from data_schemas import CompareError
from finray_calib.compare._image_noise import missing_pixels
from finray_calib.spectra import compiled, compiled_inside

Floats = NDArray[np.float64]
WINDOW_PX = 11
_BORDER_PX = WINDOW_PX // 2
_SIGMA_PX = 1.5
_WEIGHTS = np.exp(-0.5 * (np.arange(-_BORDER_PX, _BORDER_PX + 1) / _SIGMA_PX) ** 2)
_WEIGHTS /= _WEIGHTS.sum()
_K1, _K2 = 0.01, 0.03
#: Rows worked at once, in buffers that are allocated once: fresh memory costs more than the arithmetic.
_BAND_ROWS = 128


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
    x, y = _images(first, second, data_range_dn)
    everywhere = np.ones(x.shape[:2], dtype=np.bool_)
    ssim_map = np.full(x.shape[:2], np.nan)
    _mean_factors(x, y, data_range_dn, everywhere, ssim_map)
    return StructuralSimilarity(ssim_map, _mean_within(ssim_map, everywhere if mask is None else mask))


def _images(
    first: NDArray[np.float64] | NDArray[np.uint8],
    second: NDArray[np.float64] | NDArray[np.uint8],
    data_range_dn: float,
) -> tuple[Floats, Floats]:
    """Return two images as floats, or say what they must be."""
    x, y = np.asarray(first, dtype=np.float64), np.asarray(second, dtype=np.float64)
    if x.ndim != 3 or x.shape != y.shape or min(x.shape[:2]) < WINDOW_PX:
        raise CompareError(
            "Structural similarity needs two images of the same shape (height, width, channels) and of at least "
            f"{WINDOW_PX} x {WINDOW_PX} px, got the shapes {x.shape} and {y.shape}. Register and crop the render first."
        )
    if not data_range_dn > 0:
        raise CompareError(
            f"The data range must be positive, got {data_range_dn}; give the full scale, such as 255 for 8 bit."
        )
    return x, y


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
    x, y = np.ascontiguousarray(x), np.ascontiguousarray(y)
    buffers = np.empty((2, _BAND_ROWS, width - 2 * _BORDER_PX, channels))
    for start in range(_BORDER_PX, height - _BORDER_PX, _BAND_ROWS):
        stop = min(start + _BAND_ROWS, height - _BORDER_PX)
        band = slice(start - _BORDER_PX, stop + _BORDER_PX)
        luminance, structure = buffers[:, : stop - start]
        windowed_factors(_rows(x[band]), _rows(y[band]), (c1, c2), _WEIGHTS, _rows(luminance), _rows(structure))
        yield slice(start, stop), luminance, structure


def _rows(image: Floats) -> Floats:
    """Return an image as (rows, columns x channels)."""
    return image.reshape(len(image), -1)


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


Mask = NDArray[np.bool_]
SCALE_WEIGHTS = (0.0448, 0.2856, 0.3001, 0.2363, 0.1333)


def multi_scale_similarity(first: Floats, second: Floats, data_range_dn: float) -> float | None:
    r"""Return the multi-scale structural similarity of two images.

    .. math:: \langle l_5 s_5 \rangle^{w_5} \prod_{j=1}^{4} \langle s_j \rangle^{w_j}

    for each channel, then the mean over channels, with the luminance and structure factors l, s of
    `structural_similarity`, their means over complete windows, and each scale the mean over 2 x 2 pixels of the one
    before: over those that are finite in both images. A negative mean counts as 0.

    Parameters
    ----------
    first, second : ndarray, shape (H, W, C)
        Images in one unit.
    data_range_dn : float
        Full scale in that unit.

    Returns
    -------
    float or None
        None for an image too small for five scales (shorter side below 176 px), or where a scale has no complete
        window.

    Raises
    ------
    CompareError
        If shapes differ, the images are smaller than the window, or the range is not positive.

    References
    ----------
    Z. Wang, E. P. Simoncelli, A. C. Bovik, Asilomar Conference on Signals, Systems and Computers (2003) 1398.
    """
    return similarity_of_all_scales(first, second, data_range_dn)[1]


def similarity_of_all_scales(
    first: Floats, second: Floats, data_range_dn: float
) -> tuple[StructuralSimilarity, float | None]:
    """Return `structural_similarity` and `multi_scale_similarity` of whole images, whose finest windows are the same.

    Parameters
    ----------
    first, second : ndarray, shape (H, W, C)
        Images in one unit.
    data_range_dn : float
        Full scale in that unit.

    Raises
    ------
    CompareError
        If shapes differ, the images are smaller than the window, or the range is not positive.
    """
    x, y = _images(first, second, data_range_dn)
    everywhere = np.ones(x.shape[:2], dtype=np.bool_)
    ssim_map = np.full(x.shape[:2], np.nan)
    factors = [_mean_factors(x, y, data_range_dn, everywhere, ssim_map)]
    single = StructuralSimilarity(ssim_map, _mean_within(ssim_map, everywhere))
    if min(x.shape[:2]) < WINDOW_PX * 2 ** (len(SCALE_WEIGHTS) - 1):
        return single, None
    missing = missing_pixels(x, y)
    if missing is not None:
        x, y = (np.where(missing[..., None], np.nan, image) for image in (x, y))
    for _ in SCALE_WEIGHTS[1:]:
        x, y = _halved(x), _halved(y)
        factors.append(_mean_factors(x, y, data_range_dn, np.ones(x.shape[:2], dtype=np.bool_)))
    # structure of all scales but the last, where the luminance counts too
    means = np.array([*(structure for structure, _ in factors[:-1]), factors[-1][1]])
    value = float((np.maximum(means, 0.0) ** np.array(SCALE_WEIGHTS)[:, None]).prod(axis=0).mean())
    return single, value if np.isfinite(value) else None


def _halved(image: Floats) -> Floats:
    """Return the mean over the finite pixels of blocks of 2 x 2; NaN where there is none."""
    half = np.empty((image.shape[0] // 2, image.shape[1] // 2, image.shape[2]))
    mean_of_finite(image, half)
    return half


def _mean_factors(
    x: Floats, y: Floats, data_range_dn: float, mask: Mask, ssim_map: Floats | None = None
) -> tuple[Floats, Floats]:
    """Return per channel the means of structure and of luminance x structure over the complete windows of a mask.

    The mean over channels of the latter is put into a map (H, W) of NaN, where one is given, at all complete windows.
    """
    missing, spoiled = missing_pixels(x, y), None
    if missing is not None:
        window = np.ones((WINDOW_PX, WINDOW_PX), dtype=np.uint8)
        spoiled = cv2.dilate(missing.astype(np.uint8), window) > 0
        mask = mask & ~spoiled
        x, y = (np.where(missing[..., None], 0.0, image) for image in (x, y))
    sums, windows, inside = np.zeros((2, x.shape[2])), 0, slice(_BORDER_PX, -_BORDER_PX)
    for rows, luminance, structure in similarity_bands(x, y, data_range_dn):
        chosen = mask[rows, inside]
        of_band = np.zeros_like(sums)
        add_factors(luminance, structure, chosen, of_band)
        sums += of_band
        windows += int(np.count_nonzero(chosen))
        if ssim_map is not None:
            channel_mean_of_product(luminance, structure, ssim_map[rows, inside])
    if ssim_map is not None and spoiled is not None:
        ssim_map[spoiled] = np.nan
    structure_mean, whole_mean = sums / windows if windows else np.full_like(sums, np.nan)
    return structure_mean, whole_mean


@compiled
def windowed_factors(
    x: Floats, y: Floats, constants: tuple[float, float], weights: Floats, luminance: Floats, structure: Floats
) -> None:
    """Put the factors of two images, (rows, columns x channels), into the last two, which have no border.

    luminance = (2 mu_x mu_y + c1) / (mu_x^2 + mu_y^2 + c1), structure = (2 cov + c2) / (var_x + var_y + c2). Each row
    is averaged across once, and then enters the windows of the eleven rows around it.
    """
    c1, c2 = constants
    window, values = weights.size, luminance.shape[1]
    channels = (x.shape[1] - values) // (window - 1)
    moments, means = np.empty((4, x.shape[1])), np.empty((4, values))
    # every row stands here twice, so that the last eleven always follow each other
    across = np.empty((2 * window, 4, values))
    listed = across.ravel()
    for row in range(x.shape[0]):
        moments_of_row(x[row], y[row], moments[0], moments[1], moments[2], moments[3])
        for kind in range(4):
            weighted_sum(moments[kind], channels, weights, across[row % window, kind])
        across[row % window + window] = across[row % window]
        if row < window - 1:
            continue
        first = (row + 1) % window
        for kind in range(4):
            weighted_sum(listed[(4 * first + kind) * values :], 4 * values, weights, means[kind])
        factors_of_row(means, c1, c2, luminance[row - window + 1], structure[row - window + 1])


@compiled_inside
def moments_of_row(x: Floats, y: Floats, first: Floats, second: Floats, squares: Floats, product: Floats) -> None:
    """Put x, y, x^2 + y^2 and x y into the last four."""
    for i in range(x.size):
        a, b = x[i], y[i]
        first[i], second[i] = a, b
        squares[i], product[i] = a * a + b * b, a * b


@compiled_inside
def weighted_sum(values: Floats, apart: int, weights: Floats, result: Floats) -> None:
    """Put the sum of eleven values that stand apart by a number, with weights that read alike both ways, into the last.

    Written out, as loops over the eleven are not turned into vector instructions.
    """
    n = result.size
    w0, w1, w2, w3, w4, w5 = weights[0], weights[1], weights[2], weights[3], weights[4], weights[5]
    v0, v1, v2 = values[:n], values[apart : apart + n], values[2 * apart : 2 * apart + n]
    v3, v4, v5 = values[3 * apart : 3 * apart + n], values[4 * apart : 4 * apart + n], values[5 * apart : 5 * apart + n]
    v6, v7, v8 = values[6 * apart : 6 * apart + n], values[7 * apart : 7 * apart + n], values[8 * apart : 8 * apart + n]
    v9, v10 = values[9 * apart : 9 * apart + n], values[10 * apart : 10 * apart + n]
    for i in range(n):
        inner = w5 * v5[i] + w4 * (v4[i] + v6[i]) + w3 * (v3[i] + v7[i])
        result[i] = inner + w2 * (v2[i] + v8[i]) + w1 * (v1[i] + v9[i]) + w0 * (v0[i] + v10[i])


@compiled_inside
def factors_of_row(means: Floats, c1: float, c2: float, luminance: Floats, structure: Floats) -> None:
    """Put luminance and structure of windowed x, y, x^2 + y^2 and x y into the last two."""
    mean_x, mean_y, squares, product = means[0], means[1], means[2], means[3]
    for i in range(luminance.size):
        a, b = mean_x[i], mean_y[i]
        ab, aabb = a * b, a * a + b * b
        luminance[i] = (2.0 * ab + c1) / (aabb + c1)
        structure[i] = (2.0 * (product[i] - ab) + c2) / (squares[i] - aabb + c2)


@compiled
def add_factors(luminance: Floats, structure: Floats, chosen: Mask, sums: Floats) -> None:
    """Add structure and luminance x structure, (rows, columns, channels), of chosen pixels to sums (2, channels)."""
    for row in range(chosen.shape[0]):
        for column in range(chosen.shape[1]):
            if chosen[row, column]:
                for channel in range(structure.shape[2]):
                    similar = structure[row, column, channel]
                    sums[0, channel] += similar
                    sums[1, channel] += luminance[row, column, channel] * similar


@compiled
def mean_of_finite(image: Floats, result: Floats) -> None:
    """Put the mean over the finite values of blocks of 2 x 2 pixels, NaN where there is none, into the result."""
    for row in range(result.shape[0]):
        for column in range(result.shape[1]):
            for channel in range(result.shape[2]):
                total, finite = 0.0, 0
                for i in range(2):
                    for j in range(2):
                        value = image[2 * row + i, 2 * column + j, channel]
                        if np.isfinite(value):
                            total += value
                            finite += 1
                result[row, column, channel] = (total / 4.0) / (finite / 4.0) if finite else np.nan


@compiled
def channel_mean_of_product(first: Floats, second: Floats, result: Floats) -> None:
    """Put the mean over channels of the product of two (rows, columns, channels) arrays into the third."""
    channels = first.shape[2]
    for row in range(first.shape[0]):
        for column in range(first.shape[1]):
            total = 0.0
            for channel in range(channels):
                total += first[row, column, channel] * second[row, column, channel]
            result[row, column] = total / channels
