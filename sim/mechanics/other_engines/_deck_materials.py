"""Materials and sections of a deck; mm, N, MPa.

Where a program does not converge with Ogden's law, a law of the invariants that is fitted to the rubber stands in.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from data_schemas import SimulateError
from sim.mechanics import LinearElastic, Material, Ogden

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


Dialect = Literal["abaqus", "calculix"]

_NO_TERM = "1e6"  # D2 in 1/MPa of a term that shall vanish; CalculiX takes 0 for a value of its own
_ABAQUS_TERMS = 6
_LARGEST_DEVIATION_REL = 0.05  # of a stand-in: beside it, the engines are to agree within 3 %


@dataclass(frozen=True, slots=True)
class DeckMaterials:
    """Lines of the materials, and what must be said about them."""

    lines: tuple[str, ...]
    notes: tuple[str, ...]


def deck_materials(materials: Mapping[str, Material], dialect: Dialect) -> DeckMaterials:
    """Return the materials under their names in capitals.

    Ogden's law is written in the 2 mu / alpha^2 convention, which both programs share, with D1 = 2/K. For CalculiX a
    rubber that is not neo-Hookean becomes a polynomial of the invariants: CalculiX 2.20 takes the stretches from the
    roots of a cubic, whose rounding drowns the tangent at strains of some 1e-6 to 1e-5. A push of 1 mm in one increment
    passes over these strains and converges with Ogden's law too; one of 0.05 mm does not. A law without stretches has
    nothing to round.

    Raises
    ------
    SimulateError
        When the program cannot hold a material.
    """
    lines: list[str] = []
    notes: list[str] = []
    for name, material in materials.items():
        lines.append(f"*MATERIAL, NAME={name.upper()}")
        if isinstance(material, LinearElastic):
            lines += ["*ELASTIC", _numbers(material.youngs_modulus_mpa, material.poisson_ratio)]
            continue
        d1 = 2.0 / material.bulk_modulus_mpa
        if material.alpha == (2.0,):
            lines += ["*HYPERELASTIC, NEO HOOKE", _numbers(material.mu_mpa[0] / 2.0, d1)]
        elif dialect == "calculix":
            law = _stand_in(name, material)
            lines += ["*HYPERELASTIC, POLYNOMIAL, N=2", f"{_numbers(*law.c_mpa, d1)}, {_NO_TERM}"]
            notes.append(
                f"{name}: polynomial of the invariants in place of Ogden's law, with which CalculiX stalls at small "
                f"strains; its stress deviates by at most {100.0 * law.deviation_rel:.1f} % for stretches of "
                f"{law.stretches[0]:g} to {law.stretches[1]:g}, and by more beyond"
            )
        else:
            lines += _ogden(name, material, d1)
    return DeckMaterials(tuple(lines), tuple(notes))


def _stand_in(name: str, material: Ogden) -> InvariantLaw:
    """Return the polynomial for a rubber."""
    law = fit_invariant_law(material)
    if law.deviation_rel > _LARGEST_DEVIATION_REL:
        raise SimulateError(
            f"mechanics.{name}: no polynomial of second order follows this Ogden rubber closer than "
            f"{100.0 * law.deviation_rel:.0f} % for stretches of {law.stretches[0]:g} to {law.stretches[1]:g}; a deck "
            f"for CalculiX allows {100.0 * _LARGEST_DEVIATION_REL:g} %. Press with the engine in process"
        )
    return law


def _ogden(name: str, material: Ogden, d1: float) -> list[str]:
    """Return Ogden's law: pairs mu, alpha, then D of each term, eight numbers in a line."""
    terms = len(material.mu_mpa)
    if terms > _ABAQUS_TERMS:
        raise SimulateError(
            f"mechanics.{name}: an Abaqus deck holds at most {_ABAQUS_TERMS} Ogden terms, the design has {terms}"
        )
    values = [v for pair in zip(material.mu_mpa, material.alpha, strict=True) for v in pair]
    values += [d1, *[0.0] * (terms - 1)]
    return [f"*HYPERELASTIC, OGDEN, N={terms}", *(_numbers(*values[k : k + 8]) for k in range(0, len(values), 8))]


def _numbers(*values: float) -> str:
    """Return a data line; CalculiX reads 20 characters of each number."""
    return ", ".join(f"{value:.10g}" for value in values)
