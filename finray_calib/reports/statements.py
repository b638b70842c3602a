"""What the numbers mean, in plain sentences; every sentence is computed from the records."""

from data_schemas.compare import PhotometricErrorReport
from data_schemas.decide import AngleStatement, LightAngleDecision
from finray_calib.reports.demo_results import DemoResults, headline, row_of
from finray_calib.reports.number_text import fixed, percent, skill_text
from finray_calib.reports.summary import true_loss


def verdict_meaning(decision: LightAngleDecision) -> str:
    """Say what the verdict tells a designer to do."""
    tolerance, angle = percent(decision.tolerance_rel), f"{decision.angle_deg:.0f} deg"
    alone_angle = f"{decision.angle_simulation_only_deg:.0f} deg"
    loss, alone = percent(decision.statement.regret_95), percent(decision.statement_simulation_only.regret_95)
    if decision.at_range_end:
        return (
            f"The best angle found, {angle}, is at the end of the sweep. The optimum may lie outside the sweep: widen "
            "it. Until then no tolerance can be promised, and a loss is one against the angles of this sweep only."
        )
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
        moved = f" With captures the best guess is {angle}." if decision.validated else ""
        return (
            f"The renders alone do not yet show a choice that loses at most {tolerance}: {alone_angle} is their best "
            f"guess so far, and may lose {alone}.{moved} More angles or more repeats would help."
        )
    if not decision.validated:
        return (
            f"By the renders alone {alone_angle} loses at most {alone}, but no capture has shown how far the finger "
            f"differs from the simulation. With what is assumed until one does, {angle} is the best guess and may lose "
            f"{loss}. More renders will not help; a capture would."
        )
    return (
        f"By the renders alone {alone_angle} loses at most {alone}; with the difference between simulation and capture "
        f"{angle} is the best guess and may lose {loss}, more than the {tolerance} that count as equal. More renders "
        "will not help; a better model or more captures would."
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
        # with the noise taken out an estimate may lie above 1
        share = "all" if skill.estimate >= 1 else percent(skill.estimate)
        meaning = f"The simulated touch explains {share} of the squared change in the image: skill {score}"
    bound, taken_out = "no repeat was captured, so the camera's noise is unknown and lowers the score", ""
    if floor is not None:
        repeated = repeat_text(floor.skill.estimate)
        bound = f"a repeated capture in its place scores {repeated}; the noise of encoded values stays in both scores"
    if floor is not None and is_noise_taken_out(report):
        bound = f"a repeated capture in its place, whose noise is not, scores {repeated}"
        taken_out = " (the camera's noise is taken out)"
    return (
        f"{meaning} over the region \u201c{report.headline_region}\u201d. Doing nothing scores 0, a perfect simulation "
        f"1{taken_out}; {bound}."
    )


def is_noise_taken_out(report: PhotometricErrorReport) -> bool:
    """Return whether the scores are free of the camera's noise: linear light, and a repeat to tell its noise from."""
    return report.values == "linear light" and row_of(headline(report), "floor") is not None


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


def repeat_text(skill: float) -> str:
    """Return the floor row's skill; what rounds to a perfect 1 is said to be above 0.999."""
    return "above 0.999" if skill > 0.999 else fixed(skill, 3)


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
