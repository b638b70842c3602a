"""What a comparison says, in plain sentences and tables, all of them computed from the report.

Every metric stands beside doing nothing and the floor, in light, and in normals and depth; then what each input adds to
the uncertainty, and every part of the image against it.
"""

import re
from collections.abc import Callable
from math import hypot, sqrt
from typing import Literal

from data_schemas import (
    CauseParameter,
    ErrorAttribution,
    ErrorRow,
    FittedToneCurve,
    Interval,
    PackagedMetric,
    PhotometricErrorReport,
    RecordError,
    RegionError,
    SensingError,
    SensingRow,
    ValidationCell,
    WhiteBalanceDrift,
)
from finray_calib.reports._page import Light, ReportTable, TableGroup, one_group
from finray_calib.reports._plain_text import (
    NO_VALUE,
    decimals_for,
    fixed,
    interval_name,
    interval_text,
    metric_value,
    percent,
    signed_percent,
    significant,
    skill_text,
)

Verdict = Literal[
    "As good as this capture can show",
    "Better than no simulation",
    "Not distinguishable from no simulation",
    "Worse than no simulation",
]
WELL_KNOWN = 0.9
"""A skill that may be below this is not called as good as the capture can show, wherever its interval ends."""
_PART_ROWS, _PART_COLUMNS = ("top", "middle", "bottom"), ("left", "centre", "right")


def judged_skill(low: float | None, high: float | None) -> tuple[Light, str]:
    """Return the light of a skill by its 95 % interval, and the reason."""
    if low is None or high is None:
        return "care", "one or two presses do not show how other presses would score"
    well = f"{WELL_KNOWN:g}"
    if low >= WELL_KNOWN:
        return "good", f"its interval lies above {well}; 1 is perfect"
    if low <= 0.0:
        where = "lies below" if high < 0.0 else "reaches"
        return "bad", f"its interval {where} 0, the score of an untouched image"
    where = "lies below" if high < WELL_KNOWN else "reaches below"
    return "care", f"its interval lies above 0, the score of an untouched image, but {where} {well}"


def headline(report: PhotometricErrorReport) -> RegionError:
    """Return the region that the report's headline score belongs to.

    Raises
    ------
    RecordError
        When the report holds no region of that name.
    """
    for region in report.regions:
        if region.region == report.headline_region:
            return region
    raise RecordError(
        f"photometric error report: the headline region '{report.headline_region}' is not among the regions of the "
        f"report ({', '.join(repr(r.region) for r in report.regions)}); run compare again"
    )


def row_of(region: RegionError, candidate: str) -> ErrorRow | None:
    """Return the row of one candidate; None when it is absent (no repeat image, no floor)."""
    return next((row for row in region.rows if row.candidate == candidate), None)


def comparison_verdict(report: PhotometricErrorReport) -> Verdict:
    """Return where the interval of the skill lies: below or about 0 (doing nothing), above it, or at the floor."""
    skill, floor = report.headline_skill, row_of(headline(report), "floor")
    if skill.high95 < 0:
        return "Worse than no simulation"
    if skill.low95 <= 0:
        return "Not distinguishable from no simulation"
    if floor is not None and skill.high95 >= floor.skill.low95 and skill.low95 >= WELL_KNOWN:
        return "As good as this capture can show"
    return "Better than no simulation"


def verdict_meaning(report: PhotometricErrorReport) -> str:
    """Say what the verdict lets the reader do."""
    skill, floor = report.headline_skill, row_of(headline(report), "floor")
    predicts = "all of what the touch changes, within the uncertainty of the skill."
    if skill.estimate < 1:
        left = percent(1 - skill.estimate)
        predicts = f"what the touch changes, but not all of it: {left} of the squared change remains unexplained."
    wide = ""
    if floor is not None and skill.high95 >= floor.skill.low95:
        wide = (
            f" The interval is wide: the simulation may be as good as the capture can show, or explain only "
            f"{percent(skill.low95)}."
        )
    meaning: dict[Verdict, str] = {
        "As good as this capture can show": "The difference between render and capture is no larger than that "
        "between two captures of the same touch. This capture could not "
        "distinguish a better simulation from this one.",
        "Better than no simulation": f"The simulation predicts {predicts} The error map shows where.{wide}",
        "Not distinguishable from no simulation": "This capture gives no reason to prefer the simulation to an image "
        "of the "
        "untouched pad. Do not rely on the simulated touch; look at the findings, the pose and the light first.",
        "Worse than no simulation": "An image of the untouched pad is nearer to the capture than the simulated touch. "
        "Do not rely on it; look at the findings, the pose and the light first.",
    }
    return meaning[comparison_verdict(report)]


def simulation_sentence(report: PhotometricErrorReport) -> str:
    """Say how much of what the touch changes in the image the simulation explains, against both bounds."""
    skill, floor = report.headline_skill, row_of(headline(report), "floor")
    score = skill_text(skill.estimate, skill.low95, skill.high95)
    if "[" in score and interval_name(report) != "95 %":
        score = f"{score} (over pixels of this press)"
    if report.relative:
        score = f"{score}, relative to the captured image without contact"
    if skill.high95 < 0:
        meaning = f"The simulated touch is worse than leaving the image unchanged: skill {score}"
    elif skill.low95 <= 0:
        meaning = f"The simulated touch is not distinguishable from an unchanged image: skill {score}"
    else:
        # with the noise taken out an estimate may lie above 1
        share = "all" if skill.estimate >= 1 else percent(skill.estimate)
        meaning = f"The simulated touch explains {share} of the squared change in the image: skill {score}"
    bound, taken_out = "no repeat was captured, so the camera's noise is unknown and lowers the score", ""
    if floor is not None:
        repeated = repeat_text(floor.skill.estimate)
        bound = f"a repeated capture scores {repeated}; the noise of encoded values stays in both scores"
    if floor is not None and is_noise_taken_out(report):
        bound = f"a repeated capture scores {repeated}, its noise taken out as well"
        taken_out = " (the camera's noise is taken out)"
    return (
        f"{meaning} over the region \u201c{report.headline_region}\u201d. Doing nothing scores 0, a perfect simulation "
        f"1{taken_out}; {bound}."
    )


def is_noise_taken_out(report: PhotometricErrorReport) -> bool:
    """Return whether the scores are free of the camera's noise: linear light, and a repeat to tell its noise from."""
    return report.values == "linear light" and row_of(headline(report), "floor") is not None


def level_a_sentence(report: PhotometricErrorReport, report_level_a: PhotometricErrorReport) -> str:
    """Say how the paper's emitter scores beside the default one."""
    default, paper = (
        skill_text(skill.estimate, skill.low95, skill.high95)
        for skill in (report.headline_skill, report_level_a.headline_skill)
    )
    return (
        "With the paper's emitter (walls textured by distance, the same from every angle) the skill over "
        f"\u201c{report_level_a.headline_region}\u201d is {paper}; with walls that re-emit the light reaching them "
        f"(the default) it is {default}."
    )


def repeat_text(skill: float) -> str:
    """Return the floor row's skill; what rounds to a perfect 1 is said to be above 0.999."""
    return "above 0.999" if skill > 0.999 else fixed(skill, 3)


def grid_phrase(report: PhotometricErrorReport) -> str:
    """Say over which pixels or blocks images were compared."""
    if report.block_px == 1:
        return "pixel by pixel"
    return f"over blocks of {report.block_px} x {report.block_px} px, which average out render noise"


def objective_sentence(report: PhotometricErrorReport) -> str | None:
    """Say how far the brightness beside the indenter is off; None where it was not measured."""
    if report.objective_error is None:
        return None
    error = report.objective_error.error_rel
    low, high = signed_percent(error.low95), signed_percent(error.high95)
    if error.low95 <= 0 <= error.high95:
        return (
            f"Beside the indenter no difference in brightness is seen: {signed_percent(error.estimate)}, 95 %: {low} "
            f"to {high}. This is what 'finray decide' takes from this comparison."
        )
    side = "brighter" if error.estimate > 0 else "darker"
    return (
        f"Beside the indenter the simulation is {percent(abs(error.estimate))} {side} than the capture (95 %: {low} "
        f"to {high}). This is what 'finray decide' takes from this comparison."
    )


def validation_sentence(cells: tuple[ValidationCell, ...]) -> str | None:
    """Say in how many parts the level agrees, and where it is worst; None without cells."""
    if not cells:
        return None
    within = sum(cell.within for cell in cells)
    if within == len(cells):
        return f"Level by part: all {within} parts and channels agree within the validation uncertainty."
    worst = max((cell for cell in cells if not cell.within), key=lambda cell: abs(cell.error_rel))
    return (
        f"Level by part: {within} of {len(cells)} parts and channels agree within the validation uncertainty; the "
        f"largest error outside it is {signed_percent(worst.error_rel)} in {worst.channel}, {place(worst)}."
    )


def place(cell: ValidationCell) -> str:
    """Return where in the image a cell lies."""
    return f"{_PART_ROWS[cell.row]} {_PART_COLUMNS[cell.column]}"


def coverage(report: PhotometricErrorReport) -> str:
    """Return what the intervals cover; older records hold a part of a sentence in place of one."""
    text = f"{report.interval_covers.rstrip('.')}."
    is_sentence = re.match("(the|these) ([0-9]+ % )?intervals ", text, re.IGNORECASE)
    return f"{text[0].upper()}{text[1:]}" if is_sentence else f"The intervals cover {text}"


def limits(report: PhotometricErrorReport) -> tuple[str, ...]:
    """Return what the numbers do not know: reach of the intervals, withheld figures, findings of the checks."""
    told = [coverage(report)]
    if report.monte_carlo is not None:
        run = report.monte_carlo
        told += [f"Not in the intervals: {reason.rstrip('.')}." for reason in run.not_included]
        if run.significant_digits == 0:
            told.append(
                f"The Monte Carlo run of {run.draws} draws ended before the uncertainty was steady to one significant "
                "digit, so the ends of the interval may change with another seed."
            )
    skills = (report.headline_skill, *(row.skill for region in report.regions for row in region.rows))
    if any(skill.low95 > 1 for skill in skills):
        told.append(
            "An interval of a skill that lies entirely above 1 means that model and noise disagree: render and "
            "capture differ by less than the noise that was subtracted. Either this noise is overestimated, or the "
            "capture was used to make the render."
        )
    if any(skill.high95 > 1 >= skill.low95 for skill in skills):
        told.append(
            "An interval of a skill can reach above 1 because of noise: noise is subtracted, and the result scatters "
            "about the true skill, which cannot exceed 1."
        )
    if report.tone_curve is not None:
        told.append(
            "The render contains linear light, but the capture contains encoded values. A tone curve that was fitted "
            "to the images without contact converts the render, and scores compare code values."
        )
    elif report.values != "linear light":
        told.append(
            "The images hold encoded values of an unknown camera curve, not light, so scores compare code values only."
        )
    told += [f"Withheld: {reason.rstrip('.')}." for reason in report.withheld]
    told += [f"Check: {finding.rstrip('.')}." for finding in report.findings]
    return tuple(told)


def exposure_sentence(report: PhotometricErrorReport) -> str:
    """Say whether the render was scaled, and by what."""
    if report.tone_curve is not None:
        return "The render enters as the ratio of its images with and without contact, through the fitted tone curve."
    if report.exposure_factor is None:
        return "The render was not scaled."
    sd = report.exposure_factor_sd
    known = "" if sd is None or sd <= 0 else f", known to {percent(sd / report.exposure_factor)} (standard uncertainty)"
    return (
        f"The render was multiplied by one exposure factor, the same for all channels{known}. No other correction was "
        "fitted, so an error of a paint or of the light stays visible."
    )


def tone_sentence(curve: FittedToneCurve) -> str:
    """Say which tone curve was fitted, what it rests on and what it adds to the uncertainty."""
    p = curve.exponent
    rests = f"The two images without contact agree in pattern by a correlation of {fixed(curve.correlation, 2)}"
    if curve.correlation < _LITTLE_CORRELATION:
        rests += ", so the exponent comes mostly from what is usual for 8-bit cameras (0.45 +- 0.05, or linear)"
    beyond = ""
    if curve.outside_share > _TOLD_SHARE:
        beyond = (
            f" {percent(curve.outside_share)} of the scored pixels have a level that does not occur without contact: "
            "there the curve is an extrapolation."
        )
    return (
        f"Camera values follow light to the power {fixed(p.estimate, 2)} (95 %: {fixed(p.low95, 2)} to "
        f"{fixed(p.high95, 2)}); this exponent and the gains add {significant(curve.skill_u, 2)} to the standard "
        f"uncertainty of the skill. {rests}. A gain common to both captured images cannot be known, and does not "
        f"enter.{beyond}"
    )


_LITTLE_CORRELATION, _TOLD_SHARE = 0.7, 0.01


def white_balance_sentence(drift: WhiteBalanceDrift) -> str:
    """Say which channel changed most between the captured images, and whether that was taken out."""
    known = [c for c in range(3) if drift.blocks[c] > 0]
    if not known:
        return "It is not known whether the white balance changed between the captured images."
    worst = max(known, key=lambda c: abs(drift.gains[c] / drift.expected_gains[c] - 1.0))
    gain, expected = drift.gains[worst], drift.expected_gains[worst]
    done = "This change was not taken out."
    if drift.corrected:
        done = "Each side was divided by its own gain, so that an unchanged image with such a gain scores 0."
    return (
        f"Far from the contact, capture and simulation differ most in {CHANNELS[worst]}: the capture changes by "
        f"{signed_percent(gain - 1.0)}, the simulation by {signed_percent(expected - 1.0)} (standard uncertainty "
        f"{percent(drift.u_rel[worst])}). {done}"
    )


def between(value: Interval) -> str:
    """Return the ends of an interval of an angle, or that there is none."""
    if value.low95 == value.high95:
        return "without an interval: no input with a known uncertainty changes it"
    places = max(1, min(decimals_for((value.high95 - value.low95) / 2.0), 3))
    if fixed(value.low95, places) == fixed(value.high95, places):
        return "95 %: less than 0.001 deg to either side"
    return f"95 %: {fixed(value.low95, places)} to {fixed(value.high95, places)} deg"


def scale_sentences(report: PhotometricErrorReport) -> tuple[str, ...]:
    """Say how large the contact patch is on the pad; nothing where the scale was not given."""
    scale = report.patch_scale
    if scale is None:
        return ()
    middle, patch = scale.middle, scale.extents[0]
    return (
        f"At the patch a raw pixel spans {middle.along_x_mm_per_px:.4g} mm along x and {middle.along_y_mm_per_px:.4g} "
        f"mm along y (standard uncertainties {percent(middle.along_x_u_rel)} and {percent(middle.along_y_u_rel)}); the "
        f"{patch.region} of the render is {patch.along_x_mm:.3g} mm by {patch.along_y_mm:.3g} mm.",
    )


def error_alternative(report: PhotometricErrorReport, typical_rel: float, large_rel: float) -> str:
    """Say in words what the error map shows."""
    skill = report.headline_skill
    return (
        f"Map of the error of the simulation: half of the pixels are wrong by less than {percent(typical_rel)} of the "
        f"untouched level, and one in twenty by more than {percent(large_rel)}. Skill {fixed(skill.estimate, 2)}."
    )


CHANNELS = ("red", "green", "blue")
_CANDIDATES = ("do nothing", "simulation", "floor")
_METRIC_COLUMNS = ("metric", "do nothing", "simulation", "floor (a repeat)", "better is")
_Cell = Callable[[ErrorRow], str | None]


def metric_table(report: PhotometricErrorReport, region: RegionError) -> ReportTable:
    """List every metric of one region for the three candidates; metrics that nobody has are left out."""
    groups = [TableGroup(title, _rows(region, rows)) for title, rows in _METRICS]
    if region.region == report.headline_region:
        shown = (_number(report.ssim_full_frame.get(name), 3) or NO_VALUE for name in _CANDIDATES)
        paper = groups[-1]
        row = ("SSIM of the whole frame", *shown, "higher; says little")
        groups[-1] = TableGroup(paper.heading, (*paper.rows, row))
    return ReportTable(_sentence(region_heading(report, region)), _METRIC_COLUMNS, tuple(g for g in groups if g.rows))


def packaged_metric_table(metrics: tuple[PackagedMetric, ...]) -> ReportTable:
    """List the metrics that other packages bring, for the three candidates."""
    groups = []
    for metric in metrics:
        shown: dict[str, str] = {row.candidate: metric_value(row, metric) for row in metric.rows}
        values = [shown.get(name, NO_VALUE) for name in _CANDIDATES]
        over = f", interval over {metric.draws} draws of the inputs" if metric.draws else ", without an interval"
        groups.append(TableGroup(metric.package, ((f"{metric.name}: {metric.words}{over}", *values, metric.better),)))
    return ReportTable("Metrics of other packages", _METRIC_COLUMNS, tuple(groups))


def tone_table(curve: FittedToneCurve) -> ReportTable:
    """List what was fitted between render and capture."""
    red, green, blue = curve.white_balance
    rows = [("exponent of the tone curve", _interval(curve.exponent)), ("offset (DN)", _interval(curve.offset_dn))]
    named = zip(CHANNELS, (red, green, blue), strict=True)
    rows += [
        (f"white balance in light, {name} / green", None if value is None else _interval(value))
        for name, value in named
        if name != "green"
    ]
    return one_group(
        "Fitted to the images without contact alone; the white balance cancels in the score.",
        ("quantity", "value"),
        tuple((name, text or NO_VALUE) for name, text in rows),
    )


def white_balance_table(drift: WhiteBalanceDrift) -> ReportTable:
    """List the gains far from the contact."""
    rows = []
    for c, name in enumerate(CHANNELS):
        if drift.blocks[c] == 0:
            rows.append((name, NO_VALUE, NO_VALUE, NO_VALUE, NO_VALUE))
            continue
        rows.append(
            (
                name,
                fixed(drift.gains[c], 3),
                fixed(drift.expected_gains[c], 3),
                percent(drift.u_rel[c]),
                percent(drift.uneven_rel[c]),
            )
        )
    return one_group(
        "Contact / no contact, beyond 3 half-widths from the contact.",
        ("channel", "captured", "simulated", "standard uncertainty", "change across the picture"),
        tuple(rows),
    )


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
    return one_group("Normals and depth from render and capture, over the headline region.", _METRIC_COLUMNS, body)


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


def error_table(report: PhotometricErrorReport, report_level_a: PhotometricErrorReport | None = None) -> ReportTable:
    """List do nothing, simulation, the paper's emitter where it was rendered, and floor for every region."""
    paper = {} if report_level_a is None else {region.region: region for region in report_level_a.regions}
    groups = tuple(
        TableGroup(region_heading(report, region), _region_rows(region, paper.get(region.region)))
        for region in report.regions
    )
    columns = (
        "candidate",
        f"skill [{interval_name(report)}]",
        "skill R, G, B",
        "relative RMS R, G, B",
        "PSNR (dB)",
        "SSIM",
    )
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
    known = [line.objective_u_rel for line in lines if line.objective_u_rel is not None]
    objective = percent(hypot(*known)) if known else NO_VALUE
    rows.append(("root of the sum of squares", significant(total, 2), "100 %", objective, NO_VALUE))
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


def causes_sentence(found: ErrorAttribution) -> str:
    """Say what most of the skill is lost by."""
    if found.skill_lost <= 0.0:  # noise is subtracted from the squared error
        return f"No skill is lost: 1 - skill is {fixed(found.skill_lost, 3)}, so that no cause has a share of a loss."
    lost = f"A skill of {fixed(found.skill_lost, 3)} is lost"
    if not found.causes:
        return f"{lost}; no small change of the simulation explains any part of it."
    first, share = found.causes[0], found.causes[0].skill_lost / found.skill_lost
    return (
        f"{lost}, {fixed(first.skill_lost, 3)} of it by {first.cause} ({percent(share)}). Each picture shows what one "
        "cause changes in the image, relative to the untouched level."
    )


def causes_table(found: ErrorAttribution) -> ReportTable:
    """List every cause with its size and what it costs, and what is left, so that the parts add up."""
    rows: list[tuple[str, ...]] = [
        (
            cause.cause,
            "; ".join(_parameter_text(p) for p in cause.parameters),
            fixed(cause.skill_lost, 3),
            fixed(cause.skill_regained, 3),
            ", ".join(cause.like) or NO_VALUE,
        )
        for cause in found.causes
    ]
    rest = (
        ("saturation", "pixels that are nearly clipped in the simulation", found.saturation_skill),
        ("noise", "noise of the capture, estimated from neighbouring pixels", found.noise_skill),
        ("remainder", "error that none of these explains", found.remainder_skill),
        ("sum", "1 - skill", found.skill_lost),
    )
    rows += [(name, what, fixed(value, 3), NO_VALUE, NO_VALUE) for name, what, value in rest]
    columns = ("cause", "size, with standard uncertainty", "skill lost", "regained if repaired alone", "looks like")
    return one_group("What the lost skill is due to", columns, rows, is_words=True)


def causes_remarks(found: ErrorAttribution) -> tuple[str, ...]:
    """Return what the attribution does not know."""
    told = ["The parts add up; a part may be below 0 where causes work against each other."]
    if any(cause.like for cause in found.causes):
        told.append(
            "One image alone does not separate causes that look alike: their sum is known, the share of each is not. "
            "Presses at other depths and places separate them."
        )
    if found.skill_lost > 0.0 and found.remainder_skill > 0.5 * found.skill_lost:
        told.append("More than half of the loss is not explained by any of these causes: look at the error map.")
    return tuple(told)


def _parameter_text(parameter: CauseParameter) -> str:
    """Return a parameter with its standard uncertainty."""
    if parameter.unit == "1":
        return f"{parameter.name} {signed_percent(parameter.value)} (u {percent(parameter.u)})"
    return f"{parameter.name} {significant(parameter.value, 2)} {parameter.unit} (u {significant(parameter.u, 2)})"
