"""``finray certificate``: the certificate of a paint, as a page and as PDF."""

import argparse
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING

from finray_calib.cli._output import give, look_at, progress_bar, say, warn, wrote
from finray_calib.cli._run import naming, require_new

if TYPE_CHECKING:
    from data_schemas import CaptureSession, PaintCalibration
    from finray_calib.acceptance import CertifiedResult
    from finray_calib.fit import BudgetRow
    from finray_calib.lineage import Traced

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
        "--budget", type=Path, metavar="BANDS", help="band signals of the paint, for a budget by source"
    )
    parser.add_argument(
        "--out", type=Path, metavar="PATH",
        help="page to write (default: PAINT.certificate.html); the PDF is written beside it; both must be new",
    )  # fmt: skip
    parser.set_defaults(run=run_certificate)


def run_certificate(arguments: argparse.Namespace) -> int:
    """Write the certificate and return the exit status."""
    from data_schemas import CertificateDetails, FinrayError, PaintCalibration, digest_of_input
    from data_schemas.storage import ProductSet, read_record, read_toml
    from finray_calib.acceptance import certified_results
    from finray_calib.reports import certificate_of, certificate_page, certificate_pdf

    path: Path = arguments.paint
    stem = path.name.removesuffix(".json").removesuffix(".paint")
    page = arguments.out or path.with_name(f"{stem}.certificate.html")
    if page.suffix != ".html":
        raise FinrayError(f"{page}: must be a page: choose an --out that ends in .html; the PDF is written beside it")
    require_new(page)
    pdf = require_new(page.with_suffix(".pdf"))
    paint = read_record(path, PaintCalibration)
    details = (
        CertificateDetails() if arguments.laboratory is None else read_toml(arguments.laboratory, CertificateDetails)
    )
    session, lineage = _found(path)
    measured_on = None if session is None else datetime.fromisoformat(session.frames[-1].captured_utc).date()
    with naming(FinrayError, path):
        results = certified_results(paint, details, measured_on)
    budget = () if arguments.budget is None else _budget(arguments.budget, paint)
    today = datetime.now(UTC).date()
    certificate = certificate_of(paint, results, details, digest_of_input(path), today, session, budget, lineage)
    with ProductSet(page) as products:
        products.add(pdf, certificate_pdf(certificate, paint))
        products.add(page, certificate_page(certificate, paint).encode())
    _say(results, certificate.traceability)
    wrote(page, f"certificate {certificate.number}")
    wrote(pdf, "the same, to print and sign")
    give(number=certificate.number, results=results, traceability=certificate.traceability, budget=budget)
    look_at(page)
    return NOT_CONFORMING if any(result.verdict == "FAIL" for result in results) else 0


def _budget(path: Path, paint: "PaintCalibration") -> "tuple[BudgetRow, ...]":
    """Return the budget of a calibration from the band signals that it was fitted to."""
    from data_schemas import BandSignals, FinrayError
    from data_schemas.storage import read_record
    from finray_calib.fit import uncertainty_budget

    seed = 1 if paint.provenance is None or paint.provenance.seed is None else paint.provenance.seed
    with progress_bar("budget"), naming(FinrayError, path):
        return uncertainty_budget(read_record(path, BandSignals), paint, seed)


def _found(path: Path) -> "tuple[CaptureSession | None, str]":
    """Return the session that a calibration was made from, and what was found of its files.

    A calibration that is not as it was written is refused where it is read; files that it was made from and that were
    changed since are named.
    """
    from data_schemas import FinrayError
    from finray_calib.lineage import Tracer, findings

    tree = Tracer().trace(path)
    faults = findings(tree)
    if changed := [fault for fault in faults if fault.state != "missing"]:
        raise FinrayError(
            f"{changed[0].path}: {changed[0].text}; a certificate needs files that are unchanged since they were "
            f"written: see "
            f"'finray trace {path}'"
        )
    for fault in faults:
        warn(f"note: {fault.path}: {fault.text}")
    hashed = sum(1 for part in tree.all() if part.path is not None and not part.is_repeated)
    told = (
        f"The calibration and the {hashed - 1} files behind it were hashed again and are unchanged."
        if not faults
        else f"Of the files behind the calibration, {len(faults)} were not found and not verified."
    )
    return _session(tree), told


def _session(tree: "Traced") -> "CaptureSession | None":
    """Return the only paint session of a tree; several lights have several, and none speaks for all."""
    from rigs.capture import read_session

    places = [part.path for part in tree.all() if part.kind == "CaptureSession" and not part.is_repeated]
    return read_session(places[0].parent) if len(places) == 1 and places[0] is not None else None


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
