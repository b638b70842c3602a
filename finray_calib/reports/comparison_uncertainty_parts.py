"""The parts of a comparison's page on its uncertainty: the budget, and where the level agrees."""

from data_schemas.compare import InputUncertainty, PhotometricErrorReport
from finray_calib.reports import comparison_words as words
from finray_calib.reports.budget_figure import budget_figure
from finray_calib.reports.metric_tables import CHANNELS
from finray_calib.reports.number_text import percent, significant
from finray_calib.reports.section import Content, Part, Picture, drawing
from finray_calib.reports.uncertainty_tables import budget_table, validation_table
from finray_calib.reports.validation_figure import validation_figure

_STEADY = ("not yet steady to one significant digit", "steady to one significant digit", "steady to two digits")
"""By the number of steady digits of the headline's standard uncertainty."""


def budget_part(report: PhotometricErrorReport) -> Part:
    """Show what each input adds to the uncertainty."""
    largest = max(report.budget, key=lambda line: line.skill_u)
    run = report.monte_carlo
    steady = ""
    if run is not None:
        digits = _STEADY[run.significant_digits]
        steady = f" The intervals come from {run.draws} draws of all inputs together (JCGM 101), {digits}."
    share = largest.skill_u**2 / (sum(line.skill_u**2 for line in report.budget) or 1.0)
    lead = (
        f"The largest contribution is {largest.input}: {percent(share)} of the sum of squares of the lines below, "
        f"which need not add up to the whole.{steady}"
    )
    return Part("Uncertainty", Content(lead, (_bars(report),), tables=(budget_table(report),)))


def _bars(report: PhotometricErrorReport) -> tuple[Picture, ...]:
    """Show what each input adds to the skill, and to the brightness where that is known."""
    see = "What to see: to make the interval narrower, work on the longest bar first."
    skill = [(line, line.skill_u) for line in report.budget]
    brightness = [(line, line.objective_u_rel) for line in report.budget if line.objective_u_rel is not None]
    pictures = [
        drawing(
            budget_figure(skill, lambda u: significant(u, 2), "standard uncertainty of the skill (1)"),
            f"Bars: {_ranking(skill)} add most to the uncertainty of the skill.",
            f"What each input adds to the uncertainty of the skill when it alone varies. {see}",
        )
    ]
    if brightness:
        pictures.append(
            drawing(
                budget_figure(brightness, percent, "standard uncertainty of the brightness, relative (1)"),
                f"Bars: {_ranking(brightness)} add most to the uncertainty of the brightness beside the indenter.",
                f"The same for the brightness beside the indenter. {see}",
            )
        )
    return tuple(pictures)


def _ranking(bars: list[tuple[InputUncertainty, float]]) -> str:
    """Return the names of the two longest bars."""
    ranked = sorted(bars, key=lambda bar: -bar[1])
    return " and ".join(line.input for line, _ in ranked[:2])


def validation_part(report: PhotometricErrorReport) -> Part:
    """Show in which parts and channels the level agrees."""
    sentence = words.validation_sentence(report.validation) or ""
    pictures = []
    for channel in CHANNELS:
        cells = tuple(cell for cell in report.validation if cell.channel == channel)
        found = f"{channel}: {sum(cell.within for cell in cells)} of {len(cells)} parts within"
        pictures.append(drawing(validation_figure(cells), f"Error of the level, {found}.", found, is_small=True))
    lead = "Area: what lies between the distributions of simulation and capture, split by sign."
    numbers = Content(lead, tables=(validation_table(report),), has_wide_tables=True)
    detail = Part("Numbers of every part", numbers, is_detail=True)
    remark = (
        "Error of the mean level in the parts of the scored region, as they lie in the image. Within: the error is "
        "smaller than twice the validation uncertainty u of render, inputs and capture. Outside (thick frame, "
        "hatched): the simulation is wrong there by about the error."
    )
    title = "Where the level agrees (ASME V&V 20)"
    return Part(title, Content(sentence, (tuple(pictures),), (remark,), parts=(detail,)))
