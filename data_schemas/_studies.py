"""What studies write: the paper's optical experiments, stiffness of fingers, the paper's statements on paints.

The optical experiments, on one finger, vary the emitter of the painted walls, the number of panels and the angle of
the panel. Stiffness, in bending and twist, comes with whether its order depends on assumed dimensions. Statements are
tested on measured materials. A design study is a plan (TOML), a record for each of its points, and their table.
"""

from collections.abc import Mapping
from typing import Annotated, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from data_schemas._curves import SpectralCurve
from data_schemas._design import FingerDesign
from data_schemas._design_parts import LEAST_DEPTH_MM, Indenter
from data_schemas._fit import Reradiation, SamplingMethod
from data_schemas._model import Estimate, Model, Record
from data_schemas._units import AngleDeg, ArraySpec, Fraction, LengthMm, PositionMm, WavelengthNm

Floats = NDArray[np.float64]
Alternatives = Annotated[
    NDArray[np.float32], ArraySpec("<f4", ("alternative", "row", "column", "band"), "radiance of the panel")
]
OnCoat = Annotated[NDArray[np.bool_], ArraySpec("|b1", ("row", "column"))]
CameraMatrix = Annotated[Floats, ArraySpec("<f8", ("3", "band"))]


class _Study(Record):
    """What every study says of its finger."""

    name: str
    label: str = Field(description="how the images came about")
    design: FingerDesign
    paints: dict[str, str] = Field(description="colour -> where the paint's optics come from")
    samples: int = Field(description="paths per pixel, or per probe and repeat")
    notes: tuple[str, ...] = ()


class LevelDifference(Model):
    """How far an image with the paper's emitter is from the one with baked walls, over blocks of the coat.

    Errors are norms of differences over the norm of the baked image.
    """

    level: str
    state: Literal["no contact", "contact"]
    band: str
    mean_ratio: float = Field(description="mean over the coat without contact, relative to the baked walls")
    block_error_rel: float
    shape_error_rel: float = Field(description="the same error at equal mean brightness (without mean_ratio)")
    noise_rel: float = Field(description="render noise of one baked image; the differences share its random numbers")


class FluorescentRendering(_Study):
    """The paper's emitter (level a, by the distance from the light) beside baked walls (level b)."""

    dimension_of: ClassVar[Mapping[str, str]] = {"levels": "alternative", "bands": "band", "walls": "wall"}
    schema_version: ClassVar[int] = 5
    written_by: ClassVar[str] = "'finray study fluorescent-rendering'"

    levels: tuple[str, ...]
    bands: tuple[str, ...]
    no_contact_bands: Alternatives
    contact_bands: Alternatives
    camera_matrix: CameraMatrix
    on_coat: OnCoat
    block_px: int
    differences: tuple[LevelDifference, ...]
    walls: tuple[str, ...]
    z_mm: Annotated[Floats, ArraySpec("<f8", ("z",), "mm")]
    wall_radiance_rel: Annotated[Floats, ArraySpec("<f8", ("alternative", "wall", "z"))] = Field(
        description="emitted radiance without contact, mean over the wall's height, relative to that of the panel"
    )
    second_order_rel: Annotated[Floats, ArraySpec("<f8", ("wall", "z"))] = Field(
        description="part of the baked radiance that light of other paint has excited"
    )
    wall_error_rel: Annotated[Floats, ArraySpec("<f8", ("alternative", "wall"))] = Field(
        description="difference from the baked radiance along z, both scaled to equal means: norm of the difference, "
        "relative to the norm of the baked radiance"
    )
    second_order_wall_share: dict[str, float]
    second_order_coat_share: dict[str, float] = Field(
        description="share of the light of the coat without contact, by band"
    )
    angles_deg: Annotated[Floats, ArraySpec("<f8", ("angle",), "deg")]
    wall_by_angle_rel: Annotated[Floats, ArraySpec("<f8", ("angle", "wall", "z"))] = Field(
        description="baked radiance at other light angles; the paper's rule does not depend on the angle"
    )


class Uniformity(Model):
    """How evenly the coat is lit without contact."""

    lights: str
    channel: str = Field(description="a band, or R, G, B of the camera")
    variation_rel: float = Field(
        description="standard deviation over the area of the coat, relative to the mean; without noise"
    )
    middle_variation_rel: float = Field(description="the same over the middle 70 % of the length")
    min_to_max_ratio: float = Field(description="darkest to brightest along z, means over the width")
    noise_rel: float = Field(description="render noise of one cell of the coat / the mean")


class TwoLights(_Study):
    """One panel at the base against panels at base and tip."""

    dimension_of: ClassVar[Mapping[str, str]] = {"lights": "alternative", "bands": "band", "channels": "channel"}
    schema_version: ClassVar[int] = 5
    written_by: ClassVar[str] = "'finray study two-lights'"

    lights: tuple[str, ...]
    bands: tuple[str, ...]
    channels: tuple[str, ...]
    no_contact_bands: Alternatives
    contact_bands: Alternatives
    camera_matrix: CameraMatrix
    on_coat: OnCoat
    tip_light_position_mm: tuple[PositionMm, PositionMm, PositionMm]
    tip_light_angle_deg: AngleDeg
    cell_mm: LengthMm
    uniformity: tuple[Uniformity, ...]
    z_mm: Annotated[Floats, ArraySpec("<f8", ("z",), "mm")]
    along_rel: Annotated[Floats, ArraySpec("<f8", ("alternative", "channel", "z"), allow_nan=True)] = Field(
        description="means over the width, relative to the mean with one panel; NaN where the camera sees nothing"
    )


class BrightestAngle(Model):
    """Where a curve over the light angle has its maximum; 95 % limits over repeats (jackknife, Student's t)."""

    mirror: str
    probe: str
    band: str
    angle_deg: float
    low95_deg: float
    high95_deg: float
    loss_at_printed_rel: float = Field(description="loss at the paper's angle, relative to the maximum")
    loss_at_printed_low95_rel: float
    loss_at_printed_high95_rel: float
    past_90_rel: float = Field(description="value at the last angle, relative to that at 90 deg")


class LightAngleIntensity(_Study):
    """Brightness beside the indenter over the angle of the panel, with and without the mirror."""

    dimension_of: ClassVar[Mapping[str, str]] = {"mirrors": "mirror", "probes": "probe", "bands": "band"}
    schema_version: ClassVar[int] = 5
    written_by: ClassVar[str] = "'finray study light-angle'"

    mirrors: tuple[str, ...]
    probes: tuple[str, ...]
    bands: tuple[str, ...]
    probe_points_mm: Annotated[Floats, ArraySpec("<f8", ("probe", "3"), "mm")]
    led_depth_mm: LengthMm = Field(description="depth of the panel's centre below the inner face")
    angles_deg: Annotated[Floats, ArraySpec("<f8", ("angle",), "deg")]
    radiance_rel: Annotated[Floats, ArraySpec("<f8", ("mirror", "angle", "repeat", "probe", "band"))]
    elevation_deg: Annotated[Floats, ArraySpec("<f8", ("probe",), "deg")] = Field(
        description="elevation of the refracted path from the panel's centre to the probe: where its direct light "
        "is brightest"
    )
    elevation_by_depth_deg: dict[str, tuple[float, ...]] = Field(
        description="the same elevation per probe for other depths of the panel (mm)"
    )
    printed_angle_deg: AngleDeg
    maxima: tuple[BrightestAngle, ...]


Measure = Literal["bending_n_per_mm", "sideways_n_per_mm", "pad_n_per_mm", "twist_n_mm_per_deg"]


class StiffnessRow(Model):
    """One finger with one dimension changed; values are secants at the study's loads."""

    design: str
    changed: str = Field(description="field of the design that differs from it; empty for the design itself")
    change_rel: float = Field(default=0.0, description="change of the dimension, relative to its value in the design")
    bending_n_per_mm: float | None = Field(default=None, description="force at the tip, away from the pad's side")
    sideways_n_per_mm: float | None = Field(default=None, description="force at the tip across the finger")
    pad_n_per_mm: float | None = Field(default=None, description="force under the middle of the pad, along its normal")
    twist_n_mm_per_deg: float | None = Field(default=None, description="turn of the tip end about the long axis")
    slip_torque_per_friction_n_mm: float | None = Field(
        default=None,
        description="torque about the pad's normal at which a gripped cylinder begins to turn / Coulomb's "
        "coefficient; only for unchanged designs",
    )
    tipping_torque_n_mm: float | None = Field(
        default=None,
        description="torque about the finger's long axis that the gripping force alone resists; only for unchanged "
        "designs",
    )
    grip_failure: str = Field(default="", description="why an unchanged design has no torques; otherwise empty")
    failure: str = Field(
        default="",
        description="why there are no values: the changed parts do not fit, or the press found no equilibrium",
    )


class StiffnessOrder(Model):
    """Whether two fingers keep their order in one measure."""

    measure: Measure
    stiffer: str
    softer: str
    ratio: float = Field(description="stiffer over softer, as designed")
    smallest_ratio: float = Field(
        description="smallest ratio with the same dimension changed in both by the same share"
    )
    at: str = Field(description="the change at which the ratio is smallest; empty: without any change")
    independent_ratio: float = Field(
        description="least stiffness of the stiffer finger / largest of the softer one, of all changes"
    )
    note: str = ""


class FingerStiffness(Record):
    """Stiffnesses of some designs, and of each with its assumed dimensions changed one at a time."""

    schema_version: ClassVar[int] = 5
    written_by: ClassVar[str] = "'finray study finger-stiffness'"

    label: str
    designs: tuple[FingerDesign, ...]
    tip_force_n: float
    pad_force_n: float
    twist_deg: float
    grip_force_n: float | None = Field(
        default=None,
        description="force that grips a cylinder of 20 mm across the middle of the pad; None in older versions",
    )
    share: float = Field(description="share by which each dimension is increased and decreased")
    rows: tuple[StiffnessRow, ...]
    orders: tuple[StiffnessOrder, ...]
    notes: tuple[str, ...] = ()


OverEmission = Annotated[Floats, ArraySpec("<f8", ("wavelength",), "1/nm")]
PaintColour = Literal["red", "green"]
StatementVerdict = Literal["holds", "holds in part", "does not hold", "cannot be tested"]


class CurveFit(Model):
    """One family of curves fitted by least squares to all of a measured emission or absorption."""

    family: str
    parameters: dict[str, float]
    mode_nm: WavelengthNm
    fwhm_nm: float
    curve: SpectralCurve
    residual_rel: float = Field(description="difference from the whole measured curve: norm, relative to the curve's")


class BandFit(Model):
    """Posterior of a whole emission from eight filter bands in three channels, judged by the measured emission."""

    family: str
    with_discrepancy: bool = Field(description="whether the paint may differ from the family's curve")
    parameters: dict[str, Estimate] = Field(
        description="mode_nm and fwhm_nm; for the paper's family also its own parameters"
    )
    wavelength_nm: Annotated[Floats, ArraySpec("<f8", ("wavelength",), "nm")]
    mean_per_nm: OverEmission
    low95_per_nm: OverEmission
    high95_per_nm: OverEmission
    residual_rel: float = Field(description="norm of (mean - measured emission) / norm of the measured emission")
    covered_share: Fraction = Field(
        description="share of the measured samples above 5 % of the peak within the pointwise 95 % band"
    )
    method: SamplingMethod
    trusted: bool = Field(description="whether the draws support 95 % limits")


class ColourPatch(Model):
    """Distance of a ColorChecker patch from a measured reflectance."""

    name: str
    error_rel: float = Field(description="norm of the difference / norm of the measured reflectance")


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
    stokes_shift_low_nm: float = Field(
        description="maximum of emission minus the longest wavelength of the absorption plateau"
    )
    stokes_shift_high_nm: float = Field(
        description="maximum of emission minus the shortest wavelength of the absorption plateau"
    )
    printed_stokes_shift_nm: float
    absorption_edge_nm: WavelengthNm = Field(description="where absorption has fallen to half, towards the red")
    laser_absorption_factor: float = Field(description="a(laser) / maximum")
    filter_bands: dict[str, float] = Field(description="radiance factor in the band of each filter, per 10 nm")
    energy_yield: float = Field(description="emitted / incident energy, laser line to 780 nm")
    photon_yield: float = Field(description="emitted / incident photons")
    printed_patch: ColourPatch
    closest_patch: ColourPatch
    paper_curve: CurveFit = Field(description="the paper's family, fitted to the whole emission")
    our_curve: CurveFit = Field(description="our default family, fitted to the whole emission")
    absorption_curve: CurveFit = Field(description="the paper's family, fitted to the whole absorption")
    paper_fit: BandFit = Field(description="emission from the filter bands, by the paper's family alone")
    our_fit: BandFit = Field(description="emission from the filter bands, our default family with discrepancy")
    one_laser: Reradiation = Field(description="our absorption from the yield under the laser alone")
    several_lights: Reradiation = Field(description="our absorption from the yields under several lights")


class PaperStatement(Model):
    """One statement of the paper beside what the stand-ins say."""

    subject: str
    paper: str
    measure: str = Field(description="what the row gives for each stand-in")
    ours: dict[str, str] = Field(description="result for each material")
    verdict: StatementVerdict
    why: str


class PaperPaints(Record):
    """The paper's statements on its two paints, and ours on measured stand-ins."""

    schema_version: ClassVar[int] = 2
    written_by: ClassVar[str] = "'finray study paper-paints'"

    laser_nm: WavelengthNm
    stand_ins: tuple[PaintStandIn, ...]
    statements: tuple[PaperStatement, ...]
    caveat: str


DesignValue = bool | int | float | str
"""A value of a design's field as a plan writes it."""


class StudyVariation(Model):
    """One thing that a study changes: a field of the design and its values, or the range that they are drawn from."""

    field: str = Field(description="dotted field of the design, or 'preset' for a ready-made finger, or 'seed'")
    values: tuple[DesignValue, ...] = Field(default=(), description="the values, in order")
    low: float | None = Field(default=None, description="lower end of the range of a random study")
    high: float | None = Field(default=None, description="upper end of the range of a random study")

    @model_validator(mode="after")
    def _values_or_range(self) -> "StudyVariation":
        if bool(self.values) == (self.low is not None or self.high is not None):
            raise ValueError(
                f"vary {self.field}: give either values, or low and high (with combine = 'random'), but not both"
            )
        if not self.values and (self.low is None or self.high is None or self.low >= self.high):
            raise ValueError(f"vary {self.field}: low and high must both be given, and low must be below high")
        return self


class StudyMeasure(Model):
    """What a study computes at each of its points."""

    press: Literal["analytic", "finite elements"] = Field(
        default="analytic",
        description="how the indenter is pressed in: by a formula, where the pad takes its shape at once, or by "
        "finite elements, which also give the force",
    )
    increments: Annotated[int, Field(ge=1, le=100)] = Field(default=2, description="number of steps of the push")
    images: bool = Field(default=True, description="whether the press is rendered; without, only mechanics is computed")
    samples: Annotated[int, Field(ge=2, le=100_000, multiple_of=2)] = Field(
        default=64, description="paths per pixel of each repeat"
    )
    repeats: Annotated[int, Field(ge=3, le=100)] = Field(
        default=3, description="independent renders of a point; their spread gives the intervals"
    )

    @model_validator(mode="after")
    def _measures_something(self) -> "StudyMeasure":
        if self.press == "analytic" and not self.images:
            raise ValueError(
                'measure: press = "analytic" without images computes nothing; set press = "finite elements" or '
                "images = true"
            )
        return self


class DesignStudy(Record):
    """Plan of a design study (TOML): a finger, what changes, and what is computed at each point."""

    kind: Literal["design"] = "design"
    name: Annotated[str, Field(min_length=1, max_length=80)]
    about: str = Field(default="", description="purpose of the study, in one sentence")
    design: str = Field(default="flat-70x35", description="a ready-made finger, or a design file beside the plan")
    combine: Literal["grid", "together", "random"] = Field(
        default="grid",
        description="grid: every value with every other; together: first with first, second with second; random: a "
        "Sobol' sample of the ranges",
    )
    count: Annotated[int, Field(ge=2, le=100_000)] | None = Field(default=None, description="points of a random study")
    seed: Annotated[int, Field(ge=0)] = Field(default=1, description="seed of the sample and of the renders")
    set: dict[str, DesignValue] = Field(default={}, description="fields of the design that every point takes")
    measure: StudyMeasure = StudyMeasure()
    vary: tuple[StudyVariation, ...] = Field(min_length=1)

    @model_validator(mode="after")
    def _combination_is_whole(self) -> "DesignStudy":
        fields = [variation.field for variation in self.vary]
        twice = sorted({field for field in fields if fields.count(field) > 1 or field in self.set})
        if twice:
            raise ValueError(f"{twice[0]} is given more than once; give it once, either in a vary table or in set")
        if (self.combine == "random") != (self.count is not None):
            raise ValueError('count must be given with combine = "random", and only then')
        ranged = [variation.field for variation in self.vary if not variation.values]
        listed = [variation.field for variation in self.vary if variation.values]
        if self.combine == "random" and listed:
            raise ValueError(f'vary {listed[0]}: combine = "random" needs low and high, not values')
        if self.combine != "random" and ranged:
            raise ValueError(f'vary {ranged[0]}: low and high are supported only with combine = "random"; give values')
        if self.combine == "together" and len({len(variation.values) for variation in self.vary}) > 1:
            raise ValueError('combine = "together": all lists of values must have the same length')
        self._require_different_points()
        return self

    def _require_different_points(self) -> None:
        """Refuse points that would be computed twice."""
        if self.combine == "together":
            points = list(zip(*(variation.values for variation in self.vary), strict=True))
            repeated = [point for point in points if points.count(point) > 1]
            if repeated:
                raise ValueError(f"vary: the point {list(repeated[0])} is listed twice; list each point only once")
            return
        for variation in self.vary:
            twice = [value for value in variation.values if variation.values.count(value) > 1]
            if twice:
                raise ValueError(
                    f"vary {variation.field}: {twice[0]!r} is listed twice in its values; list each value only once"
                )


class StudyMetric(Model):
    """One number of a point, with the 95 % interval that its repeats give."""

    name: str
    value: float
    low95: float | None = Field(default=None, description="None: the study gives no uncertainty for this number")
    high95: float | None = None
    unit: str
    meaning: str


Image = Annotated[NDArray[np.float32], ArraySpec("<f4", ("row", "column", "3"), "radiance of the panel")]


class StudyPoint(Record):
    """What a design study found at one point."""

    schema_version: ClassVar[int] = 4
    written_by: ClassVar[str] = "'finray study run'"
    shown: ClassVar[tuple[str, ...]] = ("study", "number", "changes", "metrics")

    study: str
    number: Annotated[int, Field(ge=1)]
    key: str = Field(description="SHA-256 of what the point was computed from; another plan gives another one")
    changes: dict[str, DesignValue]
    design: FingerDesign
    metrics: tuple[StudyMetric, ...]
    no_contact: Image | None = Field(default=None, description="camera RGB, mean of the repeats")
    contact: Image | None = None
    notes: tuple[str, ...] = ()
    processor_s: Annotated[float, Field(ge=0.0)] = Field(description="processor time of the point")


class StudyFailure(Model):
    """A point that could not be computed, and why."""

    number: Annotated[int, Field(ge=1)]
    changes: dict[str, DesignValue]
    reason: str


class StudyRow(Model):
    """One point of a study as its table shows it."""

    number: Annotated[int, Field(ge=1)]
    changes: dict[str, DesignValue]
    metrics: tuple[StudyMetric, ...]
    computed_by: str | None = Field(
        default=None, description="version and commit of the code that computed the point, and its press; None: unknown"
    )


class StudyResult(Record):
    """All points of a design study, without their images, and those that failed."""

    schema_version: ClassVar[int] = 2
    written_by: ClassVar[str] = "'finray study run'"
    shown: ClassVar[tuple[str, ...]] = ("name", "about")

    name: str
    about: str
    varied: tuple[str, ...] = Field(description="fields of the design")
    points: tuple[StudyRow, ...]
    failures: tuple[StudyFailure, ...] = ()


LengthRangeMm = tuple[LengthMm, LengthMm]


class DatasetPlan(Model):
    """What the presses of a data set are drawn from; how many they are is no part of it, so that a set can grow."""

    design: FingerDesign
    press: Literal["analytic", "finite elements"] = Field(
        default="analytic",
        description="how the indenter is pressed in: by a formula, where the pad takes its shape at once, or by "
        "finite elements, which also give the force",
    )
    increments: Annotated[int, Field(ge=1, le=100)] = Field(default=2, description="steps of a push by finite elements")
    shapes: tuple[Literal["ball", "cylinder"], ...] = Field(default=("ball",), min_length=1)
    radius_mm: LengthRangeMm = Field(default=(3.0, 10.0), description="range of the indenter's radius, drawn evenly")
    depth_mm: LengthRangeMm = Field(default=(0.3, 2.0), description="range of the push, drawn evenly")
    lights: Annotated[int, Field(ge=1, le=1000)] = Field(default=2, description="draws of the light for each press")
    light_angle_reach_deg: Annotated[float, Field(ge=0.0, le=45.0)] = Field(
        default=5.0,
        description="each panel's angle is drawn evenly between the design's angle minus this and plus this",
    )
    paints: Annotated[int, Field(ge=1, le=1000)] = Field(default=4, description="draws of the paints for each light")
    emission_ratio: Annotated[float, Field(ge=1.0, le=10.0)] = Field(
        default=1.25,
        description="largest factor by which the emission of a paint without posterior is multiplied or divided, at "
        "random",
    )
    samples_per_pixel: Annotated[int, Field(ge=2, le=100_000, multiple_of=2)] = Field(
        default=32, description="paths per pixel of the pad; twice as many near the contact"
    )
    presses_per_shard: Annotated[int, Field(ge=1, le=100_000)] = 10
    seed: Annotated[int, Field(ge=0)] = 1

    @model_validator(mode="after")
    def _ranges_ascend(self) -> "DatasetPlan":
        for name in ("radius_mm", "depth_mm"):
            low, high = getattr(self, name)
            if low > high:
                raise ValueError(
                    f"{name}: the range must not run downwards, from {low:g} to {high:g} mm; give the "
                    "smaller number first"
                )
        if self.depth_mm[0] < LEAST_DEPTH_MM:
            raise ValueError(
                f"depth_mm: the range begins at {self.depth_mm[0]:g} mm, less than the {LEAST_DEPTH_MM:g} mm that the "
                "finest mesh resolves; check that the depths are in mm, not in metres"
            )
        return self


DatasetSplit = Literal["train", "validation", "test"]


class DatasetSample(Model):
    """Labels of one sample of a data set: how it was pressed, lit and painted."""

    sample: Annotated[int, Field(ge=0)] = Field(
        description="number of the sample; its key in the shard has six digits or more"
    )
    press: Annotated[int, Field(ge=0)]
    split: DatasetSplit = Field(description="number of the press; all its samples have the same")
    light: Annotated[int, Field(ge=0)] = Field(description="number of the light's draw for this press")
    paint: Annotated[int, Field(ge=0)] = Field(description="number of the paints' draw for this light")
    indenter: Indenter = Field(
        description="indenter as it was pressed; with finite elements its depth is the push that was reached"
    )
    light_angles_deg: tuple[AngleDeg, ...] = Field(description="light angle of each panel")
    emission_draws: dict[str, int] = Field(
        description="colour -> number of the draw of the paint's posterior; or empty"
    )
    emission_factors: dict[str, float] = Field(
        description="colour -> factor on the emission of a paint without a posterior"
    )
    render_seed: Annotated[int, Field(ge=0)]
    gains: tuple[float, float, float] = Field(description="linear camera RGB was multiplied by these before encoding")
    clipped_share: Fraction = Field(description="share of the coat's pixels with contact that have a channel at 255")
    render_noise_rel: Annotated[float, Field(ge=0.0)] = Field(
        description="render noise of a pixel of the coat: standard deviation, rms over channels and coat, relative "
        "to the mean"
    )
    largest_depth_mm: float = Field(description="largest depth in depth.png")
    force_n: float | None = Field(
        default=None, description="force of the indenter along the pad's normal; with finite elements only"
    )
    slip_torque_per_friction_n_mm: float | None = Field(
        default=None, description="torque about the normal at which the contact slips, divided by Coulomb's coefficient"
    )


class DatasetFailure(Model):
    """A press that could not be computed, and why."""

    press: Annotated[int, Field(ge=0)]
    reason: str


class DatasetShard(Record):
    """What one shard of a data set holds; it is stored together with the shard."""

    schema_version: ClassVar[int] = 3
    written_by: ClassVar[str] = "'finray study dataset'"
    shown: ClassVar[tuple[str, ...]] = ("number", "key")

    number: Annotated[int, Field(ge=0)]
    key: str = Field(description="SHA-256 of what the shard is computed from; another plan gives another one")
    sha256: Annotated[str, Field(pattern="^[0-9a-f]{64}$")] = Field(description="SHA-256 of the TAR file")
    samples: tuple[DatasetSample, ...]
    failures: tuple[DatasetFailure, ...] = ()
    processor_s: Annotated[float, Field(ge=0.0)] = Field(description="processor time of the shard")


class DatasetShardRow(Model):
    """One shard as the whole data set lists it."""

    file: str
    sha256: Annotated[str, Field(pattern="^[0-9a-f]{64}$")]
    samples: Annotated[int, Field(ge=0)]


class LearningDataset(Record):
    """A data set of presses for learning: its plan, its shards, and what it does not hold."""

    schema_version: ClassVar[int] = 3
    written_by: ClassVar[str] = "'finray study dataset'"
    shown: ClassVar[tuple[str, ...]] = ("name", "samples", "split_presses")

    name: str
    plan: DatasetPlan
    paints: dict[str, str] = Field(description="colour -> where the paint's optics come from")
    presses: Annotated[int, Field(ge=1)]
    samples: Annotated[int, Field(ge=1)]
    rest_level_rel: Fraction = Field(
        description="mean to which each channel is scaled over the coat without contact, as a share of full scale, in "
        "linear values"
    )
    split_presses: dict[DatasetSplit, int] = Field(description="presses in each part")
    shards: tuple[DatasetShardRow, ...]
    failures: tuple[DatasetFailure, ...] = ()
    processor_s: Annotated[float, Field(ge=0.0)]
    sample_bytes: Annotated[int, Field(ge=0, description="size of all shards / number of samples")]
    notes: tuple[str, ...] = ()
