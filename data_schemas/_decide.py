"""Decisions: on the angle of the blue light, on the numbers of a design, its paints and its tolerances."""

from typing import Annotated, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from data_schemas._design import FingerDesign, PlainSensor
from data_schemas._model import Estimate, Model, Record
from data_schemas._units import AngleDeg, ArraySpec, Fraction

Floats = NDArray[np.float64]
Verdict = Literal["decided", "tie", "undecided", "needs captures"]
Criterion = Literal["average", "worst"]
Aim = Literal["brightness", "normal"]
Curve = Annotated[Floats, ArraySpec("<f8", ("angle",))]


class AngleStatement(Model):
    """What is claimed about the decided angle."""

    p_within_5deg: Fraction
    expected_regret: float = Field(description="expected loss relative to the best angle")
    regret_95: float = Field(description="loss that is not exceeded with 95 % probability")
    equivalent_deg: tuple[tuple[AngleDeg, AngleDeg], ...] = Field(
        description="angles whose loss stays within the tolerance with 95 % probability"
    )
    p_within_tolerance: Fraction | None = Field(
        default=None, description="probability that the loss is within the tolerance; none in records of older versions"
    )


class DecidingCapture(Model):
    """One physical capture: how far the simulated objective is from the captured one at its angle.

    value and sd: the captured objective on the scale of the decision's curve, to be drawn as a point beside it.
    """

    captured: str
    light_angle_deg: AngleDeg
    light_angle_uncertainty_deg: Annotated[float, Field(ge=0.0, le=90.0)]
    error_rel: float = Field(
        description="simulated / captured objective - 1; where captures are compared by exposure and LED current, the "
        "unknown scale of the rig is taken out"
    )
    error_u_rel: float = Field(description="standard uncertainty of the error, including that of the angle")
    value: float
    sd: float


class AngleProposal(Model):
    """The angle at which one more observation is expected to help most (knowledge gradient)."""

    angle_deg: AngleDeg
    gain_rel: float = Field(
        description="expected increase of the best expected objective by this observation, relative to that objective"
    )
    noise_rel: float = Field(description="assumed standard uncertainty of the observation, relative")
    position_mm: float | None = Field(
        default=None, description="where to touch the pad; None: at the place of the sweep"
    )


class OtherObjective(Model):
    """What the decided angle loses under another objective of the sweep."""

    name: str
    best_deg: AngleDeg = Field(description="where this objective has its optimum")
    loss_rel: float = Field(description="mean loss at the decided angle, relative to that optimum")
    loss_90_rel: tuple[float, float] = Field(description="5 % and 95 % quantiles of that loss")
    disagrees: bool | None = Field(
        description="whether the loss exceeds the tolerance with 95 % probability; None: cannot be determined"
    )
    cost_rel: float | None = Field(
        default=None,
        description="expected loss of the decided objective at the best angle of this one; None in older versions",
    )
    statement: str


class DecidedContact(Model):
    """One touch of the finger that the decision counts, and what the decided angle loses there.

    Losses are relative to the angle that is best for this touch alone.
    """

    sweep: str = Field(description="name of the sweep")
    shape: str = Field(description="shape of the indenter")
    position_mm: float = Field(description="place of the indenter's middle along the pad, from the base")
    across_mm: float = Field(description="distance of the indenter's middle from the middle line of the pad")
    depth_mm: float
    weight_share: Fraction = Field(description="share in the average over all touches")
    best_deg: AngleDeg
    loss_rel: float = Field(description="expected loss at the decided angle")
    loss_95_rel: float = Field(description="loss that is not exceeded with 95 % probability")


class LightAngleDecision(Record):
    """The angle to mount the light at, the probability and the risk, on the real finger and by simulation alone.

    Over several touches the value of an angle is the weighted mean, or the least (`criterion`), of the brightness of
    each touch over that at its own best angle; statements are about this value. Without captures (`validated` is False)
    the sim-to-real error has its prior and the verdict is never "decided" or "tie". Records written before that rule
    carry no `discrepancy_rel` then, and claim what the simulation alone does. Records of version 3 and older are about
    one touch, the sweep's, and name none.
    """

    schema_version: ClassVar[int] = 5
    written_by: ClassVar[str] = "'finray decide'"
    shown: ClassVar[tuple[str, ...]] = ("angle_deg", "verdict", "sentence")

    objective: str
    aim: Aim = Field(
        default="brightness",
        description="what the decision is based on: 'brightness' of the touched region, or 'normal', the inverse of "
        "the expected error of the sensed normal at places on the pad",
    )
    angle_deg: AngleDeg
    angle_simulation_only_deg: AngleDeg
    verdict: Verdict
    at_range_end: bool = Field(default=False, description="the optimum may lie outside the sweep: widen the sweep")
    headline: str = Field(default="", description="the first of the sentences: what to do; empty in older versions")
    sentence: str
    tolerance_rel: Fraction
    tolerance_deg: tuple[AngleDeg, AngleDeg] | None = Field(
        default=None,
        description="range of angles in which the expected value is within the tolerance of that of the decided angle",
    )
    criterion: Criterion = "average"
    contacts: tuple[DecidedContact, ...] = ()
    angle_average_deg: AngleDeg | None = Field(
        default=None, description="angle of the least loss on average over the touches"
    )
    angle_worst_deg: AngleDeg | None = Field(
        default=None, description="angle of the least loss at the worst of the touches"
    )
    contact_value: Annotated[Floats, ArraySpec("<f8", ("contact", "angle"))] | None = Field(
        default=None, description="expected brightness of each touch / that at its own best angle"
    )
    validated: bool = Field(description="False: not validated against a capture")
    discrepancy_rel: float | None = Field(
        description="sim-to-real error of the objective at an angle without capture, one standard deviation: median; "
        "assumed where there is no capture"
    )
    discrepancy_95_rel: tuple[float, float] | None = Field(default=None, description="its central 95 % interval")
    captures: tuple[DecidingCapture, ...] = ()
    statement: AngleStatement = Field(description="statement for the real finger, with the sim-to-real error")
    statement_simulation_only: AngleStatement
    grid_deg: Annotated[Floats, ArraySpec("<f8", ("angle",), "deg")]
    mean: Curve = Field(description="curve of the real finger, from simulation and captures (or the prior) together")
    low95: Curve
    high95: Curve
    mean_simulation_only: Curve
    low95_simulation_only: Curve
    high95_simulation_only: Curve
    next_render: AngleProposal | None = Field(default=None, description="None where no render would change anything")
    next_capture: AngleProposal | None = Field(default=None, description="None where no capture would change anything")
    other_objectives: tuple[OtherObjective, ...] = ()
    notes: tuple[str, ...] = ()


class DesignObjective(Model):
    """One number by which designs are judged."""

    name: str
    unit: str
    meaning: str
    larger_is_better: bool


class DesignParameter(Model):
    """One number of a design that may be changed, and its limits."""

    field: str = Field(description="dotted field of the design; for a place, with its coordinate: light.position_mm[y]")
    low: float
    high: float
    is_integer: bool = Field(default=False, description="whole numbers only, such as a number of ribs")
    start: float = Field(description="value in the starting design")


class EvaluatedDesign(Record):
    """The objectives of one design; kept so that an interrupted search continues."""

    schema_version: ClassVar[int] = 3
    written_by: ClassVar[str] = "'finray design optimise'"
    shown: ClassVar[tuple[str, ...]] = ("values", "failure")

    key: str = Field(description="SHA-256 of what the numbers were computed from")
    values: dict[str, float] = Field(description="objective -> its number; empty where it failed")
    failure: str = Field(default="", description="why the design could not be evaluated")
    processor_s: Annotated[float, Field(ge=0.0)] = Field(description="processor time of the evaluation")
    design: FingerDesign


DesignRole = Literal["start", "screen", "search", "chosen"]


class OptimisedDesign(Model):
    """One design of a search."""

    number: Annotated[int, Field(ge=1)]
    role: DesignRole = Field(
        description="origin of the design: as given; computed in the screening; proposed by the emulator; recommended"
    )
    changes: dict[str, float] = Field(description="parameter -> its value")
    values: dict[str, float] = Field(description="objective -> its number, as computed; empty where it failed")
    failure: str = ""
    expected_95: dict[str, tuple[float, float]] = Field(
        default={}, description="objective -> 95 % interval of its number by the emulator, all designs together"
    )
    p_front: Fraction | None = Field(
        default=None,
        description="probability that no design within the limits is as good in all objectives and better by the "
        "tolerance in one",
    )
    better_than_chosen: tuple[str, ...] = Field(
        default=(), description="objectives in which it is better with 97.5 % probability"
    )
    worse_than_chosen: tuple[str, ...] = Field(
        default=(), description="objectives in which it is worse with 97.5 % probability"
    )


class DesignGain(Model):
    """What the chosen design gains in one objective; positive is better, relative to what it is compared with."""

    objective: str
    against: Literal["start", "best of the screen"]
    seen_rel: float = Field(description="as computed in the search, with its random numbers")
    expected_rel: float = Field(description="prediction of the emulator: median")
    expected_95_rel: tuple[float, float] = Field(description="its central 95 % interval")
    confirmed_rel: float | None = Field(
        default=None, description="mean with other seeds and contact places, which the search has not seen"
    )
    confirmed_95_rel: tuple[float, float] | None = Field(default=None, description="Student's t over these seeds")
    shrinkage_rel: float | None = Field(
        default=None, description="gain in the search minus the confirmed one: the part that was chance"
    )


class MainEffect(Model):
    """How an objective changes with one parameter, averaged over all others within their limits, by the emulator."""

    objective: str
    parameter: str
    at: tuple[float, ...]
    mean: tuple[float, ...]
    low95: tuple[float, ...]
    high95: tuple[float, ...]


class DesignOptimum(Record):
    """The best design found within limits, what it gains and trades, and how much better another could be."""

    schema_version: ClassVar[int] = 4
    written_by: ClassVar[str] = "'finray design optimise'"
    shown: ClassVar[tuple[str, ...]] = ("sentence",)

    name: str
    sentence: str
    objectives: tuple[DesignObjective, ...] = Field(min_length=1)
    parameters: tuple[DesignParameter, ...] = Field(min_length=1)
    designs: tuple[OptimisedDesign, ...] = Field(min_length=1, description="all designs that were computed, in order")
    chosen: Annotated[int, Field(ge=1)] = Field(description="number of the recommended design")
    screen_best: Annotated[int, Field(ge=1)] = Field(description="number of the best design of the screen, as computed")
    gains: tuple[DesignGain, ...]
    regret_rel: float = Field(description="expected loss against the best design within the limits")
    regret_95_rel: float = Field(
        description="loss that is not exceeded with 95 % probability, according to the emulator"
    )
    unexplained_rel: dict[str, float] = Field(
        description="objective -> error of the emulator at left-out designs / their spread, both of ln(value)"
    )
    tolerance_rel: Fraction = Field(description="tolerance of p_front")
    effects: tuple[MainEffect, ...] = ()
    start: FingerDesign
    design: FingerDesign = Field(description="the recommended finger")
    processor_s: Annotated[float, Field(ge=0.0)] = Field(description="processor time of all evaluations")
    notes: tuple[str, ...] = ()


class PaintPairRow(Model):
    """How well a finger would sense normals with one paint on each wall."""

    red: str = Field(description="paint of the red wall")
    green: str = Field(description="paint of the green wall")
    normal_error_deg: Estimate = Field(description="error of the sensed normal, mean over the pad")
    above_best_deg: Estimate = Field(description="error minus that of the best pair, draw by draw")
    is_worse: bool = Field(
        description="whether the difference from the best pair is significant, at 95 % for all pairs together"
    )
    best_share: Fraction = Field(description="share of the draws in which this pair is the best")
    separation_deg: Annotated[float, Field(ge=0.0)] = Field(
        description="angle between the colours of facets tilted to opposite sides"
    )
    exposure_rel: Annotated[float, Field(gt=0.0)] = Field(description="exposure time relative to the shortest")


class PaintChoice(Record):
    """Pairs of paints ranked for one finger by the error of the sensed normal, before anything is moulded."""

    schema_version: ClassVar[int] = 3
    written_by: ClassVar[str] = "'finray design paints'"
    shown: ClassVar[tuple[str, ...]] = ("sentence",)

    name: str
    sentence: str
    paints: tuple[str, ...]
    pairs: tuple[PaintPairRow, ...] = Field(min_length=2, description="best first")
    normal_error_draws_deg: Annotated[Floats, ArraySpec("<f8", ("pair", "draw"), "deg")] = Field(
        description="one row of draws for each pair, in the order of the pairs; all pairs share each draw"
    )
    design: FingerDesign
    notes: tuple[str, ...] = ()

    @model_validator(mode="after")
    def _one_row_a_pair(self) -> "PaintChoice":
        if len(self.normal_error_draws_deg) != len(self.pairs):
            raise ValueError(
                f"the draws have {len(self.normal_error_draws_deg)} rows, but must have one for each of "
                f"the {len(self.pairs)} pairs"
            )
        return self


class ToleranceSide(Model):
    """How far one number may differ from its value to one side, everything else as designed."""

    limit: float | None = Field(
        description="distance at which the error has grown by the allowed share; null: not found"
    )
    low95: float | None = None
    high95: float | None = None
    tried: float = Field(description="largest distance that was evaluated")
    ended_by: str = Field(
        default="",
        description="why no larger distance was evaluated: the reason why the design cannot be built there",
    )
    checked_loss_rel: float | None = Field(
        default=None, description="growth of the error at the limit, with other paths, draws and noise"
    )


class VarianceShare(Model):
    """A Sobol' index with its 95 % interval."""

    estimate: Fraction
    low95: Fraction
    high95: Fraction


class ToleranceRow(Model):
    """One number of a finger that varies."""

    field: str
    unit: str
    nominal: float
    given: Annotated[float, Field(gt=0.0)] = Field(description="half-range that was given for the number")
    origin: str = Field(description="where the half-range comes from")
    less: ToleranceSide
    more: ToleranceSide
    first: VarianceShare = Field(description="share of the variance that this number causes alone")
    total: VarianceShare = Field(description="share of the variance that would vanish if this number did not vary")
    is_distinguishable: bool = Field(
        description="whether the total share exceeds the share that the emulator does not explain"
    )


class FingerTolerances(Record):
    """How far the numbers of a finger may vary before its sensed normals are worse than allowed, alone and together."""

    schema_version: ClassVar[int] = 3
    written_by: ClassVar[str] = "'finray design tolerances'"
    shown: ClassVar[tuple[str, ...]] = ("sentence",)

    name: str
    sentence: str
    objective: str
    calibration: Literal["own", "shared"] = Field(
        description="whether each finger is calibrated as it was built, or uses the calibration of the finger as "
        "designed"
    )
    allowed_rel: Annotated[float, Field(gt=0.0)] = Field(description="allowed growth of the error")
    nominal_error_deg: Annotated[float, Field(gt=0.0)] = Field(description="expected error of the finger as designed")
    contact_places_mm: tuple[float, ...] = Field(description="middles of the contacts along the pad")
    rows: tuple[ToleranceRow, ...] = Field(min_length=1)
    together_factor: float | None = Field(
        description="largest factor on all half-ranges at which 95 % of the fingers stay within the allowed growth; "
        "null: beyond the emulated box"
    )
    together_low95: float | None = None
    together_high95: float | None = None
    within_given_share: Fraction = Field(
        description="share of the fingers that stay within the allowed growth when all numbers vary within the given "
        "half-ranges"
    )
    checked_within: Annotated[int, Field(ge=0)] = Field(
        description="number of fingers within the allowed growth at together_factor (at the end of the emulated box "
        "where there is none), among checked_fingers that were evaluated directly with other paths"
    )
    checked_fingers: Annotated[int, Field(ge=0)]
    box_factor: Annotated[float, Field(gt=0.0)] = Field(description="half-ranges of the emulated box / the given ones")
    q2: float = Field(description="share of the variance of left-out runs that the emulator predicts")
    noise_rel: Annotated[float, Field(ge=0.0)] = Field(
        description="standard deviation of a growth that random numbers alone cause"
    )
    inputs: Annotated[Floats, ArraySpec("<f8", ("run", "input"))] = Field(
        description="inputs of each run, from -1 to 1 over the emulated box"
    )
    losses_rel: Annotated[Floats, ArraySpec("<f8", ("run",))] = Field(description="growth of the error of each run")
    design: FingerDesign
    paints: dict[str, str] = Field(description="colour -> SHA-256 of the calibration")
    notes: tuple[str, ...] = ()

    @model_validator(mode="after")
    def _one_column_a_row(self) -> "FingerTolerances":
        if self.inputs.shape != (len(self.losses_rel), len(self.rows)):
            raise ValueError(
                f"inputs has shape {self.inputs.shape}, but must have a row for each of the {len(self.losses_rel)} "
                f"runs and a column for each of the {len(self.rows)} numbers"
            )
        return self


class LightPowerRow(Model):
    """One light and the power that lights the coat most evenly."""

    field: str = Field(description="design field that holds its power")
    light: str = Field(description="the light in words")
    now_rel: Annotated[float, Field(gt=0.0)] = Field(description="power_rel of the design")
    least_rel: Annotated[float, Field(ge=0.0)]
    most_rel: Annotated[float, Field(gt=0.0)]
    power_rel: Annotated[float, Field(ge=0.0)] = Field(description="recommended")
    optimum_rel: Estimate = Field(description="power that makes the light most even, from draws of paths and paints")
    share_now: Fraction = Field(description="share of the light that all lights emit now")


class NormalErrorChange(Model):
    """What the powers do to the expected error of the sensed normal."""

    now_deg: Annotated[float, Field(gt=0.0)]
    recommended_deg: Annotated[float, Field(gt=0.0)]
    change_rel: float = Field(description="change with the recommended powers, relative to now, by the same draws")
    low95_rel: float
    high95_rel: float


class LightPlaceMap(Model):
    """A finger over two of its numbers, such as the angle and a place of its light, all else as designed."""

    fields: tuple[str, str]
    units: tuple[str, str]
    first: Annotated[Floats, ArraySpec("<f8", ("first",))]
    second: Annotated[Floats, ArraySpec("<f8", ("second",))]
    normal_error_deg: Annotated[Floats, ArraySpec("<f8", ("first", "second"), "deg", allow_nan=True)] = Field(
        description="expected error of the sensed normal; places that are not seen count as not tilted; none where the "
        "finger cannot be built"
    )
    above_best_u_deg: Annotated[Floats, ArraySpec("<f8", ("first", "second"), "deg", allow_nan=True)] = Field(
        description="standard uncertainty of the difference to the best, by paths, paints and noise"
    )
    evenness_rel: Annotated[Floats, ArraySpec("<f8", ("first", "second"), allow_nan=True)] = Field(
        description="ratio of the 5 % and the 95 % quantile over the pad of the luminance without contact"
    )
    brightness_rel: Annotated[Floats, ArraySpec("<f8", ("first", "second"), allow_nan=True)]


class LightPowers(Record):
    """Powers of the lights by which a coat is lit most evenly, and what they cost."""

    schema_version: ClassVar[int] = 2
    written_by: ClassVar[str] = "'finray design lights'"
    shown: ClassVar[tuple[str, ...]] = ("sentence",)

    name: str
    sentence: str
    rows: tuple[LightPowerRow, ...] = Field(min_length=1)
    total_rel: Annotated[float, Field(gt=0.0)] = Field(
        description=("allowed light of all lights together, relative to the present")
    )
    variation_now_rel: Estimate = Field(
        description=(
            "standard deviation of the brightness over the places, relative to its mean, with the present powers"
        )
    )
    variation_rel: Estimate = Field(
        description=(
            "standard deviation of the brightness over the places, relative to its mean, with the recommended powers"
        )
    )
    gain_rel: Estimate = Field(description="share by which the variation falls")
    gap_rel: Annotated[float, Field(ge=0.0)] = Field(
        description="upper bound, on this basis, of what other allowed powers could still gain"
    )
    brightness_rel: Annotated[float, Field(gt=0.0)] = Field(description="mean brightness, relative to the present")
    normal_error: NormalErrorChange | None = Field(
        default=None, description="error of the normal; none where it is not evaluated"
    )
    at_rest: Annotated[int, Field(ge=1)] = Field(
        description=("rows of the basis without contact; the others are with contact")
    )
    places_mm: Annotated[Floats, ArraySpec("<f8", ("row", "2"), "mm")] = Field(
        description="x and z of each place on the pad"
    )
    basis: Annotated[Floats, ArraySpec("<f8", ("light", "row"))] = Field(
        description="brightness by each light at its present power; the mean of all together is 1 in each state"
    )
    basis_u: Annotated[Floats, ArraySpec("<f8", ("light", "row"))] = Field(
        description="standard uncertainty of the basis from the noise of the paths"
    )
    power_draws: Annotated[Floats, ArraySpec("<f8", ("draw", "light"))] = Field(
        description="draws of the most even powers, as factors of the present ones"
    )
    map: LightPlaceMap | None = None
    design: FingerDesign | None = Field(default=None, description="the finger as it is now")
    sensor: PlainSensor | None = Field(default=None, description="the classic sensor as it is now")
    notes: tuple[str, ...] = ()

    @model_validator(mode="after")
    def _one_row_a_light(self) -> "LightPowers":
        if len(self.basis) != len(self.rows):
            raise ValueError(
                f"the basis has {len(self.basis)} lights, but must have one for each of the {len(self.rows)} rows"
            )
        if (self.design is None) == (self.sensor is None):
            raise ValueError("exactly one of design (a finger) and sensor (a classic sensor) must be given")
        return self

    @property
    def subject(self) -> FingerDesign | PlainSensor:
        """Whose lights they are."""
        subject = self.design or self.sensor
        if subject is None:  # the validator has refused it
            raise AttributeError("light powers without a design")
        return subject
