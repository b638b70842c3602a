"""Hexahedra of skeleton, base plate, backing and mirror: one structured grid bent into shape, all parts conforming.

Grid lines: i across (x), j from the back of the finger to its front, k from base to tip along lines that run from the
back fin to the front fin, parallel to the ribs where ribs are.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from data_schemas.design import FingerDesign
from data_schemas.mechanical_design import Backing
from sim.mechanics.mesh import Block, FingerMesh
from sim.mechanics.skeleton import SkeletonLayout, back_curve_mm, skeleton_layout
from sim.mechanics.structured_grid import Grid, divided, hexahedra_on_grid, quads_of_layer

# an end of window, mirror or backing this near to a grid line moves onto it: no slivers
_SNAP_MM = 0.1
_FEWEST_ALONG_A_RIB = 6
# the base plate is stiff and fixed from below
_COARSER_BASE = 2.0

RowKind = Literal["base", "gap", "rib", "tip"]


@dataclass(frozen=True, slots=True)
class _Rows:
    """Grid lines k: z on the front fin, s on the back fin, and the kind of the row above each but the last."""

    front_z_mm: NDArray[np.float64]
    along_mm: NDArray[np.float64]
    kinds: NDArray[np.str_]


@dataclass(frozen=True, slots=True)
class _Levels:
    """Number of element layers from back to front: backing, back fin, between the fins, front fin."""

    backing: int
    back: int
    between: int
    front: int

    @property
    def ends(self) -> NDArray[np.int64]:
        """First level of backing, back fin, room between the fins and front fin, and the last level."""
        return np.cumsum([0, self.backing, self.back, self.between, self.front])


def skeleton_mesh(design: FingerDesign, step_mm: float, layers: int) -> FingerMesh:
    """Mesh skeleton, base plate, backing and mirror.

    Parameters
    ----------
    design
        Finger.
    step_mm
        Largest edge of the elements, in mm; twice that in the base plate.
    layers
        Elements through fins and ribs.

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
    layout, skeleton = skeleton_layout(design), design.skeleton
    rows = _rows(design, layout, step_mm, layers)
    deepest = layout.front_inner_mm - float(back_curve_mm(layout.mirror, layout.base_line[1], 0.0)[0])
    levels = _Levels(
        backing=0 if skeleton.backing is None else max(1, layers // 2),
        back=layers,
        between=max(_FEWEST_ALONG_A_RIB, int(np.ceil(deepest / step_mm))),
        front=layers,
    )
    side_view, kinds = _with_base_and_tip(design, _side_view(design, layout, rows, levels), rows, step_mm)
    x = _across(design, layout, step_mm)
    points = np.empty((len(x), *side_view.shape[:2], 3))
    points[..., 0] = x[:, None, None]
    points[..., 1:] = side_view
    below = int((kinds == "base").sum())
    along = np.full(side_view.shape[1], np.nan)
    along[below : below + len(rows.along_mm)] = rows.along_mm
    grid = hexahedra_on_grid(points, _used(design, layout, levels, x, side_view, kinds))
    return _assembled(layout, levels, grid, x, along, kinds)


def _rows(design: FingerDesign, layout: SkeletonLayout, step_mm: float, layers: int) -> _Rows:
    """Return the grid lines of the hollow: through all edges of ribs, window, mirror and backing."""
    lines = np.concatenate([[layout.base_line], layout.ribs.reshape(-1, 2), [layout.tip_line]])
    wanted = [0.0, design.pad.length_mm, *np.interp(layout.mirror_along_mm, lines[:, 1], lines[:, 0])]
    if design.skeleton.backing is not None:
        wanted += _backing_ends(design.skeleton.backing, design, layout, lines)
    front = lines[:, 0]
    for z in wanted:
        if front[0] < z < front[-1] and np.abs(front - z).min() > _SNAP_MM:
            front = np.sort(np.append(front, z))
    along = np.interp(front, lines[:, 0], lines[:, 1])
    rib = np.searchsorted(lines[:, 0], (front[1:] + front[:-1]) / 2.0) % 2 == 0
    fine = design.skeleton.rib_thickness_mm / np.cos(np.radians(design.skeleton.rib_angle_deg)) / layers
    z_parts, s_parts, kinds = [front[:1]], [along[:1]], []
    for k, is_rib in enumerate(rib):
        longer = max(front[k + 1] - front[k], 0.0 if is_rib else along[k + 1] - along[k])
        share = divided([0.0, 1.0], (fine if is_rib else step_mm) / longer)[1:]
        z_parts.append(front[k] + share * (front[k + 1] - front[k]))
        s_parts.append(along[k] + share * (along[k + 1] - along[k]))
        kinds += ["rib" if is_rib else "gap"] * len(share)
    return _Rows(np.concatenate(z_parts), np.concatenate(s_parts), np.array(kinds))


def _backing_ends(
    backing: Backing, design: FingerDesign, layout: SkeletonLayout, lines: NDArray[np.float64]
) -> list[float]:
    """Return z on the front fin of the grid lines that meet the ends of the backing."""
    s = np.linspace(lines[0, 1], lines[-1, 1], 1001)
    behind = design.skeleton.mirror_thickness_mm + design.skeleton.back_fin_thickness_mm
    ends = np.interp([backing.from_z_mm, backing.to_z_mm], back_curve_mm(layout.mirror, s, behind)[:, 1], s)
    return [float(z) for z in np.interp(ends, lines[:, 1], lines[:, 0])]


def _side_view(design: FingerDesign, layout: SkeletonLayout, rows: _Rows, levels: _Levels) -> NDArray[np.float64]:
    """Return the points (y, z) of the grid over the hollow, shape (levels + 1, rows + 1, 2)."""
    skeleton = design.skeleton
    inner = skeleton.mirror_thickness_mm
    outer = inner + skeleton.back_fin_thickness_mm
    behind = np.linspace(outer, inner, levels.back + 1)
    if skeleton.backing is not None:
        last = np.linspace(outer + skeleton.backing.thickness_mm, outer, levels.backing + 1)
        behind = np.concatenate([last[:-1], behind])
    back = back_curve_mm(layout.mirror, rows.along_mm[None, :], behind[:, None])
    y_front = np.linspace(layout.front_inner_mm, layout.front_outer_mm, levels.front + 1)
    front = np.stack(np.broadcast_arrays(y_front[:, None], rows.front_z_mm[None, :]), axis=-1)
    share = np.linspace(0.0, 1.0, levels.between + 1)[1:-1, None, None]
    return np.concatenate([back, (1.0 - share) * back[-1] + share * front[0], front])


def _with_base_and_tip(
    design: FingerDesign, side_view: NDArray[np.float64], rows: _Rows, step_mm: float
) -> tuple[NDArray[np.float64], NDArray[np.str_]]:
    """Return the side view with the rows of base plate and tip, and the kinds of all rows."""
    bottom, top = side_view[:, 0].copy(), side_view[:, -1].copy()
    bottom[:, 1] = rows.front_z_mm[0] - design.skeleton.base_thickness_mm
    top[:, 1] = rows.front_z_mm[-1] + design.skeleton.tip_length_mm
    below = divided([0.0, design.skeleton.base_thickness_mm], _COARSER_BASE * step_mm)[:-1]
    above = divided([0.0, design.skeleton.tip_length_mm], step_mm)[1:]
    share = (below / design.skeleton.base_thickness_mm)[None, :, None]
    base = (1.0 - share) * bottom[:, None] + share * side_view[:, :1]
    share = (above / design.skeleton.tip_length_mm)[None, :, None]
    tip = (1.0 - share) * side_view[:, -1:] + share * top[:, None]
    kinds = np.concatenate([np.full(len(below), "base"), rows.kinds, np.full(len(above), "tip")])
    return np.concatenate([base, side_view, tip], axis=1), kinds


def _across(design: FingerDesign, layout: SkeletonLayout, step_mm: float) -> NDArray[np.float64]:
    """Return the grid lines across the finger, through the edges of window, mirror and ribs."""
    half = [design.pad.width_mm / 2.0, layout.mirror.half_width_mm, layout.rib_inner_mm, layout.half_width_mm]
    return divided([-x for x in reversed(half)] + half, step_mm)


def _used(
    design: FingerDesign,
    layout: SkeletonLayout,
    levels: _Levels,
    x: NDArray[np.float64],
    side_view: NDArray[np.float64],
    kinds: NDArray[np.str_],
) -> NDArray[np.bool_]:
    """Return which cells of the grid hold material."""
    pad, backing = design.pad, design.skeleton.backing
    x_middle = np.abs(x[1:] + x[:-1]) / 2.0
    front_z = (side_view[-1, 1:, 1] + side_view[-1, :-1, 1]) / 2.0
    _, back, between, front, end = levels.ends
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


def _assembled(
    layout: SkeletonLayout,
    levels: _Levels,
    grid: Grid,
    x: NDArray[np.float64],
    along: NDArray[np.float64],
    kinds: NDArray[np.str_],
) -> FingerMesh:
    """Return blocks, sets and surfaces of the grid, with the mirror on the back fin."""
    in_base, in_backing = kinds[grid.cells[:, 2]] == "base", grid.cells[:, 1] < levels.ends[1]
    parts = {"skeleton": ~in_base & ~in_backing, "base_plate": in_base, "backing": ~in_base & in_backing}
    blocks = [
        Block(name, grid.hexahedra[own], "skeleton" if name == "skeleton" else "onyx", "incompatible_modes")
        for name, own in parts.items()
        if own.any()
    ]
    face = grid.numbers[:, levels.ends[2], :].T
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
    on_front = grid.cells[grid.cells[:, 1] == levels.ends[4] - 1]
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
