"""Absorption of a paint and its Stokes shift."""

from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from data_schemas.arrays import ArraySpec, check_dimensions
from data_schemas.estimate import Estimate
from data_schemas.model import Model
from data_schemas.units import Fraction, WavelengthNm

Floats = NDArray[np.float64]
OverExcitation = Annotated[Floats, ArraySpec("<f8", ("excitation",))]


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
    prior_driven: bool = Field(
        description="True while the Stokes shift is hardly narrower than its prior: too little was measured"
    )
    prior: dict[str, str] = Field(description="prior of each parameter in words, with its origin")
    distinct_shapes: int = Field(ge=0, description="effective number of absorption shapes among the weighted ones")
    rejected_share: Fraction = Field(description="share of draws replaced: they emitted more than the paint absorbs")
    violating_share: Fraction = Field(description="share of draws kept although they emit more than the paint absorbs")
    statement: str = Field(description="what the measurement fixes and what stays belief")

    @model_validator(mode="after")
    def _lengths_agree(self) -> "Reradiation":
        check_dimensions(self)
        return self
