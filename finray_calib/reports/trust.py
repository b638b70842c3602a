"""How far the report can be trusted: what limits it, what was assumed, and every note of the records."""

from collections.abc import Callable

from data_schemas.decide import LightAngleDecision
from finray_calib.reports.decision_words import validation_sentence
from finray_calib.reports.demo_results import COLOURS, DemoResults, PaintResult
from finray_calib.reports.fit_statements import model_statement
from finray_calib.reports.number_text import percent


def limits(results: DemoResults) -> tuple[str, ...]:
    """Return what limits the trust in this report, computed from the records."""
    paints = [results.paints[colour] for colour in COLOURS]
    fit_warnings = [
        f"Warning of the {paint.colour} paint's fit: {warning}."
        for paint in paints
        for warning in paint.calibration.warnings
    ]
    return (
        f"Renderer: {results.renderer_note.rstrip('.')}.",
        f"Capture: {results.capture.source}.",
        *(model_statement(paint.fitted, paint.truth) for paint in paints),
        *fit_warnings,
        validation_statement(results.decision),
        *(f"Withheld: {reason}." for reason in results.report.withheld),
    )


def validation_statement(decision: LightAngleDecision) -> str:
    """Say whether the sim-to-real error entered the decision."""
    if not decision.validated or decision.discrepancy_rel is None:
        return validation_sentence(decision)
    return (
        f"The decision carries a sim-to-real error of {percent(decision.discrepancy_rel)} (standard deviation of "
        "the objective), taken from the comparison with one capture at one light angle; that it holds at other "
        "angles is assumed."
    )


def assumptions(results: DemoResults) -> tuple[str, ...]:
    """List what was taken for granted: curves of the rig, numbers of the finger, and shortcuts of the simulation."""
    optics = results.paints["red"].bands.optics
    sources = sorted({curve.source for curve in optics.camera_response})
    listed = [
        f"Calibration rig: camera response {'; '.join(sources)}; lamp spectrum {optics.lamp.source}.",
        _emission_model(results),
    ]
    design = results.press.design
    if design is not None:
        known = ", ".join(f"{name} ({origin})" for name, origin in sorted(design.origin.items()) if origin != "assumed")
        listed.append(
            f"Finger {design.name}: known are {known}; every other number is assumed."
            if known
            else f"Finger {design.name}: every number is assumed."
        )
    if results.press.notes:
        listed.append(f"Simulation: {'; '.join(results.press.notes)}.")
    return tuple(listed)


def _emission_model(results: DemoResults) -> str:
    """Say which curves the paints were taken to have, and how far they may leave them."""
    fits = [results.paints[colour].calibration for colour in COLOURS]
    families = " and ".join(dict.fromkeys(fit.family_title for fit in fits))
    discrepancy = fits[0].discrepancy
    return (
        f"Paint emission: {families}, with a discrepancy of {percent(discrepancy.amplitude_rel)}; from "
        f"{discrepancy.origin}."
    )


_PAINT_NOTES: tuple[tuple[str, Callable[[PaintResult], tuple[str, ...]]], ...] = (
    ("capture", lambda paint: paint.session.notes),
    ("radiometry", lambda paint: paint.bands.notes),
    ("fit", lambda paint: paint.calibration.warnings),
)


def all_notes(results: DemoResults) -> tuple[str, ...]:
    """Return every note and warning of the records once, under the stage that made it."""
    stage_of: dict[str, str] = {}
    for stage, notes_of in _PAINT_NOTES:
        told = {colour: notes_of(results.paints[colour]) for colour in COLOURS}
        for note in (note for notes in told.values() for note in notes):
            whose = [colour for colour in COLOURS if note in told[colour]]
            paints = f"{whose[0]} paint" if len(whose) == 1 else "both paints"
            stage_of.setdefault(note, f"{stage}, {paints}")
    later = {
        "simulate": (*results.press.notes, *results.sweep.notes),
        "compare": (*results.report.withheld, *results.report.notes),
        "decide": results.decision.notes,
    }
    for stage, notes in later.items():
        for note in notes:
            stage_of.setdefault(note, stage)
    return tuple(f"{stage}: {note}" for note, stage in stage_of.items())
