"""A solid by its boundary, as CAD programs keep it: corners, edges between them, faces bounded by loops of edges."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from data_schemas.errors import SimulateError

Floats = NDArray[np.float64]
Loop = tuple[tuple[int, bool], ...]
"""Edges in the order in which they are run, each with whether it is run from its start to its end."""


@dataclass(frozen=True, slots=True)
class EllipseArc:
    """Arc centre + cos(t) u + sin(t) v, from the edge's start to its end with growing t; u and v are perpendicular."""

    centre_mm: Floats
    u_mm: Floats
    v_mm: Floats


@dataclass(frozen=True, slots=True)
class Edge:
    """Part of a curve between two corners; a straight line without an arc."""

    start: int
    end: int
    arc: EllipseArc | None = None


@dataclass(frozen=True, slots=True)
class Plane:
    """Plane through a point, with the unit normal that points out of the solid."""

    point_mm: Floats
    normal: Floats


@dataclass(frozen=True, slots=True)
class HollowCylinder:
    """Inside of a cylinder: the solid lies beyond it, seen from its axis."""

    centre_mm: Floats
    axis: Floats
    radius_mm: float


@dataclass(frozen=True, slots=True)
class HollowEllipsoid:
    """Inside of an ellipsoid's cap around the end of its y axis, for u and v up to the two tangents.

    Points (x/a, y/b, z/c) = (2u, 1 - u^2 - v^2, 2v) / (1 + u^2 + v^2): the unit sphere seen from its lower pole, where
    u and v are tangents of half the angle from the y axis.
    """

    centre_mm: Floats
    semi_axes_mm: Floats
    tan_half_across: float
    tan_half_along: float


@dataclass(frozen=True, slots=True)
class Face:
    """Part of a surface within its first loop and outside the others, each with the face on its left from outside."""

    surface: Plane | HollowCylinder | HollowEllipsoid
    loops: tuple[Loop, ...]


@dataclass(frozen=True, slots=True)
class Solid:
    """Corners (n, 3) in mm, edges and faces of one closed body.

    Raises
    ------
    SimulateError
        When an edge is not run exactly once in each direction.
    """

    corners_mm: Floats
    edges: tuple[Edge, ...]
    faces: tuple[Face, ...]

    def __post_init__(self) -> None:
        runs = sorted(run for face in self.faces for loop in face.loops for run in loop)
        if runs != [(edge, forward) for edge in range(len(self.edges)) for forward in (False, True)]:
            raise SimulateError("the solid is not closed: two faces must meet at every edge, one on each side of it")
