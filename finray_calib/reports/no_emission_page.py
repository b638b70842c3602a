"""The page of a sample in which no emission was found: one HTML file, the verdict and its limit first."""

from collections.abc import Mapping

from data_schemas.emission_detection import PaintWithoutEmission
from data_schemas.provenance import package_version
from finray_calib.reports.band_figures import blank_figure
from finray_calib.reports.number_text import fixed, percent
from finray_calib.reports.origin_tables import files_table
from finray_calib.reports.page import render_page
from finray_calib.reports.plain_json import plain
from finray_calib.reports.section import Content, Part, drawing

TEMPLATE = "result_page.html.j2"


def no_emission_page(paint: PaintWithoutEmission, command: str, digests: Mapping[str, str]) -> str:
    """Return the page of a sample without emission as self-contained HTML; equal input gives equal text.

    Parameters
    ----------
    paint
        The record.
    command
        The command that reproduces it.
    digests
        Name of each input file -> SHA-256.
    """
    found = paint.detection
    return render_page(
        TEMPLATE,
        verb="finray fit",
        title=f"No emission: {paint.paint_name}",
        lead=f"Whether this sample emits light when the laser at {paint.optics.laser.wavelength_nm:g} nm shines on it.",
        verdict="No emission",
        sentence=f"{found.statement[:1].upper()}{found.statement[1:]}.",
        key_numbers=_key_numbers(paint),
        findings=_findings(paint),
        limits=_limits(paint),
        notes=paint.warnings,
        sections=(_signals(paint),),
        command=command,
        files=files_table(digests, package_version()),
        summary=plain(paint.model_dump(mode="json", exclude={"provenance", "optics"})),
    )


def _key_numbers(paint: PaintWithoutEmission) -> tuple[tuple[str, str, str], ...]:
    """Return (label, value, remark) of the few numbers that stand beside the verdict."""
    found = paint.detection
    limit = "not stated" if found.yield_limit is None else f"below {percent(found.yield_limit)}"
    modes = f"with 95 %, modes from {found.limit_low_nm:.0f} to {found.limit_high_nm:.0f} nm"
    return (
        ("Energy yield", limit, modes),
        ("Signal beyond a blank", f"{fixed(found.statistic_sd, 1)} sd", f"threshold {fixed(found.threshold_sd, 1)} sd"),
        ("Reflects of the laser", percent(paint.reflectance_at_laser), "from the filter at its line"),
    )


def _findings(paint: PaintWithoutEmission) -> tuple[str, ...]:
    """Return what to do, and what the decision rests on."""
    found = paint.detection
    return (
        "There is no spectrum, no mode and no width in this record: the signals do not hold any. It cannot be "
        "simulated with, mapped or exported.",
        f"{percent(found.blanks_above)} of {found.blanks} simulated samples of the same rig and reflectance, which "
        "emit nothing, show at least as much.",
        "If this should be a fluorescent paint: look at whether the laser was on, the right sample in view and the "
        "region inside it, and measure again with longer exposures.",
    )


def _limits(paint: PaintWithoutEmission) -> tuple[str, ...]:
    """Return what the decision does not know."""
    found = paint.detection
    return (
        f"Emission with its mode beyond {found.limit_high_nm:.0f} nm is not seen by these filters.",
        "The limit rests on the filters' blocking as the rig file states it, and on an allowance for stray light of "
        "0.03 % of the laser. Filters that leak more make blanks look like paints.",
        f"Of samples without any emission {percent(found.false_alarm)} are called paints.",
    )


def _signals(paint: PaintWithoutEmission) -> Part:
    """Show what was measured beside what a blank would show."""
    picture = drawing(
        blank_figure(paint),
        "Measured band signals agree with those of a sample that reflects the laser and emits nothing.",
        "Band signals and what is expected of a sample that reflects as much of the laser and emits nothing. Boxes: "
        "two standard deviations of noise, leaks, tolerances and stray light. Open markers are not used.",
    )
    lead = "What was measured through each filter, and what reflected laser, leak and stray light alone would give."
    return Part("Band signals", Content(lead, ((picture,),)))
