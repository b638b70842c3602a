"""Measured transmissions of band-pass filters: how they must agree with the filters that name them.

A measured transmission holds over its range and never falls below the filter's blocking floor; outside its range it
does not hold its end value, as other curves do: the floor holds there.
"""

from collections.abc import Iterable, Mapping

import numpy as np
from numpy.typing import NDArray

from data_schemas.band_pass_filter import BandPassFilter
from data_schemas.curves import SpectralCurve, require_coverage
from data_schemas.errors import CurveError

Floats = NDArray[np.float64]
LARGEST_CENTER_DIFFERENCE_NM = 5.0
_NOMINAL_HALF_WIDTHS: Floats = np.linspace(-4.0, 4.0, 401)


def half_maximum_nm(curve: SpectralCurve) -> tuple[float, float]:
    """Return where a pass band crosses half of its peak, left and right of it (nm).

    Valid for one pass band; the outermost crossings count, so that ripple in its top does not matter.

    Raises
    ------
    CurveError
        The curve does not fall to half of its peak on both sides.
    """
    above = np.flatnonzero(curve.values >= 0.5 * curve.values.max())
    first, last = int(above[0]), int(above[-1])
    if first == 0 or last == len(curve.values) - 1:
        raise CurveError(
            f"{curve.source}: the curve from {curve.wavelength_nm[0]:g} to {curve.wavelength_nm[-1]:g} nm does not "
            "fall to 50% of its peak on both sides; give the whole pass band"
        )
    return _crossing_nm(curve, first, first - 1), _crossing_nm(curve, last, last + 1)


def _crossing_nm(curve: SpectralCurve, inside: int, outside: int) -> float:
    """Return where the curve is half its peak between two neighbouring samples."""
    x_nm, values = curve.wavelength_nm, curve.values
    share = (0.5 * values.max() - values[outside]) / (values[inside] - values[outside])
    return float(x_nm[outside] + share * (x_nm[inside] - x_nm[outside]))


def _nominal_pass_band(band: BandPassFilter) -> tuple[Floats, Floats]:
    """Return wavelengths (nm) over four half widths around a filter's nominal centre and its shape there, 0..1."""
    wavelength_nm = band.center_nm + 0.5 * band.fwhm_nm * _NOMINAL_HALF_WIDTHS
    return wavelength_nm, 2.0 ** -(np.abs(_NOMINAL_HALF_WIDTHS) ** (2.0 * band.shape_order))


def _filter_curve_note(band: BandPassFilter, curve: SpectralCurve) -> str:
    """Check a measured transmission against the nominal data of its filter and say what holds where.

    Raises
    ------
    CurveError
        The curve holds no whole pass band, its centre is more than 5 nm from `center_nm`, or more than 20 % of the
        nominal pass band lies outside its range.
    """
    low_nm, high_nm = half_maximum_nm(curve)
    center_nm = 0.5 * (low_nm + high_nm)
    if abs(center_nm - band.center_nm) > LARGEST_CENTER_DIFFERENCE_NM:
        raise CurveError(
            f"{curve.source}: the pass band has its centre at {center_nm:.4g} nm, but filter {band.name} has "
            f"center_nm = {band.center_nm:g}; they may differ by at most {LARGEST_CENTER_DIFFERENCE_NM:g} nm: correct "
            "center_nm, or name the curve of this filter"
        )
    require_coverage(curve, *_nominal_pass_band(band), f"filter {band.name}")
    return (
        f"filter {band.name}: measured transmission {curve.source}, half of its peak at {low_nm:.2f} and {high_nm:.2f} "
        f"nm; below 10^-{band.blocking_od:g} and outside {curve.wavelength_nm[0]:g} to {curve.wavelength_nm[-1]:g} nm "
        "the blocking_od holds"
    )


def coverage_notes(
    filters: Iterable[BandPassFilter], filter_curves: Mapping[str, SpectralCurve], curves: Iterable[SpectralCurve]
) -> tuple[str, ...]:
    """Check that every curve covers every filter's pass band, measured or nominal, and say what is held.

    Parameters
    ----------
    filters
        Filters of a rig.
    filter_curves
        Measured transmission of those that name one, by the filter's name; checked too.
    curves
        Camera response and lamp.

    Raises
    ------
    CurveError
        More than 20 % of a filter's weight lies outside a curve, or a measured transmission does not agree with its
        filter.
    """
    curves = tuple(curves)
    notes: list[str | None] = []
    for band in filters:
        wavelength_nm, weight = _nominal_pass_band(band)
        measured = filter_curves.get(band.name)
        if measured is not None:
            notes.append(_filter_curve_note(band, measured))
            wavelength_nm = np.linspace(measured.wavelength_nm[0], measured.wavelength_nm[-1], len(wavelength_nm))
            weight = measured(wavelength_nm)
        notes += [require_coverage(curve, wavelength_nm, weight, f"filter {band.name}") for curve in curves]
    return tuple(dict.fromkeys(note for note in notes if note is not None))


def check_named_curves(filters: Iterable[BandPassFilter], curves: Mapping[str, SpectralCurve]) -> None:
    """Refuse curves that are not exactly those which the filters name; for validators of records.

    Raises
    ------
    ValueError
        A filter's curve is missing, or a curve belongs to no filter that names one.
    """
    named = {band.name: band.curve for band in filters if band.curve is not None}
    for name in sorted(named.keys() ^ curves.keys()):
        if name in named:
            raise ValueError(f"filter_curves: the curve {named[name]} of filter {name!r} is missing")
        raise ValueError(f"filter_curves: {name!r} is no filter that names a curve")
