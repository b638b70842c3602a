"""What is fitted to a paint: emission spectrum with its uncertainty, absorption, maps, or that it does not emit.

:class:`PaintCalibration` is the whole, with the posterior of the spectrum, absorption and Stokes shift, and the
reflectance of the ColorChecker patch that looks most like the paint in room light. :class:`PaintMap` holds the
emission pixel by pixel, :class:`PaintWithoutEmission` a sample without emission and what the verdict rests on,
:class:`CertificateDetails` what a laboratory adds to the certificate of a paint.
"""

from collections.abc import Callable, Mapping
from typing import Annotated, Any, ClassVar, Final, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field, model_validator

from data_schemas._capture import RegionOfInterest
from data_schemas._curves import SpectralCurve
from data_schemas._lazy_exports import call_record_method
from data_schemas._model import Estimate, Model, PropagatedDraws, Quantity, Record, propagate_draws
from data_schemas._radiometry import Optics
from data_schemas._rig import IsoDay
from data_schemas._units import ArraySpec, Fraction, WavelengthNm

Floats = NDArray[np.float64]


Patches = Annotated[Floats, ArraySpec("<f8", ("24", "3"), "DN")]
DeltaE = Annotated[float, Field(ge=0.0, description="CIEDE2000", json_schema_extra={"unit": "1"})]


class PatchDistance(Model):
    """How different the paint looks from one patch."""

    patch: str
    delta_e: DeltaE


class ColourCheckerMatch(Model):
    """The paint's colour in the room-light frame, matched to the closest of the 24 patches.

    patches
        All patches, closest first.
    reflectance
        Measured reflectance of the closest patch; its relative uncertainty is that of such a match, as a share of the
        root mean square of the paint's curve.
    reflectance_sd
        The same as a standard uncertainty of the paint's reflectance, equal at all wavelengths.
    at_filters
        The curve averaged over each filter's pass band, with `reflectance_sd`.
    camera_median_delta_e, camera_largest_delta_e
        CIEDE2000 between a patch and its prediction by a camera matrix fitted to the other 23.
    patch_mean_dn, patch_sd_dn, paint_mean_dn
        Linear camera values (dark level removed): mean and standard deviation over the pixels of each patch, and the
        mean over the painted region.
    corners_px
        Corners of the chart (column, row) in pixels of the raw frame, first the one beside "dark skin".
    """

    patches: tuple[PatchDistance, ...] = Field(min_length=24, max_length=24)
    reflectance: SpectralCurve
    reflectance_sd: Annotated[float, Field(ge=0.0, json_schema_extra={"unit": "1"})]
    at_filters: tuple[Estimate, ...]
    camera_median_delta_e: DeltaE
    camera_largest_delta_e: DeltaE
    patch_mean_dn: Patches
    patch_sd_dn: Patches
    paint_mean_dn: Annotated[Floats, ArraySpec("<f8", ("3",), "DN")]
    corners_px: Annotated[Floats, ArraySpec("<f8", ("4", "2"), "px")]
    frame_file: str
    statement: str


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
    stokes_shift_nm: Estimate = Field(
        description="maximum of emission minus last (longest) maximum of absorption, nm; before version 7 of "
        "the record of the paint its prior was narrower, normal(35, 15) nm"
    )
    stokes_shift_draws_nm: Annotated[Floats, ArraySpec("<f8", ("draw",), "nm")]
    measured_at_nm: tuple[WavelengthNm, ...] = Field(description="excitation lights with a measured yield")
    prior_driven: bool = Field(
        description="True where the Stokes shift comes from the prior: one light alone, or a standard "
        "deviation above 15 nm"
    )
    prior: dict[str, str] = Field(description="prior of each parameter in words, with its origin")
    distinct_shapes: int = Field(ge=0, description="effective number of absorption shapes among the weighted ones")
    rejected_share: Fraction = Field(
        description="share of draws that were replaced, because they emitted more than the paint absorbs"
    )
    violating_share: Fraction = Field(
        description="share of draws that emit more than is absorbed at the laser line; at other wavelengths none does"
    )
    statement: str = Field(description="what the measurement determines and what comes from the prior")


NO_SPECTRUM = (
    "'finray fit' found no emission in this sample, so there is no spectrum to simulate, map, compare or export. Give "
    "the fit of a fluorescent paint; if this paint should fluoresce, check its detection limit and the laser, and "
    "measure the paint again"
)
_WHOLE_FROM_SD = 10.0
EmissionVerdict = Literal["emission measured", "no emission"]


class EmissionDetection(Model):
    """Whether band signals hold emission beyond reflected laser, leak and stray light, as ISO 11843 decides."""

    verdict: EmissionVerdict
    statistic_sd: float = Field(
        description="fitted emission / the standard deviation that it has in a sample without emission; the "
        "largest value over many shapes"
    )
    threshold_sd: float = Field(description="value of the statistic that the stated share of simulated blanks exceeds")
    blanks_above: Fraction = Field(description="share of simulated blanks with at least this statistic")
    blanks: int = Field(ge=1, description="number of simulated blanks: same rig and reflectance, no emission")
    false_alarm: Fraction = Field(
        description="share of blanks whose statistic exceeds the threshold, so that emission would be claimed"
    )
    yield_limit: Annotated[float, Field(ge=0.0)] | None = Field(
        description="energy yield that this session would have detected with 95 % probability; none where emission "
        "was measured, because its stray light would add to the limit"
    )
    limit_low_nm: WavelengthNm = Field(
        description="lower end of the modes (peak wavelengths) for which the limit holds"
    )
    limit_high_nm: WavelengthNm = Field(description="upper end of the modes for which the limit holds")

    @property
    def measured(self) -> bool:
        """Whether emission was measured."""
        return self.verdict == "emission measured"

    @property
    def statement(self) -> str:
        """The verdict as one sentence."""
        size = f"{self.statistic_sd:.0f}" if self.statistic_sd >= _WHOLE_FROM_SD else f"{self.statistic_sd:.1f}"
        beyond = (
            f"the signal exceeds reflected laser, leak and stray light by {size} standard deviations (threshold "
            f"{self.threshold_sd:.2g})"
        )
        if self.yield_limit is None:
            return f"{self.verdict}: {beyond}"
        return (
            f"{self.verdict}: the yield is below {self.yield_limit:.2g} with 95 % probability (modes from "
            f"{self.limit_low_nm:.0f} to {self.limit_high_nm:.0f} nm), and {beyond}"
        )


class PaintWithoutEmission(Record):
    """A sample in whose band signals no emission was found: a limit of its yield in place of a spectrum."""

    dimension_of: ClassVar[Mapping[str, str]] = {"optics.filters": "filter", "reflectance": "filter"}
    schema_version: ClassVar[int] = 5
    written_by: ClassVar[str] = "'finray fit'"

    paint_name: str
    detection: EmissionDetection
    reflectance_at_laser: float = Field(
        ge=0.0, description="reflected share of the laser; 1 where the measured value cannot be used"
    )
    reflectance: tuple[Estimate, ...] = Field(description="reflectance at each filter under the lamp")
    optics: Optics
    usable: Annotated[NDArray[np.bool_], ArraySpec("|b1", ("filter", "3"))]
    measured: Annotated[Floats, ArraySpec("<f8", ("filter", "3"))]
    measured_sd: Annotated[Floats, ArraySpec("<f8", ("filter", "3"))]
    blank: Annotated[Floats, ArraySpec("<f8", ("filter", "3"))] = Field(
        description="signals that are expected of a sample with this reflectance that emits nothing; 0 where not usable"
    )
    blank_sd: Annotated[Floats, ArraySpec("<f8", ("filter", "3"))] = Field(
        description="standard deviation of the blank from noise, leaks, tolerances and calibration"
    )
    warnings: tuple[str, ...] = ()


Curve = Annotated[Floats, ArraySpec("<f8", ("wavelength",))]
FamilyCurves = Annotated[Floats, ArraySpec("<f8", ("family", "wavelength"))]
SamplingMethod = Literal["importance sampling", "adapted importance sampling", "resample-move", "emcee"]


class ChainCheck(Model):
    """A run of emcee: the fallback of importance sampling, or the independent check of it."""

    walkers: int
    steps: int
    converged: bool = Field(
        description="True where the chains are longer than 50 autocorrelation times, R-hat is at most 1.01 and "
        "there are 400 effective samples"
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
    """Whether the draws can be trusted."""

    method: SamplingMethod
    trusted: bool = Field(
        description="whether the draws meet their criteria: importance sampling, Pareto k at most 0.7 and 800 "
        "effective draws; resample-move, memory at most 0.15; emcee, converged"
    )
    pareto_k: float | None = Field(description="shape of the weights' tail; none where it cannot be estimated")
    effective_samples: float = Field(description="for moved draws: how many of them are distinct")
    ln_evidence: float
    ln_evidence_sd: float
    maxima: tuple[float, ...] = Field(description="log posterior of the distinct maxima that were found, best first")
    memory: Fraction | None = Field(
        default=None,
        description="for moved draws: largest correlation with their state before the last moves, by ranks of "
        "parameters and density, and by the maximum that a draw belongs to",
    )
    chain: ChainCheck | None = Field(
        default=None, description="run of emcee, where it replaced importance sampling or was requested as a check"
    )


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
        description="probability among the families that include a discrepancy, all equally likely a priori; null for "
        "a family without discrepancy"
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


class PriorShare(Model):
    """How much of a reported quantity comes from the prior."""

    share: Fraction = Field(description="variance after the measurement / variance before it, at most 1")
    shift_sd: float = Field(description="shift of the mean by the measurement, in standard deviations of the prior")

    @property
    def mostly_prior(self) -> bool:
        """Whether more than half of the prior's variance is left."""
        return self.share > MOSTLY_PRIOR_SHARE


MOSTLY_PRIOR_SHARE = 0.5


class SessionScatter(Model):
    """How the sessions of a paint that were combined differ: standard deviations between sessions, and each level."""

    level_rel: Estimate = Field(description="relative standard deviation of the level between sessions")
    filter_rel: Estimate = Field(
        description="relative standard deviation of a single filter between sessions, in addition to that of the level"
    )
    session_levels_rel: tuple[float, ...] = Field(
        min_length=2, description="level of each session relative to the common one, in the order given"
    )
    departing: tuple[Annotated[int, Field(ge=1)], ...] = Field(
        default=(), description="numbers (from 1) of the sessions that differ significantly from the others (p < 0.001)"
    )


class PaintCalibration(Record):
    """Emission spectrum of one paint with its uncertainty.

    The emission is a bispectral radiance factor per nm for excitation at the laser line (nm^-1): draws under the prior
    learned from measured spectra, or curves of a family that was asked for, plus the discrepancy. ``paper`` holds
    the paper's skew-Cauchy without discrepancy, in its symbols:
    location_nm = lambda_0 (not the peak), scale_nm = gamma, skewness = omega, amplitude_nm = h.
    """

    dimension_of: ClassVar[Mapping[str, str]] = {
        "sampled": "parameter",
        "families": "family",
        **dict.fromkeys(("optics.filters", "bands", "reflectance", "band_integrals"), "filter"),
    }
    schema_version: ClassVar[int] = 9
    written_by: ClassVar[str] = "'finray fit'"
    other_kinds: ClassVar[Mapping[str, str]] = {"PaintWithoutEmission": NO_SPECTRUM}
    shown: ClassVar[tuple[str, ...]] = (
        "spectrum_source", "mode_nm", "fwhm_nm", "energy_yield", "reflectance_at_laser", "stokes_shift_nm",
        "between_sessions_level_rel", "between_sessions_filter_rel",
    )  # fmt: skip

    paint_name: str
    detection: EmissionDetection | None = Field(
        default=None,
        description="verdict on whether there is emission, and its certainty; none: not judged, by an older version",
    )
    spectrum_from: str = Field(default="", description="origin of the reported spectrum; empty: the family")
    family: str = Field(description="family whose sampled parameters stand here, and with which pixels are mapped")
    family_title: str
    family_choice: str = Field(description="reason for this family, and its certainty")
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
    emission_low95_simultaneous_per_nm: Curve | None = Field(
        default=None,
        description="lower limit of the band that holds the whole curve with 95 %, where it exceeds 5 % of its peak; "
        "the limits above hold at each wavelength by itself; none: made by an older version",
    )
    emission_high95_simultaneous_per_nm: Curve | None = None
    emission_draws_per_nm: Annotated[Floats, ArraySpec("<f8", ("curve draw", "wavelength"), "1/nm")]
    prior_shares: dict[str, PriorShare] = Field(
        default={},
        description="shares of mode_nm, fwhm_nm, peak_per_nm, energy_yield, stokes_shift_nm; empty: not judged",
    )
    energy_yield: Estimate = Field(description="emitted / incident energy, emission above the laser line to 780 nm")
    band_integrals: tuple[Estimate, ...] = Field(
        description="emission through each filter: integral of emission times transmission / that of transmission"
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
    between_sessions: SessionScatter | None = Field(
        default=None,
        description="differences between the sessions that this fit combines; none: one session, or an older version",
    )
    diagnostics: Diagnostics
    warnings: tuple[str, ...] = ()

    @property
    def spectrum_source(self) -> str:
        """Origin of the reported spectrum: the prior learned from measured spectra, or a family of curves."""
        return self.spectrum_from or self.family_title

    @property
    def mostly_prior(self) -> tuple[str, ...]:
        """Names of the quantities of the spectrum that the measurement hardly constrains."""
        return tuple(n for n, s in self.prior_shares.items() if s.mostly_prior and n != "stokes_shift_nm")

    @property
    def mode_nm(self) -> Quantity:
        """Wavelength of the emission's maximum, nm."""
        return Quantity.of(self.parameters["mode_nm"], "nm")

    @property
    def fwhm_nm(self) -> Quantity:
        """Full width of the emission at half its maximum, nm."""
        return Quantity.of(self.parameters["fwhm_nm"], "nm")

    @property
    def peak_per_nm(self) -> Quantity:
        """Emission at its maximum, as a radiance factor per nm, 1/nm."""
        return Quantity.of(self.parameters["peak_per_nm"], "1/nm")

    @property
    def reflectance_at_laser(self) -> Quantity:
        """Non-fluorescent reflectance at the laser line, 0 to 1."""
        return Quantity.of(self.parameters["reflectance_at_laser"], "")

    @property
    def stokes_shift_nm(self) -> Quantity:
        """Maximum of emission minus last maximum of absorption, nm; `reradiation` says whether it was measured."""
        return Quantity.of(self.reradiation.stokes_shift_nm, "nm")

    @property
    def between_sessions_level_rel(self) -> Estimate | None:
        """Relative standard deviation of the level between the sessions combined; None of a single session."""
        return None if self.between_sessions is None else self.between_sessions.level_rel

    @property
    def between_sessions_filter_rel(self) -> Estimate | None:
        """Relative standard deviation of a single filter beside the level; None of a single session."""
        return None if self.between_sessions is None else self.between_sessions.filter_rel

    def propagate(self, function: Callable[[Floats], ArrayLike]) -> PropagatedDraws:
        """Carry the posterior of the emission through a function of the user.

        Parameters
        ----------
        function
            Takes one draw of the emission (L,) in 1/nm on `wavelength_nm`, which may dip slightly below 0; returns a
            number or an array of a fixed shape.

        Returns
        -------
        PropagatedDraws
            What the function returned for each draw, with estimate and 95 % interval.
        """
        return propagate_draws(self.emission_draws_per_nm, function)

    def to_inferencedata(self) -> Any:
        """Return posterior, prior, data and replicated data as ArviZ knows them (an ``arviz.InferenceData``).

        Raises
        ------
        MissingExtraError
            ArviZ or xarray is not installed.
        """
        return call_record_method(self, "to_inferencedata")


Floats32 = NDArray[np.float32]
PlainMap = Annotated[Floats32, ArraySpec("<f4", ("row", "column"), allow_nan=True)]
MapNm = Annotated[Floats32, ArraySpec("<f4", ("row", "column"), "nm", allow_nan=True)]
MapPerNm = Annotated[Floats32, ArraySpec("<f4", ("row", "column"), "1/nm", allow_nan=True)]
BlockMap = Annotated[Floats, ArraySpec("<f8", ("block row", "block column"), allow_nan=True)]
BlockMapNm = Annotated[Floats, ArraySpec("<f8", ("block row", "block column"), "nm", allow_nan=True)]
MappedQuantity = Literal["mode_nm", "peak_per_nm", "energy_yield"]


class PaintSpread(Model):
    """How much one quantity of the paint differs from pixel to pixel, in the unit of the quantity.

    The noise of the pixels is subtracted, and so is the pull of the prior: a noisy camera does not make a paint look
    uneven, and a strong prior does not make it look even.
    """

    estimate: float = Field(description="median over the pixels")
    sd: Annotated[float, Field(ge=0.0)] = Field(description="robust standard deviation between pixels, without noise")
    high: Annotated[float, Field(ge=0.0)] = Field(
        description="the same spread if the pixels' noise were 10 % less than stated"
    )
    noise_share: Fraction = Field(description="share of the noise in the scatter of the pixels (variance)")
    resolved: bool = Field(
        description="whether the paint's part exceeds what a 10 % error of the stated noise could imitate"
    )
    pixels: Annotated[int, Field(ge=0)] = Field(description="pixels counted: those that the prior does not dominate")


class PaintSpot(Model):
    """A block of pixels whose yield departs from the paint's median."""

    row_px: int = Field(description="centre of the block in the raw frame")
    column_px: int
    deviation_rel: float = Field(description="yield / median - 1")
    deviation_sd_rel: float
    mode_shift_nm: float = Field(description="mode minus the median")


class PaintMap(Record):
    """Emission of every raw pixel, fitted from the bands that its own Bayer channel sees.

    The bands are first divided, filter by filter and channel by channel, by what the region's signal exceeds the
    region's family curve: calibration errors and the paint's departure from the family are common to all pixels.
    The map shows how pixels differ from the region; ``region`` holds its values, whose uncertainty all pixels share.
    Standard deviations hold what differs between pixels. Those of width, peak and yield are relative: 95 % limits
    are value * exp(+-1.96 sd / value). NaN where a pixel could not be fitted. The reflectance at the laser is linear
    in the signals and may scatter below 0.
    """

    schema_version: ClassVar[int] = 2
    written_by: ClassVar[str] = "'finray fit --map'"

    paint_name: str
    family: str
    area: RegionOfInterest = Field(description="area of the maps, in pixels of the raw frame")
    mode_nm: MapNm
    mode_sd_nm: MapNm
    fwhm_nm: MapNm
    fwhm_sd_nm: MapNm
    peak_per_nm: MapPerNm
    peak_sd_per_nm: MapPerNm
    energy_yield: PlainMap
    energy_yield_sd: PlainMap
    shape_name: str = Field(description="the family's own parameter: kappa or ln_asymmetry")
    shape_value: PlainMap
    shape_sd: PlainMap
    reflectance_at_laser: PlainMap
    reflectance_at_laser_sd: PlainMap
    chi_square: PlainMap = Field(
        description="sum of squared residuals of the bands in standard deviations, without the prior"
    )
    bands_used: Annotated[NDArray[np.uint8], ArraySpec("|u1", ("row", "column"))]
    converged: Annotated[NDArray[np.bool_], ArraySpec("|b1", ("row", "column"))]
    region: dict[str, Estimate] = Field(
        description="fit of the region: the centre of the prior, whose error all pixels share"
    )
    prior_sd: dict[str, float] = Field(description="prior of a pixel around the region's fit")
    prior_in_words: str
    band_factor: Annotated[Floats, ArraySpec("<f8", ("filter", "3"), allow_nan=True)] = Field(
        description="region's signal / its family curve; NaN where a filter and channel is not used"
    )
    fitted_pixels: Annotated[int, Field(ge=1)]
    unusable_pixels: Annotated[int, Field(ge=0)] = Field(description="masked, or with too few usable bands")
    unconverged_pixels: Annotated[int, Field(ge=0)]
    uniformity: dict[MappedQuantity, PaintSpread]
    block_px: Annotated[int, Field(ge=2)] = Field(description="side of a block")
    block_mode_nm: BlockMapNm = Field(description="median over each block; NaN with too few pixels")
    block_mode_sd_nm: BlockMapNm
    block_energy_yield: BlockMap
    block_energy_yield_sd: BlockMap
    worst_spots: tuple[PaintSpot, ...] = Field(
        description="blocks whose yield differs most from the median, worst first"
    )

    @model_validator(mode="after")
    def _sizes_agree(self) -> "PaintMap":
        rows, columns = self.chi_square.shape
        if (self.area.height_px, self.area.width_px) != (rows, columns):
            raise ValueError(
                f"area is {self.area.height_px} x {self.area.width_px} px, but the maps have {rows} x {columns} px; "
                "the sizes must be equal"
            )
        return self


CertifiedName = Literal["mode_nm", "fwhm_nm", "peak_per_nm", "energy_yield", "reflectance_at_laser"]
CERTIFIED: Final[dict[CertifiedName, tuple[str, str]]] = {
    "mode_nm": ("Wavelength of the maximum of the emission", "nm"),
    "fwhm_nm": ("Full width at half maximum", "nm"),
    "peak_per_nm": ("Emission at the maximum, as radiance factor per nm", "1/nm"),
    "energy_yield": ("Energy yield: emitted / incident energy", ""),
    "reflectance_at_laser": ("Reflectance at the laser line", ""),
}
"""Quantity -> what it is, and its unit."""
Reference = Literal["white reference", "filters", "lamp", "camera response", "laser", "other"]
Line = Annotated[str, Field(max_length=300)]


class ReferenceCertificate(Model):
    """A certificate of calibration that the laboratory holds for a part of its rig."""

    of: Reference
    number: Annotated[str, Field(min_length=1, max_length=300)] = Field(description="number of the certificate")
    issued_by: Annotated[str, Field(min_length=1, max_length=300)]
    calibrated_on: IsoDay
    valid_until: IsoDay | None = Field(
        default=None, description="last day on which it is valid; none: the certificate states none"
    )


class CertifiedLimits(Model):
    """What a quantity must keep, for a statement of conformity; in the unit of the quantity."""

    quantity: CertifiedName
    low: float | None = Field(default=None, allow_inf_nan=False)
    high: float | None = Field(default=None, allow_inf_nan=False)

    @model_validator(mode="after")
    def _limits_are_in_order(self) -> "CertifiedLimits":
        if self.low is None and self.high is None:
            raise ValueError("neither low nor high is given, so there is nothing to conform to; give one or both")
        if self.low is not None and self.high is not None and self.low > self.high:
            raise ValueError(f"low = {self.low:g} must not be above high = {self.high:g}")
        return self


class CertificateDetails(Record):
    """What stands on a certificate beside what finray measured; all of it may be left out."""

    kind: Literal["certificate"] = "certificate"
    laboratory: Line = ""
    address: Line = ""
    number: Line = Field(
        default="", description="number of the certificate; if left out, it is made from the record's SHA-256"
    )
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
