"""Decision on the angle of the blue light."""

from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from data_schemas.arrays import ArraySpec
from data_schemas.model import Model, Record
from data_schemas.units import AngleDeg, Fraction

Floats = NDArray[np.float64]
Verdict = Literal["decided", "tie", "undecided", "model-limited"]
Curve = Annotated[Floats, ArraySpec("<f8", ("angle",))]


class AngleStatement(Model):
    """What is claimed about the decided angle."""

    p_within_5deg: Fraction
    expected_regret: float = Field(description="expected loss relative to the best angle")
    regret_95: float = Field(description="loss that is not exceeded with 95 % probability")
    equivalent_deg: tuple[tuple[AngleDeg, AngleDeg], ...] = Field(
        description="angles whose loss stays within the tolerance with 95 % probability"
    )


class LightAngleDecision(Record):
    """The angle to mount the light at, the probability and the risk, with and without the sim-to-real error."""

    objective: str
    angle_deg: AngleDeg
    verdict: Verdict
    sentence: str
    tolerance_rel: Fraction
    validated: bool = Field(description="False: not validated against a capture")
    discrepancy_rel: float | None
    statement: AngleStatement = Field(description="with the sim-to-real error where there is one")
    statement_simulation_only: AngleStatement
    grid_deg: Annotated[Floats, ArraySpec("<f8", ("angle",), "deg")]
    mean: Curve
    low95: Curve
    high95: Curve
    low95_simulation_only: Curve
    high95_simulation_only: Curve
    notes: tuple[str, ...] = ()
