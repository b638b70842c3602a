"""The page of one comparison: one HTML file with everything inside, the verdict first, readable without scripts.

Capture, render, what the touch changes in both, the error, all metrics, the budget of the uncertainty, and where the
level agrees.
"""

from collections.abc import Mapping
from typing import TypedDict

import numpy as np

from data_schemas import (
    ErrorAttribution,
    InputUncertainty,
    PhotometricErrorReport,
    SensingError,
    SimulatedPress,
    TactileCapture,
    package_version,
)
from finray_calib.compare import OWN_NOISE
from finray_calib.reports import _comparison_statements as words
from finray_calib.reports._comparison_figures import (
    budget_figure,
    cause_figure,
    change_figures,
    error_map_figure,
    score_figure,
    tone_figure,
    validation_figure,
)
from finray_calib.reports._comparison_statements import (
    CHANNELS,
    budget_table,
    headline,
    metric_table,
    packaged_metric_table,
    row_of,
    sensing_table,
    tone_table,
    validation_table,
    white_balance_table,
)
from finray_calib.reports._images import (
    TouchChanges,
    TouchPictures,
    clipped_remark,
    display_remark,
    pad_window,
    require_one_grid,
    touch_changes,
    touch_pictures,
)
from finray_calib.reports._methods import comparison_methods, methods_part
from finray_calib.reports._page import (
    Content,
    KeyNumber,
    Light,
    Part,
    Picture,
    PicturePair,
    ReportPage,
    drawing,
    files_table,
    findings_section,
    images_table,
    in_rows,
    light_of,
    limits_section,
    raster,
    report_html,
    scale_table,
)
from finray_calib.reports._plain_text import (
    Json,
    fixed,
    interval_name,
    percent,
    plain,
    relative_sentence,
    signed_percent,
    significant,
)


def comparison_page(
    report: PhotometricErrorReport,
    press: SimulatedPress,
    capture: TactileCapture,
    command: str,
    digests: Mapping[str, str],
) -> str:
    """Return the page of a comparison as self-contained HTML; equal input gives equal text.

    Parameters
    ----------
    report
        The comparison.
    press, capture
        What was compared, on one grid.
    command
        The command that reproduces it.
    digests
        Name of each input file -> SHA-256.

    Raises
    ------
    RecordError
        Render and capture are not on one grid.
    """
    require_one_grid(press, capture)
    factors = tuple(region.factor for region in report.regions)
    pictures = touch_pictures(press, capture, factors)
    return report_html(
        ReportPage(
            verb="finray compare",
            title=f"{report.simulated}, compared with {report.captured}",
            lead=f"How far a simulated touch is from a real one. Simulation: {report.label}. Compared "
            f"{words.grid_phrase(report)}; values: {report.values}.{relative_sentence(report)}",
            **_judged(report),
            picture=_touched(report, pictures),
            key_numbers=_key_numbers(report),
            parts=(
                *findings_section(_findings(report)),
                limits_section(words.limits(report), report.notes),
                *_sections(report, press, capture, pictures),
                methods_part(comparison_methods(report), report.provenance),
            ),
            command=command,
            origin=files_table(digests, package_version()),
            summary=_summary(report, command, digests),
        )
    )


class _Judged(TypedDict):
    """Verdict, its light and its meaning."""

    verdict: str
    light: Light
    sentence: str


def _judged(report: PhotometricErrorReport) -> _Judged:
    """Return the verdict; a capture that was made from this render proves nothing of the simulation."""
    if OWN_NOISE in report.findings:
        why = "The capture was made from this render: agreement shows only that the comparison works."
        return {"verdict": "This comparison proves nothing about the simulation", "light": "care", "sentence": why}
    skill = report.headline_skill
    light = words.judged_skill(skill.low95, skill.high95)[0]
    return {"verdict": words.comparison_verdict(report), "light": light, "sentence": words.verdict_meaning(report)}


def _findings(report: PhotometricErrorReport) -> tuple[str, ...]:
    """Return skill, brightness and level in sentences."""
    told = (words.objective_sentence(report), words.validation_sentence(report.validation))
    return (words.simulation_sentence(report), *(text for text in told if text is not None))


def skill_number(report: PhotometricErrorReport) -> KeyNumber:
    """Return the skill for the first screen."""
    skill = report.headline_skill
    judged = words.judged_skill(skill.low95, skill.high95)
    if OWN_NOISE in report.findings:
        judged = "care", "the capture was made from this render"
    name = "Relative skill of the simulation" if report.relative else "Skill of the simulation"
    return KeyNumber(name, fixed(skill.estimate, 2), _skill_between(report), *judged)


def _key_numbers(report: PhotometricErrorReport) -> tuple[KeyNumber, ...]:
    """Return skill, its upper bound, and the brightness that a decision takes; without that the lower bound."""
    floor = row_of(headline(report), "floor")
    repeated = ("not known", "no repeat of the no-contact image was captured")
    if floor is not None:
        noise = "the camera's noise is taken out of this number, as of the simulation's skill"
        if not words.is_noise_taken_out(report):
            noise = "the camera's noise is in this number, and in the simulation's skill too"
        repeated = (words.repeat_text(floor.skill.estimate), noise)
    known = "the camera's noise is not known" if floor is None else "the camera's noise is known"
    numbers = (
        skill_number(report),
        KeyNumber("Skill of a repeated capture", *repeated, light_of(floor is not None), known),
    )
    if report.objective_error is None:
        return (*numbers, KeyNumber("Doing nothing", "0", "an image of the untouched pad in place of the simulation"))
    error = report.objective_error.error_rel
    between = f"95 %: {signed_percent(error.low95)} to {signed_percent(error.high95)}"
    is_seen = not error.low95 <= 0 <= error.high95
    reason = "its interval does not contain 0, so a difference is seen" if is_seen else "its interval contains 0"
    brightness = signed_percent(error.estimate)
    return (
        *numbers,
        KeyNumber("Brightness beside the indenter", brightness, between, light_of(not is_seen), reason),
    )


def _skill_between(report: PhotometricErrorReport) -> str:
    """Return the ends of the skill's interval, and what they are of."""
    skill = report.headline_skill
    if skill.low95 == skill.high95:
        return "without an interval: no input with a known uncertainty changes it"
    places = 2 if fixed(skill.low95, 2) != fixed(skill.high95, 2) else 3
    if fixed(skill.low95, places) == fixed(skill.high95, places):
        return "its interval is narrower than 0.001"
    ends = f"{fixed(skill.low95, places)} to {fixed(skill.high95, places)}"
    return f"95 %: {ends}" if interval_name(report) == "95 %" else f"over pixels of this press: {ends}"


def _sections(
    report: PhotometricErrorReport, press: SimulatedPress, capture: TactileCapture, pictures: TouchPictures
) -> list[Part]:
    """Return images, metrics, uncertainty, parts and origin, as far as there are any."""
    parts = [images_part(report, press, capture, pictures)]
    if report.attribution is not None:
        parts.append(causes_part(report.attribution))
    parts.append(_metrics(report))
    if report.tone_curve is not None or report.white_balance is not None:
        parts.append(_camera(report))
    if report.budget:
        parts.append(budget_part(report))
    if report.validation:
        parts.append(validation_part(report))
    if report.sensing is not None:
        parts.append(_sensed(report.sensing))
    scales = () if report.patch_scale is None else (scale_table(report.patch_scale),)
    lead = " ".join((words.exposure_sentence(report), *words.scale_sentences(report)))
    parts.append(Part("What was compared", Content(lead=lead, tables=(*scales, images_table(press, capture)))))
    return parts


def _camera(report: PhotometricErrorReport) -> Part:
    """Show the tone curve that was fitted, and the gains between the captured images."""
    curve, drift = report.tone_curve, report.white_balance
    rows: tuple[tuple[Picture, ...], ...] = ()
    if curve is not None:
        picture = drawing(
            tone_figure(curve),
            f"Captured level against the light of the render, with a fitted curve. {words.tone_sentence(curve)}",
            "Without contact: captured level against the light of the render, one point for each block of pixels, the "
            "fitted curve of each channel and the 95 % band of its draws. What to see: the points should follow the "
            "curve; where they scatter, the render's light without contact is wrong.",
        )
        rows = ((picture,),)
    sentences = [] if curve is None else [words.tone_sentence(curve)]
    sentences += [] if drift is None else [words.white_balance_sentence(drift)]
    tables = [] if curve is None else [tone_table(curve)]
    tables += [] if drift is None else [white_balance_table(drift)]
    return Part("Tone curve of the camera", Content(" ".join(sentences), rows, tables=tuple(tables)))


def _sensed(sensing: SensingError) -> Part:
    """Show the error in sensing space."""
    score = sensing.held_out_explained_rel
    simulation = next(row for row in sensing.rows if row.candidate == "simulation")
    outside = max(sensing.outside_share_simulated, sensing.outside_share_captured)
    remarks = [
        f"The map '{sensing.normal_map}' was trained on {sensing.presses} presses. On presses that were not used to "
        f"train it, the map explains {percent(score.estimate)} of the squared slopes ({percent(score.low95)} to "
        f"{percent(score.high95)} over random halves). Errors of the map act on render and capture alike, so they "
        "partly cancel here."
    ]
    if outside > 0.0:
        remarks.append(f"{percent(outside)} of the pixels show a change of colour that no calibration press showed.")
    if sensing.mm_per_px_u_rel is not None:
        # the step of the integration and the size of the calibration ball in pixels both carry the scale
        remarks.append(
            f"All depths rest on one scale, whose standard uncertainty of {percent(sensing.mm_per_px_u_rel)} is not "
            "included in their intervals; twice this uncertainty changes all depths together by about "
            f"{percent(2.0 * sensing.mm_per_px_u_rel)}."
        )
    angle = simulation.normal_angle_mean_deg
    return Part(
        "As the sensor would see it",
        Content(
            lead="One map from colour to surface normals is applied to render and capture. The normals differ by "
            f"{fixed(angle.estimate, 1)} deg in the mean ({words.between(angle)}).",
            tables=(sensing_table(sensing),),
            remarks=tuple(remarks),
            has_wide_tables=True,
        ),
    )


def _metrics(report: PhotometricErrorReport) -> Part:
    """Show every metric of every region."""
    others = (packaged_metric_table(report.packaged_metrics),) if report.packaged_metrics else ()
    return Part(
        "All metrics",
        Content(
            lead="Every number is given also for doing nothing (the untouched image in place of the simulation) "
            "and for the floor (a second capture without contact in place of the first). A metric that rates "
            "doing nothing nearly as good as the simulation cannot distinguish them. Square brackets: "
            f"{_BRACKETS[interval_name(report)]}.",
            tables=(*(metric_table(report, region) for region in report.regions), *others),
            remarks=(f"SSIM: {report.ssim_settings}.",),
            has_wide_tables=True,
        ),
    )


_BRACKETS = {"95 %": "95 % interval", "over pixels": "spread over pixels of this press, not a 95 % interval"}


def _summary(report: PhotometricErrorReport, command: str, digests: Mapping[str, str]) -> Json:
    """Return every number of the page; draws and map stay in the record."""
    objective, causes = report.objective_error, report.attribution
    draws = {"log_ratio_draws", "log_exposure_draws"}
    numbers: Json = plain(
        {
            "photometric_error": {
                **report.model_dump(mode="json", exclude={"error_map", "provenance", "objective_error", "attribution"}),
                "objective_error": None if objective is None else objective.model_dump(mode="json", exclude=draws),
                "attribution": None if causes is None else causes.model_dump(mode="json", exclude={"maps"}),
            },
            "command": command,
            "input_sha256": dict(digests),
            "package_version": package_version(),
        }
    )
    return numbers


_BLANK = " Blank: not compared (clipped, or not on the pad)."


def images_part(
    report: PhotometricErrorReport, press: SimulatedPress, capture: TactileCapture, pictures: TouchPictures
) -> Part:
    """Show the captured touch, what the touch changes in capture and render, and the error."""
    factors = tuple(region.factor for region in report.regions)
    blank = _BLANK if np.isnan(report.error_map).any() else ""
    changes = _changes(report, touch_changes(press, capture, factors), blank)
    rows = ((_captured(pictures),), changes, (_error(report, press, blank), _scores(report)))
    return Part("Images", Content(lead=display_remark(press), picture_rows=rows))


def _captured(shown: TouchPictures) -> PicturePair:
    """Show the pad as captured, before and after the touch."""
    return PicturePair(
        raster(
            shown.captured_untouched,
            "Captured image of the untouched pad.",
            f"Captured, no contact.{clipped_remark(shown.clipped[0])}",
        ),
        _captured_contact(shown),
        "Slide between the captured images without and with contact",
    )


def _captured_contact(shown: TouchPictures) -> Picture:
    """Show the captured touch."""
    return raster(
        shown.captured,
        "Captured image of the pressed pad, scored regions outlined.",
        f"Captured, contact. Outlined: the regions that are scored.{clipped_remark(shown.clipped[1])}",
    )


def _touched(report: PhotometricErrorReport, shown: TouchPictures) -> PicturePair:
    """Show the touch as captured and as simulated."""
    simulated = raster(
        shown.simulated,
        f"Simulated image of the pressed pad. {words.simulation_sentence(report)}",
        "Simulated, contact. What to see: inside the outlines it should look like the capture, except for noise.",
    )
    return PicturePair(_captured_contact(shown), simulated, "Slide between the captured and the simulated touch")


def _changes(report: PhotometricErrorReport, changes: TouchChanges, blank: str) -> tuple[Picture, ...]:
    """Show what the touch changes in capture and render, and what is left over."""
    captured, simulated, left = change_figures(changes)
    return (
        drawing(
            captured,
            "Map of what the touch changes in the capture.",
            f"Change by the touch, captured: bright is brighter than untouched, dark is darker.{blank}",
            is_small=True,
        ),
        drawing(
            simulated,
            "Map of what the touch changes in the simulation.",
            "Change by the touch, simulated, on the same scale. What to see: it should agree with the captured one.",
            is_small=True,
        ),
        drawing(
            left,
            f"Map of simulated minus captured change. {words.verdict_meaning(report)}",
            "Simulated minus captured, on the same scale. What to see: the map should be uniform.",
            is_small=True,
        ),
    )


def _error(report: PhotometricErrorReport, press: SimulatedPress, blank: str) -> Picture:
    """Show where the simulation is wrong."""
    typical, large = (float(np.nanpercentile(np.abs(report.error_map), p)) for p in (50, 95))
    return drawing(
        error_map_figure(report, press.distance <= headline(report).factor, pad_window(press)),
        words.error_alternative(report, typical, large),
        "Error of the simulation, RMS over the channels, relative to the untouched level; outlined: the region of the "
        "headline score. What to see: bright spots are where the simulation is wrong; the noise of both images is part "
        f"of it.{blank}",
    )


def _scores(report: PhotometricErrorReport) -> Picture:
    """Return the figure of the skill."""
    return drawing(
        score_figure(report),
        words.simulation_sentence(report),
        f"Skill by region; bars: {_BRACKETS[interval_name(report)]}. What to see: the nearer the circle is to 1, the "
        f"less can be improved; the diamond is a repeated capture; at 0 the simulation is only as "
        "good as an image of the untouched pad.",
    )


def causes_part(found: ErrorAttribution) -> Part:
    """Show what the skill is lost by: size, picture and what to do, with the sum and what is left."""
    maps = found.maps
    pictures = (
        []
        if maps is None
        else [
            drawing(
                cause_figure(maps[k], maps),
                f"What {cause.cause} changes in the image; it costs {fixed(cause.skill_lost, 3)} of skill.",
                f"{cause.cause.capitalize()}: {cause.advice}.",
                is_small=len(found.causes) > 1,
            )
            for k, cause in enumerate(found.causes)
        ]
    )
    return Part(
        "Causes of the lost skill",
        Content(
            words.causes_sentence(found),
            in_rows(pictures),
            remarks=words.causes_remarks(found),
            tables=(words.causes_table(found),),
        ),
    )


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
            f"Bars: {_ranking(skill)} contribute most to the uncertainty of the skill.",
            f"What each input adds to the uncertainty of the skill when it alone varies. {see}",
        )
    ]
    if brightness:
        pictures.append(
            drawing(
                budget_figure(brightness, percent, "standard uncertainty of the brightness, relative (1)"),
                f"Bars: {_ranking(brightness)} contribute most to the uncertainty of the brightness beside "
                "the indenter.",
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
    lead = "Area: the area between the distributions of simulation and capture, split by sign."
    numbers = Content(lead, tables=(validation_table(report),), has_wide_tables=True)
    detail = Part("Numbers of every part", numbers, is_detail=True)
    remark = (
        "Error of the mean level in the parts of the scored region, as they lie in the image. Within: the error is "
        "smaller than twice the validation uncertainty u of render, inputs and capture. Outside (thick frame, "
        "hatched): the simulation is wrong there by about the error."
    )
    title = "Where the level agrees (ASME V&V 20)"
    return Part(title, Content(sentence, (tuple(pictures),), (remark,), parts=(detail,)))
