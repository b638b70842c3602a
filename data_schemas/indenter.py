"""The indenter of a finger's design: its shape, place and push."""

from typing import Annotated, Literal

from pydantic import Field, model_validator

from data_schemas.model import Model
from data_schemas.units import AngleDeg, LengthMm, PositionMm

# below it not even a fine mesh has a patch
_LEAST_DEPTH_MM = 0.02


class Indenter(Model):
    """A rigid body that is pressed in from the coat, along the pad's normal, from where it first touches.

    A cylinder without ends (its axis across the pad, along x), a ball, a cuboid with rounded edges, or a closed
    triangle mesh in its own axes. ``rotation_deg`` turns it about x, then y, then z.
    """

    shape: Literal["cylinder", "ball", "cuboid", "mesh"] = "cylinder"
    radius_mm: LengthMm = Field(default=10.0, description="of a cylinder or a ball")
    size_mm: tuple[LengthMm, LengthMm, LengthMm] | None = Field(
        default=None, description="of a cuboid: across the pad, along its normal, along it"
    )
    edge_radius_mm: LengthMm = Field(default=1.0, description="of a cuboid's edges and corners")
    file: str | None = Field(default=None, description="of a mesh: closed STL in mm; relative to the design")
    depth_mm: Annotated[float, Field(ge=0.0, le=20.0, json_schema_extra={"unit": "mm"})] = Field(
        default=1.5, description=f"0 without a press, else at least {_LEAST_DEPTH_MM:g} mm"
    )
    position_mm: PositionMm = Field(default=35.0, description="of its middle (a mesh: its origin) along the pad")
    across_mm: PositionMm = Field(default=0.0, description="of its middle (a mesh: its origin) from the middle line")
    rotation_deg: tuple[AngleDeg, AngleDeg, AngleDeg] = (0.0, 0.0, 0.0)
    friction: Annotated[float, Field(ge=0.0, le=2.0, json_schema_extra={"unit": "1"})] = Field(
        default=0.0, description="Coulomb's coefficient between indenter and coat"
    )

    @model_validator(mode="after")
    def _shape_is_complete(self) -> "Indenter":
        for shape, name in (("cuboid", "size_mm"), ("mesh", "file")):
            if (getattr(self, name) is not None) != (self.shape == shape):
                state = "missing" if self.shape == shape else f"given for a {self.shape}"
                raise ValueError(f'{name} is {state}; it belongs to shape = "{shape}" and only to that')
        if 0.0 < self.depth_mm < _LEAST_DEPTH_MM:
            raise ValueError(
                f"depth_mm = {self.depth_mm:g} mm is less than a press that any mesh resolves ({_LEAST_DEPTH_MM:g} mm);"
                f" it looks like a number in metres: write {1e3 * self.depth_mm:g}"
            )
        if self.size_mm is not None and 2.0 * self.edge_radius_mm > min(self.size_mm):
            raise ValueError(
                f"edge_radius_mm = {self.edge_radius_mm:g} mm must be at most half the cuboid's least size, "
                f"{min(self.size_mm) / 2.0:g} mm"
            )
        return self

    def idle_fields(self) -> dict[str, str]:
        """Return the sizes of other shapes."""
        of_shapes = {"radius_mm": ("cylinder", "ball"), "edge_radius_mm": ("cuboid",)}
        return {
            name: f'it is of a {" or a ".join(shapes)}, not of shape = "{self.shape}"; leave it out, or change shape'
            for name, shapes in of_shapes.items()
            if self.shape not in shapes
        }
