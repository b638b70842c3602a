"""What is printed to build a finger: its skeleton, base plate and backing, and the mould in which its pad is cast.

The mould is a tray whose cavity is the pad as designed, coated face down, open where the inner face will be. The
walls of the cavity are upright (no draft): the silicone is soft enough to be peeled out, and the pad's walls, which
are painted, must stand at right angles. Shrinkage is not allowed for.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from data_schemas import FingerDesign, GelPad, SimulateError
from sim.mechanics._mesh import Grid, divided, hexahedra_on_grid
from sim.mechanics._skeleton import skeleton_mesh
from sim.surface_meshes import (
    Coordinates,
    Edge,
    EllipseArc,
    Face,
    HollowCylinder,
    HollowEllipsoid,
    Loop,
    Plane,
    Solid,
    boundary_quads,
    planar_solid,
    rest_height_mm,
    split_quads,
    stl_bytes,
)

LINING_MM = 0.1
"""Sheet that is laid on the bottom of flat and cylindrical moulds for a smooth pad; the paper's Mylar."""

_WALL_MM = 3.0
# of the film's flange, on the rim where the mould is closed with the film
_BEYOND_FLANGE_MM = 2.0
_STEP_MM = 0.5
# the patch of an ellipsoid reaches this much beyond the corners of the pad, as far as it can
_PATCH_REACH = 1.01
# signs of x and z of the corners of a ring, in the order that is counter-clockwise from the open side (-y)
_ROUND = np.array([(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)])


@dataclass(frozen=True, slots=True)
class MouldSizes:
    """Sizes of a mould: walls around the cavity, floor under the crown, sheet laid on its bottom (0: none)."""

    wall_mm: float
    floor_mm: float
    lining_mm: float

    def __post_init__(self) -> None:
        if not (self.wall_mm > 0.0 and self.floor_mm > 0.0):
            raise SimulateError(
                f"wall_mm and floor_mm of a mould must be positive, got {self.wall_mm:g} and {self.floor_mm:g} mm"
            )
        if not 0.0 <= self.lining_mm <= 1.0:
            raise SimulateError(
                "lining_mm of a mould (the thickness of the sheet on the mould's floor) must be from 0 to 1 mm, got "
                f"{self.lining_mm:g} mm"
            )


_BENT_TO = ("flat", "cylindrical")  # of these pads a sheet takes the shape; of another package's it is not known


def mould_sizes(design: FingerDesign, lining_mm: float | None = None) -> MouldSizes:
    """Return the sizes of a pad's mould: a rim on which the film's flange lies, a lining where a sheet can be bent.

    Parameters
    ----------
    design
        Finger.
    lining_mm
        Thickness of the sheet on the bottom; by default 0.1 mm, and none in an ellipsoidal mould or that of another
        package.
    """
    if lining_mm is None:
        lining_mm = LINING_MM if design.pad.shape in _BENT_TO else 0.0
    return MouldSizes(max(_WALL_MM, design.skeleton.flange_mm + _BEYOND_FLANGE_MM), _WALL_MM, lining_mm)


def mould_grid(design: FingerDesign, sizes: MouldSizes) -> Grid:
    """Return hexahedra of the mould, in the finger's axes, for its surface of triangles.

    Raises
    ------
    SimulateError
        When an ellipsoidal mould is to be lined.
    """
    lined = design.model_copy(update={"pad": _lined(design.pad, sizes.lining_mm)})
    half, length, wall = design.pad.width_mm / 2.0, design.pad.length_mm, sizes.wall_mm
    x = np.concatenate([[-half - wall], divided([-half, half], _STEP_MM), [half + wall]])
    z = np.concatenate([[-wall], divided([0.0, length], _STEP_MM), [length + wall]])
    coat = rest_height_mm(lined, np.clip(x, -half, half)[:, None], np.clip(z, 0.0, length)[None, :])
    y = np.stack([np.zeros_like(coat), coat, np.full_like(coat, lined.pad.thickness_mm + sizes.floor_mm)], axis=1)
    used = np.ones(tuple(n - 1 for n in y.shape), dtype=np.bool_)
    used[1:-1, 0, 1:-1] = False
    return hexahedra_on_grid(np.stack(np.broadcast_arrays(x[:, None, None], y, z), axis=-1), used)


def mould_solid(design: FingerDesign, sizes: MouldSizes) -> Solid:
    """Return the mould with exact faces, in the finger's axes: planes, and a cylinder or ellipsoid on its bottom.

    Raises
    ------
    SimulateError
        When an ellipsoidal mould is to be lined.
    """
    if design.pad.package is not None:
        raise SimulateError(
            f'pad.shape = "{design.pad.shape}" comes from {design.pad.package} and cannot be written as STEP; write '
            "the mould as STL"
        )
    pad = _lined(design.pad, sizes.lining_mm)
    half, middle, wall = pad.width_mm / 2.0, pad.length_mm / 2.0, sizes.wall_mm
    # rings of four corners: rim outside, underside, rim inside, bottom of the cavity
    outside, inside = (half + wall, middle + wall), (half, middle)
    bottom_mm = pad.thickness_mm - float(pad.drop_mm(half, middle))
    heights_mm = (0.0, pad.thickness_mm + sizes.floor_mm, 0.0, bottom_mm)
    corners = [
        (x * across, y, middle + z * along)
        for (across, along), y in zip((outside, outside, inside, inside), heights_mm, strict=True)
        for x, z in _ROUND
    ]
    ring_edges = [Edge(4 * ring + i, 4 * ring + (i + 1) % 4) for ring in range(3) for i in range(4)]
    bottom_edges = [Edge(12 + i, 12 + (i + 1) % 4, _bottom_arc(pad, i)) for i in range(4)]
    upright = [Edge(ring + i, ring + 4 + i) for ring in (0, 8) for i in range(4)]
    points = np.array(corners)
    return Solid(points, (*ring_edges, *bottom_edges, *upright), _mould_faces(pad, points))


def _lined(pad: GelPad, lining_mm: float) -> GelPad:
    """Return the pad together with the sheet under its coat: its face moved outward along its normal."""
    if not lining_mm:
        return pad
    if pad.shape not in _BENT_TO:
        raise SimulateError(
            f"lining_mm = {lining_mm:g} mm is not supported, because a sheet cannot be bent to pad.shape = "
            f"{pad.shape}; leave lining_mm out"
        )
    radius = None if pad.radius_mm is None else pad.radius_mm + lining_mm
    return pad.model_copy(update={"thickness_mm": pad.thickness_mm + lining_mm, "radius_mm": radius})


def _bottom_arc(pad: GelPad, side: int) -> EllipseArc | None:
    """Return the arc in which the bottom of the cavity meets one of its walls; none where they meet in a line."""
    x, z = (_ROUND[side] + _ROUND[(side + 1) % 4]) / 2.0 * (pad.width_mm / 2.0, pad.length_mm / 2.0)
    along = np.zeros(3)
    along[[0, 2]] = (_ROUND[(side + 1) % 4] - _ROUND[side]) / 2.0
    if pad.radius_mm is not None and z:
        long_mm = high_mm = pad.radius_mm
        centre_mm = pad.thickness_mm - pad.radius_mm
    elif pad.semi_axes_mm is not None:
        a, b, c = pad.semi_axes_mm
        share = np.sqrt(1.0 - (x / a) ** 2 - (z / c) ** 2)
        long_mm, high_mm, centre_mm = (a if z else c) * share, b * share, pad.thickness_mm - b
    else:
        return None
    centre = np.array([x, centre_mm, pad.length_mm / 2.0 + z])
    return EllipseArc(centre, -long_mm * along, np.array([0.0, high_mm, 0.0]))


def _mould_faces(pad: GelPad, corners_mm: Coordinates) -> tuple[Face, ...]:
    """Return rim, underside, bottom of the cavity, outer sides and walls; edges are numbered ring by ring."""
    up, down = np.array([0.0, -1.0, 0.0]), np.array([0.0, 1.0, 0.0])
    outer, under, inner, bottom = (_ring(4 * ring) for ring in range(4))
    faces = [
        Face(Plane(corners_mm[0], up), (outer, _backwards(inner))),
        Face(Plane(corners_mm[4], down), (_backwards(under),)),
        Face(_bottom_surface(pad), (bottom,)),
    ]
    for i in range(4):
        normal = np.zeros(3)
        normal[[0, 2]] = (_ROUND[i] + _ROUND[(i + 1) % 4]) / 2.0
        after = (i + 1) % 4
        outside = ((i, False), (16 + i, True), (4 + i, True), (16 + after, False))
        inside = ((8 + i, True), (20 + after, True), (12 + i, False), (20 + i, False))
        faces += [
            Face(Plane(corners_mm[i], normal), (outside,)),
            Face(Plane(corners_mm[8 + i], -normal), (inside,)),
        ]
    return tuple(faces)


def _ring(first: int) -> Loop:
    """Return four edges run one after the other."""
    return tuple((first + i, True) for i in range(4))


def _backwards(loop: Loop) -> Loop:
    """Return a loop run the other way."""
    return tuple((edge, not forward) for edge, forward in reversed(loop))


def _bottom_surface(pad: GelPad) -> Plane | HollowCylinder | HollowEllipsoid:
    """Return the surface of the cavity's bottom."""
    middle, crown = pad.length_mm / 2.0, pad.thickness_mm
    if pad.radius_mm is not None:
        return HollowCylinder(np.array([0.0, crown - pad.radius_mm, middle]), np.array([0.0, 0.0, 1.0]), pad.radius_mm)
    if pad.semi_axes_mm is None:
        return Plane(np.array([0.0, crown, middle]), np.array([0.0, -1.0, 0.0]))
    a, b, c = pad.semi_axes_mm
    x, z = pad.width_mm / 2.0 / a, middle / c
    u, v = np.array([x, z]) / (1.0 + np.sqrt(1.0 - x**2 - z**2))
    # at the ellipsoid's equator u^2 + v^2 is 1
    reach = min(_PATCH_REACH, (1.0 + 1.0 / float(np.hypot(u, v))) / 2.0)
    return HollowEllipsoid(np.array([0.0, crown - b, middle]), np.array([a, b, c]), float(reach * u), float(reach * v))


Part = Literal["skeleton", "base_plate", "backing", "skeleton_and_base"]

_ONE_PIECE = ("skeleton", "base_plate")
# chords of the back fin leave its curve by h^2 / 8 R = 0.3 um, printers lay down 100 um
_SKELETON_STEP_MM = 1.0


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
    mesh = skeleton_mesh(design, _SKELETON_STEP_MM)
    names = _ONE_PIECE if part == "skeleton_and_base" else (part,)
    if not set(names) <= set(mesh.hexahedra):
        raise SimulateError(f"the design '{design.name}' has no part {part}; its parts are {', '.join(mesh.hexahedra)}")
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
