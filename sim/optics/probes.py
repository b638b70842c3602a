"""Points of the coated face whose radiance is measured, on any deformed finger."""

from dataclasses import dataclass
from types import ModuleType
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from data_schemas.design import FingerDesign
from data_schemas.errors import SimulateError
from sim.optics.scene import band_film
from sim.surface_meshes.finger_shape import FingerShape

Floats = NDArray[np.float64]

_ALONG: Final = 4001  # points of the middle line among which the ends of the contact are sought
_MARGIN: Final = 0.05  # of the pad's length that probes stay away from its ends
_AT_ONCE: Final = 64  # points that are looked for together, among the triangles of their surroundings


@dataclass(frozen=True, slots=True)
class Probes:
    """Points of the coat and the rays in the gel that look at them; each array is (probe, 3).

    Attributes
    ----------
    points_mm
        On the deformed coat.
    origins_mm
        Halfway between inner face and coat, from where a point is looked at.
    directions
        Unit vectors from inner face to coat: the pad's normal where it is not deformed.
    """

    points_mm: Floats
    origins_mm: Floats
    directions: Floats


def probes_on(design: FingerDesign, shape: FingerShape, points_xz_mm: Floats) -> Probes:
    """Return the probes at points (x, z) of the undeformed pad, (probe, 2).

    Raises
    ------
    SimulateError
        When a point lies outside the pad, or the array has another shape.
    """
    points = np.asarray(points_xz_mm, dtype=np.float64)
    pad = design.pad
    if points.ndim != 2 or points.shape[1] != 2:
        raise SimulateError(f"probe_points_mm must hold (x, z) per probe, shape (probe, 2), got {points.shape}")
    outside = (np.abs(points[:, 0]) >= pad.width_mm / 2.0) | (points[:, 1] <= 0.0) | (points[:, 1] >= pad.length_mm)
    if outside.any():
        x, z = points[outside][0]
        raise SimulateError(
            f"the probe at x = {x:g} mm, z = {z:g} mm lies outside the pad (|x| < {pad.width_mm / 2.0:g} mm, 0 < z < "
            f"{pad.length_mm:g} mm); move it onto the pad"
        )
    uv = np.column_stack([points[:, 0] / pad.width_mm + 0.5, points[:, 1] / pad.length_mm])
    coat, inner = (_at(shape, name, shape.surfaces[name].vertices_mm, uv) for name in ("coat", "inner"))
    leg = coat - inner
    return Probes(coat, (coat + inner) / 2.0, leg / np.linalg.norm(leg, axis=1, keepdims=True))


def default_probe_points_mm(design: FingerDesign, shape: FingerShape) -> Floats:
    """Return four points (x, z): on both ends of the contact, a sixth of the width left and right of the middle.

    Without contact, or where the contact has no end on the pad, they lie beside the indenter's position, at most a
    twentieth of the length from the pad's ends.
    """
    pad = design.pad
    v = np.linspace(0.0, 1.0, _ALONG)
    distance = _at(shape, "coat", shape.contact_distance, np.column_stack([np.full_like(v, 0.5), v]))
    touching = pad.length_mm * v[distance <= 1.0]
    ends = [touching[0], touching[-1]] if touching.size else [design.indenter.position_mm] * 2
    ends = np.clip(ends, _MARGIN * pad.length_mm, (1.0 - _MARGIN) * pad.length_mm).tolist()
    return np.array([[x, z] for z in ends for x in (-pad.width_mm / 6.0, pad.width_mm / 6.0)])


def radiance_meter(renderer: ModuleType, probes: Probes, number: int) -> dict[str, Any]:
    """Return a one-pixel radiance meter that looks at a probe."""
    origin, direction = probes.origins_mm[number], probes.directions[number]
    transform = renderer.ScalarTransform4f().look_at(
        origin=origin.tolist(), target=(origin + direction).tolist(), up=[1.0, 0.0, 0.0]
    )
    sampler = {"type": "independent", "sample_count": 16}
    return {"type": "radiancemeter", "to_world": transform, "film": band_film(1, 1), "sampler": sampler}


def _at(shape: FingerShape, name: str, values: Floats, uv: Floats) -> Floats:
    """Return what a surface's vertices carry at texture coordinates (n, 2), linear over its own triangles."""
    surface = shape.surfaces[name]
    triangles = surface.triangles[_near(surface.uv[surface.triangles], uv)]
    corners, found = surface.uv[triangles], []
    for points in np.split(uv, range(_AT_ONCE, len(uv), _AT_ONCE)):
        near = _near(corners, points)
        # barycentric coordinates of every point in every triangle (point, triangle, 3)
        edges = np.linalg.inv(corners[near, 1:] - corners[near, :1])
        shares = np.einsum("pti,tij->ptj", points[:, None] - corners[near, 0], edges)
        weights = np.concatenate([1.0 - shares.sum(axis=-1, keepdims=True), shares], axis=-1)
        # none is negative in the triangle that holds the point, to rounding at its edges
        holds = weights.min(axis=-1).argmax(axis=1)
        at_corners = values[triangles[near][holds]]
        found.append(np.einsum("pk,pk...->p...", weights[np.arange(len(points)), holds], at_corners))
    return np.concatenate(found)


def _near(corners: Floats, points: Floats) -> NDArray[np.bool_]:
    """Return which triangles (n, 3, 2) reach into the rectangle around points (m, 2)."""
    low, high = corners.min(axis=1), corners.max(axis=1)
    return np.asarray(((low <= points.max(axis=0)) & (high >= points.min(axis=0))).all(axis=1))
