import numpy as np
import pytest

from data_schemas.errors import DecideError
from finray_calib.decide.light_angle import decide_angle
from tests.decide.curves import FINE_DEG, SWEEP_DEG, random_curve, regret_of, sweep

PEAK = 0.5 + np.exp(-0.5 * ((FINE_DEG - 33) / 20) ** 2)


def decide(values, seed=1, angles=SWEEP_DEG, **options):
    return decide_angle(angles, values, "contrast", np.random.default_rng(seed), **options)


def test_a_clear_peak_is_decided_off_the_rendered_angles():
    decision = decide(sweep(PEAK, np.random.default_rng(0), noise=0.003, repeats=5))
    assert decision.verdict == "decided"
    assert decision.best_deg == pytest.approx(33, abs=2)
    assert not decision.at_range_end
    risk = decision.simulation_only
    assert risk.p_within_5deg > 0.99
    assert regret_of(PEAK, decision.best_deg) <= risk.regret_95_rel < 0.005
    (interval,) = risk.equivalent_deg
    truth = FINE_DEG[0.98 * PEAK.max() <= PEAK]
    # Equivalent with 95 % probability: inside the true set, and most of it.
    assert truth[0] - 1 <= interval[0] < 33 < interval[1] <= truth[-1] + 1
    assert interval[1] - interval[0] > 0.6 * np.ptp(truth)


def test_the_band_holds_the_curve_in_its_own_unit():
    rng = np.random.default_rng(2)
    decision = decide(1e4 * sweep(PEAK, rng, noise=0.02, repeats=4))
    covered = (decision.low <= 1e4 * PEAK) & (decision.high >= 1e4 * PEAK)
    assert decision.grid_deg.tolist() == FINE_DEG.tolist()
    assert covered.mean() > 0.8
    assert decision.mean == pytest.approx(1e4 * PEAK, rel=0.1)
    # Noise is 2 % of the maximum; relative to the mean, within the chi-square of 27 degrees of freedom (4 sigma).
    assert decision.noise_rel == pytest.approx(0.02 * PEAK.max() / PEAK[::10].mean(), rel=0.5)


def test_a_common_scale_of_each_repeat_changes_nothing():
    values = sweep(PEAK, np.random.default_rng(3), noise=0.02, repeats=4)
    plain = decide(values)
    scaled = decide(values * np.array([0.5, 1.0, 2.0, 40.0]))
    assert scaled.best_deg == plain.best_deg
    assert scaled.simulation_only.regret_95_rel == pytest.approx(plain.simulation_only.regret_95_rel, rel=1e-6)
    assert scaled.simulation_only.equivalent_deg == plain.simulation_only.equivalent_deg
    assert scaled.noise_rel == pytest.approx(plain.noise_rel, rel=1e-12)
    assert scaled.mean / scaled.mean[0] == pytest.approx(plain.mean / plain.mean[0], rel=1e-9)


def test_shared_draws_matter():
    """3 % advantage of 30 over 10 deg; 5 % common scale and 1 % own noise: seen with shared draws, lost without."""
    rng = np.random.default_rng(4)
    curve = 1 + 0.06 * np.cos(np.radians(6 * (SWEEP_DEG - 30)) / 2)
    scale = 1 + 0.05 * rng.standard_normal(8)
    own = 1 + 0.01 * rng.standard_normal((10, 8))
    shared = curve[:, None] * own * scale
    shuffled = np.array([row * rng.permutation(scale) for row in curve[:, None] * own])
    together, apart = decide(shared), decide(shuffled)
    # 63 degrees of freedom give 1 % to about 9 % of itself.
    assert together.noise_rel == pytest.approx(0.01, rel=0.35)
    assert apart.noise_rel > 0.03
    assert together.simulation_only.p_within_5deg > 0.95
    assert apart.simulation_only.regret_95_rel > 2 * together.simulation_only.regret_95_rel


def test_each_verdict_is_reached():
    rng = np.random.default_rng(5)
    noisy = decide(sweep(PEAK, rng, noise=0.25, repeats=2))
    assert noisy.verdict == "undecided"
    assert "undecided, more renders are needed" in noisy.sentence
    clear = sweep(PEAK, rng, noise=0.003, repeats=5)
    assert decide(clear, discrepancy_rel=0.01).verdict == "decided"
    limited = decide(clear, discrepancy_rel=0.3)
    assert limited.verdict == "model-limited"
    assert "the sim-to-real error exceeds the advantage" in limited.sentence
    flat = decide(sweep(1 + 0.004 * PEAK, rng, noise=0.005, repeats=5))
    assert flat.verdict == "tie"
    assert "any of these angles will do" in flat.sentence


def test_a_sim_to_real_error_widens_the_risk_and_moves_nothing_else():
    values = sweep(PEAK, np.random.default_rng(6), noise=0.01, repeats=4)
    without, zero, large = decide(values), decide(values, discrepancy_rel=0.0), decide(values, discrepancy_rel=0.1)
    assert not without.validated
    assert without.with_discrepancy is None
    assert "not validated against a capture" in without.sentence
    assert zero.validated
    assert zero.with_discrepancy == zero.simulation_only == without.simulation_only
    assert large.best_deg == without.best_deg
    assert large.simulation_only == without.simulation_only
    assert large.with_discrepancy.regret_95_rel > 3 * large.simulation_only.regret_95_rel
    assert large.with_discrepancy.p_within_5deg < large.simulation_only.p_within_5deg
    assert "a sim-to-real error of 10 % is included" in large.sentence


def test_an_optimum_at_the_end_of_the_sweep_is_said():
    rising = decide(sweep(0.5 + FINE_DEG / 60, np.random.default_rng(7), noise=0.005, repeats=3))
    assert rising.at_range_end
    assert rising.best_deg == 90
    assert "may lie outside" in rising.sentence


def test_uneven_angles_and_seeds():
    angles = np.array([5.0, 18.5, 30.0, 44.0, 61.3])
    values = np.interp(angles, FINE_DEG, PEAK)[:, None] * [1.0, 1.01, 0.99]
    decision = decide(values, angles=angles)
    assert decision.grid_deg[[0, -1]].tolist() == [5.0, 61.3]
    assert np.diff(decision.grid_deg).max() <= 1.0
    assert decision.simulation_only == decide(values, angles=angles).simulation_only


def test_claims_are_calibrated_at_8_percent_noise():
    """120 random curves, 3 repeats: the claimed probabilities must be the actual ones, and beat argmax of means.

    The number of hits is a sum of independent events with the claimed probabilities, if the claims are right:
    4 standard deviations are passed by chance in 6 of 100 000 runs. The seed is fixed.
    """
    rng = np.random.default_rng(9)
    hits, claims, regrets, naive_regrets, covered = [], [], [], [], []
    for _ in range(120):
        curve = random_curve(rng)
        values = sweep(curve, rng, noise=0.08, repeats=3, scale=0.05)
        decision = decide_angle(SWEEP_DEG, values, "synthetic", rng, draws=2000)
        risk = decision.simulation_only
        hits.append(abs(FINE_DEG[curve.argmax()] - decision.best_deg) <= 5)
        claims.append(risk.p_within_5deg)
        regrets.append(regret_of(curve, decision.best_deg))
        covered.append(regrets[-1] <= risk.regret_95_rel)
        naive_regrets.append(regret_of(curve, SWEEP_DEG[values.mean(axis=1).argmax()]))
    claimed = np.array(claims)
    spread = np.sqrt((claimed * (1 - claimed)).sum())
    assert abs(sum(hits) - claimed.sum()) < 4 * spread
    # Binomial(120, 0.95): below 104 with probability 4e-4.
    assert sum(covered) >= 104
    assert np.mean(regrets) < 0.5 * np.mean(naive_regrets)


@pytest.mark.parametrize(
    ("angles", "values", "message"),
    [
        ([0, 10, 20], np.ones((3, 2)), r"has 3 angles; at least 4 are needed"),
        ([0, 20, 10, 30], np.ones((4, 2)), r"must increase and occur once each, got \[0.0, 20.0, 10.0, 30.0\] deg"),
        ([0, 10, 10, 30], np.ones((4, 2)), r"must increase and occur once each"),
        ([0, 10, np.nan, 30], np.ones((4, 2)), r"must increase and occur once each"),
        ([0, 10, 20, 30], np.ones((4, 1)), r"shape \(4, 1\) for 4 angles; .* at least 2 repeats"),
        ([0, 10, 20, 30], np.ones((5, 2)), r"shape \(5, 2\) for 4 angles"),
        ([0, 10, 20, 30], np.array([[1, 1], [1, np.nan], [1, 1], [1, 1]]), r"at 10 deg is not a positive number"),
        ([0, 10, 20, 30], np.array([[1, 1], [1, 1], [1, 0.0], [1, 1]]), r"at 20 deg is not a positive number"),
    ],
)
def test_a_sweep_that_allows_no_decision_is_refused(angles, values, message):
    with pytest.raises(DecideError, match=message):
        decide(values, angles=np.array(angles, float))


def test_settings_out_of_range_are_refused():
    values = sweep(PEAK, np.random.default_rng(10), noise=0.01, repeats=2)
    with pytest.raises(DecideError, match=r"tolerance must be a relative loss between 0 and 1, got 2"):
        decide(values, tolerance_rel=2)
    with pytest.raises(DecideError, match=r"sim-to-real error must be relative and between 0 and 1, got -0.1"):
        decide(values, discrepancy_rel=-0.1)
    with pytest.raises(DecideError, match=r"between 0 and 1, got nan"):
        decide(values, discrepancy_rel=float("nan"))
