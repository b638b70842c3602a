"""The demo's report: one HTML page with everything inside, the verdict first, readable without scripts."""

from finray_calib.reports import fit_statements, statements, trust
from finray_calib.reports.demo_results import COLOURS, DemoResults, headline, row_of
from finray_calib.reports.demo_sections import sections
from finray_calib.reports.number_text import fixed, percent, probability
from finray_calib.reports.page import render_page
from finray_calib.reports.report_tables import provenance_table
from finray_calib.reports.summary import summary

TEMPLATE = "demo_report.html.j2"


def demo_report(results: DemoResults) -> str:
    """Return the report of one run as a self-contained HTML page.

    Parameters
    ----------
    results
        The six stages of one run.

    Returns
    -------
    str
        HTML text; equal input gives equal text.
    """
    return render_page(
        TEMPLATE,
        decision=results.decision,
        verdict_meaning=statements.verdict_meaning(results.decision),
        key_numbers=_key_numbers(results),
        findings=_findings(results),
        limits=trust.limits(results),
        assumptions=trust.assumptions(results),
        notes=trust.all_notes(results),
        sections=sections(results),
        provenance=provenance_table(results.provenance),
        command=results.command,
        summary=summary(results),
    )


def _key_numbers(results: DemoResults) -> tuple[tuple[str, str, str], ...]:
    """Return (label, value, remark) of the few numbers that stand beside the verdict."""
    decision, report = results.decision, results.report
    claim, skill, floor = decision.statement, report.headline_skill, row_of(headline(report), "floor")
    repeated = "no repeat captured" if floor is None else f"a repeated capture {fixed(floor.skill.estimate, 3)}"
    return (
        ("Light angle", f"{decision.angle_deg:.0f} deg", f"equivalent: {statements.equivalent_text(claim)}"),
        ("True best within 5 deg", probability(claim.p_within_5deg), "probability"),
        ("Expected loss", percent(claim.expected_regret), f"at most {percent(claim.regret_95)} with 95 % probability"),
        (
            "Simulation skill",
            fixed(skill.estimate, 2),
            f"95 %: {fixed(skill.low95, 2)} to {fixed(skill.high95, 2)}; do nothing 0, {repeated}",
        ),
    )


def _findings(results: DemoResults) -> tuple[str, ...]:
    """Return the sentences below the verdict: simulation, each paint, and the truth where it is known."""
    truth = statements.truth_statement(results)
    paints = [fit_statements.paint_sentence(results.paints[colour].fitted) for colour in COLOURS]
    return (statements.simulation_sentence(results.report), *paints, *([] if truth is None else [truth]))
