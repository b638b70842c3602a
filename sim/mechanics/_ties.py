"""Ties: nodes of one part that move with the faces of another, by a stiff penalty."""

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from data_schemas import SimulateError
from sim.mechanics._mesh import Tie
from sim.mechanics._penalty_contact import node_blocks, quad_shapes

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
                f"node {slaves[worst]} at ({x:.3f}, {y:.3f}, {z:.3f}) mm cannot be tied: it lies {distance[worst]:.3g} "
                f"mm off the master faces, at most {_REACH * diagonal[worst]:.3g} mm are allowed; let the parts touch"
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
