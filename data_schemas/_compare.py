"""What a comparison writes: how far a render is from a capture, beside doing nothing and repeating; also forces.

A batch holds each pair's headline, their mean, and what failed. A force comparison holds a measured force over
displacement against a simulated press, with what is uncertain in both.
"""

from collections.abc import Mapping
from typing import Annotated, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from data_schemas._design import FingerIdentity
from data_schemas._model import Estimate, Model, Record
from data_schemas._record_text import interval_text
from data_schemas._sensing import LocalScale, ScaleRange
from data_schemas._units import ArraySpec, Fraction, RelativeUncertainty

NotNegative = Annotated[float, Field(ge=0.0)]


class Interval(Model):
    """Point estimate with a 95 % interval."""

    estimate: float
    low95: float
    high95: float

    def __str__(self) -> str:
        return interval_text(self.estimate, self.low95, self.high95)

    def __repr__(self) -> str:
        return str(self)


class InputUncertainty(Model):
    """One line of the uncertainty budget: what this input alone does, all others at their best values.

    Attributes
    ----------
    evaluation
        "A": from repeated observations (posterior draws, repeated images, halves of a render); "B": from other
        knowledge (a stated uncertainty of the camera, of the pose).
    skill_u, objective_u_rel
        Standard uncertainty of the headline skill and of the objective's relative error.
    """

    input: str
    evaluation: Literal["A", "B"]
    source: str
    skill_u: float
    objective_u_rel: float | None


class MonteCarlo(Model):
    """How the intervals were propagated (JCGM 101): draws, and to how many digits they are stable."""

    draws: int
    significant_digits: Annotated[
        int,
        Field(
            ge=0,
            le=2,
            description="number of numerically stable digits of the headline's standard uncertainty (JCGM 101)",
        ),
    ]
    not_included: tuple[str, ...] = Field(description="what the intervals leave out, in plain words")


class ValidationCell(Model):
    """Mean level of one part of the region in one channel, simulated against captured (ASME V&V 20).

    All numbers are relative to the captured level. The simulation is within its validation uncertainty where
    ``abs(error_rel) <= 2 u_validation_rel``; else the model is wrong by about ``error_rel``. The area metric is the
    area between the distribution of the simulation (its uncertain inputs) and that of the capture; its two signed parts
    add up to it.
    """

    row: Annotated[int, Field(ge=0, le=2)]
    column: Annotated[int, Field(ge=0, le=2)]
    channel: Literal["red", "green", "blue"]
    pixels: int
    error_rel: float
    u_numerical_rel: float
    u_input_rel: float
    u_data_rel: float
    u_validation_rel: float
    within: bool
    area_too_bright_rel: float
    area_too_dark_rel: float


class ObjectiveError(Model):
    """Simulated against captured value of the sweep's own objective, per channel, as draws.

    log_ratio_draws: ln(k simulated / captured) of the brightness beside the indenter in red, green, blue, with the
    exposure factor k of the no-contact images. log_exposure_draws: ln of k per second of exposure and mA of the LED;
    subtracted from log_ratio it leaves the absolute ratio, of which only differences between captures of one rig mean
    something. None where exposure or current is not known. Reports on the same paints and camera share their draws, so
    that the covariance of two reports is that of their draws.
    """

    error_rel: Interval
    log_ratio_draws: Annotated[NDArray[np.float64], ArraySpec("<f8", ("draw", "3"))]
    log_exposure_draws: Annotated[NDArray[np.float64], ArraySpec("<f8", ("draw",))] | None
    source: str = Field(description="checksums of the paints and name of the camera whose draws are shared")
    rig: str | None = Field(default=None, description="what the capture was taken with; None: not known")


class ErrorRow(Model):
    """One row of the table: a candidate image against the captured contact image in one region."""

    candidate: Literal["do nothing", "simulation", "floor"]
    skill: Interval = Field(
        description="1 - squared error relative to that of the no-contact image. The true skill is at most 1, but the "
        "estimate and its interval may exceed 1, because the expected noise is subtracted from the squared error. An "
        "interval entirely above 1 means that this noise is overestimated: the squared error is smaller than the "
        "noise alone would give"
    )
    skill_per_channel: tuple[float | None, float | None, float | None] = Field(
        description="None where contact does not change the channel"
    )
    relative_rms: tuple[Interval, Interval, Interval] | None = Field(
        description="RMS error of each channel; None where values are not linear light"
    )
    difference_gradient_rms_per_px: Interval | None = Field(
        default=None,
        description="RMS error of the gradient of (image - its no-contact image), relative to the pad's level",
    )
    chromaticity_rms: Interval | None = Field(
        default=None, description="RMS error of R / (R + G + B) and G / (R + G + B); None where noise hides them"
    )
    ms_ssim: float | None = Field(default=None, description="multi-scale SSIM of the frame; None in small images")
    ciede2000_mean: float | None = Field(
        default=None, description="colour difference of the displayed images, mean over the region"
    )
    ciede2000_p95: float | None = Field(
        default=None, description="colour difference of the displayed images, 95th percentile over the region"
    )
    flip_mean: float | None = Field(
        default=None, description="difference of the displayed images, mean over the headline region"
    )
    psnr_db: float | None = Field(description="peak signal-to-noise ratio; None for identical images")
    ssim: float | None = Field(
        description="mean of the SSIM map over the region; for comparison with papers; None without a complete window"
    )


class RegionError(Model):
    """All rows for one region."""

    region: str
    factor: float = Field(description="region size in contact half-widths")
    pixels: int
    clipped_fraction: float
    rows: tuple[ErrorRow, ...]


class SensingRow(Model):
    """One candidate as the sensor itself would see it: normals and depth from its colours against the captured ones."""

    candidate: Literal["do nothing", "simulation", "floor"]
    normal_angle_mean_deg: Interval
    normal_angle_p95_deg: Interval
    depth_rms_mm: Interval


class SensingError(Model):
    """Error in sensing space over the headline region: one map from colour to normals, applied to both sides.

    ``held_out_explained_rel`` is what the map explains of the squared slopes of presses that did not teach it, median
    and range over random halves. The ``outside_share`` are pixels whose change of colour no calibration press showed.
    """

    normal_map: str
    presses: int
    held_out_explained_rel: Interval = Field(
        description="median, least and greatest over random halves of the presses; this is not a 95 % interval"
    )
    outside_share_simulated: float
    outside_share_captured: float
    rows: tuple[SensingRow, ...]
    mm_per_px_u_rel: RelativeUncertainty | None = Field(
        default=None,
        description="relative standard uncertainty of the scale from which the map and its depths are computed; "
        "None: not known",
    )


class MetricRow(Model):
    """One candidate by a metric of another package."""

    candidate: Literal["do nothing", "simulation", "floor"]
    value: Interval = Field(
        description="value of the simulation over draws of its uncertain inputs; of zero width where no input is "
        "uncertain"
    )


class PackagedMetric(Model):
    """A metric that another package brings, over the headline region."""

    name: str
    package: str = Field(description="package that provides it, with its version")
    unit: str = Field(description="1: a pure number")
    better: Literal["higher", "lower"]
    words: str = Field(description="what the metric is, in the words of its package")
    draws: Annotated[int, Field(ge=0)] = Field(
        description="number of draws of the inputs behind the simulation's interval; 0: none"
    )
    rows: tuple[MetricRow, ...]


class RegionExtent(Model):
    """How far a region reaches on the pad, along the rows and the columns of the picture at the patch's middle."""

    region: str
    along_x_mm: Annotated[float, Field(gt=0.0, json_schema_extra={"unit": "mm"})]
    along_y_mm: Annotated[float, Field(gt=0.0, json_schema_extra={"unit": "mm"})]
    along_x_u_mm: Annotated[float, Field(ge=0.0, json_schema_extra={"unit": "mm"})]
    along_y_u_mm: Annotated[float, Field(ge=0.0, json_schema_extra={"unit": "mm"})]


class PatchScale(Model):
    """Millimetres per raw pixel of the capture at the compared patch.

    ``extents`` are those of the pixels that belong to a region, for the pad at rest; half a pixel at either end is in
    their standard uncertainty.
    """

    middle: LocalScale = Field(description="scale at the middle of the contact patch")
    over_patch: ScaleRange
    over_pad: ScaleRange
    extents: tuple[RegionExtent, ...]


class WhiteBalanceDrift(Model):
    """Gain of the contact image over the no-contact image per channel, from pixels beyond 3 half-widths.

    A gain common to all channels and one of a single channel are seen alike. Where it was taken out, both sides were
    brought to the light of their no-contact image, each by its own gain.
    """

    gains: tuple[float, float, float] = Field(description="gains of the capture for red, green, blue; 1: no gain")
    expected_gains: tuple[float, float, float] = Field(description="gains that the simulation expects")
    u_rel: tuple[NotNegative, NotNegative, NotNegative] = Field(description="relative standard uncertainty")
    uneven_rel: tuple[NotNegative, NotNegative, NotNegative] = Field(description="change across the picture")
    blocks: tuple[int, int, int] = Field(
        description="number of blocks of pixels; a channel of fewer than 8 is not judged"
    )
    corrected: bool


class FittedToneCurve(Model):
    """Curve DN = b + s L^p between the render's light L and the capture's values, from the no-contact images alone.

    The score uses it in the ratio form S = b + (B - b) (L1 / L0)^p, in which the scales cancel. A gain common to both
    images cannot be known, nor an exponent apart from an error of the render's contrast.
    """

    exponent: Interval = Field(description="exponent p; 0.45 is sRGB, 1 linear")
    offset_dn: Interval = Field(description="offset b above the recorded black level")
    white_balance: tuple[Interval | None, Interval | None, Interval | None] = Field(
        description="scale of red, green and blue in linear light, relative to green; None where the render has no "
        "light in this channel or in green"
    )
    correlation: float = Field(
        description="correlation of the logarithms of both no-contact images; near 0 the prior decides"
    )
    skill_u: NotNegative = Field(description="standard uncertainty of the headline skill from curve and gains alone")
    outside_share: Fraction = Field(
        description="share of the pixels of the headline region whose level does not occur without contact: there the "
        "curve is an extrapolation"
    )
    log_light: Annotated[NDArray[np.float64], ArraySpec("<f8", ("block", "3"))] = Field(
        description="logarithm of the render's level, relative to the mean of its channel"
    )
    level_dn: Annotated[NDArray[np.float64], ArraySpec("<f8", ("block", "3"))]
    draws: Annotated[NDArray[np.float64], ArraySpec("<f8", ("draw", "2"))] = Field(description="exponent, offset")


class CauseParameter(Model):
    """How large a cause of error is: what would have to change in the simulation to repair it."""

    name: str
    unit: str
    value: float
    u: NotNegative = Field(description="standard uncertainty from noise and from errors that no cause explains")


class ErrorCause(Model):
    """One cause of a simulation's error, its size, and the skill that it costs."""

    cause: Literal["pose", "size", "depth", "gain", "shading", "blur", "halo"]
    parameters: tuple[CauseParameter, ...]
    skill_lost: float = Field(
        description="its part of 1 - skill; the parts add up to 1 - skill, so one of them may be below 0"
    )
    skill_regained: float = Field(description="what correcting this cause alone would add to the skill")
    like: tuple[str, ...] = Field(default=(), description="causes whose effect on the image is much like this one's")
    advice: str


class ErrorAttribution(Model):
    """Where 1 - skill of the headline region comes from: parts that add up.

    Causes are those that a joint fit of small changes of the simulation found to explain the residual; the largest
    first. Saturated pixels and noise are no causes of the simulation.
    """

    causes: tuple[ErrorCause, ...]
    skill_lost: float = Field(description="1 - skill of the region")
    saturation_skill: float = Field(description="part of pixels that are clipped, or nearly so, in the simulation")
    noise_skill: float = Field(
        description="part that is noise of render and capture, known or from neighbouring pixels; 0 where removed"
    )
    remainder_skill: float = Field(description="part that neither saturation, noise nor a cause explains")
    maps: Annotated[NDArray[np.float32], ArraySpec("<f4", ("cause", "row", "column"))] | None = Field(
        description="what each cause changes in the image, mean over channels, relative to the pad's level; None "
        "where no cause was found"
    )


class PhotometricErrorReport(Record):
    """Comparison of one simulated press with one tactile capture.

    The headline is the skill score over the contact patch dilated to twice its half-width: 0 is doing nothing,
    the floor row is what a repeat of the no-contact image costs. Where the camera's noise is taken out (linear light
    with a repeat) a score may lie above it; elsewhere a score above it is not meaningful.
    """

    schema_version: ClassVar[int] = 6
    written_by: ClassVar[str] = "'finray compare'"
    shown: ClassVar[tuple[str, ...]] = (
        "simulated", "captured", "headline_skill", "headline_region", "exposure_factor", "values",
    )  # fmt: skip

    simulated: str
    captured: str
    finger: FingerIdentity | None = Field(
        default=None, description="finger that was rendered; None: not known (no design, or an older version)"
    )
    label: str
    values: Literal["linear light", "encoded values, encoding unknown", "encoded values, through a fitted tone curve"]
    block_px: Annotated[int, Field(ge=1, description="images were averaged over blocks of this side")]
    headline_region: str
    headline_skill: Interval
    regions: tuple[RegionError, ...]
    ssim_full_frame: dict[str, float | None]
    ssim_settings: str
    exposure_factor: float | None = Field(description="one factor for all channels; None when not fitted")
    exposure_factor_sd: float | None
    channel_weights: tuple[float, float, float]
    objective_error: ObjectiveError | None = Field(
        description="None where values are not linear light, or no input of the press has a known uncertainty"
    )
    light_angle_deg: float | None
    light_angle_uncertainty_deg: float | None = None
    interval_covers: str = Field(description="what the intervals cover, in plain words")
    interval_over: Literal["inputs", "pixels of this press"] | None = Field(
        default=None,
        description="inputs: the interval holds 95 % of what the inputs leave open; pixels of this press: it "
        "is only the spread over parts of the region and does not apply to another press; None: not "
        "known (an older version)",
    )
    contact_signal: NotNegative | None = Field(
        default=None,
        description="weighted sum of squares of the contact's change over the headline region, in squares of the "
        "no-contact level (encoded values: of full scale) times pixels; None: not known (an older version)",
    )
    attribution: ErrorAttribution | None = Field(
        default=None, description="None where the causes cannot be separated, or were not requested"
    )
    monte_carlo: MonteCarlo | None = Field(default=None, description="None where no input has a known uncertainty")
    budget: tuple[InputUncertainty, ...] = ()
    validation: tuple[ValidationCell, ...] = ()
    sensing: SensingError | None = Field(default=None, description="None where no normal map was given")
    patch_scale: PatchScale | None = Field(default=None, description="None where no pixel scale was given")
    tone_curve: FittedToneCurve | None = Field(
        default=None, description="None where both sides hold the same kind of values"
    )
    white_balance: WhiteBalanceDrift | None = Field(default=None, description="None where it cannot be determined")
    findings: tuple[str, ...] = Field(
        default=(), description="findings of the checks of registration, channels and exposure"
    )
    forced_mismatch: bool = Field(
        default=False, description="compared although the checks say that the images do not belong together"
    )
    relative: bool = Field(
        default=False,
        description="only the change by contact was judged: the captured image without contact replaced the render's, "
        "so that nothing is said of the render's light",
    )
    error_map: Annotated[NDArray[np.float32], ArraySpec("<f4", ("row", "column"), allow_nan=True)]
    withheld: tuple[str, ...] = Field(default=(), description="figures that are not given, and why")
    notes: tuple[str, ...] = ()
    packaged_metrics: tuple[PackagedMetric, ...] = Field(
        default=(), description="metrics of other packages that were requested"
    )


class ComparedPair(Model):
    """One press of a batch: its files, and either its report or why there is none."""

    name: str
    simulated: str
    captured: str
    simulator: str = Field(default="", description="name of the simulator; empty where only one is compared")
    press: str = Field(
        default="", description="name that repeats of one press share; empty: same as the name of the pair"
    )
    session: str | None = Field(default=None, description="session in which it was captured; None: not known")
    sensor: str | None = Field(default=None, description="sensor with which it was captured; None: not known")
    report: str | None = Field(default=None, description="file of the report, relative to the batch")
    skill: Interval | None = Field(default=None, description="headline of the report")
    floor_skill: Interval | None = Field(default=None, description="what a repeat of the no-contact image would score")
    contact_signal: NotNegative | None = Field(
        default=None, description="squared change by the contact, of which the skill is a share; None: not known"
    )
    findings: tuple[str, ...] = ()
    error: str | None = Field(default=None, description="why this pair could not be compared")


class SkillOverPresses(Model):
    """Skill of all presses together: 1 - sum of their squared errors / sum of their squared changes by contact.

    The interval says what other presses of this kind would give. Its units are the highest of sensors, sessions and
    presses of which there are three; with fewer units it has no ends.
    """

    estimate: float
    low95: float | None = Field(description="None with fewer than three units")
    high95: float | None = Field(description="None with fewer than three units")
    presses: Annotated[int, Field(ge=1)]
    unit: Literal["press", "session", "sensor"]
    units: Annotated[int, Field(ge=1)]
    method: str = Field(description="how the interval was formed, in plain words")
    not_sampled: tuple[str, ...] = Field(default=(), description="what the interval leaves out")


class SimulatorScore(Model):
    """One simulator of a batch."""

    simulator: str
    compared: Annotated[int, Field(ge=0, description="presses")]
    failed: Annotated[int, Field(ge=0, description="presses that could not be compared")]
    skill: SkillOverPresses | None = Field(
        description="skill over the presses that all ranked simulators share; None where nothing could be compared"
    )


class SkillDifference(Model):
    """Skill of one simulator minus that of another on the same presses.

    Intervals of all differences of a batch hold together with 95 % (Bonferroni).
    """

    first: str
    second: str
    estimate: float
    low95: float | None = Field(description="None with fewer than three units")
    high95: float | None = Field(description="None with fewer than three units")
    presses: Annotated[int, Field(ge=1)]
    better_in: Annotated[int, Field(ge=0, description="presses in which the first has the higher skill")]


class ComparisonBatch(Record):
    """Comparison of simulated presses with their captures, of one simulator or several, the best first."""

    schema_version: ClassVar[int] = 4
    written_by: ClassVar[str] = "'finray compare' with folders"

    pairs: tuple[ComparedPair, ...]
    headline_region: str | None = Field(description="None where no pair could be compared")
    simulators: tuple[SimulatorScore, ...] = Field(default=(), description="the best first")
    differences: tuple[SkillDifference, ...] = Field(default=(), description="difference of every two simulators")
    worst: tuple[str, ...] = Field(
        default=(), description="names of the pairs of lowest skill, the lowest first; of the best simulator"
    )
    to_capture_next: tuple[str, ...] = Field(
        default=(), description="which captures would make the scores more certain"
    )
    relative: bool = Field(default=False, description="only the change by contact was judged, in all pairs")
    notes: tuple[str, ...] = ()


class ForceEstimate(Model):
    """Point estimate with a 95 % interval; without ends where the comparison withholds its intervals."""

    estimate: float
    low95: float | None
    high95: float | None


class ForcePoint(Model):
    """One measured point. Errors are simulated minus measured, with the first touch fitted where it is."""

    displacement_mm: float = Field(description="as measured")
    depth_mm: float = Field(description="push from first touch, at which the simulation is read")
    force_n: float = Field(description="as measured")
    simulated_n: ForceEstimate = Field(
        description="95 % interval from the design's inputs and the numerics, at this push"
    )
    error_n: float
    u_numerical_n: NotNegative
    u_input_n: NotNegative
    u_data_n: NotNegative
    u_validation_n: NotNegative = Field(description="root of the sum of the three squares")
    within: bool | None = Field(description="abs(error_n) <= 2 u_validation_n; None: withheld")


class ForceInput(Model):
    """One line of the budget: what an input alone does to the force at the deepest measured point."""

    input: str
    evaluation: Literal["A", "B"]
    source: str
    u_rel: NotNegative | None = Field(
        description="standard uncertainty of the input; None for a contribution that is not an input"
    )
    ln_force_per_ln_input: float | None = Field(
        description="d ln F / d ln x; None for a contribution that is not an input"
    )
    force_u_rel: NotNegative = Field(description="standard uncertainty, relative to the simulated force")


class ForceRow(Model):
    """A candidate curve against the measured one."""

    candidate: Literal["do nothing", "simulation"]
    rms_rel: ForceEstimate = Field(
        description="root mean square of the error / that of the measured force, with noise removed from both; the "
        "interval includes the model's own error"
    )


class ForceThird(Model):
    """Mean error over a third of the displacement (ASME V&V 20): the model's error lies in error +- 2 u_validation."""

    from_mm: float
    to_mm: float
    points: int
    force_n: float = Field(description="mean of the measured force")
    error_n: float
    u_numerical_n: NotNegative
    u_input_n: NotNegative
    u_data_n: NotNegative
    u_validation_n: NotNegative
    within: bool | None = Field(description="abs(error_n) <= 2 u_validation_n; None where the verdict is withheld")


class FirstTouch(Model):
    """Measured displacement at which the indenter first touches: the one nuisance, fitted by least squares."""

    offset_mm: ForceEstimate
    u_mm: NotNegative


class ForceComparison(Record):
    """A measured force over displacement against a simulated press."""

    schema_version: ClassVar[int] = 2
    written_by: ClassVar[str] = "'finray compare PRESS.mechanics.json --force CSV'"

    simulated: str
    label: str = Field(description="engine and mesh of the press")
    measured: str
    points: tuple[ForcePoint, ...]
    rows: tuple[ForceRow, ...]
    first_touch: FirstTouch | None = Field(description="None where the displacement counts from first touch")
    thirds: tuple[ForceThird, ...] = Field(
        description="thirds of the measured displacement; a third without points is absent"
    )
    budget: tuple[ForceInput, ...]
    draws: int
    not_included: tuple[str, ...] = Field(description="what the intervals leave out, in plain words")
    withheld: str = Field(
        default="", description="why there are no intervals and verdicts, and how to get them; empty where there are"
    )


MaterialVerdict = Literal["measured", "constrained in part", "not measured (prior)"]
PerForce = NDArray[np.float64]


class FittedModulus(Model):
    """A modulus, or a ratio of two, before and after force curves were seen."""

    field: str = Field(description="field of the finger's design; for a list of constants, their sum")
    unit: str
    prior: Estimate = Field(description="without the curves")
    posterior: Estimate
    left_of_prior_rel: NotNegative = Field(
        description="width of the middle 68 % of the modulus' logarithm, with the curves / without them"
    )
    verdict: MaterialVerdict = Field(
        description="verdict by the share of the prior's width that is left: below a quarter and known to 15 %, below "
        "0.8, or more"
    )


class FittedForceCurve(Model):
    """A measured force curve, and what the fitted moduli predict for it."""

    measured: str
    specimen: str
    displacement_mm: Annotated[PerForce, ArraySpec("<f8", ("point",), "mm")] = Field(description="as measured")
    force_n: Annotated[PerForce, ArraySpec("<f8", ("point",), "N")] = Field(description="as measured")
    fitted_n: Annotated[PerForce, ArraySpec("<f8", ("point",), "N")] = Field(
        description="median over the posterior, with the load cell's zero and drift"
    )
    low95_n: Annotated[PerForce, ArraySpec("<f8", ("point",), "N")] = Field(
        description="95 % limits of a point that is measured again, with the noise"
    )
    high95_n: Annotated[PerForce, ArraySpec("<f8", ("point",), "N")]
    first_touch_mm: Estimate = Field(description="displacement at which the plate or indenter touches")
    noise_n: Estimate = Field(description="standard deviation of a point, in addition to its stated uncertainty")
    scale_ln: Estimate = Field(description="logarithm of the factor by which the computed force is wrong")
    residual_rms_n: NotNegative


class MaterialFit(Record):
    """Moduli by measured force curves of blocks of gel, or of a finger."""

    dimension_of: ClassVar[Mapping[str, str]] = {"moduli": "modulus"}
    schema_version: ClassVar[int] = 1
    written_by: ClassVar[str] = "'finray fit-material'"

    name: str
    moduli: tuple[FittedModulus, ...]
    draws: Annotated[PerForce, ArraySpec("<f8", ("draw", "modulus"))] = Field(
        description="draws of the posterior; columns in the order of moduli, each in its unit"
    )
    bulk_modulus_mpa: Estimate = Field(
        description="K of the gel; a confined block determines it, although not its two factors separately"
    )
    curves: tuple[FittedForceCurve, ...]
    effective_samples: Annotated[float, Field(gt=0.0)]
    pareto_k: float
    trusted: bool = Field(description="the draws cover the posterior, and their effective number is large enough")
    design_toml: str = Field(description="lines of a finger's design with what was measured of the gel; may be empty")
    notes: tuple[str, ...] = ()
