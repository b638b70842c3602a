"""Frictionless contact with a rigid body by a penalty on its signed distance: the fast path, of the coat alone."""

import math

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from data_schemas import ContactKind, FingerDesign, SimulateError
from sim.mechanics._assembly import State, Term
from sim.mechanics._indenters import RigidIndenter
from sim.mechanics._mesh import FingerMesh
from sim.mechanics._newton import Supports
from sim.mechanics._rigid_bodies import Body, Pose

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

_POINTS_PER_EDGE = 2  # Gauss points along each side of a face
QUAD_CORNERS = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])


def quad_shapes(local: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the bilinear shape functions at points (..., 2), shape (..., 4), and their gradients (..., 4, 2)."""
    x, y = 1.0 + QUAD_CORNERS[:, 0] * local[..., None, 0], 1.0 + QUAD_CORNERS[:, 1] * local[..., None, 1]
    return x * y / 4.0, np.stack([QUAD_CORNERS[:, 0] * y, QUAD_CORNERS[:, 1] * x], -1) / 4.0


class PenaltyContact:
    """A :class:`~sim.mechanics._assembly.Term`: Pi = eps/2 sum_q A_q min(g_q, 0)^2 over Gauss points of the faces.

    g is the signed distance of the deformed face's point and A its area at rest, so that contact is sampled inside
    the faces too: nodes alone would let the faces between them cut into a round body by h^2 / 8 R. The body sinks in
    by pressure / eps.

    Parameters
    ----------
    nodes_mm
        Nodes at rest (n, 3).
    quads
        Faces (k, 4) that may touch, outward.
    body, pose
        The rigid body.
    stiffness_mpa_per_mm
        eps; about 100 shear moduli per mm of element size sinks in by under 1 % of that size.
    reference_node
        Node whose displacement moves the body besides its pose; it must belong to no element. With it the body can
        be driven by supports or by a load.
    curvature
        False leaves eps g H out of the second derivative: at a jump of the body g is the whole step, and the term's
        negative stiffness sends points sideways; at equilibrium g is a micrometre and the term worth nothing.
    """

    def __init__(
        self,
        nodes_mm: FloatArray,
        quads: IntArray,
        body: Body,
        pose: Pose,
        stiffness_mpa_per_mm: float,
        reference_node: int | None = None,
        curvature: bool = True,
    ) -> None:
        if not 0.0 < stiffness_mpa_per_mm < math.inf:
            raise SimulateError(f"a contact's stiffness must be above 0 MPa/mm, got {stiffness_mpa_per_mm:g}")
        self.body, self.pose = body, pose
        self.quads = quads
        self._rest = nodes_mm
        self._eps = stiffness_mpa_per_mm
        self._curvature = curvature
        self._reference = reference_node
        at, weights = np.polynomial.legendre.leggauss(_POINTS_PER_EDGE)
        self._shapes, slopes = quad_shapes(np.stack(np.meshgrid(at, at), -1).reshape(-1, 2))
        tangents = np.einsum("kai,qaj->kqij", nodes_mm[quads], slopes)
        normal = np.cross(tangents[..., 0], tangents[..., 1])
        self._areas = np.linalg.norm(normal, axis=-1) * np.outer(weights, weights).ravel()

    def place(self, pose: Pose) -> None:
        """Put the body somewhere else."""
        self.pose = pose

    def _offset(self, u: FloatArray) -> FloatArray:
        return np.zeros(3) if self._reference is None else np.asarray(u[self._reference])

    def _touching(self, u: FloatArray) -> tuple[IntArray, IntArray, FloatArray]:
        """Return face, number and place relative to the pose of all points, of faces whose nodes are near enough."""
        corners = (self._rest + u)[self.quads] - self._offset(u)
        points = np.einsum("qa,kai->kqi", self._shapes, corners)
        face, number = np.divmod(np.arange(points.shape[0] * points.shape[1]), points.shape[1])
        return face, number, points.reshape(-1, 3)

    def gaps_mm(self, u: FloatArray) -> FloatArray:
        """Return the signed distance of each face's points, shape (k, q)."""
        distance, _, _ = self.pose.distances(self.body, self._touching(u)[2])
        return distance.reshape(self._areas.shape)

    def pressures_mpa(self, u: FloatArray) -> FloatArray:
        """Return the contact pressure (referred to the area at rest) at each face's points, shape (k, q)."""
        return self._eps * np.maximum(-self.gaps_mm(u), 0.0)

    def points_mm(self, u: FloatArray) -> FloatArray:
        """Return the places of each face's points, shape (k, q, 3)."""
        return np.asarray(np.einsum("qa,kai->kqi", self._shapes, (self._rest + u)[self.quads]))

    def force_n(self, u: FloatArray) -> FloatArray:
        """Return the force on the body (3,)."""
        distance, normal, _ = self.pose.distances(self.body, self._touching(u)[2])
        push = self._eps * self._areas.ravel() * np.maximum(-distance, 0.0)
        return np.asarray(-push @ normal)

    def energy(self, u: FloatArray) -> float:
        """Return Pi in N mm."""
        return float(0.5 * self._eps * (self._areas * np.minimum(self.gaps_mm(u), 0.0) ** 2).sum())

    def gradient(self, u: FloatArray) -> FloatArray:
        """Return dPi/du in N, shape (n, 3)."""
        face, number, points = self._touching(u)
        distance, normal, _ = self.pose.distances(self.body, points)
        pull = (self._eps * self._areas.ravel() * np.minimum(distance, 0.0))[:, None] * normal
        out = np.zeros_like(u)
        np.add.at(out, self.quads[face].ravel(), (self._shapes[number][:, :, None] * pull[:, None]).reshape(-1, 3))
        if self._reference is not None:
            out[self._reference] -= pull.sum(0)
        return out

    def hessian(self, u: FloatArray, project: bool) -> sp.coo_array | sp.csr_array:
        """Return eps A (n n + g H) at the touching points, with `project` without the second part."""
        face, number, points = self._touching(u)
        distance, normal, curvature = self.pose.distances(self.body, points)
        # with a reference node, all faces reserve their place beside it: it may come to touch any of them
        kept = (distance < 0.0) if self._reference is None else np.ones(len(face), dtype=bool)
        scale = self._eps * self._areas.ravel()[kept] * (distance[kept] < 0.0)
        blocks = normal[kept, :, None] * normal[kept, None, :]
        if self._curvature and not project:
            blocks = blocks + distance[kept, None, None] * curvature[kept]
        nodes, weights = self.quads[face[kept]], self._shapes[number[kept]]
        if self._reference is not None:
            nodes = np.column_stack([nodes, np.full(len(nodes), self._reference)])
            weights = np.column_stack([weights, np.full(len(nodes), -1.0)])
        return node_blocks(nodes, weights, scale[:, None, None] * blocks, len(u))

    def max_step(self, u: FloatArray, du: FloatArray) -> float:
        """Return 1: a penalty allows every step."""
        return 1.0


def node_blocks(nodes: IntArray, weights: FloatArray, blocks: FloatArray, count: int) -> sp.coo_array:
    """Return the matrix of sum_m (w_a w_b) B_m over nodes (m, k), weights (m, k) and blocks (m, 3, 3)."""
    size = 3 * nodes.shape[1]
    unknowns = (3 * nodes[:, :, None] + np.arange(3)).reshape(len(nodes), size)
    whole = np.einsum("ma,mb,mij->maibj", weights, weights, blocks)
    rows, cols = np.repeat(unknowns, size, axis=1).ravel(), np.tile(unknowns, (1, size)).ravel()
    return sp.coo_array((whole.ravel(), (rows, cols)), shape=(3 * count, 3 * count))


# contact sinks in by pressure / stiffness: at a tenth of the gel's modulus by a thousandth of an element
_CONTACT_MODULI_PER_STEP = 100.0


def penalty_mpa_per_mm(design: FingerDesign, step_mm: float) -> float:
    """Return the stiffness of a penalty on a coat with elements of this size."""
    return _CONTACT_MODULI_PER_STEP * (2.0 * design.mechanics.gel.c10_mpa) / step_mm


class PenaltyTouch:
    """What the penalty does at an equilibrium: a :class:`~sim.mechanics._press.Touch`.

    Parameters
    ----------
    mesh
        The finger's, with one more node where the indenter is one.
    contact
        Of its coat with the indenter.
    left_out
        What it leaves out though the design has it, in words.
    """

    kind: ContactKind = "penalty"

    def __init__(self, mesh: FingerMesh, contact: PenaltyContact, left_out: str = "") -> None:
        self.mesh = mesh
        self._contact = contact
        self._left_out = left_out

    @property
    def note(self) -> str:
        """How the surfaces touch."""
        how = "contact by penalty: frictionless; the indenter's distance is exact; contact between ribs is not computed"
        return f"{how}; {self._left_out}" if self._left_out else how

    def force_n(self, u: FloatArray) -> FloatArray:
        """Return the force on the indenter (3,)."""
        return self._contact.force_n(u)

    def energy_n_mm(self, u: FloatArray) -> float:
        """Return the energy of the contact."""
        return self._contact.energy(u)

    def friction_work_n_mm(self, u: FloatArray) -> float:
        """Return 0: there is no friction."""
        return 0.0

    def pressures_mpa(self, u: FloatArray) -> FloatArray:
        """Return the pressure at the q sampling points of the coat's f faces, (f, q)."""
        return self._contact.pressures_mpa(u)

    def touch_mm(self) -> FloatArray:
        """Return where these lie in the undeformed pad, (f, q, 3)."""
        return self._contact.points_mm(np.zeros_like(self.mesh.nodes_mm))


class PenaltyPress(PenaltyTouch):
    """The coat against an indenter that is placed at a depth.

    Parameters
    ----------
    mesh
        The finger.
    indenter
        At first touch.
    stiffness_mpa_per_mm
        See :func:`penalty_mpa_per_mm`.
    left_out
        What it leaves out though the design has it, in words.

    Raises
    ------
    SimulateError
        When the indenter is a mesh of the user.
    """

    settle = None  # nothing is lagged

    def __init__(
        self, mesh: FingerMesh, indenter: RigidIndenter, stiffness_mpa_per_mm: float, left_out: str = ""
    ) -> None:
        if indenter.body is None:
            raise SimulateError(
                "the penalty cannot compute distances to an indenter from an STL: use --contact barrier, or auto"
            )
        contact = PenaltyContact(
            mesh.nodes_mm,
            mesh.surfaces["coat"],
            indenter.body,
            indenter.touching,
            stiffness_mpa_per_mm,
            curvature=False,
        )
        super().__init__(mesh, contact, left_out)
        self._indenter = indenter
        self.terms: tuple[Term, ...] = (contact,)
        self._supports = Supports.at_rest(len(mesh.nodes_mm), mesh.node_sets["fixed"])

    def push(self, depth_mm: float) -> Supports:
        """Place the indenter at a depth and return the supports."""
        self._contact.place(self._indenter.pose(depth_mm))
        return self._supports

    def accept(self, state: State) -> None:
        """Do nothing: an increment leaves nothing behind."""
