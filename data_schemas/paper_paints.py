"""The paper's statements on its paints, tested on measured materials."""

from typing import Annotated, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from data_schemas.arrays import ArraySpec, check_dimensions
from data_schemas.curves import SpectralCurve
from data_schemas.estimate import Estimate
from data_schemas.fit import SamplingMethod
from data_schemas.model import Model, Record
from data_schemas.reradiation import Reradiation
from data_schemas.units import Fraction, WavelengthNm

Floats = NDArray[np.float64]
OverEmission = Annotated[Floats, ArraySpec("<f8", ("wavelength",), "1/nm")]
PaintColour = Literal["red", "green"]
Verdict = Literal["holds", "holds in part", "does not hold", "cannot be tested"]


class CurveFit(Model):
    """One family of curves fitted by least squares to all of a measured emission or absorption."""

    family: str
    parameters: dict[str, float]
    mode_nm: WavelengthNm
    fwhm_nm: float
    curve: SpectralCurve
    residual_rel: float = Field(description="norm of the difference to the whole measured curve over its norm")


class BandFit(Model):
    """Posterior of a whole emission from eight filter bands in three channels, judged by the measured emission."""

    family: str
    with_discrepancy: bool = Field(description="whether the paint may leave the family's curve")
    parameters: dict[str, Estimate] = Field(description="mode_nm and fwhm_nm; of the paper's family also its own")
    wavelength_nm: Annotated[Floats, ArraySpec("<f8", ("wavelength",), "nm")]
    mean_per_nm: OverEmission
    low95_per_nm: OverEmission
    high95_per_nm: OverEmission
    residual_rel: float = Field(description="norm of the mean's difference to the measured emission over its norm")
    covered_share: Fraction = Field(
        description="share of the measured samples above 5 % of the peak within the pointwise 95 % band"
    )
    method: SamplingMethod
    trusted: bool = Field(description="whether the draws support 95 % limits")

    @model_validator(mode="after")
    def _lengths_agree(self) -> "BandFit":
        check_dimensions(self)
        return self


class ColourPatch(Model):
    """Distance of a ColorChecker patch from a measured reflectance."""

    name: str
    error_rel: float = Field(description="norm of the difference over the norm of the measured reflectance")


class PaintStandIn(Model):
    """What a measured material says about the quantities that the paper states for a paint."""

    colour: PaintColour
    material: str
    source: str
    emission: SpectralCurve = Field(description="radiance factor per nm under the laser line (nm^-1)")
    absorption: SpectralCurve = Field(description="photons absorbed, relative to the laser line")
    emission_peak_nm: WavelengthNm
    absorption_peak_nm: WavelengthNm
    stokes_shift_nm: float = Field(description="maximum of emission minus maximum of absorption")
    stokes_shift_low_nm: float = Field(description="the same to the longest wavelength on the absorption plateau")
    stokes_shift_high_nm: float = Field(description="the same to the shortest wavelength on the absorption plateau")
    printed_stokes_shift_nm: float
    absorption_edge_nm: WavelengthNm = Field(description="where absorption has fallen to half, towards the red")
    laser_absorption_factor: float = Field(description="a(laser) / maximum")
    filter_bands: dict[str, float] = Field(description="radiance factor in the band of each filter, per 10 nm")
    energy_yield: float = Field(description="emitted over incident energy, laser line to 780 nm")
    photon_yield: float = Field(description="emitted over incident photons")
    printed_patch: ColourPatch
    closest_patch: ColourPatch
    paper_curve: CurveFit = Field(description="the paper's family, whole emission seen")
    our_curve: CurveFit = Field(description="our default family, whole emission seen")
    absorption_curve: CurveFit = Field(description="the paper's family, whole absorption seen")
    paper_fit: BandFit = Field(description="emission from the filter bands, the paper's family alone")
    our_fit: BandFit = Field(description="emission from the filter bands, our default family with discrepancy")
    one_laser: Reradiation = Field(description="our absorption from the yield under the laser alone")
    several_lights: Reradiation = Field(description="our absorption from the yields under several lights")


class PaperStatement(Model):
    """One statement of the paper beside what the stand-ins say."""

    subject: str
    paper: str
    measure: str = Field(description="what is given for each stand-in")
    ours: dict[str, str] = Field(description="by material")
    verdict: Verdict
    why: str


class PaperPaints(Record):
    """The paper's statements on its two paints, and ours on measured stand-ins."""

    schema_version: ClassVar[int] = 2
    written_by: ClassVar[str] = "'finray study paper-paints'"

    laser_nm: WavelengthNm
    stand_ins: tuple[PaintStandIn, ...]
    statements: tuple[PaperStatement, ...]
    caveat: str
