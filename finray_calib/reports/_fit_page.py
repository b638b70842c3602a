"""The page of one fitted paint, and that of a sample in which no emission was found: one HTML file, the verdict first.

The section on the fit shows one paint, or several side by side.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Final, Literal

from data_schemas import BandSignals, PaintCalibration, PaintWithoutEmission, package_version
from finray_calib.fit import BudgetRow, allowed_stray_per_nm
from finray_calib.reports import _fit_statements as said
from finray_calib.reports._fit_figures import (
    absorption_figure,
    bands_figure,
    blank_figure,
    budget_figure,
    emission_figure,
    families_figure,
    marginals_figure,
    reflectance_figure,
)
from finray_calib.reports._fit_statements import (
    absorption_table,
    bands_table,
    budget_table,
    chain_table,
    families_table,
    prior_table,
    quantities_table,
    sampling_table,
    signals_table,
)
from finray_calib.reports._fitted_paint import FittedPaint, fit_summary
from finray_calib.reports._methods import fit_methods, methods_part
from finray_calib.reports._page import (
    Content,
    KeyNumber,
    Light,
    Part,
    Picture,
    ReportPage,
    drawing,
    files_table,
    findings_section,
    light_of,
    limits_section,
    provenance_table,
    report_html,
)
from finray_calib.reports._plain_text import centre_text, estimate_text, fixed, percent, plain

Verdict = Literal["Fit can be used", "Use with care", "Do not use"]


def paint_report(paint: PaintCalibration, bands: BandSignals, budget: Sequence[BudgetRow] = ()) -> str:
    """Return the report of one fitted paint as a self-contained HTML page.

    Parameters
    ----------
    paint
        The calibration.
    bands
        The band signals that it was fitted to.
    budget
        Of its uncertainty; left out where none was computed.

    Returns
    -------
    str
        HTML text; equal input gives equal text.
    """
    fitted = FittedPaint(bands, paint)
    verdict = fit_verdict(paint)
    emission, *parts = fit_parts([fitted])
    shown_above = replace(emission.content, picture_rows=())
    return report_html(
        ReportPage(
            verb="finray fit",
            title=f"Paint: {paint.paint_name}",
            lead=_lead(fitted),
            verdict=verdict,
            light=_FIT_LIGHTS[verdict],
            sentence=said.paint_sentence(fitted),
            picture=_emission_picture(fitted),
            key_numbers=_fit_key_numbers(paint),
            parts=(
                *findings_section(_fit_findings(fitted, verdict)),
                limits_section(_fit_limits(fitted), assumed=_assumptions(fitted)),
                replace(emission, content=shown_above),
                *([_budget(fitted, budget)] if budget else []),
                *parts,
                _fit_signals(fitted),
                methods_part(fit_methods(fitted), paint.provenance),
            ),
            origin=None if paint.provenance is None else provenance_table(paint.provenance),
            command="" if paint.provenance is None else paint.provenance.command,
            summary=plain(fit_summary(fitted)),
        )
    )


_FIT_LIGHTS: Final[dict[Verdict, Light]] = {"Fit can be used": "good", "Use with care": "care", "Do not use": "bad"}


def fit_verdict(paint: PaintCalibration) -> Verdict:
    """Return whether the fit can be used: not when its draws cannot be trusted, with care when there is a warning."""
    if not said.is_trusted(paint.diagnostics):
        return "Do not use"
    return (
        "Use with care"
        if paint.warnings or paint.mostly_prior or not all(band.explained for band in paint.bands)
        else "Fit can be used"
    )


def _lead(paint: FittedPaint) -> str:
    """Say what was measured."""
    fit = paint.fit
    return (
        f"Emission spectrum of this paint for light at {fit.optics.laser.wavelength_nm:g} nm, inferred from "
        f"{fit.usable_values} usable signals of {len(fit.optics.filters)} filters"
        + (
            ", imported from a table."
            if paint.bands.region_pixels == 1
            else f" and three camera channels over {paint.bands.region_pixels} pixels."
        )
    )


def _fit_key_numbers(paint: PaintCalibration) -> tuple[KeyNumber, ...]:
    """Return mode, width and yield, each judged by what the measurement has left of its prior."""
    mode, width, light = paint.parameters["mode_nm"], paint.parameters["fwhm_nm"], paint.energy_yield
    return (
        KeyNumber("Emits most at", f"{fixed(mode.estimate, 0)} nm", _interval(mode.low95, mode.high95, "nm"),
                  *_measured(paint, "mode_nm")),
        KeyNumber("Full width at half maximum", f"{fixed(width.estimate, 0)} nm",
                  _interval(width.low95, width.high95, "nm"), *_measured(paint, "fwhm_nm")),
        KeyNumber("Energy yield", percent(light.estimate), _interval(100 * light.low95, 100 * light.high95, "%"),
                  *_measured(paint, "energy_yield")),
    )  # fmt: skip


def _measured(paint: PaintCalibration, name: str) -> tuple[Light, str]:
    """Return the light of a quantity and its reason."""
    if not said.is_trusted(paint.diagnostics):
        return "bad", "the draws of the posterior cannot be trusted"
    share = paint.prior_shares.get(name)
    if share is None:
        return "", "how much of this number comes from the prior was not judged"
    left = f"{percent(share.share)} of the prior's variance remains"
    return light_of(not share.mostly_prior), f"{'mostly prior' if share.mostly_prior else 'measured'}: {left}"


def _interval(low: float, high: float, unit: str) -> str:
    """Return a 95 % interval in words."""
    return f"95 %: {fixed(low, 0)} to {fixed(high, 0)} {unit}"


def _fit_findings(paint: FittedPaint, verdict: Verdict) -> tuple[str, ...]:
    """Return the sentences below the verdict: why it is so, the bands, the family, the absorption."""
    reasons = {
        "Fit can be used": "The draws can be trusted, every band is explained, and there are no warnings.",
        "Use with care": (
            f"The draws can be trusted. Read first the warnings below ({len(paint.fit.warnings)}), and which "
            "quantities come mostly from the prior."
        ),
        "Do not use": "The draws of the posterior cannot be trusted, so neither can any number of this page.",
    }
    conclusion = said.bands_conclusion(paint)
    return (
        reasons[verdict],
        f"{conclusion[:1].upper()}{conclusion[1:]}.",
        said.prior_share_statement(paint),
        *filter(None, [said.maxima_statement(paint)]),
        said.family_statement(paint),
        said.absorption_statement(paint),
    )


def _fit_limits(paint: FittedPaint) -> tuple[str, ...]:
    """Return warnings, the sampling, the prior, and what the bands' record has noted."""
    bands = paint.bands
    flagged = int((~bands.usable()).sum())
    leaked = int((bands.usable() & ~paint.fit.usable).sum())
    told = [f"Warning: {warning}." for warning in paint.fit.warnings]
    told.append(f"Sampling: {said.sampling_statement(paint.fit.diagnostics)}")
    told.append(said.prior_statement(paint))
    told.append(
        f"{flagged + leaked} of {bands.usable().size} signals are not used: {flagged} are flagged, and {leaked} "
        "measure mostly what the filter leaks outside its band."
    )
    return (*told, *(f"Radiometry: {note}." for note in bands.notes))


def _assumptions(paint: FittedPaint) -> tuple[str, ...]:
    """List what was taken for granted."""
    optics = paint.fit.optics
    sources = sorted({curve.source for curve in optics.camera_response})
    centers = ", ".join(centre_text(band.center_nm) for band in optics.filters)
    centre_nm, width_nm, leak_od = (
        max(getattr(band, name) for band in optics.filters)
        for name in ("center_uncertainty_nm", "fwhm_uncertainty_nm", "blocking_uncertainty_od")
    )
    return (
        f"Camera response: {'; '.join(sources)}. Lamp: {optics.lamp.source}.",
        f"Filters at {centers} nm, as the rig file states them: centres within {centre_nm:g} nm, widths within "
        f"{width_nm:g} nm, blocking within {leak_od:g} OD (standard uncertainty, the largest of all filters).",
        _emission_assumption(paint),
        *([] if paint.bands.tilt_ratios else ["A diffuse paint: the same radiance in all directions."]),
    )


def _emission_assumption(paint: FittedPaint) -> str:
    """Say what the spectrum rests on."""
    fit = paint.fit
    if paint.rests_on_measured_spectra:
        return (
            "Emission: prototypes of measured spectra (fluorophores, ink, textile, papers) with smooth "
            "deviations of three sizes, averaged over all. The prior does not cover a paint unlike any of "
            "them, such as one with narrow lines between the filters."
        )
    return (
        f"Emission: {fit.family_title} with a discrepancy of {percent(fit.discrepancy.amplitude_rel)}, from "
        f"{fit.discrepancy.origin}."
    )


def _budget(paint: FittedPaint, rows: Sequence[BudgetRow]) -> Part:
    """Show which source makes how much of each uncertainty."""
    statement = said.budget_statement(paint, rows)
    return Part(
        "Uncertainty by source",
        Content(
            lead="Where the uncertainty of each quantity comes from: shares of its variance, which add up to 100 %. "
            "To make "
            "one more certain, begin with its largest share. Only other filters can reduce the prior's share.",
            picture_rows=(
                (
                    drawing(
                        budget_figure(rows, said.SMALL_SHARE),
                        statement,
                        paint.titled("one bar for each quantity. What to see: which part is widest."),
                    ),
                ),
            ),
            tables=(budget_table(rows, title=paint.titled("")),),
            has_wide_tables=True,
        ),
    )


def _fit_signals(paint: FittedPaint) -> Part:
    """Show what was fitted."""
    lead = "What the fit was made from: one value per filter and channel over the painted region."
    return Part("Band signals", Content(lead=lead, tables=(signals_table(paint),)))


Paints = Sequence[FittedPaint]


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
        "perfect diffuse white. The pointwise band contains the paint's curve at each single wavelength with 95 % "
        "probability; the band of the whole curve contains all of it at once, wherever it exceeds 5 % of its peak.",
        remarks=tuple(said.prior_share_statement(paint) for paint in paints),
        picture_rows=_row(paints, _emission_picture),
        tables=tuple(quantities_table(paint) for paint in paints),
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
        lead="Each family assumes another shape of an emission curve. Evidence and probability show how well a "
        "family predicts the bands before seeing them, if all families are equally likely. The score of the left-out "
        "bands says how well each band is predicted from the others: higher is better, \u00b1 is the standard error "
        "of the difference to the default family, and scores with \u2248 are only indicative (Pareto k above 0.7).",
        picture_rows=_row(paints, _families_picture),
        remarks=tuple(said.family_statement(paint) for paint in paints),
        tables=tuple(families_table(paint) for paint in paints),
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
        lead="The prediction is the curve of the family as each filter sees it, with the spread from discrepancy "
        "and filters. The predictive p is the probability of a larger misfit if the model is right; a band "
        "below 0.01 is not explained. The pull is the filter's calibration error in units of its assumed "
        "uncertainty: 0 \u00b1 1 means that these data do not constrain it.",
        picture_rows=_row(paints, _bands_picture),
        tables=tuple(bands_table(paint) for paint in paints),
        has_wide_tables=True,
    )


def _bands_picture(paint: FittedPaint) -> Picture:
    """Return the figure of measured against predicted bands."""
    return drawing(
        bands_figure(paint),
        f"{paint.titled('measured against predicted signal of each filter')}: {said.bands_conclusion(paint)}.",
        paint.titled(
            "signals of the red, green and blue channel (markers, \u00b1 2 sd) on the predicted ones (boxes, \u00b1 2 "
            "sd); hollow markers were not used in the fit. Nearly all differences should lie within the grey strip. "
            f"Here {said.bands_conclusion(paint)}."
        ),
    )


def _absorption(paints: Paints) -> Content:
    """Show what is known and believed of the absorption."""
    return Content(
        lead="How strongly other blue and green light would excite the paint, relative to the laser.",
        picture_rows=_row(paints, _absorption_picture),
        remarks=tuple(said.absorption_statement(paint) for paint in paints),
        tables=tuple(absorption_table(paint) for paint in paints),
    )


def _absorption_picture(paint: FittedPaint) -> Picture:
    """Return the figure of the absorption."""
    seen = (
        "the wide band shows measured paints in general, not this one; this paint is measured at the dashed line only"
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
        f"{discrepancy.length_nm:g} nm, a floor of {percent(discrepancy.floor_rel)} of the peak, and "
        f"{percent(discrepancy.reabsorption_rel)} of re-absorption at the blue edge. Origin: {discrepancy.origin}.",
        picture_rows=_row(paints, _marginals_picture),
        remarks=tuple(said.prior_statement(paint) for paint in paints),
        tables=tuple(prior_table(paint) for paint in paints),
    )


def _marginals_picture(paint: FittedPaint) -> Picture:
    """Return the figure of prior and posterior."""
    mode = estimate_text(paint.fit.parameters["mode_nm"], "nm")
    return drawing(
        marginals_figure(paint),
        f"Prior and posterior of {len(paint.fit.sampled)} parameters of {paint.subject}; the mode of the emission is "
        f"narrowed to {mode}.",
        paint.titled(
            "prior before (hatched) and posterior after (filled) the measurement. What to see: a filled peak "
            "much narrower than the hatching was set by the measurement, not by the prior."
        ),
    )


def _sampling(paints: Paints) -> Content:
    """Show how the posterior was sampled."""
    chains = [table for paint in paints if (table := chain_table(paint)) is not None]
    return Content(
        lead="The posterior is drawn by importance sampling, which diagnoses itself; where it is not good enough, "
        "its draws are moved until they no longer depend on their start, and if that fails emcee takes over. "
        "emcee can check any of them.",
        remarks=tuple(paint.titled(said.sampling_statement(paint.fit.diagnostics)) for paint in paints),
        tables=(*(sampling_table(paint) for paint in paints), *chains),
    )


def no_emission_page(paint: PaintWithoutEmission, command: str, digests: Mapping[str, str]) -> str:
    """Return the page of a sample without emission as self-contained HTML; equal input gives equal text.

    Parameters
    ----------
    paint
        The record.
    command
        The command that reproduces it.
    digests
        Name of each input file -> SHA-256.
    """
    found = paint.detection
    return report_html(
        ReportPage(
            verb="finray fit",
            title=f"No emission: {paint.paint_name}",
            lead="Whether this sample emits light when the laser at "
            f"{paint.optics.laser.wavelength_nm:g} nm shines on it.",
            verdict="No emission",
            light="care",
            sentence=f"{found.statement[:1].upper()}{found.statement[1:]}.",
            picture=_signals(paint),
            key_numbers=_key_numbers(paint),
            parts=(*findings_section(_findings(paint)), limits_section(_limits(paint), paint.warnings)),
            command=command,
            origin=files_table(digests, package_version()),
            summary=plain(paint.model_dump(mode="json", exclude={"provenance", "optics"})),
        )
    )


def _key_numbers(paint: PaintWithoutEmission) -> tuple[KeyNumber, ...]:
    """Return the few numbers that stand beside the verdict."""
    found = paint.detection
    limit = "not stated" if found.yield_limit is None else f"below {percent(found.yield_limit).removeprefix('below ')}"
    modes = f"with 95 % confidence, for modes from {found.limit_low_nm:.0f} to {found.limit_high_nm:.0f} nm"
    beyond, threshold = fixed(found.statistic_sd, 1), fixed(found.threshold_sd, 1)
    return (
        KeyNumber("Energy yield", limit, modes),
        KeyNumber("Signal beyond a blank", f"{beyond} sd", f"threshold {threshold} sd", "care", "below the threshold"),
        KeyNumber("Reflected share of the laser", percent(paint.reflectance_at_laser), "by the filter at the laser"),
    )


def _findings(paint: PaintWithoutEmission) -> tuple[str, ...]:
    """Return what to do, and what the decision rests on."""
    found = paint.detection
    return (
        "There is no spectrum, no mode and no width in this record, because the signals contain none. The "
        "record cannot be used for a simulation, a map or an export.",
        f"{percent(found.blanks_above)} of {found.blanks} simulated samples of the same rig and reflectance, which "
        "emit nothing, show at least as much.",
        "If this should be a fluorescent paint: check that the laser was on, the right sample in view and "
        "the region inside it, and measure again with longer exposures.",
    )


_VISIBLE_NM: Final = 300.0


def _limits(paint: PaintWithoutEmission) -> tuple[str, ...]:
    """Return what the decision does not know."""
    found = paint.detection
    return (
        f"Emission with its mode beyond {found.limit_high_nm:.0f} nm is not seen by these filters.",
        "The limit depends on the filters' blocking as the rig file states it, and on an allowance for stray light of "
        f"{100 * _VISIBLE_NM * allowed_stray_per_nm(paint.optics):.2g} % of the laser. Filters that leak more make "
        "samples without emission look like paints.",
        f"Of all samples without any emission, {percent(found.false_alarm)} are wrongly called paints.",
    )


def _signals(paint: PaintWithoutEmission) -> Picture:
    """Show what was measured beside what a blank would show."""
    return drawing(
        blank_figure(paint),
        "Measured band signals agree with those of a sample that reflects the laser and emits nothing.",
        "Measured through each filter, and what a sample would give that reflects the same share of the laser and "
        "emits nothing. Boxes: two standard deviations of noise, leaks, tolerances and stray light. Open markers are "
        "not used.",
    )
