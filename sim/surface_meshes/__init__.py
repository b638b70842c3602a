"""The surfaces of a finger, for light and for printing, and tests that they are closed and do not intersect.

A :class:`FingerShape` holds triangles with texture coordinates of the undeformed finger: six faces of the gel, whose
normals point outward and which close one volume, the mirror, and dark bodies. It comes from a design (`rest_shape`,
`pressed_shape`: the analytic press), from a mesh of hexahedra, deformed or not (`shape_from_mesh`), or from a record
(`restore_shapes`). `check_no_intersections` proves that no surface passes through another; `planar_solid` and
`stl_bytes` give the boundaries that CAD programs and slicers read. All in mm: x across the pad, y from its inner
face into the gel, z along it from the base.
"""

from typing import TYPE_CHECKING

from data_schemas import lazy_exports

if TYPE_CHECKING:
    from sim.surface_meshes._finger_shape import (
        GEL_FACES,
        FingerShape,
        MirrorShape,
        Surface,
        bent,
        check_analytic_press,
        check_closed,
        contact_distance,
        contact_half_width_mm,
        gel_faces,
        layout_scale,
        mirror_shape,
        pressed_height_mm,
        pressed_shape,
        rest_height_mm,
        rest_shape,
        restore_shapes,
        store_shapes,
        unpressed_design,
        vertex_normals,
    )
    from sim.surface_meshes._hexahedra import (
        HEXAHEDRON_FACES,
        boundary_quads,
        coat_nodes,
        corner_jacobians_mm3,
        shape_from_mesh,
        split_quads,
    )
    from sim.surface_meshes._imprint import everyday_objects, height_over_pad_mm, imprinted_height_mm, read_height_map
    from sim.surface_meshes._solid import (
        Coordinates,
        Edge,
        EllipseArc,
        Face,
        HollowCylinder,
        HollowEllipsoid,
        Loop,
        Plane,
        Solid,
        check_no_intersections,
        crossing_pair,
        planar_solid,
        stl_bytes,
    )
else:
    __getattr__ = lazy_exports(__name__, __file__)

__all__ = [
    "GEL_FACES",
    "HEXAHEDRON_FACES",
    "Coordinates",
    "Edge",
    "EllipseArc",
    "Face",
    "FingerShape",
    "HollowCylinder",
    "HollowEllipsoid",
    "Loop",
    "MirrorShape",
    "Plane",
    "Solid",
    "Surface",
    "bent",
    "boundary_quads",
    "check_analytic_press",
    "check_closed",
    "check_no_intersections",
    "coat_nodes",
    "contact_distance",
    "contact_half_width_mm",
    "corner_jacobians_mm3",
    "crossing_pair",
    "everyday_objects",
    "gel_faces",
    "height_over_pad_mm",
    "imprinted_height_mm",
    "layout_scale",
    "mirror_shape",
    "planar_solid",
    "pressed_height_mm",
    "pressed_shape",
    "read_height_map",
    "rest_height_mm",
    "rest_shape",
    "restore_shapes",
    "shape_from_mesh",
    "split_quads",
    "stl_bytes",
    "store_shapes",
    "unpressed_design",
    "vertex_normals",
]
