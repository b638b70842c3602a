"""A finger condensed to the forces on its coat: contact is found in milliseconds, exactly on a linear finger.

One factorisation at rest gives the displacement of every node under a force on each node of the coat. After that only
the contact has to be found, with the sampling points, penalty and distances of the finite elements. The effect of large
strains of the gel and of bent ribs is not included: :class:`~sim.experiments.SurrogateFinger` learns it and states its
error.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from data_schemas import FingerDesign, Preset, SimulateError
from sim.mechanics._assembly import Assembly, Elasticity
from sim.mechanics._finger_mesh import STEPS, finger_materials, finger_mesh, finger_ties
from sim.mechanics._indenters import RigidIndenter
from sim.mechanics._linear_solver import linear_solver
from sim.mechanics._mesh import FingerMesh
from sim.mechanics._newton import Supports
from sim.mechanics._penalty_contact import (
    PenaltyContact,
    TouchedPoints,
    coat_points,
    penalty_mpa_per_mm,
)
from sim.mechanics._rigid_bodies import Pose

FloatArray = NDArray[np.float64]
SingleArray = NDArray[np.float32]
IntArray = NDArray[np.int64]
Progress = Callable[[int, int, str], None]

_SHAPES = 160  # of the finger behind the coat; see Condensation.far_rest_rel
_EXTRA_SHAPES = 16  # by which a random range must be wider than what is kept of it (Halko, Martinsson, Tropp 2011)
_TOLD_EVERY = 64  # solutions between two lines of progress
_MOST_ROUNDS = 40
_NEAR_MM = 0.5  # of the body at its whole push: faces that are looked at, unless others come to touch
_FIRST_SHARE = 0.2  # of the push, whose points take the first step
_SETTLED_REL = (
    5e-4  # of the contact's forces; the exact ones lie nearer: the finger gives way, which (1 + H C)^-1 < 1 tells
)
_INEXACT_REL = 0.02  # to which a round solves its linear system, of what is out of balance then
_MOST_PRODUCTS = 200
_SLIGHT_FALL = 1e-4
_LEAST_SHARE = 1.0 / 64.0


@dataclass(frozen=True, slots=True)
class Condensation:
    r"""How a finger at rest moves under forces f (3 c,) on the c nodes of its coat: u_coat = C f, u = S^T (L f).

    Attributes
    ----------
    compliance_mm_per_n
        C (3 c, 3 c), symmetric, unknown 3 node + axis; the nodes as ascending in the mesh's surface "coat".
    shapes
        S (r, 3 n), orthonormal: all nodes' displacements in r shapes.
    shape_compliance_mm_per_n
        L (r, 3 c).
    far_rest_rel
        Norm of what the r shapes leave of the displacements of the nodes off the coat, over their norm.
    """

    compliance_mm_per_n: SingleArray
    shapes: SingleArray
    shape_compliance_mm_per_n: SingleArray
    far_rest_rel: float


def coat_of(mesh: FingerMesh) -> IntArray:
    """Return the nodes of a mesh's coat, ascending, (c,)."""
    return np.unique(mesh.surfaces["coat"])


def condense_finger(
    design: FingerDesign, preset: Preset | None = None, threads: int = 1, progress: Progress | None = None
) -> Condensation:
    """Factorise a finger at rest and solve for a force on each node of its coat, along each axis.

    Valid for displacements small beside the finger's parts: the stiffness is that at rest.

    Parameters
    ----------
    design, preset
        Finger and fineness; 2,052 solutions of 38,676 unknowns on the coarse 70 x 35 finger.
    threads
        Of elements and factorisation.
    progress
        Called now and then with solutions done and wanted.

    Raises
    ------
    SimulateError
        When the finger cannot be meshed, or a part of it can move freely.
    """
    mesh, steps = finger_mesh(design, preset), STEPS[preset or design.mesh.preset]
    elasticity = Elasticity(mesh, finger_materials(design), threads)
    assembly = Assembly(elasticity, finger_ties(design, mesh, steps.skeleton_mm))
    assembly.assemble(assembly.at_rest())
    fixed = Supports.at_rest(len(mesh.nodes_mm), mesh.node_sets["fixed"]).fixed
    assembly.matrix.constrain(np.asarray(fixed).ravel())
    solver = linear_solver(threads=threads)
    solver.factorise(assembly.matrix.upper(), assembly.matrix.version)
    unknowns = (3 * coat_of(mesh)[:, None] + np.arange(3)).ravel()
    moved = np.empty((len(unknowns), mesh.nodes_mm.size), np.float32)
    for number, unknown in enumerate(unknowns):
        force = np.zeros(mesh.nodes_mm.size)
        force[unknown] = 1.0
        moved[number] = solver.solve(force)
        if progress is not None and number % _TOLD_EVERY == 0:
            progress(number, len(unknowns), "condensing the finger to its coat")
    return _condensation(moved, unknowns)


def _condensation(moved: SingleArray, unknowns: IntArray) -> Condensation:
    """Return the condensation from the displacements (3 c, 3 n) under a unit force on each unknown of the coat."""
    coat = moved[:, unknowns]
    off = moved.copy()
    off[:, unknowns] = 0.0
    wide = min(_SHAPES + _EXTRA_SHAPES, len(unknowns))
    random = np.random.default_rng(0).standard_normal((wide, len(unknowns))).astype(np.float32)
    # twice applied, the range is that of the cube: a compliance falls slowly enough to need it
    range_of, _ = np.linalg.qr(((random @ off) @ off.T @ off).T)
    turn, _, _ = np.linalg.svd(range_of.T @ off.T, full_matrices=False)
    shapes = np.ascontiguousarray((range_of @ turn[:, :_SHAPES]).T)
    found = shapes @ off.T
    rest = float(np.linalg.norm(off - found.T @ shapes) / np.linalg.norm(off))
    return Condensation((coat + coat.T) / 2.0, shapes, found, rest)


@dataclass(frozen=True, slots=True)
class CondensedContact:
    """Where contact and the linear finger are in balance.

    Attributes
    ----------
    coat_forces_n
        On the coat's nodes, (c, 3).
    coat_mm
        Displacement of the coat's nodes (c, 3).
    force_n
        On the indenter (3,).
    pressure_mpa
        At the q sampling points of the coat's f faces, (f, q).
    touch_mm
        Where these lie in the undeformed pad, (f, q, 3).
    rounds
        Newton's steps.
    """

    coat_forces_n: FloatArray
    coat_mm: FloatArray
    force_n: FloatArray
    pressure_mpa: FloatArray
    touch_mm: FloatArray
    rounds: int


class CondensedFinger:
    """A finger whose contact is found on its condensation.

    Parameters
    ----------
    design, preset
        As for :func:`condense_finger`; the design's indenter has no part in it.
    condensed
        What that returned.

    Attributes
    ----------
    mesh, coat
        The mesh, and the nodes of its coat (c,).

    Raises
    ------
    SimulateError
        When the condensation is of another mesh.
    """

    def __init__(self, design: FingerDesign, preset: Preset, condensed: Condensation) -> None:
        self.mesh = finger_mesh(design, preset)
        self.coat = coat_of(self.mesh)
        self.condensed = condensed
        size = 3 * len(self.coat)
        if condensed.compliance_mm_per_n.shape != (size, size) or condensed.shapes.shape[1] != self.mesh.nodes_mm.size:
            raise SimulateError(
                "the condensation belongs to another mesh, because its coat has "
                f"{len(condensed.compliance_mm_per_n) // 3} nodes and that of the design has {len(self.coat)}; "
                "condense this design again"
            )
        self._quads = np.searchsorted(self.coat, self.mesh.surfaces["coat"])
        self._rest = self.mesh.nodes_mm[self.coat]
        self._eps = penalty_mpa_per_mm(design, STEPS[preset].pad_mm)

    def press(self, indenter: RigidIndenter, depth_mm: float) -> CondensedContact:
        r"""Return the contact with an indenter at a push, by Newton's method on the forces of the coat.

        .. math:: f + \nabla\Pi(C f) = 0, \qquad (1 + H C)\,\Delta f = -(f + \nabla\Pi)

        with the penalty's energy Pi and its second derivative H. The system is self-adjoint in the product x^T C y and
        solved by conjugate gradients in it; steps lower f^T C f / 2 + Pi.

        Parameters
        ----------
        indenter
            At first touch, with an exact distance.
        depth_mm
            Push from there.

        Raises
        ------
        SimulateError
            When the indenter is a mesh, or no balance is found.
        """
        if indenter.body is None:
            raise SimulateError(
                "a condensed finger cannot be pressed by an indenter from an STL file; give a cylinder, a ball or a "
                "cuboid, or press by finite elements"
            )
        pose = indenter.pose(depth_mm)
        points, still = coat_points(self._rest, self._quads, indenter.body), np.zeros_like(self._rest)
        whole = PenaltyContact(self._rest, points, indenter.body, pose, self._eps)
        near = np.flatnonzero(whole.gaps_mm(still).min(axis=1) < _NEAR_MM)
        while True:
            contact = PenaltyContact(self._rest, points.of(near), indenter.body, pose, self._eps)
            search = _Balance(self.condensed.compliance_mm_per_n, contact, len(self.coat))
            search.begin(indenter.pose(_FIRST_SHARE * depth_mm))
            rounds = search.solve()
            moved = search.moved.reshape(-1, 3)
            pressure = whole.pressures_mpa(moved)
            touching = np.flatnonzero(pressure.max(axis=1) > 0.0)
            if np.isin(touching, near).all():
                break
            near = np.union1d(near, touching)
        forces, touch_mm = search.forces.reshape(-1, 3), whole.points_mm(still)
        return CondensedContact(forces, moved, whole.force_n(moved), pressure, touch_mm, rounds)

    def displacement_mm(self, contact: CondensedContact) -> FloatArray:
        """Return the displacement of all n nodes (n, 3): the coat's exact, the others' in the stored shapes."""
        along = self.condensed.shape_compliance_mm_per_n @ contact.coat_forces_n.ravel().astype(np.float32)
        moved = (along @ self.condensed.shapes).reshape(-1, 3).astype(np.float64)
        moved[self.coat] = contact.coat_mm
        return moved


class _Balance:
    """Newton's search of the forces on the coat that a contact and the compliance agree on."""

    def __init__(self, compliance: SingleArray, contact: PenaltyContact, count: int) -> None:
        self._compliance, self._contact = compliance, contact
        self.forces: FloatArray = np.zeros(3 * count)
        self.moved: FloatArray = np.zeros(3 * count)
        self._region = np.empty(0, np.int64)  # unknowns that forces act on
        self._rows = self._block = np.empty((0, 0), np.float32)

    def begin(self, raised: Pose) -> None:
        """Take the first step by the points alone that touch a body which is pushed less far.

        The finger gives way by most of the push: of the points within the body at its whole push few stay in touch.
        """
        there = self._contact.pose
        self._contact.place(raised)
        points = self._contact.touched(self.moved.reshape(-1, 3))
        self._contact.place(there)
        if not len(points.gap_mm):
            return
        self._widen(points)
        normal = self._normal_rows(points)
        further = np.array(there.position_mm) - np.array(raised.position_mm)
        gap = points.gap_mm - points.normals @ further
        step = self._step(normal, points.stiffness_n_per_mm, normal.T @ (-points.stiffness_n_per_mm * gap))
        self.forces[self._region] = step
        self.moved = np.asarray(self._rows.T @ step.astype(np.float32), dtype=np.float64)

    def solve(self) -> int:
        """Search; return the number of rounds."""
        touched = self._contact.touched(self.moved.reshape(-1, 3))
        for number in range(_MOST_ROUNDS):
            self._widen(touched)
            if not len(self._region):
                return number
            normal = self._normal_rows(touched)
            pushes = -touched.stiffness_n_per_mm * touched.gap_mm
            wanted = normal.T @ pushes
            out_of_balance = wanted - self.forces[self._region]
            if np.linalg.norm(out_of_balance) <= _SETTLED_REL * np.linalg.norm(wanted):
                return number
            step = self._step(normal, touched.stiffness_n_per_mm, out_of_balance)
            touched = self._walk(step, out_of_balance, touched)
        raise SimulateError(
            f"no equilibrium of the contact was found in {_MOST_ROUNDS} rounds; press by finite elements, or less "
            "deeply"
        )

    def _widen(self, touched: TouchedPoints) -> None:
        """Let forces act on all nodes whose faces touch, or have touched."""
        nodes = np.union1d(self._region[::3] // 3, touched.nodes)
        if 3 * len(nodes) != len(self._region):
            self._region = (3 * nodes[:, None] + np.arange(3)).ravel()
            self._rows = self._compliance[self._region]
            self._block = np.ascontiguousarray(self._rows[:, self._region])

    def _normal_rows(self, touched: TouchedPoints) -> sp.csr_array:
        """Return the matrix (m, unknowns of the region) from forces' unknowns to each point's way along its normal."""
        count = len(touched.gap_mm)
        place = np.searchsorted(self._region[::3] // 3, touched.nodes)
        columns = (3 * place[:, :, None] + np.arange(3)).reshape(-1)
        values = (touched.weights[:, :, None] * touched.normals[:, None, :]).reshape(-1)
        return sp.csr_array((values, columns, 12 * np.arange(count + 1)), shape=(count, len(self._region)))

    def _step(self, normal: sp.csr_array, stiffness: FloatArray, right: FloatArray) -> FloatArray:
        """Return df of (1 + H C) df = right, nearly, by conjugate gradients in the product x^T C y."""
        back = normal.T.tocsr()
        step, residual = np.zeros_like(right), right
        seen = self._times(residual)
        slope = float(residual @ seen)
        enough = _INEXACT_REL**2 * slope
        way, way_seen = residual, seen
        for _ in range(_MOST_PRODUCTS):
            if not slope > enough:
                break
            image = way + back @ (stiffness * (normal @ way_seen))
            share = slope / float(image @ way_seen)
            step, residual = step + share * way, residual - share * image
            seen = self._times(residual)
            before, slope = slope, float(residual @ seen)
            way, way_seen = residual + slope / before * way, seen + slope / before * way_seen
        return step

    def _times(self, forces: FloatArray) -> FloatArray:
        return np.asarray(self._block @ forces.astype(np.float32), dtype=np.float64)

    def _energy(self, forces: FloatArray, touched: TouchedPoints) -> float:
        """Return f^T C f / 2 + Pi of forces on the region."""
        penalty = 0.5 * float(touched.stiffness_n_per_mm @ touched.gap_mm**2)
        return 0.5 * float(forces @ self._times(forces)) + penalty

    def _walk(self, step: FloatArray, out_of_balance: FloatArray, touched: TouchedPoints) -> TouchedPoints:
        """Go along a step as far as the energy falls; return what touches there."""
        start, moved = self.forces[self._region], self.moved
        seen = self._rows.T @ step.astype(np.float32)
        energy, slope = self._energy(start, touched), -float(out_of_balance @ self._times(step))
        share = 1.0
        while True:
            there = start + share * step
            self.moved = moved + share * seen
            touched = self._contact.touched(self.moved.reshape(-1, 3))
            fallen = self._energy(there, touched) <= energy + _SLIGHT_FALL * share * slope
            if fallen or share <= _LEAST_SHARE:
                self.forces[self._region] = there
                return touched
            share /= 2.0
