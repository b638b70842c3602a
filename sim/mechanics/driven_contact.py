"""A barrier contact whose rigid obstacle is driven to a depth, an increment at a time."""

from sim.mechanics.assembly import State, Term
from sim.mechanics.contact_ipc import BarrierContact
from sim.mechanics.drive import Drive
from sim.mechanics.newton import Supports


class DrivenContact:
    """A barrier contact and the drive of its obstacle against y; along x and z the obstacle is held.

    Parameters
    ----------
    contact
        With an obstacle.
    supports
        What else is held; the obstacle is added.
    reference_node
        The obstacle's.
    met_mm
        How near the depth must be.

    Attributes
    ----------
    terms
        Of the assembly.
    """

    def __init__(self, contact: BarrierContact, supports: Supports, reference_node: int, met_mm: float = 1e-4) -> None:
        self.contact = contact
        self._drive = Drive(reference_node, 1, met_mm=met_mm)
        self.terms: tuple[Term, ...] = (contact, self._drive)
        self._supports = supports
        self._supports.fixed[reference_node] = (True, False, True)

    def push(self, depth_mm: float) -> Supports:
        """Aim at a depth and return the supports; slip counts from the last accepted state."""
        self.contact.restart()
        self._drive.target_mm = -depth_mm
        return self._supports

    def settle(self, state: State) -> bool:
        """Renew lagged forces at an equilibrium; return whether it still is one, and then accept it."""
        met, settled = self._drive.settle(state.u_mm), self.contact.settle(state.u_mm)
        if met and settled:
            self.accept(state)
        return met and settled

    def accept(self, state: State) -> None:
        """Let the next increment begin at a state."""
        self.contact.accept(state.u_mm)
