"""The whole finger as a mesh, by preset."""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from data_schemas.design import FingerDesign
from data_schemas.mechanical_design import Preset
from sim.mechanics.corner_grading import CornerGrading
from sim.mechanics.mesh import FingerMesh, Tie
from sim.mechanics.pad_mesh import pad_mesh
from sim.mechanics.skeleton_mesh import skeleton_mesh


@dataclass(frozen=True, slots=True)
class MeshSteps:
    """Fineness of a finger.

    Attributes
    ----------
    pad_mm, pad_layer_mm
        Largest edges along and across the pad, and through it.
    skeleton_mm, across_mm
        Largest edges elsewhere: in the side view, and across.
    corners
        How elements shrink towards the inner corners of ribs and fins; None: even ones.
    """

    pad_mm: float
    pad_layer_mm: float
    skeleton_mm: float
    across_mm: float
    corners: CornerGrading | None = None


# Through the fine pad two thirds of a mm in place of the paper's 0.4 mm: 600 000 unknowns, which is what 8 GB hold.
STEPS: Final[dict[Preset, MeshSteps]] = {
    "coarse": MeshSteps(2.0, 2.0, 2.5, 5.0, CornerGrading(0.15, 8.0)),
    "medium": MeshSteps(1.0, 1.0, 1.5, 2.5, CornerGrading(0.1, 4.0)),
    "fine": MeshSteps(0.4, 0.67, 1.2, 2.5, CornerGrading(0.15, 3.0)),
}

FORCE_EXCESS_REL: Final[dict[Preset, float]] = {"coarse": 0.10, "medium": 0.06, "fine": 0.05}
"""By how much a preset's force exceeds that of an infinitely fine mesh, for the 70 x 35 finger.

Of the skeleton by its stiffness under the pad at a small force, extrapolated (7.8, 4.8 and 4.1 %), and of the pad by
presses of 2 mm (1.3, 0.1 and 0 %): ``benchmarks/finger_mesh_convergence.py``. One per cent more for the base plate,
whose rows that study leaves as they are.
"""


def finger_mesh(design: FingerDesign, preset: Preset | None = None, steps: MeshSteps | None = None) -> FingerMesh:
    """Mesh a finger; the flange around its pad is tied to the front fin, everything else conforms.

    Parameters
    ----------
    design
        Finger; its mesh preset holds when none is given.
    preset
        Fineness.
    steps
        Sizes in place of a preset, for studies of convergence.

    Returns
    -------
    FingerMesh
        Blocks "gel", "film" (or "bond" of the gel's material), "skeleton", "base_plate", "backing" (if any) and
        "mirror"; their materials are fields of ``design.mechanics``. Node sets "coat", "flange", "fixed" and
        "tip_end"; surfaces "coat", "inner", "red", "green", "base", "tip" (of the gel), "mirror" and
        "front". Nodes of the pad come first.

    Raises
    ------
    SimulateError
        When the parts do not fit together.
    """
    sizes = steps or STEPS[preset or design.mesh.preset]
    pad = pad_mesh(design, sizes.pad_mm, sizes.pad_layer_mm)
    return joined(pad, skeleton_mesh(design, sizes.skeleton_mm, sizes.across_mm, sizes.corners))


def joined(pad: FingerMesh, skeleton: FingerMesh) -> FingerMesh:
    """Put pad and skeleton into one mesh and tie the flange of the pad to the front fin."""
    shift = len(pad.nodes_mm)
    surfaces = {**pad.surfaces, **{name: quads + shift for name, quads in skeleton.surfaces.items()}}
    return FingerMesh(
        nodes_mm=np.concatenate([pad.nodes_mm, skeleton.nodes_mm]),
        blocks=pad.blocks + tuple(replace(b, hexahedra=b.hexahedra + shift) for b in skeleton.blocks),
        node_sets={**pad.node_sets, **{name: nodes + shift for name, nodes in skeleton.node_sets.items()}},
        surfaces=surfaces,
        ties=(Tie(pad.node_sets["flange"], surfaces["front"]),),
    )
