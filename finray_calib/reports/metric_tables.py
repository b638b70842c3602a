"""Every metric of a comparison beside doing nothing and the floor: in light, and in normals and depth."""

from collections.abc import Callable

from data_schemas.compare import ErrorRow, Interval, PhotometricErrorReport, RegionError, SensingError, SensingRow
from finray_calib.reports.demo_results import row_of
from finray_calib.reports.number_text import NO_VALUE, fixed, interval_text, skill_text
from finray_calib.reports.report_tables import ReportTable, TableGroup, one_group, region_heading

CHANNELS = ("red", "green", "blue")
_CANDIDATES = ("do nothing", "simulation", "floor")
_COLUMNS = ("metric", "do nothing", "simulation", "floor (a repeat)", "better is")
_Cell = Callable[[ErrorRow], str | None]


def metric_table(report: PhotometricErrorReport, region: RegionError) -> ReportTable:
    """List every metric of one region for the three candidates; metrics that nobody has are left out."""
    groups = [TableGroup(title, _rows(region, rows)) for title, rows in _METRICS]
    if region.region == report.headline_region:
        shown = (_number(report.ssim_full_frame.get(name), 3) or NO_VALUE for name in _CANDIDATES)
        paper = groups[-1]
        row = ("SSIM of the whole frame", *shown, "higher; says little")
        groups[-1] = TableGroup(paper.heading, (*paper.rows, row))
    return ReportTable(_sentence(region_heading(report, region)), _COLUMNS, tuple(g for g in groups if g.rows))


def sensing_table(sensing: SensingError) -> ReportTable:
    """List the error in sensing space of each candidate."""
    by_name: dict[str, SensingRow] = {row.candidate: row for row in sensing.rows}
    rows = [by_name.get(name) for name in _CANDIDATES]

    def cells(pick: Callable[[SensingRow], Interval]) -> tuple[str, ...]:
        return tuple(NO_VALUE if row is None else _interval(pick(row)) or NO_VALUE for row in rows)

    body = (
        ("angle between normals, mean (deg)", *cells(lambda r: r.normal_angle_mean_deg), "lower"),
        ("angle between normals, 95th percentile (deg)", *cells(lambda r: r.normal_angle_p95_deg), "lower"),
        ("depth, RMS (mm)", *cells(lambda r: r.depth_rms_mm), "lower"),
    )
    return one_group("Normals and depth from render and capture, over the headline region.", _COLUMNS, body)


def _rows(region: RegionError, metrics: tuple[tuple[str, str, _Cell], ...]) -> tuple[tuple[str, ...], ...]:
    """Return one row for each metric that at least one candidate has."""
    candidates = [row_of(region, name) for name in _CANDIDATES]
    rows = []
    for name, better, cell in metrics:
        cells = [None if candidate is None else cell(candidate) for candidate in candidates]
        if any(text is not None for text in cells):
            rows.append((name, *(text or NO_VALUE for text in cells), better))
    return tuple(rows)


def _interval(value: Interval | None, factor: float = 1.0, unit: str = "") -> str | None:
    """Return an estimate with its interval, or None."""
    if value is None:
        return None
    return interval_text(factor * value.estimate, factor * value.low95, factor * value.high95, unit, most_decimals=4)


def _number(value: float | None, places: int) -> str | None:
    """Return a number with fixed decimals, or None."""
    return None if value is None else fixed(value, places)


def _channel_skill(channel: int) -> _Cell:
    """Return the cell of one channel's skill."""
    return lambda row: _number(row.skill_per_channel[channel], 3)


def _channel_rms(channel: int) -> _Cell:
    """Return the cell of one channel's relative RMS, per cent."""
    return lambda row: None if row.relative_rms is None else _interval(row.relative_rms[channel], 100.0, "%")


_METRICS: tuple[tuple[str, tuple[tuple[str, str, _Cell], ...]], ...] = (
    (
        "Share of the touch that is explained (skill)",
        (
            (
                "all channels",
                "higher; 1 is perfect",
                lambda row: skill_text(row.skill.estimate, row.skill.low95, row.skill.high95),
            ),
            *((f"{name} alone", "higher; 1 is perfect", _channel_skill(i)) for i, name in enumerate(CHANNELS)),
        ),
    ),
    (
        "Size of the error in linear light",
        (
            *((f"relative RMS, {name}", "lower", _channel_rms(i)) for i, name in enumerate(CHANNELS)),
            (
                "gradient of the change, RMS (1/px)",
                "lower",
                lambda row: _interval(row.difference_gradient_rms_per_px),
            ),
            ("chromaticity, RMS (1)", "lower", lambda row: _interval(row.chromaticity_rms)),
        ),
    ),
    (
        "For comparison with papers",
        (
            ("PSNR (dB)", "higher", lambda row: _number(row.psnr_db, 1) or "identical"),
            ("SSIM of the region", "higher; 1 is perfect", lambda row: _number(row.ssim, 3)),
            ("MS-SSIM of the frame", "higher; 1 is perfect", lambda row: _number(row.ms_ssim, 3)),
            ("CIEDE2000, mean", "lower; 1 is barely seen", lambda row: _number(row.ciede2000_mean, 2)),
            ("CIEDE2000, 95th percentile", "lower", lambda row: _number(row.ciede2000_p95, 2)),
            ("FLIP, mean", "lower", lambda row: _number(row.flip_mean, 3)),
        ),
    ),
)


def _sentence(text: str) -> str:
    """Return the text with a capital."""
    return text[:1].upper() + text[1:]
