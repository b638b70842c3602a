"""What a comparison leaves open: what each input adds, and every part of the image against its uncertainty."""

from math import hypot, sqrt

from data_schemas.compare import PhotometricErrorReport
from finray_calib.reports.comparison_words import place
from finray_calib.reports.metric_tables import CHANNELS
from finray_calib.reports.number_text import NO_VALUE, percent, signed_percent, significant
from finray_calib.reports.report_tables import ReportTable, TableGroup, one_group


def budget_table(report: PhotometricErrorReport) -> ReportTable:
    """List what each input adds to the uncertainty of the skill and of the brightness beside the indenter."""
    lines = sorted(report.budget, key=lambda line: -line.skill_u)
    total = sqrt(sum(line.skill_u**2 for line in lines))
    rows = [
        (
            line.input,
            significant(line.skill_u, 2),
            percent(line.skill_u**2 / total**2) if total > 0 else NO_VALUE,
            NO_VALUE if line.objective_u_rel is None else percent(line.objective_u_rel),
            f"{line.evaluation}: {line.source}",
        )
        for line in lines
    ]
    objective = hypot(*(line.objective_u_rel or 0.0 for line in lines))
    rows.append(
        ("root sum of squares, as if independent", significant(total, 2), "100 %", percent(objective), NO_VALUE)
    )
    columns = ("input", "u of the skill (1)", "share", "u of the brightness", "known from")
    return one_group("What each input adds: standard uncertainty u with this input alone", columns, rows, True)


def validation_table(report: PhotometricErrorReport) -> ReportTable:
    """List every part and channel: error, validation uncertainty and where it comes from, area metric."""
    groups = tuple(
        TableGroup(
            channel,
            tuple(
                (
                    place(cell),
                    signed_percent(cell.error_rel),
                    percent(2 * cell.u_validation_rel),
                    "within" if cell.within else "outside",
                    ", ".join(percent(u) for u in (cell.u_numerical_rel, cell.u_input_rel, cell.u_data_rel)),
                    f"{percent(cell.area_too_bright_rel)}, {percent(cell.area_too_dark_rel)}",
                    str(cell.pixels),
                )
                for cell in sorted(report.validation, key=lambda cell: (cell.row, cell.column))
                if cell.channel == channel
            ),
        )
        for channel in CHANNELS
    )
    columns = ("part", "error", "2 u", "verdict", "u of render, inputs, capture", "area too bright, too dark", "pixels")
    return ReportTable("Mean level, simulated against captured, relative to the captured level", columns, groups)
