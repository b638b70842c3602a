"""Signed distances of rigid bodies with their normals and curvatures: exact geometry, no facets (mm)."""

import math
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from data_schemas.errors import SimulateError

FloatArray = NDArray[np.float64]

Distances = tuple[FloatArray, FloatArray, FloatArray]
"""Distance (m,), negative inside, in mm; its gradient (m, 3), the outward normal; its Hessian (m, 3, 3) in 1/mm."""

_ORTHONORMAL = 1e-9  # a rotation matrix may miss R R^T = 1 by this much


class Body(Protocol):
    """A rigid body in its own axes."""

    def distances(self, points_mm: FloatArray) -> Distances:
        """Return signed distance, gradient and Hessian at points (m, 3) in mm."""
        ...


def _check_positive(body: str, **sizes_mm: float) -> None:
    for name, value in sizes_mm.items():
        if not value > 0.0:
            raise SimulateError(f"{body}: {name} must be above 0 mm, got {value:g} mm")


def _check_edge(body: str, edge_mm: float, limit_mm: float) -> None:
    if not 0.0 < edge_mm <= limit_mm:
        raise SimulateError(
            f"{body}: edge_radius_mm must be above 0 and at most {limit_mm:g} mm, half its least size, got "
            f"{edge_mm:g} mm"
        )


@dataclass(frozen=True, slots=True)
class Sphere:
    """Sphere about the origin."""

    radius_mm: float

    def __post_init__(self) -> None:
        _check_positive("sphere", radius_mm=self.radius_mm)

    def distances(self, points_mm: FloatArray) -> Distances:
        """Return |x| - R, x / |x| and (1 - n n) / |x|."""
        r = np.linalg.norm(points_mm, axis=1)
        normal = points_mm / r[:, None]
        return r - self.radius_mm, normal, (np.eye(3) - _outer(normal, normal)) / r[:, None, None]


@dataclass(frozen=True, slots=True)
class Cylinder:
    """Cylinder about the x axis with its middle in the origin; endless without a half length, else of rounded rims."""

    radius_mm: float
    half_length_mm: float = math.inf
    edge_radius_mm: float = 1.0

    def __post_init__(self) -> None:
        _check_positive("cylinder", radius_mm=self.radius_mm, half_length_mm=self.half_length_mm)
        if self.half_length_mm < math.inf:
            _check_edge("cylinder", self.edge_radius_mm, min(self.radius_mm, self.half_length_mm))

    def distances(self, points_mm: FloatArray) -> Distances:
        """Return the distance from the rounded rectangle of half section, turned about the axis."""
        axis = np.array([1.0, 0.0, 0.0])
        radial = points_mm * (1.0 - axis)
        rho = np.linalg.norm(radial, axis=1)
        outward = radial / rho[:, None]
        around = np.eye(3) - _outer(outward, outward) - np.outer(axis, axis)
        if self.half_length_mm == math.inf:
            return rho - self.radius_mm, outward, around / rho[:, None, None]
        half = np.array([self.radius_mm, self.half_length_mm])
        distance, slope, curve = _rounded_box(np.stack([rho, points_mm[:, 0]], 1), half, self.edge_radius_mm)
        normal = slope[:, :1] * outward + slope[:, 1:] * axis
        along = np.broadcast_to(axis, outward.shape)
        mixed = _outer(outward, along)
        hessian = curve[:, 0, 0, None, None] * _outer(outward, outward) + curve[:, 1, 1, None, None] * _outer(
            along, along
        )
        hessian += curve[:, 0, 1, None, None] * (mixed + mixed.transpose(0, 2, 1))
        return distance, normal, hessian + (slope[:, 0] / rho)[:, None, None] * around


@dataclass(frozen=True, slots=True)
class RoundedBox:
    """Cuboid about the origin with rounded edges and corners; sizes include them."""

    half_sizes_mm: tuple[float, float, float]
    edge_radius_mm: float

    def __post_init__(self) -> None:
        _check_positive("cuboid", **dict(zip(("half_x_mm", "half_y_mm", "half_z_mm"), self.half_sizes_mm, strict=True)))
        _check_edge("cuboid", self.edge_radius_mm, min(self.half_sizes_mm))

    def distances(self, points_mm: FloatArray) -> Distances:
        """Return the distance from the box shrunk by the edge radius, less that radius."""
        return _rounded_box(points_mm, np.array(self.half_sizes_mm), self.edge_radius_mm)


def _rounded_box(points: FloatArray, half: FloatArray, edge: float) -> Distances:
    """Distances of a rounded box in two or three dimensions."""
    axes = points.shape[1]
    side = np.where(points >= 0.0, 1.0, -1.0)
    beyond = np.abs(points) - (half - edge)
    out = beyond > 0.0
    reach = np.where(out, beyond, 0.0)
    length = np.linalg.norm(reach, axis=1)
    outside = length > 0.0
    safe = np.where(outside, length, 1.0)
    nearest = np.eye(axes)[beyond.argmax(1)]
    normal = np.where(outside[:, None], reach / safe[:, None], nearest)
    hessian = (np.eye(axes) * out[:, :, None] - _outer(normal, normal)) / safe[:, None, None]
    hessian[~outside] = 0.0
    distance = np.where(outside, length, beyond.max(1)) - edge
    return distance, normal * side, hessian * _outer(side, side)


def _outer(a: FloatArray, b: FloatArray) -> FloatArray:
    return a[:, :, None] * b[:, None, :]


@dataclass(frozen=True, slots=True)
class Pose:
    """Place of a body's origin in mm and its rotation: columns are the body's axes in space."""

    position_mm: tuple[float, float, float]
    rotation: FloatArray = field(default_factory=lambda: np.eye(3))

    def __post_init__(self) -> None:
        r = self.rotation
        if r.shape != (3, 3) or np.abs(r @ r.T - np.eye(3)).max() > _ORTHONORMAL or np.linalg.det(r) < 0.0:
            raise SimulateError(f"a pose's rotation must be a proper rotation matrix (3, 3), got {r.tolist()}")

    def distances(self, body: Body, points_mm: FloatArray) -> Distances:
        """Return the distances of a body in this pose at points (m, 3) in space."""
        r = self.rotation
        distance, normal, hessian = body.distances((points_mm - np.array(self.position_mm)) @ r)
        return distance, normal @ r.T, r @ hessian @ r.T
