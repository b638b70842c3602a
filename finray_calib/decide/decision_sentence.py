"""The light-angle decision as one sentence that an engineer can act on."""

from finray_calib.decide.angle_risk import CONFIDENCE, NEARBY_DEG, AngleRisk, Verdict

_CONSEQUENCE: dict[Verdict, str] = {
    "tie": "a tie, any of these angles will do",
    "undecided": "undecided, more renders are needed",
    "model-limited": "the sim-to-real error exceeds the advantage, so more renders will not decide",
}


def decision_sentence(
    best_deg: float,
    risk: AngleRisk,
    verdict: Verdict,
    at_range_end: bool,
    tolerance_rel: float,
    discrepancy_rel: float | None,
) -> str:
    """Return a decision in plain English with its numbers.

    Parameters
    ----------
    best_deg : float
        Chosen angle.
    risk : AngleRisk
        The risk that the verdict rests on.
    verdict : str
    at_range_end : bool
        Whether the chosen angle is the first or last of the sweep.
    tolerance_rel : float
        Relative loss that does not matter.
    discrepancy_rel : float or None
        Relative sim-to-real error included in the risk; None if there was no capture to compare with.

    Returns
    -------
    str
    """
    parts = [
        f"{best_deg:.0f} deg: true optimum within {NEARBY_DEG:.0f} deg with probability {risk.p_within_5deg:.2f}",
        f"expected loss {_percent(risk.expected_regret_rel)}, at most {_percent(risk.regret_95_rel)} with "
        f"{_percent(CONFIDENCE)} probability",
    ]
    intervals = " and ".join(f"{low:.0f}-{high:.0f} deg" for low, high in risk.equivalent_deg)
    if intervals:
        parts.append(f"{intervals} are equivalent within {_percent(tolerance_rel)}")
    else:
        parts.append(
            f"no angle is within {_percent(tolerance_rel)} of the best with {_percent(CONFIDENCE)} probability"
        )
    if at_range_end:
        parts.append("the best angle is at the end of the sweep, so the optimum may lie outside it: widen the sweep")
    elif verdict in _CONSEQUENCE:
        parts.append(_CONSEQUENCE[verdict])
    if discrepancy_rel is None:
        parts.append("not validated against a capture")
    else:
        parts.append(f"a sim-to-real error of {_percent(discrepancy_rel)} is included")
    return "; ".join(parts) + "."


def _percent(fraction: float) -> str:
    """Return a fraction as per cent with two significant digits."""
    return f"{float(f'{100 * fraction:.2g}'):g} %"
