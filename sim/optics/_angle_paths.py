"""Paths that serve all angles of a light at once: only where they meet the panel depends on its angle.

A path through the finger is traced once, in a scene whose panels are moved far away. Each of its segments in air, and
each connection of a surface point through the inner face, is then tested against the panel in every pose, by
arithmetic; a path ends for the poses that it has met. What painted walls emit is not needed either: a path notes where
it meets them, which makes the light of the walls a matrix product. Only what the panel itself reflects (5 % of what
falls onto it) is left out.

Light that small facets of the coat send to the camera is found the same way: what arrives at a point is traced once for
all of them. Differences between facets are then free of the noise of separate paths, and another facet costs arithmetic
only.

Import this module only after a compiled variant has been set (see :func:`sim.optics.open_renderer`).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from data_schemas import FingerDesign, LightPanel
from sim.optics._band_paths import WallGlow, WallTexels, band_paths, texels_around
from sim.optics._painted_walls import TEXELS_ALONG, TEXELS_UP, WALLS, LightOfTexels
from sim.optics._panel_light import DIRECT, FROM_EYE, FROM_START, FROM_SURFACE, STRAIGHT_OUT, PosedPanel, state_after
from sim.optics._path_rules import (
    LARGEST_SURVIVAL,
    LIFT_MM,
    MAX_DEPTH,
    NEWTON_STEPS,
    ROULETTE_DEPTH,
    SMALLEST_COS_AIR,
    EventLog,
    Tally,
    even_points,
    even_points_of_groups,
)
from sim.optics._probes import Facets, Probes
from sim.optics._refraction import refract_through
from sim.surface_meshes import FingerShape

Floats = NDArray[np.float64]

_FAR_MM = 1e6
# as many paths at once as fit into some hundred MB
_MOST_PATHS = 400_000
_TEXELS = len(WALLS) * TEXELS_ALONG * TEXELS_UP
# meetings of ended paths with walls that are noted at first, per path; where there are more, room is made for all
_MEETINGS_LOGGED = 0.25


@dataclass(frozen=True, slots=True)
class Received:
    """Means over the paths of each group.

    Attributes
    ----------
    led
        LED radiance, (group, angle), in units of the panel's.
    by_wall
        Radiance per radiance that a texel of a wall emits.
    """

    led: Floats
    by_wall: LightOfTexels


@dataclass(frozen=True, slots=True)
class Rays:
    """Rays in the gel with the random numbers of their first bounce, (ray, 3) each; groups follow each other."""

    origins_mm: Floats
    directions: Floats
    spread: Floats
    per_group: int
    start: int


class AnglePaths:
    """Tracer of a finger for several angles of its first light; further lights stay as they are."""

    def __init__(self, scene: Any, design: FingerDesign, shape: FingerShape, lights: Sequence[LightPanel]) -> None:
        self.scene, self.count = scene, len(lights)
        self.paths = band_paths(scene, design, shape)
        length_mm = design.pad.length_mm
        self.panels = [PosedPanel(lights, length_mm), *(PosedPanel([light], length_mm) for light in design.lights[1:])]
        parameters = mi.traverse(scene)
        for number in range(len(design.lights)):
            parameters[f"panel{number}.to_world"] = mi.Transform4f().translate([0.0, -_FAR_MM, 0.0])
        parameters.update()

    def trace(self, origins_mm: Floats, directions: Floats, per_group: int, seed: int, from_wall: bool) -> Received:
        """Trace rays of equally large groups, which follow each other.

        Parameters
        ----------
        origins_mm, directions
            Start and unit direction in the gel, (group * per_group, 3).
        per_group
            Rays per group.
        seed
            Random seed, 32 bit.
        from_wall
            Rays start on a wall: direct light of the panels through the inner face is left out.
        """
        groups, paths = len(origins_mm) // per_group, len(origins_mm)
        rng = np.random.default_rng(seed)
        # the first bounce decides whether a path meets the panel by the mirror, which is most of the noise
        spread = even_points_of_groups(groups, per_group, 3, rng)
        seeds = rng.integers(2**32, size=-(-paths // _MOST_PATHS)).tolist()
        rays = Rays(origins_mm, directions, spread, per_group, FROM_START if from_wall else FROM_EYE)
        log_length = max(1, round(_MEETINGS_LOGGED * paths))
        while True:
            led, by_wall = Tally(groups * self.count, mi), Tally(groups * _TEXELS, mi)
            kept_away = EventLog(log_length, 3, 3, mi)
            for number, chunk_seed in enumerate(seeds):
                self._trace_chunk(rays, number * _MOST_PATHS, chunk_seed, led, by_wall, kept_away)
            if int(kept_away.count[0]) <= log_length:
                break
            log_length = int(kept_away.count[0])  # the same paths again, with room for all that panels keep away
        of_led = np.array(led.sums, dtype=np.float64).reshape(groups, self.count) / per_group
        whole = by_wall.sums.numpy().reshape(groups, _TEXELS) / np.float32(per_group)
        return Received(of_led, LightOfTexels(whole, self._kept_away(kept_away, groups, per_group)))

    def _trace_chunk(self, rays: Rays, first: int, seed: int, led: Tally, by_wall: Tally, kept_away: EventLog) -> None:
        """Trace as many rays as are traced at once, from the first one on."""
        chunk = slice(first, first + _MOST_PATHS)
        o, d, spread = (
            np.ascontiguousarray(v[chunk].T, dtype=np.float32) for v in (rays.origins_mm, rays.directions, rays.spread)
        )
        sampler = mi.load_dict({"type": "independent"})
        sampler.seed(seed, o.shape[1])
        path = dr.arange(mi.UInt32, o.shape[1]) + first
        group = path // rays.per_group
        found = _follow(  # type: ignore[no-untyped-call]
            self, sampler, mi.Ray3f(mi.Point3f(o), mi.Vector3f(d)), mi.Point3f(spread),
            WallTexels(by_wall, kept_away, path, group), rays.start,
        )  # fmt: skip
        for k, radiance in enumerate(found):
            led.add(radiance, group * self.count + k)
        dr.eval(led.sums, by_wall.sums, kept_away.columns, kept_away.count)

    def _kept_away(self, log: EventLog, groups: int, per_group: int) -> tuple[csr_array, ...]:
        """Return what each panel pose keeps away, (group, texel) each, from where ended paths have met walls."""
        path, texel, ended, carried, s, t = log.rows()
        order = np.argsort(path, kind="stable")  # a lane's own rows are in order, lanes need not be
        path, texel, ended, carried, s, t = (column[order] for column in (path, texel, ended, carried, s, t))
        weight, column = (np.stack(v, axis=-1) for v in zip(*texels_around(texel, s, t), strict=True))
        row = np.repeat(path[:, None] // per_group, column.shape[1], axis=1)
        share = carried[:, None] * weight / per_group
        poses = [(ended >> k) & 1 == 1 for k in range(self.count)]
        return tuple(
            csr_array((share[here].ravel(), (row[here].ravel(), column[here].ravel())), shape=(groups, _TEXELS))
            for here in poses
        )

    def arriving(
        self, origins_mm: Floats, directions: NDArray[np.floating], emitted: Floats, seed: int
    ) -> NDArray[np.float32]:
        """Return the band radiance (ray, angle, 3) that arrives along rays from points of the coat, but for direct LED.

        Parameters
        ----------
        origins_mm, directions
            Start at the coat and unit direction into the gel, (ray, 3).
        emitted
            Radiance of the walls for each angle, (angle, wall, TEXELS_ALONG, TEXELS_UP).
        seed
            Random seed, 32 bit.
        """
        light = np.empty((len(origins_mm), self.count, 3), dtype=np.float32)
        rng = np.random.default_rng(seed)
        for start in range(0, len(origins_mm), _MOST_PATHS):
            chunk = slice(start, start + _MOST_PATHS)
            o, d = (np.ascontiguousarray(v[chunk].T, dtype=np.float32) for v in (origins_mm, directions))
            sampler = mi.load_dict({"type": "independent"})
            sampler.seed(int(rng.integers(2**32)), o.shape[1])
            walls = WallGlow(emitted, o.shape[1])
            ray, first = mi.Ray3f(mi.Point3f(o), mi.Vector3f(d)), mi.Point3f(0.0)
            led = _follow(self, sampler, ray, first, walls, FROM_SURFACE)  # type: ignore[no-untyped-call]
            dr.eval(led, walls.radiance.sums)
            light[chunk, :, :2] = np.array(walls.radiance.sums).reshape(-1, self.count, 2)
            light[chunk, :, 2] = np.stack([np.array(radiance) for radiance in led], axis=1)
        return light

    def straight(
        self, origins_mm: Floats, looking: Floats, per_group: int, seed: int
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Return directions (ray, 3) and LED radiance times solid angle (ray, angle) straight from the panels.

        Parameters
        ----------
        origins_mm, looking
            Starts in the gel and unit directions towards the points of the coat that are lit, (group * per_group, 3).
        per_group
            Rays per group, each to an evenly spread point of what panels may cover.
        seed
            Random seed, 32 bit.
        """
        o, d = (np.ascontiguousarray(v.T, dtype=np.float32) for v in (origins_mm, looking))
        si = self.scene.ray_intersect(mi.Ray3f(mi.Point3f(o), mi.Vector3f(d)))
        rng = np.random.default_rng(seed)
        directions, light = [], []
        for number, panel in enumerate(self.panels):
            spots = np.tile(even_points(per_group, 2, rng), (o.shape[1] // per_group, 1))
            spot = mi.Point2f(np.ascontiguousarray(spots.T, dtype=np.float32))
            reached, direction, weight, outside, length = self.connect(panel, si, spot, si.is_valid())
            seen = self.met(outside, length)
            sent = [dr.select(reached & here, weight * power, 0) for here, power in (pair[number] for pair in seen)]
            dr.eval(direction, sent)
            directions.append(direction.numpy().T)
            light.append(np.stack([np.array(value) for value in sent], axis=1))
        return np.concatenate(directions), np.concatenate(light)

    def met(self, ray: Any, before_mm: Any) -> list[list[tuple[Any, Any]]]:
        """Return (meets it first, radiance sent) per angle and panel for rays that end after a distance."""
        meets = [[pose.meet(ray) for pose in panel.poses] for panel in self.panels]
        found = []
        for k in range(self.count):
            here = [poses[min(k, len(poses) - 1)] for poses in meets]
            reach = [dr.select(inside & (at < before_mm), at, dr.inf) for inside, at, _ in here]
            first = reach[0]
            for other in reach[1:]:
                first = dr.minimum(first, other)
            found.append(
                [
                    ((at == first) & (at < dr.inf), panel.sent(cosine))
                    for panel, at, (_, _, cosine) in zip(self.panels, reach, here, strict=True)
                ]
            )
        return found

    def connect(self, panel: PosedPanel, si: Any, sample: Any, active: Any) -> tuple[Any, Any, Any, Any, Any]:
        """Return (reached, direction in the gel, solid angle, ray in air, its length) towards a panel in all poses."""
        paths, aim = self.paths, panel.aim
        point = aim.centre + (2.0 * sample.x - 1.0) * aim.across + (2.0 * sample.y - 1.0) * aim.along
        path = refract_through(
            paths.evaluate_face, *paths.point_and_foot(si, active), (point.x, point.y, point.z), paths.face, dr,
            NEWTON_STEPS, paths.index,
        )  # fmt: skip
        in_gel, in_air = mi.Vector3f(*path.to_crossing), mi.Vector3f(*path.to_panel)
        weight = path.weight * dr.maximum(-dr.dot(aim.normal, in_air), 0.0) * aim.area_mm2
        reached = active & (weight > 0.0)
        before, after = paths.gap / path.cos_gel, paths.gap / dr.maximum(path.cos_air, SMALLEST_COS_AIR)
        inside = mi.Ray3f(
            si.p + in_gel * LIFT_MM, in_gel, path.length_in_gel - LIFT_MM - before, si.time, si.wavelengths
        )
        reached &= ~self.scene.ray_test(inside, reached & (inside.maxt > 0.0))
        outside = mi.Ray3f(mi.Point3f(*path.crossing) + in_air * after, in_air)
        hit = self.scene.ray_intersect_preliminary(outside, coherent=False, active=reached)
        return reached, in_gel, weight, outside, dr.select(hit.is_valid(), hit.t, dr.inf)


@dr.syntax
def _follow(  # type: ignore[no-untyped-def]
    tracer, sampler, ray, first, walls, start
):
    """Follow paths; return the LED radiance of every angle and tell the walls what has met them."""
    paths, scene = tracer.paths, tracer.scene
    context = mi.BSDFContext()
    ray = mi.Ray3f(ray)
    throughput: Any = mi.Color3f(1)
    led = [mi.Float(0) for _ in range(tracer.count)]
    ended = mi.UInt32(0)
    depth, eta, active = mi.UInt32(0), mi.Float(1), mi.Bool(True)
    state = mi.UInt32(start)
    while dr.hint(active, max_iterations=MAX_DEPTH):
        si = scene.ray_intersect(ray, active)
        aimed_at = [(state == DIRECT) | ((state == STRAIGHT_OUT) & panel.aim.faces(ray)) for panel in tracer.panels]
        met = tracer.met(ray, si.t)
        for k in range(tracer.count):
            for (here, sent), counted in zip(met[k], aimed_at, strict=True):
                free = (ended & (1 << k)) == 0
                led[k] += dr.select(active & free & here & ~counted, throughput.z * sent, 0)
            for here, _ in met[k]:
                ended = dr.select(here, ended | (1 << k), ended)
        active &= si.is_valid()
        front = mi.Frame3f.cos_theta(si.wi) > 0
        is_red, is_green = si.shape == paths.red, si.shape == paths.green
        on_wall = active & front & (is_red | is_green)
        walls.met(si, is_green, throughput, ended, on_wall)
        active &= (depth + 1) < MAX_DEPTH
        bsdf = si.bsdf(ray)
        can_connect = active & (on_wall | (~front & (si.shape == paths.coat)))
        for panel in tracer.panels:
            reached, direction, weight, outside, length = tracer.connect(
                panel, si, sampler.next_2d(can_connect), can_connect
            )
            value = throughput.z * bsdf.eval(context, si, si.to_local(direction), reached).z * weight
            seen = tracer.met(outside, length)
            number = tracer.panels.index(panel)
            for k in range(tracer.count):
                here, sent = seen[k][number]
                led[k] += dr.select(reached & ((ended & (1 << k)) == 0) & here, value * sent, 0)
        lobe, spot = sampler.next_1d(active), sampler.next_2d(active)
        if dr.hint(start != FROM_SURFACE, mode="scalar"):
            lobe = dr.select(depth == 0, first.z, lobe)
            spot = dr.select(depth == 0, mi.Point2f(first.x, first.y), spot)
        chosen, chosen_weight = bsdf.sample(context, si, lobe, spot, active)
        smooth = mi.has_flag(chosen.sampled_type, mi.BSDFFlags.Delta)
        transmitted = smooth & mi.has_flag(chosen.sampled_type, mi.BSDFFlags.DeltaTransmission)
        throughput *= chosen_weight
        on_inner = si.shape == paths.inner
        if dr.hint(paths.face.film is not None, mode="scalar"):
            throughput *= dr.select(on_inner & smooth, paths.film_factor(si, transmitted), 1)
        eta *= dr.select(smooth, chosen.eta, 1.0)
        state = state_after(state, smooth, transmitted & on_inner & ~front)
        ray = si.spawn_ray(si.to_world(chosen.wo))
        depth += 1
        largest = dr.max(throughput)
        active &= largest > 0
        survival = dr.minimum(largest * eta * eta, LARGEST_SURVIVAL)
        survival = dr.select(depth >= ROULETTE_DEPTH, survival, 1.0)
        active &= sampler.next_1d(active) < survival
        throughput /= survival
    return led


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
