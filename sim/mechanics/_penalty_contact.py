"""Contact with a rigid body by a penalty on its signed distance: the fast path, of the coat alone.

Without friction, or with Coulomb friction that follows stick and slip, for a body that is pressed straight in or moves
freely.
"""

import math
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from data_schemas import ContactKind, FingerDesign, SimulateError
from sim.mechanics._assembly import State, Term
from sim.mechanics._increments import CURVED_REL, LAGGED_REL
from sim.mechanics._indenters import RigidIndenter
from sim.mechanics._materials import material_of
from sim.mechanics._mesh import FacePoints, FingerMesh, face_points, quad_shapes
from sim.mechanics._newton import Supports
from sim.mechanics._rigid_bodies import Body, Pose, least_radius_mm

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

NOT_OF_RIBS = "; contact between ribs is not computed"


def coat_points(nodes_mm: FloatArray, quads: IntArray, body: Body) -> FacePoints:
    """Return the points at which a coat's faces (k, 4) meet a body: 2 x 2, or 3 x 3 of one sharper than the faces.

    A sharp edge comes between the points: with 2 x 2 of them a node of the coat lay 0.17 mm in a cuboid.
    """
    return face_points(quads, 3 if least_radius_mm(body) < face_side_mm(nodes_mm, quads) else 2)


def face_side_mm(nodes_mm: FloatArray, quads: IntArray) -> float:
    """Return the median side of faces (k, 4)."""
    sides_mm = np.linalg.norm(nodes_mm[quads] - nodes_mm[np.roll(quads, -1, axis=1)], axis=2)
    return float(np.median(sides_mm))


@dataclass(frozen=True, slots=True)
class TouchedPoints:
    """The m points of a penalty contact that touch.

    Attributes
    ----------
    nodes, weights
        Of their faces, and the shape functions there, (m, 4).
    gap_mm, normals
        Signed distance (m,), below 0, and the body's outward normal (m, 3).
    stiffness_n_per_mm
        Penalty times the area at rest, (m,).
    """

    nodes: IntArray
    weights: FloatArray
    gap_mm: FloatArray
    normals: FloatArray
    stiffness_n_per_mm: FloatArray


class PenaltyContact:
    """A :class:`~sim.mechanics._assembly.Term`: Pi = eps/2 sum_q A_q min(g_q, 0)^2 over points of the faces.

    g is the signed distance of the deformed face's point and A its area at rest, so that contact is sampled inside
    the faces too: nodes alone would let the faces between them cut into a round body by h^2 / 8 R. The body sinks in
    by pressure / eps.

    Parameters
    ----------
    nodes_mm
        Nodes at rest (n, 3).
    faces
        Those (k, 4) that may touch, outward, and where: by default at 2 x 2 Gauss points of each.
    body, pose
        The rigid body.
    stiffness_mpa_per_mm
        eps; about 100 shear moduli per mm of element size sinks in by under 1 % of that size.
    reference_node
        Node whose displacement moves the body besides its pose; it must belong to no element. With it the body can
        be driven by supports or by a load.
    curvature
        False leaves eps g H out of the second derivative until :meth:`approach`: at a jump of the body g is the whole
        step, and the term's negative stiffness sends points sideways. Near an equilibrium at a sharp edge, Newton's
        method without it only halves the residual in each step.
    """

    def __init__(
        self,
        nodes_mm: FloatArray,
        faces: IntArray | FacePoints,
        body: Body,
        pose: Pose,
        stiffness_mpa_per_mm: float,
        reference_node: int | None = None,
        curvature: bool = True,
    ) -> None:
        if not 0.0 < stiffness_mpa_per_mm < math.inf:
            raise SimulateError(f"a contact's stiffness must be above 0 MPa/mm, got {stiffness_mpa_per_mm:g}")
        self.body, self.pose = body, pose
        self._rest = nodes_mm
        self._eps = stiffness_mpa_per_mm
        self.curvature, self._is_near = curvature, False
        self._reference = reference_node
        self._held: NDArray[np.bool_] | None = None
        points = faces if isinstance(faces, FacePoints) else face_points(faces, to_border=False)
        self.quads = quads = points.quads
        self._shapes, slopes = quad_shapes(points.places)
        tangents = np.einsum("kai,kqaj->kqij", nodes_mm[quads], slopes)
        normal = np.cross(tangents[..., 0], tangents[..., 1])
        self._areas = np.linalg.norm(normal, axis=-1) * 4.0 * points.shares

    def place(self, pose: Pose) -> None:
        """Put the body somewhere else."""
        self.pose, self._held, self._is_near = pose, None, False

    def approach(self) -> None:
        """Take the whole second derivative until the body is placed again: an equilibrium is near."""
        self._is_near = True

    def hold(self, u: FloatArray, pose: Pose) -> bool:
        """Put the body elsewhere with the points that touch now, which act alone and cannot part until it is placed.

        Returns whether there are any. Only the first and the second derivative know of this.
        """
        self._held, self.pose = (self.gaps_mm(u) < 0.0).ravel(), pose
        return bool(self._held.any())

    def _acting(self, distance: FloatArray) -> NDArray[np.bool_]:
        """Return which points push or, where they are held, pull."""
        return distance < 0.0 if self._held is None else self._held

    def _offset(self, u: FloatArray) -> FloatArray:
        return np.zeros(3) if self._reference is None else np.asarray(u[self._reference])

    def _touching(self, u: FloatArray) -> tuple[IntArray, IntArray, FloatArray]:
        """Return face, number and place relative to the pose of all points, of faces whose nodes are near enough."""
        corners = (self._rest + u)[self.quads] - self._offset(u)
        points = np.einsum("kqa,kai->kqi", self._shapes, corners)
        face, number = np.divmod(np.arange(points.shape[0] * points.shape[1]), points.shape[1])
        return face, number, points.reshape(-1, 3)

    def gaps_mm(self, u: FloatArray) -> FloatArray:
        """Return the signed distance of each face's points, shape (k, q)."""
        distance, _, _ = self.pose.distances(self.body, self._touching(u)[2])
        return distance.reshape(self._areas.shape)

    def touched(self, u: FloatArray) -> "TouchedPoints":
        """Return the points that touch."""
        face, number, points = self._touching(u)
        distance, normal, _ = self.pose.distances(self.body, points)
        kept = np.flatnonzero(distance < 0.0)
        return TouchedPoints(
            self.quads[face[kept]],
            self._shapes[face[kept], number[kept]],
            distance[kept],
            normal[kept],
            self._eps * self._areas.ravel()[kept],
        )

    def pressures_mpa(self, u: FloatArray) -> FloatArray:
        """Return the contact pressure (referred to the area at rest) at each face's points, shape (k, q)."""
        return self._eps * np.maximum(-self.gaps_mm(u), 0.0)

    def sunk_mm(self, u: FloatArray) -> float:
        """Return how deep the deepest corner of the faces lies in the body; below 0 where none does."""
        nodes = np.unique(self.quads)
        distance, _, _ = self.pose.distances(self.body, (self._rest + u)[nodes] - self._offset(u))
        return -float(distance.min())

    def points_mm(self, u: FloatArray) -> FloatArray:
        """Return the places of each face's points, shape (k, q, 3)."""
        return np.asarray(np.einsum("kqa,kai->kqi", self._shapes, (self._rest + u)[self.quads]))

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
        pull = (self._eps * self._areas.ravel() * np.where(self._acting(distance), distance, 0.0))[:, None] * normal
        out = np.zeros_like(u)
        np.add.at(
            out, self.quads[face].ravel(), (self._shapes[face, number][:, :, None] * pull[:, None]).reshape(-1, 3)
        )
        if self._reference is not None:
            out[self._reference] -= pull.sum(0)
        return out

    def hessian(self, u: FloatArray, project: bool) -> sp.coo_array | sp.csr_array:
        """Return eps A (n n + g H) at the touching points, with `project` without the second part."""
        face, number, points = self._touching(u)
        distance, normal, curvature = self.pose.distances(self.body, points)
        # with a reference node, all faces reserve their place beside it: it may come to touch any of them
        acting = self._acting(distance)
        kept = acting if self._reference is None else np.ones(len(face), dtype=bool)
        scale = self._eps * self._areas.ravel()[kept] * acting[kept]
        blocks = normal[kept, :, None] * normal[kept, None, :]
        if (self.curvature or self._is_near) and not project:
            blocks = blocks + distance[kept, None, None] * curvature[kept]
        nodes, weights = self.quads[face[kept]], self._shapes[face[kept], number[kept]]
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
    return _CONTACT_MODULI_PER_STEP * material_of(design.mechanics.gel, "mechanics.gel").shear_modulus_mpa / step_mm


MOST_SUNK_SHARE = 0.1
"""Of a face's side, what a node of the coat may lie in the indenter; the penalty itself sinks in by 0.1 of it where the
pressure is 10 shear moduli."""


class PenaltyTouch:
    """What the penalty does at an equilibrium: a :class:`~sim.mechanics._press.Touch`.

    Parameters
    ----------
    mesh
        The finger's, with one more node where the indenter is one.
    contact
        Of its coat with the indenter.
    """

    kind: ContactKind = "penalty"

    def __init__(self, mesh: FingerMesh, contact: PenaltyContact) -> None:
        self.mesh = mesh
        self._contact = contact
        self.is_sharp = 0.0 < least_radius_mm(contact.body) < face_side_mm(mesh.nodes_mm, contact.quads)
        self.settle_rel = CURVED_REL if self.is_sharp else LAGGED_REL

    @property
    def note(self) -> str:
        """How the surfaces touch."""
        return f"penalty contact: frictionless; the indenter's distance is exact{NOT_OF_RIBS}"

    def caveat(self, u: FloatArray) -> str:
        """Return in words that the indenter lies in the coat between the points where contact acts, or nothing."""
        sunk, side = self._contact.sunk_mm(u), face_side_mm(self.mesh.nodes_mm, self.mesh.surfaces["coat"])
        if sunk <= MOST_SUNK_SHARE * side:
            return ""
        return (
            f"; a node of the coat lies {sunk:.2f} mm inside the indenter (at most {MOST_SUNK_SHARE * side:.2f} mm is "
            f"allowed), because the indenter's edges are too sharp for elements of {side:.1f} mm. Press on a finer mesh"
        )

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
    """

    def __init__(self, mesh: FingerMesh, indenter: RigidIndenter, stiffness_mpa_per_mm: float) -> None:
        body, pose = indenter.exact_body(), indenter.touching
        points = coat_points(mesh.nodes_mm, mesh.surfaces["coat"], body)
        contact = PenaltyContact(mesh.nodes_mm, points, body, pose, stiffness_mpa_per_mm, curvature=False)
        super().__init__(mesh, contact)
        self._indenter = indenter
        self.terms: tuple[Term, ...] = (contact,)
        self._supports = Supports.at_rest(len(mesh.nodes_mm), mesh.node_sets["fixed"])
        self.settle = self._settle if self.is_sharp else None  # rounder bodies lag nothing that matters

    def push(self, depth_mm: float) -> Supports:
        """Place the indenter at a depth and return the supports."""
        self._contact.place(self._indenter.pose(depth_mm))
        return self._supports

    def hold(self, state: State, touching_mm: float, depth_mm: float) -> bool:
        """Place the indenter with what touches at another depth alone, see :class:`~sim.mechanics._increments.Load`."""
        self.push(touching_mm)
        return self._contact.hold(state.u_mm, self._indenter.pose(depth_mm))

    def _settle(self, state: State) -> bool:
        """Take the contact's whole second derivative, and return that this is an equilibrium."""
        self._contact.approach()
        return True

    def accept(self, state: State) -> None:
        """Do nothing: an increment leaves nothing behind."""


_SETTLED_REL = 1e-3  # of the normal forces: by how much friction may still change when its limits are renewed
# of the penalty's stiffness: stick gives way by 0.05 of an element where the shear is a whole modulus, 0.005 where it
# is a tenth; Newton's method meets fewer kinks the softer it is
_STICK_SHARE = 0.2
_LEAST_MM = 1e-300  # keeps a stretch of nothing from dividing by nothing


@dataclass(frozen=True, slots=True)
class _Memory:
    """What is kept of the last increment at the m points of the faces, in the body's axes."""

    anchors_mm: FloatArray  # (m, 3), where they hold on to the body; NaN where they do not touch
    places_mm: FloatArray  # (m, 3)
    gaps_mm: FloatArray  # (m,)
    normals: FloatArray  # (m, 3)


@dataclass(frozen=True, slots=True)
class _Lag:
    """What friction takes as given while an equilibrium is sought, of the m points, in space."""

    anchors_mm: FloatArray  # (m, 3), of any value where the limit is zero
    limits_mpa: FloatArray  # (m,), mu p
    normals: FloatArray  # (m, 3)


class SlidingContact(PenaltyContact):
    r"""A penalty contact with Coulomb's friction between the faces' points and the body.

    .. math:: \Pi = \frac\epsilon2 \sum_q A_q \min(g_q, 0)^2 + \sum_q A_q \phi(|t_q|), \qquad
        \phi(t) = \begin{cases} k t^2 / 2 & k t \le \mu p \\ \mu p\, t - (\mu p)^2 / 2 k
        & \text{else} \end{cases}, \quad k = \epsilon / 5

    t is the part across the normal of the way from a point's anchor, a place of the body, to the point. A point that
    sticks keeps its anchor, and its shear is k t; one that slips takes its anchor along (return mapping), and its
    shear is mu p. The pressure p and the normal are those of the last equilibrium, renewed until friction changes by
    less than a thousandth of the normal forces: the energy is convex in t, and its second derivative symmetric. A
    point that comes to touch is anchored where it met the body, on the straight way from its last place.

    Valid for any rigid motion in increments short beside the patch: slip is straight within an increment, and friction
    acts along its end. Stick gives way by shear / k, as the body sinks in by pressure / epsilon.

    Parameters
    ----------
    nodes_mm, faces, body, pose, stiffness_mpa_per_mm
        See :class:`~sim.mechanics.PenaltyContact`.
    friction_ratio
        Coulomb's coefficient mu.

    Raises
    ------
    SimulateError
        When the coefficient is negative.
    """

    def __init__(
        self,
        nodes_mm: FloatArray,
        faces: IntArray | FacePoints,
        body: Body,
        pose: Pose,
        stiffness_mpa_per_mm: float,
        friction_ratio: float,
    ) -> None:
        super().__init__(nodes_mm, faces, body, pose, stiffness_mpa_per_mm, curvature=False)
        if not 0.0 <= friction_ratio < np.inf:
            raise SimulateError(f"friction must be a finite coefficient of 0 or more (Coulomb), got {friction_ratio:g}")
        self.friction_ratio = friction_ratio
        self._stick = _STICK_SHARE * stiffness_mpa_per_mm
        places, gaps, normals = self._in_body(np.zeros_like(nodes_mm))
        anchors = np.where((gaps < 0.0)[:, None], places, np.nan)
        self._begin = self._end = _Memory(anchors, places, gaps, normals)
        self._anchors = anchors.copy()
        self._lag = self._lagged(gaps, normals)

    def _in_body(self, u: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return places (m, 3), gaps (m,) and normals (m, 3) of the points in the body's axes."""
        rotation = self.pose.rotation
        places = (self._points(u) - np.array(self.pose.position_mm)) @ rotation
        gaps, normals, _ = self.body.distances(places)
        return places, gaps, normals

    def _points(self, u: FloatArray) -> FloatArray:
        return self._touching(u)[2]

    def _lagged(self, gaps: FloatArray, normals: FloatArray) -> _Lag:
        """Return the limits of friction by these gaps, at the body's present pose."""
        anchored = np.isfinite(self._anchors[:, 0])
        limits = np.where(anchored, self.friction_ratio * self._eps * np.maximum(-gaps, 0.0), 0.0)
        held = np.where(anchored[:, None], self._anchors, 0.0)
        in_space = held @ self.pose.rotation.T + np.array(self.pose.position_mm)
        return _Lag(in_space, limits, normals @ self.pose.rotation.T)

    def restart(self, pose: Pose) -> None:
        """Put the body at a pose for an increment that begins, or begins again, where the last one ended."""
        self.place(pose)
        self._begin = self._end
        self._anchors = self._begin.anchors_mm.copy()
        self._lag = self._lagged(self._begin.gaps_mm, self._begin.normals)

    def follow(self, pose: Pose) -> None:
        """Move the body a little, with the places that points hold on to; the limits of friction stay as they are."""
        to_body, before = self.pose.rotation, np.array(self.pose.position_mm)
        held, normals = (self._lag.anchors_mm - before) @ to_body, self._lag.normals @ to_body
        self.place(pose)
        in_space = held @ pose.rotation.T + np.array(pose.position_mm)
        self._lag = _Lag(in_space, self._lag.limits_mpa, normals @ pose.rotation.T)

    def settle(self, u: FloatArray) -> bool:
        """Renew the limits of friction at an equilibrium; return whether friction stayed as it was."""
        if self.friction_ratio == 0.0:
            return True
        before = self._friction_n(u)
        places, gaps, normals = self._in_body(u)
        self._anchor(places, gaps)
        self._lag = self._lagged(gaps, normals)
        change = np.linalg.norm(self._friction_n(u) - before)
        pushes = self._eps * self._areas.ravel() * np.maximum(-gaps, 0.0)
        return bool(change <= _SETTLED_REL * np.linalg.norm(pushes))

    def _anchor(self, places: FloatArray, gaps: FloatArray) -> None:
        """Anchor the points that have come to touch in this increment where they met the body."""
        begin = self._begin
        fresh = ~np.isfinite(begin.anchors_mm[:, 0])
        self._anchors[fresh & (gaps >= 0.0)] = np.nan
        new = fresh & (gaps < 0.0) & ~np.isfinite(self._anchors[:, 0])
        way = np.maximum(begin.gaps_mm[new], 0.0)
        share = (way / (way - gaps[new]))[:, None]
        self._anchors[new] = (1.0 - share) * begin.places_mm[new] + share * places[new]

    def accept(self, u: FloatArray) -> None:
        """Remember an increment's end for the next one; what this one gives stays until :meth:`restart`."""
        places, gaps, normals = self._in_body(u)
        stretch, length = self._stretch(u)
        kept = np.minimum(1.0, self._lag.limits_mpa / (self._stick * length))[:, None] * stretch
        anchors = np.where((gaps < 0.0)[:, None], places - kept @ self.pose.rotation, np.nan)
        self._end = _Memory(anchors, places, gaps, normals)

    def _stretch(self, u: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return t of the points (m, 3) and its length (m,), zero where nothing holds."""
        way = np.where((self._lag.limits_mpa > 0.0)[:, None], self._points(u) - self._lag.anchors_mm, 0.0)
        along = np.einsum("mi,mi->m", way, self._lag.normals)
        stretch = way - along[:, None] * self._lag.normals
        return stretch, np.maximum(np.linalg.norm(stretch, axis=1), _LEAST_MM)

    def shears_mpa(self, u: FloatArray) -> FloatArray:
        """Return the shear by friction on the body at each face's points, referred to the area at rest, (k, q, 3)."""
        stretch, length = self._stretch(u)
        size = np.minimum(self._stick * length, self._lag.limits_mpa)
        return np.asarray((size / length)[:, None] * stretch).reshape(*self._areas.shape, 3)

    def slips_mm(self, u: FloatArray) -> FloatArray:
        """Return how far each face's points have slipped over the body since the increment began, (k, q)."""
        _, length = self._stretch(u)
        slipped = np.maximum(length - self._lag.limits_mpa / self._stick, 0.0)
        return np.where(self._lag.limits_mpa > 0.0, slipped, 0.0).reshape(self._areas.shape)

    def friction_work_n_mm(self, u: FloatArray) -> float:
        """Return the work lost since the increment began, sum A mu p s, with the limits at its end."""
        return float((self._areas * self._lag.limits_mpa.reshape(self._areas.shape) * self.slips_mm(u)).sum())

    def stored_energy(self, u: FloatArray) -> float:
        """Return the energy that comes back, in N mm: of the sinking in, and of the stretch of what sticks."""
        shear = np.linalg.norm(self.shears_mpa(u), axis=-1)
        return super().energy(u) + float((self._areas * shear**2).sum()) / (2.0 * self._stick)

    def _friction_n(self, u: FloatArray) -> FloatArray:
        """Return the force of friction on the body at each point, (m, 3)."""
        return np.asarray((self._areas[..., None] * self.shears_mpa(u)).reshape(-1, 3))

    def energy(self, u: FloatArray) -> float:
        """Return Pi in N mm at the limits that friction has now."""
        _, length = self._stretch(u)
        limit, k = self._lag.limits_mpa, self._stick
        slips = k * length > limit
        phi = np.where(slips, limit * length - limit**2 / (2.0 * k), 0.5 * k * length**2)
        return super().energy(u) + float((self._areas.ravel() * np.where(limit > 0.0, phi, 0.0)).sum())

    def gradient(self, u: FloatArray) -> FloatArray:
        """Return dPi/du in N, shape (n, 3)."""
        out = super().gradient(u)
        force = self._friction_n(u).reshape(*self._areas.shape, 3)
        np.add.at(out, self.quads.ravel(), np.einsum("kqa,kqi->kai", self._shapes, force).reshape(-1, 3))
        return out

    def hessian(self, u: FloatArray, project: bool) -> sp.coo_array | sp.csr_array:
        """Return the second derivative, which has no negative curvature: k A P of what sticks, less where it slips.

        A mu p / t (P - t t) of a point that slips, with P = 1 - n n and the direction t of its slip.
        """
        pushed = super().hessian(u, project)
        stretch, length = self._stretch(u)
        limit, k, normal = self._lag.limits_mpa, self._stick, self._lag.normals
        at = np.flatnonzero(limit > 0.0)
        if not len(at):
            return pushed
        across = np.eye(3) - normal[at, :, None] * normal[at, None, :]
        way = stretch[at] / length[at, None]
        slips = (k * length[at] > limit[at])[:, None, None]
        rate = np.minimum(k, limit[at] / length[at])[:, None, None]
        blocks = rate * (across - np.where(slips, way[:, :, None] * way[:, None, :], 0.0))
        face, number = np.divmod(at, self._areas.shape[1])
        scaled = self._areas.ravel()[at, None, None] * blocks
        return sp.coo_array(pushed + node_blocks(self.quads[face], self._shapes[face, number], scaled, len(u)))

    def forces_n(self, u: FloatArray) -> FloatArray:
        """Return the force on the body at each point, (m, 3)."""
        distance, normal, _ = self.pose.distances(self.body, self._points(u))
        pull = (self._eps * self._areas.ravel() * np.minimum(distance, 0.0))[:, None] * normal
        return np.asarray(pull + self._friction_n(u))

    def force_n(self, u: FloatArray) -> FloatArray:
        """Return the force on the body (3,)."""
        return np.asarray(self.forces_n(u).sum(axis=0))

    def normal_force_n(self, u: FloatArray) -> FloatArray:
        """Return the part of the force on the body that is pressure, (3,)."""
        return super().force_n(u)

    def torque_n_mm(self, u: FloatArray) -> FloatArray:
        """Return the torque on the body about its origin, where that is now, (3,)."""
        arms = self._points(u) - np.array(self.pose.position_mm)
        return np.asarray(np.cross(arms, self.forces_n(u)).sum(axis=0))


@dataclass(frozen=True, slots=True)
class ContactMotion:
    """Where an indenter was at k increments of its path, and what its contact did there.

    Attributes
    ----------
    moves_mm
        From first touch across the finger (x), along the pad's outward normal (y) and along the finger (z), (k, 3).
    turns_deg
        Rotation vector from first touch about the indenter's own middle, in the same axes, (k, 3).
    origins_mm
        Where that middle was, (k, 3).
    torque_n_mm
        On the indenter, about its middle where that was, (k, 3).
    pressure_mpa
        At the q points of the coat's f faces, (k, f, q).
    shear_mpa
        By friction, on the indenter, (k, f, q, 3).
    slip_mm
        Of the coat over the indenter in the increment, (k, f, q); 0 where it sticks or does not touch.
    """

    moves_mm: FloatArray
    turns_deg: FloatArray
    origins_mm: FloatArray
    torque_n_mm: FloatArray
    pressure_mpa: FloatArray
    shear_mpa: FloatArray
    slip_mm: FloatArray


class SlidingTouch(PenaltyTouch):
    """What a moved indenter's contact does at an equilibrium: a :class:`~sim.mechanics._press.Touch`.

    Parameters
    ----------
    mesh
        Finger.
    contact
        Of its coat with the indenter.
    """

    def __init__(self, mesh: FingerMesh, contact: SlidingContact) -> None:
        super().__init__(mesh, contact)
        self.sliding = contact
        self.supports = Supports.at_rest(len(mesh.nodes_mm), mesh.node_sets["fixed"])

    @property
    def note(self) -> str:
        """How the surfaces touch."""
        ratio = self.sliding.friction_ratio
        how = f"Coulomb friction {ratio:g}, which follows stick and slip" if ratio > 0.0 else "frictionless"
        return f"penalty contact: {how}; the indenter's distance is exact{NOT_OF_RIBS}"

    def energy_n_mm(self, u: FloatArray) -> float:
        """Return the energy that the contact gives back."""
        return self.sliding.stored_energy(u)

    def friction_work_n_mm(self, u: FloatArray) -> float:
        """Return the work lost in the increment that ended at `u`."""
        return self.sliding.friction_work_n_mm(u)

    def settle(self, state: State) -> bool:
        """Renew the limits of friction at an equilibrium; return whether it still is one."""
        if self.is_sharp:
            self.sliding.approach()
        return self.sliding.settle(state.u_mm)

    def accept(self, state: State) -> None:
        """Let the next increment begin at a state."""
        self.sliding.accept(state.u_mm)


class SlidingPress(SlidingTouch):
    """The coat against an indenter with friction that is placed at a depth.

    Parameters
    ----------
    mesh, indenter, stiffness_mpa_per_mm
        See :class:`PenaltyPress`.
    friction_ratio
        Coulomb's coefficient.
    """

    def __init__(
        self, mesh: FingerMesh, indenter: RigidIndenter, stiffness_mpa_per_mm: float, friction_ratio: float
    ) -> None:
        body, pose = indenter.exact_body(), indenter.touching
        points = coat_points(mesh.nodes_mm, mesh.surfaces["coat"], body)
        contact = SlidingContact(mesh.nodes_mm, points, body, pose, stiffness_mpa_per_mm, friction_ratio)
        super().__init__(mesh, contact)
        self._indenter = indenter
        self.terms: tuple[Term, ...] = (contact,)

    def push(self, depth_mm: float) -> Supports:
        """Place the indenter at a depth for an increment from where the last one ended, and return the supports."""
        self.sliding.restart(self._indenter.pose(depth_mm))
        return self.supports

    def hold(self, state: State, touching_mm: float, depth_mm: float) -> bool:
        """Place the indenter with what touches at another depth alone, see :class:`~sim.mechanics._increments.Load`."""
        self.push(touching_mm)
        return self.sliding.hold(state.u_mm, self._indenter.pose(depth_mm))
