"""Control charts: run lengths of published tables, false alarms of simulated series in control, detection of a step."""

import numpy as np
import pytest
from scipy import stats

from data_schemas import FinrayError
from finray_calib.acceptance import ChartRules, chart_rules, run_length, watch

NO_SHEWHART = 1e3


@pytest.mark.parametrize(
    ("weight", "limit_sd", "shift_sd", "sessions"),
    [
        (0.10, 2.814, 0.0, 500.0),
        (0.25, 2.998, 0.0, 500.0),
        (0.10, 2.814, 1.0, 10.3),
        (0.25, 2.998, 1.0, 11.1),
        (0.40, 3.054, 0.0, 500.0),
    ],
)
def test_run_lengths_of_lucas_and_saccucci(weight, limit_sd, shift_sd, sessions):
    """Technometrics 32 (1990), table 3 as it is widely quoted (Montgomery, Statistical Quality Control, table 9.11)."""
    rules = ChartRules(0.01, None, NO_SHEWHART, weight, limit_sd)
    assert run_length(rules, shift_sd) == pytest.approx(sessions, rel=0.01)


def test_run_length_of_a_shewhart_chart_is_geometric():
    rules = ChartRules(0.01, None, 3.0, 1.0, 1e3)
    for shift_sd in (0.0, 1.0, 3.0):
        p = stats.norm.sf(3.0 - shift_sd) + stats.norm.cdf(-3.0 - shift_sd)
        assert run_length(rules, shift_sd) == pytest.approx(1 / p, rel=1e-9)


def series(rng, runs, sessions):
    return rng.standard_normal((runs, sessions))


def alarms_at(values, rules):
    """Return which sessions alarm, (runs, sessions), by arrays of our own: the charts of all runs at once."""
    count = rules.reference
    mean, sd = values[:, :count].mean(axis=1), values[:, :count].std(axis=1, ddof=1)
    found, z = np.zeros(values.shape, bool), np.zeros(len(values))
    for i in range(count, values.shape[1]):
        x = (values[:, i] - mean) / sd
        z = rules.smoothing_factor * x + (1 - rules.smoothing_factor) * z
        found[:, i] = (np.abs(x) > rules.shewhart_factor) | (np.abs(z) > rules.ewma_limit_factor)
        z[found[:, i]] = 0.0
    return found


@pytest.mark.parametrize(("reference", "rate"), [(6, 0.01), (10, 0.01), (10, 0.001), (30, 0.01)])
def test_false_alarms_of_series_in_control_are_those_that_were_asked_for(reference, rate):
    """6000 references with 100 sessions each; within four standard errors over the references."""
    found = alarms_at(series(np.random.default_rng(1), 6000, reference + 100), chart_rules(rate, reference))
    shares = found[:, reference:].mean(axis=1)
    error = shares.std() / np.sqrt(shares.size)
    assert shares.mean() == pytest.approx(rate, abs=4 * error)
    assert error < 0.1 * rate


def test_limits_that_ignore_how_short_the_reference_is_alarm_far_too_often():
    """The poisoned case: limits of a known mean and standard deviation on a reference of 10 sessions."""
    known = chart_rules(0.01)
    careless = ChartRules(0.01, 10, known.shewhart_factor, known.smoothing_factor, known.ewma_factor)
    found = alarms_at(series(np.random.default_rng(2), 1000, 110), careless)
    assert found[:, 10:].mean() > 0.03


def test_a_chart_is_that_of_the_arrays():
    values = series(np.random.default_rng(3), 40, 60)
    values[:, 30:] += 2.0
    rules = chart_rules(0.01, 10)
    found = alarms_at(values, rules)
    for row, expected in zip(values, found, strict=True):
        assert {alarm.place for alarm in watch(row, rules).alarms} == set(np.flatnonzero(expected))


def test_a_step_is_seen_and_small_ones_by_the_weighted_mean():
    """Steps at the first session behind a reference of 20: seen within 10 sessions."""
    rng, rules = np.random.default_rng(4), chart_rules(0.01, 20)
    for step_sd, least in ((1.5, 0.75), (3.0, 0.98)):
        values = series(rng, 2000, 30)
        values[:, 20:] += step_sd
        assert alarms_at(values, rules)[:, 20:].any(axis=1).mean() > least
    slow = series(rng, 200, 40)
    slow[:, 20:] += 1.2
    first = [charts[0].chart for row in slow if (charts := watch(row, rules).alarms)]
    assert first.count("EWMA") > first.count("Shewhart")


def test_cleared_alarms_begin_anew():
    values = np.r_[series(np.random.default_rng(5), 1, 10)[0], 50.0, 0.0, 0.0]
    rules = chart_rules(0.01, 10)
    assert [alarm.place for alarm in watch(values, rules).alarms][:1] == [10]
    assert watch(values, rules, cleared=11).alarms == ()


def test_a_session_that_stands_out_of_the_reference():
    good = series(np.random.default_rng(6), 1, 12)[0]
    rules = chart_rules(0.01, 12)
    assert watch(good, rules).outlier is None
    good[3] = 12.0
    assert watch(good, rules).outlier == 3


def test_sessions_stand_out_of_a_good_reference_in_one_percent():
    """Grubbs' test at 1 %: 3000 references of 10; four standard errors are 0.7 %."""
    rules = chart_rules(0.01, 10)
    found = [watch(row, rules).outlier is not None for row in series(np.random.default_rng(7), 3000, 10)]
    assert np.mean(found) == pytest.approx(0.01, abs=0.007)


@pytest.mark.parametrize(
    ("rate", "reference", "weight", "match"),
    [
        (0.5, 10, 0.2, "out of range; give 0.000001"),
        (0.01, 5, 0.2, "give 6 or more"),
        (0.01, 10, 2.0, "give 0.01 to 1"),
    ],
)
def test_rules_that_cannot_be(rate, reference, weight, match):
    with pytest.raises(FinrayError, match=match):
        chart_rules(rate, reference, weight)


def test_series_that_cannot_be_charted():
    rules = chart_rules(0.01, 10)
    for values in (np.ones(9), np.r_[np.arange(10.0), np.nan]):
        with pytest.raises(FinrayError, match="must have at least 10 values, as the reference has, and only finite"):
            watch(values, rules)
    with pytest.raises(FinrayError, match="have exactly the same value"):
        watch(np.ones(12), rules)
