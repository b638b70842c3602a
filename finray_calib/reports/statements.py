"""What the numbers mean, in plain sentences; every sentence is computed from the records."""

from data_schemas.compare import PhotometricErrorReport
from data_schemas.decide import AngleStatement, LightAngleDecision
from data_schemas.fit import Diagnostics, Estimate
from finray_calib.fit.diagnostics import LARGEST_R_HAT, SMALLEST_EFFECTIVE_SAMPLES
from finray_calib.reports.curve_agreement import CurveAgreement, curve_agreement
from finray_calib.reports.demo_results import DemoResults, PaintResult, headline, row_of
from finray_calib.reports.number_text import fixed, interval_text, percent, skill_text
from finray_calib.reports.summary import true_loss

GOOD_COVERAGE = 0.80
"""A 95 % band that holds less of the curve than this is called too narrow."""
SMALL_P = 0.01


def verdict_meaning(decision: LightAngleDecision) -> str:
    """Say what the verdict tells a designer to do."""
    tolerance, angle = percent(decision.tolerance_rel), f"{decision.angle_deg:.0f} deg"
    loss, alone = percent(decision.statement.regret_95), percent(decision.statement_simulation_only.regret_95)
    if decision.verdict == "decided":
        return (
            f"Mount the light at {angle}: the loss against the best angle stays within {tolerance} with 95 % "
            f"probability, and only angles nearby do as well ({equivalent_text(decision.statement)})."
        )
    if decision.verdict == "tie":
        return (
            f"Any of these angles will do: {equivalent_text(decision.statement)}. Each loses at most {tolerance} "
            "against the best angle with 95 % probability; take the one that is easiest to build."
        )
    if decision.verdict == "undecided":
        return (
            f"The renders alone do not yet show a choice that loses at most {tolerance}: {angle} is the best guess so "
            f"far, and may lose {alone}. More angles or more repeats would help."
        )
    return (
        f"By the renders alone {angle} loses at most {alone}; with the difference between simulation and capture it "
        f"may lose {loss}, more than the {tolerance} that count as equal. More renders will not help; a better model "
        "or more captures would."
    )


def equivalent_text(statement: AngleStatement) -> str:
    """Return the equivalent angles as ranges in deg."""
    ranges = [
        f"{low:.0f} to {high:.0f} deg" if high > low else f"{low:.0f} deg" for low, high in statement.equivalent_deg
    ]
    return ", ".join(ranges) or "none"


def simulation_sentence(report: PhotometricErrorReport) -> str:
    """Say how much of what the touch changes in the image the simulation explains, against both bounds."""
    skill, floor = report.headline_skill, row_of(headline(report), "floor")
    score = skill_text(skill.estimate, skill.low95, skill.high95)
    if skill.high95 < 0:
        meaning = f"The simulated touch is worse than leaving the image unchanged: skill {score}"
    elif skill.low95 <= 0:
        meaning = f"The simulated touch cannot be told from leaving the image unchanged: skill {score}"
    else:
        meaning = (
            f"The simulated touch explains {percent(skill.estimate)} of the squared change in the image: skill {score}"
        )
    bound = "no repeat was captured, so the best possible score is unknown"
    if floor is not None:
        ceiling = _ceiling(floor.skill.estimate)
        bound = f"a perfect simulation would score {ceiling}, limited by how well the capture itself repeats"
    return f"{meaning} over the region \u201c{report.headline_region}\u201d. Doing nothing scores 0; {bound}."


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


def _ceiling(skill: float) -> str:
    """Return the floor row's skill; what rounds to a perfect 1 is said to be above 0.999."""
    return "above 0.999" if skill > 0.999 else fixed(skill, 3)


def paint_sentence(paint: PaintResult) -> str:
    """Say where the paint's emission peaks and how wide it is, against the truth."""
    mode, width = paint.calibration.parameters["mode_nm"], paint.calibration.parameters["fwhm_nm"]
    name = "measured" if paint.truth.is_measured else "truth"
    caution = (
        "" if is_converged(paint.calibration.diagnostics) else " The sampler has NOT converged: do not use this fit."
    )
    return (
        f"The {paint.colour} paint emits most at {estimate_text(mode, 'nm')} "
        f"({name} {_beside(paint.truth.mode_nm, mode)}); its full width at half maximum is "
        f"{estimate_text(width, 'nm')} ({name} {_beside(paint.truth.fwhm_nm, width)}). "
        f"Over the whole spectrum the fit is off by {percent(curve_agreement(paint).error_rel)}.{caution}"
    )


def estimate_text(value: Estimate, unit: str = "") -> str:
    """Return an estimate with its 95 % interval."""
    return interval_text(value.estimate, value.low95, value.high95, unit)


def holds(value: Estimate, truth: float) -> bool:
    """Whether the 95 % interval holds the truth."""
    return value.low95 <= truth <= value.high95


def _beside(truth: float, value: Estimate) -> str:
    """Return the truth in nm and on which side of the 95 % interval it lies."""
    place = "inside" if holds(value, truth) else "outside"
    return f"{truth:.1f} nm, {place} the 95 % interval"


def model_statement(paint: PaintResult) -> str:
    """Say how well the fitted family describes this paint, from coverage, curve error and chi-square."""
    agreement = curve_agreement(paint)
    name = "measured" if paint.truth.is_measured else "true"
    facts = (
        f"{paint.colour.capitalize()} paint: the 95 % band covers {percent(agreement.coverage_95_rel)} of the "
        f"{name} curve, and the fitted curve differs from it by {percent(agreement.error_rel)} (relative RMS)"
    )
    return f"{facts}: {_model_verdict(paint, agreement)}. {_chi_square_remark(agreement)}"


def _model_verdict(paint: PaintResult, agreement: CurveAgreement) -> str:
    """Say what coverage and chi-square mean for this kind of paint."""
    if not is_converged(paint.calibration.diagnostics):
        return "the sampler has NOT converged, so this fit must not be used"
    if agreement.coverage_95_rel >= GOOD_COVERAGE:
        return "the paper's four-parameter family describes this paint within its stated uncertainty"
    if paint.truth.is_measured:
        return "the paper's four-parameter family is too stiff for this paint and its intervals are too narrow"
    if agreement.chi_square_p is not None and agreement.chi_square_p < SMALL_P:
        return "this paint belongs to the fitted family, so the measurement or the fit has gone wrong"
    return (
        "this paint belongs to the fitted family, so the low coverage is the luck of this one session: points along "
        "a curve err together"
    )


def _chi_square_remark(agreement: CurveAgreement) -> str:
    """Say whether the band signals alone would have revealed a misfit."""
    p = agreement.chi_square_p
    if p is None:
        return "There are too few band values to test the fit by chi-square."
    if p < SMALL_P:
        return f"The band signals reject the fit (chi-square, {_p_text(p)})."
    if agreement.coverage_95_rel < GOOD_COVERAGE:
        return f"The band signals alone do not reveal it (chi-square, {_p_text(p)}): the bands leave gaps."
    return f"The band signals agree (chi-square, {_p_text(p)})."


def _p_text(p: float) -> str:
    """Return a p-value; very small ones are only bounded."""
    return "p < 0.001" if p < 0.001 else f"p = {p:.2g}"


def is_converged(diagnostics: Diagnostics) -> bool:
    """Whether the chain is long enough, mixed, and holds enough effective samples."""
    r_hat, samples = max(diagnostics.r_hat.values()), min(diagnostics.effective_samples.values())
    return diagnostics.converged and r_hat <= LARGEST_R_HAT and samples >= SMALLEST_EFFECTIVE_SAMPLES


def chain_statement(diagnostics: Diagnostics) -> str:
    """Say whether the sampler's chain deserves trust."""
    r_hat, samples = max(diagnostics.r_hat.values()), min(diagnostics.effective_samples.values())
    return (
        f"{'converged' if is_converged(diagnostics) else 'NOT converged'}; largest R-hat {r_hat:.3f} (below "
        f"{LARGEST_R_HAT} wanted), at least {samples:.0f} effective samples (above {SMALLEST_EFFECTIVE_SAMPLES:.0f} "
        "wanted)."
    )


def truth_statement(results: DemoResults) -> str | None:
    """Say what the chosen angle costs on the hidden true finger, or None when that was not rendered."""
    if results.true_sweep is None:
        return None
    best_deg, loss = true_loss(results.true_sweep, results.decision.angle_deg)
    cost = "nothing measurable" if loss < 0.0005 else percent(loss)
    return (
        f"On the hidden true finger the best rendered angle is {best_deg:.0f} deg, and the chosen "
        f"{results.decision.angle_deg:.0f} deg loses {cost} against it."
    )


def bands_conclusion(paint: PaintResult) -> str:
    """Say how many bands the fit explains."""
    bands = [band for band in paint.calibration.bands if band.degrees_of_freedom > 0]
    poor = [band for band in bands if band.posterior_predictive_p < SMALL_P]
    if not poor:
        return f"all {len(bands)} bands agree with the fit"
    names = ", ".join(f"{band.center_nm:g} nm" for band in poor)
    return f"{len(bands) - len(poor)} of {len(bands)} bands agree with the fit; {names} do not"
