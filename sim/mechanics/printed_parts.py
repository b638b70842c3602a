"""What is printed to build a finger: its skeleton, base plate and backing, and the mould of its pad, as STL."""

from typing import Literal

import numpy as np

from data_schemas.design import FingerDesign
from data_schemas.errors import SimulateError
from sim.mechanics.skeleton_mesh import skeleton_mesh
from sim.mechanics.structured_grid import divided, hexahedra_on_grid
from sim.surface_meshes.hexahedra import boundary_quads, split_quads
from sim.surface_meshes.pressed_pad import rest_height_mm
from sim.surface_meshes.stl import stl_bytes

Part = Literal["skeleton", "base_plate", "backing"]

# chords of the back fin leave its curve by h^2 / 8 R = 0.3 um, printers lay down 100 um
_STEP_MM = 1.0
_MOULD_STEP_MM = 0.5


def part_stl(design: FingerDesign, part: Part = "skeleton") -> bytes:
    """Return a printed part of the finger as binary STL, in the finger's axes.

    Raises
    ------
    SimulateError
        When the design has no such part, or its parts do not fit together.
    """
    mesh = skeleton_mesh(design, _STEP_MM, layers=1)
    if part not in mesh.hexahedra:
        raise SimulateError(f"the design '{design.name}' has no part {part}; it has {', '.join(mesh.hexahedra)}")
    triangles = split_quads(boundary_quads(mesh.hexahedra[part]).quads, mesh.nodes_mm)
    return stl_bytes(triangles, mesh.nodes_mm, f"{part} of a finger, mm")


def mould_stl(design: FingerDesign, wall_mm: float = 3.0, floor_mm: float = 3.0) -> bytes:
    """Return the mould in which the pad is cast, coat down and inner face open, as binary STL in the finger's axes.

    The cavity is the pad as designed: shrinkage, draft and the thickness of a film laid into it are not allowed for.

    Parameters
    ----------
    design
        Finger.
    wall_mm, floor_mm
        Thickness around the pad and under its crown.

    Raises
    ------
    SimulateError
        When a thickness is not positive.
    """
    if wall_mm <= 0.0 or floor_mm <= 0.0:
        raise SimulateError(f"wall_mm = {wall_mm:g} and floor_mm = {floor_mm:g} of a mould must be positive")
    pad = design.pad
    half, length = pad.width_mm / 2.0, pad.length_mm
    x = np.concatenate([[-half - wall_mm], divided([-half, half], _MOULD_STEP_MM), [half + wall_mm]])
    z = np.concatenate([[-wall_mm], divided([0.0, length], _MOULD_STEP_MM), [length + wall_mm]])
    coat = rest_height_mm(design, np.clip(x, -half, half)[:, None], np.clip(z, 0.0, length)[None, :])
    y = np.stack([np.zeros_like(coat), coat, np.full_like(coat, pad.thickness_mm + floor_mm)], axis=1)
    used = np.ones(tuple(n - 1 for n in y.shape), dtype=np.bool_)
    used[1:-1, 0, 1:-1] = False
    grid = hexahedra_on_grid(np.stack(np.broadcast_arrays(x[:, None, None], y, z), axis=-1), used)
    triangles = split_quads(boundary_quads(grid.hexahedra).quads, grid.nodes_mm)
    return stl_bytes(triangles, grid.nodes_mm, "mould of a gel pad, mm")
