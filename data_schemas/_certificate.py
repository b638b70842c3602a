"""What a laboratory adds to the certificate of a paint (TOML): for whom, under which conditions, its references."""

from typing import Annotated, Final, Literal

from pydantic import Field, model_validator

from data_schemas._model import Model, Record
from data_schemas._rig import IsoDay

CertifiedName = Literal["mode_nm", "fwhm_nm", "peak_per_nm", "energy_yield", "reflectance_at_laser"]
CERTIFIED: Final[dict[CertifiedName, tuple[str, str]]] = {
    "mode_nm": ("Wavelength of the maximum of the emission", "nm"),
    "fwhm_nm": ("Full width at half maximum", "nm"),
    "peak_per_nm": ("Emission at the maximum, as radiance factor per nm", "1/nm"),
    "energy_yield": ("Energy yield: emitted over incident energy", ""),
    "reflectance_at_laser": ("Reflectance at the laser line", ""),
}
"""Quantity -> what it is, and its unit."""
Reference = Literal["white reference", "filters", "lamp", "camera response", "laser", "other"]
Line = Annotated[str, Field(max_length=300)]


class ReferenceCertificate(Model):
    """A certificate of calibration that the laboratory holds for a part of its rig."""

    of: Reference
    number: Annotated[str, Field(min_length=1, max_length=300)] = Field(description="of the certificate")
    issued_by: Annotated[str, Field(min_length=1, max_length=300)]
    calibrated_on: IsoDay
    valid_until: IsoDay | None = Field(default=None, description="none: the certificate states no such day")


class CertifiedLimits(Model):
    """What a quantity must keep, for a statement of conformity; in the unit of the quantity."""

    quantity: CertifiedName
    low: float | None = Field(default=None, allow_inf_nan=False)
    high: float | None = Field(default=None, allow_inf_nan=False)

    @model_validator(mode="after")
    def _limits_are_in_order(self) -> "CertifiedLimits":
        if self.low is None and self.high is None:
            raise ValueError("give low, high or both: without a limit there is nothing to conform to")
        if self.low is not None and self.high is not None and self.low > self.high:
            raise ValueError(f"low = {self.low:g} must not be above high = {self.high:g}")
        return self


class CertificateDetails(Record):
    """What stands on a certificate beside what finray measured; all of it may be left out."""

    kind: Literal["certificate"] = "certificate"
    laboratory: Line = ""
    address: Line = ""
    number: Line = Field(default="", description="of the certificate; left out: made from the record's SHA-256")
    customer: Line = ""
    item: Line = Field(default="", description="what was measured: tin, batch, coat, substrate")
    conditions: Line = Field(default="", description="temperature and humidity with their uncertainty, and what else")
    authorised_by: Line = ""
    references: tuple[ReferenceCertificate, ...] = ()
    limits: tuple[CertifiedLimits, ...] = ()

    @model_validator(mode="after")
    def _limits_once(self) -> "CertificateDetails":
        names = [limit.quantity for limit in self.limits]
        if twice := sorted({name for name in names if names.count(name) > 1}):
            raise ValueError(f"limits: {twice[0]!r} is given twice; give each quantity once")
        return self
