"""The coated face of a flat gel pad with a cylinder pressed into it: an analytic shape, not a mechanical solution.

The cylinder lies across the pad (axis along x), so the face is one profile y(z) extruded along x. The shape
serves to exercise the optics; deformed meshes of the finite-element model replace it where mechanics matters.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from data_schemas.design import FingerDesign
from data_schemas.errors import SimulateError

BLEND_MM = 0.15
"""Radius of the rounded transition between the indenter and the free face."""

_QUADRATURE_POINTS = 4001
_SMALLEST_BULGE_SHARE = 0.05


@dataclass(frozen=True, slots=True)
class PadFace:
    """The coated face on a grid: ``y_mm[i, j]`` is its height above the inner face at ``x_mm[i], z_mm[j]``."""

    x_mm: NDArray[np.float64]
    z_mm: NDArray[np.float64]
    y_mm: NDArray[np.float64]


def without_press(design: FingerDesign) -> FingerDesign:
    """Return the same finger with nothing pressed into it."""
    return design.model_copy(update={"indenter": design.indenter.model_copy(update={"depth_mm": 0.0})})


def contact_half_width_mm(design: FingerDesign) -> float:
    """Return half the chord of the indenter in the plane of the undeformed face, sqrt(2 R d - d^2).

    The geometric overlap; R once the depth d reaches the radius R. Zero without a press.
    """
    radius, depth = design.indenter.radius_mm, design.indenter.depth_mm
    return radius if depth >= radius else float(np.sqrt(2.0 * radius * depth - depth**2))


def pressed_profile(design: FingerDesign, z_mm: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the height of the coated face along the pad.

    y(z) = smooth minimum of thickness and cylinder, plus B (s/l)^2 exp(-s/l) outside the contact, where s is the
    distance from its edge, l half the thickness, and B makes the net volume zero: the gel is incompressible.
    Valid for one press well inside the pad; analytic, no stress is solved for.

    Parameters
    ----------
    design
        Pad and indenter.
    z_mm
        Positions along the pad, any shape.

    Returns
    -------
    array
        Height above the inner face, mm, shape of `z_mm`.

    Raises
    ------
    SimulateError
        When the contact leaves no free face beside it for the displaced volume.
    """
    height = _dented(design, z_mm)
    if design.indenter.depth_mm == 0.0:
        return height
    quadrature_z = np.linspace(0.0, design.pad.length_mm, _QUADRATURE_POINTS)
    removed = float(np.trapezoid(design.pad.thickness_mm - _dented(design, quadrature_z), quadrature_z))
    available = float(np.trapezoid(_bulge_shape(design, quadrature_z), quadrature_z))
    if available < _SMALLEST_BULGE_SHARE * 2.0 * _bulge_length_mm(design):
        raise SimulateError(
            f"indenter.radius_mm = {design.indenter.radius_mm} mm at depth {design.indenter.depth_mm} mm covers "
            f"the pad of {design.pad.length_mm} mm from end to end and leaves no free face; reduce radius or depth"
        )
    return height + removed / available * _bulge_shape(design, z_mm)


def pad_face(design: FingerDesign, step_z_mm: float = 0.1, across: int = 3) -> PadFace:
    """Return the coated face on a regular grid of the pad.

    Parameters
    ----------
    design
        Pad and indenter.
    step_z_mm
        Largest spacing along the pad; the curvature of the dent needs about 0.1 mm.
    across
        Number of points across the pad; the face is straight there.
    """
    pad = design.pad
    z_mm = np.linspace(0.0, pad.length_mm, int(np.ceil(pad.length_mm / step_z_mm)) + 1)
    x_mm = np.linspace(-pad.width_mm / 2.0, pad.width_mm / 2.0, across)
    y_mm = np.broadcast_to(pressed_profile(design, z_mm), (across, z_mm.size)).copy()
    return PadFace(x_mm, z_mm, y_mm)


def _dented(design: FingerDesign, z_mm: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the smooth minimum of the flat face and the cylinder, without the bulge."""
    thickness, indenter = design.pad.thickness_mm, design.indenter
    if indenter.depth_mm == 0.0:
        return np.full(np.shape(z_mm), thickness)
    offset = z_mm - indenter.position_mm
    under = np.sqrt(np.maximum(indenter.radius_mm**2 - offset**2, 0.0))
    tool = thickness - indenter.depth_mm + indenter.radius_mm - under
    tool = np.where(np.abs(offset) < indenter.radius_mm, tool, np.inf)
    return -BLEND_MM * np.logaddexp(-thickness / BLEND_MM, -tool / BLEND_MM)


def _bulge_length_mm(design: FingerDesign) -> float:
    """Return the decay length of the bulge: half the pad's thickness."""
    return design.pad.thickness_mm / 2.0


def _bulge_shape(design: FingerDesign, z_mm: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the bulge beside the contact at unit amplitude."""
    outside = np.abs(z_mm - design.indenter.position_mm) - contact_half_width_mm(design)
    s = np.maximum(outside, 0.0) / _bulge_length_mm(design)
    return s**2 * np.exp(-s)
