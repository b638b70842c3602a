"""The press of an indenter by barriers: friction, any indenter, and contact of the finger's parts."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from data_schemas.design import FingerDesign
from data_schemas.press_mechanics import ContactKind
from sim.mechanics.assembly import State
from sim.mechanics.body_meshes import TriangleMesh
from sim.mechanics.colliding_surfaces import Obstacle
from sim.mechanics.contact_ipc import Barrier, BarrierContact
from sim.mechanics.driven_contact import DrivenContact
from sim.mechanics.indenters import RigidIndenter
from sim.mechanics.mesh import FingerMesh
from sim.mechanics.newton import Supports
from sim.surface_meshes.hexahedra import boundary_quads, split_quads

FloatArray = NDArray[np.float64]

# facets of the indenter that stay this far from the finger's box throughout the push are left out
_OUT_OF_REACH_MM = 3.0


class BarrierPress(DrivenContact):
    """All surfaces of the finger among themselves and against the indenter's triangles.

    The push counts from where the gap to first touch is the barrier's reach. Surfaces rest at a gap a little below
    that, so that the coat goes down by the push, as it does under an indenter that may touch.

    Parameters
    ----------
    design, mesh
        Finger.
    indenter
        At first touch.
    barrier
        How the barrier acts.
    threads
        Of the barrier.
    """

    kind: ContactKind = "barrier"

    def __init__(
        self, design: FingerDesign, mesh: FingerMesh, indenter: RigidIndenter, barrier: Barrier, threads: int
    ) -> None:
        reference = len(mesh.nodes_mm)
        place = np.array([indenter.touching.position_mm])
        self.mesh = replace(mesh, nodes_mm=np.concatenate([mesh.nodes_mm, place]))
        start = indenter.vertices_mm(barrier.reach_mm)
        near = _within_reach(start, indenter.surface, mesh.nodes_mm, design.indenter.depth_mm)
        obstacle = Obstacle(near.vertices_mm, near.triangles, reference)
        contact = BarrierContact(self.mesh.nodes_mm, outer_triangles(mesh), obstacle, barrier, threads=threads)
        super().__init__(contact, Supports.at_rest(reference + 1, mesh.node_sets["fixed"]), reference)
        self._settled_mm = np.zeros_like(self.mesh.nodes_mm)

    @property
    def note(self) -> str:
        """How the surfaces touch, and how near they are at the last equilibrium."""
        u, reach = self._settled_mm, self.contact.barrier.reach_mm
        own = self.contact.pairs_of_parts(u)
        parts = f"touch each other at {own} pairs" if own else "do not touch each other"
        return (
            f"contact by a barrier: surfaces keep a gap below {reach:g} mm, from which the push counts (least gap: "
            f"{self.contact.gap_mm(u):.3g} mm); friction {self.contact.barrier.friction_ratio:g} between indenter and "
            f"finger, none elsewhere; the ribs and other parts of the finger {parts}"
        )

    def accept(self, state: State) -> None:
        """Let the next increment begin at a state."""
        super().accept(state)
        self._settled_mm = state.u_mm

    def force_n(self, u: FloatArray) -> FloatArray:
        """Return the force on the indenter (3,)."""
        return self.contact.force_n(u)

    def energy_n_mm(self, u: FloatArray) -> float:
        """Return the energy of the barrier alone, without friction and the drive of the indenter."""
        return self.contact.barrier_energy(u)

    def friction_work_n_mm(self, u: FloatArray) -> float:
        """Return the work lost to friction in the increment that ended at `u`."""
        return self.contact.friction_work_n_mm(u)

    def pressures_mpa(self, u: FloatArray) -> FloatArray:
        """Return the pressure at the corners of the faces of the coat, (f, 4)."""
        return self.contact.pressures_mpa(u, self.mesh.surfaces["coat"])

    def touch_mm(self) -> FloatArray:
        """Return where these lie in the undeformed pad, (f, 4, 3)."""
        return np.asarray(self.mesh.nodes_mm[self.mesh.surfaces["coat"]])


def outer_triangles(mesh: FingerMesh) -> NDArray[np.int64]:
    """Return the triangles (k, 3) of everything that can be touched: the boundary of all blocks that share nodes."""
    return split_quads(boundary_quads(np.concatenate(list(mesh.hexahedra.values()))).quads, mesh.nodes_mm)


def _within_reach(vertices: FloatArray, surface: TriangleMesh, nodes_mm: FloatArray, depth_mm: float) -> TriangleMesh:
    """Return the facets that can come near the finger, whose parts move by up to the push."""
    corners = vertices[surface.triangles]
    low, high = corners.min(axis=1), corners.max(axis=1)
    margin = depth_mm + _OUT_OF_REACH_MM
    near = ((low <= nodes_mm.max(axis=0) + margin) & (high >= nodes_mm.min(axis=0) - margin)).all(axis=1)
    used, numbers = np.unique(surface.triangles[near], return_inverse=True)
    return TriangleMesh(vertices[used], numbers.reshape(-1, 3))
