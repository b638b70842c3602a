"""Band path tracer: panels connected through the gel's smooth curved inner face, and found by the mirror.

Import this module only after a compiled variant has been set (see :mod:`sim.optics.variants`);
:mod:`sim.optics.band_integrator` makes tracers of a scene.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from sim.optics.curved_refraction import refract_through
from sim.optics.gel_face import GelFace, film_transmittance
from sim.optics.lookup_tables import LookupTable
from sim.optics.mirror_guide import GUIDE_CHANCE, MirrorGuide
from sim.optics.panel_light import Panel, panel_point
from sim.optics.path_rules import LARGEST_SURVIVAL, LIFT_MM, MAX_DEPTH, NEWTON_STEPS, ROULETTE_DEPTH, SMALLEST_COS_AIR
from sim.optics.path_states import FROM_EYE, FROM_SURFACE, STRAIGHT_OUT, state_after
from sim.optics.wall_emission import FIRST_CHAINS, TEXELS_ALONG, TEXELS_UP, WALLS, last_band
from sim.optics.wall_tallies import first_texel

# texels are fetched in packets of this many chains
_PACKET = 4
_SMALLEST_COSINE = 1e-4


class BandPaths:
    """Unidirectional path tracer whose channels are chains of fluorescence, one LED light and two painted walls.

    A point in the gel and a panel point, drawn by the panels' light, are joined by the refracted path between them, see
    :func:`sim.optics.curved_refraction.refract_through`. A path that later meets the panel by just that kind of route
    is given weight zero, so nothing is counted twice. What the painted walls emit is looked up where a path meets
    them: they are large and need no connection. Panels seen by the mirror are found along the directions of a
    :class:`sim.optics.mirror_guide.MirrorGuide`. Light that enters through the ends of the gel is left to chance.
    """

    def __init__(
        self, scene: Any, panels: Sequence[Panel], face: GelFace, max_depth: int = MAX_DEPTH, from_wall: bool = False
    ) -> None:
        self.max_depth, self.from_wall = max_depth, from_wall
        self.refractive, self.with_led = True, True
        self.guide: MirrorGuide | None = None
        self.chains: tuple[str, ...] = FIRST_CHAINS
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
        """Set what the walls emit: per chain, radiance (TEXELS_ALONG, TEXELS_UP) of the wall that the chain ends at."""
        further = tuple(chain for chain in emission if chain not in FIRST_CHAINS)
        self.chains = FIRST_CHAINS + further
        self.of_wall = {wall: [c for c in self.chains if last_band(c) == wall] for wall in WALLS}
        self.packets = -(-max(len(chains) for chains in self.of_wall.values()) // _PACKET)
        texels = np.zeros((2, TEXELS_ALONG, TEXELS_UP, self.packets * _PACKET), dtype=np.float32)
        for k, wall in enumerate(WALLS):
            for channel, chain in enumerate(self.of_wall[wall]):
                texels[k, ..., channel] = emission.get(chain, 0.0)
        self.texels = LookupTable(texels.reshape(-1, _PACKET), mi)

    def wall_radiance(self, si: Any, is_green: Any, active: Any) -> list[Any]:
        """Return the emission at wall points, bilinear between texel centres, one value per chain of the wall."""
        first, s, t = first_texel(si, is_green)
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
