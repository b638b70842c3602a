"""What is printed to build a finger: its skeleton, base plate and backing, and the mould of its pad."""

from typing import Literal

import numpy as np
from numpy.typing import NDArray

from data_schemas.design import FingerDesign
from data_schemas.errors import SimulateError
from sim.mechanics.pad_mould import MouldSizes, mould_grid
from sim.mechanics.skeleton_mesh import skeleton_mesh
from sim.surface_meshes.hexahedra import boundary_quads, split_quads
from sim.surface_meshes.planar_faces import planar_solid
from sim.surface_meshes.solid import Solid
from sim.surface_meshes.stl import stl_bytes

Part = Literal["skeleton", "base_plate", "backing", "skeleton_and_base"]

_ONE_PIECE = ("skeleton", "base_plate")
# chords of the back fin leave its curve by h^2 / 8 R = 0.3 um, printers lay down 100 um
_STEP_MM = 1.0


def part_stl(design: FingerDesign, part: Part = "skeleton") -> bytes:
    """Return a printed part of the finger as binary STL, in the finger's axes.

    Raises
    ------
    SimulateError
        When the design has no such part, or its parts do not fit together.
    """
    nodes, quads = _boundary(design, part)
    return stl_bytes(split_quads(quads, nodes), nodes, f"{part} of a finger, mm")


def part_solid(design: FingerDesign, part: Part = "skeleton") -> Solid:
    """Return a printed part of the finger with its flat faces; curved fins are strips of 1 mm, as in the STL file.

    Raises
    ------
    SimulateError
        When the design has no such part, or its parts do not fit together.
    """
    return planar_solid(*_boundary(design, part))


def _boundary(design: FingerDesign, part: Part) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return nodes and outward quadrilaterals of a part; skeleton and base share theirs, so as one piece they join."""
    mesh = skeleton_mesh(design, _STEP_MM)
    names = _ONE_PIECE if part == "skeleton_and_base" else (part,)
    if not set(names) <= set(mesh.hexahedra):
        raise SimulateError(f"the design '{design.name}' has no part {part}; it has {', '.join(mesh.hexahedra)}")
    return mesh.nodes_mm, boundary_quads(np.concatenate([mesh.hexahedra[name] for name in names])).quads


def mould_stl(design: FingerDesign, wall_mm: float = 3.0, floor_mm: float = 3.0, lining_mm: float = 0.0) -> bytes:
    """Return the mould in which the pad is cast, coat down and inner face open, as binary STL in the finger's axes.

    Parameters
    ----------
    design
        Finger.
    wall_mm, floor_mm
        Thickness around the pad and under its crown.
    lining_mm
        Thickness of a sheet that is laid on the bottom of the cavity, by which it is deeper than the pad.

    Raises
    ------
    SimulateError
        When a thickness is not positive, or an ellipsoidal mould is to be lined.
    """
    grid = mould_grid(design, MouldSizes(wall_mm, floor_mm, lining_mm))
    triangles = split_quads(boundary_quads(grid.hexahedra).quads, grid.nodes_mm)
    return stl_bytes(triangles, grid.nodes_mm, "mould of a gel pad, mm")
