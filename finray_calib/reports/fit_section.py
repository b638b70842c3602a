"""The section on the fit, for one paint or several side by side."""

from collections.abc import Callable, Sequence

from finray_calib.reports import fit_statements as said
from finray_calib.reports import fit_tables as tables
from finray_calib.reports.band_figures import bands_figure, reflectance_figure
from finray_calib.reports.demo_results import COLOURS, DemoResults
from finray_calib.reports.fit_figures import absorption_figure, emission_figure, families_figure, marginals_figure
from finray_calib.reports.fitted_paint import FittedPaint
from finray_calib.reports.number_text import estimate_text, percent
from finray_calib.reports.section import Content, Part, Picture, drawing

Paints = Sequence[FittedPaint]


def fit_section(results: DemoResults) -> Content:
    """Show the fits of both paints of a run."""
    paints = [results.paints[colour].fitted for colour in COLOURS]
    return Content(
        lead="The emission spectrum of each paint was inferred from its band signals. Several families of curves were "
        "fitted, each with a smooth random deviation (discrepancy) for what a real paint does beyond its family, with "
        "the reflected laser and the imperfections of the filters as further unknowns.",
        parts=fit_parts(paints),
    )


def fit_parts(paints: Paints) -> tuple[Part, ...]:
    """Return emission, families, bands, absorption and reflectance, then prior and sampling as details."""
    return (
        Part("Emission", _emission(paints)),
        Part("Families of curves", _families(paints)),
        Part("Measured against predicted bands", _bands(paints)),
        Part("Absorption", _absorption(paints)),
        Part("Reflectance", _reflectance(paints)),
        Part("Prior beliefs", _prior(paints), is_detail=True),
        Part("Sampling", _sampling(paints), is_detail=True),
    )


def _row(paints: Paints, make: Callable[[FittedPaint], Picture]) -> tuple[tuple[Picture, ...], ...]:
    """Return one picture of each paint in a row."""
    return (tuple(make(paint) for paint in paints),)


def _emission(paints: Paints) -> Content:
    """Show the emission, the paper's curve beside it, and the truth where it is known."""
    laser_nm = paints[0].fit.optics.laser.wavelength_nm
    return Content(
        lead=f"What the paint emits at each wavelength for light at {laser_nm:g} nm, per nm of emission, relative to a "
        "perfect diffuse white.",
        picture_rows=_row(paints, _emission_picture),
        tables=tuple(tables.quantities_table(paint) for paint in paints),
        has_wide_tables=True,
    )


def _emission_picture(paint: FittedPaint) -> Picture:
    """Return the emission figure."""
    if paint.truth is None:
        conclusion = said.paint_sentence(paint)
        seen = "between the filters the bands widen, because nothing was measured there"
    else:
        conclusion = said.model_statement(paint, paint.truth)
        seen = "the dashed line should run inside the bands"
    text = f"fitted emission, and the paper's curve fitted to the same bands. What to see: {seen}."
    return drawing(emission_figure(paint), conclusion, paint.titled(text))


def _families(paints: Paints) -> Content:
    """Show what each family makes of the same bands."""
    return Content(
        lead="Each family is a different idea of what an emission curve looks like. Evidence and probability say how "
        "well a family predicts the bands before seeing them, all equally likely beforehand. The score of the left-out "
        "bands says how well each band is predicted from the others: higher is better, \u00b1 is the standard error of "
        "the difference to the default family, and scores with \u2248 are only indicative (Pareto k above 0.7).",
        picture_rows=_row(paints, _families_picture),
        remarks=tuple(said.family_statement(paint) for paint in paints),
        tables=tuple(tables.families_table(paint) for paint in paints),
        has_wide_tables=True,
    )


def _families_picture(paint: FittedPaint) -> Picture:
    """Return the figure of all families."""
    return drawing(
        families_figure(paint),
        said.family_statement(paint),
        paint.titled("mean emission by each family. What to see: where the lines part, the choice of family matters."),
    )


def _bands(paints: Paints) -> Content:
    """Show how well each band is explained."""
    return Content(
        lead="The prediction is the family's curve seen through each filter, with the spread that discrepancy and "
        "filters allow. The predictive p is the probability of a larger misfit if the model is right; a band below "
        "0.01 is not explained. The pull is the filter's calibration error in units of its assumed uncertainty: "
        "0 \u00b1 1 means that these data say nothing about it.",
        picture_rows=_row(paints, _bands_picture),
        tables=tuple(tables.bands_table(paint) for paint in paints),
        has_wide_tables=True,
    )


def _bands_picture(paint: FittedPaint) -> Picture:
    """Return the figure of measured against predicted bands."""
    return drawing(
        bands_figure(paint),
        f"{paint.titled('measured against predicted signal of each filter')}: {said.bands_conclusion(paint)}.",
        paint.titled(
            "signals of the red, green and blue channel on their prediction (box), each \u00b1 2 sd; hollow ones are "
            f"not used. What to see: nearly all differences should lie in the grey strip. Here "
            f"{said.bands_conclusion(paint)}."
        ),
    )


def _absorption(paints: Paints) -> Content:
    """Show what is known and believed of the absorption."""
    return Content(
        lead="How strongly other blue and green light would excite the paint, relative to the laser.",
        picture_rows=_row(paints, _absorption_picture),
        remarks=tuple(said.absorption_statement(paint) for paint in paints),
        tables=tuple(tables.absorption_table(paint) for paint in paints),
    )


def _absorption_picture(paint: FittedPaint) -> Picture:
    """Return the figure of the absorption."""
    seen = (
        "the wide band is what measured paints do, not a measurement of this one; it is known at the dashed line only"
    )
    if not paint.fit.reradiation.prior_driven:
        seen = "the band narrows at the measured lights (dashed)"
    text = f"photons absorbed relative to the laser line, mean and 95 % band. What to see: {seen}."
    return drawing(absorption_figure(paint), said.absorption_statement(paint), paint.titled(text))


def _reflectance(paints: Paints) -> Content:
    """Show the reflectance without fluorescence."""
    return Content(
        lead="What the paint sends back without changing the wavelength, at each filter.",
        picture_rows=_row(paints, _reflectance_picture),
    )


def _reflectance_picture(paint: FittedPaint) -> Picture:
    """Return the figure of the reflectance."""
    values = [value.estimate for value in paint.fit.reflectance]
    return drawing(
        reflectance_figure(paint),
        f"Without fluorescence {paint.subject} reflects {percent(min(values))} to {percent(max(values))} of the light, "
        "depending on the filter.",
        paint.titled(
            "radiance factor under the lamp by channel, and the reflectance without fluorescence. What to see: points "
            f"above the line carry fluorescence. Method: {paint.fit.reflectance_method}."
        ),
    )


def _prior(paints: Paints) -> Content:
    """Show what was believed, and how much the answer owes to it."""
    discrepancy = paints[0].fit.discrepancy
    return Content(
        lead=f"Discrepancy: {percent(discrepancy.amplitude_rel)} of the curve with a correlation length of "
        f"{discrepancy.length_nm:g} nm, on {percent(discrepancy.floor_rel)} of the peak as a floor, and "
        f"{percent(discrepancy.reabsorption_rel)} of re-absorption at the blue edge. Origin: {discrepancy.origin}.",
        picture_rows=_row(paints, _marginals_picture),
        remarks=tuple(said.prior_statement(paint) for paint in paints),
        tables=tuple(tables.prior_table(paint) for paint in paints),
    )


def _marginals_picture(paint: FittedPaint) -> Picture:
    """Return the figure of prior and posterior."""
    mode = estimate_text(paint.fit.parameters["mode_nm"], "nm")
    return drawing(
        marginals_figure(paint),
        f"Prior and posterior of {len(paint.fit.sampled)} parameters of {paint.subject}; the mode of the emission is "
        f"narrowed to {mode}.",
        paint.titled(
            "what was believed before (hatched) and after (filled) the measurement. What to see: a filled peak much "
            "narrower than the hatching was set by the measurement, not by the prior."
        ),
    )


def _sampling(paints: Paints) -> Content:
    """Show how the posterior was sampled."""
    chains = [table for paint in paints if (table := tables.chain_table(paint)) is not None]
    return Content(
        lead="The posterior is drawn by importance sampling, which diagnoses itself; where it falls short its draws "
        "are moved until they forget their start, at last emcee takes over. emcee checks any of them where asked.",
        remarks=tuple(paint.titled(said.sampling_statement(paint.fit.diagnostics)) for paint in paints),
        tables=(*(tables.sampling_table(paint) for paint in paints), *chains),
    )
