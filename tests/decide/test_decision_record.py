"""From a stored sweep and reports to the stored decision."""

import numpy as np
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from data_schemas import AngleObjective, DecideError, finger_identity
from data_schemas.storage._records import MIGRATIONS
from finray_calib.decide import _decision_record, decide
from finray_calib.decide._decision_record import TOLERANCE_REL
from finray_calib.decide._swept_contacts import swept_contacts
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
    assert decision.verdict == "needs captures"
    assert decision.discrepancy_rel == pytest.approx(0.03, rel=0.02)
    assert decision.discrepancy_95_rel == pytest.approx((0.0042, 0.213), rel=0.08)
    assert decision.captures == ()
    assert decision.statement_simulation_only.p_within_tolerance > 0.99 > 0.8 > decision.statement.p_within_tolerance
    assert decision.statement.regret_95 > 10 * decision.statement_simulation_only.regret_95
    assert decision.mean == pytest.approx(decision.mean_simulation_only, rel=1e-12)
    assert (decision.high95 - decision.low95 > decision.high95_simulation_only - decision.low95_simulation_only).all()
    assert any("Until one does, the simulated curve is assumed to be shifted" in note for note in decision.notes)
    assert "it stays undecided until one does" in decision.sentence
    assert decision.sentence.startswith(decision.headline)
    assert decision.headline.startswith("For one place only (35 mm from the base), for now, mount the light at 3")
    assert decision.angle_deg == pytest.approx(BEST_DEG, abs=2)
    assert decision.angle_simulation_only_deg == pytest.approx(BEST_DEG, abs=2)
    assert "no capture has checked it" in decision.sentence
    assert decision.next_capture is not None
    assert f"Capture next with the light at {decision.next_capture.angle_deg:g} deg" in decision.sentence


def test_threads_do_not_wait_for_each_other_over_small_matrices(monkeypatch):
    asked = []

    def recorded(*_given, **_named):
        asked.extend(pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas")
        raise DecideError("seen")

    monkeypatch.setattr(_decision_record, "decide_contacts", recorded)
    with threadpool_limits(limits=2, user_api="blas"), pytest.raises(DecideError, match="seen"):
        decide(sweep_record(), [], 1)
    assert asked
    assert set(asked) == {1}


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
    assert "A capture at 30 deg is included" in decision.sentence
    assert any("relative to the no-contact image" in note for note in decision.notes)
    assert any("older version without its channels" in note for note in decision.notes)


def test_a_capture_beyond_the_sweep_does_not_validate():
    decision = decide(sweep_record(), [capture(150.0, 0.1)], 1)
    assert not decision.validated
    assert "no capture has checked it" in decision.sentence
    assert any("outside the sweep (0 to 120 deg)" in note for note in decision.notes)


def test_an_optimum_at_the_end_of_the_sweep_is_stored():
    assert not decide(sweep_record(), [], 1).at_range_end
    cut = decide(sweep_record(last_deg=30.0), [], 1)
    assert cut.at_range_end
    assert cut.verdict == "undecided"
    assert "Render" not in cut.sentence


def test_reports_that_mislead_are_refused():
    with pytest.raises(DecideError, match="contains no brightness error"):
        decide(sweep_record(), [report("encoded", 30.0, None)], 1)
    with pytest.raises(DecideError, match="which would count twice"):
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
    assert "Normal error would have chosen " in decision.sentence
    # what its best angle loses of the brightness, by the brightness' own curve
    at = np.abs(decision.grid_deg - disagrees.best_deg).argmin()
    assert disagrees.cost_rel == pytest.approx(1 - decision.mean[at] / decision.mean.max(), abs=0.01)
    assert agrees.cost_rel < 0.01
    assert "Uniformity" not in decision.sentence


def with_normal_errors(tops_deg, places_mm=(10.0, 30.0, 50.0)):
    """A sweep that holds the error of the normal at places, each least at an angle of its own, and brightness."""
    sweep = sweep_record()
    errors = 5.0 / hills(sweep.angles_deg, tops_deg).T[:, None, :]
    noise = 1 + 0.005 * np.random.default_rng(8).standard_normal((sweep.angles_deg.size, 4, len(tops_deg)))
    normal = AngleObjective(
        name="held-out normal error", meaning="m", unit="deg", larger_is_better=False,
        values=(errors * noise).mean(axis=2), place_values=errors * noise, places_mm=np.array(places_mm),
    )  # fmt: skip
    return sweep.model_copy(update={"other_objectives": (normal,)})


@pytest.mark.parametrize("criterion", ["average", "worst"])
def test_the_error_of_the_normal_is_decided_on_where_it_is_there(criterion):
    tops = (60.0, 75.0, 90.0)
    sweep = with_normal_errors(tops)
    decision = decide(sweep, [], 1, criterion=criterion)
    assert decision.aim == "normal"
    fine = np.arange(0.0, 121.0)
    relative = hills(fine, tops)
    value = relative.min(axis=0) if criterion == "worst" else relative.mean(axis=0)
    assert value[int(decision.angle_deg)] > value.max() - 0.01
    assert [c.best_deg for c in decision.contacts] == pytest.approx(tops, abs=4)
    assert [c.position_mm for c in decision.contacts] == [10.0, 30.0, 50.0]
    above = 1 / relative[:, int(decision.angle_deg)] - 1
    assert [1 / (1 - c.loss_rel) - 1 for c in decision.contacts] == pytest.approx(above, abs=0.02)
    assert "at each of the 3 places" in decision.headline
    (brightness,) = decision.other_objectives
    assert brightness.name == "brightness"
    assert brightness.best_deg == pytest.approx(BEST_DEG, abs=3)
    assert brightness.disagrees
    assert brightness.cost_rel == pytest.approx(1 - value[int(brightness.best_deg)] / value.max(), abs=0.02)
    assert "Brightness would have chosen 3" in decision.sentence
    assert decision.verdict == "needs captures"
    assert decision.next_capture is None


def test_captures_and_weights_are_of_the_brightness():
    sweep = with_normal_errors((60.0, 75.0, 90.0))
    reported = decide(sweep, [capture(30.0, 0.1)], 1)
    assert reported.aim == "brightness"
    assert {other.name for other in reported.other_objectives} == {"held-out normal error"}
    assert decide(sweep, [], 1, weights=[2.0]).aim == "brightness"
    assert decide(sweep, [], 1, aim="brightness").angle_deg == pytest.approx(BEST_DEG, abs=3)
    with pytest.raises(
        DecideError, match=r"reports measure the brightness\. Leave them out, or decide on the brightness"
    ):
        decide(sweep, [capture(30.0, 0.1)], 1, aim="normal")
    with pytest.raises(DecideError, match="weights apply to touches, but this error to places"):
        decide(sweep, [], 1, weights=[2.0], aim="normal")
    with pytest.raises(
        DecideError, match="do not contain this error at places along the pad; simulate them with --objectives all"
    ):
        decide(sweep_record(), [], 1, aim="normal")


def at_place(position_mm, best_deg, **changes):
    """The hill of the records with its top elsewhere, beside an indenter at another place."""
    sweep = sweep_record()
    hill = 0.4 + np.exp(-0.5 * ((sweep.angles_deg - best_deg) / 20.0) ** 2)
    noise = 1 + 0.003 * np.random.default_rng(int(position_mm)).standard_normal(sweep.values.shape)
    indenter = sweep.design.indenter.model_copy(update={"position_mm": position_mm})
    design = sweep.design.model_copy(update={"indenter": indenter})
    return sweep.model_copy(update={"values": hill[:, None] * noise, "design": design, **changes})


def hills(angles_deg, tops_deg):
    curves = np.array([0.4 + np.exp(-0.5 * ((angles_deg - top) / 20.0) ** 2) for top in tops_deg])
    return curves / curves.max(axis=1, keepdims=True)


@pytest.mark.parametrize("criterion", ["average", "worst"])
@pytest.mark.parametrize("weights", [None, [1.0, 1.0, 6.0]])
def test_several_places_are_decided_as_brute_force_does(criterion, weights):
    tops = (25.0, 35.0, 60.0)
    sweeps = [at_place(10.0 * (n + 1), top) for n, top in enumerate(tops)]
    decision = decide(sweeps, [], 1, weights=weights, criterion=criterion)
    fine = np.arange(0.0, 121.0)
    relative = hills(fine, tops)
    shares = np.full(3, 1 / 3) if weights is None else np.array(weights) / sum(weights)
    value = relative.min(axis=0) if criterion == "worst" else shares @ relative
    at = int(np.abs(fine - decision.angle_deg).argmin())
    # sweeps of 10 deg with 0.1 % noise of the mean: the value is known to some tenths of a per cent
    assert value[at] > value.max() - 0.005
    assert [c.best_deg for c in decision.contacts] == pytest.approx(tops, abs=3)
    assert [c.loss_rel for c in decision.contacts] == pytest.approx(1 - relative[:, at], abs=0.01)
    assert [c.weight_share for c in decision.contacts] == pytest.approx(shares)
    assert decision.contact_value == pytest.approx(relative, abs=0.03)
    assert decision.mean == pytest.approx(value, abs=0.02)
    low, high = decision.tolerance_deg
    inside = (fine >= low) & (fine <= high)
    assert value[inside].min() > 0.98 * value.max() - 0.005
    assert decision.verdict == "needs captures"
    assert "3 places from 10 to 30 mm" in decision.headline
    assert decision.next_capture is not None


def test_a_report_corrects_the_place_it_is_of():
    """Absolute captures at one of two places show that its hill stands elsewhere; the other place follows in part."""
    sweeps = [at_place(10.0, 35.0), at_place(50.0, 35.0)]
    angles = np.array([10.0, 25.0, 40.0, 55.0, 70.0, 100.0])
    errors = np.log(hills(angles, [35.0])[0] / hills(angles, [60.0])[0])
    identity = finger_identity(sweeps[1].design)
    reports = [capture(a, e, 3.0).model_copy(update={"finger": identity}) for a, e in zip(angles, errors, strict=True)]
    decision = decide(sweeps, reports, 1)
    first, second = decision.contacts
    assert second.best_deg == pytest.approx(60, abs=4)
    assert 35 < first.best_deg < second.best_deg - 3
    assert decision.validated
    elsewhere = finger_identity(at_place(20.0, 35.0).design)
    with pytest.raises(DecideError, match="differs in indenter, and the error of one finger does not apply to another"):
        decide(sweeps, [reports[0].model_copy(update={"finger": elsewhere})], 1)


def test_weights_count_by_their_ratios():
    sweeps = [at_place(10.0, 30.0), at_place(20.0, 40.0)]
    for weights in ([1e308, 1e308], [1e-320, 1e-320]):  # the sum of the first is infinite
        assert [contact.weight_rel for contact in swept_contacts(sweeps, weights)] == [1.0, 1.0]
    with pytest.raises(
        DecideError, match=r"the smallest weight, 1e-09, is less than .* times the greatest, 1; leave out"
    ):
        swept_contacts(sweeps, [1.0, 1e-9])


def test_sweeps_that_do_not_belong_together_are_refused():
    first = at_place(10.0, 35.0)
    other_light = first.design.light.model_copy(update={"width_mm": 15.0})
    other = at_place(20.0, 35.0)
    for second, said in (
        (
            other.model_copy(update={"design": other.design.model_copy(update={"light": other_light})}),
            "differ in light",
        ),
        (other.model_copy(update={"paints": {"red": "0" * 64}}), "different paint calibrations"),
        (other.model_copy(update={"objective": "evenness"}), "different objectives"),
        (other.model_copy(update={"angles_deg": other.angles_deg + 1}), "different angles"),
        (first, r"two sweeps belong to the same touch \(position_mm = 10 mm\)"),
    ):
        with pytest.raises(DecideError, match=said):
            decide([first, second], [], 1)
    for weights in ([1.0], [1.0, -1.0]):
        with pytest.raises(DecideError, match="give one number above 0 for each sweep"):
            decide([first, other], [], 1, weights=weights)


def test_angles_in_radians_are_refused():
    """0 to 120 deg, written in radians: a best angle of 1 deg would be decided on."""
    sweep = sweep_record()
    small = sweep.model_copy(update={"angles_deg": np.radians(sweep.angles_deg)})
    with pytest.raises(
        DecideError, match=r"13 angles of the light from 0 to 2\.0944 deg span less than 4 deg, which suggests radians"
    ):
        decide(small, [], 1)
    assert decide(small, [], 1, narrow_sweep=True).angle_deg < 2.1


def painted_sweep(paint_sd, noise_sd, repeats=6, seed=5):
    """A sweep whose repeats differ by a draw of the paints, which tilts the curve, and by noise of their bands."""
    rng = np.random.default_rng(seed)
    plain = sweep_record()
    angles = plain.angles_deg
    hill = np.array([0.4 + np.exp(-0.5 * ((angles - top) / 25.0) ** 2) for top in (20.0, 40.0, 60.0)]).T
    basis = hill[:, None, None, :] * (1 + noise_sd * rng.standard_normal((angles.size, repeats, 2, 3)))
    yields = 1 + paint_sd * rng.standard_normal((repeats, 3))
    rgb = np.einsum("rb,arpb->arb", yields, basis) / 2
    channels = 3 * rgb / rgb.mean(axis=(0, 1)).sum()
    return plain.model_copy(update={"basis": basis, "channels": channels, "values": channels.mean(axis=2)})


def test_paints_and_paths_are_told_apart():
    """Scatter of paints alone leaves no noise; noise alone leaves no scatter; together each is found as alone."""
    (paint,) = swept_contacts([painted_sweep(0.1, 0.0)], None)
    assert np.ptp(paint.values, axis=1).max() < 1e-12
    spread = paint.scatter.std(axis=0)
    assert spread.max() > 0.01
    (noise,) = swept_contacts([painted_sweep(0.0, 0.02)], None)
    assert np.ptp(noise.scatter, axis=0).max() < 1e-12
    (both,) = swept_contacts([painted_sweep(0.1, 0.02)], None)
    assert both.scatter.std(axis=0) == pytest.approx(spread, abs=0.2 * spread.max())


def test_more_repeats_do_not_average_the_paint_away():
    """The real paint is one draw: 24 repeats leave as much doubt as 6; noise of the paths is averaged."""
    few, many = (decide(painted_sweep(0.15, 0.0, n), [], 1).statement_simulation_only for n in (6, 24))
    assert few.regret_95 > 0.005
    assert many.regret_95 > 0.5 * few.regret_95
    few, many = (decide(painted_sweep(0.0, 0.05, n), [], 1).statement_simulation_only for n in (6, 24))
    assert many.regret_95 < 0.6 * few.regret_95


def test_colours_that_do_not_follow_from_the_bands_keep_their_whole_scatter():
    sweep = painted_sweep(0.1, 0.02)
    broken = sweep.model_copy(update={"channels": sweep.channels * (1 + 0.01 * np.sin(np.arange(3)))[::-1] ** 2 + 0.01})
    (kept,) = swept_contacts([broken], None)
    assert kept.values is broken.values or np.array_equal(kept.values, broken.values)
    relative = broken.values / broken.values.mean(axis=0)
    assert kept.scatter == pytest.approx(np.log(relative).T)


def test_a_record_of_before_reads_with_the_verdict_of_today():
    step = MIGRATIONS["LightAngleDecision", 3]
    assert step({"verdict": "model-limited", "sentence": "s"}) == {"verdict": "needs captures", "sentence": "s"}
    assert step({"verdict": "tie"}) == {"verdict": "tie"}
