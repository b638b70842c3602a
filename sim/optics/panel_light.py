"""Light panels as the renderer's numbers: drawn by their light, and what a path that meets one sees.

Import this module only after a compiled variant has been set (see :mod:`sim.optics.variants`).
"""

from collections.abc import Sequence
from typing import Any, Protocol

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from data_schemas.design import FingerDesign
from sim.optics.curved_refraction import curved_irradiance
from sim.optics.gel_face import GelFace
from sim.optics.panel_frame import PanelFrame, panel_frame
from sim.optics.scene import PANEL_RADIANCE_REL

# panels light different parts of the pad, so none is drawn more rarely than this
_SMALLEST_SHARE = 0.25
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
    sent = np.maximum(sent, _SMALLEST_SHARE * sent.sum()) if sent.sum() > 0.0 else np.ones_like(sent)
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
