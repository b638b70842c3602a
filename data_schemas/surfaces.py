"""Surfaces of a finger, at rest or deformed: what the mechanics writes and the optics renders."""

from typing import Annotated, ClassVar

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from data_schemas.arrays import ArraySpec, check_dimensions
from data_schemas.model import Record

Counts = Annotated[NDArray[np.int64], ArraySpec("<i8", ("part",))]


class FingerSurfaces(Record):
    """Triangle meshes of a finger's parts, one after the other, in mm in the axes of the undeformed pad.

    Part k owns the next ``vertex_counts[k]`` vertices and ``triangle_counts[k]`` triangles, whose corners are counted
    within the part. Names and texture coordinates are those of :class:`sim.surface_meshes.finger_shape.FingerShape`.
    """

    schema_version: ClassVar[int] = 2
    written_by: ClassVar[str] = "'finray simulate'"

    name: str
    label: str = Field(description="where the shape comes from, for example 'at rest'")
    push_mm: float | None = Field(
        default=None, description="how far the indenter was pushed from first touch; none where it is not known"
    )
    parts: tuple[str, ...]
    vertex_counts: Counts
    triangle_counts: Counts
    vertices_mm: Annotated[NDArray[np.float64], ArraySpec("<f8", ("vertex", "3"), "mm")]
    rest_vertices_mm: Annotated[NDArray[np.float64], ArraySpec("<f8", ("vertex", "3"), "mm")] = Field(
        description="the same vertices without contact"
    )
    uv: Annotated[NDArray[np.float64], ArraySpec("<f8", ("vertex", "2"))]
    triangles: Annotated[NDArray[np.int64], ArraySpec("<i8", ("triangle", "3"))]
    contact_distance: Annotated[
        NDArray[np.float64], ArraySpec("<f8", ("coat vertex",), "contact half-width", allow_nan=True)
    ] = Field(description="per vertex of the coat; the contact is where it is at most 1, NaN without contact")

    @model_validator(mode="after")
    def _counts_add_up(self) -> "FingerSurfaces":
        check_dimensions(self, {"parts": "part"})
        for counts, rows in ((self.vertex_counts, self.vertices_mm), (self.triangle_counts, self.triangles)):
            if (counts < 0).any() or counts.sum() != len(rows):
                raise ValueError(f"the counts of the parts add up to {counts.sum()}, but there are {len(rows)} rows")
        return self
