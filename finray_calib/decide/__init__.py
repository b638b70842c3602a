"""Decide on a light angle from a sweep: probability, regret and the set of equivalent angles.

The objective's curve f over the angle is a Gaussian process through the renders, the real one f exp(-t), with the
sim-to-real error t learnt from captures (its prior without any). Joint draws give the probability that the optimum is
near the chosen angle and the relative regret (max f - f(best)) / max f; the verdict, the sentence and the next render
or capture that helps most follow from them.
"""

from typing import TYPE_CHECKING

from data_schemas import lazy_exports

if TYPE_CHECKING:
    from finray_calib.decide._decision_record import decide
    from finray_calib.decide._light_angle import AngleDecision, decide_angle
else:
    __getattr__ = lazy_exports(__name__, __file__)

__all__ = ["AngleDecision", "decide", "decide_angle"]
