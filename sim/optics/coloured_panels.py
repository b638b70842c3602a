"""Coloured light panels below a gel without fluorescent paint, each connected with the gel through its inner face.

Import this module only after a compiled variant has been set (see :mod:`sim.optics.variants`).
"""

from collections.abc import Sequence
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from sim.optics.fluorescent_paths import fluorescent_integrator, painted_bsdfs
from sim.optics.gel_face import GelFace
from sim.optics.panel_light import Panel
from sim.optics.path_rules import MAX_DEPTH, ROULETTE_DEPTH
from sim.optics.paths import BandPaths


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
