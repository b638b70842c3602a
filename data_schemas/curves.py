"""Spectral curves and re-radiation (Donaldson) matrices with their range, uncertainty and source.

A curve is never silently extrapolated: outside its range it holds its end value with a stated uncertainty.
:meth:`SpectralCurve.share_outside` tells how much of a band's weight lies outside; more than
:data:`LARGEST_SHARE_OUTSIDE` is refused by :func:`require_coverage`.
"""

from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field, field_validator, model_validator

from data_schemas.arrays import ArraySpec
from data_schemas.errors import CurveError
from data_schemas.model import Model
from data_schemas.units import RelativeUncertainty

Floats = NDArray[np.float64]
LARGEST_SHARE_OUTSIDE = 0.20
HELD_UNCERTAINTY_REL = 0.5


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
            f"wavelengths must lie within 200 to 2500 nm, got {wavelength_nm[0]:g} to {wavelength_nm[-1]:g}; "
            "are they in nm?"
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
            f"{curve.source}: curve '{curve.name}' covers {span}, but {share:.0%} of the weight of {band} lies "
            f"outside (at most {LARGEST_SHARE_OUTSIDE:.0%} is allowed); give a curve that covers the band"
        )
    return (
        f"{curve.name} covers {span}; its end value is held for {share:.1%} of the weight of {band} with a "
        f"relative uncertainty of {HELD_UNCERTAINTY_REL:g} there"
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
                f"radiance_factor_per_nm has shape {self.radiance_factor_per_nm.shape}, wanted emission x "
                f"excitation = {wanted}"
            )
        return self

    def emission_at(self, excitation_nm: float) -> SpectralCurve:
        """Return the emission per nm for light at `excitation_nm`, interpolated between columns."""
        if not self.excitation_nm[0] <= excitation_nm <= self.excitation_nm[-1]:
            raise CurveError(
                f"{self.source}: no excitation data at {excitation_nm:g} nm; the matrix covers "
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
