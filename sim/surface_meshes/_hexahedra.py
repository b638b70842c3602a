"""A mesh of hexahedra, deformed or not, as the surfaces that light meets.

The boundary of the hexahedra as quadrilaterals and triangles with outward normals, and what these are worth; then the
surfaces of a whole finger's mesh, told apart by where they lie in the undeformed mesh.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from data_schemas import FingerDesign, SimulateError
from sim.surface_meshes._finger_shape import GEL_FACES, FingerShape, MirrorShape, Surface, mirror_shape, rest_height_mm

# corners of the faces of a hexahedron in C3D8 order, counter-clockwise seen from outside
HEXAHEDRON_FACES = np.array([[0, 3, 2, 1], [4, 5, 6, 7], [0, 1, 5, 4], [1, 2, 6, 5], [2, 3, 7, 6], [3, 0, 4, 7]])

_NEIGHBOURS = np.array([[1, 3, 4], [2, 0, 5], [3, 1, 6], [0, 2, 7], [7, 5, 0], [4, 6, 1], [5, 7, 2], [6, 4, 3]])
# diagonals that differ by less, relative, count as equal: rounding must not decide the split
_EQUAL_DIAGONALS_REL = 1e-9


@dataclass(frozen=True, slots=True)
class BoundaryQuads:
    """Boundary quadrilaterals (k, 4) with outward normals, and the hexahedron that each belongs to, (k,)."""

    quads: NDArray[np.int64]
    owner: NDArray[np.int64]


def boundary_quads(hexahedra: NDArray[np.int64]) -> BoundaryQuads:
    """Return the faces that belong to one hexahedron only.

    A face is known by its four node numbers in ascending order, as two 64-bit keys; faces that occur twice lie
    inside.

    Parameters
    ----------
    hexahedra
        Node numbers (m, 8) in Abaqus' C3D8 order, 0 to 2^31.
    """
    quads = hexahedra[:, HEXAHEDRON_FACES].reshape(-1, 4)
    count = int(hexahedra.max()) + 1
    a, b, c, d = np.ascontiguousarray(quads.T)
    low_ab, high_ab, low_cd, high_cd = np.minimum(a, b), np.maximum(a, b), np.minimum(c, d), np.maximum(c, d)
    lowest, highest = np.minimum(low_ab, low_cd), np.maximum(high_ab, high_cd)
    second = np.minimum(np.maximum(low_ab, low_cd), np.minimum(high_ab, high_cd))
    third = a + b + c + d - lowest - second - highest
    first_key, second_key = lowest * count + second, third * count + highest
    order = np.lexsort((second_key, first_key))
    first_key, second_key = first_key[order], second_key[order]
    again = (first_key[1:] == first_key[:-1]) & (second_key[1:] == second_key[:-1])
    inside = np.concatenate([again, [False]]) | np.concatenate([[False], again])
    kept = np.sort(order[~inside])
    return BoundaryQuads(quads[kept], kept // len(HEXAHEDRON_FACES))


def split_quads(quads: NDArray[np.int64], nodes_mm: NDArray[np.float64]) -> NDArray[np.int64]:
    """Return two triangles per quad, (2 k, 3), split on the shorter diagonal (first to third corner when equal).

    Triangles 2 i and 2 i + 1 belong to quad i and keep its normal.
    """
    a, b, c, d = (nodes_mm[quads[:, i]] for i in range(4))
    ac, bd = ((a - c) ** 2).sum(axis=1), ((b - d) ** 2).sum(axis=1)
    other = (bd < ac * (1.0 - _EQUAL_DIAGONALS_REL))[:, None]
    first = np.where(other, quads[:, [0, 1, 3]], quads[:, [0, 1, 2]])
    second = np.where(other, quads[:, [1, 2, 3]], quads[:, [0, 2, 3]])
    return np.stack([first, second], axis=1).reshape(-1, 3)


def corner_jacobians_mm3(nodes_mm: NDArray[np.float64], hexahedra: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return the triple product of the three edges at each corner, shape (m, 8): 8 times the Jacobian there."""
    points = nodes_mm[hexahedra]
    edges = points[:, _NEIGHBOURS] - points[:, :, None, :]
    return np.asarray(np.einsum("ecx,ecx->ec", np.cross(edges[:, :, 0], edges[:, :, 1]), edges[:, :, 2]))


DARK_BODIES = ("skeleton", "base_plate", "backing")
"""Blocks behind which there is no light; together with the mirror they conform."""

# nodes are placed on the planes of the pad and on the mirror to rounding; the thinnest sheet has 0.02 mm
_ON_FACE_MM = 1e-3


def shape_from_mesh(
    design: FingerDesign,
    nodes_mm: NDArray[np.float64],
    hexahedra: Mapping[str, NDArray[np.int64]],
    displacement_mm: NDArray[np.float64] | None = None,
    contact_distance: NDArray[np.float64] | None = None,
    label: str = "mesh at rest",
) -> FingerShape:
    """Return the surfaces of a meshed finger, with the texture coordinates of the undeformed one.

    Faces are told apart, and quads split, by where they are in the undeformed mesh; so a deformed finger has the
    triangles of the undeformed one. The film is left out: optics counts it as part of the inner face.

    Parameters
    ----------
    design
        Finger that was meshed.
    nodes_mm
        Nodes of the undeformed mesh, shape (n, 3).
    hexahedra
        Hexahedra (m, 8) of the blocks "gel" and "mirror", and of any of "skeleton", "base_plate" and "backing".
    displacement_mm
        Of the nodes, shape (n, 3); none for the finger at rest.
    contact_distance
        Per vertex of the coat in the order of :func:`coat_nodes`, distance from the centre of the contact in units of
        its half-width; without contact it is NaN.
    label
        Where the shape comes from, in words.

    Returns
    -------
    FingerShape
        Six faces of the gel, "mirror", and dark bodies named as their blocks.

    Raises
    ------
    SimulateError
        When blocks, faces or displacements are missing, or when the deformed gel is open.
    """
    displaced = _displaced(nodes_mm, displacement_mm)
    faces = {**_gel_quads(design, nodes_mm, hexahedra), **_rigid_quads(design, nodes_mm, hexahedra)}
    surfaces = {}
    for name, quads in faces.items():
        used, triangles = np.unique(split_quads(quads, nodes_mm), return_inverse=True)
        uv = _reference_uv(design, name, nodes_mm[used])
        surfaces[name] = Surface(displaced[used], triangles.reshape(-1, 3).astype(np.int64), uv)
    if contact_distance is None:
        contact_distance = np.full(len(surfaces["coat"].vertices_mm), np.nan)
    return FingerShape(surfaces, contact_distance, label)


def coat_nodes(
    design: FingerDesign, nodes_mm: NDArray[np.float64], hexahedra: Mapping[str, NDArray[np.int64]]
) -> NDArray[np.int64]:
    """Return the node number of each vertex of the surface "coat" of :func:`shape_from_mesh`, ascending."""
    return np.unique(_gel_quads(design, nodes_mm, hexahedra)["coat"])


def _displaced(nodes_mm: NDArray[np.float64], displacement_mm: NDArray[np.float64] | None) -> NDArray[np.float64]:
    """Return where the nodes are."""
    if displacement_mm is None:
        return nodes_mm
    if displacement_mm.shape != nodes_mm.shape or not np.isfinite(displacement_mm).all():
        raise SimulateError(
            f"displacement_mm must be finite and of the same shape as the nodes, {nodes_mm.shape}, got shape "
            f"{displacement_mm.shape}"
        )
    return nodes_mm + displacement_mm


def _gel_quads(
    design: FingerDesign, nodes_mm: NDArray[np.float64], hexahedra: Mapping[str, NDArray[np.int64]]
) -> dict[str, NDArray[np.int64]]:
    """Return the boundary of the gel by face: what lies in a plane of the pad, and the coat as the rest."""
    pad = design.pad
    quads = boundary_quads(_block(hexahedra, "gel")).quads
    planes = {
        "inner": (1, 0.0),
        "red": (0, -pad.width_mm / 2.0),
        "green": (0, pad.width_mm / 2.0),
        "base": (2, 0.0),
        "tip": (2, pad.length_mm),
    }
    on = {
        name: (np.abs(nodes_mm[quads, axis] - place) < _ON_FACE_MM).all(axis=1)
        for name, (axis, place) in planes.items()
    }
    on["coat"] = ~np.logical_or.reduce(list(on.values()))
    missing = [name for name in GEL_FACES if not on[name].any()]
    if missing:
        raise SimulateError(
            "the mesh does not belong to this design, because its block gel has no face "
            f"{' and no face '.join(missing)}; the pad of the design, {pad.length_mm:g} x {pad.width_mm:g} mm, starts "
            "at y = 0 and z = 0"
        )
    return {name: quads[on[name]] for name in GEL_FACES}


def _rigid_quads(
    design: FingerDesign, nodes_mm: NDArray[np.float64], hexahedra: Mapping[str, NDArray[np.int64]]
) -> dict[str, NDArray[np.int64]]:
    """Return the mirror's face towards the pad, and the rest of the boundary of all conforming parts by owner."""
    names = ["mirror", *(name for name in DARK_BODIES if name in hexahedra)]
    parts = [_block(hexahedra, name) for name in names]
    boundary = boundary_quads(np.concatenate(parts))
    owner = np.searchsorted(np.cumsum([len(part) for part in parts]), boundary.owner, side="right")
    _, height = _on_mirror(mirror_shape(design), nodes_mm[boundary.quads])
    facing = (owner == 0) & (np.abs(height) < _ON_FACE_MM).all(axis=1)
    if not facing.any():
        raise SimulateError(
            "the mesh does not belong to this design, because no face of the block mirror lies on the mirror of the "
            "design; give the mesh of this design"
        )
    if len(names) == 1:
        return {"mirror": boundary.quads[facing]}
    # the edges of the mirror belong to the skeleton: they are as dark
    owner[(owner == 0) & ~facing] = 1
    dark = {name: boundary.quads[(owner == number) & ~facing] for number, name in enumerate(names) if number}
    return {"mirror": boundary.quads[facing], **dark}


def _block(hexahedra: Mapping[str, NDArray[np.int64]], name: str) -> NDArray[np.int64]:
    """Return a block."""
    if name not in hexahedra:
        raise SimulateError(f"the mesh has no block {name}; its blocks are {', '.join(hexahedra)}")
    return hexahedra[name]


def _on_mirror(mirror: MirrorShape, points_mm: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the place along the mirror and the height over it of points (..., 3)."""
    from_apex = points_mm[..., 1:] - mirror.apex_yz_mm
    along = from_apex @ mirror.tangent_yz
    return along, from_apex @ mirror.normal_yz + along**2 / (2.0 * mirror.radius_mm)


def _reference_uv(design: FingerDesign, name: str, points_mm: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the texture coordinates of undeformed points of a surface; zero on dark bodies, which need none."""
    if name == "mirror":
        mirror = mirror_shape(design)
        along, _ = _on_mirror(mirror, points_mm)
        from_middle = np.column_stack([points_mm[:, 0] / mirror.half_width_mm, along / mirror.half_length_mm])
        return np.asarray(np.clip((from_middle + 1.0) / 2.0, 0.0, 1.0))
    if name in DARK_BODIES:
        return np.zeros((len(points_mm), 2))
    x, y, z = points_mm.T
    across, along = x / design.pad.width_mm + 0.5, z / design.pad.length_mm
    up = y / rest_height_mm(design, x, z)
    uv = {"red": (up, along), "green": (up, along), "base": (across, up), "tip": (across, up)}
    return np.asarray(np.clip(np.column_stack(uv.get(name, (across, along))), 0.0, 1.0))
