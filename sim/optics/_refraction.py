"""The inner face of the gel as light meets it, and the refracted path from a panel through it.

The face is a smooth map with an index and a film; Fresnel's formulas tell what gel, film and air let through. A point p
in the gel sees a panel point q in air along a path that is stationary in optical length (Fermat),

    L(u, v) = n |p - s(u, v)| + |s(u, v) - q|,

where s is the inner face. Newton's method in two dimensions finds the crossing; the determinant of the Hessian of L
gives the solid angle in the gel per panel area. One piece of arithmetic serves numpy's arrays and the renderer's.
"""

from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from data_schemas import Film, FingerDesign, LightPanel
from sim.optics._optical_layout import panel_frame, panel_quadrature
from sim.optics._position_map import Evaluate, FacePoint, PositionMap, Vector
from sim.surface_meshes import FingerShape

# light that crosses the face nearer to its outline than this counts as that of the rim
_RIM_MM = 2.0


@dataclass(frozen=True, slots=True)
class GelFace:
    """The inner face as light meets it: its map, its size at rest, the gel's index at the LED and the film on it.

    ``part`` says which light counts: all of it, that of the middle, which fades out smoothly before the outline, or the
    rest, that of the rim. Both together are all.
    """

    map: PositionMap
    width_mm: float
    length_mm: float
    index: float
    film: Film | None = None
    part: Literal["all", "middle", "rim"] = "all"

    def share(self, u: Any, v: Any, arithmetic: Any) -> Any:
        """Return which share of the light that crosses the face at (u, v) counts; twice differentiable."""
        if self.part == "all":
            return 1.0
        across, along = arithmetic.minimum(u, 1.0 - u), arithmetic.minimum(v, 1.0 - v)
        middle = 1.0
        for from_edge, size_mm in ((across, self.width_mm), (along, self.length_mm)):
            x = arithmetic.clip(from_edge * (size_mm / _RIM_MM), 0.0, 1.0)
            middle = middle * (x * x * x * (10.0 - x * (15.0 - 6.0 * x)))
        return middle if self.part == "middle" else 1.0 - middle


def inner_face(design: FingerDesign, shape: FingerShape) -> GelFace:
    """Return the inner face of a finger, at rest or deformed, for the light of its panels."""
    pad = design.pad
    position_map = PositionMap.of(shape.surfaces["inner"], "inner face")
    index = pad.index_at(design.light.peak_wavelength_nm)
    return GelFace(position_map, pad.width_mm, pad.length_mm, index, pad.film)


def fresnel_transmittance(cos_gel: Any, cos_air: Any, index: Any) -> Any:
    """Return the unpolarised power transmittance of the bare gel face for angles that obey Snell's law."""
    s_polarised, p_polarised = _reflectances(cos_gel, cos_air, index, 1.0)
    return 1.0 - 0.5 * (s_polarised + p_polarised)


def film_transmittance(cos_gel: Any, cos_air: Any, index: Any, film_index: float) -> Any:
    r"""Return the unpolarised transmittance of gel, film and air relative to that of gel and air.

    Incoherent slab, per polarisation :math:`T = (1 - R_1)(1 - R_2) / (1 - R_1 R_2)` with the reflectances of its two
    faces; no absorption. Valid for films much thicker than the coherence length of the LED (0.01 mm).
    """
    sine2_film = (1.0 - cos_air * cos_air) / film_index**2
    cos_film = (1.0 - sine2_film) ** 0.5
    inner = _reflectances(cos_gel, cos_film, index, film_index)
    outer = _reflectances(cos_film, cos_air, film_index, 1.0)
    slab = [(1.0 - a) * (1.0 - b) / (1.0 - a * b) for a, b in zip(inner, outer, strict=True)]
    return 0.5 * (slab[0] + slab[1]) / fresnel_transmittance(cos_gel, cos_air, index)


def _reflectances(cos_1: Any, cos_2: Any, index_1: Any, index_2: Any) -> tuple[Any, Any]:
    """Return Fresnel's s and p power reflectances for angles that obey Snell's law."""
    s_polarised = (index_2 * cos_2 - index_1 * cos_1) / (index_2 * cos_2 + index_1 * cos_1)
    p_polarised = (index_1 * cos_2 - index_2 * cos_1) / (index_1 * cos_2 + index_2 * cos_1)
    return s_polarised * s_polarised, p_polarised * p_polarised


START_STEPS = 4
"""Newton steps on Snell's law in the undeformed face; they only begin the search."""

NEWTON_STEPS = 5
"""Newton steps on the curved face in double precision; three meet Snell's law to 1e-6 at a bending radius of 50 mm."""

# Snell's law counts as met when the sines differ by less: 30 times what single precision rounds at 100 mm
_LARGEST_SINE_ERROR = 1e-3
# a step across more than this share of the face is cut short: the face's own curvature is not known that far
_LONGEST_STEP = 0.25
_SHORTEST_MM = 1e-6


class RefractedPath(NamedTuple):
    """The path from gel points to panel points; unit directions as three components, all of one array type.

    ``weight`` is n^2 T times solid angle in the gel per mm^2 of a panel seen face on: multiply by the cosine at the
    panel, its radiance and area. It is zero where no path was found. ``to_crossing`` is the direction in the gel.
    """

    found: Any
    crossing: Vector
    to_crossing: Vector
    to_panel: Vector
    length_in_gel: Any
    length_in_air: Any
    cos_gel: Any
    cos_air: Any
    weight: Any


class NumpyArithmetic:
    """The functions of numpy under the names that the renderer's arrays use."""

    sqrt = staticmethod(np.sqrt)
    select = staticmethod(np.where)
    maximum = staticmethod(np.maximum)
    minimum = staticmethod(np.minimum)
    clip = staticmethod(np.clip)
    abs = staticmethod(np.abs)


def refract_through(
    evaluate: Evaluate,
    point: Vector,
    foot: tuple[Any, Any],
    panel_point: Vector,
    face: GelFace,
    arithmetic: Any = NumpyArithmetic,
    steps: int = NEWTON_STEPS,
    index: Any = None,
) -> RefractedPath:
    """Connect gel points with panel points through the inner face.

    Newton's steps start from the crossing of the undeformed face and are cut at a quarter of the face; where the
    Hessian is not positive its curvature part is left out. With N = du x dv, directions d and lengths l,
    solid angle / area = |d_gel . N| |d_air . N| cos_panel / (l_gel^2 l_air^2 det Hessian) by the implicit function
    theorem. Of several crossings (a face with deep folds) the one nearest to the start is found, only minima count.

    Parameters
    ----------
    evaluate
        The inner face in the arrays' type.
    point, panel_point
        Points in mm, three components each.
    foot
        Texture coordinates of the points' feet on the face: those that the undeformed points have.
    face
        Size, index and film.
    arithmetic
        Where sqrt, select, maximum, minimum, clip and abs come from.
    steps
        Number of Newton steps.
    index
        Refractive index as one of the arrays' type, to keep it a variable of a compiled kernel.
    """
    n = face.index if index is None else index
    u, v = _start(evaluate, point, foot, panel_point, face, arithmetic, n)
    for _ in range(steps):
        step_u, step_v = _newton_step(evaluate(u, v), point, panel_point, n, arithmetic)
        u, v = arithmetic.clip(u + step_u, 0.0, 1.0), arithmetic.clip(v + step_v, 0.0, 1.0)
    path = _path(evaluate(u, v), (u, v), point, panel_point, n, face.film, arithmetic)
    return path._replace(weight=path.weight * face.share(u, v, arithmetic))


def curved_irradiance(
    points_mm: NDArray[np.float64],
    normals: NDArray[np.float64],
    foot: NDArray[np.float64],
    light: LightPanel,
    face: GelFace,
    quadrature: tuple[int, int] = (16, 8),
) -> NDArray[np.float64]:
    """Return the irradiance of a panel at points in the gel, for unit radiance along the panel's normal.

    E = integral over the panel of n^2 T cos_surface (dw/dA) cos^(m-1) dA by Gauss-Legendre quadrature, m the panel's
    beam exponent. Light that would enter beside the inner face, and light that meets the mirror, the coating or
    another face first, is not counted. Valid while nothing shades the path.

    Parameters
    ----------
    points_mm, normals
        Points in the gel and unit normals of the receiving surface, into the gel, shape (n, 3).
    foot
        Texture coordinates of the points' feet on the inner face, shape (n, 2).
    light, face
        Panel and inner face.
    quadrature
        Number of panel points across and along.

    Returns
    -------
    array
        Irradiance in units of the panel's radiance, shape (n,).
    """
    frame = panel_frame(light)
    panel_points, areas_mm2 = panel_quadrature(frame, *quadrature)
    count = len(panel_points)
    p, at_foot = (tuple(np.repeat(values, count, axis=0).T) for values in (points_mm, foot))
    q = tuple(np.tile(panel_points, (len(points_mm), 1)).T)
    path = refract_through(face.map.evaluate, p, at_foot, q, face)
    cos_panel = np.maximum(-(np.stack(path.to_panel, axis=-1) @ frame.normal), 0.0)
    cos_surface = np.einsum("nk,nk->n", np.stack(path.to_crossing, axis=-1), np.repeat(normals, count, axis=0))
    kernel = path.weight * cos_panel**light.beam_exponent * np.maximum(cos_surface, 0.0)
    return np.asarray(kernel.reshape(len(points_mm), count) @ areas_mm2)


def _start(
    evaluate: Evaluate, point: Vector, foot: tuple[Any, Any], panel_point: Vector, face: GelFace, m: Any, n: Any
) -> tuple[Any, Any]:
    """Return (u, v) where the path would cross the undeformed face, the plane y = 0."""
    height = m.maximum(_length(_minus(point, evaluate(*foot).position), m), _SHORTEST_MM)
    depth = m.maximum(-panel_point[1], _SHORTEST_MM)
    offset_u = panel_point[0] / face.width_mm + 0.5 - foot[0]
    offset_v = panel_point[2] / face.length_mm - foot[1]
    lateral = m.sqrt((offset_u * face.width_mm) ** 2 + (offset_v * face.length_mm) ** 2) + _SHORTEST_MM
    r = lateral * height / (height + n * depth)
    for _ in range(START_STEPS):
        rest = lateral - r
        in_gel, in_air = m.sqrt(r * r + height * height), m.sqrt(rest * rest + depth * depth)
        slope = n * height * height / (in_gel * in_gel * in_gel) + depth * depth / (in_air * in_air * in_air)
        r = m.clip(r - (n * r / in_gel - rest / in_air) / slope, 0.0, lateral)
    share = r / lateral
    return m.clip(foot[0] + share * offset_u, 0.0, 1.0), m.clip(foot[1] + share * offset_v, 0.0, 1.0)


def _newton_step(s: FacePoint, point: Vector, panel_point: Vector, n: Any, m: Any) -> tuple[Any, Any]:
    """Return the step in (u, v) towards the stationary optical length."""
    (gradient_u, gradient_v), hessian, flat_hessian = _length_derivatives(s, point, panel_point, n, m)
    usable = (_determinant(hessian) > 0.0) & (hessian[0] > 0.0)
    a, b, c = (m.select(usable, whole, flat) for whole, flat in zip(hessian, flat_hessian, strict=True))
    determinant = m.maximum(a * c - b * b, 1e-12)
    step_u = (b * gradient_v - c * gradient_u) / determinant
    step_v = (b * gradient_u - a * gradient_v) / determinant
    cut = m.minimum(1.0, _LONGEST_STEP / m.maximum(m.maximum(m.abs(step_u), m.abs(step_v)), 1e-6))
    return step_u * cut, step_v * cut


def _length_derivatives(s: FacePoint, point: Vector, panel_point: Vector, n: Any, m: Any) -> tuple[Any, Any, Any]:
    """Return gradient (u, v) and Hessian (uu, uv, vv) of the optical length, and its part without curvature."""
    in_gel, in_air = _minus(point, s.position), _minus(panel_point, s.position)
    length_gel, length_air = _length(in_gel, m), _length(in_air, m)
    gel, air = _scaled(in_gel, 1.0 / length_gel), _scaled(in_air, 1.0 / length_air)
    pull = tuple(n * a + b for a, b in zip(gel, air, strict=True))
    gradient = (-_dot(pull, s.du), -_dot(pull, s.dv))
    gel_uv, air_uv = (_dot(gel, s.du), _dot(gel, s.dv)), (_dot(air, s.du), _dot(air, s.dv))
    near, far = n / length_gel, 1.0 / length_air
    flat = []
    for (i, d_i), (j, d_j) in (((0, s.du), (0, s.du)), ((0, s.du), (1, s.dv)), ((1, s.dv), (1, s.dv))):
        metric = _dot(d_i, d_j)
        flat.append(near * (metric - gel_uv[i] * gel_uv[j]) + far * (metric - air_uv[i] * air_uv[j]))
    curved = [h - _dot(pull, second) for h, second in zip(flat, (s.duu, s.duv, s.dvv), strict=True)]
    return gradient, curved, flat


def _path(
    s: FacePoint, uv: tuple[Any, Any], point: Vector, panel_point: Vector, n: Any, film: Film | None, m: Any
) -> RefractedPath:
    """Return the path over a point of the face, found only if that point obeys Snell's law."""
    (gradient_u, gradient_v), hessian, _ = _length_derivatives(s, point, panel_point, n, m)
    from_point, onward = _minus(s.position, point), _minus(panel_point, s.position)
    length_gel, length_air = _length(from_point, m), _length(onward, m)
    gel, air = _scaled(from_point, 1.0 / length_gel), _scaled(onward, 1.0 / length_air)
    normal = _cross(s.du, s.dv)
    area = _length(normal, m)
    gel_flux, air_flux = _dot(gel, normal), _dot(air, normal)
    cos_gel, cos_air = m.minimum(m.abs(gel_flux) / area, 1.0), m.minimum(m.abs(air_flux) / area, 1.0)
    error = m.maximum(gradient_u * gradient_u / _dot(s.du, s.du), gradient_v * gradient_v / _dot(s.dv, s.dv))
    determinant = _determinant(hessian)
    found = (error < _LARGEST_SINE_ERROR**2) & (determinant > 0.0) & (hessian[0] > 0.0) & (gel_flux * air_flux > 0.0)
    found &= (uv[0] > 0.0) & (uv[0] < 1.0) & (uv[1] > 0.0) & (uv[1] < 1.0)
    spread = length_gel * length_gel * length_air * length_air * m.maximum(determinant, 1e-12)
    transmittance = fresnel_transmittance(cos_gel, cos_air, n)
    if film is not None:
        transmittance = transmittance * film_transmittance(cos_gel, cos_air, n, film.refractive_index)
    weight = n * n * transmittance * m.abs(gel_flux * air_flux) / spread
    return RefractedPath(
        found, s.position, gel, air, length_gel, length_air, cos_gel, cos_air, m.select(found, weight, 0.0)
    )


def _determinant(symmetric: Any) -> Any:
    """Return the determinant of a symmetric 2 x 2 matrix (a, b, c)."""
    return symmetric[0] * symmetric[2] - symmetric[1] * symmetric[1]


def _minus(a: Vector, b: Vector) -> Vector:
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


def _scaled(a: Vector, factor: Any) -> Vector:
    return a[0] * factor, a[1] * factor, a[2] * factor


def _dot(a: Any, b: Any) -> Any:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _cross(a: Vector, b: Vector) -> Vector:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


def _length(a: Vector, arithmetic: Any) -> Any:
    return arithmetic.sqrt(_dot(a, a))
