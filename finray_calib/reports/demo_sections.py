"""The six sections of the demo's report: one sentence, figures with their conclusion, tables."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from finray_calib.reports import statements
from finray_calib.reports.compare_figures import error_map_figure, score_figure
from finray_calib.reports.decide_figures import angle_figure
from finray_calib.reports.demo_results import COLOURS, STAGES, DemoResults, PaintResult, headline
from finray_calib.reports.fit_figures import bands_figure, emission_figure, marginals_figure, reflectance_figure
from finray_calib.reports.images import capture_rgb, display_white, png_data_uri, to_display, with_outline
from finray_calib.reports.number_text import duration, interval_text, percent
from finray_calib.reports.report_tables import (
    ReportTable,
    bands_table,
    capture_table,
    decision_table,
    error_table,
    fit_table,
    signals_table,
)
from finray_calib.reports.style import svg_data_uri


@dataclass(frozen=True, slots=True)
class Picture:
    """An image inside the page; the alternative text carries its conclusion."""

    source: str
    alternative: str
    caption: str
    is_raster: bool = False


@dataclass(frozen=True, slots=True)
class Section:
    """One stage of the report."""

    stage: str
    wall_time: str
    lead: str
    picture_rows: tuple[tuple[Picture, ...], ...]
    tables: tuple[ReportTable, ...]
    remarks: tuple[str, ...] = ()


def sections(results: DemoResults) -> tuple[Section, ...]:
    """Return the six stages of a run in order, with their figures and tables."""
    makers = (_capture, _radiometry, _fit, _simulate, _compare, _decide)
    return tuple(
        Section(stage, duration(results.stage_wall_times_s[stage]), *make(results))
        for stage, make in zip(STAGES, makers, strict=True)
    )


Content = tuple[str, tuple[tuple[Picture, ...], ...], tuple[ReportTable, ...], tuple[str, ...]]


def _capture(results: DemoResults) -> Content:
    """Show what the rig saw."""
    rig = results.paints["red"].session.rig
    lead = (
        f"Each paint was photographed raw through {len(rig.filter_wheel.filters)} band-pass "
        f"filters, under the {rig.laser.wavelength_nm:g} nm laser and under the white lamp, with dark frames and a "
        "white reference."
    )
    images = tuple(
        _image(
            paint.room_light_rgb8,
            f"The {paint.colour} paint sample under room light, as the camera of the rig saw it.",
            f"\u201c{paint.calibration.paint_name}\u201d under room light (preview)",
        )
        for paint in (results.paints[colour] for colour in COLOURS)
    )
    return lead, (images,), (capture_table(results),), ()


def _radiometry(results: DemoResults) -> Content:
    """Show the band signals."""
    paints = [results.paints[colour] for colour in COLOURS]
    pixels = " and ".join(f"{paint.bands.region_pixels}" for paint in paints)
    lead = (
        f"The frames became one value per filter and channel over the painted regions ({pixels} pixels): "
        "dark-subtracted, per second of exposure, relative to the white reference, with their full covariance."
    )
    flagged = [
        f"{paint.colour.capitalize()} paint: {int((~paint.bands.usable()).sum())} of {paint.bands.usable().size} "
        "values are flagged and not used by the fit."
        for paint in paints
    ]
    return lead, (), tuple(signals_table(paint) for paint in paints), tuple(flagged)


def _fit(results: DemoResults) -> Content:
    """Show the fitted emission against the truth, and how well the bands are explained."""
    paints = [results.paints[colour] for colour in COLOURS]
    lead = (
        "The emission spectrum of each paint was inferred from its band signals: the posterior of the paper's "
        "skew-Cauchy curve, with the reflected laser and the leak of the filters as further unknowns."
    )
    makers = (_emission_picture, _bands_picture, _marginals_picture, _reflectance_picture)
    picture_rows = tuple(tuple(make(paint) for paint in paints) for make in makers)
    tables = tuple(make(paint) for make in (fit_table, bands_table) for paint in paints)
    remarks = tuple(
        f"{p.colour.capitalize()} paint, sampler: {statements.chain_statement(p.calibration.diagnostics)}"
        for p in paints
    )
    return lead, picture_rows, tables, remarks


def _emission_picture(paint: PaintResult) -> Picture:
    """Return the emission figure."""
    name = "measured" if paint.truth.is_measured else "true"
    return Picture(
        svg_data_uri(emission_figure(paint)),
        statements.model_statement(paint),
        f"{paint.colour.capitalize()} paint: fitted emission against the {name} one, for light at "
        f"{paint.bands.optics.laser.wavelength_nm:g} nm",
    )


def _bands_picture(paint: PaintResult) -> Picture:
    """Return the figure of measured against predicted bands."""
    return Picture(
        svg_data_uri(bands_figure(paint)),
        f"{paint.colour.capitalize()} paint, measured against predicted signal of each filter: "
        f"{statements.bands_conclusion(paint)}.",
        f"{paint.colour.capitalize()} paint: signals of the red, green and blue channel (\u00b1 2 sd) on their "
        "posterior prediction (box, \u00b1 2 sd). Hollow: not used; what lies below the axis is drawn at its foot",
    )


def _marginals_picture(paint: PaintResult) -> Picture:
    """Return the figure of prior and posterior."""
    return Picture(
        svg_data_uri(marginals_figure(paint)),
        f"Prior and posterior of {len(paint.calibration.sampled)} parameters of the {paint.colour} paint; the mode is "
        f"narrowed to {statements.estimate_text(paint.calibration.parameters['mode_nm'], 'nm')}.",
        f"{paint.colour.capitalize()} paint: what was believed before (hatched) and after (filled) the measurement, "
        "each scaled to its own peak",
    )


def _reflectance_picture(paint: PaintResult) -> Picture:
    """Return the figure of the reflectance."""
    values = [value.estimate for value in paint.calibration.reflectance]
    return Picture(
        svg_data_uri(reflectance_figure(paint)),
        f"Without fluorescence the {paint.colour} paint reflects {percent(min(values))} to {percent(max(values))} of "
        "the light, depending on the filter.",
        f"{paint.colour.capitalize()} paint: radiance factor under the lamp by channel, and the reflectance without "
        f"fluorescence ({paint.calibration.reflectance_method})",
    )


def _simulate(results: DemoResults) -> Content:
    """Show the two renders."""
    press, sweep = results.press, results.sweep
    lead = (
        f"The finger, untouched and pressed{_at_angle(press.light_angle_deg)}: {press.label}. "
        f"Then the light was swept: {sweep.label}."
    )
    white, linear = display_white(press.no_contact), press.encoding == "linear"
    touch = press.distance <= headline(results.report).factor
    images = (
        _image(
            to_display(press.no_contact, white, linear),
            "Simulated image of the untouched pad.",
            "Simulated, no contact",
        ),
        _image(
            with_outline(to_display(press.contact, white, linear), touch),
            "Simulated image of the pressed pad, with the region of the headline score outlined.",
            "Simulated, contact; outlined: the region that is scored",
        ),
    )
    return lead, (images,), (), (_display_remark(linear),)


def _at_angle(angle_deg: float | None) -> str:
    """Return the light angle in words, or nothing."""
    return "" if angle_deg is None else f" with the light at {angle_deg:g} deg"


def _display_remark(linear: bool) -> str:
    """Say what was done to the images for the screen."""
    if linear:
        return (
            "Images are white-balanced per channel on the untouched pad and brightened for the screen (sRGB); capture "
            "and render each by their own white. The numbers use the linear values without any such balance."
        )
    return "Images hold encoded values; for the screen they are only scaled."


def _compare(results: DemoResults) -> Content:
    """Show capture, render, error map and scores."""
    report, press, capture = results.report, results.press, results.capture
    lead = (
        f"The render was compared with the capture \u201c{capture.name}\u201d pixel by pixel, "
        f"{_exposure_sentence(results)}. Beside it stand two candidates that need no simulation: leaving the image "
        "unchanged (do nothing), and repeating the capture (floor)."
    )
    before, touched = (capture_rgb(capture, image) for image in (capture.no_contact, capture.contact))
    white, linear = display_white(before), capture.encoding == "linear"
    outline = press.distance <= headline(report).factor
    simulated = to_display(press.contact, display_white(press.no_contact), press.encoding == "linear")
    sentence = statements.simulation_sentence(report)
    images = (
        _image(to_display(before, white, linear), "Captured image of the untouched pad.", "Captured, no contact"),
        _image(
            with_outline(to_display(touched, white, linear), outline),
            "Captured image of the pressed pad, with the scored region outlined.",
            "Captured, contact; outlined: the region that is scored",
        ),
        _image(
            with_outline(simulated, outline), f"Simulated image of the pressed pad. {sentence}", "Simulated, contact"
        ),
    )
    drawings = (
        Picture(
            svg_data_uri(error_map_figure(report, outline)),
            _error_alternative(results),
            "Where simulation and capture differ (RMS over the channels, relative to the mean untouched level); "
            "outlined: the region that is scored",
        ),
        Picture(svg_data_uri(score_figure(report)), sentence, "Skill by region, with 95 % intervals"),
    )
    return lead, (images, drawings), (error_table(report),), (_display_remark(linear),)


def _image(rgb8: NDArray[np.uint8], alternative: str, caption: str) -> Picture:
    """Return a raster image as a picture."""
    return Picture(png_data_uri(rgb8), alternative, caption, is_raster=True)


def _exposure_sentence(results: DemoResults) -> str:
    """Say whether the render was scaled."""
    factor, sd = results.report.exposure_factor, results.report.exposure_factor_sd
    if factor is None:
        return "without any scaling"
    spread = 0.0 if sd is None else 2 * sd
    return f"after one exposure factor for all channels, {interval_text(factor, factor - spread, factor + spread)}"


def _error_alternative(results: DemoResults) -> str:
    """Say in words what the error map shows."""
    error = np.abs(results.report.error_map)
    typical, large = np.nanmedian(error), np.nanpercentile(error, 95)
    return (
        f"Map of the error: half of the pixels err by less than {percent(float(typical))}, one in twenty by more "
        f"than {percent(float(large))}."
    )


def _decide(results: DemoResults) -> Content:
    """Show the objective over the angle."""
    decision, sweep = results.decision, results.sweep
    lead = (
        f"Objective: {decision.objective}. It was rendered at {len(sweep.angles_deg)} angles with "
        f"{sweep.values.shape[1]} repeats that share their random draws; "
        "a smooth random curve through them gives the probability of each angle."
    )
    picture = Picture(
        svg_data_uri(angle_figure(decision, sweep, results.true_sweep)),
        f"The objective over the light angle is best near {decision.angle_deg:.0f} deg. {decision.sentence}",
        "Objective over the angle of the blue light: 0 deg along the pad, 90 deg straight into it",
    )
    return lead, ((picture,),), (decision_table(results),), (statements.validation_statement(decision),)
