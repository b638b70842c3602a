"""The light-angle decision as one sentence that an engineer can act on."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from finray_calib.decide.angle_risk import CONFIDENCE, NEARBY_DEG, AngleRisk, Verdict
from finray_calib.decide.light_angle import AngleDecision
from finray_calib.decide.other_objectives import OtherOptimum
from finray_calib.decide.proposals import Proposal

_CONSEQUENCE: dict[Verdict, str] = {
    "tie": "a tie, any of these angles will do",
    "undecided": "undecided, more renders are needed",
    "model-limited": "the sim-to-real error exceeds the advantage, so more renders will not decide",
}
_UNPROVEN = "not decided, only captures can tell how far the finger differs from the simulation"


def decision_sentence(
    decision: AngleDecision,
    captures_deg: NDArray[np.float64],
    tolerance_rel: float,
    next_render: Proposal | None = None,
    next_capture: Proposal | None = None,
    others: Sequence[OtherOptimum] = (),
) -> str:
    """Return a decision in plain English with its numbers, with captures and without, and what to do next.

    Parameters
    ----------
    decision : AngleDecision
    captures_deg : ndarray, shape (N,)
        Angles of the captures in it; none: not validated.
    tolerance_rel : float
        Relative loss that does not matter.
    next_render, next_capture : Proposal, optional
        Said where the verdict asks for it.
    others : sequence of OtherOptimum
        Other objectives; those that disagree are named.

    Returns
    -------
    str
    """
    parts = [*_claim(decision.best_deg, decision.risk, tolerance_rel)]
    if decision.at_range_end:
        parts.append("the best angle is at the end of the sweep, so the optimum may lie outside it: widen the sweep")
    elif decision.verdict == "model-limited" and not decision.validated:
        parts.append(_UNPROVEN)
    elif decision.verdict in _CONSEQUENCE:
        parts.append(_CONSEQUENCE[decision.verdict])
    parts += _captures(decision, captures_deg)
    # inside a sweep that is too narrow no render helps
    if next_render is not None and decision.verdict == "undecided" and not decision.at_range_end:
        parts.append(f"next: render {next_render.angle_deg:.0f} deg")
    if next_capture is not None and (decision.verdict == "model-limited" or not len(captures_deg)):
        parts.append(f"next: capture at {next_capture.angle_deg:.0f} deg")
    parts += [
        f"{other.name} would choose {other.best_deg:.0f} deg and loses {_percent(other.loss_rel)} here"
        for other in others
        if other.disagrees
    ]
    return "; ".join(parts) + "."


def _claim(best_deg: float, risk: AngleRisk, tolerance_rel: float) -> tuple[str, ...]:
    """Return angle, probabilities, loss and equivalent angles."""
    intervals = " and ".join(f"{low:.0f}-{high:.0f} deg" for low, high in risk.equivalent_deg)
    return (
        f"{best_deg:.0f} deg: within {_percent(tolerance_rel)} of the best with probability "
        f"{risk.p_within_tolerance:.2f}, true optimum within {NEARBY_DEG:.0f} deg with {risk.p_within_5deg:.2f}",
        f"expected loss {_percent(risk.expected_regret_rel)}, at most {_percent(risk.regret_95_rel)} with "
        f"{_percent(CONFIDENCE)} probability",
        f"{intervals} are equivalent within {_percent(tolerance_rel)}"
        if intervals
        else f"no angle is within {_percent(tolerance_rel)} of the best with {_percent(CONFIDENCE)} probability",
    )


def _captures(decision: AngleDecision, captures_deg: NDArray[np.float64]) -> tuple[str, ...]:
    """Return what captures changed, or what is assumed because there are none."""
    low_rel, amplitude_rel, high_rel = decision.discrepancy.amplitude_quantiles_rel
    alone = _percent(decision.simulation_only.regret_95_rel)
    if not len(captures_deg):
        return (
            f"not validated against a capture, a sim-to-real error of {_percent(amplitude_rel)} (95 %: "
            f"{_percent(low_rel)} to {_percent(high_rel)}) is assumed; if the simulation were exact, at most {alone}",
        )
    angles = [f"{angle:.0f}" for angle in sorted(set(captures_deg.tolist()))]
    listed = " and ".join([*([", ".join(angles[:-1])] if len(angles) > 1 else []), angles[-1]])
    number = "a capture" if len(captures_deg) == 1 else f"{len(captures_deg)} captures"
    return (
        f"{number} at {listed} deg included, with a sim-to-real error of {_percent(amplitude_rel)}",
        f"by simulation alone {decision.best_simulation_only_deg:.0f} deg, at most {alone}",
    )


def _percent(fraction: float) -> str:
    """Return a fraction as per cent with two significant digits."""
    return f"{float(f'{100 * fraction:.2g}'):g} %"
