"""Surfaces of a finger that pass through each other: what no contact sees, and what makes a result untrue.

Ribs fold onto ribs and fins, and the pad's film onto the skeleton, without a word from a penalty that knows the
indenter alone. Edges are tested against triangles, so that what crosses is found however thin it is.
"""

import numpy as np
from numpy.typing import NDArray

from sim.mechanics._mesh import FingerMesh
from sim.surface_meshes import boundary_quads, crossing_pair, split_quads

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


def outer_triangles(mesh: FingerMesh) -> IntArray:
    """Return the triangles (k, 3) of everything that can be touched: the boundary of all blocks that share nodes."""
    return split_quads(boundary_quads(np.concatenate(list(mesh.hexahedra.values()))).quads, mesh.nodes_mm)


class OwnSurfaces:
    """The outer surfaces of a finger, but for faces at a tie, which lie in each other.

    Parameters
    ----------
    mesh
        Finger at rest.
    """

    def __init__(self, mesh: FingerMesh) -> None:
        self._mesh = mesh
        triangles = outer_triangles(mesh)
        tied = [nodes.ravel() for tie in mesh.ties for nodes in (tie.slave_nodes, tie.master_quads)]
        at_tie = np.isin(triangles, np.concatenate([np.empty(0, np.int64), *tied])).any(axis=1)
        self._triangles = np.ascontiguousarray(triangles[~at_tie])

    def crossing(self, displacement_mm: FloatArray) -> str:
        """Return in words where surfaces pass through each other at a displacement (n, 3) of the nodes, or nothing."""
        rest = self._mesh.nodes_mm
        found = crossing_pair(np.ascontiguousarray(rest + displacement_mm), self._triangles)
        if found is None:
            return ""
        edge, triangle = found
        x, y, z = rest[triangle].mean(axis=0)
        return (
            f"the finger passes through itself: its {self._part(edge[0])} through its {self._part(triangle[0])}, near "
            f"({x:.1f}, {y:.1f}, {z:.1f}) mm of the undeformed finger"
        )

    def _part(self, node: int) -> str:
        """Return the name of a part that a node is of."""
        return next(b.name.replace("_", " ") for b in self._mesh.blocks if (b.hexahedra == node).any())
