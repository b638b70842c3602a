"""One band-pass filter of the rig: what a catalogue, a certificate or a measured curve says of it."""

from collections.abc import Callable
from typing import Annotated, Any

from pydantic import Field

from data_schemas.model import Model
from data_schemas.units import OpticalDensity, WavelengthNm, WidthNm

# A band-pass of a catalogue: centre within 1.5 nm and width within 1 nm of nominal, evenly likely: 1.5 / sqrt(3) and
# 1 / sqrt(3), rounded up. A spectrophotometer's wavelength scale is good to 0.15 nm, and so is a certificate.
CATALOGUE_CENTER_NM, CATALOGUE_FWHM_NM, MEASURED_CURVE_NM = 0.9, 0.6, 0.15


def _where_none_is_given(catalogue_nm: float) -> Callable[[dict[str, Any]], float]:
    """Return the standard uncertainty (nm) of a filter's centre or width for a measured curve or a catalogue's data."""
    return lambda given: catalogue_nm if given.get("curve") is None else MEASURED_CURVE_NM


def _uncertainty_text(catalogue_nm: float) -> str:
    """Say which standard uncertainty holds where none is given."""
    return (
        f"standard uncertainty; left out: {catalogue_nm:g} nm for a filter known from a catalogue only, "
        f"{MEASURED_CURVE_NM:g} nm with a measured curve. Give the value of a certificate"
    )


FilterUncertaintyNm = Annotated[float, Field(ge=0.0, le=10.0, json_schema_extra={"unit": "nm"})]


class BandPassFilter(Model):
    """One filter of the wheel; slots count from 1.

    Nominal transmission: ``peak 2^(-|2 (l - center) / fwhm|^(2 shape_order)) + 10^-OD``. A measured curve takes its
    place; centre and width are then labels, and shape and peak are not used.
    The fitter carries the standard uncertainties; those of centre and width shift and stretch a measured curve.
    """

    slot: Annotated[int, Field(ge=1, le=64)]
    name: str
    curve: str | None = Field(
        default=None,
        description="CSV file of the measured transmission (0 to 1) with the header wavelength_nm,transmission, over "
        "the range in which it stands above the instrument's noise; its centre must lie within 5 nm of center_nm",
    )
    center_nm: WavelengthNm
    center_uncertainty_nm: FilterUncertaintyNm = Field(
        default_factory=_where_none_is_given(CATALOGUE_CENTER_NM), description=_uncertainty_text(CATALOGUE_CENTER_NM)
    )
    fwhm_nm: WidthNm = 10.0
    fwhm_uncertainty_nm: FilterUncertaintyNm = Field(
        default_factory=_where_none_is_given(CATALOGUE_FWHM_NM), description=_uncertainty_text(CATALOGUE_FWHM_NM)
    )
    shape_order: Annotated[float, Field(ge=1.0, le=10.0, description="1 Gaussian, 2 hard-coated flat top")] = 2.0
    peak_transmission: Annotated[float, Field(gt=0.0, le=1.0)] = 0.6
    blocking_od: OpticalDensity = Field(
        default=5.0, description="floor of the transmission, also of a measured curve, and all of it outside its range"
    )
    blocking_uncertainty_od: Annotated[float, Field(ge=0.0, le=3.0, json_schema_extra={"unit": "1"})] = 0.2
