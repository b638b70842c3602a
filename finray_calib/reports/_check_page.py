"""Pages of an acceptance check (the verdict first, then each check) and of the history of a rig over its sessions."""

from collections import Counter
from collections.abc import Sequence
from typing import Final

import numpy as np
from matplotlib.ticker import MaxNLocator

from data_schemas import AcceptanceReport, CheckResult, CheckVerdict, Section, package_version
from finray_calib.acceptance import GUARD_FACTOR, PRESS_SECTIONS, SECTIONS, ChartedQuantity, History, value_text
from finray_calib.reports._methods import check_methods, methods_part
from finray_calib.reports._page import (
    Content,
    KeyNumber,
    Light,
    Part,
    Picture,
    ReportPage,
    ReportTable,
    TableGroup,
    drawing,
    files_table,
    findings_section,
    light_of,
    limits_section,
    one_group,
    provenance_table,
    report_html,
)
from finray_calib.reports._plain_text import NO_VALUE, fixed, percent, plain
from finray_calib.reports._style import (
    BLUE,
    HAIRLINE,
    MUTED,
    ORANGE,
    VERMILLION,
    ReadableFigure,
    legend_above,
    new_figure,
    readable,
    styled,
    svg_text,
)

_SENTENCES: Final[dict[CheckVerdict, str]] = {
    "PASS": "Every check passed.",
    "UNDECIDED": "No check failed; some could not be decided.",
    "ERROR": "Some checks could not be carried out.",
    "FAIL": "The rig exceeds its limits.",
}
_LIGHTS: Final[dict[str, Light]] = {
    "PASS": "good", "IN CONTROL": "good", "UNDECIDED": "care", "ERROR": "bad", "FAIL": "bad", "OUT OF CONTROL": "bad",
}  # fmt: skip


def check_report(report: AcceptanceReport) -> str:
    """Return the report of an acceptance check as a self-contained HTML page.

    Parameters
    ----------
    report
        The report.
    """
    look = [result for verdict in ("FAIL", "ERROR", "UNDECIDED") for result in report.results
            if result.verdict == verdict]  # fmt: skip
    rule = (
        f"A check passes when its value is inside the limit by at least {GUARD_FACTOR:g} standard uncertainties, fails "
        "when it is outside by at least as much, and is undecided between (JCGM 106, guard band for 95 %)."
    )
    notes = () if not report.notes else (Part("Notes", Content(points=report.notes)),)
    return report_html(
        ReportPage(
            verb="finray check",
            title=f"Rig: {report.rig.name}",
            lead=f"Acceptance check '{report.plan.check_name}': what the devices of this rig did, against the limits "
            "of the plan.",
            verdict=report.verdict,
            light=_LIGHTS[report.verdict],
            sentence=_SENTENCES[report.verdict],
            picture=_checks_picture(report),
            key_numbers=_check_numbers(report),
            parts=(
                *findings_section(f"{result.verdict}: {result.name}: {_short(result)}" for result in look),
                Part("Checks", Content(rule, tables=(_results(report),))),
                Part("Devices", Content(tables=(_devices(report),), parts=notes)),
                methods_part(check_methods(GUARD_FACTOR), report.provenance),
            ),
            origin=None if report.provenance is None else provenance_table(report.provenance),
            command="" if report.provenance is None else report.provenance.command,
            summary=report.model_dump(mode="json", include={"verdict", "results", "notes"}),
        )
    )


def _check_numbers(report: AcceptanceReport) -> tuple[KeyNumber, ...]:
    """Return how many checks passed, how many did not, and how many could not be decided."""
    count, total = Counter(result.verdict for result in report.results), len(report.results)
    broken, unsure = count["FAIL"] + count["ERROR"], count["UNDECIDED"]
    return (
        KeyNumber("Passed", f"{count['PASS']} of {total}", "inside the limit with 95 % confidence",
                  light_of(count["PASS"] == total), "all of them" if count["PASS"] == total else "not all"),
        KeyNumber("Failed or ended early", str(broken),
                  f"{count['FAIL']} outside the limit with 95 % confidence, {count['ERROR']} with a device's error",
                  light_of(broken == 0, is_bad=broken > 0), "some" if broken else "none"),
        KeyNumber("Undecided", str(unsure), "too close to the limit, or not visible on this rig",
                  light_of(unsure == 0), "some" if unsure else "none"),
    )  # fmt: skip


def _checks_picture(report: AcceptanceReport) -> Picture:
    """Show every check as a mark in the row of its section."""
    told = "; ".join(
        f"{verdict.lower()}: {', '.join(names)}"
        for verdict in ("FAIL", "ERROR", "UNDECIDED")
        if (names := [result.name for result in report.results if result.verdict == verdict])
    )
    return drawing(
        checks_figure(report.results),
        f"Every check as a mark in the row of its section. {told or 'All passed'}.",
        "One mark for each check, in the row of its section. What to see: every mark that is not a filled circle "
        "needs attention.",
    )


_MARKS: Final[dict[CheckVerdict, tuple[str, str]]] = {
    "PASS": ("o", BLUE), "UNDECIDED": ("D", ORANGE), "ERROR": ("s", MUTED), "FAIL": ("X", VERMILLION),
}  # fmt: skip


@styled()
def checks_figure(results: Sequence[CheckResult]) -> str:
    """Draw the verdict of every check, section by section."""
    titles = section_titles(results)
    rows = [title for section, title in titles.items() if any(result.section == section for result in results)]
    figure = new_figure(4.8, 0.3 * len(rows) + 0.9)
    axes = figure.subplots()
    for verdict, (marker, colour) in _MARKS.items():
        seen: Counter[str] = Counter()
        places = []
        for result in results:
            row = titles[result.section]
            seen[row] += 1
            if result.verdict == verdict:
                places.append((seen[row], rows.index(row)))
        if places:
            across, down = zip(*places, strict=True)
            axes.plot(across, down, marker, color=colour, markersize=9, label=f"{verdict.lower()}: {len(places)}")
    axes.set(ylim=(len(rows) - 0.5, -0.5), xlim=(0.4, None))
    axes.set_yticks(range(len(rows)), rows)
    axes.set_xticks([])
    axes.grid(visible=False)
    axes.spines[["left", "bottom"]].set_visible(False)
    axes.tick_params(length=0)
    legend_above(figure, axes, 4)
    return svg_text(figure)


def section_titles(results: Sequence[CheckResult]) -> dict[Section, str]:
    """Return the parts of the check that results come from, in their order."""
    presses = any(result.section in PRESS_SECTIONS and result.section not in SECTIONS for result in results)
    return PRESS_SECTIONS if presses else SECTIONS


def _short(result: CheckResult) -> str:
    """Return value, limit and evidence of a check that asks for attention."""
    value = value_text(result)
    words = (value, f"allowed: {result.limit}" if value and result.limit else "", result.evidence)
    return "; ".join(word for word in words if word)


def _results(report: AcceptanceReport) -> ReportTable:
    """List every check, grouped as it was done."""
    groups = []
    for section, title in section_titles(report.results).items():
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
        keys = ("address", "vendor", "model", "serial", "firmware")
        words = () if said is None else tuple(getattr(said, key, "") for key in keys)
        rows.append((hand.role, hand.driver, *(word or "\N{EN DASH}" for word in words or ("",) * 5)))
    columns = ("device", "driver", "address", "vendor", "model", "serial", "firmware")
    return one_group("What the devices report about themselves", columns, rows, is_words=True)


_HISTORY_SENTENCES: Final = {
    "IN CONTROL": "No chart alarmed after the reference.",
    "OUT OF CONTROL": "A chart alarmed, or a session could not be reduced. Find the cause before you measure again.",
    "UNDECIDED": "There is no chart with more sessions than its reference yet.",
}
MOST_FINDINGS: Final = 12


def history_page(history: History, folder: str, reference: int) -> str:
    """Return the history of a folder of sessions as a self-contained HTML page.

    Parameters
    ----------
    history
        Charts, ledger and verdict.
    folder
        Name of the folder.
    reference
        Sessions of the reference.
    """
    groups = dict.fromkeys(one.of for one in history.watched)
    newest = history.newest_utc or NO_VALUE
    alarms = sum(len({alarm.place for alarm in one.chart.alarms}) for one in history.watched)
    key_numbers = (
        KeyNumber("Alarms", f"{alarms} in {len(history.watched)} charts",
                  f"cleared alarms included; reference: the first {reference} sessions",
                  _LIGHTS[history.verdict], history.verdict.lower()),
        KeyNumber("Newest session", newest[:10], newest[11:19]),
        KeyNumber("False alarms", percent(history.false_alarm_share), "share of good sessions, all charts together"),
    )  # fmt: skip
    alarmed = sorted(history.watched, key=lambda one: not one.chart.alarms)
    return report_html(
        ReportPage(
            verb="finray history",
            title=folder,
            lead="How the rig and its samples were in every session, compared with the first sessions.",
            verdict=history.verdict,
            light=_LIGHTS[history.verdict],
            sentence=_HISTORY_SENTENCES[history.verdict],
            picture=_picture(alarmed[0]) if alarmed else None,
            key_numbers=key_numbers,
            parts=(
                *findings_section(_findings(history)),
                limits_section(_limits(history, reference)),
                *(_charts(name, history) for name in groups),
                _ledger(history),
            ),
            command=f"finray history {folder} --reference {reference} --report PAGE",
            origin=files_table({}, package_version()),
            summary=plain({"verdict": history.verdict, "reasons": history.reasons, "series": [
                {"of": one.of, "quantity": one.quantity, "sessions": one.sessions, "values": one.chart.values}
                for one in history.watched
            ]}),
        )
    )  # fmt: skip


def _findings(history: History) -> tuple[str, ...]:
    """Return the newest reasons, and what waits for more sessions."""
    older = len(history.reasons) - MOST_FINDINGS
    told = history.reasons[-MOST_FINDINGS:]
    return (*((f"earlier findings that are not listed: {older}",) if older > 0 else ()), *told, *history.waiting)


def _limits(history: History, reference: int) -> tuple[str, ...]:
    """Say what the charts rest on."""
    outliers = [
        f"{session} differs from the rest of the reference ({', '.join(quantities)}): if it was not a good session, "
        "the limits are too wide."
        for session, quantities in history.outliers.items()
    ]
    return (
        f"The limits give {100 * history.false_alarm_share_each:.2g} % false alarms for each chart and session, with "
        f"mean and standard deviation estimated from {reference} sessions. That holds for sessions that are "
        "independent and normally distributed.",
        "A fault that the reference sessions already have is not found, because they define what is normal.",
        "A chart shows that something changed, but not what: lamp, filter and white tile change the same signals.",
        "A change that a chart shows may be too small to matter: compare it with the uncertainty that you state.",
        *outliers,
    )


def _charts(name: str, history: History) -> Part:
    """Show the quantities of one rig or sample."""
    shown = [one for one in history.watched if one.of == name]
    pictures = tuple(_picture(one) for one in shown)
    rows = tuple(pictures[i : i + 3] for i in range(0, len(pictures), 3))
    lead = (
        "Difference from the mean of the reference (hollow marks). Dashed: limits of one session (Shewhart). Grey line "
        "and band: weighted mean and its limits (EWMA). Crosses: alarms."
    )
    return Part(name, Content(lead=lead, picture_rows=rows, tables=(_table(shown),), has_wide_tables=True))


def _picture(one: ChartedQuantity) -> Picture:
    """Return the chart of one quantity."""
    alarms = sorted({alarm.place for alarm in one.chart.alarms})
    text = "no alarm" if not alarms else f"alarms at {', '.join(one.sessions[i] for i in alarms[:5])}"
    caption = f"{one.quantity}: {text}"
    return drawing(chart_figure(one), f"{caption}, of {len(one.sessions)} sessions", caption, is_small=True)


@styled()
def chart_figure(one: ChartedQuantity) -> ReadableFigure:
    """Draw one quantity over its sessions, with limits and alarms."""
    chart, count = one.chart, one.chart.rules.reference or 0
    figure = new_figure(3.6, 2.3)
    axes = figure.subplots()
    place = np.arange(1, chart.values.size + 1)
    apart, weighted = chart.values - chart.mean, chart.weighted - chart.mean
    single, mean = (chart.sd * limit for limit in (chart.rules.shewhart_factor, chart.rules.ewma_limit_factor))
    axes.axhspan(-mean, mean, facecolor=HAIRLINE, alpha=0.6, linewidth=0)
    for limit in (-single, single):
        axes.axhline(limit, color=MUTED, linestyle="--", linewidth=0.9)
    axes.axhline(0.0, color=MUTED, linewidth=0.8)
    axes.plot(place[count:], weighted[count:], color=MUTED, linewidth=1.2)
    axes.plot(place[:count], apart[:count], "o", color=BLUE, markerfacecolor="none", markersize=3.5)
    axes.plot(place[count:], apart[count:], "o-", color=BLUE, markersize=3.5, linewidth=0.8)
    alarms = sorted({alarm.place for alarm in chart.alarms})
    axes.plot(place[alarms], apart[alarms], "x", color=VERMILLION, markersize=8, markeredgewidth=2)
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.set(xlabel="session", title=one.quantity)
    axes.title.set_fontsize(9)
    return readable(figure, axes, chart_readings(one))


def chart_readings(one: ChartedQuantity) -> dict[float, str]:
    """Return in words, by the number of the session, its value and how far it is from the reference."""
    chart, alarmed = one.chart, {alarm.place for alarm in one.chart.alarms}
    return {
        k + 1.0: f"session {k + 1}, {session}: {one.told(value)}, {(value - chart.mean) / chart.sd:+.1f} sd from the "
        f"reference{'; alarm' if k in alarmed else ''}"
        for k, (session, value) in enumerate(zip(one.sessions, chart.values, strict=True))
    }


def _table(shown: Sequence[ChartedQuantity]) -> ReportTable:
    """List mean and standard deviation of the reference, limits, and the last session."""
    rows = []
    for one in shown:
        chart = one.chart
        last = (chart.values[-1] - chart.mean) / chart.sd
        rows.append((
            one.quantity, one.told_mean(), f"{chart.sd:.2g}", f"{chart.rules.shewhart_factor:.2f} sd",
            f"{chart.rules.ewma_limit_factor:.2f} sd", f"{fixed(last, 1)} sd",
            str(len({alarm.place for alarm in chart.alarms})),
        ))  # fmt: skip
    columns = ("quantity", "mean", "sd", "limit, one session", "limit, weighted mean", "last session", "alarms")
    return one_group("Reference, limits and the last session", columns, rows)


def _ledger(history: History) -> Part:
    """List the light on each sample."""
    rows = []
    for row in history.ledger:
        fading = NO_VALUE
        if row.fading_per_j is not None and row.fading_sd_per_j is not None:
            fading = f"{100 * row.fading_per_j:.2g} \u00b1 {100 * row.fading_sd_per_j:.1g} %"
        lost = "not resolved" if row.lost is None else percent(row.lost)
        rows.append((row.paint_name, str(row.sessions), f"{row.dose_j:.3g} J", fading, lost))
    table = one_group(
        "Laser light on each sample, summed over its sessions",
        ("sample", "sessions", "dose", "loss per joule", "emission lost so far"),
        rows,
    )
    lead = (
        "The dose counts all laser light while the sample was in view, as each session recorded it; light outside of "
        "sessions is not in it. Samples are distinguished by the name of the paint in their plans."
    )
    return Part("Light on the samples", Content(lead=lead, tables=(table,)))
