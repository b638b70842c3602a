"""Oracle of the tests: light of a panel through the flat inner face, in closed form and independent of the package.

A point at height h1 in the gel sees a panel point at depth h2 in air through the one crossing of the plane y = 0 that
obeys Snell's law; no rays are thrown.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from data_schemas import GelPad, LightPanel
from sim.optics import panel_frame
from sim.optics._optical_layout import PanelFrame

_NEWTON_STEPS = 8
_SMALLEST_LATERAL_MM = 1e-6


@dataclass(frozen=True, slots=True)
class Crossing:
    """How panel points are seen from gel points through the inner face; arrays of the broadcast shape (..., ).

    ``direction`` (..., 3) is the unit vector in the gel towards the panel, ``crossing_mm`` (..., 3) the point on
    the face, ``solid_angle_per_mm2`` the solid angle in the gel per panel area, ``transmittance`` Fresnel's.
    """

    direction: NDArray[np.float64]
    crossing_mm: NDArray[np.float64]
    solid_angle_per_mm2: NDArray[np.float64]
    transmittance: NDArray[np.float64]


def trace_crossing(
    points_mm: NDArray[np.float64], panel_points_mm: NDArray[np.float64], normal: NDArray[np.float64], index: float
) -> Crossing:
    """Connect gel points with panel points through the plane y = 0 by Snell's law.

    Solves n r/l1 = (d - r)/l2 for the lateral distance r of the crossing (Newton; the function is monotone) and
    gives dw/dA = (r/l1) cos_panel / (d (dd/dt1) cos2), dd/dt1 = h1/cos1^2 + h2 n cos1/cos2^3.

    Parameters
    ----------
    points_mm, panel_points_mm
        Shapes that broadcast against each other, last axis 3; y > 0 in the gel and y < 0 in air.
    normal
        Unit normal of the panel, shape (3,); light leaves only on this side.
    index
        Refractive index of the gel, >= 1.
    """
    height, depth = points_mm[..., 1], -panel_points_mm[..., 1]
    offset_x = panel_points_mm[..., 0] - points_mm[..., 0]
    offset_z = panel_points_mm[..., 2] - points_mm[..., 2]
    lateral = np.maximum(np.hypot(offset_x, offset_z), _SMALLEST_LATERAL_MM)
    r = lateral * height / (height + index * depth)
    for _ in range(_NEWTON_STEPS):
        in_gel, in_air = np.hypot(r, height), np.hypot(lateral - r, depth)
        residual = index * r / in_gel - (lateral - r) / in_air
        slope = index * height**2 / in_gel**3 + depth**2 / in_air**3
        r = np.clip(r - residual / slope, 0.0, lateral)
    in_gel, in_air = np.hypot(r, height), np.hypot(lateral - r, depth)
    cos_gel, cos_air = height / in_gel, depth / in_air
    share = r / lateral
    crossing = np.stack(
        [points_mm[..., 0] + share * offset_x, np.zeros_like(r), points_mm[..., 2] + share * offset_z], axis=-1
    )
    direction = (crossing - points_mm) / in_gel[..., None]
    in_air_direction = (panel_points_mm - crossing) / in_air[..., None]
    cos_panel = np.maximum(-(in_air_direction @ normal), 0.0)
    spread = height / cos_gel**2 + depth * index * cos_gel / cos_air**3
    solid_angle = (r / in_gel) * cos_panel / (lateral * spread * cos_air)
    return Crossing(direction, crossing, solid_angle, fresnel_transmittance(cos_gel, cos_air, index))


def fresnel_transmittance(
    cos_gel: NDArray[np.float64], cos_air: NDArray[np.float64], index: float
) -> NDArray[np.float64]:
    """Return the unpolarised power transmittance of the gel face for angles that obey Snell's law."""
    s_polarised = (cos_air - index * cos_gel) / (cos_air + index * cos_gel)
    p_polarised = (index * cos_air - cos_gel) / (index * cos_air + cos_gel)
    return 1.0 - 0.5 * (s_polarised**2 + p_polarised**2)


def refracted_irradiance(
    points_mm: NDArray[np.float64],
    normals: NDArray[np.float64],
    light: LightPanel,
    pad: GelPad,
    quadrature: tuple[int, int] = (16, 8),
) -> NDArray[np.float64]:
    """Return the irradiance of the panel at points in the gel, for a Lambertian panel of unit radiance.

    E = integral over the panel of n^2 T cos_surface (dw/dA) dA by Gauss-Legendre quadrature; n^2 is the
    concentration of radiance in the gel. Light that would enter beside the inner face, and light that meets the
    mirror, the coating or another face first, is not counted. Valid while the coating does not shade the path.

    Parameters
    ----------
    points_mm
        Points in the gel, shape (n, 3).
    normals
        Unit normals of the receiving surface, into the gel, shape (n, 3).
    light, pad
        Panel and gel.
    quadrature
        Number of panel points across and along.

    Returns
    -------
    array
        Irradiance in units of the panel's radiance, shape (n,).
    """
    frame = panel_frame(light)
    panel_points, weights_mm2 = _panel_quadrature(frame, *quadrature)
    index = pad.index_at(light.peak_wavelength_nm)
    seen = trace_crossing(points_mm[:, None, :], panel_points[None, :, :], frame.normal, index)
    inside = (
        (np.abs(seen.crossing_mm[..., 0]) < pad.width_mm / 2.0)
        & (seen.crossing_mm[..., 2] > 0.0)
        & (seen.crossing_mm[..., 2] < pad.length_mm)
    )
    cos_surface = np.maximum(np.einsum("nmk,nk->nm", seen.direction, normals), 0.0)
    kernel = index**2 * seen.transmittance * cos_surface * seen.solid_angle_per_mm2 * inside
    return np.asarray(kernel @ weights_mm2)


def _panel_quadrature(frame: PanelFrame, across: int, along: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return Gauss-Legendre points (m, 3) on the panel and their areas (m,)."""
    u, weight_u = np.polynomial.legendre.leggauss(across)
    v, weight_v = np.polynomial.legendre.leggauss(along)
    points = (
        frame.centre_mm
        + u[:, None, None] * frame.half_across_mm[None, None, :]
        + v[None, :, None] * frame.half_along_mm[None, None, :]
    )
    weights = np.outer(weight_u, weight_v) * frame.area_mm2 / 4.0
    return points.reshape(-1, 3), weights.ravel()
