"""Absorption of a paint and its Stokes shift; and the paper's statements on paints, tested on measured materials."""

from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from data_schemas.arrays import ArraySpec, check_dimensions
from data_schemas.curves import SpectralCurve
from data_schemas.estimate import Estimate
from data_schemas.model import Model, Record
from data_schemas.units import Fraction, WavelengthNm

Floats = NDArray[np.float64]
OverExcitation = Annotated[Floats, ArraySpec("<f8", ("excitation",))]
Verdict = Literal["holds", "holds in part", "does not hold", "cannot be tested"]


class Reradiation(Model):
    """Posterior of what a paint absorbs, relative to the laser line; with the emission it gives the whole matrix.

    The absorptance counts photons. Energy follows as D(out, in) = e(out) a(in)/a(laser) in/laser for out > in,
    with e the emission per nm under the laser.
    """

    excitation_nm: Annotated[Floats, ArraySpec("<f8", ("excitation",), "nm")]
    laser_nm: WavelengthNm
    absorption_rel: OverExcitation = Field(description="posterior mean of a(excitation) / a(laser)")
    low95: OverExcitation
    high95: OverExcitation
    absorption_rel_draws: Annotated[Floats, ArraySpec("<f8", ("draw", "excitation"))] = Field(
        description="paired one to one with the emission draws they were made from"
    )
    stokes_shift_nm: Estimate = Field(description="maximum of emission minus maximum of absorption, nm")
    stokes_shift_draws_nm: Annotated[Floats, ArraySpec("<f8", ("draw",), "nm")]
    measured_at_nm: tuple[WavelengthNm, ...] = Field(description="excitation lights with a measured yield")
    prior_driven: bool = Field(description="True when no light but the laser was measured")
    prior: dict[str, str] = Field(description="prior of each parameter in words, with its origin")
    distinct_shapes: int = Field(ge=0, description="effective number of absorption shapes among the weighted ones")
    rejected_share: Fraction = Field(description="share of draws replaced: they emitted more than the paint absorbs")
    violating_share: Fraction = Field(description="share of draws kept although they emit more than the paint absorbs")
    statement: str = Field(description="what the measurement fixes and what stays belief")

    @model_validator(mode="after")
    def _lengths_agree(self) -> "Reradiation":
        check_dimensions(self)
        return self


class CurveFit(Model):
    """One family of curves fitted by least squares to a measured emission or absorption."""

    family: str
    seen: Literal["whole spectrum", "filter bands"]
    parameters: dict[str, float]
    mode_nm: WavelengthNm
    fwhm_nm: float
    curve: SpectralCurve
    residual_rel: float = Field(description="norm of the difference to the whole measured curve over its norm")


class ColourPatch(Model):
    """Distance of a ColorChecker patch from a measured reflectance."""

    name: str
    error_rel: float = Field(description="norm of the difference over the norm of the measured reflectance")


class PaintStandIn(Model):
    """What a measured material says about the quantities that the paper states for a paint."""

    colour: Literal["red", "green"]
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
    fits: tuple[CurveFit, ...] = Field(description="of the emission")
    absorption_fit: CurveFit
    one_laser: Reradiation = Field(description="our absorption from the yield under the laser alone")
    several_lights: Reradiation = Field(description="our absorption from the yields under several lights")


class PaperStatement(Model):
    """One statement of the paper beside what the stand-ins say."""

    subject: str
    paper: str
    ours: str
    verdict: Verdict
    why: str


class PaperPaints(Record):
    """The paper's statements on its two paints, and ours on measured stand-ins."""

    laser_nm: WavelengthNm
    stand_ins: tuple[PaintStandIn, ...]
    statements: tuple[PaperStatement, ...]
    caveat: str
