"""The page of one comparison: one HTML file with everything inside, the verdict first, readable without scripts."""

from collections.abc import Mapping

from data_schemas.capture import TactileCapture
from data_schemas.compare import PhotometricErrorReport, SensingError
from data_schemas.provenance import package_version
from data_schemas.simulate import SimulatedPress
from finray_calib.reports import comparison_words as words
from finray_calib.reports.comparison_images import require_one_grid
from finray_calib.reports.comparison_images_part import images_part
from finray_calib.reports.comparison_uncertainty_parts import budget_part, validation_part
from finray_calib.reports.demo_results import headline, row_of
from finray_calib.reports.metric_tables import metric_table, sensing_table
from finray_calib.reports.number_text import fixed, percent, signed_percent
from finray_calib.reports.origin_tables import files_table, images_table, scale_table
from finray_calib.reports.page import render_page
from finray_calib.reports.plain_json import Json, plain
from finray_calib.reports.section import Content, Part
from finray_calib.reports.statements import is_noise_taken_out, repeat_text, simulation_sentence
from finray_calib.reports.touch_sections import grid_phrase

TEMPLATE = "result_page.html.j2"


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
    objective, parts = words.objective_sentence(report), words.validation_sentence(report.validation)
    found = (words.verdict_meaning(report), *(text for text in (objective, parts) if text is not None))
    return render_page(
        TEMPLATE,
        verb="finray compare",
        title=f"{report.simulated} against {report.captured}",
        lead=f"How far a simulated touch is from a real one. Simulation: {report.label}. Compared "
        f"{grid_phrase(report)}; values: {report.values}.",
        verdict=words.comparison_verdict(report),
        sentence=simulation_sentence(report),
        key_numbers=_key_numbers(report),
        findings=found,
        limits=words.limits(report),
        notes=report.notes,
        sections=tuple(_sections(report, press, capture)),
        command=command,
        files=files_table(digests, package_version()),
        summary=_summary(report, command, digests),
    )


def _key_numbers(report: PhotometricErrorReport) -> tuple[tuple[str, str, str], ...]:
    """Return (label, value, remark) of the few numbers that stand beside the verdict."""
    skill, floor = report.headline_skill, row_of(headline(report), "floor")
    repeated = ("not known", "no repeat of the no-contact image was captured")
    if floor is not None:
        noise = "with its noise, which the simulation's score is free of"
        if not is_noise_taken_out(report):
            noise = "with its noise, which is in the simulation's score too"
        repeated = (repeat_text(floor.skill.estimate), noise)
    between = f"95 %: {fixed(skill.low95, 2)} to {fixed(skill.high95, 2)}"
    numbers = [
        ("Skill of the simulation", fixed(skill.estimate, 2), between),
        ("Doing nothing", "0", "the untouched image in its place"),
        ("A repeated capture", *repeated),
    ]
    if report.objective_error is not None:
        error = report.objective_error.error_rel
        between = f"95 %: {signed_percent(error.low95)} to {signed_percent(error.high95)}"
        numbers.append(("Brightness beside the indenter", signed_percent(error.estimate), between))
    return tuple(numbers)


def _sections(report: PhotometricErrorReport, press: SimulatedPress, capture: TactileCapture) -> list[Part]:
    """Return images, metrics, uncertainty, parts and origin, as far as there are any."""
    parts = [images_part(report, press, capture), _metrics(report)]
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


def _sensed(sensing: SensingError) -> Part:
    """Show the error in sensing space."""
    score = sensing.held_out_explained_rel
    simulation = next(row for row in sensing.rows if row.candidate == "simulation")
    outside = max(sensing.outside_share_simulated, sensing.outside_share_captured)
    remarks = [
        f"The map '{sensing.normal_map}' was taught by {sensing.presses} presses; of presses that it had not seen it "
        f"explains {percent(score.estimate)} of the squared slopes ({percent(score.low95)} to {percent(score.high95)} "
        "over random halves). A wrong map is wrong on both sides alike, and its errors partly cancel here."
    ]
    if outside > 0.0:
        remarks.append(f"{percent(outside)} of the pixels show a change of colour that no calibration press showed.")
    if sensing.mm_per_px_u_rel is not None:
        # the step of the integration and the size of the calibration ball in pixels both carry the scale
        remarks.append(
            f"All depths rest on one scale, whose standard uncertainty of {percent(sensing.mm_per_px_u_rel)} is not in "
            f"their intervals; it changes them by about {percent(2.0 * sensing.mm_per_px_u_rel)}, all alike."
        )
    angle = simulation.normal_angle_mean_deg
    return Part(
        "As the sensor would see it",
        Content(
            lead="One map from colour to surface normals is applied to render and capture. The normals differ by "
            f"{fixed(angle.estimate, 1)} deg in the mean ({fixed(angle.low95, 1)} to {fixed(angle.high95, 1)} deg).",
            tables=(sensing_table(sensing),),
            remarks=tuple(remarks),
            has_wide_tables=True,
        ),
    )


def _metrics(report: PhotometricErrorReport) -> Part:
    """Show every metric of every region."""
    return Part(
        "All metrics",
        Content(
            lead="Every number stands beside doing nothing (the untouched image in place of the simulation) and the "
            "floor (a second capture without contact in place of the first). A metric that rates doing nothing nearly "
            "as good as the simulation cannot tell them apart. Square brackets: 95 % interval.",
            tables=tuple(metric_table(report, region) for region in report.regions),
            remarks=(f"SSIM: {report.ssim_settings}.",),
            has_wide_tables=True,
        ),
    )


def _summary(report: PhotometricErrorReport, command: str, digests: Mapping[str, str]) -> Json:
    """Return every number of the page; draws and map stay in the record."""
    objective = report.objective_error
    draws = {"log_ratio_draws", "log_exposure_draws"}
    numbers: Json = plain(
        {
            "photometric_error": {
                **report.model_dump(mode="json", exclude={"error_map", "provenance", "objective_error"}),
                "objective_error": None if objective is None else objective.model_dump(mode="json", exclude=draws),
            },
            "command": command,
            "input_sha256": dict(digests),
            "package_version": package_version(),
        }
    )
    return numbers
