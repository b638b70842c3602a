"""Paint calibration: the fitted emission spectrum with its uncertainty."""

from collections.abc import Mapping
from typing import Annotated, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from data_schemas.arrays import ArraySpec, check_dimensions
from data_schemas.colour_checker import ColourCheckerMatch
from data_schemas.emission_detection import NO_SPECTRUM, EmissionDetection
from data_schemas.estimate import Estimate
from data_schemas.model import Model, Record
from data_schemas.radiometry import Optics
from data_schemas.reradiation import Reradiation
from data_schemas.units import Fraction, WavelengthNm

Floats = NDArray[np.float64]
Curve = Annotated[Floats, ArraySpec("<f8", ("wavelength",))]
FamilyCurves = Annotated[Floats, ArraySpec("<f8", ("family", "wavelength"))]
SamplingMethod = Literal["importance sampling", "adapted importance sampling", "resample-move", "emcee"]


class ChainCheck(Model):
    """A run of emcee: the fallback of importance sampling, or the independent check of it."""

    walkers: int
    steps: int
    converged: bool = Field(
        description="longer than 50 autocorrelation times, R-hat at most 1.01, 400 effective samples"
    )
    acceptance_fraction: float
    autocorrelation_time: dict[str, float]
    r_hat: dict[str, float] = Field(description="rank-normalised split R-hat, bulk and folded")
    effective_samples: dict[str, float]
    mean_shift_sd: dict[str, float] = Field(
        description="difference of the posterior means to the stored draws, in posterior standard deviations; empty "
        "where emcee made the draws itself"
    )


class Diagnostics(Model):
    """Whether the draws deserve trust."""

    method: SamplingMethod
    trusted: bool = Field(
        description="importance sampling: Pareto k at most 0.7 and 800 effective draws; resample-move: memory at most "
        "0.15; emcee: converged"
    )
    pareto_k: float | None = Field(description="shape of the weights' tail; none where it cannot be estimated")
    effective_samples: float = Field(description="of moved draws: how many of them differ")
    ln_evidence: float
    ln_evidence_sd: float
    maxima: tuple[float, ...] = Field(description="log posterior of the distinct maxima that were found, best first")
    memory: Fraction | None = Field(
        default=None,
        description="of moved draws: largest correlation with what they were before the last moves (ranks of "
        "parameters and of the density, place among the maxima)",
    )
    chain: ChainCheck | None = Field(default=None, description="emcee, where it took over or was asked for as a check")


class BandResidual(Model):
    """How well the fit explains one filter (three channels together)."""

    filter_name: str
    center_nm: WavelengthNm
    chi_square: float
    degrees_of_freedom: int
    posterior_predictive_p: Fraction
    explained: bool = Field(description="False where the posterior predictive p is below 0.01")
    calibration_pull: Estimate = Field(
        description="posterior of the filter's calibration error in prior standard deviations"
    )


class DiscrepancySettings(Model):
    """Hyper-parameters of the discrepancy between paint and family."""

    amplitude_rel: Fraction
    length_nm: float
    floor_rel: Fraction
    reabsorption_rel: Fraction
    origin: str


class FamilyResult(Model):
    """What one family of emission curves makes of the same bands."""

    name: str
    title: str
    with_discrepancy: bool
    quantities: dict[str, Estimate] = Field(description="mode_nm, fwhm_nm, skew, peak_per_nm, energy_yield")
    ln_evidence: float
    ln_evidence_sd: float
    probability: Fraction | None = Field(
        description="among the families with discrepancy, all equally likely beforehand; none without discrepancy"
    )
    left_out_bands: float | None = Field(description="sum of ln p(band | other bands), nats; higher predicts better")
    left_out_bands_sd: float | None = Field(description="standard error of its difference to the default family's")
    left_out_pareto_k: float | None = Field(
        description="largest over the bands, none where it cannot be estimated; above 0.5 the sum is only "
        "indicative, and too high"
    )
    chi_square: float
    method: SamplingMethod
    pareto_k: float | None = Field(description="none where it cannot be estimated")


class PriorSensitivity(Model):
    """Shift of a posterior mean, in its standard deviations, when all priors are made half and twice as wide."""

    halved: float
    doubled: float


class PaintCalibration(Record):
    """Emission spectrum of one paint with its uncertainty.

    The emission is a bispectral radiance factor per nm for excitation at the laser line (nm^-1): a curve of the
    family plus the discrepancy. ``paper`` holds the paper's skew-Cauchy without discrepancy, in its symbols:
    location_nm = lambda_0 (not the peak), scale_nm = gamma, skewness = omega, amplitude_nm = h.
    """

    schema_version: ClassVar[int] = 5
    written_by: ClassVar[str] = "'finray fit'"
    other_kinds: ClassVar[Mapping[str, str]] = {"PaintWithoutEmission": NO_SPECTRUM}

    paint_name: str
    detection: EmissionDetection | None = Field(
        default=None, description="that there is emission, and how sure that is; none: not judged, by an older version"
    )
    family: str
    family_title: str
    family_choice: str = Field(description="why this family, and how sure that is")
    discrepancy: DiscrepancySettings
    parameters: dict[str, Estimate] = Field(description="quantities of the emission, then the sampled parameters")
    paper: dict[str, Estimate]
    prior: dict[str, str] = Field(description="prior of each sampled parameter, in words")
    prior_sensitivity: dict[str, PriorSensitivity]
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
    emission_draws_per_nm: Annotated[Floats, ArraySpec("<f8", ("curve draw", "wavelength"), "1/nm")]
    energy_yield: Estimate = Field(description="emitted over incident energy, emission above the laser line to 780 nm")
    band_integrals: tuple[Estimate, ...] = Field(
        description="emission through each filter: integral of emission times transmission over that of transmission"
    )
    families: tuple[FamilyResult, ...]
    family_emission_per_nm: FamilyCurves
    family_low95_per_nm: FamilyCurves
    family_high95_per_nm: FamilyCurves
    reflectance: tuple[Estimate, ...] = Field(description="non-fluorescent reflectance at each filter")
    reflectance_method: str
    colour_match: ColourCheckerMatch | None = None
    reradiation: Reradiation
    optics: Optics
    usable: Annotated[NDArray[np.bool_], ArraySpec("|b1", ("filter", "3"))]
    measured: Annotated[Floats, ArraySpec("<f8", ("filter", "3"))]
    measured_sd: Annotated[Floats, ArraySpec("<f8", ("filter", "3"))]
    predicted: Annotated[Floats, ArraySpec("<f8", ("filter", "3"))]
    predicted_sd: Annotated[Floats, ArraySpec("<f8", ("filter", "3"))]
    bands: tuple[BandResidual, ...]
    chi_square: float
    usable_values: int = Field(ge=0, description="number of band values that entered the fit")
    diagnostics: Diagnostics
    warnings: tuple[str, ...] = ()

    @model_validator(mode="after")
    def _lengths_agree(self) -> "PaintCalibration":
        along_filters = dict.fromkeys(("optics.filters", "bands", "reflectance", "band_integrals"), "filter")
        check_dimensions(self, {"sampled": "parameter", "families": "family", **along_filters})
        return self
