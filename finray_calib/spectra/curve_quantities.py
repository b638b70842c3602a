"""The quantities that every emission curve has, whatever its family: mode, width, skew, peak, area."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

YIELD_END_NM = 780.0
"""The energy yield is counted up to here, nm: the end of the visible."""


@dataclass(frozen=True, slots=True)
class CurveQuantities:
    """Quantities of n curves, each (n,).

    Attributes
    ----------
    mode_nm
        Wavelength of the maximum, nm.
    fwhm_nm
        Full width between the half-maximum crossings nearest to the mode on either side, nm.
    skew
        (red half width - blue half width) / FWHM, -1 to 1; positive for a tail towards long wavelengths.
    peak_per_nm
        Height of the maximum, nm^-1.
    energy_yield
        Integral up to 780 nm: emitted over incident energy relative to a perfect white.
    """

    mode_nm: FloatArray
    fwhm_nm: FloatArray
    skew: FloatArray
    peak_per_nm: FloatArray
    energy_yield: FloatArray


def curve_quantities(curves: FloatArray, wavelength_nm: FloatArray) -> CurveQuantities:
    """Return the quantities of curves sampled on a fine, even grid.

    The maximum is that of the parabola through the highest sample and its neighbours, the half-maximum crossings
    are linear between samples; where a curve does not fall to half within the grid, the grid's end counts.

    Parameters
    ----------
    curves
        (n, L) curves of 0 or more, nm^-1.
    wavelength_nm
        (L,) even grid, nm.
    """
    rows, step = np.arange(len(curves)), float(wavelength_nm[1] - wavelength_nm[0])
    top = np.clip(curves.argmax(axis=1), 1, len(wavelength_nm) - 2)
    left, middle, right = (curves[rows, top + offset] for offset in (-1, 0, 1))
    bend = left - 2 * middle + right
    inside = bend < 0
    shift = np.clip(np.where(inside, 0.5 * (left - right) / np.where(inside, bend, -1.0), 0.0), -1.0, 1.0)
    peak = middle - 0.25 * (left - right) * shift
    mode = wavelength_nm[top] + shift * step
    red = _crossing(curves, top, peak / 2, 1) * step + wavelength_nm[0]
    blue = _crossing(curves, top, peak / 2, -1) * step + wavelength_nm[0]
    width = red - blue
    skew = (red + blue - 2 * mode) / np.where(width > 0, width, 1.0)
    counted = wavelength_nm <= YIELD_END_NM
    area = np.trapezoid(curves[:, counted], wavelength_nm[counted], axis=1)
    return CurveQuantities(mode, width, skew, peak, np.asarray(area))


def _crossing(curves: FloatArray, top: NDArray[np.intp], half: FloatArray, direction: int) -> FloatArray:
    """Return the fractional sample where each curve first falls to half on one side of its top, (n,)."""
    count = curves.shape[1]
    samples = np.arange(count)
    beyond = (samples - top[:, None]) * direction > 0
    below = beyond & (curves < half[:, None])
    order = below if direction > 0 else below[:, ::-1]
    first = order.argmax(axis=1)
    first = first if direction > 0 else count - 1 - first
    rows = np.arange(len(curves))
    low, high = curves[rows, first], curves[rows, np.clip(first - direction, 0, count - 1)]
    fraction = (half - low) / np.where(high > low, high - low, 1.0)
    end = count - 1 if direction > 0 else 0
    return np.where(below.any(axis=1), first - direction * np.clip(fraction, 0.0, 1.0), float(end))
