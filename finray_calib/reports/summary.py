"""Every number of the report as plain JSON types; a number that is not finite becomes null."""

import numpy as np

from data_schemas.compare import PhotometricErrorReport
from data_schemas.decide import AngleStatement
from data_schemas.simulate import LightAngleSweep
from finray_calib.reports.demo_results import COLOURS, STAGES, DemoResults, PaintResult
from finray_calib.reports.fit_summary import fit_summary
from finray_calib.reports.plain_json import Json, plain


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
    """Return the whole report but its map."""
    return None if report is None else report.model_dump(mode="json", exclude={"error_map", "provenance"})


def _decision(results: DemoResults) -> Json:
    """Return the decision with and without the sim-to-real error, beside the truth where it is known."""
    decision = results.decision
    true = None if results.true_sweep is None else true_loss(results.true_sweep, decision.angle_deg)
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


def true_loss(true_sweep: LightAngleSweep, angle_deg: float) -> tuple[float, float]:
    """Return the best rendered angle of the true finger in deg, and the loss of another angle relative to it.

    Linear between the rendered angles; a loss below the sweep's own noise is not distinguishable from none.
    """
    curve = (true_sweep.values / true_sweep.values.mean(axis=0)).mean(axis=1)
    best = int(np.argmax(curve))
    at_angle = float(np.interp(angle_deg, true_sweep.angles_deg, curve))
    return float(true_sweep.angles_deg[best]), 1.0 - at_angle / float(curve[best])


def _statement(statement: AngleStatement) -> Json:
    """Return probability, loss and equivalent angles."""
    return {
        "p_within_5deg": statement.p_within_5deg,
        "p_within_tolerance": statement.p_within_tolerance,
        "expected_regret": statement.expected_regret,
        "regret_95": statement.regret_95,
        "equivalent_deg": [list(interval) for interval in statement.equivalent_deg],
    }
