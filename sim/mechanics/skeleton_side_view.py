"""The skeleton's grid seen from the side: lines k from base to tip, j from the back of the finger to its front.

Lines k run from the back fin to the front fin, parallel to the ribs where ribs are.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from data_schemas.design import FingerDesign
from data_schemas.mechanical_design import Backing
from sim.mechanics.corner_grading import CornerGrading, fitted_between, graded
from sim.mechanics.skeleton import SkeletonLayout, back_curve_mm
from sim.mechanics.structured_grid import divided

# an end of window, mirror or backing this near to a grid line is taken to lie on it: no slivers
_SNAP_MM = 0.1
_FEWEST_ALONG_A_RIB = 6
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
    along_rib = edges.over(deepest)
    if len(along_rib) <= _FEWEST_ALONG_A_RIB:
        along_rib = np.linspace(0.0, deepest, _FEWEST_ALONG_A_RIB + 1)
    share = fitted_between(along_rib, np.linalg.norm(front[0] - back[-1], axis=1))[1:-1, :, None]
    backing = int(skeleton.backing is not None)
    levels = [0, backing, len(through_back) - 1 - backing, len(along_rib) - 1, len(y_front) - 1]
    return np.concatenate([back, (1.0 - share) * back[-1] + share * front[0], front]), np.cumsum(levels)


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
