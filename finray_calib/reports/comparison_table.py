"""The comparison as a plain text table for the terminal."""

from textwrap import wrap

from data_schemas.compare import ErrorRow, PhotometricErrorReport, RegionError
from finray_calib.reports.number_text import fixed, significant, skill_text

WIDTH_COLUMNS = 100
_COLUMNS = (
    ("", 12),
    ("skill [95 %]", 22),
    ("skill R, G, B", 19),
    ("rel. RMS R, G, B", 22),
    ("PSNR dB", 9),
    ("SSIM", 7),
)
_LABEL_COLUMNS = 40


def comparison_lines(report: PhotometricErrorReport) -> str:
    """Return regions by rows (do nothing, simulation, floor), at most 100 columns wide.

    Parameters
    ----------
    report
        The comparison to print.

    Returns
    -------
    str
        Lines separated by newlines, ending with one.
    """
    lines = [f"{_cut(report.simulated)} against {_cut(report.captured)}", _cut(report.label, WIDTH_COLUMNS)]
    lines.append(f"values: {report.values}; exposure factor: {_exposure(report)}")
    for region in report.regions:
        lines += ["", _cut(_heading(report, region), WIDTH_COLUMNS), _line([title for title, _ in _COLUMNS])]
        lines += [_line(_cells(row)) for row in region.rows]
    skill = report.headline_skill
    headline = skill_text(skill.estimate, skill.low95, skill.high95)
    lines += ["", _cut(f"headline: skill {headline} over {report.headline_region}", WIDTH_COLUMNS)]
    for reason in report.withheld:
        lines += wrap(f"withheld: {reason}", WIDTH_COLUMNS, subsequent_indent="  ")
    return "\n".join(lines) + "\n"


def _heading(report: PhotometricErrorReport, region: RegionError) -> str:
    """Return the name and size of a region."""
    clipped = f", {region.clipped_fraction:.1%} clipped" if region.clipped_fraction > 0 else ""
    unit = "px" if report.block_px == 1 else f"blocks of {report.block_px} x {report.block_px} px"
    return f"{region.region} ({region.factor:g} half-widths, {region.pixels} {unit}{clipped})"


def _exposure(report: PhotometricErrorReport) -> str:
    """Return the exposure factor with its standard deviation, or that it was not fitted."""
    if report.exposure_factor is None:
        return "not fitted (1)"
    spread = "" if report.exposure_factor_sd is None else f", sd {significant(report.exposure_factor_sd, 2)}"
    return f"{significant(report.exposure_factor, 4)}{spread}"


def _cells(row: ErrorRow) -> list[str]:
    """Return the cells of one candidate."""
    skill = skill_text(row.skill.estimate, row.skill.low95, row.skill.high95)
    channels = " ".join("-" if value is None else fixed(value, 2) for value in row.skill_per_channel)
    spread = "withheld" if row.relative_rms is None else " ".join(fixed(rms.estimate, 3) for rms in row.relative_rms)
    return [
        row.candidate,
        skill,
        channels,
        spread,
        "identical" if row.psnr_db is None else fixed(row.psnr_db, 1),
        "none" if row.ssim is None else fixed(row.ssim, 3),
    ]


def _line(cells: list[str]) -> str:
    """Return cells in columns; the first is aligned left, the others right."""
    name, *rest = (f"{cell:>{width}}" for cell, (_, width) in zip(cells, _COLUMNS, strict=True))
    return (f"{cells[0]:<{len(name)}}" + "  " + " ".join(rest)).rstrip()


def _cut(text: str, columns: int = _LABEL_COLUMNS) -> str:
    """Shorten a text to a number of columns."""
    return text if len(text) <= columns else text[: columns - 3] + "..."
