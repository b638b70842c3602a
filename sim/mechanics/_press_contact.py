"""Contact of a press: the fast penalty on exact distances, or the barrier with friction and contact of the ribs."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from data_schemas import ContactKind, FingerDesign, MissingExtraError, SimulateError
from sim.mechanics._assembly import State, Term
from sim.mechanics._contact_library import contact_library_failure
from sim.mechanics._indenters import rigid_indenter
from sim.mechanics._mesh import FingerMesh
from sim.mechanics._newton import Supports
from sim.mechanics._penalty_contact import PenaltyPress, penalty_mpa_per_mm

if TYPE_CHECKING:
    from sim.mechanics._barrier_contact import Barrier

FloatArray = NDArray[np.float64]
ContactChoice = Literal["auto", "penalty", "barrier"]


class Touch(Protocol):
    """What contact does at an equilibrium; `mesh` is the finger's, with one more node where the indenter is one."""

    mesh: FingerMesh
    kind: ContactKind

    @property
    def note(self) -> str:
        """How surfaces touch, in words."""
        ...

    def force_n(self, u: FloatArray) -> FloatArray:
        """Return the force on the indenter (3,)."""
        ...

    def energy_n_mm(self, u: FloatArray) -> float:
        """Return the energy that the contact stores, without friction."""
        ...

    def friction_work_n_mm(self, u: FloatArray) -> float:
        """Return the work lost to friction in the increment that ended at `u`."""
        ...

    def pressures_mpa(self, u: FloatArray) -> FloatArray:
        """Return the pressure at q points of the coat's f faces, (f, q)."""
        ...

    def touch_mm(self) -> FloatArray:
        """Return where these points lie in the undeformed pad, (f, q, 3)."""
        ...


class PressContact(Touch, Protocol):
    """What a press to a depth needs of its contact."""

    terms: tuple[Term, ...]

    def push(self, depth_mm: float) -> Supports:
        """Move the indenter to a depth and return the supports; lagged forces are those of the last increment."""
        ...

    @property
    def settle(self) -> Callable[[State], bool] | None:
        """What renews lagged forces at an equilibrium and tells whether it still is one; None: nothing is lagged."""
        ...

    def accept(self, state: State) -> None:
        """Let the next increment begin at a stored state."""
        ...


def chosen_contact(design: FingerDesign, wanted: ContactChoice = "auto") -> ContactKind:
    """Return the contact of a press: the penalty where it can, the barrier for friction and meshes of the user.

    Where the barrier's library does not run on this machine, "auto" takes the penalty, without the friction: see
    :func:`left_out`.

    Raises
    ------
    SimulateError
        When the penalty is asked for where only the barrier serves.
    MissingExtraError
        When only the barrier serves, or it is asked for, and its library does not run here.
    """
    needs = _needs_of_barrier(design)
    if wanted == "penalty" and needs:
        raise SimulateError(f"--contact penalty cannot serve {' and '.join(needs)}: use --contact barrier, or auto")
    if wanted == "penalty" or not (needs or wanted == "barrier"):
        return "penalty"
    failure = contact_library_failure()
    if failure is None:
        return "barrier"
    if wanted == "auto" and design.indenter.shape != "mesh":
        return "penalty"
    asked = "--contact barrier" if wanted == "barrier" else " and ".join(needs)
    raise MissingExtraError(f"{asked} needs the contact by a barrier, and {failure}")


def left_out(design: FingerDesign, wanted: ContactChoice = "auto") -> str:
    """Return in a sentence what the chosen contact leaves out because the barrier's library does not run here."""
    if wanted != "auto" or not _needs_of_barrier(design) or chosen_contact(design) == "barrier":
        return ""
    return (
        f"this press leaves friction out (indenter.friction = {design.indenter.friction:g}), because "
        f"{contact_library_failure()}"
    )


def _needs_of_barrier(design: FingerDesign) -> list[str]:
    """Return the fields of a design that only the barrier serves."""
    indenter = design.indenter
    return [
        *([f"indenter.friction = {indenter.friction:g}"] if indenter.friction > 0.0 else []),
        *(['indenter.shape = "mesh"'] if indenter.shape == "mesh" else []),
    ]


def press_contact(
    design: FingerDesign,
    mesh: FingerMesh,
    step_mm: float,
    wanted: ContactChoice = "auto",
    threads: int = 1,
    folder: Path = Path(),
    barrier: "Barrier | None" = None,
) -> PressContact:
    """Return the contact of a finger with its indenter at first touch.

    Parameters
    ----------
    design, mesh
        Finger.
    step_mm
        Edge of the pad's elements.
    wanted
        See :func:`chosen_contact`.
    threads
        Of the barrier.
    folder
        Where the design stands.
    barrier
        How the barrier acts; by default its stiffness is the gel's shear modulus.

    Raises
    ------
    SimulateError, MissingExtraError
        See :func:`chosen_contact` and :func:`~sim.mechanics.rigid_indenter`.
    """
    kind = chosen_contact(design, wanted)
    indenter = rigid_indenter(design, folder)
    if kind == "penalty":
        return PenaltyPress(mesh, indenter, penalty_mpa_per_mm(design, step_mm), left_out(design, wanted))
    # here, because they cannot be imported where the library does not run
    from sim.mechanics._barrier_contact import Barrier, BarrierPress

    chosen = barrier or Barrier(stiffness_mpa=2.0 * design.mechanics.gel.c10_mpa)
    return BarrierPress(design, mesh, indenter, replace(chosen, friction_ratio=design.indenter.friction), threads)
