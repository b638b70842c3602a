"""What the numbers of a fit mean, in plain sentences; every sentence is computed from the records."""

from data_schemas.estimate import Estimate
from data_schemas.fit import ChainCheck, Diagnostics
from finray_calib.fit.calibration_records import LARGEST_CHAIN_SHIFT_SD
from finray_calib.fit.diagnostics import LARGEST_R_HAT, SMALLEST_EFFECTIVE_SAMPLES
from finray_calib.fit.importance import FEWEST_EFFECTIVE
from finray_calib.fit.pareto_smoothing import LARGEST_PARETO_K
from finray_calib.fit.resample_move import LARGEST_MEMORY
from finray_calib.reports.curve_agreement import CurveAgreement, curve_agreement, paper_agreement
from finray_calib.reports.fitted_paint import FittedPaint, PaintTruth
from finray_calib.reports.number_text import estimate_text, fixed, pareto_text, percent, probability

GOOD_COVERAGE = 0.80
"""A 95 % band that holds less of the curve than this is called too narrow."""

SMALL_SHIFT_SD = 0.5
"""A shift by the prior below this is well inside the stated uncertainty."""

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
    rest = f"It gives back {estimate_text(fit.energy_yield, '%', 100.0)} of the light's energy as fluorescence."
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
    remark = "" if truth.is_measured else " (this hidden paint is exactly such a curve; no measured paint is)"
    return (
        f"{paint.titled('the')} 95 % band covers {percent(agreement.coverage_95_rel)} of the {truth.word} curve, "
        f"and the fitted curve differs from it by {percent(agreement.error_rel)} (relative RMS): "
        f"{_model_verdict(paint, agreement)}. The paper's curve alone, taken to be exact: "
        f"{percent(paper.coverage_95_rel)} covered, {percent(paper.error_rel)} off{remark}."
    )


def _model_verdict(paint: FittedPaint, agreement: CurveAgreement) -> str:
    """Say what coverage and bands mean together."""
    if not is_trusted(paint.fit.diagnostics):
        return "the sampling can NOT be trusted, so this fit must not be used"
    if agreement.coverage_95_rel >= GOOD_COVERAGE:
        return "the fit describes this paint within its stated uncertainty"
    if not all(band.explained for band in paint.fit.bands):
        return "the intervals are too narrow, as the bands that are not explained have warned"
    return (
        "the intervals are too narrow here, and the bands alone do not reveal it: the filters leave gaps, and points "
        "along a curve err together"
    )


def bands_conclusion(paint: FittedPaint) -> str:
    """Say how many bands the fit explains."""
    bands = [band for band in paint.fit.bands if band.degrees_of_freedom > 0]
    poor = [band for band in bands if not band.explained]
    if not poor:
        return f"all {len(bands)} bands agree with the fit"
    names = ", ".join(f"{band.center_nm:g} nm" for band in poor)
    return f"{len(bands) - len(poor)} of {len(bands)} bands agree with the fit; not explained: {names}"


def family_statement(paint: FittedPaint) -> str:
    """Say why this family is reported, how sure that is, and what the choice changes."""
    text = paint.fit.family_choice
    for family in paint.competing:
        text = text.replace(family.name, family.title)
    remark, chance = "", paint.chosen.probability
    if chance is not None and chance < IMPROBABLE:
        remark = (
            f" By these bands alone the reported family is unlikely (probability "
            f"{probability(chance)}): its discrepancy had to do part of its work."
        )
    return f"{paint.titled(text)}.{remark} {_spread(paint)}"


def _spread(paint: FittedPaint) -> str:
    """Say how far the families differ in what is reported."""
    mode, width, energy_yield = (
        [family.quantities[name].estimate for family in paint.competing]
        for name in ("mode_nm", "fwhm_nm", "energy_yield")
    )
    return (
        f"What the choice changes: the {len(mode)} families put the mode at {min(mode):.1f} to "
        f"{max(mode):.1f} nm, the full width at {min(width):.1f} to {max(width):.1f} nm and the yield at "
        f"{percent(min(energy_yield))} to {percent(max(energy_yield))}."
    )


def absorption_statement(paint: FittedPaint) -> str:
    """Say what is known of the Stokes shift, and whether it was measured."""
    absorption = paint.fit.reradiation
    shift = estimate_text(absorption.stokes_shift_nm, "nm")
    if absorption.prior_driven:
        return paint.titled(f"Stokes shift {shift}: belief, not measurement. {_sentence(absorption.statement)}")
    return paint.titled(f"Stokes shift {shift}. {_sentence(absorption.statement)}")


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
        f"{pareto_text(diagnostics.pareto_k)}), so its draws were moved until they had forgotten where they began "
        f"(correlation {diagnostics.memory:.2f}, at most {LARGEST_MEMORY:g} wanted); {found}."
        if diagnostics.memory is not None
        else f"draws by {diagnostics.method}, {trust}: Pareto k {pareto_text(diagnostics.pareto_k)} (at most "
        f"{LARGEST_PARETO_K:g} wanted), {diagnostics.effective_samples:.0f} effective draws (at least "
        f"{FEWEST_EFFECTIVE:.0f} wanted); {found}."
    )
    if diagnostics.chain is None:
        return own
    shift = largest_shift_sd(diagnostics.chain)
    verdict = "DISAGREES with them" if chain_disagrees(diagnostics.chain) else "agrees with them"
    return (
        f"{own} emcee, run as an independent check, {verdict}: its means differ by at most {fixed(shift, 2)} standard "
        f"deviations (at most {LARGEST_CHAIN_SHIFT_SD:g} wanted); {_chain_text(diagnostics.chain)}."
    )


def _chain_text(chain: ChainCheck) -> str:
    """Return convergence, largest R-hat and smallest effective sample size of a chain."""
    r_hat, samples = max(chain.r_hat.values()), min(chain.effective_samples.values())
    return (
        f"{'converged' if chain.converged else 'NOT converged'}, largest R-hat {r_hat:.3f} (at most {LARGEST_R_HAT} "
        f"wanted), at least {samples:.0f} effective samples (above {SMALLEST_EFFECTIVE_SAMPLES:.0f} wanted)"
    )
