"""What is in equilibrium: the elastic mesh and further energies, assembled into one gradient and one matrix."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from sim.mechanics.elements import Elasticity, Modes
from sim.mechanics.sparsity import UpperBlocks, add_forces

FloatArray = NDArray[np.float64]


class Term(Protocol):
    """An energy of the nodes' displacement u (n, 3) in mm beside the elastic one: contact, friction at fixed lag, ties.

    A node of the mesh that no element uses is a rigid body's position: terms may move it like any other.
    """

    def energy(self, u: FloatArray) -> float:
        """Return the energy in N mm; infinity where u is not allowed."""
        ...

    def gradient(self, u: FloatArray) -> FloatArray:
        """Return its derivative in N, shape (n, 3): minus the force on the nodes."""
        ...

    def hessian(self, u: FloatArray, project: bool) -> sp.coo_array | sp.csr_array:
        """Return its second derivative in N/mm, symmetric (3 n, 3 n), unknown 3 node + axis.

        With `project` without negative curvature. Explicit zeros reserve their place, so that a matrix whose entries
        come and go need not be analysed again.
        """
        ...

    def max_step(self, u: FloatArray, du: FloatArray) -> float:
        """Return the largest share (0, 1] of the step du (n, 3) from u that is allowed."""
        ...


@dataclass(frozen=True, slots=True)
class State:
    """Displacement of the nodes (n, 3) and incompatible modes of the elements, in mm."""

    u_mm: FloatArray
    modes: Modes

    def moved(self, share: float, du: FloatArray, step: Modes) -> "State":
        """Return the state a share of a step further."""
        return State(self.u_mm + share * du, tuple(m + share * d for m, d in zip(self.modes, step, strict=True)))


class Assembly:
    """Elastic mesh and further terms, whose sum of energies is to be least.

    Parameters
    ----------
    elasticity
        The elastic mesh.
    terms
        Further energies.
    """

    def __init__(self, elasticity: Elasticity, terms: Sequence[Term] = ()) -> None:
        self.elasticity = elasticity
        self.terms: tuple[Term, ...] = tuple(terms)
        self.count = elasticity.count
        self.matrix = UpperBlocks(self.count, elasticity.cells)
        self._slots_of(self.matrix.version)

    def _slots_of(self, version: int) -> None:
        self._version = version
        self._slots = [self.matrix.slots(cells) for cells in self.elasticity.cells]

    def at_rest(self) -> State:
        """Return the undeformed state."""
        return State(np.zeros((self.count, 3)), self.elasticity.no_modes)

    def energy(self, state: State) -> float:
        """Return the whole energy in N mm; infinity where it is not defined."""
        energy = 0.0
        for term in self.terms:
            energy += term.energy(state.u_mm)
            if energy == math.inf:
                return energy
        return energy + self.elasticity.energy(state.u_mm, state.modes)

    def assemble(self, state: State, project: bool = False) -> tuple[FloatArray, FloatArray]:
        """Fill :attr:`matrix` and return the gradient without the modes, and its part of the terms, in N, (n, 3)."""
        if self._version != self.matrix.version:
            self._slots_of(self.matrix.version)
        self.matrix.clear()
        gradient = np.zeros((self.count, 3))
        for part in self.elasticity.matrices(state.u_mm, state.modes, project):
            cells = self.elasticity.cells[part.block][part.elements]
            self.matrix.add_cells(cells, self._slots[part.block][part.elements], part.tangent)
            add_forces(cells, part.force, gradient)
        of_terms = np.zeros((self.count, 3))
        for term in self.terms:
            of_terms += term.gradient(state.u_mm)
            self.matrix.add_sparse(term.hessian(state.u_mm, project))
        return gradient + of_terms, of_terms

    def max_step(self, state: State, du: FloatArray) -> float:
        """Return the largest share of the step du (n, 3) that all terms allow."""
        return min([1.0, *(term.max_step(state.u_mm, du) for term in self.terms)])
