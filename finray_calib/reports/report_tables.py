"""The tables of the report as rows of text; the first cell of a row is its heading."""

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from data_schemas.compare import ErrorRow, PhotometricErrorReport, RegionError
from data_schemas.decide import LightAngleDecision
from data_schemas.provenance import Provenance
from finray_calib.reports.demo_results import COLOURS, DemoResults, row_of
from finray_calib.reports.fitted_paint import FittedPaint
from finray_calib.reports.number_text import (
    decimals_for,
    fixed,
    percent,
    probability,
    significant,
    skill_text,
)
from finray_calib.reports.statements import equivalent_text


@dataclass(frozen=True, slots=True)
class TableGroup:
    """Rows under a common heading; an empty heading shows none."""

    heading: str
    rows: tuple[tuple[str, ...], ...]


@dataclass(frozen=True, slots=True)
class ReportTable:
    """One table: caption, column headings and groups of rows."""

    caption: str
    columns: tuple[str, ...]
    groups: tuple[TableGroup, ...]
    is_words: bool = False


def one_group(
    caption: str, columns: tuple[str, ...], rows: Iterable[tuple[str, ...]], is_words: bool = False
) -> ReportTable:
    """Return a table of one group without a heading."""
    return ReportTable(caption, columns, (TableGroup("", tuple(rows)),), is_words)


def capture_table(results: DemoResults) -> ReportTable:
    """List what was captured of each paint, one column for each."""
    sessions = [results.paints[colour].session for colour in COLOURS]
    kinds = [Counter(frame.frame_type for frame in session.frames) for session in sessions]
    exposures = [[frame.exposure_s for frame in session.frames] for session in sessions]
    saturated = [max((frame.saturated_fraction for frame in session.frames), default=0.0) for session in sessions]
    rows: list[tuple[str, ...]] = [
        ("paint", *(session.plan.paint_name for session in sessions)),
        ("rig", *(session.rig.name for session in sessions)),
        ("frames", *(str(len(session.frames)) for session in sessions)),
        ("of which", *(", ".join(f"{n} {kind}" for kind, n in sorted(count.items())) for count in kinds)),
        ("exposures", *(_range(times, "s") for times in exposures)),
        ("saturated", *("none" if share == 0 else f"up to {percent(share)} of a region" for share in saturated)),
    ]
    columns = ("session", *(f"{colour} paint" for colour in COLOURS))
    return one_group("Frames of the two paint sessions", columns, rows, is_words=True)


def _range(values: list[float], unit: str) -> str:
    """Return the smallest and largest value."""
    if not values:
        return "none"
    return f"{significant(min(values), 2)} to {significant(max(values), 2)} {unit}"


def signals_table(paint: FittedPaint) -> ReportTable:
    """List the fluorescence signal of every filter and channel with its standard deviation."""
    bands = paint.bands
    sd = np.sqrt(np.diag(bands.fluorescence_covariance)).reshape(-1, 3)
    rows = (
        (
            f"{band.center_nm:g}",
            *(_signal(*numbers) for numbers in zip(bands.fluorescence[i], sd[i], bands.flags[i], strict=True)),
        )
        for i, band in enumerate(bands.optics.filters)
    )
    caption = "fluorescence relative to white, in thousandths, \u00b1 standard deviation"
    return one_group(paint.titled(caption), ("filter (nm)", "red", "green", "blue"), rows)


def _signal(value: float, sd: float, flag: str) -> str:
    """Return value and standard deviation in thousandths, or the flag of a value that is not used."""
    if flag != "ok":
        return flag
    places = min(decimals_for(1e3 * sd), 4)
    return f"{fixed(1e3 * value, places)} \u00b1 {fixed(1e3 * sd, places)}"


def error_table(report: PhotometricErrorReport, report_level_a: PhotometricErrorReport | None = None) -> ReportTable:
    """List do nothing, simulation, the paper's emitter where it was rendered, and floor for every region."""
    paper = {} if report_level_a is None else {region.region: region for region in report_level_a.regions}
    groups = tuple(
        TableGroup(region_heading(report, region), _region_rows(region, paper.get(region.region)))
        for region in report.regions
    )
    columns = ("candidate", "skill [95 %]", "skill R, G, B", "relative RMS R, G, B", "PSNR (dB)", "SSIM")
    return ReportTable("Every candidate against the captured contact image", columns, groups)


def region_heading(report: PhotometricErrorReport, region: RegionError) -> str:
    """Return name and size of a region; blocks that were averaged count as one."""
    unit = "pixels" if report.block_px == 1 else f"blocks of {report.block_px} x {report.block_px} px"
    extent = "the contact half-width" if region.factor == 1 else f"{region.factor:g} contact half-widths"
    return f"{region.region}: up to {extent}, {region.pixels} {unit}, {_clipped(region.clipped_fraction)}"


def _region_rows(region: RegionError, paper: RegionError | None) -> tuple[tuple[str, ...], ...]:
    """Return the rows of a region, with the paper's emitter below the simulation."""
    rows: list[tuple[str, ...]] = []
    for row in region.rows:
        rows.append(_error_cells(row))
        other = None if paper is None or row.candidate != "simulation" else row_of(paper, "simulation")
        if other is not None:
            rows.append(("simulation, paper's emitter", *_error_cells(other)[1:]))
    return tuple(rows)


def _clipped(fraction: float) -> str:
    """Say how much of a region is clipped."""
    return "none clipped" if fraction == 0 else f"{percent(fraction)} clipped"


def _error_cells(row: ErrorRow) -> tuple[str, ...]:
    """Return the cells of one candidate."""
    spread = "withheld" if row.relative_rms is None else ", ".join(percent(rms.estimate) for rms in row.relative_rms)
    return (
        row.candidate,
        skill_text(row.skill.estimate, row.skill.low95, row.skill.high95),
        ", ".join("none" if value is None else fixed(value, 2) for value in row.skill_per_channel),
        spread,
        "identical" if row.psnr_db is None else fixed(row.psnr_db, 1),
        "none" if row.ssim is None else fixed(row.ssim, 3),
    )


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


def provenance_table(origin: Provenance) -> ReportTable:
    """List origin, versions, processor, seed and input hashes; what an older record does not hold is left out."""
    commit = origin.git_commit or "not run from a source tree"
    rows: list[tuple[str, ...]] = [
        ("made (UTC)", origin.created_utc),
        ("finray-calib", origin.package_version),
        ("source commit", f"{commit}, with changes that are not committed" if origin.git_dirty else commit),
        ("Python", origin.python_version),
        ("seed", "none" if origin.seed is None else str(origin.seed)),
    ]
    if origin.packages:
        rows.append(("packages", ", ".join(f"{name} {number}" for name, number in sorted(origin.packages.items()))))
    rows += [(what, said) for what, said in (("processor", origin.processor), ("renderer", origin.renderer)) if said]
    rows += [(f"SHA-256 of {name}", digest) for name, digest in sorted(origin.input_sha256.items())]
    return one_group("Where this report comes from", ("item", "value"), rows, is_words=True)
