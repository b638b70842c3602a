"""Paint calibration: the fitted emission spectrum with its uncertainty."""

from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from data_schemas.arrays import ArraySpec, check_dimensions
from data_schemas.model import Model, Record
from data_schemas.radiometry import Optics
from data_schemas.units import WavelengthNm

Floats = NDArray[np.float64]
Curve = Annotated[Floats, ArraySpec("<f8", ("wavelength",))]


class Estimate(Model):
    """Posterior summary of one number: median, standard deviation and equal-tailed intervals."""

    estimate: float
    sd: Annotated[float, Field(ge=0.0)]
    low68: float
    high68: float
    low95: float
    high95: float


class Diagnostics(Model):
    """Does the chain deserve trust? R-hat at most 1.01 and at least 400 effective samples, else a warning."""

    walkers: int
    steps: int
    converged: bool = Field(
        description="longer than 50 autocorrelation times, R-hat at most 1.01, 400 effective samples"
    )
    acceptance_fraction: float
    autocorrelation_time: dict[str, float]
    r_hat: dict[str, float]
    effective_samples: dict[str, float]
    maxima: tuple[float, ...] = Field(description="log posterior of the distinct maxima NLopt found, best first")


class BandResidual(Model):
    """How well the fit explains one filter (three channels together)."""

    filter_name: str
    center_nm: WavelengthNm
    chi_square: float
    degrees_of_freedom: int
    posterior_predictive_p: Annotated[float, Field(ge=0.0, le=1.0)]


class PaintCalibration(Record):
    """Emission spectrum of one paint: posterior of the paper's skew-Cauchy family.

    The emission is a bispectral radiance factor per nm for excitation at the laser line (nm^-1). The paper's
    symbols: location_nm = lambda_0 (not the peak), scale_nm = gamma, skewness = omega, amplitude = h.
    """

    paint_name: str
    family: str
    parameters: dict[str, Estimate] = Field(description="sampled and derived quantities by name")
    prior: dict[str, str] = Field(description="prior of each sampled parameter, in words")
    sampled: tuple[str, ...]
    map_estimate: dict[str, float]
    draws: Annotated[Floats, ArraySpec("<f8", ("draw", "parameter"))]
    prior_draws: Annotated[Floats, ArraySpec("<f8", ("prior draw", "parameter"))]
    wavelength_nm: Annotated[Floats, ArraySpec("<f8", ("wavelength",), "nm")]
    emission_per_nm: Curve
    emission_low95_per_nm: Curve
    emission_high95_per_nm: Curve
    emission_low68_per_nm: Curve
    emission_high68_per_nm: Curve
    energy_yield: Estimate = Field(description="emitted over incident energy, emission above the laser line to 780 nm")
    reflectance: tuple[Estimate, ...] = Field(description="non-fluorescent reflectance at each filter")
    reflectance_method: str
    optics: Optics
    usable: Annotated[NDArray[np.bool_], ArraySpec("|b1", ("filter", "3"))]
    measured: Annotated[Floats, ArraySpec("<f8", ("filter", "3"))]
    measured_sd: Annotated[Floats, ArraySpec("<f8", ("filter", "3"))]
    predicted: Annotated[Floats, ArraySpec("<f8", ("filter", "3"))]
    predicted_sd: Annotated[Floats, ArraySpec("<f8", ("filter", "3"))]
    bands: tuple[BandResidual, ...]
    chi_square: float
    degrees_of_freedom: int
    diagnostics: Diagnostics
    warnings: tuple[str, ...] = ()

    @model_validator(mode="after")
    def _lengths_agree(self) -> "PaintCalibration":
        along_filters = dict.fromkeys(("optics.filters", "bands", "reflectance"), "filter")
        check_dimensions(self, {"sampled": "parameter", **along_filters})
        return self
