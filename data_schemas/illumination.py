"""The paper's optical experiments on one finger: emitter of the painted walls, number of panels, angle of the panel."""

from typing import Annotated, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from data_schemas.arrays import ArraySpec, check_dimensions
from data_schemas.design import FingerDesign
from data_schemas.model import Model, Record
from data_schemas.units import AngleDeg, LengthMm, PositionMm

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
    shape_error_rel: float = Field(description="the same with equal mean brightness (mean_ratio taken out)")
    noise_rel: float = Field(description="render noise of one baked image; the differences share its random numbers")


class FluorescentRendering(_Study):
    """The paper's emitter (level a, by the distance from the light) beside baked walls (level b)."""

    schema_version: ClassVar[int] = 2
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
        description="emitted radiance without contact, mean over the wall's height, in units of the panel's"
    )
    second_order_rel: Annotated[Floats, ArraySpec("<f8", ("wall", "z"))] = Field(
        description="part of the baked radiance that light of other paint has excited"
    )
    wall_error_rel: Annotated[Floats, ArraySpec("<f8", ("alternative", "wall"))] = Field(
        description="norm of the difference to the baked radiance along z at equal means, over its norm"
    )
    second_order_wall_share: dict[str, float]
    second_order_coat_share: dict[str, float] = Field(description="by band, of the light of the coat without contact")
    angles_deg: Annotated[Floats, ArraySpec("<f8", ("angle",), "deg")]
    wall_by_angle_rel: Annotated[Floats, ArraySpec("<f8", ("angle", "wall", "z"))] = Field(
        description="baked radiance at other light angles; the paper's rule knows no angle"
    )

    @model_validator(mode="after")
    def _lengths_agree(self) -> "FluorescentRendering":
        check_dimensions(self, {"levels": "alternative", "bands": "band", "walls": "wall"})
        return self


class Uniformity(Model):
    """How evenly the coat is lit without contact."""

    lights: str
    channel: str = Field(description="a band, or R, G, B of the camera")
    variation_rel: float = Field(description="standard deviation over the coat by area, over the mean; noise taken out")
    middle_variation_rel: float = Field(description="the same over the middle 70 % of the length")
    min_to_max_ratio: float = Field(description="darkest to brightest along z, means over the width")
    noise_rel: float = Field(description="render noise of one cell of the coat, over the mean")


class TwoLights(_Study):
    """One panel at the base against panels at base and tip."""

    schema_version: ClassVar[int] = 2
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

    @model_validator(mode="after")
    def _lengths_agree(self) -> "TwoLights":
        check_dimensions(self, {"lights": "alternative", "bands": "band", "channels": "channel"})
        return self


class BrightestAngle(Model):
    """Where a curve over the light angle has its maximum; 95 % limits over repeats (jackknife, Student's t)."""

    mirror: str
    probe: str
    band: str
    angle_deg: float
    low95_deg: float
    high95_deg: float
    loss_at_printed_rel: float = Field(description="what the printed angle costs, relative to the maximum")
    loss_at_printed_low95_rel: float
    loss_at_printed_high95_rel: float
    past_90_rel: float = Field(description="value at the last angle, relative to that at 90 deg")


class LightAngleIntensity(_Study):
    """Brightness beside the indenter over the angle of the panel, with and without the mirror."""

    schema_version: ClassVar[int] = 2
    written_by: ClassVar[str] = "'finray study light-angle'"

    mirrors: tuple[str, ...]
    probes: tuple[str, ...]
    bands: tuple[str, ...]
    probe_points_mm: Annotated[Floats, ArraySpec("<f8", ("probe", "3"), "mm")]
    led_depth_mm: LengthMm = Field(description="of the panel's centre below the inner face")
    angles_deg: Annotated[Floats, ArraySpec("<f8", ("angle",), "deg")]
    radiance_rel: Annotated[Floats, ArraySpec("<f8", ("mirror", "angle", "repeat", "probe", "band"))]
    elevation_deg: Annotated[Floats, ArraySpec("<f8", ("probe",), "deg")] = Field(
        description="of the refracted path from the panel's centre to the probe: where its direct light is brightest"
    )
    elevation_by_depth_deg: dict[str, tuple[float, ...]] = Field(
        description="the same per probe for other depths of the panel (mm)"
    )
    printed_angle_deg: AngleDeg
    maxima: tuple[BrightestAngle, ...]

    @model_validator(mode="after")
    def _lengths_agree(self) -> "LightAngleIntensity":
        check_dimensions(self, {"mirrors": "mirror", "probes": "probe", "bands": "band"})
        return self
