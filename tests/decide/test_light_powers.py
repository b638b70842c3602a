"""Powers of lights: against other solvers and the conditions of an optimum, and intervals at their rate."""

from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import minimize, nnls

from data_schemas import DecideError, LightPowers
from data_schemas.storage import read_record
from finray_calib.decide import LightBasis, PowerLimits, error_change, even_powers, most_uniform_powers
from finray_calib.decide._light_powers import powers_sentence

LOW, HIGH, TOTAL = 0.25, 4.0, 1.0


def limits_of(count, low=LOW, high=HIGH, total=TOTAL):
    return PowerLimits(np.full(count, low), np.full(count, high), np.full(count, 1.0 / count), total)


def problem(count, seed, places=30):
    """Spread and level of lights that each reach some places well."""
    brightness = np.random.default_rng(seed).gamma(1.5, 1.0, (count, places)) / count
    return np.cov(brightness, bias=True).reshape(count, count), brightness.mean(axis=1)


def relative_variance(powers, spread, level):
    return float(powers @ spread @ powers / (level @ powers) ** 2)


@pytest.mark.parametrize(("count", "seed"), [(2, 0), (3, 1), (3, 2), (6, 3), (12, 4), (24, 5)])
def test_powers_are_those_of_another_solver_and_meet_the_conditions_of_an_optimum(count, seed):
    spread, level = problem(count, seed)
    found = most_uniform_powers(spread, level, limits_of(count))
    powers = found.powers
    assert relative_variance(powers, spread, level) == pytest.approx(found.variance_rel, rel=1e-9)
    assert found.gap_rel <= 1e-8 * found.variance_rel
    starts = np.random.default_rng(seed).uniform(0.3, 1.0, (3, count))
    others = [
        minimize(
            relative_variance, start, (spread, level), method="SLSQP", bounds=[(LOW, HIGH)] * count,
            constraints={"type": "ineq", "fun": lambda p: TOTAL - p.mean()},
            options={"ftol": 1e-13, "maxiter": 500},
        ).fun
        for start in starts
    ]  # fmt: skip
    # SLSQP stops at its own tolerance, from above
    assert found.variance_rel <= min(others) * (1.0 + 1e-7)
    assert found.variance_rel == pytest.approx(min(others), rel=1e-5)
    # Karush, Kuhn and Tucker: the gradient is a sum of normals of the limits that are reached, none negative
    slope = level @ powers
    gradient = 2.0 * (spread @ powers / slope**2 - found.variance_rel * level / slope)
    active = [np.eye(count)[k] for k in range(count) if powers[k] < LOW * (1.0 + 1e-7)]
    active += [-np.eye(count)[k] for k in range(count) if powers[k] > HIGH * (1.0 - 1e-7)]
    active += [-np.full(count, 1.0 / count)] if powers.mean() > TOTAL * (1.0 - 1e-7) else []
    _, residual = nnls(np.array(active).T, gradient)
    assert residual < 1e-6 * np.linalg.norm(spread @ powers) / slope**2
    assert (powers >= LOW * (1.0 - 1e-9)).all()
    assert (powers <= HIGH * (1.0 + 1e-9)).all()


def test_the_brightest_of_equally_even_powers_are_taken():
    # mirrored lights: equal powers are the most even, and the total or the upper limit says how large they are
    left = np.linspace(2.0, 0.5, 20)
    brightness = np.stack([left, left[::-1]])
    spread, level = np.cov(brightness, bias=True), brightness.mean(axis=1)
    assert most_uniform_powers(spread, level, limits_of(2)).powers == pytest.approx([1.0, 1.0], abs=1e-6)
    assert most_uniform_powers(spread, level, limits_of(2, total=0.5)).powers == pytest.approx([0.5, 0.5], abs=1e-6)
    assert most_uniform_powers(spread, level, limits_of(2, high=0.8)).powers == pytest.approx([0.8, 0.8], abs=1e-6)


def test_a_perfectly_even_coat_is_found():
    found = most_uniform_powers(np.zeros((3, 3)), np.ones(3), limits_of(3))
    assert found.variance_rel == 0.0
    rising = np.linspace(0.0, 2.0, 9)
    brightness = np.stack([rising, 2.0 - rising, np.ones(9)])
    found = most_uniform_powers(np.cov(brightness, bias=True), brightness.mean(axis=1), limits_of(3))
    assert found.variance_rel < 1e-10


def test_limits_that_no_powers_meet_are_refused():
    with pytest.raises(DecideError, match="two factors of 0 or more, the lower one first"):
        limits_of(2, low=2.0, high=1.0)
    with pytest.raises(DecideError, match="but the total allows only"):
        limits_of(2, low=0.9, total=0.5)


def world(seed, noise=0.03, batches=8):
    """A true basis of three lights at rest and touched, and noisy batches of it."""
    rng = np.random.default_rng(seed)
    along = np.linspace(0.0, 1.0, 24)
    true = np.stack([np.exp(-2.0 * along), np.exp(-2.0 * (1.0 - along)), np.exp(-8.0 * (along - 0.5) ** 2)])
    true = np.stack([true, 0.8 * true**1.2], axis=1)[..., None]  # (light, state, place, channel)
    seen = true * (1.0 + noise * rng.standard_normal((batches, *true.shape)))
    return true, seen


def basis_of(seen):
    return LightBasis.balanced(seen[:, :, 0], seen[:, :, 1])


def test_intervals_of_powers_and_gain_hold_at_their_rate():
    limits, worlds = limits_of(3), 60
    true, _ = world(0)
    truth = basis_of(np.repeat(true[None], 3, axis=0))
    best = most_uniform_powers(truth.spread(truth.mean), truth.level(truth.mean), limits).powers

    def variation(powers):
        return np.sqrt(relative_variance(powers, truth.spread(truth.mean), truth.level(truth.mean)))

    held = np.zeros((worlds, 5))
    for seed in range(worlds):
        found = even_powers(basis_of(world(seed)[1]), limits, seed, draws=59)
        gain = 1.0 - variation(found.powers) / variation(np.ones(3))
        told = [*found.power_draws.T, found.gain_rel_draws, found.variation_now_draws]
        for k, (value, draws) in enumerate(zip([*best, gain, variation(np.ones(3))], told, strict=True)):
            low, high = np.quantile(draws, [0.025, 0.975])
            held[seed, k] = low <= value <= high
    # 60 of 0.95: 0.85 is 3.5 standard errors below; that all five always hold by chance has a probability below 0.05
    assert held.mean(axis=0).min() >= 0.85
    assert held.mean() < 1.0


def test_noise_does_not_count_as_unevenness():
    true, seen = world(1, noise=0.3)
    truth = basis_of(np.repeat(true[None], 3, axis=0))
    now = np.sqrt(relative_variance(np.ones(3), truth.spread(truth.mean), truth.level(truth.mean)))
    estimates = [
        even_powers(basis_of(world(seed, 0.3)[1]), limits_of(3), seed, 2).variation_now_rel for seed in range(40)
    ]
    error = np.std(estimates, ddof=1) / np.sqrt(40)
    # of squares: the root of an unbiased square is low by half of its relative variance
    assert np.mean(np.square(estimates)) == pytest.approx(now**2, abs=4.0 * 2.0 * now * error)
    mean = basis_of(seen).mean
    raw = np.sqrt(relative_variance(np.ones(3), truth.spread(mean), truth.level(mean)))
    assert raw > np.mean(estimates)


def test_a_dark_or_too_short_basis_is_refused():
    with pytest.raises(DecideError, match="at least 3 independent batches"):
        LightBasis.balanced(np.ones((2, 1, 4, 3)), np.ones((2, 1, 4, 3)))
    with pytest.raises(DecideError, match="no channel of the camera sees the coat"):
        LightBasis.balanced(np.zeros((3, 1, 4, 3)), np.ones((3, 1, 4, 3)))


def test_a_change_of_the_error_is_that_of_paired_draws():
    rng = np.random.default_rng(3)
    now = 8.0 * np.exp(0.1 * rng.standard_normal(24))
    change = error_change(now, 0.9 * now)
    assert change.change_rel == pytest.approx(-0.1)
    assert change.low95_rel == pytest.approx(change.high95_rel)
    with pytest.raises(DecideError, match="at least 3 draws"):
        error_change(now[:2], now[:2])


@pytest.mark.parametrize(
    ("low95", "begins"), [(-0.01, "No gain is certain, so the powers may stay as they are."), (0.01, "Set ")]
)
def test_a_gain_that_is_not_certain_is_no_advice_to_change_powers(low95, begins):
    file = Path(__file__).resolve().parents[1] / "schemas/frozen/LightPowers/v1/example.json"
    record = read_record(file, LightPowers)
    rows = record.rows if len(record.rows) > 1 else record.rows * 2
    gain = record.gain_rel.model_copy(update={"low95": low95, "high95": 0.3})
    assert powers_sentence(record.model_copy(update={"rows": rows, "gain_rel": gain})).startswith(begins)


def test_where_nothing_is_gained_the_present_powers_are_kept():
    file = Path(__file__).resolve().parents[1] / "schemas/frozen/LightPowers/v1/example.json"
    record = read_record(file, LightPowers)
    # lights that light alike: one of them at full power is as even as both
    rows = tuple(
        record.rows[0].model_copy(update={"light": f"LED {k}", "now_rel": 1.0, "power_rel": power, "least_rel": 0.0,
                                          "most_rel": 1.0})
        for k, power in enumerate((1.0, 0.0))
    )  # fmt: skip
    gain = record.gain_rel.model_copy(update={"low95": 0.0, "high95": 0.0})
    alike = record.model_copy(update={"rows": rows, "gain_rel": gain, "total_rel": 1.0})
    assert powers_sentence(alike).startswith("No powers within the limits light the pad more evenly: keep the present ")
    assert "at 0" not in powers_sentence(alike)
    # less light than now is asked for, so that the present powers cannot be kept
    less = powers_sentence(alike.model_copy(update={"total_rel": 0.5}))
    assert "than the present powers, which are outside the limits. The most even powers within them are LED 0 " in less
