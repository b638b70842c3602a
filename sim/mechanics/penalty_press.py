"""The press of an indenter by a penalty on its exact distances: the fast path, frictionless, of the coat alone."""

import numpy as np
from numpy.typing import NDArray

from data_schemas.design import FingerDesign
from data_schemas.errors import SimulateError
from data_schemas.press_mechanics import ContactKind
from sim.mechanics.assembly import State, Term
from sim.mechanics.contact_analytic import PenaltyContact
from sim.mechanics.indenters import RigidIndenter
from sim.mechanics.mesh import FingerMesh
from sim.mechanics.newton import Supports

FloatArray = NDArray[np.float64]

# contact sinks in by pressure / stiffness: at a tenth of the gel's modulus by a thousandth of an element
_CONTACT_MODULI_PER_STEP = 100.0


def penalty_mpa_per_mm(design: FingerDesign, step_mm: float) -> float:
    """Return the stiffness of a penalty on a coat with elements of this size."""
    return _CONTACT_MODULI_PER_STEP * (2.0 * design.mechanics.gel.c10_mpa) / step_mm


class PenaltyTouch:
    """What the penalty does at an equilibrium: a :class:`~sim.mechanics.press_contact.Touch`.

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
        how = "contact by penalty: frictionless; the indenter's distance is exact; ribs do not see each other"
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

    def __init__(
        self, mesh: FingerMesh, indenter: RigidIndenter, stiffness_mpa_per_mm: float, left_out: str = ""
    ) -> None:
        if indenter.body is None:
            raise SimulateError("a mesh of the user has no exact distances: use --contact barrier, or auto")
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

    def settle(self, state: State) -> bool:
        """Return True: nothing is lagged."""
        return True

    def accept(self, state: State) -> None:
        """Do nothing: an increment leaves nothing behind."""
