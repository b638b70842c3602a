"""Materials and sections of a deck; mm, N, MPa."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from data_schemas.errors import SimulateError
from sim.mechanics.materials import LinearElastic, Material, Ogden
from sim.mechanics.other_engines.invariant_law import InvariantLaw, fit_invariant_law

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
