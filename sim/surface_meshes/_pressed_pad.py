"""The coated face of a gel pad with a cylinder or a ball pressed into it: analytic, not a mechanical solution.

The cylinder lies across the pad (axis along x), and each line of the face along the pad is dented for itself; so
the shape serves flat, cylindrical and ellipsoidal pads. It exercises the optics; deformed meshes of the
finite-element model replace it where mechanics matters.
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from data_schemas import FingerDesign, SimulateError

BLEND_MM = 0.15
"""Radius of the rounded transition between the indenter and the free face."""

_ANALYTIC_SHAPES = ("cylinder", "ball")
_BY_ELEMENTS = "Press by finite elements: finray simulate press DESIGN, and render with --surfaces"
_QUADRATURE_POINTS = 4001
_QUADRATURE_COLUMNS = 401
# a whole bulge beside a press in a pad of 70 mm has a mean near 0.2
_SMALLEST_BULGE_MEAN = 0.01
# a line whose overlap with the indenter is thinner than this is left alone
_SMALLEST_OVERLAP_MM = 1e-6


def check_analytic_press(design: FingerDesign) -> None:
    """Check that the analytic press can shape this press: a cylinder that lies across the pad, or a ball.

    Raises
    ------
    SimulateError
        When it cannot; the message names the field and the finite elements that can.
    """
    pad, indenter = design.pad, design.indenter
    if indenter.depth_mm == 0.0:
        return
    if indenter.depth_mm >= pad.thickness_mm:
        raise SimulateError(
            f"indenter.depth_mm = {indenter.depth_mm} mm goes through the pad; it must be below pad.thickness_mm = "
            f"{pad.thickness_mm} mm for the analytic press. {_BY_ELEMENTS}"
        )
    if indenter.shape not in _ANALYTIC_SHAPES:
        raise SimulateError(
            f'indenter.shape = "{indenter.shape}": the analytic press knows {" and ".join(_ANALYTIC_SHAPES)} only. '
            f"{_BY_ELEMENTS}"
        )
    turned = any(indenter.rotation_deg)
    if indenter.shape == "cylinder" and (indenter.across_mm != 0.0 or turned):
        field = (
            f"rotation_deg = {list(indenter.rotation_deg)} deg" if turned else f"across_mm = {indenter.across_mm:g} mm"
        )
        raise SimulateError(
            f"indenter.{field}: the analytic press is for a cylinder on the middle line, not turned. {_BY_ELEMENTS}"
        )


def without_press(design: FingerDesign) -> FingerDesign:
    """Return the same finger with nothing pressed into it."""
    return design.model_copy(update={"indenter": design.indenter.model_copy(update={"depth_mm": 0.0})})


def contact_half_width_mm(design: FingerDesign, drop_mm: ArrayLike = 0.0) -> NDArray[np.float64]:
    """Return half the chord of the indenter in the plane of the undeformed face, sqrt(2 R d - d^2).

    The geometric overlap of a line `drop_mm` below the crown, d = depth - drop; R once d reaches the radius R, zero
    where there is no overlap.
    """
    radius = design.indenter.radius_mm
    overlap = np.clip(design.indenter.depth_mm - np.asarray(drop_mm, dtype=np.float64), 0.0, radius)
    return np.asarray(np.sqrt(2.0 * radius * overlap - overlap**2))


def contact_distance(design: FingerDesign, x_mm: ArrayLike, z_mm: ArrayLike) -> NDArray[np.float64]:
    """Return the distance from the contact's centre in units of its half-width: the contact is where it is <= 1.

    sqrt(s^2 / w^2 + drop / depth), s the distance from the cylinder's line or the ball's centre, w the half-width
    at the crown; the drop of a curved pad from its crown ends the contact too. NaN without a press.
    """
    pad, indenter = design.pad, design.indenter
    x, z = np.broadcast_arrays(np.asarray(x_mm, dtype=np.float64), np.asarray(z_mm, dtype=np.float64))
    if indenter.depth_mm == 0.0:
        return np.full(x.shape, np.nan)
    drop = pad.drop_mm(x, z - pad.length_mm / 2.0) - pad.drop_mm(
        _across_mm(design), indenter.position_mm - pad.length_mm / 2.0
    )
    offset = _offset_mm(design, x, z) / contact_half_width_mm(design)
    return np.asarray(np.sqrt(offset**2 + np.maximum(drop, 0.0) / indenter.depth_mm))


def pressed_height_mm(
    design: FingerDesign, x_mm: NDArray[np.float64], z_mm: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the height of the coated face on a grid of the pad.

    Smooth minimum of the face and the indenter, plus B (s/l)^2 exp(-s/l) outside the contact, where s is the
    distance from its edge, l half the thickness, and B makes the net volume zero, for a cylinder on each line along
    the pad: the gel is incompressible. The depth counts from the crown at the indenter's position. Valid for one
    press well inside the pad; analytic, no stress is solved for.

    Parameters
    ----------
    design
        Pad and indenter.
    x_mm, z_mm
        Positions across (nx,) and along (nz,) the pad.

    Returns
    -------
    array
        Height above the inner face, mm, shape (nx, nz).

    Raises
    ------
    SimulateError
        When the press is not one that :func:`check_analytic_press` allows, or its contact leaves no free face beside
        it for the displaced volume.
    """
    check_analytic_press(design)
    pad, indenter = design.pad, design.indenter
    rest = rest_height_mm(design, x_mm[:, None], z_mm[None, :])
    if indenter.depth_mm == 0.0:
        return rest
    z = np.linspace(0.0, pad.length_mm, _QUADRATURE_POINTS)
    if indenter.shape == "cylinder":
        return np.stack(
            [_dent_and_bulge(design, x_mm[i : i + 1], z_mm, x_mm[i : i + 1], z)[0] for i in range(x_mm.size)]
        )
    x = np.linspace(-pad.width_mm / 2.0, pad.width_mm / 2.0, _QUADRATURE_COLUMNS)
    return _dent_and_bulge(design, x_mm, z_mm, x, z[:: _QUADRATURE_POINTS // _QUADRATURE_COLUMNS])


def rest_height_mm(design: FingerDesign, x_mm: ArrayLike, z_mm: ArrayLike) -> NDArray[np.float64]:
    """Return the height of the undeformed coated face above the inner one, shape of the broadcast arguments."""
    drop = design.pad.drop_mm(x_mm, np.asarray(z_mm, dtype=np.float64) - design.pad.length_mm / 2.0)
    return np.asarray(design.pad.thickness_mm - drop)


def _dent_and_bulge(
    design: FingerDesign,
    x_mm: NDArray[np.float64],
    z_mm: NDArray[np.float64],
    quadrature_x: NDArray[np.float64],
    quadrature_z: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Return the height on a grid; the bulge makes up for the volume that is missing on the quadrature grid."""
    indenter = design.indenter
    x, z = x_mm[:, None], z_mm[None, :]
    qx, qz = quadrature_x[:, None], quadrature_z[None, :]
    across = _across_mm(design)
    crown = rest_height_mm(design, across, indenter.position_mm)
    nearest = rest_height_mm(design, qx if indenter.shape == "cylinder" else across, indenter.position_mm)
    half_width = float(contact_half_width_mm(design, crown - nearest.max()))
    if indenter.depth_mm - (crown - nearest.max()) < _SMALLEST_OVERLAP_MM:
        return rest_height_mm(design, x, z)
    removed = _mean(rest_height_mm(design, qx, qz) - _dented(design, qx, qz))
    bulge = _mean(_bulge_shape(design, half_width, qx, qz))
    if bulge < _SMALLEST_BULGE_MEAN:
        raise SimulateError(
            f"indenter.radius_mm = {indenter.radius_mm} mm at depth {indenter.depth_mm} mm covers "
            f"the pad of {design.pad.length_mm} mm from end to end and leaves no free face; reduce radius or depth"
        )
    return _dented(design, x, z) + removed / bulge * _bulge_shape(design, half_width, x, z)


def _mean(values: NDArray[np.float64]) -> float:
    """Return the mean over a grid by the trapezoid rule."""
    means = np.trapezoid(values, axis=1) / (values.shape[1] - 1)
    return float(means[0] if means.size == 1 else np.trapezoid(means) / (means.size - 1))


def _across_mm(design: FingerDesign) -> float:
    """Return the place of the indenter across the pad; a cylinder lies on all of it."""
    return design.indenter.across_mm if design.indenter.shape == "ball" else 0.0


def _offset_mm(design: FingerDesign, x_mm: ArrayLike, z_mm: ArrayLike) -> NDArray[np.float64]:
    """Return the distance from the cylinder's line or from the ball's centre, seen along the press."""
    across = np.asarray(x_mm, dtype=np.float64) - _across_mm(design)
    along = np.asarray(z_mm, dtype=np.float64) - design.indenter.position_mm
    return np.asarray(np.hypot(across, along) if design.indenter.shape == "ball" else np.abs(along + 0.0 * across))


def _dented(design: FingerDesign, x_mm: NDArray[np.float64], z_mm: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the smooth minimum of the face and the indenter, without the bulge."""
    indenter, radius = design.indenter, design.indenter.radius_mm
    rest = rest_height_mm(design, x_mm, z_mm)
    bottom = rest_height_mm(design, _across_mm(design), indenter.position_mm) - indenter.depth_mm
    offset = _offset_mm(design, x_mm, z_mm)
    tool = bottom + radius - np.sqrt(np.maximum(radius**2 - offset**2, 0.0))
    tool = np.where(offset < radius, tool, np.inf)
    return np.asarray(-BLEND_MM * np.logaddexp(-rest / BLEND_MM, -tool / BLEND_MM))


def _bulge_shape(
    design: FingerDesign, half_width_mm: float, x_mm: NDArray[np.float64], z_mm: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the bulge beside the contact at unit amplitude; it decays over half the pad's thickness."""
    s = np.maximum(_offset_mm(design, x_mm, z_mm) - half_width_mm, 0.0) / (design.pad.thickness_mm / 2.0)
    return np.asarray(s**2 * np.exp(-s))
