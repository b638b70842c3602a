"""The six sections of the demo's report: one sentence, figures with their conclusion, tables."""

from finray_calib.reports import trust
from finray_calib.reports.decide_figures import angle_figure
from finray_calib.reports.demo_results import COLOURS, STAGES, DemoResults
from finray_calib.reports.fit_section import fit_section
from finray_calib.reports.number_text import duration
from finray_calib.reports.report_tables import capture_table, decision_table, signals_table
from finray_calib.reports.section import Content, Section, drawing, raster
from finray_calib.reports.touch_sections import compare_section, simulate_section


def sections(results: DemoResults) -> tuple[Section, ...]:
    """Return the six stages of a run in order, with their figures and tables."""
    makers = (_capture, _radiometry, fit_section, simulate_section, compare_section, _decide)
    return tuple(
        Section(stage, duration(results.stage_wall_times_s[stage]), make(results))
        for stage, make in zip(STAGES, makers, strict=True)
    )


def _capture(results: DemoResults) -> Content:
    """Show what the rig saw."""
    rig = results.paints["red"].session.rig
    pictures = tuple(
        raster(
            paint.room_light_rgb8,
            f"The {paint.colour} paint sample under room light, as the camera of the rig saw it.",
            f"\u201c{paint.calibration.paint_name}\u201d under room light, as the camera sees it (preview)",
        )
        for paint in (results.paints[colour] for colour in COLOURS)
    )
    return Content(
        lead=f"Each paint was photographed raw through {len(rig.filter_wheel.filters)} band-pass filters, under the "
        f"{rig.laser.wavelength_nm:g} nm laser and under the white lamp, with dark frames and a white reference.",
        picture_rows=(pictures,),
        tables=(capture_table(results),),
    )


def _radiometry(results: DemoResults) -> Content:
    """Show the band signals."""
    paints = [results.paints[colour] for colour in COLOURS]
    pixels = " and ".join(f"{paint.bands.region_pixels}" for paint in paints)
    return Content(
        lead=f"The frames became one value per filter and channel over the painted regions ({pixels} pixels): "
        "dark-subtracted, per second of exposure, relative to the white reference, with their full covariance.",
        remarks=tuple(
            f"{paint.colour.capitalize()} paint: {int((~paint.bands.usable()).sum())} of {paint.bands.usable().size} "
            "values are flagged and not used by the fit."
            for paint in paints
        ),
        tables=tuple(signals_table(paint.fitted) for paint in paints),
    )


def _decide(results: DemoResults) -> Content:
    """Show the objective over the angle."""
    decision, sweep = results.decision, results.sweep
    picture = drawing(
        angle_figure(decision, sweep, results.true_sweep),
        f"The objective over the light angle is best near {decision.angle_deg:.0f} deg. {decision.sentence}",
        "Objective over the angle of the blue light: 0 deg along the pad, 90 deg straight into it. What to see: where "
        "the curve is flat the angle matters little; hatched angles do as well as the chosen one.",
    )
    return Content(
        lead=f"Objective: {decision.objective}. It was rendered at {len(sweep.angles_deg)} angles with "
        f"{sweep.values.shape[1]} repeats that share their random draws; a smooth random curve through them gives the "
        "probability of each angle.",
        picture_rows=((picture,),),
        remarks=(trust.validation_statement(decision),),
        tables=(decision_table(decision),),
    )
