"""Pointwise arithmetic of CIEDE2000, compiled; powers and angles stay with numpy, which forms several at once."""

import numpy as np
from numpy.typing import NDArray

from finray_calib.spectra.compiled import compiled

Floats = NDArray[np.float64]
_COS_30, _SIN_30 = 0.5 * 3.0**0.5, 0.5
_COS_6, _SIN_6 = float(np.cos(np.deg2rad(6.0))), float(np.sin(np.deg2rad(6.0)))
_COS_63, _SIN_63 = float(np.cos(np.deg2rad(63.0))), float(np.sin(np.deg2rad(63.0)))
_CHROMA_SCALE_7 = 25.0**7


@compiled
def white_ratios(srgb: Floats, powers: Floats, to_ratio: Floats, result: Floats) -> None:
    """Put X/Xn, Y/Yn, Z/Zn, (3, pixels), of sRGB into the result, given ((srgb + 0.055) / 1.055)^2.4."""
    linear = np.empty(3)
    for pixel in range(srgb.shape[1]):
        for channel in range(3):
            encoded = srgb[channel, pixel]
            linear[channel] = encoded / 12.92 if encoded <= 0.04045 else powers[channel, pixel]
        for row in range(3):
            result[row, pixel] = (
                to_ratio[row, 0] * linear[0] + to_ratio[row, 1] * linear[1] + to_ratio[row, 2] * linear[2]
            )


@compiled
def lab_of_ratios(ratios: Floats, roots: Floats) -> None:
    """Put L*, a*, b* in place of the ratios to white, (3, pixels), given their cube roots."""
    f = np.empty(3)
    for pixel in range(ratios.shape[1]):
        for row in range(3):
            ratio = ratios[row, pixel]
            f[row] = roots[row, pixel] if ratio > 216.0 / 24389.0 else ratio * (24389.0 / 27.0 / 116.0) + 16.0 / 116.0
        ratios[0, pixel] = 116.0 * f[1] - 16.0
        ratios[1, pixel] = 500.0 * (f[0] - f[1])
        ratios[2, pixel] = 200.0 * (f[1] - f[2])


@compiled
def stretched_red_green(first: Floats, second: Floats, chroma: Floats) -> None:
    """Put a' in place of a* of both colours, (3, pixels), and the chromas C' into (2, pixels)."""
    for pixel in range(first.shape[1]):
        a1, b1, a2, b2 = first[1, pixel], first[2, pixel], second[1, pixel], second[2, pixel]
        mean = (np.sqrt(a1 * a1 + b1 * b1) + np.sqrt(a2 * a2 + b2 * b2)) / 2.0
        seventh = mean * mean * mean * mean * mean * mean * mean
        stretch = 1.5 - 0.5 * np.sqrt(seventh / (seventh + _CHROMA_SCALE_7))
        a1 *= stretch
        a2 *= stretch
        first[1, pixel], second[1, pixel] = a1, a2
        chroma[0, pixel], chroma[1, pixel] = np.sqrt(a1 * a1 + b1 * b1), np.sqrt(a2 * a2 + b2 * b2)


@compiled
def hue_difference_and_mean(hues: Floats, chroma: Floats) -> None:
    """Put half the hue difference and the mean hue, on the circle, in place of two hues in -pi..pi, (2, pixels).

    A grey has no hue, so that the sum stands for the mean.
    """
    for pixel in range(hues.shape[1]):
        h1, h2 = hues[0, pixel], hues[1, pixel]
        h1 += 2.0 * np.pi if h1 < 0.0 else 0.0
        h2 += 2.0 * np.pi if h2 < 0.0 else 0.0
        difference, total = h2 - h1, h1 + h2
        mean = total
        if abs(difference) > np.pi:
            mean += 2.0 * np.pi if total < 2.0 * np.pi else -2.0 * np.pi
            difference += -2.0 * np.pi if difference > 0.0 else 2.0 * np.pi
        hues[0, pixel] = difference / 2.0
        hues[1, pixel] = total if chroma[0, pixel] * chroma[1, pixel] == 0.0 else mean / 2.0


@compiled
def difference_of_terms(
    first: Floats, second: Floats, chroma: Floats, sine_half: Floats, cosine: Floats, sine: Floats, turn: Floats,
    result: Floats,
) -> None:  # fmt: skip
    """Put CIEDE2000 into the result, (pixels,), from L* and C' of both colours and the sines and cosines of the hues.

    Of half the hue difference, of the mean hue, and of the rotation angle 60 deg exp(-((h - 275 deg) / 25 deg)^2).
    Multiples of the mean hue come from its cosine and sine.
    """
    for pixel in range(result.shape[0]):
        l1, l2, c1, c2 = first[0, pixel], second[0, pixel], chroma[0, pixel], chroma[1, pixel]
        c, s = cosine[pixel], sine[pixel]
        double, double_sine = 2.0 * c * c - 1.0, 2.0 * s * c
        triple, triple_sine = c * (2.0 * double - 1.0), s * (2.0 * double + 1.0)
        weight = (
            1.0
            - 0.17 * (c * _COS_30 + s * _SIN_30)
            + 0.24 * double
            + 0.32 * (triple * _COS_6 - triple_sine * _SIN_6)
            - 0.20 * ((2.0 * double * double - 1.0) * _COS_63 + 2.0 * double_sine * double * _SIN_63)
        )
        mean, from_grey = (c1 + c2) / 2.0, (l1 + l2) / 2.0 - 50.0
        seventh = mean * mean * mean * mean * mean * mean * mean
        lightness = (l2 - l1) / (1.0 + 0.015 * from_grey * from_grey / np.sqrt(20.0 + from_grey * from_grey))
        chroma_term = (c2 - c1) / (1.0 + 0.045 * mean)
        hue = 2.0 * np.sqrt(c1 * c2) * sine_half[pixel] / (1.0 + 0.015 * mean * weight)
        rotation = -2.0 * np.sqrt(seventh / (seventh + _CHROMA_SCALE_7)) * turn[pixel]
        square = lightness * lightness + chroma_term * chroma_term + hue * hue + rotation * chroma_term * hue
        # The form is positive definite but can round below zero for equal colours.
        result[pixel] = np.sqrt(max(square, 0.0))
