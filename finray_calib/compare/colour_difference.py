"""CIEDE2000: how different two displayed images look to people.

For displayed images only. A photometric error belongs in linear light, see `relative_rms` and `skill`.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from data_schemas.errors import CompareError
from finray_calib.compare.colour_kernels import (
    difference_of_terms,
    hue_difference_and_mean,
    lab_of_ratios,
    stretched_red_green,
    white_ratios,
)
from finray_calib.compare.regions import pixels_within, usable_pixels

Floats = NDArray[np.float64]

#: IEC 61966-2-1, rounded as in the standard.
_SRGB_TO_XYZ = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])
#: D65 of the 2 degree observer from its chromaticity (0.3127, 0.3290).
_WHITE_XYZ = np.array([0.3127 / 0.3290, 1.0, (1 - 0.3127 - 0.3290) / 0.3290])
_TO_RATIO = _SRGB_TO_XYZ / _WHITE_XYZ[:, None]
#: Pixels worked at once, one plane for each quantity: some twenty of them stay in the processor's cache.
_CHUNK_PX = 8192


@dataclass(frozen=True, slots=True)
class ColourDifference:
    """Hold the CIEDE2000 difference over a region: mean and 95th percentile of its `pixels`."""

    mean: float
    p95: float
    pixels: int


def srgb_to_lab(srgb: Floats) -> Floats:
    """Convert sRGB to CIE L*a*b* under D65 for the 2 degree observer.

    The sRGB curve is inverted, the linear light goes through the matrix of IEC 61966-2-1 to XYZ, then
    L* = 116 f(Y/Yn) - 16, a* = 500 (f(X/Xn) - f(Y/Yn)), b* = 200 (f(Y/Yn) - f(Z/Zn)). Valid for encoded sRGB,
    not for linear camera channels.

    Parameters
    ----------
    srgb : ndarray, shape (..., 3)
        Encoded sRGB, 0..1.

    Returns
    -------
    ndarray, shape (..., 3)
        L*, a*, b*.

    Raises
    ------
    CompareError
        If the last axis is not three channels or a value lies outside 0..1.

    References
    ----------
    IEC 61966-2-1:1999; CIE 15:2018.
    """
    encoded = _checked_srgb(srgb)
    lab = np.empty(encoded.shape)
    flat, result = encoded.reshape(-1, 3), lab.reshape(-1, 3)
    for start in range(0, len(flat), _CHUNK_PX):
        chunk = slice(start, start + _CHUNK_PX)
        result[chunk] = np.transpose(_lab_planes(_planes(flat[chunk])))
    return lab


def ciede2000(first_lab: Floats, second_lab: Floats) -> Floats:
    """Return the CIEDE2000 colour difference, parametric factors all 1.

    dE = sqrt((dL'/S_L)^2 + (dC'/S_C)^2 + (dH'/S_H)^2 + R_T (dC'/S_C)(dH'/S_H)). Meant for small differences;
    beyond about 5 units it is a rank, not a distance.

    Parameters
    ----------
    first_lab, second_lab : ndarray, shape (..., 3)
        CIE L*, a*, b*; two shapes that broadcast.

    Returns
    -------
    ndarray, shape (...)

    References
    ----------
    G. Sharma, W. Wu, E. N. Dalal, Color Research and Application 30 (2005) 21.
    """
    first, second = np.broadcast_arrays(
        np.asarray(first_lab, dtype=np.float64), np.asarray(second_lab, dtype=np.float64)
    )
    return _in_chunks(_difference, first.reshape(-1, 3), second.reshape(-1, 3)).reshape(first.shape[:-1])


def colour_difference_map(first_srgb: Floats, second_srgb: Floats) -> Floats:
    """Return the CIEDE2000 difference of two displayed images, pixel by pixel.

    Parameters
    ----------
    first_srgb, second_srgb : ndarray, shape (H, W, 3)
        Encoded sRGB, 0..1.

    Returns
    -------
    ndarray, shape (H, W)

    Raises
    ------
    CompareError
        If the shapes differ or values lie outside 0..1.
    """
    if first_srgb.shape != second_srgb.shape:
        raise CompareError(
            f"Displayed images must have one shape, got {first_srgb.shape} and {second_srgb.shape}. Crop them first."
        )
    first, second = _checked_srgb(first_srgb), _checked_srgb(second_srgb)
    return _in_chunks(_srgb_difference, first.reshape(-1, 3), second.reshape(-1, 3)).reshape(first.shape[:-1])


def colour_difference_within(first_srgb: Floats, second_srgb: Floats, mask: NDArray[np.bool_]) -> ColourDifference:
    """Return mean and 95th percentile of the CIEDE2000 difference of two displayed images over a region.

    Parameters
    ----------
    first_srgb, second_srgb : ndarray, shape (H, W, 3)
        Encoded sRGB, 0..1, see `displayed_image`; pixels that are not finite in both are left out.
    mask : ndarray of bool, shape (H, W)

    Returns
    -------
    ColourDifference

    Raises
    ------
    CompareError
        If shapes differ, no pixel is usable, or values lie outside 0..1.
    """
    used = usable_pixels(mask, first_srgb, second_srgb)
    first, second = _checked_srgb(pixels_within(first_srgb, used)), _checked_srgb(pixels_within(second_srgb, used))
    difference = _in_chunks(_srgb_difference, first, second)
    return ColourDifference(float(difference.mean()), float(np.quantile(difference, 0.95)), difference.size)


def _checked_srgb(srgb: Floats) -> Floats:
    """Return sRGB values as floats, or say what they must be."""
    encoded = np.asarray(srgb, dtype=np.float64)
    if encoded.shape[-1:] != (3,) or not ((encoded >= 0) & (encoded <= 1)).all():
        raise CompareError(
            f"sRGB values must be 0..1 in three channels on the last axis, got shape {encoded.shape}. Divide 8-bit "
            "values by 255."
        )
    return encoded


def _in_chunks(difference: Callable[[Floats, Floats], Floats], first: Floats, second: Floats) -> Floats:
    """Apply a difference of planes (3, pixels) to two lists of pixels, shape (P, 3)."""
    result = np.empty(len(first))
    for start in range(0, len(first), _CHUNK_PX):
        chunk = slice(start, start + _CHUNK_PX)
        result[chunk] = difference(_planes(first[chunk]), _planes(second[chunk]))
    return result


def _planes(pixels: Floats) -> Floats:
    """Return a copy of a list of pixels as planes (3, pixels)."""
    return np.array(pixels.T, order="C")


def _lab_planes(srgb: Floats) -> Floats:
    """Return L*, a*, b* of sRGB planes."""
    ratios = np.empty_like(srgb)
    white_ratios(srgb, ((srgb + 0.055) / 1.055) ** 2.4, _TO_RATIO, ratios)
    lab_of_ratios(ratios, np.cbrt(ratios))
    return ratios


def _srgb_difference(first: Floats, second: Floats) -> Floats:
    """Return the CIEDE2000 difference of sRGB planes."""
    return _difference(_lab_planes(first), _lab_planes(second))


def _difference(first: Floats, second: Floats) -> Floats:
    """Return the CIEDE2000 difference of L*, a*, b* planes, which are used up."""
    chroma = np.empty((2, first.shape[1]))
    stretched_red_green(first, second, chroma)
    hues = np.stack([np.arctan2(lab[2], lab[1]) for lab in (first, second)])
    hue_difference_and_mean(hues, chroma)
    half_difference, mean = hues
    from_blue = (np.rad2deg(mean) - 275) / 25
    turn = np.sin(np.pi / 3 * np.exp(-from_blue * from_blue))
    result = np.empty(first.shape[1])
    difference_of_terms(first, second, chroma, np.sin(half_difference), np.cos(mean), np.sin(mean), turn, result)
    return result
