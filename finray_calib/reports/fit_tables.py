"""The tables on one fitted paint, as rows of text."""

from data_schemas.estimate import Estimate
from data_schemas.fit import BandResidual, FamilyResult
from finray_calib.fit.calibration_records import LARGEST_CHAIN_SHIFT_SD
from finray_calib.fit.diagnostics import LARGEST_R_HAT, SMALLEST_EFFECTIVE_SAMPLES
from finray_calib.fit.pareto_smoothing import LARGEST_PARETO_K
from finray_calib.reports.fit_statements import holds
from finray_calib.reports.fitted_paint import FittedPaint
from finray_calib.reports.number_text import (
    NO_VALUE,
    estimate_text,
    fixed,
    pareto_text,
    percent,
    probability,
    significant,
)
from finray_calib.reports.report_tables import ReportTable, TableGroup, one_group

PER_THOUSAND = "10\u207b\u00b3/nm"
QUANTITIES: dict[str, tuple[str, float, str]] = {
    "mode_nm": ("mode", 1.0, "nm"),
    "fwhm_nm": ("FWHM", 1.0, "nm"),
    "energy_yield": ("energy yield", 1e2, "%"),
    "skew": ("skew", 1.0, ""),
    "peak_per_nm": ("peak", 1e3, PER_THOUSAND),
}
"""Label, factor for display and unit of what every family reports."""

_PAPER_SYMBOLS = {
    "location_nm": ("location (\u03bb\u2080)", "nm"),
    "scale_nm": ("scale (\u03b3)", "nm"),
    "skewness": ("skewness (\u03c9)", ""),
    "amplitude_nm": ("amplitude (h)", "nm"),
}
_PARAMETER_WORDS = {
    "shape_mode_nm": "mode of the family's curve",
    "ln_shape_fwhm_nm": "its full width",
    "ln_shape_peak_per_nm": "its peak",
    "kappa": "skewness, as asinh",
    "ln_tail": "degrees of freedom",
    "ln_asymmetry": "red over blue half width, logarithm",
    "shift_nm": "second component's shift",
    "ln_width_ratio": "second component's width",
    "ln_height_ratio": "second component's height",
    "ln_reflected_laser": "reflectance at the laser",
    "ln_blocking": "filter leak over its nominal value",
}
_OWN_LEAK = "leak_"


def parameter_words(name: str) -> str:
    """Return a sampled parameter in words."""
    if name.startswith(_OWN_LEAK):
        return f"own leak of filter {name.removeprefix(_OWN_LEAK)}, in prior sd"
    return _PARAMETER_WORDS.get(name, name)


def quantities_table(paint: FittedPaint) -> ReportTable:
    """List what was fitted beside the paper's curve and the truth where it is known."""
    fit, truth = paint.fit, paint.truth
    known = {}
    if truth is not None:
        known = {"mode_nm": truth.mode_nm, "fwhm_nm": truth.fwhm_nm, "energy_yield": truth.energy_yield}
    rows = []
    for name, (label, factor, unit) in QUANTITIES.items():
        value = fit.parameters[name]
        paper = estimate_text(paint.paper.quantities[name], unit, factor)
        true = _truth_cell(value, known.get(name), unit, factor)
        rows.append((label, estimate_text(value, unit, factor), paper, *([] if truth is None else [true])))
    blank = () if truth is None else ("",)
    rows.append(("reflectance at the laser", estimate_text(fit.parameters["reflectance_at_laser"]), NO_VALUE, *blank))
    symbols = [
        (label, NO_VALUE, estimate_text(fit.paper[name], unit), *blank)
        for name, (label, unit) in _PAPER_SYMBOLS.items()
    ]
    columns = ("quantity", "fit", "the paper's curve alone", *([] if truth is None else [f"{truth.word} value"]))
    groups = (TableGroup("", tuple(rows)), TableGroup("The paper's four parameters, in its symbols", tuple(symbols)))
    return ReportTable(paint.titled("emission, median and 95 % interval"), columns, groups)


def _truth_cell(value: Estimate, true: float | None, unit: str, factor: float) -> str:
    """Return the truth and whether the interval holds it."""
    if true is None:
        return ""
    place = "inside" if holds(value, true) else "OUTSIDE"
    return f"{fixed(factor * true, 1)} {unit}, {place}"


def families_table(paint: FittedPaint) -> ReportTable:
    """List what each family of curves makes of the same bands, the paper's alone last."""
    chosen = paint.chosen
    rows = [(f"{f.title} (reported)" if f is chosen else f.title, *_family_cells(f)) for f in paint.competing]
    paper = paint.paper
    rows.append((f"{paper.title} alone", *_family_cells(paper)))
    columns = ("family", "mode (nm)", "FWHM (nm)", "skew", "yield (%)", "ln evidence", "probability")
    caption = "the same bands seen by each family of curves; all but the last with discrepancy"
    return one_group(paint.titled(caption), (*columns, "left out (nats)"), rows)


def _family_cells(family: FamilyResult) -> tuple[str, ...]:
    """Return the cells of one family."""
    return (
        *(estimate_text(family.quantities[name]) for name in ("mode_nm", "fwhm_nm", "skew")),
        estimate_text(family.quantities["energy_yield"], "", 1e2),
        fixed(family.ln_evidence, 1),
        NO_VALUE if family.probability is None else probability(family.probability),
        _left_out(family),
    )


def _left_out(family: FamilyResult) -> str:
    """Return the predictive score of the left-out bands with the error of its difference to the default family."""
    if family.left_out_bands is None:
        return NO_VALUE
    text = fixed(family.left_out_bands, 1)
    if family.left_out_bands_sd:
        text += f" \u00b1 {fixed(family.left_out_bands_sd, 1)}"
    rough = family.left_out_pareto_k is None or family.left_out_pareto_k > LARGEST_PARETO_K
    return f"\u2248 {text}" if rough else text


def bands_table(paint: FittedPaint) -> ReportTable:
    """List how well each band is explained, the pull on its calibration, and the emission in it."""
    fit, laser_nm = paint.fit, paint.fit.optics.laser.wavelength_nm
    rows = [
        (
            f"{band.center_nm:g} nm",
            *_band_cells(band),
            NO_VALUE if band.center_nm < laser_nm else estimate_text(emission, "", 1e3),
        )
        for band, emission in zip(fit.bands, fit.band_integrals, strict=True)
    ]
    rows.append(("all bands", fixed(fit.chi_square, 1), str(fit.usable_values), "", "", "", ""))
    columns = ("filter", "chi-square", "values", "predictive p", "explained", "calibration pull (sd)")
    caption = "how well the fit explains each band, and the emission in it"
    return one_group(paint.titled(caption), (*columns, f"emission ({PER_THOUSAND})"), rows)


def _band_cells(band: BandResidual) -> tuple[str, ...]:
    """Return the cells of one filter."""
    if band.degrees_of_freedom == 0:
        return ("not used", "0", "", "", "")
    return (
        fixed(band.chi_square, 1),
        str(band.degrees_of_freedom),
        probability(band.posterior_predictive_p),
        "yes" if band.explained else "NO",
        f"{fixed(band.calibration_pull.estimate, 1)} \u00b1 {fixed(band.calibration_pull.sd, 1)}",
    )


def absorption_table(paint: FittedPaint) -> ReportTable:
    """List what is believed of the absorption, and what the draws had to respect."""
    absorption = paint.fit.reradiation
    lights = ", ".join(f"{nm:g} nm" for nm in absorption.measured_at_nm)
    origin = "prior" if absorption.prior_driven else "measurement and prior"
    rows = [
        (f"Stokes shift ({origin})", estimate_text(absorption.stokes_shift_nm, "nm")),
        ("excitation lights measured", lights or "none"),
        ("draws replaced, they emitted more than absorbed", percent(absorption.rejected_share)),
        ("draws kept although they emit more than absorbed", percent(absorption.violating_share)),
        *(
            (f"prior of {name.removesuffix('_nm').replace('_', ' ')}", words)
            for name, words in absorption.prior.items()
        ),
    ]
    return one_group(paint.titled("the absorption and where it comes from"), ("item", "value"), rows, is_words=True)


def prior_table(paint: FittedPaint) -> ReportTable:
    """List the prior of every sampled parameter, and how far the answer moves with all priors."""
    fit = paint.fit
    words = [(parameter_words(name), fit.prior[name]) for name in fit.sampled]
    shifts = [
        (QUANTITIES[name][0], f"{shift.halved:+.2f} / {shift.doubled:+.2f} sd")
        for name, shift in fit.prior_sensitivity.items()
    ]
    groups = (
        TableGroup("Prior", tuple(words)),
        TableGroup("Shift when all priors are half / twice as wide", tuple(shifts)),
    )
    return ReportTable(paint.titled("what was believed beforehand"), ("parameter", "value"), groups, is_words=True)


def sampling_table(paint: FittedPaint) -> ReportTable:
    """List how the posterior was sampled."""
    told = paint.fit.diagnostics
    rows = [
        ("method", told.method),
        ("trusted", "yes" if told.trusted else "NO"),
        ("Pareto k of the weights", pareto_text(told.pareto_k)),
        ("effective draws", f"{told.effective_samples:.0f}"),
        ("ln evidence", f"{fixed(told.ln_evidence, 2)} \u00b1 {fixed(told.ln_evidence_sd, 2)}"),
        ("maxima, log posterior", ", ".join(fixed(value, 1) for value in told.maxima)),
    ]
    if told.memory is not None:
        rows.append(("moved draws: correlation with their start", f"{told.memory:.2f}"))
    if told.chain is not None:
        chain = told.chain
        role = "in its place" if told.method == "emcee" else "as a check"
        rows += [
            (f"emcee, {role}", "converged" if chain.converged else "NOT converged"),
            ("walkers, steps", f"{chain.walkers}, {chain.steps}"),
            ("accepted proposals", percent(chain.acceptance_fraction)),
        ]
    return one_group(paint.titled("sampling"), ("item", "value"), rows, is_words=True)


def chain_table(paint: FittedPaint) -> ReportTable | None:
    """List emcee's diagnostics of every parameter; None where it did not run."""
    chain = paint.fit.diagnostics.chain
    if chain is None:
        return None
    rows = [
        (
            parameter_words(name),
            f"{chain.r_hat[name]:.3f}",
            f"{chain.effective_samples[name]:.0f}",
            significant(chain.autocorrelation_time[name], 2),
            f"{chain.mean_shift_sd[name]:+.2f}" if chain.mean_shift_sd else NO_VALUE,
        )
        for name in paint.fit.sampled
    ]
    rows.append(
        (
            "wanted",
            f"\u2264 {LARGEST_R_HAT}",
            f"\u2265 {SMALLEST_EFFECTIVE_SAMPLES:.0f}",
            "",
            f"\u00b1 {LARGEST_CHAIN_SHIFT_SD:g}",
        )
    )
    columns = ("parameter", "R-hat", "effective samples", "autocorrelation (steps)", "shift of mean (sd)")
    return one_group(paint.titled("parameter by parameter, by emcee"), columns, rows)
