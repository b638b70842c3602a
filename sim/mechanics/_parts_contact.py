"""Contact of a finger's parts among themselves, which a press by the penalty takes up where they come near."""

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from data_schemas import FingerDesign, SimulateError
from sim.mechanics._assembly import Assembly, State
from sim.mechanics._contact_library import contact_library_failure
from sim.mechanics._mesh import FingerMesh, OwnSurfaces
from sim.mechanics._penalty_contact import NOT_OF_RIBS

if TYPE_CHECKING:
    from sim.mechanics._barrier_contact import BarrierContact

FloatArray = NDArray[np.float64]

# parts of a press this shallow have met in none that was tried; where they do, it begins again with the barrier
_SHALLOW_MM = 2.0


def check_parts_contact(had_mm: float | None, asked: str, may_act: bool) -> None:
    """Check that a press whose parts touched is continued with their contact.

    Parameters
    ----------
    had_mm
        Push from which on the press that is continued had it; none: it had not, or none is continued.
    asked
        Contact that is asked for.
    may_act
        Whether contact between the parts may act beside it, on this machine.

    Raises
    ------
    SimulateError
        When it may not.
    """
    if had_mm is None or may_act:
        return
    why = contact_library_failure() or f"--contact {asked} leaves this contact out"
    raise SimulateError(
        f"the press to continue has contact between the parts of the finger from a push of {had_mm:.4g} mm on, but "
        f"{why}; continue with --contact auto, or press again from the beginning"
    )


class PartsContact:
    """Contact of a finger's parts among themselves by a barrier, which acts from where they come within its reach on.

    Nothing was within its reach in the increments before, which are therefore its equilibria too: one contact holds for
    the whole press, and the search continues from the last of them. Where something was, as in a press by the penalty
    that is continued, it is not taken up.

    Parameters
    ----------
    design, mesh, threads
        Of the press.
    assembly
        Gets the contact as a term.
    begin_mm
        Displacement (n, 3) from which the press begins.
    acts
        Whether the press that is continued had this contact.
    """

    def __init__(
        self,
        design: FingerDesign,
        mesh: FingerMesh,
        assembly: Assembly,
        threads: int,
        begin_mm: FloatArray,
        acts: bool = False,
    ) -> None:
        self._design, self._mesh, self._assembly, self._threads = design, mesh, assembly, threads
        self.surfaces = OwnSurfaces(mesh)
        self._clean_mm = begin_mm
        self._watched, self._acts, self._left_out = not acts, acts, ""
        self._continued = ""
        self._contact: BarrierContact | None = None
        if acts:
            self._contact = self._of_parts()
            assembly.terms += (self._contact,)

    def check_start(self, pushed_mm: float) -> None:
        """Check that nothing crosses where a press is continued.

        Raises
        ------
        SimulateError
            When surfaces of the finger pass through each other there, after a push of `pushed_mm`.
        """
        self._continued = (
            ", from which this press was continued. The record of that increment does not state whether contact "
            "between the parts acted (a record before version 7 never does). Press from the start if it may have acted"
        )
        if found := self.surfaces.crossing(self._clean_mm):
            raise SimulateError(
                f"at the increment to continue from (a push of {pushed_mm:.4g} mm), {found}. This is not physical, so "
                "continue from an earlier increment or with --contact penalty, or press again from the beginning"
            )

    def _of_parts(self) -> "BarrierContact":
        from sim.mechanics._barrier_contact import finger_parts_contact  # the library runs here

        return finger_parts_contact(self._design, self._mesh, self._threads)

    def take_up(self, state: State, pushed_mm: float) -> str:
        """Return that parts come near each other at an equilibrium, from before which contact acts; or nothing."""
        if not self._watched or pushed_mm <= _SHALLOW_MM:
            return ""
        if self._contact is None:
            self._contact = self._of_parts()
            if self._contact.energy(self._clean_mm) > 0.0:  # the increments before are no equilibria of it
                self._watched = False
                self._left_out = (
                    f"; parts of the finger were within {self._contact.barrier.reach_mm:g} mm of each other already at "
                    f"the increment before a push of {pushed_mm:.4g} mm{self._continued}"
                )
                return ""
        if self._contact.energy(state.u_mm) == 0.0 and not self.surfaces.crossing(state.u_mm):
            return ""
        self._watched, self._acts = False, True
        self._assembly.terms += (self._contact,)
        reach = self._contact.barrier.reach_mm
        return (
            f"parts of the finger come within {reach:g} mm of each other before a push of {pushed_mm:.4g} mm; contact "
            "between them acts from here on"
        )

    def accept(self, state: State) -> None:
        """Let the next increment begin at a state."""
        self._clean_mm = state.u_mm

    def energy_n_mm(self, u: FloatArray) -> float:
        """Return the energy that this contact stores; 0 where it does not act, or nothing is within its reach."""
        return self._contact.energy(u) if self._contact is not None and self._acts else 0.0

    def note(self, of_penalty: str, u: FloatArray, from_mm: float | None) -> str:
        """Return how the indenter and the parts touch, from what the penalty's note says.

        `from_mm` is the push at the first increment where they touched, if any.
        """
        if self._contact is None or from_mm is None:
            return of_penalty + self._left_out
        reach, pairs = self._contact.barrier.reach_mm, self._contact.pairs_of_parts(u)
        return (
            f"{of_penalty.removesuffix(NOT_OF_RIBS)}; barrier contact acts between parts of the finger, which come "
            f"within {reach:g} mm of each other from a push of {from_mm:.4g} mm on; {pairs} pairs touch at the last "
            "increment"
        )
