"""Band path tracer with refractive next-event estimation through the gel's flat inner face.

Import this module only after an LLVM variant has been set (see :mod:`sim.optics.variants`): integrators written
in Python do not run in scalar variants, which use Mitsuba's own ``path`` instead.
"""

from typing import Any

import drjit as dr
import mitsuba as mi

from data_schemas.design import FingerDesign
from sim.optics.refracted_light import panel_frame
from sim.optics.scene import MAX_DEPTH, PANEL_RADIANCE_REL, ROULETTE_DEPTH

_NAME = "finray_band_paths"
_NEWTON_STEPS = 6
# points nearer to the inner face than this count as on it, mm
_FACE_MARGIN_MM = 1e-3
_SHORTEST_LATERAL_MM = 1e-3
_LARGEST_SURVIVAL = 0.95
# how a path left its last surface that was not a smooth interface
_FROM_SURFACE, _STRAIGHT_OUT, _OTHER_WAY, _FROM_EYE = 0, 1, 2, 3


class BandPaths(mi.SamplingIntegrator):
    """Unidirectional path tracer; emitters are met by chance, the panel through the inner face by construction.

    A point in the gel and a uniformly drawn panel point are joined by the one refracted path between them (Newton
    on Snell's law) with weight n^2 T A dw/dA, as in :func:`sim.optics.refracted_light.trace_crossing`. A path that
    later meets the panel by just that kind of route is given weight zero, so nothing is counted twice. The painted
    walls are large and need no such connection. Valid while the inner face is the plane y = 0.
    """

    def __init__(self, props: Any) -> None:
        super().__init__(props)
        self.max_depth = props.get("max_depth", MAX_DEPTH)
        self.roulette_depth = props.get("rr_depth", ROULETTE_DEPTH)
        self.refractive = True
        self.from_wall = props.get("from_wall", False)

    def aim(self, design: FingerDesign, refractive: bool = True) -> None:
        """Tell the integrator where panel and inner face are; `refractive` False leaves the panel to chance."""
        frame = panel_frame(design.light)
        self.refractive = refractive
        self.index, self.area = mi.Float(design.pad.refractive_index), mi.Float(frame.area_mm2)
        self.half_width, self.length = mi.Float(design.pad.width_mm / 2.0), mi.Float(design.pad.length_mm)
        self.centre = mi.Point3f(*frame.centre_mm.tolist())
        self.across = mi.Vector3f(*frame.half_across_mm.tolist())
        self.along = mi.Vector3f(*frame.half_along_mm.tolist())
        self.normal = mi.Normal3f(*frame.normal.tolist())
        # numbers that vary between scenes must not become constants of the compiled kernel
        dr.make_opaque(self.index, self.area, self.half_width, self.length)
        dr.make_opaque(self.centre, self.across, self.along, self.normal)

    def connect(self, scene: Any, si: Any, sample: Any, active: Any) -> tuple[Any, Any, Any]:
        """Return (visible, direction in the gel, n^2 T A dw/dA) of a panel point seen through y = 0."""
        panel_point = self.centre + (2 * sample.x - 1) * self.across + (2 * sample.y - 1) * self.along
        p: Any = si.p
        n: Any = self.index
        height, depth = dr.maximum(p.y, 1e-4), dr.maximum(-panel_point.y, 1e-4)
        offset_x, offset_z = panel_point.x - p.x, panel_point.z - p.z
        lateral = dr.maximum(dr.sqrt(offset_x * offset_x + offset_z * offset_z), _SHORTEST_LATERAL_MM)
        r = lateral * height / (height + n * depth)
        for _ in range(_NEWTON_STEPS):
            in_gel, in_air = dr.sqrt(r * r + height * height), dr.sqrt(dr.square(lateral - r) + depth * depth)
            residual = n * r / in_gel - (lateral - r) / in_air
            slope = n * height * height / (in_gel * in_gel * in_gel) + depth * depth / (in_air * in_air * in_air)
            r = dr.clip(r - residual / slope, 0, lateral)
        in_gel, in_air = dr.sqrt(r * r + height * height), dr.sqrt(dr.square(lateral - r) + depth * depth)
        cos_gel, cos_air = height / in_gel, depth / in_air
        crossing = mi.Point3f(p.x + offset_x * (r / lateral), 0.0, p.z + offset_z * (r / lateral))
        gel_direction, air_direction = (crossing - p) / in_gel, (panel_point - crossing) / in_air
        cos_panel = dr.maximum(-dr.dot(self.normal, air_direction), 0)
        spread = height / (cos_gel * cos_gel) + depth * n * cos_gel / (cos_air * cos_air * cos_air)
        solid_angle = self.area * (r / in_gel) * cos_panel / (lateral * spread * cos_air)
        seen = active & (p.y > _FACE_MARGIN_MM) & (solid_angle > 0)
        seen &= (dr.abs(crossing.x) < self.half_width) & (crossing.z > 0) & (crossing.z < self.length)
        seen &= ~scene.ray_test(
            mi.Ray3f(p + gel_direction * 2e-3, gel_direction, in_gel - 6e-3, si.time, si.wavelengths), seen
        )
        outside = mi.Ray3f(crossing + air_direction * 4e-3, air_direction, in_air - 8e-3, si.time, si.wavelengths)
        seen &= ~scene.ray_test(outside, seen)
        transmittance = 1 - mi.fresnel(cos_air, n)[0]
        return seen, gel_direction, n * n * transmittance * solid_angle

    @dr.syntax
    def sample(  # type: ignore[no-untyped-def]
        self, scene, sampler, ray, medium=None, active=True
    ):
        """Return radiance along rays in the three bands (called by Mitsuba)."""
        context = mi.BSDFContext()
        ray = mi.Ray3f(ray)
        throughput: Any = mi.Color3f(1)
        radiance: Any = mi.Color3f(0)
        depth, eta = mi.UInt32(0), mi.Float(1)
        active, valid, in_gel = mi.Bool(active), mi.Bool(False), mi.Bool(self.from_wall)
        state = mi.UInt32(_FROM_SURFACE if self.from_wall else _FROM_EYE)
        while dr.hint(active, max_iterations=self.max_depth):
            si = scene.ray_intersect(ray, active)
            valid |= si.is_valid() & (depth == 0)
            active &= si.is_valid()
            bsdf = si.bsdf(ray)
            emitted = si.emitter(scene).eval(si, active)
            if dr.hint(self.refractive, mode="scalar"):
                emitted = dr.select((state == _STRAIGHT_OUT) & in_gel, 0, emitted)
            radiance += dr.select(active, throughput * emitted, 0)
            active &= (depth + 1) < self.max_depth
            here_in_gel = si.p.y > _FACE_MARGIN_MM
            if dr.hint(self.refractive, mode="scalar"):
                can_connect = active & here_in_gel & mi.has_flag(bsdf.flags(), mi.BSDFFlags.Smooth)
                seen, direction, weight = self.connect(scene, si, sampler.next_2d(can_connect), can_connect)
                value = bsdf.eval(context, si, si.to_local(direction), seen) * mi.Color3f(0, 0, PANEL_RADIANCE_REL)
                radiance += dr.select(seen, throughput * value * weight, 0)
            chosen, chosen_weight = bsdf.sample(context, si, sampler.next_1d(active), sampler.next_2d(active), active)
            smooth = mi.has_flag(chosen.sampled_type, mi.BSDFFlags.Delta)
            throughput *= chosen_weight
            eta *= dr.select(smooth, chosen.eta, 1.0)
            straight = smooth & mi.has_flag(chosen.sampled_type, mi.BSDFFlags.DeltaTransmission)
            straight &= (dr.abs(si.p.y) < 1e-4) & (ray.d.y < 0) & (state == _FROM_SURFACE)
            after = dr.select(straight, mi.UInt32(_STRAIGHT_OUT), mi.UInt32(_OTHER_WAY))
            after = dr.select(state == _FROM_EYE, mi.UInt32(_FROM_EYE), after)
            state = dr.select(smooth, after, mi.UInt32(_FROM_SURFACE))
            in_gel = dr.select(smooth, in_gel, here_in_gel)
            ray = si.spawn_ray(si.to_world(chosen.wo))
            depth += 1
            largest = dr.max(throughput)
            active &= largest > 0
            survival = dr.minimum(largest * eta * eta, _LARGEST_SURVIVAL)
            survival = dr.select(depth >= self.roulette_depth, survival, 1.0)
            active &= sampler.next_1d(active) < survival
            throughput /= survival
        return radiance, valid, []


def band_integrator(
    design: FingerDesign, refractive: bool = True, max_depth: int = MAX_DEPTH, from_wall: bool = False
) -> BandPaths:
    """Return the path tracer aimed at a design's panel.

    Parameters
    ----------
    design
        Panel, pad and refractive index.
    refractive
        False leaves the panel to chance: the same mean, much more noise; it serves as a check.
    max_depth
        Longest path in surfaces; below 30 the painted bands lose light.
    from_wall
        Rays start on a wall in the gel: the panel's direct light through the inner face is left out.
    """
    mi.register_integrator(_NAME, BandPaths)
    integrator: BandPaths = mi.load_dict({"type": _NAME, "max_depth": max_depth, "from_wall": from_wall})
    integrator.aim(design, refractive)
    return integrator
