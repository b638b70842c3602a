"""From a stored sweep and reports to the stored decision."""

import numpy as np
import pytest

from data_schemas import AngleObjective, DecideError
from finray_calib.decide import decide
from finray_calib.decide._decision_record import TOLERANCE_REL
from tests.command_line.records import BEST_DEG
from tests.command_line.records import sweep as sweep_record
from tests.decide.test_capture_errors import objective_error, report


def capture(angle_deg, log_error, log_exposure=None):
    rng = np.random.default_rng(int(angle_deg))
    error = objective_error(np.full(3, log_error + (log_exposure or 0.0)), log_exposure, sd=0.005, rng=rng)
    return report(f"capture at {angle_deg:g} deg", angle_deg, error, 0.5)


def test_without_a_report_it_carries_the_prior_of_the_error_and_decides_nothing():
    decision = decide(sweep_record(), [], 1)
    assert not decision.validated
    assert decision.verdict == "model-limited"
    assert decision.discrepancy_rel == pytest.approx(0.10, rel=0.02)
    assert decision.discrepancy_95_rel == pytest.approx((0.0245, 0.40), rel=0.05)
    assert decision.captures == ()
    assert decision.statement_simulation_only.p_within_tolerance > 0.99 > 0.8 > decision.statement.p_within_tolerance
    assert decision.statement.regret_95 > 10 * decision.statement_simulation_only.regret_95
    assert decision.mean == pytest.approx(decision.mean_simulation_only, rel=1e-12)
    assert (decision.high95 - decision.low95 > decision.high95_simulation_only - decision.low95_simulation_only).all()
    assert any("until one does, the error is taken to be a random curve" in note for note in decision.notes)
    assert "not decided, only captures can tell how far the finger differs from the simulation" in decision.sentence
    assert decision.angle_deg == decision.angle_simulation_only_deg == pytest.approx(BEST_DEG, abs=2)
    assert "not validated against a capture" in decision.sentence
    assert decision.next_capture is not None
    assert f"next: capture at {decision.next_capture.angle_deg:.0f} deg" in decision.sentence


def test_captures_of_another_curve_correct_this_one():
    """Captures show a real curve whose hill stands at 50 instead of 35 deg; exposures and LED are known."""
    sweep = sweep_record()

    def hill(angles_deg, top_deg):
        return 0.4 + np.exp(-0.5 * ((angles_deg - top_deg) / 20.0) ** 2)

    angles = np.array([10.0, 25.0, 40.0, 55.0, 70.0, 100.0])
    errors = np.log(hill(angles, BEST_DEG) / hill(angles, 50.0))
    reports = [capture(a, e, 3.0) for a, e in zip(angles, errors + 0.7, strict=True)]
    decision = decide(sweep, reports, 1)
    assert decision.validated
    assert decision.angle_deg == pytest.approx(50, abs=3)
    assert decision.angle_simulation_only_deg == pytest.approx(BEST_DEG, abs=2)
    assert decision.statement_simulation_only == decide(sweep, [], 1).statement_simulation_only
    low_rel, high_rel = decision.discrepancy_95_rel
    assert low_rel < decision.discrepancy_rel < high_rel
    assert (decision.high95 - decision.low95 > decision.high95_simulation_only - decision.low95_simulation_only).all()
    # the captured values lie on the corrected curve, apart from a common scale
    expected = np.interp(angles, decision.grid_deg, decision.mean)
    found = np.array([c.value for c in decision.captures])
    assert found == pytest.approx(expected, rel=0.03)
    assert all(0 < c.error_u_rel < 0.05 for c in decision.captures)
    assert [c.error_rel for c in decision.captures] == pytest.approx(
        np.expm1(errors - np.mean(errors - decision_log_ratio(decision, angles))), abs=0.02
    )


def decision_log_ratio(decision, angles_deg):
    """ln(simulated / real) at some angles, as decided."""
    ratio = np.log(decision.mean_simulation_only / decision.mean)
    return np.interp(angles_deg, decision.grid_deg, ratio)


def test_a_report_relative_to_the_no_contact_image_keeps_its_level():
    decision = decide(sweep_record(), [capture(30.0, 0.1)], 1)
    (only,) = decision.captures
    curve = np.interp(30.0, decision.grid_deg, decision.mean)
    assert only.value == pytest.approx(curve, rel=0.02)
    # the table's error is what was compared, whatever the curve takes up of it
    assert only.error_rel == pytest.approx(np.expm1(0.1), rel=0.01)
    assert "a capture at 30 deg included" in decision.sentence
    assert any("relative to the no-contact image" in note for note in decision.notes)
    assert any("older version without its channels" in note for note in decision.notes)


def test_a_capture_beyond_the_sweep_does_not_validate():
    decision = decide(sweep_record(), [capture(150.0, 0.1)], 1)
    assert not decision.validated
    assert "not validated against a capture" in decision.sentence
    assert any("outside the sweep (0 to 120 deg)" in note for note in decision.notes)


def test_an_optimum_at_the_end_of_the_sweep_is_stored():
    assert not decide(sweep_record(), [], 1).at_range_end
    cut = decide(sweep_record(last_deg=30.0), [], 1)
    assert cut.at_range_end
    assert cut.verdict == "undecided"
    assert "next: render" not in cut.sentence


def test_reports_that_mislead_are_refused():
    with pytest.raises(DecideError, match="carries no brightness error"):
        decide(sweep_record(), [report("encoded", 30.0, None)], 1)
    with pytest.raises(DecideError, match="the same capture would count twice"):
        decide(sweep_record(), [capture(30.0, 0.0), capture(30.0, 0.0)], 1)


def test_other_objectives_are_listed_and_disagreement_is_said():
    sweep = sweep_record()
    rng = np.random.default_rng(3)
    late = 0.4 + np.exp(-0.5 * ((sweep.angles_deg - 90) / 20.0) ** 2)
    noise = 1 + 0.005 * rng.standard_normal((sweep.angles_deg.size, 4))
    objectives = (
        AngleObjective(name="uniformity", meaning="m", unit="1", larger_is_better=True, values=sweep.values),
        AngleObjective(
            name="normal error", meaning="m", unit="deg", larger_is_better=False, values=noise / late[:, None]
        ),
    )
    decision = decide(sweep.model_copy(update={"other_objectives": objectives}), [], 1)
    agrees, disagrees = decision.other_objectives
    assert agrees.disagrees is False
    assert disagrees.disagrees is True
    assert disagrees.best_deg == pytest.approx(90, abs=2)
    assert TOLERANCE_REL < disagrees.loss_90_rel[0] < disagrees.loss_rel < disagrees.loss_90_rel[1]
    assert "normal error would choose 9" in decision.sentence
    assert "uniformity" not in decision.sentence
