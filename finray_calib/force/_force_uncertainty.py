"""What a simulated force may be off by: uncertain inputs of the design, and the mesh.

Constants and dimensions are uncertain as stated or by named defaults. The mesh's share is known from the 70 x 35
finger's convergence, or from another mesh.
"""

import math
from dataclasses import dataclass
from operator import attrgetter
from typing import Final

import numpy as np
from numpy.typing import NDArray

from data_schemas import CompareError, FingerDesign, PressMechanics
from finray_calib.force._force_curves import ForceCurve, log_sensitivity

Floats = NDArray[np.float64]

# an elastomer's or plastic's modulus from the literature, for another batch, cure and rate
ASSUMED_MODULUS_REL: Final = 0.2
# K / mu is measured for hardly any silicone: from nu = 0.475 to 0.49975, even in its logarithm. The force changes less
# and less with it, so that this sensitivity, taken where the design is, makes the interval too wide rather than short
ASSUMED_BULK_OVER_SHEAR: Final = (20.0, 2000.0)
_BULK_LN = math.log(ASSUMED_BULK_OVER_SHEAR[1] / ASSUMED_BULK_OVER_SHEAR[0]) / math.sqrt(12.0)
ASSUMED_BULK_REL: Final = math.sqrt(math.expm1(_BULK_LN**2))
# rolled and cast sheets are sold to about a tenth of their thickness
ASSUMED_SHEET_REL: Final = 0.1
# a print's or mould's limits; a rectangular distribution within them (JCGM 100, 4.3.7)
PRINT_LIMIT_MM: Final = 0.1
_SHEETS: Final = ("pad.film.thickness_mm", "skeleton.mirror_thickness_mm")


@dataclass(frozen=True, slots=True)
class ForceInputs:
    """Uncertain inputs of a force, log-normal and independent, each with its effect on ln F.

    Attributes
    ----------
    names, sources
        Field of the design, and in words where its uncertainty is from.
    u_rel
        Standard uncertainties over the values, (i,).
    ln_force_per_ln_input
        d ln F / d ln x at the points, (i, n).
    missing
        What has no sensitivity although it is uncertain, in words.
    """

    names: tuple[str, ...]
    sources: tuple[str, ...]
    u_rel: Floats
    ln_force_per_ln_input: Floats
    missing: tuple[str, ...]

    def draw_ratios(self, draws: int, rng: np.random.Generator) -> Floats:
        """Return draws of the force over that of the design as it is, (draws, n).

        ln F moves by the sum of sensitivities times ln x / x0; ln x is normal with variance ln(1 + u_rel^2).
        """
        u_ln = np.sqrt(np.log1p(self.u_rel**2))
        deviations = u_ln * rng.standard_normal((draws, len(self.names)))
        return np.exp(deviations @ self.ln_force_per_ln_input)


def force_inputs(press: PressMechanics, depth_mm: Floats) -> ForceInputs:
    """Return the uncertain inputs of a press at pushes (n,): those that it was pressed again with."""
    again = press.sensitivities
    varied = again.varied if again is not None else ()
    known = [v for v in varied if len(v.depth_mm) > 1]
    effects = [log_sensitivity(again, v, depth_mm) for v in known] if again is not None else []
    stated = set(press.design.uncertainty_rel) - {v.field for v in varied}
    uncertain = [_uncertainty(press.design, v.field) for v in known]
    return ForceInputs(
        names=tuple(v.field for v in known),
        sources=tuple(source for _, source in uncertain),
        u_rel=np.array([u for u, _ in uncertain]),
        ln_force_per_ln_input=np.array(effects).reshape(len(known), len(depth_mm)),
        missing=(
            *(f"{v.field}: its press failed ({v.failure})" for v in varied if len(v.depth_mm) < 2),
            *(f"{field}: stated by the design, which was not pressed with it changed" for field in sorted(stated)),
            *(() if varied else ("materials and dimensions: 'finray simulate press --sensitivities'",)),
        ),
    )


def _uncertainty(design: FingerDesign, field: str) -> tuple[float, str]:
    """Return the relative standard uncertainty of a field, and where it is from."""
    if field in design.uncertainty_rel:
        return design.uncertainty_rel[field], "stated by the design"
    if field.endswith("_mpa"):
        return ASSUMED_MODULUS_REL, f"assumed: {ASSUMED_MODULUS_REL:.0%} of a modulus"
    if field.endswith("bulk_over_shear"):
        low, high = ASSUMED_BULK_OVER_SHEAR
        return ASSUMED_BULK_REL, f"assumed: K / mu from {low:g} to {high:g}, even in its logarithm"
    if field in _SHEETS:
        return ASSUMED_SHEET_REL, f"assumed: {ASSUMED_SHEET_REL:.0%} of a sheet"
    value_mm = float(attrgetter(field)(design))
    return PRINT_LIMIT_MM / math.sqrt(3.0) / value_mm, f"assumed: printed to +-{PRINT_LIMIT_MM:g} mm"


@dataclass(frozen=True, slots=True)
class MeshError:
    """What the mesh may make a force wrong by.

    Attributes
    ----------
    excess_rel
        By how much the force exceeds that of an infinitely fine mesh.
    other
        Curve of another mesh, if there is one.
    source
        In words where it is known from; empty where nothing is known.
    """

    excess_rel: float
    other: ForceCurve | None
    source: str

    def at(self, depth: Floats, force: Floats) -> Floats:
        """Return the standard uncertainty, N, at pushes (n,) with the force that the press has there."""
        known = self.excess_rel / (1.0 + self.excess_rel) * force
        return known if self.other is None else np.maximum(known, np.abs(self.other.at(depth) - force))


def mesh_error(press: PressMechanics, other: PressMechanics | None) -> MeshError:
    """Return what is known of the error of a press's mesh, taken for its standard uncertainty.

    F e / (1 + e) with the force F and the excess e of the press's preset on the 70 x 35 finger; |F' - F| where the
    force F' on another mesh differs by more.

    Raises
    ------
    CompareError
        When the other press is of another design, or on the same preset.
    """
    sources = [] if press.mesh_excess_rel is None else ["the mesh's excess on the 70 x 35 finger"]
    curve = None if other is None else _curve_on_other_mesh(press, other)
    if curve is not None:
        sources.append("the other mesh's difference")
    return MeshError(press.mesh_excess_rel or 0.0, curve, " or ".join(sources))


def _curve_on_other_mesh(press: PressMechanics, other: PressMechanics) -> ForceCurve:
    """Return the curve of the same finger on another mesh."""
    own = press.design.model_dump(exclude={"mesh", "provenance", "uncertainty_rel"})
    if own != other.design.model_dump(exclude={"mesh", "provenance", "uncertainty_rel"}):
        raise CompareError(f"{other.name}: is a press of another design; give the same one on another mesh")
    if other.preset == press.preset:
        raise CompareError(f"{other.name}: is on the {other.preset} mesh too; give a press on another one")
    return ForceCurve(other.name, other.depth_mm, other.force_n[:, 1])
