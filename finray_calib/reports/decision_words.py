"""What a decision on the light angle says in plain sentences; every sentence is computed from the record."""

from data_schemas.decide import AngleStatement, LightAngleDecision, OtherObjective
from finray_calib.reports.number_text import percent, probability
from finray_calib.reports.statements import equivalent_text


def verdict_title(decision: LightAngleDecision) -> str:
    """Return the verdict as what to do about the angle."""
    angle = f"{decision.angle_deg:.0f} deg"
    if decision.verdict == "decided":
        return f"Mount the light at {angle}"
    if decision.verdict == "tie":
        return f"Several angles do equally well; take {angle} if nothing speaks against it"
    if decision.verdict == "undecided":
        return f"Not decided yet; {angle} is the best guess so far"
    if not decision.validated:
        return f"{angle} is the best guess of the simulation; a capture has to confirm it"
    return f"{angle} is the best guess; the simulation is not good enough to decide"


def tolerance_text(statement: AngleStatement, angle_deg: float) -> str:
    """Return how far the mounted angle may be off: the equivalent range that holds the chosen angle."""
    for low, high in statement.equivalent_deg:
        if low <= angle_deg <= high and high > low:
            return f"-{angle_deg - low:.0f} / +{high - angle_deg:.0f} deg"
    return "none known"


def mounting_sentence(decision: LightAngleDecision) -> str:
    """Say what to write on the drawing."""
    claim, angle = decision.statement, decision.angle_deg
    if not any(low <= angle <= high and high > low for low, high in claim.equivalent_deg):
        return (
            f"On the drawing: {angle:.0f} deg. No tolerance can be promised: no range of angles is known to lose less "
            f"than {percent(decision.tolerance_rel)} with 95 % probability."
        )
    return (
        f"On the drawing: {angle:.0f} deg, {tolerance_text(claim, angle)}. Inside this tolerance at most "
        f"{percent(decision.tolerance_rel)} of the signal is lost, at each angle with 95 % probability."
    )


def risk_sentence(decision: LightAngleDecision) -> str:
    """Say what may go wrong, in how many cases."""
    claim = decision.statement
    within = ""
    if claim.p_within_tolerance is not None:
        odds = probability(claim.p_within_tolerance)
        within = f" At most {percent(decision.tolerance_rel)} is lost with probability {odds}."
    return (
        f"Risk: on average {percent(claim.expected_regret)} of the signal is lost against the best possible angle, and "
        f"in 19 of 20 cases not more than {percent(claim.regret_95)}.{within} The best angle itself lies within 5 deg "
        f"of {decision.angle_deg:.0f} deg with probability {probability(claim.p_within_5deg)}."
    )


def capture_sentence(decision: LightAngleDecision) -> str:
    """Say whether the simulation was checked against captures, and what that changed."""
    alone, both = decision.statement_simulation_only, decision.statement
    if not decision.validated:
        return validation_sentence(decision)
    count = len(decision.captures)
    part = "One capture is part" if count == 1 else f"{count} captures are part"
    return (
        f"{part} of this decision. By the renders alone it would be {decision.angle_simulation_only_deg:.0f} deg, with "
        f"a loss below {percent(alone.regret_95)} with 95 % probability (equivalent: {equivalent_text(alone)}); with "
        f"captures it is {decision.angle_deg:.0f} deg and {percent(both.regret_95)} ({equivalent_text(both)})."
    )


def validation_sentence(decision: LightAngleDecision) -> str:
    """Say of a decision without captures what it assumes, and what the renders alone would claim."""
    start = "The decision is not validated against a capture"
    if decision.discrepancy_rel is None:
        return f"{start}: it holds only if the simulation is right."
    alone = decision.statement_simulation_only
    return (
        f"{start}. How far the finger differs from the simulation is assumed: "
        f"{percent(decision.discrepancy_rel)}{_range_text(decision)} at each angle. If the simulation were exact, the "
        f"loss would stay below {percent(alone.regret_95)} with 95 % probability."
    )


def _range_text(decision: LightAngleDecision) -> str:
    """Return the interval of the sim-to-real error in brackets, where it is known."""
    if decision.discrepancy_95_rel is None:
        return ""
    low, high = decision.discrepancy_95_rel
    return f" (95 %: {percent(low)} to {percent(high)})"


def discrepancy_sentence(decision: LightAngleDecision) -> str | None:
    """Say how far the simulation may be off at an angle without a capture; None where the record does not say."""
    if decision.discrepancy_rel is None:
        return None
    source = "after what the captures have shown" if decision.validated else "assumed until a capture shows it"
    return (
        f"At an angle without a capture the simulation may be off by {percent(decision.discrepancy_rel)}"
        f"{_range_text(decision)}, as one standard deviation, {source}."
    )


def next_sentences(decision: LightAngleDecision) -> tuple[str, ...]:
    """Say which render and which capture would help most; at the end of a sweep only a wider one would."""
    if decision.at_range_end:
        return (f"Next: simulate a sweep that goes beyond {decision.angle_deg:.0f} deg, and decide again.",)
    told = []
    for what, proposal in (("Next render", decision.next_render), ("Next capture", decision.next_capture)):
        if proposal is None:
            told.append(f"{what}: none is expected to change the decision.")
        else:
            told.append(
                f"{what}: at {proposal.angle_deg:.0f} deg. It may move the chosen angle; expected gain on average: "
                f"{percent(proposal.gain_rel)} of the signal (assumed: an observation is good to "
                f"{percent(proposal.noise_rel)})."
            )
    return tuple(told)


def disagreement_sentence(decision: LightAngleDecision) -> str | None:
    """Say which other objectives would choose differently; None where no other one was looked at."""
    others = decision.other_objectives
    if not others:
        return None
    against = [other for other in others if other.disagrees]
    if not against:
        unsure = sum(other.disagrees is None for other in others)
        doubt = "" if unsure == 0 else f" (of {unsure} the sweep is too noisy to say)"
        return f"No other objective of the sweep is shown to need another angle{doubt}: {_names(others)}."
    told = "; ".join(
        f"{other.name} is best at {other.best_deg:.0f} deg and loses {percent(other.loss_rel)} here"
        for other in against
    )
    return f"The objectives disagree: {told}. Weigh this before the light is mounted."


def _names(others: tuple[OtherObjective, ...]) -> str:
    """Return the names of objectives."""
    return ", ".join(other.name for other in others)


def _others_unknown(decision: LightAngleDecision) -> str:
    """Say that other objectives were not looked at, where that is so."""
    return "" if decision.other_objectives else "Another objective may prefer another angle."


def limits(decision: LightAngleDecision) -> tuple[str, ...]:
    """Return what the decision rests on."""
    return (
        f"The angle is best for one objective: {decision.objective.rstrip('.')}. {_others_unknown(decision)}".strip(),
        "It holds for the place and size of the panel and the mirror of the finger named below; move them and the "
        "angle must be decided anew.",
        *(() if (sentence := discrepancy_sentence(decision)) is None else (sentence,)),
    )
