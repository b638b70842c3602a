"""A light panel in several poses as the renderer's numbers: which rays meet it, and what it sends along them.

Import this module only after a compiled variant has been set (see :mod:`sim.optics.variants`).
"""

from collections.abc import Sequence
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from data_schemas.optical_design import LightPanel
from sim.optics.panel_frame import PanelFrame, panel_frame
from sim.optics.scene import PANEL_RADIANCE_REL


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
