"""What is uncertain in a simulated force: constants and dimensions of the design, as stated or by named defaults."""

import math
from dataclasses import dataclass
from operator import attrgetter
from typing import Final

import numpy as np
from numpy.typing import NDArray

from data_schemas.design import FingerDesign
from data_schemas.press_mechanics import PressMechanics
from finray_calib.compare.force_curve import log_sensitivity

Floats = NDArray[np.float64]

# an elastomer's or plastic's modulus from the literature, for another batch, cure and rate
ASSUMED_MODULUS_REL: Final = 0.2
# K / mu is measured for hardly any silicone; a factor of 1.6 either way is nu = 0.46 to 0.48
ASSUMED_BULK_REL: Final = 0.5
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
            *(() if varied else ("materials and dimensions: simulate with --only mechanics --sensitivities",)),
        ),
    )


def _uncertainty(design: FingerDesign, field: str) -> tuple[float, str]:
    """Return the relative standard uncertainty of a field, and where it is from."""
    if field in design.uncertainty_rel:
        return design.uncertainty_rel[field], "stated by the design"
    if field.endswith("_mpa"):
        return ASSUMED_MODULUS_REL, f"assumed: {ASSUMED_MODULUS_REL:.0%} of a modulus"
    if field.endswith("bulk_over_shear"):
        return ASSUMED_BULK_REL, f"assumed: {ASSUMED_BULK_REL:.0%} of K / mu"
    if field in _SHEETS:
        return ASSUMED_SHEET_REL, f"assumed: {ASSUMED_SHEET_REL:.0%} of a sheet"
    value_mm = float(attrgetter(field)(design))
    return PRINT_LIMIT_MM / math.sqrt(3.0) / value_mm, f"assumed: printed to +-{PRINT_LIMIT_MM:g} mm"
