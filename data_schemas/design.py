"""The finger as a designer describes it (TOML): pad, indenter, light panel, mirror, coating, tactile camera.

Axes: x across the pad, y from the inner (camera side) face into the gel, z along the pad from the base; mm.
The light angle is the angle of the panel's normal from the pad plane: 0 along the pad, 90 straight into it.
"""

import difflib
from typing import Annotated, Literal

from pydantic import BaseModel, Field, field_validator, model_validator

from data_schemas.model import Model, Record
from data_schemas.units import AngleDeg, Fraction, LengthMm, PositionMm, WavelengthNm, WidthNm

Origin = Literal["measured", "data sheet", "paper", "assumed"]


class GelPad(Model):
    """A flat gel pad; sizes are always length x width."""

    length_mm: LengthMm = 70.0
    width_mm: LengthMm = 35.0
    thickness_mm: LengthMm = 6.0
    refractive_index: Annotated[float, Field(ge=1.0, le=2.0)] = 1.41


class Coating(Model):
    """Aluminium-flake coating on the touched face: a blend of a rough conductor and a diffuse part."""

    roughness_alpha: Annotated[float, Field(gt=0.0, le=1.0, description="GGX alpha")] = 0.25
    diffuse_share: Fraction = 0.35
    diffuse_reflectance: Fraction = 0.6


class LightPanel(Model):
    """Blue LED panel outside the gel, below the inner face."""

    angle_deg: AngleDeg = 30.0
    position_mm: tuple[PositionMm, PositionMm, PositionMm] = (0.0, -10.0, -1.0)
    width_mm: LengthMm = 20.0
    height_mm: LengthMm = 4.0
    peak_wavelength_nm: WavelengthNm = 450.0
    fwhm_nm: WidthNm = 20.0

    @model_validator(mode="after")
    def _outside_the_gel(self) -> "LightPanel":
        if self.position_mm[1] >= 0.0:
            raise ValueError(
                f"position_mm: y must be negative (outside the gel, whose inner face is y = 0 mm), got "
                f"{self.position_mm[1]} mm"
            )
        return self


class Mirror(Model):
    """Flexible mirror on the back beam, slightly convex."""

    reflectance: Fraction = 0.88
    radius_mm: Annotated[float, Field(gt=50.0, le=1e6, json_schema_extra={"unit": "mm"})] = 400.0


class TactileCamera(Model):
    """Camera at the base that sees the pad through the mirror."""

    field_of_view_deg: Annotated[float, Field(ge=20.0, le=150.0, json_schema_extra={"unit": "deg"})] = 120.0
    width_px: Annotated[int, Field(ge=64, le=4096)] = 640
    height_px: Annotated[int, Field(ge=48, le=4096)] = 480
    bit_depth: Literal[8, 10, 12, 14, 16] = 10
    response: str = Field(
        default="assumed",
        description="'assumed' (smooth stand-in curves) or a CSV file with the header "
        "wavelength_nm,red_percent,green_percent,blue_percent",
    )

    @model_validator(mode="after")
    def _whole_bayer_cells(self) -> "TactileCamera":
        if self.width_px % 2 or self.height_px % 2:
            raise ValueError(
                f"width_px and height_px must be even (Bayer cells), got {self.width_px} x {self.height_px}"
            )
        return self


class Indenter(Model):
    """A rigid cylinder across the pad (axis along x), pressed in from the coated side."""

    radius_mm: LengthMm = 10.0
    depth_mm: Annotated[float, Field(ge=0.0, le=20.0, json_schema_extra={"unit": "mm"})] = 1.5
    position_mm: PositionMm = 35.0


class FingerDesign(Record):
    """Everything the simulation needs to know of a finger apart from the paints."""

    name: str = "fin-ray-70x35"
    pad: GelPad = GelPad()
    coating: Coating = Coating()
    light: LightPanel = LightPanel()
    mirror: Mirror = Mirror()
    camera: TactileCamera = TactileCamera()
    indenter: Indenter = Indenter()
    origin: dict[str, Origin] = Field(
        default={
            "pad.length_mm": "paper",
            "pad.width_mm": "paper",
            "camera.field_of_view_deg": "paper",
            "indenter.radius_mm": "paper",
        },
        description="where a number comes from; every number that is not listed is assumed",
    )

    @field_validator("origin")
    @classmethod
    def _origins_of_known_fields(cls, origin: dict[str, Origin]) -> dict[str, Origin]:
        known = [
            f"{part}.{name}"
            for part, field in cls.model_fields.items()
            if isinstance(field.annotation, type) and issubclass(field.annotation, BaseModel)
            for name in field.annotation.model_fields
        ]
        for name in origin:
            if name not in known:
                near = difflib.get_close_matches(name, known, cutoff=0.5)
                hint = f"did you mean {' or '.join(near)}?" if near else f"fields are {', '.join(known)}"
                raise ValueError(f"'{name}' is no field of the design; {hint}")
        return origin

    @model_validator(mode="after")
    def _press_inside_the_pad(self) -> "FingerDesign":
        if self.indenter.depth_mm >= self.pad.thickness_mm:
            raise ValueError(
                f"indenter.depth_mm = {self.indenter.depth_mm} mm goes through the pad; it must be below "
                f"pad.thickness_mm = {self.pad.thickness_mm} mm"
            )
        if not 0.0 <= self.indenter.position_mm <= self.pad.length_mm:
            raise ValueError(
                f"indenter.position_mm = {self.indenter.position_mm} mm must lie on the pad (0 to "
                f"{self.pad.length_mm} mm)"
            )
        return self
