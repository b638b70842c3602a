"""The page of one decision on the light angle, for whoever mounts the light: one HTML file with everything inside.

What the decision says stands in plain sentences; every sentence is computed from the record.
"""

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from data_schemas import (
    AngleProposal,
    AngleStatement,
    DecidedContact,
    LightAngleDecision,
    LightAngleSweep,
    OtherObjective,
    package_version,
)
from finray_calib.reports._decision_figures import (
    angle_figure,
    contacts_figure,
    mounting_figure,
    other_objectives_figure,
)
from finray_calib.reports._methods import decision_methods, methods_part
from finray_calib.reports._page import (
    Content,
    KeyNumber,
    Light,
    Part,
    Picture,
    ReportPage,
    ReportTable,
    drawing,
    files_table,
    light_of,
    limits_section,
    one_group,
    report_html,
)
from finray_calib.reports._plain_text import Json, percent, plain, probability, signed_percent

Floats = NDArray[np.float64]
#: Whether it is decided, and what follows.
VERDICTS: Final = {
    "decided": ("decided", "only nearby angles are equally good"),
    "tie": ("decided", "neighbouring angles are equally good"),
    "undecided": ("not decided", "more renders are needed"),
    "needs captures": ("not decided", "captures are needed"),
}


def decision_page(
    decision: LightAngleDecision, sweeps: Sequence[LightAngleSweep], command: str, digests: Mapping[str, str]
) -> str:
    """Return the page of a decision as self-contained HTML; equal input gives equal text.

    Parameters
    ----------
    decision
        The decision.
    sweeps
        What it was made from, one of each touch.
    command
        The command that reproduces it.
    digests
        Name of each input file -> SHA-256.
    """
    sweep = sweeps[0]
    told = dict.fromkeys(note for swept in sweeps for note in swept.notes)
    return report_html(
        ReportPage(
            verb="finray decide",
            title=f"Angle of the blue light: {sweep.design.name}",
            verdict=verdict_sentence(decision),
            light=verdict_light(decision),
            picture=mounting_picture(decision, sweep),
            key_numbers=decision_numbers(decision),
            parts=(
                *_opening(decision),
                limits_section(limits(decision), (*decision.notes, *(n for n in told if n not in decision.notes))),
                *_sections(decision, sweeps),
                methods_part(decision_methods(decision, sweep), decision.provenance),
            ),
            command=command,
            origin=files_table(digests, package_version()),
            summary=_summary(decision, sweeps, command, digests),
        )
    )


def verdict_light(decision: LightAngleDecision) -> Light:
    """Return the light of a decision: good where it is decided, and not at the end of its sweep."""
    return light_of(VERDICTS[decision.verdict][0] == "decided" and not decision.at_range_end)


def decision_numbers(decision: LightAngleDecision) -> tuple[KeyNumber, ...]:
    """Return the few numbers that stand beside the verdict: whether it holds, how exactly, and what may be lost."""
    claim, angle = decision.statement, decision.angle_deg
    if decision.at_range_end:
        told = "end of the sweep: no tolerance can be stated"
        return (KeyNumber("Light angle", f"{angle:.0f} deg", told, "bad", "the optimum may lie outside the sweep"),)
    tolerance, side = percent(decision.tolerance_rel), mounting_range(decision)
    light, (what, why) = verdict_light(decision), VERDICTS[decision.verdict]
    decided = KeyNumber("The angle is", what, f"{angle:.0f} deg", light, why)
    loss = light_of(claim.regret_95 <= decision.tolerance_rel, is_bad=claim.expected_regret > decision.tolerance_rel)
    limit = f"the {tolerance} that count as equal"
    reasons = {"good": f"below {limit}", "care": f"it may exceed {limit}", "bad": f"the expected loss exceeds {limit}"}
    most = KeyNumber(
        "Another angle may be better",
        f"by {percent(claim.expected_regret)}",
        f"{_loss_of(decision)}; at most {percent(claim.regret_95)} with 95 % probability",
        loss,
        reasons[loss],
    )
    if side is not None:
        return (decided, KeyNumber("Mount it between", side, f"is expected to cost at most {tolerance} more"), most)
    if claim.p_within_tolerance is None:
        return (decided, most)
    odds = light_of(claim.p_within_tolerance >= _SURE, is_bad=claim.p_within_tolerance < _EVEN)
    within, needed = probability(claim.p_within_tolerance), f"a decision needs {_SURE:g}"
    return (decided, KeyNumber(f"None better by more than {tolerance}", within, "probability", odds, needed), most)


_SURE, _EVEN = 0.95, 0.5


def _loss_of(decision: LightAngleDecision) -> str:
    """Say of what the expected loss is a share, and over what it is averaged."""
    value = "inverse error of the normal" if decision.aim == "normal" else "brightness"
    many, worst = len(decision.contacts) > 1, decision.criterion == "worst"
    over = [] if decision.discrepancy_rel is None else [", averaged over the possible errors of the simulation"]
    return f"of the {value}{'' if not many else ' at the worst place' if worst else ' over all places'}{''.join(over)}"


def verdict_sentence(decision: LightAngleDecision) -> str:
    """Return the first sentence of the decision; of a record of an older version, what its verdict asks you to do."""
    return decision.headline or verdict_title(decision)


def verdict_words(decision: LightAngleDecision) -> str:
    """Return the verdict in words, such as "not decided: captures are needed"."""
    return ": ".join(VERDICTS[decision.verdict])


def mounting_range(decision: LightAngleDecision) -> str | None:
    """Return between which angles the light may be mounted; None at the end of a sweep and in older records."""
    if decision.tolerance_deg is None or decision.at_range_end:
        return None
    low, high = decision.tolerance_deg
    return f"{low:.0f} and {high:.0f} deg"


def _opening(decision: LightAngleDecision) -> list[Part]:
    """Return the map of places and angles where there are several, and why."""
    rest = decision.sentence.removeprefix(decision.headline).strip()
    why = Content(rest if decision.headline else decision_meaning(decision), remarks=_reasons(decision, rest))
    places = [places_part(decision)] if len(decision.contacts) > 1 else []
    return [*places, Part("Why, and how sure it is", why)]


def _reasons(decision: LightAngleDecision, rest: str) -> tuple[str, ...]:
    """Return the sentences below the reason; older records do not tell risk and captures in their own."""
    other, choice = disagreement_sentence(decision), criterion_sentence(decision)
    older: tuple[str, ...] = ()
    if not decision.headline:
        promised = () if decision.at_range_end else (mounting_sentence(decision), risk_sentence(decision))
        older = (rest, *promised, capture_sentence(decision), *(() if other is None else (other,)))
    elif decision.validated:
        older = (capture_sentence(decision),)
    return (*older, *(() if choice is None else (choice,)))


def lost_rel(decision: LightAngleDecision, loss_rel: Floats) -> Floats:
    """Return losses of brightness as they are, of the inverse error of the normal as how much larger the error is."""
    return loss_rel if decision.aim == "brightness" else np.asarray(1.0 / (1.0 - loss_rel) - 1.0)


def lost(decision: LightAngleDecision, loss_rel: float) -> str:
    """Return a loss in words, see :func:`lost_rel`."""
    return percent(float(lost_rel(decision, np.array(loss_rel))))


def criterion_sentence(decision: LightAngleDecision) -> str | None:
    """Say what the other way to weigh the touches would choose, and what that costs; None for one touch."""
    value, average_deg, worst_deg = decision.contact_value, decision.angle_average_deg, decision.angle_worst_deg
    if len(decision.contacts) < 2 or value is None or average_deg is None or worst_deg is None:
        return None
    weights = [contact.weight_share for contact in decision.contacts]
    kind = "a loss of" if decision.aim == "brightness" else "an error larger by"

    def told(angle_deg: float) -> str:
        at = int(np.abs(decision.grid_deg - angle_deg).argmin())
        losses = lost_rel(decision, np.maximum(1.0 - value[:, at], 0.0))
        return f"{kind} {percent(float(losses @ weights))} on average and {percent(float(losses.max()))} at most"

    chosen = "on average" if decision.criterion == "average" else "at the worst place"
    return (
        f"Best on average is {average_deg:.0f} deg: {told(average_deg)}. Best at the worst place is {worst_deg:.0f} "
        f"deg: {told(worst_deg)}. The best {chosen} was chosen: the criterion is '{decision.criterion}'."
    )


def places_part(decision: LightAngleDecision) -> Part:
    """Show what each place loses at each angle."""
    worst = max(decision.contacts, key=lambda contact: contact.loss_rel)
    what = "less bright a touch is" if decision.aim == "brightness" else "larger the error of the sensed normal is"
    picture = drawing(
        contacts_figure(decision),
        f"How much {what} than at its best, over place and angle. At {decision.angle_deg:.0f} deg the most is lost at "
        f"{worst.position_mm:g} mm from the base: {lost(decision, worst.loss_rel)}.",
        f"Over place and angle: how much {what} than at the best angle for that place (expected value). Dots: the best "
        "angle of each place; dashed line: the chosen angle. What to see: light colours mean little loss. Look whether "
        "one angle is light for all places.",
    )
    rows = (
        (
            touch_text(contact, decision.contacts),
            percent(contact.weight_share),
            f"{contact.best_deg:.0f} deg",
            lost(decision, contact.loss_rel),
            lost(decision, contact.loss_95_rel),
        )
        for contact in decision.contacts
    )
    name, lose = ("touch", "less bright by") if decision.aim == "brightness" else ("place", "error larger by")
    columns = (name, "weight", "its own best angle", f"{lose}, expected value", f"{lose}, 95 % bound")
    table = one_group(f"Each {name}, with the light at {decision.angle_deg:.0f} deg", columns, rows, is_words=True)
    lead = "Every place has a best angle of its own, but there is one light for all of them."
    return Part("What each place loses", Content(lead, ((picture,),), tables=(table,)))


def _sections(decision: LightAngleDecision, sweeps: Sequence[LightAngleSweep]) -> list[Part]:
    """Return curve, numbers, other objectives where there are any, proposals and origin."""
    parts = [_curve(decision, sweeps), _claims(decision)]
    if decision.other_objectives:
        parts.append(_others(decision, next((sweep for sweep in sweeps if sweep.other_objectives), sweeps[0])))
    # captures tell of the brightness: with another aim none is proposed
    proposals = [_next(decision)] if decision.aim == "brightness" else []
    return [*parts, *proposals, _sweep(sweeps)]


def _curve(decision: LightAngleDecision, sweeps: Sequence[LightAngleSweep]) -> Part:
    """Show the objective over the angle."""
    several = len(decision.contacts) > 1
    what = "The objective"
    if several:
        what = "The brightness of all touches" if decision.aim == "brightness" else "The inverse error of the normal"
    certain = bool(decision.statement.equivalent_deg)
    hatched = f"; hatched angles lose at most {percent(decision.tolerance_rel)}" if certain else ""
    picture = drawing(
        angle_figure(decision, sweeps[0]),
        f"{what}, plotted against the light angle; the best angle is near {decision.angle_deg:.0f} deg. "
        f"{decision.headline or decision.sentence}",
        f"{what}, plotted against the light angle. What to see: where the curve is flat the angle matters "
        f"little{hatched}. The wider the bands, the less is known.",
    )
    lead = (
        f"Objective: {decision.objective.rstrip('.')}. It was rendered at {len(sweeps[0].angles_deg)} angles with "
        "repeats that share their random draws; smooth and rough random curves through them, also with a kink or a "
        "cusp, give the probability of each angle."
    )
    return Part("Curve over the angle", Content(lead, ((picture,),)))


def mounting_picture(decision: LightAngleDecision, sweep: LightAngleSweep) -> Picture:
    """Show what the angle means on the finger."""
    between = mounting_range(decision)
    marks = "where it was touched" if decision.aim == "brightness" else "the places that were looked at"
    hatched = (
        ""
        if between is None
        else f" Hatched: angles between {between} cost at most {percent(decision.tolerance_rel)} more."
    )
    return drawing(
        mounting_figure(decision, sweep.design),
        f"Side view of the finger with its light panel, which shines at {decision.angle_deg:.0f} deg from the pad's "
        f"plane.{hatched}",
        f"The finger from the side, to scale. The angle of the light (light.angle_deg of the design): 0 deg along the "
        f"pad towards the tip, 90 deg straight into it. Marks on the pad: {marks}.{hatched}",
    )


def _claims(decision: LightAngleDecision) -> Part:
    """Show the numbers with and without captures."""
    lead = "What the decision claims with all available information, and what the renders alone would claim."
    tables = [decision_table(decision)]
    if decision.captures:
        tables.append(_captures_table(decision))
    return Part("Numbers", Content(lead, tables=tuple(tables)))


def touch_text(contact: DecidedContact, contacts: Sequence[DecidedContact]) -> str:
    """Return what tells a touch from the others."""
    parts = [f"{contact.position_mm:g} mm"]
    if len({other.across_mm for other in contacts}) > 1:
        parts.append(f"{contact.across_mm:g} mm across")
    if len({other.depth_mm for other in contacts}) > 1:
        parts.append(f"{contact.depth_mm:g} mm deep")
    if len({other.shape for other in contacts}) > 1:
        parts.append(contact.shape)
    return ", ".join(parts)


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
    """Show what the other objectives would have chosen, what that costs, and what the angle costs under them."""
    sentence = disagreement_sentence(decision) or ""
    picture = drawing(
        other_objectives_figure(decision, sweep),
        f"The other objectives, plotted against the light angle. {sentence}",
        "Every objective relative to its best rendered angle, so that 1 is best for each. What to see: an "
        "objective that is far below 1 at the chosen angle is made worse by this choice. Crossed out: angles "
        "that clip or do not fit.",
    )
    told = {True: "yes", False: "no", None: "cannot be told"}
    rows = (
        (
            other.name,
            f"{other.best_deg:.0f} deg",
            "not stored" if other.cost_rel is None else lost(decision, other.cost_rel),
            f"{percent(other.loss_rel)} [{percent(other.loss_90_rel[0])}, {percent(other.loss_90_rel[1])}]",
            told[other.disagrees],
        )
        for other in decision.other_objectives
    )
    cost = "touch less bright there by" if decision.aim == "brightness" else "error of the normal larger there by"
    columns = ("objective", "would have chosen", cost, "its own loss here [90 %]", "needs another angle")
    table = one_group("Objectives side by side", columns, rows, is_words=True)
    meanings = tuple(f"{o.name}: {o.meaning.rstrip('.')} ({o.unit})." for o in sweep.other_objectives)
    return Part("What other objectives would have chosen", Content(sentence, ((picture,),), meanings, tables=(table,)))


def _next(decision: LightAngleDecision) -> Part:
    """Show what to do next."""
    lead = "What to add if a smaller risk is wanted."
    return Part("What would help most", Content(lead, remarks=next_sentences(decision)))


def _sweep(sweeps: Sequence[LightAngleSweep]) -> Part:
    """Show what was rendered."""
    lead = "What was rendered. The decision holds for this finger, with its light and its mirror, and these touches."
    return Part("What was decided on", Content(lead, tables=(_sweep_table(sweeps),)))


def _sweep_table(sweeps: Sequence[LightAngleSweep]) -> ReportTable:
    """List finger, light, angles and paints of the sweeps."""
    sweep = sweeps[0]
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
        ("sweeps, one for each touch", str(len(sweeps))),
        ("points evaluated in each", str(len(sweep.probe_points_mm))),
    ]
    rows += [(f"{colour} paint", f"SHA-256 {digest}") for colour, digest in sorted(sweep.paints.items())]
    return one_group("Sweep of the light angle", ("item", "value"), rows, is_words=True)


def _summary(
    decision: LightAngleDecision, sweeps: Sequence[LightAngleSweep], command: str, digests: Mapping[str, str]
) -> Json:
    """Return every number of the page."""
    numbers: Json = plain(
        {
            "decision": decision.model_dump(mode="json", exclude={"provenance"}),
            "sweeps": [
                {
                    "name": sweep.name,
                    "position_mm": sweep.design.indenter.position_mm,
                    "angles_deg": sweep.angles_deg,
                    "values": sweep.values,
                }
                for sweep in sweeps
            ],
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
        (f"angles that lose at most {tolerance}, with 95 % probability", *(equivalent_text(s) for s in shown)),
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
        return f"Several angles are equally good; take {angle} unless you have a reason for another"
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
            "the sweep. Until then no tolerance can be stated, and a loss is relative to the angles of this sweep only."
        )
    if decision.verdict == "decided":
        return (
            f"Mount the light at {angle}: the loss against the best angle stays within {tolerance} with 95 % "
            f"probability, and only nearby angles are equally good ({equivalent_text(decision.statement)})."
        )
    if decision.verdict == "tie":
        return (
            f"Any of these angles is suitable: {equivalent_text(decision.statement)}. Each loses at most {tolerance} "
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
            f"differs from the simulation. With the difference that is assumed until then, {angle} is the best guess "
            f"and may lose {loss}. More renders will not help; a capture would."
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


def _equivalent(statement: AngleStatement) -> str:
    """Return in words which angles are known to lose no more than the tolerance."""
    return f"within the tolerance: {equivalent_text(statement) if statement.equivalent_deg else 'no angle'}"


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
            f"On the drawing: {angle:.0f} deg. No tolerance can be stated: no range of angles is known to lose less "
            f"than {percent(decision.tolerance_rel)} with 95 % probability."
        )
    return (
        f"On the drawing: {angle:.0f} deg, {tolerance_text(claim, angle)}. At each angle inside this tolerance at "
        f"most {percent(decision.tolerance_rel)} of the signal is lost, with 95 % probability."
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
        f"{part} of this decision. By renders alone the angle would be {decision.angle_simulation_only_deg:.0f} deg "
        f"and the loss {_up_to(alone.regret_95)} (95 % probability; {_equivalent(alone)}); with captures the angle is "
        f"{decision.angle_deg:.0f} deg and the loss {_up_to(both.regret_95)} (95 % probability; {_equivalent(both)})."
    )


def decision_validation(decision: LightAngleDecision) -> str:
    """Say of a decision without captures what it assumes, and what the renders alone would claim."""
    start = "The decision is not validated against a capture"
    if decision.discrepancy_rel is None:
        return f"{start}: it holds only if the simulation is correct."
    alone = decision.statement_simulation_only
    return (
        f"{start}. How far the finger differs from the simulation is assumed: "
        f"{percent(decision.discrepancy_rel)}{_range_text(decision)} at each angle. If the simulation were exact, the "
        f"loss would stay {_up_to(alone.regret_95)} with 95 % probability."
    )


def _up_to(loss_rel: float) -> str:
    """Return a limit of a loss; what rounds to nothing says "below" of itself."""
    return f"below {percent(loss_rel).removeprefix('below ')}"


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
    source = "as the captures show" if decision.validated else "assumed until a capture measures it"
    return (
        f"At an angle without a capture the simulation may be off by {percent(decision.discrepancy_rel)}"
        f"{_range_text(decision)}, as one standard deviation, {source}."
    )


def next_sentences(decision: LightAngleDecision) -> tuple[str, ...]:
    """Say which render and which capture would help most; at the end of a sweep only a wider one would."""
    if decision.at_range_end:
        return (f"Next: simulate a sweep that goes beyond {decision.angle_deg:.0f} deg, and decide again.",)
    told = []
    if decision.next_render is not None or len(decision.contacts) < 2:  # over several places none is looked for
        told.append(_next_sentence(decision, "render", decision.next_render))
    if decision.next_capture is None and decision.aim == "normal":
        told.append(
            "Next capture: none is proposed. Captures show only the brightness, so a decision with reports on captures "
            "is by the brightness, not by the error of the normal."
        )
    elif decision.next_capture is None and decision.verdict == "needs captures":
        told.append(
            "Next capture: no single capture is expected to change the angle. Several captures, at places and angles "
            "that have none yet, would make the possible loss more certain."
        )
    else:
        told.append(_next_sentence(decision, "capture", decision.next_capture))
    return tuple(told)


def _next_sentence(decision: LightAngleDecision, what: str, proposal: AngleProposal | None) -> str:
    """Say which render or capture would help most, and how much."""
    if proposal is None:
        return f"Next {what}: none is expected to change the decision."
    return (
        f"Next {what}: at {proposal.angle_deg:g} deg{_place(decision, proposal)}. It may move the chosen angle; "
        f"expected gain on average: {percent(proposal.gain_rel)} of the signal (assumed uncertainty of the {what}: "
        f"{percent(proposal.noise_rel)})."
    )


def _place(decision: LightAngleDecision, proposal: AngleProposal) -> str:
    """Return where to touch the finger, where there is more than one place."""
    if len(decision.contacts) < 2 or proposal.position_mm is None:
        return ""
    return f", {proposal.position_mm:g} mm from the base"


def disagreement_sentence(decision: LightAngleDecision) -> str | None:
    """Say which other objectives would choose differently; None where no other one was looked at."""
    others = decision.other_objectives
    if not others:
        return None
    against = [other for other in others if other.disagrees]
    if not against:
        unsure = sum(other.disagrees is None for other in others)
        doubt = "" if unsure == 0 else f" (for {unsure} the sweep is too noisy to decide this)"
        return f"No other objective of the sweep is shown to need another angle{doubt}: {_names(others)}."
    told = "; ".join(
        f"{other.name} is best at {other.best_deg:.0f} deg and loses {percent(other.loss_rel)} here"
        + _cost(decision, other)
        for other in against
    )
    return f"The objectives disagree: {told}. Weigh this before the light is mounted."


def _cost(decision: LightAngleDecision, other: OtherObjective) -> str:
    """Return what the best angle of another objective costs the one that was decided on."""
    if other.cost_rel is None:
        return ""
    larger = "less brightness" if decision.aim == "brightness" else "larger error of the normal"
    return f" (there: {lost(decision, other.cost_rel)} {larger})"


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
        "The decision holds for the panel and the mirror of the finger named below, at their present place and size; "
        "if one of these changes, decide again.",
        *(() if (sentence := discrepancy_sentence(decision)) is None else (sentence,)),
    )
