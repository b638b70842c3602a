"""A displacement that is pulled to a target."""

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


class Drive:
    """A :class:`~sim.mechanics.assembly.Term` that pulls one displacement to a target: k/2 (u - t)^2 + l (u - t).

    A prescribed motion would stop where the barrier's step limit does, far from any equilibrium; a stiff spring gives
    the way there an energy. Its force l is renewed until the target is met.

    Parameters
    ----------
    node, axis
        What is driven.
    stiffness_n_per_mm
        k.
    met_mm
        How near the target must be.
    """

    def __init__(self, node: int, axis: int, stiffness_n_per_mm: float = 1e4, met_mm: float = 1e-4) -> None:
        self.target_mm = 0.0
        self._node, self._axis, self._k, self._met, self._force = node, axis, stiffness_n_per_mm, met_mm, 0.0

    def _off(self, u: FloatArray) -> float:
        return float(u[self._node, self._axis]) - self.target_mm

    def energy(self, u: FloatArray) -> float:
        """Return the energy in N mm."""
        off = self._off(u)
        return 0.5 * self._k * off**2 + self._force * off

    def gradient(self, u: FloatArray) -> FloatArray:
        """Return its derivative in N, shape (n, 3)."""
        out = np.zeros_like(u)
        out[self._node, self._axis] = self._k * self._off(u) + self._force
        return out

    def hessian(self, u: FloatArray, project: bool) -> sp.coo_array | sp.csr_array:
        """Return k at its place."""
        at = np.array([3 * self._node + self._axis])
        return sp.coo_array((np.array([self._k]), (at, at)), shape=(u.size, u.size))

    def max_step(self, u: FloatArray, du: FloatArray) -> float:
        """Return 1."""
        return 1.0

    def settle(self, u: FloatArray) -> bool:
        """Renew the force at an equilibrium; return whether the target was met."""
        off = self._off(u)
        self._force += self._k * off
        return abs(off) <= self._met
