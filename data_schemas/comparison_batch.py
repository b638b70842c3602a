"""Many presses compared in one run: each pair's headline, their mean, and what failed."""

from typing import ClassVar

from pydantic import Field

from data_schemas.compare import Interval
from data_schemas.model import Model, Record


class ComparedPair(Model):
    """One press of a batch: its files, and either its report or why there is none."""

    name: str
    simulated: str
    captured: str
    report: str | None = Field(default=None, description="file of the report, relative to the batch")
    skill: Interval | None = Field(default=None, description="headline of the report")
    floor_skill: Interval | None = Field(default=None, description="what a repeat of the no-contact image would score")
    findings: tuple[str, ...] = ()
    error: str | None = Field(default=None, description="why this pair could not be compared")


class ComparisonBatch(Record):
    """Comparison of several simulated presses with their captures.

    The mean skill is over presses, each counting once; its interval draws presses with replacement, so that it says
    what other presses of this kind would give, which the intervals of single reports do not know.
    """

    schema_version: ClassVar[int] = 2
    written_by: ClassVar[str] = "'finray compare' with folders"

    pairs: tuple[ComparedPair, ...]
    headline_region: str | None = Field(description="None where no pair could be compared")
    mean_skill: Interval | None = Field(
        description="None with fewer than two compared pairs; an interval from 1 to 1 beside a larger estimate means "
        "that model and noise disagree"
    )
    worst: tuple[str, ...] = Field(default=(), description="names of the pairs of lowest skill, the lowest first")
    notes: tuple[str, ...] = ()
