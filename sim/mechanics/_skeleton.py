"""Skeleton of a finger: where its parts lie, seen from the side, and their hexahedra.

The mirror stands where the light needs it (:mod:`sim.surface_meshes`); the back fin follows its back, the front fin
lies under the pad, ribs join them at both sides of the hollow. Skeleton, base plate, backing and mirror are one
structured grid bent into shape, all parts conforming. Its lines: i across (x), k from base to tip, j from the back of
the finger to its front. Lines k run from the back fin to the front fin, parallel to the ribs where ribs are.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from data_schemas import Backing, FingerDesign, SimulateError, check_magnitude
from sim.mechanics._mesh import (
    Block,
    CornerGrading,
    FingerMesh,
    Grid,
    divided,
    fitted_between,
    graded,
    hexahedra_on_grid,
    quads_of_layer,
)
from sim.surface_meshes import MirrorShape, layout_scale, mirror_shape

BOND_MM = 0.1
"""Skin of adhesive under the pad, and around it on the front fin, where the pad has no film."""

_MIRROR_CLEARANCE_MM = 0.5
# the camera's pinhole lies 2 mm under the pad's end in the nominal lay-out; half as much again for its housing
_BASE_BELOW_CAMERA_MM = 3.0
_LIGHT_CLEARANCE_MM = 0.5
# least free length of a fin between neighbouring ribs, base and tip, and least room between the fins where the hollow
# ends: a nozzle of 0.4 mm closes a narrower slit
_SMALLEST_GAP_MM = 0.5
# what Newton's method leaves of the distance between a line and the back fin: far below an element, far above rounding
_ON_LINE_MM = 1e-6
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
    margin = min(half_width - pad.width_mm / 2.0, -base_line[0])
    if skeleton.flange_mm > margin:
        raise SimulateError(
            f"skeleton.flange_mm = {skeleton.flange_mm:g} mm reaches beyond the front fin, because the narrowest "
            f"margin beside and below the pad is {margin:.3g} mm; make flange_mm at most "
            f"{np.floor(100.0 * margin) / 100.0:g} mm"
        )
    if half_width - skeleton.rib_width_mm < rib_inner - 1e-9:
        raise SimulateError(
            f"skeleton.width_mm = {2.0 * half_width:g} mm is too narrow, because ribs of rib_width_mm = "
            f"{skeleton.rib_width_mm:g} mm would stand in front of the mirror; make width_mm at least "
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
    return z, _along_at(mirror, behind, np.array([inner_mm, z]), np.array([-1.0, 0.0]), "the base plate")


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
    s = _along_at(mirror, behind, np.array([inner_mm, z]), np.array([-1.0, 0.0]), "the tip")
    depth = inner_mm - float(back_curve_mm(mirror, s, behind)[0])
    if depth < _SMALLEST_GAP_MM:
        raise SimulateError(
            f"the fins are only {depth:.2g} mm apart at the tip, but must be at least {_SMALLEST_GAP_MM:g} mm apart; "
            f"reduce skeleton.tip_starts_mm = {z:g} mm or skeleton.front_fin_thickness_mm"
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
    what = f"a rib of skeleton.rib_angle_deg = {skeleton.rib_angle_deg:g} deg"
    along = [_along_at(mirror, behind, np.array([inner_mm, z]), towards_back, what) for z in front]
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
            f"{below} and {above} of the skeleton overlap or nearly touch ({gaps.min():.2f} mm apart along a fin, but "
            f"at least {_SMALLEST_GAP_MM:g} mm is needed); change skeleton.rib_count = {count}, rib_spacing_mm = "
            f"{spacing:.3g} mm, rib_thickness_mm = {skeleton.rib_thickness_mm:g} mm or rib_angle_deg = "
            f"{skeleton.rib_angle_deg:g} deg"
        )
    return edges


def _along_at(
    mirror: MirrorShape, behind_mm: float, start_yz: NDArray[np.float64], direction_yz: NDArray[np.float64], what: str
) -> float:
    """Return s where a line in the side view meets the back fin's inner face, by Newton's method from its tangent.

    Raises
    ------
    SimulateError
        When it passes the fin, which is bent away from it; `what` names the line.
    """
    across = np.array([-direction_yz[1], direction_yz[0]])
    s = 0.0
    for _ in range(20):
        off, step = ((back_curve_mm(mirror, s + d, behind_mm) - start_yz) @ across for d in (0.0, 1e-4))
        s -= 1e-4 * off / (step - off)
    if not abs((back_curve_mm(mirror, s, behind_mm) - start_yz) @ across) <= _ON_LINE_MM:
        raise SimulateError(
            f"{what} does not meet the back fin, because the fin is bent away from it (mirror.radius_mm = "
            f"{mirror.radius_mm:g} mm); make mirror.radius_mm larger, or the ribs' angle nearer to 0 deg"
        )
    return float(s)


# an end of window, mirror or backing this near to a grid line is taken to lie on it: no slivers
_SNAP_MM = 0.1
_FEWEST_ALONG_A_RIB = 6
MOST_RIB_WEDGE = 0.12
"""Most of :func:`rib_wedge`; elements along the ribs are shorter where it would be more."""
# the base plate is stiff and fixed from below
_COARSER_BASE = 2.0

RowKind = Literal["base", "gap", "rib", "tip"]
Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class SideView:
    """Points of the grid and what lies between its lines.

    Attributes
    ----------
    points_mm
        (y, z), shape (levels + 1, rows + 1, 2).
    along_mm
        s on the back fin of each line k; NaN in base plate and tip.
    kinds
        Of the row above each line k but the last.
    ends
        First level j of backing, back fin, room between the fins and front fin, and the last level.
    """

    points_mm: Floats
    along_mm: Floats
    kinds: NDArray[np.str_]
    ends: NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class _Rows:
    """Grid lines k over the hollow: z on the front fin, s on the back fin, and the kind of the row above each."""

    front_z_mm: Floats
    along_mm: Floats
    kinds: list[RowKind]


@dataclass(frozen=True, slots=True)
class _Edges:
    """Longest edge, and how edges grow from corners: from one as long as that where they are not graded."""

    longest_mm: float
    first_mm: float
    growth_ratio: float
    halvings: int

    def over(self, length_mm: float, corners: tuple[bool, bool] = (True, True)) -> Floats:
        """Return positions over a length."""
        places = graded(length_mm, self.first_mm, self.growth_ratio, self.longest_mm, corners)
        whole, parts = np.arange(len(places)), 2**self.halvings
        return np.asarray(np.interp(np.arange(parts * (len(places) - 1) + 1) / parts, whole, places))


def skeleton_side_view(
    design: FingerDesign, layout: SkeletonLayout, step_mm: float, corners: CornerGrading | None
) -> SideView:
    """Return the grid of skeleton, base plate and backing from the side.

    Parameters
    ----------
    design, layout
        Finger and where its skeleton lies.
    step_mm
        Largest edge of the elements; twice that in the base plate.
    corners
        How elements shrink towards inner corners; None: even ones.
    """
    skeleton = design.skeleton
    thinnest = min(skeleton.rib_thickness_mm, skeleton.front_fin_thickness_mm, skeleton.back_fin_thickness_mm)
    edges = (
        _Edges(step_mm, step_mm, 1.0, 0)
        if corners is None
        else _Edges(step_mm, corners.thickness_share * thinnest, corners.growth_ratio, corners.halvings)
    )
    rows = _rows(design, layout, edges)
    hollow, ends = _hollow(design, layout, rows, edges)
    points, below, above = _with_base_and_tip(design, hollow, rows, edges)
    return SideView(
        points_mm=points,
        along_mm=np.concatenate([np.full(below, np.nan), rows.along_mm, np.full(above, np.nan)]),
        kinds=np.array(["base"] * below + rows.kinds + ["tip"] * above),
        ends=ends,
    )


def _rows(design: FingerDesign, layout: SkeletonLayout, edges: _Edges) -> _Rows:
    """Return the grid lines of the hollow: through all edges of ribs, window, mirror and backing."""
    corners = np.concatenate([[layout.base_line], layout.ribs.reshape(-1, 2), [layout.tip_line]])
    wanted = [0.0, design.pad.length_mm, *np.interp(layout.mirror_along_mm, corners[:, 1], corners[:, 0])]
    if design.skeleton.backing is not None:
        wanted += _backing_ends(design.skeleton.backing, design, layout, corners)
    front = corners[:, 0]
    for z in wanted:
        if front[0] < z < front[-1] and np.abs(front - z).min() > _SNAP_MM:
            front = np.sort(np.append(front, z))
    along = np.interp(front, corners[:, 0], corners[:, 1])
    is_corner = np.isin(front, corners[:, 0])
    z_parts, s_parts, kinds = [front[:1]], [along[:1]], list[RowKind]()
    for k, middle in enumerate((front[1:] + front[:-1]) / 2.0):
        kind: RowKind = "gap" if np.searchsorted(corners[:, 0], middle) % 2 else "rib"
        width, behind = front[k + 1] - front[k], along[k + 1] - along[k]
        longer = width if kind == "rib" else max(width, behind)
        share = edges.over(longer, (bool(is_corner[k]), bool(is_corner[k + 1])))[1:] / longer
        z_parts.append(front[k] + share * width)
        s_parts.append(along[k] + share * behind)
        kinds += [kind] * len(share)
    return _Rows(np.concatenate(z_parts), np.concatenate(s_parts), kinds)


def _backing_ends(backing: Backing, design: FingerDesign, layout: SkeletonLayout, lines: Floats) -> list[float]:
    """Return z on the front fin of the grid lines that meet the ends of the backing."""
    s = np.linspace(lines[0, 1], lines[-1, 1], 1001)
    behind = design.skeleton.mirror_thickness_mm + design.skeleton.back_fin_thickness_mm
    ends = np.interp([backing.from_z_mm, backing.to_z_mm], back_curve_mm(layout.mirror, s, behind)[:, 1], s)
    return [float(z) for z in np.interp(ends, lines[:, 1], lines[:, 0])]


def _hollow(
    design: FingerDesign, layout: SkeletonLayout, rows: _Rows, edges: _Edges
) -> tuple[Floats, NDArray[np.int64]]:
    """Return the points of the grid over the hollow, shape (levels + 1, rows + 1, 2), and where its parts end."""
    skeleton = design.skeleton
    inner = skeleton.mirror_thickness_mm
    through_back = inner + edges.over(skeleton.back_fin_thickness_mm, (True, False))[::-1]
    if skeleton.backing is not None:
        through_back = np.concatenate([[through_back[0] + skeleton.backing.thickness_mm], through_back])
    back = back_curve_mm(layout.mirror, rows.along_mm[None, :], through_back[:, None])
    y_front = layout.front_inner_mm + edges.over(skeleton.front_fin_thickness_mm, (True, False))
    front = np.stack(np.broadcast_arrays(y_front[:, None], rows.front_z_mm[None, :]), axis=-1)
    deepest = layout.front_inner_mm - float(back_curve_mm(layout.mirror, layout.base_line[1], 0.0)[0])
    depth = np.linalg.norm(front[0] - back[-1], axis=1)
    while True:
        along_rib = edges.over(deepest)
        if len(along_rib) <= _FEWEST_ALONG_A_RIB:
            along_rib = np.linspace(0.0, deepest, _FEWEST_ALONG_A_RIB + 1)
        share = fitted_between(along_rib, depth)[:, :, None]
        between = (1.0 - share) * back[-1] + share * front[0]
        wedge = rib_wedge(between, rows.kinds)
        if wedge <= MOST_RIB_WEDGE:
            break
        # half the edge leaves a quarter of the wedge
        longest = min(edges.longest_mm, float(np.diff(along_rib).max()))
        edges = replace(edges, longest_mm=longest * min(0.95, np.sqrt(MOST_RIB_WEDGE / wedge)))
    backing = int(skeleton.backing is not None)
    levels = [0, backing, len(through_back) - 1 - backing, len(along_rib) - 1, len(y_front) - 1]
    return np.concatenate([back, between[1:-1], front]), np.cumsum(levels)


def rib_wedge(points_mm: Floats, kinds: Sequence[str]) -> float:
    """Return by how much the elements of ribs are wedges: the most of L/t tan(slant), over elements and ribs.

    L is an element's length along the rib, t the thickness of the whole rib there, and slant half the angle between
    the two edges through the rib. A bent rib of such elements is too stiff by about as much, 2 % at 0.09 and 10 % at
    0.22 (linear beams of one layer); a rib of several layers by less.

    Parameters
    ----------
    points_mm
        (y, z) of the grid between the fins, shape (levels, rows + 1, 2).
    kinds
        Of each row.
    """
    is_rib = np.array([kind == "rib" for kind in kinds])
    edges = np.flatnonzero(np.diff(np.concatenate([[False], is_rib, [False]]).astype(int)))
    low, high = points_mm[:, edges[0::2]], points_mm[:, edges[1::2]]
    through = high - low
    a, b = through[:-1], through[1:]
    slant = np.abs(np.arctan2(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0], (a * b).sum(axis=-1))) / 2.0
    along = np.diff((low + high) / 2.0, axis=0)
    length = np.linalg.norm(along, axis=-1)
    middle = (a + b) / 2.0
    thickness = np.abs(along[..., 0] * middle[..., 1] - along[..., 1] * middle[..., 0]) / length
    return float((length / thickness * np.tan(slant)).max(initial=0.0))


def _with_base_and_tip(design: FingerDesign, hollow: Floats, rows: _Rows, edges: _Edges) -> tuple[Floats, int, int]:
    """Return the points with the rows of base plate and tip, and how many rows these are."""
    base_mm, tip_mm = design.skeleton.base_thickness_mm, design.skeleton.tip_length_mm
    bottom, top = hollow[:, 0].copy(), hollow[:, -1].copy()
    bottom[:, 1] = rows.front_z_mm[0] - base_mm
    top[:, 1] = rows.front_z_mm[-1] + tip_mm
    below = divided([0.0, base_mm], _COARSER_BASE * edges.longest_mm)[:-1]
    above = edges.over(tip_mm, (True, False))[1:]
    share = (below / base_mm)[None, :, None]
    base = (1.0 - share) * bottom[:, None] + share * hollow[:, :1]
    share = (above / tip_mm)[None, :, None]
    tip = (1.0 - share) * hollow[:, -1:] + share * top[:, None]
    return np.concatenate([base, hollow, tip], axis=1), len(below), len(above)


def skeleton_mesh(
    design: FingerDesign, step_mm: float, across_mm: float | None = None, corners: CornerGrading | None = None
) -> FingerMesh:
    """Mesh skeleton, base plate, backing and mirror.

    Parameters
    ----------
    design
        Finger.
    step_mm
        Largest edge of the elements in the side view, in mm; twice that in the base plate.
    across_mm
        Largest edge across the finger, in mm; None: as in the side view.
    corners
        How elements shrink towards the inner corners between ribs and fins; None: even ones.

    Returns
    -------
    FingerMesh
        Blocks "skeleton", "base_plate", "backing" (if any) and "mirror"; node sets "fixed" (under the base plate) and
        "tip_end" (on top of the tip); surfaces "front" (towards the pad) and "mirror" (its face towards the pad).

    Raises
    ------
    SimulateError
        When the parts do not fit together.
    """
    layout = skeleton_layout(design)
    view = skeleton_side_view(design, layout, step_mm, corners)
    x = _across(design, layout, across_mm or step_mm)
    points = np.empty((len(x), *view.points_mm.shape[:2], 3))
    points[..., 0] = x[:, None, None]
    points[..., 1:] = view.points_mm
    grid = hexahedra_on_grid(points, _used(design, layout, view, x))
    return _assembled(layout, view, grid, x)


def _across(design: FingerDesign, layout: SkeletonLayout, step_mm: float) -> NDArray[np.float64]:
    """Return the grid lines across the finger, through the edges of window, mirror and ribs."""
    half = [design.pad.width_mm / 2.0, layout.mirror.half_width_mm, layout.rib_inner_mm, layout.half_width_mm]
    return divided([-x for x in reversed(half)] + half, step_mm)


def _used(design: FingerDesign, layout: SkeletonLayout, view: SideView, x: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return which cells of the grid hold material."""
    pad, backing, side_view, kinds = design.pad, design.skeleton.backing, view.points_mm, view.kinds
    x_middle = np.abs(x[1:] + x[:-1]) / 2.0
    front_z = (side_view[-1, 1:, 1] + side_view[-1, :-1, 1]) / 2.0
    _, back, between, front, end = view.ends
    used = np.zeros((len(x) - 1, end, len(kinds)), dtype=np.bool_)
    used[:, back:between] = used[:, front:end] = True
    window = (x_middle < pad.width_mm / 2.0)[:, None, None] & (front_z > 0.0) & (front_z < pad.length_mm)
    used[:, front:end] &= ~window
    used[:, between:front] = (x_middle > layout.rib_inner_mm)[:, None, None] & (kinds == "rib")
    used[:, between:front] |= (kinds == "base") | (kinds == "tip")
    used[:, :back] = kinds == "base"
    if backing is not None:
        back_z = (side_view[back, 1:, 1] + side_view[back, :-1, 1]) / 2.0
        used[:, :back] |= (kinds != "tip") & (back_z > backing.from_z_mm) & (back_z < backing.to_z_mm)
    return used


def _assembled(layout: SkeletonLayout, view: SideView, grid: Grid, x: NDArray[np.float64]) -> FingerMesh:
    """Return blocks, sets and surfaces of the grid, with the mirror on the back fin."""
    kinds, along = view.kinds, view.along_mm
    in_base, in_backing = kinds[grid.cells[:, 2]] == "base", grid.cells[:, 1] < view.ends[1]
    parts = {"skeleton": ~in_base & ~in_backing, "base_plate": in_base, "backing": ~in_base & in_backing}
    blocks = [
        Block(name, grid.hexahedra[own], "skeleton" if name == "skeleton" else "onyx", "incompatible_modes")
        for name, own in parts.items()
        if own.any()
    ]
    face = grid.numbers[:, view.ends[2], :].T
    middle = (along[1:] + along[:-1]) / 2.0
    first, last = layout.mirror_along_mm
    # rows of base and tip have no place on the mirror: NaN, which compares false
    mirrored = ((middle > first) & (middle < last))[:, None] & (
        np.abs(x[1:] + x[:-1]) / 2.0 < layout.mirror.half_width_mm
    )
    behind = quads_of_layer(face, mirrored)
    carriers, place = np.unique(behind, return_inverse=True)
    row, column = _where(face, carriers)
    front = np.column_stack([x[column], back_curve_mm(layout.mirror, along[row], 0.0)])
    facing = len(grid.nodes_mm) + place.reshape(-1, 4)
    blocks.append(Block("mirror", np.hstack([behind, facing]), "mirror", "incompatible_modes"))
    outer = grid.numbers[:, -1, :].T
    corners = np.stack([outer[:-1, :-1], outer[1:, :-1], outer[1:, 1:], outer[:-1, 1:]])
    used_front = np.zeros(corners.shape[1:], dtype=np.bool_)
    on_front = grid.cells[grid.cells[:, 1] == view.ends[4] - 1]
    used_front[on_front[:, 2], on_front[:, 0]] = True
    return FingerMesh(
        nodes_mm=np.concatenate([grid.nodes_mm, front]),
        blocks=tuple(blocks),
        node_sets={"fixed": _named(grid.numbers[:, :, 0]), "tip_end": _named(grid.numbers[:, :, -1])},
        surfaces={"front": quads_of_layer(outer, used_front), "mirror": facing},
        ties=(),
    )


def _where(face: NDArray[np.int64], nodes: NDArray[np.int64]) -> tuple[NDArray[np.int64], ...]:
    """Return row and column of node numbers on a sheet."""
    order = np.argsort(face, axis=None)
    at = order[np.searchsorted(face.ravel(), nodes, sorter=order)]
    return np.unravel_index(at, face.shape)


def _named(numbers: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the node numbers of grid points that are used."""
    return np.unique(numbers[numbers >= 0])
