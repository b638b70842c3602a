"""Light panels as the renderer's numbers: how they are drawn, their poses, and what a path that meets one sees.

A path also keeps how it left its last surface that was not a smooth interface: that decides whether a panel it meets
was counted already.
Import this module only after a compiled variant has been set (see :func:`sim.optics.open_renderer`).
"""

from collections.abc import Sequence
from typing import Any, Protocol

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from data_schemas import FingerDesign, LightPanel
from sim.optics._optical_layout import PanelFrame, panel_frame, panel_quadrature
from sim.optics._path_rules import NEWTON_STEPS, LookupTable
from sim.optics._refraction import GelFace, curved_irradiance, refract_through
from sim.optics._scene import PANEL_RADIANCE_REL

Floats = NDArray[np.float64]

# panels light different parts of the pad, so none is drawn more rarely than this share of an even one
_SMALLEST_SHARE = 0.5
_SHARE_GRID = np.array([0.1, 0.3, 0.5, 0.7, 0.9])


class PanelPower(Protocol):
    """How strongly and how narrowly a panel shines."""

    @property
    def power_rel(self) -> float:
        """Radiance along the normal."""

    @property
    def beam_exponent(self) -> float:
        """Exponent m of an intensity ~ cos^m."""


class Panel:
    """A light panel as the renderer's numbers, and with which probability it is drawn."""

    def __init__(self, frame: PanelFrame, light: PanelPower, share: float) -> None:
        self.share = float(share)
        self.beamed = light.beam_exponent != 1.0
        self.centre = mi.Point3f(*frame.centre_mm.tolist())
        self.across, self.along = (mi.Vector3f(*edge.tolist()) for edge in (frame.half_across_mm, frame.half_along_mm))
        self.normal = mi.Vector3f(*frame.normal.tolist())
        self.exponent = mi.Float(light.beam_exponent)
        self.radiance = mi.Float(PANEL_RADIANCE_REL * light.power_rel)
        self.radiance_per_density = mi.Float(PANEL_RADIANCE_REL * light.power_rel * frame.area_mm2 / share)
        dr.make_opaque(self.centre, self.across, self.along, self.normal)
        dr.make_opaque(self.exponent, self.radiance, self.radiance_per_density)

    def at(self, x: Any, y: Any, start: float) -> tuple[Any, Any, Any, Any]:
        """Return point, normal, beam exponent and radiance over density for sample x in start .. start + share."""
        across: Any = 2.0 * (x - start) / self.share - 1.0
        point = self.centre + across * self.across + (2.0 * y - 1.0) * self.along
        return point, self.normal, self.exponent, self.radiance_per_density


def _panel_shares(design: FingerDesign, face: GelFace) -> NDArray[np.float64]:
    """Return with which probability each panel is drawn: by the light that it sends through the face into the pad."""
    u, v = np.meshgrid(_SHARE_GRID, _SHARE_GRID)
    uv = np.stack([u.ravel(), v.ravel()], axis=-1)
    outward = face.map.normals(uv)
    points = face.map.positions_mm(uv) - design.pad.thickness_mm / 2.0 * outward
    sent = np.array(
        [light.power_rel * curved_irradiance(points, outward, uv, light, face, (4, 2)).sum() for light in design.lights]
    )
    sent = np.maximum(sent, _SMALLEST_SHARE / len(sent) * sent.sum()) if sent.sum() > 0.0 else np.ones_like(sent)
    return np.asarray(sent / sent.sum())


def panels_of(design: FingerDesign, face: GelFace) -> list[Panel]:
    """Return the panels of a finger."""
    shares = _panel_shares(design, face)
    return [Panel(panel_frame(light), light, share) for light, share in zip(design.lights, shares, strict=True)]


def panel_point(panels: Sequence[Panel], sample: Any) -> tuple[Any, Any, Any]:
    """Return a point on a panel drawn by its light, (normal, beam exponent), and radiance over density in mm^2."""
    chosen, start = panels[0], 0.0
    point, normal, exponent, weight = chosen.at(sample.x, sample.y, start)
    for panel in panels[1:]:
        start = start + chosen.share
        chosen = panel
        here = sample.x >= start
        other = panel.at(sample.x, sample.y, start)
        point, normal, exponent, weight = (
            dr.select(here, b, a) for a, b in zip((point, normal, exponent, weight), other, strict=True)
        )
    return point, (normal, exponent), weight


def panel_irradiances(
    points_mm: Floats,
    normals: Floats,
    foot: Floats,
    lights: Sequence[LightPanel],
    face: GelFace,
    quadrature: tuple[int, int],
) -> Floats:
    """Return :func:`sim.optics._refraction.curved_irradiance` of several panels, (light, n), in single precision.

    All of them in one kernel, whose paths take as many Newton steps as the tracers' connections.

    Parameters
    ----------
    points_mm, normals, foot, face, quadrature
        As there.
    lights
        Panels.
    """
    frames = [panel_frame(light) for light in lights]
    spots, areas = zip(*(panel_quadrature(frame, *quadrature) for frame in frames), strict=True)
    count = len(areas[0])
    of_lights = [[*frame.normal, light.beam_exponent] for frame, light in zip(frames, lights, strict=True)]
    place, facing, spot, panel = (
        LookupTable(np.asarray(rows), mi)
        for rows in (
            np.column_stack([points_mm, foot[:, 0]]),
            np.column_stack([normals, foot[:, 1]]),
            np.column_stack([np.concatenate(spots), np.concatenate(areas)]),
            of_lights,
        )
    )
    per_point, per_light = dr.opaque(mi.UInt32, count), dr.opaque(mi.UInt32, count * len(points_mm))
    lane = dr.arange(mi.UInt32, count * len(points_mm) * len(lights))
    of_light, rest = lane // per_light, lane % per_light
    at, seen = place.row(rest // per_point), facing.row(rest // per_point)
    q, towards = spot.row(of_light * per_point + rest % per_point), panel.row(of_light)
    index = dr.opaque(mi.Float, face.index)
    path = refract_through(
        face.map.in_renderer(mi), (at.x, at.y, at.z), (at.w, seen.w), (q.x, q.y, q.z), face, dr, NEWTON_STEPS, index
    )
    cosine = dr.maximum(-dr.dot(mi.Vector3f(*path.to_panel), towards.xyz), 0.0)
    sent = dr.power(cosine, towards.w) if any(light.beam_exponent != 1.0 for light in lights) else cosine
    received = dr.maximum(dr.dot(mi.Vector3f(*path.to_crossing), seen.xyz), 0.0)
    kernel = (path.weight * sent * received * q.w).numpy()
    return np.asarray(kernel.reshape(len(lights), len(points_mm), count).sum(axis=-1, dtype=np.float64))


class PosedRectangle:
    """A rectangle as the renderer's numbers."""

    def __init__(self, frame: PanelFrame) -> None:
        self.centre, self.normal = mi.Point3f(*frame.centre_mm.tolist()), mi.Vector3f(*frame.normal.tolist())
        across, along = frame.half_across_mm, frame.half_along_mm
        self.across, self.along = mi.Vector3f(*across.tolist()), mi.Vector3f(*along.tolist())
        # products with these are -1..1 inside
        self.u = mi.Vector3f(*(across / (across @ across)).tolist())
        self.v = mi.Vector3f(*(along / (along @ along)).tolist())
        # numbers that vary between scenes must not become constants of the compiled kernel
        dr.make_opaque(self.centre, self.normal, self.across, self.along, self.u, self.v)
        self.area_mm2 = frame.area_mm2

    def faces(self, ray: Any) -> Any:
        """Return whether rays meet its front."""
        inside, _, cosine = self.meet(ray)
        return inside & (cosine > 0.0)

    def meet(self, ray: Any) -> tuple[Any, Any, Any]:
        """Return (meets it, distance in mm, cosine on the side of the normal) of rays."""
        cosine = -dr.dot(ray.d, self.normal)
        from_centre = ray.o - self.centre
        distance = dr.dot(from_centre, self.normal) / dr.select(cosine == 0.0, 1.0, cosine)
        spot = from_centre + distance * ray.d
        inside = (dr.abs(dr.dot(spot, self.u)) <= 1.0) & (dr.abs(dr.dot(spot, self.v)) <= 1.0)
        return inside & (cosine != 0.0) & (distance > 0.0), distance, cosine


class PosedPanel:
    """One light in all its poses, and the rectangle that surface points aim at: it covers all poses."""

    def __init__(self, lights: Sequence[LightPanel], length_mm: float) -> None:
        self.poses = [PosedRectangle(panel_frame(light)) for light in lights]
        self.radiance = mi.Float(PANEL_RADIANCE_REL * lights[0].power_rel)
        self.exponent = mi.Float(lights[0].beam_exponent - 1.0)
        self.beamed = lights[0].beam_exponent != 1.0
        dr.make_opaque(self.radiance, self.exponent)
        self.aim = PosedRectangle(_covering(lights[0], length_mm))

    def sent(self, cosine: Any) -> Any:
        """Return the radiance at a cosine from the panel's normal, none behind it."""
        beam: Any = dr.power(dr.maximum(cosine, 0.0), self.exponent) if self.beamed else 1.0
        return dr.select(cosine > 0.0, self.radiance * beam, 0.0)


def _covering(light: LightPanel, length_mm: float) -> PanelFrame:
    """Return a rectangle that looks at the inner face and hides the panel in all poses from nearly all of it.

    What it does not hide is left to chance, so its size changes the noise alone.
    """
    centre = np.array(light.position_mm, dtype=np.float64)
    ends = [np.array([0.0, 0.0, z]) - centre * [0.0, 1.0, 1.0] for z in (0.0, length_mm)]
    ends = [end / np.linalg.norm(end) for end in ends]
    middle = (ends[0] + ends[1]) / np.linalg.norm(ends[0] + ends[1])
    across = np.array([1.0, 0.0, 0.0])
    half = light.height_mm / 2.0
    half_along = half / max(float(middle @ ends[0]), 0.5)
    return PanelFrame(centre, across * (light.width_mm / 2.0 + half), np.cross(middle, across) * half_along, middle)


# from a surface; from it straight out through the inner face; any other way; from the eye, all smooth since; from the
# start in a wall; from that start straight out
FROM_SURFACE, STRAIGHT_OUT, OTHER_WAY, FROM_EYE, FROM_START, DIRECT = range(6)


def state_after(state: Any, smooth: Any, out: Any) -> Any:
    """Return the state after a surface, by whether it was smooth, and whether the path went out by the inner face."""
    after = dr.select(out & (state == FROM_SURFACE), mi.UInt32(STRAIGHT_OUT), mi.UInt32(OTHER_WAY))
    after = dr.select(out & (state == FROM_START), mi.UInt32(DIRECT), after)
    after = dr.select(state == FROM_EYE, mi.UInt32(FROM_EYE), after)
    return dr.select(smooth, after, mi.UInt32(FROM_SURFACE))
