"""CIEDE2000: how different two displayed images look to people.

For displayed images only. A photometric error belongs in linear light, see `relative_rms` and `skill`.
"""

import numpy as np
from numpy.typing import NDArray

from data_schemas.errors import CompareError

#: IEC 61966-2-1, rounded as in the standard.
_SRGB_TO_XYZ = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])
#: D65 of the 2 degree observer from its chromaticity (0.3127, 0.3290).
_WHITE_XYZ = np.array([0.3127 / 0.3290, 1.0, (1 - 0.3127 - 0.3290) / 0.3290])
#: Rows worked at once: some thirty temporaries of this height stay in the processor's cache.
_BAND_ROWS = 16


def srgb_to_lab(srgb: NDArray[np.float64]) -> NDArray[np.float64]:
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
    encoded = np.asarray(srgb, dtype=np.float64)
    if encoded.shape[-1:] != (3,) or not ((encoded >= 0) & (encoded <= 1)).all():
        raise CompareError(
            f"sRGB values must be 0..1 in three channels on the last axis, got shape {encoded.shape}. Divide 8-bit "
            "values by 255."
        )
    linear = np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)
    ratio = linear @ (_SRGB_TO_XYZ / _WHITE_XYZ[:, None]).T
    f = np.where(ratio > 216 / 24389, np.cbrt(ratio), ratio * (24389 / 27 / 116) + 16 / 116)
    x, y, z = f[..., 0], f[..., 1], f[..., 2]
    return np.stack([116 * y - 16, 500 * (x - y), 200 * (y - z)], axis=-1)


def ciede2000(first_lab: NDArray[np.float64], second_lab: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the CIEDE2000 colour difference, parametric factors all 1.

    dE = sqrt((dL'/S_L)^2 + (dC'/S_C)^2 + (dH'/S_H)^2 + R_T (dC'/S_C)(dH'/S_H)). Meant for small differences;
    beyond about 5 units it is a rank, not a distance.

    Parameters
    ----------
    first_lab, second_lab : ndarray, shape (..., 3)
        CIE L*, a*, b*.

    Returns
    -------
    ndarray, shape (...)

    References
    ----------
    G. Sharma, W. Wu, E. N. Dalal, Color Research and Application 30 (2005) 21.
    """
    l1, a1, b1 = np.moveaxis(np.asarray(first_lab, dtype=np.float64), -1, 0)
    l2, a2, b2 = np.moveaxis(np.asarray(second_lab, dtype=np.float64), -1, 0)
    stretch = 1.5 - 0.5 * _chroma_ratio((np.hypot(a1, b1) + np.hypot(a2, b2)) / 2)
    c1, h1 = _chroma_and_hue(a1 * stretch, b1)
    c2, h2 = _chroma_and_hue(a2 * stretch, b2)
    hue_difference, hue_mean = _hue_difference_and_mean(h1, h2, grey=c1 * c2 == 0)
    chroma_mean = (c1 + c2) / 2
    lightness_term = ((l1 + l2) / 2 - 50) ** 2
    t = (
        1
        - 0.17 * np.cos(hue_mean - np.deg2rad(30))
        + 0.24 * np.cos(2 * hue_mean)
        + 0.32 * np.cos(3 * hue_mean + np.deg2rad(6))
        - 0.20 * np.cos(4 * hue_mean - np.deg2rad(63))
    )
    lightness = (l2 - l1) / (1 + 0.015 * lightness_term / np.sqrt(20 + lightness_term))
    chroma = (c2 - c1) / (1 + 0.045 * chroma_mean)
    hue = 2 * np.sqrt(c1 * c2) * np.sin(hue_difference / 2) / (1 + 0.015 * chroma_mean * t)
    rotation_deg = 30 * np.exp(-(((np.rad2deg(hue_mean) - 275) / 25) ** 2))
    rotation = -2 * _chroma_ratio(chroma_mean) * np.sin(np.deg2rad(2 * rotation_deg))
    square = lightness**2 + chroma**2 + hue**2 + rotation * chroma * hue
    # The form is positive definite but can round below zero for equal colours.
    return np.asarray(np.sqrt(np.maximum(square, 0)))


def colour_difference_map(first_srgb: NDArray[np.float64], second_srgb: NDArray[np.float64]) -> NDArray[np.float64]:
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
    difference = np.empty(first_srgb.shape[:2])
    for start in range(0, len(difference), _BAND_ROWS):
        rows = slice(start, start + _BAND_ROWS)
        difference[rows] = ciede2000(srgb_to_lab(first_srgb[rows]), srgb_to_lab(second_srgb[rows]))
    return difference


def _chroma_ratio(chroma: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return sqrt(C^7 / (C^7 + 25^7))."""
    seventh = chroma**7
    return np.asarray(np.sqrt(seventh / (seventh + 25.0**7)))


def _chroma_and_hue(a: NDArray[np.float64], b: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return chroma and the hue angle in 0..2 pi."""
    hue = np.arctan2(b, a)
    return np.hypot(a, b), np.where(hue < 0, hue + 2 * np.pi, hue)


def _hue_difference_and_mean(
    h1: NDArray[np.float64], h2: NDArray[np.float64], grey: NDArray[np.bool_]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return difference and mean of two hue angles on the circle; a grey has no hue, so the sum stands in."""
    difference, total = h2 - h1, h1 + h2
    wraps = np.abs(difference) > np.pi
    mean = np.where(wraps, np.where(total < 2 * np.pi, total + 2 * np.pi, total - 2 * np.pi), total) / 2
    wrapped = np.where(wraps, difference - np.copysign(2 * np.pi, difference), difference)
    return wrapped, np.where(grey, total, mean)
