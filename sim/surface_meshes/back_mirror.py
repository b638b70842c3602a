"""The mirror on the back beam: straight across, slightly convex along the finger.

Assumed lay-out for a pad of 70 x 35 mm, chosen so that the pad fills the frame of a 120 deg camera; it scales with
the pad.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from data_schemas.design import FingerDesign
from sim.surface_meshes.surface import Surface, grid_surface

_NOMINAL_LENGTH_MM, _NOMINAL_WIDTH_MM = 70.0, 35.0
# ends of the straight back beam, y then z
_BASE_YZ_MM = np.array([-20.0, 0.0])
_TIP_YZ_MM = np.array([-4.5, 70.0])
_OVERHANG_MM = 4.0
_ROWS = 241


@dataclass(frozen=True, slots=True)
class MirrorShape:
    """Convex mirror, straight across (x): apex, unit tangent and unit normal to the pad in (y, z), and radius.

    Points: apex + s tangent - s^2 / (2 radius) normal, for s in -half_length_mm .. half_length_mm.
    """

    apex_yz_mm: NDArray[np.float64]
    tangent_yz: NDArray[np.float64]
    normal_yz: NDArray[np.float64]
    radius_mm: float
    half_length_mm: float
    half_width_mm: float


def layout_scale(design: FingerDesign) -> float:
    """Return the size of this finger's lay-out over the nominal one."""
    return max(design.pad.length_mm / _NOMINAL_LENGTH_MM, design.pad.width_mm / _NOMINAL_WIDTH_MM)


def mirror_shape(design: FingerDesign) -> MirrorShape:
    """Return the mirror on the back beam, scaled with the pad."""
    base, tip = _BASE_YZ_MM * layout_scale(design), _TIP_YZ_MM * layout_scale(design)
    length = float(np.linalg.norm(tip - base))
    tangent = (tip - base) / length
    return MirrorShape(
        apex_yz_mm=(base + tip) / 2.0,
        tangent_yz=tangent,
        normal_yz=np.array([tangent[1], -tangent[0]]),
        radius_mm=design.mirror.radius_mm,
        half_length_mm=length / 2.0 + _OVERHANG_MM,
        half_width_mm=design.pad.width_mm / 2.0 + 1.0,
    )


def mirror_surface(design: FingerDesign) -> Surface:
    """Triangulate the mirror; its normals point to the pad, u runs across, v along from the base."""
    mirror = mirror_shape(design)
    v = np.linspace(0.0, 1.0, _ROWS)
    s = (2.0 * v - 1.0) * mirror.half_length_mm
    sag = s**2 / (2.0 * mirror.radius_mm)
    yz = mirror.apex_yz_mm + s[:, None] * mirror.tangent_yz - sag[:, None] * mirror.normal_yz
    x = np.array([-mirror.half_width_mm, mirror.half_width_mm])
    points = np.stack([np.broadcast_to(x[:, None], (2, _ROWS)), *np.broadcast_to(yz.T[:, None], (2, 2, _ROWS))], -1)
    # d/du x d/dv = x cross tangent points away from the pad
    return grid_surface(points, np.array([0.0, 1.0]), v, flip=True)
