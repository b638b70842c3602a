import numpy as np
import pytest

from finray_calib.decide._light_angle import AngleRisk, angle_risk, verdict_of

GRID = np.arange(0, 21.0)


def peak_at(angle_deg, slope=0.01):
    return 1 - slope * np.abs(GRID - angle_deg)


def risk(wide_deg=4.0, regret_95=0.0):
    return AngleRisk(0.9, regret_95 / 3, regret_95, ((2.0, 3.0), (8.0, 8.0 + wide_deg)), 0.97)


def test_risk_of_draws_that_can_be_counted():
    """100 curves: 90 peak at the chosen 10 deg, 6 at 5 deg, 4 at 20 deg; each loses 1 % of its maximum per deg."""
    curves = np.array([peak_at(10)] * 90 + [peak_at(5)] * 6 + [peak_at(20)] * 4)
    result = angle_risk(curves, GRID, 10, tolerance_rel=0.0205)
    assert result.p_within_5deg == pytest.approx(0.96)
    assert result.p_within_tolerance == pytest.approx(0.90)
    assert result.expected_regret_rel == pytest.approx(0.06 * 0.05 + 0.04 * 0.10)
    assert result.regret_95_rel == pytest.approx(0.05)
    # Within 2 deg of the peak for 90 of 100 curves only: no angle reaches 95 %.
    assert result.equivalent_deg == ()
    wide = angle_risk(curves, GRID, 10, tolerance_rel=0.0505)
    # 5..10 deg lie within 5 deg of both large groups: 96 %.
    assert wide.equivalent_deg == ((5.0, 10.0),)
    assert wide.p_within_tolerance == pytest.approx(0.96)


def test_two_peaks_give_two_intervals():
    curve = np.maximum(peak_at(4, 0.05), peak_at(16, 0.05))[None, :]
    assert angle_risk(curve, GRID, 4, 0.051).equivalent_deg == ((3.0, 5.0), (15.0, 17.0))


def test_only_allowed_angles_are_optima_and_equivalent():
    curve = np.maximum(peak_at(4, 0.05), 0.95 * peak_at(16, 0.05))[None, :]
    allowed = GRID >= 10
    result = angle_risk(curve, GRID, 16, 0.051, allowed)
    assert result.p_within_5deg == 1.0
    assert result.regret_95_rel == 0.0
    assert result.equivalent_deg == ((15.0, 17.0),)
    assert angle_risk(curve, GRID, 16, 0.051).regret_95_rel == pytest.approx(0.05)


@pytest.mark.parametrize(
    ("simulation", "full", "verdict"),
    [
        (risk(regret_95=0.021), risk(regret_95=0.5), "undecided"),
        (risk(regret_95=0.01), risk(regret_95=0.021), "needs captures"),
        (risk(regret_95=0.01), risk(wide_deg=10.5, regret_95=0.019), "tie"),
        (risk(wide_deg=10.5, regret_95=0.01), risk(wide_deg=10.0, regret_95=0.01), "decided"),
        (risk(regret_95=0.01), risk(regret_95=0.019), "decided"),
        (risk(regret_95=0.02), risk(regret_95=0.02), "decided"),
    ],
)
def test_the_first_rule_that_applies_gives_the_verdict(simulation, full, verdict):
    assert verdict_of(simulation, full, 0.02, validated=True) == verdict


@pytest.mark.parametrize("wide_deg", [4.0, 10.5])
def test_without_captures_nothing_is_decided(wide_deg):
    """A loss that is small because only some angles are open, or because the prior is small, is no measurement."""
    small = risk(wide_deg, regret_95=0.001)
    assert verdict_of(small, small, 0.02, validated=False) == "needs captures"
    assert verdict_of(risk(regret_95=0.021), small, 0.02, validated=False) == "undecided"
