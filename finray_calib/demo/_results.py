"""Everything that a run of the demo produced, as its report reads it, and every number of it as plain JSON types.

A number that is not finite becomes null. Also how far the run can be trusted: what limits it, what was assumed, and
every note of the records.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from data_schemas import (
    AngleStatement,
    BandSignals,
    CaptureSession,
    FingerSurfaces,
    LightAngleDecision,
    LightAngleSweep,
    PaintCalibration,
    PhotometricErrorReport,
    PressMechanics,
    Provenance,
    RecordError,
    SimulatedPress,
    TactileCapture,
)
from finray_calib.reports import (
    FittedPaint,
    Json,
    PaintTruth,
    capture_sentence,
    fit_summary,
    model_statement,
    percent,
    plain,
    true_value,
)

Colour = Literal["red", "green"]
COLOURS: tuple[Colour, Colour] = ("red", "green")
STAGES = ("capture", "radiometry", "fit", "simulate", "compare", "decide")


@dataclass(frozen=True, slots=True)
class PaintResult:
    """One paint from capture to fit.

    Attributes
    ----------
    colour
        "red" or "green".
    room_light_rgb8
        (H, W, 3) preview of the sample under room light, sRGB code values.
    """

    colour: Colour
    session: CaptureSession
    bands: BandSignals
    calibration: PaintCalibration
    truth: PaintTruth
    room_light_rgb8: NDArray[np.uint8]

    @property
    def fitted(self) -> FittedPaint:
        """The paint as the sections on the fit show it."""
        return FittedPaint(self.bands, self.calibration, f"{self.colour} paint", self.truth)


@dataclass(frozen=True, slots=True)
class DemoResults:
    """All six stages of one run.

    Attributes
    ----------
    paints
        The two paints by colour.
    mechanics, surfaces
        The finger as finite elements pressed it; its shape is that of all renders. None where it was not shown.
    stage_wall_times_s
        Wall time of each of the six stages, s.
    renderer_note
        Which renderer made the images and what that means, in words.
    command
        The command that reproduces the run.
    true_sweeps
        The same objective over the angle for the hidden true finger, at each place; empty when it was not rendered.
    report_level_a
        The paper's emitter (light textured by distance, the same at every angle) against the same capture, or
        None when it was not rendered.

    Raises
    ------
    RecordError
        When a paint or a stage is missing or unknown.
    """

    paints: dict[Colour, PaintResult]
    press: SimulatedPress
    capture: TactileCapture
    report: PhotometricErrorReport
    sweep: LightAngleSweep
    decision: LightAngleDecision
    stage_wall_times_s: dict[str, float]
    renderer_note: str
    command: str
    provenance: Provenance
    true_sweeps: tuple[LightAngleSweep, ...] = ()
    mechanics: PressMechanics | None = None
    surfaces: FingerSurfaces | None = None
    report_level_a: PhotometricErrorReport | None = None

    def __post_init__(self) -> None:
        if set(self.paints) != set(COLOURS):
            raise RecordError(f"demo results: paints must be exactly 'red' and 'green', got {sorted(self.paints)}")
        if set(self.stage_wall_times_s) != set(STAGES):
            raise RecordError(
                f"demo results: wall times (s) must be given for each of the stages {', '.join(STAGES)}, got "
                f"{sorted(self.stage_wall_times_s)}"
            )


def summary(results: DemoResults) -> Json:
    """Return every number of the report.

    Parameters
    ----------
    results
        The six stages of one run.

    Returns
    -------
    dict
        Keys `stages` (wall times, s), `paints` (`red`, `green`), `simulation`, `photometric_error`,
        `photometric_error_level_a` (the paper's emitter; null when not rendered), `decision`, `provenance` and
        `command`. Fractions are 0 to 1; other units are the suffix of the key.
    """
    numbers: Json = plain(
        {
            "stages": {stage: results.stage_wall_times_s[stage] for stage in STAGES},
            "paints": {colour: _paint(results.paints[colour]) for colour in COLOURS},
            "simulation": _simulation(results),
            "photometric_error": _photometric_error(results.report),
            "photometric_error_level_a": _photometric_error(results.report_level_a),
            "decision": _decision(results),
            "provenance": results.provenance.model_dump(mode="json"),
            "command": results.command,
        }
    )
    return numbers


def _paint(paint: PaintResult) -> Json:
    """Return what was captured and fitted for one paint, beside the truth."""
    return {
        **fit_summary(paint.fitted),
        "frames": len(paint.session.frames),
        "region_pixels": paint.bands.region_pixels,
    }


def _simulation(results: DemoResults) -> Json:
    """Return how the images and the sweep came about."""
    press, sweep = results.press, results.sweep
    return {
        "label": press.label,
        "method": press.method,
        "light_angle_deg": press.light_angle_deg,
        "height_px": press.contact.shape[0],
        "width_px": press.contact.shape[1],
        "sweep_label": sweep.label,
        "sweep_angles": len(sweep.angles_deg),
        "sweep_repeats": sweep.values.shape[1],
        "renderer_note": results.renderer_note,
    }


def _photometric_error(report: PhotometricErrorReport | None) -> Json | None:
    """Return the whole report but its maps."""
    if report is None:
        return None
    return report.model_dump(mode="json", exclude={"error_map": True, "provenance": True, "attribution": {"maps"}})


def _decision(results: DemoResults) -> Json:
    """Return the decision with and without the sim-to-real error, beside the truth where it is known."""
    decision = results.decision
    true = true_loss(results.true_sweeps, decision.angle_deg) if results.true_sweeps else None
    return {
        "angle_deg": decision.angle_deg,
        **_statement(decision.statement),
        "verdict": decision.verdict,
        "sentence": decision.sentence,
        "objective": decision.objective,
        "tolerance_rel": decision.tolerance_rel,
        "validated": decision.validated,
        "discrepancy_rel": decision.discrepancy_rel,
        "simulation_only": _statement(decision.statement_simulation_only),
        "true_best_angle_deg": None if true is None else true[0],
        "true_regret": None if true is None else true[1],
    }


def true_loss(true_sweeps: Sequence[LightAngleSweep], angle_deg: float) -> tuple[float, float]:
    """Return the best rendered angle of the true finger in deg, and the loss of another angle relative to it.

    Over several places the value of an angle is the mean of the brightness over its own best there. Linear between the
    rendered angles; a loss below the sweeps' own noise is not distinguishable from none.
    """
    curve = true_value(true_sweeps)
    best = int(np.argmax(curve))
    at_angle = float(np.interp(angle_deg, true_sweeps[0].angles_deg, curve))
    return float(true_sweeps[0].angles_deg[best]), 1.0 - at_angle / float(curve[best])


def _statement(statement: AngleStatement) -> Json:
    """Return probability, loss and equivalent angles."""
    return {
        "p_within_5deg": statement.p_within_5deg,
        "p_within_tolerance": statement.p_within_tolerance,
        "expected_regret": statement.expected_regret,
        "regret_95": statement.regret_95,
        "equivalent_deg": [list(interval) for interval in statement.equivalent_deg],
    }


def trust_limits(results: DemoResults) -> tuple[str, ...]:
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
        capture_sentence(results.decision),
        *(f"Withheld: {reason}." for reason in results.report.withheld),
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
            f"Finger {design.name}: {known} are known, and every other number is assumed."
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


def truth_statement(results: DemoResults) -> str | None:
    """Say what the chosen angle costs on the hidden true finger, or None when that was not rendered."""
    if not results.true_sweeps:
        return None
    best_deg, loss = true_loss(results.true_sweeps, results.decision.angle_deg)
    cost = "nothing measurable" if loss < 0.0005 else percent(loss)
    return (
        f"On the true finger, which neither the fit nor the decision saw, the best angle is {best_deg:.0f} deg, and "
        f"the chosen {results.decision.angle_deg:.0f} deg loses {cost} compared with it."
    )
