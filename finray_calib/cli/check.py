"""``finray check``: acceptance of a rig, with its hardware in the loop."""

import argparse
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from finray_calib.cli.options import (
    Progress,
    add_out,
    command_line,
    file_name,
    input_digests,
    naming,
    progress_bar,
    require_new,
    say,
    warn,
)

if TYPE_CHECKING:
    from data_schemas.rig import RigFile

HELP = "check a rig with its hardware in the loop (acceptance)"
RUN_HELP = "try every device of a rig and judge it against limits"
RUN_DESCRIPTION = """\
Try every device of a rig: handshakes, moves of the wheel, filters in their slots, dark level, exposure ratios, and how
long the laser stays on after a mishap. Every check has a value, its standard uncertainty, a limit and a verdict: PASS,
FAIL, UNDECIDED, or ERROR when a device broke it off.
Writes a folder with check.json, junit.xml and report.html. The white tile must be in view, the box closed.
Exit status: 0 when nothing failed (also with undecided checks, which are named), 1 after FAIL or ERROR, 2 after a
mistake in plan, rig file or arguments."""
NOT_ACCEPTED = 1


def add_parser(verbs: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Register the verb and what it can do."""
    acts = verbs.add_parser("check", help=HELP, description=HELP).add_subparsers(
        dest="act", metavar="ACT", title="acts", required=True
    )
    parser = acts.add_parser(
        "run", help=RUN_HELP, description=RUN_DESCRIPTION, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "plan", type=Path, metavar="PLAN", help='plan file (TOML): kind = "check", name, region, limits'
    )
    parser.add_argument("--rig", type=Path, required=True, metavar="RIG", help="rig file (TOML): camera, wheel, lights")
    add_out(parser, "NAME-check/")
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Check, store the report and return the exit status."""
    from data_schemas.check import CheckPlan
    from data_schemas.errors import CaptureError
    from data_schemas.product_set import ProductSet
    from data_schemas.provenance import provenance
    from data_schemas.rig import RigFile
    from data_schemas.storage import read_toml, write_record
    from finray_calib.acceptance.acceptance_report import judge
    from finray_calib.acceptance.result_text import result_line
    from finray_calib.cli.interruption import interruptible
    from finray_calib.exchange.junit_xml import junit_xml
    from finray_calib.reports.check_report import check_report
    from rigs.capture.check_session import check_filters, record_facts

    plan, rig = read_toml(arguments.plan, CheckPlan), read_toml(arguments.rig, RigFile)
    out = require_new(arguments.out or Path(f"{file_name(plan.check_name)}-check"))
    with naming(CaptureError, arguments.plan):
        check_filters(plan, rig)
    with interruptible(out), _telling(rig) as progress:
        facts, notes = record_facts(rig, plan, arguments.rig.parent, progress)
    origin = provenance(command_line(), input_digests([arguments.plan, arguments.rig]), plan.seed)
    report = judge(facts, plan, rig, notes).model_copy(update={"provenance": origin})
    with ProductSet(out) as products:
        products.add(out / "junit.xml", junit_xml(report, origin))
        products.add(out / "report.html", check_report(report).encode())
        write_record(report, out / "check.json", origin, products)
    for result in report.results:
        say(result_line(result))
    for note in report.notes:
        say(f"note: {note}")
    say(f"{out}: {report.verdict}; see report.html, junit.xml, check.json")
    return NOT_ACCEPTED if report.verdict in ("FAIL", "ERROR") else 0


@contextmanager
def _telling(rig: "RigFile") -> Iterator[Progress]:
    """Show the progress; on a real rig in lines, below the safety line of its laser."""
    from finray_calib.cli.capture_kinds import safety_lines

    if rig.is_simulated:
        with progress_bar("check") as progress:
            yield progress
        return
    for line in safety_lines(rig.laser):
        warn(line)
    yield lambda done, total, what: warn(f"  {done + 1}/{total} {what}")
