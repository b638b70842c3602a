"""``finray history``: is a rig still what it was."""

import argparse
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from finray_calib.cli._output import give, look_at, progress_bar, say, wrote
from finray_calib.cli._run import naming, require_new

if TYPE_CHECKING:
    from finray_calib.acceptance import ChartRules, History, SessionFacts

HISTORY_HELP = "chart a rig over its sessions: in control or out of control, and the light each sample received"
HISTORY_DESCRIPTION = """\
Read all paint sessions below a folder and chart, for each rig: level and colour of the lamp, each filter, the laser,
the dark level and its growth (stray light), the sharpness of the white frames; and for each sample: level and centroid
of the emission. The first sessions are the reference (--reference, 10). Later ones are judged by a Shewhart and an EWMA
chart, whose limits keep the stated share of false alarms (--false-alarms, 0.01 of the sessions, all quantities
together) for a reference of that length.

When you have looked into an alarm, give --cleared SESSION: charts begin anew after it, with the same reference. After a
change of the rig (a new lamp), move the older sessions to another folder: the rig then needs a new reference.

The ledger sums the laser light that fell on each sample, and what it took of the emission where that was measured.
Exit status: 0 in control or undecided (too few sessions), 1 out of control, 2 after a mistake."""
OUT_OF_CONTROL = 1
DEPTHS = ("session.json", "*/session.json", "*/*/session.json")


def add_history(verbs: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Register the verb."""
    parser = verbs.add_parser(
        "history", help=HISTORY_HELP, description=HISTORY_DESCRIPTION,
    )  # fmt: skip
    parser.add_argument("folder", type=Path, metavar="DIR", help="folder of session folders")
    parser.add_argument("--reference", type=int, default=10, metavar="N", help="first sessions: what is normal (10)")
    parser.add_argument(
        "--false-alarms", type=float, default=0.01, metavar="SHARE", help="of good sessions that give an alarm (0.01)"
    )
    parser.add_argument("--cleared", metavar="SESSION", help="alarms up to this session were looked into")
    parser.add_argument("--report", type=Path, metavar="PAGE", help="write the charts as a page (HTML); must be new")
    parser.set_defaults(run=run_history)


def run_history(arguments: argparse.Namespace) -> int:
    """Read, chart, print and return the exit status."""
    from data_schemas import FinrayError
    from data_schemas.storage import write_bytes
    from finray_calib.acceptance import session_history
    from finray_calib.reports import history_page

    page = None if arguments.report is None else require_new(arguments.report)
    facts = _facts(arguments.folder)
    with naming(FinrayError, arguments.folder):
        found = session_history(facts, arguments.reference, arguments.false_alarms, arguments.cleared)
    _say_history(found, len(facts))
    if page is not None:
        write_bytes(page, history_page(found, str(arguments.folder), arguments.reference).encode())
        wrote(page, "the charts")
        look_at(page)
    give(verdict=found.verdict, reasons=found.reasons, charts=found.watched, ledger=found.ledger, waiting=found.waiting)
    return OUT_OF_CONTROL if found.verdict == "OUT OF CONTROL" else 0


def _facts(folder: Path) -> "list[SessionFacts]":
    """Reduce the paint sessions below a folder."""
    from data_schemas import CaptureError
    from finray_calib.acceptance import session_facts
    from rigs.capture import read_frame_of, read_session, session_kind

    places = sorted({path.parent for pattern in DEPTHS for path in folder.glob(pattern)})
    paint = [place for place in places if session_kind(place) == "paint"]
    if not paint:
        raise CaptureError(
            f"{folder}: holds no paint session; give a folder whose folders were written by 'finray capture'"
        )
    facts = []
    with progress_bar("history") as progress:
        for number, place in enumerate(paint):
            name = place.relative_to(folder).as_posix()
            progress(number, len(paint), name)
            facts.append(session_facts(name, read_session(place), partial(read_frame_of, place)))
    return facts


def _say_history(found: "History", sessions: int) -> None:
    """Print the verdict, its reasons, every quantity at its last session, and the ledger."""
    say(f"{found.verdict}: {sessions} sessions, {len(found.watched)} charts")
    for reason in found.reasons:
        say(f"  {reason}")
    for waiting in found.waiting:
        say(f"  no chart: {waiting}")
    for name in dict.fromkeys(one.of for one in found.watched):
        say(f"  {name}: mean and sd of the reference, then the newest session")
        for one in (one for one in found.watched if one.of == name):
            chart = one.chart
            last = (chart.values[-1] - chart.mean) / chart.sd
            newest = f"{last:+7.1f} sd" if len(one.sessions) > (chart.rules.reference or 0) else ""
            say(f"    {one.quantity:46s}{chart.mean:10.5g} {chart.sd:9.2g}{newest}")
            if chart.outlier is not None:
                say(f"      note: {one.sessions[chart.outlier]} stands out of the reference; was it good?")
    if found.watched:
        say(f"  limits: {_limit(found.watched[0].chart.rules)}")
    for row in found.ledger:
        lost = "" if row.lost is None else f", which took {100 * row.lost:.2g} % of the emission"
        say(f"  light on '{row.paint_name}': {row.dose_j:.3g} J in {row.sessions} sessions{lost}")
    share, each = 100 * found.false_alarm_share, 100 * found.false_alarm_share_each
    say(f"  false alarms: {share:g} % of good sessions in all, {each:.2g} % a chart")


def _limit(rules: "ChartRules") -> str:
    """Return the limits of both charts."""
    return f"{rules.shewhart_factor:.1f} sd for one session, {rules.ewma_limit_factor:.1f} sd for the weighted mean"
