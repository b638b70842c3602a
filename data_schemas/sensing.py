"""How a sensor senses: the map from colour to surface normal that its calibration presses taught."""

from typing import Annotated, ClassVar

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from data_schemas.arrays import ArraySpec, check_dimensions
from data_schemas.capture import Encoding
from data_schemas.model import Record
from data_schemas.units import LengthMm, RelativeUncertainty

Floats = NDArray[np.float64]


class NormalMapRecord(Record):
    """A polynomial from change of colour and place in the picture to the slope of the gel, with its held-out score.

    Terms as :func:`finray_calib.compare.normal_map.polynomial_terms` orders them. A Bayer capture counts as one pixel
    per 2 x 2 cell. Scores are over random halves of the presses: the share of the squared slopes that the map explains
    on the half that did not teach it, and the mean angle of its normals.
    """

    schema_version: ClassVar[int] = 2
    written_by: ClassVar[str] = "'finray study normal-map'"

    name: str
    degree: Annotated[int, Field(ge=1, le=6)]
    coefficients: Annotated[Floats, ArraySpec("<f8", ("term", "2"), "mm/mm")]
    lowest_change_rel: Annotated[Floats, ArraySpec("<f8", ("3",))]
    highest_change_rel: Annotated[Floats, ArraySpec("<f8", ("3",))]
    height_px: Annotated[int, Field(ge=1)]
    width_px: Annotated[int, Field(ge=1)]
    mm_per_px: LengthMm
    mm_per_px_u_rel: RelativeUncertainty | None = Field(
        default=None, description="relative standard uncertainty, as the captures state it; none: not known"
    )
    encoding: Encoding = Field(description="of the captures that taught it; it senses those of the same encoding only")
    presses: Annotated[int, Field(ge=1)]
    held_out_explained_rel: Annotated[Floats, ArraySpec("<f8", ("split",))]
    held_out_angle_deg: Annotated[Floats, ArraySpec("<f8", ("split",), "deg")]
    notes: tuple[str, ...] = ()

    @model_validator(mode="after")
    def _lengths_agree(self) -> "NormalMapRecord":
        check_dimensions(self)
        return self
