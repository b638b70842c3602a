"""Numbers and tables as plain text: as many digits as the interval supports, tables of the terminal, plain JSON.

A number that is not finite becomes null in JSON.
"""

import math
import re
from collections.abc import Iterable, Iterator, Sequence
from textwrap import wrap
from typing import Any

import numpy as np

from data_schemas import (
    ComparisonBatch,
    ErrorRow,
    Estimate,
    ForceComparison,
    ForceEstimate,
    ForceThird,
    MetricRow,
    PackagedMetric,
    PhotometricErrorReport,
    RegionError,
    unsigned_zeros,
)
from data_schemas import decimals_for as decimals_for
from data_schemas import fixed as fixed
from data_schemas import interval_text as interval_text
from data_schemas import significant as significant

NO_VALUE = "\N{EN DASH}"
"""Stands where there is no number to show."""


def estimate_text(value: Estimate, unit: str = "", factor: float = 1.0) -> str:
    """Return an estimate with its 95 % interval, times a factor for the unit."""
    return interval_text(factor * value.estimate, factor * value.low95, factor * value.high95, unit)


def aligned_lines(head: Sequence[str], rows: Iterable[Sequence[str]]) -> list[str]:
    """Return a table as lines whose columns stand below each other."""
    lines = [head, *rows]
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    return ["  ".join(map(str.ljust, line, widths)).rstrip() for line in lines]


def percent(fraction: float) -> str:
    """Return a fraction as per cent, as "below 0.1 %" when it rounds to less, and as "12 times" from 10 on."""
    if 0 < abs(fraction) < 0.0005:
        return "below 0.1 %"
    if abs(fraction) >= 10:
        return f"{fixed(fraction, 0)} times"
    value = 100 * fraction
    text = fixed(value, 0 if abs(value) >= 10 else 1)
    return f"{text.removesuffix('.0')} %"


def centre_text(center_nm: float) -> str:
    """Return the centre of a filter to 0.1 nm; of a measured curve it has many more digits."""
    return fixed(center_nm, 1).removesuffix(".0")


def filter_label(name: str, center_nm: float, unit: str = "") -> str:
    """Return the centre of a filter to 0.1 nm, in brackets behind its name where that is another."""
    centre = f"{centre_text(center_nm)}{unit}"
    return centre if f"{name}{unit}" == centre else f"{name} ({centre})"


def signed_percent(fraction: float) -> str:
    """Return a fraction as per cent with its sign; what rounds to nothing is 0 %."""
    text = percent(fraction) if abs(fraction) >= 0.0005 else "0 %"
    return f"+{text}" if fraction >= 0.0005 else text


def probability(value: float) -> str:
    """Return a probability with two decimals; never 0 or 1, which no finite number of draws can show."""
    if value > 0.99:
        return "above 0.99"
    return "below 0.01" if value < 0.01 else f"{value:.2f}"


def pareto_text(k: float | None) -> str:
    """Return the shape k of importance weights with two decimals; a dash where it cannot be estimated."""
    return NO_VALUE if k is None else fixed(k, 2)


def duration(seconds: float) -> str:
    """Return a wall time in seconds or minutes."""
    if seconds >= 120:
        return f"{seconds / 60:.1f} min"
    return f"{seconds:.1f} s" if seconds < 20 else f"{seconds:.0f} s"


def skill_text(estimate: float, low: float, high: float) -> str:
    """Return a skill score with its interval, at most three decimals."""
    return interval_text(estimate, low, high, most_decimals=3)


def unbroken(text: str) -> str:
    """Return the text as a page shows it: zeros without sign, number and unit on one line, and so [low, high]."""
    text = unsigned_zeros(text)
    text = text.replace(" +- ", " \u00b1 ").replace(" \u00b1 ", "\u00a0\u00b1\u00a0")
    units = re.sub(r"(?<=[\d\]]) (?=(?:%|nm|um|deg|dB|DN|mN|N|mm|ms|s|px|pixels)(?![\w/]))", "\u00a0", text)
    return re.sub(r"\[[^\[\]]{0,40}\]", lambda found: found[0].replace(" ", "\u00a0"), units)


Json = dict[str, Any]


def plain(value: Any) -> Any:
    """Return plain JSON types: numpy scalars and arrays as numbers and lists, null for what is not finite."""
    if isinstance(value, dict):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, np.generic | np.ndarray):
        return plain(value.tolist())
    return None if isinstance(value, float) and not math.isfinite(value) else value


def estimate_json(value: Estimate, truth: float | None = None) -> Json:
    """Return estimate and 95 % interval, beside the truth where it is known."""
    numbers: Json = {"estimate": value.estimate, "low95": value.low95, "high95": value.high95}
    return numbers if truth is None else {**numbers, "truth": truth}


WIDTH_COLUMNS = 80
_COLUMNS = (
    ("", 10),
    ("skill", 20),
    ("skill R, G, B", 16),
    ("rel. RMS R, G, B", 17),
    ("PSNR dB", 7),
    ("SSIM", 5),
)
_LABEL_COLUMNS = 40


def interval_name(report: PhotometricErrorReport) -> str:
    """Return what the intervals of the scores are called: 95 % of what inputs leave open, or pixels of one press."""
    of_inputs = report.monte_carlo is not None if report.interval_over is None else report.interval_over == "inputs"
    return "95 %" if of_inputs else "over pixels"


def relative_sentence(compared: PhotometricErrorReport | ComparisonBatch) -> str:
    """Say, after a space, that only the change by contact was judged; nothing where the light was judged as well."""
    if not compared.relative:
        return ""
    return (
        " Relative: the captured image without contact replaces the render's, so that only the change by contact is "
        "judged, and not the light of the render."
    )


def comparison_lines(report: PhotometricErrorReport) -> str:
    """Return regions by rows (do nothing, simulation, floor), at most 80 columns wide.

    Parameters
    ----------
    report
        The comparison to print.

    Returns
    -------
    str
        Lines separated by newlines, ending with one.
    """
    lines = [
        _cut(f"simulated: {report.simulated}, {report.label}", WIDTH_COLUMNS),
        _cut(f"captured:  {report.captured}", WIDTH_COLUMNS),
    ]
    lines.append(f"values: {report.values}; {_exposure(report)}")
    if report.relative:
        lines.append("relative: only the change by contact is judged, not the light of the render")
    for region in report.regions:
        titles = [f"skill [{interval_name(report)}]" if title == "skill" else title for title, _ in _COLUMNS]
        lines += ["", _cut(_heading(report, region), WIDTH_COLUMNS), _line(titles)]
        lines += [_line(_cells(row)) for row in region.rows]
    skill = report.headline_skill
    headline = skill_text(skill.estimate, skill.low95, skill.high95)
    name = "relative skill" if report.relative else "skill"
    lines += ["", _cut(f"headline: {name} {headline} over {report.headline_region}", WIDTH_COLUMNS)]
    if interval_name(report) != "95 %":
        lines.append(
            "in brackets: spread over pixels of this press, not a 95 % interval; for an interval, compare folders "
            "of three presses or more"
        )
    for metric in report.packaged_metrics:
        shown = "; ".join(f"{row.candidate} {metric_value(row, metric)}" for row in metric.rows)
        told = f"{metric.name} of {metric.package} ({metric.words}; {metric.better} is better): {shown}"
        lines += wrap(told, WIDTH_COLUMNS, subsequent_indent="  ")
    for reason in report.withheld:
        lines += wrap(f"withheld: {reason}", WIDTH_COLUMNS, subsequent_indent="  ")
    return "\n".join(lines) + "\n"


def metric_value(row: MetricRow, metric: PackagedMetric) -> str:
    """Return the value of a metric of another package with its interval, where it has one, and its unit."""
    value = row.value
    text = f"{value.estimate:.4g}"
    if value.low95 < value.high95:
        text += f" [{value.low95:.4g}, {value.high95:.4g}]"
    return text if metric.unit == "1" else f"{text} {metric.unit}"


def _heading(report: PhotometricErrorReport, region: RegionError) -> str:
    """Return the name and size of a region."""
    clipped = f", {100 * region.clipped_fraction:.1f} % clipped" if region.clipped_fraction > 0 else ""
    unit = "px" if report.block_px == 1 else f"blocks of {report.block_px} x {report.block_px} px"
    return f"{region.region} ({region.factor:g} half-widths, {region.pixels} {unit}{clipped})"


def _exposure(report: PhotometricErrorReport) -> str:
    """Return the exposure factor with its standard deviation, or that it was not fitted; or the tone curve."""
    if report.tone_curve is not None:
        p = report.tone_curve.exponent
        return f"exponent {interval_text(p.estimate, p.low95, p.high95, most_decimals=2)}"
    if report.exposure_factor is None:
        return "exposure factor: not fitted (1)"
    spread = "" if report.exposure_factor_sd is None else f", sd {significant(report.exposure_factor_sd, 2)}"
    return f"exposure factor: {significant(report.exposure_factor, 4)}{spread}"


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
    return (f"{cells[0]:<{len(name)}}" + " " + " ".join(rest)).rstrip()


def _cut(text: str, columns: int = _LABEL_COLUMNS) -> str:
    """Shorten a text to a number of columns."""
    return text if len(text) <= columns else text[: columns - 3] + "..."


_LARGEST_INPUTS = 6


def force_lines(comparison: ForceComparison) -> str:
    """Return the rows, the validation statement by thirds, and the budget; 80 columns where no name is longer."""
    return "\n".join(_lines(comparison)) + "\n"


def _lines(comparison: ForceComparison) -> Iterator[str]:
    """Yield the lines."""
    yield f"simulated: {comparison.simulated}; measured: {comparison.measured}, {len(comparison.points)} points"
    yield comparison.label
    yield ""
    yield f"{'':<12}relative RMS" + ("" if comparison.withheld else " [95 % of the model's own error]")
    for row in comparison.rows:
        rms = row.rms_rel
        yield f"{row.candidate:<12}{100 * rms.estimate:7.1f} %" + _interval(rms, ".1f", "  ", 100.0, " %")
    if comparison.first_touch is None:
        yield "first touch: the zero of the measured displacements; not fitted"
    else:
        offset = comparison.first_touch.offset_mm
        known = "" if comparison.withheld else f", u = {comparison.first_touch.u_mm:.3f} mm"
        yield f"first touch: fitted at {offset.estimate:.3f} mm{_interval(offset, '.3f', ' ')}{known}"
    yield ""
    yield f"{'displacement mm':<16}{'force N':>8}{'error N':>8}{'u_num':>8}{'u_input':>8}{'u_D':>7}{'u_val':>7}"
    yield from map(_third, comparison.thirds)
    yield ""
    yield "largest contributions to the simulated force at the deepest point:"
    for line in comparison.budget[:_LARGEST_INPUTS]:
        effect = (
            ""
            if line.u_rel is None
            else f"; input {100 * line.u_rel:.1f} %, d ln F / d ln x = {line.ln_force_per_ln_input:+.2f}"
        )
        yield f"  {100 * line.force_u_rel:5.1f} %  {line.input} ({line.source}{effect})"
    yield ""
    if comparison.withheld:
        yield from wrap(f"withheld: {comparison.withheld}", WIDTH_COLUMNS, subsequent_indent="  ")
    for missing in comparison.not_included:
        yield f"not included: {missing}"


def _interval(value: ForceEstimate, form: str, before: str, scale: float = 1.0, unit: str = "") -> str:
    """Return the ends of an interval, times a scale, in brackets; nothing where they are withheld."""
    if value.low95 is None or value.high95 is None:
        return ""
    return f"{before}[{scale * value.low95:{form}}, {scale * value.high95:{form}}]{unit}"


def _third(third: ForceThird) -> str:
    """Return the line of a third."""
    place = f"{third.from_mm:.3g} to {third.to_mm:.3g}"
    uncertainties = (third.u_numerical_n, third.u_input_n, third.u_data_n, third.u_validation_n)
    said = "verdict withheld"
    if third.within is not None:
        said = "within 2 u_val" if third.within else "off by > 2 u_val"
    return (
        f"{place:<16}{third.force_n:8.3f}{third.error_n:+8.3f}"
        + "".join(f"{u:{width}.3f}" for u, width in zip(uncertainties, (8, 8, 7, 7), strict=True))
        + f"  {said}"
    )


def interval_words(estimate: float, low: float, high: float) -> str:
    """Return an estimate with its interval in brackets, three decimals each."""
    return f"{estimate:.3f} [{low:.3f}, {high:.3f}]"
