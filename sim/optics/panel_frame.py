"""A light panel as a rectangle in space, and points on it for quadrature."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from data_schemas.optical_design import LightPanel


@dataclass(frozen=True, slots=True)
class PanelFrame:
    """The panel as a rectangle: centre, half edges and unit normal, in mm of the pad's axes."""

    centre_mm: NDArray[np.float64]
    half_across_mm: NDArray[np.float64]
    half_along_mm: NDArray[np.float64]
    normal: NDArray[np.float64]

    @property
    def area_mm2(self) -> float:
        """Area of the panel."""
        return float(4.0 * np.linalg.norm(self.half_across_mm) * np.linalg.norm(self.half_along_mm))


def panel_frame(light: LightPanel) -> PanelFrame:
    """Return the rectangle of a light panel: normal (0, sin a, cos a) for the light angle a from the pad plane."""
    angle = np.radians(light.angle_deg)
    normal = np.array([0.0, np.sin(angle), np.cos(angle)])
    across = np.array([1.0, 0.0, 0.0])
    return PanelFrame(
        np.array(light.position_mm, dtype=np.float64),
        across * light.width_mm / 2.0,
        np.cross(normal, across) * light.height_mm / 2.0,
        normal,
    )


def panel_quadrature(frame: PanelFrame, across: int, along: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return Gauss-Legendre points (m, 3) on a panel and their areas (m,)."""
    u, weight_u = np.polynomial.legendre.leggauss(across)
    v, weight_v = np.polynomial.legendre.leggauss(along)
    points = frame.centre_mm + u[:, None, None] * frame.half_across_mm + v[None, :, None] * frame.half_along_mm
    return points.reshape(-1, 3), np.outer(weight_u, weight_v).ravel() * frame.area_mm2 / 4.0
