"""Whether a sample emits at all: the verdict, what it rests on, and the record of a sample that does not."""

from typing import Annotated, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from data_schemas.arrays import ArraySpec, check_dimensions
from data_schemas.estimate import Estimate
from data_schemas.model import Model, Record
from data_schemas.radiometry import Optics
from data_schemas.units import Fraction, WavelengthNm

Floats = NDArray[np.float64]
NO_SPECTRUM = (
    "'finray fit' found no emission in this sample, so there is no spectrum to simulate, map, compare or export. Give "
    "the fit of a fluorescent paint; if this should be one, look at its limit and at the laser, and measure it again"
)
_WHOLE_FROM_SD = 10.0
EmissionVerdict = Literal["emission measured", "no emission"]


class EmissionDetection(Model):
    """Whether band signals hold emission beyond reflected laser, leak and stray light, as ISO 11843 decides."""

    verdict: EmissionVerdict
    statistic_sd: float = Field(
        description="emission over its standard deviation in a sample without any, largest over many shapes"
    )
    threshold_sd: float = Field(description="what the stated share of simulated blanks exceeds")
    blanks_above: Fraction = Field(description="share of simulated blanks with at least this statistic")
    blanks: int = Field(ge=1, description="number of simulated blanks: same rig and reflectance, no emission")
    false_alarm: Fraction = Field(description="share of blanks that the threshold calls emission")
    yield_limit: Annotated[float, Field(ge=0.0)] | None = Field(
        description="energy yield that this session would have called emission with 95 % probability; none where "
        "emission was measured, whose own stray light would count"
    )
    limit_low_nm: WavelengthNm = Field(description="the limit holds for emission with its mode above this")
    limit_high_nm: WavelengthNm = Field(description="and below this")

    @property
    def measured(self) -> bool:
        """Whether emission was measured."""
        return self.verdict == "emission measured"

    @property
    def statement(self) -> str:
        """The verdict as one sentence."""
        size = f"{self.statistic_sd:.0f}" if self.statistic_sd >= _WHOLE_FROM_SD else f"{self.statistic_sd:.1f}"
        beyond = (
            f"beyond reflected laser, leak and stray light the signal is {size} standard deviations, "
            f"threshold {self.threshold_sd:.2g}"
        )
        if self.yield_limit is None:
            return f"{self.verdict}: {beyond}"
        return (
            f"{self.verdict}: yield below {self.yield_limit:.2g} with 95 % (modes from {self.limit_low_nm:.0f} to "
            f"{self.limit_high_nm:.0f} nm); {beyond}"
        )


class PaintWithoutEmission(Record):
    """A sample in whose band signals no emission was found: a limit of its yield in place of a spectrum."""

    schema_version: ClassVar[int] = 2
    written_by: ClassVar[str] = "'finray fit'"

    paint_name: str
    detection: EmissionDetection
    reflectance_at_laser: float = Field(ge=0.0, description="from the filter at the laser line; 1 where it is lost")
    reflectance: tuple[Estimate, ...] = Field(description="reflectance at each filter under the lamp")
    optics: Optics
    usable: Annotated[NDArray[np.bool_], ArraySpec("|b1", ("filter", "3"))]
    measured: Annotated[Floats, ArraySpec("<f8", ("filter", "3"))]
    measured_sd: Annotated[Floats, ArraySpec("<f8", ("filter", "3"))]
    blank: Annotated[Floats, ArraySpec("<f8", ("filter", "3"))] = Field(
        description="expected of a sample that reflects as much and emits nothing; 0 where not usable"
    )
    blank_sd: Annotated[Floats, ArraySpec("<f8", ("filter", "3"))] = Field(
        description="its standard deviation over noise, leaks, tolerances and calibration"
    )
    warnings: tuple[str, ...] = ()

    @model_validator(mode="after")
    def _lengths_agree(self) -> "PaintWithoutEmission":
        check_dimensions(self, {"optics.filters": "filter", "reflectance": "filter"})
        return self
