"""Conformance probabilities and risks: published examples, closed forms, another program's numbers, simulation."""

import numpy as np
import pytest
from scipy import stats

from data_schemas import FinrayError
from finray_calib.acceptance import ToleranceInterval, conformance_probability, global_risks
from finray_calib.acceptance._conformity import (
    ISO_14253_1_FACTOR,
    guard_band,
    measured,
    verdict_of,
    zone,
)

RESISTORS = ToleranceInterval(1499.8, 1500.2)
TAIL_SDS = 9.0  # beyond it a normal distribution has less than 1e-18


def global_risks_normal(mean, process_sd, sd, tolerance, guard=0.0):
    """Return the global risks of items that are normally distributed."""
    reach = TAIL_SDS * process_sd
    return global_risks(stats.norm(mean, process_sd).pdf, (mean - reach, mean + reach), sd, tolerance, guard)


def test_conformance_of_a_zener_diode():
    """JCGM 106:2012, example of 7.4: breakdown voltage -5.47 V, u = 0.05 V, at most -5.40 V: 0.92."""
    assert conformance_probability(-5.47, 0.05, ToleranceInterval(None, -5.40)) == pytest.approx(0.919, abs=5e-4)


def test_specific_risk_of_the_suncal_manual():
    """Suncal 1.7 API manual, chapter 6: 9.8 with u = 0.1 in 9 to 10 fails with 0.022750131948180274."""
    risk = 1 - conformance_probability(9.8, 0.1, ToleranceInterval(9, 10))
    assert risk == pytest.approx(0.022750131948180274, rel=1e-12)


def test_ball_bearings():
    """JCGM 106:2012, 9.5.4, to the digits that Suncal prints: gamma(4, 1/4) um, at most 2 um, u = 0.25 um.

    4.2 % of the bearings do not conform, 0.8 % are accepted all the same; an acceptance limit of 1.67 um brings that to
    0.1 %.
    """
    items, limit = stats.gamma(4, scale=0.25), ToleranceInterval(0.0, 2.0)
    plain = global_risks(items.pdf, (0.0, 12.0), 0.25, limit)
    assert 1 - plain.conforming_share == pytest.approx(0.04238011199168401, rel=1e-9)
    # without a lower acceptance limit: a measured value below 0 is no reason to reject a bearing
    upper = ToleranceInterval(None, 2.0)
    accepted = global_risks(items.pdf, (0.0, 12.0), 0.25, upper).consumer_share
    assert accepted == pytest.approx(0.008019111884303471, rel=1e-9)
    guarded = global_risks(items.pdf, (0.0, 12.0), 0.25, upper, guard=2 - 1.6718287715440068)
    assert guarded.consumer_share == pytest.approx(0.001, rel=1e-8)


@pytest.mark.parametrize(
    ("guard", "consumer", "producer"),
    [(0.0, 0.01894220671702191, 0.037207800178056825), (0.09206604548578412, 0.005, None)],
)
def test_global_risks_of_the_suncal_manual(guard, consumer, producer):
    """Chapter 6: items 9.5 +- 0.3 in 9 to 10, u = 0.1, without and with a guard band for 0.5 %."""
    found = global_risks_normal(9.5, 0.3, 0.1, ToleranceInterval(9, 10), guard)
    # Suncal solves for the guard band to 1e-9.
    assert found.consumer_share == pytest.approx(consumer, rel=1e-8)
    assert producer is None or found.producer_share == pytest.approx(producer, rel=1e-9)


@pytest.mark.parametrize(
    ("ratio", "guard_share", "consumer", "producer"), [(4, 1.0, 0.008, 0.015), (2, 0.91, 0.008, 0.066)]
)
def test_risks_of_deaver(ratio, guard_share, consumer, producer):
    """D. Deaver, How to maintain your confidence (NCSL 1993), pages 7 and 10: limits of 2 sd, as printed."""
    found = global_risks_normal(0, 1, 1 / ratio, ToleranceInterval(-2, 2), 2 - 2 * guard_share)
    assert found.consumer_share == pytest.approx(consumer, abs=5e-4)
    assert found.producer_share == pytest.approx(producer, abs=5e-4)


@pytest.mark.parametrize("guard", [-0.05, 0.0, 0.02, 0.08])
def test_risks_agree_with_a_plain_double_sum(guard):
    """1500 ohm +- 0.2, items 0.12, u = 0.04 (JCGM 106:2012, the precision resistors): midpoint sums of 1 mohm."""
    step = 1e-3
    true = np.arange(1499.0 + step / 2, 1501.0, step)
    seen = np.arange(1498.7 + step / 2, 1501.3, step)
    weight = stats.norm.pdf(true, 1500, 0.12) * step
    accepted = (seen >= 1499.8 + guard) & (seen <= 1500.2 - guard)
    chance = (stats.norm.pdf(seen[None, accepted], true[:, None], 0.04) * step).sum(axis=1)
    good = (true >= 1499.8) & (true <= 1500.2)
    found = global_risks_normal(1500, 0.12, 0.04, RESISTORS, guard)
    # the midpoint rule errs by step^2 f'' / 24 f: z^2 step^2 / 24 u^2 where z = 4 sds out matter, 4e-4
    assert found.consumer_share == pytest.approx((weight * chance)[~good].sum(), rel=1e-3)
    assert found.producer_share == pytest.approx((weight * (1 - chance))[good].sum(), rel=1e-3)
    assert found.conforming_share == pytest.approx(stats.norm.cdf(0.2 / 0.12) * 2 - 1, rel=1e-9)


def test_a_wider_guard_band_moves_risk_from_the_consumer_to_the_producer():
    found = [global_risks_normal(1500, 0.12, 0.04, RESISTORS, guard) for guard in (0.0, 0.04, 0.08)]
    rounded = [(round(100 * f.consumer_share, 2), round(100 * f.producer_share, 1)) for f in found]
    assert rounded == [(1.89, 3.7), (0.43, 11.5), (0.05, 24.8)]


def test_guard_bands_that_overlap_accept_nothing():
    found = global_risks_normal(0.5, 0.2, 0.1, ToleranceInterval(0, 1), 0.6)
    assert found.consumer_share == 0.0
    assert found.producer_share == pytest.approx(found.conforming_share)


def test_a_measurement_without_error_has_no_risks_and_a_useless_one_has_its_closed_form():
    sharp = global_risks_normal(1500, 0.12, 1e-6, RESISTORS)
    assert max(sharp.consumer_share, sharp.producer_share) < 1e-5
    # scattered far beyond the limits, a value is accepted with the same small chance whatever the item
    blunt = global_risks_normal(1500, 0.12, 100.0, RESISTORS)
    chance = 2 * stats.norm.cdf(0.2 / 100) - 1
    assert blunt.producer_share == pytest.approx(blunt.conforming_share * (1 - chance), rel=1e-6)
    assert blunt.consumer_share == pytest.approx((1 - blunt.conforming_share) * chance, rel=1e-4)


def test_two_sided_probability_does_not_cancel_in_the_tails():
    """Far above both limits: the difference of two numbers near 1 would be 0."""
    found = conformance_probability(20.0, 1.0, ToleranceInterval(0.0, 10.0))
    assert found == pytest.approx(stats.norm.sf(10.0), rel=1e-9)
    assert conformance_probability(-10.0, 1.0, ToleranceInterval(0.0, 10.0)) == pytest.approx(found, rel=1e-9)


def test_an_exact_value_conforms_or_not_and_a_limit_conforms():
    limits = ToleranceInterval(0.0, 1.0)
    assert [conformance_probability(y, 0.0, limits) for y in (-1e-9, 0.0, 1.0, 1.1)] == [0, 1, 1, 0]


def test_guard_bands_are_multiples_of_the_expanded_uncertainty():
    assert guard_band(0.5, 1.0) == 1.0
    assert guard_band(0.5, 0.0) == 0.0
    assert guard_band(0.5) == pytest.approx(1.645 * 0.5)
    # at the end of the guard band one limit is kept with 95 %: the factor is Phi^-1(0.95) / 2, rounded
    assert stats.norm.ppf(0.95) / 2.0 == pytest.approx(ISO_14253_1_FACTOR, abs=3e-4)
    y = 10.0 - guard_band(0.3)
    assert conformance_probability(y, 0.3, ToleranceInterval(None, 10.0)) == pytest.approx(0.95, abs=1e-4)


@pytest.mark.parametrize(
    ("value", "simple", "guarded"),
    [
        (1499.7, "reject", "reject"),
        (1499.79, "reject", "not decided"),
        (1499.81, "accept", "not decided"),
        (1500.0, "accept", "accept"),
        (1500.19, "accept", "not decided"),
        (1500.3, "reject", "reject"),
    ],
)
def test_simple_acceptance_decides_what_guard_bands_leave_open(value, simple, guarded):
    assert zone(value, 0.04, RESISTORS, 0.0) == simple
    assert zone(value, 0.04, RESISTORS) == guarded


def test_a_check_carries_its_conformance_probability():
    result = measured("wheel", "n", "w", 0.8, 0.1, "s", "e", ToleranceInterval(None, 1.0))
    assert result.p_conform == pytest.approx(stats.norm.cdf(2.0))
    assert result.verdict == verdict_of(0.8, 0.1, None, 1.0) == "PASS"
    assert measured("wheel", "n", "w", 0.8, float("inf"), "s", "e", ToleranceInterval(None, 1.0)).p_conform is None
    assert measured("wheel", "n", "w", 0.8, 0.1, "s", "e").p_conform == 1.0


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: ToleranceInterval(None, None), r"every limit must be finite"),
        (
            lambda: ToleranceInterval(None, float("nan")),
            r"\[None, nan\]: at least one limit is needed, and every limit must be finite",
        ),
        (lambda: ToleranceInterval(2.0, 1.0), r"\[2.0, 1.0\]: the lower limit must not be above the upper limit"),
        (lambda: conformance_probability(0, -1, RESISTORS), r"standard uncertainty -1: must be 0 or more"),
        (lambda: conformance_probability(0, float("nan"), RESISTORS), r"standard uncertainty nan: must be 0 or more"),
        (
            lambda: conformance_probability(0, float("inf"), RESISTORS),
            r"standard uncertainty: is infinite, .* measure again",
        ),
        (lambda: zone(0, 1, RESISTORS, -0.1), r"guard factor -0.1: must be 0 or more for a rule with three verdicts"),
        (lambda: global_risks_normal(0, 1, 0, RESISTORS), r"uncertainty 0: the support must be a finite interval"),
        (lambda: global_risks(np.exp, (0, np.inf), 1, RESISTORS), r"support \(0, inf\) .* must be a finite interval"),
        (
            lambda: global_risks(stats.norm(0, 1).pdf, (-1, 1), 1, RESISTORS),
            r"integrates to 0.682689 over \(-1, 1\), but must integrate to 1; widen the support, or normalise",
        ),
    ],
)
def test_what_allows_no_statement_is_refused(call, message):
    with pytest.raises(FinrayError, match=message):
        call()
