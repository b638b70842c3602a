"""What the numbers of a fit mean, in plain sentences and tables, all of them computed from the records."""

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np

from data_schemas import BandResidual, ChainCheck, Diagnostics, Estimate, FamilyResult
from finray_calib.fit import (
    FEWEST_EFFECTIVE,
    LARGEST_CHAIN_SHIFT_SD,
    LARGEST_MEMORY,
    LARGEST_PARETO_K,
    LARGEST_R_HAT,
    SMALLEST_EFFECTIVE_SAMPLES,
    BudgetRow,
    two_maxima,
)
from finray_calib.reports._fitted_paint import CurveAgreement, FittedPaint, PaintTruth, curve_agreement, paper_agreement
from finray_calib.reports._page import ReportTable, TableGroup, one_group
from finray_calib.reports._plain_text import (
    NO_VALUE,
    decimals_for,
    estimate_text,
    filter_label,
    fixed,
    pareto_text,
    percent,
    probability,
    significant,
)

GOOD_COVERAGE = 0.80
"""A 95 % band that holds less of the curve than this is called too narrow."""

SMALL_SHIFT_SD = 0.5
"""A result that moves by fewer of its standard deviations when a prior's width is halved or doubled is robust."""

IMPROBABLE = 0.05
"""A reported family below this probability needs a word on why it is reported."""

_QUANTITY_WORDS = {
    "mode_nm": "the mode",
    "fwhm_nm": "the full width",
    "skew": "the skew",
    "peak_per_nm": "the peak",
    "energy_yield": "the yield",
}


def holds(value: Estimate, truth: float) -> bool:
    """Whether the 95 % interval holds the truth."""
    return value.low95 <= truth <= value.high95


def paint_sentence(paint: FittedPaint) -> str:
    """Say where the paint emits, how widely and how much, beside the truth where it is known."""
    fit, truth = paint.fit, paint.truth
    mode, width = fit.parameters["mode_nm"], fit.parameters["fwhm_nm"]
    caution = "" if is_trusted(fit.diagnostics) else " The sampling can NOT be trusted: do not use this fit."
    beside = ("", "") if truth is None else (_beside(truth, truth.mode_nm, mode), _beside(truth, truth.fwhm_nm, width))
    rest = f"It re-emits {estimate_text(fit.energy_yield, '%', 100.0)} of the light's energy as fluorescence."
    if truth is not None:
        rest = f"Over the whole spectrum the fit is off by {percent(curve_agreement(fit, truth.emission).error_rel)}."
    subject = paint.subject[:1].upper() + paint.subject[1:]
    return (
        f"{subject} emits most at {estimate_text(mode, 'nm')}{beside[0]}; its full width at half maximum is "
        f"{estimate_text(width, 'nm')}{beside[1]}. {rest}{caution}"
    )


def _beside(truth: PaintTruth, value_nm: float, estimate: Estimate) -> str:
    """Return the truth in nm and on which side of the 95 % interval it lies, in brackets."""
    place = "inside" if holds(estimate, value_nm) else "outside"
    return f" ({truth.word} {value_nm:.1f} nm, {place} the 95 % interval)"


def model_statement(paint: FittedPaint, truth: PaintTruth) -> str:
    """Say how well the fit describes the true emission, with the paper's curve beside it."""
    agreement, paper = curve_agreement(paint.fit, truth.emission), paper_agreement(paint.fit, truth.emission)
    remark = "" if truth.is_measured else " (the simulated paint is exactly such a curve; no measured paint is)"
    return (
        f"{paint.titled('the')} 95 % band covers {percent(agreement.coverage_95_rel)} of the {truth.word} curve, "
        f"and the fitted curve differs from it by {percent(agreement.error_rel)} (relative RMS): "
        f"{_model_verdict(paint, agreement)}. The paper's curve alone, taken to be exact: "
        f"{percent(paper.coverage_95_rel)} covered, error {percent(paper.error_rel)}{remark}."
    )


def _model_verdict(paint: FittedPaint, agreement: CurveAgreement) -> str:
    """Say what coverage and bands mean together."""
    if not is_trusted(paint.fit.diagnostics):
        return "the sampling can NOT be trusted, so this fit must not be used"
    if agreement.coverage_95_rel >= GOOD_COVERAGE:
        return "the fit describes this paint within its stated uncertainty"
    if not all(band.explained for band in paint.fit.bands):
        return "the intervals are too narrow, as the bands that are not explained show"
    return (
        "the intervals are too narrow here, and the bands alone do not reveal it: the filters leave gaps, and the "
        "errors of points along a curve are correlated"
    )


def bands_conclusion(paint: FittedPaint) -> str:
    """Say how many bands the fit explains."""
    bands = [band for band in paint.fit.bands if band.degrees_of_freedom > 0]
    poor = [band for band in bands if not band.explained]
    if not poor:
        return f"all {len(bands)} bands agree with the fit"
    names = ", ".join(filter_label(band.filter_name, band.center_nm, " nm") for band in poor)
    return f"{len(bands) - len(poor)} of {len(bands)} bands agree with the fit; not explained: {names}"


def family_statement(paint: FittedPaint) -> str:
    """Say why this family is reported or stands beside the spectrum, how sure that is, and what the choice changes."""
    text = paint.fit.family_choice
    for family in paint.competing:
        text = text.replace(family.name, family.title)
    remark, chance = "", paint.chosen.probability
    if chance is not None and chance < IMPROBABLE:
        remark = (
            f" By these bands alone this family is unlikely (probability "
            f"{probability(chance)}): its discrepancy had to explain part of the signals."
        )
    beside = ""
    if paint.rests_on_measured_spectra:
        beside = " The reported spectrum does not depend on the family; only the parameters and the maps of pixels do."
    return f"{paint.titled(text)}.{remark}{beside} {_spread(paint)}"


def prior_share_statement(paint: FittedPaint) -> str:
    """Say which quantities the measurement has hardly constrained."""
    shares = paint.fit.prior_shares
    if not shares:
        return paint.titled(
            "the version that made this fit did not judge how much of each number comes from the prior."
        )
    weak = [QUANTITIES[name][0] for name in paint.fit.mostly_prior]
    largest = max((n for n in shares if n in QUANTITIES), key=lambda name: shares[name].share)
    if weak:
        return paint.titled(
            f"emission constrained in part: {', '.join(weak)} mostly prior, because more than half of the "
            "prior's variance remains after the measurement."
        )
    stokes = shares.get("stokes_shift_nm")
    beside = "" if stokes is None else f"; of the Stokes shift's, {percent(stokes.share)} remains"
    return paint.titled(
        f"the measurement determines the emission: at most {percent(shares[largest].share)} of the prior's variance "
        f"remains ({QUANTITIES[largest][0]}){beside}."
    )


def maxima_statement(paint: FittedPaint) -> str:
    """Say where a spectrum of two maxima has them; empty for one of a single maximum."""
    found = two_maxima(paint.fit.wavelength_nm, paint.fit.emission_draws_per_nm)
    if found is None:
        return ""
    return paint.titled(
        f"the spectrum has two maxima (probability {found.probability:.2f}), at {estimate_text(found.first_nm, 'nm')} "
        f"and at {estimate_text(found.second_nm, 'nm')}; the second is {estimate_text(found.second_to_first)} times as "
        "high as the first. The mode is the higher one, and the full width is measured around it."
    )


def _spread(paint: FittedPaint) -> str:
    """Say how far the families differ in what is reported."""
    mode, width = ([f.quantities[name].estimate for f in paint.competing] for name in ("mode_nm", "fwhm_nm"))
    possible = [y for f in paint.competing if (y := f.quantities["energy_yield"].estimate) <= 1.0]
    beyond = [f.title for f in paint.competing if f.quantities["energy_yield"].estimate > 1.0]
    excess = "above 100 %, which no paint emits: the bands contradict"
    energy = f"at {percent(min(possible))} to {percent(max(possible))}" if possible else f"{excess} all families"
    if beyond and possible:
        these = "this family" if len(beyond) == 1 else "these families"
        energy += f" ({' and '.join(beyond)}: {excess} {these})"
    return (
        f"What the choice changes: the {len(mode)} families put the mode at {min(mode):.1f} to "
        f"{max(mode):.1f} nm, the full width at {min(width):.1f} to {max(width):.1f} nm and the yield "
        f"{energy}."
    )


def absorption_statement(paint: FittedPaint) -> str:
    """Say what is known of the Stokes shift, and whether it was measured."""
    absorption = paint.fit.reradiation
    shift = estimate_text(absorption.stokes_shift_nm, "nm")
    if absorption.prior_driven:
        several = len(absorption.measured_at_nm) > 1
        return paint.titled(
            f"Stokes shift {shift}: this comes from the prior and the emission; {_UNMEASURED[several]}. "
            f"{_sentence(absorption.statement)}"
        )
    return paint.titled(f"Stokes shift {shift}. {_sentence(absorption.statement)}")


_UNMEASURED: Final = {
    False: "with one light, the absorption is not measured",
    True: "the lights that were measured hardly constrain the absorption",
}


def _sentence(text: str) -> str:
    """Return text with a capital and a full stop."""
    return f"{text[:1].upper()}{text[1:].rstrip('.')}."


def prior_statement(paint: FittedPaint) -> str:
    """Say how much the answer owes to the priors."""
    shifts = {name: max(abs(s.halved), abs(s.doubled)) for name, s in paint.fit.prior_sensitivity.items()}
    name = max(shifts, key=lambda key: shifts[key])
    within = (
        "well inside its own uncertainty"
        if shifts[name] < SMALL_SHIFT_SD
        else "so the prior matters: read the table below"
    )
    return paint.titled(
        f"when all priors are made half and twice as wide, {_QUANTITY_WORDS.get(name, name)} moves most, by "
        f"{fixed(shifts[name], 2)} of its standard deviation, {within}."
    )


def chain_disagrees(chain: ChainCheck) -> bool:
    """Whether emcee's means differ from the stored draws' by more than chance."""
    return largest_shift_sd(chain) > LARGEST_CHAIN_SHIFT_SD


def largest_shift_sd(chain: ChainCheck) -> float:
    """Return the largest difference of a mean to the draws, in posterior standard deviations; 0 where it made them."""
    return max(map(abs, chain.mean_shift_sd.values()), default=0.0)


def is_trusted(diagnostics: Diagnostics) -> bool:
    """Whether the draws deserve trust, and emcee agrees where it was asked."""
    chain = diagnostics.chain
    return diagnostics.trusted and (chain is None or not chain_disagrees(chain))


def sampling_statement(diagnostics: Diagnostics) -> str:
    """Say how the posterior was sampled and whether the draws deserve trust."""
    trust = "trusted" if diagnostics.trusted else "NOT trusted"
    maxima = len(diagnostics.maxima)
    found = "one maximum of the posterior" if maxima == 1 else f"{maxima} maxima of the posterior"
    if diagnostics.method == "emcee":
        taken = f"draws by emcee, after importance sampling failed (Pareto k {pareto_text(diagnostics.pareto_k)})"
        return f"{taken}: {trust}; {_chain_text(diagnostics.chain)}; {found}." if diagnostics.chain else f"{taken}."
    own = (
        f"draws by resample-move, {trust}: importance sampling was uneven (Pareto k "
        f"{pareto_text(diagnostics.pareto_k)}), so its draws were moved until they no longer depended on "
        f"where they began (correlation {diagnostics.memory:.2f}, at most {LARGEST_MEMORY:g} is allowed); "
        f"{found}."
        if diagnostics.memory is not None
        else f"draws by {diagnostics.method}, {trust}: Pareto k {pareto_text(diagnostics.pareto_k)} (at most "
        f"{LARGEST_PARETO_K:g} is allowed), {diagnostics.effective_samples:.0f} effective draws (at least "
        f"{FEWEST_EFFECTIVE:.0f} are needed); {found}."
    )
    if diagnostics.chain is None:
        return own
    shift = largest_shift_sd(diagnostics.chain)
    verdict = "DISAGREES with them" if chain_disagrees(diagnostics.chain) else "agrees with them"
    return (
        f"{own} emcee, run as an independent check, {verdict}: its means differ by at most {fixed(shift, 2)} "
        f"standard deviations (at most {LARGEST_CHAIN_SHIFT_SD:g} is allowed); "
        f"{_chain_text(diagnostics.chain)}."
    )


def _chain_text(chain: ChainCheck) -> str:
    """Return convergence, largest R-hat and smallest effective sample size of a chain."""
    r_hat, samples = max(chain.r_hat.values()), min(chain.effective_samples.values())
    return (
        f"{'converged' if chain.converged else 'NOT converged'}, largest R-hat {r_hat:.3f} (at most "
        f"{LARGEST_R_HAT} is allowed), at least {samples:.0f} effective samples (more than "
        f"{SMALLEST_EFFECTIVE_SAMPLES:.0f} are needed)"
    )


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
    "ln_asymmetry": "red / blue half width, logarithm",
    "shift_nm": "second component's shift",
    "ln_width_ratio": "second component's width",
    "ln_height_ratio": "second component's height",
    "ln_reflected_laser": "reflectance at the laser",
    "ln_blocking": "filter leak / its nominal value",
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
        share = fit.prior_shares.get(name)
        left = NO_VALUE if share is None else f"{percent(share.share)} ({share.shift_sd:+.1f} sd)"
        rows.append((label, estimate_text(value, unit, factor), left, paper, *([] if truth is None else [true])))
    blank = () if truth is None else ("",)
    at_laser = estimate_text(fit.parameters["reflectance_at_laser"])
    rows.append(("reflectance at the laser", at_laser, NO_VALUE, NO_VALUE, *blank))
    symbols = [
        (label, NO_VALUE, NO_VALUE, estimate_text(fit.paper[name], unit), *blank)
        for name, (label, unit) in _PAPER_SYMBOLS.items()
    ]
    columns = (
        "quantity",
        "fit",
        "prior variance remaining (shift)",
        "the paper's curve alone",
        *([] if truth is None else [f"{truth.word} value"]),
    )
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
    chosen, mark = paint.chosen, "parameters and maps" if paint.rests_on_measured_spectra else "reported"
    rows = [(f"{f.title} ({mark})" if f is chosen else f.title, *_family_cells(f)) for f in paint.competing]
    paper = paint.paper
    rows.append((f"{paper.title} alone", *_family_cells(paper)))
    columns = ("family", "mode (nm)", "FWHM (nm)", "skew", "yield (%)", "ln evidence", "probability")
    caption = "the same bands seen by each family of curves; all but the last with discrepancy"
    return one_group(paint.titled(caption), (*columns, "left out (nats)"), rows)


def _family_cells(family: FamilyResult) -> tuple[str, ...]:
    """Return the cells of one family."""
    return (
        *(estimate_text(family.quantities[name]) for name in ("mode_nm", "fwhm_nm", "skew")),
        _yield_cell(family.quantities["energy_yield"]),
        fixed(family.ln_evidence, 1),
        NO_VALUE if family.probability is None else probability(family.probability),
        _left_out(family),
    )


def _yield_cell(energy_yield: Estimate) -> str:
    """Return a yield in per cent; one that no paint can have is not quoted."""
    return "above 100, impossible" if energy_yield.estimate > 1.0 else estimate_text(energy_yield, "", 1e2)


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
            filter_label(band.filter_name, band.center_nm, " nm"),
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
        (f"Stokes shift from the last absorption maximum ({origin})", estimate_text(absorption.stokes_shift_nm, "nm")),
        ("excitation lights measured", lights or "none"),
        ("draws replaced, because they emitted more than was absorbed", percent(absorption.rejected_share)),
        ("draws that emit more than is absorbed at the laser", percent(absorption.violating_share)),
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
    return ReportTable(paint.titled("prior, before the measurement"), ("parameter", "value"), groups, is_words=True)


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


def signals_table(paint: FittedPaint) -> ReportTable:
    """List the fluorescence signal of every filter and channel with its standard deviation."""
    bands = paint.bands
    sd = np.sqrt(np.diag(bands.fluorescence_covariance)).reshape(-1, 3)
    rows = (
        (
            filter_label(band.name, band.center_nm),
            *(_signal(*numbers) for numbers in zip(bands.fluorescence[i], sd[i], bands.flags[i], strict=True)),
        )
        for i, band in enumerate(bands.optics.filters)
    )
    caption = "fluorescence relative to white, in thousandths, \u00b1 standard deviation"
    return one_group(paint.titled(caption), ("filter (nm)", "red", "green", "blue"), rows)


def _signal(value: float, sd: float, flag: str) -> str:
    """Return value and standard deviation in thousandths, or the flag of a value that is not used."""
    if flag != "ok":
        return flag
    places = min(decimals_for(1e3 * sd), 4)
    return f"{fixed(1e3 * value, places)} \u00b1 {fixed(1e3 * sd, places)}"


BUDGET_NAMES: Final = {
    "mode_nm": "mode", "fwhm_nm": "FWHM", "peak_per_nm": "peak", "energy_yield": "yield",
    "reflectance_at_laser": "reflectance", "stokes_shift_nm": "Stokes shift",
}  # fmt: skip
SMALL_SHARE = 0.01


def joined_budget(
    rows: Sequence[BudgetRow], least_share: float = SMALL_SHARE
) -> dict[str, tuple[str, dict[str, float]]]:
    """Return source -> size with evaluation, and share by quantity; small sources are one.

    Parameters
    ----------
    rows
        Of the budget.
    least_share
        A source stands by itself where it makes so much of any variance.
    """
    found: dict[str, tuple[str, dict[str, float]]] = {}
    for row in rows:
        size = f"{row.size} ({row.evaluation})"
        found.setdefault(row.source, (size, {}))[1][row.quantity] = row.share
    small = [source for source, (_, shares) in found.items() if max(shares.values()) < least_share]
    if len(small) < 2:
        return found
    together: dict[str, float] = {}
    for source in small:
        for quantity, share in found.pop(source)[1].items():
            together[quantity] = together.get(quantity, 0.0) + share
    found[f"other sources, each below {percent(least_share)}"] = (f"{len(small)} sources", together)
    return found


def budget_table(
    rows: Sequence[BudgetRow],
    names: Mapping[str, str] = BUDGET_NAMES,
    title: str = "",
    least_share: float = SMALL_SHARE,
) -> ReportTable:
    """Return the share of the variance of each quantity that each source makes.

    Parameters
    ----------
    rows
        Of the budget.
    names
        Quantity -> heading of its column.
    title
        Before the caption, with the paint's name.
    least_share
        A source stands by itself where it makes so much of any variance.
    """
    shown = [row for row in rows if row.quantity in names]
    quantities = [name for name in names if any(row.quantity == name for row in shown)]

    def cell(share: float | None) -> str:
        return NO_VALUE if share is None else f"{100 * share:.1f} %"

    cells = [
        (source, size, *(cell(shares.get(name)) for name in quantities))
        for source, (size, shares) in joined_budget(shown, least_share).items()
    ]
    sums = [cell(sum(row.share for row in shown if row.quantity == name)) for name in quantities]
    caption = f"{title}Budget: share of the variance of each quantity by source; A from frames, B stated or assumed"
    columns = ("source", "size (evaluation)", *(names[name] for name in quantities))
    return one_group(caption, columns, [*cells, ("together", "", *sums)])


def budget_statement(paint: FittedPaint, rows: Sequence[BudgetRow]) -> str:
    """Say what makes most of the uncertainty of the mode and the yield.

    Parameters
    ----------
    paint
        The paint.
    rows
        Of its budget.
    """
    told = []
    for name in ("mode_nm", "energy_yield"):
        largest = max((row for row in rows if row.quantity == name), key=lambda row: row.share)
        told.append(f"{percent(largest.share)} of the variance of the {BUDGET_NAMES[name]} is {largest.source}")
    return paint.titled("; ".join(told)) + "."
