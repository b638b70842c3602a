"""``finray check``, ``history`` and ``certificate``: what is certified of rigs and paints.

Acceptance of a rig, gauge R&R, two tins of a paint, drift over sessions, and the certificate of a paint.
"""

import argparse
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from finray_calib.cli._capture import plan_kind
from finray_calib.cli._output import Progress, give, guide, progress_bar, say, suggest_file, warn, wrote
from finray_calib.cli._run import (
    add_out,
    command_line,
    file_name,
    input_digests,
    interruptible,
    naming,
    number_within,
    require_new,
    whole_number,
)

if TYPE_CHECKING:
    from data_schemas import AcceptanceReport, CaptureSession, PaintCalibration, RigFile, TactileRig
    from finray_calib.acceptance import CertifiedResult, ChartRules, ComparedQuantity, GaugeStudy, History, SessionFacts
    from finray_calib.fit import BudgetRow
    from finray_calib.lineage import Traced

CHECK_HELP = "check a rig with its hardware in the loop (acceptance), or compare two tins of a paint"
CHECK_RUN_HELP = "try every device of a rig and judge the results against limits"
CHECK_RUN_DESCRIPTION = """\
Try every device of a rig: handshakes, moves of the wheel, filters in their slots, shift of the picture, dark level,
exposure ratios, warm-up, stray light, trigger latency, and how long the laser stays on after a fault. Every check has
a value, its standard uncertainty, a limit and a verdict: PASS, FAIL, UNDECIDED, or ERROR if a device failed during it.
Writes a folder with check.json, junit.xml and report.html. The white tile must be in view, and the box closed.

A plan of kind "tactile check" tries a rig whose stage presses: noise, drift and zero of the load cell, moves of the
stage, the position of the touch over many returns, play, and whether the stage stops on request, at a force, and when
the load cell sends nothing. The stage moves after you have typed yes.

Exit status: 0 when nothing failed (also with undecided checks, which are named), 1 after FAIL or ERROR, 2 after a
mistake in plan, rig file or arguments."""
NOT_ACCEPTED = 1
KINDS = ("check", "tactile check")


def add_check(verbs: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Register the verb and what it can do."""
    acts = verbs.add_parser("check", help=CHECK_HELP, description=CHECK_HELP).add_subparsers(
        dest="act", metavar="ACT", title="acts", required=True
    )
    parser = acts.add_parser(
        "run",
        help=CHECK_RUN_HELP,
        description=CHECK_RUN_DESCRIPTION,
    )
    parser.add_argument(
        "plan", type=Path, metavar="PLAN", help='plan file (TOML): kind = "check" or "tactile check", name, limits'
    )
    parser.add_argument(
        "--rig", type=Path, required=True, metavar="RIG", help="rig file (TOML) that fits the kind of the plan"
    )
    add_out(parser, "NAME-check/")
    parser.set_defaults(run=run_check)
    add_gauge_rr(acts)
    add_equivalence(acts)


def run_check(arguments: argparse.Namespace) -> int:
    """Check, store the report and return the exit status."""
    from data_schemas import provenance
    from data_schemas.storage import ProductSet, write_record
    from finray_calib.acceptance import result_line
    from finray_calib.exchange import junit_xml
    from finray_calib.reports import check_report

    check = _press_check if plan_kind(arguments.plan, KINDS) == "tactile check" else _paint_check
    report, out = check(arguments)
    seed = report.plan.seed if report.plan.kind == "check" else None
    origin = provenance(command_line(), input_digests([arguments.plan, arguments.rig]), seed)
    report = report.model_copy(update={"provenance": origin})
    with ProductSet(out) as products:
        products.add(out / "junit.xml", junit_xml(report, origin))
        products.add(out / "report.html", check_report(report).encode())
        write_record(report, out / "check.json", origin, products)
    for result in report.results:
        say(result_line(result))
    for note in report.notes:
        say(f"note: {note}")
    give(verdict=report.verdict, results=report.results, notes=report.notes)
    wrote(out, f"{report.verdict}; holds report.html, junit.xml and check.json")
    suggest_file(out / "report.html")
    return NOT_ACCEPTED if report.verdict in ("FAIL", "ERROR") else 0


def _paint_check(arguments: argparse.Namespace) -> "tuple[AcceptanceReport, Path]":
    """Check camera, wheel and lights, and return the report with the folder that it belongs in."""
    from data_schemas import CaptureError, CheckPlan, RigFile
    from data_schemas.storage import read_toml
    from finray_calib.acceptance import judge
    from rigs.capture import check_filters, record_facts

    plan, rig = read_toml(arguments.plan, CheckPlan), read_toml(arguments.rig, RigFile)
    out = require_new(arguments.out or Path(f"{file_name(plan.check_name)}-check"))
    with naming(CaptureError, arguments.plan):
        check_filters(plan, rig)
    with interruptible(out), _telling(rig) as progress:
        facts, notes = record_facts(rig, plan, arguments.rig.parent, progress)
    return judge(facts, plan, rig, notes), out


def _press_check(arguments: argparse.Namespace) -> "tuple[AcceptanceReport, Path]":
    """Check stage, load cell and camera, and return the report with the folder that it belongs in."""
    from data_schemas import CaptureError, TactileCheckPlan, TactileRig
    from data_schemas.storage import read_toml
    from finray_calib.acceptance import judge_pressing
    from rigs.capture import check_press_plan, record_press_facts

    plan, rig = read_toml(arguments.plan, TactileCheckPlan), read_toml(arguments.rig, TactileRig)
    out = require_new(arguments.out or Path(f"{file_name(plan.check_name)}-check"))
    with naming(CaptureError, arguments.plan):
        check_press_plan(plan, rig, arguments.rig.parent)
    with interruptible(out), _telling_of_parts(rig) as progress:
        facts = record_press_facts(rig, plan, arguments.rig.parent, progress)
    return judge_pressing(facts, plan, rig), out


@contextmanager
def _telling_of_parts(rig: "TactileRig") -> Iterator[Progress]:
    """Show the progress; on a real rig in lines, below what must be known before the stage moves."""
    if rig.is_simulated:
        with progress_bar("check") as progress:
            yield progress
        return
    guide("The stage will move and press. Keep your hands away, and the power switch of its motors within reach.")
    yield lambda done, total, what: guide(f"  {done + 1}/{total} {what}")


@contextmanager
def _telling(rig: "RigFile") -> Iterator[Progress]:
    """Show the progress; on a real rig in lines, below the safety line of its laser."""
    if rig.is_simulated:
        with progress_bar("check") as progress:
            yield progress
        return
    from rigs.light_guard import safety_lines

    for line in safety_lines(rig.laser):
        guide(line)
    yield lambda done, total, what: guide(f"  {done + 1}/{total} {what}")


GAUGE_HELP = "gauge R&R: how much of the scatter comes from the measurement"
GAUGE_DESCRIPTION = """\
Analyse a gauge study: several samples, each measured in the same sessions, with repeats and, optionally, mounted again
within a session. Take five samples or more, as different as those that you will measure, and six sessions or more:
with three sessions, the interval of the measurement's standard deviation spans a factor of five.

STUDY is a CSV file with one row for each capture, with equal numbers for each sample and session:

  sample,session,mount,paint
  A,1,1,A-1-1a.paint.json
  A,1,1,A-1-1b.paint.json

where "paint" is the calibration of the capture (a path relative to the CSV file; --quantity names the quantity), or
with a column "value" in place of "paint". Leave out the column "mount" where the samples were not mounted again.
PASS: the measurement's share of the total standard deviation is below 10 % with 95 % confidence; FAIL: above 30 %.
Exit status: 0, 1 after FAIL, 2 after a mistake."""
QUANTITIES = ("mode_nm", "fwhm_nm", "peak_per_nm", "energy_yield", "reflectance_at_laser")


def add_gauge_rr(acts: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Register what ``finray check gauge-rr`` takes."""
    parser = acts.add_parser("gauge-rr", help=GAUGE_HELP, description=GAUGE_DESCRIPTION)
    parser.add_argument("study", type=Path, metavar="STUDY", help="CSV file: sample,session[,mount],paint or value")
    parser.add_argument(
        "--quantity",
        choices=QUANTITIES,
        default="mode_nm",
        metavar="QUANTITY",
        help=f"quantity of the calibrations to study: {', '.join(QUANTITIES)} (default: mode_nm)",
    )
    parser.set_defaults(run=run_gauge_rr)


def run_gauge_rr(arguments: argparse.Namespace) -> int:
    """Analyse, print and return the exit status."""
    from data_schemas import FinrayError
    from finray_calib.acceptance import balanced_values, gauge_study

    with naming(FinrayError, arguments.study):
        study = gauge_study(balanced_values(_measurements(arguments.study, arguments.quantity)))
    _say_study(study)
    return NOT_ACCEPTED if study.verdict == "FAIL" else 0


def _measurements(path: Path, quantity: str) -> "list[tuple[str, str, str, float]]":
    """Return sample, session, mount and value of each row."""
    from data_schemas import PaintCalibration, RecordError
    from data_schemas.storage import finite_number, read_csv, read_record

    texts = ("sample", "session", "mount", "paint")
    columns, rows = read_csv(path, "a CSV file of a gauge study", other_marks=True, names=texts)
    value = next((name for name in ("paint", "value") if name in columns), None)
    lacking = [name for name in ("sample", "session") if name not in columns]
    if lacking or value is None:
        raise RecordError(
            f"{path}: the header must name the columns sample, session, and paint or value (mount is optional), but "
            f"its columns are {', '.join(columns) or 'missing'}"
        )
    found, paints = [], []
    for line, cells in rows:
        row = dict(zip(columns, cells, strict=False))
        if any(not row.get(name) for name in ("sample", "session", value)):
            raise RecordError(f"{path}, line {line}: an entry is missing; give sample, session and {value}")
        if value == "paint":
            paints.append(path.parent / row["paint"])
            number = read_record(paints[-1], PaintCalibration).parameters[quantity].estimate
        else:
            try:
                number = finite_number(row["value"])
            except ValueError as fault:
                raise RecordError(f"{path}: line {line}: value: {fault}") from None
        found.append((row["sample"], row["session"], row.get("mount", ""), number))
    _require_different(paints, "capture")
    return found


def _say_study(study: "GaugeStudy") -> None:
    """Print the analysis of variance, the standard deviations and the verdict."""
    mounts = f" x {study.mounts} mounts" if study.mounts > 1 else ""
    say(f"{study.samples} samples x {study.sessions} sessions{mounts} x {study.repeats} repeats")
    say(f"  {'source':20s}{'freedom':>8s}{'mean square':>14s}{'F':>9s}{'p':>8s}{'sd':>12s}")
    for line in study.strata:
        ratio = "" if line.f_ratio is None else f"{line.f_ratio:.4g}"
        chance = "" if line.p is None else f"{line.p:.3f}"
        say(f"  {line.source:20s}{line.freedom:8d}{line.mean_square:14.6g}{ratio:>9s}{chance:>8s}"
            f"{line.variance**0.5:12.4g}")  # fmt: skip
    rows = (
        ("measurement, sd", study.gauge_sd, 1.0, ""),
        ("samples, sd", study.sample_sd, 1.0, ""),
        ("share of the total sd (%GRR)", study.share, 100.0, " %"),
        ("distinct categories, not rounded", study.categories, 1.0, ""),
    )
    for name, value, factor, unit in rows:
        low, centre, high = (factor * x for x in (value.low95, value.estimate, value.high95))
        say(f"  {name:34s}{centre:.4g}{unit} [{low:.3g}, {high:.3g}]{unit} (95 %)")
    say(f"  number of distinct categories: {study.distinct_categories} (5 or more are wanted)")
    for note in study.notes:
        say(f"  note: {note}")
    say(f"{study.verdict}: passes with the whole interval below 10 %, fails with all of it above 30 %")
    give(study=study)


EQUIVALENCE_HELP = "test whether two tins of a paint are equivalent within margins"
EQUIVALENCE_DESCRIPTION = """\
Compare two tins of a paint by the calibrations of their coats, each fitted from a session of its own on one rig,
against margins that you state: two one-sided tests with 5 % risk.

  finray check equivalence --first A1.json A2.json A3.json --second B1.json B2.json B3.json
      --margin mode_nm=4 --margin energy_yield=0.03 --margin spectrum=0.1

PASS: equivalent in this quantity. FAIL: different. UNDECIDED: neither is shown; measure more coats. Margins are in the
unit of the quantity: mode_nm, fwhm_nm, peak_per_nm, energy_yield, reflectance_at_laser; that of spectrum is a share of
the peak. With one coat of a tin the differences between coats are unknown, and the command says so.
Exit status: 0, 1 where the tins differ in a quantity, 2 after a mistake."""
COMPARED: "tuple[ComparedQuantity, ...]" = (
    "mode_nm", "fwhm_nm", "peak_per_nm", "energy_yield", "reflectance_at_laser", "spectrum",
)  # fmt: skip


def add_equivalence(acts: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Register what ``finray check equivalence`` takes."""
    parser = acts.add_parser(
        "equivalence", help=EQUIVALENCE_HELP, description=EQUIVALENCE_DESCRIPTION,
    )  # fmt: skip
    for tin in ("first", "second"):
        parser.add_argument(
            f"--{tin}", type=Path, nargs="+", required=True, metavar="PAINT", help=f"calibrations of the {tin} tin"
        )
    parser.add_argument(
        "--margin", action="append", required=True, type=_margin, metavar="QUANTITY=VALUE",
        help="largest allowed difference of a quantity (give the option once for each quantity)",
    )  # fmt: skip
    parser.set_defaults(run=run_equivalence)


def _margin(text: str) -> "tuple[ComparedQuantity, float]":
    """Parse QUANTITY=VALUE."""
    name, _, number = text.partition("=")
    known = next((one for one in COMPARED if one == name), None)
    try:
        margin = float(number)
    except ValueError:
        margin = 0.0
    if known is None or not 0.0 < margin < float("inf"):
        raise argparse.ArgumentTypeError(
            f"{text!r} must be QUANTITY=VALUE, with VALUE above 0 and QUANTITY one of {', '.join(COMPARED)}"
        )
    return known, margin


def _require_different(paths: Sequence[Path], of: str = "coat") -> None:
    """Refuse a calibration that is given twice, also by another name: it would agree with itself."""
    from data_schemas import FinrayError, digest_of_input

    first: dict[str, Path] = {}
    for path in paths:
        if (other := first.setdefault(digest_of_input(path), path)) is not path:
            raise FinrayError(f"{other} and {path} are the same calibration; give one calibration for each {of}")


def run_equivalence(arguments: argparse.Namespace) -> int:
    """Compare, print and return the exit status."""
    from data_schemas import FinrayError, PaintCalibration, decimals_for, fixed
    from data_schemas.storage import read_record
    from finray_calib.acceptance import tins_are_equivalent

    margins = dict(arguments.margin)
    if len(margins) < len(arguments.margin):
        raise FinrayError("--margin: a quantity is given twice; give each quantity once")
    tins = [[read_record(path, PaintCalibration) for path in paths] for paths in (arguments.first, arguments.second)]
    _require_different([*arguments.first, *arguments.second])
    found = tins_are_equivalent(tins[0], tins[1], margins)
    for one in found:
        places = decimals_for(0.5 * (one.high90 - one.low90))
        low, centre, high = (fixed(value, places) for value in (one.low90, one.difference, one.high90))
        say(f"{one.verdict:10s} {one.title}: differs by {centre} [{low}, {high}] {one.unit}".rstrip())
        say(f"           90 % interval, allowed +-{one.margin:g} {one.unit}".rstrip())
        say(f"           {one.basis}")
    give(compared=found)
    return NOT_ACCEPTED if any(one.verdict == "FAIL" for one in found) else 0


HISTORY_HELP = "chart a rig over its sessions: in control or out of control, and the light each sample received"
HISTORY_DESCRIPTION = """\
Read all paint sessions below a folder and chart, for each rig: level and colour of the lamp, each filter, the laser,
the dark level and its growth (stray light), the sharpness of the white frames; and for each sample: level and centroid
of the emission. The first sessions are the reference (--reference, 10). Later ones are judged by a Shewhart and an EWMA
chart. Their limits are set for the number of reference sessions, so that 1 % of good sessions (--false-alarms 0.01)
give an alarm in any quantity.

When you have found the cause of an alarm, give --cleared SESSION: the charts then start again after that session, with
the same reference. After a change of the rig (a new lamp), move the older sessions to another folder: the rig then
needs a new reference.

The command also reports how much laser light fell on each sample and, where it was measured, how much of the emission
was lost to this light.
Exit status: 0 in control or undecided (too few sessions), 1 out of control, 2 after a mistake."""
OUT_OF_CONTROL = 1
DEPTHS = ("session.json", "*/session.json", "*/*/session.json")


def add_history(verbs: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Register the verb."""
    parser = verbs.add_parser(
        "history", help=HISTORY_HELP, description=HISTORY_DESCRIPTION,
    )  # fmt: skip
    parser.add_argument("folder", type=Path, metavar="DIR", help="folder of session folders")
    parser.add_argument(
        "--reference",
        type=whole_number(6, 10_000),  # of fewer, no limits are known: FEWEST_REFERENCE
        default=10,
        metavar="N",
        help="number of sessions, counted from the first, that serve as the reference (default: 10)",
    )
    parser.add_argument(
        "--false-alarms",
        type=number_within("a share (0.01 is 1 %)", (0.0001, 0.2)),  # the library asks each chart for 1e-6
        default=0.01,
        metavar="SHARE",
        help="share of good sessions that may give an alarm (default: 0.01)",
    )
    parser.add_argument(
        "--cleared",
        metavar="SESSION",
        help="last session up to which you know the cause of every alarm; the charts start again after this session",
    )
    parser.add_argument("--report", type=Path, metavar="PAGE", help="write the charts as a page (HTML); must be new")
    parser.set_defaults(run=run_history)


def run_history(arguments: argparse.Namespace) -> int:
    """Read, chart, print and return the exit status."""
    from data_schemas import FinrayError
    from data_schemas.storage import write_bytes
    from finray_calib.acceptance import session_history
    from finray_calib.reports import history_page

    page = None if arguments.report is None else require_new(arguments.report, ".html")
    facts = _facts(arguments.folder, arguments.cleared)
    with naming(FinrayError, arguments.folder):
        found = session_history(facts, arguments.reference, arguments.false_alarms, arguments.cleared)
    _say_history(found, len(facts))
    if page is not None:
        folder: Path = arguments.folder
        title = str(folder.resolve() if folder.name in ("", "..") else folder)
        write_bytes(page, history_page(found, title, arguments.reference).encode())
        wrote(page, "the charts")
        suggest_file(page)
    give(verdict=found.verdict, reasons=found.reasons, charts=found.watched, ledger=found.ledger, waiting=found.waiting)
    return OUT_OF_CONTROL if found.verdict == "OUT OF CONTROL" else 0


def _facts(folder: Path, cleared: str | None) -> "list[SessionFacts]":
    """Reduce the paint sessions below a folder, of which that which was cleared must be one."""
    from data_schemas import CaptureError
    from finray_calib.acceptance import session_facts
    from rigs.capture import JOURNAL_NAME, SESSION_NAME, read_frame_of, read_session, session_kind

    if not folder.is_dir():
        what = "is a file" if folder.exists() else "no such folder"
        raise CaptureError(f"{folder}: {what}; give the folder that holds the session folders of 'finray capture'")
    places = sorted({path.parent for pattern in DEPTHS for path in folder.glob(pattern)})
    journals = {path.parent for pattern in DEPTHS for path in folder.glob(pattern.replace(SESSION_NAME, JOURNAL_NAME))}
    for place in sorted(journals - set(places)):
        warn(f"note: {place}: its capture was not finished, so that this session is left out")
    paint = [place for place in places if session_kind(place) == "paint"]
    if not paint:
        raise CaptureError(
            f"{folder}: holds no paint session; give the folder that holds the session folders of 'finray capture'"
        )
    names = [place.relative_to(folder).as_posix() for place in paint]
    if cleared is not None and cleared not in names:
        raise CaptureError(f"--cleared {cleared}: no such session; give one of {', '.join(names)}")
    facts = []
    with progress_bar("history") as progress:
        for number, (name, place) in enumerate(zip(names, paint, strict=True)):
            progress(number, len(paint), name)
            facts.append(session_facts(name, read_session(place), partial(read_frame_of, place)))
    return facts


def _counted(number: int, noun: str) -> str:
    return f"{number} {noun}{'' if number == 1 else 's'}"


def _say_history(found: "History", sessions: int) -> None:
    """Print the verdict, its reasons, every quantity at its last session, and the ledger."""
    say(f"{found.verdict}: {_counted(sessions, 'session')}, {_counted(len(found.watched), 'chart')}")
    for reason in found.reasons:
        say(f"  {reason}")
    for waiting in found.waiting:
        say(f"  not judged: {waiting}")
    for name in dict.fromkeys(one.of for one in found.watched):
        say(f"  {name}: mean and sd of the reference, then the newest session")
        for one in (one for one in found.watched if one.of == name):
            chart = one.chart
            last = (chart.values[-1] - chart.mean) / chart.sd
            newest = f"{last:+7.1f} sd" if len(one.sessions) > (chart.rules.reference or 0) else ""
            say(f"    {one.quantity:46s}{one.told_mean():>10s} {chart.sd:9.2g}{newest}")
    for session, quantities in found.outliers.items():
        say(
            f"  note: {session} differs from the rest of the reference ({', '.join(quantities)}); check that it was a "
            "good session"
        )
    if found.watched:
        say(f"  limits: {_limit(found.watched[0].chart.rules)}")
    for row in found.ledger:
        lost = "" if row.lost is None else f", by which {100 * row.lost:.2g} % of the emission was lost"
        say(f"  light on '{row.paint_name}': {row.dose_j:.3g} J in {_counted(row.sessions, 'session')}{lost}")
    share, each = 100 * found.false_alarm_share, 100 * found.false_alarm_share_each
    say(f"  false alarms: {share:g} % of good sessions with all charts together, {each:.2g} % with each chart")


def _limit(rules: "ChartRules") -> str:
    """Return the limits of both charts."""
    return f"{rules.shewhart_factor:.1f} sd for one session, {rules.ewma_limit_factor:.1f} sd for the weighted mean"


CERTIFICATE_HELP = "write the certificate of a paint: results with expanded uncertainty, on one page"
CERTIFICATE_DESCRIPTION = """\
Write the certificate of a fitted paint as a page (HTML) and as PDF: spectrum with its band, quantities with expanded
uncertainty and coverage factor, method, conditions, instruments and their certificates, decision rule, and a place to
sign. The files that the paint was made from are looked for and hashed again; the session is then read for date, devices
and conditions. Where no certificate of a reference is recorded, the page says that the results are not traceable.

--laboratory FILE (TOML) adds what only the laboratory knows:

  kind = "certificate"
  laboratory = "Optics laboratory"      # also: address, number, customer, item, conditions, authorised_by
  item = "tin 12, third coat on acrylic"

  [[references]]                        # one for each certificate that you hold
  of = "white reference"                # filters, lamp, camera response, laser, other
  number = "WR-2026-117"
  issued_by = "National institute"
  calibrated_on = 2026-03-02
  valid_until = 2027-03-02              # may be left out

  [[limits]]                            # for a statement of conformity
  quantity = "mode_nm"                  # fwhm_nm, peak_per_nm, energy_yield, reflectance_at_laser
  low = 590.0
  high = 605.0

--budget BANDS adds how much each source contributes to each uncertainty; the shares of a quantity add up to 100 %.
Exit status: 0, 1 where a quantity fails its limits, 2 after a mistake."""
NOT_CONFORMING = 1


def add_certificate(verbs: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Register the verb."""
    parser = verbs.add_parser(
        "certificate", help=CERTIFICATE_HELP, description=CERTIFICATE_DESCRIPTION,
    )  # fmt: skip
    parser.add_argument("paint", type=Path, metavar="PAINT", help="paint calibration (.json)")
    parser.add_argument("--laboratory", type=Path, metavar="FILE", help="what the laboratory adds (TOML)")
    parser.add_argument(
        "--budget",
        type=Path,
        metavar="BANDS",
        help="band signals of the paint, to add an uncertainty budget by source",
    )
    parser.add_argument(
        "--out", type=Path, metavar="PATH",
        help="page to write (default: PAINT.certificate.html); the PDF goes into the same folder, and both files "
             "must be new",
    )  # fmt: skip
    parser.set_defaults(run=run_certificate)


def run_certificate(arguments: argparse.Namespace) -> int:
    """Write the certificate and return the exit status."""
    from data_schemas import CertificateDetails, FinrayError, PaintCalibration, digest_of_input
    from data_schemas.storage import ProductSet, read_record, read_toml
    from finray_calib.acceptance import certified_results
    from finray_calib.reports import certificate_page, certificate_pdf, paint_certificate

    path: Path = arguments.paint
    stem = path.name.removesuffix(".json").removesuffix(".paint")
    page = arguments.out or path.with_name(f"{stem}.certificate.html")
    if page.suffix != ".html":
        raise FinrayError(f"{page}: must end in .html; choose another --out (the PDF is written beside the page)")
    require_new(page)
    pdf = require_new(page.with_suffix(".pdf"))
    paint = read_record(path, PaintCalibration)
    details = (
        CertificateDetails() if arguments.laboratory is None else read_toml(arguments.laboratory, CertificateDetails)
    )
    sessions, is_simulated, lineage = _found(path)
    measured_on = None
    if len(sessions) == 1:
        measured_on = datetime.fromisoformat(sessions[0].frames[-1].captured_utc).date()
    with naming(FinrayError, path):
        results = certified_results(paint, details, measured_on, is_simulated=is_simulated)
    budget = () if arguments.budget is None else _budget(arguments.budget, paint)
    today = datetime.now(UTC).date()
    certificate = paint_certificate(paint, results, details, digest_of_input(path), today, sessions, budget, lineage)
    with ProductSet(page) as products:
        products.add(pdf, certificate_pdf(certificate, paint))
        products.add(page, certificate_page(certificate, paint).encode())
    _say(results, certificate.traceability)
    wrote(page, f"certificate {certificate.number}")
    wrote(pdf, "the same, to print and sign")
    give(number=certificate.number, results=results, traceability=certificate.traceability, budget=budget)
    suggest_file(page)
    return NOT_CONFORMING if any(result.verdict == "FAIL" for result in results) else 0


def _budget(path: Path, paint: "PaintCalibration") -> "tuple[BudgetRow, ...]":
    """Return the budget of a calibration from the band signals that it was fitted to."""
    from data_schemas import BandSignals, FinrayError
    from data_schemas.storage import read_record
    from finray_calib.fit import uncertainty_budget

    seed = 1 if paint.provenance is None or paint.provenance.seed is None else paint.provenance.seed
    with progress_bar("budget"), naming(FinrayError, path):
        return uncertainty_budget(read_record(path, BandSignals), paint, seed)


def _found(path: Path) -> "tuple[list[CaptureSession], bool | None, str]":
    """Return the sessions that a calibration was made from, whether a rig was simulated, and what was found of files.

    A calibration that is not as it was written is refused where it is read; files that it was made from and that were
    changed since are named.
    """
    from data_schemas import FinrayError
    from finray_calib.lineage import Tracer, findings

    tree = Tracer().trace(path)
    faults = findings(tree)
    if changed := [fault for fault in faults if fault.state != "missing"]:
        raise FinrayError(
            f"{changed[0].path}: {changed[0].text}; a certificate needs files that have not changed since they were "
            f"written. Run 'finray trace {path}' to see all changes"
        )
    for fault in faults:
        warn(f"note: {fault.path}: {fault.text}")
    hashed = sum(1 for part in tree.all() if part.path is not None and not part.is_repeated)
    told = (
        f"The calibration and the {hashed - 1} files behind it were hashed again and are unchanged."
        if not faults
        else f"Of the files behind the calibration, {len(faults)} were not found and not verified."
    )
    return *_sessions(tree), told


def _sessions(tree: "Traced") -> "tuple[list[CaptureSession], bool | None]":
    """Return the paint sessions of a tree, and whether any was of a simulated rig.

    Whether the rig was simulated is None where none was and a session, or band signals that would name one, were not
    found.
    """
    from rigs.capture import read_session

    parts = [part for part in tree.all() if not part.is_repeated]
    sessions = [
        read_session(part.path.parent) for part in parts if part.kind == "CaptureSession" and part.path is not None
    ]
    signals = [part for part in parts if part.kind == "BandSignals"]
    is_whole = bool(signals) and not any(one.path is None and one.name.endswith(".json") for one in tree.inputs)
    is_whole &= all(any(one.kind == "CaptureSession" for one in part.inputs) for part in signals)
    is_simulated = any(session.rig.is_simulated for session in sessions)
    return sessions, True if is_simulated else False if is_whole else None


def _say(results: "tuple[CertifiedResult, ...]", traceability: str) -> None:
    """Print the results."""
    from data_schemas import decimals_for, fixed

    for result in results:
        places = decimals_for(result.expanded)
        told = f"{fixed(result.value, places)} +- {fixed(result.expanded, places)} {result.unit}".strip()
        text = (
            f"{told} (k = {result.coverage_factor:.2f}, 95 %)" if result.is_measured else "not measured: mostly prior"
        )
        verdict = "" if result.verdict is None else f"  {result.verdict}"
        say(f"  {result.title:52s} {text}{verdict}")
    say(f"  {traceability}")
