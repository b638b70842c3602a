"""Pressing a finger: parametric meshes, materials, contact and the solver.

A press is a sequence of equilibria. At each, the sum of the elastic energy of the hexahedra, of ties and of contact
is least under the supports: Pi(u) = sum_e W_e(u) + sum_t E_t(u), found by Newton's method with an energy line search.

`press_finger` pushes the indenter of a design to a depth, `press_to_force` to a force; both return a `PressedFinger`.
`press_along` moves it along a path of poses (press, slide, twist, roll, release) with friction that depends on where
the coat has stuck so far; `press_as_designed` presses to the depth or along the path of the design. `grasp_object`
closes two fingers on a free object. Contact is a penalty on exact distances (fast) or a barrier that never lets
surfaces cross, both with friction. `LoadedFinger` bends and twists a finger without an indenter, `compress_block`
presses a block of gel between plates. `press_derivatives` computes how the force changes with each number of the
design. Lengths in mm, forces in N, stresses in MPa. There is no light here: mechanics and optics meet in the studies.

The design decides: the shape of the pad and the constants of the materials are those of `FingerDesign` (`GelPad`,
`MechanicalMaterials`). A rigid indenter is described by its distance function and the derivatives of it, in
`_rigid_bodies.py`.
"""

from typing import TYPE_CHECKING

from data_schemas import lazy_exports

if TYPE_CHECKING:
    from sim.mechanics._condensed_finger import (
        Condensation,
        CondensedContact,
        CondensedFinger,
        condense_finger,
    )
    from sim.mechanics._derivatives import DesignChange, PressDerivatives, press_derivatives
    from sim.mechanics._elastic_layer import PressedLayer, layer_compliance, press_layer
    from sim.mechanics._finger_mesh import (
        FORCE_EXCESS_REL,
        LARGEST_UNTOLD_REL,
        STEPS,
        chord_shortfall_rel,
        finger_materials,
        finger_mesh,
        pad_mesh,
    )
    from sim.mechanics._grasp import (
        HALF_TURN,
        Grasp,
        GraspTask,
        contact_forces_n,
        facing_design,
        frictionless_torque_n_mm,
        grasp_object,
        slip_torque_n_mm,
    )
    from sim.mechanics._indenter_path import IndenterPath, moved_pose, press_along, press_as_designed, read_path
    from sim.mechanics._indenters import (
        IndenterShape,
        RigidIndenter,
        ShapeBody,
        check_indenter_shape,
        rigid_indenter,
        side_outline_mm,
    )
    from sim.mechanics._loads import CompressedBlock, GelBlock, LoadedFinger, Plates, compress_block, press_to_force
    from sim.mechanics._materials import (
        LinearElastic,
        Material,
        MaterialLaw,
        Ogden,
        PackagedMaterial,
        check_material_law,
    )
    from sim.mechanics._mesh import QUAD_CORNERS, Block, FingerMesh, face_points, quad_shapes
    from sim.mechanics._penalty_contact import (
        ContactMotion,
        PenaltyContact,
        SlidingContact,
        coat_points,
        penalty_mpa_per_mm,
    )
    from sim.mechanics._press import (
        ContactChoice,
        PressedFinger,
        PressSettings,
        check_no_path,
        chosen_contact,
        contact_distance,
        contact_pressure_mpa,
        press_finger,
        touch_areas_mm2,
    )
    from sim.mechanics._printed_parts import Part, mould_sizes, mould_solid, mould_stl, part_solid, part_stl
    from sim.mechanics._rigid_bodies import Body, Cylinder, Pose, RoundedBox, Sphere, body_mesh, read_triangles
    from sim.mechanics._skeleton import SkeletonLayout, back_curve_mm, skeleton_layout, skeleton_mesh
else:
    __getattr__ = lazy_exports(__name__, __file__)

__all__ = [
    "FORCE_EXCESS_REL",
    "HALF_TURN",
    "LARGEST_UNTOLD_REL",
    "QUAD_CORNERS",
    "STEPS",
    "Block",
    "Body",
    "CompressedBlock",
    "Condensation",
    "CondensedContact",
    "CondensedFinger",
    "ContactChoice",
    "ContactMotion",
    "Cylinder",
    "DesignChange",
    "FingerMesh",
    "GelBlock",
    "Grasp",
    "GraspTask",
    "IndenterPath",
    "IndenterShape",
    "LinearElastic",
    "LoadedFinger",
    "Material",
    "MaterialLaw",
    "Ogden",
    "PackagedMaterial",
    "Part",
    "PenaltyContact",
    "Plates",
    "Pose",
    "PressDerivatives",
    "PressSettings",
    "PressedFinger",
    "PressedLayer",
    "RigidIndenter",
    "RoundedBox",
    "ShapeBody",
    "SkeletonLayout",
    "SlidingContact",
    "Sphere",
    "back_curve_mm",
    "body_mesh",
    "check_indenter_shape",
    "check_material_law",
    "check_no_path",
    "chord_shortfall_rel",
    "chosen_contact",
    "coat_points",
    "compress_block",
    "condense_finger",
    "contact_distance",
    "contact_forces_n",
    "contact_pressure_mpa",
    "face_points",
    "facing_design",
    "finger_materials",
    "finger_mesh",
    "frictionless_torque_n_mm",
    "grasp_object",
    "layer_compliance",
    "mould_sizes",
    "mould_solid",
    "mould_stl",
    "moved_pose",
    "pad_mesh",
    "part_solid",
    "part_stl",
    "penalty_mpa_per_mm",
    "press_along",
    "press_as_designed",
    "press_derivatives",
    "press_finger",
    "press_layer",
    "press_to_force",
    "quad_shapes",
    "read_path",
    "read_triangles",
    "rigid_indenter",
    "side_outline_mm",
    "skeleton_layout",
    "skeleton_mesh",
    "slip_torque_n_mm",
    "touch_areas_mm2",
]
