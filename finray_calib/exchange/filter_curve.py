"""A measured filter curve reduced to the band-pass model of the rig: centre, width, edge steepness, peak, blocking."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from data_schemas.curve_files import read_table
from data_schemas.errors import CurveError
from data_schemas.rig import BandPassFilter

Floats = NDArray[np.float64]
COLUMNS = ["wavelength_nm", "transmission"]
# Beyond this many widths from the centre a filter only leaks.
_BLOCKED_FWHM = 2.0
_TENTH = 0.1
_SMALLEST_ORDER, _LARGEST_ORDER = 1.0, 10.0
_LARGEST_OD = 12.0


def read_filter_curve(path: Path, slot: int, name: str, blocking_od: float, uncertainty_nm: float) -> BandPassFilter:
    """Read a measured transmission (0..1) and return the band-pass that has its half- and tenth-width, peak and leak.

    The blocking is the mean transmission beyond two widths from the centre where the curve reaches that far, else
    the given one. Valid for one pass band; what the model cannot follow (ripple, skew) is left out.

    Parameters
    ----------
    path
        CSV file with wavelength_nm,transmission.
    slot, name
        Of the filter.
    blocking_od
        Optical density outside the band where the curve does not tell.
    uncertainty_nm
        Standard uncertainty of centre and width.

    Raises
    ------
    CurveError
        The file is no such curve, or holds no whole pass band.
    """
    header, table = read_table(path)
    if header != COLUMNS:
        raise CurveError(f"{path}: header is {','.join(header)[:80]}; a filter needs {','.join(COLUMNS)}")
    wavelength_nm, transmission = table.T
    if (np.diff(wavelength_nm) <= 0).any():
        raise CurveError(f"{path}: wavelengths must increase from row to row; sort the rows and remove repeats")
    if transmission.min() < 0 or transmission.max() > 1:
        raise CurveError(
            f"{path}: transmission runs from {transmission.min():g} to {transmission.max():g}; 0 to 1 is allowed: "
            "divide by 100 if it is in per cent"
        )
    low_nm, high_nm = _edges(path, wavelength_nm, transmission, 0.5)
    center_nm, fwhm_nm = (low_nm + high_nm) / 2, high_nm - low_nm
    tenth_low_nm, tenth_high_nm = _edges(path, wavelength_nm, transmission, _TENTH)
    # T / T_peak = 2^-(x^(2p)) with x = 2 |l - center| / fwhm falls to a tenth where x^(2p) = log2 10
    x = (tenth_high_nm - tenth_low_nm) / fwhm_nm
    order = np.log(np.log2(1 / _TENTH)) / (2 * np.log(x)) if x > 1 else _LARGEST_ORDER
    return BandPassFilter(
        slot=slot,
        name=name,
        center_nm=center_nm,
        center_uncertainty_nm=uncertainty_nm,
        fwhm_nm=fwhm_nm,
        fwhm_uncertainty_nm=uncertainty_nm,
        shape_order=float(np.clip(order, _SMALLEST_ORDER, _LARGEST_ORDER)),
        peak_transmission=float(transmission.max()),
        blocking_od=_blocking_od(wavelength_nm, transmission, center_nm, fwhm_nm, blocking_od),
    )


def _edges(path: Path, wavelength_nm: Floats, transmission: Floats, share: float) -> tuple[float, float]:
    """Return where the curve crosses a share of its peak, left and right of it, nm."""
    peak = int(transmission.argmax())
    level = share * transmission[peak]
    left = np.flatnonzero(transmission[:peak] < level)
    right = np.flatnonzero(transmission[peak:] < level) + peak
    if left.size == 0 or right.size == 0:
        raise CurveError(
            f"{path}: the curve from {wavelength_nm[0]:g} to {wavelength_nm[-1]:g} nm does not fall to {share:.0%} of "
            "its peak on both sides; give the whole pass band"
        )

    def crossing_nm(inside: int, outside: int) -> float:
        rise = (level - transmission[outside]) / (transmission[inside] - transmission[outside])
        return float(wavelength_nm[outside] + rise * (wavelength_nm[inside] - wavelength_nm[outside]))

    return crossing_nm(left[-1] + 1, left[-1]), crossing_nm(right[0] - 1, right[0])


def _blocking_od(
    wavelength_nm: Floats, transmission: Floats, center_nm: float, fwhm_nm: float, otherwise: float
) -> float:
    """Return the optical density of the mean transmission far from the pass band."""
    far = np.abs(wavelength_nm - center_nm) > _BLOCKED_FWHM * fwhm_nm
    leak = float(transmission[far].mean()) if far.any() else 0.0
    return otherwise if leak <= 0 else min(-float(np.log10(leak)), _LARGEST_OD)
