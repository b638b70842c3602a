"""Measured against simulated force on closed-form curves: recovery, coverage, budget, refusals."""

import numpy as np
import pytest

from data_schemas import CompareError, PressMechanics, VariedPress
from finray_calib.force import ForceCurve, MeasuredForce, compare_force
from finray_calib.force._force_comparison import error_size
from finray_calib.force._force_curves import log_sensitivity
from finray_calib.reports import force_figure_png, force_lines
from tests.compare.force_curves import (
    INCREMENTS_MM,
    POWERS,
    U_REL,
    force_at,
    measure,
    power_law_press,
)

MEASUREMENTS = 200
# binomial: of 200 intervals that hold with probability 0.95, fewer than 180 do so once in 500 times
FEWEST_COVERED = 180
NOISE_N = 0.03
# displacements that count from 0.5 mm after first touch
LATE_MM = np.array([0.02, 0.5, 1.0, 1.5, 2.0])


def without_uncertain_inputs() -> PressMechanics:
    return power_law_press(powers={})


def changed(press: PressMechanics, **fields: object) -> PressMechanics:
    return press.model_copy(update=fields)


def test_a_power_law_is_met_between_below_and_beyond_the_increments():
    curve = ForceCurve("press", INCREMENTS_MM, force_at(INCREMENTS_MM))
    depth = np.array([-0.3, 0.0, 0.01, 0.3, 0.77, 1.5, 1.99, 2.05])
    np.testing.assert_allclose(curve.at(depth), force_at(depth), rtol=1e-12)
    # a difference over 2e-5 of the reach: second derivatives cancel, rounding leaves 1e-11 / 1e-5
    np.testing.assert_allclose(curve.slope_at(depth[3:7]), 1.5 * force_at(depth[3:7]) / depth[3:7], rtol=1e-5)
    assert curve.interpolation_error(INCREMENTS_MM) == pytest.approx(0.0, abs=1e-12)
    assert 0.0 < curve.interpolation_error(np.array([0.25]))[0] < 0.2 * force_at(np.array([0.25]))[0]


def test_the_sensitivity_of_a_power_is_its_exponent():
    press = power_law_press().sensitivities
    for varied in press.varied:
        effect = log_sensitivity(press, varied, np.array([0.1, 0.8, 2.0]))
        np.testing.assert_allclose(effect, POWERS[varied.field], rtol=1e-9)


def test_a_varied_press_that_ended_early_tells_what_it_reached():
    press = power_law_press().sensitivities
    short = VariedPress(
        field="pad.thickness_mm", change_rel=0.1, depth_mm=INCREMENTS_MM[:2], force_n=force_at(INCREMENTS_MM[:2], 1.1)
    )
    np.testing.assert_allclose(log_sensitivity(press, short, np.array([0.6, 2.0])), 1.0, rtol=1e-9)
    # between two of the unchanged press's increments
    shorter = short.model_copy(
        update={"depth_mm": np.array([0.2, 0.4]), "force_n": force_at(np.array([0.2, 0.4]), 1.1)}
    )
    np.testing.assert_allclose(log_sensitivity(press, shorter, np.array([0.6])), 1.0, rtol=1e-9)


def test_without_error_noise_and_inputs_nothing_is_left(rng):
    depth = np.linspace(0.1, 2.0, 12)
    found = compare_force(without_uncertain_inputs(), MeasuredForce("exact", depth + 0.137, force_at(depth)), rng)
    assert found.first_touch.offset_mm.estimate == pytest.approx(0.137, abs=1e-5)
    rows = {row.candidate: row.rms_rel for row in found.rows}
    # an offset known to 1e-7 of the reach
    assert rows["simulation"].estimate < 1e-5
    assert rows["do nothing"].estimate == pytest.approx(1.0)
    assert any("--sensitivities" in missing for missing in found.not_included)
    assert any("states no uncertainty" in missing for missing in found.not_included)


def test_without_any_uncertainty_intervals_and_verdicts_are_withheld(rng):
    depth = np.linspace(0.1, 2.0, 12)
    bare = MeasuredForce("a tenth stiffer", depth, 1.1 * force_at(depth))
    found = compare_force(without_uncertain_inputs(), bare, rng)
    assert "--sensitivities" in found.withheld
    assert "force_uncertainty_n" in found.withheld
    assert {point.within for point in found.points} == {third.within for third in found.thirds} == {None}
    ends = [*(row.rms_rel for row in found.rows), found.first_touch.offset_mm, *(p.simulated_n for p in found.points)]
    assert all(value.low95 is None and value.high95 is None for value in ends)
    told = force_lines(found)
    assert "off by" not in told
    assert "[" not in told
    assert "withheld: intervals and verdicts" in told
    assert force_figure_png(found).startswith(b"\x89PNG")
    # either of both is enough to judge by
    for press, measured in (
        (power_law_press(), bare),
        (without_uncertain_inputs(), MeasuredForce(bare.name, depth, bare.force_n, np.full(12, 0.01))),
    ):
        judged = compare_force(press, measured, rng)
        assert not judged.withheld
        assert all(third.within is not None for third in judged.thirds)


def test_a_known_scale_error_is_the_relative_rms(rng):
    depth = np.linspace(0.1, 2.0, 12)
    measured = MeasuredForce("a tenth stiffer", depth, 1.1 * force_at(depth))
    found = compare_force(without_uncertain_inputs(), measured, rng, fit_first_touch=False)
    assert found.first_touch is None
    assert found.rows[1].rms_rel.estimate == pytest.approx(0.1 / 1.1, rel=1e-12)
    assert [third.points for third in found.thirds] == [4, 4, 4]
    for point in found.points:
        assert point.error_n == pytest.approx(-0.1 * force_at(np.array([point.depth_mm]))[0], rel=1e-9)
        assert point.u_input_n == 0.0


@pytest.mark.parametrize(
    ("model_error_rel", "fit_first_touch"), [(0.0, True), (0.15, True), (0.0, False), (0.15, False)]
)
def test_the_interval_of_the_models_own_error_covers_it(model_error_rel, fit_first_touch):
    """Inputs drawn anew for every made-up finger, as the design's uncertainty says."""
    press, covered, touches = power_law_press(), 0, 0
    for seed in range(MEASUREMENTS):
        rng = np.random.default_rng(seed)
        u_ln = np.array([np.sqrt(np.log1p(U_REL[field] ** 2)) for field in POWERS])
        factor = float(np.exp(u_ln * rng.standard_normal(len(POWERS)) @ np.array(list(POWERS.values()))))
        offset = float(rng.uniform(-0.05, 0.2)) if fit_first_touch else 0.0
        measured = measure(rng, offset, model_error_rel, NOISE_N, factor, points=20)
        found = compare_force(press, measured, rng, fit_first_touch)
        interval = found.rows[1].rms_rel
        truth = own_error_rel(model_error_rel, factor, fit_first_touch)
        covered += interval.low95 <= truth <= interval.high95
        if fit_first_touch:
            touch = found.first_touch.offset_mm
            touches += touch.low95 <= offset <= touch.high95
    assert covered >= FEWEST_COVERED
    if fit_first_touch and model_error_rel == 0.0:
        assert touches >= FEWEST_COVERED


def own_error_rel(model_error_rel, factor, fitted):
    """The error with true inputs and of a measurement without noise."""
    exact = measure(np.random.default_rng(0), 0.0, model_error_rel, 0.0, factor, points=20)
    error = force_at(exact.displacement_mm, factor) - exact.force_n
    if fitted and model_error_rel > 0.0:
        press = power_law_press()
        stiffer = changed(press, force_n=factor * press.force_n)
        stated = MeasuredForce(exact.name, exact.displacement_mm, exact.force_n, np.full(20, NOISE_N))
        error = np.array([p.error_n for p in compare_force(stiffer, stated, np.random.default_rng(0)).points])
    return float(np.sqrt(np.mean(error**2) / np.mean(exact.force_n**2)))


def test_points_hold_the_force_of_the_true_finger():
    """The 95 % band of the simulated force at the deepest point holds the true finger's force."""
    press, inside = power_law_press(), 0
    for seed in range(MEASUREMENTS):
        rng = np.random.default_rng(seed)
        u_ln = np.array([np.sqrt(np.log1p(U_REL[field] ** 2)) for field in POWERS])
        factor = float(np.exp(u_ln * rng.standard_normal(len(POWERS)) @ np.array(list(POWERS.values()))))
        found = compare_force(press, measure(rng, 0.0, 0.0, NOISE_N, factor, points=6), rng, fit_first_touch=False)
        deepest = found.points[-1]
        true = force_at(np.array([deepest.depth_mm]), factor)[0]
        inside += deepest.simulated_n.low95 <= true <= deepest.simulated_n.high95
    assert inside >= FEWEST_COVERED


def test_the_budget_is_sensitivity_times_uncertainty(rng):
    found = compare_force(power_law_press(), measure(rng, 0.0, 0.0, NOISE_N), rng)
    lines = {line.input: line for line in found.budget}
    for field, power in POWERS.items():
        assert lines[field].force_u_rel == pytest.approx(abs(power) * U_REL[field], rel=1e-6)
        assert lines[field].source == "stated by the design"
    assert [line.force_u_rel for line in found.budget] == sorted((li.force_u_rel for li in found.budget), reverse=True)
    # u_input of the deepest point without a fit: the root of the sum of squares, as draws (2000: 4.7 % at three sigma)
    known = compare_force(power_law_press(), measure(rng, 0.0, 0.0, NOISE_N), rng, fit_first_touch=False)
    deepest = known.points[-1]
    together = np.sqrt(sum((POWERS[f] * U_REL[f]) ** 2 for f in POWERS)) * deepest.simulated_n.estimate
    assert deepest.u_input_n == pytest.approx(together, rel=0.05)
    assert deepest.u_data_n == pytest.approx(NOISE_N, rel=0.05)


def test_what_the_design_does_not_state_is_assumed_and_said(rng):
    found = compare_force(power_law_press(u_rel={}), measure(rng, 0.0, 0.0, NOISE_N), rng)
    source = {line.input: line.source for line in found.budget}
    u_rel = {line.input: line.u_rel for line in found.budget}
    assert source["mechanics.gel.c10_mpa"] == "assumed: 20 % of a modulus"
    assert source["pad.thickness_mm"] == "assumed: printed to +-0.1 mm"
    # a rectangle of +-0.1 mm on the default pad of 6 mm
    assert u_rel["pad.thickness_mm"] == pytest.approx(0.1 / np.sqrt(3.0) / 6.0)


def test_inputs_without_a_press_are_named(rng):
    press = power_law_press(u_rel={**U_REL, "indenter.radius_mm": 0.01})
    gel, *others = press.sensitivities.varied
    failed = gel.model_copy(update={"depth_mm": np.empty(0), "force_n": np.empty(0), "failure": "parts overlap"})
    again = press.sensitivities.model_copy(update={"varied": (failed, *others)})
    found = compare_force(changed(press, sensitivities=again), measure(rng, 0.0, 0.0, NOISE_N), rng)
    assert "mechanics.gel.c10_mpa: its press failed (parts overlap)" in found.not_included
    assert any(
        missing.startswith("indenter.radius_mm: the design states its uncertainty") for missing in found.not_included
    )


def test_another_mesh_adds_its_difference(rng):
    press = power_law_press()
    finer = changed(press, preset="medium", force_n=0.98 * press.force_n)
    alone = compare_force(press, measure(rng, 0.0, 0.0, NOISE_N), rng, fit_first_touch=False)
    both = compare_force(press, measure(rng, 0.0, 0.0, NOISE_N), rng, False, finer)
    assert alone.points[-1].u_numerical_n < 0.002 * alone.points[-1].simulated_n.estimate
    # 2000 draws: 4.7 % at three sigma
    assert both.points[-1].u_numerical_n == pytest.approx(0.02 * both.points[-1].simulated_n.estimate, rel=0.05)
    assert any("the mesh" in missing for missing in alone.not_included)
    assert not any("the mesh" in missing for missing in both.not_included)


def test_the_known_excess_of_a_mesh_is_its_uncertainty(rng):
    press = changed(power_law_press(), mesh_excess_rel=0.08)
    alone = compare_force(press, measure(rng, 0.0, 0.0, NOISE_N), rng, fit_first_touch=False)
    # 2000 draws: 4.7 % at three sigma
    known = 0.08 / 1.08 * alone.points[-1].simulated_n.estimate
    assert alone.points[-1].u_numerical_n == pytest.approx(known, rel=0.05)
    # another mesh counts where it is further off than that
    for force_rel, expected in ((0.97, known), (0.85, 0.15 / 0.08 * 1.08 * known)):
        other = changed(press, preset="medium", mesh_excess_rel=0.03, force_n=force_rel * press.force_n)
        both = compare_force(press, measure(rng, 0.0, 0.0, NOISE_N), rng, False, other)
        assert both.points[-1].u_numerical_n == pytest.approx(expected, rel=0.05)
    assert not any("the mesh" in missing for missing in alone.not_included)
    numerics = next(line for line in alone.budget if line.input == "numerics")
    assert numerics.source.endswith("excess force of the mesh, as found on the 70 x 35 finger")


def test_the_uncertainty_of_the_displacement_goes_through_the_slope(rng):
    depth = np.linspace(0.2, 1.9, 8)
    measured = MeasuredForce("bench", depth, force_at(depth), None, np.full(8, 0.02))
    found = compare_force(without_uncertain_inputs(), measured, rng, fit_first_touch=False)
    slope = 1.5 * force_at(depth) / depth
    # 2000 draws: 4.7 % at three sigma
    np.testing.assert_allclose([p.u_data_n for p in found.points], 0.02 * slope, rtol=0.06)


def test_an_error_within_its_deviations_may_be_none():
    rng = np.random.default_rng(1)
    shared = np.outer(rng.standard_normal(4000), np.ones(10))
    size = error_size(np.full(10, 1.5), shared, np.zeros((4000, 10)))
    # 0 up to the draw that is nearest, of 4000; 1.5 + 1.96 up to the uncertainty of a quantile
    assert size.low95 < 0.01
    assert size.high95 == pytest.approx(1.5 + 1.96, abs=0.1)
    far = error_size(np.full(10, 20.0), shared, np.zeros((4000, 10)))
    assert (far.low95, far.high95) == (pytest.approx(20.0 - 1.96, abs=0.1), pytest.approx(20.0 + 1.96, abs=0.1))


def test_a_true_finger_within_the_interval_of_the_points_leaves_no_error():
    """Inputs are log-normal: a finger may well be 2.3 times as stiff as its design, and is never so much softer."""
    press = power_law_press({"mechanics.gel.c10_mpa": 1.0}, {"mechanics.gel.c10_mpa": 0.6})
    depth, rows = np.linspace(0.4, 1.9, 8), {}
    for factor in (2.3, 0.4):
        measured = MeasuredForce("bench", depth, force_at(depth, factor))
        found = compare_force(press, measured, np.random.default_rng(1), fit_first_touch=False)
        assert all(p.simulated_n.low95 < p.force_n < p.simulated_n.high95 for p in found.points)
        rows[factor] = next(row.rms_rel for row in found.rows if row.candidate == "simulation")
    # 0 up to the nearest of 2000 draws
    assert rows[2.3].low95 < 0.02
    assert rows[0.4].low95 < 0.02


def test_noise_is_taken_out_of_a_size():
    rng = np.random.default_rng(2)
    noise = rng.standard_normal((4000, 2000))
    seen = 3.0 + rng.standard_normal(2000)
    size = error_size(seen, np.zeros((4000, 2000)), noise)
    assert np.sqrt(np.mean(seen**2)) > 3.1
    # u / sqrt(n) is 0.022: four of them, and an interval of 1.96 of them to both sides
    assert size.estimate == pytest.approx(3.0, abs=0.09)
    assert size.high95 - size.low95 == pytest.approx(2.0 * 1.96 / np.sqrt(2000), rel=0.1)


@pytest.mark.parametrize(
    ("displacement_mm", "force_n", "fit", "message"),
    [
        ([0.5, 1.0, 1.5], [1.0, 2.0, 3.0], True, "has only 3 points, but a comparison needs 5 or more"),
        ([1, 2, 3, 4, 5], [-1, -2, -3, -4, -5], True, "pushing must count as positive; change the sign"),
        (
            [100, 500, 1000, 1500, 1900],
            [0.1, 1, 2, 3, 4],
            True,
            "largest displacement is 1.9e.03 mm, .* the unit may be wrong",
        ),
        (
            [0.1, 0.5, 1.0, 1.5, 1.9],
            [100, 500, 1600, 2900, 4200],
            True,
            "largest force is 4.2e.03 N, .* the unit may be wrong",
        ),
        ([0.1, 0.5, 1.0, 1.5, 2.5], [0.1, 1, 2, 3, 4], False, r"reaches 2\.5 mm or more .* reaches only 2\.1 mm"),
        (LATE_MM, force_at(LATE_MM + 0.5), True, "reaches 2.1 mm or more from first touch"),
        ([0.0, 4.8, 4.9, 4.95, 5.0], [0.0, 10, 11, 11.5, 12], True, r"reaches only 2\.1 mm"),
        ([-5.0, -4.0, -3.0, -2.0, -1.0], [0.1, 1, 2, 3, 4], False, "no point lies beyond first touch at 0 mm"),
    ],
)
def test_measurements_that_cannot_be_compared(displacement_mm, force_n, fit, message, rng):
    with pytest.raises(CompareError, match=message):
        compare_force(
            power_law_press(), MeasuredForce("bench.csv", np.array(displacement_mm), np.array(force_n)), rng, fit
        )


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"preset": "coarse"}, "is also on the coarse mesh"),
        (
            {"preset": "medium", "design": power_law_press().design.model_copy(update={"name": "x"})},
            "of another design",
        ),
    ],
)
def test_another_mesh_must_be_of_the_same_finger(fields, message, rng):
    press = power_law_press()
    with pytest.raises(CompareError, match=message):
        compare_force(press, measure(rng, 0.0, 0.0, NOISE_N), rng, True, changed(press, **fields))


def test_a_force_in_its_noise_is_refused(rng):
    depth = np.linspace(0.1, 1.9, 8)
    measured = MeasuredForce("bench.csv", depth, force_at(depth), np.full(8, 5.0))
    with pytest.raises(CompareError, match="is not larger than its uncertainty"):
        compare_force(power_law_press(), measured, rng, fit_first_touch=False)


def test_curves_that_are_none():
    with pytest.raises(CompareError, match=r"1 increment\(s\), too few for a curve; simulate with --increments 4"):
        ForceCurve("press", np.array([1.0]), np.array([1.0]))
    with pytest.raises(CompareError, match="depths must be above 0 mm and increase, and all forces must be above 0 N"):
        ForceCurve("press", np.array([1.0, 2.0]), np.array([1.0, -1.0]))


def test_negative_uncertainty():
    ones = np.ones(5)
    with pytest.raises(CompareError, match="an uncertainty of the force is negative"):
        MeasuredForce("bench.csv", ones, ones, -ones)


@pytest.fixture
def rng():
    return np.random.default_rng(7)
