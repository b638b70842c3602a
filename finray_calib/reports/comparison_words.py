"""What a comparison says in plain sentences; every sentence is computed from the report."""

from typing import Literal

from data_schemas.compare import PhotometricErrorReport, ValidationCell
from finray_calib.reports.demo_results import headline, row_of
from finray_calib.reports.number_text import fixed, percent, signed_percent

Verdict = Literal[
    "As good as this capture can tell",
    "Better than no simulation",
    "Not told apart from no simulation",
    "Worse than no simulation",
]
_WELL_KNOWN = 0.9
"""A skill that may be below this is not told to be as good as the capture can tell, wherever its interval ends."""
_ROWS, _COLUMNS = ("top", "middle", "bottom"), ("left", "centre", "right")


def comparison_verdict(report: PhotometricErrorReport) -> Verdict:
    """Return where the interval of the skill lies: below or about 0 (doing nothing), above it, or at the floor."""
    skill, floor = report.headline_skill, row_of(headline(report), "floor")
    if skill.high95 < 0:
        return "Worse than no simulation"
    if skill.low95 <= 0:
        return "Not told apart from no simulation"
    if floor is not None and skill.high95 >= floor.skill.low95 and skill.low95 >= _WELL_KNOWN:
        return "As good as this capture can tell"
    return "Better than no simulation"


def verdict_meaning(report: PhotometricErrorReport) -> str:
    """Say what the verdict lets the reader do."""
    left = percent(max(1 - report.headline_skill.estimate, 0.0))
    skill, floor = report.headline_skill, row_of(headline(report), "floor")
    wide = ""
    if floor is not None and skill.high95 >= floor.skill.low95:
        wide = (
            f" The interval is wide: it may be as good as the capture can tell, or explain only {percent(skill.low95)}."
        )
    meaning: dict[Verdict, str] = {
        "As good as this capture can tell": "No difference between render and capture is shown beyond that of two "
        "captures of the same thing. A better simulation could not be told from this one with this capture.",
        "Better than no simulation": f"The simulation predicts what the touch changes, but not all of it: {left} of "
        f"the squared change is left over. The error map shows where.{wide}",
        "Not told apart from no simulation": "This capture gives no reason to prefer the simulation to an image of the "
        "untouched pad. Do not rely on the simulated touch; look at the findings, the pose and the light first.",
        "Worse than no simulation": "An image of the untouched pad is nearer to the capture than the simulated touch. "
        "Do not rely on it; look at the findings, the pose and the light first.",
    }
    return meaning[comparison_verdict(report)]


def objective_sentence(report: PhotometricErrorReport) -> str | None:
    """Say how far the brightness beside the indenter is off; None where it was not measured."""
    if report.objective_error is None:
        return None
    error = report.objective_error.error_rel
    low, high = signed_percent(error.low95), signed_percent(error.high95)
    if error.low95 <= 0 <= error.high95:
        return (
            f"Beside the indenter no difference in brightness is seen: {signed_percent(error.estimate)}, 95 %: {low} "
            f"to {high}. This is what 'finray decide' takes from this comparison."
        )
    side = "brighter" if error.estimate > 0 else "darker"
    return (
        f"Beside the indenter the simulation is {percent(abs(error.estimate))} {side} than the capture (95 %: {low} "
        f"to {high}). This is what 'finray decide' takes from this comparison."
    )


def validation_sentence(cells: tuple[ValidationCell, ...]) -> str | None:
    """Say in how many parts the level agrees, and where it is worst; None without cells."""
    if not cells:
        return None
    within = sum(cell.within for cell in cells)
    if within == len(cells):
        return f"Level by part: all {within} parts and channels agree within the validation uncertainty."
    worst = max((cell for cell in cells if not cell.within), key=lambda cell: abs(cell.error_rel))
    return (
        f"Level by part: {within} of {len(cells)} parts and channels agree within the validation uncertainty; the "
        f"largest error outside it is {signed_percent(worst.error_rel)} in {worst.channel}, {place(worst)}."
    )


def place(cell: ValidationCell) -> str:
    """Return where in the image a cell lies."""
    return f"{_ROWS[cell.row]} {_COLUMNS[cell.column]}"


def limits(report: PhotometricErrorReport) -> tuple[str, ...]:
    """Return what the numbers do not know: reach of the intervals, withheld figures, findings of the checks."""
    told = [f"The intervals cover {report.interval_covers.rstrip('.')}."]
    if report.monte_carlo is not None:
        run = report.monte_carlo
        told += [f"Not in the intervals: {reason.rstrip('.')}." for reason in run.not_included]
        if run.significant_digits == 0:
            told.append(
                f"The Monte Carlo run of {run.draws} draws ended before the uncertainty was steady to one significant "
                "digit: the ends of the interval may change with another seed."
            )
    skills = (report.headline_skill, *(row.skill for region in report.regions for row in region.rows))
    if any(skill.estimate > 1 and skill.low95 >= 1 for skill in skills):
        told.append(
            "An interval from 1 to 1 beside an estimate above 1 is the rest of one that lies above 1 altogether: model "
            "and noise disagree. Less is left of the difference than the noise that was taken out, so that this noise "
            "is too large, or the capture was used to make the render."
        )
    if any(skill.estimate > 1 > skill.low95 for skill in skills):
        told.append(
            "An estimate of a skill above 1 means 1 within its uncertainty: the noise is taken out, and what is left "
            "scatters about the true skill, which cannot exceed 1. Intervals end there."
        )
    if report.values != "linear light":
        told.append(
            "The images hold encoded values of an unknown camera curve, not light: scores compare code values only."
        )
    told += [f"Withheld: {reason.rstrip('.')}." for reason in report.withheld]
    told += [f"Check: {finding.rstrip('.')}." for finding in report.findings]
    return tuple(told)


def exposure_sentence(report: PhotometricErrorReport) -> str:
    """Say whether the render was scaled, and by what."""
    if report.exposure_factor is None:
        return "The render was not scaled."
    sd = report.exposure_factor_sd
    known = "" if sd is None or sd <= 0 else f", known to {percent(sd / report.exposure_factor)} (standard uncertainty)"
    return (
        f"The render was multiplied by one exposure factor, the same for all channels{known}. No other correction was "
        "fitted, so an error of a paint or of the light stays visible."
    )


def scale_sentences(report: PhotometricErrorReport) -> tuple[str, ...]:
    """Say how large the contact patch is on the pad; nothing where the scale was not given."""
    scale = report.patch_scale
    if scale is None:
        return ()
    middle, patch = scale.middle, scale.extents[0]
    return (
        f"At the patch a raw pixel spans {middle.along_x_mm_per_px:.4g} mm along x and {middle.along_y_mm_per_px:.4g} "
        f"mm along y (standard uncertainties {percent(middle.along_x_u_rel)} and {percent(middle.along_y_u_rel)}); the "
        f"{patch.region} of the render is {patch.along_x_mm:.3g} mm by {patch.along_y_mm:.3g} mm.",
    )


def error_alternative(report: PhotometricErrorReport, typical_rel: float, large_rel: float) -> str:
    """Say in words what the error map shows."""
    skill = report.headline_skill
    return (
        f"Map of the error of the simulation: half of the image errs by less than {percent(typical_rel)} of the "
        f"untouched level, one in twenty by more than {percent(large_rel)}. Skill {fixed(skill.estimate, 2)}."
    )
