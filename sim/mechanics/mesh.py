"""A finite-element mesh of the finger: blocks of hexahedra, sets of nodes, surfaces and ties; mm."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from data_schemas.errors import SimulateError
from sim.surface_meshes.hexahedra import corner_jacobians_mm3

Element = Literal["mean_dilatation", "incompatible_modes"]


@dataclass(frozen=True, slots=True)
class Block:
    """Hexahedra of one part: (m, 8) node numbers in Abaqus' C3D8 order, material and element."""

    name: str
    hexahedra: NDArray[np.int64]
    material: str
    element: Element


@dataclass(frozen=True, slots=True)
class Tie:
    """Slave nodes (k,) that move with the master quadrilaterals (m, 4) they lie on."""

    slave_nodes: NDArray[np.int64]
    master_quads: NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class FingerMesh:
    """Nodes (n, 3) in mm, blocks, named sets of nodes, named surfaces (quads outward) and ties.

    Raises
    ------
    SimulateError
        When a block, set, surface or tie names a node that does not exist, or a hexahedron is folded at a corner.
    """

    nodes_mm: NDArray[np.float64]
    blocks: tuple[Block, ...]
    node_sets: Mapping[str, NDArray[np.int64]]
    surfaces: Mapping[str, NDArray[np.int64]]
    ties: tuple[Tie, ...]

    def __post_init__(self) -> None:
        count = len(self.nodes_mm)
        numbered = [(f"block {b.name}", b.hexahedra) for b in self.blocks]
        numbered += [(f"node set {name}", nodes) for name, nodes in self.node_sets.items()]
        numbered += [(f"surface {name}", quads) for name, quads in self.surfaces.items()]
        numbered += [("a tie", part) for tie in self.ties for part in (tie.slave_nodes, tie.master_quads)]
        for what, nodes in numbered:
            if not nodes.size or nodes.min() < 0 or nodes.max() >= count:
                raise SimulateError(f"{what} of the mesh must name some of the nodes 0 to {count - 1}, and only these")
        for block in self.blocks:
            check_unfolded(self.nodes_mm, block.hexahedra, block.name)

    @property
    def hexahedra(self) -> dict[str, NDArray[np.int64]]:
        """Hexahedra of each block by its name."""
        return {block.name: block.hexahedra for block in self.blocks}


def check_unfolded(nodes_mm: NDArray[np.float64], hexahedra: NDArray[np.int64], name: str) -> None:
    """Check that the Jacobian of every hexahedron is positive at all eight corners.

    Raises
    ------
    SimulateError
        When one is not; the message gives the block and the place.
    """
    jacobians = corner_jacobians_mm3(nodes_mm, hexahedra)
    worst = np.unravel_index(np.argmin(jacobians), jacobians.shape)
    if jacobians[worst] <= 0.0:
        x, y, z = nodes_mm[hexahedra[worst]]
        raise SimulateError(
            f"{int((jacobians.min(axis=1) <= 0.0).sum())} hexahedra of block {name} are folded, the worst at "
            f"({x:.2f}, {y:.2f}, {z:.2f}) mm; nodes must be in C3D8 order, and the parts must not pass through each "
            "other"
        )
