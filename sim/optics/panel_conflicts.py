"""What a light panel passes through in a pose: a panel that intersects another part cannot be mounted there."""

import numpy as np

from data_schemas.errors import SimulateError
from data_schemas.optical_design import LightPanel
from sim.optics.panel_frame import panel_frame
from sim.surface_meshes.finger_shape import FingerShape
from sim.surface_meshes.intersections import check_no_intersections
from sim.surface_meshes.surface import Surface


def in_the_way(light: LightPanel, shape: FingerShape) -> str:
    """Return the name of the first surface that the panel passes through, or an empty text when it fits.

    Panels are sheets without thickness, so a fit is necessary but not sufficient: housing and wires need room too.
    """
    panel = panel_surface(light)
    for name, surface in shape.surfaces.items():
        try:
            check_no_intersections({"light panel": panel, name: surface})
        except SimulateError:
            return name
    return ""


def panel_surface(light: LightPanel) -> Surface:
    """Return a light panel as two triangles."""
    frame = panel_frame(light)
    sides = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    corners = frame.centre_mm + sides[:, :1] * frame.half_across_mm + sides[:, 1:] * frame.half_along_mm
    return Surface(corners, np.array([[0, 1, 2], [0, 2, 3]]), (sides + 1.0) / 2.0)
