"""The page of one decision on the light angle, for whoever mounts the light: one HTML file with everything inside.

What the decision says stands in plain sentences; every sentence is computed from the record.
"""

from collections.abc import Mapping

from data_schemas import AngleStatement, LightAngleDecision, LightAngleSweep, OtherObjective, package_version
from finray_calib.reports._decision_figures import angle_figure, mounting_figure, other_objectives_figure
from finray_calib.reports._page import Content, Part, Picture, ReportTable, drawing, files_table, one_group, render_page
from finray_calib.reports._plain_text import Json, percent, plain, probability, signed_percent

TEMPLATE = "result_page.html.j2"


def decision_page(
    decision: LightAngleDecision, sweep: LightAngleSweep, command: str, digests: Mapping[str, str]
) -> str:
    """Return the page of a decision as self-contained HTML; equal input gives equal text.

    Parameters
    ----------
    decision
        The decision.
    sweep
        What it was made from.
    command
        The command that reproduces it.
    digests
        Name of each input file -> SHA-256.
    """
    return render_page(
        TEMPLATE,
        verb="finray decide",
        title=f"Angle of the blue light: {sweep.design.name}",
        lead="At which angle to mount the light of the finger, how exactly, and what may be lost.",
        verdict=verdict_title(decision),
        sentence=decision.sentence,
        key_numbers=_key_numbers(decision),
        findings=_findings(decision),
        limits=limits(decision),
        notes=(*decision.notes, *(note for note in sweep.notes if note not in decision.notes)),
        sections=tuple(_sections(decision, sweep)),
        command=command,
        files=files_table(digests, package_version()),
        summary=_summary(decision, sweep, command, digests),
    )


def _key_numbers(decision: LightAngleDecision) -> tuple[tuple[str, str, str], ...]:
    """Return (label, value, remark) of the few numbers that stand beside the verdict."""
    claim, angle = decision.statement, decision.angle_deg
    if decision.at_range_end:
        return (("Light angle", f"{angle:.0f} deg", "end of the sweep: no tolerance can be promised"),)
    return (
        ("Light angle", f"{angle:.0f} deg", decision.verdict),
        ("Mounting tolerance", tolerance_text(claim, angle), f"equivalent: {equivalent_text(claim)}"),
        ("Expected loss", percent(claim.expected_regret), f"at most {percent(claim.regret_95)} with 95 % probability"),
        ("Best angle within 5 deg", probability(claim.p_within_5deg), "probability"),
    )


def _findings(decision: LightAngleDecision) -> tuple[str, ...]:
    """Return the sentences below the verdict: what to do, what to draw, the risk, captures, other objectives."""
    other = disagreement_sentence(decision)
    promised = () if decision.at_range_end else (mounting_sentence(decision), risk_sentence(decision))
    return (
        decision_meaning(decision),
        *promised,
        capture_sentence(decision),
        *(() if other is None else (other,)),
    )


def _sections(decision: LightAngleDecision, sweep: LightAngleSweep) -> list[Part]:
    """Return curve, numbers, other objectives where there are any, proposals and origin."""
    parts = [_curve(decision, sweep), _claims(decision)]
    if decision.other_objectives:
        parts.append(_others(decision, sweep))
    return [*parts, _next(decision), _sweep(sweep)]


def _curve(decision: LightAngleDecision, sweep: LightAngleSweep) -> Part:
    """Show the objective over the angle."""
    picture = drawing(
        angle_figure(decision, sweep, None),
        f"The objective over the light angle is best near {decision.angle_deg:.0f} deg. {decision.sentence}",
        "Objective over the angle of the light. What to see: where the curve is flat the angle matters little; hatched "
        f"angles lose at most {percent(decision.tolerance_rel)}. The wider the bands, the less is known.",
    )
    lead = (
        f"Objective: {decision.objective.rstrip('.')}. It was rendered at {len(sweep.angles_deg)} angles with "
        f"{sweep.values.shape[1]} repeats that share their random draws; a smooth random curve through them gives the "
        "probability of each angle."
    )
    return Part("Curve and mounting", Content(lead, ((picture, _mounting(decision, sweep)),)))


def _mounting(decision: LightAngleDecision, sweep: LightAngleSweep) -> Picture:
    """Show what the angle means on the finger."""
    return drawing(
        mounting_figure(decision, sweep.design),
        f"Side view of pad and light panel: the panel shines at {decision.angle_deg:.0f} deg from the pad's plane. "
        f"Equivalent: {equivalent_text(decision.statement)}.",
        "What the angle means, from the side and to scale: between the pad's plane and the direction in which the "
        "panel shines. Hatched: equivalent angles.",
    )


def _claims(decision: LightAngleDecision) -> Part:
    """Show the numbers with and without captures."""
    lead = "What is claimed with all that is known, beside what the renders alone would claim."
    tables = [decision_table(decision)]
    if decision.captures:
        tables.append(_captures_table(decision))
    return Part("Numbers", Content(lead, tables=tuple(tables)))


def _captures_table(decision: LightAngleDecision) -> ReportTable:
    """List the captures that entered."""
    rows = (
        (
            capture.captured,
            f"{capture.light_angle_deg:g} \u00b1 {capture.light_angle_uncertainty_deg:.2g} deg",
            signed_percent(capture.error_rel),
            percent(capture.error_u_rel),
        )
        for capture in decision.captures
    )
    columns = ("capture", "light at", "simulation too bright by", "standard uncertainty")
    return one_group("Captures in this decision", columns, rows, is_words=True)


def _others(decision: LightAngleDecision, sweep: LightAngleSweep) -> Part:
    """Show what the angle costs under the other objectives."""
    sentence = disagreement_sentence(decision) or ""
    picture = drawing(
        other_objectives_figure(decision, sweep),
        f"The other objectives over the light angle. {sentence}",
        "Every objective relative to its best rendered angle, so that 1 is best for each. What to see: an objective "
        "that is far below 1 at the chosen angle pays for the choice. Crossed out: angles that clip or do not fit.",
    )
    told = {True: "yes", False: "no", None: "cannot be told"}
    rows = (
        (
            other.name,
            f"{other.best_deg:.0f} deg",
            f"{percent(other.loss_rel)} [{percent(other.loss_90_rel[0])}, {percent(other.loss_90_rel[1])}]",
            told[other.disagrees],
        )
        for other in decision.other_objectives
    )
    columns = ("objective", "best at", "loss at the chosen angle [90 %]", "needs another angle")
    table = one_group("Other objectives of the sweep", columns, rows, is_words=True)
    meanings = tuple(f"{o.name}: {o.meaning.rstrip('.')} ({o.unit})." for o in sweep.other_objectives)
    return Part("Other objectives", Content(sentence, ((picture,),), meanings, (table,)))


def _next(decision: LightAngleDecision) -> Part:
    """Show what to do next."""
    lead = "What to add if a smaller risk is wanted: the one render and the one capture that are expected to help most."
    return Part("What would help most", Content(lead, remarks=next_sentences(decision)))


def _sweep(sweep: LightAngleSweep) -> Part:
    """Show what was rendered."""
    lead = "What was rendered. The decision holds for this finger, with its light and its mirror, and these points."
    return Part("What was decided on", Content(lead, tables=(_sweep_table(sweep),)))


def _sweep_table(sweep: LightAngleSweep) -> ReportTable:
    """List finger, light, angles and paints of a sweep."""
    design, light = sweep.design, sweep.design.light
    stored = "not stored before" if sweep.provenance is None else sweep.provenance.created_utc
    rows = [
        ("sweep", f"{sweep.name}: {sweep.label}"),
        ("stored (UTC)", stored),
        ("finger", design.name),
        ("angles", f"{', '.join(f'{angle:g}' for angle in sweep.angles_deg)} deg"),
        ("repeats", str(sweep.values.shape[1])),
        ("light panel", f"{light.width_mm:g} x {light.height_mm:g} mm, {light.peak_wavelength_nm:g} nm"),
        ("panel sits at", f"x, y, z = {', '.join(f'{p:g}' for p in light.position_mm)} mm"),
        ("mirror", f"reflects {percent(design.mirror.reflectance)}, radius {design.mirror.radius_mm:g} mm"),
        ("points looked at", str(len(sweep.probe_points_mm))),
    ]
    rows += [(f"{colour} paint", f"SHA-256 {digest}") for colour, digest in sorted(sweep.paints.items())]
    return one_group("Sweep of the light angle", ("item", "value"), rows, is_words=True)


def _summary(decision: LightAngleDecision, sweep: LightAngleSweep, command: str, digests: Mapping[str, str]) -> Json:
    """Return every number of the page."""
    numbers: Json = plain(
        {
            "decision": decision.model_dump(mode="json", exclude={"provenance"}),
            "sweep": {"name": sweep.name, "angles_deg": sweep.angles_deg, "values": sweep.values},
            "command": command,
            "input_sha256": dict(digests),
            "package_version": package_version(),
        }
    )
    return numbers


def decision_table(decision: LightAngleDecision) -> ReportTable:
    """List what is claimed of the real finger, beside what the renders alone would claim."""
    claims = {"renders alone": decision.statement_simulation_only}
    angle = f"Light at {decision.angle_deg:.0f} deg"
    if decision.validated:
        claims = {"with captures": decision.statement, **claims}
    else:
        angle += ", not validated against a capture"
        if decision.discrepancy_rel is not None:
            claims = {"with the assumed sim-to-real error": decision.statement, **claims}
    shown = claims.values()
    tolerance = percent(decision.tolerance_rel)
    rows: list[tuple[str, ...]] = [
        (f"loss within {tolerance}, probability", *(_known_probability(s.p_within_tolerance) for s in shown)),
        ("true optimum within 5 deg, probability", *(probability(s.p_within_5deg) for s in shown)),
        ("expected loss", *(percent(s.expected_regret) for s in shown)),
        ("loss not exceeded with 95 % probability", *(percent(s.regret_95) for s in shown)),
        (f"angles equivalent within {tolerance}", *(equivalent_text(s) for s in shown)),
    ]
    return one_group(angle, ("claim", *claims), rows, is_words=True)


def _known_probability(value: float | None) -> str:
    """Return a probability; records of older versions hold none."""
    return "not stored" if value is None else probability(value)


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


def decision_meaning(decision: LightAngleDecision) -> str:
    """Say what the verdict tells a designer to do."""
    tolerance, angle = percent(decision.tolerance_rel), f"{decision.angle_deg:.0f} deg"
    alone_angle = f"{decision.angle_simulation_only_deg:.0f} deg"
    loss, alone = percent(decision.statement.regret_95), percent(decision.statement_simulation_only.regret_95)
    if decision.at_range_end:
        return (
            f"The best angle found, {angle}, is at the end of the sweep. The optimum may lie outside the sweep: widen "
            "it. Until then no tolerance can be promised, and a loss is one against the angles of this sweep only."
        )
    if decision.verdict == "decided":
        return (
            f"Mount the light at {angle}: the loss against the best angle stays within {tolerance} with 95 % "
            f"probability, and only angles nearby do as well ({equivalent_text(decision.statement)})."
        )
    if decision.verdict == "tie":
        return (
            f"Any of these angles will do: {equivalent_text(decision.statement)}. Each loses at most {tolerance} "
            "against the best angle with 95 % probability; take the one that is easiest to build."
        )
    if decision.verdict == "undecided":
        moved = f" With captures the best guess is {angle}." if decision.validated else ""
        return (
            f"The renders alone do not yet show a choice that loses at most {tolerance}: {alone_angle} is their best "
            f"guess so far, and may lose {alone}.{moved} More angles or more repeats would help."
        )
    if not decision.validated:
        return (
            f"By the renders alone {alone_angle} loses at most {alone}, but no capture has shown how far the finger "
            f"differs from the simulation. With what is assumed until one does, {angle} is the best guess and may lose "
            f"{loss}. More renders will not help; a capture would."
        )
    return (
        f"By the renders alone {alone_angle} loses at most {alone}; with the difference between simulation and capture "
        f"{angle} is the best guess and may lose {loss}, more than the {tolerance} that count as equal. More renders "
        "will not help; a better model or more captures would."
    )


def equivalent_text(statement: AngleStatement) -> str:
    """Return the equivalent angles as ranges in deg."""
    ranges = [
        f"{low:.0f} to {high:.0f} deg" if high > low else f"{low:.0f} deg" for low, high in statement.equivalent_deg
    ]
    return ", ".join(ranges) or "none"


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
        return decision_validation(decision)
    count = len(decision.captures)
    part = "One capture is part" if count == 1 else f"{count} captures are part"
    return (
        f"{part} of this decision. By the renders alone it would be {decision.angle_simulation_only_deg:.0f} deg, with "
        f"a loss below {percent(alone.regret_95)} with 95 % probability (equivalent: {equivalent_text(alone)}); with "
        f"captures it is {decision.angle_deg:.0f} deg and {percent(both.regret_95)} ({equivalent_text(both)})."
    )


def decision_validation(decision: LightAngleDecision) -> str:
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
