"""A law of the invariants fitted to an Ogden rubber, for programs in which Ogden's law does not converge."""

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from data_schemas.errors import SimulateError
from sim.mechanics.materials import Ogden

FloatArray = NDArray[np.float64]

_MODES: Final = {"uniaxial": -0.5, "planar": 0.0, "equibiaxial": 1.0}
_STRETCHES = 121  # per mode, even in log stretch: the fit changes by under 1e-4 with twice as many
_UNSTRETCHED = 1e-3  # |log stretch| under which a relative deviation of two vanishing stresses means nothing


@dataclass(frozen=True, slots=True)
class InvariantLaw:
    """Polynomial of second order, sum over i + j = 1, 2 of C_ij (I1 - 3)^i (I2 - 3)^j, with K/2 (J - 1)^2.

    Attributes
    ----------
    c_mpa
        C10, C01, C20, C11, C02.
    bulk_modulus_mpa
        K.
    stretches
        Range of the fit.
    deviation_rel
        Largest relative deviation of its stress from the fitted rubber's in the range: uniaxial, planar, equibiaxial.
    """

    c_mpa: tuple[float, float, float, float, float]
    bulk_modulus_mpa: float
    stretches: tuple[float, float]
    deviation_rel: float


def fit_invariant_law(rubber: Ogden, stretches: tuple[float, float] = (0.8, 1.25)) -> InvariantLaw:
    """Fit the polynomial of second order to a rubber's stresses; the initial shear modulus is kept exactly.

    Least squares of the relative deviation in uniaxial, planar and equibiaxial load, incompressible, evenly over the
    logarithm of the stretch. Outside its range the polynomial is no better than any extrapolation.

    Parameters
    ----------
    rubber
        Material to stand in for.
    stretches
        Least and largest stretch, around 1.

    Raises
    ------
    SimulateError
        When the range does not hold 1 inside, or when the fitted law is not stable in it.
    """
    if not 0.0 < stretches[0] < 1.0 < stretches[1]:
        raise SimulateError(f"the stretches of a fit must lie on both sides of 1, got {stretches[0]} to {stretches[1]}")
    logs = np.linspace(math.log(stretches[0]), math.log(stretches[1]), _STRETCHES)
    logs = logs[np.abs(logs) > _UNSTRETCHED]
    slopes, aims, curves = zip(*(_slopes(rubber, logs, second) for second in _MODES.values()), strict=True)
    slope, aim = np.concatenate(slopes), np.concatenate(aims)
    # C01 = mu / 2 - C10 keeps the initial shear modulus 2 (C10 + C01)
    half = rubber.shear_modulus_mpa / 2.0
    free = np.column_stack([slope[:, 0] - slope[:, 1], slope[:, 2:]])
    known = half * slope[:, 1]
    solution, *_ = np.linalg.lstsq(free / aim[:, None], (aim - known) / aim)
    c10, c20, c11, c02 = (float(c) for c in solution)
    law = (c10, half - c10, c20, c11, c02)
    for name, curve in zip(_MODES, curves, strict=True):
        if (curve @ law <= 0.0).any():
            raise SimulateError(
                f"the polynomial fitted to mu_mpa = {rubber.mu_mpa}, alpha = {rubber.alpha} loses its stiffness under "
                f"{name} load between stretches of {stretches[0]:g} and {stretches[1]:g}; take a smaller range"
            )
    deviation = float(np.abs(slope @ law / aim - 1.0).max())
    return InvariantLaw(law, rubber.bulk_modulus_mpa, stretches, deviation)


def _slopes(rubber: Ogden, logs: FloatArray, second: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return d psi / d log stretch of the five terms (m, 5) and of the rubber (m,), and of the terms once more."""
    share = np.array([1.0, second, -(1.0 + second)])
    stretch = np.exp(np.outer(logs, share))
    i1, i2 = (stretch**2).sum(1) - 3.0, (stretch**-2).sum(1) - 3.0
    d1, d2 = 2.0 * stretch**2 @ share, -2.0 * stretch**-2 @ share
    dd1, dd2 = 4.0 * stretch**2 @ share**2, 4.0 * stretch**-2 @ share**2
    first = np.column_stack([d1, d2, 2.0 * i1 * d1, d1 * i2 + i1 * d2, 2.0 * i2 * d2])
    again = np.column_stack(
        [
            dd1,
            dd2,
            2.0 * (d1**2 + i1 * dd1),
            dd1 * i2 + 2.0 * d1 * d2 + i1 * dd2,
            2.0 * (d2**2 + i2 * dd2),
        ]
    )
    terms = zip(rubber.mu_mpa, rubber.alpha, strict=True)
    aim = sum((2.0 * m / a * (stretch**a @ share) for m, a in terms), np.zeros_like(logs))
    return first, aim, again
