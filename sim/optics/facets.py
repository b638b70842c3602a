"""Small facets of the coat that stand at an angle, as an indentation tilts it, seen by the tactile camera."""

from dataclasses import dataclass
from types import ModuleType

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from data_schemas.camera_calibration import CameraCalibration
from data_schemas.design import FingerDesign
from data_schemas.errors import SimulateError
from sim.optics.pixel_maps import pixel_maps
from sim.optics.probes import Probes
from sim.surface_meshes.finger_shape import FingerShape

Floats = NDArray[np.float64]

# a pad's rim has edges of its own, and walls shine on it from next to nothing
_MARGIN = 0.1


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
        From :func:`sim.optics.variants.open_renderer`.
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
    share = 0.5 - _MARGIN
    x, z = np.linspace(-share, share, across) * pad.width_mm, (0.5 + np.linspace(-share, share, along)) * pad.length_mm
    grid = np.stack(np.meshgrid(x, z), axis=-1).reshape(-1, 2)
    step_mm = min(pad.width_mm / across, pad.length_mm / along)
    distance_mm, nearest = cKDTree(seen_mm).query(grid)
    chosen = np.unique(np.asarray(nearest)[np.asarray(distance_mm) < step_mm / 2.0])
    if 2 * len(chosen) < len(grid):
        raise SimulateError(
            f"the camera sees {len(chosen)} of {len(grid)} points spread over the pad, too few to judge a light angle "
            "by; check camera.field_of_view_deg, the mirror and whether light.position_mm stands in the way"
        )
    points, legs = maps.position_mm[on_coat][chosen], maps.last_leg[on_coat][chosen]
    # halfway back to the inner face of the undeformed pad: a start inside the gel
    back_mm = points[:, 1] / legs[:, 1] / 2.0
    probes = Probes(points, points - back_mm[:, None] * legs, legs)
    return SeenPoints(probes, maps.normal[on_coat][chosen], seen_mm[chosen])


def tilted(normals: Floats, slopes: Floats) -> Facets:
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
    if before.triangles.shape != after.triangles.shape or (before.triangles != after.triangles).any():
        raise SimulateError(
            f"the coat '{pressed.label}' has {len(after.triangles)} triangles and the coat '{rest.label}' "
            f"{len(before.triangles)}, or in another order: tilts need the same mesh, deformed and at rest"
        )
    sides = [s.vertices_mm[s.triangles[:, 1:]] - s.vertices_mm[s.triangles[:, :1]] for s in (before, after)]
    across, tilted_across = (np.cross(side[:, 0], side[:, 1]) for side in sides)
    turn = np.linalg.norm(np.cross(across, tilted_across), axis=1), (across * tilted_across).sum(axis=1)
    tilt_deg = np.degrees(np.arctan2(*turn))
    nearest = np.abs(tilt_deg[:, None] - tilts_deg).argmin(axis=1)
    area = np.bincount(nearest, np.linalg.norm(across, axis=1), len(tilts_deg))
    return np.asarray(area / area.sum())
