"""The whole finger as the engine takes it: mesh by preset, materials of its parts and ties between them.

A tie lets nodes of one part move with the faces of another, by a stiff penalty. What a preset's fineness costs stands
here too: by how much its force is too high, and how much too low a penalty on few nodes makes that of a round indenter.
"""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from data_schemas import FingerDesign, Preset, SimulateError
from sim.mechanics._indenters import touch_radius_mm
from sim.mechanics._materials import Material, material_of
from sim.mechanics._mesh import (
    Block,
    CornerGrading,
    FingerMesh,
    Tie,
    divided,
    hexahedra_on_grid,
    quad_shapes,
    quads_of_layer,
)
from sim.mechanics._penalty_contact import node_blocks
from sim.mechanics._skeleton import BOND_MM, skeleton_mesh
from sim.surface_meshes import rest_height_mm

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

_CANDIDATES = 8  # faces with the nearest boxes that a node is projected on; a corner of a grid has four
_AT_ONCE = 256  # nodes whose distances from all boxes are held at once
_PROJECTION_STEPS = 8  # Gauss-Newton on a bilinear face converges in three or four
_REACH = 0.05  # a tied node may lie this share of a face's diagonal off the faces
_DIAGONAL = np.array([0, 2])


class TiedNodes:
    """A :class:`~sim.mechanics._assembly.Term`: Pi = k/2 sum_s |u_s - sum_a N_a u_a|^2.

    Parameters
    ----------
    nodes_mm
        Nodes at rest (n, 3).
    tie
        Slave nodes on master faces. The meshes need not match; let the finer side be the slave, and expect the strain
        beside the tie to be uneven by some per cent where they do not.
    stiffness_n_per_mm
        k of each node: two orders above the stiffness of the stiffer neighbour (E h) leaves a gap of 1 % of its strain
        times its size.

    Raises
    ------
    SimulateError
        When a slave node lies off the master faces.
    """

    def __init__(self, nodes_mm: FloatArray, tie: Tie, stiffness_n_per_mm: float) -> None:
        slaves, quads = tie.slave_nodes, tie.master_quads
        face, weights, distance = _project(nodes_mm, slaves, quads)
        diagonal = np.linalg.norm(np.diff(nodes_mm[quads[face]][:, _DIAGONAL], axis=1)[:, 0], axis=1)
        worst = int(np.argmax(distance / diagonal))
        if distance[worst] > _REACH * diagonal[worst]:
            x, y, z = nodes_mm[slaves[worst]]
            raise SimulateError(
                f"node {slaves[worst]} at ({x:.3f}, {y:.3f}, {z:.3f}) mm cannot be tied, because it lies "
                f"{distance[worst]:.3g} mm off the master faces and at most {_REACH * diagonal[worst]:.3g} mm are "
                "allowed; change the design so that the parts touch"
            )
        self._nodes = np.column_stack([slaves, quads[face]])
        self._weights = np.column_stack([np.ones(len(slaves)), -weights])
        self._k = stiffness_n_per_mm
        blocks = np.broadcast_to(self._k * np.eye(3), (len(slaves), 3, 3))
        self._hessian = node_blocks(self._nodes, self._weights, blocks, len(nodes_mm)).tocsr()

    def gaps_mm(self, u: FloatArray) -> FloatArray:
        """Return by how much each slave node has left its face, shape (s, 3)."""
        return np.asarray(np.einsum("sa,sai->si", self._weights, u[self._nodes]))

    def energy(self, u: FloatArray) -> float:
        """Return Pi in N mm."""
        return float(0.5 * self._k * (self.gaps_mm(u) ** 2).sum())

    def gradient(self, u: FloatArray) -> FloatArray:
        """Return dPi/du in N, shape (n, 3)."""
        out = np.zeros_like(u)
        pull = self._k * self._weights[:, :, None] * self.gaps_mm(u)[:, None]
        np.add.at(out, self._nodes.ravel(), pull.reshape(-1, 3))
        return out

    def hessian(self, u: FloatArray, project: bool) -> sp.coo_array | sp.csr_array:
        """Return the constant second derivative."""
        return self._hessian

    def max_step(self, u: FloatArray, du: FloatArray) -> float:
        """Return 1: ties allow every step."""
        return 1.0


def _project(nodes: FloatArray, slaves: IntArray, quads: IntArray) -> tuple[IntArray, FloatArray, FloatArray]:
    """Return for each slave node its nearest face, the weights of the face's corners (s, 4) and the distance."""
    points = nodes[slaves]
    near = _nearest_boxes(points, nodes[quads])
    corners = nodes[quads[near]]
    local = np.zeros((*near.shape, 2))
    for _ in range(_PROJECTION_STEPS):
        shapes, slopes = quad_shapes(local)
        off = points[:, None] - np.einsum("sca,scai->sci", shapes, corners)
        tangents = np.einsum("scaj,scai->scij", slopes, corners)
        normal = tangents.swapaxes(-1, -2) @ tangents
        step = np.linalg.solve(normal, tangents.swapaxes(-1, -2) @ off[..., None])[..., 0]
        local = np.clip(local + step, -1.0, 1.0)
    shapes, _ = quad_shapes(local)
    distance = np.linalg.norm(points[:, None] - np.einsum("sca,scai->sci", shapes, corners), axis=-1)
    row = np.arange(len(slaves))
    best = distance.argmin(axis=1)
    return near[row, best], shapes[row, best], distance[row, best]


def _nearest_boxes(points: FloatArray, corners: FloatArray) -> IntArray:
    """Return the faces (s, c) whose boxes are nearest to each point, of faces with corners (f, 4, 3).

    Centres would not do: of long and narrow faces the nearest centre may be that of another row.
    """
    low, high, count = corners.min(axis=1), corners.max(axis=1), min(_CANDIDATES, len(corners))
    near = [
        np.argpartition(
            (np.maximum(0.0, np.maximum(low - some[:, None], some[:, None] - high)) ** 2).sum(axis=2), count - 1
        )[:, :count]
        for some in np.array_split(points, max(1, len(points) // _AT_ONCE))
    ]
    return np.concatenate(near)


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


_FEWEST_LAYERS = 2


def pad_mesh(design: FingerDesign, step_mm: float, layer_mm: float) -> FingerMesh:
    """Mesh gel and film; the nodes of the coated face lie on the designed shape.

    Parameters
    ----------
    design
        Finger.
    step_mm
        Largest edge along and across the pad.
    layer_mm
        Largest thickness of an element at the crown.

    Returns
    -------
    FingerMesh
        Blocks "gel", and "film" or "bond" under it; surfaces "coat", "inner" (gel against film or bond), "red",
        "green", "base", "tip" of the gel; node sets "coat" and "flange" (what lies on the front fin).
    """
    pad, flange = design.pad, design.skeleton.flange_mm
    half, length = pad.width_mm / 2.0, pad.length_mm
    x = divided([-half - flange, -half, half, half + flange], step_mm)
    z = divided([-flange, 0.0, length, length + flange], step_mm)
    share = divided([0.0, 1.0], layer_mm / pad.thickness_mm, _FEWEST_LAYERS)
    height = rest_height_mm(design, np.clip(x, -half, half)[:, None], np.clip(z, 0.0, length)[None, :])
    sheet_mm = BOND_MM if pad.film is None else pad.film.thickness_mm
    y = np.concatenate([np.full_like(height[:, None], -sheet_mm), height[:, None] * share[:, None]], axis=1)
    over_x, over_z = np.flatnonzero(np.abs(x) <= half), np.flatnonzero((z >= 0.0) & (z <= length))
    used = np.zeros(tuple(n - 1 for n in y.shape), dtype=np.bool_)
    used[:, 0] = True
    used[over_x[0] : over_x[-1], 1:, over_z[0] : over_z[-1]] = True
    grid = hexahedra_on_grid(np.stack(np.broadcast_arrays(x[:, None, None], y, z), axis=-1), used)
    in_sheet = grid.cells[:, 1] == 0
    under = grid.hexahedra[in_sheet]
    blocks = (
        Block("gel", grid.hexahedra[~in_sheet], "gel", "mean_dilatation"),
        Block("bond", under, "gel", "mean_dilatation")
        if pad.film is None
        else Block("film", under, "film", "incompatible_modes"),
    )
    gel = grid.numbers[over_x[0] : over_x[-1] + 1, 1:, over_z[0] : over_z[-1] + 1]
    # (sheet of node numbers whose first index crossed with the second points outward)
    sheets = {
        "coat": gel[:, -1].T,
        "inner": gel[:, 0],
        "red": gel[0].T,
        "green": gel[-1],
        "base": gel[:, :, 0].T,
        "tip": gel[:, :, -1],
    }
    surfaces = {
        name: quads_of_layer(sheet, np.ones((sheet.shape[0] - 1, sheet.shape[1] - 1), dtype=np.bool_))
        for name, sheet in sheets.items()
    }
    on_fin = (np.abs(x) >= half)[:, None] | (z <= 0.0) | (z >= length)
    sets = {"coat": np.unique(gel[:, -1]), "flange": np.unique(grid.numbers[:, 0, :][on_fin])}
    return FingerMesh(grid.nodes_mm, blocks, sets, surfaces, ())


# per node, against the fin's E times element size: the tie opens by a hundredth of the fin's own strain
_TIE_MODULI_TIMES_STEP = 100.0


def finger_materials(design: FingerDesign) -> dict[str, Material]:
    """Return the engine's materials by the names that the mesh's blocks give.

    Raises
    ------
    SimulateError
        When a rubber's constants make it unstable, or the law of another package cannot be loaded.
    """
    parts = {name: getattr(design.mechanics, name) for name in type(design.mechanics).model_fields}
    return {name: material_of(solid, f"mechanics.{name}") for name, solid in parts.items()}


def finger_ties(design: FingerDesign, mesh: FingerMesh, step_mm: float) -> list[TiedNodes]:
    """Return the ties of the mesh."""
    fin = finger_materials(design)["skeleton"]
    stiffness = _TIE_MODULI_TIMES_STEP * fin.youngs_modulus_mpa * step_mm
    return [TiedNodes(mesh.nodes_mm, tie, stiffness) for tie in mesh.ties]


_SHORTFALL = 0.3
LARGEST_UNTOLD_REL: Final = 0.1
"""Shortfall from which the user is warned."""


def chord_shortfall_rel(design: FingerDesign, preset: Preset, depth_mm: float) -> float:
    """Return by how much, relative, a penalty's force falls short of the barrier's at a push, at most 1.

    0.3 h^2 / (8 R d): h the pad's element, R the radius, d the push. Between nodes the coat cuts into a round indenter
    by up to the chord's height h^2 / (8 R), which is lost from the push. The factor is that of ten presses of balls
    (2 to 8 mm) and a cylinder (10 mm) on the coarse 70 x 35 finger, h^2 / (8 R d) from 0.1 to 0.8, whose shortfalls of
    3 to 33 % it meets within 5 points, with the middle over an edge of the mesh. Over the middle of a face a third more
    is missing (43 % in place of 33 %), over a sampling point nothing (3 %). Cuboids touch with faces: 0. Of a body of
    another package, R is its least radius of curvature where it first touches.

    Parameters
    ----------
    design
        Finger with its indenter.
    preset
        Fineness of the mesh.
    depth_mm
        Push from first touch.
    """
    radius_mm = touch_radius_mm(design) if depth_mm > 0.0 else None
    if radius_mm is None:
        return 0.0
    chord_mm = STEPS[preset].pad_mm ** 2 / (8.0 * radius_mm)
    return float(min(1.0, _SHORTFALL * chord_mm / depth_mm))
