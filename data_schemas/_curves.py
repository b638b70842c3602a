"""Spectral curves and re-radiation (Donaldson) matrices with their range, uncertainty and source.

A curve is never silently extrapolated: outside its range it holds its end value with a stated uncertainty.
:meth:`SpectralCurve.share_outside` tells how much of a band's weight lies outside; more than
:data:`LARGEST_SHARE_OUTSIDE` is refused by :func:`require_coverage`.

The measured transmission of a band-pass filter must agree with the filter that names it. It holds over its range and
never falls below the filter's blocking floor; outside its range it does not hold its end value, as other curves do:
the floor holds there.
"""

from collections.abc import Iterable, Mapping
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field, field_validator, model_validator

from data_schemas._model import Model
from data_schemas._rig import BandPassFilter
from data_schemas._units import ArraySpec, RelativeUncertainty
from data_schemas.errors import CurveError

Floats = NDArray[np.float64]
LARGEST_SHARE_OUTSIDE = 0.20
EXTRAPOLATION_UNCERTAINTY_REL = 0.5


def _increasing(wavelength_nm: Floats) -> Floats:
    """Check a wavelength axis: at least two values, strictly increasing, 200..2500 nm."""
    if len(wavelength_nm) < 2:
        raise ValueError(f"needs at least 2 wavelengths, got {len(wavelength_nm)}")
    steps = np.diff(wavelength_nm)
    if (steps <= 0).any():
        at = int(np.argmax(steps <= 0))
        raise ValueError(
            f"wavelengths must increase from row to row: {wavelength_nm[at + 1]:g} nm follows "
            f"{wavelength_nm[at]:g} nm; sort the rows and remove repeats"
        )
    if wavelength_nm[0] < 200 or wavelength_nm[-1] > 2500:
        raise ValueError(
            f"wavelengths must lie within 200 to 2500 nm, got {wavelength_nm[0]:g} to {wavelength_nm[-1]:g}; check "
            "that they are in nm"
        )
    return wavelength_nm


class SpectralCurve(Model):
    """A quantity sampled over wavelength, linear between samples.

    Attributes
    ----------
    name, source
        What it is and where it comes from (file, data sheet, "assumed").
    uncertainty_rel
        Standard uncertainty relative to the value, common to all wavelengths: a scale, which cancels wherever a
        signal is referred to white in the same band.
    """

    name: str
    wavelength_nm: Annotated[Floats, ArraySpec("<f8", ("wavelength",), "nm")]
    values: Annotated[Floats, ArraySpec("<f8", ("wavelength",))]
    uncertainty_rel: RelativeUncertainty = 0.0
    source: str

    _check_axis = field_validator("wavelength_nm")(_increasing)

    @model_validator(mode="after")
    def _same_length(self) -> "SpectralCurve":
        if len(self.values) != len(self.wavelength_nm):
            raise ValueError(f"{len(self.values)} values for {len(self.wavelength_nm)} wavelengths")
        return self

    def __call__(self, wavelength_nm: ArrayLike) -> Floats:
        """Return the curve at `wavelength_nm`; outside its range it holds its end value."""
        x = np.asarray(wavelength_nm, dtype=float)
        values: Floats = np.interp(x, self.wavelength_nm, self.values)
        return values

    def share_outside(self, wavelength_nm: ArrayLike, weight: ArrayLike) -> float:
        """Return the share of a band's weight that lies outside the range of the curve (0..1)."""
        x, w = np.asarray(wavelength_nm, dtype=float), np.asarray(weight, dtype=float)
        outside = (x < self.wavelength_nm[0]) | (x > self.wavelength_nm[-1])
        return float(w[outside].sum() / w.sum())


def require_coverage(curve: SpectralCurve, wavelength_nm: ArrayLike, weight: ArrayLike, band: str) -> str | None:
    """Refuse a curve that misses more than 20 % of a band's weight; return a note when it misses any.

    Raises
    ------
    CurveError
        More than 20 % of the band's weight lies outside the curve.
    """
    share = curve.share_outside(wavelength_nm, weight)
    if share <= 1e-4:
        return None
    span = f"{curve.wavelength_nm[0]:g} to {curve.wavelength_nm[-1]:g} nm"
    if share > LARGEST_SHARE_OUTSIDE:
        raise CurveError(
            f"{curve.source}: curve '{curve.name}' covers only {span}, and {100 * share:.0f} % of the weight of {band} "
            f"lies outside (at most {100 * LARGEST_SHARE_OUTSIDE:.0f} % is allowed); give a curve that covers the band"
        )
    return (
        f"{curve.name} covers only {span}; outside, where {100 * share:.1f} % of the weight of {band} lies, its end "
        f"value is used with a relative uncertainty of {EXTRAPOLATION_UNCERTAINTY_REL:g}"
    )


class DonaldsonMatrix(Model):
    """Bispectral radiance factor per nm of emission: rows are emission, columns excitation wavelengths.

    The diagonal of a measured matrix (excitation = emission) is reflectance and is kept apart here:
    ``reflectance`` (dimensionless) and ``radiance_factor_per_nm`` with a zero diagonal (nm^-1).
    """

    name: str
    emission_nm: Annotated[Floats, ArraySpec("<f8", ("emission",), "nm")]
    excitation_nm: Annotated[Floats, ArraySpec("<f8", ("excitation",), "nm")]
    radiance_factor_per_nm: Annotated[Floats, ArraySpec("<f8", ("emission", "excitation"), "1/nm")]
    reflectance: SpectralCurve
    source: str = Field(description="file or origin")

    _check_axes = field_validator("emission_nm", "excitation_nm")(_increasing)

    @model_validator(mode="after")
    def _shapes_agree(self) -> "DonaldsonMatrix":
        wanted = (len(self.emission_nm), len(self.excitation_nm))
        if self.radiance_factor_per_nm.shape != wanted:
            raise ValueError(
                f"radiance_factor_per_nm has shape {self.radiance_factor_per_nm.shape}, but must have shape "
                f"(emission, excitation) = {wanted}"
            )
        return self

    def emission_at(self, excitation_nm: float) -> SpectralCurve:
        """Return the emission per nm for light at `excitation_nm`, interpolated between columns."""
        if not self.excitation_nm[0] <= excitation_nm <= self.excitation_nm[-1]:
            raise CurveError(
                f"{self.source}: the matrix has no data for excitation at {excitation_nm:g} nm; it covers only "
                f"{self.excitation_nm[0]:g} to {self.excitation_nm[-1]:g} nm"
            )
        columns = self.radiance_factor_per_nm
        values = np.array([np.interp(excitation_nm, self.excitation_nm, row) for row in columns])
        return SpectralCurve(
            name=f"{self.name}, emission for {excitation_nm:g} nm",
            wavelength_nm=self.emission_nm,
            values=values,
            source=self.source,
        )


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
            f"{curve.source}: the curve ({curve.wavelength_nm[0]:g} to {curve.wavelength_nm[-1]:g} nm) does not fall "
            "to 50 % of its peak on both sides; give a curve of the whole pass band"
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
            f"{curve.source}: the pass band is centred at {center_nm:.4g} nm, but filter {band.name} has center_nm = "
            f"{band.center_nm:g}, and they may differ by at most {LARGEST_CENTER_DIFFERENCE_NM:g} nm; correct "
            "center_nm, or give the curve of this filter"
        )
    require_coverage(curve, *_nominal_pass_band(band), f"filter {band.name}")
    return (
        f"filter {band.name}: transmission measured ({curve.source}), half of its peak at {low_nm:.2f} and "
        f"{high_nm:.2f} nm; blocking_od is used below 10^-{band.blocking_od:g} and outside {curve.wavelength_nm[0]:g} "
        f"to {curve.wavelength_nm[-1]:g} nm"
    )


def coverage_notes(
    filters: Iterable[BandPassFilter], filter_curves: Mapping[str, SpectralCurve], curves: Iterable[SpectralCurve]
) -> tuple[str, ...]:
    """Check that every curve covers every filter's pass band, measured or nominal; name end values that are held.

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
        raise ValueError(f"filter_curves: {name!r} is not a filter with a curve assigned to it")
