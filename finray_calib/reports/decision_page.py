"""The page of one decision on the light angle: one HTML file with everything inside, for whoever mounts the light."""

from collections.abc import Mapping

from data_schemas.decide import LightAngleDecision
from data_schemas.provenance import package_version
from data_schemas.simulate import LightAngleSweep
from finray_calib.reports import decision_words as words
from finray_calib.reports.decide_figures import angle_figure
from finray_calib.reports.mounting_figure import mounting_figure
from finray_calib.reports.number_text import percent, probability, signed_percent
from finray_calib.reports.origin_tables import files_table
from finray_calib.reports.other_objectives_figure import other_objectives_figure
from finray_calib.reports.page import render_page
from finray_calib.reports.plain_json import Json, plain
from finray_calib.reports.report_tables import ReportTable, decision_table, one_group
from finray_calib.reports.section import Content, Part, Picture, drawing
from finray_calib.reports.statements import equivalent_text, verdict_meaning

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
        verdict=words.verdict_title(decision),
        sentence=decision.sentence,
        key_numbers=_key_numbers(decision),
        findings=_findings(decision),
        limits=words.limits(decision),
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
        ("Mounting tolerance", words.tolerance_text(claim, angle), f"equivalent: {equivalent_text(claim)}"),
        ("Expected loss", percent(claim.expected_regret), f"at most {percent(claim.regret_95)} with 95 % probability"),
        ("Best angle within 5 deg", probability(claim.p_within_5deg), "probability"),
    )


def _findings(decision: LightAngleDecision) -> tuple[str, ...]:
    """Return the sentences below the verdict: what to do, what to draw, the risk, captures, other objectives."""
    other = words.disagreement_sentence(decision)
    promised = () if decision.at_range_end else (words.mounting_sentence(decision), words.risk_sentence(decision))
    return (
        verdict_meaning(decision),
        *promised,
        words.capture_sentence(decision),
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
    sentence = words.disagreement_sentence(decision) or ""
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
    return Part("What would help most", Content(lead, remarks=words.next_sentences(decision)))


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
