"""Band path tracer: panels connected through the gel's smooth curved inner face, and found by the mirror.

Where paths meet a painted wall they note the texels for later, or take up the light that it sends. Tracers are made of
a finger's scene, with the renderer's handle on them, or of a plain sensor's: coloured panels below a gel without
fluorescent paint, each connected with the gel through its inner face.

Import this module only after a compiled variant has been set (see :func:`sim.optics.open_renderer`): integrators
written in Python do not run in scalar variants, which use Mitsuba's own ``path`` instead.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from data_schemas import FingerDesign
from sim.optics._fluorescent_paths import fluorescent_integrator, painted_bsdfs
from sim.optics._mirror_guide import GUIDE_CHANCE, MirrorGuide, learn_guide
from sim.optics._painted_walls import FIRST_CHAINS, TEXELS_ALONG, TEXELS_UP, WALLS, last_band, wall_map
from sim.optics._panel_light import FROM_EYE, FROM_SURFACE, STRAIGHT_OUT, Panel, panel_point, panels_of, state_after
from sim.optics._path_rules import (
    LARGEST_SURVIVAL,
    LIFT_MM,
    MAX_DEPTH,
    NEWTON_STEPS,
    ROULETTE_DEPTH,
    SMALLEST_COS_AIR,
    EventLog,
    LedSearch,
    LookupTable,
    Tally,
    cell_at,
)
from sim.optics._position_map import PositionMap
from sim.optics._refraction import GelFace, film_transmittance, inner_face, refract_through
from sim.surface_meshes import FingerShape

# texels are fetched in packets of this many chains
_PACKET = 4
_SMALLEST_COSINE = 1e-4
# a wall's points, up and along: linear between them, a mesh bent by a press leaves them by micrometres
_WALL_POINTS = (17, 141)
# shadow rays stop before a wall by more than its mesh and these points differ
_BEFORE_WALL_MM = 0.05
# share of the points on a wall that are drawn evenly up it: weights stay bounded on facets that lean to the wall
_EVENLY, _GLOSS = 0.1, 0.2
_SMALLEST_MM = 1e-3


class BandPaths:
    """Unidirectional path tracer whose channels are chains of fluorescence, one LED light and two painted walls.

    A point in the gel and a panel point, drawn by the panels' light, are joined by the refracted path between them, see
    :func:`sim.optics.refract_through`. A path that later meets the panel by just that kind of route
    is given weight zero, so nothing is counted twice. What the painted walls emit is looked up where a path meets
    them: they are large and need no connection. Panels seen by the mirror are found along the directions of a
    :class:`sim.optics._mirror_guide.MirrorGuide`. Light that enters through the ends of the gel is left to chance.
    """

    def __init__(
        self, scene: Any, panels: Sequence[Panel], face: GelFace, max_depth: int = MAX_DEPTH, from_wall: bool = False
    ) -> None:
        self.max_depth, self.from_wall = max_depth, from_wall
        self.refractive, self.with_led = True, True
        self.guide: MirrorGuide | None = None
        self.chains: tuple[str, ...] = FIRST_CHAINS
        self.batch = dr.opaque(mi.UInt32, 0)
        self.face, self.evaluate_face = face, face.map.in_renderer(mi)
        self.index = mi.Float(face.index)
        self.gap = mi.Float(face.map.gap_mm + LIFT_MM)
        self.panels = list(panels)
        by_name = {shape.id(): shape for shape in scene.shapes()}
        self.inner, self.red, self.green, self.coat = (
            mi.ShapePtr(by_name[name]) for name in ("inner", "red", "green", "coat")
        )
        self.panel_shapes = [mi.ShapePtr(by_name[f"panel{k}"]) for k in range(len(self.panels))]
        self.film_index = 1.0 if face.film is None else face.film.refractive_index
        # numbers that vary between scenes must not become constants of the compiled kernel
        dr.make_opaque(self.index, self.gap, self.inner, self.red, self.green, self.coat, self.panel_shapes)

    def emit(self, emission: Mapping[str, NDArray[np.float64]]) -> None:
        """Set what the walls emit: per chain, radiance of the wall that the chain ends at.

        Of shape (TEXELS_ALONG, TEXELS_UP), or (batch, TEXELS_ALONG, TEXELS_UP) for the lanes that
        :meth:`divide_lanes` gives to each batch.
        """
        further = tuple(chain for chain in emission if chain not in FIRST_CHAINS)
        self.chains = FIRST_CHAINS + further
        self.of_wall = {wall: [c for c in self.chains if last_band(c) == wall] for wall in WALLS}
        self.packets = -(-max(len(chains) for chains in self.of_wall.values()) // _PACKET)
        batches = max([1, *(len(radiance) for radiance in emission.values() if np.ndim(radiance) > 2)])
        texels = np.zeros((batches, 2, TEXELS_ALONG, TEXELS_UP, self.packets * _PACKET), dtype=np.float32)
        for k, wall in enumerate(WALLS):
            for channel, chain in enumerate(self.of_wall[wall]):
                texels[:, k, ..., channel] = emission.get(chain, 0.0)
        self.texels = LookupTable(texels.reshape(-1, _PACKET), mi)
        self.texels_per_batch = dr.opaque(mi.UInt32, 2 * TEXELS_ALONG * TEXELS_UP if batches > 1 else 0)

    def divide_lanes(self, batch: Any) -> None:
        """Tell which batch of what the walls emit each lane of the next rays sees."""
        self.batch = batch

    def wall_radiance(self, si: Any, is_green: Any, active: Any) -> list[Any]:
        """Return the emission at wall points, bilinear between texel centres, one value per chain of the wall."""
        first, s, t = first_texel(si, is_green)
        first += self.batch * self.texels_per_batch
        radiance: list[Any] = []
        for packet in range(self.packets):
            corner = [
                self.texels.row((first + (b * TEXELS_UP + a)) * self.packets + packet, active)
                for b in (0, 1)
                for a in (0, 1)
            ]
            mixed = (1 - t) * ((1 - s) * corner[0] + s * corner[1]) + t * ((1 - s) * corner[2] + s * corner[3])
            radiance += [mixed[k] for k in range(_PACKET)]
        return radiance

    def foot(self, si: Any) -> tuple[Any, Any]:
        """Return the coordinates of the inner face below points of coat and painted walls."""
        return dr.select(si.shape == self.red, 0.0, dr.select(si.shape == self.green, 1.0, si.uv.x)), si.uv.y

    def point_and_foot(self, si: Any, active: Any) -> tuple[tuple[Any, Any, Any], tuple[Any, Any]]:
        """Return points of coat and painted walls and the coordinates of the inner face below them.

        Lanes that are not active hold numbers that were never written; they get any place on the face.
        """
        point, (u, v) = dr.select(active, si.p, 0.0), self.foot(si)
        return (point.x, point.y, point.z), (dr.select(active, u, 0.5), dr.select(active, v, 0.5))

    def connect(self, scene: Any, si: Any, sample: Any, active: Any) -> tuple[Any, Any, Any]:
        """Return (visible, direction in the gel, LED radiance x solid angle) of a panel point seen through the face."""
        point, (normal, exponent), weight = panel_point(self.panels, sample)
        path = refract_through(
            self.evaluate_face,
            *self.point_and_foot(si, active),
            (point.x, point.y, point.z),
            self.face,
            dr,
            NEWTON_STEPS,
            self.index,
        )
        in_gel, in_air = mi.Vector3f(*path.to_crossing), mi.Vector3f(*path.to_panel)
        cos_panel = dr.maximum(-dr.dot(normal, in_air), 0.0)
        sent = dr.power(cos_panel, exponent) if any(p.beamed for p in self.panels) else cos_panel
        weight = weight * path.weight * sent
        seen = active & (weight > 0.0)
        crossing = mi.Point3f(*path.crossing)
        before_face, after_face = self.gap / path.cos_gel, self.gap / dr.maximum(path.cos_air, SMALLEST_COS_AIR)
        inside = mi.Ray3f(
            si.p + in_gel * LIFT_MM, in_gel, path.length_in_gel - LIFT_MM - before_face, si.time, si.wavelengths
        )
        seen &= ~scene.ray_test(inside, seen & (inside.maxt > 0.0))
        outside = mi.Ray3f(
            crossing + in_air * after_face,
            in_air,
            path.length_in_air - after_face - LIFT_MM,
            si.time,
            si.wavelengths,
        )
        seen &= ~scene.ray_test(outside, seen & (outside.maxt > 0.0))
        return seen, in_gel, weight

    def film_factor(self, si: Any, transmitted: Any) -> Any:
        """Return what the film changes where a path meets the inner face: the scene knows a bare one."""
        cosine = dr.minimum(dr.abs(mi.Frame3f.cos_theta(si.wi)), 1.0)
        sine2 = 1.0 - cosine * cosine
        n: Any = self.index
        from_gel: Any = mi.Frame3f.cos_theta(si.wi) < 0.0
        other = dr.safe_sqrt(1.0 - sine2 * dr.select(from_gel, n * n, 1.0 / (n * n)))
        cos_gel, cos_air = dr.select(from_gel, cosine, other), dr.select(from_gel, other, cosine)
        cos_air = dr.maximum(cos_air, _SMALLEST_COSINE)
        relative = film_transmittance(cos_gel, cos_air, n, self.film_index)
        bare_reflectance: Any = mi.fresnel(dr.select(from_gel, -cosine, cosine), n)[0]
        reflected = (1.0 - (1.0 - bare_reflectance) * relative) / bare_reflectance
        return dr.select(transmitted, relative, reflected)

    @dr.syntax
    def sample(  # type: ignore[no-untyped-def]
        self, scene, sampler, ray, medium=None, active=True
    ):
        """Return radiance along rays: of the first three chains, whether anything was met, of the other chains."""
        ray = mi.Ray3f(ray)
        throughput: Any = mi.Color3f(1)
        led = mi.Float(0)
        reds, greens = [mi.Float(0) for _ in self.of_wall["red"]], [mi.Float(0) for _ in self.of_wall["green"]]
        depth, eta = mi.UInt32(0), mi.Float(1)
        active, valid = mi.Bool(active), mi.Bool(False)
        state = mi.UInt32(FROM_SURFACE if self.from_wall else FROM_EYE)
        while dr.hint(active, max_iterations=self.max_depth):
            si = scene.ray_intersect(ray, active)
            valid |= si.is_valid() & (depth == 0)
            active &= si.is_valid()
            front = mi.Frame3f.cos_theta(si.wi) > 0
            if dr.hint(self.with_led, mode="scalar"):
                led += dr.select(active & front, throughput.z * self.panel_met(si, state), 0)
            is_red, is_green = si.shape == self.red, si.shape == self.green
            on_wall = active & front & (is_red | is_green)
            glow = self.wall_radiance(si, is_green, on_wall)
            for k in range(len(reds)):
                reds[k] += dr.select(on_wall & is_red, throughput.x * glow[k], 0)
            for k in range(len(greens)):
                greens[k] += dr.select(on_wall & is_green, throughput.y * glow[k], 0)
            active &= (depth + 1) < self.max_depth
            on_coat = active & ~front & (si.shape == self.coat)
            direction = mi.Vector3f(0, 0, 1)
            weight, seen = mi.Float(0), mi.Bool(False)
            if dr.hint(self.with_led and self.refractive, mode="scalar"):
                can_connect = on_wall | on_coat
                seen, direction, weight = self.connect(scene, si, sampler.next_2d(can_connect), can_connect & active)
            value, chosen, onward, usual_weight, chosen_weight = self.scatter(
                si, si.bsdf(ray), sampler, direction, on_coat, active
            )
            led += dr.select(seen, throughput.z * value.z * weight, 0)
            smooth = mi.has_flag(chosen.sampled_type, mi.BSDFFlags.Delta)
            transmitted = smooth & mi.has_flag(chosen.sampled_type, mi.BSDFFlags.DeltaTransmission)
            carried_usually = dr.max(throughput * usual_weight)
            throughput *= chosen_weight
            on_inner = si.shape == self.inner
            if dr.hint(self.face.film is not None, mode="scalar"):
                throughput *= dr.select(on_inner & smooth, self.film_factor(si, transmitted), 1)
            eta *= dr.select(smooth, chosen.eta, 1.0)
            state = state_after(state, smooth, transmitted & on_inner & ~front)
            ray = si.spawn_ray(onward)
            depth += 1
            active &= dr.max(throughput) > 0
            # a guided path carries little of the walls' light but may be about to meet a panel: judged as any other,
            # and not between smooth faces, where what it carries now says nothing of that
            survival = dr.minimum(carried_usually * eta * eta, LARGEST_SURVIVAL)
            survival = dr.select((depth >= ROULETTE_DEPTH) & ~smooth, survival, 1.0)
            active &= sampler.next_1d(active) < survival
            throughput /= survival
        return mi.Color3f(reds[0], greens[0], led), valid, reds[1:] + greens[1:]

    def scatter(
        self, si: Any, bsdf: Any, sampler: Any, aimed: Any, on_coat: Any, active: Any
    ) -> tuple[Any, Any, Any, Any, Any]:
        """Return (BSDF times cosine towards `aimed`, BSDF sample, way on, its weight without guide, its weight)."""
        context = mi.BSDFContext()
        value, _, chosen, chosen_weight = bsdf.eval_pdf_sample(
            context, si, si.to_local(aimed), sampler.next_1d(active), sampler.next_2d(active), active
        )
        onward = si.to_world(chosen.wo)
        if self.guide is None:
            return value, chosen, onward, chosen_weight, chosen_weight
        lobes = self.guide.lobes(si, on_coat)
        known = on_coat & self.guide.known(lobes)
        guided = known & (sampler.next_1d(on_coat) < GUIDE_CHANCE)
        drawn = self.guide.direction(lobes, sampler.next_1d(on_coat), sampler.next_2d(on_coat))
        onward = dr.select(guided, drawn, onward)
        along, material_density = bsdf.eval_pdf(context, si, si.to_local(onward), known)
        density = GUIDE_CHANCE * self.guide.density(lobes, onward) + (1.0 - GUIDE_CHANCE) * material_density
        usual = dr.select(material_density > 0.0, along / material_density, 0.0)
        mixed = dr.select(density > 0.0, along / density, 0.0)
        return (
            value,
            chosen,
            onward,
            dr.select(known, usual, chosen_weight),
            dr.select(known, mixed, chosen_weight),
        )

    def panel_met(self, si: Any, state: Any) -> Any:
        """Return the radiance of a panel that a path has met, none if its connection has counted it."""
        cosine = mi.Frame3f.cos_theta(si.wi)
        radiance = mi.Float(0)
        for panel, shape in zip(self.panels, self.panel_shapes, strict=True):
            beam: Any = dr.power(cosine, panel.exponent - 1) if panel.beamed else 1.0
            sent = beam * panel.radiance
            radiance = dr.select(si.shape == shape, sent, radiance)
        return dr.select(state == STRAIGHT_OUT, 0, radiance) if self.refractive else radiance


@dr.syntax
def by_smooth_faces(paths, scene, sampler, ray, carried):  # type: ignore[no-untyped-def]
    """Return the panels' light along rays from the coat by smooth surfaces alone, but for what comes straight."""
    context, ray, carried = mi.BSDFContext(), mi.Ray3f(ray), mi.Float(carried)
    led, depth, state = mi.Float(0), mi.UInt32(0), mi.UInt32(FROM_SURFACE)
    active = carried > 0.0
    while dr.hint(active, max_iterations=MAX_DEPTH):
        si = scene.ray_intersect(ray, active)
        active &= si.is_valid()
        front = mi.Frame3f.cos_theta(si.wi) > 0
        led += dr.select(active & front, carried * paths.panel_met(si, state), 0)
        chosen, weight = si.bsdf(ray).sample(context, si, sampler.next_1d(active), sampler.next_2d(active), active)
        smooth = mi.has_flag(chosen.sampled_type, mi.BSDFFlags.Delta)
        transmitted = smooth & mi.has_flag(chosen.sampled_type, mi.BSDFFlags.DeltaTransmission)
        carried *= weight.z
        on_inner = si.shape == paths.inner
        if dr.hint(paths.face.film is not None, mode="scalar"):
            carried *= dr.select(on_inner & smooth, paths.film_factor(si, transmitted), 1)
        state = state_after(state, smooth, transmitted & on_inner & ~front)
        ray = si.spawn_ray(si.to_world(chosen.wo))
        depth += 1
        active &= smooth & (carried > 0.0) & (depth < MAX_DEPTH)
    return led


Floats = NDArray[np.float64]


def first_texel(si: Any, is_green: Any) -> tuple[Any, Any, Any]:
    """Return number, and share of the way up and along to the next ones, of the texel below and before wall points.

    Texels of the red wall come first, then those of the green one, (along, up) each.
    """
    x = dr.clip(si.uv.x * TEXELS_UP - 0.5, 0.0, TEXELS_UP - 1.0)
    y = dr.clip(si.uv.y * TEXELS_ALONG - 0.5, 0.0, TEXELS_ALONG - 1.0)
    i, j = cell_at(x, TEXELS_UP - 1), cell_at(y, TEXELS_ALONG - 1)
    first = (dr.select(is_green, mi.UInt32(TEXELS_ALONG), mi.UInt32(0)) + j) * TEXELS_UP + i
    return first, x - mi.Float(i), y - mi.Float(j)


class LitWalls:
    """The radiance of both walls in all channels, and points drawn on them by the light they send to a place.

    Parameters
    ----------
    radiance
        Shape (batch, wall, TEXELS_ALONG, TEXELS_UP, channel).
    shape
        Where the walls are.
    thickness_mm, length_mm
        Sizes of the pad: they shape the density of the points only.
    """

    def __init__(self, radiance: Floats, shape: FingerShape, thickness_mm: float, length_mm: float) -> None:
        batches, _, _, _, self.channels = radiance.shape
        self.packets = -(-self.channels // _PACKET)
        texels = np.zeros((*radiance.shape[:-1], self.packets * _PACKET), dtype=np.float32)
        texels[..., : self.channels] = radiance
        self.texels = LookupTable(texels.reshape(-1, _PACKET), mi)
        self.per_batch = dr.opaque(mi.UInt32, 2 * TEXELS_ALONG * TEXELS_UP if batches > 1 else 0)
        self.height, self.length = mi.Float(thickness_mm), mi.Float(length_mm)
        self.points = LookupTable(np.concatenate([_wall_points(wall_map(shape, wall)) for wall in WALLS]), mi)
        dr.make_opaque(self.height, self.length)

    def at(self, place: Any, is_green: Any, batch: Any, active: Any) -> list[Any]:
        """Return the radiance of wall points (what has ``uv``), one value per channel."""
        first, s, t = first_texel(place, is_green)
        first += batch * self.per_batch
        radiance: list[Any] = []
        for packet in range(self.packets):
            a, b, c, d = (
                self.texels.row((first + (j * TEXELS_UP + i)) * self.packets + packet, active)
                for j in (0, 1)
                for i in (0, 1)
            )
            mixed = (1 - t) * ((1 - s) * a + s * b) + t * ((1 - s) * c + s * d)
            radiance += [mixed[k] for k in range(_PACKET)]
        return radiance[: self.channels]

    def place(self, wall: int, u: Any, v: Any, active: Any) -> tuple[Any, Any, Any]:
        """Return points of a wall and their derivatives by u (up) and v (along)."""
        across, along = (count - 1 for count in _WALL_POINTS)
        x, y = u * across, v * along
        i, j = cell_at(x, across), cell_at(y, along)
        s, t = x - mi.Float(i), y - mi.Float(j)
        first = (wall * (along + 1) + j) * (across + 1) + i
        a, b, c, d = (
            mi.Vector3f(row.x, row.y, row.z)
            for row in (
                self.points.row(first + step, active) for step in (0, 1, across + 1, across + 2)
            )
        )  # fmt: skip
        point = (1 - t) * ((1 - s) * a + s * b) + t * ((1 - s) * c + s * d)
        return point, ((1 - t) * (b - a) + t * (d - c)) * across, ((1 - s) * (c - a) + s * (d - b)) * along

    def aim(self, scene: Any, si: Any, wall: int, sample: Sequence[Any], active: Any) -> tuple[Any, Any, Any, Any]:
        r"""Return (seen, direction, solid angle per point, place) of a point drawn on a wall from points of the coat.

        With the distance d from the wall at the coat, a depth t below it and a place z along, the light of an even wall
        on an even coat is :math:`t d / (d^2 + t^2 + z^2)^2 dt dz`: with :math:`D^2 = d^2 + t^2`, t is drawn by
        :math:`t d / D^3`, as a matt coat is lit, for some points by :math:`t / D^2`, as a glossy one sees further up,
        and for a few evenly; z by :math:`D / (D^2 + z^2)`.
        """
        rim = self.place(wall, mi.Float(1), si.uv.y, active)[0]
        d = dr.maximum(dr.norm(rim - si.p), _SMALLEST_MM)
        reach, furthest = 0.5 * dr.log(1.0 + dr.square(self.height / d)), dr.sqrt(d * d + dr.square(self.height))
        gloss = d * dr.safe_sqrt(dr.exp(2.0 * reach * sample[0]) - 1.0)
        matt = d * dr.safe_sqrt(dr.square(1.0 / (1.0 - sample[0] * (1.0 - d / furthest))) - 1.0)
        t = dr.select(sample[2] < _EVENLY + _GLOSS, gloss, matt)
        t = dr.select(sample[2] < _EVENLY, sample[0] * self.height, dr.minimum(t, self.height))
        d2 = d * d + t * t
        up_density = _GLOSS / reach + (1.0 - _EVENLY - _GLOSS) * d / (dr.sqrt(d2) * (1.0 - d / furthest))
        up_density = up_density * t / d2 * self.height + _EVENLY
        across = dr.sqrt(d2)
        from_end = si.uv.y * self.length
        low, high = dr.atan(-from_end / across), dr.atan((self.length - from_end) / across)
        z = across * dr.tan(low + (high - low) * sample[1])
        along_density = across / (across * across + z * z) / (high - low) * self.length
        u, v = 1.0 - t / self.height, dr.clip(si.uv.y + z / self.length, 0.0, 1.0)
        point, du, dv = self.place(wall, u, v, active)
        way = point - si.p
        r2: Any = dr.maximum(dr.squared_norm(way), _SMALLEST_MM**2)
        r = dr.sqrt(r2)
        direction = way / r
        # |n . direction| dA = |(du x dv) . direction| du dv
        solid_angle = dr.abs(dr.dot(dr.cross(du, dv), direction)) / (r2 * up_density * along_density)
        ray = si.spawn_ray(direction)
        ray.maxt = dr.maximum(r - _BEFORE_WALL_MM, 0.0)
        seen = active & (solid_angle > 0.0)
        seen &= ~scene.ray_test(ray, seen & (r > 2.0 * _BEFORE_WALL_MM))
        return seen, direction, solid_angle, _Place(mi.Point2f(u, v))


@dataclass(frozen=True, slots=True)
class _Place:
    """Texture coordinates, as those of an interaction."""

    uv: Any


def _wall_points(where: PositionMap) -> Floats:
    """Return points of a wall, (along * up, 4), the last number zero."""
    u, v = (np.linspace(0.0, 1.0, count) for count in _WALL_POINTS)
    points = where.positions_mm(np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2))
    return np.column_stack([points, np.zeros(len(points))])


class WallTexels:
    """Adds up, per group, what paths carry to the texels of the walls, and logs what the panels keep away from them."""

    def __init__(self, by_wall: Tally, kept_away: EventLog, path: Any, group: Any) -> None:
        self.by_wall, self.kept_away, self.path, self.group = by_wall, kept_away, path, group

    def met(self, si: Any, is_green: Any, throughput: Any, ended: Any, active: Any) -> None:
        """Note that paths have met a wall; for the angles whose bits are set in ``ended`` they had met the panel."""
        carried = dr.select(is_green, throughput.y, throughput.x)
        first, s, t = first_texel(si, is_green)
        own = first + self.group * (2 * TEXELS_ALONG * TEXELS_UP)
        for weight, texel in texels_around(own, s, t):
            self.by_wall.add(carried * weight, texel, active)
        self.kept_away.add([self.path, first, ended, carried, s, t], active & (ended != 0))


class WallGlow:
    """Adds up what known walls send along each path: radiance (path, angle, 2)."""

    def __init__(self, emitted: Floats, paths: int) -> None:
        self.count = len(emitted)
        self.texels = LookupTable(emitted.reshape(-1, 1), mi)
        self.radiance = Tally(paths * self.count * 2, mi)
        self.path = dr.arange(mi.UInt32, paths)

    def met(self, si: Any, is_green: Any, throughput: Any, ended: Any, active: Any) -> None:
        """Add the emission where paths have met a wall, as :meth:`BandPaths.wall_radiance` reads it."""
        carried = dr.select(is_green, throughput.y, throughput.x)
        around = texels_around(*first_texel(si, is_green))
        per_angle = 2 * TEXELS_ALONG * TEXELS_UP
        for k in range(self.count):
            here = active & ((ended & (1 << k)) == 0)
            glow = mi.Float(0)
            for weight, texel in around:
                glow += weight * self.texels.row(texel + k * per_angle, here)
            band = (self.path * self.count + k) * 2 + dr.select(is_green, mi.UInt32(1), mi.UInt32(0))
            self.radiance.add(carried * glow, band, here)


def texels_around(first: Any, s: Any, t: Any) -> list[tuple[Any, Any]]:
    """Return weight and number of the four texels around wall points, from :func:`first_texel`.

    They are read as by :meth:`BandPaths.wall_radiance`.
    """
    return [
        (along * up, first + (b * TEXELS_UP + a))
        for b, along in ((0, 1.0 - t), (1, t))
        for a, up in ((0, 1.0 - s), (1, s))
    ]


def band_paths(
    scene: Any,
    design: FingerDesign,
    shape: FingerShape,
    emission: Mapping[str, NDArray[np.float64]] | None = None,
    led: LedSearch | None = None,
    max_depth: int = MAX_DEPTH,
    guide: MirrorGuide | None = None,
) -> BandPaths:
    """Return the path tracer of a scene, whose channels are its ``chains``.

    Parameters
    ----------
    scene
        From :func:`sim.optics._scene.finger_scene`; emitters of its walls are not looked at.
    design, shape
        Panels, pad and the shape of the inner face.
    emission
        What the walls emit per chain, see :data:`sim.optics.WallLight`; dark by default.
    led
        How the panels' light is found; by default from the camera or a probe, through the inner face.
    max_depth
        Longest path in surfaces; below 30 the painted bands lose light.
    guide
        From :func:`mirror_guide` for this scene: the same mean, less noise of the LED's light.
    """
    face, led = inner_face(design, shape), led or LedSearch()
    paths = BandPaths(scene, panels_of(design, face), face, max_depth, led.from_wall)
    paths.refractive, paths.with_led = led.refractive, led.counted
    paths.emit(emission or {})
    paths.guide = guide if led.counted else None
    return paths


def band_integrator(
    scene: Any,
    design: FingerDesign,
    shape: FingerShape,
    emission: Mapping[str, NDArray[np.float64]] | None = None,
    **options: Any,
) -> Any:
    """Return the same as an integrator of the renderer, which has the ``chains`` too; options are those of the paths.

    Its first three channels are the chains led>red, led>green and led, the others ``aov_names()``.
    """
    paths = band_paths(scene, design, shape, emission, **options)

    class BandIntegrator(mi.SamplingIntegrator):
        """The renderer's handle on the paths; a class of the variant that is set, for others refuse it."""

        chains = paths.chains

        def sample(  # type: ignore[no-untyped-def]
            self, scene, sampler, ray, medium=None, active=True
        ):
            """Return the radiance of the chains along rays (called by the renderer)."""
            return paths.sample(scene, sampler, ray, medium, active)  # type: ignore[no-untyped-call]

        def aov_names(self) -> list[str]:
            """Return the names of the channels beyond the first three chains."""
            return list(paths.chains[len(FIRST_CHAINS) :])

        def divide_lanes(self, batch: Any) -> None:
            """Tell which batch of what the walls emit each lane of the next rays sees."""
            paths.divide_lanes(batch)

    return BandIntegrator(mi.Properties())


def mirror_guide(scene: Any, design: FingerDesign, shape: FingerShape) -> MirrorGuide:
    """Return where the coating of a finger sees its panels by the mirror; for all integrators of this scene."""
    return learn_guide(scene, band_paths(scene, design, shape))


class ColouredPanels(BandPaths):
    """The connection of panels with the gel; radiance is a colour. Panels are drawn with equal probability."""

    def colour(self, colours: NDArray[np.float64], scene: Any) -> None:
        """Set the colour of each panel, shape (panel, 3), and know the ends of the gel."""
        self.colours = [mi.Color3f(*row.tolist()) for row in colours]
        by_name = {shape.id(): shape for shape in scene.shapes()}
        self.base, self.tip = (mi.ShapePtr(by_name[name]) for name in ("base", "tip"))
        dr.make_opaque(self.colours, self.base, self.tip)

    def foot(self, si: Any) -> tuple[Any, Any]:
        """Return the coordinates of the inner face below points of the coat and of all four walls."""
        u, v = super().foot(si)
        return u, dr.select(si.shape == self.base, 0.0, dr.select(si.shape == self.tip, 1.0, v))

    def connect(self, scene: Any, si: Any, sample: Any, active: Any) -> tuple[Any, Any, Any]:
        """Return (visible, direction in the gel, coloured radiance x solid angle) of a panel point."""
        seen, direction, weight = super().connect(scene, si, sample, active)
        colour = self.colours[0]
        for k in range(1, len(self.colours)):
            colour = dr.select(sample.x >= k / len(self.colours), self.colours[k], colour)
        return seen, direction, colour * weight

    def panel_met(self, si: Any, state: Any) -> Any:
        """Return the coloured radiance of a panel that a path has met, none if its connection has counted it."""
        colour = mi.Color3f(0)
        for panel_colour, shape in zip(self.colours, self.panel_shapes, strict=True):
            colour = dr.select(si.shape == shape, panel_colour, colour)
        return colour * super().panel_met(si, state)


class _PlainCarrier:
    """One throughput per channel; the dark walls are the only paint, and it reflects."""

    def __init__(self, wall_reflectance: float) -> None:
        self.reflectance = mi.Float(wall_reflectance)
        dr.make_opaque(self.reflectance)

    def start(self) -> Any:
        return mi.Color3f(1)

    def received(self, carried: Any, light: Any) -> Any:
        return carried * light

    def scattered(self, carried: Any, weight: Any) -> Any:
        return carried * weight

    def reradiated(self, carried: Any, si: Any, sampler: Any, paint: Any, painted: Any) -> Any:
        return carried * dr.select(painted, self.reflectance, 1.0)

    def largest(self, carried: Any) -> Any:
        return dr.max(carried)

    def panel_light(self, si: Any, radiance: Any) -> Any:
        return mi.Color3f(radiance)


def coloured_integrator(
    scene: Any,
    panels: Sequence[Panel],
    colours: NDArray[np.float64],
    face: GelFace,
    dark_walls: Sequence[str],
    wall_reflectance: float,
) -> Any:
    """Return the integrator of a plain sensor.

    Parameters
    ----------
    scene
        With the shapes "coat", "inner", "red", "green", "base", "tip" and "panel0", ...
    panels, colours
        Panels of equal shares, and their colours (panel, 3).
    face
        The inner face.
    dark_walls
        Names of the gel's faces that are painted dark; none where the walls are clear.
    wall_reflectance
        Of the dark walls.
    """
    connection = ColouredPanels(scene, panels, face)
    connection.colour(colours, scene)
    paints = painted_bsdfs(scene, dark_walls)
    return fluorescent_integrator(_PlainCarrier(wall_reflectance), paints, MAX_DEPTH, ROULETTE_DEPTH, connection)
