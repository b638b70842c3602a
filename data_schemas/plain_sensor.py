"""A classic tactile sensor: a flat or domed gel pad over coloured light panels, with a camera straight below (TOML).

Axes as in the finger: x across the pad, y from the inner (camera side) face into the gel, z along the pad; mm.
"""

from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from data_schemas.design import FingerDesign
from data_schemas.gel_pad import GelPad
from data_schemas.indenter import Indenter
from data_schemas.model import Model, Record
from data_schemas.optical_design import Coating
from data_schemas.units import AngleDeg, Fraction, LengthMm

Channel = Literal["red", "green", "blue"]
CHANNELS: tuple[Channel, ...] = ("red", "green", "blue")


class ColouredLight(Model):
    """A light panel beside and below the pad that shines in one channel of the picture."""

    channel: Channel
    azimuth_deg: AngleDeg = Field(
        default=0.0, description="where its light goes, seen along the pad: 0 along +z, 90 along +x"
    )
    angle_deg: AngleDeg = Field(
        default=40.0, description="of the panel's normal from the pad plane: 0 along the pad, 90 straight into it"
    )
    distance_mm: LengthMm = Field(default=14.0, description="of its centre from the axis through the pad's middle")
    depth_mm: LengthMm = Field(default=10.0, description="of its centre below the inner face")
    width_mm: LengthMm = 12.0
    height_mm: LengthMm = 4.0
    power_rel: Annotated[float, Field(gt=0.0, le=100.0)] = Field(default=1.0, description="radiance along the normal")
    beam_exponent: Annotated[float, Field(ge=1.0, le=50.0)] = Field(
        default=1.0, description="m of an intensity ~ cos^m of the angle from the normal; 1 is Lambertian"
    )

    @model_validator(mode="after")
    def _below_the_pad(self) -> "ColouredLight":
        reach_mm = self.height_mm / 2.0 * abs(float(np.cos(np.radians(self.angle_deg))))
        if reach_mm >= self.depth_mm:
            raise ValueError(
                f"depth_mm = {self.depth_mm:g} mm puts an edge of the {self.channel} panel at the inner face or above "
                f"it; it must be more than {reach_mm:.3g} mm for a panel of this height and angle"
            )
        return self


class CameraBelow(Model):
    """Pinhole camera on the axis through the pad's middle that looks straight at it.

    Columns of the picture run along +x, rows against z, as the camera sees the pad.
    """

    distance_mm: LengthMm = Field(default=40.0, description="of the pinhole below the inner face")
    field_of_view_deg: Annotated[float, Field(ge=5.0, le=120.0, json_schema_extra={"unit": "deg"})] = Field(
        default=30.0, description="over the width of the picture"
    )
    width_px: Annotated[int, Field(ge=8, le=4096)] = 160
    height_px: Annotated[int, Field(ge=8, le=4096)] = 160


def _three_lights() -> tuple[ColouredLight, ...]:
    """Return three lights a third of a turn apart."""
    return tuple(ColouredLight(channel=c, azimuth_deg=a) for c, a in zip(CHANNELS, (0.0, 120.0, -120.0), strict=True))


class PlainSensor(Record):
    """A classic sensor without fluorescence: every number is an assumption unless its user knows better.

    The gel's index is that at 589 nm in all channels: over the visible range it differs by 0.01.
    """

    name: str = "plain-20x20"
    pad: GelPad = GelPad(length_mm=20.0, width_mm=20.0, thickness_mm=4.0)
    coating: Coating = Coating(diffuse_share=0.8)
    walls: Literal["dark", "clear"] = Field(default="dark", description="sides of the gel: black-painted, or bare gel")
    wall_reflectance: Fraction = Field(default=0.05, description="of dark walls")
    box_reflectance: Fraction = Field(default=0.04, description="of the housing")
    lights: tuple[ColouredLight, ...] = Field(default_factory=_three_lights, min_length=1, max_length=3)
    camera: CameraBelow = CameraBelow()
    indenter: Indenter = Indenter(shape="ball", radius_mm=4.0, depth_mm=1.0, position_mm=10.0)

    @model_validator(mode="after")
    def _one_light_per_channel(self) -> "PlainSensor":
        channels = [light.channel for light in self.lights]
        if len(set(channels)) < len(channels):
            raise ValueError(f"lights: one panel per channel, got {', '.join(channels)}")
        return self

    @model_validator(mode="after")
    def _press_is_possible(self) -> "PlainSensor":
        self.pressed_pad()
        return self

    def pressed_pad(self) -> FingerDesign:
        """Return pad and indenter as a design whose coated face the analytic press can shape.

        Raises
        ------
        ValueError
            When the indenter lies beside the pad.
        """
        return FingerDesign(pad=self.pad, coating=self.coating, indenter=self.indenter)

    def middle_mm(self) -> NDArray[np.float64]:
        """Return the middle of the inner face, shape (3,)."""
        return np.array([0.0, 0.0, self.pad.length_mm / 2.0])
