"""Force comparison: a measured force over displacement against a simulated press, with what is uncertain in both."""

from typing import Annotated, ClassVar, Literal

from pydantic import Field

from data_schemas.model import Model, Record

NotNegative = Annotated[float, Field(ge=0.0)]


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
    simulated_n: ForceEstimate = Field(description="95 % over the design's inputs and the numerics, at this push")
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
    u_rel: NotNegative | None = Field(description="standard uncertainty of the input; None for what is no input")
    ln_force_per_ln_input: float | None = Field(description="d ln F / d ln x; None for what is no input")
    force_u_rel: NotNegative = Field(description="standard uncertainty over the simulated force")


class ForceRow(Model):
    """A candidate curve against the measured one."""

    candidate: Literal["do nothing", "simulation"]
    rms_rel: ForceEstimate = Field(
        description="root mean square of the error over that of the measured force, noise taken out of both; the "
        "interval holds the model's own error, whatever the inputs really are"
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
    within: bool | None = Field(description="None: withheld")


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
    thirds: tuple[ForceThird, ...] = Field(description="of the measured displacement; a third without points is absent")
    budget: tuple[ForceInput, ...]
    draws: int
    not_included: tuple[str, ...] = Field(description="what the intervals do not know, in plain words")
    withheld: str = Field(
        default="", description="why there are no intervals and verdicts, and how to get them; empty where there are"
    )
