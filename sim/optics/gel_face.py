"""The inner face of the gel as light meets it: where it is, and what gel, film and air let through."""

from dataclasses import dataclass
from typing import Any, Literal

from data_schemas.design import FingerDesign
from data_schemas.gel_pad import Film
from sim.optics.position_map import PositionMap
from sim.surface_meshes.finger_shape import FingerShape

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
