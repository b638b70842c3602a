"""Light that small facets of the coat send to the camera: what arrives at a point is traced once for all of them.

Differences between facets are then free of the noise of separate paths, and another facet costs arithmetic only.
Import this module only after a compiled variant has been set (see :mod:`sim.optics.variants`).
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from sim.optics.even_points import even_points
from sim.optics.facets import Facets
from sim.optics.path_rules import LIFT_MM
from sim.optics.probes import Probes

if TYPE_CHECKING:
    from sim.optics.angle_paths import AnglePaths

Floats = NDArray[np.float64]
Floats32 = NDArray[np.float32]

_BANDS = 3


@dataclass(frozen=True, slots=True)
class FacetRays:
    """Directions from the coat into the gel, spread as the facets of a point reflect, and what each facet weights.

    ``directions`` is (probe, ray, 3); ``weight`` (probe, facet, ray, 3 bands) is f cos over the density of the ray.
    """

    directions: Floats32
    weight: Floats32


def facet_radiance(
    tracer: "AnglePaths", probes: Probes, facets: Facets, emitted: Floats, rays: int, seed: int
) -> Floats:
    r"""Return the band radiance (angle, facet, probe, 3) that facets of the coat send along the probes' rays.

    .. math:: L = \int f(i, o) \cos(i, n) L_i di

    over directions on the gel's side of the coat: a facet sees nothing below the mesh around it. The arriving
    radiance L_i is traced along one set of directions for all facets and angles, drawn from the mixture of what the
    facets reflect to; what comes straight from the panels is connected.

    Parameters
    ----------
    tracer
        Of the finger and all angles.
    probes
        Points on the coat and how they are looked at.
    facets
        Several at each probe.
    emitted
        Radiance of the walls for each angle, (angle, wall, along, up).
    rays
        Directions per probe.
    seed
        Random seed.
    """
    rng = np.random.default_rng(seed)
    coat = next(shape.bsdf() for shape in tracer.scene.shapes() if shape.id() == "coat")
    drawn = _drawn(coat, probes, facets, even_points(rays, 4, rng))
    points = len(probes.points_mm)
    starts = np.repeat(probes.points_mm - LIFT_MM * probes.directions, rays, axis=0)
    light = tracer.arriving(starts, drawn.directions.reshape(-1, 3), emitted, int(rng.integers(2**32)))
    light = light.reshape(points, rays, -1, _BANDS)
    sent = np.einsum("pfrb,prab->afpb", drawn.weight, light, optimize=True).astype(np.float64) / rays
    origins, looking = (np.repeat(v, rays, axis=0) for v in (probes.origins_mm, probes.directions))
    towards, straight = tracer.straight(origins, looking, rays, int(rng.integers(2**32)))
    panels = len(towards) // (points * rays)
    towards, straight = towards.reshape(panels, points, rays, 3), straight.reshape(panels, points, rays, -1)
    for k, normals in enumerate(facets.normals):
        for panel in range(panels):
            reflected = _reflected(coat, normals, probes.directions, towards[panel])[0][..., 2]
            sent[:, k, :, 2] += np.einsum("pr,pra->ap", reflected, straight[panel]) / rays
    return np.asarray(sent)


def _drawn(coat: Any, probes: Probes, facets: Facets, numbers: Floats) -> FacetRays:
    """Draw directions from the mixture of all facets' reflection, the same numbers at every probe."""
    points, rays = len(probes.points_mm), len(numbers)
    chosen = np.minimum((numbers[:, 3] * len(facets.normals)).astype(np.int64), len(facets.normals) - 1)
    si = _seen(np.swapaxes(facets.normals, 0, 1)[:, chosen].reshape(-1, 3), np.repeat(probes.directions, rays, axis=0))
    lobe, spot = (np.tile(v, (points, 1)).T.astype(np.float32) for v in (numbers[:, 2:3], numbers[:, :2]))
    sample, _ = coat.sample(mi.BSDFContext(), si, mi.Float(lobe[0]), mi.Point2f(np.ascontiguousarray(spot)))
    directions = si.to_world(sample.wo).numpy().T.reshape(points, rays, 3)
    # the probe's ray meets the coat from the gel: what leaves with it, instead of against it, is behind the mesh
    into_gel = (directions * facets.outward[:, None]).sum(axis=-1) < 0.0
    weight = np.empty((points, len(facets.normals), rays, _BANDS), dtype=np.float32)
    density = np.zeros((points, rays))
    for k, normals in enumerate(facets.normals):
        weight[:, k], pdf = _reflected(coat, normals, probes.directions, directions)
        density += pdf / len(facets.normals)
    usable = into_gel & (density > 0.0)
    weight *= (usable / np.where(usable, density, 1.0)).astype(np.float32)[:, None, :, None]
    # a path must start into the gel; its weight is zero
    directions = np.where(usable[..., None], directions, -probes.directions[:, None]).astype(np.float32)
    return FacetRays(directions, weight)


def _seen(normals: Floats, looking: Floats) -> Any:
    """Return interactions of rays with facets; frames turn smoothly with the normal."""
    normal, look = (mi.Vector3f(np.ascontiguousarray(v.T, dtype=np.float32)) for v in (normals, looking))
    si = mi.SurfaceInteraction3f()
    # the renderer's own tangent jumps with the normal, and the random numbers with it
    across = mi.Vector3f(1.0, 0.0, 0.0)
    s = dr.normalize(across - normal * dr.dot(normal, across))
    si.sh_frame = mi.Frame3f(s, dr.cross(normal, s), normal)
    si.wi = si.to_local(-look)
    return si


def _reflected(coat: Any, normals: Floats, looking: Floats, directions: Floats32) -> tuple[Floats32, Floats32]:
    """Return f cos per band (probe, ray, 3) and density (probe, ray) of one facet per probe for rays into the gel."""
    points, rays = directions.shape[:2]
    si = _seen(np.repeat(normals, rays, axis=0), np.repeat(looking, rays, axis=0))
    wo = si.to_local(mi.Vector3f(np.ascontiguousarray(directions.reshape(-1, 3).T, dtype=np.float32)))
    value, density = coat.eval_pdf(mi.BSDFContext(), si, wo, mi.Bool(True))
    return value.numpy().T.reshape(points, rays, _BANDS), np.array(density).reshape(points, rays)
