"""Hexahedra of skeleton, base plate, backing and mirror: one structured grid bent into shape, all parts conforming.

Grid lines: i across (x), j and k as in :mod:`sim.mechanics.skeleton_side_view`.
"""

import numpy as np
from numpy.typing import NDArray

from data_schemas.design import FingerDesign
from sim.mechanics.corner_grading import CornerGrading
from sim.mechanics.mesh import Block, FingerMesh
from sim.mechanics.skeleton import SkeletonLayout, back_curve_mm, skeleton_layout
from sim.mechanics.skeleton_side_view import SideView, skeleton_side_view
from sim.mechanics.structured_grid import Grid, divided, hexahedra_on_grid, quads_of_layer


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
