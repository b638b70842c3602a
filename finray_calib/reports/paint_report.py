"""The report of one fitted paint: one HTML page with everything inside, the verdict first."""

from typing import Literal

from data_schemas.fit import PaintCalibration
from data_schemas.radiometry import BandSignals
from finray_calib.reports import fit_statements as said
from finray_calib.reports.fit_section import fit_parts
from finray_calib.reports.fit_summary import fit_summary
from finray_calib.reports.fitted_paint import FittedPaint
from finray_calib.reports.number_text import fixed, percent
from finray_calib.reports.page import render_page
from finray_calib.reports.plain_json import plain
from finray_calib.reports.report_tables import provenance_table, signals_table
from finray_calib.reports.section import Content, Part

TEMPLATE = "paint_report.html.j2"
Verdict = Literal["Fit can be used", "Use with care", "Do not use"]


def paint_report(paint: PaintCalibration, bands: BandSignals) -> str:
    """Return the report of one fitted paint as a self-contained HTML page.

    Parameters
    ----------
    paint
        The calibration.
    bands
        The band signals that it was fitted to.

    Returns
    -------
    str
        HTML text; equal input gives equal text.
    """
    fitted = FittedPaint(bands, paint)
    verdict = fit_verdict(paint)
    return render_page(
        TEMPLATE,
        paint_name=paint.paint_name,
        verdict=verdict,
        lead=_lead(fitted),
        sentence=said.paint_sentence(fitted),
        key_numbers=_key_numbers(paint),
        findings=_findings(fitted, verdict),
        limits=_limits(fitted),
        assumptions=_assumptions(fitted),
        sections=(*fit_parts([fitted]), _signals(fitted)),
        provenance=None if paint.provenance is None else provenance_table(paint.provenance),
        summary=plain(fit_summary(fitted)),
    )


def fit_verdict(paint: PaintCalibration) -> Verdict:
    """Return whether the fit can be used: not when its draws cannot be trusted, with care when there is a warning."""
    if not said.is_trusted(paint.diagnostics):
        return "Do not use"
    return "Use with care" if paint.warnings or not all(band.explained for band in paint.bands) else "Fit can be used"


def _lead(paint: FittedPaint) -> str:
    """Say what was measured."""
    usable = paint.bands.usable()
    return (
        f"Emission spectrum of this paint for light at {paint.fit.optics.laser.wavelength_nm:g} nm, inferred from "
        f"{int(usable.sum())} usable signals of {len(usable)} filters and three camera channels over "
        f"{paint.bands.region_pixels} pixels."
    )


def _key_numbers(paint: PaintCalibration) -> tuple[tuple[str, str, str], ...]:
    """Return (label, value, remark) of the few numbers that stand beside the verdict."""
    mode, width = paint.parameters["mode_nm"], paint.parameters["fwhm_nm"]
    shift, light = paint.reradiation.stokes_shift_nm, paint.energy_yield
    origin = "belief, not measured; " if paint.reradiation.prior_driven else ""
    return (
        ("Emits most at", f"{fixed(mode.estimate, 0)} nm", _interval(mode.low95, mode.high95, "nm")),
        ("Full width at half maximum", f"{fixed(width.estimate, 0)} nm", _interval(width.low95, width.high95, "nm")),
        ("Energy yield", percent(light.estimate), _interval(100 * light.low95, 100 * light.high95, "%")),
        ("Stokes shift", f"{fixed(shift.estimate, 0)} nm", f"{origin}{_interval(shift.low95, shift.high95, 'nm')}"),
    )


def _interval(low: float, high: float, unit: str) -> str:
    """Return a 95 % interval in words."""
    return f"95 %: {fixed(low, 0)} to {fixed(high, 0)} {unit}"


def _findings(paint: FittedPaint, verdict: Verdict) -> tuple[str, ...]:
    """Return the sentences below the verdict: why it is so, the bands, the family, the absorption."""
    reasons = {
        "Fit can be used": "The draws are trusted, every band is explained, and there are no warnings.",
        "Use with care": f"The draws are trusted; read the warnings first ({len(paint.fit.warnings)}, below).",
        "Do not use": "The draws of the posterior cannot be trusted, so neither can any number of this page.",
    }
    conclusion = said.bands_conclusion(paint)
    return (
        reasons[verdict],
        f"{conclusion[:1].upper()}{conclusion[1:]}.",
        said.family_statement(paint),
        said.absorption_statement(paint),
    )


def _limits(paint: FittedPaint) -> tuple[str, ...]:
    """Return warnings, the sampling, the prior, and what the bands' record has noted."""
    bands = paint.bands
    lost = int((~bands.usable()).sum())
    told = [f"Warning: {warning}." for warning in paint.fit.warnings]
    told.append(f"Sampling: {said.sampling_statement(paint.fit.diagnostics)}")
    told.append(said.prior_statement(paint))
    told.append(f"{lost} of {bands.usable().size} signals are flagged and not used.")
    return (*told, *(f"Radiometry: {note}." for note in bands.notes))


def _assumptions(paint: FittedPaint) -> tuple[str, ...]:
    """List what was taken for granted."""
    optics, fit = paint.fit.optics, paint.fit
    sources = sorted({curve.source for curve in optics.camera_response})
    centers = ", ".join(f"{band.center_nm:g}" for band in optics.filters)
    centre_nm, width_nm, leak_od = (
        max(getattr(band, name) for band in optics.filters)
        for name in ("center_uncertainty_nm", "fwhm_uncertainty_nm", "blocking_uncertainty_od")
    )
    return (
        f"Camera response: {'; '.join(sources)}. Lamp: {optics.lamp.source}.",
        f"Filters at {centers} nm, as the rig file states them: centres within {centre_nm:g} nm, widths within "
        f"{width_nm:g} nm, blocking within {leak_od:g} OD (standard uncertainty, the largest of all filters).",
        f"Emission: {fit.family_title} with a discrepancy of {percent(fit.discrepancy.amplitude_rel)}, from "
        f"{fit.discrepancy.origin}.",
        *([] if paint.bands.tilt_ratios else ["A diffuse paint: the same radiance in all directions."]),
    )


def _signals(paint: FittedPaint) -> Part:
    """Show what was fitted."""
    lead = "What the fit was made from: one value per filter and channel over the painted region."
    return Part("Band signals", Content(lead=lead, tables=(signals_table(paint),)))
