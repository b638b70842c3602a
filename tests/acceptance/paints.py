"""Calibrations to certify: the stored example with other numbers."""

from datetime import date
from functools import cache
from pathlib import Path

from data_schemas import Estimate, PaintCalibration
from data_schemas.storage import read_record

EXAMPLE = Path(__file__).parents[1] / "schemas" / "frozen" / "PaintCalibration"
MEASURED_ON = date(2026, 11, 24)


@cache
def example() -> PaintCalibration:
    path = EXAMPLE / f"v{PaintCalibration.schema_version}" / "example.json"
    return read_record(path, PaintCalibration)


def normal(estimate: float, sd: float) -> Estimate:
    return Estimate(
        estimate=estimate,
        sd=sd,
        low68=estimate - 0.994458 * sd,
        high68=estimate + 0.994458 * sd,
        low95=estimate - 1.959964 * sd,
        high95=estimate + 1.959964 * sd,
    )


def paint(**parameters: Estimate) -> PaintCalibration:
    """Return the example with other values of some quantities."""
    return example().model_copy(update={"parameters": {**example().parameters, **parameters}})
