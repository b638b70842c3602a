"""From a sweep of the light angle and photometric error reports to the stored decision."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from data_schemas.compare import PhotometricErrorReport
from data_schemas.decide import AngleStatement, LightAngleDecision
from data_schemas.errors import DecideError
from data_schemas.simulate import LightAngleSweep
from finray_calib.decide.angle_risk import AngleRisk
from finray_calib.decide.light_angle import AngleDecision, decide_angle

Floats = NDArray[np.float64]
TOLERANCE_REL = 0.02
_BAND_QUANTILE = 1.959964


def decide(sweep: LightAngleSweep, reports: Sequence[PhotometricErrorReport], seed: int) -> LightAngleDecision:
    """Decide on the light angle; the reports' error of the sweep's own objective widens the decision.

    Parameters
    ----------
    sweep
        Objective over angle and repeat.
    reports
        Comparisons with captures; their brightness errors beside the indenter are combined as a root mean
        square (each with its uncertainty). Without any, the decision is not validated against a capture.
    seed
        Seed of the posterior draws.

    Raises
    ------
    DecideError
        The sweep allows no decision, or a report carries no error of the objective.
    """
    discrepancy_rel = _discrepancy_rel(reports)
    decision = decide_angle(
        sweep.angles_deg, sweep.values, sweep.objective, np.random.default_rng(seed), TOLERANCE_REL, discrepancy_rel
    )
    half_width = (decision.high - decision.low) / 2
    widened = np.hypot(half_width, _BAND_QUANTILE * (discrepancy_rel or 0.0) * decision.mean)
    simulation_only = _statement(decision.simulation_only)
    return LightAngleDecision(
        objective=sweep.objective,
        angle_deg=decision.best_deg,
        verdict=decision.verdict,
        sentence=decision.sentence,
        tolerance_rel=TOLERANCE_REL,
        validated=decision.validated,
        discrepancy_rel=discrepancy_rel,
        statement=simulation_only if decision.with_discrepancy is None else _statement(decision.with_discrepancy),
        statement_simulation_only=simulation_only,
        grid_deg=decision.grid_deg,
        mean=decision.mean,
        low95=decision.mean - widened,
        high95=decision.mean + widened,
        low95_simulation_only=decision.low,
        high95_simulation_only=decision.high,
        notes=_notes(sweep, decision),
    )


def _discrepancy_rel(reports: Sequence[PhotometricErrorReport]) -> float | None:
    """Return the relative sim-to-real error of the objective (one standard deviation), or None without reports."""
    if not reports:
        return None
    squares = []
    for report in reports:
        if report.objective_error_rel is None or report.objective_error_sd_rel is None:
            raise DecideError(
                f"the report on {report.captured} carries no brightness error, because its values are "
                f"'{report.values}': give a report on a capture in linear light (raw frames)"
            )
        squares.append(report.objective_error_rel**2 + report.objective_error_sd_rel**2)
    return float(np.sqrt(np.mean(squares)))


def _statement(risk: AngleRisk) -> AngleStatement:
    """Return the record of what is claimed."""
    return AngleStatement(
        p_within_5deg=risk.p_within_5deg,
        expected_regret=risk.expected_regret_rel,
        regret_95=risk.regret_95_rel,
        equivalent_deg=risk.equivalent_deg,
    )


def _notes(sweep: LightAngleSweep, decision: AngleDecision) -> tuple[str, ...]:
    """Say what the decision rests on."""
    light = sweep.design.light
    notes = [
        *sweep.notes,
        f"the panel sits at x, y, z = {', '.join(f'{p:g}' for p in light.position_mm)} mm and the mirror reflects "
        f"{sweep.design.mirror.reflectance:.0%}: the best angle depends on both and on the probe points",
        f"scatter of one value about the curve: {decision.noise_rel:.1%}, of render noise and paint draws together; "
        "both are averaged over the repeats",
    ]
    if decision.validated:
        notes.append(
            "how the sim-to-real error depends on the angle is unknown: it enters as a random curve of that size with "
            "a correlation length of 35 deg; the size of one report's error stands in for its standard deviation, and "
            "is taken in the image beside the indenter, not at the sweep's probe points"
        )
    return tuple(notes)
