"""The tables of a comparison: every metric beside doing nothing and the floor, the budget, the parts, the images."""

from collections.abc import Callable, Mapping
from math import hypot, sqrt

from data_schemas.capture import IndenterPose, TactileCapture
from data_schemas.compare import (
    ErrorRow,
    Interval,
    PatchScale,
    PhotometricErrorReport,
    RegionError,
    SensingError,
    SensingRow,
)
from data_schemas.simulate import SimulatedPress
from finray_calib.reports.comparison_words import place
from finray_calib.reports.demo_results import row_of
from finray_calib.reports.number_text import fixed, interval_text, percent, signed_percent, significant, skill_text
from finray_calib.reports.report_tables import ReportTable, TableGroup, one_group, region_heading

CHANNELS = ("red", "green", "blue")
_CANDIDATES = ("do nothing", "simulation", "floor")
_DASH = "\N{EN DASH}"
_Cell = Callable[[ErrorRow], str | None]


def metric_table(report: PhotometricErrorReport, region: RegionError) -> ReportTable:
    """List every metric of one region for the three candidates; metrics that nobody has are left out."""
    groups = [TableGroup(title, _rows(region, rows)) for title, rows in _METRICS]
    if region.region == report.headline_region:
        shown = (_number(report.ssim_full_frame.get(name), 3) or _DASH for name in _CANDIDATES)
        paper = groups[-1]
        row = ("SSIM of the whole frame", *shown, "higher; says little")
        groups[-1] = TableGroup(paper.heading, (*paper.rows, row))
    columns = ("metric", "do nothing", "simulation", "floor (a repeat)", "better is")
    return ReportTable(_sentence(region_heading(report, region)), columns, tuple(g for g in groups if g.rows))


def sensing_table(sensing: SensingError) -> ReportTable:
    """List the error in sensing space of each candidate."""
    by_name: dict[str, SensingRow] = {row.candidate: row for row in sensing.rows}
    rows = [by_name.get(name) for name in _CANDIDATES]

    def cells(pick: Callable[[SensingRow], Interval]) -> tuple[str, ...]:
        return tuple(_DASH if row is None else _interval(pick(row)) or _DASH for row in rows)

    body = (
        ("angle between normals, mean (deg)", *cells(lambda r: r.normal_angle_mean_deg), "lower"),
        ("angle between normals, 95th percentile (deg)", *cells(lambda r: r.normal_angle_p95_deg), "lower"),
        ("depth, RMS (mm)", *cells(lambda r: r.depth_rms_mm), "lower"),
    )
    columns = ("metric", "do nothing", "simulation", "floor (a repeat)", "better is")
    return one_group("Normals and depth from render and capture, over the headline region.", columns, body)


def _rows(region: RegionError, metrics: tuple[tuple[str, str, _Cell], ...]) -> tuple[tuple[str, ...], ...]:
    """Return one row for each metric that at least one candidate has."""
    candidates = [row_of(region, name) for name in _CANDIDATES]
    rows = []
    for name, better, cell in metrics:
        cells = [None if candidate is None else cell(candidate) for candidate in candidates]
        if any(text is not None for text in cells):
            rows.append((name, *(text or _DASH for text in cells), better))
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


def budget_table(report: PhotometricErrorReport) -> ReportTable:
    """List what each input adds to the uncertainty of the skill and of the brightness beside the indenter."""
    lines = sorted(report.budget, key=lambda line: -line.skill_u)
    total = sqrt(sum(line.skill_u**2 for line in lines))
    rows = [
        (
            line.input,
            significant(line.skill_u, 2),
            percent(line.skill_u**2 / total**2) if total > 0 else _DASH,
            _DASH if line.objective_u_rel is None else percent(line.objective_u_rel),
            f"{line.evaluation}: {line.source}",
        )
        for line in lines
    ]
    objective = hypot(*(line.objective_u_rel or 0.0 for line in lines))
    rows.append(("root sum of squares, as if independent", significant(total, 2), "100 %", percent(objective), _DASH))
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


def images_table(press: SimulatedPress, capture: TactileCapture) -> ReportTable:
    """List what was captured and what was rendered, each beside the other."""
    made = press.provenance.created_utc if press.provenance else _DASH
    taken = capture.provenance.created_utc if capture.provenance else _DASH
    rows = [
        ("name", capture.name, press.name),
        ("what", capture.source, press.label),
        ("stored (UTC)", taken, made),
        ("image", _layout(capture), f"{press.contact.shape[1]} x {press.contact.shape[0]} px"),
        ("values", _encoding(capture.encoding), _encoding(press.encoding)),
        ("exposure", _unit(capture.exposure_s, "s"), "fitted, see above" if press.encoding == "linear" else _DASH),
        ("light angle", _with_u(capture.light_angle_deg, capture.light_angle_uncertainty_deg, "deg"),
         _unit(press.light_angle_deg, "deg")),
        ("LED current", _unit(capture.led_current_ma, "mA"), _DASH),
        ("indenter", *_indenter(capture.indenter, press)),
        ("scale, as the capture states it", _scale(capture), _DASH),
        ("finger", _DASH, "no design" if press.design is None else press.design.name),
    ]  # fmt: skip
    rows += [(f"{colour} paint", _DASH, f"SHA-256 {digest}") for colour, digest in sorted(press.paints.items())]
    return one_group("What was compared with what", ("item", "capture", "simulation"), rows, is_words=True)


def files_table(digests: Mapping[str, str], version: str) -> ReportTable:
    """List the files that went in, by content, and the version that read them."""
    rows = [("finray-calib", version), *((f"SHA-256 of {name}", digest) for name, digest in sorted(digests.items()))]
    return one_group("Program and input files", ("item", "value"), rows, is_words=True)


def scale_table(scale: PatchScale) -> ReportTable:
    """List millimetres per raw pixel along x and y at the patch and over patch and pad, and the regions' extents."""
    middle, patch, pad = scale.middle, scale.over_patch, scale.over_pad
    rows = [
        (
            "mm per pixel at the middle of the patch",
            _known(middle.along_x_mm_per_px, middle.along_x_u_rel * middle.along_x_mm_per_px),
            _known(middle.along_y_mm_per_px, middle.along_y_u_rel * middle.along_y_mm_per_px),
        ),
        *(
            (
                f"mm per pixel, range over the {name}",
                f"{over.along_x_low_mm_per_px:.4g} to {over.along_x_high_mm_per_px:.4g}",
                f"{over.along_y_low_mm_per_px:.4g} to {over.along_y_high_mm_per_px:.4g}",
            )
            for name, over in (("patch", patch), ("pad", pad))
        ),
        *(
            (
                f"{extent.region}, extent in mm",
                _known(extent.along_x_mm, extent.along_x_u_mm),
                _known(extent.along_y_mm, extent.along_y_u_mm),
            )
            for extent in scale.extents
        ),
    ]
    columns = ("length", "along x (rows)", "along y (columns)")
    return one_group("Scale of the capture's raw pixels on the pad", columns, rows, is_words=True)


def _known(value: float, u: float) -> str:
    """Return a value with its standard uncertainty, in its unit."""
    return f"{value:.4g} (u = {u:.2g})"


def _scale(capture: TactileCapture) -> str:
    """Return the scale that the capture carries."""
    u = (
        None
        if capture.mm_per_px is None or capture.mm_per_px_u_rel is None
        else (capture.mm_per_px * capture.mm_per_px_u_rel)
    )
    return _with_u(capture.mm_per_px, u, "mm per pixel")


def _layout(capture: TactileCapture) -> str:
    """Return size, layout and depth of a captured image."""
    height, width = capture.contact.shape[:2]
    return (
        f"{width} x {height} px, {capture.layout}, {capture.bit_depth} bit, black level {capture.black_level_dn:g} DN"
    )


def _encoding(encoding: str) -> str:
    """Return what the values mean."""
    return "linear light" if encoding == "linear" else "encoded, curve unknown"


def _unit(value: float | None, unit: str) -> str:
    """Return a value with its unit, or that it is not known."""
    return "not recorded" if value is None else f"{value:.4g} {unit}"


def _with_u(value: float | None, u: float | None, unit: str) -> str:
    """Return a value with its standard uncertainty where that is known."""
    text = _unit(value, unit)
    return text if value is None or u is None else f"{text} (u = {u:.2g} {unit})"


def _indenter(pose: IndenterPose, press: SimulatedPress) -> tuple[str, str]:
    """Return what was pressed, in the capture and in the simulation."""
    parts = [f"{pose.shape}, radius {pose.radius_mm:g} mm"]
    if pose.depth_mm is not None:
        parts.append(f"depth {_with_u(pose.depth_mm, pose.depth_uncertainty_mm, 'mm')}")
    if pose.position_mm is not None:
        parts.append(f"at {_with_u(pose.position_mm, pose.position_uncertainty_mm, 'mm')} along the pad")
    if pose.tilt_deg is not None:
        parts.append(f"tilt {_with_u(pose.tilt_deg, pose.tilt_uncertainty_deg, 'deg')}")
    if press.design is None:
        return "; ".join(parts), _DASH
    simulated = press.design.indenter
    return "; ".join(parts), f"{simulated.shape}, depth {simulated.depth_mm:g} mm"


def _sentence(text: str) -> str:
    """Return the text with a capital."""
    return text[:1].upper() + text[1:]
