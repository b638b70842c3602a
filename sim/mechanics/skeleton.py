"""Where the parts of a finger's skeleton lie, seen from the side: all that the mesh of the skeleton needs to know.

The mirror stands where the light needs it (:mod:`sim.surface_meshes.back_mirror`); the back fin follows its back,
the front fin lies under the pad, ribs join them at both sides of the hollow.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from data_schemas.design import FingerDesign
from data_schemas.errors import SimulateError
from data_schemas.mechanical_design import check_magnitude
from sim.surface_meshes.back_mirror import MirrorShape, layout_scale, mirror_shape

BOND_MM = 0.1
"""Skin of adhesive under the pad, and around it on the front fin, where the pad has no film."""

_MIRROR_CLEARANCE_MM = 0.5
# the camera's pinhole lies 2 mm under the pad's end in the nominal lay-out; half as much again for its housing
_BASE_BELOW_CAMERA_MM = 3.0
_LIGHT_CLEARANCE_MM = 0.5
# least free length of a fin between neighbouring ribs, base and tip
_SMALLEST_GAP_MM = 0.5
# least room between the fins where the hollow ends
_SMALLEST_DEPTH_MM = 1.0
_PAD_SIZES_MM = (5.0, 300.0)
_PAD_THICKNESS_MM = (0.5, 50.0)
_FILM_THICKNESS_MM = (0.01, 2.0)


@dataclass(frozen=True, slots=True)
class SkeletonLayout:
    """Places in the finger's axes, mm.

    Attributes
    ----------
    mirror
        The sheet that light meets; ``along`` below is the coordinate s on it.
    mirror_along_mm
        Part of the sheet that the skeleton carries, from and to.
    front_outer_mm, front_inner_mm
        y of the front fin's faces.
    half_width_mm, rib_inner_mm
        x of the fins' side, and of the ribs' side towards the hollow.
    base_line, tip_line
        Ends of the hollow: z on the front fin, s on the back fin.
    ribs
        Lower, then upper edge of each rib from the base on: z on the front fin, s on the back fin, shape (ribs, 2, 2).
    """

    mirror: MirrorShape
    mirror_along_mm: tuple[float, float]
    front_outer_mm: float
    front_inner_mm: float
    half_width_mm: float
    rib_inner_mm: float
    base_line: tuple[float, float]
    tip_line: tuple[float, float]
    ribs: NDArray[np.float64]


def back_curve_mm(mirror: MirrorShape, along_mm: ArrayLike, behind_mm: ArrayLike) -> NDArray[np.float64]:
    """Return points (y, z), shape (..., 2), at a distance behind the mirror's front along its own normal."""
    s, behind = np.broadcast_arrays(np.asarray(along_mm, dtype=np.float64), np.asarray(behind_mm, dtype=np.float64))
    slope = s / mirror.radius_mm
    front = (
        mirror.apex_yz_mm
        + s[..., None] * mirror.tangent_yz
        - (s**2 / (2.0 * mirror.radius_mm))[..., None] * mirror.normal_yz
    )
    normal = (mirror.normal_yz + slope[..., None] * mirror.tangent_yz) / np.sqrt(1.0 + slope**2)[..., None]
    return np.asarray(front - behind[..., None] * normal)


def skeleton_layout(design: FingerDesign) -> SkeletonLayout:
    """Return where the skeleton of a finger lies.

    Raises
    ------
    SimulateError
        When sizes of the pad seem to be in another unit, or the parts do not fit; the message names the field.
    """
    _check_pad(design)
    skeleton, pad, mirror = design.skeleton, design.pad, mirror_shape(design)
    outer = -(BOND_MM if pad.film is None else pad.film.thickness_mm)
    inner = outer - skeleton.front_fin_thickness_mm
    first = -mirror.half_length_mm
    base_line = _base_line(design, mirror, inner)
    tip_line = _tip_line(design, mirror, inner)
    rib_inner = mirror.half_width_mm + _MIRROR_CLEARANCE_MM
    half_width = rib_inner + skeleton.rib_width_mm if skeleton.width_mm is None else skeleton.width_mm / 2.0
    if pad.width_mm / 2.0 + skeleton.flange_mm > half_width or skeleton.flange_mm > -base_line[0]:
        raise SimulateError(
            f"skeleton.flange_mm = {skeleton.flange_mm:g} mm reaches beyond the front fin, which leaves "
            f"{min(half_width - pad.width_mm / 2.0, -base_line[0]):.3g} mm around the pad"
        )
    if half_width - skeleton.rib_width_mm < rib_inner - 1e-9:
        raise SimulateError(
            f"skeleton.width_mm = {2.0 * half_width:g} mm is too narrow: ribs of rib_width_mm = "
            f"{skeleton.rib_width_mm:g} mm would stand in front of the mirror; it must be at least "
            f"{2.0 * (rib_inner + skeleton.rib_width_mm):g} mm (or leave it out), or the ribs narrower"
        )
    return SkeletonLayout(
        mirror=mirror,
        mirror_along_mm=(first, min(mirror.half_length_mm, tip_line[1] - _MIRROR_CLEARANCE_MM)),
        front_outer_mm=outer,
        front_inner_mm=inner,
        half_width_mm=half_width,
        rib_inner_mm=half_width - skeleton.rib_width_mm,
        base_line=base_line,
        tip_line=tip_line,
        ribs=_ribs(design, mirror, inner, base_line, tip_line),
    )


def _check_pad(design: FingerDesign) -> None:
    """Check that the pad's sizes can be mm."""
    pad = design.pad
    sizes = [
        ("length_mm", pad.length_mm, _PAD_SIZES_MM),
        ("width_mm", pad.width_mm, _PAD_SIZES_MM),
        ("thickness_mm", pad.thickness_mm, _PAD_THICKNESS_MM),
    ]
    if pad.film is not None:
        sizes.append(("film.thickness_mm", pad.film.thickness_mm, _FILM_THICKNESS_MM))
    for name, value, bounds in sizes:
        try:
            check_magnitude(value, *bounds, "mm")
        except ValueError as error:
            raise SimulateError(f"pad.{name}: {error}") from error


def _base_line(design: FingerDesign, mirror: MirrorShape, inner_mm: float) -> tuple[float, float]:
    """Return the top of the base plate, under mirror, camera and the panels at the base: z in front, s at the back."""
    behind = design.skeleton.mirror_thickness_mm
    under_mirror = float(back_curve_mm(mirror, -mirror.half_length_mm - _MIRROR_CLEARANCE_MM, behind)[1])
    lights = [light.position_mm[2] - light.height_mm / 2.0 - _LIGHT_CLEARANCE_MM for light in design.lights]
    z = min(under_mirror, -_BASE_BELOW_CAMERA_MM * layout_scale(design), *lights)
    return z, _along_at(mirror, behind, np.array([inner_mm, z]), np.array([-1.0, 0.0]))


def _tip_line(design: FingerDesign, mirror: MirrorShape, inner_mm: float) -> tuple[float, float]:
    """Return where the hollow ends at the tip: z on the front fin, s on the back fin, at one height."""
    behind, past = design.skeleton.mirror_thickness_mm, mirror.half_length_mm + _MIRROR_CLEARANCE_MM
    z = design.skeleton.tip_starts_mm
    if z is None:
        z = float(back_curve_mm(mirror, past, behind)[1])
    elif z < design.pad.length_mm + design.skeleton.flange_mm:
        raise SimulateError(
            f"skeleton.tip_starts_mm = {z:g} mm must lie above the end of the pad and its flange (pad.length_mm = "
            f"{design.pad.length_mm:g} mm, skeleton.flange_mm = {design.skeleton.flange_mm:g} mm)"
        )
    s = _along_at(mirror, behind, np.array([inner_mm, z]), np.array([-1.0, 0.0]))
    depth = inner_mm - float(back_curve_mm(mirror, s, behind)[0])
    if depth < _SMALLEST_DEPTH_MM:
        raise SimulateError(
            f"the fins are {depth:.2g} mm apart at the tip ({_SMALLEST_DEPTH_MM:g} mm needed): make "
            f"skeleton.tip_starts_mm = {z:g} mm smaller, or skeleton.front_fin_thickness_mm"
        )
    return z, s


def _ribs(
    design: FingerDesign,
    mirror: MirrorShape,
    inner_mm: float,
    base_line: tuple[float, float],
    tip_line: tuple[float, float],
) -> NDArray[np.float64]:
    """Return the edges of the ribs on both fins and check that they stand apart."""
    skeleton, angle = design.skeleton, np.radians(design.skeleton.rib_angle_deg)
    count = skeleton.rib_count
    spacing = skeleton.rib_spacing_mm or (tip_line[0] - base_line[0]) / (count + 1)
    centres = (base_line[0] + tip_line[0]) / 2.0 + spacing * (np.arange(count) - (count - 1) / 2.0)
    half = skeleton.rib_thickness_mm / 2.0 / np.cos(angle)
    towards_back = np.array([-np.cos(angle), np.sin(angle)])
    behind = skeleton.mirror_thickness_mm
    front = (centres[:, None] + half * np.array([-1.0, 1.0])).reshape(-1)
    along = [_along_at(mirror, behind, np.array([inner_mm, z]), towards_back) for z in front]
    edges = np.column_stack([front, along]).reshape(count, 2, 2)
    lines = np.concatenate([[base_line], edges.reshape(-1, 2), [tip_line]])
    gaps = np.diff(lines, axis=0)[::2].min(axis=1)
    if gaps.min() < _SMALLEST_GAP_MM:
        place = int(np.argmin(gaps))
        below, above = (
            ("the base" if place == 0 else f"rib {place}"),
            ("the tip" if place == count else f"rib {place + 1}"),
        )
        raise SimulateError(
            f"{below} and {above} of the skeleton overlap or nearly touch ({gaps.min():.2f} mm apart along a fin, at "
            f"least {_SMALLEST_GAP_MM:g} mm needed): change skeleton.rib_count = {count}, rib_spacing_mm = "
            f"{spacing:.3g} mm, rib_thickness_mm = {skeleton.rib_thickness_mm:g} mm or rib_angle_deg = "
            f"{skeleton.rib_angle_deg:g} deg"
        )
    return edges


def _along_at(
    mirror: MirrorShape, behind_mm: float, start_yz: NDArray[np.float64], direction_yz: NDArray[np.float64]
) -> float:
    """Return s where a line in the side view meets the back fin's inner face, by Newton's method from its tangent."""
    across = np.array([-direction_yz[1], direction_yz[0]])
    s = 0.0
    for _ in range(20):
        off, step = ((back_curve_mm(mirror, s + d, behind_mm) - start_yz) @ across for d in (0.0, 1e-4))
        s -= 1e-4 * off / (step - off)
    return float(s)
