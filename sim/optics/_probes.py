"""Points of the coated face whose radiance is measured, on any deformed finger.

As the coat is, or as small facets that stand at an angle, as an indentation tilts them, seen by the tactile camera.
"""

from dataclasses import dataclass
from types import ModuleType
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from data_schemas import CameraCalibration, FingerDesign, ImpossibleFingerError, SimulateError
from sim.optics._pixel_maps import pixel_maps, require_same_coat
from sim.optics._scene import band_film
from sim.surface_meshes import FingerShape

Floats = NDArray[np.float64]

_ALONG: Final = 4001  # points of a line along the pad among which the ends of the contact are sought
_MARGIN: Final = 0.05  # of the pad's length and width that probes stay away from its ends
_ON_EDGE: Final = 0.5**0.5  # of an ellipse's half-width: there its edge is as far along as across
_AT_ONCE: Final = 64  # points that are looked for together, among the triangles of their surroundings


@dataclass(frozen=True, slots=True)
class ProbePaths:
    """How many paths measure each probe.

    Attributes
    ----------
    samples
        Paths per probe and repeat.
    repeats
        Independent repeats, which give the noise.
    seed
        Random seed, >= 0.
    """

    samples: int = 4000
    repeats: int = 6
    seed: int = 0


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
        raise SimulateError(
            f"probe_points_mm must contain (x, z) for each probe, shape (probe, 2), got shape {points.shape}"
        )
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
    """Return four points (x, z) at both ends of the contact.

    They lie a sixth of the width left and right of the pad's middle line, at the ends that the contact has there. A
    contact that does not reach both of these lines, such as a ball's, has them on its own edge, at 0.71 of its
    half-width from its middle. Without contact they lie beside the indenter's position. All keep a twentieth of the
    pad's length and width from its ends.
    """
    pad = design.pad
    side_mm = pad.width_mm / 6.0
    x_mm = (shape.surfaces["coat"].uv[shape.contact_distance <= 1.0, 0] - 0.5) * pad.width_mm
    if x_mm.size == 0 or (x_mm.min() <= -side_mm and x_mm.max() >= side_mm):
        ends = _contact_ends_mm(design, shape, 0.0)
        points = [[x, z] for z in ends for x in (-side_mm, side_mm)]
    else:
        middle, half = (x_mm.min() + x_mm.max()) / 2.0, (x_mm.max() - x_mm.min()) / 2.0
        columns = [middle - half * _ON_EDGE, middle + half * _ON_EDGE]
        ends_of = [_contact_ends_mm(design, shape, x) for x in columns]
        points = [[x, ends[k]] for k in (0, 1) for x, ends in zip(columns, ends_of, strict=True)]
    low, high = [(_MARGIN - 0.5) * pad.width_mm, _MARGIN * pad.length_mm], (1.0 - _MARGIN) * pad.length_mm
    return np.clip(points, low, [-low[0], high])


def _contact_ends_mm(design: FingerDesign, shape: FingerShape, x_mm: float) -> tuple[float, float]:
    """Return where the contact begins and ends along a line of the pad; without contact, the indenter's position."""
    pad = design.pad
    v = np.linspace(0.0, 1.0, _ALONG)
    line = np.column_stack([np.full_like(v, x_mm / pad.width_mm + 0.5), v])
    touching = pad.length_mm * v[_at(shape, "coat", shape.contact_distance, line) <= 1.0]
    return (touching[0], touching[-1]) if touching.size else (design.indenter.position_mm,) * 2


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


# a pad's rim has edges of its own, and walls shine on it from next to nothing
_RIM_SHARE = 0.1


@dataclass(frozen=True, slots=True)
class SeenPoints:
    """Points of the coat that the camera sees, with the rays of their pixels.

    Attributes
    ----------
    probes
        The points, and the last leg of each pixel's ray in the gel.
    normals
        Outward unit normals of the coat, (probe, 3).
    places_mm
        (x, z) on the undeformed pad, (probe, 2).
    """

    probes: Probes
    normals: Floats
    places_mm: Floats


@dataclass(frozen=True, slots=True)
class Facets:
    """Small tilted facets of the coat at probes: normal of the coat around them, (probe, 3), and theirs.

    ``normals`` is (facet, probe, 3), outward as the coat's.
    """

    outward: Floats
    normals: Floats


def seen_points(
    design: FingerDesign,
    rest: FingerShape,
    renderer: ModuleType,
    across: int,
    along: int,
    calibration: CameraCalibration | None = None,
) -> SeenPoints:
    """Return the pixels' points nearest to a grid over what the camera sees of the undeformed pad.

    The grid spans the middle four fifths of the pad in both directions; a grid point that no pixel comes near to (half
    a grid step) is left out.

    Parameters
    ----------
    design, rest
        The finger, and its surfaces at rest.
    renderer
        From :func:`sim.optics.open_renderer`.
    across, along
        Points of the grid across and along the pad.
    calibration
        Of the camera; without it the ideal pinhole of the design.

    Raises
    ------
    SimulateError
        When the camera does not see the coat, or less than half of the grid.
    """
    maps, pad = pixel_maps(design, rest, rest, renderer, calibration), design.pad
    place = maps.coat_mm(design)[..., ::-1]
    on_coat = np.isfinite(place[..., 0])
    seen_mm = place[on_coat]
    share = 0.5 - _RIM_SHARE
    x, z = np.linspace(-share, share, across) * pad.width_mm, (0.5 + np.linspace(-share, share, along)) * pad.length_mm
    grid = np.stack(np.meshgrid(x, z), axis=-1).reshape(-1, 2)
    step_mm = min(pad.width_mm / across, pad.length_mm / along)
    distance_mm, nearest = cKDTree(seen_mm).query(grid)
    chosen = np.unique(np.asarray(nearest)[np.asarray(distance_mm) < step_mm / 2.0])
    if 2 * len(chosen) < len(grid):
        raise ImpossibleFingerError(
            f"the camera sees only {len(chosen)} of {len(grid)} points spread over the pad, too few to judge a light "
            "angle; check camera.field_of_view_deg, the mirror and whether the panel at light.position_mm is in the way"
        )
    points, legs = maps.position_mm[on_coat][chosen], maps.last_leg[on_coat][chosen]
    # halfway back to the inner face of the undeformed pad: a start inside the gel
    back_mm = points[:, 1] / legs[:, 1] / 2.0
    probes = Probes(points, points - back_mm[:, None] * legs, legs)
    return SeenPoints(probes, maps.normal[on_coat][chosen], seen_mm[chosen])


def tilted_facets(normals: Floats, slopes: Floats) -> Facets:
    r"""Return facets with slopes g, :math:`n \propto n_0 - g_x t_x - g_z t_z`.

    The slopes are those of the coat's height over the plane across :math:`n_0`; t_x points across the pad, t_z along it
    from the base.

    Parameters
    ----------
    normals
        Outward unit normals without tilt, (probe, 3), none of them along x.
    slopes
        Rise across and along the pad, (facet, 2).
    """
    across = np.array([1.0, 0.0, 0.0]) - normals[:, :1] * normals
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    along = np.cross(across, normals)
    turned = normals - slopes[:, None, :1] * across - slopes[:, None, 1:] * along
    return Facets(normals, turned / np.linalg.norm(turned, axis=-1, keepdims=True))


def tilt_shares(rest: FingerShape, pressed: FingerShape, tilts_deg: Floats) -> Floats:
    """Return the share of the coat's area whose tilt by a press is nearest to each of some tilts, (tilt,), sum 1.

    Raises
    ------
    SimulateError
        When the two shapes have different meshes.
    """
    before, after = rest.surfaces["coat"], pressed.surfaces["coat"]
    require_same_coat(pressed, rest)
    sides = [s.vertices_mm[s.triangles[:, 1:]] - s.vertices_mm[s.triangles[:, :1]] for s in (before, after)]
    across, tilted_across = (np.cross(side[:, 0], side[:, 1]) for side in sides)
    turn = np.linalg.norm(np.cross(across, tilted_across), axis=1), (across * tilted_across).sum(axis=1)
    tilt_deg = np.degrees(np.arctan2(*turn))
    nearest = np.abs(tilt_deg[:, None] - tilts_deg).argmin(axis=1)
    area = np.bincount(nearest, np.linalg.norm(across, axis=1), len(tilts_deg))
    return np.asarray(area / area.sum())
