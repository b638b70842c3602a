"""The section on the fit: emission against the truth, bands, prior and posterior, reflectance."""

from finray_calib.reports import statements
from finray_calib.reports.demo_results import COLOURS, DemoResults, PaintResult
from finray_calib.reports.fit_figures import bands_figure, emission_figure, marginals_figure, reflectance_figure
from finray_calib.reports.number_text import percent
from finray_calib.reports.report_tables import bands_table, fit_table
from finray_calib.reports.section import Content, Picture, drawing


def fit_section(results: DemoResults) -> Content:
    """Show the fitted emission against the truth, and how well the bands are explained."""
    paints = [results.paints[colour] for colour in COLOURS]
    makers = (_emission_picture, _bands_picture, _marginals_picture, _reflectance_picture)
    return Content(
        lead="The emission spectrum of each paint was inferred from its band signals: the posterior of the paper's "
        "skew-Cauchy curve, with the reflected laser and the leak of the filters as further unknowns.",
        picture_rows=tuple(tuple(make(paint) for paint in paints) for make in makers),
        remarks=tuple(f"{_name(p)}, sampler: {statements.chain_statement(p.calibration.diagnostics)}" for p in paints),
        tables=tuple(make(paint) for make in (fit_table, bands_table) for paint in paints),
    )


def _name(paint: PaintResult) -> str:
    """Return the paint's name at the start of a sentence."""
    return f"{paint.colour.capitalize()} paint"


def _emission_picture(paint: PaintResult) -> Picture:
    """Return the emission figure."""
    name = "measured" if paint.truth.is_measured else "true"
    return drawing(
        emission_figure(paint),
        statements.model_statement(paint),
        f"{_name(paint)}: fitted emission against the {name} one, for light at "
        f"{paint.bands.optics.laser.wavelength_nm:g} nm. What to see: the dashed line should run inside the bands.",
    )


def _bands_picture(paint: PaintResult) -> Picture:
    """Return the figure of measured against predicted bands."""
    return drawing(
        bands_figure(paint),
        f"{_name(paint)}, measured against predicted signal of each filter: {statements.bands_conclusion(paint)}.",
        f"{_name(paint)}: signals of the red, green and blue channel on their prediction (box), each \u00b1 2 sd; "
        "hollow ones are not used. What to see: nearly all differences should lie in the grey strip.",
    )


def _marginals_picture(paint: PaintResult) -> Picture:
    """Return the figure of prior and posterior."""
    return drawing(
        marginals_figure(paint),
        f"Prior and posterior of {len(paint.calibration.sampled)} parameters of the {paint.colour} paint; the mode is "
        f"narrowed to {statements.estimate_text(paint.calibration.parameters['mode_nm'], 'nm')}.",
        f"{_name(paint)}: what was believed before (hatched) and after (filled) the measurement. What to see: a filled "
        "peak much narrower than the hatching was set by the measurement, not by the prior.",
    )


def _reflectance_picture(paint: PaintResult) -> Picture:
    """Return the figure of the reflectance."""
    values = [value.estimate for value in paint.calibration.reflectance]
    return drawing(
        reflectance_figure(paint),
        f"Without fluorescence the {paint.colour} paint reflects {percent(min(values))} to {percent(max(values))} of "
        "the light, depending on the filter.",
        f"{_name(paint)}: radiance factor under the lamp by channel, and the reflectance without fluorescence. What to "
        f"see: points above the line carry fluorescence. Method: {paint.calibration.reflectance_method}.",
    )
