"""One number with its uncertainty."""

from typing import Annotated

from pydantic import Field

from data_schemas.model import Model


class Estimate(Model):
    """Posterior summary of one number: median, standard deviation and equal-tailed intervals."""

    estimate: float
    sd: Annotated[float, Field(ge=0.0)]
    low68: float
    high68: float
    low95: float
    high95: float
