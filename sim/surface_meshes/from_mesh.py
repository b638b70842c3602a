"""A finger's mesh of hexahedra, deformed or not, as the surfaces that light meets."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from data_schemas.design import FingerDesign
from data_schemas.errors import SimulateError
from sim.surface_meshes.back_mirror import MirrorShape, mirror_shape
from sim.surface_meshes.finger_shape import GEL_FACES, FingerShape
from sim.surface_meshes.hexahedra import boundary_quads, split_quads
from sim.surface_meshes.pressed_pad import rest_height_mm
from sim.surface_meshes.surface import Surface

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
            f"displacement_mm must be finite, of shape {nodes_mm.shape} as the nodes, got {displacement_mm.shape}"
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
            f"the block gel of the mesh has no face {' and no face '.join(missing)}; the mesh is not that of this "
            f"design, whose pad of {pad.length_mm:g} x {pad.width_mm:g} mm starts at y = 0 and z = 0"
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
        raise SimulateError("no face of the block mirror lies on the mirror of this design; mesh and design must agree")
    if len(names) == 1:
        return {"mirror": boundary.quads[facing]}
    # the edges of the mirror belong to the skeleton: they are as dark
    owner[(owner == 0) & ~facing] = 1
    dark = {name: boundary.quads[(owner == number) & ~facing] for number, name in enumerate(names) if number}
    return {"mirror": boundary.quads[facing], **dark}


def _block(hexahedra: Mapping[str, NDArray[np.int64]], name: str) -> NDArray[np.int64]:
    """Return a block."""
    if name not in hexahedra:
        raise SimulateError(f"the mesh has no block {name}; it has {', '.join(hexahedra)}")
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
