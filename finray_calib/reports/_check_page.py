"""The page of an acceptance check: the verdict first, then every check with value, limit and evidence."""

from collections import Counter
from typing import Final

from data_schemas import AcceptanceReport, CheckResult, CheckVerdict
from finray_calib.acceptance import GUARD_FACTOR, SECTIONS, value_text
from finray_calib.reports._page import ReportTable, TableGroup, one_group, provenance_table, render_page

TEMPLATE: Final = "check_report.html.j2"
_SENTENCES: Final[dict[CheckVerdict, str]] = {
    "PASS": "Every check passed.",
    "UNDECIDED": "No check failed; some could not be decided.",
    "ERROR": "Some checks could not be carried out.",
    "FAIL": "The rig does not keep its limits.",
}
_COUNTED: Final[tuple[tuple[CheckVerdict, str, str], ...]] = (
    ("PASS", "Passed", "inside the limit with 95 % confidence"),
    ("FAIL", "Failed", "outside it with 95 % confidence"),
    ("UNDECIDED", "Undecided", "too close to tell, or not to be seen here"),
    ("ERROR", "Errors", "a device broke the check off"),
)


def check_report(report: AcceptanceReport) -> str:
    """Return the report of an acceptance check as a self-contained HTML page.

    Parameters
    ----------
    report
        The report.
    """
    count = Counter(result.verdict for result in report.results)
    look = [result for verdict in ("FAIL", "ERROR", "UNDECIDED") for result in report.results
            if result.verdict == verdict]  # fmt: skip
    return render_page(
        TEMPLATE,
        rig_name=report.rig.name,
        check_name=report.plan.check_name,
        verdict=report.verdict,
        sentence=_SENTENCES[report.verdict],
        key_numbers=[(label, str(count[verdict]), remark) for verdict, label, remark in _COUNTED],
        findings=[f"{result.verdict}: {result.name}: {_short(result)}" for result in look],
        rule=(
            f"A check passes when value and {GUARD_FACTOR:g} standard uncertainties lie inside its limit, fails when "
            "they lie outside, and is undecided between (JCGM 106, guard band for 95 %)."
        ),
        notes=report.notes,
        results=_results(report),
        devices=_devices(report),
        provenance=None if report.provenance is None else provenance_table(report.provenance),
        summary=report.model_dump(mode="json", include={"verdict", "results", "notes"}),
    )


def _short(result: CheckResult) -> str:
    """Return value, limit and evidence of a check that asks for attention."""
    value = value_text(result)
    words = (value, f"allowed: {result.limit}" if value and result.limit else "", result.evidence)
    return "; ".join(word for word in words if word)


def _results(report: AcceptanceReport) -> ReportTable:
    """List every check, grouped as it was done."""
    groups = []
    for section, title in SECTIONS.items():
        rows = tuple(
            (
                result.name,
                result.verdict,
                value_text(result) or "\N{EN DASH}",
                result.limit or "\N{EN DASH}",
                f"{result.what}; {result.evidence}",
            )
            for result in report.results
            if result.section == section
        )
        if rows:
            groups.append(TableGroup(title, rows))
    columns = ("check", "verdict", "value and standard uncertainty", "allowed", "what it is, and evidence")
    return ReportTable("All checks", columns, tuple(groups), is_words=True)


def _devices(report: AcceptanceReport) -> ReportTable:
    """List what the devices say they are."""
    rows = []
    for hand in report.facts.handshakes:
        said = hand.identity
        words = () if said is None else (said.address, said.vendor, said.model, said.serial, said.firmware)
        rows.append((hand.role, hand.driver, *(word or "\N{EN DASH}" for word in words or ("",) * 5)))
    columns = ("device", "driver", "address", "vendor", "model", "serial", "firmware")
    return one_group("What the devices say they are", columns, rows, is_words=True)
