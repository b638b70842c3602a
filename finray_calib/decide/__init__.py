"""Decide on a light angle from sweeps at the touched places: the loss at each, the odds, and the most useful capture.

The objective's curve f over the angle is a random curve through the renders of one place, the real one f exp(p - t):
p is a draw of the paints and t the sim-to-real error learnt from captures (its prior without any). An angle's value is
the mean over the places, or the least, of the curve over its greatest value there. Joint draws give the probability
that another angle is better and by how much; the verdict, the sentences and the next capture that helps most follow.
`rank_by_draws` ranks other choices, such as paints, by draws that belong to each other. `fit_chaos`, `sobol_indices`
and the limits say how far inputs may vary, and which of them matter.
"""

from typing import TYPE_CHECKING

from data_schemas import lazy_exports

if TYPE_CHECKING:
    from finray_calib.decide._decision_record import decide
    from finray_calib.decide._design_emulator import (
        DesignEmulator,
        best_design,
        emulator_ensemble,
        fit_emulator,
        joint_draws,
        next_design,
        screening_designs,
    )
    from finray_calib.decide._design_optimum import (
        DesignSearch,
        PairedRanking,
        design_optimum,
        losses,
        paint_choice,
        rank_by_draws,
    )
    from finray_calib.decide._light_angle import AngleDecision, SweptContact, decide_angle, decide_contacts
    from finray_calib.decide._light_powers import (
        LightBasis,
        OptimalPowers,
        PoweredLight,
        PowerLimits,
        UniformPowers,
        error_change,
        even_powers,
        light_powers,
        most_uniform_powers,
    )
    from finray_calib.decide._tolerances import (
        ChaosEmulator,
        Estimates,
        Limit,
        SobolIndices,
        fit_chaos,
        limit_of_curve,
        limit_together,
        share_within,
        sobol_indices,
    )
else:
    __getattr__ = lazy_exports(__name__, __file__)

__all__ = [
    "AngleDecision",
    "ChaosEmulator",
    "DesignEmulator",
    "DesignSearch",
    "Estimates",
    "LightBasis",
    "Limit",
    "OptimalPowers",
    "PairedRanking",
    "PowerLimits",
    "PoweredLight",
    "SobolIndices",
    "SweptContact",
    "UniformPowers",
    "best_design",
    "decide",
    "decide_angle",
    "decide_contacts",
    "design_optimum",
    "emulator_ensemble",
    "error_change",
    "even_powers",
    "fit_chaos",
    "fit_emulator",
    "joint_draws",
    "light_powers",
    "limit_of_curve",
    "limit_together",
    "losses",
    "most_uniform_powers",
    "next_design",
    "paint_choice",
    "rank_by_draws",
    "screening_designs",
    "share_within",
    "sobol_indices",
]
